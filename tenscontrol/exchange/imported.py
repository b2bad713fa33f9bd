"""What comes from a file of another program."""

from __future__ import annotations

from dataclasses import dataclass

from tenscontrol.arrays import FloatArray, freeze_arrays
from tenscontrol.dynamics.model import Model
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.structure import Structure


@dataclass(frozen=True, eq=False)
class Imported:
    """A model read from a file. Made by the ``from_`` functions.

    Attributes
    ----------
    model : Model
        The structure, with the string law and gravity where the file has them.
    rest_length : ndarray, shape (α,), or None
        Rest lengths of the strings, m; None where the file has none.
    notes : tuple of str
        What the file has and the model does not, one sentence each.
    """

    model: Model
    rest_length: FloatArray | None
    notes: tuple[str, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def structure(self) -> Structure:
        """The structure of the model."""
        return self.model.structure
