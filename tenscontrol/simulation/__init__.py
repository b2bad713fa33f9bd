"""Open- and closed-loop simulation."""

from tenscontrol.simulation.health import AccuracyWarning, Health, Limits
from tenscontrol.simulation.loop import SimulationError
from tenscontrol.simulation.simulate import simulate
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory

__all__ = [
    "AccuracyWarning",
    "ControlRecord",
    "Health",
    "Limits",
    "SimulationError",
    "Trajectory",
    "simulate",
]
