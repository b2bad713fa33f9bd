/* Small changes of steps by the instructions that every machine has, and the choice of wider ones. */
#include "variations.h"

#include "lanes.h"

#undef WIDE
#define WIDE
#define LANES 2
#define LANES_NAME(name) name##_by_all
#include "variations_lanes.h"
#include "reduced_lanes.h"

size_t tc_variations_work_size(const Scene *scene, const Drive *drive, const Tableau *method,
                               int32_t columns) {
  VariationsSize *size = WIDEST(variations_size_by_avx512, variations_size_by_avx2, variations_size_by_all);
  return size(scene, drive, method, columns);
}

void tc_tangents(const Scene *scene, const Drive *drive, const Lengths *lengths, const Tableau *method,
                 const Steps *steps, const Switches *switches, const Changes *changes, double *X,
                 double *work) {
  Variations *tangents = WIDEST(tangents_by_avx512, tangents_by_avx2, tangents_by_all);
  tangents(scene, drive, lengths, method, steps, switches, changes, X, work);
}

void tc_costs(const Scene *scene, const Drive *drive, const Lengths *lengths, const Tableau *method,
              const Steps *steps, const Switches *switches, const Changes *costs, double *mu, double *work) {
  Variations *by = WIDEST(costs_by_avx512, costs_by_avx2, costs_by_all);
  by(scene, drive, lengths, method, steps, switches, costs, mu, work);
}

void tc_accelerations(const Scene *scene, const Drive *drive, const Steps *steps, double *accelerations,
                      double *work) {
  Accelerations *of = WIDEST(accelerations_by_avx512, accelerations_by_avx2, accelerations_by_all);
  of(scene, drive, steps, accelerations, work);
}

size_t tc_reduced_work_size(const Reduced *plant, int32_t rows) {
  return WIDEST(reduced_size_by_avx512, reduced_size_by_avx2, reduced_size_by_all)(plant, rows);
}

void tc_reduced_motion(const Reduced *plant, int32_t count, int32_t steps, double length,
                       const double *states, const double *inputs, double *ends, double *by_state,
                       double *by_input, double *work) {
  ReducedMotion *motion = WIDEST(reduced_by_avx512, reduced_by_avx2, reduced_by_all);
  motion(plant, count, steps, length, states, inputs, ends, by_state, by_input, work);
}

void tc_reduced_rows(const Reduced *plant, const Rows *rows, int32_t count, const double *states,
                     const double *inputs, const double *ends, double *values, double *by_state,
                     double *by_input, double *by_end, double *work) {
  ReducedRows *of = WIDEST(reduced_rows_by_avx512, reduced_rows_by_avx2, reduced_rows_by_all);
  of(plant, rows, count, states, inputs, ends, values, by_state, by_input, by_end, work);
}
