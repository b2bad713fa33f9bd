/* Four members of one run at once by AVX2, where the compiler knows it. */
#include "members.h"

#include <string.h>

#ifdef HAS_WIDE_LANES
#include "avx2.h"
#include "columns.h"
#include "string_laws.h"

/* Two numbers that follow one another in memory. */
typedef double Pair __attribute__((vector_size(16), aligned(8)));

static inline Number row(const double *x) { return *numbers(x); }

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
