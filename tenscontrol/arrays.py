"""Array types with their tools."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class ArrayRecord:
    """A record that goes wherever one of its arrays does, by the name of the argument."""

    #: Argument, and the attribute that goes there.
    stands_for: ClassVar[Mapping[str, str]]


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only copy of an array, so that a value handed out cannot change."""
    copy = np.array(array, order="C", copy=True)
    copy.setflags(write=False)
    return copy


def all_but(count: int, some: IntArray) -> IntArray:
    """Return the indices below a count that are not among some, ascending."""
    is_left = np.ones(count, dtype=bool)
    is_left[some] = False
    return np.flatnonzero(is_left)


def freeze_arrays(record: object) -> None:
    """Make the arrays of a frozen dataclass read-only, when it is made."""
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            object.__setattr__(record, name, frozen(value))
