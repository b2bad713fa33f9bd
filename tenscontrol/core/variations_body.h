/* Derivatives of the equation of motion in D dimensions: included by variations_lanes.h, once for each. */

#define NAME_(name, d) name##_##d
#define NAME2(name, d) NAME_(name, d)
#define N(name) NAME2(name, D)

static inline Number N(product)(const Number *a, const Number *b) {
  Number sum = a[0] * b[0];
  for (int k = 1; k < D; ++k) sum += a[k] * b[k];
  return sum;
}

/* ---- the derivatives of members: steps are in lanes ---- */

/* Forces of strings, with their derivatives. */
static void N(pulled)(const Scene *s, const Layout *at, const Number *u, const Number *taut, const Point *now,
                      Number *x) {
  const int has_lengths = s->law != FORCE_DENSITY_HELD || s->clustered;
  Number *weight = x + at->weight, *matrix = x + at->matrix;
  memset(now->string_length, 0, s->strings * sizeof(Number));
  memset(now->string_rate, 0, s->strings * sizeof(Number));
  for (int i = 0; i < s->segments; ++i) {
    const int start = s->segment_start[i], end = s->segment_end[i], string = s->segment_string[i];
    Number *along = x + at->along + D * i, S[D], inverse;
    N(difference)(now->p, start, end, S);
    now->length[i] = has_lengths ? root(larger(N(product)(S, S), all(s->shortest * s->shortest))) : all(1);
    inverse = 1 / now->length[i];
    for (int k = 0; k < D; ++k) along[k] = S[k] * inverse;
    now->string_length[string] += now->length[i];
    if (!s->damped) continue;
    {
      Number *turning = x + at->turning + D * i, Sd[D], rate;
      N(difference)(now->v, start, end, Sd);
      rate = N(product)(along, Sd);
      for (int k = 0; k < D; ++k) turning[k] = (Sd[k] - rate * along[k]) * inverse;
      now->string_rate[string] += rate;
    }
  }
  for (int i = 0; i < s->strings; ++i) {
    Number *by = x + at->string + at->of_string * i, gamma = u[i];
    const Number length = now->string_length[i];
    if (s->law == FORCE_DENSITY_HELD) {
      memset(by, 0, at->of_string * sizeof *by);
      by[BY_REST] = all(1);
    } else {
      gamma = string_slopes(s, i, length, now->string_rate[i], u[i], s->slacking ? taut[i] : all(1), by);
    }
    for (int m = 0; m < at->of_string; ++m) by[m] *= length;
    if (s->clustered) by[BY_LENGTH] += gamma;
    now->tension[i] = s->clustered ? gamma * length : gamma;
  }
  for (int i = 0; i < s->segments; ++i) {
    const int start = s->segment_start[i], end = s->segment_end[i];
    const Number *along = x + at->along + D * i, pull = now->tension[s->segment_string[i]];
    weight[i] = s->clustered ? pull / now->length[i] : pull;
    for (int k = 0; k < D; ++k) {
      const Number force = weight[i] * now->length[i] * along[k];
      now->f[start + k] += force;
      now->f[end + k] -= force;
    }
    if (s->clustered) continue;
    for (int j = 0; j < D; ++j)
      for (int k = j; k < D; ++k, ++matrix) {
        *matrix = x[at->string + at->of_string * i + BY_LENGTH] * along[j] * along[k];
        if (j == k) *matrix += pull;
      }
  }
}

/* The force of the ground on a node, with its derivatives by x, v and the numbers of the law. */
static void N(touched)(const Ground *g, const Number *own, const Number *x, const Number *v, Number pressing,
                       Number *force, Number *by) {
  /* Of the press: by depth, rate, stiffness, damping, width; of the force: by press, v, friction, slip. */
  Number depth, rate, press, presses[5] = {all(0), all(0), all(0), all(0), all(0)};
  Number normal[D], forces[D * (D + 3)];
  for (int j = 0; j < D; ++j) normal[j] = all(g->normal[j]);
  N(sinking)(x, v, own[4], normal, &depth, &rate);
  if (g->kind == LINEAR_GROUND) linear_press_slopes(depth, rate, own[0], own[1], pressing, &press, presses);
  else if (g->kind == HERTZ_GROUND)
    hertz_press_slopes(depth, rate, own[0], own[1], pressing, &press, presses);
  else smooth_press_slopes(depth, rate, own[0], own[1], own[5], &press, presses);
  N(ground_force_slopes)(press, v, own[2], own[3], normal, force, forces);
  for (int k = 0; k < D; ++k) {
    Number *of_law = by + D * 2 * D + k;
    for (int j = 0; j < D; ++j) {
      by[D * j + k] = -normal[j] * presses[0] * forces[k];
      by[D * (D + j) + k] = forces[D * (1 + j) + k] - normal[j] * presses[1] * forces[k];
    }
    of_law[0] = presses[2] * forces[k];
    of_law[D] = presses[3] * forces[k];
    of_law[D * 2] = forces[D * (1 + D) + k];
    of_law[D * 3] = forces[D * (2 + D) + k];
    of_law[D * 4] = presses[0] * forces[k];
    of_law[D * 5] = presses[4] * forces[k];
  }
}

