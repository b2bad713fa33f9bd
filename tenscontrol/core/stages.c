/* Programs along the stages of a horizon: see stages.h. */
#include "stages.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* Blocks from this size on are multiplied by the BLAS, where there is one. */
#define STAGES_LARGE 32

/* Rows that are factorized together. */
#define STAGES_BLOCK 32

/* What the solution may be off by, in levels, before it is refined. */
#define STAGES_OFF 1e-13

/* What a correction changes inputs by, in levels, that is worth another, and how many at most. */
#define STAGES_AGAIN 1e-11
#define STAGES_ROUNDS 10

/* What inputs may be off by at the end, in levels. */
#define STAGES_LOOSE 1e-5

/* The place of the derivatives of stage k. */
static size_t stages_slot(const Stages *s, int k) { return s->alike ? 0 : (size_t)s->slot[k]; }

/* The place of the step of the recursion at stage k. */
static size_t stages_step(const Stages *s, int k) { return s->alike ? 0 : (size_t)s->step[k]; }

static int stages_rows(const Stages *s) { return s->inputs * (s->changes ? 2 : 1) + s->limited; }

/* C = A B of (rows, inner) and (inner, columns); with `upper`, right of the diagonal alone. */
SOLVER_WIDE static void stages_loops(int rows, int inner, int columns, const double *A, int lda,
                                     const double *B, int ldb, double *C, int ldc, int upper) {
  int i, j, k, r, c;
  for (i = 0; i + 4 <= rows; i += 4) {
    const double *a = A + (size_t)i * lda;
    double *to = C + (size_t)i * ldc;
    for (j = upper ? i : 0; j + 8 <= columns; j += 8) {
      double sum[4][8] = {{0.0}};
      for (k = 0; k < inner; k++) {
        const double *b = B + (size_t)k * ldb + j;
        for (r = 0; r < 4; r++)
          for (c = 0; c < 8; c++) sum[r][c] += a[(size_t)r * lda + k] * b[c];
      }
      for (r = 0; r < 4; r++)
        for (c = 0; c < 8; c++) to[(size_t)r * ldc + j + c] = sum[r][c];
    }
    for (; j < columns; j++) {
      double sum[4] = {0.0};
      for (k = 0; k < inner; k++)
        for (r = 0; r < 4; r++) sum[r] += a[(size_t)r * lda + k] * B[(size_t)k * ldb + j];
      for (r = 0; r < 4; r++) to[(size_t)r * ldc + j] = sum[r];
    }
  }
  for (; i < rows; i++) {
    double *to = C + (size_t)i * ldc;
    memset(to, 0, (size_t)columns * sizeof *to);
    for (k = 0; k < inner; k++)
      for (j = upper ? i : 0; j < columns; j++) to[j] += A[(size_t)i * lda + k] * B[(size_t)k * ldb + j];
  }
}

static void stages_product(const Stages *s, int rows, int inner, int columns, const double *A, int lda,
                           const double *B, int ldb, double *C, int ldc, int upper) {
  double one = 1.0, none = 0.0;
  int first, height;
  if (s->gemm == NULL || inner < STAGES_LARGE) {
    stages_loops(rows, inner, columns, A, lda, B, ldb, C, ldc, upper);
    return;
  }
  for (first = 0; first < rows; first += height) { /* as the BLAS sees them, all are transposed */
    int left = upper ? first : 0, width = columns - left;
    height = upper && rows - first > 2 * STAGES_LARGE ? 2 * STAGES_LARGE : rows - first;
    s->gemm("N", "N", &width, &height, &inner, &one, (double *)B + left, &ldb,
            (double *)A + (size_t)first * lda, &lda, &none, C + (size_t)first * ldc + left, &ldc);
  }
}

/* y += factor A'x of (rows, columns): a sum of rows, as all products with vectors here. */
SOLVER_WIDE static void stages_add(int rows, int columns, double factor, const double *A, const double *x,
                                   double *y) {
  int i, j;
  for (i = 0; i + 2 <= rows; i += 2) {
    const double *a = A + (size_t)i * columns, *b = a + columns;
    double p = factor * x[i], q = factor * x[i + 1];
    for (j = 0; j < columns; j++) y[j] += p * a[j] + q * b[j];
  }
  if (i < rows) {
    const double *a = A + (size_t)i * columns;
    for (j = 0; j < columns; j++) y[j] += factor * x[i] * a[j];
  }
}

/* C = A B of (rows, inner) and (inner, columns), of rows of a batch; small ones one by one. */
static void stages_times(const Stages *s, int rows, int inner, int columns, const double *A, int lda,
                         const double *B, double *C) {
  int i;
  if (rows > 1 && inner >= STAGES_LARGE) {
    stages_product(s, rows, inner, columns, A, lda, B, columns, C, columns, 0);
    return;
  }
  memset(C, 0, (size_t)rows * columns * sizeof *C);
  for (i = 0; i < rows; i++) stages_add(inner, columns, 1.0, B, A + (size_t)i * lda, C + (size_t)i * columns);
}

/* to = A' of (rows, columns), with lda and `width` numbers from row to row, in tiles. */
static void stages_transpose(int rows, int columns, const double *A, int lda, double *to, int width) {
  int i, j, r, c;
  for (i = 0; i < rows; i += 8)
    for (j = 0; j < columns; j += 8)
      for (c = j; c < columns && c < j + 8; c++)
        for (r = i; r < rows && r < i + 8; r++) to[(size_t)c * width + r] = A[(size_t)r * lda + c];
}

/*
 * Put what a stage does into a slot: derivatives A by z_k, B by u_k and C by u_{k-1}. The matrices
 * are stored by columns; C is NULL where inputs are no ramps. Thin stages need no B. Steps found
 * from the slot before are none any more.
 */
static void stages_set_motion(Stages *s, size_t slot, const double *A, const double *B, const double *C) {
  int n = s->states, a = s->thin ? 0 : s->inputs, m = s->ramp ? n - a : n, j;
  double *motion = s->motion + slot * (a + n) * n;
  if (!s->ramp) {
    memcpy(motion, B, (size_t)a * n * sizeof *motion);
    memcpy(motion + (size_t)a * n, A, (size_t)n * n * sizeof *motion);
  } else {
    memset(motion, 0, (size_t)(a + n) * n * sizeof *motion);
    for (j = 0; j < a; j++) {
      memcpy(motion + (size_t)j * n, B + (size_t)j * m, (size_t)m * sizeof *motion);
      motion[(size_t)j * n + m + j] = 1.0;
      memcpy(motion + (size_t)(n + j) * n, C + (size_t)j * m, (size_t)m * sizeof *motion);
    }
    for (j = 0; j < m; j++)
      memcpy(motion + (size_t)(a + j) * n, A + (size_t)j * m, (size_t)m * sizeof *motion);
  }
  stages_transpose(a + n, n, motion, n, s->motion_t + slot * (a + n) * n, a + n);
  for (j = 0; !s->alike && j < s->stages; j++)
    if (s->from[j] == (int)slot) s->from[j] = -1;
}

/* out = S h, or S'h, which must not be h. */
static void stages_unfactor(const Stages *s, int k, int transposed, const double *h, double *out) {
  int a = s->inputs;
  memset(out, 0, (size_t)a * sizeof *out);
  stages_add(a, a, 1.0, (transposed ? s->S : s->S_t) + stages_step(s, k) * a * a, h, out);
}

