"""What a tensegrity structure is: nodes, bars, strings, masses."""

from tenscontrol.structure.lengths import (
    refuse_strings_without_length,
    refuse_wrong_bar_lengths,
    restore_bar_lengths,
)
from tenscontrol.structure.prism import prism, prism_radius
from tenscontrol.structure.structure import Structure

__all__ = [
    "Structure",
    "prism",
    "prism_radius",
    "refuse_strings_without_length",
    "refuse_wrong_bar_lengths",
    "restore_bar_lengths",
]