static void N(bars_that_share)(const Scene *s, const Layout *at, const Point *now, Number *x) {
  Number *factors = x + at->factors, *y = now->unknowns;
  memcpy(factors, s->block_mass, (s->factors + s->unknowns + 1) * sizeof *factors);
  for (int i = 0; i < s->block_rows; ++i) y[s->block_place[i]] = now->f[s->block_row[i]];
  for (int i = 0; i < s->block_bars; ++i) {
    Number *rate = x + at->block_bar + at->of_block_bar * i, bar[D];
    N(difference)(now->p, s->block_start[i], s->block_end[i], bar);
    N(difference)(now->v, s->block_start[i], s->block_end[i], rate);
    for (int k = 0; k < D; ++k) {
      factors[s->entry_end[D * i + k]] = bar[k];
      factors[s->entry_start[D * i + k]] = -bar[k];
    }
    N(coupled_bar)(rate, all(0), y + s->right_place[i]);
  }
  factorize(s, factors);
  solve(s, factors, y);
  for (int i = 0; i < s->block_rows; ++i) now->a[s->block_row[i]] = y[s->block_place[i]];
  for (int i = 0; i < s->block_bars; ++i) {
    Number *of_bar = x + at->block_bar + at->of_block_bar * i;
    N(difference)(now->a, s->block_start[i], s->block_end[i], of_bar + D);
    of_bar[2 * D] = y[s->right_place[i]];
  }
}

static void N(accelerated)(const Scene *s, const Layout *at, const Point *now, Number *x) {
  const Number *f = now->f;
  Number *a = now->a, rate[D], force[D];
  memset(a, 0, s->entries * sizeof *a);
  for (int i = 0; i < s->free_bars; ++i) {
    const int start = s->bar_start[i], end = s->bar_end[i];
    const Number *constants = numbers(s->bar_constants) + 4 * i;
    Number *bar = x + at->free_bar + at->of_bar * i;
    N(difference)(now->p, start, end, bar);
    N(difference)(now->v, start, end, rate);
    N(difference)(f, start, end, force);
    N(free_bar_force_density_slopes)(bar, rate, force, 12 * constants[2], bar + D, bar + D + 1);
    for (int k = 0; k < D; ++k) {
      const Number mean = constants[0] * (f[start + k] + f[end + k]);
      const Number turning = constants[1] * force[k] + constants[3] * bar[D] * bar[k];
      a[start + k] = mean - turning;
      a[end + k] = mean + turning;
    }
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const int hinge = s->hinge[i], tip = s->tip[i];
    const Number *constants = numbers(s->tip_constants) + 2 * i;
    Number *bar = x + at->swinging_bar + at->of_bar * i;
    N(difference)(now->p, hinge, tip, bar);
    N(difference)(now->v, hinge, tip, rate);
    N(swinging_bar_force_density_slopes)(bar, rate, f + tip, 3 * constants[0], bar + D, bar + D + 1);
    for (int k = 0; k < D; ++k) a[tip + k] = constants[1] * (f[tip + k] + bar[D] * bar[k]);
  }
  for (int i = 0; i < s->points; ++i)
    for (int k = 0; k < D; ++k) a[s->point[i] + k] = f[s->point[i] + k] * numbers(s->point_inverse_mass)[i];
  if (s->block_bars) N(bars_that_share)(s, at, now, x);
}

/* Accelerations at a point whose p and v are there, with the derivatives of members. */
static void N(differentiated)(const Scene *s, const Layout *at, const Input *input, const Number *taut,
                              const Point *now, Number *x) {
  const Number *load = input->load ? input->load : s->load ? numbers(s->load) : 0;
  Number *contact = x + at->contact;
  if (load) memcpy(now->f, load, s->entries * sizeof *load);
  else memset(now->f, 0, s->entries * sizeof *now->f);
  if (s->segments) N(pulled)(s, at, input->strings, taut, now, x);
  for (int i = 0; i < s->grounds; ++i) {
    const Ground *g = s->ground + i;
    const Number *own = numbers(s->ground_numbers) + GROUND_NUMBERS * i;
    for (int j = 0; j < g->count; ++j, contact += at->of_contact) {
      const int node = g->node[j];
      Number force[D];
      contact[0] = g->first_switch < 0 ? all(1) : taut[s->slacking + g->first_switch + j];
      N(touched)(g, own, now->p + node, now->v + node, contact[0], force, contact + 1);
      for (int k = 0; k < D; ++k) now->f[node + k] += force[k];
    }
  }
  N(accelerated)(s, at, now, x);
  memcpy(x + at->acceleration, now->a, s->entries * sizeof *now->a);
}

