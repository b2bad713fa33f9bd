"""Shapes and paths where bars share nodes, roll, are redundant, in the plane, and with clusters."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.shape import (
    Height,
    NodesAt,
    PointAt,
    RotationalSymmetry,
    Twist,
    shape_path,
    shape_target,
)
from tenscontrol.shape.shape_search import turned_over
from tests import coupled

STIFFNESS = 500.0
GRAVITY = 9.81
HALF_TURN = RotationalSymmetry([[0, 2], [1, 3]], centre=[0.0, 0.0])


def d_bar(*arguments, **changes):
    structure = coupled.d_bar(*arguments, **changes)
    return tc.Model(structure, strings=tc.LinearStrings(STIFFNESS))


# ---- the D-bar: one shape for each height, and one force density at all of them ----


def test_a_d_bar_in_the_plane_by_its_closed_form():
    found = shape_target(d_bar(), Height(1.2, [2], [0]), force_density=10.0)
    across = 2 * np.sqrt(1 - 0.6**2)
    np.testing.assert_allclose(found.force_density, 10.0, rtol=1e-12)
    np.testing.assert_allclose(found.nodes[0, 1] - found.nodes[0, 3], across, rtol=1e-12)
    lengths = np.array([across, 1.2]) * (1 - 10.0 / STIFFNESS)
    np.testing.assert_allclose(found.rest_length, lengths, rtol=1e-12)
    assert found.residual < 1e-12
    assert found.bar_length_error < 1e-14
    assert found.is_stable


def test_a_path_of_a_d_bar_at_the_rate_of_its_winches():
    model = d_bar()
    ends = [shape_target(model, Height(h, [2], [0]), force_density=10.0) for h in (1.5, 1.2)]
    found = shape_path(model, *ends, winches=tc.Winches(rate=0.1))
    height = found.nodes[1, 2] - found.nodes[1, 0]
    across = found.nodes[0, 1] - found.nodes[0, 3]
    np.testing.assert_allclose(across**2 + height**2, 4.0, rtol=1e-12)
    np.testing.assert_allclose(found.force_density, 10.0, rtol=1e-10)
    assert np.abs(found.rest_length_rate).max() <= 0.1
    assert found.reference(found.time[::7]).nodes.shape == (2, 4, len(found.time[::7]))


def test_a_half_turn_of_a_d_bar_with_parallel_strings():
    """Each of two strings side by side has its own force density, and both balance one."""
    model = d_bar(((1, 3), (3, 1), (0, 2)), ("across", "across", "along"))
    found = shape_target(
        model, Height(1.2, [2], [0]), force_density=10.0, reference="along", symmetry=HALF_TURN,
        max_force_density=[8.0, 30.0, 30.0], min_force_density=1.0,
    )  # fmt: skip
    assert found.force_density[:2].sum() == pytest.approx(10.0, rel=1e-9)
    turned = -found.nodes[:, [2, 3, 0, 1]]
    np.testing.assert_allclose(turned, found.nodes, atol=1e-12)


def test_a_half_turn_takes_a_clustered_string_to_itself_run_through_the_other_way():
    """A closed string along the bars and one across: the other diagonal shortens no closed one."""
    model = d_bar(((0, 1, 2, 3, 0), (1, 3), (0, 2)), ("closed", "across", "along"))
    found = shape_target(
        model, Height(1.2, [2], [0]), force_density=10.0, reference="along", symmetry=HALF_TURN,
        max_force_density=30.0,
    )  # fmt: skip
    # The closed string is as long in every shape, so that its tension balances along the bars.
    np.testing.assert_allclose(found.force_density[1:], 10.0, rtol=1e-9)
    assert found.residual < 1e-12


def test_a_half_turn_takes_rollers_to_rollers():
    x_held = [(0, "x"), (2, "x")]
    found = shape_target(
        d_bar(fixed=x_held), Height(1.2, [2], [0]), force_density=10.0, symmetry=HALF_TURN
    )
    np.testing.assert_allclose(found.force_density, 10.0, rtol=1e-12)
    for fixed, message in (
        ([(0, "x")], "roller at node 0 to a roller that holds the same"),
        ([0], "fixed node 0 to a fixed node"),
    ):
        with pytest.raises(ValueError, match=message):
            shape_target(d_bar(fixed=fixed), force_density=10.0, symmetry=HALF_TURN)


# ---- an arm: two bars of 1 m and a slider, by virtual work ----


def arm(cluster=False):
    structure = coupled.arm(cluster)
    return tc.Model(structure, strings=tc.LinearStrings(STIFFNESS), gravity=GRAVITY)


def arm_lengths(angle, cluster):
    """Lengths of the strings of the arm, m, shape (2,)."""
    reach = 2 * np.cos(angle)
    slide = reach + np.hypot(reach - 0.8, 1.0) if cluster else reach
    return np.array([slide, np.hypot(np.cos(angle) - 0.8, np.sin(angle) + 1.0)])


def arm_energy(angle, cluster, rest_length):
    stretch = arm_lengths(angle, cluster) - rest_length
    return STIFFNESS * (stretch @ stretch) / 2 + (1.0 + 2.0) * GRAVITY * np.sin(angle)


@pytest.mark.parametrize("cluster", [False, True])
def test_an_arm_with_a_roller_is_balanced_by_virtual_work(cluster):
    model = arm(cluster)
    wanted = NodesAt([2], [[1.5]], directions="x")
    found = shape_target(model, wanted, force_density=60.0, reference="slide")
    angle, step = np.arccos(0.75), 1e-6
    np.testing.assert_allclose(found.nodes[:, 1], [0.75, np.sin(angle)], rtol=1e-12)
    at = arm_lengths(angle, cluster)
    rate = (arm_lengths(angle + step, cluster) - arm_lengths(angle - step, cluster)) / (2 * step)
    power = found.force_density * at @ rate + 3.0 * GRAVITY * np.cos(angle)
    assert abs(power) < 1e-6
    assert found.force_density[0] == pytest.approx(60.0)
    # The smallest stiffness is that of the only motion, by the squared speed of the nodes.
    energies = [arm_energy(angle + d, cluster, found.rest_length) for d in (-1e-4, 0.0, 1e-4)]
    stiffness = (energies[0] - 2 * energies[1] + energies[2]) / 1e-8
    squares = 1.0 + (2 * np.sin(angle)) ** 2
    assert found.stability_margin == pytest.approx(stiffness / squares, rel=1e-5)


def test_a_path_of_an_arm_is_balanced_all_the_way():
    model = arm(cluster=True)
    ends = [
        shape_target(model, NodesAt([2], [[x]], directions="x"), force_density=60.0)
        for x in (1.6, 1.3)
    ]
    found = shape_path(model, *ends, duration=2.0)
    assert (found.nodes[1, 2] == 0.0).all()
    for k in range(0, len(found.time), 20):
        nodes, gamma = found.nodes[:, :, k], found.force_density[:, k]
        moving = [1, 2]
        rates = model.acceleration(nodes[:, moving], np.zeros((2, 2)), gamma)
        assert np.abs(np.array(rates)).max() < 1e-10
        np.testing.assert_allclose(model.structure.string_length(nodes) - found.rest_length[:, k],
                                   gamma * model.structure.string_length(nodes) / STIFFNESS,
                                   rtol=1e-9)  # fmt: skip


# ---- a class-2 tower: two prisms on one another ----


@cache
def tower():
    return tc.Model(coupled.tower(), strings=tc.LinearStrings(STIFFNESS))


@pytest.mark.parametrize("symmetric", [False, True])
def test_a_class_2_tower_is_two_prisms(symmetric):
    rings = [0, 1, 2], [3, 4, 5], [6, 7, 8]
    demands = [Height(0.9, rings[1], rings[0]), Height(0.9, rings[2], rings[1])]
    symmetry = RotationalSymmetry(rings) if symmetric else None
    found = shape_target(tower(), demands, force_density=10.0, reference="along", symmetry=symmetry)
    assert tower().structure.structure_class == 2
    N = found.nodes
    radius = [
        np.linalg.norm(N[:, ring] - N[:, ring].mean(axis=1, keepdims=True), axis=0).mean()
        for ring in rings
    ]
    end, middle = radius[0], radius[1]
    assert radius[2] == pytest.approx(end, rel=1e-9)
    # A prism with radii a and b has √3 γ a/b along for γ in the ring of radius a, γ a²/b² around b.
    expected = (
        10.0 / np.sqrt(3) * np.repeat([np.sqrt(3), middle / end, 2 * end / middle], [6, 3, 3])
    )
    np.testing.assert_allclose(found.force_density[:12], expected, rtol=1e-8)
    np.testing.assert_allclose(found.force_density[12:], expected[6:9], rtol=1e-8)


# ---- redundant bars: vertebrae, balanced as rigid bodies ----


@cache
def spine():
    return tc.Model(coupled.spine(), strings=tc.LinearStrings(STIFFNESS), gravity=GRAVITY)


@pytest.mark.parametrize("symmetric", [False, True])
def test_a_vertebra_of_redundant_bars_is_balanced_as_a_rigid_body(symmetric):
    model = spine()
    structure = model.structure
    assert [block.is_redundant for block in structure.blocks] == [True]
    if symmetric:
        symmetry = RotationalSymmetry([[0, 1], [2, 3], [5, 6], [7, 8]])
        demands = [NodesAt([9], [[0.21]], directions="z")]
    else:
        symmetry, demands = None, [NodesAt([9], [[0.01], [0.005], [0.21]])]
    found = shape_target(
        model, demands, symmetry=symmetry, prestress="least", min_force_density=5.0
    )
    N, moving = found.nodes, np.arange(5, 10)
    assert found.bar_length_error < 1e-13  # of all ten, also of the one that is left out
    force = np.array(model.constant_force)
    for (start, end), gamma in zip(structure.strings, found.force_density, strict=True):
        force[:, start] += gamma * (N[:, end] - N[:, start])
        force[:, end] -= gamma * (N[:, end] - N[:, start])
    np.testing.assert_allclose(force[:, moving].sum(axis=1), 0.0, atol=1e-11)
    moment = np.cross(N[:, moving].T, force[:, moving].T).sum(axis=0)
    np.testing.assert_allclose(moment, 0.0, atol=1e-11)
    assert found.force_density.min() >= 5.0
    assert found.is_stable


def test_a_mirror_image_of_a_rigid_body_is_no_shape():
    structure = coupled.spine()
    triangle = tc.Structure([[0, 1, 0, 3], [0, 0, 1, 3]], [[0, 1], [1, 2], [2, 0]],
                            [[0, 3], [1, 3]], 1.0, fixed=[3])  # fmt: skip
    turn = tc.RotationalSymmetry([[0, 1, 2]], axis=[1.0, 2.0, 3.0]).rotation()
    assert not turned_over(structure, structure.nodes, turn @ structure.nodes)
    assert turned_over(structure, structure.nodes, -structure.nodes)
    assert not turned_over(triangle, triangle.nodes, -triangle.nodes)
    assert turned_over(triangle, triangle.nodes, triangle.nodes[::-1])
    assert not turned_over(coupled.d_bar(), coupled.d_bar().nodes, coupled.d_bar().nodes[::-1])


def test_a_net_without_bars():
    """Its middle hangs by W/(4 γ) below the mean of the four fixed nodes."""
    nodes = [[1.0, 0.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 0.0, -0.1]]
    net = tc.Structure(
        nodes, np.zeros((0, 2), int), [[i, 4] for i in range(4)], [], fixed=range(4),
        point_mass=[0.0, 0.0, 0.0, 0.0, 2.0],
    )  # fmt: skip
    model = tc.Model(net, gravity=GRAVITY)
    found = shape_target(model, force_density=10.0)
    np.testing.assert_allclose(found.nodes[:, 4], [0.0, 0.0, -2.0 * GRAVITY / 40.0], atol=1e-12)


# ---- a plant that follows ----


@pytest.mark.parametrize("name", ["d_bar", "arm", "spine"])
def test_mpc_moves_the_nonlinear_plant_along_a_path(name):
    strings, winches = tc.LinearStrings(2000.0, damping=2.0), tc.Winches(rate=0.5)
    forces = {"prestress": "least", "min_force_density": 20.0}
    if name == "d_bar":
        model = tc.Model(coupled.d_bar(), strings=strings)
        demands, forces = [Height(h, [2], [0]) for h in (1.5, 1.2)], {"force_density": 40.0}
    elif name == "arm":
        model = tc.Model(coupled.arm(cluster=True), strings=strings, gravity=GRAVITY)
        demands = [NodesAt([2], [[x]], directions="x") for x in (1.6, 1.3)]
    else:
        model = tc.Model(coupled.spine(), strings=strings, gravity=GRAVITY)
        demands = [NodesAt([9], [[x], [0.0]], directions="xy") for x in (0.0, 0.03)]
    start, goal = (shape_target(model, demand, **forces) for demand in demands)
    path = shape_path(model, start, goal, winches=winches, duration=1.3)
    (plant,) = path.plants(1, input="rest_length")
    mpc = tc.MPC(plant, horizon=8, sample_time=0.02, winches=winches, reference=path.reference())
    run = tc.simulate(
        model, 2.1, start.nodes, controller=mpc, winches=winches, step=5e-3,
        rest_length=path.rest_length[:, 0],
    )  # fmt: skip
    travel = np.abs(goal.nodes - start.nodes).max()
    assert travel > 0.02
    assert np.abs(run.nodes[:, :, -1] - goal.nodes).max() < 0.01 * travel


# ---- demands in the plane ----


def test_a_twist_in_the_plane_is_counterclockwise_from_bottom_to_top():
    model = d_bar()
    N = model.structure.nodes
    turned = Twist(np.radians(100.0), top=[1, 3], bottom=[2, 0])
    import casadi as ca

    # The diagonals are at right angles: the one along turns clockwise to the one across.
    miss = ca.Function("miss", [at := ca.SX.sym("N", 2, 4)], [turned.miss(at)])
    assert float(miss(N)) == pytest.approx(np.radians(-90.0 - 100.0) + 2 * np.pi)


def test_demands_of_another_dimension_are_refused():
    flat, solid = d_bar(), tower()
    for model, demand in (
        (solid, NodesAt([0], [[0.0], [1.0]])),
        (solid, PointAt([0, 1], [0.0, 1.0])),
        (solid, Height(1.0, [2], [0], axis=[0.0, 1.0])),
        (flat, NodesAt([0], np.zeros((3, 1)))),
        (flat, NodesAt([0], [[1.0]], directions="z")),
        (flat, PointAt([0], np.zeros(3))),
        (flat, Height(1.0, [2], [0], axis=[0.0, 0.0, 1.0])),
    ):
        with pytest.raises(ValueError, match=r"demands\[0\] is for nodes in"):
            shape_target(model, demand, force_density=10.0)
    with pytest.raises(ValueError, match="bars lie in layers"):
        shape_target(flat, force_density=10.0, min_clearance=0.1)
    about_x = RotationalSymmetry([[0, 2], [1, 3]], axis=[1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="plane turns about z"):
        shape_target(flat, force_density=10.0, symmetry=about_x)
