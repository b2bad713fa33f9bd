"""Steps of several runs at once: one instruction for the same step of 4 runs, in compiled C.

A step for fixed taut strings, and the test for a switch within it, are straight lists of
operations. They are written here as C on short vectors with one entry a run. Each entry is
computed by the operations of the scalar step in their order, so its bits are those of a run by
itself. Where some runs have a switch within a step, these go on to it together, and the others
wait.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.dynamics.forms.loops import C_EXPORT
from tenscontrol.dynamics.instructions import OPERATIONS, instructions, number_text
from tenscontrol.dynamics.machine_code import compiled_library, compiler, if_compiled
from tenscontrol.integrate.events import POLISHES, interpolant, zooms
from tenscontrol.integrate.fixed_step import COUNTS, REST, SUBSTEPS, FixedStep, not_finite
from tenscontrol.integrate.integrator import IntegrationError, Span, Work
from tenscontrol.integrate.simd_switches import (
    corrected,
    crossing,
    distance,
    missed,
    part_to_try,
    switch_on_interpolant,
    switching,
    taut_strings,
    zoom_in,
)

# Operations of a step up to which it is written out: compilers take half a millisecond for each.
_MOST_WRITTEN = 30_000


def lane_code(function: ca.Function) -> str | None:
    """Return a C function ``name(const V *in0, …, V *out0, …)`` of a function of dense SX.

    None if it has operations that are not written so.
    """
    steps = instructions(function)
    if steps is None:
        return None
    values: dict[int, str] = {}
    lines = []
    for k, (operation, to, of, constant) in enumerate(steps):
        if operation == "OUTPUT":
            lines.append(f"out{to[0]}[{to[1]}] = {values[of[0]]};")
            continue
        if operation == "INPUT":
            text = f"in{of[0]}[{of[1]}]"
        elif operation == "CONST":
            text = f"ALL({number_text(constant)})"
        else:
            form = OPERATIONS[operation]
            if form is None:
                return None
            text = form.format(*(values[i] for i in of))
        values[to[0]] = f"t{k}"
        lines.append(f"const V t{k} = {text};")
    arguments = [f"const V *in{i}" for i in range(function.n_in())]
    arguments += [f"V *out{i}" for i in range(function.n_out())]
    body = "\n".join(f"  {line}" for line in lines)
    return f"LANES static void lanes_{function.name()}({', '.join(arguments)}) {{\n{body}\n}}\n"


class Lanes:
    """Steps of a method with a fixed step for several runs at once, in machine code.

    :meth:`of` makes them. Any number of threads may call :meth:`advance`.
    """

    counts = len(COUNTS)

    def __init__(self, integrator: FixedStep, equation: Equation, library: Path) -> None:
        self._integrator, self._equation = integrator, equation
        self._run = ctypes.CDLL(str(library)).run_lanes
        self._run.restype = None

    @classmethod
    def of(cls, integrator: object, equation: Equation, project: bool) -> Lanes | None:
        """Return the lanes of an integrator, or None where no compiler works or no code is."""
        if not isinstance(integrator, FixedStep) or equation.form != "flat" or compiler() is None:
            return None
        key = "lanes", type(integrator), project, compiler()

        def build() -> Path | None:
            source = lanes_source(integrator.smooth_step(project), equation)
            if source is None:
                return None
            library = compiled_library(source)
            ctypes.CDLL(str(library))  # which a system may refuse
            return library

        (library,) = equation.prepared.get(key, lambda: (if_compiled(build),))
        return None if library is None else cls(integrator, equation, library)

    @property
    def back_end(self) -> str:
        """What runs the steps."""
        return f"machine code, {4 if has_wide_vectors() else 2} runs an instruction"

    def steps_between(self, duration: float, outputs: int) -> int:
        """See :meth:`FixedStep.steps_between`."""
        return self._integrator.steps_between(duration, outputs)

    def advance(
        self, states: FloatArray, held: FloatArray, duration: float, outputs: int,
        stop: ctypes.c_int,
    ) -> tuple[FloatArray, IntArray, FloatArray]:  # fmt: skip
        """Return states, shape (runs, outputs, states), steps up to which they are finite, counts.

        From states of shape (runs, states) over a span; ``held`` has shape (runs, inputs), or (1,
        inputs) for all. Once ``stop`` is not 0, all runs end after the step they are in. Counts
        are those of :data:`COUNTS`, shape (runs, 4).
        """
        runs, n = states.shape
        inner = self._integrator.steps_between(duration, outputs)
        kept = np.full((runs, outputs, n), np.nan)
        good, counts = np.zeros(runs, dtype=np.int64), np.zeros((runs, len(COUNTS)))
        begin, held = np.ascontiguousarray(states), np.ascontiguousarray(held)
        sizes = (ctypes.c_longlong(size) for size in (runs, outputs, inner))
        self._run(
            *sizes, ctypes.c_double(duration / (outputs * inner)), _place(begin), _place(held),
            ctypes.c_longlong(held.shape[1] if len(held) > 1 else 0), _place(kept), _place(good),
            _place(counts), ctypes.byref(stop),
        )  # fmt: skip
        return kept, good, counts

    @property
    def single(self) -> _Lane:
        """What integrates a single run."""
        return _Lane(self)

    def work_of(self, steps: int, counts: FloatArray) -> Work:
        """See :meth:`FixedStep.work_of`."""
        return self._integrator.work_of(steps, counts)


class _Lane:
    """One lane as an integrator of one run."""

    def __init__(self, lanes: Lanes) -> None:
        self._lanes = lanes

    def shorten(self) -> None:
        """See :meth:`Integrator.shorten`: steps are fixed."""

    def advance(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int, /
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        lanes = self._lanes
        kept, good, counts = lanes.advance(
            state[None], held[None], duration, outputs, ctypes.c_int(0)
        )
        inner, (done,) = lanes.steps_between(duration, outputs), good.tolist()
        work = lanes.work_of(done, counts[0])
        if done < outputs * inner:
            step = duration / (outputs * inner)
            span = Span(kept[0, : done // inner].T, work)
            raise IntegrationError(not_finite(done, step), step * done, span)
        return Span(kept[0].T, work)


def _place(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def lanes_source(smooth: ca.Function, equation: Equation) -> str | None:
    """Return the C text of a smooth step ``(x, u, taut, h) -> x1``, cut at switches, in lanes.

    None if the step cannot be written so.
    """
    if not smooth.is_a("SXFunction"):
        return None
    functions = _parts(smooth, equation)
    if sum(each.n_instructions() for each in functions) > _MOST_WRITTEN:
        return None
    written = [code for each in functions if (code := lane_code(each)) is not None]
    if len(written) < len(functions):
        return None
    wide = has_wide_vectors()
    sizes = {
        "W": 4 if wide else 2, "STATES": equation.states, "INPUTS": equation.inputs,
        "SWITCHES": equation.switches, "COUNTS": len(COUNTS), "ZOOMS": zooms(equation),
        "POLISHES": POLISHES, "SUBSTEPS": SUBSTEPS - 1, "REST": repr(REST),
        "LANES": '__attribute__((target("avx2")))' if wide else "",
    }  # fmt: skip
    texts = [f"#define {name} {value}" for name, value in sizes.items()]
    texts += [C_EXPORT, _VECTORS, *written]
    return "\n".join([*texts, _CUT if equation.switches else "", _RUN])


def _parts(smooth: ca.Function, equation: Equation) -> list[ca.Function]:
    """Return what the loop calls, of dense SX.

    ``of`` are the input, the time since u, and the time of the step that is done: the step, or
    what is left of it, begins there.
    """
    x, u, taut, h = equation.symbols(ca.SX)
    clock, done, x1 = ca.SX.sym("clock"), ca.SX.sym("done"), ca.SX.sym("x1", equation.states)
    of = [u, clock, done]
    now = equation.ahead(equation.ahead(u, clock), done)
    later = equation.ahead(now, h)

    def function(name: str, inputs: list[Any], *outputs: Any) -> ca.Function:
        return Function(name, inputs, [ca.densify(ca.SX(each)) for each in outputs])

    found = [function("smooth", [x, taut, *of, h], smooth(x, now, taut, h))]
    if not equation.switches:
        return found
    n, alpha = equation.states, equation.switches
    part, wanted, before, gap_before, speed, taken, aim, low, high, hit = map(
        ca.SX.sym,
        ("part", "wanted", "before", "gap", "speed", "taken", "aim", "low", "high", "hit"),
    )
    chosen, leaving = ca.SX.sym("chosen", alpha), ca.SX.sym("leaving", alpha)
    dense = ca.SX.sym("coefficients", n // 2, 6)
    within = [dense, now, taut, h]
    slopes = equation.slope(x, now, taut), equation.slope(x1, later, taut)
    tried = part_to_try(wanted, speed)
    end = equation.ahead(now, part * h)
    gap = distance(equation)(x1, end, taut, chosen)
    zoom, first_out = (each(equation).expand() for each in (zoom_in, switch_on_interpolant))
    return [
        *found,
        function("crossing", [x, x1, taut, *of, h], crossing(equation)(x, x1, now, taut, h)),
        function("missed", [x, x1, taut, *of, h], missed(equation)(x, x1, now, taut, h)),
        function("pulling", [x, *of], taut_strings(equation, x, now)),
        function(
            "interpolated", [x, x1, taut, *of, h],
            interpolant(equation)(x, slopes[0], x1, slopes[1], h),
        ),
        function("zoom", [dense, taut, *of, h, low, high], *zoom(*within, low, high)),
        function(
            "first_out", [dense, taut, *of, h, low, high, hit],
            *first_out(*within, low, high, hit, 0),
        ),
        function("to_try", [wanted, speed, h], tried, tried * h),
        function(
            "corrected", [x1, taut, *of, h, chosen, part, before, gap_before, speed, taken, aim],
            gap, *corrected(part, gap, before, gap_before, speed, taken, aim),
        ),
        function(
            "switching", [x1, taut, *of, h, part, leaving],
            *switching(equation)(x1, end, taut, leaving), part * h,
        ),
    ]  # fmt: skip


def has_wide_vectors() -> bool:
    """Whether this machine computes with four numbers in an instruction (AVX2)."""
    return bool(ctypes.CDLL(str(compiled_library(_WIDE))).has_wide_vectors())


_WIDE = """\
#if defined(_WIN32)
__declspec(dllexport) int has_wide_vectors(void) { return 0; }
#elif defined(__x86_64__)
int has_wide_vectors(void) { return __builtin_cpu_supports("avx2") != 0; }
#else
int has_wide_vectors(void) { return 0; }
#endif
"""

_VECTORS = """\
#include <math.h>
#include <string.h>
typedef double V __attribute__((vector_size(8 * W)));
typedef long long M __attribute__((vector_size(8 * W)));
#define ALL(x) ((V){0} + (x))
#define ONLY(mask, x) ((V)((mask) & (M)(x)))
#define TRUTH(mask) ONLY(mask, ALL(1.0))
#define POSITIVE(x) ((V)((M)(x) & 0x7fffffffffffffffLL))
#define CHOICE(mask, x, y) ((V)(((mask) & (M)(x)) | (~(mask) & (M)(y))))
#define LARGER(x, y) CHOICE((x > y) | (y != y), x, y)
#define SMALLER(x, y) CHOICE((x < y) | (y != y), x, y)
#define CALL(f, x) ({ V to = x; for (int i = 0; i < W; ++i) to[i] = f(to[i]); to; })
#define CALL_2(f, x, y) \\
  ({ V to = x; for (int i = 0; i < W; ++i) to[i] = f(to[i], (y)[i]); to; })
