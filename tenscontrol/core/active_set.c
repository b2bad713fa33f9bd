/* The dual active-set method of active_set.h. */
#include "active_set.h"

#include <math.h>
#include <string.h>

/*
 * Candidates are left for new ones where all are violated by less than this part of what the worst
 * row was. With 0 there are fewest products, but up to twice as many changes of the set: rows are
 * added that worse ones, unknown as yet, push out again.
 */
#define ACTIVE_SET_PART 0.3

/* After so many changes for each row, rows are chosen by their distances: seldom reached, since the
   usual choice takes fewer changes in most programs. */
#define ACTIVE_SET_LATE 5

/* A row whose distance from the span of the others is below this part of its length, squared. */
#define ACTIVE_SET_DEPENDENT 1e-12

/* The same of rows that a solve begins with, of which it can do without any: rows behind one that is
   nearly dependent are factorized with errors larger by one over this part. */
#define ACTIVE_SET_APART 1e-6

/* Below this part a pivot is computed anew, as a sum of squares. */
#define ACTIVE_SET_CANCELLED 1e-4

/* Repeated steps at most, each of which leaves a quarter of what the one before did. */
#define ACTIVE_SET_REFINEMENTS 40

/* What a row may be violated by that could not be made active, in tolerances. */
#define ACTIVE_SET_LOOSE 1e3

static double active_set_dot(const double *a, const double *b, int count) {
  double s0 = 0.0, s1 = 0.0, s2 = 0.0, s3 = 0.0; /* four sums, added in pairs */
  int i;
  for (i = 0; i + 4 <= count; i += 4) {
    s0 += a[i] * b[i];
    s1 += a[i + 1] * b[i + 1];
    s2 += a[i + 2] * b[i + 2];
    s3 += a[i + 3] * b[i + 3];
  }
  for (; i < count; i++) s0 += a[i] * b[i];
  return (s0 + s1) + (s2 + s3);
}

/* y += factor x */
static void active_set_add(double factor, const double *x, double *y, int count) {
  int i;
  for (i = 0; i < count; i++) y[i] += factor * x[i];
}

/* The product of two rows of the lists. */
static double active_set_inner(const ActiveSet *set, int j, int k) {
  int shorter = set->length[j] < set->length[k] ? set->length[j] : set->length[k];
  double product = active_set_dot(set->entries[j], set->entries[k], shorter);
  if (set->rest != NULL) product += set->rest->inner(set->data, set->active[j], set->active[k]);
  return product;
}

/* The product of a row of the lists with x. */
static double active_set_value(const ActiveSet *set, int k, const double *x) {
  double value = active_set_dot(set->entries[k], x, set->length[k]);
  if (set->rest != NULL) value += set->rest->value(set->data, set->active[k], x);
  return value;
}

/* x += factor times a row of the lists */
static void active_set_add_row(const ActiveSet *set, double factor, int k, double *x) {
  active_set_add(factor, set->entries[k], x, set->length[k]);
  if (set->rest != NULL) set->rest->add(set->data, factor, set->active[k], x);
}

/* Row k of L, left of its diagonal. */
static double *active_set_factor_row(const ActiveSet *set, int k) {
  return set->factor + (size_t)k * ((size_t)k - 1) / 2;
}

static double active_set_price(const ActiveSet *set, int i) {
  return set->price == NULL ? INFINITY : set->price[i];
}

static int active_set_finite(const double *values, int count) {
  int i;
  for (i = 0; i < count; i++)
    if (!isfinite(values[i])) return 0;
  return 1;
}

/* What a violation adds to the diagonal of the Gram matrix. */
static double active_set_softness(const ActiveSet *set, int k) {
  return set->violated[k] ? 1.0 / set->curvature[set->active[k]] : 0.0;
}

static double active_set_diagonal(const ActiveSet *set, int k) {
  return active_set_inner(set, k, k) + active_set_softness(set, k);
}

/* Solve L' p = p for the first rows. */
SOLVER_WIDE static void active_set_backward(const ActiveSet *set, double *p, int count) {
  int k;
  for (k = count - 1; k > 0; k--) active_set_add(-p[k], active_set_factor_row(set, k), p, k);
}

/* x += factor M' y, of the active rows. */
SOLVER_WIDE static void active_set_combine(const ActiveSet *set, const double *y, double factor, double *x) {
  int k;
  for (k = 0; k < set->count; k++) active_set_add_row(set, factor * y[k], k, x);
}

