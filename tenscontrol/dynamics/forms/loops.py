"""The state equation of a large scene in C: a loop over the members for each kernel.

The kernels are CasADi's C code for one member; here are the loops around them
and the tables of nodes and parameters they run over. The compiler puts the
kernels into the loops, so that one evaluation costs about what a loop written by
hand costs, and as much a member in a large scene as in a small one.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.dynamics.forms.passes import Pass, body_passes, gap_pass, string_pass
from tenscontrol.dynamics.machine_code import compiled_source
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray

# Entries that each array has for a node or a string.
_WIDTH = {"p": 3, "v": 3, "f": 3, "a": 3, "u": 1, "taut": 1, "gap": 1, "rate": 1}


def loops_functions(
    structure: Structure, law: StringLaw | None, load: FloatArray
) -> tuple[ca.Function, ...]:
    """Return slope, gap and force of :class:`Equation` in compiled C, without derivatives."""
    return compiled_source(loops_source(structure, law, load), ("slope", "gap", "force"))


def loops_source(structure: Structure, law: StringLaw | None, load: FloatArray) -> str:
    """Return the C text: the functions of :class:`Equation` with CasADi's interface.

    ``law`` is None where force densities are held; ``load`` are constant forces on all nodes, N,
    shape (3, n).
    """
    strings, bodies = [string_pass(structure, law)], body_passes(structure)
    gaps = [] if law is None else [gap_pass(structure, law)]
    passes = [each for each in [*strings, *bodies, *gaps] if each.count]
    loops = [_Loop(each, structure) for each in passes]
    calls = {loop.over.name: loop.call for loop in loops}
    free, alpha = len(structure.free), len(structure.strings)
    states, switches = 6 * free, 0 if law is None else alpha
    sizes = {"NODES": structure.nodes.shape[1], "FREE": free, "LARGEST": max(states, alpha, 1)}
    tables: dict[str, Any] = {}
    if len(structure.fixed):
        tables["free_nodes"] = 3 * structure.free
        tables["places"] = structure.nodes.ravel(order="F")
    if load.any():
        tables["load"] = load.ravel(order="F")
    kernels = ca.CodeGenerator("kernels", {"with_header": False})
    for loop in loops:
        kernels.add(loop.function)
        tables |= loop.tables

    def called(some: list[Pass]) -> str:
        return "\n".join(f"  {calls[each.name]}" for each in some if each.name in calls)

    return "\n".join(
        [
            _HEAD,
            kernels.dump(),
            _EXPORT,
            *(f"#define {name} {size}" for name, size in sizes.items()),
            *(_table(name, values) for name, values in tables.items()),
            _SUPPORTED if len(structure.fixed) else _FREE,
            *(loop.text for loop in loops),
            _FORCES % {"start": _LOADED if load.any() else _UNLOADED, "calls": called(strings)},
            _SLOPE % {"calls": called(bodies)},
            _FORCE_FREE if len(structure.fixed) == 0 else _FORCE_SUPPORTED,
            _GAP % {"calls": called(gaps)},
            _interface("slope", [states, alpha, switches], [states]),
            _interface("gap", [states, alpha], [switches, switches]),
            _interface("force", [states // 2, states // 2, alpha, switches], [states // 2]),
        ]
    )


class _Loop:
    """The loop of one pass: its kernel, its tables, its text, and how it is called."""

    def __init__(self, over: Pass, structure: Structure) -> None:
        self.over = over
        self.tables: dict[str, Any] = {}
        # Rows of the accelerations are the free nodes only.
        self._slots = np.zeros(structure.nodes.shape[1], dtype=int)
        self._slots[structure.free] = np.arange(len(structure.free))
        lines = self._kernel_lines()
        lines += [line for write in over.writes for line in self._write(write)]
        arrays = dict.fromkeys([read.array for read in over.reads.values()])
        arrays |= dict.fromkeys([write.array for write in over.writes])
        written = {write.array for write in over.writes}
        declared = ", ".join(
            f"{'' if name in written else 'const '}double *{name}" for name in arrays
        )
        self.call = f"{over.name}({', '.join(arrays)});"
        body = "\n".join(f"    {line}" for line in lines)
        self.text = _LOOP % {
            "name": over.name, "arrays": declared, "count": over.count, "body": body
        }  # fmt: skip

    def _kernel_lines(self) -> list[str]:
        """Make the kernel of one member, and return the lines that call it."""
        over = self.over
        inputs = {name: ca.SX.sym(name, _WIDTH[read.array]) for name, read in over.reads.items()}
        shared = {name: ca.DM(v) for name, v in over.parameters.items() if isinstance(v, float)}
        own = {name: ca.SX.sym(name) for name in over.parameters if name not in shared}
        outputs = over.kernel(inputs | shared | own)
        # What depends on parameters only is worked out here, once.
        outputs, constants = _constants(outputs, own, over.parameters)
        lines = []
        for name, read in over.reads.items():
            width = _WIDTH[read.array]
            at = self._at(read.nodes, slots=False, width=width)
            entries = ", ".join(f"{read.array}[{at} + {k}]" for k in range(width))
            lines.append(f"const double in_{name}[{width}] = {{{entries}}};")
        for k, (_, values) in enumerate(constants):
            table = self._add_table(f"constant_{k}", values)
            lines.append(f"const double in_constant_{k}[1] = {{{table}[i]}};")
        lines += [f"double out_{k}[{part.numel()}];" for k, part in enumerate(outputs)]
        names = [*inputs, *(f"constant_{k}" for k in range(len(constants)))]
        lines.append(f"const double *arg[] = {{{', '.join(f'in_{name}' for name in names)}}};")
        lines.append(f"double *res[] = {{{', '.join(f'out_{k}' for k in range(len(outputs)))}}};")
        lines.append(f"kernel_{over.name}(arg, res, 0, 0, 0);")
        symbols = [*inputs.values(), *(symbol for symbol, _ in constants)]
        dense = [ca.densify(part) for part in outputs]
        self.function = ca.Function(f"kernel_{over.name}", symbols, dense)
        return lines

    def _write(self, write: Any) -> list[str]:
        width = _WIDTH[write.array]
        at = self._at(write.nodes, slots=write.array == "a", width=width)
        how = "=" if write.array != "f" else "+=" if write.sign > 0 else "-="
        return [
            f"{write.array}[{at} + {k}] {how} out_{write.output}[{k}];" for k in range(width)
        ]  # fmt: skip

    def _at(self, nodes: Any, slots: bool, width: int) -> str:
        """Return the C expression of where the entries of a member begin."""
        if nodes is None:
            return "i" if width == 1 else f"{width} * i"
        table = self._add_table("at", width * (self._slots[nodes] if slots else nodes))
        return f"{table}[i]"

    def _add_table(self, name: str, values: Any) -> str:
        for known, others in self.tables.items():
            if np.array_equal(others, values):
                return known
        full = f"{self.over.name}_{name}_{len(self.tables)}"
        self.tables[full] = values
        return full


def _constants(
    outputs: tuple[Any, ...], own: dict[str, Any], parameters: dict[str, float | FloatArray]
) -> tuple[tuple[Any, ...], list[tuple[Any, FloatArray]]]:
    """Return the outputs with symbols for what depends on parameters only, and their values."""
    if not own:
        return outputs, []
    stacked, found, expressions = ca.extract_parametric(
        ca.vertcat(*(ca.vec(part) for part in outputs)), ca.vertcat(*own.values())
    )
    # A parameter that stands by itself in the outputs is a constant as it is.
    alone = [symbol for symbol in own.values() if ca.depends_on(stacked, symbol)]
    evaluate = ca.Function("constants", list(own.values()), [*expressions, *alone])
    columns = [np.asarray(parameters[name])[None, :] for name in own]
    values = [row.ravel().copy() for row in evaluate_columns(evaluate, *columns)]
    ends = np.cumsum([0, *(part.numel() for part in outputs)]).tolist()
    split = ca.vertsplit(stacked, ends)
    return tuple(split), list(zip([*found, *alone], values, strict=True))


def _table(name: str, values: Any) -> str:
    kind = "int" if values.dtype.kind == "i" else "double"
    entries = values.tolist()
    lines = [",".join(map(repr, entries[i : i + 16])) for i in range(0, len(entries), 16)]
    return f"static const {kind} {name}[{len(entries)}] = {{\n" + ",\n".join(lines) + "\n};"


def _interface(name: str, inputs: list[int], outputs: list[int]) -> str:
    """Return what CasADi asks about an external function: its arguments, all dense columns."""
    shapes_in, shapes_out = (
        ", ".join(f"{{{rows}, 1, 1}}" for rows in sizes) for sizes in (inputs, outputs)
    )
    counts = {"inputs": len(inputs), "outputs": len(outputs)}
    return _INTERFACE % {"name": name, "shapes_in": shapes_in, "shapes_out": shapes_out, **counts}


# ---- the parts of the C text that are the same for every scene ----

# CasADi's code of the kernels follows: for this file only, to be put into the loops.
# Calls of the library's fmax and fmin would keep the loops from being fast; these give the same.
_HEAD = """\
#include <math.h>
#include <string.h>
static inline double larger(double x, double y) { return x > y || y != y ? x : y; }
static inline double smaller(double x, double y) { return x < y || y != y ? x : y; }
#undef fmax
#undef fmin
#define fmax larger
#define fmin smaller
#define CASADI_SYMBOL_EXPORT static inline
"""

_EXPORT = """\
#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif
"""

# Every node is free: the state is the nodes. A null argument means zeros, as CasADi has it.
_GIVEN = """\
static double zeros[LARGEST];
static const double *given(const double *array) { return array ? array : zeros; }
"""
_FREE = (
    _GIVEN
    + """\
