/* Steps of rk4 of many runs, some side by side: included by files that say by which instructions.

   Runs are kept in groups, one a lane. All take a step; those whose step is crossed are then gathered
   from all groups, so that few lanes are idle while steps are cut. */
#include "carry.c"
#include "equation.c"
#include "events.c"
#include "lengths.c"
#include "rk4.c"
#include "span.c"

/* A group of runs: where they are, what is left of their steps, how many strings may switch in it, and
   the numbers that they differ in, in this order. */
typedef struct {
  Number *time, *left, *crossed, *x, *x1, *taut, *own;
} Group;

/* Runs of a scene, and the scene of a group of them. */
typedef struct {
  const Runs *runs;
  int states, switches, size, moving; /* numbers of a group, and those that a step changes */
  Number *groups;
  Scene scene;
  Drive drive;
  Span span;
  Rk4 method;
} Many;

/* A table of numbers, and its rows where runs differ in it. */
typedef struct {
  const double **of_scene, *rows;
  size_t count;
} Table;

enum { TABLES = 9 };

static void tables_of(Scene *s, Drive *drive, const Runs *runs, Table *tables) {
  const size_t strings = s->law == FORCE_DENSITY_HELD ? 0 : s->strings;
  const size_t factors = s->block_bars ? s->factors + s->unknowns + 1 : 0;
  const Table each[TABLES] = {
      {&s->place, 0, s->entries},
      {&s->load, 0, s->load ? s->entries : 0},
      {&s->stiffness, runs->stiffness, strings},
      {&s->damping, runs->damping, strings},
      {&s->bar_constants, runs->bar_constants, FREE_BAR_3_CONSTANTS * (size_t)s->free_bars},
      {&s->tip_constants, runs->tip_constants, SWINGING_BAR_3_CONSTANTS * (size_t)s->swinging_bars},
      {&s->point_inverse_mass, runs->point_inverse_mass, s->points},
      {&s->block_mass, 0, factors},
      {&drive->coefficients, runs->inputs, (size_t)drive->count * (drive->degree + 1)},
  };
  memcpy(tables, each, sizeof each);
}

/* Numbers of tables that all runs have, or of those that they differ in. */
static size_t table_size(const Scene *scene, const Drive *drive, const Runs *runs, int is_own) {
  Scene s = *scene;
  Drive d = *drive;
  Table tables[TABLES];
  size_t size = 0;
  tables_of(&s, &d, runs, tables);
  for (int k = 0; k < TABLES; ++k)
    if ((tables[k].rows != 0) == is_own) size += tables[k].count;
  return size;
}

static Group group_of(const Many *many, Number *numbers) {
  const int n = many->states;
  Group g;
  g.time = numbers;
  g.left = numbers + 1;
  g.crossed = numbers + 2;
  g.x = numbers + 3;
  g.x1 = g.x + n;
  g.taut = g.x1 + n;
  g.own = g.taut + many->switches;
  return g;
}

static Number *numbers_of(const Many *many, int run) {
  return many->groups + (size_t)(run / WIDTH) * many->size;
}

/* Goes over to a group. */
static void turn_to(Many *many, Number *numbers) {
  const Group g = group_of(many, numbers);
  Table tables[TABLES];
  Number *own = g.own;
  tables_of(&many->scene, &many->drive, many->runs, tables);
  for (int k = 0; k < TABLES; ++k)
    if (tables[k].rows) {
      *tables[k].of_scene = (const double *)own;
      own += tables[k].count;
    }
  many->method.x = g.x;
  many->method.x1 = g.x1;
  many->method.taut = g.taut;
  many->method.time = *g.time;
  many->method.left = *g.left;
}

/* Lays out all runs in memory; a lane that no run is left for repeats the last one. */
static Number *lay_out(Many *many, const Scene *scene, const Drive *drive, const Lengths *lengths,
                       const Runs *runs, const double *start, Number *work) {
  Table tables[TABLES];
  const int n = 2 * scene->free, m = scene->switches;
  many->runs = runs;
  many->states = n;
  many->switches = m;
  many->moving = 3 + 2 * n + m;
  many->size = many->moving + (int)table_size(scene, drive, runs, 1);
  many->scene = *scene;
  many->drive = *drive;
  many->groups = work;
  work += (size_t)(runs->count + WIDTH - 1) / WIDTH * many->size;
  tables_of(&many->scene, &many->drive, runs, tables);
  for (int first = 0; first < runs->count; first += WIDTH) {
    const Group g = group_of(many, numbers_of(many, first));
    for (int i = 0; i < WIDTH; ++i) {
      const size_t run = first + i < runs->count ? first + i : runs->count - 1;
      Number *own = g.own;
      for (int k = 0; k < n; ++k) put(start[run * n + k], g.x + k, i);
      for (int j = 0; j < TABLES; ++j)
        if (tables[j].rows)
          for (size_t k = 0; k < tables[j].count; ++k)
            put(tables[j].rows[run * tables[j].count + k], own++, i);
    }
  }
  for (int k = 0; k < TABLES; ++k) {
    const double *shared = *tables[k].of_scene;
    if (tables[k].rows || !tables[k].count) continue;
    *tables[k].of_scene = (const double *)work;
    for (size_t i = 0; i < tables[k].count; ++i) *work++ = all(shared[i]);
  }
  work = begin(&many->span, &many->scene, &many->drive, lengths, work);
  many->method = rk4_of(&many->span, 0, 0, 0, work);
  work += RK4_STATES * n;
  for (int run = 0; run < runs->count; run += WIDTH) {
    turn_to(many, numbers_of(many, run));
    gap_at(&many->span, many->method.x, all(0), 0, many->span.gap, many->span.rate);
    for (int i = 0; i < m; ++i) many->method.taut[i] = truth(many->span.gap[i] > 0);
  }
  return work;
}

