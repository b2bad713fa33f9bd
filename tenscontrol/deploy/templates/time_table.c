
/* ---- what depends on time alone ---- */

/* Copy the row of the sample nearest to a time. */
static const double *row_at(double time, double *row) {
  copy(row, first_row, ROW_LENGTH);
#if VARYING > 0
  {
    double nearest = clamp(floor(time / CONTROLLER_STEP + 0.5), FIRST_SAMPLE, LAST_SAMPLE);
    const double *changed = table[(int)(nearest - FIRST_SAMPLE)];
    int i;
    for (i = 0; i < VARYING; i++) row[varying[i]] = changed[i];
  }
#else
  (void)time;
#endif
  return row;
}
