/* A motion of point masses and rigid bars in node coordinates, every switch located.
 *
 * Lagrange's equations of the first kind, solved by a dense Cholesky factor in every evaluation, and
 * the Dormand-Prince method of order 8. All arrays belong to the caller; positions in m, node by
 * node (x y z x ...), of d components each. Called by located_motion.py, which says what the fields
 * mean. Not part of the package, and shares nothing with it.
 */

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { STAGES = 12, ALL_STAGES = 16, POWERS = 7, SAMPLES = 11 };
enum { DONE = 0, TOO_MANY_EVALUATIONS = 1, STEP_TOO_SMALL = 2, NOT_FINITE = 3, STUCK = 4 };

/* Numbers of a plane: stiffness, damping, friction, slip speed, height, exponent and normal. */
typedef struct {
  double stiffness, damping, friction, slip_speed, height, exponent, normal[3];
} Plane;

typedef struct {
  int dimension, nodes, rows, bars, strings, planes, outputs, held_force_density;
  const int *row;                    /* (rows) place of each free coordinate in vec(N) */
  const int *bar;                    /* (bars, 2) independent bars */
  const int *first;                  /* (strings + 1) first segment of each string */
  const int *segment;                /* (segments, 2) */
  const int *touches;                /* (planes, nodes) whether a plane acts on a node */
  const double *inverse;             /* (rows, rows) inverse of the mass matrix, 1/kg */
  const double *load;                /* (nodes, d) N */
  const double *held;                /* (strings) rest length, m, or force density, N/m */
  const double *stiffness, *damping; /* (strings) N/m, N s/m */
  const Plane *plane;
  const double *a, *b, *c, *e3, *e5, *d; /* coefficients of the method */
  const double *times;                   /* (outputs) ascending, from 0, s */
  double size, tolerance;
  long most_evaluations;
  double *moments; /* (most_moments) of the first switches, s */
  long most_moments;
} Scene;

typedef struct {
  long evaluations, steps, rejections, switches;
} Counts;

typedef struct {
  const Scene *scene;
  Counts *counts;
  int states, borders;
  double *N, *V, *F, *J, *JW, *G, *lambda; /* of an evaluation */
  double *K, *y_new, *y_try, *dense;       /* of a step */
  double *gaps, *rooms;                    /* of each border, and at each sample of a step */
  int *pulls, *free; /* of each border; and place of each coordinate among the free, or -1 */
} Work;

static void place(Work *w, const double *y) {
  const Scene *s = w->scene;
  for (int i = 0; i < s->rows; i++) {
    w->N[s->row[i]] = y[i];
    w->V[s->row[i]] = y[s->rows + i];
  }
}

static double segment(const Work *w, int k, double *S, double *rate) {
  const int d = w->scene->dimension, *ends = w->scene->segment + 2 * k;
  double square = 0, along = 0;
  for (int j = 0; j < d; j++) {
    S[j] = w->N[d * ends[1] + j] - w->N[d * ends[0] + j];
    square += S[j] * S[j];
    along += S[j] * (w->V[d * ends[1] + j] - w->V[d * ends[0] + j]);
  }
  const double length = sqrt(square);
  *rate = length > 0 ? along / length : 0;
  return length;
}

static double string_length(const Work *w, int i, double *rate) {
  double length = 0, part, S[3];
  *rate = 0;
  for (int k = w->scene->first[i]; k < w->scene->first[i + 1]; k++) {
    length += segment(w, k, S, &part);
    *rate += part;
  }
  return length;
}

static double depth_of(const Work *w, const Plane *plane, int node, double *rate) {
  const int d = w->scene->dimension;
  double depth = plane->height;
  *rate = 0;
  for (int j = 0; j < d; j++) {
    depth -= plane->normal[j] * w->N[d * node + j];
    *rate -= plane->normal[j] * w->V[d * node + j];
  }
  return depth;
}

/* How far each string pulls and each node presses, m, positive where it does. */
static void borders(Work *w, const double *y, double *gap) {
  const Scene *s = w->scene;
  double rate;
  int at = 0;
  place(w, y);
  if (!s->held_force_density)
    for (int i = 0; i < s->strings; i++) {
      const double stretch = string_length(w, i, &rate) - s->held[i];
      gap[at++] = fmin(stretch, stretch + s->damping[i] / s->stiffness[i] * rate);
    }
  for (int p = 0; p < s->planes; p++)
    for (int node = 0; node < s->nodes; node++) {
      if (!s->touches[p * s->nodes + node]) continue;
      const double depth = depth_of(w, s->plane + p, node, &rate);
      gap[at++] = fmin(depth, s->size * (1 + s->plane[p].damping * rate));
    }
}

