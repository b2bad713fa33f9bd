/* Adaptive steps of order 8 by Dormand and Prince, which end at switches.

   E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.5
   (coefficients, error estimate) and II.6 (interpolant). */
#include <float.h>
#include <math.h>
#include <string.h>

#include "dop853_coefficients.h"
#include "methods.h"
#include "motion.h"

enum { STAGES = 12, MORE_STAGES = 3, SLOPES = 16, POWERS = 7, ORDER = 8, MOST_STALLS = 50 };

/* Steps aim at an error of this part of what it may be; they change by these factors at most. */
static const double SAFETY = 0.75, LEAST = 0.2, MOST = 10;

/* A step shorter than this part of the span is lost in round-off. */
static const double SHORTEST = 10 * DBL_EPSILON;

/* A longer step, times the largest frequency, makes round-off grow, which no estimate sees. */
static const double STABLE = 4;

/* What ending late at a switch may change of velocities, as part of what a step may err. */
static const double LATE = 0.003;

/* Steps end at a switch on their interpolant where it errs less than this part of it. */
static const double SMOOTH = 0.3;

/* What switches that are carried err is of order 4 in the step. So much of the next order, of
   positions and velocities, is what they err: an impulse that grows from zero leaves less. */
static const double OF_POSITIONS = 1. / 12, OF_VELOCITIES = 1. / 3;
enum { CARRY_ORDER = 4 };

typedef struct {
  Span *span;
  const double *x, *taut;
  double time, h; /* of the step */
  double *K, *y, *interpolant;
  double reach; /* h of the interpolant */
} Dop853;

#define STAGE(k)                                                              \
  do {                                                                        \
    for (int i = 0; i < n; ++i) y[i] = x[i] + h * STAGE_##k;                  \
    slope_at(m->span, y, m->time + TIME_##k * h, m->taut, K + k * n);         \
  } while (0)

/* The sums of a stage, in wide registers. */
#define SUM(k)                                                                                   \
  WIDE static void sum_##k(const double *restrict x, double h, const double *restrict K,         \
                           double *restrict y, int n) {                                          \
    for (int i = 0; i < n; ++i) y[i] = x[i] + h * STAGE_##k;                                     \
  }
