/* Small changes of steps: included by files that say by which instructions.

   The derivatives of all members at the stages of steps are found of several steps at once, which are
   in lanes, since what each begins with is known. Then step follows step: several columns of changes
   are in lanes as they are multiplied with these derivatives. */
#include <string.h>

#include "carry.c"
#include "equation.c"
#include "events.c"
#include "frequency.c"
#include "lengths.c"
#include "span.c"

#include "columns.h"
#include "lanes_tables.h"
#include "slopes.h"

/* Derivatives of a string's tension, N (of its force density, N/m, where no length is needed): by its
   length, rest length, stiffness, and where it is damped rate and damping. */
enum { BY_LENGTH, BY_REST, BY_STIFFNESS, BY_RATE, BY_DAMPING };

/* Of the mass of a bar, what each end has of the acceleration of itself and of the other. */
static const double OWN = 1.0 / 3, OTHER = 1.0 / 6;

/* Put in line, so that what it is given stays in registers. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

/* Where the derivatives of members are among those of a point, and how many numbers these are. */
typedef struct {
  int of_string, of_contact, of_bar, of_block_bar; /* numbers of each */
  size_t along, turning, weight, matrix, string, contact, free_bar, swinging_bar, block_bar, factors,
      acceleration, size;
} Layout;

static Layout layout_of(const Scene *s) {
  const size_t d = s->dimension, m = s->segments;
  size_t contacts = 0;
  Layout at;
  for (int i = 0; i < s->grounds; ++i) contacts += s->ground[i].count;
  at.of_string = s->damped ? 5 : 3;
  at.of_contact = (int)(1 + d * (2 * d + GROUND_NUMBERS)); /* whether it presses, and slopes */
  at.of_bar = (int)(4 * d + 1);                            /* its vector, force density, and slopes of that */
  at.of_block_bar = (int)(2 * d + 1);                      /* its rate, acceleration and force density */
  at.along = 0;                                            /* (segments, d): its direction */
  at.turning = at.along + m * d;                    /* (segments, d): the rate of its length by its vector */
  at.weight = at.turning + (s->damped ? m * d : 0); /* (segments): pull by vector */
  /* (segments, d (d + 1) / 2): of a string of one segment, all of the pull by its vector */
  at.matrix = at.weight + m;
  at.string = at.matrix + (s->clustered ? 0 : m * d * (d + 1) / 2);
  at.contact = at.string + at.of_string * (size_t)s->strings;
  at.free_bar = at.contact + at.of_contact * contacts;
  at.swinging_bar = at.free_bar + at.of_bar * (size_t)s->free_bars;
  at.block_bar = at.swinging_bar + at.of_bar * (size_t)s->swinging_bars;
  at.factors = at.block_bar + at.of_block_bar * (size_t)s->block_bars;
  at.acceleration = at.factors + (s->block_bars ? s->factors + s->unknowns + 1 : 0);
  at.size = (at.acceleration + s->entries + WIDTH - 1) / WIDTH * WIDTH;
  return at;
}

/* Free entries into all entries; those that supports hold are 0. */
static void spread_free(const Scene *s, const double *free, double *all_entries) {
  if (s->free_row) memset(all_entries, 0, s->entries * sizeof *all_entries);
  for (int i = 0; i < s->free; ++i) all_entries[s->free_row ? s->free_row[i] : i] = free[i];
}

static void from_all(const Scene *s, const Number *all_entries, Number *free) {
  for (int i = 0; i < s->free; ++i) free[i] = all_entries[s->free_row ? s->free_row[i] : i];
}

/* The force density of a string and its derivatives; those of one that is slack are 0. */
static Number string_slopes(const Scene *s, int i, Number length, Number rate, Number rest, Number taut,
                            Number *by) {
  const Number k = numbers(s->stiffness)[i], c = numbers(s->damping)[i];
  Number gamma, slopes[5];
  if (s->damped) {
    if (s->law == LINEAR_STRINGS)
      linear_damped_force_density_slopes(length, rest, rate, k, c, &gamma, slopes);
    else elastic_damped_force_density_slopes(length, rest, rate, k, c, &gamma, slopes);
    by[BY_RATE] = slopes[2] * taut;
    by[BY_STIFFNESS] = slopes[3] * taut;
    by[BY_DAMPING] = slopes[4] * taut;
  } else {
    if (s->law == LINEAR_STRINGS) linear_undamped_force_density_slopes(length, rest, k, &gamma, slopes);
    else elastic_undamped_force_density_slopes(length, rest, k, &gamma, slopes);
    by[BY_STIFFNESS] = slopes[2] * taut;
  }
  by[BY_LENGTH] = slopes[0] * taut;
  by[BY_REST] = slopes[1] * taut;
  return gamma * taut;
}

