"""String law, loads and prestress of a scene."""

from __future__ import annotations

import numpy as np

from tenscontrol.dynamics import ElasticStrings, LinearStrings, StringLaw
from tenscontrol.scene.document import Document, Table
from tenscontrol.scene.keys import ELASTIC, FORCE, LINEAR
from tenscontrol.scene.members import is_cut, per_string, whole
from tenscontrol.statics import prestress
from tenscontrol.structure import Structure, spread_force_density, to_segments, to_strings
from tenscontrol.validation import FloatArray, non_negative

# What a value "per" refers to where strings are cut: the whole string, or each segment.
_PER = ("string", "segment")


def build_law(document: Document, structure: Structure) -> tuple[StringLaw, StringLaw] | None:
    """Return the law of the strings and that of the whole strings, or None if there is no table.

    Segments act in series: a string of stiffness k and damping c has segments of
    s k and s c. Axial rigidity is that of the material and stays.
    """
    if not document.has("strings"):
        return None
    kind = document.table("strings").choice("law", ("linear", "elastic"))
    keys = LINEAR if kind == "linear" else ELASTIC
    table = document.table("strings", keys, f" with law = {kind!r}")
    main = "stiffness" if kind == "linear" else "axial_rigidity"
    table.need(main)
    make = LinearStrings if kind == "linear" else ElasticStrings
    by_string = table.choice("per", _PER, "string") == "string"
    given = whole(structure) if by_string else structure
    values = {main: per_string(table, main, given)}
    values["damping"] = np.zeros(len(given.strings))
    if "damping" in table:
        values["damping"] = per_string(table, "damping", given)
    with table.checked():
        law: StringLaw = make(**values)
        if not is_cut(structure):
            return law, law
        mapped = to_segments if by_string else to_strings
        other = {name: mapped(structure, name, value) for name, value in values.items()}
        return (make(**other), law) if by_string else (law, make(**other))


def build_loads(document: Document, structure: Structure) -> tuple[object, FloatArray | None]:
    """Return gravity, or None, and the forces on the nodes, N, shape (3, n), or None."""
    table = document.table("loads")
    gravity = table.get("gravity")
    if "forces" not in table:
        return gravity, None
    count = structure.nodes.shape[1]
    forces, seen = np.zeros((3, count)), set()
    for i, values in enumerate(table.need("forces")):
        path = ("loads", "forces", i)
        entry = Table(document, path, f"[loads] forces[{i}]", values, FORCE)
        node, force = entry.need("node"), entry.need("force")
        if not 0 <= node < count:
            raise entry.error(
                "node",
                f"in [loads], forces[{i}] is on node {node}, expected 0 to {count - 1}: "
                f"there are {count} nodes, counted from 0",
            )
        if node in seen:
            raise entry.error("node", f"in [loads], forces[{i}] is on node {node} once more")
        if not np.isfinite(force).all():
            raise entry.error("force", f"in [loads], forces[{i}].force is {force}, not finite")
        seen.add(node)
        forces[:, node] = force
    return gravity, forces


def build_force_density(document: Document, structure: Structure, load: FloatArray) -> FloatArray:
    """Return γ of each string in the shape of the structure, in balance or not.

    A single number is the mean γ of the reference strings in a state of
    self-stress; a list or a table is taken as it is.

    Parameters
    ----------
    document : Document
    structure : Structure
    load : ndarray, shape (3, n)
        All that acts from outside, N.

    Returns
    -------
    ndarray, shape (α,)
        N/m.
    """
    if not document.has("prestress"):
        if len(structure.strings):
            raise document.error(
                (), "the table [prestress] is missing; a scene with strings needs force_density"
            )
        return np.zeros(0)
    table = document.table("prestress")
    by_string = table.choice("per", _PER, "string") == "string"
    given = whole(structure) if by_string else structure
    value = table.need("force_density")
    if isinstance(value, int | float):
        count = given.nodes.shape[1]
        if load[:, count:].any():
            raise table.error(
                "force_density",
                "in [prestress], force_density is a single number, for which a balance is sought, "
                "but the loads act on the nodes within strings, which are in no balance while the "
                "strings are straight; give a table by string group",
            )
        if "reference" in table:
            with table.checked("reference"):
                given.strings_in(table.need("reference"))
        with table.checked("force_density"):
            found = prestress(given, value, table.get("reference"), load[:, :count])
        gamma = found.force_density
    elif "reference" in table:
        raise table.error(
            "reference", "in [prestress], reference goes with a single number as force_density"
        )
    else:
        gamma = per_string(table, "force_density", given)
        with table.checked("force_density"):
            non_negative("force_density", gamma, "a string can only pull")
    return spread_force_density(structure, gamma) if given is not structure else gamma
