
/* ---- the face ---- */

int controller_reset(void)
{
    has_standing = 0;
    forget();
    return CONTROLLER_OK;
}

int controller_command(double time, const double *nodes, const double *velocities,
                       double *command)
{
    double state[STATES], wish[CONTROLLER_COMMANDS];
    int i, status = fault_of(time, nodes, velocities);
    iterations = 0;
    if (status == CONTROLLER_OK) {
        measure(nodes, velocities, state);
        status = decide(time, state, wish);
        if (!all_finite(wish, CONTROLLER_COMMANDS))
            status = fall_back(CONTROLLER_BAD_WISH, wish);
    } else {
        status = fall_back(status, wish);
    }
    for (i = 0; i < CONTROLLER_COMMANDS; i++)
        command[i] = within_reach(wish, i);
    stand(command);
    return status;
}

int controller_applied(const double *value)
{
    if (!all_finite(value, CONTROLLER_COMMANDS))
        return CONTROLLER_NOT_FINITE;
    stand(value);
    return CONTROLLER_OK;
}

int controller_iterations(void)
{
    return iterations;
}
