
/* ---- Kalman filter: iterated correction by gated readings, prediction ---- */

/* State at the moment that was measured, and its covariance, by rows. */
static double filter_state[FILTER_STATES], filter_covariance[FILTER_STATES * FILTER_STATES];

/*
 * Inputs since that moment, the oldest first, and the one that acted until then. Of lengths of bars,
 * those and then their rates, m/s.
 */
static double filter_inputs[FILTER_DELAY + 1][FILTER_KNOWN];
static double filter_previous[FILTER_KNOWN];
static int filter_waiting, filter_has_previous, filter_mostly_refused, filter_is_fresh;
static int filter_is_ready;

typedef struct {
  int passed[FILTER_READINGS];
  int any; /* whether a reading was used */
} Fit;

/* Work space. */
static double jacobian[FILTER_NUMBERS * FILTER_STATES], read_now[FILTER_NUMBERS];
static double gain_rows[FILTER_NUMBERS * FILTER_STATES]; /* C P, then S^-1 C P */
static double weight[FILTER_NUMBERS * FILTER_NUMBERS], spread_of[FILTER_NUMBERS * FILTER_NUMBERS];
static double variance_of[FILTER_NUMBERS];
static double of_state[FILTER_STATES * FILTER_STATES], product[FILTER_STATES * FILTER_STATES];
static double shape_nodes[CONTROLLER_COORDINATES], shape_velocities[CONTROLLER_COORDINATES];

static void call(int (*function)(const double **, double **, casadi_int *, double *, int), const double *z,
                 const double *u, double *first, double *second) {
  const double *given[CASADI_ARG] = {0};
  double *found[CASADI_RES] = {0};
  given[0] = z;
  given[1] = u;
  found[0] = first;
  found[1] = second;
  function(given, found, casadi_integers, casadi_numbers, 0);
}

/* Whether the coordinates reach the shape; its nodes are then in shape_nodes. */
static int reaches(const double *z, const double *held) {
  if (!all_finite(z, FILTER_STATES)) return 0;
  call(controller_shape, z, held, shape_nodes, shape_velocities);
  return all_finite(shape_nodes, CONTROLLER_COORDINATES);
}

/* Readings of a state, and their derivative; CasADi has it by columns. */
static void read_state(const double *z, const double *held) {
  call(controller_outputs, z, held, read_now, jacobian);
}

#if FILTER_ROLLS
/*
 * Turn of the frame that the state is in, by rows, and the lowest node, which stands on the ground
 * at pose_touch.
 */
static double pose_turn[DIMENSION * DIMENSION], pose_touch[DIMENSION];
static int pose_lowest;

/* y = A x, or A' x */
static void turn_vector(const double *A, int transposed, const double *x, double *y) {
  int i, j;
  for (i = 0; i < DIMENSION; i++) {
    y[i] = 0.0;
    for (j = 0; j < DIMENSION; j++) y[i] += A[transposed ? j * DIMENSION + i : i * DIMENSION + j] * x[j];
  }
}

/* C = A B, or A' B */
static void multiply(const double *A, int transposed, const double *B, double *C) {
  int i, j, k;
  for (i = 0; i < DIMENSION; i++)
    for (j = 0; j < DIMENSION; j++) {
      double sum = 0.0;
      for (k = 0; k < DIMENSION; k++)
        sum += A[transposed ? k * DIMENSION + i : i * DIMENSION + k] * B[k * DIMENSION + j];
      C[i * DIMENSION + j] = sum;
    }
}

/* Vectors that were read, as they are in the frame; one that is not finite stays so. */
static void read_in_frame(double *y) {
  int i;
  for (i = 0; i < FRAME_VECTORS; i++) {
    double vector[DIMENSION];
    copy(vector, y + frame_vector[i], DIMENSION);
    if (all_finite(vector, DIMENSION)) turn_vector(pose_turn, 1, vector, y + frame_vector[i]);
  }
}

