
/* ---- what the solver of quadratic programs says ---- */

#include "controller_active_set.h"

static int iterations; /* changes of the active set in the last sample */

static int reason_of(int status)
{
    switch (status) {
    case ACTIVE_SET_SOLVED:
        return CONTROLLER_OK;
    case ACTIVE_SET_INFEASIBLE:
        return CONTROLLER_INFEASIBLE;
    case ACTIVE_SET_OUT_OF_ITERATIONS:
        return CONTROLLER_OUT_OF_ITERATIONS;
    case ACTIVE_SET_INACCURATE:
        return CONTROLLER_INACCURATE;
    default:
        return CONTROLLER_BAD_DATA;
    }
}
