"""Controller and winches of a scene."""

from __future__ import annotations

from typing import Any

from tenscontrol.actuation import Winches
from tenscontrol.control import (
    MPC,
    NMPC,
    Controller,
    FeedbackLinearization,
    GainSchedule,
    energy_weights,
    lqr,
)
from tenscontrol.dynamics import Model
from tenscontrol.plant import Reference, linearize
from tenscontrol.scene import keys
from tenscontrol.scene.document import Document, Table
from tenscontrol.scene.members import per_string, whole
from tenscontrol.scene.reference import build_outputs, build_reference, build_tracked
from tenscontrol.shape.along import plants_along
from tenscontrol.statics import Prestress
from tenscontrol.structure import Structure
from tenscontrol.validation import positive_number, whole_number

# Of energy_weights, where the scene gives no R.
_INPUT_WEIGHT = 0.1

# Keys without which a controller of this kind means nothing.
_NEEDED = {
    "lqr": (),
    "mpc": ("horizon", "sample_time"),
    "nmpc": ("horizon", "sample_time"),
    "feedback_linearization": ("sample_time", "max_force_density", "frequency"),
}

# Of γ, which a reference keeps to as well.
_BOUNDS = ("min_force_density", "max_force_density")

# Keys that are not arguments of the controller itself.
_OTHER = ("kind", "input", "plants")


def build_controller(
    document: Document, model: Model, rest: Prestress, winches: Winches | None
) -> Controller:
    """Return the controller that the scene has.

    Parameters
    ----------
    document : Document
    model : Model
        Of the whole strings.
    rest : Prestress
        About which it is designed.
    winches : Winches, optional
        Of the whole strings.

    Returns
    -------
    Controller
    """
    kind = document.table("controller").choice("kind", tuple(keys.CONTROLLERS))
    table = document.table("controller", keys.CONTROLLERS[kind], f" with kind = {kind!r}")
    held = table.choice("input", ("force_density", "rest_length"), "force_density")
    if "sample_time" in table:
        with table.checked("sample_time"):
            positive_number("sample_time", table.get("sample_time"), "s")
    for key in _NEEDED[kind]:
        table.need(key)
    if kind in ("mpc", "nmpc") and held == "force_density":
        table.need("max_force_density")
    arguments: dict[str, Any] = {
        key: per_string(table, key, model.structure) if isinstance(value, dict) else value
        for key, value in table.values.items()
        if key not in _OTHER
    }
    if "tracked" in table:
        arguments["tracked"] = build_tracked(table, model.structure)
    if "outputs" in table:
        arguments["outputs"] = build_outputs(table, model.structure)
    if "reference" in table:
        bounds = {key: arguments[key] for key in _BOUNDS if key in arguments}
        arguments["reference"] = build_reference(
            table, model, rest, winches, table.need("sample_time"), bounds
        )
    # A law without a sample time knows neither speeds in a sample nor winding through it.
    in_samples = kind != "feedback_linearization" and "sample_time" in arguments
    if in_samples and held == "rest_length":
        arguments["winches"] = winches
    if "plants" in table:
        return _schedule(table, model, arguments, held)
    with table.checked():
        plant = linearize(model, rest, input=held)
        if kind == "mpc":
            return MPC(plant, **arguments)
        if kind == "nmpc":
            return NMPC(plant, **arguments)
        if kind == "feedback_linearization":
            return FeedbackLinearization(
                plant, reference=arguments.pop("reference", None), **arguments
            )
        natural_Q, natural_R = energy_weights(plant)
        weights = {"Q": natural_Q, "R": _INPUT_WEIGHT * natural_R}
        return lqr(plant, **(weights | arguments))


def _schedule(table: Table, model: Model, arguments: dict[str, Any], held: str) -> GainSchedule:
    """Return MPCs designed along the reference, which take turns."""
    if "reference" not in table:
        raise table.error(
            "plants",
            f"in {table.title}, plants counts those along the reference, but there is none: add "
            "[[controller.reference]]",
        )
    with table.checked("plants"):
        count = whole_number("plants", table.need("plants"), least=1)
    reference: Reference = arguments["reference"]
    assert reference.force_density is not None  # build_reference gives it
    with table.checked():
        plants = plants_along(model, reference.nodes, reference.force_density, count, held)
        return GainSchedule([MPC(plant, **arguments) for plant in plants])


def build_winches(document: Document, structure: Structure) -> Winches | None:
    """Return the limits of the winches, one for each whole string, or None."""
    if not document.has("winches"):
        return None
    table = document.table("winches")
    keys = [key for key in table.values if key not in ("ramp", "substeps")]
    limits = {key: per_string(table, key, whole(structure)) for key in keys}
    with table.checked():
        return Winches(
            limits.get("rate"),
            limits.get("shortest"),
            limits.get("longest"),
            **table.given("ramp", "substeps"),
        )