/* The rotation by a vector of angles (Rodrigues); in the plane by one angle. */
static void rotation(const double *angles, double *step) {
  double K[DIMENSION * DIMENSION] = {0}, square[DIMENSION * DIMENSION], size = 0.0;
  double first = 1.0, second = 0.5;
  int i;
  for (i = 0; i < FRAME_ANGLES; i++) size += angles[i] * angles[i];
  size = sqrt(size);
  if (size > 0.0) {
    first = sin(size) / size;
    second = sin(size / 2) / size;
    second = 2 * second * second;
  }
#if DIMENSION == 3
  K[1] = -(K[3] = angles[2]);
  K[6] = -(K[2] = angles[1]);
  K[5] = -(K[7] = angles[0]);
#else
  K[1] = -(K[2] = angles[0]);
#endif
  multiply(K, 0, K, square);
  for (i = 0; i < DIMENSION * DIMENSION; i++)
    step[i] = (i % (DIMENSION + 1) == 0) + first * K[i] + second * square[i];
}

/* Coordinates of displacements or velocities of the nodes. */
static void project(const double *motion, double *coordinates) {
  int i, k;
  for (i = 0; i < FRAME_SHAPES; i++) {
    coordinates[i] = 0.0;
    for (k = 0; k < CONTROLLER_COORDINATES; k++)
      coordinates[i] += frame_projection[i * CONTROLLER_COORDINATES + k] * motion[k];
  }
}

/* The motion of each node turned by A, or A'. */
static void turn_motion(const double *A, int transposed, const double *motion, double *turned) {
  int i;
  for (i = 0; i < CONTROLLER_COORDINATES; i += DIMENSION) turn_vector(A, transposed, motion + i, turned + i);
}

/* P <- G P G', with G the same for each block of states that turns. */
static void turn_covariance(const double *G, double *P) {
  int i, j, k;
  const int r = FRAME_SHAPES, s = FILTER_STATES;
  for (i = 0; i < s; i++)
    for (j = 0; j < s; j++) {
      double sum = P[i * s + j];
      if (i < FRAME_TURNED * r)
        for (sum = 0.0, k = 0; k < r; k++) sum += G[i % r * r + k] * P[(i / r * r + k) * s + j];
      product[i * s + j] = sum;
    }
  for (i = 0; i < s; i++)
    for (j = 0; j <= i; j++) {
      double sum = product[i * s + j];
      if (j < FRAME_TURNED * r)
        for (sum = 0.0, k = 0; k < r; k++) sum += product[i * s + j / r * r + k] * G[j % r * r + k];
      P[i * s + j] = P[j * s + i] = sum;
    }
}

/* Take the turn out of the state; the frame turns by it. */
static void settle(void) {
  static double G[FRAME_SHAPES * FRAME_SHAPES];
  double angles[FRAME_ANGLES] = {0}, step[DIMENSION * DIMENSION], next[DIMENSION * DIMENSION];
  double motion[CONTROLLER_COORDINATES], turned[CONTROLLER_COORDINATES], now[FRAME_SHAPES];
  int i, k;
  for (i = 0; i < FRAME_ANGLES; i++)
    for (k = 0; k < FRAME_SHAPES; k++) angles[i] += frame_angle[i * FRAME_SHAPES + k] * filter_state[k];
  rotation(angles, step);
  for (k = 0; k < FRAME_SHAPES; k++) {
    for (i = 0; i < CONTROLLER_COORDINATES; i++) motion[i] = frame_basis[i * FRAME_SHAPES + k];
    turn_motion(step, 1, motion, turned);
    project(turned, now);
    for (i = 0; i < FRAME_SHAPES; i++) G[i * FRAME_SHAPES + k] = now[i];
  }
  reaches(filter_state, filter_previous);
  turn_motion(step, 1, shape_nodes, turned);
  for (i = 0; i < CONTROLLER_COORDINATES; i++) turned[i] -= frame_nodes[i];
  project(turned, filter_state);
  turn_motion(step, 1, shape_velocities, turned);
  project(turned, filter_state + FRAME_SHAPES);
#if FRAME_TURNED > 2
  copy(now, filter_state + 2 * FRAME_SHAPES, FRAME_SHAPES);
  for (i = 0; i < FRAME_SHAPES; i++) {
    filter_state[2 * FRAME_SHAPES + i] = 0.0;
    for (k = 0; k < FRAME_SHAPES; k++) filter_state[2 * FRAME_SHAPES + i] += G[i * FRAME_SHAPES + k] * now[k];
  }
#endif
  turn_covariance(G, filter_covariance);
  multiply(pose_turn, 0, step, next);
  multiply(next, 1, next, step); /* a rotation again, as round-off adds up */
  for (i = 0; i < DIMENSION * DIMENSION; i++) step[i] = 1.5 * (i % (DIMENSION + 1) == 0) - 0.5 * step[i];
  multiply(next, 0, step, pose_turn);
}

