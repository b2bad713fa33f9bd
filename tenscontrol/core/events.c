/* Location of switches: steps end where a string goes slack or taut, or a contact opens or closes.

   A step across such a border loses the order of every method. So a step is taken with the strings
   that pull as they are at its start. If one of them changes within, the step is cut there. What is
   said of strings holds for contacts. Runs in lanes are searched together, each at its own times. */
#include <string.h>

#include "motion.h"

/* The search: samples, how often it zooms in on those next to the first that is out, chords on the
   interpolant, and the most true steps to the place found. With ground, a node that dips in by
   little stays a small part of a step. */
enum { SAMPLES = 6, ZOOMS = 2, ZOOMS_ON_GROUND = 7, CHORDS = 6, POLISHES = 8 };

/* A gap is flat beyond the border where it falls by less than this part of its slope before. */
static const double FLAT = 0.1;

/* Parts of a step that are this far from each other have a chord. */
static const double APART = 1e-6;

/* How late a step may end at most, as part of it. */
static const double MOST_LATE = 1e-3;

SHARED int velocity_dependent(const Scene *s) {
  if (s->damped) return 1;
  for (int i = 0; i < s->grounds; ++i)
    if (s->ground[i].count && (s->ground[i].damped || s->ground[i].rubs)) return 1;
  return 0;
}

SHARED const Some *list(Span *span, const Number *marked) {
  Some *some = &span->some;
  some->count = 0;
  for (int i = 0; i < span->switches; ++i)
    if (any(marked[i] != 0)) some->which[some->count++] = i;
  return some;
}

/* Gaps alone, of all or of some. */
static void gaps_at(Span *span, const Number *x, Number time, const Some *some, Number *gap) {
  gap_at(span, x, time, some, gap, velocity_dependent(span->scene) ? span->rate : 0);
}

/* Lengths that round-off in each gap is a part of, m, at a time: rest lengths, and the size. */
SHARED const Number *gap_scales(Span *span, Number time) {
  const Scene *s = span->scene;
  const Input input = input_at(span, time);
  memcpy(span->scale, input.strings, s->slacking * sizeof(Number));
  for (int i = s->slacking; i < span->switches; ++i) span->scale[i] = all(s->size);
  return span->scale;
}

static inline Number sign_of(Number taut) { return 2 * taut - 1; }

/* Whether the tangents room0 - out t and room1 - back (h - t) meet below zero. */
static inline Truth meet_outside(Number room0, Number room1, Number out, Number back, Number h) {
  return (out > 0) & (back > 0) & (back * room0 + out * room1 < out * back * h);
}

/* Marks what is out with 1 at the end of a step, with 2 otherwise; what is marked stays. */
static inline Number marked(Number mark, Truth is_met, Truth is_out) {
  return choice(is_met & (mark == 0), choice(is_out, all(1), all(2)), mark);
}

/* Marks what the ends of a step tell of: what is out at the end, or was between them. */
WIDE static void mark_by_ends(const Number *restrict taut, const Number *restrict scale,
                              const Number *restrict gap0, const Number *restrict rate0,
                              const Number *restrict gap1, const Number *restrict rate1, Number h,
                              Number *restrict marks, int m) {
  for (int i = 0; i < m; ++i) {
    const Number sign = sign_of(taut[i]), band = BAND * scale[i];
    const Number room0 = sign * gap0[i] + band, room1 = sign * gap1[i] + band;
    const Truth is_out = room1 < 0;
    const Truth meet = meet_outside(room0, room1, -sign * rate0[i], sign * rate1[i], h);
    marks[i] = marked(all(0), is_out | meet, is_out);
  }
}

WIDE static Truth are_finite(const Number *restrict x, int n) {
  Truth are = all(0) < 1;
  for (int i = 0; i < n; ++i) are &= positive(x[i]) < INFINITY;
  return are;
}

/* Positions in the middle of a step, and velocities, by the cubic with those at its ends, where no
   acceleration may be known yet. */
