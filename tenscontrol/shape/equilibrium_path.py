"""Timed path of equilibria between two equilibria, by continuation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Evaluator, Function, builds
from tenscontrol.shape.nonlinear_program import EXACT, ShapeProblem
from tenscontrol.statics.prestress import Prestress, prestress

# Weight of γ against positions, both in their units.
_FORCES = 1e-2

# Newton steps, and changes of the set of strings on a bound, for one point.
_STEPS, _CHANGES = 12, 8

# Longest and shortest piece of a path, and how far a prediction may be off, in sizes.
_LONGEST, _SHORTEST, _OFF = 1 / 32, 1 / 8192, 0.01

# More shapes than a step needs, since the path is slowed down in the end; and what rounds off a
# rate.
_SPARE, _ROUND_OFF = 1.02, 1e-12

# Least pace, as a fraction of the largest: no division by zero where the nodes do not move.
_LEAST_PACE = 1e-6

# A motion as one body that moves no node by more than this part of the size moves none.
_STILL = 1e-9


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
        fields = [problem.neutral_fields(problem.read(end)[0]) for end in (start, goal)]
        if any(np.linalg.matrix_rank(of_end, _STILL) < of_end.shape[1] for of_end in fields):
            # A straight string is not moved by a turn about itself: the equations do not tell that
            # there is none.
            cost += ca.sumsqr(v[v.numel() - problem.neutral.shape[1] :])
        mu = ca.SX.sym("mu", problem.equations.numel())
        slope = ca.gradient(cost + ca.dot(mu, problem.equations), v)
        conditions = ca.vertcat(slope, problem.equations)
        unknowns = ca.vertcat(v, mu)
        outputs = [conditions, ca.jacobian(conditions, unknowns), ca.jacobian(conditions, s)]
        dense = [ca.densify(expression) for expression in outputs]
        self._newton = Evaluator(Function("conditions", [unknowns, s], dense))

    def first(self) -> Waypoint:
        """Return the start."""
        still = np.zeros(self.problem.equations.numel())
        waypoint = self.at(0.0, self._start, still)
        if waypoint is None:
            raise ArithmeticError("the start does not solve the equations of equilibrium")
        return waypoint

    def at(self, share: float, values: FloatArray, multipliers: FloatArray) -> Waypoint | None:
        """Return the waypoint at s from a guess, or None if Newton does not get there."""
        size = len(values)
        point = np.concatenate([values, multipliers])
        g = values[self._rows]
        at_low = g - self._low < 1e-9
        at_high = self._high - g < 1e-9
        for _ in range(_CHANGES):
            pinned = self._rows[at_low | at_high]
            bound = np.where(at_low, self._low, self._high)[at_low | at_high]
            reached = self._converged(point, share, pinned, bound)
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
                try:
                    change = np.asarray(np.linalg.solve(jacobian, -along), dtype=float)
                except np.linalg.LinAlgError:
                    return None  # paths part there: no single one goes on
                return Waypoint(share, point[:size], change[:size], point[size:])
            at_low, at_high = (at_low & ~wrong) | below, (at_high & ~wrong) | above
        return None

    def _converged(
        self, point: FloatArray, share: float, pinned: np.ndarray, bound: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
        """Newton with some γ on their bounds; return point, Jacobian, d/ds, and all conditions."""
        point = point.copy()
        point[pinned] = bound
        last = np.inf
        for _ in range(_STEPS):
            residual, jacobian, along = (output.copy() for output in self._newton(point, share))
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
            share = 1.0 if here.place + step > 1 - 1e-12 else here.place + step
            guess = here.values + (share - here.place) * here.slope
            reached = self.at(share, guess, here.multipliers)
            count = self._rows[0]
            off = np.inf if reached is None else np.abs(reached.values - guess)[:count].max()
            if reached is not None and off <= _OFF:
                here = reached
                way.append(here)
                step = min(2 * step, _LONGEST)
            elif step <= _SHORTEST:
                return way, False
            else:
                step /= 2
        rest = np.abs(here.values - self._goal)[: self._rows[-1] + 1].max()
        return way, bool(rest < 1e-6)


class PathError(ValueError):
    """No path through equilibria was found between two shapes.

    Attributes
    ----------
    reached : Prestress
        The last equilibrium on the way.
    """

    def __init__(self, message: str, reached: Prestress) -> None:
        super().__init__(message)
        self.reached = reached


class TimedPath:
    """A path laid out in time, each shape solved anew at its time.

    ``rates`` limit the winches and the drives of bars, m/s; ``step`` is the largest time between
    shapes, s.
    """

    def __init__(
        self,
        continuation: Continuation,
        waypoints: list[Waypoint],
        rates: tuple[FloatArray | None, ...],
        duration: float | None,
        step: float,
        ramp: float,
    ) -> None:
        self._continuation, self._waypoints = continuation, waypoints
        motion_of = PathMotion(continuation.problem)
        places = np.array([point.place for point in waypoints])
        pace = np.array([motion_of.pace(point, rates) for point in waypoints])
        scaling = TimeScaling(places, pace, ramp)
        total = scaling.shortest if duration is None else duration
        # A little more than needed: the path is slowed down below.
        size = 400 * continuation.problem.nodes.shape[1]
        validation.refuse_memory(f"step is {step:g} s", _SPARE * total / step, "shapes", size)
        count = max(3, ceil(_SPARE * total / step) + 1)
        share = np.linspace(0.0, 1.0, count)
        targets, speed = scaling.at(share)
        points = self._solved(places, targets)
        rows = [motion_of.motion(*pair) for pair in zip(points, speed, strict=True)]
        self.nodes, moves, self.force_density = (
            np.stack([r[i] for r in rows], -1) for i in (0, 1, 2)
        )
        self.rest_length: FloatArray | None = None
        self.rest_length_rate: FloatArray | None = None
        self.bar_length: FloatArray | None = None
        self.bar_length_rate: FloatArray | None = None
        self.shortest: float | None = None
        if continuation.problem.model.strings is not None:
            self.rest_length, winding = (np.stack([r[i] for r in rows], -1) for i in (3, 4))
            driven = [(self.rest_length, winding)]
            if len(rows[0]) > 5:
                self.bar_length, moving = (np.stack([r[i] for r in rows], -1) for i in (5, 6))
                driven.append((self.bar_length, moving))
            fastest = []
            for (lengths, moved), rate in zip(driven, rates, strict=False):
                if rate is not None:
                    limit = np.broadcast_to(rate, (len(moved),))[:, None]
                    jumps = np.diff(lengths, axis=1) * (count - 1)
                    fastest += [float((np.abs(speed) / limit).max()) for speed in (moved, jumps)]
            if fastest:
                # Between waypoints the pace was a guess; this is what the shapes need.
                self.shortest = max(fastest) * (1 + _ROUND_OFF)
                if duration is not None and duration < self.shortest:
                    raise ValueError(
                        f"duration is {duration:g} s, expected at least {self.shortest:.6g} s: "
                        "that is the speed limit of the winches"
                    )
                total = self.shortest if duration is None else duration
            self.rest_length_rate = winding / total
            self.bar_length_rate = None if self.bar_length is None else moving / total
        self.time = total * share
        self.velocities = moves / total
        self.residual = max(motion_of.unbalanced(point) for point in points)

    def _solved(self, places: FloatArray, targets: FloatArray) -> list[Waypoint]:
        """Return equilibria at these places, from guesses between the waypoints."""
        from scipy.interpolate import CubicHermiteSpline

        values = np.array([point.values for point in self._waypoints])
        slopes = np.array([point.slope for point in self._waypoints])
        guesses = CubicHermiteSpline(places, values, slopes)(targets)
        points = []
        for s, guess in zip(targets.tolist(), guesses, strict=True):
            before = self._waypoints[int(np.searchsorted(places, s, side="right")) - 1]
            waypoint = self._continuation.at(s, guess, before.multipliers)
            if waypoint is None:
                raise PathError(
                    f"no equilibrium found {100 * s:.4g} % of the way to the goal, although "
                    "there are some before and after. Add intermediate shapes",
                    rest_at(self._continuation.problem, before),
                )
            points.append(waypoint)
        return points


class TimeScaling:
    """The place on a path at any time.

    The pace p(s), given at ``places`` and straight in between, is the time that a unit of the path
    takes at full speed. The speed, as a share of the full one, rises over the share ``ramp`` of the
    duration by ``3τ² − 2τ³``, stays, and falls again; acceleration is zero at both ends of a ramp.
    """

    def __init__(self, places: FloatArray, pace: FloatArray, ramp: float) -> None:
        self._places = places
        self._pace = np.maximum(pace, _LEAST_PACE * pace.max())
        durations = np.diff(places) * (self._pace[1:] + self._pace[:-1]) / 2
        self._passed = np.concatenate([[0.0], np.cumsum(durations)])
        self._ramp = ramp

    @property
    def shortest(self) -> float:
        """The duration at which the full speed is just reached."""
        return float(self._passed[-1] / (1 - self._ramp))

    def at(self, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s and ds/dτ at shares τ of the duration, from 0 to 1."""
        r = self._ramp
        begun = np.clip(share / r, 0.0, 1.0)
        left = np.clip((1 - share) / r, 0.0, 1.0)
        speed = _step(begun) * _step(left) / (1 - r)
        travelled = r * _integral(begun) - r * _integral(left) + r / 2
        travelled = travelled + np.clip(share - r, 0.0, 1 - 2 * r)
        passed = np.clip(travelled / (1 - r), 0.0, 1.0) * self._passed[-1]
        k = np.clip(np.searchsorted(self._passed, passed, side="right") - 1, 0, len(self._pace) - 2)
        # Within a piece the pace is p + c x: passed = p x + c x²/2, solved for x.
        p, length = self._pace[k], self._places[k + 1] - self._places[k]
        c = (self._pace[k + 1] - p) / length
        rest = passed - self._passed[k]
        x = np.clip(2 * rest / (p + np.sqrt(np.maximum(p**2 + 2 * c * rest, 0.0))), 0.0, length)
        return self._places[k] + x, speed * self._passed[-1] / (p + c * x)


