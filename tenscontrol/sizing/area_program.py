"""Linear programs for the least areas of members."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.properties import cached_property
from tenscontrol.statics.equilibrium_matrix import least_norm

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Limits of members, in their order: pull, push, buckling, least area.
_ALL = slice(None)
BUCKLING_OR_LEAST = slice(2, None)

# Unknowns and slacks below this part of the largest are zero.
_ROUND_OFF = 1e-11

# Regularization of the multipliers, part of the largest singular value squared.
_REGULAR = 1e-12

# Members above which an interior point takes less time than the simplex.
_LARGE = 3_000

# A reduced cost of the wrong sign up to this part of its terms is round-off.
_OPTIMAL = 1e-9


class _Segments(NamedTuple):
    """Forces of members in segments, each with an area per force: cheap ones fill first."""

    start: FloatArray  # (m,), the force that segments come on top of
    base: FloatArray  # (m,), the area that it asks for, m²
    slope: FloatArray  # (s,), area per unit force, m²
    most: FloatArray  # (s,), the longest that each can be, in unit forces


class _Layout(NamedTuple):
    """What the linear programs of a shape share: where segments and areas stand in them."""

    member: IntArray  # (s,), the member of each segment, in five blocks of ascending members
    sign: FloatArray  # (s,), −1 where a bar is pulled
    pulls: csr_array  # (m, s), forces by segments
    equal: csr_array  # balance of the forces of each load
    shares: IntArray  # (r,), members whose area is an unknown: they share it, or loads do
    owner: IntArray  # (r,), which one
    unit: FloatArray  # (g,), of areas that are unknowns, m²
    above: csr_array  # areas by segments: data are places in ``asking`` from 1 on, or −1
    asking: IntArray  # segments that ask for areas that are unknowns
    place: IntArray  # (m,), members in ``shares``


class _LinearProgram(NamedTuple):
    """Least ``cost · z`` with 0 ≤ z ≤ most, ``above z ≤ most_above`` and ``equal z = load``."""

    cost: FloatArray
    above: csr_array
    most_above: FloatArray
    equal: csr_array
    load: FloatArray
    most: FloatArray
    segments: _Segments

    def is_least(self, z: FloatArray) -> bool:
        """Return whether multipliers show that no other z has less cost.

        Unknowns between their bounds determine the multipliers y of rows without slack by
        ``Aᵀ y = cost``; then the reduced costs of all others must have the right signs.
        """
        from scipy.sparse import csc_array, vstack

        scale = np.abs(z).max(initial=1.0)
        tight = self.most_above - self.above @ z < _ROUND_OFF * scale
        rows = csc_array(vstack([self.equal, self.above[tight]]))
        is_low, is_high = z < _ROUND_OFF * scale, self.most - z < _ROUND_OFF * scale
        between = ~(is_low | is_high)
        y = least_norm(csc_array(rows[:, between].T), self.cost[between], _REGULAR)
        reduced = self.cost - rows.T @ y
        reduced /= np.abs(self.cost) + abs(rows).T @ np.abs(y) + np.finfo(float).tiny
        return bool(
            np.abs(reduced[between]).max(initial=0.0) < _OPTIMAL
            and reduced[is_low & ~is_high].min(initial=0.0) > -_OPTIMAL
            and reduced[is_high & ~is_low].max(initial=0.0) < _OPTIMAL
            and y[len(self.load) :].max(initial=0.0) < _OPTIMAL * np.abs(y).max(initial=1.0)
        )


@dataclass(frozen=True, eq=False)
class AreaProgram:
    """Least mass of a shape under K loads, by the forces x of its m members in units of one force.

    Strings come first and pull; bars push where x is positive. Members of a group share an area.
    """

    balance: csr_array  # (f, m), unit forces of members on free coordinates
    loads: FloatArray  # (K, f), in the unit
    least_pull: FloatArray  # (α,), in the unit
    per_pull: FloatArray  # (m,), area per unit force in tension, m²
    per_push: FloatArray  # (β,), area per unit force in compression by stress, m²
    per_root: FloatArray  # (β,), area per root of the unit force by buckling, m²
    least_area: FloatArray  # (m,)
    per_area: FloatArray  # (m,), mass for an area of 1 m², kg
    group: IntArray  # (m,), which area each member has

    def areas(self, x: FloatArray) -> FloatArray:
        """Return what each limit asks for, shape (4, K, m): pull, push, buckling, least."""
        alpha = len(self.least_pull)
        area = np.zeros((4, *x.shape))
        area[0] = self.per_pull * np.abs(x)
        push = np.maximum(x[:, alpha:], 0.0)
        area[0, :, alpha:] = self.per_pull[alpha:] * np.maximum(-x[:, alpha:], 0.0)
        area[1, :, alpha:] = self.per_push * push
        area[2, :, alpha:] = self.per_root * np.sqrt(push)
        area[3] = self.least_area
        return area

    def shared(self, x: FloatArray, limits: slice = _ALL) -> FloatArray:
        """Return the area of each member, the largest that its group asks for, shape (m,)."""
        return self.of_groups(self.areas(x)[limits].max(axis=(0, 1)))

    def of_groups(self, area: FloatArray) -> FloatArray:
        """Return the largest area of the group of each member, shape (m,)."""
        largest = np.zeros(self.group.max(initial=-1) + 1)
        np.maximum.at(largest, self.group, area)
        return np.asarray(largest[self.group])

    def mass(self, x: FloatArray) -> float:
        """Return the mass of all members under these forces, kg."""
        return float(self.per_area @ self.shared(x))

    def solve(
        self, slope: FloatArray, offset: FloatArray, start: FloatArray | None = None
    ) -> FloatArray | None:
        """Return forces, shape (K, m), of least mass where bars ask for offset + slope · push.

        None where no forces balance the loads. Forces to start from come back if no others have
        less: that is looked up by multipliers, in less time than a program takes.
        """
        program = self._linear_program(self._segments(slope, offset, self.least_area))
        if start is not None and program.is_least(self._filled(program, start)):
            return start
        return self._solved(program, is_yield=not slope.any())

    def relaxed(
        self, low: FloatArray, high: FloatArray
    ) -> tuple[float, FloatArray, FloatArray] | None:
        """Return a mass that none with bar areas from low to high, shape (m,), is below.

        With it, the forces of that mass, and the areas of members that it counts: roots of forces
        are replaced by their chords over the range. None where no forces balance the loads.
        """
        alpha = len(self.least_pull)
        least, most = low[alpha:], high[alpha:]
        first, last = (least / self.per_root) ** 2, (most / self.per_root) ** 2
        both = least + most
        slope = self.per_root**2 / np.where(both > 0, both, 1.0)
        offset = least - slope * first
        least_area = np.maximum(self.least_area, low)
        most_push = np.minimum(last, most / self.per_push)
        segments = self._segments(
            slope, offset, least_area, most / self.per_pull[alpha:], most_push
        )
        x = self._solved(self._linear_program(segments))
        if x is None:
            return None
        area = self.areas(x)
        area[3] = least_area
        area[2, :, alpha:] = offset + slope * x[:, alpha:]
        relaxed = self.of_groups(area.max(axis=(0, 1)))
        return float(self.per_area @ relaxed), x, relaxed

    def _solved(self, program: _LinearProgram, is_yield: bool = False) -> FloatArray | None:
        """Return the forces of a linear program, shape (K, m), or None if there are none."""
        from scipy.optimize import linprog

        cases, pieces = len(self.loads), len(program.segments.slope)
        is_large = len(self.group) > _LARGE
        answer = linprog(
            program.cost, program.above, program.most_above, program.equal, program.load,
            np.c_[np.zeros(len(program.cost)), program.most],
            method="highs-ipm" if is_large or is_yield else "highs-ds",
        )  # fmt: skip
        if answer.status == 2:
            return None
        if answer.status != 0:
            raise ArithmeticError(f"the linear program of least mass ended early: {answer.message}")
        # Bounds hold to the tolerance of the solver, balance to round-off.
        segment_forces = answer.x[: cases * pieces].reshape(cases, pieces)
        x = np.asarray(program.segments.start + (self._layout.pulls @ segment_forces.T).T)
        return np.where(np.abs(x) < _ROUND_OFF * np.abs(x).max(initial=0.0), 0.0, x)

    @cached_property
    def _layout(self) -> _Layout:
        from scipy.sparse import block_array, csr_array, eye_array, kron

        cases, count, alpha = len(self.loads), len(self.group), len(self.least_pull)
        members, bars = np.arange(count), np.arange(alpha, count)
        member = np.concatenate([members, members, bars, bars, bars])
        ways = np.r_[np.ones(alpha), -np.ones(count - alpha)]
        sign = np.r_[ways, ways, np.ones(3 * len(bars))]
        pieces = len(member)
        # The area of a member alone under one load is no unknown: its segments have mass.
        is_shared = (cases > 1) | (np.bincount(self.group, minlength=1)[self.group] > 1)
        shares = np.flatnonzero(is_shared)
        groups, owner = np.unique(self.group[shares], return_inverse=True)
        unit = np.full(len(groups), self.per_pull.min(initial=1.0))
        np.maximum.at(unit, owner, self.per_pull[shares])
        rows = np.arange(len(owner))
        served = csr_array((np.ones(len(owner)), (rows, owner)), shape=(len(owner), len(groups)))
        place = np.cumsum(is_shared) - 1
        asking = np.flatnonzero(is_shared[member])
        needs = csr_array(
            (np.arange(1.0, len(asking) + 1), (place[member[asking]], asking)),
            shape=(len(owner), pieces),
        )
        pulls = csr_array((sign, (member, np.arange(pieces))), shape=(count, pieces))
        identity = eye_array(cases)
        equal = [[kron(identity, self.balance @ pulls), csr_array((self.loads.size, len(groups)))]]
        above = [[kron(identity, needs), kron(np.ones((cases, 1)), -served, format="csr")]]
        return _Layout(
            member, sign, pulls, block_array(equal, format="csr"), shares, owner, unit,
            block_array(above, format="csr"), asking, place,
        )  # fmt: skip

    def _linear_program(self, segments: _Segments) -> _LinearProgram:
        """Return the program in segments of forces of each load, then areas of groups."""
        from scipy.sparse import csr_array

        layout, cases = self._layout, len(self.loads)
        shares, owner, unit, asking = layout.shares, layout.owner, layout.unit, layout.asking
        member, groups = layout.member[asking], len(layout.unit)
        asked = np.r_[-1.0, segments.slope[asking] / unit[owner[layout.place[member]]]]
        pattern = layout.above
        data = asked[np.maximum(pattern.data, 0.0).astype(int)]
        above = csr_array((data, pattern.indices, pattern.indptr), shape=pattern.shape)
        of_groups = unit * np.bincount(owner, self.per_area[shares], groups)
        alone = segments.slope * self.per_area[layout.member]
        alone[asking] = 0.0
        cost = np.r_[np.tile(alone, cases), of_groups]
        return _LinearProgram(
            # Costs of yield are about 1: solvers have tolerances that do not know of steep ones.
            cost / (self.per_pull * self.per_area).max(initial=np.finfo(float).tiny),
            above, np.tile(-segments.base[shares] / unit[owner], cases),
            layout.equal, (self.loads - self.balance @ segments.start).ravel(),
            np.r_[np.tile(segments.most, cases), np.full(groups, np.inf)], segments,
        )  # fmt: skip

    def _filled(self, program: _LinearProgram, x: FloatArray) -> FloatArray:
        """Return the unknowns of the program at forces x: segments filled in order, least areas."""
        start, _, _, most = program.segments
        member, sign = self._layout.member, self._layout.sign
        cases, groups = len(self.loads), len(self._layout.unit)
        left = np.stack([np.maximum(x - start, 0.0), np.maximum(start - x, 0.0)])
        filled = np.zeros((cases, len(member)))
        # Segments come in blocks of ascending members.
        for block in np.split(np.arange(len(member)), np.flatnonzero(np.diff(member) < 0) + 1):
            way = (sign[block] < 0).astype(int)
            take = np.minimum(left[way, :, member[block]].T, most[block])
            filled[:, block] = take
            left[way, :, member[block]] -= take.T
        unknowns = np.r_[filled.ravel(), np.zeros(groups)]
        if groups:
            needed = program.above @ unknowns - program.most_above
            of_groups = program.above[:, filled.size :]
            of_groups.eliminate_zeros()
            np.maximum.at(unknowns[filled.size :], of_groups.indices, needed)
        return np.asarray(unknowns)

    def _segments(
        self, slope: FloatArray, offset: FloatArray, least_area: FloatArray,
        most_pull: float | FloatArray = np.inf,
        most_push: float | FloatArray = np.inf,
    ) -> _Segments:  # fmt: skip
        """Return the forces of members in segments, cheap ones first, from where areas are least.

        The tangent goes on below no push, until tension or the least area ask for as much: so it
        does not bind a bar that is pulled.
        """
        alpha = len(self.least_pull)
        least, per_pull = least_area[alpha:], self.per_pull[alpha:]
        steep = np.maximum(slope, np.finfo(float).tiny)
        pull = np.where(offset > least, (offset - least) / steep, 0.0)
        pull = np.where(per_pull * pull > least, offset / (steep + per_pull), pull)
        start = np.r_[self.least_pull, -pull]
        base = np.maximum(least_area, self.per_pull * np.abs(start))
        flat = base / self.per_pull - np.abs(start)  # more pull for the same area
        pulled = np.r_[np.full(alpha, np.inf), most_pull - pull]
        flat = np.minimum(flat, pulled)
        # Of a push: what asks for no more, then the tangent up to where stress takes over.
        by_stress = base[alpha:] / self.per_push + pull
        by_root = np.where(slope > 0, (base[alpha:] - offset) / steep + pull, np.inf)
        pushed = most_push + pull
        level = np.minimum(np.maximum(np.minimum(by_root, by_stress), 0.0), pushed)
        over = self.per_push > slope
        end = np.where(over, offset / np.where(over, self.per_push - slope, 1.0), np.inf) + pull
        along = np.where(by_root < by_stress, np.maximum(end - level, 0.0), 0.0)
        along = np.minimum(along, pushed - level)
        last = np.where(
            np.isinf(along), 0.0, pushed - level - np.where(np.isinf(along), 0.0, along)
        )
        most = np.concatenate([flat, pulled - flat, level, along, last])
        most[most < _ROUND_OFF] = 0.0
        zero = np.zeros(len(flat))
        rates = np.concatenate([zero, self.per_pull, zero[alpha:], slope, self.per_push])
        return _Segments(start, base, np.where(most > 0, rates, 0.0), most)
