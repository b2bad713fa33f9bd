
/* ---- linear model predictive control ---- */

/* Places in a row of the table over time. */
#define ROW_REFERENCE 0
#define ROW_PREVIOUS_ORIGIN (ROW_REFERENCE + HORIZON * PROGRAM_STATES)
#define ROW_ORIGIN (ROW_PREVIOUS_ORIGIN + CONTROLLER_COMMANDS)
#define ROW_AIM (ROW_ORIGIN + PLANNED)
#define ROW_DRIFT (ROW_AIM + PLANNED)
#define ROW_VALUES (ROW_DRIFT + HORIZON * PROGRAM_STATES)
#define ROW_START (ROW_VALUES + HORIZON * LIMITED)
#define ROW_FREE_RESPONSE (ROW_START + CROSSED * PROGRAM_STATES)

static struct {
  double plan[PLANNED];
  int has_plan, used, aimed;
#if LOADS > 0
  double load[LOADS], free_response[STATES];
  int has_free_response;
#endif
  double row[ROW_LENGTH];
} memory;

/*
 * Prepare about a plan of zeros: once where all stages are alike, else in each sample, from steps
 * of the recursion that are known.
 */
static void prepare_program(const double *values) {
  static const double ends[HORIZON * PROGRAM_STATES];
  const int *slots = NULL, *fresh = NULL;
#if !ALIKE
  static const int same[HORIZON], first[HORIZON] = {1};
  slots = same;
  fresh = program.placed ? same : first;
#endif
  if (!program.placed) place_program();
  stages_program_prepare(&program.stages, slots, fresh, 0.0, ends, motion_by_state, motion_by_input, NULL,
                         values, limited_by_state, limited_by_input, limited_by_next_state);
}

static void forget(void) {
  static const double values[HORIZON * LIMITED + 1];
  if (!program.placed) prepare_program(values);
  memset(&memory, 0, sizeof memory);
  forget_program();
}

/* Continue the last plan; after its end hold a safe input. */
static int continue_plan(int reason, double *desired_input) {
  memory.used++;
  forget_program();
  if (memory.has_plan && memory.used < HORIZON) {
    copy(desired_input, memory.plan + memory.used * CONTROLLER_COMMANDS, CONTROLLER_COMMANDS);
    return reason | CONTROLLER_PLAN_CONTINUED;
  }
  return hold(reason, desired_input);
}

static int fall_back(int reason, double *desired_input) {
#if LOADS > 0
  memory.has_free_response = 0;
#endif
  return continue_plan(reason, desired_input);
}

#if LOADS > 0
/* Attribute the error of the prediction to the load. */
static void correct_load(const double *state) {
  double error[STATES], response[STATES] = {0};
  int i;
  if (!memory.has_free_response) return;
  add_product(&by_input, previous_input, response);
  for (i = 0; i < STATES; i++) error[i] = state[i] - (memory.free_response[i] + response[i]);
  if (all_finite(error, STATES)) add_product(&load_gain, error, memory.load);
}

/* Move references and inputs to where the plant is at rest under the load. */
static void rest_under_load(double *row) {
  int k;
  if (CROSSED) add_product(&load_shift, memory.load, row + ROW_START);
  for (k = 0; k < HORIZON; k++) {
    add_product(&load_shift, memory.load, row + ROW_REFERENCE + k * PROGRAM_STATES);
    add_product(&load_effort, memory.load, row + ROW_AIM + k * CONTROLLER_COMMANDS);
    add_product(&load_response, memory.load, row + ROW_DRIFT + k * PROGRAM_STATES);
  }
}

/* The state a sample later, without the input of the sample. */
static void predict(const double *start, const double *row) {
  copy(memory.free_response, row + ROW_FREE_RESPONSE, STATES);
  add_product(&load_response, memory.load, memory.free_response);
  add_product(&transition, start, memory.free_response);
  memory.has_free_response = 1;
}
#endif

/* Put in the targets, and what inputs and limited values are measured from. */
static void aim_program(const double *row) {
#if ALIKE
  if (memory.aimed && VARYING == 0 && LOADS == 0) return;
#else
  double values[HORIZON * LIMITED + 1];
  int i;
  for (i = 0; i < HORIZON * LIMITED; i++)
    values[i] = row[ROW_VALUES + i] * limit_scale[i % (LIMITED + !LIMITED)];
  prepare_program(values);
#endif
  copy(program.inputs - CONTROLLER_COMMANDS, row + ROW_PREVIOUS_ORIGIN, PLANNED + CONTROLLER_COMMANDS);
  copy(program.values, row + ROW_VALUES, HORIZON * LIMITED);
  memset(program.gaps, 0, HORIZON * PROGRAM_STATES * sizeof *program.gaps);
  stages_program_aim(&program.stages, row + ROW_REFERENCE, row + ROW_AIM, CROSSED ? row + ROW_START : NULL,
                     row + ROW_DRIFT);
  memory.aimed = 1;
}

static void store_plan(void) {
  int i;
#if ALIKE
  stages_program_plan(&program.stages);
#endif
  for (i = 0; i < PLANNED; i++) {
    int j = i % CONTROLLER_COMMANDS;
    memory.plan[i] = clamp(program.inputs[i] + program.input_moves[i], low[j], high[j]);
  }
  memory.has_plan = all_finite(memory.plan, PLANNED);
  memory.used = 0;
}

static int decide(double time, const double *state, double *desired_input) {
  double start[PROGRAM_STATES], previous[CONTROLLER_COMMANDS];
  const double *row;
  int i, reason;
  if (!program.placed) forget();
  row = row_at(time, memory.row);
#if LOADS > 0
  correct_load(state);
  rest_under_load(memory.row);
#endif
  if (!has_previous_input) set_previous_input(row + ROW_PREVIOUS_ORIGIN);
  copy(start, state, STATES);
  for (i = STATES; i < PROGRAM_STATES; i++) /* of ramps */
    start[i] = previous_input[i - STATES] - row[ROW_PREVIOUS_ORIGIN + i - STATES];
#if LOADS > 0
  predict(start, row);
#endif
  aim_program(row);
  for (i = 0; i < CONTROLLER_COMMANDS; i++) previous[i] = previous_within_bounds(i);
  reason = stages_program_solve(&program.stages, start, previous, previous, NULL);
  iterations = stages_program_iterations(&program.stages);
  if (reason != CONTROLLER_OK) return continue_plan(reason, desired_input);
  store_plan();
  stages_program_shift(&program.stages);
  copy(desired_input, memory.plan, CONTROLLER_COMMANDS);
  return CONTROLLER_OK;
}
