"""Bar lengths made exact after a step that does not keep them."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.integrate.multipliers import Coupled
from tenscontrol.structure.structure import Structure

#: Why states cannot be projected.
NOT_RIGID = (
    "bars that share nodes cannot be put on their lengths near by; try a smaller tolerance, unless "
    "they came to a dead centre, where two ways lead on"
)


def project(structure: Structure, symbol: Any = ca.SX.sym, driven: bool = False) -> ca.Function:
    """Return ``(x) -> x``: the state near by whose bars have their lengths and do not stretch.

    Where lengths are driven, ``(x, lengths) -> x`` of those of all bars, m, then of their rates,
    m/s: a bar gets its length and stretches at its rate.

    Bars on their own one by one and in closed form: the bar vector is scaled to its length, the
    nearest state in the metric of the mass; what its rate has along the bar is removed, and the
    rest is scaled by the inverse, so that ``b × ḃ`` stays. Centres, string nodes and hinges stay,
    and linear and angular momentum with them, to round-off. Bars that share nodes block by block,
    see :meth:`Coupled.restored`; NaN where their lengths are too far off.
    """
    bodies = Bodies(structure)
    size = 2 * len(structure.bars)
    if not structure.blocks:
        given = [symbol("x", 2 * len(structure.free_rows))]
        given += [symbol("lengths", size)] if driven else []
        return Function("project", given, [_project_alone(bodies, *given)])
    x, more = ca.MX.sym("x", 2 * len(structure.free_rows)), list[Any]()
    given = [ca.SX.sym("x", 2 * len(bodies.alone))]
    if driven:
        given, more = [*given, ca.SX.sym("lengths", size)], [ca.MX.sym("lengths", size)]
    project_alone = Function("project_alone", given, [_project_alone(bodies, *given)])
    q, v = ca.vertsplit(x, x.shape[0] // 2)
    moved = project_alone(ca.vertcat(q[bodies.alone], v[bodies.alone]), *more)
    half, coupled = len(bodies.alone), Coupled(structure, driven)
    own = [_of_bars(lengths, coupled.bars) for lengths in more]
    c, rates = coupled.restored()(q[bodies.coupled], v[bodies.coupled], *own)
    ends = [bodies.merge(moved[:half], c), bodies.merge(moved[half:], rates)]
    return Function("project", [x, *more], [ca.vertcat(*ends)])


def _of_bars(lengths: kernel.Symbolic, bars: IntArray) -> kernel.Symbolic:
    """Return lengths and rates of some bars, a column, of those of all."""
    return lengths[np.concatenate([bars, lengths.shape[0] // 2 + bars]).tolist()]


def _project_alone(
    bodies: Bodies, x: kernel.Symbolic, lengths: kernel.Symbolic | None = None
) -> kernel.Symbolic:
    half, length, rate = x.shape[0] // 2, bodies.length, None
    if lengths is not None:
        count, own = len(bodies.bars), _of_bars(lengths, bodies.bars)
        length, rate = own[:count].T, own[count:].T
    nodes, velocities = bodies.columns(x[:half], bodies.held), bodies.columns(x[half:])
    points, B = bodies.split(nodes, bodies.hinges)
    point_rates, Bd = bodies.split(velocities)
    square = kernel.dots(B, B)
    scale = length / ca.sqrt(square)
    across = Bd - kernel.scale_columns(B, kernel.dots(B, Bd) / square)
    vectors, turning = (kernel.scale_columns(*pair) for pair in ((B, scale), (across, 1 / scale)))
    if rate is not None:
        turning += kernel.scale_columns(vectors, rate / length)
    moved = bodies.join(points, vectors, bodies.hinges)
    rates = bodies.join(point_rates, turning)
    return ca.vertcat(bodies.entries(moved), bodies.entries(rates))


def projection(equation: Equation) -> ca.Function | None:
    """Return :func:`project` for an equation, or None where there are no bars.

    Where lengths are driven, it is ``(x, u) -> x`` of the input at the time of x.
    """
    structure = equation.structure
    if structure is None or len(structure.bars) == 0:
        return None
    if equation.layout.lengths:
        return equation.prepared.get("project", lambda: _project_driven(equation, structure))
    return equation.prepared.get("project", lambda: project(structure, equation.symbol))


def _project_driven(equation: Equation, structure: Structure) -> ca.Function:
    exact = project(structure, equation.symbol, driven=True)
    symbol = ca.SX.sym if exact.is_a("SXFunction") else ca.MX.sym
    x, u = symbol("x", equation.states), symbol("u", equation.inputs)
    length, rate, _ = equation.layout.bar_lengths(u)
    return Function("project_driven", [x, u], [exact(x, ca.vertcat(length, rate))])


def put_on_lengths(exact: ca.Function, x: Any, u: Any) -> Any:
    """Return the expression of a state that :func:`projection` makes exact under an input."""
    return exact(x) if exact.n_in() == 1 else exact(x, u)


class Projector:
    """Makes the bar lengths of states exact, one a column, if wanted and there are bars."""

    def __init__(self, equation: Equation, wanted: bool) -> None:
        self._exact = projection(equation) if wanted else None
        self._layout = equation.layout

    def __repr__(self) -> str:
        return f"Projector({'exact bar lengths' if self._exact is not None else 'nothing'})"

    def __call__(
        self, states: FloatArray, held: FloatArray | None = None, times: Any = None
    ) -> FloatArray:
        """Return states of shape (states, count), up to the first that is too far off.

        ``held`` is the input, and ``times`` are those of the states after its begin, s, an array of
        shape (count,): needed where lengths of bars are driven.
        """
        if self._exact is None:
            return states
        inputs = []
        if self._exact.n_in() > 1 and states.shape[1]:
            assert held is not None  # bars are driven
            assert times is not None  # then, too
            inputs = [np.column_stack([self._layout.later(held, time) for time in times])]
        exact = evaluate_columns(self._exact, states, *inputs)[0]
        good = np.isfinite(exact).all(axis=0)
        return exact if good.all() else exact[:, : int(good.argmin())]


def projected(step: ca.Function, equation: Equation) -> ca.Function:
    """Return a step that is followed by :func:`project`."""
    exact = projection(equation)
    if exact is None:
        return step
    written = step.is_a("SXFunction") and exact.is_a("SXFunction")
    symbols = ca.SX if written else ca.MX
    arguments = [symbols.sym(step.name_in(i), step.size1_in(i)) for i in range(step.n_in())]
    _, u, _, h = arguments
    end = put_on_lengths(exact, step(*arguments), equation.ahead(u, h))
    return Function(f"projected_{step.name()}", arguments, [end])


class Bodies:
    """The map between nodes and bodies that share none, for positions, velocities and forces.

    *Points* are the centres of the bars with two free ends, then the string nodes. *Vectors* are
    those of the bars with two free ends, then of the bars that swing, from the fixed to the free
    end. Bars with both ends fixed do not move and are left out, as are blocks of bars. In these
    coordinates the mass matrix is diagonal: m, m_s, m/12 and m/3. Expressions may be SX or MX, one
    column per node, point or vector.

    Attributes
    ----------
    alone, coupled : list of int
        Places in the free coordinates of those of these bodies, and of those of the blocks.
    bars : ndarray of int
        Those of the vectors.
    held : DM
        Positions of string nodes along the axes in which they are on rollers, m.
    """

    def __init__(self, structure: Structure, masses: kernel.Masses | None = None) -> None:
        d = self.dimension = structure.dimension
        nothing = np.zeros(0, dtype=np.int64)
        nodes = np.setdiff1d(structure.free, [i for block in structure.blocks for i in block.nodes])
        rows = (d * nodes[:, None] + np.arange(d)).ravel()
        blocks = np.concatenate([nothing, *(block.rows for block in structure.blocks)])
        is_free = np.isin(rows, structure.free_rows)
        self.alone = np.searchsorted(structure.free_rows, rows[is_free]).tolist()
        self.coupled = np.searchsorted(structure.free_rows, blocks).tolist()
        self._merged = np.argsort(self.alone + self.coupled).tolist()
        # String nodes on rollers: coordinates that are free, and places of those that are not.
        self._free = np.flatnonzero(is_free).tolist()
        self._rolls = not is_free.all()
        self._filled = np.argsort(np.concatenate([self._free, np.flatnonzero(~is_free)])).tolist()
        self.held = ca.DM(structure.nodes.ravel(order="F")[rows[~is_free]])

        def columns(of: IntArray) -> list[int]:
            """Places of nodes among these."""
            return [int(i) for i in np.searchsorted(nodes, of)]

        free, swinging = structure.free_bars, structure.swinging_bars
        start, end = structure.bars[free].T
        hinge, tip = structure.hinged_pairs.T
        self._start, self._end, self._tip = columns(start), columns(end), columns(tip)
        self._string_nodes = columns(structure.string_nodes)
        self._order = np.argsort(
            self._start + self._end + self._tip + self._string_nodes, kind="stable"
        ).tolist()
        self.hinges = ca.DM(structure.nodes[:, hinge])
        mass = kernel.bar_mass(structure, free, masses)
        hinged_mass = kernel.bar_mass(structure, swinging, masses)
        self.bars = np.concatenate([free, swinging])
        self.length = _row(structure.bar_length[self.bars])
        # Of points; and by which the difference of the end forces, or the force on the tip, moves
        # a vector.
        self.point_mass = ca.horzcat(mass, kernel.string_node_mass(structure, masses))
        self.vector_mass = ca.horzcat(mass / 6, hinged_mass / 3)

    def columns(self, entries: kernel.Symbolic, held: kernel.Symbolic = 0) -> kernel.Symbolic:
        """Return columns, shape (d, ·), of what is free; what is not is :attr:`held`, or zero."""
        if self._rolls:
            entries = ca.vertcat(entries, held + 0 * self.held)[self._filled]
        return ca.reshape(entries, self.dimension, entries.shape[0] // self.dimension)

    def entries(self, columns: kernel.Symbolic) -> kernel.Symbolic:
        """Return what supports leave free of columns: :meth:`columns` undone."""
        entries = ca.vec(columns)
        return entries[self._free] if self._rolls else entries

    def merge(self, alone: kernel.Symbolic, coupled: kernel.Symbolic) -> kernel.Symbolic:
        """Return all free coordinates of those of the bodies and of the blocks."""
        return ca.vertcat(alone, coupled)[self._merged]

    def split(
        self, nodes: kernel.Symbolic, hinges: kernel.Symbolic = 0
    ) -> tuple[kernel.Symbolic, kernel.Symbolic]:
        """Return points and vectors, shape (d, ·) each, of positions or velocities."""
        start, end = nodes[:, self._start], nodes[:, self._end]
        points = ca.horzcat((start + end) / 2, nodes[:, self._string_nodes])
        return points, ca.horzcat(end - start, nodes[:, self._tip] - hinges)

    def join(
        self, points: kernel.Symbolic, vectors: kernel.Symbolic, hinges: kernel.Symbolic = 0
    ) -> kernel.Symbolic:
        """Return nodes, shape (d, ·), of points and vectors: :meth:`split` undone."""
        bars = len(self._start)
        centre, half = points[:, :bars], vectors[:, :bars] / 2
        blocks = centre - half, centre + half, vectors[:, bars:] + hinges, points[:, bars:]
        return ca.horzcat(*blocks)[:, self._order]

    def resultants(self, forces: kernel.Symbolic) -> tuple[kernel.Symbolic, kernel.Symbolic]:
        """Return what forces on the nodes, N, shape (d, ·), do to points and vectors.

        The sum of the forces on a bar, or the force on a string node; and the force on the end
        less that on the start, or the force on the tip of a bar that swings.
        """
        start, end = forces[:, self._start], forces[:, self._end]
        points = ca.horzcat(start + end, forces[:, self._string_nodes])
        return points, ca.horzcat(end - start, forces[:, self._tip])


def _row(values: FloatArray) -> ca.DM:
    return ca.DM(np.asarray(values)).T
