"""Nodes seen as bodies: the centre and the vector of every bar, and the string nodes."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscontrol.dynamics.kernel import Symbolic, scale_columns
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, IntArray


class Bodies:
    """The map between free nodes and bodies, the same for positions, velocities and forces.

    *Points* are the centres of the bars with two free ends, then the string
    nodes. *Vectors* are those of the bars with two free ends, then of the bars
    that swing, from the fixed to the free end. Bars with both ends fixed do
    not move and are left out. In these coordinates the mass matrix is
    diagonal: m, m_s, m/12 and m/3. Expressions may be SX or MX, one column per
    node, point or vector.

    Parameters
    ----------
    structure : Structure
    """

    def __init__(self, structure: Structure) -> None:
        def columns(nodes: IntArray) -> list[int]:
            """Places of free nodes in the state."""
            return [int(i) for i in np.searchsorted(structure.free, nodes)]

        free, swinging = structure.free_bars, structure.swinging_bars
        start, end = structure.bars[free].T
        hinge, tip = structure.hinged_pairs.T
        self._start, self._end, self._tip = columns(start), columns(end), columns(tip)
        self._string_nodes = columns(structure.string_nodes)
        self._order = np.argsort(
            self._start + self._end + self._tip + self._string_nodes, kind="stable"
        ).tolist()
        self.hinges = ca.DM(structure.nodes[:, hinge])
        mass, hinged_mass = structure.bar_mass[free], structure.bar_mass[swinging]
        self.length = _row(structure.bar_length[np.concatenate([free, swinging])])
        self._centre_mass = _row(mass)
        self._point_mass = _row(structure.string_node_mass)
        self._vector_mass = _row(mass / 6)
        self._tip_mass = _row(hinged_mass / 3)

    def split(self, nodes: Symbolic, hinges: Symbolic = 0) -> tuple[Symbolic, Symbolic]:
        """Return points and vectors, shape (3, ·) each, of positions or velocities.

        Parameters
        ----------
        nodes : casadi.SX or MX, shape (3, n)
            Free nodes.
        hinges : casadi.DM, optional
            :attr:`hinges` for positions; nothing for velocities, of which hinges have none.
        """
        start, end = nodes[:, self._start], nodes[:, self._end]
        points = ca.horzcat((start + end) / 2, nodes[:, self._string_nodes])
        return points, ca.horzcat(end - start, nodes[:, self._tip] - hinges)

    def join(self, points: Symbolic, vectors: Symbolic, hinges: Symbolic = 0) -> Symbolic:
        """Return free nodes, shape (3, n), of points and vectors: :meth:`split` undone."""
        bars = len(self._start)
        centre, half = points[:, :bars], vectors[:, :bars] / 2
        blocks = centre - half, centre + half, vectors[:, bars:] + hinges, points[:, bars:]
        return ca.horzcat(*blocks)[:, self._order]

    def accelerations(self, forces: Symbolic) -> tuple[Symbolic, Symbolic]:
        """Return how forces on the free nodes accelerate points and vectors, bar forces left out.

        ``r̈ = (f_start + f_end)/m`` (eq. 4), ``b̈ = 6/m (f_end − f_start)``
        (eq. 5 with λ = 0), and 3/m times its force for the tip of a bar that swings.
        """
        start, end = forces[:, self._start], forces[:, self._end]
        points = ca.horzcat(
            scale_columns(start + end, 1 / self._centre_mass),
            scale_columns(forces[:, self._string_nodes], 1 / self._point_mass),
        )
        vectors = ca.horzcat(
            scale_columns(end - start, 1 / self._vector_mass),
            scale_columns(forces[:, self._tip], 1 / self._tip_mass),
        )
        return points, vectors


def _row(values: FloatArray) -> ca.DM:
    return ca.DM(np.asarray(values)).T
