/* Motions in reduced coordinates: included after variations_lanes.h, whose derivatives of members they have.

   States are in lanes as values are found, and displacements of nodes are carried from stage to stage, not
   coordinates: what keeps them within the motions of the coordinates is of a small rank. */
#include "reduced.h"

enum { RK4_STAGES = 4 };

/* Derivatives of a string's force density, then of its tension: by length, rate and what is held. */
enum { STRING_SLOPES = 6 };

typedef struct {
  Batch batch; /* of the states in the lanes */
  const Reduced *plant;
  Layout at;
  size_t bars, size; /* of a point: where its bars are, and how many numbers it has */
  double *points;    /* (stages, WIDTH, size) */
  Point now;         /* of the states in the lanes, and of changes in a block */
  Number *strings, *taut, *gap, *gap_rate, *x, *inner, *state, *input;
  /* Displacements and their rates, at a stage and of it, and accelerations. */
  Number *motion, *stage, *total;
  int some, is_kept; /* states in the lanes; whether their points are kept */
  int in_lanes;      /* the state whose changes these are */
  const Number *string_changes;
  const Changes *changes;
} Reduction;

#define D 2
#include "reduced_body.h"
#undef D
#define D 3
#include "reduced_body.h"
#undef D

/* Adds the product of a matrix with a vector, times a sign. */
static void add_product(const double *matrix, int rows, int columns, const Number *x, double sign,
                        Number *y) {
  int i = 0;
  for (; i + 4 <= rows; i += 4) {
    const double *a = matrix + (size_t)columns * i, *b = a + columns, *c = b + columns, *d = c + columns;
    Number of_a = all(0), of_b = all(0), of_c = all(0), of_d = all(0);
    for (int k = 0; k < columns; ++k) {
      const Number value = x[k];
      of_a += a[k] * value;
      of_b += b[k] * value;
      of_c += c[k] * value;
      of_d += d[k] * value;
    }
    y[i] += sign * of_a;
    y[i + 1] += sign * of_b;
    y[i + 2] += sign * of_c;
    y[i + 3] += sign * of_d;
  }
  for (; i < rows; ++i) {
    Number sum = all(0);
    for (int k = 0; k < columns; ++k) sum += matrix[(size_t)columns * i + k] * x[k];
    y[i] += sign * sum;
  }
}

/* Accelerations of what the basis displaces from those of all entries. */
static void within(const Reduction *r, const Number *a, Number *to) {
  const Reduced *plant = r->plant;
  const Scene *s = plant->scene;
  memset(to, 0, s->entries * sizeof *to);
  memset(r->inner, 0, plant->inner * sizeof *to);
  add_product(plant->right, plant->inner, s->entries, a, 1, r->inner);
  if (plant->is_complement)
    for (int i = 0; i < s->free; ++i) {
      const int row = s->free_row ? s->free_row[i] : i;
      to[row] = a[row];
    }
  add_product(plant->left, s->entries, plant->inner, r->inner, plant->is_complement ? -1 : 1, to);
}

/* Accelerations of all entries at displacements, with the derivatives of members at a stage. */
static void values_at(Reduction *r, int stage, const Number *moved, const Number *rates) {
  const Reduced *plant = r->plant;
  const Scene *s = &r->batch.scene;
  const Point *now = &r->now;
  const Input input = {.strings = r->strings};
  const Work w = parts_of(s, r->batch.span.work);
  const int is_plane = s->dimension == 2, chosen = plant->taut ? s->slacking : 0;
  if (is_plane) kept_2(plant, moved, rates, now->p, now->v, r->x + r->bars);
  else kept_3(plant, moved, rates, now->p, now->v, r->x + r->bars);
  if (is_plane && chosen < s->switches) gaps_2(s, now->p, now->v, r->strings, 0, r->gap, r->gap_rate, &w);
  else if (chosen < s->switches) gaps_3(s, now->p, now->v, r->strings, 0, r->gap, r->gap_rate, &w);
  for (int i = chosen; i < s->switches; ++i) r->taut[i] = truth(r->gap[i] > 0);
  if (is_plane) differentiated_2(s, &r->at, &input, r->taut, now, r->x);
  else differentiated_3(s, &r->at, &input, r->taut, now, r->x);
  if (r->is_kept) from_lanes(r->x, r->size, r->some, r->points + WIDTH * r->size * stage, r->size);
}