/* ---- forward: columns of changes are in lanes ---- */

/* Changes of the vectors of free bars, or of their rates, of which these are the rows of both ends. */
static void N(bar_differences)(const Scene *s, const int32_t *row, const Number *of, Number *to) {
  for (int i = 0; i < s->free_bars; ++i, row += 2, to += D) N(difference)(of, row[0], row[1], to);
}

static void N(rates_of_bars)(const Scene *s, const Point *change) {
  for (int i = 0; i < s->free_bars; ++i)
    N(difference)(change->v, s->bar_start[i], s->bar_end[i], change->bar_rate + D * i);
}

/* Multiplies a vector of numbers with one of changes. */
INLINE Number N(times)(const double *by, const Number *change) {
  Number sum = by[0] * change[0];
  for (int k = 1; k < D; ++k) sum += by[k] * change[k];
  return sum;
}

/* What a string's own numbers change of its tension, or of its force density times its length. */
INLINE Number N(own_tension)(const Scene *s, const double *by, const Changes *c, int string, int first) {
  const size_t place = (size_t)c->columns * string + first;
  Number sum = all(0);
  if (c->stiffness) sum += by[BY_STIFFNESS] * *numbers(c->stiffness + place);
  if (c->damping && s->damped) sum += by[BY_DAMPING] * *numbers(c->damping + place);
  return sum;
}

/* The change of a segment's length, of its vector S, and of its rate. */
INLINE Number N(stretch_forward)(const double *along, const double *turning, const Number *p0,
                                 const Number *p1, const Number *v0, const Number *v1, Number *S,
                                 Number *rate) {
  for (int k = 0; k < D; ++k) S[k] = p1[k] - p0[k];
  if (turning) {
    Number Sd[D];
    for (int k = 0; k < D; ++k) Sd[k] = v1[k] - v0[k];
    *rate = N(times)(turning, S) + N(times)(along, Sd);
  }
  return N(times)(along, S);
}

INLINE void N(pull_forward)(const double *along, double weight, const Number *S, Number axial, Number *f0,
                            Number *f1) {
  for (int k = 0; k < D; ++k) {
    const Number pull = along[k] * axial + weight * S[k];
    f0[k] += pull;
    f1[k] -= pull;
  }
}

/* The change of a pull by that of its vector, which a symmetric matrix makes: rows from the diagonal on. */
INLINE void N(pull_of)(const double *matrix, const Number *S, Number *pull) {
  for (int k = 0; k < D; ++k) pull[k] = matrix[k] * S[0];
  for (int k = 1; k < D; ++k) pull[0] += matrix[k] * S[k];
  matrix += D;
  for (int j = 1; j < D; ++j) {
    pull[j] += *matrix++ * S[j];
    for (int k = j + 1; k < D; ++k, ++matrix) {
      pull[j] += *matrix * S[k];
      pull[k] += *matrix * S[j];
    }
  }
}

/* Strings of one segment each. Those that follow one another at a node share what is there, which stays
   in registers: numbers that are stored and read again wait for each other. */
INLINE void N(pulled_forward)(const Scene *s, const Layout *at, const double *x, const Point *change,
                              const int damped) {
  const int count = s->segments, slopes = damped ? 5 : 3;
  const int32_t *start = s->segment_start, *end = s->segment_end;
  const double *matrix = x + at->matrix;
  const double *along = x + at->along, *turning = damped ? x + at->turning : 0, *by = x + at->string;
  const Number *p = change->p, *v = change->v;
  Number *f = change->f, S[D], pull[D];
  for (int i = 0; i < count;) {
    const int from = start[i];
    Number place[D], moving[D], force[D];
    for (int k = 0; k < D; ++k) {
      place[k] = p[from + k];
      moving[k] = damped ? v[from + k] : all(0);
      force[k] = f[from + k];
    }
    do {
      const int to = end[i];
      for (int k = 0; k < D; ++k) S[k] = place[k] - p[to + k];
      N(pull_of)(matrix, S, pull);
      matrix += D * (D + 1) / 2;
      if (damped) {
        Number rate = all(0);
        N(stretch_forward)(along, turning, p + to, place, v + to, moving, S, &rate);
        for (int k = 0; k < D; ++k) pull[k] += along[k] * (by[BY_RATE] * rate);
        along += D;
        turning += D;
        by += slopes;
      }
      for (int k = 0; k < D; ++k) {
        force[k] -= pull[k];
        f[to + k] += pull[k];
      }
    } while (++i < count && start[i] == from);
    for (int k = 0; k < D; ++k) f[from + k] = force[k];
  }
}

