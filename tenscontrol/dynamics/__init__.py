"""The equations of motion as CasADi functions."""

from tenscontrol.dynamics.coordinates import (
    KINDS,
    Coordinates,
    affine_motions,
    coordinates,
    rigid_motions,
)
from tenscontrol.dynamics.evaluator import Evaluator, evaluate_columns
from tenscontrol.dynamics.model import Model, pack_state, unpack_states
from tenscontrol.dynamics.strings import ElasticStrings, LinearStrings, StringLaw

__all__ = [
    "KINDS",
    "Coordinates",
    "ElasticStrings",
    "Evaluator",
    "LinearStrings",
    "Model",
    "StringLaw",
    "affine_motions",
    "coordinates",
    "evaluate_columns",
    "pack_state",
    "rigid_motions",
    "unpack_states",
]
