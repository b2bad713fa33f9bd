"""Laws in γ and in rest lengths against the stiffness of the strings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.plant import LinearPlant, Reference
from tenscontrol.progress import progress_bar
from tenscontrol.robustness.distance import farthest_node
from tenscontrol.robustness.stiffness_loops import LATE, Task, natural_weights
from tenscontrol.robustness.stiffness_report import StiffnessReport, StiffnessRow
from tenscontrol.shape import ShapeTarget
from tenscontrol.statics import Prestress
from tenscontrol.structure import refuse_wrong_bar_lengths
from tenscontrol.validation import (
    float_array,
    instance,
    positive,
    positive_number,
    truth,
)

# Largest γ that laws in γ command, if the user gives none: so many times the largest at rest.
_REACH = 3.0


def stiffness_report(
    at: Prestress | ShapeTarget,
    stiffness: Sequence[float],
    *,
    sample_time: float,
    damping: float | Callable[[float], float] = 0.0,
    reference: Reference | None = None,
    push: float = 0.02,
    duration: float = 4.0,
    tolerance: float = 1e-3,
    weights: Callable[[LinearPlant], tuple[Any, Any]] | None = None,
    horizon: int = 20,
    max_force_density: object = None,
    winches: Winches | None = None,
    integration_step: float | None = None,
    progress: bool = False,
) -> StiffnessReport:
    """Try laws in γ and in rest lengths with strings from soft to stiff.

    Winches hold rest lengths between samples. A law in γ is undone by the motion between
    samples, the more so the stiffer the strings. For each stiffness LQR and MPC are designed
    with either input, looked at as linear sampled loops, and run on the nonlinear structure.

    Parameters
    ----------
    at : Prestress or ShapeTarget
        The equilibrium to be held. Its force densities and its load are those of every stiffness.
    stiffness : array_like, shape (K,)
        k of every string, N/m, ascending.
    sample_time : float
        Sample time, s.
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
        A run that runs away, or is not accurate, is a row of it that says so.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, or no controller can be designed
        for a stiffness. All are designed before the first run.
    KeyboardInterrupt
        If the user interrupts a run: part of a run tells nothing.

    Notes
    -----
    The linear loops are those of LQR; see :func:`held_loop` for γ. Without limits MPC has the same
    gains.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> rest = tc.prestress(tc.prism(), force_density=17.3205)
    >>> report = tc.robustness.stiffness_report(
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
        instance("winches", winches, Winches, "make them by Winches(rate=...)")
    if weights is not None and not callable(weights):
        raise TypeError(
            f"weights is a {type(weights).__name__}, expected a function weights(plant) -> Q, R"
        )
    duration = positive_number("duration", duration, "s")
    task = Task(
        at=at,
        sample_time=positive_number("sample_time", sample_time, "s"),
        reference=None if reference is None else _checked_reference(reference, at, duration),
        push=positive_number("push", push, "m/s"),
        duration=duration,
        weights=natural_weights if weights is None else weights,
        horizon=horizon,
        reach=_REACH * float(at.force_density.max(initial=0.0))
        if max_force_density is None
        else max_force_density,
        winches=winches,
        integration_step=None
        if integration_step is None
        else positive_number("integration_step", integration_step, "s"),
    )
    tolerance = positive_number("tolerance", tolerance, "m")
    truth("progress", progress, "whether to show a progress bar")
    designs = [task.design(each, _damping(damping, each)) for each in k]
    if reference is not None:
        _refuse_other_end(reference, designs[0].controllers[0].plant, tolerance)
    rows, done = [], 0
    total = sum(len(design.controllers) for design in designs)
    with progress_bar(total, progress, label="stiffness", unit="runs") as report:
        for design in designs:
            runs = []
            for controller in design.controllers:
                runs.append(task.run(controller, design.integration_step))
                done += 1
                report(done)
            rows.append(
                StiffnessRow(
                    design.stiffness, design.damping, design.held, design.radius, tuple(runs)
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


def _checked_reference(reference: object, at: Prestress, duration: float) -> Reference:
    instance("reference", reference, Reference, "shape_path(...).reference() gives one")
    assert isinstance(reference, Reference)  # just checked
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


def _refuse_other_end(reference: Reference, plant: LinearPlant, tolerance: float) -> None:
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
