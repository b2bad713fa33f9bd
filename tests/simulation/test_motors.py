"""Motors of a run: torque times speed is work, limits hold, play is a loop, runs go on."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.actuation.winch_motion import Drive
from tenscontrol.control import Command, Controller
from tests.known_structures import arm, d_bar
from tests.random_structures import any_structure

SAMPLE, INERTIA, GEAR = 0.02, 1e-6, {"drum_radius": 0.01, "gear_ratio": 20.0}

LINEAR, ELASTIC = tc.LinearStrings(1e3), tc.ElasticStrings(1e3)


def loaded_arm():
    """An arm of three frames, half a kilogram at its tip."""
    bare = tc.library.arm(sections=3, length=0.5, height=0.4, bar_mass=0.3)
    return replace(bare, point_mass=0.5 * (np.arange(8) == 6))


def ball():
    """The six-bar ball on three fixed nodes."""
    free = tc.library.six_bar_ball()
    return tc.Structure(free.nodes, free.bars, free.strings, 1.0, fixed=[0, 4, 8])


def clustered():
    """A rhombus of bars, one string of which runs over a joint."""
    nodes = [[-1, 0, 1, 0], [0, -0.8, 0, 0.8]]
    bars = [(0, 1), (1, 2), (2, 3), (3, 0)]
    return tc.Structure(nodes, bars, [(0, 2), (3, 1), (0, 1, 2)], 1.0, fixed=[0])


SCENES = {
    "arm with a payload": (loaded_arm, LINEAR, 9.81),
    "ball on three nodes": (ball, ELASTIC, None),
    "planar D-bar": (d_bar, LINEAR, None),
    "clustered string": (clustered, ELASTIC, None),
    "subdivided": (lambda: tc.subdivide(tc.prism(), segments=2, node_mass=0.02), LINEAR, None),
}


@cache
def scene(name, law=None):
    """A model, rest lengths that hold it about, and its plant for controllers of those."""
    make, own, gravity = SCENES[name]
    structure = make()
    options = {} if gravity is None else {"gravity": gravity}
    model = tc.Model(structure, strings=own if law is None else law, **options)
    parent = structure if structure.parent is None else structure.parent
    if gravity is None:
        return model, 0.97 * parent.string_length()
    rest = tc.prestress(structure, min_force_density=40.0, external_force=model.constant_force)
    return model, tc.to_rest_length(model, structure.nodes, rest.force_density).rest_length


class Wave(Controller):
    """Winds strings in and out, each at a time of its own, whatever it is told."""

    def __init__(self, model, start, size=5e-3, input="rest_length"):
        structure = model.structure
        shape = structure if structure.parent is None else structure.parent
        base = tc.Model(shape, strings=LINEAR)
        rest = tc.OperatingPoint(shape.nodes, 20.0 * np.ones(len(shape.strings)))
        plant = tc.linearize(base, rest, input=input, require_equilibrium=False)
        super().__init__(plant, SAMPLE, np.zeros(len(start)), np.full(len(start), np.inf))
        self.start, self.size = start, size

    def _decide(self, time, state):
        phase = np.arange(len(self.start))
        shift = np.sin(9 * (time + SAMPLE) + phase) - np.sin(phase)
        return Command(self.start * (1 + self.size * shift))


def winches_of(rate=None, ramp=True, **motor):
    """Winches with motors, which ramp unless it is said otherwise."""
    return tc.Winches(rate=rate, ramp=ramp, motor=tc.Motor(**GEAR, **motor))


def run_of(name, duration=0.4, size=5e-3, step=5e-4, law=None, **kind):
    model, start = scene(name, law)
    return tc.simulate(
        model, duration, controller=Wave(model, start, size), winches=winches_of(**kind),
        rest_length=start, step=step, error="none",
    )  # fmt: skip


def unbalanced(run, inertia=0.0):
    """What motors gave and the structure did not get, as part of the most they gave."""
    motors = run.control.motors
    rotors = inertia / 2 * (motors.speed**2).sum(axis=0)
    stored, given = run.energy + rotors, motors.energy.sum(axis=0)
    off = (stored - stored[0]) - (given - given[0])
    return np.abs(off).max() / np.abs(given).max()


KINDS = {
    "jumps": {"ramp": False},
    "ramps": {},
    "speed limit": {"ramp": False, "speed": 200.0},
    "lag": {"ramp": False, "lag": 0.05},
    "ramps with a lag": {"lag": 0.05},
    "inertia": {"ramp": False, "rate": 0.1, "torque": 5.0, "inertia": INERTIA},
    "play": {"backlash": 0.3},
}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        (name, kind)
        for name in SCENES
        for kind in (KINDS if name == "ball on three nodes" else ("ramps", "inertia"))
    ],
)
def test_what_motors_give_is_what_the_structure_gets(name, kind):
    run = run_of(name, 0.1, step=2.5e-4, **KINDS[kind])
    assert unbalanced(run, KINDS[kind].get("inertia", 0.0)) < 1e-6


def test_strings_that_go_slack_on_the_way():
    """An arm that falls from a shape that is none of rest."""
    model = tc.Model(arm(), strings=LINEAR, gravity=9.81)
    start = 0.97 * model.structure.string_length()
    winches = tc.Winches(ramp=True, motor=tc.Motor(**GEAR))
    run = tc.simulate(
        model, 0.4, controller=Wave(model, start), winches=winches, rest_length=start,
        step=2.5e-4, error="none",
    )  # fmt: skip
    assert run.work.switches > 5
    assert unbalanced(run) < 1e-6


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_structures_that_nobody_chose(seed):
    """Bars that share nodes, supports, clusters; strings go slack and taut."""
    structure = any_structure(seed)
    model = tc.Model(structure, strings=ELASTIC if seed % 2 else LINEAR)
    start = 0.97 * structure.string_length()
    winches = tc.Winches(rate=0.1, ramp=True, motor=tc.Motor(**GEAR))
    run = tc.simulate(
        model, 0.1, controller=Wave(model, start), winches=winches, rest_length=start,
        method="dop853", tolerance=1e-11, error="none",
    )  # fmt: skip
    assert run.work.switches > 0
    assert unbalanced(run) < 1e-6


def test_the_energy_of_a_motor_is_that_of_an_oracle():
    """An integrator of SciPy, with the work of each string as a state of its own."""
    from scipy.integrate import solve_ivp

    model, start = scene("planar D-bar")
    run = run_of("planar D-bar", step=2.5e-4)
    structure, applied = model.structure, run.control.applied
    count = len(structure.free_rows)
    state = np.r_[run.nodes[:, :, 0].ravel(order="F")[structure.free_rows], np.zeros(count)]
    state = np.r_[state, np.zeros(len(start))]
    before = start
    for k in range(applied.shape[1]):
        rate = (applied[:, k] - before) / SAMPLE

        def slope(time, y, before=before, rate=rate):
            x, lengths = y[: 2 * count], before + rate * time
            nodes = structure.nodes.copy().ravel(order="F")
            nodes[structure.free_rows] = x[:count]
            long = structure.string_length(nodes.reshape(structure.nodes.shape, order="F"))
            motion = np.array(model.rest_length_dynamics(x, lengths)).ravel()
            return np.r_[motion, -1e3 * np.maximum(long - lengths, 0) * rate]

        state = solve_ivp(slope, (0, SAMPLE), state, rtol=1e-11, atol=1e-12).y[:, -1]
        before = applied[:, k]
    given = run.control.motors.energy[:, -1]
    assert np.abs(given - state[2 * count :]).max() < 1e-7 * np.abs(given).max()


def test_torque_and_speed_are_those_of_the_drum():
    run = run_of("planar D-bar", step=1e-3)
    motors, lever = run.control.motors, 0.01 / 20
    length = np.array([run.structure.string_length(N) for N in np.moveaxis(run.nodes, 2, 0)]).T
    np.testing.assert_allclose(motors.torque, run.force_density * length * lever, atol=1e-12)
    turned = (run.rest_length[:, :1] - run.rest_length) / lever
    np.testing.assert_allclose(motors.angle - motors.angle[:, :1], turned, atol=1e-9)
    wound = np.repeat(-run.control.winch_rate / lever, 20, axis=1)
    np.testing.assert_allclose(motors.speed[:, 1:], wound, atol=1e-9)
    np.testing.assert_array_equal(motors.power, motors.torque * motors.speed)
    asked = (run.rest_length[:, :1] - run.control.command) / lever
    np.testing.assert_allclose(motors.angle_command, asked, atol=1e-9)
    assert "motors" in run.summary()


def test_few_states_kept_say_so():
    kept = [run_of("ball on three nodes", step=1e-3).control.motors]
    model, start = scene("ball on three nodes")
    winches = tc.Winches(ramp=True, motor=tc.Motor(**GEAR))
    run = tc.simulate(
        model, 0.4, controller=Wave(model, start), winches=winches, rest_length=start, step=1e-3,
        output_step=SAMPLE, error="none",
    )  # fmt: skip
    kept.append(run.control.motors)
    off = np.abs(kept[0].energy[:, -1] - kept[1].energy[:, -1]).sum()
    assert kept[0].energy_error < 1e-8
    assert off < kept[1].energy_error
    assert off < 1e-5 * np.abs(kept[0].energy).max()


def test_limits_of_speed_torque_and_range_hold():
    model, start = scene("planar D-bar")
    motor = tc.Motor(**GEAR, speed=150.0, torque=0.05, inertia=2e-6, lag=0.01)
    winches = tc.Winches(shortest=0.99 * start, longest=1.005 * start, motor=motor)
    run = tc.simulate(
        model, 1.0, controller=Wave(model, start, 0.02), winches=winches, rest_length=start,
        step=5e-4, error="none",
    )  # fmt: skip
    motors = run.control.motors
    assert np.abs(motors.speed).max() == pytest.approx(150.0)
    assert np.abs(motors.torque).max() <= 0.05
    assert (run.rest_length >= winches.shortest[:, None] * (1 - 1e-9)).all()
    assert (run.rest_length <= winches.longest[:, None] * (1 + 1e-9)).all()
    assert np.ptp(run.rest_length, axis=1).max() > 0.014 * start.min()
    assert run.control.rate_limited.any()
    assert run.control.range_limited.any()
    assert motors.torque_limited.any()
    # The speed of a motor with inertia does not jump.
    assert np.abs(np.diff(motors.speed, axis=1)).max() < (0.05 + 0.05) / 2e-6 * 5e-4


@pytest.mark.parametrize("law", [LINEAR, ELASTIC])
@pytest.mark.parametrize("ramp", [False, True])
def test_a_weak_motor_holds_where_it_can_wind_no_further(law, ramp):
    model, start = scene("planar D-bar", law)
    long, lever = model.structure.string_length(), 0.01 / 20
    most = 1.2 * law.force_density(long, start) * long * lever
    run = run_of("planar D-bar", 0.6, 0.02, law=law, ramp=ramp, torque=most)
    motors = run.control.motors
    assert motors.torque_limited.any()
    assert "limit of torque" in run.summary()
    assert (np.abs(motors.torque) <= most[:, None]).all()
    strong = run_of("planar D-bar", 0.6, 0.02, law=law, ramp=ramp)
    assert (np.abs(strong.control.motors.torque).max(axis=1) > 1.2 * most).any()
    # It winds in only while the tension is below the limit.
    force = (
        run.force_density
        * np.array([run.structure.string_length(N) for N in np.moveaxis(run.nodes, 2, 0)]).T
    )
    winds = (motors.speed[:, 1:] > 1e-9) & ramp
    assert (force[:, 1:] * winds <= 1.02 * most[:, None] / lever).all()


def weak_run(substeps, duration=0.2, step=SAMPLE / 32, **kind):
    """A ball whose motors hold no more than 1.2 times the tension at the start."""
    model, start = scene("ball on three nodes")
    long, lever = model.structure.string_length(), 0.01 / 20
    most = 1.2 * ELASTIC.force_density(long, start) * long * lever
    winches = tc.Winches(ramp=True, substeps=substeps, motor=tc.Motor(**GEAR, torque=most, **kind))
    return tc.simulate(
        model, duration, controller=Wave(model, start, 0.02), winches=winches, rest_length=start,
        step=step, output_step=SAMPLE, error="none",
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore:rest length error")
@pytest.mark.parametrize("kind", [{}, {"inertia": 1e-5}, {"backlash": 0.3}])
def test_a_run_estimates_the_error_of_few_substeps(kind):
    runs = {substeps: weak_run(substeps, **kind) for substeps in (2, 8, 32)}
    for substeps in (2, 8):
        off = np.abs(runs[substeps].control.applied - runs[32].control.applied).max()
        found = runs[substeps].control.motors.rest_length_error
        assert 0.5 < found / off < 8
        assert runs[substeps].health.rest_length_error == pytest.approx(found / 1.7)
        assert f"rest lengths to {found:.2g} m" in runs[substeps].control.summary()
    assert off < 1e-3


def test_a_weak_motor_is_followed_to_second_order():
    """Ten parts of a sample leave a tenth of a millimetre where they once left four."""
    few, many = weak_run(10), weak_run(40, step=SAMPLE / 40)
    assert few.control.motors.torque_limited.sum() > 20
    assert np.abs(few.control.applied - many.control.applied).max() < 2.5e-4


def test_a_run_that_stops_within_a_sample_has_its_record():
    """Strings break loose from a step far too long: motors are followed up to there."""
    model, start = scene("planar D-bar", tc.LinearStrings(1e6))
    motor = tc.Motor(**GEAR, torque=5.0, lag=0.01)
    with pytest.raises(tc.simulation.SimulationError) as info:
        tc.simulate(
            model, 1.0, controller=Wave(model, start), winches=tc.Winches(ramp=True, motor=motor),
            rest_length=start, method="rk4", step=SAMPLE / 10, error="none",
        )  # fmt: skip
    motors = info.value.trajectory.control.motors
    assert motors.rest_length_error >= 0
    assert len(motors.time) == len(info.value.trajectory.time)


def test_few_substeps_give_a_warning():
    with pytest.warns(tc.simulation.AccuracyWarning, match="rest length error .* substeps"):
        weak_run(2, 0.6, SAMPLE / 16, inertia=1e-6)


def test_what_is_exact_has_no_error():
    for kind in ("jumps", "ramps", "speed limit"):
        assert run_of("planar D-bar", 0.1, **KINDS[kind]).control.motors.rest_length_error == 0
    whole = weak_run(4, 0.2)
    assert whole.control.motors.rest_length_error > 0


def test_a_motor_knows_the_force_at_both_ends_of_a_part(monkeypatch):
    forces = []

    def tick(self, number, now, pull, real=Drive.tick):
        forces.append((pull(self.rest_length, 0.0)[0], pull(self.rest_length, 1e-3)[0]))
        return real(self, number, now, pull)

    monkeypatch.setattr(Drive, "tick", tick)
    run_of("planar D-bar", 0.1, torque=1.0)
    assert all((now != later).all() for now, later in forces[15:25])


def test_a_lag_is_that_of_its_time_constant():
    class Step(Wave):
        def _decide(self, time, state):
            return Command(0.99 * self.start)

    model, start = scene("planar D-bar")
    for rate in (None, 0.2):
        winches = tc.Winches(rate=rate, motor=tc.Motor(**GEAR, lag=0.03))
        run = tc.simulate(
            model, 0.2, controller=Step(model, start), winches=winches, rest_length=start,
            step=1e-3, error="none",
        )  # fmt: skip
        gap = (run.rest_length - 0.99 * start[:, None]) / start[:, None]
        time = run.time[::2]  # ends of ticks
        if rate is None:
            np.testing.assert_allclose(gap[:, ::2], 0.01 * np.exp(-time / 0.03)[None].repeat(2, 0))
        else:
            late = np.maximum((0.01 * start - 0.2 * 0.03) / 0.2, 0)[:, None]
            far = np.where(late > 0, 0.006, 0.01 * start[:, None])
            expected = np.where(
                time < late, 0.01 * start[:, None] - 0.2 * time, far * np.exp(-(time - late) / 0.03)
            )
            np.testing.assert_allclose(gap[:, ::2] * start[:, None], expected, atol=1e-12)
            assert run.control.rate_limited[0] == (late > 0).sum()


def test_a_ramp_goes_from_command_to_command_whatever_the_lag():
    """After a step of commands a drive is late by a ramp of one sample, then decays as it says."""

    class Step(Wave):
        def _decide(self, time, state):
            return Command(0.99 * self.start)

    model, start = scene("planar D-bar")
    winches, lag, sample = winches_of(lag=0.012), 0.012, SAMPLE
    given = {"controller": Step(model, start), "winches": winches, "step": 2e-3}
    run = tc.simulate(model, 0.1, rest_length=start, **given)
    gap = (run.control.applied / start[:, None] - 0.99) / 0.01
    decay = np.exp(-sample / lag)
    expected = lag / sample * (1 - decay) * decay ** np.arange(5)
    np.testing.assert_allclose(gap, np.tile(expected, (2, 1)), rtol=1e-9)
    first = tc.simulate(model, 0.02, rest_length=start, **given)
    second = tc.simulate(model, 0.08, start=first, **given)
    np.testing.assert_array_equal(second.control.applied, run.control.applied[:, 1:])


@pytest.mark.parametrize("ramp", [False, True])
@pytest.mark.parametrize("rate", [None, 0.2, 2.0])
def test_a_lag_under_a_speed_limit_is_that_of_an_oracle(ramp, rate):
    from scipy.integrate import solve_ivp

    lag, most = np.array([0.005, 0.03, 0.1]), np.inf if rate is None else rate
    winches = tc.Winches(rate=rate, ramp=ramp, motor=tc.Motor(0.01, lag=lag))
    drive, commands = Drive(winches, np.ones(3), SAMPLE), np.random.default_rng(3)
    reference = np.ones(3)
    for k in range(6):
        command, begin = commands.uniform(0.98, 1.02, 3), drive.position
        drive.begin(command, np.zeros(0, dtype=int))
        for number in range(1, winches.ticks + 1):
            drive.tick(number, k * SAMPLE, lambda *_: None)
        way = (command - reference) / SAMPLE * ramp
        origin = reference if ramp else command

        def follow(time, y, origin=origin, way=way):
            return np.clip((origin + way * time - y) / lag, -most, most)

        limits = {"rtol": 1e-9, "atol": 1e-12, "max_step": 2e-4}
        found = solve_ivp(follow, (0, SAMPLE), begin, **limits).y[:, -1]
        np.testing.assert_allclose(drive.position, found, atol=1e-8)
        reference = command


def test_the_loop_of_a_reversal_is_as_wide_as_the_play():
    play = 0.3
    run = run_of("planar D-bar", 1.5, backlash=play)
    motors, radius = run.control.motors, 0.01
    behind = run.rest_length - (motors.zero[:, None] - motors.angle * radius / 20)
    np.testing.assert_allclose(behind.max(axis=1), play * radius / 2, rtol=1e-9)
    np.testing.assert_allclose(behind.min(axis=1), -play * radius / 2, rtol=1e-9)
    # In the play the motor turns against nothing, and the string stands.
    alone = np.abs(np.diff(run.rest_length, axis=1)) < 1e-12
    turning = np.abs(motors.speed[:, 1:]) > 1
    assert (alone & turning).any()
    assert np.abs(motors.torque[:, 1:][alone & turning]).max() < 1e-9


@pytest.mark.parametrize("kind", ["jumps", "ramps with a lag", "inertia", "play"])
def test_a_run_in_two_parts_is_the_one(kind):
    model, start = scene("planar D-bar")
    winches = winches_of(**KINDS[kind])
    given = {"controller": Wave(model, start), "winches": winches, "step": 1e-3}
    whole = tc.simulate(model, 0.2, rest_length=start, **given)
    first = tc.simulate(model, 0.1, rest_length=start, **given)
    second = tc.simulate(model, 0.1, start=first, **given)
    np.testing.assert_array_equal(second.nodes[:, :, -1], whole.nodes[:, :, -1])
    motors = whole.control.motors
    np.testing.assert_allclose(second.control.motors.angle[:, -1], motors.angle[:, -1], rtol=1e-12)
    both = first.control.motors.energy[:, -1] + second.control.motors.energy[:, -1]
    np.testing.assert_allclose(both, motors.energy[:, -1], rtol=1e-9)


@pytest.mark.parametrize("kind", ["ramps", "inertia", "lag"])
def test_a_stuck_winch_stands(kind):
    model, start = scene("planar D-bar")
    winches = winches_of(**KINDS[kind])
    run = tc.simulate(
        model, 0.4, controller=Wave(model, start), winches=winches, rest_length=start, step=1e-3,
        faults=[tc.StuckWinch(1, time=0.1, until=0.3), tc.CutString(0, time=0.25)], error="none",
    )  # fmt: skip
    stands = (run.time > 0.1 + 1e-9) & (run.time < 0.3 - 1e-9)
    assert np.ptp(run.rest_length[1, stands]) == 0
    assert np.ptp(run.rest_length[1]) > 1e-3
    after = run.time > 0.25 + 1e-9
    if kind != "inertia":  # whose rotor turns on
        assert np.abs(run.control.motors.power[0, after]).max() == 0
    assert np.abs(run.control.motors.energy[:, -1]).max() < 1.0


class Pull(Controller):
    """Pulls with force densities that change from sample to sample."""

    def __init__(self, plant):
        count = plant.B.shape[1]
        super().__init__(plant, SAMPLE, np.zeros(count), np.full(count, np.inf))

    def _decide(self, time, state):
        phase = np.arange(self.plant.B.shape[1])
        return Command(30.0 + 20.0 * np.sin(7 * time + phase))


@pytest.mark.parametrize("name", ["arm with a payload", "ball on three nodes", "clustered string"])
def test_a_cable_of_held_force_works_on_the_structure(name):
    model, start = scene(name)
    plant = Wave(model, start, input="force_density").plant
    winches = tc.Winches(motor=tc.Motor(**GEAR))
    run = tc.simulate(
        model, 0.3, controller=Pull(plant), winches=winches, input="force_density", step=2.5e-4,
        error="none",
    )  # fmt: skip
    motors, length = run.control.motors, run.structure.string_length
    lengths = np.array([length(N) for N in np.moveaxis(run.nodes, 2, 0)]).T
    stored = 0.5 * (run.force_density * lengths**2).sum(axis=0)
    # What is left of the energy when what γ stores is taken out: speed and height.
    body = run.energy - stored
    given = motors.energy.sum(axis=0)
    assert np.abs(body - body[0] - given).max() < 1e-6 * np.abs(given).max()
    np.testing.assert_allclose(motors.torque, run.force_density * lengths * 0.01 / 20)
    turned = (lengths[:, :1] - lengths) * 20 / 0.01
    np.testing.assert_allclose(motors.angle, turned, atol=1e-9)
    weak = tc.Winches(motor=tc.Motor(**GEAR, torque=0.01))
    held = tc.simulate(
        model, 0.3, controller=Pull(plant), winches=weak, input="force_density", step=1e-3,
        error="none",
    )  # fmt: skip
    assert held.control.motors.torque_limited.any()
    most = 0.01 * 20 / 0.01 / lengths[:, 0]
    assert (held.force_density[:, 0] <= most * (1 + 1e-12)).all()
    assert np.abs(held.control.motors.torque).max() <= 0.01


@pytest.mark.parametrize("kind", [{}, {"inertia": 2e-6}])
def test_a_motor_of_three_strings_is_three_motors_that_do_the_same(kind):
    """A prism whose lid is wound, by one motor with three times the torque or by three."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0, damping=2.0))
    rest = tc.prestress(prism, force_density=10.0)
    start = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    runs = []
    for lid, times in (({"lid": [0, 1, 2]}, 3.0), ([0, 1, 2], 1.0)):
        plant = tc.linearize(model, rest, input="rest_length", actuated=lid)
        inputs = plant.equilibrium_input
        winding = partial(_wound, inputs=inputs)
        law = tc.FunctionController(
            prism, winding, input="rest_length", sample_time=0.02, actuated=plant.actuation
        )
        numbers = {name: times * value for name, value in kind.items()}
        motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, torque=times * 4.5e-3, **numbers)
        winches = tc.Winches(ramp=True, substeps=4, motor=motor)
        runs.append(tc.simulate(
            model, 0.6, controller=law, winches=winches, rest_length=start, step=5e-3, error="none"
        ))  # fmt: skip
    one, three = runs
    assert one.control.motors.torque_limited.sum() > 5
    assert np.abs(one.rest_length[0] - start[0]).max() < 0.12  # asked: 0.15 m
    np.testing.assert_allclose(one.rest_length, three.rest_length, rtol=0, atol=1e-9)
    sums = three.control.motors.torque.sum(axis=0)
    np.testing.assert_allclose(one.control.motors.torque[0], sums, rtol=0, atol=1e-10)


