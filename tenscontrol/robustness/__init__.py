"""Robustness: many runs of one case with parameters drawn at random."""

from tenscontrol.robustness.closed_loop import ClosedLoopCase
from tenscontrol.robustness.distance import farthest_node
from tenscontrol.robustness.distributions import Distribution, Normal, OneOf, Uniform
from tenscontrol.robustness.errors import SweepError
from tenscontrol.robustness.outcome import Outcome
from tenscontrol.robustness.report import SweepFailure, SweepReport
from tenscontrol.robustness.sweep import sweep

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
    "farthest_node",
    "sweep",
]
