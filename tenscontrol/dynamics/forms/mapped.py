"""The state equation of a large scene as a graph of operations on all members at once.

The graph has so many operations, however many members there are; each is a loop
inside CasADi. That is built in no time where a flat expression of every member
takes minutes, and it needs no compiler.
"""

from __future__ import annotations

from itertools import chain
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.equation import InputLayout
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.dynamics.force import sum_on_nodes
from tenscontrol.dynamics.forces import Forces
from tenscontrol.dynamics.forms.body_passes import body_passes
from tenscontrol.structure.structure import Structure


def mapped_functions(
    forces: Forces, load: FloatArray, layout: InputLayout
) -> tuple[ca.Function, ...]:
    """Return slope, gap and force of :class:`Equation`; arguments as for ``loops_source``."""
    structure = forces.structure
    free, alpha = structure.free.tolist(), len(structure.strings)
    (N, p), (Nd, v) = (
        _symbols(structure, name, values)
        for name, values in (("N", structure.nodes), ("Nd", np.zeros_like(structure.nodes)))
    )
    u, taut = ca.MX.sym("u", alpha), ca.MX.sym("taut", forces.switches)
    ends, given, varying = (p, v), u, None
    if layout.load:
        varying = ca.MX.sym("load", *structure.nodes.shape)
        given = ca.vertcat(given, ca.vec(varying))
    if layout.offset:
        offsets = [ca.MX.sym(name, *structure.nodes.shape) for name in ("offset", "rate")]
        ends = p + offsets[0], v + offsets[1]
        given = ca.vertcat(given, *map(ca.vec, offsets))
    bodies: dict[str, Any] = {"p": p, "v": v}
    if layout.lengths:
        extension = ca.MX.sym("extension", layout.lengths)
        given, bodies["e"] = ca.vertcat(given, extension), extension.T
    arrays = {"p": ends[0], "v": ends[1], "u": u.T, "taut": taut.T}
    f = sum_on_nodes(chain(*forces.passes()), arrays)
    if load.any():
        f += ca.DM(load)
    if varying is not None:
        f += varying
    x = ca.vertcat(ca.vec(N), ca.vec(Nd))
    gap, rate = forces.gaps(*ends, u)
    xdot = ca.vertcat(ca.vec(Nd), _accelerations(structure, bodies | {"f": f}))
    on_free = kernel.free_entries(structure, ca.densify(f[:, free]))
    return (
        Function("slope", [x, given, taut], [xdot]),
        Function("gap", [x, given], [gap, rate]),
        Function("force", [ca.vec(N), ca.vec(Nd), given, taut], [on_free]),
    )


def _symbols(structure: Structure, name: str, fixed: FloatArray) -> tuple[Any, Any]:
    """Return a symbol of what supports leave free, and with it the columns of all nodes."""
    if structure.rollers:
        free = ca.MX.sym(name, len(structure.free_rows))
        return free, kernel.placed(structure, free, fixed)
    free = ca.MX.sym(name, structure.dimension, len(structure.free))
    return free, kernel.all_nodes(structure, free, fixed)


def _accelerations(structure: Structure, arrays: dict[str, Any]) -> Any:
    """Return the accelerations of what supports leave free, m/s², a column."""
    d = structure.dimension
    passes = body_passes(structure, driven="e" in arrays)
    columns = [output for over in passes for output in over.outputs(arrays)]
    ends = [write.at for over in passes for write in over.writes]
    nodes = np.concatenate([np.arange(0), *ends])
    if not structure.blocks:
        return kernel.free_entries(structure, ca.horzcat(*columns)[:, np.argsort(nodes).tolist()])
    block = kernel.coupled_block(structure)
    p, v, f = (arrays[name] for name in "pvf")
    accelerations, _ = kernel.block_motion(structure, block, p, v, f, arrays.get("e"))
    rows = np.concatenate([(d * nodes[:, None] + np.arange(d)).ravel(), block.rows])
    index = np.full(structure.nodes.size, -1)
    index[rows] = np.arange(len(rows))
    alone = ca.vec(ca.horzcat(ca.MX(d, 0), *columns))
    return ca.vertcat(alone, accelerations)[index[structure.free_rows].tolist()]
