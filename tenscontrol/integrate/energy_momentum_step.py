"""One step that conserves energy and momenta and keeps bar lengths, as equations to be solved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, kernel


@dataclass(frozen=True, eq=False)
class StepEquations:
    """The equations of a step of length h from x, in the mean velocities y over the step.

    y holds, 3 entries each: the mean velocities of the centres of free bars,
    the mean angular velocities of free bars and of bars that swing, times the
    bar length, and the mean velocities of string nodes, all m/s.

    Attributes
    ----------
    system : casadi.Function
        ``(y, x, u, h) -> (residual, jacobian)``, kg m/s and kg; the Jacobian sparse.
    guess : casadi.Function
        ``(x) -> y`` of a motion without forces.
    end : casadi.Function
        ``(y, x, h) -> x`` at the end of the step.
    """

    system: ca.Function
    guess: ca.Function
    end: ca.Function


def step_equations(equation: Equation) -> StepEquations:
    """Return the equations of a step.

    Parameters
    ----------
    equation : Equation
        With a structure.
    """
    structure = equation.structure
    assert structure is not None  # checked by the integrator
    motion = _Motion(equation)
    x, u, h = ca.SX.sym("x", equation.states), ca.SX.sym("u", equation.inputs), ca.SX.sym("h")
    y = ca.SX.sym("y", motion.size)
    start = motion.start(x)
    end, middle_bars = motion.moved(start, y, h)
    gamma = u if equation.law is None else _mean_force_density(equation, start["N"], end, u, h)
    middle = (start["N"] + end) / 2
    load = None if equation.load is None else ca.sparsify(ca.DM(equation.load))
    F = kernel.node_forces(structure, middle, gamma, load)
    residual = motion.impulse_balance(start, y, h, middle_bars, F)
    return StepEquations(
        system=ca.Function("system", [y, x, u, h], [residual, ca.jacobian(residual, y)]),
        guess=ca.Function("guess", [x], [motion.mean(start)]),
        end=ca.Function("end", [y, x, h], [motion.end_state(start, y, h, end)]),
    )


def _mean_force_density(equation: Equation, N0: Any, N1: Any, rest: Any, h: Any) -> Any:
    """Return 2 T̄/(l₀ + l₁), where T̄ is the mean of the tension over the lengths passed.

    ``T̄ (l₁ − l₀)`` is then the change of the stored energy: a discrete gradient.
    A string that is slack on a part of the way pulls on the other part only.
    For laws in which the tension is linear in the length, the mean over the
    taut part is the tension in its middle.
    """
    structure, law = equation.structure, equation.law
    assert structure is not None  # as in step_equations
    assert law is not None  # asked for only where there is a law
    lengths = []
    for N in (N0, N1):
        S = kernel.differences(N, structure.strings)
        lengths.append(ca.sqrt(kernel.dots(S, S)).T)
    before, after = lengths
    low, high = ca.fmax(before, rest), ca.fmax(after, rest)
    was, is_ = before > rest, after > rest
    change = after - before
    crossing = was != is_
    share = ca.if_else(crossing, (high - low) / ca.if_else(crossing, change, 1), was)
    tension = law.tension((low + high) / 2, rest)
    if law.is_damped:
        tension = ca.fmax(0, tension + ca.DM(law.damping) * change / h)
    return 2 * share * tension / (before + after)


class _Motion:
    """Bars as a centre and a vector that turns, string nodes as points.

    Bars turn by the Cayley map of the mean angular velocity, which keeps the
    length whatever that velocity is.
    """

    def __init__(self, equation: Equation) -> None:
        structure = equation.structure
        assert structure is not None  # as in step_equations
        self._structure = structure
        self._free = structure.free.tolist()
        self._starts, self._ends = structure.bars[structure.free_bars].T.tolist()
        self._pivots, self._tips = structure.hinged_pairs.T.tolist()
        self._points = structure.string_nodes.tolist()
        turning = np.concatenate([structure.free_bars, structure.swinging_bars])
        self._length = ca.DM(structure.bar_length[turning]).T
        self._bar_mass = ca.DM(structure.bar_mass[structure.free_bars]).T
        self._swing_mass = ca.DM(structure.bar_mass[structure.swinging_bars]).T
        self._point_mass = ca.DM(structure.string_node_mass).T
        self._counts = [len(self._starts), len(turning), len(self._points)]
        self.size = 3 * sum(self._counts)

    def _split(self, y: Any) -> list[Any]:
        parts = np.cumsum([0, *self._counts]).tolist()
        return list(ca.horzsplit(ca.reshape(y, 3, -1), parts))

    def start(self, x: Any) -> dict[str, Any]:
        """Return nodes, bar vectors of true length, and the velocities as y has them."""
        structure = self._structure
        half = x.shape[0] // 2
        N, Nd = ca.SX(3, structure.nodes.shape[1]), ca.SX(3, structure.nodes.shape[1])
        N[:, structure.fixed.tolist()] = ca.DM(structure.nodes[:, structure.fixed])
        N[:, self._free] = ca.reshape(x[:half], 3, -1)
        Nd[:, self._free] = ca.reshape(x[half:], 3, -1)
        tails, heads = self._starts + self._pivots, self._ends + self._tips
        B = _of_length(N[:, heads] - N[:, tails], self._length)
        # The start is put on the constraint as the end will be: no jump between the two.
        centres = (N[:, self._starts] + N[:, self._ends]) / 2
        self._place(N, centres, B)
        turn = kernel.scale_columns(_cross(B, Nd[:, heads] - Nd[:, tails]), 1 / self._length)
        return {
            "N": N,
            "B": B,
            "centres": centres,
            "velocity": (Nd[:, self._starts] + Nd[:, self._ends]) / 2,
            "turn": turn,
            "points": Nd[:, self._points],
        }

    def mean(self, start: dict[str, Any]) -> Any:
        """Return y where no force acts."""
        return ca.vec(ca.horzcat(start["velocity"], start["turn"], start["points"]))

    def moved(self, start: dict[str, Any], y: Any, h: Any) -> tuple[Any, Any]:
        """Return the nodes at the end, and the bar vectors halfway between start and end."""
        velocity, turn, points = self._split(y)
        B0 = start["B"]
        a = kernel.scale_columns(turn, h / 2 / self._length)
        swept = _cross(a, B0)
        swept += _cross(a, swept)
        half = kernel.scale_columns(swept, 1 / (1 + kernel.dots(a, a)))
        N = ca.SX(start["N"])
        self._place(N, start["centres"] + h * velocity, _of_length(B0 + 2 * half, self._length))
        N[:, self._points] = start["N"][:, self._points] + h * points
        return N, B0 + half

    def _place(self, N: Any, centres: Any, B: Any) -> None:
        free = self._counts[0]
        N[:, self._starts] = centres - B[:, :free] / 2
        N[:, self._ends] = centres + B[:, :free] / 2
        N[:, self._tips] = N[:, self._pivots] + B[:, free:]

    def impulse_balance(self, start: dict[str, Any], y: Any, h: Any, B: Any, F: Any) -> Any:
        """Return change of momentum less impulse of the forces F, with B halfway."""
        velocity, turn, points = self._split(y)
        at_start, at_end = F[:, self._starts], F[:, self._ends]
        scale = kernel.scale_columns
        parts = [scale(velocity - start["velocity"], 2 * self._bar_mass) - h * (at_start + at_end)]
        # I = m l²/12 about the centre of a free bar, m l²/3 about the fixed end of one that swings.
        inertia = ca.horzcat(self._bar_mass / 6, self._swing_mass * 2 / 3)
        lever = ca.horzcat((at_end - at_start) / 2, F[:, self._tips])
        torque = scale(_cross(B, lever), h / self._length)
        parts.append(scale(turn - start["turn"], inertia) - torque)
        parts.append(scale(points - start["points"], 2 * self._point_mass) - h * F[:, self._points])
        return ca.vec(ca.densify(ca.horzcat(*parts)))

    def end_state(self, start: dict[str, Any], y: Any, h: Any, N: Any) -> Any:
        """Return x at the end: velocities there are twice the mean less those at the start."""
        free = self._counts[0]
        velocity, turn, points = self._split(2 * y - self.mean(start))
        tails, heads = self._starts + self._pivots, self._ends + self._tips
        Bd = _cross(kernel.scale_columns(turn, 1 / self._length), N[:, heads] - N[:, tails])
        Nd = ca.SX(3, N.shape[1])
        Nd[:, self._starts] = velocity - Bd[:, :free] / 2
        Nd[:, self._ends] = velocity + Bd[:, :free] / 2
        Nd[:, self._tips] = Bd[:, free:]
        Nd[:, self._points] = points
        return ca.vertcat(ca.vec(N[:, self._free]), ca.vec(ca.densify(Nd[:, self._free])))


def _cross(a: Any, b: Any) -> Any:
    """Return the cross products of the columns of two (3, k) matrices."""
    return ca.vertcat(
        a[1, :] * b[2, :] - a[2, :] * b[1, :],
        a[2, :] * b[0, :] - a[0, :] * b[2, :],
        a[0, :] * b[1, :] - a[1, :] * b[0, :],
    )


def _of_length(B: Any, length: Any) -> Any:
    return kernel.scale_columns(B, length / ca.sqrt(kernel.dots(B, B)))
