"""The integration methods by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tenscontrol.dynamics import Equation
from tenscontrol.integrate.cvodes import CVODES
from tenscontrol.integrate.dop853 import DOP853
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
    setting : {"step", "tolerance"}
        What its accuracy is set by.
    about : str
        What it is good for, one line.
    drifts : bool
        Whether bar lengths drift unless they are made exact after each step.
    projects : bool
        Whether they are, unless the user says otherwise.
    compiles : bool
        Whether its steps can be compiled.
    make : callable
        ``(equation, setting) -> Integrator``, with ``project`` and
        ``machine_code`` where it knows them.
    """

    name: str
    setting: str
    about: str
    make: Callable[..., Integrator]
    drifts: bool = True
    projects: bool = False
    compiles: bool = True

    def integrator(
        self,
        equation: Equation,
        setting: float,
        project: bool | None = None,
        machine_code: bool = False,
    ) -> Integrator:
        """Return the integrator.

        Parameters
        ----------
        equation : Equation
        setting : float
            Step, s, or tolerance.
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
        options: dict[str, bool] = {}
        if self.compiles:
            options["machine_code"] = machine_code
        if not self.drifts:
            if project is False:
                raise ValueError(
                    f"project is False, but method {self.name!r} keeps bar lengths by itself; "
                    "leave project out"
                )
        else:
            options["project"] = self.projects if project is None else project
        return self.make(equation, setting, **options)


_ALL = (
    Method("rk4", "step", "order 4, fixed steps", RK4),
    Method("rattle", "step", "order 2, symplectic, keeps bar lengths", Rattle, drifts=False),
    Method("rattle4", "step", "order 4, symplectic, keeps bar lengths", Rattle4, drifts=False),
    Method("rattle6", "step", "order 6, symplectic, keeps bar lengths", Rattle6, drifts=False),
    Method(
        "dop853",
        "tolerance",
        "order 8, own steps: smooth motions, high accuracy",
        DOP853,
        projects=True,
    ),
    Method(
        "radau",
        "tolerance",
        "order 5, implicit, own steps in Python: damped stiff strings, and to check others",
        Radau,
        projects=True,
        compiles=False,
    ),
    Method(
        "cvodes",
        "tolerance",
        "orders 1 to 5, implicit, own steps: damped stiff strings",
        CVODES,
        projects=True,
        compiles=False,
    ),
)

#: Every method by its name.
METHODS: Mapping[str, Method] = MappingProxyType({method.name: method for method in _ALL})
