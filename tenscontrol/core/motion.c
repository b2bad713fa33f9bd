/* A span of a motion: its inputs in time, its memory, bars on their lengths, and the loop. */
#include "motion.h"

#include <math.h>
#include <string.h>

#include "methods.h"

Input input_at(Span *span, double time) {
  const Scene *s = span->scene;
  const Drive *drive = span->drive;
  const int n = drive->count;
  const double *c = drive->coefficients, *values = c, *offset;
  Input input;
  if (drive->degree) {
    const double t = drive->begin + time;
    double *to = span->values;
    for (int i = 0; i < n; ++i) to[i] = c[drive->degree * n + i];
    for (int k = drive->degree - 1; k >= 0; --k)
      for (int i = 0; i < n; ++i) to[i] = to[i] * t + c[k * n + i];
    values = to;
    if (drive->is_moved) {
      const int first = n - s->entries;
      double *rate = span->rates;
      for (int i = first; i < n; ++i) rate[i] = drive->degree * c[drive->degree * n + i];
      for (int k = drive->degree - 1; k > 0; --k)
        for (int i = first; i < n; ++i) rate[i] = rate[i] * t + k * c[k * n + i];
    }
  }
  offset = values + n - s->entries;
  input.strings = values;
  input.load = drive->is_loaded ? values + s->strings : 0;
  input.offset = drive->is_moved ? offset : 0;
  input.offset_rate = drive->is_moved && drive->degree ? span->rates + n - s->entries : 0;
  return input;
}

void slope_at(Span *span, const double *x, double time, const double *taut, double *slope) {
  const Input input = input_at(span, time);
  slope_of(span->scene, x, &input, taut, slope, span->work);
}

/* The rate of a stretch is less by that of the rest length. */
void gap_at(Span *span, const double *x, double time, double *gap, double *rate) {
  const Input input = input_at(span, time);
  const Drive *drive = span->drive;
  gap_of(span->scene, x, &input, gap, rate, span->work);
  if (drive->degree) {
    const int n = drive->count;
    const double t = drive->begin + time, *c = drive->coefficients;
    for (int i = 0; i < span->scene->slacking; ++i) {
      double change = drive->degree * c[drive->degree * n + i];
      for (int k = drive->degree - 1; k > 0; --k) change = change * t + k * c[k * n + i];
      rate[i] -= change;
    }
  }
}

static size_t restored_size(const Scene *s) {
  return 2 * (size_t)s->free + 2 * (size_t)s->entries + s->factors + 2 * (size_t)s->unknowns + 1 +
         s->block_rows;
}

size_t tc_motion_work_size(const Scene *s, const Drive *drive) {
  const size_t n = 2 * (size_t)s->free, m = s->switches;
  return equation_work_size(s) + 2 * (size_t)drive->count + 10 * m + 4 * n + restored_size(s) +
         carry_size(s) + METHOD_STATES * n;
}

/* Lays out a span in memory; returns what is left of it. */
static double *begin(Span *span, const Scene *s, const Drive *drive, const Lengths *lengths,
                     double *work) {
  const int n = 2 * s->free, m = s->switches;
  double **arrays[] = {&span->gap,    &span->rate,   &span->scale,   &span->rooms, &span->inside,
                       &span->outside, &span->chosen, &span->leaving, &span->within};
  span->scene = s;
  span->drive = drive;
  span->lengths = lengths;
  span->states = n;
  span->switches = m;
  span->work = work;
  work += equation_work_size(s);
  span->values = work;
  span->rates = work + drive->count;
  work += 2 * drive->count;
  for (size_t i = 0; i < sizeof arrays / sizeof *arrays; ++i, work += m) *arrays[i] = work;
  span->middle = work;
  span->coefficients = work + n;
  span->restored = work + 4 * n;
  span->carried = span->restored + restored_size(s);
  return span->carried + carry_size(s);
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
  gap_at(&span, state, 0, gap, rate);
}

void tc_taut(const Scene *s, const Drive *drive, const double *state, double *taut, double *work) {
  Span span;
  begin(&span, s, drive, 0, work);
  gap_at(&span, state, 0, span.gap, span.rate);
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
