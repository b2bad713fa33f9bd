"""What a tensegrity structure is: nodes, bars, strings, masses."""

from tenscontrol.structure.bar_clearance import BarClearance, BarCrossing
from tenscontrol.structure.bar_geometry import restore_bar_lengths
from tenscontrol.structure.net import net
from tenscontrol.structure.prism import prism, prism_radius, prism_tower
from tenscontrol.structure.segments import (
    segment_counts,
    spread_force_density,
    spread_rest_length,
    subdivide,
)
from tenscontrol.structure.skin import skin, skin_rest_length
from tenscontrol.structure.structure import Structure

__all__ = [
    "BarClearance",
    "BarCrossing",
    "Structure",
    "net",
    "prism",
    "prism_radius",
    "prism_tower",
    "restore_bar_lengths",
    "segment_counts",
    "skin",
    "skin_rest_length",
    "spread_force_density",
    "spread_rest_length",
    "subdivide",
]
