"""Robots that are advanced sample by sample, beside runs of the same samples."""

import pickle

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.model_parameters import parameters_of, with_parameters
from tests.marks import needs_core
from tests.without_core import without_core

SAMPLE, STEP = 0.02, 1e-3


def ball(ground=True):
    structure = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    law = tc.LinearStrings(stiffness=1000.0, damping=10.0)
    plane = tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.05)
    return tc.Model(structure, law, gravity=9.81, ground=plane if ground else None)


def prism():
    return tc.Model(tc.prism(), tc.LinearStrings(stiffness=100.0))


def hinged():
    from dataclasses import replace

    return tc.Model(replace(tc.prism(), fixed=[3]), tc.LinearStrings(100.0), gravity=9.81)


def joined():
    return tc.Model(tc.library.class2_tower(1), tc.LinearStrings(100.0))


MODELS = {"ball": ball, "prism": prism, "hinged": hinged, "joined": joined}
WINCHES = {
    "none": None,
    "jumps": tc.Winches(rate=0.3),
    "ramp": tc.Winches(rate=0.3, shortest=0.1, ramp=True),
}


def start_of(model):
    """Nodes, and rest lengths a little short, so that it moves; the ball a little above ground."""
    nodes = model.structure.nodes.copy()
    if model.ground:
        nodes[2] += 0.01 - nodes[2].min()
    return nodes, 0.97 * model.structure.string_length()


def commands_of(model, count, seed=0):
    rng = np.random.default_rng(seed)
    lengths = model.structure.string_length()
    return rng.uniform(0.85, 1.05, (count, len(lengths))) * lengths


def stepped(stepper, commands):
    return [stepper.step(command) for command in commands]


@pytest.mark.parametrize(
    ("winches", "method"), [("none", "rk4_plain"), ("jumps", "rk4"), ("ramp", "rk4_plain")]
)
@pytest.mark.parametrize("name", MODELS)
def test_samples_have_the_bits_of_a_run(name, winches, method):
    model = MODELS[name]()
    nodes, lengths = start_of(model)
    commands = commands_of(model, 12)
    run = tc.simulate(
        model, 12 * SAMPLE, nodes, controller=lambda t, N, V: commands[round(t / SAMPLE)],
        sample_time=SAMPLE, rest_length=lengths, winches=WINCHES[winches], method=method,
        step=STEP, output_step=SAMPLE, error="none",
    )  # fmt: skip
    stepper = tc.Stepper(
        model, SAMPLE, step=STEP, nodes=nodes, rest_length=lengths, winches=WINCHES[winches],
        method=method,
    )  # fmt: skip
    assert (run.work.switches > 0) == (method == "rk4")
    for k, (N, V) in enumerate(stepped(stepper, commands)):
        assert np.array_equal(N, run.nodes[:, :, k + 1])
        assert np.array_equal(V, run.velocities[:, :, k + 1])
    assert np.array_equal(stepper.held, run.control.applied[:, -1])
    assert stepper.time == pytest.approx(12 * SAMPLE)


def test_force_densities_are_held():
    model = tc.Model(tc.prism())
    gamma = np.array([17.3205] * 6 + [9.0] * 3)
    stepper = tc.Stepper(model, SAMPLE, step=STEP, force_density=gamma)
    commands = np.random.default_rng(0).uniform(5, 30, (5, 9))
    run = tc.simulate(
        model, 5 * SAMPLE, controller=lambda t, N, V: commands[round(t / SAMPLE)],
        sample_time=SAMPLE, method="rk4_plain", step=STEP, output_step=SAMPLE, error="none",
    )  # fmt: skip
    (*_, (N, _)) = stepped(stepper, commands)
    assert np.array_equal(N, run.nodes[:, :, -1])


@pytest.mark.parametrize(
    ("winches", "method"), [("none", "rk4_plain"), ("jumps", "rk4"), ("ramp", "rk4_plain")]
)
def test_many_robots_have_the_bits_of_each(winches, method):
    model, count = ball(), 7
    nodes, lengths = start_of(model)
    rng = np.random.default_rng(1)
    starts = nodes + rng.uniform(0.0, 0.2, (count, 3, 1))
    commands = np.stack([commands_of(model, 8, seed) for seed in range(count)], axis=1)
    given = {"step": STEP, "method": method, "rest_length": lengths, "winches": WINCHES[winches]}
    many = tc.Stepper(model, SAMPLE, nodes=starts, count=count, **given)
    (*_, (N, V)) = stepped(many, commands)
    assert N.shape == (count, 3, 12)
    for robot in range(count):
        one = tc.Stepper(model, SAMPLE, nodes=starts[robot], **given)
        (*_, last) = stepped(one, commands[:, robot])
        assert np.array_equal(last[0], N[robot])
        assert np.array_equal(last[1], V[robot])
    assert many.held.shape == (count, 24)


