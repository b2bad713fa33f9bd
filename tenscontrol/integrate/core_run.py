"""A span of a motion in the compiled core, called in parts that leave time for signals."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.core import records
from tenscontrol.integrate.core_scene import CoreMotion, CoreScene
from tenscontrol.integrate.integrator import (
    AdvancedSpans,
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

# Steps in the first call, or so many numbers in their states if that is more, seconds that a call
# should take at most, and steps at most: calls that end early, as memory is full, let them grow.
_FIRST, _FIRST_NUMBERS, _LONGEST, _MOST_STEPS = 64, 20_000, 0.05, 10**9

# Steps in a call over several spans, at most.
_MOST_TRIES = 2048

# Ends of steps that are kept at most, and the numbers that they may have, if that is less.
_MOST_ENDS, _MOST_NUMBERS = 4096, 8_000_000

# The methods in the order of the core's own numbers for them.
_METHODS = ("rk4", "dop853", "rk4_plain")

_PROGRESS = np.dtype(records.Progress)


def settings_of(
    method: str,
    duration: float,
    outputs: int,
    project: bool,
    step: float = 0.0,
    limit: float = float("inf"),
    room: int = 0,
    traces: bool = False,
    within: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> records.Settings:
    """Return the settings of a span for the core, with what is allowed within a step of dop853."""
    return records.Settings(
        _METHODS.index(method), project, traces, outputs, 0, room, duration, step, 0.0, limit,
        *within, None,
    )  # fmt: skip


def room_for(states: int) -> int:
    """Return how many ends of steps are kept at most in a call, an even number."""
    return 2 * min(max(_MOST_NUMBERS // (2 * states), 32), _MOST_ENDS // 2)


def reached(motion: CoreMotion, work: Work) -> Span:
    """Return the outputs so far of a motion, with what they have cost."""
    whole, ends = motion.whole, motion.ends
    if not motion.is_over:  # what follows has memory of its own: give back what is left of this
        whole = whole.copy()
    return Span(whole[:, 1:], work, whole, StepEnds(*ends) if ends else None)


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
    progress, budget = motion.progress, max(_FIRST, _FIRST_NUMBERS // (len(motion.state) + 1))
    try:
        while True:
            check()
            began = perf_counter()
            is_over = motion.advance(budget)
            taken = perf_counter() - began
            if progress.stuck:
                raise failure(motion)
            if report is not None:
                report(progress.time)
            if is_over:
                return reached(motion, work_of(progress))
            if motion.is_paused:
                so_far = reached(motion, work_of(progress))
                raise IntegrationPause(progress.time, motion.state, so_far)
            budget = int(min(max(budget * _LONGEST / (taken + 1e-9), 1), 8 * budget, _MOST_STEPS))
    except KeyboardInterrupt:
        so_far = reached(motion, work_of(progress))
        raise IntegrationInterrupt(progress.time, so_far) from None


def spans_in_core(
    scene: CoreScene,
    state: FloatArray,
    given: SpanInputs,
    settings: records.Settings,
    work_of: Callable[[records.Progress, int], Work],
    steps: records.Spans | None = None,
) -> AdvancedSpans:
    """Return spans that one call of the core finishes, up to the first that needs another look.

    To the bits of what :func:`advance_in_core` makes of them one by one.

    Parameters
    ----------
    scene : CoreScene
    state : ndarray, shape (states,)
    given : SpanInputs
    settings : Settings
    work_of : callable
        What so many first spans have cost, by the sum of their counts.
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
    progress: Any = (records.Progress * count)()
    memory = np.empty(int(numbers[count - 1]))
    room = settings.room
    ends = [np.empty(shape) for shape in (room, (room, n), (room, scene.switches))]
    at = ctypes.byref
    done = scene.core.tc_advance_spans(
        scene.at, at(scene.drive(held[0])), scene.lengths_at, at(settings), at(spans),
        at(progress), *records.pointers(
            state.copy(), memory, *ends, np.empty(scene.work_size + 3 * n + scene.switches)
        ),
    )  # fmt: skip
    counts = np.frombuffer(progress, _PROGRESS, done)
    until = memory[: int(numbers[done - 1]) if done else 0]
    if not validation.is_bounded(until):
        bad = np.flatnonzero(~(np.abs(until) <= validation.LARGEST))[0]
        counts = counts[: int(np.searchsorted(numbers, bad, "right"))]
    kept = counts["kept"].cumsum()
    some = kept[-1] if len(kept) else 0
    time, states, taut = (array[:some].copy() for array in ends)
    first, begin, whole, of_steps = 0, 0, list[FloatArray](), list[StepEnds]()
    for end, last in zip(kept.tolist(), numbers.tolist(), strict=False):
        whole.append(memory[first:last].reshape(n, -1))
        pulled = taut[begin:end].T if settings.traces else None
        of_steps.append(StepEnds(time[begin:end], states[begin:end].T, pulled))
        first, begin = last, end
    total = records.Progress(**{name: int(counts[name].sum()) for name in records.COUNTED})
    return AdvancedSpans(whole, of_steps, work_of(total, len(whole)))
