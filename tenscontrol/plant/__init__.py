"""Linear plants and what controllers and filters need of them."""

from tenscontrol.plant.actuator_choice import ActuatorChoice, actuator_choice
from tenscontrol.plant.controllability import Controllability, controllability
from tenscontrol.plant.deflections import (
    Deflections,
    DirectionalStiffness,
    deflections,
    stiffness_along,
)
from tenscontrol.plant.equilibrium import equilibrium
from tenscontrol.plant.linear_plant import LinearPlant, SparsePlant
from tenscontrol.plant.linearize import OperatingPoint, command_parents, in_coordinates, linearize
from tenscontrol.plant.modes import Modes, modes
from tenscontrol.plant.reduced_dynamics import ReducedPlant, reduce
from tenscontrol.plant.reference import Reference
from tenscontrol.plant.riccati import energy_weights, natural_weights
from tenscontrol.plant.rigidity import Rigidity, RigidityWarning, rigidity
from tenscontrol.plant.stance import Stance, StanceContacts, Tipping, set_down

__all__ = [
    "ActuatorChoice",
    "Controllability",
    "Deflections",
    "DirectionalStiffness",
    "LinearPlant",
    "Modes",
    "OperatingPoint",
    "ReducedPlant",
    "Reference",
    "Rigidity",
    "RigidityWarning",
    "SparsePlant",
    "Stance",
    "StanceContacts",
    "Tipping",
    "actuator_choice",
    "command_parents",
    "controllability",
    "deflections",
    "energy_weights",
    "equilibrium",
    "in_coordinates",
    "linearize",
    "modes",
    "natural_weights",
    "reduce",
    "rigidity",
    "set_down",
    "stiffness_along",
]
