"""Many runs of one equation side by side in the compiled core."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.core import records
from tenscontrol.core.records import GROUND_NUMBERS, pointers
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.model_parameters import MASSES, ground_numbers
from tenscontrol.fields import changed
from tenscontrol.integrate.core_run import settings_of
from tenscontrol.integrate.core_scene import CoreScene, numbers_of_grounds
from tenscontrol.integrate.dop853 import STEP_RULES, have_changed, steps_of, work_of
from tenscontrol.integrate.fixed_step import not_finite, work_in_core
from tenscontrol.integrate.integrator import (
    IntegrationError,
    Span,
    Work,
    differences,
    first_vector,
    length_and_mass,
    speed_scale,
    steps_between,
)

# Evaluations of a try, its interpolant and its landing, at most.
_MOST_OF_A_TRY = 20

_PROGRESS = np.dtype(records.Progress)  # which NumPy makes anew each time


def have_tables(model: Model, given: Mapping[str, FloatArray]) -> bool:
    """Return whether runs with these parameters differ in tables of the core alone.

    Parameters
    ----------
    model : Model
    given : mapping of str to ndarray, shape (runs, members)
        By the names of :func:`simulate_many`.
    """
    structure = model.structure
    if set(MASSES) & set(given):
        carried = given.get("point_mass", structure.point_mass)[..., structure.bar_nodes]
        if structure.blocks or structure.point_mass[structure.bar_nodes].any() or carried.any():
            return False  # bars that share nodes, or carry masses, have other tables
    # Without damping or friction equations are simpler.
    switched = [name for name in given if name.endswith(("damping", "friction"))]
    return all(len(np.unique((given[name] > 0).any(axis=1))) == 1 for name in switched)


def tables_of_runs(model: Model, given: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the tables of the core that parameters of runs change, one row a run.

    Parameters
    ----------
    model : Model
    given : mapping of str to ndarray, shape (runs, members)
        Parameters of which :func:`have_tables` is true.
    """
    tables, structure = {}, model.structure
    for name, table in (
        ("stiffness", "stiffness"), ("axial_rigidity", "stiffness"), ("damping", "damping"),
    ):  # fmt: skip
        if name in given:
            tables[table] = given[name]
    if "bar_mass" in given:
        mass = given["bar_mass"][:, structure.free_bars]
        tables["bar_constants"] = np.stack([0.5 * (2 / mass), 3 / mass, mass / 12, 6 / mass], 2)
        mass = given["bar_mass"][:, structure.swinging_bars]
        tables["tip_constants"] = np.stack([mass / 3, 3 / mass], axis=2)
    if "point_mass" in given:
        tables["point_inverse_mass"] = 1 / given["point_mass"][:, structure.string_nodes]
    of_ground = {name: at for name, at in ground_numbers(model).items() if name in given}
    if of_ground:
        runs = len(given[next(iter(of_ground))])
        rows = np.tile(numbers_of_grounds(model.ground), (runs, 1, 1))
        for name, (law, number) in of_ground.items():
            rows[:, law, GROUND_NUMBERS.index(number)] = given[name][:, 0]
        tables["ground_numbers"] = rows
    return {name: np.ascontiguousarray(table) for name, table in tables.items()}


@dataclass(frozen=True, eq=False)
class LaneSpans:
    """Runs over a span.

    Attributes
    ----------
    states : ndarray, shape (runs, outputs, states)
        NaN from where a run did not go on.
    time : ndarray, shape (runs,)
        Up to which they are good, s.
    reaches_end : ndarray of bool, shape (runs,)
    counts : ndarray, shape (runs, counts)
        Of what the lanes count.
    """

    states: FloatArray
    time: FloatArray
    reaches_end: np.ndarray
    counts: FloatArray


