/* Small changes of steps, forward, and costs of their end, backward. */
#include "variations.h"

#include <string.h>

#include "blocks.h"
#include "motion.h"
#include "slopes.h"

/* Put in line, so that it is compiled for wide registers with what calls it. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

/* The widest registers there are, for columns of changes. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define WIDER __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define WIDER
#endif

/* Derivatives of a string's force density by its length, rest length, rate, stiffness, damping. */
enum { BY_LENGTH, BY_REST, BY_RATE, BY_STIFFNESS, BY_DAMPING, STRING_SLOPES };

/* Of the mass of a bar, what each end has of the acceleration of itself and of the other. */
static const double OWN = 1.0 / 3, OTHER = 1.0 / 6;

/* A state with the derivatives of all members there. */
typedef struct {
  double *p, *v, *f, *a;                 /* (entries) */
  double *S, *Sd;                        /* (segments, d) */
  double *length, *rate, *weight;        /* (segments): force is weight times S */
  double *string_length, *string_rate, *gamma, *by; /* (strings), and STRING_SLOPES of each */
  double *touch, *free_bar, *swinging_bar;          /* Jacobians of the kernels */
  double *factors, *unknowns;                       /* of bars that share nodes */
} Point;

static size_t touches(const Scene *s) {
  size_t count = 0;
  for (int i = 0; i < s->grounds; ++i) count += s->ground[i].count;
  return count;
}

static double *take(double **memory, size_t count) {
  double *block = *memory;
  *memory += count;
  return block;
}

enum { POINT_PARTS = 18 };

/* Writes the sizes of the parts of a point, in their order, and returns their sum. */
static size_t point_sizes(const Scene *s, size_t *size) {
  const size_t n = s->entries, m = s->segments, d = s->dimension, strings = s->strings;
  const size_t sizes[POINT_PARTS] = {
      n, n, n, n, m * d, m * d, m, m, m, strings, strings, strings, strings * STRING_SLOPES,
      touches(s) * d * (2 * d + GROUND_NUMBERS), s->free_bars * 3 * d * d,
      s->swinging_bars * 3 * d * d, (size_t)s->factors + s->unknowns + 1, s->unknowns};
  size_t sum = 0;
  for (int i = 0; i < POINT_PARTS; ++i) sum += size[i] = sizes[i];
  return sum;
}

/* Lays out a point in memory, which becomes what is left of it. */
static Point point_in(const Scene *s, double **memory) {
  size_t size[POINT_PARTS];
  Point at;
  double **fields[POINT_PARTS] = {
      &at.p, &at.v, &at.f, &at.a, &at.S, &at.Sd, &at.length, &at.rate, &at.weight,
      &at.string_length, &at.string_rate, &at.gamma, &at.by, &at.touch, &at.free_bar,
      &at.swinging_bar, &at.factors, &at.unknowns};
  point_sizes(s, size);
  for (int i = 0; i < POINT_PARTS; ++i) *fields[i] = take(memory, size[i]);
  return at;
}

/* Free entries into all entries; what supports hold becomes `held`, or 0. */
static void to_all(const Scene *s, const double *free, const double *held, double *all_entries) {
  if (!s->free_row) {
    memcpy(all_entries, free, s->entries * sizeof *free);
    return;
  }
  if (held)
    memcpy(all_entries, held, s->entries * sizeof *held);
  else
    memset(all_entries, 0, s->entries * sizeof *all_entries);
  for (int i = 0; i < s->free; ++i) all_entries[s->free_row[i]] = free[i];
}

/* The force density of a string and its derivatives; those of one that is slack are 0. */
INLINE double string_slopes(const Scene *s, int i, double length, double rate, double rest,
                            double taut, double *by) {
  double gamma, slopes[STRING_SLOPES];
  memset(by, 0, STRING_SLOPES * sizeof *by);
  if (s->law == FORCE_DENSITY_HELD) {
    by[BY_REST] = 1;
    return rest;
  }
  if (s->damped) {
    const double k = s->stiffness[i], c = s->damping[i];
    if (s->law == LINEAR_STRINGS)
      linear_damped_force_density_slopes(length, rest, rate, k, c, &gamma, slopes);
    else
      elastic_damped_force_density_slopes(length, rest, rate, k, c, &gamma, slopes);
    for (int j = 0; j < STRING_SLOPES; ++j) by[j] = slopes[j] * taut;
  } else {
    if (s->law == LINEAR_STRINGS)
      linear_undamped_force_density_slopes(length, rest, s->stiffness[i], &gamma, slopes);
    else
      elastic_undamped_force_density_slopes(length, rest, s->stiffness[i], &gamma, slopes);
    by[BY_LENGTH] = slopes[0] * taut;
    by[BY_REST] = slopes[1] * taut;
    by[BY_STIFFNESS] = slopes[2] * taut;
  }
  return gamma * taut;
}

