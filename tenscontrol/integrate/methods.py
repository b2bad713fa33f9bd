"""The integration methods by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tenscontrol.dynamics import Equation
from tenscontrol.integrate.cvodes import CVODES
from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.integrate.energy_momentum import EnergyMomentum
from tenscontrol.integrate.integrator import Integrator
from tenscontrol.integrate.radau import Radau
from tenscontrol.integrate.rattle import Rattle, Rattle4, Rattle6
from tenscontrol.integrate.rk4 import RK4


@dataclass(frozen=True)
class Method:
    """An integration method as users know it.

    Attributes
    ----------
    name : str
        As in ``simulate(method=...)``.
    settings : tuple of {"step", "tolerance"}
        What its accuracy can be set by; the first is the usual one.
    about : str
        What it is good for, one line.
    make : callable
        ``(equation, step=... or tolerance=...) -> Integrator``, with
        ``project`` and ``machine_code`` where it knows them.
    drifts : bool
        Whether bar lengths drift unless they are made exact after each step.
    projects : bool
        Whether they are, unless the user says otherwise.
    compiles : bool
        Whether its steps can be compiled.
    differentiates : bool
        Whether it takes derivatives of the equation.
    """

    name: str
    settings: tuple[str, ...]
    about: str
    make: Callable[..., Integrator]
    drifts: bool = True
    projects: bool = False
    compiles: bool = True
    differentiates: bool = False

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
        machine_code: bool = False,
    ) -> Integrator:
        """Return the integrator.

        Parameters
        ----------
        equation : Equation
        value : float
            Step, s, or tolerance.
        setting : {"step", "tolerance"}, optional
            Which of the two it is; the usual one of the method if not given.
        project : bool, optional
            Whether to make bar lengths exact after each step; as
            :attr:`projects` if not given.
        machine_code : bool
            Whether to compile the steps, where the method can be compiled and
            there is a C compiler; :attr:`Integrator.back_end` says what came.

        Returns
        -------
        Integrator

        Raises
        ------
        ValueError
            If the method takes no such setting, or keeps bar lengths by itself
            and is told not to.
        """
        setting = self.setting if setting is None else setting
        if setting not in self.settings:
            raise ValueError(
                f"method {self.name!r} is set by {' or '.join(self.settings)}, found {setting}"
            )
        options: dict[str, float | bool] = {setting: value}
        if self.compiles:
            options["machine_code"] = machine_code
        if self.drifts:
            options["project"] = self.projects if project is None else project
        elif project is False:
            raise ValueError(
                f"project is False, but method {self.name!r} keeps bar lengths by itself; "
                "leave project out"
            )
        return self.make(equation, **options)


_ALL = (
    Method("rk4", ("step",), "order 4, fixed steps; bar lengths drift", RK4),
    Method("rattle", ("step",), "order 2, symplectic, fixed steps", Rattle, drifts=False),
    Method(
        "rattle4", ("step",), "order 4, symplectic, fixed steps; no damping", Rattle4, drifts=False
    ),
    Method(
        "rattle6",
        ("step",),
        "order 6, symplectic, fixed steps; no damping: the fastest",
        Rattle6,
        drifts=False,
    ),
    Method(
        "dop853",
        ("tolerance",),
        "order 8, steps of its own: accuracy on demand",
        DOP853,
        projects=True,
    ),
    Method(
        "radau",
        ("tolerance",),
        "order 5, implicit, steps of its own in Python: stiff damped strings, and to check others",
        Radau,
        projects=True,
        compiles=False,
        differentiates=True,
    ),
    Method(
        "cvodes",
        ("tolerance",),
        "orders 1 to 5, implicit, steps of its own: stiff damped strings",
        CVODES,
        projects=True,
        compiles=False,
        differentiates=True,
    ),
    Method(
        "energy_momentum",
        ("step", "tolerance"),
        "order 2, implicit, conserves energy and momenta: stiff strings, slow motion",
        EnergyMomentum,
        drifts=False,
        compiles=False,
        differentiates=True,
    ),
)

#: Every method by its name.
METHODS: Mapping[str, Method] = MappingProxyType({method.name: method for method in _ALL})
