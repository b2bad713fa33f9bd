
/* ---- nonlinear model predictive control by real-time iterations ---- */

/* Places in a row of the table over time. */
#define ROW_REFERENCE UNKNOWNS
#define ROW_ORIGIN (ROW_REFERENCE + HORIZON * STATES)

/* Slopes of a sample by states and by inputs, of the motion and of what is limited. */
#define WIDTH (STATES + CONTROLLER_COMMANDS)
#define SLOPES (HORIZON * (STATES * WIDTH + LIMITED * (WIDTH + STATES)))

static struct {
    double states[(HORIZON + 1) * STATES]; /* z_0 ... z_N of the plan */
    double inputs[PLANNED];
    int has_plan, prepared, shifted; /* linearized; shifted to this sample */
    int followed;                  /* samples without a program that was solved */
    double slopes[SLOPES]; /* A_k, B_k, then E_k, G_k, F_k, by columns */
    double offset[HORIZON * STATES];
#if LIMITED > 0
    double limited[HORIZON * LIMITED]; /* d_k */
#endif
#if LOADS > 0
    double load[LOADS], drift[STATES], last_state[STATES];
    int has_last_state;
#endif
    double row[ROW_LENGTH];
} memory;

static void forget_plan(void)
{
    memory.has_plan = memory.prepared = 0;
    memory.shifted = 1;
    program.has_start = 0;
}

static void forget(void)
{
    memset(&memory, 0, sizeof memory);
    forget_plan();
    forget_program();
}

/* The state a sample later. */
static void advance(const double *state, const double *input, double *end)
{
    const double *given[CASADI_ARG] = {0};
    double *found[CASADI_RES] = {0};
    given[0] = state;
    given[1] = input;
    found[0] = end;
    controller_advance(given, found, casadi_integers, casadi_numbers, 0);
}

static void keep_within_bounds(double *input)
{
    int i;
    for (i = 0; i < CONTROLLER_COMMANDS; i++)
        input[i] = clamp(input[i], low[i], high[i]);
}

/* Shift the plan by a sample, once. */
static void shift_plan(void)
{
    double *last = memory.inputs + PLANNED - CONTROLLER_COMMANDS;
    if (memory.shifted)
        return;
    memmove(memory.states, memory.states + STATES, HORIZON * STATES * sizeof(double));
    memmove(memory.inputs, memory.inputs + CONTROLLER_COMMANDS,
            (PLANNED - CONTROLLER_COMMANDS) * sizeof(double));
    if (HORIZON > 1)
        copy(last, last - CONTROLLER_COMMANDS, CONTROLLER_COMMANDS);
    keep_within_bounds(last);
    advance(memory.states + (HORIZON - 1) * STATES, last, memory.states + HORIZON * STATES);
    if (program.has_start) {
        static double x[UNKNOWNS], y[ROWS];
        copy(x, program.x, UNKNOWNS);
        copy(y, program.y, ROWS);
        shift_answer(source_of_x, x, program.x, UNKNOWNS);
        shift_answer(source_of_y, y, program.y, ROWS);
    }
    memory.shifted = 1;
}

/* Plan with the linear feedback within bounds, on the nonlinear plant. */
static void initialize_plan(const double *state, const double *row)
{
    int i, k;
    copy(memory.states, state, STATES);
    for (k = 0; k < HORIZON; k++) {
        const double *reference = row + ROW_REFERENCE + (k > 0 ? k - 1 : 0) * STATES;
        double *now = memory.states + k * STATES, off[STATES];
        double *input = memory.inputs + k * CONTROLLER_COMMANDS;
        for (i = 0; i < STATES; i++)
            off[i] = now[i] - reference[i];
        copy(input, row + ROW_ORIGIN + k * CONTROLLER_COMMANDS, CONTROLLER_COMMANDS);
        add_product(&feedback, off, input);
        keep_within_bounds(input);
        advance(now, input, now + STATES);
    }
    memory.has_plan = 1;
    memory.shifted = 1;
    memory.prepared = 0;
}

/* offset -= slope x, with the slope by columns. */
static void subtract(const double *slope, const double *x, int columns, double *offset, int rows)
{
    int i, j;
    for (j = 0; j < columns; j++)
        for (i = 0; i < rows; i++)
            offset[i] -= slope[j * rows + i] * x[j];
}

