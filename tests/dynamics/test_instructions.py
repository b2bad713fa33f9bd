"""A scene pays only for what it has: inputs and instructions of the built functions."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.scenes import random_structure, side_by_side, weighted_prism


def standing():
    """The prism with its bottom nodes fixed."""
    prism = tc.prism()
    return tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3, 4, 5])


# Instructions of class 1 in space, damped strings, no more than before bars could share nodes:
# dynamics, rest_length_dynamics, bar_force_density, kinetic_energy, momentum, and the operations
# on all members with force densities and with rest lengths held.
CLASS_1 = [
    (tc.prism, (316, 526, 227, 102, 172, 62, 93)),
    (lambda: tc.prism_tower(3), (1252, 2428, 989, 300, 514, 62, 93)),
    (lambda: tc.net(4, 3, 0.1, 0.01), (282, 651, 0, 99, 193, 20, 53)),
    (lambda: tc.subdivide(tc.prism(), 3, node_mass=0.01), (767, 1390, 344, 319, 605, 66, 97)),
    # CasADi 3.7 keeps products with what is fixed in energies and momenta.
    (standing, (188, 320, 148, *((48, 130) if ca.__version__ < "3.8" else (39, 122)), 46, 79)),
]


@pytest.mark.parametrize(("structure", "counts"), CLASS_1)
def test_class_1_in_space_builds_what_it_always_built(structure, counts):
    model = tc.Model(structure(), strings=tc.LinearStrings(100.0, 0.5))
    functions = [
        *(model.dynamics, model.rest_length_dynamics, model.bar_force_density),
        *(model.kinetic_energy, model.momentum),
        *(model.equation(u, form="mapped").slope for u in ("force_density", "rest_length")),
    ]
    assert tuple(function.n_instructions() for function in functions) == counts


def cost(function):
    """Instructions and inputs of a function; an input matrix counts each of its entries."""
    return function.n_instructions(), function.nnz_in()


def cheaper(less, more):
    """Whether one function takes fewer instructions and fewer inputs than another."""
    return all(a < b for a, b in zip(cost(less), cost(more), strict=True))


def test_the_dynamics_of_a_prism_take_at_most_four_hundred_instructions(prism):
    assert tc.Model(prism).dynamics.n_instructions() <= 400


@pytest.mark.parametrize("function", ["acceleration", "dynamics", "stiffness_matrix"])
def test_a_scene_without_load_has_no_input_and_no_instruction_for_it(prism, function):
    without = getattr(tc.Model(prism), function)
    loaded = getattr(tc.Model(prism, external_force=True), function)
    assert cheaper(without, loaded)
    assert without.n_in() == loaded.n_in() - 1
    assert "W" not in without.name_in()


def test_a_load_costs_its_entries_and_one_addition_each(prism):
    without = tc.Model(prism).dynamics.n_instructions()
    loaded = tc.Model(prism, external_force=True).dynamics.n_instructions()
    assert loaded - without == 2 * 3 * 6


@pytest.mark.parametrize("kind", [tc.LinearStrings, tc.ElasticStrings])
def test_a_scene_without_damping_has_no_instruction_for_it(prism, kind):
    undamped = tc.Model(prism, strings=kind(100.0, 0.0)).rest_length_dynamics
    damped = tc.Model(prism, strings=kind(100.0, 1.0)).rest_length_dynamics
    assert undamped.n_instructions() < damped.n_instructions()
    assert undamped.nnz_in() == damped.nnz_in()  # the velocities are part of the state


def test_undamped_string_forces_do_not_depend_on_the_velocities(prism):
    dependence = {}
    for damping in (0.0, 1.0):
        law = tc.LinearStrings(100.0, damping)
        function = tc.Model(prism, strings=law).string_force_density
        dependence[damping] = ca.DM(function.jac_sparsity(0, 0))[:, 18:].nnz()
    assert dependence[0.0] == 0
    assert dependence[1.0] > 0


def test_a_string_law_costs_nothing_where_force_density_is_the_input(prism):
    plain, with_law = (
        tc.Model(prism, strings=law).dynamics for law in (None, tc.LinearStrings(100.0, 1.0))
    )
    assert cost(plain) == cost(with_law)


def test_holding_rest_lengths_costs_more_than_holding_force_densities(prism):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    assert model.dynamics.n_instructions() < model.rest_length_dynamics.n_instructions()


def test_a_scene_without_string_nodes_is_cheaper(prism):
    assert cheaper(tc.Model(prism).dynamics, tc.Model(weighted_prism()).dynamics)


def test_string_nodes_cost_only_themselves():
    """One point mass and one string more, again and again: the same few instructions each."""

    def count(points):
        nodes = np.vstack([np.arange(4.0 + points), np.zeros((2, 4 + points))])
        nodes[1, 1::2] = 1.0
        chain = [[3, 4]] + [[4 + i, 5 + i] for i in range(points - 1)] if points else []
        structure = tc.Structure(
            nodes, [[0, 1], [2, 3]], [[1, 2], *chain], 1.0, 0.1 if points else None
        )
        return tc.Model(structure).dynamics.n_instructions()

    growth = np.diff([count(points) for points in (1, 2, 3, 4)])
    assert len(set(growth)) == 1
    assert 0 < growth[0] < 30


def test_a_scene_without_bars_has_no_bar_terms():
    chain = tc.Structure(
        [[0.0, 1.0, 2.0], [0.0] * 3, [0.0] * 3], [], [[0, 1], [1, 2]], [], string_node_mass=1.0
    )
    # x and γ in, ẋ out; per string 3 differences and 3 products, per node 3 divisions, 3 sums.
    assert tc.Model(chain).dynamics.n_instructions() < 80


@pytest.mark.parametrize(
    ("law", "function"),
    [
        (None, "dynamics"),
        (None, "acceleration"),
        (None, "stiffness_matrix"),
        (None, "kinetic_energy"),
        (tc.LinearStrings(100.0), "rest_length_dynamics"),
        (tc.LinearStrings(100.0, 1.0), "rest_length_dynamics"),
        (tc.ElasticStrings(100.0), "rest_length_dynamics"),
    ],
)
def test_instructions_grow_linearly_with_the_members(prism, law, function):
    counts = [
        getattr(tc.Model(side_by_side(prism, copies), strings=law), function).n_instructions()
        for copies in (1, 2, 4, 8)
    ]
    one = (counts[-1] - counts[0]) / 7
    expected = counts[0] + one * (np.array([1, 2, 4, 8]) - 1)
    np.testing.assert_allclose(counts, expected, rtol=0.01)


def test_side_by_side_prisms_move_as_one_does(prism):
    gamma = np.random.default_rng(0).uniform(5.0, 20.0, 9)
    alone = np.array(tc.Model(prism).acceleration(prism.nodes, 0, gamma))
    three = side_by_side(prism, 3)
    together = np.array(tc.Model(three).acceleration(three.nodes, 0, np.tile(gamma, 3)))
    np.testing.assert_allclose(together, np.hstack([alone] * 3), rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_nodes_costs_nothing(seed):
    structures = [random_structure(seed, bars=3, points=2)]
    place = np.random.default_rng(seed).permutation(8)
    first = structures[0]
    order = np.argsort(place)
    shuffled = tc.Structure(
        first.nodes[:, order],
        place[first.bars],
        place[first.strings],
        first.bar_mass,
        first.string_node_mass,
    )
    counts = {tc.Model(each).dynamics.n_instructions() for each in (first, shuffled)}
    assert max(counts) - min(counts) <= 0.02 * min(counts)


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_an_input_that_is_held_has_no_time_and_no_instruction_for_it(held):
    model = tc.Model(standing(), strings=tc.LinearStrings(100.0, 0.5))
    plain, moving = model.equation(held), model.equation(held, degree=1)
    loaded = model.equation(held, load_input=True)
    shaken = model.equation(held, load_input=True, offset_input=True)
    u = ca.MX.sym("u", plain.inputs)
    assert plain.inputs == 9
    assert plain.ahead(u, 0.1) is u
    assert plain.of_strings(u) is u
    assert moving.inputs == 2 * 9 + 1
    assert cheaper(plain.slope, moving.slope)
    assert cheaper(plain.slope, loaded.slope)
    assert cheaper(loaded.slope, shaken.slope)


# ---- ground ----


def grounded(structure, ground, form="flat"):
    """Slope, gap and force of a structure with rest lengths held."""
    model = tc.Model(structure, strings=tc.LinearStrings(100.0, 0.5), gravity=9.81, ground=ground)
    equation = model.equation("rest_length", form=form)
    return equation.slope, equation.gap, equation.force


@pytest.mark.parametrize("form", ["flat", "mapped"])
def test_ground_that_no_node_can_touch_costs_nothing(form):
    """Nodes that are fixed touch nothing."""
    structure = standing()
    without = grounded(structure, None, form)
    untouched = grounded(structure, tc.Ground(1e4, 0.3, 0.5, nodes=[3, 4, 5]), form)
    assert list(map(cost, without)) == list(map(cost, untouched))


def test_ground_costs_only_the_nodes_that_can_touch():
    """Each the same, on slopes too; with friction and damping more than without."""
    tower = tc.prism_tower(3)
    plain = grounded(tower, None)[0].n_instructions()

    def each(nodes, **law):
        ground = tc.Ground(1e4, nodes=nodes, **law)
        return (grounded(tower, ground)[0].n_instructions() - plain) / len(nodes)

    every = range(tower.nodes.shape[1])
    for law in ({}, {"damping": 0.3}, {"damping": 0.3, "friction": 0.5}, {"normal": [0, 0.6, 0.8]}):
        assert each([0, 1, 2], **law) == pytest.approx(each(every, **law), abs=1.5)
    bare, rubbing = each(every), each(every, damping=0.3, friction=0.5)
    assert 0 < bare < 15
    assert bare < rubbing < 50


def test_ground_costs_as_many_instructions_as_nodes(prism):
    ground = tc.Ground(1e4, 0.3, 0.5)
    counts = np.array(
        [
            [each.n_instructions() for each in grounded(side_by_side(prism, copies), ground)]
            for copies in (1, 2, 4, 8)
        ]
    )
    one = (counts[-1] - counts[0]) / 7
    expected = counts[0] + one * (np.array([[1], [2], [4], [8]]) - 1)
    np.testing.assert_allclose(counts, expected, rtol=0.01)


def test_ground_in_operations_on_all_nodes_has_so_many_whatever_their_number(prism):
    ground = tc.Ground(1e4, 0.3, 0.5)
    counts = {
        grounded(side_by_side(prism, copies), ground, "mapped")[0].n_instructions()
        for copies in (2, 8)
    }
    assert len(counts) == 1
