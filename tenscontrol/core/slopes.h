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

static inline void linear_ground_slopes_2(const Number *x, const Number *v, const Number stiffness,
      const Number damping, const Number friction, const Number slip_speed, const Number height,
      const Number pressing, const Number *normal, Number *force, Number *slopes) {
  const Number t10 = height - (normal[0] * x[0] + normal[1] * x[1]);
  const Number t11 = stiffness * t10;
  const Number t18 = normal[0] * v[0] + normal[1] * v[1];
  const Number t20 = 1.0 - damping * t18;
  const Number t22 = pressing * (t11 * t20);
  const Number t25 = v[0] - normal[0] * t18;
  const Number t30 = v[1] - normal[1] * t18;
  const Number t36 = root(t25 * t25 + t30 * t30 + slip_speed * slip_speed);
  const Number t37 = friction * t22 / t36;
  force[0] = normal[0] * t22 - t25 * t37;
  force[1] = normal[1] * t22 - t30 * t37;
  const Number t45 = t25 / t36;
  const Number t48 = pressing * (normal[0] - friction * t45);
  const Number t49 = t20 * t48;
  const Number t50 = stiffness * t49;
  slopes[0] = -(normal[0] * t50);
  const Number t54 = t30 / t36;
  const Number t57 = pressing * (normal[1] - friction * t54);
  const Number t58 = t20 * t57;
  const Number t59 = stiffness * t58;
  slopes[1] = -(normal[0] * t59);
  slopes[2] = -(normal[1] * t50);
  slopes[3] = -(normal[1] * t59);
  const Number t69 = 2 * t25;
  const Number t70 = t37 / t36;
  const Number t72 = 2 * t36;
  const Number t73 = t70 * t25 / t72;
  const Number t75 = t69 * t73 - t37;
  const Number t76 = 2 * t30;
  const Number t77 = t76 * t73;
  const Number t80 = normal[1] * t77 + normal[0] * t75;
  const Number t83 = t11 * t48;
  const Number t84 = damping * t83;
  slopes[4] = t75 - normal[0] * t80 - normal[0] * t84;
  const Number t89 = t70 * t30 / t72;
  const Number t90 = t69 * t89;
  const Number t92 = t76 * t89 - t37;
  const Number t95 = normal[1] * t92 + normal[0] * t90;
  const Number t98 = t11 * t57;
  const Number t99 = damping * t98;
  slopes[5] = t90 - normal[0] * t95 - normal[0] * t99;
  slopes[6] = t77 - normal[1] * t80 - normal[1] * t84;
  slopes[7] = t92 - normal[1] * t95 - normal[1] * t99;
  slopes[8] = t10 * t49;
  slopes[9] = t10 * t58;
  slopes[10] = -(t18 * t83);
  slopes[11] = -(t18 * t98);
  slopes[12] = -(t22 * t45);
  slopes[13] = -(t22 * t54);
  const Number t129 = 2 * slip_speed;
  slopes[14] = t129 * t73;
  slopes[15] = t129 * t89;
  slopes[16] = t50;
  slopes[17] = t59;
}

