/* Derivatives of the kernels of one member: printed by tests/core_kernels.py, not by hand.

   Jacobians are stored column by column: of what a kernel returns, by what it is given in turn. */
#ifndef TENSCONTROL_SLOPES_H
#define TENSCONTROL_SLOPES_H

#include "numbers.h"

static inline void free_bar_force_density_slopes_2(const Number *bar, const Number *rate,
      const Number *force, const Number mass, Number *force_density, Number *slopes) {
  const Number t2 = mass / 12.0;
  const Number t18 = t2 * (rate[0] * rate[0] + rate[1] * rate[1]) + (bar[0] * force[0] +
      bar[1] * force[1]) / 2.0;
  const Number t21 = bar[0] * bar[0] + bar[1] * bar[1];
  const Number t22 = t18 / t21;
  *force_density = -t22;
  const Number t26 = t22 / t21;
  const Number t29 = 0.5 / t21;
  slopes[0] = 2 * bar[0] * t26 - force[0] * t29;
  slopes[1] = 2 * bar[1] * t26 - force[1] * t29;
  const Number t39 = t2 / t21;
  slopes[2] = -(2 * rate[0] * t39);
  slopes[3] = -(2 * rate[1] * t39);
  slopes[4] = -(bar[0] * t29);
  slopes[5] = -(bar[1] * t29);
}

static inline void swinging_bar_force_density_slopes_2(const Number *bar, const Number *rate,
      const Number *force, const Number mass, Number *force_density, Number *slopes) {
  const Number t2 = mass / 3.0;
  const Number t16 = t2 * (rate[0] * rate[0] + rate[1] * rate[1]) + (bar[0] * force[0] + bar[1] * force[1]);
  const Number t19 = bar[0] * bar[0] + bar[1] * bar[1];
  const Number t20 = t16 / t19;
  *force_density = -t20;
  const Number t24 = t20 / t19;
  slopes[0] = 2 * bar[0] * t24 - force[0] / t19;
  slopes[1] = 2 * bar[1] * t24 - force[1] / t19;
  const Number t35 = t2 / t19;
  slopes[2] = -(2 * rate[0] * t35);
  slopes[3] = -(2 * rate[1] * t35);
  slopes[4] = -(bar[0] / t19);
  slopes[5] = -(bar[1] / t19);
}

static inline void ground_force_slopes_2(const Number press, const Number *v, const Number friction,
      const Number slip_speed, const Number *normal, Number *force, Number *slopes) {
  const Number t8 = normal[0] * v[0] + normal[1] * v[1];
  const Number t10 = v[0] - normal[0] * t8;
  const Number t15 = v[1] - normal[1] * t8;
  const Number t21 = root(t10 * t10 + t15 * t15 + slip_speed * slip_speed);
  const Number t22 = friction * press / t21;
  force[0] = normal[0] * press - t10 * t22;
  force[1] = normal[1] * press - t15 * t22;
  const Number t30 = t10 / t21;
  slopes[0] = normal[0] - friction * t30;
  const Number t34 = t15 / t21;
  slopes[1] = normal[1] - friction * t34;
  const Number t38 = 2 * t10;
  const Number t39 = t22 / t21;
  const Number t41 = 2 * t21;
  const Number t42 = t39 * t10 / t41;
  const Number t44 = t38 * t42 - t22;
  const Number t45 = 2 * t15;
  const Number t46 = t45 * t42;
  const Number t49 = normal[1] * t46 + normal[0] * t44;
  slopes[2] = t44 - normal[0] * t49;
  const Number t54 = t39 * t15 / t41;
  const Number t55 = t38 * t54;
  const Number t57 = t45 * t54 - t22;
  const Number t60 = normal[1] * t57 + normal[0] * t55;
  slopes[3] = t55 - normal[0] * t60;
  slopes[4] = t46 - normal[1] * t49;
  slopes[5] = t57 - normal[1] * t60;
  slopes[6] = -(press * t30);
  slopes[7] = -(press * t34);
  const Number t76 = 2 * slip_speed;
  slopes[8] = t76 * t42;
  slopes[9] = t76 * t54;
}

static inline void free_bar_force_density_slopes_3(const Number *bar, const Number *rate,
      const Number *force, const Number mass, Number *force_density, Number *slopes) {
  const Number t2 = mass / 12.0;
  const Number t25 = t2 * (rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2]) + (bar[0] * force[0] +
      bar[1] * force[1] + bar[2] * force[2]) / 2.0;
  const Number t30 = bar[0] * bar[0] + bar[1] * bar[1] + bar[2] * bar[2];
  const Number t31 = t25 / t30;
  *force_density = -t31;
  const Number t35 = t31 / t30;
  const Number t38 = 0.5 / t30;
  slopes[0] = 2 * bar[0] * t35 - force[0] * t38;
  slopes[1] = 2 * bar[1] * t35 - force[1] * t38;
  slopes[2] = 2 * bar[2] * t35 - force[2] * t38;
  const Number t53 = t2 / t30;
  slopes[3] = -(2 * rate[0] * t53);
  slopes[4] = -(2 * rate[1] * t53);
  slopes[5] = -(2 * rate[2] * t53);
  slopes[6] = -(bar[0] * t38);
  slopes[7] = -(bar[1] * t38);
  slopes[8] = -(bar[2] * t38);
}

