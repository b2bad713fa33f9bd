/* Kernels of one member: printed by tests/core_kernels.py, not by hand.

   Vectors have as many entries as the name says. Units are SI; signs are those of the module
   tenscontrol.dynamics.kernel: force densities of strings are positive in tension, those of bars
   in compression. */
#ifndef TENSCONTROL_KERNELS_H
#define TENSCONTROL_KERNELS_H

#include "numbers.h"

enum { FREE_BAR_2_CONSTANTS = 4 };
static inline void free_bar_2_constants(const Number mass, Number *constants) {
  constants[0] = 0.5 * (2.0 / mass);
  constants[1] = 3.0 / mass;
  constants[2] = mass / 12.0;
  constants[3] = 6.0 / mass;
}

static inline void free_bar_2(const Number *bar, const Number *rate, const Number extension,
      const Number *on_start, const Number *on_end, const Number *constants, Number *start,
      Number *end) {
  const Number t4 = (on_start[0] + on_end[0]) * constants[0];
  const Number t5 = on_end[0] - on_start[0];
  const Number t23 = on_end[1] - on_start[1];
  const Number t28 = constants[2] * (rate[0] * rate[0] + rate[1] * rate[1] - extension) + (bar[0] * t5 +
      bar[1] * t23) / 2.0;
  const Number t33 = constants[3] * (t28 / (bar[0] * bar[0] + bar[1] * bar[1]));
  const Number t35 = t5 * constants[1] - bar[0] * t33;
  start[0] = t4 - t35;
  const Number t39 = (on_start[1] + on_end[1]) * constants[0];
  const Number t42 = t23 * constants[1] - bar[1] * t33;
  start[1] = t39 - t42;
  end[0] = t4 + t35;
  end[1] = t39 + t42;
}

static inline void free_bar_force_density_2(const Number *bar, const Number *rate,
      const Number extension, const Number *on_start, const Number *on_end, const Number mass,
      Number *force_density) {
  const Number t23 = (bar[0] * (on_end[0] - on_start[0]) + bar[1] * (on_end[1] - on_start[1])) / 2.0;
  const Number t28 = (mass / 12.0 * (rate[0] * rate[0] + rate[1] * rate[1] - extension) +
      t23) / (bar[0] * bar[0] + bar[1] * bar[1]);
  *force_density = -t28;
}

enum { SWINGING_BAR_2_CONSTANTS = 2 };
static inline void swinging_bar_2_constants(const Number mass, Number *constants) {
  constants[0] = mass / 3.0;
  constants[1] = 3.0 / mass;
}

static inline void swinging_bar_2(const Number *bar, const Number *rate, const Number extension,
      const Number *on_tip, const Number *constants, Number *tip) {
  const Number t16 = constants[0] * (rate[0] * rate[0] + rate[1] * rate[1] - extension) +
      (bar[0] * on_tip[0] + bar[1] * on_tip[1]);
  const Number t20 = t16 / (bar[0] * bar[0] + bar[1] * bar[1]);
  tip[0] = (on_tip[0] - bar[0] * t20) * constants[1];
  tip[1] = (on_tip[1] - bar[1] * t20) * constants[1];
}

static inline void swinging_bar_force_density_2(const Number *bar, const Number *rate,
      const Number extension, const Number *on_tip, const Number mass, Number *force_density) {
  const Number t18 = mass / 3.0 * (rate[0] * rate[0] + rate[1] * rate[1] - extension) + (bar[0] * on_tip[0]
      + bar[1] * on_tip[1]);
  *force_density = -(t18 / (bar[0] * bar[0] + bar[1] * bar[1]));
}

static inline void coupled_bar_2(const Number *rate, const Number extension, Number *right) {
  *right = -(rate[0] * rate[0] + rate[1] * rate[1] - extension);
}

static inline void pulling_length_2(const Number *segment, const Number rest, Number *length) {
  const Number t7 = 1e-12 * rest;
  *length = root(larger(segment[0] * segment[0] + segment[1] * segment[1], t7 * t7));
}

static inline void length_rate_2(const Number *segment, const Number *change, const Number length,
      Number *rate) {
  *rate = (segment[0] * change[0] + segment[1] * change[1]) / length;
}

static inline void sinking_2(const Number *x, const Number *v, const Number height,
      const Number *normal, Number *depth, Number *rate) {
  *depth = height - (normal[0] * x[0] + normal[1] * x[1]);
  *rate = -(normal[0] * v[0] + normal[1] * v[1]);
}

