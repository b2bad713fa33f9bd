"""Checks of arguments that the whole package shares: what they refuse and what they keep."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol import validation
from tests.refused import INF, NAN, assert_refused, equation, nodes, prism, refused, with_entry

# fmt: off
# Two lines a case.
CASES = [
    refused("entry too large", lambda: tc.prestress(prism(), 1e308), ValueError,
            r"force_density is 1e\+308, expected at most 1e\+70"),
    refused("number too large", lambda: tc.prism(radius=1e100), ValueError,
            r"radius is 1e\+100, .*1e-70 and 1e\+70"),
    refused("number too small", lambda: tc.statics.prism_force_density(3, 1.0, radius=1e-320),
            ValueError, r"radius is (9\.99\d+e-321|1e-320), .*between 1e-70"),
    refused("positive entry too small", lambda: tc.LinearStrings([1.0, 1e-200]), ValueError,
            r"stiffness\[1\] is 1e-200, expected a positive .* of at least 1e-70"),
    refused("force densities beyond", lambda: tc.statics.prism_force_density(3, 1, 1e-60, 1e60),
            ValueError, r"force_density \(top_radius/radius\)² is 1e\+240"),
    refused("nodes far off",
            lambda: tc.structure.restore_bar_lengths(prism(), with_entry(nodes(), (1, 2), 1e300)),
            ValueError, r"nodes\[1, 2\] is 1e\+300, expected at most 1e\+70"),
    refused("long double", lambda: tc.prestress(prism(), np.longdouble("1e4000")), ValueError,
            r"force_density is (inf|1e\+4000)"),
    refused("axis too long", lambda: tc.Height(1.0, [0], [3], axis=[1e300, 0, 1e300]), ValueError,
            r"axis\[0\] is 1e\+300"),
    refused("no time", lambda: tc.prism(radius=np.timedelta64("NaT", "s")), TypeError,
            r"radius is .*NaT"),
    refused("sides a time", lambda: tc.prism(sides=np.timedelta64(3, "s")), TypeError,
            r"sides is .*timedelta64\(3,'s'\)"),
    refused("whole number beyond printing", lambda: tc.prism(handedness=10**5000), ValueError,
            r"handedness is beyond 1e4000, expected one of"),
    refused("group an array", lambda: prism().strings_in(np.ones(9)), ValueError,
            r"group is array.*, expected one of"),
    refused("groups a number", lambda: validation.items("groups", np.array(1.0), "names"),
            TypeError, r"groups is array\(1\.\), expected a sequence of names"),
    refused("state of another count",
            lambda: integrator().advance(np.ones(3), np.ones(9), 0.1, 1), ValueError,
            r"state has shape \(3,\), expected \(36,\)"),
    refused("held nan", lambda: integrator().advance(np.ones(36), np.full(9, NAN), 0.1, 1),
            ValueError, r"held\[0\] is nan"),
    refused("outputs without end",
            lambda: integrator().advance(np.ones(36), np.ones(9), 0.1, 2**40),
            ValueError, r"outputs is 1099511627776, expected a whole number of at most"),
    refused("report a number",
            lambda: integrator().advance(np.ones(36), np.ones(9), 0.1, 1, report=3), TypeError,
            r"report is a int, expected a function"),
    refused("duration infinite", lambda: integrator().advance(np.ones(36), np.ones(9), INF, 1),
            ValueError, r"duration is inf"),
    refused("equation a model", lambda: tc.integrate.RK4(prism(), 0.1), TypeError,
            r"equation is a Structure, expected Equation"),
    refused("method without name",
            lambda: tc.integrate.Method(1, ("step",), "mine", tc.integrate.RK4), TypeError,
            r"name is 1, expected text"),
    refused("method without settings",
            lambda: tc.integrate.Method("mine", (), "mine", tc.integrate.RK4), TypeError,
            r"settings is a tuple, expected a tuple of 'step' and 'tolerance'"),
]
# fmt: on


def integrator():
    return tc.integrate.RK4(equation(), step=0.01)


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)


@pytest.mark.parametrize("size", [1e-300, 1e-320, 1.0, 1e69])
def test_a_direction_has_length_one_whatever_its_size(size):
    np.testing.assert_allclose(
        validation.direction("axis", [size, 0.0, size]), np.sqrt([0.5, 0.0, 0.5]), rtol=1e-3
    )
    turned = tc.RotationalSymmetry([[0, 1, 2]], axis=[0.0, 0.0, size]).rotation()
    np.testing.assert_array_equal(
        turned, tc.RotationalSymmetry([[0, 1, 2]], axis=[0.0, 0.0, 1.0]).rotation()
    )
