"""Structures of the kinds that people build, by formula, each at a shape it can have.

Their members are those of Goyal & Skelton, *Tensegrity Systems* (2009) and Snelson's and Fuller's
figures; sizes are in metres, masses in kilograms, and of no particular make.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

import tenscontrol as tc


def six_bar_ball() -> tc.Structure:
    """The expandable octahedron: bars of 1 m in three pairs, 24 strings, class 1."""
    nodes = np.array([np.roll([0.5 * a, 0.25 * b, 0.0], k)
                      for k in range(3) for b in (-1, 1) for a in (-1, 1)]).T  # fmt: skip
    bars = [(i, i + 1) for i in range(0, 12, 2)]
    length = np.linalg.norm(nodes[:, :, None] - nodes[:, None], axis=0)
    near = np.argwhere(np.triu(np.abs(length - np.sqrt(3 / 8)) < 1e-9))
    return tc.Structure(nodes, bars, near, 1.0)


def snelson_x() -> tc.Structure:
    """Two crossing bars in a square of strings, in the plane, class 1."""
    nodes = [[0, 1, 1, 0], [0, 0, 1, 1]]
    return tc.Structure(nodes, [(0, 2), (1, 3)], [(0, 1), (1, 2), (2, 3), (3, 0)], 1.0)


def d_bar(**more: object) -> tc.Structure:
    """Four bars in a rhombus with two strings across, in the plane, class 2."""
    nodes = [[-1, 0, 1, 0], [0, -0.6, 0, 0.6]]
    bars = [(0, 1), (1, 2), (2, 3), (3, 0)]
    return tc.Structure(nodes, bars, [(0, 2), (1, 3)], [1.0, 1.2, 0.8, 1.1], **more)


def d_bar_in_space() -> tc.Structure:
    """Six bars from two tips to three nodes around, four strings, class 3."""
    turn = 2 * np.pi / 3 * np.arange(3)
    around = 0.5 * np.array([np.cos(turn), np.sin(turn), 0 * turn])
    nodes = np.hstack([[[0, 0], [0, 0], [-1, 1]], around])
    bars = [(tip, 2 + i) for tip in (0, 1) for i in range(3)]
    return tc.Structure(nodes, bars, [(0, 1), (2, 3), (3, 4), (4, 2)], 1.0)


def t_bar() -> tc.Structure:
    """Four bars from one node, with strings around them, in the plane, class 4."""
    nodes = [[0, 1, 0, -1, 0], [0, 0, 0.7, 0, -0.7]]
    bars = [(0, i) for i in range(1, 5)]
    return tc.Structure(nodes, bars, [(1, 2), (2, 3), (3, 4), (4, 1)], 1.0)


def class2_tower(stages: int, radius: float = 0.5, height: float = 1.0) -> tc.Structure:
    """Prisms on top of one another that share their nodes: three chains of bars, class 2."""
    level, corner = (part.ravel() for part in np.mgrid[: stages + 1, :3])
    turn = 2 * np.pi / 3 * corner + 5 * np.pi / 6 * level
    nodes = np.array([radius * np.cos(turn), radius * np.sin(turn), height * level])
    below = 3 * np.arange(stages)[:, None] + np.arange(3)
    rings = 3 * np.arange(stages + 1)[:, None]
    bars = np.stack([below, below + 3], axis=-1).reshape(-1, 2)
    ring = np.stack([rings + np.arange(3), rings + np.array([1, 2, 0])], axis=-1).reshape(-1, 2)
    # From each node to the one above it that is 30 degrees away: not the bar's end.
    up = np.stack([below, 3 + below - np.arange(3) + [2, 0, 1]], axis=-1).reshape(-1, 2)
    return tc.Structure(nodes, bars, np.vstack([ring, up]), 1.0)


def vertebra() -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Return nodes, shape (3, 5), and the bars of a tetrahedron with its centre: ten, redundant."""
    corners = 0.5 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]).T
    return np.hstack([corners, np.zeros((3, 1))]), list(combinations(range(5), 2))


def spine(vertebrae: int = 3, fixed: bool = True) -> tc.Structure:
    """Rigid vertebrae of redundant bars above one another, held by strings; the first is fixed."""
    one, pairs = vertebra()
    lift = [[0.0], [0.0], [0.7]]
    nodes = np.hstack([one + k * np.array(lift) for k in range(vertebrae)])
    bars = [(5 * k + a, 5 * k + b) for k in range(vertebrae) for a, b in pairs]
    strings = [
        (5 * k + a, 5 * (k + 1) + b)
        for k in range(vertebrae - 1)
        for a, b in [(i, i) for i in range(4)] + [(0, 1), (3, 1), (0, 2), (3, 2)]
    ]
    return tc.Structure(nodes, bars, strings, 1.0, fixed=range(5) if fixed else ())


def arm() -> tc.Structure:
    """Three links in the plane on a pin and a roller, with a payload and a string over a joint."""
    nodes = [[0, 0.8, 1.6, 2.2, 0.1, 1.0], [0, 0.5, 0.1, 0.9, 1.0, 1.2]]
    bars = [(0, 1), (1, 2), (2, 3)]
    strings = [(4, 1, 5, 3), (4, 5), (5, 2), (0, 2)]
    mass = [0, 0, 0.7, 0, 0, 0.2]
    return tc.Structure(nodes, bars, strings, 1.0, fixed=[0, 4, (2, "y")], point_mass=mass)


def dome() -> tc.Structure:
    """Struts under cables from a fixed rim, and a node on top that slides up and down, class 1."""
    turn = np.pi / 2 * np.arange(4)
    circle = np.array([np.cos(turn), np.sin(turn)])
    level = [np.vstack([r * circle, np.full(4, z)]) for r, z in ((2, 0), (1, 0.5), (1, -0.4))]
    nodes = np.hstack([*level, [[0], [0], [0.8]]])
    bars = [(4 + i, 8 + i) for i in range(4)]
    strings = [(i, k + i) for k in (4, 8) for i in range(4)] + [(4 + i, 12) for i in range(4)]
    strings += [(8 + i, 8 + (i + 1) % 4) for i in range(4)]
    mass = np.eye(13)[12] * 0.3
    return tc.Structure(
        nodes, bars, strings, 1.0, fixed=[*range(4), (12, "x"), (12, "y")], point_mass=mass
    )


def clustered_d_bar() -> tc.Structure:
    """A rhombus of bars with a closed string around it and one over two joints."""
    nodes = [[-1, 0, 1, 0, 0], [0, -0.6, 0, 0.6, 1.5]]
    bars = [(0, 1), (1, 2), (2, 3), (3, 0)]
    strings = [(0, 1, 2, 3, 0), (4, 0, 2), (1, 3)]
    return tc.Structure(nodes, bars, strings, 1.0, fixed=[4])


KNOWN = {
    "six-bar ball": six_bar_ball,
    "Snelson's X": snelson_x,
    "D-bar": d_bar,
    "D-bar in space": d_bar_in_space,
    "T-bar": t_bar,
    "class-2 tower": lambda: class2_tower(3),
    "spine": spine,
    "arm": arm,
    "dome": dome,
    "clustered D-bar": clustered_d_bar,
}


def lowered(height):
    """Nodes of the prism with the bars of the usual one and another height, m."""
    radius = tc.structure.prism_radius(tc.prism().bar_length[0], height)
    return tc.prism(radius=radius, height=height).nodes


def height_row():
    """The height of the top of the prism above its bottom, as a row over all coordinates."""
    row = np.zeros((3, 6))
    row[2, :3], row[2, 3:] = 1 / 3, -1 / 3
    return row.ravel(order="F")[None]