/*
 * The pivot of a row as the square of its distance from the span of those before it. Their parts in
 * it, which `l` has, are repeated on what is left: factors of rows that nearly depend on one another
 * know few digits of them, and a row that does depend would seem not to.
 */
SOLVER_WIDE static double active_set_distance(ActiveSet *set, int k, double *l) {
  double *p = set->step, *left = set->residual, *z = set->column, square = INFINITY, before;
  int m;
  do {
    before = square;
    memcpy(p, l, (size_t)k * sizeof *p);
    active_set_backward(set, p, k);
    memset(z, 0, (size_t)set->columns * sizeof *z);
    active_set_add_row(set, 1.0, k, z);
    square = active_set_softness(set, k);
    for (m = 0; m < k; m++) {
      active_set_add_row(set, -p[m], m, z);
      square += active_set_softness(set, m) * p[m] * p[m];
    }
    square += set->rest != NULL ? set->rest->square(set->data, z) : active_set_dot(z, z, set->columns);
    for (m = 0; m < k; m++) {
      left[m] = active_set_value(set, m, z) - active_set_softness(set, m) * p[m];
      left[m] -= active_set_dot(active_set_factor_row(set, m), left, m);
    }
    for (m = 0; m < k; m++) l[m] += left[m] / set->pivot[m];
  } while (square < 0.25 * before);
  return square;
}

/* Find the listed candidates, but for the first, which are known. */
static void active_set_fetch(ActiveSet *set, int known) {
  double *space[ACTIVE_SET_BATCH];
  int first = set->count + known, count = set->candidates - known, j;
  for (j = 0; j < count; j++) {
    size_t slot = (size_t)set->slot[first + j];
    space[j] = set->stored ? set->stored_rows + slot * set->columns : NULL;
  }
  if (count)
    set->batch(set->data, count, set->active + first, space, set->entries + first, set->length + first);
}

/* Exchange two rows of the lists; what is stored stays where it is. */
static void active_set_exchange(ActiveSet *set, int j, int k) {
  int active = set->active[j], length = set->length[j], slot = set->slot[j];
  const double *entries = set->entries[j];
  set->active[j] = set->active[k];
  set->length[j] = set->length[k];
  set->slot[j] = set->slot[k];
  set->entries[j] = set->entries[k];
  set->active[k] = active;
  set->length[k] = length;
  set->slot[k] = slot;
  set->entries[k] = entries;
}

/* Factorize the Gram matrix with a candidate, whose multiplier has this side, after all others. */
SOLVER_WIDE static void active_set_append(ActiveSet *set, int candidate, int side, int violated) {
  int k = set->count++, m;
  double *l = active_set_factor_row(set, k), diagonal, pivot;
  set->candidates--;
  active_set_exchange(set, candidate, k);
  set->place[set->active[k]] = k;
  set->side[k] = side;
  set->violated[k] = violated;
  diagonal = pivot = active_set_diagonal(set, k);
  for (m = 0; m < k; m++)
    l[m] = active_set_inner(set, m, k) - active_set_dot(active_set_factor_row(set, m), l, m);
  for (m = 0; m < k; m++) {
    double scaled = l[m] / set->pivot[m];
    pivot -= scaled * l[m];
    l[m] = scaled;
  }
  if (!(pivot > ACTIVE_SET_CANCELLED * diagonal)) pivot = active_set_distance(set, k, l);
  set->singular = !(pivot > ACTIVE_SET_DEPENDENT * diagonal);
  set->pivot[k] = set->singular ? 0.0 : pivot;
  if (!set->singular) set->apart = fmin(set->apart, pivot / diagonal);
}

/* Add alpha w w' to the factors of the rows from k on; w, of the rows before `count`, is lost. */
SOLVER_WIDE static void active_set_update(ActiveSet *set, int k, double alpha, double *w) {
  int j, m;
  for (j = k; j < set->count; j++) {
    double p = w[j], old = set->pivot[j], new = old + alpha * p * p, beta;
    if (p == 0.0 || new == 0.0) continue;
    beta = alpha * p / new;
    alpha *= old / new;
    set->pivot[j] = new;
    for (m = j + 1; m < set->count; m++) {
      double *l = active_set_factor_row(set, m);
      w[m] -= p * l[j];
      l[j] += beta * w[m];
    }
  }
  k = set->count - 1;
  if (set->singular) {
    set->singular = !(set->pivot[k] > ACTIVE_SET_DEPENDENT * active_set_diagonal(set, k));
    if (set->singular) set->pivot[k] = 0.0;
  }
}

