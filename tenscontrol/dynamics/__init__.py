"""The equations of motion as CasADi functions."""

from tenscontrol.dynamics.contact_laws import (
    ContactLaw,
    Contacts,
    Ground,
    HertzGround,
    SmoothGround,
)
from tenscontrol.dynamics.coordinates import KINDS, Coordinates, coordinates, normal_basis
from tenscontrol.dynamics.equation import Equation, InputLayout, smooth_equation
from tenscontrol.dynamics.evaluator import (
    BUILDING,
    ColumnEvaluator,
    Evaluator,
    Exclusive,
    Prepared,
    SharedEvaluator,
    builds,
    built,
    evaluate_columns,
    exclusive,
    solving,
)
from tenscontrol.dynamics.machine_code import (
    Compiled,
    Compiler,
    CompilerError,
    compiled,
    compiled_library,
    compiled_source,
    compiler,
)
from tenscontrol.dynamics.model import Model, pack_state, unpack_states
from tenscontrol.dynamics.profile import Pieces, Profile, as_pieces, polynomial_at
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings, StringLaw

__all__ = [
    "BUILDING",
    "KINDS",
    "ColumnEvaluator",
    "Compiled",
    "Compiler",
    "CompilerError",
    "ContactLaw",
    "Contacts",
    "Coordinates",
    "ElasticStrings",
    "Equation",
    "Evaluator",
    "Exclusive",
    "Ground",
    "HertzGround",
    "InputLayout",
    "LinearStrings",
    "Model",
    "Pieces",
    "Prepared",
    "Profile",
    "SharedEvaluator",
    "SmoothGround",
    "StringLaw",
    "as_pieces",
    "builds",
    "built",
    "compiled",
    "compiled_library",
    "compiled_source",
    "compiler",
    "coordinates",
    "evaluate_columns",
    "exclusive",
    "normal_basis",
    "pack_state",
    "polynomial_at",
    "smooth_equation",
    "solving",
    "unpack_states",
]
