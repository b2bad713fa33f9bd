"""Estimate of the global error of a motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from itertools import pairwise
from math import ceil
from typing import Protocol

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.integrate.integrator import IntegrationError, Span, steps_between
from tenscontrol.properties import cached_property
from tenscontrol.simulation.plant_run import PlantRun
from tenscontrol.simulation.strut_record import done_by_drives, drive_work, impulse_work
from tenscontrol.structure.structure import Structure

# With a tolerance, the motion is found again with this part of it, and so many times the difference
# is the estimate. A method of order 2 would need more than twice the steps: it takes half as many,
# with this multiple of the tolerance.
_TIGHTER, _SAFETY, _LOOSER = 0.1, 2.0, 8.0

# A tenth of so tight a tolerance is lost in round-off: ten times it is taken.
_TIGHT = 1e-12

# The motion found again is looked at at so many outputs of a stage at most: states between two
# steps may be less accurate than both, but cost the interpolants of the steps.
_LOOKED_AT = 256

# Parts of the time in which an estimate is at least that in the part before.
_WINDOWS = 20

# Steps of twice the length are taken where they are fewer than this part.
_FEWER = 0.75

# The part of a motion with fixed steps that is found in steps four times as long, to see the order,
# and the times in it, as parts of it, at which it is looked for.
_OF_ORDER, _SEEN_AT = 0.2, (0.25, 0.5, 0.75, 1.0)

# Half the step must stay so many times below the limit where twice the step passed it.
_CLEARLY = 3.0

# A difference above this part of the size no longer grows with the step, and shows no order.
_SATURATED = 0.05


# Behind the last output.
_NO_OUTPUT = np.array([-1])


class Resolved(Protocol):
    """What integrates a span at a step or tolerance; see :class:`Integrator`."""

    def shorten(self) -> None:
        """Take shorter steps where it is not the tolerance that limits them."""

    def advance(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int, /
    ) -> Span:
        """Return the states at so many equally spaced times, the last at the end."""


@dataclass(frozen=True, eq=False)
class Stage:
    """A time over which the inputs of a motion are one polynomial.

    Attributes
    ----------
    length : float
        s.
    outputs : int
        Number of equally spaced times, the last at the end.
    held : ndarray, shape (inputs,)
        The inputs as integrators take them, from the beginning on.
    begin : callable, optional
        Takes the state at the end of the stage before to the one that this begins with.
    work : callable, optional
        ``(before, times, states) -> work`` of drives of bars, J, shape (β, K): between times from
        the beginning on, s, (K + 1), of states there, one a column, and an end of the stage before.
    """

    length: float
    outputs: int
    held: FloatArray
    begin: Callable[[FloatArray], FloatArray] | None = None
    work: Callable[[FloatArray, FloatArray, FloatArray], FloatArray] | None = None

    @property
    def spacing(self) -> float:
        """Time from one output to the next, s."""
        return self.length / self.outputs

    def strides(self, step: float, factor: float) -> list[tuple[int, int]]:
        """Return how the outputs are reached in steps by a factor longer: (strides, outputs each).

        A step may pass several outputs. What is left in the end is a shorter stride. Of work, parts
        twice as long show what its quadrature errs.
        """
        least = 1 if self.work is None else 2
        every = min(self.outputs, max(least, round(factor / steps_between(self.spacing, step))))
        whole, rest = divmod(self.outputs, every)
        return [(whole, every), *([(1, rest)] if rest else [])]

    def steps(self, step: float, factor: float) -> int:
        """Return how many steps these are."""
        strides = self.strides(step, factor)
        return sum(k * steps_between(every * self.spacing, factor * step) for k, every in strides)


def _joined(parts: Sequence[FloatArray]) -> FloatArray:
    """Return arrays beside one another; one alone is not copied."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)


def _common(one: IntArray, other: IntArray) -> IntArray:
    """Return the outputs that are among both, ascending as each is."""
    below = one.searchsorted(other)  # how many of one are below each of the other
    among: IntArray = other[np.concatenate((one, _NO_OUTPUT)).take(below) == other]
    return among


def _first_of_each(values: IntArray) -> IntArray:
    """Return where equal values that follow on one another begin."""
    is_first = np.ones(len(values), dtype=bool)
    np.not_equal(values[1:], values[:-1], out=is_first[1:])
    return is_first.nonzero()[0]


