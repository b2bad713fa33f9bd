"""
Laws in γ and in rest lengths against the stiffness of the strings
==================================================================

A study for a structure of your own: copy this file beside your script, and ::

    from stiffness_study import draw, stiffness_report

``plot_control_stiffness.py`` is an example. Winches hold rest lengths between samples. A law in γ
is undone by the motion between samples, the more so the stiffer the strings. For each stiffness
LQR and MPC are designed with either input, judged as linear sampled loops, and run on the
nonlinear structure.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

import tenscontrol as tc
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control import Controller, ControlWarning, HeldLoop, Status, held_loop
from tenscontrol.interrupt import check, interruptible, keeping
from tenscontrol.plant import LinearPlant, Modes
from tenscontrol.plant.linear_plant import INPUTS
from tenscontrol.progress import progress_bar
from tenscontrol.robustness import farthest_node
from tenscontrol.shape import ShapeTarget
from tenscontrol.simulation import SimulationError, simulate
from tenscontrol.statics import Prestress
from tenscontrol.structure.bar_geometry import refuse_wrong_bar_lengths
from tenscontrol.tables import aligned
from tenscontrol.validation import (
    choice,
    float_array,
    instance,
    positive,
    positive_number,
    truth,
)

CONTROLLERS = ("LQR", "MPC")
NAMES = {"force_density": "γ", "rest_length": "rest lengths"}

# Largest γ that laws in γ command, if the user gives none: so many times the largest at rest.
REACH = 3.0

# Part of a run, at its end, in which the structure is to be at its place.
LATE = 0.25

# Steps of RK4: rad of the fastest vibration, and how many a sample at least.
RADIANS, STEPS = 0.3, 10


# ---- the report ----


@dataclass(frozen=True)
class StiffnessRun:
    """One controller on the nonlinear structure, with rest lengths held between samples.

    ``error`` is the largest distance of a node from its place in the last quarter of the run, m,
    motion as one body apart; None where the run failed, and then ``failure`` says why.
    ``least_force_density`` is the smallest γ of any string at ten moments a sample, N/m,
    ``slackened`` whether a string was slack at any moment, and ``commands_not_ok`` how many
    commands had another status than ``"ok"``.
    """

    controller: str
    input: str
    error: float | None
    failure: str | None
    least_force_density: float
    slackened: bool
    commands_not_ok: int

    def __str__(self) -> str:
        return f"{self.controller} in {NAMES[self.input]}"


@dataclass(frozen=True)
class StiffnessRow:
    """Four loops with strings of one stiffness, N/m, and damping, N s/m.

    ``held`` is the linear loop of the law in γ where winches hold rest lengths, ``radius`` the
    spectral radius of that of the law in rest lengths, both without the modes ``left_alone``, which
    no string reaches and which the runs do not start with; ``runs`` are LQR and MPC in γ, then both
    in rest lengths.
    """

    stiffness: float
    damping: float
    held: HeldLoop
    radius: float
    left_alone: Modes
    runs: tuple[StiffnessRun, ...]


@dataclass(frozen=True)
class StiffnessReport:
    """Four loops over the stiffness. Made by :func:`stiffness_report`.

    ``sample_time`` and ``duration`` of each run, s; ``tolerance``, the largest error of a run that
    holds the target, m; ``rows`` from soft to stiff.
    """

    sample_time: float
    duration: float
    tolerance: float
    rows: tuple[StiffnessRow, ...]

    @property
    def stiffness(self) -> FloatArray:
        """Stiffness k of each row, N/m, shape (K,)."""
        return frozen(np.array([row.stiffness for row in self.rows]))

    def runs(self, controller: str, input: str) -> tuple[StiffnessRun, ...]:
        """Return the runs of a loop (``"LQR"`` or ``"MPC"``, and its input), from soft to stiff."""
        loop = choice("controller", controller, CONTROLLERS), choice("input", input, INPUTS)
        found = [run for row in self.rows for run in row.runs]
        return tuple(run for run in found if (run.controller, run.input) == loop)

    def holds(self, controller: str, input: str) -> np.ndarray:
        """Return at which stiffness a loop holds the target, shape (K,).

        Its run comes to its end within the tolerance. For γ the linear loop must say so as
        well (:attr:`HeldLoop.holds`): a run that is close to the target may settle too slowly.
        """
        errors = [run.error for run in self.runs(controller, input)]
        near = [error is not None and error <= self.tolerance for error in errors]
        linear = [input == "rest_length" or row.held.holds for row in self.rows]
        return frozen(np.logical_and(near, linear))

    def limit(self, controller: str, input: str) -> float | None:
        """Return the largest stiffness tried up to which a loop holds the target, N/m, or None."""
        count = int(np.cumprod(self.holds(controller, input)).sum())
        return self.rows[count - 1].stiffness if count else None

    def table(self) -> str:
        """Return one line a stiffness, as text.

        The settling rate of the law in γ over that of its design and of the law in rest
        lengths, 1/s, both by the linear loop; the errors of the runs, mm, marked ``slack``
        where a string was slack, or ``failed``.
        """
        names = [str(run) for run in self.rows[0].runs]
        head = ["k, N/m", "γ: rate/design", *names[:2], "rest lengths: rate", *names[2:]]
        rows = []
        for row in self.rows:
            errors = [
                "failed"
                if run.error is None
                else f"{1e3 * run.error:.3f}{' slack' if run.slackened else ''}"
                for run in row.runs
            ]
            rate = f"{-np.log(row.radius) / self.sample_time:.2g}"
            ratio = f"{row.held.rate_ratio:.3f}"
            rows.append([f"{row.stiffness:g}", ratio, *errors[:2], rate, *errors[2:]])
        return aligned(head, rows)

    def summary(self) -> str:
        """Return the table, up to which stiffness each loop holds, and what went wrong, as text."""
        lines = [
            f"rest lengths held over samples of {self.sample_time:g} s; errors of the last quarter "
            f"of {self.duration:g} s, mm; rates in 1/s",
            self.table(),
        ]
        lines += [f"{run}: {self._verdict(run)}" for run in self.rows[0].runs]
        for row in self.rows:
            alone = zip(row.left_alone.frequency, row.left_alone.label, strict=True)
            listed = ", ".join(f"{frequency:.4g} Hz ({label})" for frequency, label in alone)
            if listed:
                lines.append(f"left alone, reached by no string: {row.stiffness:g} N/m: {listed}")
            for run in row.runs:
                where = f"{row.stiffness:g} N/m, {run}"
                if run.failure is not None:
                    lines.append(f"failed: {where}: {run.failure}")
                if run.commands_not_ok:
                    lines.append(f"commands not ok: {where}: {run.commands_not_ok}")
        return "\n".join(lines)

    def _verdict(self, loop: StiffnessRun) -> str:
        k = self.stiffness
        held = int(np.cumprod(self.holds(loop.controller, loop.input)).sum())
        within = f"within {1e3 * self.tolerance:g} mm"
        if held == len(k):
            return f"holds {within} at all that was tried, up to {k[-1]:g} N/m"
        why, error = "", self.runs(loop.controller, loop.input)[held].error
        if error is not None and error <= self.tolerance:
            ratio = self.rows[held].held.rate_ratio
            why = f" (settles at {100 * ratio:.2g} % of its design)" if ratio > 0 else " (unstable)"
        if held == 0:
            return f"does not hold {within} at {k[0]:g} N/m{why}, the softest that was tried"
        return f"holds {within} up to {k[held - 1]:g} N/m, not at {k[held]:g} N/m{why}"

    def __repr__(self) -> str:
        ends = f"{self.rows[0].stiffness:g} to {self.rows[-1].stiffness:g} N/m"
        return f"StiffnessReport({len(self.rows)} rows, {ends}, sample time {self.sample_time:g} s)"


def stiffness_report(
    at: Prestress | ShapeTarget,
    stiffness: Sequence[float],
    *,
    sample_time: float,
    damping: float | Callable[[float], float] = 0.0,
    reference: tc.Reference | None = None,
    push: float = 0.02,
    duration: float = 4.0,
    tolerance: float = 1e-3,
    weights: Callable[[LinearPlant], tuple[Any, Any]] | None = None,
    horizon: int = 20,
    max_force_density: object = None,
    winches: tc.Winches | None = None,
    integration_step: float | None = None,
    progress: bool = False,
) -> StiffnessReport:
    """Try laws in γ and in rest lengths with strings from soft to stiff.

    A run that runs away, or is not accurate, is a row of the report that says so. All controllers
    are designed before the first run. The linear loops are those of LQR, see
    :func:`tenscontrol.control.held_loop` for γ; without limits MPC has the same gains.

    Parameters
    ----------
    at : Prestress or ShapeTarget
        The equilibrium to be held. Its force densities and its load are those of every stiffness.
    stiffness : array_like, shape (K,)
        k of every string, N/m, ascending.
    sample_time : float
        s.
    damping : float or callable
        c of every string, N s/m, or a function of k that returns it.
    reference : Reference, optional
        The way to the equilibrium, for example ``shape_path(...).reference()``. MPC starts at
        its first shape and follows it; it ends before the last quarter of the run. LQR, which
        follows nothing, is pushed as without one.
    push : float
        Speed of the fastest node at the start of the other runs, m/s. They start in the shape to
        be held, in a direction that is the same for all.
    duration : float
        Of each run, s.
    tolerance : float
        Largest error of a run that holds the target, m.
    weights : callable, optional
        ``weights(plant)`` returns Q and R. If not given, those of :func:`energy_weights`, with
        a tenth of R for γ, by mode for rest lengths: what MPC takes.
    horizon : int
        Of MPC, samples.
    max_force_density : float or array_like, shape (α,), optional
        Largest γ that laws in γ command, N/m; three times the largest at rest if not given.
    winches : Winches, optional
        In all runs. Laws in rest lengths know of them. MPC that follows a reference starts where
        its force densities say, or those of the equilibrium if it has none.
    integration_step : float, optional
        Longest step of RK4, s; 0.3 rad of the fastest vibration if not given, and a tenth of a
        sample at most.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    StiffnessReport

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, or no controller can be designed
        for a stiffness.
    KeyboardInterrupt
        If the user interrupts before the first row is done.

    Warns
    -----
    InterruptionWarning
        If the user interrupts later: the rows done by then are returned.

    Examples
    --------
    >>> rest = tc.prestress(tc.prism(), force_density=17.3205)
    >>> report = stiffness_report(
    ...     rest, [1e2, 1e4], sample_time=0.02, damping=lambda k: 0.02 * np.sqrt(k), duration=0.4)
    >>> report.limit("MPC", "force_density"), report.limit("MPC", "rest_length")
    (100.0, 10000.0)
    """
    if isinstance(at, ShapeTarget):
        at = at.prestress
    instance("at", at, Prestress, "make one by prestress(...) or shape_target(...)")
    if at.structure.parent is not None:
        raise ValueError(
            "at is of a subdivided structure, whose segments have no winches: give the "
            "prestress of the structure before subdivide(...)"
        )
    k = _checked_stiffness(stiffness)
    if winches is not None:
        instance("winches", winches, tc.Winches, "make them by Winches(rate=...)")
    if weights is not None and not callable(weights):
        raise TypeError(
            f"weights is a {type(weights).__name__}, expected a function weights(plant) -> Q, R"
        )
    if max_force_density is None:
        max_force_density = REACH * float(at.force_density.max(initial=0.0))
    if integration_step is not None:
        integration_step = positive_number("integration_step", integration_step, "s")
    duration = positive_number("duration", duration, "s")
    task = Task(
        at=at,
        sample_time=positive_number("sample_time", sample_time, "s"),
        reference=None if reference is None else _checked_reference(reference, at, duration),
        push=positive_number("push", push, "m/s"),
        duration=duration,
        weights=weights,
        horizon=horizon,
        reach=max_force_density,
        winches=winches,
        integration_step=integration_step,
    )
    tolerance = positive_number("tolerance", tolerance, "m")
    truth("progress", progress, "whether to show a progress bar")
    designs: list[Design] = []
    with interruptible():  # CasADi may lose a key while it builds
        for each in k:
            designs.append(task.design(each, _damping(damping, each)))
            check()
    if reference is not None:
        _refuse_other_end(reference, designs[0].controllers[0].plant, tolerance)
    rows: list[StiffnessRow] = []
    kept = keeping("rows are done", rows.__len__)
    total = sum(len(design.controllers) for design in designs)
    with kept, progress_bar(total, progress, label="stiffness", unit="runs") as report:
        for design in designs:
            runs: list[StiffnessRun] = []
            for controller in design.controllers:
                runs.append(task.run(controller, design.integration_step))
                report(len(rows) * len(design.controllers) + len(runs))
            rows.append(
                StiffnessRow(
                    design.stiffness,
                    design.damping,
                    design.held,
                    design.radius,
                    design.left_alone,
                    tuple(runs),
                )
            )
    return StiffnessReport(task.sample_time, task.duration, tolerance, tuple(rows))


def _checked_stiffness(value: object) -> list[float]:
    k = float_array("stiffness", value)
    if k.ndim != 1 or not len(k):
        raise ValueError(f"stiffness has shape {k.shape}, expected (K,) with K at least 1")
    positive("stiffness", k, "stiffness in N/m")
    if (np.diff(k) <= 0).any():
        i = int(np.argmax(np.diff(k) <= 0))
        raise ValueError(
            f"stiffness[{i + 1}] is {k[i + 1]:g} N/m after {k[i]:g} N/m, expected ascending numbers"
        )
    return [float(each) for each in k]


def _checked_reference(reference: tc.Reference, at: Prestress, duration: float) -> tc.Reference:
    instance("reference", reference, tc.Reference, "shape_path(...).reference() gives one")
    expected = at.structure.nodes.shape
    if reference.nodes.shape[:2] != expected:
        raise ValueError(
            f"reference.nodes has shape {reference.nodes.shape}, expected {expected} at each time"
        )
    refuse_wrong_bar_lengths("reference.nodes[:, :, 0]", at.structure, reference.nodes[:, :, 0])
    latest = (1 - LATE) * duration
    if reference.time[-1] > latest:
        raise ValueError(
            f"reference ends at {reference.time[-1]:g} s, expected by {latest:g} s: errors are "
            f"taken from the last quarter of duration={duration:g} s"
        )
    return reference


def _refuse_other_end(reference: tc.Reference, plant: LinearPlant, tolerance: float) -> None:
    off = farthest_node(plant, reference.nodes[:, :, -1:], plant.nodes)
    if off > tolerance:
        raise ValueError(
            f"reference ends with a node {off:.3g} m off the shape of at, expected at most the "
            f"tolerance of {tolerance:g} m: it is to lead there"
        )


def _damping(given: object, stiffness: float) -> float:
    value = given(stiffness) if callable(given) else given
    number = float_array("damping", value)
    if number.ndim or number < 0:
        found = value if number.ndim == 0 else f"of shape {number.shape}"
        raise ValueError(
            f"damping is {found} at {stiffness:g} N/m, expected one number of at least 0, N s/m: "
            "the same for all strings"
        )
    return float(number)


# ---- the loops ----


@dataclass(frozen=True, eq=False)
class Design:
    """All that is made for a stiffness before anything runs."""

    stiffness: float
    damping: float
    held: HeldLoop
    radius: float
    left_alone: Modes
    controllers: tuple[Controller, ...]
    integration_step: float


@dataclass(frozen=True, eq=False)
class Task:
    """What is the same for every stiffness: the checked arguments of :func:`stiffness_report`."""

    at: Prestress
    sample_time: float
    reference: tc.Reference | None
    push: float
    duration: float
    weights: Callable[[LinearPlant], tuple[Any, Any]] | None
    horizon: int
    reach: object
    winches: tc.Winches | None
    integration_step: float | None

    def design(self, stiffness: float, damping: float) -> Design:
        """Return LQR and MPC with either input, and their linear loops."""
        load = self.at.external_force
        model = tc.Model(
            self.at.structure,
            strings=tc.LinearStrings(stiffness, damping=damping),
            external_force=load if load.any() else False,
        )
        laws, controllers = {}, []
        for name in INPUTS:
            plant = tc.linearize(model, self.at, input=name)
            pair = (None, None) if self.weights is None else self.weights(plant)
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise TypeError(f"weights returned a {type(pair).__name__}, expected a pair Q, R")
            settings = {
                "Q": pair[0],
                "R": pair[1],
                "sample_time": self.sample_time,
                "max_force_density": self.reach if name == "force_density" else None,
                "winches": self.winches if name == "rest_length" else None,
            }
            # That a law in γ will not hold, and what is left alone, are in the report.
            with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
                laws[name] = tc.LQR(plant, **settings)
                mpc = tc.MPC(plant, horizon=self.horizon, reference=self.reference, **settings)
            controllers += [laws[name], mpc]
        of_force, by_length = laws["force_density"], laws["rest_length"]
        fastest = float(np.abs(np.linalg.eigvals(by_length.plant.A)).max())
        # The last poles are those of what is left alone, which never settles.
        poles, lost = by_length.poles, tc.controllability(by_length.plant).unreachable
        return Design(
            stiffness,
            damping,
            held_loop(of_force.plant, of_force.gain, sample_time=self.sample_time),
            float(np.abs(poles[: len(poles) - lost]).max()),
            by_length.left_alone,
            tuple(controllers),
            min(self.sample_time / STEPS, self.integration_step or RADIANS / fastest),
        )

    def run(self, controller: Controller, integration_step: float) -> StiffnessRun:
        """Return what becomes of a loop on the nonlinear structure."""
        model = controller.plant.model
        nodes, velocities, gamma = self._start(controller)
        rest_length = None
        if self.winches is not None:
            rest_length = tc.to_rest_length(model, nodes, gamma).rest_length
        failure = None
        try:
            with warnings.catch_warnings(action="ignore", category=ControlWarning):
                run = simulate(
                    model,
                    self.duration,
                    nodes,
                    velocities,
                    controller=controller,
                    winches=self.winches,
                    rest_length=rest_length,
                    step=integration_step,
                    output_step=self.sample_time / STEPS,
                    limits=tc.HealthLimits(action="raise"),
                )
        except SimulationError as error:
            run = error.trajectory
            failure = run.stopped or str(error)
        if run.stopped is not None and failure is None:
            raise KeyboardInterrupt(run.stopped)
        return self._judged(controller, run, failure)

    def _start(self, controller: Controller) -> tuple[FloatArray, FloatArray | None, FloatArray]:
        """Return nodes, velocities and γ at the start."""
        plant, reference = controller.plant, self.reference
        if reference is not None and isinstance(controller, tc.MPC):
            gamma = plant.force_density
            if reference.force_density is not None:
                gamma = reference.force_density[:, 0]
            return reference.nodes[:, :, 0], None, gamma
        r = plant.degrees_of_freedom
        # Any velocities, made such as bars can have.
        any_velocities = np.random.default_rng(0).normal(size=plant.nodes.shape)
        rates = plant.measure(plant.nodes, any_velocities)[r:]
        shapes = controller.left_alone.shape
        if shapes.shape[2]:
            alone = shapes.real.swapaxes(0, 1).reshape(plant.nodes.size, -1)
            alone = np.linalg.qr(plant.coordinates.project(alone))[0]
            rates = rates - alone @ (alone.T @ rates)
        velocities = plant.to_velocities(np.zeros(r), rates)
        velocities *= self.push / np.linalg.norm(velocities, axis=0).max()
        return plant.nodes, velocities, plant.force_density

    def _judged(self, controller: Controller, run: Any, failure: str | None) -> StiffnessRun:
        error = None
        if failure is None:
            late = run.nodes[:, :, run.time >= (1 - LATE) * run.time[-1]]
            error = farthest_node(controller.plant, late, controller.plant.nodes)
        least = float(run.force_density.min())
        return StiffnessRun(
            type(controller).__name__,
            controller.input,
            error,
            failure,
            least,
            # A string may be slack between states that are kept: then it has switched.
            least <= 0 or run.work.switches > 0,
            sum(status is not Status.OK for status in run.control.status),
        )


# ---- the figure ----

# One look a loop, in the order of a row: Okabe and Ito's colours, dashes and markers.
LOOKS = (
    {"color": "#0072B2", "linestyle": "solid", "marker": "o"},
    {"color": "#D55E00", "linestyle": (0, (6, 2)), "marker": "s"},
    {"color": "#009E73", "linestyle": (0, (1.5, 1.5)), "marker": "^"},
    {"color": "#CC79A7", "linestyle": (0, (6, 2, 1.5, 2)), "marker": "D"},
)
MARK = {"color": "0.35", "linewidth": 1.0, "linestyle": (0, (1.0, 2.2))}

# Share of the designed rate below which a law in γ does not hold: see HeldLoop.holds.
SLOWEST = 0.25

# Where failed runs are marked: so far below the top, one row of marks a loop, parts of the height.
TOP, NEXT = 0.97, 0.05


@dataclass(frozen=True, eq=False)
class StiffnessDrawing:
    """What :func:`draw` drew.

    ``errors`` has the runs that came to their end and ``failed`` the others, by loop
    (``"MPC in γ"``); ``rate`` is the settling rate where the linear loop is stable, ``shaded``
    the areas of the upper axes where the linear loop of the law in γ does not hold.
    """

    axes: tuple[Axes, Axes]
    errors: dict[str, Line2D]
    failed: dict[str, Line2D]
    rate: Line2D
    shaded: tuple[Any, ...]


def draw(report: StiffnessReport, axes: Sequence[Axes] | None = None) -> StiffnessDrawing:
    """Draw the errors of the four loops, and how the law in γ settles, over the stiffness.

    Hollow marks: a string was slack. Crosses at the top: the run failed. Grey areas: the
    linear loop of the law in γ is unstable or settles too slowly (:attr:`HeldLoop.holds`).
    """
    instance("report", report, StiffnessReport, "make one by stiffness_report(...)")
    if axes is None:
        _, axes = plt.subplots(
            2, 1, sharex=True, figsize=(6.4, 5.6), height_ratios=(2.2, 1.0), layout="constrained"
        )
    upper, lower = axes
    for ax in (upper, lower):
        ax.set_xscale("log")
        ax.grid(visible=True, color="0.9", linewidth=0.6)
        ax.set_axisbelow(True)
    upper.set_yscale("log")
    shaded = _shade(upper, report)
    _shade(lower, report)
    errors, failed = _errors(upper, report)
    upper.axhline(1e3 * report.tolerance, label="tolerance", **MARK)
    upper.set_ylabel("farthest node off at the end, mm")
    upper.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False, fontsize="small")
    rate = _rates(lower, report)
    lower.set_xlabel("stiffness of the strings, N/m")
    lower.set_ylabel("rate / design,\nlaw in γ")
    return StiffnessDrawing((upper, lower), errors, failed, rate, shaded)


def _shade(ax: Axes, report: StiffnessReport) -> tuple[Any, ...]:
    """Shade each row whose linear loop does not hold, halfway to its neighbours."""
    k = np.log10(report.stiffness)
    between = (k[1:] + k[:-1]) / 2
    # Rows at the ends, and one alone, reach as far beyond as their neighbour is, or a decade.
    first, last = (between[0], between[-1]) if len(between) else (k[0] + 0.5, k[0] - 0.5)
    edges = 10 ** np.r_[2 * k[0] - first, between, 2 * k[-1] - last]
    ax.set_xlim(edges[0], edges[-1])
    label = "γ: linear loop does not hold"
    areas: list[Any] = []
    for i, row in enumerate(report.rows):
        if not row.held.holds:
            area = ax.axvspan(edges[i], edges[i + 1], color="0.92", linewidth=0, zorder=0,
                              label=None if areas else label)  # fmt: skip
            areas.append(area)
    return tuple(areas)


def _errors(ax: Axes, report: StiffnessReport) -> tuple[dict[str, Line2D], dict[str, Line2D]]:
    """Draw a curve a loop, hollow where a string was slack, and crosses where runs failed."""
    k, errors, failed = report.stiffness, {}, {}
    for i, (loop, look) in enumerate(zip(report.rows[0].runs, LOOKS, strict=True)):
        name, runs = str(loop), report.runs(loop.controller, loop.input)
        found = np.array([np.nan if run.error is None else 1e3 * run.error for run in runs])
        (errors[name],) = ax.plot(k, found, markersize=5, linewidth=1.3, label=name, **look)
        slack = np.array([run.slackened for run in runs])
        hollow = look | {"linestyle": "none", "markerfacecolor": "white", "zorder": 3}
        ax.plot(k[slack], found[slack], markersize=5, **hollow)
        lost = np.array([run.error is None for run in runs])
        if lost.any():
            (failed[name],) = ax.plot(
                k[lost], np.full(lost.sum(), TOP - i * NEXT), transform=ax.get_xaxis_transform(),
                marker="X", markersize=9, linestyle="none", color=look["color"],
                markeredgecolor="black", label=f"failed: {name}", clip_on=False,
            )  # fmt: skip
    if any(run.slackened and run.error is not None for row in report.rows for run in row.runs):
        ax.plot([], [], marker="o", markersize=5, linestyle="none", color="0.35",
                markerfacecolor="white", label="a string was slack")  # fmt: skip
    return errors, failed


def _rates(ax: Axes, report: StiffnessReport) -> Line2D:
    """Draw the settling rate of the law in γ over that of its design."""
    k, ratio = report.stiffness, np.array([row.held.rate_ratio for row in report.rows])
    stable = ratio > 0
    (rate,) = ax.plot(
        k, np.where(stable, ratio, np.nan), color="#000000", marker=".", linewidth=1.0
    )
    ax.plot(k[~stable], np.zeros((~stable).sum()), marker="X", markersize=8, linestyle="none",
            color="#D55E00", markeredgecolor="black", label="unstable")  # fmt: skip
    ax.axhline(SLOWEST, **MARK)
    ax.set_ylim(-0.08, max(1.08, 1.05 * float(ratio.max())))
    if not stable.all():
        ax.legend(handles=ax.lines[1:2], loc="upper right", frameon=False, fontsize="small")
    return rate