SOLVER_WIDE static int stages_finite(const double *values, size_t count) {
  size_t i;
  long long wrong = 0; /* as wide as the numbers, for registers of several */
  for (i = 0; i < count; i++) wrong |= !(fabs(values[i]) < INFINITY);
  return !wrong;
}

static double stages_largest(const double *values, size_t count) {
  double largest = 0.0;
  size_t i;
  for (i = 0; i < count; i++) largest = fmax(largest, fabs(values[i]));
  return largest;
}

/* Factorize rows of X = U'U in place, from what is right of the diagonal; whether X is definite. */
SOLVER_WIDE static int stages_factorize_rows(int first, int a, int width, double *X) {
  int i, j, k;
  for (i = first; i < a; i++) {
    double *row = X + (size_t)i * width, root;
    if (!(row[i] > 0.0) || !isfinite(row[i])) return 0;
    root = 1.0 / sqrt(row[i]);
    for (j = i; j < width; j++) row[j] *= root;
    for (k = i + 1; k < a; k++) {
      double *below = X + (size_t)k * width, factor = row[k];
      for (j = k; j < width; j++) below[j] -= factor * row[j];
    }
  }
  return 1;
}

/* Factorize X = U'U in place, a block of rows at a time; the work is as large as X. */
static int stages_factorize(const Stages *s, int a, int width, double *X, double *work) {
  int first, i, j;
  for (first = 0; first < a; first += STAGES_BLOCK) {
    int rows = a - first < STAGES_BLOCK ? a - first : STAGES_BLOCK, columns = width - first;
    double *block = X + (size_t)first * width + first, *above = X + first;
    double *sums = work + (size_t)rows * first;
    if (first) {
      stages_transpose(first, rows, above, width, work, first);
      stages_product(s, rows, first, columns, work, first, above, width, sums, columns, 1);
      for (i = 0; i < rows; i++)
        for (j = i; j < columns; j++) block[(size_t)i * width + j] -= sums[(size_t)i * columns + j];
    }
    if (!stages_factorize_rows(first, first + rows, width, X)) return 0;
  }
  return 1;
}

/*
 * Many inputs that move few states, with alike stages and a diagonal R: D R D = I, and D B' = V T
 * with orthonormal V such that T P T' is diagonal. Then S = D (I - V diag(1 - shrink) V'), and what
 * passes from stage to stage is in the span of V. There vectors of inputs are [w v s], which is for
 * V (w - v) + s, with w and v = V's of n numbers: one after another for all stages, w first. The s
 * of a row is what its own inputs are, and few of them are other than zero.
 */

/* Where v and s of a stage are in [w v s]. */
static size_t stages_thin_v(const Stages *s, int k) { return (size_t)(s->stages + k) * s->states; }

static size_t stages_thin_s(const Stages *s, int k) {
  return 2 * (size_t)s->stages * s->states + (size_t)k * s->inputs;
}

/* W in the span of V, the v of limited values, and the growth. */
static void stages_thin_prepare(Stages *s) {
  int n = s->states, p = s->limited, i, j, e;
  double *A = s->motion_t, *PA = s->work, least = INFINITY, most = 0.0, shrink = 1.0;
  for (i = 0; i < s->inputs; i++) {
    least = fmin(least, s->unit[i]);
    most = fmax(most, s->unit[i]);
  }
  for (i = 0; i < n; i++) shrink = fmin(shrink, s->shrink[i]);
  s->growth[0] = most / s->level * most / (least * shrink);
  stages_transpose(s->inputs, n, s->V, n, s->V_t, s->inputs);
  stages_product(s, n, n, n, s->P, n, A, n, PA, n, 0);
  stages_product(s, n, n, n, s->T, n, PA, n, s->W, n, 0);
  for (i = 0; i < n; i++)
    for (j = 0; j < n; j++) s->W[i * n + j] *= s->shrink[i];
  stages_transpose(n, n, s->W, n, s->W_t, n);
  s->reach[0] = stages_largest(s->W, (size_t)n * n);
  memset(s->limited_v, 0, (size_t)p * n * sizeof *s->limited_v);
  for (i = 0; i < p; i++)
    for (e = s->G_start[i]; e < s->G_start[i + 1]; e++)
      stages_add(1, n, s->G[e] / s->scale[i], s->V + (size_t)s->G_which[e] * n, s->unit + s->G_which[e],
                 s->limited_v + (size_t)i * n);
}

/*
 * f = S'(B't + g) as [w v s], of slopes g by inputs, and p -= W'f. With D g alone for s, f would be
 * a difference of numbers as large as multipliers are, where it is next to nothing.
 */
static void stages_thin_aim(const Stages *s, int k, const double *t, const double *g, double *f, double *p) {
  int n = s->states, a = s->inputs, i, j;
  double *w = f + (size_t)k * n, *v = f + stages_thin_v(s, k);
  double *rest = f + stages_thin_s(s, k);
  for (j = 0; j < a; j++) rest[j] = s->unit[j] * g[j];
  for (i = 0; i < n; i++) {
    w[i] = 0.0;
    for (j = 0; j < n; j++) w[i] += s->T[i * n + j] * t[j];
  }
  stages_add(n, a, 1.0, s->V_t, w, rest);
  memset(v, 0, (size_t)n * sizeof *v);
  stages_add(a, n, 1.0, s->V, rest, v);
  for (i = 0; i < n; i++) w[i] = s->shrink[i] * v[i];
  stages_add(n, n, -1.0, s->W, w, p);
}

/* u_k = S (x - f - W z) with x and f as [w v s], and drive, of which T' is what u does. */
static void stages_thin_input(const Stages *s, int k, const double *x, const double *f, const double *z,
                              double *u, double *drive) {
  int n = s->states, a = s->inputs, j;
  size_t w = (size_t)k * n, v = stages_thin_v(s, k), rest = stages_thin_s(s, k);
  double *c = drive + n;
  memset(drive, 0, (size_t)n * sizeof *drive);
  stages_add(n, n, -1.0, s->W_t, z, drive);
  memset(u, 0, (size_t)a * sizeof *u);
  for (j = 0; x != NULL && j < a; j++) u[j] = x[rest + j];
  for (j = 0; f != NULL && j < a; j++) u[j] -= f[rest + j];
  for (j = 0; j < n; j++) {
    drive[j] += (x == NULL ? 0.0 : x[w + j]) - (f == NULL ? 0.0 : f[w + j]);
    drive[j] *= s->shrink[j];
    c[j] = drive[j] - (x == NULL ? 0.0 : x[v + j]) + (f == NULL ? 0.0 : f[v + j]);
  }
  stages_add(n, a, 1.0, s->V_t, c, u);
  for (j = 0; j < a; j++) u[j] *= s->unit[j];
}

/* Find the states from the first on by these inputs: a simulation by x knows few digits of B u where
   x is large. */
static void stages_thin_follow(const Stages *s, const double *u, double *z) {
  int n = s->states, a = s->inputs, j, k;
  double *c = s->work, *scaled = c + n;
  for (k = 0; k < s->stages; k++, z += n, u += a) {
    for (j = 0; j < a; j++) scaled[j] = u[j] / s->unit[j];
    memset(c, 0, (size_t)n * sizeof *c);
    stages_add(a, n, 1.0, s->V, scaled, c);
    memcpy(z + n, s->gap + (size_t)k * n, (size_t)n * sizeof *z);
    stages_add(n, n, 1.0, s->T, c, z + n);
    stages_add(n, n, 1.0, s->motion, z, z + n);
  }
}

