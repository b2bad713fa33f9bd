"""Optimal motion between two shapes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import trapezoid

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    every_string,
    inputs_of,
    strings_of,
    sums_by_input,
    through,
)
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, freeze_arrays, frozen
from tenscontrol.dynamics.equation import unpack_states
from tenscontrol.dynamics.evaluator import Function, builds, evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Profile
from tenscontrol.interrupt import keeping
from tenscontrol.optimize.collocation import (
    Collocation,
    DiscreteMotion,
    Instant,
    MotionProgram,
    Solution,
)
from tenscontrol.optimize.motion_end import MotionEnd
from tenscontrol.optimize.motion_guess import end_input, guessed_motion
from tenscontrol.optimize.motion_limits import MotionLimits
from tenscontrol.optimize.motor_states import MotorStates
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.reference import Reference
from tenscontrol.progress import progress_bar
from tenscontrol.shape.demands import Demand, checked_demands
from tenscontrol.shape.force_bounds import refuse_ground
from tenscontrol.shape.held_strings import HeldStrings, held_strings
from tenscontrol.shape.shape_path import path_end, refuse_same
from tenscontrol.shape.target import ShapeTarget, shape_target
from tenscontrol.simulation.health import HealthLimits
from tenscontrol.simulation.motion_functions import by_node
from tenscontrol.simulation.simulate import simulate
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.statics.prestress import Prestress
from tenscontrol.status import Status
from tenscontrol.structure.bar_geometry import restore_bar_lengths
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import free_coordinates
from tenscontrol.tables import aligned
from tenscontrol.warn import warn

# What can be least, beside a cost of the user.
COSTS = ("time", "energy", "effort")

# Of motions of least time or work, the one of least effort: its weight beside the cost.
_TIE = 1e-3

# Durations of the guess that are tried one after the other, as parts of the first.
_SLOWER = (1.0, 2.0, 10.0)

# Tolerance of the replay, as a part of that of the goal; shapes in each interval of a reference.
_REPLAY, _SHAPES = 1e-3, 4

# The least tolerance of the goal.
_FINEST = 1e-10

# More intervals, or halvings of them, are refused.
_MOST_INTERVALS, _MOST_REFINEMENTS = 10_000, 10

# Strings with less than this part of the largest γ are slack. Ways below the second part of the
# size are none.
_SLACK, _NO_WAY = 1e-9, 1e-6

# Changes of the cost below this part of its size are none.
_NO_COST = 1e-6

# Statuses with a motion that obeys the equation of motion.
_PLANNED = (Status.OK, Status.INACCURATE)

_ADVICE = {
    Status.INFEASIBLE: "Give more time, faster winches or wider limits, or a nearer goal",
    Status.OUT_OF_ITERATIONS: "Give more iterations, fewer intervals or a nearer goal",
    Status.BAD_DATA: "Give functions that are finite and smooth on the way, or other limits",
    Status.INACCURATE: "Give more intervals or refinements, or a larger tolerance",
}


class OptimalMotionWarning(RuntimeWarning):
    """No motion was planned, its replay misses the goal, or its cost changes with the mesh."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """One of the meshes that were solved, each of half the intervals' length of the one before.

    Attributes
    ----------
    intervals : int
        Of equal length.
    iterations : int
        Of IPOPT.
    status : Status
    cost : float
        What was least, in its unit: s, J, or that of the function that was given.
    goal_miss, end_speed : float
        Largest distance of a node from the goal at the end of the replay, m, and largest speed
        there, m/s; NaN where nothing was solved.
    """

    intervals: int
    iterations: int
    status: Status
    cost: float
    goal_miss: float
    end_speed: float


@dataclass(frozen=True, eq=False, repr=False)
class OptimalMotion:
    """A motion of least cost from one shape to another. Made by :func:`optimal_motion`.

    Attributes
    ----------
    model : Model
    start, goal : Prestress
        Equilibria at both ends.
    input : {"rest_length", "force_density"}
    actuation : Actuation
        Which strings are driven.
    minimize : str
        ``"time"``, ``"energy"``, ``"effort"``, or the name of the function that was given.
    status : Status
        ``OK``: planned, the replay meets the goal, and the cost has settled. ``INACCURATE``:
        planned, but the replay misses the goal, or the last two meshes differ in cost, by more than
        the tolerances. Any other: nothing was planned.
    message : str
        What ended it, and what to try.
    time : ndarray, shape (K + 1,)
        Ends of the intervals, s.
    nodes, velocities : ndarray, shape (d, n, K + 1)
        The plan at these times, m and m/s.
    force_density, rest_length : ndarray, shape (α, K + 1)
        γ of the plan, N/m, and rest lengths, m (None where γ is the input); of an input that jumps
        between intervals, the value after the jump.
    cost : float
        Duration, s; work, J; effort; or the integral of the function that was given.
    cost_change : float
        Between the last two meshes with a motion, as a part of the cost; NaN if there is one alone.
    run : Trajectory or None
        The replay by :func:`simulate`; None where nothing was planned, and its figures are NaN.
    goal_miss, end_speed : float
        Of the replay at its end: largest distance of a node from the goal, m, of a structure that
        is free to move after the rigid-body motion that aligns both, and largest speed, m/s.
    least_force_density, peak_tension : float
        Of all strings over the replay, N/m and N.
    energy : float
        Work that the motors give over the replay, J, without what they take back.
    meshes : tuple of Mesh
        What was solved, coarse to fine.
    guess : {"path", "straight line"}
        Where the search began.
    """

    model: Model
    start: Prestress
    goal: Prestress
    input: str
    actuation: Actuation
    minimize: str
    status: Status
    message: str
    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    force_density: FloatArray
    rest_length: FloatArray | None
    cost: float
    cost_change: float
    run: Trajectory | None
    goal_miss: float
    end_speed: float
    least_force_density: float
    peak_tension: float
    energy: float
    meshes: tuple[Mesh, ...]
    guess: str
    _motion: DiscreteMotion
    _end: MotionEnd

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def structure(self) -> Structure:
        """The structure of the model."""
        return self.model.structure

    @property
    def duration(self) -> float:
        """Duration of the motion, s."""
        return float(self.time[-1])

    @property
    def rate(self) -> FloatArray:
        """Mean rate of the input in each interval, m/s or N/m/s, shape (α, K).

        It is constant in the interval, unless motors have inertia.
        """
        return frozen((self._motion.end - self._motion.begin) / np.diff(self.time))

    @property
    def profile(self) -> Profile:
        """The input over time: for ``simulate(model, ..., rest_length=motion.profile)``.

        Raises ValueError if nothing was planned.
        """
        self._refuse_unplanned()
        return _profile(self._motion, self.input, self.goal.force_density)

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return nodes, m, and velocities, m/s, of the plan at a time, shape (d, n) each.

        Parameters
        ----------
        time : float
            s; before the start and after the end the plan stands still.

        Raises
        ------
        TypeError, ValueError
            If it is not one finite number, or nothing was planned.
        """
        self._refuse_unplanned()
        share = min(max(validation.number("time", time, "s") / self.duration, 0.0), 1.0)
        states = np.concatenate(self._motion.at(np.array([share])))
        nodes, velocities = unpack_states(self.structure, states)
        return frozen(nodes[:, :, 0]), frozen(velocities[:, :, 0] * (0.0 < share < 1.0))

    def reference(self, times: object = None) -> Reference:
        """Return the motion as the reference of a controller, as in ``MPC(..., reference=...)``.

        Parameters
        ----------
        times : array_like, shape (K,), optional
            s, ascending; four shapes in each interval if not given. Before the start and after the
            end it stands still.

        Returns
        -------
        Reference
            With the force densities of the motion, and bars of exact lengths.

        Raises
        ------
        TypeError, ValueError
            If the times are not finite numbers or do not ascend, or nothing was planned.
        """
        self._refuse_unplanned()
        count = _SHAPES * (len(self.time) - 1) + 1
        instants = np.linspace(0.0, self.duration, count)
        if times is not None:
            instants = validation.float_array("times", times)
            if instants.ndim != 1 or not len(instants):
                raise ValueError(
                    f"times has shape {instants.shape}, expected (K,) with K at least 1"
                )
        shares = np.clip(instants / self.duration, 0.0, 1.0)
        nodes, _ = unpack_states(self.structure, np.concatenate(self._motion.at(shares)))
        exact = [restore_bar_lengths(self.structure, shape) for shape in np.moveaxis(nodes, 2, 0)]
        gamma = np.array(
            [np.interp(shares * self.duration, self.time, row) for row in self.force_density]
        )
        return Reference(instants, np.stack(exact, axis=-1), np.maximum(gamma, 0.0))

    def goal_distance(self, nodes: object) -> FloatArray:
        """Return how far the farthest node is from the goal, m, shape (T,), as :attr:`goal_miss`.

        Parameters
        ----------
        nodes : array_like, shape (d, n, T)
            m.
        """
        d, n = self.structure.nodes.shape
        shapes = validation.float_array("nodes", nodes)
        if shapes.ndim != 3 or shapes.shape[:2] != (d, n):
            raise ValueError(f"nodes has shape {shapes.shape}, expected ({d}, {n}, T)")
        return np.array([self._end.distance(shape) for shape in np.moveaxis(shapes, 2, 0)])

    def table(self) -> str:
        """Return the meshes that were solved, as text."""
        rows = [
            [str(mesh.intervals), str(mesh.iterations), str(mesh.status),
             f"{mesh.cost:.6g}", f"{mesh.goal_miss:.2e}", f"{mesh.end_speed:.2e}"]
            for mesh in self.meshes
        ]  # fmt: skip
        head = ["intervals", "iterations", "status", "cost", "goal missed, m",
                "speed at the end, m/s"]  # fmt: skip
        return aligned(head, rows)

    def summary(self) -> str:
        """Return what was found, as text."""
        if self.run is None:
            return f"{self.status}: {self.message}\n{self.table()}"
        lines = [
            f"{self.status}: {self.message}",
            f"least {self.minimize} {self.cost:.6g}, duration {self.duration:.6g} s",
            f"replay: goal missed by {self.goal_miss:.2e} m, {self.end_speed:.2e} m/s at the end",
            f"least force density {self.least_force_density:.4g} N/m, peak tension "
            f"{self.peak_tension:.4g} N, work of the motors {self.energy:.4g} J",
            self.table(),
        ]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return (
            f"OptimalMotion({self.status}: {self.minimize} {self.cost:.5g}, {self.duration:.4g} s, "
            f"goal missed by {self.goal_miss:.1e} m)"
        )

    def _refuse_unplanned(self) -> None:
        if self.status not in _PLANNED:
            raise ValueError(f"no motion was planned: {self.message}")


