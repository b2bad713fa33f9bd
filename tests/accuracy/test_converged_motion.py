"""The reference against an independent model, and how long anything can be compared."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy.converged_motion import PiecewiseSolver
from tests.accuracy.scenes import paper_case, slack_skin_case
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength


def test_example_one_agrees_with_rigid_bodies_through_all_switches(paper_motion):
    """Five seconds, 56 moments of switching; both have errors of some 1e-12 m."""
    found = tc.accuracy.converged_motion(paper_case(5.0), outputs=100)
    true = paper_motion.nodes[:, :, 50::50]
    np.testing.assert_allclose(found.time, paper_motion.time[50::50], rtol=1e-14)
    assert np.abs(found.nodes - true).max() < 5e-11
    assert 1e-14 < found.error < 5e-11
    moments = paper_motion.switches[np.diff(paper_motion.switches, prepend=-1) > 1e-8]
    np.testing.assert_allclose(found.switches, moments, atol=1e-9)


def test_damped_strings_agree_with_rigid_bodies():
    case = paper_case(1.0, damping=0.3)
    found = tc.accuracy.converged_motion(case, outputs=20)
    law = HeldRestLength(case.input_value, 100.0, 0.3)
    nodes, _ = exact_motion(case.structure, law, np.r_[0.0, found.time])
    assert len(found.switches) > 0
    assert np.abs(found.nodes - nodes[:, :, 1:]).max() < 1e-10
    assert found.error < 1e-10


def test_strings_that_chatter_are_refused(monkeypatch):
    case = paper_case(1.0)
    solver = PiecewiseSolver(case)
    gaps = iter([1.0, -1.0] * 100_000)
    monkeypatch.setattr(PiecewiseSolver, "_gaps", lambda self, state: np.full(9, next(gaps)))
    monkeypatch.setattr(PiecewiseSolver, "_comes_near", lambda *_: True)
    monkeypatch.setattr(PiecewiseSolver, "_crosses", lambda *_: True)
    monkeypatch.setattr(
        PiecewiseSolver, "_first_crossing", lambda self, between, start, *_: start + 1e-15
    )
    with pytest.raises(ArithmeticError, match="strings or contacts switch without end at"):
        list(solver.states(np.array([1.0]), 1e-10))


def test_growth_in_example_one():
    """A random 1e-10 m becomes about 1e-6 m in five seconds, as two formulations showed."""
    found = tc.predictability(paper_case(5.0))
    assert 1e3 < found.factor < 1e5
    assert not found.is_limited
    assert found.horizon == 5.0
    assert "compared" not in found.summary()
    assert (np.diff(found.growth) >= 0).all()


def test_no_growth_to_speak_of_without_slack():
    assert tc.predictability(paper_case(2.0, vertical=45.0)).factor < 50


def test_a_slack_skin_is_chaotic():
    """Two double-precision codes part at about 1.3 s: the comparison must end near there."""
    case = slack_skin_case(3.0)
    found = tc.predictability(case)
    assert found.is_limited
    assert 1.0 < found.horizon < 1.8
    assert found.rate > 5
    assert f"compared up to {found.horizon:g} s" not in found.summary()
    assert f"beyond {found.horizon:g} s round-off alone" in found.summary()
    # A coarser error can be asked for longer.
    assert tc.predictability(case, error=1e-7).horizon > found.horizon + 0.1
    # Up to the horizon the two codes of the reference agree to about the error asked for.
    assert tc.accuracy.converged_motion(replace(case, duration=found.horizon), 20).error < 1e-8


def test_the_comparison_of_a_chaotic_motion_is_cut_short():
    found = tc.work_precision(
        slack_skin_case(3.0), ["dop853"], {"dop853": [1e-6]}, repeats=1, outputs=20
    )
    assert found.case.duration == found.predictability.horizon < 1.8
    assert "round-off alone makes errors of 1e-09 m" in found.table()
    (row,) = found.rows
    assert row.error < 1e-2


@pytest.mark.parametrize(
    ("options", "message"),
    [({"error": -1.0}, "error is -1.0"), ({"samples": 0}, "samples is 0"), ({"seed": -1}, "seed")],
)
def test_bad_input(options, message):
    with pytest.raises(ValueError, match=message):
        tc.predictability(paper_case(0.1), **options)
