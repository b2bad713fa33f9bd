/* Bars put on their lengths, and what stretches them removed from velocities. */
#include <string.h>

#include "blocks.h"
#include "motion.h"

/* Scales the vector from one end of a bar to its length, and removes what its rate has along it. */
static inline void restore(const Number *bar, const Number *rate, Number length, int d, Number *new_bar,
                           Number *new_rate) {
  Number square = all(0), along = all(0), scale;
  for (int k = 0; k < d; ++k) {
    square += bar[k] * bar[k];
    along += bar[k] * rate[k];
  }
  scale = length / root(square);
  for (int k = 0; k < d; ++k) {
    new_bar[k] = bar[k] * scale;
    new_rate[k] = (rate[k] - bar[k] * (along / square)) * (1 / scale);
  }
}

/* The length of a bar among those of a kind: that of its drive, if lengths are driven. */
static inline Number length_of(const Input *input, const int32_t *bars, int i, const double *own) {
  return input->length ? input->length[bars[i]] : all(own[i]);
}

/* Adds to the rate of a bar what its drive stretches it by. */
static inline void stretch(const Input *input, const int32_t *bars, int i, int d, const Number *bar,
                           Number *rate) {
  if (!input->length) return;
  for (int k = 0; k < d; ++k) rate[k] += bar[k] * (input->length_rate[bars[i]] / input->length[bars[i]]);
}

/* Puts bars that share no nodes on their lengths: the nearest state in the metric of the mass.

   Rates are scaled by the inverse, so that the cross product of bar and rate stays. Centres, string
   nodes and hinges stay, and momenta with them, to round-off. */
static inline void restore_alone(Span *span, const Input *input, int d, Number *x) {
  const Scene *s = span->scene;
  const int free = s->free;
  for (int i = 0; i < s->free_bars; ++i) {
    Number *a = x + s->bar_row[2 * i], *b = x + s->bar_row[2 * i + 1];
    Number bar[3], rate[3], new_bar[3], new_rate[3];
    for (int k = 0; k < d; ++k) {
      bar[k] = b[k] - a[k];
      rate[k] = b[free + k] - a[free + k];
    }
    restore(bar, rate, length_of(input, s->free_bar, i, span->lengths->bar_length), d, new_bar, new_rate);
    stretch(input, s->free_bar, i, d, new_bar, new_rate);
    for (int k = 0; k < d; ++k) {
      const Number centre = (a[k] + b[k]) / 2, speed = (a[free + k] + b[free + k]) / 2;
      a[k] = centre - new_bar[k] / 2;
      b[k] = centre + new_bar[k] / 2;
      a[free + k] = speed - new_rate[k] / 2;
      b[free + k] = speed + new_rate[k] / 2;
    }
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    Number *b = x + s->tip_row[i];
    const Number *hinge = numbers(s->place) + s->hinge[i];
    Number bar[3], new_bar[3], new_rate[3];
    for (int k = 0; k < d; ++k) bar[k] = b[k] - hinge[k];
    restore(bar, b + free, length_of(input, s->swinging_bar, i, span->lengths->tip_length), d, new_bar,
            new_rate);
    stretch(input, s->swinging_bar, i, d, new_bar, new_rate);
    for (int k = 0; k < d; ++k) {
      b[k] = hinge[k] + new_bar[k];
      b[free + k] = new_rate[k];
    }
  }
}

/* Newton's iteration with the matrix of its start leaves, each time, such a part of the error as the
   angle by which bars turn. It ends where a change is this part of the size, or where it is small
   and, by round-off, is not halved again. Bars may turn by one rad. */
enum { MOST_ITERATIONS = 40 };
static const double TINY = 2e-16, SMALL = 1e-12, LEAST_COSINE = 0.54030230586813977;

/* Positions or velocities of all entries of the structure. */
static void spread_all(const Scene *s, const Number *free, int are_places, Number *to) {
  if (!s->free_row) {
    memcpy(to, free, s->entries * sizeof *to);
    return;
  }
  if (are_places) memcpy(to, s->place, s->entries * sizeof *to);
  else memset(to, 0, s->entries * sizeof *to);
  for (int i = 0; i < s->free; ++i) to[s->free_row[i]] = free[i];
}