/* The pull of a string of one segment by a change of its tension. */
INLINE void N(tension_forward)(const Scene *s, const double *along, int i, Number tension, Number *f) {
  Number *f0 = f + s->segment_start[i], *f1 = f + s->segment_end[i];
  for (int k = 0; k < D; ++k) {
    const Number pull = along[D * i + k] * tension;
    f0[k] += pull;
    f1[k] -= pull;
  }
}

/* Pulls of strings of one segment each by what these are given, and by their own numbers. */
static void N(given_forward)(const Scene *s, const Layout *at, const double *x, const Changes *c, int first,
                             const Given *given, Number *f) {
  const double *along = x + at->along, *by = x + at->string;
  const int count = given->string ? given->count : s->strings;
  for (int m = 0; m < count && given->change; ++m) {
    const int i = given->string ? given->string[m] : m;
    N(tension_forward)(s, along, i, by[at->of_string * i + BY_REST] * given->change[i], f);
  }
  for (int i = 0; i < s->strings && (c->stiffness || c->damping); ++i)
    N(tension_forward)(s, along, i, N(own_tension)(s, by + at->of_string * i, c, i, first), f);
}

/* Strings that run over several segments. */
static void N(clusters_forward)(const Scene *s, const Layout *at, const double *x, const Changes *c,
                                int first, const Given *given, const Point *change) {
  const double *along = x + at->along, *turning = s->damped ? x + at->turning : 0;
  const Number *p = change->p, *v = change->v;
  Number S[D], rate = all(0);
  memset(change->string_length, 0, s->strings * sizeof(Number));
  memset(change->string_rate, 0, s->strings * sizeof(Number));
  for (int i = 0; i < s->segments; ++i) {
    const int from = s->segment_start[i], to = s->segment_end[i], string = s->segment_string[i];
    change->length[i] = N(stretch_forward)(along + D * i, turning ? turning + D * i : 0, p + from, p + to,
                                           v + from, v + to, S, &rate);
    change->string_length[string] += change->length[i];
    change->string_rate[string] += rate;
  }
  for (int i = 0; i < s->strings; ++i) {
    const double *by = x + at->string + at->of_string * i;
    Number tension = by[BY_LENGTH] * change->string_length[i];
    if (s->damped) tension += by[BY_RATE] * change->string_rate[i];
    if (given->change) tension += by[BY_REST] * given->change[i];
    change->tension[i] = tension + N(own_tension)(s, by, c, i, first);
  }
  for (int i = 0; i < s->segments; ++i) {
    const int from = s->segment_start[i], to = s->segment_end[i];
    const double weight = x[at->weight + i];
    N(difference)(p, from, to, S);
    N(pull_forward)(along + D * i, weight, S,
                    change->tension[s->segment_string[i]] - weight * change->length[i], change->f + from,
                    change->f + to);
  }
}

/* Weights less inertia that changes of masses add to the forces. */
static void N(weighed_forward)(const Scene *s, const double *a, const Changes *c, int first, Number *f) {
  const size_t P = c->columns;
  for (int i = 0; i < s->bars && c->bar_mass; ++i) {
    const Number mass = *numbers(c->bar_mass + i * P + first);
    const int ends[] = {s->any_start[i], s->any_end[i]};
    for (int side = 0; side < 2; ++side)
      for (int k = 0; k < D; ++k)
        f[ends[side] + k] +=
            mass * (OWN * (c->gravity[k] - a[ends[side] + k]) + OTHER * (c->gravity[k] - a[ends[!side] + k]));
  }
  for (int i = 0; i < s->entries && c->point_mass; ++i)
    f[i] += (c->gravity[i % D] - a[i]) * *numbers(c->point_mass + i / D * P + first);
}

static void N(touched_forward)(const Scene *s, const Layout *at, const double *x, const Changes *c, int first,
                               const Point *change) {
  const double *contact = x + at->contact;
  for (int i = 0; i < s->grounds; ++i)
    for (int j = 0; j < s->ground[i].count; ++j, contact += at->of_contact) {
      const int node = s->ground[i].node[j];
      const double *by = contact + 1;
      if (contact[0] == 0) continue;
      for (int k = 0; k < D; ++k) {
        Number force = change->f[node + k];
        for (int m = 0; m < D; ++m)
          force += by[k + D * m] * change->p[node + m] + by[k + D * (D + m)] * change->v[node + m];
        for (int m = 0; m < GROUND_NUMBERS && c->ground; ++m)
          force += by[k + D * (2 * D + m)] *
                   *numbers(c->ground + (size_t)(GROUND_NUMBERS * i + m) * c->columns + first);
        change->f[node + k] = force;
      }
    }
}

