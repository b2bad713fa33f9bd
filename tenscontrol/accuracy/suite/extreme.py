"""One case of the suite, and the settings at which its methods run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.integrate import METHODS, largest_frequency
from tenscontrol.validation import FloatArray

#: Error that a method is asked for, as part of the size of the structure.
ASKED = 1e-3

#: Tolerance of the methods that choose their steps: error allowed a step.
TOLERANCE = 1e-6

# The method that takes either, with a step.
_STEPPED = "energy_momentum, step"

# Steps of the others as angles that the fastest motion turns through, rad: higher orders do more
# in a step. And about how many evaluations a step takes.
_ANGLES = {"rk4": 0.1, "rattle": 0.02, "rattle4": 0.2, "rattle6": 0.4, _STEPPED: 0.03}
_EVALUATIONS = {"rk4": 4, "rattle": 1, "rattle4": 4, "rattle6": 14, _STEPPED: 8}

# About how many evaluations the others take for a radian of the fastest motion, where they follow
# it. The energy-momentum method by tolerance does not follow what is smaller than its tolerance.
_BY_RADIAN = {"dop853": 4.0, "cvodes": 20.0}

# What an evaluation of this costs, by that of the explicit ones: it solves linear systems.
_COST = {_STEPPED: 3.0}

# Nodes for which the budget is meant.
_NODES = 6


@dataclass(frozen=True, eq=False)
class Extreme:
    """A motion with something extreme about it.

    Attributes
    ----------
    group, label : str
        What is extreme, and how much: ``"string stiffness"``, ``"1e9 N/m"``.
    case : Case
    longer : float
        How many times too long the fixed steps are.
    outputs : int
        Number of equally spaced times at which motions are compared.
    turning : float
        Largest speed of turning, rad/s, which steps must follow too.
    budget : float
        Evaluations of a prism by explicit methods that a run may cost; above, it is not run.
    closed_form : callable or None
        ``time -> nodes`` of shape (3, n, T), m, where the motion is known.
    """

    group: str
    label: str
    case: Case
    longer: float = 1.0
    outputs: int = 100
    turning: float = 0.0
    budget: float = 3e5
    closed_form: Callable[[FloatArray], FloatArray] | None = None

    @property
    def name(self) -> str:
        """Group and label."""
        return f"{self.group}: {self.label}"

    @property
    def time(self) -> FloatArray:
        """The times at which motions are compared, s, shape (outputs,)."""
        return self.case.duration * np.arange(1, self.outputs + 1) / self.outputs

    @cached_property
    def frequency(self) -> float:
        """Largest of the frequencies of the strings and the speeds of turning, rad/s."""
        case = self.case
        strings = 0.0
        if len(case.structure.strings):
            strings = largest_frequency(case.equation(), case.state, case.value)
        return float(max(strings, self.turning, 1.0 / case.duration))

    @property
    def angle(self) -> float:
        """What the fastest motion turns through in all, rad."""
        return self.frequency * self.case.duration

    def settings(self, method: str) -> dict[str, float]:
        """Return what ``simulate`` is given for a method.

        Parameters
        ----------
        method : str
            One of :func:`methods`.

        Returns
        -------
        dict
            ``step`` or ``tolerance``.
        """
        if method in _ANGLES:
            return {"step": self.longer * _ANGLES[method] / self.frequency}
        return {"tolerance": TOLERANCE}

    def evaluations(self, method: str) -> float:
        """Return about how many evaluations of the forces a method needs, at most.

        Parameters
        ----------
        method : str
            One of :func:`methods`.

        Returns
        -------
        float
            0 for a method that need not follow the fastest motion.
        """
        if method in _ANGLES:
            return _EVALUATIONS[method] * self.angle / (self.longer * _ANGLES[method])
        return _BY_RADIAN.get(method, 0.0) * self.angle

    def allowed(self, method: str) -> float:
        """Return how many evaluations a method may take.

        Parameters
        ----------
        method : str
            One of :func:`methods`.

        Returns
        -------
        float
        """
        larger: float = max(1.0, self.case.nodes.shape[1] / _NODES)
        return self.budget / (_COST.get(method, 1.0) * larger)


def methods() -> tuple[str, ...]:
    """Return the names of what the suite runs: every method, and the automatic choice.

    Returns
    -------
    tuple of str
    """
    return (*METHODS, _STEPPED, "auto")
