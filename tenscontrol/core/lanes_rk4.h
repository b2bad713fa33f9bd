/* Steps of rk4 of many runs, some side by side.

   Runs are kept in groups, one a lane. All take a step; those whose step is crossed are then gathered
   from all groups, so that few lanes are idle while steps are cut. Where switches are not looked for,
   each group goes to its end by itself, so that it stays in the cache. */

/* A group of runs: where they are, what is left of their steps, how many strings may switch in it, and
   the numbers that they differ in, in this order. */
typedef struct {
  Number *time, *left, *crossed, *x, *x1, *taut, *own;
} Group;

/* Runs of a scene in groups. */
typedef struct {
  Batch batch;
  int states, switches, size, moving; /* numbers of a group, and those that a step changes */
  int is_plain;                       /* whether switches are not looked for */
  Number *groups;
  Rk4 method;
} Many;

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
  use_own(&many->batch, g.own);
  many->method.x = g.x;
  many->method.x1 = g.x1;
  many->method.taut = many->is_plain ? 0 : g.taut;
  many->method.time = *g.time;
  many->method.left = *g.left;
}

/* Lays out all runs in memory; a lane that no run is left for repeats the last one. */
static Number *lay_out(Many *many, const Scene *scene, const Drive *drive, const Lengths *lengths,
                       const Settings *settings, const Runs *runs, const double *start, Number *work) {
  const int n = 2 * scene->free, m = scene->switches;
  Span *span = &many->batch.span;
  many->states = n;
  many->switches = m;
  many->moving = 3 + 2 * n + m;
  many->is_plain = settings->method == PLAIN_RK4_METHOD;
  many->size = many->moving + (int)table_size(scene, drive, runs, 1);
  many->groups = work;
  work += (size_t)(runs->count + WIDTH - 1) / WIDTH * many->size;
  work = share(&many->batch, scene, drive, lengths, runs, work);
  for (int first = 0; first < runs->count; first += WIDTH) {
    const Group g = group_of(many, numbers_of(many, first));
    for (int i = 0; i < WIDTH; ++i) {
      const int run = first + i < runs->count ? first + i : runs->count - 1;
      put_row(start, run, n, g.x, i);
      put_own(&many->batch, run, g.own, i);
    }
  }
  many->method = rk4_of(span, 0, 0, 0, work);
  work += RK4_STATES * n;
  for (int run = 0; run < runs->count && !many->is_plain; run += WIDTH) {
    turn_to(many, numbers_of(many, run));
    gap_at(span, many->method.x, all(0), 0, span->gap, span->rate);
    for (int i = 0; i < m; ++i) many->method.taut[i] = truth(span->gap[i] > 0);
  }
  return work;
}

/* Takes a step in runs from one group to another; returns how many are crossed, and which. */
static int step_groups(Many *many, int begin, int end, double time, double h, Progress *progress,
                       int *crossed) {
  int waiting = 0;
  for (int first = begin; first < end; first += WIDTH) {
    Number *numbers = numbers_of(many, first);
    const Group g = group_of(many, numbers);
    *g.time = all(time);
    *g.left = all(h);
    turn_to(many, numbers);
    *g.crossed = take_whole(&many->method);
    for (int i = 0; i < WIDTH && first + i < end; ++i) {
      progress[first + i].tries += 1;
      if (lane(g.crossed, i) > 0) crossed[waiting++] = first + i;
    }
    if (any(*g.crossed > 0))
      for (int k = 0; k < many->states; ++k) g.x[k] = choice(*g.crossed > 0, g.x[k], g.x1[k]);
    else memcpy(g.x, g.x1, many->states * sizeof(Number));
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
  slope_at(&many->batch.span, method->x, method->time, method->taut, method->k1);
  step = tried_by(method);
  crossings(&many->batch.span, &step); /* marks what may switch in these runs */
  landing = land(method, *g.crossed, cuts);
  memcpy(g.x, g.x1, many->states * sizeof(Number));
  *g.time = method->time += landing.taken;
  *g.left = method->left -= landing.taken;
  going = *g.left > rest;
  *g.crossed = any(going) ? only(going, take_whole(method)) : all(0);
  for (int k = 0; k < many->states; ++k) g.x[k] = choice(going & (*g.crossed == 0), g.x1[k], g.x[k]);
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
static int end_step(const Many *many, const FixedSteps *steps, int64_t done, int first, double *states,
                    Progress *progress) {
  const Group g = group_of(many, numbers_of(many, first));
  const int n = many->states;
  int ended = 0;
  Number zero = all(0);
  for (int k = 0; k < n; ++k) zero += g.x[k] * 0;
  for (int i = 0; i < WIDTH && first + i < many->batch.runs->count; ++i) {
    const int64_t row = (first + i) * (steps->total / steps->inner) + done / steps->inner;
    if (progress[i].stuck) continue;
    progress[i].time = (double)(done + 1) * steps->h;
    progress[i].stuck = lane(&zero, i) != 0;
    ended += progress[i].stuck;
    if (!progress[i].stuck && (done + 1) % steps->inner == 0) take_row(g.x, i, n, states, row);
  }
  return ended;
}

static size_t rk4_runs_size(const Scene *scene, const Drive *drive, const Runs *runs) {
  const size_t n = 2 * (size_t)scene->free, groups = (size_t)(runs->count + WIDTH - 1) / WIDTH + 1;
  const size_t own = 3 + 2 * n + scene->switches + table_size(scene, drive, runs, 1);
  return WIDTH * (groups * own + shared_size(scene, drive, runs) + RK4_STATES * n + 1) + runs->count;
}

static void advance_runs_by_rk4(const Scene *scene, const Drive *drive, const Lengths *lengths,
                                const Settings *settings, const Runs *runs, const double *start,
                                double *states, Progress *progress, const volatile int32_t *stop,
                                double *work) {
  const FixedSteps steps = fixed_steps(settings);
  Many many;
  Number *batch = lay_out(&many, scene, drive, lengths, settings, runs, start, aligned(work));
  int *crossed = (int *)(batch + many.size);
  const int together = many.is_plain ? WIDTH : runs->count;
  for (int begin = 0; begin < runs->count; begin += together) {
    const int end = begin + together < runs->count ? begin + together : runs->count;
    int going = end - begin;
    for (int64_t done = 0; done < steps.total && going && !*stop; ++done) {
      const double time = (double)done * steps.h;
      int waiting = step_groups(&many, begin, end, time, steps.h, progress, crossed);
      for (int cuts = 0; waiting; ++cuts) {
        const int before = waiting;
        waiting = 0;
        for (int i = 0; i < before; i += WIDTH)
          waiting += cut_some(&many, cuts, REST * steps.h, before - i < WIDTH ? before - i : WIDTH,
                              crossed + i, batch, progress, crossed + waiting);
      }
      for (int first = begin; first < end; first += WIDTH)
        going -= end_step(&many, &steps, done, first, states, progress + first);
    }
  }
}
