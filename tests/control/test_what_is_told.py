"""What controllers tell: predictions that failed, tracking errors, runs that end elsewhere."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Command, Controller, ControlWarning, Status
from tenscontrol.simulation import AccuracyWarning
from tests.known_structures import lowered

SAMPLE = 0.02
STILL = np.zeros((3, 6))


@cache
def model(stiffness=100.0):
    return tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness))


@cache
def plant(input="rest_length", stiffness=100.0):
    return tc.linearize(model(stiffness), tc.prestress(tc.prism(), 17.3205), input=input)


def law(kind, input="rest_length", **settings):
    settings = {"horizon": 8, "sample_time": SAMPLE, "max_force_density": 60.0} | settings
    return kind(plant(input), **settings)


# ---- the prediction of the first step ----


@pytest.mark.parametrize("kind", [tc.MPC, tc.NMPC])
@pytest.mark.parametrize("input", ["rest_length", "force_density"])
def test_the_prediction_error_is_that_of_the_plan_on_the_plant(kind, input):
    """Against the exact sample of the linear plant, or steps of the nonlinear one."""
    controller = law(kind, input)
    start = plant(input).to_nodes(0.02 * np.random.default_rng(0).normal(size=9))
    run = tc.simulate(model(), 0.4, start, controller=controller, step=1e-3, input=input)
    error = run.control.prediction_error
    assert error.shape == (20,)
    assert np.isnan(error[0])
    if kind is tc.NMPC:
        assert np.nanmax(error) < 3e-5
        return
    transition, by_input, _ = plant(input).discretize(SAMPLE)
    at = [int(np.argmin(np.abs(run.time - SAMPLE * k))) for k in range(20)]
    for k in (1, 7, 19):
        before, now = (
            plant(input).measure(run.nodes[:, :, i], run.velocities[:, :, i])
            for i in at[k - 1 : k + 1]
        )
        v = run.control.command[:, k - 1] - plant(input).equilibrium_input
        off = plant(input).basis @ (now - transition @ before - by_input @ v)[:9]
        assert error[k] == pytest.approx(np.linalg.norm(off.reshape(6, 3), axis=1).max(), rel=1e-6)


def test_there_is_no_prediction_error_where_nothing_was_predicted():
    mpc = law(tc.MPC)
    nodes = plant().nodes
    mpc.command(0.0, nodes, STILL)
    assert mpc.prediction_error is None
    mpc.command(SAMPLE, nodes, STILL)
    assert mpc.prediction_error < 1e-6
    mpc.command(2 * SAMPLE, np.full((3, 6), np.nan), STILL)
    assert mpc.prediction_error is None
    mpc.command(3 * SAMPLE, nodes, STILL)
    assert mpc.prediction_error is None
    mpc.command(4 * SAMPLE, nodes, STILL)
    assert mpc.prediction_error < 1e-6
    mpc.reset()
    mpc.command(5 * SAMPLE, nodes, STILL)
    assert mpc.prediction_error is None
    assert tc.LQR(plant()).prediction_error is None


# ---- the summary ----


def test_the_summary_says_how_the_controller_did():
    start = plant().to_nodes(0.03 * np.random.default_rng(1).normal(size=9))
    mpc = law(tc.MPC, reference=lowered(0.95), horizon=12)
    run = tc.simulate(model(), 2.0, start, controller=mpc, step=1e-3)
    record = run.control
    assert record.tracking_error.shape == (101,)
    # The reference is a shape: the turn and the place of the plant do not count.
    at = plant().coordinates
    shape = at.laid_over(run.nodes[:, :, -1], STILL)[0]
    wanted = at.laid_over(lowered(0.95), STILL)[0]
    off = np.linalg.norm(shape - wanted, axis=0).max()
    assert record.tracking_error[-1] == pytest.approx(off, abs=1e-9)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    again = law(tc.MPC, reference=turned @ lowered(0.95) + 3.0, horizon=12)
    other = tc.simulate(model(), 2.0, turned @ start - 5.0, controller=again, step=1e-3)
    np.testing.assert_allclose(other.control.tracking_error, record.tracking_error, atol=1e-7)
    text = record.summary()
    for part in ("MPC(", "100 of 0.02 s: 100 ok", "m at the end", "m rms", "% of a sample"):
        assert part in text


def test_commands_at_a_bound_are_counted():
    winches = tc.Winches(rate=0.02)
    mpc = law(tc.MPC, winches=winches, max_force_density=None, reference=lowered(0.95))
    begin = plant().equilibrium_input
    run = tc.simulate(model(), 0.2, controller=mpc, winches=winches, rest_length=begin, step=1e-3)
    change = np.abs(np.diff(run.control.command, axis=1, prepend=begin[:, None]))
    np.testing.assert_array_equal(
        run.control.at_bound[1:], (change >= 0.02 * SAMPLE * (1 - 1e-6)).sum(axis=0)[1:]
    )
    assert run.control.at_bound.max() > 0
    assert "at a bound" in run.control.summary()


# ---- runs that end elsewhere ----


class Away(Controller):
    """Holds a shape that is not the one that it says, or says none."""

    says = True

    def __init__(self):
        super().__init__(plant(), SAMPLE, np.zeros(9), np.full(9, np.inf))

    def reference_nodes(self, times):
        return np.repeat(lowered(0.8)[:, :, None], len(times), axis=2) if self.says else None

    def _decide(self, time, state):
        return Command(plant().equilibrium_input)


def test_a_run_that_ends_away_from_its_reference_warns_once():
    with pytest.warns(ControlWarning, match=r"comes no nearer.*run\.control\.summary") as caught:
        run = tc.simulate(model(), 1.5, controller=Away(), step=2e-3)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert len(run.control.problems) == 1


def test_a_controller_without_a_reference_has_no_tracking_error():
    silent = Away()
    silent.says = False
    run = tc.simulate(model(), 1.5, controller=silent, step=2e-3)
    assert run.control.tracking_error is None
    assert "tracking" not in run.control.summary()


def test_a_short_run_that_is_still_away_does_not_warn():
    tc.simulate(model(), 0.2, controller=Away(), step=2e-3)


def test_programs_that_are_not_solved_warn():
    mpc = law(tc.MPC, max_iterations=1, solver="osqp")
    start = plant().to_nodes(0.05 * np.random.default_rng(0).normal(size=9))
    with pytest.warns(
        ControlWarning, match="% of the programs were not solved, most of them out of"
    ):
        run = tc.simulate(model(), 0.2, start, controller=mpc, step=2e-3)
    assert Status.OUT_OF_ITERATIONS in run.control.status_count
    assert "not solved" in run.control.summary()


# ---- sample times in seconds ----


@pytest.mark.parametrize("sample_time", [20.0, 10.0, 5.0])
@pytest.mark.parametrize("input", ["rest_length", "force_density"])
def test_a_sample_time_in_milliseconds_is_asked_about(sample_time, input):
    at, sensors = plant(input), tc.Sensors(structure=tc.prism(), string_length=1e-3)
    usual = {"sample_time": sample_time, "horizon": 5, "max_force_density": 60.0}
    calls = [
        lambda: tc.LQR(at, sample_time=sample_time),
        lambda: tc.MPC(at, **usual),
        lambda: tc.NMPC(at, **usual),
        lambda: tc.KalmanFilter(at, sensors, sample_time=sample_time),
    ]
    if input == "force_density":
        feedback = {"sample_time": sample_time, "max_force_density": 60.0, "frequency": 1e-3}
        calls.append(lambda: tc.FeedbackLinearization(at, **feedback))
    for call in calls:
        with pytest.raises(
            ValueError, match=rf"did you mean {sample_time / 1000:g} \({sample_time:g} ms"
        ):
            call()


def test_stiff_strings_may_be_sampled_slowly():
    """The fastest vibration turns often in a sample, the slowest does not."""
    stiff = plant("rest_length", 1e6)
    assert stiff.spectral_radius * SAMPLE > 6 * np.pi
    tc.LQR(stiff, sample_time=SAMPLE)


# ---- references that the linear plant does not reach ----


def way_down(share):
    """Return a path on which the highest node of the prism goes down by a share of the size."""
    node = int(plant().nodes[2].argmax())
    wanted = plant().nodes[:, [node]] - [[0.0], [0.0], [share]]
    goal = tc.shape_target(
        model(), tc.NodesAt([node], wanted), force_density=17.3205, place="centre"
    )
    rest = tc.prestress(tc.prism(), 17.3205)
    return tc.shape_path(model(), rest, goal, duration=1.5, step=0.05).reference()


def test_a_reference_farther_than_the_linear_plant_holds_is_warned_of():
    """With γ as the input it ends off; with rest lengths of the shapes it does not."""
    far, near = way_down(0.25), way_down(0.05)
    with pytest.warns(ControlWarning, match=r"at 1\.5 s is outside .* comes to rest") as caught:
        far_law = law(tc.MPC, "force_density", reference=far, max_force_density=300.0)
    assert caught[0].filename == __file__
    follows = law(tc.MPC, "force_density", reference=near, max_force_density=300.0)
    quiet = law(tc.MPC, reference=far, max_force_density=None)
    with pytest.warns(ControlWarning, match="outside the range of the linear plant") as caught:
        follows.follow(far)
    assert caught[0].filename == __file__
    law(tc.NMPC, "force_density", reference=far, max_force_density=300.0)
    with pytest.warns(ControlWarning, match="ends up to 0"):
        run = tc.simulate(model(), 3.5, controller=far_law, input="force_density", step=2e-3)
    assert run.control.tracking_error[-1] > 0.02
    run = tc.simulate(model(), 3.5, controller=quiet, step=2e-3)
    assert run.control.tracking_error[-1] < 2e-3


def test_a_loop_that_is_unstable_in_the_reference_is_warned_of():
    """Stiff strings without damping, with weights that ask for too much."""
    stiff, far = plant("rest_length", 3000.0), way_down(0.1)
    settings = {"horizon": 8, "sample_time": 0.05, "reference": far}
    with pytest.warns(ControlWarning, match=r"lets errors grow by a factor e in .* s"):
        wild = tc.MPC(stiff, Q=1e3, R=1e-3, **settings)
    with (
        pytest.warns(ControlWarning, match="comes no nearer"),
        pytest.warns(AccuracyWarning, match=r"from 2\.\d+ s on"),
    ):
        tc.simulate(model(3000.0), 3.0, controller=wild)
    run = tc.simulate(model(3000.0), 3.0, controller=tc.MPC(stiff, **settings))
    assert run.control.tracking_error[-1] < 1e-3
