"""The state equation that integrators are given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.contact_laws import Contacts
from tenscontrol.dynamics.evaluator import Function, Prepared, evaluate_columns
from tenscontrol.dynamics.forces import Forces
from tenscontrol.dynamics.profile import polynomial_at
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.properties import cached_property
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import free_coordinates

#: How the functions of an equation can be built.
FORMS = ("flat", "mapped", "loops")


@dataclass(frozen=True)
class InputLayout:
    """What the input u of an equation holds: values that are held, or polynomials in time.

    The values are those of the strings, then the load on all nodes, parameters of the model,
    what supports and the bars on them are displaced by, node by node, and the lengths of all bars,
    where these are inputs. Of degree 0 they are u.
    Above, u holds their coefficients of power 0, of power 1, and so on, and in the end the time at
    which they are taken, s.

    Attributes
    ----------
    strings, load, offset, lengths : int
        Numbers of values.
    degree : int
        Of the polynomials.
    parameters : tuple of (str, int)
        Names and numbers of entries: fields of the string law, ``"bar_mass"``, ``"point_mass"``.
    """

    strings: int
    load: int = 0
    offset: int = 0
    degree: int = 0
    parameters: tuple[tuple[str, int], ...] = ()
    lengths: int = 0

    @cached_property
    def count(self) -> int:
        """Number of values."""
        own = sum(size for _, size in self.parameters)
        return self.strings + self.load + own + self.offset + self.lengths

    @property
    def size(self) -> int:
        """Number of entries of u."""
        return self.count * (self.degree + 1) + 1 if self.degree else self.count

    @property
    def load_rows(self) -> slice:
        """Which values are loads."""
        return slice(self.strings, self.strings + self.load)

    @property
    def offset_rows(self) -> slice:
        """Which values are displacements by supports."""
        end = self.count - self.lengths
        return slice(end - self.offset, end)

    @property
    def length_rows(self) -> slice:
        """Which values are lengths of bars."""
        return slice(self.count - self.lengths, self.count)

    def ahead(self, u: Any, time: Any) -> Any:
        """Return the expression of the input that begins a time later."""
        return ca.vertcat(u[:-1], u[-1] + time) if self.degree else u

    def values(self, u: Any, order: int = 0) -> Any:
        """Return the expression of the values, or of their derivative of an order, in time."""
        if not self.degree:
            return u if order == 0 else type(u).zeros(self.count)
        value: Any = type(u).zeros(self.count)
        for k in range(self.degree, order - 1, -1):
            factor = float(np.prod(np.arange(k - order + 1, k + 1)))
            value = value * u[-1] + factor * u[k * self.count : (k + 1) * self.count]
        return value

    def bar_lengths(self, u: Any) -> tuple[Any, Any, Any]:
        """Return the expressions of the lengths of bars, their rates and accelerations."""
        length, rate, acceleration = (self.values(u, order)[self.length_rows] for order in range(3))
        return length, rate, acceleration

    def columns(self, u: Any) -> dict[str, Any]:
        """Return the expressions of the parameters that are inputs, by name."""
        columns, start = {}, self.strings + self.load
        for name, size in self.parameters:
            columns[name] = self.values(u)[start : start + size]
            start += size
        return columns

    def later(self, u: FloatArray, time: float) -> FloatArray:
        """Return u, shape (..., inputs), that begins a time later, in numbers."""
        if not self.degree:
            return u
        later = u.copy()
        later[..., -1] += time
        return later

    def numbers(self, u: FloatArray, rows: slice, order: int = 0) -> FloatArray:
        """Return some values of u, one a column, or their derivative of an order, (rows, K)."""
        powers, count = self.degree + 1, u.shape[1]
        coefficients = u[: powers * self.count].reshape(powers, self.count, count)
        time = u[-1] if self.degree else np.zeros(count)
        return polynomial_at(coefficients[:, rows].swapaxes(0, 1), time, order)

    def packed(self, coefficients: FloatArray, time: float) -> FloatArray:
        """Return u of coefficients of ascending powers, shape (count, degree + 1), at a time."""
        u = coefficients.ravel(order="F")
        return np.append(u, time) if self.degree else u


@dataclass(frozen=True, eq=False)
class Equation:
    """The state equation ``ẋ = f(x, u)``, smooth between switches.

    Strings whose rest length is held pull or are slack, and nodes press on the ground or do not;
    ``taut`` says which, 1 or 0 for each string, then for each contact, and is an input of its own
    so that a step never crosses the switching surface between the two. Where force densities are
    held and nothing can touch, ``taut`` has no entries. Made by :meth:`Model.equation`.

    Attributes
    ----------
    slope : casadi.Function
        ``(x, u, taut) -> xdot``, dense columns.
    gap : casadi.Function
        ``(x, u) -> (gap, gap_rate)``: how far each string is from slack, m,
        positive where it pulls, and how fast the stretch grows, m/s; and the gap of each contact,
        m, positive where it presses, and how fast the node sinks, m/s.
    force : casadi.Function or None
        ``(q, v, u, taut) -> F``: forces along the free coordinates from positions and
        velocities, N, node by node. None for an equation that is no structure's.
    velocity_dependent : bool
        Whether the force depends on the velocities: a string or the ground is damped, or rubs.
    forces : Forces or None
        What acts on the nodes, beside the load. None for an equation that is no structure's.
    load : ndarray, shape (d, n), or None
        Constant force on every node, N; None for none, or where it is an input.
    form : {"flat", "mapped", "loops"}
        How the functions are built: one expression of all members (SX);
        operations on all members at once (MX); loops over the members in C.
    input_layout : InputLayout or None
        What u holds; None for the values of the strings.
    prepared : Prepared
        What integrators have built for this equation, for every later call; not for users.
    """

    slope: ca.Function
    gap: ca.Function
    force: ca.Function | None = None
    velocity_dependent: bool = False
    forces: Forces | None = None
    load: FloatArray | None = None
    form: str = "flat"
    input_layout: InputLayout | None = None
    prepared: Prepared = field(default_factory=Prepared, init=False, repr=False)

    def __repr__(self) -> str:
        return f"Equation({self.states} states, {self.form})"

    @property
    def structure(self) -> Structure | None:
        """The structure, or None."""
        return None if self.forces is None else self.forces.structure

    @property
    def law(self) -> StringLaw | None:
        """The law of the strings where rest lengths are held; None where γ is."""
        return None if self.forces is None else self.forces.law

    @property
    def contacts(self) -> Contacts | None:
        """The nodes that can touch the ground; None without ground."""
        return None if self.forces is None else self.forces.contacts

    @cached_property
    def layout(self) -> InputLayout:
        """What u holds."""
        return InputLayout(self.inputs) if self.input_layout is None else self.input_layout

    @property
    def symbol(self) -> Any:
        """``casadi.SX.sym`` or ``casadi.MX.sym``: for graphs that call the functions."""
        return ca.SX.sym if self.form == "flat" else ca.MX.sym

    def symbols(self, kind: Any = None) -> tuple[Any, Any, Any, Any]:
        """Return fresh symbols for x, u, taut and a step h, for functions of one step.

        Parameters
        ----------
        kind : type, optional
            ``casadi.SX`` or ``casadi.MX``; what :attr:`symbol` makes if not given.
        """
        make = self.symbol if kind is None else kind.sym
        sizes = {"x": self.states, "u": self.inputs, "taut": self.switches, "h": 1}
        x, u, taut, h = (make(name, size) for name, size in sizes.items())
        return x, u, taut, h

    @cached_property
    def states(self) -> int:
        """Number of entries of x."""
        return int(self.slope.size1_in(0))

    @cached_property
    def inputs(self) -> int:
        """Number of entries of u."""
        return int(self.slope.size1_in(1))

    @cached_property
    def switches(self) -> int:
        """Number of strings that can go slack, and of contacts: entries of ``taut``."""
        return int(self.slope.size1_in(2))

    def gap_scale(self, u: Any) -> Any:
        """Return the expression of the length that round-off in each gap is a part of, m.

        The rest length of a string; for a contact the size of the structure.

        Parameters
        ----------
        u : casadi.SX or MX, shape (inputs, 1)
        """
        of_strings = self.of_strings(u) if self.law is not None else type(u)(0, 1)
        if self.forces is None or not self.forces.terms:
            return of_strings
        size = self.forces.structure.size
        others = self.switches - self.forces.strings.switches
        return ca.vertcat(of_strings, ca.DM.ones(others) * size)

    def ahead(self, u: Any, time: Any) -> Any:
        """Return the expression of the input that begins a time later: of one held, itself.

        Parameters
        ----------
        u : casadi.SX or MX, shape (inputs, 1)
        time : casadi.SX or MX, or float
            s.
        """
        return self.layout.ahead(u, time)

    def of_strings(self, u: Any) -> Any:
        """Return the expression of the rest lengths, or force densities, at the time of u.

        Parameters
        ----------
        u : casadi.SX or MX, shape (inputs, 1)
        """
        values = self.layout.values(u)
        return values if self.layout.count == self.layout.strings else values[: self.layout.strings]

    @property
    def kinked_slope(self) -> ca.Function:
        """``(x, u) -> xdot``: the whole equation, not smooth where strings switch."""
        return self.prepared.get("kinked_slope", self._kinked_slope)

    def _kinked_slope(self) -> ca.Function:
        x, u = self.symbol("x", self.states), self.symbol("u", self.inputs)
        return Function("kinked", [x, u], [self.slope(x, u, self.gap(x, u)[0] > 0)])


def pack_state(structure: Structure, nodes: FloatArray, velocities: FloatArray) -> FloatArray:
    """Return ``x = [vec(N); vec(Ṅ)]`` of what is free, from two arrays of shape (d, n)."""
    return np.concatenate([free_coordinates(structure, array) for array in (nodes, velocities)])


def unpack_states(structure: Structure, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return all nodes and velocities, shape (d, n, T) each, from states, one a column.

    They share the memory of the states where nothing is fixed.
    """
    d, n = structure.nodes.shape
    half, count = len(structure.free_rows), states.shape[1]
    nodes, velocities = states[:half], states[half:]
    if half < n * d:
        nodes, velocities = np.zeros((2, n * d, count))
        nodes[:] = structure.nodes.ravel(order="F")[:, None]
        nodes[structure.free_rows], velocities[structure.free_rows] = states[:half], states[half:]
    shape = (n, d, count)
    return nodes.reshape(shape).swapaxes(0, 1), velocities.reshape(shape).swapaxes(0, 1)