static void middle_of(Span *span, const Tried *step) {
  const int half = span->states / 2;
  const Number h = step->h;
  const Number *q = step->x, *v = q + half, *q1 = step->x1, *v1 = q1 + half;
  Number *y = span->middle;
  for (int i = 0; i < half; ++i) {
    y[i] = (q[i] + q1[i]) / 2 + h / 8 * (v[i] - v1[i]);
    y[half + i] = 1.5 / h * (q1[i] - q[i]) - (v[i] + v1[i]) / 4;
  }
}

/* Gaps of a state at rest, of some. */
static void gap_at_rest(Span *span, const Number *x, Number time, const Some *some, Number *gap) {
  const int half = span->states / 2;
  memcpy(span->middle, x, half * sizeof *x);
  memset(span->middle + half, 0, half * sizeof *x);
  gap_at(span, span->middle, time, some, gap, span->rate);
}

/* Marks strings that may switch within a step with 1, and with 2 those that come back in; returns how
   many they are. */
SHARED Number crossings(Span *span, const Tried *step) {
  const int m = span->switches;
  const Number h = step->h;
  const Number *scale, *taut = step->taut;
  Number *marks = span->marked;
  Number *gap0 = span->gap0, *rate0 = span->inside, *gap1 = span->gap1, *rate1 = span->within;
  Number count = all(0);
  Truth finite;
  if (!m) return count;
  finite = are_finite(step->x1, span->states); /* a state that is not is not searched */
  if (span->goes_on) {
    memcpy(gap0, gap1, m * sizeof *gap0);
    memcpy(rate0, rate1, m * sizeof *rate0);
  } else {
    gap_at(span, step->x, step->time, 0, gap0, rate0);
  }
  gap_at(span, step->x1, step->time + h, 0, gap1, rate1);
  scale = gap_scales(span, step->time);
  mark_by_ends(taut, scale, gap0, rate0, gap1, rate1, h, marks, m);
  if (velocity_dependent(span->scene)) {
    Number *gap = span->gap, *end_gap = span->rooms, *slack = span->chosen;
    /* The border of a damped string has other tangents than its stretch: look at the middle. */
    middle_of(span, step);
    gap_at(span, span->middle, step->time + h / 2, 0, gap, span->rate);
    scale = gap_scales(span, step->time);
    for (int i = 0; i < m; ++i) {
      const Number sign = sign_of(taut[i]), band = BAND * scale[i];
      marks[i] = marked(marks[i], sign * gap[i] + band < 0, sign * gap1[i] + band < 0);
    }
    /* A slack string pulls as soon as its stretch grows through zero, however soon the damping lets
       it go again. At rest nothing is damped, and the gap is the stretch. */
    for (int i = 0; i < m; ++i) slack[i] = 1 - taut[i];
    list(span, slack);
    gap_at_rest(span, step->x, step->time, &span->some, gap);
    gap_at_rest(span, step->x1, step->time + h, &span->some, end_gap);
    scale = gap_scales(span, step->time);
    for (int i = 0; i < m; ++i) {
      const Number band = BAND * scale[i], room0 = band - gap[i], room1 = band - end_gap[i];
      const Truth dips = meet_outside(room0, room1, rate0[i], -rate1[i], h);
      const Truth pulls = (taut[i] == 0) & (room0 > 0) & ((room1 < 0) | dips);
      marks[i] = marked(marks[i], pulls, sign_of(taut[i]) * gap1[i] + band < 0);
    }
  }
  for (int i = 0; i < m; ++i) {
    marks[i] = only(finite, marks[i]);
    count += truth(marks[i] != 0);
  }
  return count;
}

static Number least_of(const Number *of, int count) {
  Number least = all(INFINITY);
  for (int i = 0; i < count; ++i) least = smaller(of[i], least);
  return least;
}

/* Switches in a step that is not cut: a string that is out at the end has switched once, at least;
   one that comes back in, twice. */
