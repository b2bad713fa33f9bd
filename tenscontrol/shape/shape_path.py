"""A path between two shapes through equilibria, timed for the winches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.dynamics.coordinates import coordinates
from tenscontrol.dynamics.model import Model
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.linearize import OperatingPoint, linearize
from tenscontrol.plant.reference import STRINGS_MOVE_NO_CENTRE, Reference
from tenscontrol.shape.equilibrium_path import (
    Continuation,
    PathError,
    TimedPath,
    Waypoint,
    rest_at,
)
from tenscontrol.shape.force_bounds import checked_bounds, drive_strokes, refuse_ground
from tenscontrol.shape.held_strings import HeldStrings, shape_drives
from tenscontrol.shape.nonlinear_program import ShapeProblem
from tenscontrol.shape.shape_search import STIFF
from tenscontrol.shape.target import (
    PLACES,
    ShapeTarget,
    moved_as_one_body,
    with_lengths_of,
)
from tenscontrol.statics.prestress import Prestress
from tenscontrol.string_bounds import refuse_out_of_range
from tenscontrol.structure.bar_clearance import BarMotion, bar_distances
from tenscontrol.structure.bar_geometry import put_on_lengths, refuse_wrong_bar_lengths
from tenscontrol.structure.structure import same_members
from tenscontrol.structure.supports import (
    free_coordinates,
    left_by_supports,
    refuse_moved_supports,
    rigid_basis,
    rigid_motions,
)
from tenscontrol.tables import percent
from tenscontrol.viewable import Viewable


@dataclass(frozen=True, eq=False)
class ShapePath(Viewable):
    """Equilibria over time from one shape to another. Made by :func:`shape_path`.

    Attributes
    ----------
    model : Model
    time : ndarray, shape (T,)
        s, from 0, evenly spaced.
    nodes, velocities : ndarray, shape (d, n, T)
        m and m/s; each shape is an equilibrium, the motion is at rest at both ends.
    force_density : ndarray, shape (α, T)
        γ, N/m.
    rest_length, rest_length_rate : ndarray, shape (α, T), or None
        m and m/s; None without a string law.
    bar_length, bar_length_rate : ndarray, shape (β, T)
        m and m/s; constant but for bars that are driven.
    residual : float
        Largest unbalanced force on a node, N.
    bar_length_error : float
        Largest departure of a bar that is not driven from its length, relative.
    stability_margin : float
        The smallest on the way, N/m; see :class:`ShapeTarget`.
    clearance : float
        Smallest distance between the axes of two bars on the way, m.
    shortest_duration : float or None
        What the winches need, s; None if they have no limit of rate.
    """

    model: Model
    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    force_density: FloatArray
    rest_length: FloatArray | None
    rest_length_rate: FloatArray | None
    bar_length: FloatArray
    bar_length_rate: FloatArray
    residual: float
    bar_length_error: float
    stability_margin: float
    clearance: float
    shortest_duration: float | None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def reference(self, times: object = None) -> Reference:
        """Return the path as the reference of a controller, as in ``MPC(..., reference=...)``.

        Parameters
        ----------
        times : array_like, shape (K,), optional
            s, ascending; the times of the path if not given. Before the start
            and after the end the path stands still.

        Returns
        -------
        Reference
            With the force densities of the path. Between its times by cubic
            polynomials in the node positions with bar lengths restored.

        Raises
        ------
        TypeError, ValueError
            If the times are not finite numbers or do not ascend.
        """
        if times is None:
            return Reference(self.time, self.nodes, self.force_density)
        from scipy.interpolate import CubicHermiteSpline

        instants = validation.float_array("times", times)
        if instants.ndim != 1 or not len(instants):
            raise ValueError(f"times has shape {instants.shape}, expected (K,) with K at least 1")
        spline = CubicHermiteSpline(self.time, self.nodes, self.velocities, axis=2)
        within = np.clip(instants, self.time[0], self.time[-1])
        shapes, structure = spline(within), self.model.structure
        of_bars = CubicHermiteSpline(self.time, self.bar_length, self.bar_length_rate, axis=1)
        lengths = of_bars(within).T
        exact = [
            put_on_lengths(structure, shapes[:, :, k], lengths[k]) for k in range(len(instants))
        ]
        gamma = np.array([np.interp(instants, self.time, row) for row in self.force_density])
        return Reference(instants, np.stack(exact, axis=-1), gamma)

    def plants(self, count: int, input: str) -> tuple[LinearPlant, ...]:
        """Return linear plants along the path, at equal distances of node travel.

        Parameters
        ----------
        count : int
            How many, at least 1. The first is at the start, the last at the end; one alone in
            the middle.
        input : {"force_density", "rest_length"}
            As for :func:`linearize`.

        Returns
        -------
        tuple of LinearPlant
            In internal coordinates.

        Raises
        ------
        TypeError, ValueError
            If ``count`` is not a whole number of at least 1, or a shape cannot be
            linearized; see :func:`linearize`.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
        >>> start = tc.prestress(tc.prism(), force_density=10.0)
        >>> low = tc.Height(0.85, top=[0, 1, 2], bottom=[3, 4, 5])
        >>> goal = tc.shape_target(model, low, force_density=10.0)
        >>> path = tc.shape_path(model, start, goal, duration=2.0)
        >>> [round(float(plant.nodes[2, 0]), 3) for plant in path.plants(3, input="rest_length")]
        [1.0, 0.964, 0.925]
        """
        count = validation.whole_number("count", count, 1, validation.MOST_DESIGNS)
        distance = np.linalg.norm(np.diff(self.nodes, axis=2), axis=(0, 1))
        travel = np.concatenate([[0.0], np.cumsum(distance)])
        shares = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])
        indices = [int(np.argmin(np.abs(travel - share * travel[-1]))) for share in shares]
        load = self.model.constant_force
        return tuple(
            linearize(
                with_lengths_of(self.model, self.nodes[:, :, k]),
                OperatingPoint(self.nodes[:, :, k], self.force_density[:, k], load),
                input=input,
            )
            for k in indices
        )

    def __repr__(self) -> str:
        return (
            f"ShapePath({self.model.structure!r}, {len(self.time)} shapes in "
            f"{self.time[-1]:.4g} s, residual {self.residual:.1e} N)"
        )


def shape_path(
    model: Model,
    start: ShapeTarget | Prestress,
    goal: ShapeTarget | Prestress,
    *,
    winches: Winches | None = None,
    duration: float | None = None,
    step: float = 0.02,
    ramp: float = 0.25,
    min_force_density: object = 0.0,
    max_force_density: object = None,
    place: str = "anywhere",
    require_stable: bool = True,
    plant: LinearPlant | None = None,
    struts: LinearPlant | None = None,
    drives: Winches | None = None,
) -> ShapePath:
    """Return a path between two shapes through equilibrium shapes.

    It stays as close to the straight line from start to goal, in node positions and γ, as
    equilibria allow. If the winches have a speed limit, one of them runs at its limit at any time,
    except while speeding up and slowing down.

    Parameters
    ----------
    model : Model
        Its weights and built-in load act.
    start, goal : ShapeTarget or Prestress
        Equilibria of this model. For a free structure they should stand where the
        path is to begin and end: their places count, not their shapes only.
    winches : Winches, optional
        Limits of rest lengths and their rates.
    duration : float, optional
        s. The shortest that the winches allow if not given.
    step : float
        Largest time between shapes, s: the sample time of the controller, say.
    ramp : float
        Share of the duration in which the speed rises, and in which it falls,
        more than 0 and at most 0.5.
    min_force_density, max_force_density : float or array_like, shape (α,), optional
        Bounds of γ on the way, N/m.
    place : {"anywhere", "centre"}
        Where the shapes are of a structure that supports leave free to move as one body.
        ``"anywhere"``: on the way to the place of ``goal``. ``"centre"``: where its strings alone
        bring it. The centre of mass stays, and no step from shape to shape turns the whole, so
        that the end may be turned a little against ``goal``.
    require_stable : bool
        Whether a path that leads through shapes that buckle is refused.
    plant : LinearPlant, optional
        Of this model, made with ``actuated``: its passive strings keep their rest lengths, or force
        densities, all the way; strings that share a winch move by their ratios. Both ends are made
        by ``shape_target(..., plant=plant)``. With ``input="bar_length"``, bars that it drives
        change their lengths, and ``winches`` limit these and their rates.
    struts : LinearPlant, optional
        Of this model, with ``input="bar_length"``: the bars that it drives change their lengths
        beside the strings that ``plant`` drives. Not with a plant of both.
    drives : Winches, optional
        Limits of the bars driven beside strings, and of their rates.

    Returns
    -------
    ShapePath
        Nodes and γ are continuous. Velocities are, too, but where a string
        reaches a bound of γ or leaves it.

    Raises
    ------
    PathError
        If equilibria do not lead all the way, or buckle, or bars would pass through
        one another; it carries the equilibrium where that is.
    TypeError, ValueError
        If an argument does not fit; if ``duration`` is too short for the winches,
        or a rest length leaves their range; if the goal is the shape of the start in another
        place.

    Notes
    -----
    Waypoints are found by continuation: a prediction along the exact tangent, then
    Newton steps on the conditions of the nearest equilibrium. Steps are halved
    until a prediction is good, so that a jump to another family is noticed.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
    >>> start = tc.prestress(tc.prism(), force_density=10.0)
    >>> low = tc.Height(0.85, top=[0, 1, 2], bottom=[3, 4, 5])
    >>> goal = tc.shape_target(model, low, force_density=10.0)
    >>> path = tc.shape_path(model, start, goal, winches=tc.Winches(rate=0.1))
    >>> bool(abs(path.rest_length_rate).max() <= 0.1), path.residual < 1e-12
    (True, True)
    >>> path.reference().nodes.shape == path.nodes.shape
    True
    """
    validation.instance("model", model, Model, "make one by Model(structure)")
    refuse_ground(model)
    validation.truth(
        "require_stable", require_stable, "whether a path through shapes that buckle is refused"
    )
    validation.choice("place", place, PLACES)
    held, winches, drives = shape_drives(model, plant, struts, winches, drives)
    driven = None if held is None else held.driven_bars
    begin, end = (path_end(model, *end, driven) for end in (("start", start), ("goal", goal)))
    step = validation.positive_number("step", step, "s")
    ramp = validation.positive_number("ramp", ramp, "shares of the duration")
    if ramp > 0.5:
        raise ValueError(f"ramp is {ramp:g}, expected at most 0.5: there are two of them")
    bounds = checked_bounds(model, min_force_density, max_force_density, winches, held)
    bounds.refuse_outside("start", begin.force_density)
    bounds.refuse_outside("goal", end.force_density)
    rates = tuple(None if limits is None else limits.largest_rate for limits in (winches, drives))
    members = (model.structure.strings, "string"), (model.structure.bars, "bar")
    for rate, (listed, noun) in zip(rates, members, strict=True):
        if rate is not None:
            validation.one_or_per_member("winches.rate", rate, len(listed), noun)
    if duration is not None:
        duration = validation.positive_number("duration", duration, "s")
    elif all(rate is None for rate in rates):
        raise ValueError("expected duration, or winches with a rate, which settle the time")
    refuse_same(model, begin, end)

    # Equal where all strings are slack.
    level = max(float(rest.force_density.max()) for rest in (begin, end)) or 1.0
    if held is not None:
        for name, rest in (("start", begin), ("goal", end)):
            values = rest.force_density
            if held.input == "rest_length":
                assert model.strings is not None  # of the plant
                values = model.strings.rest_length(rest.structure.string_length(), values)
            held.refuse_other(name, values)
    problem = ShapeProblem(model, begin.structure.nodes, level, held=held)
    sides = [problem.start(rest.structure.nodes, rest.force_density) for rest in (begin, end)]
    low, high = bounds.low / level, bounds.highest / level
    continuation = Continuation(problem, sides[0], sides[1], low, high)
    waypoints, complete = continuation.waypoints()
    if not complete:
        last = rest_at(problem, waypoints[-1])
        off = np.linalg.norm(last.structure.nodes - end.structure.nodes, axis=0).max()
        raise PathError(
            f"no continuous path of equilibria leads from start to goal: it ends or jumps where "
            "a node is still "
            f"{off:.3g} m from its goal, {percent(waypoints[-1].place, 3)} of the way. Add "
            "intermediate shapes, or widen the bounds of γ",
            last,
        )
    margin = _least_margin(problem, waypoints, require_stable)
    clearance = _least_clearance(problem, waypoints)
    timed = TimedPath(continuation, waypoints, rates, duration, step, ramp)
    if timed.rest_length is not None:
        bounds.refuse_rest_lengths(timed.rest_length, timed.time)
    structure = model.structure
    bar_length, bar_rate = _bar_lengths(model, timed, drives, held)
    nodes, velocities = timed.nodes, timed.velocities
    if place == "centre":
        nodes, velocities = _with_centre_kept(model, begin.structure.nodes, nodes, velocities)
    bars = timed.nodes[:, structure.bars[:, 1]] - timed.nodes[:, structure.bars[:, 0]]
    length = np.linalg.norm(bars, axis=0) / bar_length
    return ShapePath(
        model=model,
        time=timed.time,
        nodes=nodes,
        velocities=velocities,
        force_density=timed.force_density,
        rest_length=timed.rest_length,
        rest_length_rate=timed.rest_length_rate,
        bar_length=bar_length,
        bar_length_rate=bar_rate,
        residual=timed.residual,
        bar_length_error=float(np.abs(length - 1).max(initial=0.0)),
        stability_margin=margin,
        clearance=clearance,
        shortest_duration=timed.shortest,
    )


def _with_centre_kept(
    model: Model, start: FloatArray, nodes: FloatArray, velocities: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return shapes and velocities, (d, n, T), without momenta along what supports leave free."""
    structure = model.structure
    if not rigid_basis(structure).shape[1]:
        return nodes, velocities
    mass, last = model.mass_matrix().toarray(), start
    shapes, rates = [], []
    for N, V in zip(np.moveaxis(nodes, 2, 0), np.moveaxis(velocities, 2, 0), strict=True):
        # Laid over the shape before: then nothing of the step between them is such a motion.
        before = coordinates(with_lengths_of(model, last), last, "nodes")
        last, turned = before.laid_over(N, V)
        fields = left_by_supports(structure, rigid_motions(last))
        momenta = (mass @ fields.reshape(len(mass), -1)).reshape(fields.shape).T
        rate = turned.ravel(order="F")
        rate = rate - fields @ np.linalg.lstsq(momenta @ fields, momenta @ rate, rcond=None)[0]
        shapes.append(last)
        rates.append(rate.reshape(N.shape, order="F"))
    return np.stack(shapes, axis=-1), np.stack(rates, axis=-1)


