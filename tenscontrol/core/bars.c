/* Bars that may meet within a motion: most pairs stay so far apart that a few states tell. */
#include <math.h>
#include <string.h>

#include "core.h"
#include "largest.h"

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static double within(double share) { return share < 0 ? 0 : share > 1 ? 1 : share; }

/* The square of the distance of two points w apart, so far along u and v. */
static double square(const double *w, const double *u, const double *v, double s, double t) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) {
    const double x = w[k] + s * u[k] - t * v[k];
    sum += x * x;
  }
  return sum;
}

/* The distance of the bars a to b and c to d, m. */
static double distance(const double *a, const double *b, const double *c, const double *d) {
  double u[3], v[3], w[3], least = INFINITY;
  for (int k = 0; k < 3; ++k) {
    u[k] = b[k] - a[k];
    v[k] = d[k] - c[k];
    w[k] = a[k] - c[k];
  }
  const double uu = dot(u, u), vv = dot(v, v), uv = dot(u, v), uw = dot(u, w), vw = dot(v, w);
  const double across = uu * vv - uv * uv;
  if (across > 1e-12 * uu * vv) {
    const double s = (uv * vw - vv * uw) / across, t = (uu * vw - uv * uw) / across;
    /* Two lines are nearest within both bars, or else at an end of one of them. */
    if (s > 0 && s < 1 && t > 0 && t < 1) return sqrt(square(w, u, v, s, t));
  }
  for (int end = 0; end < 2; ++end) {
    least = fmin(least, square(w, u, v, end, within((vw + end * uv) / vv)));
    least = fmin(least, square(w, u, v, within((end * uv - uw) / uu), end));
  }
  return sqrt(least);
}

static void put(const Motion *motion, int node, int time, double *to) {
  const double *from = motion->values + node * motion->node + time * motion->time;
  for (int k = 0; k < 3; ++k) to[k] = from[k * motion->axis];
}

/* Times that are looked at together. */
enum { TIMES = 1024 };

/* One coordinate of a node at some times, as it lies in memory or copied. */
static const double *some(const Motion *motion, int node, int axis, int first, int times, double *copy) {
  const double *from = along(motion, node, axis) + first * motion->time;
  if (motion->time == 1) return from;
  for (int t = 0; t < times; ++t) copy[t] = from[t * motion->time];
  return copy;
}

WIDE static void add(const double *restrict numbers, int count, double *restrict sum) {
  for (int t = 0; t < count; ++t) sum[t] += numbers[t];
}

WIDE static void divide(int count, double by, double *restrict numbers) {
  for (int t = 0; t < count; ++t) numbers[t] /= by;
}

WIDE static void distances(const double *restrict numbers, const double *restrict others, int count,
                           double *restrict apart) {
  for (int t = 0; t < count; ++t) apart[t] = fabs(numbers[t] - others[t]);
}

/* Raises `largest` (count, 3) to the rates of nodes at some times beside the mean of them all. */
static void raise_to(const Motion *rates, int first, int times, int count, const int32_t *nodes,
                     double *largest) {
  double copy[TIMES], mean[TIMES], beside[TIMES];
  for (int k = 0; k < 3; ++k) {
    memset(mean, 0, times * sizeof *mean);
    for (int i = 0; i < count; ++i) add(some(rates, nodes[i], k, first, times, copy), times, mean);
    divide(times, count, mean);
    for (int i = 0; i < count; ++i) {
      distances(some(rates, nodes[i], k, first, times, copy), mean, times, beside);
      raise_to_largest(times, beside, largest + 3 * i + k);
    }
  }
}

void tc_largest_speeds(const Rates *rates, int32_t intervals, double *speed, double *work) {
  const int count = rates->count;
  double *largest = work;
  memset(largest, 0, 3 * (size_t)count * sizeof *largest);
  for (int t = 0; t < intervals; t += TIMES)
    raise_to(&rates->begin, t, intervals - t < TIMES ? intervals - t : TIMES, count, rates->nodes, largest);
  raise_to(&rates->end, intervals - 1, 1, count, rates->nodes, largest);
  for (int i = 0; i < count; ++i) speed[rates->nodes[i]] = sqrt(dot(largest + 3 * i, largest + 3 * i));
}

/* The first interval after k that ends at a time or later. */
static int first_to_reach(const double *begin, const double *length, int k, int count, double time) {
  int low = k + 1, high = count;
  while (low < high) {
    const int middle = low + (high - low) / 2;
    if (begin[middle] + length[middle] < time) low = middle + 1;
    else high = middle;
  }
  return low;
}

int64_t tc_near_bars(const Motion *nodes, const Rates *rates, int32_t intervals, const double *begin,
                     const double *length, int32_t count, const int32_t *pairs, double faster, int64_t room,
                     int32_t *found, double *speed, double *work) {
  int64_t near = 0;
  tc_largest_speeds(rates, intervals, speed, work);
  for (int p = 0; p < count; ++p) {
    const int32_t *ends = pairs + 4 * p;
    const double closing =
        faster * (fmax(speed[ends[0]], speed[ends[1]]) + fmax(speed[ends[2]], speed[ends[3]]));
    for (int k = 0; k < intervals;) {
      double x[12];
      for (int i = 0; i < 4; ++i) put(nodes, ends[i], k, x + 3 * i);
      const double apart = distance(x, x + 3, x + 6, x + 9);
      if (apart > closing * length[k]) {
        /* They cannot meet before they have come this far. */
        k = first_to_reach(begin, length, k, intervals, begin[k] + apart / closing);
        continue;
      }
      if (near < room) {
        found[2 * near] = p;
        found[2 * near + 1] = k;
      }
      ++near;
      ++k;
    }
  }
  return near;
}
