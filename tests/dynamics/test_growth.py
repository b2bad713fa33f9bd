"""What segments and skin nodes cost: so much each, and nothing where there are none."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc

STRINGS = tc.LinearStrings(100.0)
# Instructions of the prism's functions, no more than before there were string nodes.
PRISM = {"dynamics": 316, "rest_length_dynamics": 408}
# Instructions of one more segment and of one more skin node with its three strings.
SEGMENT = {"dynamics": 25, "rest_length_dynamics": 35}
SKIN_NODE = {"dynamics": 53, "rest_length_dynamics": 83}

each_function = pytest.mark.parametrize("name", PRISM)


def built(structure, name):
    return getattr(tc.Model(structure, strings=STRINGS), name)


def instructions(function):
    """The function, line by line: operation, operands, results and constants."""
    lines = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        constant = function.instruction_constant(k) if operation == ca.OP_CONST else None
        operands = function.instruction_input(k), function.instruction_output(k)
        lines.append((operation, *operands, constant))
    return lines


def one_string_cut(prism, segments):
    return tc.subdivide(prism, [1] * 8 + [segments], node_mass=0.01)


# ---- nothing where there are none ----


@each_function
def test_a_prism_takes_the_instructions_it_always_took(prism, name):
    assert built(prism, name).n_instructions() == PRISM[name]
    assert built(prism, name).nnz_in() == 36 + 9


@each_function
def test_a_prism_whose_strings_are_not_cut_builds_the_same_function(prism, name):
    plain = instructions(built(prism, name))
    assert instructions(built(tc.subdivide(prism, 1, node_mass=0.01), name)) == plain
    assert instructions(built(tc.skin(prism, "top", iterations=0, node_mass=0.01), name)) == plain


# ---- segments ----


@each_function
@pytest.mark.parametrize(("cut", "strings"), [(one_string_cut, 1), (tc.subdivide, 9)])
def test_each_segment_costs_the_same(prism, name, cut, strings):
    """To the instruction from the second segment on; the first point mass may cost one more."""
    segments = np.array([1, 2, 3, 4, 8, 16, 32])
    options = {"node_mass": 0.01} if cut is tc.subdivide else {}
    counts = [built(cut(prism, s, **options), name).n_instructions() for s in segments.tolist()]
    growth = np.diff(counts) / (strings * np.diff(segments))
    np.testing.assert_array_equal(growth[1:], SEGMENT[name])
    assert 0 <= counts[1] - PRISM[name] - strings * SEGMENT[name] <= 1


def test_each_segment_has_a_node_of_six_states_and_one_input(prism):
    for segments in (1, 2, 4, 16):
        cut = tc.subdivide(prism, segments, node_mass=0.01)
        function = tc.Model(cut).dynamics
        assert function.size1_in(0) == 36 + 6 * 9 * (segments - 1)
        assert function.size1_in(1) == 9 * segments


@pytest.mark.parametrize(("kind", "count"), [("minimal", 15), ("internal", 9)])
def test_each_segment_has_three_degrees_of_freedom(prism, rest, kind, count):
    for segments in (1, 2, 4):
        cut = tc.subdivide(prism, segments, node_mass=0.01)
        at = tc.prestress(cut, rest.force_density[np.repeat(np.arange(9), segments)] * segments)
        plant = tc.linearize(tc.Model(cut), at, coordinates=kind)
        assert plant.degrees_of_freedom == count + 27 * (segments - 1)


# ---- skins ----


def skins(prism):
    """Skins of 1 to 160 nodes on one panel, on two, and on all eight."""
    for panels in (["top"], ["top", "bottom"], ["top", "bottom", "sides"]):
        for iterations in (1, 2, 3, 4):
            yield tc.skin(prism, panels, iterations=iterations, node_mass=0.01)


@each_function
def test_each_skin_node_costs_the_same(prism, name):
    """Within 1 % of a line through the prism; a node comes with three strings.

    The skin of the sides has three strings more, across them, at a third of the strings' share.
    """
    for skinned in skins(prism):
        nodes = skinned.nodes.shape[1] - 6
        strings = len(skinned.strings) - 9
        across = strings - 3 * nodes
        assert across in (0, 3)
        string_cost = {"dynamics": 16, "rest_length_dynamics": 28}[name]
        expected = PRISM[name] + SKIN_NODE[name] * nodes + string_cost * across
        assert built(skinned, name).n_instructions() == pytest.approx(expected, rel=0.01)


def test_each_skin_node_has_six_states_and_three_inputs(prism):
    for skinned in skins(prism):
        nodes = skinned.nodes.shape[1] - 6
        function = tc.Model(skinned).dynamics
        assert function.size1_in(0) == 36 + 6 * nodes
        assert function.size1_in(1) == len(skinned.strings)


def test_a_skin_and_segments_together_cost_the_sum(prism):
    skinned = tc.skin(prism, ("top", "bottom"), iterations=2, node_mass=0.01)
    both = tc.subdivide(skinned, [4] * 9 + [1] * 24, node_mass=0.01)
    costs = [tc.Model(each).dynamics.n_instructions() for each in (prism, skinned, both)]
    assert costs[1] - costs[0] == pytest.approx(8 * SKIN_NODE["dynamics"], rel=0.01)
    assert costs[2] - costs[1] == 27 * SEGMENT["dynamics"]


def test_a_net_costs_the_same_for_each_knot():
    """Columns of four knots, held at the corners: each takes 7 strings and 4 knots more."""
    counts = [tc.Model(tc.net(4, c, 0.1, 0.01)).dynamics.n_instructions() for c in range(3, 8)]
    np.testing.assert_allclose(np.diff(counts), 139, rtol=0.01)
