/* Four members of one run at once by AVX2, where the compiler knows it. */
#include "members.h"

#include <string.h>

#ifdef HAS_WIDE_LANES
#include "avx2.h"
#include "string_laws.h"

#ifdef __clang__
#define PICK(x, y, i, j, k, l) __builtin_shufflevector(x, y, i, j, k, l)
#else
#define PICK(x, y, i, j, k, l) __builtin_shuffle(x, y, (Truth){i, j, k, l})
#endif

/* Two numbers that follow one another in memory. */
typedef double Pair __attribute__((vector_size(16), aligned(8)));

static inline Number row(const double *x) { return *numbers(x); }

/* Rows of numbers become columns. */
static inline void columns(const Number *row, Number *column) {
  const Number even = PICK(row[0], row[1], 0, 4, 2, 6), odd = PICK(row[0], row[1], 1, 5, 3, 7);
  const Number last_even = PICK(row[2], row[3], 0, 4, 2, 6);
  const Number last_odd = PICK(row[2], row[3], 1, 5, 3, 7);
  column[0] = PICK(even, last_even, 0, 1, 4, 5);
  column[1] = PICK(odd, last_odd, 0, 1, 4, 5);
  column[2] = PICK(even, last_even, 2, 3, 6, 7);
  column[3] = PICK(odd, last_odd, 2, 3, 6, 7);
}

/* The vectors from nodes to others, one a row. */
static inline void apart(const double *x, const int32_t *from, const int32_t *to, Number *rows) {
  for (int j = 0; j < WIDTH; ++j) rows[j] = row(x + to[j]) - row(x + from[j]);
}

#define D 2
#include "members_body.h"
#undef D
#define D 3
#include "members_body.h"
#undef D

#ifdef __clang__
#pragma clang attribute pop
#endif
#endif
