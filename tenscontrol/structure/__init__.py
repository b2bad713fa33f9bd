"""What a tensegrity structure is: nodes, bars, strings, masses."""

from tenscontrol.structure.bar_lengths import refuse_wrong_bar_lengths, restore_bar_lengths
from tenscontrol.structure.prism import prism, prism_radius
from tenscontrol.structure.structure import Structure

__all__ = ["Structure", "prism", "prism_radius", "refuse_wrong_bar_lengths", "restore_bar_lengths"]
