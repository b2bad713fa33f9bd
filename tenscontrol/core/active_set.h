/*
 * A dual active-set method for least-distance programs.
 *
 *     minimize    1/2 |x|^2 + q'x + sum_i (price_i s_i + 1/2 curvature_i s_i^2)
 *     subject to  low_i - s_i <= (M x)_i <= high_i + s_i,   s_i >= 0,   s_i = 0 in hard rows
 *
 * Bounds may be infinite, or equal; no two may cross. A row is soft where its price is finite; its
 * curvature is then positive. The violation of a soft row is no unknown: its multiplier is bounded
 * by the price while the row holds, and beyond it grows with the violation,
 * |y| = price + curvature s. Multipliers y have the sign of x + q + M'y = 0: positive at upper
 * bounds.
 *
 * The method is that of Goldfarb & Idnani (1983), doi:10.1007/BF02591962, on the LDL' factors of
 * the Gram matrix of the active rows, which follow each change by a rank-one update. The iterates
 * are multipliers, and rise in the dual problem until all rows hold. The last step is repeated on
 * the residuals of the answer, which is so exact to round-off.
 *
 * Rows are reached by two functions, so that M need not be a matrix:
 *
 *     products(data, x, out)        out = M x
 *     batch(data, count, which, space, entries, length)
 *                                   finds rows which[0] ... which[count - 1], ACTIVE_SET_BATCH of
 *                                   them at most, and none twice. Row which[j] is written to
 *                                   space[j], of `columns` numbers, or lies elsewhere and stays
 *                                   there; entries[j] is set to where it is, and length[j] to where
 *                                   zeros begin that last to its end.
 *
 * Rows may have a part beside their entries, by the functions in `rest`, for rows that have few
 * numbers other than zero, and for x in coordinates that are not orthonormal.
 *
 * All products cost much where M is no matrix. So the rows that are violated most by one are
 * reached in a batch, and are candidates: the set changes among itself and them while one of them
 * is violated, by no less than a part of what the worst row was, and only then are all products
 * found again. No row is violated at the end.
 *
 * How to use it:
 *
 *     ActiveSet set = {0};
 *     set.rows = ...; set.columns = ...; set.batch = ...; set.products = ...; set.data = ...;
 *     set.price = ...; set.curvature = ...;      both NULL if no row is soft; price INFINITY: hard
 *     set.most = ACTIVE_SET_MOST(rows, columns, soft);    active rows at most; fewer saves memory
 *     set.stored = 1;                            0 if `batch` never writes to `space`
 *     set.limit = 500; set.tolerance = 1e-11;    changes of the set; violation in units of a row
 *     active_set_place(&set, numbers, integers, pointers);
 *     active_set_start(&set, y);                 y of `rows` numbers, or NULL: nothing is active
 *     status = active_set_solve(&set, q, low, high, x);
 *     ...                                        set.y are the multipliers, 0 where inactive
 *
 * `active_set_start` may run before q, low and high are known: it reaches the rows where y is not
 * zero and factorizes them. Without it, a solve starts from the active set of the last one, whose
 * rows must not have changed. `numbers`, `integers` and `pointers` are memory of the sizes of the
 * macros below; nothing else is allocated, and there are no globals.
 */
#ifndef ACTIVE_SET_H
#define ACTIVE_SET_H

#include <stddef.h>
#include <stdint.h> /* also says whether the C library is that of GNU */

/* Functions that a shared library shows. */
#if defined(_WIN32)
#define SOLVER_API __declspec(dllexport)
#elif defined(__GNUC__)
#define SOLVER_API __attribute__((visibility("default")))
#else
#define SOLVER_API
#endif

/* The same operations, so the same numbers, in wider registers where the machine has them: in the
   library of the core, not in code for small machines. */
#if defined(TENSCONTROL_SOURCES) && defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && \
    !defined(__clang__)
#define SOLVER_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define SOLVER_WIDE
#endif

