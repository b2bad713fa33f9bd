"""Input of plant that must be refused by name."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.refused import (
    NAN,
    STILL,
    assert_refused,
    drifting,
    elastic,
    gamma,
    loaded,
    model,
    nodes,
    plant,
    prism,
    refused,
    rest,
    touching,
    with_entry,
)


def point(**changes):
    """The prism at rest, with some arguments of the operating point replaced."""
    return tc.OperatingPoint(**({"nodes": nodes(), "force_density": gamma()} | changes))


# fmt: off
# Two lines a case.
LINEARIZE = [
    refused("linearize a structure", lambda: tc.linearize(prism(), rest()), TypeError,
            r"model is a Structure, expected Model"),
    refused("linearize swapped", lambda: tc.linearize(rest(), model()), TypeError,
            r"model is a Prestress, expected Model"),
    refused("linearize at force densities", lambda: tc.linearize(model(), gamma()), TypeError,
            r"at is a ndarray, expected .*prestress"),
    refused("linearize at nothing", lambda: tc.linearize(model(), None), TypeError,
            r"at is a NoneType"),
    refused("input unknown", lambda: tc.linearize(model(), rest(), input="tension"), ValueError,
            r"input is 'tension', expected one of 'force_density', 'rest_length'"),
    refused("linearize coordinates unknown",
            lambda: tc.linearize(model(), rest(), coordinates="modal"), ValueError,
            r"coordinates is 'modal', expected one of 'nodes', 'minimal', 'internal'"),
    refused("linearize keyword", lambda: tc.linearize(model(), rest(), inputs="force_density"),
            TypeError, r"argument 'inputs'"),
    refused("rest length without strings",
            lambda: tc.linearize(model(), rest(), input="rest_length"), ValueError,
            r"model has no string law.*strings=LinearStrings"),
    refused("strings too soft",
            lambda: tc.linearize(tc.Model(prism(), strings=tc.LinearStrings(20.0)), rest()),
            ValueError, r"force_density\[6\] is 30 N/m, expected less than the stiffness 20 N/m"),
    refused("not an equilibrium", lambda: tc.linearize(model(), point(force_density=np.ones(9))),
            ValueError, r"not an equilibrium: node \d is left with an unbalanced force of 0\.47 N"),
    refused("not an equilibrium for its load",
            lambda: tc.linearize(loaded(), point(external_force=with_entry(STILL, (2, 0), 1.0))),
            ValueError, r"not an equilibrium: node 0 is left"),
    refused("load without a load input",
            lambda: tc.linearize(model(), point(external_force=with_entry(STILL, (2, 0), 1.0))),
            ValueError, r"carries another load than the model: at node 0"),
    refused("structure of other bars", lambda: tc.linearize(tc.Model(tc.prism(sides=4)), rest()),
            ValueError, r"prestress and the model differ in their bars"),
    refused("structure of other masses",
            lambda: tc.linearize(tc.Model(tc.prism(bar_mass=2.0)), rest()), ValueError,
            r"prestress and the model differ in their bar_mass"),
    refused("structure of other bar lengths",
            lambda: tc.linearize(tc.Model(tc.prism(height=1.2)), rest()), ValueError,
            r"bar 0 has length 1\.39\d* m, expected 1\.54\d* m"),
    refused("point transposed", lambda: tc.linearize(model(), point(nodes=nodes().T)), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, [6n]\)"),
    refused("point of wrong bar lengths", lambda: tc.linearize(model(), point(nodes=1.1 * nodes())),
            ValueError,
            r"at\.nodes, bar 0 has length 1\.529\d* m, expected 1\.390\d* m.*restore_bar_lengths"),
    refused("point of too few force densities",
            lambda: tc.linearize(model(), point(force_density=gamma()[:8])), ValueError,
            r"force_density has shape \(8,\), expected \(9,\)"),
    refused("point of one force density", lambda: tc.linearize(model(), point(force_density=17.0)),
            ValueError, r"force_density has shape \(\), expected \((9|α),\)"),
    refused("point of a pushing string",
            lambda: tc.linearize(model(), point(force_density=with_entry(gamma(), 3, -1.0))),
            ValueError, r"force_density\[3\] is -1, .*can only pull"),
    refused("point of a nan",
            lambda: tc.linearize(model(), point(force_density=with_entry(gamma(), 3, NAN))),
            ValueError, r"force_density\[3\] is nan"),
    refused("point load transposed", lambda: tc.linearize(loaded(), point(external_force=STILL.T)),
            ValueError, r"external_force has shape \(6, 3\), expected \(3, [6n]\)"),
    refused("slack string at the kink",
            lambda: drifting(elastic(), force_density=with_entry(gamma(), 5, 0.0),
                             input="rest_length"),
            ValueError, r"string 5 has γ = 0 N/m, at the border between taut and slack"),
    refused("OperatingPoint keyword", lambda: point(velocities=STILL), TypeError,
            r"argument 'velocities'"),
]

PLANT = [
    refused("modes of a model", lambda: tc.modes(model()), TypeError,
            r"plant is a Model, .*Linear"),
    refused("modes of a matrix", lambda: tc.modes(np.eye(2)), TypeError, r"plant is a ndarray"),
    refused("controllability of a model", lambda: tc.controllability(model()), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("controllability of matrices", lambda: tc.controllability(np.eye(2), np.eye(2)),
            TypeError, r"plant is a.* expected LinearPlant"),
    refused("in_coordinates unknown", lambda: tc.plant.in_coordinates(plant(), "modal"), ValueError,
            r"is 'modal', expected one of 'nodes', 'minimal', 'internal'"),
    refused("step zero", lambda: plant().discretize(0.0), ValueError,
            r"sample_time is 0\.0, .* in s"),
    refused("step negative", lambda: plant().discretize(-0.1), ValueError, r"sample_time is -0\.1"),
    refused("step nan", lambda: plant().discretize(NAN), ValueError, r"sample_time is nan"),
    refused("step text", lambda: plant().discretize("0.1"), TypeError, r"sample_time is '0\.1'"),
    refused("step none", lambda: plant().discretize(None), TypeError, r"sample_time is None"),
    refused("state space of a drifting plant",
            lambda: drifting(model(), force_density=np.ones(9)).to_statespace(), ValueError,
            r"plant has a drift.*away from an equilibrium"),
    refused("plant measure transposed", lambda: plant().measure(nodes().T, STILL), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("plant to_nodes of a whole state", lambda: plant().to_nodes(np.zeros(18)), ValueError,
            r"q has shape \(18,\), expected \(9,\)"),
    refused("plant to_velocities rates", lambda: plant().to_velocities(np.zeros(9), np.zeros(8)),
            ValueError, r"rates has shape \(8,\), expected \(9,\)"),
]

FOUND_IN_REVIEW = [
    refused("in_coordinates of a model", lambda: tc.plant.in_coordinates(model(), "minimal"),
            TypeError, r"plant is a Model, expected LinearPlant"),
    refused("require_equilibrium text",
            lambda: tc.linearize(model(), rest(), require_equilibrium="no"), TypeError,
            r"require_equilibrium is .*(str|'no')"),
    refused("OperatingPoint transposed", lambda: tc.OperatingPoint(nodes().T, gamma()), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, n\)"),
    refused("OperatingPoint text", lambda: tc.OperatingPoint("here", gamma()), TypeError,
            r"nodes .*'here'"),
    refused("linearize with a string of no length",
            lambda: drifting(touching(), touching().structure.nodes, [1.0, 1.0],
                             input="rest_length"),
            ValueError, r"string(s\[1\]| 1) "),
]

# fmt: on


CASES = [*LINEARIZE, *PLANT, *FOUND_IN_REVIEW]


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)


def test_controllability_of_a_plant_whose_poles_are_all_real():
    result = tc.controllability(drifting(model(), force_density=np.zeros(9)))
    np.testing.assert_array_equal(result.pole, [0.0])
    # The strings change no length, and so do no work, along the mechanism of the prism.
    assert result.unreachable == 2
