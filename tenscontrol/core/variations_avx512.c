/* Small changes of steps by AVX-512, where the compiler knows it; the machine is asked by lanes.c. */
#include "variations.h"

#include "lanes.h"

#ifdef HAS_WIDE_LANES
#include "avx512.h"
#define LANES_NAME(name) name##_by_avx512
#include "variations_lanes.h"
#include "reduced_lanes.h"
#ifdef __clang__
#pragma clang attribute pop
#endif
#endif
