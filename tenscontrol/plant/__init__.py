"""Linear plants and what controllers and filters need of them."""

from tenscontrol.plant.controllability import (
    Controllability,
    controllability,
    lost_poles,
    refuse_empty,
    refuse_unreachable,
)
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
from tenscontrol.plant.riccati import (
    check_riccati,
    filter_riccati,
    regulator_riccati,
    riccati_residual,
    state_units,
)

__all__ = [
    "INPUTS",
    "Controllability",
    "LinearPlant",
    "Modes",
    "OperatingPoint",
    "Reference",
    "check_riccati",
    "command_parents",
    "controllability",
    "equilibrium",
    "filter_riccati",
    "in_coordinates",
    "linearize",
    "lost_poles",
    "modes",
    "refuse_empty",
    "refuse_unreachable",
    "regulator_riccati",
    "riccati_residual",
    "state_units",
]
