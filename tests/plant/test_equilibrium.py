"""Equilibrium under load: closed forms, the equations of motion, and what cannot be held."""

import tracemalloc
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import brentq

import tenscontrol as tc
from tenscontrol.plant.potential import Potential
from tests.plant.equilibria import random_rest

GRAVITY = 9.81


def standing():
    """A prism on three fixed nodes, its strings wound, under its own weight."""
    prism = tc.prism()
    structure = tc.Structure(
        prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3, 4, 5],
        string_groups=prism.string_groups,
    )  # fmt: skip
    model = tc.Model(structure, strings=tc.LinearStrings(500.0), gravity=GRAVITY)
    gamma = tc.statics.prism_force_density(3, 60.0)[0]
    return model, tc.to_rest_length(model, prism.nodes, gamma).rest_length


def vee(mass=0.7):
    """A point mass between two supports 2 m apart, on two strings of 1 m."""
    nodes = [[-1.0, 1.0, 0.05], [0.0, 0.0, 0.1], [0.0, 0.0, -0.1]]
    return tc.Structure(
        nodes, np.zeros((0, 2)), [[0, 2], [1, 2]], 1.0, string_node_mass=mass, fixed=[0, 1]
    )


def test_a_mass_on_two_springs_sags_as_the_closed_form_says():
    model = tc.Model(vee(), strings=tc.LinearStrings(100.0), gravity=GRAVITY)
    rest = tc.equilibrium(model, rest_length=1.0)
    # 2 k (l - 1) sag / l = m g, l = √(1 + sag²)
    sag = brentq(lambda d: 200 * (1 - 1 / np.hypot(1, d)) * d - 0.7 * GRAVITY, 1e-3, 5, xtol=1e-15)
    np.testing.assert_allclose(rest.structure.nodes[:, 2], [0, 0, -sag], atol=1e-12)
    assert rest.residual < 1e-11
    assert rest.is_stable


def test_a_mass_on_held_force_densities_sags_in_proportion():
    model = tc.Model(vee(), gravity=GRAVITY)
    rest = tc.equilibrium(model, force_density=[4.0, 4.0])
    np.testing.assert_allclose(rest.structure.nodes[:, 2], [0, 0, -0.7 * GRAVITY / 8], atol=1e-12)


def test_the_standing_prism_does_not_move_from_its_equilibrium():
    model, wound = standing()
    rest = tc.equilibrium(model, rest_length=wound)
    lengths = rest.structure.bar_length
    np.testing.assert_allclose(lengths, model.structure.bar_length, rtol=1e-14)
    assert (rest.structure.nodes[2, :3] < 1.0).all()  # it sinks
    run = tc.simulate(model, 1.0, rest.structure.nodes, rest_length=wound, step=1e-3)
    np.testing.assert_allclose(run.nodes[:, :, -1], rest.structure.nodes, atol=1e-10)
    # The supports carry the weight: what the members ask of the fixed nodes is 3 m g.
    load = (
        tc.statics.equilibrium_matrix(rest.structure)
        @ np.r_[rest.force_density, rest.bar_force_density]
    )
    reaction = load.reshape(-1, 3)[[3, 4, 5], 2].sum() - rest.external_force[2, [3, 4, 5]].sum()
    assert reaction == pytest.approx(3 * GRAVITY)


def test_the_loaded_prism_is_linearized_and_regulated():
    model, wound = standing()
    rest = tc.equilibrium(model, rest_length=wound)
    plant = tc.linearize(model, rest)
    assert plant.invariance_residual < 1e-12
    Q, R = tc.energy_weights(plant)
    regulator = tc.LQR(plant, Q, 0.1 * R, max_force_density=400.0)
    start = plant.to_nodes(0.01 * np.ones(plant.degrees_of_freedom))
    run = tc.simulate(model, 6.0, start, controller=regulator, sample_time=0.01, step=1e-3)
    off = np.linalg.norm(run.nodes - plant.nodes[:, :, None], axis=0).max(axis=0)
    assert off[0] > 5e-3
    assert off[-1] < 1e-4


