"""What is built once for a model or a plant and used by every later call."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

_Value = TypeVar("_Value")

# CasADi's symbols are counted without a lock of their own: one thread builds at a time.
_BUILDING = threading.RLock()

# Distinct inputs, methods and settings of one model in a program; the oldest is dropped.
_MOST = 32


class Prepared:
    """Functions and matrices by key: bounded, thread-safe, and left out of pickles and copies.

    Examples
    --------
    >>> prepared = Prepared()
    >>> prepared.get("square", lambda: print("built") or 4), prepared.get("square", None)
    built
    (4, 4)
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, build: Callable[[], _Value]) -> _Value:
        """Return what was built for a key; the first time, build it.

        Parameters
        ----------
        key : hashable
            All that the value depends on, beside the owner of this object.
        build : callable
            Builds the value; must not return None.
        """
        with _BUILDING:
            value: _Value | None = self._kept.get(key)
            if value is None:
                value = build()
                self._kept[key] = value
                while len(self._kept) > _MOST:
                    self._kept.popitem(last=False)
            else:
                self._kept.move_to_end(key)
            return value

    def __reduce__(self) -> tuple[type[Prepared], tuple[()]]:
        """Pickle and copy as an empty store."""
        return Prepared, ()
