/* The calls of the core. */
#include "motion.h"

#include <math.h>
#include <string.h>

#include "methods.h"

size_t tc_motion_work_size(const Scene *s, const Drive *drive) {
  return span_size(s, drive) + METHOD_STATES * 2 * (size_t)s->free + s->entries;
}

void tc_slope(const Scene *s, const Drive *drive, const double *state, const double *taut, double *slope,
              double *work) {
  Span span;
  begin(&span, s, drive, 0, work);
  slope_at(&span, state, 0, taut, slope);
}

void tc_gap(const Scene *s, const Drive *drive, const double *state, double *gap, double *rate,
            double *work) {
  Span span;
  begin(&span, s, drive, 0, work);
  gap_at(&span, state, 0, 0, gap, rate);
}

void tc_taut(const Scene *s, const Drive *drive, const double *state, double *taut, double *work) {
  Span span;
  begin(&span, s, drive, 0, work);
  gap_at(&span, state, 0, 0, span.gap, span.rate);
  for (int i = 0; i < span.switches; ++i) taut[i] = span.gap[i] > 0;
}

/* What a span by dop853 begins with; see `tc_begin`. */
static double begin_dop853(Span *span, const double *state, double *taut, double *slope, double *forces) {
  const Scene *s = span->scene;
  const Input input = input_at(span, 0);
  double largest = 0, not_finite = 0;
  gap_at(span, state, 0, 0, span->gap, span->rate);
  for (int i = 0; i < span->switches; ++i) taut[i] = span->gap[i] > 0;
  slope_at(span, state, 0, taut, slope);
  forces_of(s, state, &input, taut, forces, span->work);
  for (int i = 0; i < s->free; ++i) {
    const double on_free = forces[s->free_row ? s->free_row[i] : i];
    largest = fmax(fabs(on_free), largest);
    not_finite += on_free * 0;
  }
  return largest + not_finite;
}

double tc_begin(const Scene *s, const Drive *drive, const double *state, double *taut, double *slope,
                double *work) {
  Span span;
  double *forces = begin(&span, s, drive, 0, work);
  return begin_dop853(&span, state, taut, slope, forces);
}

void tc_restore(const Scene *s, const Drive *drive, const Lengths *lengths, double *state, double *work) {
  Span span;
  begin(&span, s, drive, lengths, work);
  restore_bars(&span, state, 0);
}

double tc_frequency(const Scene *s, const Drive *drive, const double *state, double difference,
                    const double *vector, double *work) {
  Span span;
  double *rest = begin(&span, s, drive, 0, work);
  return frequency_of(&span, state, difference, vector, rest);
}

double *next_output(Kept *kept) {
  if (kept->waiting == GATHERED) write_outputs(kept);
  return kept->rows + (size_t)kept->n * kept->waiting++;
}

void write_outputs(Kept *kept) {
  for (int i = 0; i < kept->n; ++i) {
    double *to = kept->states + (size_t)i * kept->columns + kept->column;
    for (int j = 0; j < kept->waiting; ++j) to[j] = kept->rows[(size_t)j * kept->n + i];
  }
  kept->column += kept->waiting;
  kept->waiting = 0;
}

void keep_step(Kept *kept, Progress *now, double time, const double *x, const double *taut) {
  const size_t n = kept->n, m = kept->switches;
  if (!kept->room || ++now->since < now->every) return;
  now->since = 0;
  if (now->kept == kept->room) {
    now->kept /= 2;
    now->since = now->every;
    now->every *= 2;
    for (int i = 0; i < now->kept; ++i) {
      kept->step_times[i] = kept->step_times[2 * i + 1];
      memcpy(kept->step_states + i * n, kept->step_states + (2 * i + 1) * n, n * sizeof *x);
    }
    return;
  }
  kept->step_times[now->kept] = time;
  if (kept->step_taut) memcpy(kept->step_taut + now->kept * m, taut, m * sizeof *taut);
  memcpy(kept->step_states + now->kept++ * n, x, n * sizeof *x);
}

int32_t tc_advance(const Scene *scene, const Drive *drive, const Lengths *lengths, const Settings *settings,
                   Progress *progress, double *state, double *slope, double *taut, double *states,
                   double *step_times, double *step_states, double *step_taut, double *work) {
  Span span;
  double *rest = begin(&span, scene, drive, settings->projects ? lengths : 0, work);
  const int n = span.states;
  Kept kept = {states,
               step_times,
               step_states,
               settings->traces ? step_taut : 0,
               rest + (size_t)(METHOD_STATES - GATHERED) * n,
               n,
               span.switches,
               settings->outputs + 1,
               0,
               0,
               settings->room};
  int done;
  if (settings->method == DOP853_METHOD)
    done = advance_by_dop853(&span, settings, progress, &kept, state, slope, taut, rest);
  else done = advance_by_rk4(&span, settings, progress, &kept, state, taut, rest);
  write_outputs(&kept);
  return done;
}

