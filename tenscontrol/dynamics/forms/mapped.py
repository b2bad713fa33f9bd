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
from tenscontrol.dynamics.forms.passes import Pass, body_passes, gap_pass, string_pass
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, IntArray


def mapped_functions(
    structure: Structure, law: StringLaw | None, load: FloatArray
) -> tuple[ca.Function, ...]:
    """Return slope, gap and force of :class:`Equation`; arguments as for ``loops_source``."""
    free = structure.free
    N, Nd = ca.MX.sym("N", 3, len(free)), ca.MX.sym("Nd", 3, len(free))
    u = ca.MX.sym("u", len(structure.strings))
    taut = ca.MX.sym("taut", 0 if law is None else len(structure.strings))
    arrays = {
        "p": kernel.all_nodes(structure, N, structure.nodes),
        "v": kernel.all_nodes(structure, Nd),
        "u": u.T,
        "taut": taut.T,
    }
    arrays["f"] = _forces(structure, arrays, law, load)
    x = ca.vertcat(ca.vec(N), ca.vec(Nd))
    gap = rate = ca.MX(0, 1)
    if law is not None:
        gap, rate = (row.T for row in _outputs(gap_pass(structure, law), arrays))
    xdot = ca.vertcat(ca.vec(Nd), ca.vec(_accelerations(structure, arrays)))
    on_free = ca.vec(ca.densify(arrays["f"][:, free.tolist()]))
    return (
        ca.Function("slope", [x, u, taut], [xdot]),
        ca.Function("gap", [x, u], [gap, rate]),
        ca.Function("force", [ca.vec(N), ca.vec(Nd), u, taut], [on_free]),
    )


def _forces(
    structure: Structure, arrays: dict[str, Any], law: StringLaw | None, load: FloatArray
) -> Any:
    """Return the forces on all nodes, N, shape (3, n)."""
    strings = string_pass(structure, law)
    n, alpha = structure.nodes.shape[1], strings.count
    pulls = _outputs(strings, arrays)[0] if alpha else ca.MX(3, 0)
    # Adds the pulls up: a column a node, by the strings that meet there.
    rows = np.repeat(np.arange(alpha), 2)
    columns = structure.strings.ravel()
    signs = np.tile([float(write.sign) for write in strings.writes], alpha)
    gather = ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM(signs), alpha, n)
    forces = ca.mtimes(pulls, gather)
    return forces + ca.DM(load) if load.any() else forces


def _accelerations(structure: Structure, arrays: dict[str, Any]) -> Any:
    """Return N̈ of the free nodes, m/s², shape (3, n)."""
    columns: list[Any] = []
    nodes: list[IntArray] = []
    for each in body_passes(structure):
        columns += _outputs(each, arrays)
        nodes += [write.nodes for write in each.writes if write.nodes is not None]
    place = np.argsort(np.concatenate(nodes))
    return ca.horzcat(*columns)[:, place.tolist()]


def _outputs(over: Pass, arrays: dict[str, Any]) -> list[Any]:
    """Return the outputs of the kernel, a column a member."""
    columns = {
        name: arrays[read.array]
        if read.nodes is None
        else arrays[read.array][:, read.nodes.tolist()]
        for name, read in over.reads.items()
    }
    columns |= {name: ca.DM(value).T for name, value in over.parameters.items()}
    return [ca.densify(part) for part in over.kernel(columns)]