/* Take row k out of the active set: it is the first candidate then. Its multiplier stays. */
static void active_set_remove(ActiveSet *set, int k) {
  double *w = set->step, alpha = set->pivot[k];
  int m, last = set->count - 1;
  set->place[set->active[k]] = -1;
  if (k == last) set->singular = 0;
  for (m = k + 1; m < set->count; m++) {
    const double *from = active_set_factor_row(set, m);
    double *to = active_set_factor_row(set, m - 1);
    w[m - 1] = from[k];
    memmove(to, from, (size_t)k * sizeof *to);
    memmove(to + k, from + k + 1, (size_t)(m - 1 - k) * sizeof *to);
    set->pivot[m - 1] = set->pivot[m];
    set->side[m - 1] = set->side[m];
    set->violated[m - 1] = set->violated[m];
    active_set_exchange(set, m - 1, m);
    set->place[set->active[m - 1]] = m - 1;
  }
  set->count = last;
  set->candidates++;
  if (k < last) active_set_update(set, k, alpha, w);
}

/* Let soft row k be violated, or hold it at its bound again. */
static void active_set_switch(ActiveSet *set, int k) {
  int i = set->active[k];
  if (!set->violated[k]) {
    memset(set->step, 0, (size_t)set->count * sizeof *set->step);
    set->step[k] = 1.0;
    set->side[k] = set->y[i] < 0.0 ? -1 : 1;
    set->violated[k] = 1;
    active_set_update(set, k, active_set_softness(set, k), set->step);
  } else { /* a smaller diagonal: factorized anew, which shows whether the row is independent */
    int side = set->side[k];
    active_set_remove(set, k);
    active_set_append(set, set->count, side, 0);
  }
}

void active_set_place(ActiveSet *set, double *numbers, int *integers, const double **pointers) {
  size_t rows = (size_t)set->rows, most = (size_t)set->most;
  int k;
  set->y = numbers;
  set->product = set->y + rows;
  set->column = set->product + rows;
  set->pivot = set->column + set->columns;
  set->step = set->pivot + most;
  set->residual = set->step + most;
  set->factor = set->residual + most;
  set->stored_rows = set->factor + most * (most - 1) / 2;
  set->place = integers;
  set->active = set->place + rows;
  set->side = set->active + most;
  set->violated = set->side + most;
  set->length = set->violated + most;
  set->slot = set->length + most;
  set->entries = pointers;
  for (k = 0; k < set->most; k++) set->slot[k] = k;
  set->iterations = 0;
  active_set_start(set, NULL);
}

/* Append all candidates in turn, but for those that nearly depend on the rows before them. */
static void active_set_append_all(ActiveSet *set, const double *y) {
  int left = 0, last; /* stay candidates */
  while (left < set->candidates) {
    int next = set->count + left, i = set->active[next];
    active_set_append(set, next, y[i] < 0.0 ? -1 : 1, fabs(y[i]) > active_set_price(set, i));
    last = set->count - 1;
    if (!(set->pivot[last] > ACTIVE_SET_APART * active_set_diagonal(set, last))) {
      active_set_remove(set, last);
      left++;
    } else {
      set->y[i] = y[i];
    }
  }
}

void active_set_start(ActiveSet *set, const double *y) {
  int i, next = 0;
  set->count = set->candidates = set->singular = 0;
  set->apart = 1.0;
  for (i = 0; i < set->rows; i++) {
    set->place[i] = -1;
    set->y[i] = 0.0;
  }
  while (y != NULL && next < set->rows && set->count < set->most) {
    int room = set->most - set->count;
    if (room > ACTIVE_SET_BATCH) room = ACTIVE_SET_BATCH;
    set->candidates = 0;
    for (; next < set->rows && set->candidates < room; next++)
      if (y[next] != 0.0 && isfinite(y[next])) set->active[set->count + set->candidates++] = next;
    active_set_fetch(set, 0);
    active_set_append_all(set, y);
  }
}

/* Move to x = -q - M'y. */
static void active_set_point(ActiveSet *set, const double *q, double *x) {
  int k;
  for (k = 0; k < set->columns; k++) x[k] = -q[k];
  for (k = 0; k < set->count; k++) set->step[k] = set->y[set->active[k]];
  active_set_combine(set, set->step, -1.0, x);
}

