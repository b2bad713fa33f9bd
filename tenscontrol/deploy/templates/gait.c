
/* ---- rolling gait: rest lengths that tip a structure over edges of its faces, from a table ---- */

#define NODES (CONTROLLER_COORDINATES / DIMENSION)
#define ENDS (DIMENSION - 1) /* nodes of an edge */

enum { STANDS, WINDS, LANDS };

static struct {
  int phase;
  int has_moved_at, has_begun, pushes;
  int face, edge;              /* wound over: numbers in the tables */
  int has_tipped, tipped_from; /* a step that has not come to rest, and the face it left */
  int made;                    /* steps, so far */
  int passed;                  /* the last equilibrium of the plan that was passed */
  double since;                /* beginning of the phase, or the last winding, s */
  double moved_at;             /* when it was not still, or began, s */
  double wound[CONTROLLER_COMMANDS];
  double begun[DIMENSION], stood[DIMENSION], moved[DIMENSION];
  char vain[DIFFERENT_EDGES];
} memory;

static void forget(void) { memset(&memory, 0, sizeof memory); }

static double dot(const double *x, const double *y) {
  double sum = 0.0;
  int i;
  for (i = 0; i < DIMENSION; i++) sum += x[i] * y[i];
  return sum;
}

static void difference(const double *x, const double *y, double *out) {
  int i;
  for (i = 0; i < DIMENSION; i++) out[i] = x[i] - y[i];
}

#if DIMENSION == 3
static void cross(const double *x, const double *y, double *out) {
  out[0] = x[1] * y[2] - x[2] * y[1];
  out[1] = x[2] * y[0] - x[0] * y[2];
  out[2] = x[0] * y[1] - x[1] * y[0];
}
#endif

static const double *node(const double *nodes, int number) { return nodes + DIMENSION * number; }

static void centre_of(const double *nodes, double *centre) {
  int i, axis;
  for (axis = 0; axis < DIMENSION; axis++) {
    centre[axis] = 0.0;
    for (i = 0; i < NODES; i++) centre[axis] += nodes[DIMENSION * i + axis];
    centre[axis] /= NODES;
  }
}

static int has(const int *numbers, int count, int number) {
  int i;
  for (i = 0; i < count; i++)
    if (numbers[i] == number) return 1;
  return 0;
}

static int is_foot(int face, int number) {
  return has(foot + foot_start[face], foot_start[face + 1] - foot_start[face], number);
}

/* The face that looks most downward, and the cosine of its angle to level ground. */
static int lowest_face(const double *nodes, double *level) {
  double deepest = -INFINITY;
  int face, lowest = 0;
  for (face = 0; face < FACES; face++) {
    const int *corners = corner + corner_start[face];
    const double *first = node(nodes, corners[0]);
    double area[DIMENSION], sinks;
#if DIMENSION == 3
    double side[DIMENSION], next[DIMENSION], part[DIMENSION];
    int i, axis, count = corner_start[face + 1] - corner_start[face];
    memset(area, 0, sizeof area);
    difference(node(nodes, corners[1]), first, side);
    for (i = 2; i < count; i++) {
      difference(node(nodes, corners[i]), first, next);
      cross(side, next, part);
      for (axis = 0; axis < DIMENSION; axis++) area[axis] += part[axis];
      copy(side, next, DIMENSION);
    }
#else
    double side[DIMENSION];
    difference(node(nodes, corners[1]), first, side);
    area[0] = side[1];
    area[1] = -side[0];
#endif
    sinks = -dot(area, up) / (sqrt(dot(area, area)) + TINY);
    if (sinks > deepest) {
      deepest = sinks;
      lowest = face;
    }
  }
  *level = deepest;
  return lowest;
}

/* The unit vector over an edge of a face and across a direction. */
static void across_edge(const double *nodes, int face, int edge, const double *direction, double *over) {
  const int *ends = edge_node + ENDS * edge;
  const double *first = node(nodes, ends[0]);
  double inside[DIMENSION], scale;
  int i, axis, count = foot_start[face + 1] - foot_start[face];
#if DIMENSION == 3
  double along[DIMENSION];
  difference(node(nodes, ends[1]), first, along);
  cross(along, direction, over);
#else
  over[0] = -direction[1];
  over[1] = direction[0];
#endif
  memset(inside, 0, sizeof inside);
  for (i = foot_start[face]; i < foot_start[face + 1]; i++)
    for (axis = 0; axis < DIMENSION; axis++) inside[axis] += nodes[DIMENSION * foot[i] + axis];
  for (axis = 0; axis < DIMENSION; axis++) inside[axis] = inside[axis] / count - first[axis];
  scale = sqrt(dot(over, over));
  if (dot(over, inside) > 0) scale = -scale;
  for (axis = 0; axis < DIMENSION; axis++) over[axis] /= scale;
}