/* Whether costs differ from P right of the diagonal by no more than a part of their diagonal. */
SOLVER_WIDE static int stages_near(int n, double tolerance, const double *P, const double *cost,
                                   double *diagonal) {
  int i, j;
  for (i = 0; i < n; i++) diagonal[i] = P[(size_t)i * n + i];
  for (i = 0; i < n; i++) {
    const double *one = P + (size_t)i * n, *other = cost + (size_t)i * n;
    double square = tolerance * tolerance;
    long long wrong = 0;
    for (j = i; j < n; j++) {
      double off = one[j] - other[j];
      wrong |= !(off * off <= square * (diagonal[i] * diagonal[j]));
    }
    if (wrong) return 0;
  }
  return 1;
}

/* A step of the recursion found from the slot of stage k and a cost near P; -1 if there is none. */
static int stages_known(const Stages *s, int k, const double *P, double tolerance) {
  size_t square = (size_t)s->states * s->states;
  int step;
  for (step = 0; step < s->stages; step++)
    if (s->from[step] == s->slot[k] &&
        stages_near(s->states, tolerance, P, s->costs + square * step, s->work))
      return step;
  return -1;
}

/* A place for a step at stage k that no stage behind it has, nor, from before, one ahead of it. */
static int stages_free(const Stages *s, int k) {
  int step, i;
  for (step = 0; step < s->stages; step++) {
    for (i = 0; i < s->stages && (i == k || s->step[i] != step); i++);
    if (i == s->stages) break;
  }
  return step;
}

/*
 * Find a step of the recursion: S and W of a stage, and the cost before it, which nothing needs of
 * the `first`. Returns whether R and what is added to it are definite.
 */
static int stages_find_step(Stages *s, size_t step, size_t slot, int first) {
  int n = s->states, a = s->inputs, w = a + n, m = s->ramp ? n - a : n, i, j;
  double *Y = s->work, *X = Y + (size_t)w * w, *before = s->before + step * n * n;
  double *S = s->S + step * a * a, *W = s->W + step * a * n, *W_t = s->W_t + step * a * n;
  double most = 0.0, most_S = 0.0;
  stages_product(s, w, n, n, s->motion + slot * w * n, n, s->costs + step * n * n, n, Y, n, 0);
  stages_product(s, first ? a : w, n, w, Y, n, s->motion_t + slot * w * n, w, X, w, 1);
  for (i = 0; i < a; i++)
    for (j = i; j < a; j++) X[(size_t)i * w + j] += s->R[i * a + j];
  for (j = 0; s->cross != NULL && j < m; j++)
    for (i = 0; i < a; i++) X[(size_t)i * w + a + j] += s->cross[(size_t)j * a + i];
  /* With the columns of the states behind it, the factor is [U W]. */
  if (!stages_factorize(s, a, w, X, Y)) return 0;
  for (i = 0; i < a; i++) memcpy(W + (size_t)i * n, X + (size_t)i * w + a, (size_t)n * sizeof *W);
  stages_transpose(a, n, W, n, W_t, a);
  memset(S, 0, (size_t)a * a * sizeof *S);
  for (i = a - 1; i >= 0; i--) {
    double unit = 1.0 / X[(size_t)i * w + i];
    stages_add(a - 1 - i, a, -unit, S + (size_t)(i + 1) * a, X + (size_t)i * w + i + 1, S + (size_t)i * a);
    S[(size_t)i * a + i] += unit;
  }
  stages_transpose(a, a, S, a, s->S_t + step * a * a, a);
  for (i = 0; i < a; i++)
    for (j = i; j < a; j++) {
      most = fmax(most, fabs(X[(size_t)i * w + j]));
      most_S = fmax(most_S, fabs(S[(size_t)j * a + i]));
    }
  s->reach[step] = stages_largest(W, (size_t)a * n);
  s->growth[step] = most_S / s->level * most_S * most; /* |S| times the condition of U */
  if (first) return 1;
  stages_product(s, n, a, n, W_t, a, W, n, Y, n, 1);
  for (i = 0; i < n; i++)
    for (j = i; j < n; j++)
      before[(size_t)i * n + j] = before[(size_t)j * n + i] =
          X[(size_t)(a + i) * w + a + j] - Y[(size_t)i * n + j] + s->Q[i * n + j];
  return 1;
}

/*
 * The Riccati recursion. Returns whether R and what is added to it are definite. A stage takes a
 * step that is known of its derivatives, if the cost behind it was the same to the tolerance.
 */
static int stages_prepare(Stages *s, double tolerance) {
  size_t square = (size_t)s->states * s->states;
  const double *P = s->P;
  int k;
  if (s->alike) {
    memcpy(s->costs, s->P, square * sizeof *P);
    if (!s->thin) return stages_find_step(s, 0, 0, 1);
    stages_thin_prepare(s);
    return 1;
  }
  for (k = s->stages - 1; k >= 0; k--) {
    int step = stages_known(s, k, P, tolerance);
    if (step < 0) {
      step = stages_free(s, k);
      memcpy(s->costs + square * step, P, square * sizeof *P);
      s->from[step] = -1;
      if (!stages_find_step(s, (size_t)step, (size_t)s->slot[k], k == 0)) return 0;
      s->from[step] = k ? s->slot[k] : -1;
    }
    s->step[k] = step;
    P = s->before + square * step;
  }
  return 1;
}

/* Add what limit `kind` of a stage has by [u_k; z_k] of the stage, or of the one before it. */
static void stages_enter(const Stages *s, int stage, int kind, int k, double factor, double *by_all) {
  int a = s->inputs, p = s->limited, m = s->ramp ? s->states - a : s->states, j;
  int values = stages_rows(s) - p; /* where limited values begin */
  size_t at = s->alike ? 0 : (size_t)k;
  if (kind >= a && kind < values && k >= stage - 1)
    by_all[kind - a] += (k == stage ? factor : -factor) / s->level;
  if (k != stage) return;
  if (kind < a) by_all[kind] += factor / s->level;
  if (kind < values) return;
  kind -= values;
  factor /= s->scale[kind];
  if (s->alike)
    for (j = s->G_start[kind]; j < s->G_start[kind + 1]; j++) by_all[s->G_which[j]] += factor * s->G[j];
  else
    for (j = 0; j < a; j++) by_all[j] += factor * s->G[(at * a + j) * p + kind];
  for (j = 0; j < m; j++) by_all[a + j] += factor * s->E[(at * m + j) * p + kind];
}

/* Add what limit `kind` of stage k has by z_{k+1}. */
static void stages_enter_ahead(const Stages *s, int k, int kind, double factor, double *ahead) {
  int p = s->limited, m = s->ramp ? s->states - s->inputs : s->states, j;
  size_t at = s->alike ? 0 : (size_t)k;
  kind -= stages_rows(s) - p;
  for (j = 0; s->ahead && kind >= 0 && j < m; j++)
    ahead[j] += factor / s->scale[kind] * s->F[(at * m + j) * p + kind];
}

