"""The instructions of a CasADi function of numbers, and the C text of each operation."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from types import MappingProxyType
from typing import NamedTuple

import casadi as ca

#: Operations by CasADi's names without ``OP_``, and their C text: of numbers, or of short vectors
#: with one entry a run, once ``TRUTH``, ``ONLY``, ``LARGER``, ``SMALLER``, ``POSITIVE`` and
#: ``CALL``, ``CALL_2`` (a function of the C library, entry by entry) are defined. None for none.
OPERATIONS: Mapping[str, str | None] = MappingProxyType({
    "ASSIGN": "{0}",
    "ADD": "{0} + {1}",
    "SUB": "{0} - {1}",
    "MUL": "{0} * {1}",
    "DIV": "{0} / {1}",
    "NEG": "-{0}",
    "SQ": "{0} * {0}",
    "TWICE": "{0} + {0}",
    "INV": "1.0 / {0}",
    "LT": "TRUTH({0} < {1})",
    "LE": "TRUTH({0} <= {1})",
    "EQ": "TRUTH({0} == {1})",
    "NE": "TRUTH({0} != {1})",
    "NOT": "TRUTH({0} == 0.0)",
    "AND": "TRUTH(({0} != 0.0) & ({1} != 0.0))",
    "OR": "TRUTH(({0} != 0.0) | ({1} != 0.0))",
    "IF_ELSE_ZERO": "ONLY({0} != 0.0, {1})",
    "FABS": "POSITIVE({0})",
    "FMAX": "LARGER({0}, {1})",
    "FMIN": "SMALLER({0}, {1})",
    "POW": "CALL_2(pow, {0}, {1})",
    "CONSTPOW": "CALL_2(pow, {0}, {1})",
    "ATAN2": "CALL_2(atan2, {0}, {1})",
    **{
        name.upper(): f"CALL({name}, {{0}})"
        for name in (
            "sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh",
            "tanh", "floor", "ceil",
        )
    },
    **dict.fromkeys(
        (
            "FMOD", "SIGN", "COPYSIGN", "ERF", "ASINH", "ACOSH", "ATANH", "ERFINV", "LOG1P",
            "EXPM1", "HYPOT", "REMAINDER", "CONST", "INPUT", "OUTPUT",
        )
    ),
})  # fmt: skip

_NAMES = {getattr(ca, f"OP_{name}"): name for name in OPERATIONS}


class Instruction(NamedTuple):
    """One operation of a function of numbers.

    Operands and results are entries of a work vector; of an input or output they are which one it
    is, and which of its entries.
    """

    operation: str
    results: list[int]
    operands: list[int]
    constant: float


def instructions(function: ca.Function) -> list[Instruction] | None:
    """Return the instructions of a function of SX, in order.

    None where the function is none, or has an operation that :data:`OPERATIONS` does not know.
    """
    if not function.is_a("SXFunction"):
        return None
    found = []
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        if code not in _NAMES:
            return None
        constant = function.instruction_constant(k) if code == ca.OP_CONST else 0.0
        results, operands = function.instruction_output(k), function.instruction_input(k)
        found.append(Instruction(_NAMES[code], results, operands, constant))
    return found


def number_text(value: float) -> str:
    """Return the C text of a number."""
    if value != value:
        return "NAN"
    if value in (inf, -inf):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(value)
