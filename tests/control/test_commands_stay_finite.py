"""Whatever a controller or a filter is given, what follows is finite and within bounds."""

import re
from contextlib import suppress
from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Command, Controller, Status
from tests.refused import (
    INF,
    NAN,
    STILL,
    estimator,
    held_plant,
    lengths,
    nodes,
    plant,
    refused,
)

PREDICT = {"horizon": 4, "sample_time": 0.02}
RAMPS = tc.Winches(rate=0.5, substeps=4)
HUGE = np.full(9, 1e308)

# What is no input, no shape, no velocity, and no time.
BAD = {
    "None": None,
    "text": "x",
    "nan": NAN,
    "infinite": INF,
    "nans": np.full(9, NAN),
    "eight": np.ones(8),
    "complex": np.ones(9) * 1j,
    "truths": np.ones(9, dtype=bool),
    "masked": np.ma.ones(9),
    "row": np.ones((1, 9)),
    "shape of nans": np.full((3, 6), NAN),
    "transposed": np.ones((6, 3)),
    "ragged": [[1.0], [1.0, 2.0]],
    "list": [0.0],
    "mapping": {},
}

# Measurements may hold what is not finite; None is the operating point.
ALLOWED = {("command, nodes", "shape of nans"), ("command, velocities", "shape of nans")}
ALLOWED |= {("follow", "None")}
NAMED = re.compile(r"^(in )?(value|command|status|time|nodes|velocities|reference)\b")


class Own(Controller):
    """A controller of a user."""

    def _decide(self, time, state):
        return Command(self.plant.equilibrium_input - self.plant.B[9:].T @ state[9:])


@cache
def made(name):
    """A controller, used once."""
    kinds = {
        "LQR": lambda: tc.LQR(plant(), sample_time=0.02),
        "LQR, ramps": lambda: tc.LQR(held_plant(), sample_time=0.02, winches=RAMPS),
        "MPC": lambda: tc.MPC(plant(), max_force_density=60.0, load_gain=0.5, **PREDICT),
        "MPC, ramps": lambda: tc.MPC(held_plant(), winches=RAMPS, load_gain=0.5, **PREDICT),
        "NMPC": lambda: tc.NMPC(plant(), max_force_density=60.0, load_gain=0.5, **PREDICT),
        "FeedbackLinearization": lambda: tc.FeedbackLinearization(
            plant(), sample_time=0.02, max_force_density=60.0, frequency=1.0
        ),
        "Own": lambda: Own(plant(), 0.02, np.zeros(9), np.full(9, 60.0)),
    }
    return kinds[name]()


NAMES = "LQR", "LQR, ramps", "MPC", "MPC, ramps", "NMPC", "FeedbackLinearization", "Own"


def calls(controller):
    """Public methods with one argument each that is to be spoilt, by name."""
    named = {
        "applied": controller.applied,
        "fall_back": controller.fall_back,
        "command, time": lambda bad: controller.command(bad, nodes(), STILL),
        "command, nodes": lambda bad: controller.command(0.0, bad, STILL),
        "command, velocities": lambda bad: controller.command(0.0, nodes(), bad),
    }
    if hasattr(controller, "follow"):
        named["follow"] = controller.follow
    if hasattr(controller, "targets"):
        named["targets"] = controller.targets
    if hasattr(controller, "error"):
        named["error, time"] = lambda bad: controller.error(bad, nodes(), STILL)
        named["error, nodes"] = lambda bad: controller.error(0.0, bad, STILL)
    return named


def assert_commands(controller):
    """The next commands are finite and within bounds, with measurements and without."""
    low, high = controller.bounds
    pushed = controller.plant.to_nodes(np.full(9, 0.003))
    for k, shape in enumerate((nodes(), pushed, np.full((3, 6), NAN), pushed)):
        value = controller.command(0.02 * k, shape, STILL).value
        assert np.isfinite(value).all()
        assert (low <= value).all()
        assert (value <= high).all()


