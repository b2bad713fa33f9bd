"""Limits on the forces of bars in MPC: slopes by differences, loops that keep them, refusals."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import buckling
from tenscontrol.plant.bar_outputs import bar_map

METAL = tc.sizing.materials["aluminium"]


def sized(radius=0.006):
    return tc.sections(
        tc.prism(), bars=METAL, bar_radius=radius, strings=METAL, string_radius=0.0005
    )


def plants(kind):
    members = sized()
    structure = members.structure
    if kind == "joined":
        tower = tc.library.class2_tower(stages=2)
        structure = tc.Structure(tower.nodes, tower.bars, tower.strings, 0.2, fixed=[0, 1, 2])
    model = tc.Model(structure, tc.LinearStrings(2e3, damping=3.0), gravity=9.81 * (kind != "free"))
    if kind == "free":
        rest = tc.prestress(structure, force_density=20.0)
    else:
        rest = tc.equilibrium(model, rest_length=0.95 * structure.string_length())
    return model, rest


@pytest.mark.parametrize("kind", ["free", "joined"])
@pytest.mark.parametrize("input_", ["force_density", "rest_length"])
def test_slopes_are_those_of_the_forces_of_the_model(kind, input_):
    model, rest = plants(kind)
    plant = tc.linearize(model, rest, input=input_, coordinates="minimal")
    found, r = bar_map(plant), plant.degrees_of_freedom
    structure, free = model.structure, model.structure.free
    length = structure.bar_length

    def forces(z, v):
        nodes, speed = plant.to_nodes(z[:r]), (plant.basis @ z[r:]).reshape(-1, 3).T
        gamma = plant.force_density + v
        if input_ == "rest_length":
            S = structure.string_vectors(nodes)
            L = np.linalg.norm(S, axis=0)
            rate = (S * structure.string_vectors(speed)).sum(axis=0) / L
            gamma = (2e3 * (L - plant.rest_length - v) + 3.0 * rate) / L
        given = model.bar_force_density(nodes[:, free], speed[:, free], gamma)
        return np.array(given).ravel() * length

    rng = np.random.default_rng(0)
    z, v = rng.normal(size=2 * r), rng.normal(size=len(structure.strings))
    np.testing.assert_allclose(found.force, forces(0 * z, 0 * v), rtol=1e-9)
    h = 1e-5
    by_hand = (forces(h * z, h * v) - forces(-h * z, -h * v)) / (2 * h)
    slope = found.by_state @ z + found.by_input @ v
    np.testing.assert_allclose(slope, by_hand, atol=1e-6 * np.abs(by_hand).max())


def moved(limits, **options):
    """A prism that goes to a lower shape, and the forces of its bars on the way."""
    members = sized()
    model = tc.Model(members.structure, tc.LinearStrings(500.0, damping=2.0))
    rest = tc.prestress(members.structure, force_density=30.0)
    plant = tc.linearize(model, rest, input="rest_length")
    target = tc.shape_target(
        model, tc.Height(0.9, top=[0, 1, 2], bottom=[3, 4, 5]), force_density=30.0
    )
    mpc = tc.MPC(
        plant, horizon=20, sample_time=0.01, reference=target.nodes, outputs=limits, **options
    )
    run = tc.simulate(model, 0.6, controller=mpc, output_step=2e-3, error="none")
    return run, run.bar_force_density * members.structure.bar_length[:, None], members, mpc


@pytest.fixture(scope="module")
def freely():
    return moved([])


@pytest.mark.parametrize("solver", ["auto", "osqp"])
def test_a_loop_keeps_bars_from_buckling(freely, solver):
    run, push, members, _ = freely
    begin, peak = push[:, 0].max(), push.max()
    assert peak > 1.1 * begin
    most = begin + 0.25 * (peak - begin)
    limit = buckling(members, safety=members.buckling_force[0] / most)
    held, kept, _, mpc = moved([limit], solver=solver)
    # But for what is not linear: a twentieth of what the limit takes away.
    assert most < kept.max() < most + 0.06 * (peak - most)
    assert set(mpc.statistics.status_count) == {tc.control.Status.OK}
    np.testing.assert_allclose(held.nodes[:, :, -1], run.nodes[:, :, -1], atol=1e-4)
    margin = tc.strength(held, members).bar_margin.min()
    assert margin == pytest.approx(members.buckling_force[0] / kept.max())


def test_a_limit_that_is_broken_is_named(freely):
    _, push, members, _ = freely
    low = members.buckling_force[0] / (0.9 * push[:, 0].max())
    with pytest.raises(
        ValueError, match=r"outputs\[0\].high is .* N for row \d, but the operating"
    ):
        moved([buckling(members, safety=low)])
    # The lower shape rests with less, by which its reference is judged: exactly, but for geometry.
    limit = tc.OutputLimit(np.eye(3), low=push[:, -1].max() + 1.0, penalty=10.0, of="bars")
    with pytest.warns(tc.control.ControlWarning, match=r"outputs\[0\].low is 73.1\d* N for row"):
        _, raised, _, _ = moved([limit])
    assert raised[0, -1] > push[0, -1] + 0.2


def test_what_does_not_fit_is_refused():
    model, rest = plants("free")
    plant = tc.linearize(model, rest, input="rest_length")
    limit = buckling(sized())
    with pytest.raises(
        ValueError, match=r"outputs\[0\] limits forces of bars, which NMPC does not"
    ):
        tc.NMPC(plant, horizon=3, sample_time=0.02, outputs=[limit])
    wrong = tc.OutputLimit(np.eye(2), high=1.0, of="bars")
    with pytest.raises(ValueError, match=r"matrix has shape \(2, 2\), expected \(p, 3\): one col"):
        tc.MPC(plant, horizon=3, sample_time=0.02, outputs=[wrong])
    with pytest.raises(ValueError, match="of is 'members'"):
        tc.OutputLimit(np.eye(3), of="members")
    with pytest.raises(ValueError, match="safety is 0"):
        buckling(sized(), safety=0.0)
