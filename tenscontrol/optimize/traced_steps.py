"""Steps of a run that was traced: where each begins, how long it is, what pulls in it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.equation import InputLayout
from tenscontrol.simulation.plant_run import PlantRun


@dataclass(frozen=True, eq=False)
class TracedSteps:
    """The K steps of a run, one after the other.

    Attributes
    ----------
    begin, length : ndarray, shape (K,)
        s.
    span : ndarray of int, shape (K,)
        The span of the run that each is in; inputs are one polynomial in a span.
    states : ndarray, shape (states, K + 1)
        x at the beginning of each step, and at the end of the last.
    inputs : ndarray, shape (inputs, K)
        u as the equation takes it from the beginning of each step on.
    taut : ndarray, shape (switches, K)
    projects : bool
        Whether bars are put on their lengths after each step.
    method : {"rk4", "dop853"}
    layout : InputLayout
    """

    begin: FloatArray
    length: FloatArray
    span: IntArray
    states: FloatArray
    inputs: FloatArray
    taut: FloatArray
    projects: bool
    method: str
    layout: InputLayout

    @property
    def end(self) -> float:
        """Time at the end of the last step, s."""
        return float(self.begin[-1] + self.length[-1])

    def step_at(self, times: FloatArray) -> IntArray:
        """Return in which step each of some times is; a time between two is the end of one."""
        last = np.searchsorted(self.begin + 1e-9 * self.length, times) - 1
        return np.asarray(np.clip(last, 0, len(self.begin) - 1))

    @property
    def switched(self) -> FloatArray:
        """What switched at the end of each step, 1, -1 or 0, shape (switches, K)."""
        change = np.zeros_like(self.taut)
        same = self.span[1:] == self.span[:-1]
        change[:, :-1] = np.diff(self.taut, axis=1) * same
        return change


def steps_of(run: PlantRun, load: FloatArray) -> TracedSteps:
    """Return the steps of a run that was traced.

    The inputs have the load on all nodes, N, (d, n), behind those of the strings.
    """
    strings = len(run.model.structure.strings)
    layout = InputLayout(strings, load.size, degree=run.degree)
    begin, length, which, states, inputs, taut = [], [], [], [], [], []
    for i, (before, span) in enumerate(pairwise(run.spans)):
        assert span.ends is not None  # it was traced
        assert span.ends.taut is not None  # so these were kept
        start = float(before.time[-1])
        starts = np.append(0.0, span.ends.time[:-1])
        begin.append(start + starts)
        length.append(np.diff(span.ends.time, prepend=0.0))
        which.append(np.full(len(starts), i))
        states.append(np.column_stack([span.begin, span.ends.states[:, :-1]]))
        taut.append(span.ends.taut)
        rows = span.coefficients
        if len(rows) == strings:
            constant = np.zeros((load.size, rows.shape[1]))
            constant[:, 0] = load.ravel(order="F")
            rows = np.vstack([rows, constant])
        packed = layout.packed(rows, start - span.origin)
        packed = np.repeat(packed[:, None], len(starts), axis=1)
        if layout.degree:
            packed[-1] += starts
        inputs.append(packed)
        last = span.ends.states[:, -1:]
    method = run.methods[-1]
    how = run.integration
    projects = method == "dop853" if how.project is None else how.project
    return TracedSteps(
        np.concatenate(begin), np.concatenate(length), np.concatenate(which),
        np.hstack([*states, last]), np.hstack(inputs), np.hstack(taut), projects, method, layout,
    )  # fmt: skip
