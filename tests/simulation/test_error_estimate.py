"""The estimate of the global error: against exact motions, whatever is kept of them."""

import warnings
from dataclasses import replace
from threading import Lock

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import ControlWarning
from tenscontrol.simulation import AccuracyWarning
from tests.benchmarks.trust_in_loops import random_loop
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength

STEPPING = ["rk4", "energy_momentum"]


def off(run, exact):
    """Distance of the node that is off most, as part of the size, at each time."""
    size = np.ptp(run.structure.nodes, axis=1).max()
    return np.linalg.norm(run.nodes - exact.nodes, axis=0).max(axis=0) / size


@pytest.fixture(scope="module")
def example():
    """The paper's example 1, damped, slack now and then."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.2))
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    return model, tc.to_rest_length(model, prism.nodes, gamma).rest_length


def falling_bar():
    """A bar that falls freely for 1.9 s and is caught by a damped string that was slack."""
    structure = tc.Structure(
        nodes=[[0.0, 0.3, 0.0], [0.0, 0.0, 0.0], [0.0, 0.5, 1.0]],
        bars=[(0, 1)], strings=[(2, 0)], bar_mass=1.0, fixed=[2],
    )  # fmt: skip
    return tc.Model(structure, strings=tc.LinearStrings(2000.0, damping=5.0), gravity=9.81)


@pytest.mark.parametrize("kept", [None, 0.4, 1.0])
def test_what_is_kept_does_not_matter(kept):
    model = falling_bar()
    exact = tc.simulate(model, 2.0, rest_length=18.0, tolerance=1e-12, output_step=kept or 0.02)
    with pytest.warns(AccuracyWarning, match="position error"):
        run = tc.simulate(
            model, 2.0, rest_length=18.0, method="energy_momentum", step=0.02, output_step=kept
        )
    true = off(run, exact)
    assert true[-1] > 0.01
    assert true[-1] / 2 < run.error[-1] < 10 * true[-1]
    assert run.trusted_until < 2.0


@pytest.mark.parametrize("method", STEPPING)
def test_the_estimate_with_fixed_steps_is_near_the_error(example, method):
    model, lengths = example
    kept = {"rest_length": lengths, "output_step": 0.1}
    exact = tc.simulate(model, 2.0, **kept, tolerance=1e-13)
    ratios = []
    for step in (1e-2, 7e-3, 5e-3):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AccuracyWarning)
            run = tc.simulate(model, 2.0, **kept, method=method, step=step)
        ratios.append(run.error.max() / off(run, exact).max())
    assert min(ratios) > 0.5
    assert np.median(ratios) < 6


@pytest.mark.parametrize(
    ("method", "tolerance"), [("dop853", 1e-6), ("cvodes", 1e-6), ("energy_momentum", 1e-5)]
)
def test_the_estimate_with_a_tolerance_is_near_the_error(example, method, tolerance):
    model, lengths = example
    kept = {"rest_length": lengths, "output_step": 0.1}
    exact = tc.simulate(model, 2.0, **kept, tolerance=1e-12)
    run = tc.simulate(model, 2.0, **kept, method=method, tolerance=tolerance)
    assert 0.5 < run.error.max() / off(run, exact).max() < 8


def test_states_between_steps_are_estimated_too():
    """Damping takes errors of steps away, and leaves those of states between them."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(1000.0, damping=20.0))
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    given = {"rest_length": tc.to_rest_length(model, prism.nodes, gamma).rest_length}
    exact = tc.simulate(model, 5.0, **given, method="dop853", tolerance=1e-12, error="none")
    run = tc.simulate(model, 5.0, **given, method="dop853", tolerance=1e-4)
    true = off(run, exact)
    assert true.max() > 100 * true[-1]
    # It says nothing where the errors of both runs pass through zero; few are not looked at.
    assert np.mean(true <= np.maximum(3 * run.error, 1e-4 * true.max())) > 0.99


