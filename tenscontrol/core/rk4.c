/* The classical Runge-Kutta method of order 4, in fixed steps that are cut at switches. */
#include <math.h>
#include <string.h>

#include "kernels.h"
#include "methods.h"

/* Cuts of a step, at most; the rest is then taken whole, and its switches are carried or, where that
   cannot be, counted. What is left below this part of a step is round-off. How late a step ends, as part of the length of a string. */
enum { MOST_CUTS = 9 };
static const double REST = 1e-13, LATE = 1e-9;

typedef struct {
  Span *span;
  const double *x, *taut;
  double time, h;
  double *k1, *k2, *k3, *k4, *y;
} Rk4;

WIDE static void combine(const double *restrict x, double h, const double *restrict k,
                         double *restrict y, int n) {
  for (int i = 0; i < n; ++i) y[i] = x[i] + h * k[i];
}

WIDE static void finish(const double *restrict x, double h, const double *restrict k1,
                        const double *restrict k2, const double *restrict k3,
                        const double *restrict k4, double *restrict y, int n) {
  for (int i = 0; i < n; ++i) y[i] = x[i] + h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}

/* A step of a part of h. */
static void step_to(void *by, double part, double *x1) {
  Rk4 *m = by;
  Span *span = m->span;
  const int n = span->states;
  const double h = part * m->h;
  slope_at(span, m->x, m->time, m->taut, m->k1);
  combine(m->x, h / 2, m->k1, m->y, n);
  slope_at(span, m->y, m->time + h / 2, m->taut, m->k2);
  combine(m->x, h / 2, m->k2, m->y, n);
  slope_at(span, m->y, m->time + h / 2, m->taut, m->k3);
  combine(m->x, h, m->k3, m->y, n);
  slope_at(span, m->y, m->time + h, m->taut, m->k4);
  finish(m->x, h, m->k1, m->k2, m->k3, m->k4, x1, n);
  restore_bars(span, x1);
}

int advance_by_rk4(Span *span, const Settings *settings, Progress *now, double *x, double *taut,
                   double *states, double *work) {
  const int n = span->states;
  const double spacing = settings->duration / settings->outputs;
  /* The small allowance lets 0.02/0.001 be 20 steps, whatever round-off says. */
  const double between = ceil(spacing / settings->step - 1e-9);
  const int64_t inner = between > 1 ? (int64_t)between : 1, total = inner * settings->outputs;
  const double h = settings->duration / (double)total;
  double *x1 = work, *slope = x1 + n, *slope1 = slope + n;
  Rk4 method = {span, x, taut, 0, 0, slope1 + n, slope1 + 2 * n, slope1 + 3 * n, slope1 + 4 * n,
                slope1 + 5 * n};
  const int may_carry = !velocity_dependent(span->scene);
  int64_t done = (int64_t)round(now->time / h);
  for (int tried = 0; tried < settings->budget && done < total; ++tried) {
    double left = h, time = (double)done * h;
    for (int cuts = 0; left > REST * h; ++cuts) {
      const Tried step = {x, x1, slope, slope1, taut, time, left};
      double taken = left;
      int crossed;
      method.time = time;
      method.h = left;
      step_to(&method, 1, x1);
      now->tries += 1;
      crossed = span->switches ? crossings(span, &step) : 0;
      if (crossed && cuts >= MOST_CUTS && !may_carry) {
        now->missed += missed_switches(span, &step);
        gap_at(span, x1, time + left, span->gap, span->rate);
        for (int i = 0; i < span->switches; ++i) taut[i] = span->gap[i] > 0;
      } else if (crossed) {
        memcpy(slope, method.k1, n * sizeof *slope);
        slope_at(span, x1, time + left, taut, slope1);
        if (may_carry && (crossed > MANY_SWITCHES || cuts >= MOST_CUTS)) {
          const int count = carry(span, &step, x1, taut, 0);
          now->carries += 1;
          now->carried += count;
          now->switches += count;
        } else {
          const Cut cut = first_switch(span, &step, 0, LATE);
          now->landings += 1;
          if (cut.found) {
            int places;
            taken = left * approach(span, &step, cut, step_to, &method, x1, &places);
            now->switches += switch_over(span, x1, time + taken, taut);
            now->tries += places;
          }
        }
      }
      memcpy(x, x1, n * sizeof *x);
      time += taken;
      left -= taken;
    }
    ++done;
    now->time = (double)done * h;
    for (int i = 0; i < n; ++i)
      if (!isfinite(x[i])) {
        now->stuck = 1;
        return (int)((done - 1) / inner);
      }
    if (done % inner == 0) memcpy(states + (done / inner - 1) * n, x, n * sizeof *x);
  }
  return (int)(done / inner);
}
