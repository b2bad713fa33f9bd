"""Error of a simulation that stopped before its end."""

from __future__ import annotations

from tenscontrol.simulation.trajectory import Trajectory


class SimulationError(ArithmeticError):
    """A simulation that stopped before its end; it carries the motion up to there.

    Attributes
    ----------
    trajectory : Trajectory
        The motion up to the time of the failure.
    """

    def __init__(self, message: str, trajectory: Trajectory) -> None:
        super().__init__(message)
        self.trajectory = trajectory
