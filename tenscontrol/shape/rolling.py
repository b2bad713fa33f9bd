"""Rolling by deformation: rest lengths that tip a structure over an edge of its base."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, final

import casadi as ca
import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.dynamics import Model, SharedEvaluator, builds, kernel
from tenscontrol.plant import held_value
from tenscontrol.structure import Structure, bar_distances, restore_bar_lengths
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    float_array,
    freeze_arrays,
    indices,
    instance,
    number,
    positive_number,
    shaped,
    whole_number,
)
from tenscontrol.validation import (
    direction as unit_vector,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Least rest length, in those of the start, unless the winches say.
_SHORTEST = 0.01

# Newton steps to an equilibrium: at the start, and from one to the next, which is close by. Within
# this part of the size it is one.
_FIRST, _NEXT, _CLOSE = 40, 8, 1e-8

# Times that the way to the next equilibrium is halved.
_HALVINGS = 4

# Largest move of a node in a Newton step, largest change of a rest length between equilibria, and
# margin that is enough, in sizes.
_MOVE, _STEP, _MARGIN = 0.1, 0.01, 0.02

# Winding that moves the centre of mass by less than this part of itself is in vain.
_VAIN = 1e-3

# Nodes this near the ground touch it, and lifted ones are farther, in sizes; slower ones than this
# part of √(g · size) are at rest.
_TOUCHES, _STILL = 0.02, 0.05

# So long a structure is waited for that has not tipped, or not come to rest, in √(size / g).
_PATIENCE = 8.0

# Steps that a gait foresees, as if the shape were rigid, and how far ahead it looks, in sizes.
_FORESEEN, _AHEAD = 2, 2.0

# What a gait does.
_STANDS, _WINDS, _LANDS = "stands", "winds", "lands"


class TippingError(ValueError):
    """No winding was found that brings the centre of mass over the edge.

    Attributes
    ----------
    reached : TippingPath
        How far it got.
    """

    def __init__(self, message: str, reached: TippingPath) -> None:
        super().__init__(message)
        self.reached = reached


@dataclass(frozen=True, eq=False)
class TippingPath:
    """Equilibria on the way over an edge. Made by :func:`tipping_path`.

    Attributes
    ----------
    feet : ndarray of int
        Nodes that it stands on.
    edge : ndarray of int, shape (d − 1,)
        The feet that it tips over: two in space, one in the plane.
    outward : ndarray, shape (d,)
        Horizontal direction over the edge at the start.
    rest_length : ndarray, shape (α, K)
        m.
    nodes : ndarray, shape (d, n, K)
        m.
    margin : ndarray, shape (K,)
        How far the centre of mass is beyond the edge, m; negative while it stands.
    clearance : float
        Smallest distance between the axes of two bars on the way, m.
    """

    feet: IntArray
    edge: IntArray
    outward: FloatArray
    rest_length: FloatArray
    nodes: FloatArray
    margin: FloatArray
    clearance: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __repr__(self) -> str:
        wound = np.abs(self.rest_length - self.rest_length[:, :1]).max()
        return (
            f"TippingPath(over {self.edge.tolist()} of {self.feet.tolist()}, margin "
            f"{self.margin[0]:.3g} to {self.margin[-1]:.3g} m, winding at most {wound:.3g} m)"
        )


def tipping_path(
    model: Model,
    rest_length: ArrayLike,
    feet: ArrayLike,
    direction: ArrayLike,
    *,
    nodes: ArrayLike | None = None,
    winches: Winches | None = None,
    margin: float | None = None,
    step: float | None = None,
    clearance: float = 0.0,
) -> TippingPath:
    """Return rest lengths that bring the centre of mass over an edge of the base.

    The structure stands on its feet, which slide without friction on the plane that they span. Of
    the edges of their convex hull, the one is taken that looks most in the direction. From
    equilibrium to equilibrium, rest lengths change by the gradient of the distance by which the
    centre of mass is beyond it, so with the least winding. Strings may go slack.

    Parameters
    ----------
    model : Model
        With a string law and gravity, without supports. Its ground is not looked at.
    rest_length : float or array_like, shape (α,)
        m, at the start.
    feet : array_like of int
        Nodes that it stands on, at least d.
    direction : array_like, shape (d,)
        Where to go.
    nodes : array_like, shape (d, n), optional
        A shape near equilibrium, m; that of the structure if not given. In space it may be turned.
    winches : Winches, optional
        Whose range of rest lengths is kept.
    margin : float, optional
        How far to go beyond the edge, m; a fiftieth of the size if not given.
    step : float, optional
        Largest change of a rest length between two equilibria, m; a hundredth of the size if not
        given.
    clearance : float
        Least distance between the axes of bars that share no node, m.

    Returns
    -------
    TippingPath

    Raises
    ------
    TippingError
        If the centre of mass cannot be brought so far: the winches end, bars would come too near,
        or there is no stable equilibrium. ``.reached`` has the way up to there.
    TypeError, ValueError
        If an argument does not fit, or there is no equilibrium on these feet at the start.

    Notes
    -----
    The centre of mass c is beyond an edge with one end at a and the direction e by ``o·(c − a)``,
    with the unit vector o along ``± e × g``: the moment of gravity about the edge over the weight's
    part across it. Where that is zero, the other feet are without force.
    The gradient ``dm/dl0`` is by the adjoint of the conditions of equilibrium. Tipping by few
    strings is that of K. Kim, A. K. Agogino et al., *Rolling locomotion of cable-driven soft
    spherical tensegrity robots*, Soft Robotics 7 (2020), 346-361, doi:10.1089/soro.2019.0056.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> ball = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    >>> model = tc.Model(ball, strings=tc.LinearStrings(stiffness=1000.0),
    ...                  gravity=9.81 * np.array([-1.0, -1.0, -1.0]) / np.sqrt(3))
    >>> low = np.argsort(ball.nodes.sum(axis=0))[:3]
    >>> path = tc.shape.tipping_path(model, 0.55, feet=low, direction=[1.0, -1.0, 0.0])
    >>> bool(path.margin[0] < 0 < path.margin[-1])
    True
    """
    planner = TippingPlanner(model, rest_length, winches, clearance)
    shape = model.structure.nodes
    if nodes is not None:
        shape = restore_bar_lengths(model.structure, model.structure.checked_nodes("nodes", nodes))
    found = _checked_feet(feet, *shape.shape)
    heading = unit_vector("direction", direction, len(shape))
    enough = _MARGIN * planner.size if margin is None else positive_number("margin", margin, "m")
    most = _STEP * planner.size if step is None else positive_number("step", step, "m")
    edges = planner.edges(shape, found)
    edge = max(edges, key=lambda each: float(edges[each] @ heading))
    try:
        planner.start(shape, found, edge)
    except StuckError as error:
        raise ValueError(f"nothing stands on the feet {found.tolist()}: {error}") from None
    points, trouble = [planner.point], None
    while planner.margin < enough and trouble is None:
        try:
            planner.advance(most)
        except StuckError as error:
            trouble = error
        else:
            points.append(planner.point)
    lengths, shapes, margins = (np.stack(rows, axis=-1) for rows in zip(*points, strict=True))
    apart = [bar_distances(model.structure, each).least for each in np.moveaxis(shapes, 2, 0)]
    path = TippingPath(found, np.array(edge), edges[edge], lengths, shapes, margins, min(apart))
    if trouble is not None:
        raise TippingError(
            f"the centre of mass comes to {path.margin.max():.3g} m beyond the edge "
            f"{path.edge.tolist()}, expected {enough:.3g} m: {trouble}. Allow the winches a longer "
            "way, change the prestress, or go in another direction",
            path,
        )
    return path


def stand_on(model: Model, feet: ArrayLike) -> FloatArray:
    """Return the shape of the structure turned so that it stands on the ground on these feet.

    Parameters
    ----------
    model : Model
        With one ground that is a plane.
    feet : array_like of int
        At least d nodes, in one plane.

    Returns
    -------
    ndarray, shape (d, n)
        m. The feet are on the ground, and the middle of all nodes above its origin, the point
        nearest to that of the axes.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or other nodes are lower than the feet.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> ball = tc.library.six_bar_ball(bar_length=1.0)
    >>> model = tc.Model(ball, ground=tc.Ground(stiffness=5e3))
    >>> tc.shape.stand_on(model, [0, 4, 8])[2, :5].round(3)
    array([0.   , 0.577, 0.289, 0.866, 0.   ])
    """
    instance("model", model, Model, "make one by Model(structure, ground=...)")
    normal, height = _one_plane(model)
    nodes = model.structure.nodes - model.structure.nodes.mean(axis=1, keepdims=True)
    d, n = nodes.shape
    found = _checked_feet(feet, d, n)
    outward = -_plane(nodes[:, found], nodes[:, found].mean(axis=1))[0]
    # The least turn that takes one to the other; half a turn where they are opposite.
    aligned = float(outward @ -normal)
    if aligned > _CLOSE - 1:
        both = outward - normal
        turn = np.eye(d) - np.outer(both, both) / (1 + aligned) - 2 * np.outer(normal, outward)
    else:
        side = np.linalg.svd(normal[None])[2][-1]
        turn = np.eye(d) - 2 * (np.outer(normal, normal) + np.outer(side, side))
    turned = turn @ nodes
    above = normal @ turned
    size = float(np.ptp(nodes, axis=1).max())
    if above.min() < above[found].min() - _CLOSE * size:
        raise ValueError(
            f"feet are {found.tolist()}, but node {above.argmin()} would be lower by "
            f"{above[found].min() - above.min():.3g} m: give the nodes of a face"
        )
    return np.asarray(turned + ((height - above.min()) * normal)[:, None])


class StuckError(ValueError):
    """Winding cannot go on; the message says why."""


class TippingPlanner:
    """Equilibria on feet that slide without friction, wound towards an edge of their base.

    Unknowns are the positions of the nodes, and multipliers for the lengths of bars and for what
    holds the feet: each at its height, and all together in place and in their direction, by forces
    that act on all of them alike.
    """

    def __init__(
        self, model: Model, rest_length: object, winches: Winches | None, clearance: float
    ) -> None:
        import scipy.linalg
        import scipy.spatial  # both now, not within the first sample  # noqa: F401

        instance("model", model, Model, "make one by Model(structure, strings=..., gravity=...)")
        structure, force = model.structure, model.constant_force.sum(axis=1)
        if len(structure.fixed_rows):
            raise ValueError("the structure has supports, but what rolls has none: leave them out")
        if model.strings is None:
            raise ValueError(
                "the model has no string law, so rest lengths mean nothing to it; build it as "
                "Model(structure, strings=LinearStrings(stiffness=...))"
            )
        weight = float(np.linalg.norm(force))
        if weight == 0:
            raise ValueError(
                "the model has no weight, so nothing tips it; build it as Model(..., gravity=9.81)"
            )
        self._structure, self._down = structure, force / weight
        self._shares = self._down @ model.constant_force / weight
        self.home = held_value(model, rest_length, None)
        self.size = float(np.ptp(structure.nodes, axis=1).max())
        self.gravity = weight / float(structure.bar_mass.sum() + structure.point_mass.sum())
        self._low, self._high = _SHORTEST * self.home, np.full(len(self.home), np.inf)
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
            winches.refuse_out_of_range("rest_length", self.home)
            if winches.shortest is not None:
                self._low = np.broadcast_to(winches.shortest, self.home.shape)
            if winches.longest is not None:
                self._high = np.broadcast_to(winches.longest, self.home.shape)
        self._clearance = number("clearance", clearance, "m")
        self._conditions = model.prepared.get("tipping", lambda: _conditions(model))

    @property
    def point(self) -> tuple[FloatArray, FloatArray, float]:
        """Rest lengths, nodes and margin, m."""
        return self.rest_length, self.nodes, self.margin

    def edges(self, nodes: FloatArray, feet: IntArray) -> dict[tuple[int, ...], FloatArray]:
        """Return the edges of the base, each with the horizontal direction over it."""
        d = len(nodes)
        if len(feet) == d:
            found = list(combinations(feet.tolist(), d - 1))
        else:
            places = _plane(nodes[:, feet], self._down)[1] @ nodes[:, feet]
            found = [tuple(sorted(feet[pair].tolist())) for pair in _hull(places)]
        return {edge: _across(nodes, feet, edge, self._down)[0] for edge in found}

    def start(self, nodes: FloatArray, feet: IntArray, edge: tuple[int, ...]) -> None:
        """Go to the equilibrium on these feet near a shape, at the rest lengths of the start.

        Raises
        ------
        StuckError
            If there is none.
        """
        d, n = nodes.shape
        self.feet, self.edge = feet, edge
        shape = nodes[:, feet]
        up, tangents = _plane(shape, self._down)
        self._up = up
        held = [np.outer(up, each) for each in np.eye(len(feet))]
        held += [np.outer(each, np.ones(len(feet))) for each in tangents]
        if d == 3:
            held.append(np.cross(up, (shape - shape.mean(axis=1, keepdims=True)).T).T)
        rows = np.zeros((len(held), n, d))
        rows[:, feet] = np.transpose(held, (0, 2, 1))
        self._rows = rows.reshape(len(held), n * d)
        place = nodes.ravel(order="F")
        self._values = self._rows @ place
        count = len(_moving_bars(self._structure)) + len(held)
        self._balance(np.concatenate([place, np.zeros(count)]), self.home, _FIRST)

    def advance(self, most: FloatArray | float) -> None:
        """Go on to the next equilibrium, with rest lengths changed by this much at most, m.

        Raises
        ------
        StuckError
            If that brings nothing, or there is none.
        """
        uphill = self._uphill()
        low, high = self.rest_length <= self._low, self.rest_length >= self._high
        uphill[(low & (uphill < 0)) | (high & (uphill > 0))] = 0.0
        if np.linalg.norm(uphill) < _VAIN:
            raise StuckError("the winches that would move it are at the end of their way")
        change = uphill * np.min(most / np.maximum(np.abs(uphill), _VAIN**2))
        for _ in range(_HALVINGS):
            wanted = np.clip(self.rest_length + change, self._low, self._high)
            slope = self._solve(self._pushes @ (self.rest_length - wanted))
            try:
                return self._balance(self._unknowns + slope, wanted, _NEXT)
            except StuckError as error:
                trouble, change = error, change / 2
        raise trouble

    def _solve(self, forces: FloatArray) -> FloatArray:
        """Return what forces on the nodes change in the unknowns."""
        from scipy.linalg import lu_solve

        right = np.zeros(len(self._unknowns))
        right[: len(forces)] = forces
        return np.asarray(lu_solve(self._factors, right, check_finite=False))

    def _balance(self, unknowns: FloatArray, rest_length: FloatArray, steps: int) -> None:
        """Go to the equilibrium near these unknowns."""
        from scipy.linalg import lu_factor, lu_solve

        d, n = self._structure.nodes.shape
        entries, bars = n * d, len(unknowns) - n * d - len(self._rows)
        for _ in range(steps):
            place = unknowns[:entries]
            parts = self._conditions(place, rest_length, unknowns[entries : entries + bars])
            force, stretch, directions, hessian, pushes = (each.copy() for each in parts)
            held = np.vstack([directions, self._rows])
            matrix = np.block([[hessian, held.T], [held, np.zeros((len(held), len(held)))]])
            left = force + held.T @ unknowns[entries:]
            residual = np.concatenate([left, stretch, self._rows @ place - self._values])
            if not (np.isfinite(residual).all() and np.isfinite(matrix).all()):
                break
            factors = lu_factor(matrix, check_finite=False)
            move = -lu_solve(factors, residual, check_finite=False)
            largest = float(np.abs(move[:entries]).max())
            unknowns = unknowns + min(1.0, _MOVE * self.size / largest) * move
            if largest < _CLOSE * self.size:
                return self._take(unknowns, rest_length, matrix, factors, pushes)
        raise StuckError("no equilibrium is found close by")

    def _take(
        self, unknowns: FloatArray, rest_length: FloatArray, matrix: FloatArray, factors: object,
        pushes: FloatArray,
    ) -> None:  # fmt: skip
        """Keep an equilibrium, if it is one that can be kept."""
        d, n = self._structure.nodes.shape
        nodes = unknowns[: d * n].reshape((d, n), order="F")
        # As many negative eigenvalues as constraints: the energy is least.
        if np.count_nonzero(np.linalg.eigvalsh(matrix) < 0) > len(matrix) - d * n:
            raise StuckError("there it is not stable")
        above = np.delete(self._up @ nodes, self.feet)
        if above.min(initial=np.inf) < self._up @ nodes[:, self.feet].mean(axis=1):
            raise StuckError("another node would come to the ground before")
        apart = bar_distances(self._structure, nodes).least if self._clearance else np.inf
        if apart < self._clearance:
            raise StuckError(f"bars would come as near as {apart:.3g} m")
        self._unknowns, self._factors, self._pushes = unknowns, factors, pushes
        self.nodes, self.rest_length = nodes, rest_length
        across, _ = _across(nodes, self.feet, self.edge, self._down)
        self.margin = float(across @ (nodes @ self._shares - nodes[:, self.edge[0]]))

    def _uphill(self) -> FloatArray:
        """Return by how much each rest length moves the centre of mass over the edge."""
        across, scale = _across(self.nodes, self.feet, self.edge, self._down)
        slope = np.outer(across, self._shares)
        slope[:, self.edge[0]] -= across
        if len(across) == 3:
            beyond = self.nodes @ self._shares - self.nodes[:, self.edge[0]]
            turned = np.cross(self._down, beyond - (across @ beyond) * across) / scale
            slope[:, self.edge[1]] += turned
            slope[:, self.edge[0]] -= turned
        d, n = slope.shape
        return np.asarray(-self._pushes.T @ self._solve(slope.ravel(order="F"))[: d * n])


def _across(
    nodes: FloatArray, feet: IntArray, edge: tuple[int, ...], down: FloatArray
) -> tuple[FloatArray, float]:
    """Return the unit vector over an edge and across a direction, and the scale that it had."""
    if len(nodes) == 2:
        across = np.array([-down[1], down[0]])
    else:
        across = np.cross(nodes[:, edge[1]] - nodes[:, edge[0]], down)
    scale = float(np.linalg.norm(across))
    if across @ (nodes[:, feet].mean(axis=1) - nodes[:, edge[0]]) > 0:
        scale = -scale
    return across / scale, scale


def _rolled(
    nodes: FloatArray, feet: IntArray, edge: tuple[int, ...], up: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return the nodes, and on which they stand, after a rigid shape has rolled over an edge."""
    over, _ = _across(nodes, feet, edge, -up)
    beside = nodes - nodes[:, edge[:1]]
    out, above = over @ beside, up @ beside
    angles = np.arctan2(above, out)
    angles[feet] = np.inf
    turn = angles.min()
    c, s = np.cos(turn) - 1, np.sin(turn)
    moved = np.outer(over, c * out + s * above) + np.outer(up, c * above - s * out)
    return nodes + moved, np.union1d(edge, np.flatnonzero(angles < turn + _TOUCHES))


