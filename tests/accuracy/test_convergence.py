"""Orders are those of the methods, also through slack/taut switches."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.accuracy.scenes import paper_case

STEPS = [0.01, 0.005, 0.0025, 0.00125]


@pytest.mark.parametrize(
    ("method", "low", "high"), [("rk4", 3.7, 4.3), ("energy_momentum", 1.8, 2.2)]
)
def test_order_through_switches(method, low, high):
    found = tc.convergence_order(paper_case(0.5), method, STEPS, outputs=10)
    assert found.switches > 3
    assert low < found.order < high
    assert found.deviation < 0.3
    assert found.is_clean.all()
    assert f"{method}: order {found.order:.2f}" in found.table()


def test_the_fit_is_the_line_through_the_logarithms():
    found = tc.convergence_order(paper_case(0.5, vertical=45.0), "rk4", STEPS, outputs=10)
    slope, level = np.polyfit(np.log(found.step), np.log(found.error), 1)
    assert found.order == pytest.approx(slope)
    assert found.constant == pytest.approx(np.exp(level))
    np.testing.assert_allclose(found.step, STEPS)


def test_runs_at_round_off_and_too_coarse_are_not_fitted():
    steps = [0.1, *STEPS, 1e-3 / 32, 1e-3 / 128]
    case = paper_case(0.5, vertical=45.0)
    found = tc.convergence_order(case, "rk4", steps, outputs=5)
    assert not found.is_clean[-1]
    assert found.is_clean[2:5].all()
    # Fitted with them, it would be another.
    assert abs(np.polyfit(np.log(found.step), np.log(found.error), 1)[0] - 4) > 0.3
    assert 3.7 < found.order < 4.3


def test_too_few_clean_runs_give_no_order():
    found = tc.convergence_order(paper_case(0.2), "rk4", [0.01, 0.005], outputs=4)
    assert np.isnan(found.order)
    assert "no order, as fewer than 3 runs are clean" in found.table()


def test_a_method_with_own_steps_is_judged_by_their_mean():
    case = paper_case(0.5, vertical=45.0)
    found = tc.convergence_order(case, "dop853", [1e-4, 1e-6, 1e-8, 1e-10], outputs=4)
    assert 6 < found.order < 11
    assert (np.diff(found.step) < 0).all()
