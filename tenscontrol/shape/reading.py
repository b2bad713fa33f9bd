"""What waypoints of a path mean: positions, forces, rest lengths, and their rates."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscontrol.dynamics import kernel
from tenscontrol.shape.continuation import Waypoint
from tenscontrol.shape.problem import ShapeProblem
from tenscontrol.validation import FloatArray


class Reading:
    """Positions, forces and rest lengths of waypoints, and their rates.

    Parameters
    ----------
    problem : ShapeProblem
    """

    def __init__(self, problem: ShapeProblem) -> None:
        self._problem = problem
        model = problem.model
        v, dv = problem.unknowns, ca.SX.sym("dv", problem.unknowns.numel())
        N, gamma = problem.nodes, problem.gamma
        rows = [ca.vec(ca.densify(N)), gamma]
        if model.strings is not None:
            S = kernel.differences(N, model.structure.strings)
            length = ca.sqrt(kernel.dots(S, S)).T
            rows.append(model.strings.taut_rest_length(length, gamma))
        rates = [ca.densify(ca.jtimes(row, v, dv)) for row in rows]
        self._read = ca.Function("read", [v, dv], [*rows, *rates])
        self._equations = ca.Function("equations", [v], [problem.equations])

    def motion(self, point: Waypoint, speed: float) -> list[FloatArray]:
        """Return nodes, velocities, γ, and rest lengths with their rates, at ds/dt."""
        parts = [np.array(part.full()).ravel() for part in self._read(point.values, point.slope)]
        half = len(parts) // 2
        nodes, moves = (part.reshape(3, -1, order="F") for part in (parts[0], parts[half]))
        found = [nodes, speed * moves, parts[1]]
        if half == 3:
            found += [parts[2], speed * parts[5]]
        return found

    def pace(self, point: Waypoint, rate: FloatArray | None) -> float:
        """Return the time that a unit of the path takes; without a rate, its length in space."""
        found = self.motion(point, 1.0)
        if rate is None:
            return float(np.linalg.norm(found[1], axis=0).max())
        return float((np.abs(found[4]) / rate).max())

    def unbalanced(self, point: Waypoint) -> float:
        """Return the largest unbalanced force, N."""
        problem = self._problem
        left = np.array(self._equations(point.values).full()).ravel()
        forces = left[: problem.positions.numel()]
        return float(np.abs(forces).max(initial=0.0) * problem.level * problem.size)
