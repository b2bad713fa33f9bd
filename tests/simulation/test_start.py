"""Runs that go on from runs, and starts that are off by a little."""

from types import SimpleNamespace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.interrupt import InterruptionWarning
from tests.dynamics.scenes import paper_force_density, rest_lengths

SAMPLE = 0.02
FIXED = ("rk4", "energy_momentum")


@pytest.fixture(scope="module")
def example():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    rest = tc.prestress(prism, force_density=17.3205)
    plant = tc.linearize(model, rest, input="rest_length")
    nodes = plant.to_nodes(0.01 * np.random.default_rng(0).normal(size=9))
    return SimpleNamespace(model=model, lengths=lengths, rest=rest, plant=plant, nodes=nodes)


def same(parts, whole, tolerance=0.0):
    """The second part is the end of the whole run, to the last bit or to a tolerance."""
    count = len(parts.time)
    np.testing.assert_allclose(parts.time, whole.time[-count:], rtol=1e-12)
    for name, first in (("nodes", 0), ("velocities", 0), ("force_density", 1)):
        found, expected = getattr(parts, name), getattr(whole, name)[..., -count:]
        # γ is that of the step to each time: there is none to the first.
        np.testing.assert_allclose(found[..., first:], expected[..., first:], 0, tolerance)


@pytest.mark.parametrize("method", FIXED)
def test_fixed_steps_go_on_to_the_last_bit(example, method):
    options = {"method": method, "step": 1e-3, "output_step": 0.05}
    whole = tc.simulate(example.model, 1.5, rest_length=example.lengths, **options)
    first = tc.simulate(example.model, 0.5, rest_length=example.lengths, **options)
    assert whole.work.switches or method == "energy_momentum"
    same(tc.simulate(example.model, 1.0, start=first, **options), whole)


@pytest.mark.parametrize("method", ["dop853", "cvodes"])
def test_steps_of_their_own_go_on_to_the_tolerance(example, method):
    options = {"method": method, "tolerance": 1e-10, "output_step": 0.05}
    whole = tc.simulate(example.model, 1.0, rest_length=example.lengths, **options)
    first = tc.simulate(example.model, 0.5, rest_length=example.lengths, **options)
    same(tc.simulate(example.model, 0.5, start=first, **options), whole, 1e-5)


def test_force_densities_and_cut_strings_stay(example):
    gamma, cut = paper_force_density(9.0), [tc.CutString(4, time=0.3), tc.CutString(6, time=0.7)]
    options = {"step": 1e-3, "output_step": 0.1}
    whole = tc.simulate(example.model, 1.0, force_density=gamma, faults=cut, **options)
    first = tc.simulate(example.model, 0.5, force_density=gamma, faults=cut, **options)
    more = tc.simulate(example.model, 0.5, start=first, **options)
    same(more, whole, 1e-13)
    assert more.force_density[[4, 6], -1].tolist() == [0, 0]


def controllers(example):
    winches = tc.Winches(rate=0.05, substeps=4)
    force = tc.linearize(example.model, example.rest)
    Q, R = tc.energy_weights(force)
    return {
        "lqr": (tc.LQR(force, Q, 0.1 * R, sample_time=SAMPLE, max_force_density=90.0), None),
        "mpc": (tc.MPC(example.plant, sample_time=SAMPLE, horizon=10, winches=winches), winches),
        "nmpc": (tc.NMPC(example.plant, sample_time=SAMPLE, horizon=5), None),
    }


@pytest.mark.parametrize("name", ["mpc", "nmpc"])
def test_a_controller_goes_on(example, name):
    """With its memory, its winches, stuck ones too, and the noise of the sensors."""
    controller, winches = controllers(example)[name]
    sensors = tc.Sensors(
        structure=example.model.structure, delay=2, string_length=1e-3, bar_direction=1e-2,
        node_position=2e-3, string_tension=0.1,
    )  # fmt: skip
    estimator = tc.KalmanFilter(example.plant, sensors, sample_time=SAMPLE, winches=winches)
    faults = [tc.StuckWinch(3, time=0.1, until=0.5), tc.LostMeasurement(0.34, until=0.38)]
    options = {"controller": controller, "estimator": estimator, "winches": winches, "step": 5e-3}
    start = {"nodes": example.nodes, "rest_length": example.plant.rest_length, "faults": faults}
    whole = tc.simulate(example.model, 0.8, seed=3, **start, **options)
    first = tc.simulate(example.model, 0.4, seed=3, **start, **options)
    more = tc.simulate(example.model, 0.4, start=first, seed=3, **options)
    same(more, whole)
    for record, other in (
        (more.control, whole.control),
        (more.control.estimate, whole.control.estimate),
    ):
        for part in ("time", "command", "applied", "winch_rate", "nodes", "state", "measurement"):
            if hasattr(record, part):
                values = getattr(other, part)[..., 20:]
                np.testing.assert_array_equal(getattr(record, part), values)


def test_an_interrupted_run_goes_on(example):
    controller, _ = controllers(example)["mpc"]
    decide, calls = controller._decide, []

    def pressed(*arguments):
        calls.append(arguments)
        if len(calls) == 11:
            raise KeyboardInterrupt
        return decide(*arguments)

    options = {"controller": controller, "step": 5e-3, "rest_length": example.plant.rest_length}
    whole = tc.simulate(example.model, 0.4, example.nodes, **options)
    controller._decide = pressed
    with pytest.warns(InterruptionWarning):
        first = tc.simulate(example.model, 0.4, example.nodes, **options)
    del options["rest_length"]
    assert first.time[-1] == pytest.approx(0.2)
    same(tc.simulate(example.model, 0.2, start=first, **options), whole, 1e-9)


