/* The largest of many numbers, in wide registers. */
#ifndef TENSCONTROL_LARGEST_H
#define TENSCONTROL_LARGEST_H

#include "core.h"

/* Raises numbers to others; what is none becomes and stays none. */
WIDE static void raise_numbers(const double *restrict others, int count, double *restrict numbers) {
  for (int i = 0; i < count; ++i) {
    const double one = numbers[i], other = others[i];
    numbers[i] = (one >= other) | (one != one) ? one : other;
  }
}

/* Raises `to` to the largest of some numbers, which are used up. */
static inline void raise_to_largest(int count, double *numbers, double *to) {
  for (int half; count > 1; count -= half) {
    half = count / 2;
    raise_numbers(numbers + count - half, half, numbers);
  }
  raise_numbers(numbers, count, to);
}

#endif
