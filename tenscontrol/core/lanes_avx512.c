/* Runs side by side by AVX-512, where the compiler knows it; the machine is asked by lanes.c. */
#include "lanes.h"

#ifdef HAS_WIDE_LANES
#include "avx512.h"
#define LANES_NAME(name) LANES_NAME_##name
#define LANES_NAME_advance advance_by_avx512
#define LANES_NAME_size avx512_size
#define LANES_NAME_begin begin_by_avx512
#include "lanes_body.h"
#ifdef __clang__
#pragma clang attribute pop
#endif
#endif
