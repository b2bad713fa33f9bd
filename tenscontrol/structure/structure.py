"""The structure: nodes, bars, strings, masses, and the connectivity matrices they define."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscontrol.validation import (
    FloatArray,
    IntArray,
    float_array,
    frozen,
    identifier,
    indices,
    instance,
    items,
    per_member,
    positive,
    shaped,
    text,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike
    from scipy.sparse import csr_array

# A bar shorter than this fraction of the structure's size has no direction in double precision.
_ZERO_LENGTH = 1e-12


@dataclass(frozen=True, eq=False)
class Structure:
    """A class-1 tensegrity structure: rigid bars in a net of strings.

    No two bars share a node. Nodes keep the order in which they are given, in
    every output. A node on a bar is a *bar node*. A node on no bar is a *string
    node*, a point mass, unless it is fixed. A *fixed node* stays where it is.

    Parameters
    ----------
    nodes : array_like, shape (3, n)
        Node positions N in the reference shape, m. They fix the bar lengths.
    bars : array_like of int, shape (β, 2)
        Start and end node of each bar.
    strings : array_like of int, shape (α, 2)
        Start and end node of each string.
    bar_mass : float or array_like, shape (β,)
        Mass of each bar, kg, spread evenly along it. One number serves all.
    string_node_mass : float or array_like, shape (σ,), optional
        Mass of each string node, kg, in ascending order of node index.
        Needed when there are string nodes, refused when there are none.
    fixed : sequence of int, optional
        Nodes that are held in place. They cost no state and no mass. A bar with one fixed end
        swings about it; one with both ends fixed is part of the support.
    string_groups : sequence of str, length α, optional
        A group name for each string, used in names of signals and to refer to
        strings in words. All are ``"string"`` when not given.
    parent : Structure, optional
        The structure that this one was made from; :func:`subdivide` and
        :func:`skin` set it. Its nodes are the first of this one.
    string_parent : array_like of int, shape (α,), optional
        For each string, the index of the string of ``parent`` that it is a
        segment of; :func:`subdivide` sets it.

    Raises
    ------
    TypeError
        If an argument is not an array of numbers, or an index is not a whole number.
    ValueError
        If a shape does not fit, an index is out of range, a member joins a node to itself or
        repeats another, two bars share a node, a node has no member, a bar has no length, a mass is
        missing or not positive, a fixed node is named twice, or ``string_parent`` does not fit
        ``parent``. The message names the culprit.

    Notes
    -----
    Connectivity follows Goyal & Skelton: ``B = N C_nbᵀ C_bᵀ`` are the bar
    vectors and ``S = N C_sᵀ`` the string vectors, each from start to end node.

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

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            nodes: ArrayLike,
            bars: ArrayLike,
            strings: ArrayLike,
            bar_mass: ArrayLike,
            string_node_mass: ArrayLike | None = None,
            string_groups: Sequence[str] | None = None,
            fixed: ArrayLike = (),
            parent: Structure | None = None,
            string_parent: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        nodes = float_array("nodes", self.nodes)
        if nodes.ndim != 2 or nodes.shape[0] != 3 or nodes.shape[1] == 0:
            hint = "; transpose it" if nodes.ndim == 2 and nodes.shape[1] == 3 else ""
            raise ValueError(
                f"nodes has shape {nodes.shape}, expected (3, n): one column per node{hint}"
            )
        count = nodes.shape[1]
        bars = _members("bars", self.bars, count)
        strings = _members("strings", self.strings, count)
        _refuse_repeats(bars, strings)
        _refuse_shared_bar_nodes(bars)
        _refuse_untouched_nodes(bars, strings, count)
        _refuse_bad_sizes(nodes, bars)
        put = object.__setattr__  # the dataclass is frozen for everyone else
        put(self, "nodes", frozen(nodes))
        put(self, "bars", frozen(bars))
        put(self, "strings", frozen(strings))
        put(self, "fixed", frozen(_fixed_nodes(self.fixed, count)))
        bar_mass = per_member("bar_mass", self.bar_mass, len(bars), "bar")
        put(self, "bar_mass", frozen(positive("bar_mass", bar_mass, "mass in kg")))
        put(self, "string_node_mass", frozen(self._checked_string_node_mass()))
        put(self, "string_groups", self._checked_groups())
        if self.parent is not None:
            instance("parent", self.parent, Structure, "the structure that this one was made from")
        if self.string_parent is not None:
            put(self, "string_parent", frozen(self._checked_string_parent()))

    def _checked_string_node_mass(self) -> FloatArray:
        count = len(self.string_nodes)
        if count == 0:
            given = self.string_node_mass
            if given is not None and float_array("string_node_mass", given).size > 0:
                raise ValueError(
                    "string_node_mass is given, but every node is on a bar or fixed; leave it out"
                )
            return np.zeros(0)
        if self.string_node_mass is None:
            raise ValueError(
                f"node {self.string_nodes[0]} is on no bar, so it is a point mass and needs "
                f"string_node_mass: one number, or one for each of the {count} string nodes"
            )
        mass = per_member("string_node_mass", self.string_node_mass, count, "string node")
        return positive("string_node_mass", mass, "mass in kg")

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
    def bar_nodes(self) -> IntArray:
        """Indices of the nodes on a bar, ascending, shape (2β,)."""
        return frozen(np.sort(self.bars.ravel()))

    @cached_property
    def string_nodes(self) -> IntArray:
        """Indices of the free nodes on no bar, ascending, shape (σ,)."""
        return frozen(np.setdiff1d(self.free, self.bars.ravel()))

    @cached_property
    def free(self) -> IntArray:
        """Indices of the nodes that are not fixed, ascending."""
        return frozen(np.unique(self.free_rows // 3))

    @cached_property
    def fixed_rows(self) -> IntArray:
        """Rows of ``vec(N)``, x1 y1 z1 x2 …, that supports hold, ascending."""
        return frozen((3 * self.fixed[:, None] + np.arange(3)).ravel())

    @cached_property
    def free_rows(self) -> IntArray:
        """Rows of ``vec(N)`` that supports leave free, ascending, shape (f,)."""
        return frozen(np.setdiff1d(np.arange(self.nodes.size), self.fixed_rows))

    @cached_property
    def free_bars(self) -> IntArray:
        """Indices of the bars with two free ends."""
        return frozen(np.flatnonzero(~np.isin(self.bars, self.fixed).any(axis=1)))

    @cached_property
    def swinging_bars(self) -> IntArray:
        """Indices of the bars that swing about a fixed end."""
        return frozen(np.flatnonzero(np.isin(self.bars, self.fixed).sum(axis=1) == 1))

    @cached_property
    def hinged_pairs(self) -> IntArray:
        """Fixed and free node of each swinging bar, shape (·, 2)."""
        pairs = self.bars[self.swinging_bars]
        turned = np.isin(pairs[:, 1], self.fixed)
        return frozen(np.where(turned[:, None], pairs[:, ::-1], pairs))

    @cached_property
    def end_share(self) -> FloatArray:
        """Share of a bar's change that falls on each end, shape (β, 2): none on a fixed one."""
        free = ~np.isin(self.bars, self.fixed)
        return frozen(free / np.maximum(free.sum(axis=1, keepdims=True), 1))

    @cached_property
    def bar_length(self) -> FloatArray:
        """Bar lengths l, m, shape (β,). They stay what they are in the reference shape."""
        return frozen(np.linalg.norm(self.bar_vectors(self.nodes), axis=0))

    def bar_vectors(self, nodes: object) -> FloatArray:
        """Return the bar vectors B = N C_nbᵀ C_bᵀ, shape (3, β), from start to end node.

        Parameters
        ----------
        nodes : array_like, shape (3, n)
            Node positions, m, or velocities, m/s; the result has the same unit.
        """
        return self._vectors(self.bars, nodes)

    def string_vectors(self, nodes: object) -> FloatArray:
        """Return the string vectors S = N C_sᵀ, shape (3, α), from start to end node.

        Parameters
        ----------
        nodes : array_like, shape (3, n)
            Node positions, m, or velocities, m/s; the result has the same unit.
        """
        return self._vectors(self.strings, nodes)

    def _vectors(self, pairs: IntArray, nodes: object) -> FloatArray:
        N = self.checked_nodes("nodes", nodes)
        return np.asarray(N[:, pairs[:, 1]] - N[:, pairs[:, 0]])

    def string_length(self, nodes: object = None) -> FloatArray:
        """Return the string lengths, m, shape (α,), of the reference shape or of ``nodes``.

        Parameters
        ----------
        nodes : array_like, shape (3, n), optional
            Node positions, m.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> tc.prism().string_length().round(4)
        array([0.866, 0.866, 0.866, 0.866, 0.866, 0.866, 1.033, 1.033, 1.033])
        """
        vectors = self.string_vectors(self.nodes if nodes is None else nodes)
        return np.asarray(np.linalg.norm(vectors, axis=0))

    def strings_in(self, group: str) -> IntArray:
        """Return the indices of the strings of one group, or raise and list the groups.

        Parameters
        ----------
        group : str
            A name from ``string_groups``.
        """
        text("group", group, "a name from string_groups")
        found = np.array([i for i, name in enumerate(self.string_groups) if name == group])
        if len(found) == 0:
            known = ", ".join(repr(name) for name in dict.fromkeys(self.string_groups)) or "none"
            raise ValueError(f"there is no string group {group!r}; the groups are: {known}")
        return found

    def checked_nodes(self, name: str, nodes: object) -> FloatArray:
        """Return positions or velocities as an array, shape (3, n), or raise naming the argument.

        Parameters
        ----------
        name : str
            What the message calls them.
        nodes : array_like, shape (3, n)
        """
        meaning = "one column of x, y, z per node of the structure"
        return shaped(name, nodes, self.nodes.shape, meaning)

    # The paper's matrices, built on demand. The dynamics never multiply by them:
    # every product is done member by member.

    @property
    def C_b(self) -> csr_array:  # noqa: N802
        """Bar connectivity, shape (β, 2β), over the bar nodes: −1 at the start, 1 at the end."""
        position = np.searchsorted(self.bar_nodes, self.bars)
        return _signed_incidence(position, 2 * len(self.bars))

    @property
    def C_r(self) -> csr_array:  # noqa: N802
        """Centres of mass, ½|C_b|, shape (β, 2β)."""
        half = abs(self.C_b) * 0.5
        return half.tocsr()

    @property
    def C_s(self) -> csr_array:  # noqa: N802
        """String connectivity, shape (α, n), over all nodes: −1 at the start, 1 at the end."""
        return _signed_incidence(self.strings, self.nodes.shape[1])

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
    names = ("bars", "strings", "fixed")
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
    for i, pair in enumerate(array.tolist()):
        for node in pair:
            if not node.is_integer():
                raise TypeError(f"{name}[{i}] is {pair}, expected two whole numbers")
            refuse_missing_node(f"{name}[{i}]", node, count)
        if pair[0] == pair[1]:
            raise ValueError(f"{name}[{i}] joins node {pair[0]:g} to itself")
    return array.astype(np.int64)


def refuse_missing_node(name: str, node: float, count: int) -> None:
    """Raise if a member or a loop names a node that there is not."""
    if not 0 <= node < count:
        raise ValueError(
            f"{name} names node {node:g}, expected 0 to {count - 1}: "
            f"there are {count} nodes, counted from 0"
        )


def _fixed_nodes(nodes: Any, count: int) -> IntArray:
    """Check the indices of fixed nodes and return them in ascending order."""
    array = np.atleast_1d(float_array("fixed", nodes))
    if array.ndim != 1:
        raise ValueError(f"fixed has shape {array.shape}, expected a sequence of node indices")
    given = indices("fixed", array, count, f"there are {count} nodes", "node ")
    nodes, counts = np.unique(given, return_counts=True)
    if (counts > 1).any():
        raise ValueError(f"fixed names node {nodes[counts.argmax()]} twice")
    return np.asarray(nodes)


def _refuse_repeats(bars: IntArray, strings: IntArray) -> None:
    seen: dict[tuple[int, int], str] = {}
    for name, pairs in (("bars", bars), ("strings", strings)):
        for i, pair in enumerate(pairs.tolist()):
            key = (min(pair), max(pair))
            label = f"{name}[{i}]"
            if key in seen:
                raise ValueError(
                    f"{label} joins nodes {key[0]} and {key[1]}, as {seen[key]} does; remove one"
                )
            seen[key] = label


def _refuse_shared_bar_nodes(bars: IntArray) -> None:
    on: dict[int, list[int]] = {}
    for i, pair in enumerate(bars.tolist()):
        for node in pair:
            on.setdefault(node, []).append(i)
    shared = {node: members for node, members in sorted(on.items()) if len(members) > 1}
    if shared:
        listed = "; ".join(f"node {node} is on bars {members}" for node, members in shared.items())
        raise ValueError(
            f"{listed}: not a class-1 structure, in which a node is on one bar at most. "
            "Give each bar its own node and join them by a short string"
        )


def _refuse_untouched_nodes(bars: IntArray, strings: IntArray, count: int) -> None:
    touched = np.concatenate([bars.ravel(), strings.ravel()])
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
