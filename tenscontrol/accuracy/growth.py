"""Processor time and memory of each stage from structure to control, by number of members."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from tenscontrol.accuracy.measured_run import NOT_KNOWN
from tenscontrol.control import LQR, MPC
from tenscontrol.dynamics import LinearStrings, Model
from tenscontrol.interrupt import check, keeping
from tenscontrol.plant import LinearPlant, linearize, modes, reduce
from tenscontrol.progress import progress_bar
from tenscontrol.simulation import simulate
from tenscontrol.statics import Prestress, prestress
from tenscontrol.structure import Structure, prism_tower
from tenscontrol.tables import aligned, shown, write_csv
from tenscontrol.validation import IntArray, choice, frozen, instance, items, positive_number

# Stages of the towers that are measured if no structures are given: 12 to 100,788 members.
_STAGES = (1, 4, 14, 42, 140, 420, 1400, 4200)

# What the towers are: γ of the first group, N/m, stiffness of strings by that, sample, s.
_LEVEL, _STIFF, _SAMPLE, _MODES, _HORIZON = 10.0, 100.0, 0.02, 20, 20

# Shorter runs are repeated, and the least time counts; and what an exponent is not fitted to.
_SHORT, _REPEATS = 0.1, 3
_MEASURABLE_TIME, _MEASURABLE_MEMORY = 0.02, 2e7

# Least and largest exponent by which the next size is foretold, and sizes it is fitted to.
_EXPONENTS, _FITTED = (1.0, 3.0), 4


@dataclass(frozen=True)
class StopCost:
    """Processor time and memory of one stage at one size. One of :attr:`Growth.rows`.

    Attributes
    ----------
    stop : str
        What is done.
    members : int
        Bars and strings.
    seconds : float
        Processor time of all threads, s; NaN if it was not run.
    memory : float
        Largest memory of the process while it ran, less that before the first stage, bytes. NaN
        where the system does not tell.
    note : str
        Why it was not run, or failed; else empty.
    """

    stop: str
    members: int
    seconds: float
    memory: float
    note: str


@dataclass(frozen=True, eq=False)
class Growth:
    """Processor time and memory of each stage, by size. Made by :func:`growth`.

    Attributes
    ----------
    rows : tuple of StopCost
        One for each stage and size.
    """

    rows: tuple[StopCost, ...]

    @property
    def members(self) -> IntArray:
        """The sizes, ascending: bars and strings."""
        return frozen(np.unique([row.members for row in self.rows]))

    @property
    def stops(self) -> tuple[str, ...]:
        """The stages, from structure to control."""
        return tuple(dict.fromkeys(row.stop for row in self.rows))

    def of(self, stop: str) -> tuple[StopCost, ...]:
        """Return what a stage costs, where it was run, in order of size.

        Parameters
        ----------
        stop : str
        """
        choice("stop", stop, self.stops)
        found = [row for row in self.rows if row.stop == stop and not np.isnan(row.seconds)]
        return tuple(sorted(found, key=lambda row: row.members))

    def exponent(self, stop: str, quantity: str = "seconds") -> float:
        """Return p of cost ∝ membersᵖ, fitted to the largest sizes; NaN if there are too few.

        Parameters
        ----------
        stop : str
        quantity : {"seconds", "memory"}
            Times below 0.02 s and memory below 20 MB are not fitted.
        """
        choice("quantity", quantity, ("seconds", "memory"))
        least = _MEASURABLE_TIME if quantity == "seconds" else _MEASURABLE_MEMORY
        found = [(row.members, getattr(row, quantity)) for row in self.of(stop)]
        return _fitted([pair for pair in found if pair[1] >= least][-_FITTED:])

    def table(self) -> str:
        """Return time and memory as text, one stage a line, and the exponents.

        Returns
        -------
        str
        """
        sizes = self.members.tolist()
        cost = {(row.stop, row.members): row for row in self.rows}
        parts = []
        for quantity, unit, form in (("seconds", 1.0, ".2g"), ("memory", 1e6, ".0f")):
            lines = []
            for stop in self.stops:
                values = [getattr(cost[stop, size], quantity) / unit for size in sizes]
                cells = [shown(float(value), form) for value in values]
                lines.append([stop, *cells, shown(self.exponent(stop, quantity), ".2f")])
            title = "processor s" if quantity == "seconds" else "peak memory MB"
            parts.append(aligned([title, *map(str, sizes), "exponent"], lines))
        notes = [f"{r.stop}, {r.members} members: {r.note}" for r in self.rows if r.note]
        return "\n\n".join([*parts, "\n".join(notes)] if notes else parts)

    def to_csv(self, path: str | Path) -> Path:
        """Write all rows as CSV, and return where.

        Parameters
        ----------
        path : str or Path
        """
        return write_csv(path, ("stop", "members", "seconds", "memory", "note"), self.rows)

    def __repr__(self) -> str:
        return f"Growth({len(self.stops)} stops, {self.members[0]} to {self.members[-1]} members)"


def growth(
    structures: Sequence[Structure | Callable[[], Structure]] | None = None,
    *,
    seconds: float = 60.0,
    memory: float = 4e9,
    last: str = "MPC step",
    progress: bool = False,
) -> Growth:
    """Return time and memory of each stage: structure, prestress, plant, simulation, control.

    Parameters
    ----------
    structures : sequence of Structure, or of functions that return one, optional
        In order of size; functions are timed as the stage ``"structure"``. Towers of prisms of 12
        to 100,788 members if not given.
    seconds : float
        A stage is not run at a size where more processor time is foretold from smaller ones, s.
    memory : float
        The same for memory, bytes.
    last : str
        The last stage that is run: ``"structure"``, ``"prestress search"``, ``"prestress
        check"``, ``"stability"``, ``"linearize"``, ``"20 modes"``, ``"simulate"``, ``"reduce"``,
        ``"LQR"``, ``"LQR step"``, ``"MPC"`` or ``"MPC step"``.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Growth
        Up to there, if Ctrl-C or SIGTERM ends it; a warning says so.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Notes
    -----
    Strings are linear, a hundred times as stiff as their γ. The plant has rest lengths as its
    input; it is reduced to 20 modes for LQR and for MPC with a horizon of 20 samples of 0.02 s, of
    which a step is timed apart. The simulation lasts 0.02 s.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> found = tc.accuracy.growth([tc.prism(), tc.prism_tower(stages=2)], last="stability")
    >>> found.members, found.stops
    (array([12, 36]), ('structure', 'prestress search', 'prestress check', 'stability'))
    """
    if structures is None:
        makers: list[Any] = [lambda stages=stages: prism_tower(stages) for stages in _STAGES]
    else:
        makers = list(items("structures", structures, "structures, or functions that return one"))
    if not makers:
        raise ValueError("structures is empty, expected at least one")
    seconds = positive_number("seconds", seconds, "s")
    memory = positive_number("memory", memory, "bytes")
    stops = list(_STOPS)[: list(_STOPS).index(choice("last", last, _STOPS)) + 1]
    rows: list[StopCost] = []
    _Road(makers[0]).warm_up(stops)
    _forget_peak()
    base = _resident()
    total = len(makers) * len(stops)
    with (
        keeping("stops are measured", rows.__len__),
        progress_bar(total, progress, "measuring", "stops") as report,
    ):
        for maker in makers:
            road = _Road(maker)
            for stop in stops:
                check()
                rows.append(_measured(road, stop, rows, base, (seconds, memory)))
                report(len(rows))
    return Growth(tuple(rows))


class _Road:
    """One structure from stage to stage: each keeps what later ones need."""

    def __init__(self, maker: Structure | Callable[[], Structure]) -> None:
        self._maker = maker
        self._made: dict[str, Any] = {}

    def warm_up(self, stops: Sequence[str]) -> None:
        """Import what some stages import."""
        self._made["rest"] = prestress(prism_tower(2), _LEVEL)
        for stop in ("linearize", "reduce", "20 modes", "simulate", "LQR", "LQR step"):
            if stop in stops:
                _STOPS[stop].run(self)

    @property
    def members(self) -> int:
        """Bars and strings."""
        made: Structure = self._made["structure"]
        return len(made.bars) + len(made.strings)

    def lacks(self, what: str) -> bool:
        """Return whether an earlier stage has not made something, where there is something."""
        return bool(what) and what not in self._made

    def structure(self) -> None:
        made = self._maker() if callable(self._maker) else self._maker
        instance("structures", made, Structure, "make them by prism_tower(...), or a function")
        self._made["structure"] = made

    def search(self) -> None:
        self._made["rest"] = prestress(self._made["structure"], _LEVEL)

    def check(self) -> None:
        rest: Prestress = self._made["rest"]
        prestress(rest.structure, rest.force_density)

    def stability(self) -> None:
        rest: Prestress = replace(self._made["rest"])  # without what it remembers
        self._made["stability"] = rest.stability

    def linearize(self) -> None:
        rest: Prestress = self._made["rest"]
        strings = LinearStrings(stiffness=_STIFF * float(rest.force_density.max()))
        model = Model(rest.structure, strings=strings)
        self._made["plant"] = linearize(model, rest, input="rest_length")

    def modes(self) -> None:
        plant: LinearPlant = self._made["plant"]
        modes(plant, min(_MODES, plant.degrees_of_freedom))

    def simulate(self) -> None:
        plant: LinearPlant = self._made["plant"]
        simulate(plant.model, _SAMPLE, plant.nodes, rest_length=plant.rest_length, error="none")

    def reduce(self) -> None:
        plant: LinearPlant = self._made["plant"]
        self._made["reduced"] = reduce(plant, min(_MODES, plant.degrees_of_freedom))

    def design(self) -> None:
        self._made["LQR"] = LQR(self._made["reduced"], sample_time=_SAMPLE)

    def predict(self) -> None:
        plant: LinearPlant = self._made["reduced"]
        self._made["MPC"] = MPC(plant, sample_time=_SAMPLE, horizon=_HORIZON)

    def command(self, controller: str) -> None:
        law, plant = self._made[controller], self._made["plant"]
        law.reset()
        law.command(0.0, plant.nodes, 0 * plant.nodes)


class _Stop(NamedTuple):
    run: Callable[[_Road], None]
    needs: str = ""  # what an earlier stage makes


# What is done, in order.
_STOPS = MappingProxyType(
    {
        "structure": _Stop(_Road.structure),
        "prestress search": _Stop(_Road.search),
        "prestress check": _Stop(_Road.check, "rest"),
        "stability": _Stop(_Road.stability, "rest"),
        "linearize": _Stop(_Road.linearize, "rest"),
        "20 modes": _Stop(_Road.modes, "plant"),
        "simulate": _Stop(_Road.simulate, "plant"),
        "reduce": _Stop(_Road.reduce, "plant"),
        "LQR": _Stop(_Road.design, "reduced"),
        "LQR step": _Stop(lambda road: road.command("LQR"), "LQR"),
        "MPC": _Stop(_Road.predict, "reduced"),
        "MPC step": _Stop(lambda road: road.command("MPC"), "MPC"),
    }
)


def _measured(
    road: _Road, stop: str, rows: Sequence[StopCost], base: float, budget: tuple[float, float]
) -> StopCost:
    """Run a stage and return what it costs, or why it is not run."""
    run, needs = _STOPS[stop]
    if road.lacks(needs):
        return StopCost(stop, road.members, NOT_KNOWN, NOT_KNOWN, "needs an earlier stop")
    if stop != "structure":
        before = sorted((row for row in rows if row.stop == stop), key=lambda row: row.members)
        note = _beyond(before, road.members, budget)
        if note:
            return StopCost(stop, road.members, NOT_KNOWN, NOT_KNOWN, note)
    _forget_peak()
    spent = np.inf
    try:
        for _ in range(_REPEATS):
            start = process_time()
            run(road)
            spent = min(spent, process_time() - start)
            if spent > _SHORT:
                break
    except (ValueError, ArithmeticError, MemoryError) as error:
        if stop == "structure":
            raise
        return StopCost(stop, road.members, NOT_KNOWN, NOT_KNOWN, f"failed: {error}")
    return StopCost(stop, road.members, spent, max(0.0, _peak() - base), "")


def _beyond(before: Sequence[StopCost], members: int, budget: tuple[float, float]) -> str:
    """Return why a stage is not run at a size, foretold from smaller ones, or nothing."""
    run = [row for row in before if not np.isnan(row.seconds)]
    if not run:
        return ""
    for quantity, unit, least, most in zip(
        ("seconds", "memory"), ("s", "bytes"), (_MEASURABLE_TIME, _MEASURABLE_MEMORY), budget,
        strict=True,
    ):  # fmt: skip
        cost = [(row.members, max(getattr(row, quantity), least)) for row in run]
        power = float(np.clip(_fitted(cost[-2:]), *_EXPONENTS)) if len(cost) > 1 else 1.0
        foretold = cost[-1][1] * (members / cost[-1][0]) ** power
        if foretold > most:
            return f"about {foretold:.2g} {unit} foretold, beyond the budget of {most:g} {unit}"
    return ""


def _fitted(pairs: Sequence[tuple[float, float]]) -> float:
    """Return p of y ∝ xᵖ by least squares, NaN if there is but one x."""
    if len({x for x, _ in pairs}) < 2:
        return NOT_KNOWN
    x, y = np.log(np.array(pairs)).T
    return float(np.polyfit(x, y, 1)[0])


def _resident() -> float:
    """Return the memory of this process, bytes; its largest so far where no more is told."""
    return _told("VmRSS") or _peak()


def _peak() -> float:
    """Return the largest memory of this process since it was last forgotten, bytes."""
    peak = _told("VmHWM")
    if peak is None and sys.platform != "win32":
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        peak *= 1 if sys.platform == "darwin" else 1024
    return NOT_KNOWN if peak is None else float(peak)


def _told(name: str) -> float | None:
    """Return an entry of Linux's table of this process, bytes."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    for line in status.read_text(encoding="ascii").splitlines():
        if line.startswith(name + ":"):
            return 1024.0 * float(line.split()[1])
    return None


def _forget_peak() -> None:
    """Let Linux count the largest memory anew; elsewhere it is that of all stages so far."""
    gc.collect()
    if sys.platform == "linux":
        with contextlib.suppress(AttributeError):  # musl has none
            ctypes.CDLL(None).malloc_trim(0)  # what is freed is given back
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
