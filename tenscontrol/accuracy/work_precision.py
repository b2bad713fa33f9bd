"""Error against run time of our methods and of peers, on the user's own motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.converged_motion import ConvergedMotion, converged_motion
from tenscontrol.accuracy.measured_run import (
    FINER,
    NOT_KNOWN,
    Bench,
    Measurement,
    TimedRun,
    as_taken,
    checked_settings,
    default_settings,
    method_named,
)
from tenscontrol.accuracy.open_loop import open_loop_of
from tenscontrol.accuracy.peers.peer import Peer
from tenscontrol.accuracy.predictability import Predictability, predictability
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.integrate.methods import METHODS, Method
from tenscontrol.interrupt import keeping
from tenscontrol.progress import progress_bar
from tenscontrol.simulation.scene import Scene
from tenscontrol.tables import aligned, markdown, shown, write_csv

# An error below so many times that of the reference is not resolved.
_RESOLVED = 3.0

# How often a run is repeated before the next one is.
_IN_A_ROW = 5

_HEAD = (
    "method", "setting", "error m", "of size", "at end m", "time s", "building s", "evals", "steps",
    "rejected", "switches", "energy", "momentum", "angular", "bars m",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Ratios:
    """Run time of other methods by that of our fastest, at equal error.

    Made by :meth:`WorkPrecision.ratios`.

    Attributes
    ----------
    errors : tuple of float, length E
        m.
    best : tuple of str, length E
        Our fastest method at each error; empty where none reaches it.
    time : ndarray, shape (E,)
        Its run time, s; NaN where none reaches the error.
    against : tuple of str, length P
        What it is compared with.
    ratio : ndarray, shape (E, P)
        Above 1 where ours is faster; NaN where one of the two does not reach the error.
    reached : ndarray of bool, shape (E, P)
        Whether the other one reaches the error.
    """

    errors: tuple[float, ...]
    best: tuple[str, ...]
    time: FloatArray
    against: tuple[str, ...]
    ratio: FloatArray
    reached: np.ndarray

    @property
    def least(self) -> float:
        """The smallest ratio; NaN if no error is reached by both."""
        known = self.ratio[np.isfinite(self.ratio)]
        return float(known.min()) if known.size else NOT_KNOWN

    def table(self) -> str:
        """Return the ratios as text, one error a line."""
        head = ["error m", "ours", "time s", *self.against]
        rows = []
        for i, error in enumerate(self.errors):
            cells = [
                shown(float(self.ratio[i, j]), ".3g") if self.reached[i, j] else "not reached"
                for j in range(len(self.against))
            ]
            rows.append([f"{error:.0e}", self.best[i] or "-", shown(float(self.time[i])), *cells])
        return aligned(head, rows, left=2)

    def __repr__(self) -> str:
        return f"Ratios({len(self.errors)} errors, {len(self.against)} others)"


@dataclass(frozen=True, eq=False)
class WorkPrecision:
    """Error against run time of methods on one case. Made by :func:`work_precision`.

    Attributes
    ----------
    case : Scene
        As compared: its duration is cut where the motion cannot be predicted longer.
    rows : tuple of Measurement
        One for each run, also for those that failed.
    reference : ConvergedMotion
        What errors are measured against.
    predictability : Predictability or None
        How perturbations grow; None where the reference was given.
    refused : tuple of (str, str)
        Peers that do not take part, with their reason.
    own_laws : tuple of (str, str)
        Peers whose law is another than that of the case, and in what: their errors are against
        their own motions, at a setting 8 times finer than their finest.
    """

    case: Scene
    rows: tuple[Measurement, ...]
    reference: ConvergedMotion
    predictability: Predictability | None
    refused: tuple[tuple[str, str], ...]
    own_laws: tuple[tuple[str, str], ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of our own methods that were run."""
        return tuple(dict.fromkeys(row.method for row in self.rows if not row.is_peer))

    @property
    def peers(self) -> tuple[str, ...]:
        """Names of the peers that were run."""
        return tuple(dict.fromkeys(row.method for row in self.rows if row.is_peer))

    @property
    def failures(self) -> tuple[Measurement, ...]:
        """The runs that failed."""
        return tuple(row for row in self.rows if row.failure)

    def of(self, method: str) -> tuple[Measurement, ...]:
        """Return the runs of one method.

        Parameters
        ----------
        method : str
            Or a peer.

        Raises
        ------
        ValueError
            If it was not run.
        """
        validation.choice("method", method, (*self.methods, *self.peers))
        return tuple(row for row in self.rows if row.method == method)

    def is_resolved(self, row: Measurement) -> bool:
        """Return whether the error of a run is well above that of the reference.

        Parameters
        ----------
        row : Measurement
        """
        validation.instance("row", row, Measurement, "one of the rows")
        return row.error > _RESOLVED * self.reference.error

    def time_at(self, method: str, error: float) -> float:
        """Return the run time at which a method has an error, s.

        It is interpolated between the logarithms of the runs; to a larger
        error than all of them it is that of the fastest.

        Parameters
        ----------
        method : str
            Or a peer.
        error : float
            m.

        Returns
        -------
        float
            NaN where the method does not reach the error.
        """
        error = validation.positive_number("error", error, "m")
        return time_to_reach(self.of(method), error, self.reference.error)

    def fastest(self, error: float) -> tuple[str, float]:
        """Return which of our methods is fastest at an error, and its run time.

        Parameters
        ----------
        error : float
            m.

        Returns
        -------
        method : str
            Empty where none reaches the error.
        time : float
            s; NaN where none does.
        """
        times = {name: self.time_at(name, error) for name in self.methods}
        known = {name: time for name, time in times.items() if np.isfinite(time)}
        if not known:
            return "", NOT_KNOWN
        name = min(known, key=lambda method: known[method])
        return name, known[name]

    def ratios(
        self,
        errors: Sequence[float] = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9),
        against: Sequence[str] | None = None,
    ) -> Ratios:
        """Return how many times as long others take as our fastest, at equal error.

        Parameters
        ----------
        errors : sequence of float
            m.
        against : sequence of str, optional
            Peers, or methods of our own; all peers if not given.
        """
        names = (
            self.peers
            if against is None
            else validation.items("against", against, "names of methods")
        )
        for i, other in enumerate(names):
            validation.choice(f"against[{i}]", other, (*self.methods, *self.peers))
        errors = [
            validation.positive_number(f"errors[{i}]", error, "m")
            for i, error in enumerate(validation.items("errors", errors, "numbers in m"))
        ]
        best = [self.fastest(error) for error in errors]
        others = np.array([[self.time_at(name, error) for name in names] for error in errors])
        others = others.reshape(len(best), len(names))
        time = np.array([seconds for _, seconds in best])
        return Ratios(
            errors=tuple(errors),
            best=tuple(name for name, _ in best),
            time=frozen(time),
            against=names,
            ratio=frozen(others / time[:, None]),
            reached=frozen(np.isfinite(others)),
        )

    def summary(self) -> str:
        """Return what was compared, against what, and who did not take part, as text."""
        lines = [repr(self.case)]
        lines += [self.case.note] * bool(self.case.note)
        if self.predictability is not None:
            lines.append(self.predictability.summary())
        lines.append(self.reference.summary())
        lines += [f"{name} does not take part: {why}" for name, why in self.refused]
        lines += [
            f"{name} has a law of its own, {law}: its errors are against its own motion at a "
            f"setting {FINER:g} times finer than its finest"
            for name, law in self.own_laws
        ]
        return "\n".join(lines)

    def table(self) -> str:
        """Return all runs as text, with what was compared above and what failed below.

        Errors marked ``<~`` are not resolved by the reference. Energy is as part of
        what the motion exchanges, momentum in kg m/s, angular momentum in
        kg m²/s; ``bars m`` is how far a bar is off its length.
        """
        failed = [f"{row.method} at {row.setting:g} failed: {row.failure}" for row in self.failures]
        paragraphs = [self.summary(), aligned(_HEAD, [self._cells(row) for row in self.rows])]
        return "\n\n".join([*paragraphs, *(["\n".join(failed)] if failed else [])])

    def to_markdown(self) -> str:
        """Return the same as :meth:`table` in Markdown."""
        failed = [f"- {row.method} at {row.setting:g}: {row.failure}" for row in self.failures]
        above = "\n".join(f"- {line}" for line in self.summary().splitlines())
        title = self.case.name or "Accuracy"
        paragraphs = [f"# {title}", above, markdown(_HEAD, [self._cells(row) for row in self.rows])]
        return (
            "\n\n".join([*paragraphs, *(["Failed:", "\n".join(failed)] if failed else [])]) + "\n"
        )

    def to_csv(self, path: str | Path) -> Path:
        """Write all runs with all figures in full precision.

        Parameters
        ----------
        path : str or Path
        """
        return write_csv(path, [field.name for field in fields(Measurement)], self.rows)

    def _cells(self, row: Measurement) -> list[str]:
        if row.failure:
            error = "failed"
        else:
            error = ("" if self.is_resolved(row) else "<~") + shown(row.error)
        figures = [
            row.relative_error,
            row.end_error,
            row.time,
            row.build_time,
            row.evaluations,
            row.steps,
            row.rejections,
            row.switches,
            row.energy_error,
            row.momentum_drift,
            row.angular_momentum_drift,
            row.bar_length_drift,
        ]
        return [row.method, f"{row.setting:.3g}", error, *map(shown, figures)]

    def __repr__(self) -> str:
        return (
            f"WorkPrecision({len(self.rows)} runs of {len(self.methods)} methods and "
            f"{len(self.peers)} peers, {len(self.failures)} failed)"
        )


