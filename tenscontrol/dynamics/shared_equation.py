"""Equation of a model, made from that of another one in which some parameters differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import InputLayout
from tenscontrol.dynamics.evaluator import Function


def with_values(
    function: ca.Function, input: int, layout: InputLayout, values: Mapping[str, FloatArray]
) -> ca.Function:
    """Return a function of SX whose input u, that of a number, has the parameters no more.

    Parameters
    ----------
    function : casadi.Function
    input : int
        Which input is u.
    layout : InputLayout
        Of u, with parameters.
    values : mapping of str to ndarray
        Of the parameters.
    """
    own = np.concatenate([values[name] for name, _ in layout.parameters])
    before, rest = layout.strings + layout.load, layout.count - len(own)
    u = ca.SX.sym("u", layout.size - len(own) * (layout.degree + 1))
    rows = []
    for power in range(layout.degree + 1):
        begin, middle = power * rest, power * rest + before
        constant = ca.DM(own) if power == 0 else ca.DM.zeros(len(own))
        # With the column: of a u of one entry, an empty slice else is a row.
        rows += [u[begin:middle, 0], constant, u[middle : begin + rest, 0]]
    if layout.degree:
        rows.append(u[-1])
    arguments: list[Any] = [
        ca.SX.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in())
    ]
    inputs = arguments.copy()
    inputs[input], arguments[input] = u, ca.vertcat(*rows)
    return Function(function.name(), inputs, function.call(arguments))
