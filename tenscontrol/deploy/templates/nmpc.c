
/* ---- nonlinear model predictive control by real-time iterations ---- */

/* Places in a row of the table over time. */
#define ROW_REFERENCE 0
#define ROW_ORIGIN (ROW_REFERENCE + HORIZON * STATES)
#define ROW_START (ROW_ORIGIN + PLANNED)

/* Slopes of a sample by states and by inputs, of the motion and of what is limited. */
#define WIDTH (STATES + CONTROLLER_COMMANDS)
#define SLOPES (HORIZON * (STATES * WIDTH + LIMITED * (WIDTH + STATES)))

static struct {
  int has_plan, prepared, shifted; /* linearized; shifted to this sample */
  int followed;                    /* samples without a program that was solved */
  double slopes[SLOPES];           /* A_k, B_k, then E_k, G_k, F_k, by columns */
  double ends[HORIZON * STATES];
#if LIMITED > 0
  double limited[HORIZON * LIMITED]; /* d_k */
#endif
#if LOADS > 0
  double load[LOADS], drift[HORIZON * STATES], last_state[STATES];
  int has_last_state;
#endif
  double row[ROW_LENGTH];
} memory;

static void forget_plan(void) {
  memory.has_plan = memory.prepared = 0;
  memory.shifted = 1;
  forget_program();
}

static void forget(void) {
  if (!program.placed) place_program();
  memset(&memory, 0, sizeof memory);
  forget_plan();
}

/* The state a sample later. */
static void advance(const double *state, const double *input, double *end) {
  const double *given[CASADI_ARG] = {0};
  double *found[CASADI_RES] = {0};
  given[0] = state;
  given[1] = input;
  found[0] = end;
  controller_advance(given, found, casadi_integers, casadi_numbers, 0);
}

static void keep_within_bounds(double *input) {
  int i;
  for (i = 0; i < CONTROLLER_COMMANDS; i++) input[i] = clamp(input[i], low[i], high[i]);
}

/* Shift the plan by a sample, once. */
static void shift_plan(void) {
  double *last = program.inputs + PLANNED - CONTROLLER_COMMANDS;
  if (memory.shifted) return;
  memmove(program.states, program.states + STATES, HORIZON * STATES * sizeof(double));
  memmove(program.inputs, program.inputs + CONTROLLER_COMMANDS,
          (PLANNED - CONTROLLER_COMMANDS) * sizeof(double));
  if (HORIZON > 1) copy(last, last - CONTROLLER_COMMANDS, CONTROLLER_COMMANDS);
  keep_within_bounds(last);
  advance(program.states + (HORIZON - 1) * STATES, last, program.states + HORIZON * STATES);
  stages_program_shift(&program.stages);
  memory.shifted = 1;
}

/* Plan with the linear feedback within bounds, on the nonlinear plant. */
static void initialize_plan(const double *state, const double *row) {
  int i, k;
  copy(program.states, state, STATES);
  for (k = 0; k < HORIZON; k++) {
    const double *reference = row + ROW_REFERENCE + (k > 0 ? k - 1 : 0) * STATES;
    double *now = program.states + k * STATES, off[STATES];
    double *input = program.inputs + k * CONTROLLER_COMMANDS;
    for (i = 0; i < STATES; i++) off[i] = now[i] - reference[i];
    copy(input, row + ROW_ORIGIN + k * CONTROLLER_COMMANDS, CONTROLLER_COMMANDS);
    add_product(&feedback, off, input);
    keep_within_bounds(input);
    advance(now, input, now + STATES);
  }
  memory.has_plan = 1;
  memory.shifted = 1;
  memory.prepared = 0;
}

/* Linearize along the plan, and prepare the program where that is finite. */
static void linearize(void) {
  double *A = memory.slopes, *B = A + HORIZON * STATES * STATES;
  double *E = B + HORIZON * STATES * CONTROLLER_COMMANDS;
  double *G = E + HORIZON * LIMITED * STATES;
  double *F = G + HORIZON * LIMITED * CONTROLLER_COMMANDS;
  const double *limited = NULL;
  int k;
  for (k = 0; k < HORIZON; k++) {
    const double *z = program.states + k * STATES;
    const double *u = program.inputs + k * CONTROLLER_COMMANDS;
    const double *given[CASADI_ARG] = {0};
    double *found[CASADI_RES] = {0};
    given[0] = z;
    given[1] = u;
    found[0] = memory.ends + k * STATES;
    found[1] = A + k * STATES * STATES;
    found[2] = B + k * STATES * CONTROLLER_COMMANDS;
    controller_linearize(given, found, casadi_integers, casadi_numbers, 0);
  }
#if LIMITED > 0
  for (k = 0; k < HORIZON; k++) {
    const double *z = program.states + k * STATES;
    const double *u = program.inputs + k * CONTROLLER_COMMANDS;
    const double *given[CASADI_ARG] = {0};
    double *found[CASADI_RES] = {0};
    given[0] = z;
    given[1] = u;
    given[2] = z + STATES;
    found[0] = memory.limited + k * LIMITED;
    found[1] = E + k * LIMITED * STATES;
    found[2] = G + k * LIMITED * CONTROLLER_COMMANDS;
    found[3] = F + k * LIMITED * STATES;
    controller_limited(given, found, casadi_integers, casadi_numbers, 0);
  }
  limited = memory.limited;
#endif
  memory.prepared =
      stages_program_prepare(&program.stages, NULL, NULL, 0.0, memory.ends, A, B, NULL, limited, E, G, F);
}

