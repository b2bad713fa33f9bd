/* Many runs, some side by side: included by files that say by which instructions. */
#include "carry.c"
#include "equation.c"
#include "events.c"
#include "frequency.c"
#include "lengths.c"
#include "span.c"

#include "dop853.c"
#include "rk4.c"

#include "lanes_tables.h"

#include "lanes_begin.h"
#include "lanes_dop853.h"
#include "lanes_rk4.h"

size_t LANES_NAME(size)(const Scene *scene, const Drive *drive, const Settings *settings, const Runs *runs) {
  return settings->method == DOP853_METHOD ? dop853_runs_size(scene, drive, runs)
                                           : rk4_runs_size(scene, drive, runs);
}

void LANES_NAME(advance)(const Scene *scene, const Drive *drive, const Lengths *lengths,
                         const Settings *settings, const Runs *runs, const double *start, double *states,
                         Progress *progress, const volatile int32_t *stop, double *work) {
  AdvanceRuns *advance = settings->method == DOP853_METHOD ? advance_runs_by_dop853 : advance_runs_by_rk4;
  advance(scene, drive, settings->projects ? lengths : 0, settings, runs, start, states, progress, stop,
          work);
}
