/* Small changes of steps by AVX2, where the compiler knows it; the machine is asked by lanes.c. */
#include "variations.h"

#include "lanes.h"

#ifdef HAS_WIDE_LANES
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC target("avx2")
#endif
#undef WIDE
#define WIDE
#define LANES 4
#define LANES_NAME(name) name##_by_avx2
#include "variations_lanes.h"
#ifdef __clang__
#pragma clang attribute pop
#endif
#endif