@dataclass(frozen=True, eq=False)
class Path:
    """Positions of a motion at some of its outputs, what drives of bars did by then, and switches.

    Attributes
    ----------
    columns : ndarray of int, shape (k,)
        Outputs, counted from 0 over all stages, ascending.
    positions : ndarray, shape (coordinates, k) or (runs, coordinates, k)
        m.
    switches : int
        How often strings or contacts switched, as far as it is known.
    work : ndarray, shape (β, k), optional
        J, where bars are driven.
    """

    columns: IntArray
    positions: FloatArray
    switches: int
    work: FloatArray | None = None

    def at(self, columns: IntArray) -> FloatArray:
        """Return the positions at outputs that are among its own."""
        if len(columns) == len(self.columns):
            return self.positions
        return self.positions[..., self.columns.searchsorted(columns)]

    def work_at(self, columns: IntArray) -> FloatArray:
        """Return the work at outputs that are among its own, of no bars where none is driven."""
        work = np.zeros((0, len(self.columns))) if self.work is None else self.work
        return work[:, self.columns.searchsorted(columns)]


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion that can be integrated again at another resolution.

    Attributes
    ----------
    structure : Structure
    start : ndarray, shape (states,)
    stages : sequence of Stage
    path : Path
        What was kept of it.
    rows : ndarray of int, shape (coordinates,)
        Place of each coordinate that was kept among those of a state.
    setting : {"step", "tolerance"}
    value : float
        Step, s, or tolerance.
    order : int
        Of the method.
    integrator : callable
        Makes the integrator for another value.
    later : callable
        ``(held, time) -> held`` of a span that begins a time later, s.
    loop : callable, optional
        ``value -> path`` of the motion at another value with its controller in the loop. None where
        there is no controller, or no other one like it: inputs are replayed.
    report : callable, optional
        Told the time reached by another motion, s.
    """

    structure: Structure
    start: FloatArray
    stages: Sequence[Stage]
    path: Path
    rows: IntArray
    setting: str
    value: float
    order: int
    integrator: Callable[[float], Resolved]
    later: Callable[[FloatArray, float], FloatArray]
    loop: Callable[[float], Path] | None = None
    report: Callable[[float], None] | None = None

    def estimated_error(self, limit: float) -> FloatArray:
        """Return the error of the nodes at each output that was kept, as part of the size."""
        error: FloatArray = self.estimated_errors(limit)[0]
        return error

    def estimated_errors(self, limit: float) -> FloatArray:
        """Return the error of the nodes at each output that was kept, and of the work of drives.

        As part of the size, and in J, one a row.

        Under a controller the motion is found again with it in the loop. Under its commands alone
        an unstable structure that the loop holds would leave, and a loop that acts far from what it
        was designed for may magnify what is wrong as the structure alone does not.
        """
        error = self._from_another(limit) if self.loop is None else self._in_loop(self.loop)
        return self._without_dips(error)

    def errors_by_tolerance(self) -> FloatArray:
        """Return the errors of several runs with a tolerance, one a row.

        Starts, positions, inputs of stages, and states that the integrator takes and returns then
        have a first axis of runs. Not finite at the end where another run has to be looked for.
        """
        return self._without_dips(self._by_tolerance(self._again))

    def _without_dips(self, error: FloatArray) -> FloatArray:
        """Return estimates that are at least those of just before: motions may meet for once."""
        lengths = np.array([stage.length for stage in self.stages])
        ends = lengths.cumsum()
        begins = ends - lengths
        times = [
            begin + stage.length * (np.arange(1, stage.outputs + 1) / stage.outputs)
            for begin, stage in zip(begins, self.stages, strict=True)
        ]
        time, kept = _joined(times), self.path.columns
        if len(kept) < len(time):
            time = time[kept]
        window = np.minimum((time / ends[-1] * _WINDOWS).astype(int), _WINDOWS - 1)
        largest = np.zeros((len(error), _WINDOWS + 1))
        first = _first_of_each(window)
        largest[:, window[first] + 1] = np.maximum.reduceat(error, first, axis=1)
        least: FloatArray = np.maximum(error, largest.take(window, axis=1))
        return least

    def _from_another(self, limit: float) -> FloatArray:
        """Return the error by another motion, under the same inputs.

        The motion is integrated again at another resolution. What magnifies errors magnifies the
        difference as much, so that it tells the global error, not that of a step. With a tolerance
        it is twice the difference from a tenth of it. With fixed steps it is the difference from
        steps of twice the length; for methods of order 4 and 6 divided by what the order allows, as
        far as steps of four times the length show it in the first part of the motion, and only
        where as many switches were found. Longer steps of these may be much worse: where they pass
        the limit, and half the step stays clearly below, that counts. Infinite from where no other
        motion can be found.
        """
        if self.setting == "tolerance":
            error = self._by_tolerance(self._again)
            is_tighter = self.order > 2 and self.value > _TIGHT
            if is_tighter and not np.isfinite(error[0, -1]):
                return self._difference(self._again(1 / _TIGHTER))
            return error
        steps, fewer = (sum(stage.steps(self.value, f) for stage in self.stages) for f in (1, 2))
        if fewer > _FEWER * steps:  # inputs change with each step
            return _SAFETY * self._difference(self._again(0.5))
        coarse = self._again(2)
        error = self._difference(coarse)
        if not np.isfinite(error[0, -1]):  # some motions need the steps that they have
            return _SAFETY * self._difference(self._again(0.5))
        if self.order > 2 and coarse.switches == self.path.switches:
            divisor = 2 ** self._order_seen(coarse) - 1
            small = np.maximum.accumulate(error[0]) < _SATURATED
            error[:, small] *= min(1.0, _SAFETY / divisor)
        if self.order > 2 and float(error[0].max()) > limit:
            finer = _SAFETY * self._difference(self._again(0.5))
            if _CLEARLY * float(finer[0].max()) < limit:
                return finer
        return error

    def _by_tolerance(self, again: Callable[[float], Path]) -> FloatArray:
        """Return the error by a motion found again at a part or a multiple of the tolerance."""
        if self.order <= 2:
            return self._difference(again(_LOOSER))
        if self.value > _TIGHT:
            return _SAFETY * self._difference(again(_TIGHTER))
        return self._difference(again(1 / _TIGHTER))

    def _in_loop(self, loop: Callable[[float], Path]) -> FloatArray:
        """Return the error by a motion that its controller corrects, or leads away."""
        if self.setting == "step":
            return _SAFETY * self._difference(loop(0.5 * self._step))
        return self._by_tolerance(lambda factor: loop(factor * self.value))

    def _order_seen(self, coarse: Path) -> float:
        """Return the order by which differences grow with the step, at most that of the method."""
        coarser = self._again(4, _OF_ORDER)
        columns = reduce(_common, (path.columns for path in (self.path, coarse, coarser)))
        if not len(columns):
            return 1.0
        at = np.ceil(np.multiply(_SEEN_AT, len(columns) - 1)).astype(int)
        pairs = (self.path, coarse), (coarse, coarser)
        less, more = (
            np.maximum.accumulate(self._distance(one.at(columns), other.at(columns)))[at]
            for one, other in pairs
        )
        orders = np.log2(np.maximum(more / np.maximum(less, np.finfo(float).tiny), 1.0))
        if orders.max() > self.order + 1:  # the longest steps are not stable, and show nothing
            return 1.0
        return float(np.clip(orders.min(), 1.0, self.order))

    def _again(self, factor: float, share: float = 1.0) -> Path:
        """Return the motion for a value by a factor larger, over a first part of the time."""
        integrator, state = self._integrator_of(factor), self.start
        columns, positions = [np.zeros(0, int)], list[FloatArray]()
        done, of_work = list[FloatArray](), None
        first, switches, now, left = 0, 0, 0.0, share * sum(stage.length for stage in self.stages)
        for stage in self.stages:
            if left <= 0:
                break
            before, state = state, state if stage.begin is None else stage.begin(state)
            passed = 0
            for count, every in self._strides(stage, factor):
                time = every * stage.spacing
                some = min(count, max(0, ceil(left / time)))
                if not some:
                    break
                inputs = stage.held
                if passed:
                    inputs = self.later(inputs, passed * stage.spacing)
                try:
                    span = integrator.advance(state, inputs, some * time, some)
                except IntegrationError as error:
                    span = error.span
                reached = span.states.shape[-1]
                if stage.work is not None and reached:
                    times = passed * stage.spacing + time * np.arange(reached + 1)
                    states = np.column_stack([state, span.states])
                    done.append(stage.work(states[:, 0] if passed else before, times, states))
                now += some * time
                if self.report is not None:
                    self.report(now)
                columns.append(first + passed - 1 + every * np.arange(1, reached + 1))
                positions.append(span.states[..., self.rows, :])
                switches += span.work.switches + span.work.missed
                passed += every * some
                left = left - some * time if reached == some else 0.0
                state = span.states[..., -1] if reached else state
            first += stage.outputs
        if done:
            of_work = np.hstack(done).cumsum(axis=1)
        return Path(np.concatenate(columns), _joined(positions), switches, of_work)

    def _integrator_of(self, factor: float) -> Resolved:
        """Return the integrator for a value by a factor larger than what was taken."""
        value = self._step if self.setting == "step" else self.value
        integrator = self.integrator(factor * value)
        if factor < 1:
            integrator.shorten()
        return integrator

    @property
    def _step(self) -> float:
        """The longest step that was taken, s: outputs may lie closer than that asked for."""
        spacings = [stage.spacing for stage in self.stages]
        return max(spacing / steps_between(spacing, self.value) for spacing in spacings)

    def _strides(self, stage: Stage, factor: float) -> list[tuple[int, int]]:
        if self.setting == "step":
            return stage.strides(self.value, factor)
        # Outputs may limit the steps of a tolerance.
        is_close = factor > 1 or stage.work is not None
        every = 2 if is_close else ceil(stage.outputs / _LOOKED_AT)
        return stage.strides(stage.spacing, every)

    def _difference(self, other: Path) -> FloatArray:
        """Return how far the motion is from another at the outputs that were kept, and its work.

        At one that the other does not have, it is the larger of those beside.
        """
        own = self.path.columns
        columns = _common(own, other.columns)
        off = self._distance(self.path.at(columns), other.at(columns))
        off = off if off.ndim > 1 else off[None]
        if self.path.work is not None:
            work = np.abs(self.path.work_at(columns) - other.work_at(columns))
            off = np.vstack([off, work])
        if len(columns) == len(own):
            return off
        beside = np.zeros((len(off), len(columns) + 2))
        beside[:, 1:-1], beside[:, -1] = off, np.inf
        is_met = np.zeros(len(own), dtype=bool)
        is_met[own.searchsorted(columns)] = True
        before = is_met.cumsum()  # of one that is met itself, and so is what follows
        after = before + ~is_met
        return np.maximum(beside.take(before, axis=1), beside.take(after, axis=1))

    def _distance(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Return the largest distance of a node between positions, as part of the size."""
        with np.errstate(over="ignore", invalid="ignore"):
            apart = one - other
            squares = np.square(apart, out=apart)
            d, n = self.structure.nodes.shape
            is_whole = len(self.rows) == d * n
            if not is_whole:
                first = self._first_of_nodes
                n, is_whole = len(first), len(self.rows) == d * len(first)
            if is_whole:  # in an eighth of the time of the other
                shape = *squares.shape[:-2], n, d, squares.shape[-1]
                of_nodes = np.add.reduce(squares.reshape(shape), axis=-2)
            else:
                of_nodes = np.add.reduceat(squares, first, axis=-2)
            apart = np.sqrt(np.maximum.reduce(of_nodes, axis=-2))
        return np.where(np.isfinite(apart), apart / self.structure.size, np.inf)

    @cached_property
    def _first_of_nodes(self) -> IntArray:
        """Place of the first coordinate of each node among those that were kept."""
        node = self.structure.free_rows[self.rows] // self.structure.dimension
        return _first_of_each(node)


