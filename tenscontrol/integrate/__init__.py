"""Integrators: one interface; one a file, but the simplest, which is with the fixed steps."""

from tenscontrol.integrate.cvodes import CVODES, is_expandable, jacobian_weight, state_jacobian
from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.integrate.energy_momentum import EnergyMomentum
from tenscontrol.integrate.fixed_step import RK4, FixedStep, not_finite
from tenscontrol.integrate.integrator import (
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Integrator,
    MethodChange,
    Report,
    Span,
    Work,
    contact_frequency,
    largest_frequency,
    state_scale,
)
from tenscontrol.integrate.lanes import Lanes
from tenscontrol.integrate.methods import METHODS, Choice, Method, choose, method_of
from tenscontrol.integrate.projection import Projector
from tenscontrol.integrate.watched import Watched

__all__ = [
    "CVODES",
    "DOP853",
    "METHODS",
    "RK4",
    "Choice",
    "EnergyMomentum",
    "FixedStep",
    "IntegrationError",
    "IntegrationInterrupt",
    "IntegrationPause",
    "Integrator",
    "Lanes",
    "Method",
    "MethodChange",
    "Projector",
    "Report",
    "Span",
    "Watched",
    "Work",
    "choose",
    "contact_frequency",
    "is_expandable",
    "jacobian_weight",
    "largest_frequency",
    "method_of",
    "not_finite",
    "state_jacobian",
    "state_scale",
]
