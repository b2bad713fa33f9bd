/*
 * A linear-quadratic problem along a horizon as a least-distance program, without its matrix.
 *
 *     minimize    1/2 sum |z_k - r_k|_Q^2 + 1/2 sum |u_k - s_k|_R^2 + 1/2 |z_N - r_N|_P^2
 *     subject to  z_{k+1} = A_k z_k + B_k u_k + d_k
 *
 * A Riccati recursion gives U_k' U_k = R + B_k' P_{k+1} B_k and W_k = U_k^-T B_k' P_{k+1} A_k. With
 *
 *     u_k = S_k (x_k - f_k - W_k z_k),   S_k = U_k^-1,
 *
 * the cost is 1/2 |x|^2 and a constant: x = 0 is the optimum where nothing is limited. Limited are
 * inputs, their changes from stage to stage, and E_k z_k + G_k u_k + F_k z_{k+1}. The values of all
 * limits for some x take one simulation forward; a batch of rows of their matrix takes one sweep
 * backward.
 *
 * Where inputs are ramps, the state is z and the input before. States and inputs are departures
 * from a plan. Matrices are stored by rows. There are no globals, and no memory is allocated.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

/* The same operations, so the same numbers, in wider registers where the machine has them. */
#ifdef STAGES_WIDE
#elif defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define STAGES_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define STAGES_WIDE
#endif

#ifndef STAGES_API
#define STAGES_API static
#endif

/* Blocks from this size on are multiplied by the BLAS, where there is one. */
#define STAGES_LARGE 32

/* Rows that are factorized together. */
#define STAGES_BLOCK 32

typedef void (*StagesMultiply)(char *, char *, int *, int *, int *, double *, double *, int *,
                               double *, int *, double *, double *, int *);

typedef struct {
    /* sizes */
    int stages, states, inputs, limited; /* N; n, with the input before for ramps; a; p */
    int ramp, changes;                   /* whether inputs are ramps, and changes are limited */
    int alike; /* whether all stages have the same matrices, stored once, and P is that of the LQR */
    int *slot; /* (N): where the derivatives of a stage are; several stages may have the same */
    int *step; /* (N): where its step of the recursion is, also shared */
    int *from; /* (N): the slot that a step was found from; -1: the step is none */
    /* what does not change */
    double level;                             /* unit of an input */
    const double *Q, *R, *P, *scale, *change; /* (n, n) (a, a) (n, n); units of rows (p); (a) */
    StagesMultiply gemm;                      /* of the BLAS, or NULL */
    /* the plan */
    double *z, *u; /* (N + 1, n - a or n); (N + 1, a), the input before first */
    /* the problem linearized along it */
    double *motion, *motion_t;             /* by slots: (N, a + n, n), [B A]'; (N, n, a + n), [B A] */
    const double *E, *G, *F;               /* (N, n, p) (N, a, p) (N, n, p), by columns; of ramps
                                              E and F end before the inputs */
    double *values;                        /* (N, p), in their units */
    double *gap;                           /* (N, n): d */
    double *costs, *before;                /* by steps: (N, n, n), P behind a stage and before it */
    double *S, *S_t, *W, *W_t;             /* by steps: (N, a, a) twice; (N, a, n); (N, n, a) */
    double *first;                         /* (N, a): f */
    double *work;                          /* STAGES_WORK(n, a) */
    /* for many inputs that move few states, with alike stages: S = unit (I - Y Y') */
    int thin;
    const double *unit, *Y; /* (a); (a, n), in place of S, and Y' in place of S_t */
    int *span;              /* (a, 2), where columns of G begin and end, of alike stages */
    int ahead;              /* whether F may be other than zero */
} Stages;

#define STAGES_WORK(n, a) \
    ((size_t)((n) + (a)) * (2 * (size_t)((n) + (a)) + 3 * (size_t)ACTIVE_SET_BATCH + 6))

/* Numbers of the memory of a program. */
#define STAGES_NUMBERS(N, n, a, p, rows, soft)                                                   \
    (ACTIVE_SET_NUMBERS(rows, (N) * (a), ACTIVE_SET_MOST(rows, (N) * (a), soft), 1) +            \
     STAGES_OTHERS(N, N, n, a, p, rows))
#define STAGES_OTHERS(N, many, n, a, p, rows)                                                    \
    ((size_t)(many) * (2 * ((a) + (n)) * (n) + 2 * (n) * (n) + 2 * (a) * (a) + 2 * (a) * (n)) +  \
     (size_t)(N) * ((p) + (n) + 4 * (a)) + (size_t)((N) + 1) * (2 * (n) + (a)) +                 \
     4 * (size_t)(rows) + STAGES_WORK(n, a))

/* Integers of the memory, besides those of the active set. */
#define STAGES_INTEGERS(alike, N, a, rows) ((alike) ? (rows) / (N) + 2 * (a) : 3 * (size_t)(N))

/* Rows that may be active at once where all stages are alike, and so may be very many. */
#define STAGES_MOST 5000

/* The place of the derivatives of stage k. */
static size_t stages_slot(const Stages *s, int k)
{
    return s->alike ? 0 : (size_t)s->slot[k];
}

