/* Kernels of one member: printed by tests/core_kernels.py, not by hand.

   Vectors have as many entries as the name says. Units are SI; signs are those of the module
   tenscontrol.dynamics.kernel: force densities of strings are positive in tension, those of bars
   in compression. */
#ifndef TENSCONTROL_KERNELS_H
#define TENSCONTROL_KERNELS_H

#include "numbers.h"

enum { FREE_BAR_2_CONSTANTS = 4 };
static inline void free_bar_2_constants(const Number mass, Number *constants) {
  const Number t3 = 2.0 / mass;
  const Number t4 = 0.5 * t3;
  constants[0] = t4;
  const Number t7 = 3.0 / mass;
  constants[1] = t7;
  const Number t10 = mass / 12.0;
  constants[2] = t10;
  const Number t13 = 6.0 / mass;
  constants[3] = t13;
}

static inline void free_bar_2(const Number *bar, const Number *rate, const Number *on_start, const Number *on_end, const Number *constants, Number *start, Number *end) {
  const Number t2 = on_start[0] + on_end[0];
  const Number t4 = t2 * constants[0];
  const Number t5 = on_end[0] - on_start[0];
  const Number t7 = t5 * constants[1];
  const Number t12 = rate[0] * rate[0];
  const Number t14 = rate[1] * rate[1];
  const Number t15 = t12 + t14;
  const Number t16 = constants[2] * t15;
  const Number t17 = bar[0] * t5;
  const Number t21 = on_end[1] - on_start[1];
  const Number t22 = bar[1] * t21;
  const Number t23 = t17 + t22;
  const Number t25 = t23 / 2.0;
  const Number t26 = t16 + t25;
  const Number t27 = bar[0] * bar[0];
  const Number t28 = bar[1] * bar[1];
  const Number t29 = t27 + t28;
  const Number t30 = t26 / t29;
  const Number t31 = constants[3] * t30;
  const Number t32 = bar[0] * t31;
  const Number t33 = t7 - t32;
  const Number t34 = t4 - t33;
  start[0] = t34;
  const Number t36 = on_start[1] + on_end[1];
  const Number t37 = t36 * constants[0];
  const Number t38 = t21 * constants[1];
  const Number t39 = bar[1] * t31;
  const Number t40 = t38 - t39;
  const Number t41 = t37 - t40;
  start[1] = t41;
  const Number t43 = t4 + t33;
  end[0] = t43;
  const Number t45 = t37 + t40;
  end[1] = t45;
}

enum { SWINGING_BAR_2_CONSTANTS = 2 };
static inline void swinging_bar_2_constants(const Number mass, Number *constants) {
  const Number t2 = mass / 3.0;
  constants[0] = t2;
  const Number t4 = 3.0 / mass;
  constants[1] = t4;
}

static inline void swinging_bar_2(const Number *bar, const Number *rate, const Number *on_tip, const Number *constants, Number *tip) {
  const Number t4 = rate[0] * rate[0];
  const Number t6 = rate[1] * rate[1];
  const Number t7 = t4 + t6;
  const Number t8 = constants[0] * t7;
  const Number t9 = bar[0] * on_tip[0];
  const Number t12 = bar[1] * on_tip[1];
  const Number t13 = t9 + t12;
  const Number t14 = t8 + t13;
  const Number t15 = bar[0] * bar[0];
  const Number t16 = bar[1] * bar[1];
  const Number t17 = t15 + t16;
  const Number t18 = t14 / t17;
  const Number t19 = bar[0] * t18;
  const Number t20 = on_tip[0] - t19;
  const Number t22 = t20 * constants[1];
  tip[0] = t22;
  const Number t24 = bar[1] * t18;
  const Number t25 = on_tip[1] - t24;
  const Number t26 = t25 * constants[1];
  tip[1] = t26;
}

static inline void coupled_bar_2(const Number *rate, Number *right) {
  const Number t1 = rate[0] * rate[0];
  const Number t3 = rate[1] * rate[1];
  const Number t4 = t1 + t3;
  const Number t5 = -t4;
  *right = t5;
}

static inline void driven_free_bar_2(const Number *bar, const Number *rate, const Number extension, const Number *on_start, const Number *on_end, const Number *constants, Number *start, Number *end) {
  const Number t2 = on_start[0] + on_end[0];
  const Number t4 = t2 * constants[0];
  const Number t5 = on_end[0] - on_start[0];
  const Number t7 = t5 * constants[1];
  const Number t12 = rate[0] * rate[0];
  const Number t14 = rate[1] * rate[1];
  const Number t15 = t12 + t14;
  const Number t17 = t15 - extension;
  const Number t18 = constants[2] * t17;
  const Number t19 = bar[0] * t5;
  const Number t23 = on_end[1] - on_start[1];
  const Number t24 = bar[1] * t23;
  const Number t25 = t19 + t24;
  const Number t27 = t25 / 2.0;
  const Number t28 = t18 + t27;
  const Number t29 = bar[0] * bar[0];
  const Number t30 = bar[1] * bar[1];
  const Number t31 = t29 + t30;
  const Number t32 = t28 / t31;
  const Number t33 = constants[3] * t32;
  const Number t34 = bar[0] * t33;
  const Number t35 = t7 - t34;
  const Number t36 = t4 - t35;
  start[0] = t36;
  const Number t38 = on_start[1] + on_end[1];
  const Number t39 = t38 * constants[0];
  const Number t40 = t23 * constants[1];
  const Number t41 = bar[1] * t33;
  const Number t42 = t40 - t41;
  const Number t43 = t39 - t42;
  start[1] = t43;
  const Number t45 = t4 + t35;
  end[0] = t45;
  const Number t47 = t39 + t42;
  end[1] = t47;
}

