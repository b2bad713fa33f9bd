"""Input of dynamics that must be refused by name."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.refused import (
    INF,
    NAN,
    STILL,
    assert_refused,
    elastic,
    gamma,
    model,
    nodes,
    plant,
    prism,
    refused,
    with_entry,
)

# fmt: off
# Two lines a case.
STRINGS = [
    refused("stiffness missing", lambda: tc.LinearStrings(), TypeError, r"'stiffness'"),
    refused("stiffness zero", lambda: tc.LinearStrings(0.0), ValueError,
            r"stiffness\[0\] is 0, .*pos"),
    refused("stiffness negative", lambda: tc.LinearStrings([1.0, -2.0]), ValueError,
            r"stiffness\[1\] is -2"),
    refused("stiffness nan", lambda: tc.LinearStrings(NAN), ValueError, r"stiffness is nan"),
    refused("stiffness inf", lambda: tc.LinearStrings(INF), ValueError, r"stiffness is inf"),
    refused("stiffness text", lambda: tc.LinearStrings("k"), TypeError, r"stiffness .*'k'"),
    refused("stiffness complex", lambda: tc.LinearStrings(1j), TypeError, r"stiffness .*complex"),
    refused("stiffness of two dimensions", lambda: tc.LinearStrings(np.ones((2, 2))), ValueError,
            r"stiffness has shape \(2, 2\)"),
    refused("damping negative", lambda: tc.LinearStrings(1.0, damping=-1.0), ValueError,
            r"damping\[0\] is -1, expected at least 0"),
    refused("LinearStrings keyword", lambda: tc.LinearStrings(1.0, rest_length=1.0), TypeError,
            r"argument 'rest_length'"),
    refused("axial_rigidity zero", lambda: tc.ElasticStrings(0.0), ValueError,
            r"axial_rigidity\[0\] is 0"),
    refused("axial_rigidity text", lambda: tc.ElasticStrings("EA"), TypeError,
            r"axial_rigidity .*'EA'"),
    refused("elastic damping nan", lambda: tc.ElasticStrings(1.0, damping=[0.0, NAN]), ValueError,
            r"damping\[1\] is nan"),
    refused("ElasticStrings keyword", lambda: tc.ElasticStrings(stiffness=1.0), TypeError,
            r"argument 'stiffness'"),
    refused("StringLaw itself", lambda: tc.dynamics.StringLaw(), TypeError,
            r"abstract class StringLaw.*tension"),
    refused("length zero", lambda: tc.LinearStrings(100.0).force_density([1.0, 0.0], 1.0),
            ValueError, r"^length\[1\] is 0"),
    refused("rest_length negative",
            lambda: tc.ElasticStrings(100.0).force_density(1.0, [1.0, -0.5]), ValueError,
            r"rest_length\[1\] is -0\.5"),
    refused("rest_length nan", lambda: tc.LinearStrings(100.0).force_density(1.0, NAN), ValueError,
            r"rest_length is nan"),
    refused("rate nan", lambda: tc.LinearStrings(100.0).force_density(1.0, 0.9, rate=NAN),
            ValueError, r"rate is nan"),
    refused("shapes of arguments",
            lambda: tc.LinearStrings(100.0).force_density(np.ones(2), np.ones(3)), ValueError,
            r"length \(2,\), rest_length \(3,\)"),
    refused("shapes of arguments and parameters",
            lambda: tc.LinearStrings([1.0, 2.0]).force_density(np.ones(3), 1.0), ValueError,
            r"length.*\(3,\).*\(2,\)"),
    refused("lengths of two dimensions",
            lambda: tc.LinearStrings(100.0).force_density(np.ones((2, 2)), 1.0), ValueError,
            r"(?=.*shape \(2, 2\)).*one per string"),
    refused("force_density keyword",
            lambda: tc.LinearStrings(100.0).force_density(1.0, 1.0, velocity=0.0), TypeError,
            r"argument 'velocity'"),
    refused("force_density at the stiffness",
            lambda: tc.LinearStrings(100.0).rest_length(1.0, [1.0, 100.0]), ValueError,
            r"force_density\[1\] is 100 N/m, expected less than the stiffness 100 N/m"),
    refused("force_density of a pushing string",
            lambda: tc.ElasticStrings(100.0).rest_length(1.0, -2.0), ValueError,
            r"force_density\[0\] is -2, .*can only pull"),
    refused("force_density infinite", lambda: tc.ElasticStrings(100.0).rest_length(1.0, INF),
            ValueError, r"force_density is inf"),
]

MODEL = [
    refused("Model of nodes", lambda: tc.Model(nodes()), TypeError, r"structure is a ndarray"),
    refused("Model strings number", lambda: tc.Model(prism(), strings=100.0), TypeError,
            r"strings is a float, expected StringLaw"),
    refused("Model strings count", lambda: tc.Model(prism(), strings=tc.LinearStrings(np.ones(8))),
            ValueError, r"stiffness has shape \(8,\), expected \(\) or \(9,\)"),
    refused("Model damping count",
            lambda: tc.Model(prism(), strings=tc.ElasticStrings(1.0, damping=np.ones(3))),
            ValueError, r"damping has shape \(3,\), expected \(\) or \(9,\)"),
    refused("Model load transposed", lambda: tc.Model(prism(), external_force=np.zeros((6, 3))),
            ValueError, r"external_force has shape \(6, 3\), expected \(3, 6\)"),
    refused("Model gravity of two", lambda: tc.Model(prism(), gravity=[0.0, 9.81]), ValueError,
            r"gravity has shape \(2,\), expected \(\) or \(3,\)"),
    refused("Model gravity upward", lambda: tc.Model(prism(), gravity=-9.81), ValueError,
            r"gravity is -9\.81 m/s², expected at least 0: .* Give 9\.81, or a vector"),
    refused("Model gravity nan", lambda: tc.Model(prism(), gravity=NAN), ValueError,
            r"gravity is nan"),
    refused("Model keyword", lambda: tc.Model(prism(), g=9.81), TypeError, r"argument 'g'"),
    *[
        refused(
            f"{name} without strings",
            lambda name=name: getattr(model(), name),
            ValueError,
            r"model has no string law.*strings=LinearStrings",
        )
        for name in ("rest_length_dynamics", "string_force_density", "elastic_energy")
    ],
    # A CasADi function speaks for itself.
    refused("acceleration of transposed nodes",
            lambda: model().acceleration(nodes().T, STILL, gamma()), RuntimeError,
            r"acceleration(.|\n)*\(N\) has mismatching shape\. Got 6-by-3"),
]

COORDINATES = [
    refused("coordinates unknown", lambda: tc.dynamics.coordinates(model(), kind="modal"),
            ValueError, r"is 'modal', expected one of 'nodes', 'minimal', 'internal'"),
    refused("coordinates kind as nodes", lambda: tc.dynamics.coordinates(model(), "minimal"),
            TypeError, r"nodes .*'minimal'"),
    refused("coordinates transposed", lambda: tc.dynamics.coordinates(model(), nodes().T),
            ValueError, r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("coordinates nan",
            lambda: tc.dynamics.coordinates(model(), with_entry(nodes(), (0, 0), NAN)), ValueError,
            r"nodes\[0, 0\] is nan"),
    refused("measure transposed", lambda: plant().coordinates.measure(nodes().T, STILL), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("measure velocities", lambda: plant().coordinates.measure(nodes(), STILL[:2]),
            ValueError, r"velocities has shape \(2, 6\), expected \(3, 6\)"),
    refused("measure nan",
            lambda: plant().coordinates.measure(nodes(), with_entry(STILL, (1, 1), NAN)),
            ValueError, r"velocities\[1, 1\] is nan"),
    refused("to_nodes of a whole state", lambda: plant().coordinates.to_nodes(np.zeros(18)),
            ValueError, r"q has shape \(18,\), expected \(9,\): one per internal coordinate"),
    refused("to_nodes nan", lambda: plant().coordinates.to_nodes(with_entry(np.zeros(9), 2, NAN)),
            ValueError, r"q\[2\] is nan"),
    refused("to_nodes too far", lambda: plant().coordinates.to_nodes(np.full(9, 10.0)), ValueError,
            r"q turns bar \d by a right angle or more"),
    refused("to_velocities q", lambda: plant().coordinates.to_velocities(np.zeros(8), np.zeros(9)),
            ValueError, r"q has shape \(8,\), expected \(9,\)"),
    refused("to_velocities rates",
            lambda: plant().coordinates.to_velocities(np.zeros(9), np.zeros((9, 1))), ValueError,
            r"rates has shape \(9, 1\), expected \(9,\)"),
]

FOUND_IN_REVIEW = [
    refused("stiffness none", lambda: tc.LinearStrings(None), TypeError, r"stiffness is None"),
    refused("damping none", lambda: tc.LinearStrings(1.0, damping=None), TypeError,
            r"damping is None"),
    refused("q none", lambda: plant().coordinates.to_nodes(None), TypeError, r"q is None"),
    refused("stiffness digits", lambda: tc.LinearStrings("100"), TypeError, r"stiffness.*100"),
    refused("coordinates of a structure", lambda: tc.dynamics.coordinates(prism()), TypeError,
            r"model is a Structure, expected Model"),
    refused("project a shape", lambda: plant().coordinates.project(nodes()), ValueError,
            r"displacements has shape \(3, 6\)"),
    refused("project nan", lambda: plant().coordinates.project(np.full(18, NAN)), ValueError,
            r"displacements\[0\] is nan"),
    refused("to_velocities q in nodes",
            lambda: plant("nodes").coordinates.to_velocities(np.zeros(3), np.zeros(18)), ValueError,
            r"q has shape \(3,\), expected \(18,\)"),
    refused("stiffness and damping of two counts",
            lambda: tc.LinearStrings([1.0, 2.0], damping=[1.0, 2.0, 3.0]), ValueError,
            r"stiffness.*\(2,\).*damping.*\(3,\)"),
    refused("stiffness of no strings", lambda: tc.LinearStrings([]), ValueError, r"stiffness"),
    refused("length of no strings", lambda: tc.LinearStrings(100.0).force_density([], 1.0),
            ValueError, r"length.*\(0,\)"),
    refused("state_equation unknown", lambda: elastic().state_equation("tension"), ValueError,
            r"input is 'tension', expected one of 'force_density', 'rest_length'"),
    refused("kind by its name", lambda: tc.dynamics.coordinates(model(), kind="modal"), ValueError,
            r"^kind is 'modal'"),
    refused("coordinates of wrong bar lengths",
            lambda: tc.dynamics.coordinates(model(), 1.1 * nodes()), ValueError,
            r"nodes, bar 0 has length 1\.529\d* m, expected 1\.390\d* m"),
    refused("coordinates collapsed", lambda: tc.dynamics.coordinates(model(), STILL), ValueError,
            r"nodes, bar 0 has length 0 m, expected 1\.390\d* m"),
]

# fmt: on


CASES = [*STRINGS, *MODEL, *COORDINATES, *FOUND_IN_REVIEW]


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)


def test_a_string_law_without_strings_is_refused():
    bars = tc.Structure([[0, 1, 2], [0, -1, -1]], [(0, 1), (1, 2)], [], 1.0, fixed=[0])
    with pytest.raises(ValueError, match="strings is given, but the structure has none; leave it"):
        tc.Model(bars, tc.LinearStrings(10.0))
