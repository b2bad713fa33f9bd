
/* ---- linear-quadratic regulator: u = u0 - K z, less H (held - u0) where winches wind ---- */

static int iterations; /* none, ever */

static void forget(void)
{
}

static int decide(double time, const double *state, double *wish)
{
    int i;
    (void)time;
    copy(wish, equilibrium, CONTROLLER_COMMANDS);
    add_product(&feedback, state, wish);
#if WINDS
    if (has_standing) {
        double off[CONTROLLER_COMMANDS];
        for (i = 0; i < CONTROLLER_COMMANDS; i++)
            off[i] = standing[i] - equilibrium[i];
        add_product(&held_feedback, off, wish);
    }
#endif
    for (i = 0; i < CONTROLLER_COMMANDS; i++)
        if (within_reach(wish, i) != wish[i])
            return CONTROLLER_SATURATED;
    return CONTROLLER_OK;
}

static int fall_back(int reason, double *wish)
{
    return hold(reason, wish);
}
