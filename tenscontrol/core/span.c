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
  return equation_work_size(s) + 2 * (size_t)drive->count + (drive->is_driven ? s->bars : 0) + 13 * m +
         4 * n + restored_size(s) + carry_size(s);
}

SHARED Number *begin(Span *span, const Scene *s, const Drive *drive, const Lengths *lengths, Number *work) {
  const int n = 2 * s->free, m = s->switches;
  Number **arrays[] = {&span->gap,    &span->rate,    &span->scale,  &span->rooms,
                       &span->inside, &span->outside, &span->chosen, &span->leaving,
                       &span->within, &span->marked,  &span->gap0,   &span->gap1};
  span->scene = s;
  span->drive = drive;
  span->lengths = lengths;
  span->states = n;
  span->switches = m;
  span->goes_on = 0;
  span->work = work;
  work += equation_work_size(s);
  span->values = work;
  span->rates = work + drive->count;
  span->extension = work + 2 * drive->count;
  work = span->extension + (drive->is_driven ? s->bars : 0);
  for (size_t i = 0; i < sizeof arrays / sizeof *arrays; ++i, work += m) *arrays[i] = work;
  span->some.which = (int32_t *)work;
  work += m;
  span->middle = work;
  span->coefficients = work + n;
  span->restored = work + 4 * n;
  span->carried = span->restored + restored_size(s);
  return span->carried + carry_size(s);
}

/* The driven lengths of bars, their rates and accelerations in time. */
static void put_lengths(Span *span, Number t, const Number *length, Input *input) {
  const Drive *drive = span->drive;
  const int n = drive->count, bars = span->scene->bars, first = n - bars, degree = drive->degree;
  const Number *c = numbers(drive->coefficients) + first;
  Number *rate = span->rates + first, *extension = span->extension;
  for (int i = 0; i < bars; ++i) {
    Number speed = all(0), acceleration = all(0);
    for (int k = degree; k > 0; --k) speed = speed * t + (double)k * c[k * n + i];
    for (int k = degree; k > 1; --k) acceleration = acceleration * t + (double)(k * (k - 1)) * c[k * n + i];
    rate[i] = speed;
    extension[i] = length[i] * acceleration + speed * speed;
  }
  input->length = length;
  input->length_rate = rate;
  input->extension = extension;
}

SHARED Input input_at(Span *span, Number time) {
  const Scene *s = span->scene;
  const Drive *drive = span->drive;
  const int n = drive->count;
  const int moved = n - s->entries - (drive->is_driven ? s->bars : 0);
  const Number *c = numbers(drive->coefficients), *values = c;
  Input input;
  if (drive->degree) {
    const Number t = drive->begin + time;
    Number *to = span->values;
    for (int i = 0; i < n; ++i) to[i] = c[drive->degree * n + i];
    for (int k = drive->degree - 1; k >= 0; --k)
      for (int i = 0; i < n; ++i) to[i] = to[i] * t + c[k * n + i];
    values = to;
    if (drive->is_moved) {
      const int end = moved + s->entries;
      Number *rate = span->rates;
      for (int i = moved; i < end; ++i) rate[i] = (double)drive->degree * c[drive->degree * n + i];
      for (int k = drive->degree - 1; k > 0; --k)
        for (int i = moved; i < end; ++i) rate[i] = rate[i] * t + (double)k * c[k * n + i];
    }
  }
  input.strings = values;
  input.load = drive->is_loaded ? values + s->strings : 0;
  input.offset = drive->is_moved ? values + moved : 0;
  input.offset_rate = drive->is_moved && drive->degree ? span->rates + moved : 0;
  input.length = input.length_rate = input.extension = 0;
  if (drive->is_driven) put_lengths(span, drive->begin + time, values + n - s->bars, &input);
  return input;
}

SHARED void slope_at(Span *span, const Number *x, Number time, const Number *taut, Number *slope) {
  const Input input = input_at(span, time);
  slope_of(span->scene, x, &input, taut, slope, span->work);
}

/* The rate of a stretch is less by that of the rest length. */
SHARED void gap_at(Span *span, const Number *x, Number time, const Some *some, Number *gap, Number *rate) {
  const Input input = input_at(span, time);
  const Drive *drive = span->drive;
  gap_of(span->scene, x, &input, some, gap, rate, span->work);
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
