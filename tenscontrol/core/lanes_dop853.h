/* Steps of dop853 of many runs, some side by side, each with its own time and step.

   Some groups of runs, one a lane, are at work together. All try a step. Where most runs of a group
   may switch in it, their steps are cut at once; others that may are gathered from all groups, so that
   few lanes are idle while steps are cut. The place of a run that is over goes to the next run, or to
   the last of those at work. Runs whose next step is of order 5 are in the first places, so that at most
   one group takes steps of both orders. */

enum { GROUPS_AT_WORK = 4, PLACES = GROUPS_AT_WORK * WIDTH, MOST_LANES = (3 * WIDTH + 3) / 4 };

/* Runs at work. A group has what runs change, then what they are given, then that of its step. */
typedef struct {
  Batch batch;
  const double *start;
  double *states;
  Progress *progress;
  Dop853 method;
  int size, moving, own; /* numbers of a group, those that steps change, and these with a run's own */
  int gathered;          /* those of a step that is tried, too */
  Number *groups;        /* one more for those that are gathered */
  int next, count;       /* the next run to begin, and runs at work */
  int run[PLACES];       /* at each place */
  const int *in_lanes;   /* of the group at hand */
} Pool;

static Number *group_at(const Pool *pool, int place) {
  return pool->groups + (size_t)(place / WIDTH) * pool->size;
}

static int is_short(const Pool *pool, int place) {
  const Adaptive *now = (const Adaptive *)group_at(pool, place);
  return lane(&now->short_left, place % WIDTH) > 0;
}

/* Parts of a group. */
static Dop853 method_at(const Pool *pool, Number *numbers) {
  const int n = pool->batch.span.states, m = pool->batch.span.switches;
  Dop853 method = pool->method;
  method.now = (Adaptive *)numbers;
  method.x = numbers + ADAPTIVE_NUMBERS;
  method.slope = method.x + n;
  method.taut = method.slope + n;
  method.pulls = method.taut;
  method.scale = method.taut + m;
  method.x1 = numbers + pool->own;
  method.K = method.x1 + n;
  return method;
}

/* Goes over to a group. */
static Dop853 *work_on(Pool *pool, Number *numbers, const int *in_lanes) {
  pool->method = method_at(pool, numbers);
  pool->in_lanes = in_lanes;
  use_own(&pool->batch, numbers + pool->moving + pool->batch.span.states);
  return &pool->method;
}

static void emit_to_rows(void *by, Truth due, Number done, const Number *x) {
  const Pool *pool = by;
  for (int i = 0; i < WIDTH; ++i)
    if (is_in(due, i)) {
      const size_t row = (size_t)pool->in_lanes[i] * pool->method.settings->outputs;
      take_row(x, i, pool->batch.span.states, pool->states, row + (size_t)lane(&done, i));
    }
}

/* Puts runs whose next step is of order 5 before the others. */
static void sort_by_order(Pool *pool) {
  int first = 0, last = pool->count - 1;
  for (;;) {
    while (first < last && is_short(pool, first)) ++first;
    while (first < last && !is_short(pool, last)) --last;
    if (first / WIDTH >= last / WIDTH) return;
    swap_lanes(group_at(pool, first), first % WIDTH, group_at(pool, last), last % WIDTH, pool->own);
    const int run = pool->run[first];
    pool->run[first++] = pool->run[last];
    pool->run[last--] = run;
  }
}

/* Begins a run at a place. */
static void begin_run(Pool *pool, int run, int place) {
  const int n = pool->batch.span.states, i = place % WIDTH;
  const Runs *runs = pool->batch.runs;
  Number *numbers = group_at(pool, place);
  const Dop853 method = method_at(pool, numbers);
  const Progress from = {.step = runs->step[run]};
  take_up(&from, runs->longest[run], 0, i, method.now);
  put_row(pool->start, run, n, method.x, i);
  put_row(runs->slope, run, n, method.slope, i);
  put_row(runs->taut, run, pool->batch.span.switches, method.taut, i);
  put_row(runs->scale, run, n, numbers + pool->moving, i);
  put_own(&pool->batch, run, numbers + pool->moving + n, i);
  pool->run[place] = run;
}

/* Those of the lanes that are less than a count. */
static Truth first_lanes(int count) {
  Number is_less = all(0);
  for (int i = 0; i < WIDTH; ++i) put(i < count, &is_less, i);
  return is_less > 0;
}

/* Tries a step in a group; returns in how many places strings may switch in it and are to be gathered,
   and which. */
static int step_group(Pool *pool, int first, int *crossed) {
  Dop853 *method = work_on(pool, group_at(pool, first), pool->run + first);
  const Truth good = first_lanes(pool->count - first) & try_step(method);
  const Truth whole = good & (method->now->crossed == 0), others = good & (whole == 0);
  int count = 0;
  if (any(whole)) end_steps(method, whole);
  for (int i = 0; i < WIDTH; ++i)
    if (is_in(others, i)) crossed[count++] = first + i;
  if (count < MOST_LANES) return count;
  pass_switches(method, others);
  return 0;
}

