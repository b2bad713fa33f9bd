/* Forces of bars whose lengths are driven, and the work of their drives along a motion. */
#include <string.h>

#include "motion.h"

/* A state at a time with its slope, and the force densities of bars and the power of drives there. */
typedef struct {
  const double *x;
  double time, *slope, *density, *power;
} Instant;

/* Memory of one. */
static size_t instant_size(const Scene *s) { return 2 * (size_t)s->free + 2 * (size_t)s->bars; }

static Instant instant_in(const Scene *s, double *memory) {
  const Instant at = {0, 0, memory, memory + 2 * s->free, memory + 2 * s->free + s->bars};
  return at;
}

static void evaluate(Span *span, Instant *at, double *taut) {
  const Scene *s = span->scene;
  Input input;
  gap_at(span, at->x, at->time, 0, span->gap, span->rate);
  for (int i = 0; i < span->switches; ++i) taut[i] = span->gap[i] > 0;
  input = input_at(span, at->time);
  slope_and_bars(s, at->x, &input, taut, at->slope, at->density, span->work);
  for (int i = 0; i < s->bars; ++i) at->power[i] = at->density[i] * input.length[i] * input.length_rate[i];
}

size_t tc_strut_work_size(const Scene *s, const Drive *drive) {
  return span_size(s, drive) + 3 * instant_size(s) + 2 * (size_t)s->free + s->switches;
}

static void add(const double *power, double factor, int count, double *to) {
  for (int i = 0; i < count; ++i) to[i] += factor * power[i];
}

void tc_strut_work(const Scene *s, const Drive *drive, const Quadrature *quadrature, int32_t parts,
                   const double *times, const double *states, double *density, double *strut_work,
                   double *work) {
  Span span;
  double *rest = begin(&span, s, drive, 0, work), *y, *taut;
  const int n = span.states, bars = s->bars, last = quadrature->count - 1;
  const double *weights = quadrature->weights;
  Instant before = instant_in(s, rest), after = instant_in(s, rest + instant_size(s));
  Instant inside = instant_in(s, rest + 2 * instant_size(s));
  y = rest + 3 * instant_size(s);
  taut = y + n;
  after.x = states;
  after.time = times[0];
  evaluate(&span, &after, taut);
  memcpy(density, after.density, bars * sizeof *density);
  for (int k = 1; k <= parts; ++k) {
    const Instant old = before;
    const double h = times[k] - times[k - 1];
    double *sum = strut_work + (size_t)(k - 1) * bars;
    Tried path;
    before = after;
    after = old;
    after.x = states + (size_t)k * n;
    after.time = times[k];
    evaluate(&span, &after, taut);
    memcpy(density + (size_t)k * bars, after.density, bars * sizeof *density);
    path = (Tried){before.x, after.x, before.slope, after.slope, taut, before.time, h};
    make_path(&span, &path);
    memset(sum, 0, bars * sizeof *sum);
    add(before.power, weights[0] * h, bars, sum);
    for (int j = 1; j < last; ++j) {
      inside.x = y;
      inside.time = before.time + quadrature->shares[j] * h;
      on_path(&span, h, quadrature->shares[j], y);
      evaluate(&span, &inside, taut);
      add(inside.power, weights[j] * h, bars, sum);
    }
    add(after.power, weights[last] * h, bars, sum);
  }
}
