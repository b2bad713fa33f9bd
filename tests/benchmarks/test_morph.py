"""Height 1.0 m to 0.7 m and 20 degrees of twist, and back, by winches on strings with mass."""

import pytest

from tests.benchmarks.morph import LARGEST_TENSION, LEAST, morph

pytestmark = pytest.mark.benchmark


def test_a_prism_goes_there_and_back_within_all_limits():
    """The benchmark, with winches that are faster: 0.4 m/s."""
    rate = 0.4
    made = morph(1e3, 5, rate=rate, machine_code=False)
    assert made.height_error < 1e-4
    assert made.twist_error < 0.01
    assert made.node_error < 1e-4
    assert made.least_force_density > 0.5 * LEAST
    assert made.largest_tension < LARGEST_TENSION
    assert made.rate <= rate * (1 + 1e-9)
    assert made.at_rate > 0.2
    assert made.in_range
    assert set(made.statuses) == {"ok"}
