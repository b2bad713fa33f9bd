"""What all model predictive controllers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, signature
from typing import Any, ClassVar, Concatenate, ParamSpec, Self, TypeVar

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import BoolArray, FloatArray, freeze_arrays, frozen
from tenscontrol.control.command import ControlWarning
from tenscontrol.control.controller import Controller, warn_of_unreached
from tenscontrol.control.disturbance import LoadModel, LoadObserver, load_observer
from tenscontrol.control.mpc.constraints import OutputLimit, broken_limits, output_block
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.control.mpc.problem import (
    Constraints,
    MPCProblem,
    RowBlock,
    string_block,
)
from tenscontrol.control.mpc.qp_solver import MOST_ITERATIONS, QPSolver
from tenscontrol.control.mpc.sparse import Sparse
from tenscontrol.core.library import absence, library
from tenscontrol.fields import check_fields, checked, optional
from tenscontrol.plant.controllability import (
    lasting,
    reached_states,
    refuse_empty,
    refuse_unreachable,
    ways,
)
from tenscontrol.plant.input_bounds import input_bounds, largest_change
from tenscontrol.plant.linear_plant import LinearPlant, Sampled, acceleration_response, sampled
from tenscontrol.plant.linearize import OperatingPoint, linearize
from tenscontrol.plant.reference import Reference, ReferencePreview
from tenscontrol.plant.riccati import (
    cross_weight,
    least_eigenvalue,
    natural_weights,
    regulator,
)
from tenscontrol.plant.string_outputs import (
    input_matrix,
    string_map,
    to_commanded_strings,
    to_model_strings,
)
from tenscontrol.short_repr import short_repr
from tenscontrol.string_bounds import string_bounds
from tenscontrol.warn import warn

# Price of a violation by one level, against the cost of an input one level off.
_PENALTY = 1e2

# Least γ in a shape, relative to the largest: there a string is taken as taut.
_TAUT = 1e-6

_SOLVERS = ("auto", "stages", "osqp")


# Checks of one setting each. Those of arrays leave shapes for later: they depend on the plant.


def _numbers(name: str, value: object) -> object:
    if value is not None:
        validation.float_array(name, value)
    return value


def _limit(name: str, value: object) -> object:
    validation.limits(name, value)
    return value


def _shapes(name: str, value: object) -> object:
    return value if isinstance(value, Reference) else _numbers(name, value)


def _output_limits(name: str, value: object) -> Sequence[object]:
    given = () if value is None else validation.items(name, value, "OutputLimit")
    for i, limit in enumerate(given):
        validation.instance(
            f"{name}[{i}]", limit, OutputLimit, "make one by OutputLimit(matrix, low, high)"
        )
    return given


def _penalty(name: str, value: object) -> float:
    if value is None:
        return _PENALTY
    if isinstance(value, float) and value == np.inf:
        return np.inf
    return validation.positive_number(name, value, "costs of an input, or inf for hard limits")


def _gain(name: str, value: object) -> object:
    if value is not None and (gain := validation.positive_number(name, value, "no unit")) > 1:
        raise ValueError(f"{name} is {gain:g}, expected above 0 and at most 1")
    return value


def _time(name: str, value: object) -> float | None:
    return None if validation.is_unlimited(value) else validation.positive_number(name, value, "s")


def _solver(name: str, value: object) -> object:
    if isinstance(value, str):
        if value not in _SOLVERS:
            known = ", ".join(map(repr, _SOLVERS))
            raise ValueError(
                f"{name} is {value!r}, expected one of {known}, or a subclass of QPSolver"
            )
    elif not (isinstance(value, type) and issubclass(value, QPSolver)):
        raise TypeError(f"{name} is {value!r}, expected a name or a subclass of QPSolver")
    return value


@dataclass(frozen=True, eq=False, kw_only=True)
class MPCSettings:
    """Settings of :class:`MPC` and :class:`NMPC`: horizon, bounds, weights, limits, solver.

    Parameters
    ----------
    horizon : int
        Number of samples predicted, 1 to 10,000.
    sample_time : float
        Time between two commands, s.
    max_force_density : float or array_like, shape (α,), optional
        Largest force density γ, N/m; no limit if infinite or not given. The least is 0 always.
    Q : float or array_like, shape (2r,) or (2r, 2r), optional
        Weight of the state less its reference. If not given, that of :func:`energy_weights`, by
        mode where the input is the rest length.
    R : float or array_like, shape (α,) or (α, α), optional
        Weight of the input. It weighs the departure from the operating point, or from the rest
        lengths that hold the reference. If not given, that of :func:`energy_weights`; a tenth of it
        for γ.
    N : array_like, shape (2r, α), optional
        Cross weight of state and input, each less its reference: ``2 zᵀ N v`` is added to the cost
        of a sample. None if not given.
    terminal_weight : float or array_like, shape (2r,) or (2r, 2r), optional
        Weight P of the state at the end of the horizon, less its reference. Where winches are
        ramps, it may also be of ``[z; v_previous]``, as :attr:`LQR.cost` is. If not given, the
        solution of the Riccati equation of the LQR with these weights.
    max_change : float or array_like, shape (α,), optional
        Largest change of the input from sample to sample, N/m or m.
    reference : Reference or array_like, shape (d, n), optional
        Shapes to follow. They are seen ahead over the horizon; a single shape is a constant one.
        The operating point if not given.
    min_force_density : float or array_like, shape (α,)
        Least force density γ, N/m, at least 0.
    max_tension : float or array_like, shape (α,), optional
        Strength of the strings, N.
    winches : Winches, optional
        Speed and range that bound rest lengths, never violated. Where they move through samples,
        γ is limited at the ends of samples.
    outputs : sequence of OutputLimit, optional
        Limits on node positions.
    string_penalty : float, optional
        Price p of a force density or tension beyond its limit. Beyond by ε times the largest γ, or
        tension, at the operating point, it costs ``p (2 ε + ε²)`` in each sample; the unit is the
        least that R charges for an input off by its unit, see ``tolerance``. The linear part makes
        limits exact: where they can be kept at a lower price, they are. ``inf`` makes them hard;
        commands of γ are within bounds always. 100 if not given.
    load_gain : float, optional
        Gain of the estimate of a constant load, at most 1. With it an unknown load is estimated (at
        once with 1), and the plant is brought to rest at the reference under it.
    tracked : array_like, shape (p, d n), optional
        Node coordinates without offset under a load. Combinations of them; all, as well as
        can be, if not given.
    tolerance : float
        Absolute and relative tolerance of the solver. That of OSQP is where ADMM stops; the exact
        solution is found from there. Its unit is that of an input: the largest γ at the operating
        point, or the largest stretch.
    max_iterations : int, optional
        Most iterations of the solver. 4,000 if not given; for "stages", whose iterations are
        changes of the active set, 10 for each limit of the program where that is more.
    time_limit : float, optional
        Most computing time of a command, s, from its call. A program that is not solved by then is
        given up at the end of an iteration of the solver. The few operations that follow are not
        counted.
    solver : {"auto", "stages", "osqp"} or subclass of QPSolver
        Solver of the quadratic programs. "stages" is an active set along the stages of the horizon,
        exact to round-off, in the compiled core. OSQP (ADMM, then an active set) solves the sparse
        program with its states, as a solver of your own does, and is slower. "auto" takes "stages"
        where the core is there, else OSQP; see the attribute ``solver`` of a controller.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or out of range. What must fit a plant is checked when
        a controller is made.

    Examples
    --------
    >>> from tenscontrol.control import MPCSettings
    >>> MPCSettings(horizon=20, sample_time=0.02, max_force_density=80.0).string_penalty
    100.0
    """

    horizon: int = field(metadata=checked(validation.whole_number, 1, validation.MOST_SAMPLES))
    sample_time: float = field(metadata=checked(validation.positive_number, "s"))
    max_force_density: object = field(default=None, metadata=checked(_limit))
    Q: object = field(default=None, metadata=checked(_numbers))
    R: object = field(default=None, metadata=checked(_numbers))
    N: object = field(default=None, metadata=checked(_numbers))
    terminal_weight: object = field(default=None, metadata=checked(_numbers))
    max_change: object = field(default=None, metadata=checked(_limit))
    reference: object = field(default=None, metadata=checked(_shapes))
    min_force_density: object = field(default=0.0, metadata=checked(_numbers))
    max_tension: object = field(default=None, metadata=checked(_limit))
    winches: Winches | None = field(
        default=None,
        metadata=optional(validation.instance, Winches, "make them by Winches(rate=...)"),
    )
    outputs: Sequence[OutputLimit] = field(default=(), metadata=checked(_output_limits))
    string_penalty: float | None = field(default=None, metadata=checked(_penalty))
    load_gain: float | None = field(default=None, metadata=checked(_gain))
    tracked: object = field(default=None, metadata=checked(_numbers))
    tolerance: float = field(
        default=1e-4, metadata=checked(validation.positive_number, "units of an input")
    )
    max_iterations: int | None = field(default=None, metadata=optional(validation.whole_number, 1))
    time_limit: float | None = field(default=None, metadata=checked(_time))
    solver: str | type[QPSolver] = field(default="auto", metadata=checked(_solver))

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        if self.tracked is not None and self.load_gain is None:
            raise ValueError(
                "tracked needs load_gain: it selects what is free of offset under a load"
            )

    @property
    def longest_time(self) -> float:
        """Time for a command, s; inf where there is no limit."""
        return np.inf if self.time_limit is None else self.time_limit


_P = ParamSpec("_P")
_C = TypeVar("_C")
_S = TypeVar("_S")


def from_settings(
    record: Callable[_P, _S],
) -> Callable[
    [Callable[[_C, LinearPlant, _S], None]], Callable[Concatenate[_C, LinearPlant, _P], None]
]:
    """Return a decorator: the constructor takes the arguments of a record in place of the record.

    People, editors and type checkers see them as keyword arguments of the constructor.
    """

    def decorate(
        init: Callable[[_C, LinearPlant, _S], None],
    ) -> Callable[Concatenate[_C, LinearPlant, _P], None]:
        shown = signature(init)
        itself, plant, _ = shown.parameters.values()
        options = signature(record).parameters
        required = [name for name, option in options.items() if option.default is Parameter.empty]

        @wraps(init)
        def from_keywords(self: Any, plant: LinearPlant, **settings: Any) -> None:
            name = type(self).__name__
            for given in settings.keys() - options.keys():
                near = get_close_matches(given, options, n=1)
                meant = f"did you mean {near[0]!r}?" if near else f"expected {', '.join(options)}"
                raise TypeError(f"{name} has no argument {given!r}; {meant}")
            if missing := [option for option in required if option not in settings]:
                example = ", ".join(f"{option}=..." for option in missing)
                raise TypeError(f"{name} needs {' and '.join(missing)}: {name}(plant, {example})")
            init(self, plant, record(**settings))  # type: ignore[call-arg]

        from_keywords.__signature__ = shown.replace(  # type: ignore[attr-defined]
            parameters=[itself, plant, *options.values()]
        )
        return from_keywords  # type: ignore[return-value]

    return decorate


def uses_stages(settings: MPCSettings) -> bool:
    """Return whether programs are solved along the stages, or raise where that cannot be."""
    if settings.solver not in ("auto", "stages"):
        return False
    if settings.solver == "auto":
        return library() is not None
    if missing := absence():
        raise ValueError(
            f"solver is 'stages', which is in the compiled core, but {missing}. Take 'auto' or "
            "'osqp'"
        )
    return True


def make_solver(settings: MPCSettings, form: Sparse, equations: bool = False) -> QPSolver:
    """Return a solver of a sparse program, as it is before the first solve."""
    kind = OSQPSolver if isinstance(settings.solver, str) else settings.solver
    iterations = settings.max_iterations or MOST_ITERATIONS
    return kind(form.P, form.A, settings.tolerance, iterations, equations=equations)


@dataclass(frozen=True, eq=False)
class Design:
    """Data of a program."""

    problem: MPCProblem
    constraints: Constraints
    sampled: Sampled  # what a sample does
    low: FloatArray  # least input, (m,)
    high: FloatArray
    free: BoolArray  # inputs that can go both ways at the operating point, or are not used, (m,)
    regulator_cost: FloatArray  # cost to go of the LQR of all inputs, without bounds
    proven: bool  # whether P is the cost to go of a law that the bounds allow near rest

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def plant_problem(self) -> MPCProblem:
        """The problem with z alone as its state; what weighs ``[z; v_before]`` stays."""
        s, problem = len(self.sampled.transition), self.problem
        cross = problem.cross_weight
        return replace(
            problem,
            transition=self.sampled.transition,
            input_matrix=self.sampled.by_input,
            drift=self.sampled.drift,
            state_weight=problem.state_weight[:s, :s],
            cross_weight=None if cross is None else cross[:s],
        )


def design(plant: LinearPlant, settings: MPCSettings, nonlinear: bool = False) -> Design:
    """Return the data of a program, or raise naming the argument that does not fit the plant.

    What no string reaches and drifts at the operating point, as a structure in the air, a nonlinear
    prediction may reach by the ground: it is left out of the terminal cost.
    """
    states, count = plant.B.shape
    refuse_empty(plant)
    low, high = _command_range(plant, settings)
    natural_Q, natural_R = natural_weights(plant)
    Q, R = settings.Q, settings.R
    state_weight = (
        natural_Q if Q is None else validation.weight_matrix("Q", Q, states, definite=False)
    )
    input_weight = natural_R if R is None else validation.weight("R", R, count, definite=True)
    if input_weight.ndim == 2 and np.count_nonzero(input_weight) == count:
        input_weight = np.diagonal(input_weight)
    winches, sample_time = settings.winches, settings.sample_time
    ramp = winches is not None and winches.ramp
    numbers = (30.0 + 2.0 * states) * count * settings.horizon
    own = settings.N is not None or settings.terminal_weight is not None
    many = not (nonlinear or ramp or own or input_weight.ndim == 2 or count <= 2 * states)
    if not many:
        numbers = 10.0 * count**2
    hint = (
        ". MPC takes more inputs where R is diagonal, N and terminal_weight are not given, winches "
        "are no ramps and states are fewer than half of them: reduce(plant, modes=20)"
    )
    validation.refuse_memory(
        f"plant has {count:,} inputs", numbers, "numbers in the program", 8, hint
    )
    if not nonlinear or plant.model.contacts is None:
        refuse_unreachable(plant)
    else:
        refuse_unreachable(plant, drifting=False)
    level = float(plant.force_density.max()) or float(np.where(np.isinf(high), 1.0, high).max())
    if plant.input != "force_density":
        lengths = plant.model.structure.string_length(plant.nodes)
        lengths = to_commanded_strings(plant, "length", lengths)
        assert plant.rest_length is not None  # there is a law
        level = float((lengths - plant.rest_length).max())
    model = sampled(plant, sample_time, ramp)
    transition, input_matrix = model.augmented
    cross = cross_weight(settings.N, state_weight, input_weight)
    weights = state_weight, input_weight, True
    weight, (gain, _, cost, _) = regulator(plant, transition, input_matrix, *weights, cross)
    added = len(transition) - states
    # What inputs that can go one way only do at the bound is nothing that the law counts on.
    free = np.logical_and(*ways(plant, low, high)) | ~gain.any(axis=1)
    terminal, proven = cost, bool(free.all())
    if settings.terminal_weight is not None:
        terminal, proven = _terminal_weight(settings.terminal_weight, states, added), False
    elif not proven and not many and _hold(plant, free):
        held = None if cross is None else cross * free
        _, (_, _, terminal, _) = regulator(plant, transition, input_matrix * free, *weights, held)
        proven = True
    # The price is relative to the cost of an input one level off.
    assert settings.string_penalty is not None  # the record filled in the default
    penalty = settings.string_penalty * level**2 * least_eigenvalue(input_weight)
    blocks = _row_blocks(plant, settings, penalty)
    if model.ramp:
        blocks = [block.at_sample_ends(added) for block in blocks]
    constraints = Constraints(blocks, states)
    problem = MPCProblem(
        transition=transition,
        input_matrix=input_matrix,
        drift=np.r_[model.drift, np.zeros(added)],
        state_weight=weight,
        input_weight=input_weight,
        terminal_weight=terminal,
        low=low - plant.equilibrium_input,
        high=high - plant.equilibrium_input,
        change=largest_change(
            plant.input, plant.actuation, settings.max_change, winches, sample_time
        ),
        length=settings.horizon,
        level=level,
        feedback=gain,
        rows=constraints.rows(),
        cross_weight=None if cross is None else np.pad(cross, ((0, added), (0, 0))),
        steady=terminal is cost,
    )
    return Design(problem, constraints, model, low, high, free, cost, proven)


def _hold(plant: LinearPlant, free: BoolArray) -> bool:
    """Return whether these inputs alone reach all that all of them reach and that stays."""
    all_left, left = (
        reached_states(one).unreached_pole for one in (plant, replace(plant, B=plant.B * free))
    )
    return bool(lasting(left) == lasting(all_left))


def _terminal_weight(given: object, states: int, added: int) -> FloatArray:
    """Return P of z, or of ``[z; v_previous]``, where so many inputs are added to the state."""
    whole = validation.float_array("terminal_weight", given).shape[:1] == (states + added,)
    size = states + added if whole else states
    matrix = validation.weight_matrix("terminal_weight", given, size, definite=False)
    return np.pad(matrix, (0, states + added - size))


def _command_range(plant: LinearPlant, settings: MPCSettings) -> tuple[FloatArray, FloatArray]:
    if plant.input != "force_density":
        return input_bounds(plant, None, settings.winches)
    return input_bounds(
        plant, settings.max_force_density, settings.winches, settings.min_force_density
    )


def _row_blocks(plant: LinearPlant, settings: MPCSettings, penalty: float) -> list[RowBlock]:
    if plant.drives_bars and (settings.outputs or settings.tracked is not None):
        raise ValueError(
            f"{'outputs' if settings.outputs else 'tracked'} is of nodes or forces of bars, which "
            "MPC does not know as functions of the lengths of bars: leave it out; "
            "winches.shortest and winches.longest limit the lengths"
        )
    outputs = [output_block(plant, limit) for limit in settings.outputs]
    has_strength = np.isfinite(validation.limits("max_tension", settings.max_tension)).any()
    if plant.input == "force_density" and not has_strength:
        return outputs
    blocks, strings = [], string_map(plant, plant.input)
    count = len(plant.commanded.strings)
    if plant.input != "force_density":
        bounds = string_bounds(count, settings.min_force_density, settings.max_force_density)
        high = to_model_strings(plant, "force_density", bounds.high)
        low = to_model_strings(plant, "force_density", bounds.low)
        if low[plant.slack].any():
            i = plant.slack[low[plant.slack].argmax()]
            raise ValueError(
                f"min_force_density is {low[i]:g} N/m for string {i}, which is slack at the "
                "operating point; expected 0 there, or a shape in which it is taut"
            )
        level = float(strings.force_density.max())
        blocks.append(string_block("force_density", strings, low, high, level, penalty))
    if has_strength:
        structure = plant.model.structure
        most = validation.limit_per_member("max_tension", settings.max_tension, count, "string")
        validation.positive("max_tension", most, "tension in N")
        if plant.commanded is not structure:
            most = most[structure.string_parent]
        over = np.flatnonzero(strings.tension > most)
        if len(over):
            i = over[0]
            raise ValueError(
                f"max_tension is {most[i]:g} N for string {i}, which has {strings.tension[i]:g} N "
                "at the operating point; expected at least that"
            )
        level = float(strings.tension.max()) or float(most[np.isfinite(most)].max())
        low = np.full(len(most), -np.inf)
        blocks.append(string_block("tension", strings, low, most, level, penalty))
    return blocks + outputs


def law_in_shape(
    plant: LinearPlant, designed: Design, path: ReferencePreview, time: float
) -> tuple[float, float]:
    """Return how the LQR of the program does in a shape of the reference, on the plant there.

    The rate, 1/s, at which errors grow, negative if they decay; and how far the node that is off
    most comes to rest from its place, m.
    """
    from scipy.linalg import block_diag

    r = plant.degrees_of_freedom
    preview = path.at(np.array([time]))
    q, gamma = preview.reference[0, :r], preview.force_density[0]
    if plant.input == "force_density":
        # The linear plant rests where v balances the change of the shape, as well as it can.
        v = np.asarray(np.linalg.lstsq(plant.B[r:], -plant.A[r:, :r] @ q, rcond=None)[0])
        gamma = gamma + input_matrix(plant, "force_density") @ v
    gamma = np.maximum(gamma, _TAUT * gamma.max())
    operating_point = OperatingPoint(plant.to_nodes(q), gamma, plant.external_force)
    nearby = linearize(plant.model, operating_point, input=plant.input, require_equilibrium=False)
    spread = input_matrix(plant, plant.input)
    model = sampled(replace(nearby, B=nearby.B @ spread), path.sample_time, designed.sampled.ramp)
    transition, by_input = model.augmented
    turn, added = plant.coordinates.project(nearby.basis), len(transition) - 2 * r
    feedback = designed.problem.feedback @ block_diag(turn, turn, np.eye(added))
    closed = transition - by_input @ feedback
    growth = float(np.log(np.abs(np.linalg.eigvals(closed)).max())) / path.sample_time
    drift = np.r_[model.drift, np.zeros(added)]
    off = nearby.basis @ np.linalg.lstsq(np.eye(len(closed)) - closed, drift, rcond=None)[0][:r]
    return growth, float(np.linalg.norm(off.reshape(-1, len(plant.nodes)), axis=1).max())


@dataclass(frozen=True, eq=False, kw_only=True)
class PredictiveLaw:
    """What a predictive controller computes with, except what it remembers."""

    settings: MPCSettings
    load: LoadModel | None
    path: ReferencePreview

    def following(self, reference: object) -> Self:
        """Return the law that follows another reference."""
        settings = replace(self.settings, reference=reference)
        return replace(self, settings=settings, path=self.path.following(reference))


class PredictiveController(Controller):
    """What linear and nonlinear MPC have in common: bounds, horizon, reference and load."""

    _law: PredictiveLaw
    _nonlinear: ClassVar[bool] = False

    def __init__(self, plant: LinearPlant, settings: MPCSettings, designed: Design) -> None:
        super().__init__(
            plant, settings.sample_time, designed.low, designed.high, designed.problem.change
        )
        if not (self._nonlinear and plant.model.contacts is not None):
            warn_of_unreached(self)
        self._longest_time = settings.longest_time
        self._settings = vars(settings)
        self._limits = designed.constraints.blocks
        self._observer: LoadObserver | None = None
        if settings.load_gain is not None:
            response = acceleration_response(plant, settings.sample_time)
            self._observer = load_observer(plant, response, settings.load_gain, settings.tracked)

    def _concerns(self, path: ReferencePreview) -> list[str]:
        """Return what to warn of in a reference, or raise where it is not for this controller."""
        return broken_limits(self.plant, self._limits, path) if self._limits else []

    @property
    def horizon(self) -> int:
        """Number N of samples predicted."""
        return self._law.settings.horizon

    @property
    def load(self) -> FloatArray | None:
        """q̈ laid to an unknown load, m √kg/s², shape (r,); None where none is estimated."""
        return None if self._observer is None else frozen(self._observer.acceleration)

    def follow(self, reference: object) -> None:
        """Follow another reference from now on.

        Parameters
        ----------
        reference : Reference or array_like, shape (d, n), or None
            As in the constructor.

        Raises
        ------
        TypeError, ValueError
            If it does not fit the structure.
        """
        law = self._law.following(reference)
        for text in self._concerns(law.path):
            warn(text, ControlWarning)  # that of the lock is between
        self._law, self._settings = law, vars(law.settings)

    def reference_nodes(self, times: FloatArray) -> FloatArray:
        """See :meth:`Controller.reference_nodes`."""
        return self._law.path.nodes_at(times)

    def reset(self) -> None:
        """Forget the plan, the previous input, the estimated load and the statistics."""
        super().reset()
        if self._observer is not None:
            self._observer.reset()