/* What is left of the conditions of the active rows: slopes of the dual problem. */
SOLVER_WIDE static double active_set_residuals(ActiveSet *set, const double *x, const double *low,
                                               const double *high) {
  double largest = 0.0;
  int k;
  for (k = 0; k < set->count; k++) {
    int i = set->active[k];
    double left = active_set_value(set, k, x);
    left -= set->side[k] > 0 ? high[i] : low[i];
    if (set->violated[k]) left -= (set->y[i] - set->side[k] * set->price[i]) / set->curvature[i];
    set->residual[k] = left;
    largest = fmax(largest, fabs(left));
  }
  return largest;
}

/* The step to where all active rows hold, in set->step, which adds to the multipliers. */
SOLVER_WIDE static void active_set_direction(ActiveSet *set) {
  double *p = set->step;
  int k;
  for (k = 0; k < set->count; k++)
    p[k] = set->residual[k] - active_set_dot(active_set_factor_row(set, k), p, k);
  for (k = 0; k < set->count; k++) p[k] /= set->pivot[k];
  active_set_backward(set, p, set->count);
}

/*
 * The step along which x stays where it is, since the last row depends on the others, and the dual
 * problem rises. Where it is level, the step is to where the last row has no multiplier, and its
 * largest part is 1, otherwise infinite.
 */
static double active_set_ray(ActiveSet *set) {
  double *p = set->step, rate, length = 1.0, factor;
  int k, last = set->count - 1;
  memcpy(p, active_set_factor_row(set, last), (size_t)last * sizeof *p);
  active_set_backward(set, p, last);
  for (k = 0; k < last; k++) {
    p[k] = set->violated[k] ? 0.0 : -p[k]; /* of violated rows it is round-off */
    length += fabs(p[k]);
  }
  p[last] = 1.0;
  rate = active_set_dot(p, set->residual, set->count);
  factor = rate < 0.0 ? -1.0 : 1.0;
  if (fabs(rate) <= set->tolerance * length) factor = -set->y[set->active[last]];
  for (k = 0; k < set->count; k++) p[k] *= factor;
  return fabs(rate) <= set->tolerance * length ? 1.0 : INFINITY;
}

/* The largest part of the step after which all multipliers keep their kinds, and which stops it. */
static double active_set_reach(const ActiveSet *set, const double *low, const double *high, double most,
                               int *blocking) {
  double reach = most;
  int k;
  *blocking = -1;
  for (k = 0; k < set->count; k++) {
    int i = set->active[k];
    int side = set->side[k], free = low[i] == high[i] && !set->violated[k];
    double p = set->step[k], y = set->y[i], ratio = INFINITY;
    if (free) side = p < 0.0 ? -1 : 1;
    p *= side;
    y *= side;
    if (set->violated[k]) ratio = p < 0.0 ? (y - set->price[i]) / -p : INFINITY;
    else if (p < 0.0) ratio = y / -p;
    else if (p > 0.0) ratio = (active_set_price(set, i) - y) / p;
    ratio = ratio > 0.0 ? ratio : 0.0;
    if (ratio < reach) {
      reach = ratio;
      *blocking = k;
    }
  }
  return reach;
}

/* Change the kind of a row at the end of a step. */
static void active_set_change(ActiveSet *set, int k, const double *low, const double *high) {
  int i = set->active[k], free = low[i] == high[i], side = set->side[k];
  double p = set->step[k];
  if (free && !set->violated[k]) side = p < 0.0 ? -1 : 1;
  if (set->violated[k] || side * p > 0.0) {
    set->y[i] = side * set->price[i];
    active_set_switch(set, k);
  } else {
    set->y[i] = 0.0;
    active_set_remove(set, k);
  }
}

/* What row i is violated by; 0 if it is not, within the tolerance. */
static double active_set_violation(const ActiveSet *set, int i, const double *low, const double *high,
                                   double tolerance) {
  double value = set->product[i], over = fmax(value - high[i], low[i] - value);
  return over > tolerance * (1.0 + fabs(value)) ? over : 0.0;
}

/* Whether a barred row is violated, by far. */
static int active_set_inaccurate(const ActiveSet *set, const double *low, const double *high) {
  double tolerance = ACTIVE_SET_LOOSE * set->tolerance;
  int i;
  for (i = 0; i < set->rows; i++)
    if (set->place[i] < 0 && active_set_violation(set, i, low, high, tolerance) > 0.0) return 1;
  return 0;
}

