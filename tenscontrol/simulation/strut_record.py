"""Record of bars whose lengths are driven: lengths, forces, and the work of the drives."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.equation import unpack_states
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces, polynomial_at
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.dense_motion import SHARES, WEIGHTS, DenseMotion
from tenscontrol.simulation.motion_functions import BLOCK, MotionFunctions, by_node
from tenscontrol.simulation.plant_run import PlantRun


@dataclass(frozen=True, eq=False)
class StrutRecord:
    """What bars with a driven length did in a run.

    A bar has its mass spread evenly over its length, however long it is: that of a strut of many
    short tubes. Of two tubes it is an approximation; see the notes of :func:`simulate`.

    Attributes
    ----------
    bar : ndarray of int, shape (k,)
        Bars whose lengths change.
    length, rate, acceleration : ndarray, shape (β, T)
        Of all bars as they are driven, m, m/s and m/s². Where a rate jumps, those before.
    force : ndarray, shape (β, T)
        Along each bar, N, positive in compression.
    work : ndarray, shape (β, T)
        What the drives did by each time, J: the integral of :attr:`power`, and what the impulses
        did by which rates jump. By a quadrature of order 8 between the states that are kept.
    work_error : ndarray, shape (β, T), or None
        Estimate of the error of :attr:`work`, J, by the motion that the error of the run is found
        from; None where that is not estimated.
    """

    bar: IntArray
    length: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    force: FloatArray
    work: FloatArray
    work_error: FloatArray | None = None

    __repr__ = short_repr

    @property
    def power(self) -> FloatArray:
        """Power of each drive, W, shape (β, T): force times rate."""
        return self.force * self.rate

    @property
    def stroke(self) -> FloatArray:
        """Difference of the largest and the least length of each bar, m, shape (β,)."""
        return np.asarray(np.ptp(self.length, axis=1))

    def summary(self) -> str:
        """Return what the struts did, as text.

        Returns
        -------
        str
        """
        some = ", ".join(map(str, self.bar[:8])) + (", ..." if len(self.bar) > 8 else "")
        force, rate, stroke = (
            float(np.abs(values[self.bar]).max(initial=0.0))
            for values in (self.force, self.rate, self.stroke)
        )
        within = ""
        if self.work_error is not None:
            within = f" within {self.work_error[:, -1].sum():.1g} J"
        return (
            f"struts            bar{'s' * (len(self.bar) > 1)} {some}: stroke {stroke:.3g} m, at "
            f"most {rate:.3g} m/s and {force:.3g} N, {self.work[:, -1].sum():.4g} J in all{within}"
        )


def driven_bar_forces(
    model: Model,
    nodes: FloatArray,
    velocities: FloatArray,
    held: tuple[str, FloatArray],
    load: FloatArray,
    bars: tuple[FloatArray, FloatArray, FloatArray],
    offset: tuple[FloatArray, FloatArray] | None = None,
) -> FloatArray:
    """Return λ of all bars at times, N/m, shape (β, T), of bars whose lengths are driven.

    Of nodes, velocities and loads of all nodes, (d n, T), node by node; the input of the strings
    and its values, (α, T); and lengths of the bars, their rates and accelerations, (β, T) each.
    ``offset`` is what supports displace, and its rates, (d n, T) each: loads are then less by its
    inertia.
    """
    kind, values = held
    function = model.prepared.get(("driven bar forces", kind), lambda: _of_columns(model, kind))
    length, rate, acceleration = bars
    still = np.zeros_like(nodes)
    moved = (still, still) if offset is None else offset
    load = np.broadcast_to(load, nodes.shape)
    given = nodes, velocities, *moved, values, load
    return evaluate_columns(function, *given, length * acceleration + rate**2)[0]


def _of_columns(model: Model, kind: str) -> ca.Function:
    """Return the function of the forces of driven bars, with columns as arguments."""
    structure = model.structure
    shape, size = structure.nodes.shape, structure.nodes.size
    N, V, E, rate, W = columns = [ca.SX.sym(name, size) for name in ("N", "V", "E", "Ed", "W")]
    held, extension = (
        ca.SX.sym(name, len(members))
        for name, members in (("held", structure.strings), ("extension", structure.bars))
    )
    nodes, velocities, displaced, moving, load = (ca.reshape(column, *shape) for column in columns)
    forces = model.forces(kind).on_nodes(nodes, velocities, held, load)
    density = kernel.bar_force_density(
        structure, nodes - displaced, velocities - moving, forces, extension=extension.T
    )
    arguments = [N, V, E, rate, held, W, extension]
    return Function("of_columns", arguments, [ca.densify(density.T)])


def done_by_drives(run: PlantRun) -> tuple[FloatArray, FloatArray]:
    """Return λ of driven bars in a run and what the drives did, at all times kept, (β, T) each.

    See :func:`drive_work`.
    """
    bars = len(run.model.structure.bars)
    work, forces = [np.zeros((bars, 1))], [np.zeros((bars, 0))]
    for i, (before, span) in enumerate(pairwise(run.spans), 1):
        times = np.append(before.time[-1], span.time)
        states = np.column_stack([span.begin, span.states])
        density, done = drive_work(run, i, times, states)
        if i > 1 and done.shape[1]:  # the run begins after the first jump
            done[:, 0] += impulse_work(run, i, before.states[:, -1])
        work.append(done)
        forces.append(density if i == 1 else density[:, 1:])
    return np.hstack(forces), np.hstack(work).cumsum(axis=1)


def recorded_struts(
    run: PlantRun,
    done: tuple[FloatArray, FloatArray],
    work_error: FloatArray | None,
    functions: MotionFunctions,
    motion: tuple[FloatArray, FloatArray],
) -> StrutRecord:
    """Return what driven bars did in a run.

    By :func:`done_by_drives`, functions of the model at the times kept, and nodes and velocities
    there, (d, n, T).
    """
    assert run.bars is not None  # else nothing is recorded
    length, rate, acceleration = (run.all_values(run.length_rows, order) for order in range(3))
    density, work = done
    if any(block.is_redundant for block in run.model.structure.blocks) or run.core is None:
        density = _bar_forces(run, functions, *motion, (length, rate, acceleration))
    return StrutRecord(
        frozen(run.bars.bars),
        frozen(length),
        frozen(rate),
        frozen(acceleration),
        force=frozen(density * length),
        work=frozen(work),
        work_error=None if work_error is None else frozen(work_error),
    )


def _bar_forces(
    run: PlantRun, functions: MotionFunctions, nodes: FloatArray, velocities: FloatArray,
    bars: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:  # fmt: skip
    """Return λ at the times kept, N/m, shape (β, T)."""
    load = run.all_values(run.load_rows) if run.loads_given else _constant_load(run)
    offset = None
    if run.supports is not None:
        offset = run.all_values(run.offset_rows), run.all_values(run.offset_rows, 1)
    N, V = by_node(nodes), by_node(velocities)
    return driven_bar_forces(run.model, N, V, (run.input, functions.inputs), load, bars, offset)


def drive_work(
    run: PlantRun, i: int, times: FloatArray, states: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return λ of driven bars at times of a span of a run, and what drives do between them, J.

    Of states there, (states, K + 1), and with the shapes (β, K + 1) and (β, K). λ is that of the
    core, of redundant bars not of least norm; without the core it is left out, (β, 0).
    """
    span, core, quadrature = run.spans[i], run.core, (SHARES, WEIGHTS)
    if core is not None:
        u = run.packed(span.coefficients, float(times[0]) - span.origin)
        return core.strut_work(states, u, times - times[0], quadrature)
    count, shares = len(times) - 1, len(SHARES)
    dense = DenseMotion(
        run, np.full(count, i), times[:-1], times[1:], states[:, :-1], states[:, 1:]
    )
    work = np.zeros((len(run.model.structure.bars), count))
    for first in range(0, count, BLOCK):
        some = np.arange(first, min(first + BLOCK, count))
        k = np.repeat(some, shares)
        time, x = dense.at(np.tile(SHARES, len(some)), k)
        strings, bars = (dense.values(rows, time, k) for rows in (run.string_rows, run.length_rows))
        load = dense.values(run.load_rows, time, k)[0]
        load = load if run.loads_given else _constant_load(run)
        position, rate, _ = dense.values(run.offset_rows, time, k)
        offset = None if run.supports is None else (position, rate)
        nodes, velocities = np.split(x, 2)
        moved, held = (bars[0], bars[1], bars[2]), (run.input, strings[0])
        density = driven_bar_forces(run.model, nodes, velocities, held, load, moved, offset)
        power = (density * bars[0] * bars[1]).reshape(len(work), len(some), shares)
        work[:, some] = power @ WEIGHTS * np.diff(times)[some]
    return work[:, :0], work


