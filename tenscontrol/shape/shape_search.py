"""Search for the equilibrium shape that meets the demands, or misses them least."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function, builds
from tenscontrol.dynamics.model import Model
from tenscontrol.shape.demands import CentreKept, Demand
from tenscontrol.shape.force_bounds import ForceLimits, choose_force_density
from tenscontrol.shape.held_strings import HeldStrings
from tenscontrol.shape.nonlinear_program import EXACT, MIRRORED, ShapeProblem
from tenscontrol.shape.symmetry import RotationalSymmetry
from tenscontrol.statics.prestress import Prestress, UnbalancedError, prestress
from tenscontrol.structure.bar_clearance import bar_distances
from tenscontrol.structure.bar_geometry import bar_lengths
from tenscontrol.structure.structure import Structure

# Weights of misses against distance from the start, one search after the other; the longer list is
# for starts from which the first fails.
_WEIGHTS = ((1e5, 1e7), (1.0, 1e2, 1e5, 1e7))

# Weight of the forces against distance from the start, where no level is given.
_FORCES = 1e-2

# Strings keep this fraction of their length at the start: without length, no direction.
_SHORT = 1e-2

# Misses and gaps to a bound below this are zero, for Newton to bring to round-off.
_CLOSE = 1e-5

# How often strings are pinned to bounds that Newton left.
_PINNINGS = 3

# A body is flat, so that it is its own mirror image, below this part of its size to the power 2 d.
_FLAT = 1e-6

# A demand is met when it is missed by less than this, in units of the size.
MET = 1e-9

# A stiffness below this fraction of the largest γ is none.
STIFF = 1e-9

# Starts beside the given one, off by this fraction of the size: some demands
# have no first-order effect in a symmetric shape.
_NUDGES, _NUDGE = 3, 0.1


@dataclass(frozen=True, eq=False)
class Solved:
    """An equilibrium and how far it is from the demands."""

    rest: Prestress
    rest_length: FloatArray | None
    misses: FloatArray  # found less wanted
    scales: FloatArray  # the unit of size of each miss
    margin: float  # N/m
    outside: float  # how far the rows of the demands are outside their bounds

    @property
    def is_stable(self) -> bool:
        """Whether the stiffness is more than round-off."""
        return self.margin > STIFF * float(self.rest.force_density.max(initial=0.0))


# An expression with its lower and upper bounds.
Rows = tuple[Any, FloatArray, FloatArray]


class _DemandRows:
    """Demands and bounds as rows ``low ≤ expression ≤ high``, in units of the size."""

    def __init__(
        self,
        problem: ShapeProblem,
        demands: tuple[Demand, ...],
        limits: ForceLimits,
        start: FloatArray,
    ) -> None:
        model, size, bounds = problem.model, problem.size, limits.bounds
        misses = [demand.miss(problem.nodes) for demand in demands]
        units = [size if demand.unit == "m" else 1.0 for demand in demands]
        counts = [miss.numel() for miss in misses]
        hard = np.repeat([isinstance(demand, CentreKept) for demand in demands], counts)
        self.scales = np.repeat(units, counts)
        blocks: list[Rows] = [(ca.SX(0, 1), np.zeros(0), np.zeros(0))]
        for demand, miss, unit in zip(demands, misses, units, strict=True):
            off = np.full(miss.numel(), demand.tolerance / unit)
            blocks.append((miss / unit, -off, off))
        capped = np.flatnonzero(np.isfinite(bounds.high))
        if len(capped):
            gamma = problem.gamma[capped.tolist()] / problem.level
            most = bounds.high[capped] / problem.level
            blocks.append((gamma, np.full(len(capped), -np.inf), most))
        if bounds.rest_length is not None:
            assert model.strings is not None  # checked with the winches
            length = kernel.string_lengths(model.structure, problem.nodes).T
            rest_length = model.strings.taut_rest_length(length, problem.gamma)
            shortest, longest = bounds.rest_length
            blocks.append((rest_length / size, shortest / size, longest / size))
        if limits.strokes is not None:
            shortest, longest = limits.strokes
            blocks.append((problem.bar_lengths / size, shortest / size, longest / size))
        if limits.clearance:
            apart = _signed_distances(model.structure, start, problem.nodes)
            least = np.full(apart.numel(), limits.clearance / size)
            blocks.append((apart / size, least, np.full(apart.numel(), np.inf)))
        self.rows = ca.vertcat(*(rows for rows, _, _ in blocks))
        #: Rows that may be missed, at a cost.
        self.soft = np.setdiff1d(np.arange(self.rows.numel()), np.flatnonzero(hard))
        self.low = np.concatenate([low for _, low, _ in blocks])
        self.high = np.concatenate([high for _, _, high in blocks])
        self._evaluate = Function("rows", [problem.unknowns], [ca.densify(self.rows)])
        every = ca.densify(ca.vertcat(ca.SX(0, 1), *misses))
        self._misses = Function("misses", [problem.unknowns], [every])

    def misses(self, values: FloatArray) -> FloatArray:
        """Return found less wanted numbers, m or rad."""
        return np.array(self._misses(values).full()).ravel()

    def outside(self, values: FloatArray) -> FloatArray:
        """Return by how much each row is outside its bounds."""
        rows = np.array(self._evaluate(values).full()).ravel()
        return np.asarray(np.maximum(np.maximum(self.low - rows, rows - self.high), 0.0))

    def at_bound(self, values: FloatArray, reach: float) -> Any:
        """Return the rows at a bound or beyond, by ``reach`` at most, less the bound."""
        levels = np.array(self._evaluate(values).full()).ravel()
        bound = np.where(
            np.abs(levels - self.low) <= np.abs(levels - self.high),
            self.low,
            self.high,
        )
        inside = np.minimum(levels - self.low, self.high - levels)
        rows = np.flatnonzero((inside < _CLOSE) & (inside >= -reach))
        if len(rows) == 0:
            return ca.SX(0, 1)
        return self.rows[rows.tolist()] - ca.DM(bound[rows])


def _signed_distances(structure: Structure, nodes: FloatArray, N: Any) -> Any:
    """Return distances of bars that pass one another in a shape, m, smooth in N."""
    distances = bar_distances(structure, nodes)
    rows = []
    for (i, j), side in zip(distances.pairs.tolist(), distances.side.tolist(), strict=True):
        if side:
            u, v = (N[:, end] - N[:, start] for start, end in structure.bars[[i, j]].tolist())
            across = ca.cross(u, v)
            gap = N[:, int(structure.bars[i, 0])] - N[:, int(structure.bars[j, 0])]
            rows.append(side * ca.dot(across, gap) / ca.norm_2(across))
    return ca.vertcat(*rows) if rows else ca.SX(0, 1)


def turned_over(structure: Structure, before: FloatArray, after: FloatArray) -> bool:
    """Return whether a rigid body of bars is the mirror image of what it was."""
    d = structure.dimension
    for block in structure.blocks:
        free = d * len(block.nodes)
        if len(block.rows) == free == len(block.independent) + d * (d + 1) // 2:
            one, other = (
                nodes[:, block.nodes] - nodes[:, block.nodes].mean(axis=1, keepdims=True)
                for nodes in (before, after)
            )
            size = (np.linalg.norm(one) * np.linalg.norm(other)) ** d
            if np.linalg.det(one @ other.T) < -_FLAT * size:
                return True
    return False


class _EquilibriumSearch:
    """Search for equilibria near a shape, each nearer to the demands than the one before."""

    def __init__(
        self,
        problem: ShapeProblem,
        demanded: _DemandRows,
        limits: ForceLimits,
        kind: str,
        start: FloatArray,
    ) -> None:
        self._problem, self._demanded, self._start = problem, demanded, start
        level = ca.SX(0, 1)  # the equation of the level, if it is given
        if limits.level is not None:
            mean = ca.sum1(problem.gamma[limits.reference.tolist()]) / len(limits.reference)
            level = mean / limits.level - 1
        self._level, self._tensions = level, _orbit_bounds(problem, limits)
        self._gamma = np.clip(limits.scale, limits.bounds.low, limits.bounds.high)
        structure = problem.model.structure
        S = kernel.differences(problem.nodes, structure.segments)
        squares = kernel.dots(S, S).T / problem.size**2
        segment_length = np.linalg.norm(structure.string_vectors(start), axis=0)
        shortest = (_SHORT * segment_length / problem.size) ** 2
        e, missed = ca.SX.sym("e", len(demanded.soft)), ca.SX(demanded.rows.numel(), 1)
        missed[demanded.soft.tolist()] = e
        stretch = problem.dependent_stretch
        off = np.full(stretch.numel(), MIRRORED)
        self._misses = e
        self._rows = [
            (stretch, -off, off),
            (demanded.rows - missed, demanded.low, demanded.high),
            (level, np.zeros(level.numel()), np.zeros(level.numel())),
            (squares, shortest, np.full(len(shortest), np.inf)),
        ]
        if problem.held is not None and problem.held.struts is not None:
            bars, length = problem.held.driven_bars, bar_lengths(structure, start)
            lengths, least = problem.bar_lengths[bars.tolist()], _SHORT * length[bars]
            most = np.full(len(bars), np.inf)
            self._rows.append((lengths / problem.size, least / problem.size, most))
        home = problem.start(start, self._gamma)[: problem.positions.numel()]
        self._away = ca.sumsqr(problem.positions - ca.DM(home))
        self._forces = ca.SX(0)
        if limits.level is None and not limits.is_settled:
            self._forces = _FORCES * _prestress_cost(problem, limits, kind)

    def equilibria(self, nodes: FloatArray) -> Iterator[FloatArray]:
        """Yield the unknowns of one equilibrium after the other, from a shape on."""
        problem, e = self._problem, self._misses
        for weights in _WEIGHTS:
            guess = np.concatenate([problem.start(nodes, self._gamma), np.zeros(e.numel())])
            for weight in weights:
                objective = self._away + weight * ca.sumsqr(e) + self._forces
                guess, success = problem.search(objective, self._rows, e, *self._tensions, guess)
                if not success:
                    break
                values = _polished(problem, self._demanded, self._level, self._tensions, guess)
                if values is not None and not turned_over(
                    problem.model.structure, self._start, problem.read(values)[0]
                ):
                    yield values
            else:
                return


@builds
def solve_shape(
    model: Model,
    demands: tuple[Demand, ...],
    limits: ForceLimits,
    kind: str,
    symmetry: RotationalSymmetry | None,
    start: FloatArray,
    held: HeldStrings | None = None,
) -> Solved | None:
    """Return the equilibrium nearest to the start that meets the demands, or misses them least."""
    problem = ShapeProblem(model, start, limits.scale, symmetry, held)
    demanded = _DemandRows(problem, demands, limits, start)
    search = _EquilibriumSearch(problem, demanded, limits, kind, start)
    random = np.random.default_rng(0)
    best: Solved | None = None
    for k in range(1 + _NUDGES):
        aside = _NUDGE * problem.size * random.uniform(-1.0, 1.0, size=start.shape)
        for values in search.equilibria(start if k == 0 else start + aside):
            outside = float(np.linalg.norm(demanded.outside(values)))
            if best is None or outside < max(best.outside, MET):
                solved = _finished(problem, demanded, limits, kind, values, outside)
                if solved is None:
                    continue
                if best is None or best.outside > MET or solved.margin > best.margin:
                    best = solved
            if outside <= MET:
                break
        if best is not None and best.outside <= MET and best.is_stable:
            break
    return best


def _prestress_cost(problem: ShapeProblem, limits: ForceLimits, kind: str) -> Any:
    """Return the cost of the forces without a level: their size, or distance from the centre."""
    if kind == "least":
        return ca.sumsqr(problem.gamma / problem.level) / len(limits.bounds.low)
    room = limits.bounds.high - limits.bounds.low
    wide = np.flatnonzero(room > 0)
    off = problem.gamma[wide.tolist()] - ca.DM((limits.bounds.low + limits.bounds.high)[wide] / 2)
    return ca.sumsqr(off / ca.DM(room[wide])) / len(limits.bounds.low)


def _orbit_bounds(problem: ShapeProblem, limits: ForceLimits) -> tuple[FloatArray, FloatArray]:
    """Return hard bounds of γ in units of the level, for each set of strings that share one."""
    orbits = problem.string_orbits > 0
    low = np.array([limits.bounds.low[column].max() for column in orbits.T]) / problem.level
    high = np.array([limits.bounds.largest[column].min() for column in orbits.T]) / problem.level
    return low, high


def _polished(
    problem: ShapeProblem,
    demanded: _DemandRows,
    level: Any,
    bounds: tuple[FloatArray, FloatArray],
    values: FloatArray,
) -> FloatArray | None:
    """Return the unknowns with equations, and demands that can be met, at round-off."""
    values = values[: problem.unknowns.numel()]
    low, high = bounds
    # All demands if Newton converges; else those that are nearly met; else equilibrium only.
    for rows in (demanded.at_bound(values, np.inf), demanded.at_bound(values, _CLOSE), ca.SX(0, 1)):
        g = values[problem.tension_rows]
        for _ in range(_PINNINGS):
            at_low, at_high = g - low < _CLOSE, high - g < _CLOSE
            pinned = np.flatnonzero(at_low | at_high)
            bound = np.where(at_low, low, high)
            at_bound = ca.vec(problem.tensions[pinned.tolist()]) - ca.DM(bound[pinned])
            point, left = problem.polish(values, ca.vertcat(level, at_bound, rows))
            if np.abs(left).max(initial=0.0) > EXACT:
                break
            g = point[problem.tension_rows]
            g[pinned] = bound[pinned]
            if (g >= low).all() and (g <= high).all():
                return point
    return None


def _first_balanced(
    structure: Structure, choices: list[FloatArray], limits: ForceLimits, load: FloatArray
) -> Prestress | None:
    """Return the first γ that balance: where bars are in line, those chosen may not."""
    for gamma in choices:
        with suppress(UnbalancedError):
            return prestress(structure, np.maximum(gamma, limits.bounds.low), external_force=load)
    return None


def _finished(
    problem: ShapeProblem,
    demanded: _DemandRows,
    limits: ForceLimits,
    kind: str,
    values: FloatArray,
    outside: float,
) -> Solved | None:
    """Choose the forces in the shape that was found, and measure it; None if none balance."""
    model = problem.model
    nodes, gamma = problem.read(values)
    structure = replace(model.structure, nodes=nodes)
    length = structure.string_length()
    low, high = limits.bounds.at_lengths(length, model.strings)
    is_ganged = problem.held is not None and problem.held.actuation.is_ganged
    if problem.held is not None:
        passive = problem.held.actuation.passive
        low, high = low.copy(), high.copy()
        low[passive] = high[passive] = gamma[passive]
    choices = [gamma]
    if (low <= high).all() and not is_ganged and not limits.is_settled:
        chosen = choose_force_density(structure, model.constant_force, limits, low, high, kind)
        choices = ([] if chosen is None else [chosen]) + choices
    rest = _first_balanced(structure, choices, limits, model.constant_force)
    if rest is None:
        return None
    rest_length = None
    if model.strings is not None:
        rest_length = model.strings.rest_length(length, rest.force_density)
    return Solved(
        rest=rest,
        rest_length=rest_length,
        misses=demanded.misses(values),
        scales=demanded.scales,
        margin=problem.stability_margin(rest),
        outside=outside,
    )
