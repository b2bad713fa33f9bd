"""The Radau IIA method of order 5 with error control, from SciPy: for stiff strings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.integrate.integrator import Work
from tenscontrol.integrate.pieces import Piece, PiecewiseIntegrator, Step
from tenscontrol.validation import FloatArray

# Looked at so many times a step, its start counted: several switches may lie in one.
_LOOKS = 9

# From so many states on, the sparse factorization is faster than the dense one.
_SPARSE_FROM = 100

Slope = Callable[[float, FloatArray], FloatArray]
Jacobian = Callable[[float, FloatArray], Any]


@final
class Radau(PiecewiseIntegrator):
    """Implicit adaptive steps after Hairer & Wanner, by ``scipy.integrate.Radau``.

    L-stable: where strings are so stiff that an explicit step must follow
    their vibration, its step follows the motion instead. The Jacobian is exact,
    by CasADi, and sparse in large structures. Every step ends where a string
    goes slack or taut.

    Parameters
    ----------
    equation : Equation
    tolerance : float
        Error allowed a step, as part of the size of the structure for
        positions, and of its characteristic speed for velocities.
    project : bool
        Whether to make the bar lengths of the states returned exact.

    Notes
    -----
    Steps run in Python. A Jacobian counts as as many evaluations as it has
    times the instructions of the right-hand side. SciPy does not tell how many
    steps it rejected: they appear in the evaluations only.
    """

    name = "radau"

    def _prepare(self, equation: Equation) -> None:
        self._slope = Evaluator(equation.slope)
        jacobian = state_jacobian(equation.slope)
        self._pattern = jacobian.sparsity_out(0)
        self._sparse = equation.states >= _SPARSE_FROM
        self._jacobian = Evaluator(_stored(jacobian, self._sparse))
        self._weight = jacobian_weight(equation.slope, jacobian)

    def _begin(
        self,
        now: float,
        state: FloatArray,
        held: FloatArray,
        taut: FloatArray,
        times: FloatArray,
        before: Piece | None,
    ) -> Piece:
        from scipy.sparse import csc_array

        shape = self._pattern.shape
        rows, starts = np.array(self._pattern.row()), np.array(self._pattern.colind())

        def slope(time: float, x: FloatArray) -> FloatArray:
            return self._slope(x, held, taut)[0].copy()

        def jacobian(time: float, x: FloatArray) -> Any:
            values = self._jacobian(x, held, taut)[0].reshape(-1, order="F").copy()
            if not np.isfinite(values).all():
                raise FloatingPointError("the forces are no longer finite")
            if self._sparse:
                return csc_array((values, rows, starts), shape=shape)
            return values.reshape(shape, order="F")

        looks = _LOOKS if self._equation.switches else 2
        return _RadauPiece(
            slope, jacobian, now, state, float(times[-1]), self.tolerance, looks, self._weight
        )


class _RadauPiece:
    """Steps of SciPy's method with the strings' states fixed."""

    def __init__(
        self,
        slope: Slope,
        jacobian: Jacobian,
        now: float,
        state: FloatArray,
        until: float,
        tolerance: float,
        looks: int,
        weight: int,
    ) -> None:
        self._slope, self._jacobian = slope, jacobian
        self._tolerance, self._looks, self._weight = tolerance, looks, weight
        self._landed = Work()
        self._start = state
        self._stepper = self._method(now, state, until, None)

    @property
    def work(self) -> Work:
        """What was done so far, landings included."""
        return self._landed + self._counted(self._stepper)

    def step(self) -> Step:
        """Take a step of the method's own length."""
        self._start = self._stepper.y
        _advance(self._stepper)
        end = self._stepper.t
        self._landed += Work(steps=1)
        times = np.linspace(self._stepper.t_old, end, self._looks)
        return Step(times, self._stepper.dense_output(), self._stepper.y)

    def land(self, step: Step, time: float) -> FloatArray:
        """Integrate again: the interpolation has a lower order than the steps."""
        start = float(step.times[0])
        stepper = self._method(start, self._start, time, time - start)
        while stepper.status == "running":
            _advance(stepper)
        self._landed += self._counted(stepper)
        return np.asarray(stepper.y)

    def _method(self, now: float, state: FloatArray, until: float, first: float | None) -> Any:
        from scipy import integrate

        if not np.isfinite(self._slope(now, state)).all():
            # SciPy would choose a first step that is not a number.
            raise FloatingPointError("the forces are no longer finite")
        return integrate.Radau(
            self._slope, now, state, until, rtol=self._tolerance, atol=self._tolerance,
            jac=self._jacobian, first_step=first,
        )  # fmt: skip

    def _counted(self, stepper: Any) -> Work:
        return Work(evaluations=1 + stepper.nfev + self._weight * stepper.njev)


def _advance(stepper: Any) -> None:
    trouble = stepper.step()
    if stepper.status == "failed" or not np.isfinite(stepper.y).all():
        raise FloatingPointError(trouble or "the state is no longer finite")


def state_jacobian(slope: ca.Function) -> ca.Function:
    """Return the derivative of a right-hand side by its first input, sparse; same inputs."""
    inputs = slope.sx_in()
    return ca.Function("jacobian", inputs, [ca.jacobian(slope(*inputs), inputs[0])])


def jacobian_weight(slope: ca.Function, jacobian: ca.Function) -> int:
    """Return how many evaluations of a right-hand side one of its Jacobian is worth."""
    inputs = slope.sx_in()
    written = ca.Function("written", inputs, [slope(*inputs)])  # in whatever form it comes
    return max(1, round(int(jacobian.n_instructions()) / int(written.n_instructions())))


def _stored(jacobian: ca.Function, sparse: bool) -> ca.Function:
    """Return the Jacobian as it is handed over: its entries in a column, or a full matrix."""
    inputs = jacobian.sx_in()
    matrix = jacobian(*inputs)
    entries = matrix.nz[:] if sparse else ca.densify(matrix)
    return ca.Function("entries", inputs, [entries])
