/* The calls of the core. */
#include "motion.h"

#include <math.h>
#include <string.h>

#include "methods.h"

size_t tc_motion_work_size(const Scene *s, const Drive *drive) {
  return span_size(s, drive) + METHOD_STATES * 2 * (size_t)s->free;
}

void tc_slope(const Scene *s, const Drive *drive, const double *state, const double *taut,
              double *slope, double *work) {
  Span span;
  begin(&span, s, drive, 0, work);
  slope_at(&span, state, 0, taut, slope);
}

void tc_forces(const Scene *s, const Drive *drive, const double *state, const double *taut,
               double *forces, double *work) {
  Span span;
  Input input;
  begin(&span, s, drive, 0, work);
  input = input_at(&span, 0);
  forces_of(s, state, &input, taut, forces, span.work);
}

void tc_gap(const Scene *s, const Drive *drive, const double *state, double *gap, double *rate,
            double *work) {
  Span span;
  begin(&span, s, drive, 0, work);
  gap_at(&span, state, 0, 0, gap, rate);
}

void tc_taut(const Scene *s, const Drive *drive, const double *state, double *taut, double *work) {
  Span span;
  begin(&span, s, drive, 0, work);
  gap_at(&span, state, 0, 0, span.gap, span.rate);
  for (int i = 0; i < span.switches; ++i) taut[i] = span.gap[i] > 0;
}

void tc_restore(const Scene *s, const Drive *drive, const Lengths *lengths, double *state,
                double *work) {
  Span span;
  begin(&span, s, drive, lengths, work);
  restore_bars(&span, state);
}

double tc_frequency(const Scene *s, const Drive *drive, const double *state, double difference,
                    const double *vector, double *work) {
  enum { ITERATIONS = 60 };
  Span span;
  double *rest = begin(&span, s, drive, 0, work), *x = rest, *there = x + span.states;
  double *back = there + span.states, *along = back + span.states, *taut = along + span.states;
  double size = 0;
  const int half = s->free;
  for (int i = 0; i < span.switches; ++i) taut[i] = i < s->slacking;
  memcpy(along, vector, half * sizeof *along);
  for (int count = 0; count <= ITERATIONS; ++count) {
    size = 0;
    for (int i = 0; i < half; ++i) size += along[i] * along[i];
    size = sqrt(size);
    if (count == ITERATIONS) break;
    for (int sign = 1; sign >= -1; sign -= 2) {
      memcpy(x, state, 2 * half * sizeof *x);
      for (int i = 0; i < half; ++i) x[i] += sign * (difference * along[i] / (size > 0 ? size : 1));
      slope_at(&span, x, 0, taut, sign > 0 ? there : back);
    }
    for (int i = 0; i < half; ++i) along[i] = (there[half + i] - back[half + i]) / (2 * difference);
  }
  return sqrt(size);
}

int32_t tc_advance(const Scene *scene, const Drive *drive, const Lengths *lengths,
                   const Settings *settings, Progress *progress, double *state, double *slope,
                   double *taut, double *states, double *work) {
  Span span;
  double *rest = begin(&span, scene, drive, settings->projects ? lengths : 0, work);
  if (settings->method == RK4_METHOD)
    return advance_by_rk4(&span, settings, progress, state, taut, states, rest);
  return advance_by_dop853(&span, settings, progress, state, slope, taut, states, rest);
}