def optimal_motion(
    model: Model,
    start: ShapeTarget | Prestress,
    goal: ShapeTarget | Prestress | Demand,
    *,
    minimize: str | Callable[..., Any] = "time",
    duration: float | None = None,
    input: str | None = None,
    winches: Winches | None = None,
    min_force_density: object = 0.0,
    max_force_density: object = None,
    max_tension: object = None,
    max_power: object = None,
    min_clearance: float | None = None,
    obstacles: Callable[[Any], Any] | None = None,
    plant: LinearPlant | None = None,
    intervals: int = 10,
    tolerance: float = 1e-4,
    cost_tolerance: float | None = 1e-2,
    refinements: int = 5,
    most_iterations: int = 200,
    progress: bool = False,
) -> OptimalMotion:
    """Return the motion of least time, work or effort from rest in one shape to rest in another.

    All strings stay taut. The plan is replayed by :func:`simulate`, which knows nothing of it, and
    its intervals are halved until the replay ends at the goal and the cost has settled.

    Parameters
    ----------
    model : Model
        Without ground. Its weights and built-in load act.
    start : ShapeTarget or Prestress
        An equilibrium of this model.
    goal : ShapeTarget, Prestress, Demand or sequence of Demand
        The equilibrium at the end; of demands, as :class:`NodesAt`, the one that
        :func:`shape_target` finds nearest to the start, with its level of prestress.
    minimize : {"time", "energy", "effort"} or callable
        ``"energy"``: the work that motors give, J; what they take back is lost. ``"effort"``: of
        rest lengths, ∫ Σ (rate)² dt over the winches, m²/s; of force densities, ∫ Σ T² dt over the
        driven strings, N² s. A function
        ``(nodes, velocities, input, rate) -> cost`` in CasADi is integrated over the time: of the
        nodes, m, and their velocities, m/s, shape (d, n), the input of the strings and its rate,
        shape (α, 1).
    duration : float, optional
        s; found if not given, as the least one is, or that of least cost of a function. Needed for
        ``"energy"`` and ``"effort"``.
    input : {"rest_length", "force_density"}, optional
        What the actuators set: rest lengths go on without jumps, at a constant rate in each
        interval, or as motors with inertia turn; γ may jump. That of ``plant`` if it is given; else
        the rest length if the model has a string law, else γ.
    winches : Winches, optional
        Their rates, range and motors: torque holds at any time, without the help of a brake, and
        turns what inertia there is. Where γ is the input, the rate is that at which strings get
        shorter or longer.
    min_force_density, max_force_density : float or array_like, shape (α,), optional
        Bounds of γ on the way, N/m.
    max_tension : float or array_like, shape (α,), optional
        N.
    max_power : float or array_like, shape (α,), optional
        Largest power that each motor gives, W.
    min_clearance : float, optional
        Least distance between the axes of two bars that share no node, m. Not in the plane, where
        bars lie in layers.
    obstacles : callable, optional
        ``nodes -> expressions`` in CasADi that are at least 0, m, of the nodes, shape (d, n).
    plant : LinearPlant, optional
        Of this model, made with ``actuated``: its passive strings keep the rest lengths, or force
        densities, that they have in both ends; strings that share a winch move by their ratios, and
        limits of the winch are the narrowest of its strings. All strings are driven if not given.
    intervals : int
        Of equal length, to begin with.
    tolerance : float
        How far a node may be from the goal at the end of the replay, as a part of the size of the
        structure, and how fast, as a part of that size in the duration.
    cost_tolerance : float or None
        By how much the cost may differ between the last two meshes, as a part of it. A mesh alone,
        as with ``refinements=0``, is not judged. None: the goal alone counts.
    refinements : int
        How often the intervals are halved at most.
    most_iterations : int
        Of IPOPT on each mesh.
    progress : bool

    Returns
    -------
    OptimalMotion

    Raises
    ------
    ShapeError
        If no shape meets the demands.
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit; an end breaks a limit, or has a slack
        string while rest lengths are the input; or motors have lag or backlash, or some of them
        inertia and others not, or any while force densities are the input.

    Warns
    -----
    OptimalMotionWarning
        If no motion was planned, its replay misses the goal, or its cost has not settled. The
        message says which, and which limit stands against a motion.
    InterruptionWarning
        If Ctrl-C ended it: what the finished meshes gave is returned.

    Notes
    -----
    Direct collocation at Gauss points (Hairer, Lubich & Wanner 2006, II.1.3), two in an
    interval: of order 4. IPOPT solves it with exact sparse derivatives. Gauss points keep bar
    lengths and momenta exactly (IV.2.1). The optimum is a local one, near the guess: the path of
    :func:`shape_path` where there is one. Iterations are the same in each run.

    Of several motions of least time or work it is that of least effort: a thousandth of the effort
    is least beside the cost, and is no part of ``cost``.

    Examples
    --------
    The arm lifts its tip by 10 cm:

    >>> import tenscontrol as tc
    >>> arm = tc.library.arm()
    >>> model = tc.Model(arm, strings=tc.LinearStrings(stiffness=500.0, damping=2.0))
    >>> rest = tc.prestress(arm, min_force_density=50.0)
    >>> up = tc.NodesAt([5], arm.nodes[:, [5]] + [[0.0], [0.1]])
    >>> motion = tc.optimal_motion(model, rest, up, winches=tc.Winches(rate=0.8), intervals=10)
    >>> str(motion.status), motion.duration < 0.2, motion.goal_miss < 1e-4
    ('ok', True, True)
    >>> run = tc.simulate(model, 0.3, rest_length=motion.profile)
    """
    validation.instance("model", model, Model, "make one by Model(structure)")
    refuse_ground(model)
    kind = validation.choice(
        "input",
        _usual_input(model, plant) if input is None else input,
        ("rest_length", "force_density"),
    )
    if kind == "rest_length" and model.strings is None:
        raise ValueError(
            "input is 'rest_length', but the model has no law of strings: make it by "
            "Model(structure, strings=...), or give input='force_density'"
        )
    held = held_strings(model, plant)
    if held is not None and held.input != kind:
        raise ValueError(
            f"input is {kind!r}, but that of plant is {held.input!r}: give one of both"
        )
    if winches is not None:
        validation.instance("winches", winches, Winches, "make them by Winches(rate=...)")
    if min_clearance is not None and model.structure.dimension == 2:
        raise ValueError("min_clearance is for bars in space; in the plane they lie in layers")
    intervals = validation.whole_number("intervals", intervals, 2, _MOST_INTERVALS)
    tolerance = validation.positive_number("tolerance", tolerance, "parts of the size", 1.0)
    if tolerance < _FINEST:
        raise ValueError(
            f"tolerance is {tolerance:g}, expected at least {_FINEST:g}: a replay that is a "
            "thousand times as accurate comes up to double precision there"
        )
    if cost_tolerance is not None:
        cost_tolerance = validation.positive_number(
            "cost_tolerance", cost_tolerance, "parts of the cost", 1.0
        )
    refinements = validation.whole_number("refinements", refinements, 0, _MOST_REFINEMENTS)
    most_iterations = validation.whole_number("most_iterations", most_iterations, 1)
    duration = _checked_duration(minimize, duration)
    begin = path_end(model, "start", start)
    level = float(begin.force_density.max()) or 1.0
    driven = _driven(model, begin, kind, held)
    limits = MotionLimits(
        model, driven, winches, min_force_density, max_force_density, max_tension, max_power,
        min_clearance, obstacles, level,
    )  # fmt: skip
    _refuse_end(model, limits, driven, "start", begin)
    if not isinstance(goal, ShapeTarget | Prestress):
        demands = checked_demands("goal", goal, model.structure)
        goal = _target(model, begin, demands, limits, winches, plant)
    ends = begin, path_end(model, "goal", goal)
    refuse_same(model, *ends)
    _refuse_end(model, limits, driven, "goal", ends[1])
    limits.keep_taut(ends)
    planner = _Planner(
        model, ends, kind, minimize, duration, limits, winches, plant, tolerance, cost_tolerance
    )
    with progress_bar(1.0 + refinements, progress, "planning", "meshes") as report:
        return planner.run(intervals, refinements, most_iterations, report)


