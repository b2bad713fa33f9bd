"""Shapes at rest while bars get other lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc


def plant_of(structure, actuated=None):
    model = tc.Model(structure, tc.LinearStrings(stiffness=200.0))
    rest = tc.prestress(structure, min_force_density=20.0)
    return tc.linearize(model, rest, "bar_length", "minimal", actuated=actuated)


@pytest.fixture(scope="module")
def plant():
    return plant_of(replace(tc.prism(), fixed=[3, 4, 5]))


@pytest.mark.parametrize("structure", [None, tc.library.d_bar_3d()])
def test_shapes_have_the_lengths_and_are_those_of_least_energy(plant, structure):
    """On supports, and bars that share nodes in the air."""
    plant = plant if structure is None else plant_of(structure)
    structure = plant.model.structure
    lengths = np.outer(structure.bar_length, [0.95, 1.0, 1.04])
    path = tc.shape.strut_path(plant, lengths, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(path.nodes[:, :, 1], plant.nodes, atol=1e-9)
    for nodes, length, gamma in zip(
        path.nodes.T.swapaxes(1, 2), lengths.T, path.force_density.T, strict=True
    ):
        found = np.linalg.norm(structure.bar_vectors(nodes), axis=0)
        np.testing.assert_allclose(found, length, rtol=1e-12)
        there = replace(structure, nodes=nodes)
        assert tc.prestress(there, gamma).residual < 1e-9
        least = tc.equilibrium(plant.model.replace(structure=there), rest_length=plant.rest_length)
        np.testing.assert_allclose(least.structure.nodes, nodes, atol=1e-7)


def test_a_path_ends_where_strings_go_slack(plant):
    lengths = plant.model.structure.bar_length
    with pytest.raises(tc.shape.PathError, match="goes slack with bars of") as stopped:
        tc.shape.strut_path(plant, np.outer(lengths, [1.0, 0.4]), [0.0, 1.0])
    reached = stopped.value.reached.structure
    assert (reached.bar_length < 0.95 * lengths).all()
    few = plant_of(plant.model.structure, actuated=[0])
    with pytest.raises(ValueError, match="changes bar 1, which the plant does not drive"):
        tc.shape.strut_path(few, np.outer(lengths, [1.0, 1.1]), [0.0, 1.0])
    wound = tc.linearize(plant.model, tc.prestress(plant.model.structure, min_force_density=20.0))
    with pytest.raises(ValueError, match="expected 'bar_length'"):
        tc.shape.strut_path(wound, np.outer(lengths, [1.0, 1.1]), [0.0, 1.0])


LOW = tc.Height(0.9, top=[0, 1, 2], bottom=[3, 4, 5])
SEARCHES = {
    "a pair": (
        replace(tc.prism(), fixed=[3, 4, 5]),
        {"pair": [0, 1]},
        tc.Height(0.97, [0], [3]),
        "anywhere",
    ),
    "in the air": (tc.prism(), None, LOW, "centre"),
    "joined": (tc.library.d_bar_3d(), None, tc.Height(1.68, top=[3], bottom=[4]), "anywhere"),
}


@pytest.mark.parametrize("name", SEARCHES)
def test_lengths_of_bars_are_found_for_a_shape_and_the_path_to_it(name):
    """Of least energy with the rest lengths of the plant, by another method."""
    structure, actuated, demand, place = SEARCHES[name]
    plant = plant_of(structure, actuated)
    structure, model = plant.model.structure, plant.model
    target = tc.shape_target(model, demand, plant=plant, place=place)
    drives = plant.actuation
    assert np.abs(target.bar_length / structure.bar_length - 1).max() > 0.02
    found = drives.strings(drives.inputs(target.bar_length))  # those of the bars
    np.testing.assert_allclose(target.bar_length, found, rtol=1e-12)
    np.testing.assert_allclose(target.rest_length, plant.rest_length, rtol=1e-12)
    there = model.replace(structure=replace(structure, nodes=target.nodes))
    least = tc.equilibrium(there, rest_length=plant.rest_length)
    np.testing.assert_allclose(least.structure.nodes, target.nodes, atol=1e-7)
    start = tc.prestress(structure, plant.force_density)
    path = tc.shape_path(model, start, target, duration=1.0, step=0.1, plant=plant, place=place)
    assert path.residual < 1e-9
    assert path.bar_length_error < 1e-12
    np.testing.assert_allclose(path.bar_length[:, [0, -1]].T, [structure.bar_length,
                                                               target.bar_length])  # fmt: skip
    np.testing.assert_allclose(path.rest_length.T, np.tile(plant.rest_length, (len(path.time), 1)))
    followed = tc.shape.strut_path(plant, path.bar_length, path.time)
    strings = [structure.string_length(shapes.nodes[:, :, -1]) for shapes in (path, followed)]
    np.testing.assert_allclose(*strings, rtol=1e-9)
    between = path.reference([0.43]).nodes[:, :, 0]
    held = np.setdiff1d(np.arange(len(structure.bars)), drives.driven)
    length = np.linalg.norm(structure.bar_vectors(between), axis=0)
    np.testing.assert_allclose(length[held], structure.bar_length[held], rtol=1e-12)


def test_strokes_and_rates_of_drives_bound_what_is_found(plant):
    model, place = plant.model, plant.nodes[:, :1] + [[0.03], [-0.02], [-0.05]]
    demand, start = tc.NodesAt([0], place), tc.prestress(plant.model.structure, plant.force_density)
    narrow = tc.Winches(shortest=1.385, longest=1.4)
    with pytest.raises(tc.shape.ShapeError, match=r"bar_length\[1\] is .* wanted 1.385 to") as off:
        tc.shape_target(model, demand, winches=narrow, plant=plant)
    assert off.value.nearest.residual < 1e-9
    drives = tc.Winches(ramp=True, rate=0.5, shortest=1.2, longest=1.5)
    target = tc.shape_target(model, demand, winches=drives, plant=plant)
    path = tc.shape_path(model, start, target, winches=drives, plant=plant)
    assert np.abs(path.bar_length_rate).max() == pytest.approx(0.5, rel=1e-6)
    with pytest.raises(ValueError, match=r"bar 1 needs a length of .* stroke of its drive"):
        tc.shape_path(
            model, start, target, winches=tc.Winches(rate=0.5, shortest=1.35), plant=plant
        )
    with pytest.raises(ValueError, match="force_density goes with winches that set forces"):
        tc.shape_target(model, demand, force_density=10.0, plant=plant)


def test_rest_lengths_and_lengths_of_bars_are_found_at_once(plant):
    """Springs keep rest lengths, a bar its length; the shape is that of least energy."""
    model, structure = plant.model, plant.model.structure
    rest = tc.prestress(structure, min_force_density=20.0)
    wound = tc.linearize(model, rest, "rest_length", actuated=[6, 7, 8])
    both = {"plant": wound, "struts": plant_of(structure, [0, 1])}
    winches = tc.Winches(rate=0.2, shortest=0.5, longest=0.97)
    drives = tc.Winches(ramp=True, rate=0.1, shortest=1.3, longest=1.5)
    place = plant.nodes[:, :1] + [[0.03], [-0.02], [0.05]]
    limits = {"winches": winches, "drives": drives, "min_force_density": 1.0}
    target = tc.shape_target(model, tc.NodesAt([0], place), prestress="least", **limits, **both)
    np.testing.assert_allclose(target.nodes[:, :1], place, atol=1e-8)
    np.testing.assert_allclose(target.rest_length[:6], wound.rest_length[:6], rtol=1e-10)
    assert target.bar_length[2] == pytest.approx(structure.bar_length[2], rel=1e-12)
    assert (np.abs(target.bar_length / structure.bar_length - 1)[:2] > 1e-3).all()
    assert (np.abs(target.rest_length - wound.rest_length)[6:] > 1e-3).all()
    there = model.replace(structure=replace(structure, nodes=target.nodes))
    least = tc.equilibrium(there, rest_length=target.rest_length)
    np.testing.assert_allclose(least.structure.nodes, target.nodes, atol=1e-7)
    path = tc.shape_path(model, rest, target, **limits, **both)
    shares = np.abs(path.rest_length_rate[6:]).max() / 0.2, np.abs(path.bar_length_rate).max() / 0.1
    assert max(shares) == pytest.approx(1.0, rel=1e-6)
    assert min(shares) > 0.05
    np.testing.assert_allclose(path.bar_length[:, -1], target.bar_length, rtol=1e-12)
    assert path.residual < 1e-9
    # With every string on a winch, too; and within narrow strokes not at all.
    every = tc.shape_target(model, tc.NodesAt([0], place), struts=both["struts"],
                            force_density=20.0)  # fmt: skip
    assert every.residual < 1e-9
    assert every.force_density[structure.strings_in("top")].mean() == pytest.approx(20.0)
    narrow = tc.Winches(shortest=1.385, longest=1.395)
    with pytest.raises(tc.shape.ShapeError, match=r"bar_length\[0\] is .* wanted 1.385 to"):
        tc.shape_target(
            model, tc.NodesAt([0], place), prestress="least", **limits | {"drives": narrow}, **both
        )
    for wrong, message in (
        ({"drives": drives}, "but struts is not given"),
        ({"struts": wound}, "expected 'bar_length'"),
        ({"struts": plant, "plant": plant}, "both drive bars"),
    ):
        with pytest.raises(ValueError, match=message):
            tc.shape_target(model, LOW, **wrong)
