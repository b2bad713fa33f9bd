"""Error, run time and stability of integrators, measured on the user's own scene."""

from tenscontrol.accuracy.converged_motion import ConvergedMotion, converged_motion
from tenscontrol.accuracy.convergence import ConvergenceOrder, convergence_order
from tenscontrol.accuracy.long_run import Drift, LongRun, long_run
from tenscontrol.accuracy.measured_run import Measurement
from tenscontrol.accuracy.peers import Peer, Solution
from tenscontrol.accuracy.predictability import Predictability, predictability
from tenscontrol.accuracy.stability_map import StabilityMap, stability_map
from tenscontrol.accuracy.work_precision import Ratios, WorkPrecision, work_precision

__all__ = [
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
    "converged_motion",
    "convergence_order",
    "long_run",
    "predictability",
    "stability_map",
    "work_precision",
]