static inline void swinging_bar_force_density_slopes_3(const Number *bar, const Number *rate,
      const Number *force, const Number mass, Number *force_density, Number *slopes) {
  const Number t2 = mass / 3.0;
  const Number t23 = t2 * (rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2]) + (bar[0] * force[0] +
      bar[1] * force[1] + bar[2] * force[2]);
  const Number t28 = bar[0] * bar[0] + bar[1] * bar[1] + bar[2] * bar[2];
  const Number t29 = t23 / t28;
  *force_density = -t29;
  const Number t33 = t29 / t28;
  slopes[0] = 2 * bar[0] * t33 - force[0] / t28;
  slopes[1] = 2 * bar[1] * t33 - force[1] / t28;
  slopes[2] = 2 * bar[2] * t33 - force[2] / t28;
  const Number t49 = t2 / t28;
  slopes[3] = -(2 * rate[0] * t49);
  slopes[4] = -(2 * rate[1] * t49);
  slopes[5] = -(2 * rate[2] * t49);
  slopes[6] = -(bar[0] / t28);
  slopes[7] = -(bar[1] / t28);
  slopes[8] = -(bar[2] / t28);
}

static inline void ground_force_slopes_3(const Number press, const Number *v, const Number friction,
      const Number slip_speed, const Number *normal, Number *force, Number *slopes) {
  const Number t12 = normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2];
  const Number t14 = v[0] - normal[0] * t12;
  const Number t19 = v[1] - normal[1] * t12;
  const Number t23 = v[2] - normal[2] * t12;
  const Number t29 = root(t14 * t14 + t19 * t19 + t23 * t23 + slip_speed * slip_speed);
  const Number t30 = friction * press / t29;
  force[0] = normal[0] * press - t14 * t30;
  force[1] = normal[1] * press - t19 * t30;
  force[2] = normal[2] * press - t23 * t30;
  const Number t42 = friction / t29;
  slopes[0] = normal[0] - t14 * t42;
  slopes[1] = normal[1] - t19 * t42;
  slopes[2] = normal[2] - t23 * t42;
  const Number t54 = 1.0 - normal[0] * normal[0];
  const Number t56 = t30 / t29;
  const Number t57 = 2 * t14;
  const Number t59 = 2 * t19;
  const Number t60 = normal[1] * normal[0];
  const Number t63 = 2 * t23;
  const Number t64 = normal[2] * normal[0];
  const Number t67 = 2 * t29;
  const Number t69 = t56 * ((t57 * t54 - t59 * t60 - t63 * t64) / t67);
  slopes[3] = -(t30 * t54 - t14 * t69);
  slopes[4] = t30 * t60 + t19 * t69;
  slopes[5] = t30 * t64 + t23 * t69;
  const Number t82 = normal[0] * normal[1];
  const Number t85 = 1.0 - normal[1] * normal[1];
  const Number t89 = normal[2] * normal[1];
  const Number t93 = t56 * ((t59 * t85 - t57 * t82 - t63 * t89) / t67);
  slopes[6] = t30 * t82 + t14 * t93;
  slopes[7] = -(t30 * t85 - t19 * t93);
  slopes[8] = t30 * t89 + t23 * t93;
  const Number t106 = normal[0] * normal[2];
  const Number t109 = 1.0 - normal[2] * normal[2];
  const Number t112 = normal[1] * normal[2];
  const Number t117 = t56 * ((t63 * t109 - (t57 * t106 + t59 * t112)) / t67);
  slopes[9] = t30 * t106 + t14 * t117;
  slopes[10] = t30 * t112 + t19 * t117;
  slopes[11] = -(t30 * t109 - t23 * t117);
  const Number t130 = press / t29;
  slopes[12] = -(t14 * t130);
  slopes[13] = -(t19 * t130);
  slopes[14] = -(t23 * t130);
  const Number t141 = t56 * (slip_speed / t29);
  slopes[15] = t14 * t141;
  slopes[16] = t19 * t141;
  slopes[17] = t23 * t141;
}

static inline void linear_press_slopes(const Number depth, const Number rate, const Number stiffness,
      const Number damping, const Number pressing, Number *press, Number *slopes) {
  const Number t3 = stiffness * depth;
  const Number t8 = 1.0 + damping * rate;
  *press = pressing * (t3 * t8);
  const Number t12 = t8 * pressing;
  slopes[0] = stiffness * t12;
  const Number t15 = t3 * pressing;
  slopes[1] = damping * t15;
  slopes[2] = depth * t12;
  slopes[3] = rate * t15;
}

