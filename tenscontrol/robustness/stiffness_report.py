"""What controllers make of strings of different stiffness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from tenscontrol.control import HeldLoop
from tenscontrol.plant import INPUTS
from tenscontrol.tables import aligned
from tenscontrol.validation import FloatArray, choice, frozen

CONTROLLERS = ("LQR", "MPC")

_NAMES = {"force_density": "γ", "rest_length": "rest lengths"}


@final
@dataclass(frozen=True)
class StiffnessRun:
    """One controller on the nonlinear structure, with rest lengths held between samples.

    Attributes
    ----------
    controller : str
        ``"LQR"`` or ``"MPC"``.
    input : str
        What it commands: ``"force_density"`` or ``"rest_length"``.
    error : float or None
        Largest distance of a node from its place in the last quarter of the run, m, motion
        as one body apart; None where the run failed.
    failure : str or None
        Why the run ended early or is not accurate; None where neither is so.
    least_force_density : float
        Smallest γ of any string at ten moments a sample, N/m.
    slackened : bool
        Whether a string was slack at any moment.
    commands_not_ok : int
        How many commands had another status than ``"ok"``.
    """

    controller: str
    input: str
    error: float | None
    failure: str | None
    least_force_density: float
    slackened: bool
    commands_not_ok: int

    def __str__(self) -> str:
        return f"{self.controller} in {_NAMES[self.input]}"


@final
@dataclass(frozen=True)
class StiffnessRow:
    """Four loops with strings of one stiffness.

    Attributes
    ----------
    stiffness : float
        k of every string, N/m.
    damping : float
        c of every string, N s/m.
    held : HeldLoop
        The linear loop of the law in γ, where winches hold rest lengths.
    radius : float
        Spectral radius of the linear sampled loop of the law in rest lengths.
    runs : tuple of StiffnessRun
        LQR and MPC in γ, then both in rest lengths.
    """

    stiffness: float
    damping: float
    held: HeldLoop
    radius: float
    runs: tuple[StiffnessRun, ...]


@final
@dataclass(frozen=True)
class StiffnessReport:
    """What became of four loops over the stiffness. Made by :func:`stiffness_report`.

    Attributes
    ----------
    sample_time : float
        Sample time, s.
    duration : float
        Of each run, s.
    tolerance : float
        Largest error of a run that holds the target, m.
    rows : tuple of StiffnessRow
        From soft to stiff.
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
        """Return the runs of one loop, from soft to stiff.

        Parameters
        ----------
        controller : {"LQR", "MPC"}
        input : {"force_density", "rest_length"}

        Returns
        -------
        tuple of StiffnessRun

        Raises
        ------
        ValueError
            If there is no such loop.
        """
        loop = choice("controller", controller, CONTROLLERS), choice("input", input, INPUTS)
        found = [run for row in self.rows for run in row.runs]
        return tuple(run for run in found if (run.controller, run.input) == loop)

    def holds(self, controller: str, input: str) -> np.ndarray:
        """Return at which stiffness a loop holds the target.

        Its run comes to its end within the tolerance. For γ the linear loop must say so as
        well (:attr:`HeldLoop.holds`): a run that is close to the target may settle too slowly.

        Parameters
        ----------
        controller : {"LQR", "MPC"}
        input : {"force_density", "rest_length"}

        Returns
        -------
        ndarray of bool, shape (K,)

        Raises
        ------
        ValueError
            If there is no such loop.
        """
        errors = [run.error for run in self.runs(controller, input)]
        near = [error is not None and error <= self.tolerance for error in errors]
        linear = [input == "rest_length" or row.held.holds for row in self.rows]
        return frozen(np.logical_and(near, linear))

    def limit(self, controller: str, input: str) -> float | None:
        """Return the largest stiffness up to which a loop holds the target, N/m.

        Parameters
        ----------
        controller : {"LQR", "MPC"}
        input : {"force_density", "rest_length"}

        Returns
        -------
        float or None
            Of those that were tried, and all softer ones hold too; None if the softest does not.

        Raises
        ------
        ValueError
            If there is no such loop.
        """
        count = int(np.cumprod(self.holds(controller, input)).sum())
        return self.rows[count - 1].stiffness if count else None

    def table(self) -> str:
        """Return one line a stiffness, as text.

        Returns
        -------
        str
            The settling rate of the law in γ over that of its design and of the law in rest
            lengths, 1/s, both by the linear loop; the errors of the runs, mm, marked ``slack``
            where a string was slack, or ``failed``.
        """
        names = [str(run) for run in self.rows[0].runs]
        head = ["k, N/m", "γ: rate/design", *names[:2], "rest lengths: rate", *names[2:]]
        rows = []
        for row in self.rows:
            errors = [_error(run) for run in row.runs]
            rate = f"{-np.log(row.radius) / self.sample_time:.2g}"
            ratio = f"{row.held.rate_ratio:.3f}"
            rows.append([f"{row.stiffness:g}", ratio, *errors[:2], rate, *errors[2:]])
        return aligned(head, rows)

    def summary(self) -> str:
        """Return the table, up to which stiffness each loop holds, and what went wrong, as text.

        Returns
        -------
        str
        """
        lines = [
            f"rest lengths held over samples of {self.sample_time:g} s; errors of the last quarter "
            f"of {self.duration:g} s, mm; rates in 1/s",
            self.table(),
        ]
        lines += [f"{run}: {self._verdict(run)}" for run in self.rows[0].runs]
        for row in self.rows:
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


def _error(run: StiffnessRun) -> str:
    if run.error is None:
        return "failed"
    return f"{1e3 * run.error:.3f}{' slack' if run.slackened else ''}"