def _checked_duration(minimize: object, duration: float | None) -> float | None:
    if callable(minimize):
        meaning = "(nodes, velocities, input, rate) -> cost per second"
        validation.function("minimize", minimize, meaning, 4)
    else:
        validation.choice("minimize", minimize, COSTS)
    if duration is not None:
        if minimize == "time":
            raise ValueError(
                "duration is given, but the least one is asked for: leave it out, or minimize "
                "'energy' or 'effort'"
            )
        return validation.positive_number("duration", duration, "s")
    if minimize in ("energy", "effort"):
        raise ValueError(
            f"expected duration, s: a motion of least {minimize} takes as long as it may"
        )
    return None


def _usual_input(model: Model, plant: LinearPlant | None) -> str:
    if plant is not None:
        validation.instance("plant", plant, LinearPlant, "make one by linearize(..., actuated=...)")
        return plant.input
    return "force_density" if model.strings is None else "rest_length"


def _driven(model: Model, begin: Prestress, input: str, held: HeldStrings | None) -> HeldStrings:
    """Return which strings are driven, where the passive ones have the values of the start."""
    if held is None:
        return HeldStrings(every_string(len(model.structure.strings)), input)
    return HeldStrings(through(held.actuation, end_input(model, begin, input)), input)


def _target(
    model: Model, begin: Prestress, demands: Sequence[Demand], limits: MotionLimits,
    winches: Winches | None, plant: LinearPlant | None,
) -> ShapeTarget:  # fmt: skip
    """Return the equilibrium that meets demands, at the level of prestress of the start."""
    groups = model.structure.string_groups
    alike = [i for i, group in enumerate(groups) if group == groups[0]]
    bounds = limits.bounds
    return shape_target(
        model,
        demands,
        force_density=float(begin.force_density[alike].mean()) or None,
        min_force_density=bounds.low,
        max_force_density=bounds.high,
        winches=None if model.strings is None else winches,
        start=begin.structure.nodes,
        place="centre",
        plant=plant,
    )