/* The nodes of a rigid shape after it has rolled over an edge onto the next face. */
static void roll(const double *nodes, int face, int edge, double *rolled) {
  const double *first = node(nodes, edge_node[ENDS * edge]);
  double over[DIMENSION], below[DIMENSION], beside[DIMENSION], turn = INFINITY, c, s;
  int i, axis;
  for (axis = 0; axis < DIMENSION; axis++) below[axis] = -up[axis];
  across_edge(nodes, face, edge, below, over);
  for (i = 0; i < NODES; i++) {
    if (is_foot(face, i)) continue;
    difference(node(nodes, i), first, beside);
    turn = fmin(turn, atan2(dot(up, beside), dot(over, beside)));
  }
  c = cos(turn) - 1;
  s = sin(turn);
  for (i = 0; i < NODES; i++) {
    double out, above;
    difference(node(nodes, i), first, beside);
    out = dot(over, beside);
    above = dot(up, beside);
    for (axis = 0; axis < DIMENSION; axis++)
      rolled[DIMENSION * i + axis] =
          nodes[DIMENSION * i + axis] + over[axis] * (c * out + s * above) + up[axis] * (c * above - s * out);
  }
}

/* How far from the goal the centre is after some steps of a rigid shape, m. */
static double distance_left(const double *nodes, int face, int edge, const double *goal, int steps) {
  double rolled[CONTROLLER_COORDINATES], least = INFINITY, level;
  roll(nodes, face, edge, rolled);
  if (steps == 1) {
    double centre[DIMENSION], off[DIMENSION];
    centre_of(rolled, centre);
    difference(centre, goal, off);
    return sqrt(dot(off, off));
  }
  face = lowest_face(rolled, &level);
  for (edge = edge_start[face]; edge < edge_start[face + 1]; edge++)
    least = fmin(least, distance_left(rolled, face, edge, goal, steps - 1));
  return least;
}

/* The edge of a face to tip over: ahead and not in vain, else not in vain, else any. */
static int best_edge(const double *nodes, int face, const double *goal) {
  double nearest = INFINITY, back = -BACK * sqrt(dot(memory.moved, memory.moved));
  int edge, kind, best_kind = 0, best = edge_start[face];
  for (edge = edge_start[face]; edge < edge_start[face + 1]; edge++) {
    double over[DIMENSION], from_goal;
    kind = 0;
    if (!memory.vain[edge_number[edge]]) {
      across_edge(nodes, face, edge, down, over);
      kind = dot(over, memory.moved) >= back ? 2 : 1;
    }
    if (kind < best_kind) continue;
    from_goal = distance_left(nodes, face, edge, goal, FORESEEN);
    if (kind > best_kind || from_goal < nearest) {
      best_kind = kind;
      nearest = from_goal;
      best = edge;
    }
  }
  return best;
}

/* Count the step that led here, and begin to wind over the best edge. */
static void stand(double time, const double *nodes) {
  double centre[DIMENSION], goal[DIMENSION], along, level;
  int axis, face = lowest_face(nodes, &level);
  centre_of(nodes, centre);
  if (!memory.has_begun) copy(memory.begun, centre, DIMENSION);
  memory.has_begun = 1;
  if (memory.has_tipped && face == memory.tipped_from) {
    memory.vain[edge_number[memory.edge]] = 1; /* it fell back */
  } else if (memory.has_tipped) {
    memory.made += memory.made < STEPS; /* without end they are not counted */
    memset(memory.vain, 0, sizeof memory.vain);
    difference(centre, memory.stood, memory.moved);
  }
  memory.has_tipped = 0;
  copy(memory.stood, centre, DIMENSION);
  if ((STEPS > 0 && memory.made >= STEPS) || edge_start[face] == edge_start[face + 1]) return;
  difference(centre, memory.begun, goal);
  along = dot(heading, goal) + AHEAD;
  for (axis = 0; axis < DIMENSION; axis++) goal[axis] = memory.begun[axis] + along * heading[axis];
  memory.face = face;
  memory.edge = best_edge(nodes, face, goal);
  memory.passed = plan_start[memory.edge];
  copy(memory.wound, equilibrium, CONTROLLER_COMMANDS);
  memory.pushes = 0;
  memory.phase = WINDS;
  memory.since = time;
}