/* What is at a point, or changes of it, in lanes. */
typedef struct {
  Number *p, *v, *f, *a;                                 /* (entries) */
  Number *bar_rate, *bar_acceleration;                   /* (free bars, d): of their vectors */
  Number *length;                                        /* (segments) */
  Number *string_length, *string_rate, *tension, *input; /* (strings) */
  Number *unknowns;                                      /* of bars that share nodes */
} Point;

/* Changes of what strings are given, in lanes: null if none changes. */
typedef struct {
  const Number *change; /* (strings) */
  const int *string;    /* (count): those for which it is other than 0; null for all */
  int count;
} Given;

/* A cost by what is at a point. */
typedef struct {
  double *p, *v, *f, *a, *tension, *unknowns;
} Cost;

/* By what values of a profile count at one time; by nothing before the first and from the end on. */
typedef struct {
  const double *share;
  int first, end;
} Shares;

/* Adds a cost by what a string is given, by each value of a profile, too. */
static inline void add_input_cost(const Changes *c, int string, const Shares *shares, double cost) {
  if (c->input) c->input[string] += cost;
  for (int k = shares->first; k < shares->end; ++k)
    c->by_values[(size_t)c->profile->values * string + k] += shares->share[k] * cost;
}

static size_t point_size(const Scene *s) {
  return 4 * (size_t)s->entries + s->segments + 4 * (size_t)s->strings + s->unknowns +
         2 * s->dimension * (size_t)s->free_bars;
}

static Point point_in(const Scene *s, Number **memory) {
  Number *work = *memory;
  Point point;
  Number **arrays[] = {&point.p, &point.v, &point.f, &point.a};
  Number **of_strings[] = {&point.string_length, &point.string_rate, &point.tension, &point.input};
  for (int i = 0; i < 4; ++i, work += s->entries) *arrays[i] = work;
  for (int i = 0; i < 4; ++i, work += s->strings) *of_strings[i] = work;
  point.length = work;
  point.unknowns = work + s->segments;
  point.bar_rate = point.unknowns + s->unknowns;
  point.bar_acceleration = point.bar_rate + s->dimension * s->free_bars;
  *memory += point_size(s);
  return point;
}

#define SOLVE solve_columns
#define FACTOR double
#define ENTRY Number
#include "solve_body.h"
#define SOLVE solve_numbers
#define FACTOR double
#define ENTRY double
#include "solve_body.h"

/* Rows that are advanced together, so that each weight is read once for all of them. */
enum { ROWS = 9 };

#define D 2
#include "variations_body.h"
#undef D
#define D 3
#include "variations_body.h"
#undef D

/* Accelerations that count at each stage, and at the end of a step. */
typedef struct {
  int *first;     /* (stages + 2): where those of each begin */
  size_t *at;     /* how many bytes behind the first they are */
  double *once;   /* by what they count in a step of 1 s */
  Number *weight; /* and in some steps */
} Terms;

/* What both calls share: the steps, and the derivatives of members at the stages of those in the lanes. */
typedef struct {
  Batch batch; /* of the steps in the lanes */
  const Scene *scene;
  const Tableau *method;
  const Steps *steps;
  const Switches *switches;
  Layout at;
  double *twice; /* (stages + 1, stages): what accelerations count by in places, of the end, too */
  Terms in_places, in_rates;
  Number *drift;  /* (stages + 1): what rates count by in places */
  size_t apart;   /* accelerations of stages: those of free bars' vectors follow those of entries */
  double *points; /* (steps, stages, numbers of a point) */
  Point now;
  Number *inputs, *taut, *q, *v, *accelerations, *x;
  Number *rest; /* memory that is left */
} Sweep;

static size_t apart_of(const Scene *s) { return s->free + s->dimension * (size_t)s->free_bars; }

/* Numbers of the terms of a method, and how they are weighed. */
static size_t terms_size(size_t stages) {
  return stages * (stages + 1) + 2 * (stages + 2 + 2 * stages * (stages + 1));
}