/* Solves for the changes of bars that share nodes. */
static void N(coupled_forward)(const Scene *s, const Layout *at, const double *x, const Point *change) {
  Number *f = change->f, *y = change->unknowns;
  for (int i = 0; i < s->block_bars; ++i) {
    const int start = s->block_start[i], end = s->block_end[i];
    const double *rate = x + at->block_bar + at->of_block_bar * i, *acceleration = rate + D;
    Number bar[D], turning[D];
    N(difference)(change->p, start, end, bar);
    N(difference)(change->v, start, end, turning);
    for (int k = 0; k < D; ++k) {
      f[end + k] -= acceleration[D] * bar[k];
      f[start + k] += acceleration[D] * bar[k];
    }
    y[s->right_place[i]] = -2 * N(times)(rate, turning) - N(times)(acceleration, bar);
  }
  for (int i = 0; i < s->block_rows; ++i) y[s->block_place[i]] = f[s->block_row[i]];
  solve_columns(s, x + at->factors, y);
  for (int i = 0; i < s->block_rows; ++i) change->a[s->block_row[i]] = y[s->block_place[i]];
}

/* The change of what a bar and its own force turn its vector by: 3/m of these. */
INLINE void N(turned_forward)(const double *bar, const Number *vector, const Number *rate,
                              const Number *force, double twice, Number *turning) {
  const double density = twice * bar[D], *by = bar + D + 1;
  const Number change = twice * (N(times)(by, vector) + N(times)(by + D, rate) + N(times)(by + 2 * D, force));
  for (int k = 0; k < D; ++k) turning[k] = force[k] + density * vector[k] + bar[k] * change;
}

INLINE void N(accelerated_forward)(const Scene *s, const Layout *at, const double *x, const Point *change) {
  const Number *p = change->p, *f = change->f;
  const double *bar = x + at->free_bar, *constants = s->bar_constants;
  Number *a = change->a, vector[D], rate[D], force[D], turning[D];
  for (int i = 0; i < s->free_bars; ++i, bar += 4 * D + 1, constants += 4) {
    const int start = s->bar_start[i], end = s->bar_end[i];
    const double inverse = constants[0], thrice = constants[1];
    N(difference)(p, start, end, vector);
    N(difference)(f, start, end, force);
    N(turned_forward)(bar, vector, change->bar_rate + D * i, force, 2, turning);
    for (int k = 0; k < D; ++k) {
      const Number mean = inverse * (f[start + k] + f[end + k]), turn = thrice * turning[k];
      a[start + k] = mean - turn;
      a[end + k] = mean + turn;
      change->bar_acceleration[D * i + k] = 2 * turn;
    }
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const int hinge = s->hinge[i], tip = s->tip[i];
    N(difference)(change->p, hinge, tip, vector);
    N(difference)(change->v, hinge, tip, rate);
    N(turned_forward)(x + at->swinging_bar + at->of_bar * i, vector, rate, f + tip, 1, turning);
    for (int k = 0; k < D; ++k) a[tip + k] = s->tip_constants[2 * i + 1] * turning[k];
  }
  for (int i = 0; i < s->points; ++i)
    for (int k = 0; k < D; ++k) a[s->point[i] + k] = f[s->point[i] + k] * s->point_inverse_mass[i];
  if (s->block_bars) N(coupled_forward)(s, at, x, change);
}

/* Changes of the accelerations of all entries by those of their places and rates. */
static void N(forward)(const Scene *s, const Layout *at, const double *x, const Changes *c, int first,
                       const Given *given, const Point *change) {
  for (int i = 0; i < s->entries; i += D)
    for (int k = 0; k < D; ++k)
      change->f[i + k] = c->load ? *numbers(c->load + (size_t)c->columns * (i + k) + first) : all(0);
  if (s->clustered) {
    N(clusters_forward)(s, at, x, c, first, given, change);
  } else if (s->segments) {
    if (s->damped) N(pulled_forward)(s, at, x, change, 1);
    else N(pulled_forward)(s, at, x, change, 0);
    N(given_forward)(s, at, x, c, first, given, change->f);
  }
  if (s->grounds) N(touched_forward)(s, at, x, c, first, change);
  if (c->bar_mass || c->point_mass) N(weighed_forward)(s, x + at->acceleration, c, first, change->f);
  N(accelerated_forward)(s, at, x, change);
}

/* A bar that is put on its length: its vector b and rate r before, as restore() in lengths.c. */
typedef struct {
  double b[D], r[D];
  double square, scale, along; /* b'b, length over |b|, b'r / b'b */
} N(Restored);

static inline N(Restored) N(restored_at)(const double *b, const double *r, double length) {
  N(Restored) bar;
  double dot = 0;
  bar.square = 0;
  for (int k = 0; k < D; ++k) {
    bar.b[k] = b[k];
    bar.r[k] = r[k];
    bar.square += b[k] * b[k];
    dot += b[k] * r[k];
  }
  bar.scale = length / sqrt(bar.square);
  bar.along = dot / bar.square;
  return bar;
}

