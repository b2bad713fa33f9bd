/* Methods of integration: a step, and the loop over steps that end at switches. */
#ifndef TENSCONTROL_METHODS_H
#define TENSCONTROL_METHODS_H

#include "motion.h"

/* States that a method keeps in memory, at most, and those at outputs that are gathered before they
   are written: of a large structure to whole lines of the cache. */
enum { METHOD_STATES = 64, GATHERED = 8 };

/* Steps between outputs, in all, and the size of one, s. */
typedef struct {
  int64_t inner, total;
  double h;
} FixedSteps;

#ifndef LANES
/* What is kept of a motion: states at outputs, and at ends of steps. */
typedef struct {
  double *states, *step_times, *step_states, *step_taut;
  double *rows; /* (GATHERED, n): outputs to be written */
  int n, switches, columns, column, waiting, room;
} Kept;

/* The memory of the next output. */
double *next_output(Kept *kept);
void write_outputs(Kept *kept);
void keep_step(Kept *kept, Progress *now, double time, const double *x, const double *taut);

int advance_by_rk4(Span *span, const Settings *settings, Progress *now, Kept *kept, double *x, double *taut,
                   double *work);
int advance_by_dop853(Span *span, const Settings *settings, Progress *now, Kept *kept, double *x,
                      double *slope, double *taut, double *work);
#endif

SHARED FixedSteps fixed_steps(const Settings *settings);

#endif