static inline void hertz_press_slopes(const Number depth, const Number rate, const Number stiffness,
      const Number damping, const Number pressing, Number *press, Number *slopes) {
  const Number t3 = stiffness * depth;
  const Number t6 = depth * depth + 1e-30;
  const Number t8 = power(t6, 0.25);
  const Number t9 = t3 * t8;
  const Number t14 = 1.0 + damping * rate;
  *press = pressing * (t9 * t14);
  const Number t22 = t14 * pressing;
  const Number t26 = t8 * t22;
  slopes[0] = 2 * depth * (0.25 * power(t6, -0.75) * (t3 * t22)) + stiffness * t26;
  const Number t30 = t9 * pressing;
  slopes[1] = damping * t30;
  slopes[2] = depth * t26;
  slopes[3] = rate * t30;
}

static inline void smooth_press_slopes(const Number depth, const Number rate, const Number stiffness,
      const Number damping, const Number width, Number *press, Number *slopes) {
  const Number t3 = depth + width;
  const Number t5 = larger(t3, all(0.0));
  const Number t6 = 2 * width;
  const Number t7 = smaller(t5, t6);
  const Number t10 = 4.0 * width;
  const Number t11 = t7 * t7 / t10;
  const Number t12 = depth - width;
  const Number t14 = t11 + larger(t12, all(0.0));
  const Number t15 = stiffness * t14;
  const Number t20 = 1.0 + damping * rate;
  const Number t24 = root(t20 * t20 + 0.010000000000000002);
  const Number t27 = (t20 + t24) / 2.004987562112089;
  *press = t15 * t27;
  const Number t30 = truth(0.0 <= t12);
  const Number t34 = stiffness * t27;
  const Number t35 = t30 / (t30 + truth(t12 <= 0.0)) * t34;
  const Number t36 = truth(0.0 <= t3);
  const Number t40 = truth(t5 <= t6);
  const Number t41 = truth(t6 <= t5);
  const Number t42 = t40 + t41;
  const Number t46 = 2 * t7 * (t34 / t10);
  const Number t48 = t36 / (t36 + truth(t3 <= 0.0)) * (t40 / t42 * t46);
  slopes[0] = t35 + t48;
  const Number t52 = 0.4987562112089027 * t15;
  const Number t57 = t52 + 2 * t20 * (t52 / (2 * t24));
  slopes[1] = damping * t57;
  slopes[2] = t14 * t27;
  slopes[3] = rate * t57;
  slopes[4] = 2 * (t41 / t42 * t46) - (t35 + 4.0 * (t11 / t10 * t34)) + t48;
}

static inline void linear_undamped_force_density_slopes(const Number length, const Number rest,
      const Number stiffness, Number *force_density, Number *slopes) {
  const Number t3 = length - rest;
  const Number t5 = stiffness * t3 / length;
  *force_density = t5;
  const Number t7 = stiffness / length;
  slopes[0] = t7 - t5 / length;
  slopes[1] = -t7;
  slopes[2] = t3 / length;
}

static inline void linear_damped_force_density_slopes(const Number length, const Number rest,
      const Number rate, const Number stiffness, const Number damping, Number *force_density,
      Number *slopes) {
  const Number t3 = length - rest;
  const Number t9 = (stiffness * t3 + damping * rate) / length;
  *force_density = t9;
  const Number t11 = stiffness / length;
  slopes[0] = t11 - t9 / length;
  slopes[1] = -t11;
  slopes[2] = damping / length;
  slopes[3] = t3 / length;
  slopes[4] = rate / length;
}

static inline void elastic_undamped_force_density_slopes(const Number length, const Number rest,
      const Number stiffness, Number *force_density, Number *slopes) {
  const Number t3 = length / rest;
  const Number t5 = t3 - 1.0;
  const Number t7 = stiffness * t5 / length;
  *force_density = t7;
  const Number t9 = stiffness / length;
  slopes[0] = t9 / rest - t7 / length;
  slopes[1] = -(t3 / rest * t9);
  slopes[2] = t5 / length;
}

static inline void elastic_damped_force_density_slopes(const Number length, const Number rest,
      const Number rate, const Number stiffness, const Number damping, Number *force_density,
      Number *slopes) {
  const Number t3 = length / rest;
  const Number t5 = t3 - 1.0;
  const Number t11 = (stiffness * t5 + damping * rate) / length;
  *force_density = t11;
  const Number t13 = stiffness / length;
  slopes[0] = t13 / rest - t11 / length;
  slopes[1] = -(t3 / rest * t13);
  slopes[2] = damping / length;
  slopes[3] = t5 / length;
  slopes[4] = rate / length;
}

#endif
