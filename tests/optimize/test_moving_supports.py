"""Derivatives of runs whose supports move: differences of the simulator, and both ways alike."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc

TIMES = np.array([0.0, 0.075, 0.1125, 0.3])  # a start, a kink, between, and the end
GIVEN = {"tolerance": 1e-12, "method": "dop853", "output_step": 0.01, "error": "none"}
LENGTHS = 0.98 * tc.prism().string_length()


def shaken(interpolation):
    """Displacements of three feet of a prism, over time."""
    time = np.linspace(0.0, 0.3, 5)
    values = 0.04 * np.random.default_rng(5).normal(size=(3, 3, 5))
    values[:, 1:] = values[:, :1]  # bars lead from foot to foot in no prism; yet it stays whole
    values[2, 1] *= 0.5
    return tc.Profile(time, values, interpolation)


def run_of(motion, **changes):
    """A prism on feet that move, with damped strings of which some go slack, a mass on one."""
    prism = tc.prism()
    structure = tc.Structure(
        prism.nodes, prism.bars, prism.strings, prism.bar_mass + changes.get("bar_mass", 0.0),
        fixed=[0, 1, 2], point_mass=[0.0, 0.0, 0.0, 0.5, 0.0, 0.0],
    )  # fmt: skip
    strings = tc.LinearStrings(100.0 + changes.get("stiffness", 0.0), damping=1.0)
    moved = motion
    if "support_motion" in changes:
        moved = tc.Profile(
            motion.time, motion.values + changes["support_motion"], motion.interpolation
        )
    lengths = LENGTHS + changes.get("rest_length", 0.0)
    model = tc.Model(structure, strings, gravity=9.81)
    return tc.simulate(model, 0.3, rest_length=lengths, support_motion=moved, **GIVEN)


def squares(time, nodes, velocities):
    return time * ca.sumsqr(nodes) + 0.1 * ca.sumsqr(velocities)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_motions_of_supports_by_their_values(interpolation):
    motion = shaken(interpolation)
    run = run_of(motion)
    assert run.work.switches > 0
    names = ["support_motion", "rest_length", "stiffness", "bar_mass"]
    tangent = tc.sensitivity(run, names, TIMES)
    assert tangent.nodes["support_motion"].shape == (3, 6, 4, 3, 3, 5)
    random = np.random.default_rng(6)
    at = np.searchsorted(run.time, TIMES - 1e-9)
    for name, size in (("support_motion", 0.04), ("bar_mass", 0.5)):
        direction = size * random.normal(size=tangent.nodes[name].shape[3:])
        step = 1e-4
        ends = [run_of(motion, **{name: k * step * direction}) for k in (1, -1, 2, -2)]
        for quantity in ("nodes", "velocities"):
            of = [getattr(end, quantity)[:, :, at] for end in ends]
            difference = (8 * (of[0] - of[1]) - (of[2] - of[3])) / (12 * step)
            found = np.tensordot(getattr(tangent, quantity)[name], direction, direction.ndim)
            np.testing.assert_allclose(found, difference, atol=1e-6 * np.abs(difference).max())
    gradient = tc.gradient(run, squares, names, TIMES)
    by_nodes, by_velocities = 2 * TIMES * run.nodes[:, :, at], 0.2 * run.velocities[:, :, at]
    for name in names:
        wanted = np.tensordot(by_nodes, tangent.nodes[name], 3)
        wanted = wanted + np.tensordot(by_velocities, tangent.velocities[name], 3)
        np.testing.assert_allclose(gradient.slope[name], wanted, atol=1e-7 * np.abs(wanted).max())
