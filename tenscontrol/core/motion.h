/* What steps, switches and the loop over steps share: not for callers of the core. */
#ifndef TENSCONTROL_MOTION_H
#define TENSCONTROL_MOTION_H

#include "core.h"
#include "numbers.h"

/* Inputs at one time. */
typedef struct {
  const Number *strings;              /* rest lengths, m, or force densities, N/m */
  const Number *load;                 /* (entries), N, or null */
  const Number *offset, *offset_rate; /* (entries): displacement with supports, m, m/s, or null */
  /* (bars): driven lengths L, m, their rates, m/s, and L L'' + L'^2, m^2/s^2, or null */
  const Number *length, *length_rate, *extension;
} Input;

/* Some of what can switch, ascending: strings, then contacts. */
typedef struct {
  int32_t count, *which;
} Some;

/* A span of a motion: a scene, its inputs as polynomials in time, and memory. */
typedef struct {
  const Scene *scene;
  const Drive *drive;
  const Lengths *lengths; /* null where bars are left as they are */
  int states, switches;
  Number *values, *rates;              /* inputs at one time, and their rates in time */
  Number *extension;                   /* of driven bars */
  Number *work;                        /* of the equation */
  Number *gap, *rate, *middle, *scale; /* of the search for switches */
  Number *restored;                    /* of bars that are put on their lengths */
  Number *coefficients, *rooms, *inside, *outside, *chosen, *leaving, *within, *marked;
  Number *gap0, *gap1; /* at both ends of the step that was searched last */
  int goes_on;         /* whether the next step to be searched begins at its end */
  Some some;           /* those that were listed last */
  Number *carried;     /* of switches in steps that are not cut */
} Span;

/* Of equation.c: memory of one evaluation; by inputs at one time xdot, where what pulls and presses is
   given, or null for what the state says; accelerations by the forces of some that can switch, counted
   by each of at most three rows of weights, (count, switches), that are 0 of others; forces on all
   entries, and gaps: of all that can switch, or at least of some. Where no force depends on velocities,
   rates of gaps need not be asked for. Where lengths are driven, xdot with the force densities of all
   bars, N/m: of bars that are redundant, those of a set that holds the others. */
SHARED size_t equation_work_size(const Scene *scene);
SHARED void slope_of(const Scene *scene, const Number *state, const Input *input, const Number *taut,
                     Number *slope, Number *work);
SHARED void weighed_accelerations(const Scene *scene, const Number *state, const Input *input,
                                  const Some *some, int count, const Number *weights, Number *to,
                                  Number *work);
SHARED void forces_of(const Scene *scene, const Number *state, const Input *input, const Number *taut,
                      Number *forces, Number *work);
SHARED void slope_and_bars(const Scene *scene, const Number *state, const Input *input, const Number *taut,
                           Number *slope, Number *density, Number *work);
SHARED void gap_of(const Scene *scene, const Number *state, const Input *input, const Some *some, Number *gap,
                   Number *rate, Number *work);

/* Of span.c: lays out a span in memory, and returns what is left of it. */
SHARED size_t span_size(const Scene *scene, const Drive *drive);
SHARED Number *begin(Span *span, const Scene *scene, const Drive *drive, const Lengths *lengths,
                     Number *work);
SHARED Input input_at(Span *span, Number time);
SHARED void slope_at(Span *span, const Number *x, Number time, const Number *taut, Number *slope);
SHARED void gap_at(Span *span, const Number *x, Number time, const Some *some, Number *gap, Number *rate);

/* Of frequency.c: the largest frequency of small motions about a state, rad/s, by power iteration that
   begins with a vector. */
SHARED size_t frequency_size(const Scene *scene);
SHARED Number frequency_of(Span *span, const Number *state, Number difference, const double *vector,
                           Number *work);

/* Of lengths.c: bars on their lengths at a time, if the span has any. */
SHARED void restore_bars(Span *span, Number *x, Number time);

/* A step whose switches are looked for: from x to x1 within h from a time, with slopes at both. */
typedef struct {
  const Number *x, *x1, *slope, *slope1, *taut;
  Number time, h;
} Tried;

/* Where a step is cut: the part of it, found on an interpolant, and what is to switch there. */
typedef struct {
  Truth found;
  Number part, speed, aim;
} Cut;

/* A state a part of the way into a step. */
typedef void Place(void *by, Number part, Number *x);

/* How far a string may pass the border before it is acted on, as part of its rest length, and a
   contact as part of the size: it covers round-off. */
static const double BAND = 1e-11;

/* Of events.c: what is marked in any run, how many strings may switch within a step, whether their force depends on velocities,
   lengths that round-off in each gap is a part of, and the path of a step, of degree 5 in time. */
SHARED const Some *list(Span *span, const Number *marked);
SHARED Number crossings(Span *span, const Tried *step);
SHARED Number missed_switches(Span *span, const Tried *step);
SHARED int velocity_dependent(const Scene *scene);
SHARED const Number *gap_scales(Span *span, Number time);
SHARED void make_path(Span *span, const Tried *step);
SHARED void on_path(const Span *span, Number h, Number part, Number *x);
/* Of a step that `crossings` was asked of last. */
SHARED Cut first_switch(Span *span, Truth meant, const Tried *step, Number allowed, double least);
SHARED Number approach(Span *span, const Tried *step, Cut cut, Place *place, void *by, Number *x,
                       Number *places);
SHARED Number switch_over(Span *span, Truth meant, const Number *x, Number time, Number *taut);

/* Of carry.c: so many strings in a step are not landed on, if what they change can be added to it. It
   leaves gaps at the end, and their rates, as `crossings` does. */
enum { MANY_SWITCHES = 12 };
SHARED size_t carry_size(const Scene *scene);
SHARED Number carry(Span *span, Truth meant, const Tried *step, Number *x, Number *taut, Number *defect);

#endif
