"""Linear plants and what controllers and filters need of them."""

from tenscontrol.plant.controllability import Controllability, controllability, lost_poles
from tenscontrol.plant.equilibrium import equilibrium
from tenscontrol.plant.linear_plant import INPUTS, LinearPlant
from tenscontrol.plant.linearize import (
    OperatingPoint,
    command_parents,
    in_coordinates,
    linearize,
)
from tenscontrol.plant.modes import Modes, modes
from tenscontrol.plant.reference import Reference

__all__ = [
    "INPUTS",
    "Controllability",
    "LinearPlant",
    "Modes",
    "OperatingPoint",
    "Reference",
    "command_parents",
    "controllability",
    "equilibrium",
    "in_coordinates",
    "linearize",
    "lost_poles",
    "modes",
]
