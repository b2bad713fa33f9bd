"""Tables of a scene for the structure: members, strings, loads, ground, prestress, start."""

from __future__ import annotations

from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.contact_laws import ContactLaw
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Profile
from tenscontrol.dynamics.string_laws import ElasticStrings, StringLaw
from tenscontrol.scene.document import Document, Table
from tenscontrol.scene.schema import (
    FORCE,
    GENERATOR_KEYS,
    GENERATORS,
    GROUND_KEYS,
    GROUNDS,
    LAW_KEYS,
    LAWS,
    MEMBERS,
)
from tenscontrol.simulation.start import initial_state
from tenscontrol.sizing.materials import Material, materials
from tenscontrol.sizing.sections import Sections, sections
from tenscontrol.statics.prestress import Prestress, prestress
from tenscontrol.structure.bar_geometry import restore_bar_lengths
from tenscontrol.structure.segments import (
    spread_force_density,
    subdivide,
    to_segments,
    to_strings,
    whole_strings,
)
from tenscontrol.structure.skin import skin
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.structure_file import from_table, points
from tenscontrol.structure.supports import random_moves

# What a value "per" refers to where strings are cut: the whole string, or each segment.
_PER = ("string", "segment")


def build_structure(document: Document) -> Structure:
    """Return the structure: generated or given, then skinned, then with sections, then cut."""
    structure = _uncut(document)
    if document.has("skin"):
        table = document.table("skin")
        table.need_required()
        with table.checked():
            structure = skin(structure, **table.values)
    _materials(document)
    if document.has("sections"):
        structure = _sized(document, structure).structure
    if document.has("subdivide"):
        table = document.table("subdivide")
        table.need_required()
        values: dict[str, Any] = {
            key: per_string(table, key, structure) if isinstance(value, dict) else value
            for key, value in table.values.items()
        }
        with table.checked():
            structure = subdivide(structure, **values)
    return structure


def _sized(document: Document, structure: Structure) -> Sections:
    """Return the sections of the members."""
    table = document.table("sections")
    table.need_required()
    values: dict[str, Any] = {
        key: per_string(table, key, structure) if isinstance(value, dict) else value
        for key, value in table.without("bars", "strings").items()
    }
    known = {**materials, **_materials(document)}
    of = {key: known[table.choice(key, tuple(known))] for key in ("bars", "strings")}
    with table.checked():
        return sections(structure, bars=of["bars"], strings=of["strings"], **values)


def _materials(document: Document) -> dict[str, Material]:
    """Return the materials of the file itself by name."""
    given, own = document.values.get("materials", {}), {}
    for name, values in given.items():
        if not isinstance(values, dict):
            raise document.error(
                ("materials", name),
                f"in [materials], {name[:60]} is no table; write [materials.{name[:60]}] on a line",
            )
        table = document.nested("materials", name)
        table.need_required()
        with table.checked():
            own[name] = Material(**table.values)
    return own


def _uncut(document: Document) -> Structure:
    if "generator" in document.values["structure"]:
        name, table = document.table("structure").chosen("generator", GENERATOR_KEYS)
        make = GENERATORS[name]
        table.need_required()
        own = {key: table.values[key] for key in signature(make).parameters if key in table}
        with table.checked():
            structure = make(**own)
            changes = table.without("generator", *own)
            return replace(structure, **changes) if changes else structure
    table = document.table("structure", MEMBERS, " without a generator")
    if not table.values:
        raise table.error(
            None, "[structure] is empty, expected generator = 'prism', or nodes, bars and strings"
        )
    for key in ("nodes", "bars", "strings", *(["bar_mass"] if table.get("bars") else [])):
        table.need(key)
    with table.checked():
        return from_table(table.values, Structure)


def columns(table: Table, key: str, dimension: int | None = None) -> FloatArray:
    """Return points of a table, shape (d, ·), all with as many coordinates as the first."""
    rows = table.need(key)
    with table.checked(key):
        return points(key, rows, dimension)


def per_string(table: Table, key: str, structure: Structure) -> FloatArray:
    """Return one value for each string: given as a number, a list or a table by group.

    It may be infinite; what takes it refuses that where it is no limit.
    """
    value = table.need(key)
    count = len(structure.strings)
    if not isinstance(value, dict):
        with table.checked(key):
            return validation.limit_per_member(key, value, count, "string")
    with table.checked(key):
        for group in value:
            structure.strings_in(group)
        groups = dict.fromkeys(structure.string_groups)
        missing = [group for group in groups if group not in value]
        if missing:
            raise ValueError(
                f"{key} lacks the string group {missing[0]!r}, expected a value for each of: "
                f"{', '.join(groups)}"
            )
        by_string = [value[group] for group in structure.string_groups]
        return validation.limit_per_member(key, by_string, count, "string")


