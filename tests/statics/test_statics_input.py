"""Input of statics that must be refused by name."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tests.refused import (
    INF,
    NAN,
    STILL,
    assert_refused,
    gamma,
    line,
    model,
    nodes,
    prism,
    refused,
    with_entry,
)


def held_top():
    """A prism that hangs on its top nodes."""
    return replace(prism(), fixed=[0, 1, 2])


# fmt: off
# Two lines a case.
STATICS = [
    refused("prestress of a model", lambda: tc.prestress(model(), 17.0), TypeError,
            r"structure is a Model, expected Structure"),
    refused("prestress impossible", lambda: tc.prestress(line(), 1.0), ValueError,
            r"no state of self-stress.*singular value.*4\.1e-01"),
    refused("force_density none", lambda: tc.prestress(prism(), None), TypeError,
            r"force_density is None"),
    refused("force_density text", lambda: tc.prestress(prism(), "17"), TypeError,
            r"force_density .*'17'"),
    refused("force_density zero", lambda: tc.prestress(prism(), 0.0), ValueError,
            r"force_density is 0\.0, .*positive"),
    refused("force_density negative number", lambda: tc.prestress(prism(), -1.0), ValueError,
            r"force_density is -1\.0, .*positive"),
    refused("force_density nan", lambda: tc.prestress(prism(), NAN), ValueError,
            r"force_density is nan"),
    refused("force_density bool", lambda: tc.prestress(prism(), True), TypeError,
            r"force_density .*True"),
    refused("force_density too few", lambda: tc.prestress(prism(), gamma()[:8]), ValueError,
            r"force_density has shape \(8,\), expected \(9,\)"),
    refused("force_density a row", lambda: tc.prestress(prism(), gamma()[None, :]), ValueError,
            r"force_density has shape \(1, 9\), expected \(9,\)"),
    refused("force_density negative entry",
            lambda: tc.prestress(prism(), with_entry(gamma(), 4, -1.0)), ValueError,
            r"force_density\[4\] is -1, .*can only pull"),
    refused("force_density nan entry", lambda: tc.prestress(prism(), with_entry(gamma(), 4, NAN)),
            ValueError, r"force_density\[4\] is nan"),
    refused("force_density unbalanced", lambda: tc.prestress(prism(), np.ones(9)), ValueError,
            r"force_density does not balance: node \d is left with .* 0\.47 N"),
    refused("reference with an array", lambda: tc.prestress(prism(), gamma(), reference="top"),
            ValueError, r"reference goes with a single force_density"),
    refused("reference unknown", lambda: tc.prestress(prism(), 17.0, reference="diagonal"),
            ValueError, r"reference is 'diagonal', expected one of 'top', 'bottom', 'vertical'"),
    refused("prestress load transposed",
            lambda: tc.prestress(prism(), 17.0, external_force=STILL.T), ValueError,
            r"external_force has shape \(6, 3\), expected \(3, 6\)"),
    refused("prestress load nan",
            lambda: tc.prestress(prism(), 17.0, external_force=with_entry(STILL, (1, 2), NAN)),
            ValueError, r"external_force\[1, 2\] is nan"),
    refused("prestress load unbalanced",
            lambda: tc.prestress(prism(), 17.0, external_force=with_entry(STILL, (2, 0), 1.0)),
            ValueError, r"no member forces balance external_force: node \d is left with .* N"),
    refused("prestress keyword", lambda: tc.prestress(prism(), gamma=1.0), TypeError,
            r"argument 'gamma'"),
    refused("prism_force_density sides", lambda: tc.statics.prism_force_density(2, 1.0), ValueError,
            r"sides is 2"),
    refused("prism_force_density negative", lambda: tc.statics.prism_force_density(3, -1.0),
            ValueError, r"force_density is -1\.0"),
    refused("prism_force_density array", lambda: tc.statics.prism_force_density(3, [1.0, 2.0]),
            TypeError, r"force_density is \[1\.0, 2\.0\]"),
    refused("prism_force_density radius",
            lambda: tc.statics.prism_force_density(3, 1.0, radius=0.0), ValueError,
            r"^radius is 0\.0"),
    refused("prism_force_density top_radius",
            lambda: tc.statics.prism_force_density(3, 1.0, top_radius=INF), ValueError,
            r"top_radius is inf"),
    refused("equilibrium_matrix transposed",
            lambda: tc.statics.equilibrium_matrix(prism(), nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("equilibrium_matrix nan",
            lambda: tc.statics.equilibrium_matrix(prism(), with_entry(nodes(), (2, 3), NAN)),
            ValueError, r"nodes\[2, 3\] is nan"),
    refused("equilibrium_matrix text", lambda: tc.statics.equilibrium_matrix(prism(), "here"),
            TypeError, r"nodes .*'here'"),
]

FOUND_IN_REVIEW = [
    refused("prestress force_density complex", lambda: tc.prestress(prism(), gamma() + 0j),
            TypeError, r"force_density.*complex"),
    refused("force_density ragged", lambda: tc.prestress(prism(), [[1.0], [1.0, 2.0]]), TypeError,
            r"force_density .*(inhomogeneous|ragged|lengths)"),
    refused("equilibrium_matrix of nodes", lambda: tc.statics.equilibrium_matrix(nodes()),
            TypeError, r"structure is a ndarray, expected Structure"),
    refused("stress_matrix of a model",
            lambda: tc.statics.stress_matrix(model(), np.ones(9), np.ones(3)), TypeError,
            r"structure is a Model, expected Structure"),
    refused("stress_matrix too few",
            lambda: tc.statics.stress_matrix(prism(), np.ones(8), np.ones(3)), ValueError,
            r"^force_density has shape \(8,\), expected \(9,\)"),
    refused("stress_matrix swapped",
            lambda: tc.statics.stress_matrix(prism(), np.ones(3), np.ones(9)), ValueError,
            r"^force_density has shape \(3,\), expected \(9,\)"),
    refused("stress_matrix nan",
            lambda: tc.statics.stress_matrix(prism(), np.full(9, NAN), np.ones(3)), ValueError,
            r"^force_density\[0\] is nan"),
    refused("force_density beyond squares", lambda: tc.prestress(prism(), 1e308), ValueError,
            r"^force_density(\[0\])? is 1e\+308, expected at most 1e\+70"),
    refused("force_density of a string beyond squares",
            lambda: tc.prestress(prism(), np.full(9, 1e308)), ValueError,
            r"^force_density(\[0\])? is 1e\+308, expected at most 1e\+70"),
    refused("load beyond squares",
            lambda: tc.prestress(prism(), 17.0, external_force=np.full((3, 6), 1e308)), ValueError,
            r"^external_force\[0, 0\] is 1e\+308, expected at most 1e\+70"),
    refused("radius beyond squares",
            lambda: tc.statics.prism_force_density(3, 10.0, radius=1e-320), ValueError,
            r"^radius is 1e-320, expected a positive .* between 1e-70"),
    refused("ratio of radii", lambda: tc.statics.prism_force_density(3, 10.0, 1e-60, 1e60),
            ValueError, r"^force_density \(top_radius/radius\)² is 1e\+241, expected"),
    refused("reference between fixed nodes", lambda: tc.prestress(held_top(), 17.0, "top"),
            ValueError, r"^reference is 'top', whose strings have both ends fixed"),
    refused("group of the first string between fixed nodes",
            lambda: tc.prestress(held_top(), 17.0), ValueError, r"^reference is 'top'"),
    refused("reference empty", lambda: tc.prestress(prism(), 17.0, reference=""), ValueError,
            r"reference is '', expected one of"),
]

# fmt: on


# fmt: off
BOUNDS = [
    refused("no level at all", lambda: tc.prestress(prism()), TypeError,
            r"^force_density is None, expected .* or min_force_density"),
    refused("least negative", lambda: tc.prestress(prism(), min_force_density=-1.0), ValueError,
            r"^min_force_density\[0\] is -1, .*can only pull"),
    refused("least of too few", lambda: tc.prestress(prism(), min_force_density=[1.0]), ValueError,
            r"^min_force_density has shape \(1,\), expected \(\) or \(9,\)"),
    refused("least nothing", lambda: tc.prestress(prism(), min_force_density=0.0), ValueError,
            r"^min_force_density is 0 for every string"),
    refused("most nan", lambda: tc.prestress(prism(), 1.0, max_force_density=NAN), ValueError,
            r"^max_force_density is nan"),
    refused("most nothing", lambda: tc.prestress(prism(), max_force_density=0.0), ValueError,
            r"^no force densities|^max_force_density"),
    refused("all strings held",
            lambda: tc.prestress(replace(prism(), fixed=range(6)), min_force_density=1.0),
            ValueError, r"^both ends of every string are fixed"),
    refused("bounds crossed",
            lambda: tc.prestress(prism(), min_force_density=2.0, max_force_density=1.0), ValueError,
            r"^min_force_density\[0\] is 2 N/m, more than max_force_density\[0\] = 1 N/m"),
    refused("bounds of given forces",
            lambda: tc.prestress(prism(), gamma(), min_force_density=1.0), ValueError,
            r"^force_density gives γ of every string"),
    refused("reference without level",
            lambda: tc.prestress(prism(), reference="top", min_force_density=1.0), ValueError,
            r"^reference goes with a single force_density, which is not given"),
    refused("stiffness zero", lambda: tc.prestress(prism(), 17.0).tangent_stiffness(0.0),
            ValueError, r"^stiffness\[0\] is 0, expected a positive"),
    refused("stiffness of too many",
            lambda: tc.prestress(prism(), 17.0).tangent_stiffness(np.ones(3)), ValueError,
            r"^stiffness has shape \(3,\), expected \(\) or \(9,\)"),
]
# fmt: on

CASES = [*STATICS, *FOUND_IN_REVIEW, *BOUNDS]


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)


def test_a_number_may_be_an_array_without_dimension():
    strings = tc.LinearStrings(stiffness=100.0)
    wanted = strings.force_density(length=1.0, rest_length=0.8)  # array(20.)
    assert tc.prestress(prism(), wanted).force_density[0] == pytest.approx(20.0)
