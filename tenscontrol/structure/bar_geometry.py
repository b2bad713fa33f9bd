"""Lengths of members."""

from __future__ import annotations

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.structure.blocks import restore_block
from tenscontrol.structure.structure import Structure, member_vectors
from tenscontrol.warn import warn

# How far, relative to its length, a bar may be off in a shape given by the user, or measured.
_TOLERANCE = 1e-8
MEASURED = 0.05


def bar_lengths(structure: Structure, nodes: FloatArray) -> FloatArray:
    """Return the lengths of the bars in a shape, m, shape (β,)."""
    return np.asarray(np.linalg.norm(structure.bar_vectors(nodes), axis=0))


def restore_bar_lengths(structure: Structure, nodes: object) -> FloatArray:
    """Return the nodes, corrected so that every bar has its true length.

    A bar is stretched about its centre, or about its fixed end. Bars that share nodes are moved
    together, as little as can be in the metric of their mass.

    Parameters
    ----------
    structure : Structure
        Gives the bar lengths.
    nodes : array_like, shape (d, n)
        Node positions, m, for example a disturbed shape.

    Returns
    -------
    ndarray, shape (d, n)
        Node positions, m. String nodes and the directions of bars that share no node are unchanged.

    Raises
    ------
    ValueError
        If the shape does not fit, a bar has no direction left, or bars that share nodes cannot be
        given their lengths near by.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> nodes = tc.structure.restore_bar_lengths(prism, 1.1 * prism.nodes)
    >>> bool(np.allclose(np.linalg.norm(prism.bar_vectors(nodes), axis=0), prism.bar_length))
    True
    """
    validation.instance(
        "structure", structure, Structure, "make one by Structure(...) or prism(...)"
    )
    return put_on_lengths(structure, nodes, structure.bar_length)


def put_on_lengths(structure: Structure, nodes: object, lengths: FloatArray) -> FloatArray:
    """Return the same where bars have these lengths, m, shape (β,)."""
    moved = structure.checked_nodes("nodes", nodes).copy()
    largest = np.abs(moved[:, structure.bar_nodes]).max(initial=0.0)
    most = _TOLERANCE / np.finfo(float).eps * lengths.min(initial=np.inf)
    if largest > most:
        raise ValueError(
            f"nodes has entries up to {largest:g} m, expected at most {most:g} m: beyond that, "
            "double precision cannot resolve the shortest bar"
        )
    vectors = structure.bar_vectors(moved)
    length = np.linalg.norm(vectors, axis=0)
    lost = np.flatnonzero(length == 0)
    if len(lost):
        raise ValueError(
            f"in nodes, the ends of bar {lost[0]} are at the same point, so that it has no "
            "direction; move one of them"
        )
    alone = np.concatenate([structure.free_bars, structure.swinging_bars])
    change = (vectors * (lengths / length - 1))[:, alone]
    share = structure.end_share[alone]
    start, end = structure.bars[alone].T
    moved[:, start] -= share[:, 0] * change
    moved[:, end] += share[:, 1] * change
    for block in structure.blocks:
        moved = restore_block(structure, block, moved, lengths)
        length = np.linalg.norm(structure.bar_vectors(moved)[:, block.bars], axis=0)
        off = np.abs(length / lengths[block.bars] - 1)
        if off.max() > _TOLERANCE:  # a mirrored shape of a body, which its redundant bars forbid
            raise ValueError(
                f"in nodes, the redundant bars among {sorted(block.bars.tolist())} cannot have "
                f"their lengths in a shape near this one: bar {block.bars[off.argmax()]} is off by "
                f"{off.max():.1e} of its length; give a shape nearer to one that they can have"
            )
    return moved


def rigid_shape(name: str, structure: Structure, nodes: FloatArray) -> FloatArray:
    """Return a shape; of one that was measured, give bars their lengths, and warn of that."""
    length = bar_lengths(structure, nodes)
    off = float(np.abs(length / structure.bar_length - 1).max(initial=0.0))
    if off <= _TOLERANCE:
        return nodes
    refuse_wrong_bar_lengths(name, structure, nodes, MEASURED)
    moved = restore_bar_lengths(structure, nodes)
    most = float(np.linalg.norm(moved - nodes, axis=0).max())
    warn(
        f"in {name}, bars are off by up to {off:.2g} of their length: nodes are moved by up to "
        f"{most:.3g} m, so that each bar has its own",
        RuntimeWarning,
    )
    return moved


def refuse_wrong_bar_lengths(
    name: str,
    structure: Structure,
    nodes: FloatArray,
    tolerance: float = _TOLERANCE,
    driven: IntArray | None = None,
) -> None:
    """Raise if a bar of this shape has not its length, naming the worst one that is not driven."""
    length = bar_lengths(structure, nodes)
    off = np.abs(length / structure.bar_length - 1)
    if driven is not None:
        off[driven] = 0.0
    if off.size and off.max() > tolerance:
        worst = int(off.argmax())
        raise ValueError(
            f"in {name}, bar {worst} has length {length[worst]:.9g} m, expected "
            f"{structure.bar_length[worst]:.9g} m as in the structure; bars are rigid. "
            "tenscontrol.structure.restore_bar_lengths(structure, nodes) corrects a shape"
        )


def refuse_strings_without_length(name: str, structure: Structure, nodes: FloatArray) -> None:
    """Raise if the ends of a string are at the same place: its force has no direction."""
    length = np.linalg.norm(member_vectors(nodes, structure.segments), axis=0)
    is_short = length <= max(1e-12 * length.max(initial=0.0), 1 / validation.LARGEST)
    if is_short.any():
        short = np.flatnonzero(is_short)
        start, end = structure.segments[short[0]]
        raise ValueError(
            f"in {name}, strings[{structure.segment_string[short[0]]}] has no length: nodes "
            f"{start} and {end} are at the same point, so that its force has no direction; move "
            "one of them"
        )


def refuse_other_bar_lengths(name: str, structure: Structure, bars: IntArray) -> None:
    """Refuse other lengths than those of the structure for bars that cannot have them."""
    held = bars[np.isin(structure.bars[bars], structure.fixed).all(axis=1)]
    if len(held):
        raise ValueError(
            f"{name} changes the length of bar {held[0]}, whose two ends are fixed: leave it at "
            f"{structure.bar_length[held[0]]:.9g} m"
        )
    for block in structure.blocks:
        among = np.intersect1d(bars, block.bars)
        if block.is_redundant and len(among):
            raise ValueError(
                f"{name} changes the length of bar {among[0]}, which hangs together with more bars "
                "than a rigid body needs: their lengths depend on one another. Leave out bars of "
                "the body, or its lengths as they are"
            )
