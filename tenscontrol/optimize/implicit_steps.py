"""Implicit steps of a run, differentiated where Newton's iteration converged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Evaluator, Function
from tenscontrol.integrate.energy_momentum import (
    newton_solver,
    step_equations,
    step_expressions,
)
from tenscontrol.optimize.derivatives import (
    Derivatives,
    law_symbols,
    law_values,
    sources,
    symbolic_forces,
)
from tenscontrol.optimize.parameters import BESIDE, Parameter, shares
from tenscontrol.optimize.traced_steps import TracedSteps


class ImplicitSteps:
    """The steps of a run by the energy-momentum method, differentiated.

    With the unknowns y of a step, ``R(y, x, u, p) = 0`` and ``x⁺ = E(y, x)``::

        dx⁺ = E_x dx − E_y R_y⁻¹ (R_x dx + R_u du + R_p dp)

    Parameters
    ----------
    steps : TracedSteps
    derivatives : Derivatives
    parameters : sequence of Parameter
    columns : sequence of slice
        Which columns of a derivative are those of each parameter.
    """

    #: How many steps a call may take at most.
    most = 1

    def __init__(
        self, steps: TracedSteps, derivatives: Derivatives, parameters: Sequence[Parameter],
        columns: Sequence[slice],
    ) -> None:  # fmt: skip
        self._steps, self._parameters, self._columns = steps, parameters, columns
        own = [by for by in parameters if by.kind not in BESIDE]
        self._solver = _Solver(derivatives)
        model, names = derivatives.model, tuple(by.name for by in own)
        key = ("slopes of implicit steps", derivatives.input, steps.layout.degree, names)
        function, self._patterns = model.prepared.get(key, lambda: _step_slopes(derivatives, own))
        self._function = Evaluator(function)

    def reached(self, k: int, length: float) -> FloatArray:
        """Return the state after so much of a step."""
        return self._solver.end(self._steps, k, length)[1]

    def forward(
        self, k: int, _: int, part: float | None, X: FloatArray, answer: FloatArray | None
    ) -> FloatArray:
        """Return the derivative of the state, (states, P), after a step, or a part of it, s."""
        length = float(self._steps.length[k]) if part is None else part
        slopes = self._slopes(k, length)
        moved = slopes.by_state @ X
        if answer is not None:
            moved += slopes.by_input @ answer
        for columns, (by,) in self._sources(slopes, k, length):
            moved[:, columns] += by
        unknowns = slopes.factors.solve(moved)
        return np.asarray(slopes.end_by_state @ X - slopes.end_by_unknowns @ unknowns)

    def backward(
        self, k: int, _: int, part: float | None, end: FloatArray, slope: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return a cost by the state before a step, from that after it, and by the input meanwhile.

        Those by the parameters are added to the slope.
        """
        length = float(self._steps.length[k]) if part is None else part
        slopes = self._slopes(k, length)
        weight = -slopes.factors.solve(slopes.end_by_unknowns.T @ end, trans="T")
        for columns, (by,) in self._sources(slopes, k, length):
            slope[columns] += weight @ by
        by_input = slopes.by_input.T @ weight
        return slopes.end_by_state.T @ end + slopes.by_state.T @ weight, by_input

    def take_costs(self, slope: FloatArray) -> None:
        """Nothing is kept from step to step."""

    def _sources(
        self, slopes: _StepSlopes, k: int, length: float
    ) -> Iterator[tuple[slice, tuple[FloatArray, ...]]]:
        """Yield what the parameters themselves change of the residual of a step."""
        middle, counts = np.array([self._steps.begin[k] + length / 2]), list[FloatArray | None]()
        for by in self._parameters:
            count = shares(by, middle, middle) if by.kind == "input" else None
            counts.append(None if count is None else count[:, 0])
        by_own = slopes.by_input, slopes.by_parameters
        return sources(self._parameters, self._columns, counts, *by_own)

    def _slopes(self, k: int, length: float) -> _StepSlopes:
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import splu

        y, _ = self._solver.end(self._steps, k, length)
        outputs = self._function(y, self._steps.states[:, k], self._steps.inputs[:, k], length)
        by_unknowns, *others = (
            csc_array((values.copy(), (pattern.row, pattern.column)), pattern.shape)
            for values, pattern in zip(outputs, self._patterns, strict=True)
        )
        by_state, by_input, by_parameters, end_by_unknowns, end_by_state = others
        return _StepSlopes(
            splu(by_unknowns), by_state, by_input.toarray(), by_parameters.toarray(),
            end_by_unknowns, end_by_state,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _StepSlopes:
    """Derivatives of the residual of a step and of its end, sparse."""

    factors: Any  # of R_y
    by_state: Any
    by_input: FloatArray
    by_parameters: FloatArray
    end_by_unknowns: Any
    end_by_state: Any


@dataclass(frozen=True, eq=False)
class _Pattern:
    row: IntArray
    column: IntArray
    shape: tuple[int, int]

    @classmethod
    def of(cls, matrix: Any) -> _Pattern:
        """Return where the entries of an expression are."""
        row, column = map(np.array, matrix.sparsity().get_triplet())
        return cls(row, column, matrix.shape)


class _Solver:
    """The unknowns of steps, and the states that they end at."""

    def __init__(self, derivatives: Derivatives) -> None:
        equation = derivatives.equation
        size = float(np.ptp(derivatives.structure.nodes, axis=1).max())

        def build() -> tuple[ca.Function, ...]:
            step = step_equations(equation)
            return newton_solver(step, size), step.guess, step.end

        functions = equation.prepared.get("implicit step", build)
        self._newton, self._guess, self._end = (Evaluator(function) for function in functions)

    def end(self, steps: TracedSteps, k: int, length: float) -> tuple[FloatArray, FloatArray]:
        """Return the unknowns of so much of a step, and the state after it."""
        x = steps.states[:, k]
        guess = self._guess(x)[0]
        y, converged, _ = self._newton(guess, x, steps.inputs[:, k], length)
        if not converged[0]:
            raise ValueError(
                f"a step at {steps.begin[k]:.6g} s was not found again as the run took it: take a "
                "shorter step, or the method 'dop853'"
            )
        return y.copy(), self._end(y, x, length)[0].copy()


def halved(steps: TracedSteps, derivatives: Derivatives) -> TracedSteps:
    """Return the steps that a run by tolerance accepts: two halves each."""
    solver, count = _Solver(derivatives), len(steps.length)
    half = np.repeat(steps.length / 2, 2)
    begin = np.repeat(steps.begin, 2)
    begin[1::2] += half[1::2]
    states = np.empty((len(steps.states), 2 * count + 1))
    states[:, ::2] = steps.states
    for k in range(count):
        states[:, 2 * k + 1] = solver.end(steps, k, float(half[2 * k]))[1]
    inputs = np.repeat(steps.inputs, 2, axis=1)
    if steps.layout.degree:
        inputs[-1, 1::2] += half[1::2]
    return replace(
        steps, begin=begin, length=half, span=np.repeat(steps.span, 2), states=states,
        inputs=inputs, taut=np.repeat(steps.taut, 2, axis=1),
    )  # fmt: skip


def _step_slopes(
    derivatives: Derivatives, parameters: Sequence[Parameter]
) -> tuple[ca.Function, list[_Pattern]]:
    """Return ``(y, x, u, h) -> entries of derivatives``, and where these are in the matrices.

    Of the residual by y, x, inputs of strings and parameters, then of the end by y and x.
    """
    model, equation = derivatives.model, derivatives.equation
    structure, (d, n) = model.structure, model.structure.nodes.shape
    laws = [by for by in parameters if by.kind in ("strings", "ground")]
    values = {
        "bar_mass": structure.bar_mass, "point_mass": structure.point_mass,
        "gravity": model.gravity, "external_force": np.zeros(d * n),  # beside that of the scene
    }  # fmt: skip
    symbols = {name: ca.SX.sym(name, len(value)) for name, value in values.items()}
    of_laws = law_symbols(laws)
    masses = kernel.Masses(symbols["bar_mass"], symbols["point_mass"])
    usual = kernel.Masses(*(ca.SX(ca.DM(values[name])) for name in kernel.Masses._fields))
    load = kernel.weights(structure, symbols["gravity"], masses)
    load = load - kernel.weights(structure, model.gravity, usual)
    load = load + ca.reshape(symbols["external_force"], n, d).T
    forces = symbolic_forces(model, derivatives.input, laws, of_laws)
    step = step_expressions(equation, forces, masses, load)
    y, x, u, h = step.symbols
    by_name = symbols | {by.name: symbol for by, symbol in zip(laws, of_laws, strict=True)}
    own = ca.vertcat(ca.SX(0, 1), *(by_name[by.name] for by in parameters))
    strings = equation.layout.strings
    slopes = [
        ca.jacobian(step.residual, y), ca.jacobian(step.residual, x),
        ca.jacobian(step.residual, u)[:, :strings], ca.jacobian(step.residual, own),
        ca.jacobian(step.end, y), ca.jacobian(step.end, x),
    ]  # fmt: skip
    of_all = ca.vertcat(*symbols.values(), *of_laws)
    own_values = law_values(model, derivatives.input, laws)
    numbers = ca.vertcat(*map(ca.DM, values.values()), own_values)
    entries = ca.substitute([slope.nz[:] for slope in slopes], [of_all], [numbers])
    patterns = [_Pattern.of(slope) for slope in slopes]
    return Function(
        "step_slopes", [y, x, u, h], [ca.densify(column) for column in entries]
    ), patterns
