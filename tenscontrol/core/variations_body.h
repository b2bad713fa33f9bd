/* Derivatives of the equation of motion in D dimensions: included by variations.c, once for each. */

#define NAME_(name, d) name##_##d
#define NAME2(name, d) NAME_(name, d)
#define N(name) NAME2(name, D)

enum { N(TOUCH) = 2 * D + GROUND_NUMBERS };

/* Forces of strings, with their derivatives. */
INLINE void N(pulled)(const Scene *s, const double *u, const double *taut, const Point *at) {
  const int has_lengths = s->law != FORCE_DENSITY_HELD || s->clustered;
  memset(at->string_length, 0, s->strings * sizeof(double));
  memset(at->string_rate, 0, s->strings * sizeof(double));
  for (int i = 0; i < s->segments; ++i) {
    const double *p = at->p, *v = at->v;
    const int start = s->segment_start[i], end = s->segment_end[i];
    double *S = at->S + D * i, *Sd = at->Sd + D * i, square = 0, along = 0;
    for (int k = 0; k < D; ++k) {
      S[k] = p[end + k] - p[start + k];
      Sd[k] = v[end + k] - v[start + k];
      square += S[k] * S[k];
      along += S[k] * Sd[k];
    }
    if (!has_lengths) continue;
    at->length[i] = sqrt(larger(square, s->shortest * s->shortest));
    at->rate[i] = s->damped ? along / at->length[i] : 0;
    at->string_length[s->segment_string[i]] += at->length[i];
    at->string_rate[s->segment_string[i]] += at->rate[i];
  }
  for (int i = 0; i < s->strings; ++i)
    at->gamma[i] = string_slopes(s, i, at->string_length[i], at->string_rate[i], u[i],
                                 s->slacking ? taut[i] : 1, at->by + STRING_SLOPES * i);
  for (int i = 0; i < s->segments; ++i) {
    const int j = s->segment_string[i];
    const double *S = at->S + D * i;
    at->weight[i] = at->gamma[j] * (s->clustered ? at->string_length[j] / at->length[i] : 1);
    for (int k = 0; k < D; ++k) {
      at->f[s->segment_start[i] + k] += at->weight[i] * S[k];
      at->f[s->segment_end[i] + k] -= at->weight[i] * S[k];
    }
  }
}

/* The force of the ground on a node, with its derivatives by x, v and the numbers of the law. */
static void N(touched)(const Ground *g, const double *own, const double *x, const double *v,
                       double pressing, double *force, double *by) {
  const double k = own[0], c = own[1], friction = own[2], slip = own[3], height = own[4];
  const double width = own[5], *normal = g->normal;
  double slopes[D * N(TOUCH)];
  int given = 2 * D + GROUND_NUMBERS - 1;
  memset(by, 0, D * N(TOUCH) * sizeof *by);
  if (g->kind == LINEAR_GROUND) {
    N(linear_ground_slopes)(x, v, k, c, friction, slip, height, pressing, normal, force, slopes);
  } else if (g->kind == HERTZ_GROUND) {
    N(hertz_ground_slopes)(x, v, k, c, friction, slip, height, pressing, normal, force, slopes);
  } else if (c == 0) { /* the law leaves damping out; what a little of it would do, the other tells */
    double of_damping[D * N(TOUCH)];
    N(smooth_ground_slopes)(x, v, k, c, friction, slip, height, width, normal, force, of_damping);
    N(smooth_undamped_ground_slopes)(x, v, k, friction, slip, height, width, normal, force, slopes);
    memcpy(by, slopes, D * (2 * D + 1) * sizeof *by);
    memcpy(by + D * (2 * D + 1), of_damping + D * (2 * D + 1), D * sizeof *by);
    memcpy(by + D * (2 * D + 2), slopes + D * (2 * D + 1), D * 4 * sizeof *by);
    return;
  } else {
    N(smooth_ground_slopes)(x, v, k, c, friction, slip, height, width, normal, force, slopes);
    ++given;
  }
  memcpy(by, slopes, D * given * sizeof *by);
}