SHARED Number missed_switches(Span *span, const Tried *step) {
  Number count = all(0);
  crossings(span, step);
  for (int i = 0; i < span->switches; ++i) count += span->marked[i];
  return count;
}

/* The polynomials of degree 5 with positions, velocities and accelerations at both ends. */
WIDE static void path_by(const Number *restrict x, const Number *restrict x1, const Number *restrict slope,
                         const Number *restrict slope1, Number h, Number *restrict c, int half) {
  for (int i = 0; i < half; ++i) {
    const Number q0 = x[i], v0 = h * x[half + i], q1 = x1[i], v1 = h * x1[half + i];
    const Number a0 = h * h * slope[half + i], a1 = h * h * slope1[half + i];
    const Number d = q1 - q0 - v0 - a0 / 2, e = v1 - v0 - a0, f = a1 - a0;
    c[i] = q0;
    c[half + i] = v0;
    c[2 * half + i] = a0 / 2;
    c[3 * half + i] = 10 * d - 4 * e + f / 2;
    c[4 * half + i] = -15 * d + 7 * e - f;
    c[5 * half + i] = 6 * d - 3 * e + f / 2;
  }
}

SHARED void make_path(Span *span, const Tried *step) {
  path_by(step->x, step->x1, step->slope, step->slope1, step->h, span->coefficients, span->states / 2);
}

/* Positions at a part of a step. */
WIDE static void places_by(const Number *restrict c, Number part, Number *restrict x, int half) {
  for (int i = 0; i < half; ++i) {
    Number value = c[5 * half + i];
    for (int k = 4; k >= 0; --k) value = value * part + c[k * half + i];
    x[i] = value;
  }
}

static void places_on_path(const Span *span, Number part, Number *x) {
  places_by(span->coefficients, part, x, span->states / 2);
}

SHARED void on_path(const Span *span, Number h, Number part, Number *x) {
  const int half = span->states / 2;
  const Number *c = span->coefficients;
  places_on_path(span, part, x);
  for (int i = 0; i < half; ++i) {
    Number v = 5 * c[5 * half + i];
    for (int k = 4; k > 0; --k) v = v * part + (double)k * c[k * half + i];
    x[half + i] = v / h;
  }
}

/* Room of each string up to its border at a part of a step, m, or of some. */
static void rooms_at(Span *span, const Tried *step, Number part, const Some *some, Number *rooms) {
  const int count = some ? some->count : span->switches;
  const Number *scale;
  Number *y = span->middle;
  if (velocity_dependent(span->scene)) on_path(span, step->h, part, y);
  else places_on_path(span, part, y);
  gaps_at(span, y, step->time + part * step->h, some, span->gap);
  scale = gap_scales(span, step->time);
  for (int j = 0; j < count; ++j) {
    const int i = some ? some->which[j] : j;
    rooms[i] = sign_of(step->taut[i]) * span->gap[i] + BAND * scale[i];
  }
}

/* The least room of what is listed and marked, and how many are out. */
static Number least_marked(const Span *span, Number *out) {
  Number least = all(INFINITY);
  *out = all(0);
  for (int j = 0; j < span->some.count; ++j) {
    const int i = span->some.which[j];
    const Truth is_marked = span->marked[i] != 0;
    least = choice(is_marked, smaller(span->rooms[i], least), least);
    *out += truth(is_marked & (span->rooms[i] < 0));
  }
  return least;
}

/* Closes in on the first sample that is out, else on the lowest; whether one is out, and how many
   strings are out there. */
static Truth zoom(Span *span, const Tried *step, Number *low, Number *high, Number *out) {
  const Number width = (*high - *low) / SAMPLES;
  Number least = all(INFINITY), first = all(0), last = all(1);
  for (int j = 0; j < SAMPLES && any((least < 0) == 0); ++j) {
    const Truth is_in = (least < 0) == 0;
    Number lowest, count;
    Truth better;
    rooms_at(span, step, *low + (j + 1.0) * width, &span->some, span->rooms);
    lowest = least_marked(span, &count);
    better = is_in & (lowest < least);
    first = choice(better, all(j), first);
    last = choice(better, choice(lowest < 0, all(j + 1), all(j + 2 > SAMPLES ? j + 1 : j + 2)), last);
    least = choice(better, lowest, least);
    *out = choice(better, count, *out);
  }
  *high = *low + last * width;
  *low += first * width;
  return least < 0;
}

