"""Limits that a planned motion keeps at every instant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    bounds_of_inputs,
    changes_of_inputs,
    inputs_of,
)
from tenscontrol.actuation.motors import each_motor
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function, builds
from tenscontrol.dynamics.model import Model
from tenscontrol.optimize.collocation import POWER, Instant, Rows, positive, stacked
from tenscontrol.shape.force_bounds import checked_bounds
from tenscontrol.shape.held_strings import HeldStrings
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.bar_clearance import bar_distances
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import free_coordinates

# Strings keep this part of the force densities, and of the stretch, that they have at the ends: so
# none goes slack between the instants at which limits are kept.
_TAUT = 0.02

# Of the squared lengths of two bars: added where they may be parallel.
_PARALLEL = 1e-9

# Limits of places alone; by how much a limit, scaled to order one, may be passed at an end.
_OF_PLACES, _OFF = ("min_clearance", "obstacles"), 1e-9

# How CasADi calls a function of the nodes, and what users give.
Obstacles = Callable[[Any], Any]


@dataclass(frozen=True, eq=False)
class StringState:
    """Expressions of the strings at an instant, shape (α, 1) where nothing else is said."""

    nodes: Any  # (d, n), m
    velocities: Any  # (d, n), m/s
    input: Any  # rest lengths, m, or force densities, N/m
    input_rate: Any  # m/s or N/m/s
    length: Any  # m
    rate: Any  # m/s
    force_density: Any  # N/m
    pull: Any  # of the strings on each winch, N, shape (m, 1): Gᵀ T
    power: Any  # of the motors, W, shape (m, 1)


class MotionLimits:
    """Limits of a planned motion, from the arguments of a user.

    Attributes
    ----------
    actuation : Actuation
        From the m inputs, one a winch, to the strings.
    input_range : ndarray, shape (2, m)
        Least and largest input.
    rate : ndarray, shape (m,)
        Largest rate of the rest lengths, m/s; infinite where there is no limit, and where force
        densities are the input.
    level : float
        Size of the force densities, N/m.
    pull : ndarray, shape (m,)
        Largest force of the motors, N; may be infinite.
    inertia : ndarray, shape (m,), or None
        Of the motors, as the mass that it is to a rest length, kg; None where they have none.
    """

    def __init__(
        self,
        model: Model,
        driven: HeldStrings,
        winches: Winches | None,
        min_force_density: object,
        max_force_density: object,
        max_tension: object,
        max_power: object,
        min_clearance: object,
        obstacles: Obstacles | None,
        level: float,
    ) -> None:
        structure = model.structure
        count = len(structure.strings)
        self._model, self._input, self._structure = model, driven.input, structure
        self.actuation, self._matrix = driven.actuation, driven.actuation.matrix.toarray()
        self.level, self._size = level, structure.size
        is_wound = self._input == "rest_length"
        bounds = checked_bounds(
            model, min_force_density, max_force_density, winches if is_wound else None, driven
        )
        self.bounds = bounds
        none = np.full(count, np.inf)
        self.tension = validation.limit_per_member("max_tension", max_tension, count, "string")
        validation.positive("max_tension", self.tension, "tension in N")
        power = validation.limit_per_member("max_power", max_power, count, "string")
        validation.positive("max_power", power, "power in W")
        self.power = _least_by_winch(self.actuation, power)
        largest, self.pull = none, np.full(len(self.actuation.lead), np.inf)
        self.inertia = None
        if winches is not None:
            rate = winches.largest_rate
            if rate is not None:
                validation.one_or_per_member("winches.rate", rate, count)
                largest = np.broadcast_to(rate, count)
            self.pull = _most_pull(winches, self.actuation)
            self.inertia = _inertia(winches, self.actuation, self._input)
        pays_out = np.unique(self.actuation.input[self.actuation.ratio < 0])
        self._push = np.full_like(self.pull, np.inf)  # of strings that it pays out as it winds in
        self._push[pays_out] = self.pull[pays_out]
        has_winch = self.actuation.input >= 0
        self.rate = changes_of_inputs(self.actuation, largest if is_wound else none)
        self._length_rate = none if is_wound else np.where(has_winch, largest, np.inf)
        low, high = (np.zeros(count), none) if bounds.rest_length is None else bounds.rest_length
        if not is_wound:
            low, high = bounds.low, bounds.highest
        self.input_range = np.array(bounds_of_inputs(self.actuation, low, high))
        self._clearance = None
        if min_clearance is not None:
            self._clearance = validation.positive_number("min_clearance", min_clearance, "m")
        if obstacles is not None:
            validation.function("obstacles", obstacles, "nodes -> expressions of at least 0", 1)
        self._obstacles = obstacles
        self._least = np.zeros((2, count))  # force density and stretch of strings that are taut

    def keep_taut(self, ends: tuple[Prestress, Prestress]) -> None:
        """Let strings go no further towards slack than a part of what both ends have."""
        law = self._model.strings
        if self._input == "force_density" or law is None:
            return
        margins = []
        for rest in ends:
            length, gamma = rest.structure.string_length(), rest.force_density
            margins.append([gamma, length - law.rest_length(length, gamma)])
        self._least = _TAUT * np.min(margins, axis=0)

    @builds
    def refuse_end(self, name: str, rest: Prestress) -> None:
        """Raise if a limit does not hold at rest in an equilibrium, which is an end of the motion.

        Where force densities are the input, those of the equilibrium need not act.
        """
        structure, law = self._structure, self._model.strings
        value = rest.force_density
        if self._input == "rest_length":
            assert law is not None  # rest lengths are the input
            try:
                value = law.rest_length(rest.structure.string_length(), value)
            except ValueError as error:  # the strings are too soft
                raise ValueError(f"{name} is not held by the strings of model: {error}") from None
        value = inputs_of(self.actuation, value)
        places = free_coordinates(structure, rest.structure.nodes)
        symbols = [
            ca.SX.sym(letter, len(vector))
            for letter, vector in zip("nu", (places, value), strict=True)
        ]
        still = [ca.SX.zeros(len(vector)) for vector in (places, value)]
        rows = self.rows(Instant(symbols[0], still[0], symbols[1], still[1]))
        numbers = np.array(
            Function("rows", symbols, [ca.densify(rows.value)])(places, value)
        ).ravel()
        for label, number, low, high in zip(rows.labels, numbers, rows.low, rows.high, strict=True):
            is_fixed = self._input == "rest_length" or label in _OF_PLACES
            if is_fixed and not low - _OFF <= number <= high + _OFF:
                raise ValueError(
                    f"{name} is an end of the motion, but does not keep the limit of {label} at "
                    "rest: give another end, or a wider limit"
                )

    def rows(self, now: Instant) -> Rows:
        """Return what holds at an instant."""
        state = self.state(now)
        rows = [
            *self._string_rows(state),
            _at_most(state.power, self.power, POWER),
            # Of cables under force control.
            _at_most(state.rate, self._length_rate, "rate"),
            _at_most(-state.rate, self._length_rate, "rate"),
        ]
        if now.force is not None:  # whose limits are those of the input of the program
            low, high = self.input_range / self._size
            rows.append(Rows(now.input / self._size, low, high, ("range",) * len(low)))
            rows += [_at_most(sign * now.rate, self.rate, "rate") for sign in (1, -1)]
        else:
            rows.append(_at_most(state.pull, self.pull, "torque of the motors"))
            rows.append(_at_most(-state.pull, self._push, "torque of the motors"))
        if self._clearance is not None:
            apart = bar_clearances(self._structure, state.nodes)
            rows.append(positive((apart - self._clearance) / self._size, "min_clearance"))
        if self._obstacles is not None:
            rows.append(positive(_column(self._obstacles(state.nodes)) / self._size, "obstacles"))
        return stacked(rows)

    def state(self, now: Instant) -> StringState:
        """Return the strings at an instant, as if all were taut."""
        structure, law = self._structure, self._model.strings
        nodes = kernel.placed(structure, now.places, structure.nodes)
        velocities = kernel.placed(structure, now.velocities, np.zeros_like(structure.nodes))
        length, rate = (
            row.T for row in kernel.string_motion(structure, nodes, ca.densify(velocities))
        )
        values, turning = self.strings(now.input), self._times(self._matrix, now.rate)
        if self._input == "force_density":
            gamma, pull, shortening = values, values * length, rate
        else:
            assert law is not None  # rest lengths are the input
            gamma = law.taut_force_density(length, values, rate)
            wound = ca.SX.sym("wound", values.numel())
            stored = law.as_expressions().stored_energy(length, wound)
            pull = -ca.jtimes(stored, wound, ca.DM.ones(wound.shape))
            pull, shortening = ca.substitute(pull, wound, values), turning
        if now.force is None:
            power = self._times((self._matrix.T != 0).astype(float), -pull * shortening)
        else:
            power = -now.force * now.rate
        on_winches = self._times(self._matrix.T, pull)  # a string counts by its ratio
        return StringState(
            nodes, velocities, values, turning, length, rate, gamma, on_winches, power
        )

    def strings(self, inputs: Any) -> Any:
        """Return expressions of all strings, shape (α, 1), at those of the inputs, (m, 1)."""
        if self.actuation.is_whole:
            return inputs
        return ca.DM(self.actuation.offset) + self._times(self._matrix, inputs)

    def _times(self, matrix: FloatArray, values: Any) -> Any:
        """Return a matrix between inputs and strings times values of the one or the other."""
        if self.actuation.is_whole:
            return values
        return ca.mtimes(ca.sparsify(ca.DM(matrix)), values)

    def _string_rows(self, state: StringState) -> list[Rows]:
        """Return limits of force densities and tensions, and that strings are taut."""
        bounds, rows = self.bounds, list[Rows]()
        if self._input == "rest_length":
            least = np.maximum(bounds.low, self._least[0])
            kept = state.force_density / self.level
            label = ("force density",) * len(least)
            rows.append(Rows(kept, least / self.level, bounds.highest / self.level, label))
            law = self._model.strings
            if law is not None and law.is_damped:  # which pulls while it is too short
                spare = state.length - state.input - ca.DM(self._least[1])
                rows.append(positive(spare / self._size, "taut strings"))
        tension = state.force_density * state.length
        rows.append(_at_most(tension, self.tension, "max_tension"))
        return rows


def _least_by_winch(actuation: Actuation, values: FloatArray) -> FloatArray:
    """Return the least value of the strings of each winch, shape (m,)."""
    least, strings = np.full(len(actuation.lead), np.inf), actuation.driven
    np.minimum.at(least, actuation.input[strings], values[strings])
    return least


def _most_pull(winches: Winches, actuation: Actuation) -> FloatArray:
    """Return the force that each motor holds, N, (m,), or raise for motors not planned for."""
    motor, count = winches.motor, len(actuation.input)
    if motor is None:
        return np.full(len(actuation.lead), np.inf)
    if motor.lag.any() or motor.backlash.any():
        raise ValueError(
            "winches have motors with lag or backlash, which a plan does not know: give motors "
            "without them, and see by simulate(..., controller=...) how yours follow"
        )
    return _least_by_winch(actuation, each_motor(motor, count).most_tension)


def _inertia(winches: Winches, actuation: Actuation, input: str) -> FloatArray | None:
    """Return the masses that motors are to rest lengths, kg, shape (m,), or raise."""
    if winches.motor is None or not winches.motor.inertia.any():
        return None
    if input == "force_density":
        raise ValueError(
            "winches have motors with inertia, and force densities may jump from interval to "
            "interval: give motors without it, or plan with input='rest_length'"
        )
    motor = each_motor(winches.motor, len(actuation.input))
    inertia = (motor.inertia / motor.lever**2)[actuation.lead]
    none = np.flatnonzero(inertia == 0)
    if len(none):
        raise ValueError(
            f"the motor of string {actuation.lead[none[0]]} has no inertia beside others that have "
            "it: give all that turn an inertia, or none"
        )
    return np.asarray(inertia)


def _at_most(value: Any, limit: FloatArray, label: str) -> Rows:
    limited = np.flatnonzero(np.isfinite(limit)).tolist()
    return positive(1 - ca.vec(value[limited]) / ca.DM(limit[limited]), label)


def _column(value: Any) -> Any:
    """Return what a function of a user says as a column, or raise."""
    is_list = isinstance(value, list | tuple)
    columns = [ca.SX(0, 1)]
    for i, expression in enumerate(value if is_list else [value]):
        if not isinstance(expression, ca.SX):
            raise validation.wrong_kind(
                f"what obstacles returns{f', its entry {i},' if is_list else ''}", expression,
                "expressions in CasADi, as ca.sumsqr(nodes[:, 5] - centre) - radius**2",
            )  # fmt: skip
        columns.append(ca.vec(expression))
    return ca.vertcat(*columns)


def bar_clearances(structure: Structure, N: Any) -> Any:
    """Return expressions of the distances of all pairs of bars that share no node, m, SX."""
    distances = list[Any]()
    for i, j in bar_distances(structure, structure.nodes).pairs.tolist():
        (a, b), (c, d) = structure.bars[[i, j]].tolist()
        u, v, w = N[:, b] - N[:, a], N[:, d] - N[:, c], N[:, a] - N[:, c]
        uu, vv, uv = ca.dot(u, u), ca.dot(v, v), ca.dot(u, v)
        uw, vw = ca.dot(u, w), ca.dot(v, w)
        # The nearest places of two lines, then of their segments (Ericson 2005, 5.1.9).
        across = uu * vv - uv**2 + _PARALLEL * uu * vv
        s = _clipped((uv * vw - vv * uw) / across)
        t = _clipped((uv * s + vw) / vv)
        s = _clipped((uv * t - uw) / uu)
        gap = w + s * u - t * v
        distances.append(ca.norm_2(gap))
    return ca.vertcat(ca.SX(0, 1), *distances)


def _clipped(share: Any) -> Any:
    return ca.fmin(ca.fmax(share, 0), 1)
