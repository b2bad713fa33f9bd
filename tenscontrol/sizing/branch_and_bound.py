"""Branch and bound over the areas of bars that buckle."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.sizing.area_program import BUCKLING_OR_LEAST, AreaProgram
from tenscontrol.statics.equilibrium_matrix import matrix_rank

# Tangents of the root of a force begin at these parts of the largest force of a bar, one after the
# other. The error of the mass is the root of the last.
_FLOORS = (0.03, 1e-8, 1e-13)

# Programs in a row, and the gain of mass at which they end.
_MOST_PROGRAMS, _GAIN = 50, 1e-10

# A mass is the least when the bound is this close, part of it.
CLOSE = 1e-6

# The part of starts that branch and bound takes at most; the rest is random.
_BRANCHES = 0.5


# A range of areas is cut where its bound has them, but no nearer to its ends than this part of it.
_INSIDE = 0.05

# Members up to which states of self-stress are looked up, and the part of one that is none.
_DENSE, _NO_PART = 500, 1e-9


class Search(NamedTuple):
    """Masses and forces from each start, and the mass that none is below."""

    results: list[tuple[float, FloatArray]]
    bound: float  # kg


class _Range(NamedTuple):
    """Areas of members from low to high, and the relaxed program over them."""

    bound: float  # kg
    number: int  # tells ranges of one bound apart
    low: FloatArray  # (m,), m²
    high: FloatArray  # (m,), m²
    x: FloatArray  # (K, m)
    area: FloatArray  # (m,), areas that the bound counts, m²


def search(program: AreaProgram, by_yield: FloatArray, starts: int, seed: int) -> Search:
    """Return what is found from forces of yield alone, then by branch and bound, then at random.

    It ends where the bound shows that there is no less mass, or after so many starts.
    """
    tree = _Tree(program, by_yield)
    if not tree.is_least and starts > 1:
        tree.branch()
        if not tree.is_least:
            tree.descend(by_yield, _FLOORS)
        while not tree.is_least and tree.count < _BRANCHES * starts and tree.ranges:
            tree.branch()
        random = np.random.default_rng(seed)
        while not tree.is_least and tree.count < starts:
            tree.perturb(random)
    return Search(tree.results, tree.bound)


class _Tree:
    """Ranges of areas in which there may be less mass, and the masses found so far."""

    def __init__(self, program: AreaProgram, by_yield: FloatArray) -> None:
        self._program = program
        self._alpha, self._beta = len(program.least_pull), len(program.per_push)
        self._closed = np.inf  # the least bound of ranges that are given up
        self.count = 1
        self.ranges: list[_Range] = []
        self.results = [_improved(program, by_yield, _FLOORS[-1:])]
        # By yield alone: what no member can do without.
        area = program.of_groups(program.areas(by_yield)[[0, 1, 3]].max(axis=(0, 1)))
        least = float(program.per_area @ area)
        self._is_root = self._beta > 0 and self.mass > least * (1 + CLOSE)
        if self._is_root:
            self.ranges.append(_Range(least, 0, *_first_range(program, by_yield), by_yield, area))

    @property
    def mass(self) -> float:
        """The least mass so far, kg."""
        return min(mass for mass, _ in self.results)

    @property
    def bound(self) -> float:
        """The mass that none is below, kg."""
        lowest = self.ranges[0].bound if self.ranges else np.inf
        return float(min(lowest, self._closed, self.mass))

    @property
    def is_least(self) -> bool:
        """Whether the bound shows that no mass is less."""
        return self.bound >= self.mass * (1 - CLOSE)

    def branch(self) -> None:
        """Cut the range of the least bound in two where its areas are furthest from the true."""
        chosen = heapq.heappop(self.ranges)
        if self._is_root:
            self._is_root = False
            self._look(chosen.low, chosen.high)
            return
        program = self._program
        true = program.shared(chosen.x)
        lack = np.bincount(program.group, program.per_area * (true - chosen.area))
        group = program.group == lack.argmax()
        low, high = chosen.low[group].max(), chosen.high[group].min()
        margin = _INSIDE * (high - low)
        cut = np.clip(true[group].max(), low + margin, high - margin)
        self._look(chosen.low, np.where(group, cut, chosen.high))
        self._look(np.where(group, cut, chosen.low), chosen.high)

    def perturb(self, random: np.random.Generator) -> None:
        """Start from tangents that are changed at random, at the least mass or anywhere."""
        program = self._program
        x = min(self.results, key=lambda result: result[0])[1]
        largest = np.abs(x[:, self._alpha :]).max(initial=1.0)
        area = program.per_root * np.sqrt(largest)
        if self.count % 4:
            pushed = program.per_root * np.sqrt(_FLOORS[0] * largest)
            area = np.maximum(program.shared(x)[self._alpha :], pushed)
        area = area * 10 ** random.uniform(-1, 1, self._beta)
        start = program.solve(0.5 * program.per_root**2 / area, np.zeros(self._beta))
        if start is None:
            raise ArithmeticError("the linear program of least mass lost its solution")
        self.count += 1
        self.descend(start, _FLOORS[-1:])

    def _look(self, low: FloatArray, high: FloatArray) -> None:
        """Solve the relaxed program of a range, and keep it where there may be less mass."""
        program = self._program
        # No group has more area than leaves the others the least of theirs.
        beyond = self.mass - float(program.per_area @ low)
        if beyond < 0:
            return
        of_group = np.bincount(program.group, program.per_area)[program.group]
        high = np.minimum(high, low + beyond / of_group)
        relaxed = program.relaxed(low, high)
        self.count += 1
        if relaxed is None:
            return
        bound, x, area = relaxed
        if bound < self.mass * (1 - CLOSE) and abs(program.mass(x) / self.mass - 1) > _GAIN:
            self.descend(x, _FLOORS[-1:])
        if bound < self.mass * (1 - CLOSE):
            heapq.heappush(self.ranges, _Range(bound, self.count, low, high, x, area))
        else:
            self._closed = min(self._closed, bound)

    def descend(self, x: FloatArray, floors: tuple[float, ...]) -> None:
        """Add the mass where programs from these forces end."""
        self.results.append(_improved(self._program, x, floors))


def _first_range(program: AreaProgram, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest areas of members, by bounds and by forces that none changes.

    Where bars have no part in any self-stress, loads alone determine their forces.
    """
    alpha, count = len(program.least_pull), len(program.group)
    low = program.least_area.copy()
    low[:alpha] = np.maximum(low[:alpha], program.per_pull[:alpha] * program.least_pull)
    high = np.full(count, np.inf)
    if count <= _DENSE:
        _, sizes, Vt = np.linalg.svd(program.balance.toarray())
        states = Vt[matrix_rank(sizes) :]
        is_fixed = np.abs(states).max(axis=0, initial=0.0) < _NO_PART
        low[is_fixed] = program.areas(x)[:, :, is_fixed].max(axis=(0, 1))
        low = program.of_groups(low)
        free_groups = np.unique(program.group[~is_fixed])
        high[~np.isin(program.group, free_groups)] = 0.0
        high = np.maximum(high, low * (1 + _NO_PART))
    return program.of_groups(low), high


