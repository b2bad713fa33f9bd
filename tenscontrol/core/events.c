/* Location of switches: steps end where a string goes slack or taut, or a contact opens or closes.

   A step across such a border loses the order of every method. So a step is taken with the strings
   that pull as they are at its start. If one of them changes within, the step is cut there. What is
   said of strings holds for contacts. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "kernels.h"
#include "motion.h"

/* The search: samples, how often it zooms in on those next to the first that is out, chords on the
   interpolant, and the most true steps to the place found. With ground, a node that dips in by
   little stays a small part of a step. */
enum { SAMPLES = 6, ZOOMS = 2, ZOOMS_ON_GROUND = 7, CHORDS = 6, POLISHES = 8 };

/* A gap is flat beyond the border where it falls by less than this part of its slope before. */
static const double FLAT = 0.1;

/* How late a step may end at most, as part of it. */
static const double MOST_LATE = 1e-3;

int velocity_dependent(const Scene *s) {
  if (s->damped) return 1;
  for (int i = 0; i < s->grounds; ++i)
    if (s->ground[i].count && (s->ground[i].damping > 0 || s->ground[i].friction > 0)) return 1;
  return 0;
}

/* Lengths that round-off in each gap is a part of, m, at a time: rest lengths, and the size. */
const double *gap_scales(Span *span, double time) {
  const Scene *s = span->scene;
  const Input input = input_at(span, time);
  memcpy(span->scale, input.strings, s->slacking * sizeof(double));
  for (int i = s->slacking; i < span->switches; ++i) span->scale[i] = s->size;
  return span->scale;
}

static double least_of(const double *of, int count) {
  double least = INFINITY;
  for (int i = 0; i < count; ++i) least = smaller(of[i], least);
  return least;
}

/* Whether the tangents room0 - out t and room1 - back (h - t) meet below zero. */
static int meet_outside(double room0, double room1, double out, double back, double h) {
  return out > 0 && back > 0 && back * room0 + out * room1 < out * back * h;
}

static double sign_of(double taut) { return 2 * taut - 1; }

/* Marks strings that may switch within a step with 1, and with 2 those that come back in; returns how
   many they are. */
static int crossed_by(Span *span, const Tried *step, double *marks) {
  const int m = span->switches, n = span->states, half = n / 2;
  const double h = step->h, *scale;
  double *gap0 = span->rooms, *rate0 = span->inside, *gap1 = span->outside, *rate1 = span->within;
  int count = 0;
  double square = 0;
  for (int i = 0; i < n; ++i) square += step->x1[i] * step->x1[i];
  memset(marks, 0, m * sizeof *marks);
  if (!(square < INFINITY)) return 0; /* a state that is not finite is not searched */
  gap_at(span, step->x, step->time, gap0, rate0);
  gap_at(span, step->x1, step->time + h, gap1, rate1);
  scale = gap_scales(span, step->time);
  for (int i = 0; i < m; ++i) {
    const double sign = sign_of(step->taut[i]), band = BAND * scale[i];
    const double room0 = sign * gap0[i] + band, room1 = sign * gap1[i] + band;
    if (room1 < 0 || meet_outside(room0, room1, -sign * rate0[i], sign * rate1[i], h))
      marks[i] = room1 < 0 ? 1 : 2;
  }
  if (velocity_dependent(span->scene)) {
    double *y = span->middle, *gap = span->gap, *rate = span->rate;
    const double *q = step->x, *v = q + half, *q1 = step->x1, *v1 = q1 + half;
    /* The border of a damped string has other tangents than its stretch: look at the middle. */
    double *out = span->chosen; /* whether the end is out */
    for (int i = 0; i < m; ++i) out[i] = sign_of(step->taut[i]) * gap1[i] + BAND * scale[i] < 0;
    for (int i = 0; i < half; ++i) {
      y[i] = (q[i] + q1[i]) / 2 + h / 8 * (v[i] - v1[i]);
      y[half + i] = 1.5 / h * (q1[i] - q[i]) - (v[i] + v1[i]) / 4;
    }
    gap_at(span, y, step->time + h / 2, gap, rate);
    scale = gap_scales(span, step->time);
    for (int i = 0; i < m; ++i)
      if (sign_of(step->taut[i]) * gap[i] + BAND * scale[i] < 0 && !marks[i])
        marks[i] = out[i] ? 1 : 2;
    /* A slack string pulls as soon as its stretch grows through zero, however soon the damping lets
       it go again. At rest nothing is damped, and the gap is the stretch. */
    memcpy(y, q, half * sizeof *y);
    memset(y + half, 0, half * sizeof *y);
    gap_at(span, y, step->time, gap, rate);
    memcpy(y, q1, half * sizeof *y);
    gap_at(span, y, step->time + h, span->rooms, rate);
    scale = gap_scales(span, step->time);
    for (int i = 0; i < m; ++i) {
      const double room0 = BAND * scale[i] - gap[i], room1 = BAND * scale[i] - span->rooms[i];
      const int dips = meet_outside(room0, room1, rate0[i], -rate1[i], h);
      if (step->taut[i] == 0 && room0 > 0 && (room1 < 0 || dips) && !marks[i])
        marks[i] = out[i] ? 1 : 2;
    }
  }
  for (int i = 0; i < m; ++i) count += marks[i] != 0;
  return count;
}

