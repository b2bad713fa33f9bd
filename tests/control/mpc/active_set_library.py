"""The active-set solver in C, with rows of a matrix, called from Python."""

from __future__ import annotations

import ctypes
from functools import cache
from importlib.resources import files

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.machine_code import compiled_library, compiler
from tenscontrol.status import Status

_CALLS = """
typedef struct {
    ActiveSet set;
    const size_t *start; /* row i is value[start[i]] ... value[start[i + 1] - 1] */
    const double *value;
    int asked, stop_at, products, batches, reached; /* how often in the last solve */
} Opened;

static const double *row_of(const Opened *opened, int i, int *length)
{
    *length = (int)(opened->start[i + 1] - opened->start[i]);
    return opened->value + opened->start[i];
}

static void kept_batch(void *data, int count, const int *which, double *const *space,
                       const double **entries, int *length)
{
    Opened *opened = data;
    int j;
    (void)space;
    opened->batches++;
    opened->reached += count;
    for (j = 0; j < count; j++)
        entries[j] = row_of(opened, which[j], &length[j]);
}

static void copied_batch(void *data, int count, const int *which, double *const *space,
                         const double **entries, int *length)
{
    int j;
    kept_batch(data, count, which, NULL, entries, length);
    for (j = 0; j < count; j++)
        entries[j] = memcpy(space[j], entries[j], (size_t)length[j] * sizeof *space[j]);
}

static void all_products(void *data, const double *x, double *out)
{
    Opened *opened = data;
    int i, length;
    opened->products++;
    for (i = 0; i < opened->set.rows; i++) {
        const double *row = row_of(opened, i, &length);
        out[i] = active_set_dot(row, x, length);
    }
}

static int asked(void *data)
{
    Opened *opened = data;
    return opened->asked++ == opened->stop_at;
}

size_t sizes(int what, int rows, int columns, int soft, int stored)
{
    int most = ACTIVE_SET_MOST(rows, columns, soft);
    size_t found[] = {sizeof(Opened), ACTIVE_SET_NUMBERS(rows, columns, most, stored),
                      ACTIVE_SET_INTEGERS(rows, most), ACTIVE_SET_POINTERS(most)};
    return found[what];
}

void open_set(Opened *opened, int rows, int columns, int soft, int stored, int limit,
              const size_t *start, const double *value, const double *price,
              const double *curvature, double *numbers, int *integers, const double **pointers)
{
    ActiveSet *set = &opened->set;
    set->rows = rows;
    opened->start = start;
    opened->value = value;
    set->columns = columns;
    set->most = ACTIVE_SET_MOST(rows, columns, soft);
    set->stored = stored;
    set->limit = limit;
    set->tolerance = 1e-11;
    set->price = price;
    set->curvature = curvature;
    set->batch = stored ? copied_batch : kept_batch;
    set->products = all_products;
    set->stop = asked;
    set->data = opened;
    opened->stop_at = -1;
    active_set_place(set, numbers, integers, pointers);
}

void start_set(Opened *opened, const double *y) { active_set_start(&opened->set, y); }

int solve_set(Opened *opened, int stop_at, const double *q, const double *low, const double *high,
              double *x, double *y, int *counts)
{
    int status;
    opened->asked = opened->products = opened->batches = opened->reached = 0;
    opened->stop_at = stop_at;
    status = active_set_solve(&opened->set, q, low, high, x);
    memcpy(y, opened->set.y, (size_t)opened->set.rows * sizeof *y);
    counts[0] = opened->set.iterations;
    counts[1] = opened->products;
    counts[2] = opened->batches;
    counts[3] = opened->reached;
    return status;
}
"""


@cache
def library(batch: int | None = None) -> ctypes.CDLL | None:
    """Return the compiled solver, or None without a compiler; batches are of this size."""
    if compiler() is None:
        return None
    size = "" if batch is None else f"#define ACTIVE_SET_BATCH {batch}\n"
    core = files("tenscontrol") / "core"
    parts = [(core / f"active_set.{end}").read_text(encoding="utf-8") for end in "hc"]
    text = size + parts[0] + parts[1].replace('#include "active_set.h"', "") + _CALLS
    found = ctypes.CDLL(str(compiled_library(text)))
    found.sizes.restype = ctypes.c_size_t
    return found


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


class ActiveSetProgram:
    """Programs with one matrix M, shape (m, n); ``price`` is also the curvature, inf for hard."""

    def __init__(
        self, M: FloatArray, price: FloatArray, stored: bool = False, limit: int = 5000,
        batch: int | None = None,
    ) -> None:  # fmt: skip
        found = library(batch)
        assert found is not None  # the tests are skipped without
        self._library, self.shape = found, M.shape
        # Trailing zeros are left out.
        lengths = [len(row) - int((row[::-1] != 0).argmax()) if row.any() else 0 for row in M]
        parts = [row[:length] for row, length in zip(M, lengths, strict=True)]
        soft = int(np.isfinite(price).sum())
        size = [int(found.sizes(i, *M.shape, soft, int(stored))) for i in range(4)]
        self._kept = (
            np.r_[0, np.cumsum(lengths)].astype(np.uintp),
            np.concatenate(parts).astype(float),
            price.astype(float),
            np.where(np.isfinite(price), price, 1.0),
            np.zeros(size[1]),
            np.zeros(size[2], np.intc),
            np.zeros(size[3], np.uintp),
        )
        self._memory = np.zeros(size[0] // 8 + 1)
        found.open_set(
            _pointer(self._memory), *M.shape, soft, int(stored), limit, *map(_pointer, self._kept)
        )

    def start(self, y: FloatArray | None) -> None:
        """Begin with the rows whose multiplier is not zero; with none of them."""
        self._library.start_set(_pointer(self._memory), None if y is None else _pointer(y))

    def solve(
        self, q: FloatArray, low: FloatArray, high: FloatArray, stop_at: int = -1
    ) -> tuple[str, FloatArray, FloatArray, int]:
        """Return status, x, y and the number of changes of the active set."""
        x, y, counts = np.zeros(self.shape[1]), np.zeros(self.shape[0]), np.zeros(4, np.intc)
        arrays = (np.ascontiguousarray(each, float) for each in (q, low, high))
        given = [*arrays, x, y, counts]
        status = self._library.solve_set(_pointer(self._memory), stop_at, *map(_pointer, given))
        self.products, self.batches, self.reached = (int(count) for count in counts[1:])
        return tuple(Status)[status], x, y, int(counts[0])