/* What C adds to by_all, [u_k; z_k], of departures of state and input from their targets. */
static void stages_cross(const Stages *s, const double *z, const double *u, double *by_all) {
  int a = s->inputs, m = s->ramp ? s->states - a : s->states, i, j;
  for (j = 0; j < m; j++) {
    const double *c = s->cross + (size_t)j * a;
    for (i = 0; i < a; i++) {
      by_all[i] += c[i] * z[j];
      by_all[a + j] += c[i] * u[i];
    }
  }
}

/* Add the limits of stage k with their multipliers to slopes by [u_k; z_k]; `ahead`: by z_{k+1}. */
static void stages_add_limits(const Stages *s, int k, const double *y, double *by_all, double *ahead) {
  int rows = stages_rows(s), i;
  const double *here = y + (size_t)k * rows, *next = here + rows;
  for (i = 0; i < rows; i++) {
    if (here[i] == 0.0) continue;
    stages_enter(s, k, i, k, here[i], by_all);
    stages_enter_ahead(s, k, i, here[i], ahead);
  }
  for (i = s->inputs; s->changes && k + 1 < s->stages && i < 2 * s->inputs; i++)
    if (next[i] != 0.0) stages_enter(s, k + 1, i, k, next[i], by_all);
}

/*
 * Find f of departures from the targets, z of (N + 1, n) and u of (N, a), from which the motion has
 * these gaps (NULL: none), with multipliers of the limits (NULL: zeros). It is the slope by x.
 */
static void stages_aim(const Stages *s, const double *z, const double *u, const double *gap, const double *y,
                       double *f) {
  int n = s->states, a = s->inputs, w = a + n, moved = s->thin ? 0 : a, j, k;
  double *p = s->work, *t = p + n, *by_all = t + n;
  memset(p, 0, (size_t)n * sizeof *p);
  for (k = s->stages - 1; k >= 0; k--) {
    const double *z_k = z + (size_t)k * n, *u_k = u + (size_t)k * a;
    memset(by_all, 0, (size_t)w * sizeof *by_all);
    /* t = P_{k+1} d_k + p_{k+1} */
    memcpy(t, p, (size_t)n * sizeof *t);
    stages_add(n, n, 1.0, k == s->stages - 1 ? s->P : s->Q, z_k + n, t);
    if (gap != NULL) stages_add(n, n, 1.0, s->costs + stages_step(s, k) * n * n, gap + (size_t)k * n, t);
    if (y != NULL) stages_add_limits(s, k, y, by_all, t);
    /* f = S'(B't + R (u - s) + C'(z - r)),   p_k = A't + C (u - s) - W'f */
    for (j = 0; s->thin && j < a; j++) by_all[j] += u_k[j] / (s->unit[j] * s->unit[j]);
    stages_add(moved, a, 1.0, s->R, u_k, by_all);
    if (s->cross != NULL) stages_cross(s, z_k, u_k, by_all);
    stages_add(n, moved + n, 1.0, s->motion_t + stages_slot(s, k) * (moved + n) * n, t, by_all + a - moved);
    memcpy(p, by_all + a, (size_t)n * sizeof *p);
    if (s->thin) {
      stages_thin_aim(s, k, t, by_all, f, p);
      continue;
    }
    stages_unfactor(s, k, 1, by_all, f + (size_t)k * a);
    stages_add(a, n, -1.0, s->W + stages_step(s, k) * a * n, f + (size_t)k * a, p);
  }
}

/* u_k = S_k (x_k - f_k - W_k z_k); x and f may be NULL: zeros. */
static void stages_input(const Stages *s, int k, const double *x, const double *f, const double *z,
                         double *u) {
  int n = s->states, a = s->inputs, j;
  size_t at = (size_t)k * a;
  double *h = s->work;
  if (s->thin) {
    stages_thin_input(s, k, x, f, z, u, h);
    return;
  }
  for (j = 0; j < a; j++) h[j] = (x == NULL ? 0.0 : x[at + j]) - (f == NULL ? 0.0 : f[at + j]);
  stages_add(n, a, -1.0, s->W_t + stages_step(s, k) * a * n, z, h);
  stages_unfactor(s, k, 0, h, u);
}

/*
 * Simulate from the first state in z, of (N + 1, n), with u_k = S_k (x_k - f_k - W_k z_k), of
 * (N, a). x, f and the gaps may be NULL: zeros.
 */
static void stages_simulate(const Stages *s, const double *x, const double *f, const double *gap, double *z,
                            double *u) {
  int n = s->states, a = s->inputs, moved = s->thin ? 0 : a, k;
  for (k = 0; k < s->stages; k++, z += n, u += a) {
    const double *motion = s->motion + stages_slot(s, k) * (moved + n) * n;
    stages_input(s, k, x, f, z, u);
    if (gap != NULL) memcpy(z + n, gap + (size_t)k * n, (size_t)n * sizeof *z);
    else memset(z + n, 0, (size_t)n * sizeof *z);
    if (s->thin) stages_add(n, n, 1.0, s->T, s->work, z + n);
    stages_add(moved, n, 1.0, motion, u, z + n);
    stages_add(n, n, 1.0, motion + (size_t)moved * n, z, z + n);
  }
}

/* The values of all limits at states and inputs, in their units: of each stage in turn. */
static void stages_limits(const Stages *s, const double *z, const double *u, double *out) {
  int n = s->states, a = s->inputs, p = s->limited, m = s->ramp ? n - a : n, i, j, k;
  for (k = 0; k < s->stages; k++, z += n, u += a) {
    size_t at = s->alike ? 0 : (size_t)k;
    for (i = 0; i < a; i++) *out++ = u[i] / s->level;
    if (s->changes)
      for (i = 0; i < a; i++) *out++ = (u[i] - (k ? u[i - a] : 0.0)) / s->level;
    if (!p) continue;
    memset(out, 0, (size_t)p * sizeof *out);
    stages_add(m, p, 1.0, s->E + at * m * p, z, out);
    if (s->alike)
      for (i = 0; i < p; i++)
        for (j = s->G_start[i]; j < s->G_start[i + 1]; j++) out[i] += s->G[j] * u[s->G_which[j]];
    else stages_add(a, p, 1.0, s->G + at * a * p, u, out);
    if (s->ahead) stages_add(m, p, 1.0, s->F + at * m * p, z + n, out);
    for (i = 0; i < p; i++) *out++ /= s->scale[i];
  }
}

/*
 * Rows of the matrix of limits, ACTIVE_SET_BATCH at most: for each, a numbers for each stage up to
 * its own. In the sweep back they are rows of matrices, from their own stages on.
 */
