"""Forces at rest: self-stress, prestress, mechanisms, stability."""

from tenscontrol.statics.equilibrium_matrix import equilibrium_matrix, member_forces, null_space
from tenscontrol.statics.least_distance import least_distance
from tenscontrol.statics.prestress import (
    Prestress,
    balanced,
    prestress,
    prism_force_density,
)
from tenscontrol.statics.stability import Stability, TangentStiffness, stress_matrix

__all__ = [
    "Prestress",
    "Stability",
    "TangentStiffness",
    "balanced",
    "equilibrium_matrix",
    "least_distance",
    "member_forces",
    "null_space",
    "prestress",
    "prism_force_density",
    "stress_matrix",
]
