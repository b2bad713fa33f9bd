"""A span of a motion in the compiled core, called in parts that leave time for signals."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from time import perf_counter

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.core import records
from tenscontrol.integrate.core_scene import CoreMotion, CoreScene
from tenscontrol.integrate.integrator import (
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Report,
    Span,
    SpanInputs,
    StepEnds,
    Work,
)
from tenscontrol.interrupt import check

# Steps in the first call, and seconds that a call should take at most.
_FIRST, _LONGEST = 64, 0.05

# Steps in a call over several spans, at most.
_MOST_TRIES = 2048

# Ends of steps that are kept at most, and the numbers that they may have, if that is less.
_MOST_ENDS, _MOST_NUMBERS = 4096, 8_000_000

# The methods in the order of the core's own numbers for them.
_METHODS = ("rk4", "dop853", "rk4_plain")


def settings_of(
    method: str,
    duration: float,
    outputs: int,
    project: bool,
    step: float = 0.0,
    limit: float = float("inf"),
    room: int = 0,
    traces: bool = False,
    smooth: float = 0.0,
) -> records.Settings:
    """Return the settings of a span for the core."""
    return records.Settings(
        _METHODS.index(method), project, traces, outputs, 0, room, duration, step, 0.0, limit,
        smooth, None,
    )  # fmt: skip


def room_for(states: int) -> int:
    """Return how many ends of steps are kept at most in a call, an even number."""
    return 2 * min(max(_MOST_NUMBERS // (2 * states), 32), _MOST_ENDS // 2)


def reached(motion: CoreMotion, work: Work) -> Span:
    """Return the outputs so far of a motion, with what they have cost."""
    whole = motion.whole
    if not motion.is_over:  # what follows has memory of its own: give back what is left of this
        whole = whole.copy()
    # Of the room for ends of steps most is left as a rule.
    ends = [array.copy(order="A") for array in motion.ends]
    return Span(whole[:, 1:], work, whole, StepEnds(*ends))


def advance_in_core(
    motion: CoreMotion,
    work_of: Callable[[records.Progress], Work],
    failure: Callable[[CoreMotion], IntegrationError],
    report: Report | None,
) -> Span:
    """Return the states at the outputs of a motion; see :meth:`Integrator.advance`.

    Parameters
    ----------
    motion : CoreMotion
    work_of : callable
        What the motion has cost so far.
    failure : callable
        The error of a motion that cannot go on.
    report : callable, optional
        Told the time reached.
    """
    progress, budget = motion.progress, _FIRST

    def span() -> Span:
        return reached(motion, work_of(progress))

    try:
        is_over = motion.is_over
        while not is_over:
            check()
            began = perf_counter()
            budget = min(budget, motion.most_steps)
            motion.advance(budget)
            taken = perf_counter() - began
            if progress.stuck:
                raise failure(motion)
            if report is not None:
                report(progress.time)
            is_over = motion.is_over
            if not is_over and motion.is_paused:
                raise IntegrationPause(progress.time, motion.state, span())
            budget = int(min(max(budget * _LONGEST / (taken + 1e-9), 1), 8 * budget))
        return span()
    except KeyboardInterrupt:
        raise IntegrationInterrupt(progress.time, span()) from None


def spans_in_core(
    scene: CoreScene,
    state: FloatArray,
    given: SpanInputs,
    settings: records.Settings,
    work_of: Callable[[records.Progress, float], Work],
    steps: records.Spans | None = None,
) -> list[Span]:
    """Return spans that one call of the core finishes, up to the first that needs another look.

    To the bits of what :func:`advance_in_core` makes of them one by one.

    Parameters
    ----------
    scene : CoreScene
    state : ndarray, shape (states,)
    given : SpanInputs
    settings : Settings
    work_of : callable
        What a span of such a duration, s, has cost.
    steps : Spans, optional
        How DOP853 finds its steps.
    """
    n, columns = len(state), given.outputs + 1
    numbers = np.cumsum(n * columns)
    given = given.first(int(np.searchsorted(numbers, max(_MOST_NUMBERS, numbers[0]), "right")))
    settings.budget, count = _MOST_TRIES, len(given.duration)
    spans = records.Spans() if steps is None else steps
    outputs = given.outputs.astype(np.int32)
    held, duration = map(np.ascontiguousarray, (given.held, given.duration))
    spans.count, spans.outputs = count, records.address(outputs)
    spans.inputs, spans.duration = records.address(held), records.address(duration)
    progress = (records.Progress * count)()
    memory = np.empty(int(numbers[count - 1]))
    room = settings.room
    ends = [np.empty(shape) for shape in (room, (room, n), (room, scene.switches))]
    at = ctypes.byref
    done = scene.core.tc_advance_spans(
        at(scene.scene), at(scene.drive(held[0])), at(scene.lengths), at(settings), at(spans),
        at(progress), *records.pointers(
            state.copy(), memory, *ends, np.empty(scene.work_size + 3 * n + scene.switches)
        ),
    )  # fmt: skip
    kept = np.cumsum([0, *(now.kept for now in progress[:done])])
    time, states, taut = (array[: kept[-1]].copy() for array in ends)
    taut_rows = taut if settings.traces else None
    first = int(numbers[done - 1]) if done else 0
    is_good = validation.is_bounded(memory[:first])
    finished, first = [], 0
    for k in range(done):
        size, some = int(n * columns[k]), slice(kept[k], kept[k + 1])
        whole = memory[first : first + size].reshape(n, -1)
        first += size
        if not (is_good or validation.is_bounded(whole)):
            break
        of_steps = None if taut_rows is None else taut_rows[some].T
        step_ends = StepEnds(time[some], states[some].T, of_steps)
        work = work_of(progress[k], float(duration[k]))
        finished.append(Span(whole[:, 1:], work, whole, step_ends))
    return finished