static inline void driven_swinging_bar_2(const Number *bar, const Number *rate, const Number extension, const Number *on_tip, const Number *constants, Number *tip) {
  const Number t4 = rate[0] * rate[0];
  const Number t6 = rate[1] * rate[1];
  const Number t7 = t4 + t6;
  const Number t9 = t7 - extension;
  const Number t10 = constants[0] * t9;
  const Number t11 = bar[0] * on_tip[0];
  const Number t14 = bar[1] * on_tip[1];
  const Number t15 = t11 + t14;
  const Number t16 = t10 + t15;
  const Number t17 = bar[0] * bar[0];
  const Number t18 = bar[1] * bar[1];
  const Number t19 = t17 + t18;
  const Number t20 = t16 / t19;
  const Number t21 = bar[0] * t20;
  const Number t22 = on_tip[0] - t21;
  const Number t24 = t22 * constants[1];
  tip[0] = t24;
  const Number t26 = bar[1] * t20;
  const Number t27 = on_tip[1] - t26;
  const Number t28 = t27 * constants[1];
  tip[1] = t28;
}

static inline void driven_free_bar_force_density_2(const Number *bar, const Number *rate, const Number extension, const Number *on_start, const Number *on_end, const Number mass, Number *force_density) {
  const Number t2 = mass / 12.0;
  const Number t4 = rate[0] * rate[0];
  const Number t6 = rate[1] * rate[1];
  const Number t7 = t4 + t6;
  const Number t9 = t7 - extension;
  const Number t10 = t2 * t9;
  const Number t14 = on_end[0] - on_start[0];
  const Number t15 = bar[0] * t14;
  const Number t19 = on_end[1] - on_start[1];
  const Number t20 = bar[1] * t19;
  const Number t21 = t15 + t20;
  const Number t23 = t21 / 2.0;
  const Number t24 = t10 + t23;
  const Number t25 = bar[0] * bar[0];
  const Number t26 = bar[1] * bar[1];
  const Number t27 = t25 + t26;
  const Number t28 = t24 / t27;
  const Number t29 = -t28;
  *force_density = t29;
}

static inline void driven_swinging_bar_force_density_2(const Number *bar, const Number *rate, const Number extension, const Number *on_tip, const Number mass, Number *force_density) {
  const Number t2 = mass / 3.0;
  const Number t4 = rate[0] * rate[0];
  const Number t6 = rate[1] * rate[1];
  const Number t7 = t4 + t6;
  const Number t9 = t7 - extension;
  const Number t10 = t2 * t9;
  const Number t13 = bar[0] * on_tip[0];
  const Number t16 = bar[1] * on_tip[1];
  const Number t17 = t13 + t16;
  const Number t18 = t10 + t17;
  const Number t19 = bar[0] * bar[0];
  const Number t20 = bar[1] * bar[1];
  const Number t21 = t19 + t20;
  const Number t22 = t18 / t21;
  const Number t23 = -t22;
  *force_density = t23;
}

static inline void driven_coupled_bar_2(const Number *rate, const Number extension, Number *right) {
  const Number t1 = rate[0] * rate[0];
  const Number t3 = rate[1] * rate[1];
  const Number t4 = t1 + t3;
  const Number t6 = t4 - extension;
  const Number t7 = -t6;
  *right = t7;
}

static inline void pulling_length_2(const Number *segment, const Number rest, Number *length) {
  const Number t1 = segment[0] * segment[0];
  const Number t3 = segment[1] * segment[1];
  const Number t4 = t1 + t3;
  const Number t7 = 1e-12 * rest;
  const Number t8 = t7 * t7;
  const Number t9 = larger(t4, t8);
  const Number t10 = root(t9);
  *length = t10;
}

static inline void length_rate_2(const Number *segment, const Number *change, const Number length, Number *rate) {
  const Number t2 = segment[0] * change[0];
  const Number t5 = segment[1] * change[1];
  const Number t6 = t2 + t5;
  const Number t8 = t6 / length;
  *rate = t8;
}

static inline void ground_gap_2(const Number *x, const Number *v, const Number damping, const Number height, const Number *normal, Number *gap, Number *rate) {
  const Number t3 = normal[0] * x[0];
  const Number t6 = normal[1] * x[1];
  const Number t7 = t3 + t6;
  const Number t8 = height - t7;
  const Number t10 = truth(t8 < 0.0);
  const Number t14 = normal[0] * v[0];
  const Number t16 = normal[1] * v[1];
  const Number t17 = t14 + t16;
  const Number t18 = damping * t17;
  const Number t19 = 1.0 - t18;
  const Number t20 = smaller(t19, all(1.0));
  const Number t22 = larger(t20, all(0.1));
  const Number t23 = only(t10 != 0, t22);
  const Number t24 = truth(t10 == 0);
  const Number t25 = only(t24 != 0, t20);
  const Number t26 = t23 + t25;
  const Number t27 = t8 * t26;
  *gap = t27;
  const Number t29 = -t17;
  *rate = t29;
}

