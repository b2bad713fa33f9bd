"""Table of the rest lengths that tip a structure over each edge of each of its faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.actuation.driven_strings import changes_of_inputs, inputs_of
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.model import Model
from tenscontrol.plant.stance import convex_hull, set_down
from tenscontrol.shape.faces import faces
from tenscontrol.shape.tipping import MARGIN, STEP, StuckError, TippingPlanner, across_edge

# Keeps the direction of a face without area finite.
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class Face:
    """A face of the hull.

    Attributes
    ----------
    feet : ndarray of int
        Its nodes, ascending.
    corners : ndarray of int
        Of its polygon, counterclockwise seen from outside; in the plane from one end to the other.
    edges : list of tuple of int
        Those that can be passed.
    plans : list of tuple of ndarray
        For each of them inputs, shape (m, K), m, and margins, shape (K,), m, of equilibria.
    """

    feet: IntArray
    corners: IntArray
    edges: list[tuple[int, ...]]
    plans: list[tuple[FloatArray, FloatArray]]


class TippingTable:
    """Plans of a :class:`TippingPlanner` for all faces and edges, made once on level ground.

    It takes the place of the planner: winding follows a plan from equilibrium to equilibrium. The
    face that looks most downward, of those in the table, is that on which the structure stands.
    """

    def __init__(self, planner: TippingPlanner, model: Model, near: float, enough: float) -> None:
        # Nodes that are ``near`` a face belong to it, m; plans end ``enough`` beyond an edge, m.
        self.home, self.size, self.gravity = planner.home, planner.size, planner.gravity
        self.actuation, self.bounds = planner.actuation, planner.bounds
        self.down, nodes = planner.down, model.structure.nodes
        self.faces: list[Face] = []
        for feet, outward in faces(nodes, near):
            placed = set_down(model, feet)
            plans = {
                edge: plan
                for edge in sorted(planner.edges(placed, feet))
                if (plan := _plan(planner, placed, feet, edge, enough)) is not None
            }
            corners = _corners(nodes, feet, outward)
            self.faces.append(Face(feet, corners, list(plans), list(plans.values())))
        if not any(face.edges for face in self.faces):
            raise ValueError(
                "the gait finds no rest lengths that tip the structure over any edge of any face: "
                "give the winches a larger range, or change the prestress"
            )
        self._face_of = {tuple(face.feet.tolist()): face for face in self.faces}

    def standing(self, nodes: FloatArray, down: FloatArray) -> tuple[IntArray, float]:
        """Return the nodes of the face that looks most downward, and how level it is."""
        sinks = []
        for face in self.faces:
            area = _area(nodes[:, face.corners])
            sinks.append(float(area @ down) / (float(np.sqrt(area @ area)) + TINY))
        lowest = int(np.argmax(sinks))
        return self.faces[lowest].feet, sinks[lowest]

    def edges(self, nodes: FloatArray, feet: IntArray) -> dict[tuple[int, ...], FloatArray]:
        """Return the edges that can be passed, each with the horizontal direction over it."""
        edges = self._face_of[tuple(feet.tolist())].edges
        return {edge: across_edge(nodes, feet, edge, self.down)[0] for edge in edges}

    def start(self, nodes: FloatArray, feet: IntArray, edge: tuple[int, ...]) -> None:
        """Begin the plan of an edge of a face."""
        face = self._face_of[tuple(feet.tolist())]
        self.feet, self.edge = feet, edge
        self._inputs, self._margins = face.plans[face.edges.index(edge)]
        self._passed, self.wound = 0, inputs_of(self.actuation, self.home)

    @property
    def margin(self) -> float:
        """Margin at the last equilibrium of the plan that was passed, m."""
        return float(self._margins[self._passed])

    def advance(self, most: FloatArray) -> None:
        """Go on along the plan, with inputs changed by this much at most, m.

        Raises
        ------
        StuckError
            At the end of the plan.
        """
        last, left = len(self._margins) - 1, 1.0  # of this sample
        if self._passed == last:
            raise StuckError("the plan ends here")
        while left > 0 and self._passed < last:
            ahead = self._inputs[:, self._passed + 1] - self.wound
            takes = float(np.max(np.abs(ahead) / most))
            if takes <= left:
                self.wound = self._inputs[:, self._passed + 1]
                self._passed += 1
                left -= takes
            else:
                self.wound = self.wound + ahead * (left / takes)
                left = 0.0


def _plan(
    planner: TippingPlanner, nodes: FloatArray, feet: IntArray, edge: tuple[int, ...], enough: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return inputs and margins of equilibria over an edge; None if it cannot be passed."""
    try:
        planner.start(nodes, feet, edge)
    except StuckError:
        return None
    points = [(planner.wound, planner.margin)]
    most = changes_of_inputs(planner.actuation, np.full(len(planner.home), STEP * planner.size))
    while planner.margin < enough:
        try:
            planner.advance(most)
        except StuckError:
            break
        points.append((planner.wound, planner.margin))
    inputs, margins = zip(*points, strict=True)
    if margins[-1] < MARGIN * planner.size:
        return None
    return np.stack(inputs, axis=-1), np.array(margins)


def _corners(nodes: FloatArray, feet: IntArray, outward: FloatArray) -> IntArray:
    """Return the corners of a face, so that :func:`_area` looks along its outward normal."""
    basis = np.linalg.svd(outward[None])[2][1:]
    corners = feet[convex_hull(basis @ nodes[:, feet])]
    return corners if _area(nodes[:, corners]) @ outward > 0 else corners[::-1]


def _area(corners: FloatArray) -> FloatArray:
    """Return twice the area of a polygon as a vector along its normal; in the plane, a length."""
    sides = corners[:, 1:] - corners[:, :1]
    if len(corners) == 2:
        return np.array([sides[1, 0], -sides[0, 0]])
    return np.asarray(np.cross(sides[:, :-1], sides[:, 1:], axis=0).sum(axis=1))
