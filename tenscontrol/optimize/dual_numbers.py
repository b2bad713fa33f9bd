"""Numbers with derivatives, which NumPy's functions take in place of arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from tenscontrol.arrays import FloatArray

# Derivatives of functions by their arguments. At a kink, that of what is taken.
_PARTIALS: dict[np.ufunc, Callable[..., tuple[Any, ...]]] = {
    np.add: lambda a, b: (1.0, 1.0),
    np.subtract: lambda a, b: (1.0, -1.0),
    np.multiply: lambda a, b: (b, a),
    np.divide: lambda a, b: (1 / b, -a / b**2),
    np.power: lambda a, b: (b * a ** (b - 1), np.nan),  # by a number
    np.negative: lambda a: (-1.0,),
    np.absolute: lambda a: (np.sign(a),),
    np.sqrt: lambda a: (0.5 / np.sqrt(a),),
    np.exp: lambda a: (np.exp(a),),
    np.log: lambda a: (1 / a,),
    np.maximum: lambda a, b: (a >= b, a < b),
    np.minimum: lambda a, b: (a <= b, a > b),
}

# Functions that are constant but for jumps.
_FLAT = {
    np.sign, np.isfinite, np.less, np.less_equal, np.greater, np.greater_equal, np.equal,
    np.not_equal,
}  # fmt: skip


class Dual(NDArrayOperatorsMixin):
    """Numbers and their derivatives by some variables, to the first order.

    Derivatives are those of the branch that is taken. Zero times infinity is zero: limits may be
    infinite.

    Parameters
    ----------
    value : ndarray, shape s
    slope : ndarray, shape (m, *s)
        By m variables.
    """

    def __init__(self, value: FloatArray, slope: FloatArray) -> None:
        self.value, self.slope = value, slope

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the numbers."""
        return self.value.shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:
        """Return the numbers without their derivatives."""
        return self.value

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **more: Any) -> Any:
        """Return a function of numbers, elementwise."""
        if method != "__call__" or more:
            return NotImplemented
        values = [_value(given) for given in inputs]
        if function in _FLAT:
            return function(*values)
        if function not in _PARTIALS:
            return NotImplemented
        with np.errstate(all="ignore"):  # where another branch is taken
            result = function(*values)
            partials = _PARTIALS[function](*values)
            slopes = [
                _times(given.slope, by)
                for given, by in zip(inputs, partials, strict=True)
                if isinstance(given, Dual)
            ]
        slope = sum(slopes[1:], slopes[0])
        return Dual(result, np.broadcast_to(slope, (len(slope), *result.shape)))

    def __array_function__(
        self, function: Any, types: Any, given: Sequence[Any], more: Mapping[str, Any]
    ) -> Any:
        """Return what NumPy's functions that choose and stack make of numbers."""
        if function is np.where:
            chosen, first, second = given
            return _of_all(lambda a, b: np.where(chosen, a, b), (first, second))
        if function is np.clip:
            x, low, high = given
            return np.minimum(np.maximum(x, low), high)
        if function is np.stack and more == {"axis": -1}:
            return _of_all(lambda *rows: np.stack(rows, axis=-1), given[0])
        return NotImplemented


def _value(given: Any) -> Any:
    return given.value if isinstance(given, Dual) else given


def _times(slope: FloatArray, by: Any) -> FloatArray:
    """Return products, zero where a factor is."""
    return np.where((slope != 0) & (by != 0), slope * by, 0.0)


def _of_all(function: Callable[..., Any], given: Sequence[Any]) -> Dual:
    """Return a function that is linear in each of the given, in values and derivatives."""
    values = np.broadcast_arrays(*map(_value, given))
    count = max(len(numbers.slope) for numbers in given if isinstance(numbers, Dual))
    slopes = [
        np.broadcast_to(numbers.slope if isinstance(numbers, Dual) else 0.0, (count, *value.shape))
        for numbers, value in zip(given, values, strict=True)
    ]
    return Dual(function(*values), function(*slopes))