def gravity_vector(gravity: object, dimension: int) -> FloatArray:
    """Return the acceleration of free fall, m/s², shape (d,), from what a user gives."""
    vector = validation.float_array("gravity", gravity)
    if vector.ndim == 0:
        if vector < 0:
            raise ValueError(
                f"gravity is {vector:g} m/s², expected at least 0: a number is the size of an "
                f"acceleration that points down. Give {-vector:g}, or a vector"
            )
        return np.append(np.zeros(dimension - 1), -float(vector))
    if vector.shape != (dimension,):
        raise ValueError(
            f"gravity has shape {vector.shape}, expected () or ({dimension},): m/s² downward, or a "
            "vector"
        )
    return vector


def gravity_forces(
    structure: Structure, gravity: FloatArray, bar_mass: FloatArray, point_mass: FloatArray
) -> FloatArray:
    """Return the weights at the nodes, N, shape (…, d, n): half a bar's at each of its ends.

    Of masses of shape (…, β) and (…, n), kg, and a fall of shape (…, d), m/s².
    """
    runs = np.broadcast_shapes(gravity.shape[:-1], bar_mass.shape[:-1], point_mass.shape[:-1])
    mass = np.broadcast_to(point_mass, (*runs, point_mass.shape[-1])).copy()
    halves = np.broadcast_to(bar_mass[..., None] / 2, (*runs, len(structure.bars), 2))
    places: Any = (..., structure.bars)
    np.add.at(mass, places, halves)
    return np.asarray(gravity[..., None] * mass[..., None, :])


