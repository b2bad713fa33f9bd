"""The linear plant for the design of controllers, with its exact discretizations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from itertools import pairwise
from typing import TYPE_CHECKING, Concatenate, ParamSpec, TypeVar, overload

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import BAR_INPUTS, Actuation, inputs_of, member_rows
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays, frozen
from tenscontrol.dynamics.coordinates import Coordinates
from tenscontrol.dynamics.evaluator import Prepared, on_one_thread
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.tangent import refuse_large
from tenscontrol.properties import cached_property
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.segments import to_segments
from tenscontrol.structure.structure import Structure

if TYPE_CHECKING:
    import control
    from scipy.sparse import csr_array

_Arguments = ParamSpec("_Arguments")
_Value = TypeVar("_Value")

# Radians of the slowest vibration in a sample from which on nothing is controlled between samples;
# poles below the second part of the largest are no vibrations.
_MOST_TURNED, _AT_REST = 20 * np.pi, 1e-6

# More radians of the fastest pole in a sample leave less than eight digits of its phase.
_MOST_RADIANS = 1e8

# Stiffness eigenvalues below this fraction of the largest are zero: round-off is at 1e-15,
# and a soft mechanism beside strings of 1e9 N/m is still at 1e-8.
_ZERO = 1e-11

# Eigenvalues this close to each other, relative to themselves, are one frequency.
_EQUAL = 1e-7

# Round-off of ω², relative to the largest: soft modes beside stiff ones.
_NOISE = 1e-13

# A stiffness matrix this far from symmetric, relative to its size, is not that of a rest.
_SYMMETRIC = 1e-9

# Rows that are decomposed at once.
_ROWS = 1000

#: What the inputs of strings may be, and those of all plants.
INPUTS = ("force_density", "rest_length")
PLANT_INPUTS = (*INPUTS, *BAR_INPUTS)


#: Why inputs that jump do not fit bars.
NO_JUMP = (
    "lengths of bars cannot jump: give sample_time and winches=Winches(ramp=True), whose rate, "
    "shortest and longest limit the drives of the bars"
)


def member_lengths(
    plant: LinearPlant, rest_length: FloatArray, bar_length: FloatArray
) -> FloatArray:
    """Return the values that inputs set where strings and bars have these lengths.

    Both are on the last axis, m: of the commanded strings, and of bars.
    """
    strings, bars = member_rows(plant.input, plant.commanded)
    of_bars = bar_length[..., : bars.stop - bars.start]
    return frozen(np.concatenate([rest_length[..., strings], of_bars], axis=-1))


def lead_names(commanded: Structure, rows: tuple[slice, slice], lead: IntArray) -> tuple[str, ...]:
    """Return names of inputs by their leads: group and number of a string, number of a bar.

    Among values with these :func:`member_rows`.
    """
    seen: dict[str, int] = {}
    names = []
    for group in commanded.string_groups[rows[0]]:
        seen[group] = seen.get(group, -1) + 1
        names.append(f"{group}[{seen[group]}]")
    names += [f"bar[{bar}]" for bar in range(len(commanded.bars[: rows[1].stop - rows[1].start]))]
    return tuple(names[member] for member in lead)


def refuse_driven_bars(plant: LinearPlant, who: str) -> None:
    """Raise if lengths of bars are the input of a plant, for whom or what cannot take it."""
    if plant.drives_bars:
        raise ValueError(
            f"{who} takes no plant with input={plant.input!r}: LQR, MPC, KalmanFilter and simulate "
            "do. Linearize by input='rest_length' or 'force_density'"
        )


class _Made:
    """An array of a record that is made when it is first asked for, or given."""

    def __init__(self, make: Callable[[LinearPlant], FloatArray]) -> None:
        self._make = make

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __set__(self, plant: LinearPlant, value: FloatArray | None) -> None:
        plant.__dict__[self._name] = value

    @overload
    def __get__(self, plant: None, owner: type) -> None: ...
    @overload
    def __get__(self, plant: LinearPlant, owner: type) -> FloatArray: ...
    def __get__(self, plant: LinearPlant | None, owner: type) -> FloatArray | None:
        if plant is None:
            return None  # the default
        array: FloatArray | None = plant.__dict__[self._name]
        if array is None:
            array = plant.__dict__[self._name] = frozen(self._make(plant))
        return array


@dataclass(frozen=True, eq=False)
class SparsePlant:
    """A linearized structure ``ÿ + D ẏ + K y = E v + f`` in coordinates y in which it is sparse.

    ``y`` are the minimal coordinates, or the nodes of a plant in ``"nodes"`` coordinates: nodes
    move by ``vec(δN) = plant.coordinates.sparse_basis @ y``. The mass is the identity.

    Attributes
    ----------
    stiffness, damping : csr_array, shape (m, m)
        K, 1/s², and D, 1/s.
    by_input : csr_array, shape (m, inputs)
        E.
    drift : ndarray, shape (m,)
        f: zero at an equilibrium up to round-off.
    """

    stiffness: csr_array
    damping: csr_array
    by_input: csr_array
    drift: FloatArray

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for matrix in (self.stiffness, self.damping, self.by_input):
            matrix.data.flags.writeable = False


def norm(matrix: csr_array) -> float:
    """Return Frobenius' norm of a sparse matrix."""
    return float(np.linalg.norm(matrix.data))


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """A linearized structure ``ż = A z + B v + drift``.

    The state is ``z = [q; q̇]`` in the chosen coordinates, the input v the departure of γ or of the
    rest lengths of m driven strings, or winches, from the operating point. There are m = α inputs
    where every string is driven by itself. Lengths of driven bars may be inputs, alone or after
    those of the strings. Made by :func:`linearize`.

    Where lengths of bars are the input, nodes move by ``vec(δN) = T q + E v``, with E across all
    motions T in the metric of the mass: bars push along themselves, so that neither an acceleration
    of v nor the impulse of a jump of its rate moves z. Damped strings feel its rate:
    ``ż = A z + B v + F v̇``.

    Attributes
    ----------
    model : Model
    coordinates : Coordinates
        The basis and the maps between node positions and q.
    input : str
        ``"force_density"``, ``"rest_length"``, ``"bar_length"`` or ``"length"``, rest lengths of
        strings and then lengths of bars.
    A, B : ndarray, shape (2r, 2r) and (2r, m)
        Matrices for q in m √kg, made when they are first asked for, and refused where A has more
        than 64 million entries, 4,000 coordinates: large structures have :attr:`sparse`.
    drift : ndarray, shape (2r,)
        Change of the state, m √kg/s and m √kg/s²: zero at an equilibrium up to round-off.
    sparse : SparsePlant or None
        The same in second-order form, in coordinates in which it is sparse. None for a plant that
        was given another A or B.
    commanded : Structure
        The structure whose strings are the inputs: that of the model, or its
        parent after :func:`command_parents`.
    force_density : ndarray, shape (α,)
        γ of the commanded strings at the operating point, N/m.
    rest_length : ndarray, shape (α,), or None
        Their rest lengths at the operating point, m; None without a string law.
    external_force : ndarray, shape (d, n)
        W, N.
    invariance_residual : float
        How far the accelerations lead out of the space of the coordinates, or
        answer to motions that it leaves out, relative to their size.
    actuation : Actuation
        Which of the commanded strings the inputs drive; the others are passive. Of bars, where
        their lengths are the input, and of strings and then bars, where both are.
    input_displacements : ndarray, shape (d n, m), or None
        E, where lengths of bars are inputs; zero for inputs of strings.
    rate_input : ndarray, shape (2r, m), or None
        F, where lengths of bars are inputs and strings are damped; zero for inputs of strings.
    feet : ndarray of int
        Fixed nodes of the model that stand on ground by friction, of a plant about a stance: z is
        measured relative to them. Empty for any other plant.
    """

    model: Model
    coordinates: Coordinates
    input: str
    sparse: SparsePlant | None
    commanded: Structure
    force_density: FloatArray
    rest_length: FloatArray | None
    external_force: FloatArray
    invariance_residual: float
    actuation: Actuation
    feet: IntArray = field(default_factory=lambda: frozen(np.zeros(0, np.int64)))
    input_displacements: FloatArray | None = None
    rate_input: FloatArray | None = None
    A: _Made = _Made(lambda plant: _dense_A(plant))
    B: _Made = _Made(lambda plant: _dense_B(plant))
    drift: _Made = _Made(lambda plant: _dense_drift(plant))

    def __post_init__(self) -> None:
        if self.__dict__["A"] is not None or self.__dict__["B"] is not None:
            object.__setattr__(self, "sparse", None)

    @property
    def nodes(self) -> FloatArray:
        """Node positions at the operating point, m, shape (d, n)."""
        return self.coordinates.nodes

    @property
    def basis(self) -> FloatArray:
        """T, shape (d n, r): node displacements are ``vec(δN) = T q``."""
        return self.coordinates.basis

    @property
    def degrees_of_freedom(self) -> int:
        """Number r of coordinates; the state has twice as many entries."""
        return self.coordinates.count

    @property
    def equilibrium_input(self) -> FloatArray:
        """The input at the operating point, γ or length, shape (m,)."""
        return inputs_of(self.actuation, self.string_values)

    @property
    def string_values(self) -> FloatArray:
        """γ or rest length of the commanded strings at the operating point, shape (α,).

        Lengths of bars, shape (β,), where these are the input, and after those of the strings,
        shape (α + β,), where both are.
        """
        if self.input == "force_density":
            return self.force_density
        assert self.rest_length is not None  # linearize needs a string law for this input
        return member_lengths(self, self.rest_length, self.model.structure.bar_length)

    @property
    def drives_bars(self) -> bool:
        """Whether lengths of bars are among the inputs."""
        return self.input in BAR_INPUTS

    @property
    def winds_strings(self) -> bool:
        """Whether rest lengths of strings are among the inputs."""
        return self.input in ("rest_length", "length")

    @property
    def string_input(self) -> str:
        """What strings are held at, ``"force_density"`` or ``"rest_length"``."""
        return "rest_length" if self.drives_bars else self.input

    @cached_property
    def slack(self) -> IntArray:
        """Strings of the model that are slack at the operating point, by rest lengths; indices.

        They move nothing there, and controllers take them to stay slack.
        """
        if self.input == "force_density":
            return frozen(np.zeros(0, np.int64))
        gamma = self.force_density
        if self.commanded is not self.model.structure:
            gamma = to_segments(self.model.structure, "force_density", gamma)
        return frozen(np.flatnonzero(gamma == 0))

    @property
    def load_input(self) -> list[FloatArray]:
        """W as an argument of the model's functions: what is not built in, on the free nodes."""
        return load_arguments(self.model, self.external_force)

    @cached_property
    def spectral_radius(self) -> float:
        """Largest size of a pole, 1/s; 0 without poles."""
        return float(self._pole_sizes.max(initial=0.0))

    @cached_property
    def _pole_sizes(self) -> FloatArray:
        if is_undamped(self):
            r = self.degrees_of_freedom
            squares = squared_frequencies(-self.A[r:, :r])[0]
            return np.sqrt(np.abs(np.repeat(squares, 2)))
        return np.asarray(np.abs(np.linalg.eigvals(self.A)))

    @cached_property
    def slowest_vibration(self) -> float:
        """Least size of a pole that is not zero, 1/s; inf without one."""
        vibrations = self._pole_sizes[self._pole_sizes > _AT_REST * self.spectral_radius]
        return float(vibrations.min(initial=np.inf))

    def refuse_long_sample_time(self, sample_time: float) -> None:
        """Raise if even the slowest vibration turns more than ten times in a sample.

        Parameters
        ----------
        sample_time : float
            s.
        """
        slowest = self.slowest_vibration
        if np.isfinite(slowest) and sample_time * slowest > _MOST_TURNED:
            raise ValueError(
                f"sample_time is {sample_time:g} s, in which even the slowest vibration of the "
                f"plant, {slowest / (2 * np.pi):.3g} Hz, turns "
                f"{sample_time * slowest / (2 * np.pi):.3g} times: the controller cannot act in "
                f"between. Times are in seconds: did you mean {sample_time / 1000:g} "
                f"({sample_time:g} ms)?"
            )

    @cached_property
    def prepared(self) -> Prepared:
        """What was built for this plant once, for every later call; not for users."""
        return Prepared()

    def measure(self, nodes: object, velocities: object) -> FloatArray:
        """Return z of a motion; see :meth:`Coordinates.measure`."""
        return self.coordinates.measure(nodes, velocities)

    def to_nodes(self, q: object, bar_length: object = None) -> FloatArray:
        """Return node positions of reduced coordinates; see :meth:`Coordinates.to_nodes`."""
        return self.coordinates.to_nodes(q, bar_length)

    def to_velocities(
        self, q: object, rates: object, bar_length: object = None, bar_length_rate: object = None
    ) -> FloatArray:
        """Return node velocities; see :meth:`Coordinates.to_velocities`."""
        return self.coordinates.to_velocities(q, rates, bar_length, bar_length_rate)

    def discretize(self, sample_time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the exact zero-order-hold model ``z⁺ = Φ z + Γ v + d``.

        Parameters
        ----------
        sample_time : float
            Sample time, s.

        Returns
        -------
        Φ, Γ : ndarray, shape (2r, 2r) and (2r, m)
            Matrices of a sample.
        d : ndarray, shape (2r,)
            The drift over one sample, m √kg and m √kg/s.

        Raises
        ------
        TypeError, ValueError
            If the sample time is not a positive finite number, or so long that digits are lost.
        """
        return zero_order_hold(
            self, self.B, validation.positive_number("sample_time", sample_time, "s")
        )

    @property
    def state_names(self) -> list[str]:
        """Names of z: coordinates, then rates."""
        r = self.degrees_of_freedom
        if self.coordinates.kind == "nodes":
            d, rows = self.model.structure.dimension, self.model.structure.free_rows.tolist()
            positions = [f"{'xyz'[row % d]}[{row // d}]" for row in rows]
        else:
            positions = [f"q[{i}]" for i in range(r)]
        return positions + [f"d{name}" for name in positions]

    @property
    def input_names(self) -> list[str]:
        """Names of v, by string group: ``gamma_top[0]`` or ``rest_length_top[0]``.

        Of winches that were given a name, that name. Of bars ``bar_length_bar[0]``.
        """
        symbol = "gamma" if self.input == "force_density" else self.string_input
        rows, lead = member_rows(self.input, self.commanded), self.actuation.lead
        names = self.actuation.names or lead_names(self.commanded, rows, lead)
        symbols = np.where(lead < rows[1].start, symbol, "bar_length")
        return [f"{symbol}_{name}" for symbol, name in zip(symbols, names, strict=True)]

    @property
    def output_names(self) -> list[str]:
        """Names of the node displacements, node by node."""
        d, n = self.nodes.shape
        return [f"delta_{axis}[{i}]" for i in range(n) for axis in "xyz"[:d]]

    def to_statespace(self, dt: float | None = None, outputs: str = "nodes") -> control.StateSpace:
        """Return the plant as a ``control.StateSpace`` with named signals.

        Parameters
        ----------
        dt : float, optional
            Sample time, s: the plant is discretized exactly, for inputs held between samples. A
            continuous system if not given.
        outputs : {"nodes", "state"}
            The node displacements δN, m, node by node; or z, as :meth:`LQR.to_statespace` sees it.

        Returns
        -------
        control.StateSpace

        Raises
        ------
        ValueError
            If the operating point is not an equilibrium: a state-space system has no drift. If
            damped strings feel the rate of the input.
        """
        validation.choice("outputs", outputs, ("nodes", "state"))
        if dt is not None:
            dt = validation.positive_number("dt", dt, "s")
        if np.abs(self.drift).max(initial=0.0) > 1e-8 * max(1.0, np.abs(self.A).max(initial=0.0)):
            raise ValueError(
                "the plant has a drift, as it was linearized away from an equilibrium, and a "
                "StateSpace has none. Use A, B and drift"
            )
        if self.rate_input is not None:
            raise ValueError(
                "the plant has damped strings, which feel the rate of the lengths of bars, and a "
                "StateSpace of lengths has no rate of its input. Use A, B and rate_input"
            )
        A, B = (self.A, self.B) if dt is None else self.discretize(dt)[:2]
        r, by_node = self.degrees_of_freedom, outputs == "nodes"
        C = np.hstack([self.basis, np.zeros((len(self.basis), r))]) if by_node else np.eye(2 * r)
        D = np.zeros((len(C), B.shape[1]))
        if by_node and self.input_displacements is not None:
            D = np.array(self.input_displacements)
        return named_system(
            (A, B, C, D),
            dt,
            f"{self.coordinates.kind} {self.input}",
            inputs=self.input_names,
            outputs=self.output_names if by_node else self.state_names,
            states=self.state_names,
        )

    def __repr__(self) -> str:
        return (
            f"LinearPlant({self.degrees_of_freedom} {self.coordinates.kind} coordinates, "
            f"input {self.input}, {len(self.actuation.lead)} inputs)"
        )


def named_system(
    matrices: tuple[FloatArray, FloatArray, FloatArray, FloatArray], dt: float | None, name: str,
    **signals: list[str],
) -> control.StateSpace:  # fmt: skip
    """Return A, B, C, D as a system with named inputs, outputs and states; dt None: continuous."""
    import control

    return control.StateSpace(
        *matrices, 0 if dt is None else dt, name=name.replace(" ", "_"),
        remove_useless_states=False, **signals,
    )  # fmt: skip


def _dense_A(plant: LinearPlant) -> FloatArray:  # noqa: N802
    r, system, turned = (
        plant.degrees_of_freedom,
        _second_order(plant),
        plant.coordinates.from_sparse,
    )
    refuse_large("A", (2 * r, 2 * r))
    A = np.zeros((2 * r, 2 * r))
    A[:r, r:] = np.eye(r)
    A[r:, :r] = -turned(turned(system.stiffness).T).T
    if system.damping.nnz:
        A[r:, r:] = -turned(turned(system.damping).T).T
    return A


def _dense_B(plant: LinearPlant) -> FloatArray:  # noqa: N802
    by_input = _second_order(plant).by_input
    refuse_large("B", (2 * plant.degrees_of_freedom, by_input.shape[1]))
    moved = plant.coordinates.from_sparse(by_input)
    return np.vstack([np.zeros_like(moved), moved])


def _dense_drift(plant: LinearPlant) -> FloatArray:
    moved = plant.coordinates.from_sparse(_second_order(plant).drift)
    return np.concatenate([np.zeros_like(moved), moved])


def _second_order(plant: LinearPlant) -> SparsePlant:
    assert plant.sparse is not None  # else A, B and drift were given
    return plant.sparse


@on_one_thread
def state_units(plant: LinearPlant) -> tuple[FloatArray, float]:
    """Return units of the state, shape (s,), and of the input: of one speed and acceleration."""
    r = plant.degrees_of_freedom
    highest = plant.spectral_radius or 1.0
    largest = spectral_norm(plant.B) or 1.0
    return frozen(np.r_[np.full(r, 1 / highest), np.ones(r)]), highest / largest


def load_arguments(model: Model, load: FloatArray) -> list[FloatArray]:
    """Return the load input of a model's functions: what is not built in, on the free nodes."""
    if not model.has_external_force:
        return []
    return [(load - model.constant_force)[:, model.structure.free]]


@dataclass(frozen=True, eq=False)
class Sampled:
    """The exact model of a sample, ``z⁺ = Φ z + Γ_p v_previous + Γ v + d``."""

    sample_time: float  # s
    transition: FloatArray  # Φ, (s, s)
    by_previous: FloatArray  # Γ_p, (s, m); zero without a ramp
    by_input: FloatArray  # Γ, (s, m)
    drift: FloatArray  # d, (s,)
    ramp: bool  # whether the input moves through the sample, from v_previous to v

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def augmented(self) -> tuple[FloatArray, FloatArray]:
        """Φ and Γ of the state ``[z; v_previous]``, or of z without a ramp."""
        if not self.ramp:
            return self.transition, self.by_input
        s, a = self.by_input.shape
        rows = np.hstack([self.transition, self.by_previous])
        return np.vstack([rows, np.zeros((a, s + a))]), np.vstack([self.by_input, np.eye(a)])

    def free_response(
        self, state: FloatArray, previous: FloatArray, origin: FloatArray
    ) -> FloatArray:
        """Return the next state at zero input without drift; ``origin`` is where v is zero."""
        free = self.transition @ state - self.by_input @ origin
        if self.ramp:
            free += self.by_previous @ previous
        return np.asarray(free)


def kept(
    function: Callable[Concatenate[LinearPlant, _Arguments], _Value],
) -> Callable[Concatenate[LinearPlant, _Arguments], _Value]:
    """Keep with a plant what a function of it and of hashable arguments returns."""

    @wraps(function)
    def get(plant: LinearPlant, /, *args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Value:
        key = function.__qualname__, args, tuple(kwargs.items())
        return plant.prepared.get(key, lambda: function(plant, *args, **kwargs))

    return get


def spectral_norm(matrix: FloatArray) -> float:
    """Return the largest singular value, from the squares of what has few rows or columns."""
    largest = float(np.abs(matrix).max(initial=0.0))
    if largest == 0.0:
        return 0.0
    scaled = matrix / largest
    is_wide = matrix.shape[0] < matrix.shape[1]
    squares = scaled @ scaled.T if is_wide else scaled.T @ scaled
    return largest * float(np.sqrt(np.linalg.norm(squares, 2)))


def tall_qr(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Q and R as ``numpy.linalg.qr``, of many rows part by part, each in the cache."""
    count = len(matrix) // max(_ROWS, 2 * matrix.shape[1])
    if count < 2:
        Q, R = np.linalg.qr(matrix)
        return Q, R
    parts = [np.linalg.qr(rows) for rows in np.array_split(matrix, count)]
    turns, R = np.linalg.qr(np.vstack([R for _, R in parts]))
    turned = zip(parts, np.split(turns, count), strict=True)
    return np.vstack([Q @ turn for (Q, _), turn in turned]), R


@kept
def sampled(plant: LinearPlant, sample_time: float, ramp: bool) -> Sampled:
    """Return the sampled model, of an input that ramps to v or jumps to it."""
    from scipy.linalg import expm

    plant.refuse_long_sample_time(sample_time)
    if plant.drives_bars and not ramp:
        raise ValueError(NO_JUMP)
    transition, whole, drift = plant.discretize(sample_time)
    states, inputs = whole.shape
    now = whole
    if ramp:
        exponent = np.zeros((states + 2 * inputs,) * 2)
        exponent[:states, : states + inputs] = sample_time * np.hstack([plant.A, plant.B])
        exponent[states : states + inputs, states + inputs :] = np.eye(inputs)
        now = expm(exponent)[:states, states + inputs :]
    if plant.rate_input is not None:  # constant over a ramp
        moved = zero_order_hold(plant, plant.rate_input, sample_time)[1] / sample_time
        now = now + moved
    return Sampled(sample_time, transition, whole - now, now, drift, ramp)


@kept
def acceleration_response(plant: LinearPlant, sample_time: float) -> FloatArray:
    """Return the response of the state to unit accelerations held over a sample, shape (s, r)."""
    r = plant.degrees_of_freedom
    unit = np.vstack([np.zeros((r, r)), np.eye(r)])
    return frozen(zero_order_hold(plant, unit, sample_time)[1])


@on_one_thread
def zero_order_hold(
    plant: LinearPlant, B: FloatArray, sample_time: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Φ, Γ and d of ``z⁺ = Φ z + Γ v + d``, exact for v held over a sample."""
    from scipy.linalg import expm

    states = len(B)
    # What is held over a sample; of more inputs than states, accelerations and speeds.
    held = np.column_stack([B, plant.drift])
    pushed = held if held.shape[1] <= states else np.eye(states)
    exponent = np.zeros((states + pushed.shape[1],) * 2)
    exponent[:states, :states], exponent[:states, states:] = plant.A, pushed
    turned, grown = sample_time * plant.spectral_radius, np.full((states, len(exponent)), np.nan)
    if turned <= _MOST_RADIANS:
        with np.errstate(over="ignore", invalid="ignore"):
            grown = expm(sample_time * exponent)[:states]
    if not np.isfinite(grown).all():
        raise ValueError(
            f"sample_time is {sample_time:g} s, in which the plant turns by up to {turned:.3g} rad "
            f"or its state overflows; expected at most {_MOST_RADIANS:g} rad, as more loses digits"
        )
    moved = grown[:, states:] if pushed is held else grown[:, states:] @ held
    return grown[:, :states], moved[:, :-1], moved[:, -1]


def is_undamped(plant: LinearPlant) -> bool:
    """Whether ``q̈ + K q = 0`` with symmetric K describes a plant."""
    r = plant.degrees_of_freedom
    stiffness, friction = plant.A[r:, :r], plant.A[r:, r:]
    asymmetry = np.abs(stiffness - stiffness.T).max(initial=0.0)
    largest = np.abs(stiffness).max(initial=0.0)
    return not friction.any() and bool(asymmetry <= _SYMMETRIC * largest)


def squared_frequencies(stiffness: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ω² and orthonormal modes of ``q̈ + K q = 0``, ascending; round-off is zero."""
    values, vectors = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    values[np.abs(values) < _ZERO * np.abs(values).max(initial=0.0)] = 0.0
    return values, vectors


def clusters(values: FloatArray) -> list[tuple[int, int]]:
    """Return the runs of equal ω² in a sorted array."""
    noise = _NOISE * np.abs(values).max(initial=0.0)
    breaks = np.flatnonzero(np.diff(values) > _EQUAL * np.abs(values[1:]) + noise) + 1
    edges = [0, *breaks.tolist(), len(values)]
    return list(pairwise(edges)) if len(values) else []
