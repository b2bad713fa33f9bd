"""Values of parameters for many runs: full grids and random draws."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.robustness.distributions import Distribution, GivenValues, draw_run


def grid(values: Mapping[str, object]) -> dict[str, FloatArray]:
    """Return all combinations of values of some parameters: a run for each.

    Parameters
    ----------
    values : mapping of str to array_like, shape (k,) or (k, members)
        By name, the values that a parameter takes: numbers, or rows of one number a member.

    Returns
    -------
    dict of str to ndarray, shape (runs,) or (runs, members)
        What :func:`simulate_many` takes as ``vary``, and :func:`sweep` as ``parameters``. The last
        name changes fastest.

    Raises
    ------
    TypeError, ValueError
        If an array does not fit or is not finite, or there are more than 10,000,000 runs.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> vary = tc.grid({"ground.friction": [0.2, 0.5], "bar_mass": [0.9, 1.0, 1.1]})
    >>> vary["ground.friction"].tolist(), vary["bar_mass"].tolist()
    ([0.2, 0.2, 0.2, 0.5, 0.5, 0.5], [0.9, 1.0, 1.1, 0.9, 1.0, 1.1])
    """
    wanted = "a dict of arrays, by name, at least one"
    validation.named("values", values, wanted)
    if not values:
        raise validation.wrong_kind("values", values, wanted)
    choices = {name: _rows(f"values[{name!r}]", given) for name, given in values.items()}
    runs = prod(map(len, choices.values()))
    validation.whole_number("the number of runs", runs, 1, validation.MOST_RUNS)
    places = np.unravel_index(np.arange(runs), tuple(map(len, choices.values())))
    return {
        name: array[place] for (name, array), place in zip(choices.items(), places, strict=True)
    }


def _rows(name: str, value: object) -> FloatArray:
    """Return values in turn, numbers or rows of them, as an array."""
    array = validation.float_array(name, value)
    if array.ndim not in (1, 2) or not len(array):
        raise ValueError(
            f"{name} has shape {array.shape}, expected (k,) or (k, members) with k at least 1: "
            "what it takes one after the other"
        )
    return array


def draws(
    parameters: Mapping[str, Distribution], count: int, seed: int = 0
) -> dict[str, FloatArray]:
    """Return random values of some parameters for many runs: those that :func:`sweep` draws.

    Parameters
    ----------
    parameters : mapping of str to Distribution
        :class:`Uniform`, :class:`Normal` or :class:`OneOf` by name; ``size`` of them for one number
        a member.
    count : int
        Number of runs.
    seed : int
        Of the random numbers. A run's numbers hang on the seed, its index and the name alone.

    Returns
    -------
    dict of str to ndarray, shape (count,) or (count, size)
        What :func:`simulate_many` takes as ``vary``.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> vary = tc.draws({"ground.friction": tc.Uniform(0.3, 0.6)}, count=3)
    >>> vary["ground.friction"].shape, bool((vary["ground.friction"] < 0.6).all())
    ((3,), True)
    """
    distributions = checked_distributions(parameters)
    count = validation.whole_number("count", count, 1, validation.MOST_RUNS)
    seed = validation.whole_number("seed", seed, 0, validation.LARGEST_SEED)
    runs = [draw_run(distributions, seed, run) for run in range(count)]
    return {name: np.array([run[name] for run in runs]) for name in distributions}


def parameters_of_runs(parameters: object, count: object) -> tuple[dict[str, Distribution], int]:
    """Return what runs get by name, distributions or values of each run, and how many they are."""
    if not isinstance(parameters, Mapping):
        raise validation.wrong_kind("parameters", parameters, "a dict of distributions")
    given, longest = dict(parameters), validation.MOST_RUNS
    for name, value in given.items():
        if isinstance(value, Distribution) or not isinstance(value, np.ndarray | list | tuple):
            continue
        rows = _rows(f"parameters[{name!r}]", value)
        if longest not in (validation.MOST_RUNS, len(rows)):
            raise ValueError(
                f"parameters[{name!r}] has {len(rows)} runs, but those before it have {longest}: "
                "give one value, or row, a run, as grid(...) returns them"
            )
        longest = len(rows)
        given[name] = GivenValues(frozen(rows), size=rows.shape[1] if rows.ndim == 2 else None)
    if count is None and any(isinstance(value, GivenValues) for value in given.values()):
        count = longest
    return checked_distributions(given), validation.whole_number("count", count, 1, longest)


def checked_distributions(parameters: Any) -> dict[str, Distribution]:
    """Return distributions by name, or raise naming what is none."""
    validation.named("parameters", parameters, "a dict of distributions")
    for name, distribution in parameters.items():
        validation.instance(
            f"parameters[{name!r}]", distribution, Distribution, "use Uniform, Normal or OneOf"
        )
    return dict(parameters)
