"""Our own methods as they are measured: by name, at settings from coarse to fine."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil

from tenscontrol.accuracy.case import Case
from tenscontrol.accuracy.spectrum import fastest_rate
from tenscontrol.integrate import METHODS, Method
from tenscontrol.validation import choice, positive_number

# Steps by the fastest rate of the case, and tolerances, from coarse to fine.
_STEPS = tuple(2.0**-k for k in range(8))
_TOLERANCES = tuple(10.0**-k for k in range(3, 13))


def method_named(name: object) -> Method:
    """Return the method of this name.

    Parameters
    ----------
    name : str

    Returns
    -------
    Method

    Raises
    ------
    ValueError
        If there is none.
    """
    return METHODS[choice("method", name, METHODS)]


def default_settings(method: Method, case: Case) -> tuple[float, ...]:
    """Return steps that fit the case, s, or tolerances, from coarse to fine.

    The coarsest step is the inverse of the fastest rate.

    Parameters
    ----------
    method : Method
    case : Case

    Returns
    -------
    tuple of float
    """
    if method.setting == "tolerance":
        return _TOLERANCES
    rate = fastest_rate(case)
    return tuple(float(f"{share / rate:.3g}") for share in _STEPS)


def checked_settings(name: str, settings: object, unit: str) -> tuple[float, ...]:
    """Return settings from coarse to fine, each a positive number.

    Parameters
    ----------
    name : str
        Of the argument, for messages.
    settings : sequence of float
    unit : str

    Returns
    -------
    tuple of float

    Raises
    ------
    TypeError, ValueError
        If there is none, or one is not a positive number.
    """
    if not isinstance(settings, Iterable) or isinstance(settings, str | bytes):
        raise TypeError(f"{name} is {settings!r}, expected a sequence of numbers in {unit}")
    found = [positive_number(f"{name}[{i}]", value, unit) for i, value in enumerate(settings)]
    if not found:
        raise ValueError(f"{name} is empty, expected at least one number in {unit}")
    return tuple(sorted(set(found), reverse=True))


def as_taken(method: Method, settings: Iterable[float], spacing: float) -> tuple[float, ...]:
    """Return steps as they are taken, shortened to fit between outputs, each once.

    Parameters
    ----------
    method : Method
    settings : iterable of float
        Steps, s, or tolerances, which are left as they are.
    spacing : float
        Time from one output to the next, s.

    Returns
    -------
    tuple of float
    """
    if method.setting == "tolerance":
        return tuple(settings)
    # The allowance is that of the integrators for round-off.
    taken = [spacing / max(1, ceil(spacing / step - 1e-9)) for step in settings]
    return tuple(dict.fromkeys(taken))
