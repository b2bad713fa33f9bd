"""Steps of a run that was traced: where each begins, how long it is, what pulls in it."""

from __future__ import annotations

from dataclasses import dataclass

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
    spans = run.spans[1:]
    ends = [span.ends for span in spans if span.ends is not None]
    taut = [of_span.taut for of_span in ends if of_span.taut is not None]
    assert len(taut) == len(spans)  # it was traced
    counts = np.array([len(of_span.time) for of_span in ends])
    which = np.repeat(np.arange(len(spans)), counts)
    until, first = np.concatenate([of_span.time for of_span in ends]), np.cumsum(counts) - counts
    within = np.append(0.0, until[:-1])
    within[first] = 0.0
    begins = np.array([before.time[-1] for before in run.spans[:-1]])
    states = np.hstack([spans[0].begin[:, None], *(of_span.states for of_span in ends)])
    states[:, first] = np.stack([span.begin for span in spans], axis=1)
    rows = np.stack([span.coefficients for span in spans])
    if rows.shape[1] == strings:
        constant = np.zeros((len(spans), load.size, rows.shape[2]))
        constant[..., 0] = load.ravel(order="F")
        rows = np.concatenate([rows, constant], axis=1)
    inputs = rows.transpose(2, 1, 0).reshape(-1, len(spans))[:, which]
    if layout.degree:
        origins = np.array([span.origin for span in spans])
        inputs = np.vstack([inputs, (begins - origins)[which] + within])
    method = run.methods[-1]
    how = run.integration
    projects = method == "dop853" if how.project is None else how.project
    return TracedSteps(
        begins[which] + within, until - within, which, states, inputs,
        np.hstack(taut), projects, method, layout,
    )  # fmt: skip
