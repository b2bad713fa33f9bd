"""Fit of a model to logs, with what the logs can tell."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.model import Model
from tenscontrol.files import write_file
from tenscontrol.integrate.integrator import IntegrationError
from tenscontrol.optimize.log import Log
from tenscontrol.optimize.rollouts import Readings, Rollouts, checked_logs
from tenscontrol.optimize.unknowns import unknowns_of
from tenscontrol.progress import progress_bar
from tenscontrol.properties import cached_property
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.plant_run import StoppedError
from tenscontrol.tables import aligned

# First parts of the logs that are fitted one after the other. Where noise does not explain one, the
# fit is in a wrong minimum of fast motions: it goes back, and a shorter part comes before, of the
# first that share, else halfway.
_PARTS, _SHORTER_PART = (0.1, 0.25, 0.5, 1.0), 0.3

# Least fall of the squares that is worth a rollout: of a part, as part of them, where noise does
# explain it and where not; at the end, in variances of the residuals, as 0.01 is a tenth of a
# standard error in whichever direction (D. M. Bates and D. G. Watts, *A relative offset
# orthogonality convergence criterion for nonlinear least squares*, 1981,
# doi:10.1080/00401706.1981.10486255). The fourth is that after a step that did not lessen them: at
# a switch of the motion slopes jump, and what they foresee is never met.
_ROUGHLY, _CLOSER, _WELL, _AT_SWITCH, _TINY = 3e-2, 3e-3, 1e-2, 0.2, 1e-6

# Steps in a part at most; damping of the first step, and by how much it changes after one that
# lessened the cost by more than the first share of what was foreseen. Part of a step that lessened
# it by less than the second, within which the next is.
_MOST, _DAMPING, _LESS, _GOOD, _POOR, _SHORTER = 12, 1e-3, 0.2, 0.75, 0.25, (0.1, 0.5)

# Longest step of an unknown, in standard deviations of its prior: slopes do not hold far away.
_LONGEST = 2.0

# Part of a step after which it is seen how residuals bend along it, and the longest correction for
# that, as part of the step.
_AHEAD, _BENT = 0.1, 0.375

# Data does not tell directions with a singular value below the first. Of an unknown that it tells,
# the second is at most the part in these, and the third what is left of the variance of its prior.
_BLIND, _TOLD, _LEFT = 0.1, 0.01, 0.5

# Squares of the residuals a degree of freedom from which on noise does not explain them.
_FAR = 2.0

# Chance of their squares from which on it is said that noise does not explain them quite.
_CHANCE = 1e-3

# Residuals beyond count in proportion, with Huber's loss.
_HUBER = 1.345

# A part whose fit is farther from what was known, in standard deviations, is in a wrong minimum.
_FARTHEST = 6.0

# Of a normal distribution, 95 % lie within.
_INTERVAL = 1.959964


@dataclass(frozen=True, eq=False, repr=False)
class Identifiability:
    """What logs tell of parameters, beside what was known before. Made by :func:`identifiable`.

    Attributes
    ----------
    rollouts : Rollouts
        Of the model beside the logs, with the unknowns; not for users.
    labels : tuple of str
        Name of each unknown.
    singular : ndarray, shape (unknowns,)
        Of the slope of the readings, in standard deviations, by the unknowns in theirs, largest
        first: below 1, data tells less of that direction than was known before.
    directions : ndarray, shape (unknowns, unknowns)
        One row each, of length 1, in parts of the unknowns.
    is_told : ndarray of bool, shape (unknowns,)
        Whether less than half of the variance of an unknown before is left, and below 1 % of it are
        in directions that data does not tell.
    """

    rollouts: Rollouts
    labels: tuple[str, ...]
    singular: FloatArray
    directions: FloatArray
    is_told: Any

    @property
    def untold(self) -> FloatArray:
        """Directions of which data tells next to nothing, one row each: singular below 0.1."""
        return self.directions[self.singular < _BLIND]

    @property
    def deviation(self) -> FloatArray:
        """What is left of the standard deviation of each unknown, as part of its prior's."""
        left = self.directions.T / np.sqrt(1 + self.singular**2)
        return np.asarray(np.sqrt((left**2).sum(axis=1)))

    def table(self) -> str:
        """Return as text which unknowns are told, and the directions that are not."""
        rows = [
            [label, "yes" if is_told else "no", f"{share:.2g}"]
            for label, is_told, share in zip(self.labels, self.is_told, self.deviation, strict=True)
        ]
        lines = [aligned(["unknown", "told", "left of the deviation"], rows)]
        for size, direction in zip(self.singular[self.singular < _BLIND], self.untold, strict=True):
            lines.append(f"not told ({size:.2g}): {_described(self.labels, direction)}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        untold = len(self.untold)
        return f"Identifiability({len(self.labels)} unknowns, {untold} directions not told)"


@dataclass(frozen=True, eq=False, repr=False)
class Validation:
    """How a model does on a log. Made by :meth:`Fit.validate`.

    Attributes
    ----------
    log : Log
    residuals : ndarray, shape (K, m)
        What the model reads less what was read, in standard deviations of the noise; NaN where a
        reading was lost.
    """

    log: Log
    residuals: FloatArray

    @property
    def root_mean_square(self) -> float:
        """Of the residuals: 1 where only noise is left."""
        return float(np.sqrt(np.nanmean(self.residuals**2)))

    @property
    def whiteness(self) -> float:
        """Correlation of residuals with those just before: near 0 where only noise is left."""
        r = np.nan_to_num(self.residuals)
        return float((r[1:] * r[:-1]).sum() / max((r**2).sum(), np.finfo(float).tiny))

    def __repr__(self) -> str:
        return (
            f"Validation(residuals {self.root_mean_square:.3g} deviations, correlated by "
            f"{self.whiteness:.2g})"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A model fitted to logs. Made by :func:`fit`.

    Attributes
    ----------
    model : Model
        With the parameters that were found.
    logs : tuple of Log
    labels : tuple of str
        Name of each unknown.
    value : ndarray, shape (unknowns,)
        Factors of what was known before, of what is positive; else what is added, in its unit.
    interval : ndarray, shape (unknowns, 2)
        Within which each is at 95 %; NaN where data does not tell, and of all if the fit did not
        converge or :attr:`explained` is false, as none would hold.
    parameters : mapping of str to ndarray
        All parameters that were fitted, with those that were known.
    identifiability : Identifiability
        At what was found.
    chi_squared : float
        Squares of the residuals over the degrees of freedom: 1 where only noise is left. By
        Huber's loss, what far readings make of the variances.
    p_value : float, or None
        Chance of squares as large from the noise of the sensors alone; None with Huber's loss.
    rollouts : int
        Simulations of all logs.
    message : str
        Why it ended.
    """

    model: Model
    logs: tuple[Log, ...]
    labels: tuple[str, ...]
    value: FloatArray
    interval: FloatArray
    parameters: Mapping[str, FloatArray]
    identifiability: Identifiability
    chi_squared: float
    p_value: float | None
    rollouts: int
    message: str
    _rollouts: Rollouts
    _theta: FloatArray

    @property
    def converged(self) -> bool:
        """Whether no step lessens the cost any more."""
        return self.message == "converged"

    @property
    def explained(self) -> bool:
        """Whether noise explains the residuals: chi squared is at most 2."""
        return self.chi_squared <= _FAR

    def validate(self, log: Log) -> Validation:
        """Return how the model does on a log, as a rule another than those of the fit.

        Parameters
        ----------
        log : Log
            Its start is taken as known.

        Returns
        -------
        Validation
        """
        checked_logs(self.model, (log,))
        known = Rollouts(
            self._rollouts.model, (log,), self._rollouts.unknowns, None, self._rollouts.integration
        )
        return self._judged(known, log, self._theta[: known.size], 0)

    @cached_property
    def residuals(self) -> tuple[Validation, ...]:
        """Those of the logs of the fit."""
        return tuple(
            self._judged(self._rollouts, log, self._theta, i) for i, log in enumerate(self.logs)
        )

    def _judged(self, rollouts: Rollouts, log: Log, theta: FloatArray, i: int) -> Validation:
        readings = rollouts.readings(theta, 1.0, slopes=False)
        residuals = np.full(log.readings.shape, np.nan)
        residuals[~np.isnan(log.readings)] = readings.residuals[readings.of_log == i]
        return Validation(log, frozen(residuals))

    def table(self) -> str:
        """Return what was found as text."""
        rows = []
        for label, value, (low, high), is_told in zip(
            self.labels, self.value, self.interval, self.identifiability.is_told, strict=True
        ):
            between = "not told by the data"
            if is_told:
                between = "none" if np.isnan(low) else f"{low:.5g} to {high:.5g}"
            rows.append([label, f"{value:.5g}", between])
        lines = [
            aligned(["unknown", "factor or shift", "95 %"], rows),
            f"chi squared {self.chi_squared:.3g} a degree of freedom, {self.rollouts} rollouts, "
            f"{self.message}",
        ]
        if not self.converged:
            lines.append("steps still lessen the cost, so no interval holds: raise most_rollouts")
        if not self.explained:
            lines.append(
                f"residuals are {self.chi_squared**0.5:.2g} times the noise, so no interval holds: "
                "the model lacks something, sensors have more noise, units differ, or the fit is "
                "in a wrong minimum; fit windows or a first part of the log"
            )
        elif self.converged and self.p_value is not None and self.p_value < _CHANCE:
            lines.append(
                f"noise alone leaves squares as large with probability {self.p_value:.1g}: the "
                "model lacks a little, or sensors have more noise; intervals count it as noise"
            )
        for direction in self.identifiability.untold:
            lines.append(f"not told: {_described(self.labels, direction)}")
        return "\n".join(lines)

    def save(self, file: str | Path) -> Path:
        """Write what was found as JSON and return its path.

        Parameters
        ----------
        file : path

        Returns
        -------
        Path
        """
        path = validation.file_path("file", file)
        record = {
            "parameters": {name: value.tolist() for name, value in self.parameters.items()},
            "unknowns": [
                {"name": label, "value": value, "interval": None if np.isnan(low) else [low, high]}
                for label, value, (low, high) in zip(
                    self.labels, self.value.tolist(), self.interval.tolist(), strict=True
                )
            ],
            "chi_squared": self.chi_squared,
            "p_value": self.p_value,
            "rollouts": self.rollouts,
            "message": self.message,
        }  # fmt: skip
        return write_file(path, json.dumps(record, indent=1) + "\n")

    def __repr__(self) -> str:
        untold = len(self.identifiability.untold)
        return (
            f"Fit({len(self.labels)} unknowns, {untold} directions not told; chi squared "
            f"{self.chi_squared:.3g}, {self.rollouts} rollouts, {self.message})"
        )


def identifiable(
    model: Model,
    log: object,
    parameters: object,
    *,
    known: Mapping[str, object] | None = None,
    groups: Mapping[str, object] | None = None,
    start: object = None,
    tolerance: float = 1e-8,
    step: float | None = None,
) -> Identifiability:
    """Return what logs can tell of parameters, by the derivatives of the readings, before a fit.

    Readings of places, lengths and directions alone cannot tell the common scale of masses,
    stiffness, damping and ground: hold one as ``known``, or read a tension.

    Parameters
    ----------
    model : Model
    log : Log, or sequence of Log
        The readings are not used, but which of them were lost.
    parameters : list of str, or dict of str to LogNormal or float
    known : dict of str to list of int, optional
    groups : dict of str to list of lists of int, or "all", optional
    start : tuple of float, optional
    tolerance : float
        As of :func:`fit`.
    step : float, optional
        As of :func:`fit`, s.

    Returns
    -------
    Identifiability

    Raises
    ------
    TypeError, ValueError
        As :func:`fit`.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    >>> sensors = tc.Sensors(structure=prism, node_position=0.001)
    >>> run = tc.simulate(model, 0.5, rest_length=0.9 * prism.string_length())
    >>> log = tc.Log.of_run(run, sensors, np.linspace(0.02, 0.5, 25))
    >>> tc.identifiable(model, log, ["stiffness", "damping", "bar_mass"])
    Identifiability(21 unknowns, 2 directions not told)
    """
    return identifiability_of(
        rollouts_of(model, log, parameters, known, groups, start, tolerance, step)
    )


def fit(
    model: Model,
    log: object,
    parameters: object,
    *,
    known: Mapping[str, object] | None = None,
    groups: Mapping[str, object] | None = None,
    start: object = None,
    loss: str = "squared",
    tolerance: float = 1e-8,
    step: float | None = None,
    most_rollouts: int = 100,
    progress: bool = False,
) -> Fit:
    """Return a model fitted to what sensors read of a structure.

    The method is that of Levenberg and Marquardt, with derivatives of the run through its switches.
    It fits the first tenth of the logs first, then more and more, as long motions from a poor guess
    have many minima.

    Parameters
    ----------
    model : Model
        With what is known of the parameters before.
    log : Log, or sequence of Log
    parameters : list of str, or dict of str to LogNormal or float
        What is unknown: ``"stiffness"`` and other parameters of the string law, ``"rest_length"``,
        a shift of those that were commanded, ``"bar_mass"``, ``"point_mass"``, those of the ground
        as ``"ground.friction"``, ``"delay"`` of the readings, s. The value is what is known before:
        a :class:`~tenscontrol.optimize.LogNormal`, or the standard deviation of the logarithm, of
        a shift in its unit; if not given, 0.5, 5 % of a length, 0.02 s, or 1 % of the size.
    known : dict of str to list of int, optional
        Members whose parameter is not fitted.
    groups : dict of str to list of lists of int, or "all", optional
        Members that share an unknown; the others have one each.
    start : tuple of float, optional
        Standard deviations of nodes, m, and velocities, m/s, at the start of each log, which are
        then fitted too; known exactly if not given.
    loss : {"squared", "huber"}
        Whether readings that are far off count in proportion only.
    tolerance : float
        Of the rollouts, relative: that of :class:`tenscontrol.Integration`.
    step : float, optional
        Of rollouts by rk4 in place of a tolerance, s.
    most_rollouts : int
        Simulations with derivatives at most.
    progress : bool

    Returns
    -------
    Fit

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, a parameter is not one of the model's,
        or the model cannot be simulated as it is given.

    Notes
    -----
    Ctrl-C ends a fit with what was found so far. Intervals come from the slope at what was found,
    the residuals as they are, and what was known before (Gelman and others 2013, *Bayesian Data
    Analysis*, 4.1). Of them 95 % hold if true values are as far from the believed ones as was said.
    For what data does not tell there is none: see :func:`identifiable`. Nor is there any if the fit
    did not converge, or noise does not explain the residuals: :meth:`Fit.table` says so.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> true = tc.Model(prism, strings=tc.LinearStrings(120.0, damping=0.5))
    >>> run = tc.simulate(true, 0.5, rest_length=0.9 * prism.string_length(), step=1e-3)
    >>> sensors = tc.Sensors(structure=prism, node_position=0.001)
    >>> log = tc.Log.of_run(run, sensors, np.linspace(0.02, 0.5, 25), seed=0)
    >>> guess = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    >>> found = tc.fit(guess, log, ["stiffness"], groups={"stiffness": "all"})
    >>> found.converged, bool(abs(found.parameters["stiffness"][0] - 120.0) < 1.0)
    (True, True)
    """
    validation.choice("loss", loss, ("squared", "huber"))
    most = validation.whole_number("most_rollouts", most_rollouts, 1)
    rollouts = rollouts_of(model, log, parameters, known, groups, start, tolerance, step)
    solver = _Solver(rollouts, loss == "huber", most)
    with progress_bar(100.0, progress, "fitting", "% of the logs") as report:
        theta, readings, message = solver.run(report)
    return _result(rollouts, theta, readings, message, loss == "huber")


def rollouts_of(
    model: Model, log: object, parameters: object, known: Any, groups: Any, start: object,
    tolerance: float, step: float | None,
) -> Rollouts:  # fmt: skip
    """Return the rollouts of a model beside logs, after checking all that is asked for."""
    validation.instance("model", model, Model, "make one by Model(structure)")
    logs = checked_logs(model, log)
    first = logs[0]
    held = None if first.input == "force_density" else np.zeros(len(model.structure.strings))
    unknowns = unknowns_of(model, first.input, parameters, known, groups, held)
    deviations = None
    if start is not None:
        pair = validation.shaped("start", start, (2,), "deviations of nodes and velocities")
        pair = validation.positive("start", pair, "standard deviation")
        deviations = float(pair[0]), float(pair[1])
    integration = Integration("dop853", tolerance, error="none")
    if step is not None:  # in place of the tolerance
        integration = Integration("rk4", step=step, error="none")
    return Rollouts(model, logs, unknowns, deviations, integration)


class _Solver:
    """Levenberg and Marquardt's method, over longer and longer parts of the logs."""

    def __init__(self, rollouts: Rollouts, is_robust: bool, most: int) -> None:
        self._rollouts, self._is_robust, self._most = rollouts, is_robust, most
        self._scale = rollouts.deviations

    def run(self, report: Any) -> tuple[FloatArray, Readings, str]:
        """Return the unknowns, the residuals with their slope, and why it ended."""
        theta, done, message = np.zeros(self._rollouts.size), 0.0, "converged"
        readings: Readings | None = None
        parts = list(_PARTS)
        try:
            while parts:
                share = parts.pop(0)
                if self._left(share) < 1:
                    continue
                shorter = self._shorter(done, share)
                readings = self._rollouts.readings(theta, share, slopes=True)
                moved, readings, message = self._fit_part(theta, readings, share, shorter > 0)
                if shorter and not self._is_explained(readings):
                    parts = [shorter, share, *parts]
                    continue
                theta, done = moved, share
                report(100 * share)
        except KeyboardInterrupt:
            if readings is None:
                raise
            message = f"interrupted, {100 * done:.0f} % of the logs were fitted"
            readings = self._rollouts.readings(theta, 1.0, slopes=True)
        assert readings is not None  # the whole of the logs is never passed over
        return theta, readings, message

    def _fit_part(
        self, theta: FloatArray, readings: Readings, share: float, may_return: bool
    ) -> tuple[FloatArray, Readings, str]:
        """Return the unknowns and residuals of a part, and why its fit ended.

        Where a shorter part may come before, it ends soon if noise will not explain it.
        """
        damping, cost, is_bent = _DAMPING, self._cost(readings, theta), False
        linear, is_whole, has_failed = self._linear(readings, theta), share == 1.0, False
        for i in range(self._most):
            if self._is_enough(i, theta, readings, share, may_return):
                return theta, readings, "converged"
            if self._left(share) < 1:
                return theta, readings, f"stopped after {self._rollouts.count} rollouts"
            least = cost * self._least_share(readings, is_whole, has_failed)
            step, fall = linear.step(damping)
            if linear.offset <= least or fall <= _TINY * cost:
                return theta, readings, "converged"
            straight = step
            if is_bent and self._left(share) > 1:
                ahead = self._tried(theta + _AHEAD * self._scale * step, share, slopes=False)
                if ahead is not None:
                    step = linear.bent(step, damping, ahead.residuals - readings.residuals)
            moved = theta + self._scale * step
            tried = self._tried(moved, share)
            new = np.inf if tried is None else self._cost(tried, moved)
            fell = cost - new
            is_bent = step is not straight or fell < _GOOD * fall
            damping = linear.next_damping(damping, fall, fell)
            has_failed = not new < cost
            if tried is None or has_failed:
                if not is_whole and abs(fell) <= least:
                    return theta, readings, "converged"
                continue
            theta, readings, cost = moved, tried, new
            linear = self._linear(readings, theta)
            if not is_whole and fell < least:
                break
        return theta, readings, "converged"

    def _least_share(self, readings: Readings, is_whole: bool, has_failed: bool) -> float:
        """Return which part of the cost must still fall for another rollout."""
        if is_whole:
            return (_AT_SWITCH if has_failed else _WELL) / len(readings.residuals)
        return _ROUGHLY if self._is_explained(readings) else _CLOSER

    def _is_enough(
        self, steps: int, theta: FloatArray, readings: Readings, share: float, may_return: bool
    ) -> bool:
        """Return whether a part has had its steps, or none will help where it can go back."""
        if may_return and np.abs(theta / self._scale).max() > _FARTHEST:
            return True
        return steps >= _MOST and (share < 1 or (may_return and not self._is_explained(readings)))

    def _left(self, share: float) -> int:
        """Return how many rollouts are left for a part of the logs; one is kept for all of them."""
        return self._most - (share < 1.0) - self._rollouts.count

    def _shorter(self, done: float, share: float) -> float:
        """Return a part between two that has other times, or 0."""
        shorter = float(np.sqrt(done * share)) if done else _SHORTER_PART * share
        is_other = self._times(done) < self._times(shorter) < self._times(share)
        return shorter if is_other and 2 * self._rollouts.count < self._most else 0.0

    def _is_explained(self, readings: Readings) -> bool:
        """Return whether noise explains the residuals of a fitted part."""
        r = readings.residuals
        return _chi_squared(r, len(r), self._is_robust) <= _FAR

    def _times(self, share: float) -> int:
        """Return how many times of the logs a part has, at least one of each."""
        if share == 0:
            return 0
        return sum(
            max(1, int((log.time <= share * log.time[-1]).sum())) for log in self._rollouts.logs
        )

    def _tried(self, theta: FloatArray, share: float, slopes: bool = True) -> Readings | None:
        """Return the residuals for unknowns; None where the motion runs away."""
        try:
            readings = self._rollouts.readings(theta, share, slopes)
        except (IntegrationError, StoppedError):
            return None
        return readings if np.isfinite(readings.residuals).all() else None

    def _cost(self, readings: Readings, theta: FloatArray) -> float:
        return cost_of(readings.residuals, theta / self._scale, self._is_robust)

    def _linear(self, readings: Readings, theta: FloatArray) -> _Linear:
        """Return the residuals, and what unknowns are off from what was known, made linear."""
        assert readings.slope is not None  # every try has one
        weight = np.ones(len(readings.residuals))
        if self._is_robust:
            weight = np.sqrt(_HUBER / np.maximum(np.abs(readings.residuals), _HUBER))
        rows = np.vstack([readings.slope * self._scale * weight[:, None], np.eye(len(theta))])
        right = np.concatenate([weight * readings.residuals, theta / self._scale])
        return _Linear(rows, right, weight)


class _Linear:
    """Steps that lessen the squares of residuals ``rows @ step + right``.

    A damping is relative to the squares of the columns (J. J. Moré, *The Levenberg-Marquardt
    algorithm: implementation and theory*, 1978, doi:10.1007/BFb0067700).
    """

    def __init__(self, rows: FloatArray, right: FloatArray, weight: FloatArray) -> None:
        self._size, self._weight = np.sqrt((rows**2).sum(axis=0)), weight
        self._left, self._singular, self._directions = np.linalg.svd(rows / self._size, False)
        self._right = self._left.T @ right

    @property
    def offset(self) -> float:
        """By how much the squares would fall at their least, were they as linear as this."""
        return float(self._right @ self._right)

    def step(self, damping: float) -> tuple[FloatArray, float]:
        """Return a step, of no unknown too long, and by how much the squares should fall."""
        step = -(self._parts(damping, self._right) @ self._directions) / self._size
        step *= min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-300))
        moved = self._singular * (self._directions @ (self._size * step))
        return step, float(-(moved * (2 * self._right + moved)).sum())

    def next_damping(self, damping: float, foreseen: float, fell: float) -> float:
        """Return the damping of the next step, after one by which the squares fell so much."""
        if fell > _GOOD * foreseen:
            return damping * _LESS
        if fell < _POOR * foreseen:
            # Least of the parabola along the step: what is known is its slope and both ends.
            share = float(np.clip(foreseen / (2 * foreseen - fell), *_SHORTER))
            longest = share * np.linalg.norm(self._parts(damping, self._right))
            while np.linalg.norm(self._parts(damping, self._right)) > longest:
                damping *= 2
        return damping

    def bent(self, step: FloatArray, damping: float, ahead: FloatArray) -> FloatArray:
        """Return a step that keeps to the floor of a valley that is narrow and bent.

        It adds what the step lacks as residuals bend along it, unless that is too long (M. K.
        Transtrum and J. P. Sethna, *Improvements to the Levenberg-Marquardt algorithm for nonlinear
        least-squares minimization*, 2012, arXiv:1201.5885). ``ahead`` is how residuals change in
        the first part of the step.
        """
        along, count = self._size * step, len(ahead)
        moved = self._left[:count] @ (self._singular * (self._directions @ along))
        second = self._weight * ahead / _AHEAD**2 - moved / _AHEAD  # half of the derivative
        bend = -(self._parts(damping, self._left[:count].T @ second) @ self._directions)
        if np.linalg.norm(bend) > _BENT * np.linalg.norm(along):
            return step
        return np.asarray((along + bend) / self._size)

    def _parts(self, damping: float, right: FloatArray) -> FloatArray:
        return np.asarray(self._singular / (self._singular**2 + damping) * right)


