"""What stands at the top level; each name is imported when it is first used."""

from . import (
    accuracy as accuracy,
    actuation as actuation,
    control as control,
    deploy as deploy,
    dynamics as dynamics,
    estimation as estimation,
    exchange as exchange,
    integrate as integrate,
    learning as learning,
    library as library,
    optimize as optimize,
    plant as plant,
    plot as plot,
    robustness as robustness,
    scene as scene,
    shape as shape,
    simulation as simulation,
    sizing as sizing,
    statics as statics,
    structure as structure,
)
from ._version import __version__ as __version__
from .accuracy import (
    convergence_order as convergence_order,
    long_run as long_run,
    predictability as predictability,
    stability_map as stability_map,
    work_precision as work_precision,
)
from .actuation import (
    Motor as Motor,
    Winches as Winches,
    to_force_density as to_force_density,
    to_rest_length as to_rest_length,
)
from .configuration import (
    show_config as show_config,
)
from .control import (
    LQR as LQR,
    MPC as MPC,
    NMPC as NMPC,
    FeedbackLinearization as FeedbackLinearization,
    FunctionController as FunctionController,
    OutputLimit as OutputLimit,
    clearance as clearance,
)
from .deploy import (
    generate_c as generate_c,
)
from .dynamics import (
    ElasticStrings as ElasticStrings,
    Ground as Ground,
    LinearStrings as LinearStrings,
    Model as Model,
    Profile as Profile,
)
from .estimation import (
    KalmanFilter as KalmanFilter,
    Sensors as Sensors,
)
from .learning import (
    vector_env as vector_env,
)
from .optimize import (
    Log as Log,
    fit as fit,
    gradient as gradient,
    identifiable as identifiable,
    sensitivity as sensitivity,
)
from .plant import (
    OperatingPoint as OperatingPoint,
    Reference as Reference,
    actuator_choice as actuator_choice,
    controllability as controllability,
    energy_weights as energy_weights,
    equilibrium as equilibrium,
    linearize as linearize,
    modes as modes,
    reduce as reduce,
    rigidity as rigidity,
)
from .robustness import (
    ClosedLoopCase as ClosedLoopCase,
    Normal as Normal,
    OneOf as OneOf,
    Uniform as Uniform,
    sweep as sweep,
)
from .scene import (
    load_scene as load_scene,
)
from .shape import (
    Height as Height,
    NodesAt as NodesAt,
    RotationalSymmetry as RotationalSymmetry,
    Twist as Twist,
    shape_path as shape_path,
    shape_target as shape_target,
)
from .simulation import (
    CutString as CutString,
    HealthLimits as HealthLimits,
    Integration as Integration,
    LostMeasurement as LostMeasurement,
    Scene as Scene,
    Stepper as Stepper,
    StuckWinch as StuckWinch,
    load_run as load_run,
    simulate as simulate,
    simulate_many as simulate_many,
    strength as strength,
)
from .sizing import (
    Material as Material,
    design as design,
    sections as sections,
)
from .statics import (
    prestress as prestress,
)
from .structure import (
    Structure as Structure,
    net as net,
    prism as prism,
    prism_tower as prism_tower,
    skin as skin,
    subdivide as subdivide,
)

__all__ = [
    "LQR",
    "MPC",
    "NMPC",
    "ClosedLoopCase",
    "CutString",
    "ElasticStrings",
    "FeedbackLinearization",
    "FunctionController",
    "Ground",
    "HealthLimits",
    "Height",
    "Integration",
    "KalmanFilter",
    "LinearStrings",
    "Log",
    "LostMeasurement",
    "Material",
    "Model",
    "Motor",
    "NodesAt",
    "Normal",
    "OneOf",
    "OperatingPoint",
    "OutputLimit",
    "Profile",
    "Reference",
    "RotationalSymmetry",
    "Scene",
    "Sensors",
    "Stepper",
    "Structure",
    "StuckWinch",
    "Twist",
    "Uniform",
    "Winches",
    "__version__",
    "actuator_choice",
    "clearance",
    "controllability",
    "convergence_order",
    "design",
    "energy_weights",
    "equilibrium",
    "fit",
    "generate_c",
    "gradient",
    "identifiable",
    "linearize",
    "load_run",
    "load_scene",
    "long_run",
    "modes",
    "net",
    "predictability",
    "prestress",
    "prism",
    "prism_tower",
    "reduce",
    "rigidity",
    "sections",
    "sensitivity",
    "shape_path",
    "shape_target",
    "show_config",
    "simulate",
    "simulate_many",
    "skin",
    "stability_map",
    "strength",
    "subdivide",
    "sweep",
    "to_force_density",
    "to_rest_length",
    "vector_env",
    "work_precision",
]