static double height_of(const double *node) {
  double sum = 0.0;
  int axis;
  for (axis = 0; axis < DIMENSION; axis++) sum += frame_up[axis] * node[axis];
  return sum;
}

/* Nodes and velocities out of the frame: the lowest node has stood still. */
static void place_motion(double *nodes, double *velocities) {
  double shift[DIMENSION], speed[DIMENSION], least = INFINITY;
  int i, axis;
  turn_motion(pose_turn, 0, shape_nodes, nodes);
  turn_motion(pose_turn, 0, shape_velocities, velocities);
  for (axis = 0; axis < DIMENSION; axis++) {
    shift[axis] = pose_touch[axis] - nodes[DIMENSION * pose_lowest + axis];
    speed[axis] = velocities[DIMENSION * pose_lowest + axis];
  }
  for (i = 0; i < CONTROLLER_COORDINATES; i++) {
    nodes[i] += shift[i % DIMENSION];
    velocities[i] -= speed[i % DIMENSION];
  }
  for (i = 0; i < CONTROLLER_COORDINATES; i += DIMENSION)
    if (height_of(nodes + i) < least) {
      least = height_of(nodes + i);
      pose_lowest = i / DIMENSION;
    }
  for (i = 0; i < CONTROLLER_COORDINATES; i++) nodes[i] += (FRAME_GROUND - least) * frame_up[i % DIMENSION];
  copy(pose_touch, nodes + DIMENSION * pose_lowest, DIMENSION);
}
#endif

/* Inverse of a symmetric positive definite matrix, in place of it; 0 if it has none. */
static int invert(double *A, int n) {
  int i, j, k;
  for (j = 0; j < n; j++) { /* A = L L' */
    double pivot = A[j * n + j];
    for (k = 0; k < j; k++) pivot -= A[j * n + k] * A[j * n + k];
    if (!(pivot > 0.0) || !isfinite(pivot)) return 0;
    pivot = sqrt(pivot);
    A[j * n + j] = pivot;
    for (i = j + 1; i < n; i++) {
      double sum = A[i * n + j];
      for (k = 0; k < j; k++) sum -= A[i * n + k] * A[j * n + k];
      A[i * n + j] = sum / pivot;
    }
  }
  for (j = 0; j < n; j++) { /* L^-1 */
    A[j * n + j] = 1.0 / A[j * n + j];
    for (i = j + 1; i < n; i++) {
      double sum = 0.0;
      for (k = j; k < i; k++) sum -= A[i * n + k] * A[k * n + j];
      A[i * n + j] = sum / A[i * n + i];
    }
  }
  for (i = 0; i < n; i++) /* L^-T L^-1 */
    for (j = 0; j <= i; j++) {
      double sum = 0.0;
      for (k = i; k < n; k++) sum += A[k * n + i] * A[k * n + j];
      A[i * n + j] = sum;
    }
  for (i = 0; i < n; i++)
    for (j = i + 1; j < n; j++) A[i * n + j] = A[j * n + i];
  return 1;
}

/* v' B^-1 v of a block of at most three rows, from row first of the matrix; -1 if it has none. */
static double distance(const double *v, const double *matrix, int rows, int first, int count) {
  double block[FILTER_LARGEST * FILTER_LARGEST], sum = 0.0;
  int i, j;
  if (count == 1) return v[first] * v[first] / matrix[first * rows + first];
  for (i = 0; i < count; i++)
    for (j = 0; j < count; j++) block[i * count + j] = matrix[(first + i) * rows + first + j];
  if (!invert(block, count)) return -1.0;
  for (i = 0; i < count; i++)
    for (j = 0; j < count; j++) sum += v[first + i] * block[i * count + j] * v[first + j];
  return sum;
}

/* S = C P C' + R of some entries, into spread_of, and R into variance_of; gain_rows is C P. Readings
   that were much better than predicted would make S singular by round-off. */
