/* The largest frequency of small motions about a state. */
#include <string.h>

#include "motion.h"

enum { POWER_ITERATIONS = 60 };

SHARED size_t frequency_size(const Scene *s) { return 7 * (size_t)s->free + s->switches; }

/* By power iteration on the derivative of the accelerations by positions, from differences of a
   length, with all strings taut and contacts open. */
SHARED Number frequency_of(Span *span, const Number *state, Number difference, const double *vector,
                           Number *work) {
  const int half = span->scene->free;
  Number *x = work, *forward = x + 2 * half, *back = forward + 2 * half, *along = back + 2 * half;
  Number *taut = along + half, size = all(0);
  for (int i = 0; i < span->switches; ++i) taut[i] = all(i < span->scene->slacking);
  for (int i = 0; i < half; ++i) along[i] = all(vector[i]);
  for (int count = 0; count <= POWER_ITERATIONS; ++count) {
    Number scale;
    size = all(0);
    for (int i = 0; i < half; ++i) size += along[i] * along[i];
    size = root(size);
    if (count == POWER_ITERATIONS) break;
    scale = choice(size > 0, size, all(1));
    for (int sign = 1; sign >= -1; sign -= 2) {
      memcpy(x, state, 2 * half * sizeof *x);
      for (int i = 0; i < half; ++i) x[i] += (double)sign * (difference * along[i] / scale);
      slope_at(span, x, all(0), taut, sign > 0 ? forward : back);
    }
    for (int i = 0; i < half; ++i)
      along[i] = (forward[half + i] - back[half + i]) / (2 * difference);
  }
  return root(size);
}
