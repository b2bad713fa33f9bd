/* Many runs of one structure: several at once, by the instructions that there are. */
#ifndef TENSCONTROL_LANES_H
#define TENSCONTROL_LANES_H

#include "core.h"

#if defined(__x86_64__) && defined(__GNUC__)
#define HAS_WIDE_LANES
#endif

/* The choice of the widest instructions that the machine has. */
#ifdef HAS_WIDE_LANES
static inline int has_avx512(void) {
  return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq");
}
#define WIDEST(by_avx512, by_avx2, by_all) \
  (has_avx512() ? by_avx512 : __builtin_cpu_supports("avx2") ? by_avx2 : by_all)
#else
#define WIDEST(by_avx512, by_avx2, by_all) by_all
#endif

typedef void AdvanceRuns(const Scene *scene, const Drive *drive, const Lengths *lengths,
                         const Settings *settings, const Runs *runs, const double *start, double *states,
                         Progress *progress, const volatile int32_t *stop, double *work);
typedef void BeginRuns(const Scene *scene, const Drive *drive, const Runs *runs, const double *start,
                       const double *difference, const double *vector, double *frequency, double *force,
                       double *slope, double *taut, double *work);
typedef size_t RunsSize(const Scene *scene, const Drive *drive, const Settings *settings, const Runs *runs);

AdvanceRuns advance_by_all, advance_by_avx2, advance_by_avx512;
BeginRuns begin_by_all, begin_by_avx2, begin_by_avx512;
RunsSize all_size, avx2_size, avx512_size;

#endif
