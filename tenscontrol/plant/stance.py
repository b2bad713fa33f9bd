"""Stances: equilibria on the ground."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.dynamics.contact_laws import Contacts
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.dynamics.model import Model
from tenscontrol.properties import cached_property
from tenscontrol.short_repr import short_repr
from tenscontrol.statics.equilibrium_matrix import least_norm, sparse_equilibrium_matrix
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.blocks import bar_rows
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import free_coordinates, rigid_motions

if TYPE_CHECKING:
    from scipy.sparse import csc_array

# Nodes this near the ground touch it, and shapes that are set down end so near, by their size.
_TOUCHING, _LANDED, _STEPS = 1e-6, 1e-12, 50

# Singular values of what bars resist below which sticking ends would strain them.
_FLAT = 0.05

# Parts of the friction cone, and of the largest contact force, beyond and below which a contact
# is no support.
_SLIPS, _PRESSES = 0.99, 1e-3


@dataclass(frozen=True, eq=False)
class StanceContacts:
    """The contacts of a stance, c of them: a node in two grounds has two.

    Attributes
    ----------
    node : ndarray of int, shape (c,)
    ground : ndarray of int, shape (c,)
        Which law of ``model.ground``.
    depth : ndarray, shape (c,)
        m.
    normal : ndarray, shape (d, c)
        Unit vectors away from the ground.
    normal_force : ndarray, shape (c,)
        F_n, N, positive.
    tangential_force : ndarray, shape (d, c)
        F_t, N, of the ground on the node.
    cone_use : ndarray, shape (c,)
        ``|F_t|/(μ F_n)``, at most 1; 1 where there is no friction.
    """

    node: IntArray
    ground: IntArray
    depth: FloatArray
    normal: FloatArray
    normal_force: FloatArray
    tangential_force: FloatArray
    cone_use: FloatArray

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def force(self) -> FloatArray:
        """Force of the ground on the node of each contact, N, shape (d, c)."""
        return np.asarray(self.normal * self.normal_force + self.tangential_force)


@dataclass(frozen=True)
class Tipping:
    """Margin of a stance against tipping over an edge of its support polygon.

    Attributes
    ----------
    margin : float
        Distance, m, of the line of action of the load from the nearest edge, both projected along
        that line; negative outside. Of weights alone it goes through the centre of mass.
    edge : tuple of int
        The two nodes of that edge; in the plane the one node.
    angle : float
        Angle, rad, by which ground and stance may be tilted together about that edge.
    """

    margin: float
    edge: tuple[int, ...]
    angle: float


@dataclass(frozen=True, eq=False, repr=False)
class Stance(Prestress):
    """A structure at rest on the ground. Made by :func:`equilibrium` for a model with ground.

    Its ``external_force`` is all that acts, the forces of the ground among it.

    Attributes
    ----------
    structure, force_density, bar_force_density : see :class:`~tenscontrol.statics.Prestress`
    external_force, residual, self_stress_states, mechanisms, crossings : see there
        Self-stress and mechanisms are those of the structure without its contacts.
    contacts : StanceContacts
    least_stiffness : float
        Least eigenvalue of the tangent stiffness in the free coordinates with bar lengths and
        sticking places kept, N/m: positive where every small push meets resistance, 0 where the
        stance slides or turns freely. A stance with less is not returned.
    """

    contacts: StanceContacts
    least_stiffness: float

    def __repr__(self) -> str:
        feet = np.unique(self.contacts.node).tolist()
        return f"Stance({self.structure!r} on nodes {feet}, residual {self.residual:.1e} N)"

    @property
    def load(self) -> FloatArray:
        """Weights and loads without the forces of the ground, N, shape (d, n)."""
        load = self.external_force.copy()
        np.subtract.at(load.T, self.contacts.node, self.contacts.force.T)
        return load

    @cached_property
    def tipping(self) -> Tipping | None:
        """Margin against tipping; None if supports hold the structure, or no load presses it down.

        Edges are those of the contacts whose normals oppose the load.
        """
        load, N = self.load, self.structure.nodes
        resultant = load.sum(axis=1)
        size = float(np.linalg.norm(resultant))
        if len(self.structure.fixed_rows) or size <= _LANDED * np.abs(load).sum():
            return None
        fall = resultant / size
        below = self.contacts.node[fall @ self.contacts.normal < 0]
        if not len(below):
            return None
        # The line of action goes through this point.
        centre = N @ (fall @ load) / size
        turning = (N - centre[:, None]) @ load.T
        centre = centre + (turning - turning.T) @ fall / size
        return _tipping(N[:, below] - centre[:, None], below, fall)


def _tipping(feet: FloatArray, nodes: IntArray, fall: FloatArray) -> Tipping:
    """Return the margin; feet, shape (d, c), are relative to the centre, ``fall`` a unit vector."""
    across = np.linalg.svd(fall[:, None])[0][:, 1:]
    flat, deep = across.T @ feet, fall @ feet
    if len(fall) == 2:
        ends = convex_hull(flat).tolist()
        distance = np.array([-flat[0, ends[0]], flat[0, ends[1]]])
        least = int(distance.argmin())
        foot, margin = ends[least], float(distance[least])
        return Tipping(margin, (int(nodes[foot]),), float(np.arctan2(margin, deep[foot])))
    hull = convex_hull(flat)
    following = np.roll(hull, -1)
    edges = flat[:, following] - flat[:, hull]
    length = np.hypot(*edges)
    inward = np.stack([-edges[1], edges[0]]) / np.where(length > 0, length, 1.0)
    distance = -(inward * flat[:, hull]).sum(axis=0)
    least = int(distance.argmin())
    start, end, margin = int(hull[least]), int(following[least]), float(distance[least])
    # About the edge in space, from where the centre is to where it is above the edge.
    axis = feet[:, end] - feet[:, start]
    norm = float(np.linalg.norm(axis))
    axis = axis / norm if norm > 0 else axis
    up, arm = (vector - axis * (axis @ vector) for vector in (-fall, -feet[:, start]))
    height = float(up @ arm) / float(np.linalg.norm(up))
    return Tipping(margin, (int(nodes[start]), int(nodes[end])), float(np.arctan2(margin, height)))


def convex_hull(points: FloatArray) -> IntArray:
    """Return the corners of the convex hull of points, shape (2, c), counterclockwise.

    Of points on a line, shape (1, c), the lowest and the highest.
    """
    if len(points) == 1:
        return np.array([points.argmin(), points.argmax()])
    order = np.lexsort(points[::-1]).tolist()
    size = float(np.ptp(points, axis=1).max(initial=0.0)) ** 2

    def chain(indices: list[int]) -> list[int]:
        corners: list[int] = []
        for i in indices:
            while len(corners) > 1:
                a, b = np.diff(points[:, [*corners[-2:], i]]).T
                if a[0] * b[1] - a[1] * b[0] > _LANDED * size:
                    break
                corners.pop()
            corners.append(i)
        return corners[:-1]

    return np.array(chain(order) + chain(order[::-1]) or order[:1])


@dataclass(frozen=True, eq=False)
class GroundPoints:
    """Where nodes are to the ground, law by law, and the normal forces on them at rest."""

    node: IntArray
    ground: IntArray
    depth: FloatArray  # (k,), m
    normal: FloatArray  # (d, k), unit vectors
    force: FloatArray  # (k,), N
    friction: FloatArray  # (k,)

    @classmethod
    def of(cls, model: Model, nodes: FloatArray) -> GroundPoints:
        """Return the points of a shape."""
        contacts = model.contacts
        assert contacts is not None  # asked for where there is ground
        function = model.prepared.get("ground points", lambda: _ground_function(model, contacts))
        outputs = np.array(function(nodes).full())
        normal, force = outputs[2:], outputs[1]
        size = np.linalg.norm(normal, axis=0)
        count = [len(node) for node in contacts.nodes]
        return cls(
            np.concatenate(contacts.nodes),
            np.repeat(np.arange(len(count)), count),
            outputs[0],
            normal / size,
            force * size,
            np.repeat([law.friction for law in contacts.laws], count),
        )

    def at(self, which: np.ndarray) -> GroundPoints:
        """Return some of the points."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return GroundPoints(**{name: value[..., which] for name, value in values.items()})

    @property
    def pressing(self) -> GroundPoints:
        """Those with a force."""
        return self.at(self.force > 0)

    def touching(self, size: float) -> GroundPoints:
        """Return those that touch before their forces are known, as if all had the same.

        They have some force already, or are almost at the ground, of a structure of this size, m.
        """
        touching = self.at((self.force > 0) | (self.depth >= -_TOUCHING * size))
        return replace(touching, force=np.ones(len(touching.node)))

    @property
    def grip(self) -> FloatArray:
        """The most that friction holds at each, μ F_n, N."""
        return np.asarray(self.friction * self.force)

    @property
    def gripping(self) -> set[int]:
        """The nodes that meet friction."""
        return set(self.node[self.friction > 0].tolist())

    def agrees(self, other: GroundPoints, settling: bool) -> bool:
        """Return whether others are the same, with the same normals, and shares of the friction."""
        if not (
            np.array_equal(self.node, other.node) and np.array_equal(self.ground, other.ground)
        ):
            return False
        off = np.abs(self.normal - other.normal).max(initial=0.0)
        change = np.abs(self.grip - other.grip).max(initial=0.0)
        shares = not settling or change <= _TOUCHING * self.grip.max(initial=0.0)
        return bool(off <= _LANDED and shares)


