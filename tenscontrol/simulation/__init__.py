"""Open- and closed-loop simulation."""

from tenscontrol.simulation.arguments import Arguments
from tenscontrol.simulation.batch import Batch, BatchCrossings, simulate_many
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
from tenscontrol.simulation.observation import EstimateRecord
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.simulate import simulate
from tenscontrol.simulation.stepper import Stepper, StepperState
from tenscontrol.simulation.strength import Strength, strength
from tenscontrol.simulation.trajectory import Trajectory, load_run

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
    "StuckWinch",
    "Trajectory",
    "load_run",
    "simulate",
    "simulate_many",
    "strength",
]