INLINE void N(accelerated)(const Scene *s, const Point *at) {
  const double *p = at->p, *v = at->v, *f = at->f;
  double *a = at->a;
  memset(a, 0, s->entries * sizeof *a);
  for (int i = 0; i < s->free_bars; ++i) {
    const int start = s->bar_start[i], end = s->bar_end[i];
    double bar[D], rate[D], difference[D], turning[D];
    for (int k = 0; k < D; ++k) {
      bar[k] = p[end + k] - p[start + k];
      rate[k] = v[end + k] - v[start + k];
      difference[k] = f[end + k] - f[start + k];
    }
    N(turning_bar_slopes)(bar, rate, difference, 12 * s->bar_constants[4 * i + 2], turning,
                          at->free_bar + 3 * D * D * i);
    for (int k = 0; k < D; ++k) {
      const double mean = s->bar_constants[4 * i] * (f[start + k] + f[end + k]);
      a[start + k] = mean - turning[k];
      a[end + k] = mean + turning[k];
    }
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const int hinge = s->hinge[i], tip = s->tip[i];
    double bar[D], rate[D];
    for (int k = 0; k < D; ++k) bar[k] = p[tip + k] - p[hinge + k], rate[k] = v[tip + k] - v[hinge + k];
    N(swinging_bar_slopes)(bar, rate, f + tip, 3 * s->tip_constants[2 * i], a + tip,
                           at->swinging_bar + 3 * D * D * i);
  }
  for (int i = 0; i < s->points; ++i)
    for (int k = 0; k < D; ++k) a[s->point[i] + k] = f[s->point[i] + k] * s->point_inverse_mass[i];
  if (!s->block_bars) return;
  memcpy(at->factors, s->block_mass, (s->factors + s->unknowns + 1) * sizeof(double));
  for (int i = 0; i < s->block_rows; ++i) at->unknowns[s->block_place[i]] = f[s->block_row[i]];
  for (int i = 0; i < s->block_bars; ++i) {
    double square = 0;
    for (int k = 0; k < D; ++k) {
      const double b = p[s->block_end[i] + k] - p[s->block_start[i] + k];
      const double r = v[s->block_end[i] + k] - v[s->block_start[i] + k];
      at->factors[s->entry_end[D * i + k]] = b;
      at->factors[s->entry_start[D * i + k]] = -b;
      square += r * r;
    }
    at->unknowns[s->right_place[i]] = -square;
  }
  factorize(s, at->factors);
  solve(s, at->factors, at->unknowns);
  for (int i = 0; i < s->block_rows; ++i) a[s->block_row[i]] = at->unknowns[s->block_place[i]];
}

/* Forces and accelerations at a point whose p and v are there, with the derivatives of members. */
INLINE void N(differentiated)(const Scene *s, const Input *input, const double *taut,
                              const Point *at) {
  const double *load = input->load ? input->load : s->load;
  double *by = at->touch;
  if (load)
    memcpy(at->f, load, s->entries * sizeof *load);
  else
    memset(at->f, 0, s->entries * sizeof(double));
  if (s->segments) N(pulled)(s, input->strings, taut, at);
  for (int i = 0; i < s->grounds; ++i) {
    const Ground *g = s->ground + i;
    const double *own = s->ground_numbers + GROUND_NUMBERS * i;
    for (int j = 0; j < g->count; ++j, by += D * N(TOUCH)) {
      const double pressing = g->first_switch < 0 ? 1 : taut[s->slacking + g->first_switch + j];
      double force[D];
      N(touched)(g, own, at->p + g->node[j], at->v + g->node[j], pressing, force, by);
      for (int k = 0; k < D; ++k) at->f[g->node[j] + k] += force[k];
    }
  }
  N(accelerated)(s, at);
}

/* ---- forward: a block of columns ----

   A loop over columns writes one row and reads numbers of its own: what might share memory with the row
   would keep it from wide registers. */

#define EACH for (int j = 0; j < COLUMNS; ++j)
typedef double N(Row)[COLUMNS];

INLINE void N(differences)(const N(Row) *from, int start, int end, N(Row) *to) {
  for (int k = 0; k < D; ++k) EACH to[k][j] = from[end + k][j] - from[start + k][j];
}