static size_t sweep_size(const Scene *s, const Drive *drive, const Tableau *method, const Layout *at) {
  const Runs alike = {0};
  const size_t stages = method->stages;
  return shared_size(s, drive, &alike) + s->switches + stages * apart_of(s) + 4 * s->free + point_size(s) +
         at->size + stages * at->size + (stages + 1) * (2 * stages + 1);
}

/* Of bars on their lengths: their vectors and rates, and three numbers. */
static size_t restored_bars_size(const Scene *s) {
  return (2 * s->dimension + 3) * (size_t)(s->free_bars + s->swinging_bars) / WIDTH + 1;
}

static size_t forward_size(const Scene *s, const Tableau *method, int columns) {
  return ((size_t)columns / WIDTH * 2 + 2) * s->free + method->stages * apart_of(s) + point_size(s) +
         s->dimension * (size_t)s->free_bars + restored_bars_size(s);
}

/* Numbers of a row of a cost, whole registers of them. */
static size_t padded(const Scene *s) { return ((size_t)s->free + WIDTH - 1) / WIDTH * WIDTH; }

static size_t backward_size(const Scene *s, const Tableau *method) {
  return 2 * (method->stages + 2) * padded(s) + 2 * (3 * (size_t)method->stages + 2) +
         4 * (size_t)s->entries + s->strings + s->unknowns;
}

size_t LANES_NAME(variations_size)(const Scene *s, const Drive *drive, const Tableau *method,
                                   int32_t columns) {
  const Layout at = layout_of(s);
  const size_t stages = method->stages, backward = backward_size(s, method) / WIDTH + 1;
  const size_t forward = forward_size(s, method, columns);
  return WIDTH * (2 + sweep_size(s, drive, method, &at) + (forward > backward ? forward : backward)) +
         terms_size(stages);
}

static Number *taken(Number **memory, size_t count) {
  Number *block = *memory;
  *memory += count;
  return block;
}

/* Lays out the terms of so many stages, none yet. */
static void begin_terms(Terms *terms, int stages, double *work) {
  terms->once = work;
  terms->first = (int *)(work + stages * (stages + 1));
  terms->at = (size_t *)(work + stages * (stages + 1) + stages + 2);
  memset(terms->first, 0, (stages + 2) * sizeof(int));
}

/* Adds a term to a stage, of which all before have theirs, unless it counts by nothing. */
static void add_term(Terms *terms, int stage, size_t at, double once) {
  int *end = terms->first + stage + 1;
  if (*end < end[-1]) *end = end[-1];
  if (once == 0) return;
  terms->once[*end] = once;
  terms->at[(*end)++] = at;
}

static void begin_sweep(Sweep *sweep, const Scene *s, const Drive *drive, const Tableau *method,
                        const Steps *steps, const Switches *switches, double *work) {
  const int n = method->stages;
  const size_t half = s->free;
  const Runs own = {.count = steps->count, .inputs = steps->inputs};
  Number *rest;
  sweep->scene = s;
  sweep->method = method;
  sweep->steps = steps;
  sweep->switches = switches;
  sweep->at = layout_of(s);
  sweep->apart = apart_of(s);
  sweep->twice = work;
  begin_terms(&sweep->in_places, n, work + n * (n + 1));
  begin_terms(&sweep->in_rates, n, (double *)(sweep->in_places.at + n * (n + 1)));
  for (int i = 0; i <= n; ++i) {
    const double *weights = i < n ? method->a + i * n : method->b;
    for (int j = 0; j < n; ++j) {
      double sum = 0, size = 0;
      for (int k = 0; k < n; ++k) {
        const double term = weights[k] * method->a[k * n + j];
        sum += term;
        size += fabs(term);
      }
      sweep->twice[i * n + j] = fabs(sum) > 1e-14 * size ? sum : 0; /* or else it is round-off */
      add_term(&sweep->in_places, i, sweep->apart * j * sizeof(Number), sweep->twice[i * n + j]);
      add_term(&sweep->in_rates, i, sweep->apart * j * sizeof(Number), weights[j]);
    }
  }
  rest = share(&sweep->batch, s, drive, 0, &own, aligned(work + terms_size(n)));
  sweep->inputs = taken(&rest, (size_t)drive->count * (drive->degree + 1));
  sweep->batch.drive.coefficients = (const double *)sweep->inputs;
  sweep->batch.drive.begin = 0; /* times are those of the polynomials */
  sweep->taut = taken(&rest, s->switches);
  sweep->accelerations = taken(&rest, n * sweep->apart);
  sweep->in_places.weight = taken(&rest, n * (n + 1));
  sweep->in_rates.weight = taken(&rest, n * (n + 1));
  sweep->drift = taken(&rest, n + 1);
  sweep->q = taken(&rest, 2 * half);
  sweep->v = taken(&rest, 2 * half);
  sweep->now = point_in(s, &rest);
  sweep->x = taken(&rest, sweep->at.size);
  sweep->points = (double *)taken(&rest, n * sweep->at.size);
  sweep->rest = rest;
}

