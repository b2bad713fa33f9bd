/* Adaptive steps of order 8 by Dormand and Prince, which end at switches: of one run, and of those in
   lanes, each with its own time and step.

   Switches in a step are carried, with an error of order 4, where that takes less than a landing on each.
   The next steps are then of order 5, in half the evaluations, until some have ended otherwise. Under a
   loose tolerance steps of order 5 go across switches.

   E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.5
   (coefficients, error estimates) and II.6 (interpolant). */
#include <float.h>
#include <math.h>
#include <string.h>

#include "dop853_coefficients.h"
#include "methods.h"
#include "motion.h"

enum { STAGES = 12, MORE_STAGES = 3, SLOPES = 16, POWERS = 7, ORDER = 8, MOST_STALLS = 50 };
enum { SHORT_STAGES = 6, SHORT_ORDER = 5 };

/* Steps aim at an error of a tenth of what it may be: of order 8 by this factor. They change by these
   factors at most. */
static const double SAFETY = 0.75, LEAST = 0.2, MOST = 10;

/* After a step that is taken the next is longer by DAMPED (last / error^3)^FEEDBACK, PI control by its
   error and that of the step before, which counts as SMALLEST at least. It aims at the same error. */
static const double DAMPED = 0.832, FEEDBACK = 0.04, SMALLEST = 1e-4;

/* Steps longer than 1 / frequency err by the phase of the fastest vibration. Once one was thrown away,
   they grow by this factor at most, lest every third is. */
static const double GROWTH = 1.2;

/* A step shorter than this part of the span is lost in round-off. */
static const double SHORTEST = 10 * DBL_EPSILON;

/* The longest step times the largest frequency at the start: round-off grows from 5.9 on. Where the
   frequency is higher later, the error of a step keeps what grows below what it may be. */
static const double STABLE = 5;

/* What ending late at a switch may change of velocities, as part of what a step may err. */
static const double LATE_IMPULSE = 0.003;

/* What a path from the ends of a step errs of positions, and times the step of velocities, at most along
   it: so many times what the embedded order 5 errs of positions, at the leading order, h^6. */
static const double PATH_OF_POSITIONS = 1.61, PATH_OF_VELOCITIES = 5.52;

/* What switches that are carried err is of order 4 in the step. So much of what they change by moving
   the nodes, times h^2 and h, is what they may err of positions and velocities: half of what all of it
   would be that is not added. */
static const double OF_POSITIONS = 1. / 24, OF_VELOCITIES = 1. / 6;
enum { CARRY_ORDER = 4 };

/* So many steps of order 5 follow one whose switches are carried, or that is too long for it. */
enum { SHORT_FOLLOWING = 2 };

/* Under a loose tolerance a step of order 8 with switches in it is thrown away, and steps of order 5 go
   across them: each stage finds what pulls and presses in its state, as rk4_plain does. Where forces are
   continuous at their borders a step then errs by their kinks, which its error estimate tells. They add
   up along a motion: the estimate counts so many times. The first of these steps is such a part of the
   one that is thrown away, and so many follow one with a switch. */
static const double ACROSS = 10, FIRST_ACROSS = 0.25;
enum { ACROSS_FOLLOWING = 20 };

/* How far a motion is, what it has counted, and the step that it tries: numbers alone, so that runs
   can go from lane to lane. */
typedef struct {
  Number time, step, longest; /* s: the step to try next, and the longest */
  Number stuck, stalls, done; /* whether it can go on, switches in a row, outputs that are reached */
  Number tries, rejections, landings, approaches, switches, interpolants, carries, carried;
  Number short_tries, short_left;          /* tries and approaches of order 5, and how many are to follow */
  Number last;                             /* the error of the step before, if it was of order 8 */
  Number h, error, factor;                 /* length and error of the step, and how much longer the next is */
  Number crossed, taken;                   /* how many strings may switch in it; what of it is taken, s */
  Number is_inside, is_carried, is_across; /* ends on its interpolant; switches are carried, or crossed */
} Adaptive;

enum { ADAPTIVE_NUMBERS = sizeof(Adaptive) / sizeof(Number) };

/* Takes the state at the next output of the runs in which it is due; `done` are before it. */
typedef void Emit(void *by, Truth due, Number done, const Number *x);