class CoreLanes:
    """Runs of a scene, to the bits of single runs.

    Any number of threads may call :meth:`advance`.

    Parameters
    ----------
    scene : CoreScene
    project : bool
        Whether bars are put on their lengths after each step.
    tables : mapping of str to ndarray
        What runs differ in, one row a run; see :func:`tables_of_runs`.
    """

    back_end = "core, runs side by side"

    #: What runs count, each.
    counted: tuple[str, ...]

    def __init__(self, scene: CoreScene, project: bool, tables: Mapping[str, FloatArray]) -> None:
        self._scene, self._project, self._tables = scene, project, tables

    def advance(
        self, runs: IntArray, states: FloatArray, held: FloatArray, duration: float, outputs: int,
        stop: ctypes.c_int,
    ) -> LaneSpans:  # fmt: skip
        """Return runs by their numbers over a span, from states of shape (runs, states).

        ``held`` has shape (runs, inputs), or (1, inputs) for all. Once ``stop`` is not 0, all runs
        end after the step they are in.
        """
        raise NotImplementedError

    def over_spans(self, first: int, last: int) -> CoreLanes:
        """Return the same for some runs, to be advanced over several spans one after another."""
        return self

    def work_of(self, counts: FloatArray) -> Work:
        """Return the work of a run by what it counted, in all its spans."""
        raise NotImplementedError

    def _calls(self, runs: IntArray, states: FloatArray, held: FloatArray) -> _Calls:
        tables = {name: table[runs] for name, table in self._tables.items()}
        return _Calls(self._scene, np.ascontiguousarray(states), held, tables)


class FixedStepLanes(CoreLanes):
    """Runs in fixed steps; see :class:`CoreLanes`.

    Parameters
    ----------
    scene, project, tables : optional
        Of :class:`CoreLanes`.
    step : float
        s, at most.
    method : {"rk4", "rk4_plain"}
    """

    counted = "steps", "tries", "landings", "switches", "missed", "carries", "carried"

    def __init__(
        self, scene: CoreScene, project: bool, tables: Mapping[str, FloatArray], step: float,
        method: str,
    ) -> None:  # fmt: skip
        super().__init__(scene, project, tables)
        self._step, self._method = step, method

    def advance(
        self, runs: IntArray, states: FloatArray, held: FloatArray, duration: float, outputs: int,
        stop: ctypes.c_int,
    ) -> LaneSpans:  # fmt: skip
        """See :meth:`CoreLanes.advance`."""
        settings = settings_of(self._method, duration, outputs, self._project, step=self._step)
        reached, progress = self._calls(runs, states, held).advance(settings, {}, stop)
        # The last step of a run that is stuck was no good one.
        step = self._length_of_steps(duration, outputs)
        steps = np.round(progress["time"] / step) - progress["stuck"]
        counts = np.stack([steps, *(progress[name] for name in self.counted[1:])], axis=1)
        reaches_end = np.asarray(np.isfinite(reached[:, -1]).all(axis=1))
        return LaneSpans(reached, step * steps, reaches_end, counts)

    def work_of(self, counts: FloatArray) -> Work:
        """See :meth:`CoreLanes.work_of`."""
        by_name = dict(zip(self.counted, map(int, counts), strict=True))
        steps = by_name.pop("steps")
        return work_in_core(records.Progress(**by_name), steps)

    def _length_of_steps(self, duration: float, outputs: int) -> float:
        return duration / (outputs * steps_between(duration / outputs, self._step))

    def failure(self, time: float, duration: float, outputs: int) -> str:
        """Return why a run ended at a time."""
        step = self._length_of_steps(duration, outputs)
        return not_finite(round(time / step), step)

    def of_step(self, step: float) -> FixedStepLanes:
        """Return the same in other steps."""
        return changed(self, _step=step)