static const double *point_of(const Sweep *sweep, int step, int stage) {
  return sweep->points + ((size_t)step * sweep->method->stages + stage) * sweep->at.size;
}

/* The first switch at the end of a step or later; all of them come before `count`. */
static int switch_from(const Sweep *sweep, int step) {
  const Switches *switches = sweep->switches;
  int first = 0, count = switches ? switches->count : 0;
  while (first < count) { /* by halves */
    const int middle = (first + count) / 2;
    if (switches->step[middle] < sweep->steps->first + step) first = middle + 1;
    else count = middle;
  }
  return first;
}

/* Adds accelerations, each counted by a weight, to some rows of what would be without them. */
INLINE void add_accelerations(int rows, const Terms *terms, int stage, const Number *accelerations,
                              const Number *start, const Number *rate, Number drift, Number *to) {
  const size_t *at = terms->at + terms->first[stage], *end = terms->at + terms->first[stage + 1];
  const Number *weight = terms->weight + terms->first[stage];
  Number sum[ROWS];
  for (int k = 0; k < rows; ++k) sum[k] = rate ? start[k] + drift * rate[k] : start[k];
  for (; at < end; ++at, ++weight) {
    const Number *a = (const Number *)((const char *)accelerations + *at), by = *weight;
    for (int k = 0; k < rows; ++k) sum[k] += by * a[k];
  }
  for (int k = 0; k < rows; ++k) to[k] = sum[k];
}

/* The same for all rows. */
INLINE void advance_rows(const Terms *terms, int stage, size_t count, const Number *accelerations,
                         const Number *start, const Number *rate, Number drift, Number *to) {
  size_t k = 0;
  for (; k + ROWS <= count; k += ROWS)
    add_accelerations(ROWS, terms, stage, accelerations + k, start + k, rate ? rate + k : 0, drift, to + k);
  for (; k < count; ++k)
    add_accelerations(1, terms, stage, accelerations + k, start + k, rate ? rate + k : 0, drift, to + k);
}

/* Places at a stage, or at the end of a step, from those at its begin, the rates there and the
   accelerations at stages, (stages, half). */
static void advance_places(const Sweep *sweep, int stage, const Number *accelerations, const Number *place,
                           const Number *rate, Number *to) {
  advance_rows(&sweep->in_places, stage, sweep->scene->free, accelerations, place, rate, sweep->drift[stage],
               to);
}

/* Rates of so many rows. */
static void advance_rates(const Sweep *sweep, int stage, size_t count, const Number *accelerations,
                          const Number *rate, Number *to) {
  advance_rows(&sweep->in_rates, stage, count, accelerations, rate, 0, all(0), to);
}

/* Weighs accelerations for steps of these lengths, s. */
static void weigh_stages(Sweep *sweep, Number h) {
  const Tableau *method = sweep->method;
  const int n = method->stages;
  for (int i = 0; i <= n; ++i) sweep->drift[i] = i < n ? method->c[i] * h : h;
  for (int m = 0; m < sweep->in_places.first[n + 1]; ++m)
    sweep->in_places.weight[m] = sweep->in_places.once[m] * h * h;
  for (int m = 0; m < sweep->in_rates.first[n + 1]; ++m)
    sweep->in_rates.weight[m] = sweep->in_rates.once[m] * h;
}

/* Whole registers of numbers of the first lanes, each lane to a place of its own, so far apart. */
static void from_lanes(const Number *x, size_t size, int count, double *to, size_t apart) {
  for (size_t part = 0; part < size; part += WIDTH, x += WIDTH) {
    Number rows[WIDTH];
    columns(x, rows);
    for (int i = 0; i < count; ++i) *(Number *)(to + i * apart + part) = rows[i];
  }
}

