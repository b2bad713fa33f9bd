"""Switches within steps that are not cut, against converged motions."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.benchmarks.rk4_peers import numpy_rk4
from tests.benchmarks.towers import simulated, tower
from tests.marks import needs_core

pytestmark = needs_core


@pytest.fixture(scope="module")
def case():
    return tower(8)


@pytest.fixture(scope="module")
def exact(case):
    run = simulated(case, method="dop853", tolerance=1e-11, error="none")
    assert run.work.switches > 60
    return run


def off(run, exact):
    return np.linalg.norm(run.nodes[:, :, -1] - exact.nodes[:, :, -1], axis=0).max()


def test_fixed_steps_keep_their_order_through_carried_switches(case, exact):
    errors = []
    for step in (2e-3, 1e-3, 5e-4, 2.5e-4):
        run = simulated(case, method="rk4", step=step, error="none")
        assert run.work.switches == exact.work.switches
        assert run.work.missed == 0
        errors.append(off(run, exact))
    assert run.work.carried < exact.work.switches
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert orders.mean() > 3.2  # of naive steps 2


def test_plain_steps_are_those_of_numpy(case):
    run = simulated(case, method="rk4_plain", step=4e-3, error="none")
    naive = numpy_rk4(case, np.array([case.duration]), [4e-3]).prepare(4e-3)()
    assert np.allclose(run.nodes[:, :, -1], naive[:, :, -1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("step", [4e-3, 2e-3])
def test_located_steps_are_no_worse_than_plain_ones(case, exact, step):
    run = simulated(case, method="rk4", step=step, error="none")
    assert run.work.carried > 0
    assert off(run, exact) < off(simulated(case, method="rk4_plain", step=step), exact)


def test_the_error_follows_the_tolerance(case, exact):
    runs = [simulated(case, tolerance=tolerance) for tolerance in (1e-2, 1e-3, 1e-4, 1e-5)]
    size = float(np.ptp(case.model.structure.nodes, axis=1).max())
    for run in runs:
        assert off(run, exact) < 3 * run.error[-1] * size
        assert run.work.switches == pytest.approx(exact.work.switches, rel=0.03)
    assert [run.work.carried > 0 for run in runs] == [False, False, True, True]
    assert off(runs[3], exact) < off(runs[1], exact) / 10
    assert runs[1].work.evaluations < simulated(case, tolerance=1e-10).work.evaluations / 2


def test_steps_too_long_for_their_switches_end_sooner(case, exact):
    """They are not taken again, and err no more for it."""
    for tolerance, most in ((1e-4, 3e-5), (1e-5, 3e-6)):
        run = simulated(case, method="dop853", tolerance=tolerance, error="none")
        assert run.work.carried > 30
        assert run.work.rejections < 0.1 * run.work.steps
        assert off(run, exact) < most


def test_what_carried_switches_do_by_moving_the_nodes_is_added():
    """Without it errors are 1.9e-5 and 1.6e-7 in the same steps."""
    case = tower(30)
    exact = simulated(case, method="dop853", tolerance=1e-11, error="none")
    for tolerance, most, evaluations in ((1e-4, 8e-6, 260), (1e-6, 1e-7, 700)):
        run = simulated(case, tolerance=tolerance, error="none")
        assert run.work.carried > 0.99 * run.work.switches
        assert run.work.evaluations < evaluations
        assert off(run, exact) < most


def test_outputs_within_steps_across_switches_are_as_good_as_the_ends():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    lengths = 0.98 * prism.string_length()
    lengths[::2] *= 1.03
    how = {"rest_length": lengths, "output_step": 1 / 300, "error": "none"}
    exact = tc.simulate(model, 1.0, tolerance=1e-11, **how)
    run = tc.simulate(model, 1.0, tolerance=1e-3, **how)
    assert run.work.switches > 10
    assert run.work.carried == 0
    distance = np.linalg.norm(run.nodes - exact.nodes, axis=0).max(axis=0)
    assert distance.max() < 2e-3
    assert distance.max() < 3 * np.maximum(distance[-30:].max(), 1e-4)
    start, end = prism.bars.T
    along = np.linalg.norm(run.nodes[:, end] - run.nodes[:, start], axis=0)
    assert np.abs(along / prism.bar_length[:, None] - 1).max() < 1e-12


def _elastic(structure):
    rest = tc.prestress(structure, min_force_density=5.0)
    return tc.ElasticStrings(100 * (rest.force_density * structure.string_length()).max())


def _clustered(structure):
    strings = [list(pair) for pair in structure.strings]
    first, second = next(
        (a, b) for a in strings for b in strings if a is not b and a[1] == b[0] and a[0] != b[1]
    )
    kept = [pair for pair in strings if pair not in (first, second)]
    return tc.Structure(
        structure.nodes, structure.bars, [*kept, [*first, second[1]]], structure.bar_mass
    )


@pytest.mark.parametrize("kind", ["elastic", "clustered", "moving load"])
def test_all_that_the_core_knows_can_be_carried(kind):
    tower = tc.prism_tower(8)
    structure = {
        "fixed": lambda: tc.Structure(
            tower.nodes, tower.bars, tower.strings, tower.bar_mass, fixed=[0, 1, 2]
        ),
        "clustered": lambda: _clustered(tower),
        "payload": lambda: tc.Structure(
            tower.nodes, tower.bars, tower.strings, tower.bar_mass,
            point_mass=np.where(np.arange(tower.nodes.shape[1]) % 5 == 0, 0.5, 0.0),
        ),
    }.get(kind, lambda: tower)()  # fmt: skip
    law = _elastic(tower) if kind == "elastic" else tc.LinearStrings(5e3)
    model = tc.Model(structure, strings=law, external_force=kind == "moving load")
    lengths = 0.998 * structure.string_length()
    lengths[::7] *= 0.97
    how = {"rest_length": lengths, "output_step": 0.05, "error": "none"}
    if kind == "moving load":
        pull = np.random.default_rng(0).normal(size=tower.nodes.shape)
        loads = np.stack([np.zeros_like(pull), 20 * pull], axis=-1)
        how["external_force"] = tc.Profile([0, 0.1], loads)
    exact = tc.simulate(model, 0.1, tolerance=1e-11, **how)
    for settings, most in (({"tolerance": 1e-4}, 1e-4), ({"method": "rk4", "step": 2e-3}, 3e-4)):
        run = tc.simulate(model, 0.1, **settings, **how)
        assert run.work.carried > 0
        assert np.abs(run.nodes - exact.nodes).max() < most
