"""Chains of equal parts that share nodes or hang in strings: towers, arms and spines."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tenscontrol import validation
from tenscontrol.library.sizes import of_sizes
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.structure import Structure


@of_sizes
def class2_tower(
    stages: int = 2,
    sides: int = 3,
    radius: float = 0.5,
    height: float = 1.0,
    bar_mass: ArrayLike = 1.0,
    handedness: str = "left",
    floating: bool = False,
) -> Structure:
    """Return a class-2 tower: tensegrity prisms on one another, whose bars meet in shared nodes.

    Each stage is turned against the one below by ``π/2 − π/sides``, so that it balances by itself.
    Nodes come polygon by polygon from the bottom, q each, bars stage by stage; strings are in the
    groups ``"polygon"``, q for each polygon above the bottom, and ``"vertical"``, q for each stage.

    One state of self-stress and one mechanism, the twist, for each stage, which prestress stiffens;
    floating, 2 q − 6 mechanisms more.

    Parameters
    ----------
    stages : int
        Number of prisms, at least 1.
    sides : int
        Number q of bars and of polygon sides of a stage, at least 3.
    radius : float
        Radius of the circles through the nodes, m.
    height : float
        Height of a stage, m.
    bar_mass : float or array_like, shape (stages * q,)
        Mass of each bar, kg.
    handedness : {"left", "right"}
        The screw that the bars follow on their way up.
    floating : bool
        Whether the bottom polygon has strings, group ``"bottom"``, and nothing holds it; it is
        fixed if not.

    Returns
    -------
    Structure
        Of class 2, or 1 with one stage.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, ``stages`` is below 1, ``sides`` is below 3,
        ``handedness`` is another word, or ``floating`` is no truth value.

    Notes
    -----
    The first examples of TsgFEM: S. Ma, M. Chen and R. E. Skelton, *TsgFEM: Tensegrity Finite
    Element Method*, JOSS 7 (2022) 3390, with two stages, radius 10 and height 30 a stage.
    :func:`tenscontrol.prism_tower` is the tower of class 1.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tower = tc.library.class2_tower(stages=3)
    >>> tower, tower.structure_class
    (Structure(12 nodes, 9 bars, 18 strings), 2)
    """
    count = validation.whole_number("stages", stages, least=1)
    q = validation.whole_number("sides", sides, least=3)
    refuse_many_members(f"stages is {count} and sides is {q}", 3 * count * q)
    radius = validation.positive_number("radius", radius, "m")
    height = validation.positive_number("height", height, "m")
    mirror = (
        1.0 if validation.choice("handedness", handedness, ("left", "right")) == "left" else -1.0
    )
    floats = validation.truth("floating", floating, "whether nothing holds the bottom polygon")

    level, k = np.arange(count + 1)[:, None], np.arange(q)
    angle = -mirror * (2 * np.pi * k / q + (np.pi / 2 - np.pi / q) * level)
    places = [radius * np.cos(angle), radius * np.sin(angle), height * level + 0.0 * angle]
    node = q * level + k
    around = np.stack([node, np.roll(node, -1, axis=1)], axis=-1)
    upright = np.stack([node[:-1], node[1:]], axis=-1)
    groups = {"polygon": around[1:], "vertical": upright}
    if floats:
        groups["bottom"] = around[:1]
    return Structure(
        nodes=np.reshape(places, (3, -1)),
        bars=np.column_stack([node[:-1].ravel(), np.roll(node[1:], -1, axis=1).ravel()]),
        strings=np.vstack([pairs.reshape(-1, 2) for pairs in groups.values()]),
        bar_mass=bar_mass,
        string_groups=[name for name, pairs in groups.items() for _ in range(pairs.size // 2)],
        fixed=() if floats else node[0],
    )


@of_sizes
def arm(
    sections: int = 2, length: float = 1.0, height: float = 1.0, bar_mass: ArrayLike = 1.0
) -> Structure:
    """Return a planar arm of Snelson's X-frames in a row, held at its left end.

    Bars of neighbouring frames meet in shared nodes. Nodes 2 i and 2 i + 1 are the lower and the
    upper one of upright i; the first two are fixed. Strings are in the groups ``"lower"``,
    ``"upper"`` and ``"upright"``, one of each for every section.

    One state of self-stress for each section, no mechanism.

    Parameters
    ----------
    sections : int
        Number of frames, at least 1.
    length : float
        Length of a frame, m.
    height : float
        Height of a frame, m.
    bar_mass : float or array_like, shape (2 * sections,)
        Mass of each bar, kg.

    Returns
    -------
    Structure
        In the plane; of class 2, or 1 with one section.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, or ``sections`` is below 1.

    Notes
    -----
    Of frames as in K. Snelson, US patent 3,169,611 (1965).

    Examples
    --------
    >>> import tenscontrol as tc
    >>> reach = tc.library.arm(sections=3)
    >>> reach, reach.dimension, reach.fixed
    (Structure(8 nodes, 6 bars, 9 strings), 2, array([0, 1]))
    """
    count = validation.whole_number("sections", sections, least=1)
    refuse_many_members(f"sections is {count}", 5 * count)
    length = validation.positive_number("length", length, "m")
    height = validation.positive_number("height", height, "m")
    upright, end = np.divmod(np.arange(2 * count + 2), 2)
    low = 2 * np.arange(count)
    crossed = np.stack([np.column_stack([low, low + 3]), np.column_stack([low + 1, low + 2])], 1)
    pairs = [[low, low + 2], [low + 1, low + 3], [low + 2, low + 3]]
    return Structure(
        nodes=[length * upright, height * end],
        bars=crossed.reshape(-1, 2),
        strings=np.hstack(pairs).T,
        bar_mass=bar_mass,
        string_groups=np.repeat(["lower", "upper", "upright"], count).tolist(),
        fixed=[0, 1],
    )


@of_sizes
def stedy_arm(bar_length: float = 1.0, bar_mass: ArrayLike = 1.0) -> Structure:
    """Return the planar arm of STEDY: triangles of bars about two joints, in strings.

    Nodes go around the arm from the fixed ones, 0, 1 and 15, on its left; 4 and 7 are the joints in
    its middle, where six bars meet.

    Six states of self-stress, no mechanism.

    Parameters
    ----------
    bar_length : float
        Length of the slanted bars, m; the others are 1/√2 of it.
    bar_mass : float or array_like, shape (16,)
        Mass of each bar, kg.

    Returns
    -------
    Structure
        In the plane, of class 6, with 18 strings.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite.

    Notes
    -----
    V. Tadiparthi, S.-C. Hsu and R. Bhattacharya, *STEDY: Software for Tensegrity Dynamics*, JOSS 4
    (2019) 1042, in its plane.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> reach = tc.library.stedy_arm()
    >>> reach, reach.structure_class
    (Structure(16 nodes, 16 bars, 18 strings), 6)
    """
    step = validation.positive_number("bar_length", bar_length, "m") / np.sqrt(2)
    x = [0, 0, 1, 2, 2, 3, 4, 4, 5, 6, 5, 4, 3, 2, 1, 0]
    y = [0, -1, -1, -1, 0, -1, -1, 0, -1, 0, 1, 1, 1, 1, 1, 1]
    bars = [
        (0, 2), (2, 4), (4, 3), (4, 5), (5, 7), (7, 6), (7, 8), (8, 9),
        (9, 10), (10, 7), (7, 11), (7, 12), (12, 4), (4, 13), (4, 14), (14, 0),
    ]  # fmt: skip
    strings = [
        (0, 1), (1, 2), (2, 3), (3, 5), (5, 6), (6, 8), (10, 11), (11, 12), (12, 13),
        (13, 14), (14, 15), (15, 0), (0, 4), (4, 7), (7, 9), (8, 10), (5, 12), (2, 14),
    ]  # fmt: skip
    return Structure(
        nodes=step * np.array([x, y]),
        bars=bars,
        strings=strings,
        bar_mass=bar_mass,
        fixed=[0, 1, 15],
    )


@of_sizes
def spine(
    vertebrae: int = 2,
    leg_length: float = 0.15,
    spread: float = np.pi / 3,
    spacing: float = 0.1,
    bar_mass: ArrayLike = 0.1,
) -> Structure:
    """Return a spine of rigid vertebrae that hang in strings above one another; the lowest is held.

    A vertebra has a centre node and four legs, two down along ± x and two up along ± y, whose tips
    six more bars join: ten bars, one more than make it rigid. Nodes come vertebra by vertebra, the
    centre first, then the legs along x, −x, y, −y. Strings come in the groups ``"vertical"``, four
    from leg to leg for each joint, and ``"saddle"``, four from the upper legs of a vertebra to the
    lower ones of the next.

    Three states of self-stress for each joint, one of them within the bars of the upper vertebra,
    no mechanism.

    Parameters
    ----------
    vertebrae : int
        Number of vertebrae, at least 2.
    leg_length : float
        Distance from the centre to each tip, m.
    spread : float
        Angle of the legs from the vertical, rad, above 0 and below π/2.
    spacing : float
        Height of a centre above the next lower one, m. Below twice that of a leg, vertebrae
        reach into one another, so that the saddle strings pull them apart.
    bar_mass : float or array_like, shape (10 * vertebrae,)
        Mass of each bar, kg; the four legs of a vertebra come before its other bars.

    Returns
    -------
    Structure
        Of class 4, with redundant bars.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite, ``vertebrae`` is below 2, ``spread`` is not below
        π/2, or ``spacing`` is not below twice the height of a leg.

    Notes
    -----
    A. P. Sabelhaus et al., *Design, simulation, and testing of a flexible actuated spine for
    quadruped robots* (2018), with its sizes, and with bars that hold the legs.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> back = tc.library.spine(vertebrae=3)
    >>> back, [block.is_redundant for block in back.blocks]
    (Structure(15 nodes, 30 bars, 16 strings), [True, True])
    """
    count = validation.whole_number("vertebrae", vertebrae, least=2)
    refuse_many_members(f"vertebrae is {count}", 18 * count)
    leg = validation.positive_number("leg_length", leg_length, "m")
    angle = validation.positive_number("spread", spread, "rad")
    if angle >= np.pi / 2:
        raise ValueError(f"spread is {angle:g} rad, expected below π/2: legs go up and down")
    rise, reach = leg * np.cos(angle), leg * np.sin(angle)
    step = validation.positive_number("spacing", spacing, "m")
    if step >= 2 * rise:
        raise ValueError(
            f"spacing is {step:g} m, expected below {2 * rise:g} m, twice the height of a leg: the "
            "saddle strings would not pull the vertebrae apart"
        )
    x, y, z = [0, reach, -reach, 0, 0], [0, 0, 0, reach, -reach], [0, -rise, -rise, rise, rise]
    one = np.array([x, y, z])
    nodes = one[:, None, :] + step * np.arange(count)[:, None] * np.eye(3)[2][:, None, None]
    bars = np.array(
        [(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (1, 3), (1, 4), (2, 3), (2, 4), (3, 4)]
    )
    first = 5 * np.arange(count)
    joint = first[:-1, None, None]
    vertical = joint + np.array([(1, 6), (2, 7), (3, 8), (4, 9)])
    saddle = joint + np.array([(3, 6), (3, 7), (4, 6), (4, 7)])
    return Structure(
        nodes=nodes.reshape(3, -1),
        bars=(first[:, None, None] + bars).reshape(-1, 2),
        strings=np.vstack([vertical.reshape(-1, 2), saddle.reshape(-1, 2)]),
        bar_mass=bar_mass,
        string_groups=np.repeat(["vertical", "saddle"], 4 * (count - 1)).tolist(),
        fixed=np.arange(5),
    )
