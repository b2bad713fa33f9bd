"""The equations of motion as CasADi functions."""

from tenscontrol.dynamics.contact_laws import (
    ContactLaw,
    Contacts,
    Ground,
    HertzGround,
    SmoothGround,
)
from tenscontrol.dynamics.coordinates import KINDS, Coordinates, coordinates
from tenscontrol.dynamics.equation import (
    Equation,
    InputLayout,
    pack_state,
    smooth_equation,
    unpack_states,
)
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
from tenscontrol.dynamics.gravity import weights
from tenscontrol.dynamics.machine_code import (
    Compiled,
    Compiler,
    CompilerError,
    compiled,
    compiled_library,
    compiled_source,
    compiler,
)
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces, Profile, as_pieces, polynomial_at
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings, StringLaw
from tenscontrol.dynamics.tangent import (
    Tangent,
    normal_basis,
    refuse_large,
    string_stretch,
    tangent,
)

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
    "Tangent",
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
    "refuse_large",
    "smooth_equation",
    "solving",
    "string_stretch",
    "tangent",
    "unpack_states",
    "weights",
]