PARAMETERS = {
    "side by side": {
        "stiffness": [900.0, 1000.0, 1100.0], "damping": [5.0, 10.0, 20.0],
        "ground.friction": [0.2, 0.5, 0.9], "ground.stiffness": [3e3, 5e3, 9e3],
        "bar_mass": np.array([0.4, 0.5, 0.6])[:, None] * np.linspace(0.9, 1.1, 6),
        "gravity": np.array([[0.0, 0.0, -9.0], [0.0, 0.0, -9.81], [0.1, 0.0, -10.0]]),
    },
    "one by one": {"damping": [0.0, 10.0, 20.0], "ground.friction": [0.0, 0.5, 0.9]},
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "winches"),
    [
        pytest.param("side by side", "jumps", marks=needs_core),
        pytest.param("side by side", "ramp", marks=needs_core),
        ("one by one", "none"),
    ],
)
def test_robots_with_parameters_have_the_bits_of_runs_of_their_models(kind, winches):
    model, samples = ball(), 4
    nodes, lengths = start_of(model)
    commands, given = commands_of(model, samples), PARAMETERS[kind]
    how = {"nodes": nodes, "rest_length": lengths, "winches": WINCHES[winches], "step": STEP}
    many = tc.Stepper(model, SAMPLE, count=3, **how)
    many.step(np.stack([commands[0]] * 3))
    many.reset(parameters={name: np.array(rows) for name, rows in given.items()})
    assert (many._models._lanes is not None) == (kind == "side by side")
    ends = []
    for command in commands:
        ends.append(many.step(np.stack([command] * 3)))
    last, again = ends[-1], pickle.loads(pickle.dumps(many))
    for robot in (0, 2):
        own = {
            name: np.broadcast_to(rows[robot], parameters_of(model)[name].shape)
            for name, rows in given.items()
        }
        run = tc.simulate(
            with_parameters(model, own), samples * SAMPLE, method="rk4_plain", output_step=SAMPLE,
            controller=lambda t, N, V: commands[round(t / SAMPLE)], sample_time=SAMPLE,
            error="none", **how,
        )  # fmt: skip
        assert np.array_equal(last[0][robot], run.nodes[:, :, -1])
        one = tc.Stepper(model, SAMPLE, parameters=own, **how)
        assert np.array_equal(stepped(one, commands)[-1][1], run.velocities[:, :, -1])
    both = np.stack([commands[0]] * 3)
    assert np.array_equal(again.step(both)[0], many.step(both)[0])
    assert many.parameters.keys() == given.keys()
    # Another robot alone gets other numbers: what is prepared for the others stays.
    prepared, core = dict(many._models._alone), many._models._core
    many.reset([1], parameters={"ground.friction": 0.7})
    assert many._models._core is core
    assert many._models._alone == {k: own for k, own in prepared.items() if k != 1}
    own = {name: np.array(rows[1]) for name, rows in many.parameters.items()}
    one = tc.Stepper(model, SAMPLE, parameters=own, **how)
    ends = one.step(commands[0])[0], many.step(both)[0][1]  # samples differ by round-off
    assert np.allclose(*ends, rtol=0, atol=1e-12)


