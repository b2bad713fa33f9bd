"""The equilibrium on which controller and estimator of a scene are designed."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscontrol.dynamics import Model, StringLaw
from tenscontrol.scene.document import Document
from tenscontrol.scene.members import whole
from tenscontrol.statics import Prestress, prestress
from tenscontrol.structure import Structure, to_segments, to_strings
from tenscontrol.validation import FloatArray


def build_design(
    document: Document,
    structure: Structure,
    law: StringLaw | None,
    gravity: object,
    forces: FloatArray | None,
    force_density: FloatArray,
) -> tuple[Model, Prestress]:
    """Return the model with its strings whole, and its equilibrium.

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
    tuple of Model and Prestress
    """
    design = whole(structure)
    load: Any = False if forces is None else forces[:, : design.nodes.shape[1]]
    model = Model(design, strings=law, external_force=load, gravity=gravity)
    with document.table("prestress").checked("force_density", "for a controller "):
        return model, _at_rest(structure, force_density, model)


def _at_rest(structure: Structure, gamma: FloatArray, model: Model) -> Prestress:
    """Return the prestress of the whole strings, or raise if they are not at rest."""
    design = model.structure
    if design is not structure:
        together = to_strings(structure, "force_density", gamma)
        if not np.allclose(to_segments(structure, "force_density", together), gamma):
            raise ValueError("force_density differs between the segments of a string")
        gamma = together
    return prestress(design, gamma, external_force=model.constant_force)
