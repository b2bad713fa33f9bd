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

/* Why a command is not the decision of the controller: status & 15. */
#define CONTROLLER_OK 0                     /* it is the decision */
#define CONTROLLER_SATURATED 1              /* cut off at a bound, or at the largest change */
#define CONTROLLER_NOT_FINITE 2             /* time or measurement not finite */
#define CONTROLLER_INACCURATE 3             /* the program was ... solved inaccurately */
#define CONTROLLER_INFEASIBLE 4             /* ... infeasible */
#define CONTROLLER_UNBOUNDED 5              /* ... unbounded */
#define CONTROLLER_OUT_OF_ITERATIONS 6      /* ... not solved in the iterations allowed */
#define CONTROLLER_OUT_OF_TIME 7            /* ... not solved in the time allowed */
#define CONTROLLER_NOT_CONVEX 8             /* ... not convex */
#define CONTROLLER_INTERRUPTED 9            /* ... interrupted */
#define CONTROLLER_UNSOLVED 10              /* ... not solved */
#define CONTROLLER_BAD_DATA 11              /* ... made of data not finite or too large */
#define CONTROLLER_NOT_PLAUSIBLE 12         /* a measurement that the structure cannot have */
#define CONTROLLER_INPUT_NOT_FINITE 13      /* a decision that is not finite */
#define CONTROLLER_REASON(status) ((status) & 15)

/* The fallback that was commanded: status & 48; 0 if the command is the decision. */
#define CONTROLLER_PLAN_CONTINUED 16        /* the next input of the last plan */
#define CONTROLLER_PREVIOUS_INPUT_HELD 32   /* what the actuators hold */
#define CONTROLLER_EQUILIBRIUM_HELD 48      /* the input of the operating point */
#define CONTROLLER_FALLBACK(status) ((status) & 48)

/* Forget all that was measured, planned or applied. Returns CONTROLLER_OK. */
int controller_reset(void);

/*
 * Decide on the command of the sample that starts now, once a sample.
 *
 *   time        s; matters only for a reference that moves, and is rounded to a whole sample
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
 * Returns CONTROLLER_OK, or CONTROLLER_NOT_FINITE, and then nothing was changed.
 */
int controller_applied(const double *value);

/* Iterations that the solver took in the last call of controller_command; 0 where none ran. */
int controller_iterations(void);

#ifdef __cplusplus
}
#endif

#endif