/* Marks what is out already where the first of what is marked goes out: the ends of the step did not
   tell of it. Returns where there is any. */
static Truth mark_earlier(Span *span, Truth found) {
  Truth earlier = found & (found == 0);
  for (int i = 0; i < span->switches; ++i) {
    const Truth is_new = found & (span->inside[i] < 0) & (span->marked[i] == 0);
    span->marked[i] = choice(is_new, all(2), span->marked[i]);
    earlier |= is_new;
  }
  return earlier;
}

/* Of what is listed and chosen. */
static Number mean_of_chosen(const Span *span, const Number *of) {
  Number sum = all(0), count = all(0);
  for (int j = 0; j < span->some.count; ++j) {
    const int i = span->some.which[j];
    sum += only(span->chosen[i] != 0, of[i]);
    count += span->chosen[i];
  }
  return sum / count;
}

/* The first switch within a step that is crossed, on its interpolant, in the runs that are meant.

   A step that ends past the border by d, where the gap shrinks at r, leaves an impulse of d^2/2r
   times the stiffness, as a force that does not depend on velocities is continuous there. So it may
   end past the border by at most sqrt(allowed r), or the part `least` of the length of the string
   if that is more, and never before it: the next step would be wrong. Other forces jump. */
SHARED Cut first_switch(Span *span, Truth meant, const Tried *step, Number allowed, double least) {
  const int m = span->switches;
  const Number *scale, h = step->h;
  Number *inside = span->inside, *outside = span->outside, *chosen = span->chosen;
  Number low = all(0), high = all(1), near, size, first = all(INFINITY), edge, before, after;
  Number late = all(0), lowest, left, right, over, under, value_before;
  Cut cut;
  make_path(span, step);
  do {
    Truth is_settled = all(0) > 1;
    low = all(0), high = all(1);
    list(span, span->marked);
    for (int i = 0; i < (span->scene->grounds ? ZOOMS_ON_GROUND : ZOOMS) && any(is_settled == 0); ++i) {
      Number from = low, to = high, out = all(0);
      const Truth is_out = zoom(span, step, &from, &to, &out);
      low = choice(is_settled, low, from), high = choice(is_settled, high, to);
      cut.found = meant & (is_settled | is_out);         /* what is settled is found */
      if (i >= ZOOMS) is_settled |= is_out & (out == 1); /* nothing else can be first */
    }
    rooms_at(span, step, low, 0, inside);
  } while (any(mark_earlier(span, cut.found & (low > 0))));
  rooms_at(span, step, high, 0, outside);
  scale = gap_scales(span, step->time);
  size = least_of(scale, m);
  near = 0.5 * BAND * size;
  /* The string that is out first, by the secants; several, where they go out together. */
  for (int i = 0; i < m; ++i) {
    const Number start = larger(inside[i], all(0)), secant = start / (start - outside[i]);
    first = smaller(choice(outside[i] < 0, secant, all(1)), first);
  }
  lowest = least_of(outside, m);
  for (int i = 0; i < m; ++i) {
    const Truth is_out = (outside[i] < 0) & (inside[i] + first * (outside[i] - inside[i]) <= near);
    chosen[i] = choice(cut.found, truth(is_out), truth(outside[i] <= lowest + near));
    span->leaving[i] = truth(outside[i] < inside[i]);
  }
  list(span, chosen);
  edge = BAND * size;
  before = mean_of_chosen(span, inside) - edge;
  after = mean_of_chosen(span, outside) - edge;
  cut.speed = (after - before) / (high - low);
  if (!velocity_dependent(span->scene)) {
    const Number speed = positive(cut.speed);
    late = larger(smaller(root(allowed * speed / h), MOST_LATE * speed), least * size);
  }
  cut.aim = larger(-larger(late, 0.2 * BAND * size), after) / 2;
  /* The Illinois method: the chord of a string that starts at rest on the border is far from its
     slope there, and others that start next to it are not to be passed. */
  left = low, right = high, over = before - cut.aim, under = after - cut.aim;
  cut.part = high, value_before = under;
  for (int i = 0; i < CHORDS; ++i) {
    const Number part_before = cut.part;
    Number value, moved_by, secant;
    Truth is_in, apart;
    cut.part = smaller(larger(left + over * (right - left) / (over - under), left), right);
    rooms_at(span, step, cut.part, &span->some, span->rooms);
    value = mean_of_chosen(span, span->rooms) - edge - cut.aim;
    moved_by = cut.part - part_before;
    apart = positive(moved_by) > APART;
    secant = (value - value_before) / choice(apart, moved_by, all(1));
    cut.speed = choice(apart & (secant < 0), secant, cut.speed);
    value_before = value;
    is_in = value > 0;
    left = choice(is_in, cut.part, left);
    right = choice(is_in, right, cut.part);
    over = choice(is_in, value, over / 2);
    under = choice(is_in, under / 2, value);
  }
  return cut;
}

