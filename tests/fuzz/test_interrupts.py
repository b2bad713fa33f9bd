"""A few interrupts of the campaign; all of it: ``python -m tests.fuzz.interrupts``."""

import os

import pytest

from tests.fuzz.interrupts import campaign

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


def test_a_few_interrupts_lose_nothing(capfd):
    failures, _ = campaign(6, seed=1, commands=False)
    assert failures == []
