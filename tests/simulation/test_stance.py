"""Controllers for a stance on the full model: all nodes free, on the ground."""

from functools import cache

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Status

GRAVITY = 9.81


@cache
def scene(name):
    """The model on the ground, its stance, and the plant that stands on its feet."""
    ground = tc.Ground(5e4, damping=0.3, friction=0.8, slip_speed=1e-2)
    if name == "ball":
        structure, feet, level = tc.library.six_bar_ball(1.0), [0, 4, 8], 50.0
    else:
        structure, feet, level = tc.library.class2_tower(floating=True), [0, 1, 2], 30.0
    strings = tc.LinearStrings(1e3, damping=2.0)
    model = tc.Model(structure, strings=strings, gravity=GRAVITY, ground=ground)
    rest = tc.prestress(structure, min_force_density=level)
    lengths = tc.to_rest_length(model, structure.nodes, rest.force_density).rest_length
    start = tc.plant.set_down(model, feet)
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start, settle=True)
    return model, stance, tc.linearize(model, stance, input="rest_length"), lengths


def controller(plant, kind, **more):
    """A controller so gentle that no foot is lifted."""
    Q, R = tc.energy_weights(plant)
    if kind == "lqr":
        return tc.LQR(plant, Q, 1e3 * R, sample_time=0.01)
    settings = {"horizon": 10, "sample_time": 0.02, "Q": Q, "R": 1e3 * R} | more
    return {"mpc": tc.MPC, "nmpc": tc.NMPC}[kind](plant, **settings)


def ground_force(model, nodes, velocities):
    """Forces of the ground on all nodes, N, by the law alone."""
    symbols = [ca.SX.sym(name, *nodes.shape) for name in ("N", "V")]
    force = ca.Function("force", symbols, [model.contacts.on_nodes(*symbols)])
    return np.array(force(nodes, velocities).full())


@pytest.mark.parametrize(("name", "kind"), [("tower", "lqr"), ("ball", "mpc")])
def test_a_push_is_brought_back(name, kind):
    model, stance, plant, lengths = scene(name)
    r, nodes = plant.degrees_of_freedom, stance.structure.nodes
    push = plant.to_velocities(np.zeros(r), 0.05 * np.random.default_rng(0).normal(size=r))
    run = tc.simulate(
        model, 1.5, nodes, push, controller=controller(plant, kind), rest_length=lengths,
        step=5e-4, error="none",
    )  # fmt: skip
    assert set(run.control.status_count) == {Status.OK}
    off = np.linalg.norm(run.nodes - nodes[:, :, None], axis=0)
    size = float(np.ptp(nodes, axis=1).max())
    assert off.max() > 3e-3 * size
    assert off[:, -1].max() < 1e-3 * size
    # Feet sink and creep by much less, and end with the forces of the stance.
    assert 1e-6 < off[plant.feet].max() < 5e-4
    force = ground_force(model, run.nodes[:, :, -1], run.velocities[:, :, -1])
    np.testing.assert_allclose(force[2, plant.feet], stance.contacts.normal_force, rtol=5e-3)
    assert np.delete(force, plant.feet, axis=1).max() == 0


@pytest.mark.parametrize(("name", "kind"), [("tower", "mpc"), ("ball", "nmpc")])
def test_a_node_is_moved_by_a_twentieth_of_the_size(name, kind):
    model, stance, plant, lengths = scene(name)
    nodes, r = stance.structure.nodes, plant.degrees_of_freedom
    size, top = float(np.ptp(nodes, axis=1).max()), int(nodes[2].argmax())
    wanted = np.array([0.6, 0.0, -0.8]) * 0.05 * size
    # By the least change of rest lengths that moves the top so far, to first order.
    rests = plant.basis @ np.linalg.solve(-plant.A[r:, :r], plant.B[r:])
    change = np.linalg.pinv(rests[3 * top : 3 * top + 3]) @ wanted
    goal = stance
    for part in (0.5, 1.0):
        goal = tc.equilibrium(
            model, rest_length=lengths + part * change, nodes=goal.structure.nodes
        )
    there = goal.structure.nodes
    assert np.linalg.norm(there[:, top] - nodes[:, top]) == pytest.approx(0.05 * size, rel=0.05)
    reference = tc.Reference(
        [0.0, 1.0], np.stack([nodes, there], axis=-1),
        np.column_stack([stance.force_density, goal.force_density]),
    )  # fmt: skip
    run = tc.simulate(
        model, 2.5, nodes, controller=controller(plant, kind, reference=reference),
        rest_length=lengths, step=5e-4, output_step=0.1,
        limits=tc.HealthLimits(position_error=0.05), error="none",
    )  # fmt: skip
    off = np.linalg.norm(run.nodes[:, top, -1] - there[:, top])
    assert off < 0.01 * size


