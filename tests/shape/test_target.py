"""Shapes asked for: closed forms, exact equilibria, symmetry, the nearest where there is none."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.shape import (
    Height,
    NodesAt,
    PointAt,
    RotationalSymmetry,
    ShapeError,
    Twist,
    shape_target,
)

TOP, BOTTOM = [0, 1, 2], [3, 4, 5]
LEVEL = 17.320508075688775
THREEFOLD = RotationalSymmetry([TOP, BOTTOM])


@cache
def free():
    return tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))


@cache
def twelve():
    """The prism with a second set of strings between top and bottom."""
    prism = tc.prism()
    strings = np.vstack([prism.strings, [[0, 5], [1, 3], [2, 4]]])
    groups = (*prism.string_groups, *["diagonal"] * 3)
    structure = tc.Structure(prism.nodes, prism.bars, strings, 1.0, string_groups=groups)
    return tc.Model(structure, strings=tc.LinearStrings(200.0))


@cache
def standing(stiffness=500.0):
    prism = tc.prism()
    structure = tc.Structure(
        prism.nodes, prism.bars, prism.strings, 1.0, fixed=BOTTOM,
        string_groups=prism.string_groups,
    )  # fmt: skip
    return tc.Model(structure, strings=tc.LinearStrings(stiffness), gravity=9.81)


def height(nodes):
    return nodes[2, TOP].mean() - nodes[2, BOTTOM].mean()


def twist(nodes):
    N = ca.SX.sym("N", 3, 6)
    return float(ca.Function("t", [N], [Twist(0.0, TOP, BOTTOM).miss(N)])(nodes))


def refuse_motion(target):
    """The model itself must say that the shape is at rest, with its true bars."""
    model = target.model
    free_nodes = model.structure.free
    Ndd = model.acceleration(
        target.nodes[:, free_nodes], np.zeros((3, len(free_nodes))), target.force_density
    )
    scale = max(target.force_density.max() / model.structure.bar_mass.min(), 10.0)
    assert np.abs(np.array(Ndd)).max() < 1e-12 * scale
    length = np.linalg.norm(model.structure.bar_vectors(target.nodes), axis=0)
    np.testing.assert_allclose(length, model.structure.bar_length, rtol=1e-13)
    assert target.bar_length_error < 1e-12
    load = np.abs(model.constant_force).max()
    assert target.residual < 1e-12 * max(target.force_density.max(), load)
    assert (target.force_density >= 0).all()
    if model.strings is not None:
        again = tc.to_force_density(model, target.nodes, target.rest_length)
        np.testing.assert_allclose(again, target.force_density, rtol=1e-9, atol=1e-9)


# ---- the twist, first: the other tests measure by it ----


@pytest.mark.parametrize(("sides", "turn"), [(3, 30.0), (4, 45.0), (6, 60.0)])
def test_the_twist_of_a_prism_is_a_right_angle_less_pi_over_its_sides(sides, turn):
    upper, lower = range(sides), range(sides, 2 * sides)
    for hand, sign in (("right", 1), ("left", -1)):
        nodes = tc.prism(sides, handedness=hand).nodes
        N = ca.SX.sym("N", 3, 2 * sides)
        for top, bottom in ((upper, lower), (lower, upper)):
            miss = ca.Function("m", [N], [Twist(np.radians(10.0), top, bottom).miss(N)])
            assert np.degrees(float(miss(nodes))) == pytest.approx(sign * turn - 10.0)


def test_the_twist_does_not_depend_on_place_or_direction():
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    nodes = tc.prism().nodes
    assert twist(turn @ nodes + 3.0) == pytest.approx(twist(nodes), abs=1e-14)


# ---- closed forms ----


@pytest.mark.parametrize("wanted", [0.3, 0.85, 1.2, 1.35])
def test_a_prism_of_a_height_is_the_one_of_the_closed_form(wanted):
    target = shape_target(free(), Height(wanted, TOP, BOTTOM), force_density=LEVEL)
    refuse_motion(target)
    assert height(target.nodes) == pytest.approx(wanted, abs=1e-13)
    radius = tc.structure.prism_radius(free().structure.bar_length[0], wanted)
    np.testing.assert_allclose(np.hypot(*target.nodes[:2]), radius, rtol=1e-8)
    expected = tc.statics.prism_force_density(3, LEVEL)[0]
    np.testing.assert_allclose(target.force_density, expected, rtol=1e-7)
    assert twist(target.nodes) == pytest.approx(-np.pi / 6, abs=1e-12)


@pytest.mark.parametrize("sides", [4, 6])
def test_prisms_of_more_sides(sides):
    model = tc.Model(tc.prism(sides))
    wanted = Height(0.8, range(sides), range(sides, 2 * sides))
    target = shape_target(model, wanted, force_density=10.0)
    expected = tc.statics.prism_force_density(sides, 10.0)[0]
    np.testing.assert_allclose(target.force_density, expected, rtol=1e-7)
    refuse_motion(target)


def test_unequal_radii_follow_from_a_bound_on_the_force_density():
    # γ_v = 2 sin(π/q) γ_t a/b and γ_b = γ_t a²/b²: a bound on γ_v settles a/b.
    target = shape_target(free(), force_density=LEVEL, max_force_density=25.0)
    refuse_motion(target)
    share = 25.0 / (np.sqrt(3) * LEVEL)
    np.testing.assert_allclose(target.force_density[6:], 25.0, rtol=1e-9)
    np.testing.assert_allclose(target.force_density[3:6], LEVEL * share**2, rtol=1e-8)
    centred = target.nodes - target.nodes[:, [0, 1, 2, 3, 4, 5]].mean(axis=1, keepdims=True)
    top, bottom = np.hypot(*centred[:2, TOP]), np.hypot(*centred[:2, BOTTOM])
    np.testing.assert_allclose(top / bottom, share, rtol=1e-8)


@pytest.mark.parametrize("degrees", [35.0, 45.0, 60.0, 80.0])
def test_with_a_second_set_of_strings_the_twist_is_free(degrees):
    wanted = Twist(np.radians(-degrees), TOP, BOTTOM)
    target = shape_target(twelve(), wanted, force_density=10.0, min_force_density=0.01)
    refuse_motion(target)
    assert twist(target.nodes) == pytest.approx(np.radians(-degrees), abs=1e-12)
    # Forces around the axis and along a radius balance at a node of the top, all radii equal.
    phi, third = np.radians(degrees), 2 * np.pi / 3
    vertical, diagonal = target.force_density[6], target.force_density[9]
    bar = target.prestress.bar_force_density[0]
    assert bar == pytest.approx(vertical + diagonal, rel=1e-7)
    around = [vertical * np.sin(phi), diagonal * np.sin(phi - third), -bar * np.sin(phi + third)]
    assert sum(around) == pytest.approx(0.0, abs=1e-6 * bar)
    inward = 3 * 10.0 + vertical * (1 - np.cos(phi)) + diagonal * (1 - np.cos(phi - third))
    assert inward == pytest.approx(bar * (1 - np.cos(phi + third)), rel=1e-7)
    assert target.is_stable


# ---- what a class-1 prism with nine strings can be ----


@pytest.mark.parametrize("degrees", [-20.0, -25.0, -35.0])
def test_another_twist_takes_a_prism_without_symmetry(degrees):
    wanted = Twist(np.radians(degrees), TOP, BOTTOM)
    target = shape_target(free(), wanted, force_density=LEVEL, min_force_density=1.0)
    refuse_motion(target)
    assert np.degrees(twist(target.nodes)) == pytest.approx(degrees, abs=1e-10)
    assert target.is_stable
    assert target.force_density.min() >= 1.0
    assert np.ptp(target.force_density[:3]) > 1.0  # not regular


def test_bars_keep_their_distance_where_it_is_asked_for():
    wanted = Twist(np.radians(-25.0), TOP, BOTTOM)
    asked = {"force_density": LEVEL, "min_force_density": 1.0}
    near = shape_target(free(), wanted, **asked)
    assert near.clearance < 0.04
    apart = shape_target(free(), wanted, min_clearance=0.06, **asked)
    refuse_motion(apart)
    assert apart.clearance == pytest.approx(0.06, abs=1e-10)
    with pytest.raises(ShapeError, match="clearance is") as caught:
        shape_target(free(), wanted, min_clearance=0.3, **asked)
    (missed,) = [check for check in caught.value.nearest.missed if check.name == "clearance"]
    assert missed.missed == pytest.approx(0.3 - caught.value.nearest.clearance)


def test_a_couple_about_the_axis_twists_a_prism_that_stays_regular():
    nodes = tc.prism().nodes
    force = 4.0 * np.vstack([-nodes[1], nodes[0], np.zeros(6)])
    force[:, BOTTOM] *= -1
    loaded = tc.Model(tc.prism(), strings=tc.LinearStrings(200.0), external_force=force)
    wanted = Twist(np.radians(-25.0), TOP, BOTTOM)
    target = shape_target(loaded, wanted, force_density=LEVEL, symmetry=THREEFOLD)
    refuse_motion(target)
    assert np.degrees(twist(target.nodes)) == pytest.approx(-25.0, abs=1e-10)
    assert np.ptp(target.force_density[6:]) < 1e-9


def test_with_symmetry_another_twist_is_refused_and_the_nearest_is_the_closed_form():
    wanted = Twist(np.radians(-20.0), TOP, BOTTOM)
    with pytest.raises(ShapeError, match=r"misses 1 of 1: twist is -0\.523599 rad") as caught:
        shape_target(free(), wanted, force_density=LEVEL, symmetry=THREEFOLD)
    nearest = caught.value.nearest
    refuse_motion(nearest)
    assert np.degrees(twist(nearest.nodes)) == pytest.approx(-30.0, abs=1e-8)
    assert nearest.missed[0].missed == pytest.approx(np.radians(10.0), abs=1e-9)
    assert "missed by 0.175 rad" in str(caught.value)


def test_a_height_beyond_the_bars_is_refused_and_the_nearest_reaches_their_length():
    bar = free().structure.bar_length[0]
    with pytest.raises(ShapeError, match=r"missed by 0\.11 m") as caught:
        shape_target(free(), Height(1.5, TOP, BOTTOM), force_density=LEVEL)
    nearest = caught.value.nearest
    refuse_motion(nearest)
    # All but upright: what is left of the radius is what strings must keep of their length.
    assert height(nearest.nodes) == pytest.approx(bar, abs=2e-4)
    assert height(nearest.nodes) <= bar + 1e-12
    assert nearest.prestress.structure.string_length().min() > 0.008
    (check,) = nearest.missed
    assert check.missed == pytest.approx(1.5 - height(nearest.nodes), abs=1e-12)


@pytest.mark.parametrize("rise", [-0.2, 0.2])
@pytest.mark.parametrize("fixed", [BOTTOM, ()])
def test_a_place_at_another_distance_than_the_bar_has_is_named(rise, fixed):
    prism = replace(tc.prism(), fixed=fixed)
    assert prism.bars[0].tolist() == [0, 4]
    demands = [NodesAt([0], prism.nodes[:, [0]] + [[0.0], [0.0], [rise]])]
    moved, other = 0, 4
    if not fixed:  # the other end has a place by a demand
        demands.append(NodesAt([4], prism.nodes[:, [4]]))
        moved, other = 4, 0
    apart = np.linalg.norm(demands[0].positions[:, 0] - prism.nodes[:, 4])
    text = (
        f"node {moved} would be {apart:.6g} m from node {other}; the bar between them has "
        f"{prism.bar_length[0]:.6g} m"
    )
    with pytest.raises(ShapeError, match=text):
        shape_target(tc.Model(prism), demands, force_density=LEVEL)
    demands[0] = replace(demands[0], tolerance=0.3)
    shape_target(tc.Model(prism), demands, force_density=LEVEL)


def test_a_height_that_a_bar_does_not_reach_is_named_wherever_its_node_is():
    prism = replace(tc.prism(), fixed=BOTTOM)
    high = NodesAt([0], [[1.5]], directions="z")
    with pytest.raises(ShapeError, match=r"node 0 would be at least 1\.5 m from node 4"):
        shape_target(tc.Model(prism), high, force_density=LEVEL)


def test_a_demand_that_supports_rule_out_blames_no_bar():
    prism = replace(tc.prism(), fixed=BOTTOM)
    with pytest.raises(ShapeError, match=r"near start that meets the demands\. The nearest"):
        shape_target(tc.Model(prism), NodesAt([4], [[2.0]], "z"), force_density=LEVEL)


def test_no_equilibrium_beside_the_nearest_is_nearer():
    random = np.random.default_rng(3)
    wanted = tc.prism().nodes + 0.02 * random.normal(size=(3, 6))
    with pytest.raises(ShapeError, match="18 of 18") as caught:
        shape_target(free(), NodesAt(range(6), wanted), force_density=LEVEL)
    nearest = caught.value.nearest
    refuse_motion(nearest)
    least = np.linalg.norm(nearest.nodes - wanted)
    assert least == pytest.approx(np.linalg.norm([check.missed for check in nearest.missed]))
    for _ in range(6):
        beside = nearest.nodes + 0.01 * random.normal(size=(3, 6))
        other = shape_target(free(), start=beside, force_density=LEVEL)
        assert np.linalg.norm(other.nodes - nearest.nodes) > 1e-4
        assert np.linalg.norm(other.nodes - wanted) > least


# ---- demands of every kind ----


def test_nodes_are_brought_to_their_places():
    place = tc.prism().nodes[:, [0]] + [[0.05], [-0.03], [0.02]]
    target = shape_target(free(), NodesAt([0], place), force_density=LEVEL)
    refuse_motion(target)
    np.testing.assert_allclose(target.nodes[:, [0]], place, atol=1e-13)


def test_demands_that_say_the_same_twice_do_no_harm():
    prism = tc.prism()
    demands = [NodesAt(range(6), prism.nodes), Height(1.0, TOP, BOTTOM)]
    target = shape_target(free(), demands, force_density=LEVEL)
    np.testing.assert_allclose(target.nodes, prism.nodes, atol=1e-10)


def test_a_tolerance_is_used_and_kept():
    random = np.random.default_rng(0)
    wanted = tc.prism().nodes + 0.01 * random.uniform(-1, 1, size=(3, 6))
    with pytest.raises(ShapeError):
        shape_target(free(), NodesAt(range(6), wanted), force_density=LEVEL)
    demand = NodesAt(range(6), wanted, tolerance=0.008)
    target = shape_target(free(), demand, force_density=LEVEL)
    refuse_motion(target)
    off = np.abs(target.nodes - wanted).max()
    assert off <= 0.008 * (1 + 1e-9)
    assert target.missed == ()


def test_a_standing_prism_carries_its_weight_and_leans_where_it_is_told():
    point = PointAt(TOP, [0.1, 0.05], directions="xy")
    target = shape_target(standing(), point, force_density=60.0)
    refuse_motion(target)
    np.testing.assert_allclose(target.nodes[:2, TOP].mean(axis=1), [0.1, 0.05], atol=1e-13)
    np.testing.assert_array_equal(target.nodes[:, BOTTOM], tc.prism().nodes[:, BOTTOM])
    assert target.is_stable


def test_a_weighted_point_of_a_bar():
    prism = tc.prism()
    point = PointAt(prism.bars[0], [0.0, 0.0, 0.4], weights=[1.0, 3.0], tolerance=0.01)
    target = shape_target(free(), point, force_density=LEVEL)
    refuse_motion(target)
    start, end = target.nodes[:, prism.bars[0]].T
    np.testing.assert_allclose(0.25 * start + 0.75 * end, [0.0, 0.0, 0.4], atol=0.01 + 1e-12)


def test_the_range_of_the_winches_is_kept():
    wanted, winches = Height(0.85, TOP, BOTTOM), tc.Winches(shortest=0.65, longest=1.0)
    before = shape_target(free(), wanted, force_density=LEVEL)
    assert before.rest_length.min() < 0.64
    target = shape_target(free(), wanted, force_density=LEVEL, winches=winches)
    refuse_motion(target)
    assert target.rest_length.min() == pytest.approx(0.65, abs=1e-12)


def test_a_range_that_cannot_be_kept_is_named():
    winches = tc.Winches(shortest=1.1)
    with pytest.raises(
        ShapeError, match=r"rest_length\[\d\] is .* m, wanted at least 1.1 m"
    ) as caught:
        shape_target(free(), force_density=LEVEL, winches=winches)
    missed = {check.name: check.missed for check in caught.value.nearest.missed}
    name, by = next(iter(missed.items()))
    string = int(name.split("[")[1][:-1])
    assert by == pytest.approx(1.1 - caught.value.nearest.rest_length[string])


# ---- symmetry ----


@pytest.mark.parametrize("symmetry", [None, THREEFOLD])
def test_a_symmetric_demand_gets_a_symmetric_answer(symmetry):
    target = shape_target(free(), Height(0.9, TOP, BOTTOM), force_density=LEVEL, symmetry=symmetry)
    turned = THREEFOLD.rotation() @ target.nodes
    np.testing.assert_allclose(turned, target.nodes[:, THREEFOLD.permutation(6)], atol=1e-9)
    for group in ("top", "bottom", "vertical"):
        assert np.ptp(target.force_density[free().structure.strings_in(group)]) < 1e-6


def test_symmetry_is_kept_under_load_and_stability_is_asked_of_all_motions():
    target = shape_target(
        standing(), Height(0.95, TOP, BOTTOM), force_density=60.0, symmetry=THREEFOLD
    )
    refuse_motion(target)
    turned = THREEFOLD.rotation() @ target.nodes
    np.testing.assert_allclose(turned, target.nodes[:, THREEFOLD.permutation(6)], atol=1e-12)
    without = shape_target(standing(), Height(0.95, TOP, BOTTOM), force_density=60.0)
    assert target.stability_margin == pytest.approx(without.stability_margin, rel=1e-5)


def test_what_has_not_the_symmetry_is_refused():
    with pytest.raises(ValueError, match=r"takes string 0, nodes \[0, 1\], to nodes \[1, 5\]"):
        shape_target(free(), force_density=1.0, symmetry=RotationalSymmetry([[0, 1, 5], [3, 4, 2]]))
    sideways = tc.Model(standing().structure, gravity=[1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="does not map the loads and weights"):
        shape_target(sideways, force_density=1.0, symmetry=THREEFOLD)
    off = RotationalSymmetry([TOP, BOTTOM], centre=[0.1, 0.0, 0.0])
    with pytest.raises(ValueError, match="does not take the fixed node 3 to a fixed node"):
        shape_target(standing(), force_density=1.0, symmetry=off)


# ---- prestress ----


def test_least_and_centred_forces_among_several_states():
    wanted = Twist(np.radians(-60.0), TOP, BOTTOM)
    bounds = {"force_density": 20.0, "min_force_density": 2.0, "max_force_density": 60.0}
    least = shape_target(twelve(), wanted, prestress="least", **bounds)
    centred = shape_target(twelve(), wanted, prestress="centred", **bounds)
    for target in (least, centred):
        refuse_motion(target)
        assert target.force_density[:3].mean() == pytest.approx(20.0)
        assert (target.force_density >= 2.0).all()
        assert (target.force_density <= 60.0).all()
    assert least.prestress.self_stress_states > 1
    # Each is best in its own sense among the others in the same shape.
    E = tc.statics.equilibrium_matrix(least.prestress.structure)
    _, sizes, Vt = np.linalg.svd(E)
    states = Vt[np.count_nonzero(sizes > 1e-9 * sizes[0]) :].T
    mean = states[:3].mean(axis=0)
    moves = (states @ np.linalg.svd(mean[None])[2][1:].T)[:12]
    assert moves.shape[1] >= 2
    gamma = least.force_density
    at_bound = (gamma < 2.0 + 1e-9) | (gamma > 60.0 - 1e-9)
    assert not at_bound.any()
    np.testing.assert_allclose(moves.T @ gamma, 0.0, atol=1e-8)
    gamma = centred.force_density
    slope = 1 / (gamma - 2.0) - 1 / (60.0 - gamma)
    np.testing.assert_allclose(moves.T @ slope, 0.0, atol=1e-8)


def test_the_level_may_follow_from_bounds():
    target = shape_target(free(), prestress="least", min_force_density=20.0)
    refuse_motion(target)
    assert target.force_density.min() == pytest.approx(20.0)
    assert target.force_density.max() < 60.0


# ---- stability ----


def test_the_margin_is_the_softest_direction_of_the_linearized_model():
    target = shape_target(free(), Height(0.85, TOP, BOTTOM), force_density=LEVEL)
    # An independent figure: second differences of the energy along bar-preserving motions.
    model = target.model
    basis = tc.dynamics.coordinates(model, target.nodes, "internal")

    def energy(q):
        nodes = basis.to_nodes(q)
        x = np.concatenate([nodes.ravel(order="F"), np.zeros(18)])
        return float(model.elastic_energy(x, target.rest_length))

    h, eye = 1e-4, np.eye(9)
    at = np.zeros(9)
    K = np.array(
        [
            [
                energy(at + h * (a + b)) - energy(at + h * (a - b))
                - energy(at + h * (b - a)) + energy(at - h * (a + b))
                for b in eye
            ]
            for a in eye
        ]
    ) / (4 * h * h)  # fmt: skip
    # In the metric of the node displacements, less what moves the body as one.
    T = basis.basis
    rigid = np.linalg.qr(
        np.column_stack(
            [np.tile(e, 6) for e in np.eye(3)]
            + [np.cross(e, target.nodes.T).ravel() for e in np.eye(3)]
        )
    )[0]
    T = T - rigid @ (rigid.T @ T)
    softest = np.linalg.eigvals(np.linalg.solve(T.T @ T, K)).real.min()
    assert target.stability_margin == pytest.approx(softest, rel=1e-4)


def test_a_shape_that_gives_way_is_refused_unless_it_is_wanted():
    # A bar on a hinge, held upright by two strings from above: it hangs or it falls over.
    nodes = [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0], [0.0, 1.0, 0.5, 0.5]]
    bar = tc.Structure(nodes, [[0, 1]], [[1, 2], [1, 3]], 1.0, fixed=[0, 2, 3])
    model = tc.Model(bar, strings=tc.ElasticStrings(0.5), gravity=9.81)
    asked = {"force_density": 0.1, "reference": "string", "prestress": "least"}
    with pytest.raises(ShapeError, match="is unstable") as caught:
        shape_target(model, **asked)
    assert caught.value.nearest.stability_margin < 0
    target = shape_target(model, require_stable=False, **asked)
    assert not target.is_stable
    refuse_motion(target)


def test_a_target_is_an_operating_point_for_control():
    target = shape_target(free(), Height(0.85, TOP, BOTTOM), force_density=LEVEL)
    plant = tc.linearize(target.model, target.prestress)
    assert np.abs(plant.drift).max() < 1e-10
    assert tc.LQR(plant, 1.0, 1e-3).poles.real.max() < 0
    still = tc.simulate(target.model, 1.0, target.nodes, rest_length=target.rest_length, step=1e-3)
    np.testing.assert_allclose(still.nodes[:, :, -1], target.nodes, atol=1e-10)


def test_a_tip_far_out_of_reach_is_told_with_the_nearest_shape():
    """The arm is straight there, with all bars in line."""
    arm = tc.library.arm()
    tip = arm.nodes[:, [5]] + [[9.0], [0.0]]
    with pytest.raises(ShapeError, match=r"x\[5\] is 2\.82843 m, wanted 11 m") as failure:
        tc.shape_target(tc.Model(arm), tc.NodesAt([5], tip), force_density=10.0)
    assert failure.value.nearest.residual < 1e-9
