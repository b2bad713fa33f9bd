"""Deflections under loads: closed forms, energies minimized by scipy, finite elements."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

import tenscontrol as tc
from tests.oracle import truss_stiffness


def string_over(clustered=False, tension=20.0, stiffness=500.0):
    """A string between two supports 2 m apart with a node in the middle, and its rest."""
    nodes = [[-1.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    strings = [[0, 1, 2]] if clustered else [[0, 1], [1, 2]]
    structure = tc.Structure(nodes, [], strings, [], fixed=[0, 2], point_mass=[0, 0.1, 0])
    model = tc.Model(structure, tc.LinearStrings(stiffness))
    length = structure.string_length()
    return model, tc.prestress(structure, tension / length)


def across(force):
    return np.array([[0.0, 0.0, 0.0], [0.0, -force, 0.0]])


def test_a_string_between_two_supports_in_closed_form():
    model, rest = string_over()
    found = tc.deflections(model, rest, [across(1.0), across(50.0)])
    sag = -found.displacement[1, 1]
    length = np.sqrt(1 + sag**2)
    np.testing.assert_allclose(found.string_force[0], 20 + 500 * (length - 1), rtol=1e-12)
    np.testing.assert_allclose(2 * found.string_force[0] * sag / length, [1.0, 50.0], rtol=1e-9)
    np.testing.assert_allclose(-found.linear[1, 1], [1 / 40, 50 / 40], rtol=1e-9)
    np.testing.assert_allclose(found.reaction[1, 0], [0.5, 25.0], rtol=1e-9)
    np.testing.assert_allclose(found.reaction[0, 2], found.string_force[1] / length)
    along = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    stiff = tc.stiffness_along(model, rest, [across(3.0), along])
    np.testing.assert_allclose(stiff.stiffness, [2 * 20.0, 2 * 500.0], rtol=1e-9)


def test_a_clustered_string_slides_over_its_node():
    model, rest = string_over(clustered=True)
    found = tc.deflections(model, rest, [across(30.0)])
    sag = -found.displacement[1, 1, 0]
    length = np.sqrt(1 + sag**2)
    tension = 20 + 500 * (2 * length - 2)
    assert found.string_force[0, 0] == pytest.approx(tension, rel=1e-12)
    assert 2 * tension * sag / length == pytest.approx(30.0, rel=1e-9)
    with pytest.raises(ValueError, match=r"directions\[0\] pushes on a mechanism: 1 N on node 1 a"):
        tc.stiffness_along(model, rest, [[[0, 1, 0], [0, 0, 0]]])


@pytest.fixture(scope="module")
def held():
    """A ball on three nodes with weights, an equilibrium of given rest lengths, and loads."""
    ball = replace(tc.library.six_bar_ball(), bar_mass=np.full(6, 0.3))
    low = np.argsort(ball.nodes[2])[:3]
    structure = replace(ball, fixed=low)
    model = tc.Model(structure, tc.ElasticStrings(3e3), gravity=9.81)
    rest_length = 0.97 * ball.string_length()
    rest = tc.equilibrium(model, rest_length=rest_length)
    loads = np.random.default_rng(0).normal(size=(3, *ball.nodes.shape))
    loads *= np.array([0.01, 10.0, 60.0])[:, None, None]
    return model, rest, loads, tc.deflections(model, rest, list(loads)), rest_length


def test_shapes_are_those_of_least_energy(held):
    model, rest, loads, found, rest_length = held
    structure, free = model.structure, model.structure.free_rows
    i, j = structure.strings.T
    a, b = structure.bars.T
    start = rest.structure.nodes.ravel(order="F")
    weight = np.zeros(structure.nodes.shape)
    for end in structure.bars.T:
        np.add.at(weight[2], end, -0.5 * 9.81 * structure.bar_mass)

    def nodes(x):
        whole = start.copy()
        whole[free] = x
        return whole.reshape(-1, 3).T

    def energy(x, load):
        N = nodes(x)
        S = N[:, j] - N[:, i]
        length = np.linalg.norm(S, axis=0)
        stretch = np.maximum(length - rest_length, 0)
        pull = 3e3 / rest_length * stretch * S / length
        slope = np.zeros(N.shape)
        np.add.at(slope.T, j, pull.T)
        np.add.at(slope.T, i, -pull.T)
        slope -= load
        value = (0.5 * 3e3 / rest_length * stretch**2).sum() - (load * N).sum()
        return value, slope.ravel(order="F")[free]

    def kept(x):
        N = nodes(x)
        return ((N[:, b] - N[:, a]) ** 2).sum(axis=0) - structure.bar_length**2

    def slopes(x):
        N = nodes(x)
        rows = np.zeros((len(a), N.shape[1], 3))
        B = 2 * (N[:, b] - N[:, a]).T
        rows[np.arange(len(a)), b], rows[np.arange(len(a)), a] = B, -B
        return rows.reshape(len(a), -1)[:, free]

    for k, load in enumerate(loads):
        total = load + weight
        answer = minimize(
            energy, start[free], args=(total,), jac=True, method="SLSQP",
            constraints={"type": "eq", "fun": kept, "jac": slopes},
            options={"ftol": 1e-14, "maxiter": 400},
        )  # fmt: skip
        off = found.displacement[:, :, k] - (nodes(answer.x) - rest.structure.nodes)
        assert np.abs(off).max() < 2e-5
        balance = found.reaction[:, :, k] + total
        assert np.abs(balance.sum(axis=1)).max() < 1e-8
        taut = np.flatnonzero(rest.force_density > 0)
        N = rest.structure.nodes + found.displacement[:, :, k]
        loose = [s for s in taut if np.linalg.norm(N[:, j[s]] - N[:, i[s]]) <= rest_length[s]]
        assert found.slack[k] == tuple(loose)
    assert found.slack[0] == ()
    assert found.slack[2]
    assert found.is_elastic.all()


def test_linear_displacements_are_the_limit_of_small_loads_and_of_stiff_finite_elements(held):
    model, rest, loads, found, rest_length = held
    assert found.nonlinearity[0] < 0.01
    assert np.abs(np.diff(np.log(found.nonlinearity[:2]))) > 2
    structure, free = rest.structure, rest.structure.free_rows
    errors = []
    for rigidity in (1e6, 1e7):
        K = truss_stiffness(
            structure, rest.force_density, rest.bar_force_density, 3e3 / rest_length,
            np.full(6, rigidity),
        )[np.ix_(free, free)]  # fmt: skip
        elastic = np.linalg.solve(K, loads[1].ravel(order="F")[free])
        errors.append(np.abs(elastic - found.linear[:, :, 1].ravel(order="F")[free]).max())
    assert np.log10(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.05)
    assert errors[1] < 2e-3 * found.largest[1]
    stiff = tc.stiffness_along(model, rest, [loads[1]], rest_length=rest_length)
    size = np.linalg.norm(loads[1], axis=0).max()
    work = (loads[1] * found.linear[:, :, 1]).sum()
    assert stiff.stiffness[0] == pytest.approx(size**2 / work, rel=1e-9)


def test_a_structure_without_supports_is_pulled_and_turns_over_under_a_push():
    prism = tc.prism()
    model = tc.Model(prism, tc.LinearStrings(2e4))
    rest = tc.prestress(prism, force_density=100.0)
    squeeze = np.zeros((3, 6))
    squeeze[2] = [-1, -1, -1, 1, 1, 1]
    pulled = tc.deflections(model, rest, [-0.01 * squeeze])
    moved = pulled.displacement[:, :, 0]
    assert np.abs(moved.sum(axis=1)).max() < 1e-12
    assert pulled.nonlinearity[0] < 1e-4
    # Held by supports that bear nothing, it deflects alike: to and fro but for the sign.
    own = replace(prism, fixed=[3], rollers=[(4, "y"), (4, "z"), (5, "z")])
    pressed = tc.deflections(
        tc.Model(own, model.strings), tc.prestress(own, force_density=100.0), [0.01 * squeeze]
    )
    height = [x[2, :3].mean() - x[2, 3:].mean() for x in (moved, pressed.displacement[:, :, 0])]
    assert height[0] == pytest.approx(-height[1], rel=1e-3)
    assert np.abs(pressed.reaction).max() < 1e-9
    stiff = tc.stiffness_along(model, rest, [squeeze]).stiffness[0]
    assert 0.01 / (3 * height[0]) == pytest.approx(stiff, rel=1e-3)
    with pytest.raises(ValueError, match=r"loads\[0\] turns the structure, .* by 180°"):
        tc.deflections(model, rest, [10 * squeeze])
    with pytest.raises(ValueError, match=r"loads\[1\]: no equilibrium: the structure has no supp"):
        tc.deflections(model, rest, [0, np.eye(3, 6)])


def test_on_ground_it_sinks_beside():
    prism = replace(tc.prism(), bar_mass=np.ones(3))
    ground, strings = tc.Ground(5e3, friction=0.8), tc.LinearStrings(2e4)
    model = tc.Model(prism, strings, gravity=9.81, ground=ground)
    wound = 0.99 * prism.string_length()
    stance = tc.equilibrium(model, rest_length=wound)
    press = np.zeros((3, 6))
    press[2, :3] = -20.0
    found = tc.deflections(model, stance, [press])
    held = replace(stance.structure, fixed=[3, 4, 5])
    same = tc.Model(held, strings, gravity=9.81)
    point = tc.prestress(held, stance.force_density, external_force=stance.load)
    firm = tc.deflections(same, point, [press])
    np.testing.assert_allclose(found.displacement[2, 3:, 0], -20 / 5e3, rtol=1e-8)
    sunk = firm.displacement[:, :, 0] - np.array([[0.0], [0.0], [20 / 5e3]])
    np.testing.assert_allclose(found.displacement[:, :, 0], sunk, atol=1e-9)
    np.testing.assert_allclose(found.linear, firm.linear, atol=1e-12)
    assert not found.reaction.any()


def bistable():
    """A bar on a hinge between two strings: level to the right or to the left."""
    nodes = [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 2.0, -2.0]]
    structure = tc.Structure(nodes, [[0, 1]], [[1, 2], [1, 3]], 1.0, fixed=[0, 2, 3])
    model = tc.Model(structure, tc.LinearStrings(100.0))
    return model, tc.equilibrium(model, rest_length=0.5)


def test_it_says_where_a_structure_snaps_through():
    model, rest = bistable()
    push = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.0]])
    with pytest.warns(UserWarning, match=r"under loads\[1\] the structure goes to another") as told:
        found = tc.deflections(model, rest, [push, 500 * push])
    assert told[0].filename == __file__
    assert found.is_elastic.tolist() == [True, False]
    assert found.displacement[0, 1, 1] < -1.9


def test_along_a_bar_there_is_no_give():
    prism = tc.prism()
    model, rest = tc.Model(prism, tc.LinearStrings(2e4)), tc.prestress(prism, force_density=100.0)
    i, j = prism.bars[0]
    along = np.zeros((3, 6))
    along[:, j] = prism.nodes[:, j] - prism.nodes[:, i]
    along[:, i] = -along[:, j]
    assert tc.stiffness_along(model, rest, [along]).stiffness[0] == np.inf


def test_what_has_no_answer_is_refused():
    model, rest = bistable()
    with pytest.raises(TypeError, match="at is a "):
        tc.deflections(model, 0.5, [])
    with pytest.raises(ValueError, match=r"loads\[0\] has shape"):
        tc.deflections(model, rest, [[1.0, 2.0]])
    with pytest.raises(ValueError, match=r"directions\[1\] is zero"):
        tc.stiffness_along(model, rest, [across(1.0) @ np.eye(3, 4), 0])
    with pytest.raises(ValueError, match="the model has no string law"):
        tc.deflections(tc.Model(model.structure), rest, [])
    unstable = tc.Structure(
        [[0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 2.0, -2.0]], [[0, 1]], [[1, 2], [1, 3]], 1.0,
        fixed=[0, 2, 3],
    )  # fmt: skip
    model = tc.Model(unstable, tc.LinearStrings(100.0))
    upright = tc.prestress(unstable, [50.0, 250 / 3])
    with pytest.raises(ValueError, match="at is unstable with these strings: a motion, most of n"):
        tc.deflections(model, upright, [])
    assert tc.deflections(*bistable(), []).table().splitlines()[1:] == []
