/* Switches in steps that are not cut: what they change is added to the end of the step.

   A step is taken with the strings that pull as they are at its start. From the time at which one of
   them passes its border, its force is off by r: it pushes, or does not pull. To first order in r the
   end is then off by

     dv = integral of M^-1 r dt,   dq = integral of (h - t) M^-1 r dt,

   along the path of the step. Of each string r is a polynomial in time where it is out: it is known
   at samples of the path, as is the gap, whose zeros say where it is out. So both integrals are sums
   of accelerations at the samples, with a weight for each string. Where a force is continuous at its
   border, r grows from zero and the next order, what r does by moving the nodes, is O(h^4) of the
   velocities. What is said of strings holds for contacts. */
#include <string.h>

#include "motion.h"

/* Samples of the path: its ends, and the middle. */
enum { PATH = 3 };

/* Coefficients of the polynomials of degree 2 that are 1 at one sample and 0 at the others. */
static const double LAGRANGE[PATH][PATH] = {{1, -3, 2}, {0, 4, -4}, {0, -1, 2}};

SHARED size_t carry_size(const Scene *s) {
  return 3 * PATH * (size_t)s->switches + 6 * (size_t)s->free;
}

/* Adds what the Lagrange polynomials, and they times 1 - t, have as integrals from 0 to t. */
static void add_integrals(Number sign, Number t, Number *plain, Number *falling) {
  for (int j = 0; j < PATH; ++j) {
    Number power = sign * t;
    for (int k = 0; k < PATH; ++k, power *= t) {
      const Number term = LAGRANGE[j][k] * power;
      plain[j] += term * (1. / (k + 1));
      falling[j] += term * (1. / (k + 1) - t * (1. / (k + 2)));
    }
  }
}

/* What a string counts at the samples, by its room there, and how often it switches: 0 where its gap
   does not pass its border, as a parabola leaves the polygon of its values by less than their second
   difference. */
static Number weigh(const Number *room, Truth meant, Number *plain, Number *falling) {
  const Number bend = positive(room[0] - 2 * room[1] + room[2]);
  const Truth passes = meant & (smaller(smaller(room[0], room[1]), room[2]) < bend);
  const Truth is_out = room[0] < 0, ends_out = passes & (room[PATH - 1] < 0);
  const Number sign = choice(is_out, all(1), all(-1));
  Number c[PATH] = {all(0), all(0), all(0)}, half, square, large, one, other, time[PATH], count;
  Truth has_one, has_other, is_odd, is_late;
  if (!any(passes)) return all(0);
  for (int j = 0; j < PATH; ++j)
    for (int k = 0; k < PATH; ++k) c[k] += room[j] * LAGRANGE[j][k];
  /* The zeros within the step, in order. */
  half = -c[1] / 2;
  square = half * half - c[2] * c[0];
  large = root(larger(square, all(0)));
  large = half + choice(half < 0, -large, large);
  one = c[0] / large;
  other = large / c[2];
  time[0] = smaller(one, other);
  time[1] = larger(one, other);
  has_one = passes & (square > 0) & (time[0] > 0) & (time[0] < 1);
  has_other = passes & (square > 0) & (time[1] > 0) & (time[1] < 1);
  count = truth(has_one) + truth(has_other);
  time[0] = choice(has_one, time[0], only(has_other, time[1]));
  time[1] = only(has_one & has_other, time[1]);
  time[2] = all(0);
  /* At the end the string is as its gap says, whatever round-off makes of a zero there. */
  is_odd = passes & ((count == 1) ^ is_out ^ ends_out);
  is_late = is_odd & (count > 0) & (choice(count > 1, time[1], time[0]) > 0.5);
  for (int i = 0; i < PATH; ++i) {
    const Truth is_next = is_odd & (count == i), is_last = is_late & (count == i + 1);
    time[i] = choice(is_next & (is_late == 0), all(1), only(is_last == 0, time[i]));
  }
  count += only(is_odd, choice(is_late, all(-1), all(1)));
  for (int j = 0; j < PATH; ++j) plain[j] = falling[j] = all(0);
  for (int i = 0; i < PATH; ++i)
    add_integrals(i % 2 ? -sign : sign, time[i], plain, falling);
  add_integrals(truth(ends_out), all(1), plain, falling);
  return count;
}