static inline void hertz_ground_slopes_2(const Number *x, const Number *v, const Number stiffness,
      const Number damping, const Number friction, const Number slip_speed, const Number height,
      const Number pressing, const Number *normal, Number *force, Number *slopes) {
  const Number t10 = height - (normal[0] * x[0] + normal[1] * x[1]);
  const Number t11 = stiffness * t10;
  const Number t14 = t10 * t10 + 1e-30;
  const Number t16 = power(t14, 0.25);
  const Number t17 = t11 * t16;
  const Number t24 = normal[0] * v[0] + normal[1] * v[1];
  const Number t26 = 1.0 - damping * t24;
  const Number t28 = pressing * (t17 * t26);
  const Number t31 = v[0] - normal[0] * t24;
  const Number t36 = v[1] - normal[1] * t24;
  const Number t42 = root(t31 * t31 + t36 * t36 + slip_speed * slip_speed);
  const Number t43 = friction * t28 / t42;
  force[0] = normal[0] * t28 - t31 * t43;
  force[1] = normal[1] * t28 - t36 * t43;
  const Number t51 = 2 * t10;
  const Number t54 = 0.25 * power(t14, -0.75);
  const Number t55 = t31 / t42;
  const Number t58 = pressing * (normal[0] - friction * t55);
  const Number t59 = t26 * t58;
  const Number t63 = t16 * t59;
  const Number t65 = t51 * (t54 * (t11 * t59)) + stiffness * t63;
  slopes[0] = -(normal[0] * t65);
  const Number t69 = t36 / t42;
  const Number t72 = pressing * (normal[1] - friction * t69);
  const Number t73 = t26 * t72;
  const Number t77 = t16 * t73;
  const Number t79 = t51 * (t54 * (t11 * t73)) + stiffness * t77;
  slopes[1] = -(normal[0] * t79);
  slopes[2] = -(normal[1] * t65);
  slopes[3] = -(normal[1] * t79);
  const Number t89 = 2 * t31;
  const Number t90 = t43 / t42;
  const Number t92 = 2 * t42;
  const Number t93 = t90 * t31 / t92;
  const Number t95 = t89 * t93 - t43;
  const Number t96 = 2 * t36;
  const Number t97 = t96 * t93;
  const Number t100 = normal[1] * t97 + normal[0] * t95;
  const Number t103 = t17 * t58;
  const Number t104 = damping * t103;
  slopes[4] = t95 - normal[0] * t100 - normal[0] * t104;
  const Number t109 = t90 * t36 / t92;
  const Number t110 = t89 * t109;
  const Number t112 = t96 * t109 - t43;
  const Number t115 = normal[1] * t112 + normal[0] * t110;
  const Number t118 = t17 * t72;
  const Number t119 = damping * t118;
  slopes[5] = t110 - normal[0] * t115 - normal[0] * t119;
  slopes[6] = t97 - normal[1] * t100 - normal[1] * t104;
  slopes[7] = t112 - normal[1] * t115 - normal[1] * t119;
  slopes[8] = t10 * t63;
  slopes[9] = t10 * t77;
  slopes[10] = -(t24 * t103);
  slopes[11] = -(t24 * t118);
  slopes[12] = -(t28 * t55);
  slopes[13] = -(t28 * t69);
  const Number t149 = 2 * slip_speed;
  slopes[14] = t149 * t93;
  slopes[15] = t149 * t109;
  slopes[16] = t65;
  slopes[17] = t79;
}

