/* The compiled core: equation of motion, steps, located switches, many steps a call.

   Units are SI. Vectors of nodes are stored node by node, d entries each. Places of nodes in tables
   are places of their first entry, d times the number of the node. The state is the free entries of
   the positions, then those of the velocities. A Scene and its tables belong to the caller and are
   not written to; work memory is the caller's too, of `tc_work_size` numbers. */
#ifndef TENSCONTROL_CORE_H
#define TENSCONTROL_CORE_H

#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

/* The same operations, so the same numbers, in wider registers where the machine has them. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

enum { FORCE_DENSITY_HELD, LINEAR_STRINGS, ELASTIC_STRINGS };
enum { LINEAR_GROUND, HERTZ_GROUND, SMOOTH_GROUND };

/* A plane that some nodes can touch. */
typedef struct {
  int32_t kind, count, first_switch; /* of contacts; -1 where the force is smooth */
  int32_t damped, rubs;              /* whether it has damping, friction */
  const int32_t *node;
  double normal[3];
} Ground;

/* Numbers of a plane: stiffness, damping, friction, slip speed, height, width. */
enum { GROUND_NUMBERS = 6 };

/* A structure with its strings, loads, supports and ground. */
typedef struct {
  int32_t dimension, entries, free; /* d; d n; entries that supports leave free */
  int32_t law, damped, strings, segments, clustered, slacking, switches;
  int32_t free_bars, swinging_bars, points, grounds, bars;
  int32_t block_bars, block_rows, unknowns, factors;
  double size;             /* largest extent of the structure, m */
  double shortest;         /* length below which a segment of a cluster has no direction, m */
  const int32_t *free_row; /* (free), or null where all are */
  const double *place;     /* (entries): positions of what supports hold, m */
  const double *load;      /* (entries), N, or null */
  const int32_t *segment_start, *segment_end, *segment_string;
  const double *stiffness, *damping;  /* (strings): N/m or N, and N s/m */
  const int32_t *bar_start, *bar_end; /* (free_bars) */
  const int32_t *bar_row;             /* (free_bars, 2): places of its ends among the free entries */
  const double *bar_constants;
  const int32_t *hinge, *tip;
  const int32_t *tip_row;
  const double *tip_constants;
  const int32_t *point;
  const double *point_inverse_mass;
  const Ground *ground;
  const double *ground_numbers;        /* (grounds, GROUND_NUMBERS) */
  const int32_t *any_start, *any_end;  /* (bars): of all bars, for energies */
  const double *bar_mass, *point_mass; /* (bars), (entries / d): kg */
  /* Bars that share nodes: LDL' of [[M, J'], [J, 0]] in an order without vanishing pivots. The
     array of factors holds the entries below the diagonal, column by column, the diagonal, and one
     entry for what supports hold. */
  const int32_t *block_start, *block_end; /* (block_bars) */
  const int32_t *entry_start, *entry_end; /* (block_bars, d): places of b among the factors */
  const int32_t *right_place;             /* (block_bars): of its equation among the unknowns */
  const double *block_mass;               /* (factors + unknowns + 1) */
  const int32_t *factor_row, *factor_first, *factor_pair;
  const int32_t *block_row, *block_place; /* (block_rows): among the entries, the unknowns */
  /* Where lengths are driven: which of all bars they are. */
  const int32_t *free_bar, *swinging_bar, *block_bar; /* (free_bars), ... (block_bars) */
  const int32_t *segment_row; /* (segments, 2): four times the numbers of their nodes */
} Scene;

/* The inputs of a span as polynomials in time: coefficients of power 0 of all values, of power 1, and
   so on. Values are those of strings, then loads on all entries, then displacements of all, then lengths
   of all bars, m. */
typedef struct {
  const double *coefficients;
  double begin; /* time of the polynomials at the start of the span, s */
  int32_t count, degree, is_loaded, is_moved, is_driven;
} Drive;

