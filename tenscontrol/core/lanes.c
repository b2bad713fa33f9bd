/* Runs side by side by the instructions that every machine has, and the choice of wider ones. */
#include "lanes.h"

#undef WIDE
#define WIDE
#define LANES 2
#define LANES_NAME(name) LANES_NAME_##name
#define LANES_NAME_advance advance_by_all
#define LANES_NAME_size all_size
#define LANES_NAME_begin begin_by_all
#include "lanes_body.h"

size_t tc_runs_work_size(const Scene *scene, const Drive *drive, const Settings *settings, const Runs *runs) {
  return WIDEST(avx512_size, avx2_size, all_size)(scene, drive, settings, runs);
}

void tc_begin_runs(const Scene *scene, const Drive *drive, const Runs *runs, const double *start,
                   const double *difference, const double *vector, double *frequency, double *force,
                   double *slope, double *taut, double *work) {
  BeginRuns *begin = WIDEST(begin_by_avx512, begin_by_avx2, begin_by_all);
  begin(scene, drive, runs, start, difference, vector, frequency, force, slope, taut, work);
}

void tc_advance_runs(const Scene *scene, const Drive *drive, const Lengths *lengths, const Settings *settings,
                     const Runs *runs, const double *start, double *states, Progress *progress,
                     const volatile int32_t *stop, double *work) {
  AdvanceRuns *advance = WIDEST(advance_by_avx512, advance_by_avx2, advance_by_all);
  advance(scene, drive, lengths, settings, runs, start, states, progress, stop, work);
}