static inline void smooth_ground_slopes_2(const Number *x, const Number *v, const Number stiffness,
      const Number damping, const Number friction, const Number slip_speed, const Number height,
      const Number width, const Number *normal, Number *force, Number *slopes) {
  const Number t9 = height - (normal[0] * x[0] + normal[1] * x[1]);
  const Number t11 = t9 + width;
  const Number t13 = larger(t11, all(0.0));
  const Number t14 = 2 * width;
  const Number t15 = smaller(t13, t14);
  const Number t18 = 4.0 * width;
  const Number t19 = t15 * t15 / t18;
  const Number t20 = t9 - width;
  const Number t22 = t19 + larger(t20, all(0.0));
  const Number t23 = stiffness * t22;
  const Number t30 = normal[0] * v[0] + normal[1] * v[1];
  const Number t32 = 1.0 - damping * t30;
  const Number t36 = root(t32 * t32 + 0.010000000000000002);
  const Number t39 = (t32 + t36) / 2.004987562112089;
  const Number t40 = t23 * t39;
  const Number t43 = v[0] - normal[0] * t30;
  const Number t48 = v[1] - normal[1] * t30;
  const Number t54 = root(t43 * t43 + t48 * t48 + slip_speed * slip_speed);
  const Number t55 = friction * t40 / t54;
  force[0] = normal[0] * t40 - t43 * t55;
  force[1] = normal[1] * t40 - t48 * t55;
  const Number t63 = truth(0.0 <= t20);
  const Number t66 = t63 / (t63 + truth(t20 <= 0.0));
  const Number t67 = t43 / t54;
  const Number t69 = normal[0] - friction * t67;
  const Number t70 = t39 * t69;
  const Number t71 = stiffness * t70;
  const Number t72 = t66 * t71;
  const Number t73 = truth(0.0 <= t11);
  const Number t76 = t73 / (t73 + truth(t11 <= 0.0));
  const Number t77 = truth(t13 <= t14);
  const Number t78 = truth(t14 <= t13);
  const Number t79 = t77 + t78;
  const Number t80 = t77 / t79;
  const Number t81 = 2 * t15;
  const Number t83 = t81 * (t71 / t18);
  const Number t85 = t76 * (t80 * t83);
  const Number t86 = t72 + t85;
  slopes[0] = -(normal[0] * t86);
  const Number t90 = t48 / t54;
  const Number t92 = normal[1] - friction * t90;
  const Number t93 = t39 * t92;
  const Number t94 = stiffness * t93;
  const Number t95 = t66 * t94;
  const Number t97 = t81 * (t94 / t18);
  const Number t99 = t76 * (t80 * t97);
  const Number t100 = t95 + t99;
  slopes[1] = -(normal[0] * t100);
  slopes[2] = -(normal[1] * t86);
  slopes[3] = -(normal[1] * t100);
  const Number t110 = 2 * t43;
  const Number t111 = t55 / t54;
  const Number t113 = 2 * t54;
  const Number t114 = t111 * t43 / t113;
  const Number t116 = t110 * t114 - t55;
  const Number t117 = 2 * t48;
  const Number t118 = t117 * t114;
  const Number t121 = normal[1] * t118 + normal[0] * t116;
  const Number t126 = 0.4987562112089027 * (t23 * t69);
  const Number t127 = 2 * t32;
  const Number t128 = 2 * t36;
  const Number t131 = t126 + t127 * (t126 / t128);
  const Number t132 = damping * t131;
  slopes[4] = t116 - normal[0] * t121 - normal[0] * t132;
  const Number t137 = t111 * t48 / t113;
  const Number t138 = t110 * t137;
  const Number t140 = t117 * t137 - t55;
  const Number t143 = normal[1] * t140 + normal[0] * t138;
  const Number t147 = 0.4987562112089027 * (t23 * t92);
  const Number t150 = t147 + t127 * (t147 / t128);
  const Number t151 = damping * t150;
  slopes[5] = t138 - normal[0] * t143 - normal[0] * t151;
  slopes[6] = t118 - normal[1] * t121 - normal[1] * t132;
  slopes[7] = t140 - normal[1] * t143 - normal[1] * t151;
  slopes[8] = t22 * t70;
  slopes[9] = t22 * t93;
  slopes[10] = -(t30 * t131);
  slopes[11] = -(t30 * t150);
  slopes[12] = -(t40 * t67);
  slopes[13] = -(t40 * t90);
  const Number t181 = 2 * slip_speed;
  slopes[14] = t181 * t114;
  slopes[15] = t181 * t137;
  slopes[16] = t86;
  slopes[17] = t100;
  const Number t188 = t78 / t79;
  const Number t191 = t19 / t18;
  slopes[18] = 2 * (t188 * t83) - (t72 + 4.0 * (t191 * t71)) + t85;
  slopes[19] = 2 * (t188 * t97) - (t95 + 4.0 * (t191 * t94)) + t99;
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

static inline void linear_ground_slopes_3(const Number *x, const Number *v, const Number stiffness,
      const Number damping, const Number friction, const Number slip_speed, const Number height,
      const Number pressing, const Number *normal, Number *force, Number *slopes) {
  const Number t14 = height - (normal[0] * x[0] + normal[1] * x[1] + normal[2] * x[2]);
  const Number t15 = stiffness * t14;
  const Number t25 = normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2];
  const Number t27 = 1.0 - damping * t25;
  const Number t29 = pressing * (t15 * t27);
  const Number t32 = v[0] - normal[0] * t25;
  const Number t37 = v[1] - normal[1] * t25;
  const Number t41 = v[2] - normal[2] * t25;
  const Number t47 = root(t32 * t32 + t37 * t37 + t41 * t41 + slip_speed * slip_speed);
  const Number t48 = friction * t29 / t47;
  force[0] = normal[0] * t29 - t32 * t48;
  force[1] = normal[1] * t29 - t37 * t48;
  force[2] = normal[2] * t29 - t41 * t48;
  const Number t60 = t32 / t47;
  const Number t63 = pressing * (normal[0] - friction * t60);
  const Number t64 = t27 * t63;
  const Number t65 = stiffness * t64;
  slopes[0] = -(normal[0] * t65);
  const Number t69 = t37 / t47;
  const Number t72 = pressing * (normal[1] - friction * t69);
  const Number t73 = t27 * t72;
  const Number t74 = stiffness * t73;
  slopes[1] = -(normal[0] * t74);
  const Number t78 = t41 / t47;
  const Number t81 = pressing * (normal[2] - friction * t78);
  const Number t82 = t27 * t81;
  const Number t83 = stiffness * t82;
  slopes[2] = -(normal[0] * t83);
  slopes[3] = -(normal[1] * t65);
  slopes[4] = -(normal[1] * t74);
  slopes[5] = -(normal[1] * t83);
  slopes[6] = -(normal[2] * t65);
  slopes[7] = -(normal[2] * t74);
  slopes[8] = -(normal[2] * t83);
  const Number t105 = 2 * t32;
  const Number t106 = t48 / t47;
  const Number t108 = 2 * t47;
  const Number t109 = t106 * t32 / t108;
  const Number t111 = t105 * t109 - t48;
  const Number t112 = 2 * t41;
  const Number t113 = t112 * t109;
  const Number t115 = 2 * t37;
  const Number t116 = t115 * t109;
  const Number t120 = normal[2] * t113 + normal[1] * t116 + normal[0] * t111;
  const Number t123 = t15 * t63;
  const Number t124 = damping * t123;
  slopes[9] = t111 - normal[0] * t120 - normal[0] * t124;
  const Number t129 = t106 * t37 / t108;
  const Number t130 = t105 * t129;
  const Number t131 = t112 * t129;
  const Number t134 = t115 * t129 - t48;
  const Number t138 = normal[2] * t131 + normal[1] * t134 + normal[0] * t130;
  const Number t141 = t15 * t72;
  const Number t142 = damping * t141;
  slopes[10] = t130 - normal[0] * t138 - normal[0] * t142;
  const Number t147 = t106 * t41 / t108;
  const Number t148 = t105 * t147;
  const Number t150 = t112 * t147 - t48;
  const Number t152 = t115 * t147;
  const Number t156 = normal[2] * t150 + normal[1] * t152 + normal[0] * t148;
  const Number t159 = t15 * t81;
  const Number t160 = damping * t159;
  slopes[11] = t148 - normal[0] * t156 - normal[0] * t160;
  slopes[12] = t116 - normal[1] * t120 - normal[1] * t124;
  slopes[13] = t134 - normal[1] * t138 - normal[1] * t142;
  slopes[14] = t152 - normal[1] * t156 - normal[1] * t160;
  slopes[15] = t113 - normal[2] * t120 - normal[2] * t124;
  slopes[16] = t131 - normal[2] * t138 - normal[2] * t142;
  slopes[17] = t150 - normal[2] * t156 - normal[2] * t160;
  slopes[18] = t14 * t64;
  slopes[19] = t14 * t73;
  slopes[20] = t14 * t82;
  slopes[21] = -(t25 * t123);
  slopes[22] = -(t25 * t141);
  slopes[23] = -(t25 * t159);
  slopes[24] = -(t29 * t60);
  slopes[25] = -(t29 * t69);
  slopes[26] = -(t29 * t78);
  const Number t218 = 2 * slip_speed;
  slopes[27] = t218 * t109;
  slopes[28] = t218 * t129;
  slopes[29] = t218 * t147;
  slopes[30] = t65;
  slopes[31] = t74;
  slopes[32] = t83;
}