/* Find the rows that are violated most, the worst first; returns how many, up to the most. */
static int active_set_select(const ActiveSet *set, const double *low, const double *high, int most,
                             int *which) {
  double violation[ACTIVE_SET_BATCH];
  int count = 0, i, j;
  for (i = 0; i < set->rows; i++) {
    double over = 0.0;
    if (set->place[i] == -1) over = active_set_violation(set, i, low, high, set->tolerance);
    if (over == 0.0 || (count == most && over <= violation[count - 1])) continue;
    if (count < most) count++;
    for (j = count - 1; j > 0 && violation[j - 1] < over; j--) {
      violation[j] = violation[j - 1];
      which[j] = which[j - 1];
    }
    violation[j] = over;
    which[j] = i;
  }
  return count;
}

/* Make these rows the candidates; those that were are not reached again. */
static void active_set_replace(ActiveSet *set, const int *which, int count) {
  int known = set->count, all = set->count + set->candidates, j;
  for (j = 0; j < count; j++) set->place[which[j]] = -3; /* listed below */
  for (j = known; j < all; j++)
    if (set->place[set->active[j]] == -3) {
      set->place[set->active[j]] = -1;
      active_set_exchange(set, j, known++);
    }
  set->candidates = count;
  all = known;
  for (j = 0; j < count; j++)
    if (set->place[which[j]] == -3) {
      set->place[which[j]] = -1;
      set->active[all++] = which[j];
    }
  active_set_fetch(set, known - set->count);
}

/*
 * The candidate to append, as a place in the lists; -1 if all hold. It is the one that is violated
 * most, but after many changes the one whose bound is farthest from x: where lengths of rows differ
 * by decades, the long ones are violated most again and again, and the set changes by thousands.
 */
static int active_set_worst(const ActiveSet *set, const double *low, const double *high, double *largest) {
  int late = set->iterations > ACTIVE_SET_LATE * set->rows, k, worst = -1;
  double farthest = 0.0;
  *largest = 0.0;
  for (k = set->count; k < set->count + set->candidates; k++) {
    int i = set->active[k];
    double over = 0.0, distance;
    if (set->place[i] == -1) over = active_set_violation(set, i, low, high, set->tolerance);
    distance = late && over > 0.0 ? over / sqrt(active_set_inner(set, k, k)) : over;
    *largest = fmax(*largest, over);
    if (distance > farthest) {
      farthest = distance;
      worst = k;
    }
  }
  return worst;
}

/*
 * The row to append, as a place in the lists: the worst candidate, or where none is violated by
 * what is enough, the worst row of all, by its product whatever its entries say: so each product
 * leads to a change. Without one all rows hold (-1), or there is no room (-2).
 */
static int active_set_next(ActiveSet *set, const double *x, const double *low, const double *high,
                           double *enough) {
  int which[ACTIVE_SET_BATCH], room = set->most - set->count, count, k, worst;
  double largest;
  for (k = set->count; k < set->count + set->candidates; k++)
    set->product[set->active[k]] = active_set_value(set, k, x);
  worst = active_set_worst(set, low, high, &largest);
  if (worst >= 0 && largest >= *enough) return worst;
  set->products(set->data, x, set->product);
  if (room > ACTIVE_SET_BATCH) room = ACTIVE_SET_BATCH;
  count = active_set_select(set, low, high, room > 1 ? room : 1, which);
  if (count == 0) return -1;
  if (room == 0) return -2;
  active_set_replace(set, which, count);
  worst = active_set_worst(set, low, high, &largest);
  *enough = ACTIVE_SET_PART * largest;
  return worst;
}

/* Step to where the active rows hold. */
static void active_set_step(ActiveSet *set, double *x) {
  int k;
  active_set_direction(set);
  for (k = 0; k < set->count; k++) set->y[set->active[k]] += set->step[k];
  active_set_combine(set, set->step, -1.0, x); /* less round-off than x = -q - M'y */
}

/* Repeat the last step on the residuals of the answer, until they are round-off; returns the largest. */
static double active_set_refine(ActiveSet *set, const double *q, const double *low, const double *high,
                                double *x) {
  double before = INFINITY, left;
  int round;
  active_set_point(set, q, x);
  for (round = 0;; round++) {
    left = active_set_residuals(set, x, low, high);
    if (round == ACTIVE_SET_REFINEMENTS || !(left < 0.25 * before) || left == 0.0) return left;
    before = left;
    active_set_step(set, x);
  }
}