/* Changes of these accelerations. */
static void changes_at(Reduction *r, int stage, const Number *moved, const Number *rates) {
  const Scene *s = r->plant->scene;
  const double *x = r->points + (WIDTH * (size_t)stage + r->in_lanes) * r->size;
  const Given given = {.change = r->string_changes};
  memcpy(r->now.p, moved, s->entries * sizeof *moved);
  memcpy(r->now.v, rates, s->entries * sizeof *rates);
  if (s->dimension == 2) {
    kept_forward_2(r->plant, x + r->bars, r->now.p, r->now.v);
    rates_of_bars_2(s, &r->now);
    forward_2(s, &r->at, x, r->changes, 0, &given, &r->now);
  } else {
    kept_forward_3(r->plant, x + r->bars, r->now.p, r->now.v);
    rates_of_bars_3(s, &r->now);
    forward_3(s, &r->at, x, r->changes, 0, &given, &r->now);
  }
}

/* A step of RK4, of displacements and their rates or of changes of both. */
INLINE void rk4_step(Reduction *r, double h, Number *motion,
                     void at(Reduction *, int, const Number *, const Number *)) {
  static const double weights[] = {1, 2, 2, 1}, ahead[] = {0.5, 0.5, 1};
  const size_t m = r->plant->scene->entries;
  Number *accelerations = r->stage + 2 * m;
  memcpy(r->stage, motion, 2 * m * sizeof *motion);
  memcpy(r->total, motion, 2 * m * sizeof *motion);
  for (int i = 0; i < RK4_STAGES; ++i) {
    const double weight = h / 6 * weights[i];
    at(r, i, r->stage, r->stage + m);
    within(r, r->now.a, accelerations);
    for (size_t k = 0; k < m; ++k) {
      r->total[k] += weight * r->stage[m + k];
      r->total[m + k] += weight * accelerations[k];
    }
    if (i + 1 == RK4_STAGES) break;
    for (size_t k = 0; k < m; ++k) {
      r->stage[k] = motion[k] + h * ahead[i] * r->stage[m + k];
      r->stage[m + k] = motion[m + k] + h * ahead[i] * accelerations[k];
    }
  }
  memcpy(motion, r->total, 2 * m * sizeof *motion);
}

static int blocks_of(const Reduced *plant) {
  return (2 * plant->coordinates + plant->inputs + WIDTH - 1) / WIDTH;
}

/* Changes of displacements by the columns of a block: of coordinates, then of their rates. */
static void start_motion(const Reduced *plant, int block, Number *motion) {
  const int r = plant->coordinates, m = plant->scene->entries;
  memset(motion, 0, 2 * m * sizeof *motion);
  for (int j = 0, column = WIDTH * block; j < WIDTH && column < 2 * r; ++j, ++column) {
    Number *half = motion + (column < r ? 0 : m);
    for (int i = 0; i < m; ++i) put(plant->basis[(size_t)r * i + column % r], half + i, j);
  }
}

/* Changes of what strings are held at by the columns of inputs, after these. */
static void start_strings(const Reduced *plant, int block, Number *strings) {
  const int count = plant->scene->strings;
  memset(strings, 0, count * sizeof *strings);
  for (int j = 0; j < WIDTH; ++j) {
    const int input = WIDTH * block + j - 2 * plant->coordinates;
    if (input < 0 || input >= plant->inputs) continue;
    if (!plant->spread) put(1, strings + input, j);
    for (int i = 0; i < count && plant->spread; ++i)
      put(plant->spread[(size_t)plant->inputs * i + input], strings + i, j);
  }
}

/* Writes the columns of a block, of so many numbers each. */
static void end_block(const Reduced *plant, int block, size_t count, const Number *values, double *by_state,
                      double *by_input) {
  const int s = 2 * plant->coordinates;
  for (int j = 0; j < WIDTH; ++j) {
    const int column = WIDTH * block + j;
    double *to = by_state + count * column;
    if (column >= s + plant->inputs) return;
    if (column >= s) to = by_input + count * (column - s);
    for (size_t i = 0; i < count; ++i) to[i] = lane(values + i, j);
  }
}

