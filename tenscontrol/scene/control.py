"""Controller and winches of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.analysis import linearize
from tenscontrol.control import LQR, MPC, energy_weights, lqr
from tenscontrol.dynamics import Model, StringLaw
from tenscontrol.scene import keys
from tenscontrol.scene.document import Document
from tenscontrol.scene.members import per_string, whole
from tenscontrol.statics import Prestress, prestress
from tenscontrol.structure import Structure, spread_force_density
from tenscontrol.validation import FloatArray, positive_number

# Of energy_weights, where the scene gives no R.
_INPUT_WEIGHT = 0.1


def build_controller(
    document: Document,
    structure: Structure,
    law: StringLaw | None,
    gravity: object,
    forces: FloatArray | None,
    force_density: FloatArray,
) -> LQR | MPC | None:
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

    Returns
    -------
    LQR or MPC, or None if the scene has no controller
    """
    if not document.has("controller"):
        return None
    kind = document.table("controller").choice("kind", ("lqr", "mpc"))
    table = document.table(
        "controller", keys.LQR if kind == "lqr" else keys.MPC, f" with kind = {kind!r}"
    )
    held = table.choice("input", ("force_density", "rest_length"), "force_density")
    for key in ("step", "sample_time"):
        if key in table:
            with table.checked(key):
                positive_number(key, table.get(key), "s")
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
    with table.checked():
        plant = linearize(model, rest, input=held)
        if kind == "mpc":
            for key in ("horizon", "step", "max_force_density"):
                table.need(key)
            return MPC(plant, **arguments)
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
    limits = {key: per_string(table, key, whole(structure)) for key in table.values}
    with table.checked():
        return Winches(**limits)
