
/* ---- linear-quadratic regulator: u = u0 - K z, less H (previous input - u0) for ramps ---- */

static void forget(void) {}

static int decide(double time, const double *state, double *desired_input) {
  int i;
  (void)time;
  copy(desired_input, equilibrium, CONTROLLER_COMMANDS);
  add_product(&feedback, state, desired_input);
#if RAMP
  if (has_previous_input) {
    double off[CONTROLLER_COMMANDS];
    for (i = 0; i < CONTROLLER_COMMANDS; i++) off[i] = previous_input[i] - equilibrium[i];
    add_product(&previous_input_feedback, off, desired_input);
  }
#endif
  for (i = 0; i < CONTROLLER_COMMANDS; i++)
    if (bounded_input(desired_input, i) != desired_input[i]) return CONTROLLER_SATURATED;
  return CONTROLLER_OK;
}

static int fall_back(int reason, double *desired_input) { return hold(reason, desired_input); }
