"""Parameters of a model by name: what fits, sweeps and batches change."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.model import Model

MASSES = "bar_mass", "point_mass"

# Of contact laws, what is no number.
_NO_NUMBER = {"normal", "nodes"}


def parameters_of(model: Model) -> dict[str, FloatArray]:
    """Return the parameters of a model by name, one number a member.

    Members are bars (``"bar_mass"``), nodes (``"point_mass"``), axes (``"gravity"``), strings (the
    parameters of the string law, as ``"stiffness"``). Contact laws have one number each, by names
    as in :func:`ground_numbers`.
    """
    structure = model.structure
    values = {name: getattr(structure, name) for name in MASSES} | {"gravity": model.gravity}
    count = (len(structure.strings),)
    for name in law_parameters(model):
        values[name] = np.broadcast_to(getattr(model.strings, name), count)
    for name, (law, number) in ground_numbers(model).items():
        values[name] = np.array([getattr(model.ground[law], number)])
    return values


def law_parameters(model: Model) -> tuple[str, ...]:
    """Return the names of the parameters of the string law; none without a law."""
    law: Any = model.strings
    return () if law is None else tuple(declared.name for declared in fields(law))


def ground_numbers(model: Model) -> dict[str, tuple[int, str]]:
    """Return the numbers of contact laws by name: which law, and what it calls the number.

    The names are as ``"ground.friction"``, of several laws as ``"ground[1].friction"``.
    """
    several = len(model.ground) > 1
    numbers = {}
    for i, law in enumerate(model.ground):
        label = f"ground[{i}]" if several else "ground"
        for name in (declared.name for declared in fields(law) if declared.name not in _NO_NUMBER):
            if isinstance(getattr(law, name), float):  # a height may be a function
                numbers[f"{label}.{name}"] = i, name
    return numbers


def without_law(name: str) -> str:
    """Return a name without the number of a contact law: ``"ground[1].friction"`` has one."""
    return re.sub(r"^ground\[\d+\]", "ground", name)


def with_parameters(model: Model, values: Mapping[str, FloatArray]) -> Model:
    """Return the model with other values of some parameters, by the names of :func:`parameters_of`.

    Raises
    ------
    TypeError, ValueError
        If a value does not fit, as what is made of it raises.
    """
    changes: dict[str, Any] = {}
    masses: dict[str, Any] = {name: values[name] for name in MASSES if name in values}
    if masses:
        changes["structure"] = replace(model.structure, **masses)
    of_law: dict[str, Any] = {
        name: values[name] for name in law_parameters(model) if name in values
    }
    if of_law and model.strings is not None:
        changes["strings"] = replace(model.strings, **of_law)
    if "gravity" in values:
        changes["gravity"] = values["gravity"]
    laws = list(model.ground)
    for name, (i, number) in ground_numbers(model).items():
        if name in values:
            laws[i] = replace(laws[i], **{number: float(values[name][0])})
            changes["ground"] = laws
    return model.replace(**changes) if changes else model