/* Goes to the switch that is found by true steps, as a rule by one; where none is, to the end of the
   step. Returns the part of the step, and x there. */
SHARED Number approach(Span *span, const Tried *step, Cut cut, Place *place, void *by, Number *x,
                       Number *places) {
  Number fraction = choice(cut.found, all(0), all(1)), wanted = cut.part, speed = cut.speed;
  Number gap_before = cut.aim;
  Truth going = cut.found;
  const Some *some = list(span, span->chosen);
  *places = all(0);
  for (int count = 0; count < POLISHES && any(going); ++count) {
    const Number before = fraction;
    Number gap, moved_by, secant;
    Truth apart, flat;
    *places += truth(going);
    fraction = choice(going, smaller(larger(only(speed < 0, wanted), all(0)), all(1)), fraction);
    place(by, fraction, x);
    gaps_at(span, x, step->time + fraction * step->h, some, span->gap);
    for (int j = 0; j < some->count; ++j) span->gap[some->which[j]] *= sign_of(step->taut[some->which[j]]);
    gap = mean_of_chosen(span, span->gap);
    /* The gap of a damped string has a kink next to the border: the tension falls fast up to it,
       and beyond it is the stretch that counts. Where it is flat between two places beyond, the
       next is twice as far back. */
    moved_by = fraction - before;
    apart = positive(moved_by) > (count ? APART : INFINITY);
    secant = (gap - gap_before) / choice(apart, moved_by, all(1));
    flat = apart & (larger(gap, gap_before) < 0) & (secant > FLAT * speed);
    speed = choice(apart & (secant < 0) & (flat == 0), secant, speed);
    wanted = fraction + choice(flat, -2 * positive(moved_by), (cut.aim - gap) / speed);
    gap_before = gap;
    going &= positive(gap - cut.aim) > positive(cut.aim);
  }
  return fraction;
}

/* Switches what has reached its border on the way out, in the runs that are meant; returns how many. */
SHARED Number switch_over(Span *span, Truth meant, const Number *x, Number time, Number *taut) {
  Number count = all(0);
  const Number *scale;
  gaps_at(span, x, time, 0, span->gap);
  scale = gap_scales(span, time);
  for (int i = 0; i < span->switches; ++i) {
    const Number room = sign_of(taut[i]) * span->gap[i];
    const Truth over = meant & (room <= 0.5 * BAND * scale[i]) & (span->leaving[i] != 0);
    taut[i] = choice(over, 1 - taut[i], taut[i]);
    count += truth(over);
  }
  return count;
}
