"""Linear programs for the least areas of members."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
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

# A reduced cost of the wrong sign up to this part of the largest cost is round-off.
_OPTIMAL = 1e-9


class _Segments(NamedTuple):
    """Forces of members in segments, each with an area per force: cheap ones fill first."""

    start: FloatArray  # (m,), the force that segments come on top of
    base: FloatArray  # (m,), the area that it asks for, m²
    member: IntArray  # (s,)
    sign: FloatArray  # (s,), −1 where a bar is pulled
    slope: FloatArray  # (s,), area per unit force, m²
    most: FloatArray  # (s,), the longest that each can be, in unit forces


class _LinearProgram(NamedTuple):
    """Least ``cost · z`` with 0 ≤ z ≤ most, ``above z ≤ most_above`` and ``equal z = load``."""

    cost: FloatArray
    above: csr_array
    most_above: FloatArray
    equal: csr_array
    load: FloatArray
    most: FloatArray
    segments: _Segments
    pulls: csr_array  # (m, s), forces by segments
    groups: int

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
        return bool(
            np.abs(reduced[between]).max(initial=0.0) < _OPTIMAL
            and reduced[is_low & ~is_high].min(initial=0.0) > -_OPTIMAL
            and reduced[is_high & ~is_low].max(initial=0.0) < _OPTIMAL
            and y[len(self.load) :].max(initial=0.0) < _OPTIMAL
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
        largest = np.zeros(self.group.max(initial=-1) + 1)
        np.maximum.at(largest, self.group, self.areas(x)[limits].max(axis=(0, 1)))
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
        from scipy.optimize import linprog

        program = self._linear_program(slope, offset)
        if start is not None and program.is_least(self._filled(program, start)):
            return start
        cases, pieces = len(self.loads), len(program.segments.member)
        is_large = len(self.group) > _LARGE
        answer = linprog(
            program.cost, program.above, program.most_above, program.equal, program.load,
            np.c_[np.zeros(len(program.cost)), program.most],
            method="highs-ipm" if is_large or not slope.any() else "highs-ds",
        )  # fmt: skip
        if answer.status == 2:
            return None
        if answer.status != 0:
            raise ArithmeticError(f"the linear program of least mass ended early: {answer.message}")
        segment_forces = answer.x[: cases * pieces].reshape(cases, pieces)
        x = np.asarray(program.segments.start + (program.pulls @ segment_forces.T).T)
        return np.where(np.abs(x) < _ROUND_OFF * np.abs(x).max(initial=0.0), 0.0, x)

    def _linear_program(self, slope: FloatArray, offset: FloatArray) -> _LinearProgram:
        """Return the program in segments of forces of each load, then areas of groups."""
        from scipy.sparse import block_array, csr_array, eye_array, kron

        cases, count = len(self.loads), len(self.group)
        segments = self._segments(slope, offset)
        member, pieces = segments.member, len(segments.member)
        # The area of a member alone under one load is no unknown: its segments have mass.
        shares = (cases > 1) | (np.bincount(self.group, minlength=1)[self.group] > 1)
        groups, owner = np.unique(self.group[shares], return_inverse=True)
        unit = np.full(len(groups), self.per_pull.min(initial=1.0))
        np.maximum.at(unit, owner, self.per_pull[shares])
        rows = np.arange(len(owner))
        served = csr_array((np.ones(len(owner)), (rows, owner)), shape=(len(owner), len(groups)))
        place = np.cumsum(shares) - 1
        own = shares[member]
        needs = csr_array(
            (segments.slope[own] / unit[owner[place[member[own]]]],
             (place[member[own]], np.flatnonzero(own))),
            shape=(len(owner), pieces),
        )  # fmt: skip
        pulls = csr_array((segments.sign, (member, np.arange(pieces))), shape=(count, pieces))
        identity = eye_array(cases)
        equal = [[kron(identity, self.balance @ pulls), csr_array((self.loads.size, len(groups)))]]
        above = [[kron(identity, needs), kron(np.ones((cases, 1)), -served, format="csr")]]
        of_groups = unit * np.bincount(owner, self.per_area[shares], len(groups))
        alone = np.where(own, 0.0, segments.slope * self.per_area[member])
        cost = np.r_[np.tile(alone, cases), of_groups]
        return _LinearProgram(
            cost / cost.max(initial=np.finfo(float).tiny),
            block_array(above, format="csr"), np.tile(-segments.base[shares] / unit[owner], cases),
            block_array(equal, format="csr"), (self.loads - self.balance @ segments.start).ravel(),
            np.r_[np.tile(segments.most, cases), np.full(len(groups), np.inf)],
            segments, pulls, len(groups),
        )  # fmt: skip

    def _filled(self, program: _LinearProgram, x: FloatArray) -> FloatArray:
        """Return the unknowns of the program at forces x: segments filled in order, least areas."""
        start, _, member, sign, _, most = program.segments
        cases, groups = len(self.loads), program.groups
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

    def _segments(self, slope: FloatArray, offset: FloatArray) -> _Segments:
        """Return the forces of members in segments, cheap ones first, from where areas are least.

        The tangent goes on below no push, until tension or the least area ask for as much: so it
        does not bind a bar that is pulled.
        """
        count, alpha = len(self.group), len(self.least_pull)
        least, per_pull = self.least_area[alpha:], self.per_pull[alpha:]
        steep = np.maximum(slope, np.finfo(float).tiny)
        pull = np.where(offset > least, (offset - least) / steep, 0.0)
        pull = np.where(per_pull * pull > least, offset / (steep + per_pull), pull)
        start = np.r_[self.least_pull, -pull]
        base = np.maximum(self.least_area, self.per_pull * np.abs(start))
        flat = base / self.per_pull - np.abs(start)  # more pull for the same area
        # Of a push: what asks for no more, then the tangent up to where stress takes over.
        by_stress = base[alpha:] / self.per_push + pull
        by_root = np.where(slope > 0, (base[alpha:] - offset) / steep + pull, np.inf)
        level = np.maximum(np.minimum(by_root, by_stress), 0.0)
        over = self.per_push > slope
        end = np.where(over, offset / np.where(over, self.per_push - slope, 1.0), np.inf) + pull
        along = np.where(by_root < by_stress, np.maximum(end - level, 0.0), 0.0)
        members, bars = np.arange(count), np.arange(alpha, count)
        ways = np.r_[np.ones(alpha), -np.ones(count - alpha)]
        zero, one, rest = np.zeros(count), np.ones(count), np.full(count, np.inf)
        blocks = [
            (members, ways, zero, flat),
            (members, ways, self.per_pull, rest),
            (bars, one[alpha:], zero[alpha:], level),
            (bars, one[alpha:], slope, along),
            (bars, one[alpha:], self.per_push, np.where(np.isinf(along), 0.0, np.inf)),
        ]
        columns = [np.concatenate(column) for column in zip(*blocks, strict=True)]
        kept = columns[3] > _ROUND_OFF
        return _Segments(start, base, *(column[kept] for column in columns))
