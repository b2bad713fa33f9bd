"""Linear model predictive control of force densities that cannot be negative."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import final

import numpy as np

from tenscontrol.analysis import LinearPlant
from tenscontrol.control.bounds import input_bounds
from tenscontrol.control.controller import Controller
from tenscontrol.control.horizon import Condensed, Form, Horizon, Sparse
from tenscontrol.control.lqr import lqr
from tenscontrol.control.quadratic_program import QuadraticProgram, Status
from tenscontrol.control.reference import ReducedReference, Reference
from tenscontrol.control.weights import energy_weights, weight_matrix
from tenscontrol.validation import (
    FloatArray,
    choice,
    float_array,
    frozen,
    instance,
    per_member,
    positive,
    positive_number,
    whole_number,
)

FORMS = ("auto", "condensed", "sparse")

# Up to so many unknown inputs the dense form is the cheaper one: tests/benchmarks/mpc_step.py.
_LARGEST_CONDENSED = 600

# Input weight, in units of energy_weights, when the user gives none.
_INPUT_WEIGHT = 0.1


@dataclass(frozen=True, eq=False)
class MPCStatistics:
    """What became of the solves since the last reset.

    Attributes
    ----------
    status_count : dict of str to int
        How often each status came; ``"ok"`` is a solved program.
    fallbacks : int
        Commands that did not come from a solved program.
    iterations : ndarray of int, shape (K,)
        OSQP iterations of each solve.
    """

    status_count: dict[str, int]
    fallbacks: int
    iterations: np.ndarray


@final
class MPC(Controller):
    """Model predictive control with γ ≥ 0, whatever else.

    At each sample the plant is predicted over a horizon by its exact
    zero-order-hold discretization, a quadratic program is solved by OSQP, and
    the first input is applied. The terminal cost is that of the discrete LQR.

    If a program is not solved, the command is the next input of the last plan
    that was; when that is used up, γ of the operating point. Either is counted
    (:attr:`statistics`) and shows in the status of the command.

    Parameters
    ----------
    plant : LinearPlant
        In internal coordinates, with ``input="force_density"``.
    horizon : int
        Number of samples predicted, at least 1.
    step : float
        Sample time, s.
    max_force_density : float or array_like, shape (α,)
        Largest γ, N/m. The least is 0.
    Q : float or array_like, shape (2r,) or (2r, 2r), optional
        Weight of ``z − reference``. If not given, ω² on coordinates and 1 on
        rates, ω the highest frequency of the plant.
    R : float or array_like, shape (α,) or (α, α), optional
        Weight of the departure of γ from the operating point. If not given, a
        tenth of the cost of the displacement that the input would hold.
    max_change : float or array_like, shape (α,), optional
        Largest change of γ from sample to sample, N/m; no limit if not given.
    reference : Reference or array_like, shape (3, n), optional
        Shapes to follow, seen ahead over the horizon; a single shape is a
        constant one. The operating point if not given.
    form : {"auto", "condensed", "sparse"}
        How the program is written. Both give the same inputs; "auto" takes the
        cheaper one by size.
    tolerance : float
        OSQP's absolute and relative tolerance, in units of the largest γ at
        the operating point.
    max_iterations : int
        OSQP's limit.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, or the plant has a
        pole that no string reaches.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> mpc = tc.MPC(plant, horizon=20, step=0.02, max_force_density=300.0)
    >>> pushed = plant.to_nodes(np.r_[0.01, np.zeros(8)])
    >>> command = mpc.command(0.0, pushed, np.zeros((3, 6)))
    >>> command.status, bool((command.value >= 0).all()), command.value.shape
    ('ok', True, (9,))
    """

    def __init__(
        self,
        plant: LinearPlant,
        horizon: int,
        step: float,
        max_force_density: object,
        *,
        Q: object = None,
        R: object = None,
        max_change: object = None,
        reference: object = None,
        form: str = "auto",
        tolerance: float = 1e-4,
        max_iterations: int = 4000,
    ) -> None:
        instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        if plant.input != "force_density":
            raise ValueError(
                f"plant has input={plant.input!r}, but MPC commands force densities; "
                "linearize with input='force_density'"
            )
        if max_force_density is None:
            raise TypeError("max_force_density is None, expected a positive number in N/m")
        step = positive_number("step", step, "s")
        super().__init__(plant, step, *input_bounds(plant, max_force_density))
        states, count = plant.B.shape
        length = whole_number("horizon", horizon, least=1)
        natural_Q, natural_R = energy_weights(plant)
        state_weight = natural_Q if Q is None else weight_matrix("Q", Q, states, definite=False)
        input_weight = (
            _INPUT_WEIGHT * natural_R if R is None else weight_matrix("R", R, count, definite=True)
        )
        regulator = lqr(plant, state_weight, input_weight, step=step)
        change = None
        if max_change is not None:
            change = per_member("max_change", max_change, count, "string")
            positive("max_change", change, "change of force density in N/m")
        transition, input_matrix, drift = plant.discretize(step)
        problem = Horizon(
            transition=transition,
            input_matrix=input_matrix,
            drift=drift,
            state_weight=state_weight,
            input_weight=input_weight,
            terminal_weight=regulator.cost,
            low=self._low - plant.force_density,
            high=self._high - plant.force_density,
            change=change,
            length=length,
            level=float(plant.force_density.max()) or float(self._high.max()),
            feedback=regulator.gain,
        )
        if choice("form", form, FORMS) == "auto":
            form = "condensed" if problem.input_count <= _LARGEST_CONDENSED else "sparse"
        self._form: Form = Condensed(problem) if form == "condensed" else Sparse(problem)
        self._form_name = form
        self._program = QuadraticProgram(
            self._form.P,
            self._form.A,
            positive_number("tolerance", tolerance, "units of the largest force density"),
            whole_number("max_iterations", max_iterations, least=1),
        )
        self._problem = problem
        self._ahead: FloatArray = step * np.arange(1.0, length + 1)
        self.follow(reference)
        self.reset()

    @property
    def form(self) -> str:
        """``"condensed"`` or ``"sparse"``."""
        return self._form_name

    @property
    def statistics(self) -> MPCStatistics:
        """What became of the solves since the last reset."""
        counts = dict(Counter(self._statuses))
        return MPCStatistics(
            status_count=counts,
            fallbacks=len(self._statuses) - counts.get(Status.SOLVED.value, 0),
            iterations=frozen(np.array(self._iterations, dtype=np.int64)),
        )

    @property
    def plan(self) -> FloatArray:
        """γ that the last solved program planned, N/m, shape (α, N); empty before the first."""
        return frozen((self._plan + self.plant.force_density).T)

    def follow(self, reference: object) -> None:
        """Follow another reference from now on.

        Parameters
        ----------
        reference : Reference or array_like, shape (3, n), or None
            As in the constructor.

        Raises
        ------
        TypeError, ValueError
            If it does not fit the structure.
        """
        plant = self.plant
        shape = plant.nodes.shape
        if reference is None:
            reference = plant.nodes
        if not isinstance(reference, Reference):
            nodes = float_array("reference", reference)
            if nodes.shape != shape:
                raise ValueError(
                    f"reference has shape {nodes.shape}, expected {shape}: one column per node; "
                    "shapes over time go in a Reference(time, nodes)"
                )
            reference = Reference([0.0], nodes[:, :, None])
        if reference.nodes.shape[:2] != shape:
            raise ValueError(
                f"reference.nodes has shape {reference.nodes.shape}, "
                f"expected {(*shape, len(reference.time))}: one column per node"
            )
        still = np.zeros(shape)
        shapes = [reference.nodes[:, :, k] for k in range(len(reference.time))]
        coordinates = [plant.measure(N, still)[: plant.degrees_of_freedom] for N in shapes]
        self._reference = ReducedReference(reference.time, np.array(coordinates))

    def reset(self) -> None:
        """Forget the last plan and the statistics."""
        count = len(self._low)
        self._plan = np.zeros((0, count))
        self._used = 0
        self._guess: tuple[FloatArray, FloatArray] | None = None
        self._previous = np.zeros(count)
        self._statuses: list[str] = []
        self._iterations: list[int] = []

    def _decide(self, time: float, state: FloatArray) -> tuple[FloatArray, str]:
        reference = self._reference.at(time + self._ahead)
        vectors = self._form.vectors(state, reference, self._previous)
        answer = self._program.solve(*vectors, start=self._guess)
        self._iterations.append(answer.iterations)
        if answer.x is None or answer.y is None:
            return self._fall_back(answer.status.value)
        # Solved to a tolerance: what is left outside the bounds is cut off.
        inputs = self._form.inputs(answer.x, state)
        self._plan = np.clip(inputs, self._problem.low, self._problem.high)
        self._used = 0
        self._guess = self._form.shifted(answer.x, answer.y)
        self._statuses.append(answer.status.value)
        return self._applied(self._plan[0]), answer.status.value

    def _fall_back(self, reason: str) -> tuple[FloatArray, str]:
        self._used += 1
        self._guess = None
        if self._used < len(self._plan):
            wish, what = self._plan[self._used], "last plan continued"
        else:
            wish, what = np.zeros_like(self._low), "equilibrium held"
        status = f"{reason}: {what}"
        self._statuses.append(status)
        return self._applied(wish), status

    def _applied(self, wish: FloatArray) -> FloatArray:
        """Return γ of an input, and remember the input for the limit of its change."""
        change = self._problem.change
        if change is not None:
            wish = np.clip(wish, self._previous - change, self._previous + change)
        self._previous = wish
        return wish + self.plant.force_density

    def __repr__(self) -> str:
        return (
            f"MPC({self.plant!r}, horizon {self._problem.length}, step {self.step:g} s, "
            f"{self._form_name})"
        )
