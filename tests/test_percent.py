"""Parts of 1 as people read them."""

import pytest

from tenscontrol.tables import percent


@pytest.mark.parametrize(
    ("part", "shown"),
    [(1.0, "100 %"), (0.999, "100 %"), (0.124, "12 %"), (1.26, "130 %"), (3e-6, "0.0003 %"),
     (0.0, "0 %"), (-0.034, "-3.4 %"), (-1.0, "-100 %")],
)  # fmt: skip
def test_percent_has_no_exponent(part, shown):
    assert percent(part) == shown