def _moving_bars(structure: Structure) -> IntArray:
    """Return the bars whose lengths are independent."""
    return np.concatenate([structure.free_bars, *(b.independent for b in structure.blocks)])


@builds
def _conditions(model: Model) -> SharedEvaluator:
    """Return the slope of the energy with bars, their stretch, and the derivatives of both.

    ``(positions, rest lengths, multipliers) -> (slope, stretch, directions, Hessian, pushes)``,
    where the first is that of strings and weights alone, and the last by the rest lengths.
    """
    structure = model.structure
    q, rest = ca.SX.sym("q", structure.nodes.size), ca.SX.sym("rest", len(structure.strings))
    N = ca.reshape(q, *structure.nodes.shape)
    assert model.strings is not None  # refused before
    length = kernel.string_lengths(structure, N).T
    energy = ca.sum1(model.strings.as_expressions().stored_energy(length, rest))
    energy -= ca.dot(ca.DM(model.constant_force), N)
    B = kernel.differences(N, structure.bars[_moving_bars(structure)])
    stretch = (kernel.dots(B, B).T - ca.DM(structure.bar_length[_moving_bars(structure)] ** 2)) / 2
    lam = ca.SX.sym("lambda", stretch.numel())
    slope, directions = ca.gradient(energy, q), ca.jacobian(stretch, q)
    hessian = ca.jacobian(slope + ca.mtimes(directions.T, lam), q)
    found = [slope, stretch, directions, hessian, ca.jacobian(slope, rest)]
    given = [q, rest, lam]
    return SharedEvaluator(ca.Function("tipping", given, [ca.densify(each) for each in found]))


