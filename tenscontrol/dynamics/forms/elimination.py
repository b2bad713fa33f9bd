"""Blocks of coupled bars in C: their matrix is factorized by tables, in loops over its entries."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.forms.passes import Pass, Read, Write
from tenscontrol.structure import Structure
from tenscontrol.validation import IntArray


class Elimination:
    """LDLᵀ of ``[[M, Jᵀ], [J, 0]]`` of all blocks, in their order, without pivoting.

    The array "K" holds the factor's entries above the diagonal, column by column, then the
    diagonal, then one entry for what supports hold; "y" holds the right-hand side.

    Attributes
    ----------
    tables : dict of str to ndarray
        What the C text needs: the entries of the masses, the pattern, and where rows stand.
    sizes : dict of str to int
    work : int
        Entries of memory it takes.
    assembly : Pass
        Puts the bars into "K" and "y".
    """

    def __init__(self, structure: Structure) -> None:
        block = kernel.coupled_block(structure)
        rows, unknowns = len(block.rows), len(block.order)
        position = np.argsort(block.order)
        mass = kernel.block_mass(structure, block).tocoo()
        across, down = position[mass.row], position[mass.col]
        # Entries of J: of each bar by the rows of both ends, or none where they are held.
        row_of = np.full(structure.nodes.size, -1)
        row_of[block.rows] = position[:rows]
        d = structure.dimension
        ends = structure.bars[block.independent].T
        at = row_of[d * ends[:, :, None] + np.arange(d)]  # (2, bars, d)
        bars = np.broadcast_to(position[rows:][:, None], at.shape)
        above = [across[across < down], at[at >= 0]], [down[across < down], bars[at >= 0]]
        columns, starts = _factor_pattern(*map(np.concatenate, above), unknowns)
        factors = len(columns)
        keys = np.repeat(np.arange(unknowns), np.diff(starts)) * unknowns + columns

        def entry(upper: IntArray, lower: IntArray) -> IntArray:
            """Return where the entries of the matrix on or above the diagonal are kept."""
            above = np.searchsorted(keys, lower * unknowns + upper)
            return np.where(upper == lower, factors + upper, above)

        start = np.zeros(factors + unknowns + 1)
        upper = across <= down
        np.add.at(start, entry(across[upper], down[upper]), mass.data[upper])
        nowhere = factors + unknowns
        from_end, to_end = (np.where(one >= 0, entry(one, two), nowhere)
                            for one, two in zip(at, bars, strict=True))  # fmt: skip
        self.tables: dict[str, Any] = {
            "block_mass": start,
            "factor_row": columns,
            "factor_start": starts,
            "block_row": block.rows,
            "block_place": position[:rows],
        }
        self.sizes = {"FACTORS": factors, "UNKNOWNS": unknowns, "BLOCK_ROWS": rows}
        self.work = len(start) + 2 * unknowns
        first, last = ends
        self.assembly = Pass(
            "coupled_bars",
            len(first),
            _assemble,
            {
                "p_start": Read("p", first),
                "v_start": Read("v", first),
                "p_end": Read("p", last),
                "v_end": Read("v", last),
            },
            (
                Write("K", 0, to_end),
                Write("K", 0, from_end, sign=-1),
                Write("y", 1, position[rows:]),
            ),
            {},
        )


def _assemble(columns: dict[str, Any]) -> tuple[Any, ...]:
    B, Bd = (columns[f"{part}_end"] - columns[f"{part}_start"] for part in "pv")
    return B, -kernel.dots(Bd, Bd)


def _factor_pattern(rows: IntArray, columns: IntArray, size: int) -> tuple[IntArray, IntArray]:
    """Return rows and column starts of the factor's entries above the diagonal, with fill-in."""
    every = np.arange(size)
    both = np.concatenate([rows, columns, every]), np.concatenate([columns, rows, every])
    pattern = ca.Sparsity.triplet(size, size, *(part.tolist() for part in both))
    factor, _ = pattern.ldl(False)
    return np.array(factor.row(), dtype=int), np.array(factor.colind(), dtype=int)


#: Called with forces f; accelerations of the block's rows go to a.
SOLVE = """\
static void eliminate(double *K, double *y, double *w) {
  double *diagonal = K + FACTORS;
  memset(w, 0, UNKNOWNS * sizeof(double));
  for (int c = 0; c < UNKNOWNS; ++c) {
    const int from = factor_start[c], to = factor_start[c + 1];
    double pivot = diagonal[c], right = y[c];
    for (int k = from; k < to; ++k) w[factor_row[k]] = K[k];
    for (int k = from; k < to; ++k) {
      const int r = factor_row[k];
      double x = w[r];
      for (int m = factor_start[r]; m < factor_start[r + 1]; ++m) x -= K[m] * w[factor_row[m]];
      w[r] = x;
      K[k] = x / diagonal[r];
      pivot -= K[k] * x;
      right -= K[k] * y[r];
    }
    diagonal[c] = pivot;
    y[c] = right;
    for (int k = from; k < to; ++k) w[factor_row[k]] = 0;
  }
  for (int c = 0; c < UNKNOWNS; ++c) y[c] /= diagonal[c];
  for (int c = UNKNOWNS - 1; c >= 0; --c)
    for (int k = factor_start[c]; k < factor_start[c + 1]; ++k) y[factor_row[k]] -= K[k] * y[c];
}
static void blocks(const double *p, const double *v, const double *f, double *a, double *w) {
  double *K = w, *y = K + FACTORS + UNKNOWNS + 1;
  memcpy(K, block_mass, sizeof(block_mass));
  for (int i = 0; i < BLOCK_ROWS; ++i) y[block_place[i]] = f[block_row[i]];
  %(assembly)s
  eliminate(K, y, y + UNKNOWNS);
  for (int i = 0; i < BLOCK_ROWS; ++i) a[block_slot[i]] = y[block_place[i]];
}
"""