def test_a_motion_that_magnifies_errors_says_until_when_it_is_right():
    """A ball pulled out of shape turns over and over; strings fall slack.

    A controller that gives the same lengths whatever the motion corrects nothing.
    """
    ball = tc.library.six_bar_ball()
    model = tc.Model(ball, strings=tc.LinearStrings(1000.0))
    random = np.random.default_rng(1)
    lengths = ball.string_length(ball.nodes) * random.uniform(0.5, 1.3, len(ball.strings))
    exact = tc.simulate(model, 3.0, rest_length=lengths, tolerance=1e-13, error="none")
    with pytest.warns(AccuracyWarning, match="foretold for a time"):
        run = tc.simulate(model, 3.0, rest_length=lengths, tolerance=1e-4)
    true = off(run, exact)
    assert true.max() > 0.01
    right = run.time[np.flatnonzero(true > 0.01)[0]]
    assert 0.3 * right < run.trusted_until <= right
    with pytest.warns(AccuracyWarning, match="foretold for a time"):
        commanded = tc.simulate(
            model, 3.0, controller=lambda *motion: lengths, rest_length=lengths, sample_time=1.0,
            tolerance=1e-4, limits=tc.HealthLimits(crossings=None),
        )  # fmt: skip
    assert 0.3 * right < commanded.trusted_until <= right
    assert f"trusted until     {run.trusted_until:.4g} s" in run.summary()
    shown = tc.plot.trajectory(run)["coordinates"].ax
    assert "not to be trusted" in shown.get_legend_handles_labels()[1]


@pytest.mark.parametrize(
    ("weight", "sample_time"),
    [
        pytest.param(1e4, 0.05, id="does little"),
        pytest.param(1.0, 0.05, id="is unstable away from its reference"),
    ],
)
def test_a_loop_that_magnifies_errors_says_until_when_it_is_right(weight, sample_time):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(1000.0))
    plant = tc.linearize(model, tc.prestress(model.structure, 10.0), input="rest_length")
    start = plant.to_nodes(0.1 * np.random.default_rng(0).normal(size=9))
    Q, R = tc.energy_weights(plant)
    law = tc.LQR(plant, Q, weight * R, sample_time=sample_time)
    given = {"controller": law, "output_step": 0.05, "limits": tc.HealthLimits(crossings=None)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ControlWarning)
        exact = tc.simulate(model, 2.0, start, **given, tolerance=1e-12, error="none")
        with pytest.warns(AccuracyWarning, match="foretold for a time"):
            run = tc.simulate(model, 2.0, start, **given, tolerance=1e-4)
    true = off(run, exact)
    assert true.max() > 0.01
    assert (true <= np.maximum(3 * run.error, 1e-9)).all()
    right = run.time[np.flatnonzero(true > 0.01)[0]]
    assert 0.3 * right < run.trusted_until <= right


@pytest.mark.parametrize("seed", [36, 515077], ids=["a filter", "limits far from rest"])
def test_a_loop_that_magnifies_errors_is_part_of_the_estimate(seed):
    # Nothing speaks of a problem, and under its commands the motion alone errs by 2e-4 and 5e-4.
    loop = random_loop(seed)
    exact = loop.simulate(method="dop853", tolerance=1e-11, error="none")
    with pytest.warns(AccuracyWarning, match="foretold for a time"):
        run = loop.simulate(tolerance=1e-4)
    assert not run.control.problems
    true = off(run, exact)
    assert true.max() > 0.02
    assert (true <= np.maximum(3 * run.error, 1e-9)).all()


def pendulum():
    """A heavy bar that stands on its foot between four strings too soft to hold it, and its LQR."""
    structure = tc.Structure(
        nodes=[[0, 0, 1, 0, -1, 0], [0, 0, 0, 1, 0, -1], [0, 1, 0, 0, 0, 0]],
        bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], bar_mass=1.0,
        fixed=[0, 2, 3, 4, 5],
    )  # fmt: skip
    model = tc.Model(structure, strings=tc.LinearStrings(20.0), gravity=200.0)
    rest = tc.prestress(structure, force_density=2.0, external_force=model.constant_force)
    plant = tc.linearize(model, rest, input="rest_length")
    return plant, tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.02)


def test_a_loop_that_holds_what_would_fall_is_trusted():
    plant, law = pendulum()
    given = {"controller": law, "output_step": 0.1}
    start = plant.to_nodes([0.05, 0.02])
    exact = tc.simulate(plant.model, 3.0, start, **given, tolerance=1e-12, error="none")
    run = tc.simulate(plant.model, 3.0, start, **given, tolerance=1e-4)
    assert off(run, exact).max() <= run.error.max() < 1e-3
    time = np.append(run.control.time, 3.0)
    wound = tc.Profile(time, np.column_stack([run.control.applied, law.bounds[0]]), "hold")
    with pytest.warns(AccuracyWarning, match="foretold for a time"):
        tc.simulate(plant.model, 3.0, start, rest_length=wound, tolerance=1e-4)


