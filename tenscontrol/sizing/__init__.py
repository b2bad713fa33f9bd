"""Materials, cross sections and minimal mass."""

from tenscontrol.sizing.complexity import Complexity, complexity
from tenscontrol.sizing.materials import Material, materials
from tenscontrol.sizing.member_groups import length_groups, symmetry_groups
from tenscontrol.sizing.minimal_mass import Design, Tube, design
from tenscontrol.sizing.sections import Sections, sections

__all__ = [
    "Complexity",
    "Design",
    "Material",
    "Sections",
    "Tube",
    "complexity",
    "design",
    "length_groups",
    "materials",
    "sections",
    "symmetry_groups",
]
