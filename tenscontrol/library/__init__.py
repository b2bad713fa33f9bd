"""Structures that people know, each a function of its sizes."""

from tenscontrol.library.balls import (
    six_bar_ball,
    thirty_bar_ball,
    truncated_tetrahedron,
    twelve_bar_ball,
)
from tenscontrol.library.chains import arm, class2_tower, spine, stedy_arm
from tenscontrol.library.crosses import d_bar, d_bar_3d, kite, snelson_x, t_bar
from tenscontrol.library.domes import cable_net, geiger_dome, levy_dome, wheel
from tenscontrol.structure import net, prism, prism_tower

__all__ = [
    "arm",
    "cable_net",
    "class2_tower",
    "d_bar",
    "d_bar_3d",
    "geiger_dome",
    "kite",
    "levy_dome",
    "net",
    "prism",
    "prism_tower",
    "six_bar_ball",
    "snelson_x",
    "spine",
    "stedy_arm",
    "t_bar",
    "thirty_bar_ball",
    "truncated_tetrahedron",
    "twelve_bar_ball",
    "wheel",
]
