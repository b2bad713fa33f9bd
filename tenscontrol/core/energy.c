/* Energies of a motion, and distances of its nodes, at many times. */
#include <math.h>
#include <string.h>

#include "core.h"
#include "kernels.h"
#include "largest.h"

WIDE static void add_bar(const double *restrict start, const double *restrict end, double mass, int times,
                         double *restrict energy) {
  for (int t = 0; t < times; ++t) {
    double of_bar;
    bar_energy(start[t], end[t], mass, &of_bar);
    energy[t] += of_bar;
  }
}

WIDE static void add_point(const double *restrict rate, double mass, int times, double *restrict energy) {
  for (int t = 0; t < times; ++t) energy[t] += 0.5 * mass * rate[t] * rate[t];
}

void tc_kinetic_energy(const Scene *s, int32_t times, const Motion *rates, double *energy) {
  const int d = s->dimension;
  memset(energy, 0, times * sizeof *energy);
  for (int k = 0; k < d; ++k) {
    for (int i = 0; i < s->bars; ++i)
      add_bar(along(rates, s->any_start[i] / d, k), along(rates, s->any_end[i] / d, k), s->bar_mass[i], times,
              energy);
    for (int i = 0; i < s->entries / d; ++i)
      if (s->point_mass[i] != 0) add_point(along(rates, i, k), s->point_mass[i], times, energy);
  }
}

WIDE static void squares_2(const double *restrict x0, const double *restrict x1, const double *restrict y0,
                           const double *restrict y1, int times, double *restrict square) {
  for (int t = 0; t < times; ++t)
    square[t] = (x1[t] - x0[t]) * (x1[t] - x0[t]) + (y1[t] - y0[t]) * (y1[t] - y0[t]);
}

WIDE static void add_square(const double *restrict z0, const double *restrict z1, int times,
                            double *restrict square) {
  for (int t = 0; t < times; ++t) square[t] += (z1[t] - z0[t]) * (z1[t] - z0[t]);
}

/* Squares of the distance of two nodes. */
static void squares(const Motion *nodes, int d, int start, int end, int times, double *square) {
  squares_2(along(nodes, start, 0), along(nodes, end, 0), along(nodes, start, 1), along(nodes, end, 1), times,
            square);
  if (d == 3) add_square(along(nodes, start, 2), along(nodes, end, 2), times, square);
}

WIDE static void take_root(int times, double *restrict square) {
  for (int t = 0; t < times; ++t) square[t] = sqrt(square[t]);
}

WIDE static void add_root(const double *restrict square, int times, double *restrict length) {
  for (int t = 0; t < times; ++t) length[t] += sqrt(square[t]);
}

void tc_distances(const Motion *nodes, int32_t dimension, int32_t times, int32_t count, const int32_t *pairs,
                  double *distance) {
  for (int i = 0; i < count; ++i) {
    double *to = distance + (size_t)i * times;
    squares(nodes, dimension, pairs[2 * i], pairs[2 * i + 1], times, to);
    take_root(times, to);
  }
}

/* What a string stores; its input is the same at all times where `step` is 0, else it is 1. */
WIDE static void add_string(const Scene *s, int string, const double *restrict length,
                            const double *restrict u, int step, int times, double *restrict energy) {
  const double k = s->law == FORCE_DENSITY_HELD ? 0 : s->stiffness[string];
  double stored;
  if (s->law == FORCE_DENSITY_HELD)
    for (int t = 0; t < times; ++t) energy[t] += 0.5 * u[t * step] * length[t] * length[t];
  else if (s->law == LINEAR_STRINGS)
    for (int t = 0; t < times; ++t) {
      linear_energy(length[t], u[t * step], k, &stored);
      energy[t] += stored;
    }
  else
    for (int t = 0; t < times; ++t) {
      elastic_energy(length[t], u[t * step], k, &stored);
      energy[t] += stored;
    }
}

WIDE static void add_load(const double *restrict place, double load, int times, double *restrict energy) {
  for (int t = 0; t < times; ++t) energy[t] -= load * place[t];
}

void tc_potential_energy(const Scene *s, int32_t times, const Motion *nodes, const double *inputs,
                         int32_t is_constant, const double *load, double *energy, double *work) {
  const int d = s->dimension;
  const size_t row = is_constant ? 1 : (size_t)times;
  double *square = work, *length = work + times;
  memset(energy, 0, times * sizeof *energy);
  /* Segments of a string follow one another. */
  for (int i = 0; i < s->segments; ++i) {
    const int string = s->segment_string[i];
    if (i == 0 || s->segment_string[i - 1] != string) memset(length, 0, times * sizeof *length);
    squares(nodes, d, s->segment_start[i] / d, s->segment_end[i] / d, times, square);
    add_root(square, times, length);
    if (i + 1 == s->segments || s->segment_string[i + 1] != string)
      add_string(s, string, length, inputs + string * row, !is_constant, times, energy);
  }
  for (int i = 0; load && i < s->entries; ++i)
    if (load[i] != 0) add_load(along(nodes, i / d, i % d), load[i], times, energy);
}

WIDE static void add_energy(const double *restrict kinetic, int times, double *restrict energy,
                            double *restrict size) {
  for (int t = 0; t < times; ++t) energy[t] += kinetic[t];
  for (int t = 0; t < times; ++t) size[t] = fabs(energy[t]);
}

WIDE static void take_changes(int times, double *restrict energy) {
  const double first = energy[0];
  for (int t = 0; t < times; ++t) energy[t] = fabs(energy[t] - first);
}

WIDE static void take_stretches(double length, int times, double *restrict square) {
  for (int t = 0; t < times; ++t) square[t] = fabs(sqrt(square[t]) - length) / length;
}

void tc_conservation(const Scene *s, int32_t times, const Motion *nodes, const Motion *rates,
                     const double *inputs, int32_t is_constant, const double *load, const double *length,
                     Conservation *found, double *work) {
  const int d = s->dimension;
  double *kinetic = work, *energy = work + times, *square = energy + times;
  memset(found, 0, sizeof *found);
  tc_kinetic_energy(s, times, rates, kinetic);
  tc_potential_energy(s, times, nodes, inputs, is_constant, load, energy, square);
  if (!times) return;
  add_energy(kinetic, times, energy, square);
  take_changes(times, energy);
  raise_to_largest(times, kinetic, &found->kinetic);
  raise_to_largest(times, square, &found->energy);
  raise_to_largest(times, energy, &found->change);
  for (int i = 0; i < s->bars; ++i) {
    squares(nodes, d, s->any_start[i] / d, s->any_end[i] / d, times, square);
    take_stretches(length[i], times, square);
    raise_to_largest(times, square, &found->stretch);
  }
}
