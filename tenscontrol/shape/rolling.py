"""Rolling: steps in which a structure tips over an edge of its base."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.dynamics.model import Model
from tenscontrol.shape.tipping import (
    CLOSE,
    MARGIN,
    NEAR,
    STEP,
    StuckError,
    TippingPlanner,
    across_edge,
)
from tenscontrol.shape.tipping_table import TippingTable
from tenscontrol.short_repr import short_repr
from tenscontrol.validation import direction as unit_vector

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Nodes slower than this part of √(g · size) are still.
STILL = 0.05

# At rest it is where it was still for so long, in √(size / g): nothing that falls is. And so long a
# structure is waited for that has not tipped, or not come to rest.
RESTS, PATIENCE = 2 * STILL, 8.0

# Where it does not tip, winding goes on until the centre of mass is so far beyond, in sizes.
FARTHER = 3 * MARGIN

# Ground is level if the cosines of its normal are off by less than this.
_LEVEL = 1e-6

# Steps that a gait foresees, as if the shape were rigid, and how far ahead it looks, in sizes.
_FORESEEN, _AHEAD = 2, 2.0

# An edge is behind if its direction has this part, turned round, of that of the last step.
_BACK = 0.7


class _Phase(Enum):
    """What a gait does: at rest or on its way there, winding over an edge, tipping."""

    STANDS = 1
    WINDS = 2
    LANDS = 3


@dataclass(frozen=True, eq=False)
class RollingStep:
    """A step of a :class:`RollingGait`.

    Attributes
    ----------
    time : float
        When it had tipped: another face looked more downward than the one it stood on, s.
    feet, edge : ndarray of int
        What it stood on, and what it tipped over.
    landed : ndarray of int
        What it came to rest on.
    """

    time: float
    feet: IntArray
    edge: IntArray
    landed: IntArray

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)


@final
class RollingGait:
    """A controller that rolls a structure on the ground along a line, by its rest lengths.

    An object with a method ``command``, as ``simulate(controller=...)`` takes it. It stands on the
    face of its hull that looks most downward; the height of the ground is not needed. At rest it
    tips over the edge of this face from which two steps, of a shape that is rigid, lead nearest to
    a point of the line ahead. Sample by sample the winches follow the gradient of
    :func:`tipping_path`, the fastest of them at its limit, until the centre of mass is beyond the
    edge by a fiftieth of the size, and three times as far if it has not tipped then. It waits until
    it is at rest, and winds back straight to the rest lengths of the start. Where one edge cannot
    be passed, it tries the next; back over where it came from it goes only if it must.

    Parameters
    ----------
    model : Model
        With a string law, gravity and one ground that is a plane, without supports. What it plans
        with; that of the run may differ.
    rest_length : float or array_like, shape (α,)
        m, between the steps.
    direction : array_like, shape (d,)
        Where the line goes; it begins where the structure is at the first command.
    sample_time : float
        s.
    winches : Winches, optional
        Their range and speed are kept; without a speed, winding is by a hundredth of the size in a
        sample.
    steps : int, optional
        Steps to make; without end if not given.
    clearance : float
        Least distance between the axes of bars that share no node while it winds, m.
    actuated : sequence of int or str, dict, array_like or Actuation, optional
        The strings that winches drive, as in :func:`linearize`; all if not given. The others keep
        the rest lengths of the start.
    tabulated : bool
        Whether the plans of each edge of each face of the hull are made at once, on level ground,
        and looked up in the run. Commands then take no planning, and :func:`generate_c` writes the
        gait as C code. Between the steps it must stand on a face of the hull of the structure.

    Attributes
    ----------
    made : tuple of RollingStep
        The steps so far.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or no edge of any face can be passed where it is tabulated.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> ball = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    >>> ground = tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.05)
    >>> model = tc.Model(ball, strings=tc.LinearStrings(stiffness=1000.0, damping=10.0),
    ...                  gravity=9.81, ground=ground)
    >>> winches = tc.Winches(rate=0.2, ramp=True)
    >>> gait = tc.shape.RollingGait(model, 0.55, direction=[1.0, 0.0, 0.0], sample_time=0.05,
    ...                             winches=winches, steps=1)
    >>> nodes = tc.plant.set_down(model, [0, 4, 8])
    >>> run = tc.simulate(model, 3.5, nodes, controller=gait, winches=winches, rest_length=0.55,
    ...                   method="cvodes", tolerance=1e-5)
    >>> [step.landed.tolist() for step in gait.made]
    [[4, 8, 10]]
    """

    input = "rest_length"

    def __init__(
        self,
        model: Model,
        rest_length: ArrayLike,
        direction: ArrayLike,
        sample_time: float,
        *,
        winches: Winches | None = None,
        steps: int | None = None,
        clearance: float = 0.0,
        actuated: object = None,
        tabulated: bool = False,
    ) -> None:
        planner = TippingPlanner(model, rest_length, winches, clearance, actuated)
        self._structure, self._normal = model.structure, _normal_of_plane(model)
        self._planner: TippingPlanner | TippingTable = planner
        if validation.truth("tabulated", tabulated, "whether to plan before the run"):
            if not np.allclose(self._normal, -planner.down, atol=_LEVEL):
                raise ValueError(
                    "tabulated is True, but the ground of the model is inclined to its gravity, "
                    "and a plan then depends on where uphill lies: give a model on level ground, "
                    "or leave it out"
                )
            reach = FARTHER * planner.size
            self._planner = TippingTable(planner, model, NEAR * planner.size, reach)
        self._direction = unit_vector("direction", direction, model.structure.dimension)
        self.sample_time = validation.positive_number("sample_time", sample_time, "s")
        self._steps = np.inf if steps is None else validation.whole_number("steps", steps, 1)
        size, gravity = self._planner.size, self._planner.gravity
        rate = None if winches is None else winches.largest_rate
        most = STEP * size if rate is None else rate * self.sample_time
        self._most = most * np.ones(len(self._planner.home))
        self._still, self._moment = STILL * np.sqrt(gravity * size), np.sqrt(size / gravity)
        self.reset()

    def __repr__(self) -> str:
        way = ", ".join(f"{entry:.3g}" for entry in self._direction)
        return f"RollingGait({self._structure!r}, along [{way}], every {self.sample_time:g} s)"

    def reset(self) -> None:
        """Forget the steps made and start from the standing shape."""
        self.made: tuple[RollingStep, ...] = ()
        self._phase = _Phase.STANDS
        self._since = 0.0
        self._moved_at: float | None = None  # when it was not still, or began
        self._reached = self._planner.home
        self._enough = MARGIN
        self._vain: set[tuple[int, ...]] = set()
        self._begun: FloatArray | None = None  # where the line begins
        self._tipped: RollingStep | None = None  # a step that has not come to rest
        self._stood = self._moved = np.zeros(len(self._normal))  # where, and in the last step, m

    def applied(self, value: ArrayLike) -> None:
        """Take note of the rest lengths that the winches reached, if not those commanded.

        Parameters
        ----------
        value : array_like, shape (α,)
            m.
        """
        home = self._planner.home
        self._reached = validation.shaped("value", value, home.shape, "one rest length per string")

    def command(self, time: float, nodes: ArrayLike, velocities: ArrayLike) -> FloatArray:
        """Return rest lengths, m, shape (α,).

        Parameters
        ----------
        time : float
            s.
        nodes, velocities : array_like, shape (d, n)
            m and m/s.
        """
        time = validation.number("time", time, "s")
        nodes = self._structure.checked_nodes("nodes", nodes)
        velocities = self._structure.checked_nodes("velocities", velocities)
        is_still = bool(np.linalg.norm(velocities, axis=0).max() < self._still)
        if not is_still or self._moved_at is None:
            self._moved_at = time
        rests = time - self._moved_at >= RESTS * self._moment
        is_late = time > self._since + PATIENCE * self._moment
        if self._phase is _Phase.WINDS:
            self._wind(time, self._standing(nodes), is_late)
        elif self._phase is _Phase.LANDS and (rests or is_late):
            self._phase = _Phase.STANDS
        elif self._phase is _Phase.STANDS and rests:
            off = np.abs(self._reached - self._planner.home).max()
            feet = self._standing(nodes) if off <= CLOSE * self._planner.size else ()
            if len(feet):
                self._stand(time, nodes, np.asarray(feet))
        stands = self._phase is _Phase.STANDS
        self._reached = self._back() if stands else self._planner.rest_length
        return self._reached

    def _standing(self, nodes: FloatArray) -> IntArray:
        """Return the nodes of the lowest face; none where the shape has no faces."""
        return self._planner.standing(nodes, -self._normal)

    def _back(self) -> FloatArray:
        """Return the next rest lengths on the straight way back."""
        left = self._planner.home - self._reached
        share = np.min(self._most / np.maximum(np.abs(left), CLOSE * self._planner.size))
        return np.asarray(self._reached + min(1.0, float(share)) * left)

    def _stand(self, time: float, nodes: FloatArray, feet: IntArray) -> None:
        """Count the step that led here, and begin to wind over the best edge."""
        centre = nodes.mean(axis=1)
        self._begun = centre if self._begun is None else self._begun
        if self._tipped is not None and not np.array_equal(feet, self._tipped.feet):
            self.made += (replace(self._tipped, landed=feet),)
            self._vain, self._moved = set(), centre - self._stood
        self._tipped, self._stood = None, centre
        if len(self.made) >= self._steps:
            return
        along = self._direction @ (centre - self._begun)
        goal = self._begun + (along + _AHEAD * self._planner.size) * self._direction
        edges = self._planner.edges(nodes, feet)
        # Back where it came from it would only come here again.
        back = -_BACK * float(np.linalg.norm(self._moved))
        ahead = [edge for edge, over in edges.items() if over @ self._moved >= back]
        left = [[edge for edge in some if edge not in self._vain] for some in (ahead, edges)]
        edge = min(
            left[0] or left[1] or edges,
            key=lambda candidate: self._distance(nodes, feet, candidate, goal, _FORESEEN),
        )
        try:
            self._planner.start(nodes, feet, edge)
        except StuckError:
            self._vain.add(edge)
        else:
            self._phase, self._since, self._enough = _Phase.WINDS, time, MARGIN

    def _distance(
        self, nodes: FloatArray, feet: IntArray, edge: tuple[int, ...], goal: FloatArray, steps: int
    ) -> float:
        """Return how far from the goal the centre is after some steps of a rigid shape, m."""
        nodes = _rolled(nodes, feet, edge, self._normal)
        feet = self._standing(nodes)
        if steps == 1 or len(feet) < len(nodes):
            return float(np.linalg.norm(nodes.mean(axis=1) - goal))
        edges = self._planner.edges(nodes, feet)
        return min(self._distance(nodes, feet, edge, goal, steps - 1) for edge in edges)

    def _wind(self, time: float, lowest: IntArray, is_late: bool) -> None:
        """Wind on, or end it where it has tipped or cannot."""
        planner = self._planner
        behind = np.setdiff1d(planner.feet, planner.edge)
        if len(lowest) and not np.isin(behind, lowest).any():
            edge = np.array(planner.edge)
            self._tipped = RollingStep(time, planner.feet, edge, lowest)
            self._phase, self._since = _Phase.LANDS, time
            return
        if is_late and planner.margin >= self._enough * planner.size:
            if self._enough == FARTHER:
                self._give_up()
                return
            self._enough = FARTHER
        if planner.margin < self._enough * planner.size:
            try:
                planner.advance(self._most)
                self._since = time
            except StuckError:
                self._give_up()

    def _give_up(self) -> None:
        """Go back, to try another edge."""
        self._vain.add(self._planner.edge)
        self._phase = _Phase.STANDS


def _rolled(nodes: FloatArray, feet: IntArray, edge: tuple[int, ...], up: FloatArray) -> FloatArray:
    """Return the nodes after a rigid shape has rolled over an edge onto the next face."""
    over, _ = across_edge(nodes, feet, edge, -up)
    beside = nodes - nodes[:, edge[:1]]
    out, above = over @ beside, up @ beside
    angles = np.arctan2(above, out)
    angles[feet] = np.inf
    turn = angles.min()
    c, s = np.cos(turn) - 1, np.sin(turn)
    moved = np.outer(over, c * out + s * above) + np.outer(up, c * above - s * out)
    return np.asarray(nodes + moved)


def _normal_of_plane(model: Model) -> FloatArray:
    """Return the normal of the ground of a model, which must be a plane."""
    if len(model.ground) != 1:
        raise ValueError(
            f"the model has {len(model.ground)} contact laws, expected one: build it as "
            "Model(..., ground=Ground(stiffness=...))"
        )
    law = model.ground[0]
    if not isinstance(law.height, float):
        raise ValueError(
            "the ground of the model is curved, expected a plane, a number as height: plan with "
            "the plane that is nearest to it; the ground of the run may be rough"
        )
    return np.asarray(law.up(model.structure.dimension))
