"""Parameters of a model by name: what fits, sweeps and batches change."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import gravity_forces
from tenscontrol.dynamics.model import Model

MASSES = "bar_mass", "point_mass"

# Numbers that may be zero, and those that may have any sign; all others are positive.
_FROM_ZERO = {"force_density", "damping", "point_mass", "ground.damping", "ground.friction"}
_SIGNED = {"nodes", "velocities", "external_force", "load", "gravity", "ground.height"}

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


def constant_forces(model: Model, values: Mapping[str, FloatArray]) -> FloatArray:
    """Return loads and weights at the nodes, N, shape (runs, d, n), of masses and gravity of runs.

    What is not among the values is that of the model; runs are 1 where nothing is.
    """
    structure = model.structure
    forces = model.built_in_load + gravity_forces(
        structure,
        values.get("gravity", model.gravity),
        values.get("bar_mass", structure.bar_mass),
        values.get("point_mass", structure.point_mass),
    )
    return forces if forces.ndim == 3 else forces[None]


def least_value(name: str) -> float:
    """Return the least number that a parameter, or an input of a run, can be."""
    kind = without_law(name)
    if kind in _SIGNED:
        return -validation.LARGEST
    return 0.0 if kind in _FROM_ZERO else float(np.finfo(float).tiny)


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
