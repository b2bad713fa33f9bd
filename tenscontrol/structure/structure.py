"""The structure: nodes, bars, strings, masses, and the connectivity matrices they define."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscontrol.limits import refuse_memory
from tenscontrol.structure.blocks import Block, find_blocks
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    choice,
    float_array,
    frozen,
    identifier,
    indices,
    instance,
    items,
    non_negative,
    per_member,
    positive,
    shaped,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike
    from scipy.sparse import csr_array

# A bar shorter than this fraction of the structure's size has no direction in double precision.
_ZERO_LENGTH = 1e-12


@dataclass(frozen=True, eq=False)
class Structure:
    """A tensegrity structure: rigid bars in a net of strings, in space or in the plane.

    Bars may share nodes, where they are joined by a ball joint (a pin in the plane). Nodes keep the
    order in which they are given, in every output. A node on a bar is a *bar node*. A node on no
    bar is a *string node*, a point mass, unless it is fixed. A *fixed node* stays where it is.

    Parameters
    ----------
    nodes : array_like, shape (d, n)
        Node positions N in the reference shape, m, in space (d = 3) or in the plane (d = 2: x and
        y). They fix the bar lengths.
    bars : array_like of int, shape (β, 2)
        Start and end node of each bar. More bars than make a body rigid are allowed.
    strings : array_like of int, shape (α, 2), or sequence of paths
        Start and end node of each string. A path of more nodes, ``(1, 2, 3)``, is a *clustered*
        string: it runs over the inner nodes without friction, with one tension and one rest length.
        It is closed if it ends where it starts.
    bar_mass : float or array_like, shape (β,)
        Mass of each bar, kg, spread evenly along it. One number serves all.
    string_node_mass : float or array_like, shape (σ,), optional
        Mass of each string node, kg, in ascending order of node index: ``point_mass`` of these
        nodes alone.
    fixed : sequence of int and of (int, str), optional
        Nodes that are held in place, and pairs of a node and the axis, ``"x"``, ``"y"`` or ``"z"``,
        along which it is held: a roller. What is held costs no state and no mass. A bar with
        one fixed end swings about it; one with both ends fixed is part of the support.
    string_groups : sequence of str, length α, optional
        A group name for each string, used in names of signals and to refer to
        strings in words. All are ``"string"`` when not given.
    parent : Structure, optional
        The structure that this one was made from; :func:`subdivide` and
        :func:`skin` set it. Its nodes are the first of this one.
    string_parent : array_like of int, shape (α,), optional
        For each string, the index of the string of ``parent`` that it is a
        segment of; :func:`subdivide` sets it.
    point_mass : array_like, shape (n,), optional
        Mass at each node, kg, beside that of the bars: a payload, a motor, a string node. Every
        string node needs one; fixed nodes have none.
    rollers : sequence of (int, str), optional
        The pairs of ``fixed``, which may also be given here.
    paths : sequence of sequence of int, optional
        The nodes that each string runs over, if one is clustered: ``strings`` as it was given,
        which then has the first and the last node of each.

    Raises
    ------
    TypeError
        If an argument is not an array of numbers, or an index is not a whole number.
    ValueError
        If a shape does not fit, an index is out of range, a member joins a node to itself, a bar
        repeats another, a clustered string passes a node twice, a node has no member, a bar has no
        length, a mass is missing or not positive, a fixed node is named twice, or ``string_parent``
        does not fit ``parent``. The message names the culprit.

    Notes
    -----
    Connectivity follows Goyal & Skelton: ``B = N C_nbᵀ C_bᵀ`` are the bar
    vectors and ``S = N C_sᵀ`` the string vectors, each from start to end node; of a clustered
    string, those of its segments.

    Examples
    --------
    A bar held between two string nodes:

    >>> import tenscontrol as tc
    >>> line = tc.Structure(
    ...     nodes=[[0, 1, 2, 3], [0, 0, 0, 0], [0, 0, 0, 0]],
    ...     bars=[[1, 2]], strings=[[0, 1], [2, 3]],
    ...     bar_mass=1.0, string_node_mass=0.1)
    >>> line.bar_nodes, line.string_nodes
    (array([1, 2]), array([0, 3]))
    >>> line.bar_length
    array([1.])

    Two bars in the plane that share a node, held at the first and on a roller:

    >>> arm = tc.Structure([[0, 1, 2], [0, 1, 0]], bars=[[0, 1], [1, 2]], strings=[[0, 2]],
    ...                    bar_mass=1.0, fixed=[0, (2, "y")])
    >>> arm.structure_class, arm.dimension, arm.rollers
    (2, 2, ((2, 'y'),))
    """

    nodes: FloatArray
    bars: IntArray
    strings: IntArray
    bar_mass: FloatArray
    string_node_mass: FloatArray = None  # type: ignore[assignment]  # replaced in __post_init__
    string_groups: tuple[str, ...] = None  # type: ignore[assignment]  # replaced in __post_init__
    fixed: IntArray = ()  # type: ignore[assignment]  # replaced in __post_init__
    parent: Structure | None = None
    string_parent: IntArray | None = None
    point_mass: FloatArray = None  # type: ignore[assignment]  # replaced in __post_init__
    rollers: tuple[tuple[int, str], ...] = ()
    paths: tuple[tuple[int, ...], ...] = ()

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            nodes: ArrayLike,
            bars: ArrayLike,
            strings: ArrayLike | Sequence[Sequence[int]],
            bar_mass: ArrayLike,
            string_node_mass: ArrayLike | None = None,
            string_groups: Sequence[str] | None = None,
            fixed: ArrayLike | Sequence[int | tuple[int, str]] = (),
            parent: Structure | None = None,
            string_parent: ArrayLike | None = None,
            point_mass: ArrayLike | None = None,
            rollers: Sequence[tuple[int, str]] = (),
            paths: Sequence[Sequence[int]] = (),
        ) -> None: ...

    def __post_init__(self) -> None:
        nodes = float_array("nodes", self.nodes)
        if nodes.ndim != 2 or nodes.shape[0] not in (2, 3) or nodes.shape[1] == 0:
            hint = "; transpose it" if nodes.ndim == 2 and nodes.shape[1] in (2, 3) else ""
            raise ValueError(
                f"nodes has shape {nodes.shape}, expected (3, n), or (2, n) in the plane: "
                f"one column per node{hint}"
            )
        count = nodes.shape[1]
        bars = _members("bars", self.bars, count)
        strings, paths = _strings(self.strings, self.paths, count)
        put = object.__setattr__  # the dataclass is frozen for everyone else
        _refuse_repeats(bars)
        _refuse_bad_sizes(nodes, bars)
        put(self, "nodes", frozen(nodes))
        put(self, "bars", frozen(bars))
        put(self, "strings", frozen(strings))
        put(self, "paths", paths)
        _refuse_untouched_nodes(bars, self.segments, count)
        fixed, rollers = _supports(self.fixed, self.rollers, nodes.shape)
        put(self, "fixed", frozen(fixed))
        put(self, "rollers", rollers)
        bar_mass = per_member("bar_mass", self.bar_mass, len(bars), "bar")
        put(self, "bar_mass", frozen(positive("bar_mass", bar_mass, "mass in kg")))
        put(self, "point_mass", frozen(self._checked_point_mass()))
        put(self, "string_node_mass", frozen(self.point_mass[self.string_nodes]))
        put(self, "string_groups", self._checked_groups())
        if self.parent is not None:
            instance("parent", self.parent, Structure, "the structure that this one was made from")
        if self.string_parent is not None:
            put(self, "string_parent", frozen(self._checked_string_parent()))
        _ = self.blocks  # refuses what does not determine its forces

    def _checked_point_mass(self) -> FloatArray:
        points, count = self.string_nodes, self.nodes.shape[1]
        mass = np.zeros(count)
        if self.point_mass is not None:
            mass = shaped("point_mass", self.point_mass, (count,), "one per node, kg").copy()
            non_negative("point_mass", mass, "mass in kg")
            held = self.fixed[mass[self.fixed] > 0]
            if len(held):
                raise ValueError(
                    f"point_mass[{held[0]}] is {mass[held[0]]:g} kg, but node {held[0]} is fixed: "
                    "its mass would do nothing; give 0 there"
                )
        given = self.string_node_mass
        if given is not None and len(points) == 0 and float_array("string_node_mass", given).size:
            raise ValueError(
                "string_node_mass is given, but every node is on a bar or fixed; leave it out, or "
                "give point_mass, a mass for each node"
            )
        if given is not None and len(points):
            alone = per_member("string_node_mass", given, len(points), "string node")
            positive("string_node_mass", alone, "mass in kg")
            if self.point_mass is not None and not np.array_equal(alone, mass[points]):
                node = points[np.argmax(alone != mass[points])]
                raise ValueError(
                    f"string_node_mass and point_mass differ at node {node}; give one of the two"
                )
            mass[points] = alone
        bare = points[mass[points] == 0]
        if len(bare):
            raise ValueError(
                f"node {bare[0]} is on no bar, so it is a point mass and needs "
                f"string_node_mass: one number, or one for each of the {len(points)} string nodes; "
                f"or give point_mass, one for each of the {count} nodes"
            )
        return mass

    def _checked_groups(self) -> tuple[str, ...]:
        given: Any = self.string_groups
        if given is None:
            return ("string",) * len(self.strings)
        groups = items("string_groups", given, "names, one per string")
        if len(groups) != len(self.strings):
            raise ValueError(
                f"string_groups has {len(groups)} names, "
                f"expected {len(self.strings)}: one per string"
            )
        return tuple(identifier(f"string_groups[{i}]", group) for i, group in enumerate(groups))

    def _checked_string_parent(self) -> IntArray:
        if self.parent is None:
            raise ValueError("string_parent is given without parent, whose strings it counts")
        count = len(self.parent.strings)
        array = shaped("string_parent", self.string_parent, (len(self.strings),), "one per string")
        parent = indices("string_parent", array, count, f"the parent has {count} strings")
        missing = np.setdiff1d(np.arange(count), parent)
        if len(missing):
            raise ValueError(
                f"string_parent leaves out string {missing[0]} of the parent, "
                "expected at least one segment of each"
            )
        return parent

    def __repr__(self) -> str:
        return (
            f"Structure({self.nodes.shape[1]} nodes, {len(self.bars)} bars, "
            f"{len(self.strings)} strings)"
        )

    @cached_property
    def dimension(self) -> int:
        """d: 3 in space, 2 in the plane."""
        return int(self.nodes.shape[0])

    @cached_property
    def structure_class(self) -> int:
        """The largest number of bars that share a node: 1 for bars that float apart."""
        return int(np.bincount(self.bars.ravel(), minlength=1).max())

    @cached_property
    def has_clusters(self) -> bool:
        """Whether a string runs over inner nodes."""
        return bool(self.paths)

    @cached_property
    def segments(self) -> IntArray:
        """Start and end node of the straight segments of all strings, shape (s, 2).

        They are the strings where none is clustered; else those of string 0 in order, then of
        string 1, and so on.
        """
        if not self.paths:
            return self.strings
        return frozen(np.array([pair for path in self.paths for pair in pairwise(path)]))

    @cached_property
    def segment_string(self) -> IntArray:
        """The string that each segment is a part of, shape (s,)."""
        counts = [len(path) - 1 for path in self.paths] or 1
        return frozen(np.repeat(np.arange(len(self.strings)), counts))

    @cached_property
    def bar_nodes(self) -> IntArray:
        """Indices of the nodes on a bar, ascending, shape (2β,) in class 1."""
        return frozen(np.unique(self.bars))

    @cached_property
    def string_nodes(self) -> IntArray:
        """Indices of the free nodes on no bar, ascending, shape (σ,)."""
        return frozen(np.setdiff1d(self.free, self.bars.ravel()))

    @cached_property
    def free(self) -> IntArray:
        """Indices of the nodes that are not fixed, ascending; those on rollers are among them."""
        return frozen(np.setdiff1d(np.arange(self.nodes.shape[1]), self.fixed))

    @cached_property
    def fixed_rows(self) -> IntArray:
        """Rows of ``vec(N)``, x1 y1 z1 x2 …, that supports hold, ascending."""
        d = self.dimension
        rows = (d * self.fixed[:, None] + np.arange(d)).ravel()
        rolling = [d * node + "xyz".index(axis) for node, axis in self.rollers]
        return frozen(np.union1d(rows, np.array(rolling, dtype=np.int64)))

    @cached_property
    def free_rows(self) -> IntArray:
        """Rows of ``vec(N)`` that supports leave free, ascending, shape (f,)."""
        return frozen(np.setdiff1d(np.arange(self.nodes.size), self.fixed_rows))

    @cached_property
    def _is_alone(self) -> np.ndarray:
        """Which bars move by themselves: no free end is on another bar, rolls or has a mass."""
        bars_at = np.bincount(self.bars.ravel(), minlength=self.nodes.shape[1])
        bound = (bars_at > 1) | (self.point_mass > 0)
        bound[[node for node, _ in self.rollers]] = True
        bound[self.fixed] = False
        return np.asarray(~bound[self.bars].any(axis=1))

    @cached_property
    def free_bars(self) -> IntArray:
        """Indices of the bars with two free ends that are joined to nothing else."""
        held = np.isin(self.bars, self.fixed).any(axis=1)
        return frozen(np.flatnonzero(self._is_alone & ~held))

    @cached_property
    def swinging_bars(self) -> IntArray:
        """Indices of the bars that swing about a fixed end and are joined to nothing else."""
        held = np.isin(self.bars, self.fixed).sum(axis=1) == 1
        return frozen(np.flatnonzero(self._is_alone & held))

    @cached_property
    def coupled_bars(self) -> IntArray:
        """Indices of the other bars that move: joined to others, to a mass or to a roller."""
        held = np.isin(self.bars, self.fixed).all(axis=1)
        return frozen(np.flatnonzero(~self._is_alone & ~held))

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """The coupled bars, by what hangs together."""
        return find_blocks(self)

    @cached_property
    def hinged_pairs(self) -> IntArray:
        """Fixed and free node of each swinging bar, shape (·, 2)."""
        pairs = self.bars[self.swinging_bars]
        turned = np.isin(pairs[:, 1], self.fixed)
        return frozen(np.where(turned[:, None], pairs[:, ::-1], pairs))

    @cached_property
    def end_share(self) -> FloatArray:
        """Share of the change of a bar on its own that falls on each end: none on a fixed one."""
        free = ~np.isin(self.bars, self.fixed)
        return frozen(free / np.maximum(free.sum(axis=1, keepdims=True), 1))

    @cached_property
    def bar_length(self) -> FloatArray:
        """Bar lengths l, m, shape (β,). They stay what they are in the reference shape."""
        return frozen(np.linalg.norm(self.bar_vectors(self.nodes), axis=0))

    def bar_vectors(self, nodes: object) -> FloatArray:
        """Return the bar vectors B = N C_nbᵀ C_bᵀ, shape (d, β), from start to end node.

        Parameters
        ----------
        nodes : array_like, shape (d, n)
            Node positions, m, or velocities, m/s; the result has the same unit.
        """
        return self._vectors(self.bars, nodes)

    def string_vectors(self, nodes: object) -> FloatArray:
        """Return the string vectors S = N C_sᵀ, from start to end node, of each segment.

        Parameters
        ----------
        nodes : array_like, shape (d, n)
            Node positions, m, or velocities, m/s; the result has the same unit.

        Returns
        -------
        ndarray, shape (d, s)
            A column for each of the ``segments``: for each string, where none is clustered.
        """
        return self._vectors(self.segments, nodes)

    def _vectors(self, pairs: IntArray, nodes: object) -> FloatArray:
        N = self.checked_nodes("nodes", nodes)
        return np.asarray(N[:, pairs[:, 1]] - N[:, pairs[:, 0]])

    def string_length(self, nodes: object = None) -> FloatArray:
        """Return the string lengths, m, shape (α,), of the reference shape or of ``nodes``.

        A clustered string is as long as its segments together.

        Parameters
        ----------
        nodes : array_like, shape (d, n), optional
            Node positions, m.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> tc.prism().string_length().round(4)
        array([0.866, 0.866, 0.866, 0.866, 0.866, 0.866, 1.033, 1.033, 1.033])
        """
        vectors = self.string_vectors(self.nodes if nodes is None else nodes)
        length = np.asarray(np.linalg.norm(vectors, axis=0))
        if not self.has_clusters:
            return length
        total = np.bincount(self.segment_string, length, minlength=len(self.strings))
        return np.asarray(total, dtype=float)

    def strings_in(self, group: str) -> IntArray:
        """Return the indices of the strings of one group, or raise and list the groups.

        Parameters
        ----------
        group : str
            A name from ``string_groups``.
        """
        choice("group", group, dict.fromkeys(self.string_groups))
        return np.array([i for i, name in enumerate(self.string_groups) if name == group])

    def checked_nodes(self, name: str, nodes: object) -> FloatArray:
        """Return positions or velocities as an array, shape (d, n), or raise naming the argument.

        Parameters
        ----------
        name : str
            What the message calls them.
        nodes : array_like, shape (d, n)
        """
        axes = ", ".join("xyz"[: self.dimension])
        meaning = f"one column of {axes} per node of the structure"
        return shaped(name, nodes, self.nodes.shape, meaning)

    # The paper's matrices, built on demand. The dynamics never multiply by them:
    # every product is done member by member.

    @property
    def C_b(self) -> csr_array:  # noqa: N802
        """Bar connectivity, shape (β, 2β), over the bar nodes: −1 at the start, 1 at the end."""
        position = np.searchsorted(self.bar_nodes, self.bars)
        return _signed_incidence(position, len(self.bar_nodes))

    @property
    def C_r(self) -> csr_array:  # noqa: N802
        """Centres of mass, ½|C_b|, shape (β, 2β)."""
        half = abs(self.C_b) * 0.5
        return half.tocsr()

    @property
    def C_s(self) -> csr_array:  # noqa: N802
        """String connectivity, shape (α, n), over all nodes: −1 at the start, 1 at the end.

        Of clustered strings, a row for each segment.
        """
        return _signed_incidence(self.segments, self.nodes.shape[1])

    @property
    def C_nb(self) -> csr_array:  # noqa: N802
        """Selects the bar nodes, shape (2β, n): ``N_b = N C_nbᵀ``."""
        return _selection(self.bar_nodes, self.nodes.shape[1])

    @property
    def C_ns(self) -> csr_array:  # noqa: N802
        """Selects the free string nodes, shape (σ, n): ``N_s = N C_nsᵀ``."""
        return _selection(self.string_nodes, self.nodes.shape[1])

    @property
    def C_sb(self) -> csr_array:  # noqa: N802
        """The columns of C_s that belong to bar nodes, shape (α, 2β)."""
        return self.C_s[:, self.bar_nodes]

    @property
    def C_ss(self) -> csr_array:  # noqa: N802
        """The columns of C_s that belong to free string nodes, shape (α, σ)."""
        return self.C_s[:, self.string_nodes]


def same_members(one: Structure, other: Structure | None) -> bool:
    """Return whether bars, strings and supports are the same; masses and lengths may differ."""
    if other is None or one.nodes.shape != other.nodes.shape:
        return False
    names = ("bars", "segments", "segment_string", "fixed_rows")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


def _members(name: str, pairs: Any, count: int) -> IntArray:
    """Check index pairs: shape (·, 2), whole numbers, in range, not from a node to itself."""
    array = float_array(name, pairs)
    if array.shape in ((0,), (0, 2)):
        return np.zeros((0, 2), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(
            f"{name} has shape {array.shape}, expected (count, 2): a start and an end node each"
        )
    ends = [indices(name, nodes, count, f"there are {count} nodes", "node ") for nodes in array.T]
    loops = np.flatnonzero(ends[0] == ends[1])
    if len(loops):
        raise ValueError(f"{name}[{loops[0]}] joins node {ends[0][loops[0]]} to itself")
    return np.column_stack(ends)


def refuse_many_members(asked: str, count: float) -> None:
    """Raise if so many members do not fit in memory: to be checked, each takes 800 bytes."""
    refuse_memory(asked, count, "bars and strings", 800)


def _strings(strings: Any, paths: Any, count: int) -> tuple[IntArray, tuple[tuple[int, ...], ...]]:
    """Check strings: their first and last nodes, shape (α, 2), and the paths if one is longer."""
    given = items("paths", paths, "paths of nodes")
    if not given and isinstance(strings, list | tuple) and any(map(_is_path, strings)):
        given, strings = tuple(strings), None
    if not given:
        return _members("strings", strings, count), ()
    found = tuple(_path(f"strings[{i}]", path, count) for i, path in enumerate(given))
    ends = np.array([(path[0], path[-1]) for path in found])
    if strings is not None and not np.array_equal(ends, float_array("strings", strings)):
        raise ValueError("paths and strings have different ends; give one of the two")
    return ends, found


def _is_path(path: Any) -> bool:
    """Return whether a string is given by more nodes than two."""
    return isinstance(path, list | tuple | np.ndarray) and np.size(path) == len(path) > 2


def _path(name: str, path: Any, count: int) -> tuple[int, ...]:
    array = np.atleast_1d(float_array(name, path))
    if array.ndim != 1 or len(array) < 2:
        raise ValueError(
            f"{name} has shape {array.shape}, expected (k,) with k at least 2: the nodes that "
            "the string runs over"
        )
    nodes = indices(name, array, count, f"there are {count} nodes", "node ").tolist()
    inner = nodes[:-1] if nodes[0] == nodes[-1] and len(nodes) > 3 else nodes
    if len(set(inner)) < len(inner):
        node = next(node for node in inner if inner.count(node) > 1)
        raise ValueError(
            f"{name} passes node {node} twice, expected each node once; a closed string of at "
            "least three nodes ends where it starts"
        )
    return tuple(nodes)


def _supports(
    fixed: Any, rollers: Any, shape: tuple[int, ...]
) -> tuple[IntArray, tuple[tuple[int, str], ...]]:
    """Return the nodes that are fixed, ascending, and the (node, axis) pairs of the others."""
    d, count = shape
    nodes, pairs = fixed, list(items("rollers", rollers, "pairs of a node and an axis"))
    if isinstance(fixed, list | tuple):
        is_pair = [isinstance(each, list | tuple) for each in fixed]
        nodes = [each for each, pair in zip(fixed, is_pair, strict=True) if not pair]
        pairs += [each for each, pair in zip(fixed, is_pair, strict=True) if pair]
    array = np.atleast_1d(float_array("fixed", nodes))
    if array.ndim != 1:
        raise ValueError(
            f"fixed has shape {array.shape}, expected a sequence of node indices, and of pairs of "
            'a node and an axis, as in [0, (4, "z")]'
        )
    whole = indices("fixed", array, count, f"there are {count} nodes", "node ")
    whole, times = np.unique(whole, return_counts=True)
    if (times > 1).any():
        raise ValueError(f"fixed names node {whole[times.argmax()]} twice")
    held: dict[int, set[str]] = {}
    for pair in pairs:
        if not (isinstance(pair, list | tuple) and len(pair) == 2):
            raise ValueError(f"rollers has {pair!r}, expected pairs of a node and an axis")
        node = int(indices("fixed", float_array("fixed", [pair[0]]), count,
                           f"there are {count} nodes", "node ")[0])  # fmt: skip
        axis = choice(f"the axis of node {node} in fixed", pair[1], tuple("xyz"[:d]))
        if node in whole or axis in held.get(node, ()):
            raise ValueError(f"fixed names node {node} twice")
        held.setdefault(node, set()).add(axis)
    everywhere = [node for node, axes in held.items() if len(axes) == d]
    rolling = [(node, axis) for node, axes in held.items() if len(axes) < d for axis in axes]
    return np.union1d(whole, np.array(everywhere, dtype=np.int64)), tuple(sorted(rolling))


def _refuse_repeats(bars: IntArray) -> None:
    pairs, first, which = np.unique(np.sort(bars), axis=0, return_index=True, return_inverse=True)
    if len(pairs) < len(bars):
        again = int(np.argmax(first[which.ravel()] != np.arange(len(bars))))
        one, other = sorted(bars[again].tolist())
        raise ValueError(
            f"bars[{again}] joins nodes {one} and {other}, as bars[{first[which.ravel()[again]]}] "
            "does; remove one"
        )


def _refuse_untouched_nodes(bars: IntArray, segments: IntArray, count: int) -> None:
    touched = np.concatenate([bars.ravel(), segments.ravel()])
    untouched = np.setdiff1d(np.arange(count), touched)
    if len(untouched):
        raise ValueError(
            f"nothing touches node {untouched[0]}"
            + (f" (nor {len(untouched) - 1} more)" if len(untouched) > 1 else "")
            + "; remove it, or join it by a bar or a string"
        )


def _refuse_bad_sizes(nodes: FloatArray, bars: IntArray) -> None:
    size = float(np.ptp(nodes, axis=1).max())
    length = np.linalg.norm(nodes[:, bars[:, 1]] - nodes[:, bars[:, 0]], axis=0)
    short = np.flatnonzero(length <= _ZERO_LENGTH * size)
    if len(short):
        start, end = bars[short[0]]
        raise ValueError(
            f"bars[{short[0]}] has no length: nodes {start} and {end} are at the same place"
        )


def _signed_incidence(pairs: IntArray, columns: int) -> csr_array:
    from scipy.sparse import csr_array

    rows = np.repeat(np.arange(len(pairs)), 2)
    values = np.tile([-1.0, 1.0], len(pairs))
    return csr_array((values, (rows, pairs.ravel())), shape=(len(pairs), columns))


def _selection(columns: IntArray, count: int) -> csr_array:
    from scipy.sparse import csr_array

    rows = np.arange(len(columns))
    return csr_array((np.ones(len(columns)), (rows, columns)), shape=(len(columns), count))
