"""Arguments of a call by name, as a run and its file keep them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol.arrays import frozen


@dataclass(frozen=True)
class Unsaved:
    """A value that a file names and does not hold: where it belongs, and what it was."""

    place: str
    what: str

    @classmethod
    def of(cls, place: str, value: object) -> Unsaved:
        """Return what is left of a value: the name of a function or class, or of its class."""
        is_named = hasattr(value, "__qualname__")
        named: Any = value if is_named else type(value)
        full_name = f"{named.__qualname__} of {named.__module__}"
        return cls(place, f"the function or class {full_name}" if is_named else f"a {full_name}")

    def __str__(self) -> str:
        return (
            f"{self.place} was {self.what}, which a file of a run does not hold: give it again "
            "where you need it"
        )


class Arguments(Mapping[str, Any]):
    """Arguments by name, as they were given; read-only.

    In a run from a file a function is named only: asking for it raises a ValueError that says so.
    """

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        self._values = {
            name: frozen(value) if isinstance(value, np.ndarray) else value
            for name, value in (values or {}).items()
        }

    def __getitem__(self, name: str) -> Any:
        """Return the argument of this name."""
        value = self._values[name]
        if isinstance(value, Unsaved):
            raise ValueError(str(value))
        return value

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a file does: a function may be one that no other process can find."""
        left = {
            name: Unsaved.of(name, value) if callable(value) else value
            for name, value in self._values.items()
        }
        return Arguments, (left,)

    def __repr__(self) -> str:
        return f"Arguments({', '.join(self._values)})"

    @property
    def raw(self) -> dict[str, Any]:
        """All values, with :class:`Unsaved` for what a file did not hold; not for users."""
        return self._values