SUM(1) SUM(2) SUM(3) SUM(4) SUM(5) SUM(6) SUM(7) SUM(8) SUM(9) SUM(10) SUM(11)
SUM(13) SUM(14) SUM(15)
#undef STAGE
#define STAGE(k)                                                      \
  do {                                                                \
    sum_##k(x, h, K, y, n);                                           \
    slope_at(m->span, y, m->time + TIME_##k * h, m->taut, K + k * n); \
  } while (0)

WIDE static void sum_end(const double *restrict x, double h, const double *restrict K,
                         double *restrict y, int n) {
  for (int i = 0; i < n; ++i) y[i] = x[i] + h * END;
}

/* A step of length h, whose first slope is known. */
static void step_of(Dop853 *m, double h, double *x1) {
  const int n = m->span->states;
  const double *x = m->x;
  double *K = m->K, *y = m->y;
  STAGE(1); STAGE(2); STAGE(3); STAGE(4); STAGE(5); STAGE(6);
  STAGE(7); STAGE(8); STAGE(9); STAGE(10); STAGE(11);
  sum_end(x, h, K, x1, n);
  restore_bars(m->span, x1);
}

/* The root mean square of the error over the state, as part of what it may be. */
WIDE static double error_of(const double *restrict K, const double *restrict scale, double h,
                            int n) {
  double fifth = 0, third = 0, below;
  for (int i = 0; i < n; ++i) {
    const double a = FIFTH / scale[i], b = THIRD / scale[i];
    fifth += a * a;
    third += b * b;
  }
  below = sqrt((fifth + 0.01 * third) * n);
  /* Nothing moves: no error. Squares that overflow: a step far too long. */
  return below > 0 && below < INFINITY ? h * fifth / below : below;
}

static double factor_of(double error, double order) {
  return smaller(larger(SAFETY * pow(larger(error, 1e-16), -1 / order), LEAST), MOST);
}

/* What carried switches err, as error_of a step, by what the next order adds to xdot. */
static double carry_error(const double *defect, const double *scale, double h, int n) {
  double sum = 0;
  for (int i = 0; i < n / 2; ++i) {
    const double a = defect[n / 2 + i];
    const double q = OF_POSITIONS * h * h * a / scale[i], v = OF_VELOCITIES * h * a / scale[n / 2 + i];
    sum += q * q + v * v;
  }
  return sqrt(sum / n);
}

WIDE static void dense(const double *restrict x, const double *restrict x1,
                       const double *restrict K, double h, double *restrict made, int n) {
  const double *f = K, *f1 = K + STAGES * n;
  for (int i = 0; i < n; ++i) {
    const double step = x1[i] - x[i];
    made[i] = step;
    made[n + i] = h * f[i] - step;
    made[2 * n + i] = 2 * step - h * (f1[i] + f[i]);
  }
  for (int i = 0; i < n; ++i) made[3 * n + i] = h * DENSE_0;
  for (int i = 0; i < n; ++i) made[4 * n + i] = h * DENSE_1;
  for (int i = 0; i < n; ++i) made[5 * n + i] = h * DENSE_2;
  for (int i = 0; i < n; ++i) made[6 * n + i] = h * DENSE_3;
}

/* The coefficients of the interpolant of a step of length h to x1. */
static void interpolate(Dop853 *m, double h, const double *x1) {
  const int n = m->span->states;
  const double *x = m->x;
  double *K = m->K, *y = m->y;
  STAGE(13); STAGE(14); STAGE(15);
  dense(x, x1, K, h, m->interpolant, n);
  m->reach = h;
}

/* The state on the interpolant a time after the start of the step. */
WIDE static void within(const double *restrict x, const double *restrict made, double part,
                        double *restrict to, int n) {
  for (int i = 0; i < n; ++i) {
    double value = 0;
    for (int k = POWERS - 1; k >= 0; --k)
      value = (value + made[k * n + i]) * (k % 2 ? 1 - part : part);
    to[i] = x[i] + value;
  }
}

static void place_inside(void *by, double part, double *x1) {
  Dop853 *m = by;
  within(m->x, m->interpolant, part * m->h / m->reach, x1, m->span->states);
  restore_bars(m->span, x1);
}

static void place_by_step(void *by, double part, double *x1) {
  Dop853 *m = by;
  step_of(m, part * m->h, x1);
}

/* What the interpolant errs at a part of the step, as part of the error estimate. */
static double interpolant_error(double part) {
  double value = 0;
  for (int k = sizeof INTERPOLANT_ERROR / sizeof(double) - 1; k >= 0; --k)
    value = INTERPOLANT_ERROR[k] + part * value;
  return fabs(value);
}

/* A landing takes a new start; switches that are carried another slope, whether they are or not. */
double tc_evaluations(const Progress *now) {
  return 1.0 + STAGES * (double)(now->tries + now->approaches) +
         (double)(now->landings + now->carries) + MORE_STAGES * (double)now->interpolants;
}

int advance_by_dop853(Span *span, const Settings *settings, Progress *now, Kept *kept, double *x,
                      double *slope, double *taut, double *work) {
  const int n = span->states, m = span->switches;
  const double duration = settings->duration, *scale = settings->scale;
  const double spacing = duration / settings->outputs;
  const int may_carry = !velocity_dependent(span->scene) && !settings->traces;
  double *x1 = work, *K = x1 + n, *y = K + SLOPES * n, *made = y + n, *started = made + POWERS * n;
  double *end = started + m, *pulling = end + n, *defect = pulling + m;
  Dop853 method = {span, x, taut, 0, 0, K, y, made, 0};
  /* The first output that is not reached yet. */
  int done = (int)floor(now->time / spacing * (1 + 1e-14));
  kept->column = done + 1;
  for (int tried = 0; tried < settings->budget && now->time < duration && !now->stuck; ++tried) {
    if (tc_evaluations(now) >= settings->limit) break;
    const double time = now->time;
    const double h = smaller(smaller(now->step, settings->longest), duration - time);
    const Tried step = {x, x1, K, K + STAGES * n, taut, time, h};
    double taken = h, after, error, factor, until;
    int crossed = 0, is_inside = 0, is_carried = 0;
    double places = 0;
    method.time = time;
    method.h = h;
    memcpy(K, slope, n * sizeof *K);
    step_of(&method, h, x1);
    error = error_of(K, scale, h, n);
    now->tries += 1;
    if (!(error < 1)) {
      now->step = h * (error < INFINITY ? smaller(factor_of(error, ORDER), 1) : LEAST / 2);
      now->rejections += 1;
      now->stuck = now->step < SHORTEST * duration;
      continue;
    }
    slope_at(span, x1, time + h, taut, K + STAGES * n);
    crossed = (int)crossings(span, &step);
    memcpy(started, taut, m * sizeof *taut);
    factor = factor_of(error, ORDER);
    if (crossed) factor = smaller(factor, 1);
    if (crossed > MANY_SWITCHES && may_carry) {
      int count;
      double off;
      memcpy(end, x1, n * sizeof *end);
      count = (int)carry(span, 1, &step, end, pulling, defect);
      off = carry_error(defect, scale, h, n);
      now->carries += 1;
      is_carried = off < 1;
      if (!is_carried && 2 < crossed * factor_of(off, CARRY_ORDER)) {
        /* Shorter steps take less than a landing on each. */
        now->step = h * smaller(factor_of(off, CARRY_ORDER), SAFETY);
        now->rejections += 1;
        continue;
      }
      if (is_carried) {
        const Tried carried = {x, end, slope, defect, 0, time, h};
        memcpy(taut, pulling, m * sizeof *taut);
        slope_at(span, end, time + h, taut, defect);
        make_path(span, &carried);
        memcpy(x1, end, n * sizeof *x1);
        factor = smaller(factor_of(error, ORDER), factor_of(off, CARRY_ORDER));
        now->switches += count;
        now->carried += count;
      }
    }
    if (crossed && !is_carried) {
      const double reach = settings->longest / STABLE;
      const double allowed = settings->traces ? 0 : 2 * LATE * scale[n - 1] * (reach * reach);
      const Cut cut = first_switch(span, &step, allowed, 0);
      if (cut.found) {
        is_inside = !settings->traces && error * interpolant_error(cut.part) < SMOOTH;
        if (is_inside) {
          interpolate(&method, h, x1);
          now->interpolants += 1;
        }
        taken = h * approach(span, &step, cut, is_inside ? place_inside : place_by_step, &method,
                             x1, &places);
        if (!is_inside) now->approaches += (int64_t)places;
        now->switches += (int64_t)switch_over(span, 1, x1, time + taken, taut);
      }
    }
    after = taken >= duration - time ? duration : time + taken;
    until = after * (1 + 2e-14);
    if (done + 1 < settings->outputs && (done + 1) * spacing <= until && after > time) {
      if (!is_inside && !is_carried) {
        method.taut = started;
        if (crossed) slope_at(span, x1, time + taken, started, K + STAGES * n);
        interpolate(&method, taken, x1);
        method.taut = taut;
        now->interpolants += 1;
      }
      for (; done + 1 < settings->outputs && (done + 1) * spacing <= until; ++done) {
        double *to = next_output(kept);
        const double past = (done + 1) * spacing - time;
        if (is_carried) on_path(span, h, past / h, to);
        else within(x, made, past / method.reach, to, n);
        restore_bars(span, to);
      }
    }
    now->time = after;
    now->step = h * factor;
    memcpy(x, x1, n * sizeof *x);
    keep_step(kept, now, after, x, started);
    if (is_carried) {
      memcpy(slope, defect, n * sizeof *slope);
      now->landings += 1;
    } else if (crossed) {
      now->landings += 1;
      now->stalls = taken < SHORTEST * duration ? now->stalls + 1 : 0;
      now->stuck = now->stalls > MOST_STALLS;
      slope_at(span, x, after, taut, slope);
    } else {
      memcpy(slope, K + STAGES * n, n * sizeof *slope);
    }
  }
  if (now->time >= duration) {
    memcpy(next_output(kept), x, n * sizeof *x);
    done = settings->outputs;
  }
  return done;
}