static void pull(Work *w) {
  const Scene *s = w->scene;
  const int d = s->dimension;
  for (int i = 0; i < s->strings; i++) {
    if (!s->held_force_density && !w->pulls[i]) continue;
    double rate, part, S[3], gamma = s->held[i], tension = 0;
    const int straight = s->first[i + 1] - s->first[i] == 1;
    const double length = string_length(w, i, &rate);
    if (!s->held_force_density) {
      tension = s->stiffness[i] * (length - s->held[i]) + s->damping[i] * rate;
      gamma = tension / length;
    } else tension = gamma * length;
    for (int k = s->first[i]; k < s->first[i + 1]; k++) {
      const double along = segment(w, k, S, &part);
      const double density = straight ? gamma : tension / along;
      for (int j = 0; j < d; j++) {
        w->F[d * s->segment[2 * k] + j] += density * S[j];
        w->F[d * s->segment[2 * k + 1] + j] -= density * S[j];
      }
    }
  }
}

static void press(Work *w) {
  const Scene *s = w->scene;
  const int d = s->dimension;
  int at = s->held_force_density ? 0 : s->strings;
  for (int p = 0; p < s->planes; p++)
    for (int node = 0; node < s->nodes; node++) {
      if (!s->touches[p * s->nodes + node] || !w->pulls[at++]) continue;
      const Plane *plane = s->plane + p;
      double rate, slip[3], square = plane->slip_speed * plane->slip_speed;
      const double depth = depth_of(w, plane, node, &rate);
      const double size = copysign(pow(fabs(depth), plane->exponent), depth);
      const double force = plane->stiffness * size * (1 + plane->damping * rate);
      for (int j = 0; j < d; j++) {
        slip[j] = w->V[d * node + j] + rate * plane->normal[j];
        square += slip[j] * slip[j];
      }
      const double drag = plane->friction * force / sqrt(square);
      for (int j = 0; j < d; j++) w->F[d * node + j] += force * plane->normal[j] - drag * slip[j];
    }
}

/* dy/dt for the strings that pull and the nodes that press: J W F' - (J W J') lambda = -|b'|^2. */
static void slope(Work *w, const double *y, double *out) {
  const Scene *s = w->scene;
  const int d = s->dimension, rows = s->rows, bars = s->bars;
  double *acceleration = out + rows;
  w->counts->evaluations++;
  place(w, y);
  memcpy(w->F, s->load, sizeof(double) * (size_t)(s->nodes * d));
  pull(w);
  press(w);
  memcpy(out, y + rows, sizeof(double) * (size_t)rows);
  for (int i = 0; i < rows; i++) {
    acceleration[i] = 0;
    for (int j = 0; j < rows; j++) acceleration[i] += s->inverse[i * rows + j] * w->F[s->row[j]];
  }
  if (bars == 0) return;
  for (int i = 0; i < bars; i++) {
    double square = 0, *JW = w->JW + i * rows;
    memset(JW, 0, sizeof(double) * (size_t)rows);
    w->lambda[i] = 0;
    for (int at = 0; at < 2 * d; at++) {
      const int node = s->bar[2 * i + at / d], axis = at % d;
      const int other = s->bar[2 * i + 1 - at / d], q = w->free[d * node + axis];
      const double b = w->N[d * node + axis] - w->N[d * other + axis];
      const double v = w->V[d * node + axis] - w->V[d * other + axis];
      square += 0.5 * v * v;
      w->J[2 * d * i + at] = q < 0 ? 0 : b;
      if (q < 0) continue;
      for (int r = 0; r < rows; r++) JW[r] += b * s->inverse[q * rows + r];
      w->lambda[i] -= b * acceleration[q];
    }
    w->lambda[i] -= square;
  }
  double *G = w->G;
  for (int i = 0; i < bars; i++)
    for (int k = 0; k <= i; k++) {
      double sum = 0;
      for (int at = 0; at < 2 * d; at++) {
        const int q = w->free[d * s->bar[2 * k + at / d] + at % d];
        if (q >= 0) sum += w->JW[i * rows + q] * w->J[2 * d * k + at];
      }
      for (int q = 0; q < k; q++) sum -= G[i * bars + q] * G[k * bars + q];
      G[i * bars + k] = i == k ? sqrt(sum) : sum / G[k * bars + k];
    }
  for (int i = 0; i < bars; i++) {
    for (int k = 0; k < i; k++) w->lambda[i] -= G[i * bars + k] * w->lambda[k];
    w->lambda[i] /= G[i * bars + i];
  }
  for (int i = bars - 1; i >= 0; i--) {
    for (int k = i + 1; k < bars; k++) w->lambda[i] -= G[k * bars + i] * w->lambda[k];
    w->lambda[i] /= G[i * bars + i];
  }
  for (int i = 0; i < bars; i++)
    for (int r = 0; r < rows; r++) acceleration[r] += w->JW[i * rows + r] * w->lambda[i];
}