static inline N(Restored) N(restored_free)(const Scene *s, const Lengths *lengths, int i, const double *x) {
  const double *a = x + s->bar_row[2 * i], *b = x + s->bar_row[2 * i + 1];
  double bar[D], rate[D];
  for (int k = 0; k < D; ++k) bar[k] = b[k] - a[k], rate[k] = b[s->free + k] - a[s->free + k];
  return N(restored_at)(bar, rate, lengths->bar_length[i]);
}

static inline N(Restored)
    N(restored_swinging)(const Scene *s, const Lengths *lengths, int i, const double *x) {
  const double *tip = x + s->tip_row[i], *hinge = s->place + s->hinge[i];
  double bar[D];
  for (int k = 0; k < D; ++k) bar[k] = tip[k] - hinge[k];
  return N(restored_at)(bar, tip + s->free, lengths->tip_length[i]);
}

/* Changes of the vector and rate of a bar become those after it is put on its length. */
static inline void N(restore_changes)(const N(Restored) * bar, Number *db, Number *dr) {
  const double inverse = 1 / bar->scale, part = 1 / bar->square;
  const Number stretch = part * N(times)(bar->b, db);
  const Number drift = part * (N(times)(bar->r, db) + N(times)(bar->b, dr)) - 2 * bar->along * stretch;
  for (int k = 0; k < D; ++k) {
    const double b = bar->b[k], across = bar->r[k] - bar->along * b;
    dr[k] = inverse * (dr[k] - bar->along * db[k] - b * drift + across * stretch);
    db[k] = bar->scale * (db[k] - b * stretch);
  }
}

/* All bars that are put on their lengths at the end of a step, those that are free first. */
static void N(restored_all)(const Scene *s, const Lengths *lengths, const double *x, void *memory) {
  N(Restored) *bar = memory;
  for (int i = 0; i < s->free_bars; ++i) *bar++ = N(restored_free)(s, lengths, i, x);
  for (int i = 0; i < s->swinging_bars; ++i) *bar++ = N(restored_swinging)(s, lengths, i, x);
}

/* Changes of a state, (states), become those after its bars, of which none share nodes, are put on
   their lengths. */
static void N(restored_forward)(const Scene *s, const void *restored, Number *X) {
  const N(Restored) *bar = restored;
  for (int i = 0; i < s->free_bars; ++i, ++bar) {
    Number *a = X + s->bar_row[2 * i], *b = X + s->bar_row[2 * i + 1], of[2][D], mean[2][D];
    for (int m = 0; m < 2; ++m)
      for (int k = 0; k < D; ++k) {
        of[m][k] = b[m * s->free + k] - a[m * s->free + k];
        mean[m][k] = (b[m * s->free + k] + a[m * s->free + k]) / 2;
      }
    N(restore_changes)(bar, of[0], of[1]);
    for (int m = 0; m < 2; ++m)
      for (int k = 0; k < D; ++k) {
        a[m * s->free + k] = mean[m][k] - of[m][k] / 2;
        b[m * s->free + k] = mean[m][k] + of[m][k] / 2;
      }
  }
  for (int i = 0; i < s->swinging_bars; ++i, ++bar)
    N(restore_changes)(bar, X + s->tip_row[i], X + s->tip_row[i] + s->free);
}

/* ---- backward: one cost ---- */

static inline void N(spread_difference)(const double *of, int start, int end, double *to) {
  for (int k = 0; k < D; ++k) {
    to[end + k] += of[k];
    to[start + k] -= of[k];
  }
}

static inline double N(dot)(const double *a, const double *b) {
  double sum = a[0] * b[0];
  for (int k = 1; k < D; ++k) sum += a[k] * b[k];
  return sum;
}

/* Of a cost by what a bar turns by: those by its vector, rate and force. */
static inline void N(turned_backward)(const double *bar, const double *cost, double twice, double *of_bar,
                                      double *of_rate, double *of_force) {
  const double density = twice * bar[D], *by = bar + D + 1, change = twice * N(dot)(bar, cost);
  for (int k = 0; k < D; ++k) {
    of_bar[k] = density * cost[k] + change * by[k];
    of_rate[k] = change * by[D + k];
    of_force[k] = cost[k] + change * by[2 * D + k];
  }
}

static void N(coupled_backward)(const Scene *s, const Layout *at, const double *x, const Cost *by) {
  double *f = by->f, *y = by->unknowns;
  memset(y, 0, s->unknowns * sizeof *y);
  for (int i = 0; i < s->block_rows; ++i) y[s->block_place[i]] = by->a[s->block_row[i]];
  solve_numbers(s, x + at->factors, y);
  for (int i = 0; i < s->block_rows; ++i) f[s->block_row[i]] += y[s->block_place[i]];
  for (int i = 0; i < s->block_bars; ++i) {
    const int start = s->block_start[i], end = s->block_end[i];
    const double *rate = x + at->block_bar + at->of_block_bar * i, *acceleration = rate + D;
    const double own = y[s->right_place[i]];
    double of_bar[D], of_rate[D];
    for (int k = 0; k < D; ++k) {
      of_bar[k] = -acceleration[D] * (f[end + k] - f[start + k]) - own * acceleration[k];
      of_rate[k] = -2 * own * rate[k];
    }
    N(spread_difference)(of_bar, start, end, by->p);
    N(spread_difference)(of_rate, start, end, by->v);
  }
}

