"""Linear plants: linearization, modes, controllability."""

from tenscontrol.analysis.controllability import Controllability, controllability, lost_poles
from tenscontrol.analysis.equilibrium import equilibrium
from tenscontrol.analysis.linearize import (
    OperatingPoint,
    command_parents,
    in_coordinates,
    linearize,
)
from tenscontrol.analysis.modes import Modes, modes
from tenscontrol.analysis.plant import INPUTS, LinearPlant

__all__ = [
    "INPUTS",
    "Controllability",
    "LinearPlant",
    "Modes",
    "OperatingPoint",
    "command_parents",
    "controllability",
    "equilibrium",
    "in_coordinates",
    "linearize",
    "lost_poles",
    "modes",
]
