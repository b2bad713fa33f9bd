/* The equation of motion in D dimensions: included by equation.c, once for each. */

#define NAME_(name, d) name##_##d
#define NAME2(name, d) NAME_(name, d)
#define N(name) NAME2(name, D)

static inline void N(difference)(const Number *from, int start, int end, Number *to) {
  Number apart[D];
  for (int k = 0; k < D; ++k) apart[k] = from[end + k] - from[start + k];
  for (int k = 0; k < D; ++k) to[k] = apart[k];
}

/* The vectors of segments, or their rates, one after another. Compilers that would gather entries from
   several segments into one register take longer; they do not, as S is not known to be elsewhere. */
static void N(differences)(const Scene *s, const Number *p, Number *S) {
  const int count = s->segments;
  const int32_t *start = s->segment_start, *end = s->segment_end;
  for (int i = 0; i < count; ++i) N(difference)(p, start[i], end[i], S + D * i);
}

/* Lengths of segments. */
WIDE static void N(lengths)(const Scene *s, const Number *restrict S, const Number *restrict rest,
                            Number *restrict length) {
  const int count = s->segments;
  if (s->clustered) {
    const Number least = all(s->shortest * s->shortest);
    for (int i = 0; i < count; ++i) {
      Number square = all(0);
      for (int k = 0; k < D; ++k) square += S[D * i + k] * S[D * i + k];
      length[i] = root(larger(square, least));
    }
    return;
  }
  for (int i = 0; i < count; ++i) N(pulling_length)(S + D * i, rest[i], length + i);
}

WIDE static void N(length_rates)(const Scene *s, const Number *restrict changes, const Number *restrict S,
                                 const Number *restrict length, Number *restrict rate) {
  const int count = s->segments;
  for (int i = 0; i < count; ++i) N(length_rate)(S + D * i, changes + D * i, length[i], rate + i);
}

/* Adds the pull of the strings from one on to the forces on nodes, string by string: of runs in lanes,
   which need not keep what is between. By the same operations as that below. The force on a node that
   strings begin at one after another stays in registers: numbers that are stored and read again wait
   for each other. */
static void N(pull_one_by_one)(const Scene *s, int first, const Number *p, const Number *v, const Number *u,
                               const Number *taut, Number *restrict f) {
  const int is_held = s->law == FORCE_DENSITY_HELD;
  for (int i = first; i < s->segments;) {
    const int start = s->segment_start[i];
    Number force[D];
    for (int k = 0; k < D; ++k) force[k] = f[start + k];
    do {
      const int end = s->segment_end[i];
      Number one[D], change[D], length, rate = all(0), gamma = u[i];
      N(difference)(p, start, end, one);
      if (!is_held) {
        const Number k = numbers(s->stiffness)[i], c = numbers(s->damping)[i];
        N(pulling_length)(one, u[i], &length);
        if (s->damped) {
          N(difference)(v, start, end, change);
          N(length_rate)(one, change, length, &rate);
        }
        gamma = force_density(law_of(s), k, c, length, rate, u[i]);
        gamma *= taut ? taut[i] : truth(string_gap(law_of(s), k, c, length, rate, u[i]) > 0);
      }
      for (int k = 0; k < D; ++k) {
        force[k] += one[k] * gamma;
        f[end + k] -= one[k] * gamma;
      }
    } while (++i < s->segments && s->segment_start[i] == start);
    for (int k = 0; k < D; ++k) f[start + k] = force[k];
  }
}