#define D 2
#include "variations_body.h"
#undef D
#define D 3
#include "variations_body.h"
#undef D

INLINE void point_at(const Scene *s, const double *y, const Input *input, const double *taut,
                     const Point *at) {
  to_all(s, y, s->place, at->p);
  to_all(s, y + s->free, 0, at->v);
  if (s->dimension == 2)
    differentiated_2(s, input, taut, at);
  else
    differentiated_3(s, input, taut, at);
}

/* What both calls share: the steps, and the states and points of the stages of one of them. */
typedef struct {
  Span span;
  Drive drive; /* of the step */
  const Tableau *method;
  const Steps *steps;
  double *states, *slopes; /* (stages, states) */
  double *points;          /* (stages, numbers of a point) */
  size_t point_size;
  double *rest; /* memory that is left */
} Sweep;

static void begin_sweep(Sweep *sweep, const Scene *s, const Drive *drive, const Tableau *method,
                        const Steps *steps, double *work) {
  const size_t n = 2 * (size_t)s->free, stages = method->stages;
  size_t parts[POINT_PARTS];
  sweep->drive = *drive;
  sweep->method = method;
  sweep->steps = steps;
  sweep->rest = begin(&sweep->span, s, &sweep->drive, 0, work);
  sweep->states = take(&sweep->rest, stages * n);
  sweep->slopes = take(&sweep->rest, stages * n);
  sweep->point_size = point_sizes(s, parts);
  sweep->points = take(&sweep->rest, stages * sweep->point_size);
}

static Point point_of(const Sweep *sweep, int stage) {
  double *memory = sweep->points + stage * sweep->point_size;
  return point_in(sweep->span.scene, &memory);
}

size_t tc_variations_work_size(const Scene *s, const Drive *drive, const Tableau *method,
                               int32_t columns) {
  const size_t n = 2 * (size_t)s->free, stages = method->stages, strings = s->strings;
  const size_t entries = s->entries, segments = s->segments;
  size_t parts[POINT_PARTS];
  const size_t forward =
      n * columns + COLUMNS * (stages * n + n / 2 + 4 * entries + 3 * strings + segments) + s->unknowns;
  const size_t backward = (stages + 1) * n + stages + 4 * entries + 2 * strings + segments + s->unknowns;
  return span_size(s, drive) + stages * (2 * n + point_sizes(s, parts)) +
         (forward > backward ? forward : backward);
}

/* A sum of vectors that follow one another, `apart` numbers from each to the next, by weights times
   h, added to one. */
INLINE void combine(const double *first, double h, const double *weights, int count,
                    const double *vectors, size_t apart, size_t size, double *to) {
  const double *from = first;
  int j = 0;
  while (j < count) {
    double w[4];
    const double *v[4];
    int some = 0;
    for (; j < count && some < 4; ++j)
      if (weights[j] != 0) w[some] = h * weights[j], v[some++] = vectors + j * apart;
    if (some == 4)
      for (size_t k = 0; k < size; ++k)
        to[k] = from[k] + w[0] * v[0][k] + w[1] * v[1][k] + w[2] * v[2][k] + w[3] * v[3][k];
    else
      for (int m = 0; m < some; ++m, from = to)
        for (size_t k = 0; k < size; ++k) to[k] = from[k] + w[m] * v[m][k];
    if (some) from = to;
  }
  if (from == first && to != first) memcpy(to, first, size * sizeof *to);
}

/* Finds the states at the stages of a step, and the derivatives of all members there. */
WIDE static void reach_stages(Sweep *sweep, int k) {
  const Scene *s = sweep->span.scene;
  const Tableau *method = sweep->method;
  const Steps *steps = sweep->steps;
  const int n = sweep->span.states, half = s->free, stages = method->stages;
  const size_t numbers = (size_t)sweep->drive.count * (sweep->drive.degree + 1);
  const double h = steps->length[k], *state = steps->states + (size_t)k * n;
  const double *taut = steps->taut + (size_t)k * s->switches;
  const double *inputs = steps->inputs + (numbers + (sweep->drive.degree > 0)) * k;
  sweep->drive.coefficients = inputs;
  if (sweep->drive.degree) sweep->drive.begin = inputs[numbers];
  for (int i = 0; i < stages; ++i) {
    double *y = sweep->states + (size_t)i * n, *slope = sweep->slopes + (size_t)i * n;
    const Point at = point_of(sweep, i);
    Input input;
    combine(state, h, method->a + i * stages, i, sweep->slopes, n, n, y);
    input = input_at(&sweep->span, method->c[i] * h);
    point_at(s, y, &input, taut, &at);
    memcpy(slope, y + half, half * sizeof *slope);
    for (int m = 0; m < half; ++m) slope[half + m] = at.a[s->free_row ? s->free_row[m] : m];
  }
}