static void factorize_at(const Scene *s, const Number *p, Number *K) {
  const int d = s->dimension;
  memcpy(K, s->block_mass, (s->factors + s->unknowns + 1) * sizeof *K);
  for (int i = 0; i < s->block_bars; ++i)
    for (int k = 0; k < d; ++k) {
      const Number b = p[s->block_end[i] + k] - p[s->block_start[i] + k];
      K[s->entry_end[d * i + k]] = b;
      K[s->entry_start[d * i + k]] = -b;
    }
  factorize(s, K);
}

static Number dot_of_bars(const Scene *s, int i, const Number *a, const Number *b) {
  Number sum = all(0);
  for (int k = 0; k < s->dimension; ++k)
    sum += (a[s->block_end[i] + k] - a[s->block_start[i] + k]) *
           (b[s->block_end[i] + k] - b[s->block_start[i] + k]);
  return sum;
}

/* The change of the rows of blocks that solves J change = right, along the inverse of M times J'. */
static void change_of(const Scene *s, const Number *K, Number *y, Number *to) {
  solve(s, K, y);
  for (int i = 0; i < s->block_rows; ++i) to[i] = y[s->block_place[i]];
}

static Number cross_part(const Number *a, const Number *b, int axis) {
  const int i = (axis + 1) % 3, j = (axis + 2) % 3;
  return a[i] * b[j] - a[j] * b[i];
}

/* Adds the mass, its first moment, its spread and its angular momentum about the origin. */
typedef struct {
  double mass;
  Number first[3], spread[3][3], momentum[3];
} Moments;

static void add(Moments *m, double mass, const Number *r, const Number *q, const Number *v, int d) {
  Number a[3], b[3], c[3];
  memset(a, 0, sizeof a);
  memset(b, 0, sizeof b);
  memset(c, 0, sizeof c);
  memcpy(a, r, d * sizeof *a);
  memcpy(b, q, d * sizeof *b);
  memcpy(c, v, d * sizeof *c);
  for (int i = 0; i < 3; ++i) {
    m->first[i] += mass * a[i];
    m->momentum[i] += mass * cross_part(a, c, i);
    for (int j = 0; j < 3; ++j) m->spread[i][j] += mass * a[i] * b[j];
  }
  m->mass += mass;
}

static Moments moments_of(const Body *body, const Number *x, int free, int d) {
  Moments m;
  memset(&m, 0, sizeof m);
  for (int i = 0; i < body->bars; ++i) {
    const double mass = body->bar_mass[i];
    const Number *a = x + body->start[i], *b = x + body->end[i];
    add(&m, mass / 3, a, a, a + free, d);
    add(&m, mass / 6, a, b, b + free, d);
    add(&m, mass / 6, b, a, a + free, d);
    add(&m, mass / 3, b, b, b + free, d);
  }
  for (int i = 0; i < body->nodes; ++i) {
    const Number *a = x + body->node[i];
    add(&m, body->point_mass[i], a, a, a + free, d);
  }
  return m;
}

/* Solves a positive definite 3 x 3 system by LDL'; all of it is used up. */
static void solve3(Number A[3][3], Number *b, Number *x) {
  for (int j = 0; j < 3; ++j)
    for (int i = j + 1; i < 3; ++i) {
      const Number factor = A[i][j] / A[j][j];
      for (int k = j; k < 3; ++k) A[i][k] -= factor * A[j][k];
      b[i] -= factor * b[j];
    }
  for (int i = 2; i >= 0; --i) {
    x[i] = b[i];
    for (int k = i + 1; k < 3; ++k) x[i] -= A[i][k] * x[k];
    x[i] /= A[i][i];
  }
}

