"""The closed loop with a plant that varies: against simulations by hand and closed forms."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tests.robustness import cases
from tests.robustness.cases import Inline, loop_case

STEP, DURATION = 5e-3, 0.6
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def strings():
    return tc.LinearStrings(100.0, damping=0.5)


@pytest.fixture(scope="module")
def plant(prism, strings):
    rest = tc.prestress(prism, force_density=17.320508)
    return tc.linearize(tc.Model(prism, strings=strings), rest, input="rest_length")


@pytest.fixture(scope="module")
def regulator(plant):
    Q, R = tc.energy_weights(plant)
    return tc.LQR(plant, Q, 0.1 * R, sample_time=0.02)


@pytest.fixture(scope="module")
def case(prism, strings, regulator):
    return loop_case(prism, strings, regulator, DURATION, STEP, tolerance=0.02)


def test_it_is_the_simulation_of_the_varied_plant(case, prism, plant, regulator):
    mass, stiffness = np.array([0.8, 1.0, 1.2]), np.linspace(0.7, 1.3, 9)
    q = np.linspace(-0.01, 0.01, 9)
    drawn = {"bar_mass": mass, "stiffness": stiffness, "damping": 2.0, "start": q}
    figures = case(drawn, RNG).figures
    varied = tc.Structure(prism.nodes, prism.bars, prism.strings, mass)
    law = tc.LinearStrings(100.0 * stiffness, damping=1.0)
    run = tc.simulate(
        tc.Model(varied, strings=law), DURATION, plant.to_nodes(q), controller=regulator, step=STEP
    )
    assert figures["least_force_density"] == run.force_density.min()
    assert figures["largest_force_density"] == run.force_density.max()
    assert figures["largest_command"] == run.control.command.max()
    last = plant.measure(run.nodes[..., -1], run.velocities[..., -1])[:9]
    off = np.linalg.norm(plant.to_nodes(last) - prism.nodes, axis=0).max()
    assert figures["final_error"] >= off > 0.01


def test_strings_that_are_all_stiffer_hold_the_same_shape(case):
    # Every force grows alike, so that the balance stays.
    nominal, stiffer = (case({"stiffness": k}, RNG).figures for k in (1.0, 1.3))
    assert nominal["final_error"] < 1e-9
    assert stiffer["final_error"] < 1e-9
    ratio = stiffer["largest_force_density"] / nominal["largest_force_density"]
    assert ratio == pytest.approx(1.3, rel=1e-9)


def test_a_motion_as_one_body_is_no_error(prism, strings, regulator):
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = turn @ prism.nodes + np.array([[1.0], [2], [3]])
    elsewhere = loop_case(prism, strings, regulator, DURATION, STEP, 0.02, nodes=moved)
    assert elsewhere({}, RNG).figures["final_error"] < 1e-9
    target = loop_case(prism, strings, regulator, DURATION, STEP, 0.02, target=moved)
    assert target({}, RNG).figures["final_error"] < 1e-9


def test_another_target_is_missed_by_the_distance(plant, prism, strings, regulator):
    wanted = plant.to_nodes(np.r_[0.05, np.zeros(8)])
    case = loop_case(prism, strings, regulator, DURATION, STEP, 0.02, target=wanted)
    outcome = case({}, RNG)
    distance = np.linalg.norm(wanted - prism.nodes, axis=0).max()
    assert outcome.figures["final_error"] == pytest.approx(distance, rel=1e-6)
    assert not outcome.success


def test_weights_go_with_the_masses(prism, strings, regulator):
    # All bodies fall alike, whatever they weigh: none is left behind the others.
    falling = loop_case(prism, strings, regulator, 0.2, STEP, 0.02, gravity=9.81)
    assert falling({"bar_mass": [0.5, 1.0, 2.0]}, RNG).figures["final_error"] < 1e-9


def test_what_is_wrong_with_a_draw_is_named(case):
    with pytest.raises(
        tc.robustness.SweepError, match="no parameter 'mass', expected some of 'bar_mass'"
    ):
        case({"mass": 1.0}, RNG)
    with pytest.raises(ValueError, match=r"bar_mass\[0\] is -1"):
        case({"bar_mass": -1.0}, RNG)
    with pytest.raises(ValueError, match=r"stiffness has shape \(3,\), expected \(\) or \(9,\)"):
        case({"stiffness": np.ones(3)}, RNG)


def test_strings_without_the_parameter_stop_the_sweep(prism):
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 17.32))
    regulator = tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.02, max_force_density=60.0)
    case = loop_case(prism, None, regulator, DURATION, STEP, 0.02)
    assert case({"bar_mass": 1.1}, RNG).success
    with pytest.raises(
        tc.robustness.SweepError, match="stiffness is drawn, but the strings have none: None"
    ):
        case({"stiffness": 1.1}, RNG)


def test_a_motion_that_runs_away_or_is_inaccurate_is_a_failure(prism, strings, regulator):
    coarse = loop_case(prism, strings, regulator, DURATION, 0.02, 0.02)
    drawn = {"stiffness": tc.OneOf([1.0, 1e5]), "start": tc.Normal(0.0, 0.01, size=9)}
    found = tc.sweep(coarse, drawn, 6, seed=0, executor=Inline())
    stiff = found.parameters["stiffness"] > 1
    assert 0 < stiff.sum() < 6
    assert np.array_equal(found.completed, ~stiff)
    assert {failure.error for failure in found.failures} == {"SimulationError"}


@pytest.mark.parametrize("kind", [tc.MPC, tc.NMPC])
def test_a_pickled_mpc_commands_what_a_new_one_does(prism, strings, plant, kind):
    made = [
        kind(plant, horizon=6, sample_time=0.04, max_force_density=65.0, load_gain=0.3)
        for _ in range(2)
    ]
    case = loop_case(prism, strings, made[0], DURATION, STEP, 0.02)
    case({"start": np.full(9, 0.01)}, RNG)  # leaves something in OSQP
    loaded = pickle.loads(pickle.dumps(case))
    draw = {"stiffness": np.linspace(0.8, 1.2, 9)}
    fresh = loop_case(prism, strings, made[1], DURATION, STEP, 0.02)
    assert loaded(draw, RNG).figures == fresh(draw, RNG).figures


@pytest.fixture(scope="module")
def watched(prism, strings, plant, regulator):
    """The regulator on what a filter makes of readings."""
    sensors = tc.Sensors(structure=prism, string_length=1e-3, bar_direction=[5e-3, 6e-3, 7e-3])
    estimator = tc.KalmanFilter(plant, sensors, sample_time=0.02)
    return loop_case(prism, strings, regulator, 0.2, STEP, tolerance=0.02, estimator=estimator)


def test_noise_and_delay_are_those_of_the_true_sensors(watched, prism, strings, regulator):
    figures = watched({"noise": 2.0, "delay": 3.0}, np.random.default_rng(8)).figures
    true = tc.Sensors(
        structure=prism, string_length=2e-3, bar_direction=[1e-2, 1.2e-2, 1.4e-2], delay=3
    )
    run = tc.simulate(
        tc.Model(prism, strings=strings), 0.2, controller=regulator, step=STEP,
        estimator=watched.scene.estimator, sensors=true,
        seed=int(np.random.default_rng(8).integers(2**63)),
    )  # fmt: skip
    assert figures["largest_command"] == run.control.command.max()
    assert figures["least_force_density"] == run.force_density.min()
    assert watched.scene.estimator.sensors.delay == 0  # it believes what it did


def test_noise_is_that_of_the_run_alone(watched):
    drawn = {"noise": tc.Uniform(0.5, 2.0), "delay": tc.OneOf([0, 1])}
    whole, part = (tc.sweep(watched, drawn, n, seed=1, executor=Inline()) for n in (4, 3))
    assert whole.completed.all()
    assert whole._records[:3] == part._records
    same = tc.sweep(watched, {}, 2, seed=1, executor=Inline()).figure("largest_command")
    assert same[0] != same[1]


def test_sensors_of_ones_own_are_those_that_vary(watched):
    own = replace(watched.scene.estimator.sensors, delay=2)
    late = replace(watched, scene=replace(watched.scene, sensors=own))
    two, drawn = (case(given, np.random.default_rng(0)).figures
                  for case, given in ((late, {}), (watched, {"delay": 2})))  # fmt: skip
    assert two == drawn


def test_draws_that_no_sensor_can_have_stop_the_sweep(case, watched):
    for name in ("noise", "delay"):
        with pytest.raises(
            tc.robustness.SweepError, match=f"{name} is drawn, but nothing is measured"
        ):
            case({name: 1.0}, RNG)
    for late in (0.5, -1.0, np.ones(2)):
        with pytest.raises(
            tc.robustness.SweepError, match="expected whole samples, at least 0: draw it by"
        ):
            watched({"delay": late}, RNG)
    with pytest.raises(ValueError, match="noise is 0"):
        watched({"noise": 0.0}, RNG)


def test_faults_are_those_of_each_run(prism, strings, regulator):
    cut = loop_case(
        prism, strings, regulator, 0.2, STEP, 0.02, faults=[tc.CutString(string=0, time=0.1)]
    )
    assert cut({}, RNG).figures["least_force_density"] == 0.0


def test_an_estimate_of_the_load_makes_up_for_wrong_stiffness(prism, strings, plant, regulator):
    """What the sweep is for: strings that are not as stiff as the controller was told."""
    mpc = tc.MPC(plant, horizon=8, sample_time=0.04, max_force_density=65.0, load_gain=0.3)
    drawn = {"stiffness": tc.Uniform(0.7, 1.3, size=9), "bar_mass": tc.Uniform(0.8, 1.2, size=3)}
    rates = []
    for controller in (regulator, mpc):
        case = loop_case(prism, strings, controller, 2.0, 1e-2, tolerance=0.01)
        rates.append(tc.sweep(case, drawn, 4, seed=3, executor=Inline()))
    assert rates[0].success_rate < 0.3
    assert rates[1].success_rate == 1.0
    assert np.array_equal(rates[0].parameters["stiffness"], rates[1].parameters["stiffness"])


# ---- functions as controllers ----


def own(controller=cases.damper, **changes):
    """A tower of class 2 under a function."""
    strings = tc.LinearStrings(1000.0, damping=0.5)
    settings = {"duration": 0.2, "step": STEP, "tolerance": 0.3, "sample_time": 0.02}
    settings |= {"rest_length": cases.LENGTH, **changes}
    return loop_case(cases.TOWER, strings, controller, **settings)


def test_a_function_is_run_as_simulate_does():
    case, drawn = own(), {"stiffness": 1.2}
    figures = case(drawn, RNG).figures
    model = tc.Model(cases.TOWER, strings=tc.LinearStrings(1200.0, damping=0.5))
    run = tc.simulate(
        model, 0.2, controller=cases.damper, sample_time=0.02, rest_length=cases.LENGTH, step=STEP
    )
    late = run.nodes[:, :, run.time >= 0.9 * run.time[-1]]
    off = np.linalg.norm(late - cases.TOWER.nodes[:, :, None], axis=0).max()
    # Supports leave no motion as one body; the coordinates make the bars of RK4 exact.
    assert figures["final_error"] == pytest.approx(off, rel=1e-3)
    assert figures["largest_command"] == run.control.command.max()


def test_a_target_and_a_start_need_no_plant():
    moved = own(target=cases.TOWER.nodes)
    assert moved({}, RNG).figures == own()({}, RNG).figures
    started = own()({"start": np.full(12, 1e-3)}, RNG)
    assert started.figures != own()({}, RNG).figures
    with pytest.raises(ValueError, match=r"target\b.*bar 0"):
        own(target=1.1 * cases.TOWER.nodes)


def test_a_sweep_of_a_function_goes_on_from_its_file(tmp_path):
    file = tmp_path / "sweep.jsonl"
    drawn = {"stiffness": tc.Uniform(0.8, 1.2)}
    first = tc.sweep(own(), drawn, 2, seed=0, executor=Inline(), file=file)
    more = tc.sweep(own(), drawn, 4, seed=0, executor=Inline(), file=file)
    whole = tc.sweep(own(), drawn, 4, seed=0, executor=Inline())
    assert more.figures.keys() == whole.figures.keys()
    for name, values in whole.figures.items():
        np.testing.assert_array_equal(values, more.figures[name])
        np.testing.assert_array_equal(values[:2], first.figures[name])


def test_a_function_that_raises_is_a_failure_of_its_run():
    def law(time, nodes, velocities):
        if time > 0.1:
            raise ZeroDivisionError("by my own fault")
        return cases.LENGTH

    with pytest.raises(tc.simulation.SimulationError, match="law raised ZeroDivisionError"):
        own(law)({}, RNG)


def test_a_lambda_cannot_be_pickled():
    case = own(lambda time, nodes, velocities: cases.LENGTH)
    assert case({}, RNG).success  # alone it runs
    with pytest.raises(TypeError, match=r"case cannot be pickled.*lambda.*top of a module"):
        tc.sweep(case, {"stiffness": tc.Uniform(0.8, 1.2)}, 2, seed=0, executor=Inline())
