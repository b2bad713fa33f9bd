/* What many runs begin with: largest frequencies, forces and slopes, of several at once. */

/* Memory: states and what is a run's own, slopes, what pulls, forces, and that of the frequency. */
static size_t begin_runs_size(const Scene *scene, const Drive *drive, const Runs *runs) {
  return table_size(scene, drive, runs, 1) + 4 * (size_t)scene->free + scene->switches + scene->entries +
         frequency_size(scene) + shared_size(scene, drive, runs);
}

void LANES_NAME(begin)(const Scene *scene, const Drive *drive, const Runs *runs, const double *start,
                       const double *difference, const double *vector, double *frequency, double *force,
                       double *slope, double *taut, double *work) {
  const int n = 2 * scene->free, m = scene->switches;
  Batch batch;
  Number *own = share(&batch, scene, drive, 0, runs, aligned(work));
  Number *x = own + table_size(scene, drive, runs, 1), *slopes = x + n, *pulls = slopes + n;
  Number *forces = pulls + m, *rest = forces + scene->entries;
  Span *span = &batch.span;
  for (int first = 0; first < runs->count; first += WIDTH) {
    Number differences = all(0), largest = all(0), not_finite = all(0), frequencies;
    Input input;
    for (int i = 0; i < WIDTH; ++i) {
      const int run = first + i < runs->count ? first + i : runs->count - 1;
      put_row(start, run, n, x, i);
      put_own(&batch, run, own, i);
      put(difference[run], &differences, i);
    }
    use_own(&batch, own);
    gap_at(span, x, all(0), 0, span->gap, span->rate);
    for (int i = 0; i < m; ++i) pulls[i] = truth(span->gap[i] > 0);
    slope_at(span, x, all(0), pulls, slopes);
    input = input_at(span, all(0));
    forces_of(span->scene, x, &input, pulls, forces, span->work);
    for (int i = 0; i < scene->free; ++i) {
      const Number on_free = forces[scene->free_row ? scene->free_row[i] : i];
      largest = larger(positive(on_free), largest);
      not_finite += on_free * 0;
    }
    frequencies = frequency ? frequency_of(span, x, differences, vector, rest) : all(0);
    largest += not_finite;
    for (int i = 0; i < WIDTH && first + i < runs->count; ++i) {
      if (frequency) frequency[first + i] = lane(&frequencies, i);
      force[first + i] = lane(&largest, i);
      take_row(slopes, i, n, slope, first + i);
      take_row(pulls, i, m, taut, first + i);
    }
  }
}
