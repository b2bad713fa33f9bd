/* The numbers that equations are written in: one of one run, or one each of several runs, in lanes.

   A file that defines LANES, how many, before it includes others has them in lanes; operators then act on each
   run by itself, in the same order, so to the same bits. Compilers without vectors have one lane. */
#ifndef TENSCONTROL_NUMBERS_H
#define TENSCONTROL_NUMBERS_H

#include <math.h>

#ifdef LANES
#define SHARED static inline
#else
#define SHARED
#endif

#if defined(LANES) && defined(__GNUC__)
enum { WIDTH = LANES };
typedef double Number __attribute__((vector_size(8 * LANES), aligned(8)));
typedef long long Truth __attribute__((vector_size(8 * LANES), aligned(8))); /* -1 or 0 */

static inline Number all(double x) { return x - (Number){0}; }
static inline Number choice(Truth which, Number x, Number y) {
  return (Number)((which & (Truth)x) | (~which & (Truth)y));
}
static inline double lane(const Number *x, int i) { return (*x)[i]; }
static inline void put(double x, Number *to, int i) { (*to)[i] = x; }
static inline int is_in(Truth which, int i) { return which[i] != 0; }
static inline int any(Truth which) {
  long long bits = 0;
  for (int i = 0; i < WIDTH; ++i) bits |= which[i];
  return bits != 0;
}
static inline Number root(Number x) {
  for (int i = 0; i < WIDTH; ++i) x[i] = sqrt(x[i]);
  return x;
}
static inline Number power(Number x, double exponent) {
  for (int i = 0; i < WIDTH; ++i) x[i] = pow(x[i], exponent);
  return x;
}
#else
enum { WIDTH = 1 };
typedef double Number;
typedef int Truth;

static inline Number all(double x) { return x; }
static inline Number choice(Truth which, Number x, Number y) { return which ? x : y; }
static inline double lane(const Number *x, int i) { return x[i]; }
static inline void put(double x, Number *to, int i) { to[i] = x; }
static inline int is_in(Truth which, int i) { return which && !i; }
static inline int any(Truth which) { return which != 0; }
static inline Number root(Number x) { return sqrt(x); }
static inline Number power(Number x, double exponent) { return pow(x, exponent); }
#endif

/* Calls of the library's fmax and fmin would keep loops from being fast; these give the same. */
static inline Number larger(Number x, Number y) { return choice((x > y) | (y != y), x, y); }
static inline Number smaller(Number x, Number y) { return choice((x < y) | (y != y), x, y); }
static inline Number truth(Truth is) { return choice(is, all(1), all(0)); }
static inline Number only(Truth where, Number x) { return choice(where, x, all(0)); }
static inline Number positive(Number x) { return choice(x < 0, -x, x); }

/* Tables of a scene: numbers of one run, or of those in the lanes. */
static inline const Number *numbers(const double *table) { return (const Number *)table; }

#endif
