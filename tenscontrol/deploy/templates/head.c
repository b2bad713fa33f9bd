/* The controller whose face is controller.h. Its numbers are in controller_data.h. */
#include "controller.h"

#include <math.h>
#include <string.h>

#include "controller_casadi.h"
#include "controller_data.h"

/* ---- what every law needs ---- */

static double standing[CONTROLLER_COMMANDS]; /* what the actuators hold: told, or the last command */
static int has_standing;

static int all_finite(const double *values, int count)
{
    int i;
    for (i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return 0;
    return 1;
}

static double within(double value, double least, double most)
{
    return value < least ? least : value > most ? most : value;
}

static void copy(double *to, const double *from, int count)
{
    memcpy(to, from, (size_t)count * sizeof *to);
}

static void stand(const double *value)
{
    copy(standing, value, CONTROLLER_COMMANDS);
    has_standing = 1;
}

/* What stands, within bounds: where the next change is counted from. */
static double reachable(int i)
{
    return within(has_standing ? standing[i] : equilibrium[i], low[i], high[i]);
}

/* The wish within the change allowed and the bounds. */
static double within_reach(const double *wish, int i)
{
    double before = reachable(i);
    return within(within(wish[i], before - change[i], before + change[i]), low[i], high[i]);
}

/* y += M x, with M by rows. */
static void add_product(const Matrix *M, const double *x, double *y)
{
    int i, k;
    for (i = 0; i < M->rows; i++) {
        double sum = 0.0;
        for (k = M->start[i]; k < M->start[i + 1]; k++)
            sum += M->value[k] * x[M->column[k]];
        y[i] += sum;
    }
}

/* What functions by CasADi work in. */
static casadi_int casadi_integers[CASADI_IW];
static double casadi_numbers[CASADI_W];

/* z = [q; q'] of a motion. */
static void measure(const double *nodes, const double *velocities, double *state)
{
    const double *given[CASADI_ARG] = {0};
    double *found[CASADI_RES] = {0};
    given[0] = nodes;
    given[1] = velocities;
    found[0] = state;
    controller_measure(given, found, casadi_integers, casadi_numbers, 0);
}

/* Whether all numbers are at most so large, and along no axis farther from each other than that. */
static int close_together(const double *values, double largest, double spread)
{
    int axis, i;
    for (axis = 0; axis < 3; axis++) {
        double least = values[axis], most = values[axis];
        for (i = axis; i < CONTROLLER_COORDINATES; i += 3) {
            if (!(fabs(values[i]) <= largest))
                return 0;
            least = fmin(least, values[i]);
            most = fmax(most, values[i]);
        }
        if (!(most - least <= spread))
            return 0;
    }
    return 1;
}

static double squared_distance(const double *one, const double *other)
{
    double x = one[0] - other[0], y = one[1] - other[1], z = one[2] - other[2];
    return x * x + y * y + z * z;
}

/* What is wrong with a measurement; CONTROLLER_OK if nothing is. */
static int fault_of(double time, const double *nodes, const double *velocities)
{
    int i;
    if (!isfinite(time) || !all_finite(nodes, CONTROLLER_COORDINATES) ||
        !all_finite(velocities, CONTROLLER_COORDINATES))
        return CONTROLLER_NOT_FINITE;
    if (!close_together(nodes, FARTHEST, SPREAD) ||
        !close_together(velocities, FASTEST_SEEN, FASTEST))
        return CONTROLLER_NOT_PLAUSIBLE;
    for (i = 0; i < BARS; i++) {
        double square = squared_distance(nodes + 3 * bar_start[i], nodes + 3 * bar_end[i]);
        if (!(square >= shortest_square[i] && square <= longest_square[i]))
            return CONTROLLER_NOT_PLAUSIBLE;
    }
    for (i = 0; i < FIXED; i++)
        if (!(sqrt(squared_distance(nodes + 3 * fixed_node[i], place + 3 * i)) <= OFF))
            return CONTROLLER_NOT_PLAUSIBLE;
    return CONTROLLER_OK;
}

/* What is safe where there is nothing to go by. */
static int hold(int reason, double *wish)
{
    if (HOLDS_LAST && has_standing) {
        copy(wish, standing, CONTROLLER_COMMANDS);
        return reason | CONTROLLER_COMMAND_HELD;
    }
    copy(wish, equilibrium, CONTROLLER_COMMANDS);
    return reason | CONTROLLER_EQUILIBRIUM_HELD;
}