static inline void ground_force_2(const Number press, const Number *v, const Number friction,
      const Number slip_speed, const Number *normal, Number *force) {
  const Number t8 = normal[0] * v[0] + normal[1] * v[1];
  const Number t10 = v[0] - normal[0] * t8;
  const Number t15 = v[1] - normal[1] * t8;
  const Number t22 = friction * press / root(t10 * t10 + t15 * t15 + slip_speed * slip_speed);
  force[0] = normal[0] * press - t10 * t22;
  force[1] = normal[1] * press - t15 * t22;
}

enum { FREE_BAR_3_CONSTANTS = 4 };
static inline void free_bar_3_constants(const Number mass, Number *constants) {
  constants[0] = 0.5 * (2.0 / mass);
  constants[1] = 3.0 / mass;
  constants[2] = mass / 12.0;
  constants[3] = 6.0 / mass;
}

static inline void free_bar_3(const Number *bar, const Number *rate, const Number extension,
      const Number *on_start, const Number *on_end, const Number *constants, Number *start,
      Number *end) {
  const Number t4 = (on_start[0] + on_end[0]) * constants[0];
  const Number t5 = on_end[0] - on_start[0];
  const Number t21 = constants[2] * (rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2] - extension);
  const Number t26 = on_end[1] - on_start[1];
  const Number t32 = on_end[2] - on_start[2];
  const Number t43 = (t21 + (bar[0] * t5 + bar[1] * t26 + bar[2] * t32) / 2.0) / (bar[0] * bar[0] +
      bar[1] * bar[1] + bar[2] * bar[2]);
  const Number t44 = constants[3] * t43;
  const Number t46 = t5 * constants[1] - bar[0] * t44;
  start[0] = t4 - t46;
  const Number t50 = (on_start[1] + on_end[1]) * constants[0];
  const Number t53 = t26 * constants[1] - bar[1] * t44;
  start[1] = t50 - t53;
  const Number t57 = (on_start[2] + on_end[2]) * constants[0];
  const Number t60 = t32 * constants[1] - bar[2] * t44;
  start[2] = t57 - t60;
  end[0] = t4 + t46;
  end[1] = t50 + t53;
  end[2] = t57 + t60;
}

static inline void free_bar_force_density_3(const Number *bar, const Number *rate,
      const Number extension, const Number *on_start, const Number *on_end, const Number mass,
      Number *force_density) {
  const Number t13 = mass / 12.0 * (rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2] - extension);
  const Number t30 = bar[0] * (on_end[0] - on_start[0]) + bar[1] * (on_end[1] - on_start[1]) +
      bar[2] * (on_end[2] - on_start[2]);
  const Number t39 = (t13 + t30 / 2.0) / (bar[0] * bar[0] + bar[1] * bar[1] + bar[2] * bar[2]);
  *force_density = -t39;
}

enum { SWINGING_BAR_3_CONSTANTS = 2 };
static inline void swinging_bar_3_constants(const Number mass, Number *constants) {
  constants[0] = mass / 3.0;
  constants[1] = 3.0 / mass;
}

static inline void swinging_bar_3(const Number *bar, const Number *rate, const Number extension,
      const Number *on_tip, const Number *constants, Number *tip) {
  const Number t13 = constants[0] * (rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2] - extension);
  const Number t29 = (t13 + (bar[0] * on_tip[0] + bar[1] * on_tip[1] +
      bar[2] * on_tip[2])) / (bar[0] * bar[0] + bar[1] * bar[1] + bar[2] * bar[2]);
  tip[0] = (on_tip[0] - bar[0] * t29) * constants[1];
  tip[1] = (on_tip[1] - bar[1] * t29) * constants[1];
  tip[2] = (on_tip[2] - bar[2] * t29) * constants[1];
}

static inline void swinging_bar_force_density_3(const Number *bar, const Number *rate,
      const Number extension, const Number *on_tip, const Number mass, Number *force_density) {
  const Number t13 = mass / 3.0 * (rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2] - extension);
  const Number t31 = (t13 + (bar[0] * on_tip[0] + bar[1] * on_tip[1] +
      bar[2] * on_tip[2])) / (bar[0] * bar[0] + bar[1] * bar[1] + bar[2] * bar[2]);
  *force_density = -t31;
}

static inline void coupled_bar_3(const Number *rate, const Number extension, Number *right) {
  *right = -(rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2] - extension);
}

static inline void pulling_length_3(const Number *segment, const Number rest, Number *length) {
  const Number t7 = segment[0] * segment[0] + segment[1] * segment[1] + segment[2] * segment[2];
  const Number t10 = 1e-12 * rest;
  *length = root(larger(t7, t10 * t10));
}