def build_law(document: Document, structure: Structure) -> tuple[StringLaw, StringLaw] | None:
    """Return the law of the strings and that of the whole strings, or None if there is no table.

    Elastic strings without axial rigidity have that of their sections, of each whole string.
    """
    if not document.has("strings"):
        return None
    kind, table = document.table("strings").chosen("law", LAW_KEYS)
    make = LAWS[kind]
    by_string = table.choice("per", _PER, "string") == "string"
    given = whole_strings(structure) if by_string else structure
    values = {key: per_string(table, key, given) for key in table.without("law", "per")}
    has_sections = document.has("sections") and make is ElasticStrings
    if has_sections and "axial_rigidity" not in values:
        rigidity = _sized(document, whole_strings(structure)).axial_rigidity
        values["axial_rigidity"] = (
            rigidity if by_string else to_segments(structure, "axial_rigidity", rigidity)
        )
    else:
        table.need_required()
    with table.checked():
        law = make(**values)
        if whole_strings(structure) is structure:
            return law, law
        convert = to_segments if by_string else to_strings
        other = make(
            **{
                name: convert(structure, name, values_of_key)
                for name, values_of_key in values.items()
            }
        )
        return (other, law) if by_string else (law, other)


def build_loads(document: Document, structure: Structure) -> tuple[object, FloatArray | None]:
    """Return gravity, or None, and the forces on the nodes, N, shape (d, n), or None."""
    table = document.table("loads")
    gravity = table.get("gravity")
    if "forces" not in table:
        return gravity, None
    count = structure.nodes.shape[1]
    forces, seen = np.zeros_like(structure.nodes), set()
    for i, values in enumerate(table.need("forces")):
        where = f"in [loads], forces[{i}]"
        entry = Table(document, ("loads", "forces", i), f"[loads] forces[{i}]", values, FORCE)
        node = entry.index("node", count, "nodes", f"{where} is on node")
        force = np.array(entry.need("force"), dtype=float)  # of whole numbers of any size too
        if node in seen:
            raise entry.error("node", f"{where} is on node {node} a second time")
        if len(force) != structure.dimension:
            raise entry.error(
                "force",
                f"{where}.force has {len(force)} numbers, expected {structure.dimension} in N",
            )
        if not np.isfinite(force).all():
            raise entry.error("force", f"{where}.force is {force.tolist()}, not finite")
        seen.add(node)
        forces[:, node] = force
    return gravity, forces


def build_ground(document: Document, structure: Structure) -> tuple[ContactLaw, ...]:
    """Return the contact laws of the ground, one for each table."""
    laws = []
    for entry in document.entries("ground"):
        kind, table = entry.chosen("kind", GROUND_KEYS, "linear")
        table.need_required()
        with table.checked():
            if "normal" in table:
                validation.direction("normal", table.get("normal"), structure.dimension)
            if "nodes" in table:
                given = np.array(table.get("nodes"), dtype=float)
                validation.indices("nodes", given, structure.nodes.shape[1], "nodes")
            laws.append(GROUNDS[kind](**table.without("kind")))
    return tuple(laws)


def build_force_density(document: Document, structure: Structure, load: FloatArray) -> FloatArray:
    """Return γ of each string in the shape of the structure, N/m, shape (α,).

    A single number is the mean γ of the reference strings in balance with the load (d, n), N;
    bounds of γ ask for a balance too.
    """
    if not document.has("prestress"):
        if len(structure.strings):
            raise document.error(
                (), "the table [prestress] is missing; a scene with strings needs force_density"
            )
        return np.zeros(0)
    table = document.table("prestress")
    by_string = table.choice("per", _PER, "string") == "string"
    given = whole_strings(structure) if by_string else structure
    bounds = [key for key in ("min_force_density", "max_force_density") if key in table]
    key = "force_density" if "force_density" in table else (bounds or ["force_density"])[0]
    value = table.need(key)
    if bounds or isinstance(value, int | float):
        if key == "force_density" and not isinstance(value, int | float):
            raise table.error(
                bounds[0],
                f"in [prestress], {bounds[0]} goes with a single number as force_density, or alone",
            )
        count = given.nodes.shape[1]
        if load[:, count:].any():
            raise table.error(
                key,
                f"in [prestress], {key} is a {'bound' if bounds else 'single number'}, which "
                "asks for an equilibrium, but loads act on nodes within strings, and straight "
                "strings cannot balance them; give a table by string group",
            )
        settings: dict[str, Any] = {bound: per_string(table, bound, given) for bound in bounds}
        settings |= table.given("force_density", "reference")
        if "reference" in settings:
            with table.checked("reference"):
                given.strings_in(settings["reference"])
        with table.checked(key):
            gamma = prestress(given, external_force=load[:, :count], **settings).force_density
    elif "reference" in table:
        raise table.error(
            "reference", "in [prestress], reference goes with a single number as force_density"
        )
    else:
        gamma = per_string(table, "force_density", given)
        with table.checked("force_density"):
            validation.non_negative("force_density", gamma, "a string can only pull")
    with table.checked("force_density"):
        return spread_force_density(structure, gamma) if given is not structure else gamma