/* Go on along the plan; 0 at its end. */
static int wind_on(void) {
  int i, last = plan_start[memory.edge + 1] - 1;
  double left = 1.0; /* of this sample */
  if (memory.passed == last) return 0;
  while (left > 0 && memory.passed < last) {
    const double *next = plan_input + CONTROLLER_COMMANDS * (memory.passed + 1);
    double takes = 0.0;
    for (i = 0; i < CONTROLLER_COMMANDS; i++)
      takes = fmax(takes, fabs(next[i] - memory.wound[i]) / largest_winding[i]);
    if (takes <= left) {
      copy(memory.wound, next, CONTROLLER_COMMANDS);
      memory.passed++;
      left -= takes;
    } else {
      for (i = 0; i < CONTROLLER_COMMANDS; i++)
        memory.wound[i] += (next[i] - memory.wound[i]) * (left / takes);
      left = 0.0;
    }
  }
  return 1;
}

/* Go back, to try another edge. */
static void give_up(void) {
  memory.vain[edge_number[memory.edge]] = 1;
  memory.phase = STANDS;
}

/* Whether it has tipped: the lowest face is level, and has no foot from behind the edge. */
static int has_tipped(const double *nodes) {
  const int *ends = edge_node + ENDS * memory.edge;
  double level;
  int i, face = lowest_face(nodes, &level);
  if (!(level > LANDED)) return 0;
  for (i = foot_start[memory.face]; i < foot_start[memory.face + 1]; i++)
    if (!has(ends, ENDS, foot[i]) && is_foot(face, foot[i])) return 0;
  return 1;
}

/* Wind on, or end it where it has tipped or cannot. */
static void wind(double time, const double *nodes, int is_late) {
  double enough = memory.pushes ? ENOUGH_PUSHED : ENOUGH;
  if (has_tipped(nodes)) {
    memory.has_tipped = 1;
    memory.tipped_from = memory.face;
    memory.phase = LANDS;
    memory.since = time;
    return;
  }
  if (is_late && plan_margin[memory.passed] >= enough) {
    if (memory.pushes) {
      give_up();
      return;
    }
    memory.pushes = 1;
    enough = ENOUGH_PUSHED;
  }
  if (plan_margin[memory.passed] < enough) {
    if (wind_on()) memory.since = time;
    else give_up();
  }
}

static int is_home(const double *reached) {
  int i;
  for (i = 0; i < CONTROLLER_COMMANDS; i++)
    if (!(fabs(reached[i] - equilibrium[i]) <= CLOSE)) return 0;
  return 1;
}

/* The next inputs on the straight way back. */
static void wind_back(const double *reached, double *desired_input) {
  double share = 1.0;
  int i;
  for (i = 0; i < CONTROLLER_COMMANDS; i++)
    share = fmin(share, largest_winding[i] / fmax(fabs(equilibrium[i] - reached[i]), CLOSE));
  for (i = 0; i < CONTROLLER_COMMANDS; i++)
    desired_input[i] = reached[i] + share * (equilibrium[i] - reached[i]);
}

static int decide(double time, const double *state, double *desired_input) {
  const double *nodes = state, *velocities = state + CONTROLLER_COORDINATES;
  const double *reached = has_previous_input ? previous_input : equilibrium;
  int i, rests, is_late, is_still = 1;
  for (i = 0; i < NODES; i++)
    if (!(sqrt(dot(node(velocities, i), node(velocities, i))) < STILL)) is_still = 0;
  if (!is_still || !memory.has_moved_at) memory.moved_at = time;
  memory.has_moved_at = 1;
  rests = time - memory.moved_at >= RESTS;
  is_late = time > memory.since + PATIENCE;
  if (memory.phase == WINDS) wind(time, nodes, is_late);
  else if (memory.phase == LANDS && (rests || is_late)) memory.phase = STANDS;
  else if (memory.phase == STANDS && rests && is_home(reached)) stand(time, nodes);
  if (memory.phase == STANDS) wind_back(reached, desired_input);
  else copy(desired_input, memory.wound, CONTROLLER_COMMANDS);
  return CONTROLLER_OK;
}

static int fall_back(int reason, double *desired_input) { return hold(reason, desired_input); }