/* Adds the pull of the strings to the forces on nodes. */
static void N(pull)(const Scene *s, const Number *p, const Number *v, const Number *u, const Number *taut,
                    Number *restrict f, const Work *w) {
  const int count = s->segments;
  const int32_t *restrict start = s->segment_start, *restrict end = s->segment_end;
  Number *restrict S = w->S, *restrict length = w->length, *restrict rate = w->rate;
  Number *restrict gamma = w->gamma;
  const int is_held = s->law == FORCE_DENSITY_HELD;
  if (WIDTH > 1 && !s->clustered) {
    N(pull_one_by_one)(s, 0, p, v, u, taut, f);
    return;
  }
  N(differences)(s, p, S);
  if (!is_held || s->clustered) N(lengths)(s, S, u, length);
  if (!is_held && s->damped) {
    N(differences)(s, v, w->changes);
    N(length_rates)(s, w->changes, S, length, rate);
  }
  if (s->clustered) {
    sum_by_string(s, length, w->string_length);
    if (!is_held && s->damped) sum_by_string(s, rate, w->string_rate);
    taut = pulling(s, w->string_length, w->string_rate, u, taut, w->string_taut);
    force_densities(s, w->string_length, w->string_rate, u, taut, w->string_gamma);
    for (int i = 0; i < count; ++i) {
      const int j = s->segment_string[i];
      gamma[i] = w->string_gamma[j] * w->string_length[j] / length[i];
    }
  } else {
    taut = pulling(s, length, rate, u, taut, w->string_taut);
    force_densities(s, length, rate, u, taut, gamma);
  }
  for (int i = 0; i < count; ++i) {
    Number *on_start = f + start[i], *on_end = f + end[i];
    Number pulled[D], held[D];
    for (int k = 0; k < D; ++k) {
      const Number pull = S[D * i + k] * gamma[i];
      pulled[k] = on_start[k] + pull;
      held[k] = on_end[k] - pull;
    }
    for (int k = 0; k < D; ++k) on_start[k] = pulled[k];
    for (int k = 0; k < D; ++k) on_end[k] = held[k];
  }
}

static void N(touch)(const Scene *s, int plane, const Number *p, const Number *v, const Number *taut,
                     Number *f) {
  const Ground *g = s->ground + plane;
  const Number *own = numbers(s->ground_numbers) + GROUND_NUMBERS * plane;
  Number normal[D];
  for (int j = 0; j < D; ++j) normal[j] = all(g->normal[j]);
  for (int i = 0; i < g->count; ++i) {
    const int at = g->node[i];
    Number depth, rate, press, force[D], presses = taut ? taut[i] : all(1);
    if (!any(presses != 0)) continue;
    N(sinking)(p + at, v + at, own[4], normal, &depth, &rate);
    if (!taut && g->first_switch >= 0) {
      ground_gap(depth, rate, own[1], &presses);
      presses = truth(presses > 0);
      if (!any(presses != 0)) continue;
    }
    switch (g->kind) {
    case LINEAR_GROUND: linear_press(depth, rate, own[0], own[1], presses, &press); break;
    case HERTZ_GROUND: hertz_press(depth, rate, own[0], own[1], presses, &press); break;
    default: smooth_press(depth, rate, own[0], own[1], own[5], &press);
    }
    N(ground_force)(press, v + at, own[2], own[3], normal, force);
    for (int j = 0; j < D; ++j) f[at + j] += force[j];
  }
}

static void N(forces)(const Scene *s, const Number *p, const Number *v, const Input *input,
                      const Number *taut, Number *f, const Work *w) {
  const Number *load = input->load ? input->load : numbers(s->load), *u = input->strings;
  if (TAKES_SEVERAL && !s->clustered) {
    const int done = N(pull_by_avx2)(s, p, v, u, taut, load, f, w->rows);
    N(pull_one_by_one)(s, done, p, v, u, taut, f);
  } else {
    if (load) memcpy(f, load, s->entries * sizeof *f);
    else memset(f, 0, s->entries * sizeof *f);
    if (s->segments) N(pull)(s, p, v, u, taut, f, w);
  }
  for (int i = 0; i < s->grounds; ++i) {
    const int first = s->ground[i].first_switch;
    N(touch)(s, i, p, v, first < 0 || !taut ? 0 : taut + s->slacking + first, f);
  }
}

static void N(coupled)(const Scene *s, const Number *p, const Number *v, const Number *f,
                       const Number *extension, Number *a, const Work *w) {
  Number *K = w->factors, *y = w->unknowns;
  memcpy(K, s->block_mass, (s->factors + s->unknowns + 1) * sizeof *K);
  for (int i = 0; i < s->block_rows; ++i) y[s->block_place[i]] = f[s->block_row[i]];
  for (int i = 0; i < s->block_bars; ++i) {
    Number bar[D], rate[D];
    N(difference)(p, s->block_start[i], s->block_end[i], bar);
    N(difference)(v, s->block_start[i], s->block_end[i], rate);
    for (int k = 0; k < D; ++k) {
      K[s->entry_end[D * i + k]] = bar[k];
      K[s->entry_start[D * i + k]] = -bar[k];
    }
    N(coupled_bar)(rate, extension ? extension[s->block_bar[i]] : all(0), y + s->right_place[i]);
  }
  factorize(s, K);
  solve(s, K, y);
  for (int i = 0; i < s->block_rows; ++i) a[s->block_row[i]] = y[s->block_place[i]];
}

