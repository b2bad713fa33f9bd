"""Open- and closed-loop simulation."""

from tenscontrol.simulation.batch import Batch, BatchCrossings, checked_controller, simulate_many
from tenscontrol.simulation.contacts import ContactRecord
from tenscontrol.simulation.faults import CutString, Fault, Faults, LostMeasurement, StuckWinch
from tenscontrol.simulation.health import (
    AccuracyWarning,
    BarCrossingWarning,
    ControlRecord,
    Given,
    Health,
    HealthLimits,
)
from tenscontrol.simulation.loop import SimulationError
from tenscontrol.simulation.observation import EstimateRecord
from tenscontrol.simulation.simulate import checked_load, initial_state, simulate
from tenscontrol.simulation.trajectory import Trajectory, load_run

__all__ = [
    "AccuracyWarning",
    "BarCrossingWarning",
    "Batch",
    "BatchCrossings",
    "ContactRecord",
    "ControlRecord",
    "CutString",
    "EstimateRecord",
    "Fault",
    "Faults",
    "Given",
    "Health",
    "HealthLimits",
    "LostMeasurement",
    "SimulationError",
    "StuckWinch",
    "Trajectory",
    "checked_controller",
    "checked_load",
    "initial_state",
    "load_run",
    "simulate",
    "simulate_many",
]
