"""Weights that are symmetric but for round-off, limits that are none, and whole floats."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import OutputLimit

PRISM = tc.prism()
REST = tc.prestress(PRISM, 17.3205)
LAW = tc.LinearStrings(100.0)
PLANT = tc.linearize(tc.Model(PRISM), REST)
HELD = tc.linearize(tc.Model(PRISM, LAW), REST, input="rest_length")
INF = np.inf


def command(controller):
    shape, velocities = controller.plant.nodes, controller.plant.coordinates
    rates = 0.3 * np.cos(np.arange(9.0))
    return controller.command(0.0, shape, velocities.to_velocities(np.zeros(9), rates)).value


def mpc(**changes):
    given = {"sample_time": 0.02, "horizon": 5, "max_force_density": 80.0}
    return tc.MPC(PLANT, **(given | changes))


def test_a_weight_may_be_unsymmetric_by_round_off():
    weight = np.diag(np.arange(1.0, 19.0))
    skew = np.triu(np.ones((18, 18)), 1)
    known = tc.LQR(PLANT, Q=weight, R=1.0, sample_time=0.01).gain
    for size in (1e-12, 1e-10):
        gain = tc.LQR(PLANT, Q=weight + 18 * size * skew, R=1.0, sample_time=0.01).gain
        np.testing.assert_allclose(gain, known, rtol=1e-7, atol=1e-7)
    with pytest.raises(ValueError, match="Q is not symmetric"):
        tc.LQR(PLANT, Q=weight + 1e-6 * 18 * skew, R=1.0)


def test_a_diagonal_may_be_a_column():
    diagonal = np.arange(1.0, 19.0)
    np.testing.assert_array_equal(
        tc.LQR(PLANT, Q=diagonal[:, None], R=np.ones((9, 1))).gain,
        tc.LQR(PLANT, Q=diagonal, R=1.0).gain,
    )


@pytest.mark.parametrize("solver", ["auto", "osqp"])
@pytest.mark.parametrize(
    "none",
    [
        {"max_force_density": INF},
        {"max_force_density": [INF] * 8 + [1e6]},
        {"max_change": INF},
        {"max_change": [INF] * 9},
        {"max_tension": INF},
        {"max_tension": [[INF]] * 9},
        {"time_limit": INF},
        {"outputs": None},
        {"outputs": [OutputLimit(np.zeros((0, 18)))]},
        {"outputs": [OutputLimit(np.ones(18), low=-INF, high=[INF], penalty=INF)]},
    ],
    ids=repr,
)
def test_infinite_limits_of_mpc_are_none(none, solver):
    np.testing.assert_allclose(command(mpc(solver=solver, **none)), command(mpc()), rtol=1e-5)


def test_some_strings_may_have_no_limit_of_change():
    """That of one string is reached, as if those of the others were large."""
    for kind in (tc.MPC, tc.NMPC):
        found = []
        for free in (INF, 1e4):
            given = {"max_change": [0.05] + [free] * 8, "max_force_density": INF}
            law = kind(PLANT, sample_time=0.02, horizon=5, **given)
            found.append(command(law))
        np.testing.assert_allclose(found[0], found[1], rtol=1e-6)
        assert abs(found[0][0] - REST.force_density[0]) == pytest.approx(0.05, rel=1e-6)


def test_infinite_limits_of_plants_with_rest_lengths_are_none():
    known = command(tc.MPC(HELD, sample_time=0.02, horizon=5))
    for none in (
        {"max_force_density": INF},
        {"winches": tc.Winches(rate=INF, shortest=0.0, longest=INF)},
        {"winches": tc.Winches(rate=[INF] * 8 + [1e3])},
    ):
        law = tc.MPC(HELD, sample_time=0.02, horizon=5, **none)
        np.testing.assert_allclose(command(law), known, rtol=1e-6)
    assert tc.LQR(HELD, max_force_density=INF, max_change=INF).largest_change is None


def test_infinite_limits_of_lqr_are_none():
    known = tc.LQR(PLANT, sample_time=0.02)
    for given in ({"max_force_density": INF}, {"max_change": INF}, {"max_change": [INF] * 9}):
        law = tc.LQR(PLANT, sample_time=0.02, **given)
        np.testing.assert_array_equal(command(law), command(known))
        np.testing.assert_array_equal(law.bounds[1], np.full(9, INF))
    tc.LQR(PLANT, max_change=INF)  # in continuous time


def test_feedback_linearization_may_have_no_largest_force_density():
    given = {"sample_time": 0.01, "frequency": 1.0}
    known = command(tc.FeedbackLinearization(PLANT, max_force_density=1e6, **given))
    law = tc.FeedbackLinearization(PLANT, max_force_density=INF, max_change=INF, **given)
    np.testing.assert_allclose(command(law), known, rtol=1e-6)


def test_infinite_limits_of_functions_are_none():
    law = tc.FunctionController(
        PRISM, lambda *_: REST.force_density, input="force_density", high=INF, max_change=INF
    )
    assert law.largest_change is None
    np.testing.assert_array_equal(law.bounds[1], np.full(9, INF))


def test_other_limits_are_still_refused():
    for wrong in (np.nan, -INF, 0.0, [INF] * 8):
        with pytest.raises(ValueError, match="max_force_density"):
            mpc(max_force_density=wrong)
        with pytest.raises(ValueError, match="max_change"):
            mpc(max_change=wrong)


def test_counts_may_be_whole_floats_and_integers_of_numpy():
    for whole in (5.0, np.float64(5), np.int32(5), np.array(5)):
        law = mpc(horizon=whole, max_iterations=50.0)
        assert law.horizon == 5
        assert type(law.horizon) is int
    with pytest.raises(TypeError, match=r"horizon is 5\.5, expected a whole number"):
        mpc(horizon=5.5)


def test_less_than_two_bars_have_no_clearance_to_keep():
    net = tc.net(3, 3, spacing=0.1, node_mass=0.1)
    plant = tc.linearize(tc.Model(net), tc.prestress(net, 10.0))
    assert tc.clearance(plant, 0.1).matrix.shape == (0, 27)
