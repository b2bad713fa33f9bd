/* What follows is compiled for AVX2: lanes of 4 numbers. For clang, a file that includes this ends
   in "#pragma clang attribute pop". */
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC target("avx2")
#endif
#undef WIDE
#define WIDE
#define LANES 4
