
/* ---- the quadratic program: min 1/2 x'Px + q'x, l <= Ax <= u ---- */

#include "osqp.h"
#include "controller_qp_workspace.h"

/* OSQP takes 1e30 for infinite, and loses its digits long before. */
#define LARGEST 1e20

static int iterations; /* of the last solve */

static struct {
    double q[UNKNOWNS], l[ROWS], u[ROWS];
    double x[UNKNOWNS], y[ROWS]; /* start of the next solve */
    int has_start;
} program;

static void forget_program(void)
{
    program.has_start = 0;
    osqp_cold_start(&controller_qp_solver);
    osqp_update_rho(&controller_qp_solver, FIRST_RHO);
}

/* Data that are not finite, or bounds that cross, must never reach the solver. */
static int fault_of_data(void)
{
    int i;
    for (i = 0; i < UNKNOWNS; i++)
        if (!(fabs(program.q[i]) < LARGEST))
            return CONTROLLER_BAD_DATA;
    for (i = 0; i < ROWS; i++)
        if (!(program.l[i] < LARGEST) || !(program.u[i] > -LARGEST))
            return CONTROLLER_BAD_DATA;
    for (i = 0; i < ROWS; i++)
        if (program.l[i] > program.u[i])
            return CONTROLLER_INFEASIBLE;
    return CONTROLLER_OK;
}

static int reason_of(OSQPInt status)
{
    switch (status) {
    case OSQP_SOLVED:
        return CONTROLLER_OK;
    case OSQP_SOLVED_INACCURATE:
        return CONTROLLER_INACCURATE;
    case OSQP_PRIMAL_INFEASIBLE:
    case OSQP_PRIMAL_INFEASIBLE_INACCURATE:
        return CONTROLLER_INFEASIBLE;
    case OSQP_DUAL_INFEASIBLE:
    case OSQP_DUAL_INFEASIBLE_INACCURATE:
        return CONTROLLER_UNBOUNDED;
    case OSQP_MAX_ITER_REACHED:
        return CONTROLLER_OUT_OF_ITERATIONS;
    case OSQP_TIME_LIMIT_REACHED:
        return CONTROLLER_OUT_OF_TIME;
    case OSQP_NON_CVX:
        return CONTROLLER_NOT_CONVEX;
    case OSQP_SIGINT:
        return CONTROLLER_INTERRUPTED;
    default:
        return CONTROLLER_UNSOLVED;
    }
}

/* Solve for program.q, .l and .u; the answer is in controller_qp_solver.solution if it is OK. */
static int solve_program(void)
{
    int i, reason = fault_of_data();
    if (reason != CONTROLLER_OK)
        return reason;
    for (i = 0; i < ROWS; i++) {
        program.l[i] = fmax(program.l[i], -OSQP_INFTY);
        program.u[i] = fmin(program.u[i], OSQP_INFTY);
    }
    osqp_update_data_vec(&controller_qp_solver, program.q, program.l, program.u);
    if (program.has_start)
        osqp_warm_start(&controller_qp_solver, program.x, program.y);
    osqp_solve(&controller_qp_solver);
    iterations = (int)controller_qp_solver.info->iter;
    reason = reason_of(controller_qp_solver.info->status_val);
    if (reason != CONTROLLER_OK) /* do not start from what is left in x */
        osqp_cold_start(&controller_qp_solver);
    return reason;
}

/* Shift a solution by a sample: entry i comes from entry source[i], or is zero if that is -1. */
static void shift_answer(const int *source, const double *from, double *to, int count)
{
    int i;
    for (i = 0; i < count; i++)
        to[i] = source[i] < 0 ? 0.0 : from[source[i]];
}
