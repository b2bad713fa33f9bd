/* What steps, switches and the loop over steps share: not for callers of the core. */
#ifndef TENSCONTROL_MOTION_H
#define TENSCONTROL_MOTION_H

#include "core.h"

/* Inputs at one time. */
typedef struct {
  const double *strings;              /* rest lengths, m, or force densities, N/m */
  const double *load;                 /* (entries), N, or null */
  const double *offset, *offset_rate; /* (entries): displacement with supports, m, m/s, or null */
} Input;

/* A span of a motion: a scene, its inputs as polynomials in time, and memory. */
typedef struct {
  const Scene *scene;
  const Drive *drive;
  const Lengths *lengths; /* null where bars are left as they are */
  int states, switches;
  double *values, *rates; /* inputs at one time, and their rates in time */
  double *work;           /* of the equation */
  double *gap, *rate, *middle, *scale; /* of the search for switches */
  double *restored; /* of bars that are put on their lengths */
  double *coefficients, *rooms, *inside, *outside, *chosen, *leaving, *within;
} Span;

/* Of equation.c: memory of one evaluation, xdot, forces on all entries and gaps by inputs at one
   time. */
size_t equation_work_size(const Scene *scene);
void slope_of(const Scene *scene, const double *state, const Input *input, const double *taut,
              double *slope, double *work);
void forces_of(const Scene *scene, const double *state, const Input *input, const double *taut,
               double *forces, double *work);
void gap_of(const Scene *scene, const double *state, const Input *input, double *gap, double *rate,
            double *work);

Input input_at(Span *span, double time);
void slope_at(Span *span, const double *x, double time, const double *taut, double *slope);
void gap_at(Span *span, const double *x, double time, double *gap, double *rate);
void restore_bars(Span *span, double *x);

/* A state a part of the way into a step. */
typedef void Place(void *step, double part, double *x);

/* A step whose switches are looked for: from x to x1 within h from a time, with slopes at both. */
typedef struct {
  const double *x, *x1, *slope, *slope1, *taut;
  double time, h;
} Tried;

/* Where a step is cut: the part of it, found on an interpolant, and what is to switch there. */
typedef struct {
  int found;
  double part, speed, aim;
} Cut;

int is_crossed(Span *span, const Tried *step);
int missed_switches(Span *span, const Tried *step);
Cut first_switch(Span *span, const Tried *step, double allowed, double least);
double approach(Span *span, const Tried *step, Cut cut, Place *place, void *by, double *x,
                int *places);
int switch_over(Span *span, const double *x, double time, double *taut);

#endif
