"""Forces at rest: self-stress, prestress, mechanisms, stability."""

from tenscontrol.statics.equilibrium_matrix import equilibrium_matrix
from tenscontrol.statics.prestress import Prestress, prestress, prism_force_density
from tenscontrol.statics.stability import Stability, TangentStiffness, stress_matrix

__all__ = [
    "Prestress",
    "Stability",
    "TangentStiffness",
    "equilibrium_matrix",
    "prestress",
    "prism_force_density",
    "stress_matrix",
]