/* Linearize along the plan, and put that into the program where it is finite. */
static void linearize(void)
{
    static double values[ENTRIES];
    double *A = memory.slopes, *B = A + HORIZON * STATES * STATES;
    int i, k;
    for (k = 0; k < HORIZON; k++) {
        const double *z = memory.states + k * STATES;
        const double *u = memory.inputs + k * CONTROLLER_COMMANDS;
        double *offset = memory.offset + k * STATES;
        const double *given[CASADI_ARG] = {0};
        double *found[CASADI_RES] = {0};
        given[0] = z;
        given[1] = u;
        found[0] = offset;
        found[1] = A + k * STATES * STATES;
        found[2] = B + k * STATES * CONTROLLER_COMMANDS;
        controller_linearize(given, found, casadi_integers, casadi_numbers, 0);
        subtract(found[1], z, STATES, offset, STATES);
        subtract(found[2], u, CONTROLLER_COMMANDS, offset, STATES);
    }
#if LIMITED > 0
    for (k = 0; k < HORIZON; k++) {
        double *E = B + HORIZON * STATES * CONTROLLER_COMMANDS;
        double *G = E + HORIZON * LIMITED * STATES;
        double *F = G + HORIZON * LIMITED * CONTROLLER_COMMANDS;
        const double *z = memory.states + k * STATES;
        const double *u = memory.inputs + k * CONTROLLER_COMMANDS;
        double *offset = memory.limited + k * LIMITED;
        const double *given[CASADI_ARG] = {0};
        double *found[CASADI_RES] = {0};
        given[0] = z;
        given[1] = u;
        given[2] = z + STATES;
        found[0] = offset;
        found[1] = E + k * LIMITED * STATES;
        found[2] = G + k * LIMITED * CONTROLLER_COMMANDS;
        found[3] = F + k * LIMITED * STATES;
        controller_limited(given, found, casadi_integers, casadi_numbers, 0);
        subtract(found[1], z, STATES, offset, LIMITED);
        subtract(found[2], u, CONTROLLER_COMMANDS, offset, LIMITED);
        subtract(found[3], z + STATES, STATES, offset, LIMITED);
    }
    if (!all_finite(memory.limited, HORIZON * LIMITED))
        return;
#endif
    if (!all_finite(memory.slopes, SLOPES) || !all_finite(memory.offset, HORIZON * STATES))
        return;
    for (i = 0; i < ENTRIES; i++)
        values[i] = source_of_entry[i] < 0 ? entry[i] : entry[i] * memory.slopes[source_of_entry[i]];
    osqp_update_data_mat(&controller_qp_solver, NULL, NULL, 0, values, NULL, ENTRIES);
    memory.prepared = 1;
}

/* q, l and u: those of the row, moved by the linearization and by what is measured. */
static void fill_program(const double *state, const double *row)
{
    static double moved[ROWS];
    double previous[CONTROLLER_COMMANDS], motion[HORIZON * STATES];
    int i;
#if LIMITED > 0
    static double limited[HORIZON * LIMITED];
    const double *E = memory.slopes + HORIZON * STATES * WIDTH;
    for (i = 0; i < HORIZON * LIMITED; i++)
        limited[i] = -memory.limited[i];
    subtract(E, state, STATES, limited, LIMITED);
#endif
    for (i = 0; i < CONTROLLER_COMMANDS; i++)
        previous[i] = previous_within_bounds(i);
    copy(program.q, row, UNKNOWNS);
    memset(moved, 0, sizeof moved);
    add_product(&by_previous_input, previous, moved);
    for (i = 0; i < ROWS; i++) {
#if LIMITED > 0
        if (limit_of_row[i] >= 0)
            moved[i] += limited[limit_of_row[i]] / limit_scale[i];
#endif
        program.l[i] = first_low[i] + moved[i];
        program.u[i] = first_high[i] + moved[i];
    }
    for (i = 0; i < HORIZON * STATES; i++)
        motion[i] = -memory.offset[i];
#if LOADS > 0
    for (i = 0; i < HORIZON * STATES; i++)
        motion[i] -= memory.drift[i % STATES];
#endif
    subtract(memory.slopes, state, STATES, motion, STATES);
    for (i = 0; i < HORIZON * STATES; i++)
        program.l[i] = program.u[i] = -motion[i] / unit[i % STATES];
}

/* Store the plan. Returns the largest change of an input, in its unit. */
static double take_plan(const double *state)
{
    const double *x = controller_qp_solver.solution->x;
    double largest = 0.0;
    int i;
    copy(memory.states, state, STATES);
    for (i = 0; i < HORIZON * STATES; i++)
        memory.states[STATES + i] = x[i] * unit[i % STATES];
    for (i = 0; i < PLANNED; i++) {
        double input = x[HORIZON * STATES + i] * LEVEL;
        largest = fmax(largest, fabs(input - memory.inputs[i]) / LEVEL);
        memory.inputs[i] = input;
    }
    copy(program.x, x, UNKNOWNS);
    copy(program.y, controller_qp_solver.solution->y, ROWS);
    program.has_start = 1;
    return largest;
}

