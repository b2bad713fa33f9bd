"""Steps of several runs at once: one instruction for the same step of 4 runs, in compiled C.

A step for fixed taut strings, and the test for a switch within it, are straight lists of
operations. They are written here as C on short vectors with one entry a run. Each entry is
computed by the operations of the scalar step in their order, so its bits are those of a run by
itself. A run with a switch within a step takes that step by the scalar code, which locates it.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, compiled_library, compiler
from tenscontrol.integrate.events import COUNTS, crossing, taut_strings
from tenscontrol.integrate.fixed_step import FixedStep, carried
from tenscontrol.validation import FloatArray, IntArray

# Operations of a step up to which it is written out: compilers take half a millisecond for each.
_MOST_WRITTEN = 12_000

_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_COMPARED = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
# Written with two operands, or one; the second is then left out.
_FORMS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_NOT: "TRUTH({0} == 0.0)",
    ca.OP_AND: "TRUTH(({0} != 0.0) & ({1} != 0.0))",
    ca.OP_OR: "TRUTH(({0} != 0.0) | ({1} != 0.0))",
    ca.OP_IF_ELSE_ZERO: "ONLY({0} != 0.0, {1})",
    ca.OP_FABS: "POSITIVE({0})",
    ca.OP_FMAX: "CHOICE(({0} > {1}) | ({1} != {1}), {0}, {1})",
    ca.OP_FMIN: "CHOICE(({0} < {1}) | ({1} != {1}), {0}, {1})",
    **{op: f"{{0}} {sign} {{1}}" for op, sign in _INFIX.items()},
    **{op: f"TRUTH({{0}} {sign} {{1}})" for op, sign in _COMPARED.items()},
}

# Functions of the C library, entry by entry.
_CALLED = {
    ca.OP_SQRT: "sqrt", ca.OP_EXP: "exp", ca.OP_LOG: "log", ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow", ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan", ca.OP_ATAN2: "atan2",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh", ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
}  # fmt: skip
_OF_TWO = ("pow", "atan2")


def _operations(function: ca.Function) -> set[int]:
    return {function.instruction_id(k) for k in range(function.n_instructions())}


def _is_writable(function: ca.Function) -> bool:
    """Whether a function is a list of operations that :func:`lane_code` knows."""
    known = {*_FORMS, *_CALLED, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
    return bool(_operations(function) <= known)


def lane_code(function: ca.Function) -> str:
    """Return a C function ``name(const V *in0, …, V *out0, …)`` of a function of dense SX."""
    values: dict[int, str] = {}
    lines = []
    for k in range(function.n_instructions()):
        op, to = function.instruction_id(k), function.instruction_output(k)
        of = function.instruction_input(k)
        if op == ca.OP_OUTPUT:
            lines.append(f"out{to[0]}[{to[1]}] = {values[of[0]]};")
            continue
        if op == ca.OP_INPUT:
            text = f"in{of[0]}[{of[1]}]"
        elif op == ca.OP_CONST:
            text = f"ALL({_number(function.instruction_constant(k))})"
        else:
            operands = [values[each] for each in of]
            if op in _CALLED:
                text = f"each_{_CALLED[op]}({', '.join(operands)})"
            else:
                text = _FORMS[op].format(*operands)
        values[to[0]] = f"t{k}"
        lines.append(f"const V t{k} = {text};")
    arguments = [f"const V *in{i}" for i in range(function.n_in())]
    arguments += [f"V *out{i}" for i in range(function.n_out())]
    body = "\n".join(f"  {line}" for line in lines)
    return f"LANES static void lanes_{function.name()}({', '.join(arguments)}) {{\n{body}\n}}\n"


def _number(value: float) -> str:
    if value != value:
        return "NAN"
    if value in (float("inf"), float("-inf")):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(value)


class Lanes:
    """Steps of a method with a fixed step for several runs at once, in machine code.

    :meth:`of` makes them. Any number of threads may call :meth:`advance`.
    """

    def __init__(self, integrator: FixedStep, equation: Equation, library: Path) -> None:
        self._integrator, self._equation = integrator, equation
        self._run = ctypes.CDLL(str(library)).run_lanes
        self._run.restype = None

    @classmethod
    def of(cls, integrator: object, equation: Equation, project: bool) -> Lanes | None:
        """Return the lanes of an integrator, or None where there is no compiler or no such code."""
        if not isinstance(integrator, FixedStep) or equation.form != "flat" or compiler() is None:
            return None
        key = "lanes", type(integrator), project, compiler()

        def build() -> tuple[Path | None]:
            source = lanes_source(integrator.smooth_step(project), equation)
            return (None if source is None else compiled_library(source),)

        (library,) = equation.prepared.get(key, build)
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


def _place(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def lanes_source(smooth: ca.Function, equation: Equation) -> str | None:
    """Return the C text of a smooth step ``(x, u, taut, h) -> x1``, cut at switches, in lanes.

    None if the step cannot be written so.
    """
    x, u, taut, h = equation.symbols(ca.SX)
    clock = ca.SX.sym("clock")
    if not smooth.is_a("SXFunction") or smooth.n_instructions() > _MOST_WRITTEN:
        return None
    now = equation.ahead(u, clock)
    x1 = smooth(x, now, taut, h)
    crossed = ca.SX(0)
    if equation.switches:
        crossed = crossing(equation)(x, x1, now, taut, h)
    attempt = ca.Function("attempt", [x, u, taut, clock, h], [x1, ca.densify(crossed)])
    pulling = ca.Function("pulling", [x, u], [ca.densify(taut_strings(equation, x, u))])
    if not all(map(_is_writable, (attempt, pulling))):
        return None
    code = ca.CodeGenerator("lib", {"with_header": False})
    if equation.switches:
        code.add(carried(smooth, equation))
    wide = has_wide_vectors()
    sizes = {
        "W": 4 if wide else 2, "STATES": equation.states, "INPUTS": equation.inputs,
        "SWITCHES": equation.switches, "CLOCKS": min(equation.layout.degree, 1),
        "COUNTS": len(COUNTS), "LANES": '__attribute__((target("avx2")))' if wide else "",
    }  # fmt: skip
    called = {_CALLED[op] for each in (attempt, pulling) for op in _operations(each) & set(_CALLED)}
    kinds = (f"{'EACH_OF_TWO' if name in _OF_TWO else 'EACH'}({name})" for name in sorted(called))
    texts = [f"#define {name} {value}" for name, value in sizes.items()]
    texts += [code.dump(), _VECTORS, *kinds, lane_code(attempt), lane_code(pulling), _RUN]
    return "\n".join(texts)


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
#include <stdlib.h>
#include <string.h>
typedef double V __attribute__((vector_size(8 * W)));
typedef long long M __attribute__((vector_size(8 * W)));
#define ALL(x) ((V){0} + (x))
#define ONLY(mask, x) ((V)((mask) & (M)(x)))
#define TRUTH(mask) ONLY(mask, ALL(1.0))
#define POSITIVE(x) ((V)((M)(x) & 0x7fffffffffffffffLL))
#define CHOICE(mask, x, y) ((V)(((mask) & (M)(x)) | (~(mask) & (M)(y))))
#define EACH(f) LANES static inline V each_##f(V x) \\
  { for (int i = 0; i < W; ++i) x[i] = f(x[i]); return x; }
#define EACH_OF_TWO(f) LANES static inline V each_##f(V x, V y) \\
  { for (int i = 0; i < W; ++i) x[i] = f(x[i], y[i]); return x; }
"""