static inline void linear_ground_2(const Number *x, const Number *v, const Number pressing, const Number stiffness, const Number damping, const Number friction, const Number slip_speed, const Number height, const Number *normal, Number *force) {
  const Number t5 = normal[0] * x[0];
  const Number t8 = normal[1] * x[1];
  const Number t9 = t5 + t8;
  const Number t10 = height - t9;
  const Number t11 = stiffness * t10;
  const Number t15 = normal[0] * v[0];
  const Number t17 = normal[1] * v[1];
  const Number t18 = t15 + t17;
  const Number t19 = damping * t18;
  const Number t20 = 1.0 - t19;
  const Number t21 = t11 * t20;
  const Number t22 = pressing * t21;
  const Number t23 = normal[0] * t22;
  const Number t24 = normal[0] * v[0];
  const Number t25 = normal[1] * v[1];
  const Number t26 = t24 + t25;
  const Number t27 = normal[0] * t26;
  const Number t28 = v[0] - t27;
  const Number t30 = friction * t22;
  const Number t31 = t28 * t28;
  const Number t32 = normal[1] * t26;
  const Number t33 = v[1] - t32;
  const Number t34 = t33 * t33;
  const Number t35 = t31 + t34;
  const Number t37 = slip_speed * slip_speed;
  const Number t38 = t35 + t37;
  const Number t39 = root(t38);
  const Number t40 = t30 / t39;
  const Number t41 = t28 * t40;
  const Number t42 = t23 - t41;
  force[0] = t42;
  const Number t44 = normal[1] * t22;
  const Number t45 = t33 * t40;
  const Number t46 = t44 - t45;
  force[1] = t46;
}

static inline void hertz_ground_2(const Number *x, const Number *v, const Number pressing, const Number stiffness, const Number damping, const Number friction, const Number slip_speed, const Number height, const Number *normal, Number *force) {
  const Number t5 = normal[0] * x[0];
  const Number t8 = normal[1] * x[1];
  const Number t9 = t5 + t8;
  const Number t10 = height - t9;
  const Number t11 = stiffness * t10;
  const Number t12 = t10 * t10;
  const Number t14 = t12 + 1e-30;
  const Number t16 = power(t14, 0.25);
  const Number t17 = t11 * t16;
  const Number t21 = normal[0] * v[0];
  const Number t23 = normal[1] * v[1];
  const Number t24 = t21 + t23;
  const Number t25 = damping * t24;
  const Number t26 = 1.0 - t25;
  const Number t27 = t17 * t26;
  const Number t28 = pressing * t27;
  const Number t29 = normal[0] * t28;
  const Number t30 = normal[0] * v[0];
  const Number t31 = normal[1] * v[1];
  const Number t32 = t30 + t31;
  const Number t33 = normal[0] * t32;
  const Number t34 = v[0] - t33;
  const Number t36 = friction * t28;
  const Number t37 = t34 * t34;
  const Number t38 = normal[1] * t32;
  const Number t39 = v[1] - t38;
  const Number t40 = t39 * t39;
  const Number t41 = t37 + t40;
  const Number t43 = slip_speed * slip_speed;
  const Number t44 = t41 + t43;
  const Number t45 = root(t44);
  const Number t46 = t36 / t45;
  const Number t47 = t34 * t46;
  const Number t48 = t29 - t47;
  force[0] = t48;
  const Number t50 = normal[1] * t28;
  const Number t51 = t39 * t46;
  const Number t52 = t50 - t51;
  force[1] = t52;
}

static inline void smooth_ground_2(const Number *x, const Number *v, const Number stiffness, const Number damping, const Number friction, const Number slip_speed, const Number height, const Number width, const Number *normal, Number *force) {
  const Number t4 = normal[0] * x[0];
  const Number t7 = normal[1] * x[1];
  const Number t8 = t4 + t7;
  const Number t9 = height - t8;
  const Number t11 = t9 + width;
  const Number t13 = larger(t11, all(0.0));
  const Number t14 = 2 * width;
  const Number t15 = smaller(t13, t14);
  const Number t16 = t15 * t15;
  const Number t18 = 4.0 * width;
  const Number t19 = t16 / t18;
  const Number t20 = t9 - width;
  const Number t21 = larger(t20, all(0.0));
  const Number t22 = t19 + t21;
  const Number t23 = stiffness * t22;
  const Number t27 = normal[0] * v[0];
  const Number t29 = normal[1] * v[1];
  const Number t30 = t27 + t29;
  const Number t31 = damping * t30;
  const Number t32 = 1.0 - t31;
  const Number t33 = t32 * t32;
  const Number t35 = t33 + 0.010000000000000002;
  const Number t36 = root(t35);
  const Number t37 = t32 + t36;
  const Number t39 = t37 / 2.004987562112089;
  const Number t40 = t23 * t39;
  const Number t41 = normal[0] * t40;
  const Number t42 = normal[0] * v[0];
  const Number t43 = normal[1] * v[1];
  const Number t44 = t42 + t43;
  const Number t45 = normal[0] * t44;
  const Number t46 = v[0] - t45;
  const Number t48 = friction * t40;
  const Number t49 = t46 * t46;
  const Number t50 = normal[1] * t44;
  const Number t51 = v[1] - t50;
  const Number t52 = t51 * t51;
  const Number t53 = t49 + t52;
  const Number t55 = slip_speed * slip_speed;
  const Number t56 = t53 + t55;
  const Number t57 = root(t56);
  const Number t58 = t48 / t57;
  const Number t59 = t46 * t58;
  const Number t60 = t41 - t59;
  force[0] = t60;
  const Number t62 = normal[1] * t40;
  const Number t63 = t51 * t58;
  const Number t64 = t62 - t63;
  force[1] = t64;
}