def test_a_free_prism_finds_back_to_its_shape():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    gamma = tc.statics.prism_force_density(3, 17.3205)[0]
    wound = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    plant = tc.linearize(model, tc.prestress(prism, gamma))
    pushed = plant.to_nodes(0.05 * np.random.default_rng(0).normal(size=9))
    rest = tc.equilibrium(model, rest_length=wound, nodes=pushed)
    np.testing.assert_allclose(rest.structure.string_length(), prism.string_length(), atol=1e-9)
    np.testing.assert_allclose(rest.force_density, gamma, rtol=1e-7)


def test_what_floats_keeps_its_centre_of_mass_and_its_attitude():
    prism = tc.prism()
    mass = np.array([0.0, 2.0, 0.0, 0.5, 0.0, 1.0])
    prism = replace(prism, point_mass=mass, bar_mass=[1.0, 2.0, 3.0])
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    wound = prism.string_length() * np.linspace(0.7, 1.0, 9)
    found = tc.equilibrium(model, rest_length=wound).structure.nodes
    np.add.at(mass, prism.bars, prism.bar_mass[:, None] / 2)
    gone = found - prism.nodes
    assert np.abs(gone).max() > 0.02
    assert np.abs(gone @ mass).max() < 1e-12
    # Without a turn that would bring it nearer, to first order: Eckart, Phys. Rev. 47 (1935).
    assert np.abs(np.cross(prism.nodes, gone, axis=0) @ mass).max() < 1e-12
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    moved = turn @ prism.nodes + [[1.0], [2.0], [3.0]]
    other = tc.equilibrium(model, rest_length=wound, nodes=moved).structure.nodes
    np.testing.assert_allclose(other, turn @ found + [[1.0], [2.0], [3.0]], atol=1e-9)
    # A couple turns it: the attitude is that of the load.
    pulled = tc.Model(prism, strings=tc.LinearStrings(100.0), external_force=_pair(1, 5))
    turned = tc.equilibrium(pulled, rest_length=wound).structure.nodes
    assert np.abs((turned - prism.nodes) @ mass).max() < 1e-12
    assert np.abs(np.cross(turned[:, 5] - turned[:, 1], [0.0, 0.0, 1.0])).max() < 1e-9


def _pair(lower, upper):
    """Return a load that pulls two nodes apart along the vertical, N."""
    load = np.zeros((3, 6))
    load[2, lower], load[2, upper] = -1.0, 1.0
    return load


def test_a_load_given_at_the_call_is_the_load_built_in():
    structure = vee()
    load = np.zeros((3, 3))
    load[:, 2] = [0.5, 0.0, -3.0]
    built_in = tc.Model(structure, strings=tc.LinearStrings(100.0), external_force=load)
    taken = tc.Model(structure, strings=tc.LinearStrings(100.0), external_force=True)
    one = tc.equilibrium(built_in, rest_length=0.9)
    other = tc.equilibrium(taken, rest_length=0.9, external_force=load)
    np.testing.assert_allclose(one.structure.nodes, other.structure.nodes, atol=1e-12)


def test_what_nothing_holds_is_refused():
    """Under gravity and without a support there is no least energy."""
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0), gravity=GRAVITY)
    with pytest.raises(
        ValueError, match="the structure has no support, and its weights and external_force"
    ):
        tc.equilibrium(model, rest_length=0.7)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "expected one of rest_length and force_density, found neither"),
        ({"rest_length": 1.0, "force_density": 1.0}, "found both"),
        ({"rest_length": -1.0}, r"rest_length\[0\] is -1"),
        ({"force_density": [1.0] * 3}, r"force_density has shape \(3,\)"),
        ({"rest_length": 1.0, "external_force": np.ones((3, 3))}, "takes no load as an input"),
        ({"rest_length": 1.0, "nodes": np.zeros((3, 3))}, "fixed node 0 is 1 m from its place"),
    ],
)
def test_bad_arguments_are_refused_by_name(arguments, message):
    model = tc.Model(vee(), strings=tc.LinearStrings(100.0), gravity=GRAVITY)
    with pytest.raises(ValueError, match=message):
        tc.equilibrium(model, **arguments)


