/* Rows of numbers in lanes become columns. */
#ifndef TENSCONTROL_COLUMNS_H
#define TENSCONTROL_COLUMNS_H

#include "numbers.h"

#if defined(__GNUC__) && LANES == 4
#ifdef __clang__
#define PICK(x, y, i, j, k, l) __builtin_shufflevector(x, y, i, j, k, l)
#else
#define PICK(x, y, i, j, k, l) __builtin_shuffle(x, y, (Truth){i, j, k, l})
#endif

static inline void columns(const Number *row, Number *column) {
  const Number even = PICK(row[0], row[1], 0, 4, 2, 6), odd = PICK(row[0], row[1], 1, 5, 3, 7);
  const Number last_even = PICK(row[2], row[3], 0, 4, 2, 6);
  const Number last_odd = PICK(row[2], row[3], 1, 5, 3, 7);
  column[0] = PICK(even, last_even, 0, 1, 4, 5);
  column[1] = PICK(odd, last_odd, 0, 1, 4, 5);
  column[2] = PICK(even, last_even, 2, 3, 6, 7);
  column[3] = PICK(odd, last_odd, 2, 3, 6, 7);
}
#else
static inline void columns(const Number *row, Number *column) {
  for (int i = 0; i < WIDTH; ++i)
    for (int k = 0; k < WIDTH; ++k) put(lane(row + k, i), column + i, k);
}
#endif

#endif
