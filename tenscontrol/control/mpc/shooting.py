"""The motion of a plant over the samples of a horizon, with derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import casadi as ca
import numpy as np

from tenscontrol.control.mpc.stage_jacobians import Tangents, evaluated
from tenscontrol.dynamics import Evaluator, compiled
from tenscontrol.plant import LinearPlant, acceleration_response, sampled_dynamics
from tenscontrol.validation import FloatArray


class Motion(ABC):
    """What a sample does to the state: for one sample, and to first order for N of a plan at once.

    A plan may have more than states and inputs: the accelerations at the stages of implicit
    steps, shape (N, stages, r). Explicit steps have none.

    Parameters
    ----------
    function : casadi.Function
        What is evaluated along the plan, mapped.
    machine_code : bool
        Whether to compile it where there is a C compiler.

    Attributes
    ----------
    back_end : str
        ``"machine code"`` or ``"virtual machine"``.
    ramp : bool
        Whether the input moves through a sample, so that the one before matters too.
    """

    ramp: bool

    def __init__(self, function: ca.Function, machine_code: bool) -> None:
        self._evaluator, self.back_end = evaluator(function, machine_code)

    @property
    def calls(self) -> int:
        """How often derivatives were evaluated along a plan."""
        return self._evaluator.calls

    @property
    @abstractmethod
    def sampled(self) -> ca.Function:
        """``(z, u) -> z⁺``, or ``(z, u_before, u) -> z⁺`` where winches wind."""

    @abstractmethod
    def advance(
        self, state: FloatArray, before: FloatArray, held: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the state a sample later, shape (s,), and the stages, shape (stages, r).

        Not a number where the dynamics have no value, or an implicit step is not solved.

        Parameters
        ----------
        state : ndarray, shape (s,)
        before, held : ndarray, shape (α,)
            The input of the sample before, and that of this one.
        """

    @abstractmethod
    def expected(
        self, state: FloatArray, before: FloatArray, held: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return the state a sample later under a load, and its derivative by it, shape (s, r).

        The derivative is None where that of the operating point is taken.

        Parameters
        ----------
        state, before, held : ndarray
            As above.
        load : ndarray, shape (r,)
            Constant accelerations beside those of the plant.
        """

    @abstractmethod
    def tangents(self, states: FloatArray, acting: FloatArray, stages: FloatArray) -> Tangents:
        """Return z_{k+1} to first order in z_k, u_k and, where winches wind, u_{k−1}.

        Parameters
        ----------
        states : ndarray, shape (N, s)
            z_0 … z_{N−1}.
        acting : ndarray, shape (N + 1, α)
            u_{−1} … u_{N−1}.
        stages : ndarray, shape (N, stages, r)
        """

    @abstractmethod
    def pushed(self, load: FloatArray) -> FloatArray:
        """Return what constant accelerations do to z_{k+1} linearized last, (s,) or (N, s)."""

    @abstractmethod
    def corrected(
        self,
        stages: FloatArray,
        states: FloatArray,
        acting: FloatArray,
        load: FloatArray | None = None,
    ) -> FloatArray:
        """Return the stages that were linearized last, corrected to first order.

        Parameters
        ----------
        stages : ndarray, shape (N, stages, r)
        states, acting : ndarray, shapes (N, s) and (N + 1, α)
            Changes since.
        load : ndarray, shape (r,), optional
            Constant accelerations.
        """


@final
class ExplicitMotion(Motion):
    """By RK4 in steps that resolve the fastest vibration; inputs jump at the starts of samples.

    Parameters
    ----------
    plant : LinearPlant
    sample_time : float
        Sample time, s.
    length : int
        N.
    machine_code : bool
        Whether to compile the derivatives where there is a C compiler.

    Attributes
    ----------
    linearized : casadi.Function
        ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)``, dense.
    """

    ramp = False

    def __init__(
        self, plant: LinearPlant, sample_time: float, length: int, machine_code: bool
    ) -> None:
        self._sampled, self.linearized = sampled_dynamics(plant, sample_time)
        super().__init__(self.linearized.map(length), machine_code)
        self._advance = Evaluator(self._sampled)
        self._push = acceleration_response(plant, sample_time)
        self._no_stages = np.zeros((0, plant.degrees_of_freedom))

    @property
    def sampled(self) -> ca.Function:
        """See :attr:`Motion.sampled`."""
        return self._sampled

    def advance(
        self, state: FloatArray, before: FloatArray, held: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Motion.advance`."""
        return self._advance(state, held)[0].copy(), self._no_stages

    def expected(
        self, state: FloatArray, before: FloatArray, held: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, None]:
        """See :meth:`Motion.expected`."""
        return self._push @ load + self._advance(state, held)[0], None

    def tangents(self, states: FloatArray, acting: FloatArray, stages: FloatArray) -> Tangents:
        """See :meth:`Motion.tangents`."""
        return evaluated(self._evaluator, states, acting[1:])

    def pushed(self, load: FloatArray) -> FloatArray:
        """See :meth:`Motion.pushed`."""
        return np.asarray(self._push @ load)

    def corrected(
        self,
        stages: FloatArray,
        states: FloatArray,
        acting: FloatArray,
        load: FloatArray | None = None,
    ) -> FloatArray:
        """See :meth:`Motion.corrected`: there is nothing to correct."""
        return stages


def evaluator(function: ca.Function, machine_code: bool) -> tuple[Evaluator, str]:
    """Return an evaluator, compiled where that is wished and can be, and which it is."""
    code = compiled(function) if machine_code else None
    if code is None:
        return Evaluator(function), "virtual machine"
    return Evaluator(code.function), "machine code"