def test_a_pendulum_set_upside_down_is_found_hanging():
    """Between two soft strings: upright the forces balance too, but it would fall."""
    structure = tc.Structure(
        [[0, 0, 0.5], [0, 0, 0], [0, 1.0, -1.0]], [[0, 1]], [[1, 2]], 1.0, fixed=[0, 2]
    )
    model = tc.Model(structure, strings=tc.LinearStrings(1.0), gravity=GRAVITY)
    with pytest.warns(UserWarning, match="all strings are slack"):
        rest = tc.equilibrium(model, rest_length=3.0)
    np.testing.assert_allclose(rest.structure.nodes[:, 1], [0, 0, -1], atol=1e-9)


def test_a_bar_without_strings_hangs():
    structure = tc.Structure([[0, 0.6], [0, 0], [0, 0.8]], [[0, 1]], [], 1.0, fixed=[0])
    model = tc.Model(structure, gravity=GRAVITY)
    rest = tc.equilibrium(model, force_density=[])
    np.testing.assert_allclose(rest.structure.nodes[:, 1], [0, 0, -1], atol=1e-9)
    assert rest.bar_force_density[0] == pytest.approx(-GRAVITY / 2)  # in tension
    # Swinging is a motion as one body, but gravity stiffens it: 'internal' may not leave it out.
    with pytest.raises(ValueError, match="use coordinates='minimal'"):
        tc.linearize(model, rest)
    swing = tc.modes(tc.linearize(model, rest, coordinates="minimal")).frequency
    np.testing.assert_allclose(swing, np.sqrt(3 * GRAVITY / 2) / (2 * np.pi), rtol=1e-9)


def test_heavy_strings_under_gravity_are_commanded_as_wholes():
    """Tension varies along a hanging string, the rest length of its segments does not."""
    model, wound = standing()
    cut = tc.subdivide(model.structure, 3, node_mass=0.005)
    strings = tc.LinearStrings(500.0 * tc.structure.segment_counts(cut))
    heavy = tc.Model(cut, strings=strings, gravity=GRAVITY)
    rest = tc.equilibrium(heavy, rest_length=tc.structure.spread_rest_length(cut, wound))
    whole = tc.plant.command_parents(tc.linearize(heavy, rest, input="rest_length"))
    np.testing.assert_allclose(whole.rest_length, wound, rtol=1e-8)
    with pytest.raises(ValueError, match="linearize with input='rest_length'"):
        tc.plant.command_parents(tc.linearize(heavy, rest, input="force_density"))


# All strings slack; soft beside stiff ones, where forces or lengths of bars were lost.
@pytest.mark.filterwarnings("ignore:.* are slack", "ignore:.* pass through each other")
@pytest.mark.parametrize("seed", [3, 12, 16, 17, 25, 66, 90])
def test_random_structures_come_to_rest(seed):
    case = random_rest(seed)
    model, wound = case["model"], case["rest_length"]
    rest = tc.equilibrium(**case)
    length = rest.structure.string_length()
    stiffest = model.strings.stiffness.max()
    np.testing.assert_allclose(rest.structure.bar_length, model.structure.bar_length, rtol=1e-12)
    pull = model.strings.force_density(length, wound)
    np.testing.assert_allclose(rest.force_density, pull, rtol=0, atol=1e-11 * stiffest)
    assert rest.residual <= 1e-9 * max(abs(rest.force_density * length).max(), 1e-3 * stiffest)


