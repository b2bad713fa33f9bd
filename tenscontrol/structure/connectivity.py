"""Checks of the connectivity that a user gives: members, paths of strings, supports."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, all_but
from tenscontrol.warn import warn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scipy.sparse import csr_array

# A bar shorter than this fraction of the structure's size has no direction in double precision.
_ZERO_LENGTH = 1e-12

Paths = tuple[tuple[int, ...], ...]
Rollers = tuple[tuple[int, str], ...]


def checked_members(name: str, pairs: Any, count: int) -> IntArray:
    """Return index pairs: shape (·, 2), whole numbers, in range, not from a node to itself."""
    array = validation.float_array(name, pairs)
    if array.shape in ((0,), (0, 2)):
        return np.zeros((0, 2), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(
            f"{name} has shape {array.shape}, expected (count, 2): a start and an end node each"
        )
    ends = [
        validation.indices(name, nodes, count, f"there are {count} nodes", "node ")
        for nodes in array.T
    ]
    loops = np.flatnonzero(ends[0] == ends[1])
    if len(loops):
        raise ValueError(f"{name}[{loops[0]}] joins node {ends[0][loops[0]]} to itself")
    return np.column_stack(ends)


def members_of(name: str, matrix: Any, count: int) -> IntArray:
    """Return start and end node of each member, shape (·, 2), from its connectivity matrix."""
    C = validation.float_array(name, matrix.toarray() if hasattr(matrix, "toarray") else matrix)
    if C.size == 0:
        return np.zeros((0, 2), dtype=np.int64)
    if C.ndim != 2 or C.shape[1] != count:
        raise ValueError(
            f"{name} has shape {C.shape}, expected (members, {count}): a column for each of nodes"
        )
    wrong = np.flatnonzero(
        ((C == -1).sum(axis=1) != 1) | ((C == 1).sum(axis=1) != 1) | ((C != 0).sum(axis=1) != 2)
    )
    if len(wrong):
        raise ValueError(
            f"{name}[{wrong[0]}] is {C[wrong[0]].tolist()}, expected one -1, at the start node, "
            "and one 1, at the end node"
        )
    return np.column_stack([C.argmin(axis=1), C.argmax(axis=1)])


def checked_strings(strings: Any, paths: Any, count: int) -> tuple[IntArray, Paths]:
    """Return the first and last nodes of strings, shape (α, 2), and all paths if one is longer."""
    given = () if paths is None else validation.items("paths", paths, "paths of nodes")
    if not given:
        if not (isinstance(strings, list | tuple) and any(map(_is_path, strings))):
            return checked_members("strings", strings, count), ()
        checked = tuple(_path(f"strings[{i}]", path, count) for i, path in enumerate(strings))
    else:
        checked = tuple(_path(f"paths[{i}]", path, count) for i, path in enumerate(given))
    ends = np.array([(path[0], path[-1]) for path in checked])
    if given and not np.array_equal(ends, validation.float_array("strings", strings)):
        raise ValueError(
            "strings and paths differ, expected in strings the first and the last node of each "
            "path. With new strings give paths=(): strings may hold paths themselves"
        )
    if all(len(path) == 2 for path in checked):
        return ends, ()
    return ends, checked


def checked_supports(fixed: Any, rollers: Any, shape: tuple[int, ...]) -> tuple[IntArray, Rollers]:
    """Return the nodes that are fixed, ascending, and the (node, axis) pairs of the others.

    What is named twice is held once.
    """
    d, count = shape
    nodes, pairs = () if fixed is None else fixed, []
    if isinstance(fixed, list | tuple | set | frozenset):
        pairs = [entry for entry in fixed if isinstance(entry, list | tuple)]
        nodes = [entry for entry in fixed if not isinstance(entry, list | tuple)]
        if any(isinstance(node, str) for node in nodes):
            raise TypeError(
                f"fixed is {fixed!r}, expected node indices; a node and an axis are a pair of "
                'their own, as in [0, (4, "z")]'
            )
    array = validation.index_array("fixed", nodes, count)
    whole = validation.indices("fixed", array, count, f"there are {count} nodes", "node ").tolist()
    held = [(node, axis) for node in whole for axis in "xyz"[:d]]
    held += [_roller("fixed", pair, d, count) for pair in pairs]
    more = () if rollers is None else rollers
    for pair in validation.items("rollers", more, "pairs of a node and an axis"):
        held.append(_roller("rollers", pair, d, count))
    by_node: dict[int, set[str]] = {}
    for node, axis in held:
        by_node.setdefault(node, set()).add(axis)
    still = sorted(node for node, axes in by_node.items() if len(axes) == d)
    rolling = sorted((node, axis) for node, axis in set(held) if len(by_node[node]) < d)
    return np.array(still, dtype=np.int64), tuple(rolling)


def refuse_repeats(bars: IntArray) -> None:
    """Raise if two bars join the same nodes."""
    low, high = bars.min(axis=1), bars.max(axis=1)
    pairs = np.sort(low * (1 + high.max(initial=0)) + high)
    if (np.diff(pairs) > 0).all():
        return
    _, first, which = np.unique(np.sort(bars), axis=0, return_index=True, return_inverse=True)
    again = int(np.argmax(first[which.ravel()] != np.arange(len(bars))))
    one, other = sorted(bars[again].tolist())
    raise ValueError(
        f"bars[{again}] joins nodes {one} and {other}, as bars[{first[which.ravel()[again]]}] "
        "does; remove one"
    )


def warn_of_useless_strings(bars: IntArray, strings: IntArray, groups: tuple[str, ...]) -> None:
    """Warn of straight strings that repeat another of their group, or that run along a bar."""
    pairs = np.sort(np.concatenate([bars, strings]), axis=1)
    nodes = int(pairs.max(initial=0)) + 1
    _, which, members = np.unique(pairs @ [nodes, 1], return_inverse=True, return_counts=True)
    is_alone = members[which] == 1  # as most are: an object of Python for each would cost more
    joined = pairs.tolist() if not is_alone.all() else []
    along = {tuple(joined[i]): i for i in np.flatnonzero(~is_alone[: len(bars)]).tolist()}
    first: dict[tuple[object, ...], int] = {}
    for i in np.flatnonzero(~is_alone[len(bars) :]).tolist():
        (low, high), group = joined[len(bars) + i], groups[i]
        if (bar := along.get((low, high))) is not None:
            warn(
                f"strings[{i}] joins nodes {low} and {high}, as bars[{bar}] does: it never changes "
                "its length, so that it does not act on the motion",
                UserWarning,
            )
        if (other := first.setdefault((low, high, group), i)) != i:
            warn(
                f"strings[{i}] joins nodes {low} and {high}, as strings[{other}] does: both pull. "
                "Remove one; if two strings are meant, give them different string_groups",
                UserWarning,
            )


def refuse_untouched_nodes(bars: IntArray, segments: IntArray, held: IntArray, count: int) -> None:
    """Raise if a node has no member, unless it is fixed."""
    touched = np.concatenate([bars.ravel(), segments.ravel(), held])
    untouched = all_but(count, touched)
    if len(untouched):
        raise ValueError(
            f"nodes[:, {untouched[0]}]"
            + (f" (and {len(untouched) - 1} more)" if len(untouched) > 1 else "")
            + " is in none of bars, strings and fixed; remove it, join it by a bar or a string, or "
            "fix it"
        )


def refuse_bars_without_length(nodes: FloatArray, bars: IntArray) -> None:
    """Raise if the ends of a bar are at the same place."""
    size = float(np.ptp(nodes, axis=1).max())
    length = np.linalg.norm(nodes[:, bars[:, 1]] - nodes[:, bars[:, 0]], axis=0)
    short = np.flatnonzero(length <= _ZERO_LENGTH * size)
    if len(short):
        start, end = bars[short[0]]
        raise ValueError(
            f"bars[{short[0]}] has no length: nodes {start} and {end} are at the same place"
        )


def refuse_many_members(asked: str, count: float) -> None:
    """Raise if so many members do not fit in memory: to be checked, each takes 800 bytes."""
    validation.refuse_memory(asked, count, "bars and strings", 800)


def signed_incidence(pairs: IntArray, columns: int) -> csr_array:
    """Return −1 at the start and 1 at the end of each pair, shape (·, columns)."""
    from scipy.sparse import csr_array

    rows = np.repeat(np.arange(len(pairs)), 2)
    values = np.tile([-1.0, 1.0], len(pairs))
    return csr_array((values, (rows, pairs.ravel())), shape=(len(pairs), columns))


def selection(columns: IntArray, count: int) -> csr_array:
    """Return the rows of the identity that select these columns, shape (·, count)."""
    from scipy.sparse import csr_array

    rows = np.arange(len(columns))
    return csr_array((np.ones(len(columns)), (rows, columns)), shape=(len(columns), count))


def _is_path(path: Any) -> bool:
    """Return whether a string is given by another number of nodes than two."""
    is_array = isinstance(path, np.ndarray) and path.ndim > 0
    return (is_array or isinstance(path, list | tuple)) and len(path) != 2


def _path(name: str, path: Any, count: int) -> tuple[int, ...]:
    array = np.atleast_1d(validation.float_array(name, path))
    if array.ndim != 1 or len(array) < 2:
        raise ValueError(
            f"{name} has shape {array.shape}, expected (k,) with k at least 2: the nodes that "
            "the string runs over"
        )
    nodes = validation.indices(name, array, count, f"there are {count} nodes", "node ").tolist()
    for node, following in pairwise(nodes):
        if node == following:
            raise ValueError(f"{name} joins node {node} to itself")
    inner = nodes[:-1] if nodes[0] == nodes[-1] and len(nodes) > 3 else nodes
    if len(set(inner)) < len(inner):
        node = next(node for node in inner if inner.count(node) > 1)
        raise ValueError(
            f"{name} passes node {node} twice, expected each node once; a closed string runs over "
            "at least three nodes and ends where it starts"
        )
    return tuple(nodes)


def _roller(name: str, pair: Any, d: int, count: int) -> tuple[int, str]:
    if not (isinstance(pair, list | tuple) and len(pair) == 2):
        raise ValueError(f"{name} has {pair!r}, expected pairs of a node and an axis")
    number = validation.float_array(name, pair[0])
    if number.ndim:
        raise ValueError(f"{name} has {pair!r}, expected pairs of a node and an axis")
    (node,) = validation.indices(
        name, number[None], count, f"there are {count} nodes", "node "
    ).tolist()
    return node, validation.choice(f"{name} axis of node {node}", pair[1], tuple("xyz"[:d]))


def member_images(paths: Sequence[Sequence[int]], to: IntArray) -> list[int]:
    """Return the member that each is taken to where node i is taken to ``to[i]``, or -1 for none.

    Members between the same nodes are taken to one another in their order.
    """
    places: dict[tuple[int, ...], list[int]] = {}
    for i, path in enumerate(paths):
        places.setdefault(_undirected(path), []).append(i)
    images = []
    for i, path in enumerate(paths):
        alike = places[_undirected(path)]
        candidates = places.get(_undirected(to[list(path)].tolist()), [])
        images.append(candidates[alike.index(i)] if len(candidates) == len(alike) else -1)
    return images


def _undirected(path: Sequence[int]) -> tuple[int, ...]:
    """Return the nodes of a member, the same whichever way it is run through."""
    nodes = list(path)
    if nodes[0] == nodes[-1]:
        first = nodes.index(min(nodes))
        around = nodes[first:-1] + nodes[:first]
        return min(tuple(around), (around[0], *around[:0:-1]))
    return min(tuple(nodes), tuple(nodes[::-1]))
