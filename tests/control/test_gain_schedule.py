"""Controllers in turn along a path that leads far from any one operating point."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc

TOP, BOTTOM = [0, 1, 2], [3, 4, 5]
LEVEL, SAMPLE = 17.320508, 0.02
STILL = np.zeros((3, 6))


@cache
def path():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(1e4, damping=2.0))
    start = tc.prestress(tc.prism(), force_density=LEVEL)
    goal = tc.shape_target(model, tc.Height(0.7, TOP, BOTTOM), force_density=LEVEL)
    return tc.shape_path(model, start, goal, duration=2.5, step=SAMPLE)


@cache
def plants_of(count):
    return path().plants(count, "rest_length")


def mpc_of(plant, **options):
    return tc.MPC(plant, horizon=8, sample_time=SAMPLE, reference=path().reference(), **options)


@cache
def schedule(count=4):
    return tc.GainSchedule([mpc_of(plant) for plant in plants_of(count)])


def test_plants_lie_along_the_path_evenly():
    plants = plants_of(4)
    np.testing.assert_allclose(plants[0].nodes, path().nodes[:, :, 0])
    np.testing.assert_allclose(plants[-1].nodes, path().nodes[:, :, -1])
    for plant in plants:
        k = int(np.abs(path().nodes - plant.nodes[:, :, None]).max(axis=(0, 1)).argmin())
        np.testing.assert_array_equal(plant.force_density, path().force_density[:, k])
        np.testing.assert_allclose(plant.rest_length, path().rest_length[:, k], rtol=1e-12)
        assert np.abs(plant.drift).max() < 1e-9
    places = [plant.nodes[2, 0] for plant in plants]
    np.testing.assert_allclose(np.diff(places), np.diff(places).mean(), rtol=0.25)
    (middle,) = path().plants(1, "force_density")
    assert middle.input == "force_density"
    assert middle.nodes[2, 0] == pytest.approx((1.0 + 0.85) / 2, abs=0.01)


def test_the_nearest_acts_and_gives_its_own_command():
    found = schedule()
    found.reset()
    last = None
    for i, each in enumerate(found.controllers):
        nodes = each.plant.to_nodes(1e-4 * np.ones(9))
        # As one body it may stand anywhere.
        moved = np.diag([-1.0, -1.0, 1.0]) @ nodes + np.array([[1.0], [2.0], [0.5]])
        alone = mpc_of(each.plant)
        if last is not None:
            alone.take_over(last)
        command = found.command(0.1 * i, moved, STILL)
        assert found.active == i
        assert command.status == "ok"
        np.testing.assert_allclose(command.value, alone.command(0.1 * i, nodes, STILL).value,
                                   atol=1e-7)  # fmt: skip
        last = command.value
    found.reset()
    assert found.active == 0


def test_limits_of_change_hold_across_a_switch():
    winches = tc.Winches(rate=0.05)
    plants = plants_of(2)
    found = tc.GainSchedule([mpc_of(plant, winches=winches) for plant in plants])
    last = found.command(0.0, plants[0].nodes, STILL).value
    for k in range(1, 6):
        command = found.command(k * SAMPLE, plants[k % 2].nodes, STILL).value
        assert found.active == k % 2
        assert np.abs(command - last).max() <= 0.05 * SAMPLE * (1 + 1e-9)
        last = command


def test_a_bad_measurement_is_left_to_the_one_that_acted_last():
    found = schedule()
    found.reset()
    found.command(1.0, found.controllers[2].plant.nodes, STILL)
    planned = found.controllers[2].plan[:, 1]
    broken = found.command(1.0 + SAMPLE, np.full((3, 6), np.nan), STILL)
    assert str(broken) == "measurement not finite: plan continued"
    np.testing.assert_array_equal(broken.value, planned)
    assert found.active == 2


def test_a_schedule_goes_there_and_back():
    """Strings of 10 kN/m, winding through the samples."""
    there = path().reference()
    reference = there.then(there.reversed(), pause=0.3)
    winches = tc.Winches(rate=0.5, substeps=10)
    plants = plants_of(6)
    controllers = [
        tc.MPC(plant, horizon=8, sample_time=SAMPLE, reference=reference, winches=winches)
        for plant in plants
    ]
    run = tc.simulate(
        path().model, reference.time[-1] + 0.7, controller=tc.GainSchedule(controllers),
        winches=winches, rest_length=path().rest_length[:, 0], step=1e-3,
    )  # fmt: skip
    height = run.nodes[2, TOP].mean(axis=0) - run.nodes[2, BOTTOM].mean(axis=0)
    assert abs(height[-1] - 1.0) < 1e-4
    assert height.min() == pytest.approx(0.7, abs=1e-3)
    assert run.force_density.min() > 10.0
    assert set(run.control.status_count) == {"ok"}


@cache
def with_load(number):
    winches = tc.Winches(substeps=10)
    return mpc_of(plants_of(6)[number], winches=winches, load_gain=1.0)


@pytest.mark.parametrize(("push", "gained"), [(1e-4, 2.5), (1e-3, 20.0)])
def test_the_nearest_plant_predicts_where_a_far_one_does_not(push, gained):
    """By what the shape does otherwise than predicted, as accelerations, near the start."""
    winches = tc.Winches(substeps=10)
    start = plants_of(6)[0].to_nodes(push * np.random.default_rng(0).normal(size=9))
    left = {}
    for name, chosen in (("far", [5]), ("middle", [2]), ("nearest", range(6))):
        found = tc.GainSchedule([with_load(number) for number in chosen])
        tc.simulate(
            path().model, 5 * SAMPLE, start, controller=found, winches=winches, step=1e-4,
            rest_length=path().rest_length[:, 0],
        )  # fmt: skip
        left[name] = np.linalg.norm(found.controllers[found.active].load)
    assert left["middle"] > gained * left["nearest"]
    assert left["far"] > 3 * left["middle"]


def test_bars_may_be_turned_beyond_the_coordinates():
    """And seem 5 % too long: a command comes, that of the regulator itself."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205), input="rest_length")
    regulator, rng = (
        tc.LQR(plant, *tc.energy_weights(plant), sample_time=SAMPLE),
        np.random.default_rng(0),
    )
    schedule = tc.GainSchedule([tc.LQR(plant, *tc.energy_weights(plant), sample_time=SAMPLE)])
    start, end = prism.bars.T
    middle = (prism.nodes[:, start] + prism.nodes[:, end]) / 2
    beyond = 0
    for _ in range(100):
        axes = rng.normal(size=(3, len(prism.bars)))
        half = 1.05 * prism.bar_length / 2 * axes / np.linalg.norm(axes, axis=0)
        nodes = np.hstack([middle - half, middle + half])[:, np.argsort(np.r_[start, end])]
        found, own = (each.command(0.0, nodes, 0 * nodes) for each in (schedule, regulator))
        assert (found.status, own.status) == ("ok", "ok")
        np.testing.assert_array_equal(found.value, own.value)
        turned = (prism.bar_vectors(nodes) * prism.bar_vectors(prism.nodes)).sum(axis=0)
        beyond += bool((turned < 0).any())
    assert beyond > 50