static void stages(Work *w, const double *y, double h, int from, int to) {
  const Scene *s = w->scene;
  const int n = w->states;
  for (int k = from; k < to; k++) {
    memcpy(w->y_try, y, sizeof(double) * (size_t)n);
    for (int j = 0; j < k; j++) {
      const double a = h * s->a[ALL_STAGES * k + j];
      if (a != 0)
        for (int i = 0; i < n; i++) w->y_try[i] += a * w->K[j * n + i];
    }
    slope(w, w->y_try, w->K + k * n);
  }
}

/* A step from y, whose slope is in K, into y_new. */
static void step(Work *w, const double *y, double h) {
  const int n = w->states;
  stages(w, y, h, 1, STAGES);
  memcpy(w->y_new, y, sizeof(double) * (size_t)n);
  for (int j = 0; j < STAGES; j++)
    for (int i = 0; i < n; i++) w->y_new[i] += h * w->scene->b[j] * w->K[j * n + i];
}

static double error_of(const Work *w, double h, double speed) {
  const Scene *s = w->scene;
  const int n = w->states;
  double five = 0, three = 0;
  for (int i = 0; i < n; i++) {
    const double scale = s->tolerance * (i < s->rows ? s->size : speed);
    double of5 = 0, of3 = 0;
    for (int j = 0; j <= STAGES; j++) {
      of5 += s->e5[j] * w->K[j * n + i];
      of3 += s->e3[j] * w->K[j * n + i];
    }
    five += of5 * of5 / (scale * scale);
    three += of3 * of3 / (scale * scale);
  }
  if (five == 0 && three == 0) return 0;
  return fabs(h) * five / sqrt((five + 0.01 * three) * n);
}

/* Coefficients of the interpolant of order 7 of the step from y to y_new. */
static void interpolate(Work *w, const double *y, double h) {
  const Scene *s = w->scene;
  const int n = w->states;
  stages(w, y, h, STAGES + 1, ALL_STAGES);
  for (int i = 0; i < n; i++) {
    const double change = w->y_new[i] - y[i];
    w->dense[i] = change;
    w->dense[n + i] = h * w->K[i] - change;
    w->dense[2 * n + i] = 2 * change - h * (w->K[STAGES * n + i] + w->K[i]);
    for (int p = 0; p < 4; p++) {
      double sum = 0;
      for (int j = 0; j < ALL_STAGES; j++) sum += s->d[ALL_STAGES * p + j] * w->K[j * n + i];
      w->dense[(3 + p) * n + i] = h * sum;
    }
  }
}

static void between(const Work *w, const double *y, double theta, double *out) {
  const int n = w->states;
  for (int i = 0; i < n; i++) {
    double value = 0;
    for (int p = POWERS - 1; p >= 0; p--)
      value = (value + w->dense[p * n + i]) * (p % 2 == 0 ? theta : 1 - theta);
    out[i] = y[i] + value;
  }
}

static double room_of(const Work *w, const double *gap, int i) {
  return (w->pulls[i] ? gap[i] : -gap[i]) + 1e-12 * w->scene->size;
}

static double least_room(Work *w, const double *y) {
  double least = INFINITY;
  borders(w, y, w->gaps);
  for (int i = 0; i < w->borders; i++) least = fmin(least, room_of(w, w->gaps, i));
  return least;
}

static double room_at(Work *w, const double *y, double theta, int only) {
  between(w, y, theta, w->y_try);
  if (only < 0) return least_room(w, w->y_try);
  borders(w, w->y_try, w->gaps);
  return room_of(w, w->gaps, only);
}

/* Return the first crossing within the step, as part of it, or 2. A border that is passed and passed
 * back between two samples is found where it comes nearest, by a parabola. */