static void stages_batch(const Stages *s, int count, const int *which, double *const *out) {
  int n = s->states, a = s->inputs, w = a + n, rows = stages_rows(s), live = 0, k, r, j;
  int order[ACTIVE_SET_BATCH]; /* of late stages first */
  double *by_all = s->work, *ahead = by_all + (size_t)count * w;
  double *x = ahead + (size_t)count * n, *t = x + (size_t)count * a;
  for (r = 0; r < count; r++) {
    for (j = r; j > 0 && which[order[j - 1]] / rows < which[r] / rows; j--) order[j] = order[j - 1];
    order[j] = r;
  }
  for (k = count ? which[order[0]] / rows : -1; k >= 0; k--) {
    for (; live < count && which[order[live]] / rows == k; live++) {
      double *own = ahead + (size_t)live * n;
      memset(own, 0, (size_t)n * sizeof *own);
      stages_enter_ahead(s, k, which[order[live]] % rows, 1.0, own);
    }
    /* x = S'(g + B'ahead),   ahead = e + A'ahead - W'x */
    stages_times(s, live, n, w, ahead, n, s->motion_t + stages_slot(s, k) * w * n, by_all);
    for (r = 0; r < live; r++) {
      int i = which[order[r]];
      stages_enter(s, i / rows, i % rows, k, 1.0, by_all + (size_t)r * w);
    }
    stages_times(s, live, a, a, by_all, w, s->S + stages_step(s, k) * a * a, x); /* S'h */
    for (r = 0; r < live; r++)
      memcpy(out[order[r]] + (size_t)k * a, x + (size_t)r * a, (size_t)a * sizeof *x);
    stages_times(s, live, a, n, x, a, s->W + stages_step(s, k) * a * n, t);
    for (r = 0; r < live; r++)
      for (j = 0; j < n; j++) ahead[(size_t)r * n + j] = by_all[(size_t)r * w + a + j] - t[(size_t)r * n + j];
  }
}

/* What a row has in s of [w v s] at one stage: numbers times a factor and D, and its v. */
typedef struct {
  int stage, count, own; /* own: the one input, where there are no entries of G */
  const int *which;
  const double *by, *v;
  double factor, v_factor;
} StagesPart;

/* Find the parts of row i, one or two; returns how many. */
static int stages_thin_parts(const Stages *s, int i, StagesPart *part) {
  int a = s->inputs, rows = stages_rows(s), kind = i % rows, values = rows - s->limited;
  part->stage = i / rows;
  if (kind >= values) {
    kind -= values;
    part->count = s->G_start[kind + 1] - s->G_start[kind];
    part->which = s->G_which + s->G_start[kind];
    part->by = s->G + s->G_start[kind];
    part->v = s->limited_v + (size_t)kind * s->states;
    part->factor = 1.0 / s->scale[kind];
    part->v_factor = 1.0;
    return 1;
  }
  part->own = kind % a;
  part->count = 1;
  part->which = &part->own;
  part->by = NULL;
  part->v = s->V + (size_t)part->own * s->states;
  part->factor = 1.0 / s->level;
  part->v_factor = s->unit[part->own] * part->factor;
  if (kind < a || part->stage == 0) return 1;
  part[1] = part[0];
  part[1].which = &part[1].own;
  part[1].stage--;
  part[1].factor = -part->factor;
  part[1].v_factor = -part->v_factor;
  return 2;
}

/* Number e of a part. */
static double stages_thin_number(const Stages *s, const StagesPart *part, int e) {
  return part->factor * s->unit[part->which[e]] * (part->by == NULL ? 1.0 : part->by[e]);
}