def _improved(
    program: AreaProgram, x: FloatArray, floors: tuple[float, ...]
) -> tuple[float, FloatArray]:
    """Return mass and forces where programs with tangents at the last forces end.

    A bar without force has a steep tangent, so that it stays without. Tangents begin at
    a floor, part of the largest force: from high to low, more bars come and go.
    """
    alpha = len(program.least_pull)
    best, least = x, program.mass(x)
    largest = np.abs(x[:, alpha:]).max(initial=1.0)
    for floor in floors:
        before = program.mass(x)
        # Where a pull sizes a bar, a tangent at its area lets pushes rise to what that bears; one
        # at its pushes lets the area fall. Both hold: one after the other.
        limits = [BUCKLING_OR_LEAST, slice(None)]
        tried = 0
        for _ in range(_MOST_PROGRAMS):
            area = program.shared(x, limits[tried])[alpha:]
            area = np.maximum(area, program.per_root * np.sqrt(floor * largest))
            trial = program.solve(0.5 * program.per_root**2 / area, 0.5 * area, x)
            if trial is None:
                raise ArithmeticError("the linear program of least mass lost its solution")
            mass = program.mass(trial)
            if mass < before * (1 - _GAIN):
                x, before, tried = trial, mass, 0
                continue
            tried += 1
            if tried == len(limits):
                break
        if before < least:
            best, least = x, before
    return least, best