typedef struct {
  Span *span;
  const Settings *settings;
  Adaptive *now;
  Number *x, *slope, *taut; /* where the motion is */
  const Number *scale;      /* what a step may err */
  Number *x1, *K;           /* end of the step, slopes of its stages */
  /* What pulls in the stages, what pulled at the start of the step; memory of all runs in turn. */
  const Number *pulls;
  Number *started, *y, *interpolant, *end, *pulling, *defect, *short_end, *short_slopes;
  Number reach; /* h of the interpolant */
  Emit *emit;
  void *emitter;
} Dop853;

/* Memory that is shared by all runs, and the slopes that a step leaves. */
enum { DOP853_STATES = POWERS + SHORT_STAGES + 5, DOP853_TAUTS = 2, STEP_SLOPES = STAGES + 1 };

/* A method without a motion, in memory of DOP853_STATES and DOP853_TAUTS. */
static Dop853 dop853_of(Span *span, const Settings *settings, Emit *emit, void *emitter, Number *work) {
  const int n = span->states, m = span->switches;
  Dop853 method;
  memset(&method, 0, sizeof method);
  method.span = span;
  method.settings = settings;
  method.y = work;
  method.interpolant = method.y + n;
  method.end = method.interpolant + POWERS * n;
  method.defect = method.end + n;
  method.short_end = method.defect + n;
  method.short_slopes = method.short_end + n;
  method.started = method.short_slopes + (SHORT_STAGES + 1) * n;
  method.pulling = method.started + m;
  method.emit = emit;
  method.emitter = emitter;
  return method;
}

/* The sums of a stage, in wide registers. */
#define SUM(k)                                                                                               \
  WIDE static void sum_##k(const Number *restrict x, Number h, const Number *restrict K, Number *restrict y, \
                           int n) {                                                                          \
    for (int i = 0; i < n; ++i) y[i] = x[i] + h * STAGE_##k;                                                 \
  }
SUM(1)
SUM(2)
SUM(3)
SUM(4)
SUM(5)
SUM(6)
SUM(7)
SUM(8)
SUM(9)
SUM(10)
SUM(11)
SUM(13)
SUM(14)
SUM(15)
#define STAGE(k)                                                            \
  do {                                                                      \
    sum_##k(x, h, K, y, n);                                                 \
    slope_at(m->span, y, m->now->time + TIME_##k * h, m->pulls, K + k * n); \
  } while (0)

WIDE static void sum_end(const Number *restrict x, Number h, const Number *restrict K, Number *restrict y,
                         int n) {
  for (int i = 0; i < n; ++i) y[i] = x[i] + h * END;
}

/* A step of length h, whose first slope is known. */
static void step_of(Dop853 *m, Number h, Number *x1) {
  const int n = m->span->states;
  const Number *x = m->x;
  Number *K = m->K, *y = m->y;
  memcpy(K, m->slope, n * sizeof *K);
  STAGE(1);
  STAGE(2);
  STAGE(3);
  STAGE(4);
  STAGE(5);
  STAGE(6);
  STAGE(7);
  STAGE(8);
  STAGE(9);
  STAGE(10);
  STAGE(11);
  sum_end(x, h, K, x1, n);
  restore_bars(m->span, x1, m->now->time + h);
}

#define SHORT(k)                                                                               \
  WIDE static void short_sum_##k(const Number *restrict x, Number h, const Number *restrict K, \
                                 Number *restrict y, int n) {                                  \
    for (int i = 0; i < n; ++i) y[i] = x[i] + h * SHORT_STAGE_##k;                             \
  }