enum { FREE_BAR_3_CONSTANTS = 4 };
static inline void free_bar_3_constants(const Number mass, Number *constants) {
  const Number t3 = 2.0 / mass;
  const Number t4 = 0.5 * t3;
  constants[0] = t4;
  const Number t7 = 3.0 / mass;
  constants[1] = t7;
  const Number t10 = mass / 12.0;
  constants[2] = t10;
  const Number t13 = 6.0 / mass;
  constants[3] = t13;
}

static inline void free_bar_3(const Number *bar, const Number *rate, const Number *on_start, const Number *on_end, const Number *constants, Number *start, Number *end) {
  const Number t2 = on_start[0] + on_end[0];
  const Number t4 = t2 * constants[0];
  const Number t5 = on_end[0] - on_start[0];
  const Number t7 = t5 * constants[1];
  const Number t12 = rate[0] * rate[0];
  const Number t14 = rate[1] * rate[1];
  const Number t15 = t12 + t14;
  const Number t17 = rate[2] * rate[2];
  const Number t18 = t15 + t17;
  const Number t19 = constants[2] * t18;
  const Number t20 = bar[0] * t5;
  const Number t24 = on_end[1] - on_start[1];
  const Number t25 = bar[1] * t24;
  const Number t26 = t20 + t25;
  const Number t30 = on_end[2] - on_start[2];
  const Number t31 = bar[2] * t30;
  const Number t32 = t26 + t31;
  const Number t34 = t32 / 2.0;
  const Number t35 = t19 + t34;
  const Number t36 = bar[0] * bar[0];
  const Number t37 = bar[1] * bar[1];
  const Number t38 = t36 + t37;
  const Number t39 = bar[2] * bar[2];
  const Number t40 = t38 + t39;
  const Number t41 = t35 / t40;
  const Number t42 = constants[3] * t41;
  const Number t43 = bar[0] * t42;
  const Number t44 = t7 - t43;
  const Number t45 = t4 - t44;
  start[0] = t45;
  const Number t47 = on_start[1] + on_end[1];
  const Number t48 = t47 * constants[0];
  const Number t49 = t24 * constants[1];
  const Number t50 = bar[1] * t42;
  const Number t51 = t49 - t50;
  const Number t52 = t48 - t51;
  start[1] = t52;
  const Number t54 = on_start[2] + on_end[2];
  const Number t55 = t54 * constants[0];
  const Number t56 = t30 * constants[1];
  const Number t57 = bar[2] * t42;
  const Number t58 = t56 - t57;
  const Number t59 = t55 - t58;
  start[2] = t59;
  const Number t61 = t4 + t44;
  end[0] = t61;
  const Number t63 = t48 + t51;
  end[1] = t63;
  const Number t65 = t55 + t58;
  end[2] = t65;
}

enum { SWINGING_BAR_3_CONSTANTS = 2 };
static inline void swinging_bar_3_constants(const Number mass, Number *constants) {
  const Number t2 = mass / 3.0;
  constants[0] = t2;
  const Number t4 = 3.0 / mass;
  constants[1] = t4;
}

static inline void swinging_bar_3(const Number *bar, const Number *rate, const Number *on_tip, const Number *constants, Number *tip) {
  const Number t4 = rate[0] * rate[0];
  const Number t6 = rate[1] * rate[1];
  const Number t7 = t4 + t6;
  const Number t9 = rate[2] * rate[2];
  const Number t10 = t7 + t9;
  const Number t11 = constants[0] * t10;
  const Number t12 = bar[0] * on_tip[0];
  const Number t15 = bar[1] * on_tip[1];
  const Number t16 = t12 + t15;
  const Number t19 = bar[2] * on_tip[2];
  const Number t20 = t16 + t19;
  const Number t21 = t11 + t20;
  const Number t22 = bar[0] * bar[0];
  const Number t23 = bar[1] * bar[1];
  const Number t24 = t22 + t23;
  const Number t25 = bar[2] * bar[2];
  const Number t26 = t24 + t25;
  const Number t27 = t21 / t26;
  const Number t28 = bar[0] * t27;
  const Number t29 = on_tip[0] - t28;
  const Number t31 = t29 * constants[1];
  tip[0] = t31;
  const Number t33 = bar[1] * t27;
  const Number t34 = on_tip[1] - t33;
  const Number t35 = t34 * constants[1];
  tip[1] = t35;
  const Number t37 = bar[2] * t27;
  const Number t38 = on_tip[2] - t37;
  const Number t39 = t38 * constants[1];
  tip[2] = t39;
}

