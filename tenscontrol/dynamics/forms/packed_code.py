"""C code of an expression with its roots and quotients side by side.

A processor finds several of them in the time of one, if they are neighbours in memory. CasADi
writes operations one by one, each as soon as it can be done, and compilers leave them apart.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from math import isfinite

import casadi as ca

# Longer functions take compilers too long.
_MOST_OPERATIONS = 4000

# The same operations, so the same numbers, in wider registers where the machine has them.
WIDE = """\
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif"""

_OPERATIONS = {
    ca.OP_ASSIGN: "{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}",
    ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2. * {0}",
    ca.OP_FMAX: "fmax({0}, {1})", ca.OP_FMIN: "fmin({0}, {1})", ca.OP_FABS: "fabs({0})",
    ca.OP_LT: "{0} < {1}", ca.OP_LE: "{0} <= {1}", ca.OP_IF_ELSE_ZERO: "{0} ? {1} : 0",
}  # fmt: skip

# What is brought together: names of vectors, and the operation on their entries.
_PACKED = {
    ca.OP_SQRT: ("root", "sqrt({0}[i])"),
    ca.OP_DIV: ("quotient", "{0}[i] / {1}[i]"),
    ca.OP_INV: ("inverse", "1. / {0}[i]"),
}


def packed_source(function: ca.Function) -> str | None:
    """Return the C text of a function of dense arrays, called as CasADi's; all outputs are found.

    None where the function is no SX, is long, or has more than arithmetic of finite numbers.

    Operations come in layers: first what needs no root or quotient, then the roots and quotients of
    that, then what needs those, and so on.
    """
    count = function.n_instructions() if function.is_a("SXFunction") else _MOST_OPERATIONS + 1
    if count > _MOST_OPERATIONS:
        return None
    # Of each entry of CasADi's work vector: its C expression, and the layer where it is known.
    known: dict[int, tuple[str, int]] = {}
    layers: defaultdict[int, list[str]] = defaultdict(list)
    vectors: Counter[tuple[int, int]] = Counter()  # entries, by layer and operation
    for k in range(count):
        operation, given = function.instruction_id(k), function.instruction_input(k)
        found = function.instruction_output(k)
        if operation == ca.OP_CONST:
            value = float(function.instruction_constant(k))
            if not isfinite(value):
                return None
            known[found[0]] = f"({value!r})", 0
        elif operation == ca.OP_INPUT:
            known[found[0]] = f"in{given[0]}[{given[1]}]", 0
        elif operation == ca.OP_OUTPUT:
            text, layer = known[given[0]]
            layers[layer].append(f"out{found[0]}[{found[1]}] = {text};")
        else:
            operands = [known[i][0] for i in given]
            layer = max(known[i][1] for i in given)
            if operation in _PACKED:
                place = layer + 1, operation
                for name, each in zip(_names(*place), operands, strict=False):
                    layers[layer].append(f"{name}[{vectors[place]}] = {each};")
                known[found[0]] = f"{_names(*place)[-1]}[{vectors[place]}]", layer + 1
                vectors[place] += 1
            elif operation in _OPERATIONS:
                text = _OPERATIONS[operation].format(*operands)
                layers[layer].append(f"const double a{k} = {text};")
                known[found[0]] = f"a{k}", layer
            else:
                return None
    lines = [f"const double *restrict in{i} = arg[{i}];" for i in range(function.n_in())]
    lines += [f"double *restrict out{i} = res[{i}];" for i in range(function.n_out())]
    for place, size in vectors.items():
        lines.append("double " + ", ".join(f"{name}[{size}]" for name in _names(*place)) + ";")
    lines += [f"(void)in{i};" for i in range(function.n_in())]
    for layer in range(1 + max([0, *layers, *(at for at, _ in vectors)])):
        for (at, operation), size in vectors.items():
            if at == layer:
                *operands, result = _names(at, operation)
                each = _PACKED[operation][1].format(*operands)
                lines.append(f"for (int i = 0; i < {size}; ++i) {result}[i] = {each};")
        lines += layers[layer]
    given = "const double **arg, double **res, casadi_int *iw, double *w, int mem"
    body = "\n  ".join([*lines, "(void)iw; (void)w; (void)mem;", "return 0;"])
    return f"WIDE static int {function.name()}({given}) {{\n  {body}\n}}\n"


def _names(layer: int, operation: int) -> list[str]:
    """Return the names of the vectors of operands, and that of the results."""
    name, text = _PACKED[operation]
    operands = ("of", "by")[: 1 + ("{1}" in text)]
    return [*(f"{name}{layer}_{each}" for each in operands), f"{name}{layer}"]
