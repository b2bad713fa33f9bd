/* The scene of the runs that are in the lanes: tables that all have, and those of each. */

/* Runs of a scene, and the scene, inputs and memory of those in the lanes. */
typedef struct {
  const Runs *runs;
  Scene scene;
  Drive drive;
  Span span;
} Batch;

/* A table of numbers, and its rows where runs differ in it. */
typedef struct {
  const double **of_scene, *rows;
  size_t count;
} Table;

enum { TABLES = 10 };

static void tables_of(Scene *s, Drive *drive, const Runs *runs, Table *tables) {
  const size_t strings = s->law == FORCE_DENSITY_HELD ? 0 : s->strings;
  const size_t factors = s->block_bars ? s->factors + s->unknowns + 1 : 0;
  const Table list[TABLES] = {
      {&s->place, 0, s->entries},
      {&s->load, 0, s->load ? s->entries : 0},
      {&s->stiffness, runs->stiffness, strings},
      {&s->damping, runs->damping, strings},
      {&s->bar_constants, runs->bar_constants, FREE_BAR_3_CONSTANTS * (size_t)s->free_bars},
      {&s->tip_constants, runs->tip_constants, SWINGING_BAR_3_CONSTANTS * (size_t)s->swinging_bars},
      {&s->point_inverse_mass, runs->point_inverse_mass, s->points},
      {&s->ground_numbers, runs->ground_numbers, GROUND_NUMBERS * (size_t)s->grounds},
      {&s->block_mass, 0, factors},
      {&drive->coefficients, runs->inputs, (size_t)drive->count * (drive->degree + 1)},
  };
  memcpy(tables, list, sizeof list);
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

/* Lays out what all runs have, and the memory of a span; returns what is left. */
static Number *share(Batch *batch, const Scene *scene, const Drive *drive, const Lengths *lengths,
                     const Runs *runs, Number *work) {
  Table tables[TABLES];
  batch->runs = runs;
  batch->scene = *scene;
  batch->drive = *drive;
  tables_of(&batch->scene, &batch->drive, runs, tables);
  for (int k = 0; k < TABLES; ++k) {
    const double *shared = *tables[k].of_scene;
    if (tables[k].rows || !tables[k].count) continue;
    *tables[k].of_scene = (const double *)work;
    for (size_t i = 0; i < tables[k].count; ++i) *work++ = all(shared[i]);
  }
  return begin(&batch->span, &batch->scene, &batch->drive, lengths, work);
}

static size_t shared_size(const Scene *scene, const Drive *drive, const Runs *runs) {
  return table_size(scene, drive, runs, 0) + span_size(scene, drive);
}

/* Copies what is a run's own into a lane of what is of several. */
static inline void put_own(Batch *batch, int run, Number *own, int i) {
  Table tables[TABLES];
  tables_of(&batch->scene, &batch->drive, batch->runs, tables);
  for (int j = 0; j < TABLES; ++j)
    if (tables[j].rows)
      for (size_t k = 0; k < tables[j].count; ++k) put(tables[j].rows[run * tables[j].count + k], own++, i);
}

/* Makes the scene that of the runs of which this is their own. */
static inline void use_own(Batch *batch, const Number *own) {
  Table tables[TABLES];
  tables_of(&batch->scene, &batch->drive, batch->runs, tables);
  for (int k = 0; k < TABLES; ++k)
    if (tables[k].rows) {
      *tables[k].of_scene = (const double *)own;
      own += tables[k].count;
    }
}

static void put_row(const double *rows, int run, int count, Number *to, int i) {
  for (int k = 0; k < count; ++k) put(rows[(size_t)run * count + k], to + k, i);
}

static inline void take_row(const Number *from, int i, int count, double *rows, size_t row) {
  for (int k = 0; k < count; ++k) rows[row * count + k] = lane(from + k, i);
}

static inline void copy_lane(const Number *from, int i, Number *to, int j, int count) {
  for (int k = 0; k < count; ++k) put(lane(from + k, i), to + k, j);
}

static inline void swap_lanes(Number *one, int i, Number *other, int j, int count) {
  for (int k = 0; k < count; ++k) {
    const double kept = lane(one + k, i);
    put(lane(other + k, j), one + k, i);
    put(kept, other + k, j);
  }
}

/* Memory of numbers in lanes, on their border. */
static Number *aligned(double *work) {
  const size_t off = (uintptr_t)work / sizeof *work % WIDTH;
  return (Number *)(work + (WIDTH - off) % WIDTH);
}
