"""The state equation of a large scene in C: a loop over the members for each kernel.

The kernels are CasADi's C code for one member; here are the loops around them
and the tables of nodes and parameters they run over. The compiler puts the
kernels into the loops, so that one evaluation costs about what a loop written by
hand costs, and as much a member in a large scene as in a small one.
"""

from __future__ import annotations

from itertools import chain
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.equation import InputLayout
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.dynamics.force import VECTORS, Pass, Read, Write
from tenscontrol.dynamics.forces import Forces
from tenscontrol.dynamics.forms.body_passes import body_passes
from tenscontrol.dynamics.forms.elimination import SOLVE, Elimination
from tenscontrol.dynamics.machine_code import compiled_source
from tenscontrol.structure.structure import Structure


def loops_functions(
    forces: Forces, load: FloatArray, layout: InputLayout
) -> tuple[ca.Function, ...]:
    """Return slope, gap and force of :class:`Equation` in compiled C, without derivatives."""
    return compiled_source(loops_source(forces, load, layout), ("slope", "gap", "force"))


def loops_source(forces: Forces, load: FloatArray, layout: InputLayout | None = None) -> str:
    """Return the C text: the functions of :class:`Equation` with CasADi's interface.

    ``load`` are constant forces on all nodes, N, shape (d, n). The values of ``layout`` are the
    input, displacements followed by their rates.
    """
    structure, switches = forces.structure, forces.switches
    acting, bodies = list(chain(*forces.passes())), body_passes(structure)
    gaps = forces.gap_passes()
    solver = Elimination(structure) if structure.blocks else None
    passes = [*acting, *bodies, *gaps, *([] if solver is None else [solver.assembly])]
    slots = _slots(structure)
    loops = [_Loop(over, structure.dimension, slots) for over in passes]
    calls = {loop.over.name: loop.call for loop in loops}
    d, states, alpha = structure.dimension, 2 * len(structure.free_rows), len(structure.strings)
    supported = len(structure.fixed_rows) > 0
    entries, inputs, start = structure.nodes.size, alpha, _LOADED if load.any() else _UNLOADED
    sizes: dict[str, Any] = {}
    if layout is not None and layout.load:
        sizes["LOAD_AT"], start = inputs, _LOAD_GIVEN
        inputs += entries
    if layout is not None and layout.offset:
        sizes["OFFSET_AT"] = inputs
        inputs += 2 * entries
    largest = max(states, inputs, switches, 1)
    sizes |= {"ENTRIES": entries, "FREE": states // 2, "LARGEST": largest}
    work = 3 * entries + 2 * largest
    tables: dict[str, Any] = {}
    if supported:
        # Free coordinates, node by node where no node rolls.
        sizes["PIECE"] = 1 if structure.rollers else d
        tables["free_rows"] = structure.free_rows[:: sizes["PIECE"]]
        tables["places"] = structure.nodes.ravel(order="F")
    if structure.rollers:
        work += entries
    if load.any():
        tables["load"] = load.ravel(order="F")
    if solver is not None:
        sizes |= solver.sizes | {"BLOCKS_AT": work}
        work += solver.work
        tables |= solver.tables
        tables["block_slot"] = slots[solver.tables["block_row"]]
    ends, moved = "p, v", ""
    if "OFFSET_AT" in sizes:
        sizes["ENDS_AT"] = work
        work += 2 * entries
        ends = "ends(p, u, 0, w), ends(v, u, ENTRIES, w)"
        moved = "  p = ends(p, u, 0, w);\n  v = ends(v, u, ENTRIES, w);"
    sizes["WORK"] = work
    kernels = ca.CodeGenerator("kernels", {"with_header": False})
    for loop in loops:
        kernels.add(loop.function)
        tables |= loop.tables

    def called(some: list[Pass]) -> str:
        return "\n".join(f"  {calls[over.name]}" for over in some)

    slope = called(bodies)
    if solver is not None:
        slope += "\n  blocks(p, v, f, a, w + BLOCKS_AT);"
    return "\n".join(
        [
            C_HEAD,
            kernels.dump(),
            C_EXPORT,
            *(f"#define {name} {size}" for name, size in sizes.items()),
            *(_table(name, values) for name, values in tables.items()),
            _SUPPORTED if supported else _FREE,
            *(loop.text for loop in loops),
            "" if solver is None else SOLVE % {"assembly": calls[solver.assembly.name]},
            _ENDS if "OFFSET_AT" in sizes else "",
            _FORCES % {"start": start, "calls": called(acting)},
            (_SLOPE_ROLLING if structure.rollers else _SLOPE) % {"ends": ends, "calls": slope},
            (_FORCE_SUPPORTED if supported else _FORCE_FREE) % {"ends": ends},
            _GAP % {"moved": moved, "calls": called(gaps)},
            external_interface("slope", [states, inputs, switches], [states]),
            external_interface("gap", [states, inputs], [switches, switches]),
            external_interface(
                "force", [states // 2, states // 2, inputs, switches], [states // 2]
            ),
        ]
    )


def _slots(structure: Structure) -> IntArray:
    """Return where accelerations of rows of ``vec(N)`` are written."""
    slots = np.arange(structure.nodes.size)
    if not structure.rollers:
        slots[structure.free_rows] = np.arange(len(structure.free_rows))
    return slots


class _Loop:
    """The loop of one pass: its kernel, its tables, its text, and how it is called."""

    def __init__(self, over: Pass, dimension: int, slots: IntArray) -> None:
        self.over = over
        self.tables: dict[str, Any] = {}
        self._dimension, self._slots = dimension, slots
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
        inputs, own, outputs = over.for_one(self._dimension)
        # What depends on parameters only is worked out here, once.
        outputs, constants = _constants(outputs, own, over.parameters)
        lines = []
        for name, read in over.reads.items():
            width = self._width(read)
            first = self._at(read)
            entries = ", ".join(f"{read.array}[{first} + {k}]" for k in range(width))
            lines.append(f"const double in_{name}[{width}] = {{{entries}}};")
        for k, (_, values) in enumerate(constants):
            table = self._add_table(f"constant_{k}", values)
            lines.append(f"const double in_constant_{k}[1] = {{{table}[i]}};")
        lines += [f"double out_{k}[{output.numel()}];" for k, output in enumerate(outputs)]
        names = [*inputs, *(f"constant_{k}" for k in range(len(constants)))]
        lines.append(f"const double *arg[] = {{{', '.join(f'in_{name}' for name in names)}}};")
        lines.append(f"double *res[] = {{{', '.join(f'out_{k}' for k in range(len(outputs)))}}};")
        lines.append(f"kernel_{over.name}(arg, res, 0, 0, 0);")
        symbols = [*inputs.values(), *(symbol for symbol, _ in constants)]
        dense = [ca.densify(output) for output in outputs]
        self.function = Function(f"kernel_{over.name}", symbols, dense)
        return lines

    def _write(self, write: Write) -> list[str]:
        how = "=" if write.array != "f" else "+=" if write.sign > 0 else "-="
        out = f"{'-' if how == '=' and write.sign < 0 else ''}out_{write.output}"
        if write.at is not None and write.at.ndim == 2:  # each entry has its own place
            width = write.at.shape[1]
            table = self._add_table("at", write.at.ravel())
            places = [f"{table}[{width} * i + {k}]" for k in range(width)]
        else:
            first = self._at(write)
            places = [f"{first} + {k}" for k in range(self._width(write))]
        return [f"{write.array}[{entry}] {how} {out}[{k}];" for k, entry in enumerate(places)]

    def _width(self, access: Read | Write) -> int:
        return self._dimension if access.array in VECTORS else 1

    def _at(self, access: Read | Write) -> str:
        """Return the C expression of where the entries of a member begin."""
        width = self._width(access)
        if access.at is None:
            return "i" if width == 1 else f"{width} * i"
        first = width * access.at
        table = self._add_table("at", self._slots[first] if access.array == "a" else first)
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
    stacked, symbols, expressions = ca.extract_parametric(
        ca.vertcat(*(ca.vec(output) for output in outputs)), ca.vertcat(*own.values())
    )
    # A parameter that stands by itself in the outputs is a constant as it is.
    alone = [symbol for symbol in own.values() if ca.depends_on(stacked, symbol)]
    evaluate = Function("constants", list(own.values()), [*expressions, *alone])
    columns = [np.asarray(parameters[name])[None, :] for name in own]
    values = [row.ravel().copy() for row in evaluate_columns(evaluate, *columns)]
    ends = np.cumsum([0, *(output.numel() for output in outputs)]).tolist()
    split = ca.vertsplit(stacked, ends)
    return tuple(split), list(zip([*symbols, *alone], values, strict=True))


def _table(name: str, values: Any) -> str:
    kind = "int" if values.dtype.kind == "i" else "double"
    entries = values.tolist()
    lines = [",".join(map(repr, entries[i : i + 16])) for i in range(0, len(entries), 16)]
    return f"static const {kind} {name}[{len(entries)}] = {{\n" + ",\n".join(lines) + "\n};"


def external_interface(name: str, inputs: list[int], outputs: list[int]) -> str:
    """Return what CasADi asks about an external function: its arguments, all dense columns."""
    shapes_in, shapes_out = (
        ", ".join(f"{{{rows}, 1, 1}}" for rows in sizes) for sizes in (inputs, outputs)
    )
    counts = {"inputs": len(inputs), "outputs": len(outputs)}
    return _INTERFACE % {"name": name, "shapes_in": shapes_in, "shapes_out": shapes_out, **counts}


# ---- the parts of the C text that are the same for every scene ----

# CasADi's code of the kernels follows: for this file only, to be put into the loops.
# Calls of the library's fmax and fmin would keep the loops from being fast; these give the same.
C_HEAD = """\
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

C_EXPORT = """\
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

# Supports hold some: all nodes are put together in the work memory.
_SUPPORTED = (
    _GIVEN
    + """\
static void spread(const double *from, double *to) {
  for (int i = 0; i < FREE / PIECE; ++i)
    memcpy(to + free_rows[i], from + PIECE * i, PIECE * sizeof(double));
}
static void pick(const double *from, double *to) {
  for (int i = 0; i < FREE / PIECE; ++i)
    memcpy(to + PIECE * i, from + free_rows[i], PIECE * sizeof(double));
}
static const double *positions(const double *q, double *w) {
  memcpy(w, places, sizeof(places));
  spread(q, w);
  return w;
}
static const double *velocities(const double *v, double *w) {
  w += ENTRIES;
  memset(w, 0, ENTRIES * sizeof(double));
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
_LOAD_GIVEN = "memcpy(f, u + LOAD_AT, ENTRIES * sizeof(double));"
_UNLOADED = "memset(f, 0, ENTRIES * sizeof(double));"

# Where the ends of strings are that move with supports, or their velocities.
_ENDS = """\
static const double *ends(const double *of, const double *u, int part, double *w) {
  double *moved = w + ENDS_AT + part;
  for (int i = 0; i < ENTRIES; ++i) moved[i] = of[i] + u[OFFSET_AT + part + i];
  return moved;
}
"""

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
  const double *p = positions(x, w), *v = velocities(x + FREE, w);
  double *f = w + 2 * ENTRIES, *a;
  (void)iw; (void)mem;
  if (!res[0]) return 0;
  a = res[0] + FREE;
  forces(%(ends)s, u, taut, f);
  memcpy(res[0], x + FREE, FREE * sizeof(double));
%(calls)s
  return 0;
}
"""
# Accelerations of all nodes are put together first.
_SLOPE_ROLLING = _SLOPE.replace("a = res[0] + FREE;", "a = f + ENTRIES + 2 * LARGEST;").replace(
    "%(calls)s", "%(calls)s\n  pick(a, res[0] + FREE);"
)

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
_FORCE_FREE = _FORCE % "  forces(%(ends)s, u, taut, res[0]);"
_FORCE_SUPPORTED = (
    _FORCE
    % """\
  forces(%(ends)s, u, taut, w + 2 * ENTRIES);
  pick(w + 2 * ENTRIES, res[0]);"""
)

_GAP = """\
EXPORTED int gap(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *x = given(arg[0]), *u = given(arg[1]);
  const double *p = positions(x, w), *v = velocities(x + FREE, w);
  double *gap = res[0] ? res[0] : w + 2 * ENTRIES;
  double *rate = res[1] ? res[1] : w + 2 * ENTRIES + LARGEST;
  (void)iw; (void)mem; (void)u; (void)p; (void)v; (void)gap; (void)rate;
%(moved)s
%(calls)s
  return 0;
}
"""

# The work memory holds positions, velocities, then forces, or what nobody asked for; then
# accelerations where nodes roll, and the matrix of the blocks.
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
  if (sz_w) *sz_w = WORK;
  return 0;
}
"""
