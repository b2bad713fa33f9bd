"""Controllers: LQR and MPC behind one face."""

from tenscontrol.control.controller import Command, Controller
from tenscontrol.control.lqr import LQR, lqr
from tenscontrol.control.mpc import MPC, MPCStatistics
from tenscontrol.control.reference import Reference
from tenscontrol.control.weights import energy_weights

__all__ = [
    "LQR",
    "MPC",
    "Command",
    "Controller",
    "MPCStatistics",
    "Reference",
    "energy_weights",
    "lqr",
]
