"""Record of bars whose lengths are driven: lengths, forces, and the work of the drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces, polynomial_at
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.dense_motion import SHARES, WEIGHTS, DenseMotion
from tenscontrol.simulation.motion_functions import BLOCK, by_node
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
    """

    bar: IntArray
    length: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    force: FloatArray
    work: FloatArray

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
        return (
            f"struts            bar{'s' * (len(self.bar) > 1)} {some}: stroke {stroke:.3g} m, at "
            f"most {rate:.3g} m/s and {force:.3g} N, {self.work[:, -1].sum():.4g} J in all"
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


def recorded_struts(
    dense: DenseMotion, nodes: FloatArray, velocities: FloatArray, force_density: FloatArray
) -> StrutRecord:
    """Return what driven bars did in a run, by the motion between the states kept.

    Of nodes and velocities, (d, n, T), and γ, (α, T), at the times kept.
    """
    run = dense.run
    assert run.bars is not None  # else nothing is recorded
    length, rate, acceleration = (run.all_values(run.length_rows, order) for order in range(3))
    load = run.all_values(run.load_rows) if isinstance(run.load, Pieces) else _column(run.load)
    motion = by_node(nodes), by_node(velocities)
    histories = length, rate, acceleration
    density = driven_bar_forces(run.model, *motion, force_density, load, histories)
    kept = (*histories, density * length, _work(dense).cumsum(axis=1))
    return StrutRecord(frozen(run.bars.bars), *(frozen(history) for history in kept))


def _work(dense: DenseMotion) -> FloatArray:
    """Return what the drives do in each part of a motion, J, shape (β, K)."""
    run, count = dense.run, len(dense.ends)
    structure, shares = run.model.structure, len(SHARES)
    work = np.zeros((len(structure.bars), count))
    for first in range(0, count, BLOCK):
        some = np.arange(first, min(first + BLOCK, count))
        k = np.repeat(some, shares)
        time, x = dense.at(np.tile(SHARES, len(some)), k)
        strings, bars = (dense.values(rows, time, k) for rows in (run.string_rows, run.length_rows))
        load = dense.values(run.load_rows, time, k)[0]
        load = load if isinstance(run.load, Pieces) else _column(run.load)
        power = _powers(run, x, strings[0], load, bars).reshape(len(work), len(some), shares)
        work[:, some] = power @ WEIGHTS * (dense.ends - dense.begins)[some]
    first_of = np.flatnonzero(np.diff(dense.of, prepend=-1))
    for i in range(2, len(run.spans)):  # the run begins after the first jump
        jump = run.spans[i].jump
        if jump is not None and jump.bars is not None:
            work[:, first_of[i]] += _impulse_work(run, i, jump.bars)
    return work


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


def _impulse_work(run: PlantRun, i: int, jump: FloatArray) -> FloatArray:
    """Return what impulses do by which rates jump at the beginning of a span, J, shape (β,)."""
    span, before = run.spans[i], run.spans[i - 1]
    now = before.time[-1:]
    given = span.coefficients[run.length_rows]
    length, after = (polynomial_at(given, now - span.origin, order) for order in (0, 1))
    inputs = span.coefficients[:, :, None]
    x = run.all_nodes(before.states[:, -1:], inputs, now - span.origin)
    gamma, load = np.zeros((len(run.model.structure.strings), 1)), np.zeros((len(x) // 2, 1))
    (nodes, velocities), still, change = np.split(x, 2), np.zeros_like(after), jump[:, None]
    impulse, none = (
        driven_bar_forces(run.model, nodes, velocities, gamma, load, (length, still, acceleration))
        for acceleration in (change, still)
    )
    return np.asarray((impulse - none) * length * (after - change / 2))[:, 0]


def _column(load: FloatArray) -> FloatArray:
    return load.ravel(order="F")[:, None]
