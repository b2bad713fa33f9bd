"""Elastic bars beside rigid ones: against finite elements with elastic bars."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

import tenscontrol as tc
from tenscontrol.plant import RigidityWarning
from tests.oracle import consistent_mass, truss_stiffness


def elastic_frequencies(structure, gamma, bar_gamma, string_stiffness, axial_rigidity):
    """Frequencies, Hz, of bars and strings as elements with axial and geometric stiffness."""
    d = structure.dimension
    K = truss_stiffness(structure, gamma, bar_gamma, string_stiffness, axial_rigidity)
    free = structure.free_rows
    M = np.kron(consistent_mass(structure), np.eye(d))[np.ix_(free, free)]
    squares = eigh(K[np.ix_(free, free)], M, eigvals_only=True)
    return np.sqrt(np.maximum(squares, 0)) / (2 * np.pi)


def case(name):
    metal = tc.sizing.materials["aluminium"]
    if name == "prism":
        structure = tc.prism()
    elif name == "ball":
        structure = tc.library.six_bar_ball()
    else:
        tower = tc.library.class2_tower(stages=2)
        structure = replace(tower, fixed=[0, 1, 2])
    rest = tc.prestress(structure, min_force_density=20.0)
    if name == "prism":
        sized = tc.design(structure, bars=metal, strings=metal, min_force_density=1000.0)
    else:
        sized = tc.sections(
            structure, bars=metal, bar_radius=0.01, strings=metal, string_radius=0.001
        )
    return sized, rest


@pytest.mark.parametrize("name", ["prism", "ball", "held tower"])
@pytest.mark.parametrize("input_", ["rest_length", "force_density"])
def test_the_change_is_that_of_finite_elements_to_first_order(name, input_):
    sized, rest = case(name)
    structure = sized.structure
    stiffness = np.full(len(structure.strings), 2e3)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness, damping=1.0))
    gamma = np.array(rest.force_density)
    point = tc.OperatingPoint(structure.nodes, gamma)
    plant = tc.linearize(model, point, input=input_, coordinates="minimal")
    if input_ == "force_density":  # γ held: no stiffness along the string but its own
        stiffness = gamma
    errors = []
    softest = 0.01 if input_ == "rest_length" else 3e-4
    for factor in (softest, 4 * softest):
        axial = factor * sized.bar_axial_rigidity
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RigidityWarning)
            found = tc.rigidity(plant, axial)
        rigid = found.frequency
        found_all = elastic_frequencies(structure, gamma, rest.bar_force_density, stiffness, axial)
        elastic = found_all[found_all > 1e-4 * rigid.max()][: len(rigid)]
        errors.append(np.abs(elastic / rigid - 1 - found.change).max())
        assert np.abs(elastic / rigid - 1).max() > 10 * errors[-1]
    order = np.log(errors[0] / errors[1]) / np.log(4)
    assert order > 1.7


def test_a_bar_alone_vibrates_as_it_should():
    metal = tc.sizing.materials["steel"]
    sized = tc.sections(tc.prism(), bars=metal, bar_radius=0.01, strings=metal, string_radius=0.001)
    plant = tc.linearize(
        tc.Model(sized.structure), tc.prestress(sized.structure, force_density=10.0)
    )
    found = tc.rigidity(plant, sized.bar_axial_rigidity, count=2)
    free = np.sqrt(12 * sized.bar_axial_rigidity / (sized.bar_mass * sized.structure.bar_length))
    np.testing.assert_allclose(found.axial_frequency, free / (2 * np.pi))
    assert len(found.frequency) == 2
    loaded = replace(sized.structure, point_mass=np.full(6, 0.5))
    plant = tc.linearize(tc.Model(loaded), tc.prestress(loaded, force_density=10.0))
    pair = np.array([[1, -1], [-1, 1]]) * (sized.bar_axial_rigidity / loaded.bar_length)[0]
    mass = sized.bar_mass[0] / 6 * np.array([[2, 1], [1, 2]]) + 0.5 * np.eye(2)
    exact = np.sqrt(eigh(pair, mass, eigvals_only=True)[1]) / (2 * np.pi)
    again = tc.rigidity(plant, sized.bar_axial_rigidity)
    np.testing.assert_allclose(again.axial_frequency, exact)


def test_it_warns_where_bars_are_too_soft_and_refuses_what_is_wrong():
    structure = tc.prism()
    model = tc.Model(structure, strings=tc.LinearStrings(1000.0))
    rest = tc.prestress(structure, force_density=10.0)
    plant = tc.linearize(model, rest, input="rest_length")
    with pytest.warns(RigidityWarning, match="elastic bars change mode") as told:
        tc.rigidity(plant, 1e4)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = tc.rigidity(plant, 1e8).table()
    assert "lowest frequency of a bar along itself" in text
    with pytest.raises(ValueError, match="axial_rigidity"):
        tc.rigidity(plant, 0.0)
    with pytest.raises(ValueError, match=r"axial_rigidity has shape \(2,\)"):
        tc.rigidity(plant, [1e6, 1e6])


def test_unstable_modes_are_reported_as_finite_elements_have_them():
    """A prism on its base, pressed by more than its strings hold upright."""
    structure = replace(tc.prism(), fixed=[0, 1, 2])
    gamma, lam = np.full(9, 20.0), np.full(3, 60.0)
    force = tc.statics.equilibrium_matrix(structure) @ np.r_[gamma, lam]
    load = force.reshape(-1, 3).T * (np.arange(6) > 2)
    stiffness = np.full(9, 60.0)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness), external_force=load)
    plant = tc.linearize(model, tc.OperatingPoint(structure.nodes, gamma, load), "rest_length")
    errors = []
    for axial in (np.full(3, 4e5), np.full(3, 16e5)):
        found = tc.rigidity(plant, axial)
        grows = found.growth_rate > 0
        assert 0 < grows.sum() < len(found.frequency) == 6
        K = truss_stiffness(structure, gamma, lam, stiffness, axial)[9:, 9:]
        M = np.kron(consistent_mass(structure), np.eye(3))[9:, 9:]
        squares = eigh(K, M, eigvals_only=True)[:6]
        rigid = (2 * np.pi * found.frequency) ** 2 - found.growth_rate**2
        change = np.sqrt(squares / rigid) - 1
        np.testing.assert_array_equal(change > 0, grows)
        errors.append(np.abs(change - found.change).max() / np.abs(change).max())
    assert errors[1] < 0.01
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.2)


def test_deflection_of_finite_elements_differs_by_the_stretch_of_the_bars():
    """Under a small load, elastic bars add the work of the forces that they bear."""
    sized, rest = case("held tower")
    structure = sized.structure
    gamma, stiffness = np.array(rest.force_density), np.full(len(structure.strings), 2e3)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness))
    load = np.zeros(structure.nodes.shape)
    load[0, -3:] = 0.1
    wound = tc.to_rest_length(model, structure.nodes, gamma).rest_length
    at_rest = tc.equilibrium(model, rest_length=wound)
    given = tc.deflections(model, at_rest, [load])
    free, w = structure.free_rows, load.T.ravel()
    axial = sized.bar_axial_rigidity
    K = truss_stiffness(structure, gamma, rest.bar_force_density, stiffness, axial)
    moved = np.linalg.solve(K[np.ix_(free, free)], w[free])
    rigid = given.linear[:, :, 0].T.ravel()[free]
    more = w[free] @ (moved - rigid)  # compliance, J
    push = given.bar_force[:, 0] - rest.bar_force_density * structure.bar_length
    stretch = (push**2 * structure.bar_length / axial).sum()
    assert more == pytest.approx(stretch, rel=1e-3)
