"""Stances: closed forms, friction cones, tipping, and what cannot stand."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc

GRAVITY = 9.81


def wound(structure, ground, level=50.0, stiffness=1e3):
    """A model on ground, and the rest lengths that give its strings a prestress without weight."""
    strings = tc.LinearStrings(stiffness)
    model = tc.Model(structure, strings=strings, gravity=GRAVITY, ground=ground)
    rest = tc.prestress(structure, min_force_density=level)
    return model, tc.to_rest_length(model, structure.nodes, rest.force_density).rest_length


def ball_on_face(**ground):
    model, lengths = wound(tc.library.six_bar_ball(1.0), tc.Ground(**{"stiffness": 5e3} | ground))
    return model, lengths, tc.plant.set_down(model, [0, 4, 8])


def slope(degrees, stiffness=5e3, friction=0.5):
    angle = np.radians(degrees)
    normal = [np.sin(angle), 0.0, np.cos(angle)]
    return tc.Ground(stiffness, friction=friction, normal=normal)


def trestle(count, spread=0.6, height=0.8):
    """Bars of 1 m and 2 kg from an apex to the ground, in space; two in the plane."""
    angle = 2 * np.pi * np.arange(count) / count
    feet = [spread * np.cos(angle), spread * np.sin(angle), 0 * angle]
    nodes = np.column_stack([[0.0, 0.0, height], feet])
    nodes = nodes[[0, 2]] if count == 2 else nodes
    bars = [[0, i + 1] for i in range(count)]
    return tc.Structure(nodes, bars, np.zeros((0, 2), int), 2.0)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_trestle_presses_its_feet_apart_as_the_closed_form_says(count):
    structure = trestle(count)
    model = tc.Model(structure, gravity=GRAVITY, ground=tc.Ground(1e7, friction=0.5))
    stance = tc.equilibrium(model, force_density=[])
    found = stance.contacts
    # Of each bar: F_n = m g, and about the apex F_n a - m g a/2 = H h.
    np.testing.assert_allclose(found.normal_force, 2 * GRAVITY, rtol=1e-9)
    size = np.linalg.norm(found.tangential_force, axis=0)
    np.testing.assert_allclose(size, GRAVITY * 0.6 / 0.8, rtol=1e-5)
    np.testing.assert_allclose(found.cone_use, size / (0.5 * found.normal_force), rtol=1e-12)
    assert found.node.tolist() == list(range(1, count + 1))
    np.testing.assert_allclose(stance.bars_in_tension, [])
    slippery = tc.Model(structure, gravity=GRAVITY, ground=tc.Ground(1e7, friction=0.3))
    with pytest.raises(ValueError, match="no equilibrium"):
        tc.equilibrium(slippery, force_density=[])


def test_contact_forces_are_the_weight_and_those_of_the_law():
    model, lengths, start = ball_on_face(friction=0.5)
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start)
    found = stance.contacts
    np.testing.assert_allclose(found.force.sum(axis=1), [0, 0, 6 * GRAVITY], atol=1e-10)
    np.testing.assert_allclose(found.normal_force, 5e3 * found.depth, rtol=1e-10)
    np.testing.assert_allclose(stance.load, model.constant_force, atol=1e-12)
    # They keep the places that they have at the start, and the model agrees that all is at rest.
    places = stance.structure.nodes[:2, [0, 4, 8]]
    np.testing.assert_allclose(places, start[:2, [0, 4, 8]], atol=1e-12)
    assert 0.1 < found.cone_use.max() < 0.3
    assert stance.residual < 1e-11
    assert stance.least_stiffness > 10
    assert "on nodes [0, 4, 8]" in repr(stance)


@pytest.mark.parametrize("law", [tc.Ground, tc.dynamics.HertzGround, tc.dynamics.SmoothGround])
def test_the_model_is_at_rest_where_feet_push_nothing_sideways(law):
    structure = tc.library.six_bar_ball(1.0)
    model, lengths = wound(structure, law(1e5, friction=0.5))
    start = tc.plant.set_down(model, [0, 8, 2])
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start, settle=True)
    found = stance.contacts
    assert np.abs(found.tangential_force).max() < 1e-10
    np.testing.assert_allclose(found.normal_force.sum(), 6 * GRAVITY, rtol=1e-12)
    Ndd = model.acceleration(stance.structure.nodes, np.zeros(start.shape), stance.force_density)
    assert np.abs(np.array(Ndd)).max() < 1e-9


@pytest.mark.parametrize("degrees", [5.0, 20.0])
def test_on_a_slope_all_feet_use_the_same_part_of_their_friction(degrees):
    model, lengths = wound(tc.library.class2_tower(floating=True), slope(degrees), 20.0)
    start = tc.plant.set_down(model, [0, 1, 2])
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start, settle=True)
    use = np.tan(np.radians(degrees)) / 0.5
    np.testing.assert_allclose(stance.contacts.cone_use, use, rtol=1e-4)
    total = stance.contacts.force.sum(axis=1)
    np.testing.assert_allclose(total, [0, 0, 6 * GRAVITY], atol=1e-10)
    assert stance.least_stiffness > 1
    slippery = slope(degrees, friction=0.9 * use * 0.5)
    model, lengths = wound(tc.library.class2_tower(floating=True), slippery, 20.0)
    with pytest.raises(ValueError, match="no equilibrium"):
        tc.equilibrium(model, rest_length=lengths, nodes=start)


def test_the_margin_against_tipping_is_that_of_geometry():
    model, lengths, start = ball_on_face(friction=0.5)
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start)
    nodes = stance.structure.nodes
    side = np.linalg.norm(start[:, 0] - start[:, 4])
    assert stance.tipping.margin == pytest.approx(side / np.sqrt(12), rel=1e-3)
    centre = nodes[2].mean() - nodes[2, [0, 4, 8]].mean()
    assert stance.tipping.angle == pytest.approx(np.arctan2(stance.tipping.margin, centre))
    assert set(stance.tipping.edge) < {0, 4, 8}
    # A weight at a node moves the line of action towards it: 2 N more of 6 m g.
    heavy = tc.Model(
        model.structure, strings=model.strings, external_force=True, gravity=GRAVITY,
        ground=model.ground,
    )  # fmt: skip
    load = np.zeros(start.shape)
    load[2, 0] = -2.0
    other = tc.equilibrium(heavy, rest_length=lengths, nodes=start, external_force=load)
    shape = other.structure.nodes
    line = (shape[:2].mean(axis=1) * 6 * GRAVITY + shape[:2, 0] * 2.0) / (6 * GRAVITY + 2)
    ends = shape[:2, list(other.tipping.edge)]
    across = np.array([[0, -1], [1, 0]]) @ (ends[:, 1] - ends[:, 0])
    distance = abs(across @ (line - ends[:, 0])) / np.linalg.norm(across)
    assert other.tipping.margin == pytest.approx(distance, rel=1e-9)
    assert 0 in other.tipping.edge


def test_a_slope_as_steep_as_the_margin_says_tips_it_over():
    tower = tc.library.class2_tower(floating=True)
    model, lengths = wound(tower, slope(0.0, 1e5, 5.0), 50.0, 1e5)
    level = tc.equilibrium(model, rest_length=lengths, settle=True)
    angle = np.degrees(level.tipping.angle)
    for part in (0.97, 1.03):
        model, lengths = wound(tower, slope(part * angle, 1e5, 5.0), 50.0, 1e5)
        # The edge of least margin is downhill where the slope falls towards node 0's opposite.
        start = tc.plant.set_down(model, [0, 1, 2], turned(tower.nodes, level.tipping.edge))
        if part < 1:
            stance = tc.equilibrium(model, rest_length=lengths, nodes=start)
            assert 0 < stance.tipping.margin < 0.1 * level.tipping.margin
        else:
            with pytest.raises(ValueError, match="falls"):
                tc.equilibrium(model, rest_length=lengths, nodes=start)


def turned(nodes, edge):
    """The nodes turned about z so that an edge is at the largest x, along y."""
    middle = nodes[:2, list(edge)].mean(axis=1) - nodes[:2].mean(axis=1)
    angle = -np.arctan2(middle[1], middle[0])
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turn @ nodes


def test_a_structure_in_the_air_is_let_down():
    model, lengths, start = ball_on_face(friction=0.5)
    there = tc.equilibrium(model, rest_length=lengths, nodes=start)
    high = tc.equilibrium(model, rest_length=lengths, nodes=start + np.c_[[0.0, 0.0, 3.0]])
    np.testing.assert_allclose(high.structure.nodes, there.structure.nodes, atol=1e-10)
    wall = tc.Model(
        model.structure, strings=model.strings, gravity=GRAVITY,
        ground=tc.Ground(5e3, normal=[1.0, 0.0, 0.0], height=-9.0),
    )  # fmt: skip
    with pytest.raises(ValueError, match="without meeting ground"):
        tc.equilibrium(wall, rest_length=lengths)


def test_what_falls_over_is_refused():
    model, lengths, _ = ball_on_face(friction=0.5)
    with pytest.raises(ValueError, match=r"falls.*set_down"):
        tc.equilibrium(model, rest_length=lengths)  # on an edge
    pole = tc.Structure([[0.0, 0.3], [0.0, 1.0]], [[0, 1]], np.zeros((0, 2), int), 1.0)
    model = tc.Model(pole, gravity=GRAVITY, ground=tc.Ground(5e3, friction=0.5))
    with pytest.raises(ValueError, match="falls"):
        tc.equilibrium(model, force_density=[])


def test_a_bar_lies_on_the_ground_without_strain():
    bar = tc.Structure([[0.0, 1.0], [0.0, 0.0]], [[0, 1]], np.zeros((0, 2), int), 1.0)
    model = tc.Model(bar, gravity=GRAVITY, ground=tc.Ground(5e3, friction=0.5))
    stance = tc.equilibrium(model, force_density=[])
    np.testing.assert_allclose(stance.contacts.normal_force, GRAVITY / 2)
    np.testing.assert_allclose(stance.contacts.tangential_force, 0, atol=1e-10)
    assert stance.tipping.margin == pytest.approx(0.5)
    assert stance.tipping.angle == pytest.approx(np.pi / 2)


def test_a_planar_frame_stands_on_a_line():
    model, lengths = wound(tc.library.snelson_x(dimension=2), tc.Ground(5e3, friction=0.8))
    stance = tc.equilibrium(model, rest_length=lengths)
    np.testing.assert_allclose(stance.contacts.force.sum(axis=1), [0, 2 * GRAVITY], atol=1e-10)
    assert stance.tipping.margin == pytest.approx(0.5, rel=1e-3)
    assert len(stance.tipping.edge) == 1


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_hinged_bar_comes_down_on_the_ground(friction):
    bar = tc.Structure([[0.0, 1.0], [0.5, 0.6]], [[0, 1]], np.zeros((0, 2), int), 2.0, fixed=[0])
    model = tc.Model(bar, gravity=GRAVITY, ground=tc.Ground(1e6, friction=friction))
    stance = tc.equilibrium(model, force_density=[])
    np.testing.assert_allclose(stance.contacts.force, [[0], [GRAVITY]], atol=1e-9)
    assert stance.contacts.depth[0] == pytest.approx(GRAVITY / 1e6)
    assert stance.tipping is None


def test_without_friction_it_slides_freely():
    model, lengths, start = ball_on_face()
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start)
    assert stance.least_stiffness == 0
    assert (stance.contacts.cone_use == 1).all()
    with pytest.raises(ValueError, match="no support"):
        tc.linearize(model, stance)


def test_a_ball_in_a_valley_and_in_a_corner():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    valley = tc.Ground(5e3, friction=0.5, height=ca.Function("h", [x, y], [0.2 * (x**2 + y**2)]))
    model, lengths = wound(tc.library.six_bar_ball(1.0), valley)
    start = tc.plant.set_down(model, [0, 4, 8])
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start, settle=True)
    np.testing.assert_allclose(stance.contacts.force.sum(axis=1), [0, 0, 6 * GRAVITY], atol=1e-10)
    off = (stance.contacts.normal * stance.contacts.tangential_force).sum(axis=0)
    assert np.abs(off).max() < 1e-9
    floor = tc.Ground(5e3, friction=0.5)
    wall = tc.Ground(5e3, friction=0.5, normal=[1.0, 0.0, 0.0], height=-0.1)
    block = trestle(3)
    model = tc.Model(block, gravity=GRAVITY, ground=[floor, wall])
    stance = tc.equilibrium(model, force_density=[], nodes=block.nodes + np.c_[[0.2, 0.0, 0.0]])
    assert stance.contacts.ground.tolist() == [0, 0, 0, 1, 1]
    np.testing.assert_allclose(stance.contacts.force.sum(axis=1), [0, 0, 6 * GRAVITY], atol=1e-10)


def test_linearized_about_a_stance_its_feet_are_supports():
    model, lengths, start = ball_on_face(friction=0.5)
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start)
    plant = tc.linearize(model, stance, input="rest_length")
    assert plant.model.structure.fixed.tolist() == plant.feet.tolist() == [0, 4, 8]
    assert plant.model.ground == ()
    np.testing.assert_allclose(plant.rest_length, lengths, rtol=1e-9)
    ball = model.structure
    held = tc.Structure(stance.structure.nodes, ball.bars, ball.strings, 1.0, fixed=[0, 4, 8])
    other = tc.linearize(
        tc.Model(held, strings=model.strings, gravity=GRAVITY),
        tc.OperatingPoint(held.nodes, stance.force_density, stance.load), input="rest_length",
    )  # fmt: skip
    np.testing.assert_allclose(plant.A, other.A)
    np.testing.assert_allclose(plant.B, other.B)
    loaded = tc.Model(
        ball, strings=model.strings, gravity=GRAVITY, ground=model.ground, external_force=True
    )
    asked = {"rest_length": lengths, "nodes": start, "external_force": np.zeros(start.shape)}
    same = tc.linearize(loaded, tc.equilibrium(loaded, **asked), input="rest_length")
    np.testing.assert_allclose(same.A, plant.A, atol=1e-9 * np.abs(plant.A).max())
    assert same.model.has_external_force
    rough = tc.plant.in_coordinates(plant, "nodes")
    assert rough.feet.tolist() == [0, 4, 8]


def test_z_is_measured_relative_to_the_feet():
    model, lengths, start = ball_on_face(friction=0.5)
    stance = tc.equilibrium(model, rest_length=lengths, nodes=start)
    plant = tc.linearize(model, stance, input="rest_length")
    r = plant.degrees_of_freedom
    rng = np.random.default_rng(0)
    q, rates = 0.02 * rng.normal(size=(2, r))
    nodes, velocities = plant.to_nodes(q), plant.to_velocities(q, rates)
    np.testing.assert_allclose(plant.measure(nodes, velocities), np.r_[q, rates], atol=1e-12)
    # All of it moved and turned a little, with a speed, is measured as before, to second order.
    for small in (1e-2, 1e-3):
        spin, shift, speed = small * rng.normal(size=(3, 3))
        cross = np.cross(np.eye(3), spin)
        moved = nodes + shift[:, None] + cross @ nodes
        faster = velocities + speed[:, None] + cross @ velocities + 3 * cross @ moved
        z = plant.measure(moved, faster)
        np.testing.assert_allclose(z, np.r_[q, rates], atol=20 * small * np.abs(q).max())
        if small == 1e-3:
            assert np.abs(z[:r] - q).max() < 2e-4


def test_stiff_and_sticky_ground_has_the_modes_of_the_stance():
    """The lowest frequencies of the compliant plant near those of the stance, ever closer."""
    off = []
    for stiffness, slip in ((1e6, 1e-5), (1e7, 1e-6), (1e8, 1e-7)):
        ground = {"stiffness": stiffness, "friction": 0.8, "slip_speed": slip}
        model, lengths, start = ball_on_face(**ground)
        stance = tc.equilibrium(model, rest_length=lengths, nodes=start, settle=True)
        at = tc.OperatingPoint(stance.structure.nodes, stance.force_density, stance.load)
        compliant = tc.linearize(model, at, input="rest_length", coordinates="minimal")
        stands = tc.linearize(model, stance, input="rest_length")
        wanted = np.sort(np.linalg.eigvals(stands.A).imag)
        wanted = wanted[wanted > 0]
        found = np.linalg.eigvals(compliant.A)
        near = [np.abs(found - 1j * each).min() for each in wanted]
        off.append(max(np.array(near) / wanted))
    assert off[1] < 0.15 * off[0]
    assert off[2] < 0.15 * off[1]
    assert off[2] < 1e-5


def test_a_contact_that_slips_or_just_touches_is_no_support():
    model, lengths = wound(tc.library.snelson_x(dimension=2), tc.Ground(5e3, friction=0.8))
    use = tc.equilibrium(model, rest_length=lengths).contacts.cone_use.max()
    model, lengths = wound(model.structure, tc.Ground(5e3, friction=0.8 * use * 1.001))
    stance = tc.equilibrium(model, rest_length=lengths)
    with pytest.raises(ValueError, match="of its friction is used"):
        tc.linearize(model, stance)
    # A load that all but lifts an end of a bar.
    bar = tc.Structure([[0.0, 1.0], [0.0, 0.0]], [[0, 1]], np.zeros((0, 2), int), 1.0)
    ground = tc.Ground(5e3, friction=0.5)
    model = tc.Model(bar, external_force=True, gravity=GRAVITY, ground=ground)
    load = [[0.0, 0.0], [0.0, GRAVITY / 2 * (1 - 1e-4)]]
    stance = tc.equilibrium(model, force_density=[], external_force=load)
    np.testing.assert_allclose(stance.contacts.normal_force, [GRAVITY / 2, GRAVITY / 2e4])
    with pytest.raises(ValueError, match=r"node 1 .* just touches"):
        tc.linearize(model, stance)


def test_feet_that_would_slip_settle_where_all_use_the_same_part():
    """A T-bar on its side, in the plane, and a ball on an open face: their feet spread."""
    bar = tc.library.t_bar()
    bar = tc.Structure(bar.nodes, bar.bars, bar.strings, 1.0)
    for structure, feet in ((bar, [1, 2]), (tc.library.six_bar_ball(1.0), [0, 8, 2])):
        model, lengths = wound(structure, tc.Ground(2e4, friction=0.4))
        start = tc.plant.set_down(model, feet)
        stance = tc.equilibrium(model, rest_length=lengths, nodes=start)
        assert np.abs(stance.contacts.tangential_force).max() < 1e-9
        sticky, _ = wound(structure, tc.Ground(2e4, friction=5.0))
        stays = tc.equilibrium(sticky, rest_length=lengths, nodes=start)
        assert np.abs(stays.contacts.tangential_force).max() > 5
        moved = stays.structure.nodes[:-1, feet] - start[:-1, feet]
        np.testing.assert_allclose(moved, 0, atol=1e-12)


def test_a_stance_of_strings_with_mass_is_commanded_by_whole_strings():
    x = tc.library.snelson_x(dimension=2)
    ground = tc.Ground(2e4, friction=0.8, nodes=[0, 1, 2, 3])  # the bottom string sags
    whole, lengths = wound(x, ground, stiffness=2e3)
    massive = tc.subdivide(x, 2, string_mass=0.02)
    strings = tc.LinearStrings(4e3, damping=0.5)
    model = tc.Model(massive, strings=strings, gravity=GRAVITY, ground=whole.ground)
    parts = lengths[massive.string_parent] / 2
    stance = tc.equilibrium(model, rest_length=parts, settle=True)
    plant = tc.plant.command_parents(tc.linearize(model, stance, input="rest_length"))
    assert plant.commanded.fixed.tolist() == plant.feet.tolist() == [0, 1]
    lqr = tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.01)
    run = tc.simulate(model, 0.05, stance.structure.nodes, controller=lqr, step=2e-4, error="none")
    np.testing.assert_allclose(run.nodes[:, :, -1], stance.structure.nodes, atol=1e-6)


def test_a_tall_tower_stands_as_on_supports():
    """It twists under its weight, by more than a structure that falls may tilt."""
    held = tc.library.class2_tower(stages=15)
    level, strings = 200.0, tc.LinearStrings(1e5)
    gamma = tc.prestress(held, min_force_density=level).force_density
    model = tc.Model(held, strings=strings, gravity=GRAVITY)
    lengths = tc.to_rest_length(model, held.nodes, gamma).rest_length
    on_supports = tc.equilibrium(model, rest_length=lengths)
    free = tc.library.class2_tower(stages=15, floating=True)
    ground = tc.Ground(1e8, friction=0.8)
    model, lengths = wound(free, ground, level, 1e5)
    stance = tc.equilibrium(model, rest_length=lengths)
    moved = on_supports.structure.nodes - held.nodes
    assert np.linalg.norm(moved, axis=0).max() > 0.5
    np.testing.assert_allclose(stance.structure.nodes, on_supports.structure.nodes, atol=1e-2)
    softest = on_supports.tangent_stiffness(1e5).eigenvalues[0]
    assert stance.least_stiffness == pytest.approx(softest, rel=0.01)
