"""The loop of DOP853 over its steps in C: the same numbers as CasADi's graph, without its copies.

Slopes, projections and what finds a switch are CasADi's C code; here are the sums of slopes, the
error, the interpolant, and what becomes of a step that was tried.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from tenscontrol.dynamics.forms.loops import C_EXPORT, C_HEAD, external_interface
from tenscontrol.dynamics.forms.packed_code import PACKED_HEAD, packed_source

# Functions that are called so often that they are worth the time of the compiler.
_OFTEN = ("slope", "room")

# Names of numbers in z that another constant has.
_NUMBERS = {"switches": "SWITCHED"}


def loop_source(
    functions: Sequence[ca.Function],
    sizes: Mapping[str, int],
    numbers: Mapping[str, float],
    carried: Sequence[str],
    method: Any,
    share: Sequence[float],
) -> str:
    """Return the C text of ``turns(z, given) -> (z, records)``, of ``largest`` and of ``exact``.

    The first is many turns of :class:`DOP853`, the second is the last of ``functions``, by which
    the largest frequency is found, the third makes bars rigid, if one of them does. ``functions``
    are called by name, ``sizes`` and ``numbers`` are constants of the text, ``carried``
    names the numbers in z, ``method`` has the coefficients, and ``share`` is the polynomial of what
    the interpolant errs.
    """
    n, switches, inputs = (sizes[name] for name in ("STATES", "SWITCHES", "INPUTS"))
    kernels, packed = ca.CodeGenerator("kernels", {"with_header": False}), []
    for each in functions:
        text = packed_source(each) if each.name() in _OFTEN else None
        packed += [] if text is None else [text]
        if text is None:
            kernels.add(each)
    memory = {
        name: max(1, *(getattr(each, f"sz_{name}")() for each in functions))
        for name in ("arg", "res", "iw", "w")
    }
    first = len(method.B) + 1  # slope that the interpolant adds
    slopes = first + len(method.C_EXTRA)
    z, given = 2 * n + switches + len(carried), inputs + 3 + n
    constants = {
        **sizes,
        **{name: repr(float(value)) for name, value in numbers.items()},
        **{_NUMBERS.get(each, each.upper()): i for i, each in enumerate(carried)},
        "NUMBERS": len(carried),
        **{f"{name.upper()}_SIZE": size for name, size in memory.items()},
        "END_SLOPE": f"({first - 1} * STATES)",
        "SLOPES": f"({slopes} * STATES)",
        "COEFFICIENTS": len(method.D) + 3,
        "WORK": memory["w"] + (2 * slopes + 8 + len(method.D)) * n + 2 * inputs + 5 * switches,
        **{f"HAS_{each.name().upper()}": 1 for each in functions},
    }
    parts = {
        "share": _horner(share, "wanted"),
        "stages": _stages(method.A[1:], method.C[1:], 1),
        "end": _sum(method.B),
        "fifth": _sum(method.E5),
        "third": _sum(method.E3),
        "extra": _stages(method.A_EXTRA, method.C_EXTRA, first),
        "dense": "\n".join(
            f"  for (int i = 0; i < STATES; ++i) made[{3 + k} * STATES + i] = h * ({_sum(d)});"
            for k, d in enumerate(method.D)
        ),
    }
    return "\n".join(
        [
            C_HEAD,
            kernels.dump(),
            C_EXPORT,
            PACKED_HEAD,
            *packed,
            *(f"#define {name} {value}" for name, value in constants.items()),
            _TEXT % parts,
            external_interface("turns", [z, given], [z, sizes["RECORD"] * sizes["TURNS"]]),
            external_interface("largest", [n, inputs, switches, 1, n // 2], [1]),
            external_interface("exact", [n], [n]),
        ]
    )


def _sum(weights: Any) -> str:
    """Return the C expression of entry i of the sum of slopes with weights, but those of zero."""
    used = [(k, float(a)) for k, a in enumerate(weights) if a != 0]
    return " + ".join(f"K[{k} * STATES + i] * {a!r}" for k, a in used)


def _horner(coefficients: Sequence[float], variable: str) -> str:
    """Return the C expression of a polynomial, given by its coefficients from the lowest on."""
    *lower, text = (repr(float(a)) for a in coefficients)
    for each in reversed(lower):
        text = f"({each} + {variable} * {text})"
    return text


def _stages(weights: Any, times: Any, first: int) -> str:
    """Return the C lines of stages, each a state within the step and its slope."""
    return "\n".join(
        f"  for (int i = 0; i < STATES; ++i) y[i] = x[i] + h * ({_sum(a)});\n"
        f"  of_slope(y, ahead(u, {float(c)!r} * h, m), taut, K + {k} * STATES, m);"
        for k, (a, c) in enumerate(zip(weights, times, strict=True), first)
    )


_TEXT = """\
#ifndef HAS_PROJECT
#define project(arg, res, iw, w, mem) (memcpy(res[0], arg[0], STATES * sizeof(double)), 0)
#endif