int crossings(Span *span, const Tried *step) { return crossed_by(span, step, span->leaving); }

/* Switches in a step that is not cut: a string that is out at the end has switched once, at least;
   one that comes back in, twice. */
int missed_switches(Span *span, const Tried *step) {
  int count = 0;
  crossed_by(span, step, span->leaving);
  for (int i = 0; i < span->switches; ++i) count += (int)span->leaving[i];
  return count;
}

/* The polynomials of degree 5 with positions, velocities and accelerations at both ends. */
void make_path(Span *span, const Tried *step) {
  const int half = span->states / 2;
  const double h = step->h, *x = step->x, *x1 = step->x1;
  double *c = span->coefficients;
  for (int i = 0; i < half; ++i) {
    const double q0 = x[i], v0 = h * x[half + i], q1 = x1[i], v1 = h * x1[half + i];
    const double a0 = h * h * step->slope[half + i], a1 = h * h * step->slope1[half + i];
    const double d = q1 - q0 - v0 - a0 / 2, e = v1 - v0 - a0, f = a1 - a0;
    c[i] = q0;
    c[half + i] = v0;
    c[2 * half + i] = a0 / 2;
    c[3 * half + i] = 10 * d - 4 * e + f / 2;
    c[4 * half + i] = -15 * d + 7 * e - f;
    c[5 * half + i] = 6 * d - 3 * e + f / 2;
  }
}

void on_path(const Span *span, double h, double part, double *x) {
  const int half = span->states / 2;
  const double *c = span->coefficients;
  for (int i = 0; i < half; ++i) {
    double q = 0, v = 0;
    for (int k = 5; k >= 0; --k) {
      q = q * part + c[k * half + i];
      if (k) v = v * part + k * c[k * half + i];
    }
    x[i] = q;
    x[half + i] = v / h;
  }
}

/* Room of each string up to its border at a part of a step, m. */
static void rooms_at(Span *span, const Tried *step, double part, double *rooms) {
  const double *scale;
  double *y = span->middle;
  on_path(span, step->h, part, y);
  gap_at(span, y, step->time + part * step->h, span->gap, span->rate);
  scale = gap_scales(span, step->time);
  for (int i = 0; i < span->switches; ++i)
    rooms[i] = sign_of(step->taut[i]) * span->gap[i] + BAND * scale[i];
}

/* Closes in on the first sample that is out, else on the lowest; whether one is out. */
static int zoom(Span *span, const Tried *step, double *low, double *high) {
  const double width = (*high - *low) / SAMPLES;
  double least = INFINITY;
  int first = 0, last = 1;
  for (int j = 0; j < SAMPLES && !(least < 0); ++j) {
    double lowest;
    rooms_at(span, step, *low + (j + 1) * width, span->rooms);
    lowest = least_of(span->rooms, span->switches);
    if (lowest < least) {
      first = j;
      last = lowest < 0 || j + 2 > SAMPLES ? j + 1 : j + 2;
      least = lowest;
    }
  }
  *high = *low + last * width;
  *low += first * width;
  return least < 0;
}

static double mean_of_chosen(const Span *span, const double *of) {
  double sum = 0, count = 0;
  for (int i = 0; i < span->switches; ++i) {
    sum += span->chosen[i] * of[i];
    count += span->chosen[i];
  }
  return sum / count;
}

/* The first switch within a step that is crossed, on its interpolant.

   A step that ends past the border by d, where the gap shrinks at r, leaves an impulse of d^2/2r
   times the stiffness, as a force that does not depend on velocities is continuous there. So it may
   end past the border by at most sqrt(allowed r), or the part `least` of the length of the string
   if that is more, and never before it: the next step would be wrong. Other forces jump. */
