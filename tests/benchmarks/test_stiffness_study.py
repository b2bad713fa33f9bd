"""Laws in γ and in rest lengths over the stiffness: the report against loops made by hand."""

import doctest
import os
import signal
import warnings
from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from examples import stiffness_study
from examples.stiffness_study import stiffness_report
from tenscontrol.demo import tour as demo
from tenscontrol.interrupt import InterruptionWarning
from tenscontrol.robustness import farthest_node

SAMPLE = 0.02
TARGET = demo.prism_of_height(tc.prism(), demo.TARGET)
REST = tc.prestress(TARGET, demo.TOP_FORCE_DENSITY)
NEAR = tc.prestress(demo.prism_of_height(tc.prism(), 0.86), demo.TOP_FORCE_DENSITY)
RAMP = demo.ramp(tc.prism(), 1.0, demo.TARGET, 1.0)
DURATION = 1.5
LOOPS = [(c, i) for i in ("force_density", "rest_length") for c in ("LQR", "MPC")]


def damping(stiffness):
    return 0.02 * np.sqrt(stiffness)


@cache
def model_of(stiffness):
    return tc.Model(TARGET, strings=tc.LinearStrings(stiffness, damping=damping(stiffness)))


def laws(stiffness, held, winches=None, reference=None):
    """Return LQR and MPC, made by hand; those in rest lengths know of the winches."""
    plant = tc.linearize(model_of(stiffness), REST, input=held)
    Q, R = tc.energy_weights(plant, by_mode=held == "rest_length")
    limit = None
    if held == "force_density":
        R, limit, winches = 0.1 * R, 3 * REST.force_density.max(), None
    law = tc.LQR(plant, Q, R, sample_time=SAMPLE, max_force_density=limit, winches=winches)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # that it will not hold is known
        mpc = tc.MPC(
            plant,
            horizon=20,
            sample_time=SAMPLE,
            max_force_density=limit,
            Q=Q,
            R=R,
            reference=reference,
            winches=winches,
        )
    return {"LQR": law, "MPC": mpc}


def push(plant, speed):
    r = plant.degrees_of_freedom
    z = plant.measure(plant.nodes, np.random.default_rng(0).normal(size=(3, 6)))
    velocities = plant.to_velocities(np.zeros(r), z[r:])
    return velocities * (speed / np.linalg.norm(velocities, axis=0).max())


@cache
def fastest(stiffness):
    plant = tc.linearize(model_of(stiffness), REST, input="rest_length")
    return np.abs(np.linalg.eigvals(plant.A)).max()


def off_at_the_end(plant, run):
    """Return the largest distance of a node in the last quarter, in the plant's coordinates."""
    shapes = [plant.measure(TARGET.nodes, np.zeros((3, 6)))]
    for k in np.flatnonzero(run.time >= 0.75 * run.time[-1]):
        shapes.append(plant.measure(run.nodes[:, :, k], np.zeros((3, 6))))
    wanted, *found = (plant.to_nodes(z[: plant.degrees_of_freedom]) for z in shapes)
    return max(np.linalg.norm(nodes - wanted, axis=0).max() for nodes in found)


def off_by_kabsch(run):
    """The same, shapes laid over the target by Kabsch's rotation."""
    wanted = TARGET.nodes - TARGET.nodes.mean(axis=1, keepdims=True)
    farthest = 0.0
    for k in np.flatnonzero(run.time >= 0.75 * run.time[-1]):
        nodes = run.nodes[:, :, k] - run.nodes[:, :, k].mean(axis=1, keepdims=True)
        turn = Rotation.align_vectors(wanted.T, nodes.T)[0]
        farthest = max(farthest, np.linalg.norm(turn.apply(nodes.T) - wanted.T, axis=1).max())
    return farthest


def test_its_example_is_right():
    assert doctest.testmod(stiffness_study) == (0, 3)


@pytest.fixture(scope="module")
def report():
    return stiffness_report(
        REST, [1e2, 1e4], sample_time=SAMPLE, damping=damping, reference=RAMP, duration=DURATION
    )


@pytest.mark.filterwarnings("ignore::tenscontrol.control.ControlWarning")
@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_rows_are_what_loops_made_by_hand_give(report, held):
    row = report.rows[1]
    made = laws(1e4, held, reference=RAMP)
    for name, controller in made.items():
        plant = controller.plant
        start = (RAMP.nodes[:, :, 0], None) if name == "MPC" else (TARGET.nodes, push(plant, 0.02))
        run = tc.simulate(
            plant.model, DURATION, *start, controller=controller,
            step=min(SAMPLE / 10, 0.3 / fastest(1e4)), output_step=SAMPLE / 10,
        )  # fmt: skip
        found = report.runs(name, held)[1]
        assert found in row.runs
        late = run.nodes[:, :, run.time >= 0.75 * run.time[-1]]
        assert found.error == farthest_node(plant, late, TARGET.nodes)  # bit for bit
        assert found.error == pytest.approx(off_at_the_end(plant, run), rel=0.01)
        assert found.error == pytest.approx(off_by_kabsch(run), rel=0.02)
        assert found.least_force_density == run.force_density.min()
        assert found.slackened == (run.work.switches > 0)
        assert found.commands_not_ok == sum(status != "ok" for status in run.control.status)
        assert found.failure is None
    law = made["LQR"]
    if held == "force_density":
        loop = tc.control.held_loop(law.plant, law.gain, sample_time=SAMPLE)
        assert (row.held.radius, row.held.designed_radius) == (loop.radius, loop.designed_radius)
    else:
        assert row.radius == np.abs(law.poles).max()


