"""The fuzzer: every public name has a valid call to be spoilt, and outcomes are told apart."""

import inspect

import numpy as np
import pytest

import tenscontrol as tc
from tests.fuzz import arguments
from tests.fuzz.valid_calls import ABSTRACT, CALLS, RESULTS, WITHIN, Call
from tests.public import members, public

# Keys of calls that ended otherwise than they should.
FOUND = (
    "Structure, any class|nodes||twice", "Model.symbolic|parameters||array complex",
    "Sensors, of a robot|gravity||1e-300", "KalmanFilter.smooth|previous|(6,)|error",
    "Scene.linearize|input||array (3, 6) zeros", "plot.structure, run|faint||array masked",
    "design|min_force_density||1e-300", "LQR|max_change||longdouble",
    "learning.Rolling|direction||1e-15", "prestress|min_force_density||100",
    "Log.of_run|times||empty list",
    "Structure|bars|(2, 0)|1",
    "Structure, any class|strings||empty tuple",
    "prestress, bounds|force_density||uint64",
    "Scene|input||array 3-D",
)  # fmt: skip


def test_no_public_name_lacks_a_valid_call():
    called = {name.split(",")[0] for name in CALLS}
    methods = {
        name
        for name, (_, member) in members().items()
        if inspect.isfunction(member) or isinstance(member, classmethod | staticmethod)
    }
    assert set(public()) - called == RESULTS | ABSTRACT
    assert methods - called == WITHIN
    assert called <= set(public()) | methods


def test_outcomes_are_told_apart(monkeypatch):
    def told(function, **given):
        call = Call("modes", lambda: function, lambda: {"plant": 1.0} | given)
        monkeypatch.setitem(CALLS, "modes", call)
        return arguments.outcome_of("modes|plant||None")[0]

    assert told(lambda plant: None) == "fine"
    assert told(tc.modes) == "clear error"
    assert told(lambda plant: np.exp([1e3]).size) == "traceback from within"
    assert told(lambda plant: {"a": [np.full(2, np.inf)]}) == "not finite"
    assert told(lambda plant: plant.A) == "traceback from within"
    assert told(lambda plant: tc.prism(sides=0)) == "error without the name"


def test_bounds_may_be_infinite_but_not_nan():
    found = [arguments.not_finite({"high": x}, "", set()) for x in (np.inf, np.full(2, np.inf))]
    assert found == ["", ""]
    assert arguments.not_finite({"high": np.array([1.0, np.nan])}, "", set())
    assert arguments.not_finite({"mean": np.inf}, "", set())


@pytest.mark.parametrize("key", FOUND)
def test_what_a_longer_campaign_found_is_mended(key):
    assert arguments.outcome_of(key)[0] in arguments.OUTCOMES[:2]


def test_no_argument_reaches_what_does_not_check_it():
    finds = arguments.run(120, seed=0, least_share=1.0)
    assert len(finds) >= 120
    wrong = [find[:3] for find in finds if find[1] in arguments.OUTCOMES[3:]]
    assert wrong == []
    errors = [outcome for _, outcome, *_ in finds if outcome in arguments.OUTCOMES[1:3]]
    assert errors.count("clear error") >= 0.99 * len(errors)