def _hull(places: FloatArray) -> list[list[int]]:
    """Return the edges of the convex hull of points in the plane, or the ends of a line."""
    if len(places) == 1:
        return [[int(places.argmin())], [int(places.argmax())]]
    from scipy.spatial import ConvexHull

    edges: list[list[int]] = ConvexHull(places.T).simplices.tolist()
    return edges


def _plane(shape: FloatArray, down: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the upward normal of the plane that is nearest to some nodes, and a basis of it."""
    axes = np.linalg.svd((shape - shape.mean(axis=1, keepdims=True)).T)[2]
    return -np.sign(axes[-1] @ down) * axes[-1], axes[:-1]


def _one_plane(model: Model) -> tuple[FloatArray, float]:
    """Return normal and height of the ground of a model, which must be a plane."""
    if len(model.ground) != 1:
        raise ValueError(
            f"the model has {len(model.ground)} contact laws, expected one: build it as "
            "Model(..., ground=Ground(stiffness=...))"
        )
    law = model.ground[0]
    if isinstance(law.height, ca.Function):
        raise ValueError("the ground of the model is curved, expected a plane: a number as height")
    return law.up(model.structure.dimension), law.height


def _checked_feet(feet: object, d: int, n: int) -> IntArray:
    """Return the nodes that a structure is to stand on, ascending."""
    found = np.unique(indices("feet", np.atleast_1d(float_array("feet", feet)), n, "nodes"))
    if len(found) < d:
        raise ValueError(f"feet are {found.tolist()}, expected at least {d} nodes")
    return found


@dataclass(frozen=True, eq=False)
class RollingStep:
    """A step of a :class:`RollingGait`.

    Attributes
    ----------
    time : float
        When other nodes touched the ground, s.
    feet, edge : ndarray of int
        What it stood on, and what it tipped over.
    landed : ndarray of int
        What it came to rest on.
    """

    time: float
    feet: IntArray
    edge: IntArray
    landed: IntArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


@final
class RollingGait:
    """Rolls a structure on the ground along a line, step by step, by its rest lengths.

    An object with a method ``command``, as ``simulate(controller=...)`` takes it. At rest it sees
    which nodes it stands on, and tips over the edge of these feet from which two steps, of a shape
    that is rigid, lead nearest to a point of the line ahead. Sample by sample the winches follow
    the gradient of :func:`tipping_path`, the fastest of them at its limit, until the centre of mass
    is beyond the edge by a fiftieth of the size. It waits until it has tipped and is at rest, and
    winds back to the rest lengths of the start. Where one edge cannot be passed, it tries the next.

    Parameters
    ----------
    model : Model
        With a string law, gravity and one ground that is a plane, without supports. What it plans
        with; that of the run may differ.
    rest_length : float or array_like, shape (α,)
        m, between the steps.
    direction : array_like, shape (d,)
        Where the line goes; it begins where the structure is at the first command.
    sample_time : float
        s.
    winches : Winches, optional
        Their range and speed are kept; without a speed, winding is by a hundredth of the size in a
        sample.
    steps : int, optional
        Steps to make; without end if not given.
    clearance : float
        Least distance between the axes of bars that share no node while it winds, m.

    Attributes
    ----------
    made : tuple of RollingStep
        The steps so far.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> ball = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    >>> ground = tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.05)
    >>> model = tc.Model(ball, strings=tc.LinearStrings(stiffness=1000.0, damping=10.0),
    ...                  gravity=9.81, ground=ground)
    >>> winches = tc.Winches(rate=0.2, ramp=True)
    >>> gait = tc.shape.RollingGait(model, 0.55, direction=[1.0, 0.0, 0.0], sample_time=0.05,
    ...                             winches=winches, steps=1)
    >>> nodes = tc.shape.stand_on(model, [0, 4, 8])
    >>> run = tc.simulate(model, 3.0, nodes, controller=gait, winches=winches, rest_length=0.55,
    ...                   method="cvodes", tolerance=1e-5)
    >>> [step.landed.tolist() for step in gait.made]
    [[4, 8, 10]]
    """

    input = "rest_length"

    def __init__(
        self,
        model: Model,
        rest_length: ArrayLike,
        direction: ArrayLike,
        sample_time: float,
        *,
        winches: Winches | None = None,
        steps: int | None = None,
        clearance: float = 0.0,
    ) -> None:
        self._planner = TippingPlanner(model, rest_length, winches, clearance)
        self._structure = model.structure
        self._normal, self._height = _one_plane(model)
        self._direction = unit_vector("direction", direction, model.structure.dimension)
        self.sample_time = positive_number("sample_time", sample_time, "s")
        self._steps = np.inf if steps is None else whole_number("steps", steps, 1)
        size, gravity = self._planner.size, self._planner.gravity
        rate = None if winches is None else winches.largest_rate
        self._most = _STEP * size if rate is None else rate * self.sample_time
        self._touches, self._still = _TOUCHES * size, _STILL * np.sqrt(gravity * size)
        self._patience = _PATIENCE * np.sqrt(size / gravity)
        self.reset()

    def reset(self) -> None:
        """Forget the steps made, and stand."""
        self.made: tuple[RollingStep, ...] = ()
        self._phase = _STANDS
        self._since = 0.0
        self._reached = self._planner.home
        self._vain: set[tuple[int, ...]] = set()
        self._begun: FloatArray | None = None  # where the line begins
        self._tipped: RollingStep | None = None  # a step that has not come to rest

    def applied(self, value: ArrayLike) -> None:
        """Take note of the rest lengths that the winches reached.

        Parameters
        ----------
        value : array_like, shape (α,)
            m.
        """
        home = self._planner.home
        self._reached = shaped("value", value, home.shape, "one rest length per string")

    def command(self, time: float, nodes: ArrayLike, velocities: ArrayLike) -> FloatArray:
        """Return rest lengths, m, shape (α,).

        Parameters
        ----------
        time : float
            s.
        nodes, velocities : array_like, shape (d, n)
            m and m/s.
        """
        time = number("time", time, "s")
        nodes = self._structure.checked_nodes("nodes", nodes)
        velocities = self._structure.checked_nodes("velocities", velocities)
        above = self._normal @ nodes - self._height
        touching = np.flatnonzero(above < self._touches)
        is_still = bool(np.linalg.norm(velocities, axis=0).max() < self._still)
        is_late = time > self._since + self._patience
        if self._phase is _WINDS:
            self._wind(time, touching, is_late)
        elif self._phase is _LANDS and (is_still or is_late):
            self._phase = _STANDS
        elif self._phase is _STANDS and is_still and len(touching) >= len(nodes):
            off = np.abs(self._reached - self._planner.home).max()
            if off <= _CLOSE * self._planner.size:
                self._stand(time, nodes, touching)
        return self._planner.home if self._phase is _STANDS else self._planner.rest_length

    def _stand(self, time: float, nodes: FloatArray, feet: IntArray) -> None:
        """Count the step that led here, and begin to wind over the best edge."""
        if self._tipped is not None and not np.array_equal(feet, self._tipped.feet):
            self.made += (replace(self._tipped, landed=feet),)
            self._vain = set()
        self._tipped = None
        if len(self.made) >= self._steps:
            return
        centre = nodes.mean(axis=1)
        self._begun = centre if self._begun is None else self._begun
        along = self._direction @ (centre - self._begun)
        goal = self._begun + (along + _AHEAD * self._planner.size) * self._direction
        edges = self._planner.edges(nodes, feet).keys()
        left = edges - self._vain or edges
        edge = min(left, key=lambda each: self._distance(nodes, feet, each, goal, _FORESEEN))
        try:
            self._planner.start(nodes, feet, edge)
        except StuckError:
            self._vain.add(edge)
        else:
            self._phase, self._since = _WINDS, time

    def _distance(
        self, nodes: FloatArray, feet: IntArray, edge: tuple[int, ...], goal: FloatArray, steps: int
    ) -> float:
        """Return how far from the goal the centre is after some steps of a rigid shape, m."""
        nodes, feet = _rolled(nodes, feet, edge, self._normal)
        if steps == 1 or len(feet) < len(nodes):
            return float(np.linalg.norm(nodes.mean(axis=1) - goal))
        edges = self._planner.edges(nodes, feet)
        return min(self._distance(nodes, feet, each, goal, steps - 1) for each in edges)

    def _wind(self, time: float, touching: IntArray, is_late: bool) -> None:
        """Wind on, or end it where it has tipped or cannot."""
        planner = self._planner
        behind = np.setdiff1d(planner.feet, planner.edge)
        tipped = np.setdiff1d(touching, planner.feet).size and not np.isin(behind, touching).any()
        if tipped:
            edge = np.array(planner.edge)
            self._tipped = RollingStep(time, planner.feet, edge, touching)
            self._phase, self._since = _LANDS, time
        elif planner.margin < _MARGIN * planner.size:
            try:
                planner.advance(self._most)
                self._since = time
            except StuckError:
                self._give_up()
        elif is_late:
            self._give_up()

    def _give_up(self) -> None:
        """Go back, to try another edge."""
        self._vain.add(self._planner.edge)
        self._phase = _STANDS