def test_readings_are_those_of_a_run():
    model, samples = prism(), 6
    nodes, lengths = start_of(model)
    commands = commands_of(model, samples)
    rest = tc.prestress(model.structure, force_density=17.3205)
    plant = tc.linearize(model, rest, "rest_length")
    sensors = tc.Sensors(
        structure=model.structure, bar_inclination=0.01, gyroscope=0.02, accelerometer=0.1,
        string_tension=0.5, encoder=0.01, motor=tc.Motor(drum_radius=0.01, zero=0.6),
        bias={"gyroscope": (0.05, 0.01)}, delay=1, drop_rate=0.1, gravity=9.81,
    )  # fmt: skip
    how = {"nodes": nodes, "rest_length": lengths, "step": STEP}
    run = tc.simulate(
        model, samples * SAMPLE, controller=lambda t, N, V: commands[round(t / SAMPLE)],
        sample_time=SAMPLE, seed=3, method="rk4_plain", output_step=SAMPLE, error="none", **how,
        estimator=tc.KalmanFilter(
            plant, sensors, sample_time=SAMPLE, rest_length_error=(0.01, 0.001)
        ),
    )  # fmt: skip
    read = run.control.estimate.measurement
    stepper = tc.Stepper(model, SAMPLE, sensors=sensors, seed=3, **how)
    first = stepper.reset()
    kept = stepper.state
    rows = [first, *(stepper.step(command) for command in commands[:-1])]
    assert np.array_equal(np.column_stack(rows), read, equal_nan=True)
    stepper.state = kept
    again = [stepper.step(command) for command in commands[:-1]]
    assert np.array_equal(again, rows[1:], equal_nan=True)
    many = tc.Stepper(model, SAMPLE, sensors=sensors, seed=2, count=2, **how)
    rows = [many.step(np.stack([command] * 2))[1] for command in commands[:-1]]
    assert np.array_equal(np.column_stack(rows), read[:, 1:], equal_nan=True)
    begun = many.reset([0])
    assert np.isnan(begun[0]).all()  # nothing has arrived: they are late by a sample
    assert np.array_equal(begun[1], rows[-1], equal_nan=True)  # no time has passed for it
    # Another episode has other noise, and goes on as a state of it does.
    kept = pickle.loads(pickle.dumps(many.state))
    again = many.step(np.stack([commands[0]] * 2))
    assert np.isfinite(again[0]).any()
    assert not (again[0] == read[:, 1]).any()
    many.state = kept
    assert np.array_equal(again, many.step(np.stack([commands[0]] * 2)), equal_nan=True)


def test_without_the_core_it_is_the_same_to_round_off():
    model = ball()
    nodes, lengths = start_of(model)
    commands, given = commands_of(model, 3), {"step": STEP, "nodes": nodes, "rest_length": lengths}
    fast = stepped(tc.Stepper(model, SAMPLE, **given), commands)
    with without_core():
        slow = stepped(tc.Stepper(ball(), SAMPLE, **given), commands)
    assert np.allclose(fast[-1], slow[-1], rtol=0, atol=1e-9)


def test_driven_strings_move_and_passive_ones_keep_what_they_have():
    model = prism()
    _, lengths = start_of(model)
    groups = {"lid": ["top"], "side": {6: 1.0, 7: -0.5}}
    stepper = tc.Stepper(
        model, SAMPLE, step=STEP, rest_length=lengths, actuated=groups,
        winches=tc.Winches(rate=0.1, ramp=True), count=2,
    )  # fmt: skip
    start = stepper.actuation.inputs(lengths)
    stepper.step(start + np.array([[0.05, 0.0], [0.0, -0.05]]))
    wound = stepper.held - lengths
    expected = np.zeros((2, 9))
    expected[0, :3] = 0.1 * SAMPLE
    expected[1, 6:8] = np.array([-1.0, 0.5]) * 0.1 * SAMPLE
    assert np.allclose(wound, expected, rtol=0, atol=1e-15)
    plant = tc.linearize(
        model, tc.prestress(tc.prism(), force_density=17.3205), "rest_length", actuated=groups
    )
    assert tc.Stepper(model, SAMPLE, step=STEP, rest_length=lengths, actuated=plant.actuation).step(
        start
    )[0].shape == (3, 6)


def test_a_state_is_kept_set_and_pickled():
    model, count = ball(), 3
    nodes, lengths = start_of(model)
    stepper = tc.Stepper(model, SAMPLE, step=STEP, nodes=nodes, rest_length=lengths, count=count)
    commands = np.stack([commands_of(model, 6, seed) for seed in range(count)], axis=1)
    stepped(stepper, commands[:3])
    kept = pickle.loads(pickle.dumps(stepper.state))
    copied = pickle.loads(pickle.dumps(stepper))
    first = stepped(stepper, commands[3:])[-1]
    stepper.state = kept
    assert stepper.time == pytest.approx(3 * SAMPLE)
    assert np.array_equal(first, stepped(stepper, commands[3:])[-1])
    assert np.array_equal(first, stepped(copied, commands[3:])[-1])
    begun = stepper.reset()
    assert stepper.time == 0
    assert np.array_equal(begun[0], np.broadcast_to(nodes, begun[0].shape))
    with pytest.raises(ValueError, match=r"state.states has shape \(3, 72\), expected \(2, 72\)"):
        tc.Stepper(model, SAMPLE, step=STEP, nodes=nodes, rest_length=lengths, count=2).state = kept