static inline void hertz_ground_slopes_3(const Number *x, const Number *v, const Number stiffness,
      const Number damping, const Number friction, const Number slip_speed, const Number height,
      const Number pressing, const Number *normal, Number *force, Number *slopes) {
  const Number t14 = height - (normal[0] * x[0] + normal[1] * x[1] + normal[2] * x[2]);
  const Number t15 = stiffness * t14;
  const Number t18 = t14 * t14 + 1e-30;
  const Number t20 = power(t18, 0.25);
  const Number t21 = t15 * t20;
  const Number t31 = normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2];
  const Number t33 = 1.0 - damping * t31;
  const Number t35 = pressing * (t21 * t33);
  const Number t38 = v[0] - normal[0] * t31;
  const Number t43 = v[1] - normal[1] * t31;
  const Number t47 = v[2] - normal[2] * t31;
  const Number t53 = root(t38 * t38 + t43 * t43 + t47 * t47 + slip_speed * slip_speed);
  const Number t54 = friction * t35 / t53;
  force[0] = normal[0] * t35 - t38 * t54;
  force[1] = normal[1] * t35 - t43 * t54;
  force[2] = normal[2] * t35 - t47 * t54;
  const Number t66 = 2 * t14;
  const Number t69 = 0.25 * power(t18, -0.75);
  const Number t70 = t38 / t53;
  const Number t73 = pressing * (normal[0] - friction * t70);
  const Number t74 = t33 * t73;
  const Number t78 = t20 * t74;
  const Number t80 = t66 * (t69 * (t15 * t74)) + stiffness * t78;
  slopes[0] = -(normal[0] * t80);
  const Number t84 = t43 / t53;
  const Number t87 = pressing * (normal[1] - friction * t84);
  const Number t88 = t33 * t87;
  const Number t92 = t20 * t88;
  const Number t94 = t66 * (t69 * (t15 * t88)) + stiffness * t92;
  slopes[1] = -(normal[0] * t94);
  const Number t98 = t47 / t53;
  const Number t101 = pressing * (normal[2] - friction * t98);
  const Number t102 = t33 * t101;
  const Number t106 = t20 * t102;
  const Number t108 = t66 * (t69 * (t15 * t102)) + stiffness * t106;
  slopes[2] = -(normal[0] * t108);
  slopes[3] = -(normal[1] * t80);
  slopes[4] = -(normal[1] * t94);
  slopes[5] = -(normal[1] * t108);
  slopes[6] = -(normal[2] * t80);
  slopes[7] = -(normal[2] * t94);
  slopes[8] = -(normal[2] * t108);
  const Number t130 = 2 * t38;
  const Number t131 = t54 / t53;
  const Number t133 = 2 * t53;
  const Number t134 = t131 * t38 / t133;
  const Number t136 = t130 * t134 - t54;
  const Number t137 = 2 * t47;
  const Number t138 = t137 * t134;
  const Number t140 = 2 * t43;
  const Number t141 = t140 * t134;
  const Number t145 = normal[2] * t138 + normal[1] * t141 + normal[0] * t136;
  const Number t148 = t21 * t73;
  const Number t149 = damping * t148;
  slopes[9] = t136 - normal[0] * t145 - normal[0] * t149;
  const Number t154 = t131 * t43 / t133;
  const Number t155 = t130 * t154;
  const Number t156 = t137 * t154;
  const Number t159 = t140 * t154 - t54;
  const Number t163 = normal[2] * t156 + normal[1] * t159 + normal[0] * t155;
  const Number t166 = t21 * t87;
  const Number t167 = damping * t166;
  slopes[10] = t155 - normal[0] * t163 - normal[0] * t167;
  const Number t172 = t131 * t47 / t133;
  const Number t173 = t130 * t172;
  const Number t175 = t137 * t172 - t54;
  const Number t177 = t140 * t172;
  const Number t181 = normal[2] * t175 + normal[1] * t177 + normal[0] * t173;
  const Number t184 = t21 * t101;
  const Number t185 = damping * t184;
  slopes[11] = t173 - normal[0] * t181 - normal[0] * t185;
  slopes[12] = t141 - normal[1] * t145 - normal[1] * t149;
  slopes[13] = t159 - normal[1] * t163 - normal[1] * t167;
  slopes[14] = t177 - normal[1] * t181 - normal[1] * t185;
  slopes[15] = t138 - normal[2] * t145 - normal[2] * t149;
  slopes[16] = t156 - normal[2] * t163 - normal[2] * t167;
  slopes[17] = t175 - normal[2] * t181 - normal[2] * t185;
  slopes[18] = t14 * t78;
  slopes[19] = t14 * t92;
  slopes[20] = t14 * t106;
  slopes[21] = -(t31 * t148);
  slopes[22] = -(t31 * t166);
  slopes[23] = -(t31 * t184);
  slopes[24] = -(t35 * t70);
  slopes[25] = -(t35 * t84);
  slopes[26] = -(t35 * t98);
  const Number t243 = 2 * slip_speed;
  slopes[27] = t243 * t134;
  slopes[28] = t243 * t154;
  slopes[29] = t243 * t172;
  slopes[30] = t80;
  slopes[31] = t94;
  slopes[32] = t108;
}