@pytest.mark.parametrize("kind", ["rest_length", "force_density"])
@pytest.mark.parametrize("is_clustered", [False, True])
def test_derivatives_of_the_potential_are_those_of_one_whole_expression(kind, is_clustered):
    prism, rng = tc.prism(), np.random.default_rng(0)
    paths = [[0, 1, 2], *prism.strings[2:].tolist()] if is_clustered else prism.strings
    structure = tc.Structure(prism.nodes, prism.bars, paths, 1.0, fixed=[3])
    strings = tc.LinearStrings(np.linspace(300.0, 500.0, len(paths)))
    model = tc.Model(structure, strings=strings, ground=tc.dynamics.SmoothGround(5e3, width=0.2))
    held = rng.uniform(0.5, 0.9, len(paths))
    load, lam = rng.normal(size=prism.nodes.shape), rng.normal(size=3)
    motions = sparse.csc_array(rng.normal(size=(18, 12)) * (rng.random((18, 12)) < 0.4))
    potential = Potential(model, kind, held, load, prism.nodes.ravel(order="F"), motions)
    q, at = ca.SX.sym("q", 12), 0.1 * rng.normal(size=12)
    nodes = ca.reshape(ca.DM(prism.nodes.ravel(order="F")) + ca.mtimes(motions.toarray(), q), 3, 6)
    forces, bars = model.forces(kind), [nodes[:, b] - nodes[:, a] for a, b in prism.bars.tolist()]
    energy = ca.sum1(forces.strings.stored_energy(nodes, ca.DM(held))) - ca.dot(load, nodes)
    energy += forces.contacts.stored_energy(nodes)
    squares = structure.bar_length**2
    stretch = [(ca.dot(b, b) - square) / 2 for b, square in zip(bars, squares, strict=True)]
    stretch = ca.vertcat(*stretch)
    hessian, slope = ca.hessian(energy + ca.dot(lam, stretch), q)
    whole = ca.Function("whole", [q], [slope, stretch, hessian, ca.jacobian(stretch, q)])
    found = potential.conditions(np.r_[at, lam])
    for value, name in zip(whole(at), vars(found), strict=True):
        value, own = value.full(), getattr(found, name)
        own = own.toarray() if sparse.issparse(own) else own[:, None]
        np.testing.assert_allclose(own, value, rtol=0, atol=1e-13 * abs(value).max())


def test_a_long_tower_finds_back_to_its_shape_without_dense_matrices():
    tower = tc.prism_tower(60)
    rest = tc.prestress(tower, 10.0)
    model = tc.Model(tower, strings=tc.LinearStrings(3000.0))
    wound = tc.to_rest_length(model, tower.nodes, rest.force_density).rest_length
    turned = tower.nodes + 1e-3 * np.random.default_rng(0).normal(size=tower.nodes.shape)
    tracemalloc.start()
    try:
        found = tc.equilibrium(model, rest_length=wound, nodes=turned)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * tower.nodes.size**2  # bytes of one matrix of all coordinates
    np.testing.assert_allclose(found.structure.string_length(), tower.string_length(), atol=1e-9)
    assert found.residual < 1e-9


def test_a_long_column_of_pendulums_upside_down_falls():
    """Thirty bars on one another balance, but in no stable way."""
    count = 30
    nodes = np.zeros((2, count + 2))
    nodes[1, : count + 1], nodes[0, -1] = np.arange(count + 1), 100.0
    bars = np.column_stack([np.arange(count), np.arange(1, count + 1)])
    chain = tc.Structure(nodes, bars, [[count, count + 1]], 1.0, fixed=[0, count + 1])
    model = tc.Model(chain, strings=tc.LinearStrings(1.0), gravity=GRAVITY)
    with pytest.warns(UserWarning, match="all strings are slack"):
        hanging = tc.equilibrium(model, rest_length=500.0)
    expected = -np.arange(count + 1.0)
    np.testing.assert_allclose(hanging.structure.nodes[1, :-1], expected, atol=1e-8)