/* Finds the derivatives of all members at the stages of some steps, at most as many as there are lanes. */
static void reach_stages(Sweep *sweep, int first, int count) {
  const Scene *lanes = &sweep->batch.scene;
  const Tableau *method = sweep->method;
  const Steps *steps = sweep->steps;
  const Drive *drive = &sweep->batch.drive;
  const Point *now = &sweep->now;
  const size_t size = sweep->at.size, half = lanes->free;
  const int stages = method->stages, numbers_of_input = drive->count * (drive->degree + 1);
  Number h = all(0), begin = all(0);
  for (int i = 0; i < WIDTH; ++i) {
    const int k = first + (i < count ? i : count - 1);
    const double *inputs = steps->inputs + (size_t)(numbers_of_input + (drive->degree > 0)) * k;
    put(steps->length[k], &h, i);
    put_row(steps->states, k, 2 * lanes->free, sweep->q, i);
    put_row(steps->taut, k, lanes->switches, sweep->taut, i);
    for (int m = 0; m < numbers_of_input; ++m) put(inputs[m], sweep->inputs + m, i);
    if (drive->degree) put(inputs[numbers_of_input], &begin, i);
  }
  if (lanes->free_row) {
    memcpy(now->p, lanes->place, lanes->entries * sizeof(Number));
    memset(now->v, 0, lanes->entries * sizeof(Number));
  }
  weigh_stages(sweep, h);
  for (int i = 0; i < stages; ++i) {
    Number *q = sweep->v, *v = q + half, *to = sweep->accelerations + i * sweep->apart;
    const Input input = input_at(&sweep->batch.span, begin + method->c[i] * h);
    Point there = *now;
    advance_places(sweep, i, sweep->accelerations, sweep->q, sweep->q + half, q);
    advance_rates(sweep, i, half, sweep->accelerations, sweep->q + half, v);
    if (lanes->free_row) {
      for (size_t m = 0; m < half; ++m) now->p[lanes->free_row[m]] = q[m];
      for (size_t m = 0; m < half; ++m) now->v[lanes->free_row[m]] = v[m];
    } else {
      there.p = q;
      there.v = v;
    }
    if (lanes->dimension == 2) differentiated_2(lanes, &sweep->at, &input, sweep->taut, &there, sweep->x);
    else differentiated_3(lanes, &sweep->at, &input, sweep->taut, &there, sweep->x);
    from_all(lanes, now->a, to);
    from_lanes(sweep->x, size, count, sweep->points + i * size, stages * size);
  }
}

/* ---- forward ---- */

/* Columns of a matrix into a block of their own, and back. */
static void pack(const double *X, int columns, int rows, int first, Number *block) {
  for (int i = 0; i < rows; ++i) block[i] = *numbers(X + (size_t)columns * i + first);
}

static void unpack(const Number *block, int columns, int rows, int first, double *X) {
  for (int i = 0; i < rows; ++i) *(Number *)(X + (size_t)columns * i + first) = block[i];
}

/* Where the columns of a block are among the values of a profile, and how its inputs change beside. */
typedef struct {
  Number *change; /* (strings); null if none changes */
  int lanes;      /* that are values of the profile, from the first on */
  int first, string[WIDTH], value[WIDTH];
  double beside[WIDTH];
  int strings, own[WIDTH]; /* those of these lanes, each once */
} Inputs;

static Inputs inputs_forward(const Scene *s, const Changes *c, int first, Number *change) {
  const Profile *profile = c->profile;
  Inputs inputs = {.change = 0};
  for (int j = 0; j < WIDTH && profile; ++j) {
    const int column = first + j - profile->first;
    if (column < 0 || column >= s->strings * profile->values) continue;
    if (!inputs.lanes) inputs.first = j;
    inputs.string[inputs.lanes] = column / profile->values;
    inputs.value[inputs.lanes] = column % profile->values;
    if (!inputs.lanes || inputs.string[inputs.lanes] != inputs.string[inputs.lanes - 1])
      inputs.own[inputs.strings++] = inputs.string[inputs.lanes];
    ++inputs.lanes;
  }
  if (!inputs.lanes && !c->input) return inputs;
  inputs.change = change;
  for (int i = 0; i < s->strings; ++i)
    change[i] = c->input ? *numbers(c->input + (size_t)c->columns * i + first) : all(0);
  for (int m = 0; m < inputs.lanes; ++m) inputs.beside[m] = lane(change + inputs.string[m], inputs.first + m);
  return inputs;
}

