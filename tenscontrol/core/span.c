/* A span of a motion, one run or several in lanes: its memory, its inputs in time, and slopes and gaps
   there. */
#include <string.h>

#include "motion.h"

static size_t restored_size(const Scene *s) {
  return 2 * (size_t)s->free + 2 * (size_t)s->entries + s->factors + 2 * (size_t)s->unknowns + 1 +
         s->block_rows;
}

SHARED size_t span_size(const Scene *s, const Drive *drive) {
  const size_t n = 2 * (size_t)s->free, m = s->switches;
  return equation_work_size(s) + 2 * (size_t)drive->count + 12 * m + 4 * n + restored_size(s) +
         carry_size(s);
}

SHARED Number *begin(Span *span, const Scene *s, const Drive *drive, const Lengths *lengths,
                     Number *work) {
  const int n = 2 * s->free, m = s->switches;
  Number **arrays[] = {&span->gap,     &span->rate,   &span->scale,   &span->rooms,  &span->inside,
                       &span->outside, &span->chosen, &span->leaving, &span->within, &span->marked,
                       &span->gap0,    &span->gap1};
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

SHARED Input input_at(Span *span, Number time) {
  const Scene *s = span->scene;
  const Drive *drive = span->drive;
  const int n = drive->count;
  const Number *c = numbers(drive->coefficients), *values = c, *offset;
  Input input;
  if (drive->degree) {
    const Number t = drive->begin + time;
    Number *to = span->values;
    for (int i = 0; i < n; ++i) to[i] = c[drive->degree * n + i];
    for (int k = drive->degree - 1; k >= 0; --k)
      for (int i = 0; i < n; ++i) to[i] = to[i] * t + c[k * n + i];
    values = to;
    if (drive->is_moved) {
      const int first = n - s->entries;
      Number *rate = span->rates;
      for (int i = first; i < n; ++i) rate[i] = (double)drive->degree * c[drive->degree * n + i];
      for (int k = drive->degree - 1; k > 0; --k)
        for (int i = first; i < n; ++i) rate[i] = rate[i] * t + (double)k * c[k * n + i];
    }
  }
  offset = values + n - s->entries;
  input.strings = values;
  input.load = drive->is_loaded ? values + s->strings : 0;
  input.offset = drive->is_moved ? offset : 0;
  input.offset_rate = drive->is_moved && drive->degree ? span->rates + n - s->entries : 0;
  return input;
}

SHARED void slope_at(Span *span, const Number *x, Number time, const Number *taut, Number *slope) {
  const Input input = input_at(span, time);
  slope_of(span->scene, x, &input, taut, slope, span->work);
}

/* The rate of a stretch is less by that of the rest length. */
SHARED void gap_at(Span *span, const Number *x, Number time, const Number *marked, Number *gap,
                   Number *rate) {
  const Input input = input_at(span, time);
  const Drive *drive = span->drive;
  gap_of(span->scene, x, &input, marked, gap, rate, span->work);
  if (rate && drive->degree) {
    const int n = drive->count;
    const Number t = drive->begin + time;
    const Number *c = numbers(drive->coefficients);
    for (int i = 0; i < span->scene->slacking; ++i) {
      Number change = (double)drive->degree * c[drive->degree * n + i];
      for (int k = drive->degree - 1; k > 0; --k) change = change * t + (double)k * c[k * n + i];
      rate[i] -= change;
    }
  }
}
