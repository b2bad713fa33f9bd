"""Lengths of bars and strings in a shape: checked, and those of bars restored."""

from __future__ import annotations

import numpy as np

from tenscontrol.structure.structure import Structure
from tenscontrol.validation import FloatArray, instance

# How far, relative to its length, a bar may be off in a shape given by the user.
_TOLERANCE = 1e-8


def restore_bar_lengths(structure: Structure, nodes: object) -> FloatArray:
    """Return the nodes with every bar stretched to its true length.

    A bar is stretched about its centre, or about its fixed end.

    Parameters
    ----------
    structure : Structure
        Gives the bar lengths.
    nodes : array_like, shape (3, n)
        Node positions, m, for example a disturbed shape.

    Returns
    -------
    ndarray, shape (3, n)
        Node positions, m. Bar directions and string nodes are unchanged.

    Raises
    ------
    ValueError
        If the shape does not fit or a bar has no direction left.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> nodes = tc.structure.restore_bar_lengths(prism, 1.1 * prism.nodes)
    >>> bool(np.allclose(np.linalg.norm(prism.bar_vectors(nodes), axis=0), prism.bar_length))
    True
    """
    instance("structure", structure, Structure, "make one by Structure(...) or prism(...)")
    moved = structure.checked_nodes("nodes", nodes).copy()
    vectors = structure.bar_vectors(moved)
    length = np.linalg.norm(vectors, axis=0)
    lost = np.flatnonzero(length == 0)
    if len(lost):
        raise ValueError(f"the ends of bar {lost[0]} are at the same place: it has no direction")
    change = vectors * (structure.bar_length / length - 1)
    share = structure.end_share
    moved[:, structure.bars[:, 0]] -= share[:, 0] * change
    moved[:, structure.bars[:, 1]] += share[:, 1] * change
    return moved


def refuse_wrong_bar_lengths(name: str, structure: Structure, nodes: FloatArray) -> None:
    """Raise if a bar of this shape has not its length, naming the worst one."""
    length = np.linalg.norm(structure.bar_vectors(nodes), axis=0)
    off = np.abs(length / structure.bar_length - 1)
    if off.size and off.max() > _TOLERANCE:
        worst = int(off.argmax())
        raise ValueError(
            f"in {name}, bar {worst} has length {length[worst]:.9g} m, expected "
            f"{structure.bar_length[worst]:.9g} m as in the structure; bars are rigid. "
            "restore_bar_lengths(structure, nodes) mends a shape"
        )


def refuse_strings_without_length(name: str, structure: Structure, nodes: FloatArray) -> None:
    """Raise if the ends of a string are at the same place: its force has no direction."""
    length = structure.string_length(nodes)
    short = np.flatnonzero(length <= 1e-12 * length.max(initial=0.0))
    if len(short):
        start, end = structure.strings[short[0]]
        raise ValueError(
            f"in {name}, strings[{short[0]}] has no length: nodes {start} and {end} are at the "
            "same place, so that its force has no direction"
        )