/* By what the values of a profile count at a stage of a step; null where they count by 1. */
static const double *share_at(const Profile *profile, size_t step, int stage) {
  const size_t row = step * profile->rows + (profile->rows > 1 ? stage : 0);
  return profile->share ? profile->share + row * profile->values : 0;
}

/* Enters what values of a profile change of the inputs at a stage. */
static void enter_values(const Inputs *inputs, const double *share) {
  for (int m = 0; m < inputs->lanes; ++m)
    put(inputs->beside[m] + (share ? share[inputs->value[m]] : 1), inputs->change + inputs->string[m],
        inputs->first + m);
}

/* A block of columns past what switches at the end of a step, with what changes of the inputs then. */
static void pass_switches(const Sweep *sweep, int k, const Number *input, Number *block) {
  const Scene *s = sweep->scene;
  const Switches *switches = sweep->switches;
  const int n = 2 * s->free, end = switch_from(sweep, k + 1);
  for (int e = switch_from(sweep, k); e < end; ++e) {
    const double *by_state = switches->by_state + (size_t)n * e;
    const double *by_input = switches->by_input + (size_t)s->strings * e;
    const double *jump = switches->jump + (size_t)n * e;
    Number moved = all(0);
    for (int i = 0; i < n; ++i) moved += by_state[i] * block[i];
    for (int i = 0; i < s->strings && input; ++i) moved += by_input[i] * input[i];
    moved *= 1 / switches->rate[e];
    for (int i = 0; i < n; ++i) block[i] += jump[i] * moved;
  }
}

/* Whether forces hang on rates of nodes, beside those of free bars along their vectors. */
static int needs_rates(const Scene *s) {
  return s->damped || s->grounds || s->swinging_bars || s->block_bars;
}

/* A block of columns over a step, after which bars are put on their lengths unless these are null. */
static void step_block(const Sweep *sweep, const void *restored, int k, int in_lanes, const Changes *changes,
                       int first, Number *block, Number *memory) {
  const Scene *s = sweep->scene;
  const int stages = sweep->method->stages, is_plane = s->dimension == 2, has_rates = needs_rates(s);
  const size_t half = s->free, of_bars = sweep->apart - half;
  const Point now = point_in(s, &memory);
  Number *q = taken(&memory, half), *v = taken(&memory, half), *bar_rates = taken(&memory, of_bars);
  Number *accelerations = memory;
  const Inputs inputs = inputs_forward(s, changes, first, now.input);
  const Given given = {inputs.change, changes->input ? 0 : inputs.own, inputs.strings};
  Point there = now;
  if (s->free_row) memset(now.p, 0, 2 * s->entries * sizeof *now.p);
  else {
    there.p = q;
    there.v = v;
  }
  if (!has_rates && is_plane) bar_differences_2(s, s->bar_row, block + half, bar_rates);
  else if (!has_rates) bar_differences_3(s, s->bar_row, block + half, bar_rates);
  for (int i = 0; i < stages; ++i) {
    const double *x = point_of(sweep, in_lanes, i);
    Number *to = accelerations + i * sweep->apart;
    if (inputs.lanes && (i == 0 || changes->profile->rows > 1))
      enter_values(&inputs, share_at(changes->profile, k, i));
    advance_places(sweep, i, accelerations, block, block + half, q);
    if (has_rates) advance_rates(sweep, i, half, accelerations, block + half, v);
    else advance_rates(sweep, i, of_bars, accelerations + half, bar_rates, there.bar_rate);
    if (s->free_row) {
      for (size_t m = 0; m < half; ++m) now.p[s->free_row[m]] = q[m];
      for (size_t m = 0; m < half && has_rates; ++m) now.v[s->free_row[m]] = v[m];
    } else {
      there.a = to;
    }
    there.bar_acceleration = to + half;
    if (has_rates && is_plane) rates_of_bars_2(s, &there);
    else if (has_rates) rates_of_bars_3(s, &there);
    if (is_plane) forward_2(s, &sweep->at, x, changes, first, &given, &there);
    else forward_3(s, &sweep->at, x, changes, first, &given, &there);
    if (s->free_row) from_all(s, now.a, to);
  }
  advance_places(sweep, stages, accelerations, block, block + half, block);
  advance_rates(sweep, stages, half, accelerations, block + half, block + half);
  if (restored && is_plane) restored_forward_2(s, restored, block);
  else if (restored) restored_forward_3(s, restored, block);
  pass_switches(sweep, k, inputs.change, block); /* the last stage was at the end */
}