static const double *positions(const double *q, double *w) { (void)w; return q; }
static const double *velocities(const double *v, double *w) { (void)w; return v; }
"""
)

# Some nodes are fixed: all nodes are put together in the work memory.
_SUPPORTED = (
    _GIVEN
    + """\
static void spread(const double *from, double *to) {
  for (int i = 0; i < FREE; ++i) memcpy(to + free_nodes[i], from + 3 * i, 3 * sizeof(double));
}
static const double *positions(const double *q, double *w) {
  memcpy(w, places, sizeof(places));
  spread(q, w);
  return w;
}
static const double *velocities(const double *v, double *w) {
  w += 3 * NODES;
  memset(w, 0, 3 * NODES * sizeof(double));
  spread(v, w);
  return w;
}
"""
)

_LOOP = """\
static void %(name)s(%(arrays)s) {
  for (int i = 0; i < %(count)d; ++i) {
%(body)s
  }
}
"""

_LOADED = "memcpy(f, load, sizeof(load));"
_UNLOADED = "memset(f, 0, 3 * NODES * sizeof(double));"

_FORCES = """\
static void forces(const double *p, const double *v, const double *u, const double *taut,
                   double *f) {
  (void)v; (void)taut;
  %(start)s
%(calls)s
}
"""

_SLOPE = """\
EXPORTED int slope(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *x = given(arg[0]), *u = given(arg[1]), *taut = given(arg[2]);
  const double *p = positions(x, w), *v = velocities(x + 3 * FREE, w);
  double *f = w + 6 * NODES, *a;
  (void)iw; (void)mem;
  if (!res[0]) return 0;
  a = res[0] + 3 * FREE;
  forces(p, v, u, taut, f);
  memcpy(res[0], x + 3 * FREE, 3 * FREE * sizeof(double));
%(calls)s
  return 0;
}
"""

_FORCE = """\
EXPORTED int force(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *p = positions(given(arg[0]), w), *v = velocities(given(arg[1]), w);
  const double *u = given(arg[2]), *taut = given(arg[3]);
  (void)iw; (void)mem;
  if (!res[0]) return 0;
%s
  return 0;
}
"""
_FORCE_FREE = _FORCE % "  forces(p, v, u, taut, res[0]);"
_FORCE_SUPPORTED = (
    _FORCE
    % """\
  forces(p, v, u, taut, w + 6 * NODES);
  for (int i = 0; i < FREE; ++i)
    memcpy(res[0] + 3 * i, w + 6 * NODES + free_nodes[i], 3 * sizeof(double));"""
)

_GAP = """\
EXPORTED int gap(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *x = given(arg[0]), *u = given(arg[1]);
  const double *p = positions(x, w), *v = velocities(x + 3 * FREE, w);
  double *gap = res[0] ? res[0] : w + 6 * NODES;
  double *rate = res[1] ? res[1] : w + 6 * NODES + LARGEST;
  (void)iw; (void)mem; (void)u; (void)p; (void)v; (void)gap; (void)rate;
%(calls)s
  return 0;
}
"""

# The work memory holds positions, velocities, then forces, or what nobody asked for.
_INTERFACE = """\
static const casadi_int %(name)s_shapes_in[%(inputs)d][3] = {%(shapes_in)s};
static const casadi_int %(name)s_shapes_out[%(outputs)d][3] = {%(shapes_out)s};
EXPORTED casadi_int %(name)s_n_in(void) { return %(inputs)d; }
EXPORTED casadi_int %(name)s_n_out(void) { return %(outputs)d; }
EXPORTED const casadi_int *%(name)s_sparsity_in(casadi_int i) {
  return i < %(inputs)d ? %(name)s_shapes_in[i] : 0;
}
EXPORTED const casadi_int *%(name)s_sparsity_out(casadi_int i) {
  return i < %(outputs)d ? %(name)s_shapes_out[i] : 0;
}
EXPORTED int %(name)s_work(casadi_int *sz_arg, casadi_int *sz_res, casadi_int *sz_iw,
                           casadi_int *sz_w) {
  if (sz_arg) *sz_arg = %(inputs)d;
  if (sz_res) *sz_res = %(outputs)d;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 9 * NODES + 2 * LARGEST;
  return 0;
}
"""