static void innovation_spread(const int *entries, int count, const double *P) {
  int a, b, i, k;
  for (a = 0; a < count; a++)
    for (i = 0; i < FILTER_STATES; i++) {
      double sum = 0.0;
      for (k = 0; k < FILTER_STATES; k++)
        sum += jacobian[k * FILTER_NUMBERS + entries[a]] * P[k * FILTER_STATES + i];
      gain_rows[a * FILTER_STATES + i] = sum;
    }
  for (a = 0; a < count; a++)
    for (b = 0; b < count; b++) {
      double sum = 0.0;
      for (k = 0; k < FILTER_STATES; k++)
        sum += gain_rows[a * FILTER_STATES + k] * jacobian[k * FILTER_NUMBERS + entries[b]];
      spread_of[a * count + b] = sum;
    }
  for (a = 0; a < count; a++) {
    double noise = reading_noise[entries[a]], *own = spread_of + a * count + a;
    variance_of[a] = fmax(noise * noise, FILTER_LEAST_NOISE * *own);
    *own += variance_of[a];
  }
}

/* P <- (I - K C) P (I - K C)' + K R K', symmetric; K' is in gain_rows. */
static void joseph(const int *entries, int count, double *P) {
  int a, i, j, k;
  for (i = 0; i < FILTER_STATES; i++)
    for (j = 0; j < FILTER_STATES; j++) {
      double sum = i == j;
      for (a = 0; a < count; a++)
        sum -= gain_rows[a * FILTER_STATES + i] * jacobian[j * FILTER_NUMBERS + entries[a]];
      of_state[i * FILTER_STATES + j] = sum;
    }
  for (i = 0; i < FILTER_STATES; i++)
    for (j = 0; j < FILTER_STATES; j++) {
      double sum = 0.0;
      for (k = 0; k < FILTER_STATES; k++) sum += of_state[i * FILTER_STATES + k] * P[k * FILTER_STATES + j];
      product[i * FILTER_STATES + j] = sum;
    }
  for (i = 0; i < FILTER_STATES; i++)
    for (j = 0; j <= i; j++) {
      double sum = 0.0;
      for (k = 0; k < FILTER_STATES; k++)
        sum += product[i * FILTER_STATES + k] * of_state[j * FILTER_STATES + k];
      for (a = 0; a < count; a++)
        sum += gain_rows[a * FILTER_STATES + i] * variance_of[a] * gain_rows[a * FILTER_STATES + j];
      P[i * FILTER_STATES + j] = P[j * FILTER_STATES + i] = sum;
    }
}

/*
 * The most likely state by some entries of y. Returns 0 where it is no shape of the structure, and
 * then nothing is changed. The innovation less the correction is in linear, and S^-1 in weight.
 */
static int use(const double *y, const int *entries, int count, const double *held, double *state, double *P,
               double *linear) {
  double z[FILTER_STATES];
  int a, b, i, turn;
  copy(z, state, FILTER_STATES);
  for (turn = 0; turn < FILTER_REPEATS; turn++) {
    double moved = 0.0, next[FILTER_STATES];
    read_state(z, held);
    for (a = 0; a < count; a++) {
      linear[a] = y[entries[a]] - read_now[entries[a]];
      for (i = 0; i < FILTER_STATES; i++)
        linear[a] -= jacobian[i * FILTER_NUMBERS + entries[a]] * (state[i] - z[i]);
    }
    innovation_spread(entries, count, P);
    memcpy(weight, spread_of, (size_t)(count * count) * sizeof *weight);
    if (!invert(weight, count)) return 0;
    for (i = 0; i < FILTER_STATES; i++) { /* gain' = S^-1 C P, a column at a time */
      double column[FILTER_NUMBERS];
      for (a = 0; a < count; a++) {
        column[a] = 0.0;
        for (b = 0; b < count; b++) column[a] += weight[a * count + b] * gain_rows[b * FILTER_STATES + i];
      }
      next[i] = state[i];
      for (a = 0; a < count; a++) {
        gain_rows[a * FILTER_STATES + i] = column[a];
        next[i] += column[a] * linear[a];
      }
    }
    for (i = 0; i < FILTER_STATES; i++) {
      double size = sqrt(fmax(P[i * FILTER_STATES + i], FILTER_TINY));
      moved = fmax(moved, fabs(next[i] - z[i]) / size);
    }
    copy(z, next, FILTER_STATES);
    if (!reaches(z, held)) return 0;
    if (moved < FILTER_SETTLED) break;
  }
  joseph(entries, count, P);
  copy(state, z, FILTER_STATES);
  return 1;
}