/* Coordinates of displacements, and their rates. */
static void coordinates_of(const Reduced *plant, int halves, const Number *motion, Number *to) {
  const int r = plant->coordinates, m = plant->scene->entries;
  memset(to, 0, (size_t)halves * r * sizeof *to);
  for (int half = 0; half < halves; ++half)
    add_product(plant->project, r, m, motion + m * half, 1, to + r * half);
}

/* Memory of the derivatives of members at a point: of its motion, or of strings alone. */
static size_t members_size(const Scene *s, const Layout *at) {
  const size_t strings = 2 * (size_t)s->dimension * s->segments + STRING_SLOPES * (size_t)s->strings;
  return at->size > strings ? at->size : strings;
}

static size_t kept_size(const Reduced *plant, const Layout *at) {
  const size_t bars = 2 * (size_t)plant->scene->dimension * plant->bars;
  return (members_size(plant->scene, at) + bars + WIDTH - 1) / WIDTH * WIDTH;
}

static Drive held(const Scene *s) {
  const Drive drive = {.count = s->strings};
  return drive;
}

size_t LANES_NAME(reduced_size)(const Reduced *plant, int32_t rows) {
  const Scene *s = plant->scene;
  const Layout at = layout_of(s);
  const Runs own = {.inputs = s->place};
  const Drive drive = held(s);
  const size_t m = s->entries, size = kept_size(plant, &at);
  const size_t blocks = 2 * m * WIDTH * (size_t)blocks_of(plant);
  const size_t of_rows = 2 * (size_t)rows + 2 * (size_t)s->strings;
  return WIDTH * (1 + shared_size(s, &drive, &own) + 2 * point_size(s) + 2 * (size_t)s->strings +
                  3 * (size_t)s->switches + size + plant->inner + 9 * m + 4 * (size_t)plant->coordinates +
                  plant->inputs + RK4_STAGES * size + (blocks > of_rows ? blocks : of_rows));
}

/* Lays out the memory of values and of changes; returns what is left. */
static Number *begin_reduction(Reduction *r, const Reduced *plant, double *work, Point *of_values,
                               Point *of_changes) {
  const Scene *s = plant->scene;
  const int m = s->entries;
  const Runs own = {.inputs = s->place};
  const Drive drive = held(s);
  Number *rest = share(&r->batch, s, &drive, 0, &own, aligned(work));
  r->plant = plant;
  r->at = layout_of(s);
  r->bars = members_size(s, &r->at);
  r->size = kept_size(plant, &r->at);
  *of_values = point_in(s, &rest);
  *of_changes = point_in(s, &rest);
  r->strings = taken(&rest, s->strings);
  r->taut = taken(&rest, s->switches);
  r->gap = taken(&rest, s->switches);
  r->gap_rate = taken(&rest, s->switches);
  r->x = taken(&rest, r->size);
  r->inner = taken(&rest, plant->inner);
  r->motion = taken(&rest, 2 * m);
  r->stage = taken(&rest, 3 * m);
  r->total = taken(&rest, 2 * m);
  r->state = taken(&rest, 2 * plant->coordinates);
  r->input = taken(&rest, plant->inputs);
  r->points = (double *)taken(&rest, RK4_STAGES * r->size);
  memset(of_values->a, 0, m * sizeof(Number));
  memset(of_changes->a, 0, m * sizeof(Number));
  memset(r->x, 0, r->size * sizeof(Number));
  for (int i = 0; i < s->slacking && plant->taut; ++i) r->taut[i] = all(plant->taut[i]);
  return rest;
}

/* Puts states and inputs into the lanes: displacements, and what strings are held at. */
static void enter(Reduction *reduction, int first, int count, const double *states, const double *inputs) {
  const Reduced *plant = reduction->plant;
  const Scene *s = plant->scene;
  const int r = plant->coordinates, m = s->entries;
  reduction->some = count - first < WIDTH ? count - first : WIDTH;
  for (int i = 0; i < WIDTH; ++i) {
    const int k = first + (i < reduction->some ? i : reduction->some - 1);
    put_row(states, k, 2 * r, reduction->state, i);
    put_row(inputs, k, plant->inputs, reduction->input, i);
  }
  for (int i = 0; i < s->strings; ++i)
    reduction->strings[i] = plant->spread ? all(plant->offset[i]) : reduction->input[i];
  if (plant->spread)
    add_product(plant->spread, s->strings, plant->inputs, reduction->input, 1, reduction->strings);
  memset(reduction->motion, 0, 2 * m * sizeof(Number));
  for (int half = 0; half < 2; ++half)
    add_product(plant->basis, m, r, reduction->state + r * half, 1, reduction->motion + m * half);
}

