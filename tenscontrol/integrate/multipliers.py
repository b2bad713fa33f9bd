"""Bars that share nodes put on their lengths by Lagrange multipliers, block by block.

Positions are corrected along ``M⁻¹ Jᵀ`` by Newton's iteration, whose matrix ``[[M, Jᵀ], [J, 0]]``
is factorized once: symmetric, sparse, and solved without pivoting. Velocities are corrected by one
solution. Both corrections are impulses along the bars, so that momenta stay.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.integrate.integrator import where_needed
from tenscontrol.structure.blocks import node_mass
from tenscontrol.structure.structure import Structure

# Steps of Newton's iteration at most. With the matrix of the start, each leaves about such a part
# of the error as is the angle, rad, by which bars turn.
_MOST, _FEW = 40, 6

# The iteration ends where a change is this part of the size and the distance from the origin, or
# where it is small and, by round-off, is not halved again.
_TINY, _SMALL = 2e-16, 1e-12

# Largest turn of a bar from the place where its multipliers act, rad.
_LARGEST_TURN = 1.0

# Added to moments of inertia, as part of their sum: bars on one line have none about it.
_NO_INERTIA = 1e-12


class Coupled:
    """The blocks of a structure as functions of their coordinates c, a column, and of their rates.

    Attributes
    ----------
    rows : ndarray of int
        Rows of vec(N) of the coordinates.
    bars : ndarray of int
        The bars with multipliers: of redundant bars, those that determine the others.
    factorized : casadi.Function
        ``(c) -> factors``, a column.
    placed : casadi.Function
        ``(c, start, factors) -> change`` that puts c on the lengths of the bars. It is along
        ``M⁻¹ Jᵀ`` of ``start``, to which the factors belong; NaN where it is not found near by.
    across : casadi.Function
        ``(c, rates, factors) -> rates`` without what would stretch the bars.

    Where lengths are driven, the last two take a further column: the lengths of these bars, m, then
    their rates, m/s, at which bars then stretch.
    """

    def __init__(self, structure: Structure, driven: bool = False) -> None:
        self._structure, self._blocks = structure, structure.blocks
        self.rows: IntArray = np.concatenate([block.rows for block in self._blocks])
        self.bars: IntArray = np.concatenate([block.independent for block in self._blocks])
        self._pairs = structure.bars[self.bars]
        self._square, self._stretch = ca.DM(structure.bar_length[self.bars] ** 2), None
        self._lengths: list[Any] = []
        if driven:
            count = len(self.bars)
            self._lengths = [ca.SX.sym("lengths", 2 * count)]
            length, rate = self._lengths[0][:count], self._lengths[0][count:]
            self._square, self._stretch = length**2, length * rate
        self._size = structure.size
        self._c = ca.SX.sym("c", len(self.rows))
        self._systems = [
            kernel.SaddlePoint(structure, block, J)
            for block, J in zip(self._blocks, self._jacobians(self.nodes(self._c)), strict=True)
        ]
        values = ca.vertcat(*(system.values for system in self._systems))
        self._factors = ca.SX.sym("factors", values.shape[0])
        self.factorized = Function("factorized", [self._c], [values])
        self.placed = self._placed()
        self.across = self._across()

    def nodes(self, c: kernel.Symbolic, places: FloatArray | None = None) -> kernel.Symbolic:
        """Return the columns of nodes, shape (d, n), with those of ``places`` outside the blocks.

        The places are those of the structure if not given.
        """
        places = self._structure.nodes if places is None else places
        flat = ca.SX(ca.DM(places.ravel(order="F")))
        flat[self.rows.tolist()] = c
        return ca.reshape(flat, *places.shape)

    def rates(self, rates: kernel.Symbolic) -> kernel.Symbolic:
        """Return columns of velocities, shape (d, n), zero outside the blocks."""
        return self.nodes(rates, np.zeros_like(self._structure.nodes))

    def _jacobians(self, N: kernel.Symbolic) -> list[kernel.Symbolic]:
        """Return J of the bars of each block."""
        blocks = self._blocks
        return [kernel.block_rows(self._structure, b.independent, b.rows, N) for b in blocks]

    def _parts(self, column: kernel.Symbolic, sizes: Iterable[int]) -> list[kernel.Symbolic]:
        """Return the part of each block of a column."""
        return list(ca.vertsplit(column, np.cumsum([0, *sizes]).tolist()))

    def excess(self, c: kernel.Symbolic) -> kernel.Symbolic:
        """Return half of what the squared lengths of the bars are too large, m²."""
        B = kernel.differences(self.nodes(c), self._pairs)
        return (kernel.dots(B, B).T - self._square) / 2

    def stretching(self, c: kernel.Symbolic, rates: kernel.Symbolic) -> kernel.Symbolic:
        """Return ``J ċ``, m²/s."""
        B = kernel.differences(self.nodes(c), self._pairs)
        return kernel.dots(B, kernel.differences(self.rates(rates), self._pairs)).T

    def pull(self, N: kernel.Symbolic, values: kernel.Symbolic) -> kernel.Symbolic:
        """Return ``Jᵀ`` times values of the bars, J at columns of nodes or of velocities."""
        blocks = self._parts(values, (len(block.independent) for block in self._blocks))
        both = zip(self._jacobians(N), blocks, strict=True)
        return ca.vertcat(*(ca.mtimes(J.T, values_of_block) for J, values_of_block in both))

    def momenta(
        self, rates: kernel.Symbolic, masses: kernel.Masses | None = None
    ) -> kernel.Symbolic:
        """Return ``M ċ``, kg m/s; of masses that are expressions, if they are given."""
        product = kernel.mass_product(self._structure, self.rates(rates), masses)
        return ca.vec(product)[self.rows.tolist()]

    def _solve(self, upper: kernel.Symbolic, lower: kernel.Symbolic) -> kernel.Symbolic:
        """Return the changes of the coordinates that solve the systems of all blocks."""
        blocks = zip(
            self._systems,
            self._parts(upper, (len(block.rows) for block in self._blocks)),
            self._parts(lower, (len(block.independent) for block in self._blocks)),
            self._parts(self._factors, (system.values.shape[0] for system in self._systems)),
            strict=True,
        )
        return ca.vertcat(
            *(system.solve(up, low, factors)[: up.shape[0]] for system, up, low, factors in blocks)
        )

    def _placed(self) -> ca.Function:
        c, size, factors = self._c, len(self.rows), self._factors
        # The change of c so far, the size of the last part of it, and of the one before.
        state = ca.SX.sym("state", size + 2)
        correction = self._solve(ca.SX.zeros(size), -self.excess(c + state[:size]))
        new = ca.densify(ca.vertcat(state[:size] + correction, ca.norm_2(correction), state[size]))
        iterate = where_needed(Function("iterate", [state, c, factors, *self._lengths], [new]))
        end = ca.SX.sym("end", size)
        before, after = (
            kernel.differences(self.nodes(coordinates), self._pairs) for coordinates in (c, end)
        )
        near = ca.mmin(kernel.dots(before, after).T - cos(_LARGEST_TURN) * self._square) >= 0
        near = Function("near", [c, end, *self._lengths], [near])
        c, start, factors = (
            ca.MX.sym(name, symbol.shape[0])
            for name, symbol in (("c", self._c), ("start", self._c), ("factors", self._factors))
        )
        lengths = [ca.MX.sym("lengths", symbol.shape[0]) for symbol in self._lengths]
        scale = self._size + ca.norm_inf(start)

        def going_on(state: Any, scale: Any) -> Any:
            """Return whether to go on: not where the last change is not a number."""
            last, before = state[size], state[size + 1]
            at_its_end = ca.logic_and(last < _SMALL * scale, last >= before / 2)
            return ca.logic_and(last > _TINY * scale, ca.logic_not(at_its_end))

        def iterated(count: int, *given: Any) -> Any:
            state, c, factors, *lengths, scale = given
            for _ in range(count):
                state = iterate(going_on(state, scale), state, c, factors, *lengths)
            return state

        # Most often few are needed: the others are skipped at once.
        sizes = size + 2, size, factors.shape[0], *(symbol.shape[0] for symbol in lengths), 1
        given = [ca.MX.sym(f"a{i}", n) for i, n in enumerate(sizes)]
        others = where_needed(Function("others", given, [iterated(_MOST - _FEW, *given)]))
        of_bars = c, factors, *lengths, scale
        state = iterated(_FEW, ca.vertcat(ca.MX.zeros(size), ca.inf, ca.inf), *of_bars)
        state = others(going_on(state, scale), state, *of_bars)
        change = state[:size]
        good = ca.logic_and(state[size] < _SMALL * scale, near(start, c + change, *lengths))
        change = ca.if_else(good, change, ca.DM.nan(size))
        return Function("placed", [c, start, factors, *lengths], [change])

    def _across(self) -> ca.Function:
        rates = ca.SX.sym("rates", len(self.rows))
        off = self.stretching(self._c, rates)
        if self._stretch is not None:
            off -= self._stretch
        change = self._solve(ca.SX.zeros(len(self.rows)), -off)
        given = [self._c, rates, self._factors, *self._lengths]
        return Function("across", given, [rates + change])

    def restored(self) -> ca.Function:
        """Return ``(c, rates[, lengths]) -> (c, rates)`` with exact bars, from a state near by.

        The change is the least in the metric of the mass. Linear momentum stays, and so does the
        angular momentum of a block that nothing holds: it is turned as one body for that.
        """
        c, rates = (ca.MX.sym(name, len(self.rows)) for name in ("c", "rates"))
        lengths = [ca.MX.sym("lengths", symbol.shape[0]) for symbol in self._lengths]
        change = self.placed(c, c, self.factorized(c), *lengths)
        end = c + change
        after = self.across(end, rates, self.factorized(end), *lengths)
        outputs = [end, self._turned()(c, rates, end, after)]
        return Function("restored", [c, rates, *lengths], outputs)

    def _turned(self) -> ca.Function:
        """Return ``(c, rates, c1, rates1) -> rates1`` with the angular momentum of c, rates."""
        structure = self._structure
        names = ("c", "rates", "c1", "rates1")
        given = [ca.SX.sym(name, len(self.rows)) for name in names]
        N, V, N1, V1 = (
            self.nodes(given[0]), self.rates(given[1]), self.nodes(given[2]), self.rates(given[3])
        )  # fmt: skip
        for block in self._blocks:
            if len(block.rows) < structure.dimension * len(block.nodes):
                continue  # a roller
            if np.isin(structure.bars[block.bars], structure.fixed).any():
                continue
            nodes = block.nodes.tolist()
            M = ca.DM(node_mass(structure, block).toarray())
            total = float(ca.sum1(ca.sum2(M)))
            arms = N1[:, nodes]
            arms -= ca.repmat(ca.sum2(ca.mtimes(arms, M)) / total, 1, len(nodes))
            before, after = (
                ca.sum2(cross(positions[:, nodes], ca.mtimes(rate[:, nodes], M)))
                for positions, rate in ((N, V), (N1, V1))
            )
            spread = ca.mtimes([arms, M, arms.T])
            trace = ca.trace(spread)
            inertia = trace
            if structure.dimension == 3:
                inertia = (1 + _NO_INERTIA) * trace * ca.SX.eye(3) - spread
            turn = ca.repmat(kernel.eliminated(inertia, before - after), 1, len(nodes))
            V1[:, nodes] += cross(turn, arms)
        return Function("turned", given, [ca.vec(V1)[self.rows.tolist()]])


def cross(a: kernel.Symbolic, b: kernel.Symbolic) -> kernel.Symbolic:
    """Return the cross products of columns, shape (3, k); in the plane with one row for its normal.

    There a vector is (2, k), an angular velocity or a moment (1, k).
    """
    if a.shape[0] == 1:
        return ca.vertcat(-a * b[1, :], a * b[0, :])
    if a.shape[0] == 2:
        return a[0, :] * b[1, :] - a[1, :] * b[0, :]
    return ca.vertcat(
        a[1, :] * b[2, :] - a[2, :] * b[1, :],
        a[2, :] * b[0, :] - a[0, :] * b[2, :],
        a[0, :] * b[1, :] - a[1, :] * b[0, :],
    )
