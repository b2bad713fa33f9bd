"""Calls of a CasADi function on NumPy arrays without conversion or allocation."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.validation import FloatArray


class Evaluator:
    """A CasADi function behind its buffer: about fifty times cheaper to call than the function.

    Outputs are views of memory that the next call overwrites; copy what must
    last. Inputs are trusted: callers check them.

    Parameters
    ----------
    function : casadi.Function
        All inputs and outputs dense.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._buffer, self._run = function.buffer()
        self._inputs: list[FloatArray] = []
        self._outputs: list[FloatArray] = []
        self.calls = 0
        for i in range(function.n_in()):
            self._inputs.append(_dense(function.sparsity_in(i)))
            self._buffer.set_arg(i, _memory(self._inputs[i]))
        for i in range(function.n_out()):
            self._outputs.append(_dense(function.sparsity_out(i)))
            self._buffer.set_res(i, _memory(self._outputs[i]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the function; the memory is made anew."""
        return Evaluator, (self._function,)

    def __call__(self, *arguments: Any) -> list[FloatArray]:
        """Evaluate and return one array per output: a vector, or a matrix in Fortran order."""
        for target, argument in zip(self._inputs, arguments, strict=True):
            np.copyto(target, argument)
        self._run()
        self.calls += 1
        return self._outputs


def evaluate_columns(function: ca.Function, *columns: FloatArray) -> list[FloatArray]:
    """Evaluate a function of column vectors at T of them, one a column of each argument.

    Parameters
    ----------
    function : casadi.Function
        Dense column vectors in and out.
    *columns : ndarray, shape (size of the input, T)

    Returns
    -------
    list of ndarray, shape (size of the output, T)
    """
    count = columns[0].shape[1]
    results = Evaluator(function.map(count))(*(_as_stored(column) for column in columns))
    return [result.reshape(-1, count, order="F") for result in results]


def _as_stored(column: FloatArray) -> FloatArray:
    """Return a matrix in the shape in which an evaluator holds it."""
    return column.ravel() if column.shape[1] == 1 else column


def _dense(sparsity: ca.Sparsity) -> FloatArray:
    if not sparsity.is_dense():
        raise ValueError(f"the function has a sparse argument {sparsity.dim()}, expected dense")
    rows, columns = sparsity.shape
    # CasADi stores by columns; a single column is a plain vector here.
    return np.zeros(rows) if columns == 1 else np.zeros((rows, columns), order="F")


def _memory(array: FloatArray) -> memoryview:
    """Return the memory of an array as CasADi reads it; no copy."""
    return memoryview(array.ravel(order="K").data)
