"""Linear plants and what controllers and filters need of them."""

from tenscontrol.plant.controllability import (
    Controllability,
    controllability,
    distinct_poles,
    lost_poles,
    reached_dimension,
    refuse_empty,
    refuse_unreachable,
)
from tenscontrol.plant.equilibrium import equilibrium, held_value
from tenscontrol.plant.linear_plant import (
    INPUTS,
    LinearPlant,
    Sampled,
    acceleration_response,
    sampled,
)
from tenscontrol.plant.linearize import OperatingPoint, command_parents, in_coordinates, linearize
from tenscontrol.plant.modes import Modes, modes
from tenscontrol.plant.reduced_dynamics import (
    acceleration_slopes,
    checked_tracked,
    explicit_substeps,
    near_symbol,
    reduced_acceleration,
    reduced_motion,
    sampled_dynamics,
    settled,
    tracked_motion,
)
from tenscontrol.plant.reference import (
    Preview,
    Reference,
    ReferencePreview,
    SmoothReference,
    checked_reference,
    reduced_shape,
)
from tenscontrol.plant.riccati import (
    check_riccati,
    filter_riccati,
    regulator_riccati,
    riccati_residual,
    state_units,
)
from tenscontrol.plant.string_outputs import (
    StringMap,
    model_input,
    string_forces,
    string_map,
    to_commanded_strings,
    to_model_strings,
)

__all__ = [
    "INPUTS",
    "Controllability",
    "LinearPlant",
    "Modes",
    "OperatingPoint",
    "Preview",
    "Reference",
    "ReferencePreview",
    "Sampled",
    "SmoothReference",
    "StringMap",
    "acceleration_response",
    "acceleration_slopes",
    "check_riccati",
    "checked_reference",
    "checked_tracked",
    "command_parents",
    "controllability",
    "distinct_poles",
    "equilibrium",
    "explicit_substeps",
    "filter_riccati",
    "held_value",
    "in_coordinates",
    "linearize",
    "lost_poles",
    "model_input",
    "modes",
    "near_symbol",
    "reached_dimension",
    "reduced_acceleration",
    "reduced_motion",
    "reduced_shape",
    "refuse_empty",
    "refuse_unreachable",
    "regulator_riccati",
    "riccati_residual",
    "sampled",
    "sampled_dynamics",
    "settled",
    "state_units",
    "string_forces",
    "string_map",
    "to_commanded_strings",
    "to_model_strings",
    "tracked_motion",
]
