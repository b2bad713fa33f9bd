"""Plants that several tests use."""

import numpy as np

import tenscontrol as tc
from tests.dynamics.scenes import weighted_prism
from tests.oracle import HeldForceDensity, HeldRestLength

KINDS = ("nodes", "minimal", "internal")
INPUTS = ("force_density", "rest_length")


def prism_plant(rest, held, kind="internal", damping=0.0, stiffness=100.0):
    """The plant of a prestress with strings of 100 N/m."""
    model = tc.Model(rest.structure, strings=tc.LinearStrings(stiffness, damping))
    return tc.linearize(model, rest, input=held, coordinates=kind)


def law_of(held, stiffness=100.0, damping=0.0):
    """The oracle's strings as a function of the held values."""
    if held == "force_density":
        return HeldForceDensity
    return lambda rest_length: HeldRestLength(rest_length, stiffness, damping)


def weighted_rest(mass=0.1):
    """A prism with point masses in its vertical strings, at rest."""
    structure = weighted_prism(mass)
    # Halves of a string carry the same tension: twice its force density.
    return tc.prestress(structure, np.r_[np.full(6, 30 / np.sqrt(3)), np.full(6, 60.0)])