def _bar_lengths(
    model: Model, timed: TimedPath, drives: Winches | None, held: HeldStrings | None
) -> tuple[FloatArray, FloatArray]:
    """Return the lengths of bars on the way and their rates, (β, T) each.

    Raises an error where a drive leaves its stroke.
    """
    time, strokes = timed.time, drive_strokes(model, drives, held)
    lengths = np.repeat(model.structure.bar_length[:, None], len(time), axis=1)
    rates = np.zeros_like(lengths)
    if strokes is None or held is None:
        return lengths, rates
    assert timed.bar_length is not None  # bars are driven
    assert timed.bar_length_rate is not None  # then, too
    lengths[held.driven_bars] = timed.bar_length[held.driven_bars]
    rates[held.driven_bars] = timed.bar_length_rate[held.driven_bars]
    refuse_out_of_range("bar {} needs a length", lengths, strokes, time, "the stroke of its drive")
    return lengths, rates


def path_end(model: Model, name: str, value: object, driven: IntArray | None = None) -> Prestress:
    """Return an end of the path as an equilibrium of this model, but for lengths of driven bars."""
    rest = value.prestress if isinstance(value, ShapeTarget) else value
    validation.instance(
        name, rest, Prestress, "make one by shape_target(model, ...) or prestress(...)"
    )
    assert isinstance(rest, Prestress)  # just checked
    structure, ours = rest.structure, model.structure
    if not same_members(structure, ours):
        raise ValueError(
            f"{name} is a prestress of {structure!r}, expected one of the structure of the model, "
            f"{ours!r}, with the same members and fixed nodes"
        )
    refuse_wrong_bar_lengths(name, ours, structure.nodes, driven=driven)
    refuse_moved_supports(name, ours, structure.nodes)
    load = free_coordinates(ours, model.constant_force)
    off = float(np.abs(free_coordinates(ours, rest.external_force) - load).max(initial=0.0))
    if off > 1e-9 * max(float(np.abs(load).max(initial=0.0)), float(rest.force_density.max())):
        raise ValueError(
            f"{name} rests under loads that differ from those of the model by {off:.3g} N; "
            "make it by shape_target(model, ...), or by prestress(..., "
            "external_force=model.constant_force)"
        )
    return rest


