"""Order of convergence of a method, fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.converged_motion import ConvergedMotion, converged_motion
from tenscontrol.accuracy.measured_run import (
    Bench,
    Measurement,
    as_taken,
    checked_settings,
    default_settings,
    method_named,
)
from tenscontrol.accuracy.open_loop import open_loop_of
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.interrupt import keeping
from tenscontrol.progress import progress_bar
from tenscontrol.simulation.scene import Scene
from tenscontrol.tables import aligned, shown

# Errors above this part of the size are not small yet; below so many times what the reference is
# off by, and so many units of round-off a step, they are not the method's any more.
_COARSE, _ABOVE_REFERENCE, _ABOVE_ROUND_OFF = 1e-2, 10.0, 10.0

_LEAST_RUNS = 3


@dataclass(frozen=True, eq=False)
class ConvergenceOrder:
    """Errors of a method at several steps, and the order fitted to them.

    Made by :func:`convergence_order`.

    Attributes
    ----------
    method : str
    step : ndarray, shape (K,)
        Step, s, from coarse to fine: as shortened to fit between outputs; of a method that
        takes a tolerance the mean, NaN for a run that failed.
    error : ndarray, shape (K,)
        Largest distance of a node from the reference, m; NaN for a run that failed.
    is_clean : ndarray of bool, shape (K,)
        Whether a run counts in the fit.
    order : float
        Slope of log error over log step by least squares; NaN with fewer than three clean runs.
    deviation : float
        Its standard error.
    constant : float
        Of ``error = constant · step ** order``.
    switches : int
        Slack/taut switches of the reference.
    reference_error : float
        Estimate of the error of the reference, m.
    """

    method: str
    step: FloatArray
    error: FloatArray
    is_clean: np.ndarray
    order: float
    deviation: float
    constant: float
    switches: int
    reference_error: float

    def table(self) -> str:
        """Return steps, errors, the order between neighbours and the fit, as text."""
        local = np.diff(np.log(self.error)) / np.diff(np.log(self.step))
        rows = [
            [
                f"{self.step[i]:.3g}",
                shown(float(self.error[i]), ".2e"),
                shown(float(local[i - 1]), ".2f") if i else "",
                "yes" if self.is_clean[i] else "no",
            ]
            for i in range(len(self.step))
        ]
        if np.isfinite(self.order):
            fit = f"{self.method}: order {self.order:.2f} +/- {self.deviation:.2f}"
        else:
            fit = f"{self.method}: no order, as fewer than {_LEAST_RUNS} runs are clean"
        fit += f"; {self.switches} switches, reference good to {self.reference_error:.1e} m"
        return fit + "\n\n" + aligned(["step s", "error m", "order", "fitted"], rows, left=0)

    def __repr__(self) -> str:
        return f"ConvergenceOrder({self.method}, {self.order:.2f} +/- {self.deviation:.2f})"


def convergence_order(
    scene: Scene,
    method: str,
    steps: Sequence[float] | None = None,
    reference: ConvergedMotion | None = None,
    outputs: int = 20,
    progress: bool = False,
) -> ConvergenceOrder:
    """Return the measured order of convergence of a method on a motion.

    Parameters
    ----------
    scene : Scene
    method : str
        One that takes a step, or a tolerance: then the mean step counts.
    steps : sequence of float, optional
        Steps, s, or tolerances; fitting ones if not given.
    reference : ConvergedMotion, optional
        From :func:`converged_motion` of the same case.
    outputs : int
        Times at which errors are looked at; a step is never longer than from one to the next.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    ConvergenceOrder
        Of the runs done by then, if Ctrl-C or SIGTERM ends it; a warning says so.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name.
    ArithmeticError
        If the motion runs away.

    Notes
    -----
    A run is fitted if its error is below a hundredth of the size of the structure, above ten times
    the error of the reference, and above ten units of round-off for each step taken. Outside these
    limits, the error is not that of the method.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> case = tc.Scene(tc.Model(prism), 0.5, force_density=gamma)
    >>> found = tc.convergence_order(case, "rk4", [0.02, 0.01, 0.005, 0.0025])
    >>> 3.8 < found.order < 4.2
    True
    """
    case = open_loop_of(scene)
    chosen = method_named(method)
    count = validation.whole_number("outputs", outputs, 1, validation.MOST_RUNS)
    if reference is not None:
        validation.instance(
            "reference",
            reference,
            ConvergedMotion,
            "make one by tenscontrol.accuracy.converged_motion(scene)",
        )
        count = len(reference.time)
    unit = "s" if chosen.setting == "step" else "1"
    settings = default_settings(chosen, case)
    if steps is not None:
        settings = checked_settings("steps", steps, unit)
    settings = as_taken(chosen, settings, case.duration / count)
    rows: list[Measurement] = []
    total, keep_runs = 1 + len(settings), keeping("runs are measured", rows.__len__)
    with keep_runs, progress_bar(total, progress, "fitting the order", "runs") as report:
        reference = reference or converged_motion(case, count)
        report(1)
        bench = Bench(case, reference)
        for setting in settings:
            rows.append(bench.own(chosen, setting).measurement())
            report(1 + len(rows))
    taken = np.array([np.nan if row.failure else float(row.steps or 0) for row in rows])
    error = np.array([row.error for row in rows])
    round_off = _ABOVE_ROUND_OFF * np.finfo(float).eps * case.size * taken
    least = np.maximum(_ABOVE_REFERENCE * reference.error, round_off)
    is_clean = (error < _COARSE * case.size) & (error > least)
    step = case.duration / taken
    if chosen.setting == "step":  # not counting the pieces that switches cut steps into
        step = np.array(settings[: len(rows)])
    order, deviation, constant = _fit(step[is_clean], error[is_clean])
    return ConvergenceOrder(
        method=chosen.name,
        step=frozen(step),
        error=frozen(error),
        is_clean=frozen(is_clean),
        order=order,
        deviation=deviation,
        constant=constant,
        switches=len(reference.switches),
        reference_error=reference.error,
    )


def _fit(step: FloatArray, error: FloatArray) -> tuple[float, float, float]:
    """Return slope, its standard error, and constant of the line through the logarithms."""
    if len(step) < _LEAST_RUNS:
        return np.nan, np.nan, np.nan
    x, y = np.log(step), np.log(error)
    slope, level = np.polyfit(x, y, 1)
    left = y - slope * x - level
    spread = np.sqrt((left @ left) / (len(x) - 2) / np.sum((x - x.mean()) ** 2))
    return float(slope), float(spread), float(np.exp(level))