/* The place of the step of the recursion at stage k. */
static size_t stages_step(const Stages *s, int k)
{
    return s->alike ? 0 : (size_t)s->step[k];
}

static int stages_rows(const Stages *s)
{
    return s->inputs * (s->changes ? 2 : 1) + s->limited;
}

/* C = A B of (rows, inner) and (inner, columns); with `upper`, right of the diagonal alone. */
STAGES_WIDE static void stages_loops(int rows, int inner, int columns, const double *A, int lda,
                                     const double *B, int ldb, double *C, int ldc, int upper)
{
    int i, j, k, r, c;
    for (i = 0; i + 4 <= rows; i += 4) {
        const double *a = A + (size_t)i * lda;
        double *to = C + (size_t)i * ldc;
        for (j = upper ? i : 0; j + 8 <= columns; j += 8) {
            double sum[4][8] = {{0.0}};
            for (k = 0; k < inner; k++) {
                const double *b = B + (size_t)k * ldb + j;
                for (r = 0; r < 4; r++)
                    for (c = 0; c < 8; c++)
                        sum[r][c] += a[(size_t)r * lda + k] * b[c];
            }
            for (r = 0; r < 4; r++)
                for (c = 0; c < 8; c++)
                    to[(size_t)r * ldc + j + c] = sum[r][c];
        }
        for (; j < columns; j++) {
            double sum[4] = {0.0};
            for (k = 0; k < inner; k++)
                for (r = 0; r < 4; r++)
                    sum[r] += a[(size_t)r * lda + k] * B[(size_t)k * ldb + j];
            for (r = 0; r < 4; r++)
                to[(size_t)r * ldc + j] = sum[r];
        }
    }
    for (; i < rows; i++) {
        double *to = C + (size_t)i * ldc;
        memset(to, 0, (size_t)columns * sizeof *to);
        for (k = 0; k < inner; k++)
            for (j = upper ? i : 0; j < columns; j++)
                to[j] += A[(size_t)i * lda + k] * B[(size_t)k * ldb + j];
    }
}

static void stages_product(const Stages *s, int rows, int inner, int columns, const double *A,
                           int lda, const double *B, int ldb, double *C, int ldc, int upper)
{
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
                (double *)A + (size_t)first * lda, &lda, &none, C + (size_t)first * ldc + left,
                &ldc);
    }
}

/* y += factor A'x of (rows, columns): a sum of rows, as all products with vectors here. */
STAGES_WIDE static void stages_add(int rows, int columns, double factor, const double *A,
                                   const double *x, double *y)
{
    int i, j;
    for (i = 0; i + 2 <= rows; i += 2) {
        const double *a = A + (size_t)i * columns, *b = a + columns;
        double p = factor * x[i], q = factor * x[i + 1];
        for (j = 0; j < columns; j++)
            y[j] += p * a[j] + q * b[j];
    }
    if (i < rows) {
        const double *a = A + (size_t)i * columns;
        for (j = 0; j < columns; j++)
            y[j] += factor * x[i] * a[j];
    }
}

/* C = A B of (rows, inner) and (inner, columns), of rows of a batch; small ones one by one. */
static void stages_times(const Stages *s, int rows, int inner, int columns, const double *A,
                         int lda, const double *B, double *C)
{
    int i;
    if (rows > 1 && inner >= STAGES_LARGE) {
        stages_product(s, rows, inner, columns, A, lda, B, columns, C, columns, 0);
        return;
    }
    memset(C, 0, (size_t)rows * columns * sizeof *C);
    for (i = 0; i < rows; i++)
        stages_add(inner, columns, 1.0, B, A + (size_t)i * lda, C + (size_t)i * columns);
}

/* to = A' of (rows, columns), with lda and `width` numbers from row to row, in tiles. */
static void stages_transpose(int rows, int columns, const double *A, int lda, double *to, int width)
{
    int i, j, r, c;
    for (i = 0; i < rows; i += 8)
        for (j = 0; j < columns; j += 8)
            for (c = j; c < columns && c < j + 8; c++)
                for (r = i; r < rows && r < i + 8; r++)
                    to[(size_t)c * width + r] = A[(size_t)r * lda + c];
}

/*
 * Put what a stage does into a slot: derivatives A by z_k, B by u_k and C by u_{k-1}. The matrices
 * are stored by columns; C is NULL where inputs are no ramps. Steps found from the slot before are
 * none any more.
 */
static void stages_set_motion(Stages *s, size_t slot, const double *A, const double *B,
                              const double *C)
{
    int n = s->states, a = s->inputs, m = s->ramp ? n - a : n, j;
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
        if (s->from[j] == (int)slot)
            s->from[j] = -1;
}