/* Solve the program for what is measured. */
static int solve_program(const double *state, const double *row) {
  double previous[CONTROLLER_COMMANDS];
  const double *drift = NULL;
  int i, status;
  for (i = 0; i < CONTROLLER_COMMANDS; i++) previous[i] = previous_within_bounds(i);
#if LOADS > 0
  drift = memory.drift;
#endif
  stages_program_aim(&program.stages, row + ROW_REFERENCE, row + ROW_ORIGIN, CROSSED ? row + ROW_START : NULL,
                     drift);
  status = stages_program_solve(&program.stages, state, previous_input, previous, NULL);
  iterations = stages_program_iterations(&program.stages);
  return status;
}

/* Move the plan to the solution. Returns the largest change of an input, in its unit. */
static double take_plan(void) {
  double largest = 0.0;
  int i;
  for (i = 0; i < (HORIZON + 1) * STATES; i++) program.states[i] += program.state_moves[i];
  for (i = 0; i < PLANNED; i++) {
    double before = program.inputs[i];
    program.inputs[i] += program.input_moves[i];
    largest = fmax(largest, fabs(program.inputs[i] - before));
  }
  return largest / LEVEL;
}

/* Continue the last plan; after its end hold a safe input. */
static int continue_plan(int reason, double *desired_input) {
  memory.followed++;
  if (memory.followed >= HORIZON) forget_plan();
  if (memory.has_plan) {
    shift_plan();
    copy(desired_input, program.inputs, CONTROLLER_COMMANDS);
    reason |= CONTROLLER_PLAN_CONTINUED;
  } else {
    reason = hold(reason, desired_input);
  }
  memory.prepared = memory.shifted = 0;
  forget_program();
  return reason;
}

static int fall_back(int reason, double *desired_input) {
#if LOADS > 0
  memory.has_last_state = 0;
#endif
  return continue_plan(reason, desired_input);
}

#if LOADS > 0
/* Attribute the error of the prediction to the load. */
static void correct_load(const double *state) {
  double error[STATES];
  int i;
  if (memory.has_last_state && has_previous_input) {
    advance(memory.last_state, previous_input, error);
    for (i = 0; i < STATES; i++) error[i] = state[i] - (memory.drift[i] + error[i]);
    if (all_finite(error, STATES)) add_product(&load_gain, error, memory.load);
  }
  copy(memory.last_state, state, STATES);
  memory.has_last_state = 1;
  memset(memory.drift, 0, sizeof memory.drift);
  for (i = 0; i < HORIZON; i++) add_product(&load_response, memory.load, memory.drift + i * STATES);
}

/* Move references and origins to where the plant is at rest under the load, by Newton's method. */
static void rest_under_load(double *row) {
  int i, k, step;
  for (k = 0; k < HORIZON; k++) {
    double state[STATES] = {0}, shift[STATES] = {0}, effort[CONTROLLER_COMMANDS] = {0};
    double left[LOADS], input[CONTROLLER_COMMANDS];
    double *reference = row + ROW_REFERENCE + k * STATES;
    double *origin = row + ROW_ORIGIN + k * CONTROLLER_COMMANDS;
    const double *given[CASADI_ARG] = {0};
    double *found[CASADI_RES] = {0};
    for (step = 0; step < NEWTON_STEPS; step++) {
      for (i = 0; i < LOADS; i++) state[i] = reference[i] + shift[i];
      for (i = 0; i < CONTROLLER_COMMANDS; i++) input[i] = origin[i] + effort[i];
      given[0] = state;
      given[1] = input;
      found[0] = left;
      controller_accelerate(given, found, casadi_integers, casadi_numbers, 0);
      for (i = 0; i < LOADS; i++) left[i] += memory.load[i];
      add_product(&load_shift, left, shift);
      add_product(&load_effort, left, effort);
    }
    for (i = 0; i < LOADS; i++) reference[i] += shift[i];
    for (i = 0; i < CONTROLLER_COMMANDS; i++) origin[i] += effort[i];
  }
}
#endif

static int decide(double time, const double *state, double *desired_input) {
  const double *row;
  int total = 0, round;
  if (!program.placed) forget();
  row = row_at(time, memory.row);
#if LOADS > 0
  correct_load(state);
  rest_under_load(memory.row);
#endif
  if (!has_previous_input) set_previous_input(row + ROW_ORIGIN);
  if (!memory.has_plan) initialize_plan(state, row);
  shift_plan();
  linearize();
  if (!memory.prepared) /* the dynamics are not finite along the plan */
    initialize_plan(state, row);
  for (round = 0; round < ROUNDS; round++) {
    int reason;
    if (!memory.prepared) linearize();
    if (memory.prepared) {
      reason = solve_program(state, row);
      total += iterations;
    } else {
      forget_plan();
      reason = CONTROLLER_BAD_DATA;
    }
    iterations = total;
    memory.prepared = 0;
    if (reason != CONTROLLER_OK) return continue_plan(reason, desired_input);
    memory.followed = 0;
    if (take_plan() < CONVERGED) break;
  }
  memory.shifted = 0;
  copy(desired_input, program.inputs, CONTROLLER_COMMANDS);
  return CONTROLLER_OK;
}
