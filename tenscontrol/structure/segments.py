"""Division of strings into segments, with the map between values of both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.structure.bar_geometry import refuse_strings_without_length
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.structure import Structure

# A string of s segments in series, all with the same tension. The value of each segment is that of
# the whole string times s to this power.
_POWER = {
    "force_density": 1,
    "rest_length": -1,
    "length": -1,
    "tension": 0,
    "stiffness": 1,
    "damping": 1,
    "axial_rigidity": 0,
}


def subdivide(
    structure: Structure,
    segments: object,
    node_mass: float | None = None,
    string_mass: object = None,
) -> Structure:
    """Return the structure with its strings divided into segments, with point masses between.

    Each string becomes a straight chain of equal segments. The nodes of ``structure`` come first,
    in their order; the new ones follow string by string, each string from its start to its end.
    Bars, masses, fixed nodes and groups are kept; a segment is in the group of its string. The
    result has ``structure`` as its ``parent`` and names the string that each segment is a part of
    in ``string_parent``.

    Parameters
    ----------
    structure : Structure
    segments : int or array_like of int, shape (α,)
        Number s of segments of a string, one for all strings or one per string. A string with s = 1
        is left as it is.
    node_mass : float, optional
        Mass of each new node, kg. Not needed where no string is cut.
    string_mass : float or array_like, shape (α,), optional
        Mass of each whole string, kg, spread over its new nodes, instead of ``node_mass``; 0 for a
        string that is not cut.

    Returns
    -------
    Structure
        With ``Σ (s − 1)`` nodes more and ``Σ s`` strings.

    Raises
    ------
    TypeError, ValueError
        If ``segments`` is not a whole number of at least 1; if a string is cut, and not exactly one
        of ``node_mass`` and ``string_mass`` is given, or strings are clustered; if a mass is not
        positive, or belongs to a string that is not cut and so has no node to carry it; if a string
        has no length.

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
    validation.instance(
        "structure", structure, Structure, "make one by Structure(...) or prism(...)"
    )
    counts = _counts(segments, len(structure.strings))
    mass = _point_masses(counts, node_mass, string_mass)
    if not len(mass):
        return replace(structure, parent=structure, string_parent=np.arange(len(counts)))
    if structure.has_clusters:
        raise ValueError(
            "structure has clustered strings, which run over their inner nodes: they cannot be cut "
            "into segments with a mass"
        )
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
    string_parent = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(counts.sum()) - (np.cumsum(counts) - counts)[string_parent]
    inner = known + first[string_parent] + step
    ends = structure.strings[string_parent]
    pairs = np.column_stack(
        [
            np.where(step == 0, ends[:, 0], inner - 1),
            np.where(step == counts[string_parent] - 1, ends[:, 1], inner),
        ]
    )
    return Structure(
        nodes=nodes,
        bars=structure.bars,
        strings=pairs,
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
    counts = validation.per_member("segments", segments, count, "string")
    validation.refuse_fractions("segments", counts)
    validation.positive("segments", counts, "whole number; 1 leaves the string as it is")
    refuse_many_members(f"segments is {float(np.max(counts, initial=1)):g}", counts.sum())
    return counts.astype(np.int64)


def _point_masses(counts: IntArray, node_mass: object, string_mass: object) -> FloatArray:
    """Return the mass of each new node."""
    if node_mass is None and string_mass is None and not (counts > 1).any():
        return np.zeros(0)
    if (node_mass is None) == (string_mass is None):
        given = "no mass" if node_mass is None else "node_mass and string_mass"
        raise ValueError(
            f"found {given}, expected exactly one of node_mass (kg, of each new node) and "
            "string_mass (kg, of each whole string)"
        )
    new = counts - 1
    if node_mass is not None:
        return np.full(int(new.sum()), validation.positive_number("node_mass", node_mass, "kg"))
    mass = validation.per_member("string_mass", string_mass, len(counts), "string")
    for i, (m, points) in enumerate(zip(mass.tolist(), new.tolist(), strict=True)):
        if points == 0 and m != 0:
            raise ValueError(
                f"string_mass[{i}] is {m:g}, but string {i} is not cut (segments is 1) and has "
                "no node to carry it; cut it, or give an array with 0 there"
            )
        if points > 0 and m <= 0:
            raise ValueError(f"string_mass[{i}] is {m:g}, expected a positive mass in kg")
    return np.repeat(mass / np.maximum(new, 1), new)


def whole_strings(structure: Structure) -> Structure:
    """Return the structure with its strings whole: its parent if they were cut into segments."""
    if structure.string_parent is None or structure.parent is None:
        return structure
    return structure.parent


def to_segments(structure: Structure, what: str, values: FloatArray) -> FloatArray:
    """Return values of the segments, shape (…, α′), from those of whole strings, shape (…, α).

    ``what`` is ``"force_density"``, ``"stiffness"`` or ``"damping"``, of which a segment has s
    times that of its string; ``"rest_length"`` or ``"length"``, of which it has 1/s; ``"tension"``
    or ``"axial_rigidity"``, which are the same. ValueError if it is another word, or the last axis
    of the values does not fit. A string that is not cut is its own segment.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> massive = tc.subdivide(tc.prism(), segments=4, node_mass=0.01)
    >>> to_segments(massive, "force_density", np.full(9, 10.0))[:2]
    array([40., 40.])
    """
    power = _POWER[validation.choice("what", what, _POWER)]
    of, counts = _map(structure)
    _refuse_misfit(what, values, len(counts), "whole string")
    if structure.string_parent is None:
        return values
    if power:
        values = values * counts if power > 0 else values / counts
    return np.asarray(values[..., of])


def to_strings(structure: Structure, what: str, values: FloatArray) -> FloatArray:
    """Return values of whole strings, shape (…, α), from those of segments, shape (…, α′).

    The inverse of :func:`to_segments`. Where the segments of a string differ, lengths are added,
    stiffness, damping and axial rigidity are those of segments in series, force density and
    tension the mean.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> massive = tc.subdivide(tc.prism(), segments=4, node_mass=0.01)
    >>> to_strings(massive, "rest_length", np.full(36, 0.2))[:2]
    array([0.8, 0.8])
    """
    validation.choice("what", what, _POWER)
    of, counts = _map(structure)
    _refuse_misfit(what, values, len(of), "segment")
    if structure.string_parent is None:
        return values
    if what in ("stiffness", "damping", "axial_rigidity"):
        with np.errstate(divide="ignore"):
            total = 1 / _sums(of, 1 / values, len(counts))
        return np.asarray(counts * total if what == "axial_rigidity" else total)
    total = _sums(of, values, len(counts))
    if what == "force_density":
        return np.asarray(total / counts**2)
    return np.asarray(total / counts) if what == "tension" else total


def segment_counts(structure: Structure) -> IntArray:
    """Return, for each segment, how many segments its string was cut into, shape (α′,).

    Stiffness and damping of a string times this number are those that a segment needs
    for the chain to act as the whole string did: segments act in series.

    Parameters
    ----------
    structure : Structure
        Made by :func:`subdivide`; a string of another is its own segment.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> massive = tc.subdivide(tc.prism(), [2, 2, 2, 2, 2, 2, 3, 3, 3], string_mass=0.04)
    >>> tc.structure.segment_counts(massive)[[0, 1, -1]]
    array([2, 2, 3])
    >>> strings = tc.LinearStrings(stiffness=100.0 * tc.structure.segment_counts(massive))
    """
    whole = _checked_whole(structure)
    return frozen(to_segments(structure, "stiffness", np.ones(len(whole.strings), np.int64)))


def spread_force_density(structure: Structure, force_density: object) -> FloatArray:
    """Return the γ of segments, N/m, shape (α′,), with the tension of their whole strings.

    Parameters
    ----------
    structure : Structure
        Made by :func:`subdivide`; a string of another is its own segment.
    force_density : float or array_like, shape (α,)
        γ of each whole string, N/m, at least 0.

    Examples
    --------
    A prism at rest is at rest with its strings cut:

    >>> import tenscontrol as tc
    >>> rest = tc.prestress(tc.prism(), force_density=10.0)
    >>> massive = tc.subdivide(rest.structure, segments=4, node_mass=0.01)
    >>> cut = tc.prestress(massive, tc.structure.spread_force_density(massive, rest.force_density))
    >>> round(float(cut.force_density[0]), 4), cut.residual < 1e-12
    (40.0, True)
    """
    return _spread(structure, "force_density", force_density, "a string can only pull")


def spread_rest_length(structure: Structure, rest_length: object) -> FloatArray:
    """Return the rest lengths of segments, m, shape (α′,), that make up those of their strings.

    Parameters
    ----------
    structure : Structure
        Made by :func:`subdivide`; a string of another is its own segment.
    rest_length : float or array_like, shape (α,)
        l0 of each whole string, m, at least 0.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> massive = tc.subdivide(tc.prism(), segments=4, node_mass=0.01)
    >>> tc.structure.spread_rest_length(massive, 0.8)[:2]
    array([0.2, 0.2])
    """
    return _spread(structure, "rest_length", rest_length, "it is a length")


def _spread(structure: Structure, name: str, value: object, why: str) -> FloatArray:
    values = validation.per_member(
        name, value, len(_checked_whole(structure).strings), "whole string"
    )
    return to_segments(structure, name, validation.non_negative(name, values, why))


def _checked_whole(structure: Structure) -> Structure:
    validation.instance("structure", structure, Structure, "make one by subdivide(...)")
    return whole_strings(structure)


def _map(structure: Structure) -> tuple[IntArray, IntArray]:
    """Return the string that each segment belongs to, and how many segments each string has."""
    if structure.string_parent is None:
        own = np.arange(len(structure.strings))
        return own, np.ones_like(own)
    return structure.string_parent, np.bincount(structure.string_parent)


def _sums(of: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Return the sums over the segments of each string, segment after segment."""
    total = np.zeros((*values.shape[:-1], count))
    np.add.at(total.T, of, values.T)
    return total


def _refuse_misfit(name: str, values: FloatArray, count: int, member: str) -> None:
    if values.ndim == 0 or values.shape[-1] != count:
        raise ValueError(
            f"{name} has shape {values.shape}, expected (..., {count}): one per {member} along the "
            "last axis"
        )