INLINE void N(pulled_forward)(const Scene *s, const Point *at, int stage, const Changes *c, int first,
                              const N(Row) *dp, const N(Row) *dv, N(Row) *df, N(Row) *dL,
                              N(Row) *dR, N(Row) *dgamma, N(Row) *dl) {
  const size_t P = c->columns;
  const int has_lengths = s->law != FORCE_DENSITY_HELD || s->clustered;
  memset(dL, 0, s->strings * sizeof *dL);
  memset(dR, 0, s->strings * sizeof *dR);
  for (int i = 0; i < s->segments && has_lengths; ++i) {
    const int string = s->segment_string[i];
    const double *S = at->S + D * i, *Sd = at->Sd + D * i, inverse = 1 / at->length[i];
    const double slowing = at->rate[i] * inverse;
    double stretch[COLUMNS] = {0}, drift[COLUMNS] = {0};
    N(Row) change[D];
    N(differences)(dp, s->segment_start[i], s->segment_end[i], change);
    for (int k = 0; k < D; ++k) {
      const double along = S[k] * inverse;
      EACH stretch[j] += along * change[k][j];
    }
    EACH dl[i][j] = stretch[j];
    EACH dL[string][j] += stretch[j];
    if (!s->damped) continue;
    for (int k = 0; k < D; ++k) {
      const double turning = Sd[k] * inverse;
      EACH drift[j] += turning * change[k][j];
    }
    N(differences)(dv, s->segment_start[i], s->segment_end[i], change);
    for (int k = 0; k < D; ++k) {
      const double along = S[k] * inverse;
      EACH drift[j] += along * change[k][j];
    }
    EACH dR[string][j] += drift[j] - slowing * stretch[j];
  }
  for (int i = 0; i < s->strings; ++i) {
    const double *by = at->by + STRING_SLOPES * i;
    const double *const changes[] = {c->input ? c->input + stage * s->strings * P : 0, c->stiffness,
                                     c->damping};
    const double slopes[] = {by[BY_REST], by[BY_STIFFNESS], by[BY_DAMPING]};
    const double by_length = by[BY_LENGTH], by_rate = by[BY_RATE];
    double sum[COLUMNS];
    EACH sum[j] = by_length * dL[i][j] + by_rate * dR[i][j];
    for (int m = 0; m < 3; ++m) {
      const double *row = changes[m] ? changes[m] + i * P + first : 0;
      const double slope = slopes[m];
      if (row && slope != 0) EACH sum[j] += slope * row[j];
    }
    EACH dgamma[i][j] = sum[j];
  }
  for (int i = 0; i < s->segments; ++i) {
    const int start = s->segment_start[i], end = s->segment_end[i], string = s->segment_string[i];
    const double *S = at->S + D * i, weight = at->weight[i];
    double dw[COLUMNS];
    N(Row) change[D];
    EACH dw[j] = dgamma[string][j];
    if (s->clustered)
      EACH dw[j] = (dw[j] * at->string_length[string] + at->gamma[string] * dL[string][j] -
                    weight * dl[i][j]) / at->length[i];
    N(differences)(dp, start, end, change);
    for (int k = 0; k < D; ++k) {
      const double along = S[k];
      double pull[COLUMNS];
      EACH pull[j] = dw[j] * along + weight * change[k][j];
      EACH df[start + k][j] += pull[j];
      EACH df[end + k][j] -= pull[j];
    }
  }
}

/* Weights less inertia that changes of masses add to the forces. */
INLINE void N(weighed_forward)(const Scene *s, const Point *at, const Changes *c, int first,
                               N(Row) *df) {
  const size_t P = c->columns;
  for (int i = 0; i < s->bars && c->bar_mass; ++i) {
    const double *dm = c->bar_mass + i * P + first;
    const int ends[] = {s->any_start[i], s->any_end[i]};
    for (int side = 0; side < 2; ++side)
      for (int k = 0; k < D; ++k) {
        const double own = c->gravity[k] - at->a[ends[side] + k];
        const double other = c->gravity[k] - at->a[ends[!side] + k];
        EACH df[ends[side] + k][j] += (OWN * own + OTHER * other) * dm[j];
      }
  }
  for (int i = 0; i < s->entries / D && c->point_mass; ++i) {
    const double *dm = c->point_mass + i * P + first;
    for (int k = 0; k < D; ++k) EACH df[D * i + k][j] += (c->gravity[k] - at->a[D * i + k]) * dm[j];
  }
}