def test_law_in_force_densities_fails_where_the_one_in_rest_lengths_holds(report):
    assert report.limit("MPC", "force_density") == 1e2
    assert report.limit("LQR", "force_density") == 1e2
    assert report.runs("MPC", "force_density")[1].error > 0.03
    for controller in ("LQR", "MPC"):
        assert report.limit(controller, "rest_length") == 1e4
        assert report.holds(controller, "rest_length").all()
    text = report.summary()
    assert "MPC in γ: holds within 1 mm up to 100 N/m, not at 10000 N/m" in text
    assert "MPC in rest lengths: holds within 1 mm at all that was tried, up to 10000" in text


def test_a_law_that_settles_too_slowly_does_not_hold_though_it_is_near(report):
    run = report.runs("LQR", "force_density")[1]
    assert run.error < report.tolerance
    assert not report.rows[1].held.holds
    assert not report.holds("LQR", "force_density")[1]
    ratio = report.rows[1].held.rate_ratio
    wanted = (
        f"LQR in γ: holds within 1 mm up to 100 N/m, not at 10000 N/m (settles at {100 * ratio:.2g}"
    )
    assert wanted in report.summary()


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_linear_loops_of_lqr_and_mpc_are_one(held):
    made = laws(1e3, held)
    feedback = made["MPC"].law.design.problem.feedback
    assert np.allclose(feedback, made["LQR"].gain, rtol=1e-6, atol=1e-8 * np.abs(feedback).max())


@pytest.fixture(scope="module")
def short():
    return stiffness_report(
        REST,
        np.geomspace(1e2, 1e5, 4),
        sample_time=SAMPLE,
        damping=damping,
        duration=SAMPLE,
        horizon=2,
    )


def test_law_in_force_densities_settles_the_slower_the_stiffer(short):
    ratios = [row.held.rate_ratio for row in short.rows]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[0] > 0.75
    assert ratios[-1] < 0.01
    designed = [row.held.designed_radius for row in short.rows]
    assert np.ptp(designed) < 1e-3  # γ held, all but the damping is the same
    assert all(row.radius < 1 for row in short.rows)


def test_shorter_samples_let_the_law_in_force_densities_hold_with_stiffer_strings(short):
    """Over a sample strings act as dampers of k step / 2: half the step, twice the stiffness."""
    half = stiffness_report(
        REST,
        2 * short.stiffness[:2],
        sample_time=SAMPLE / 2,
        damping=damping,
        duration=SAMPLE,
        horizon=2,
    )
    for row, other in zip(half.rows, short.rows, strict=False):
        assert row.held.rate_ratio == pytest.approx(other.held.rate_ratio, rel=0.2)


def test_weights_of_the_user_are_those_of_all_four(short):
    seen = []

    def faster(plant):
        seen.append(plant.input)
        Q, R = tc.energy_weights(plant, by_mode=plant.input == "rest_length")
        return Q, 1e-2 * R

    fast = stiffness_report(
        REST, [1e3], sample_time=SAMPLE, damping=damping, duration=SAMPLE, weights=faster, horizon=2
    )
    assert seen == ["force_density", "rest_length"]
    plant = tc.linearize(model_of(1e3), REST)
    law = tc.LQR(plant, *faster(plant), sample_time=SAMPLE)
    loop = tc.control.held_loop(plant, law.gain, sample_time=SAMPLE)
    assert fast.rows[0].held.radius == loop.radius
    assert fast.rows[0].held.radius != short.rows[1].held.radius


def test_winches_are_those_of_all_runs():
    """Winches that hardly wind hold the rest lengths: whatever the law, one motion."""
    stuck = tc.Winches(rate=1e-9, substeps=2)
    found = stiffness_report(
        REST, [1e3], sample_time=SAMPLE, damping=damping, duration=0.3, winches=stuck
    ).rows[0]
    plant = tc.linearize(model_of(1e3), REST, input="rest_length")
    free = tc.simulate(
        plant.model, 0.3, TARGET.nodes, push(plant, 0.02), rest_length=plant.rest_length,
        step=1e-3,
    )  # fmt: skip
    wanted = off_at_the_end(plant, free)
    for run in found.runs:
        assert run.error == pytest.approx(wanted, rel=1e-3)
    free_winches = stiffness_report(REST, [1e3], sample_time=SAMPLE, damping=damping, duration=0.3)
    assert abs(free_winches.rows[0].runs[2].error / wanted - 1) > 1e-3


