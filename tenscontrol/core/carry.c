/* Switches in steps that are not cut: what they change is added to the end of the step.

   A step is taken with the strings that pull as they are at its start. From the time at which one of
   them passes its border, its force is off by r: it pushes, or does not pull. To first order in r the
   end is then off by

     dv = integral of M^-1 r dt,   dq = integral of (h - t) M^-1 r dt,

   along the path of the step. Of each string r is a polynomial in time where it is out: it is known
   at samples of the path, as is the gap, whose zeros say where it is out. So both integrals are sums
   of accelerations at the samples, with a weight for each string. What is said of strings holds for
   contacts.

   The next order is what dq does, by J, the derivative of the accelerations by positions. Where a force
   is continuous at its border, r grows from zero: after one switch at h - s, dq is as s^3, and with it
   J dq at the end of the step, which takes one evaluation. What it adds is

     s/4 J dq of velocities, s^2/20 J dq of positions.

   Parts of h and h^2 in place of s/4 and s^2/20 leave the least of it, wherever in the step the switch
   is. J is that of the strings that pull at the end of the step: a string that has switched counts
   after its switch alone. */
#include <string.h>

#include "motion.h"

/* Samples of the path: its ends, and the middle. */
enum { PATH = 3 };

/* Coefficients of the polynomials of degree 2 that are 1 at one sample and 0 at the others. */
static const double LAGRANGE[PATH][PATH] = {{1, -3, 2}, {0, 4, -4}, {0, -1, 2}};

/* They leave a twelfth of what a switch at the start of the step adds at most, and a seventh. */
static const double NEXT_OF_VELOCITIES = 0.23, NEXT_OF_POSITIONS = 0.043;

SHARED size_t carry_size(const Scene *s) {
  return (3 * PATH + 1) * (size_t)s->switches + 7 * (size_t)s->free;
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
  for (int i = 0; i < PATH; ++i) add_integrals(i % 2 ? -sign : sign, time[i], plain, falling);
  add_integrals(truth(ends_out), all(1), plain, falling);
  return count;
}

/* Weighs some strings, each of the run in one lane, side by side: few strings switch in many runs. */
static void weigh_some(const Tried *step, int m, const Number *rooms, int some, const int *of, const int *in,
                       Number *weights, Number *switches) {
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
    if (lane(room + PATH - 1, i) < 0) put(sign, weights + 2 * PATH * m + of[i], in[i]);
    for (int j = 0; j < PATH; ++j) {
      put(sign * lane(plain + j, i), weights + 2 * j * m + of[i], in[i]);
      put(sign * lane(falling + j, i), weights + (2 * j + 1) * m + of[i], in[i]);
    }
  }
}

/* Positions in the middle of a step, of degree 5: those of middle_of in events.c, of degree 3, would be
   off by more than what is carried. No force that is asked for here depends on velocities. */
WIDE static void middle_by(const Number *restrict x, const Number *restrict x1, const Number *restrict slope,
                           const Number *restrict slope1, Number h, Number *restrict y, int half) {
  for (int i = 0; i < half; ++i) {
    const Number v = x[half + i], v1 = x1[half + i], a = slope[half + i], a1 = slope1[half + i];
    y[i] = (x[i] + x1[i]) / 2 + h * (5. / 32 * (v - v1) + h / 64 * (a + a1));
    y[half + i] = v;
  }
}

/* Adds to x, the end of a step, what its switches change, and sets the strings that pull then, in the
   runs that are meant. Returns how many switches there were. The accelerations in `slope` become what
   they change by moving the nodes. */
SHARED Number carry(Span *span, Truth meant, const Tried *step, Number *x, Number *taut, Number *slope) {
  const Scene *s = span->scene;
  const int m = span->switches, half = span->states / 2, first = s->clustered ? 0 : s->slacking;
  const Number h = step->h, end = step->time + h;
  Number *rooms = span->carried, *weights = rooms + PATH * m, *flips = weights + 2 * PATH * m;
  Number *y = flips + m, *dx = y + 2 * half, *a = dx + 2 * half, *flipped = a + 2 * half;
  Number *pulls = span->chosen, *gap = span->gap1, switches = all(0);
  const Some *some = list(span, span->marked);
  const Number *scale;
  int of[WIDTH], in[WIDTH], waiting = 0;
  middle_by(step->x, step->x1, step->slope, step->slope1, h, y, half);
  gap_at(span, y, step->time + 0.5 * h, some, span->gap, 0);
  scale = gap_scales(span, step->time);
  for (int k = 0; k <= 2 * PATH; ++k) memset(weights + k * m + first, 0, (m - first) * sizeof *weights);
  for (int k = 0; k < some->count; ++k) {
    const int i = some->which[k];
    const Number sign = 2 * step->taut[i] - 1, band = BAND * scale[i];
    rooms[PATH * i] = sign * span->gap0[i] + band;
    rooms[PATH * i + 1] = sign * span->gap[i] + band;
    rooms[PATH * i + 2] = sign * span->gap1[i] + band;
    for (int j = 0; j <= 2 * PATH; ++j) weights[j * m + i] = all(0);
  }
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
    const Number *at = j == 0 ? step->x : j == 1 ? y : step->x1;
    weighed_accelerations(s, at, &input, some, j < PATH - 1 ? 2 : 3, weights + 2 * j * m, a, span->work);
    for (int i = 0; i < half; ++i) {
      dx[half + i] += h * a[i];
      dx[i] += h * h * a[half + i];
    }
  }
  for (int i = 0; i < 2 * half; ++i) dx[i] += x[i];
  memcpy(pulls, step->taut, m * sizeof *pulls);
  for (int k = 0; k < some->count; ++k) pulls[some->which[k]] += flips[some->which[k]];
  slope_at(span, dx, end, pulls, slope);
  for (int i = 0; i < half; ++i) {
    const Number change = slope[half + i] -= step->slope1[half + i] + flipped[i];
    dx[i] += NEXT_OF_POSITIONS * h * h * change;
    dx[half + i] += NEXT_OF_VELOCITIES * h * change;
  }
  restore_bars(span, dx, end);
  gap_at(span, dx, end, 0, gap, span->within);
  for (int i = 0; i < 2 * half; ++i) x[i] = choice(meant, dx[i], x[i]);
  for (int i = 0; i < m; ++i) taut[i] = choice(meant, truth(gap[i] > 0), taut[i]);
  return switches;
}