class AdaptiveLanes(CoreLanes):
    """Runs by dop853, each in steps of its own; see :class:`CoreLanes`.

    A run that does not reach the end of a span is left to an integrator of its own, from its start.

    Parameters
    ----------
    equation : Equation
        Of any of the runs.
    scene, project, tables : optional
        Of :class:`CoreLanes`.
    tolerance : float
        As of :class:`DOP853`.
    mass : ndarray, shape (1,) or (runs,)
        Of what moves, kg.
    limit : float
        Evaluations after which a run goes on no longer.
    """

    counted = (
        "tries", "rejections", "landings", "approaches", "switches", "interpolants", "carries",
        "carried", "short_tries", "spans",
    )  # fmt: skip

    def __init__(
        self, equation: Equation, scene: CoreScene, project: bool,
        tables: Mapping[str, FloatArray], tolerance: float, mass: FloatArray, limit: float,
    ) -> None:  # fmt: skip
        super().__init__(scene, project, tables)
        self._equation, self._tolerance, self._mass = equation, tolerance, mass
        self._limit, self._is_shortened = limit, False
        self._memory: _Memory | None = None  # of the spans before, where there are several

    def advance(
        self, runs: IntArray, states: FloatArray, held: FloatArray, duration: float, outputs: int,
        stop: ctypes.c_int,
    ) -> LaneSpans:  # fmt: skip
        """See :meth:`CoreLanes.advance`."""
        half, calls = states.shape[1] // 2, self._calls(runs, states, held)
        size, memory = length_and_mass(self._equation)[0], self._memory
        asked = differences(states), first_vector(self._equation)
        if memory is None:
            frequency, (force, slope, taut) = calls.begin(*asked)
        else:
            of_strings = held[:, : self._equation.layout.strings]
            frequency, (force, slope, taut) = memory.begin(calls, runs, of_strings, *asked)
        rules = STEP_RULES[self._is_shortened]
        mass = self._mass[runs] if len(self._mass) > 1 else self._mass
        with np.errstate(over="ignore", invalid="ignore"):  # such runs do not reach the end
            fastest = np.abs(states[:, half:]).max(axis=1, initial=0.0)
            speed = speed_scale(size, mass, fastest, force, frequency)
            scale = np.repeat(np.stack([np.full(len(speed), size), speed], axis=1), half, axis=1)
            step, longest = steps_of(slope, scale, frequency, duration, rules)
            scale *= self._tolerance
        own = {"step": step, "longest": longest, "scale": scale, "slope": slope, "taut": taut}
        settings = settings_of(
            "dop853", duration, outputs, self._project, limit=self._limit, within=rules.within
        )  # fmt: skip
        reached, progress = calls.advance(settings, own, stop)
        reaches_end = (
            (progress["time"] >= duration)
            & (np.abs(states) <= validation.LARGEST).all(axis=1)
            & np.isfinite(reached).all(axis=(1, 2))
        )
        counted = [progress[name] for name in self.counted[:-1]]
        counts = np.stack([*counted, np.ones(len(runs))], axis=1)
        if memory is not None:
            reaches_end &= memory.spent_less(self._limit, runs, progress)
        reached[~reaches_end] = np.nan
        return LaneSpans(reached, progress["time"], reaches_end, counts)

    def work_of(self, counts: FloatArray) -> Work:
        """See :meth:`CoreLanes.work_of`."""
        by_name = dict(zip(self.counted, map(int, counts), strict=True))
        spans = by_name.pop("spans")
        return work_of(records.Progress(**by_name), spans)

    def over_spans(self, first: int, last: int) -> AdaptiveLanes:
        """See :meth:`CoreLanes.over_spans`; as an integrator of their own, runs remember."""
        memory = _Memory(first, last - first, self._equation.layout.strings)
        return changed(self, _memory=memory)

    def of_tolerance(self, tolerance: float, is_shortened: bool) -> AdaptiveLanes:
        """Return the same with another tolerance, as after :meth:`DOP853.shorten` or not."""
        return changed(self, _tolerance=tolerance, _is_shortened=is_shortened, _memory=None)