/* What the steps of dop853 may err, and how long they are, from a state: the rules of
   integrator.scale_under and dop853.steps_of. */
static void set_steps(const Spans *spans, int half, const double *state, double force, const double *slope,
                      double *scale, Settings *settings) {
  const double duration = settings->duration;
  double fastest = 0, speed, rate = 0;
  for (int i = half; i < 2 * half; ++i) fastest = fmax(fabs(state[i]), fastest);
  speed =
      fmax(fmax(fastest, sqrt(force * spans->length / spans->mass)), 1e-3 * spans->length * spans->frequency);
  if (!(speed > 0)) speed = spans->length;
  for (int i = 0; i < 2 * half; ++i) {
    scale[i] = i < half ? spans->length : speed;
    rate = fmax(fabs(slope[i]) / scale[i], rate);
    scale[i] *= spans->tolerance;
  }
  settings->step = spans->first * fmin(0.01 / fmax(rate, 1e-300), duration);
  settings->longest = fmin(spans->stable / fmax(spans->frequency, 1e-300), spans->whole * duration);
  settings->scale = scale;
}

void tc_start(const Scene *scene, const Drive *drive, const Spans *rules, Settings *settings,
              const double *state, double *taut, double *slope, double *scale, double *work) {
  const double force = tc_begin(scene, drive, state, taut, slope, work);
  set_steps(rules, scene->free, state, force, slope, scale, settings);
}

int32_t tc_advance_spans(const Scene *scene, const Drive *drive, const Lengths *lengths,
                         const Settings *settings, const Spans *spans, Progress *progress, double *state,
                         double *states, double *step_times, double *step_states, double *step_taut,
                         double *work) {
  const size_t numbers = (size_t)drive->count * (drive->degree + 1), m = scene->switches;
  const size_t n = 2 * (size_t)scene->free;
  Settings own = *settings;
  Drive held = *drive;
  Span span;
  double *rest = begin(&span, scene, &held, settings->projects ? lengths : 0, work);
  double *x = rest + METHOD_STATES * n + scene->entries, *slope = x + n, *scale = slope + n;
  double *taut = scale + n;
  for (int k = 0; k < spans->count; ++k) {
    Progress *now = progress + k;
    Kept kept = {states,
                 step_times,
                 step_states,
                 settings->traces ? step_taut : 0,
                 rest + (METHOD_STATES - GATHERED) * n,
                 (int)n,
                 (int)m,
                 spans->outputs[k] + 1,
                 0,
                 0,
                 own.room};
    int done;
    held.coefficients = spans->inputs + (numbers + (held.degree > 0)) * k;
    if (held.degree) held.begin = held.coefficients[numbers];
    own.duration = spans->duration[k];
    own.outputs = spans->outputs[k];
    memcpy(x, state, n * sizeof *x);
    memset(now, 0, sizeof *now);
    now->every = 1;
    if (settings->method != DOP853_METHOD) {
      now->step = own.step;
      gap_at(&span, x, 0, 0, span.gap, span.rate);
      for (size_t i = 0; i < m; ++i) taut[i] = span.gap[i] > 0;
      done = advance_by_rk4(&span, &own, now, &kept, x, taut, rest);
    } else {
      const double force = begin_dop853(&span, x, taut, slope, rest);
      set_steps(spans, scene->free, x, force, slope, scale, &own);
      now->step = own.step;
      done = advance_by_dop853(&span, &own, now, &kept, x, slope, taut, rest);
      own.limit -= tc_evaluations(now);
    }
    if (done < own.outputs || now->stuck || now->every > 1) return k;
    write_outputs(&kept);
    for (size_t i = 0; i < n; ++i) states[i * (own.outputs + 1)] = state[i];
    memcpy(state, x, n * sizeof *x);
    states += n * (own.outputs + 1);
    step_times += now->kept;
    step_states += n * now->kept;
    if (settings->traces) step_taut += m * now->kept;
    own.room -= own.room ? now->kept + now->kept % 2 : 0;
    own.budget -= (int32_t)now->tries;
    if (settings->room && own.room <= 0) return k + 1;
  }
  return spans->count;
}
