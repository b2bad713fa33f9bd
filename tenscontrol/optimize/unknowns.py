"""Unknowns of a fit: numbers that scale or shift the parameters of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.model_parameters import (
    MASSES,
    ground_numbers,
    law_parameters,
    parameters_of,
    with_parameters,
)
from tenscontrol.optimize.parameters import Parameter

# Prior standard deviations where none is given: of a logarithm; of a rest length as part of it; of
# the height of the ground as part of the size; of a delay, s.
_LOGARITHM, _LENGTH, _HEIGHT, _DELAY = 0.5, 0.05, 0.01, 0.02

_SHIFTED = {"rest_length", "delay"}


@dataclass(frozen=True)
class LogNormal:
    """What is known of a positive parameter before a fit: its median, and how far it may be off.

    Parameters
    ----------
    median : float
        In the unit of the parameter.
    deviation : float
        Standard deviation of the natural logarithm: 0.5 is a factor of 1.6 either way.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.optimize.LogNormal(300.0, 0.5)
    LogNormal(median=300.0, deviation=0.5)
    """

    median: float
    deviation: float

    def __post_init__(self) -> None:
        for name in ("median", "deviation"):
            value = validation.positive_number(name, getattr(self, name), "number")
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class Unknown:
    """One parameter of the model, of which groups of members have an unknown each.

    Attributes
    ----------
    name : str
    base : ndarray, shape (members,)
        Values where all unknowns are 0.
    groups : tuple of ndarray of int
        Members of each unknown.
    deviation : float
        Of the prior of each: of the logarithm, or in the unit of the parameter.
    is_scaled : bool
        Whether unknowns are logarithms of factors; else they are added.
    """

    name: str
    base: FloatArray
    groups: tuple[Any, ...]
    deviation: float
    is_scaled: bool

    @property
    def is_beside(self) -> bool:
        """Whether it is no parameter of the model, but of the input or of the readings."""
        return self.name in _SHIFTED

    @property
    def labels(self) -> list[str]:
        """Name of each unknown."""
        if len(self.base) == 1 and self.name.startswith(("ground", "delay")):
            return [self.name]
        return [f"{self.name} {_range(group)}" for group in self.groups]

    def values(self, theta: FloatArray) -> FloatArray:
        """Return the parameter for the unknowns."""
        values = self.base.copy()
        for unknown, group in zip(theta, self.groups, strict=True):
            values[group] = (
                values[group] * np.exp(unknown) if self.is_scaled else values[group] + unknown
            )
        return values

    def slope(self, theta: FloatArray) -> FloatArray:
        """Return the derivative of the parameter by the unknowns, shape (members, unknowns)."""
        values, slope = self.values(theta), np.zeros((len(self.base), len(self.groups)))
        for column, group in enumerate(self.groups):
            slope[group, column] = values[group] if self.is_scaled else 1.0
        return slope


def _range(group: Any) -> str:
    members = [int(i) for i in group]
    if len(members) > 2 and members == list(range(members[0], members[-1] + 1)):
        return f"{members[0]}-{members[-1]}"
    return ", ".join(map(str, members))


def unknowns_of(
    model: Model,
    input: str,
    parameters: object,
    known: Mapping[str, object] | None,
    groups: Mapping[str, object] | None,
    held: FloatArray | None,
) -> tuple[Unknown, ...]:
    """Return the unknowns of a fit, after checking what is asked for.

    ``held`` are the rest lengths at the start, which those that are unknown are parts of.
    """
    if isinstance(parameters, str) or not isinstance(parameters, (Mapping, Sequence)):
        raise validation.wrong_kind(
            "parameters", parameters, "a list of names, or a dict of names with what is known"
        )
    asked = dict(parameters) if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    bases = _bases(model, input, held)
    if not asked:
        raise ValueError(f"parameters is empty, expected some of {sorted(bases)}")
    for name in asked:
        validation.choice("parameters", name, bases)
    for label, mapping in (("known", known), ("groups", groups)):
        if mapping is not None and not isinstance(mapping, Mapping):
            raise validation.wrong_kind(label, mapping, "a dict by names of parameters")
        for name in mapping or {}:
            validation.choice(f"a key of {label}", name, asked)
    unknowns = []
    for name, prior in asked.items():
        base = bases[name]
        is_scaled = name not in _SHIFTED and not name.endswith(".height")
        base, deviation = _with_prior(name, base, prior, is_scaled, model)
        some = _grouped(name, len(base), (groups or {}).get(name), (known or {}).get(name))
        if is_scaled:
            some = tuple(group for group in some if (base[group] != 0).any())
        if not some:
            raise ValueError(f"{name} has no unknown: all of it is known, or zero")
        unknowns.append(Unknown(name, frozen(base), some, deviation, is_scaled))
    return tuple(unknowns)


def _bases(model: Model, input: str, held: FloatArray | None) -> dict[str, FloatArray]:
    """Return what can be fitted, with its values in the model."""
    values = parameters_of(model)
    del values["gravity"]
    if input != "rest_length":
        for name in law_parameters(model):
            del values[name]
    elif held is not None:
        values["rest_length"] = np.zeros(len(model.structure.strings))
    values["delay"] = np.zeros(1)
    return {name: np.array(value, dtype=float) for name, value in values.items()}


def _with_prior(
    name: str, base: FloatArray, prior: object, is_scaled: bool, model: Model
) -> tuple[FloatArray, float]:
    """Return the values to begin with, and the deviation of the prior."""
    if isinstance(prior, LogNormal):
        if not is_scaled:
            raise ValueError(f"parameters: {name} is shifted, expected its standard deviation")
        return np.full(len(base), prior.median), prior.deviation
    if prior is not None:
        unit = "units of its logarithm" if is_scaled else "its unit"
        return base, validation.positive_number(f"parameters[{name!r}]", prior, unit)
    if is_scaled:
        return base, _LOGARITHM
    length = float(model.structure.string_length().mean()) if len(model.structure.strings) else 1.0
    size = model.structure.size
    usual = {"rest_length": _LENGTH * length, "delay": _DELAY}
    return base, usual.get(name, _HEIGHT * size)


def _grouped(name: str, count: int, groups: object, known: object) -> tuple[Any, ...]:
    """Return the members of each unknown."""
    kept = np.ones(count, dtype=bool)
    if known is not None:
        which = validation.index_list(f"known[{name!r}]", known, count, f"there are {count}")
        kept[which] = False
    if groups is None:
        return tuple(np.array([i]) for i in np.flatnonzero(kept))
    label = f"groups[{name!r}]"
    if isinstance(groups, str) and groups == "all":
        groups = [np.arange(count)]
    grouped = []
    for i, group in enumerate(validation.items(label, groups, "lists of members")):
        members = validation.index_list(f"{label}[{i}]", group, count, f"there are {count}")
        if not kept[members].all():
            raise ValueError(f"{label}[{i}] has members that are known, or in another group")
        kept[members] = False
        grouped.append(np.asarray(members))
    return (*grouped, *(np.array([i]) for i in np.flatnonzero(kept)))


def fitted_model(model: Model, unknowns: Sequence[Unknown], theta: Sequence[FloatArray]) -> Model:
    """Return a model with the parameters for the unknowns."""
    values = {
        unknown.name: unknown.values(own) for unknown, own in zip(unknowns, theta, strict=True)
    }
    return with_parameters(
        model, {name: value for name, value in values.items() if name not in _SHIFTED}
    )


def parameter_of(model: Model, unknown: Unknown) -> Parameter | None:
    """Return what a run is differentiated by for an unknown; None for a delay."""
    name = unknown.name
    if name == "delay":
        return None
    if name == "rest_length":
        return Parameter(name, "input", (len(unknown.base),))
    if name in MASSES:
        return Parameter(name, name, (len(unknown.base),))
    ground = ground_numbers(model)
    if name in ground:
        law, number = ground[name]
        return Parameter(name, "ground", (), law=law, field=number)
    return Parameter(name, "strings", (len(unknown.base),), field=name)
