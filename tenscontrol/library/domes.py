"""Wide structures held by strings: cable domes, a cable net and a spoked wheel."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.library.sizes import of_sizes
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.structure import Structure


@of_sizes
def geiger_dome(
    sides: int = 6,
    hoops: int = 1,
    radius: float = 1.0,
    rise: float = 0.3,
    slope: float = 0.38,
    bar_mass: ArrayLike = 1.0,
) -> Structure:
    """Return Geiger's cable dome: radial frames of strings and posts, with a mast in the middle.

    Nodes are the fixed ones of the rim, q of them, then for each hoop from the outside the heads
    and the feet of its posts, q each, then head and foot of the mast. Bars come in this order too.
    Strings are in the groups ``"ridge"`` and ``"diagonal"``, which go inward from the rim and from
    heads to heads and to feet, and ``"hoop"``, which go around the feet.

    With one hoop q − 2 states of self-stress and q + 3 mechanisms; with more, one state and
    2 q (hoops − 1) + 6 mechanisms, which prestress stiffens.

    Parameters
    ----------
    sides : int
        Number q of radial frames, at least 3.
    hoops : int
        Number of hoops, at least 1.
    radius : float
        Radius of the rim, m.
    rise : float
        Height of the head of the mast above the rim, m, below the radius; heads are on a sphere.
    slope : float
        Angle of the diagonal strings from the level, rad, above 0 and below π/2.
    bar_mass : float or array_like, shape (q * hoops + 1,)
        Mass of each post, kg, that of the mast last.

    Returns
    -------
    Structure
        Of class 1.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, or out of range.

    Notes
    -----
    D. H. Geiger, US patent 4,736,553 (1988).

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.library.geiger_dome()
    Structure(20 nodes, 7 bars, 30 strings)
    """
    q, r, head, foot = _profile(sides, hoops, radius, rise, slope, mast=True)
    angle = np.zeros(len(r) - 1)[:, None] + 2 * np.pi * np.arange(q) / q
    rim, heads, feet, nodes = _rings(angle, r[:-1], head[:-1], foot[:-1])
    mast = nodes.shape[1] + np.arange(2)
    outer = np.vstack([rim, heads])
    inner_head, inner_foot = (np.vstack([ring, np.full((1, q), end)])
                              for ring, end in zip((heads, feet), mast, strict=True))  # fmt: skip
    strings, groups = _named(
        ridge=[(outer, inner_head)],
        diagonal=[(outer, inner_foot)],
        hoop=[(feet, np.roll(feet, -1, axis=1))],
    )
    return Structure(
        nodes=np.hstack([nodes, [[0, 0], [0, 0], [head[-1], foot[-1]]]]),
        bars=np.vstack([np.column_stack([heads.ravel(), feet.ravel()]), mast]),
        strings=strings,
        bar_mass=bar_mass,
        string_groups=groups,
        fixed=rim,
    )


@of_sizes
def levy_dome(
    sides: int = 6,
    hoops: int = 2,
    radius: float = 50.0,
    rise: float = 15.0,
    slope: float = np.pi / 6,
    bar_mass: ArrayLike = 1.0,
) -> Structure:
    """Return Levy's cable dome: posts in triangles of strings, each hoop turned by half a side.

    Nodes are the fixed ones of the rim, q of them, then for each hoop from the outside the heads
    and the feet of its posts, q each. Bars come in this order too. Strings are in the groups
    ``"ridge"`` and ``"diagonal"``, two inward from each node of the rim and from each head, to
    heads and to feet, ``"hoop"``, around the feet, and ``"ring"``, around the innermost heads.

    With an even q, q + 1 states of self-stress and one mechanism, which prestress stiffens; with an
    odd one, q states and no mechanism.

    Parameters
    ----------
    sides : int
        Number q of posts of a hoop, at least 4.
    hoops : int
        Number of hoops, at least 1.
    radius : float
        Radius of the rim, m.
    rise : float
        Height of the sphere with all heads above the rim, m, below the radius.
    slope : float
        Angle of the diagonals from the level, rad, in the radial plane; above 0 and below π/2.
    bar_mass : float or array_like, shape (q * hoops,)
        Mass of each post, kg.

    Returns
    -------
    Structure
        Of class 1.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, or out of range.

    Notes
    -----
    M. P. Levy, *The Georgia Dome and beyond* (1994). The default sizes are those of an example of
    statics of TsgFEM: S. Ma, M. Chen and R. E. Skelton, JOSS 7 (2022) 3390, with twelve sides.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.library.levy_dome()
    Structure(30 nodes, 12 bars, 66 strings)
    """
    q, r, head, foot = _profile(sides, hoops, radius, rise, slope, mast=False)
    ring = np.arange(len(r))[:, None]
    angle = 2 * np.pi / q * (np.arange(q) + ring / 2)
    rim, heads, feet, nodes = _rings(angle, r, head, foot)
    outer = np.vstack([rim, heads[:-1]])
    ahead = np.roll(outer, -1, axis=1)
    strings, groups = _named(
        ridge=[(outer, heads), (ahead, heads)],
        diagonal=[(outer, feet), (ahead, feet)],
        hoop=[(feet, np.roll(feet, -1, axis=1))],
        ring=[(heads[-1:], np.roll(heads[-1:], -1, axis=1))],
    )
    return Structure(
        nodes=nodes,
        bars=np.column_stack([heads.ravel(), feet.ravel()]),
        strings=strings,
        bar_mass=bar_mass,
        string_groups=groups,
        fixed=rim,
    )


@of_sizes
def cable_net(
    rows: int = 5,
    columns: int = 5,
    spacing: float = 0.5,
    sag: float = 0.3,
    node_mass: float = 0.1,
) -> Structure:
    """Return a saddle-shaped net of strings, held at its edges.

    Node ``columns · i + j`` is knot j of row i. Rows sag and columns arch: the net is part of the
    surface ``z = c (x² − y²)``, on which strings of one force density balance. Strings are in the
    groups ``"row"`` and ``"column"``; there are none between fixed knots.

    One state of self-stress, (rows − 3) (columns − 3) mechanisms, which prestress stiffens.

    Parameters
    ----------
    rows : int
        Number of rows of knots, at least 3, those held among them.
    columns : int
        Number of knots in a row, at least 3, those held among them.
    spacing : float
        Distance of neighbouring knots in plan, m.
    sag : float
        Height of the ends of a row above its middle, m; below 0 rows arch and columns sag. With 0
        the net is flat, and has more states and mechanisms.
    node_mass : float
        Mass of each free knot, kg.

    Returns
    -------
    Structure
        Without bars.

    Raises
    ------
    TypeError, ValueError
        If a number is not finite or out of range.

    Notes
    -----
    F. Otto, *Tensile Structures* (1969). :func:`tenscontrol.net` is the flat net, held as one
    chooses.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> saddle = tc.library.cable_net()
    >>> saddle, len(saddle.free)
    (Structure(21 nodes, 0 bars, 24 strings), 9)
    """
    m = validation.whole_number("rows", rows, least=3)
    n = validation.whole_number("columns", columns, least=3)
    refuse_many_members(f"rows is {m} and columns is {n}", 2 * m * n)
    step = validation.positive_number("spacing", spacing, "m")
    depth = validation.number("sag", sag, "m")
    mass = validation.positive_number("node_mass", node_mass, "kg")
    i, j = np.divmod(np.arange(m * n), n)
    x, y = step * (j - (n - 1) / 2), step * (i - (m - 1) / 2)
    z = depth / x.max() ** 2 * (x**2 - y**2)
    knots = np.arange(m * n).reshape(m, n)
    is_corner = np.isin(knots, knots[[0, 0, -1, -1], [0, -1, 0, -1]])
    number_of = (np.cumsum(~is_corner) - 1).reshape(m, n)  # corners would hold no string
    strings, groups = _named(
        row=[(number_of[1:-1, :-1], number_of[1:-1, 1:])],
        column=[(number_of[:-1, 1:-1], number_of[1:, 1:-1])],
    )
    inner = number_of[1:-1, 1:-1]
    return Structure(
        nodes=np.array([x, y, z])[:, ~is_corner.ravel()],
        bars=[],
        strings=strings,
        bar_mass=[],
        string_node_mass=mass,
        string_groups=groups,
        fixed=np.setdiff1d(number_of[~is_corner], inner),
    )


@of_sizes
def wheel(
    spokes: int = 12, radius: float = 0.3, width: float = 0.1, bar_mass: ArrayLike = 0.1
) -> Structure:
    """Return a spoked wheel: a rim of bars joined at their ends, and an axle held by strings.

    Nodes 0 … q−1 are those of the rim, then come the ends of the axle. The last bar is the axle.
    Strings are in the groups ``"left"`` and ``"right"``, from the rim to each end of the axle.

    One state of self-stress, no mechanism.

    Parameters
    ----------
    spokes : int
        Number q of spokes on each side and of bars of the rim, at least 3.
    radius : float
        Radius of the circle through the nodes of the rim, m.
    width : float
        Length of the axle, m.
    bar_mass : float or array_like, shape (q + 1,)
        Mass of each bar, kg.

    Returns
    -------
    Structure
        Of class 2.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, or ``spokes`` is below 3.

    Notes
    -----
    The D-bar in space with bars for strings, and strings for bars. With the force density γ of the
    spokes the rim has λ = γ/(1 − cos(2π/q)), and the axle q γ/2.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.library.wheel()
    Structure(14 nodes, 13 bars, 24 strings)
    """
    q = validation.whole_number("spokes", spokes, least=3)
    refuse_many_members(f"spokes is {q}", 3 * q)
    radius = validation.positive_number("radius", radius, "m")
    half = validation.positive_number("width", width, "m") / 2
    k = np.arange(q)
    angle = 2 * np.pi * k / q
    rim = [radius * np.cos(angle), radius * np.sin(angle), np.zeros(q)]
    strings, groups = _named(left=[(k, np.full(q, q))], right=[(k, np.full(q, q + 1))])
    return Structure(
        nodes=np.hstack([rim, [[0, 0], [0, 0], [half, -half]]]),
        bars=np.vstack([np.column_stack([k, np.roll(k, -1)]), [q, q + 1]]),
        strings=strings,
        bar_mass=bar_mass,
        string_groups=groups,
    )


def _profile(
    sides: int, hoops: int, radius: float, rise: float, slope: float, mast: bool
) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """Return q, and radii, heights of heads and heights of feet, m, from the rim inward."""
    q = validation.whole_number("sides", sides, least=3 if mast else 4)  # three have no prestress
    count = validation.whole_number("hoops", hoops, least=1)
    refuse_many_members(f"sides is {q} and hoops is {count}", 6 * q * (count + 1))
    outside = validation.positive_number("radius", radius, "m")
    up = validation.positive_number("rise", rise, "m")
    if up >= outside:
        raise ValueError(f"rise is {up:g} m, expected less than the radius, {outside:g} m")
    angle = validation.positive_number("slope", slope, "rad")
    if angle >= np.pi / 2:
        raise ValueError(f"slope is {angle:g} rad, expected below π/2: diagonals go inward")
    r = outside * np.arange(count + 1, -1 if mast else 0, -1) / (count + 1)
    sphere = (outside**2 + up**2) / (2 * up)
    head = np.sqrt(sphere**2 - r**2) - (sphere - up)
    head[0] = 0.0
    foot = np.concatenate([[0.0], head[:-1] + np.diff(r) * np.tan(angle)])
    return q, r, head, foot


def _rings(
    angle: FloatArray, r: FloatArray, head: FloatArray, foot: FloatArray
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Return the node numbers of rim, heads and feet, ring by ring, and their positions, m."""
    hoops, q = len(r) - 1, angle.shape[1]
    ring = np.concatenate([[0], np.repeat(np.arange(1, hoops + 1), 2)])
    z = np.column_stack([head, foot]).ravel()[1:]  # one of the rim
    node = np.arange(q * len(ring)).reshape(-1, q)
    x, y = r[ring, None] * np.cos(angle[ring]), r[ring, None] * np.sin(angle[ring])
    nodes = np.reshape([x, y, np.repeat(z[:, None], q, axis=1)], (3, -1))
    return node[0], node[1::2], node[2::2], nodes


def _named(**groups: list[tuple[IntArray, IntArray]]) -> tuple[IntArray, list[str]]:
    """Return strings by group, shape (α, 2), and the group of each."""
    pairs = {name: np.concatenate([np.stack(pair, -1).reshape(-1, 2) for pair in ends])
             for name, ends in groups.items()}  # fmt: skip
    return np.vstack(list(pairs.values())), [name for name in pairs for _ in pairs[name]]
