
/* ---- functions of controller.h ---- */

int controller_reset(void) {
  has_previous_input = 0;
  forget();
  return CONTROLLER_OK;
}

int controller_command(double time, const double *nodes, const double *velocities, double *command) {
  double state[STATES], desired_input[CONTROLLER_COMMANDS];
  int i, status = fault_of(time, nodes, velocities);
  iterations = 0;
  if (status == CONTROLLER_OK) {
    measure(nodes, velocities, state);
    status = decide(time, state, desired_input);
    if (!all_finite(desired_input, CONTROLLER_COMMANDS))
      status = fall_back(CONTROLLER_INPUT_NOT_FINITE, desired_input);
  } else {
    status = fall_back(status, desired_input);
  }
  for (i = 0; i < CONTROLLER_COMMANDS; i++) command[i] = bounded_input(desired_input, i);
  set_previous_input(command);
  return status;
}

int controller_applied(const double *value) {
  if (!all_finite(value, CONTROLLER_COMMANDS)) return CONTROLLER_MEASUREMENT_NOT_FINITE;
  set_previous_input(value);
  return CONTROLLER_OK;
}

int controller_iterations(void) { return iterations; }
