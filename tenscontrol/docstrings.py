"""The Parameters sections of docstrings."""

from __future__ import annotations

import re
from collections.abc import Callable
from inspect import getdoc
from typing import NamedTuple, TypeVar

_Class = TypeVar("_Class", bound=type)

# From the title to the next title or to the end.
_SECTION = re.compile(r"^Parameters\n-+\n(.*?)(?=\n\n[A-Z][\w ]*\n--+\n|\Z)", re.DOTALL | re.M)


class Documented(NamedTuple):
    """What a docstring says of a parameter: type and description, each in one line."""

    type: str
    text: str


def documented(function: Callable[..., object]) -> dict[str, Documented]:
    """Return what the docstring of a function or class says of each parameter."""
    parameters = {}
    for entry in _entries(function):
        names, _, text = entry.partition("\n")
        names, _, kind = names.partition(" : ")
        for name in names.split(", "):
            parameters[name] = Documented(kind, " ".join(text.split()))
    return parameters


def with_parameters_of(other: type) -> Callable[[_Class], _Class]:
    """Return a decorator of classes whose docstrings lack parameters that another class has."""

    def decorate(cls: _Class) -> _Class:
        known, section = documented(cls), _SECTION.search(getdoc(cls) or "")
        missing = [entry for entry in _entries(other) if re.split(r"\W", entry)[0] not in known]
        if section is not None:  # there are docstrings: not so in python -OO
            before, after = section.string[: section.end()], section.string[section.end() :]
            cls.__doc__ = "\n".join([before.rstrip(), *missing]) + after
        return cls

    return decorate


def _entries(function: Callable[..., object]) -> list[str]:
    section = _SECTION.search(getdoc(function) or "")
    return re.split(r"\n(?=\S)", section[1].rstrip()) if section else []