SHORT(1)
SHORT(2)
SHORT(3)
SHORT(4)
SHORT(5)
#define SHORT_STAGE(k)                                                         \
  do {                                                                         \
    short_sum_##k(x, h, K, y, n);                                              \
    slope_at(m->span, y, m->now->time + SHORT_TIME_##k * h, pulls, K + k * n); \
  } while (0)

WIDE static void short_sum_end(const Number *restrict x, Number h, const Number *restrict K,
                               Number *restrict y, int n) {
  for (int i = 0; i < n; ++i) y[i] = x[i] + h * SHORT_END;
}

/* Whether steps of order 5 go across switches. The force of a damped string jumps as it goes taut. */
static int goes_across(const Dop853 *m) {
  const Scene *s = m->span->scene;
  return lane(m->scale, 0) > m->settings->loose * s->size && !s->damped && !m->settings->traces;
}

/* A step of order 5. */
static void short_step_of(Dop853 *m, Number h, Number *x1) {
  const int n = m->span->states;
  const Number *x = m->x, *pulls = goes_across(m) ? 0 : m->pulls;
  Number *K = m->short_slopes, *y = m->y;
  memcpy(K, m->slope, n * sizeof *K);
  SHORT_STAGE(1);
  SHORT_STAGE(2);
  SHORT_STAGE(3);
  SHORT_STAGE(4);
  SHORT_STAGE(5);
  short_sum_end(x, h, K, x1, n);
  restore_bars(m->span, x1, m->now->time + h);
}

/* The root mean square of the error over the state, as part of what it may be. */
WIDE static Number error_of(const Number *restrict K, const Number *restrict scale, Number h, int n) {
  Number fifth = all(0), third = all(0), below;
  for (int i = 0; i < n; ++i) {
    const Number a = FIFTH / scale[i], b = THIRD / scale[i];
    fifth += a * a;
    third += b * b;
  }
  below = root((fifth + 0.01 * third) * (double)n);
  /* Nothing moves: no error. Squares that overflow: a step far too long. */
  return choice((below > 0) & (below < INFINITY), h * fifth / below, below);
}

/* The same of a step of order 5, whose last slope is that at its end. */
WIDE static Number short_error_of(const Number *restrict K, const Number *restrict scale, Number h, int n) {
  Number sum = all(0);
  for (int i = 0; i < n; ++i) {
    const Number a = SHORT_ERROR / scale[i];
    sum += a * a;
  }
  return h * root(sum / (double)n);
}

/* What a path from the ends of the step errs, as error_of. */
WIDE static Number path_error_of(const Number *restrict K, const Number *restrict scale, Number h, int n) {
  Number sum = all(0);
  for (int i = 0; i < n / 2; ++i) {
    const Number off = FIFTH, q = PATH_OF_POSITIONS * h * off / scale[i];
    const Number v = PATH_OF_VELOCITIES * off / scale[n / 2 + i];
    sum += q * q + v * v;
  }
  return root(sum / (double)n);
}

static Number factor_of(Number error, double order) {
  const Number wanted = SAFETY * power(larger(error, all(1e-16)), -1 / order);
  return smaller(larger(wanted, all(LEAST)), all(MOST));
}

/* How much longer than a step of order 8 that is taken the next is. */
static Number damped_factor_of(const Adaptive *now) {
  const Number error = larger(now->error, all(1e-16)), last = larger(now->last, all(SMALLEST));
  const Number wanted = DAMPED * power(last / (error * error * error), FEEDBACK);
  const Number slow = larger(now->longest / (STABLE * now->h), all(GROWTH));
  const Number most = choice(now->rejections > 0, smaller(slow, all(MOST)), all(MOST));
  return smaller(larger(wanted, all(LEAST)), most);
}

/* What carried switches err, as error_of a step, by what they change of xdot by moving the nodes. */
static Number carry_error(const Number *defect, const Number *scale, Number h, int n) {
  Number sum = all(0);
  for (int i = 0; i < n / 2; ++i) {
    const Number a = defect[n / 2 + i];
    const Number q = OF_POSITIONS * h * h * a / scale[i], v = OF_VELOCITIES * h * a / scale[n / 2 + i];
    sum += q * q + v * v;
  }
  return root(sum / (double)n);
}

WIDE static void dense(const Number *restrict x, const Number *restrict x1, const Number *restrict K,
                       Number h, Number *restrict to, int n) {
  const Number *f = K, *f1 = K + STAGES * n;
  for (int i = 0; i < n; ++i) {
    const Number step = x1[i] - x[i];
    to[i] = step;
    to[n + i] = h * f[i] - step;
    to[2 * n + i] = 2 * step - h * (f1[i] + f[i]);
  }
  for (int i = 0; i < n; ++i) {
    to[3 * n + i] = h * DENSE_0;
    to[4 * n + i] = h * DENSE_1;
    to[5 * n + i] = h * DENSE_2;
    to[6 * n + i] = h * DENSE_3;
  }
}

/* The coefficients of the interpolant of a step of length h to x1. */
static void interpolate(Dop853 *m, Number h) {
  const int n = m->span->states;
  const Number *x = m->x;
  Number *K = m->K, *y = m->y;
  STAGE(13);
  STAGE(14);
  STAGE(15);
  dense(x, m->x1, K, h, m->interpolant, n);
  m->reach = h;
}

/* The state on the interpolant at a part of it. */
WIDE static void within(const Number *restrict x, const Number *restrict interpolant, Number part,
                        Number *restrict to, int n) {
  for (int i = 0; i < n; ++i) {
    Number value = all(0);
    for (int k = POWERS - 1; k >= 0; --k)
      value = (value + interpolant[k * n + i]) * (k % 2 ? 1 - part : part);
    to[i] = x[i] + value;
  }
}

static void place_inside(void *by, Number part, Number *x1) {
  Dop853 *m = by;
  within(m->x, m->interpolant, part * m->now->h / m->reach, x1, m->span->states);
  restore_bars(m->span, x1, m->now->time + part * m->now->h);
}

/* A step of the order that is due. */
static void step_by_order(Dop853 *m, Number h, Number *x1) {
  const int n = m->span->states;
  const Truth is_short = m->now->short_left > 0;
  if (any(is_short == 0)) step_of(m, h, x1);
  if (!any(is_short)) return;
  short_step_of(m, h, m->short_end);
  for (int i = 0; i < n; ++i) x1[i] = choice(is_short, m->short_end[i], x1[i]);
}

static void place_by_step(void *by, Number part, Number *x1) {
  Dop853 *m = by;
  step_by_order(m, part * m->now->h, x1);
}

/* What the interpolant errs at a part of the step, as part of the error estimate. */
static Number interpolant_error(Number part) {
  Number value = all(0);
  for (int k = sizeof INTERPOLANT_ERROR / sizeof(double) - 1; k >= 0; --k)
    value = INTERPOLANT_ERROR[k] + part * value;
  return positive(value);
}

/* Evaluations of the equation so far. A landing takes a new start; switches that are carried another
   slope, whether they are or not, and a step that ends sooner for them one more. */
static Number evaluations_of(const Adaptive *now) {
  return 1.0 + (double)STAGES * (now->tries + now->approaches) -
         (double)(STAGES - SHORT_STAGES) * now->short_tries + (now->landings + now->carries) +
         (double)MORE_STAGES * now->interpolants;
}

static Tried tried_step(const Dop853 *m) {
  const Tried step = {m->x,    m->x1,        m->slope, m->K + STAGES * m->span->states,
                      m->taut, m->now->time, m->now->h};
  return step;
}

/* Tries a step. Returns which are good, and how many strings may switch in them; the others are
   thrown away, and the next is shorter. */
static Truth try_step(Dop853 *m) {
  const int n = m->span->states;
  const double duration = m->settings->duration;
  Adaptive *now = m->now;
  const Number h = smaller(smaller(now->step, now->longest), duration - now->time);
  const int is_loose = goes_across(m);
  const Truth is_short = now->short_left > 0;
  Number *slope1 = m->K + STAGES * n, *short_slope1 = m->short_slopes + SHORT_STAGES * n;
  Truth good, bad;
  m->pulls = m->taut;
  memcpy(m->started, m->taut, m->span->switches * sizeof *m->taut);
  step_by_order(m, h, m->x1);
  now->h = now->taken = h;
  now->is_inside = now->is_carried = now->crossed = all(0);
  now->is_across = truth(is_short) * (double)is_loose;
  now->tries += 1;
  if (any(is_short == 0)) {
    now->error = error_of(m->K, m->scale, h, n);
    now->factor = damped_factor_of(now);
  }
  if (any(is_short)) {
    Number error;
    slope_at(m->span, m->x1, now->time + h, is_loose ? 0 : m->taut, short_slope1);
    error = short_error_of(m->short_slopes, m->scale, h, n) * (is_loose ? ACROSS : 1);
    now->error = choice(is_short, error, now->error);
    now->factor = choice(is_short, factor_of(error, SHORT_ORDER), now->factor);
    now->short_tries += truth(is_short);
  }
  good = now->error < 1;
  bad = good == 0;
  if (any(bad)) {
    const Number wanted = choice(is_short, now->factor, factor_of(now->error, ORDER));
    const Number shorter = choice(now->error < INFINITY, smaller(wanted, all(1)), all(LEAST / 2));
    now->step = choice(bad, h * shorter, now->step);
    now->rejections += truth(bad);
    now->stuck = choice(bad, truth(now->step < SHORTEST * duration), now->stuck);
  }
  if (any(good)) {
    const Tried step = tried_step(m);
    const Truth searched = good & (now->is_across == 0);
    if (any(good & (is_short == 0))) slope_at(m->span, m->x1, now->time + h, m->taut, slope1);
    for (int i = 0; i < n; ++i) slope1[i] = choice(is_short, short_slope1[i], slope1[i]);
    if (any(searched)) now->crossed = only(searched, crossings(m->span, &step));
  }
  if (is_loose && any(now->crossed > 0)) {
    const Truth thrown = now->crossed > 0;
    now->step = choice(thrown, FIRST_ACROSS * h, now->step);
    now->short_left = choice(thrown, all(ACROSS_FOLLOWING), now->short_left);
    now->rejections += truth(thrown);
    now->crossed = all(0);
    good &= thrown == 0;
  }
  return good;
}

/* Finds what pulls and presses at the ends of steps across switches, and counts what has changed. */
static void look_back(Dop853 *m, Truth meant) {
  Span *span = m->span;
  Adaptive *now = m->now;
  Number count = all(0);
  gap_at(span, m->x1, now->time + now->h, 0, span->gap, velocity_dependent(span->scene) ? span->rate : 0);
  for (int i = 0; i < span->switches; ++i) {
    const Number pulls = truth(span->gap[i] > 0);
    count += truth(meant & (pulls != m->taut[i]));
    m->taut[i] = choice(meant, pulls, m->taut[i]);
  }
  now->switches += count;
  now->short_left = choice(count > 0, all(ACROSS_FOLLOWING + 1), now->short_left);
}

/* Writes the outputs up to a time, on the interpolant or on the path from the ends of the step. */
static void write_outputs_until(Dop853 *m, Truth meant, Number until, int is_on_path) {
  const double outputs = m->settings->outputs, spacing = m->settings->duration / outputs;
  Adaptive *now = m->now;
  for (;;) {
    const Number next = (now->done + 1) * spacing, past = next - now->time;
    const Truth due = meant & (now->done + 1 < outputs) & (next <= until);
    if (!any(due)) return;
    if (is_on_path) on_path(m->span, now->taken, past / now->taken, m->y);
    else within(m->x, m->interpolant, past / m->reach, m->y, m->span->states);
    restore_bars(m->span, m->y, next);
    m->emit(m->emitter, due, now->done, m->y);
    now->done += truth(due);
  }
}

/* Writes the outputs that a step passes, on a path where that is good enough. */
static void write_passed(Dop853 *m, Truth meant, Number after) {
  const double outputs = m->settings->outputs, spacing = m->settings->duration / outputs;
  Adaptive *now = m->now;
  const Number until = after * (1 + 2e-14);
  const Truth due =
      meant & (now->done + 1 < outputs) & ((now->done + 1) * spacing <= until) & (after > now->time);
  const Truth carried = due & (now->is_carried != 0), inside = due & (now->is_inside != 0);
  const Truth others = due & (carried == 0) & (inside == 0);
  if (any(carried)) {
    const Tried step = {m->x, m->x1, m->slope, m->defect, 0, now->time, now->taken};
    make_path(m->span, &step);
    write_outputs_until(m, carried, until, 1);
  }
  if (any(inside)) {
    m->reach = now->h;
    write_outputs_until(m, inside, until, 0);
  }
  if (any(others)) {
    const double most = m->settings->path;
    const Number off = most > 0 ? path_error_of(m->K, m->scale, now->taken, m->span->states) : all(most);
    const Truth on_path = others & ((now->short_left > 0) | (off < most));
    const Truth on_interpolant = others & (on_path == 0);
    Number *slope1 = m->K + STAGES * m->span->states;
    m->pulls = m->started;
    if (any(others & (now->crossed > 0)))
      slope_at(m->span, m->x1, now->time + now->taken, m->started, slope1);
    if (any(on_path)) {
      const Tried step = {m->x, m->x1, m->slope, slope1, 0, now->time, now->taken};
      make_path(m->span, &step);
      write_outputs_until(m, on_path, until, 1);
    }
    if (any(on_interpolant)) {
      interpolate(m, now->taken);
      now->interpolants += truth(on_interpolant);
      write_outputs_until(m, on_interpolant, until, 0);
    }
    m->pulls = m->taut;
  }
}

/* Goes to the ends of steps. */
static void end_steps(Dop853 *m, Truth meant) {
  const int n = m->span->states;
  const double duration = m->settings->duration;
  Adaptive *now = m->now;
  const Truth crossed = meant & (now->crossed > 0), carried = meant & (now->is_carried != 0);
  const Truth landed = crossed & (carried == 0), across = meant & (now->is_across != 0);
  const Number after = choice(now->taken >= duration - now->time, all(duration), now->time + now->taken);
  const Number *slope1 = m->K + STAGES * n;
  write_passed(m, meant, after);
  if (any(across)) look_back(m, across);
  for (int i = 0; i < n; ++i) m->x[i] = choice(meant, m->x1[i], m->x[i]);
  now->step = choice(meant, now->h * choice(landed, smaller(now->factor, all(1)), now->factor), now->step);
  now->last = choice(meant, only(now->short_left == 0, now->error), now->last);
  now->landings += truth(crossed);
  now->short_left = choice(meant, choice(carried, all(SHORT_FOLLOWING), larger(now->short_left - 1, all(0))),
                           now->short_left);
  if (any(landed)) {
    const Number stalls = only(now->taken < SHORTEST * duration, now->stalls + 1);
    now->stalls = choice(landed, stalls, now->stalls);
    now->stuck = choice(landed, truth(stalls > (double)MOST_STALLS), now->stuck);
    slope_at(m->span, m->x, after, m->taut, m->y);
  }
  for (int i = 0; i < n; ++i) m->slope[i] = choice(meant, slope1[i], m->slope[i]);
  if (any(crossed))
    for (int i = 0; i < n; ++i)
      m->slope[i] = choice(landed, m->y[i], choice(carried, m->defect[i], m->slope[i]));
  now->time = choice(meant, after, now->time);
  if (any(meant & (now->time >= duration))) {
    const Truth over = meant & (now->time >= duration);
    const Number outputs = all(m->settings->outputs);
    m->emit(m->emitter, over, outputs - 1, m->x);
    now->done = choice(over, outputs, now->done);
  }
}

/* Adds to the ends of steps what their switches change. Returns which steps are too long for it, and
   leaves how much shorter they are to be: where shorter ones take less than a landing on each switch. */
static Truth carry_switches(Dop853 *m, Truth meant) {
  const int n = m->span->states, switches = m->span->switches;
  Adaptive *now = m->now;
  const Tried step = tried_step(m);
  Number count, off, factor;
  Truth good, too_long;
  memcpy(m->end, m->x1, n * sizeof *m->end);
  memcpy(m->pulling, m->taut, switches * sizeof *m->taut);
  count = carry(m->span, meant, &step, m->end, m->pulling, m->defect);
  off = carry_error(m->defect, m->scale, now->h, n);
  factor = factor_of(off, CARRY_ORDER);
  good = meant & (off < 1);
  too_long = meant & (good == 0) & (2 < now->crossed * factor);
  now->carries += truth(meant);
  now->factor = choice(too_long, smaller(factor, all(SAFETY)), now->factor);
  if (any(good)) {
    for (int i = 0; i < switches; ++i) m->taut[i] = choice(good, m->pulling[i], m->taut[i]);
    slope_at(m->span, m->end, now->time + now->h, m->taut, m->defect);
    for (int i = 0; i < n; ++i) m->x1[i] = choice(good, m->end[i], m->x1[i]);
    now->is_carried = truth(good);
    now->factor = choice(good, smaller(now->factor, factor), now->factor);
    now->switches += only(good, count);
    now->carried += only(good, count);
  }
  return too_long;
}

/* Ends steps of order 5 sooner, by their factors: on the path from their ends, which errs no more than
   they do. One more slope is all that this takes. */
static void shorten(Dop853 *m, Truth meant) {
  const int n = m->span->states;
  Adaptive *now = m->now;
  const Tried whole = tried_step(m);
  const Number part = now->factor, until = now->time + part * now->h;
  const Number less = now->error * part * part * part * part * part;
  Number *slope1 = m->K + STAGES * n;
  Tried shorter;
  make_path(m->span, &whole);
  on_path(m->span, now->h, part, m->y);
  restore_bars(m->span, m->y, until);
  slope_at(m->span, m->y, until, m->started, m->end);
  for (int i = 0; i < n; ++i) m->x1[i] = choice(meant, m->y[i], m->x1[i]);
  for (int i = 0; i < n; ++i) slope1[i] = choice(meant, m->end[i], slope1[i]);
  now->h = choice(meant, part * now->h, now->h);
  now->taken = choice(meant, now->h, now->taken);
  now->error = choice(meant, less, now->error);
  now->factor = choice(meant, factor_of(less, SHORT_ORDER), now->factor);
  now->carries += truth(meant);
  shorter = tried_step(m);
  now->crossed = choice(meant, crossings(m->span, &shorter), now->crossed);
}

/* Ends steps where they are cut; returns the number of places that were tried. */
static Number go_to(Dop853 *m, const Tried *step, Cut cut, Truth meant, Place *place) {
  Adaptive *now = m->now;
  Number fraction, places;
  cut.found = meant;
  fraction = approach(m->span, step, cut, place, m, m->end, &places);
  now->taken = choice(meant, now->h * fraction, now->taken);
  for (int i = 0; i < m->span->states; ++i) m->x1[i] = choice(meant, m->end[i], m->x1[i]);
  return places;
}

/* Ends steps at their first switch, if one is found: on the interpolant where that is good enough,
   else by true steps. */
static void land_on_first(Dop853 *m, Truth meant) {
  const int n = m->span->states, traces = m->settings->traces;
  Adaptive *now = m->now;
  const Tried step = tried_step(m);
  const Number reach = now->longest / STABLE;
  const Number allowed = 2 * LATE_IMPULSE * m->scale[n - 1] * (reach * reach);
  Cut cut = first_switch(m->span, meant, &step, traces ? all(0) : allowed, 0);
  const Truth is_cut = cut.found, is_long = now->short_left == 0;
  Truth inside = is_cut & is_long & (now->error * interpolant_error(cut.part) < m->settings->smooth);
  Truth by_step;
  if (traces) inside = is_cut & (is_cut == 0);
  by_step = is_cut & (inside == 0);
  now->is_inside = truth(inside);
  if (any(inside)) {
    interpolate(m, now->h);
    now->interpolants += truth(inside);
    go_to(m, &step, cut, inside, place_inside);
  }
  if (any(by_step)) {
    const Number places = go_to(m, &step, cut, by_step, place_by_step);
    now->approaches += places;
    now->short_tries += only(is_long == 0, places);
  }
  if (any(is_cut)) now->switches += switch_over(m->span, is_cut, m->x1, now->time + now->taken, m->taut);
}

/* Ends steps that carry their switches, or shorter ones where these err too much. Returns which are
   ended, and which are thrown away. */
static Truth end_carried(Dop853 *m, Truth meant, Truth *thrown) {
  Adaptive *now = m->now;
  Truth ended, shorter;
  *thrown = carry_switches(m, meant);
  ended = meant & (now->is_carried != 0);
  if (any(ended)) end_steps(m, ended);
  shorter = *thrown & (now->short_left > 0);
  if (any(shorter)) {
    Truth good;
    shorten(m, shorter);
    *thrown = (*thrown & (shorter == 0)) | carry_switches(m, shorter & (now->crossed > 0));
    good = shorter & ((now->is_carried != 0) | (now->crossed == 0));
    if (any(good)) end_steps(m, good);
    ended |= good;
  }
  now->step = choice(*thrown, now->h * now->factor, now->step);
  now->short_left = choice(*thrown, all(SHORT_FOLLOWING), now->short_left);
  now->rejections += truth(*thrown);
  return ended;
}

/* Ends steps in which strings may switch, of which `crossings` was asked last; returns those that are
   not thrown away. */
static Truth pass_switches(Dop853 *m, Truth meant) {
  const int may_carry = !velocity_dependent(m->span->scene) && !m->settings->traces;
  const Number few = choice(m->now->short_left > 0, all(0), all(MANY_SWITCHES));
  const Truth many = meant & (m->now->crossed > (may_carry ? few : all(INFINITY)));
  Truth thrown = many & (many == 0), ended = thrown, landing;
  if (any(many)) ended = end_carried(m, many, &thrown);
  landing = meant & (thrown == 0) & (ended == 0);
  if (any(landing)) {
    land_on_first(m, landing);
    end_steps(m, landing);
  }
  return meant & (thrown == 0);
}

/* The same between two calls, in one lane. */
static void take_up(const Progress *from, double longest, double done, int i, Adaptive *to) {
  const double numbers[] = {from->time,       from->step,       longest,
                            from->stuck,      from->stalls,     done,
                            from->tries,      from->rejections, from->landings,
                            from->approaches, from->switches,   from->interpolants,
                            from->carries,    from->carried,    from->short_tries,
                            from->short_left, from->last};
  Number *place = (Number *)to;
  for (int k = 0; k < ADAPTIVE_NUMBERS; ++k) put(0, place + k, i);
  for (size_t k = 0; k < sizeof numbers / sizeof *numbers; ++k) put(numbers[k], place + k, i);
}

static void put_down(const Adaptive *from, int i, Progress *to) {
  to->time = lane(&from->time, i);
  to->step = lane(&from->step, i);
  to->stuck = (int32_t)lane(&from->stuck, i);
  to->stalls = (int32_t)lane(&from->stalls, i);
  to->tries = (int64_t)lane(&from->tries, i);
  to->rejections = (int64_t)lane(&from->rejections, i);
  to->landings = (int64_t)lane(&from->landings, i);
  to->approaches = (int64_t)lane(&from->approaches, i);
  to->switches = (int64_t)lane(&from->switches, i);
  to->interpolants = (int64_t)lane(&from->interpolants, i);
  to->carries = (int64_t)lane(&from->carries, i);
  to->carried = (int64_t)lane(&from->carried, i);
  to->short_tries = (int64_t)lane(&from->short_tries, i);
  to->short_left = (int32_t)lane(&from->short_left, i);
  to->last = lane(&from->last, i);
}

#ifndef LANES
double tc_evaluations(const Progress *progress) {
  Adaptive now;
  take_up(progress, 0, 0, 0, &now);
  return evaluations_of(&now);
}

static void emit_to_kept(void *by, Truth due, Number done, const Number *x) {
  Kept *kept = by;
  (void)due;
  (void)done;
  memcpy(next_output(kept), x, kept->n * sizeof *x);
}

int advance_by_dop853(Span *span, const Settings *settings, Progress *now, Kept *kept, double *x,
                      double *slope, double *taut, double *work) {
  const double spacing = settings->duration / settings->outputs;
  const double done = floor(now->time / spacing * (1 + 1e-14));
  Adaptive motion;
  Dop853 method = dop853_of(span, settings, emit_to_kept, kept, work + (1 + SLOPES) * (size_t)span->states);
  take_up(now, settings->longest, done, 0, &motion);
  method.now = &motion;
  method.x = x;
  method.slope = slope;
  method.taut = taut;
  method.scale = settings->scale;
  method.x1 = work;
  method.K = work + span->states;
  kept->column = (int)done + 1;
  span->goes_on = 0;
  for (int tried = 0; tried < settings->budget && motion.time < settings->duration && motion.stuck == 0;
       ++tried) {
    if (evaluations_of(&motion) >= settings->limit) break;
    if (!try_step(&method)) continue;
    span->goes_on = motion.crossed == 0 && motion.is_across == 0;
    if (motion.crossed == 0) end_steps(&method, 1);
    else if (pass_switches(&method, 1)) span->goes_on = motion.is_carried != 0;
    else continue;
    keep_step(kept, now, motion.time, x, method.started);
  }
  put_down(&motion, 0, now);
  return (int)motion.done;
}
#endif
