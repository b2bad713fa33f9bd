"""Rolling by deformation: rest lengths that tip a structure over an edge of its base."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    actuation_of,
    bounds_of_inputs,
    changes_of_inputs,
    inputs_of,
    strings_of,
)
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function, SharedEvaluator, builds
from tenscontrol.dynamics.held_inputs import held_value
from tenscontrol.dynamics.model import Model
from tenscontrol.plant.input_bounds import rest_length_bounds
from tenscontrol.plant.stance import convex_hull
from tenscontrol.shape.faces import lowest_face
from tenscontrol.structure.bar_clearance import bar_distances
from tenscontrol.structure.bar_geometry import restore_bar_lengths
from tenscontrol.validation import direction as unit_vector

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Newton steps to an equilibrium: at the start, and from one to the next, which is close by. Within
# this part of the size it is one.
_FIRST, _NEXT, CLOSE = 40, 8, 1e-8

# Times that the way to the next equilibrium is halved.
_HALVINGS = 4

# Largest move of a node in a Newton step, largest change of a rest length between equilibria, and
# margin that is enough, in sizes.
_MOVE, STEP, MARGIN = 0.1, 0.01, 0.02

# Nodes this near a face belong to it, in sizes.
NEAR = 0.02

# Winding that moves the centre of mass by less than this part of itself is in vain, and so is a
# step that gains less than this part of what its slope promised.
_VAIN, _GAIN = 1e-2, 0.1

# Steps are no shorter than this, in sizes.
_SHORTEST_STEP = 1e-5


class TippingError(ValueError):
    """No rest lengths were found that bring the centre of mass over the edge.

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
    """Equilibria until a structure tips over an edge. Made by :func:`tipping_path`.

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
    actuated: object = None,
) -> TippingPath:
    """Return a path of rest lengths that tips a structure over an edge of its base.

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
    actuated : sequence of int or str, dict, array_like or Actuation, optional
        The strings that winches drive, as in :func:`linearize`; all if not given. The others keep
        the rest lengths of the start.

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
    Its gradient by the rest lengths is that of the adjoint of the conditions of equilibrium.

    K. Kim, A. K. Agogino, A. M. Agogino, *Rolling locomotion of cable-driven soft spherical
    tensegrity robots*, Soft Robotics 7 (2020), 346-361, doi:10.1089/soro.2019.0056, search such
    rest lengths for single strings; L.-H. Chen et al., *Inclined surface locomotion strategies for
    spherical tensegrity robots*, IROS (2017), climb by several at once.

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
    planner = TippingPlanner(model, rest_length, winches, clearance, actuated)
    shape = model.structure.nodes
    if nodes is not None:
        shape = restore_bar_lengths(model.structure, model.structure.checked_nodes("nodes", nodes))
    standing = checked_feet(feet, *shape.shape)
    heading = unit_vector("direction", direction, len(shape))
    enough = (
        MARGIN * planner.size
        if margin is None
        else validation.positive_number("margin", margin, "m")
    )
    most = STEP * planner.size if step is None else validation.positive_number("step", step, "m")
    if most < _SHORTEST_STEP * planner.size:
        raise ValueError(
            f"step is {most:g} m, expected at least {_SHORTEST_STEP * planner.size:.3g} m"
        )
    edges = planner.edges(shape, standing)
    edge = max(edges, key=lambda candidate: float(edges[candidate] @ heading))
    try:
        planner.start(shape, standing, edge)
    except StuckError as error:
        raise ValueError(
            f"feet are {standing.tolist()}, on which the structure does not stand with these nodes "
            f"and this rest_length: {error}"
        ) from None
    changes = changes_of_inputs(planner.actuation, np.full(len(planner.home), most))
    points, trouble = [planner.point], None
    while planner.margin < enough and trouble is None:
        try:
            planner.advance(changes)
        except StuckError as error:
            trouble = error
        else:
            points.append(planner.point)
    lengths, shapes, margins = (np.stack(rows, axis=-1) for rows in zip(*points, strict=True))
    apart = [bar_distances(model.structure, N).least for N in np.moveaxis(shapes, 2, 0)]
    path = TippingPath(standing, np.array(edge), edges[edge], lengths, shapes, margins, min(apart))
    if trouble is not None:
        raise TippingError(
            f"margin is {enough:.3g} m, but the centre of mass comes to {path.margin.max():.3g} m "
            f"beyond the edge {path.edge.tolist()}: {trouble}. Give the winches a larger range, "
            "change the prestress, take a smaller step, or go in another direction",
            path,
        )
    return path


