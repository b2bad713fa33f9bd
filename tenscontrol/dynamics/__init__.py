"""The equations of motion as CasADi functions."""

from tenscontrol.dynamics.contact_laws import (
    ContactLaw,
    Contacts,
    Ground,
    HertzGround,
    SmoothGround,
)
from tenscontrol.dynamics.coordinates import Coordinates, coordinates
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import BUILDING
from tenscontrol.dynamics.machine_code import compiled
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Profile
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings, StringLaw
from tenscontrol.dynamics.symbolic_model import SymbolicModel

__all__ = [
    "BUILDING",
    "ContactLaw",
    "Contacts",
    "Coordinates",
    "ElasticStrings",
    "Equation",
    "Ground",
    "HertzGround",
    "LinearStrings",
    "Model",
    "Profile",
    "SmoothGround",
    "StringLaw",
    "SymbolicModel",
    "compiled",
    "coordinates",
]
