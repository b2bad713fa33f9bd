"""Declarations of the fields of records."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, field, fields
from functools import cache
from importlib import import_module
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen

_Given = TypeVar("_Given", contravariant=True)
_Held = TypeVar("_Held", covariant=True)
_Record = TypeVar("_Record")


class Field(Generic[_Given, _Held]):
    """A field that takes one type and holds another, which ``__post_init__`` makes of it.

    For type checkers alone: at run time no field is one.
    """

    def __get__(self, instance: object, owner: object = None) -> _Held:
        """Return what is held."""
        raise NotImplementedError

    def __set__(self, instance: object, value: _Given) -> None:
        """Take what is given."""
        raise NotImplementedError


Array = Field[ArrayLike, FloatArray]
OptionalArray = Field[ArrayLike | None, FloatArray | None]


def converted(default: object = MISSING, metadata: Mapping[str, Any] | None = None) -> Any:
    """Return a field of a type like :data:`Array`, with a default or without."""
    return field(default=default, metadata=metadata)


def checked(check: Callable[..., object], *details: object) -> Mapping[str, Any]:
    """Return metadata of a field: ``check(name, value, *details)`` returns its value, or raises."""
    return {"check": check, "details": details}


def optional(check: Callable[..., object], *details: object) -> Mapping[str, Any]:
    """Return metadata of a field that is None or passes a check, as :func:`checked`."""
    return {**checked(check, *details), "optional": True}


def instance_of(name: str, value: object, kind: str, how: str) -> object:
    """Check as :func:`validation.instance`: of a class by its whole name, not loaded for None."""
    module, _, of = kind.rpartition(".")
    return validation.instance(name, value, getattr(import_module(module), of), how)


def check_fields(record: Any, but: frozenset[str] = frozenset()) -> None:
    """Check the fields of a frozen record in their order, and keep read-only arrays."""
    kind: Any = type(record)
    values = record.__dict__
    for name, check, details, takes_none in _declared(kind, but):
        given = value = values[name]
        if given is None and takes_none:
            continue
        if check is not None:
            value = check(name, given, *details)
        if isinstance(value, np.ndarray):
            value = frozen(value)
        if value is not given:
            object.__setattr__(record, name, value)


def changed(record: _Record, **values: Any) -> _Record:
    """Return a copy of a record with other values of some fields, which need no check."""
    copy = object.__new__(type(record))
    copy.__dict__.update(record.__dict__, **values)
    return copy


@cache
def _declared(
    kind: Any, but: frozenset[str]
) -> tuple[tuple[str, Callable[..., object] | None, Any, bool], ...]:
    """Return the fields of a class but for some, with their checks, and whether None passes."""
    named = [(one.name, one.metadata) for one in fields(kind) if one.name not in but]
    return tuple(
        (name, how.get("check"), how.get("details", ()), "check" not in how or "optional" in how)
        for name, how in named
    )