static inline void coupled_bar_3(const Number *rate, Number *right) {
  const Number t1 = rate[0] * rate[0];
  const Number t3 = rate[1] * rate[1];
  const Number t4 = t1 + t3;
  const Number t6 = rate[2] * rate[2];
  const Number t7 = t4 + t6;
  const Number t8 = -t7;
  *right = t8;
}

static inline void driven_free_bar_3(const Number *bar, const Number *rate, const Number extension, const Number *on_start, const Number *on_end, const Number *constants, Number *start, Number *end) {
  const Number t2 = on_start[0] + on_end[0];
  const Number t4 = t2 * constants[0];
  const Number t5 = on_end[0] - on_start[0];
  const Number t7 = t5 * constants[1];
  const Number t12 = rate[0] * rate[0];
  const Number t14 = rate[1] * rate[1];
  const Number t15 = t12 + t14;
  const Number t17 = rate[2] * rate[2];
  const Number t18 = t15 + t17;
  const Number t20 = t18 - extension;
  const Number t21 = constants[2] * t20;
  const Number t22 = bar[0] * t5;
  const Number t26 = on_end[1] - on_start[1];
  const Number t27 = bar[1] * t26;
  const Number t28 = t22 + t27;
  const Number t32 = on_end[2] - on_start[2];
  const Number t33 = bar[2] * t32;
  const Number t34 = t28 + t33;
  const Number t36 = t34 / 2.0;
  const Number t37 = t21 + t36;
  const Number t38 = bar[0] * bar[0];
  const Number t39 = bar[1] * bar[1];
  const Number t40 = t38 + t39;
  const Number t41 = bar[2] * bar[2];
  const Number t42 = t40 + t41;
  const Number t43 = t37 / t42;
  const Number t44 = constants[3] * t43;
  const Number t45 = bar[0] * t44;
  const Number t46 = t7 - t45;
  const Number t47 = t4 - t46;
  start[0] = t47;
  const Number t49 = on_start[1] + on_end[1];
  const Number t50 = t49 * constants[0];
  const Number t51 = t26 * constants[1];
  const Number t52 = bar[1] * t44;
  const Number t53 = t51 - t52;
  const Number t54 = t50 - t53;
  start[1] = t54;
  const Number t56 = on_start[2] + on_end[2];
  const Number t57 = t56 * constants[0];
  const Number t58 = t32 * constants[1];
  const Number t59 = bar[2] * t44;
  const Number t60 = t58 - t59;
  const Number t61 = t57 - t60;
  start[2] = t61;
  const Number t63 = t4 + t46;
  end[0] = t63;
  const Number t65 = t50 + t53;
  end[1] = t65;
  const Number t67 = t57 + t60;
  end[2] = t67;
}

static inline void driven_swinging_bar_3(const Number *bar, const Number *rate, const Number extension, const Number *on_tip, const Number *constants, Number *tip) {
  const Number t4 = rate[0] * rate[0];
  const Number t6 = rate[1] * rate[1];
  const Number t7 = t4 + t6;
  const Number t9 = rate[2] * rate[2];
  const Number t10 = t7 + t9;
  const Number t12 = t10 - extension;
  const Number t13 = constants[0] * t12;
  const Number t14 = bar[0] * on_tip[0];
  const Number t17 = bar[1] * on_tip[1];
  const Number t18 = t14 + t17;
  const Number t21 = bar[2] * on_tip[2];
  const Number t22 = t18 + t21;
  const Number t23 = t13 + t22;
  const Number t24 = bar[0] * bar[0];
  const Number t25 = bar[1] * bar[1];
  const Number t26 = t24 + t25;
  const Number t27 = bar[2] * bar[2];
  const Number t28 = t26 + t27;
  const Number t29 = t23 / t28;
  const Number t30 = bar[0] * t29;
  const Number t31 = on_tip[0] - t30;
  const Number t33 = t31 * constants[1];
  tip[0] = t33;
  const Number t35 = bar[1] * t29;
  const Number t36 = on_tip[1] - t35;
  const Number t37 = t36 * constants[1];
  tip[1] = t37;
  const Number t39 = bar[2] * t29;
  const Number t40 = on_tip[2] - t39;
  const Number t41 = t40 * constants[1];
  tip[2] = t41;
}

