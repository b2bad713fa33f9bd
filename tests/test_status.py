"""Statuses have the same numbers in Python and in C."""

import re
from importlib.resources import files

from tenscontrol.deploy.code_text import status_and_fallback
from tenscontrol.status import Status


def test_the_active_set_method_returns_statuses_by_their_numbers():
    text = (files("tenscontrol") / "core" / "active_set.h").read_text(encoding="utf-8")
    numbers = dict(re.findall(r"#define ACTIVE_SET_(\w+) (\d+)\b", text))
    found = {name: int(n) for name, n in numbers.items() if name in Status.__members__}
    assert len(found) == 6
    assert found == {name: list(Status).index(Status[name]) for name in found}


def test_numbers_of_statuses_stay_below_those_of_fallbacks():
    for number, status in enumerate(Status):
        assert status_and_fallback(number) == (status, None)
