
/* ---- model predictive control ---- */

/* Places in a row of the table over time. */
#define ROW_L UNKNOWNS
#define ROW_U (ROW_L + ROWS)
#define ROW_INPUTS (ROW_U + ROWS)
#define ROW_BEFORE (ROW_INPUTS + PLANNED)
#define ROW_COASTING (ROW_BEFORE + CONTROLLER_COMMANDS)

/* What the program is affine in: [state; what stands; the same within bounds; load]. */
#define MEASURED (STATES + CONTROLLER_COMMANDS)
#define GIVEN (MEASURED + CONTROLLER_COMMANDS + LOADS)

static struct {
    double plan[PLANNED];
    int has_plan, used;
#if LOADS > 0
    double load[LOADS], coasting[STATES];
    int has_coasting;
#endif
    double row[ROW_LENGTH];
} memory;

static void forget(void)
{
    memset(&memory, 0, sizeof memory);
    forget_program();
}

/* Go on without a new plan. */
static int go_on(int reason, double *wish)
{
    memory.used++;
    program.has_start = 0;
    if (memory.has_plan && memory.used < PLANNED / CONTROLLER_COMMANDS) {
        copy(wish, memory.plan + memory.used * CONTROLLER_COMMANDS, CONTROLLER_COMMANDS);
        return reason | CONTROLLER_PLAN_CONTINUED;
    }
    return hold(reason, wish);
}

static int fall_back(int reason, double *wish)
{
#if LOADS > 0
    memory.has_coasting = 0;
#endif
    return go_on(reason, wish);
}

/* [state; what stands; the same within bounds; load] */
static void gather(const double *state, double *given)
{
    int i;
    copy(given, state, STATES);
    copy(given + STATES, standing, CONTROLLER_COMMANDS);
    for (i = 0; i < CONTROLLER_COMMANDS; i++)
        given[MEASURED + i] = reachable(i);
#if LOADS > 0
    copy(given + MEASURED + CONTROLLER_COMMANDS, memory.load, LOADS);
#endif
}

#if LOADS > 0
/* Lay what the state did beyond the prediction to the load. */
static void correct_load(const double *state)
{
    double surprise[STATES], pushed[STATES] = {0};
    int i;
    if (!memory.has_coasting)
        return;
    add_product(&by_input, standing, pushed);
    for (i = 0; i < STATES; i++)
        surprise[i] = state[i] - (memory.coasting[i] + pushed[i]);
    add_product(&load_gain, surprise, memory.load);
}
#endif

/* q, l and u: those of the row, moved by what is given. */
static void fill_program(const double *given, const double *row)
{
    static double moved[UNKNOWNS + ROWS];
    int i;
    memset(moved, 0, sizeof moved);
    add_product(&vectors, given, moved);
    for (i = 0; i < UNKNOWNS; i++)
        program.q[i] = row[i] + moved[i];
    for (i = 0; i < ROWS; i++) {
        program.l[i] = row[ROW_L + i] + moved[UNKNOWNS + i];
        program.u[i] = row[ROW_U + i] + moved[UNKNOWNS + i];
    }
}

/* The plan of an answer, kept within bounds: solved to a tolerance, it may leave them by as much. */
static void keep_plan(const double *given, const double *row)
{
    static double known[UNKNOWNS + GIVEN];
    int i;
    copy(known, controller_qp_solver.solution->x, UNKNOWNS);
    copy(known + UNKNOWNS, given, GIVEN);
    copy(memory.plan, row + ROW_INPUTS, PLANNED);
    add_product(&inputs, known, memory.plan);
    for (i = 0; i < PLANNED; i++)
        memory.plan[i] = within(memory.plan[i], low[i % CONTROLLER_COMMANDS],
                                high[i % CONTROLLER_COMMANDS]);
    memory.has_plan = 1;
    memory.used = 0;
    move_on(source_of_x, controller_qp_solver.solution->x, program.x, UNKNOWNS);
    move_on(source_of_y, controller_qp_solver.solution->y, program.y, ROWS);
    program.has_start = 1;
}

static int decide(double time, const double *state, double *wish)
{
    const double *row = row_at(time, memory.row);
    double given[GIVEN];
    int reason;
#if LOADS > 0
    correct_load(state);
#endif
    if (!has_standing)
        stand(row + ROW_BEFORE);
    gather(state, given);
#if LOADS > 0
    copy(memory.coasting, row + ROW_COASTING, STATES);
    add_product(&coasting, given, memory.coasting);
    memory.has_coasting = 1;
#endif
    fill_program(given, row);
    reason = solve_program();
    if (reason != CONTROLLER_OK)
        return go_on(reason, wish);
    keep_plan(given, row);
    copy(wish, memory.plan, CONTROLLER_COMMANDS);
    return CONTROLLER_OK;
}
