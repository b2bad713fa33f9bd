"""Compiling takes longer here than running what was compiled."""

import pytest

from tenscontrol.deploy import compiled_controller


@pytest.fixture(autouse=True, scope="package")
def quick_to_compile():
    """Compile without optimization."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled_controller, "OPTIMIZATION", "-O0")
        yield
