"""Many closed loops of compiled controllers: the same numbers as one by one."""

import pickle

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Status
from tenscontrol.dynamics.machine_code import compiler
from tenscontrol.interrupt import InterruptionWarning
from tenscontrol.simulation import AccuracyWarning
from tests.benchmarks.trust_in_loops import random_loop

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")

RUNS = 5  # more than lanes


def shaken(plant, size, runs=RUNS):
    """Nodes of runs that start beside the reference."""
    rng = np.random.default_rng(2)
    q = size * rng.standard_normal((runs, plant.degrees_of_freedom))
    return np.array([plant.to_nodes(each) for each in q])


def loops(model, duration, code, vary, how, threads=None, **given):
    """Many loops closed by compiled code."""
    scene = tc.Scene(
        model, duration, controller=code, integration=tc.Integration(**how), **given
    )  # fmt: skip
    return tc.simulate_many(scene, vary, threads=threads)


@pytest.fixture(scope="module")
def tower():
    """Plant of a tower whose bars share nodes, and the code of its LQR of rest lengths."""
    structure = tc.library.class2_tower(1)
    rest = tc.prestress(structure, min_force_density=20.0)
    model = tc.Model(rest.structure, strings=tc.LinearStrings(1e3, damping=2.0))
    plant = tc.linearize(model, rest, input="rest_length")
    return plant, tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.03)


@pytest.fixture(scope="module")
def prism():
    """Plant of a prism and its MPC of force densities, which remembers its plan."""
    structure = tc.prism()
    plant = tc.linearize(tc.Model(structure), tc.prestress(structure, force_density=17.3205))
    return plant, tc.MPC(plant, horizon=6, sample_time=0.03, max_force_density=40.0)


@pytest.fixture(scope="module")
def codes(tower, prism, tmp_path_factory):
    """The compiled code of both."""
    scenes = {"tower": tower, "prism": prism}
    folder = tmp_path_factory.mktemp("codes")
    return {
        name: tc.generate_c(controller, folder / name).compile()
        for name, (_, controller) in scenes.items()
    }


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("tower", {"step": 5e-3, "output_step": 0.01}),
        ("tower", {"method": "dop853", "tolerance": 1e-8, "output_step": 0.01}),
        ("prism", {"step": 5e-3, "output_step": 0.02}),
        ("prism", {"tolerance": 1e-4, "output_step": 0.02}),
    ],
)
def test_numbers_are_those_of_single_runs(name, how, codes, request):
    plant, code = request.getfixturevalue(name)[0], codes[name]
    starts = shaken(plant, 0.01)
    # The last sample is a part of one.
    batch = loops(plant.model, 0.2, code, {"nodes": starts}, how, threads=2)
    assert batch.completed.all()
    for i in (0, RUNS - 1):
        run = tc.simulate(plant.model, 0.2, starts[i], controller=code, **how)
        assert np.array_equal(batch.time, run.time)
        assert np.array_equal(batch.nodes[i], run.nodes)
        assert np.array_equal(batch.velocities[i], run.velocities)
        assert np.array_equal(batch.command[i], run.control.command)
        failed = sum(status is not Status.OK for status in run.control.status)
        assert batch.commands_not_ok[i] == failed
    moved = np.abs(batch.command - plant.equilibrium_input[:, None]).max(axis=(1, 2))
    assert (moved > 1e-6).all()


def test_parameters_vary_under_a_controller_that_does_not_know(tower, codes):
    plant, _ = tower
    starts, factor = shaken(plant, 0.005, 2)[[0, 0]], np.array([1.0, 1.3])
    vary = {"nodes": starts, "stiffness": 1e3 * factor}
    batch = loops(plant.model, 0.06, codes["tower"], vary, {"step": 5e-3})
    strings = tc.LinearStrings(1.3e3, damping=2.0)
    softer = tc.Model(plant.model.structure, strings=strings)
    run = tc.simulate(softer, 0.06, starts[1], controller=codes["tower"], step=5e-3)
    assert np.array_equal(batch.nodes[1, :, :, -1], run.nodes[:, :, -1])
    assert not np.array_equal(batch.nodes[0, :, :, -1], run.nodes[:, :, -1])


def test_a_run_that_cannot_begin_leaves_the_others_alone(prism, codes):
    plant, _ = prism
    starts = shaken(plant, 0.01, 3)
    given = plant.model, 0.06, codes["prism"], {"nodes": starts}, {"step": 5e-3}
    good = loops(*given)
    starts[1, :, 0] += 1.0  # a bar of another length
    batch = loops(*given)
    assert list(batch.messages) == [1]
    assert np.isnan(batch.command[1]).all()
    assert np.array_equal(batch.nodes[[0, 2]], good.nodes[[0, 2]])
    assert np.array_equal(batch.command[[0, 2]], good.command[[0, 2]])


