"""Simulation of planar structures, shared nodes, rollers, payloads and clustered strings."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.integrate.methods import METHODS
from tests.integrate import coupled_scenes
from tests.integrate.coupled_scenes import SCENES, possible_velocities


def snelson_x():
    """Two bars crossed in the plane, four strings around them."""
    nodes = [[0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]]
    return tc.Structure(nodes, [[0, 2], [1, 3]], [[0, 1], [1, 2], [2, 3], [3, 0]], bar_mass=1.0)


def pulley():
    """A cable from a wall over the tip of a swinging bar to a payload."""
    nodes = [[0.0, 1.0, 2.0, 1.5], [0.0, 0.2, 0.0, -1.0]]
    return tc.Structure(
        nodes, [[0, 1]], [(0, 3), (2, 1, 3)], 1.0, fixed=[0, 2], point_mass=[0, 0, 0, 2.0]
    )


EVERY = {**SCENES, "snelson_x": snelson_x, "pulley": pulley}
LAW = tc.LinearStrings(100.0)


@pytest.mark.parametrize(
    ("name", "held"),
    [*((name, "rest_length") for name in EVERY), ("arm", "force_density")],
)  # fmt: skip
def test_every_method_simulates_it(name, held):
    structure = EVERY[name]()
    model = tc.Model(structure, strings=LAW, gravity=1.0)
    start = possible_velocities(structure, size=0.2)
    count = len(structure.strings)
    given = {held: np.full(count, 5.0) if held == "force_density" else structure.string_length()}
    found = {}
    for name, method in METHODS.items():
        accuracy = {"step": 2e-3} if method.setting == "step" else {"tolerance": 1e-9}
        run = tc.simulate(model, 0.1, None, start, method=name, **accuracy, **given)
        assert run.nodes.shape[:2] == structure.nodes.shape
        assert run.momentum.shape == (structure.dimension, len(run.time))
        assert len(run.angular_momentum) == (1 if structure.dimension == 2 else 3)
        assert run.health.bar_length_error < 1e-7
        assert run.health.energy_error < 1e-3
        found[name] = run.nodes[:, :, -1]
    for name, off in {"energy_momentum": 5e-5, "cvodes": 1e-6, "rk4": 1e-8}.items():
        np.testing.assert_allclose(found[name], found["dop853"], rtol=0, atol=off)


def test_the_figures_of_a_run_in_the_plane():
    """Momenta and energies by NumPy; what holds a structure takes its momentum."""
    structure = coupled_scenes.d_bar(point_mass=[0, 0.5, 0, 0])
    run = tc.simulate(
        tc.Model(structure, strings=LAW), 0.5, None, possible_velocities(structure),
        rest_length=structure.string_length(), method="energy_momentum", step=1e-3,
    )  # fmt: skip
    M = tc.structure.blocks.node_mass(structure).toarray()
    momenta = np.einsum("int,nm->imt", run.velocities, M)
    np.testing.assert_allclose(run.momentum, momenta.sum(axis=1), atol=1e-14)
    turning = (run.nodes[0] * momenta[1] - run.nodes[1] * momenta[0]).sum(axis=0)
    np.testing.assert_allclose(run.angular_momentum[0], turning, atol=1e-14)
    kinetic = (run.velocities * momenta).sum(axis=(0, 1)) / 2
    np.testing.assert_allclose(run.kinetic_energy, kinetic, rtol=1e-13)
    assert run.conserves_momentum
    assert run.health.momentum_change < 1e-14
    assert run.health.angular_momentum_change < 1e-14
    total = structure.bar_mass.sum() + 0.5
    largest = run.health.momentum_change * np.sqrt(2 * total * kinetic.max())
    moved = np.abs(run.momentum - run.momentum[:, :1]).max()
    assert largest == pytest.approx(moved)
    rolling = tc.Structure(structure.nodes, structure.bars, structure.strings, 1.0,
                           fixed=[(0, "y")])  # fmt: skip
    held = tc.simulate(tc.Model(rolling), 0.1, force_density=5.0)
    assert not held.conserves_momentum


def test_a_run_in_two_parts_is_that_in_one():
    structure = coupled_scenes.mixed()
    model = tc.Model(structure, strings=LAW)
    given = {"rest_length": structure.string_length(), "method": "rk4", "step": 2e-3}
    start = possible_velocities(structure)
    whole = tc.simulate(model, 0.2, None, start, **given)
    first = tc.simulate(model, 0.1, None, start, **given)
    second = tc.simulate(model, 0.1, start=first, method="rk4", step=2e-3)
    np.testing.assert_array_equal(second.nodes[:, :, -1], whole.nodes[:, :, -1])


def test_a_start_that_is_a_little_off_is_projected():
    structure = coupled_scenes.tower()
    model = tc.Model(structure)
    off = structure.nodes + 1e-5 * np.random.default_rng(0).normal(size=structure.nodes.shape)
    run = tc.simulate(model, 0.01, off, force_density=1.0)
    assert "bars made rigid" in run.note
    assert run.health.bar_length_error < 1e-13
    assert np.abs(run.nodes[:, :, 0] - off).max() < 1e-4


def _moved(row, column, by):
    nodes = coupled_scenes.arm().nodes.copy()
    nodes[row, column] += by
    return nodes


def _speed(row, column):
    velocities = np.zeros((2, 4))
    velocities[row, column] = 0.3
    return velocities


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"nodes": _moved(1, 2, 0.3)}, r"in nodes, bar 1 has length .*restore_bar_lengths"),
        ({"nodes": _moved(1, 2, 1e-4)}, r"in nodes, node 2 is 0.0001 m off its roller, which"),
        ({"nodes": _moved(0, 3, 1e-4)}, r"in nodes, the fixed node 3 is 0.0001 m from"),
        ({"velocities": _speed(1, 2)}, r"velocities move node 2, on a roller, by 0.3 m/s along y"),
        ({"velocities": _speed(0, 0)}, r"velocities move the fixed node 0"),
        ({"velocities": _speed(0, 2)}, r"velocities stretch bar 1 at 0\.\d+ m/s, expected 0"),
        ({"nodes": np.zeros((3, 4))}, r"nodes has shape \(3, 4\), expected \(2, 4\)"),
    ],
)
def test_a_start_that_does_not_fit_is_refused(options, message):
    model = tc.Model(coupled_scenes.arm())
    with pytest.raises(ValueError, match=message):
        tc.simulate(model, 0.1, force_density=1.0, **options)


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_a_clustered_string_is_cut_whole(held):
    structure = coupled_scenes.arm()
    model = tc.Model(structure, strings=LAW)
    given = {held: 10.0 if held == "force_density" else 0.9 * structure.string_length()}
    cut = tc.CutString(string=1, time=0.1)
    run = tc.simulate(model, 0.2, faults=[cut], **given, step=1e-3)
    after = run.time > 0.1 + 1e-9
    assert (run.force_density[1, after] == 0).all()
    assert (run.force_density[1, ~after] > 0).all()
    assert run.released_energy[-1] > 0
    assert run.health.energy_error < 1e-6


def test_a_motion_that_cannot_go_on_is_an_error_with_the_motion_up_to_there():
    structure = coupled_scenes.d_bar()
    model = tc.Model(structure, strings=tc.LinearStrings(1e5))
    with pytest.raises(tc.simulation.SimulationError, match="no longer finite") as error:
        tc.simulate(model, 4.0, rest_length=0.5, method="rk4", step=0.05)
    assert np.isfinite(error.value.trajectory.nodes).all()
