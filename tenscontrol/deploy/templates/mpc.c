
/* ---- model predictive control ---- */

/* Places in a row of the table over time. */
#define ROW_LOW UNKNOWNS
#define ROW_HIGH (ROW_LOW + ROWS)
#define ROW_INPUTS (ROW_HIGH + ROWS)
#define ROW_PREVIOUS_INPUT (ROW_INPUTS + PLANNED)
#define ROW_FREE_RESPONSE (ROW_PREVIOUS_INPUT + CONTROLLER_COMMANDS)

/* What the program is affine in: [state; previous input; the same within bounds; load]. */
#define MEASURED (STATES + CONTROLLER_COMMANDS)
#define GIVEN (MEASURED + CONTROLLER_COMMANDS + LOADS)

static struct {
    double plan[PLANNED];
    int has_plan, used;
#if LOADS > 0
    double load[LOADS], free_response[STATES];
    int has_free_response;
#endif
    double row[ROW_LENGTH];
} memory;

static void forget(void)
{
    memset(&memory, 0, sizeof memory);
    forget_program();
}

/* Continue the last plan; after its end hold a safe input. */
static int continue_plan(int reason, double *desired_input)
{
    memory.used++;
    forget_program();
    if (memory.has_plan && memory.used < PLANNED / CONTROLLER_COMMANDS) {
        copy(desired_input, memory.plan + memory.used * CONTROLLER_COMMANDS, CONTROLLER_COMMANDS);
        return reason | CONTROLLER_PLAN_CONTINUED;
    }
    return hold(reason, desired_input);
}

static int fall_back(int reason, double *desired_input)
{
#if LOADS > 0
    memory.has_free_response = 0;
#endif
    return continue_plan(reason, desired_input);
}

/* [state; previous input; the same within bounds; load] */
static void gather(const double *state, double *given)
{
    int i;
    copy(given, state, STATES);
    copy(given + STATES, previous_input, CONTROLLER_COMMANDS);
    for (i = 0; i < CONTROLLER_COMMANDS; i++)
        given[MEASURED + i] = previous_within_bounds(i);
#if LOADS > 0
    copy(given + MEASURED + CONTROLLER_COMMANDS, memory.load, LOADS);
#endif
}

#if LOADS > 0
/* Attribute the error of the prediction to the load. */
static void correct_load(const double *state)
{
    double error[STATES], response[STATES] = {0};
    int i;
    if (!memory.has_free_response)
        return;
    add_product(&by_input, previous_input, response);
    for (i = 0; i < STATES; i++)
        error[i] = state[i] - (memory.free_response[i] + response[i]);
    add_product(&load_gain, error, memory.load);
}
#endif

/* q and bounds: those of the row, plus a linear function of what is given. */
static void fill_program(const double *given, const double *row)
{
    static double moved[UNKNOWNS + ROWS];
    int i;
    memset(moved, 0, sizeof moved);
    add_product(&vectors, given, moved);
    for (i = 0; i < UNKNOWNS; i++)
        program.q[i] = row[i] + moved[i];
    for (i = 0; i < ROWS; i++) {
        program.low[i] = row[ROW_LOW + i] + moved[UNKNOWNS + i];
        program.high[i] = row[ROW_HIGH + i] + moved[UNKNOWNS + i];
    }
}

/* Store the plan, clipped to the bounds, which a solution satisfies to round-off. */
static void store_plan(const double *given, const double *row)
{
    int i, k;
    copy(memory.plan, row + ROW_INPUTS, PLANNED);
    add_product(&inputs, given, memory.plan);
    for (i = 0; i < PLANNED; i++) { /* inputs are the first values of a stage */
        int length;
        const double *of = response_row(i / STAGE_INPUTS * STAGE_ROWS + i % STAGE_INPUTS, &length);
        k = i % CONTROLLER_COMMANDS;
        memory.plan[i] += LEVEL * active_set_dot(of, program.x, length);
        memory.plan[i] = clamp(memory.plan[i], low[k], high[k]);
    }
    memory.has_plan = 1;
    memory.used = 0;
}

static int decide(double time, const double *state, double *desired_input)
{
    const double *row = row_at(time, memory.row);
    double given[GIVEN];
    int reason;
#if LOADS > 0
    correct_load(state);
#endif
    if (!has_previous_input)
        set_previous_input(row + ROW_PREVIOUS_INPUT);
    gather(state, given);
#if LOADS > 0
    copy(memory.free_response, row + ROW_FREE_RESPONSE, STATES);
    add_product(&free_response, given, memory.free_response);
    memory.has_free_response = 1;
#endif
    fill_program(given, row);
    reason = solve_program();
    if (reason != CONTROLLER_OK)
        return continue_plan(reason, desired_input);
    store_plan(given, row);
    copy(desired_input, memory.plan, CONTROLLER_COMMANDS);
    return CONTROLLER_OK;
}