def work_precision(
    scene: Scene,
    methods: Sequence[str] | None = None,
    settings: Mapping[str, Sequence[float]] | None = None,
    peers: Sequence[Peer] = (),
    reference: ConvergedMotion | None = None,
    repeats: int = 5,
    outputs: int = 100,
    finest: float = 1e-9,
    progress: bool = False,
) -> WorkPrecision:
    """Return error and run time of integration methods on one motion (work-precision diagram).

    Errors are distances of nodes from a reference solution, whose own error is estimated. If a
    small change of the start grows so fast that round-off alone would cause errors of ``finest``,
    the comparison ends earlier, and the result says so. Run times are medians of processor time
    of a second call of :func:`simulate`, with its checks and its trajectory. The time for building
    and compiling in the first call is the column ``building``.

    Parameters
    ----------
    scene : Scene
        Of a scene with a controller, the open loop with what its actuators
        hold at the start; the result says so.
    methods : sequence of str, optional
        Our own; all of them if not given.
    settings : mapping of str to sequence of float, optional
        Steps, s, or tolerances, by the name of a method or peer; steps that fit the case, or 1e-3
        to 1e-12, where not given. No step is longer than from one output to the next.
    peers : sequence of Peer
        Integrators of other packages to measure beside.
    reference : ConvergedMotion, optional
        From :func:`converged_motion` of the same case; then nothing is cut.
    repeats : int
        Runs of which the median time is taken; fewer where they take seconds.
    outputs : int
        Times at which errors are looked at, equally spaced.
    finest : float
        Smallest error that is to be resolved, m.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    WorkPrecision
        Of the runs done by then, if Ctrl-C or SIGTERM ends it; a warning says so.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name.
    ArithmeticError
        If the motion runs away.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> case = tc.Scene(tc.Model(prism), 0.5, force_density=gamma)
    >>> found = tc.work_precision(
    ...     case, ["rk4"], {"rk4": [0.025, 0.0125]}, repeats=1, outputs=10)
    >>> coarse, fine = found.rows
    >>> coarse.steps, fine.steps, 12 < coarse.error / fine.error < 20
    (20, 40, True)
    """
    case = open_loop_of(scene)
    finest = validation.positive_number("finest", finest, "m")
    repeats = validation.whole_number("repeats", repeats, 1, validation.MOST_RUNS)
    outputs = validation.whole_number("outputs", outputs, 1, validation.MOST_RUNS)
    names = (
        tuple(METHODS)
        if methods is None
        else validation.items("methods", methods, "names of methods")
    )
    named = (method_named(name, f"methods[{i}]") for i, name in enumerate(names))
    chosen = list(dict.fromkeys(named))
    peers = validation.items("peers", peers, "peers")
    for i, peer in enumerate(peers):
        validation.instance(f"peers[{i}]", peer, Peer, "make one by subclassing Peer")
    given = _checked_settings(settings, chosen, peers)
    wanted = {m: given.get(m.name) or default_settings(m, case) for m in chosen}
    theirs = {p: given.get(p.name) or p.settings for p in peers}
    other = [(p, x) for p in peers for x in theirs[p]]
    total = 2 + 2 * (sum(map(len, wanted.values())) + len(other))
    done: list[TimedRun] = []
    keep_rows = keeping("runs are measured", done.__len__)
    with keep_rows, progress_bar(total, progress, "measuring", "runs") as report:
        growth: Predictability | None = None
        if reference is None:
            full = case.duration
            growth = predictability(case, finest, report=lambda time: report(time / full))
            case = replace(case, duration=growth.horizon)
            cut = case.duration
            reference = converged_motion(case, outputs, lambda time: report(1 + time / cut))
        _refuse_other_times(reference, case)
        refusals = {peer.name: peer.refuse(case) for peer in peers}
        bench = Bench(case, reference)
        spacing = case.duration / len(reference.time)
        runs = [partial(bench.own, m, x) for m in chosen for x in as_taken(m, wanted[m], spacing)]
        runs += [
            partial(bench.peer, p, x, min(theirs[p])) for p, x in other if refusals[p.name] is None
        ]
        for run in runs:
            done.append(run())
            report(2 + len(done))
        # In turns: a machine that slows down does so for all.
        for count in range(_IN_A_ROW, repeats + _IN_A_ROW, _IN_A_ROW):
            for i, timed in enumerate(done):
                timed.repeat(min(count, repeats))
                share = (count - _IN_A_ROW + _IN_A_ROW * i / len(done)) / repeats
                report(2 + len(done) * (1 + min(share, 1)))
        report(total)
    rows = tuple(timed.measurement() for timed in done)
    refused = tuple((name, why) for name, why in refusals.items() if why is not None)
    laws = {peer.name: peer.own_law(case) for peer in peers if refusals[peer.name] is None}
    own = tuple((name, law) for name, law in laws.items() if law is not None)
    return WorkPrecision(case, rows, reference, growth, refused, own)


