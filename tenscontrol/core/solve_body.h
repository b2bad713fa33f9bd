/* SOLVE(s, K, y): by the factors K of bars that share nodes; the right-hand side y becomes the solution.
   FACTOR and ENTRY are the kinds of numbers of both: included by files once for each pair. */
static inline void SOLVE(const Scene *s, const FACTOR *K, ENTRY *y) {
  const FACTOR *inverse = K + s->factors;
  const int32_t *row = s->factor_row, *first = s->factor_first;
  for (int c = 0; c < s->unknowns; ++c)
    for (int k = first[c]; k < first[c + 1]; ++k) y[row[k]] -= K[k] * inverse[c] * y[c];
  for (int c = s->unknowns - 1; c >= 0; --c) {
    ENTRY sum = y[c];
    for (int k = first[c]; k < first[c + 1]; ++k) sum -= K[k] * y[row[k]];
    y[c] = sum * inverse[c];
  }
}
#undef SOLVE
#undef FACTOR
#undef ENTRY