/* Begin with the active rows that have a bound on their side. Returns what is wrong with data. */
static int active_set_begin(ActiveSet *set, const double *q, const double *low, const double *high) {
  int i, k;
  if (!active_set_finite(q, set->columns)) return ACTIVE_SET_BAD_DATA;
  for (i = 0; i < set->rows; i++) {
    if (!(low[i] < INFINITY) || !(high[i] > -INFINITY)) return ACTIVE_SET_BAD_DATA;
    if (low[i] > high[i]) return ACTIVE_SET_INFEASIBLE;
    if (set->place[i] < 0) set->place[i] = -1;
  }
  for (k = set->count - 1; k >= 0; k--) {
    i = set->active[k];
    if (isinf(set->side[k] > 0 ? high[i] : low[i])) {
      set->y[i] = 0.0;
      active_set_remove(set, k);
    }
  }
  set->candidates = 0;
  return ACTIVE_SET_OK;
}

/* Change the active set until all rows hold, all multipliers have their signs, or neither can be. */
static int active_set_iterate(ActiveSet *set, const double *q, const double *low, const double *high,
                              double *x) {
  double enough = 0.0;
  int newest = -1;
  active_set_point(set, q, x);
  for (;;) {
    double step_length = 1.0;
    int blocking, k;
    if (set->stop != NULL && set->stop(set->data)) return ACTIVE_SET_OUT_OF_TIME;
    if (set->iterations >= set->limit) return ACTIVE_SET_OUT_OF_ITERATIONS;
    active_set_residuals(set, x, low, high);
    if (set->singular) step_length = active_set_ray(set);
    else active_set_direction(set);
    if (!active_set_finite(set->step, set->count)) return ACTIVE_SET_BAD_DATA;
    step_length = active_set_reach(set, low, high, step_length, &blocking);
    if (isinf(step_length)) return ACTIVE_SET_INFEASIBLE;
    for (k = 0; k < set->count; k++) set->y[set->active[k]] += step_length * set->step[k];
    active_set_combine(set, set->step, -step_length, x);
    if (blocking >= 0) {
      int i = set->active[blocking];
      active_set_change(set, blocking, low, high);
      set->iterations++;
      if (i == newest && step_length == 0.0 && set->place[i] == -1)
        set->place[i] = -2; /* its violation is round-off */
    } else if (set->singular) {
      int i = set->active[set->count - 1];
      set->y[i] = 0.0;
      active_set_remove(set, set->count - 1);
      set->iterations++;
      set->place[i] = -2; /* it follows from the others */
    } else {
      int next = active_set_next(set, x, low, high, &enough);
      if (next < 0) return next == -1 ? ACTIVE_SET_OK : ACTIVE_SET_OUT_OF_ITERATIONS;
      newest = set->active[next];
      active_set_append(set, next, set->product[newest] > high[newest] ? 1 : -1, 0);
      set->iterations++;
    }
  }
}

/* Solve from the active set as it is; active rows must hold to so many tolerances. */
static int active_set_attempt(ActiveSet *set, const double *q, const double *low, const double *high,
                              double *x, double loose) {
  double left;
  int status = active_set_begin(set, q, low, high);
  if (status == ACTIVE_SET_OK) status = active_set_iterate(set, q, low, high, x);
  if (status != ACTIVE_SET_OK) return status;
  left = active_set_refine(set, q, low, high, x);
  if (!active_set_finite(x, set->columns)) return ACTIVE_SET_BAD_DATA;
  if (!(left <= loose * set->tolerance) || active_set_inaccurate(set, low, high))
    return ACTIVE_SET_INACCURATE;
  return ACTIVE_SET_OK;
}

int active_set_solve(ActiveSet *set, const double *q, const double *low, const double *high, double *x) {
  int status, begun = set->count > 0;
  set->iterations = 0;
  status = active_set_attempt(set, q, low, high, x, begun ? 1.0 : ACTIVE_SET_LOOSE);
  if (begun && (status == ACTIVE_SET_INACCURATE || status == ACTIVE_SET_INFEASIBLE)) {
    active_set_start(set, NULL); /* factors of many changes may have lost what tells */
    status = active_set_attempt(set, q, low, high, x, ACTIVE_SET_LOOSE);
  }
  if (status != ACTIVE_SET_OK) active_set_start(set, NULL);
  return status;
}

void active_set_correct(ActiveSet *set, const double *low, const double *high, double *step) {
  active_set_residuals(set, step, low, high);
  active_set_step(set, step);
}