/* Entries of the readings that passed. */
static int entries_of(const int *passed, int *entries) {
  int i, count = 0;
  for (i = 0; i < FILTER_NUMBERS; i++)
    if (passed[reading_of[i]]) entries[count++] = i;
  return count;
}

/* Correct the state by the readings that are near enough, of those that are usable. */
static Fit correct(const double *y, const int *usable, const double *held) {
  static double state[FILTER_STATES], P[FILTER_STATES * FILTER_STATES];
  int entries[FILTER_NUMBERS], every[FILTER_NUMBERS], i, count;
  double linear[FILTER_NUMBERS];
  Fit fit;
  for (i = 0; i < FILTER_NUMBERS; i++) every[i] = i;
  read_state(filter_state, held);
  innovation_spread(every, FILTER_NUMBERS, filter_covariance);
  for (i = 0; i < FILTER_NUMBERS; i++) linear[i] = y[i] - read_now[i];
  for (i = 0; i < FILTER_READINGS; i++) {
    fit.passed[i] = 0;
    if (usable[i]) {
      double away = distance(linear, spread_of, FILTER_NUMBERS, reading_start[i],
                             reading_start[i + 1] - reading_start[i]);
      fit.passed[i] = away >= 0.0 && away <= gate_limit[i];
    }
  }
  while ((count = entries_of(fit.passed, entries)) > 0) {
    double weighed[FILTER_NUMBERS], worst = -1.0;
    int a, b, first = 0, farthest = -1, done;
    copy(state, filter_state, FILTER_STATES);
    copy(P, filter_covariance, FILTER_STATES * FILTER_STATES);
    done = use(y, entries, count, held, state, P, linear);
    if (!done) break;
    for (a = 0; a < count; a++) {
      weighed[a] = 0.0;
      for (b = 0; b < count; b++) weighed[a] += weight[a * count + b] * linear[b];
    }
    for (i = 0; i < FILTER_READINGS; i++)
      if (fit.passed[i]) {
        int size = reading_start[i + 1] - reading_start[i];
        double beyond = distance(weighed, weight, count, first, size) / gate_limit[i];
        if (beyond > worst) {
          worst = beyond;
          farthest = i;
        }
        first += size;
      }
    if (worst <= 1.0) {
      copy(filter_state, state, FILTER_STATES);
      copy(filter_covariance, P, FILTER_STATES * FILTER_STATES);
      fit.any = 1;
      return fit;
    }
    fit.passed[farthest] = 0;
  }
  memset(&fit, 0, sizeof fit);
  return fit;
}

/* What became of a sample, and whether most of its usable readings were refused. */
static int status_of(const Fit *fit, const int *usable, const int *lost, int *mostly) {
  int i, used = 0, count = 0, missing = 0;
  for (i = 0; i < FILTER_READINGS; i++) {
    used += fit->passed[i];
    count += usable[i];
    missing += lost[i];
  }
  *mostly = 2 * used < count;
  if (used == FILTER_READINGS) return CONTROLLER_OK;
  if (used > 0) return CONTROLLER_PARTLY_USED;
  return missing == FILTER_READINGS ? CONTROLLER_LOST : CONTROLLER_REFUSED;
}

