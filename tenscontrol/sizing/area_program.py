"""Linear programs for the least areas of members."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class _Segments(NamedTuple):
    """Forces of members in segments, each with an area per force: cheap ones fill first."""

    member: IntArray  # (s,)
    sign: FloatArray  # (s,), −1 where a bar is pulled
    slope: FloatArray  # (s,), area per unit force, m²
    most: FloatArray  # (s,), the longest that each can be, in unit forces


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

    def shared(self, x: FloatArray) -> FloatArray:
        """Return the area of each member, the largest that its group asks for, shape (m,)."""
        largest = np.zeros(self.group.max(initial=-1) + 1)
        np.maximum.at(largest, self.group, self.areas(x).max(axis=(0, 1)))
        return np.asarray(largest[self.group])

    def mass(self, x: FloatArray) -> float:
        """Return the mass of all members under these forces, kg."""
        return float(self.per_area @ self.shared(x))

    def solve(self, slope: FloatArray, offset: FloatArray) -> FloatArray | None:
        """Return forces, shape (K, m), of least mass where bars ask for offset + slope · push.

        None where no forces balance the loads.
        """
        from scipy.optimize import linprog
        from scipy.sparse import block_array, csr_array, eye_array, kron

        cases, count, alpha = len(self.loads), len(self.group), len(self.least_pull)
        base, segments = self._segments(slope, offset)
        member, pieces = segments.member, len(segments.member)
        # The area of a member alone under one load is no unknown: its segments have mass.
        shares = (cases > 1) | (np.bincount(self.group, minlength=1)[self.group] > 1)
        groups, owner = np.unique(self.group[shares], return_inverse=True)
        unit = np.full(len(groups), self.per_pull.min())
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
        least = np.zeros(count)
        least[:alpha] = self.least_pull
        each = eye_array(cases)
        equal = [[kron(each, self.balance @ pulls), csr_array((self.loads.size, len(groups)))]]
        above = [[kron(each, needs), kron(np.ones((cases, 1)), -served)]]
        of_groups = unit * np.bincount(owner, self.per_area[shares], len(groups))
        alone = np.where(own, 0.0, segments.slope * self.per_area[member])
        cost = np.r_[np.tile(alone, cases), of_groups]
        # The first program takes an interior point less time, those with tangents the simplex.
        first = not slope.any()
        answer = linprog(
            cost / cost.max(initial=np.finfo(float).tiny),
            block_array(above, format="csr"), np.tile(-base[shares] / unit[owner], cases),
            block_array(equal, format="csr"), (self.loads - self.balance @ least).ravel(),
            np.c_[np.zeros(len(cost)), np.r_[np.tile(segments.most, cases), np.inf * unit]],
            method="highs-ipm" if first else "highs-ds",
        )  # fmt: skip
        if answer.status == 2:
            return None
        if answer.status != 0:
            raise ArithmeticError(f"the linear program of least mass ended early: {answer.message}")
        found = answer.x[: cases * pieces].reshape(cases, pieces)
        return np.asarray(least + (pulls @ found.T).T)

    def _segments(self, slope: FloatArray, offset: FloatArray) -> tuple[FloatArray, _Segments]:
        """Return the area that members have in any case, shape (m,), and forces in segments."""
        count, alpha = len(self.group), len(self.least_pull)
        bars = np.arange(alpha, count)
        base = self.least_area.copy()
        base[:alpha] = np.maximum(base[:alpha], self.per_pull[:alpha] * self.least_pull)
        base[alpha:] = np.maximum(base[alpha:], offset)
        rest = np.full(count, np.inf)
        free = base / self.per_pull  # pulls that ask for no more
        free[:alpha] -= self.least_pull
        # Of a push: what asks for no more, then the tangent up to where stress takes over.
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = np.where(slope > 0, (base[alpha:] - offset) / slope, np.inf)
            over = np.where(self.per_push > slope, offset / (self.per_push - slope), np.inf)
        by_stress = base[alpha:] / self.per_push
        along = np.where(flat < by_stress, np.maximum(over - flat, 0.0), 0.0)
        flat = np.minimum(flat, by_stress)
        zero, one = np.zeros(count), np.ones(count)
        parts = [
            (np.arange(count), np.r_[one[:alpha], -one[alpha:]], zero, free),
            (np.arange(count), np.r_[one[:alpha], -one[alpha:]], self.per_pull, rest),
            (bars, one[alpha:], zero[alpha:], flat),
            (bars, one[alpha:], slope, along),
            (bars, one[alpha:], self.per_push, np.where(np.isinf(along), 0.0, np.inf)),
        ]
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        kept = columns[3] > 0
        return base, _Segments(*(column[kept] for column in columns))