static void copy_lane(const Number *from, int i, Number *to, int j, int count) {
  for (int k = 0; k < count; ++k) put(lane(from + k, i), to + k, j);
}

/* Takes a step in all runs; returns how many are crossed, and which. */
static int step_all(Many *many, double time, double h, Progress *progress, int *crossed) {
  const int count = many->runs->count;
  int waiting = 0;
  for (int first = 0; first < count; first += WIDTH) {
    Number *numbers = numbers_of(many, first);
    const Group g = group_of(many, numbers);
    *g.time = all(time);
    *g.left = all(h);
    turn_to(many, numbers);
    *g.crossed = take_whole(&many->method);
    for (int i = 0; i < WIDTH && first + i < count; ++i) {
      progress[first + i].tries += 1;
      if (lane(g.crossed, i) > 0) crossed[waiting++] = first + i;
    }
    for (int k = 0; k < many->states; ++k) g.x[k] = choice(*g.crossed > 0, g.x[k], g.x1[k]);
  }
  return waiting;
}

/* Cuts the steps of as many runs as there are lanes, and takes what is left of them whole; returns
   how many of them are crossed again, and which. */
static int cut_some(Many *many, int cuts, double rest, int some, const int *runs, Number *numbers,
                    Progress *progress, int *crossed) {
  const Group g = group_of(many, numbers);
  Rk4 *method = &many->method;
  Landing landing;
  Tried step;
  Truth going;
  int waiting = 0;
  for (int i = 0; i < WIDTH; ++i) {
    const int run = runs[i < some ? i : some - 1];
    copy_lane(numbers_of(many, run), run % WIDTH, numbers, i, many->size);
  }
  turn_to(many, numbers);
  slope_at(&many->span, method->x, method->time, method->taut, method->k1);
  step = tried_by(method);
  crossings(&many->span, &step); /* marks what may switch in these runs */
  landing = land(method, *g.crossed, cuts);
  memcpy(g.x, g.x1, many->states * sizeof(Number));
  *g.time = method->time += landing.taken;
  *g.left = method->left -= landing.taken;
  going = *g.left > rest;
  *g.crossed = any(going) ? only(going, take_whole(method)) : all(0);
  for (int k = 0; k < many->states; ++k)
    g.x[k] = choice(going & (*g.crossed == 0), g.x1[k], g.x[k]);
  for (int i = 0; i < some; ++i) {
    const int run = runs[i];
    count(&landing, i, progress + run);
    progress[run].tries += is_in(going, i);
    copy_lane(numbers, i, numbers_of(many, run), run % WIDTH, many->moving);
    if (lane(g.crossed, i) > 0) crossed[waiting++] = run;
  }
  return waiting;
}

/* Enters what the runs of a group have come to; returns how many are not finite and end. */
static int end_step(const Many *many, const FixedSteps *steps, int64_t done, int first,
                    double *states, Progress *progress) {
  const Group g = group_of(many, numbers_of(many, first));
  const int n = many->states;
  int ended = 0;
  Number zero = all(0);
  for (int k = 0; k < n; ++k) zero += g.x[k] * 0;
  for (int i = 0; i < WIDTH && first + i < many->runs->count; ++i) {
    const int64_t row = (first + i) * (steps->total / steps->inner) + done / steps->inner;
    if (progress[i].stuck) continue;
    progress[i].time = (double)(done + 1) * steps->h;
    progress[i].stuck = lane(&zero, i) != 0;
    ended += progress[i].stuck;
    if (!progress[i].stuck && (done + 1) % steps->inner == 0)
      for (int k = 0; k < n; ++k) states[row * n + k] = lane(g.x + k, i);
  }
  return ended;
}

size_t LANES_NAME(size)(const Scene *scene, const Drive *drive, const Runs *runs) {
  const size_t n = 2 * (size_t)scene->free, groups = (size_t)(runs->count + WIDTH - 1) / WIDTH + 1;
  const size_t own = 3 + 2 * n + scene->switches + table_size(scene, drive, runs, 1);
  const size_t shared = table_size(scene, drive, runs, 0) + span_size(scene, drive) + RK4_STATES * n;
  return WIDTH * (groups * own + shared + 1) + runs->count;
}

void LANES_NAME(advance)(const Scene *scene, const Drive *drive, const Lengths *lengths,
                         const Settings *settings, const Runs *runs, const double *start,
                         double *states, Progress *progress, const volatile int32_t *stop,
                         double *work) {
  const FixedSteps steps = fixed_steps(settings);
  const size_t off = (uintptr_t)work / sizeof *work % WIDTH;
  Many many;
  Number *batch = lay_out(&many, scene, drive, settings->projects ? lengths : 0, runs, start,
                          (Number *)(work + (WIDTH - off) % WIDTH));
  int *crossed = (int *)(batch + many.size), going = runs->count;
  for (int64_t done = 0; done < steps.total && going && !*stop; ++done) {
    const double time = (double)done * steps.h;
    int waiting = step_all(&many, time, steps.h, progress, crossed);
    for (int cuts = 0; waiting; ++cuts) {
      const int before = waiting;
      waiting = 0;
      for (int i = 0; i < before; i += WIDTH)
        waiting += cut_some(&many, cuts, REST * steps.h, before - i < WIDTH ? before - i : WIDTH,
                            crossed + i, batch, progress, crossed + waiting);
    }
    for (int first = 0; first < runs->count; first += WIDTH)
      going -= end_step(&many, &steps, done, first, states, progress + first);
  }
}
