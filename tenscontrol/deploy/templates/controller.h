/*
 * A controller of a tensegrity structure: one command from each measured motion.
 *
 * All numbers are doubles in SI units. Arrays of nodes hold @AXES@ of the first node, then of the
 * second, and so on: CONTROLLER_COORDINATES numbers. The code allocates no memory and holds one
 * controller: call it from one thread.
 */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#ifdef __cplusplus
extern "C" {
#endif

@SIZES@
@INPUTS@
/* Why a command is not the decision of the controller. */
@STATUSES@
#define CONTROLLER_REASON(status) ((status) & @REASON@)

/* The fallback that was commanded; 0 if the command is the decision. */
@FALLBACKS@
#define CONTROLLER_FALLBACK(status) ((status) & ~@REASON@)

/* Forget all that was measured, planned or applied. Returns CONTROLLER_OK. */
int controller_reset(void);

/*
 * Decide on the command of the sample that starts now, once a sample.
 *
 *   time        s; @TIME@.
 *               One that is not finite counts as a measurement that is not
 *   nodes       positions, m, CONTROLLER_COORDINATES numbers
 *   velocities  m/s, CONTROLLER_COORDINATES numbers
 *   command     out: CONTROLLER_COMMANDS numbers, @UNIT@; finite and within bounds, always
 *
 * Returns the status. It need not be CONTROLLER_OK for the command to be applied.
 */
int controller_command(double time, const double *nodes, const double *velocities,
                       double *command);

/*
 * Set what the actuators hold, where that may not be the last command: before the first command,
 * or after any. Changes are limited from there. Need not be called.
 *
 *   value       CONTROLLER_COMMANDS numbers, @UNIT@
 *
 * Returns CONTROLLER_OK, or CONTROLLER_MEASUREMENT_NOT_FINITE, and then nothing was changed.
 */
int controller_applied(const double *value);

@ESTIMATOR@/* Iterations that the solver took in the last call of controller_command; 0 where none ran. */
int controller_iterations(void);

#ifdef __cplusplus
}
#endif

#endif
