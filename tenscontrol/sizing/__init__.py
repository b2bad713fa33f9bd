"""Materials, cross sections and minimal mass."""

from tenscontrol.sizing.materials import Material, materials
from tenscontrol.sizing.member_groups import length_groups, symmetry_groups
from tenscontrol.sizing.minimal_mass import Design, Tube, design
from tenscontrol.sizing.sections import Sections, sections

__all__ = [
    "Design",
    "Material",
    "Sections",
    "Tube",
    "design",
    "length_groups",
    "materials",
    "sections",
    "symmetry_groups",
]