class StuckError(ValueError):
    """Winding cannot go on; the message says why."""


class TippingPlanner:
    """Equilibria on feet that slide without friction, wound towards an edge of their base.

    Unknowns are the positions of the nodes, and multipliers for the lengths of bars and for what
    holds the feet: each at its height, and all together in place and in their direction, by forces
    that act on all of them alike.
    """

    def __init__(
        self, model: Model, rest_length: object, winches: Winches | None, clearance: float,
        actuated: object = None,
    ) -> None:  # fmt: skip
        # Now, not within the first sample.
        import scipy.linalg.lapack
        import scipy.spatial  # noqa: F401

        validation.instance(
            "model", model, Model, "make one by Model(structure, strings=..., gravity=...)"
        )
        structure, force = model.structure, model.constant_force.sum(axis=1)
        if len(structure.fixed_rows):
            raise ValueError(
                "the structure has supports, but a rolling structure must be free: leave them out"
            )
        if model.strings is None:
            raise ValueError(
                "the model has no string law, so rest lengths have no meaning for it; build it as "
                "Model(structure, strings=LinearStrings(stiffness=...))"
            )
        weight = float(np.linalg.norm(force))
        if weight == 0:
            raise ValueError(
                "the model has no weight, so nothing tips it; build it as Model(..., gravity=9.81)"
            )
        self._structure, self.down = structure, force / weight
        self._shares = self.down @ model.constant_force / weight
        self.home = held_value(model.structure, rest_length, None)
        self.size = structure.size
        self.gravity = weight / float(structure.bar_mass.sum() + structure.point_mass.sum())
        self.actuation = actuation_of(structure, actuated, self.home)
        if winches is not None:
            validation.instance("winches", winches, Winches, "make them by Winches(rate=...)")
            winches.refuse_out_of_range("rest_length", self.home, self.actuation.driven)
        # Of the inputs, as is all that winds.
        bounds = rest_length_bounds(self.home, winches)
        self.bounds = self._low, self._high = bounds_of_inputs(self.actuation, *bounds)
        self._clearance = validation.number("clearance", clearance, "m")
        self._conditions = model.prepared.get("tipping", lambda: _conditions(model))

    @property
    def wound(self) -> FloatArray:
        """Inputs now, m."""
        return inputs_of(self.actuation, self.rest_length)

    @property
    def point(self) -> tuple[FloatArray, FloatArray, float]:
        """Rest lengths, nodes and margin, m."""
        return self.rest_length, self.nodes, self.margin

    def standing(self, nodes: FloatArray, down: FloatArray) -> tuple[IntArray, float]:
        """Return the nodes of the face that looks most downward, and how level it is."""
        return lowest_face(nodes, down, NEAR * self.size)

    def edges(self, nodes: FloatArray, feet: IntArray) -> dict[tuple[int, ...], FloatArray]:
        """Return the edges of the base, each with the horizontal direction over it."""
        d = len(nodes)
        if len(feet) == d:
            edges = list(combinations(feet.tolist(), d - 1))
        else:
            places = nearest_plane(nodes[:, feet], self.down)[1] @ nodes[:, feet]
            corners = feet[convex_hull(places)]
            pairs = (
                corners[:, None] if d == 2 else np.stack([corners, np.roll(corners, -1)], axis=1)
            )
            edges = [tuple(sorted(pair)) for pair in pairs.tolist()]
        return {edge: across_edge(nodes, feet, edge, self.down)[0] for edge in edges}

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
        up, tangents = nearest_plane(shape, self.down)
        self._up = up
        held = [np.outer(up, unit) for unit in np.eye(len(feet))]
        held += [np.outer(tangent, np.ones(len(feet))) for tangent in tangents]
        if d == 3:
            held.append(np.cross(up, (shape - shape.mean(axis=1, keepdims=True)).T).T)
        rows = np.zeros((len(held), n, d))
        rows[:, feet] = np.transpose(held, (0, 2, 1))
        self._rows = rows.reshape(len(held), n * d)
        positions = nodes.ravel(order="F")
        self._values = self._rows @ positions
        count = len(self._structure.kept_bars) + len(held)
        self._balance(np.concatenate([positions, np.zeros(count)]), self.home, _FIRST, -np.inf)

    def advance(self, most: FloatArray) -> None:
        """Go on to the next equilibrium, with inputs changed by this much at most, m.

        Raises
        ------
        StuckError
            If that brings nothing, or there is none.
        """
        uphill, actuation = self._uphill(), self.actuation
        if not actuation.is_whole:
            uphill = actuation.matrix.T @ uphill
        wound = self.wound
        low, high = wound <= self._low, wound >= self._high
        uphill[(low & (uphill < 0)) | (high & (uphill > 0))] = 0.0
        if np.linalg.norm(uphill) < _VAIN:
            raise StuckError("the winches that would move it are at the end of their range")
        change = uphill * np.min(most / np.maximum(np.abs(uphill), _VAIN**2))
        for _ in range(_HALVINGS):
            inputs = np.clip(wound + change, self._low, self._high)
            wanted = strings_of(actuation, inputs)
            slope = self._solve(self._pushes @ (self.rest_length - wanted))
            least = self.margin + _GAIN * float(uphill @ (inputs - wound))
            try:
                return self._balance(self._unknowns + slope, wanted, _NEXT, least)
            except StuckError as error:
                trouble, change = error, change / 2
        raise trouble

    def _solve(self, forces: FloatArray) -> FloatArray:
        """Return what forces on the nodes change in the unknowns."""
        from scipy.linalg.lapack import dgetrs

        right = np.zeros(len(self._unknowns))
        right[: len(forces)] = forces
        return np.asarray(dgetrs(*self._factors, right)[0])

    def _balance(
        self, unknowns: FloatArray, rest_length: FloatArray, steps: int, least: float
    ) -> None:
        """Go to the equilibrium near these unknowns, if its margin is no less than that, m."""
        from scipy.linalg.lapack import dgetrf, dgetrs

        d, n = self._structure.nodes.shape
        entries, bars = n * d, len(unknowns) - n * d - len(self._rows)
        for _ in range(steps):
            positions = unknowns[:entries]
            outputs = self._conditions(positions, rest_length, unknowns[entries : entries + bars])
            force, stretch, directions, hessian, pushes = outputs
            held = np.vstack([directions, self._rows])
            matrix = np.block([[hessian, held.T], [held, np.zeros((len(held), len(held)))]])
            left = force + held.T @ unknowns[entries:]
            residual = np.concatenate([left, stretch, self._rows @ positions - self._values])
            if not (np.isfinite(residual).all() and np.isfinite(matrix).all()):
                break
            *factors, is_singular = dgetrf(matrix)
            if is_singular:
                break
            move = -dgetrs(*factors, residual)[0]
            largest = float(np.abs(move[:entries]).max())
            unknowns = unknowns + min(1.0, _MOVE * self.size / largest) * move
            if largest < CLOSE * self.size:
                self._check(unknowns[:entries].reshape((d, n), order="F"), matrix, least)
                self._unknowns, self._factors, self._pushes = unknowns, factors, pushes
                self.rest_length = rest_length
                return
        raise StuckError("no equilibrium is found close by")

    def _check(self, nodes: FloatArray, matrix: FloatArray, least: float) -> None:
        """Keep the nodes of an equilibrium, if it is one that can be kept."""
        # As many negative eigenvalues as constraints: the energy is least.
        if np.count_nonzero(np.linalg.eigvalsh(matrix) < 0) > len(matrix) - nodes.size:
            raise StuckError("there it is not stable")
        above = np.delete(self._up @ nodes, self.feet)
        if above.min(initial=np.inf) < self._up @ nodes[:, self.feet].mean(axis=1):
            raise StuckError("another node would touch the ground first")
        apart = bar_distances(self._structure, nodes).least if self._clearance else np.inf
        if apart < self._clearance:
            raise StuckError(f"bars would come as near as {apart:.3g} m, less than clearance")
        across, _ = across_edge(nodes, self.feet, self.edge, self.down)
        margin = float(across @ (nodes @ self._shares - nodes[:, self.edge[0]]))
        if margin < least:
            raise StuckError("further winding does not move it")
        self.nodes, self.margin = nodes, margin

    def _uphill(self) -> FloatArray:
        """Return by how much each rest length moves the centre of mass over the edge."""
        across, scale = across_edge(self.nodes, self.feet, self.edge, self.down)
        slope = np.outer(across, self._shares)
        slope[:, self.edge[0]] -= across
        if len(across) == 3:
            beyond = self.nodes @ self._shares - self.nodes[:, self.edge[0]]
            turned = np.cross(self.down, beyond - (across @ beyond) * across) / scale
            slope[:, self.edge[1]] += turned
            slope[:, self.edge[0]] -= turned
        d, n = slope.shape
        return np.asarray(-self._pushes.T @ self._solve(slope.ravel(order="F"))[: d * n])