def _ground_function(model: Model, contacts: Contacts) -> ca.Function:
    """Return ``N -> [depth; factor of the normal force; direction]``, one column a point."""
    N, columns = ca.SX.sym("N", *model.structure.nodes.shape), []
    for law, nodes, _ in contacts:
        positions = N[:, nodes.tolist()]
        depth, rate, away = law.sinking(positions, 0 * positions)
        gap = law.gap(depth, 0 * rate)
        pressing = 1 if gap is None else gap > 0
        columns.append(ca.vertcat(depth, pressing * law.normal_force(depth, 0 * rate), away))
    return Function("ground_points", [N], [ca.densify(ca.horzcat(*columns))])


def let_down(model: Model, start: FloatArray, load: FloatArray) -> FloatArray:
    """Return the nodes moved along the resultant of the load until one of them touches.

    As they are where one touches already, where supports hold the structure, or nothing pulls it.
    """
    structure, resultant = model.structure, load.sum(axis=1)
    size = float(np.ptp(start, axis=1).max())
    points = GroundPoints.of(model, start)
    way = float(np.linalg.norm(resultant))
    is_held = len(structure.fixed_rows) > 0 or way <= _LANDED * np.abs(load).sum()
    if is_held or (points.force > 0).any() or points.depth.max() >= -_TOUCHING * size:
        return start
    fall, nodes = resultant / way, start
    for _ in range(_STEPS):
        points = GroundPoints.of(model, nodes)
        rate = -fall @ points.normal
        meets = rate > 0
        if not meets.any():
            break
        way = float((-points.depth[meets] / rate[meets]).min())
        nodes = np.asarray(nodes + way * fall[:, None])
        if abs(way) <= _LANDED * size:
            return nodes
    raise ValueError(
        "no equilibrium: no node touches the ground, and the structure falls along "
        f"{np.array2string(fall, precision=3)} without meeting ground. Give Model(...) ground "
        "below it, or nodes above the ground that it has"
    )