def identifiability_of(rollouts: Rollouts, slope: FloatArray | None = None) -> Identifiability:
    """Return what readings with a slope tell of the unknowns, by default at what is known."""
    if slope is None:
        slope = rollouts.readings(np.zeros(rollouts.size), 1.0, slopes=True).slope
        assert slope is not None  # it was asked for
    _, triangle = np.linalg.qr(slope * rollouts.deviations, mode="reduced")
    _, singular, directions = np.linalg.svd(triangle)
    singular = np.concatenate([singular, np.zeros(rollouts.size - len(singular))])
    blind = (directions[singular < _BLIND] ** 2).sum(axis=0)
    left = directions.T**2 @ (1 / (1 + singular**2))
    is_told = (blind < _TOLD) & (left < _LEFT)
    return Identifiability(
        rollouts, tuple(rollouts.labels), frozen(singular), frozen(directions), frozen(is_told)
    )


def _result(
    rollouts: Rollouts, theta: FloatArray, readings: Readings, message: str, is_robust: bool
) -> Fit:
    from scipy.special import chdtrc  # here, as its import takes long

    assert readings.slope is not None  # every try has one
    identifiability = identifiability_of(rollouts, readings.slope)
    # What is known before pulls at what is found, and so it is part of the interval too: else those
    # of unknowns that noise nearly hides are too wide.
    known = identifiability.singular**2
    freedom = max(len(readings.residuals) - float((known / (1 + known)).sum()), 1.0)
    chi_squared = _chi_squared(readings.residuals, freedom, is_robust)
    p_value = None if is_robust else float(chdtrc(freedom, (readings.residuals**2).sum()))
    spread = max(chi_squared, float(np.finfo(float).tiny))
    variance = identifiability.directions.T**2 @ (spread / (spread + known))
    reach = _INTERVAL * np.sqrt(variance) * rollouts.deviations
    is_scaled = np.zeros(rollouts.size, dtype=bool)
    scaled = [unknown.is_scaled for unknown in rollouts.unknowns for _ in unknown.groups]
    is_scaled[: len(scaled)] = scaled
    interval = theta[:, None] + np.stack([-reach, reach], axis=1)
    interval[~identifiability.is_told | (message != "converged") | (chi_squared > _FAR)] = np.nan
    value = theta.copy()
    with np.errstate(over="ignore"):  # where little was known before: up to infinity
        for numbers in (value, interval):
            numbers[is_scaled] = np.exp(numbers[is_scaled])
    parameters = {
        unknown.name: frozen(unknown.values(own))
        for unknown, own in zip(rollouts.unknowns, rollouts.own(theta), strict=True)
    }
    return Fit(
        rollouts.model_for(theta), tuple(rollouts.logs), tuple(rollouts.labels), frozen(value),
        frozen(interval), MappingProxyType(parameters), identifiability, chi_squared, p_value,
        rollouts.count, message, rollouts, frozen(theta),
    )  # fmt: skip


