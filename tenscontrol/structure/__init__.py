"""What a tensegrity structure is: nodes, bars, strings, masses."""

from tenscontrol.structure.bar_clearance import (
    BarClearance,
    BarCrossing,
    BarDistances,
    BarMotion,
    bar_distances,
)
from tenscontrol.structure.bar_geometry import (
    refuse_strings_without_length,
    refuse_wrong_bar_lengths,
    restore_bar_lengths,
)
from tenscontrol.structure.blocks import Block, bar_rows, block_mass, node_mass
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.net import net
from tenscontrol.structure.prism import prism, prism_radius, prism_tower
from tenscontrol.structure.segments import (
    segment_counts,
    spread_force_density,
    spread_rest_length,
    subdivide,
    to_segments,
    to_strings,
    whole_strings,
)
from tenscontrol.structure.skin import skin, skin_rest_length
from tenscontrol.structure.structure import Structure, different_members, same_members
from tenscontrol.structure.structure_file import STRUCTURE_KEYS, from_table, points, to_table
from tenscontrol.structure.supports import (
    affine_motions,
    carried_by_supports,
    free_coordinates,
    is_movable,
    left_by_supports,
    moving_mass,
    refuse_load_without_support,
    refuse_moved_supports,
    rigid_basis,
    rigid_motions,
)

__all__ = [
    "STRUCTURE_KEYS",
    "BarClearance",
    "BarCrossing",
    "BarDistances",
    "BarMotion",
    "Block",
    "Structure",
    "affine_motions",
    "bar_distances",
    "bar_rows",
    "block_mass",
    "carried_by_supports",
    "different_members",
    "free_coordinates",
    "from_table",
    "is_movable",
    "left_by_supports",
    "moving_mass",
    "net",
    "node_mass",
    "points",
    "prism",
    "prism_radius",
    "prism_tower",
    "refuse_load_without_support",
    "refuse_many_members",
    "refuse_moved_supports",
    "refuse_strings_without_length",
    "refuse_wrong_bar_lengths",
    "restore_bar_lengths",
    "rigid_basis",
    "rigid_motions",
    "same_members",
    "segment_counts",
    "skin",
    "skin_rest_length",
    "spread_force_density",
    "spread_rest_length",
    "subdivide",
    "to_segments",
    "to_strings",
    "to_table",
    "whole_strings",
]
