"""Blocks of coupled bars in C: sparse factorization by tables, in loops over the entries."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.force import Pass, Read, Write
from tenscontrol.structure.blocks import block_mass
from tenscontrol.structure.structure import Structure

# Pairs of entries, each of which takes a product and a difference, that cost as much as a member.
_PAIRS_A_MEMBER = 14


def members_alone(structure: Structure) -> float:
    """Return how many members on their own take as many instructions when they are written out.

    Measured on D-bars, towers, spines and arms: an instruction count of 33 a member and 2.4 a pair.
    """
    count = float(len(structure.bars) + len(structure.strings))
    if structure.blocks:
        count += len(Elimination(structure).tables["factor_pair"]) / _PAIRS_A_MEMBER
    return count


class Elimination:
    """LDLᵀ of ``[[M, Jᵀ], [J, 0]]`` of all blocks, in their order, without pivoting.

    The array "K" holds the entries below the diagonal, fill-in among them, column by column, then
    the diagonal, then one entry for what supports hold; "y" holds the right-hand side.

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
        mass = block_mass(structure, block).tocoo()
        one, other = position[mass.row], position[mass.col]
        # Entries of J: of each bar, which comes later, by the rows of both ends that are not held.
        d = structure.dimension
        row_of = np.full(structure.nodes.size, -1)
        row_of[block.rows] = position[:rows]
        starts, ends = structure.bars[block.independent].T
        end_rows = row_of[d * np.stack([starts, ends])[:, :, None] + np.arange(d)]  # (2, bars, d)
        bars = np.broadcast_to(position[rows:, None], end_rows.shape)
        below = one < other
        down, first = _factor(
            np.concatenate([other[below], bars[end_rows >= 0]]),
            np.concatenate([one[below], end_rows[end_rows >= 0]]),
            unknowns,
        )
        factors = len(down)
        across = np.repeat(np.arange(unknowns), np.diff(first))
        keys = across * unknowns + down

        def entry(column: IntArray, row: IntArray) -> IntArray:
            """Return where entries on or below the diagonal are kept."""
            index = np.searchsorted(keys, column * unknowns + row)
            return np.where(row == column, factors + row, index)

        # Each column changes the entries at all pairs of its rows.
        pairs = np.arange(factors) - first[across] + 1
        later = np.repeat(np.arange(factors), pairs)
        earlier = later - np.repeat(np.cumsum(pairs), pairs) + np.arange(len(later)) + 1
        start = np.zeros(factors + unknowns + 1)
        on = one <= other
        np.add.at(start, entry(one[on], other[on]), mass.data[on])
        from_start, from_end = np.where(end_rows >= 0, entry(end_rows, bars), factors + unknowns)
        self.tables: dict[str, Any] = {
            "block_mass": start,
            "factor_row": down,
            "factor_first": first,
            "factor_pair": entry(down[earlier], down[later]),
            "block_row": block.rows,
            "block_place": position[:rows],
        }
        self.sizes = {"FACTORS": factors, "UNKNOWNS": unknowns, "BLOCK_ROWS": rows}
        self.work = len(start) + unknowns
        self.assembly = Pass(
            "coupled_bars",
            len(starts),
            _assemble,
            {
                f"{array}_{name}": Read(array, nodes)
                for array in "pv"
                for name, nodes in (("start", starts), ("end", ends))
            },
            (
                Write("K", 0, from_end),
                Write("K", 0, from_start, sign=-1),
                Write("y", 1, position[rows:]),
            ),
            {},
        )


def _assemble(columns: dict[str, Any]) -> tuple[Any, ...]:
    B, Bd = (columns[f"{array}_end"] - columns[f"{array}_start"] for array in "pv")
    return B, -kernel.dots(Bd, Bd)


def _factor(rows: IntArray, columns: IntArray, size: int) -> tuple[IntArray, IntArray]:
    """Return the rows of the factor's entries below the diagonal, and where columns begin."""
    every = np.arange(size)
    both = np.concatenate([rows, columns, every]), np.concatenate([columns, rows, every])
    pattern = ca.Sparsity.triplet(size, size, *(indices.tolist() for indices in both))
    lower = pattern.ldl(False)[0].T
    return np.array(lower.row(), dtype=int), np.array(lower.colind(), dtype=int)


#: Called with forces f; accelerations of the block's rows go to a.
SOLVE = """\
static void eliminate(double *K, double *y) {
  double *diagonal = K + FACTORS;
  const int *pair = factor_pair;
  for (int c = 0; c < UNKNOWNS; ++c) {
    const int first = factor_first[c], end = factor_first[c + 1];
    const double inverse = 1 / diagonal[c];
    diagonal[c] = inverse;
    for (int k = first; k < end; ++k) {
      const double factor = K[k] * inverse;
      y[factor_row[k]] -= factor * y[c];
      for (int m = first; m <= k; ++m) K[*pair++] -= factor * K[m];
    }
  }
  for (int c = UNKNOWNS - 1; c >= 0; --c) {
    double sum = y[c];
    for (int k = factor_first[c]; k < factor_first[c + 1]; ++k) sum -= K[k] * y[factor_row[k]];
    y[c] = sum * diagonal[c];
  }
}
static void blocks(const double *p, const double *v, const double *f, double *a, double *w) {
  double *K = w, *y = K + FACTORS + UNKNOWNS + 1;
  memcpy(K, block_mass, sizeof(block_mass));
  for (int i = 0; i < BLOCK_ROWS; ++i) y[block_place[i]] = f[block_row[i]];
  %(assembly)s
  eliminate(K, y);
  for (int i = 0; i < BLOCK_ROWS; ++i) a[block_slot[i]] = y[block_place[i]];
}
"""
