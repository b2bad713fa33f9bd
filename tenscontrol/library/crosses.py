"""Crosses of a few bars: the parts that larger tensegrities are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tenscontrol import validation
from tenscontrol.library.sizes import of_sizes
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.structure import Structure


@of_sizes
def snelson_x(
    width: float = 1.0, height: float = 1.0, dimension: int = 2, bar_mass: ArrayLike = 1.0
) -> Structure:
    """Return Snelson's X: a rectangle of strings with bars as its diagonals, which do not touch.

    Nodes 0 to 3 go around, from the lower left corner. Strings are in the groups ``"horizontal"``
    (lower, upper) and ``"vertical"`` (left, right).

    One state of self-stress; no mechanism in the plane, one in space: it folds along a diagonal,
    which prestress stiffens.

    Parameters
    ----------
    width : float
        Length of the strings along x, m.
    height : float
        Length of the strings along y, m.
    dimension : {2, 3}
        2 for a structure in the plane, 3 for one in space, at z = 0.
    bar_mass : float or array_like, shape (2,)
        Mass of each bar, kg.

    Returns
    -------
    Structure
        Of class 1.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, or the dimension is neither 2 nor 3.

    Notes
    -----
    K. Snelson, US patent 3,169,611 (1965). Bars and strings have one force density.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.library.snelson_x().nodes
    array([[0., 1., 1., 0.],
           [0., 0., 1., 1.]])
    """
    width = validation.positive_number("width", width, "m")
    height = validation.positive_number("height", height, "m")
    return Structure(
        nodes=_flat([[0, width, width, 0], [0, 0, height, height]], dimension),
        bars=[[0, 2], [1, 3]],
        strings=[[0, 1], [3, 2], [0, 3], [1, 2]],
        bar_mass=bar_mass,
        string_groups=["horizontal"] * 2 + ["vertical"] * 2,
    )


@of_sizes
def kite(
    width: float = 2.0,
    height: float = 2.0,
    across: float = 0.25,
    up: float = 0.75,
    dimension: int = 2,
    bar_mass: ArrayLike = 1.0,
) -> Structure:
    """Return a kite: a level and an upright bar that cross, in a loop of four strings.

    Nodes go around: left, lower, right, upper. So do the strings, from left to lower. With the
    crossing in the middle it is the class-1 T-bar.

    One state of self-stress; no mechanism in the plane, one in space, which prestress stiffens.

    Parameters
    ----------
    width : float
        Length of the level bar, m.
    height : float
        Length of the upright bar, m.
    across : float
        Where the bars cross, as a part of the width, above 0 and below 1.
    up : float
        Where the bars cross, as a part of the height, above 0 and below 1.
    dimension : {2, 3}
        2 for a structure in the plane, 3 for one in space, at z = 0.
    bar_mass : float or array_like, shape (2,)
        Mass of the level and of the upright bar, kg.

    Returns
    -------
    Structure
        Of class 1, with the crossing at the origin.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, a share is not below 1, or the dimension is neither
        2 nor 3.

    Notes
    -----
    The default is the first example of statics of MOTES: R. Goyal, M. Chen, M. Majji and R. E.
    Skelton, *MOTES: Modeling of Tensegrity Structures*, JOSS 4 (2019) 1613.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.library.kite().nodes
    array([[-0.5,  0. ,  1.5,  0. ],
           [ 0. , -1.5,  0. ,  0.5]])
    """
    width = validation.positive_number("width", width, "m")
    height = validation.positive_number("height", height, "m")
    across, up = _share("across", across, "width"), _share("up", up, "height")
    left, low = -across * width, -up * height
    return Structure(
        nodes=_flat([[left, 0, left + width, 0], [0, low, 0, low + height]], dimension),
        bars=[[0, 2], [1, 3]],
        strings=[[0, 1], [1, 2], [2, 3], [3, 0]],
        bar_mass=bar_mass,
    )


@of_sizes
def d_bar(
    width: float = 2.0, height: float = 2.0, dimension: int = 2, bar_mass: ArrayLike = 1.0
) -> Structure:
    """Return the D-bar: a diamond of four bars joined at their ends, with strings as diagonals.

    Nodes go around: left, lower, right, upper. The strings are ``"horizontal"`` and ``"vertical"``.

    One state of self-stress; no mechanism in the plane. In space it folds: one mechanism, which
    prestress makes unstable.

    Parameters
    ----------
    width : float
        Length of the strings along x, m.
    height : float
        Length of the strings along y, m.
    dimension : {2, 3}
        2 for a structure in the plane, 3 for one in space, at z = 0.
    bar_mass : float or array_like, shape (4,)
        Mass of each bar, kg.

    Returns
    -------
    Structure
        Of class 2.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, or the dimension is neither 2 nor 3.

    Notes
    -----
    R. E. Skelton and M. C. de Oliveira, *Tensegrity Systems* (2009), chapter 3. The default is an
    example of MOTES (Goyal et al., JOSS 4 (2019) 1613), where node 0 is fixed.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import tenscontrol as tc
    >>> diamond = tc.library.d_bar()
    >>> diamond.structure_class
    2
    >>> on_rails = replace(diamond, fixed=[0, (2, "y")])
    >>> len(on_rails.free_rows)
    5
    """
    half = validation.positive_number("width", width, "m") / 2
    rise = validation.positive_number("height", height, "m") / 2
    return Structure(
        nodes=_flat([[-half, 0, half, 0], [0, -rise, 0, rise]], dimension),
        bars=[[3, 0], [0, 1], [1, 2], [2, 3]],
        strings=[[0, 2], [1, 3]],
        bar_mass=bar_mass,
        string_groups=["horizontal", "vertical"],
    )


@of_sizes
def d_bar_3d(
    sides: int = 3, radius: float = 0.6, height: float = 1.6, bar_mass: ArrayLike = 1.0
) -> Structure:
    """Return the D-bar in three dimensions: bars from two tips to a polygon of strings.

    Nodes 0 … q−1 are the corners, then come the upper and the lower tip. Strings are in the groups
    ``"ring"``, q, and ``"axis"``, one.

    One state of self-stress, no mechanism.

    Parameters
    ----------
    sides : int
        Number q of corners, at least 3.
    radius : float
        Radius of the circle through the corners, m.
    height : float
        Distance between the tips, m.
    bar_mass : float or array_like, shape (2q,)
        Mass of each bar, kg; the upper ones come first.

    Returns
    -------
    Structure
        Of class q.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, or ``sides`` is below 3.

    Notes
    -----
    R. E. Skelton and M. C. de Oliveira, *Tensegrity Systems* (2009), chapter 3. With the force
    density γ in the ring, bars have λ = (1 − cos(2π/q)) γ, and the axis q λ/2.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tip = tc.library.d_bar_3d()
    >>> tip, tip.bar_length[:2]
    (Structure(5 nodes, 6 bars, 4 strings), array([1., 1.]))
    """
    q = validation.whole_number("sides", sides, least=3)
    refuse_many_members(f"sides is {q}", 3 * q)
    radius = validation.positive_number("radius", radius, "m")
    rise = validation.positive_number("height", height, "m") / 2
    k = np.arange(q)
    angle = 2 * np.pi * k / q
    ring = [radius * np.cos(angle), radius * np.sin(angle), np.zeros(q)]
    tips = [[0.0, 0.0], [0.0, 0.0], [rise, -rise]]
    return Structure(
        nodes=np.hstack([ring, tips]),
        bars=np.vstack([np.column_stack([np.full(q, tip), k]) for tip in (q, q + 1)]),
        strings=np.vstack([np.column_stack([k, (k + 1) % q]), [[q, q + 1]]]),
        bar_mass=bar_mass,
        string_groups=["ring"] * q + ["axis"],
    )


@of_sizes
def t_bar(
    width: float = 2.0,
    height: float = 1.0,
    dimension: int = 2,
    bar_mass: ArrayLike = 1.0,
    continuous: bool = False,
) -> Structure:
    """Return the T-bar: bars along and across that meet in a joint, in a loop of four strings.

    Node 0 is the joint; then come left, lower, right, upper. Strings of the group ``"side"`` go
    around, from left to lower. See :func:`kite` for two bars that cross without a joint.

    One state of self-stress, two with a continuous bar; no mechanism in the plane. In space it
    folds: two mechanisms.

    Parameters
    ----------
    width : float
        Extent along x, m.
    height : float
        Extent along y, m.
    dimension : {2, 3}
        2 for a structure in the plane, 3 for one in space, at z = 0.
    bar_mass : float or array_like, shape (4,)
        Mass of each bar, kg, in the order of the nodes at their ends; shape (3,) with a
        continuous bar, which comes last.
    continuous : bool
        Whether the bar across is one from the lower to the upper node. It passes the joint, and two
        strings more, group ``"joint"``, go from its ends there.

    Returns
    -------
    Structure
        Of class 4; of class 2 with a continuous bar.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, the dimension is neither 2 nor 3, or ``continuous``
        is no truth value.

    Notes
    -----
    R. E. Skelton and M. C. de Oliveira, *Tensegrity Systems* (2009), chapter 3. The force density
    of four bars is twice that of strings.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> [tc.library.t_bar(continuous=one).structure_class for one in (False, True)]
    [4, 2]
    """
    half = validation.positive_number("width", width, "m") / 2
    rise = validation.positive_number("height", height, "m") / 2
    bars, strings = [[0, 1], [0, 2], [0, 3], [0, 4]], [[1, 2], [2, 3], [3, 4], [4, 1]]
    if validation.truth("continuous", continuous, "whether the bar across is in one piece"):
        bars, strings = [[0, 1], [0, 3], [2, 4]], [*strings, [0, 2], [0, 4]]
    return Structure(
        nodes=_flat([[0, -half, 0, half, 0], [0, 0, -rise, 0, rise]], dimension),
        bars=bars,
        strings=strings,
        bar_mass=bar_mass,
        string_groups=["side"] * 4 + ["joint"] * (len(strings) - 4),
    )


def _flat(nodes: list[list[float]], dimension: int) -> np.ndarray:
    """Return nodes in the plane, or at z = 0 in space."""
    d = validation.whole_number("dimension", dimension, least=2, most=3)
    return np.vstack([nodes, np.zeros((d - 2, len(nodes[0])))])


def _share(name: str, value: float, of: str) -> float:
    share = validation.positive_number(name, value, f"shares of the {of}")
    if share >= 1:
        raise ValueError(f"{name} is {share:g}, expected a share of the {of}, below 1")
    return share