INLINE void N(touched_forward)(const Scene *s, const Point *at, const Changes *c, int first,
                               const N(Row) *dp, const N(Row) *dv, N(Row) *df) {
  const double *by = at->touch;
  for (int i = 0; i < s->grounds; ++i)
    for (int contact = 0; contact < s->ground[i].count; ++contact, by += D * N(TOUCH)) {
      const int node = s->ground[i].node[contact];
      for (int k = 0; k < D; ++k) {
        for (int m = 0; m < D; ++m) {
          const double by_place = by[k + D * m], by_rate = by[k + D * (D + m)];
          EACH df[node + k][j] += by_place * dp[node + m][j] + by_rate * dv[node + m][j];
        }
        for (int m = 0; m < GROUND_NUMBERS && c->ground; ++m) {
          const double *change = c->ground + (size_t)(GROUND_NUMBERS * i + m) * c->columns + first;
          EACH df[node + k][j] += by[k + D * (2 * D + m)] * change[j];
        }
      }
    }
}

/* Solves for the changes of bars that share nodes; df of their nodes is used up. */
INLINE void N(coupled_forward)(const Scene *s, const Point *at, const N(Row) *dp, const N(Row) *dv,
                               N(Row) *df, N(Row) *da, double *y) {
  for (int i = 0; i < s->block_bars; ++i) {
    const double force = at->unknowns[s->right_place[i]];
    N(Row) change[D];
    N(differences)(dp, s->block_start[i], s->block_end[i], change);
    for (int k = 0; k < D; ++k)
      EACH {
        df[s->block_end[i] + k][j] -= force * change[k][j];
        df[s->block_start[i] + k][j] += force * change[k][j];
      }
  }
  for (int j = 0; j < COLUMNS; ++j) {
    for (int i = 0; i < s->block_rows; ++i) y[s->block_place[i]] = df[s->block_row[i]][j];
    for (int i = 0; i < s->block_bars; ++i) {
      const int start = s->block_start[i], end = s->block_end[i];
      double right = 0;
      for (int k = 0; k < D; ++k)
        right -= 2 * (at->v[end + k] - at->v[start + k]) * (dv[end + k][j] - dv[start + k][j]) +
                 (dp[end + k][j] - dp[start + k][j]) * (at->a[end + k] - at->a[start + k]);
      y[s->right_place[i]] = right;
    }
    solve(s, at->factors, y);
    for (int i = 0; i < s->block_rows; ++i) da[s->block_row[i]][j] = y[s->block_place[i]];
  }
}

/* Multiplies a Jacobian (D, 3 D), stored by columns, with changes of three vectors. */
INLINE void N(times)(const double *by, const N(Row) *const *changes, N(Row) *to) {
  for (int i = 0; i < D; ++i) {
    double sum[COLUMNS] = {0};
    for (int m = 0; m < 3; ++m)
      for (int k = 0; k < D; ++k) {
        const double slope = by[i + D * (D * m + k)];
        EACH sum[j] += slope * changes[m][k][j];
      }
    memcpy(to + i, sum, sizeof sum);
  }
}

