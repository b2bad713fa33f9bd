"""The interface of integrators."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil
from typing import NamedTuple, TypeVar

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.contact_laws import ContactLaw
from tenscontrol.dynamics.equation import Equation, unpack_states
from tenscontrol.dynamics.evaluator import Function, SharedEvaluator
from tenscontrol.integrate.core_scene import core_scene
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.blocks import node_mass
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import moving_mass

_Built = TypeVar("_Built")

# States that fit in memory, as a count of numbers.
_MOST_NUMBERS = 5e8

# Time in one call of CasADi, s, from which on the next call is given fewer steps: signals wait.
_LONGEST_CALL = 0.2

FloatOrArray = float | FloatArray

# The last frequency with the state and the input for which it was found.
_Frequencies = dict[str, tuple[tuple[bytes, bytes], float]]

# Told the time reached within the span, s.
Report = Callable[[float], None]


@dataclass(frozen=True)
class Work:
    """What an integration cost, and how often strings or contacts switched.

    Attributes
    ----------
    steps : int
        Steps taken.
    rejections : int
        Steps that were tried and thrown away, because their error was too large or another method
        got further.
    evaluations : int
        Evaluations of the right-hand side, or of the forces.
    switches : int
        Strings that went slack or taut, and contacts that opened or closed, counted singly. A step
        is made to end there, or it is carried.
    carried : int
        Those of the switches that are within a step which was not cut, as many are in it: what they
        change is added to its end, to an error of order 4 in the step. Of the compiled core, where
        no force that switches depends on velocities.
    missed : int
        Switches that were not located: acted on at the end of a step, or not at all, where a string
        or contact was back by then. 0 of methods that look for none.
    """

    steps: int = 0
    rejections: int = 0
    evaluations: int = 0
    switches: int = 0
    missed: int = 0
    carried: int = 0

    def __add__(self, other: Work) -> Work:
        if self is NO_WORK:
            return other
        return Work(
            self.steps + other.steps, self.rejections + other.rejections,
            self.evaluations + other.evaluations, self.switches + other.switches,
            self.missed + other.missed, self.carried + other.carried,
        )  # fmt: skip


#: What a motion has cost at its start.
NO_WORK = Work()


class StepEnds(NamedTuple):
    """Where steps of a span ended: all of them, or every second, fourth, ... of many.

    Attributes
    ----------
    time : ndarray, shape (K,)
        After the start of the span, s, ascending.
    states : ndarray, shape (states, K)
    taut : ndarray, shape (switches, K), optional
        What pulled and pressed in the step that ended there, where it was traced.
    """

    time: FloatArray
    states: FloatArray
    taut: FloatArray | None = None

    @classmethod
    def joined(cls, spans: Sequence[StepEnds]) -> StepEnds:
        """Return ends that follow one another; their times count from the same start."""
        if len(spans) == 1:
            return spans[0]
        taut = [span.taut for span in spans if span.taut is not None]
        return cls(
            np.concatenate([span.time for span in spans]),
            np.concatenate([span.states.T for span in spans]).T,
            np.concatenate(taut, axis=1) if len(taut) == len(spans) else None,
        )


class Trace:
    """The ends of steps of a span, one by one, where all are wanted."""

    def __init__(self, wanted: bool) -> None:
        self.wanted = wanted
        self._ends: list[tuple[float, FloatArray, FloatArray]] = []

    def append(self, time: float, state: FloatArray, taut: FloatArray) -> None:
        """Keep the end of a step, with what pulled and pressed in it, if it is wanted."""
        if self.wanted:
            self._ends.append((time, state.copy(), taut.copy()))

    @property
    def ends(self) -> StepEnds | None:
        """What was kept; None where nothing was."""
        if not self._ends:
            return None
        time, states, taut = zip(*self._ends, strict=True)
        return StepEnds(np.array(time), np.column_stack(states), np.column_stack(taut))


@dataclass(frozen=True, eq=False)
class Span:
    """States at equally spaced times of one span, its start left out.

    Attributes
    ----------
    states : ndarray, shape (states, outputs)
    work : Work
    whole : ndarray, shape (states, outputs + 1), optional
        The start, then the states, where they lie together in memory.
    ends : StepEnds, optional
        Of the steps, if the integrator was told to keep some.
    """

    states: FloatArray
    work: Work
    whole: FloatArray | None = None
    ends: StepEnds | None = None

    __repr__ = short_repr


class AdvancedSpans(NamedTuple):
    """Spans that follow one another.

    Attributes
    ----------
    whole : list of ndarray, shape (states, outputs + 1)
        Of each, its start and the states after it, see :class:`Span`.
    ends : list of StepEnds
        Of each.
    work : Work
        Of all.
    """

    whole: Sequence[FloatArray] = ()
    ends: Sequence[StepEnds] = ()
    work: Work = NO_WORK


@dataclass(frozen=True, eq=False)
class SpanInputs:
    """What K spans that follow one another are integrated under.

    Attributes
    ----------
    held : ndarray, shape (K, inputs)
        u at the start of each.
    duration : ndarray, shape (K,)
        s.
    outputs : ndarray of int, shape (K,)
    """

    held: FloatArray
    duration: FloatArray
    outputs: IntArray

    def first(self, count: int) -> SpanInputs:
        """Return the first of these."""
        return SpanInputs(*(array[:count] for array in vars(self).values()))


@dataclass(frozen=True)
class MethodChange:
    """Another method that went on with a motion.

    Attributes
    ----------
    time : float
        From when on, s.
    method : str
    reason : str
    """

    time: float
    method: str
    reason: str


class IntegrationError(ArithmeticError):
    """An integration that could not go on.

    Attributes
    ----------
    time : float
        Time within the span up to which the states are good, s.
    span : Span
        What was reached, at as many output times as were.
    """

    def __init__(self, message: str, time: float, span: Span) -> None:
        super().__init__(message)
        self.time = time
        self.span = span


class IntegrationPause(Exception):  # noqa: N818 (nothing is wrong)
    """An integration that used the evaluations that :attr:`Integrator.limit` leaves it.

    Attributes
    ----------
    time : float
        Time reached within the span, s.
    state : ndarray, shape (states,)
        x at that time.
    span : Span
        The states at the output times up to it.
    """

    def __init__(self, time: float, state: FloatArray, span: Span) -> None:
        super().__init__("paused")
        self.time = time
        self.state = state
        self.span = span


class IntegrationInterrupt(KeyboardInterrupt):
    """An integration that Ctrl-C or SIGTERM ended; nothing is wrong.

    ``time`` and ``span`` are those of :class:`IntegrationError`.
    """

    def __init__(self, time: float, span: Span) -> None:
        super().__init__("interrupted")
        self.time = time
        self.span = span


def checked_tolerance(tolerance: object, least: float = 100 * float(np.finfo(float).eps)) -> float:
    """Return a tolerance, or raise: below ``least`` round-off would reject every step."""
    value = validation.positive_number("tolerance", tolerance, "of size and speed")
    if value < least:
        raise ValueError(
            f"tolerance is {value:g}, expected at least {least:.1e}: "
            "double precision goes no further"
        )
    return value


def next_size(most: int, size: int, taken: float) -> int:
    """Return how many steps a call may take, after one of a size that took so long, s."""
    if taken > _LONGEST_CALL:
        return max(size // 8, 1)
    return min(8 * most, 4096) if taken < _LONGEST_CALL / 16 else most


def steps_between(spacing: float, step: float) -> int:
    """Return how many steps, shortened to fit, there are between outputs.

    The small allowance lets 0.02/0.001 be 20 steps, whatever round-off says.
    """
    return max(1, ceil(spacing / step - 1e-9))


def where_needed(function: ca.Function) -> ca.Function:
    """Return ``(needed, first, …) -> value``: what a function returns, or else its first input."""
    count = function.n_in()
    inputs = [ca.MX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(count)]
    idle = Function("idle", inputs, [inputs[0]])
    return ca.Function.if_else(f"{function.name()}_or_not", function, idle)


class Integrator(ABC):
    """Integrates ``ẋ = f(x, u)`` with u held, or told for all times: see :meth:`Equation.ahead`.

    Parameters
    ----------
    equation : Equation
    project : bool
        Whether to make the bar lengths exact after each step, in a method from which they drift.
    """

    #: Name as users give it to ``simulate(method=...)``.
    name: str

    #: What runs the steps: ``"core"``, compiled at installation, or CasADi's ``"virtual machine"``.
    back_end = "virtual machine"

    #: Evaluations after which :meth:`advance` raises :class:`IntegrationPause`, where it can.
    limit = float("inf")

    #: Methods that took over from the first one.
    changes: tuple[MethodChange, ...] = ()

    #: Whether ends of steps are kept, of what runs in the core; see :attr:`Span.ends`.
    keeps_steps = False

    #: Whether each step ends at its first switch, as near as it can, and all ends are kept, with
    #: what pulled in the step. Of explicit methods.
    traces = False

    def __init__(self, equation: Equation, project: bool = False) -> None:
        validation.instance("equation", equation, Equation, "make one by model.equation(input)")
        validation.truth("project", project, "whether to make bar lengths exact after each step")
        self._equation = equation

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._equation!r})"

    @property
    def cost(self) -> float:
        """What an evaluation takes with all work around it, in about microseconds.

        It follows from sizes, and is no measurement: the same on every machine.
        """
        return 1.0

    def _checked(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int, report: object
    ) -> tuple[FloatArray, FloatArray, float, int]:
        """Return what :meth:`advance` is given, or refuse what the equation does not take."""
        size = self._equation.states
        if report is not None:
            validation.function("report", report, "it is told the time reached, s")
        checked = (
            validation.measured("state", state, (size,), "positions, then velocities"),
            validation.shaped("held", held, (self._equation.inputs,), "one number per input"),
            validation.positive_number("duration", duration, "s"),
            validation.whole_number("outputs", outputs, 1, int(_MOST_NUMBERS / max(size, 1))),
        )
        if not validation.is_bounded(checked[0]):
            nothing = Span(np.empty((size, 0)), Work())
            raise IntegrationError(
                f"the state has run away, beyond {validation.LARGEST:g}", 0.0, nothing
            )
        return checked

    def _kept(self, build: Callable[[], _Built], *settings: Hashable) -> _Built:
        """Return what is built once for the equation, this class and these settings."""
        return self._equation.prepared.get((type(self), *settings), build)

    def shorten(self) -> None:  # noqa: B027  # the rule where steps are fixed
        """Take shorter steps at the start and where stability or the span limits them.

        A smaller tolerance alone would take the same steps there, and show no difference.
        """

    @abstractmethod
    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """Return the states at ``outputs`` equally spaced times, the last at ``duration``.

        Parameters
        ----------
        state : ndarray, shape (states,)
            x at the start.
        held : ndarray, shape (inputs,)
            u, constant over the span; or polynomials in time, as the equation takes them, with the
            time at which the span begins.
        duration : float
            Length of the span, s.
        outputs : int
            Number of states to return, at least 1.
        report : callable, optional
            Told the time reached, now and then.

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit the equation.
        IntegrationError
            If the state grows beyond all bounds, or the step size vanishes.
        IntegrationInterrupt
            If the user interrupts; see :func:`tenscontrol.interrupt.check`.
        """

    def advance_spans(self, state: FloatArray, given: SpanInputs) -> AdvancedSpans:
        """Return spans that follow one another, as far as they are found together.

        They are what :meth:`advance` returns of one after the other, up to the first that it has to
        be called for: it fails there, or has to look at something anew. That may be the very first.

        Parameters
        ----------
        state : ndarray, shape (states,)
        given : SpanInputs

        Returns
        -------
        AdvancedSpans
        """
        return AdvancedSpans()


# ---- scales ----

# Iterations of the power method, at most and at least, the change of its square from one to the
# next at which they end, as part of it, and the step of its differences as part of the size.
_POWER_ITERATIONS, _FEWEST_ITERATIONS, _SETTLED, _DIFFERENCE = 60, 8, 1e-3, 1e-6


def state_scale(
    equation: Equation, state: FloatArray, held: FloatArray, frequency: float
) -> FloatArray:
    """Return the size of each entry of the state, shape (states,).

    For positions it is the length of the longest bar or straight piece of string; for velocities
    the larger of the fastest node's and the speed that the forces at the start give the whole
    structure over its own size, but a thousandth of what the fastest vibration of that size would
    have at least. So the answer does not change with units or place. An equation that is no
    structure's has the entry itself and 1.

    ``frequency`` is from :func:`largest_frequency`, rad/s.
    """
    force = equation.force
    if equation.structure is None or force is None:
        return 1 + np.abs(state)
    core = core_scene(equation)
    if core is not None:
        return scale_under(equation, state, core.largest_force(state, held), frequency)
    q, v = np.split(state, 2)
    taut = _shared(equation, "gap", lambda: equation.gap)(state, held)[0] > 0
    on_free = _shared(equation, "force", lambda: force)(q, v, held, taut)[0]
    return scale_under(equation, state, float(np.abs(on_free).max(initial=0.0)), frequency)


def scale_under(
    equation: Equation, state: FloatArray, force: float, frequency: float
) -> FloatArray:
    """Return the same under forces of which this is the largest, N."""
    assert equation.structure is not None  # it has forces
    half, (size, mass) = len(state) // 2, length_and_mass(equation)
    fastest = np.abs(state[half:]).max(initial=0.0)
    scale = np.empty(2 * half)
    scale[:half], scale[half:] = size, speed_scale(size, mass, fastest, force, frequency)
    return scale


def length_and_mass(equation: Equation) -> tuple[float, float]:
    """Return the length of the longest bar or straight piece of string, m, and what moves, kg."""
    structure = equation.structure
    return equation.prepared.get("length and mass", lambda: _length_and_mass(structure))


def speed_scale(
    size: float, mass: FloatOrArray, fastest: FloatOrArray, force: FloatOrArray,
    frequency: FloatOrArray,
) -> FloatArray:  # fmt: skip
    """Return the scale of velocities, m/s, of one run or several; see :func:`state_scale`."""
    speeds = np.sqrt(force * size / mass), 1e-3 * size * frequency
    speed = np.fmax(np.fmax(fastest, speeds[0]), speeds[1])
    # Where nothing moves and nothing pulls, any speed will do.
    return np.where(speed > 0, speed, size)


def _length_and_mass(structure: Structure | None) -> tuple[float, float]:
    assert structure is not None  # asked of what has members only
    nodes, members = structure.nodes, np.vstack([structure.bars, structure.segments])
    ends = nodes[:, members[:, 1]] - nodes[:, members[:, 0]]
    return float(np.linalg.norm(ends, axis=0).max()), moving_mass(structure)


def largest_frequency(equation: Equation, state: FloatArray, held: FloatArray) -> float:
    """Return the largest frequency of small motions about a state with all strings taut, rad/s.

    By power iteration on the derivative of the accelerations with respect to
    the positions: its largest eigenvalue is -ω². It is 0 for an equation that is no structure's.
    The ground is left out: see :func:`contact_frequency`.
    """
    if equation.structure is None:
        return 0.0
    # A run asks for it several times at its start, and so does the next from there.
    last = equation.prepared.get("last frequency", _Frequencies)
    given = state.tobytes(), held.tobytes()
    known = last.get("known")
    if known is None or known[0] != given:
        known = last["known"] = given, _largest_frequency(equation, state, held)
    return known[1]


def _largest_frequency(equation: Equation, state: FloatArray, held: FloatArray) -> float:
    difference, random = float(differences(state)), first_vector(equation)
    core = core_scene(equation)
    if core is not None:
        return core.frequency(state, held, difference, random)
    square = _shared(equation, "frequency", lambda: _power_iteration(equation))
    given = (state, held, _strings_alone(equation), difference, random)
    return float(np.sqrt(square(*given)[0][0]))


def differences(states: FloatArray) -> FloatArray:
    """Return the differences, m, by which frequencies are found, of states (…, states)."""
    positions = states[..., : states.shape[-1] // 2]
    size = np.abs(positions - positions.mean(axis=-1, keepdims=True)).max(axis=-1)
    return _DIFFERENCE * np.where(size > 0, size, 1.0)


def first_vector(equation: Equation) -> FloatArray:
    """Return the vector with which the power iteration begins."""
    n = equation.states // 2
    return equation.prepared.get("random", lambda: np.random.default_rng(0).standard_normal(n))


def _power_iteration(equation: Equation) -> ca.Function:
    """Return ``(x, u, taut, difference, vector) -> square`` of the largest frequency."""
    n = equation.states // 2
    x, u, taut, difference = equation.symbols(ca.MX)
    slope, vector, base = equation.slope, ca.MX.sym("vector", n), ca.MX.sym("base", n)
    before, goes_on = ca.MX.sym("before"), ca.MX.sym("goes_on")
    count = ca.MX.sym("count")
    size = ca.norm_2(vector)
    settled = ca.logic_not(ca.fabs(size - before) > _SETTLED * size)
    more = ca.if_else(ca.logic_and(count >= _FEWEST_ITERATIONS, settled), 0, goes_on)
    change = difference * vector / ca.if_else(size > 0, size, 1)
    end = slope(ca.vertcat(x[:n] + change, x[n:]), u, taut)[n:]
    following = ca.if_else(more, (end - base) / difference, vector)
    given = (base, x, u, taut, difference)
    again = Function(
        "again",
        [ca.vertcat(vector, before, goes_on, count), *given],
        [ca.vertcat(following, size, more, count + 1)],
    )
    columns = [ca.repmat(symbol, 1, _POWER_ITERATIONS) for symbol in given[1:]]
    first = ca.repmat(slope(x, u, taut)[n:], 1, _POWER_ITERATIONS)
    end = again.fold(_POWER_ITERATIONS)(ca.vertcat(vector, 0, 1, 0), first, *columns)
    return Function("frequency", [*given[1:], vector], [ca.norm_2(end[:n])])


def _shared(equation: Equation, name: str, build: Callable[[], ca.Function]) -> SharedEvaluator:
    """Return what evaluates a function of an equation, kept with it."""
    return equation.prepared.get(("evaluates", name), lambda: SharedEvaluator(build()))


def contact_frequency(equation: Equation, state: FloatArray, held: FloatArray) -> float:
    """Return the largest rate at which the ground acts on a motion from a state, rad/s.

    Of three, for the lightest node that can touch: its vibration on the ground, √(F'/m), and
    the rates at which damping and friction bring it to rest, ∂F/∂ṗ/m and μ F/(m v_s). The first is
    taken at the depth at which one node has taken the energy of all: that of now, and of the fall
    to the ground; the others where one node carries the whole load, since impacts are short. It is
    0 without ground.
    """
    structure, force, contacts = equation.structure, equation.force, equation.contacts
    if structure is None or force is None or contacts is None:
        return 0.0
    N, V = (array[:, :, 0] for array in unpack_states(structure, state[:, None]))
    forces, (q, v) = np.zeros(N.size), np.split(state, 2)
    forces[structure.free_rows] = np.array(force(q, v, held, _strings_alone(equation))).ravel()
    load = float(np.linalg.norm(forces.reshape(-1, structure.dimension).T.sum(axis=1)))
    # The end of a bar in the middle of which nothing holds it has ¾ of its entry in the mass.
    mass = 0.75 * node_mass(structure).diagonal()
    total = float(mass.sum())
    kinetic = 0.5 * total * float((V**2).sum(axis=0).max())
    rates = [0.0]
    for i, (law, nodes_of_law, _) in enumerate(contacts):
        if len(nodes_of_law):
            of_depth = equation.prepared.get(("contact rate", i), partial(_of_depth, law))
            highest = -float(
                np.array(law.sinking(ca.DM(N[:, nodes_of_law]), ca.DM(V[:, nodes_of_law]))[0]).max()
            )
            energy = kinetic + load * max(highest, 0.0)
            least, size = float(mass[nodes_of_law].min()), float(np.ptp(N))
            rates.append(_contact_rate(law, of_depth, energy, load, least, size))
    return max(rates)


def _of_depth(law: ContactLaw) -> ca.Function:
    """Return ``(p, ṗ) -> (stored, F, ∂F/∂p, ∂F/∂ṗ)`` of a node."""
    p, rate = ca.SX.sym("p"), ca.SX.sym("rate")
    normal = law.normal_force(p, rate)
    outputs = [law.stored_energy(p), normal, ca.jacobian(normal, p), ca.jacobian(normal, rate)]
    return Function("of_depth", [p, rate], outputs)


def _contact_rate(
    law: ContactLaw, of_depth: ca.Function, energy: float, load: float, mass: float, size: float
) -> float:
    """Return the largest rate of a node of a mass, rad/s."""

    def depth(output: int, wanted: float) -> float:
        """Return the depth at which an output reaches a value, to a few per cent."""
        deep, shallow = 1e3 * size, 1e-15 * size
        while deep > 1.05 * shallow:
            middle = float(np.sqrt(deep * shallow))
            reached = float(of_depth(middle, 0)[output]) >= wanted
            deep, shallow = (middle, shallow) if reached else (deep, middle)
        return deep

    at_rest, at_impact = depth(1, load), depth(0, energy)
    stiffness = float(of_depth(max(at_rest, at_impact), 0)[2])
    damping = float(of_depth(at_rest, 0)[3]) if load else 0.0
    friction = law.friction * load / law.slip_speed
    return max(float(np.sqrt(max(stiffness, 0.0) / mass)), damping / mass, friction / mass)


def _strings_alone(equation: Equation) -> FloatArray:
    """Return switches with all strings taut and nothing on the ground."""
    strings = 0 if equation.forces is None else equation.forces.strings.switches
    return (np.arange(equation.switches) < strings).astype(float)