typedef struct {
  casadi_int *iw;
  double *w, *y, *later;
} Memory;

static const double *ahead(const double *u, double time, const Memory *m) {
  if (!DEGREE) return u;
  memcpy(m->later, u, INPUTS * sizeof(double));
  m->later[INPUTS - 1] += time;
  return m->later;
}

static void of_slope(const double *x, const double *u, const double *taut, double *to,
                     const Memory *m) {
  const double *arg[ARG_SIZE];
  double *res[RES_SIZE];
  arg[0] = x; arg[1] = u; arg[2] = taut; res[0] = to;
  slope(arg, res, m->iw, m->w, 0);
}

/* A state of bars that keep their lengths. */
static void of_rigid(const double *y, double *to, const Memory *m) {
  const double *arg[ARG_SIZE] = {y};
  double *res[RES_SIZE] = {to};
  project(arg, res, m->iw, m->w, 0);
}

/* A step from x with slope K[0]: its end, and the slopes of all stages in K. */
WIDE static void step_of(const double *x, const double *u, const double *taut, double h,
                    double *restrict x1, double *restrict K, const Memory *m) {
  double *restrict y = m->y;
%(stages)s
  for (int i = 0; i < STATES; ++i) y[i] = x[i] + h * (%(end)s);
  of_rigid(y, x1, m);
}

WIDE static double error_of(const double *K, const double *scale, double h) {
  double fifth = 0, third = 0, below;
  for (int i = 0; i < STATES; ++i) {
    const double a = (%(fifth)s) / scale[i], b = (%(third)s) / scale[i];
    fifth += a * a;
    third += b * b;
  }
  below = sqrt((fifth + 0.01 * third) * STATES);
  return below > 0 && below < INFINITY ? h * fifth / below : below;
}

static double factor_of(double error) {
  return fmin(fmax(SAFETY * pow(fmax(error, 1e-16), -1 / ORDER), LEAST), MOST);
}

/* Whether an output lies in a step. */
static int is_asked(double time, double after, double duration, double spacing) {
  const double until = floor(after / spacing * MORE), since = floor(time / spacing * MORE);
  return until > since && (after < duration || time + spacing < after);
}

/* The coefficients of the interpolant of a step. */
WIDE static void interpolate(const double *x, const double *x1, double *restrict K, const double *u,
                        const double *taut, double h, double *restrict made, const Memory *m) {
  const double *f = K, *f1 = K + END_SLOPE;
  double *restrict y = m->y;
%(extra)s
  for (int i = 0; i < STATES; ++i) {
    const double step = x1[i] - x[i];
    made[i] = step;
    made[STATES + i] = h * f[i] - step;
    made[2 * STATES + i] = 2 * step - h * (f1[i] + f[i]);
  }
%(dense)s
}

/* The state on the interpolant of a step of length h. */
WIDE static void inside(const double *x, const double *made, double h, double taken, double *to,
                   const Memory *m) {
  const double part = taken / h;
  double *y = m->y;
  for (int i = 0; i < STATES; ++i) {
    double value = 0;
    for (int k = COEFFICIENTS - 1; k >= 0; --k)
      value = (value + made[k * STATES + i]) * (k %% 2 ? 1 - part : part);
    y[i] = x[i] + value;
  }
  of_rigid(y, to, m);
}

#ifdef HAS_CROSSING
static int is_crossed(const double *x, const double *x1, const double *u, const double *taut,
                      double h, const Memory *m) {
  const double *arg[ARG_SIZE];
  double *res[RES_SIZE], found = 0;
  arg[0] = x; arg[1] = x1; arg[2] = u; arg[3] = taut; arg[4] = &h; res[0] = &found;
  crossing(arg, res, m->iw, m->w, 0);
  return found != 0;
}