/* Accelerations of the ends of free bars that share no nodes. */
static void N(free_bars)(const Scene *s, const Number *restrict p, const Number *restrict v,
                         const Number *restrict f, const Number *restrict extension, Number *restrict a) {
  for (int i = TAKES_SEVERAL ? N(free_bars_by_avx2)(s, p, v, f, extension, a) : 0; i < s->free_bars; ++i) {
    const int start = s->bar_start[i], end = s->bar_end[i];
    Number bar[D], rate[D];
    N(difference)(p, start, end, bar);
    N(difference)(v, start, end, rate);
    N(free_bar)(bar, rate, extension ? extension[s->free_bar[i]] : all(0), f + start, f + end,
                numbers(s->bar_constants) + FREE_BAR_2_CONSTANTS * i, a + start, a + end);
  }
}

/* The same of the tips of bars at hinges. */
static void N(swinging_bars)(const Scene *s, const Number *restrict p, const Number *restrict v,
                             const Number *restrict f, const Number *restrict extension, Number *restrict a) {
  for (int i = 0; i < s->swinging_bars; ++i) {
    Number bar[D], rate[D];
    N(difference)(p, s->hinge[i], s->tip[i], bar);
    N(difference)(v, s->hinge[i], s->tip[i], rate);
    N(swinging_bar)(bar, rate, extension ? extension[s->swinging_bar[i]] : all(0), f + s->tip[i],
                    numbers(s->tip_constants) + SWINGING_BAR_2_CONSTANTS * i, a + s->tip[i]);
  }
}

/* Accelerations of all entries; those that supports hold are left as they are. `extension` is null
   where lengths of bars are constant. */
static void N(accelerations)(const Scene *s, const Number *restrict p, const Number *restrict v,
                             const Number *restrict f, const Number *restrict extension, Number *restrict a,
                             const Work *w) {
  N(free_bars)(s, p, v, f, extension, a);
  N(swinging_bars)(s, p, v, f, extension, a);
  for (int i = 0; i < s->points; ++i)
    for (int k = 0; k < D; ++k) a[s->point[i] + k] = f[s->point[i] + k] * numbers(s->point_inverse_mass)[i];
  if (s->block_bars) N(coupled)(s, p, v, f, extension, a, w);
}

/* Force densities of driven bars, after their accelerations, which leave those of bars that share nodes
   among the unknowns. */
static void N(bar_densities)(const Scene *s, const Number *p, const Number *v, const Number *f,
                             const Number *extension, Number *density, const Work *w) {
  Number bar[D], rate[D];
  memset(density, 0, s->bars * sizeof *density);
  for (int i = 0; i < s->free_bars; ++i) {
    const int start = s->bar_start[i], end = s->bar_end[i], j = s->free_bar[i];
    N(difference)(p, start, end, bar);
    N(difference)(v, start, end, rate);
    N(free_bar_force_density)(bar, rate, extension[j], f + start, f + end, all(s->bar_mass[j]), density + j);
  }
  for (int i = 0; i < s->swinging_bars; ++i) {
    const int tip = s->tip[i], j = s->swinging_bar[i];
    N(difference)(p, s->hinge[i], tip, bar);
    N(difference)(v, s->hinge[i], tip, rate);
    N(swinging_bar_force_density)(bar, rate, extension[j], f + tip, all(s->bar_mass[j]), density + j);
  }
  for (int i = 0; i < s->block_bars; ++i) density[s->block_bar[i]] = -w->unknowns[s->right_place[i]];
}

/* Adds the pull of some strings by each of their weights. */
static void N(pull_by)(const Scene *s, const Number *p, const Number *v, const Number *u, const Some *some,
                       int count, const Number *weights, Number **forces) {
  for (int j = 0; j < some->count && some->which[j] < s->slacking; ++j) {
    const int i = some->which[j], start = s->segment_start[i], end = s->segment_end[i];
    const Number stiffness = numbers(s->stiffness)[i], damping = numbers(s->damping)[i];
    Number segment[D], change[D], length, rate, gamma;
    N(difference)(p, start, end, segment);
    N(difference)(v, start, end, change);
    N(pulling_length)(segment, u[i], &length);
    N(length_rate)(segment, change, length, &rate);
    gamma = force_density(law_of(s), stiffness, damping, length, rate, u[i]);
    for (int m = 0; m < count; ++m) {
      const Number pull = weights[m * s->switches + i] * gamma;
      for (int k = 0; k < D; ++k) {
        forces[m][start + k] += pull * segment[k];
        forces[m][end + k] -= pull * segment[k];
      }
    }
  }
}

