"""A path through equilibria laid out in time."""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np

from tenscontrol.shape.continuation import Continuation, Waypoint
from tenscontrol.shape.problem import ShapeProblem
from tenscontrol.shape.reading import Reading
from tenscontrol.shape.timing import Clock
from tenscontrol.statics import Prestress, prestress
from tenscontrol.validation import FloatArray

# More shapes than a step needs, for a clock that has to be slowed down; and what rounds off a rate.
_SPARE, _ROUND_OFF = 1.02, 1e-12


class PathError(ValueError):
    """No path through equilibria was found between two shapes.

    Attributes
    ----------
    reached : Prestress
        The last equilibrium on the way.
    """

    def __init__(self, message: str, reached: Prestress) -> None:
        super().__init__(message)
        self.reached = reached


class Timed:
    """A path laid out in time, each shape solved anew at its time.

    Parameters
    ----------
    way : Continuation
    waypoints : list of Waypoint
    rate : ndarray, shape () or (α,), or None
        Limit of the winches, m/s.
    duration : float or None
        s; the shortest that the winches allow if None.
    step : float
        Largest time between shapes, s.
    ramp : float
        Share of the duration.
    """

    def __init__(
        self,
        way: Continuation,
        waypoints: list[Waypoint],
        rate: FloatArray | None,
        duration: float | None,
        step: float,
        ramp: float,
    ) -> None:
        self._way, self._waypoints = way, waypoints
        reading = Reading(way.problem)
        places = np.array([point.place for point in waypoints])
        pace = np.array([reading.pace(point, rate) for point in waypoints])
        clock = Clock(places, pace, ramp)
        total = clock.shortest if duration is None else duration
        # A little more than needed: the clock is slowed down below.
        count = max(3, ceil(_SPARE * total / step) + 1)
        share = np.linspace(0.0, 1.0, count)
        at, speed = clock.at(share)
        points = self._solved(places, at)
        rows = [reading.motion(*pair) for pair in zip(points, speed, strict=True)]
        self.nodes, moves, self.force_density = (
            np.stack([r[i] for r in rows], -1) for i in (0, 1, 2)
        )
        self.rest_length: FloatArray | None = None
        self.rest_length_rate: FloatArray | None = None
        self.shortest: float | None = None
        if way.problem.model.strings is not None:
            self.rest_length, winding = (np.stack([r[i] for r in rows], -1) for i in (3, 4))
            if rate is not None:
                limit = np.broadcast_to(rate, (len(winding),))[:, None]
                jumps = np.diff(self.rest_length, axis=1) * (count - 1)
                fastest = [float((np.abs(each) / limit).max()) for each in (winding, jumps)]
                # Between waypoints the pace was a guess; this is what the shapes need.
                self.shortest = max(fastest) * (1 + _ROUND_OFF)
                if duration is not None and duration < self.shortest:
                    raise ValueError(
                        f"duration is {duration:g} s, expected at least {self.shortest:.6g} s: the "
                        "winches are not faster"
                    )
                total = self.shortest if duration is None else duration
            self.rest_length_rate = winding / total
        self.time = total * share
        self.velocities = moves / total
        self.residual = max(reading.unbalanced(point) for point in points)

    def _solved(self, places: FloatArray, at: FloatArray) -> list[Waypoint]:
        """Return equilibria at these places, from guesses between the waypoints."""
        from scipy.interpolate import CubicHermiteSpline

        values = np.array([point.values for point in self._waypoints])
        slopes = np.array([point.slope for point in self._waypoints])
        guesses = CubicHermiteSpline(places, values, slopes)(at)
        points = []
        for s, guess in zip(at.tolist(), guesses, strict=True):
            before = self._waypoints[int(np.searchsorted(places, s, side="right")) - 1]
            found = self._way.at(s, guess, before.multipliers)
            if found is None:
                raise PathError(
                    f"no equilibrium found {100 * s:.4g} % of the way to the goal, though there "
                    "are some before and after. Go by shapes in between",
                    rest_at(self._way.problem, before),
                )
            points.append(found)
        return points


def rest_at(problem: ShapeProblem, point: Waypoint) -> Prestress:
    """Return a waypoint as an equilibrium of the structure."""
    nodes, gamma = problem.read(point.values)
    structure = replace(problem.model.structure, nodes=nodes)
    gamma = np.maximum(gamma, 0.0)
    return prestress(structure, gamma, external_force=problem.model.constant_force)
