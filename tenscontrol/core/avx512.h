/* What follows is compiled for AVX-512: lanes of 8 numbers. For clang, a file that includes this ends
   in "#pragma clang attribute pop". */
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx512f,avx512dq"))), apply_to = function)
#else
#pragma GCC target("avx512f,avx512dq")
#endif
#undef WIDE
#define WIDE
#define LANES 8
