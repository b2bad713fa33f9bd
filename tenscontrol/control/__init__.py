"""Controllers: LQR and MPC behind one face."""

from tenscontrol.control.bars_apart import bars_apart
from tenscontrol.control.constraints import OutputLimit
from tenscontrol.control.controller import Command, Controller
from tenscontrol.control.held_loop import HeldLoop, held_loop
from tenscontrol.control.lqr import LQR, lqr
from tenscontrol.control.mpc import MPC
from tenscontrol.control.mpc_statistics import MPCStatistics
from tenscontrol.control.nmpc import NMPC
from tenscontrol.control.nmpc_statistics import NMPCStatistics
from tenscontrol.control.reference import Reference
from tenscontrol.control.schedule import Schedule
from tenscontrol.control.shape_control import ShapeControl
from tenscontrol.control.shape_statistics import ShapeControlStatistics
from tenscontrol.control.weights import energy_weights

__all__ = [
    "LQR",
    "MPC",
    "NMPC",
    "Command",
    "Controller",
    "HeldLoop",
    "MPCStatistics",
    "NMPCStatistics",
    "OutputLimit",
    "Reference",
    "Schedule",
    "ShapeControl",
    "ShapeControlStatistics",
    "bars_apart",
    "energy_weights",
    "held_loop",
    "lqr",
]
