/*
 * A linear-quadratic problem along a horizon as a least-distance program, without its matrix.
 *
 *     minimize    1/2 sum |z_k - r_k|_Q^2 + 1/2 sum |u_k - s_k|_R^2 + 1/2 |z_N - r_N|_P^2
 *                 + sum (z_k - r_k)' C (u_k - s_k)
 *     subject to  z_{k+1} = A_k z_k + B_k u_k + d_k
 *
 * A Riccati recursion gives U_k' U_k = R + B_k' P_{k+1} B_k and
 * W_k = U_k^-T (B_k' P_{k+1} A_k + C'). With
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
#ifndef STAGES_H
#define STAGES_H

#include "active_set.h"

typedef void (*StagesMultiply)(char *, char *, int *, int *, int *, double *, double *, int *, double *,
                               int *, double *, double *, int *);

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
  const double *cross;                      /* C, (n - a or n, a); NULL: zeros */
  StagesMultiply gemm;                      /* of the BLAS, or NULL */
  /* the plan */
  double *z, *u; /* (N + 1, n - a or n); (N + 1, a), the input before first */
  /* the problem linearized along it */
  double *motion, *motion_t;    /* by slots: (N, a + n, n), [B A]'; (N, n, a + n), [B A] */
  const double *E, *G, *F;      /* (N, n, p) (N, a, p) (N, n, p), by columns; of ramps
                                              E and F end before the inputs; of alike stages G is
                                              by rows without its zeros: row i has the numbers */
  const int *G_start, *G_which; /* from G_start[i] on, of inputs G_which; (p + 1) */
  double *values;               /* (N, p), in their units */
  double *gap;                  /* (N, n): d */
  double *costs, *before;       /* by steps: (N, n, n), P behind a stage and before it */
  double *S, *S_t, *W, *W_t;    /* by steps: (N, a, a) twice; (N, a, n); (N, n, a) */
  double *first;                /* (N, a): f */
  double *growth, *reach;       /* by steps: (N), of errors of x in inputs, in levels; largest of W */
  double farthest;              /* largest of f */
  double *off_z, *off_u;        /* (N + 1, n), (N, a): the plan less its targets */
  double *work;                 /* STAGES_WORK(thin, n, a) */
  int ahead;                    /* whether F may be other than zero */
  /* for many inputs that move few states, with alike stages: in place of S, and W is (n, n) */
  int thin;
  const double *unit, *V, *T, *shrink; /* (a), (a, n), (n, n), (n): see stages.c */
  double *V_t, *limited_v;             /* (n, a); (p, n) */
} Stages;

#define STAGES_WORK(thin, n, a)                               \
  ((thin) ? (size_t)(n) * ((n) + 6) + 4 * ((size_t)(n) + (a)) \
          : (size_t)((n) + (a)) * (2 * (size_t)((n) + (a)) + 3 * (size_t)ACTIVE_SET_BATCH + 6))

/* Numbers of x: of thin stages [w v s], see stages.c. */
#define STAGES_COLUMNS(thin, N, n, a) ((size_t)(N) * ((a) + ((thin) ? 2 * (size_t)(n) : 0)))

/* Rows that may be active at once where all stages are alike, and so may be very many. */
#define STAGES_MOST 5000

/* Numbers that a map from the state to all limits may have, where all stages are alike: it stays in
   the cache of a processor. Where it would have more, limits take a simulation. */
#define STAGES_MAP 250000

/* Sizes of the memory of a program. `alike` and `thin` are as in its sizes. */
#define STAGES_ROWS(N, a, p, changes) ((size_t)(N) * ((size_t)(a) * ((changes) ? 2 : 1) + (p)))
#define STAGES_ACTIVE(alike, rows, columns, soft)                              \
  ((alike) && ACTIVE_SET_MOST(rows, columns, soft) > STAGES_MOST ? STAGES_MOST \
                                                                 : ACTIVE_SET_MOST(rows, columns, soft))
#define STAGES_MAPPED(rows, n) ((size_t)(rows) * (n) <= STAGES_MAP ? (size_t)(rows) * (n) : 0)
#define STAGES_ALIKE(thin, N, n, a, rows)                                                                 \
  ((size_t)(rows) * (((thin) ? (n) : (a)) + 2) + STAGES_MAPPED(rows, n) + STAGES_COLUMNS(thin, N, n, a) + \
   (size_t)(N) * (n) + (n))
#define STAGES_MATRICES(thin, n, a, p)                                                      \
  ((thin) ? 6 * (size_t)(n) * (n) + ((size_t)(a) + (p)) * (n)                               \
          : 2 * ((size_t)(a) + (n)) * (n) + 2 * (size_t)(n) * (n) + 2 * (size_t)(a) * (n) + \
                2 * (size_t)(a) * (a))
#define STAGES_NUMBERS(alike, thin, N, n, a, p, rows, most)                                             \
  (ACTIVE_SET_NUMBERS(rows, STAGES_COLUMNS(thin, N, n, a), most, !(alike)) +                            \
   ((alike) ? 1 : (size_t)(N)) * STAGES_MATRICES(thin, n, a, p) + 4 * STAGES_COLUMNS(thin, N, n, a) +   \
   (size_t)(N) * ((p) + (n) + 3 * (a)) + (size_t)((N) + 1) * (4 * (n) + (a) + 2) + 4 * (size_t)(rows) + \
   STAGES_WORK(thin, n, a) + ((alike) ? STAGES_ALIKE(thin, N, n, a, rows) : 0))