static double stages_thin_dot(const Stages *s, const double *a, const double *b) {
  double sum[4] = {0.0};
  int i, c;
  for (i = 0; i + 4 <= s->states; i += 4)
    for (c = 0; c < 4; c++) sum[c] += a[i + c] * b[i + c];
  for (; i < s->states; i++) sum[0] += a[i] * b[i];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* s's - v'v of two rows: their product is that of their w, and this. */
static double stages_thin_inner(void *data, int i, int j) {
  const Stages *s = &((StagesProgram *)data)->stages;
  StagesPart one[2], two[2];
  int ones = stages_thin_parts(s, i, one), twos = stages_thin_parts(s, j, two), c, d, e, f;
  double sum = 0.0;
  for (c = 0; c < ones; c++)
    for (d = 0; d < twos; d++) {
      if (one[c].stage != two[d].stage) continue;
      for (e = f = 0; e < one[c].count && f < two[d].count;) {
        int by = one[c].which[e] - two[d].which[f];
        if (by == 0) sum += stages_thin_number(s, one + c, e) * stages_thin_number(s, two + d, f);
        e += by <= 0;
        f += by >= 0;
      }
      sum -= one[c].v_factor * two[d].v_factor * stages_thin_dot(s, one[c].v, two[d].v);
    }
  return sum;
}

static double stages_thin_value(void *data, int i, const double *x) {
  const Stages *s = &((StagesProgram *)data)->stages;
  StagesPart parts[2], *part = parts;
  int count = stages_thin_parts(s, i, parts), e;
  double sum = 0.0;
  for (; count > 0; count--, part++) {
    const double *rest = x + stages_thin_s(s, part->stage);
    for (e = 0; e < part->count; e++) sum += stages_thin_number(s, part, e) * rest[part->which[e]];
    sum -= part->v_factor * stages_thin_dot(s, part->v, x + stages_thin_v(s, part->stage));
  }
  return sum;
}

static void stages_thin_add(void *data, double factor, int i, double *x) {
  const Stages *s = &((StagesProgram *)data)->stages;
  StagesPart parts[2], *part = parts;
  int count = stages_thin_parts(s, i, parts), e;
  for (; count > 0; count--, part++) {
    double *rest = x + stages_thin_s(s, part->stage), by = factor * part->v_factor;
    for (e = 0; e < part->count; e++) rest[part->which[e]] += factor * stages_thin_number(s, part, e);
    stages_add(1, s->states, 1.0, part->v, &by, x + stages_thin_v(s, part->stage));
  }
}

/* The square of V (w - v) + s, summed as it is: of a row that nearly depends on others, exact. */
static double stages_thin_square(void *data, const double *x) {
  const Stages *s = &((StagesProgram *)data)->stages;
  int n = s->states, a = s->inputs, j, k;
  double *c = s->work, *all = c + n, sum = 0.0;
  for (k = 0; k < s->stages; k++) {
    for (j = 0; j < n; j++) c[j] = x[(size_t)k * n + j] - x[stages_thin_v(s, k) + j];
    memcpy(all, x + stages_thin_s(s, k), (size_t)a * sizeof *all);
    stages_add(n, a, 1.0, s->V_t, c, all);
    for (j = 0; j < a; j++) sum += all[j] * all[j];
  }
  return sum;
}

static const ActiveSetRest stages_thin_rest = {stages_thin_inner, stages_thin_value, stages_thin_add,
                                               stages_thin_square};

/* The w of rows of the last stage: n numbers for each stage. */
static void stages_thin_batch(const Stages *s, int count, const int *which, double *const *out) {
  int n = s->states, r, c, i, j, k;
  double *ahead = s->work, *later = ahead + n;
  for (r = 0; r < count; r++) {
    StagesPart part[2];
    int parts = stages_thin_parts(s, which[r], part), stage = part->stage;
    int kind = which[r] % stages_rows(s) - stages_rows(s) + s->limited;
    memset(ahead, 0, (size_t)n * sizeof *ahead);
    stages_enter_ahead(s, stage, which[r] % stages_rows(s), 1.0, ahead);
    for (k = stage; k >= 0; k--) {
      double *w = out[r] + (size_t)k * n;
      for (i = 0; i < n; i++) { /* w = shrink (v + T ahead) */
        w[i] = stages_thin_dot(s, s->T + (size_t)i * n, ahead);
        for (c = 0; c < parts; c++)
          if (part[c].stage == k) w[i] += part[c].v_factor * part[c].v[i];
        w[i] *= s->shrink[i];
      }
      /* ahead = e + A'ahead - W'w */
      for (j = 0; j < n; j++)
        later[j] = k == stage && kind >= 0 ? s->E[(size_t)j * s->limited + kind] / s->scale[kind] : 0.0;
      stages_add(n, n, 1.0, s->motion_t, ahead, later);
      stages_add(n, n, -1.0, s->W, w, later);
      memcpy(ahead, later, (size_t)n * sizeof *ahead);
    }
  }
}

static void stages_program_batch(void *data, int count, const int *which, double *const *space,
                                 const double **entries, int *length) {
  StagesProgram *program = data;
  const Stages *s = &program->stages;
  int rows = stages_rows(s), end = s->stages - 1, unknown = 0, j;
  int width = s->thin ? s->states : s->inputs; /* numbers of a row at a stage */
  int kinds[ACTIVE_SET_BATCH];
  double *last[ACTIVE_SET_BATCH];
  for (j = 0; j < count; j++) {
    int kind = which[j] % rows, before = end - which[j] / rows;
    length[j] = (which[j] / rows + 1) * width;
    entries[j] = space[j];
    if (!s->alike) continue;
    /* Rows of earlier stages are the end of that of the last. */
    last[unknown] = program->last + (size_t)kind * s->stages * width;
    entries[j] = last[unknown] + (size_t)before * width;
    if (!program->known[kind]) kinds[unknown++] = end * rows + kind;
    program->known[kind] = 1;
  }
  if (s->thin) stages_thin_batch(s, unknown, kinds, last);
  else if (s->alike) stages_batch(s, unknown, kinds, last);
  else stages_batch(s, count, which, space);
}

static void stages_program_products(void *data, const double *x, double *out) {
  StagesProgram *program = data;
  const Stages *s = &program->stages;
  if (program->set.count == 0) { /* then x is zero */
    memset(out, 0, (size_t)program->set.rows * sizeof *out);
    return;
  }
  memset(program->dz, 0, (size_t)s->states * sizeof *program->dz);
  stages_simulate(s, x, NULL, NULL, program->dz, program->du);
  stages_limits(s, program->dz, program->du, out);
  program->moved = 1;
}

/* Forget the steps of the recursion; each stage has a place of its own for derivatives. */
static void stages_forget(Stages *s) {
  int k;
  for (k = 0; k < s->stages; k++) {
    s->slot[k] = k;
    s->step[k] = k;
    s->from[k] = -1;
  }
}

/* Take `count` numbers of memory. */
static double *stages_take(double **memory, size_t count) {
  double *taken = *memory;
  *memory += count;
  return taken;
}

/* Take the memory of the stages. */
static void stages_place(Stages *s, double **memory) {
  size_t N = (size_t)s->stages, n = (size_t)s->states, a = (size_t)s->inputs;
  size_t m = s->ramp ? n - a : n, many = s->alike ? 1 : N; /* of each matrix */
  size_t moved = s->thin ? 0 : a, factors = s->thin ? n : a;
  s->motion = stages_take(memory, many * (moved + n) * n);
  s->motion_t = stages_take(memory, many * (moved + n) * n);
  s->values = stages_take(memory, N * (size_t)s->limited);
  s->gap = stages_take(memory, N * n);
  s->costs = stages_take(memory, many * n * n);
  s->before = stages_take(memory, many * n * n);
  s->S = stages_take(memory, many * moved * a);
  s->S_t = stages_take(memory, many * moved * a);
  s->W = stages_take(memory, many * factors * n);
  s->W_t = stages_take(memory, many * factors * n);
  s->V_t = stages_take(memory, s->thin ? a * n : 0);
  s->limited_v = stages_take(memory, s->thin ? (size_t)s->limited * n : 0);
  s->first = stages_take(memory, STAGES_COLUMNS(s->thin, N, n, a));
  s->work = stages_take(memory, STAGES_WORK(s->thin, n, a));
  s->z = stages_take(memory, (N + 1) * m);
  s->u = stages_take(memory, (N + 1) * a);
  s->growth = stages_take(memory, many);
  s->reach = stages_take(memory, many);
  s->off_z = stages_take(memory, (N + 1) * n);
  s->off_u = stages_take(memory, N * a);
}

/* Take the memory that a program has where all stages are alike. */
static void stages_program_place_alike(StagesProgram *program, double **memory, int *integers) {
  Stages *s = &program->stages;
  size_t rows = (size_t)program->set.rows, n = (size_t)s->states, N = (size_t)s->stages;
  size_t a = (size_t)s->inputs, mapped = STAGES_MAPPED(rows, n);
  program->last = stages_take(memory, rows * (s->thin ? n : a));
  program->low_offset = stages_take(memory, rows);
  program->high_offset = stages_take(memory, rows);
  program->chosen = stages_take(memory, STAGES_COLUMNS(s->thin, N, n, a));
  program->drift = stages_take(memory, N * n);
  program->start = stages_take(memory, n);
  program->map = mapped ? stages_take(memory, mapped) : NULL;
  program->known = integers;
}

size_t stages_program_size(void) { return sizeof(StagesProgram); }

void stages_program_place(StagesProgram *program, const StagesSizes *sizes, double level, double tolerance,
                          StagesMultiply gemm, const StagesData *data, double *numbers, int *integers,
                          const double **pointers, size_t *counts, double **views) {
  Stages *s = &program->stages;
  ActiveSet *set = &program->set;
  size_t N = (size_t)sizes->stages, n = (size_t)sizes->states, a = (size_t)sizes->inputs;
  size_t p = (size_t)sizes->limited, rows = STAGES_ROWS(N, a, p, sizes->changes);
  size_t soft = (size_t)sizes->soft, most = STAGES_ACTIVE(sizes->alike, rows, N * a, soft);
  int thin = sizes->alike && sizes->thin;
  size_t columns = STAGES_COLUMNS(thin, N, n, a);
  counts[0] = STAGES_NUMBERS(sizes->alike, thin, N, n, a, p, rows, most);
  counts[1] = STAGES_INTEGERS(sizes->alike, N, rows, most);
  counts[2] = ACTIVE_SET_POINTERS(most);
  if (numbers == NULL) return;
  memset(program, 0, sizeof *program);
  s->stages = sizes->stages;
  s->states = sizes->states;
  s->inputs = sizes->inputs;
  s->limited = sizes->limited;
  s->ramp = sizes->ramp;
  s->changes = sizes->changes;
  s->ahead = sizes->ahead;
  s->alike = sizes->alike;
  s->thin = thin;
  s->level = level;
  s->gemm = gemm;
  s->Q = data->Q;
  s->R = data->R;
  s->P = data->P;
  s->cross = sizes->crossed ? data->cross : NULL;
  s->scale = data->scale;
  s->change = data->change;
  s->G_start = data->G_start;
  s->G_which = data->G_which;
  s->unit = data->unit;
  s->V = data->V;
  s->T = data->T;
  s->shrink = data->shrink;
  program->data = *data;
  set->rows = (int)rows;
  set->columns = (int)columns;
  set->most = (int)most;
  set->stored = !s->alike;
  set->limit = sizes->limit;
  set->tolerance = tolerance;
  set->price = data->price;
  set->curvature = data->curvature;
  set->batch = stages_program_batch;
  set->products = stages_program_products;
  set->rest = thin ? &stages_thin_rest : NULL;
  set->data = program;
  active_set_place(set, stages_take(&numbers, ACTIVE_SET_NUMBERS(rows, columns, most, set->stored)), integers,
                   pointers);
  integers += ACTIVE_SET_INTEGERS(rows, most);
  stages_place(s, &numbers);
  program->x = stages_take(&numbers, columns);
  program->none = stages_take(&numbers, columns);
  program->step = stages_take(&numbers, columns);
  program->lower = stages_take(&numbers, rows);
  program->upper = stages_take(&numbers, rows);
  program->values = stages_take(&numbers, rows);
  program->y = stages_take(&numbers, rows);
  program->dz = stages_take(&numbers, (N + 1) * n);
  program->du = stages_take(&numbers, N * a);
  program->by_z = stages_take(&numbers, (N + 1) * n);
  program->by_u = stages_take(&numbers, N * a);
  views[0] = s->z;
  views[1] = s->u;
  views[2] = program->y;
  views[3] = program->dz;
  views[4] = program->du;
  views[5] = s->gap;
  views[6] = s->values;
  if (s->alike) {
    stages_program_place_alike(program, &numbers, integers);
  } else {
    s->slot = integers;
    s->step = s->slot + N;
    s->from = s->step + N;
    stages_forget(s);
  }
  memset(program->none, 0, columns * sizeof *program->none);
  memset(program->y, 0, rows * sizeof *program->y);
}

void stages_program_shift(StagesProgram *program) {
  Stages *s = &program->stages;
  int rows = stages_rows(s), last = s->stages - 1, kept = rows * last;
  if (!s->alike) {
    int free = s->step[0];
    memmove(s->step, s->step + 1, (size_t)last * sizeof *s->step);
    s->step[last] = free;
  }
  memmove(program->y, program->y + rows, (size_t)kept * sizeof(double));
  memset(program->y + kept, 0, (size_t)rows * sizeof(double));
}

/* Find what the first state does to the limits, where all stages are alike. */
static void stages_program_find_map(StagesProgram *program) {
  const Stages *s = &program->stages;
  int j;
  for (j = 0; program->map != NULL && j < s->states; j++) {
    memset(program->dz, 0, (size_t)s->states * sizeof *program->dz);
    program->dz[j] = 1.0;
    stages_simulate(s, NULL, NULL, NULL, program->dz, program->du);
    stages_limits(s, program->dz, program->du, program->map + (size_t)j * (size_t)program->set.rows);
  }
}

int stages_program_prepare(StagesProgram *program, const int *slots, const int *fresh, double tolerance,
                           const double *ends, const double *A, const double *B, const double *C,
                           const double *limited, const double *E, const double *G, const double *F) {
  Stages *s = &program->stages;
  size_t a = (size_t)s->inputs, p = (size_t)s->limited, n = (size_t)s->states, m = n, k, i;
  size_t stages = s->alike ? 1 : (size_t)s->stages, by_input = a * p;
  if (s->ramp) m -= a;
  if (s->alike && p) by_input = (size_t)s->G_start[p];
  s->E = E;
  s->G = G;
  s->F = F;
  for (k = 0; k < stages; k++) {
    double *gap = s->gap + k * n;
    if (!stages_finite(ends + k * m, m) ||
        (p &&
         !(stages_finite(limited + k * p, p) && stages_finite(E + k * m * p, m * p) &&
           stages_finite(G + k * a * p, by_input) && (!s->ahead || stages_finite(F + k * m * p, m * p)))))
      return 0;
    memset(gap, 0, n * sizeof *gap);
    for (i = 0; i < m; i++) gap[i] = ends[k * m + i] - s->z[(k + 1) * m + i];
    for (i = 0; i < p; i++) s->values[k * p + i] = limited[k * p + i] / s->scale[i];
  }
  if (!s->alike && slots != NULL) memcpy(s->slot, slots, stages * sizeof *slots);
  for (k = 0; k < stages; k++) {
    size_t at = stages_slot(s, (int)k);
    if (fresh != NULL && !fresh[k]) continue;
    if (!(stages_finite(A + at * m * m, m * m) && (s->thin || stages_finite(B + at * a * m, a * m)) &&
          (!s->ramp || stages_finite(C + at * a * m, a * m))))
      return 0;
    stages_set_motion(s, at, A + at * m * m, B + at * a * m, s->ramp ? C + at * a * m : NULL);
  }
  if (!stages_prepare(s, tolerance)) return 0;
  if (!s->alike) {
    active_set_start(&program->set, program->y);
    return 1;
  }
  memset(program->known, 0, (size_t)stages_rows(s) * sizeof *program->known);
  stages_program_find_map(program);
  return 1;
}

/*
 * Bounds of all limits less their values, for what changes are limited from; NULL: zeros, and the
 * values are those of departures from z_0 = 0.
 */
static void stages_program_bounds(const StagesProgram *program, const double *previous, const double *value,
                                  double *lower, double *upper) {
  const Stages *s = &program->stages;
  const StagesData *data = &program->data;
  int a = s->inputs, p = s->limited, k, i;
  for (k = 0; k < s->stages; k++) {
    const double *u = s->u + (size_t)(k + 1) * a, *before = k ? u - a : previous;
    for (i = 0; i < a; i++, lower++, upper++, value++) {
      *lower = (data->low[i] - u[i]) / s->level - *value;
      *upper = (data->high[i] - u[i]) / s->level - *value;
    }
    for (i = 0; s->changes && i < a; i++, lower++, upper++, value++) {
      double change = (before == NULL ? 0.0 : before[i]) - u[i];
      *lower = (change - s->change[i]) / s->level - *value;
      *upper = (change + s->change[i]) / s->level - *value;
    }
    for (i = 0; i < p; i++, lower++, upper++, value++) {
      double here = s->values[(size_t)k * p + i] + *value;
      *lower = data->least[i] / s->scale[i] - here;
      *upper = data->most[i] / s->scale[i] - here;
    }
  }
}

void stages_program_aim(StagesProgram *program, const double *r, const double *aim, const double *r_0,
                        const double *drift) {
  Stages *s = &program->stages;
  int n = s->states, a = s->inputs, m = s->ramp ? n - a : n, j, k;
  memset(s->off_z, 0, (size_t)n * sizeof *s->off_z);
  for (j = 0; j < m; j++) s->off_z[j] = s->z[j] - (r_0 == NULL ? 0.0 : r_0[j]);
  for (k = 0; k < s->stages; k++) {
    double *u = s->off_u + (size_t)k * a, *z = s->off_z + (size_t)(k + 1) * n;
    for (j = 0; j < a; j++) u[j] = s->u[(size_t)(k + 1) * a + j] - aim[(size_t)k * a + j];
    for (j = 0; j < m; j++) z[j] = s->z[(size_t)(k + 1) * m + j] - r[(size_t)k * m + j];
    if (s->ramp) memcpy(z + m, u, (size_t)a * sizeof *u);
    for (j = 0; drift != NULL && j < m; j++) s->gap[(size_t)k * n + j] += drift[(size_t)k * m + j];
  }
  stages_aim(s, s->off_z, s->off_u, s->gap, NULL, s->first);
  s->farthest = stages_largest(s->first, STAGES_COLUMNS(s->thin, s->stages, n, a));
  if (!s->alike) return;
  memset(program->dz, 0, (size_t)s->states * sizeof *program->dz);
  stages_simulate(s, NULL, s->first, s->gap, program->dz, program->du);
  stages_limits(s, program->dz, program->du, program->values);
  stages_program_bounds(program, NULL, program->values, program->low_offset, program->high_offset);
}

/* Bounds of all limits less what they are without inputs of the program, where stages are alike. */
static void stages_program_move_bounds(StagesProgram *program, const double *previous) {
  const Stages *s = &program->stages;
  int rows = program->set.rows, a = s->inputs, i;
  double *value = program->values;
  if (program->map == NULL) {
    stages_simulate(s, NULL, NULL, NULL, program->dz, program->du);
    stages_limits(s, program->dz, program->du, value);
  } else {
    memset(value, 0, (size_t)rows * sizeof *value);
    stages_add(s->states, rows, 1.0, program->map, program->dz, value);
  }
  for (i = 0; i < rows; i++) {
    program->lower[i] = program->low_offset[i] - value[i];
    program->upper[i] = program->high_offset[i] - value[i];
  }
  for (i = a; s->changes && i < 2 * a; i++) {
    program->lower[i] += previous[i - a] / s->level;
    program->upper[i] += previous[i - a] / s->level;
  }
}

/* The first departure from the plan. */
static void stages_program_begin(StagesProgram *program, const double *state, const double *acting) {
  const Stages *s = &program->stages;
  int i, m = s->ramp ? s->states - s->inputs : s->states;
  for (i = 0; i < m; i++) program->dz[i] = state[i] - s->z[i];
  for (; i < s->states; i++) program->dz[i] = acting[i - m] - s->u[i - m];
}

/*
 * What round-off may have left of the conditions of the optimum, as an error of inputs in levels:
 * inputs are differences of f and W z, and x one of rows with their multipliers.
 */
static double stages_program_off(const StagesProgram *program, const double *state) {
  const Stages *s = &program->stages;
  const ActiveSet *set = &program->set;
  double growth = 0.0, reach = 0.0, largest = 0.0;
  int m = s->ramp ? s->states - s->inputs : s->states, k;
  for (k = 0; k < (s->alike ? 1 : s->stages); k++) {
    growth = fmax(growth, s->growth[stages_step(s, k)]);
    reach = fmax(reach, s->reach[stages_step(s, k)]);
  }
  for (k = 0; k < m; k++) largest = fmax(largest, reach * fabs(state[k] - s->z[k]));
  for (k = 0; k < set->count; k++)
    largest = fmax(largest, sqrt(set->pivot[k]) * fabs(set->y[set->active[k]]));
  return DBL_EPSILON * growth * fmax(largest, s->farthest) / sqrt(set->apart);
}

/*
 * Take out of the solution what round-off has left of the conditions of the optimum. Factors of a
 * problem whose weights differ by decades, or whose optimum without limits is far away, know few
 * digits of it; slopes and limits along the motion itself know them all. States and inputs take the
 * corrections: x may be so large that its round-off is more than those. The last one, of round-off
 * alone, is what inputs may still be off by. Returns a status.
 */
static int stages_program_refine(StagesProgram *program, const double *state, const double *acting,
                                 const double *previous) {
  Stages *s = &program->stages;
  int states = (s->stages + 1) * s->states, inputs = s->stages * s->inputs, round, i;
  double *z = program->dz, *u = program->du, *step = program->step;
  double *by_z = program->by_z, *by_u = program->by_u, moved = INFINITY, before;
  stages_program_begin(program, state, acting);
  stages_simulate(s, program->x, s->first, s->gap, z, u);
  for (round = 0; round < STAGES_ROUNDS && moved > STAGES_AGAIN; round++) {
    before = moved;
    if (s->thin) stages_thin_follow(s, u, z);
    stages_limits(s, z, u, program->values);
    stages_program_bounds(program, previous, program->values, program->lower, program->upper);
    for (i = 0; i < states; i++) by_z[i] = z[i] + s->off_z[i];
    for (i = 0; i < inputs; i++) by_u[i] = u[i] + s->off_u[i];
    stages_aim(s, by_z, by_u, NULL, program->set.y, step);
    for (i = 0; i < program->set.columns; i++) step[i] = -step[i];
    active_set_correct(&program->set, program->lower, program->upper, step);
    memset(by_z, 0, (size_t)s->states * sizeof *by_z);
    stages_simulate(s, step, NULL, NULL, by_z, by_u);
    moved = stages_largest(by_u, (size_t)inputs) / s->level;
    if (!(moved < 0.5 * before)) break;
    for (i = 0; i < states; i++) z[i] += by_z[i];
    for (i = 0; i < inputs; i++) u[i] += by_u[i];
  }
  return moved <= STAGES_LOOSE ? ACTIVE_SET_OK : ACTIVE_SET_INACCURATE;
}

/* Keep the solution, and find its first input, where all stages are alike. */
static void stages_program_choose(StagesProgram *program) {
  const Stages *s = &program->stages;
  int i;
  if (program->refined) {
    memcpy(program->chosen, program->du, (size_t)s->stages * s->inputs * sizeof(double));
    return;
  }
  for (i = 0; i < program->set.columns; i++) program->chosen[i] = program->x[i] - s->first[i];
  memcpy(program->drift, s->gap, (size_t)s->stages * s->states * sizeof *s->gap);
  memcpy(program->start, program->dz, (size_t)s->states * sizeof(double));
  stages_input(s, 0, program->chosen, NULL, program->start, program->du);
}

int stages_program_solve(StagesProgram *program, const double *state, const double *acting,
                         const double *previous, int (*stop)(void *)) {
  Stages *s = &program->stages;
  int status;
  stages_program_begin(program, state, acting);
  if (s->alike) { /* prepared once, moved on since */
    active_set_start(&program->set, program->y);
    stages_program_move_bounds(program, previous);
  } else {
    stages_simulate(s, NULL, s->first, s->gap, program->dz, program->du);
    stages_limits(s, program->dz, program->du, program->values);
    stages_program_bounds(program, previous, program->values, program->lower, program->upper);
  }
  program->set.stop = stop;
  program->moved = 0;
  status = active_set_solve(&program->set, program->none, program->lower, program->upper, program->x);
  if (status != ACTIVE_SET_OK) return status;
  program->refined = stages_program_off(program, state) > STAGES_OFF;
  if (program->refined) status = stages_program_refine(program, state, acting, previous);
  else if (s->alike || program->moved) stages_program_begin(program, state, acting);
  if (status != ACTIVE_SET_OK) return status;
  memcpy(program->y, program->set.y, (size_t)program->set.rows * sizeof(double));
  if (s->alike) stages_program_choose(program);
  else if (program->moved && !program->refined)
    stages_simulate(s, program->x, s->first, s->gap, program->dz, program->du);
  return status;
}

void stages_program_plan(StagesProgram *program) {
  const Stages *s = &program->stages;
  if (program->refined) {
    memcpy(program->du, program->chosen, (size_t)s->stages * s->inputs * sizeof(double));
    return;
  }
  memcpy(program->dz, program->start, (size_t)s->states * sizeof *program->dz);
  stages_simulate(s, program->chosen, NULL, program->drift, program->dz, program->du);
}

int stages_program_iterations(const StagesProgram *program) { return program->set.iterations; }