def test_what_cannot_be_run_again_in_its_loop_is_replayed():
    """A controller that cannot be copied, and one that goes on with what it remembers."""
    plant, law = pendulum()
    first = tc.simulate(plant.model, 0.1, plant.to_nodes([0.05, 0.02]), controller=law)
    with pytest.warns(AccuracyWarning, match="foretold for a time"):
        tc.simulate(plant.model, 3.0, start=first, controller=law)
    law.lock = Lock()
    with pytest.warns(AccuracyWarning, match="foretold for a time"):
        tc.simulate(plant.model, 3.0, plant.to_nodes([0.05, 0.02]), controller=law)


def test_steps_that_stability_limits_show_their_error():
    """All steps but the first are as long as stability allows, whatever the tolerance."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(1e5))
    lengths = tc.to_rest_length(model, prism.nodes, 17.3205 * np.repeat([1, 1, 3**0.5], 3))
    spin = np.cross([0.0, 0.0, 1.0], prism.nodes.T).T
    given = {"velocities": spin, "rest_length": lengths.rest_length, "output_step": 0.1}
    exact = tc.simulate(model, 1.0, **given, tolerance=1e-12, error="none")
    run = tc.simulate(model, 1.0, **given, tolerance=1e-3)
    assert 0.5 * off(run, exact).max() < run.error.max()


def test_commands_of_a_function_are_replayed(example):
    """A loop that is sampled at each step has no longer steps: half of them are taken."""
    model, _ = example
    prism = model.structure
    rest = tc.prestress(prism, force_density=17.3205)
    plant = tc.linearize(model, rest, input="rest_length")
    start = plant.to_nodes([0.05] * 9)
    calls = []
    for sample_time in (2e-3, 2e-2):
        law = tc.LQR(plant, sample_time=sample_time)

        def command(time, N, V, law=law):
            calls.append(time)
            return law.command(time, N, V).value

        run = tc.simulate(model, 0.4, start, controller=command, sample_time=sample_time, step=2e-3)
        assert len(calls) == len(run.control.time)
        calls.clear()
        wound = np.column_stack([run.control.applied, run.control.applied[:, -1]])
        time = np.append(run.control.time, 0.4)
        held = tc.Profile(time, wound, "hold")
        exact = tc.simulate(model, 0.4, start, rest_length=held, tolerance=1e-12, output_step=2e-3)
        true = off(run, exact)[-1] if len(run.time) == len(exact.time) else None
        assert true is not None
        assert 0.5 * true < run.error.max() < 30 * true + 1e-12


def test_supports_that_jump_push_the_other_motion_too():
    structure = tc.Structure(
        nodes=[[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]], bars=[(0, 1)], strings=[], bar_mass=1.0,
        fixed=[0],
    )  # fmt: skip
    model = tc.Model(structure, gravity=9.81)
    motion = tc.Profile(
        [0.0, 0.5, 1.0], np.array([[0.0, 0.2, 0.2], [0.0, 0, 0], [0, 0, 0]])[:, None]
    )
    given = {"force_density": np.zeros(0), "support_motion": motion, "output_step": 0.05}
    exact = tc.simulate(model, 1.0, **given, tolerance=1e-12)
    run = tc.simulate(model, 1.0, **given, method="rk4", step=0.01)
    true = off(run, exact)
    assert 0.5 * true.max() < run.error.max() < 20 * true.max()


def test_it_can_be_left_out(example):
    model, lengths = example
    run = tc.simulate(model, 0.1, rest_length=lengths, error="none")
    assert run.error is run.trusted_until is run.health.position_error is None
    with_it = tc.simulate(model, 0.1, rest_length=lengths)
    assert np.array_equal(run.nodes, with_it.nodes)
    assert with_it.work == run.work
    assert with_it.trusted_until == 0.1
    with pytest.raises(ValueError, match="error is 'no'"):
        tc.simulate(model, 0.1, rest_length=lengths, error="no")


def test_the_other_motion_takes_about_as_many_steps(example, monkeypatch):
    """What the estimate costs, in steps: twice the default call, 1.6 of one with fixed steps."""
    model, lengths = example
    works = []
    for options, most in ({}, 2.4), ({"method": "rk4", "step": 1e-3}, 1.65):
        works.clear()
        for kind in (tc.integrate.DOP853, tc.integrate.RK4):
            advance = kind.advance

            def counted(self, *arguments, advance=advance):
                span = advance(self, *arguments)
                works.append(span.work.evaluations)
                return span

            monkeypatch.setattr(kind, "advance", counted)
        run = tc.simulate(model, 2.0, rest_length=lengths, **options)
        assert works[0] == run.work.evaluations
        assert sum(works) < most * works[0]
        monkeypatch.undo()


def test_a_batch_looks_at_some_runs_and_names_those_that_are_wrong(example):
    model, lengths = example
    given = lengths * np.linspace(0.9, 1.0, 40)[:, None]
    how = tc.Integration(step=5e-3, output_step=0.1)
    scene = tc.Scene(model, 0.2, rest_length=lengths, integration=how)
    batch = tc.simulate_many(scene, {"rest_length": given})
    looked_at = np.isfinite(batch.error[:, 0])
    assert looked_at.sum() == 32
    assert np.isfinite(batch.error[looked_at]).all()
    some = int(np.flatnonzero(looked_at)[3])
    alone = tc.simulate(
        model, 0.2, rest_length=given[some], method="rk4", step=5e-3, output_step=0.1
    )
    assert np.array_equal(batch.error[some], alone.error)
    assert tc.simulate_many(scene, {"rest_length": given}, error="none").error is None
    coarse = replace(scene, integration=replace(how, step=0.05))
    with pytest.warns(AccuracyWarning, match=r"of the 40 runs that were looked at passes 0\.01"):
        wrong = tc.simulate_many(coarse, {"rest_length": given}, error="all")
    assert np.isfinite(wrong.error[:, 0]).all()


def test_an_infinite_error_is_saved(example, tmp_path):
    """Where no other motion can go on, at a step on the border of stability."""
    model, lengths = example
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)
        run = tc.simulate(model, 0.2, rest_length=lengths, step=1e-3)
        infinite = tc.simulation.Trajectory(
            **{name: getattr(run, name) for name in run.__dataclass_fields__}
            | {"error": np.append(run.error[:-1], np.inf)}
        )
        saved = tc.load_run(infinite.save(tmp_path / "run.npz"))
    assert np.array_equal(saved.error, infinite.error)
    assert saved.trusted_until == infinite.trusted_until < 0.2


def test_the_oracle_agrees_with_what_is_called_exact():
    """The falling bar, by a method that shares no code."""
    model = falling_bar()
    structure = model.structure
    weight = np.zeros((3, 3))
    weight[2, :2] = -9.81 / 2
    law = HeldRestLength(np.array([18.0]), np.array([2000.0]), damping=np.array([5.0]))
    nodes, _ = exact_motion(structure, law, np.array([0.0, 1.0, 2.0]), external_force=weight)
    exact = tc.simulate(model, 2.0, rest_length=18.0, tolerance=1e-12, output_step=1.0)
    np.testing.assert_allclose(exact.nodes, nodes, atol=1e-7)


@pytest.mark.parametrize("method", STEPPING)
def test_a_step_longer_than_the_time_between_outputs_is_no_other_one(example, method):
    """Steps are cut to reach the outputs: half of the step asked for would be the same."""
    model, lengths = example
    kept = {"rest_length": lengths, "output_step": 0.02}
    exact = tc.simulate(model, 2.0, **kept, tolerance=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)
        run = tc.simulate(model, 2.0, **kept, method=method, step=0.1)
    assert run.error.max() > 0.5 * off(run, exact).max()


def test_long_steps_that_conserve_energy_warn():
    """The energy says nothing here: the method conserves it whatever the step."""
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    gamma = np.repeat([10.0, 10.0, 0.9 * np.sqrt(3) * 10.0], 3)
    lengths = tc.to_rest_length(model, tc.prism().nodes, gamma).rest_length
    with pytest.warns(AccuracyWarning, match="position error"):
        run = tc.simulate(model, 2.0, rest_length=lengths, method="energy_momentum", step=0.1)
    assert run.health.energy_error < 1e-9
