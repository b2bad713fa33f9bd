"""Robustness studies by Monte Carlo: many runs of a case with random parameters."""

from tenscontrol.robustness.closed_loop_case import ClosedLoopCase, Outcome, farthest_node
from tenscontrol.robustness.distributions import Distribution, Normal, OneOf, Uniform
from tenscontrol.robustness.experiment_design import draws, grid
from tenscontrol.robustness.monte_carlo import sweep
from tenscontrol.robustness.sweep_report import SweepError, SweepFailure, SweepReport

__all__ = [
    "ClosedLoopCase",
    "Distribution",
    "Normal",
    "OneOf",
    "Outcome",
    "SweepError",
    "SweepFailure",
    "SweepReport",
    "Uniform",
    "draws",
    "farthest_node",
    "grid",
    "sweep",
]
