"""The tensegrity prism: q bars between two polygons, one turned against the other."""

from __future__ import annotations

import numpy as np

from tenscontrol.structure.structure import Structure, refuse_many_members
from tenscontrol.validation import choice, positive_number, truth, whole_number


def prism(
    sides: int = 3,
    radius: float = 0.5,
    height: float = 1.0,
    top_radius: float | None = None,
    bar_mass: object = 1.0,
    handedness: str = "left",
    diagonals: bool = False,
) -> Structure:
    """Return the tensegrity prism in its equilibrium shape.

    The top polygon is turned against the bottom one by ``π/2 − π/sides``, the only turn at which
    strings and bars balance. Nodes 0 … q−1 are the top, the next q the bottom. The strings come in
    groups ``"top"``, ``"bottom"`` and ``"vertical"``, q each in this order.

    Parameters
    ----------
    sides : int
        Number q of bars and of polygon sides, at least 3.
    radius : float
        Radius of the circle through the bottom nodes, m.
    height : float
        Distance between the polygons, m.
    top_radius : float, optional
        Radius of the circle through the top nodes, m. As ``radius`` if not given.
    bar_mass : float or array_like, shape (q,)
        Mass of each bar, kg.
    handedness : {"left", "right"}
        The screw that the bars follow on their way up.
    diagonals : bool
        Whether there is a second set of strings from top to bottom, group
        ``"diagonal"``. They are slack in the shape returned; pulling, they hold
        the prism at any turn from there to a quarter of a circle.

    Returns
    -------
    Structure

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, ``sides`` is below 3,
        ``handedness`` is another word, or ``diagonals`` is no truth value.

    Notes
    -----
    Geometry after Skelton & de Oliveira, *Tensegrity Systems* (2009), chapter 3.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism(sides=3, radius=0.5, height=1.0)
    >>> prism
    Structure(6 nodes, 3 bars, 9 strings)
    >>> prism.nodes[:, 0].round(4), prism.bar_length.round(4)
    (array([ 0.483 , -0.1294,  1.    ]), array([1.3903, 1.3903, 1.3903]))
    """
    q = whole_number("sides", sides, least=3)
    refuse_many_members(f"sides is {q}", 5 * q)
    bottom_radius = positive_number("radius", radius, "m")
    height = positive_number("height", height, "m")
    upper = bottom_radius if top_radius is None else positive_number("top_radius", top_radius, "m")
    mirror = 1.0 if choice("handedness", handedness, ("left", "right")) == "left" else -1.0

    k = np.arange(q)
    turn = _turn(q)
    top = mirror * (2 * np.pi * k / q - turn / 2)
    bottom = mirror * (2 * np.pi * k / q + turn / 2)
    nodes = np.hstack(
        [
            [upper * np.cos(top), upper * np.sin(top), np.full(q, height)],
            [bottom_radius * np.cos(bottom), bottom_radius * np.sin(bottom), np.zeros(q)],
        ]
    )
    following = (k + 1) % q
    groups = {
        "top": np.column_stack([k, following]),
        "bottom": np.column_stack([q + k, q + following]),
        "vertical": np.column_stack([k, q + k]),
    }
    if truth("diagonals", diagonals, "whether there is a second set of strings from top to bottom"):
        groups["diagonal"] = np.column_stack([k, q + (k - 1) % q])
    return Structure(
        nodes=nodes,
        bars=np.column_stack([k, q + following]),
        strings=np.vstack(list(groups.values())),
        bar_mass=bar_mass,  # type: ignore[arg-type]  # checked by Structure
        string_groups=[name for name in groups for _ in range(q)],
    )


def prism_radius(bar_length: float, height: float, sides: int = 3) -> float:
    """Return the radius of the prism with equal radii that has bars of this length.

    Prisms of one bar length and any height are the family that a prism moves
    through when its strings are wound.

    Parameters
    ----------
    bar_length : float
        Length of the bars, m.
    height : float
        Distance between the polygons, m; less than ``bar_length``.
    sides : int
        Number of bars, at least 3.

    Returns
    -------
    float
        Radius, m.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, ``sides`` is below 3, or the
        height is not below the bar length.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> length = tc.prism(height=1.0, radius=0.5).bar_length[0]
    >>> lower = tc.prism(height=0.85, radius=tc.structure.prism_radius(length, height=0.85))
    >>> bool(abs(lower.bar_length - length).max() < 1e-15)
    True
    """
    length = positive_number("bar_length", bar_length, "m")
    rise = positive_number("height", height, "m")
    q = whole_number("sides", sides, least=3)
    if rise >= length:
        raise ValueError(
            f"height is {rise:g} m, expected less than the bar length {length:g} m: the bars lean"
        )
    span = 2 * np.sin((_turn(q) + 2 * np.pi / q) / 2)
    return float(np.sqrt(length**2 - rise**2) / span)


def _turn(q: int) -> float:
    """Return the turn of one polygon against the other, rad: a vertical string spans it."""
    return float(np.pi / 2 - np.pi / q)
