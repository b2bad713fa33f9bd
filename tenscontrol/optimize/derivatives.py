"""Derivatives of the equation of motion by state, input and parameters, at many states."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from math import factorial, perm
from types import MappingProxyType
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.contact_laws import Contacts
from tenscontrol.dynamics.equation import Equation, InputLayout, with_derivatives
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.dynamics.force import Force
from tenscontrol.dynamics.forces import Forces
from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.core_scene import core_scene
from tenscontrol.integrate.projection import projection
from tenscontrol.optimize.parameters import BESIDE, Parameter, load_of_gravity, unit_load
from tenscontrol.optimize.projection_slope import ProjectionSlope
from tenscontrol.properties import cached_property

# Of a bar's mass, what each end has of the acceleration of itself and of the other.
_OWN, _OTHER = 1 / 3, 1 / 6


_Built = TypeVar("_Built")


class _Symbol(ca.SX):  # type: ignore[misc]  # CasADi has no types
    """A parameter that is there: laws leave out what has none."""

    def __bool__(self) -> bool:
        return True


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of the accelerations at K states.

    Attributes
    ----------
    by_state : ndarray, shape (K, half, states)
    by_input : ndarray, shape (K, half, α), or None
    by_parameters : ndarray, shape (K, half, P)
        By all parameters but start, input and motion of supports.
    by_supports : ndarray, shape (K, half, 3 d n), or None
        By what moves with supports, by its rates, and by a load on all nodes.
    by_bars : ndarray, shape (K, half, 3 β), or None
        By lengths of bars, their rates and accelerations.
    """

    by_state: FloatArray
    by_input: FloatArray | None
    by_parameters: FloatArray
    by_supports: FloatArray | None = None
    by_bars: FloatArray | None = None

    def of(self, some: slice | int) -> Slopes:
        """Return those at some of the states, or at one."""
        chosen: dict[str, Any] = {
            name: None if by is None else by[some] for name, by in vars(self).items()
        }
        return Slopes(**chosen)


