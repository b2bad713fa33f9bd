"""What one run of a sweep says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import final

from tenscontrol.validation import float_array, truth


@final
@dataclass(frozen=True, init=False)
class Outcome:
    """What a case returns: whether the run was a success, and its figures.

    Parameters
    ----------
    success : bool
    figures : mapping of str to float, optional
        Finite numbers by name, the same names in every run. Names carry no
        unit; say in the case's docstring what they are in.

    Raises
    ------
    TypeError, ValueError
        If ``success`` is neither True nor False, or a figure has no name or is
        not one finite number. Raised within a case, that is a failure of the run.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> outcome = tc.robustness.Outcome(success=True, figures={"final_error": 0.8e-3})
    >>> outcome.success, outcome.figures
    (True, {'final_error': 0.0008})
    """

    success: bool
    _figures: tuple[tuple[str, float], ...] = field(repr=False)

    def __init__(self, success: bool, figures: Mapping[str, object] | None = None) -> None:
        given = {} if figures is None else figures
        if not isinstance(given, Mapping):
            raise TypeError(f"figures is a {type(given).__name__}, expected a dict of numbers")
        put = object.__setattr__  # the dataclass is frozen for everyone else
        put(self, "success", truth("success", success, "whether the run was a success"))
        put(self, "_figures", tuple((_name(name), _figure(name, given[name])) for name in given))

    @property
    def figures(self) -> dict[str, float]:
        """The figures by name; a new dict at each access."""
        return dict(self._figures)


def _name(name: object) -> str:
    if not isinstance(name, str) or not name:
        raise TypeError(f"figures has the key {name!r}, expected a name")
    return name


def _figure(name: object, value: object) -> float:
    array = float_array(f"figures[{name!r}]", value)
    if array.ndim:
        raise ValueError(f"figures[{name!r}] has shape {array.shape}, expected one number")
    return float(array)