/* Continue the last plan; after its end hold a safe input. */
static int continue_plan(int reason, double *desired_input)
{
    memory.followed++;
    if (memory.followed >= HORIZON)
        forget_plan();
    if (memory.has_plan) {
        shift_plan();
        copy(desired_input, memory.inputs, CONTROLLER_COMMANDS);
        reason |= CONTROLLER_PLAN_CONTINUED;
    } else {
        reason = hold(reason, desired_input);
    }
    memory.prepared = memory.shifted = 0;
    program.has_start = 0;
    return reason;
}

static int fall_back(int reason, double *desired_input)
{
#if LOADS > 0
    memory.has_last_state = 0;
#endif
    return continue_plan(reason, desired_input);
}

#if LOADS > 0
/* Attribute the error of the prediction to the load. */
static void correct_load(const double *state)
{
    double error[STATES];
    int i;
    if (memory.has_last_state && has_previous_input) {
        advance(memory.last_state, previous_input, error);
        for (i = 0; i < STATES; i++)
            error[i] = state[i] - (memory.drift[i] + error[i]);
        if (all_finite(error, STATES))
            add_product(&load_gain, error, memory.load);
    }
    copy(memory.last_state, state, STATES);
    memory.has_last_state = 1;
    memset(memory.drift, 0, sizeof memory.drift);
    add_product(&load_response, memory.load, memory.drift);
}

/* Move references and origins to where the plant is at rest under the load, by Newton's method. */
static void rest_under_load(double *row)
{
    int i, k, step;
    for (k = 0; k < HORIZON; k++) {
        double state[STATES] = {0}, shift[STATES] = {0}, effort[CONTROLLER_COMMANDS] = {0};
        double left[LOADS], input[CONTROLLER_COMMANDS];
        double *reference = row + ROW_REFERENCE + k * STATES;
        double *origin = row + ROW_ORIGIN + k * CONTROLLER_COMMANDS;
        const double *given[CASADI_ARG] = {0};
        double *found[CASADI_RES] = {0};
        for (step = 0; step < NEWTON_STEPS; step++) {
            for (i = 0; i < LOADS; i++)
                state[i] = reference[i] + shift[i];
            for (i = 0; i < CONTROLLER_COMMANDS; i++)
                input[i] = origin[i] + effort[i];
            given[0] = state;
            given[1] = input;
            found[0] = left;
            controller_accelerate(given, found, casadi_integers, casadi_numbers, 0);
            for (i = 0; i < LOADS; i++)
                left[i] += memory.load[i];
            add_product(&load_shift, left, shift);
            add_product(&load_effort, left, effort);
        }
        add_product(k + 1 < HORIZON ? &by_reference : &by_last, shift, row + k * STATES);
        add_product(&by_origin, effort, row + HORIZON * STATES + k * CONTROLLER_COMMANDS);
        for (i = 0; i < LOADS; i++)
            reference[i] += shift[i];
        for (i = 0; i < CONTROLLER_COMMANDS; i++)
            origin[i] += effort[i];
    }
}
#endif

static int decide(double time, const double *state, double *desired_input)
{
    const double *row = row_at(time, memory.row);
    int total = 0, round;
#if LOADS > 0
    correct_load(state);
    rest_under_load(memory.row);
#endif
    if (!has_previous_input)
        set_previous_input(row + ROW_ORIGIN);
    if (!memory.has_plan)
        initialize_plan(state, row);
    shift_plan();
    linearize();
    if (!memory.prepared) /* the dynamics are not finite along the plan */
        initialize_plan(state, row);
    for (round = 0; round < ROUNDS; round++) {
        int reason;
        if (!memory.prepared)
            linearize();
        if (memory.prepared) {
            fill_program(state, row);
            reason = solve_program();
            total += iterations;
        } else {
            forget_plan();
            reason = CONTROLLER_BAD_DATA;
        }
        iterations = total;
        memory.prepared = 0;
        if (reason != CONTROLLER_OK)
            return continue_plan(reason, desired_input);
        memory.followed = 0;
        if (take_plan(state) < CONVERGED)
            break;
    }
    memory.shifted = 0;
    copy(desired_input, memory.inputs, CONTROLLER_COMMANDS);
    return CONTROLLER_OK;
}
