/* The matrix of bars that share nodes. */
#ifndef TENSCONTROL_BLOCKS_H
#define TENSCONTROL_BLOCKS_H

#include "core.h"
#include "numbers.h"

SHARED void factorize(const Scene *scene, Number *factors);
SHARED void solve(const Scene *scene, const Number *factors, Number *right);

#endif
