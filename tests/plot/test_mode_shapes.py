"""Mode shapes: the displaced shape over the reference, at one scale."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc


@pytest.fixture(scope="module")
def modes(plant):
    return tc.modes(plant)


def positions(drawing):
    return np.array(drawing.nodes.get_data_3d())


def test_each_mode_is_drawn_over_the_reference(plant, modes):
    drawn = tc.plot.mode_shapes(plant, modes)
    assert [shape.mode for shape in drawn] == list(range(9))
    assert len({shape.ax for shape in drawn}) == 9
    for shape in drawn:
        assert np.array_equal(positions(shape.reference), plant.nodes)
        assert shape.reference.bars.get_zorder() < shape.displaced.strings.get_zorder()


def test_displacement_is_the_mode_at_the_scale_asked_for(plant, modes):
    (shape,) = tc.plot.mode_shapes(plant, modes, which=[5], scale=0.3)
    moved = positions(shape.displaced) - plant.nodes
    size = np.ptp(plant.nodes, axis=1).max()
    assert np.isclose(np.linalg.norm(moved, axis=0).max(), 0.3 * size)
    along = abs((moved * modes.shape[:, :, 5]).sum())
    assert np.isclose(along, np.linalg.norm(moved) * np.linalg.norm(modes.shape[:, :, 5]))


def test_arrows_go_from_the_reference_to_the_displaced_shape(plant, modes):
    (shape,) = tc.plot.mode_shapes(plant, modes, which=[5])
    shafts = np.array([each for each in shape.arrows._segments3d if len(each) == 2])
    moved = positions(shape.displaced)
    starts = {tuple(np.round(each, 9)) for each in plant.nodes.T}
    ends = {tuple(np.round(each, 9)) for each in moved.T}
    found = {tuple(np.round(end, 9)) for shaft in shafts for end in shaft}
    assert found & starts
    assert len(found & ends) == len(found & starts)


def test_many_nodes_share_few_arrows_and_still_ones_have_none():
    tower = replace(tc.library.class2_tower(stages=5), fixed=[0, 1, 2])
    plant = tc.linearize(tc.Model(tower), tc.prestress(tower, min_force_density=10.0))
    (shape,) = tc.plot.mode_shapes(plant, tc.modes(plant), which=[0])
    drawn = shape.arrows._segments3d
    moving = np.linalg.norm(positions(shape.displaced) - plant.nodes, axis=0)
    assert (moving[:3] == 0).all()
    assert 0 < len(drawn) <= 3 * (moving > 0.15 * moving.max()).sum()


def test_panels_are_as_tall_as_the_structure_asks():
    sizes = []
    for structure in (tc.prism_tower(stages=4), tc.library.geiger_dome(8)):
        plant = tc.linearize(tc.Model(structure), tc.prestress(structure, min_force_density=10.0))
        figure = tc.plot.mode_shapes(plant, tc.modes(plant))[0].ax.figure
        width, height = figure.get_size_inches()
        sizes.append(height / width)
    assert sizes[0] > 1.3 > 1.0 > sizes[1]


def test_titles_say_number_frequency_and_kind(plant, modes):
    drawn = tc.plot.mode_shapes(plant, modes, which=[0, 3, 6])
    assert drawn[0].ax.get_title() == "mode 0: 0 Hz\naffine"
    assert drawn[1].ax.get_title() == "mode 3: 2.273 Hz\nelastic"
    assert drawn[2].ax.get_title() == "mode 6: 2.443 Hz\nelastic"


def test_a_mode_that_runs_away_has_the_rate_at_which_it_grows(plant, modes):
    growing = replace(modes, damping=np.full(len(modes), -1.0), pole=np.full(len(modes), 8.0 + 0j))
    (shape,) = tc.plot.mode_shapes(plant, growing, which=[2])
    assert shape.ax.get_title().startswith("mode 2: grows, 8.000 1/s")
    assert "-1.0000  mechanism, runs away" in growing.table()


def test_all_panels_have_the_same_limits(plant, modes):
    drawn = tc.plot.mode_shapes(plant, modes, which=[1, 6, 8])
    limits = {(*shape.ax.get_xlim(), *shape.ax.get_ylim(), *shape.ax.get_zlim()) for shape in drawn}
    assert len(limits) == 1


def test_a_turn_of_phase_changes_nothing(plant, modes):
    turned = replace(modes, shape=modes.shape * np.exp(0.7j))
    plain, complex_ = (
        positions(tc.plot.mode_shapes(plant, which, which=[4])[0].displaced) - plant.nodes
        for which in (modes, turned)
    )
    assert np.allclose(plain, complex_) or np.allclose(plain, -complex_)


def test_draws_into_given_axes(plant, modes, space):
    (shape,) = tc.plot.mode_shapes(plant, modes, which=[2], axes=[space])
    assert shape.ax is space


def test_wrong_arguments_are_named(plant, modes, space, flat):
    with pytest.raises(ValueError, match=r"which\[1\] is 9, expected 0 to 8: there are 9 modes"):
        tc.plot.mode_shapes(plant, modes, which=[0, 9])
    with pytest.raises(TypeError, match=r"which is \[\], expected a sequence"):
        tc.plot.mode_shapes(plant, modes, which=[])
    with pytest.raises(ValueError, match="scale is -1"):
        tc.plot.mode_shapes(plant, modes, scale=-1)
    with pytest.raises(ValueError, match="axes has 1 entries, expected 2"):
        tc.plot.mode_shapes(plant, modes, which=[0, 1], axes=[space])
    with pytest.raises(TypeError, match=r"axes\[0\] is flat"):
        tc.plot.mode_shapes(plant, modes, which=[0], axes=[flat])
    with pytest.raises(TypeError, match="modes is a LinearPlant"):
        tc.plot.mode_shapes(plant, plant)
    with pytest.raises(ValueError, match="give the plant from which"):
        tc.plot.mode_shapes(plant, replace(modes, shape=modes.shape[:, :4]))
