/* Small changes of a step, forward, and costs of its end, backward. */
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
      touches(s) * d * (2 * d + GROUND_NUMBERS), s->free_bars * 8 * d * d,
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
static double string_slopes(const Scene *s, int i, double length, double rate, double rest,
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

static void point_at(const Scene *s, const double *y, const Input *input, const double *taut,
                     const Point *at) {
  to_all(s, y, s->place, at->p);
  to_all(s, y + s->free, 0, at->v);
  if (s->dimension == 2)
    differentiated_2(s, input, taut, at);
  else
    differentiated_3(s, input, taut, at);
}

/* What both calls share: the span, the stages of the primal step, and a point. */
typedef struct {
  Span span;
  Point point;
  double *states, *slopes; /* (stages, states) */
  double *rest;            /* memory that is left */
} Step;

static Step step_in(const Scene *s, const Drive *drive, const Tableau *method, double *work) {
  const size_t n = 2 * (size_t)s->free;
  Step step;
  step.rest = begin(&step.span, s, drive, 0, work);
  step.states = take(&step.rest, method->stages * n);
  step.slopes = take(&step.rest, method->stages * n);
  step.point = point_in(s, &step.rest);
  return step;
}

size_t tc_variations_work_size(const Scene *s, const Drive *drive, const Tableau *method,
                               int32_t columns) {
  const size_t n = 2 * (size_t)s->free, stages = method->stages;
  size_t parts[POINT_PARTS];
  const size_t block = (size_t)COLUMNS * (4 * (size_t)s->entries + 3 * (size_t)s->strings + s->segments);
  const size_t forward = (stages + 1) * n * columns + block + s->unknowns;
  const size_t backward = stages * n + n + 5 * (size_t)s->entries + 2 * (size_t)s->strings +
                          s->segments + s->unknowns;
  return span_size(s, drive) + 2 * stages * n + point_sizes(s, parts) +
         (forward > backward ? forward : backward);
}

/* Finds the state at a stage, y, and the derivatives of all members there. */
static void reach_stage(Step *step, const Tableau *method, int i, double h, const double *state,
                        const double *taut) {
  const Scene *s = step->span.scene;
  const int n = step->span.states, half = s->free;
  double *y = step->states + (size_t)i * n, *slope = step->slopes + (size_t)i * n;
  Input input;
  memcpy(y, state, n * sizeof *y);
  for (int j = 0; j < i; ++j) {
    const double weight = h * method->a[i * method->stages + j];
    const double *other = step->slopes + (size_t)j * n;
    if (weight == 0) continue;
    for (int k = 0; k < n; ++k) y[k] += weight * other[k];
  }
  input = input_at(&step->span, method->c[i] * h);
  point_at(s, y, &input, taut, &step->point);
  memcpy(slope, y + half, half * sizeof *slope);
  for (int k = 0; k < half; ++k)
    slope[half + k] = step->point.a[s->free_row ? s->free_row[k] : k];
}

static void add_rows(double weight, const double *from, size_t count, double *to) {
  for (size_t k = 0; k < count; ++k) to[k] += weight * from[k];
}

WIDE void tc_step_tangents(const Scene *s, const Drive *drive, const Tableau *method, double h,
                           const double *state, const double *taut, const Changes *changes,
                           double *X, double *work) {
  Step step = step_in(s, drive, method, work);
  const int stages = method->stages, P = changes->columns, half = s->free;
  const size_t size = (size_t)2 * half * P;
  double *K = take(&step.rest, stages * size), *Y = take(&step.rest, size);
  for (int i = 0; i < stages; ++i) {
    double *to = K + i * size;
    reach_stage(&step, method, i, h, state, taut);
    memcpy(Y, X, size * sizeof *Y);
    for (int j = 0; j < i; ++j)
      if (method->a[i * stages + j] != 0) add_rows(h * method->a[i * stages + j], K + j * size, size, Y);
    memcpy(to, Y + size / 2, size / 2 * sizeof *to);
    for (int first = 0; first < P; first += COLUMNS) {
      if (s->dimension == 2)
        forward_2(s, &step.point, i, changes, first, Y, to + size / 2, step.rest);
      else
        forward_3(s, &step.point, i, changes, first, Y, to + size / 2, step.rest);
    }
  }
  for (int i = 0; i < stages; ++i)
    if (method->b[i] != 0) add_rows(h * method->b[i], K + i * size, size, X);
}

void tc_step_costs(const Scene *s, const Drive *drive, const Tableau *method, double h,
                   const double *state, const double *taut, Changes *costs, double *mu,
                   double *work) {
  Step step = step_in(s, drive, method, work);
  const int stages = method->stages, half = s->free, n = 2 * half;
  double *later = take(&step.rest, (size_t)stages * n), *kappa = take(&step.rest, n);
  for (int i = 0; i < stages; ++i) reach_stage(&step, method, i, h, state, taut);
  for (int i = stages - 1; i >= 0; --i) {
    double *own = later + (size_t)i * n;
    Input input = input_at(&step.span, method->c[i] * h);
    memset(kappa, 0, n * sizeof *kappa);
    add_rows(h * method->b[i], mu, n, kappa);
    for (int j = i + 1; j < stages; ++j)
      if (method->a[j * stages + i] != 0)
        add_rows(h * method->a[j * stages + i], later + (size_t)j * n, n, kappa);
    if (i < stages - 1) point_at(s, step.states + (size_t)i * n, &input, taut, &step.point);
    if (s->dimension == 2)
      backward_2(s, &step.point, i, costs, kappa + half, own, step.rest);
    else
      backward_3(s, &step.point, i, costs, kappa + half, own, step.rest);
    for (int k = 0; k < half; ++k) own[half + k] += kappa[k];
  }
  for (int i = 0; i < stages; ++i) add_rows(1, later + (size_t)i * n, n, mu);
}
