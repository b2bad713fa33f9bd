"""The loop of DOP853 over its steps in C: the same numbers as CasADi's graph of it, without copies.

Slopes, projections and what finds a switch are CasADi's C code; here are the sums of slopes, the
error, the interpolant, and what becomes of a step that was tried.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from tenscontrol.dynamics import external_source


def loop_source(
    functions: Sequence[ca.Function],
    sizes: Mapping[str, int],
    numbers: Mapping[str, float],
    carried: Sequence[str],
    method: Any,
) -> str:
    """Return the C text of ``turns(z, given) -> (z, records)``; see :class:`DOP853`.

    ``functions`` are those that the text calls by name, ``sizes`` and ``numbers`` its constants,
    ``carried`` names the numbers in z, and ``method`` has the coefficients.
    """
    n, kernels = sizes["STATES"], ca.CodeGenerator("kernels", {"with_header": False})
    for each in functions:
        kernels.add(each)
    memory = {
        name: max(getattr(each, f"sz_{name}")() for each in functions)
        for name in ("arg", "res", "iw", "w")
    }
    stages, last = len(method.B), len(method.B) + 1 + len(method.C_EXTRA)
    constants = {
        **sizes,
        **{f"{name.upper()}_SIZE": max(size, 1) for name, size in memory.items()},
        **{name: f"{i}" for i, name in enumerate(f"NUMBER_{each.upper()}" for each in carried)},
        **{name: repr(float(value)) for name, value in numbers.items()},
        "SLOPES": last,
    }
    calls = [_CALL % {"i": i} for i in range(1, 13)]
    del calls
    lines = [
        _advanced(f"K + {s} * STATES", f"{float(c)!r} * h", a)
        for s, (a, c) in enumerate(zip(method.A[1:], method.C[1:], strict=True), 1)
    ]
    extra = [
        _advanced(f"K + {stages + 1 + s} * STATES", f"{float(c)!r} * h", a)
        for s, (a, c) in enumerate(zip(method.A_EXTRA, method.C_EXTRA, strict=True))
    ]
    dense = [
        f"for (int i = 0; i < STATES; ++i) made[{3 + k} * STATES + i] = h * ({_sum(d)});"
        for k, d in enumerate(method.D)
    ]
    text = _TEXT
    parts = {
        "@STAGES@": "\n  ".join(lines),
        "@END@": f"for (int i = 0; i < STATES; ++i) x1[i] = x[i] + h * ({_sum(method.B)});",
        "@FIFTH@": _sum(method.E5),
        "@THIRD@": _sum(method.E3),
        "@EXTRA@": "\n  ".join(extra),
        "@DENSE@": "\n  ".join(dense),
    }
    for mark, part in parts.items():
        text = text.replace(mark, part)
    defined = "\n".join(f"#define {name} {value}" for name, value in constants.items())
    z, given = sizes["CARRIED"], sizes["GIVEN"]
    work = 2 * memory["w"] + (2 * last + 12) * n + 4 * sizes["SWITCHES"] + 2 * sizes["INPUTS"] + 64
    return external_source(
        "turns", [z, given], [z, sizes["RECORD"] * sizes["TURNS"]], work,
        [kernels.dump(), defined, text],
    )  # fmt: skip


def _sum(weights: Any) -> str:
    """Return the C expression of entry i of the sum of slopes with weights, without those of 0."""
    used = [(k, float(a)) for k, a in enumerate(weights) if a != 0]
    return " + ".join(f"K[{k} * STATES + i] * {a!r}" for k, a in used)


def _advanced(slope: str, time: str, weights: Any) -> str:
    """Return the C lines of one stage."""
    return (
        f"for (int i = 0; i < STATES; ++i) y[i] = x[i] + h * ({_sum(weights)});\n"
        f"  of_slope(y, ahead(u, {time}, later), taut, {slope});"
    )


_TEXT = """\
static const double *ahead(const double *u, double time, double *later) {
  if (!DEGREE) return u;
  memcpy(later, u, INPUTS * sizeof(double));
  later[INPUTS - 1] += time;
  return later;
}

typedef struct {
  double *w, *y, *later, *scaled;
} Memory;

static void call(int function, const double **from, double **to, double *w) {
  const double *arg[ARG_SIZE];
  double *res[RES_SIZE];
  casadi_int iw[IW_SIZE];
}
"""
