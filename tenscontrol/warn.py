"""Warnings that point to the line of the user."""

from __future__ import annotations

import inspect
import warnings

_PACKAGE = __name__.partition(".")[0]

# Frames of these between two of the package belong to the call from outside.
_BETWEEN = ("contextlib", "functools")


def warn(message: str, category: type[Warning]) -> None:
    """Warn at the line outside of the package that led here, however deep the call is."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and (outer := frame.f_back) is not None:
        module = str(outer.f_globals.get("__name__"))
        if module.partition(".")[0] not in (_PACKAGE, *_BETWEEN):
            break
        frame, level = outer, level + 1
    warnings.warn(message, category, stacklevel=level + 1)