@pytest.mark.parametrize("name", NAMES)
def test_what_no_method_can_take_leaves_no_trace(name):
    controller = made(name)
    for method, call in calls(controller).items():
        for bad in BAD:
            controller.reset()
            if (method, bad) in ALLOWED:
                call(BAD[bad])
                continue
            with pytest.raises((TypeError, ValueError)) as raised:
                call(BAD[bad])
            assert not isinstance(raised.value, np.linalg.LinAlgError)
            assert NAMED.search(str(raised.value)), (method, bad, raised.value)
            assert controller.status_count.keys() <= {Status.MEASUREMENT_NOT_FINITE}
        assert_commands(controller)


@pytest.mark.parametrize("name", NAMES)
def test_inputs_of_any_size_are_followed_by_commands_within_bounds(name):
    controller = made(name)
    for value in (HUGE, -HUGE, 1e-240 * HUGE, np.zeros(9), np.full(9, 1e-320)):
        controller.reset()
        assert_commands(controller)
        with suppress(ValueError):  # too large
            controller.applied(value)
        assert_commands(controller)
    controller.reset()
    for _ in range(6):  # beyond the horizon
        controller.fall_back(Status.MEASUREMENT_NOT_FINITE)
    assert_commands(controller)
    for time in (1e60, -1e60):
        assert np.isfinite(controller.command(time, nodes(), STILL).value).all()


@pytest.mark.parametrize("prediction", ["linear", "nonlinear"])
def test_estimates_stay_finite(prediction):
    filter_ = tc.KalmanFilter(
        held_plant(), lengths(delay=1), sample_time=0.02, prediction=prediction
    )
    states, wound = len(filter_.poles), held_plant().rest_length
    exact = filter_.sensors.measure(nodes())
    for method in (filter_.update, filter_.predict, lambda bad: filter_.reset(state=bad)):
        for bad in ("text", "nan", "eight", "complex", "truths", "masked", "row", "ragged"):
            with pytest.raises((TypeError, ValueError)):
                method(BAD[bad])
    for bad in (np.full((states, states), NAN), -np.eye(states), np.triu(np.ones((states,) * 2))):
        with pytest.raises(ValueError, match="covariance"):
            filter_.reset(covariance=bad)
    with pytest.raises(ValueError, match="held"):
        filter_.reset(held=np.full(9, NAN))
    for value in (HUGE, -HUGE, 1e-240 * HUGE, np.zeros(9)):
        for given, held in ((value, wound), (exact, value), (None, value), (NAN * exact, wound)):
            with suppress(ValueError):  # too large
                filter_.predict(held)
            found = filter_.update(given)
            for part in (found.nodes, found.velocities, found.covariance, found.node_deviation):
                assert np.isfinite(part).all()
    filter_.reset(covariance=1e60 * np.eye(states))
    assert np.isfinite(filter_.update(exact).nodes).all()


def of(name, **changes):
    """A controller on a spoilt reference, or with spoilt bounds."""
    if name == "Own":
        return Own(**({"plant": plant(), "sample_time": 0.02, "low": 0, "high": 1} | changes))
    if name == "FeedbackLinearization":
        kind, usual = tc.FeedbackLinearization, {"sample_time": 0.02, "frequency": 1.0}
    else:
        kind, usual = getattr(tc, name), PREDICT
    return kind(plant(), max_force_density=60.0, **usual, **changes)


def mirrored():
    """The mirror image of the prism: all lengths are the same."""
    return nodes() * [[-1.0], [1.0], [1.0]]


def on_supports():
    """The plant of a prism whose bottom is fixed, and its shape."""
    structure = tc.Structure(nodes(), tc.prism().bars, tc.prism().strings, 1.0, fixed=[3, 4, 5])
    return tc.linearize(tc.Model(structure), tc.prestress(structure, 17.0)), structure.nodes


def later(shape):
    """A reference that comes to a shape after a second, from the operating point."""
    return tc.Reference([0.0, 1.0], np.stack([nodes(), shape], axis=-1))


