"""A small part of ``python -m tests.fuzz.sweep_files``."""

from tests.fuzz.sweep_files import spoil


def test_spoilt_sweep_files_are_refused_or_read_to_the_same_numbers():
    ends, wrong = spoil(60)
    assert wrong == []
    assert sum(ends.values()) == 120