/* out = S h, or S'h, which must not be h. */
static void stages_unfactor(const Stages *s, int k, int transposed, const double *h, double *out)
{
    int n = s->states, a = s->inputs, j;
    double *t = s->work + 4 * (size_t)(n + a); /* behind what callers use */
    if (!s->thin) {
        memset(out, 0, (size_t)a * sizeof *out);
        stages_add(a, a, 1.0, (transposed ? s->S : s->S_t) + stages_step(s, k) * a * a, h, out);
        return;
    }
    for (j = 0; j < a; j++)
        out[j] = transposed ? s->unit[j] * h[j] : h[j];
    memset(t, 0, (size_t)n * sizeof *t);
    stages_add(a, n, 1.0, s->Y, out, t);
    stages_add(n, a, -1.0, s->S_t, t, out);
    for (j = 0; !transposed && j < a; j++)
        out[j] *= s->unit[j];
}

static int stages_finite(const double *values, size_t count)
{
    size_t i;
    int wrong = 0;
    for (i = 0; i < count; i++)
        wrong |= !(fabs(values[i]) < INFINITY);
    return !wrong;
}

/* Find where columns of G are not zero, where all stages are alike. */
static void stages_find_spans(Stages *s)
{
    int a = s->inputs, p = s->limited, i, j;
    for (j = 0; j < a; j++) {
        int *span = s->span + 2 * j;
        span[0] = span[1] = 0;
        for (i = p - 1; i >= 0; i--)
            if (s->G[(size_t)j * p + i] != 0.0) {
                span[0] = i;
                span[1] = span[1] ? span[1] : i + 1;
            }
    }
}

/* Factorize rows of X = U'U in place, from what is right of the diagonal; whether X is definite. */
STAGES_WIDE static int stages_factorize_rows(int first, int a, int width, double *X)
{
    int i, j, k;
    for (i = first; i < a; i++) {
        double *row = X + (size_t)i * width, root;
        if (!(row[i] > 0.0) || !isfinite(row[i]))
            return 0;
        root = 1.0 / sqrt(row[i]);
        for (j = i; j < width; j++)
            row[j] *= root;
        for (k = i + 1; k < a; k++) {
            double *below = X + (size_t)k * width, factor = row[k];
            for (j = k; j < width; j++)
                below[j] -= factor * row[j];
        }
    }
    return 1;
}

/* Factorize X = U'U in place, a block of rows at a time; the work is as large as X. */
static int stages_factorize(const Stages *s, int a, int width, double *X, double *work)
{
    int first, i, j;
    for (first = 0; first < a; first += STAGES_BLOCK) {
        int rows = a - first < STAGES_BLOCK ? a - first : STAGES_BLOCK, columns = width - first;
        double *block = X + (size_t)first * width + first, *above = X + first;
        double *sums = work + (size_t)rows * first;
        if (first) {
            stages_transpose(first, rows, above, width, work, first);
            stages_product(s, rows, first, columns, work, first, above, width, sums, columns, 1);
            for (i = 0; i < rows; i++)
                for (j = i; j < columns; j++)
                    block[(size_t)i * width + j] -= sums[(size_t)i * columns + j];
        }
        if (!stages_factorize_rows(first, first + rows, width, X))
            return 0;
    }
    return 1;
}

/* W = S'B'P A of alike stages with few states: all that their recursion has to find. */
static void stages_prepare_thin(Stages *s)
{
    int n = s->states, a = s->inputs, i, j;
    double *PA = s->work, *T = PA + (size_t)n * n, *off = T + (size_t)n * n;
    stages_transpose(a, n, s->Y, n, s->S_t, a);
    stages_transpose(n, n, s->motion + (size_t)a * n, n, T, n); /* A */
    stages_product(s, n, n, n, s->costs, n, T, n, PA, n, 0);
    stages_product(s, a, n, n, s->motion, n, PA, n, s->W, n, 0);
    for (i = 0; i < a; i++)
        for (j = 0; j < n; j++)
            s->W[(size_t)i * n + j] *= s->unit[i];
    stages_product(s, n, a, n, s->S_t, a, s->W, n, T, n, 0);
    stages_product(s, a, n, n, s->Y, n, T, n, off, n, 0);
    for (i = 0; i < a * n; i++)
        s->W[i] -= off[i];
    stages_transpose(a, n, s->W, n, s->W_t, a);
}

/* Whether costs differ from P right of the diagonal by no more than a part of their diagonal. */
static int stages_near(int n, double tolerance, const double *P, const double *cost)
{
    int i, j;
    for (i = 0; i < n; i++)
        for (j = i; j < n; j++) {
            double off = P[(size_t)i * n + j] - cost[(size_t)i * n + j];
            double unit = P[(size_t)i * n + i] * P[(size_t)j * n + j];
            if (!(off * off <= tolerance * tolerance * unit))
                return 0;
        }
    return 1;
}

/* A step of the recursion found from the slot of stage k and a cost near P; -1 if there is none. */
static int stages_known(const Stages *s, int k, const double *P, double tolerance)
{
    size_t square = (size_t)s->states * s->states;
    int step;
    for (step = 0; step < s->stages; step++)
        if (s->from[step] == s->slot[k] &&
            stages_near(s->states, tolerance, P, s->costs + square * step))
            return step;
    return -1;
}

/* A place for a step at stage k that no stage behind it has, nor, from before, one ahead of it. */
static int stages_free(const Stages *s, int k)
{
    int step, i;
    for (step = 0; step < s->stages; step++) {
        for (i = 0; i < s->stages && (i == k || s->step[i] != step); i++)
            ;
        if (i == s->stages)
            break;
    }
    return step;
}

