"""Inclinations, gyroscopes, accelerometers, ranges and encoders: values, biases, consistency."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.estimation.observability import observed_plant, output_function
from tests import coupled
from tests.benchmarks import filter_consistency
from tests.benchmarks.filter_consistency import ANCHORS
from tests.estimation.conftest import STEP
from tests.estimation.differences import differences


def ball_with_payload():
    """A ball of six bars, and 3 kg hung in its middle by a string from each node."""
    ball = tc.library.six_bar_ball()
    n = ball.nodes.shape[1]
    middle = ball.nodes.mean(axis=1, keepdims=True)
    return tc.Structure(
        np.hstack([ball.nodes, middle]), ball.bars,
        [*ball.strings.tolist(), *((i, n) for i in range(n))], ball.bar_mass,
        point_mass=np.r_[np.zeros(n), 3.0],
    )  # fmt: skip


@cache
def payload_rest():
    """The shape in which the strings to the payload pull as well."""
    return tc.shape_target(tc.Model(ball_with_payload()), force_density=20.0).prestress


STRUCTURES = {
    "ball": tc.library.six_bar_ball, "d_bar": coupled.d_bar, "tower": coupled.tower,
    "payload": ball_with_payload,
}  # fmt: skip


def robot(structure, scale=1.0, **more):
    d = structure.dimension
    motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, zero=1.0)
    return tc.Sensors(
        structure=structure, bar_inclination=0.01 * scale, gyroscope=0.02 * scale,
        accelerometer=0.1 * scale, node_range=0.02 * scale, range_nodes=[0, 2],
        anchors=ANCHORS[3 - d :], encoder=0.2 * scale, encoder_strings=[1, 0], motor=motor, **more,
    )  # fmt: skip


def turned(d0, d, e):
    """e turned about ``d₀ × d`` by the angle between them (Rodrigues)."""
    axis = np.cross(d0, d)
    sine, cosine = np.linalg.norm(axis), d0 @ d
    if sine < 1e-14:
        return e
    axis = axis / sine
    return e * cosine + np.cross(axis, e) * sine + axis * (axis @ e) * (1 - cosine)


def by_hand(structure, N, V, A, rest_length):
    d, y, axes = structure.dimension, [], []
    up = np.eye(d)[-1]
    for start, end in structure.bars:
        b, moved = N[:, end] - N[:, start], V[:, end] - V[:, start]
        along = b / np.linalg.norm(b)
        y.append([np.arcsin(along @ up)])
        if d == 2:
            axes.append([along, np.array([-along[1], along[0]])])
            continue
        first = structure.nodes[:, end] - structure.nodes[:, start]
        first = first / np.linalg.norm(first)
        level = np.cross(first, up)
        if np.linalg.norm(level) < 1e-6:
            level = np.cross(first, [1.0, 0, 0])
        level = level / np.linalg.norm(level)
        other = np.cross(first, level)
        axes.append([along, turned(first, along, level), turned(first, along, other)])
    for (start, end), axis in zip(structure.bars, axes, strict=True):
        b, moved = N[:, end] - N[:, start], V[:, end] - V[:, start]
        if d == 2:
            y.append([(b[0] * moved[1] - b[1] * moved[0]) / (b @ b)])
        else:
            rate = np.cross(b, moved) / (b @ b)
            y.append([rate @ axis[1], rate @ axis[2]])
    for node in range(N.shape[1]):
        bars = np.flatnonzero((structure.bars == node).any(axis=1))
        if len(bars):
            y.append([(A[:, node] + 9.81 * up) @ axis for axis in axes[bars[0]]])
    y += [[np.linalg.norm(N[:, i] - anchor)] for i in (0, 2) for anchor in ANCHORS[3 - d :].T]
    y += [[(1.0 - rest_length[i]) * 20.0 / 0.01] for i in (1, 0)]
    return np.concatenate(y)


@pytest.mark.parametrize("name", STRUCTURES)
def test_readings_are_those_of_formulas_written_anew(name):
    structure, rng = STRUCTURES[name](), np.random.default_rng(7)
    shape, count = structure.nodes.shape, len(structure.strings)
    sensors = robot(structure)
    for size in (0.0, 0.1):
        N = structure.nodes + size * rng.normal(size=shape)
        V, A = rng.normal(size=(2, *shape))
        rest_length = rng.uniform(0.5, 1.5, size=count)
        found = sensors.measure(N, velocities=V, acceleration=A, rest_length=rest_length)
        np.testing.assert_allclose(found, by_hand(structure, N, V, A, rest_length), atol=2e-8)


@pytest.mark.parametrize("name", ["ball", "d_bar", "payload"])
def test_derivatives_are_those_of_the_readings(name):
    structure = STRUCTURES[name]()
    model = tc.Model(structure, strings=tc.LinearStrings(500.0, damping=1.0))
    rest = payload_rest() if name == "payload" else tc.prestress(structure, force_density=10.0)
    sensors = robot(structure)
    plant = observed_plant(tc.linearize(model, rest, input="rest_length"), sensors)
    function, rng = output_function(plant, sensors), np.random.default_rng(0)
    z = 0.01 * rng.normal(size=len(plant.A))
    u, r = plant.rest_length, plant.degrees_of_freedom

    def read(z):
        N, V = plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:])
        free = structure.free
        x = np.concatenate([
            part[:, free].ravel(order="F") if not len(structure.rollers) else None
            for part in (N, V)
        ])  # fmt: skip
        moved = np.zeros(N.size)
        slope = np.array(model.rest_length_dynamics(x, u)).ravel()
        moved[structure.free_rows] = slope[len(x) // 2 :]
        A = moved.reshape(N.shape, order="F")
        return sensors.measure(N, velocities=V, acceleration=A, rest_length=u)

    y, C = (np.array(part.full()) for part in function(z, u))
    np.testing.assert_allclose(y.ravel(), read(z), rtol=0, atol=1e-9)
    scale = max(1.0, np.abs(C).max())
    along, changes = differences(read, z)
    np.testing.assert_allclose(C @ along / scale, changes / scale, rtol=0, atol=1e-7)


@pytest.mark.parametrize("kind", list(filter_consistency.KINDS)[:5])
def test_errors_are_as_large_as_the_filter_says(held, kind):
    """NEES of runs on the plant of the filter itself, with biases, within its bounds."""
    found = filter_consistency.consistency(filter_consistency.filter_of(held, kind, 1e-3), runs=6)
    assert found.left_alone == 0
    assert found.is_within, found


def test_a_bias_is_found_in_a_loop_and_told_with_its_deviation(held, model):
    """A gyroscope that is off by 0.1 rad/s, and strings that are wound wrongly."""
    sensors = tc.Sensors(
        structure=model.structure, string_length=1e-3, bar_direction=0.01, gyroscope=0.01,
        gyroscope_bars=[1], accelerometer=0.05, accelerometer_nodes=[0],
        bias={"gyroscope": (0.1, 1e-3), "accelerometer": (0.3, 1e-3)},
    )  # fmt: skip
    estimator = tc.KalmanFilter(held, sensors, sample_time=STEP, prediction="nonlinear")
    controller = tc.LQR(held, *tc.energy_weights(held), sample_time=STEP)
    run = tc.simulate(
        model, 3.0, controller=controller, estimator=estimator, seed=4, step=1e-3,
        rest_length=held.rest_length, error="none",
    )  # fmt: skip
    found = run.control.estimate
    biased = sensors.bias_deviation > 0
    off = found.bias[biased, -1] - found.actual_bias[biased, -1]
    assert np.abs(off / found.bias_deviation[biased, -1]).max() < 4
    assert (found.bias_deviation[biased, -1] < 0.5 * sensors.bias_deviation[biased]).all()
    assert not found.bias[~biased].any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"node_range": 0.01}, "node_range is given, but anchors is not"),
        ({"anchors": ANCHORS, "string_length": 1.0}, "anchors is given, but node_range is not"),
        ({"node_range": 0.01, "anchors": ANCHORS[:2]}, r"anchors has shape \(2, 4\)"),
        ({"encoder": 0.1}, "encoder is given, but motor is not"),
        ({"encoder": 0.1, "motor": tc.Motor(0.01)}, "motor.zero is not"),
        ({"bar_inclination": 0.1, "gravity": 0.0}, "gravity is 0"),
        ({"gyroscope": 0.1, "bias": {"bar_rate": (1, 1)}}, "key of bias"),
        ({"gyroscope": 0.1, "bias": {"gyroscope": (1, 0)}}, "bias of gyroscope"),
        ({"gyroscope": 0.1, "bias": {"gyroscope": 1}}, "bias of gyroscope has shape"),
    ],
)
def test_what_does_not_go_together_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        tc.Sensors(structure=tc.prism(), **arguments)


def test_filters_refuse_what_readings_cannot_tell(held, by_force, model):
    encoders = {"encoder": 0.1, "motor": tc.Motor(drum_radius=0.01, zero=1.0)}
    sensors = tc.Sensors(structure=model.structure, string_length=1e-3, **encoders)
    with pytest.raises(ValueError, match="give rest_length_error"):
        tc.KalmanFilter(held, sensors, sample_time=STEP)
    with pytest.raises(ValueError, match="linearize with input='rest_length'"):
        tc.KalmanFilter(by_force, sensors, sample_time=STEP, rest_length_error=(1e-3, 1e-3))
    blind = tc.Sensors(
        structure=model.structure, node_position=1e-3, bias={"node_position": (1e-3, 1e-4)}
    )
    with pytest.raises(ValueError, match="cannot be told from each other"):
        tc.KalmanFilter(held, blind, sample_time=STEP)
    weighed = tc.linearize(
        model.replace(gravity=1.62), tc.OperatingPoint(held.nodes, held.force_density,
        model.replace(gravity=1.62).constant_force), input="rest_length",
        require_equilibrium=False,
    )  # fmt: skip
    felt = tc.Sensors(structure=model.structure, bar_direction=0.01, accelerometer=0.1)
    with pytest.raises(ValueError, match="sensors feel the gravity"):
        tc.KalmanFilter(weighed, felt, sample_time=STEP)


def test_encoders_tell_of_the_inputs_that_drive_their_strings(held, model):
    """Winch 1 drives string 7: its rest length is 2 mm longer than the filter is told."""
    plant = tc.linearize(
        model, tc.OperatingPoint(held.nodes, held.force_density, model.constant_force),
        input="rest_length", actuated=[6, 7, 8], require_equilibrium=False,
    )  # fmt: skip
    motor = tc.Motor(drum_radius=0.01, zero=1.0)
    told = {"structure": model.structure, "string_length": 1e-3, "encoder": 0.01, "motor": motor}
    sensors = tc.Sensors(encoder_strings=[7], **told)
    given = {"sample_time": STEP, "rest_length_error": (5e-3, 1e-4)}
    estimator = tc.KalmanFilter(plant, sensors, **given)
    longer = plant.rest_length + 2e-3 * (np.arange(9) == 7)
    for _ in range(5):
        estimator.predict(plant.rest_length)
        y = sensors.measure(held.nodes, rest_length=longer)
        y[:9] = np.nan  # lengths are lost
        estimate = estimator.update(y)
    assert estimate.rest_length_error[7] == pytest.approx(2e-3, rel=0.02)
    assert not np.delete(estimate.rest_length_error, 7).any()
    assert np.flatnonzero(estimate.rest_length_deviation).tolist() == [7]
    with pytest.raises(ValueError, match="encoder of string 0, but no input"):
        tc.KalmanFilter(plant, tc.Sensors(encoder_strings=[0], **told), **given)


def holding(plant, sample_time):
    """A controller that holds the rest lengths of a plant."""
    return tc.FunctionController(
        plant.model.structure, lambda time, nodes, velocities: plant.rest_length,
        sample_time=sample_time, input="rest_length",
    )  # fmt: skip


def test_a_payload_is_estimated_with_the_ball_that_carries_it():
    structure = ball_with_payload()
    model = tc.Model(structure, strings=tc.LinearStrings(500.0, damping=2.0))
    plant = tc.linearize(model, payload_rest(), input="rest_length")
    sensors = tc.Sensors(
        structure=structure, bar_direction=0.005, accelerometer=0.05, string_length=1e-3,
        strings=[24, 26, 29],
    )  # fmt: skip
    estimator = tc.KalmanFilter(plant, sensors, sample_time=STEP, prediction="nonlinear")
    start = structure.nodes.copy()
    start[:, -1] += [0.03, -0.02, 0.02]
    hold = holding(plant, STEP)
    run = tc.simulate(
        model, 0.6, start, controller=hold, estimator=estimator, rest_length=plant.rest_length,
        seed=1, step=1e-3, error="none",
    )  # fmt: skip
    at = np.round(run.control.estimate.time / 1e-3).astype(int)
    off = run.control.estimate.nodes - run.nodes[:, :, at]
    off = np.linalg.norm(off - off[:, :12].mean(axis=1, keepdims=True), axis=0)
    assert off[-1, 0] > 0.02  # not known at first
    assert off[-1, 25:].max() < 5e-3


@pytest.mark.parametrize("moving", [False, True])
def test_supports_that_travel_do_not_mislead_inclinations_and_gyroscopes(moving):
    """A prism on a cart: readings that feel no place tell its shape wherever it is."""
    prism = tc.prism()
    held = tc.Structure(prism.nodes, prism.bars, prism.strings, prism.bar_mass, fixed=range(3))
    model = tc.Model(held, strings=tc.LinearStrings(200.0, damping=1.0))
    plant = tc.linearize(model, tc.prestress(held, force_density=17.3205), input="rest_length")
    sensors = tc.Sensors(
        structure=held, bar_inclination=0.005, gyroscope=0.01, string_length=1e-3,
        bias={"gyroscope": (0.05, 1e-3)},
    )  # fmt: skip
    estimator = tc.KalmanFilter(plant, sensors, sample_time=STEP, process_noise=0.05)
    hold = holding(plant, STEP)
    cart = {}
    if moving:
        x = lambda t: 0.2 * (1 - np.cos(1.5 * t))  # noqa: E731
        cart["support_motion"] = lambda t: np.array([[x(t)] * 3, [0.0] * 3, [0.0] * 3])
    run = tc.simulate(
        model, 3.0, plant.to_nodes(np.r_[0.01, np.zeros(plant.degrees_of_freedom - 1)]),
        controller=hold, estimator=estimator, rest_length=plant.rest_length, seed=1, step=1e-3,
        error="none", **cart,
    )  # fmt: skip
    at = np.round(run.control.estimate.time / 1e-3).astype(int)
    off = run.control.estimate.nodes - run.nodes[:, :, at]
    travelled = np.ptp(run.nodes[0, 0])
    assert travelled > 0.3 if moving else travelled == 0
    off = np.linalg.norm(off - off[:, :1], axis=0)
    assert off[:, 50:].max() < 4e-3


def test_a_body_on_the_ground_is_told_by_what_its_sensors_feel():
    """In a plant over ground no direction is left alone: friction feels where it turns to."""
    prism = tc.prism()
    ground = tc.Ground(stiffness=5e3, damping=0.3, friction=0.5, slip_speed=0.1)
    model = tc.Model(prism, tc.LinearStrings(200.0, damping=1.0), gravity=9.81, ground=ground)
    pulled = tc.prestress(prism, force_density=60.0)
    above = prism.nodes - [[0], [0], [prism.nodes[2].min() - 0.05]]
    air = tc.OperatingPoint(above, pulled.force_density, model.constant_force)
    plant = tc.linearize(
        model, air, input="rest_length", coordinates="minimal", require_equilibrium=False
    )
    inertial = {"string_length": 1e-3, "bar_inclination": 0.01, "gyroscope": 0.02}
    with pytest.raises(ValueError, match="not observable"):
        tc.KalmanFilter(
            plant, tc.Sensors(structure=prism, **inertial), sample_time=0.01,
            prediction="nonlinear",
        )  # fmt: skip
    sensors = tc.Sensors(
        structure=prism, **inertial, node_range=0.005, range_nodes=[0, 1, 4], anchors=ANCHORS
    )
    estimator = tc.KalmanFilter(plant, sensors, sample_time=0.01, prediction="nonlinear")
    assert not estimator.observability().left_alone
    hold = holding(plant, 0.01)
    run = tc.simulate(
        model, 0.6, above, controller=hold, estimator=estimator, rest_length=plant.rest_length,
        seed=1, step=1e-4, output_step=0.01, error="none",
    )  # fmt: skip
    told = run.control.estimate
    off = np.linalg.norm(told.nodes - run.nodes[:, :, : told.nodes.shape[2]], axis=0)
    assert run.nodes[2].min() < 0  # it stood on the ground
    assert off[:, 20:].mean() < 6e-3
