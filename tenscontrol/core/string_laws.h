/* What a string does by a law. */
#ifndef TENSCONTROL_STRING_LAWS_H
#define TENSCONTROL_STRING_LAWS_H

#include "core.h"
#include "kernels.h"

/* A law, with damping or without. */
typedef struct {
  int kind, is_damped;
} StringLaw;

static inline StringLaw law_of(const Scene *s) {
  const StringLaw law = {s->law, s->damped};
  return law;
}

/* The force density of a string if it is taut, N/m, by its stiffness k and its damping c. */
static inline Number force_density(StringLaw law, Number k, Number c, Number length, Number rate,
                                   Number rest) {
  Number gamma;
  if (law.kind == LINEAR_STRINGS && !law.is_damped) linear_undamped_force_density(length, rest, k, &gamma);
  else if (law.kind == LINEAR_STRINGS) linear_damped_force_density(length, rest, rate, k, c, &gamma);
  else if (!law.is_damped) elastic_undamped_force_density(length, rest, k, &gamma);
  else elastic_damped_force_density(length, rest, rate, k, c, &gamma);
  return gamma;
}

/* How far it is from slack, m. */
static inline Number string_gap(StringLaw law, Number k, Number c, Number length, Number rate, Number rest) {
  Number gap = length - rest;
  if (law.is_damped && law.kind == LINEAR_STRINGS) linear_damped_gap(length, rest, rate, k, c, &gap);
  else if (law.is_damped) elastic_damped_gap(length, rest, rate, k, c, &gap);
  return gap;
}

#endif