def test_winches_stand_where_the_reference_begins():
    model = model_of(1e3)
    path = tc.shape_path(model, NEAR, REST, duration=0.2, step=0.05)
    winches = tc.Winches(rate=0.5, substeps=4)
    found = stiffness_report(
        REST, [1e3], sample_time=SAMPLE, damping=damping, duration=0.3, winches=winches,
        reference=path.reference(),
    )  # fmt: skip
    mpc = laws(1e3, "rest_length", winches=winches, reference=path.reference())["MPC"]
    run = tc.simulate(
        mpc.plant.model, 0.3, path.nodes[:, :, 0], controller=mpc, winches=winches,
        rest_length=path.rest_length[:, 0], step=min(SAMPLE / 10, 0.3 / fastest(1e3)),
        output_step=SAMPLE / 10,
    )  # fmt: skip
    wanted = off_at_the_end(mpc.plant, run)
    assert found.runs("MPC", "rest_length")[0].error == pytest.approx(wanted, rel=1e-9)


def test_runs_that_fail_are_rows_that_say_so():
    found = stiffness_report(REST, [1e3], sample_time=SAMPLE, push=300.0, duration=0.2)
    for run in found.rows[0].runs:
        assert run.error is None
        assert run.failure
        assert not found.holds(run.controller, run.input).any()
        assert found.limit(run.controller, run.input) is None
        assert f"failed: 1000 N/m, {run}: {run.failure}" in found.summary()
    assert found.table().count("failed") == 4
    assert "does not hold within 1 mm at 1000 N/m, the softest" in found.summary()


def test_steps_of_the_user_are_taken():
    """A step that is too long fails, and says what to try."""
    coarse, fine = (
        stiffness_report(
            REST,
            [1e6],
            sample_time=SAMPLE,
            duration=0.1,
            horizon=2,
            push=0.001,
            integration_step=step,
        )
        for step in (SAMPLE, 8e-5)
    )
    for run in coarse.rows[0].runs:
        assert run.failure
    for run in fine.rows[0].runs:
        assert run.failure is None


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_an_interrupted_report_keeps_its_rows(monkeypatch):
    calls = 0

    def pressed(*arguments, **options):
        nonlocal calls
        calls += 1
        if calls == 6:  # the second run of the second row
            signal.raise_signal(signal.SIGINT)
        return tc.simulate(*arguments, **options)

    monkeypatch.setattr(stiffness_study, "simulate", pressed)
    with pytest.warns(InterruptionWarning, match="1 rows are done"):
        found = stiffness_report(REST, [1e2, 1e3], sample_time=SAMPLE, duration=SAMPLE)
    assert found.stiffness.tolist() == [1e2]
    assert len(found.rows[0].runs) == 4
    assert found.summary()


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_key_that_is_lost_in_a_design_ends_the_report_after_it(monkeypatch):
    design, designed = stiffness_study.Task.design, []

    def lost(*arguments):
        with suppress(KeyboardInterrupt):  # CasADi does so in its conversions
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
        designed.append(arguments)
        return design(*arguments)

    monkeypatch.setattr(stiffness_study.Task, "design", lost)
    with pytest.raises(KeyboardInterrupt):
        stiffness_report(REST, [1e2, 1e3], sample_time=SAMPLE, duration=SAMPLE)
    assert len(designed) == 1


def test_an_interrupted_run_is_no_row(monkeypatch):
    def interrupted(*arguments, **options):
        return replace(tc.simulate(*arguments, **options), stopped="was interrupted at 0.02 s")

    monkeypatch.setattr(stiffness_study, "simulate", interrupted)
    with pytest.raises(KeyboardInterrupt, match=r"interrupted at 0\.02 s"):
        stiffness_report(REST, [1e2], sample_time=SAMPLE, duration=SAMPLE)


def test_a_shape_target_on_supports_under_its_weight_is_held():
    standing = tc.prism()
    standing = replace(standing, fixed=[3, 4, 5])
    strings = tc.LinearStrings(1e3, damping=1.0)
    model = tc.Model(standing, strings=strings, gravity=9.81)
    goal = tc.shape_target(model, force_density=60.0)
    found = stiffness_report(goal, [1e3], sample_time=SAMPLE, damping=1.0, duration=0.3)
    plant = tc.linearize(model, goal.prestress, input="rest_length")
    Q, R = tc.energy_weights(plant, by_mode=True)
    law = tc.LQR(plant, Q, R, sample_time=SAMPLE)
    assert found.rows[0].radius == pytest.approx(np.abs(law.poles).max(), rel=1e-9)
    assert found.runs("LQR", "rest_length")[0].error < 2e-3


def test_there_are_no_other_loops(report):
    with pytest.raises(ValueError, match=r"controller is 'NMPC', expected one of 'LQR', 'MPC'"):
        report.runs("NMPC", "rest_length")
    with pytest.raises(ValueError, match=r"input is 'tension', expected one of 'force_density'"):
        report.holds("MPC", "tension")
    assert [(run.controller, run.input) for run in report.rows[0].runs] == LOOPS
