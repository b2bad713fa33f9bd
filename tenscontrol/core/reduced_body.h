/* Bars on their lengths along their axes, in D dimensions: included by reduced_lanes.h, once for each. */

#define NAME_(name, d) name##_##d
#define NAME2(name, d) NAME_(name, d)
#define N(name) NAME2(name, D)

/* Places and rates of all nodes from their displacements; of each bar by its vector and rate before, the
   derivatives of what it is stretched by, and of that of the rate but for the first of them by the rate. */
static void N(kept)(const Reduced *plant, const Number *moved, const Number *rates, Number *p, Number *v,
                    Number *slopes) {
  const int entries = plant->scene->entries;
  for (int i = 0; i < entries; ++i) p[i] = plant->place[i] + moved[i];
  memcpy(v, rates, entries * sizeof *v);
  for (int i = 0; i < plant->bars; ++i, slopes += 2 * D) {
    const int start = plant->end[2 * i], end = plant->end[2 * i + 1];
    const double *axis = plant->axis + D * i, *share = plant->share + 2 * i;
    Number bar[D], rate[D], along = all(0), turning = all(0), stretch, drift = all(0);
    Number left = all(plant->square[i]), reach;
    N(difference)(p, start, end, bar);
    N(difference)(v, start, end, rate);
    for (int k = 0; k < D; ++k) {
      along += axis[k] * bar[k];
      turning += axis[k] * rate[k];
    }
    for (int k = 0; k < D; ++k) {
      bar[k] -= along * axis[k];
      left -= bar[k] * bar[k];
    }
    reach = root(left);
    stretch = reach - along;
    for (int k = 0; k < D; ++k) {
      slopes[k] = -(bar[k] / reach + axis[k]);
      drift += slopes[k] * rate[k];
    }
    for (int k = 0; k < D; ++k) {
      slopes[D + k] = -(rate[k] + turning * slopes[k] + drift * (slopes[k] + axis[k])) / reach;
      p[start + k] -= share[0] * axis[k] * stretch;
      p[end + k] += share[1] * axis[k] * stretch;
      v[start + k] -= share[0] * axis[k] * drift;
      v[end + k] += share[1] * axis[k] * drift;
    }
  }
}

/* Changes of places and rates by those of displacements, which they are at first. */
static void N(kept_forward)(const Reduced *plant, const double *slopes, Number *p, Number *v) {
  for (int i = 0; i < plant->bars; ++i, slopes += 2 * D) {
    const int start = plant->end[2 * i], end = plant->end[2 * i + 1];
    const double *axis = plant->axis + D * i, *share = plant->share + 2 * i;
    Number bar[D], rate[D], stretch, drift;
    N(difference)(p, start, end, bar);
    N(difference)(v, start, end, rate);
    stretch = N(times)(slopes, bar);
    drift = N(times)(slopes + D, bar) + N(times)(slopes, rate);
    for (int k = 0; k < D; ++k) {
      const double to_start = share[0] * axis[k], to_end = share[1] * axis[k];
      p[start + k] -= to_start * stretch;
      p[end + k] += to_end * stretch;
      v[start + k] -= to_start * drift;
      v[end + k] += to_end * drift;
    }
  }
}

/* Force densities and tensions of strings at a point. Of segments their directions and how these turn, and
   of strings the derivatives of both by length, rate and what is held, follow one another in x. */
static void N(strings_at)(const Reduction *r, Number *density, Number *tension) {
  const Scene *s = &r->batch.scene;
  const Point *now = &r->now;
  Number *along = r->x, *turning = along + D * s->segments, *by = turning + D * s->segments;
  memset(now->string_length, 0, s->strings * sizeof(Number));
  memset(now->string_rate, 0, s->strings * sizeof(Number));
  for (int i = 0; i < s->segments; ++i, along += D, turning += D) {
    const int start = s->segment_start[i], end = s->segment_end[i], string = s->segment_string[i];
    Number S[D], Sd[D], length, rate;
    N(difference)(now->p, start, end, S);
    N(difference)(now->v, start, end, Sd);
    length = root(larger(N(product)(S, S), all(s->shortest * s->shortest)));
    for (int k = 0; k < D; ++k) along[k] = S[k] / length;
    rate = N(product)(along, Sd);
    for (int k = 0; k < D; ++k) turning[k] = (Sd[k] - rate * along[k]) / length;
    now->string_length[string] += length;
    now->string_rate[string] += rate;
  }
  for (int i = 0; i < s->strings; ++i, by += STRING_SLOPES) {
    const Number length = now->string_length[i], held = r->strings[i];
    Number slopes[5], gamma = held;
    memset(slopes, 0, sizeof slopes);
    if (s->law == FORCE_DENSITY_HELD) slopes[BY_REST] = all(1);
    else gamma = string_slopes(s, i, length, now->string_rate[i], held, r->taut[i], slopes);
    by[0] = slopes[BY_LENGTH];
    by[1] = slopes[BY_RATE];
    by[2] = slopes[BY_REST];
    for (int k = 0; k < 3; ++k) by[3 + k] = length * by[k];
    by[3] += gamma;
    density[i] = gamma;
    tension[i] = gamma * length;
  }
}

/* Changes of rows of strings by places, and by rates where they are damped, in a block of columns. */
static void N(strings_forward)(const Reduction *r, const double *x, const Rows *rows, Number *by_place,
                               Number *by_rate) {
  const Scene *s = r->plant->scene;
  const Point *now = &r->now;
  const double *along = x, *turning = x + D * s->segments, *by = turning + D * s->segments;
  memset(now->string_length, 0, s->strings * sizeof(Number));
  memset(now->string_rate, 0, s->strings * sizeof(Number));
  for (int i = 0; i < s->segments; ++i) {
    const int start = s->segment_start[i], end = s->segment_end[i], string = s->segment_string[i];
    Number S[D], rate = all(0);
    now->string_length[string] +=
        N(stretch_forward)(along + D * i, s->damped ? turning + D * i : 0, now->p + start, now->p + end,
                           now->v + start, now->v + end, S, &rate);
    now->string_rate[string] += rate;
  }
  for (int i = 0; i < s->strings; ++i, by += STRING_SLOPES) {
    const Number length = now->string_length[i], rate = now->string_rate[i];
    const int at[] = {rows->density, rows->tension};
    for (int k = 0; k < 2; ++k) {
      if (at[k] < 0) continue;
      by_place[at[k] + i] = by[3 * k] * length + by[3 * k + 1] * rate;
      by_rate[at[k] + i] = by[3 * k + 1] * length;
    }
  }
}

#undef NAME_
#undef NAME2
#undef N
