/* Plants in reduced coordinates, and what a sample does to them, to first order: calls of the core. */
#ifndef TENSCONTROL_REDUCED_H
#define TENSCONTROL_REDUCED_H

#include "core.h"

/* Nodes are displaced by T q. Then each bar, of which none share nodes, is put on its length L along the
   axis that it had, and its rate is what keeps that. Of the accelerations of all entries, q'' = P a and
   displacements have T P a. A state is q, then q'; an input the values that strings are held at. */
typedef struct {
  const Scene *scene;
  int32_t coordinates, inputs, bars;
  const double *place;           /* (entries), m: where q is 0 */
  const double *basis, *project; /* (entries, coordinates), (coordinates, entries): T, P */
  int32_t inner, is_complement;  /* T P = left right; of a complement the free entries less that */
  const double *left, *right;    /* (entries, inner), (inner, entries) */
  const int32_t *end;            /* (bars, 2): places of nodes */
  const double *axis, *share;    /* (bars, d); (bars, 2): of a stretch, how far each end moves */
  const double *square;          /* (bars), m^2: of lengths */
  const double *spread, *offset; /* (strings, inputs), (strings): of values by inputs; null: as they are */
  const double *taut;            /* (strings): which pull; null: those of which states say it */
} Reduced;

/* Values that are limited: of all strings, of force densities from one row on, N/m, and tensions, N,
   each -1 where there are none; of places of nodes at the end of a sample. */
typedef struct {
  int32_t count, density, tension, nodes;
  int32_t at_end; /* whether strings are limited at the ends of samples, not at their starts */
  int32_t node_rows;
  const double *on_nodes; /* (node_rows, entries) */
} Rows;

/* Work memory of the calls below, as a count of numbers, for so many rows. */
EXPORTED size_t tc_reduced_work_size(const Reduced *plant, int32_t rows);

/* States after so many steps of RK4, each of a length, s, from states with held inputs, (count, .); after
   no steps accelerations q'' instead. Their derivatives by states, (count, 2 coordinates, .), and by
   inputs, (count, inputs, .), or null. */
EXPORTED void tc_reduced_motion(const Reduced *plant, int32_t count, int32_t steps, double length,
                                const double *states, const double *inputs, double *ends, double *by_state,
                                double *by_input, double *work);

/* Values of rows, (count, rows), with states at starts and ends of samples, one row each. Their derivatives
   by the state at the start, the input, and the state at the end, (count, ., rows): what is never other
   than zero is not written. */
EXPORTED void tc_reduced_rows(const Reduced *plant, const Rows *rows, int32_t count, const double *states,
                              const double *inputs, const double *ends, double *values, double *by_state,
                              double *by_input, double *by_end, double *work);

/* The same by the instructions of one kind of machines. */
typedef size_t ReducedSize(const Reduced *plant, int32_t rows);
typedef void ReducedMotion(const Reduced *plant, int32_t count, int32_t steps, double length,
                           const double *states, const double *inputs, double *ends, double *by_state,
                           double *by_input, double *work);
typedef void ReducedRows(const Reduced *plant, const Rows *rows, int32_t count, const double *states,
                         const double *inputs, const double *ends, double *values, double *by_state,
                         double *by_input, double *by_end, double *work);
ReducedSize reduced_size_by_all, reduced_size_by_avx2, reduced_size_by_avx512;
ReducedMotion reduced_by_all, reduced_by_avx2, reduced_by_avx512;
ReducedRows reduced_rows_by_all, reduced_rows_by_avx2, reduced_rows_by_avx512;

#endif
