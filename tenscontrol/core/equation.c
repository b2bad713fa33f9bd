/* The equation of motion by tables: forces on nodes, accelerations, and gaps of switches. */
#include "motion.h"

#include <string.h>

#include "blocks.h"
#include "members.h"
#include "string_laws.h"

/* Whether several members are taken at once: of one run. */
#if defined(HAS_WIDE_LANES) && !defined(LANES)
#define TAKES_SEVERAL __builtin_cpu_supports("avx2")
#else
#define TAKES_SEVERAL 0
#define pull_by_avx2_2(...) 0
#define pull_by_avx2_3(...) 0
#define gaps_by_avx2_2(...) 0
#define gaps_by_avx2_3(...) 0
#define free_bars_by_avx2_2(...) 0
#define free_bars_by_avx2_3(...) 0
#endif

/* Numbers in a line of the cache. */
enum { LINE = 8 };

/* Parts of the work memory. */
typedef struct {
  Number *p, *v, *f, *g, *a, *b; /* (entries) */
  Number *ends, *end_rates;      /* (entries): of strings that supports move */
  Number *S, *changes;           /* (segments, d) */
  Number *length, *rate, *gamma; /* (segments) */
  Number *string_length, *string_rate, *string_gamma, *string_taut; /* (strings) */
  Number *factors, *unknowns;
  double *rows; /* (nodes, 4), from where a line of the cache begins; of one run alone */
} Work;

SHARED size_t equation_work_size(const Scene *s) {
  return 8 * (size_t)s->entries + (size_t)(2 * s->dimension + 3) * s->segments + 4 * (size_t)s->strings +
         (size_t)s->factors + 2 * (size_t)s->unknowns + 1 +
         (WIDTH > 1 ? 0 : 4 * (size_t)(s->entries / s->dimension) + LINE);
}

static inline Work parts_of(const Scene *s, Number *work) {
  const int n = s->entries, d = s->dimension;
  Number *const S = work + 8 * n, *const length = S + 2 * d * s->segments;
  Number *const string_length = length + 3 * s->segments, *const factors = string_length + 4 * s->strings;
  Number *const unknowns = factors + s->factors + s->unknowns + 1;
  double *const rest = (double *)(unknowns + s->unknowns);
  const Work w = {
      .p = work,
      .v = work + n,
      .f = work + 2 * n,
      .g = work + 3 * n,
      .a = work + 4 * n,
      .b = work + 5 * n,
      .ends = work + 6 * n,
      .end_rates = work + 7 * n,
      .S = S,
      .changes = S + d * s->segments,
      .length = length,
      .rate = length + s->segments,
      .gamma = length + 2 * s->segments,
      .string_length = string_length,
      .string_rate = string_length + s->strings,
      .string_gamma = string_length + 2 * s->strings,
      .string_taut = string_length + 3 * s->strings,
      .factors = factors,
      .unknowns = unknowns,
      .rows = rest + (LINE - (uintptr_t)rest / sizeof(double) % LINE) % LINE,
  };
  return w;
}

/* Sums over the segments of each string. */
static void sum_by_string(const Scene *s, const Number *of_segments, Number *of_strings) {
  memset(of_strings, 0, s->strings * sizeof *of_strings);
  for (int i = 0; i < s->segments; ++i) of_strings[s->segment_string[i]] += of_segments[i];
}

/* Force densities of strings, N/m; of those that are slack 0. */
WIDE static void force_densities(const Scene *s, const Number *restrict length, const Number *restrict rate,
                                 const Number *restrict u, const Number *restrict taut,
                                 Number *restrict gamma) {
  const Number *restrict k = numbers(s->stiffness), *restrict c = numbers(s->damping);
  const int count = s->strings, linear = s->law == LINEAR_STRINGS;
  if (s->law == FORCE_DENSITY_HELD) {
    memcpy(gamma, u, count * sizeof *gamma);
    return;
  }
  if (linear && !s->damped)
    for (int i = 0; i < count; ++i) linear_undamped_force_density(length[i], u[i], k[i], gamma + i);
  else if (linear)
    for (int i = 0; i < count; ++i)
      linear_damped_force_density(length[i], u[i], rate[i], k[i], c[i], gamma + i);
  else if (!s->damped)
    for (int i = 0; i < count; ++i) elastic_undamped_force_density(length[i], u[i], k[i], gamma + i);
  else
    for (int i = 0; i < count; ++i)
      elastic_damped_force_density(length[i], u[i], rate[i], k[i], c[i], gamma + i);
  for (int i = 0; i < count; ++i) gamma[i] *= taut[i];
}

WIDE static void string_gaps(const Scene *s, const Number *restrict length, const Number *restrict rate,
                             const Number *restrict u, Number *restrict gap) {
  const Number *restrict k = numbers(s->stiffness), *restrict c = numbers(s->damping);
  const int count = s->strings;
  if (!s->damped)
    for (int i = 0; i < count; ++i) gap[i] = length[i] - u[i];
  else if (s->law == LINEAR_STRINGS)
    for (int i = 0; i < count; ++i) linear_damped_gap(length[i], u[i], rate[i], k[i], c[i], gap + i);
  else
    for (int i = 0; i < count; ++i) elastic_damped_gap(length[i], u[i], rate[i], k[i], c[i], gap + i);
}

/* Which strings pull by what they are given, or by their gaps. */
static const Number *pulling(const Scene *s, const Number *length, const Number *rate, const Number *u,
                             const Number *taut, Number *found) {
  if (taut || s->law == FORCE_DENSITY_HELD) return taut;
  string_gaps(s, length, rate, u, found);
  for (int i = 0; i < s->strings; ++i) found[i] = truth(found[i] > 0);
  return found;
}