void LANES_NAME(tangents)(const Scene *s, const Drive *drive, const Lengths *lengths, const Tableau *method,
                          const Steps *steps, const Switches *switches, const Changes *changes, double *X,
                          double *work) {
  const int columns = changes->columns, n = 2 * s->free;
  Sweep sweep;
  Number *blocks;
  double *restored;
  begin_sweep(&sweep, s, drive, method, steps, switches, work);
  blocks = taken(&sweep.rest, (size_t)n * (columns / WIDTH));
  restored = (double *)taken(&sweep.rest, restored_bars_size(s));
  for (int first = 0; first < columns; first += WIDTH)
    pack(X, columns, n, first, blocks + (size_t)n * (first / WIDTH));
  for (int k = 0; k < steps->count; k += WIDTH) {
    const int some = steps->count - k < WIDTH ? steps->count - k : WIDTH;
    reach_stages(&sweep, k, some);
    for (int i = 0; i < some; ++i) {
      const double *end = steps->states + (size_t)(k + i + 1) * n;
      weigh_stages(&sweep, all(steps->length[k + i]));
      if (lengths && s->dimension == 2) restored_all_2(s, lengths, end, restored);
      else if (lengths) restored_all_3(s, lengths, end, restored);
      for (int first = 0; first < columns; first += WIDTH)
        step_block(&sweep, lengths ? restored : 0, k + i, i, changes, first,
                   blocks + (size_t)n * (first / WIDTH), sweep.rest);
    }
  }
  for (int first = 0; first < columns; first += WIDTH)
    unpack(blocks + (size_t)n * (first / WIDTH), columns, n, first, X);
}

/* ---- backward ---- */

static Shares shares_of(const Changes *c, size_t step, int stage) {
  static const double one = 1;
  Shares shares = {&one, 0, 0};
  if (!c->profile) return shares;
  shares.end = c->profile->values;
  if (!c->profile->share) return shares;
  shares.share = share_at(c->profile, step, stage);
  while (shares.end > 0 && shares.share[shares.end - 1] == 0) --shares.end;
  while (shares.first < shares.end && shares.share[shares.first] == 0) ++shares.first;
  return shares;
}

/* Adds so many vectors, each times a weight, to another: all are whole registers of numbers. */
static void add_vectors(int count, const double *weight, const double *const *vector, size_t size,
                        double *to) {
  for (size_t k = 0; k < size; k += WIDTH) {
    Number sum = *numbers(to + k);
    for (int m = 0; m < count; ++m) sum += weight[m] * *numbers(vector[m] + k);
    *(Number *)(to + k) = sum;
  }
}

/* The cost by the state after what switches at the end of a step becomes that before it, (2, padded). */
static void pass_switches_back(const Sweep *sweep, int k, const Changes *costs, double *mu) {
  const Scene *s = sweep->scene;
  const Switches *switches = sweep->switches;
  const int first = switch_from(sweep, k);
  const size_t half = s->free, n = 2 * half, apart = padded(s) - half;  /* of rates in mu */
  const Shares shares = shares_of(costs, k, sweep->method->stages - 1); /* at the end */
  for (int e = switch_from(sweep, k + 1) - 1; e >= first; --e) {
    const double *by_state = switches->by_state + n * e;
    const double *by_input = switches->by_input + (size_t)s->strings * e;
    const double *jump = switches->jump + n * e;
    double weight = 0;
    for (size_t i = 0; i < n; ++i) weight += jump[i] * mu[i < half ? i : i + apart];
    weight /= switches->rate[e];
    for (size_t i = 0; i < n; ++i) mu[i < half ? i : i + apart] += weight * by_state[i];
    for (int i = 0; i < s->strings; ++i) add_input_cost(costs, i, &shares, weight * by_input[i]);
  }
}

