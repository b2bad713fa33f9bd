"""What stands at the top level; each name is imported when it is first used."""

from . import (
    accuracy as accuracy,
)
from . import (
    actuation as actuation,
)
from . import (
    control as control,
)
from . import (
    deploy as deploy,
)
from . import (
    dynamics as dynamics,
)
from . import (
    estimation as estimation,
)
from . import (
    exchange as exchange,
)
from . import (
    integrate as integrate,
)
from . import (
    library as library,
)
from . import (
    plant as plant,
)
from . import (
    plot as plot,
)
from . import (
    robustness as robustness,
)
from . import (
    scene as scene,
)
from . import (
    shape as shape,
)
from . import (
    simulation as simulation,
)
from . import (
    statics as statics,
)
from . import (
    structure as structure,
)
from ._version import __version__ as __version__
from .accuracy import (
    convergence_order as convergence_order,
)
from .accuracy import (
    long_run as long_run,
)
from .accuracy import (
    predictability as predictability,
)
from .accuracy import (
    stability_map as stability_map,
)
from .accuracy import (
    work_precision as work_precision,
)
from .actuation import (
    Motor as Motor,
)
from .actuation import (
    Winches as Winches,
)
from .actuation import (
    to_force_density as to_force_density,
)
from .actuation import (
    to_rest_length as to_rest_length,
)
from .control import (
    LQR as LQR,
)
from .control import (
    MPC as MPC,
)
from .control import (
    NMPC as NMPC,
)
from .control import (
    FeedbackLinearization as FeedbackLinearization,
)
from .control import (
    FunctionController as FunctionController,
)
from .control import (
    OutputLimit as OutputLimit,
)
from .control import (
    clearance as clearance,
)
from .deploy import (
    generate_c as generate_c,
)
from .dynamics import (
    ElasticStrings as ElasticStrings,
)
from .dynamics import (
    Ground as Ground,
)
from .dynamics import (
    LinearStrings as LinearStrings,
)
from .dynamics import (
    Model as Model,
)
from .dynamics import (
    Profile as Profile,
)
from .estimation import (
    KalmanFilter as KalmanFilter,
)
from .estimation import (
    Sensors as Sensors,
)
from .plant import (
    OperatingPoint as OperatingPoint,
)
from .plant import (
    Reference as Reference,
)
from .plant import (
    controllability as controllability,
)
from .plant import (
    energy_weights as energy_weights,
)
from .plant import (
    equilibrium as equilibrium,
)
from .plant import (
    linearize as linearize,
)
from .plant import (
    modes as modes,
)
from .plant import (
    reduce as reduce,
)
from .robustness import (
    ClosedLoopCase as ClosedLoopCase,
)
from .robustness import (
    Normal as Normal,
)
from .robustness import (
    OneOf as OneOf,
)
from .robustness import (
    Uniform as Uniform,
)
from .robustness import (
    sweep as sweep,
)
from .scene import (
    load_scene as load_scene,
)
from .shape import (
    Height as Height,
)
from .shape import (
    NodesAt as NodesAt,
)
from .shape import (
    RotationalSymmetry as RotationalSymmetry,
)
from .shape import (
    Twist as Twist,
)
from .shape import (
    shape_path as shape_path,
)
from .shape import (
    shape_target as shape_target,
)
from .simulation import (
    CutString as CutString,
)
from .simulation import (
    HealthLimits as HealthLimits,
)
from .simulation import (
    Integration as Integration,
)
from .simulation import (
    LostMeasurement as LostMeasurement,
)
from .simulation import (
    Scene as Scene,
)
from .simulation import (
    StuckWinch as StuckWinch,
)
from .simulation import (
    load_run as load_run,
)
from .simulation import (
    simulate as simulate,
)
from .simulation import (
    simulate_many as simulate_many,
)
from .statics import (
    prestress as prestress,
)
from .structure import (
    Structure as Structure,
)
from .structure import (
    net as net,
)
from .structure import (
    prism as prism,
)
from .structure import (
    prism_tower as prism_tower,
)
from .structure import (
    skin as skin,
)
from .structure import (
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
    "LostMeasurement",
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
    "Structure",
    "StuckWinch",
    "Twist",
    "Uniform",
    "Winches",
    "__version__",
    "clearance",
    "controllability",
    "convergence_order",
    "energy_weights",
    "equilibrium",
    "generate_c",
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
    "shape_path",
    "shape_target",
    "simulate",
    "simulate_many",
    "skin",
    "stability_map",
    "subdivide",
    "sweep",
    "to_force_density",
    "to_rest_length",
    "work_precision",
]