static inline void driven_free_bar_force_density_3(const Number *bar, const Number *rate, const Number extension, const Number *on_start, const Number *on_end, const Number mass, Number *force_density) {
  const Number t2 = mass / 12.0;
  const Number t4 = rate[0] * rate[0];
  const Number t6 = rate[1] * rate[1];
  const Number t7 = t4 + t6;
  const Number t9 = rate[2] * rate[2];
  const Number t10 = t7 + t9;
  const Number t12 = t10 - extension;
  const Number t13 = t2 * t12;
  const Number t17 = on_end[0] - on_start[0];
  const Number t18 = bar[0] * t17;
  const Number t22 = on_end[1] - on_start[1];
  const Number t23 = bar[1] * t22;
  const Number t24 = t18 + t23;
  const Number t28 = on_end[2] - on_start[2];
  const Number t29 = bar[2] * t28;
  const Number t30 = t24 + t29;
  const Number t32 = t30 / 2.0;
  const Number t33 = t13 + t32;
  const Number t34 = bar[0] * bar[0];
  const Number t35 = bar[1] * bar[1];
  const Number t36 = t34 + t35;
  const Number t37 = bar[2] * bar[2];
  const Number t38 = t36 + t37;
  const Number t39 = t33 / t38;
  const Number t40 = -t39;
  *force_density = t40;
}

static inline void driven_swinging_bar_force_density_3(const Number *bar, const Number *rate, const Number extension, const Number *on_tip, const Number mass, Number *force_density) {
  const Number t2 = mass / 3.0;
  const Number t4 = rate[0] * rate[0];
  const Number t6 = rate[1] * rate[1];
  const Number t7 = t4 + t6;
  const Number t9 = rate[2] * rate[2];
  const Number t10 = t7 + t9;
  const Number t12 = t10 - extension;
  const Number t13 = t2 * t12;
  const Number t16 = bar[0] * on_tip[0];
  const Number t19 = bar[1] * on_tip[1];
  const Number t20 = t16 + t19;
  const Number t23 = bar[2] * on_tip[2];
  const Number t24 = t20 + t23;
  const Number t25 = t13 + t24;
  const Number t26 = bar[0] * bar[0];
  const Number t27 = bar[1] * bar[1];
  const Number t28 = t26 + t27;
  const Number t29 = bar[2] * bar[2];
  const Number t30 = t28 + t29;
  const Number t31 = t25 / t30;
  const Number t32 = -t31;
  *force_density = t32;
}

static inline void driven_coupled_bar_3(const Number *rate, const Number extension, Number *right) {
  const Number t1 = rate[0] * rate[0];
  const Number t3 = rate[1] * rate[1];
  const Number t4 = t1 + t3;
  const Number t6 = rate[2] * rate[2];
  const Number t7 = t4 + t6;
  const Number t9 = t7 - extension;
  const Number t10 = -t9;
  *right = t10;
}

static inline void pulling_length_3(const Number *segment, const Number rest, Number *length) {
  const Number t1 = segment[0] * segment[0];
  const Number t3 = segment[1] * segment[1];
  const Number t4 = t1 + t3;
  const Number t6 = segment[2] * segment[2];
  const Number t7 = t4 + t6;
  const Number t10 = 1e-12 * rest;
  const Number t11 = t10 * t10;
  const Number t12 = larger(t7, t11);
  const Number t13 = root(t12);
  *length = t13;
}

static inline void length_rate_3(const Number *segment, const Number *change, const Number length, Number *rate) {
  const Number t2 = segment[0] * change[0];
  const Number t5 = segment[1] * change[1];
  const Number t6 = t2 + t5;
  const Number t9 = segment[2] * change[2];
  const Number t10 = t6 + t9;
  const Number t12 = t10 / length;
  *rate = t12;
}

static inline void ground_gap_3(const Number *x, const Number *v, const Number damping, const Number height, const Number *normal, Number *gap, Number *rate) {
  const Number t3 = normal[0] * x[0];
  const Number t6 = normal[1] * x[1];
  const Number t7 = t3 + t6;
  const Number t10 = normal[2] * x[2];
  const Number t11 = t7 + t10;
  const Number t12 = height - t11;
  const Number t14 = truth(t12 < 0.0);
  const Number t18 = normal[0] * v[0];
  const Number t20 = normal[1] * v[1];
  const Number t21 = t18 + t20;
  const Number t23 = normal[2] * v[2];
  const Number t24 = t21 + t23;
  const Number t25 = damping * t24;
  const Number t26 = 1.0 - t25;
  const Number t27 = smaller(t26, all(1.0));
  const Number t29 = larger(t27, all(0.1));
  const Number t30 = only(t14 != 0, t29);
  const Number t31 = truth(t14 == 0);
  const Number t32 = only(t31 != 0, t27);
  const Number t33 = t30 + t32;
  const Number t34 = t12 * t33;
  *gap = t34;
  const Number t36 = -t24;
  *rate = t36;
}

