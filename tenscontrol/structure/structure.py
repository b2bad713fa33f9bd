"""The structure, which all else starts from."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, all_but, frozen
from tenscontrol.properties import cached_property
from tenscontrol.structure.blocks import Block, find_blocks
from tenscontrol.structure.connectivity import (
    checked_members,
    checked_strings,
    checked_supports,
    members_of,
    refuse_bars_without_length,
    refuse_repeats,
    refuse_untouched_nodes,
    selection,
    signed_incidence,
    warn_of_useless_strings,
)
from tenscontrol.viewable import Viewable

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False, init=False)
class Structure(Viewable):
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
        Start and end node of each string, or the nodes along it. A path of more nodes, ``(1, 2,
        3)``, is a *clustered* string: it runs over the inner nodes without friction, with one
        tension and one rest length. It is closed if it ends where it starts.
    bar_mass : float or array_like, shape (β,)
        Mass of each bar, kg, spread evenly along it. One number serves all. Without bars it may be
        None.
    string_node_mass : float or array_like, shape (σ,), optional
        Mass of each string node, kg, in ascending order of node index, or of each node on no bar,
        fixed ones among them. It takes the place of ``point_mass`` there.
    fixed : sequence or set of int and of (int, str), or of bool, shape (n,), optional
        Nodes that are held, and pairs of a node and an axis to hold along it. A mask of
        nodes, or pairs with the axis ``"x"``, ``"y"`` or ``"z"``: a roller. What is held costs no
        state and no mass. A bar with one fixed end swings about it; one with both ends fixed is
        part of the support.
    string_groups : sequence of str, length α, optional
        Name of the group of each string, used in names of signals and to refer to strings in words.
        All are ``"string"`` when not given.
    parent : Structure, optional
        The structure that this one was made from; :func:`subdivide` and
        :func:`skin` set it. Its nodes are the first of this one.
    string_parent : array_like of int, shape (α,), optional
        For each string, the index of the string of ``parent`` that it is a
        segment of; :func:`subdivide` sets it.
    point_mass : float or array_like, shape (n,), optional
        Mass at each node, kg, in addition to that of the bars: a payload, a motor, a string node.
        Every string node needs one. On a fixed node it is kept, and does nothing.
    rollers : sequence of (int, str), optional
        More pairs like those of ``fixed``, which end up here.
    paths : sequence of sequence of int, optional
        The nodes that each string runs over, if one is clustered: ``strings`` as it was given,
        which then has the first and the last node of each.

    Raises
    ------
    TypeError
        If an argument is not an array of numbers, or an index is not a whole number.
    ValueError
        If a shape does not fit, an index is out of range, a member joins a node to itself, a bar
        repeats another, a clustered string passes a node twice, a free node has no member, a bar
        has no length, a mass is missing or not positive, or ``string_parent`` does not fit
        ``parent``. The message names what is wrong.

    Warns
    -----
    UserWarning
        If a straight string joins the same nodes as another of its group, or as a bar.

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
    string_groups: tuple[str, ...]
    fixed: IntArray
    parent: Structure | None
    string_parent: IntArray | None
    point_mass: FloatArray
    rollers: tuple[tuple[int, str], ...]
    paths: tuple[tuple[int, ...], ...]

    def __init__(
        self,
        nodes: ArrayLike,
        bars: ArrayLike,
        strings: ArrayLike | Sequence[Sequence[int]],
        bar_mass: ArrayLike | None,
        string_node_mass: ArrayLike | None = None,
        string_groups: Sequence[str] | None = None,
        fixed: ArrayLike | Collection[int | tuple[int, str]] | None = (),
        parent: Structure | None = None,
        string_parent: ArrayLike | None = None,
        point_mass: ArrayLike | None = None,
        rollers: Sequence[tuple[int, str]] | None = (),
        paths: Sequence[Sequence[int]] | None = (),
    ) -> None:
        N = validation.float_array("nodes", nodes)
        if N.ndim != 2 or N.shape[0] not in (2, 3) or N.shape[1] == 0:
            hint = "; transpose it" if N.ndim == 2 and N.shape[1] in (2, 3) else ""
            raise ValueError(
                f"nodes has shape {N.shape}, expected (3, n), or (2, n) in the plane: "
                f"one column per node{hint}"
            )
        count = N.shape[1]
        put = object.__setattr__  # the dataclass is frozen for everyone else
        put(self, "nodes", frozen(N))
        put(self, "bars", frozen(checked_members("bars", bars, count)))
        refuse_repeats(self.bars)
        refuse_bars_without_length(N, self.bars)
        ends, checked_paths = checked_strings(strings, paths, count)
        put(self, "strings", frozen(ends))
        put(self, "paths", checked_paths)
        held, rolling = checked_supports(fixed, rollers, N.shape)
        refuse_untouched_nodes(self.bars, self.segments, held, count)
        put(self, "fixed", frozen(held))
        put(self, "rollers", rolling)
        given = () if bar_mass is None and not len(self.bars) else bar_mass
        mass = validation.per_member("bar_mass", given, len(self.bars), "bar")
        put(self, "bar_mass", frozen(validation.positive("bar_mass", mass, "mass in kg")))
        put(self, "point_mass", frozen(self._checked_point_mass(point_mass, string_node_mass)))
        put(self, "string_groups", self._checked_groups(string_groups))
        # Strings of another structure, which are read-only, were looked at when it was made.
        if not ((isinstance(strings, np.ndarray) and not strings.flags.writeable) or self.paths):
            warn_of_useless_strings(self.bars, self.strings, self.string_groups)
        if parent is not None:
            validation.instance(
                "parent", parent, Structure, "the structure that this one was made from"
            )
        put(self, "parent", parent)
        put(self, "string_parent", self._checked_string_parent(string_parent))
        _ = self.blocks  # refuses what does not determine its forces

    def _checked_point_mass(self, given: Any, alone: Any) -> FloatArray:
        """Return the mass at each node, from that of all and that of the string nodes alone."""
        points, count = self.string_nodes, self.nodes.shape[1]
        mass = validation.per_member("point_mass", 0.0 if given is None else given, count, "node")
        validation.non_negative("point_mass", mass, "mass in kg")
        if alone is not None:
            array = validation.vector("string_node_mass", alone)
            loose = all_but(count, self.bars.ravel())
            if array.shape == loose.shape:
                points = loose  # fixed nodes among them
            of_points = validation.per_member("string_node_mass", array, len(points), "string node")
            mass[points] = validation.positive("string_node_mass", of_points, "mass in kg")
        points = self.string_nodes
        bare = points[mass[points] == 0]
        if len(bare):
            raise ValueError(
                f"node {bare[0]} is in none of bars, so it is a point mass and needs "
                f"string_node_mass: one number, or one for each of the {len(points)} string nodes; "
                f"or give point_mass, one number, or one for each of the {count} nodes"
            )
        return mass

    def _checked_groups(self, given: Any) -> tuple[str, ...]:
        if given is None:
            return ("string",) * len(self.strings)
        groups = validation.items("string_groups", given, "names, one per string")
        if len(groups) != len(self.strings):
            raise ValueError(
                f"string_groups has {len(groups)} names, "
                f"expected {len(self.strings)}: one per string"
            )
        known = set[str]()
        for i, group in enumerate(groups):
            if type(group) is not str or group not in known:  # a few names stand for many strings
                known.add(validation.identifier(f"string_groups[{i}]", group))
        return groups

    def _checked_string_parent(self, given: Any) -> IntArray | None:
        if given is None:
            return None
        if self.parent is None:
            raise ValueError("string_parent is given without parent, whose strings it counts")
        count = len(self.parent.strings)
        array = validation.shaped("string_parent", given, (len(self.strings),), "one per string")
        parent = validation.indices(
            "string_parent", array, count, f"the parent has {count} strings"
        )
        missing = all_but(count, parent)
        if len(missing):
            raise ValueError(
                f"string_parent leaves out string {missing[0]} of the parent, "
                "expected at least one segment of each"
            )
        return frozen(parent)

    def __repr__(self) -> str:
        return (
            f"Structure({self.nodes.shape[1]} nodes, {len(self.bars)} bars, "
            f"{len(self.strings)} strings)"
        )

    def save(self, path: str | Path) -> Path:
        """Write the structure to a file, as TOML or JSON. It comes back bit by bit.

        Parameters
        ----------
        path : str or Path
            Its name ends in ``.toml`` or ``.json``.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ValueError
            If the name has another ending.
        OSError
            If the file cannot be written: one that was there is as it was.

        Notes
        -----
        The TOML is the table ``[structure]`` of a scene file; see :func:`load_scene`. A structure
        that was made from another, by :func:`subdivide` or :func:`skin`, holds it as ``parent``.

        Examples
        --------
        >>> import tempfile, tenscontrol as tc
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = tc.library.six_bar_ball().save(folder + "/ball.toml")
        ...     tc.Structure.load(file)
        Structure(12 nodes, 6 bars, 24 strings)
        """
        from tenscontrol.structure.structure_file import write_structure

        return write_structure(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the structure of a file that :meth:`save` wrote, or that was written by hand.

        Parameters
        ----------
        path : str or Path
            Its name ends in ``.toml`` or ``.json``.

        Returns
        -------
        Structure

        Raises
        ------
        OSError
            If the file cannot be read.
        ValueError
            If the file holds no structure, or one that :class:`Structure` refuses, or its version
            is a later one. The message names the file and the key.
        """
        from tenscontrol.structure.structure_file import read_structure

        return read_structure(path, cls)

    @classmethod
    def from_matrices(
        cls,
        nodes: ArrayLike,
        C_b: object,
        C_s: object,
        bar_mass: ArrayLike | None,
        string_node_mass: ArrayLike | None = None,
        string_groups: Sequence[str] | None = None,
        fixed: ArrayLike | Collection[int | tuple[int, str]] | None = (),
        point_mass: ArrayLike | None = None,
    ) -> Self:
        """Return the structure of connectivity matrices: ``B = N C_bᵀ``, ``S = N C_sᵀ``.

        Parameters
        ----------
        nodes : array_like, shape (d, n)
            Node positions N, m.
        C_b, C_s : array_like or sparse array, shape (β, n) and (α, n)
            Connectivity of bars and strings over all nodes: in each row −1 at the start and 1 at
            the end, as MATLAB toolboxes have it. ``C_b C_nb`` of a structure is its first one.
        bar_mass : float or array_like, shape (β,)
            Mass of each bar, kg.
        string_node_mass, string_groups, fixed, point_mass : optional
            As of :class:`Structure`.

        Returns
        -------
        Structure

        Raises
        ------
        TypeError, ValueError
            If a row has not one −1 and one 1, or as :class:`Structure` does.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> prism = tc.prism()
        >>> tc.Structure.from_matrices(prism.nodes, prism.C_b @ prism.C_nb, prism.C_s, 1.0)
        Structure(6 nodes, 3 bars, 9 strings)
        """
        count = (validation.float_array("nodes", nodes).shape or (0,))[-1]
        bars, strings = (members_of(*named, count) for named in (("C_b", C_b), ("C_s", C_s)))
        return cls(
            nodes, bars, strings, bar_mass, string_node_mass, string_groups, fixed,
            point_mass=point_mass,
        )  # fmt: skip

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
        held = np.concatenate([self.fixed, self.bars.ravel()])
        return frozen(all_but(self.nodes.shape[1], held))

    @cached_property
    def string_node_mass(self) -> FloatArray:
        """Mass of each string node, kg, shape (σ,): that of ``point_mass`` there."""
        return frozen(self.point_mass[self.string_nodes])

    @cached_property
    def free(self) -> IntArray:
        """Indices of the nodes that are not fixed, ascending; those on rollers are among them."""
        return frozen(all_but(self.nodes.shape[1], self.fixed))

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
        return frozen(all_but(self.nodes.size, self.fixed_rows))

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
    def kept_bars(self) -> IntArray:
        """Indices of the bars that move and whose lengths are to be kept, no redundant ones."""
        of_blocks = (block.independent for block in self.blocks)
        return frozen(np.concatenate([self.free_bars, self.swinging_bars, *of_blocks]))

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
    def size(self) -> float:
        """Largest extent along an axis, m: what lengths are small or large beside."""
        return float(np.ptp(self.nodes, axis=1).max())

    @cached_property
    def bar_length(self) -> FloatArray:
        """Bar lengths l, m, shape (β,). They stay what they are in the reference shape."""
        return frozen(np.linalg.norm(self.bar_vectors(self.nodes), axis=0))

    def bar_vectors(self, nodes: object) -> FloatArray:
        """Return the bar vectors B = N C_nbᵀ C_bᵀ, shape (d, β), from start to end node.

        Parameters
        ----------
        nodes : array_like, shape (d, n) or (d, n, T)
            Node positions, m, or velocities, m/s, of one shape or of a motion; the result has the
            same unit, and of a motion shape (d, β, T).
        """
        return self._vectors(self.bars, nodes)

    def string_vectors(self, nodes: object) -> FloatArray:
        """Return the string vectors S = N C_sᵀ, from start to end node, of each segment.

        Parameters
        ----------
        nodes : array_like, shape (d, n) or (d, n, T)
            Node positions, m, or velocities, m/s, of one shape or of a motion; the result has the
            same unit.

        Returns
        -------
        ndarray, shape (d, s) or (d, s, T)
            A column for each of the ``segments``: for each string, where none is clustered.
        """
        return self._vectors(self.segments, nodes)

    def _vectors(self, pairs: IntArray, nodes: object) -> FloatArray:
        N = validation.float_array("nodes", nodes)
        if N.shape[:2] != self.nodes.shape or N.ndim != 3:
            N = self.checked_nodes("nodes", N)
        return member_vectors(N, pairs)

    def string_length(self, nodes: object = None) -> FloatArray:
        """Return the string lengths, m, shape (α,), of the reference shape or of ``nodes``.

        Those of a motion have shape (α, T).

        A clustered string is as long as its segments together.

        Parameters
        ----------
        nodes : array_like, shape (d, n) or (d, n, T), optional
            Node positions, m, of one shape or of a motion.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> tc.prism().string_length().round(4)
        array([0.866, 0.866, 0.866, 0.866, 0.866, 0.866, 1.033, 1.033, 1.033])
        >>> run = tc.simulate(tc.Model(tc.prism()), 0.01, force_density=10.0, step=1e-3)
        >>> run.structure.string_length(run.nodes).shape
        (9, 11)
        """
        vectors = self.string_vectors(self.nodes if nodes is None else nodes)
        length = np.asarray(np.linalg.norm(vectors, axis=0))
        if not self.has_clusters:
            return length
        total = np.zeros((len(self.strings), *length.shape[1:]))
        np.add.at(total, self.segment_string, length)
        return total

    def strings_in(self, group: str) -> IntArray:
        """Return the indices of the strings of one group, or raise and list the groups.

        Parameters
        ----------
        group : str
            A name from ``string_groups``.
        """
        validation.choice("group", group, dict.fromkeys(self.string_groups))
        return np.array([i for i, name in enumerate(self.string_groups) if name == group])

    def checked_nodes(self, name: str, nodes: object) -> FloatArray:
        """Return positions or velocities as an array, shape (d, n), or raise naming the argument.

        Parameters
        ----------
        name : str
            What the message calls them.
        nodes : array_like, shape (d, n)
            m or m/s.
        """
        axes = ", ".join("xyz"[: self.dimension])
        meaning = f"one column of {axes} per node of the structure"
        return validation.shaped(name, nodes, self.nodes.shape, meaning)

    # The paper's matrices, built on demand. The dynamics never multiply by them:
    # every product is done member by member.

    @property
    def C_b(self) -> csr_array:  # noqa: N802
        """Bar connectivity, shape (β, 2β), over the bar nodes: −1 at the start, 1 at the end."""
        position = np.searchsorted(self.bar_nodes, self.bars)
        return signed_incidence(position, len(self.bar_nodes))

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
        return signed_incidence(self.segments, self.nodes.shape[1])

    @property
    def C_nb(self) -> csr_array:  # noqa: N802
        """Selects the bar nodes, shape (2β, n): ``N_b = N C_nbᵀ``."""
        return selection(self.bar_nodes, self.nodes.shape[1])

    @property
    def C_ns(self) -> csr_array:  # noqa: N802
        """Selects the free string nodes, shape (σ, n): ``N_s = N C_nsᵀ``."""
        return selection(self.string_nodes, self.nodes.shape[1])

    @property
    def C_sb(self) -> csr_array:  # noqa: N802
        """The columns of C_s that belong to bar nodes, shape (α, 2β)."""
        return self.C_s[:, self.bar_nodes]

    @property
    def C_ss(self) -> csr_array:  # noqa: N802
        """The columns of C_s that belong to free string nodes, shape (α, σ)."""
        return self.C_s[:, self.string_nodes]


