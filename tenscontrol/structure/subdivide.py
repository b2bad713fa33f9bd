"""Strings cut into segments, with point masses between them."""

from __future__ import annotations

import numpy as np

from tenscontrol.structure.bar_geometry import refuse_strings_without_length
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.structure import Structure
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    instance,
    per_member,
    positive,
    positive_number,
    refuse_fractions,
)


def subdivide(
    structure: Structure,
    segments: object,
    node_mass: float | None = None,
    string_mass: object = None,
) -> Structure:
    """Return the structure with its strings cut into segments, joined by point masses.

    Each string becomes a straight chain of equal segments. The nodes of ``structure`` come first,
    in their order; the new ones follow string by string, each string from its start to its end.
    Bars, masses, fixed nodes and groups are kept; a segment is in the group of its string. The
    result has ``structure`` as its ``parent`` and names the string that each segment is a part of
    in ``string_parent``.

    Parameters
    ----------
    structure : Structure
    segments : int or array_like of int, shape (α,)
        Number s of segments, one for all strings or one per string. A string
        with s = 1 is left as it is.
    node_mass : float, optional
        Mass of each new node, kg.
    string_mass : float or array_like, shape (α,), optional
        Mass of each whole string, kg, instead of ``node_mass``; 0 for a string that is not cut.

    Returns
    -------
    Structure
        With ``Σ (s − 1)`` nodes more and ``Σ s`` strings.

    Raises
    ------
    TypeError, ValueError
        If ``segments`` is not a whole number of at least 1; if not exactly one of ``node_mass`` and
        ``string_mass`` is given; if a mass is not positive, or belongs to a string that is not cut
        and so has no node to carry it; if a string has no length.

    Notes
    -----
    After Goyal & Skelton, *Dynamics of Class 1 Tensegrity Systems Including Cable Mass*, example 1.

    ``string_mass`` m is shared by the s − 1 new nodes, ``m/(s − 1)`` each: the ends of a string may
    be held, and none of the mass is to be lost. The frequencies of
    a cut string then approach those of the uniform string with an error of order 1/s. ``node_mass =
    m/s`` leaves the two outer half segments without mass, and the error is of order 1/s².

    A chain has the stiffness, damping and tension of its string when each
    segment has s times the stiffness, s times the damping and s times the
    force density, and rest length l0/s: see :func:`segment_counts`,
    :func:`spread_force_density` and :func:`spread_rest_length`. The paper's
    words "all string members are given stiffness values of 100 N/m" can also
    be read segment by segment: that is ``LinearStrings(stiffness=100.0)``, and
    each chain is then s times softer than its string.

    Examples
    --------
    The prism of the paper's example 1:

    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> massive = tc.subdivide(prism, segments=4, node_mass=0.01)
    >>> massive
    Structure(33 nodes, 3 bars, 36 strings)
    >>> massive.parent is prism, massive.string_parent[:6]
    (True, array([0, 0, 0, 0, 1, 1]))

    Strings that keep the stiffness of 100 N/m that they had whole:

    >>> strings = tc.LinearStrings(stiffness=100.0 * tc.structure.segment_counts(massive))
    """
    instance("structure", structure, Structure, "make one by Structure(...) or prism(...)")
    if structure.has_clusters:
        raise ValueError(
            "structure has clustered strings, which run over their inner nodes: they cannot be cut "
            "into segments with a mass"
        )
    counts = _counts(segments, len(structure.strings))
    mass = _point_masses(counts, node_mass, string_mass)
    if len(mass):
        refuse_strings_without_length("structure.nodes", structure, structure.nodes)
    known = structure.nodes.shape[1]

    # The new nodes: of string i, the j-th of s − 1.
    new = counts - 1
    string = np.repeat(np.arange(len(counts)), new)
    first = np.cumsum(new) - new
    share = (np.arange(new.sum()) - first[string] + 1) / counts[string]
    start, end = structure.nodes[:, structure.strings[string]].transpose(2, 0, 1)
    nodes = np.hstack([structure.nodes, (1 - share) * start + share * end])

    # A chain: start, new nodes, end. Its segments are the pairs of neighbours.
    pairs = []
    for i, (a, b) in enumerate(structure.strings):
        chain = np.r_[a, known + first[i] + np.arange(new[i]), b]
        pairs.append(np.column_stack([chain[:-1], chain[1:]]))
    string_parent = np.repeat(np.arange(len(counts)), counts)
    return Structure(
        nodes=nodes,
        bars=structure.bars,
        strings=np.vstack(pairs) if pairs else structure.strings,
        bar_mass=structure.bar_mass,
        point_mass=np.concatenate([structure.point_mass, mass]),
        string_groups=[structure.string_groups[i] for i in string_parent],
        fixed=structure.fixed,
        rollers=structure.rollers,
        parent=structure,
        string_parent=string_parent,
    )


def _counts(segments: object, count: int) -> IntArray:
    """Return the number of segments of each string."""
    if isinstance(segments, bool):
        raise TypeError(f"segments is {segments}, expected a whole number of at least 1")
    counts = per_member("segments", segments, count, "string")
    refuse_fractions("segments", counts)
    positive("segments", counts, "whole number; 1 leaves the string as it is")
    refuse_many_members(f"segments is {float(np.max(counts, initial=1)):g}", counts.sum())
    return counts.astype(np.int64)


def _point_masses(counts: IntArray, node_mass: object, string_mass: object) -> FloatArray:
    """Return the mass of each new node."""
    if (node_mass is None) == (string_mass is None):
        found = "no mass" if node_mass is None else "node_mass and string_mass"
        raise ValueError(
            f"found {found}, expected exactly one of node_mass (kg, of each new node) and "
            "string_mass (kg, of each whole string)"
        )
    new = counts - 1
    if node_mass is not None:
        return np.full(int(new.sum()), positive_number("node_mass", node_mass, "kg"))
    mass = per_member("string_mass", string_mass, len(counts), "string")
    for i, (m, points) in enumerate(zip(mass.tolist(), new.tolist(), strict=True)):
        if points == 0 and m != 0:
            raise ValueError(
                f"string_mass[{i}] is {m:g}, but string {i} is not cut (segments is 1) and has "
                "no node to carry it; cut it, or give an array with 0 there"
            )
        if points > 0 and m <= 0:
            raise ValueError(f"string_mass[{i}] is {m:g}, expected a positive mass in kg")
    return np.repeat(mass / np.maximum(new, 1), new)