static double first_crossing(Work *w, const double *y) {
  static const double part[SAMPLES] = {0, 0.02, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 0.98, 1};
  double room[SAMPLES], low = 0, high = 2;
  double *all = w->rooms;
  for (int j = 0; j < SAMPLES; j++) {
    between(w, y, part[j], w->y_try);
    room[j] = least_room(w, w->y_try);
    for (int i = 0; i < w->borders; i++) all[j * w->borders + i] = room_of(w, w->gaps, i);
  }
  for (int j = 1; j < SAMPLES && high > 1; j++)
    if (room[j] < 0) {
      low = part[j - 1];
      high = part[j];
    }
  for (int i = 0; i < w->borders; i++)
    for (int j = 1; j < SAMPLES - 1 && part[j - 1] < high; j++) {
      const double left = all[(j - 1) * w->borders + i], mid = all[j * w->borders + i];
      const double right = all[(j + 1) * w->borders + i];
      if (mid >= left || mid >= right || mid < 0) continue;
      const double x0 = part[j - 1] - part[j], x1 = part[j + 1] - part[j];
      const double curve = ((right - mid) / x1 - (left - mid) / x0) / (x1 - x0);
      const double first = (right - mid) / x1 - curve * x1;
      if (mid - first * first / (4 * curve) > 0.5 * mid) continue;
      /* Golden section for the least room of this border. */
      double from = part[j - 1], to = part[j + 1];
      for (int turn = 0; turn < 60; turn++) {
        const double p = to - 0.618 * (to - from), q = from + 0.618 * (to - from);
        const double at_p = room_at(w, y, p, i), at_q = room_at(w, y, q, i);
        if (at_p < 0 || at_q < 0) {
          const double found = at_p < 0 ? p : q;
          if (found < high) {
            low = part[j - 1];
            high = found;
          }
          break;
        }
        if (at_p < at_q) to = q;
        else from = p;
      }
    }
  if (high > 1) return 2;
  for (int turn = 0; turn < 80 && high - low > 1e-15; turn++) {
    const double middle = 0.5 * (low + high);
    if (room_at(w, y, middle, -1) < 0) high = middle;
    else low = middle;
  }
  return high;
}

/* Step exactly to where the least room is zero: secants over whole steps of order 8. */
static double land(Work *w, const double *y, double h, double theta) {
  const double border = 1e-12 * w->scene->size;
  double before = 0, room_before = 0;
  for (int turn = 0; turn < 8; turn++) {
    step(w, y, theta * h);
    const double room = least_room(w, w->y_new);
    if (fabs(room) < 0.25 * border) break;
    double slant = (room_at(w, y, theta, -1) - room_at(w, y, theta * (1 - 1e-5), -1));
    slant /= 1e-5 * theta;
    if (turn > 0 && theta != before && room != room_before) slant = (room - room_before) / (theta - before);
    if (!(slant < 0)) break;
    before = theta;
    room_before = room;
    theta = fmin(fmax(theta - room / slant, 0.5 * theta), fmin(2 * theta, 1));
    if (theta == before) break;
  }
  return theta;
}

static int finite(const double *y, int n) {
  for (int i = 0; i < n; i++)
    if (!isfinite(y[i])) return 0;
  return 1;
}

static double fastest(const double *y, int rows, double most) {
  for (int i = 0; i < rows; i++) most = fmax(most, fabs(y[rows + i]));
  return most;
}

