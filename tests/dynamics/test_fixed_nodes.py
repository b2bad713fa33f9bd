"""Fixed nodes: they cost nothing, and what hangs on them moves as if they were immensely heavy."""

import numpy as np
import pytest

import tenscontrol as tc

TOP = 30 / np.sqrt(3)


def standing(fixed, **changes):
    """The prism with some nodes fixed."""
    prism = tc.prism()
    return tc.Structure(
        prism.nodes,
        prism.bars,
        prism.strings,
        1.0,
        string_groups=prism.string_groups,
        fixed=fixed,
        **changes,
    )


@pytest.mark.parametrize(
    ("fixed", "minimal", "internal"),
    [([], 15, 9), ([3], 12, 9), ([3, 4], 9, 8), ([3, 4, 5], 6, 6), ([0, 3, 4, 5], 4, 4)],
)
@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_degrees_of_freedom_are_those_the_supports_leave(fixed, minimal, internal, held):
    """Two a swinging bar, five a free one; 6, 3, 1, 0 rigid motions with 0, 1, 2, 3 fixed nodes."""
    structure = standing(fixed)
    model = tc.Model(structure, strings=tc.LinearStrings(100.0))
    rest = tc.prestress(structure, tc.statics.prism_force_density(3, TOP)[0])
    counts = {"nodes": 3 * (6 - len(fixed)), "minimal": minimal, "internal": internal}
    for kind, count in counts.items():
        plant = tc.linearize(model, rest, input=held, coordinates=kind)
        assert plant.degrees_of_freedom == count
        assert plant.invariance_residual < 1e-12
    zeros = tc.modes(tc.linearize(model, rest, held, "minimal")).label.count("rigid")
    assert zeros == minimal - internal


def test_fixed_nodes_take_no_state_and_no_instructions():
    counts, inputs = [], []
    for fixed in ([], [3], [3, 4], [3, 4, 5]):
        function = tc.Model(standing(fixed)).dynamics
        counts.append(function.n_instructions())
        inputs.append(function.size1_in(0))
    assert inputs == [36, 30, 24, 18]
    assert (np.diff(counts) < 0).all()


def test_a_structure_without_fixed_nodes_builds_the_function_it_always_built():
    assert tc.Model(tc.prism()).dynamics.n_instructions() == 316


def test_a_fixed_node_is_the_limit_of_a_heavy_one():
    """Point masses 1, 10², 10⁴ … times a bar's approach the fixed nodes with order one in 1/m."""
    light = hanging_bar(fixed=[0, 3])
    law = tc.LinearStrings(100.0)
    target = run(tc.Model(light, strings=law))
    errors = []
    masses = [1e3, 1e4, 1e5]
    for mass in masses:
        errors.append(np.abs(run(tc.Model(hanging_bar(mass=mass), strings=law)) - target).max())
    order = np.polyfit(np.log(masses), np.log(errors), 1)[0]
    assert order == pytest.approx(-1.0, abs=0.05)


def hanging_bar(fixed=(), mass=None):
    """A bar between two strings; their outer ends are fixed or heavy."""
    nodes = [[0, 1, 2, 3], [0, 0.1, -0.1, 0], [0, 0, 0.2, 0]]
    return tc.Structure(nodes, [[1, 2]], [[0, 1], [2, 3]], 1.0, string_node_mass=mass, fixed=fixed)


def run(model):
    return tc.simulate(model, 1.0, rest_length=0.8, tolerance=1e-10).nodes[:, 1:3]


def test_a_bar_with_both_ends_fixed_is_part_of_the_support():
    """It vanishes: the rest moves as if its ends were two fixed points."""
    prism = tc.prism()
    with_bar = standing([0, 4])  # the ends of bar 0
    assert prism.bars[0].tolist() == [0, 4]
    other = [i for i in range(3) if i != 0]
    without = tc.Structure(
        prism.nodes, prism.bars[other], prism.strings, 1.0, fixed=[0, 4],
        string_groups=prism.string_groups,
    )  # fmt: skip
    gamma = np.repeat([TOP, TOP, 9.0], 3)
    runs = [
        tc.simulate(tc.Model(s), 1.0, force_density=gamma, step=1e-3) for s in (with_bar, without)
    ]
    np.testing.assert_array_equal(runs[0].nodes, runs[1].nodes)
    assert (
        tc.Model(with_bar).dynamics.n_instructions() == tc.Model(without).dynamics.n_instructions()
    )
    nodes, still = prism.nodes[:, with_bar.free], np.zeros((3, 4))
    assert float(tc.Model(with_bar).bar_force_density(nodes, still, gamma)[0]) == 0.0


