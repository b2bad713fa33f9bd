"""NMPC that predicts through touching and leaving the ground, by a smooth law, on a sharp one."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import SmoothGround
from tenscontrol.plant.reduced_dynamics import explicit_substeps, sampled_dynamics
from tests.control.mpc.contact_scenes import GROUND, SAMPLE, STRINGS, STRUCTURES, hop, models


def touching(plant, seed):
    """States in which some nodes press on the ground, slide or leave it, and others do not."""
    rng, r = np.random.default_rng(seed), plant.degrees_of_freedom
    still = np.zeros_like(plant.nodes)
    down = still.copy()
    down[-1] = -plant.nodes[-1].min() + rng.uniform(-0.012, 0.004)
    q = plant.measure(plant.nodes + down, still)[:r] + 0.01 * rng.normal(size=r)
    return np.r_[q, 0.3 * rng.normal(size=r)]


@pytest.mark.parametrize(
    ("name", "input"), [("x", "rest_length"), ("d_bar", "force_density"), ("tower", "rest_length")]
)
def test_derivatives_through_contact(name, input):
    plant = STRUCTURES[name](height=0.05, input=input)
    motion, linearized = sampled_dynamics(plant, SAMPLE)
    u = plant.equilibrium_input * 0.99
    for seed in range(2):
        z = touching(plant, seed)
        parts = [np.array(part.full()) for part in linearized(z, u)]
        np.testing.assert_allclose(parts[0], motion(z, u).full(), rtol=0, atol=1e-12)
        for slope, at, other, is_state in ((parts[1], z, u, True), (parts[2], u, z, False)):
            size = np.abs(slope).max()
            h = 1e-6
            for j in range(0, len(at), max(1, len(at) // 6)):
                ends = []
                for step in (-2 * h, -h, h, 2 * h):
                    moved = at.copy()
                    moved[j] += step
                    ends.append((motion(moved, other) if is_state else motion(other, moved)).full())
                found = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
                np.testing.assert_allclose(slope[:, [j]], found, rtol=0, atol=1e-6 * size)


@pytest.mark.parametrize("name", ["x", "d_bar"])
def test_the_plan_is_linearized_as_its_prediction_is(name):
    """Products by NumPy, sample by sample, are those of the CasADi function."""
    plant = STRUCTURES[name](height=0.05)
    nmpc = tc.NMPC(plant, horizon=3, sample_time=SAMPLE)
    discretization = nmpc.law.model.discretization
    states = np.array([touching(plant, seed) for seed in range(3)])
    inputs = np.tile(plant.equilibrium_input, (4, 1))
    found = discretization.linearize(states, inputs, np.zeros((3, 0, 0)))
    for k, z in enumerate(states):
        end, by_z, by_u = (
            np.array(part.full()) for part in discretization.linearized(z, inputs[0])
        )
        np.testing.assert_allclose(found.values[k], end.ravel(), rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            found.slopes[0][k].T, by_z, rtol=0, atol=1e-10 * np.abs(by_z).max()
        )
        np.testing.assert_allclose(
            found.slopes[1][k].T, by_u, rtol=0, atol=1e-10 * np.abs(by_u).max()
        )


@pytest.mark.parametrize("name", ["x", "d_bar", "ball"])
def test_steps_are_short_enough_for_contact_also_where_the_plant_hangs(name):
    """A sample of the plant in the air, through impact, against the same law by DOP853."""
    plant = STRUCTURES[name](height=0.05)
    assert explicit_substeps(plant, SAMPLE) >= SAMPLE * plant.spectral_radius / 0.35
    motion = sampled_dynamics(plant, SAMPLE)[0]
    r = plant.degrees_of_freedom
    nodes = plant.nodes.copy()
    nodes[-1] -= 0.046
    falling = np.zeros_like(nodes)
    falling[-1] = -0.8
    run = tc.simulate(
        plant.model, 3 * SAMPLE, nodes, falling, rest_length=plant.rest_length, tolerance=1e-9,
        output_step=SAMPLE,
    )  # fmt: skip
    z = plant.measure(nodes, falling)
    for k in range(1, 4):
        z = motion(z, plant.rest_length).full().ravel()
        off = plant.to_nodes(z[:r]) - run.nodes[..., k]
        assert np.abs(off).max() < 1.5e-4 * np.ptp(nodes)


HILL = ca.SX.sym("x")
LAWS = {
    "sharp": tc.Ground(**GROUND),
    "stiff": tc.Ground(**GROUND | {"stiffness": 1e6}),
    "slippery": tc.Ground(stiffness=5e3),
    "hertz": tc.dynamics.HertzGround(**GROUND | {"stiffness": 1e5}),
    "hill": SmoothGround(**GROUND, height=ca.Function("h", [HILL], [0.05 * ca.sin(3 * HILL)])),
    "corner": [
        SmoothGround(**GROUND),
        SmoothGround(**GROUND, normal=[1.0, 0.0], height=-0.05, nodes=[0, 3]),
    ],
}


@pytest.mark.parametrize("law", list(LAWS))
def test_steps_are_short_enough_for_any_law(law):
    """A sliding, turning impact of an X, predicted over five samples, against DOP853."""
    structure = tc.library.snelson_x()
    model = tc.Model(structure, STRINGS, gravity=9.81, ground=LAWS[law])
    nodes = structure.nodes + np.array([[0.0], [0.04]])
    rest = tc.prestress(structure, force_density=40.0)
    at = tc.OperatingPoint(nodes, rest.force_density, model.constant_force)
    plant = tc.linearize(
        model, at, input="rest_length", coordinates="minimal", require_equilibrium=False
    )
    velocities = np.array([[-0.3], [-0.8]]) + 0.5 * np.array([-nodes[1], nodes[0]])
    run = tc.simulate(
        model, 5 * SAMPLE, nodes, velocities, rest_length=plant.rest_length, tolerance=1e-9,
        output_step=SAMPLE,
    )  # fmt: skip
    assert run.nodes[1].min() < 1e-3  # at the ends of samples
    motion, z = sampled_dynamics(plant, SAMPLE)[0], plant.measure(nodes, velocities)
    for k in range(1, 6):
        z = motion(z, plant.rest_length).full().ravel()
        assert np.abs(plant.to_nodes(z[:6]) - run.nodes[..., k]).max() < 1e-4


def errors_against_sharp(width, name="x"):
    """Largest distance of a node from the sharp plant's after three samples of touching, m."""
    plant = STRUCTURES[name](height=0.05, width=width)
    sharp = models(plant.model.structure)[0]
    nodes, falling = plant.nodes.copy(), np.zeros_like(plant.nodes)
    nodes[-1] -= 0.04
    falling[-1] = -0.5
    run = tc.simulate(
        sharp, 3 * SAMPLE, nodes, falling, rest_length=plant.rest_length, tolerance=1e-9,
        output_step=SAMPLE,
    )  # fmt: skip
    motion = sampled_dynamics(plant, SAMPLE)[0]
    z, worst = plant.measure(nodes, falling), 0.0
    for k in range(1, 4):
        z = motion(z, plant.rest_length).full().ravel()
        off = plant.to_nodes(z[: len(z) // 2]) - run.nodes[..., k]
        worst = max(worst, float(np.linalg.norm(off, axis=0).max()))
    return worst


@pytest.mark.parametrize("name", ["x", "ball"])
def test_the_smooth_law_comes_to_the_sharp_one_as_it_gets_narrow(name):
    errors = [errors_against_sharp(width, name) for width in (0.02, 0.01, 0.005)]
    assert errors[0] > 1.5 * errors[1] > 2.2 * errors[2]
    assert errors[2] < 1.5e-3


@pytest.mark.parametrize(("name", "width"), [("x", None), ("d_bar", 0.005)])
def test_a_structure_lands_stands_jumps_and_lands(name, width):
    """Designed in the air, where it falls, and run on the sharp law, which may also predict."""
    plant = STRUCTURES[name](height=0.1, width=width)
    sharp = models(plant.model.structure)[0]
    nmpc = hop(plant, 0.15, 15)
    run = tc.simulate(sharp, 1.5, plant.nodes, rest_length=plant.rest_length, controller=nmpc)
    assert set(nmpc.status_count) == {tc.control.Status.OK}
    low, time = run.nodes[1].min(axis=0), run.time
    standing = (time > 0.35) & (time < 0.4)
    assert np.abs(run.velocities[..., standing]).max() < 0.1
    assert -0.01 < low[standing].min() < low[standing].max() < 0.001
    flying = (time > 0.8) & (time < 1.1)
    assert low[flying].max() > 0.09
    assert -0.01 < low[time > 1.4].min() < low[time > 1.4].max() < 0.001
    error = run.control.prediction_error[1:]
    assert np.median(error) < (1e-3 if width else 1e-5)
    assert error.max() < 5e-3
    assert run.control.tracking_error[-1] < 0.01


def test_what_drifts_is_still_refused_by_linear_controllers():
    plant = STRUCTURES["x"](height=0.1)
    with pytest.raises(ValueError, match="out of reach of the strings, and grow or drift"):
        tc.MPC(plant, horizon=5, sample_time=SAMPLE)
    with pytest.raises(ValueError, match="out of reach of the strings, and grow or drift"):
        tc.LQR(plant, sample_time=SAMPLE)


def test_places_that_the_coordinates_leave_out_are_refused():
    plant = STRUCTURES["x"](height=0.1, coordinates="internal")
    with pytest.raises(ValueError, match=r"plant has internal coordinates.*model has ground"):
        tc.NMPC(plant, horizon=5, sample_time=SAMPLE)
    sensors = tc.Sensors(structure=plant.model.structure, node_position=1e-3, nodes=[0])
    with pytest.raises(ValueError, match=r"plant has internal coordinates.*model has ground"):
        tc.KalmanFilter(plant, sensors, sample_time=SAMPLE, prediction="nonlinear")


def test_derivatives_that_are_kept_are_refused():
    plant = STRUCTURES["x"](height=0.05)
    with pytest.raises(ValueError, match=r"linearization_tolerance is 0.1, and plant has ground"):
        tc.NMPC(plant, horizon=3, sample_time=SAMPLE, linearization_tolerance=0.1)


def test_ramps_are_refused():
    plant = STRUCTURES["x"](height=0.1)
    with pytest.raises(ValueError, match="winches ramp through a sample, and NMPC"):
        tc.NMPC(plant, horizon=5, sample_time=SAMPLE, winches=tc.Winches(rate=1.0, substeps=4))


def test_a_plant_without_ground_needs_no_other_steps():
    structure = tc.library.snelson_x()
    rest = tc.prestress(structure, force_density=40.0)
    plant = tc.linearize(tc.Model(structure, STRINGS), rest, input="rest_length")
    count = np.ceil(SAMPLE * plant.spectral_radius / 0.35)
    assert explicit_substeps(plant, SAMPLE) == count
    assert isinstance(sampled_dynamics(plant, SAMPLE)[0], ca.Function)