/* The cost by the state after a step becomes that by the state before it, (2, padded). */
static void step_cost(const Sweep *sweep, int k, int in_lanes, const Changes *costs, double *mu,
                      double *memory) {
  const Scene *s = sweep->scene;
  const Tableau *method = sweep->method;
  const int stages = method->stages;
  const size_t size = padded(s), half = s->free;
  const double h = sweep->steps->length[k], *twice = sweep->twice;
  double *of_q = memory, *of_v = of_q + stages * size, *of_a = of_v + stages * size;
  double *weight = of_a + size;
  const double **vector = (const double **)(weight + 3 * stages + 2);
  Shares shares = {0, 0, 0};
  Cost by;
  double **arrays[] = {&by.p, &by.v, &by.f, &by.a};
  int count;
  memory = (double *)(vector + 3 * stages + 2);
  for (int i = 0; i < 4; ++i, memory += s->entries) *arrays[i] = memory;
  by.tension = memory;
  by.unknowns = memory + s->strings;
  for (int i = stages - 1; i >= 0; --i) {
    const double *x = point_of(sweep, in_lanes, i);
    if (i == stages - 1 || (costs->profile && costs->profile->rows > 1)) shares = shares_of(costs, k, i);
    count = 0;
    weight[count] = h * h * twice[stages * stages + i], vector[count++] = mu;
    weight[count] = h * method->b[i], vector[count++] = mu + size;
    for (int j = i + 1; j < stages; ++j) {
      const double once = h * method->a[j * stages + i], both = h * h * twice[j * stages + i];
      if (both != 0) weight[count] = both, vector[count++] = of_q + j * size;
      if (once != 0) weight[count] = once, vector[count++] = of_v + j * size;
    }
    memset(of_a, 0, size * sizeof *of_a);
    add_vectors(count, weight, vector, size, of_a);
    spread_free(s, of_a, by.a);
    if (s->dimension == 2) backward_2(s, &sweep->at, x, costs, &shares, &by);
    else backward_3(s, &sweep->at, x, costs, &shares, &by);
    for (size_t m = 0; m < half; ++m) {
      const int row = s->free_row ? s->free_row[m] : (int)m;
      of_q[i * size + m] = by.p[row];
      of_v[i * size + m] = by.v[row];
    }
    for (size_t m = half; m < size; ++m) of_q[i * size + m] = of_v[i * size + m] = 0;
  }
  count = 0;
  weight[count] = h, vector[count++] = mu;
  for (int i = 0; i < stages; ++i) {
    weight[count] = 1, vector[count++] = of_v + i * size;
    weight[count] = h * method->c[i], vector[count++] = of_q + i * size;
  }
  add_vectors(count, weight, vector, size, mu + size);
  for (int i = 0; i < stages; ++i) weight[i] = 1, vector[i] = of_q + i * size;
  add_vectors(stages, weight, vector, size, mu);
}

void LANES_NAME(costs)(const Scene *s, const Drive *drive, const Lengths *lengths, const Tableau *method,
                       const Steps *steps, const Switches *switches, const Changes *costs, double *mu,
                       double *work) {
  const size_t half = s->free, size = padded(s);
  Sweep sweep;
  double *of_state;
  begin_sweep(&sweep, s, drive, method, steps, switches, work);
  of_state = (double *)sweep.rest;
  memset(of_state, 0, 2 * size * sizeof *of_state);
  memcpy(of_state, mu, half * sizeof *mu);
  memcpy(of_state + size, mu + half, half * sizeof *mu);
  for (int k = (steps->count - 1) / WIDTH * WIDTH; k >= 0; k -= WIDTH) {
    const int some = steps->count - k < WIDTH ? steps->count - k : WIDTH;
    reach_stages(&sweep, k, some);
    for (int i = some - 1; i >= 0; --i) {
      const double *end = steps->states + (size_t)(k + i + 1) * 2 * half;
      pass_switches_back(&sweep, k + i, costs, of_state);
      if (lengths && s->dimension == 2) restored_backward_2(s, lengths, end, of_state, size);
      else if (lengths) restored_backward_3(s, lengths, end, of_state, size);
      step_cost(&sweep, k + i, i, costs, of_state, of_state + 2 * size);
    }
  }
  memcpy(mu, of_state, half * sizeof *mu);
  memcpy(mu + half, of_state + size, half * sizeof *mu);
}

/* ---- accelerations ---- */

void LANES_NAME(accelerations)(const Scene *s, const Drive *drive, const Steps *steps, double *accelerations,
                               double *work) {
  static const double nothing = 0;
  const Tableau here = {1, &nothing, &nothing, &nothing};
  Sweep sweep;
  begin_sweep(&sweep, s, drive, &here, steps, 0, work);
  for (int k = 0; k < steps->count; k += WIDTH) {
    const int some = steps->count - k < WIDTH ? steps->count - k : WIDTH;
    reach_stages(&sweep, k, some);
    for (int i = 0; i < some; ++i) take_row(sweep.accelerations, i, s->free, accelerations, k + i);
  }
}
