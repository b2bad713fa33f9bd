"""The tensegrity prism, q bars between two polygons, and towers of prisms on strings."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.structure import Structure

# Above this share of the stage height some towers would need strings that push.
_LARGEST_OVERLAP = 0.4


def prism(
    sides: int = 3,
    radius: float = 0.5,
    height: float = 1.0,
    top_radius: float | None = None,
    bar_mass: ArrayLike = 1.0,
    handedness: str = "left",
    diagonals: bool = False,
) -> Structure:
    """Return the tensegrity prism in its equilibrium shape.

    The top polygon is rotated against the bottom one by ``π/2 − π/sides``, the only angle at which
    strings and bars are in equilibrium. Nodes 0 … q−1 are the top, the next q the bottom. The
    strings are in the groups ``"top"``, ``"bottom"`` and ``"vertical"``, q each in this order.

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
    q = validation.whole_number("sides", sides, least=3)
    refuse_many_members(f"sides is {q}", 5 * q)
    bottom_radius = validation.positive_number("radius", radius, "m")
    height = validation.positive_number("height", height, "m")
    upper = (
        bottom_radius
        if top_radius is None
        else validation.positive_number("top_radius", top_radius, "m")
    )
    mirror = (
        1.0 if validation.choice("handedness", handedness, ("left", "right")) == "left" else -1.0
    )

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
    if validation.truth(
        "diagonals", diagonals, "whether there is a second set of strings from top to bottom"
    ):
        groups["diagonal"] = np.column_stack([k, q + (k - 1) % q])
    return Structure(
        nodes=nodes,
        bars=np.column_stack([k, q + following]),
        strings=np.vstack(list(groups.values())),
        bar_mass=bar_mass,
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
    length = validation.positive_number("bar_length", bar_length, "m")
    rise = validation.positive_number("height", height, "m")
    q = validation.whole_number("sides", sides, least=3)
    if rise >= length:
        raise ValueError(
            f"height is {rise:g} m, expected less than the bar length {length:g} m: the bars lean"
        )
    span = 2 * np.sin((_turn(q) + 2 * np.pi / q) / 2)
    return float(np.sqrt(length**2 - rise**2) / span)


def _turn(q: int) -> float:
    """Return the turn of one polygon against the other, rad: a vertical string spans it."""
    return float(np.pi / 2 - np.pi / q)


def prism_tower(
    stages: int,
    sides: int = 3,
    radius: float = 0.5,
    height: float = 1.0,
    bar_mass: ArrayLike = 1.0,
    overlap: float = 0.25,
    handedness: str = "left",
) -> Structure:
    """Return a class-1 tower of tensegrity prisms, one above the other, in equilibrium.

    Stages are alternately right- and left-handed, and no bar touches another. The bottom of each
    stage is below the top of the previous one, and *saddle* strings zigzag between these two
    polygons. *Diagonal* strings join the tops, and the bottoms, of neighbouring stages. One stage
    is the :func:`prism`. With more stages the tower has no mechanism, and a self-stress with all
    strings in tension, so that it is stiff without a load.

    Nodes, bars and strings come stage by stage. The nodes of a stage are its top polygon, then its
    bottom polygon, q each; its strings are the groups ``"top"``, ``"bottom"`` and ``"vertical"``, q
    each, then those to the next stage, ``"saddle"`` and ``"diagonal"``, 2q each.

    Parameters
    ----------
    stages : int
        Number of prisms, at least 1.
    sides : int
        Number q of bars and of polygon sides of a stage, at least 3.
    radius : float
        Radius of the circles through the nodes, m.
    height : float
        Distance between the polygons of a stage, m.
    bar_mass : float or array_like, shape (stages * q,)
        Mass of each bar, kg.
    overlap : float
        Part of a stage that reaches into the one below, above 0 and at most 0.4. One stage has
        nothing to overlap.
    handedness : {"left", "right"}
        Screw of the bars of the first stage, on their way up.

    Returns
    -------
    Structure

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, ``stages`` is below 1, ``sides`` is below 3,
        ``overlap`` is above 0.4, or ``handedness`` is another word.

    Notes
    -----
    K. Snelson's towers, as in Skelton & de Oliveira, *Tensegrity Systems* (2009), with the polygons
    of every stage kept. Each joint has one state of self-stress with the symmetry of the tower. The
    saddle strings of a joint with overlap ``o h`` carry ``(1 - o)/o`` times the force density of
    the diagonal strings. A stage turned beyond the twist of the prism answers their pull by tension
    in all its strings, and the less, the more it is turned; it is turned by ``2/3 o π/q``, so that
    its strings pull about as hard as those of the joint.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tower = tc.prism_tower(stages=4)
    >>> tower
    Structure(24 nodes, 12 bars, 72 strings)
    >>> rest = tc.prestress(tower, force_density=10.0, reference="vertical")
    >>> rest.mechanisms, rest.is_super_stable, bool(rest.force_density.min() > 2.0)
    (0, True, True)
    """
    count = validation.whole_number("stages", stages, least=1)
    q = validation.whole_number("sides", sides, least=3)
    refuse_many_members(f"stages is {count} and sides is {q}", 8 * count * q)
    radius = validation.positive_number("radius", radius, "m")
    height = validation.positive_number("height", height, "m")
    overlap = validation.positive_number("overlap", overlap, "stage heights")
    if overlap > _LARGEST_OVERLAP:
        raise ValueError(
            f"overlap is {overlap:g}, expected at most {_LARGEST_OVERLAP:g}: with more, no "
            "self-stress of the tower has all strings in tension"
        )
    mirror = (
        1.0 if validation.choice("handedness", handedness, ("left", "right")) == "left" else -1.0
    )

    node = np.arange(count * 2 * q).reshape(count, 2, q)
    top, bottom = node[:, 0], node[:, 1]
    # 1 where the bottom is ahead of the top, in the sense of the node numbers.
    screw = 1 - 2 * (np.arange(count) % 2)
    ends, groups = _tower_strings(top, bottom, screw)
    count_of_strings = (len(groups) * count - 4) * q  # the last stage has no joint above
    return Structure(
        nodes=_tower_nodes(q, screw, radius, height, overlap, mirror),
        bars=np.column_stack([top.ravel(), _shifted(bottom, screw).ravel()]),
        strings=ends.reshape(-1, 2)[:count_of_strings],
        bar_mass=bar_mass,
        string_groups=(tuple(np.repeat(groups, q).tolist()) * count)[:count_of_strings],
    )


def _tower_strings(
    top: IntArray, bottom: IntArray, screw: IntArray
) -> tuple[IntArray, tuple[str, ...]]:
    """Return the end nodes of all strings, shape (stages, 7, q, 2), and the seven groups."""
    q = top.shape[1]
    # The stage above; what the last stage gets is left out by the caller.
    next_top, next_bottom = np.roll(top, -1, axis=0), np.roll(bottom, -1, axis=0)
    # A diagonal goes up as steeply as it can without turning with the screw.
    back = ceil(q / 4) * screw
    behind = (screw - 1) // 2
    pairs = {
        "top": [(top, _shifted(top, 1))],
        "bottom": [(bottom, _shifted(bottom, 1))],
        "vertical": [(top, bottom)],
        "saddle": [(top, next_bottom), (top, _shifted(next_bottom, -1))],
        "diagonal": [
            (top, _shifted(next_top, behind - back)),
            (bottom, _shifted(next_bottom, back - 1 - behind)),
        ],
    }
    ends = [np.stack(pair, axis=-1) for ends_of_group in pairs.values() for pair in ends_of_group]
    groups = tuple(group for group, ends_of_group in pairs.items() for _ in ends_of_group)
    return np.stack(ends, axis=1), groups


def _shifted(polygons: IntArray, by: IntArray | int) -> IntArray:
    """Return for each node the one so many places on in its polygon, shape (stages, q)."""
    stages, q = polygons.shape
    places = (np.arange(q) + np.reshape(by, (-1, 1))) % q
    return np.asarray(np.take_along_axis(polygons, np.broadcast_to(places, (stages, q)), axis=1))


def _tower_nodes(
    q: int, screw: IntArray, radius: float, height: float, overlap: float, mirror: float
) -> FloatArray:
    """Return the node positions, m, shape (3, n)."""
    count = len(screw)
    twist = _turn(q)
    if count > 1:
        twist += 2 / 3 * overlap * np.pi / q
    stage = np.arange(count)
    # Each bottom polygon is half a side from the top polygon below; the twists cancel in pairs.
    turn = stage * (np.pi / q) + (stage % 2) * twist - twist / 2
    angles = np.stack([turn, turn + screw * twist], axis=1)[..., None]
    angles = mirror * (angles + 2 * np.pi / q * np.arange(q))
    z = height * ((1 - overlap) * stage[:, None] + [1.0, 0.0])
    z = np.broadcast_to(z[..., None], angles.shape)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), z]).reshape(3, -1)
