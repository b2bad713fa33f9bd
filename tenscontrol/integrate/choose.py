"""The choice of a method for a scene."""

from __future__ import annotations

from dataclasses import dataclass

from tenscontrol.dynamics import Equation
from tenscontrol.integrate.scales import largest_frequency
from tenscontrol.validation import FloatArray

# The largest step of an explicit method is about this over the largest frequency.
_STABLE = 3.0

# More steps than this are left to the implicit method.
_MOST_STEPS = 2e5


@dataclass(frozen=True)
class Choice:
    """A method, its setting, and why.

    Attributes
    ----------
    method : str
    setting : {"step", "tolerance"}
        What its accuracy is set by.
    value : float
        The step, s, or the tolerance.
    reason : str
    back_end : str
        What runs the steps.
    """

    method: str
    setting: str
    value: float
    reason: str
    back_end: str = "virtual machine"


def choose(
    equation: Equation,
    state: FloatArray,
    held: FloatArray,
    duration: float,
    tolerance: float,
    step: float | None,
) -> Choice:
    """Return the method for a scene.

    Where the user gives a step, the method is RK4. Else it is the one of order
    8 with steps of its own, unless the fastest string would force it to far more
    steps than the motion needs: then the implicit one.

    Parameters
    ----------
    equation : Equation
    state : ndarray, shape (states,)
        x at the start.
    held : ndarray, shape (inputs,)
        u at the start.
    duration : float
        s.
    tolerance : float
    step : float or None
        s.

    Returns
    -------
    Choice
    """
    frequency = largest_frequency(equation, state, held)
    slack = "strings can go slack, each switch ends a step" if equation.switches else "no switches"
    scene = f"largest frequency {frequency:.3g} rad/s; {slack}"
    if step is not None:
        return Choice("rk4", "step", step, f"a step is given; {scene}")
    needed = frequency * duration / _STABLE
    if needed > _MOST_STEPS:
        return Choice(
            "energy_momentum",
            "tolerance",
            tolerance,
            f"{scene}: an explicit method would need {needed:.1e} steps",
        )
    return Choice("dop853", "tolerance", tolerance, scene)