/* Weighs some strings, each of the run in one lane, side by side: few strings switch in many runs. */
static void weigh_some(const Tried *step, int m, const Number *rooms, int some, const int *of,
                       const int *in, Number *weights, Number *switches) {
  Number room[PATH], plain[PATH], falling[PATH], meant = all(0), count;
  for (int j = 0; j < PATH; ++j) room[j] = all(0);
  for (int i = 0; i < some; ++i) {
    put(1, &meant, i);
    for (int j = 0; j < PATH; ++j) put(lane(rooms + PATH * of[i] + j, in[i]), room + j, i);
  }
  count = weigh(room, meant != 0, plain, falling);
  for (int i = 0; i < some; ++i) {
    const double times = lane(&count, i), sign = 1 - 2 * lane(step->taut + of[i], in[i]);
    if (times == 0) continue;
    put(lane(switches, in[i]) + times, switches, in[i]);
    for (int j = 0; j < PATH; ++j) {
      put(sign * lane(plain + j, i), weights + 2 * j * m + of[i], in[i]);
      put(sign * lane(falling + j, i), weights + (2 * j + 1) * m + of[i], in[i]);
    }
  }
}

/* Adds to x, the end of a step, what its switches change, and sets the strings that pull then, in the
   runs that are meant. Returns how many switches there were. `defect` becomes what the next order
   adds to xdot at the end, if it is wanted. */
SHARED Number carry(Span *span, Truth meant, const Tried *step, Number *x, Number *taut,
                    Number *defect) {
  const int m = span->switches, half = span->states / 2;
  const Number h = step->h;
  Number *rooms = span->carried, *weights = rooms + PATH * m;
  Number *y = weights + 2 * PATH * m, *dx = y + 2 * half, *a = dx + 2 * half;
  Number switches = all(0);
  const Some *some = list(span, span->marked);
  const Number *scale;
  int of[WIDTH], in[WIDTH], waiting = 0;
  make_path(span, step);
  on_path(span, h, all(0.5), y);
  gap_at(span, y, step->time + 0.5 * h, some, span->gap, 0);
  scale = gap_scales(span, step->time);
  for (int k = 0; k < some->count; ++k) {
    const int i = some->which[k];
    const Number sign = 2 * step->taut[i] - 1, band = BAND * scale[i];
    rooms[PATH * i] = sign * span->gap0[i] + band;
    rooms[PATH * i + 1] = sign * span->gap[i] + band;
    rooms[PATH * i + 2] = sign * span->gap1[i] + band;
  }
  memset(weights, 0, 2 * PATH * m * sizeof *weights);
  for (int k = 0; k < some->count; ++k)
    for (int i = some->which[k], j = 0; j < WIDTH; ++j) {
      if (!is_in(meant, j) || lane(span->marked + i, j) == 0) continue;
      of[waiting] = i;
      in[waiting++] = j;
      if (waiting < WIDTH) continue;
      weigh_some(step, m, rooms, waiting, of, in, weights, &switches);
      waiting = 0;
    }
  if (waiting) weigh_some(step, m, rooms, waiting, of, in, weights, &switches);
  memset(dx, 0, 2 * half * sizeof *dx);
  for (int j = 0; j < PATH; ++j) {
    const Input input = input_at(span, step->time + j / (PATH - 1.) * h);
    const Number *at = j == 0 ? step->x : j == 1 ? y : step->x1, *plain = weights + 2 * j * m;
    weighed_accelerations(span->scene, at, &input, plain, plain + m, a, a + half, span->work);
    for (int i = 0; i < half; ++i) {
      dx[half + i] += h * a[i];
      dx[i] += h * h * a[half + i];
    }
  }
  for (int i = 0; i < 2 * half; ++i) dx[i] += x[i];
  restore_bars(span, dx, step->time + h);
  for (int i = 0; i < 2 * half; ++i) x[i] = choice(meant, dx[i], x[i]);
  if (defect) {
    slope_at(span, x, step->time + h, step->taut, defect);
    for (int i = 0; i < 2 * half; ++i) defect[i] -= step->slope1[i];
  }
  gap_at(span, x, step->time + h, 0, span->gap, 0);
  for (int i = 0; i < m; ++i) taut[i] = choice(meant, truth(span->gap[i] > 0), taut[i]);
  return switches;
}
