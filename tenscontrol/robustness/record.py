"""One run of a sweep as it is kept, in memory and as a line of a file."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from tenscontrol.robustness.distributions import Drawn


@dataclass(frozen=True)
class Record:
    """One run: what was drawn, and what came of it.

    Attributes
    ----------
    run : int
        Index of the run, from 0.
    parameters : dict of str to float or list of float
    success : bool
        False where the case raised.
    figures : dict of str to float, or None
        None where the case raised.
    error, message : str or None
        Kind and text of what the case raised; None where it did not.
    """

    run: int
    parameters: dict[str, Drawn]
    success: bool
    figures: dict[str, float] | None = None
    error: str | None = None
    message: str | None = None

    def line(self) -> str:
        """Return the record as a line of JSON. Floats are written so that they come back."""
        return json.dumps(asdict(self), allow_nan=False)

    def numbers(self) -> tuple[Any, ...]:
        """Return all but the text of an error."""
        return self.run, self.parameters, self.success, self.figures, self.error


def read_record(found: dict[str, Any]) -> Record:
    """Return the record of what a line holds, or raise ValueError or TypeError."""
    record = Record(**found)
    if not isinstance(record.run, int):
        raise TypeError(f"run is {record.run!r}, expected a whole number")
    return record
