"""Derivatives of closed loops: differences of the loop, and both ways alike."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc

TIMES = np.array([0.125, 0.2])


def squares(time, nodes, velocities):
    return time * ca.sumsqr(nodes) + 0.1 * ca.sumsqr(velocities)


def closed_loop(bounded):
    """A law with room in all inputs, or one that is at a bound in some."""
    prism = tc.prism()
    strings = None if bounded else tc.LinearStrings(500.0, damping=1.0)
    model = tc.Model(prism, strings)
    rest = tc.prestress(prism, force_density=10.0)
    plant = tc.linearize(model, rest, input="force_density" if bounded else "rest_length")
    return tc.LQR(plant, sample_time=0.05, max_force_density=18.0 if bounded else None)


def run_of(law, rates, winches=None, **changes):
    """The loop from a shape that moves, with another gain or other rates."""
    plant, usual = law.plant, law.gain
    velocities = plant.to_velocities(np.zeros(len(rates)), rates + changes.get("more", 0.0))
    given = {"winches": winches}
    if law.input == "rest_length":
        given["rest_length"] = plant.equilibrium_input
    object.__setattr__(law, "gain", usual + changes.get("gain", 0.0))
    try:
        return tc.simulate(
            plant.model, TIMES[-1], velocities=velocities, controller=law, tolerance=1e-11,
            output_step=0.025, error="none", **given,
        )  # fmt: skip
    finally:
        object.__setattr__(law, "gain", usual)


@pytest.mark.parametrize("bounded", [False, True])
def test_commands_answer_changes_of_the_motion_and_of_the_gain(bounded):
    random, law = np.random.default_rng(3), closed_loop(bounded)
    rates = 0.3 * random.normal(size=law.plant.coordinates.count)
    run = run_of(law, rates)
    assert (run.control.at_bound.any()) == bounded
    names = ["gain", "velocities"]
    tangent = tc.sensitivity(run, names, TIMES, feedback=True)
    moved = 0.1 * random.normal(size=len(rates))
    along = law.plant.to_velocities(np.zeros(len(rates)), moved)
    change = 0.1 * np.abs(law.gain).max() * random.normal(size=law.gain.shape)
    for name, key, direction, by in (
        ("velocities", "more", moved, along), ("gain", "gain", change, change)
    ):  # fmt: skip
        ends = [
            run_of(law, rates, **{key: k * 3e-4 * direction}).nodes[:, :, -1]
            for k in (1, -1, 2, -2)
        ]
        difference = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * 3e-4)
        found = np.tensordot(tangent.nodes[name][:, :, -1], by, 2)
        np.testing.assert_allclose(found, difference, atol=1e-7 * np.abs(found).max())
    slope = tc.gradient(run, squares, names, TIMES, feedback=True).slope
    at = np.searchsorted(run.time, TIMES - 1e-9)
    by_nodes, by_velocities = 2 * TIMES * run.nodes[:, :, at], 0.2 * run.velocities[:, :, at]
    for name in names:
        wanted = np.tensordot(by_nodes, tangent.nodes[name], 3)
        wanted = wanted + np.tensordot(by_velocities, tangent.velocities[name], 3)
        np.testing.assert_allclose(slope[name], wanted, atol=1e-8 * np.abs(wanted).max())


def test_feedback_that_is_not_differentiated_is_refused():
    law = closed_loop(False)
    rates = np.full(law.plant.coordinates.count, 0.1)
    run = run_of(law, rates)
    with pytest.raises(ValueError, match="the gain acts by feedback: give feedback=True"):
        tc.sensitivity(run, ["gain"])
    slow = tc.Winches(rate=1e-3)
    limited = run_of(law, 3 * rates, slow)
    with pytest.raises(ValueError, match="at 0 s the strings are not given what the LQR commands"):
        tc.sensitivity(limited, ["velocities"], feedback=True)
    free = tc.simulate(law.plant.model, 0.1, rest_length=law.plant.equilibrium_input)
    with pytest.raises(ValueError, match="feedback is that of an LQR, but the run is in open loop"):
        tc.sensitivity(free, ["velocities"], feedback=True)