def test_some_robots_begin_anew():
    model, count = ball(), 4
    nodes, lengths = start_of(model)
    stepper = tc.Stepper(model, SAMPLE, step=STEP, nodes=nodes, rest_length=lengths, count=count)
    command = np.tile(0.9 * lengths, (count, 1))
    before = stepper.step(command)[0]
    after = stepper.reset([1, 3], nodes=nodes + np.array([[0.0], [0.0], [1.0]]))[0]
    assert np.array_equal(after[[0, 2]], before[[0, 2]])
    assert np.allclose(after[[1, 3]] - [[0.0], [0.0], [1.0]], nodes, rtol=0, atol=1e-12)
    assert np.array_equal(stepper.reset(np.array([True] * 4))[0], np.stack([nodes] * 4))


def test_a_robot_that_is_lost_does_not_stop_the_others():
    model = tc.Model(tc.prism(), tc.LinearStrings(stiffness=1e6))
    lengths = model.structure.string_length()
    stepper = tc.Stepper(model, 0.5, step=0.05, rest_length=lengths, count=2)
    for _ in range(20):
        nodes, _ = stepper.step([lengths, 0.5 * lengths])
    assert stepper.lost.tolist() == [False, True]
    assert np.isfinite(nodes[0]).all()
    assert np.isnan(nodes[1]).all()
    for _ in range(20):  # on, when none is left
        nodes, _ = stepper.step([0.5 * lengths] * 2)
    assert stepper.lost.all()
    assert np.isnan(nodes).all()
    sensors = tc.Sensors(structure=model.structure, gyroscope=0.1)
    alone = tc.Stepper(model, 0.5, step=0.05, rest_length=lengths, sensors=sensors)
    for _ in range(20):
        readings = alone.step(0.5 * lengths)
    assert alone.lost
    assert np.isnan(readings).all()
    alone.reset()
    assert not alone.lost


def test_what_does_not_fit_is_refused():
    model = prism()
    _, lengths = start_of(model)

    def made(**changes):
        return tc.Stepper(model, SAMPLE, **{"step": STEP, "rest_length": lengths} | changes)

    stepper = made()
    with pytest.raises(ValueError, match=r"command has shape \(3,\), expected \(9,\)"):
        stepper.step(np.ones(3))
    with pytest.raises(ValueError, match="command"):
        stepper.step(np.full(9, np.nan))
    with pytest.raises(ValueError, match="command"):
        stepper.step(np.zeros(9))
    with pytest.raises(ValueError, match="method is 'dop853'"):
        made(method="dop853")
    with pytest.raises(ValueError, match="motor or substeps"):
        made(winches=tc.Winches(motor=tc.Motor(drum_radius=0.01, torque=1.0)))
    with pytest.raises(ValueError, match="expected 2 robots"):
        made(count=2, nodes=np.stack([tc.prism().nodes] * 3))
    with pytest.raises(TypeError, match="rest_length"):
        made(rest_length=tc.Profile([0.0, 1.0], np.column_stack([lengths, lengths + 0.1])))
    with pytest.raises(ValueError, match=r"robot 1 begins with .* passive strings begin alike"):
        made(count=2, rest_length=np.stack([lengths, 1.01 * lengths]), actuated=["vertical"])
    with pytest.raises(ValueError, match="winches move rest lengths"):
        tc.Stepper(model, SAMPLE, step=STEP, force_density=20.0, winches=tc.Winches(rate=1.0))
    with pytest.raises(ValueError, match="parameters is 'friction'"):
        made(parameters={"friction": 0.5})
    with pytest.raises(ValueError, match="stiffness"):
        made(parameters={"stiffness": -1.0})
    with pytest.raises(ValueError, match=r"parameters\['stiffness'\] has shape \(3,\)"):
        made(parameters={"stiffness": np.ones(3)})
    with pytest.raises(ValueError, match="gravity"):
        made(parameters={"gravity": 9.81})
    with pytest.raises(ValueError, match="sensors are on"):
        made(sensors=tc.Sensors(structure=tc.library.snelson_x(), string_length=0.1))
    with pytest.raises(TypeError, match="state"):
        stepper.state = lengths
    with pytest.raises(ValueError, match="robots"):
        made(count=2).reset([2])
