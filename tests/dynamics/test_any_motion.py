"""Motions of structures of any class over 2 s, strings going slack and taut, against the oracle.

Both are integrated in the same way, each switch located: what differs is the model.
"""

import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.model_motion import ModelMotion
from tests.known_structures import KNOWN
from tests.oracle import HeldRestLength, NodeMotion
from tests.random_structures import any_motion_of, any_structure

STIFFNESS, DAMPING = 40.0, 0.3
TIMES = np.linspace(0, 2, 11)


def both(structure, velocities, form="flat", tolerance=1e-13):
    """Nodes at the times by the package and by the oracle, and the number of switches."""
    rest = structure.string_length() * np.linspace(0.9, 1.05, len(structure.strings))
    model = tc.Model(structure, tc.LinearStrings(STIFFNESS, DAMPING))
    package = ModelMotion(model, "rest_length", rest, form)
    oracle = NodeMotion(structure, HeldRestLength(rest, STIFFNESS, DAMPING))
    (found, switches), (expected, others) = (
        motion.integrate(structure.nodes, velocities, TIMES, tolerance)
        for motion in (package, oracle)
    )
    assert len(switches) == len(others)
    return found, expected, len(switches)


@pytest.mark.parametrize("name", ["D-bar in space", "clustered D-bar", "arm"])
def test_known_structures_move_as_the_oracle(name):
    structure = KNOWN[name]()
    _, velocities = any_motion_of(structure, 0)
    found, expected, switches = both(structure, 0.3 * velocities)
    assert switches >= 2
    assert np.abs(found - expected).max() < 1e-8


def test_a_random_structure_moves_as_the_oracle():
    structure = any_structure(3)
    _, velocities = any_motion_of(structure, 3)
    found, expected, switches = both(structure, 0.3 * velocities)
    assert switches >= 2
    assert np.abs(found - expected).max() < 1e-8