def turned():
    """The prism with a bar the other way round."""
    return nodes()[:, [4, 1, 2, 3, 0, 5]]


IMPOSSIBLE = [
    ("zero", lambda: 0 * nodes(), r"in reference at 0 s, bar 0 has length 0 m, expected 1\.\d+ m"),
    ("twice the size", lambda: 2 * nodes(), r"bar \d has length 2\.\d+ m, expected 1\.\d+ m"),
    ("a bar long", lambda: later(nodes() * [[1.0], [1.0], [1.05]]), r"in reference at 1 s, bar"),
    ("mirrored", mirrored, r"bars 0 and 1 have changed sides"),
    (
        "mirrored later",
        lambda: later(mirrored()),
        r"in reference at 1 s, bars 0 and 1 have changed sides",
    ),
    ("turned", turned, r"strings .* off|right angle"),
    ("nan", lambda: NAN * nodes(), r"reference\[0, 0\] is nan"),
    ("of another", lambda: tc.prism(sides=5).nodes, r"reference has shape \(3, 10\)"),
    ("other bars", lambda: tc.prism(height=1.6).nodes, r"bar \d has length"),
]


@pytest.mark.parametrize("name", ["MPC", "NMPC", "FeedbackLinearization"])
@pytest.mark.parametrize(
    ("what", "shape", "message"), IMPOSSIBLE, ids=[each[0] for each in IMPOSSIBLE]
)
def test_references_that_cannot_be_are_refused_when_given(name, what, shape, message):
    with pytest.raises(ValueError, match=message):
        of(name, reference=shape())
    controller = made(name)
    controller.reset()
    with pytest.raises(ValueError, match=message):
        controller.follow(shape())
    assert_commands(controller)


def test_a_reference_moves_no_support():
    on, shape = on_supports()
    with pytest.raises(ValueError, match=r"in reference at 0 s, the fixed node \d is 0\.1 m"):
        tc.plant.reference.checked_reference(on, shape + np.array([[0.1], [0.0], [0.0]]))


def test_a_way_around_is_a_reference():
    # Another shape, halfway round as one body, and far away: shapes count, not places.
    radius = tc.structure.prism_radius(tc.prism().bar_length[0], 0.98)
    shape = tc.prism(radius=radius, height=0.98).nodes
    half = shape * [[-1.0], [-1.0], [1.0]] + [[5.0], [0.0], [0.0]]
    controller = of("MPC", reference=half)
    assert controller.command(0.0, nodes(), STILL).status is Status.OK


def test_an_estimate_starts_from_a_shape_in_reach():
    for shape in (turned(),):
        with pytest.raises(ValueError, match=r"start|bar"):
            tc.KalmanFilter(held_plant(), lengths(), sample_time=0.02, start=shape)
    assert estimator().sample_time == 0.001


OWN = [
    refused("low nan", lambda: of("Own", low=np.full(9, NAN)), ValueError, r"low\[0\] is nan"),
    refused("high nan", lambda: of("Own", low=np.zeros(9), high=np.full(9, NAN)), ValueError,
            r"high\[0\] is nan, expected at least low\[0\] = 0"),
    refused("crossed", lambda: of("Own", low=np.ones(9), high=np.zeros(9)), ValueError,
            r"high\[0\] is 0, expected at least low\[0\] = 1"),
    refused("short", lambda: of("Own", low=np.ones(8)), ValueError, r"low has shape \(8,\)"),
    refused("plant", lambda: of("Own", plant=1), TypeError, r"plant is a int"),
    refused("time", lambda: of("Own", sample_time=-1), ValueError, r"sample_time is -1"),
    refused("change", lambda: of("Own", low=np.zeros(9), high=np.ones(9), change=np.zeros(9)),
            ValueError, r"change\[0\] is 0"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "exception", "message"), OWN)
def test_a_controller_of_a_user_has_bounds(call, exception, message):
    with pytest.raises(exception, match=message):
        call()
