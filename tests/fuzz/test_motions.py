"""A small part of the campaign over odd calls of ``optimal_motion``; see ``motions.py``."""

from tests.fuzz import motions
from tests.fuzz.arguments import OUTCOMES


def test_odd_calls_are_planned_or_refused_by_name():
    found = [(number, *motions.outcome_of(number, scenes=("arm",))) for number in range(5, 12)]
    assert [each for each in found if each[1] not in OUTCOMES[:2]] == []
    assert {outcome for _, outcome, _ in found} == {"fine", "clear error"}
