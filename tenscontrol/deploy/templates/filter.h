
/* ---- state estimate from readings ----
 *
 * Once a sample: controller_estimate with the readings that have arrived, controller_command with
 * the estimate, then controller_predict with what the actuators hold until the next sample.
 */
#define FILTER_NUMBERS @READINGS@ /* numbers read at a sample */

/* Start as newly made. Returns CONTROLLER_OK. */
int controller_estimator_reset(void);

/*
 * Estimate the motion now.
 *
 *   readings    FILTER_NUMBERS numbers: @KINDS_READ@;
 *               NAN is a lost reading, one that is infinite is refused
 *   nodes       out: positions, m, CONTROLLER_COORDINATES numbers
 *   velocities  out: m/s, CONTROLLER_COORDINATES numbers
 *
 * Returns what became of the readings: CONTROLLER_OK if all were used. The estimate is finite.
 */
int controller_estimate(const double *readings, double *nodes, double *velocities);

/*
 * Predict the next sample.
 *
 *   held        what the actuators hold until then, CONTROLLER_COMMANDS numbers, @HELD@
 *
 * Returns CONTROLLER_OK; or CONTROLLER_INPUT_NOT_FINITE, or CONTROLLER_MEASUREMENT_NOT_PLAUSIBLE of a
 * length that a bar cannot have, and then nothing was changed.
 */
int controller_predict(const double *held);
