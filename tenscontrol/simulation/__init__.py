"""Open- and closed-loop simulation."""

from tenscontrol.simulation.simulate import SimulationError, simulate
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory

__all__ = ["ControlRecord", "SimulationError", "Trajectory", "simulate"]