def impulse_work(run: PlantRun, i: int, state: FloatArray) -> FloatArray:
    """Return what impulses of bars do where rates or supports jump before a span, J, shape (β,).

    Of the state before the jump, shape (states,).
    """
    span, before, count = run.spans[i], run.spans[i - 1], len(run.model.structure.bars)
    if span.jump is None:
        return np.zeros(count)
    change = np.zeros((count, 1)) if span.jump.bars is None else span.jump.bars[:, None]
    now = before.time[-1:]
    given = span.coefficients[run.length_rows]
    length, after = (polynomial_at(given, now - span.origin, order) for order in (0, 1))
    structure = run.model.structure
    nodes, velocities = map(by_node, unpack_states(structure, state[:, None]))
    held, none = ("force_density", np.zeros((len(structure.strings), 1))), np.zeros_like(nodes)
    push = none
    if span.jump.supports is not None and run.supports is not None:
        push = -run.supports.force(span.jump.supports)[:, None]
    still = np.zeros_like(after)
    impulse, without = (
        driven_bar_forces(run.model, nodes, velocities, held, load, (length, still, acceleration))
        for load, acceleration in ((push, change), (none, still))
    )
    return np.asarray((impulse - without) * length * (after - change / 2))[:, 0]


def _constant_load(run: PlantRun) -> FloatArray:
    """Return the load of a run in which it does not change, node by node, (d n, 1), N."""
    assert not isinstance(run.load, Pieces)  # else it is an input
    return run.load.ravel(order="F")[:, None]
