"""Controllers: LQR, MPC, nonlinear MPC, feedback linearization, gain schedules."""

from tenscontrol.control.controller import Command, Controller, energy_weights
from tenscontrol.control.feedback_linearization import (
    FeedbackLinearization,
    FeedbackLinearizationStatistics,
)
from tenscontrol.control.gain_schedule import GainSchedule
from tenscontrol.control.held_loop import HeldLoop, held_loop
from tenscontrol.control.lqr import LQR
from tenscontrol.control.mpc import (
    MPC,
    NMPC,
    MPCSettings,
    MPCStatistics,
    NMPCStatistics,
    OutputLimit,
    QPSolution,
    QPSolver,
    clearance,
)
from tenscontrol.control.status import UNSOLVED, ControlWarning, Fallback, Status

#: The name of :class:`LQR` in 0.1.
lqr = LQR

__all__ = [
    "LQR",
    "MPC",
    "NMPC",
    "UNSOLVED",
    "Command",
    "ControlWarning",
    "Controller",
    "Fallback",
    "FeedbackLinearization",
    "FeedbackLinearizationStatistics",
    "GainSchedule",
    "HeldLoop",
    "MPCSettings",
    "MPCStatistics",
    "NMPCStatistics",
    "OutputLimit",
    "QPSolution",
    "QPSolver",
    "Status",
    "clearance",
    "energy_weights",
    "held_loop",
    "lqr",
]
