"""What sensors read: values, derivatives, noise, losses."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.estimation.observability import observed_plant, output_derivative, output_function
from tests.benchmarks import filter_consistency
from tests.estimation.conftest import EVERY, STEP


def read(plant, sensors, z, u):
    """All readings of a state by the nodes and the string law, away from CasADi."""
    r = len(z) // 2
    N, V = plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:])
    structure = plant.model.structure
    S, Sd = structure.string_vectors(N), structure.string_vectors(V)
    length = np.linalg.norm(S, axis=0)
    gamma = u
    if plant.input == "rest_length":
        gamma = plant.model.strings.force_density(length, u, (S * Sd).sum(axis=0) / length)
    B, Bd = structure.bar_vectors(N), structure.bar_vectors(V)
    size = np.linalg.norm(B, axis=0)
    every = {
        "node_position": N,
        "string_length": length,
        "bar_direction": B / size,
        "string_tension": gamma * length,
        "bar_rate": np.cross(B, Bd, axis=0) / size**2,
    }
    y = [every[kind].ravel(order="F") for kind in EVERY if getattr(sensors, kind) is not None]
    np.testing.assert_allclose(sensors.measure(N, gamma * length, V), np.concatenate(y), atol=1e-12)
    return np.concatenate(y)


@pytest.mark.parametrize("kinds", [tuple(EVERY), *((kind,) for kind in EVERY)])
@pytest.mark.parametrize(("which", "coordinates"), [("held", "minimal"), ("by_force", "internal")])
def test_derivatives_are_those_of_the_readings(request, kinds, which, coordinates, sensors_of):
    sensors = sensors_of(*kinds)
    plant = tc.plant.in_coordinates(request.getfixturevalue(which), coordinates)
    plant = observed_plant(plant, sensors)
    rng = np.random.default_rng(3)
    function = output_function(plant, sensors)
    u = plant.equilibrium_input * (1 + 0.05 * rng.normal(size=9))
    for z in (np.zeros(len(plant.A)), 0.02 * rng.normal(size=len(plant.A))):
        y, C = (np.array(part.full()) for part in function(z, u))
        np.testing.assert_allclose(y.ravel(), read(plant, sensors, z, u), rtol=0, atol=1e-11)
        h = 1e-5
        columns = [
            (read(plant, sensors, z + h * e, u) - read(plant, sensors, z - h * e, u)) / (2 * h)
            for e in np.eye(len(z))
        ]
        np.testing.assert_allclose(C, np.column_stack(columns), rtol=0, atol=2e-8)
    at_rest = output_derivative(plant, sensors)
    np.testing.assert_array_equal(
        at_rest, function(np.zeros(len(plant.A)), plant.equilibrium_input)[1].full()
    )


def test_a_plant_gets_the_motions_as_one_body_that_are_seen(held, sensors_of):
    def count(*kinds, **options):
        return observed_plant(held, sensors_of(*kinds, **options)).degrees_of_freedom

    assert count("string_length", "string_tension") == 9
    assert count("bar_direction") == 9 + 3  # turning
    assert count("bar_direction", bars=[1]) == 9 + 2  # not about the bar
    assert count("bar_rate") == 9 + 3
    assert count("bar_rate", rate_bars=[1]) == 9 + 2  # not about the bar
    assert count("node_position", nodes=[4]) == 9 + 3
    assert count("node_position", nodes=[0, 1]) == 9 + 5  # not about the line through both
    assert count("node_position") == 9 + 6


def test_the_added_motions_do_not_mix_with_changes_of_shape(held, sensors_of):
    plant = observed_plant(held, sensors_of("node_position", nodes=[0, 1]))
    T = plant.basis
    gram = T.T @ np.kron(plant.model.mass_matrix().toarray(), np.eye(3)) @ T
    np.testing.assert_allclose(gram, np.eye(14), rtol=0, atol=1e-12)
    poles = np.sort(np.abs(np.linalg.eigvals(plant.A)))
    np.testing.assert_allclose(poles[10:], np.sort(np.abs(np.linalg.eigvals(held.A))), rtol=1e-6)
    assert poles[:10].max() < 1e-5


def test_noise_losses_and_outliers_come_as_often_as_said(model):
    sensors = tc.Sensors(
        structure=model.structure, string_length=1e-3, bar_direction=0.01, bars=[0],
        drop_rate=0.2, outlier_rate=0.05,
    )  # fmt: skip
    exact = sensors.measure(model.structure.nodes)
    rng = np.random.default_rng(0)
    rows = np.array([sensors.disturb(exact, rng) for _ in range(4000)])
    lost = np.isnan(rows).all(axis=1)
    assert np.isnan(rows).any(axis=1).tolist() == lost.tolist()
    assert lost.mean() == pytest.approx(0.2, abs=0.02)
    off = (rows[~lost] - exact) / sensors.noise
    corrupt = np.abs(off) > 10
    assert corrupt[:, :9].mean() == pytest.approx(0.05, abs=0.01)
    # The entries of one reading go wrong together.
    np.testing.assert_array_equal(corrupt[:, 9], corrupt[:, 11])
    assert np.abs(off[corrupt]).min() > 15
    assert off[~corrupt].std() == pytest.approx(1.0, abs=0.02)
    assert abs(off[~corrupt].mean()) < 0.02


def test_random_numbers_are_drawn_alike_whatever_is_lost(model):
    arguments = {"structure": model.structure, "string_length": 1e-3}
    always, often = tc.Sensors(**arguments), tc.Sensors(**arguments, drop_rate=0.5)
    exact = always.measure(model.structure.nodes)
    one, other = np.random.default_rng(1), np.random.default_rng(1)
    for _ in range(20):
        seen, perhaps = always.disturb(exact, one), often.disturb(exact, other)
        assert np.isnan(perhaps).all() or np.array_equal(seen, perhaps)


def test_tensions_that_are_not_known_are_lost(sensors_of, model):
    y = sensors_of("string_length", "string_tension").measure(model.structure.nodes)
    assert np.isfinite(y[:9]).all()
    assert np.isnan(y[9:]).all()


# ---- what is not seen ----


def test_a_mechanism_that_no_length_shows_is_seen_by_its_vibration(held, sensors_of):
    # To first order no string changes its length along the mechanism. It is no vibration of its
    # own: in time it moves the lengths.
    sensors = sensors_of("string_length")
    C = output_derivative(held, sensors)
    sizes = np.linalg.svd(C[:, :9], compute_uv=False)
    assert sizes[-1] < 1e-12 * sizes[0]
    assert np.abs(tc.KalmanFilter(held, sensors, sample_time=STEP).poles).max() < 1


def test_what_is_not_seen_is_refused_with_what_would_do(by_force, model):
    sensors = tc.Sensors(structure=model.structure, string_length=1e-3, strings=[0])
    with pytest.raises(ValueError, match=r"10 of the 18 states are not observable") as raised:
        tc.KalmanFilter(undamped(by_force), sensors, sample_time=STEP)
    text = str(raised.value)
    assert "string_length of all strings" in text
    # Nothing holds the mechanism at its place, and rates do not tell it.
    assert "bar_rate" not in text
    # What is said to do does.
    for kind in set(EVERY) - {"bar_rate"}:
        assert f"{kind} of all" in text
        more = {"string_length": 1e-3, "strings": [0]} if kind != "string_length" else {}
        tc.KalmanFilter(
            undamped(by_force),
            tc.Sensors(structure=model.structure, **more, **{kind: 1e-3}),
            sample_time=STEP,
        )


def test_rates_without_directions_tell_the_shape_and_leave_turning_alone(held, sensors_of):
    estimator = tc.KalmanFilter(held, sensors_of("string_length", "bar_rate"), sample_time=STEP)
    assert estimator.left_alone.label == ("rigid",) * 3
    assert np.count_nonzero(np.abs(estimator.poles) < 1 - 1e-6) == 24 - 3
    report = estimator.observability()
    assert report.left_alone == ("turn about x", "turn about y", "turn about z")
    whole = sensors_of("string_length", "bar_direction", "bar_rate", bars=[0, 1], rate_bars=[2])
    seen = tc.KalmanFilter(held, whole, sample_time=STEP)
    assert np.abs(seen.poles).max() < 1
    assert not seen.observability().left_alone


def test_minimal_coordinates_need_readings_of_the_motion_as_one_body(held, sensors_of):
    minimal = tc.plant.in_coordinates(held, "minimal")
    with pytest.raises(ValueError, match=r"12 of the 30 states.*node_position of all nodes"):
        tc.KalmanFilter(minimal, sensors_of("string_length"), sample_time=STEP)


def undamped(plant):
    model = tc.Model(plant.model.structure)
    return tc.linearize(model, tc.prestress(model.structure, force_density=17.320508))


def test_advice_does_not_depend_on_how_good_the_other_readings_are(by_force, model):
    texts = []
    for noise in (1e-3, 1e-13):
        sensors = tc.Sensors(structure=model.structure, string_length=noise, strings=[0])
        with pytest.raises(ValueError, match="10 of the 18 states") as raised:
            tc.KalmanFilter(undamped(by_force), sensors, sample_time=STEP)
        texts.append(str(raised.value))
    assert texts[0] == texts[1]


# ---- directions left alone ----


def imu(model, **more):
    """Inertial sensors on all bars, without a compass."""
    return tc.Sensors(
        structure=model.structure, string_length=1e-3, bar_inclination=0.01, gyroscope=0.02, **more
    )


@pytest.mark.parametrize("kind", ["no compass", "no compass, biased"])
def test_without_a_compass_errors_of_the_rest_are_as_large_as_said(held, kind):
    estimator = filter_consistency.filter_of(held, kind, 0.3, "nonlinear")
    found = filter_consistency.consistency(estimator, runs=6)
    assert found.left_alone == (1 if kind == "no compass" else 2)
    assert found.is_within, found


def test_a_bias_about_the_vertical_is_said_to_be_left_alone(held, model):
    """Those about the other axis of the bars are found."""
    biased = imu(model, bias={"gyroscope": (0.05, 1e-3)})
    report = tc.KalmanFilter(held, biased, sample_time=STEP).observability()
    alone = {f"bias of gyroscope {bar}, entry 1" for bar in range(3)}
    assert set(report.left_alone) == {"turn about z", "rate of turn about z", *alone}
    by_name = dict(zip(report.direction, report.filter_deviation, strict=True))
    assert by_name["bias of gyroscope 0, entry 0"] < 0.005
    assert "Left alone: turn about z" in report.table()


def test_a_report_says_what_tells_of_a_direction(held, model):
    report = tc.KalmanFilter(held, imu(model), sample_time=STEP).observability(duration=STEP)
    assert report.told_by("turn about x") == ("bar_inclination",)
    assert report.told_by("rate of turn about z") == ("gyroscope",)
    assert report.told_by("turn about z") == ()
    # One sample: 1 mm of each of three inclined bars, in units of the node that moves most.
    place = report.direction.index("turn about x"), report.sensor.index("bar_inclination")
    turned = model.structure.nodes - model.structure.nodes.mean(axis=1, keepdims=True)
    angle = 1 / np.linalg.norm(turned[1:], axis=0).max()
    h, cos, sin = 1e-6, np.cos(1e-6 * angle), np.sin(1e-6 * angle)
    turn = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    only = tc.Sensors(structure=model.structure, bar_inclination=0.01)
    rise = (only.measure(turn @ turned) - only.measure(turned)) / h
    assert report.deviation[place] == pytest.approx(0.01 / np.linalg.norm(rise), rel=1e-4)
    with pytest.raises(ValueError, match="direction is 'yaw', expected one of"):
        report.told_by("yaw")


def test_a_direction_left_alone_changes_no_other_estimate(held, model):
    """Turned about the vertical, the same readings give the same shape, turned as well."""
    estimator = tc.KalmanFilter(held, imu(model), sample_time=STEP)
    lost = estimator._design.unseen[:, 0]
    nodes, states = model.structure.nodes, []
    exact = estimator.sensors.measure(nodes, velocities=np.zeros_like(nodes))
    for turned in (0.0, 1e-6):
        estimator.reset(state=turned * lost)
        for _ in range(30):
            estimate = estimator.update(exact)
            estimator.predict(held.rest_length)
        states.append(estimate.state)
    np.testing.assert_allclose(states[1] - states[0], 1e-6 * lost, rtol=0, atol=1e-11)