def _checked_settings(
    settings: Mapping[str, Sequence[float]] | None, methods: Sequence[Method], peers: Sequence[Peer]
) -> dict[str, tuple[float, ...]]:
    units = {method.name: "s" if method.setting == "step" else "1" for method in methods}
    units |= {peer.name: "s or 1" for peer in peers}
    checked: dict[str, tuple[float, ...]] = {}
    if settings is None:
        return checked
    validation.instance("settings", settings, Mapping, "settings by the name of a method or peer")
    for name, values in settings.items():
        validation.choice("a key of settings", name, units)
        checked[name] = checked_settings(f"settings[{name!r}]", values, units[name])
    return checked


def _refuse_other_times(reference: ConvergedMotion, case: Scene) -> None:
    validation.instance(
        "reference",
        reference,
        ConvergedMotion,
        "make one by tenscontrol.accuracy.converged_motion(scene)",
    )
    end = float(reference.time[-1])
    if abs(end / case.duration - 1) > 1e-12:
        raise ValueError(
            f"reference ends at {end:g} s, expected the duration of the case, {case.duration:g} s"
        )
    if reference.states.shape[0] != len(case.state):
        raise ValueError(
            f"reference has {reference.states.shape[0]} states, expected those of the case: "
            f"{len(case.state)}"
        )


def frontier(rows: Sequence[Measurement], floor: float) -> tuple[FloatArray, FloatArray]:
    """Return times and errors, at least ``floor``, of runs that no faster run beats."""
    points = sorted(
        (row.time, max(row.error, floor)) for row in rows if not row.failure and row.time > 0
    )
    best: list[tuple[float, float]] = []
    for time, error in points:
        if np.isfinite(error) and (not best or error < best[-1][1]):
            best.append((time, error))
    envelope = np.array(best).reshape(-1, 2)
    return envelope[:, 0], envelope[:, 1]


def time_to_reach(rows: Sequence[Measurement], error: float, floor: float) -> float:
    """Return the run time at which a method has an error, s, between the logarithms of its runs.

    To a larger error than any, that of the fastest run; a smaller one is not reached (NaN).
    """
    times, errors = frontier(rows, floor)
    if not len(times) or error < errors[-1]:
        return NOT_KNOWN
    if error >= errors[0]:
        return float(times[0])
    falling = np.log(np.maximum(errors, np.finfo(float).tiny))
    return float(np.exp(np.interp(-np.log(error), -falling, np.log(times))))