/* Statuses, by their numbers in tenscontrol/status.py. */
#define ACTIVE_SET_OK 0
#define ACTIVE_SET_INACCURATE 6        /* a violation could not be brought below the tolerance */
#define ACTIVE_SET_INFEASIBLE 7        /* hard rows contradict each other, or bounds cross */
#define ACTIVE_SET_OUT_OF_ITERATIONS 9 /* ... or more rows are active than `most` */
#define ACTIVE_SET_OUT_OF_TIME 10      /* `stop` said so */
#define ACTIVE_SET_BAD_DATA 14         /* q, bounds or rows are not finite */

/* Rows that are reached at once, at most. */
#ifndef ACTIVE_SET_BATCH
#define ACTIVE_SET_BATCH 32
#endif

/* Rows that can be active at once: independent ones, violated soft ones, and one that is added. */
#define ACTIVE_SET_MOST(rows, columns, soft) \
  ((rows) < (columns) + (soft) + 1 ? (rows) : (columns) + (soft) + 1)

/* Sizes of the memory; `columns` counts once more for each row where rows are stored. */
#define ACTIVE_SET_NUMBERS(rows, columns, most, stored)                                              \
  (2 * (size_t)(rows) + (columns) + 3 * (size_t)(most) + (size_t)(most) * ((size_t)(most) - 1) / 2 + \
   ((stored) ? (size_t)(most) * (columns) : 0))
#define ACTIVE_SET_INTEGERS(rows, most) ((size_t)(rows) + 5 * (size_t)(most))
#define ACTIVE_SET_POINTERS(most) ((size_t)(most))

/* What rows have beside their entries; x is all `columns` of it. */
typedef struct {
  double (*inner)(void *data, int i, int j);                /* what it adds to the product of rows i and j */
  double (*value)(void *data, int i, const double *x);      /* ... of row i and x */
  void (*add)(void *data, double factor, int i, double *x); /* ... to x + factor times row i */
  double (*square)(void *data, const double *x);            /* |x|^2, whole */
} ActiveSetRest;

typedef struct {
  /* given by the caller */
  int rows, columns, most, stored, limit;
  double tolerance;
  const double *price, *curvature;
  void (*products)(void *data, const double *x, double *out);
  void (*batch)(void *data, int count, const int *which, double *const *space, const double **entries,
                int *length);
  const ActiveSetRest *rest; /* NULL: nothing */
  int (*stop)(void *data);   /* asked at each change; NULL: never stops */
  void *data;
  /* answer, besides x */
  double *y;      /* (rows) */
  int iterations; /* changes of the active set in the last solve */
  double apart;   /* the least distance, squared, from the span of others at which a row was added, as
                       a part of its length */
  /* the active set */
  int count, singular;         /* whether the last active row depends on the others */
  int candidates;              /* how many are behind the active rows in the lists of rows */
  int *place;                  /* (rows), of a row among the active ones; -1 if it is not, -2 if barred */
  int *active, *length, *slot; /* (most), lists of rows: which, and where they are stored */
  const double **entries;      /* (most), a list of rows as well */
  int *side, *violated;        /* (most), of the active rows */
  double *stored_rows, *factor, *pivot; /* of L D L' */
  double *product, *step, *residual, *column;
} ActiveSet;

/* Give the solver its memory. Nothing is active then. */
SOLVER_API void active_set_place(ActiveSet *set, double *numbers, int *integers, const double **pointers);

/* Forget the active set, and begin with the rows whose multiplier is not zero; y may be NULL. */
SOLVER_API void active_set_start(ActiveSet *set, const double *y);

/* Solve. Returns a status; x, of `columns` numbers, is the answer where that is 0. */
SOLVER_API int active_set_solve(ActiveSet *set, const double *q, const double *low, const double *high,
                                double *x);

/*
 * Correct the last answer by residuals that are known better than its rows say them: bounds less
 * the values of the rows, and in `step` what the slope x + q + M'y is less than zero by. The step to
 * add to x is written there; the multipliers are corrected.
 */
SOLVER_API void active_set_correct(ActiveSet *set, const double *low, const double *high, double *step);

#endif
