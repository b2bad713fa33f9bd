"""Model predictive control, linear and nonlinear."""

from tenscontrol.control.mpc.clearance import clearance
from tenscontrol.control.mpc.constraints import OutputLimit
from tenscontrol.control.mpc.linear import MPC
from tenscontrol.control.mpc.mpc_statistics import MPCStatistics
from tenscontrol.control.mpc.nmpc_statistics import NMPCStatistics
from tenscontrol.control.mpc.nonlinear import NMPC

__all__ = ["MPC", "NMPC", "MPCStatistics", "NMPCStatistics", "OutputLimit", "clearance"]