#define STAGES_INTEGERS(alike, N, rows, most) \
  (ACTIVE_SET_INTEGERS(rows, most) + ((alike) ? (size_t)(rows) / (N) : 3 * (size_t)(N)))

typedef struct {
  int stages, states, inputs, limited; /* as in Stages */
  int ramp, changes;
  int soft;    /* rows */
  int limit;   /* of changes of the active set */
  int ahead;   /* whether limited values depend on z_{k+1} */
  int alike;   /* whether all stages are alike */
  int thin;    /* they are so with few states, a diagonal R and no C */
  int crossed; /* whether there is a C */
} StagesSizes;

/* What does not change, and stays where it is: by rows, as in Stages and in ActiveSet. */
typedef struct {
  const double *Q, *R, *P, *cross, *scale, *change;
  const double *low, *high, *least, *most; /* bounds of inputs (a), of limited values (p) */
  const double *price, *curvature;         /* (rows) */
  const double *unit, *V, *T, *shrink;     /* of thin stages, which need no R */
  const int *G_start, *G_which;            /* of alike stages */
} StagesData;

/* The program of a horizon, and its plan: what a sample of MPC takes. */
typedef struct {
  Stages stages;
  ActiveSet set;
  StagesData data;
  double *lower, *upper, *values, *y; /* (rows) each; y: multipliers to start from */
  double *x, *none, *step;            /* (STAGES_COLUMNS), none: zeros */
  double *dz, *du;                    /* (N + 1, n) and (N, a): departures from the plan */
  double *by_z, *by_u;                /* as many: what a correction adds to them */
  int moved;                          /* whether the departures are no more those of x = 0 */
  int refined;                        /* whether the departures are those of the last solution, corrected */
  /* where all stages are alike */
  double *last;                     /* (rows of a stage, N a): rows of the last stage; of thin ones
                                      their w, (rows of a stage, N n) */
  int *known;                       /* (rows of a stage), whether they are found */
  double *map;                      /* (n, rows): what z_0 does to the limits; NULL: too large */
  double *low_offset, *high_offset; /* (rows): bounds less the limits at z_0 = 0 and x = 0 */
  double *chosen, *drift, *start;   /* (STAGES_COLUMNS), (N n), (n): x - f, d and z_0 of the
                                         last solution; if refined, chosen are its inputs */
} StagesProgram;

SOLVER_API size_t stages_program_size(void);

/*
 * Lay a program out in memory.
 *
 *     numbers, integers, pointers
 *              memory of the sizes in `counts`, which is written first; NULL: nothing else is
 *     views    where z, u, y, the departures from the plan dz, du, the gaps, and the limited values
 *              of the plan in their units are
 */
SOLVER_API void stages_program_place(StagesProgram *program, const StagesSizes *sizes, double level,
                                     double tolerance, StagesMultiply gemm, const StagesData *data,
                                     double *numbers, int *integers, const double **pointers, size_t *counts,
                                     double **views);

/* Move the multipliers, and the steps of the recursion, on by a sample. */
SOLVER_API void stages_program_shift(StagesProgram *program);

/*
 * All that needs neither targets nor a measurement: the problem along its plan, from the stage
 * Jacobians of motion and limited values, stored by columns, and the rows that may be active. E, G
 * and F are not copied, and must last for the solves. Returns whether data are finite; if they are
 * not, all stages must be fresh in the next call.
 *
 * A, B and C of stage k are in its slot. Only the slots of `fresh` stages are others than in the
 * last call. NULL for both: each stage has a slot of its own, and all are fresh. The tolerance is
 * that of the costs behind stages whose derivatives are known.
 */
SOLVER_API int stages_program_prepare(StagesProgram *program, const int *slots, const int *fresh,
                                      double tolerance, const double *ends, const double *A, const double *B,
                                      const double *C, const double *limited, const double *E,
                                      const double *G, const double *F);

/*
 * Put in the targets: r of (N, n - a or n), s of (N, a), r_0 or NULL (zeros; C alone asks for it),
 * and what a load adds to each state, (N, n - a or n) or NULL. Once for each problem prepared; where all stages are alike, whenever
 * targets, gaps, or what inputs and limited values are measured from have changed.
 */
SOLVER_API void stages_program_aim(StagesProgram *program, const double *r, const double *aim,
                                   const double *r_0, const double *drift);

/*
 * Solve for a measured state, the input that acts before a ramp, the input that changes are limited
 * from, and what may stop the method (NULL: nothing). Returns a status of the active-set method.
 * With 0 the departures from the plan are those of the optimum, or where all stages are alike the
 * first input of them, and the multipliers are kept.
 */
SOLVER_API int stages_program_solve(StagesProgram *program, const double *state, const double *acting,
                                    const double *previous, int (*stop)(void *));

/* Find all departures from the plan of the last solution, where all stages are alike. */
SOLVER_API void stages_program_plan(StagesProgram *program);

/* Changes of the active set in the last solve. */
SOLVER_API int stages_program_iterations(const StagesProgram *program);

#endif
