"""Demands on a shape: positions of nodes and points, height, twist."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.fields import Array, Field, OptionalArray, converted
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.blocks import node_mass
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import left_by_supports, rigid_basis, rigid_motions

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_Nodes = Field[Sequence[int], IntArray]

# A rigid-body motion whose speed is less than this part of the largest is none.
_STILL = 1e-9

# Indices beyond are of no structure, and not all whole.
MOST_NODES = 10**9


class Demand(ABC):
    """Base class of demands on a shape; a demand with tolerance 0 is met exactly.

    Attributes
    ----------
    tolerance : float
        How far off the numbers may be, m or rad: see ``unit``.
    unit : str
        Of the numbers and the tolerance, ``"m"`` or ``"rad"``.
    """

    tolerance: float
    unit: ClassVar[str] = "m"
    _dimension: int | None = None  # of the structures that it fits, None for any
    _node_lists: ClassVar[tuple[str, ...]]  # the fields that name nodes
    _numbers: ClassVar[str]  # the field that holds the demanded numbers

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"

    def __post_init__(self) -> None:
        put = object.__setattr__  # the dataclasses are frozen for everyone else
        for name in self._node_lists:
            put(self, name, node_list(name, getattr(self, name)))
        for name, value in self._checked().items():
            put(self, name, value)
        tolerance = validation.number("tolerance", self.tolerance, self.unit)
        if tolerance < 0:
            raise ValueError(f"tolerance is {tolerance:g} {self.unit}, expected at least 0")
        put(self, "tolerance", tolerance)

    @abstractmethod
    def _checked(self) -> dict[str, object]:
        """Return the fields beside node lists and tolerance, checked."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """A name for each demanded number."""

    @property
    def wanted(self) -> FloatArray:
        """The demanded numbers, m or rad, shape (k,); places node by node."""
        return np.ravel(getattr(self, self._numbers), order="F")

    @abstractmethod
    def miss(self, N: Any) -> Any:
        """Return found less demanded numbers, shape (k, 1).

        Parameters
        ----------
        N : casadi.SX, shape (d, n)
            Node positions, m.
        """

    def refuse_other_nodes(self, name: str, structure: Structure) -> None:
        """Raise if a node that is named is not one of the structure, or a direction is not.

        Parameters
        ----------
        name : str
            What the message calls the demand.
        structure : Structure
        """
        validation.instance(
            "structure", structure, Structure, "make one by Structure(...) or prism(...)"
        )
        count = structure.nodes.shape[1]
        for field in self._node_lists:
            validation.indices(
                f"{name}.{field}", getattr(self, field), count, f"there are {count} nodes"
            )
        if self._dimension not in (None, structure.dimension):
            where = {2: "in the plane", 3: "in space"}
            raise ValueError(
                f"{name} is for nodes {where[self._dimension or 3]}, but those of the structure "
                f"are {where[structure.dimension]}: give as many coordinates, or name those asked "
                "for by directions"
            )


@final
@dataclass(frozen=True, eq=False)
class NodesAt(Demand):
    """Demand: the positions of some nodes.

    Parameters
    ----------
    nodes : sequence of int, length k
        The nodes.
    positions : array_like, shape (d, k)
        Where they are to be, m: a row for each of the directions.
    directions : str, optional
        Which coordinates are asked for: letters out of ``"xyz"``. All of them if not given, "xy" in
        the plane.
    tolerance : float
        How far off each coordinate may be, m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    The bottom of a prism on the ground, wherever it stands there:

    >>> import tenscontrol as tc
    >>> tc.NodesAt([3, 4, 5], [[0, 0, 0]], directions="z").names
    ('z[3]', 'z[4]', 'z[5]')
    """

    nodes: _Nodes = converted()
    positions: Array = converted()
    directions: Field[str | None, str] = converted(None)
    tolerance: float = 0.0
    _node_lists = ("nodes",)
    _numbers = "positions"

    __repr__ = short_repr

    def _checked(self) -> dict[str, object]:
        positions = validation.float_array("positions", self.positions)
        directions, dimension = _directions(self.directions, positions)
        shape = (len(directions), len(self.nodes))
        meaning = "a row for each of directions, a column for each of nodes"
        positions = validation.shaped("positions", positions, shape, meaning)
        return {
            "positions": frozen(positions), "directions": directions, "_dimension": dimension
        }  # fmt: skip

    @property
    def names(self) -> tuple[str, ...]:
        """``"x[0]"`` and so on, node by node."""
        return tuple(f"{axis}[{i}]" for i in self.nodes for axis in self.directions)

    def miss(self, N: Any) -> Any:
        """Return found less wanted coordinates."""
        coordinates = N[_axis_rows(self.directions), self.nodes.tolist()]
        return ca.vec(coordinates) - ca.DM(self.wanted)


@final
@dataclass(frozen=True, eq=False)
class PointAt(Demand):
    """Demand: the position of a point of the structure, the mean of some nodes.

    Parameters
    ----------
    nodes : sequence of int, length k
        Nodes whose weighted mean the point is: the two ends of a bar for its
        centre, the top nodes of a prism for the centre of its top.
    position : array_like, shape (d,)
        Where it is to be, m.
    weights : array_like, shape (k,), optional
        Weight of each node; equal if not given. Their sum must not be 0.
    directions : str, optional
        Which coordinates are asked for: letters out of ``"xyz"``. All of them if not given, "xy" in
        the plane.
    tolerance : float
        How far off each coordinate may be, m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.shape.PointAt([0, 1, 2], [0.1, 0.0], directions="xy").names
    ('x of point', 'y of point')
    """

    nodes: _Nodes = converted()
    position: Array = converted()
    weights: Field[ArrayLike | None, FloatArray] = converted(None)
    directions: Field[str | None, str] = converted(None)
    tolerance: float = 0.0
    _node_lists = ("nodes",)
    _numbers = "position"

    __repr__ = short_repr

    def _checked(self) -> dict[str, object]:
        position = validation.float_array("position", self.position)
        directions, dimension = _directions(self.directions, position)
        position = validation.shaped(
            "position", position, (len(directions),), "one for each of directions"
        )
        given: Any = self.weights
        weights = np.ones(len(self.nodes)) if given is None else given
        weights = validation.shaped("weights", weights, (len(self.nodes),), "one for each of nodes")
        if abs(weights.sum()) <= 1e-12 * np.abs(weights).sum():
            raise ValueError(f"weights add up to {weights.sum():g}, expected another sum than 0")
        return {
            "position": frozen(position), "weights": frozen(weights / weights.sum()),
            "directions": directions, "_dimension": dimension,
        }  # fmt: skip

    @property
    def names(self) -> tuple[str, ...]:
        """``"x of point"`` and so on."""
        return tuple(f"{axis} of point" for axis in self.directions)

    def miss(self, N: Any) -> Any:
        """Return found less wanted place."""
        point = ca.mtimes(N[:, self.nodes.tolist()], ca.DM(self.weights))
        return point[_axis_rows(self.directions)] - ca.DM(self.position)


@final
@dataclass(frozen=True, eq=False)
class Height(Demand):
    """Demand: the distance between the centres of two sets of nodes along an axis.

    Parameters
    ----------
    height : float
        m; from ``bottom`` to ``top`` along the axis.
    top, bottom : sequence of int
        The nodes whose means are the centres.
    axis : array_like, shape (d,), optional
        Direction; its length plays no part. Upwards if not given: z, or y in the plane.
    tolerance : float
        m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> low = tc.Height(0.85, top=[0, 1, 2], bottom=[3, 4, 5])
    >>> target = tc.shape_target(tc.Model(tc.prism()), low, force_density=10.0)
    >>> target.nodes[2].round(3)
    array([0.925, 0.925, 0.925, 0.075, 0.075, 0.075])
    """

    height: float
    top: _Nodes = converted()
    bottom: _Nodes = converted()
    axis: OptionalArray = converted(None)
    tolerance: float = 0.0
    _node_lists = ("top", "bottom")
    _numbers = "height"

    __repr__ = short_repr

    def _checked(self) -> dict[str, object]:
        height = validation.number("height", self.height, "m")
        if self.axis is None:
            return {"height": height}
        axis = validation.float_array("axis", self.axis)
        axis = validation.direction("axis", axis, 2 if axis.shape == (2,) else 3)
        return {"height": height, "axis": frozen(axis), "_dimension": len(axis)}

    @property
    def names(self) -> tuple[str, ...]:
        """``("height",)``."""
        return ("height",)

    def miss(self, N: Any) -> Any:
        """Return found less wanted height."""
        apart = _centre(N, self.top) - _centre(N, self.bottom)
        if self.axis is None:
            return apart[-1] - ca.DM(self.height)
        return ca.dot(ca.DM(self.axis), apart) - ca.DM(self.height)


@final
@dataclass(frozen=True, eq=False)
class Twist(Demand):
    """Demand: the rotation of one set of nodes against another about the line of their centres.

    Positive for a right-handed screw, whichever set is the top. A right-handed :func:`prism` has
    ``π/2 − π/q``, a left-handed one the negative of it. In the plane it is the angle from the
    bottom to the top set, positive counterclockwise.

    Parameters
    ----------
    angle : float
        rad, at most a whole turn.
    top, bottom : sequence of int, length k
        Nodes in pairs: the turn that brings the k-th of ``bottom`` in line
        with the k-th of ``top``, in the mean of least squares.
    tolerance : float
        rad.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> turned = tc.Twist(np.radians(-25.0), top=[0, 1, 2], bottom=[3, 4, 5])
    >>> turned.names, turned.unit
    (('twist',), 'rad')
    """

    angle: float
    top: _Nodes = converted()
    bottom: _Nodes = converted()
    tolerance: float = 0.0
    unit = "rad"
    _node_lists = ("top", "bottom")
    _numbers = "angle"

    __repr__ = short_repr

    def _checked(self) -> dict[str, object]:
        if len(self.top) != len(self.bottom) or len(self.top) < 2:
            raise ValueError(
                f"top has {len(self.top)} nodes and bottom {len(self.bottom)}, "
                "expected as many of each, two at least: they are compared in pairs"
            )
        angle = validation.number("angle", self.angle, "rad")
        if abs(angle) > 2 * np.pi:
            raise ValueError(
                f"angle is {angle:g} rad, more than a whole turn; angles are in radians: for "
                f"degrees give np.radians({angle:g}) = {np.radians(angle):.4g}"
            )
        return {"angle": angle}

    @property
    def names(self) -> tuple[str, ...]:
        """``("twist",)``."""
        return ("twist",)

    def miss(self, N: Any) -> Any:
        """Return found less wanted angle, between −π and π."""
        upper, lower = _centre(N, self.top), _centre(N, self.bottom)
        if N.shape[0] == 2:
            line, zero = ca.DM([0, 0, 1]), ca.DM.zeros(1)
            N = ca.vertcat(N, ca.repmat(zero, 1, N.shape[1]))
            upper, lower = ca.vertcat(upper, zero), ca.vertcat(lower, zero)
        else:
            line = (upper - lower) / ca.norm_2(upper - lower)
        sine, cosine = ca.SX(0), ca.SX(0)
        for i, j in zip(self.top.tolist(), self.bottom.tolist(), strict=True):
            t, b = N[:, i] - upper, N[:, j] - lower
            sine += ca.dot(line, ca.cross(b, t))
            cosine += ca.dot(b, t) - ca.dot(line, b) * ca.dot(line, t)
        s, c = float(np.sin(self.angle)), float(np.cos(self.angle))
        # Turned back by the wanted angle, so that no jump is near.
        return ca.atan2(c * sine - s * cosine, c * cosine + s * sine)


@final
@dataclass(frozen=True, eq=False)
class CentreKept(Demand):
    """No part of the way from a shape is a rigid-body motion that the supports leave.

    Internal forces leave momenta at zero: the centre of mass stays, and as far as the way is
    straight, the structure does not turn.
    """

    start: FloatArray  # (d, n), m
    motions: FloatArray  # (k, d n): what a displacement has of each motion, m
    names: tuple[str, ...] = ()  # a field in place of the property
    tolerance: float = 0.0
    _node_lists = ()

    def _checked(self) -> dict[str, object]:
        return {}

    @property
    def wanted(self) -> FloatArray:
        """Zero for each motion."""
        return np.zeros(len(self.motions))

    def miss(self, N: Any) -> Any:
        """Return the part of the way along each motion."""
        return ca.mtimes(ca.DM(self.motions), ca.vec(N) - ca.DM(self.start.ravel(order="F")))


def checked_demands(name: str, value: object, structure: Structure) -> tuple[Demand, ...]:
    """Return demands on a structure as a tuple, from one, a sequence of them or None."""
    wanted: Any = (value,) if isinstance(value, Demand) else () if value is None else value
    if not isinstance(wanted, Sequence) or isinstance(wanted, str):
        how = "a demand or a sequence of them: NodesAt, PointAt, Height, Twist"
        raise validation.wrong_kind(name, value, how)
    for i, demand in enumerate(wanted):
        validation.instance(f"{name}[{i}]", demand, Demand, "NodesAt, PointAt, Height or Twist")
        demand.refuse_other_nodes(f"{name}[{i}]", structure)
    return tuple(wanted)


def centre_kept(structure: Structure, start: FloatArray) -> tuple[CentreKept, ...]:
    """Return the demand that internal forces can bring the structure from this shape, at rest.

    Empty where the supports leave no rigid-body motion.
    """
    if not rigid_basis(structure).shape[1]:
        return ()
    d, n = start.shape
    fields = left_by_supports(structure, rigid_motions(start))
    mass = node_mass(structure).toarray()
    factor = np.linalg.cholesky(mass).T
    # Orthonormal in the mass, one after the other: turns are about the centre of mass.
    weighted = (factor @ fields.reshape(n, -1)).reshape(fields.shape)
    sizes = np.abs(np.diagonal(np.linalg.qr(weighted, mode="r")))
    moves = sizes > _STILL * sizes.max()
    motions = np.linalg.qr(weighted[:, moves])[0]
    motions = (factor.T @ motions.reshape(n, -1)).reshape(motions.shape) / np.sqrt(mass.sum())
    names = [f"centre of mass along {axis}" for axis in "xyz"[:d]]
    names += [f"turn about {axis}" for axis in ("xyz" if d == 3 else "z")]
    if len(structure.fixed_rows):
        names = [f"motion {i} left by the supports" for i in range(fields.shape[1])]
    chosen = tuple(f"{names[i]}, from start," for i in np.flatnonzero(moves))
    return (CentreKept(start, motions.T, chosen),)


def node_list(name: str, nodes: object) -> IntArray:
    """Return node indices, at least one and each once; those of a set or a mask ascending."""
    array = validation.index_array(name, nodes)
    if len(array) == 0:
        raise ValueError(f"{name} has shape {array.shape}, expected (k,): indices of nodes")
    validation.refuse_fractions(name, array)
    for i, node in enumerate(array.tolist()):
        if not 0 <= node <= MOST_NODES:
            raise ValueError(
                f"{name}[{i}] is {node:g}, expected 0 to {MOST_NODES}: nodes count from 0"
            )
    known, counts = np.unique(array, return_counts=True)
    if (counts > 1).any():
        raise ValueError(f"{name} has node {known[counts.argmax()]:g} twice")
    return frozen(array.astype(np.int64))


def _directions(directions: Any, places: FloatArray) -> tuple[str, int | None]:
    """Return the letters, and the dimension of the structures that they fit, None for any.

    If none are given, those of a place in space or in the plane, by the rows of places.
    """
    if directions is None:
        d = 2 if len(np.atleast_1d(places)) == 2 else 3
        return "xyz"[:d], d
    _axis_rows(directions)
    return directions, 3 if "z" in directions else None


def _axis_rows(directions: str) -> list[int]:
    """Return the rows of N that the letters name, or raise if they are not out of "xyz"."""
    fits = isinstance(directions, str) and directions and not set(directions) - set("xyz")
    if not fits or len(set(str(directions))) < len(str(directions)):
        raise ValueError(f"directions is {directions!r}, expected letters out of 'xyz', each once")
    return ["xyz".index(axis) for axis in directions]


def _centre(N: Any, nodes: IntArray) -> Any:
    return ca.sum2(N[:, nodes.tolist()]) / len(nodes)