static int correct_sample(const double *readings) {
  double y[FILTER_NUMBERS], predicted[FILTER_STATES];
  int usable[FILTER_READINGS], lost[FILTER_READINGS], i, status, mostly, any = 0;
  const double *held = filter_has_previous ? filter_previous : filter_rest;
  Fit fit;
  for (i = 0; i < FILTER_READINGS; i++) {
    usable[i] = 1;
    lost[i] = 0;
  }
  copy(y, readings, FILTER_NUMBERS);
#if FILTER_ROLLS
  read_in_frame(y);
#endif
  for (i = 0; i < FILTER_NUMBERS; i++) {
    int reading = reading_of[i];
    /* Without the previous input, tensions and accelerations say nothing. */
    if (!filter_has_previous && needs_input[reading]) y[i] = NAN;
    lost[reading] |= isnan(y[i]) != 0;
    usable[reading] &= isfinite(y[i]) != 0;
  }
  for (i = 0; i < FILTER_READINGS; i++) any |= usable[i];
  copy(predicted, filter_state, FILTER_STATES);
  fit = correct(y, usable, held);
  status = status_of(&fit, usable, lost, &mostly);
  if (mostly) {
    int late = ++filter_mostly_refused - FILTER_PATIENCE;
    if (late >= 0) {
      double wider = pow(FILTER_WIDER, late < FILTER_MOST_WIDER ? late : FILTER_MOST_WIDER);
      for (i = 0; i < FILTER_STATES * FILTER_STATES; i++) filter_covariance[i] = start_covariance[i] * wider;
      copy(filter_state, predicted, FILTER_STATES);
      fit = correct(y, usable, held);
      filter_is_fresh = 1;
    }
  } else if (any) {
    filter_mostly_refused = 0;
  }
#if FILTER_ROLLS
  settle();
#endif
  if (filter_is_fresh) status = CONTROLLER_RESTARTED;
  filter_is_fresh = 0;
  return status;
}

/* State, and its covariance if there is one, to a sample later. */
static void advance(double *z, double *P, const double *previous, const double *held) {
  double next[FILTER_STATES];
  int i, j, k;
#if FILTER_NONLINEAR
  int step, part;
  for (i = 0; i < FILTER_STATES * FILTER_STATES; i++) of_state[i] = i % (FILTER_STATES + 1) == 0;
  for (step = FILTER_SUBSTEPS - 1; step >= 0; step--) {
    double input[CONTROLLER_COMMANDS];
    double share = FILTER_SUBSTEPS > 1 ? (step + 0.5) / FILTER_SUBSTEPS : 0.0;
    static double along[FILTER_STATES * FILTER_STATES];
    for (part = 0; part < CONTROLLER_COMMANDS; part++)
      input[part] = held[part] + share * (previous[part] - held[part]);
    call(controller_motion, z, input, next, along);
    copy(z, next, FILTER_STATES);
    for (i = 0; i < FILTER_STATES; i++)
      for (j = 0; j < FILTER_STATES; j++) {
        double sum = 0.0;
        for (k = 0; k < FILTER_STATES; k++)
          sum += along[k * FILTER_STATES + i] * of_state[k * FILTER_STATES + j];
        product[i * FILTER_STATES + j] = sum;
      }
    copy(of_state, product, FILTER_STATES * FILTER_STATES);
  }
#else
  double off[CONTROLLER_COMMANDS];
  copy(next, filter_drift, FILTER_STATES);
  add_product(&filter_transition, z, next);
  for (i = 0; i < CONTROLLER_COMMANDS; i++) off[i] = held[i] - filter_rest[i];
  add_product(&filter_by_input, off, next);
  for (i = 0; i < CONTROLLER_COMMANDS; i++) off[i] = previous[i] - filter_rest[i];
  add_product(&filter_by_previous, off, next);
  copy(z, next, FILTER_STATES);
  if (P) {
    memset(of_state, 0, sizeof of_state);
    for (i = 0; i < FILTER_STATES; i++)
      for (k = filter_transition.start[i]; k < filter_transition.start[i + 1]; k++)
        of_state[i * FILTER_STATES + filter_transition.column[k]] = filter_transition.value[k];
  }
#endif
  if (!P) return;
  for (i = 0; i < FILTER_STATES; i++)
    for (j = 0; j < FILTER_STATES; j++) {
      double sum = 0.0;
      for (k = 0; k < FILTER_STATES; k++) sum += of_state[i * FILTER_STATES + k] * P[k * FILTER_STATES + j];
      product[i * FILTER_STATES + j] = sum;
    }
  for (i = 0; i < FILTER_STATES; i++)
    for (j = 0; j <= i; j++) {
      double sum = process_covariance[i * FILTER_STATES + j];
      for (k = 0; k < FILTER_STATES; k++)
        sum += product[i * FILTER_STATES + k] * of_state[j * FILTER_STATES + k];
      P[i * FILTER_STATES + j] = P[j * FILTER_STATES + i] = sum;
    }
}

