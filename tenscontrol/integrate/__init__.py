"""Integrators: one a file, one interface."""

from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.integrate.integrator import IntegrationError, Integrator, Report, Span, Work
from tenscontrol.integrate.rk4 import RK4

__all__ = ["DOP853", "RK4", "IntegrationError", "Integrator", "Report", "Span", "Work"]