def _step(x: FloatArray) -> FloatArray:
    return x * x * (3 - 2 * x)


def _integral(x: FloatArray) -> FloatArray:
    return x**3 - x**4 / 2


class PathMotion:
    """Positions, forces and rest lengths of waypoints, and their rates."""

    @builds
    def __init__(self, problem: ShapeProblem) -> None:
        self._problem = problem
        model = problem.model
        v, dv = problem.unknowns, ca.SX.sym("dv", problem.unknowns.numel())
        N, gamma = problem.nodes, problem.gamma
        rows = [ca.vec(ca.densify(N)), gamma]
        if model.strings is not None:
            length = kernel.string_lengths(model.structure, N).T
            rows.append(model.strings.taut_rest_length(length, gamma))
        if problem.held is not None and problem.held.struts is not None:
            rows.append(problem.bar_lengths)
        rates = [ca.densify(ca.jtimes(row, v, dv)) for row in rows]
        self._read = Function("read", [v, dv], [*rows, *rates])
        self._equations = Function("equations", [v], [problem.equations])

    def motion(self, point: Waypoint, speed: float) -> list[FloatArray]:
        """Return nodes, velocities, γ, and rest lengths with their rates, at ds/dt.

        Then lengths of bars with their rates, where these are driven.
        """
        outputs = [
            np.array(output.full()).ravel() for output in self._read(point.values, point.slope)
        ]
        half = len(outputs) // 2
        shape = self._problem.model.structure.nodes.shape
        nodes, moves = (flat.reshape(shape, order="F") for flat in (outputs[0], outputs[half]))
        quantities = [nodes, speed * moves, outputs[1]]
        for value, rate in zip(outputs[2:half], outputs[half + 2 :], strict=True):
            quantities += [value, speed * rate]
        return quantities

    def pace(self, point: Waypoint, rates: tuple[FloatArray | None, ...]) -> float:
        """Return the time that a unit of the path takes; without a rate, its length in space."""
        quantities = self.motion(point, 1.0)
        # Of winches, and of drives of bars if there are.
        moved = zip(quantities[4::2], rates, strict=False)
        paces = [float((np.abs(speed) / rate).max()) for speed, rate in moved if rate is not None]
        return max(paces, default=float(np.linalg.norm(quantities[1], axis=0).max()))

    def unbalanced(self, point: Waypoint) -> float:
        """Return the largest unbalanced force, N."""
        problem = self._problem
        left = np.array(self._equations(point.values).full()).ravel()
        forces = left[: problem.positions.numel()]
        return float(np.abs(forces).max(initial=0.0) * problem.level * problem.size)


def rest_at(problem: ShapeProblem, point: Waypoint) -> Prestress:
    """Return a waypoint as an equilibrium of the structure."""
    nodes, gamma = problem.read(point.values)
    structure = replace(problem.model.structure, nodes=nodes)
    gamma = np.maximum(gamma, 0.0)
    return prestress(structure, gamma, external_force=problem.model.constant_force)