static int run(Work *w, double *y, double *out) {
  const Scene *s = w->scene;
  const int n = w->states, last = s->outputs - 1;
  const double border = 1e-12 * s->size, end = s->times[last];
  double t = 0, h = 1e-4 * end, speed, strongest = 0;
  int done = 1, stalls = 0;
  borders(w, y, w->gaps);
  for (int i = 0; i < w->borders; i++) w->pulls[i] = w->gaps[i] > 0;
  slope(w, y, w->K);
  for (int i = 0; i < s->rows; i++) strongest = fmax(strongest, fabs(w->K[s->rows + i]));
  speed = fastest(y, s->rows, 1e-3 * sqrt(s->size * strongest) + 1e-12 * s->size / end);
  memcpy(out, w->N, sizeof(double) * (size_t)(s->nodes * s->dimension));
  while (done < s->outputs) {
    if (w->counts->evaluations > s->most_evaluations) return TOO_MANY_EVALUATIONS;
    if (h < 1e-15 * end) return STEP_TOO_SMALL;
    const double rest = s->times[done] - t, tried = fmin(h, rest);
    step(w, y, tried);
    slope(w, w->y_new, w->K + STAGES * n);
    if (!finite(w->y_new, n) || !finite(w->K + STAGES * n, n)) {
      h = 0.1 * tried;
      w->counts->rejections++;
      slope(w, y, w->K);
      continue;
    }
    const double error = error_of(w, tried, speed);
    const double factor = fmin(6, fmax(0.2, 0.9 * pow(fmax(error, 1e-30), -1.0 / 8)));
    if (error > 1) {
      h = tried * factor;
      w->counts->rejections++;
      continue;
    }
    w->counts->steps++;
    double taken = tried, theta = 2;
    if (w->borders) {
      interpolate(w, y, tried);
      theta = first_crossing(w, y);
    }
    if (theta <= 1) {
      /* The stages from here on are those of shorter steps from the same slope. */
      taken = tried * land(w, y, tried, theta);
      least_room(w, w->y_new);
      int crossed = 0;
      for (int i = 0; i < w->borders; i++)
        if (room_of(w, w->gaps, i) < 0.5 * border) {
          w->pulls[i] = !w->pulls[i];
          crossed++;
        }
      if (crossed) {
        if (w->counts->switches < s->most_moments) s->moments[w->counts->switches] = t + taken;
        w->counts->switches++;
      }
      stalls = taken > 1e-14 * end ? 0 : stalls + 1;
      if (stalls > 200) return STUCK;
      slope(w, w->y_new, w->K);
      /* The next step may be as long as this one was allowed to be. */
      h = fmax(tried, h == tried ? tried * factor : h);
    } else {
      memcpy(w->K, w->K + STAGES * n, sizeof(double) * (size_t)n);
      h = tried < h ? fmax(h, tried * factor) : tried * factor;
      stalls = 0;
    }
    memcpy(y, w->y_new, sizeof(double) * (size_t)n);
    speed = fastest(y, s->rows, speed);
    if (theta > 1 && tried == rest) {
      t = s->times[done];
      place(w, y);
      memcpy(out + done * s->nodes * s->dimension, w->N, sizeof(double) * (size_t)(s->nodes * s->dimension));
      done++;
    } else t += taken;
  }
  return DONE;
}

static double *take(double **next, size_t count) {
  double *taken = *next;
  *next += count;
  return taken;
}

/* Write the nodes at the times into out, shape (outputs, nodes, d), from N and V, which change. */
int located_motion(const Scene *scene, double *N, double *V, double *out, Counts *counts) {
  const size_t rows = (size_t)scene->rows, bars = (size_t)scene->bars, n = 2 * rows;
  size_t flags = scene->held_force_density ? 0 : (size_t)scene->strings;
  for (int i = 0; i < scene->planes * scene->nodes; i++) flags += scene->touches[i] != 0;
  const size_t places = (size_t)(scene->nodes * scene->dimension);
  const size_t all = places + bars * rows + 6 * bars + bars * bars + bars + (ALL_STAGES + POWERS + 3) * n +
                     (SAMPLES + 1) * flags;
  double *memory = calloc(all + 1, sizeof(double)), *next = memory;
  int *pulls = calloc(flags + 1, sizeof(int)), *free_place = calloc(places, sizeof(int));
  if (memory == NULL || pulls == NULL || free_place == NULL) abort();
  Work w = {.scene = scene, .counts = counts, .states = (int)n, .borders = (int)flags};
  w.N = N;
  w.V = V;
  w.pulls = pulls;
  w.free = free_place;
  for (size_t i = 0; i < places; i++) free_place[i] = -1;
  for (int i = 0; i < scene->rows; i++) free_place[scene->row[i]] = i;
  w.F = take(&next, places);
  w.JW = take(&next, bars * rows);
  w.J = take(&next, 6 * bars);
  w.G = take(&next, bars * bars);
  w.lambda = take(&next, bars);
  w.K = take(&next, ALL_STAGES * n);
  w.dense = take(&next, POWERS * n);
  w.y_new = take(&next, n);
  w.y_try = take(&next, n);
  w.gaps = take(&next, flags);
  w.rooms = take(&next, SAMPLES * flags);
  double *y = take(&next, n);
  for (size_t i = 0; i < rows; i++) {
    y[i] = N[scene->row[i]];
    y[rows + i] = V[scene->row[i]];
  }
  const int status = run(&w, y, out);
  free(memory);
  free(pulls);
  free(free_place);
  return status;
}
