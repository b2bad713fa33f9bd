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
    STEP,
    StuckError,
    TippingPlanner,
    across_edge,
)
from tenscontrol.short_repr import short_repr
from tenscontrol.validation import direction as unit_vector

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Nodes this near the ground touch it, and lifted ones are farther, in sizes; slower ones than this
# part of √(g · size) are at rest.
_TOUCHES, _STILL = 0.02, 0.05

# So long a structure is waited for that has not tipped, or not come to rest, in √(size / g).
_PATIENCE = 8.0

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
        When other nodes touched the ground, s.
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

    An object with a method ``command``, as ``simulate(controller=...)`` takes it. At rest it sees
    which nodes it stands on, and tips over the edge of these feet from which two steps, of a shape
    that is rigid, lead nearest to a point of the line ahead. Sample by sample the winches follow
    the gradient of :func:`tipping_path`, the fastest of them at its limit, until the centre of mass
    is beyond the edge by a fiftieth of the size. It waits until it has tipped and is at rest, and
    winds back straight to the rest lengths of the start. Where one edge cannot be passed, it tries
    the next; back over where it came from it goes only if it must.

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

    Attributes
    ----------
    made : tuple of RollingStep
        The steps so far.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.

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
    >>> run = tc.simulate(model, 3.0, nodes, controller=gait, winches=winches, rest_length=0.55,
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
    ) -> None:
        self._planner = TippingPlanner(model, rest_length, winches, clearance, actuated)
        self._structure = model.structure
        self._normal, self._height = _one_plane(model)
        self._direction = unit_vector("direction", direction, model.structure.dimension)
        self.sample_time = validation.positive_number("sample_time", sample_time, "s")
        self._steps = np.inf if steps is None else validation.whole_number("steps", steps, 1)
        size, gravity = self._planner.size, self._planner.gravity
        rate = None if winches is None else winches.largest_rate
        self._most = STEP * size if rate is None else rate * self.sample_time
        self._touches, self._still = _TOUCHES * size, _STILL * np.sqrt(gravity * size)
        self._patience = _PATIENCE * np.sqrt(size / gravity)
        self.reset()

    def __repr__(self) -> str:
        way = ", ".join(f"{entry:.3g}" for entry in self._direction)
        return f"RollingGait({self._structure!r}, along [{way}], every {self.sample_time:g} s)"

    def reset(self) -> None:
        """Forget the steps made and start from the standing shape."""
        self.made: tuple[RollingStep, ...] = ()
        self._phase = _Phase.STANDS
        self._since = 0.0
        self._reached = self._planner.home
        self._vain: set[tuple[int, ...]] = set()
        self._begun: FloatArray | None = None  # where the line begins
        self._tipped: RollingStep | None = None  # a step that has not come to rest
        self._stood = self._moved = np.zeros(len(self._normal))  # where, and in the last step, m

    def applied(self, value: ArrayLike) -> None:
        """Take note of the rest lengths that the winches reached.

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
        above = self._normal @ nodes - self._height
        touching = np.flatnonzero(above < self._touches)
        is_still = bool(np.linalg.norm(velocities, axis=0).max() < self._still)
        is_late = time > self._since + self._patience
        if self._phase is _Phase.WINDS:
            self._wind(time, touching, is_late)
        elif self._phase is _Phase.LANDS and (is_still or is_late):
            self._phase = _Phase.STANDS
        elif self._phase is _Phase.STANDS and is_still and len(touching) >= len(nodes):
            off = np.abs(self._reached - self._planner.home).max()
            if off <= CLOSE * self._planner.size:
                self._stand(time, nodes, touching)
        return self._back() if self._phase is _Phase.STANDS else self._planner.rest_length

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
        ahead = {edge for edge, over in edges.items() if over @ self._moved >= back}
        left = ahead - self._vain or edges.keys() - self._vain or edges.keys()
        edge = min(
            left, key=lambda candidate: self._distance(nodes, feet, candidate, goal, _FORESEEN)
        )
        try:
            self._planner.start(nodes, feet, edge)
        except StuckError:
            self._vain.add(edge)
        else:
            self._phase, self._since = _Phase.WINDS, time

    def _distance(
        self, nodes: FloatArray, feet: IntArray, edge: tuple[int, ...], goal: FloatArray, steps: int
    ) -> float:
        """Return how far from the goal the centre is after some steps of a rigid shape, m."""
        nodes, feet = _rolled(nodes, feet, edge, self._normal)
        if steps == 1 or len(feet) < len(nodes):
            return float(np.linalg.norm(nodes.mean(axis=1) - goal))
        edges = self._planner.edges(nodes, feet)
        return min(self._distance(nodes, feet, edge, goal, steps - 1) for edge in edges)

    def _wind(self, time: float, touching: IntArray, is_late: bool) -> None:
        """Wind on, or end it where it has tipped or cannot."""
        planner = self._planner
        behind = np.setdiff1d(planner.feet, planner.edge)
        tipped = np.setdiff1d(touching, planner.feet).size and not np.isin(behind, touching).any()
        if tipped:
            edge = np.array(planner.edge)
            self._tipped = RollingStep(time, planner.feet, edge, touching)
            self._phase, self._since = _Phase.LANDS, time
        elif planner.margin < MARGIN * planner.size:
            try:
                planner.advance(self._most)
                self._since = time
            except StuckError:
                self._give_up()
        elif is_late:
            self._give_up()

    def _give_up(self) -> None:
        """Go back, to try another edge."""
        self._vain.add(self._planner.edge)
        self._phase = _Phase.STANDS


def _rolled(
    nodes: FloatArray, feet: IntArray, edge: tuple[int, ...], up: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return the nodes, and on which they stand, after a rigid shape has rolled over an edge."""
    over, _ = across_edge(nodes, feet, edge, -up)
    beside = nodes - nodes[:, edge[:1]]
    out, above = over @ beside, up @ beside
    angles = np.arctan2(above, out)
    angles[feet] = np.inf
    turn = angles.min()
    c, s = np.cos(turn) - 1, np.sin(turn)
    moved = np.outer(over, c * out + s * above) + np.outer(up, c * above - s * out)
    return nodes + moved, np.union1d(edge, np.flatnonzero(angles < turn + _TOUCHES))


def _one_plane(model: Model) -> tuple[FloatArray, float]:
    """Return normal and height of the ground of a model, which must be a plane."""
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
    return law.up(model.structure.dimension), law.height