def build_design(
    document: Document,
    model: Model,
    law: StringLaw | None,
    forces: FloatArray | None,
    gamma: FloatArray,
) -> tuple[Model, Prestress]:
    """Return the model with its strings whole, and its equilibrium, for the controller."""
    structure = model.structure
    design = whole_strings(structure)
    count = design.nodes.shape[1]
    load: Any = False if forces is None else forces[:, :count]
    on_first = (_on_first(contact, count) for contact in model.ground)
    laws = [contact for contact in on_first if contact is not None]
    model = model.replace(structure=design, strings=law, external_force=load, ground=laws)
    with document.table("prestress").checked("force_density", "for a controller "):
        if design is not structure:
            together = to_strings(structure, "force_density", gamma)
            if not np.allclose(to_segments(structure, "force_density", together), gamma):
                raise ValueError("force_density differs between the segments of a string")
            gamma = together
        return model, prestress(design, gamma, external_force=model.constant_force)


def _on_first(law: ContactLaw, count: int) -> ContactLaw | None:
    """Return a contact law on those of its nodes that are among the first so many, or None."""
    if law.nodes is None:
        return law
    nodes = law.nodes[law.nodes < count]
    return replace(law, nodes=nodes) if len(nodes) else None


def build_start(document: Document, model: Model) -> tuple[FloatArray, FloatArray]:
    """Return node positions and velocities at the start, m and m/s, shape (d, n)."""
    table, structure = document.table("start"), model.structure
    nodes, velocities = structure.nodes, np.zeros_like(structure.nodes)
    if "velocities" in table:
        given = columns(table, "velocities", structure.dimension)
        with table.checked("velocities"):
            if given.shape != nodes.shape:
                axes = ", ".join("xyz"[: structure.dimension])
                raise ValueError(
                    f"velocities has {given.shape[1]} entries, expected {nodes.shape[1]}: "
                    f"[{axes}] for each node"
                )
            velocities = structure.checked_nodes("velocities", given)
            initial_state(model, None, velocities, "force_density")
    if "seed" in table and "disturbance" not in table:
        raise table.error("seed", "in [start], seed goes with disturbance")
    if "disturbance" in table:
        with table.checked("disturbance"):
            size = validation.positive_number("disturbance", table.need("disturbance"), "m")
            seed = validation.whole_number("seed", table.get("seed", 0), 0, validation.LARGEST_SEED)
            nodes = _disturbed(structure, size, seed)
    return nodes, velocities


def build_struts(document: Document, structure: Structure) -> Profile | None:
    """Return the lengths of all bars in time, m; None where none is driven."""
    if not document.has("struts"):
        return None
    table, count = document.table("struts"), len(structure.bars)
    with table.checked("bars"):
        bars = validation.index_list("bars", table.get("bars", list(range(count))), count, "bars")
    with table.checked("time"):
        time = validation.vector("time", table.need("time"))
    with table.checked("length"):
        shape = time.size, len(bars)
        rows = validation.shaped("length", table.need("length"), shape, "one row a time")
        validation.positive("length", rows.ravel(), "length in m")
    lengths = np.repeat(structure.bar_length[:, None], time.size, axis=1)
    lengths[bars] = rows.T
    how = table.choice("interpolation", ("cubic", "linear"), "cubic")
    with table.checked("time"):
        return Profile(time, lengths, how)


def _disturbed(structure: Structure, size: float, seed: int) -> FloatArray:
    """Return a shape with true bar lengths whose farthest node is moved by ``size``, m."""
    moves = random_moves(structure, np.random.default_rng(seed))
    step = size / 4
    for _ in range(40):  # the distance is nearly linear in the step: this converges at once
        nodes = restore_bar_lengths(structure, structure.nodes + step * moves)
        off = float(np.linalg.norm(nodes - structure.nodes, axis=0).max())
        if off == 0:
            raise ValueError("disturbance moves nothing: no node is free")
        if abs(off / size - 1) < 1e-12:
            return nodes
        step *= size / off
    largest = structure.size
    raise ValueError(
        f"disturbance is {size:g} m, which rigid bars cannot follow; expected much less than the "
        f"size of the structure, {largest:g} m"
    )
