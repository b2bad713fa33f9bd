"""Paths: equilibrium everywhere, within the limits of the winches, and followed by the plant."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Controller
from tenscontrol.shape import Height, PathError, PointAt, Twist, shape_path, shape_target
from tenscontrol.shape.equilibrium_path import TimeScaling
from tenscontrol.structure.bar_clearance import bar_distances

TOP, BOTTOM = [0, 1, 2], [3, 4, 5]
LEVEL = 17.320508075688775
RATE = 0.1


def model_of(damping=0.0):
    return tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=damping))


@cache
def model():
    return model_of()


@cache
def start():
    return tc.prestress(tc.prism(), force_density=LEVEL)


@cache
def low():
    return shape_target(model(), Height(0.85, TOP, BOTTOM), force_density=LEVEL)


@cache
def twisted():
    demands = [Height(0.85, TOP, BOTTOM), Twist(np.radians(-25.0), TOP, BOTTOM)]
    return shape_target(model(), demands, force_density=LEVEL, min_force_density=1.0)


@cache
def path(goal="low"):
    end = {"low": low, "twisted": twisted}[goal]()
    return shape_path(model(), start(), end, winches=tc.Winches(rate=RATE), min_force_density=1.0)


@pytest.mark.parametrize("goal", ["low", "twisted"])
def test_every_shape_is_an_equilibrium(goal):
    found = path(goal)
    for k in range(len(found.time)):
        nodes, gamma = found.nodes[:, :, k], found.force_density[:, k]
        Ndd = model().acceleration(nodes, np.zeros((3, 6)), gamma)
        assert np.abs(np.array(Ndd)).max() < 1e-11
        length = np.linalg.norm(model().structure.bar_vectors(nodes), axis=0)
        np.testing.assert_allclose(length, model().structure.bar_length, rtol=1e-13)
        again = tc.to_force_density(model(), nodes, found.rest_length[:, k])
        np.testing.assert_allclose(again, gamma, rtol=1e-10)
    assert found.residual < 1e-12
    assert found.bar_length_error < 1e-13
    assert found.force_density.min() >= 1.0
    assert found.stability_margin > 10.0
    assert 0.04 < found.clearance < 0.25


@pytest.mark.parametrize("goal", ["low", "twisted"])
def test_it_begins_and_ends_where_it_should_at_rest(goal):
    found = path(goal)
    end = {"low": low, "twisted": twisted}[goal]()
    np.testing.assert_allclose(found.nodes[:, :, 0], start().structure.nodes, atol=1e-12)
    np.testing.assert_allclose(found.nodes[:, :, -1], end.nodes, atol=1e-12)
    np.testing.assert_allclose(found.force_density[:, -1], end.force_density, rtol=1e-10)
    np.testing.assert_allclose(found.rest_length[:, -1], end.rest_length, rtol=1e-10)
    np.testing.assert_array_equal(found.velocities[:, :, [0, -1]], 0.0)
    np.testing.assert_array_equal(found.rest_length_rate[:, [0, -1]], 0.0)


def test_a_change_of_height_goes_through_the_prisms_of_the_closed_form():
    found = path()
    height = found.nodes[2, TOP].mean(axis=0) - found.nodes[2, BOTTOM].mean(axis=0)
    assert (np.diff(height) < 0).all()
    bar = model().structure.bar_length[0]
    radius = [tc.structure.prism_radius(bar, h) for h in height]
    np.testing.assert_allclose(np.hypot(*found.nodes[:2])[0], radius, rtol=1e-8)
    expected = tc.statics.prism_force_density(3, LEVEL)[0][:, None] * np.ones(len(found.time))
    np.testing.assert_allclose(found.force_density, expected, rtol=1e-7)


@pytest.mark.parametrize("goal", ["low", "twisted"])
def test_velocities_are_the_rates_of_the_positions(goal):
    # Second differences fall with the square of the step.
    errors = []
    for step in (0.04, 0.02):
        end = {"low": low, "twisted": twisted}[goal]()
        found = shape_path(model(), start(), end, duration=8.0, step=step)
        middle = slice(1, -1)
        for value, rate in (
            (found.nodes, found.velocities), (found.rest_length, found.rest_length_rate)
        ):  # fmt: skip
            difference = (value[..., 2:] - value[..., :-2]) / (2 * found.time[1])
            errors.append(np.abs(difference - rate[..., middle]).max())
    assert max(errors) < 1e-4
    assert errors[0] / errors[2] > 3.0
    assert errors[1] / errors[3] > 3.0


def test_one_winch_runs_at_its_limit_between_the_ramps_and_none_beyond():
    found = path("twisted")
    fastest = np.abs(found.rest_length_rate).max(axis=0)
    assert fastest.max() <= RATE
    assert np.abs(np.diff(found.rest_length)).max() <= RATE * found.time[1] * (1 + 1e-9)
    share = found.time / found.time[-1]
    between = (share > 0.251) & (share < 0.749)
    np.testing.assert_allclose(fastest[between], RATE, rtol=2e-3)
    # Ramps take a quarter each: 4/3 of the time that it would take at full speed.
    assert found.shortest_duration == pytest.approx(found.time[-1])
    gentle = shape_path(model(), start(), twisted(), winches=tc.Winches(rate=RATE), ramp=0.5)
    assert gentle.time[-1] / found.time[-1] == pytest.approx(0.75 / 0.5, rel=1e-3)


def test_a_rate_for_each_winch():
    rate = np.full(9, 1.0)
    rate[0] = 0.02
    found = shape_path(model(), start(), low(), winches=tc.Winches(rate=rate))
    assert (np.abs(found.rest_length_rate) <= rate[:, None]).all()
    assert np.abs(found.rest_length_rate[0]).max() == pytest.approx(0.02, rel=1e-2)


def test_twice_the_duration_is_half_the_speed():
    winches = tc.Winches(rate=RATE)
    slow = shape_path(model(), start(), low(), winches=winches, duration=4.0)
    slower = shape_path(model(), start(), low(), winches=winches, duration=8.0)
    assert slow.shortest_duration == pytest.approx(path().shortest_duration, rel=1e-3)
    peaks = [np.abs(each.rest_length_rate).max() for each in (slow, slower)]
    assert peaks[0] / peaks[1] == pytest.approx(2.0, rel=1e-3)


def test_a_path_under_gravity_on_supports():
    prism = tc.prism()
    structure = tc.Structure(
        prism.nodes, prism.bars, prism.strings, 1.0, fixed=BOTTOM,
        string_groups=prism.string_groups,
    )  # fmt: skip
    standing = tc.Model(structure, strings=tc.LinearStrings(500.0), gravity=9.81)
    begin = shape_target(standing, force_density=60.0)
    end = shape_target(standing, PointAt(TOP, [0.08, 0.04], directions="xy"), force_density=60.0)
    found = shape_path(standing, begin, end, winches=tc.Winches(rate=0.2))
    np.testing.assert_array_equal(
        found.nodes[:, BOTTOM], prism.nodes[:, BOTTOM, None] * np.ones(len(found.time))
    )
    for k in range(0, len(found.time), 5):
        gamma = found.force_density[:, k]
        Ndd = standing.acceleration(found.nodes[:, TOP, k], np.zeros((3, 3)), gamma)
        assert np.abs(np.array(Ndd)).max() < 1e-11


def test_a_string_that_hangs_straight_has_the_path_of_the_plane():
    """A turn about itself moves none of its nodes, and the equations do not tell of it."""
    paths = []
    for d in (2, 3):
        load = np.zeros((d, 3))
        load[-1] = -9.81
        ends = []
        for length in (0.5, 0.6):
            hung = tc.Structure(
                -length * np.eye(d)[:, -1:] * np.arange(3.0), [], [[0, 1], [1, 2]], bar_mass=1.0,
                string_node_mass=1.0, fixed=[0],
            )  # fmt: skip
            tension = 9.81 * np.array([2.0, 1.0])
            ends.append(tc.prestress(hung, tension / length, external_force=load))
        model = tc.Model(hung, external_force=load)
        paths.append(shape_path(model, *ends, duration=1.0, step=0.2))
    plane, space = paths
    np.testing.assert_allclose(space.nodes[-1], plane.nodes[-1], atol=1e-12)
    np.testing.assert_allclose(space.velocities[-1], plane.velocities[-1], atol=1e-12)
    assert not space.nodes[:2].any()


def test_without_a_string_law_the_path_is_one_of_force_densities():
    bare = tc.Model(tc.prism())
    found = shape_path(bare, start(), low(), duration=2.0)
    assert found.rest_length is None
    assert found.rest_length_rate is None
    assert found.shortest_duration is None
    np.testing.assert_allclose(found.nodes[:, :, -1], low().nodes, atol=1e-12)


# ---- the clock ----


def test_the_clock_keeps_the_pace():
    places = np.linspace(0.0, 1.0, 7)
    pace = np.array([1.0, 2.0, 0.5, 3.0, 3.0, 0.8, 1.0])
    clock = TimeScaling(places, pace, ramp=0.2)
    share = np.linspace(0.0, 1.0, 4001)
    at, speed = clock.at(share)
    np.testing.assert_allclose(at[[0, -1]], [0.0, 1.0], atol=1e-12)
    np.testing.assert_array_equal(speed[[0, -1]], 0.0)
    assert (np.diff(at) >= 0).all()
    total = clock.shortest
    rate = np.interp(at, places, pace) * speed / total  # share of full speed
    assert rate.max() <= 1 + 1e-12
    np.testing.assert_allclose(rate[(share > 0.2) & (share < 0.8)], 1.0, rtol=1e-9)
    steady = np.gradient(at, share)[50:-50] - speed[50:-50]
    assert np.abs(steady).max() < 1e-2 * speed.max()


# ---- a plant that follows ----


class FeedForward(Controller):
    """Winds rest lengths by a path, without looking."""

    def __init__(self, plant, path):
        super().__init__(plant, path.time[1], np.zeros(9), np.full(9, np.inf))
        self._path = path

    def reset(self):
        pass

    def _decide(self, time, state):
        times, lengths = self._path.time, self._path.rest_length
        return tc.control.Command(np.array([np.interp(time, times, each) for each in lengths]))

    def _fall_back(self, status):
        return tc.control.Command(self._path.rest_length[:, 0], status)


def off_path(plant, found, run):
    """Largest distance of a node from the path, motion as one body left out, m."""
    worst = 0.0
    for k in range(0, len(run.time), 10):
        at = found.reference([run.time[k]]).nodes[:, :, 0]
        still = np.zeros((3, 6))
        q = plant.measure(run.nodes[:, :, k], still)[:9] - plant.measure(at, still)[:9]
        worst = max(worst, np.abs(plant.basis @ q).max())
    return worst


def test_a_slow_damped_plant_stays_on_the_path():
    end, damped = twisted(), model_of(damping=20.0)
    winches = tc.Winches(rate=RATE)
    off = []
    for duration in (6.0, 24.0):
        found = shape_path(damped, start(), end, winches=winches, duration=duration, step=0.05)
        plant = tc.linearize(damped, start(), input="rest_length")
        run = tc.simulate(
            damped, duration, controller=FeedForward(plant, found), winches=winches,
            rest_length=found.rest_length[:, 0], step=5e-3, output_step=0.05, error="none",
        )  # fmt: skip
        assert not run.control.rate_limited.any()
        assert np.abs(run.control.winch_rate).max() <= RATE
        off.append(off_path(plant, found, run))
    travel = np.linalg.norm(end.nodes - start().structure.nodes, axis=0).max()
    assert off[1] < 0.02 * travel
    assert off[1] < 0.5 * off[0]  # quasi-static: slower is nearer


def test_mpc_takes_the_path_as_its_reference():
    found = shape_path(model(), start(), low(), winches=tc.Winches(rate=0.2), duration=2.0)
    plant = tc.linearize(model(), low().prestress)
    mpc = tc.MPC(
        plant, horizon=20, sample_time=0.02, max_force_density=80.0, reference=found.reference()
    )
    run = tc.simulate(
        model(), 4.0, controller=mpc, winches=tc.Winches(rate=0.5), step=1e-3,
        rest_length=found.rest_length[:, 0], error="none",
    )  # fmt: skip
    height = run.nodes[2, TOP].mean(axis=0) - run.nodes[2, BOTTOM].mean(axis=0)
    assert height[-1] == pytest.approx(0.85, abs=1e-3)
    assert run.force_density.min() > 0


def test_the_reference_is_the_path_and_stands_still_outside():
    found = path()
    whole = found.reference()
    np.testing.assert_array_equal(whole.nodes, found.nodes)
    between = (found.time[:-1] + found.time[1:]) / 2
    times = np.r_[-1.0, between, found.time[-1] + 1.0]
    fine = found.reference(times)
    np.testing.assert_allclose(fine.nodes[:, :, [0, -1]], found.nodes[:, :, [0, -1]], atol=1e-12)
    structure = model().structure
    for k in range(len(times)):
        length = np.linalg.norm(structure.bar_vectors(fine.nodes[:, :, k]), axis=0)
        np.testing.assert_allclose(length, structure.bar_length, rtol=1e-14)
    # Between equilibria there are, to fourth order, equilibria.
    height = fine.nodes[2, TOP].mean(axis=0) - fine.nodes[2, BOTTOM].mean(axis=0)
    radius = [tc.structure.prism_radius(structure.bar_length[0], h) for h in height]
    np.testing.assert_allclose(np.hypot(*fine.nodes[:2])[0], radius, atol=1e-7)


# ---- what cannot be ----


def test_plants_lie_along_the_path_evenly():
    plants = path().plants(4, "rest_length")
    np.testing.assert_allclose(plants[0].nodes, path().nodes[:, :, 0])
    np.testing.assert_allclose(plants[-1].nodes, path().nodes[:, :, -1])
    for plant in plants:
        k = int(np.abs(path().nodes - plant.nodes[:, :, None]).max(axis=(0, 1)).argmin())
        np.testing.assert_array_equal(plant.force_density, path().force_density[:, k])
        np.testing.assert_allclose(plant.rest_length, path().rest_length[:, k], rtol=1e-12)
        assert np.abs(plant.drift).max() < 1e-9
    heights = [plant.nodes[2, 0] for plant in plants]
    np.testing.assert_allclose(np.diff(heights), np.diff(heights).mean(), rtol=0.25)
    (middle,) = path().plants(1, "force_density")
    assert middle.input == "force_density"
    assert middle.nodes[2, 0] == pytest.approx((1.0 + 0.925) / 2, abs=0.01)


def test_a_reference_turned_round_and_continued():
    there = path().reference()
    whole = there.then(there.reversed(), pause=0.5)
    assert whole.time[-1] == pytest.approx(2 * there.time[-1] + 0.5)
    for what in ("nodes", "force_density"):
        values = getattr(whole, what)
        np.testing.assert_array_equal(values, values[..., ::-1])
        np.testing.assert_array_equal(values[..., : len(there.time)], getattr(there, what))
    bare = tc.Reference(there.time, there.nodes)
    assert bare.reversed().then(bare, pause=1.0).force_density is None


def test_force_densities_of_a_reference_say_which_prestress_is_wanted():
    """Twelve strings balance in one shape in many ways."""
    model = tc.Model(tc.prism(diagonals=True), strings=tc.LinearStrings(1e3))
    twist = Twist(np.radians(-45.0), TOP, BOTTOM)
    soft, firm = (
        shape_target(model, twist, force_density=level, min_force_density=1.0)
        for level in (10.0, 20.0)
    )
    plant = tc.linearize(model, soft.prestress, input="rest_length")
    reference = tc.Reference([0.0], firm.nodes[:, :, None], firm.force_density[:, None])
    mpc = tc.MPC(plant, horizon=5, sample_time=0.02, reference=reference)
    np.testing.assert_allclose(
        mpc.command(0.0, firm.nodes, np.zeros((3, 6))).value, firm.rest_length, atol=1e-6
    )
    mpc.follow(firm.nodes)  # the shape alone: the prestress stays near that of the plant
    held = tc.to_force_density(
        model, firm.nodes, mpc.command(0.0, firm.nodes, np.zeros((3, 6))).value
    )
    assert held.mean() < 0.7 * firm.force_density.mean()


def test_bars_do_not_pass_through_one_another():
    # The mirror image. Stable equilibria with taut strings lead to it, through crossing bars.
    mirror = tc.prism(handedness="right").nodes
    right = tc.Structure(mirror, tc.prism().bars, tc.prism().strings, 1.0)
    goal = tc.prestress(right, force_density=LEVEL)
    with pytest.raises(PathError, match=r"bars \d and \d would pass through each other") as caught:
        shape_path(model(), start(), goal, duration=1.0)
    reached = caught.value.reached
    assert reached.residual < 1e-12
    assert bar_distances(right, reached.structure.nodes).least < 0.05


def test_a_way_through_a_shape_that_gives_way_is_refused():
    # Half a turn as one body: the straight line between the two collapses on the axis.
    turn = np.diag([-1.0, -1.0, 1.0])
    prism = tc.prism()
    turned = tc.Structure(turn @ prism.nodes, prism.bars, prism.strings, 1.0)
    goal = tc.prestress(turned, force_density=LEVEL)
    with pytest.raises(PathError, match="unstable shape, 50 % of the way") as caught:
        shape_path(model(), start(), goal, duration=1.0)
    assert caught.value.reached.residual < 1e-12


def test_equilibria_that_do_not_lead_to_the_goal_are_reported_with_the_last_one():
    # A bar hangs from a hinge, a string draws its tip to the upper left. At an angle a to the
    # right it rests at γ = m g/2 sin a / (sin a - cos a): nowhere between 0 and 45 degrees.
    def leaning(degrees):
        a = np.radians(degrees)
        nodes = [[0.0, np.sin(a), -1.0], [0.0, 0.0, 0.0], [0.0, -np.cos(a), 1.0]]
        return tc.Structure(nodes, [[0, 1]], [[1, 2]], 1.0, fixed=[0, 2])

    def at_rest(degrees):
        a = np.radians(degrees)
        gamma = 9.81 / 2 * np.sin(a) / (np.sin(a) - np.cos(a))
        weight = hanging.constant_force
        return tc.prestress(leaning(degrees), [gamma], external_force=weight)

    hanging = tc.Model(leaning(100.0), strings=tc.ElasticStrings(200.0), gravity=9.81)
    near = shape_path(hanging, at_rest(100.0), at_rest(60.0), duration=1.0, require_stable=False)
    angle = np.arctan2(near.nodes[0, 1], -near.nodes[2, 1])
    expected = 9.81 / 2 * np.sin(angle) / (np.sin(angle) - np.cos(angle))
    np.testing.assert_allclose(near.force_density[0], expected, rtol=1e-10)
    with pytest.raises(
        PathError, match="no continuous path of equilibria leads from start to goal"
    ) as caught:
        shape_path(hanging, at_rest(100.0), at_rest(-30.0), duration=1.0, require_stable=False)
    tip = caught.value.reached.structure.nodes[:, 1]
    assert np.degrees(np.arctan2(tip[0], -tip[2])) > 45.0


def test_distances_of_bars_against_a_fine_grid():
    random = np.random.default_rng(1)
    share = np.linspace(0.0, 1.0, 401)
    structure = tc.prism()
    for _ in range(20):
        nodes = random.normal(size=(3, 6))
        found = bar_distances(structure, nodes)
        for (i, j), distance in zip(found.pairs, found.distance, strict=True):
            first, second = (
                nodes[:, [a]] * (1 - share) + nodes[:, [b]] * share
                for a, b in structure.bars[[i, j]]
            )
            grid = np.linalg.norm(first[:, :, None] - second[:, None, :], axis=0).min()
            assert distance <= grid + 1e-12
            assert distance == pytest.approx(grid, abs=1e-2)
