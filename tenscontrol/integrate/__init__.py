"""Integrators: one a file, one interface."""

from tenscontrol.integrate.choose import Choice, choose
from tenscontrol.integrate.cvodes import CVODES
from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.integrate.energy_momentum import EnergyMomentum
from tenscontrol.integrate.integrator import IntegrationError, Integrator, Report, Span, Work
from tenscontrol.integrate.methods import METHODS, Method
from tenscontrol.integrate.radau import Radau
from tenscontrol.integrate.rattle import Rattle, Rattle4, Rattle6
from tenscontrol.integrate.rk4 import RK4

__all__ = [
    "CVODES",
    "DOP853",
    "METHODS",
    "RK4",
    "Choice",
    "EnergyMomentum",
    "IntegrationError",
    "Integrator",
    "Method",
    "Radau",
    "Rattle",
    "Rattle4",
    "Rattle6",
    "Report",
    "Span",
    "Work",
    "choose",
]
