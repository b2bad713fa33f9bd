"""How runs are judged and counted."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benchmarks.trust import Run, judged_run, mapped, row
from tests.located_motion import c_compiler
from tests.random_scenes import random_scene
from tests.references import Reference, reference

RIGHT = Run(
    0, "rk4", "", "ok", whole=True, error=(1e-6, 1e-5), estimate=(2e-5,),
    clear=(True, True), trusted=(False, False),
)  # fmt: skip
OFF = replace(RIGHT, error=(1e-4, 0.05))


def counts(*runs):
    """Runs judged, stopped, silent, early, caught, false and low."""
    words = row("", runs).replace("%", "").split()
    return [int(words[k]) for k in (0, 1, 2, 4, 5, 6, 8)]


@pytest.mark.parametrize(
    ("run", "expected"),
    [
        (RIGHT, [1, 0, 0, 0, 0, 0, 0]),
        (replace(RIGHT, warned=True), [1, 0, 0, 0, 0, 1, 0]),
        (replace(RIGHT, estimate=(1e-6,)), [1, 0, 0, 0, 0, 0, 1]),
        (replace(RIGHT, estimate=()), [1, 0, 0, 0, 0, 0, 1]),
        (replace(RIGHT, estimate=(), clear=(True, False)), [1, 0, 0, 0, 0, 0, 0]),
        (OFF, [1, 0, 1, 0, 0, 0, 1]),
        (replace(OFF, estimate=(1e-4, 0.1), warned=True), [1, 0, 0, 0, 1, 0, 0]),
        (replace(OFF, warned=True, trusted=(True, True)), [1, 0, 0, 1, 1, 0, 1]),
        (replace(OFF, error=(0.05, 1e-5), trusted=(True, False)), [1, 0, 1, 0, 0, 0, 0]),
        (Run(0, "rk4", "", "stopped", warned=True), [0, 1, 0, 0, 0, 0, 0]),
    ],
)
def test_a_run_is_counted(run, expected):
    assert counts(run) == expected


@pytest.mark.skipif(c_compiler() is None, reason="there is no C compiler")
def test_a_wrong_reference_makes_a_run_wrong(tmp_path):
    scene = random_scene(48)
    found = reference(scene, tmp_path)
    right = judged_run(scene, found, "dop853", "", {"method": "dop853"}, 60.0)
    assert right.is_judged
    assert not right.is_wrong
    assert max(right.error) < 1e-4
    moved = Reference(**{**vars(found), "nodes": found.nodes + 0.02 * scene.size})
    wrong = judged_run(scene, moved, "dop853", "", {"method": "dop853"}, 60.0)
    assert wrong.is_wrong
    assert np.allclose(wrong.error, 0.02, atol=1e-3)


def test_an_interruption_ends_with_what_is_done():
    def task(number):
        if number == 3:
            raise KeyboardInterrupt
        return number

    assert list(mapped(task, range(6), 1, "tasks")) == [0, 1, 2]