def with_derivatives(equation: Equation, build: Callable[[str], Equation]) -> Equation:
    """Return an equation that can be differentiated: compiled loops are built in another form."""
    return build("mapped") if equation.form == "loops" else equation


def free_accelerations(equation: Equation, states: FloatArray, u: FloatArray) -> FloatArray:
    """Return accelerations of all entries of the nodes, m/s², 0 where supports hold them.

    States, inputs and what is returned have a column each.
    """
    structure = equation.structure
    assert structure is not None  # else nothing has a place
    gap = evaluate_columns(equation.gap, states, u)[0]
    slope = evaluate_columns(equation.slope, states, u, (gap > 0).astype(float))[0]
    accelerations = np.zeros((structure.nodes.size, states.shape[1]))
    accelerations[structure.free_rows] = slope[len(states) // 2 :]
    return accelerations


def in_time(
    functions: tuple[ca.Function, ...], layout: InputLayout, moves: bool, symbol: Any
) -> tuple[ca.Function, ...]:
    """Return slope, gap and force of u from those of the values in it.

    These end in Ė, the rates of what supports displace, and ``L L̈ + L̇²`` of bars in place of their
    lengths. ``moves`` is whether strings have a gap, whose rate is less by that of the rest
    lengths; gaps of contacts follow theirs.
    """
    slope, gap, force = functions
    if not layout.degree and not layout.offset and not layout.lengths:
        return functions
    x, taut = (symbol(name, slope.size1_in(i)) for name, i in (("x", 0), ("taut", 2)))
    q, v = (symbol(name, force.size1_in(i)) for name, i in (("q", 0), ("v", 1)))
    u = symbol("u", layout.size)
    values, rates = layout.values(u), layout.values(u, 1)
    others = layout.count - layout.lengths
    values = ca.vertsplit(values, [0, others, layout.count])[0]
    if layout.offset:
        values = ca.vertcat(values, rates[others - layout.offset : others])
    if layout.lengths:
        length, rate, acceleration = layout.bar_lengths(u)
        values = ca.vertcat(values, length * acceleration + rate**2)
    room, rate = gap(x, values)
    if moves:
        strings = layout.strings
        rate = ca.vertcat(rate[:strings] - rates[:strings], rate[strings:])
    return (
        Function("slope", [x, u, taut], [slope(x, values, taut)]),
        Function("gap", [x, u], [ca.densify(room), ca.densify(rate)]),
        Function("force", [q, v, u, taut], [force(q, v, values, taut)]),
    )
