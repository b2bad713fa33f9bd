"""A controller designed on strings without mass, on a plant whose strings weigh something."""

import numpy as np
import pytest

import tenscontrol as tc

TOP, STIFFNESS = 30 / np.sqrt(3), 100.0


def plant_and_start():
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, TOP))
    start = plant.to_nodes(0.003 * np.random.default_rng(0).normal(size=9))
    return prism, plant, start


def massive_model(prism, segments, string_mass):
    structure = tc.subdivide(prism, segments, string_mass=string_mass)
    stiffness = STIFFNESS * tc.structure.segment_counts(structure)
    return tc.Model(structure, strings=tc.LinearStrings(stiffness))


def with_straight_strings(structure, start):
    """The start of the parent, and the point masses evenly on its strings."""
    moved = tc.Structure(start, *parts(structure.parent))
    counts = np.bincount(structure.string_parent)
    return tc.subdivide(moved, counts, node_mass=1.0).nodes


def parts(structure):
    return structure.bars, structure.strings, structure.bar_mass


@pytest.mark.parametrize("hold", ["rest_length", "force_density"])
def test_strings_of_vanishing_mass_are_controlled_like_none(hold):
    prism, plant, start = plant_and_start()
    mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0)
    options = {"controller": mpc, "input": hold, "step": 1e-4, "output_step": 0.02}
    ideal = tc.simulate(tc.Model(prism, tc.LinearStrings(STIFFNESS)), 0.4, start, **options)
    errors = []
    for mass in (1e-2, 1e-3):
        model = massive_model(prism, 2, mass)
        nodes = with_straight_strings(model.structure, start)
        run = tc.simulate(model, 0.4, nodes, **options)
        errors.append(np.abs(run.nodes[:, :6] - ideal.nodes).max())
        assert run.control.command.shape == (9, 20)
        assert run.force_density.shape == (18, 21)
    assert errors[0] < 3e-3
    assert errors[1] < 0.2 * errors[0]  # order one in the mass


def test_massive_prism_is_brought_to_rest():
    prism, plant, start = plant_and_start()
    model = massive_model(prism, 4, 0.01)
    mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0)
    nodes = with_straight_strings(model.structure, start)
    run = tc.simulate(model, 5.0, nodes, controller=mpc, step=1e-3)
    z = plant.measure(run.nodes[:, :6, -1], run.velocities[:, :6, -1])
    assert np.abs(z[:9]).max() < 1e-3
    assert run.force_density.min() >= 0
    assert run.control.status_count == {"ok": 250}


def test_winches_hold_the_whole_string():
    """What is held is the rest length of the parent string, shared evenly by its segments."""
    prism, plant, start = plant_and_start()
    model = massive_model(prism, 4, 0.01)
    mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0)
    nodes = with_straight_strings(model.structure, start)
    law = tc.LinearStrings(STIFFNESS)
    wound = law.rest_length(prism.string_length(start), plant.force_density)
    run = tc.simulate(
        model, 0.2, nodes, controller=mpc, step=1e-3, rest_length=wound,
        winches=tc.Winches(rate=0.05),
    )  # fmt: skip
    held = run.rest_length.reshape(9, 4, -1)
    np.testing.assert_array_equal(held, np.repeat(held[:, :1], 4, axis=1))
    np.testing.assert_allclose(held.sum(axis=1)[:, -1], run.control.applied[:, -1])
    assert np.abs(run.control.winch_rate).max() <= 0.05 * (1 + 1e-12)
    assert run.control.rate_limited.max() > 0


def test_a_controller_of_another_structure_is_refused():
    _, plant, _ = plant_and_start()
    mpc = tc.MPC(plant, horizon=5, sample_time=0.02, max_force_density=80.0)
    other = tc.subdivide(tc.prism(4), 2, node_mass=0.01)
    model = tc.Model(other, strings=tc.LinearStrings(200.0))
    with pytest.raises(
        ValueError, match=r"designed on Structure\(6 nodes.* has Structure\(20 nodes"
    ):
        tc.simulate(model, 0.1, controller=mpc, step=1e-3)
