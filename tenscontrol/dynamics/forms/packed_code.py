"""C code of an expression with its roots and quotients side by side.

A processor finds several of them in the time of one, if they are neighbours in memory. CasADi
writes operations one by one, each as soon as it can be done, and compilers leave them apart.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from math import isfinite

import casadi as ca

from tenscontrol.dynamics.instructions import OPERATIONS, Instruction, instructions, number_text

# Longer functions take compilers too long.
_MOST_OPERATIONS = 4000

# Comes before packed code. WIDE: the same operations, so the same numbers, in wider registers where
# the machine has them.
PACKED_HEAD = """\
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif
#define TRUTH(x) (x)
#define ONLY(is_so, x) ((is_so) ? (x) : 0)
#define LARGER(x, y) fmax(x, y)
#define SMALLER(x, y) fmin(x, y)
#define POSITIVE(x) fabs(x)"""

# What is brought together: names of vectors, and the operation on their entries.
_PACKED = {
    "SQRT": ("root", "sqrt({0}[i])"),
    "DIV": ("quotient", "{0}[i] / {1}[i]"),
    "INV": ("inverse", "1. / {0}[i]"),
}


def packed_source(function: ca.Function) -> str | None:
    """Return the C text of a function of dense arrays, called as CasADi's; all outputs are found.

    None where the function is no SX, is long, or has more than arithmetic of finite numbers.

    Operations come in layers: first what needs no root or quotient, then the roots and quotients of
    that, then what needs those, and so on.
    """
    if function.is_a("SXFunction") and function.n_instructions() > _MOST_OPERATIONS:
        return None
    steps = instructions(function)
    if steps is None:
        return None
    layers: defaultdict[int, list[str]] = defaultdict(list)
    vectors: Counter[tuple[int, str]] = Counter()
    if not _sort(steps, layers, vectors):
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


def _sort(
    steps: list[Instruction],
    layers: defaultdict[int, list[str]],
    vectors: Counter[tuple[int, str]],
) -> bool:
    """Write operations as lines of C in layers, and count the entries of vectors.

    By layer and operation. False where there is more than arithmetic of finite numbers.
    """
    # Of each entry of CasADi's work vector: its C expression, and the layer where it is known.
    known: dict[int, tuple[str, int]] = {}
    for k, (operation, to, of, constant) in enumerate(steps):
        if operation == "CONST":
            if not isfinite(constant):
                return False
            known[to[0]] = f"({number_text(constant)})", 0
        elif operation == "INPUT":
            known[to[0]] = f"in{of[0]}[{of[1]}]", 0
        elif operation == "OUTPUT":
            text, layer = known[of[0]]
            layers[layer].append(f"out{to[0]}[{to[1]}] = {text};")
        else:
            operands = [known[i][0] for i in of]
            layer = max(known[i][1] for i in of)
            form = OPERATIONS[operation]
            if operation in _PACKED:
                place = layer + 1, operation
                for name, operand in zip(_names(*place), operands, strict=False):
                    layers[layer].append(f"{name}[{vectors[place]}] = {operand};")
                known[to[0]] = f"{_names(*place)[-1]}[{vectors[place]}]", layer + 1
                vectors[place] += 1
            elif form is None or form.startswith("CALL"):
                return False
            else:
                layers[layer].append(f"const double a{k} = {form.format(*operands)};")
                known[to[0]] = f"a{k}", layer
    return True


def _names(layer: int, operation: str) -> list[str]:
    """Return the names of the vectors of operands, and that of the results."""
    name, text = _PACKED[operation]
    operands = ("of", "by")[: 1 + ("{1}" in text)]
    return [*(f"{name}{layer}_{each}" for each in operands), f"{name}{layer}"]