"""

# The lanes of ``cut`` are those with a switch in the step; the others go on with numbers that
# nobody reads, and keep what they have. See :func:`events.located`.
_CUT = """\
LANES static inline int any(M lanes) {
  long long found = 0;
  for (int i = 0; i < W; ++i) found |= lanes[i];
  return found != 0;
}

LANES static void take(M lanes, const V *from, V *to, int count) {
  for (int k = 0; k < count; ++k) to[k] = CHOICE(lanes, from[k], to[k]);
}

LANES static void cut(M cut_lanes, V *x, V *taut, const V *u, const V *clock, const V *h,
                      V *x1, V *counts) {
  V at[STATES], end[STATES], pulls[SWITCHES], left[1], done[1], crossed[1], dense[3 * STATES];
  V low[1], high[1], hit[1], part[1], speed[1], aim[1], chosen[SWITCHES], leaving[SWITCHES];
  V wanted[1], tried[1], gap[1], next[1], slope[1], gap_here[1], time[1], taken[1], switched[1];
  V reached[STATES], after[SWITCHES];
  M active = cut_lanes;
  memcpy(at, x, sizeof(at));
  memcpy(end, x1, sizeof(end));
  memcpy(pulls, taut, sizeof(pulls));
  left[0] = h[0];
  done[0] = ALL(0.0);
  for (int sub = 0; any(active); ++sub) {
    if (sub) {
      lanes_smooth(at, pulls, u, clock, done, left, end);
      counts[0] += ONLY(active, ALL(1.0));
      M over = active;
      if (sub <= SUBSTEPS) {
        lanes_crossing(at, end, pulls, u, clock, done, left, crossed);
        over &= crossed[0] == 0.0;
      } else {
        lanes_missed(at, end, pulls, u, clock, done, left, crossed);
        counts[3] += ONLY(active, crossed[0]);
        lanes_pulling(end, u, clock, h, after);
        take(active, after, pulls, SWITCHES);
      }
      take(over, end, at, STATES);
      active &= ~over;
      if (!any(active)) break;
    }
    lanes_interpolated(at, end, pulls, u, clock, done, left, dense);
    low[0] = ALL(0.0);
    high[0] = ALL(1.0);
    for (int i = 0; i < ZOOMS; ++i) {
      lanes_zoom(dense, pulls, u, clock, done, left, low, high, time, tried, hit);
      low[0] = time[0];
      high[0] = tried[0];
    }
    lanes_first_out(dense, pulls, u, clock, done, left, low, high, hit,
                    wanted, speed, aim, chosen, leaving);
    const M found = hit[0] != 0.0;
    part[0] = ALL(0.0);
    gap[0] = CHOICE(found, ALL(0.0), aim[0]);
    taken[0] = CHOICE(found, ALL(0.0), ALL(1.0));
    for (int i = 0; i < POLISHES; ++i) {
      const M far = active & ((taken[0] == 0.0) | (POSITIVE(gap[0] - aim[0]) > POSITIVE(aim[0])));
      if (!any(far)) break;
      lanes_to_try(wanted, speed, left, tried, time);
      lanes_smooth(at, pulls, u, clock, done, time, reached);
      lanes_corrected(reached, pulls, u, clock, done, left, chosen, tried, part, gap, speed,
                      taken, aim, gap_here, next, slope);
      take(far, reached, end, STATES);
      take(far, tried, part, 1);
      take(far, gap_here, gap, 1);
      take(far, next, wanted, 1);
      take(far, slope, speed, 1);
      taken[0] += ONLY(far, ALL(1.0));
    }
    lanes_switching(end, pulls, u, clock, done, left, part, leaving, after, switched, time);
    const M landed = active & found;
    take(active, end, at, STATES);
    take(landed, after, pulls, SWITCHES);
    counts[0] += ONLY(landed, taken[0]);
    counts[1] += ONLY(active, ALL(1.0));
    counts[2] += ONLY(landed, switched[0]);
    left[0] -= CHOICE(found, time[0], left[0]);
    done[0] = h[0] - left[0];
    active &= left[0] > REST * h[0];
  }
  take(cut_lanes, at, x1, STATES);
  take(cut_lanes, pulls, taut, SWITCHES);
}
"""

# A lane that no run is left for repeats the last run. Arrays of no entries are no C: hence + 1.
_RUN = """\
EXPORTED LANES void run_lanes(
    long long runs, long long outputs, long long inner, double length, const double *begin,
    const double *held, long long stride, double *kept, long long *good, double *counts,
    const volatile int *stop) {
  V x[STATES], x1[STATES], u[INPUTS + 1], taut[SWITCHES + 1], clock[1], none[1], h[1];
  none[0] = ALL(0.0);
  h[0] = ALL(length);
  for (long long first = 0; first < runs; first += W) {
    const long long total = outputs * inner;
    long long run[W], done = 0;
    int going = W;
    V counted[COUNTS] = {{0}};
    for (int i = 0; i < W; ++i) run[i] = first + i < runs ? first + i : runs - 1;
    for (int k = 0; k < STATES; ++k)
      for (int i = 0; i < W; ++i) x[k][i] = begin[run[i] * STATES + k];
    for (int k = 0; k < INPUTS; ++k)
      for (int i = 0; i < W; ++i) u[k][i] = held[run[i] * stride + k];
    for (int i = 0; i < W; ++i) good[run[i]] = -1;
    clock[0] = none[0];
#if SWITCHES
    lanes_pulling(x, u, clock, none, taut);
#endif
    for (; done < total && going && !*stop; ++done) {
      lanes_smooth(x, taut, u, clock, none, h, x1);
#if SWITCHES
      V crossed[1];
      lanes_crossing(x, x1, taut, u, clock, none, h, crossed);
      const M lanes = crossed[0] != 0.0;
      if (any(lanes)) cut(lanes, x, taut, u, clock, h, x1, counted);
#endif
      V finite = ALL(0.0);
      for (int k = 0; k < STATES; ++k) { x[k] = x1[k]; finite += x1[k] * 0.0; }
      clock[0] += h[0];
      going = 0;
      for (int i = 0; i < W; ++i) {
        if (finite[i] == 0) ++going;
        else if (good[run[i]] < 0) good[run[i]] = done;
      }
      if ((done + 1) % inner == 0)
        for (int i = 0; i < W; ++i)
          for (int k = 0; k < STATES; ++k)
            kept[(run[i] * outputs + done / inner) * STATES + k] = x[k][i];
    }
    for (int i = 0; i < W; ++i) {
      if (good[run[i]] < 0) good[run[i]] = done;
      for (int k = 0; k < COUNTS; ++k) counts[run[i] * COUNTS + k] = counted[k][i];
    }
  }
}
"""