/* A block of bars that nothing holds: it is turned as one body to keep its angular momentum. */
typedef struct {
  int32_t bars, nodes;
  const int32_t *start, *end; /* (bars): places of nodes among the free entries */
  const double *bar_mass;
  const int32_t *node; /* (nodes): the same of its nodes */
  const double *point_mass;
} Body;

/* Bars that are put on their lengths after a step, m, or on those of their drives. */
typedef struct {
  const double *bar_length, *tip_length; /* (free_bars), (swinging_bars) */
  const double *block_length;            /* (block_bars) */
  const int32_t *block_free;             /* (block_rows): their places among the free entries */
  int32_t bodies;
  const Body *body;
} Lengths;

/* Nodes or their rates at many times, of any layout: how far apart in memory, in numbers, the axes,
   the nodes and the times of (d, n, times) are. */
typedef struct {
  const double *values;
  int64_t axis, node, time;
} Motion;

/* One coordinate of a node at all times. */
static inline const double *along(const Motion *motion, int node, int axis) {
  return motion->values + axis * motion->axis + node * motion->node;
}

/* Rates of some nodes as intervals begin and end. */
typedef struct {
  Motion begin, end;
  int32_t count;
  const int32_t *nodes; /* (count): which */
} Rates;

/* Finds the largest speeds of nodes beside the mean of them all, as intervals begin and at the end of
   the last, m/s, each at the place of its node. Work memory is three numbers a node. */
EXPORTED void tc_largest_speeds(const Rates *rates, int32_t intervals, double *speed, double *work);

/* Finds pairs of bars and intervals, at whose beginning they are at most as far apart as they may
   come nearer in it, if their ends are so many times faster than their largest speeds, which it finds
   too. Intervals follow one another. `pairs` (count, 4) are the numbers of their nodes in space.
   Writes (pair, interval) of as many as there is room for, and returns how many there are. */
EXPORTED int64_t tc_near_bars(const Motion *nodes, const Rates *rates, int32_t intervals, const double *begin,
                              const double *length, int32_t count, const int32_t *pairs, double faster,
                              int64_t room, int32_t *found, double *speed, double *work);

/* Distances of pairs of nodes at many times, m, (count, times). Of this and what follows, times are
   next to one another in memory. */
EXPORTED void tc_distances(const Motion *nodes, int32_t dimension, int32_t times, int32_t count,
                           const int32_t *pairs, double *distance);

/* Kinetic energy at many times, J, of rates of all nodes, m/s. */
EXPORTED void tc_kinetic_energy(const Scene *scene, int32_t times, const Motion *rates, double *energy);

/* What strings store at many times, less what a load does, J, of nodes, m, inputs (strings, times), or
   (strings) where they are constant, and the load (entries), N, or null. Work memory is two numbers a
   time. */
EXPORTED void tc_potential_energy(const Scene *scene, int32_t times, const Motion *nodes,
                                  const double *inputs, int32_t is_constant, const double *load,
                                  double *energy, double *work);

/* How well a motion keeps its energy and its bars. */
typedef struct {
  double kinetic, energy; /* the largest kinetic energy, and energy by its size, J */
  double change;          /* of energy, from that at the start, at most, J */
  double stretch;         /* of a bar, as part of its length, at most */
} Conservation;

/* Finds it by the bits of the three calls above, and the lengths of all bars, (bars), m. Work memory is
   four numbers a time. */
EXPORTED void tc_conservation(const Scene *scene, int32_t times, const Motion *nodes, const Motion *rates,
                              const double *inputs, int32_t is_constant, const double *load,
                              const double *length, Conservation *found, double *work);

/* A quadrature over parts from 0 to 1, whose first share is 0 and whose last is 1. */
typedef struct {
  int32_t count;
  const double *shares, *weights;
} Quadrature;