/* Forces of what switches, counted by each of its weights. */
static void N(weighed)(const Scene *s, const Number *ends, const Number *rates, const Number *u,
                       const Some *some, int count, const Number *weights, Number **forces, const Work *w) {
  for (int m = 0; m < count; ++m) memset(forces[m], 0, s->entries * sizeof(Number));
  if (s->slacking && !s->clustered) N(pull_by)(s, ends, rates, u, some, count, weights, forces);
  for (int m = 0; m < count; ++m) {
    const Number *own = weights + m * s->switches;
    if (s->slacking && s->clustered) N(pull)(s, ends, rates, u, own, forces[m], w);
    for (int i = 0; i < s->grounds; ++i)
      if (s->ground[i].first_switch >= 0)
        N(touch)(s, i, ends, rates, own + s->slacking + s->ground[i].first_switch, forces[m]);
  }
}

/* The gap of one string, and its rate where rates are asked for. */
static inline void N(gap_of_string)(const Scene *s, int i, const Number *p, const Number *v, const Number *u,
                                    Number *gap, Number *rate) {
  const int start = s->segment_start[i], end = s->segment_end[i];
  const Number k = numbers(s->stiffness)[i], c = numbers(s->damping)[i];
  Number segment[D], change[D], length;
  N(difference)(p, start, end, segment);
  N(pulling_length)(segment, u[i], &length);
  if (rate) {
    N(difference)(v, start, end, change);
    N(length_rate)(segment, change, length, rate + i);
  }
  gap[i] = string_gap(law_of(s), k, c, length, rate ? rate[i] : all(0), u[i]);
}

/* Gaps of some strings. */
static void N(gaps_of)(const Scene *s, const Number *p, const Number *v, const Number *u, const Some *some,
                       Number *gap, Number *rate) {
  for (int j = 0; j < some->count && some->which[j] < s->slacking; ++j)
    N(gap_of_string)(s, some->which[j], p, v, u, gap, rate);
}

static void N(gaps)(const Scene *s, const Number *p, const Number *v, const Number *u, const Some *some,
                    Number *gap, Number *rate, const Work *w) {
  if (s->slacking && some && !s->clustered) {
    N(gaps_of)(s, p, v, u, some, gap, rate);
  } else if (s->slacking && TAKES_SEVERAL && !s->clustered) {
    for (int i = N(gaps_by_avx2)(s, p, v, u, gap, rate); i < s->slacking; ++i)
      N(gap_of_string)(s, i, p, v, u, gap, rate);
  } else if (s->slacking) {
    Number *length = w->length, *change = s->clustered ? w->rate : rate;
    N(differences)(s, p, w->S);
    N(lengths)(s, w->S, u, length);
    if (rate) {
      N(differences)(s, v, w->changes);
      N(length_rates)(s, w->changes, w->S, length, change);
    }
    if (s->clustered) {
      sum_by_string(s, length, w->string_length);
      if (rate) sum_by_string(s, change, rate);
      length = w->string_length;
    }
    string_gaps(s, length, rate, u, gap);
  }
  for (int i = 0; i < s->grounds; ++i) {
    const Ground *g = s->ground + i;
    const Number *own = numbers(s->ground_numbers) + GROUND_NUMBERS * i;
    const int first = s->slacking + g->first_switch, count = some ? some->count : g->count;
    Number normal[D];
    if (g->first_switch < 0) continue;
    for (int j = 0; j < D; ++j) normal[j] = all(g->normal[j]);
    for (int j = 0; j < count; ++j) {
      const int at = some ? some->which[j] : first + j;
      Number depth, sinking;
      if (at < first || at >= first + g->count) continue;
      N(sinking)(p + g->node[at - first], v + g->node[at - first], own[4], normal, &depth, &sinking);
      ground_gap(depth, sinking, own[1], gap + at);
      if (rate) rate[at] = sinking;
    }
  }
}

#undef NAME_
#undef NAME2
#undef N
