/* Small changes of steps, forward, and costs of their end, backward: calls of the core.

   Steps are those of an explicit Runge-Kutta method, with switches that stay as they are. Matrices
   have one row an entry; columns are next to one another in memory. */
#ifndef TENSCONTROL_VARIATIONS_H
#define TENSCONTROL_VARIATIONS_H

#include "core.h"

/* An explicit Runge-Kutta method: a (stages, stages), b and c (stages). */
typedef struct {
  int32_t stages;
  const double *a, *b, *c;
} Tableau;

/* Steps that follow one another, one row each. */
typedef struct {
  int32_t count;
  const double *length; /* (count), s */
  const double *states; /* (count + 1, states): as each begins, and as the last ends */
  const double *inputs; /* (count, .): coefficients of a Drive; unless constant, its time `begin` */
  const double *taut;   /* (count, switches) */
  int32_t first;        /* the number of the first of them */
} Steps;

/* Columns in a matrix are a multiple of this many. */
enum { COLUMNS = 8 };

/* Values that strings have at so many times: (strings, values) columns from the first on, and by what
   each value counts in steps, (steps, rows, values): at each stage, or the same in all of a step. */
typedef struct {
  int32_t first, values, rows; /* stages or 1 */
  const double *share;         /* null where they count by 1 */
} Profile;

/* Changes of what steps depend on beside their start, in columns; null for what does not change. Of a
   cost its derivatives by them, in one column, which are added. */
typedef struct {
  int32_t columns;
  double gravity[3];           /* m/s^2: weights change with masses */
  const Profile *profile;      /* of rest lengths, m, or force densities */
  double *by_values;           /* (strings, values), of a cost */
  double *input;               /* (strings, columns): the same of all stages, beside the profile */
  double *stiffness, *damping; /* (strings, columns) */
  double *load;                /* (entries, columns), N */
  double *bar_mass;            /* (bars, columns), kg */
  double *point_mass;          /* (entries / d, columns), kg */
  double *ground;              /* (grounds, GROUND_NUMBERS, columns) */
} Changes;

/* What switches at the ends of steps, in their order. A change of the gap moves the time of the switch by
   its part of the rate, and the state by the jump of its slope times this. */
typedef struct {
  int32_t count;
  const int32_t *step;    /* (count): ascending, counted from the first of all */
  const double *by_state; /* (count, states): derivative of the gap */
  const double *by_input; /* (count, strings) */
  const double *rate;     /* (count): of the gap just before */
  const double *jump;     /* (count, states): of the slope */
} Switches;

/* Work memory of the calls below, as a count of numbers. */
EXPORTED size_t tc_variations_work_size(const Scene *scene, const Drive *drive, const Tableau *method,
                                        int32_t columns);

/* The derivative X (states, columns) of the state before steps becomes that of the state after them.
   After each, bars that share no nodes are put on their lengths, unless these are null, and what
   switches then is passed, unless that is null. */
EXPORTED void tc_tangents(const Scene *scene, const Drive *drive, const Lengths *lengths,
                          const Tableau *method, const Steps *steps, const Switches *switches,
                          const Changes *changes, double *X, double *work);

/* The derivative of a cost by the state after steps becomes that by the state before them. */
EXPORTED void tc_costs(const Scene *scene, const Drive *drive, const Lengths *lengths, const Tableau *method,
                       const Steps *steps, const Switches *switches, const Changes *costs, double *mu,
                       double *work);

/* Accelerations as steps begin, (count, free), under what pulls in them. */
EXPORTED void tc_accelerations(const Scene *scene, const Drive *drive, const Steps *steps,
                               double *accelerations, double *work);

/* The same by the instructions of one kind of machines. */
typedef size_t VariationsSize(const Scene *scene, const Drive *drive, const Tableau *method, int32_t columns);
typedef void Variations(const Scene *scene, const Drive *drive, const Lengths *lengths, const Tableau *method,
                        const Steps *steps, const Switches *switches, const Changes *changes, double *X,
                        double *work);
typedef void Accelerations(const Scene *scene, const Drive *drive, const Steps *steps, double *accelerations,
                           double *work);
VariationsSize variations_size_by_all, variations_size_by_avx2, variations_size_by_avx512;
Variations tangents_by_all, tangents_by_avx2, tangents_by_avx512;
Variations costs_by_all, costs_by_avx2, costs_by_avx512;
Accelerations accelerations_by_all, accelerations_by_avx2, accelerations_by_avx512;

#endif
