/* Four members of one run at once, one in each lane, where the machine has AVX2: to the bits of one after
   the other. Calls return how many they have done, a multiple of four; the rest is left.

   Vectors of nodes are read by four numbers: of positions with those that follow, of rates with those
   before. So in memory rates come right after positions. */
#ifndef TENSCONTROL_MEMBERS_H
#define TENSCONTROL_MEMBERS_H

#include "lanes.h"

#ifdef HAS_WIDE_LANES
/* Finds forces on nodes: a load, or null for none, and the pull of strings of one segment each. Work
   memory is four numbers a node. */
typedef int PullMembers(const Scene *scene, const double *p, const double *v, const double *u,
                        const double *taut, const double *load, double *f, double *work);
PullMembers pull_by_avx2_2, pull_by_avx2_3;

/* Finds the gaps of such strings, and their rates where there is memory for them. */
typedef int MeasureMembers(const Scene *scene, const double *p, const double *v, const double *u, double *gap,
                           double *rate);
MeasureMembers gaps_by_avx2_2, gaps_by_avx2_3;

/* Finds accelerations of the ends of bars that share no nodes. */
typedef int MoveMembers(const Scene *scene, const double *p, const double *v, const double *f,
                        const double *extension, double *a);
MoveMembers free_bars_by_avx2_2, free_bars_by_avx2_3;
#endif

#endif
