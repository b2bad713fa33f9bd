"""The instructions of a CasADi function of numbers."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

#: Operations by CasADi's names without ``OP_``.
OPERATIONS = frozenset((
    "ASSIGN", "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV",
    "LT", "LE", "EQ", "NE", "NOT", "AND", "OR", "IF_ELSE_ZERO",
    "FABS", "FMAX", "FMIN", "POW", "CONSTPOW", "ATAN2",
    "SQRT", "EXP", "LOG", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "SINH", "COSH", "TANH",
    "FLOOR", "CEIL", "FMOD", "SIGN", "COPYSIGN", "ERF", "ASINH", "ACOSH", "ATANH", "ERFINV",
    "LOG1P", "EXPM1", "HYPOT", "REMAINDER", "CONST", "INPUT", "OUTPUT",
))  # fmt: skip

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
    listed = []
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        if code not in _NAMES:
            return None
        constant = function.instruction_constant(k) if code == ca.OP_CONST else 0.0
        results, operands = function.instruction_output(k), function.instruction_input(k)
        listed.append(Instruction(_NAMES[code], results, operands, constant))
    return listed