static inline void length_rate_3(const Number *segment, const Number *change, const Number length,
      Number *rate) {
  *rate = (segment[0] * change[0] + segment[1] * change[1] + segment[2] * change[2]) / length;
}

static inline void sinking_3(const Number *x, const Number *v, const Number height,
      const Number *normal, Number *depth, Number *rate) {
  *depth = height - (normal[0] * x[0] + normal[1] * x[1] + normal[2] * x[2]);
  *rate = -(normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2]);
}

static inline void ground_force_3(const Number press, const Number *v, const Number friction,
      const Number slip_speed, const Number *normal, Number *force) {
  const Number t12 = normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2];
  const Number t14 = v[0] - normal[0] * t12;
  const Number t19 = v[1] - normal[1] * t12;
  const Number t23 = v[2] - normal[2] * t12;
  const Number t30 = friction * press / root(t14 * t14 + t19 * t19 + t23 * t23 + slip_speed * slip_speed);
  force[0] = normal[0] * press - t14 * t30;
  force[1] = normal[1] * press - t19 * t30;
  force[2] = normal[2] * press - t23 * t30;
}

static inline void linear_press(const Number depth, const Number rate, const Number stiffness,
      const Number damping, const Number pressing, Number *press) {
  *press = pressing * (stiffness * depth * (1.0 + damping * rate));
}

static inline void ground_gap(const Number depth, const Number rate, const Number damping,
      Number *gap) {
  const Number t2 = truth(depth < 0.0);
  const Number t8 = smaller(1.0 + damping * rate, all(1.0));
  *gap = depth * (only(t2 != 0, larger(t8, all(0.1))) + only(truth(t2 == 0) != 0, t8));
}

static inline void hertz_press(const Number depth, const Number rate, const Number stiffness,
      const Number damping, const Number pressing, Number *press) {
  const Number t15 = stiffness * depth * power(depth * depth + 1e-30, 0.25) * (1.0 + damping * rate);
  *press = pressing * t15;
}

static inline void smooth_press(const Number depth, const Number rate, const Number stiffness,
      const Number damping, const Number width, Number *press) {
  const Number t7 = smaller(larger(depth + width, all(0.0)), 2 * width);
  const Number t20 = 1.0 + damping * rate;
  *press = stiffness * (t7 * t7 / (4.0 * width) + larger(depth - width, all(0.0))) * ((t20 + root(t20 * t20 +
      0.010000000000000002)) / 2.004987562112089);
}

static inline void bar_energy(const Number start, const Number end, const Number mass,
      Number *energy) {
  const Number t4 = start + end;
  const Number t11 = start * (0.16666666666666666 * (t4 + start)) + end * (0.16666666666666666 * (t4 +
      end));
  *energy = mass * (t11 / 2.0);
}

static inline void linear_energy(const Number length, const Number rest, const Number stiffness,
      Number *energy) {
  const Number t7 = larger(all(0.0), length - rest);
  *energy = 0.5 * stiffness * (t7 * t7);
}

static inline void linear_undamped_force_density(const Number length, const Number rest,
      const Number stiffness, Number *force_density) {
  *force_density = stiffness * (length - rest) / length;
}

static inline void linear_damped_force_density(const Number length, const Number rest,
      const Number rate, const Number stiffness, const Number damping, Number *force_density) {
  *force_density = (stiffness * (length - rest) + damping * rate) / length;
}

static inline void linear_damped_gap(const Number length, const Number rest, const Number rate,
      const Number stiffness, const Number damping, Number *gap) {
  const Number t2 = length - rest;
  *gap = smaller(t2, (stiffness * t2 + damping * rate) / stiffness);
}

static inline void elastic_energy(const Number length, const Number rest, const Number stiffness,
      Number *energy) {
  const Number t7 = larger(all(0.0), length - rest);
  *energy = 0.5 * stiffness * (t7 * t7) / rest;
}

static inline void elastic_undamped_force_density(const Number length, const Number rest,
      const Number stiffness, Number *force_density) {
  *force_density = stiffness * (length / rest - 1.0) / length;
}

static inline void elastic_damped_force_density(const Number length, const Number rest,
      const Number rate, const Number stiffness, const Number damping, Number *force_density) {
  *force_density = (stiffness * (length / rest - 1.0) + damping * rate) / length;
}

static inline void elastic_damped_gap(const Number length, const Number rest, const Number rate,
      const Number stiffness, const Number damping, Number *gap) {
  const Number t13 = (stiffness * (length / rest - 1.0) + damping * rate) / (stiffness / rest);
  *gap = smaller(length - rest, t13);
}

#endif
