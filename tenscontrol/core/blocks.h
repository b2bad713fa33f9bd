/* The matrix of bars that share nodes. */
#ifndef TENSCONTROL_BLOCKS_H
#define TENSCONTROL_BLOCKS_H

#include "core.h"

void factorize(const Scene *scene, double *factors);
void solve(const Scene *scene, const double *factors, double *right);

#endif
