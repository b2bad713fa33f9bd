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
  return 3 * PATH * (size_t)s->switches + 5 * (size_t)s->free;
}

/* Whether a gap with this room at the samples may pass its border: a parabola leaves
   the polygon of its values by less than their second difference. */
static int may_pass(const double *room) {
  double least = room[0];
  for (int j = 1; j < PATH; ++j) least = room[j] < least ? room[j] : least;
  return least < fabs(room[0] - 2 * room[1] + room[2]);
}

/* Adds the integrals of the Lagrange polynomials, and of them times 1 - t, from 0 to t. */
static void add_integrals(double sign, double t, double *plain, double *falling) {
  for (int j = 0; j < PATH; ++j) {
    double power = t;
    for (int k = 0; k < PATH; ++k, power *= t) {
      const double term = sign * LAGRANGE[j][k] * power;
      plain[j] += term / (k + 1);
      falling[j] += term * (1. / (k + 1) - t / (k + 2));
    }
  }
}

/* The times within a step at which a room passes zero, in order; returns how many there are. */
static int zeros_of(const double *room, double *times) {
  double c[PATH] = {0}, root[2], half, square, large;
  int count = 0;
  for (int j = 0; j < PATH; ++j)
    for (int k = 0; k < PATH; ++k) c[k] += room[j] * LAGRANGE[j][k];
  half = -c[1] / 2;
  square = half * half - c[2] * c[0];
  if (!(square > 0)) return 0;
  large = half + (half < 0 ? -sqrt(square) : sqrt(square));
  root[0] = c[0] / large;
  root[1] = large / c[2];
  if (root[1] < root[0]) {
    const double first = root[1];
    root[1] = root[0];
    root[0] = first;
  }
  for (int i = 0; i < 2; ++i)
    if (root[i] > 0 && root[i] < 1) times[count++] = root[i];
  return count;
}

/* What a string counts at the samples, by its room there; returns how often it switches. */
static int weights_of(const double *room, double *plain, double *falling) {
  double times[3];
  int is_out = room[0] < 0, count = zeros_of(room, times);
  /* At the end the string is as its gap says, whatever round-off makes of a zero there. */
  if ((is_out + count) % 2 != (room[PATH - 1] < 0)) {
    if (count && times[count - 1] > 0.5) --count;
    else times[count++] = 1;
  }
  for (int i = 0; i < count; ++i, is_out = !is_out)
    add_integrals(is_out ? 1 : -1, times[i], plain, falling);
  if (is_out) add_integrals(1, 1, plain, falling);
  return count;
}

/* Weights of a string at the samples, in one lane; how often it switches. */
static int weigh(const Number *rooms, int m, int i, double taut, int k, Number *weights) {
  double room[PATH], plain[PATH] = {0}, falling[PATH] = {0};
  int count;
  for (int j = 0; j < PATH; ++j) room[j] = lane(rooms + PATH * i + j, k);
  if (!may_pass(room)) return 0;
  count = weights_of(room, plain, falling);
  for (int j = 0; j < PATH && count; ++j) {
    put((1 - 2 * taut) * plain[j], weights + 2 * j * m + i, k);
    put((1 - 2 * taut) * falling[j], weights + (2 * j + 1) * m + i, k);
  }
  return count;
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
  const Number *scale;
  make_path(span, step);
  on_path(span, h, all(0.5), y);
  gap_at(span, y, step->time + 0.5 * h, span->marked, span->gap, 0);
  scale = gap_scales(span, step->time);
  for (int i = 0; i < m; ++i) {
    const Number sign = 2 * step->taut[i] - 1, band = BAND * scale[i];
    if (!any(span->marked[i] != 0)) continue;
    rooms[PATH * i] = sign * span->gap0[i] + band;
    rooms[PATH * i + 1] = sign * span->gap[i] + band;
    rooms[PATH * i + 2] = sign * span->gap1[i] + band;
  }
  memset(weights, 0, 2 * PATH * m * sizeof *weights);
  for (int k = 0; k < WIDTH; ++k) {
    int count = 0;
    for (int i = 0; i < m && is_in(meant, k); ++i)
      if (lane(span->marked + i, k) != 0)
      count += weigh(rooms, m, i, lane(step->taut + i, k), k, weights);
    put(count, &switches, k);
  }
  memset(dx, 0, 2 * half * sizeof *dx);
  for (int j = 0; j < PATH; ++j) {
    const Input input = input_at(span, step->time + j / (PATH - 1.) * h);
    const Number *at = j == 0 ? step->x : j == 1 ? y : step->x1;
    for (int k = 0; k < 2; ++k) {
      Number *to = dx + (k ? 0 : half);
      weighed_accelerations(span->scene, at, &input, weights + (2 * j + k) * m, a, span->work);
      for (int i = 0; i < half; ++i) to[i] += (k ? h * h : h) * a[i];
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
