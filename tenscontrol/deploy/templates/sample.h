
/*
 * All three in one call, where the actuators hold the command until the next sample.
 *
 * Takes the time of controller_command and the readings of controller_estimate; the command comes
 * out, and the status of controller_command is returned.
 */
int controller_sample(double time, const double *readings, double *command);