static void start_over(void) {
  memset(filter_state, 0, sizeof filter_state);
  copy(filter_covariance, start_covariance, FILTER_STATES * FILTER_STATES);
#if FILTER_DRIVES_BARS /* which have the lengths that they have */
  if (filter_waiting > 0) copy(filter_previous, filter_inputs[filter_waiting - 1], FILTER_KNOWN);
  if (!reaches(filter_state, filter_previous)) copy(filter_previous, filter_rest, FILTER_KNOWN);
#else
  filter_has_previous = 0;
#endif
  filter_waiting = 0;
}

int controller_estimator_reset(void) {
  start_over();
  copy(filter_state, start_state, FILTER_STATES);
#if FILTER_DRIVES_BARS
  copy(filter_previous, start_input, FILTER_KNOWN);
  filter_has_previous = 1;
#endif
  filter_mostly_refused = filter_is_fresh = 0;
#if FILTER_ROLLS
  copy(pose_turn, frame_turn, DIMENSION * DIMENSION);
  copy(pose_touch, frame_touch, DIMENSION);
  pose_lowest = FRAME_LOWEST;
#endif
  filter_is_ready = 1;
  return CONTROLLER_OK;
}

int controller_estimate(const double *readings, double *nodes, double *velocities) {
  double z[FILTER_STATES];
  const double *previous = filter_previous;
  int i, status = CONTROLLER_WAITING;
  if (!filter_is_ready) controller_estimator_reset();
  if (filter_waiting >= FILTER_DELAY) status = correct_sample(readings);
  else if (filter_is_fresh) {
    filter_is_fresh = 0;
    status = CONTROLLER_RESTARTED;
  }
  copy(z, filter_state, FILTER_STATES);
  for (i = 0; i < filter_waiting; i++) {
    if (!filter_has_previous && i == 0) previous = filter_inputs[0];
    advance(z, NULL, previous, filter_inputs[i]);
    previous = filter_inputs[i];
  }
  if (!reaches(z, previous)) {
    start_over();
    copy(z, filter_state, FILTER_STATES);
    status = CONTROLLER_RESTARTED;
    reaches(z, filter_previous);
  }
#if FILTER_ROLLS
  place_motion(nodes, velocities);
#else
  copy(nodes, shape_nodes, CONTROLLER_COORDINATES);
  copy(velocities, shape_velocities, CONTROLLER_COORDINATES);
#endif
  return status;
}

int controller_predict(const double *held) {
  int i, blown = 0;
  double *known;
#if FILTER_DRIVES_BARS
  const double *before;
#endif
  if (!all_finite(held, CONTROLLER_COMMANDS)) return CONTROLLER_INPUT_NOT_FINITE;
  if (!filter_is_ready) controller_estimator_reset();
#if FILTER_DRIVES_BARS
  for (i = 0; i < CONTROLLER_COMMANDS; i++)
    if (!(held[i] > 0.0 && held[i] <= FILTER_MOST_LENGTH * filter_rest[i]))
      return CONTROLLER_MEASUREMENT_NOT_PLAUSIBLE;
#endif
  known = filter_inputs[filter_waiting++];
  copy(known, held, CONTROLLER_COMMANDS);
#if FILTER_DRIVES_BARS
  before = filter_waiting > 1 ? filter_inputs[filter_waiting - 2] : filter_previous;
  for (i = 0; i < CONTROLLER_COMMANDS; i++)
    known[CONTROLLER_COMMANDS + i] = (held[i] - before[i]) / CONTROLLER_STEP;
#endif
  if (filter_waiting <= FILTER_DELAY) return CONTROLLER_OK;
  advance(filter_state, filter_covariance, filter_has_previous ? filter_previous : filter_inputs[0],
          filter_inputs[0]);
  copy(filter_previous, filter_inputs[0], FILTER_KNOWN);
  filter_has_previous = 1;
  filter_waiting--;
  for (i = 0; i < filter_waiting; i++) copy(filter_inputs[i], filter_inputs[i + 1], FILTER_KNOWN);
  for (i = 0; i < FILTER_STATES; i++) {
    int k = i * (FILTER_STATES + 1);
    blown |= filter_covariance[k] > FILTER_NOTHING_KNOWN * start_covariance[k];
  }
  if (blown || !reaches(filter_state, filter_previous)) {
    start_over();
    filter_is_fresh = 1;
  }
  return CONTROLLER_OK;
}
