"""End of a planned motion: at rest in a shape, wherever supports let it be."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.coordinates import coordinates
from tenscontrol.dynamics.model import Model
from tenscontrol.optimize.collocation import Rows, stacked, zero
from tenscontrol.structure.supports import free_coordinates

# Entries of a combination of distances below this part of the largest are none.
_NONE = 1e-12


class MotionEnd:
    """Conditions of the end, as many as a motion can meet, and how far one is from it.

    Where supports leave no rigid-body motion, reduced coordinates are those of the goal. Elsewhere
    strings cannot turn or move the whole at will, so the end is a shape: combinations of distances
    of nodes, as many as there are internal coordinates.
    """

    def __init__(self, model: Model, goal: FloatArray, size: float, speed: float) -> None:
        self._structure, self._goal = model.structure, goal
        self._size, self._speed = size, speed
        self._frame = coordinates(model, goal, "internal")
        self.is_loose = self._frame.is_loose
        if self.is_loose and free_coordinates(model.structure, model.constant_force).any():
            raise ValueError(
                "model has loads, and its supports leave a motion as one body, along which nothing "
                "holds the structure at the end: fix more nodes, or leave the loads out"
            )
        n = goal.shape[1]
        self._pairs = np.column_stack(np.triu_indices(n, 1))

    def rows(self, places: Any, velocities: Any) -> Rows:
        """Return the conditions of places, m, and velocities, m/s, of what is free."""
        if self.is_loose:
            return self._shape_rows(places, velocities)
        rows = self._structure.free_rows
        project = self._frame.projection[:, rows]
        project = project / np.linalg.norm(project, axis=1, keepdims=True)
        P, goal = ca.sparsify(ca.DM(project)), free_coordinates(self._structure, self._goal)
        off = ca.mtimes(P, places - ca.DM(goal)) / self._size
        return stacked([zero(off, "goal"), zero(ca.mtimes(P, velocities) / self._speed, "rest")])

    def _shape_rows(self, places: Any, velocities: Any) -> Rows:
        structure = self._structure
        N = kernel.placed(structure, places, structure.nodes)
        V = kernel.placed(structure, velocities, np.zeros_like(structure.nodes))
        i, j = (column.tolist() for column in self._pairs.T)
        apart = self._goal[:, i] - self._goal[:, j]
        d, n = self._goal.shape
        slope = np.zeros((len(i), n, d))
        slope[np.arange(len(i)), i] = apart.T
        slope[np.arange(len(i)), j] = -apart.T
        along = np.linalg.qr(slope.reshape(len(i), n * d) @ self._frame.basis)[0].T
        along = np.where(np.abs(along) > _NONE * np.abs(along).max(), along, 0.0)
        Q = ca.sparsify(ca.DM(along))
        S, rates = N[:, i] - N[:, j], V[:, i] - V[:, j]
        squares = ca.sum1(S * S).T / 2 - ca.DM((apart**2).sum(axis=0) / 2)
        off = ca.mtimes(Q, squares) / self._size**2
        moved = ca.mtimes(Q, ca.sum1(S * rates).T) / (self._size * self._speed)
        return stacked([zero(off, "goal"), zero(moved, "rest")])

    def distance(self, nodes: FloatArray) -> float:
        """Return how far a node is from the goal at most, m."""
        if self.is_loose:
            nodes, _ = self._frame.laid_over(nodes, np.zeros_like(nodes))
        return float(np.linalg.norm(nodes - self._goal, axis=0).max())
