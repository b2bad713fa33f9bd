"""A structure as a tree of rigid bodies with joints, as MuJoCo describes mechanisms."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.structure.structure import Structure

#: The parent of bodies that hang on nothing, and the home of fixed nodes.
WORLD = -1

# A planar structure is put into the plane of x and z, so that up is up in a viewer. A turn from x
# to z is one about -y.
_PLANE = [0, 2]
_OUT_OF_PLANE = np.array([0.0, -1.0, 0.0])


def in_space(vectors: FloatArray) -> FloatArray:
    """Return columns in space, shape (3, k), of columns in space or in the plane, (d, k)."""
    if len(vectors) == 3:
        return vectors
    columns = np.zeros((3, vectors.shape[1]))
    columns[_PLANE] = vectors
    return columns


def axes_of(dimension: int) -> FloatArray:
    """Return the axes x, y and z, or x and y, of a structure as rows in space, shape (d, 3)."""
    return in_space(np.eye(dimension)).T


@dataclass(frozen=True)
class Joint:
    """One of ``free``, ``ball``, ``hinge`` and ``slide``; the last two have an axis."""

    kind: str
    axis: FloatArray = field(default_factory=lambda: np.zeros(3))

    @property
    def freedoms(self) -> int:
        """The number of velocities."""
        return {"free": 6, "ball": 3}.get(self.kind, 1)


@dataclass(frozen=True)
class Body:
    """A bar, or a string node where ``bar`` is None; axes are those of space in the start.

    ``pivot`` is the node at its origin; a bar that floats has None, and its centre there.
    """

    name: str
    parent: int
    bar: int | None
    pivot: int | None
    origin: FloatArray  # (3,), m, in space
    joints: tuple[Joint, ...]
    mass: float
    centre: FloatArray  # of mass, from the origin, m
    inertia: float  # about any axis through the centre of mass, kg m²
    nodes: list[int] = field(default_factory=list)  # those that are its own


@dataclass(frozen=True)
class KinematicTree:
    """Bodies, each followed by all that hangs on it, and the joints that close loops.

    A bar hangs on the fixed node, the roller or the bar from which it is reached. ``home`` is the
    body that each node is part of. ``loops`` are triples of a node and the two bodies that are
    joined there beside the tree. A thin bar has no inertia about its axis; it is given that across
    the axis, so that inertia is a number, and spin, which nothing changes, costs no term.
    """

    structure: Structure
    start: FloatArray  # (3, n), m
    bodies: tuple[Body, ...]
    home: tuple[int, ...]
    loops: tuple[tuple[int, int, int], ...]

    @staticmethod
    def of(structure: Structure, nodes: FloatArray) -> KinematicTree:
        """Return the tree of a structure in a shape, m, shape (d, n).

        ValueError if a roller has no body of its own: both of its bar's ends are held.
        """
        return _Growth(structure, in_space(nodes)).grown()

    def joint_velocities(self, velocities: FloatArray) -> FloatArray:
        """Return the velocities of the joints from those of the nodes, m/s, shape (d, n).

        Bars do not spin. Angular velocities are in rad/s, of a body relative to its parent.
        """
        V, spins, rates = in_space(velocities), np.zeros((len(self.bodies) + 1, 3)), []
        for i, body in enumerate(self.bodies):
            if body.bar is not None:
                start, end = self.structure.bars[body.bar]
                arm = self.start[:, end] - self.start[:, start]
                spins[i] = np.cross(arm, V[:, end] - V[:, start]) / (arm @ arm)
                centre = 0.5 * (V[:, start] + V[:, end])
            turning = spins[i] - spins[body.parent]  # the last row is the world's
            velocity = centre if body.pivot is None else V[:, body.pivot]
            for joint in body.joints:
                if joint.kind == "slide":
                    rates.append([joint.axis @ velocity])
                elif joint.kind == "hinge":
                    rates.append([joint.axis @ turning])
                else:
                    rates.append([*velocity, *turning] if joint.kind == "free" else turning)
        return np.concatenate(rates) if rates else np.zeros(0)

    def start_coordinates(self) -> FloatArray:
        """Return the coordinates of the joints in the start, with unit quaternions."""
        still = [1.0, 0.0, 0.0, 0.0]
        coordinates = [
            [*body.origin, *still] if joint.kind == "free" else
            still if joint.kind == "ball" else [0.0]
            for body in self.bodies for joint in body.joints
        ]  # fmt: skip
        return np.concatenate(coordinates) if coordinates else np.zeros(0)

    def inverse_weights(self) -> FloatArray:
        """Return how far a unit force moves each body's centre of mass, 1/kg: the mean over axes.

        In the start, with joints of the tree only. MuJoCo scales its contacts by it.
        """
        count = sum(joint.freedoms for body in self.bodies for joint in body.joints)
        moves, turns = (np.zeros((len(self.bodies) + 1, 3, count)) for _ in range(2))
        mass, centres = np.zeros((count, count)), []
        column = 0
        for i, body in enumerate(self.bodies):
            if body.parent != WORLD:
                apart = body.origin - self.bodies[body.parent].origin
                turns[i] = turns[body.parent]
                moves[i] = moves[body.parent] + _crossed(turns[i], apart)
            for joint in body.joints:
                here = slice(column, column + joint.freedoms)
                if joint.kind == "slide":
                    moves[i][:, column] = joint.axis
                elif joint.kind == "hinge":
                    turns[i][:, column] = joint.axis
                else:
                    own = np.eye(joint.freedoms)
                    moves[i][:, here] = own[:3] if joint.kind == "free" else 0.0
                    turns[i][:, here] = own[-3:]
                column += joint.freedoms
            centres.append(moves[i] + _crossed(turns[i], body.centre))
            mass += body.mass * centres[i].T @ centres[i] + body.inertia * turns[i].T @ turns[i]
            for node in body.nodes:
                carried = 0.0 if body.bar is None else self.structure.point_mass[node]
                jacobian = moves[i] + _crossed(turns[i], self.start[:, node] - body.origin)
                mass += carried * jacobian.T @ jacobian
        inverse = [np.trace(J @ np.linalg.solve(mass, J.T)) / 3 if count else 0.0 for J in centres]
        return np.array(inverse)


def _crossed(turns: FloatArray, arm: FloatArray) -> FloatArray:
    """Return ω × arm of each column."""
    return np.asarray(np.cross(turns, arm, axis=0) if turns.size else turns)


class _Growth:
    """Bodies found from the supports outward, then from a first bar of what floats."""

    def __init__(self, structure: Structure, start: FloatArray) -> None:
        self.structure, self.start = structure, start
        self.bodies: list[Body] = []
        self.loops: list[tuple[int, int, int]] = []
        self.home: dict[int, int] = {int(node): WORLD for node in structure.fixed}
        self.held: dict[int, set[int]] = {}
        for node, axis in structure.rollers:
            self.held.setdefault(node, set()).add("xyz".index(axis))
        both = np.isin(structure.bars, structure.fixed).all(axis=1)
        self.left = dict.fromkeys(np.flatnonzero(~both).tolist())
        self.bars_at: dict[int, list[int]] = {}
        for bar in self.left:
            for node in structure.bars[bar].tolist():
                self.bars_at.setdefault(node, []).append(bar)
        self.turning = Joint("ball") if structure.dimension == 3 else Joint("hinge", _OUT_OF_PLANE)

    def grown(self) -> KinematicTree:
        """Return the whole tree."""
        self._spread(deque(self._on_rollers()))
        self._spread(deque(self.structure.fixed.tolist()))
        while self.left:
            self._spread(deque(self._floating(next(iter(self.left)))))
        for node in self.structure.string_nodes.tolist():
            mass = float(self.structure.point_mass[node])
            self._add(f"node{node}", WORLD, None, node, self._slides(node), mass)
        order = self._depth_first()
        number = {old: new for new, old in enumerate(order)} | {WORLD: WORLD}
        bodies = (self.bodies[old] for old in order)
        return KinematicTree(
            self.structure,
            self.start,
            tuple(replace(body, parent=number[body.parent]) for body in bodies),
            tuple(number[self.home[node]] for node in range(self.structure.nodes.shape[1])),
            tuple((node, number[one], number[other]) for node, one, other in self.loops),
        )

    def _depth_first(self) -> list[int]:
        """Return the order of the bodies in which each is followed by all that hangs on it."""
        children: dict[int, list[int]] = {}
        for i, body in enumerate(self.bodies):
            children.setdefault(body.parent, []).append(i)
        order, stack = [], children.get(WORLD, [])[::-1]
        while stack:
            order.append(stack.pop())
            stack += children.get(order[-1], [])[::-1]
        return order

    def _slides(self, node: int) -> tuple[Joint, ...]:
        """Return the joints by which a node moves along the axes that no roller holds."""
        held = self.held.get(node, ())
        axes = enumerate(axes_of(self.structure.dimension))
        return tuple(Joint("slide", axis) for i, axis in axes if i not in held)

    def _on_rollers(self) -> list[int]:
        """Put a bar on each roller, and return the nodes where more can hang."""
        reached: list[int] = []
        nodes = [node for node in self.held if node in self.bars_at]
        for node in nodes:
            free = [bar for bar in self.bars_at[node] if bar in self.left]
            if not free:
                raise ValueError(
                    f"node {node} is on a roller, and its bars end on supports at both ends; a "
                    "mechanism of joints has no place for it: give one of the ends a bar more, or "
                    "leave out the roller"
                )
            # A bar whose other end is on no support leaves other supports theirs.
            bar = min(free, key=lambda b: self._other(b, node) in (*nodes, *self.structure.fixed))
            reached += self._hang(bar, node, WORLD, (*self._slides(node), self.turning))
        return reached

    def _floating(self, bar: int) -> list[int]:
        free: tuple[Joint, ...] = (Joint("free"),)
        if self.structure.dimension == 2:
            free = (*(Joint("slide", axis) for axis in axes_of(2)), self.turning)
        return self._hang(bar, None, WORLD, free)

    def _spread(self, queue: deque[int]) -> None:
        """Hang bars on nodes, and on their other ends, until none is reached any more."""
        while queue:
            node = queue.popleft()
            for bar in self.bars_at.get(node, ()):
                if bar in self.left:
                    queue.extend(self._hang(bar, node, self.home[node], (self.turning,)))

    def _hang(
        self, bar: int, pivot: int | None, parent: int, joints: tuple[Joint, ...]
    ) -> list[int]:
        """Add the body of a bar; return its ends that were reached for the first time."""
        del self.left[bar]
        mass = float(self.structure.bar_mass[bar])
        self._add(f"bar{bar}", parent, bar, pivot, joints, mass)
        ends = [node for node in self.structure.bars[bar].tolist() if node != pivot]
        if pivot is not None and pivot not in self.home:
            ends.append(pivot)
        this, new = len(self.bodies) - 1, []
        for node in ends:
            if node in self.home:
                self.loops.append((node, this, self.home[node]))
            else:
                self.home[node] = this
                self.bodies[this].nodes.append(node)
                new.append(node)
        return new

    def _add(
        self, name: str, parent: int, bar: int | None, pivot: int | None,
        joints: tuple[Joint, ...], mass: float,
    ) -> None:  # fmt: skip
        if bar is None:
            assert pivot is not None  # a string node is its own
            self.home[pivot] = len(self.bodies)
            origin, centre, inertia, nodes = self.start[:, pivot], np.zeros(3), 0.0, [pivot]
        else:
            ends = self.start[:, self.structure.bars[bar]]
            middle, nodes = ends.mean(axis=1), []
            origin = middle if pivot is None else self.start[:, pivot]
            centre, inertia = middle - origin, mass * self.structure.bar_length[bar] ** 2 / 12
        self.bodies.append(
            Body(name, parent, bar, pivot, origin, joints, mass, centre, inertia, nodes)
        )

    def _other(self, bar: int, node: int) -> int:
        start, end = self.structure.bars[bar].tolist()
        return int(end if node == start else start)
