"""Open- and closed-loop simulation."""

from tenscontrol.simulation.loop import SimulationError
from tenscontrol.simulation.simulate import simulate
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory

__all__ = ["ControlRecord", "SimulationError", "Trajectory", "simulate"]
