"""Integrators: one interface; one a file, but the simplest, which is with the fixed steps."""

from tenscontrol.integrate.cvodes import CVODES
from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.integrate.energy_momentum import EnergyMomentum
from tenscontrol.integrate.fixed_step import RK4
from tenscontrol.integrate.integrator import (
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Integrator,
    MethodChange,
    Span,
    Work,
)
from tenscontrol.integrate.methods import Choice, Method
from tenscontrol.integrate.projection import Projector
from tenscontrol.integrate.watched import Watched

__all__ = [
    "CVODES",
    "DOP853",
    "RK4",
    "Choice",
    "EnergyMomentum",
    "IntegrationError",
    "IntegrationInterrupt",
    "IntegrationPause",
    "Integrator",
    "Method",
    "MethodChange",
    "Projector",
    "Span",
    "Watched",
    "Work",
]