# A lane that no run is left for repeats the last run. Arrays of no entries are no C: hence + 1.
_RUN = """\
#if defined(_WIN32)
__declspec(dllexport)
#endif
LANES void run_lanes(long long runs, long long outputs, long long inner, double length,
                     const double *begin, const double *held, long long stride, double *kept,
                     long long *good, double *counts, const volatile int *stop) {
  V x[STATES], x1[STATES], u[INPUTS + 1], taut[SWITCHES + 1], clock[1], h[1], crossed[1];
#if SWITCHES
  casadi_int args, results, integers, reals;
  step_work(&args, &results, &integers, &reals);
  const double **arg = malloc(args * sizeof(*arg));
  double **res = malloc(results * sizeof(*res)), *w = malloc((reals + 1) * sizeof(*w));
  casadi_int *iw = malloc((integers + 1) * sizeof(*iw));
  double z[STATES + CLOCKS + SWITCHES + COUNTS], of_run[INPUTS + 1];
#endif
  h[0] = ALL(length);
  for (long long first = 0; first < runs; first += W) {
    long long run[W], left = outputs * inner, done = 0;
    int going = W;
    for (int i = 0; i < W; ++i) run[i] = first + i < runs ? first + i : runs - 1;
    for (int k = 0; k < STATES; ++k)
      for (int i = 0; i < W; ++i) x[k][i] = begin[run[i] * STATES + k];
    for (int k = 0; k < INPUTS; ++k)
      for (int i = 0; i < W; ++i) u[k][i] = held[run[i] * stride + k];
    clock[0] = ALL(0.0);
    for (int i = 0; i < W; ++i) good[run[i]] = -1;
    lanes_pulling(x, u, taut);
    for (; done < left && going && !*stop; ++done) {
      lanes_attempt(x, u, taut, clock, h, x1, crossed);
#if SWITCHES
      for (int i = 0; i < W; ++i) {
        double *counted = counts + run[i] * COUNTS;
        if (i && run[i] == run[i - 1]) {
          for (int k = 0; k < STATES; ++k) x1[k][i] = x1[k][i - 1];
          for (int k = 0; k < SWITCHES; ++k) taut[k][i] = taut[k][i - 1];
        } else if (crossed[0][i] == 0) {
          ++counted[0];
        } else {
          for (int k = 0; k < STATES; ++k) z[k] = x[k][i];
          for (int k = 0; k < CLOCKS; ++k) z[STATES] = clock[0][i];
          for (int k = 0; k < SWITCHES; ++k) z[STATES + CLOCKS + k] = taut[k][i];
          memcpy(z + STATES + CLOCKS + SWITCHES, counted, COUNTS * sizeof(double));
          for (int k = 0; k < INPUTS; ++k) of_run[k] = u[k][i];
          arg[0] = z; arg[1] = of_run; arg[2] = &length; res[0] = z;
          step(arg, res, iw, w, 0);
          for (int k = 0; k < STATES; ++k) x1[k][i] = z[k];
          for (int k = 0; k < SWITCHES; ++k) taut[k][i] = z[STATES + CLOCKS + k];
          memcpy(counted, z + STATES + CLOCKS + SWITCHES, COUNTS * sizeof(double));
        }
      }
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
    for (int i = 0; i < W; ++i) if (good[run[i]] < 0) good[run[i]] = done;
  }
#if SWITCHES
  free(arg); free(res); free(iw); free(w);
#endif
}
"""