static void N(accelerated_backward)(const Scene *s, const Layout *at, const double *x, const Cost *by) {
  const double *cost = by->a;
  double *f = by->f, turning[D], of_bar[D], of_rate[D], of_force[D];
  for (int i = 0; i < s->free_bars; ++i) {
    const int start = s->bar_start[i], end = s->bar_end[i];
    const double inverse = s->bar_constants[4 * i];
    for (int k = 0; k < D; ++k) {
      const double of_both = inverse * (cost[start + k] + cost[end + k]);
      turning[k] = 3 * inverse * (cost[end + k] - cost[start + k]);
      f[start + k] += of_both;
      f[end + k] += of_both;
    }
    N(turned_backward)(x + at->free_bar + at->of_bar * i, turning, 2, of_bar, of_rate, of_force);
    N(spread_difference)(of_bar, start, end, by->p);
    N(spread_difference)(of_rate, start, end, by->v);
    N(spread_difference)(of_force, start, end, f);
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const int hinge = s->hinge[i], tip = s->tip[i];
    for (int k = 0; k < D; ++k) turning[k] = s->tip_constants[2 * i + 1] * cost[tip + k];
    N(turned_backward)(x + at->swinging_bar + at->of_bar * i, turning, 1, of_bar, of_rate, of_force);
    N(spread_difference)(of_bar, hinge, tip, by->p);
    N(spread_difference)(of_rate, hinge, tip, by->v);
    for (int k = 0; k < D; ++k) f[tip + k] += of_force[k];
  }
  for (int i = 0; i < s->points; ++i)
    for (int k = 0; k < D; ++k) f[s->point[i] + k] += cost[s->point[i] + k] * s->point_inverse_mass[i];
  if (s->block_bars) N(coupled_backward)(s, at, x, by);
}

static void N(weighed_backward)(const Scene *s, const double *a, const Changes *c, const double *f) {
  for (int i = 0; i < s->bars && c->bar_mass; ++i) {
    const int ends[] = {s->any_start[i], s->any_end[i]};
    for (int side = 0; side < 2; ++side)
      for (int k = 0; k < D; ++k)
        c->bar_mass[i] += f[ends[side] + k] * (OWN * (c->gravity[k] - a[ends[side] + k]) +
                                               OTHER * (c->gravity[k] - a[ends[!side] + k]));
  }
  for (int i = 0; i < s->entries && c->point_mass; ++i)
    c->point_mass[i / D] += f[i] * (c->gravity[i % D] - a[i]);
}

static void N(touched_backward)(const Scene *s, const Layout *at, const double *x, const Changes *c,
                                const Cost *by) {
  const double *contact = x + at->contact;
  for (int i = 0; i < s->grounds; ++i)
    for (int j = 0; j < s->ground[i].count; ++j, contact += at->of_contact) {
      const int node = s->ground[i].node[j];
      const double *slopes = contact + 1, *f = by->f + node;
      if (contact[0] == 0) continue;
      for (int k = 0; k < D; ++k) {
        by->p[node + k] += N(dot)(slopes + D * k, f);
        by->v[node + k] += N(dot)(slopes + D * (D + k), f);
      }
      for (int m = 0; m < GROUND_NUMBERS && c->ground; ++m)
        c->ground[GROUND_NUMBERS * i + m] += N(dot)(slopes + D * (2 * D + m), f);
    }
}

/* Of a cost by the tension of a string: those by its numbers, with what each value of a profile counts. */
static inline void N(tension_backward)(const double *by, const Changes *c, int i, const Shares *shares,
                                       double cost) {
  add_input_cost(c, i, shares, by[BY_REST] * cost);
  if (c->stiffness) c->stiffness[i] += by[BY_STIFFNESS] * cost;
  if (c->damping) c->damping[i] += by[BY_DAMPING] * cost;
}

/* Of costs by the pull of a segment, its length and its rate: those by places and rates. */
static inline void N(stretch_backward)(const Scene *s, const Layout *at, const double *x, int i,
                                       const double *pull, double length, double rate, const Cost *by) {
  const int start = s->segment_start[i], end = s->segment_end[i];
  const double *along = x + at->along + D * i, weight = x[at->weight + i];
  double of_S[D], of_Sd[D];
  for (int k = 0; k < D; ++k) of_S[k] = weight * pull[k] + length * along[k];
  if (s->damped) {
    const double *turning = x + at->turning + D * i;
    for (int k = 0; k < D; ++k) {
      of_S[k] += rate * turning[k];
      of_Sd[k] = rate * along[k];
    }
    N(spread_difference)(of_Sd, start, end, by->v);
  }
  N(spread_difference)(of_S, start, end, by->p);
}