def estimated_errors(
    run: PlantRun,
    limit: float,
    loop: Callable[[float], PlantRun] | None,
    report: Callable[[float], None] | None,
    work: FloatArray | None,
) -> FloatArray | None:
    """Return estimates of errors at all times kept, one a row; None if interrupted.

    Of the nodes, as part of the size, and of the work of drives of bars, J, if it is given, (β, T).
    ``limit`` is that up to which the motion is trusted; ``loop`` does the run at another value
    under a copy of its controller, if there is one; ``report`` is told the time reached, s.
    """
    structure, stages = run.model.structure, []
    half = len(structure.free_rows)
    for i, (before, span) in enumerate(pairwise(run.spans)):
        start = float(before.time[-1])
        u = run.packed(span.coefficients, start - span.origin)
        # The motion is kept from after a jump at its start on.
        begin = partial(run.pushed, held=u, jump=span.jump if i else None)
        done = None if work is None else partial(_work_of_stage, run, i + 1)
        stages.append(Stage(float(span.time[-1]) - start, len(span.time), u, begin, done))

    def in_loop(value: float) -> Path:
        assert loop is not None  # else it is not asked for
        other = loop(value)
        return _path(other, None if work is None else done_by_drives(other)[1])

    motion = Motion(
        structure, run.spans[0].begin, stages, _path(run, work), np.arange(half),
        run.choice.setting, run.choice.value, run.order, run.integrator_for,
        run.equation.layout.later, None if loop is None else in_loop, report,
    )  # fmt: skip
    try:
        later = motion.estimated_errors(limit)
    except KeyboardInterrupt:
        return None
    errors = np.zeros((len(later), later.shape[1] + 1))  # none at the start
    errors[:, 1:] = later
    return errors


def _path(run: PlantRun, work: FloatArray | None) -> Path:
    """Return all that was kept of a run after its start, with the work of drives, (β, T)."""
    half = len(run.model.structure.free_rows)
    positions = [span.states[:half] for span in run.spans[1:]] or [np.zeros((half, 0))]
    joined = _joined(positions)
    return Path(
        np.arange(joined.shape[1]), joined, run.work.switches + run.work.missed,
        None if work is None else work[:, 1:],
    )  # fmt: skip


def _work_of_stage(
    run: PlantRun, i: int, before: FloatArray, times: FloatArray, states: FloatArray
) -> FloatArray:
    """Return what drives do in a span of a run; see :class:`Stage`."""
    start = float(run.spans[i - 1].time[-1])
    work = drive_work(run, i, start + times, states)[1]
    if i > 1 and not times[0]:  # the run begins after the first jump
        work[:, 0] += impulse_work(run, i, before)
    return work