/* Factorizes the matrix of the blocks by LDL', without pivoting, in place. */
SHARED void factorize(const Scene *s, Number *K) {
  Number *diagonal = K + s->factors;
  const int32_t *pair = s->factor_pair, *first = s->factor_first;
  for (int c = 0; c < s->unknowns; ++c) {
    const Number inverse = 1 / diagonal[c];
    diagonal[c] = inverse;
    for (int k = first[c]; k < first[c + 1]; ++k) {
      const Number factor = K[k] * inverse;
      for (int m = first[c]; m <= k; ++m) K[*pair++] -= factor * K[m];
    }
  }
}

#define SOLVE solve_by
#define FACTOR Number
#define ENTRY Number
#include "solve_body.h"
SHARED void solve(const Scene *s, const Number *K, Number *y) { solve_by(s, K, y); }

#define D 2
#include "equation_body.h"
#undef D
#define D 3
#include "equation_body.h"
#undef D

static void spread(const Scene *s, const Number *from, Number *to) {
  for (int i = 0; i < s->free; ++i) to[s->free_row[i]] = from[i];
}

static const Number *moved(const Number *of, const Number *by, Number *to, int count) {
  if (!by) return of;
  for (int i = 0; i < count; ++i) to[i] = of[i] + by[i];
  return to;
}

/* Positions and velocities of all entries. */
static void nodes_of(const Scene *s, const Number *state, const Number **p, const Number **v, const Work *w) {
  *p = state;
  *v = state + s->free;
  if (!s->free_row) return;
  memcpy(w->p, s->place, s->entries * sizeof(Number));
  memset(w->v, 0, s->entries * sizeof(Number));
  spread(s, state, w->p);
  spread(s, state + s->free, w->v);
  *p = w->p;
  *v = w->v;
}

SHARED void slope_of(const Scene *s, const Number *state, const Input *input, const Number *taut,
                     Number *slope, Number *work) {
  const Work w = parts_of(s, work);
  const Number *p, *v, *ends, *end_rates;
  Number *a = s->free_row ? w.a : slope + s->free;
  nodes_of(s, state, &p, &v, &w);
  ends = moved(p, input->offset, w.ends, s->entries);
  end_rates = moved(v, input->offset_rate, w.end_rates, s->entries);
  if (s->dimension == 2) {
    forces_2(s, ends, end_rates, input, taut, w.f, &w);
    accelerations_2(s, p, v, w.f, input->extension, a, &w);
  } else {
    forces_3(s, ends, end_rates, input, taut, w.f, &w);
    accelerations_3(s, p, v, w.f, input->extension, a, &w);
  }
  memcpy(slope, state + s->free, s->free * sizeof(Number));
  if (s->free_row)
    for (int i = 0; i < s->free; ++i) slope[s->free + i] = a[s->free_row[i]];
}

SHARED void slope_and_bars(const Scene *s, const Number *state, const Input *input, const Number *taut,
                           Number *slope, Number *density, Number *work) {
  const Work w = parts_of(s, work);
  const Number *p, *v;
  slope_of(s, state, input, taut, slope, work);
  nodes_of(s, state, &p, &v, &w);
  if (s->dimension == 2) bar_densities_2(s, p, v, w.f, input->extension, density, &w);
  else bar_densities_3(s, p, v, w.f, input->extension, density, &w);
}

SHARED void weighed_accelerations(const Scene *s, const Number *state, const Input *input, const Some *some,
                                  int count, const Number *weights, Number *to, Number *work) {
  const Work w = parts_of(s, work);
  const Number *p, *v, *ends, *end_rates;
  Number *forces[] = {w.f, w.g, w.a};
  nodes_of(s, state, &p, &v, &w);
  ends = moved(p, input->offset, w.ends, s->entries);
  end_rates = moved(v, input->offset_rate, w.end_rates, s->entries);
  if (s->dimension == 2) weighed_2(s, ends, end_rates, input->strings, some, count, weights, forces, &w);
  else weighed_3(s, ends, end_rates, input->strings, some, count, weights, forces, &w);
  memset(w.v, 0, s->entries * sizeof *w.v);
  for (int m = 0; m < count; ++m, to += s->free) {
    Number *a = s->free_row ? w.b : to;
    if (s->dimension == 2) accelerations_2(s, p, w.v, forces[m], 0, a, &w);
    else accelerations_3(s, p, w.v, forces[m], 0, a, &w);
    if (s->free_row)
      for (int i = 0; i < s->free; ++i) to[i] = a[s->free_row[i]];
  }
}

SHARED void forces_of(const Scene *s, const Number *state, const Input *input, const Number *taut,
                      Number *forces, Number *work) {
  const Work w = parts_of(s, work);
  const Number *p, *v;
  nodes_of(s, state, &p, &v, &w);
  p = moved(p, input->offset, w.ends, s->entries);
  v = moved(v, input->offset_rate, w.end_rates, s->entries);
  if (s->dimension == 2) forces_2(s, p, v, input, taut, forces, &w);
  else forces_3(s, p, v, input, taut, forces, &w);
}

SHARED void gap_of(const Scene *s, const Number *state, const Input *input, const Some *some, Number *gap,
                   Number *rate, Number *work) {
  const Work w = parts_of(s, work);
  const Number *p, *v;
  nodes_of(s, state, &p, &v, &w);
  p = moved(p, input->offset, w.ends, s->entries);
  v = moved(v, input->offset_rate, w.end_rates, s->entries);
  if (s->dimension == 2) gaps_2(s, p, v, input->strings, some, gap, rate, &w);
  else gaps_3(s, p, v, input->strings, some, gap, rate, &w);
}
