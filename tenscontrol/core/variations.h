/* Small changes of a step, forward, and costs of its end, backward: calls of the core.

   A step is that of an explicit Runge-Kutta method, with switches that stay as they are. Matrices
   have one row an entry; columns are next to one another in memory. */
#ifndef TENSCONTROL_VARIATIONS_H
#define TENSCONTROL_VARIATIONS_H

#include "core.h"

/* An explicit Runge-Kutta method: a (stages, stages), b and c (stages). */
typedef struct {
  int32_t stages;
  const double *a, *b, *c;
} Tableau;

/* Columns in a matrix are a multiple of this many. */
enum { COLUMNS = 8 };

/* Changes of what a step depends on beside its start, in columns; null for what does not change. Of a
   cost its derivatives by them, in one column: those by inputs are written, all others are added. */
typedef struct {
  int32_t columns;
  double gravity[3];          /* m/s^2: weights change with masses */
  double *input;              /* (stages, strings, columns): rest lengths, m, or force densities */
  double *stiffness, *damping; /* (strings, columns) */
  double *load;               /* (entries, columns), N */
  double *bar_mass;           /* (bars, columns), kg */
  double *point_mass;         /* (entries / d, columns), kg */
  double *ground;             /* (grounds, GROUND_NUMBERS, columns) */
} Changes;

/* Work memory of the calls below, as a count of numbers. */
EXPORTED size_t tc_variations_work_size(const Scene *scene, const Drive *drive,
                                        const Tableau *method, int32_t columns);

/* The derivative X (states, columns) of a state becomes that of the state after a step of length h. */
EXPORTED void tc_step_tangents(const Scene *scene, const Drive *drive, const Tableau *method,
                               double h, const double *state, const double *taut,
                               const Changes *changes, double *X, double *work);

/* The derivative of a cost by the state after a step becomes that by the state before it. */
EXPORTED void tc_step_costs(const Scene *scene, const Drive *drive, const Tableau *method, double h,
                            const double *state, const double *taut, Changes *costs, double *mu,
                            double *work);

#endif
