"""A plant linearized along a trajectory: its motion and what is limited."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from tenscontrol.analysis import LinearPlant
from tenscontrol.control.constraints import Constraints
from tenscontrol.control.load_observer import LoadObserver
from tenscontrol.control.problem import Rows
from tenscontrol.control.reduced_dynamics import (
    reduced_acceleration,
    reduced_motion,
    sampled_dynamics,
)
from tenscontrol.control.strings import spreading, string_forces
from tenscontrol.dynamics import Evaluator
from tenscontrol.dynamics.compiled import compiled
from tenscontrol.validation import FloatArray

# At a shape that changes its stiffness by a tenth these leave 1e-5 of what was off.
NEWTON_STEPS = 5


@dataclass(frozen=True, eq=False)
class Tangents:
    """First-order functions along a trajectory: ``value ≈ offset + Σ slope · argument``.

    Slopes are stored by columns: entry [k, j, i] is the derivative of value i by argument j.

    Attributes
    ----------
    offset : ndarray, shape (N, m)
    slopes : tuple of ndarray, shape (N, columns, m) each
        By z_k, u_k and, for limited rows, z_{k+1}. Views of memory that the next call overwrites.
    """

    offset: FloatArray
    slopes: tuple[FloatArray, ...]


class TrajectoryModel:
    """The motion of a plant over N samples, and the values of limited rows, with derivatives.

    Parameters
    ----------
    plant : LinearPlant
    step : float
        Sample time, s.
    length : int
        N.
    constraints : Constraints
        What is limited beside the inputs.
    machine_code : bool
        Whether to compile the derivatives where there is a C compiler.

    Attributes
    ----------
    sampled : casadi.Function
        ``(z, u) -> z⁺``.
    linearized : casadi.Function
        ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)``, dense.
    acceleration : casadi.Function
        ``(z, u) -> q̈``.
    limited : casadi.Function or None
        ``(z, u, z⁺) -> (y, ∂y/∂z, ∂y/∂u, ∂y/∂z⁺)`` of the rows that are limited, dense.
    """

    def __init__(
        self,
        plant: LinearPlant,
        step: float,
        length: int,
        constraints: Constraints,
        machine_code: bool,
    ) -> None:
        self.sampled, self.linearized = sampled_dynamics(plant, step)
        self._advance = Evaluator(self.sampled)
        self._length = length
        self.back_end = "virtual machine"
        self.motion = self._evaluator(self.linearized, machine_code)
        self.acceleration = reduced_acceleration(plant)
        self._acceleration = Evaluator(self.acceleration.map(length))
        rows = limited_rows(plant, constraints)
        self.limited = None if rows is None else _dense(rows)
        self._rows = None if rows is None else self._evaluator(self.limited, machine_code)
        self._patterns = () if rows is None else tuple(
            np.array(ca.DM(rows.sparsity_out(i), 1.0)) for i in (1, 2, 3)
        )  # fmt: skip

    def with_places(self, rows: Rows | None) -> Rows | None:
        """Return limited rows with ones where a derivative can be other than zero."""
        if rows is None:
            return None
        before, inputs, after = self._patterns
        return replace(rows, before=before, inputs=inputs, after=after)

    def _evaluator(self, function: ca.Function, machine_code: bool) -> Evaluator:
        mapped = function.map(self._length)
        code = compiled(mapped) if machine_code else None
        if code is None:
            return Evaluator(mapped)
        self.back_end = "machine code"
        return Evaluator(code.function)

    def advance(self, state: FloatArray, held: FloatArray) -> FloatArray:
        """Return the state a sample later, shape (s,)."""
        return self._advance(state, held)[0].copy()

    def at_rest(
        self, reference: FloatArray, held: FloatArray, observer: LoadObserver
    ) -> tuple[FloatArray, FloatArray]:
        """Return references (N, s) and inputs (N, α) moved to rest under the estimated load.

        Newton's method on the accelerations of the nonlinear plant, with the derivatives of
        the linear one.
        """
        r = reference.shape[1] // 2
        reference, held, still = reference.copy(), held.copy(), np.zeros_like(reference[:, :r])
        for _ in range(NEWTON_STEPS):
            states = np.hstack([reference[:, :r], still])
            columns = (x.T if len(x) > 1 else x[0] for x in (states, held))
            left = self._acceleration(*columns)[0].reshape(r, -1, order="F").T
            shift, effort = observer.model.rest(left + observer.acceleration)
            reference[:, :r] += shift
            held += effort
        return reference, held

    def tangents(self, states: FloatArray, inputs: FloatArray) -> tuple[Tangents, Tangents | None]:
        """Return the motion and the limited rows, linearized; None where no row is limited.

        Parameters
        ----------
        states : ndarray, shape (N + 1, s)
        inputs : ndarray, shape (N, α)
        """
        here, later = np.ascontiguousarray(states[:-1]), np.ascontiguousarray(states[1:])
        motion = self._tangents(self.motion, here, inputs)
        rows = None if self._rows is None else self._tangents(self._rows, here, inputs, later)
        return motion, rows

    def _tangents(self, evaluator: Evaluator, *arguments: FloatArray) -> Tangents:
        N = self._length
        # One sample is a vector to an evaluator, several are columns.
        values, *slopes = evaluator(*(x.T if N > 1 else x[0] for x in arguments))
        offset = values.reshape(-1, N, order="F").T.copy()
        blocks = []
        for slope, argument in zip(slopes, arguments, strict=True):
            by_columns = slope.ravel(order="K").reshape(N, argument.shape[1], -1)
            offset -= (argument[:, None, :] @ by_columns)[:, 0]
            blocks.append(by_columns)
        return Tangents(offset, tuple(blocks))


def limited_rows(plant: LinearPlant, constraints: Constraints) -> ca.Function | None:
    """Return ``(z, u, z⁺) -> (y, ∂y/∂z, ∂y/∂u, ∂y/∂z⁺)`` of the rows that are limited.

    Force densities are those of strings that pull, and negative beyond, so that a slack string
    still says which way it gets taut. None where no row is limited.
    """
    if not constraints.blocks:
        return None
    s, a = plant.B.shape
    z, u, later = ca.SX.sym("z", s), ca.SX.sym("u", a), ca.SX.sym("later", s)
    forces = string_forces(plant, plant.input, *reduced_motion(plant, z), spreading(plant, u))
    kinds = {"force_density": forces[0], "tension": forces[1]}
    shape = ca.vec(reduced_motion(plant, later)[0])
    y = ca.vertcat(*(
        kinds[block.along] if block.along else ca.mtimes(ca.DM(block.on_nodes), shape)
        for block in constraints.blocks
    ))  # fmt: skip
    parts = [y, *(ca.jacobian(y, by) for by in (z, u, later))]
    return ca.Function("rows", [z, u, later], ca.cse(parts))


def _dense(function: ca.Function) -> ca.Function:
    arguments = function.sx_in()
    outputs = [ca.densify(part) for part in function(*arguments)]
    return ca.Function(function.name(), arguments, outputs)
