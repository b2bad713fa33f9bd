"""Whole strings and their segments: the only map between values of the one and of the other."""

from __future__ import annotations

import numpy as np

from tenscontrol.structure.structure import Structure
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    choice,
    frozen,
    instance,
    non_negative,
    per_member,
)

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
    >>> tc.structure.to_segments(massive, "force_density", np.full(9, 10.0))[:2]
    array([40., 40.])
    """
    power = _POWER[choice("what", what, _POWER)]
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
    >>> tc.structure.to_strings(massive, "rest_length", np.full(36, 0.2))[:2]
    array([0.8, 0.8])
    """
    choice("what", what, _POWER)
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
        Made by :func:`subdivide`, or ValueError.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> massive = tc.subdivide(tc.prism(), [2, 2, 2, 2, 2, 2, 3, 3, 3], string_mass=0.04)
    >>> tc.structure.segment_counts(massive)[[0, 1, -1]]
    array([2, 2, 3])
    >>> strings = tc.LinearStrings(stiffness=100.0 * tc.structure.segment_counts(massive))
    """
    parent = _whole(structure)
    return frozen(to_segments(structure, "stiffness", np.ones(len(parent.strings), np.int64)))


def spread_force_density(structure: Structure, force_density: object) -> FloatArray:
    """Return the γ of segments, N/m, shape (α′,), under the tension that their strings had whole.

    Parameters
    ----------
    structure : Structure
        Made by :func:`subdivide`, or ValueError.
    force_density : float or array_like, shape (α,)
        γ of each string of ``structure.parent``, N/m, at least 0.

    Examples
    --------
    A prism at rest is at rest with its strings cut:

    >>> import tenscontrol as tc
    >>> rest = tc.prestress(tc.prism(), force_density=17.3205)
    >>> massive = tc.subdivide(rest.structure, segments=4, node_mass=0.01)
    >>> cut = tc.prestress(massive, tc.structure.spread_force_density(massive, rest.force_density))
    >>> round(float(cut.force_density[0]), 4), cut.residual < 1e-12
    (69.282, True)
    """
    return _spread(structure, "force_density", force_density, "a string can only pull")


def spread_rest_length(structure: Structure, rest_length: object) -> FloatArray:
    """Return the rest lengths of segments, m, shape (α′,), that make up those of their strings.

    Parameters
    ----------
    structure : Structure
        Made by :func:`subdivide`, or ValueError.
    rest_length : float or array_like, shape (α,)
        l0 of each string of ``structure.parent``, m, at least 0.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> massive = tc.subdivide(tc.prism(), segments=4, node_mass=0.01)
    >>> tc.structure.spread_rest_length(massive, 0.8)[:2]
    array([0.2, 0.2])
    """
    return _spread(structure, "rest_length", rest_length, "it is a length")


def _spread(structure: Structure, what: str, value: object, why: str) -> FloatArray:
    values = per_member(what, value, len(_whole(structure).strings), "string of the parent")
    return to_segments(structure, what, non_negative(what, values, why))


def _whole(structure: Structure) -> Structure:
    """Return the parent of a subdivision, or refuse another structure."""
    instance("structure", structure, Structure, "make one by subdivide(...)")
    if structure.parent is None or structure.string_parent is None:
        raise ValueError(
            "structure has no string_parent, expected a structure made by subdivide(...); "
            "segments=1 leaves the strings as they are"
        )
    return structure.parent


def _map(structure: Structure) -> tuple[IntArray, IntArray]:
    """Return the string that each segment belongs to, and how many segments each string has."""
    if structure.string_parent is None:
        each = np.arange(len(structure.strings))
        return each, np.ones_like(each)
    return structure.string_parent, np.bincount(structure.string_parent)


def _sums(of: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Return the sums over the segments of each string, segment after segment."""
    total = np.zeros((*values.shape[:-1], count))
    np.add.at(total.T, of, values.T)
    return total


def _refuse_misfit(what: str, values: FloatArray, count: int, member: str) -> None:
    if values.ndim == 0 or values.shape[-1] != count:
        raise ValueError(
            f"{what} has shape {values.shape}, expected (..., {count}): one per {member} along the "
            "last axis"
        )