/* Ends the steps of as many runs as there are lanes at switches. */
static void cut_steps(Pool *pool, const int *places, int some) {
  Number *numbers = pool->groups + (size_t)GROUPS_AT_WORK * pool->size;
  int runs[WIDTH];
  Dop853 *method;
  Tried step;
  for (int i = 0; i < WIDTH; ++i) {
    const int place = places[i < some ? i : some - 1];
    copy_lane(group_at(pool, place), place % WIDTH, numbers, i, pool->gathered);
    runs[i] = pool->run[place];
  }
  method = work_on(pool, numbers, runs);
  memcpy(method->started, method->taut, pool->batch.span.switches * sizeof *method->taut);
  step = tried_step(method);
  crossings(method->span, &step); /* marks what may switch in these runs */
  pass_switches(method, first_lanes(some));
  for (int i = 0; i < some; ++i)
    copy_lane(numbers, i, group_at(pool, places[i]), places[i] % WIDTH, pool->moving);
}

/* Whether a run has come to its end, or goes on no longer. */
static int is_over(const Pool *pool, int place) {
  const Settings *settings = pool->method.settings;
  const Adaptive *now = (const Adaptive *)group_at(pool, place);
  const Number evaluations = evaluations_of(now);
  const int i = place % WIDTH;
  return lane(&now->time, i) >= settings->duration || lane(&now->stuck, i) != 0 ||
         lane(&evaluations, i) >= settings->limit;
}

/* Gives the places of runs that are over to others. */
static void change_runs(Pool *pool) {
  for (int place = 0; place < pool->count;) {
    if (!is_over(pool, place)) {
      ++place;
      continue;
    }
    put_down((Adaptive *)group_at(pool, place), place % WIDTH, pool->progress + pool->run[place]);
    if (pool->next < pool->batch.runs->count) {
      begin_run(pool, pool->next++, place);
    } else {
      const int last = --pool->count;
      copy_lane(group_at(pool, last), last % WIDTH, group_at(pool, place), place % WIDTH, pool->gathered);
      pool->run[place] = pool->run[last];
    }
  }
}

static size_t dop853_group_size(const Scene *scene, const Drive *drive, const Runs *runs) {
  return ADAPTIVE_NUMBERS + (4 + SLOPES) * 2 * (size_t)scene->free + scene->switches +
         table_size(scene, drive, runs, 1);
}

static size_t dop853_runs_size(const Scene *scene, const Drive *drive, const Runs *runs) {
  const size_t pool = (GROUPS_AT_WORK + 1) * dop853_group_size(scene, drive, runs) +
                      shared_size(scene, drive, runs) + DOP853_STATES * 2 * (size_t)scene->free +
                      DOP853_TAUTS * (size_t)scene->switches;
  const size_t begin = begin_runs_size(scene, drive, runs);
  return WIDTH * ((pool > begin ? pool : begin) + 1);
}

static void advance_runs_by_dop853(const Scene *scene, const Drive *drive, const Lengths *lengths,
                                   const Settings *settings, const Runs *runs, const double *start,
                                   double *states, Progress *progress, const volatile int32_t *stop,
                                   double *work) {
  const int n = 2 * scene->free;
  Pool pool;
  Number *rest;
  pool.start = start;
  pool.states = states;
  pool.progress = progress;
  pool.size = (int)dop853_group_size(scene, drive, runs);
  pool.moving = ADAPTIVE_NUMBERS + 2 * n + scene->switches;
  pool.own = pool.moving + n + (int)table_size(scene, drive, runs, 1);
  pool.gathered = pool.size - MORE_STAGES * n;
  pool.groups = aligned(work);
  rest =
      share(&pool.batch, scene, drive, lengths, runs, pool.groups + (size_t)(GROUPS_AT_WORK + 1) * pool.size);
  pool.method = dop853_of(&pool.batch.span, settings, emit_to_rows, &pool, rest);
  pool.count = pool.next = runs->count < PLACES ? runs->count : PLACES;
  /* A lane that no run is left for repeats the last one. */
  for (int place = 0; place < pool.count || place % WIDTH; ++place)
    begin_run(&pool, place < pool.count ? place : pool.count - 1, place);
  while (pool.count && !*stop) {
    int crossed[PLACES], waiting = 0;
    for (int first = 0; first < pool.count; first += WIDTH)
      waiting += step_group(&pool, first, crossed + waiting);
    for (int i = 0; i < waiting; i += WIDTH)
      cut_steps(&pool, crossed + i, waiting - i < WIDTH ? waiting - i : WIDTH);
    change_runs(&pool);
    sort_by_order(&pool);
  }
}
