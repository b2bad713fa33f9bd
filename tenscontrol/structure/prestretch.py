"""Rest lengths of skins that are stretched from the start."""

from __future__ import annotations

import numpy as np

from tenscontrol.structure.structure import Structure
from tenscontrol.validation import FloatArray, float_array, instance, per_member, positive


def skin_rest_length(
    structure: Structure, rest_length: object, prestretch: float = 0.0
) -> FloatArray:
    """Return the rest lengths of a skinned structure: as given, and those of the skin.

    Parameters
    ----------
    structure : Structure
        Made by :func:`skin`.
    rest_length : float or array_like, shape (α,)
        Rest lengths of the strings of ``structure.parent``, m.
    prestretch : float
        ε: the skin strings are this part longer in the reference shape than at
        rest, ``l0 = l/(1 + ε)``. 0 is just taut; below 0 is slack, above −1.

    Returns
    -------
    ndarray, shape (α′,)
        m, in the order of the strings of ``structure``.

    Raises
    ------
    TypeError, ValueError
        If the structure was not made by :func:`skin`, or an argument is not
        finite or out of range.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> skinned = tc.skin(tc.prism(), panels=["top"], iterations=1, node_mass=0.01)
    >>> tc.structure.skin_rest_length(skinned, 0.8, prestretch=0.25).round(4)
    array([0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.4, 0.4, 0.4])
    """
    instance("structure", structure, Structure, "make one by skin(...)")
    parent = structure.parent
    if parent is None or structure.string_parent is not None:
        raise ValueError(
            "structure has no skin, or was subdivided after: skin(structure, panels, ...) makes "
            "one, and spread_rest_length(...) spreads the answer over segments"
        )
    count = len(parent.strings)
    given = per_member("rest_length", rest_length, count, "string of the parent")
    positive("rest_length", given, "length in m")
    stretch = float_array("prestretch", prestretch)
    if stretch.ndim or stretch <= -1:
        raise ValueError(f"prestretch is {prestretch!r}, expected a number above -1")
    return np.concatenate([given, structure.string_length()[count:] / (1 + float(stretch))])
