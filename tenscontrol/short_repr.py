"""Text of records that hold many numbers: what each field is, in a line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

# Characters from which on no further field is written, and of one value that is no array.
_LONG, _VALUE = 200, 60


def short_repr(record: Any) -> str:
    """Return a line for a dataclass: numbers as they are, arrays by shape and range.

    What is None or empty is left out, and so are private fields.
    """
    parts: list[str] = []
    for field in fields(record):
        value = getattr(record, field.name)
        if field.name.startswith("_") or value is None or _is_empty(value):
            continue
        if sum(map(len, parts)) > _LONG:
            parts.append("…")
            break
        parts.append(f"{field.name}={_short(value)}")
    return f"{type(record).__name__}({', '.join(parts)})"


def _is_empty(value: Any) -> bool:
    is_sized = isinstance(value, tuple | list | Mapping | str)
    return value.size == 0 if isinstance(value, np.ndarray) else is_sized and len(value) == 0


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return _short_array(value)
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    if isinstance(value, tuple | list) and len(value) > 3:
        return f"{type(value).__name__} of {len(value)}"
    if callable(value) and hasattr(value, "__name__"):
        return str(value.__name__)
    text = " ".join(repr(value).split())
    return text if len(text) <= _VALUE and " at 0x" not in text else type(value).__name__


def _short_array(array: np.ndarray) -> str:
    shape = "×".join(map(str, array.shape))
    if array.dtype.kind not in "iuf":
        return f"{shape} {array.dtype}"
    known = array[np.isfinite(array)] if array.dtype.kind == "f" else array
    if known.size == 0:
        return f"{shape}, none finite"
    low, high = known.min(), known.max()
    if array.size <= 3 and low != high:
        return "[" + ", ".join(f"{entry:.4g}" for entry in array.ravel()) + "]"
    if low == high and known.size == array.size:
        return f"{low:.4g}" if array.ndim <= 1 else f"{shape} of {low:.4g}"
    return f"{shape} from {low:.4g} to {high:.4g}"
