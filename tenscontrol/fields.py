"""Declarations of the fields of records."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, field, fields
from functools import cache
from importlib import import_module
from itertools import compress
from operator import is_not
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
    names, passing, declared = _declared(kind, but)
    for name, check, details, takes_none in compress(
        declared, map(is_not, map(values.__getitem__, names), passing)
    ):
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


_Declared = tuple[str, Callable[..., object] | None, Any, bool]


@cache
def _declared(
    kind: Any, but: frozenset[str]
) -> tuple[tuple[str, ...], tuple[object, ...], tuple[_Declared, ...]]:
    """Return the fields of a class but for some: names, what passes as it is, and checks.

    With each check goes whether None passes. A default needs no look where its check returns it.
    """
    wanted = [one for one in fields(kind) if one.name not in but]
    declared = tuple(
        (
            one.name, one.metadata.get("check"), one.metadata.get("details", ()),
            "check" not in one.metadata or "optional" in one.metadata,
        )
        for one in wanted
    )  # fmt: skip
    pairs = zip(declared, (one.default for one in wanted), strict=True)
    passing = tuple(default if _passes(*how, default) else MISSING for how, default in pairs)
    return tuple(one.name for one in wanted), passing, declared


def _passes(
    name: str, check: Callable[..., object] | None, details: Any, takes_none: bool, default: object
) -> bool:
    """Return whether a default passes the check of its field as it is."""
    if default is None or default is MISSING or isinstance(default, np.ndarray):
        return default is None and takes_none
    return check is None or check(name, default, *details) is default
