"""Limits of predictive controllers of a prism: in a scene file, and in Python."""

import numpy as np

import tenscontrol as tc


def limits(high):
    """Keys and tables of a [controller], and the same as arguments of MPC and NMPC.

    Node 1 goes no farther along x than ``high``, m.
    """
    text = f"""min_force_density = {{top = 1.0, bottom = 1.0, vertical = 2.0}}
max_tension = 90.0
string_penalty = 50.0
load_gain = 0.5
[[controller.tracked]]
node = 0
relative_to = 3
axis = "z"
[[controller.outputs]]
node = 1
axis = "x"
high = {high}
"""
    height, place = np.zeros((2, 6, 3))
    height[[0, 3], 2] = 1, -1
    place[1, 0] = 1
    given = {
        "min_force_density": [1.0] * 6 + [2.0] * 3,
        "max_tension": 90.0,
        "string_penalty": 50.0,
        "load_gain": 0.5,
        "tracked": height.reshape(1, 18),
        "outputs": [tc.OutputLimit(place.reshape(1, 18), high=high)],
    }
    return text, given
