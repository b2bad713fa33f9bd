"""The state equation of a large scene as a graph of operations on all members at once.

The graph has so many operations, however many members there are; each is a loop
inside CasADi. That is built in no time where a flat expression of every member
takes minutes, and it needs no compiler.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.contact_laws import Contacts
from tenscontrol.dynamics.equation import InputLayout
from tenscontrol.dynamics.forms.passes import (
    Pass,
    body_passes,
    contact_passes,
    gap_passes,
    string_passes,
)
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray


def mapped_functions(
    structure: Structure, law: StringLaw | None, load: FloatArray,
    layout: InputLayout | None = None, contacts: Contacts | None = None,
) -> tuple[ca.Function, ...]:  # fmt: skip
    """Return slope, gap and force of :class:`Equation`; arguments as for ``loops_source``."""
    free, alpha = structure.free.tolist(), len(structure.strings)
    slacking = 0 if law is None else alpha  # strings that can go slack
    ground, ground_gaps = contact_passes(contacts, slacking)
    switches = slacking + (0 if contacts is None else contacts.switches)
    (N, p), (Nd, v) = (
        _symbols(structure, name, at)
        for name, at in (("N", structure.nodes), ("Nd", np.zeros_like(structure.nodes)))
    )
    u, taut = ca.MX.sym("u", alpha), ca.MX.sym("taut", switches)
    arrays = {"p": p, "v": v, "u": u.T, "taut": taut.T}
    ends, given, varying = arrays, u, None
    if layout is not None and layout.load:
        varying = ca.MX.sym("load", *structure.nodes.shape)
        given = ca.vertcat(given, ca.vec(varying))
    if layout is not None and layout.offset:
        offsets = [ca.MX.sym(name, *structure.nodes.shape) for name in ("offset", "rate")]
        ends = arrays | {"p": p + offsets[0], "v": v + offsets[1]}
        given = ca.vertcat(given, *map(ca.vec, offsets))
    arrays["f"] = _forces(structure, ends, [*string_passes(structure, law), *ground], load)
    if varying is not None:
        arrays["f"] += varying
    x = ca.vertcat(ca.vec(N), ca.vec(Nd))
    gap = rate = ca.MX(0, 1)
    if law is not None or ground_gaps:
        gaps = [] if law is None else gap_passes(structure, law)
        gap, rate = (row.T for row in _gaps([*gaps, *ground_gaps], ends))
    xdot = ca.vertcat(ca.vec(Nd), _accelerations(structure, arrays))
    on_free = kernel.free_entries(structure, ca.densify(arrays["f"][:, free]))
    return (
        ca.Function("slope", [x, given, taut], [xdot]),
        ca.Function("gap", [x, given], [gap, rate]),
        ca.Function("force", [ca.vec(N), ca.vec(Nd), given, taut], [on_free]),
    )


def _symbols(structure: Structure, name: str, fixed: FloatArray) -> tuple[Any, Any]:
    """Return a symbol of what supports leave free, and with it the columns of all nodes."""
    if structure.rollers:
        free = ca.MX.sym(name, len(structure.free_rows))
        return free, kernel.placed(structure, free, fixed)
    free = ca.MX.sym(name, structure.dimension, len(structure.free))
    return free, kernel.all_nodes(structure, free, fixed)


def _forces(
    structure: Structure, arrays: dict[str, Any], passes: list[Pass], load: FloatArray
) -> Any:
    """Return the forces on all nodes, N, shape (d, n)."""
    d, n = structure.nodes.shape
    pulls: list[Any] = []
    # Which pull goes to which node, and its sign.
    ends = [np.zeros((3, 0), dtype=int)]
    total = 0
    for each in passes:
        for write in each.writes:
            pull = total + each.count * write.output + np.arange(each.count)
            ends.append(np.array([pull, write.at, np.full(each.count, write.sign)]))
        found = _outputs(each, arrays)
        pulls += found
        total += each.count * len(found)
    rows, columns, signs = np.hstack(ends)
    gather = ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM(signs), total, n)
    forces = ca.mtimes(ca.horzcat(*pulls) if pulls else ca.MX(d, 0), gather)
    return forces + ca.DM(load) if load.any() else forces


def _gaps(passes: list[Pass], arrays: dict[str, Any]) -> list[Any]:
    """Return the gap of each switch, and how fast that changes, shape (1, α) each."""
    outputs = [_outputs(each, arrays) for each in passes]
    if len(passes) < 2:
        return outputs[0] if outputs else [ca.MX(1, 0)] * 2
    places = [np.arange(each.count) if each.writes[0].at is None else each.writes[0].at
              for each in passes]  # fmt: skip
    order = np.argsort(np.concatenate(places)).tolist()
    return [ca.horzcat(*parts)[:, order] for parts in zip(*outputs, strict=True)]


def _accelerations(structure: Structure, arrays: dict[str, Any]) -> Any:
    """Return the accelerations of what supports leave free, m/s², a column."""
    d = structure.dimension
    passes = body_passes(structure)
    columns = [part for each in passes for part in _outputs(each, arrays)]
    ends = [write.at for each in passes for write in each.writes]
    nodes = np.concatenate([np.arange(0), *ends])
    if not structure.blocks:
        return kernel.free_entries(structure, ca.horzcat(*columns)[:, np.argsort(nodes).tolist()])
    block = kernel.coupled_block(structure)
    p, v, f = (arrays[name] for name in "pvf")
    found, _ = kernel.block_motion(structure, block, p, v, f)
    rows = np.concatenate([(d * nodes[:, None] + np.arange(d)).ravel(), block.rows])
    place = np.full(structure.nodes.size, -1)
    place[rows] = np.arange(len(rows))
    alone = ca.vec(ca.horzcat(ca.MX(d, 0), *columns))
    return ca.vertcat(alone, found)[place[structure.free_rows].tolist()]


def _outputs(over: Pass, arrays: dict[str, Any]) -> list[Any]:
    """Return the outputs of the kernel, a column a member."""
    columns = {}
    for name, read in over.reads.items():
        array = arrays[read.array]
        if read.at is not None:
            array = array[:, read.at.tolist()]
        elif array.shape[1] > over.count:  # switches of contacts follow those of strings
            array = array[:, : over.count]
        columns[name] = array
    columns |= {name: ca.DM(value).T for name, value in over.parameters.items()}
    return [ca.densify(part) for part in over.kernel(columns)]
