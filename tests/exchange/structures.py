"""Structures that go to other programs and back: all of the library, and what it does not have."""

from __future__ import annotations

import numpy as np

import tenscontrol as tc


def library():
    """Every structure of the library by name."""
    needed = {"net": (3, 4, 0.2, 0.01), "prism_tower": (2,)}
    names = {name: needed.get(name, ()) for name in tc.library.__all__}
    return {name: getattr(tc.library, name)(*given) for name, given in names.items()}


def others():
    """Payloads, rollers, clustered strings, cut strings, groups of strings."""
    ball = tc.library.six_bar_ball()
    carried = np.zeros(12)
    carried[[0, 5]] = 0.7, 1.3
    members = ball.nodes, ball.bars, ball.strings, ball.bar_mass
    clustered = [*ball.strings[:20].tolist(), [0, 4, 8], [1, 5, 9, 1]]
    return {
        "payload": tc.Structure(*members, point_mass=carried),
        "rollers": tc.Structure(*members, fixed=[(0, "z"), (4, "z"), (8, "x")], point_mass=carried),
        "planar_roller": tc.Structure(
            [[0, 1, 2], [0, 1, 0]], [[0, 1], [1, 2]], [[0, 2]], 1.0, fixed=[0, (2, "y")]
        ),
        "clustered": tc.Structure(ball.nodes, ball.bars, clustered, 1.0),
        "cut": tc.subdivide(tc.prism(), segments=3, node_mass=0.01),
    }


def thrown(structure):
    """Velocities of a structure that travels and turns; none if it is held."""
    N = structure.nodes
    if len(structure.fixed_rows):
        return np.zeros_like(N)
    around = N - N.mean(axis=1, keepdims=True)
    if structure.dimension == 2:
        return np.array([[1.0], [2.0]]) + 1.5 * np.array([-around[1], around[0]])
    return np.array([[1.0], [0.5], [2.0]]) + np.cross([1.0, 2.0, -0.5], around.T).T
