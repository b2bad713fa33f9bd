"""The package as it is where no core was built.

``python -m tests.without_core`` runs the tests of an installation without it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

# Steps, runs and programs of MPC take other lines of the package where there is no core. These
# tests, of those that were tried, run all such lines; more of their kind repeat them.
_TESTS = (
    "tests/integrate",
    "tests/control/test_lqr.py",
    *(f"tests/control/mpc/test_{name}.py" for name in ("linear", "osqp_solver", "slopes")),
    "tests/control/mpc/test_exact_inputs.py::test_inputs_that_cost_little_keep_their_digits[1]",
    *(
        "tests/control/mpc/test_exact_inputs.py"
        f"::test_inputs_are_those_of_the_optimality_conditions[{scene}-0]"
        for scene in ("ball", "class_2_tower", "tower")
    ),
    "tests/test_pages.py",
    # Generated code has the C sources of the solvers, which the package brings then too.
    "tests/deploy/test_generated_code.py::test_force_density_along_a_moving_reference",
    "tests/deploy/test_generated_code.py::test_rest_length_with_winches_and_soft_limits",
    "tests/deploy/test_nonlinear_code.py::test_unknown_load_is_estimated_alike",
    "tests/test_import_cost.py",
)


@contextmanager
def without_core() -> Iterator[None]:
    """Run what is within on CasADi's virtual machine."""
    with patch("tenscontrol.integrate.core_scene.library", lambda: None):
        yield


if __name__ == "__main__":
    import pytest  # benchmarks, which need no pytest, use the rest

    sys.exit(pytest.main(["-q", *_TESTS]))
