"""Motion between the states kept of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.dynamics.profile import polynomial_at
from tenscontrol.properties import cached_property
from tenscontrol.simulation.plant_run import PlantRun

# Nodes and weights of Lobatto's quadrature of order 8, over parts from 0 to 1.
_INNER = np.sqrt(3 / 7) / 2
SHARES = frozen(np.array([0.0, 0.5 - _INNER, 0.5, 0.5 + _INNER, 1.0]))
WEIGHTS = frozen(np.array([9.0, 49.0, 64.0, 49.0, 9.0]) / 180)

#: Times, s, nodes and velocities, (d, n, T) each.
States = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(eq=False)
class DenseMotion:
    """Parts of a motion: each the quintic with the states and accelerations at its ends."""

    run: PlantRun
    of: IntArray  # span that each is part of, shape (K,)
    begins: FloatArray  # s
    ends: FloatArray
    before: FloatArray  # states at the ends, one a column
    after: FloatArray

    @classmethod
    def of_run(cls, run: PlantRun) -> DenseMotion:
        """Return the motion between the states kept of a run; the first part is the start alone."""
        spans, starts = run.spans, [span.begin for span in run.spans]
        ends = np.concatenate([span.time for span in spans])
        begins = np.concatenate([ends[:1], ends[:-1]])
        states = np.hstack([span.states for span in spans])
        of = np.repeat(np.arange(len(spans)), [len(span.time) for span in spans])
        before = np.column_stack([states[:, :1], states[:, :-1]])
        first = np.flatnonzero(np.diff(of, prepend=-1))
        before[:, first] = np.column_stack([starts[i] for i in of[first]])
        return cls(run, of, begins, ends, before, states)

    @classmethod
    def of_steps(cls, run: PlantRun) -> DenseMotion | None:
        """Return the motion between ends of steps, if they were kept and are more than the outputs.

        Its first part is the start alone.
        """
        if len(run.spans) != 2:
            return None
        (start, span), ends = run.spans, run.spans[1].ends
        outputs = len(span.time)
        if ends is None or not outputs or len(ends.time) <= outputs:  # none: it stopped before
            return None
        last, begin = span.time[-1], start.time[0]
        time, states = begin + ends.time, ends.states
        if last - time[-1] > 1e-9 * (last - begin):  # steps are thinned out
            time, states = np.append(time, last), np.column_stack([states, span.states[:, -1]])
        times, start_state = np.concatenate([[begin, begin], time]), span.begin[None]
        every = np.concatenate([start_state, start_state, states.T]).T  # of large runs, once
        of = np.repeat([0, 1], [1, len(time)])
        return cls(run, of, times[:-1], times[1:], every[:, :-1], every[:, 1:])

    @classmethod
    def joined(cls, parts: Sequence[DenseMotion]) -> DenseMotion:
        """Return parts of a motion one after the other."""
        return cls(
            parts[0].run,
            np.concatenate([motion.of for motion in parts]),
            np.concatenate([motion.begins for motion in parts]),
            np.concatenate([motion.ends for motion in parts]),
            np.hstack([motion.before for motion in parts]),
            np.hstack([motion.after for motion in parts]),
        )

    def take(self, k: IntArray | slice) -> DenseMotion:
        """Return some of them."""
        times, before, after = (self.begins[k], self.ends[k]), self.before[:, k], self.after[:, k]
        some = DenseMotion(self.run, self.of[k], *times, before, after)
        if "_accelerations" in self.__dict__:  # they are known
            some._accelerations = [array[:, k] for array in self._accelerations]
        return some

    def followed(self) -> States:
        """Return times, nodes and velocities of parts that follow one another in one span.

        From the beginning of the first to the end of the last.
        """
        run, span = self.run, self.run.spans[self.of[-1]]
        time = np.append(self.begins, self.ends[-1:])
        states = np.concatenate([self.before.T, self.after[:, -1:].T]).T
        inputs = np.repeat(span.coefficients[:, :, None], len(time), axis=2)
        d, n = run.model.structure.nodes.shape
        motion = run.all_nodes(states, inputs, time - span.origin)
        nodes, velocities = motion.reshape(2, n, d, -1).swapaxes(1, 2)
        return time, nodes, velocities

    def again(self, first: int, last: int, parts: int) -> tuple[DenseMotion, int]:
        """Return the time from one to another in equal parts, integrated again from its begin.

        With the evaluations that this took.
        """
        run, begin, end = self.run, self.begins[first], self.ends[last]
        within = run.spans[self.of[first]]
        u = run.equation.layout.packed(within.coefficients, float(begin) - within.origin)
        span = run.integrator.advance(self.before[:, first], u, float(end - begin), parts)
        after = span.states
        times = begin + (end - begin) * np.arange(parts + 1) / parts
        before = np.column_stack([self.before[:, first], after[:, :-1]])
        of = np.full(parts, self.of[first])
        return DenseMotion(run, of, times[:-1], times[1:], before, after), span.work.evaluations

    def groups(self, counts: IntArray, most: int) -> list[IntArray]:
        """Return which follow on one another and are equally long, with equal counts."""
        length = self.ends - self.begins
        apart = np.abs(self.begins[1:] - self.ends[:-1]) + np.abs(np.diff(length))
        new = (apart > 1e-6 * length[1:]) | (np.diff(self.of) != 0) | (np.diff(counts) != 0)
        runs = np.split(np.arange(len(length)), np.flatnonzero(new) + 1)
        return [run[i : i + most] for run in runs for i in range(0, len(run), most)]

    @cached_property
    def _accelerations(self) -> list[FloatArray]:
        equation, half, accelerations = self.run.equation, len(self.before) // 2, []
        for time, x in ((self.begins, self.before), (self.ends, self.after)):
            coefficients = self._inputs(np.arange(len(time))).swapaxes(0, 1)
            u = coefficients.reshape(-1, len(time))
            if equation.layout.degree:
                u = np.vstack([u, self._since(time, self.of)])
            accelerations.append(evaluate_columns(equation.kinked_slope, x, u)[0][half:])
        return accelerations

    def _since(self, time: FloatArray, of: IntArray) -> FloatArray:
        origin = np.array([span.origin for span in self.run.spans])
        return np.asarray(time - origin[of])

    def _inputs(self, k: IntArray) -> FloatArray:
        every: FloatArray = np.stack([span.coefficients for span in self.run.spans], axis=2)
        return np.asarray(every[:, :, self.of[k]])

    def at(self, s: FloatArray, k: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return times, s, and positions, then velocities, of all nodes at shares of segments."""
        h, half = self.ends[k] - self.begins[k], len(self.before) // 2
        x0, x1 = self.before[:, k], self.after[:, k]
        moved, late = x1[:half] - x0[:half], s**3 * (10 - 15 * s + 6 * s**2)
        mean = moved / np.where(h > 0, h, 1.0)
        x = np.vstack([x0[:half] + late * moved, 30 * s**2 * (1 - s) ** 2 * mean])
        bases = (
            (x0[half:], s - s**3 * (6 - 8 * s + 3 * s**2), 1 - s**2 * (18 - 32 * s + 15 * s**2)),
            (x1[half:], -(s**3) * (4 - 7 * s + 3 * s**2), -(s**2) * (12 - 28 * s + 15 * s**2)),
            (
                h / 2 * self._accelerations[0][:, k],
                s**2 * (1 - s) ** 3,
                s * (1 - s) ** 2 * (2 - 5 * s),
            ),
            (
                h / 2 * self._accelerations[1][:, k],
                s**3 * (1 - s) ** 2,
                s**2 * (1 - s) * (3 - 5 * s),
            ),
        )
        for value, position, rate in bases:
            x[:half] += h * position * value
            x[half:] += rate * value
        time = (1 - s) * self.begins[k] + s * self.ends[k]
        given = np.zeros((0, 1, 0)) if self.run.supports is None else self._inputs(k)
        return time, self.run.all_nodes(x, given, self._since(time, self.of[k]))

    def at_times(self, times: FloatArray) -> FloatArray:
        """Return positions, then velocities, of all nodes at times after the start, s."""
        k = np.clip(np.searchsorted(self.ends, times), 1, len(self.ends) - 1)
        share = (times - self.begins[k]) / (self.ends[k] - self.begins[k])
        return self.at(np.clip(share, 0.0, 1.0), k)[1]

    def string_inputs(self, time: FloatArray, k: IntArray) -> FloatArray:
        """Return what is held at times in segments, and its first two rates, (3, strings, T)."""
        return self.values(self.run.string_rows, time, k)

    def values(self, rows: slice, time: FloatArray, k: IntArray) -> FloatArray:
        """Return some inputs at times in segments, and their first two rates, (3, rows, T)."""
        given, since = self._inputs(k)[rows], self._since(time, self.of[k])
        return np.stack([polynomial_at(given, since, order) for order in range(3)])
