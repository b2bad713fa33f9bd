
/* ---- the quadratic program: min 1/2 |x|^2 + q'x + violations, low <= M x <= high ---- */

#include "controller_active_set.h"

/* Values from here on are no numbers of a program. */
#define LARGEST 1e20

#define MOST ACTIVE_SET_MOST(ROWS, UNKNOWNS, SOFT)

static struct {
    double q[UNKNOWNS], low[ROWS], high[ROWS], x[UNKNOWNS];
    double start[ROWS]; /* multipliers that the next solve starts from */
    ActiveSet set;
    int placed;
    double numbers[ACTIVE_SET_NUMBERS(ROWS, UNKNOWNS, MOST, 0)];
    int integers[ACTIVE_SET_INTEGERS(ROWS, MOST)];
    const double *pointers[ACTIVE_SET_POINTERS(MOST)];
} program;

/*
 * Row i is that of value i % STAGE_ROWS at stage i / STAGE_ROWS. All stages are alike, so that what
 * a row has from its first entries on, later stages have in front of their last.
 */
static const double *response_row(int i, int *length)
{
    *length = (i / STAGE_ROWS + 1) * STAGE_INPUTS;
    return response[i % STAGE_ROWS] + UNKNOWNS - *length;
}

static void response_batch(void *data, int count, const int *which, double *const *space,
                           const double **entries, int *length)
{
    int j;
    (void)data;
    (void)space;
    for (j = 0; j < count; j++)
        entries[j] = response_row(which[j], &length[j]);
}

static void response_products(void *data, const double *x, double *out)
{
    int i, length;
    (void)data;
    for (i = 0; i < ROWS; i++) {
        const double *row = response_row(i, &length);
        out[i] = active_set_dot(row, x, length);
    }
}

static void forget_program(void)
{
    memset(program.start, 0, sizeof program.start);
}

/* Data that are not finite, or bounds that cross, have no answer. */
static int fault_of_data(void)
{
    int i;
    for (i = 0; i < UNKNOWNS; i++)
        if (!(fabs(program.q[i]) < LARGEST))
            return CONTROLLER_BAD_DATA;
    for (i = 0; i < ROWS; i++)
        if (!(program.low[i] < LARGEST) || !(program.high[i] > -LARGEST))
            return CONTROLLER_BAD_DATA;
    return CONTROLLER_OK;
}

/* Solve for program.q, .low and .high; the answer is in program.x and the rows of it if it is OK. */
static int solve_program(void)
{
    ActiveSet *set = &program.set;
    int reason = fault_of_data();
    if (reason != CONTROLLER_OK)
        return reason;
    if (!program.placed) {
        set->rows = ROWS;
        set->columns = UNKNOWNS;
        set->most = MOST;
        set->limit = ITERATIONS;
        set->tolerance = TOLERANCE;
        set->price = set->curvature = price;
        set->batch = response_batch;
        set->products = response_products;
        active_set_place(set, program.numbers, program.integers, program.pointers);
        program.placed = 1;
    }
    active_set_start(set, program.start);
    reason = active_set_solve(set, program.q, program.low, program.high, program.x);
    iterations = set->iterations;
    if (reason == CONTROLLER_OK) { /* moved on by a sample */
        copy(program.start, set->y + STAGE_ROWS, ROWS - STAGE_ROWS);
        memset(program.start + ROWS - STAGE_ROWS, 0, STAGE_ROWS * sizeof *program.start);
    } else {
        forget_program();
    }
    return reason;
}
