"""A plant linearized along a trajectory: its motion and what is limited."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from tenscontrol.control.disturbance import LoadObserver
from tenscontrol.control.mpc.constraints import Constraints
from tenscontrol.control.mpc.implicit_shooting import ImplicitMotion
from tenscontrol.control.mpc.problem import Rows
from tenscontrol.control.mpc.shooting import ExplicitMotion, Motion, evaluator
from tenscontrol.control.mpc.stage_jacobians import Tangents, evaluated
from tenscontrol.dynamics import Evaluator
from tenscontrol.plant import (
    LinearPlant,
    acceleration_slopes,
    explicit_substeps,
    model_input,
    reduced_acceleration,
    reduced_motion,
    state_units,
    string_forces,
)
from tenscontrol.validation import FloatArray

# At a shape that changes its stiffness by a tenth these leave 1e-5 of what was off.
NEWTON_STEPS = 5

# With derivatives of their own the shapes of stiff strings take fewer.
_OWN_STEPS = 2

# Where rest lengths are held, and a sample takes more steps of RK4 than this, one implicit step
# takes their place, at less than half the cost. Where strings are soft, RK4 knows slack ones too.
_MOST_EXPLICIT = 4


class TrajectoryModel:
    """The motion of a plant over N samples, and the values of limited rows, with derivatives.

    Parameters
    ----------
    plant : LinearPlant
    sample_time : float
        Sample time, s.
    length : int
        N.
    constraints : Constraints
        What is limited beside the inputs.
    substeps : int
        Equal parts in which winches move through a sample.
    machine_code : bool
        Whether to compile the derivatives where there is a C compiler.

    Attributes
    ----------
    implicit : bool
        Whether steps are implicit: where winches wind or strings are stiff.
    motion : Motion
        Of a sample.
    back_end : str
        What evaluates the derivatives.
    acceleration : casadi.Function
        ``(z, u) -> q̈``.
    limited : casadi.Function or None
        ``(z, u, z⁺) -> (y, ∂y/∂z, ∂y/∂u, ∂y/∂z⁺)`` of the rows that are limited, dense.
    """

    def __init__(
        self,
        plant: LinearPlant,
        sample_time: float,
        length: int,
        constraints: Constraints,
        substeps: int,
        machine_code: bool,
    ) -> None:
        stiff = (
            plant.input == "rest_length" and explicit_substeps(plant, sample_time) > _MOST_EXPLICIT
        )
        self.implicit = stiff or substeps > 1
        self.motion: Motion
        if self.implicit:
            self.motion = ImplicitMotion(plant, sample_time, length, substeps, machine_code)
        else:
            self.motion = ExplicitMotion(plant, sample_time, length, machine_code)
        self.back_end = self.motion.back_end
        self._plant, self._sample_time = plant, sample_time
        self.acceleration = reduced_acceleration(plant, taut=self.implicit)
        known = acceleration_slopes(self.acceleration) if self.implicit else self.acceleration
        self._acceleration = Evaluator(known.map(length))
        rows = limited_rows(plant, constraints, at_end=self.motion.ramp)
        self.limited = None if rows is None else _dense(rows)
        if self.limited is not None:
            self._rows, _ = evaluator(self.limited.map(length), machine_code)
        self._patterns = () if rows is None else tuple(
            np.array(ca.DM(rows.sparsity_out(i), 1.0)) for i in (1, 2, 3)
        )  # fmt: skip

    def units(self, level: float) -> FloatArray:
        """Return units of the state in a program, shape (s,), with ``level`` that of an input.

        Implicit steps do not resolve fast vibrations. Where strings are stiff, one unit is then
        what a level holds, and the speed that moves it in a sample.
        """
        units, size = state_units(self._plant)
        if not self.implicit:
            return units
        held = units[: len(units) // 2] * level / size
        return np.asarray(np.minimum(units, np.concatenate([held, held / self._sample_time])))

    def with_places(self, rows: Rows | None) -> Rows | None:
        """Return limited rows with ones where a derivative can be other than zero."""
        if rows is None:
            return None
        before, inputs, after = self._patterns
        return replace(rows, before=before, inputs=inputs, after=after)

    def at_rest(
        self, reference: FloatArray, held: FloatArray, observer: LoadObserver
    ) -> tuple[FloatArray, FloatArray]:
        """Return references (N, s) and inputs (N, α) moved to rest under the estimated load.

        Newton's method on the accelerations of the nonlinear plant, with the derivatives of
        the linear one, or where strings are stiff with their own.
        """
        r = reference.shape[1] // 2
        reference, held, still = reference.copy(), held.copy(), np.zeros_like(reference[:, :r])
        for _ in range(_OWN_STEPS if self.implicit else NEWTON_STEPS):
            states = np.hstack([reference[:, :r], still])
            columns = (x.T if len(x) > 1 else x[0] for x in (states, held))
            values, *slopes = self._acceleration(*columns)
            left = values.reshape(r, -1, order="F").T + observer.acceleration
            if self.implicit:
                by_q, _, by_u = (
                    slope.ravel(order="K").reshape(len(left), -1, r).swapaxes(1, 2)
                    for slope in slopes
                )
                shift, effort = observer.model.rest_of(left, by_q, by_u)
            else:
                shift, effort = observer.model.rest(left)
            reference[:, :r] += shift
            held += effort
        return reference, held

    def tangents(
        self, states: FloatArray, acting: FloatArray, stages: FloatArray
    ) -> tuple[Tangents, Tangents | None]:
        """Return the motion and the limited rows, linearized; None where no row is limited.

        Parameters
        ----------
        states : ndarray, shape (N + 1, s)
        acting : ndarray, shape (N + 1, α)
            u_{−1} … u_{N−1}.
        stages : ndarray, shape (N, stages, r)
            Those of :class:`Motion`.
        """
        here, later = np.ascontiguousarray(states[:-1]), np.ascontiguousarray(states[1:])
        motion = self.motion.tangents(here, acting, stages)
        rows = None if self.limited is None else evaluated(self._rows, here, acting[1:], later)
        return motion, rows


def limited_rows(
    plant: LinearPlant, constraints: Constraints, at_end: bool = False
) -> ca.Function | None:
    """Return ``(z, u, z⁺) -> (y, ∂y/∂z, ∂y/∂u, ∂y/∂z⁺)`` of the rows that are limited.

    Force densities are those of strings that pull, and negative beyond, so that a slack string
    still says which way it gets taut. None where no row is limited.

    Parameters
    ----------
    plant : LinearPlant
    constraints : Constraints
    at_end : bool
        Whether strings are limited at the end of a sample, where winches that wind have brought
        them to u, and not at its start.
    """
    if not constraints.blocks:
        return None
    s, a = plant.B.shape
    z, u, later = ca.SX.sym("z", s), ca.SX.sym("u", a), ca.SX.sym("later", s)
    at = reduced_motion(plant, later if at_end else z)
    forces = string_forces(plant, plant.input, *at, model_input(plant, u))
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
