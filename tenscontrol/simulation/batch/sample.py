"""Runs of a sample, integrated again side by side."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import final

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.integrate.core_lanes import AdaptiveLanes, CoreLanes, FixedStepLanes
from tenscontrol.integrate.integrator import Span
from tenscontrol.simulation.error_estimate import Resolved


class Sample:
    """Runs that are all asked for from their starts, with the same steps or tolerances.

    Parameters
    ----------
    lanes : CoreLanes
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
        self, lanes: CoreLanes, runs: IntArray, states: FloatArray, held: FloatArray,
        alone: Callable[[int, float], Resolved], stop: ctypes.c_int,
    ) -> None:  # fmt: skip
        self._lanes, self._runs, self._states, self._held = lanes, runs, states, held
        self.alone, self._stop = alone, stop
        self._spans: dict[tuple[float, bool, float, int], list[Span | None]] = {}

    def span(
        self, run: int, value: float, is_shortened: bool, duration: float, outputs: int
    ) -> Span | None:
        """Return a run over a span from its start; None if it did not reach the end."""
        key = value, is_shortened, duration, outputs
        if key not in self._spans:
            self._spans[key] = self._integrated(*key)
        return self._spans[key][int(np.searchsorted(self._runs, run))]

    def _integrated(
        self, value: float, is_shortened: bool, duration: float, outputs: int
    ) -> list[Span | None]:
        lanes: CoreLanes = self._lanes
        if isinstance(lanes, AdaptiveLanes):
            lanes = lanes.of_tolerance(value, is_shortened)
        elif isinstance(lanes, FixedStepLanes):
            lanes = lanes.of_step(value)
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

    def __init__(self, sample: Sample, run: int, value: float) -> None:
        self._sample, self._run, self._value = sample, run, value
        self._is_shortened = False
        self._first: tuple[FloatArray, FloatArray, float, int] | None = None
        self._alone: Resolved | None = None

    def shorten(self) -> None:
        """See :meth:`Resolved.shorten`."""
        self._is_shortened = True

    def advance(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int, /
    ) -> Span:
        """See :meth:`Resolved.advance`; the first span is from the start of the run."""
        if self._first is None:
            self._first = state, held, duration, outputs
            span = self._sample.span(self._run, self._value, self._is_shortened, duration, outputs)
            if span is not None:
                return span
            self._alone = self._by_itself()
        elif self._alone is None:
            self._alone = self._by_itself()
            self._alone.advance(*self._first)
        return self._alone.advance(state, held, duration, outputs)

    def _by_itself(self) -> Resolved:
        integrator = self._sample.alone(self._run, self._value)
        if self._is_shortened:
            integrator.shorten()
        return integrator
