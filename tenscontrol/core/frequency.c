/* The largest frequency of small motions about a state. */
#include <string.h>

#include "motion.h"

/* Iterations, at most and at least, and the change of the square from one to the next, as part of it,
   from which on they end. */
enum { POWER_ITERATIONS = 60, FEWEST_ITERATIONS = 8 };
static const double SETTLED = 1e-3;

SHARED size_t frequency_size(const Scene *s) { return 7 * (size_t)s->free + s->switches; }

/* By power iteration on the derivative of the accelerations by positions, from differences of a
   length, with all strings taut and contacts open. */
SHARED Number frequency_of(Span *span, const Number *state, Number difference, const double *vector,
                           Number *work) {
  const int half = span->scene->free;
  Number *x = work, *base = x + 2 * half, *slope = base + 2 * half, *along = slope + 2 * half;
  Number *taut = along + half, size = all(0);
  Truth goes_on = size == 0;
  for (int i = 0; i < span->switches; ++i) taut[i] = all(i < span->scene->slacking);
  for (int i = 0; i < half; ++i) along[i] = all(vector[i]);
  memcpy(x, state, 2 * half * sizeof *x);
  slope_at(span, x, all(0), taut, base);
  for (int count = 0; count <= POWER_ITERATIONS; ++count) {
    const Number before = size;
    Number scale;
    size = all(0);
    for (int i = 0; i < half; ++i) size += along[i] * along[i];
    size = root(size);
    if (count >= FEWEST_ITERATIONS) goes_on &= positive(size - before) > SETTLED * size;
    if (count == POWER_ITERATIONS || !any(goes_on)) break;
    scale = choice(size > 0, size, all(1));
    for (int i = 0; i < half; ++i) x[i] = state[i] + difference * along[i] / scale;
    slope_at(span, x, all(0), taut, slope);
    for (int i = 0; i < half; ++i)
      along[i] = choice(goes_on, (slope[half + i] - base[half + i]) / difference, along[i]);
  }
  return root(size);
}