def test_what_does_not_fit_is_refused(prism, codes):
    plant, mpc = prism
    starts = shaken(plant, 0.01)
    given = {"nodes": starts}, {"step": 0.01}
    with pytest.raises(TypeError, match=r"controller is a MPC, expected the compiled code"):
        loops(plant.model, 0.1, mpc, *given)
    with pytest.raises(ValueError, match="the controller was designed on"):
        loops(plant.model, 0.1, codes["tower"], *given)
    elastic = tc.Model(plant.model.structure, strings=tc.LinearStrings(100.0))
    with pytest.raises(ValueError, match="commands force density, and the model's strings are Lin"):
        loops(elastic, 0.1, codes["prism"], *given)
    model = tc.Model(plant.model.structure, external_force=True)
    gust = tc.Profile([0.0, 0.05, 0.1], np.zeros((3, 6, 3)))
    with pytest.raises(ValueError, match="external_force changes in time"):
        loops(model, 0.1, codes["prism"], *given, external_force=gust)


@pytest.mark.parametrize("how", [{"tolerance": 1e-4}, {"step": 5e-3}])
def test_loops_that_magnify_errors_say_so_as_one_by_one(how, tmp_path):
    """A law that does little leaves a motion that magnifies errors."""
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(1000.0))
    plant = tc.linearize(model, tc.prestress(model.structure, 10.0), input="rest_length")
    Q, R = tc.energy_weights(plant)
    law = tc.LQR(plant, Q, 1e4 * R, sample_time=0.05)
    code = tc.generate_c(law, tmp_path / "own").compile()
    starts, how = shaken(plant, 0.1, 1), {**how, "method": "dop853"} if "tolerance" in how else how
    with pytest.warns(AccuracyWarning, match="passes 0.01"):
        batch = loops(model, 2.0, code, {"nodes": starts}, {**how, "output_step": 0.05})
    with pytest.warns(AccuracyWarning, match="foretold for a time"):
        run = tc.simulate(model, 2.0, starts[0], controller=code, **how, output_step=0.05)
    assert run.error.max() > 0.01
    # Round-off of a time decides in which part of the run an output is.
    largest = (np.maximum.accumulate(error) for error in (batch.error[0], run.error))
    np.testing.assert_allclose(*largest, rtol=1e-6, atol=1e-12)


def test_errors_are_those_of_the_loop_not_of_its_commands(tmp_path):
    """Under commands that are replayed, this motion errs by a ninth of what it does in the loop."""
    loop = random_loop(38)
    code = tc.generate_c(loop.controller(), tmp_path / "own").compile()
    vary = {"velocities": loop.velocities[None]}
    exact, run = (
        loops(loop.plant.model, loop.duration, code, vary,
              {"tolerance": tolerance, "output_step": loop.sample_time})
        for tolerance in (1e-11, 1e-4)
    )  # fmt: skip
    error = np.abs(run.nodes - exact.nodes).max() / loop.size
    assert 1e-5 < error < 3 * run.error.max()


def test_another_has_a_memory_of_its_own(prism, codes):
    plant, _ = prism
    start, still = shaken(plant, 0.05, 1)[0], np.zeros((3, 6))
    one, other = codes["prism"].another(), codes["prism"].another()
    first = one.command(0.0, start, still).value
    moved = one.command(0.03, plant.nodes, still).value
    assert np.array_equal(other.command(0.0, start, still).value, first)
    # A pickle holds the code, not what it remembers.
    fresh = pickle.loads(pickle.dumps(one))
    assert np.array_equal(fresh.command(0.0, start, still).value, first)
    assert np.array_equal(fresh.command(0.03, plant.nodes, still).value, moved)


def test_copies_of_a_controller_serve_the_next_batch(tower, tmp_path, monkeypatch):
    plant, law = tower
    code = tc.generate_c(law, tmp_path / "own").compile()
    made, another = [], type(code).another
    monkeypatch.setattr(type(code), "another", lambda self: made.append(1) or another(self))
    given = plant.model, 0.06, code, {"nodes": shaken(plant, 0.01)}, {"step": 0.01}
    first, second = (loops(*given, threads=1) for _ in range(2))
    assert 0 < len(made) <= RUNS
    assert np.array_equal(first.nodes, second.nodes)
    # The start and the end alone are kept.
    run = second.trajectory(1)
    assert np.array_equal(run.rest_length, second.command[1][:, [0, -1]])
    assert (run.conserves_energy, run.steps) == (False, 6)
    assert np.array_equal(run.error, second.error[1])


def test_after_an_interrupt_copies_are_used_again(prism, codes, monkeypatch):
    """A copy is a library that stays loaded, so no run may lose any."""
    (plant, _), code = prism, codes["prism"]
    starts, made, looked = shaken(plant, 0.01), [], []
    another = type(code).another
    monkeypatch.setattr(type(code), "another", lambda self: made.append(1) or another(self))

    def interrupted():
        looked.append(1)
        if len(looked) > 1:
            raise KeyboardInterrupt

    def run():
        loops(plant.model, 0.2, code, {"nodes": starts}, {"step": 5e-3}, threads=1)

    run()
    made.clear()
    with monkeypatch.context() as patch:
        patch.setattr("tenscontrol.simulation.batch.runner.check", interrupted)
        with pytest.warns(InterruptionWarning, match="runs are done"):
            run()
    assert len(looked) > 1
    run()
    assert not made
