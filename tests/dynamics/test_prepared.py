"""What is prepared once: a second run on the same model builds nothing with CasADi."""

import copy
import pickle
import sys
import threading
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.evaluator import Prepared
from tests.dynamics.scenes import paper_force_density, rest_lengths

# What evaluates functions that are there, or asks about them. Anything else builds.
EVALUATING = {
    "Function.__call__",
    "Function.call",
    "Function.buffer",
    "Function.stats",
    "Function.n_in",
    "Function.n_out",
    "Function.size1_in",
    "Function.size1_out",
    "Function.sparsity_in",
    "Function.sparsity_out",
    "Function.name_in",
    "Function.index_in",
    "GenSharedObject.__hash__",
    "SharedObject.__hash__",
}
CLASSES = ("DM.", "GenDM.", "Sparsity.", "GenSparsity.", "FunctionBuffer.", "MatrixCommon.")
HELPERS = ("_", "<", "FunctionBuffer", "DM_from_", "full")


@contextmanager
def casadi_calls():
    """Yield a list of the calls into CasADi that build something, in the order of the calls."""
    built = []

    def look(frame, event, _):
        code = frame.f_code
        if event != "call" or not code.co_filename.endswith("casadi/casadi.py"):
            return
        name = code.co_qualname
        known = name in EVALUATING or name.startswith((*CLASSES, *HELPERS))
        if not known and not code.co_name.startswith("_"):
            built.append(name)
        if code.co_name == "__init__" and name.startswith(("Function.", "SX.", "MX.", "CodeGen")):
            built.append(name)

    sys.setprofile(look)
    try:
        yield built
    finally:
        sys.setprofile(None)


RUNS = {
    "rk4": {"method": "rk4", "step": 1e-3},
    "dop853": {"method": "dop853", "tolerance": 1e-8},
    "energy_momentum by step": {"method": "energy_momentum", "step": 2e-3},
    "energy_momentum by tolerance": {"method": "energy_momentum", "tolerance": 1e-5},
    "cvodes": {"method": "cvodes", "tolerance": 1e-6},
    "auto": {},
}


@pytest.fixture
def model():
    return tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))


@pytest.mark.parametrize("options", RUNS.values(), ids=RUNS)
def test_a_second_run_builds_nothing(model, options):
    prism = model.structure
    lengths = rest_lengths(prism, paper_force_density(45.0), 100.0)
    other = rest_lengths(prism, paper_force_density(9.0), 100.0)
    with casadi_calls() as first:
        tc.simulate(model, 0.05, rest_length=lengths, **options)
    assert first
    push = np.outer([0.1, 0.0, 0.2], np.ones(6))
    with casadi_calls() as second:
        run = tc.simulate(model, 0.08, rest_length=other, velocities=push, **options)
    assert second == []
    assert run.time[-1] == pytest.approx(0.08)
    fresh = tc.Model(prism, strings=tc.LinearStrings(100.0))
    same = tc.simulate(fresh, 0.08, rest_length=other, velocities=push, **options)
    np.testing.assert_array_equal(run.nodes, same.nodes)
    assert run.work == same.work


@pytest.mark.parametrize("options", [RUNS["rk4"], RUNS["dop853"]])
def test_a_second_closed_loop_builds_nothing(options):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    plant = tc.linearize(
        model, tc.prestress(tc.prism(), force_density=17.3205), input="rest_length"
    )
    controller = tc.LQR(plant)
    run = partial(tc.simulate, model, controller=controller, sample_time=0.01, **options)
    run(0.05)
    push = np.outer([0.0, 0.1, 0.0], np.ones(6))
    with casadi_calls() as second:
        run(0.13, velocities=push)
    assert second == []


@pytest.mark.parametrize("input", ["force_density", "rest_length"])
def test_a_second_linearization_builds_nothing(input):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0), external_force=True)
    shape = prism.nodes
    points = [
        tc.OperatingPoint(shape, np.full(9, gamma), load * np.ones((3, 6)))
        for gamma, load in ((10.0, 0.0), (12.0, 0.3))
    ]
    linearized = partial(tc.linearize, input=input, require_equilibrium=False)
    linearized(model, points[0])
    with casadi_calls() as second:
        plant = linearized(model, points[1])
    assert second == []
    fresh = tc.Model(prism, strings=tc.LinearStrings(100.0), external_force=True)
    same = linearized(fresh, points[1])
    np.testing.assert_array_equal(plant.A, same.A)
    np.testing.assert_array_equal(plant.B, same.B)


def test_another_load_is_another_equation():
    """Otherwise the second run would fall as the first does."""
    model = tc.Model(tc.prism(), external_force=True)
    down = np.outer([0.0, 0.0, -1.0], np.ones(6))
    runs = [
        tc.simulate(model, 0.1, force_density=0.0, external_force=load, step=1e-2)
        for load in (down, -down)
    ]
    np.testing.assert_allclose(
        runs[0].nodes[2, :, -1] - tc.prism().nodes[2],
        tc.prism().nodes[2] - runs[1].nodes[2, :, -1],
        rtol=1e-9,
    )


def test_the_store_is_bounded():
    store = Prepared()
    for key in range(100):
        assert store.get(key, lambda key=key: [key]) == [key]
    assert len(store._kept) == 32
    assert store.get(99, list) == [99]
    assert store.get(0, list) == []


def test_copies_and_pickles_start_empty():
    store = Prepared()
    store.get("a", lambda: 1)
    assert not copy.deepcopy(store)._kept
    assert not pickle.loads(pickle.dumps(store))._kept


def test_threads_that_share_a_model_get_the_same_motion(model):
    lengths = rest_lengths(model.structure, paper_force_density(9.0), 100.0)
    starts = [np.outer([0.1 * i, 0.0, 0.0], np.ones(6)) for i in range(4)]

    def run(start, method):
        return tc.simulate(model, 0.1, rest_length=lengths, velocities=start, method=method).nodes

    for method in ("dop853", "cvodes"):
        expected = [run(start, method) for start in starts]
        found = [None] * len(starts)

        def work(i, found=found, method=method):
            found[i] = run(starts[i], method)

        threads = [threading.Thread(target=work, args=(i,)) for i in range(len(starts))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)
