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
from tenscontrol.dynamics.forms.passes import Pass, body_passes, gap_passes, string_passes
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray


def mapped_functions(
    structure: Structure, law: StringLaw | None, load: FloatArray
) -> tuple[ca.Function, ...]:
    """Return slope, gap and force of :class:`Equation`; arguments as for ``loops_source``."""
    q, v = (ca.MX.sym(name, len(structure.free_rows)) for name in "qv")
    alpha = len(structure.strings)
    u, taut = ca.MX.sym("u", alpha), ca.MX.sym("taut", 0 if law is None else alpha)
    arrays = {
        "p": kernel.placed(structure, q, structure.nodes),
        "v": kernel.placed(structure, v, np.zeros_like(structure.nodes)),
        "u": u.T,
        "taut": taut.T,
    }
    arrays["f"] = _forces(structure, arrays, law, load)
    x = ca.vertcat(q, v)
    gap = rate = ca.MX(0, 1)
    if law is not None:
        gap, rate = (row.T for row in _gaps(structure, arrays, law))
    xdot = ca.vertcat(v, _accelerations(structure, arrays))
    on_free = ca.vec(ca.densify(arrays["f"]))[structure.free_rows.tolist()]
    return (
        ca.Function("slope", [x, u, taut], [xdot]),
        ca.Function("gap", [x, u], [gap, rate]),
        ca.Function("force", [q, v, u, taut], [on_free]),
    )


def _forces(
    structure: Structure, arrays: dict[str, Any], law: StringLaw | None, load: FloatArray
) -> Any:
    """Return the forces on all nodes, N, shape (d, n)."""
    d, n = structure.nodes.shape
    pulls: list[Any] = []
    # Which pull goes to which node, and its sign.
    ends = [np.zeros((3, 0), dtype=int)]
    total = 0
    for each in string_passes(structure, law):
        for write in each.writes:
            pull = total + each.count * write.output + np.arange(each.count)
            ends.append(np.array([pull, write.at, np.full(each.count, write.sign)]))
        found = _outputs(each, arrays)
        pulls += found
        total += each.count * len(found)
    rows, columns, signs = np.hstack(ends)
    gather = ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM(signs), total, n)
    forces = ca.mtimes(ca.horzcat(ca.MX(d, 0), *pulls), gather)
    return forces + ca.DM(load) if load.any() else forces


def _gaps(structure: Structure, arrays: dict[str, Any], law: StringLaw) -> list[Any]:
    """Return how far each string is from slack, and how fast that changes, shape (1, α) each."""
    passes = gap_passes(structure, law)
    outputs = [_outputs(each, arrays) for each in passes]
    rows = [ca.horzcat(ca.MX(1, 0), *parts) for parts in zip(*outputs, strict=True)]
    if not structure.has_clusters:
        return rows or [ca.MX(1, 0)] * 2
    order = np.argsort(np.concatenate([each.writes[0].at for each in passes]))
    return [row[:, order.tolist()] for row in rows]


def _accelerations(structure: Structure, arrays: dict[str, Any]) -> Any:
    """Return the accelerations of what supports leave free, m/s², a column."""
    d = structure.dimension
    parts: list[Any] = []
    rows: list[Any] = []
    for each in body_passes(structure):
        parts += map(ca.vec, _outputs(each, arrays))
        rows += [(d * write.at[:, None] + np.arange(d)).ravel() for write in each.writes]
    if structure.blocks:
        block = kernel.coupled_block(structure)
        p, v, f = (arrays[name] for name in "pvf")
        parts.append(kernel.block_motion(structure, block, p, v, f)[0])
        rows.append(block.rows)
    place = np.full(structure.nodes.size, -1)
    place[np.concatenate(rows)] = np.arange(sum(map(len, rows)))
    return ca.vertcat(*parts)[place[structure.free_rows].tolist()]


def _outputs(over: Pass, arrays: dict[str, Any]) -> list[Any]:
    """Return the outputs of the kernel, a column a member."""
    columns = {
        name: arrays[read.array] if read.at is None else arrays[read.array][:, read.at.tolist()]
        for name, read in over.reads.items()
    }
    columns |= {name: ca.DM(value).T for name, value in over.parameters.items()}
    return [ca.densify(part) for part in over.kernel(columns)]
