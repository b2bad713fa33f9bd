"""CasADi functions: kept once they are built, and called on NumPy arrays without allocation."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock, get_ident
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from tenscontrol.dynamics.threads import BUILDING
from tenscontrol.validation import FloatArray

_Value = TypeVar("_Value")

# Distinct inputs, methods and settings of one model in a program; the oldest is dropped.
_MOST = 32


class Prepared:
    """Functions and matrices by key: bounded, thread-safe, and left out of pickles and copies."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = Lock()

    def get(self, key: Hashable, build: Callable[[], _Value]) -> _Value:
        """Return what was built for a key; the first time, build it: anything but None.

        The key holds all that the value depends on, beside the owner of this object. Threads share
        the value, so it has no memory: functions, not evaluators.
        """
        value: _Value | None = self._find(key)
        if value is None:
            with BUILDING:
                value = self._find(key)
                if value is None:
                    value = self._keep(key, build())
        return value

    def _find(self, key: Hashable) -> Any:
        with self._lock:
            value = self._kept.get(key)
            if value is not None:
                self._kept.move_to_end(key)
            return value

    def _keep(self, key: Hashable, value: _Value) -> _Value:
        with self._lock:
            # While a compiler ran, another thread may have been first.
            value = self._kept.setdefault(key, value)
            dropped = [self._kept.popitem(last=False) for _ in range(len(self._kept) - _MOST)]
        del dropped
        return value

    def __reduce__(self) -> tuple[type[Prepared], tuple[()]]:
        """Pickle and copy as an empty store."""
        return Prepared, ()


# Columns that are evaluated in one call, and functions mapped to so many.
_CHUNK = 32
_MAPPED = Prepared()


class Evaluator:
    """A CasADi function behind its buffer: about fifty times cheaper to call than the function.

    Outputs are views of memory that the next call overwrites; copy what must last. Inputs are
    trusted: callers check them. All inputs and outputs of the function must be dense. Each thread
    needs an evaluator of its own; a call during another thread's raises RuntimeError.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._buffer, self._run = function.buffer()
        self._inputs: list[FloatArray] = []
        self._outputs: list[FloatArray] = []
        self.calls, self._user = 0, 0
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
        me = get_ident()
        if self._user not in (0, me):
            raise RuntimeError(
                f"the evaluator of {self._function.name()!r} is used by another thread at this "
                "moment: it has a memory. Give each thread its own, Evaluator(function)"
            )
        try:
            self._user = me
            for target, argument in zip(self._inputs, arguments, strict=True):
                np.copyto(target, argument)
            self._run()
            self.calls += 1
        finally:
            self._user = 0
        return self._outputs


class ColumnEvaluator:
    """A function of dense column vectors, evaluated at any number of them without building anew.

    Columns are taken in chunks of one size, the last one filled up. The function is kept with its
    map to a chunk, for the next evaluator of the same function.
    """

    def __init__(self, function: ca.Function) -> None:
        self._rows = [function.size1_out(i) for i in range(function.n_out())]
        self._one = Evaluator(function)
        self._chunk = Evaluator(_MAPPED.get(function, lambda: (function, function.map(_CHUNK)))[1])

    def __call__(self, *columns: FloatArray) -> list[FloatArray]:
        """Return arrays of shape (size of the output, T) for arrays (size of the input, T)."""
        count = columns[0].shape[1]
        results: list[FloatArray] = [np.empty((rows, count)) for rows in self._rows]
        for start in range(0, count, _CHUNK):
            if start + 1 == count:
                parts = self._one(*(column[:, start] for column in columns))
            else:
                places = np.minimum(np.arange(start, start + _CHUNK), count - 1)
                parts = self._chunk(*(column[:, places] for column in columns))
            end = min(start + _CHUNK, count)
            for result, part in zip(results, parts, strict=True):
                result[:, start:end] = part.reshape(len(result), -1, order="F")[:, : end - start]
        return results


def evaluate_columns(function: ca.Function, *columns: FloatArray) -> list[FloatArray]:
    """Evaluate a function of column vectors at T of them; see :class:`ColumnEvaluator`."""
    return ColumnEvaluator(function)(*columns)


def _dense(sparsity: ca.Sparsity) -> FloatArray:
    if not sparsity.is_dense():
        raise ValueError(f"the function has a sparse argument {sparsity.dim()}, expected dense")
    rows, columns = sparsity.shape
    # CasADi stores by columns; a single column is a plain vector here.
    return np.zeros(rows) if columns == 1 else np.zeros((rows, columns), order="F")


def _memory(array: FloatArray) -> memoryview:
    """Return the memory of an array as CasADi reads it; no copy."""
    return memoryview(array.ravel(order="K").data)
