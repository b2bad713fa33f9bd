"""Errors of structures that some sizes do not make."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import wraps
from inspect import signature
from numbers import Real
from typing import ParamSpec

from tenscontrol.structure.structure import Structure

_Arguments = ParamSpec("_Arguments")


def of_sizes(function: Callable[_Arguments, Structure]) -> Callable[_Arguments, Structure]:
    """Let an error in the structure name the sizes that it was made of."""

    @wraps(function)
    def structure(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> Structure:
        try:
            return function(*args, **kwargs)
        except ValueError as error:
            given = signature(function).bind(*args, **kwargs)
            given.apply_defaults()
            if any(re.search(rf"\b{name}\b", str(error)) for name in given.arguments):
                raise
            sizes = ", ".join(
                f"{name} = {float(value):g}"
                for name, value in given.arguments.items()
                if isinstance(value, Real)
            )
            raise ValueError(f"{sizes} make no structure: {error}") from error

    return structure
