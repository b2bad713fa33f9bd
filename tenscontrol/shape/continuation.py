"""Equilibria between two equilibria, and how they change along the way."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Evaluator, builds
from tenscontrol.shape.nonlinear_program import EXACT, ShapeProblem
from tenscontrol.validation import FloatArray

# Weight of γ against positions, both in their units.
_FORCES = 1e-2

# Newton steps, and changes of the set of strings on a bound, for one point.
_STEPS, _CHANGES = 12, 8

# Longest and shortest piece of a path, and how far a prediction may be off, in sizes.
_LONGEST, _SHORTEST, _OFF = 1 / 32, 1 / 8192, 0.01


@dataclass(frozen=True, eq=False)
class Waypoint:
    """An equilibrium on the way."""

    place: float  # s, from 0 to 1
    values: FloatArray  # the unknowns of the problem
    slope: FloatArray  # their derivative with respect to s
    multipliers: FloatArray  # of the equations


class Continuation:
    """The equilibria nearest to the straight line from one to another.

    At each s the squared distance ``‖y − y(s)‖² + w ‖g − g(s)‖²`` is least among the equilibria
    with γ in its bounds, which are in units of the level. Its conditions (Karush, Kuhn and Tucker)
    are solved by Newton steps with an active set, from a prediction along the tangent.
    """

    @builds
    def __init__(
        self,
        problem: ShapeProblem,
        start: FloatArray,
        goal: FloatArray,
        low: FloatArray,
        high: FloatArray,
    ) -> None:
        self.problem, self._start, self._goal = problem, start, goal
        self._low, self._high = low, high
        v, s = problem.unknowns, ca.SX.sym("s")
        rows = problem.tension_rows
        self._rows = np.arange(rows.start, rows.stop)
        straight = (1 - s) * ca.DM(start) + s * ca.DM(goal)
        off = v - straight
        cost = ca.sumsqr(off[: rows.start]) + _FORCES * ca.sumsqr(off[rows])
        mu = ca.SX.sym("mu", problem.equations.numel())
        slope = ca.gradient(cost + ca.dot(mu, problem.equations), v)
        conditions = ca.vertcat(slope, problem.equations)
        unknowns = ca.vertcat(v, mu)
        parts = [conditions, ca.jacobian(conditions, unknowns), ca.jacobian(conditions, s)]
        dense = [ca.densify(part) for part in parts]
        self._newton = Evaluator(ca.Function("conditions", [unknowns, s], dense))

    def first(self) -> Waypoint:
        """Return the start."""
        still = np.zeros(self.problem.equations.numel())
        found = self.at(0.0, self._start, still)
        if found is None:
            raise ArithmeticError("the start does not solve the equations of equilibrium")
        return found

    def at(self, place: float, values: FloatArray, multipliers: FloatArray) -> Waypoint | None:
        """Return the waypoint at s from a guess, or None if Newton does not get there."""
        size = len(values)
        point = np.concatenate([values, multipliers])
        g = values[self._rows]
        at_low = g - self._low < 1e-9
        at_high = self._high - g < 1e-9
        for _ in range(_CHANGES):
            pinned = self._rows[at_low | at_high]
            bound = np.where(at_low, self._low, self._high)[at_low | at_high]
            reached = self._converged(point, place, pinned, bound)
            if reached is None:
                return None
            point, jacobian, along, forces = reached
            g = point[self._rows]
            # A bound that is left, or that pulls the wrong way, changes sides.
            below, above = (g < self._low) & ~at_low, (g > self._high) & ~at_high
            push = forces[self._rows]
            wrong = (at_low & (push < -1e-9)) | (at_high & (push > 1e-9))
            wrong &= self._low < self._high
            if not (below | above | wrong).any():
                change = np.asarray(np.linalg.solve(jacobian, -along), dtype=float)
                return Waypoint(place, point[:size], change[:size], point[size:])
            at_low, at_high = (at_low & ~wrong) | below, (at_high & ~wrong) | above
        return None

    def _converged(
        self, point: FloatArray, place: float, pinned: np.ndarray, bound: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
        """Newton with some γ on their bounds; return point, Jacobian, d/ds, and all conditions."""
        point = point.copy()
        point[pinned] = bound
        last = np.inf
        for _ in range(_STEPS):
            residual, jacobian, along = (part.copy() for part in self._newton(point, place))
            forces = residual.copy()
            residual[pinned], along[pinned] = 0.0, 0.0
            jacobian[pinned] = 0.0
            jacobian[pinned, pinned] = 1.0
            worst = float(np.abs(residual).max())
            if worst < EXACT and not worst < last / 2:
                return point, jacobian, along, forces
            if not np.isfinite(worst) or worst > 1e6:
                return None
            last = worst
            try:
                point = point - np.linalg.solve(jacobian, residual)
            except np.linalg.LinAlgError:
                return None
        return (point, jacobian, along, forces) if worst < EXACT else None

    def waypoints(self) -> tuple[list[Waypoint], bool]:
        """Return equilibria close to one another from the start on, and whether all the way."""
        here = self.first()
        way, step = [here], _LONGEST
        while here.place < 1:
            place = 1.0 if here.place + step > 1 - 1e-12 else here.place + step
            guess = here.values + (place - here.place) * here.slope
            there = self.at(place, guess, here.multipliers)
            count = self._rows[0]
            off = np.inf if there is None else np.abs(there.values - guess)[:count].max()
            if there is not None and off <= _OFF:
                here = there
                way.append(here)
                step = min(2 * step, _LONGEST)
            elif step <= _SHORTEST:
                return way, False
            else:
                step /= 2
        rest = np.abs(here.values - self._goal)[: self._rows[-1] + 1].max()
        return way, bool(rest < 1e-6)