def _wound(time, nodes, velocities, inputs):
    return inputs - min(0.3 * time, 0.15)


@pytest.mark.filterwarnings("ignore:rest length error")
@pytest.mark.parametrize(
    ("ramp", "kind"),
    [(True, {}), (False, {}), (True, {"backlash": 1.0}), (True, {"inertia": 1e-4})],
)
def test_a_motor_of_antagonists_is_limited_both_ways(ramp, kind):
    """A drum winds one string of a bar that is too heavy to move and pays out the other.

    Both are 1 m long, with 100 N/m and 0.9 m at rest. The drum is pulled by the difference of their
    tensions: 2 × 100 N/m until one is slack, at 0.1 m with 20 N, and 100 N/m from there. Its motor
    gives 25 N.
    """
    nodes = [[0.0, 0.0, -1.0, 1.0], [0.0, 1.0, 1.0, 1.0]]
    bar = tc.Structure(nodes, [[0, 1]], [[1, 2], [1, 3]], 1e12, fixed=[0, 2, 3])
    model = tc.Model(bar, strings=tc.LinearStrings(100.0))
    motor = tc.Motor(drum_radius=0.01, torque=0.25, **kind)
    runs = []
    for sign in (1, -1):
        law = tc.FunctionController(
            bar, lambda t, N, V, sign=sign: [0.9 - sign * 0.35 * np.sin(2 * np.pi * t)],
            input="rest_length", sample_time=2 * SAMPLE, actuated={"drum": {0: 1.0, 1: -1.0}},
        )  # fmt: skip
        winches = tc.Winches(ramp=ramp, substeps=4 if ramp else None, motor=motor)
        runs.append(tc.simulate(
            model, 1.0, controller=law, winches=winches, rest_length=0.9, step=SAMPLE, error="none",
        ))  # fmt: skip
    run, mirrored = runs
    first = run.time < (0.5 if "inertia" in kind else np.inf)  # then round-off says how it stops
    off = (run.rest_length - mirrored.rest_length[::-1])[:, first]
    np.testing.assert_allclose(off, 0.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.rest_length.sum(axis=0), 1.8, rtol=0, atol=1e-12)
    motors, tension = run.control.motors, np.maximum(100.0 * (1.0 - run.rest_length), 0.0)
    if not kind:
        pull = 0.01 * (tension[0] - tension[1])
        np.testing.assert_allclose(motors.torque[0], pull, rtol=0, atol=1e-10)
    reached = run.rest_length[0].min(), run.rest_length[0].max()
    if "inertia" in kind:  # the rotor winds on against the pull, and comes back
        assert reached[0] < 0.7
        assert reached[1] > 1.1
    else:
        np.testing.assert_allclose(reached, (0.75, 1.05), rtol=0, atol=1e-10)
    assert motors.torque_limited.sum() > 10