def cost_of(residuals: FloatArray, scaled: FloatArray, is_robust: bool) -> float:
    """Return what a fit makes least, of residuals and unknowns in their standard deviations."""
    squares = residuals**2
    if is_robust:
        far = np.abs(residuals) > _HUBER
        squares = np.where(far, 2 * _HUBER * np.abs(residuals) - _HUBER**2, squares)
    return float(squares.sum()) + float((scaled**2).sum())


def _chi_squared(residuals: FloatArray, freedom: float, is_robust: bool) -> float:
    """Return squares of residuals a degree of freedom.

    Huber's loss bounds them, and divides by the part that is near: few that are far widen no
    interval (P. J. Huber, *Robust Statistics*, 1981, 7.6).
    """
    if not is_robust:
        return float((residuals**2).sum() / freedom)
    bounded = np.clip(residuals, -_HUBER, _HUBER)
    near = max(float((bounded == residuals).mean()), 1 / len(residuals))
    return float((bounded**2).sum() / freedom) / near**2


def _described(labels: Sequence[str], direction: FloatArray) -> str:
    """Return the unknowns of a direction, those of the same parameter together."""
    parts: dict[str, list[int]] = {}
    for i, label in enumerate(labels):
        parts.setdefault(label.split()[0], []).append(i)
    sign = np.sign(direction[np.abs(direction).argmax()])
    terms = []
    for name, members in parts.items():
        own = sign * direction[members]
        if np.abs(own).max() < 0.05:
            continue
        if np.ptp(own) < 0.02 and len(own) > 1:
            terms.append(f"{own.mean():+.2f} all of {name}")
            continue
        large = np.argsort(-np.abs(own), kind="stable")[:4]
        terms += [f"{own[k]:+.2f} {labels[members[k]]}" for k in large if abs(own[k]) >= 0.05]
    return ", ".join(terms)
