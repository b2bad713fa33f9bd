/* The controller declared in controller.h. Its numbers are in controller_data.h. */
#include "controller.h"

#include <math.h>
#include <string.h>

typedef struct {
  int rows;
  const int *start, *column; /* of the entries of each row */
  const double *value;
} Matrix;

#include "controller_data.h"

#if CASADI
#include "controller_casadi.h"
#endif

/* ---- common to all laws ---- */

/* Input over the last sample: as controller_applied says, or the last command. */
static double previous_input[CONTROLLER_COMMANDS];
static int has_previous_input;

static int iterations; /* changes of the active set in the last sample */

static int all_finite(const double *values, int count) {
  int i;
  for (i = 0; i < count; i++)
    if (!isfinite(values[i])) return 0;
  return 1;
}

static double clamp(double value, double least, double most) {
  return value < least ? least : value > most ? most : value;
}

static void copy(double *to, const double *from, int count) { memcpy(to, from, (size_t)count * sizeof *to); }

static void set_previous_input(const double *value) {
  copy(previous_input, value, CONTROLLER_COMMANDS);
  has_previous_input = 1;
}

/* The previous input within bounds: changes are limited from here. */
static double previous_within_bounds(int i) {
  return clamp(has_previous_input ? previous_input[i] : equilibrium[i], low[i], high[i]);
}

/* The desired input within the change allowed and the bounds. */
static double bounded_input(const double *desired_input, int i) {
  double previous = previous_within_bounds(i);
  return clamp(clamp(desired_input[i], previous - change[i], previous + change[i]), low[i], high[i]);
}

#if MATRICES > 0
/* y += M x, with M by rows. */
static void add_product(const Matrix *M, const double *x, double *y) {
  int i, k;
  for (i = 0; i < M->rows; i++) {
    double sum = 0.0;
    for (k = M->start[i]; k < M->start[i + 1]; k++) sum += M->value[k] * x[M->column[k]];
    y[i] += sum;
  }
}
#endif

#if CASADI
/* Work space of functions by CasADi. */
static casadi_int casadi_integers[CASADI_IW];
static double casadi_numbers[CASADI_W];
#endif

#if REDUCED
/* z = [q; q'] of a motion */
static void measure(const double *nodes, const double *velocities, double *state) {
  const double *given[CASADI_ARG] = {0};
  double *found[CASADI_RES] = {0};
  given[0] = nodes;
  given[1] = velocities;
  found[0] = state;
  controller_measure(given, found, casadi_integers, casadi_numbers, 0);
}
#else
/* The nodes, then their velocities. */
static void measure(const double *nodes, const double *velocities, double *state) {
  copy(state, nodes, CONTROLLER_COORDINATES);
  copy(state + CONTROLLER_COORDINATES, velocities, CONTROLLER_COORDINATES);
}
#endif

/* Whether all numbers are at most so large, and along each axis at most so far apart. */
static int within_spread(const double *values, double largest, double spread) {
  int axis, i;
  for (axis = 0; axis < DIMENSION; axis++) {
    double least = values[axis], most = values[axis];
    for (i = axis; i < CONTROLLER_COORDINATES; i += DIMENSION) {
      if (!(fabs(values[i]) <= largest)) return 0;
      least = fmin(least, values[i]);
      most = fmax(most, values[i]);
    }
    if (!(most - least <= spread)) return 0;
  }
  return 1;
}

static double squared_distance(const double *one, const double *other) {
  double sum = 0.0;
  int axis;
  for (axis = 0; axis < DIMENSION; axis++) sum += (one[axis] - other[axis]) * (one[axis] - other[axis]);
  return sum;
}

/* What is wrong with a measurement; CONTROLLER_OK if nothing is. */
static int fault_of(double time, const double *nodes, const double *velocities) {
  int i;
  if (!isfinite(time) || !all_finite(nodes, CONTROLLER_COORDINATES) ||
      !all_finite(velocities, CONTROLLER_COORDINATES))
    return CONTROLLER_MEASUREMENT_NOT_FINITE;
  if (!within_spread(nodes, FARTHEST, SPREAD) || !within_spread(velocities, LARGEST_VELOCITY, FASTEST))
    return CONTROLLER_MEASUREMENT_NOT_PLAUSIBLE;
  for (i = 0; i < BARS; i++) {
    double square = squared_distance(nodes + DIMENSION * bar_start[i], nodes + DIMENSION * bar_end[i]);
    if (!(square >= shortest_square[i] && square <= longest_square[i]))
      return CONTROLLER_MEASUREMENT_NOT_PLAUSIBLE;
  }
  for (i = 0; i < FIXED; i++)
    if (!(sqrt(squared_distance(nodes + DIMENSION * fixed_node[i], place + DIMENSION * i)) <=
          SUPPORT_DISTANCE))
      return CONTROLLER_MEASUREMENT_NOT_PLAUSIBLE;
  for (i = 0; i < ROLLERS; i++)
    if (!(fabs(nodes[rolling[i]] - held_at[i]) <= SUPPORT_DISTANCE))
      return CONTROLLER_MEASUREMENT_NOT_PLAUSIBLE;
  return CONTROLLER_OK;
}

/* A safe input where there is no decision. */
static int hold(int reason, double *desired_input) {
  if (HOLDS_PREVIOUS_INPUT && has_previous_input) {
    copy(desired_input, previous_input, CONTROLLER_COMMANDS);
    return reason | CONTROLLER_PREVIOUS_INPUT_HELD;
  }
  copy(desired_input, equilibrium, CONTROLLER_COMMANDS);
  return reason | CONTROLLER_EQUILIBRIUM_HELD;
}
