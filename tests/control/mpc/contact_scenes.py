"""Structures over the ground, and an NMPC that lands them, stands, jumps and lands again."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from tenscontrol.dynamics import SmoothGround
from tests import coupled

SAMPLE = 0.02
GROUND = {"stiffness": 5e3, "damping": 0.3, "friction": 0.5, "slip_speed": 0.1}
STRINGS = tc.LinearStrings(stiffness=800.0, damping=2.0)


def models(structure, width=0.005):
    """The model that is simulated, and the one that is predicted with: sharp for no width."""
    sharp = tc.Ground(**GROUND)
    smooth = SmoothGround(**GROUND, width=width) if width else sharp
    return [tc.Model(structure, STRINGS, gravity=9.81, ground=ground) for ground in (sharp, smooth)]


def hanging(structure, height, gamma=40.0, width=0.005, **options):
    """A plant in the air, its lowest node at a height above the ground."""
    model = models(structure, width)[1]
    rest = tc.prestress(structure, force_density=gamma)
    nodes = structure.nodes.copy()
    nodes[-1] += height - nodes[-1].min()
    at = tc.OperatingPoint(nodes, rest.force_density, model.constant_force)
    given = {"input": "rest_length", "coordinates": "minimal"} | options
    return tc.linearize(model, at, require_equilibrium=False, **given)


def ball():
    """A six-bar ball on one of its closed triangles."""
    structure = tc.library.six_bar_ball(bar_length=1.0)
    down = structure.nodes[:, [0, 4, 8]].sum(axis=1)
    turn = Rotation.align_vectors([[0.0, 0.0, -1.0]], [down])[0].as_matrix()
    return replace(structure, nodes=turn @ structure.nodes)


STRUCTURES = {
    "x": lambda **options: hanging(tc.library.snelson_x(), **options),
    "d_bar": lambda **options: hanging(coupled.d_bar(), **options),
    "tower": lambda **options: hanging(
        coupled.tower(), gamma=coupled.tower_force_density(15.0), **options
    ),
    "ball": lambda **options: hanging(ball(), gamma=60.0, **options),
}


def weights(plant):
    """Of the places of the centre above all, and a little of the rest."""
    T, r, d = plant.basis, plant.degrees_of_freedom, len(plant.nodes)
    Q = np.diag(np.r_[np.ones(r), np.full(r, 0.1)])
    for axis in range(d):
        row = T[axis::d].mean(axis=0)
        Q[:r, :r] += 3000 * np.outer(row, row)
    return Q, np.eye(plant.B.shape[1])


def hop(plant, height, horizon, sample_time=SAMPLE, **options):
    """An NMPC that lands, stands, jumps up by a height, and lands."""
    stand = plant.nodes.copy()
    stand[-1] -= stand[-1].min() + 0.002
    high = stand.copy()
    high[-1] += height
    shapes = np.stack([stand, stand, high, high, stand], axis=-1)
    reference = tc.Reference([0.0, 0.7, 0.9, 1.0, 1.1], shapes)
    Q, R = weights(plant)
    return tc.NMPC(
        plant, horizon=horizon, sample_time=sample_time, Q=Q, R=R, reference=reference,
        winches=tc.Winches(rate=3.0, shortest=0.25, longest=1.6), **options,
    )  # fmt: skip