def _refuse_end(
    model: Model, limits: MotionLimits, driven: HeldStrings, name: str, rest: Prestress
) -> None:
    gamma = rest.force_density
    limits.bounds.refuse_outside(name, gamma)
    slack = np.flatnonzero(gamma <= _SLACK * gamma.max())
    if driven.input == "rest_length" and len(slack):
        raise ValueError(
            f"{name} has slack strings, {slack.tolist()}, but strings stay taut on the way: make "
            "it by shape_target(..., min_force_density=...) or prestress(..., "
            "min_force_density=...)"
        )
    if not driven.actuation.is_whole:
        driven.refuse_other(name, end_input(model, rest, driven.input))
    limits.refuse_end(name, rest)


class _Planner:
    """Solves one mesh after the other, each from what the one before found."""

    def __init__(
        self, model: Model, ends: tuple[Prestress, Prestress], input: str,
        minimize: str | Callable[..., Any], duration: float | None, limits: MotionLimits,
        winches: Winches | None, plant: LinearPlant | None, tolerance: float,
        cost_tolerance: float | None,
    ) -> None:  # fmt: skip
        self._model, self._ends, self._input, self._limits = model, ends, input, limits
        self._minimize, self._tolerance = minimize, tolerance
        self._cost_tolerance = cost_tolerance
        structure = model.structure
        self._size = structure.size
        guess, self._kind = guessed_motion(
            model, ends, input, winches, plant, duration, self._least_duration(duration)
        )
        self._guess = _with_inputs(guess, partial(inputs_of, limits.actuation))
        self._motors = None if limits.inertia is None else MotorStates(limits, ends)
        if self._motors is not None:
            self._guess = self._motors.guess(self._guess)
        self._duration, self._time = duration, self._guess.duration
        self._end = MotionEnd(model, ends[1].structure.nodes, self._size, self._size / self._time)
        program = self._made()
        self._program = program if self._motors is None else self._motors.program(program)
        self._meshes = list[Mesh]()
        self._best: tuple[Solution, Trajectory | None, Mesh] | None = None

    def _least_duration(self, duration: float | None) -> float:
        """Return the time of a mass on a rail over the way under all the tension at rest, s.

        Or what the slowest winch needs, by its rate and its inertia, if it is longer.
        """
        if duration is not None:
            return duration
        structure = self._model.structure
        first, last = (rest.structure.nodes for rest in self._ends)
        way = float(np.linalg.norm(last - first, axis=0).max())
        mass = float(structure.bar_mass.sum() + structure.point_mass[structure.free].sum())
        force = max(
            float((rest.force_density * rest.structure.string_length()).sum())
            for rest in self._ends
        )
        limits = self._limits
        turned = np.abs(np.subtract(*(self._end_input(rest) for rest in self._ends)))
        squared = mass * max(way, _NO_WAY * self._size) / force
        if limits.inertia is not None:
            squared = max(squared, float((limits.inertia * turned / limits.pull).max()))
        return max(2 * float(np.sqrt(squared)), float((turned / limits.rate).max()))

    @builds
    def _made(self) -> MotionProgram:
        model, limits, count = self._model, self._limits, len(self._limits.actuation.lead)
        structure = model.structure
        equation = model.equation(self._input, form="flat")
        half = equation.states // 2
        places, velocities, u = (
            ca.SX.sym(name, size) for name, size in (("n", half), ("v", half), ("u", count))
        )
        taut = np.ones(equation.switches)
        slope = equation.slope(ca.vertcat(places, velocities), limits.strings(u), taut)[half:]
        ends = None
        if self._input == "rest_length":
            ends = np.array([self._end_input(rest) for rest in self._ends])
        return MotionProgram(
            acceleration=Function("acceleration", [places, velocities, u], [slope]),
            limits=limits.rows,
            cost_rate=self._cost_rate,
            tie_rate=self._tie_rate,
            end=self._end.rows,
            start=free_coordinates(structure, self._ends[0].structure.nodes),
            input_range=limits.input_range,
            rate_limit=limits.rate,
            ends=ends,
            duration=self._duration,
            power=(lambda now: limits.state(now).power) if self._minimize == "energy" else None,
            size=self._size,
            time=self._time,
            unit=self._size if ends is not None else limits.level,
            watt=self._watt(),
            price=self._price(),
        )

    def _watt(self) -> float:
        """Return the size of a power, W."""
        return float(self._limits.level * self._size**2 / self._time)

    def _price(self) -> float:
        """Return the size of the cost."""
        if self._minimize == "effort":
            return self._time * float(np.sum(np.square(self._usual())))
        sizes = {"time": self._time, "energy": self._watt() * self._time}
        return sizes.get(self._minimize, 1.0) if isinstance(self._minimize, str) else 1.0

    def _cost_rate(self, now: Instant) -> Any:
        """Return what an instant costs in a second."""
        if self._minimize == "time":
            return ca.SX(1)
        if self._minimize == "effort":
            return self._effort(now, 1.0)
        if self._minimize == "energy":
            return ca.SX(0)
        assert callable(self._minimize)  # checked
        state = self._limits.state(now)
        value = self._minimize(state.nodes, state.velocities, state.input, state.input_rate)
        if isinstance(value, int | float | ca.DM):
            value = ca.SX(value)
        if not isinstance(value, ca.SX) or value.numel() != 1:
            raise validation.wrong_kind(
                "what minimize returns", value, "one number in CasADi, as ca.sumsqr(velocities)"
            )
        return value

    def _tie_rate(self, now: Instant) -> Any:
        """Return a part of the effort: time and work leave many inputs open."""
        if self._minimize not in ("time", "energy"):
            return ca.SX(0)
        usual = self._usual()
        weight = _TIE * self._price() / self._time / len(usual)
        return weight * self._effort(now, ca.DM(usual))

    def _effort(self, now: Instant, unit: Any) -> Any:
        values = now.rate
        if self._input == "force_density":
            state = self._limits.state(now)
            values = (state.input * state.length)[self._limits.actuation.driven.tolist()]
        return ca.sumsqr(values / unit)

    def _usual(self) -> FloatArray:
        """Return the size of a rate of each winch, or of a tension of each driven string."""
        if self._input == "force_density":
            count = len(self._limits.actuation.driven)
            return np.full(count, self._limits.level * self._size)
        first, last = (self._end_input(rest) for rest in self._ends)
        change = max(float(np.abs(last - first).max()), _NO_WAY * self._size) / self._time
        rate = self._limits.rate
        return np.where(np.isfinite(rate), rate, change)

    def _end_input(self, rest: Prestress) -> FloatArray:
        return inputs_of(self._limits.actuation, end_input(self._model, rest, self._input))

    def _of_strings(self, motion: DiscreteMotion) -> DiscreteMotion:
        """Return a motion of the program with what its inputs are to the strings."""
        if self._motors is not None:
            motion = self._motors.wound(motion)
        return _with_inputs(motion, partial(strings_of, self._limits.actuation))

    # ---- meshes ----

    def run(
        self, intervals: int, refinements: int, most: int, report: Callable[[float], None]
    ) -> OptimalMotion:
        """Return the motion of the first mesh that is fine enough, or of the last."""
        guess = self._guess
        with keeping("meshes solved, their motion is returned", lambda: len(self._meshes)):
            for number in range(refinements + 1):
                solution, run = self._solved(guess, intervals, most)
                report(number + 1.0)
                if run is None:
                    # IPOPT that loses its way on one first mesh finds it on another.
                    is_lost = solution.status is Status.OUT_OF_ITERATIONS
                    if number or not is_lost:
                        break
                elif (number or self._cost_tolerance is None) and not self._shortfall():
                    break
                else:
                    guess = solution.motion
                intervals *= 2
        return self._result()

    def _solved(
        self, guess: DiscreteMotion, intervals: int, most: int
    ) -> tuple[Solution, Trajectory | None]:
        """Return what a mesh gives, with its replay; a free duration is tried from slower guesses.

        One that is as short as rates allow leaves IPOPT no room to begin in.
        """
        mesh = Collocation(self._program, intervals)
        tries = _SLOWER if self._duration is None else _SLOWER[:1]
        for slower in tries:
            solution = mesh.solve(_slowed(guess, slower), most)
            if solution.status in _PLANNED:
                break
        run, miss = None, (np.nan, np.nan)
        if solution.status in _PLANNED:
            run = self._replayed(solution.motion)
            speed = np.linalg.norm(run.velocities[:, :, -1], axis=0).max()
            miss = self._end.distance(run.nodes[:, :, -1]), float(speed)
        mesh_of = Mesh(intervals, solution.iterations, solution.status, solution.cost, *miss)
        self._meshes.append(mesh_of)
        if self._best is None or run is not None or self._best[1] is None:
            self._best = solution, run, mesh_of
        return solution, run

    def _shortfall(self) -> str:
        """Return what the motion lacks, empty if nothing. The cost of one mesh is not judged."""
        assert self._best is not None  # a mesh was solved
        motion, mesh = self._best[0].motion, self._best[2]
        off = self._tolerance * self._size
        if mesh.goal_miss > off or mesh.end_speed > off / motion.duration:
            return (
                f"the replay misses the goal by {mesh.goal_miss:.2g} m at {mesh.end_speed:.2g} m/s "
                f"on {mesh.intervals} intervals"
            )
        change = self._cost_change()
        if self._cost_tolerance is None or len(self._meshes) == 1 or change <= self._cost_tolerance:
            return ""
        if np.isnan(change):
            return "the cost is that of one mesh, and the other was not solved"
        return (
            f"the cost changed by {100 * change:.2g} % by the last mesh, {mesh.intervals} intervals"
        )

    def _cost_change(self) -> float:
        """Return the change of the cost by the last mesh with a motion, NaN of one alone."""
        costs = [mesh.cost for mesh in self._meshes if mesh.status in _PLANNED]
        if len(costs) < 2:
            return np.nan
        return abs(costs[-1] - costs[-2]) / max(abs(costs[-1]), _NO_COST * self._program.price)

    def _replayed(self, motion: DiscreteMotion) -> Trajectory:
        profile = _profile(self._of_strings(motion), self._input, None)
        inputs: dict[str, Any] = {self._input: profile}
        return simulate(
            self._model,
            motion.duration,
            self._ends[0].structure.nodes,
            method="dop853",
            tolerance=self._tolerance * _REPLAY,
            limits=HealthLimits(crossings=None),
            error="none",
            **inputs,
        )

    def _result(self) -> OptimalMotion:
        assert self._best is not None  # `run` has solved a mesh, or raised
        solution, run, last = self._best
        status, change = Status.OK, self._cost_change()
        message = "the replay ends at the goal"
        if np.isfinite(change):
            message += f", and the last mesh changed the cost by {100 * change:.2g} %"
        if run is None:
            status, worst = solution.status, next(iter(solution.violations.items()))
            message = (
                f"IPOPT ended with {solution.message!r}, {worst[0]} violated by {worst[1]:.2g} of "
                f"its scale. {_ADVICE.get(status, 'Give another goal or limits')}"
            )
        elif shortfall := self._shortfall():
            status = Status.INACCURATE
            message = f"{shortfall}. {_ADVICE[status]}"
        if status is not Status.OK:
            warn(f"{status}: {message}", OptimalMotionWarning)
        motion = self._of_strings(solution.motion)
        states = np.concatenate([motion.places, motion.velocities])
        nodes, velocities = unpack_states(self._model.structure, states)
        inputs = np.column_stack([motion.begin, motion.end[:, -1]])
        gamma, wound = inputs, None
        if self._input == "rest_length":
            gamma, wound = self._force_densities(nodes, velocities, inputs), inputs
        name = self._minimize
        return OptimalMotion(
            model=self._model,
            start=self._ends[0],
            goal=self._ends[1],
            input=self._input,
            actuation=self._limits.actuation,
            minimize=name if isinstance(name, str) else getattr(name, "__name__", "cost"),
            status=status,
            message=message,
            time=np.linspace(0.0, motion.duration, inputs.shape[1]),
            nodes=nodes,
            velocities=velocities,
            force_density=gamma,
            rest_length=wound,
            cost=last.cost,
            cost_change=change,
            run=run,
            goal_miss=last.goal_miss,
            end_speed=last.end_speed,
            meshes=tuple(self._meshes),
            guess=self._kind,
            **_figures(run, motion, self._input, self._limits.actuation, solution.motion),
            _motion=motion,
            _end=self._end,
        )

    def _force_densities(
        self, nodes: FloatArray, velocities: FloatArray, rest_length: FloatArray
    ) -> FloatArray:
        law = self._model.strings
        assert law is not None  # the rest length is the input
        motion = self._model.of_all_nodes("string_motion")
        lengths, rates = evaluate_columns(motion, np.vstack([by_node(nodes), by_node(velocities)]))
        pairs = zip(lengths.T, np.maximum(rest_length, 0.0).T, rates.T, strict=True)
        return np.column_stack([law.force_density(*instant) for instant in pairs])