/*
 * Find a step of the recursion: S and W of a stage, and the cost before it, which nothing needs of
 * the `first`. Returns whether R and what is added to it are definite.
 */
static int stages_find_step(Stages *s, size_t step, size_t slot, int first)
{
    int n = s->states, a = s->inputs, w = a + n, i, j;
    double *Y = s->work, *X = Y + (size_t)w * w, *before = s->before + step * n * n;
    double *S = s->S + step * a * a, *W = s->W + step * a * n, *W_t = s->W_t + step * a * n;
    stages_product(s, w, n, n, s->motion + slot * w * n, n, s->costs + step * n * n, n, Y, n, 0);
    stages_product(s, first ? a : w, n, w, Y, n, s->motion_t + slot * w * n, w, X, w, 1);
    for (i = 0; i < a; i++)
        for (j = i; j < a; j++)
            X[(size_t)i * w + j] += s->R[i * a + j];
    /* With the columns of the states behind it, the factor is [U W]. */
    if (!stages_factorize(s, a, w, X, Y))
        return 0;
    for (i = 0; i < a; i++)
        memcpy(W + (size_t)i * n, X + (size_t)i * w + a, (size_t)n * sizeof *W);
    stages_transpose(a, n, W, n, W_t, a);
    memset(S, 0, (size_t)a * a * sizeof *S);
    for (i = a - 1; i >= 0; i--) {
        double unit = 1.0 / X[(size_t)i * w + i];
        stages_add(a - 1 - i, a, -unit, S + (size_t)(i + 1) * a, X + (size_t)i * w + i + 1,
                   S + (size_t)i * a);
        S[(size_t)i * a + i] += unit;
    }
    stages_transpose(a, a, S, a, s->S_t + step * a * a, a);
    if (first)
        return 1;
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
static int stages_prepare(Stages *s, double tolerance)
{
    size_t square = (size_t)s->states * s->states;
    const double *P = s->P;
    int k;
    if (s->alike) {
        memcpy(s->costs, s->P, square * sizeof *P);
        if (!s->thin)
            return stages_find_step(s, 0, 0, 1);
        stages_prepare_thin(s);
        return 1;
    }
    for (k = s->stages - 1; k >= 0; k--) {
        int step = stages_known(s, k, P, tolerance);
        if (step < 0) {
            step = stages_free(s, k);
            memcpy(s->costs + square * step, P, square * sizeof *P);
            s->from[step] = -1;
            if (!stages_find_step(s, (size_t)step, (size_t)s->slot[k], k == 0))
                return 0;
            s->from[step] = k ? s->slot[k] : -1;
        }
        s->step[k] = step;
        P = s->before + square * step;
    }
    return 1;
}

/*
 * Put in the costs of the plan: r of (N, n - a or n), s of (N, a), and what a load adds to each
 * state, (N, n - a or n) or NULL.
 */
static void stages_aim(Stages *s, const double *r, const double *aim, const double *drift)
{
    int n = s->states, a = s->inputs, m = s->ramp ? n - a : n, w = a + n, j, k;
    double *off = s->work, *p = off + n, *t = p + n, *by_all = t + n, *h = by_all + w;
    memset(off, 0, (size_t)n * sizeof *off);
    for (k = s->stages - 1; k >= 0; k--) {
        int last = k == s->stages - 1;
        const double *W = s->W + stages_step(s, k) * a * n;
        double *f = s->first + (size_t)k * a, *gap = s->gap + (size_t)k * n;
        for (j = 0; j < m; j++)
            off[j] = s->z[(size_t)(k + 1) * m + j] - r[(size_t)k * m + j];
        for (j = 0; j < a; j++)
            h[j] = s->u[(size_t)(k + 1) * a + j] - aim[(size_t)k * a + j];
        if (s->ramp)
            for (j = 0; j < a; j++)
                off[m + j] = last ? h[j] : 0.0;
        /* t = P_{k+1} d_k + p_{k+1} */
        if (last)
            memset(t, 0, (size_t)n * sizeof *t);
        else
            memcpy(t, p, (size_t)n * sizeof *t);
        stages_add(n, n, 1.0, last ? s->P : s->Q, off, t);
        if (drift != NULL)
            for (j = 0; j < m; j++)
                gap[j] += drift[(size_t)k * m + j];
        stages_add(n, n, 1.0, s->costs + stages_step(s, k) * n * n, gap, t);
        /* f = S'(B't + R (u - s)),   p_k = A't - W'f */
        memset(by_all, 0, (size_t)w * sizeof *by_all);
        for (j = 0; s->thin && j < a; j++)
            by_all[j] = h[j] / (s->unit[j] * s->unit[j]);
        if (!s->thin)
            stages_add(a, a, 1.0, s->R, h, by_all);
        stages_add(n, w, 1.0, s->motion_t + stages_slot(s, k) * w * n, t, by_all);
        stages_unfactor(s, k, 1, by_all, f);
        memcpy(p, by_all + a, (size_t)n * sizeof *p);
        stages_add(a, n, -1.0, W, f, p);
    }
}

/*
 * Simulate: z_1 ..., of (N + 1, n) where z_0 is the first, and u of (N, a). With `whole`, f and d
 * count; else they do not, and z_0 is zero. x may be NULL.
 */
static void stages_simulate(const Stages *s, const double *x, int whole, double *z, double *u)
{
    int n = s->states, a = s->inputs, w = a + n, j, k;
    double *h = s->work;
    if (!whole)
        memset(z, 0, (size_t)n * sizeof *z);
    for (k = 0; k < s->stages; k++, z += n, u += a) {
        const double *motion = s->motion + stages_slot(s, k) * w * n;
        for (j = 0; j < a; j++)
            h[j] = (x == NULL ? 0.0 : x[(size_t)k * a + j]) -
                   (whole ? s->first[(size_t)k * a + j] : 0.0);
        stages_add(n, a, -1.0, s->W_t + stages_step(s, k) * a * n, z, h);
        stages_unfactor(s, k, 0, h, u);
        if (whole)
            memcpy(z + n, s->gap + (size_t)k * n, (size_t)n * sizeof *z);
        else
            memset(z + n, 0, (size_t)n * sizeof *z);
        stages_add(a, n, 1.0, motion, u, z + n);
        stages_add(n, n, 1.0, motion + (size_t)a * n, z, z + n);
    }
}

/* The values of all limits at states and inputs, in their units: of each stage in turn. */
static void stages_limits(const Stages *s, const double *z, const double *u, double *out)
{
    int n = s->states, a = s->inputs, p = s->limited, m = s->ramp ? n - a : n, i, j, k;
    for (k = 0; k < s->stages; k++, z += n, u += a) {
        size_t at = s->alike ? 0 : (size_t)k;
        for (i = 0; i < a; i++)
            *out++ = u[i] / s->level;
        if (s->changes)
            for (i = 0; i < a; i++)
                *out++ = (u[i] - (k ? u[i - a] : 0.0)) / s->level;
        if (!p)
            continue;
        memset(out, 0, (size_t)p * sizeof *out);
        stages_add(m, p, 1.0, s->E + at * m * p, z, out);
        if (s->alike)
            for (j = 0; j < a; j++)
                for (i = s->span[2 * j]; i < s->span[2 * j + 1]; i++)
                    out[i] += s->G[(size_t)j * p + i] * u[j];
        else
            stages_add(a, p, 1.0, s->G + at * a * p, u, out);
        if (s->ahead)
            stages_add(m, p, 1.0, s->F + at * m * p, z + n, out);
        for (i = 0; i < p; i++)
            *out++ /= s->scale[i];
    }
}

/* What limit `kind` of a stage adds by [u_k; z_k] of the stage, or of the one before it. */
static void stages_enter(const Stages *s, int stage, int kind, int k, double *by_all)
{
    int a = s->inputs, p = s->limited, m = s->ramp ? s->states - a : s->states, j;
    int values = stages_rows(s) - p; /* where limited values begin */
    size_t at = s->alike ? 0 : (size_t)k;
    if (kind >= a && kind < values && k >= stage - 1)
        by_all[kind - a] += (k == stage ? 1.0 : -1.0) / s->level;
    if (k != stage)
        return;
    if (kind < a)
        by_all[kind] += 1.0 / s->level;
    if (kind < values)
        return;
    kind -= values;
    for (j = 0; j < a; j++)
        by_all[j] += s->G[(at * a + j) * p + kind] / s->scale[kind];
    for (j = 0; j < m; j++)
        by_all[a + j] += s->E[(at * m + j) * p + kind] / s->scale[kind];
}

/* What limit `kind` of stage k has by z_{k+1}. */
static void stages_enter_ahead(const Stages *s, int k, int kind, double *ahead)
{
    int n = s->states, p = s->limited, m = s->ramp ? n - s->inputs : n, j;
    size_t at = s->alike ? 0 : (size_t)k;
    memset(ahead, 0, (size_t)n * sizeof *ahead);
    kind -= stages_rows(s) - p;
    for (j = 0; s->ahead && kind >= 0 && j < m; j++)
        ahead[j] = s->F[(at * m + j) * p + kind] / s->scale[kind];
}

/* x = S'h for the first numbers of some rows of a + n, one after another; t is work. */
static void stages_unfactor_batch(const Stages *s, int k, int count, const double *rows, double *x,
                                  double *t)
{
    int n = s->states, a = s->inputs, w = a + n, r, j;
    double *off = t + (size_t)count * n;
    if (!s->thin) {
        stages_times(s, count, a, a, rows, w, s->S + stages_step(s, k) * a * a, x);
        return;
    }
    for (r = 0; r < count; r++)
        for (j = 0; j < a; j++)
            x[(size_t)r * a + j] = s->unit[j] * rows[(size_t)r * w + j];
    stages_times(s, count, a, n, x, a, s->Y, t);
    stages_times(s, count, n, a, t, n, s->S_t, off);
    for (j = 0; j < count * a; j++)
        x[j] -= off[j];
}

/*
 * Rows of the matrix of limits, ACTIVE_SET_BATCH at most: for each, a numbers for each stage up to
 * its own. In the sweep back they are rows of matrices, from their own stages on.
 */
static void stages_batch(const Stages *s, int count, const int *which, double *const *out)
{
    int n = s->states, a = s->inputs, w = a + n, rows = stages_rows(s), live = 0, k, r, j;
    int order[ACTIVE_SET_BATCH]; /* of late stages first */
    double *by_all = s->work, *ahead = by_all + (size_t)count * w;
    double *x = ahead + (size_t)count * n, *t = x + (size_t)count * a;
    for (r = 0; r < count; r++) {
        for (j = r; j > 0 && which[order[j - 1]] / rows < which[r] / rows; j--)
            order[j] = order[j - 1];
        order[j] = r;
    }
    for (k = count ? which[order[0]] / rows : -1; k >= 0; k--) {
        for (; live < count && which[order[live]] / rows == k; live++)
            stages_enter_ahead(s, k, which[order[live]] % rows, ahead + (size_t)live * n);
        /* x = S'(g + B'ahead),   ahead = e + A'ahead - W'x */
        stages_times(s, live, n, w, ahead, n, s->motion_t + stages_slot(s, k) * w * n, by_all);
        for (r = 0; r < live; r++) {
            int i = which[order[r]];
            stages_enter(s, i / rows, i % rows, k, by_all + (size_t)r * w);
        }
        stages_unfactor_batch(s, k, live, by_all, x, t);
        for (r = 0; r < live; r++)
            memcpy(out[order[r]] + (size_t)k * a, x + (size_t)r * a, (size_t)a * sizeof *x);
        stages_times(s, live, a, n, x, a, s->W + stages_step(s, k) * a * n, t);
        for (r = 0; r < live; r++)
            for (j = 0; j < n; j++)
                ahead[(size_t)r * n + j] = by_all[(size_t)r * w + a + j] - t[(size_t)r * n + j];
    }
}

/* The program of a horizon, and its plan: what a sample of nonlinear MPC takes. */
typedef struct {
    Stages stages;
    ActiveSet set;
    const double *low, *high, *least, *most; /* bounds of inputs (a), of limited values (p) */
    double *lower, *upper, *values, *y;      /* (rows) each; y: multipliers to start from */
    double *x, *none;                        /* (N a), none: zeros */
    double *dz, *du;                         /* (N + 1, n) and (N, a): departures from the plan */
    double *last; /* (rows of a stage, N a): of the last stage, where all stages are alike */
    int *known;   /* (rows of a stage), whether they are found */
    int moved;    /* whether the departures are no more those of x = 0 */
} StagesProgram;

static void stages_program_batch(void *data, int count, const int *which, double *const *space,
                                 const double **entries, int *length)
{
    StagesProgram *program = data;
    const Stages *s = &program->stages;
    int rows = stages_rows(s), end = s->stages - 1, a = s->inputs, unknown = 0, j;
    int kinds[ACTIVE_SET_BATCH];
    double *last[ACTIVE_SET_BATCH];
    for (j = 0; j < count; j++) {
        int kind = which[j] % rows, before = end - which[j] / rows;
        length[j] = (which[j] / rows + 1) * a;
        entries[j] = space[j];
        if (!s->alike)
            continue;
        /* Rows of earlier stages are the end of that of the last. */
        last[unknown] = program->last + (size_t)kind * s->stages * a;
        entries[j] = last[unknown] + (size_t)before * a;
        if (!program->known[kind])
            kinds[unknown++] = end * rows + kind;
        program->known[kind] = 1;
    }
    if (s->alike)
        stages_batch(s, unknown, kinds, last);
    else
        stages_batch(s, count, which, space);
}

static void stages_program_products(void *data, const double *x, double *out)
{
    StagesProgram *program = data;
    if (program->set.count == 0) { /* then x is zero */
        memset(out, 0, (size_t)program->set.rows * sizeof *out);
        return;
    }
    stages_simulate(&program->stages, x, 0, program->dz, program->du);
    stages_limits(&program->stages, program->dz, program->du, out);
    program->moved = 1;
}

/* Forget the steps of the recursion; each stage has a place of its own for derivatives. */
static void stages_forget(Stages *s)
{
    int k;
    for (k = 0; k < s->stages; k++) {
        s->slot[k] = k;
        s->step[k] = k;
        s->from[k] = -1;
    }
}

/* Take `count` numbers of memory. */
static double *stages_take(double **memory, size_t count)
{
    double *taken = *memory;
    *memory += count;
    return taken;
}

/*
 * Lay a program out in memory.
 *
 *     sizes    N, n, a, p; whether inputs are ramps, and changes are limited; soft rows; the most
 *              changes of the active set; whether limited values depend on z_{k+1}; whether all
 *              stages are alike, and are so with few states and a diagonal R: then the last data are
 *              the unit and Y
 *     data     Q, R, P, units of rows, limits of changes, bounds of inputs and of limited values,
 *              prices and curvatures of all rows: what does not change, and stays where it is
 *     numbers, integers, pointers
 *              memory of the sizes in `counts`, which is written first; NULL: nothing else is
 *     views    where z, u, y, the departures from the plan dz, du, the gaps, and the limited values
 *              of the plan in their units are
 */
STAGES_API void stages_program_place(StagesProgram *program, const int *sizes, double level,
                                     double tolerance, StagesMultiply gemm,
                                     const double *const *data, double *numbers, int *integers,
                                     const double **pointers, size_t *counts, double **views)
{
    Stages *s = &program->stages;
    ActiveSet *set = &program->set;
    size_t N = (size_t)sizes[0], n = (size_t)sizes[1], a = (size_t)sizes[2], p = (size_t)sizes[3];
    size_t rows, m = sizes[4] ? n - a : n, used, many = sizes[9] ? 1 : N; /* of each matrix */
    size_t narrow = a; /* columns of S */
    double *at = numbers;
    memset(program, 0, sizeof *program);
    s->stages = sizes[0];
    s->states = sizes[1];
    s->inputs = sizes[2];
    s->limited = sizes[3];
    s->ramp = sizes[4];
    s->changes = sizes[5];
    s->ahead = sizes[8];
    s->alike = sizes[9];
    s->thin = s->alike && sizes[10];
    if (s->thin)
        narrow = n;
    rows = N * (size_t)stages_rows(s);
    set->rows = (int)rows;
    set->columns = (int)(N * a);
    set->most = ACTIVE_SET_MOST(set->rows, set->columns, sizes[6]);
    if (s->alike && set->most > STAGES_MOST)
        set->most = STAGES_MOST;
    set->stored = !s->alike;
    set->limit = sizes[7];
    set->tolerance = tolerance;
    used = ACTIVE_SET_NUMBERS(set->rows, set->columns, set->most, set->stored);
    counts[0] = used + STAGES_OTHERS(N, many, n, a, p, rows) + (s->alike ? rows * a : 0);
    counts[1] = ACTIVE_SET_INTEGERS(set->rows, set->most) + STAGES_INTEGERS(s->alike, N, a, rows);
    counts[2] = ACTIVE_SET_POINTERS(set->most);
    if (numbers == NULL)
        return;
    s->level = level;
    s->gemm = gemm;
    s->Q = data[0];
    s->R = data[1];
    s->P = data[2];
    s->scale = data[3];
    s->change = data[4];
    if (s->thin) {
        s->unit = data[11];
        s->Y = data[12];
    }
    program->low = data[5];
    program->high = data[6];
    program->least = data[7];
    program->most = data[8];
    set->price = data[9];
    set->curvature = data[10];
    set->batch = stages_program_batch;
    set->products = stages_program_products;
    set->data = program;
    active_set_place(set, stages_take(&at, used), integers, pointers);
    s->motion = stages_take(&at, many * (a + n) * n);
    s->motion_t = stages_take(&at, many * (a + n) * n);
    s->values = stages_take(&at, N * p);
    s->gap = stages_take(&at, N * n);
    s->costs = stages_take(&at, many * n * n);
    s->before = stages_take(&at, many * n * n);
    s->S = stages_take(&at, s->thin ? 0 : many * a * a);
    s->S_t = stages_take(&at, many * a * narrow);
    s->W = stages_take(&at, many * a * n);
    s->W_t = stages_take(&at, many * a * n);
    s->first = stages_take(&at, N * a);
    s->work = stages_take(&at, STAGES_WORK(n, a));
    program->x = stages_take(&at, N * a);
    program->none = stages_take(&at, N * a);
    program->lower = stages_take(&at, rows);
    program->upper = stages_take(&at, rows);
    program->values = stages_take(&at, rows);
    views[0] = s->z = stages_take(&at, (N + 1) * m);
    views[1] = s->u = stages_take(&at, (N + 1) * a);
    views[2] = program->y = stages_take(&at, rows);
    views[3] = program->dz = stages_take(&at, (N + 1) * n);
    views[4] = program->du = stages_take(&at, N * a);
    views[5] = s->gap;
    views[6] = s->values;
    integers += ACTIVE_SET_INTEGERS(set->rows, set->most);
    if (s->alike) {
        program->last = stages_take(&at, rows * a);
        program->known = integers;
        s->span = program->known + rows / N;
    } else {
        s->slot = integers;
        s->step = s->slot + N;
        s->from = s->step + N;
        stages_forget(s);
    }
    memset(program->none, 0, N * a * sizeof *program->none);
    memset(program->y, 0, rows * sizeof *program->y);
}

/* Move the multipliers, and the steps of the recursion, on by a sample. */
STAGES_API void stages_program_shift(StagesProgram *program)
{
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

/*
 * All that needs no measurement: the problem along its plan, from the stage Jacobians of motion and
 * limited values, stored by columns, and the rows that may be active. E, G and F are not copied, and
 * must last for the solves. Returns whether data are finite; if they are not, all stages must be
 * fresh in the next call.
 *
 * A, B and C of stage k are in its slot. Only the slots of `fresh` stages are others than in the last
 * call. NULL for both: each stage has a slot of its own, and all are fresh. The tolerance is that of
 * the costs behind stages whose derivatives are known.
 */
STAGES_API int stages_program_prepare(StagesProgram *program, const int *slots, const int *fresh,
                                      double tolerance, const double *ends, const double *A,
                                      const double *B, const double *C, const double *limited,
                                      const double *E, const double *G, const double *F)
{
    Stages *s = &program->stages;
    size_t a = (size_t)s->inputs, p = (size_t)s->limited, n = (size_t)s->states, m = n, k, i;
    size_t stages = s->alike ? 1 : (size_t)s->stages;
    if (s->ramp)
        m -= a;
    s->E = E;
    s->G = G;
    s->F = F;
    for (k = 0; k < stages; k++) {
        double *gap = s->gap + k * n;
        if (!stages_finite(ends + k * m, m) ||
            (p && !(stages_finite(limited + k * p, p) && stages_finite(E + k * m * p, m * p) &&
                    stages_finite(G + k * a * p, a * p) &&
                    (!s->ahead || stages_finite(F + k * m * p, m * p)))))
            return 0;
        memset(gap, 0, n * sizeof *gap);
        for (i = 0; i < m; i++)
            gap[i] = ends[k * m + i] - s->z[(k + 1) * m + i];
        for (i = 0; i < p; i++)
            s->values[k * p + i] = limited[k * p + i] / s->scale[i];
    }
    if (!s->alike && slots != NULL)
        memcpy(s->slot, slots, stages * sizeof *slots);
    for (k = 0; k < stages; k++) {
        size_t at = stages_slot(s, (int)k);
        if (fresh != NULL && !fresh[k])
            continue;
        if (!(stages_finite(A + at * m * m, m * m) && stages_finite(B + at * a * m, a * m) &&
              (!s->ramp || stages_finite(C + at * a * m, a * m))))
            return 0;
        stages_set_motion(s, at, A + at * m * m, B + at * a * m,
                          s->ramp ? C + at * a * m : NULL);
    }
    if (!stages_prepare(s, tolerance))
        return 0;
    if (s->alike && p)
        stages_find_spans(s);
    if (s->alike)
        memset(program->known, 0, (size_t)stages_rows(s) * sizeof *program->known);
    active_set_start(&program->set, program->y);
    return 1;
}

/* The first departure from the plan. */
static void stages_program_begin(StagesProgram *program, const double *state,
                                 const double *acting)
{
    const Stages *s = &program->stages;
    int i, m = s->ramp ? s->states - s->inputs : s->states;
    for (i = 0; i < m; i++)
        program->dz[i] = state[i] - s->z[i];
    for (; i < s->states; i++)
        program->dz[i] = acting[i - m] - s->u[i - m];
}

/*
 * The rest: state, the input that acts before a ramp, targets, drift (NULL: none), the input that
 * changes are limited from, and what may stop the method (NULL: nothing). Returns a status of the active-set method; with 0 the departures from
 * the plan are those of the optimum, and the multipliers are kept.
 */
STAGES_API int stages_program_solve(StagesProgram *program, const double *state,
                                    const double *acting, const double *r, const double *aim,
                                    const double *drift, const double *previous,
                                    int (*stop)(void *))
{
    Stages *s = &program->stages;
    int a = s->inputs, p = s->limited, k, i, status;
    double *lower = program->lower, *upper = program->upper, *value = program->values;
    if (s->alike) /* prepared once, moved on since */
        active_set_start(&program->set, program->y);
    stages_aim(s, r, aim, drift);
    stages_program_begin(program, state, acting);
    stages_simulate(s, NULL, 1, program->dz, program->du);
    stages_limits(s, program->dz, program->du, value);
    for (k = 0; k < s->stages; k++) {
        const double *u = s->u + (size_t)(k + 1) * a, *before = k ? u - a : previous;
        for (i = 0; i < a; i++, lower++, upper++, value++) {
            *lower = (program->low[i] - u[i]) / s->level - *value;
            *upper = (program->high[i] - u[i]) / s->level - *value;
        }
        for (i = 0; s->changes && i < a; i++, lower++, upper++, value++) {
            *lower = (before[i] - u[i] - s->change[i]) / s->level - *value;
            *upper = (before[i] - u[i] + s->change[i]) / s->level - *value;
        }
        for (i = 0; i < p; i++, lower++, upper++, value++) {
            double here = s->values[(size_t)k * p + i] + *value;
            *lower = program->least[i] / s->scale[i] - here;
            *upper = program->most[i] / s->scale[i] - here;
        }
    }
    program->set.stop = stop;
    program->moved = 0;
    status = active_set_solve(&program->set, program->none, program->lower, program->upper,
                              program->x);
    if (status != ACTIVE_SET_OK)
        return status;
    memcpy(program->y, program->set.y,
           (size_t)s->stages * (size_t)stages_rows(s) * sizeof(double));
    if (program->moved) {
        stages_program_begin(program, state, acting);
        stages_simulate(s, program->x, 1, program->dz, program->du);
    }
    return status;
}

/* Changes of the active set in the last solve. */
STAGES_API int stages_program_iterations(const StagesProgram *program)
{
    return program->set.iterations;
}
