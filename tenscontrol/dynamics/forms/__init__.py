"""Forms of the state equation for large scenes."""

from tenscontrol.dynamics.forms.loops import loops_equation, loops_source
from tenscontrol.dynamics.forms.mapped import mapped_equation

__all__ = ["loops_equation", "loops_source", "mapped_equation"]
