"""Control-oriented modelling of tensegrity structures.

Each name is imported when it is first used, so that ``import tenscontrol``
loads neither scipy, control, osqp nor matplotlib.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from tenscontrol._version import __version__

if TYPE_CHECKING:
    from tenscontrol.accuracy import (
        Case,
        ConvergedMotion,
        ConvergenceOrder,
        Drift,
        LongRun,
        Measurement,
        Predictability,
        Ratios,
        StabilityMap,
        WorkPrecision,
        converged_motion,
        convergence_order,
        long_run,
        predictability,
        stability_map,
        work_precision,
    )
    from tenscontrol.actuation import (
        RestLengths,
        Winches,
        WinchMove,
        to_force_density,
        to_rest_length,
    )
    from tenscontrol.analysis import (
        Controllability,
        LinearPlant,
        Modes,
        OperatingPoint,
        command_parents,
        controllability,
        equilibrium,
        in_coordinates,
        linearize,
        modes,
    )
    from tenscontrol.control import (
        LQR,
        MPC,
        NMPC,
        Command,
        Controller,
        HeldLoop,
        MPCStatistics,
        NMPCStatistics,
        OutputLimit,
        Reference,
        Schedule,
        ShapeControl,
        ShapeControlStatistics,
        bars_apart,
        energy_weights,
        held_loop,
        lqr,
    )
    from tenscontrol.deploy import CompiledController, GeneratedController, generate_c
    from tenscontrol.dynamics import (
        Coordinates,
        ElasticStrings,
        LinearStrings,
        Model,
        StringLaw,
        coordinates,
    )
    from tenscontrol.estimation import (
        Estimate,
        FilterStatistics,
        KalmanFilter,
        Sensors,
        kalman,
    )
    from tenscontrol.integrate import Choice, Work
    from tenscontrol.robustness import (
        ClosedLoopCase,
        Distribution,
        Normal,
        OneOf,
        Outcome,
        StiffnessReport,
        StiffnessRow,
        StiffnessRun,
        SweepError,
        SweepFailure,
        SweepReport,
        Uniform,
        stiffness_report,
        sweep,
    )
    from tenscontrol.scene import Scene, SceneError, load_scene
    from tenscontrol.shape import (
        Demand,
        DemandCheck,
        Height,
        NodesAt,
        PathError,
        PointAt,
        RotationalSymmetry,
        ShapeError,
        ShapePath,
        ShapeTarget,
        Twist,
        shape_path,
        shape_target,
    )
    from tenscontrol.simulation import (
        AccuracyWarning,
        ControlRecord,
        CutString,
        EstimateRecord,
        Fault,
        Health,
        Limits,
        LostMeasurement,
        SimulationError,
        StuckWinch,
        Trajectory,
        simulate,
    )
    from tenscontrol.statics import (
        Prestress,
        Stability,
        equilibrium_matrix,
        prestress,
        prism_force_density,
        stress_matrix,
    )
    from tenscontrol.structure import (
        Structure,
        net,
        prism,
        prism_radius,
        prism_tower,
        restore_bar_lengths,
        segment_counts,
        skin,
        skin_rest_length,
        spread_force_density,
        spread_rest_length,
        subdivide,
    )

_HOME = {
    "accuracy": [
        "Case",
        "ConvergedMotion",
        "ConvergenceOrder",
        "Drift",
        "LongRun",
        "Measurement",
        "Predictability",
        "Ratios",
        "StabilityMap",
        "WorkPrecision",
        "converged_motion",
        "convergence_order",
        "long_run",
        "predictability",
        "stability_map",
        "work_precision",
    ],
    "actuation": ["RestLengths", "WinchMove", "Winches", "to_force_density", "to_rest_length"],
    "analysis": [
        "Controllability",
        "LinearPlant",
        "Modes",
        "OperatingPoint",
        "command_parents",
        "controllability",
        "equilibrium",
        "in_coordinates",
        "linearize",
        "modes",
    ],
    "control": [
        "LQR",
        "MPC",
        "NMPC",
        "Command",
        "Controller",
        "HeldLoop",
        "MPCStatistics",
        "NMPCStatistics",
        "OutputLimit",
        "Reference",
        "ShapeControl",
        "ShapeControlStatistics",
        "Schedule",
        "bars_apart",
        "energy_weights",
        "held_loop",
        "lqr",
    ],
    "deploy": ["CompiledController", "GeneratedController", "generate_c"],
    "dynamics": [
        "Coordinates",
        "ElasticStrings",
        "LinearStrings",
        "Model",
        "StringLaw",
        "coordinates",
    ],
    "estimation": ["Estimate", "FilterStatistics", "KalmanFilter", "Sensors", "kalman"],
    "integrate": ["Choice", "Work"],
    "robustness": [
        "ClosedLoopCase",
        "Distribution",
        "Normal",
        "OneOf",
        "Outcome",
        "StiffnessReport",
        "StiffnessRow",
        "StiffnessRun",
        "SweepError",
        "SweepFailure",
        "SweepReport",
        "Uniform",
        "stiffness_report",
        "sweep",
    ],
    "scene": ["Scene", "SceneError", "load_scene"],
    "simulation": [
        "AccuracyWarning",
        "ControlRecord",
        "CutString",
        "Fault",
        "EstimateRecord",
        "Health",
        "Limits",
        "LostMeasurement",
        "SimulationError",
        "StuckWinch",
        "Trajectory",
        "simulate",
    ],
    "shape": [
        "Demand",
        "DemandCheck",
        "Height",
        "NodesAt",
        "PathError",
        "PointAt",
        "RotationalSymmetry",
        "ShapeError",
        "ShapePath",
        "ShapeTarget",
        "Twist",
        "shape_path",
        "shape_target",
    ],
    "structure": [
        "Structure",
        "net",
        "prism",
        "prism_radius",
        "prism_tower",
        "restore_bar_lengths",
        "segment_counts",
        "skin",
        "skin_rest_length",
        "spread_force_density",
        "spread_rest_length",
        "subdivide",
    ],
    "statics": [
        "Prestress",
        "Stability",
        "equilibrium_matrix",
        "prestress",
        "prism_force_density",
        "stress_matrix",
    ],
}
_FOLDER = {name: folder for folder, names in _HOME.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _FOLDER:
        return getattr(importlib.import_module(f"tenscontrol.{_FOLDER[name]}"), name)
    if name in _HOME or name == "plot":
        return importlib.import_module(f"tenscontrol.{name}")
    raise AttributeError(f"module 'tenscontrol' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_HOME, "plot"])


__all__ = ["__version__", *sorted(_FOLDER)]
