"""The integration methods by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tenscontrol.dynamics import Equation
from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.integrate.integrator import Integrator
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
    make : callable
        ``(equation, setting[, project]) -> Integrator``.
    """

    name: str
    setting: str
    about: str
    make: Callable[..., Integrator]
    drifts: bool = True
    projects: bool = False

    def integrator(
        self, equation: Equation, setting: float, project: bool | None = None
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

        Returns
        -------
        Integrator

        Raises
        ------
        ValueError
            If the method takes no such setting, or keeps bar lengths by itself
            and is told not to.
        """
        if not self.drifts:
            if project is False:
                raise ValueError(
                    f"project is False, but method {self.name!r} keeps bar lengths by itself; "
                    "leave project out"
                )
            return self.make(equation, setting)
        return self.make(equation, setting, self.projects if project is None else project)


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
)

#: Every method by its name.
METHODS: Mapping[str, Method] = MappingProxyType({method.name: method for method in _ALL})
