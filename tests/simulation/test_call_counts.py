"""How many functions a call of simulate calls beside its steps, once its model is prepared."""

import pytest

import tenscontrol as tc
from tenscontrol.core.library import library
from tests.benchmarks.error_against_time import MOTIONS
from tests.test_traces import profiled

pytestmark = pytest.mark.skipif(library() is None, reason="installed without a compiler")


def calls_of(call):
    """Return how many functions of Python and of C a call enters."""
    count = 0

    def look(_, event, __):
        nonlocal count
        count += event in ("call", "c_call")

    with profiled(look):
        call()
    return count


# NumPy and Python differ by some calls from version to version.
@pytest.mark.parametrize(("error", "most"), [("none", 680), ("estimate", 960)])
def test_a_call_enters_few_functions(error, most):
    scene = MOTIONS["taut"].make(5.0)

    def call():
        tc.simulate(
            scene.model, 5.0, velocities=scene.velocities, rest_length=scene.rest_length,
            tolerance=1e-5, error=error,
        )  # fmt: skip

    call()
    assert calls_of(call) <= most
