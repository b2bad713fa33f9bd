"""Open- and closed-loop simulation."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from tenscontrol.simulation.arguments import Arguments
from tenscontrol.simulation.contacts import ContactRecord
from tenscontrol.simulation.control_record import ControlRecord
from tenscontrol.simulation.faults import CutString, Fault, LostMeasurement, StuckWinch
from tenscontrol.simulation.health import (
    AccuracyWarning,
    BarCrossingWarning,
    Health,
    HealthLimits,
    StrengthWarning,
)
from tenscontrol.simulation.health_check import SimulationError
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.simulate import simulate
from tenscontrol.simulation.strength import Strength, strength
from tenscontrol.simulation.strut_record import StrutRecord
from tenscontrol.simulation.trajectory import Trajectory, load_run

if TYPE_CHECKING:
    from tenscontrol.simulation.batch.simulate_many import Batch, BatchCrossings, simulate_many
    from tenscontrol.simulation.observation import EstimateRecord
    from tenscontrol.simulation.stepper import Stepper, StepperState

__all__ = [
    "AccuracyWarning",
    "Arguments",
    "BarCrossingWarning",
    "Batch",
    "BatchCrossings",
    "ContactRecord",
    "ControlRecord",
    "CutString",
    "EstimateRecord",
    "Fault",
    "Health",
    "HealthLimits",
    "Integration",
    "LostMeasurement",
    "Scene",
    "SimulationError",
    "Stepper",
    "StepperState",
    "Strength",
    "StrengthWarning",
    "StrutRecord",
    "StuckWinch",
    "Trajectory",
    "load_run",
    "simulate",
    "simulate_many",
    "strength",
]

# With controllers and estimators, which a run in open loop need not wait for.
_LATER = {
    "Batch": "batch",
    "BatchCrossings": "batch",
    "EstimateRecord": "observation",
    "Stepper": "stepper",
    "StepperState": "stepper",
    "simulate_many": "batch",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
