"""Runs of a sample, integrated again side by side."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from typing import final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.integrate.core_lanes import AdaptiveLanes, FixedStepLanes
from tenscontrol.integrate.integrator import Span, Work
from tenscontrol.properties import cached_property
from tenscontrol.simulation.batch.compiled_loop import CompiledLoops
from tenscontrol.simulation.error_estimate import Resolved


class Sample:
    """Runs in fixed steps that are all asked for from their starts, in the same other steps.

    Parameters
    ----------
    lanes : FixedStepLanes
        What integrated the runs.
    runs : ndarray of int
        Their numbers.
    states, held : ndarray, shape (runs, states) and (runs or 1, inputs)
        What they begin with.
    alone : callable
        ``(run, value) -> Resolved``: what integrates one of them by itself.
    stop : ctypes.c_int
        All end once it is not 0.
    """

    def __init__(
        self, lanes: FixedStepLanes, runs: IntArray, states: FloatArray, held: FloatArray,
        alone: Callable[[int, float], Resolved], stop: ctypes.c_int,
    ) -> None:  # fmt: skip
        self._lanes, self._runs, self._states, self._held = lanes, runs, states, held
        self.alone, self._stop = alone, stop
        self._spans: dict[tuple[float, float, int], list[Span | None]] = {}

    def span(self, run: int, step: float, duration: float, outputs: int) -> Span | None:
        """Return a run over a span from its start; None if it did not reach the end."""
        key = step, duration, outputs
        if key not in self._spans:
            self._spans[key] = self._integrated(*key)
        return self._spans[key][int(np.searchsorted(self._runs, run))]

    def _integrated(self, step: float, duration: float, outputs: int) -> list[Span | None]:
        lanes = self._lanes.of_step(step)
        spans = lanes.advance(self._runs, self._states, self._held, duration, outputs, self._stop)
        return [
            Span(states.T, lanes.work_of(counts)) if reaches_end else None
            for states, counts, reaches_end in zip(
                spans.states, spans.counts, spans.reaches_end, strict=True
            )
        ]


@final
class SampledRun:
    """One of the runs of a sample; see :class:`Resolved`.

    What goes on from its first span is integrated by itself, from the start: integrators remember.
    """

    def __init__(self, sample: Sample, run: int, step: float) -> None:
        self._sample, self._run, self._step = sample, run, step
        self._first: tuple[FloatArray, FloatArray, float, int] | None = None
        self._alone: Resolved | None = None

    def shorten(self) -> None:
        """See :meth:`Resolved.shorten`: steps are fixed."""

    def advance(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int, /
    ) -> Span:
        """See :meth:`Resolved.advance`; the first span is from the start of the run."""
        if self._first is None:
            self._first = state, held, duration, outputs
            span = self._sample.span(self._run, self._step, duration, outputs)
            if span is not None:
                return span
            self._alone = self._sample.alone(self._run, self._step)
        elif self._alone is None:
            self._alone = self._sample.alone(self._run, self._step)
            self._alone.advance(*self._first)
        return self._alone.advance(state, held, duration, outputs)


@final
class TightenedRuns:
    """Runs by a tolerance, all at once by another one; see :class:`Resolved`.

    States have shape (runs, states, outputs), and are NaN from the span on that a run does not
    come to the end of; inputs are one a row.

    Parameters
    ----------
    lanes : AdaptiveLanes
        What integrated the runs.
    runs : ndarray of int
        Their numbers, ascending.
    loops : CompiledLoops, optional
        Controllers that begin anew, in place of the commands of each span.
    stop : ctypes.c_int
        All end once it is not 0.
    value : float
        Tolerance.
    """

    def __init__(
        self, lanes: AdaptiveLanes, runs: IntArray, loops: CompiledLoops | None,
        stop: ctypes.c_int, value: float,
    ) -> None:  # fmt: skip
        self._runs, self._loops, self._stop = runs, loops, stop
        self._time = 0.0
        self._make = partial(lanes.of_tolerance, value)
        self._is_shortened = False

    def shorten(self) -> None:
        """See :meth:`Resolved.shorten`."""
        self._is_shortened = True

    @cached_property
    def _lanes(self) -> AdaptiveLanes:
        return self._make(self._is_shortened).over_spans(
            int(self._runs[0]), int(self._runs[-1]) + 1
        )

    def advance(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int, /
    ) -> Span:
        """See :meth:`Resolved.advance`."""
        going = np.flatnonzero((np.abs(state) <= validation.LARGEST).all(axis=1))
        states = np.full((*state.shape, outputs), np.nan)
        if len(going):
            rows = held[going] if len(held) > 1 else held
            if self._loops is not None:
                commands, _ = self._loops.commands(self._time, state[going], going)
                rows = np.hstack([commands, rows[:, commands.shape[1] :]])
            self._time += duration
            states[going] = self._lanes.advance(
                self._runs[going], state[going], rows, duration, outputs, self._stop
            ).states.transpose(0, 2, 1)
        return Span(states, Work())
