"""Lengths of bars as the input: derivatives by an oracle, LQR and MPC in closed loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.plant.linear_plant import sampled
from tests.oracle import consistent_mass, free_rows, node_acceleration, string_motion

STIFFNESS, DAMPING, STEP = 300.0, 2.0, 1e-5
RAMP = tc.Winches(ramp=True, rate=2.0, shortest=1.0, longest=1.8)


def _plant(structure, coordinates="internal", actuated=None):
    model = tc.Model(structure, tc.LinearStrings(STIFFNESS, DAMPING))
    rest = tc.prestress(structure, min_force_density=20.0)
    return tc.linearize(model, rest, "bar_length", coordinates, actuated=actuated)


@pytest.fixture(scope="module")
def plant():
    """A prism on three fixed nodes, whose bars are struts."""
    return _plant(replace(tc.prism(), fixed=[3, 4, 5]))


def _displacements(structure, nodes):
    """``M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ L̂``, dense."""
    d, rows = len(nodes), free_rows(structure)
    J, B = np.zeros((len(structure.bars), nodes.size)), structure.bar_vectors(nodes)
    for row, (start, end), b in zip(J, structure.bars, B.T, strict=True):
        row[d * start : d * start + d] -= b
        row[d * end : d * end + d] += b
    M = np.kron(consistent_mass(structure), np.eye(d))[np.ix_(rows, rows)]
    along = np.linalg.solve(M, J[:, rows].T)
    E = np.zeros((nodes.size, len(J)))
    E[rows] = along @ np.linalg.solve(J[:, rows] @ along, np.diag(np.linalg.norm(B, axis=0)))
    return E


@pytest.mark.parametrize("kind", ["on supports", "joined"])
def test_derivatives_are_those_of_an_independent_model(plant, kind):
    """By central differences of accelerations by multipliers, of lengths and of their rates."""
    if kind == "joined":
        joined = tc.library.d_bar_3d()
        model = tc.Model(joined, tc.LinearStrings(STIFFNESS, DAMPING))
        rest = tc.prestress(joined, min_force_density=20.0)
        plant = tc.linearize(model, rest, "bar_length", "minimal")
    model, nodes, r = plant.model, plant.nodes, plant.degrees_of_freedom
    structure = model.structure

    def moved(N, V):
        length, rate = string_motion(structure, N, V)
        tension = STIFFNESS * (length - plant.rest_length) + DAMPING * rate
        a, _ = node_acceleration(structure, N, V, tension / length, model.constant_force)
        return plant.coordinates.project(a.T.ravel())

    E = _displacements(structure, nodes)
    np.testing.assert_allclose(plant.input_displacements, E, atol=1e-13)
    by_length, by_rate = [], []
    for column in STEP * E.T:
        shift = column.reshape(nodes.T.shape).T
        by_length.append(moved(nodes + shift, 0 * nodes) - moved(nodes - shift, 0 * nodes))
        by_rate.append(moved(nodes, shift) - moved(nodes, -shift))
    for found, true in ((plant.B, by_length), (plant.rate_input, by_rate)):
        true = np.array(true).T / (2 * STEP)
        np.testing.assert_allclose(found[r:], true, atol=1e-8 * np.abs(true).max())
        assert not found[:r].any()


def test_lqr_closes_the_loop_that_it_predicts(plant):
    """The discrete plant, poles and ramps, against the nonlinear loop near the operating point."""
    regulator = tc.LQR(plant, sample_time=0.02, winches=RAMP)
    assert np.abs(regulator.poles).max() < 0.985
    A, B = sampled(plant, 0.02, True).augmented
    K = np.hstack([regulator.gain, regulator.previous_input_gain])
    np.testing.assert_allclose(
        np.sort(np.abs(np.linalg.eigvals(A - B @ K))), np.sort(np.abs(regulator.poles)), atol=1e-6
    )
    start = plant.to_nodes(1e-6 * np.arange(1.0, 7.0))
    x = np.r_[plant.measure(start, 0 * start), np.zeros(3)]
    run = tc.simulate(
        plant.model, 0.1, nodes=start, controller=regulator, winches=RAMP, tolerance=1e-12
    )
    for _ in range(5):
        x = (A - B @ K) @ x
    z = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
    np.testing.assert_allclose(z, x[:12], atol=3e-5 * np.abs(x[:12]).max())
    grown = run.struts.length[:, -1] - plant.equilibrium_input
    np.testing.assert_allclose(grown, x[12:], atol=3e-5 * np.abs(x[12:]).max())
    assert run.struts.bar.tolist() == [0, 1, 2]
    assert run.control.applied.shape == (3, 5)


def test_drives_keep_to_their_rates_and_strokes(plant):
    slow = tc.Winches(ramp=True, rate=0.05, shortest=1.38, longest=1.4)
    regulator = tc.LQR(plant, sample_time=0.02, winches=RAMP)  # which does not know it
    start = plant.to_nodes(0.03 * np.arange(1.0, 7.0))
    run = tc.simulate(
        plant.model, 0.2, nodes=start, controller=regulator, winches=slow, error="none"
    )
    assert np.abs(run.struts.rate).max() <= 0.05 * (1 + 1e-9)
    assert 1.38 <= run.struts.length.min() <= run.struts.length.max() <= 1.4
    assert run.control.rate_limited.any()
    assert run.health.bar_length_error < 1e-12


@pytest.fixture(scope="module")
def extension(plant):
    """Shapes at rest of the prism while its bars grow from 0.97 of their lengths."""
    shapes, nodes = [], plant.nodes
    for share in (1.0, 0.985, 0.97):
        longer = nodes.copy()
        for start, end in plant.model.structure.bars:
            foot, tip = (start, end) if start in plant.model.structure.fixed else (end, start)
            vector = nodes[:, tip] - nodes[:, foot]
            length = share * plant.model.structure.bar_length[0]
            longer[:, tip] = nodes[:, foot] + vector / np.linalg.norm(vector) * length
        grown = plant.model.replace(structure=replace(plant.model.structure, nodes=longer))
        nodes = tc.equilibrium(grown, rest_length=plant.rest_length).structure.nodes
        shapes.insert(0, nodes)
    return tc.Reference([0.1, 0.4, 0.7], np.stack(shapes, axis=-1))


def test_mpc_deploys_along_shapes_of_other_lengths(plant, extension):
    mpc = tc.MPC(
        plant, horizon=10, sample_time=0.05, winches=RAMP, reference=extension,
        min_force_density=1.0,
    )  # fmt: skip
    start = extension.nodes[:, :, 0]
    short = np.linalg.norm(plant.model.structure.bar_vectors(start), axis=0)
    run = tc.simulate(plant.model, 1.2, nodes=start, bar_length=short, controller=mpc, winches=RAMP)
    assert set(run.control.status_count) == {"ok"}
    assert np.abs(run.nodes[:, :, -1] - plant.nodes).max() < 1e-3
    np.testing.assert_allclose(run.struts.length[:, -1], plant.equilibrium_input, atol=1e-3)
    assert run.control.tracking_error.max() < 0.02
    # Of the rest in the first shape, nothing moves.
    still = tc.MPC(plant, horizon=10, sample_time=0.05, winches=RAMP, reference=start)
    command = still.command(0.0, start, 0 * start).value
    np.testing.assert_allclose(command, short, atol=1e-6)


REFUSED = {
    "jump": (lambda plant: tc.LQR(plant), "lengths of bars cannot jump"),
    "step": (lambda plant: tc.MPC(plant, horizon=5, sample_time=0.02), "cannot jump"),
    "NMPC": (lambda plant: tc.NMPC(plant, horizon=5, sample_time=0.02), "NMPC takes no plant"),
    "reduce": (lambda plant: tc.plant.reduce(plant, modes=3), "reduce takes no plant"),
    "bounds": (
        lambda plant: tc.LQR(plant, sample_time=0.02, winches=RAMP, max_force_density=9.0),
        "winches limit bar lengths",
    ),
    "outputs": (
        lambda plant: tc.MPC(
            plant, horizon=5, sample_time=0.02, winches=RAMP,
            outputs=[tc.OutputLimit(np.eye(18), high=2.0)],
        ),
        "outputs is of nodes",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_know_bars_refuses_by_name(plant, case):
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        call(plant)


def test_bars_that_are_not_driven_keep_their_lengths(plant):
    few = _plant(plant.model.structure, actuated=[0, 2])
    assert few.input_names == ["bar_length_bar[0]", "bar_length_bar[2]"]
    np.testing.assert_array_equal(few.B, plant.B[:, [0, 2]])
    longer = plant.nodes.copy()
    longer[2, 1] += 0.05
    with pytest.raises(ValueError, match="the drives of the plant leave it at"):
        tc.MPC(few, horizon=5, sample_time=0.02, winches=RAMP, reference=longer)
    pair = _plant(plant.model.structure, actuated={"pair": [0, 2]})
    np.testing.assert_allclose(pair.B[:, 0], plant.B[:, 0] + plant.B[:, 2])