static void N(pulled_backward)(const Scene *s, const Layout *at, const double *x, const Changes *c,
                               const Shares *shares, const Cost *by) {
  double pull[D];
  memset(by->tension, 0, s->strings * sizeof *by->tension);
  for (int pass = s->clustered ? 0 : 1; pass < 2; ++pass)
    for (int i = 0; i < s->segments; ++i) {
      const int string = s->segment_string[i];
      const double *slopes = x + at->string + at->of_string * string;
      double axial, tension;
      for (int k = 0; k < D; ++k) pull[k] = by->f[s->segment_start[i] + k] - by->f[s->segment_end[i] + k];
      axial = N(dot)(x + at->along + D * i, pull);
      if (!pass || !s->clustered) by->tension[string] += axial;
      if (!pass) continue;
      tension = by->tension[string];
      N(stretch_backward)(s, at, x, i, pull,
                          slopes[BY_LENGTH] * tension - (s->clustered ? x[at->weight + i] * axial : 0),
                          s->damped ? slopes[BY_RATE] * tension : 0, by);
    }
  for (int i = 0; i < s->strings; ++i)
    N(tension_backward)(x + at->string + at->of_string * i, c, i, shares, by->tension[i]);
}

/* A cost by the vector and rate of a bar on its length becomes that by those before. */
static inline void N(restore_costs)(const N(Restored) * bar, double *of_b, double *of_r) {
  double stretch = 0, drift = 0;
  for (int k = 0; k < D; ++k) {
    of_b[k] *= bar->scale;
    of_r[k] /= bar->scale;
    stretch += (bar->r[k] - bar->along * bar->b[k]) * of_r[k] - bar->b[k] * of_b[k];
    drift -= bar->b[k] * of_r[k];
  }
  stretch -= 2 * bar->along * drift;
  for (int k = 0; k < D; ++k) {
    of_b[k] += -bar->along * of_r[k] + (bar->b[k] * stretch + bar->r[k] * drift) / bar->square;
    of_r[k] += bar->b[k] * drift / bar->square;
  }
}

/* The transpose of `restored_forward`. */
static void N(restored_backward)(const Scene *s, const Lengths *lengths, const double *x, double *mu,
                                 size_t apart) {
  for (int i = 0; i < s->free_bars; ++i) {
    const N(Restored) bar = N(restored_free)(s, lengths, i, x);
    double *a = mu + s->bar_row[2 * i], *b = mu + s->bar_row[2 * i + 1], of[2][D], sum[2][D];
    for (int m = 0; m < 2; ++m)
      for (int k = 0; k < D; ++k) {
        of[m][k] = (b[m * apart + k] - a[m * apart + k]) / 2;
        sum[m][k] = (b[m * apart + k] + a[m * apart + k]) / 2;
      }
    N(restore_costs)(&bar, of[0], of[1]);
    for (int m = 0; m < 2; ++m)
      for (int k = 0; k < D; ++k) {
        a[m * apart + k] = sum[m][k] - of[m][k];
        b[m * apart + k] = sum[m][k] + of[m][k];
      }
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const N(Restored) bar = N(restored_swinging)(s, lengths, i, x);
    N(restore_costs)(&bar, mu + s->tip_row[i], mu + s->tip_row[i] + apart);
  }
}

/* The cost by places and rates of all entries, p and v, of one by accelerations, a, of those that
   are free. What supports hold takes all forces. */
static void N(backward)(const Scene *s, const Layout *at, const double *x, const Changes *c,
                        const Shares *shares, const Cost *by) {
  memset(by->p, 0, s->entries * sizeof *by->p);
  memset(by->v, 0, s->entries * sizeof *by->v);
  memset(by->f, 0, s->entries * sizeof *by->f);
  N(accelerated_backward)(s, at, x, by);
  if (s->free_row) {
    memset(by->a, 0, s->entries * sizeof *by->a);
    for (int i = 0; i < s->free; ++i) by->a[s->free_row[i]] = by->f[s->free_row[i]];
    memcpy(by->f, by->a, s->entries * sizeof *by->f);
  }
  for (int i = 0; i < s->entries && c->load; ++i) c->load[i] += by->f[i];
  if (c->bar_mass || c->point_mass) N(weighed_backward)(s, x + at->acceleration, c, by->f);
  if (s->grounds) N(touched_backward)(s, at, x, c, by);
  if (s->segments) N(pulled_backward)(s, at, x, c, shares, by);
}

#undef NAME_
#undef NAME2
#undef N
