"""Interface of an integrator of another package, to be compared with our methods."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.integrate.integrator import steps_between
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.scene import Scene


@dataclass(frozen=True, eq=False)
class Solution:
    """A motion computed by an integrator.

    Attributes
    ----------
    nodes : ndarray, shape (d, n, T)
        Positions of all nodes at the output times, m.
    velocities : ndarray, shape (d, n, T), or None
        m/s; None where the package does not give them.
    evaluations : int
        Evaluations of the forces; 0 where the package does not count them.
    """

    nodes: FloatArray
    velocities: FloatArray | None
    evaluations: int

    __repr__ = short_repr


class Peer(ABC):
    """An integrator of another package.

    A run that cannot go on raises ``ArithmeticError``, ``ValueError`` or
    ``RuntimeError`` with the reason; it is kept in the result as a failed run.
    """

    #: As tables and figures show it.
    name: str

    #: Steps, s, or tolerances, from coarse to fine: one run for each.
    settings: tuple[float, ...]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"

    def refuse(self, case: Scene) -> str | None:
        """Return why this case is beyond the peer, or None.

        Parameters
        ----------
        case : Scene

        Returns
        -------
        str or None
            For example that its package is not installed; None unless overridden.
        """
        return None

    def own_law(self, case: Scene) -> str | None:
        """Return in what forces the peer differs from the case, or None where they are the same.

        Where it does, its errors are measured against its own motion at a much finer setting.

        Parameters
        ----------
        case : Scene

        Returns
        -------
        str or None
            None unless overridden.
        """
        return None

    @abstractmethod
    def prepare(self, case: Scene, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """Build all that is built once, and return what runs the case.

        Only the returned call is timed, so it does the integration and nothing
        else; each call starts anew from the start of the case.

        Parameters
        ----------
        case : Scene
        setting : float
            One of ``settings``: a step, s, or a tolerance.
        times : ndarray, shape (T,)
            Output times, s: equally spaced, the first one spacing after 0,
            the last at ``case.duration``.

        Returns
        -------
        callable
            ``() -> Solution`` at these times.
        """


def spaced(times: FloatArray, step: float) -> tuple[float, int]:
    """Return spacing of outputs, s, and steps between them; refuse more than are done in a day."""
    spacing = float(times[-1]) / len(times)
    inner = steps_between(spacing, step)
    asked = f"setting is {step:g} s and times end at {times[-1]:g} s"
    validation.refuse_time(asked, inner * len(times), "steps", 5e-5)
    return spacing, inner


def peer_settings(settings: object) -> tuple[float, ...]:
    """Return the settings of a peer, or refuse what is no sequence of positive numbers."""
    numbers = validation.float_array(
        "settings", validation.items("settings", settings, "steps, s, or tolerances")
    )
    if numbers.ndim != 1:
        raise ValueError(f"settings has shape {numbers.shape}, expected (k,)")
    return tuple(validation.positive("settings", numbers, "step, s, or tolerance").tolist())


def checked_run(case: Scene, setting: float, times: object) -> tuple[float, FloatArray]:
    """Return setting and output times of a run, or refuse what does not fit."""
    validation.instance("case", case, Scene, "make one by Scene(model, duration, ...)")
    outputs = validation.positive("times", validation.float_array("times", times), "time in s")
    if outputs.ndim != 1 or outputs.size == 0 or (np.diff(outputs) <= 0).any():
        raise ValueError("times does not rise, expected shape (T,): equally spaced output times")
    return validation.positive_number("setting", setting, "s or 1"), outputs