class _Memory:
    """What runs by :class:`DOP853` remember from span to span, and what they have spent.

    Parameters
    ----------
    first, count : int
        Number of the first of the runs, and how many follow one another.
    strings : int
    """

    def __init__(self, first: int, count: int, strings: int) -> None:
        self._first = first
        self._frequency = np.full(count, np.nan)
        self._of_strings = np.zeros((count, strings))  # for which it was found
        self._tries = np.zeros(count)

    def begin(
        self, calls: _Calls, runs: IntArray, of_strings: FloatArray, difference: FloatArray,
        vector: FloatArray,
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:  # fmt: skip
        """Return what :meth:`_Calls.begin` does; frequencies are found where inputs changed."""
        at = runs - self._first
        frequency, before = self._frequency[at], self._of_strings[at]
        changed = np.isnan(frequency) | have_changed(
            np.broadcast_to(of_strings, before.shape), before
        )
        anew, rest = calls.begin(difference, vector, bool(changed.any()))
        self._frequency[at] = frequency = np.where(changed, anew, frequency)
        self._of_strings[at] = np.where(changed[:, None], of_strings, before)
        return frequency, rest

    def spent_less(self, limit: float, runs: IntArray, progress: np.ndarray) -> np.ndarray:
        """Return which runs have surely taken fewer evaluations than a limit, with a span more."""
        at = runs - self._first
        self._tries[at] += progress["tries"] + progress["approaches"]
        return np.asarray(_MOST_OF_A_TRY * self._tries[at] < limit)


class _Calls:
    """Calls of the core for some runs with one row each of states and tables."""

    def __init__(
        self, scene: CoreScene, states: FloatArray, held: FloatArray,
        tables: Mapping[str, FloatArray],
    ) -> None:  # fmt: skip
        self._scene, self._states, self._tables = scene, states, dict(tables)
        self._first = np.ascontiguousarray(held[0])
        drive = self._drive = scene.drive(self._first)
        if len(held) > 1:
            inputs = held[:, : drive.count * (drive.degree + 1)]
            self._tables["inputs"] = np.ascontiguousarray(inputs)

    def begin(
        self, difference: FloatArray, vector: FloatArray, finds_frequency: bool = True
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """Return largest frequencies, (runs), NaN if not found; forces, slopes, what pulls."""
        scene, count = self._scene, len(self._states)
        frequency = np.full(count, np.nan)
        arrays = (
            np.empty(count), np.empty_like(self._states), np.empty((count, scene.switches)),
        )  # fmt: skip
        runs = self._runs({})
        work = self._work(settings_of("dop853", 1.0, 1, False), runs)
        scene.core.tc_begin_runs(
            scene.at, ctypes.byref(self._drive), ctypes.byref(runs),
            *pointers(self._states, difference, vector),
            *(pointers(frequency) if finds_frequency else [None]), *pointers(*arrays, work),
        )  # fmt: skip
        return frequency, arrays

    def advance(
        self, settings: records.Settings, own: Mapping[str, FloatArray], stop: ctypes.c_int
    ) -> tuple[FloatArray, np.ndarray]:
        """Return the states at outputs, NaN where they are not reached, and progress."""
        scene, (count, size) = self._scene, self._states.shape
        reached = np.full((count, settings.outputs, size), np.nan)
        progress = np.zeros(count, dtype=_PROGRESS)
        runs = self._runs(own)
        work = self._work(settings, runs)
        scene.core.tc_advance_runs(
            scene.at, ctypes.byref(self._drive), scene.lengths_at,
            ctypes.byref(settings), ctypes.byref(runs),
            *pointers(self._states, reached, progress), ctypes.byref(stop), *pointers(work),
        )  # fmt: skip
        return reached, progress

    def _runs(self, own: Mapping[str, FloatArray]) -> records.Runs:
        record = records.Runs(len(self._states))
        for name, table in (self._tables | dict(own)).items():
            setattr(record, name, records.address(table))
        return record

    def _work(self, settings: records.Settings, runs: records.Runs) -> FloatArray:
        """Return work memory."""
        scene, records_of = self._scene, (self._scene.scene, self._drive, settings, runs)
        return np.empty(scene.core.tc_runs_work_size(*map(ctypes.byref, records_of)))


class RunLane:
    """A single run of :class:`FixedStepLanes`, by its number."""

    def __init__(self, lanes: FixedStepLanes, run: int) -> None:
        self._lanes, self._run = lanes, np.array([run])

    def shorten(self) -> None:
        """See :meth:`Integrator.shorten`: steps are fixed."""

    def advance(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int, /
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        lanes = self._lanes
        spans = lanes.advance(
            self._run, state[None], held[None], duration, outputs, ctypes.c_int(0)
        )
        (states,), (time,), work = spans.states, spans.time, lanes.work_of(spans.counts[0])
        is_good = np.isfinite(states).all(axis=1)
        reached = Span(states[is_good].T, work)
        if not is_good.all():
            raise IntegrationError(lanes.failure(time, duration, outputs), float(time), reached)
        return reached
