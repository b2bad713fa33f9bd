
/* ---- the quadratic program along the stages of the horizon ---- */

#include "stages.h"

#define ROWS STAGES_ROWS(HORIZON, CONTROLLER_COMMANDS, LIMITED, CHANGES)
#define MOST STAGES_ACTIVE(ALIKE, ROWS, PLANNED, SOFT)

static struct {
  StagesProgram stages;
  int placed;
  double *states;        /* z_0 ... z_N of the plan */
  double *inputs;        /* u_0 ... u_{N-1}, behind the input before */
  double *y;             /* multipliers that the next solve starts from */
  double *gaps, *values; /* what the plan leaves of the motion; its limited values, in units */
  const double *state_moves, *input_moves; /* what a solution adds to the plan */
  double
      numbers[STAGES_NUMBERS(ALIKE, THIN, HORIZON, PROGRAM_STATES, CONTROLLER_COMMANDS, LIMITED, ROWS, MOST)];
  int integers[STAGES_INTEGERS(ALIKE, HORIZON, ROWS, MOST)];
  const double *pointers[ACTIVE_SET_POINTERS(MOST)];
} program;

static void place_program(void) {
  static const StagesSizes sizes = {HORIZON, PROGRAM_STATES, CONTROLLER_COMMANDS, LIMITED, 0,
                                    CHANGES, SOFT,           ITERATIONS,          AHEAD,   ALIKE,
                                    THIN,    CROSSED};
  static const StagesData data = {
      state_weight, input_weight, terminal_weight, cross_weight, limit_scale,   largest_change,
      low,          high,         limit_low,       limit_high,   price,         price,
      thin_unit,    thin_inputs,  thin_states,     thin_shrink,  limited_start, limited_which};
  size_t counts[3];
  double *views[7];
  stages_program_place(&program.stages, &sizes, LEVEL, TOLERANCE, NULL, &data, program.numbers,
                       program.integers, program.pointers, counts, views);
  program.states = views[0];
  program.inputs = views[1] + CONTROLLER_COMMANDS;
  program.y = views[2];
  program.state_moves = views[3];
  program.input_moves = views[4];
  program.gaps = views[5];
  program.values = views[6];
  program.placed = 1;
}

static void forget_program(void) {
  if (program.placed) memset(program.y, 0, ROWS * sizeof *program.y);
}
