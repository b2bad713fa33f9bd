/* The classical Runge-Kutta method of order 4, in fixed steps that are cut at switches: of one run,
   and of those in lanes. */
#include <string.h>

#include "methods.h"
#include "motion.h"

/* Cuts of a step, at most; the rest is then taken whole, and its switches are carried or, where that
   cannot be, counted. What is left below this part of a step is round-off. How late a step ends, as
   part of the length of a string. */
enum { MOST_CUTS = 9 };
static const double REST = 1e-13, LATE = 1e-9;

/* A step, or what is left of one, from x to x1. Where `taut` is null, switches are not looked for. */
typedef struct {
  Span *span;
  const Number *x;
  Number *x1, *taut, time, left;
  Number *k1, *k2, *k3, *k4, *y, *slope1;
  int traces;
} Rk4;

/* Of the memory of a step. */
enum { RK4_STATES = 6 };

static Rk4 rk4_of(Span *span, const Number *x, Number *x1, Number *taut, Number *work) {
  const int n = span->states;
  const Rk4 m = {span, x,        x1,           taut,         all(0),       all(0),
                 work, work + n, work + 2 * n, work + 3 * n, work + 4 * n, work + 5 * n,
                 0};
  return m;
}

WIDE static void combine(const Number *restrict x, Number h, const Number *restrict k, Number *restrict y,
                         int n) {
  for (int i = 0; i < n; ++i) y[i] = x[i] + h * k[i];
}

WIDE static void finish(const Number *restrict x, Number h, const Number *restrict k1,
                        const Number *restrict k2, const Number *restrict k3, const Number *restrict k4,
                        Number *restrict y, int n) {
  for (int i = 0; i < n; ++i) y[i] = x[i] + h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}

/* A part of what is left, whose first slope is known. */
static void step_to(void *by, Number part, Number *x1) {
  const Rk4 *m = by;
  Span *span = m->span;
  const int n = span->states;
  const Number h = part * m->left;
  combine(m->x, h / 2, m->k1, m->y, n);
  slope_at(span, m->y, m->time + h / 2, m->taut, m->k2);
  combine(m->x, h / 2, m->k2, m->y, n);
  slope_at(span, m->y, m->time + h / 2, m->taut, m->k3);
  combine(m->x, h, m->k3, m->y, n);
  slope_at(span, m->y, m->time + h, m->taut, m->k4);
  finish(m->x, h, m->k1, m->k2, m->k3, m->k4, x1, n);
  restore_bars(span, x1, m->time + h);
}

static Tried tried_by(const Rk4 *m) {
  const Tried step = {m->x, m->x1, m->k1, m->slope1, m->taut, m->time, m->left};
  return step;
}

/* Takes what is left whole; returns how many strings may switch in it. */
static Number take_whole(Rk4 *m) {
  const Tried step = tried_by(m);
  slope_at(m->span, m->x, m->time, m->taut, m->k1);
  step_to(m, all(1), m->x1);
  return m->taut ? crossings(m->span, &step) : all(0);
}

/* What became of a step that is crossed: what of it was taken, and counts. */
typedef struct {
  Number taken, landings, places, switches, carries, carried, missed;
} Landing;

/* Ends what was taken whole, and has its first slope, at its first switch, if one is found. Switches
   of many strings are carried to its end, and those after many cuts; or missed, where that cannot
   be. */
static Landing land(Rk4 *m, Number crossed, int cuts) {
  Span *span = m->span;
  const Tried step = tried_by(m);
  const int is_last = cuts >= MOST_CUTS;
  const int may_carry = !velocity_dependent(span->scene) && !m->traces;
  const Truth carries = crossed > (may_carry ? (is_last ? 0 : MANY_SWITCHES) : INFINITY);
  Landing now = {m->left, all(0), all(0), all(0), truth(carries), all(0), all(0)};
  if (is_last && !may_carry) {
    now.missed = missed_switches(span, &step);
    gap_at(span, m->x1, m->time + m->left, 0, span->gap, span->rate);
    for (int i = 0; i < span->switches; ++i) m->taut[i] = truth(span->gap[i] > 0);
    return now;
  }
  slope_at(span, m->x1, m->time + m->left, m->taut, m->slope1);
  if (any(carries == 0)) {
    const Cut cut = first_switch(span, carries == 0, &step, all(0), m->traces ? 0 : LATE);
    now.landings = truth(carries == 0);
    now.taken = m->left * approach(span, &step, cut, step_to, m, m->x1, &now.places);
    now.switches = switch_over(span, cut.found, m->x1, m->time + now.taken, m->taut);
  }
  if (any(carries)) {
    now.carried = carry(span, carries, &step, m->x1, m->taut, m->y);
    now.switches += now.carried;
  }
  return now;
}

static void count(const Landing *landing, int i, Progress *now) {
  now->landings += (int64_t)lane(&landing->landings, i);
  now->tries += (int64_t)lane(&landing->places, i);
  now->switches += (int64_t)lane(&landing->switches, i);
  now->carries += (int64_t)lane(&landing->carries, i);
  now->carried += (int64_t)lane(&landing->carried, i);
  now->missed += (int64_t)lane(&landing->missed, i);
}

SHARED FixedSteps fixed_steps(const Settings *settings) {
  const double spacing = settings->duration / settings->outputs;
  /* The small allowance lets 0.02/0.001 be 20 steps, whatever round-off says. */
  const double between = ceil(spacing / settings->step - 1e-9);
  FixedSteps steps;
  steps.inner = between > 1 ? (int64_t)between : 1;
  steps.total = steps.inner * settings->outputs;
  steps.h = settings->duration / (double)steps.total;
  return steps;
}

#ifndef LANES
/* A step that is cut at switches, in place; `before` is room for what pulls and presses. */
static void step_through(Rk4 *m, double *x, double *before, Progress *now, Kept *kept) {
  const double rest = REST * m->left;
  for (int cuts = 0; m->left > rest; ++cuts) {
    const double crossed = take_whole(m);
    double taken = m->left;
    now->tries += 1;
    if (m->traces) memcpy(before, m->taut, m->span->switches * sizeof *before);
    if (crossed > 0) {
      const Landing landing = land(m, crossed, cuts);
      count(&landing, 0, now);
      taken = landing.taken;
    }
    memcpy(x, m->x1, m->span->states * sizeof *x);
    m->time += taken;
    m->left -= taken;
    if (m->traces) keep_step(kept, now, m->time, x, before);
  }
}

int advance_by_rk4(Span *span, const Settings *settings, Progress *now, Kept *kept, double *x, double *taut,
                   double *work) {
  const int n = span->states;
  const FixedSteps steps = fixed_steps(settings);
  double *before = work + n;
  const int is_plain = settings->method == PLAIN_RK4_METHOD;
  Rk4 method = rk4_of(span, x, work, is_plain ? 0 : taut, before + span->switches);
  int64_t done = (int64_t)round(now->time / steps.h);
  method.traces = settings->traces;
  kept->column = (int)(done / steps.inner) + 1;
  for (int tried = 0; tried < settings->budget && done < steps.total; ++tried) {
    method.time = (double)done * steps.h;
    method.left = steps.h;
    step_through(&method, x, before, now, kept);
    ++done;
    now->time = (double)done * steps.h;
    for (int i = 0; i < n; ++i)
      if (!isfinite(x[i])) {
        now->stuck = 1;
        return (int)((done - 1) / steps.inner);
      }
    if (!settings->traces) keep_step(kept, now, now->time, x, 0);
    if (done % steps.inner == 0) memcpy(next_output(kept), x, n * sizeof *x);
  }
  return (int)(done / steps.inner);
}
#endif
