"""A load that the filter does not know: with it as a state the estimate has no bias."""

import pickle

import numpy as np
import pytest

import tenscontrol as tc
from tests.estimation.conftest import STEP

KINDS = ("string_length", "bar_direction")


def pulled(held, size):
    """Shape in which the prism stands still with two nodes pulled apart, and the forces, N."""
    from scipy.optimize import least_squares

    structure, law = held.model.structure, held.model.strings

    def left_over(unknown):
        nodes = held.to_nodes(unknown[:9])
        gamma = law.force_density(structure.string_length(nodes), held.rest_length)
        force = np.zeros((3, 6))
        members = np.vstack([structure.strings, structure.bars, [[3, 4]]])
        # Pulled along the line between them, so that nothing turns.
        pull = size / np.linalg.norm(nodes[:, 4] - nodes[:, 3])
        for (i, j), each in zip(members, [*gamma, *unknown[9:], -pull], strict=True):
            force[:, i] += each * (nodes[:, j] - nodes[:, i])
            force[:, j] -= each * (nodes[:, j] - nodes[:, i])
        return force.ravel()

    found = least_squares(left_over, np.r_[np.zeros(9), np.full(3, -17.3)], xtol=1e-14, ftol=1e-14)
    assert np.abs(found.fun).max() < 1e-9
    nodes = held.to_nodes(found.x[:9])
    line = nodes[:, 4] - nodes[:, 3]
    load = np.zeros((3, 6))
    load[:, 4] = size * line / np.linalg.norm(line)
    load[:, 3] = -load[:, 4]
    return nodes, load


def watched(estimator, nodes, count, generator=None):
    """Estimates of a shape that stands still, from readings with noise or without."""
    exact, found = estimator.sensors.measure(nodes), []
    for _ in range(count):
        y = exact if generator is None else estimator.sensors.disturb(exact, generator)
        found.append(estimator.update(y))
        estimator.predict(estimator.plant.equilibrium_input)
    return found


def farthest(nodes, truth):
    return float(np.linalg.norm(nodes - truth, axis=0).max())


@pytest.mark.parametrize("prediction", ["linear", "nonlinear"])
def test_two_newtons_do_not_shift_the_estimate(held, sensors_of, prediction):
    nodes, load = pulled(held, 2.0)
    assert farthest(nodes, held.nodes) > 0.01
    off = {}
    for known in (False, True):
        estimator = tc.KalmanFilter(
            held, sensors_of(*KINDS), sample_time=STEP, load=known, prediction=prediction
        )
        last = watched(estimator, nodes, 150)[-1]
        off[known] = farthest(last.nodes, nodes)
    assert off[False] > 2e-3
    assert off[True] < 1e-6
    T = estimator.plant.basis
    found, wanted = (T.T @ each.ravel(order="F") for each in (last.load, load))
    assert np.linalg.norm(found - wanted) < 0.1 * np.linalg.norm(wanted)


def test_a_small_load_is_found_as_it_is(held, sensors_of):
    nodes, load = pulled(held, 0.02)
    estimator = tc.KalmanFilter(held, sensors_of(*KINDS), sample_time=STEP, load=True)
    last = watched(estimator, nodes, 200)[-1]
    T = estimator.plant.basis
    found, wanted = (T.T @ each.ravel(order="F") for each in (last.load, load))
    assert np.linalg.norm(found - wanted) < 2e-3 * np.linalg.norm(wanted)
    assert np.abs(last.load.sum(axis=1)).max() < 1e-9  # nothing moves as one body


def test_noise_leaves_no_bias_either(held, sensors_of):
    nodes, _ = pulled(held, 2.0)
    shift = {}
    for known in (False, True):
        estimator = tc.KalmanFilter(held, sensors_of(*KINDS), sample_time=STEP, load=known)
        found = watched(estimator, nodes, 400, np.random.default_rng(4))[100:]
        mean = np.mean([each.nodes for each in found], axis=0)
        shift[known] = np.abs((mean - nodes) / found[-1].node_deviation).max()
    # In 300 samples, alike for some tens, an error of mean 0 averages to a fraction.
    assert shift[True] < 0.6
    assert shift[False] > 2.0


@pytest.mark.parametrize(
    "kinds",
    [("string_length",), ("bar_direction",), ("node_position",), KINDS,
     ("string_length", "string_tension")],
)  # fmt: skip
def test_it_is_refused_exactly_where_the_test_of_hautus_fails_at_zero(held, sensors_of, kinds):
    sensors = sensors_of(*kinds)
    known = tc.KalmanFilter(held, sensors, sample_time=STEP)
    A, C = known.plant.A, known.C / sensors.noise[:, None]
    r = len(A) // 2
    top = np.hstack([A, np.vstack([np.zeros((r, r)), np.eye(r)])])
    whole = np.vstack([top, np.hstack([C, np.zeros((len(C), r))])])
    lost = 3 * r - np.linalg.matrix_rank(whole, tol=1e-8 * np.linalg.norm(whole, 2))
    if not lost:
        assert tc.KalmanFilter(held, sensors, sample_time=STEP, load=True).riccati_residual < 1e-8
        return
    message = rf"load: {lost} of the {r} directions of a load .*Measure in addition .*node_position"
    with pytest.raises(ValueError, match=message):
        tc.KalmanFilter(held, sensors, sample_time=STEP, load=True)


def test_a_mechanism_that_changes_no_length_is_such_a_case(held, sensors_of):
    with pytest.raises(ValueError, match="load: 1 of the 9 directions"):
        tc.KalmanFilter(held, sensors_of("string_length"), sample_time=STEP, load=True)


@pytest.mark.parametrize("options", [{}, {"load": True, "prediction": "nonlinear"}])
def test_a_pickled_filter_is_a_new_one(held, sensors_of, options):
    sensors = sensors_of(*KINDS, delay=1)
    used, new = (tc.KalmanFilter(held, sensors, sample_time=STEP, **options) for _ in range(2))
    watched(used, held.nodes, 5, np.random.default_rng(0))
    loaded = pickle.loads(pickle.dumps(used))
    assert not loaded.statistics.status_count
    for one, other in zip(
        *(watched(each, held.nodes, 5, np.random.default_rng(1)) for each in (loaded, new)),
        strict=True,
    ):
        assert np.array_equal(one.state, other.state)
        assert np.array_equal(one.covariance, other.covariance)


def test_no_load_is_told_where_none_is_estimated(held, sensors_of):
    estimator = tc.KalmanFilter(held, sensors_of(*KINDS), sample_time=STEP)
    assert estimator.update(None).load is None
    assert repr(tc.KalmanFilter(held, sensors_of(*KINDS), sample_time=STEP, load=True)).startswith(
        "KalmanFilter(36 states, "
    )