def _figures(
    run: Trajectory | None, motion: DiscreteMotion, input: str, actuation: Actuation,
    solved: DiscreteMotion,
) -> dict[str, float]:  # fmt: skip
    """Return what the strings and motors did over a replay."""
    if run is None:
        return dict.fromkeys(("least_force_density", "peak_tension", "energy"), np.nan)
    model = run.model
    states = np.vstack([by_node(run.nodes), by_node(run.velocities)])
    lengths, rates = evaluate_columns(model.of_all_nodes("string_motion"), states)
    tension = run.force_density * lengths
    power = -tension * rates
    if input == "rest_length":
        assert run.rest_length is not None  # which was given
        k = np.searchsorted(_times(motion), run.time, side="right") - 1
        k = np.clip(k, 0, motion.begin.shape[1] - 1)
        wound = ((motion.end - motion.begin) / np.diff(_times(motion)))[:, k]
        forces = evaluate_columns(model.of_all_nodes("winding"), states, run.rest_length, wound)[1]
        power = -forces * wound
    by_winch = sums_by_input(actuation, power)
    if motion.rates is not None:  # motors have inertia, and their forces are the input
        forces = solved.inputs_at(run.time / motion.duration)
        by_winch = -forces * inputs_of(actuation, _profile(motion, input, None).rate(run.time))
    return {
        "least_force_density": float(run.force_density.min()),
        "peak_tension": float(tension.max()),
        "energy": float(trapezoid(np.maximum(by_winch, 0.0), run.time, axis=1).sum()),
    }


