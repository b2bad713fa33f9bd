"""Record of bars whose lengths are driven: lengths, forces, and the work of the drives."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray, frozen
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
    force_density: FloatArray,
    load: FloatArray,
    bars: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Return λ of all bars at times, N/m, shape (β, T), of bars whose lengths are driven.

    Of nodes, velocities and loads of all nodes, (d n, T), node by node; γ, (α, T); and lengths of
    the bars, their rates and accelerations, (β, T) each.
    """
    function = model.prepared.get("driven bar forces", lambda: _of_columns(model))
    d, count = model.structure.dimension, nodes.shape[1]
    rows = (d * model.structure.free[:, None] + np.arange(d)).ravel()
    length, rate, acceleration = bars
    given = [nodes[rows], velocities[rows], force_density]
    if model.has_external_force:
        built_in = model.constant_force.ravel(order="F")[:, None]
        given.append(np.broadcast_to(load - built_in, (len(load), count))[rows])
    return evaluate_columns(function, *given, length * acceleration + rate**2)[0]


def _of_columns(model: Model) -> ca.Function:
    """Return the function of the forces of driven bars, with columns as arguments."""
    function = model.driven_bar_force_density
    shapes = [function.size_in(i) for i in range(function.n_in())]
    columns: list[Any] = [ca.MX.sym(f"column{i}", m * n) for i, (m, n) in enumerate(shapes)]
    matrices = [ca.reshape(c, *shape) for c, shape in zip(columns, shapes, strict=True)]
    return Function("of_columns", columns, [ca.densify(function(*matrices))])


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
    gamma = functions.inputs
    if run.input == "rest_length":
        gamma = functions.of("string_force_density", nodes, velocities, gamma)[0]
    load = run.all_values(run.load_rows) if isinstance(run.load, Pieces) else _column(run.load)
    return driven_bar_forces(run.model, by_node(nodes), by_node(velocities), gamma, load, bars)


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
        load = load if isinstance(run.load, Pieces) else _column(run.load)
        power = _powers(run, x, strings[0], load, bars).reshape(len(work), len(some), shares)
        work[:, some] = power @ WEIGHTS * np.diff(times)[some]
    return work[:, :0], work


def _powers(
    run: PlantRun, x: FloatArray, held: FloatArray, load: FloatArray, bars: FloatArray
) -> FloatArray:
    """Return the power of each drive, W, shape (β, T), in states of all nodes."""
    gamma = held
    if run.input == "rest_length":
        rows, half = run.model.structure.free_rows, len(x) // 2
        state = x[np.concatenate([rows, half + rows])]
        gamma = evaluate_columns(run.model.string_force_density, state, held)[0]
    nodes, velocities = np.split(x, 2)
    length, rate, acceleration = bars
    moved = length, rate, acceleration
    density = driven_bar_forces(run.model, nodes, velocities, gamma, load, moved)
    return np.asarray(density * length * rate)


def impulse_work(run: PlantRun, i: int, state: FloatArray) -> FloatArray:
    """Return what impulses do by which rates jump at the beginning of a span, J, shape (β,).

    Of the state before the jump, shape (states,).
    """
    span, before = run.spans[i], run.spans[i - 1]
    if span.jump is None or span.jump.bars is None:
        return np.zeros(len(run.model.structure.bars))
    now = before.time[-1:]
    given = span.coefficients[run.length_rows]
    length, after = (polynomial_at(given, now - span.origin, order) for order in (0, 1))
    x = run.all_nodes(state[:, None], span.coefficients[:, :, None], now - span.origin)
    gamma, load = np.zeros((len(run.model.structure.strings), 1)), np.zeros((len(x) // 2, 1))
    (nodes, velocities), still = np.split(x, 2), np.zeros_like(after)
    change = span.jump.bars[:, None]
    impulse, none = (
        driven_bar_forces(run.model, nodes, velocities, gamma, load, (length, still, acceleration))
        for acceleration in (change, still)
    )
    return np.asarray((impulse - none) * length * (after - change / 2))[:, 0]


def _column(load: FloatArray) -> FloatArray:
    return load.ravel(order="F")[:, None]
