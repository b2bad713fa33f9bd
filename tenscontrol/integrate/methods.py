"""The integration methods by name, and the choice of one for a scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import Equation
from tenscontrol.integrate.cvodes import CVODES
from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.integrate.energy_momentum import EnergyMomentum
from tenscontrol.integrate.fixed_step import RK4, PlainRK4
from tenscontrol.integrate.integrator import (
    Integrator,
    MethodChange,
    contact_frequency,
    largest_frequency,
)
from tenscontrol.short_repr import short_repr

# The largest step of an explicit method is about this over the largest frequency.
_STABLE = 3.0

# More steps than this are left to the implicit method.
_MOST_STEPS = 2e5


@dataclass(frozen=True)
class Method:
    """An integration method: its class, and what can be set.

    ``simulate(method=...)`` takes the name of one of :data:`METHODS`, or a record like this of
    an :class:`Integrator` of your own.

    Attributes
    ----------
    name : str
    settings : tuple of {"step", "tolerance"}
        What its accuracy can be set by; the first is the usual one.
    about : str
        What it is good for, one line.
    make : callable
        ``(equation, step=... or tolerance=...) -> Integrator``, with
        ``project`` where bar lengths drift.
    drifts : bool
        Whether bar lengths drift unless they are made exact after each step.
    projects : bool
        Whether they are, unless the user says otherwise.
    differentiates : bool
        Whether it takes derivatives of the equation.
    follows : bool
        Whether it integrates inputs that change within a step: it asks :meth:`Equation.ahead` for
        the input at each time within it. Else profiles and moving supports are refused.
    locates : bool
        Whether steps end where a string or a contact switches.
    order : int
        Order of convergence, as far as the estimate of the error may count on it.
    """

    name: str
    settings: tuple[str, ...]
    about: str
    make: Callable[..., Integrator]
    drifts: bool = True
    projects: bool = False
    differentiates: bool = False
    follows: bool = False
    locates: bool = True
    order: int = 1

    __repr__ = short_repr

    def __post_init__(self) -> None:
        validation.text("name", self.name, "what the method is called")
        validation.text("about", self.about, "what the method is good for")
        if not isinstance(self.settings, tuple) or not self.settings:
            raise validation.wrong_kind(
                "settings", self.settings, "a tuple of 'step' and 'tolerance'"
            )
        for i, setting in enumerate(self.settings):
            validation.choice(f"settings[{i}]", setting, ("step", "tolerance"))
        validation.function(
            "make", self.make, "(equation, step=... or tolerance=...) -> Integrator"
        )
        for name in ("drifts", "projects", "differentiates", "follows", "locates"):
            validation.truth(name, getattr(self, name), "what the method does")
        validation.whole_number("order", self.order, 1)

    @property
    def setting(self) -> str:
        """What its accuracy is usually set by: ``"step"`` or ``"tolerance"``."""
        return self.settings[0]

    def integrator(
        self,
        equation: Equation,
        value: float,
        setting: str | None = None,
        project: bool | None = None,
    ) -> Integrator:
        """Return the integrator.

        Parameters
        ----------
        equation : Equation
        value : float
            Step, s, or tolerance.
        setting : {"step", "tolerance"}, optional
            Which of the two; the usual one of the method if not given.
        project : bool, optional
            Whether to make bar lengths exact after each step; as :attr:`projects` if not given.

        Raises
        ------
        ValueError
            If the method takes no such setting, or keeps bar lengths by itself and is told not to.
        """
        setting = (
            self.setting
            if setting is None
            else validation.choice("setting", setting, self.settings)
        )
        options: dict[str, float | bool] = {setting: value}
        if project is not None:
            validation.truth(
                "project", project, "whether to make bar lengths exact after each step"
            )
        if self.drifts:
            options["project"] = self.projects if project is None else project
        elif project is False:
            raise ValueError(
                f"project is False, but method {self.name!r} keeps bar lengths by itself; "
                "leave project out"
            )
        return self.make(equation, **options)


_STEP, _TOLERANCE = ("step",), ("tolerance",)
_ALL = (
    Method("rk4", _STEP, "order 4, fixed steps: real time and batches", RK4, follows=True, order=4),
    Method(
        "rk4_plain",
        _STEP,
        "the same through switches, order 1 there: coarse steps, at half the work",
        PlainRK4,
        follows=True,
        locates=False,
    ),
    Method(
        "dop853",
        _TOLERANCE,
        "order 8, steps of its own: accuracy on demand",
        DOP853,
        projects=True,
        follows=True,
        order=8,
    ),
    Method(
        "cvodes",
        _TOLERANCE,
        "orders 1 to 5, implicit, steps of its own: stiff damped strings",
        CVODES,
        projects=True,
        differentiates=True,
        follows=True,
        order=5,
    ),
    Method(
        "energy_momentum",
        _STEP + _TOLERANCE,
        "order 2, implicit, conserves energy and momenta: stiff strings, long runs",
        EnergyMomentum,
        drifts=False,
        differentiates=True,
        follows=True,
        locates=False,
        order=2,
    ),
)

#: Every method by its name.
METHODS: Mapping[str, Method] = MappingProxyType({method.name: method for method in _ALL})


def method_of(method: object) -> Method | None:
    """Return a method by its name, or as it is given; None for ``"auto"``."""
    if type(method) is str and method == "auto":
        return None
    if isinstance(method, Method):
        return method
    return METHODS.get(validation.choice("method", method, ("auto", *METHODS)))


@dataclass(frozen=True)
class Choice:
    """A method, its setting, and why.

    Attributes
    ----------
    method : str
        The one that the run began with.
    setting : {"step", "tolerance"}
        What its accuracy is set by.
    value : float
        The step, s, or the tolerance.
    reason : str
    back_end : str
        What runs the steps.
    changes : tuple of MethodChange
        Other methods that went on, from when and why. Only ``"auto"`` goes on with another one.
    """

    method: str
    setting: str
    value: float
    reason: str
    back_end: str = "virtual machine"
    changes: tuple[MethodChange, ...] = ()

    __repr__ = short_repr

    @property
    def methods(self) -> tuple[str, ...]:
        """All methods of the run, in the order in which they were at work."""
        return (self.method, *(change.method for change in self.changes))


def choose(
    equation: Equation,
    state: FloatArray,
    held: FloatArray,
    duration: float,
    tolerance: float,
    step: float | None,
) -> Choice:
    """Return the method to begin with for a scene.

    Where the user gives a step, the method is RK4. Else it is the one of order 8 with steps of its
    own, unless the fastest string would force it to far more steps than the motion needs: then the
    implicit one, or CVODES where bars are driven, which the implicit one does not take. The ground
    does so only while something touches it, which is not known before.
    """
    strings = largest_frequency(equation, state, held)
    ground = contact_frequency(equation, state, held)
    frequency, where = max(strings, ground), " (ground)" if ground > strings else ""
    slack = "strings can go slack, each switch ends a step" if equation.switches else "no switches"
    if ground and equation.law is None:
        slack = "contacts open and close, each switch ends a step"
    elif ground:
        slack = "strings can go slack and contacts open, each switch ends a step"
    scene = f"largest frequency {frequency:.3g} rad/s{where}; {slack}"
    if step is not None:
        if where and step * ground > _STABLE:
            scene += f", and steps follow the ground up to {_STABLE / ground:.1g} s only"
        return Choice("rk4", "step", step, f"a step is given; {scene}")
    needed = strings * duration / _STABLE
    if needed > _MOST_STEPS:
        return Choice(
            "cvodes" if equation.layout.lengths else "energy_momentum",
            "tolerance",
            tolerance,
            f"{scene}: an explicit method would need {needed:.1e} steps",
        )
    return Choice("dop853", "tolerance", tolerance, scene)
