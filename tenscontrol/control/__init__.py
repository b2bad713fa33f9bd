"""Controllers: LQR, MPC, nonlinear MPC, feedback linearization, functions."""

from tenscontrol.control.command import Command, ControlWarning, Fallback
from tenscontrol.control.controller import BaseController, Controller
from tenscontrol.control.feedback_linearization import (
    FeedbackLinearization,
    FeedbackLinearizationStatistics,
)
from tenscontrol.control.function_controller import FunctionController
from tenscontrol.control.held_loop import HeldLoop, held_loop
from tenscontrol.control.linear_controller import LinearController
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
    QuadraticProgram,
    buckling,
    clearance,
)
from tenscontrol.status import Status

__all__ = [
    "LQR",
    "MPC",
    "NMPC",
    "BaseController",
    "Command",
    "ControlWarning",
    "Controller",
    "Fallback",
    "FeedbackLinearization",
    "FeedbackLinearizationStatistics",
    "FunctionController",
    "HeldLoop",
    "LinearController",
    "MPCSettings",
    "MPCStatistics",
    "NMPCStatistics",
    "OutputLimit",
    "QPSolution",
    "QPSolver",
    "QuadraticProgram",
    "Status",
    "buckling",
    "clearance",
    "held_loop",
]