static inline void linear_ground_3(const Number *x, const Number *v, const Number pressing, const Number stiffness, const Number damping, const Number friction, const Number slip_speed, const Number height, const Number *normal, Number *force) {
  const Number t5 = normal[0] * x[0];
  const Number t8 = normal[1] * x[1];
  const Number t9 = t5 + t8;
  const Number t12 = normal[2] * x[2];
  const Number t13 = t9 + t12;
  const Number t14 = height - t13;
  const Number t15 = stiffness * t14;
  const Number t19 = normal[0] * v[0];
  const Number t21 = normal[1] * v[1];
  const Number t22 = t19 + t21;
  const Number t24 = normal[2] * v[2];
  const Number t25 = t22 + t24;
  const Number t26 = damping * t25;
  const Number t27 = 1.0 - t26;
  const Number t28 = t15 * t27;
  const Number t29 = pressing * t28;
  const Number t30 = normal[0] * t29;
  const Number t31 = normal[0] * v[0];
  const Number t32 = normal[1] * v[1];
  const Number t33 = t31 + t32;
  const Number t34 = normal[2] * v[2];
  const Number t35 = t33 + t34;
  const Number t36 = normal[0] * t35;
  const Number t37 = v[0] - t36;
  const Number t39 = friction * t29;
  const Number t40 = t37 * t37;
  const Number t41 = normal[1] * t35;
  const Number t42 = v[1] - t41;
  const Number t43 = t42 * t42;
  const Number t44 = t40 + t43;
  const Number t45 = normal[2] * t35;
  const Number t46 = v[2] - t45;
  const Number t47 = t46 * t46;
  const Number t48 = t44 + t47;
  const Number t50 = slip_speed * slip_speed;
  const Number t51 = t48 + t50;
  const Number t52 = root(t51);
  const Number t53 = t39 / t52;
  const Number t54 = t37 * t53;
  const Number t55 = t30 - t54;
  force[0] = t55;
  const Number t57 = normal[1] * t29;
  const Number t58 = t42 * t53;
  const Number t59 = t57 - t58;
  force[1] = t59;
  const Number t61 = normal[2] * t29;
  const Number t62 = t46 * t53;
  const Number t63 = t61 - t62;
  force[2] = t63;
}

static inline void hertz_ground_3(const Number *x, const Number *v, const Number pressing, const Number stiffness, const Number damping, const Number friction, const Number slip_speed, const Number height, const Number *normal, Number *force) {
  const Number t5 = normal[0] * x[0];
  const Number t8 = normal[1] * x[1];
  const Number t9 = t5 + t8;
  const Number t12 = normal[2] * x[2];
  const Number t13 = t9 + t12;
  const Number t14 = height - t13;
  const Number t15 = stiffness * t14;
  const Number t16 = t14 * t14;
  const Number t18 = t16 + 1e-30;
  const Number t20 = power(t18, 0.25);
  const Number t21 = t15 * t20;
  const Number t25 = normal[0] * v[0];
  const Number t27 = normal[1] * v[1];
  const Number t28 = t25 + t27;
  const Number t30 = normal[2] * v[2];
  const Number t31 = t28 + t30;
  const Number t32 = damping * t31;
  const Number t33 = 1.0 - t32;
  const Number t34 = t21 * t33;
  const Number t35 = pressing * t34;
  const Number t36 = normal[0] * t35;
  const Number t37 = normal[0] * v[0];
  const Number t38 = normal[1] * v[1];
  const Number t39 = t37 + t38;
  const Number t40 = normal[2] * v[2];
  const Number t41 = t39 + t40;
  const Number t42 = normal[0] * t41;
  const Number t43 = v[0] - t42;
  const Number t45 = friction * t35;
  const Number t46 = t43 * t43;
  const Number t47 = normal[1] * t41;
  const Number t48 = v[1] - t47;
  const Number t49 = t48 * t48;
  const Number t50 = t46 + t49;
  const Number t51 = normal[2] * t41;
  const Number t52 = v[2] - t51;
  const Number t53 = t52 * t52;
  const Number t54 = t50 + t53;
  const Number t56 = slip_speed * slip_speed;
  const Number t57 = t54 + t56;
  const Number t58 = root(t57);
  const Number t59 = t45 / t58;
  const Number t60 = t43 * t59;
  const Number t61 = t36 - t60;
  force[0] = t61;
  const Number t63 = normal[1] * t35;
  const Number t64 = t48 * t59;
  const Number t65 = t63 - t64;
  force[1] = t65;
  const Number t67 = normal[2] * t35;
  const Number t68 = t52 * t59;
  const Number t69 = t67 - t68;
  force[2] = t69;
}