Cut first_switch(Span *span, const Tried *step, double allowed, double least) {
  const int m = span->switches;
  const double *scale, h = step->h;
  double *inside = span->inside, *outside = span->outside, *chosen = span->chosen;
  double low = 0, high = 1, near, size, first = INFINITY, edge, before, after, late = 0, lowest;
  double left, right, over, under;
  Cut cut = {0, 0, 0, 0};
  make_path(span, step);
  for (int i = 0; i < (span->scene->grounds ? ZOOMS_ON_GROUND : ZOOMS); ++i)
    cut.found = zoom(span, step, &low, &high);
  rooms_at(span, step, low, inside);
  rooms_at(span, step, high, outside);
  scale = gap_scales(span, step->time);
  size = least_of(scale, m);
  near = 0.5 * BAND * size;
  /* The string that is out first, by the secants; several, where they go out together. */
  for (int i = 0; i < m; ++i) {
    const double start = larger(inside[i], 0);
    first = smaller(outside[i] < 0 ? start / (start - outside[i]) : 1, first);
  }
  lowest = least_of(outside, m);
  for (int i = 0; i < m; ++i) {
    const int is_out = outside[i] < 0 && inside[i] + first * (outside[i] - inside[i]) <= near;
    chosen[i] = cut.found ? is_out : outside[i] <= lowest + near;
    span->leaving[i] = outside[i] < inside[i];
  }
  edge = BAND * size;
  before = mean_of_chosen(span, inside) - edge;
  after = mean_of_chosen(span, outside) - edge;
  cut.speed = (after - before) / (high - low);
  if (!velocity_dependent(span->scene)) {
    const double speed = fabs(cut.speed);
    late = larger(smaller(sqrt(allowed * speed / h), MOST_LATE * speed), least * size);
  }
  cut.aim = larger(-larger(late, 0.2 * BAND * size), after) / 2;
  /* The Illinois method: the chord of a string that starts at rest on the border is far from its
     slope there, and others that start next to it are not to be passed. */
  left = low, right = high, over = before - cut.aim, under = after - cut.aim;
  for (int i = 0; i < CHORDS; ++i) {
    double there;
    cut.part = smaller(larger(left + over * (right - left) / (over - under), left), right);
    rooms_at(span, step, cut.part, span->rooms);
    there = mean_of_chosen(span, span->rooms) - edge - cut.aim;
    if (there > 0)
      left = cut.part, over = there, under /= 2;
    else
      right = cut.part, under = there, over /= 2;
  }
  return cut;
}

/* Goes to a switch by true steps, as a rule by one; returns the part of the step, and x there. */
double approach(Span *span, const Tried *step, Cut cut, Place *place, void *by, double *x,
                int *places) {
  double part = 0, wanted = cut.part, speed = cut.speed, gap_before = cut.aim;
  *places = 0;
  while (*places < POLISHES && (!*places || fabs(gap_before - cut.aim) > fabs(cut.aim))) {
    const double before = part;
    double gap, secant;
    int apart, flat;
    part = smaller(larger(speed < 0 ? wanted : 0, 0), 1);
    place(by, part, x);
    gap_at(span, x, step->time + part * step->h, span->gap, span->rate);
    for (int i = 0; i < span->switches; ++i) span->gap[i] *= sign_of(step->taut[i]);
    gap = mean_of_chosen(span, span->gap);
    /* The gap of a damped string has a kink next to the border: the tension falls fast up to it,
       and beyond it is the stretch that counts. Where it is flat between two places beyond, the
       next is twice as far back. */
    apart = *places && fabs(part - before) > 1e-6;
    secant = (gap - gap_before) / (apart ? part - before : 1);
    flat = apart && larger(gap, gap_before) < 0 && secant > FLAT * speed;
    if (apart && secant < 0 && !flat) speed = secant;
    wanted = part + (flat ? -2 * fabs(part - before) : (cut.aim - gap) / speed);
    gap_before = gap;
    ++*places;
  }
  return part;
}

/* Switches what has reached its border on the way out; returns how many. */
int switch_over(Span *span, const double *x, double time, double *taut) {
  int count = 0;
  const double *scale;
  gap_at(span, x, time, span->gap, span->rate);
  scale = gap_scales(span, time);
  for (int i = 0; i < span->switches; ++i)
    if (sign_of(taut[i]) * span->gap[i] <= 0.5 * BAND * scale[i] && span->leaving[i]) {
      taut[i] = 1 - taut[i];
      ++count;
    }
  return count;
}