void LANES_NAME(reduced)(const Reduced *plant, int32_t count, int32_t steps, double length,
                         const double *states, const double *inputs, double *ends, double *by_state,
                         double *by_input, double *work) {
  const Scene *s = plant->scene;
  const int r = plant->coordinates, m = s->entries, blocks = by_state ? blocks_of(plant) : 0;
  const int halves = steps ? 2 : 1;
  const size_t numbers_of_end = (size_t)halves * r;
  const Changes changes = {.columns = WIDTH};
  Reduction reduction = {.is_kept = blocks > 0, .changes = &changes};
  Point of_values, of_changes;
  Number *rest = begin_reduction(&reduction, plant, work, &of_values, &of_changes);
  Number *column = taken(&rest, 2 * r), *strings = taken(&rest, s->strings);
  Number *start = taken(&rest, 2 * m);
  Number *changed = rest; /* (blocks, states in lanes, 2 entries) */
  for (int first = 0; first < count; first += WIDTH) {
    enter(&reduction, first, count, states, inputs);
    for (int step = 0; step < (steps ? steps : 1); ++step) {
      reduction.now = of_values;
      if (steps) rk4_step(&reduction, length, reduction.motion, values_at);
      else values_at(&reduction, 0, reduction.motion, reduction.motion + m);
      reduction.now = of_changes;
      for (int block = 0; block < blocks; ++block) {
        const int has_inputs = WIDTH * (block + 1) > 2 * r;
        if (!step) start_motion(plant, block, start);
        if (has_inputs) start_strings(plant, block, strings);
        reduction.string_changes = has_inputs ? strings : 0;
        for (int i = 0; i < reduction.some; ++i) {
          Number *motion = changed + 2 * m * ((size_t)WIDTH * block + i);
          const size_t k = first + i;
          reduction.in_lanes = i;
          if (!step) memcpy(motion, start, 2 * m * sizeof *start);
          if (steps) rk4_step(&reduction, length, motion, changes_at);
          else changes_at(&reduction, 0, motion, motion + m);
          if (step + 1 < steps) continue;
          coordinates_of(plant, halves, steps ? motion : of_changes.a, column);
          end_block(plant, block, numbers_of_end, column, by_state + numbers_of_end * k * 2 * r,
                    by_input + numbers_of_end * k * plant->inputs);
        }
      }
    }
    coordinates_of(plant, halves, steps ? reduction.motion : of_values.a, column);
    for (int i = 0; i < reduction.some; ++i) take_row(column, i, halves * r, ends, first + i);
  }
}

/* Derivatives of rows of strings by inputs: of each, or of those that each spreads to. */
static void rows_by_input(const Reduced *plant, const Rows *rows, const double *x, double *by_input) {
  const Scene *s = plant->scene;
  const double *by = x + 2 * s->dimension * s->segments;
  const int at[] = {rows->density, rows->tension};
  for (int i = 0; i < s->strings; ++i, by += STRING_SLOPES)
    for (int k = 0; k < 2; ++k) {
      if (at[k] < 0) continue;
      if (!plant->spread) by_input[(size_t)rows->count * i + at[k] + i] = by[3 * k + 2];
      for (int j = 0; j < plant->inputs && plant->spread; ++j)
        by_input[(size_t)rows->count * j + at[k] + i] =
            by[3 * k + 2] * plant->spread[(size_t)plant->inputs * i + j];
    }
}