class Derivatives:
    """Derivatives of the equation of a model; forces are differentiated, masses are in closed form.

    What a parameter changes of the forces on nodes, less what a mass changes of ``M a``, moves the
    nodes as a load does. So this serves every structure, whatever bars share nodes.

    Parameters
    ----------
    model : Model
    input : {"rest_length", "force_density"}
    degree : int
        Of the polynomials in time that the input is made of.
    parameters : sequence of Parameter
    by_input : bool
        Whether derivatives by the input are needed where it is no parameter.
    moves, drives : bool
        Whether supports move, and whether bars are driven.
    """

    def __init__(
        self, model: Model, input: str, degree: int, parameters: Sequence[Parameter],
        by_input: bool = False, moves: bool = False, drives: bool = False,
    ) -> None:  # fmt: skip
        self.model, self.input, self.structure = model, input, model.structure
        options: dict[str, Any] = {
            "degree": degree, "load_input": True, "offset_input": moves, "length_input": drives
        }  # fmt: skip

        def build() -> Equation:
            in_form = partial(model.equation, input, None, **options)
            return with_derivatives(in_form(), in_form)

        key = "equation with slopes", input, *options.values()
        #: Of which loads are inputs, too.
        self.equation = model.prepared.get(key, build) if model.is_small else build()
        self._by_input = by_input or any(by.kind == "input" for by in parameters)
        self._by_supports = any(by.kind == "supports" for by in parameters)
        self._by_bars = drives  # also for what a push makes of the rates at the start
        self._of = [parameter for parameter in parameters if parameter.kind not in BESIDE]
        self._laws = [
            parameter for parameter in self._of if parameter.kind in ("strings", "ground")
        ]

    @cached_property
    def _jacobian(self) -> ca.Function:
        by_supports = self._by_supports
        by_input, by_load = self._by_input, bool(self._of) or by_supports
        wanted = by_input, by_load, by_supports, self._by_bars

        def build(equation: Equation) -> ca.Function:
            return _jacobian(equation, *wanted)

        return self._of_equation(("slopes", *wanted), build)

    @cached_property
    def _by_law(self) -> ca.Function:
        names = tuple(parameter.name for parameter in self._laws)
        return self._prepared(("slopes by", names), self._force_slopes)

    @cached_property
    def _gap(self) -> ca.Function:
        return self._of_equation(("slopes of gaps",), _gap_slopes)

    @cached_property
    def _projection(self) -> ProjectionSlope | None:
        if projection(self.equation) is None:
            return None
        return self._prepared(("slope of projection",), partial(ProjectionSlope, self.equation))

    def _of_equation(
        self, key: tuple[Any, ...], build: Callable[[Equation], ca.Function]
    ) -> ca.Function:
        """Return a function of the equation that the model keeps, or shares with another."""
        name = (*key, self.input, self.equation.layout)
        return self._prepared(key, lambda: self.model.shared_function(name, self.equation, build))

    def _prepared(self, key: tuple[Any, ...], build: Callable[[], _Built]) -> _Built:
        """Return a function that the model keeps."""
        key = (*key, self.input, self.equation.layout)
        return self.model.prepared.get(key, build)

    @property
    def half(self) -> int:
        """Number of free coordinates."""
        return self.equation.states // 2

    def slope(self, x: FloatArray, u: FloatArray, taut: FloatArray) -> FloatArray:
        """Return ẋ, shape (states, K), of states, inputs and switches, one a column."""
        layout, core = self.equation.layout, core_scene(self.equation)
        if core is None or layout.offset or layout.lengths or not x.shape[1]:
            return evaluate_columns(self.equation.slope, x, u, taut)[0]
        return core.slopes(x, u, taut)

    def at(
        self, x: FloatArray, u: FloatArray, taut: FloatArray, slope: FloatArray,
        carried: FloatArray | None = None,
    ) -> Slopes:  # fmt: skip
        """Return the derivatives at states, inputs, switches and their ẋ, one a column.

        ``carried`` are the accelerations of nodes with supports, (d n, K), m/s².
        """
        outputs = iter(evaluate_columns(self._jacobian, x, u, taut))
        half, count = self.half, x.shape[1]
        by_state = _stacked(next(outputs), half)
        by_input = _stacked(next(outputs), half) if self._by_input else None
        by_parameters, by_supports, by_bars = np.zeros((count, half, 0)), None, None
        if self._of or self._by_supports:
            by_load = _stacked(next(outputs), half)
        if self._of:
            by_parameters = by_load @ self._forces(x, u, taut, slope, carried)
        if self._by_supports:
            by_motion = _stacked(next(outputs), half)
            by_supports = np.concatenate([by_motion, by_load], axis=2)
        if self._by_bars:
            by_bars = _stacked(next(outputs), half)
        return Slopes(by_state, by_input, by_parameters, by_supports, by_bars)

    def _forces(
        self, x: FloatArray, u: FloatArray, taut: FloatArray, slope: FloatArray,
        carried: FloatArray | None,
    ) -> FloatArray:  # fmt: skip
        """Return what parameters change of the forces on all nodes, shape (K, d n, P)."""
        structure, count = self.structure, x.shape[1]
        d, n = structure.nodes.shape
        of_laws = iter(list[FloatArray]())
        if self._laws:
            values = _stacked(evaluate_columns(self._by_law, x, u, taut)[0], d * n)
            ends = np.cumsum([parameter.size for parameter in self._laws])[:-1]
            of_laws = iter(np.split(values, ends, axis=2))
        moved = np.zeros((d * n, count))
        moved[structure.free_rows] = slope[self.half :]
        if carried is not None:
            moved += carried
        excess = self.model.gravity[:, None, None] - moved.reshape(n, d, count).swapaxes(0, 1)
        parts: list[FloatArray] = []
        for parameter in self._of:
            if parameter in self._laws:
                parts.append(next(of_laws))
                continue
            fixed = {"gravity": load_of_gravity, "external_force": unit_load}.get(parameter.kind)
            if fixed is not None:
                constant = fixed(self.model)
                parts.append(np.broadcast_to(constant, (count, *constant.shape)))
                continue
            of_mass = np.zeros((count, n, d, parameter.size))
            if parameter.kind == "point_mass":
                nodes = np.arange(n)
                of_mass[:, nodes, :, nodes] = excess.transpose(1, 2, 0)
            else:
                self._add_bars(of_mass, excess)
            parts.append(of_mass.reshape(count, d * n, parameter.size))
        return np.concatenate(parts, axis=2)

    def _add_bars(self, of_mass: FloatArray, excess: FloatArray) -> None:
        """Add what the masses of bars change, of gravity less acceleration, (d, n, K)."""
        bars = self.structure.bars
        every = np.arange(len(bars))
        for own, other in (bars.T, bars.T[::-1]):
            mean = _OWN * excess[:, own] + _OTHER * excess[:, other]
            of_mass[:, own, :, every] = mean.transpose(1, 2, 0)

    def _force_slopes(self) -> ca.Function:
        """Return ``(x, u, taut) -> dF``: forces on all nodes by the parameters of laws."""
        model, equation = self.model, self.equation
        x, u, taut = (ca.SX.sym(name, equation.slope.size1_in(i)) for i, name in enumerate("xut"))
        symbols = law_symbols(self._laws)
        forces = symbolic_forces(model, self.input, self._laws, symbols)
        half = self.half
        N = kernel.placed(model.structure, x[:half], model.structure.nodes)
        V = kernel.placed(model.structure, x[half:], np.zeros(model.structure.nodes.shape))
        layout = equation.layout
        if layout.offset:
            N, V = (
                nodes + ca.reshape(layout.values(u, order)[layout.offset_rows], *N.shape)
                for order, nodes in enumerate((N, V))
            )
        on_nodes = forces.on_nodes(N, V, equation.of_strings(u), None, taut)
        slopes = ca.jacobian(ca.vec(on_nodes), ca.vertcat(*symbols))
        values = law_values(model, self.input, self._laws)
        slopes = ca.substitute(slopes, ca.vertcat(*symbols), values)
        return Function("by_laws", [x, u, taut], [ca.densify(ca.vec(slopes))])

    @property
    def no_switches(self) -> Switches:
        """What switches where nothing does."""
        layout, states = self.equation.layout, self.equation.states

        def build() -> Switches:
            none, nothing = np.zeros(0, dtype=int), np.zeros(0)
            no_states, no_inputs, no_offsets = (
                np.zeros((0, size)) for size in (states, layout.strings, layout.offset)
            )
            return Switches(none, none, no_states, no_inputs, no_offsets, nothing, no_states)

        key = "no switches", layout.strings, layout.offset
        return self.model.prepared.get(key, build)

    def at_switches(
        self, x: FloatArray, u: FloatArray, before: FloatArray, step: IntArray, which: IntArray
    ) -> Switches:
        """Return what switches at the ends of steps, one a column, where ``before`` has pulled."""
        after, count = before.copy(), len(step)
        own = which, np.arange(count)
        after[own] = 1 - before[own]
        slopes = self.slope(np.tile(x, 2), np.tile(u, 2), np.hstack([before, after]))
        slope, jump = slopes[:, :count], slopes[:, count:] - slopes[:, :count]
        chosen = np.zeros_like(before)
        chosen[own] = 1.0
        by_state, by_input, by_offset, by_time = (
            np.ascontiguousarray(out.T) for out in evaluate_columns(self._gap, x, u, chosen)
        )
        rate = (by_state * slope.T).sum(axis=1) + by_time[:, 0]
        jump = np.ascontiguousarray(jump.T)
        return Switches(step, which, by_state, by_input, by_offset, rate, jump)

    def projected(
        self, x: FloatArray, u: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray | None] | None:
        """Return the derivative of putting bars on their lengths, shape (K, states, states).

        And that by lengths and rates of bars, (K, states, 2 β), where these are driven. Of states
        one a column, and of inputs, where bars are driven.
        """
        return None if self._projection is None else self._projection(x, u)

    def stretching(self, x: FloatArray, bars: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return rates of bars, m/s, shape (β,), and their derivative; 0 of others than some."""

        def build() -> ca.Function:
            state, structure = ca.SX.sym("x", len(x)), self.structure
            N = kernel.placed(structure, state[: self.half], structure.nodes)
            V = kernel.placed(structure, state[self.half :], np.zeros(structure.nodes.shape))
            start, end = structure.bars.T.tolist()
            B, rate = (nodes[:, end] - nodes[:, start] for nodes in (N, V))
            along = (ca.sum1(B * rate) / ca.sqrt(ca.sum1(B * B))).T
            outputs = [ca.densify(along), ca.densify(ca.jacobian(along, state))]
            return Function("stretching", [state], outputs)

        values, slopes = (out.full() for out in self._prepared(("stretching",), build)(x))
        others = np.setdiff1d(np.arange(len(values)), bars)
        values[others], slopes[others] = 0.0, 0.0
        return values[:, 0], slopes


@dataclass(frozen=True, eq=False)
class Switches:
    """What switched at the ends of steps, one an entry.

    Attributes
    ----------
    step, which : ndarray of int, shape (E,)
        The step that ended so, and the switch.
    by_state : ndarray, shape (E, states)
        Derivative of the gap.
    by_input : ndarray, shape (E, α)
    by_offset : ndarray, shape (E, d n), or (E, 0) where supports stand
        By what moves with supports.
    rate : ndarray, shape (E,)
        Of the gap along the motion just before, m/s.
    jump : ndarray, shape (E, states)
        Of ẋ.
    """

    step: Any
    which: Any
    by_state: FloatArray
    by_input: FloatArray
    by_offset: FloatArray
    rate: FloatArray
    jump: FloatArray


def sources(
    parameters: Sequence[Parameter],
    columns: Sequence[slice],
    counts: Sequence[FloatArray | None],
    by_input: FloatArray | None,
    by_parameters: FloatArray,
    by_motion: Mapping[str, FloatArray | None] = MappingProxyType({}),
) -> Iterator[tuple[slice, tuple[FloatArray, ...]]]:
    """Yield columns of parameters with what they change, as matrices to be multiplied.

    ``counts`` says by what each counts: the values of an input, (K,); a motion of supports or bars
    in what moves with them, (3 d n, P) or (3 β, P). The others are those of ``by_parameters``.
    """
    first = 0
    for parameter, own, count in zip(parameters, columns, counts, strict=True):
        if parameter.kind in ("supports", "bars"):
            by = by_motion[parameter.kind]
            assert by is not None  # it was asked for
            assert count is not None  # what moves with them
            yield own, (by, count)
        elif parameter.kind == "input":
            assert by_input is not None  # it was asked for
            if count is None:
                yield own, (by_input,)
                continue
            for k in np.flatnonzero(count).tolist():
                yield slice(own.start + k, own.stop, len(count)), (count[k] * by_input,)
        elif parameter.kind not in BESIDE:
            yield own, (by_parameters[:, first : first + parameter.size],)
            first += parameter.size


def _stacked(columns: FloatArray, rows: int) -> FloatArray:
    """Return matrices of so many rows, (K, rows, ·), from their entries, one matrix a column."""
    entries, count = columns.shape
    width = entries // rows if rows else 0
    return np.ascontiguousarray(columns.T.reshape(count, width, rows).swapaxes(1, 2))


def _jacobian(
    equation: Equation, by_input: bool, by_load: bool, by_supports: bool, by_bars: bool
) -> ca.Function:
    """Return ``(x, u, taut) -> columns of the derivatives of the accelerations``."""
    x, u, taut, _ = equation.symbols()
    rates = equation.slope(x, u, taut)[equation.states // 2 :]
    layout = equation.layout
    outputs = [ca.jacobian(rates, x)]
    by_held: Any = ca.jacobian(rates, u) if by_input or by_load or by_bars else None
    if by_input:
        outputs.append(by_held[:, : layout.strings])
    if by_load:
        outputs.append(by_held[:, layout.load_rows])
    if by_supports:
        outputs.append(ca.horzcat(*_by_orders(layout, by_held, u, layout.offset_rows, 2)))
    if by_bars:
        outputs.append(ca.horzcat(*_by_orders(layout, by_held, u, layout.length_rows, 3)))
    return Function("slopes", [x, u, taut], [ca.densify(ca.vec(output)) for output in outputs])


def _by_orders(layout: InputLayout, by_held: Any, u: Any, rows: slice, orders: int) -> list[Any]:
    """Return derivatives by some values, their rates and accelerations, of those by u.

    The coefficient c₁ counts by the time and as the rate, c₂ by the square of the time, by twice
    the time as the rate, and twice as the acceleration.
    """
    slopes: list[Any] = []
    for k in range(orders):
        if k > layout.degree:
            slopes.append(type(u)(*slopes[0].shape))
            continue
        own = by_held[:, k * layout.count + rows.start : k * layout.count + rows.stop]
        for j, earlier in enumerate(slopes):
            own = own - perm(k, j) * u[-1] ** (k - j) * earlier
        slopes.append(own / factorial(k))
    return slopes


def _gap_slopes(equation: Equation) -> ca.Function:
    """Return ``(x, u, chosen) -> a gap by state, input, offset and time``: where chosen is 1."""
    x, u, chosen, _ = equation.symbols()
    layout, gap = equation.layout, ca.dot(chosen, equation.gap(x, u)[0])
    by_held = ca.gradient(gap, u)
    by_time = by_held[-1] if layout.degree else type(x)(1, 1)
    outputs = [
        ca.gradient(gap, x), by_held[: layout.strings, 0], by_held[layout.offset_rows, 0], by_time
    ]  # fmt: skip
    return Function("gap_slopes", [x, u, chosen], [ca.densify(output) for output in outputs])


def law_symbols(parameters: Sequence[Parameter]) -> list[Any]:
    """Return a symbol for each parameter of a law."""
    return [_Symbol(ca.SX.sym(parameter.field, parameter.size)) for parameter in parameters]


def law_values(model: Model, input: str, parameters: Sequence[Parameter]) -> ca.DM:
    """Return the values of parameters of laws, one after the other."""
    laws = (
        model.ground[parameter.law] if parameter.kind == "ground" else model.forces(input).law
        for parameter in parameters
    )  # fmt: skip
    values = (getattr(law, by.field) for law, by in zip(laws, parameters, strict=True))
    return ca.vertcat(ca.DM(0, 1), *(ca.vec(ca.DM(value)) for value in values))


def symbolic_forces(
    model: Model, input: str, parameters: Sequence[Parameter], symbols: Sequence[Any]
) -> Forces:
    """Return the forces of a model with symbols for parameters of its laws."""
    law, terms = model.forces(input).law, model.forces(input).terms
    pairs = list(zip(parameters, symbols, strict=True))
    if law is not None:
        law = law.with_parameters(
            {by.field: symbol for by, symbol in pairs if by.kind == "strings"}
        )
    of_ground = [(by.law, by.field, symbol) for by, symbol in pairs if by.kind == "ground"]
    return Forces(model.structure, law, tuple(_with_symbols(term, of_ground) for term in terms))


def _with_symbols(term: Force, symbols: list[tuple[int, str, Any]]) -> Force:
    """Return a force with symbols for numbers of its contact laws."""
    if not isinstance(term, Contacts) or not symbols:
        return term
    laws = [copy(law) for law in term.laws]
    for i, name, symbol in symbols:
        object.__setattr__(laws[i], name, symbol)
    return Contacts(tuple(laws), term.nodes, term.switch)