@dataclass(frozen=True, eq=False)
class Sticking:
    """Displacements that sticking nodes leave: ``origin + motions @ y`` are the free coordinates.

    Each sticking node keeps its place but along the normals of what it touches. Where rigid bars
    would be strained between sticking nodes, they are not: those move as the bars ask, and the
    forces that bars and ground could exert on each other to no effect are zero.

    While they settle, they keep their places as one body only, weighted by the most that friction
    holds at each: so they move against each other until all use the same part of it.
    """

    nodes: IntArray
    origin: FloatArray  # (f,)
    motions: csc_array  # (f, m), orthonormal columns

    @classmethod
    def at(
        cls, structure: Structure, nodes: FloatArray, points: GroundPoints,
        places: dict[int, FloatArray], bars: IntArray, settling: bool,
    ) -> Sticking:  # fmt: skip
        """Return what nodes at their places leave of a shape.

        ``points`` are those that touch; ``bars`` those whose lengths are to be kept.
        """
        from scipy.linalg import block_diag
        from scipy.sparse import csc_array, diags_array, eye_array, hstack

        d, rows = structure.dimension, structure.free_rows
        origin, is_held = nodes.copy(), np.isin(rows // d, list(places))
        weight, along, across = np.zeros(len(rows)), [np.zeros((0, 0))], [np.zeros((0, 0))]
        # Of held nodes in the order of their rows, each with the motions that it has.
        for node in sorted(places):
            origin[:, node] = nodes[:, node] if settling else places[node]
            own, mine = np.flatnonzero(rows[is_held] // d == node), points.node == node
            U, sizes, _ = np.linalg.svd(points.normal[:, mine][rows[is_held][own] % d])
            rank = int((sizes > _TOUCHING).sum())
            along.append(U[:, :rank])
            across.append(U[:, rank:])
            weight[np.flatnonzero(is_held)[own]] = points.grip[mine].sum()
        every = eye_array(len(rows), format="csc")
        held, along = (every[:, is_held] @ csc_array(block_diag(*own)) for own in (across, along))
        motions = hstack([every[:, ~is_held], along], format="csc")
        loose = np.zeros((held.shape[1], 0))
        if settling:
            fields, turns = np.hsplit(rigid_motions(nodes), [d])
            if d == 3:  # about the mean normal; other turns tilt
                fields = np.c_[fields, turns @ points.normal.mean(axis=1)]
            fields = held.T @ (weight[:, None] * fields[rows])
            U, sizes, _ = np.linalg.svd(fields)
            loose = U[:, (sizes > _TOUCHING * sizes.max(initial=0.0)).sum() :]
        elif held.shape[1] and len(bars):
            bars = bars[_are_joined(structure, bars, list(places))]
            J = bar_rows(structure, bars, nodes).tocsc()[:, rows]
            J = (diags_array(1 / structure.bar_length[bars]) @ J).tocsc()
            resisted = (J @ motions).tocsc()
            resisted = resisted[:, np.diff(resisted.indptr) > 0].toarray()
            is_wide = resisted.shape[1] >= len(bars)
            U, sizes, _ = np.linalg.svd(resisted, full_matrices=not is_wide)
            strained = U[:, np.pad(sizes, (0, len(bars) - len(sizes))) < _FLAT]
            patterns, sizes, _ = np.linalg.svd(held.T @ (J.T @ strained), False)
            loose = patterns[:, sizes > _FLAT]
        motions = hstack([motions, held @ csc_array(loose)], format="csc")
        return cls(np.array(sorted(places), int), free_coordinates(structure, origin), motions)


def _are_joined(structure: Structure, bars: IntArray, nodes: list[int]) -> np.ndarray:
    """Return which bars are joined to one of some nodes, by other bars or at once."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, ends = structure.nodes.shape[1], structure.bars[bars]
    graph = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(count, count))
    component = connected_components(graph, directed=False)[1]
    return np.isin(component[ends[:, 0]], component[nodes])


def contact_forces(
    settled: Structure, gamma: FloatArray, load: FloatArray, sticking: Sticking,
    points: GroundPoints,
) -> StanceContacts:  # fmt: skip
    """Return the contacts of a shape in balance: what members and load need of the ground."""
    rows, alpha = settled.free_rows, len(gamma)
    law = np.zeros_like(load)
    np.add.at(law.T, points.node, (points.normal * points.force).T)
    E = sparse_equilibrium_matrix(settled, settled.nodes).tocsr()[rows].tocsc()
    needed = E[:, :alpha] @ gamma - free_coordinates(settled, load)
    Q, by_bars = sticking.motions, E[:, alpha:]
    off = Q.T @ (free_coordinates(settled, law) - needed)
    pushes = by_bars @ least_norm((Q.T @ by_bars).tocsc(), off)
    # Where nothing sticks the normal force alone is that of the ground.
    flat = law.ravel(order="F").copy()
    flat[rows] = needed + pushes
    asked = flat.reshape(load.shape, order="F")
    count = len(points.node)
    normal_force, tangential = np.zeros(count), np.zeros((len(load), count))
    for node in np.unique(points.node):
        which = np.flatnonzero(points.node == node)
        normals = points.normal[:, which]
        normal_forces = np.linalg.lstsq(normals, asked[:, node], rcond=None)[0]
        normal_force[which] = normal_forces
        grip = np.maximum(points.friction[which] * normal_forces, 0.0)
        if node in sticking.nodes and grip.sum() > 0:
            rest = asked[:, node] - normals @ normal_forces
            tangential[:, which] = np.outer(rest, grip / grip.sum())
    cone = points.friction * normal_force
    size = np.linalg.norm(tangential, axis=0)
    use = np.where(cone > 0, size / np.where(cone > 0, cone, 1.0), 1.0)
    return StanceContacts(
        points.node, points.ground, points.depth, points.normal, normal_force, tangential, use
    )


def refuse_slip(contacts: StanceContacts) -> None:
    """Raise if a contact needs more friction than there is."""
    slipping = np.flatnonzero((contacts.cone_use > 1) & (contacts.normal_force > 0))
    if not len(slipping):
        return
    i = slipping[contacts.cone_use[slipping].argmax()]
    asked = float(np.linalg.norm(contacts.tangential_force[:, i]))
    held = asked / contacts.cone_use[i]
    raise ValueError(
        f"no equilibrium: node {contacts.node[i]} slips, however the feet share the load. It "
        f"needs {asked:.4g} N along the ground, and friction gives at most "
        f"{held:.4g} N. Give the ground more friction or less slope, or set the structure down on "
        "other nodes by plant.set_down(model, feet)"
    )


def set_down(model: Model, feet: object, nodes: object = None) -> FloatArray:
    """Return the nodes after a rigid-body motion that puts given nodes on the ground.

    The plane through the feet (the one nearest to them, if they are more than three) is laid on
    the first law of ``model.ground``, by the least turn that has the centre of the nodes above it.
    The centre of the feet stays where it is along the ground. In the plane a line takes the place
    of the plane. On ground whose height is a function, it is the tangent plane below that centre.

    Parameters
    ----------
    model : Model
        A model with ground and without supports.
    feet : array_like of int, shape (c,)
        At least three nodes that are on no line; in the plane at least two.
    nodes : array_like, shape (d, n), optional
        Shape, m; the reference shape if not given.

    Returns
    -------
    ndarray, shape (d, n)
        m, a start for :func:`equilibrium` or :func:`simulate`.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, the feet determine no plane, other nodes would be lower, or
        the model has no ground or supports.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.library.six_bar_ball(), gravity=9.81, ground=tc.Ground(5e3))
    >>> nodes = tc.plant.set_down(model, [0, 4, 8])
    >>> nodes[2, [0, 4, 8]].round(12) + 0.0, bool(nodes[2].min() > -1e-12)
    (array([0., 0., 0.]), True)
    """
    validation.instance("model", model, Model, "make one by Model(structure, ground=Ground(...))")
    structure = model.structure
    if not model.ground:
        raise ValueError(
            "the model has no ground to set it down on: build it by Model(..., ground=Ground(...))"
        )
    if len(structure.fixed_rows):
        raise ValueError("the model has supports, which hold its nodes where they are")
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    d, count = N.shape
    below = validation.index_list("feet", feet, count, f"the structure has {count} nodes")
    centre = N[:, below].sum(axis=1, keepdims=True) / max(len(below), 1)
    axes, sizes, _ = np.linalg.svd(N[:, below] - centre)
    if len(below) < d or sizes[d - 2] <= _TOUCHING * sizes[0]:
        raise ValueError(
            f"feet are {below.tolist()}, which determine no {'plane' if d == 3 else 'line'}; "
            f"expected at least {d} nodes" + (" that are on no line" if d == 3 else "")
        )
    axis = axes[:, -1]
    axis = axis * (np.sign(axis @ (N - centre).mean(axis=1)) or 1.0)
    law = model.ground[0]
    depth, _, away = law.sinking(ca.DM(centre), ca.DM.zeros(d, 1))
    depth, up = float(depth), np.array(away).ravel()
    up /= np.linalg.norm(up)
    turned = np.asarray(_least_turn(axis, up) @ (N - centre) + centre + depth * up[:, None])
    height = up @ turned
    lower = float(height[below].min() - height.min())
    if lower > _TOUCHING * float(np.ptp(N, axis=1).max()):
        raise ValueError(
            f"feet are {below.tolist()}, but node {height.argmin()} would be lower by "
            f"{lower:.3g} m: give the nodes of a face"
        )
    return turned


def _least_turn(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the least rotation, shape (d, d), from one unit vector to another."""
    cosine = float(start @ end)
    if cosine < _LANDED - 1:  # any half turn about an axis across
        if len(start) == 2:
            return -np.eye(2)
        axis = np.linalg.svd(start[:, None])[0][:, 1]
        return np.asarray(2 * np.outer(axis, axis) - np.eye(3))
    turn = np.outer(end, start) - np.outer(start, end)
    return np.asarray(np.eye(len(start)) + turn + turn @ turn / (1 + cosine))


def standing_model(model: Model, stance: Stance) -> Model:
    """Return the model whose supports are the contacts of a stance, without ground.

    Raises if a contact is no support: it slips, or just touches.
    """
    contacts = stance.contacts
    slips = np.flatnonzero(contacts.cone_use > _SLIPS)
    if len(slips):
        i = slips[0]
        raise ValueError(
            f"node {contacts.node[i]} of the stance is no support: "
            f"{contacts.cone_use[i]:.3g} of its friction is used, expected at most {_SLIPS:g}. "
            "Give the ground more friction, or linearize with the ground's own stiffness and "
            "friction: OperatingPoint(stance.structure.nodes, stance.force_density, stance.load)"
        )
    largest = float(contacts.normal_force.max(initial=0.0))
    light = np.flatnonzero(contacts.normal_force < _PRESSES * largest)
    if len(light):
        i = light[0]
        raise ValueError(
            f"node {contacts.node[i]} of the stance is no support: it just touches, with "
            f"{contacts.normal_force[i]:.3g} N of {largest:.3g} N at most; expected at least "
            f"{_PRESSES:g} of that. Change the rest lengths so that it presses, or lift it"
        )
    feet = np.unique(contacts.node)
    if len(feet) == len(model.structure.free):
        raise ValueError("every node of the stance is on the ground: nothing is left to move")
    key = "standing", stance.structure.nodes.tobytes(), feet.tobytes()
    return model.prepared.get(key, lambda: _standing(model, stance.structure.nodes, feet))


def _standing(model: Model, nodes: FloatArray, feet: IntArray) -> Model:
    structure = _with_feet(model.structure, nodes, feet)
    load = model.constant_force
    if not model.has_external_force:
        return model.replace(structure=structure, external_force=load, gravity=None, ground=None)
    # All that is built in beside a load as an input are weights.
    fall = load.sum(axis=1) / model.mass_matrix().sum()
    return model.replace(structure=structure, gravity=fall, ground=None)


def _with_feet(structure: Structure, nodes: FloatArray, feet: IntArray) -> Structure:
    """Return the structure, and the one that it was cut from, with more fixed nodes."""
    parent = structure.parent
    if parent is not None:
        count = parent.nodes.shape[1]
        parent = _with_feet(parent, nodes[:, :count], feet[feet < count])
    rollers = tuple(roller for roller in structure.rollers if roller[0] not in feet)
    fixed = np.union1d(structure.fixed, feet)
    return replace(structure, nodes=nodes, fixed=fixed, rollers=rollers, parent=parent)