INLINE void N(accelerated_forward)(const Scene *s, const Point *at, const N(Row) *dp,
                                   const N(Row) *dv, N(Row) *df, N(Row) *da, double *y) {
  for (int i = 0; i < s->free_bars; ++i) {
    const int start = s->bar_start[i], end = s->bar_end[i];
    const double inverse = s->bar_constants[4 * i];
    N(Row) bar[D], rate[D], difference[D], turning[D];
    const N(Row) *const changes[] = {bar, rate, difference};
    N(differences)(dp, start, end, bar);
    N(differences)(dv, start, end, rate);
    N(differences)((const N(Row) *)df, start, end, difference);
    N(times)(at->free_bar + 3 * D * D * i, changes, turning);
    for (int k = 0; k < D; ++k) {
      double mean[COLUMNS];
      EACH mean[j] = inverse * (df[start + k][j] + df[end + k][j]);
      EACH da[start + k][j] = mean[j] - turning[k][j];
      EACH da[end + k][j] = mean[j] + turning[k][j];
    }
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const int hinge = s->hinge[i], tip = s->tip[i];
    N(Row) bar[D], rate[D];
    const N(Row) *const changes[] = {bar, rate, df + tip};
    N(differences)(dp, hinge, tip, bar);
    N(differences)(dv, hinge, tip, rate);
    N(times)(at->swinging_bar + 3 * D * D * i, changes, da + tip);
  }
  for (int i = 0; i < s->points; ++i)
    for (int k = 0; k < D; ++k)
      EACH da[s->point[i] + k][j] = df[s->point[i] + k][j] * s->point_inverse_mass[i];
  if (s->block_bars) N(coupled_forward)(s, at, dp, dv, df, da, y);
}

