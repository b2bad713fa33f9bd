/* Methods of integration: a step, and the loop over steps that end at switches. */
#ifndef TENSCONTROL_METHODS_H
#define TENSCONTROL_METHODS_H

#include "motion.h"

/* States that a method keeps in memory, at most. */
enum { METHOD_STATES = 64 };

int advance_by_rk4(Span *span, const Settings *settings, Progress *progress, double *x,
                   double *taut, double *states, double *work);
int advance_by_dop853(Span *span, const Settings *settings, Progress *progress, double *x,
                      double *slope, double *taut, double *states, double *work);

#endif