def test_a_regulator_can_be_scheduled():
    plants = plants_of(2)
    laws = []
    for plant in plants:
        Q, R = tc.energy_weights(plant, by_mode=True)
        laws.append(tc.LQR(plant, Q, R, sample_time=SAMPLE))
    found = tc.GainSchedule(laws)
    nodes = plants[1].to_nodes(1e-4 * np.ones(9))
    expected = laws[1].command(0.0, nodes, STILL).value
    np.testing.assert_allclose(found.command(0.0, nodes, STILL).value, expected, atol=1e-12)


def test_the_change_counts_from_what_winches_hold_across_a_switch():
    """A stuck winch stands elsewhere than was commanded; the next controller is told."""
    winches = tc.Winches(rate=0.05)
    plants = plants_of(2)
    found = tc.GainSchedule([mpc_of(plant, winches=winches, load_gain=0.5) for plant in plants])
    stands = plants[0].rest_length
    found.applied(stands)
    for k in range(6):
        broken = k in (2, 3)
        nodes = plants[k // 2 % 2].nodes * (np.nan if broken else 1.0)
        command = found.command(k * SAMPLE, nodes, STILL)
        assert (command.status == "ok") != broken
        assert np.abs(command.value - stands).max() <= 0.05 * SAMPLE * (1 + 1e-9)
        stands = np.r_[stands[:3], command.value[3:]]
        found.applied(stands)
        active = found.controllers[found.active]
        np.testing.assert_array_equal(active._previous_within_bounds, stands)
    assert found.active == 0
    assert [each.statistics.fallbacks for each in found.controllers] == [2, 0]
    found.command(6 * SAMPLE, plants[1].nodes, STILL)
    assert found.controllers[1].load is not None
    assert not found.controllers[1].load.any()  # from the winches that stand, it has seen nothing
    found.reset()
    assert sum(sum(e.statistics.status_count.values()) for e in found.controllers) == 0


def test_each_command_is_counted_once_by_the_schedule_and_once_by_its_controller():
    plants = plants_of(2)
    found = tc.GainSchedule([mpc_of(plant) for plant in plants])
    absurd = plants[1].nodes + 20 * np.eye(3, 6)  # bars far too long
    for nodes in (plants[0].nodes, plants[1].nodes, np.nan * STILL, absurd, plants[1].nodes):
        found.command(0.0, nodes, STILL)
    assert found.status_count == {
        "ok": 3, "measurement not finite": 1, "measurement not plausible": 1,
    }  # fmt: skip
    assert found.fallback_count == {"plan continued": 2}
    first, second = found.controllers
    assert first.status_count == {"ok": 1}
    assert first.fallback_count == {}
    assert second.status_count == found.status_count | {"ok": 2}
    assert second.fallback_count == found.fallback_count
    assert second.statistics.status_count == second.status_count
    assert (first.statistics.fallbacks, second.statistics.fallbacks) == (0, 2)
    found.reset()
    assert [each.status_count for each in (found, first, second)] == [{}, {}, {}]


def test_each_controller_keeps_its_own_bounds():
    plants = plants_of(2)
    lows = [0.95 * plant.rest_length for plant in plants]
    found = tc.GainSchedule(
        [
            mpc_of(plant, winches=tc.Winches(0.05, shortest=low))
            for plant, low in zip(plants, lows, strict=True)
        ]
    )
    np.testing.assert_array_equal(found.bounds[0], np.minimum(*lows))
    stands = 0.9 * np.minimum(*lows)  # where neither would go
    for i in (0, 1):
        found.applied(stands)
        value = found.command(0.0, plants[i].nodes, STILL).value
        assert found.active == i
        assert (value >= lows[i]).all()
        # Bounds come first, and then the change.
        assert (value <= lows[i] + 0.05 * SAMPLE * (1 + 1e-9)).all()


def test_a_schedule_in_a_run_with_faults():
    plants = plants_of(3)
    winches = tc.Winches(rate=0.5, substeps=5)
    found = tc.GainSchedule([mpc_of(plant, winches=winches, load_gain=0.2) for plant in plants])
    stuck, lost = tc.StuckWinch(2, time=0.4, until=0.7), tc.LostMeasurement(time=1.0, until=1.06)
    run = tc.simulate(
        path().model, 2.8, controller=found, winches=winches, step=1e-3, faults=[stuck, lost],
        rest_length=path().rest_length[:, 0],
    )  # fmt: skip
    control = run.control
    during = (control.time >= 0.4 - 1e-9) & (control.time < 0.7 - 1e-9)
    assert np.ptp(control.applied[2, during]) == 0
    assert np.abs(control.command[2, during] - control.applied[2, during]).max() > 1e-4
    assert control.status_count == {
        "ok": len(control.time) - 3,
        "measurement not finite": 3,
    }
    assert control.fallback_count == {"plan continued": 3}
    assert found.active == 2
    before = np.column_stack([path().rest_length[:, 0], control.applied[:, :-1]])
    assert np.abs(control.command - before).max() <= 0.5 * SAMPLE * (1 + 1e-9)
    shape = plants[-1].measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
    assert np.abs(shape[:9]).max() < 1e-3


# ---- references ----


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
    twist = tc.Twist(np.radians(-45.0), TOP, BOTTOM)
    soft, firm = (
        tc.shape_target(model, twist, force_density=level, min_force_density=1.0)
        for level in (10.0, 20.0)
    )
    plant = tc.linearize(model, soft.prestress, input="rest_length")
    reference = tc.Reference([0.0], firm.nodes[:, :, None], firm.force_density[:, None])
    mpc = tc.MPC(plant, horizon=5, sample_time=SAMPLE, reference=reference)
    np.testing.assert_allclose(
        mpc.command(0.0, firm.nodes, STILL).value, firm.rest_length, atol=1e-6
    )
    mpc.follow(firm.nodes)  # the shape alone: the prestress stays near that of the plant
    held = tc.to_force_density(model, firm.nodes, mpc.command(0.0, firm.nodes, STILL).value)
    assert held.mean() < 0.7 * firm.force_density.mean()