/* Changes of the accelerations, (free), by those of the free places and rates. */
INLINE void N(forward)(const Scene *s, const Point *at, int stage, const Changes *c, int first,
                       const double *places, const double *rates, double *accelerations,
                       double *work) {
  const size_t P = c->columns, row = sizeof(N(Row)), n = s->entries;
  const N(Row) *q = (const N(Row) *)places, *v = (const N(Row) *)rates;
  N(Row) *to = (N(Row) *)accelerations;
  N(Row) *all_q = (N(Row) *)work, *all_v = all_q + n, *df = all_v + n, *all_a = df + n;
  N(Row) *dL = all_a + n, *dR = dL + s->strings, *dgamma = dR + s->strings;
  N(Row) *dl = dgamma + s->strings;
  double *y = (double *)(dl + s->segments);
  if (s->free_row) {
    memset(all_q, 0, 2 * n * row);
    for (int i = 0; i < s->free; ++i) {
      memcpy(all_q + s->free_row[i], q + i, row);
      memcpy(all_v + s->free_row[i], v + i, row);
    }
    q = (const N(Row) *)all_q;
    v = (const N(Row) *)all_v;
  }
  for (size_t i = 0; i < n; ++i)
    if (c->load)
      memcpy(df + i, c->load + i * P + first, row);
    else
      memset(df + i, 0, row);
  if (s->segments) N(pulled_forward)(s, at, stage, c, first, q, v, df, dL, dR, dgamma, dl);
  N(touched_forward)(s, at, c, first, q, v, df);
  N(weighed_forward)(s, at, c, first, df);
  if (!s->free_row) {
    N(accelerated_forward)(s, at, q, v, df, to, y);
    return;
  }
  N(accelerated_forward)(s, at, q, v, df, all_a, y);
  for (int i = 0; i < s->free; ++i) memcpy(to + i, all_a + s->free_row[i], row);
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

static inline N(Restored) N(restored_free)(const Scene *s, const Lengths *lengths, int i,
                                           const double *x) {
  const double *a = x + s->bar_row[2 * i], *b = x + s->bar_row[2 * i + 1];
  double bar[D], rate[D];
  for (int k = 0; k < D; ++k) bar[k] = b[k] - a[k], rate[k] = b[s->free + k] - a[s->free + k];
  return N(restored_at)(bar, rate, lengths->bar_length[i]);
}

static inline N(Restored) N(restored_swinging)(const Scene *s, const Lengths *lengths, int i,
                                               const double *x) {
  const double *tip = x + s->tip_row[i], *hinge = s->place + s->hinge[i];
  double bar[D];
  for (int k = 0; k < D; ++k) bar[k] = tip[k] - hinge[k];
  return N(restored_at)(bar, tip + s->free, lengths->tip_length[i]);
}

/* Changes of the vector and rate of a bar become those after it is put on its length. */
INLINE void N(restore_changes)(N(Restored) bar, N(Row) *db, N(Row) *dr) {
  const double inverse = 1 / bar.scale;
  double stretch[COLUMNS] = {0}, drift[COLUMNS] = {0};
  for (int k = 0; k < D; ++k)
    EACH {
      stretch[j] += bar.b[k] / bar.square * db[k][j];
      drift[j] += bar.r[k] / bar.square * db[k][j] + bar.b[k] / bar.square * dr[k][j];
    }
  EACH drift[j] -= 2 * bar.along * stretch[j];
  for (int k = 0; k < D; ++k) {
    const double b = bar.b[k], across = bar.r[k] - bar.along * b;
    EACH dr[k][j] = inverse * (dr[k][j] - bar.along * db[k][j] - b * drift[j] + across * stretch[j]);
    EACH db[k][j] = bar.scale * (db[k][j] - b * stretch[j]);
  }
}

/* Changes of a state, (states), become those after its bars, of which none share nodes, are put on
   their lengths. */
INLINE void N(restored_forward)(const Scene *s, const Lengths *lengths, const double *x,
                                double *changes) {
  N(Row) *X = (N(Row) *)changes;
  for (int i = 0; i < s->free_bars; ++i) {
    const N(Restored) bar = N(restored_free)(s, lengths, i, x);
    N(Row) *a = X + s->bar_row[2 * i], *b = X + s->bar_row[2 * i + 1], of[2][D], mean[2][D];
    for (int m = 0; m < 2; ++m)
      for (int k = 0; k < D; ++k)
        EACH {
          of[m][k][j] = b[m * s->free + k][j] - a[m * s->free + k][j];
          mean[m][k][j] = (b[m * s->free + k][j] + a[m * s->free + k][j]) / 2;
        }
    N(restore_changes)(bar, of[0], of[1]);
    for (int m = 0; m < 2; ++m)
      for (int k = 0; k < D; ++k) {
        EACH a[m * s->free + k][j] = mean[m][k][j] - of[m][k][j] / 2;
        EACH b[m * s->free + k][j] = mean[m][k][j] + of[m][k][j] / 2;
      }
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const N(Restored) bar = N(restored_swinging)(s, lengths, i, x);
    N(restore_changes)(bar, X + s->tip_row[i], X + s->tip_row[i] + s->free);
  }
}
#undef EACH

/* ---- backward: one cost ---- */

static inline void N(spread_difference)(const double *of, int start, int end, double *to) {
  for (int k = 0; k < D; ++k) {
    to[end + k] += of[k];
    to[start + k] -= of[k];
  }
}

/* Multiplies the transpose of a Jacobian of so many rows with a cost of what it returns. */
static inline void N(transposed)(const double *by, int rows, const double *cost, int count,
                                 double *to) {
  for (int m = 0; m < count; ++m) {
    to[m] = 0;
    for (int i = 0; i < rows; ++i) to[m] += by[i + rows * m] * cost[i];
  }
}

INLINE void N(accelerated_backward)(const Scene *s, const Point *at, const double *cost, double *p,
                                    double *v, double *f, double *y) {
  for (int i = 0; i < s->free_bars; ++i) {
    const int start = s->bar_start[i], end = s->bar_end[i];
    double of_turning[D], to[3 * D];
    for (int k = 0; k < D; ++k) {
      const double of_force = s->bar_constants[4 * i] * (cost[start + k] + cost[end + k]);
      of_turning[k] = cost[end + k] - cost[start + k];
      f[start + k] += of_force;
      f[end + k] += of_force;
    }
    N(transposed)(at->free_bar + 3 * D * D * i, D, of_turning, 3 * D, to);
    N(spread_difference)(to, start, end, p);
    N(spread_difference)(to + D, start, end, v);
    N(spread_difference)(to + 2 * D, start, end, f);
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const int hinge = s->hinge[i], tip = s->tip[i];
    double to[3 * D];
    N(transposed)(at->swinging_bar + 3 * D * D * i, D, cost + tip, 3 * D, to);
    N(spread_difference)(to, hinge, tip, p);
    N(spread_difference)(to + D, hinge, tip, v);
    for (int k = 0; k < D; ++k) f[tip + k] += to[2 * D + k];
  }
  for (int i = 0; i < s->points; ++i)
    for (int k = 0; k < D; ++k)
      f[s->point[i] + k] += cost[s->point[i] + k] * s->point_inverse_mass[i];
  if (!s->block_bars) return;
  memset(y, 0, s->unknowns * sizeof *y);
  for (int i = 0; i < s->block_rows; ++i) y[s->block_place[i]] = cost[s->block_row[i]];
  solve(s, at->factors, y);
  for (int i = 0; i < s->block_rows; ++i) f[s->block_row[i]] += y[s->block_place[i]];
  for (int i = 0; i < s->block_bars; ++i) {
    const int start = s->block_start[i], end = s->block_end[i];
    const double force = at->unknowns[s->right_place[i]], own = y[s->right_place[i]];
    double of_bar[D], of_rate[D];
    for (int k = 0; k < D; ++k) {
      of_bar[k] = -force * (f[end + k] - f[start + k]) - own * (at->a[end + k] - at->a[start + k]);
      of_rate[k] = -2 * own * (at->v[end + k] - at->v[start + k]);
    }
    N(spread_difference)(of_bar, start, end, p);
    N(spread_difference)(of_rate, start, end, v);
  }
}

static void N(weighed_backward)(const Scene *s, const Point *at, Changes *c, const double *f) {
  for (int i = 0; i < s->bars && c->bar_mass; ++i) {
    const int ends[] = {s->any_start[i], s->any_end[i]};
    for (int side = 0; side < 2; ++side)
      for (int k = 0; k < D; ++k)
        c->bar_mass[i] += f[ends[side] + k] * (OWN * (c->gravity[k] - at->a[ends[side] + k]) +
                                               OTHER * (c->gravity[k] - at->a[ends[!side] + k]));
  }
  for (int i = 0; i < s->entries && c->point_mass; ++i)
    c->point_mass[i / D] += f[i] * (c->gravity[i % D] - at->a[i]);
}

static void N(touched_backward)(const Scene *s, const Point *at, Changes *c, const double *f,
                                double *p, double *v) {
  const double *by = at->touch;
  for (int i = 0; i < s->grounds; ++i)
    for (int contact = 0; contact < s->ground[i].count; ++contact, by += D * N(TOUCH)) {
      const int node = s->ground[i].node[contact];
      double to[N(TOUCH)];
      N(transposed)(by, D, f + node, N(TOUCH), to);
      for (int k = 0; k < D; ++k) p[node + k] += to[k], v[node + k] += to[D + k];
      for (int m = 0; m < GROUND_NUMBERS && c->ground; ++m)
        c->ground[GROUND_NUMBERS * i + m] += to[2 * D + m];
    }
}

INLINE void N(pulled_backward)(const Scene *s, const Point *at, int stage, Changes *c,
                               const double *f, double *p, double *v, double *of_length,
                               double *of_gamma, double *of_segment) {
  const int has_lengths = s->law != FORCE_DENSITY_HELD || s->clustered;
  double *of_input = c->input ? c->input + stage * s->strings : 0;
  memset(of_length, 0, s->strings * sizeof *of_length);
  memset(of_gamma, 0, s->strings * sizeof *of_gamma);
  for (int i = 0; i < s->segments; ++i) {
    const int start = s->segment_start[i], end = s->segment_end[i], string = s->segment_string[i];
    double of_weight = 0, of_S[D];
    for (int k = 0; k < D; ++k) {
      const double pull = f[start + k] - f[end + k];
      of_weight += at->S[D * i + k] * pull;
      of_S[k] = at->weight[i] * pull;
    }
    N(spread_difference)(of_S, start, end, p);
    of_segment[i] = 0;
    if (!s->clustered) {
      of_gamma[string] += of_weight;
      continue;
    }
    of_gamma[string] += of_weight * at->string_length[string] / at->length[i];
    of_length[string] += of_weight * at->gamma[string] / at->length[i];
    of_segment[i] = -of_weight * at->weight[i] / at->length[i];
  }
  for (int i = 0; i < s->strings; ++i) {
    const double *by = at->by + STRING_SLOPES * i;
    of_length[i] += by[BY_LENGTH] * of_gamma[i];
    if (of_input) of_input[i] = by[BY_REST] * of_gamma[i];
    if (c->stiffness) c->stiffness[i] += by[BY_STIFFNESS] * of_gamma[i];
    if (c->damping) c->damping[i] += by[BY_DAMPING] * of_gamma[i];
  }
  for (int i = 0; i < s->segments && has_lengths; ++i) {
    const int start = s->segment_start[i], end = s->segment_end[i], string = s->segment_string[i];
    const double *S = at->S + D * i, *Sd = at->Sd + D * i, inverse = 1 / at->length[i];
    const double of_rate = at->by[STRING_SLOPES * string + BY_RATE] * of_gamma[string];
    const double own = of_segment[i] + of_length[string] - of_rate * at->rate[i] * inverse;
    double of_S[D], of_Sd[D];
    for (int k = 0; k < D; ++k) {
      of_S[k] = (own * S[k] + of_rate * Sd[k]) * inverse;
      of_Sd[k] = of_rate * S[k] * inverse;
    }
    N(spread_difference)(of_S, start, end, p);
    N(spread_difference)(of_Sd, start, end, v);
  }
}

/* A cost by the vector and rate of a bar on its length becomes that by those before. */
static inline void N(restore_costs)(const N(Restored) *bar, double *of_b, double *of_r) {
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
static void N(restored_backward)(const Scene *s, const Lengths *lengths, const double *x,
                                 double *mu) {
  for (int i = 0; i < s->free_bars; ++i) {
    const N(Restored) bar = N(restored_free)(s, lengths, i, x);
    double *a = mu + s->bar_row[2 * i], *b = mu + s->bar_row[2 * i + 1], of[2][D], sum[2][D];
    for (int m = 0; m < 2; ++m)
      for (int k = 0; k < D; ++k) {
        of[m][k] = (b[m * s->free + k] - a[m * s->free + k]) / 2;
        sum[m][k] = (b[m * s->free + k] + a[m * s->free + k]) / 2;
      }
    N(restore_costs)(&bar, of[0], of[1]);
    for (int m = 0; m < 2; ++m)
      for (int k = 0; k < D; ++k) {
        a[m * s->free + k] = sum[m][k] - of[m][k];
        b[m * s->free + k] = sum[m][k] + of[m][k];
      }
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const N(Restored) bar = N(restored_swinging)(s, lengths, i, x);
    N(restore_costs)(&bar, mu + s->tip_row[i], mu + s->tip_row[i] + s->free);
  }
}

/* The cost by the state, (states), of one by the accelerations, (free). */
INLINE void N(backward)(const Scene *s, const Point *at, int stage, Changes *c, const double *cost,
                        double *to, double *work) {
  const int n = s->entries;
  double *p = work, *v = p + n, *f = v + n, *a = f + n, *of_length = a + n;
  double *of_gamma = of_length + s->strings, *of_segment = of_gamma + s->strings;
  memset(p, 0, 3 * (size_t)n * sizeof *p);
  to_all(s, cost, 0, a);
  N(accelerated_backward)(s, at, a, p, v, f, of_segment + s->segments);
  if (s->free_row) { /* what supports hold takes all forces */
    to_all(s, cost, 0, a);
    for (int i = 0; i < s->free; ++i) a[s->free_row[i]] = f[s->free_row[i]];
    memcpy(f, a, n * sizeof *f);
  }
  for (int i = 0; i < n && c->load; ++i) c->load[i] += f[i];
  N(weighed_backward)(s, at, c, f);
  N(touched_backward)(s, at, c, f, p, v);
  if (s->segments)
    N(pulled_backward)(s, at, stage, c, f, p, v, of_length, of_gamma, of_segment);
  for (int i = 0; i < s->free; ++i) {
    const int row = s->free_row ? s->free_row[i] : i;
    to[i] = p[row];
    to[s->free + i] = v[row];
  }
}

#undef NAME_
#undef NAME2
#undef N