/* Rows at the states of starts or ends of samples, by_motion: their derivatives by these. */
static void rows_at(Reduction *reduction, Point of_values, Point of_changes, const Rows *rows, int is_end,
                    int first, double *values, double *by_motion, double *by_input, Number *memory) {
  const Reduced *plant = reduction->plant;
  const Scene *s = plant->scene;
  const int r = plant->coordinates, m = s->entries, p = rows->count, is_plane = s->dimension == 2;
  const int has_strings = is_end == rows->at_end, has_nodes = is_end && rows->node_rows;
  const int from = has_strings ? 0 : rows->nodes, to = has_nodes ? p : rows->nodes;
  Number *by_place = memory, *by_rate = memory + p, *of_strings = by_rate + p;
  reduction->now = of_values;
  if (is_plane)
    kept_2(plant, reduction->motion, reduction->motion + m, of_values.p, of_values.v,
           reduction->x + reduction->bars);
  else
    kept_3(plant, reduction->motion, reduction->motion + m, of_values.p, of_values.v,
           reduction->x + reduction->bars);
  if (has_strings) {
    if (is_plane) strings_at_2(reduction, of_strings, of_strings + s->strings);
    else strings_at_3(reduction, of_strings, of_strings + s->strings);
    if (rows->density >= 0) memcpy(by_place + rows->density, of_strings, s->strings * sizeof(Number));
    if (rows->tension >= 0)
      memcpy(by_place + rows->tension, of_strings + s->strings, s->strings * sizeof(Number));
  }
  if (has_nodes) {
    memset(by_place + rows->nodes, 0, rows->node_rows * sizeof(Number));
    add_product(rows->on_nodes, rows->node_rows, m, of_values.p, 1, by_place + rows->nodes);
  }
  from_lanes(reduction->x, reduction->size, reduction->some, reduction->points, reduction->size);
  reduction->now = of_changes;
  for (int i = 0; i < reduction->some; ++i) {
    for (int k = from; k < to; ++k) values[(size_t)p * (first + i) + k] = lane(by_place + k, i);
    if (has_strings)
      rows_by_input(plant, rows, reduction->points + reduction->size * i,
                    by_input + (size_t)plant->inputs * p * (first + i));
  }
  for (int column = 0; column < r; column += WIDTH) {
    start_motion(plant, column / WIDTH, reduction->stage);
    for (int i = 0; i < reduction->some; ++i) {
      const double *x = reduction->points + reduction->size * i;
      double *by = by_motion + (size_t)p * (2 * (size_t)r * (first + i) + column);
      memcpy(of_changes.p, reduction->stage, m * sizeof(Number));
      memset(of_changes.v, 0, m * sizeof(Number));
      if (is_plane) kept_forward_2(plant, x + reduction->bars, of_changes.p, of_changes.v);
      else kept_forward_3(plant, x + reduction->bars, of_changes.p, of_changes.v);
      if (has_strings && is_plane) strings_forward_2(reduction, x, rows, by_place, by_rate);
      else if (has_strings) strings_forward_3(reduction, x, rows, by_place, by_rate);
      if (has_nodes) {
        memset(by_place + rows->nodes, 0, rows->node_rows * sizeof(Number));
        add_product(rows->on_nodes, rows->node_rows, m, of_changes.p, 1, by_place + rows->nodes);
      }
      for (int j = 0; j < WIDTH && column + j < r; ++j, by += p) {
        double *by_its_rate = by + (size_t)p * r;
        for (int k = from; k < to; ++k) by[k] = lane(by_place + k, j);
        for (int k = from; k < rows->nodes && s->damped; ++k) by_its_rate[k] = lane(by_rate + k, j);
      }
    }
  }
}

void LANES_NAME(reduced_rows)(const Reduced *plant, const Rows *rows, int32_t count, const double *states,
                              const double *inputs, const double *ends, double *values, double *by_state,
                              double *by_input, double *by_end, double *work) {
  Reduction reduction = {0};
  Point of_values, of_changes;
  Number *rest = begin_reduction(&reduction, plant, work, &of_values, &of_changes);
  const int has_strings = rows->nodes > 0;
  for (int first = 0; first < count; first += WIDTH) {
    if (has_strings && !rows->at_end) {
      enter(&reduction, first, count, states, inputs);
      rows_at(&reduction, of_values, of_changes, rows, 0, first, values, by_state, by_input, rest);
    }
    if ((has_strings && rows->at_end) || rows->node_rows) {
      enter(&reduction, first, count, ends, inputs);
      rows_at(&reduction, of_values, of_changes, rows, 1, first, values, by_end, by_input, rest);
    }
  }
}
