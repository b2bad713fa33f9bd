"""Many runs of one equation side by side in the compiled core."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.core import records
from tenscontrol.integrate.core_run import settings_of
from tenscontrol.integrate.core_scene import CoreScene
from tenscontrol.integrate.fixed_step import not_finite
from tenscontrol.integrate.integrator import IntegrationError, Span, Work
from tenscontrol.structure.structure import Structure

# What runs count, each.
COUNTS = "steps", "tries", "landings", "switches", "missed", "carries", "carried"


def tables_of_runs(structure: Structure, given: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the tables of the core that parameters of runs change, one row a run.

    Parameters
    ----------
    structure : Structure
        Whose bars share no nodes where masses are given.
    given : mapping of str to ndarray, shape (runs, members)
        By the names of :func:`simulate_many`.
    """
    tables = {}
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
    return {name: np.ascontiguousarray(table) for name, table in tables.items()}


def work_of(counts: FloatArray) -> Work:
    """Return the work of a run by what it counted."""
    steps, tries, landings, switches, missed, carries, carried = (int(c) for c in counts)
    return Work(
        steps=steps + landings, evaluations=4 * tries + 2 * landings + carries,
        switches=switches, missed=missed, carried=carried,
    )  # fmt: skip


class CoreLanes:
    """Runs of a scene by rk4, to the bits of single runs.

    Any number of threads may call :meth:`advance`.

    Parameters
    ----------
    scene : CoreScene
    step : float
        s, at most.
    project : bool
        Whether bars are put on their lengths after each step.
    tables : mapping of str to ndarray
        What runs differ in, one row a run; see :func:`tables_of_runs`.
    """

    back_end = "core, runs side by side"

    def __init__(
        self, scene: CoreScene, step: float, project: bool, tables: Mapping[str, FloatArray]
    ) -> None:
        self._scene, self._step, self._project, self._tables = scene, step, project, tables

    def advance(
        self, runs: IntArray, states: FloatArray, held: FloatArray, duration: float, outputs: int,
        stop: ctypes.c_int,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Return states, shape (runs, outputs, states), times up to which they are finite, counts.

        Of runs by their numbers, from states of shape (runs, states) over a span; ``held`` has
        shape (runs, inputs), or (1, inputs) for all. Once ``stop`` is not 0, all runs end after the
        step they are in. Counts are those of :data:`COUNTS`, shape (runs, 7).
        """
        scene, core = self._scene, self._scene.core
        begin, first = np.ascontiguousarray(states), np.ascontiguousarray(held[0])
        reached = np.full((len(runs), outputs, states.shape[1]), np.nan)
        progress = np.zeros(len(runs), dtype=np.dtype(records.Progress))
        settings = settings_of("rk4", duration, outputs, self._project, step=self._step)
        drive = scene.drive(first)
        tables = {name: table[runs] for name, table in self._tables.items()}
        if len(held) > 1:
            tables["inputs"] = np.ascontiguousarray(held[:, : drive.count * (drive.degree + 1)])
        record = records.Runs(len(runs))
        for name, table in tables.items():
            setattr(record, name, table.ctypes.data)
        sizes = ctypes.byref(scene.scene), ctypes.byref(drive)
        work = np.empty(core.tc_runs_work_size(*sizes, ctypes.byref(record)))
        core.tc_advance_runs(
            *sizes, ctypes.byref(scene.lengths), ctypes.byref(settings), ctypes.byref(record),
            _data(begin), _data(reached), _data(progress), ctypes.byref(stop), _data(work),
        )  # fmt: skip
        # The last step of a run that is stuck was no good one.
        step = duration / (outputs * self.steps_between(duration, outputs))
        steps = np.round(progress["time"] / step) - progress["stuck"]
        counts = np.stack([steps, *(progress[name] for name in COUNTS[1:])], axis=1)
        return reached, step * steps, counts

    def steps_between(self, duration: float, outputs: int) -> int:
        """Return the number of steps from one state that is kept to the next."""
        return max(1, int(np.ceil(duration / outputs / self._step - 1e-9)))

    def failure(self, time: float, duration: float, outputs: int) -> str:
        """Return why a run ended at a time."""
        step = duration / (outputs * self.steps_between(duration, outputs))
        return not_finite(round(time / step), step)

    def of_run(self, run: int, step: float) -> RunLane:
        """Return what integrates a single run by its number, with steps of its own."""
        return RunLane(CoreLanes(self._scene, step, self._project, self._tables), run)


class RunLane:
    """A single run of :class:`CoreLanes`."""

    def __init__(self, lanes: CoreLanes, run: int) -> None:
        self._lanes, self._run = lanes, np.array([run])

    def shorten(self) -> None:
        """See :meth:`Integrator.shorten`: steps are fixed."""

    def advance(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int,
        report: Callable[[float], None] | None = None, /,
    ) -> Span:  # fmt: skip
        """See :meth:`Integrator.advance`; nothing is reported."""
        lanes = self._lanes
        states, (time,), counts = lanes.advance(
            self._run, state[None], held[None], duration, outputs, ctypes.c_int(0)
        )
        work, is_good = work_of(counts[0]), np.isfinite(states[0]).all(axis=1)
        reached = Span(states[0, is_good].T, work)
        if not is_good.all():
            raise IntegrationError(lanes.failure(time, duration, outputs), float(time), reached)
        return reached


def _data(array: FloatArray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