def across_edge(
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


@builds
def _conditions(model: Model) -> SharedEvaluator:
    """Return the slope of the energy with bars, their stretch, and the derivatives of both.

    ``(positions, rest lengths, multipliers) -> (slope, stretch, directions, Hessian, pushes)``,
    where the first is that of strings and weights alone, and the last by the rest lengths.
    """
    structure = model.structure
    q, rest = ca.SX.sym("q", structure.nodes.size), ca.SX.sym("rest", len(structure.strings))
    N = ca.reshape(q, *structure.nodes.shape)
    energy = ca.sum1(model.forces("rest_length").strings.stored_energy(N, rest))
    energy -= ca.dot(ca.DM(model.constant_force), N)
    B = kernel.differences(N, structure.bars[structure.kept_bars])
    stretch = (kernel.dots(B, B).T - ca.DM(structure.bar_length[structure.kept_bars] ** 2)) / 2
    lam = ca.SX.sym("lambda", stretch.numel())
    slope, directions = ca.gradient(energy, q), ca.jacobian(stretch, q)
    hessian = ca.jacobian(slope + ca.mtimes(directions.T, lam), q)
    derivatives = [slope, stretch, directions, hessian, ca.jacobian(slope, rest)]
    given = [q, rest, lam]
    return SharedEvaluator(
        Function("tipping", given, [ca.densify(expression) for expression in derivatives])
    )


def nearest_plane(shape: FloatArray, down: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the upward normal of the plane that is nearest to some nodes, and a basis of it."""
    axes = np.linalg.svd((shape - shape.mean(axis=1, keepdims=True)).T)[2]
    return -np.sign(axes[-1] @ down) * axes[-1], axes[:-1]


def checked_feet(feet: object, d: int, n: int) -> IntArray:
    """Return the nodes that a structure is to stand on, ascending."""
    nodes = np.unique(validation.index_list("feet", feet, n, "nodes"))
    if len(nodes) < d:
        raise ValueError(f"feet are {nodes.tolist()}, expected at least {d} nodes")
    return nodes
