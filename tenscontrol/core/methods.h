/* Methods of integration: a step, and the loop over steps that end at switches. */
#ifndef TENSCONTROL_METHODS_H
#define TENSCONTROL_METHODS_H

#include "core.h"
#include "numbers.h"

/* States that a method keeps in memory, at most. */
enum { METHOD_STATES = 64 };

/* Steps between outputs, in all, and the size of one, s. */
typedef struct {
  int64_t inner, total;
  double h;
} FixedSteps;

SHARED FixedSteps fixed_steps(const Settings *settings);

#endif