/* Turns a body so that it has the angular momentum that it had before. */
static void turn(const Body *body, const Number *before, Number *x, int free, int d) {
  Moments old = moments_of(body, before, free, d), new = moments_of(body, x, free, d);
  Number inertia[3][3], centre[3], lost[3], turn[3], trace = all(0);
  memset(turn, 0, sizeof turn);
  for (int i = 0; i < 3; ++i) {
    centre[i] = new.first[i] / new.mass;
    lost[i] = old.momentum[i] - new.momentum[i];
    trace += new.spread[i][i] - new.mass * centre[i] * centre[i];
  }
  if (d == 2) turn[2] = lost[2] / trace;
  else {
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        inertia[i][j] =
            (i == j ? (1 + 1e-12) * trace : all(0)) - (new.spread[i][j] - new.mass * centre[i] * centre[j]);
    solve3(inertia, lost, turn);
  }
  for (int i = 0; i < body->nodes; ++i) {
    Number *a = x + body->node[i], arm[3];
    memset(arm, 0, sizeof arm);
    for (int k = 0; k < d; ++k) arm[k] = a[k] - centre[k];
    for (int k = 0; k < d; ++k) a[free + k] += cross_part(turn, arm, k);
  }
}

/* Puts bars that share nodes on their lengths: the least change in the metric of the mass. Momenta
   stay. Not a number where they are not found near by. */
static void restore_blocks(Span *span, const Input *input, Number *x) {
  const Scene *s = span->scene;
  const Lengths *lengths = span->lengths;
  const int rows = s->block_rows, free = s->free;
  Number *before = span->restored, *p = before + 2 * free, *p0 = p + s->entries;
  Number *K = p0 + s->entries, *y = K + s->factors + s->unknowns + 1, *change = y + s->unknowns;
  Number last = all(INFINITY), previous = last, scale = all(0);
  Truth good = last > 0, going = good;
  memcpy(before, x, 2 * free * sizeof *x);
  for (int i = 0; i < rows; ++i) scale = larger(positive(x[lengths->block_free[i]]), scale);
  scale += s->size;
  spread_all(s, x, 1, p0);
  factorize_at(s, p0, K);
  memcpy(p, p0, s->entries * sizeof *p);
  for (int count = 0; count < MOST_ITERATIONS; ++count) {
    Number square = all(0);
    going &= ((last < SMALL * scale) & (last >= previous / 2)) == 0;
    going &= last > TINY * scale;
    if (!any(going)) break;
    memset(y, 0, s->unknowns * sizeof *y);
    for (int i = 0; i < s->block_bars; ++i) {
      const Number length = length_of(input, s->block_bar, i, lengths->block_length);
      y[s->right_place[i]] = -(dot_of_bars(s, i, p, p) - length * length) / 2;
    }
    change_of(s, K, y, change);
    for (int i = 0; i < rows; ++i) {
      Number *to = x + lengths->block_free[i];
      *to = choice(going, *to + change[i], *to);
      square += change[i] * change[i];
    }
    previous = choice(going, last, previous);
    last = choice(going, root(square), last);
    spread_all(s, x, 1, p);
  }
  for (int i = 0; i < s->block_bars; ++i) {
    const Number length = length_of(input, s->block_bar, i, lengths->block_length);
    good &= dot_of_bars(s, i, p0, p) >= LEAST_COSINE * (length * length);
  }
  good &= last < SMALL * scale;
  factorize_at(s, p, K);
  spread_all(s, x + free, 0, p0);
  memset(y, 0, s->unknowns * sizeof *y);
  for (int i = 0; i < s->block_bars; ++i) {
    y[s->right_place[i]] = -dot_of_bars(s, i, p, p0);
    if (input->length)
      y[s->right_place[i]] += input->length[s->block_bar[i]] * input->length_rate[s->block_bar[i]];
  }
  change_of(s, K, y, change);
  for (int i = 0; i < rows; ++i) x[free + lengths->block_free[i]] += change[i];
  for (int i = 0; i < rows; ++i) {
    Number *to = x + lengths->block_free[i];
    *to = choice(good, *to, all(NAN));
  }
  for (int i = 0; i < lengths->bodies; ++i) turn(lengths->body + i, before, x, free, s->dimension);
}

SHARED void restore_bars(Span *span, Number *x, Number time) {
  Input input;
  if (!span->lengths) return;
  memset(&input, 0, sizeof input);
  if (span->drive->is_driven) input = input_at(span, time);
  if (span->scene->dimension == 2) restore_alone(span, &input, 2, x);
  else restore_alone(span, &input, 3, x);
  if (span->scene->block_bars) restore_blocks(span, &input, x);
}