static inline void smooth_ground_3(const Number *x, const Number *v, const Number stiffness, const Number damping, const Number friction, const Number slip_speed, const Number height, const Number width, const Number *normal, Number *force) {
  const Number t4 = normal[0] * x[0];
  const Number t7 = normal[1] * x[1];
  const Number t8 = t4 + t7;
  const Number t11 = normal[2] * x[2];
  const Number t12 = t8 + t11;
  const Number t13 = height - t12;
  const Number t15 = t13 + width;
  const Number t17 = larger(t15, all(0.0));
  const Number t18 = 2 * width;
  const Number t19 = smaller(t17, t18);
  const Number t20 = t19 * t19;
  const Number t22 = 4.0 * width;
  const Number t23 = t20 / t22;
  const Number t24 = t13 - width;
  const Number t25 = larger(t24, all(0.0));
  const Number t26 = t23 + t25;
  const Number t27 = stiffness * t26;
  const Number t31 = normal[0] * v[0];
  const Number t33 = normal[1] * v[1];
  const Number t34 = t31 + t33;
  const Number t36 = normal[2] * v[2];
  const Number t37 = t34 + t36;
  const Number t38 = damping * t37;
  const Number t39 = 1.0 - t38;
  const Number t40 = t39 * t39;
  const Number t42 = t40 + 0.010000000000000002;
  const Number t43 = root(t42);
  const Number t44 = t39 + t43;
  const Number t46 = t44 / 2.004987562112089;
  const Number t47 = t27 * t46;
  const Number t48 = normal[0] * t47;
  const Number t49 = normal[0] * v[0];
  const Number t50 = normal[1] * v[1];
  const Number t51 = t49 + t50;
  const Number t52 = normal[2] * v[2];
  const Number t53 = t51 + t52;
  const Number t54 = normal[0] * t53;
  const Number t55 = v[0] - t54;
  const Number t57 = friction * t47;
  const Number t58 = t55 * t55;
  const Number t59 = normal[1] * t53;
  const Number t60 = v[1] - t59;
  const Number t61 = t60 * t60;
  const Number t62 = t58 + t61;
  const Number t63 = normal[2] * t53;
  const Number t64 = v[2] - t63;
  const Number t65 = t64 * t64;
  const Number t66 = t62 + t65;
  const Number t68 = slip_speed * slip_speed;
  const Number t69 = t66 + t68;
  const Number t70 = root(t69);
  const Number t71 = t57 / t70;
  const Number t72 = t55 * t71;
  const Number t73 = t48 - t72;
  force[0] = t73;
  const Number t75 = normal[1] * t47;
  const Number t76 = t60 * t71;
  const Number t77 = t75 - t76;
  force[1] = t77;
  const Number t79 = normal[2] * t47;
  const Number t80 = t64 * t71;
  const Number t81 = t79 - t80;
  force[2] = t81;
}

static inline void bar_energy(const Number start, const Number end, const Number mass, Number *energy) {
  const Number t4 = start + end;
  const Number t5 = t4 + start;
  const Number t6 = 0.16666666666666666 * t5;
  const Number t7 = start * t6;
  const Number t8 = t4 + end;
  const Number t9 = 0.16666666666666666 * t8;
  const Number t10 = end * t9;
  const Number t11 = t7 + t10;
  const Number t13 = t11 / 2.0;
  const Number t14 = mass * t13;
  *energy = t14;
}

static inline void linear_energy(const Number length, const Number rest, const Number stiffness, Number *energy) {
  const Number t2 = 0.5 * stiffness;
  const Number t6 = length - rest;
  const Number t7 = larger(all(0.0), t6);
  const Number t8 = t7 * t7;
  const Number t9 = t2 * t8;
  *energy = t9;
}

static inline void linear_undamped_force_density(const Number length, const Number rest, const Number stiffness, Number *force_density) {
  const Number t3 = length - rest;
  const Number t4 = stiffness * t3;
  const Number t5 = t4 / length;
  *force_density = t5;
}

static inline void linear_damped_force_density(const Number length, const Number rest, const Number rate, const Number stiffness, const Number damping, Number *force_density) {
  const Number t3 = length - rest;
  const Number t4 = stiffness * t3;
  const Number t7 = damping * rate;
  const Number t8 = t4 + t7;
  const Number t9 = t8 / length;
  *force_density = t9;
}

static inline void linear_damped_gap(const Number length, const Number rest, const Number rate, const Number stiffness, const Number damping, Number *gap) {
  const Number t2 = length - rest;
  const Number t4 = length - rest;
  const Number t5 = stiffness * t4;
  const Number t8 = damping * rate;
  const Number t9 = t5 + t8;
  const Number t10 = t9 / stiffness;
  const Number t11 = smaller(t2, t10);
  *gap = t11;
}

static inline void elastic_energy(const Number length, const Number rest, const Number stiffness, Number *energy) {
  const Number t2 = 0.5 * stiffness;
  const Number t6 = length - rest;
  const Number t7 = larger(all(0.0), t6);
  const Number t8 = t7 * t7;
  const Number t9 = t2 * t8;
  const Number t10 = t9 / rest;
  *energy = t10;
}

static inline void elastic_undamped_force_density(const Number length, const Number rest, const Number stiffness, Number *force_density) {
  const Number t3 = length / rest;
  const Number t5 = t3 - 1.0;
  const Number t6 = stiffness * t5;
  const Number t7 = t6 / length;
  *force_density = t7;
}

static inline void elastic_damped_force_density(const Number length, const Number rest, const Number rate, const Number stiffness, const Number damping, Number *force_density) {
  const Number t3 = length / rest;
  const Number t5 = t3 - 1.0;
  const Number t6 = stiffness * t5;
  const Number t9 = damping * rate;
  const Number t10 = t6 + t9;
  const Number t11 = t10 / length;
  *force_density = t11;
}

static inline void elastic_damped_gap(const Number length, const Number rest, const Number rate, const Number stiffness, const Number damping, Number *gap) {
  const Number t2 = length - rest;
  const Number t4 = length / rest;
  const Number t6 = t4 - 1.0;
  const Number t7 = stiffness * t6;
  const Number t10 = damping * rate;
  const Number t11 = t7 + t10;
  const Number t12 = stiffness / rest;
  const Number t13 = t11 / t12;
  const Number t14 = smaller(t2, t13);
  *gap = t14;
}

#endif