def _with_inputs(
    motion: DiscreteMotion, convert: Callable[[FloatArray], FloatArray]
) -> DiscreteMotion:
    """Return the same motion with its inputs converted, by a map that may have an offset."""
    rates = motion.rates
    if rates is not None:
        rates = convert(rates) - convert(0 * rates)
    return replace(motion, begin=convert(motion.begin), end=convert(motion.end), rates=rates)


def _times(motion: DiscreteMotion) -> FloatArray:
    return np.linspace(0.0, motion.duration, motion.begin.shape[1] + 1)


def _profile(motion: DiscreteMotion, input: str, after: FloatArray | None) -> Profile:
    """Return the input over time; γ jumps to what holds the goal in the end, if that is given."""
    times = _times(motion)
    if input == "rest_length":
        lengths = np.column_stack([motion.begin, motion.end[:, -1]])
        return Profile(times, lengths, "linear" if motion.rates is None else "cubic", motion.rates)
    both = np.stack([motion.begin, motion.end], axis=2).reshape(len(motion.begin), -1)
    twice = np.repeat(times, 2)[1:-1]
    if after is None:
        return Profile(twice, both)
    return Profile(np.append(twice, times[-1]), np.column_stack([both, after]))


def _slowed(motion: DiscreteMotion, factor: float) -> DiscreteMotion:
    """Return the same motion so many times slower."""
    return replace(
        motion,
        duration=motion.duration * factor,
        velocities=motion.velocities / factor,
        stage_velocities=motion.stage_velocities / factor,
    )