def test_a_foot_that_has_left_its_place_is_reported():
    _, stance, plant, _ = scene("ball")
    nodes, still = stance.structure.nodes, np.zeros(stance.structure.nodes.shape)
    lqr = controller(plant, "lqr")
    for part, status in ((0.05, Status.OK), (0.15, Status.MEASUREMENT_NOT_PLAUSIBLE)):
        shift = part * np.ptp(nodes, axis=1).max() * np.c_[[1.0, 0.0, 0.0]]
        assert lqr.command(0.0, nodes + shift, still).status is status


def test_only_ground_may_take_the_place_of_supports():
    model, stance, plant, _ = scene("ball")
    lqr = controller(plant, "lqr")
    bare = tc.Model(model.structure, strings=model.strings, gravity=GRAVITY)
    with pytest.raises(ValueError, match="fixed nodes"):
        tc.simulate(bare, 0.1, stance.structure.nodes, controller=lqr, error="none")
    # On its supports it runs as well.
    run = tc.simulate(plant.model, 0.05, controller=lqr, step=1e-3, error="none")
    np.testing.assert_allclose(run.nodes[:, :, -1], stance.structure.nodes, atol=1e-9)


def test_a_damped_drop_ends_in_the_stance():
    """On a slope. No mechanism moves, but friction, rounded at rest, lets the prism creep down."""
    prism, slip = tc.prism(diagonals=True), 1e-2
    turn, nodes = np.radians(-15.0), prism.nodes.copy()
    nodes[:2, :3] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]] @ nodes[:2, :3]
    structure = tc.Structure(nodes, prism.bars, prism.strings, 1.0)
    angle = np.radians(5.0)
    up = np.c_[[np.sin(angle), 0.0, np.cos(angle)]]
    down = np.c_[[np.cos(angle), 0.0, -np.sin(angle)]]
    ground = tc.Ground(5e4, damping=3.0, friction=0.5, slip_speed=slip, normal=up.ravel())
    strings = tc.LinearStrings(1e3, damping=40.0)
    model = tc.Model(structure, strings=strings, gravity=GRAVITY, ground=ground)
    rest = tc.prestress(structure, min_force_density=20.0)
    lengths = tc.to_rest_length(model, nodes, rest.force_density).rest_length
    start = tc.plant.set_down(model, [3, 4, 5])
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start, settle=True)
    there = stance.structure.nodes
    run = tc.simulate(
        model, 2.0, there + 0.01 * up, rest_length=lengths, step=5e-4, output_step=0.5
    )
    end, speed = run.nodes[:, :, -1], run.velocities[:, :, -1]
    distance = [np.linalg.norm(N[:, :, None] - N[:, None], axis=0) for N in (end, there)]
    np.testing.assert_allclose(*distance, atol=2e-5)
    np.testing.assert_allclose(up.T @ end, up.T @ there, atol=1e-5)
    force = up.T @ ground_force(model, end, speed)
    np.testing.assert_allclose(force[0, 3:], stance.contacts.normal_force, rtol=1e-3)
    use = np.tan(angle) / 0.5
    np.testing.assert_allclose(stance.contacts.cone_use, use, atol=1e-6)
    np.testing.assert_allclose(
        speed, np.tile(down * slip * use / np.sqrt(1 - use**2), 6), atol=1e-5
    )


@pytest.mark.parametrize("of", ["structure", "plant"])
def test_sensors_of_the_structure_estimate_a_stance_on_its_feet(of):
    """Feet are fixed nodes to the plant alone: the readings are the same."""
    model, stance, plant, lengths = scene("ball")
    structure = model.structure if of == "structure" else plant.model.structure
    sensors = tc.Sensors(structure=structure, string_length=1e-4, node_position=1e-4)
    estimator = tc.KalmanFilter(plant, sensors, sample_time=0.01)
    run = tc.simulate(
        model, 0.2, stance.structure.nodes, controller=controller(plant, "lqr"),
        estimator=estimator, rest_length=lengths, step=1e-3, error="none",
    )  # fmt: skip
    off = run.control.estimate.nodes - run.nodes[:, :, :-1:10]
    assert np.linalg.norm(off, axis=0).max() < 2e-3


def test_sensors_of_another_structure_are_refused_with_what_differs():
    _, _, plant, _ = scene("ball")
    known = plant.model.structure
    for other, what in (
        (tc.Structure(known.nodes, known.bars, known.strings[::-1], 1.0), "other strings"),
        (
            tc.Structure(known.nodes, known.bars, known.strings, 1.0, fixed=[0, 1]),
            r"other supports, at the nodes \[1\] and \[\]",
        ),
        (tc.prism(), "6 and 12 nodes"),
    ):
        sensors = tc.Sensors(structure=other, node_position=1e-3)
        with pytest.raises(ValueError, match=f"sensors .* {what}: give Sensors"):
            tc.KalmanFilter(plant, sensors, sample_time=0.01)