def test_kinetic_energy_and_bar_lengths_hold_with_supports():
    structure = standing([3, 4, 5])
    model = tc.Model(structure, strings=tc.LinearStrings(100.0), gravity=9.81)
    gamma = np.repeat([TOP, TOP, 40.0], 3)
    start = tc.to_rest_length(model, structure.nodes, gamma).rest_length
    result = tc.simulate(model, 2.0, rest_length=start, tolerance=1e-11)
    assert np.ptp(result.kinetic_energy) > 0.01
    assert np.ptp(result.energy) < 1e-7 * abs(result.energy[0])
    assert np.abs(result.bar_length_error).max() < 1e-9
    np.testing.assert_array_equal(
        result.nodes[:, [3, 4, 5]], np.repeat(structure.nodes[:, [3, 4, 5], None], 1001, axis=2)
    )
    np.testing.assert_array_equal(result.velocities[:, [3, 4, 5]], 0.0)


@pytest.mark.parametrize("fixed", [[3], [3, 4, 5]])
def test_coordinates_map_there_and_back_with_supports(fixed):
    structure = standing(fixed)
    frame = tc.dynamics.coordinates(tc.Model(structure), kind="internal")
    random = np.random.default_rng(0)
    q, rates = 0.05 * random.normal(size=(2, frame.count))
    nodes, velocities = frame.to_nodes(q), frame.to_velocities(q, rates)
    np.testing.assert_array_equal(nodes[:, fixed], structure.nodes[:, fixed])
    lengths = np.linalg.norm(structure.bar_vectors(nodes), axis=0)
    np.testing.assert_allclose(lengths, structure.bar_length, rtol=1e-14)
    stretching = (structure.bar_vectors(nodes) * structure.bar_vectors(velocities)).sum(axis=0)
    np.testing.assert_allclose(stretching, 0, atol=1e-14)
    back = frame.measure(nodes, velocities)
    np.testing.assert_allclose(back[: frame.count], q, atol=1e-14)
    if len(fixed) > 1:  # with one fixed node the shape is turned about it when measured
        np.testing.assert_allclose(back[frame.count :], rates, atol=1e-14)


def test_weights_are_those_of_the_masses():
    structure = tc.Structure(
        [[0, 1, 2, 3], [0] * 4, [0] * 4], [[1, 2]], [[0, 1], [2, 3]], 3.0, string_node_mass=0.5
    )
    model = tc.Model(structure, gravity=[0.0, 10.0, 0.0])
    np.testing.assert_allclose(model.constant_force[1], [5.0, 15.0, 15.0, 5.0])
    np.testing.assert_allclose(model.constant_force[[0, 2]], 0.0)


def test_a_free_structure_falls_freely():
    """Gravity alone: the shape of a balanced prism does not change while it falls."""
    prism = tc.prism()
    model = tc.Model(prism, gravity=9.81)
    rest = tc.prestress(prism, TOP)
    result = tc.simulate(model, 1.0, force_density=rest.force_density, step=1e-3)
    fallen = result.nodes - 0.5 * 9.81 * result.time**2 * np.array([0, 0, -1])[:, None, None]
    np.testing.assert_allclose(fallen, np.repeat(prism.nodes[:, :, None], 1001, 2), atol=1e-11)
    assert np.ptp(result.energy) < 1e-9


def test_constant_load_is_the_load_given_at_each_call():
    prism = tc.prism()
    load = np.random.default_rng(0).normal(size=(3, 6))
    gamma = np.full(9, 20.0)
    built_in = tc.simulate(
        tc.Model(prism, external_force=load), 0.5, force_density=gamma, step=1e-3
    )
    given = tc.simulate(
        tc.Model(prism, external_force=True), 0.5, force_density=gamma, step=1e-3,
        external_force=load,
    )  # fmt: skip
    np.testing.assert_allclose(built_in.nodes, given.nodes, atol=1e-13)
    np.testing.assert_allclose(built_in.energy, given.energy, atol=1e-12)


@pytest.mark.parametrize(
    ("fixed", "exception", "message"),
    [
        ([6], ValueError, r"fixed\[0\] is node 6, expected 0 to 5"),
        ([-1], ValueError, r"fixed\[0\] is node -1, expected 0 to 5"),
        ([1.5], TypeError, r"fixed\[0\] is 1\.5, expected a whole number"),
        ([[1, 2]], ValueError, r"fixed axis of node 1 is 2, expected one of 'x', 'y', 'z'"),
        ("top", TypeError, r"fixed .*'top'"),
    ],
)
def test_bad_fixed_nodes_are_refused_by_name(fixed, exception, message):
    with pytest.raises(exception, match=message):
        standing(fixed)


def test_a_moved_support_is_refused():
    structure = standing([3])
    model = tc.Model(structure)
    moved = structure.nodes + np.array([[0.1], [0], [0]])
    with pytest.raises(ValueError, match=r"in nodes, the fixed node 3 is 0\.1 m from its place"):
        tc.simulate(model, 0.1, moved, force_density=20.0, step=1e-3)
    velocities = np.zeros((3, 6))
    velocities[2] = 1.0
    with pytest.raises(ValueError, match=r"velocities move the fixed node 3"):
        tc.simulate(model, 0.1, velocities=velocities, force_density=20.0, step=1e-3)