/* Closes in on the first sample that is out, else on the lowest; whether one is out. */
static int zoom(const double **arg, double *low, double *high, double *rooms, const Memory *m) {
  const double width = (*high - *low) / SAMPLES;
  double *res[RES_SIZE], least = INFINITY;
  int first = 0, last = 1;
  for (int j = 0; j < SAMPLES && !(least < 0); ++j) {
    const double at = *low + (j + 1) * width;
    double lowest = INFINITY;
    arg[4] = &at; res[0] = rooms;
    room(arg, res, m->iw, m->w, 0);
    for (int i = 0; i < SWITCHES; ++i) lowest = fmin(rooms[i], lowest);
    if (lowest < least) {
      first = j;
      last = lowest < 0 || j + 2 > SAMPLES ? j + 1 : j + 2;
      least = lowest;
    }
  }
  *high = *low + last * width;
  *low += first * width;
  return least < 0;
}

/* Ends a step at its first switch: its part, and x1 there; taut goes over to what follows. It ends
   on the interpolant where that is good enough, else by steps to the switch. */
static double land(const double *x, double *taut, const double *u, double h, double *x1, double *K,
                   double *made, int *is_inside, double error, double allowed, double *strings,
                   double *now, const Memory *m) {
  const double *arg[ARG_SIZE], *end;
  double *res[RES_SIZE], found = 0, wanted = 0, speed = 0, aim = 0, switched = 0;
  double part = 0, gap_before = 0, low = 0, high = 1, *chosen = strings;
  double *leaving = chosen + SWITCHES, *rooms = leaving + 2 * SWITCHES, *within = rooms + SWITCHES;
  int taken = 0;
  arg[0] = x; arg[1] = K; arg[2] = x1; arg[3] = K + END_SLOPE; arg[4] = &h; res[0] = within;
  interpolant(arg, res, m->iw, m->w, 0);
  arg[0] = within; arg[1] = u; arg[2] = taut; arg[3] = &h;
  for (int i = 0; i < ZOOMS; ++i) found = zoom(arg, &low, &high, rooms, m);
  if (!found) return h;
  arg[4] = &low; arg[5] = &high; arg[6] = &found; arg[7] = &allowed;
  res[0] = &wanted; res[1] = &speed; res[2] = &aim; res[3] = chosen; res[4] = leaving;
  first_out(arg, res, m->iw, m->w, 0);
  *is_inside = error * fabs(%(share)s) < SMOOTH;
  if (*is_inside) {
    interpolate(x, x1, K, u, taut, h, made, m);
    now[INTERPOLANTS] += 1;
  }
  for (int tried = 0; tried < POLISHES; ++tried) {
    double gap = 0, secant, before = part;
    int apart, flat;
    if (taken && !(fabs(gap_before - aim) > fabs(aim))) break;
    part = fmin(fmax(speed < 0 ? wanted : 0, 0), 1);
    if (*is_inside)
      inside(x, made, h, part * h, x1, m);
    else
      step_of(x, u, taut, part * h, x1, K, m);
    end = ahead(u, part * h, m);
    arg[0] = x1; arg[1] = end; arg[2] = taut; arg[3] = chosen; res[0] = &gap;
    distance(arg, res, m->iw, m->w, 0);
    apart = taken > 0 && fabs(part - before) > 1e-6;
    secant = (gap - gap_before) / (apart ? part - before : 1);
    flat = apart && fmax(gap, gap_before) < 0 && secant > FLAT * speed;
    if (apart && secant < 0 && !flat) speed = secant;
    wanted = part + (flat ? -2 * fabs(part - before) : (aim - gap) / speed);
    gap_before = gap;
    ++taken;
  }
  arg[0] = x1; arg[1] = ahead(u, part * h, m); arg[2] = taut; arg[3] = leaving;
  res[0] = strings + 2 * SWITCHES; res[1] = &switched;
  switching(arg, res, m->iw, m->w, 0);
  memcpy(taut, strings + 2 * SWITCHES, SWITCHES * sizeof(double));
  if (!*is_inside) now[APPROACHES] += taken;
  now[SWITCHED] += switched;
  return part * h;
}
#endif

