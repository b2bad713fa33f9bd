"""Rolling: steps in which a structure tips over an edge of its base."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import changes_of_inputs, inputs_of
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.dynamics.model import Model
from tenscontrol.shape.ground_roughness import roughness
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
from tenscontrol.structure.structure import Structure
from tenscontrol.validation import direction as unit_vector
from tenscontrol.warn import warn

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Nodes slower than this part of √(g · size) are still.
_STILL = 0.05

# At rest it is where it was still for so long, in √(size / g): nothing that falls is. And so long a
# structure is waited for that has not tipped, or not come to rest.
_RESTS, _PATIENCE = 2 * _STILL, 8.0

# Where it does not tip, winding goes on until the centre of mass is so far beyond, in sizes.
FARTHER = 3 * MARGIN

# Ground is level if the cosines of its normal are off by less than this.
_LEVEL = 1e-6

# It has tipped where another face is as near to level as this cosine says, 15°.
LANDED = 0.966

# Steps that a gait foresees, as if the shape were rigid, and how far ahead it looks, in sizes.
FORESEEN, AHEAD = 2, 2.0

# An edge is behind if its direction has this part, turned round, of that of the last step.
BACK = 0.7


# Rougher ground than this, in sizes, is warned of.
ROUGH = 0.025


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
        When it had tipped: another face was level to 15°, s.
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


@dataclass(frozen=True, eq=False)
class GaitSettings:
    """What a gait goes by, for its C code."""

    plans: TippingPlanner | TippingTable
    structure: Structure
    up: FloatArray  # normal of the ground
    direction: FloatArray
    sample_time: float  # s
    steps: float  # to make; may be infinite
    home: FloatArray  # inputs between the steps, shape (m,), m
    most: FloatArray  # largest changes of the inputs in a sample, shape (m,), m
    still: float  # slower nodes are still, m/s
    rests: float  # still for so long is at rest, s
    patience: float  # s

    def __post_init__(self) -> None:
        freeze_arrays(self)


@final
class RollingGait:
    """A controller that rolls a structure on the ground along a line, by its rest lengths.

    An object with a method ``command``, as ``simulate(controller=...)`` takes it. Nodes may be
    those that a :class:`KalmanFilter` with ``rolling=True`` estimates. It stands on the
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
    actuated : Actuation
        The strings that it commands, an input each.

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
    >>> run = tc.simulate(model, 3.5, nodes, controller=gait, winches=winches, rest_length=0.55)
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
        up, size = _normal_of_plane(model), planner.size
        heading = unit_vector("direction", direction, model.structure.dimension)
        self.sample_time = validation.positive_number("sample_time", sample_time, "s")
        count = np.inf if steps is None else validation.whole_number("steps", steps, 1)
        plans: TippingPlanner | TippingTable = planner
        if validation.truth("tabulated", tabulated, "whether to plan before the run"):
            if not np.allclose(up, -planner.down, atol=_LEVEL):
                raise ValueError(
                    "tabulated is True, but the ground of the model is inclined to its gravity, "
                    "and a plan then depends on where uphill lies: give a model on level ground, "
                    "or leave it out"
                )
            plans = TippingTable(planner, model, NEAR * size, FARTHER * size)
        rate = None if winches is None else winches.largest_rate
        most = STEP * size if rate is None else rate * self.sample_time
        moment = float(np.sqrt(size / planner.gravity))
        self._settings = GaitSettings(
            plans, model.structure, up, heading, self.sample_time, count,
            home=inputs_of(planner.actuation, planner.home),
            most=changes_of_inputs(planner.actuation, most * np.ones(len(planner.home))),
            still=float(_STILL * np.sqrt(planner.gravity * size)),
            rests=_RESTS * moment,
            patience=_PATIENCE * moment,
        )  # fmt: skip
        self._planner, self._structure = plans, model.structure
        self.actuated = planner.actuation
        self.reset()

    @property
    def settings(self) -> GaitSettings:
        """What it goes by; its C code is made from it."""
        return self._settings

    def __repr__(self) -> str:
        way = ", ".join(f"{entry:.3g}" for entry in self._settings.direction)
        return f"RollingGait({self._structure!r}, along [{way}], every {self.sample_time:g} s)"

    def reset(self) -> None:
        """Forget the steps made and start from the standing shape."""
        self.made: tuple[RollingStep, ...] = ()
        self._phase = _Phase.STANDS
        self._since = 0.0
        self._moved_at: float | None = None  # when it was not still, or began
        self._reached = self._settings.home
        self._enough = MARGIN
        self._vain: set[tuple[int, ...]] = set()
        self._begun: FloatArray | None = None  # where the line begins
        self._tipped: RollingStep | None = None  # a step that has not come to rest
        # Where it stood, and how far it moved in the last step, m.
        self._stood = self._moved = np.zeros(len(self._settings.up))

    def begin(self, model: Model, nodes: ArrayLike) -> None:
        """Warn before a run on ground that is rough beside the structure.

        Parameters
        ----------
        model : Model
            Of the run.
        nodes : array_like, shape (d, n)
            At its start, m.

        Warns
        -----
        RuntimeWarning
            If the height of the ground is off a plane by more than a fortieth of the size, root
            mean square over four sizes about the start.
        """
        validation.instance("model", model, Model, "make one by Model(structure)")
        size = self._planner.size
        rough = roughness(model, self._structure.checked_nodes("nodes", nodes), size)
        if rough > ROUGH * size:
            warn(
                f"the height of the ground is off a plane by {rough:.2g} m (root mean square), "
                f"{rough / size:.1%} of the size of the structure, but the gait plans on a plane, "
                f"and was tried up to 2 % of the size: it may stop or fall back. Let a larger "
                "structure roll, or go where the ground is flatter",
                RuntimeWarning,
            )

    def applied(self, value: ArrayLike) -> None:
        """Take note of the rest lengths that the winches reached, if not those commanded.

        Parameters
        ----------
        value : array_like, shape (m,)
            m, of the inputs.
        """
        shape = self._settings.home.shape
        self._reached = validation.shaped("value", value, shape, "one rest length per input")

    def command(self, time: float, nodes: ArrayLike, velocities: ArrayLike) -> FloatArray:
        """Return rest lengths of the driven strings, m, shape (m,).

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
        settings = self._settings
        is_still = bool(np.linalg.norm(velocities, axis=0).max() < settings.still)
        if not is_still or self._moved_at is None:
            self._moved_at = time
        rests = time - self._moved_at >= settings.rests
        is_late = time > self._since + settings.patience
        if self._phase is _Phase.WINDS:
            self._wind(time, *self._standing(nodes), is_late)
        elif self._phase is _Phase.LANDS and (rests or is_late):
            self._phase = _Phase.STANDS
        elif self._phase is _Phase.STANDS and rests:
            off = np.abs(self._reached - settings.home).max()
            feet = self._standing(nodes)[0] if off <= CLOSE * self._planner.size else ()
            if len(feet):
                self._stand(time, nodes, np.asarray(feet))
        if self._phase is _Phase.STANDS:
            self._reached = self._back()
        else:
            self._reached = self._planner.wound
        return self._reached

    def _standing(self, nodes: FloatArray) -> tuple[IntArray, float]:
        """Return the nodes of the lowest face, none of a flat shape, and how level it is."""
        return self._planner.standing(nodes, -self._settings.up)

    def _back(self) -> FloatArray:
        """Return the next inputs on the straight way back."""
        left = self._settings.home - self._reached
        least = CLOSE * self._planner.size
        share = np.min(self._settings.most / np.maximum(np.abs(left), least))
        return np.asarray(self._reached + min(1.0, float(share)) * left)

    def _stand(self, time: float, nodes: FloatArray, feet: IntArray) -> None:
        """Count the step that led here, and begin to wind over the best edge."""
        centre = nodes.mean(axis=1)
        self._begun = centre if self._begun is None else self._begun
        if self._tipped is not None:
            if np.array_equal(feet, self._tipped.feet):  # it fell back
                self._vain.add(tuple(self._tipped.edge.tolist()))
            else:
                self.made += (replace(self._tipped, landed=feet),)
                self._vain, self._moved = set(), centre - self._stood
        self._tipped, self._stood = None, centre
        if len(self.made) >= self._settings.steps:
            return
        direction, ahead = self._settings.direction, AHEAD * self._planner.size
        goal = self._begun + (direction @ (centre - self._begun) + ahead) * direction
        edges = self._planner.edges(nodes, feet)
        if not edges:
            return
        # Back where it came from it would only come here again.
        back = -BACK * float(np.linalg.norm(self._moved))
        not_back = [edge for edge, over in edges.items() if over @ self._moved >= back]
        left = [[edge for edge in some if edge not in self._vain] for some in (not_back, edges)]
        edge = min(
            left[0] or left[1] or edges,
            key=lambda candidate: self._distance(nodes, feet, candidate, goal, FORESEEN),
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
        nodes = _rolled(nodes, feet, edge, self._settings.up)
        feet, _ = self._standing(nodes)
        if steps == 1 or len(feet) < len(nodes):
            return float(np.linalg.norm(nodes.mean(axis=1) - goal))
        edges = self._planner.edges(nodes, feet)
        ways = (self._distance(nodes, feet, edge, goal, steps - 1) for edge in edges)
        return min(ways, default=np.inf)

    def _wind(self, time: float, lowest: IntArray, level: float, is_late: bool) -> None:
        """Wind on, or end it where it has tipped or cannot."""
        planner = self._planner
        behind = np.setdiff1d(planner.feet, planner.edge)
        if level > LANDED and not np.isin(behind, lowest).any():
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
                planner.advance(self._settings.most)
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
