"""A small part of ``python -m tests.fuzz.kills``."""

from pathlib import Path

import pytest

from tenscontrol.dynamics.machine_code import compiler
from tests.fuzz.kills import kill


@pytest.mark.skipif(
    compiler() is None or not Path("/proc/self/environ").exists(),
    reason="it kills compilers, and finds processes in /proc",
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forks
def test_kills_lose_nothing_and_leave_nothing():
    done, _, wrong = kill(3)
    assert wrong == []
    assert sum(done.values()) == 3
