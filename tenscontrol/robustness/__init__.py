"""Robustness: many runs of one case with parameters drawn at random, or over the stiffness."""

from tenscontrol.robustness.closed_loop import ClosedLoopCase
from tenscontrol.robustness.distributions import Distribution, Normal, OneOf, Uniform
from tenscontrol.robustness.errors import SweepError
from tenscontrol.robustness.outcome import Outcome
from tenscontrol.robustness.report import SweepFailure, SweepReport
from tenscontrol.robustness.stiffness import stiffness_report
from tenscontrol.robustness.stiffness_report import (
    StiffnessReport,
    StiffnessRow,
    StiffnessRun,
)
from tenscontrol.robustness.sweep import sweep

__all__ = [
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
]
