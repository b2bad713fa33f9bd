"""Controllers and filters where bars share nodes, in the plane, on rollers, with clusters."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.plant.joined import SCENES, arm, at_rest, d_bar, oracle, spine, tower

SAMPLE = 0.01
LAW = tc.LinearStrings(stiffness=300.0, damping=2.0)
STRUCTURES = {"d_bar": d_bar(), "arm": arm(), "tower": tower(), "spine": spine(1)}


def plant_of(structure, held="rest_length", law=LAW, **options):
    model, at = at_rest(structure, strings=law)
    return tc.linearize(model, at, input=held, **options)


def pushed(plant, size=0.03):
    r = plant.degrees_of_freedom
    return plant.to_nodes(size * np.random.default_rng(2).uniform(-1, 1, r) / np.sqrt(r))


def settled(run, plant, goal=None):
    goal = plant.nodes if goal is None else goal
    return np.abs(run.nodes[:, :, -1] - goal).max() / np.ptp(plant.nodes)


@pytest.mark.parametrize(
    ("name", "held"),
    [*((name, "rest_length") for name in STRUCTURES), ("tower", "force_density")],
)  # fmt: skip
def test_lqr_brings_the_nonlinear_plant_to_rest(name, held):
    structure = STRUCTURES[name]
    plant = plant_of(structure, held, LAW if held == "rest_length" else None)
    assert tc.controllability(plant).is_controllable
    law = tc.LQR(plant, sample_time=SAMPLE)
    assert np.abs(law.poles).max() < 1
    run = tc.simulate(plant.model, 5.0, controller=law, nodes=pushed(plant), output_step=SAMPLE)
    assert settled(run, plant) < 1e-3
    lengths = np.linalg.norm(structure.bar_vectors(run.nodes[:, :, -1]), axis=0)
    np.testing.assert_allclose(lengths, structure.bar_length, rtol=1e-12)


@pytest.mark.parametrize("name", ["d_bar", "arm"])
def test_mpc_follows_a_shape_by_winches(name):
    plant = plant_of(STRUCTURES[name])
    goal = pushed(plant, 0.04)
    winches = tc.Winches(rate=2.0, shortest=0.01, ramp=True)
    mpc = tc.MPC(plant, horizon=10, sample_time=SAMPLE, reference=goal, winches=winches)
    run = tc.simulate(
        plant.model, 1.5, controller=mpc, winches=winches, rest_length=plant.rest_length,
        output_step=SAMPLE,
    )  # fmt: skip
    away = np.abs(goal - plant.nodes).max() / np.ptp(plant.nodes)
    assert settled(run, plant, goal) < 0.1 * away
    assert set(run.control.status_count) == {"ok"}


@pytest.mark.parametrize("name", ["d_bar", "free_d_bar", "arm", "random_2d_1", "random_3d_2"])
def test_the_prediction_of_a_sample_is_that_of_the_oracle(name):
    from scipy.integrate import solve_ivp

    structure = SCENES[name]
    model, at = at_rest(structure)
    plant = tc.linearize(model, at, coordinates="minimal")
    r, rows = plant.degrees_of_freedom, structure.free_rows
    random = np.random.default_rng(4)
    z, u = 0.01 * random.uniform(-1, 1, 2 * r), at.force_density + random.uniform(0, 1)

    def slope(time, x):
        nodes, velocities = structure.nodes.copy(), np.zeros_like(structure.nodes)
        d = structure.dimension
        nodes[rows % d, rows // d], velocities[rows % d, rows // d] = np.split(x, 2)
        return np.r_[x[len(rows) :], oracle(structure, nodes, velocities, u, at.external_force)]

    both = plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:])
    start = np.concatenate([part.ravel(order="F")[rows] for part in both])
    end = solve_ivp(slope, (0, 2e-3), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    predicted = np.array(tc.plant.reduced_dynamics.sampled_dynamics(plant, 2e-3)[0](z, u)).ravel()
    columns = np.zeros((2, structure.nodes.size))
    columns[0] = structure.nodes.ravel(order="F")
    columns[:, rows] = np.split(end, 2)
    nodes, velocities = (each.reshape(structure.nodes.shape, order="F") for each in columns)
    np.testing.assert_allclose(predicted, plant.measure(nodes, velocities), rtol=0, atol=1e-9)


def test_nmpc_and_feedback_linearization_reach_a_shape_in_the_plane():
    structure = d_bar()
    model = tc.Model(structure)
    plant = tc.linearize(model, tc.OperatingPoint(structure.nodes, [20.0, 20.0]))
    goal = plant.to_nodes([0.25])
    options = {"sample_time": 0.02, "max_force_density": 80.0, "reference": goal}
    controllers = [
        tc.NMPC(plant, horizon=10, **options),
        tc.FeedbackLinearization(plant, frequency=1.0, **options),
    ]
    for controller in controllers:
        run = tc.simulate(model, 3.0, controller=controller, output_step=0.02)
        off = np.abs(run.nodes[:, :, -1] - goal).max()
        # Without any stiffness, the default weights of NMPC take a radian per second.
        assert off < (1e-6 if controller is controllers[1] else 0.02)


def test_implicit_steps_of_stiff_strings_where_bars_share_nodes():
    """Radau IIA, its Newton steps and its derivatives, with ramps."""
    plant = plant_of(arm(), law=tc.LinearStrings(stiffness=1e5))
    nmpc = tc.NMPC(plant, horizon=5, sample_time=0.02, winches=tc.Winches(ramp=True))
    command = nmpc.command(0.0, pushed(plant, 1e-4), np.zeros_like(plant.nodes))
    assert str(command) == "ok"


@pytest.mark.parametrize(("name", "prediction"), [("arm", "linear"), ("d_bar", "nonlinear")])
def test_a_filter_finds_the_shape(name, prediction):
    structure = STRUCTURES[name]
    plant = plant_of(structure)
    sensors = tc.Sensors(structure=structure, string_length=1e-3, node_position=1e-2,
                         bar_direction=1e-2, outlier_rate=0.05)  # fmt: skip
    estimator = tc.KalmanFilter(plant, sensors, sample_time=SAMPLE, prediction=prediction)
    law = tc.LQR(plant, sample_time=SAMPLE)
    run = tc.simulate(
        plant.model, 1.0, controller=law, estimator=estimator, nodes=pushed(plant),
        output_step=SAMPLE, seed=1,
    )  # fmt: skip
    assert settled(run, plant) < 5e-3
    assert estimator.statistics.restarts == 0


def test_a_node_off_its_roller_is_not_plausible():
    plant = plant_of(d_bar())
    law = tc.LQR(plant)
    nodes = plant.nodes.copy()
    still = np.zeros_like(nodes)
    assert str(law.command(0.0, nodes, still)) == "ok"
    nodes[1, 2] += 0.5 * np.ptp(nodes)  # along y, which its roller holds
    command = law.command(0.0, nodes, still)
    assert "plausible" in str(command)


def test_motions_that_no_string_reaches_are_refused_by_name():
    """A rhombus in space folds about its diagonals: no string changes its length."""
    flat = d_bar()
    nodes = np.vstack([flat.nodes, np.zeros(4)])
    structure = tc.Structure(nodes, flat.bars, flat.strings, 1.0)
    model = tc.Model(structure, strings=LAW)
    plant = tc.linearize(model, tc.OperatingPoint(nodes, [5.0, 5.0]), input="rest_length")
    assert tc.controllability(plant).unreachable > 0
    with pytest.raises(ValueError, match="out of reach of the strings"):
        tc.LQR(plant)


def test_a_law_in_force_densities_with_rest_lengths_held():
    from tenscontrol.control import held_loop

    plant = plant_of(arm(), "force_density")
    law = tc.LQR(plant, sample_time=SAMPLE)
    found = held_loop(plant, law.gain, sample_time=SAMPLE)
    assert found.designed_radius == pytest.approx(np.abs(law.poles).max(), rel=1e-9)