/* Finds force densities of bars whose lengths are driven, N/m, (parts + 1, bars), at times of a span, s,
   (parts + 1), from the states there, (parts + 1, states); and what the drives do between them, J, (parts,
   bars), by a quadrature along quintics. What pulls and presses is what the states say. Of redundant
   bars force densities are those of a set that holds the others. */
EXPORTED void tc_strut_work(const Scene *scene, const Drive *drive, const Quadrature *quadrature,
                            int32_t parts, const double *times, const double *states, double *density,
                            double *strut_work, double *work);
/* Its work memory. */
EXPORTED size_t tc_strut_work_size(const Scene *scene, const Drive *drive);

/* A motion between two calls: it goes on from here, to the last bit. */
typedef struct {
  double time, step; /* s */
  int32_t stuck, stalls;
  int64_t tries, rejections, landings, approaches, switches, interpolants, missed, carries, carried,
      short_tries;
  int32_t kept, every, since; /* ends of steps: how many, every which of them, since the last */
  int32_t short_left;         /* by dop853: how many steps of order 5 are to follow */
  double last;                /* by dop853: the error of the step before, if it was of order 8 */
} Progress;

/* How a motion is integrated. */
typedef struct {
  int32_t method; /* RK4_METHOD, DOP853_METHOD or PLAIN_RK4_METHOD */
  int32_t projects;
  int32_t traces;  /* whether each step ends at its first switch, as near as it can, and is kept */
  int32_t outputs; /* equally spaced over the span, the last at its end */
  int32_t budget;  /* steps tried in a call, at most */
  int32_t room;    /* ends of steps that are kept at most, an even number */
  double duration, step, longest;
  double limit;        /* evaluations from which on no step is tried, of dop853 */
  double smooth;       /* a step of dop853 ends at a switch on its interpolant where that errs less than
                          this part of what it may err */
  double loose;        /* the tolerance of dop853 above which steps go across switches */
  double path;         /* outputs are on the path from the ends of a step of dop853 where that errs less
                          than this part of what it may err */
  const double *scale; /* (states): what a step may err, of dop853 */
} Settings;

/* The last looks for no switches: each evaluation finds what pulls and presses in its state. */
enum { RK4_METHOD, DOP853_METHOD, PLAIN_RK4_METHOD };

/* Runs of one scene. What they differ in has one row a run; it is null where all have the scene's. */
typedef struct {
  int32_t count;
  const double *inputs; /* (runs, coefficients of a Drive) */
  const double *stiffness, *damping, *bar_constants, *tip_constants, *point_inverse_mass;
  const double *ground_numbers;
  /* Of dop853: first and longest step, what a step may err, and slopes and what pulls at the start. */
  const double *step, *longest, *scale, *slope, *taut;
} Runs;

/* The hash of the sources, as library.py makes it. */
EXPORTED const char *tc_sources(void);

/* Work memory that every call but the first takes, as a count of numbers. */
EXPORTED size_t tc_motion_work_size(const Scene *scene, const Drive *drive);

/* xdot of a state at the start of a span; taut says which strings pull and which contacts press,
   1 or 0 each. */
EXPORTED void tc_slope(const Scene *scene, const Drive *drive, const double *state, const double *taut,
                       double *slope, double *work);

/* How far strings are from slack and contacts from open, m, and the rates of it, m/s. */
EXPORTED void tc_gap(const Scene *scene, const Drive *drive, const double *state, double *gap, double *rate,
                     double *work);

/* Which strings pull and contacts press in a state. */
EXPORTED void tc_taut(const Scene *scene, const Drive *drive, const double *state, double *taut,
                      double *work);

/* Finds what a motion by dop853 begins with: which strings pull and contacts press, and xdot. Returns
   the largest force on an entry that is free, N; not a number if one of them is none. */
EXPORTED double tc_begin(const Scene *scene, const Drive *drive, const double *state, double *taut,
                         double *slope, double *work);

/* Puts the bars of a state on their lengths at the start of a span. */
EXPORTED void tc_restore(const Scene *scene, const Drive *drive, const Lengths *lengths, double *state,
                         double *work);

