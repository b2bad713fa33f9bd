/* Four members in D dimensions: included by members_avx2.c, once for each. */

#define NAME_(name, d) name##_##d
#define NAME2(name, d) NAME_(name, d)
#define N(name) NAME2(name, D)

/* How much earlier rates are read than they begin. */
#define EARLIER (WIDTH - D)

static inline void N(rates_apart)(const double *v, const int32_t *from, const int32_t *to, Number *column) {
  Number rows[WIDTH], read[WIDTH];
  apart(v - EARLIER, from, to, rows);
  columns(rows, read);
  for (int k = 0; k < D; ++k) column[k] = read[EARLIER + k];
}

/* Forces on nodes, one a row, so that one can be stored without another: a load. */
static inline void N(begin_forces)(const double *load, int nodes, Number *forces) {
  if (!load) {
    memset(forces, 0, nodes * sizeof *forces);
    return;
  }
  for (int i = 0; i + 1 < nodes; ++i) forces[i] = row(load + D * i);
  memcpy(forces + nodes - 1, load + D * (nodes - 1), D * sizeof *load);
}

static inline void N(end_forces)(const Number *forces, int nodes, double *f) {
  for (int i = 0; i + 1 < nodes; ++i) *(Number *)(f + D * i) = forces[i]; /* the next follows */
  memcpy(f + D * (nodes - 1), forces + nodes - 1, D * sizeof *f);
}

/* Adds the pull of strings by a law. It is compiled once for each common one: a law that is asked for
   in every group takes an eighth more. */
__attribute__((always_inline)) static inline int N(pull_by)(StringLaw law, const Scene *s, const double *p,
                                                            const double *v, const double *u,
                                                            const double *taut, double *forces) {
  int i = 0;
  for (; i + WIDTH <= s->segments; i += WIDTH) {
    const int32_t *start = s->segment_start + i, *end = s->segment_end + i;
    const int32_t *at = s->segment_row + 2 * i;
    const Number rest = row(u + i);
    Number rows[WIDTH], segment[WIDTH], gamma = rest;
    apart(p, start, end, rows);
    if (law.kind != FORCE_DENSITY_HELD) {
      const Number k = row(s->stiffness + i);
      Number c = all(0), change[D], length, rate = all(0);
      columns(rows, segment);
      N(pulling_length)(segment, rest, &length);
      if (law.is_damped) {
        c = row(s->damping + i);
        N(rates_apart)(v, start, end, change);
        N(length_rate)(segment, change, length, &rate);
      }
      gamma = force_density(law, k, c, length, rate, rest);
      gamma *= taut ? row(taut + i) : truth(string_gap(law, k, c, length, rate, rest) > 0);
    }
    for (int j = 0; j < WIDTH; ++j) {
      const Number pull = rows[j] * all(gamma[j]);
      *(Number *)(forces + at[2 * j]) += pull;
      *(Number *)(forces + at[2 * j + 1]) -= pull;
    }
  }
  return i;
}

int N(pull_by_avx2)(const Scene *s, const double *p, const double *v, const double *u, const double *taut,
                    const double *load, double *f, double *work) {
  const int nodes = s->entries / D;
  const StringLaw law = law_of(s), linear = {LINEAR_STRINGS, 0}, elastic = {ELASTIC_STRINGS, 0};
  int done;
  N(begin_forces)(load, nodes, (Number *)work);
  if (law.kind == LINEAR_STRINGS && !law.is_damped && taut) done = N(pull_by)(linear, s, p, v, u, taut, work);
  else if (law.kind == ELASTIC_STRINGS && !law.is_damped && taut)
    done = N(pull_by)(elastic, s, p, v, u, taut, work);
  else done = N(pull_by)(law, s, p, v, u, taut, work);
  N(end_forces)((const Number *)work, nodes, f);
  return done;
}

int N(gaps_by_avx2)(const Scene *s, const double *p, const double *v, const double *u, double *gap,
                    double *rate) {
  const StringLaw law = law_of(s);
  int i = 0;
  for (; i + WIDTH <= s->segments; i += WIDTH) {
    const int32_t *start = s->segment_start + i, *end = s->segment_end + i;
    const Number rest = row(u + i);
    Number rows[WIDTH], segment[WIDTH], change[D], length, own = all(0);
    apart(p, start, end, rows);
    columns(rows, segment);
    N(pulling_length)(segment, rest, &length);
    if (rate) {
      N(rates_apart)(v, start, end, change);
      N(length_rate)(segment, change, length, &own);
      *(Number *)(rate + i) = own;
    }
    *(Number *)(gap + i) = string_gap(law, row(s->stiffness + i), row(s->damping + i), length, own, rest);
  }
  return i;
}

/* The vectors of nodes, number by number: those that were stored just before by others are had sooner. */
static inline void N(gather)(const double *x, const int32_t *at, Number *column) {
  for (int k = 0; k < D; ++k) column[k] = (Number){x[at[0] + k], x[at[1] + k], x[at[2] + k], x[at[3] + k]};
}

static inline void N(scatter)(const Number *column, const int32_t *at, double *x) {
  const Number even = PICK(column[0], column[1], 0, 4, 2, 6);
  const Number odd = PICK(column[0], column[1], 1, 5, 3, 7);
  *(Pair *)(x + at[0]) = (Pair){even[0], even[1]};
  *(Pair *)(x + at[1]) = (Pair){odd[0], odd[1]};
  *(Pair *)(x + at[2]) = (Pair){even[2], even[3]};
  *(Pair *)(x + at[3]) = (Pair){odd[2], odd[3]};
  if (D == 3)
    for (int j = 0; j < WIDTH; ++j) x[at[j] + 2] = column[D - 1][j];
}

int N(free_bars_by_avx2)(const Scene *s, const double *p, const double *v, const double *f,
                         const double *extension, double *a) {
  int i = 0;
  for (; i + WIDTH <= s->free_bars; i += WIDTH) {
    const int32_t *start = s->bar_start + i, *end = s->bar_end + i;
    Number rows[WIDTH], bar[WIDTH], constants[WIDTH], rate[D], on_start[D], on_end[D], from[D], to[D];
    Number lengthening = all(0);
    for (int j = 0; j < WIDTH; ++j) rows[j] = row(s->bar_constants + FREE_BAR_2_CONSTANTS * (i + j));
    columns(rows, constants);
    apart(p, start, end, rows);
    columns(rows, bar);
    N(rates_apart)(v, start, end, rate);
    if (extension)
      for (int j = 0; j < WIDTH; ++j) put(extension[s->free_bar[i + j]], &lengthening, j);
    N(gather)(f, start, on_start);
    N(gather)(f, end, on_end);
    N(free_bar)(bar, rate, lengthening, on_start, on_end, constants, from, to);
    N(scatter)(from, start, a);
    N(scatter)(to, end, a);
  }
  return i;
}

#undef EARLIER
#undef NAME_
#undef NAME2
#undef N