def refuse_same(model: Model, start: Prestress, goal: Prestress) -> None:
    """Raise if start and goal are the same equilibrium."""
    travel = np.linalg.norm(goal.structure.nodes - start.structure.nodes, axis=0).max()
    change = np.abs(goal.force_density - start.force_density).max()
    level = max(float(rest.force_density.max()) for rest in (start, goal))
    size = start.structure.size
    if travel <= 1e-9 * size and change <= 1e-9 * level:
        raise ValueError(
            "start and goal are the same shape with the same γ, expected different ones"
        )
    gone = moved_as_one_body(model, start.structure.nodes, goal.structure.nodes)
    if gone and change <= 1e-9 * level:
        raise ValueError(
            f"goal is start after a rigid-body motion of up to {gone:.3g} m. "
            f"{STRINGS_MOVE_NO_CENTRE}"
        )


def _least_margin(problem: ShapeProblem, waypoints: list[Waypoint], require_stable: bool) -> float:
    """Return the least stability margin on the way, or raise where a shape buckles."""
    least = np.inf
    for point in waypoints:
        rest = rest_at(problem, point)
        now = problem.stability_margin(rest)
        if require_stable and now <= STIFF * float(rest.force_density.max()):
            raise PathError(
                f"the path leads through an unstable shape, "
                f"{percent(point.place, 3)} of the way to the goal: its stability margin is "
                f"{now:.3g} N/m. Add intermediate shapes, keep strings taut by "
                "min_force_density, or accept it by require_stable=False",
                rest,
            )
        least = min(least, now)
    return least


def _least_clearance(problem: ShapeProblem, waypoints: list[Waypoint]) -> float:
    """Return the least distance of bars on the way, or raise where they pass through each other."""
    structure = problem.model.structure
    shapes = [problem.read(point.values)[0] for point in waypoints]
    places = np.array([point.place for point in waypoints])
    motion = BarMotion(structure, places, np.stack(shapes, axis=-1))
    if motion.crossings:
        (i, j), share = motion.crossings[0].bars, motion.crossings[0].time
        raise PathError(
            f"bars {i} and {j} would pass through each other, {percent(share, 3)} of the way to "
            "the goal. Add intermediate shapes that lead them past each other's ends",
            rest_at(problem, waypoints[max(0, int(np.searchsorted(places, share)) - 1)]),
        )
    least = [bar_distances(structure, nodes).least for nodes in shapes]
    return min(least) if motion.clearance is None else motion.clearance.distance
