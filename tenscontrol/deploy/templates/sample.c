
/* ---- readings in, command out ---- */

int controller_sample(double time, const double *readings, double *command) {
  double nodes[CONTROLLER_COORDINATES], velocities[CONTROLLER_COORDINATES];
  int status;
  controller_estimate(readings, nodes, velocities);
  status = controller_command(time, nodes, velocities, command);
  controller_predict(command);
  return status;
}
