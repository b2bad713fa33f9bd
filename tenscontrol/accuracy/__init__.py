"""Error, run time and stability of integrators, measured on the user's own scene."""

from tenscontrol.accuracy.case import Case, as_case
from tenscontrol.accuracy.compare import work_precision
from tenscontrol.accuracy.converged_motion import ConvergedMotion, converged_motion
from tenscontrol.accuracy.drift import Drift, LongRun, long_run
from tenscontrol.accuracy.growth import Predictability, predictability
from tenscontrol.accuracy.order import ConvergenceOrder, convergence_order
from tenscontrol.accuracy.peer import Peer, Solution
from tenscontrol.accuracy.ratios import Ratios
from tenscontrol.accuracy.result import WorkPrecision
from tenscontrol.accuracy.runs import Measurement
from tenscontrol.accuracy.stability import StabilityMap, stability_map

__all__ = [
    "Case",
    "ConvergedMotion",
    "ConvergenceOrder",
    "Drift",
    "LongRun",
    "Measurement",
    "Peer",
    "Predictability",
    "Ratios",
    "Solution",
    "StabilityMap",
    "WorkPrecision",
    "as_case",
    "converged_motion",
    "convergence_order",
    "long_run",
    "predictability",
    "stability_map",
    "work_precision",
]
