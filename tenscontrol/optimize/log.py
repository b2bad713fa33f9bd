"""Logs: what sensors read of a structure over time, and what its actuators held."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.profile import Profile, as_pieces
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.fields import converted
from tenscontrol.files import opened_file, write_file
from tenscontrol.simulation.inputs import checked_inputs
from tenscontrol.simulation.trajectory import Trajectory

# Numbers in a table at most: more is no log of a robot, and fills the memory.
_MOST_NUMBERS, _MOST_BYTES = 50_000_000, 1_500_000_000

# Readings beyond are none: their squares overflow.
_LARGEST = 1e100


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """Readings of a motion at given times, with the inputs between them and the start.

    Parameters
    ----------
    time : array_like, shape (K,)
        Of the readings, ascending, s. The motion begins at 0.
    readings : array_like, shape (K, m)
        One row a time, in the order of ``sensors.readings``; NaN where a reading was lost.
    sensors : Sensors
        What was read, and its noise.
    rest_length : array_like, shape (α,), or Profile, optional
        Rest lengths that were commanded, m: constant, or over the time.
    force_density : array_like, shape (α,), or Profile, optional
        γ in place of rest lengths, N/m.
    nodes, velocities : array_like, shape (d, n), optional
        At time 0, m and m/s, as well as they are known; the reference shape at rest if not given.
    external_force : array_like, shape (d, n), 0, Profile or callable, optional
        A load, N, for a model with ``external_force=True``.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, times do not ascend, nothing is read,
        or a reading is infinite.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> sensors = tc.Sensors(structure=prism, string_length=0.001)
    >>> log = tc.Log([0.1, 0.2], np.ones((2, 9)), sensors, rest_length=np.full(9, 0.9))
    >>> log
    Log(2 times up to 0.2 s, 18 numbers read, 0 lost)
    """

    time: FloatArray = converted()
    readings: FloatArray = converted()
    sensors: Sensors = converted()
    rest_length: Any = None
    force_density: Any = None
    nodes: Any = None
    velocities: Any = None
    external_force: Any = None

    def __post_init__(self) -> None:
        put = object.__setattr__  # the dataclass is frozen for everyone else
        validation.instance(
            "sensors", self.sensors, Sensors, "make them by Sensors(structure=..., ...)"
        )
        time = validation.float_array("time", self.time)
        if time.ndim != 1 or not len(time):
            raise ValueError(f"time has shape {time.shape}, expected (K,): at least one time, s")
        late = np.flatnonzero(np.diff(time) <= 0)
        if len(late):
            k = int(late[0]) + 1
            raise ValueError(
                f"time[{k}] is {time[k]:g} s after {time[k - 1]:g} s, expected ascending times: "
                "sort the rows of the log, and drop what is there twice"
            )
        if time[0] < 0:
            raise ValueError(
                f"time[0] is {time[0]:g} s, expected 0 or later: the motion begins at 0"
            )
        shape = len(time), len(self.sensors.noise)
        meaning = f"a row for each time, with the {shape[1]} numbers of {self.sensors!r}"
        readings = validation.measured("readings", self.readings, shape, meaning)
        beyond = np.argwhere(np.abs(readings) > _LARGEST)
        if len(beyond):
            row, column = beyond[0]
            raise ValueError(
                f"readings[{row}, {column}] is {readings[row, column]:g}, expected at most "
                f"{_LARGEST:g}; NaN says that it was lost"
            )
        if np.isnan(readings).all():
            raise ValueError("readings are all NaN: nothing was read")
        if (self.rest_length is None) == (self.force_density is None):
            raise ValueError("expected one of rest_length and force_density: what was held")
        structure, load, end = self.sensors.structure, self.external_force, float(time[-1])
        if not callable(getattr(self, self.input)):  # which is asked when it is simulated
            checked_inputs(structure, self.rest_length, self.force_density, 0.0, end)
        if load is not None and not callable(load):
            shape = structure.nodes.shape
            as_pieces("external_force", load, shape, "one force per node", 0.0, end)
        put(self, "time", frozen(time))
        put(self, "readings", frozen(readings))
        for name in ("nodes", "velocities"):
            value = getattr(self, name)
            if value is not None:
                put(self, name, frozen(structure.checked_nodes(name, value)))

    @property
    def input(self) -> str:
        """``"rest_length"`` or ``"force_density"``."""
        return "force_density" if self.rest_length is None else "rest_length"

    @property
    def lost(self) -> int:
        """Number of readings that were lost."""
        return int(np.isnan(self.readings).sum())

    @property
    def first_read(self) -> float:
        """Time of the first reading that was not lost, s."""
        return float(self.time[~np.isnan(self.readings).all(axis=1)][0])

    def until(self, time: float) -> Log:
        """Return the log up to a time.

        Parameters
        ----------
        time : float
            s; at least one reading, that was not lost, must be before it.

        Returns
        -------
        Log
        """
        end = validation.positive_number("time", time, "s")
        kept, first = self.time <= end * (1 + 1e-12), self.first_read
        if first > end * (1 + 1e-12):
            raise ValueError(f"time is {end:g} s, but the first reading is at {first:g} s")
        return replace(self, time=self.time[kept], readings=self.readings[kept])

    def windows(self, length: float, run: Trajectory) -> tuple[Log, ...]:
        """Return the log in windows, each a log of its own with its own start.

        Fitted together, with ``start`` as unknowns, long logs have fewer minima, and a motion that
        cannot be predicted from its beginning is told by its parts.

        Parameters
        ----------
        length : float
            Of each window, s; the last may be shorter.
        run : Trajectory
            The motion, as well as it is known: that of a first model, or fit. Each window begins as
            its state that is nearest.

        Returns
        -------
        tuple of Log
            Without windows in which nothing was read. A ``delay`` of readings does not reach from
            one into the next: fit it first.
        """
        length = validation.positive_number("length", length, "s")
        validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
        last, end = float(self.time[-1]), float(run.time[-1] - run.time[0])
        if run.nodes.shape[:2] != self.sensors.structure.nodes.shape or end < last * (1 - 1e-9):
            raise ValueError(
                f"run is of {run.structure!r} up to {end:g} s, expected the structure of the "
                f"sensors up to {last:g} s"
            )
        count = max(1, int(np.ceil(last / length - 1e-9)))
        validation.refuse_time(f"length is {length:g} s", count, "windows", 1e-3)
        of = np.clip(np.ceil(self.time / length - 1e-9).astype(int) - 1, 0, count - 1)
        windows = []
        for i in np.unique(of[~np.isnan(self.readings).all(axis=1)]):
            begin, rows = i * length, of == i
            nearest = int(np.abs(run.time - run.time[0] - begin).argmin())
            held = {
                name: _later(getattr(self, name), begin) for name in (self.input, "external_force")
            }
            windows.append(
                replace(
                    self, time=np.maximum(self.time[rows] - begin, 0.0),
                    readings=self.readings[rows], nodes=run.nodes[:, :, nearest],
                    velocities=run.velocities[:, :, nearest], **held,
                )
            )  # fmt: skip
        return tuple(windows)

    @classmethod
    def of_run(
        cls, run: Trajectory, sensors: Sensors, times: object, seed: int | None = None
    ) -> Log:
        """Return what sensors would have read of a run in open loop.

        Parameters
        ----------
        run : Trajectory
            Its states at the times are those of the run that are nearest.
        sensors : Sensors
        times : array_like, shape (K,)
            s.
        seed : int, optional
            Of the noise; none if not given.

        Returns
        -------
        Log

        Raises
        ------
        TypeError, ValueError
            If an argument is of the wrong kind, a time is not one of the run, or the run is none in
            open loop.
        """
        validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
        validation.instance("sensors", sensors, Sensors, "make them by Sensors(structure=..., ...)")
        if run.scene is None or run.control is not None:
            raise ValueError(
                "run is under a controller, a copy or goes on from another, expected one in open "
                "loop that simulate(...) returned"
            )
        if seed is not None:
            seed = validation.whole_number("seed", seed, 0, validation.LARGEST_SEED)
        wanted = np.atleast_1d(validation.vector("times", times))
        if wanted.ndim != 1 or not len(wanted):
            raise ValueError(
                f"times has shape {wanted.shape}, expected (K,): one per reading, at least one"
            )
        first, last = float(run.time[0]), float(run.time[-1])
        outside = np.flatnonzero(np.abs(wanted - (first + last) / 2) > 0.5000001 * (last - first))
        if len(outside):
            k = int(outside[0])
            raise ValueError(
                f"times[{k}] is {wanted.flat[k]:g} s, expected times of the run, from {first:g} s "
                f"to {last:g} s"
            )
        columns = np.clip(np.searchsorted(run.time, wanted), 1, len(run.time) - 1)
        nearer = wanted - run.time[columns - 1] < run.time[columns] - wanted
        columns = columns - nearer
        generator = np.random.default_rng(seed)
        rows = []
        for k in columns:
            held = None if run.rest_length is None else run.rest_length[:, k]
            y = sensors.measure(
                run.nodes[:, :, k], run.tension[:, k], run.velocities[:, :, k], rest_length=held
            )
            rows.append(y if seed is None else sensors.disturb(y, generator))
        scene = run.scene
        return cls(
            run.time[columns] - scene.begin, np.array(rows), sensors, scene.rest_length,
            scene.force_density, scene.nodes, scene.velocities, scene.external_force,
        )  # fmt: skip

    def save(self, file: str | Path) -> Path:
        """Write the times and readings as a CSV table and return its path.

        Parameters
        ----------
        file : path

        Returns
        -------
        Path
        """
        path = validation.file_path("file", file)
        lines = [",".join(["time", *_columns(self.sensors)])]
        for time, row in zip(self.time.tolist(), self.readings.tolist(), strict=True):
            numbers = ("" if np.isnan(value) else repr(value) for value in row)
            lines.append(",".join([repr(time), *numbers]))
        return write_file(path, "\n".join(lines) + "\n")

    @classmethod
    def read(cls, file: str | Path, sensors: Sensors, **others: Any) -> Log:
        """Return a log from a CSV table with a column ``time`` and one a number read.

        Columns may come in any order; others are not read. Empty cells and ``nan`` are lost.

        Parameters
        ----------
        file : path
        sensors : Sensors
            Whose ``readings`` are the names of the columns, with the axis behind those of several
            numbers: ``"string_length 3"``, ``"node_position 0 x"``.
        **others
            Inputs and start, as of the class.

        Returns
        -------
        Log

        Raises
        ------
        ValueError
            If a column is missing or a cell is no number, with its line.
        """
        validation.instance("sensors", sensors, Sensors, "make them by Sensors(structure=..., ...)")
        path = validation.file_path("file", file)
        names = ["time", *_columns(sensors)]
        rows: list[list[float]] = []
        with (
            opened_file(path, _MOST_BYTES) as stream,
            TextIOWrapper(stream, "utf-8-sig", newline="") as text,
        ):
            table = csv.reader(text)
            header = [name.strip() for name in next(table, [])]
            missing = [name for name in names if name not in header]
            if missing:
                raise ValueError(
                    f"{file} has no column {missing[0]!r}; expected 'time' and {names[1:4]}..., "
                    f"found {header[:6]}"
                )
            places = [header.index(name) for name in names]
            for line in table:
                if not line:
                    continue
                rows.append([_number(line, i, file, table.line_num) for i in places])
                if len(rows) * len(names) > _MOST_NUMBERS:
                    raise ValueError(f"{file} has more than {_MOST_NUMBERS} numbers: read a part")
        array = np.array(rows).reshape(len(rows), len(names))
        return cls(array[:, 0], array[:, 1:], sensors, **others)

    def __repr__(self) -> str:
        numbers = self.readings.size - self.lost
        return (
            f"Log({len(self.time)} times up to {self.time[-1]:g} s, {numbers} numbers read, "
            f"{self.lost} lost)"
        )


def _later(held: Any, begin: float) -> Any:
    """Return what is held, as it is from a time on."""
    if isinstance(held, Profile):
        return replace(held, time=held.time - begin)
    if callable(held):
        return lambda time: held(time + begin)
    return held


def _columns(sensors: Sensors) -> list[str]:
    """Return a name for each number read: of several in a reading, with the axis."""
    of, names = sensors.reading_of, []
    first = {int(reading): i for i, reading in reversed(list(enumerate(of)))}
    for i, reading in enumerate(of):
        several = int((of == reading).sum()) > 1
        axis = " " + "xyz"[i - first[int(reading)]] if several else ""
        names.append(sensors.readings[reading] + axis)
    return names


def _number(line: list[str], place: int, file: object, number: int) -> float:
    text = line[place].strip() if place < len(line) else ""
    if not text:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{file}, line {number}: {text!r} is no number") from None