def member_vectors(nodes: FloatArray, pairs: IntArray) -> FloatArray:
    """Return the vectors between pairs of nodes (d, n, ...), (d, pairs, ...), from start to end."""
    ends = nodes.take(pairs, axis=1)
    vectors: FloatArray = ends[:, :, 1] - ends[:, :, 0]
    return vectors


def refuse_all_fixed(structure: Structure) -> None:
    """Raise if no node is free."""
    if not len(structure.free):
        raise ValueError("every node of the model is fixed: nothing can move")


def same_members(one: Structure, other: Structure | None, feet: IntArray | tuple[()] = ()) -> bool:
    """Return whether bars, strings and supports are the same; masses and lengths may differ.

    Supports at ``feet`` may differ too.
    """
    return other is not None and not different_members(one, other, feet)


def different_members(one: Structure, other: Structure, feet: IntArray | tuple[()] = ()) -> str:
    """Return in what the members of two structures differ, as text; empty where they do not.

    See :func:`same_members`.
    """
    if one.nodes.shape != other.nodes.shape:
        (d, n), (k, m) = one.nodes.shape, other.nodes.shape
        return f"{n} and {m} nodes" if d == k else f"nodes of {d} and {k} coordinates"
    differences = []
    if not np.array_equal(one.bars, other.bars):
        differences.append("other bars")
    if not all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("segments", "segment_string")
    ):
        differences.append("other strings")
    ours, theirs = (
        structure.fixed_rows[~np.isin(structure.fixed_rows // structure.dimension, feet)]
        for structure in (one, other)
    )
    if not np.array_equal(ours, theirs):
        differences.append(
            "other supports, at the nodes {} and {}".format(
                *(np.unique(rows // one.dimension).tolist() for rows in (ours, theirs))
            )
        )
    return " and ".join(differences)
