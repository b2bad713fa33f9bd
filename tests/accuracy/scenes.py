"""Cases that several tests measure on."""

from __future__ import annotations

import numpy as np

import tenscontrol as tc
from tests.dynamics.scenes import paper_force_density, rest_lengths

STIFFNESS = 100.0


def paper_case(duration, vertical=9.0, damping=0.0):
    """The paper's example 1 with massless strings; below 30 N/m horizontal strings go slack."""
    prism = tc.prism()
    lengths = rest_lengths(prism, paper_force_density(vertical), STIFFNESS)
    model = tc.Model(prism, strings=tc.LinearStrings(STIFFNESS, damping))
    return tc.Scene(model, duration, rest_length=lengths)


def slack_skin_case(duration):
    """The paper's example 2 with a skin without prestress, which hangs slack: it is chaotic."""
    structure = tc.skin(tc.prism(), panels=("top", "bottom"), iterations=2, node_mass=0.01)
    gamma = np.r_[paper_force_density(9.0), np.zeros(24)]
    model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS))
    lengths = rest_lengths(structure, gamma, STIFFNESS)
    return tc.Scene(model, duration, rest_length=lengths)