EXPORTED int largest(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *given[ARG_SIZE];
  double *to[RES_SIZE];
  casadi_int own[IW_SIZE];
  (void)iw;
  memcpy(given, arg, 5 * sizeof(double *));
  to[0] = res[0];
  return frequency(given, to, own, w, mem);
}

EXPORTED int exact(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *given[ARG_SIZE] = {arg[0]};
  double *to[RES_SIZE] = {res[0]};
  casadi_int own[IW_SIZE];
  (void)iw; (void)own; (void)mem;
  return project(given, to, own, w, mem);
}

EXPORTED int turns(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *input = arg[1], *span = input + INPUTS, longest = span[2], *scale = span + 3;
  const double duration = span[0];
  double *z = res[0], *x = z, *f = z + STATES, *taut = f + STATES, *now = taut + SWITCHES;
  double *x1, *K, *made, *started, *begun, *strings;
  casadi_int own[IW_SIZE];
  int kept = 0;
  Memory memory = {own, w, w + W_SIZE, 0}, *m = &memory;
  (void)iw;
  (void)mem;
  K = m->y + STATES; made = K + SLOPES; x1 = made + COEFFICIENTS * STATES; begun = x1 + STATES;
  m->later = begun + SWITCHES; started = m->later + INPUTS; strings = started + INPUTS;
  (void)strings;
  memcpy(z, arg[0], (2 * STATES + SWITCHES + NUMBERS) * sizeof(double));
  for (int turn = 0; turn < TURNS && now[TIME] < duration && !now[STUCK]; ++turn) {
    const double time = now[TIME];
    const double h = fmin(fmin(now[STEP], longest), duration - time);
    const double *u = input;
    double taken = h, after, error;
    int crossed = 0, is_inside = 0;
    if (DEGREE) {
      memcpy(started, ahead(input, time, m), INPUTS * sizeof(double));
      u = started;
    }
    memcpy(K, f, STATES * sizeof(double));
    step_of(x, u, taut, h, x1, K, m);
    error = error_of(K, scale, h);
    now[TRIES] += 1;
    if (!(error < 1)) {
      const double shorter = h * (error < INFINITY ? fmin(factor_of(error), 1) : LEAST / 2);
      now[STEP] = shorter;
      now[REJECTIONS] += 1;
      now[STUCK] = shorter < SHORTEST * duration;
      continue;
    }
    of_slope(x1, ahead(u, 1.0 * h, m), taut, K + END_SLOPE, m);
    memcpy(begun, taut, SWITCHES * sizeof(double));
#ifdef HAS_CROSSING
    crossed = is_crossed(x, x1, u, taut, h, m);
    if (crossed) {
      const double reach = longest / STABLE;
      const double allowed = TWICE_LATE * scale[STATES - 1] * (reach * reach);
      taken = land(x, taut, u, h, x1, K, made, &is_inside, error, allowed, strings, now, m);
    }
#endif
    after = taken >= duration - time ? duration : time + taken;
    if (is_asked(time, after, duration, span[1])) {
      double *to = res[1] + kept++ * RECORD;
      if (!is_inside) {
        if (crossed) of_slope(x1, ahead(u, 1.0 * taken, m), begun, K + END_SLOPE, m);
        interpolate(x, x1, K, u, begun, taken, made, m);
        now[INTERPOLANTS] += 1;
      }
      to[0] = time; to[1] = is_inside ? h : taken; to[2] = taken;
      memcpy(to + 3, x, STATES * sizeof(double));
      memcpy(to + 3 + STATES, made, COEFFICIENTS * STATES * sizeof(double));
    }
    now[TIME] = after;
    now[STEP] = h * (crossed ? fmin(factor_of(error), 1) : factor_of(error));
    memcpy(x, x1, STATES * sizeof(double));
    if (crossed) {
      now[LANDINGS] += 1;
      now[STALLS] = taken < SHORTEST * duration ? now[STALLS] + 1 : 0;
      now[STUCK] = now[STALLS] > MOST_STALLS;
      of_slope(x, ahead(u, taken, m), taut, f, m);
    } else {
      memcpy(f, K + END_SLOPE, STATES * sizeof(double));
    }
  }
  for (; kept < TURNS; ++kept) res[1][kept * RECORD + 1] = 0;
  return 0;
}
"""
