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
  double *carried; /* of switches in steps that are not cut */
} Span;

/* Of equation.c: memory of one evaluation; by inputs at one time xdot, accelerations by the forces of
   what can switch, each counted by a weight, forces on all entries, and gaps. */
size_t equation_work_size(const Scene *scene);
void slope_of(const Scene *scene, const double *state, const Input *input, const double *taut,
              double *slope, double *work);
void weighed_accelerations(const Scene *scene, const double *state, const Input *input,
                           const double *weight, double *accelerations, double *work);
void forces_of(const Scene *scene, const double *state, const Input *input, const double *taut,
               double *forces, double *work);
void gap_of(const Scene *scene, const double *state, const Input *input, double *gap, double *rate,
            double *work);

Input input_at(Span *span, double time);
void slope_at(Span *span, const double *x, double time, const double *taut, double *slope);
void gap_at(Span *span, const double *x, double time, double *gap, double *rate);
void restore_bars(Span *span, double *x);

/* How far a string may pass the border before it is acted on, as part of its rest length, and a
   contact as part of the size: it covers round-off. */
static const double BAND = 1e-11;

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

/* Of events.c: how many strings may switch within a step, whether their force depends on velocities,
   lengths that round-off in each gap is a part of, and the path of a step, of degree 5 in time. */
int crossings(Span *span, const Tried *step);
int missed_switches(Span *span, const Tried *step);
int velocity_dependent(const Scene *scene);
const double *gap_scales(Span *span, double time);
void make_path(Span *span, const Tried *step);
void on_path(const Span *span, double h, double part, double *x);
Cut first_switch(Span *span, const Tried *step, double allowed, double least);
double approach(Span *span, const Tried *step, Cut cut, Place *place, void *by, double *x,
                int *places);
int switch_over(Span *span, const double *x, double time, double *taut);

/* Of carry.c: so many strings in a step are not landed on, if what they change can be added to it. */
enum { MANY_SWITCHES = 12 };
size_t carry_size(const Scene *scene);
int carry(Span *span, const Tried *step, double *x, double *taut, double *defect);

#endif
