"""Controller and winches of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.analysis import linearize
from tenscontrol.control import MPC, NMPC, Controller, ShapeControl, energy_weights, lqr
from tenscontrol.dynamics import Model, StringLaw
from tenscontrol.scene import keys
from tenscontrol.scene.document import Document
from tenscontrol.scene.members import per_string, whole
from tenscontrol.scene.reference import build_outputs, build_reference, build_tracked
from tenscontrol.statics import Prestress, prestress
from tenscontrol.structure import Structure, spread_force_density
from tenscontrol.validation import FloatArray, positive_number

# Of energy_weights, where the scene gives no R.
_INPUT_WEIGHT = 0.1

# Keys without which a controller of this kind means nothing.
_NEEDED = {
    "lqr": (),
    "mpc": ("horizon", "step"),
    "nmpc": ("horizon", "step"),
    "shape_control": ("step", "max_force_density", "frequency"),
}


def build_controller(
    document: Document,
    structure: Structure,
    law: StringLaw | None,
    gravity: object,
    forces: FloatArray | None,
    force_density: FloatArray,
    winches: Winches | None,
) -> Controller | None:
    """Return the controller, designed on the structure with its strings whole.

    Parameters
    ----------
    document : Document
    structure : Structure
        The plant.
    law : StringLaw, optional
        Of the whole strings.
    gravity, forces : optional
        Loads on the plant.
    force_density : ndarray, shape (α,)
        γ of the plant, N/m.
    winches : Winches, optional
        Of the whole strings.

    Returns
    -------
    Controller, or None if the scene has none
    """
    if not document.has("controller"):
        return None
    kind = document.table("controller").choice("kind", tuple(keys.CONTROLLERS))
    table = document.table("controller", keys.CONTROLLERS[kind], f" with kind = {kind!r}")
    held = table.choice("input", ("force_density", "rest_length"), "force_density")
    for key in ("step", "sample_time"):
        if key in table:
            with table.checked(key):
                positive_number(key, table.get(key), "s")
    for key in _NEEDED[kind]:
        table.need(key)
    if kind in ("mpc", "nmpc") and held == "force_density":
        table.need("max_force_density")
    design = whole(structure)
    load: Any = False if forces is None else forces[:, : design.nodes.shape[1]]
    model = Model(design, strings=law, external_force=load, gravity=gravity)
    with document.table("prestress").checked("force_density", "for a controller "):
        rest = _at_rest(structure, force_density, model)
    arguments: dict[str, Any] = {
        key: per_string(table, key, design) if isinstance(value, dict) else value
        for key, value in table.values.items()
        if key not in ("kind", "input", "sample_time")
    }
    if "tracked" in table:
        arguments["tracked"] = build_tracked(table, design)
    if "outputs" in table:
        arguments["outputs"] = build_outputs(table, design)
    if "reference" in table:
        arguments["reference"] = build_reference(
            table, model, rest, winches, table.need("step"), arguments.get("max_force_density")
        )
    if kind in ("mpc", "nmpc") and held == "rest_length":
        arguments["winches"] = winches
    with table.checked():
        plant = linearize(model, rest, input=held)
        if kind == "mpc":
            return MPC(plant, **arguments)
        if kind == "nmpc":
            return NMPC(plant, **arguments)
        if kind == "shape_control":
            return ShapeControl(plant, arguments.pop("reference", None), **arguments)
        natural_Q, natural_R = energy_weights(plant)
        weights = {"Q": natural_Q, "R": _INPUT_WEIGHT * natural_R}
        return lqr(plant, **(weights | arguments))


def _at_rest(structure: Structure, gamma: FloatArray, model: Model) -> Prestress:
    """Return the prestress of the whole strings, or raise if they are not at rest."""
    design = model.structure
    if design is not structure:
        parent = structure.string_parent
        assert parent is not None  # a subdivision
        together = np.bincount(parent, weights=gamma) / np.bincount(parent) ** 2
        if not np.allclose(spread_force_density(structure, together), gamma):
            raise ValueError("force_density differs between the segments of a string")
        gamma = together
    return prestress(design, gamma, external_force=model.constant_force)


def build_winches(document: Document, structure: Structure) -> Winches | None:
    """Return the limits of the winches, one for each whole string, or None."""
    if not document.has("winches"):
        return None
    table = document.table("winches")
    keys = [key for key in table.values if key != "pieces"]
    limits = {key: per_string(table, key, whole(structure)) for key in keys}
    with table.checked():
        return Winches(
            limits.get("rate"),
            limits.get("shortest"),
            limits.get("longest"),
            table.get("pieces", 1),
        )