/* The largest angular frequency of small motions about a state, rad/s, by power iteration on the
   derivative of the accelerations by positions, from differences of a length. `vector` is where it
   begins. Contacts are taken as open. */
EXPORTED double tc_frequency(const Scene *scene, const Drive *drive, const double *state, double difference,
                             const double *vector, double *work);

/* Evaluations of the equation by dop853 so far. */
EXPORTED double tc_evaluations(const Progress *progress);

/* Integrates until the end of the span, or until the budget or the limit is used up; writes the
   states at outputs that are reached, and returns how many are: one a column of `states`, whose
   first is left for the start. `slope` is that of the state, of dop853. `step_times` (room) and
   `step_states` (room, states) become the ends of steps, and `step_taut` (room, switches), where it is
   traced, what pulled and pressed in them: of every second where they have no room, and so on. */
EXPORTED int32_t tc_advance(const Scene *scene, const Drive *drive, const Lengths *lengths,
                            const Settings *settings, Progress *progress, double *state, double *slope,
                            double *taut, double *states, double *step_times, double *step_states,
                            double *step_taut, double *work);

/* Spans of one motion, one after the other, and by what dop853 finds its steps and what they may err. */
typedef struct {
  int32_t count;
  const double *inputs;   /* (count, .): coefficients of a Drive; unless constant, its time `begin` */
  const double *duration; /* (count), s */
  const int32_t *outputs; /* (count) */
  double tolerance, length, mass, frequency; /* m, kg, rad/s */
  double first, whole, stable; /* first step over its rule; longest over duration, over 1 / frequency */
} Spans;

/* Finds what a motion by dop853 begins with, as `tc_begin` does, and by tolerance to stable of `rules`
   its steps: `scale` (states) becomes what they may err. Sets step, longest and scale of the settings. */
EXPORTED void tc_start(const Scene *scene, const Drive *drive, const Spans *rules, Settings *settings,
                       const double *state, double *taut, double *slope, double *scale, double *work);

/* Integrates spans from a state, as `tc_start` and `tc_advance` do one by one, and returns how many it
   has come over. It ends before a span that it cannot finish within the budget and the limit, or whose
   ends of steps have no room left, at its beginning. Of the settings duration, outputs, longest and
   scale are those of each span. Of each `progress` says the same as ever; its states at outputs,
   (states, outputs + 1), begin with that at its start, and follow those of the spans before, as its
   ends of steps do. Work memory is 3 `states` + `switches` more. */
EXPORTED int32_t tc_advance_spans(const Scene *scene, const Drive *drive, const Lengths *lengths,
                                  const Settings *settings, const Spans *spans, Progress *progress,
                                  double *state, double *states, double *step_times, double *step_states,
                                  double *step_taut, double *work);

/* Finds what runs by dop853 begin with, from the states of `start`, one a row: largest frequencies as
   `tc_frequency` does, (runs), or null where they are known, the largest force on an entry that is
   free, (runs), and slopes and what pulls, one row a run. */
EXPORTED void tc_begin_runs(const Scene *scene, const Drive *drive, const Runs *runs, const double *start,
                            const double *difference, const double *vector, double *frequency, double *force,
                            double *slope, double *taut, double *work);

/* Integrates many runs, to the bits of `tc_advance`, from the states of `start`, one a row;
   writes the states at outputs, (runs, outputs, states), and the progress of each run. All end
   after the step they are in once `stop` is not 0; by dop853 a run ends, too, where it is stuck or
   has reached the limit. */
EXPORTED void tc_advance_runs(const Scene *scene, const Drive *drive, const Lengths *lengths,
                              const Settings *settings, const Runs *runs, const double *start, double *states,
                              Progress *progress, const volatile int32_t *stop, double *work);
/* Work memory of both. */
EXPORTED size_t tc_runs_work_size(const Scene *scene, const Drive *drive, const Settings *settings,
                                  const Runs *runs);

#endif
