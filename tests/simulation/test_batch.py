"""Many runs at once: the same numbers as one by one, and what becomes of single runs."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import compiler, pack_state, unpack_states
from tenscontrol.integrate import Projector

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")

RUNS = 6


def thrown(structure, speed, seed=0):
    """Nodes and velocities of runs that start in the reference shape."""
    rng = np.random.default_rng(seed)
    equation = tc.Model(structure).equation("force_density")
    at_rest = pack_state(structure, structure.nodes, 0 * structure.nodes)
    states = np.tile(at_rest[:, None], RUNS)
    half = len(at_rest) // 2
    states[half:] = speed * rng.standard_normal((half, RUNS))
    N, V = unpack_states(structure, Projector(equation, True)(states))
    return np.moveaxis(N, 2, 0), np.moveaxis(V, 2, 0)


def scene(structure, seed=1):
    """Starts and rest lengths of which some strings go slack."""
    N, V = thrown(structure, 0.8)
    rng = np.random.default_rng(seed)
    factors = rng.uniform(0.92, 1.0, (RUNS, len(structure.strings)))
    return N, V, factors * structure.string_length(structure.nodes)


STRUCTURES = {
    "prism": tc.prism,
    "supported": lambda: replace(tc.prism(), fixed=[3]),
    "planar": tc.library.d_bar,
    "class 2": lambda: tc.library.class2_tower(1),
}


def assert_same(batch, runs):
    """Every number of the batch is that of the run by itself."""
    for i, run in enumerate(runs):
        at = np.searchsorted(run.time, batch.time - 1e-12)
        assert np.array_equal(batch.nodes[i], run.nodes[:, :, at])
        assert np.array_equal(batch.velocities[i], run.velocities[:, :, at])
        assert batch.switches[i] == run.work.switches
    assert batch.completed.all()
    assert not batch.messages


@pytest.mark.parametrize("method", [{}, {"method": "rattle"}, {"step": None, "tolerance": 1e-5}])
@pytest.mark.parametrize("name", STRUCTURES)
def test_a_batch_has_the_bits_of_single_runs(name, method):
    structure = STRUCTURES[name]()
    N, V, lengths = scene(structure)
    model = tc.Model(structure, strings=tc.LinearStrings(100.0))
    how = {"step": 0.01, "output_step": 0.1} | method
    batch = tc.simulate_many(
        model, 0.3, N, V, rest_length=lengths, machine_code=False, threads=1, **how
    )
    runs = [tc.simulate(model, 0.3, N[i], V[i], rest_length=lengths[i], **how) for i in range(RUNS)]
    assert batch.switches.sum() > 0
    assert_same(batch, runs)


@needs_compiler
@pytest.mark.parametrize("method", ["rk4", "rattle"])
def test_lanes_have_the_bits_of_single_runs(method):
    prism = tc.prism()
    N, V, lengths = scene(prism)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    how = {"method": method, "step": 0.01, "output_step": 0.1}
    batch = tc.simulate_many(model, 0.3, N, V, rest_length=lengths, threads=2, **how)
    assert "runs an instruction" in batch.choice.back_end
    assert batch.switches.sum() > 10
    runs = [tc.simulate(model, 0.3, N[i], V[i], rest_length=lengths[i], **how) for i in range(RUNS)]
    assert_same(batch, runs)
