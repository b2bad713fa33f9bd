"""Steps of a run that was traced: where each begins, how long it is, what pulls in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.equation import InputLayout
from tenscontrol.properties import cached_property
from tenscontrol.simulation.plant_run import Jump, PlantRun


@dataclass(frozen=True, eq=False)
class Push:
    """A jump of the velocity of supports, or of rates of bars, and what it made of the state.

    Rates of driven bars may jump wherever a span begins, even if they do not in this run.

    Attributes
    ----------
    state : ndarray, shape (states,)
        Before it.
    held, pushed : ndarray, shape (inputs,)
        u, and the same with the impulse on the nodes as a load, or with an acceleration of bars.
    jump : ndarray, shape (d n,), or float
        Of the velocities that nodes have with supports, node by node, m/s; 0 where these stand.
    is_first : bool
        Whether it begins the run.
    """

    state: FloatArray
    held: FloatArray
    pushed: FloatArray
    jump: FloatArray | float
    is_first: bool


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
    pushes : mapping of int to Push
        Of spans that begin with one.
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
    pushes: Mapping[int, Push] = field(default_factory=dict)

    def push_at(self, step: int) -> Push | None:
        """Return the push with which a step begins, if it does."""
        if step and self.span[step] == self.span[step - 1]:
            return None
        return self.pushes.get(int(self.span[step]))

    @cached_property
    def pushed_steps(self) -> list[int]:
        """Steps that begin with a push."""
        if not self.pushes:
            return []
        first = np.flatnonzero(np.diff(self.span, prepend=-1)).tolist()
        return [k for k in first if int(self.span[k]) in self.pushes]

    def support_motion(self, inputs: FloatArray, order: int) -> FloatArray:
        """Return E of inputs, one a column, or its derivative of an order, (d n, K)."""
        return self.layout.numbers(inputs, self.layout.offset_rows, order)

    @property
    def end(self) -> float:
        """Time at the end of the last step, s."""
        return float(self.begin[-1] + self.length[-1])

    def step_at(self, times: FloatArray) -> IntArray:
        """Return in which step each of some times is; a time between two is the end of one."""
        last = (self.begin + 1e-9 * self.length).searchsorted(times) - 1
        return np.asarray(np.minimum(np.maximum(last, 0), len(self.begin) - 1))

    @property
    def switched(self) -> tuple[IntArray, IntArray]:
        """Return which steps end at a switch, and what switches there, one entry a switch."""
        before, after = self.taut[:, :-1], self.taut[:, 1:]
        changes = before != after
        if not np.count_nonzero(changes):
            nothing = np.zeros(0, dtype=int)
            return nothing, nothing
        steps = np.flatnonzero(changes.any(axis=0) & (self.span[1:] == self.span[:-1]))
        of, which = np.nonzero((before[:, steps] != after[:, steps]).T)
        return steps[of], which


def steps_of(run: PlantRun, load: FloatArray, start: FloatArray) -> TracedSteps:
    """Return the steps of a run that was traced.

    The inputs have the load on all nodes, N, (d, n), behind those of the strings. ``start`` is the
    state before the run.
    """
    strings = len(run.model.structure.strings)
    bars = 0 if run.bars is None else len(run.model.structure.bars)
    layout = InputLayout(
        strings, load.size, load.size * (run.supports is not None), degree=run.degree, lengths=bars
    )
    spans = run.spans[1:]
    ends = [span.ends for span in spans if span.ends is not None]
    taut = [of_span.taut for of_span in ends if of_span.taut is not None]
    assert len(taut) == len(spans)  # it was traced
    # One step after the other in memory, as they are gone through.
    until, pulled = ends[0].time, taut[0]
    if len(spans) > 1:
        until = np.concatenate([of_span.time for of_span in ends])
        pulled = np.concatenate([of_span.T for of_span in taut]).T
    states = np.concatenate([spans[0].begin[None], *[of_span.states.T for of_span in ends]]).T
    which, within = np.zeros(len(until), dtype=int), np.zeros(len(until))
    within[1:] = until[:-1]
    if len(spans) > 1:
        counts = np.array([len(of_span.time) for of_span in ends])
        which, first = np.arange(len(spans)).repeat(counts), counts.cumsum() - counts
        within[first] = 0.0
        states[:, first] = np.array([span.begin for span in spans]).T
    begins = np.array([before.time[-1] for before in run.spans[:-1]])
    rows = np.array([span.coefficients for span in spans])
    if not run.loads_given:
        constant = np.zeros((len(spans), load.size, rows.shape[2]))
        constant[..., 0] = load.ravel(order="F")
        rows = np.concatenate([rows[:, :strings], constant, rows[:, strings:]], axis=1)
    inputs = rows.transpose(0, 2, 1).reshape(len(spans), -1)[which].T
    if layout.degree:
        origins = np.array([span.origin for span in spans])
        inputs = np.vstack([inputs, (begins - origins)[which] + within])
    pushes: dict[int, Push] = {}
    may_jump = run.supports is not None or run.bars is not None
    for i, span in enumerate(spans) if may_jump else ():
        jump = span.jump
        if run.bars is not None:  # whose rates may jump, though they do not
            rates = None if jump is None else jump.bars
            jump = Jump(
                None if jump is None else jump.supports, np.zeros(bars) if rates is None else rates
            )
        if jump is not None:
            before = run.spans[i]
            is_first = before.ends is None
            state = start if is_first else before.states[:, -1]
            held = layout.packed(rows[i], begins[i] - span.origin)
            moved = 0.0 if jump.supports is None else jump.supports
            pushes[i] = Push(state, *run.impulse_inputs(layout, held, jump), moved, is_first)
    method = run.last_method
    how = run.integration
    projects = method == "dop853" if how.project is None else how.project
    return TracedSteps(
        begins[which] + within, until - within, which, states, inputs,
        pulled, projects, method, layout, pushes,
    )  # fmt: skip