def test_another_controller_begins_where_the_winches_stand(example):
    controller, winches = controllers(example)["mpc"]
    first = tc.simulate(example.model, 0.3, rest_length=example.lengths, step=1e-3)
    more = tc.simulate(
        example.model, 0.1, start=first, controller=controller, winches=winches, step=1e-3
    )
    assert more.control.time[0] == pytest.approx(0.3)
    reach = 0.05 * SAMPLE + 1e-12
    assert np.abs(more.control.applied[:, 0] - example.lengths).max() <= reach


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"start": "run"}, TypeError, "start is a str"),
        ({"nodes": tc.prism().nodes}, ValueError, "start gives nodes and velocities"),
        ({"model": tc.Model(tc.prism(4))}, ValueError, "start is a run of"),
        ({"model": tc.Model(tc.prism(height=1.1))}, ValueError, "start is a run of"),
    ],
)
def test_what_does_not_fit_is_refused(example, options, error, message):
    first = tc.simulate(example.model, 0.01, rest_length=example.lengths, step=1e-3)
    given = {"model": example.model, "start": first, "step": 1e-3, **options}
    with pytest.raises(error, match=message):
        tc.simulate(duration=0.01, **given)


# ---- starts that are off ----


def moved(example, nodes, velocities, **options):
    """Return a run from a motion given as arrays."""
    return tc.simulate(example.model, 0.01, nodes, velocities, rest_length=example.lengths,
                       step=1e-3, **options)  # fmt: skip


@pytest.mark.parametrize("speed", [1e-15, 1e-9, 1e-3])
def test_a_last_state_near_rest_is_a_start(example, speed):
    """Velocities that are round-off of what forces do to the structure are no mistake."""
    gamma = example.rest.force_density
    lengths = tc.to_rest_length(example.model, example.model.structure.nodes, gamma).rest_length
    damped = tc.Model(example.model.structure, strings=tc.LinearStrings(100.0, damping=2.0))
    push = speed * np.random.default_rng(0).normal(size=example.model.structure.nodes.shape)
    V = example.plant.to_velocities(np.zeros(9), example.plant.measure(example.nodes, push)[9:])
    run = tc.simulate(damped, 2.0, None, V, rest_length=lengths, step=1e-3)
    last = run.nodes[:, :, -1], run.velocities[:, :, -1]
    assert tc.simulate(damped, 0.1, *last, rest_length=lengths, step=1e-3).note is None


@pytest.mark.parametrize("step", [5e-3, 1e-2])
def test_the_last_state_of_rk4_is_projected(example, step):
    """Its bars drift; the run from there says that they were made rigid."""
    run = tc.simulate(example.model, 0.5, rest_length=example.lengths, step=step)
    assert np.abs(run.bar_length_error[:, -1]).max() > 1e-9
    more = moved(example, run.nodes[:, :, -1], run.velocities[:, :, -1])
    assert np.abs(more.bar_length_error[:, 0]).max() < 1e-15
    assert "bars made rigid: off by" in more.note
    assert more.note in more.summary()
    assert np.abs(more.nodes[:, :, 0] - run.nodes[:, :, -1]).max() < 1e-4
    assert tc.simulate(example.model, 0.1, start=run, step=step).note is None


def test_a_load_does_not_matter(example):
    """The speed that bars may stretch at is found without it."""
    model = tc.Model(example.model.structure, strings=example.model.strings, external_force=True)
    load = {"external_force": np.zeros((3, 6)), "rest_length": example.lengths}
    run = tc.simulate(model, 0.5, step=5e-3, **load)
    last = run.nodes[:, :, -1], run.velocities[:, :, -1]
    assert "bars made rigid" in tc.simulate(model, 0.01, *last, step=1e-3, **load).note


def test_what_is_accepted_as_it_is_is_not_touched(example):
    """Within a hundred-millionth, as it always was."""
    nodes = example.model.structure.nodes * (1 + 5e-9)
    assert np.array_equal(moved(example, nodes, None).nodes[:, :, 0], nodes)


def test_a_measured_motion_is_projected_and_the_note_says_by_how_much(example):
    rng, structure = np.random.default_rng(0), example.model.structure
    N = structure.nodes + 5e-3 * rng.normal(size=(3, 6))
    V = 0.01 * rng.normal(size=(3, 6))
    run = moved(example, N, V)
    exact = tc.structure.restore_bar_lengths(structure, N)
    np.testing.assert_allclose(run.nodes[:, :, 0], exact, rtol=0, atol=1e-12)
    assert np.abs(run.bar_length_error[:, 0]).max() < 1e-14
    bars, rates = (structure.bar_vectors(part[:, :, 0]) for part in (run.nodes, run.velocities))
    assert np.abs((bars * rates).sum(axis=0)).max() < 1e-15
    after = run.velocities[:, :, 0].sum(axis=1)  # all bars have one mass
    np.testing.assert_allclose(after, V.sum(axis=1), rtol=0, atol=1e-12)
    assert f"moved by up to {np.abs(exact - N).max():.1e} m and" in run.note


def test_more_is_refused(example):
    nodes = example.model.structure.nodes
    with pytest.raises(ValueError, match="in nodes, bar 0 has length"):
        moved(example, nodes * 1.06, None)
    stretch = np.zeros_like(nodes)
    stretch[2, 0] = 0.5
    with pytest.raises(ValueError, match=r"velocities stretch bar 0 at 0\.36 m/s"):
        moved(example, nodes, stretch)