/* Columns of a matrix into a block of their own, and back. */
static void pack(const double *X, int P, int rows, int first, double *block) {
  for (int i = 0; i < rows; ++i)
    memcpy(block + (size_t)COLUMNS * i, X + (size_t)P * i + first, COLUMNS * sizeof *X);
}

static void unpack(const double *block, int P, int rows, int first, double *X) {
  for (int i = 0; i < rows; ++i)
    memcpy(X + (size_t)P * i + first, block + (size_t)COLUMNS * i, COLUMNS * sizeof *X);
}

/* A block of columns over a step. */
WIDER static void step_block(const Sweep *sweep, const Lengths *lengths, int k,
                             const Changes *changes, int first, double *block, double *work) {
  const Scene *s = sweep->span.scene;
  const Tableau *method = sweep->method;
  const int stages = method->stages;
  const size_t half = (size_t)COLUMNS * s->free, size = 2 * half;
  const double h = sweep->steps->length[k], *end = sweep->steps->states + (k + 1) * (size_t)(2 * s->free);
  double *K = work, *places = K + stages * size, *rest = places + half;
  for (int i = 0; i < stages; ++i) {
    const Point at = point_of(sweep, i);
    const double *weights = method->a + i * stages;
    double *rates = K + i * size; /* which are the slopes of places */
    combine(block, h, weights, i, K, size, half, places);
    combine(block + half, h, weights, i, K + half, size, half, rates);
    if (s->dimension == 2)
      forward_2(s, &at, i, changes, first, places, rates, rates + half, rest);
    else
      forward_3(s, &at, i, changes, first, places, rates, rates + half, rest);
  }
  combine(block, h, method->b, stages, K, size, size, block);
  if (!lengths) return;
  if (s->dimension == 2)
    restored_forward_2(s, lengths, end, block);
  else
    restored_forward_3(s, lengths, end, block);
}

void tc_tangents(const Scene *s, const Drive *drive, const Lengths *lengths, const Tableau *method,
                 const Steps *steps, const Changes *changes, double *X, double *work) {
  const int P = changes->columns, n = 2 * s->free;
  Sweep sweep;
  double *blocks;
  begin_sweep(&sweep, s, drive, method, steps, work);
  blocks = take(&sweep.rest, (size_t)n * P);
  for (int first = 0; first < P; first += COLUMNS) pack(X, P, n, first, blocks + (size_t)n * first);
  for (int k = 0; k < steps->count; ++k) {
    reach_stages(&sweep, k);
    for (int first = 0; first < P; first += COLUMNS)
      step_block(&sweep, lengths, k, changes, first, blocks + (size_t)n * first, sweep.rest);
  }
  for (int first = 0; first < P; first += COLUMNS) unpack(blocks + (size_t)n * first, P, n, first, X);
}

WIDE static void step_cost(Sweep *sweep, int k, Changes *costs, double *mu, double *work) {
  const Scene *s = sweep->span.scene;
  const Tableau *method = sweep->method;
  const int stages = method->stages, half = s->free, n = 2 * half;
  const double h = sweep->steps->length[k];
  double *later = work, *kappa = later + (size_t)stages * n, *weights = kappa + n;
  double *rest = weights + stages;
  for (int i = stages - 1; i >= 0; --i) {
    const Point at = point_of(sweep, i);
    double *own = later + (size_t)i * n;
    for (int j = i + 1; j < stages; ++j) weights[j] = method->a[j * stages + i];
    for (int m = 0; m < n; ++m) kappa[m] = h * method->b[i] * mu[m];
    combine(kappa, h, weights + i + 1, stages - i - 1, own + n, n, n, kappa);
    if (s->dimension == 2)
      backward_2(s, &at, k * stages + i, costs, kappa + half, own, rest);
    else
      backward_3(s, &at, k * stages + i, costs, kappa + half, own, rest);
    for (int m = 0; m < half; ++m) own[half + m] += kappa[m];
  }
  for (int i = 0; i < stages; ++i)
    for (int m = 0; m < n; ++m) mu[m] += later[i * n + m];
}

void tc_costs(const Scene *s, const Drive *drive, const Lengths *lengths, const Tableau *method,
              const Steps *steps, Changes *costs, double *mu, double *work) {
  const size_t n = 2 * (size_t)s->free;
  Sweep sweep;
  begin_sweep(&sweep, s, drive, method, steps, work);
  for (int k = steps->count - 1; k >= 0; --k) {
    if (lengths && s->dimension == 2)
      restored_backward_2(s, lengths, steps->states + (k + 1) * n, mu);
    else if (lengths)
      restored_backward_3(s, lengths, steps->states + (k + 1) * n, mu);
    reach_stages(&sweep, k);
    step_cost(&sweep, k, costs, mu, sweep.rest);
  }
}
