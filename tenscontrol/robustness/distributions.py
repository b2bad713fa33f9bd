"""Distributions of the random parameters of a sweep."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.fields import Array, converted
from tenscontrol.short_repr import short_repr

Drawn = float | list[float]

# Streams of random numbers of a run: one for each parameter, by its name, and one for the case.
# So a further parameter changes nothing of what the others and the case draw.
_PARAMETERS, CASE = 0, 1


@dataclass(frozen=True, eq=False)
class Distribution(ABC):
    """Base class of distributions of independent random numbers.

    Attributes
    ----------
    size : int or None
        How many a run gets: an array of shape (size,), or a float where None.
    """

    _: KW_ONLY
    size: int | None = None

    @abstractmethod
    def _numbers(self, rng: np.random.Generator) -> Any:
        """Return a number, or ``size`` of them."""

    def __post_init__(self) -> None:
        if self.size is not None:
            object.__setattr__(
                self, "size", validation.whole_number("size", self.size, 1, validation.MOST_RUNS)
            )

    def draw(self, rng: np.random.Generator) -> Drawn:
        """Return what one run gets: a number, or a list of ``size`` numbers.

        Parameters
        ----------
        rng : numpy.random.Generator

        Returns
        -------
        float or list of float
        """
        numbers = np.asarray(self._numbers(rng), dtype=float)
        return float(numbers) if self.size is None else numbers.tolist()

    def settings(self) -> dict[str, Any]:
        """Return the kind and its settings, as they stand in the file of a sweep.

        Returns
        -------
        dict of str to str, float, int, list or None
        """
        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays = {
            name: value.tolist()
            for name, value in settings.items()
            if isinstance(value, np.ndarray)
        }
        return {"kind": type(self).__name__} | settings | arrays


@final
@dataclass(frozen=True, eq=False)
class Uniform(Distribution):
    """Uniform distribution between two bounds.

    Parameters
    ----------
    low, high : float
        Bounds, ascending, in the unit of what is drawn; equal ones give always that number.
    size : int, optional
        How many numbers a run gets: an array of shape (size,), or a float if not given.

    Raises
    ------
    TypeError, ValueError
        If a bound is not a finite number, or ``low`` is above ``high``.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> np.round(tc.Uniform(0.8, 1.2, size=2).draw(np.random.default_rng(0)), 4)
    array([1.0548, 0.9079])
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = one_number("low", self.low), one_number("high", self.high)
        if low > high:
            raise ValueError(f"low is {low:g} and high is {high:g}, expected low up to high")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)

    def _numbers(self, rng: np.random.Generator) -> Any:
        return rng.uniform(self.low, self.high, self.size)


@final
@dataclass(frozen=True, eq=False)
class Normal(Distribution):
    """Normal distribution.

    Parameters
    ----------
    mean : float
        In the unit of what is drawn.
    deviation : float
        Standard deviation, at least 0, in that unit; 0 gives always the mean.
    size : int, optional
        How many numbers a run gets: an array of shape (size,), or a float if not given.

    Raises
    ------
    TypeError, ValueError
        If a number is not finite, or the deviation is negative.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> round(tc.Normal(0.0, 0.005).draw(np.random.default_rng(0)), 6)
    0.000629
    """

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "mean", one_number("mean", self.mean))
        deviation = one_number("deviation", self.deviation)
        if deviation < 0:
            raise ValueError(f"deviation is {deviation:g}, expected at least 0")
        object.__setattr__(self, "deviation", deviation)

    def _numbers(self, rng: np.random.Generator) -> Any:
        return rng.normal(self.mean, self.deviation, self.size)


@final
@dataclass(frozen=True, eq=False)
class OneOf(Distribution):
    """Discrete uniform distribution over given numbers.

    Parameters
    ----------
    values : array_like, shape (k,)
        What there is to choose from.
    size : int, optional
        How many numbers a run gets: an array of shape (size,), or a float if not given.

    Raises
    ------
    TypeError, ValueError
        If the values are not finite numbers in a row, or there is none.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> tc.OneOf([0.0, 0.01, 0.02]).draw(np.random.default_rng(0))
    0.02
    """

    values: Array = converted()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        super().__post_init__()
        values = validation.vector("values", self.values)
        if values.ndim != 1 or len(values) == 0:
            raise ValueError(f"values has shape {values.shape}, expected (k,) with k at least 1")
        object.__setattr__(self, "values", frozen(values))

    def _numbers(self, rng: np.random.Generator) -> Any:
        return rng.choice(self.values, self.size)


@final
@dataclass(frozen=True, eq=False)
class GivenValues(Distribution):
    """Values that are no draws: one, or one row, for each run in turn."""

    values: Array = converted()

    def of_run(self, run: int) -> Drawn:
        """Return what a run gets, by its index."""
        value: Drawn = self.values[run].tolist()
        return value

    def _numbers(self, rng: np.random.Generator) -> Any:
        return rng.choice(self.values)


def one_number(name: str, value: object) -> float:
    """Return a finite number, or raise an error that names it."""
    array = validation.float_array(name, value)
    if array.ndim:
        raise ValueError(f"{name} has shape {array.shape}, expected one number")
    return float(array)


def draw_run(parameters: Mapping[str, Distribution], seed: int, run: int) -> dict[str, Drawn]:
    """Return the parameters of a run, which hang on the seed and the index alone."""
    drawn = {}
    for name, distribution in parameters.items():
        if isinstance(distribution, GivenValues):
            drawn[name] = distribution.of_run(run)
        else:
            drawn[name] = distribution.draw(generator(seed, run, _PARAMETERS, *name.encode()))
    return drawn


def draw_rows(
    parameters: Mapping[str, Distribution], rng: np.random.Generator, count: int
) -> dict[str, FloatArray] | None:
    """Return rows of parameters, shape (count, size or 1), one after the other; None for none."""
    rows = [[kind.draw(rng) for kind in parameters.values()] for _ in range(count)]
    drawn = zip(*rows, strict=True)
    return {
        name: np.reshape(values, (count, -1))
        for name, values in zip(parameters, drawn, strict=False)
    } or None


def generator(seed: int, *key: int) -> np.random.Generator:
    """Return the generator that ``SeedSequence(seed)`` spawns at this key."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