static inline void smooth_ground_slopes_3(const Number *x, const Number *v, const Number stiffness,
      const Number damping, const Number friction, const Number slip_speed, const Number height,
      const Number width, const Number *normal, Number *force, Number *slopes) {
  const Number t13 = height - (normal[0] * x[0] + normal[1] * x[1] + normal[2] * x[2]);
  const Number t15 = t13 + width;
  const Number t17 = larger(t15, all(0.0));
  const Number t18 = 2 * width;
  const Number t19 = smaller(t17, t18);
  const Number t22 = 4.0 * width;
  const Number t23 = t19 * t19 / t22;
  const Number t24 = t13 - width;
  const Number t26 = t23 + larger(t24, all(0.0));
  const Number t27 = stiffness * t26;
  const Number t37 = normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2];
  const Number t39 = 1.0 - damping * t37;
  const Number t43 = root(t39 * t39 + 0.010000000000000002);
  const Number t46 = (t39 + t43) / 2.004987562112089;
  const Number t47 = t27 * t46;
  const Number t50 = v[0] - normal[0] * t37;
  const Number t55 = v[1] - normal[1] * t37;
  const Number t59 = v[2] - normal[2] * t37;
  const Number t65 = root(t50 * t50 + t55 * t55 + t59 * t59 + slip_speed * slip_speed);
  const Number t66 = friction * t47 / t65;
  force[0] = normal[0] * t47 - t50 * t66;
  force[1] = normal[1] * t47 - t55 * t66;
  force[2] = normal[2] * t47 - t59 * t66;
  const Number t78 = truth(0.0 <= t24);
  const Number t81 = t78 / (t78 + truth(t24 <= 0.0));
  const Number t82 = t50 / t65;
  const Number t84 = normal[0] - friction * t82;
  const Number t85 = t46 * t84;
  const Number t86 = stiffness * t85;
  const Number t87 = t81 * t86;
  const Number t88 = truth(0.0 <= t15);
  const Number t91 = t88 / (t88 + truth(t15 <= 0.0));
  const Number t92 = truth(t17 <= t18);
  const Number t93 = truth(t18 <= t17);
  const Number t94 = t92 + t93;
  const Number t95 = t92 / t94;
  const Number t96 = 2 * t19;
  const Number t98 = t96 * (t86 / t22);
  const Number t100 = t91 * (t95 * t98);
  const Number t101 = t87 + t100;
  slopes[0] = -(normal[0] * t101);
  const Number t105 = t55 / t65;
  const Number t107 = normal[1] - friction * t105;
  const Number t108 = t46 * t107;
  const Number t109 = stiffness * t108;
  const Number t110 = t81 * t109;
  const Number t112 = t96 * (t109 / t22);
  const Number t114 = t91 * (t95 * t112);
  const Number t115 = t110 + t114;
  slopes[1] = -(normal[0] * t115);
  const Number t119 = t59 / t65;
  const Number t121 = normal[2] - friction * t119;
  const Number t122 = t46 * t121;
  const Number t123 = stiffness * t122;
  const Number t124 = t81 * t123;
  const Number t126 = t96 * (t123 / t22);
  const Number t128 = t91 * (t95 * t126);
  const Number t129 = t124 + t128;
  slopes[2] = -(normal[0] * t129);
  slopes[3] = -(normal[1] * t101);
  slopes[4] = -(normal[1] * t115);
  slopes[5] = -(normal[1] * t129);
  slopes[6] = -(normal[2] * t101);
  slopes[7] = -(normal[2] * t115);
  slopes[8] = -(normal[2] * t129);
  const Number t151 = 2 * t50;
  const Number t152 = t66 / t65;
  const Number t154 = 2 * t65;
  const Number t155 = t152 * t50 / t154;
  const Number t157 = t151 * t155 - t66;
  const Number t158 = 2 * t59;
  const Number t159 = t158 * t155;
  const Number t161 = 2 * t55;
  const Number t162 = t161 * t155;
  const Number t166 = normal[2] * t159 + normal[1] * t162 + normal[0] * t157;
  const Number t171 = 0.4987562112089027 * (t27 * t84);
  const Number t172 = 2 * t39;
  const Number t173 = 2 * t43;
  const Number t176 = t171 + t172 * (t171 / t173);
  const Number t177 = damping * t176;
  slopes[9] = t157 - normal[0] * t166 - normal[0] * t177;
  const Number t182 = t152 * t55 / t154;
  const Number t183 = t151 * t182;
  const Number t184 = t158 * t182;
  const Number t187 = t161 * t182 - t66;
  const Number t191 = normal[2] * t184 + normal[1] * t187 + normal[0] * t183;
  const Number t195 = 0.4987562112089027 * (t27 * t107);
  const Number t198 = t195 + t172 * (t195 / t173);
  const Number t199 = damping * t198;
  slopes[10] = t183 - normal[0] * t191 - normal[0] * t199;
  const Number t204 = t152 * t59 / t154;
  const Number t205 = t151 * t204;
  const Number t207 = t158 * t204 - t66;
  const Number t209 = t161 * t204;
  const Number t213 = normal[2] * t207 + normal[1] * t209 + normal[0] * t205;
  const Number t217 = 0.4987562112089027 * (t27 * t121);
  const Number t220 = t217 + t172 * (t217 / t173);
  const Number t221 = damping * t220;
  slopes[11] = t205 - normal[0] * t213 - normal[0] * t221;
  slopes[12] = t162 - normal[1] * t166 - normal[1] * t177;
  slopes[13] = t187 - normal[1] * t191 - normal[1] * t199;
  slopes[14] = t209 - normal[1] * t213 - normal[1] * t221;
  slopes[15] = t159 - normal[2] * t166 - normal[2] * t177;
  slopes[16] = t184 - normal[2] * t191 - normal[2] * t199;
  slopes[17] = t207 - normal[2] * t213 - normal[2] * t221;
  slopes[18] = t26 * t85;
  slopes[19] = t26 * t108;
  slopes[20] = t26 * t122;
  slopes[21] = -(t37 * t176);
  slopes[22] = -(t37 * t198);
  slopes[23] = -(t37 * t220);
  slopes[24] = -(t47 * t82);
  slopes[25] = -(t47 * t105);
  slopes[26] = -(t47 * t119);
  const Number t279 = 2 * slip_speed;
  slopes[27] = t279 * t155;
  slopes[28] = t279 * t182;
  slopes[29] = t279 * t204;
  slopes[30] = t101;
  slopes[31] = t115;
  slopes[32] = t129;
  const Number t289 = t93 / t94;
  const Number t292 = t23 / t22;
  slopes[33] = 2 * (t289 * t98) - (t87 + 4.0 * (t292 * t86)) + t100;
  slopes[34] = 2 * (t289 * t112) - (t110 + 4.0 * (t292 * t109)) + t114;
  slopes[35] = 2 * (t289 * t126) - (t124 + 4.0 * (t292 * t123)) + t128;
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
