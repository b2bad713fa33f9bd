"""The motion at the start of a scene."""

from __future__ import annotations

import numpy as np

from tenscontrol.scene.document import Document
from tenscontrol.structure import Structure, restore_bar_lengths
from tenscontrol.validation import FloatArray, positive_number, whole_number


def build_start(document: Document, structure: Structure) -> tuple[FloatArray, FloatArray]:
    """Return node positions and velocities at the start, m and m/s, shape (3, n)."""
    table = document.table("start")
    nodes, velocities = structure.nodes, np.zeros_like(structure.nodes)
    if "velocities" in table:
        rows = np.array(table.need("velocities"), dtype=float).reshape(-1, 3)
        with table.checked("velocities"):
            if rows.shape != nodes.T.shape:
                raise ValueError(
                    f"velocities has {len(rows)} entries, expected {nodes.shape[1]}: "
                    "[x, y, z] for each node"
                )
            velocities = structure.checked_nodes("velocities", rows.T)
            _refuse_impossible(structure, velocities)
    if "seed" in table and "disturbance" not in table:
        raise table.error("seed", "in [start], seed goes with disturbance")
    if "disturbance" in table:
        with table.checked("disturbance"):
            size = positive_number("disturbance", table.need("disturbance"), "m")
            seed = whole_number("seed", table.get("seed", 0), least=0)
            nodes = _disturbed(structure, size, seed)
    return nodes, velocities


def _refuse_impossible(structure: Structure, velocities: FloatArray) -> None:
    """Raise if fixed nodes move, or bars are stretched."""
    for node in structure.fixed:
        if velocities[:, node].any():
            raise ValueError(f"velocities[{node}] moves a fixed node, expected [0, 0, 0]")
    bars, rates = structure.bar_vectors(structure.nodes), structure.bar_vectors(velocities)
    stretching = np.abs((bars * rates).sum(axis=0)) / structure.bar_length
    if stretching.size and stretching.max() > 1e-8 * max(float(np.abs(velocities).max()), 1e-300):
        bar = int(stretching.argmax())
        raise ValueError(
            f"velocities stretch bar {bar} at {stretching[bar]:.3g} m/s, expected 0: bars are rigid"
        )


def _disturbed(structure: Structure, size: float, seed: int) -> FloatArray:
    """Return a shape with true bar lengths whose farthest node is moved by ``size``, m."""
    moves = np.zeros_like(structure.nodes)
    random = np.random.default_rng(seed)
    moves[:, structure.free] = random.normal(size=(3, len(structure.free)))
    step = size / 4
    for _ in range(40):  # how far is nearly linear in the step: this converges at once
        nodes = restore_bar_lengths(structure, structure.nodes + step * moves)
        off = float(np.linalg.norm(nodes - structure.nodes, axis=0).max())
        if off == 0:
            raise ValueError("disturbance moves nothing: no node is free")
        if abs(off / size - 1) < 1e-12:
            return nodes
        step *= size / off
    largest = float(np.ptp(structure.nodes, axis=1).max())
    raise ValueError(
        f"disturbance is {size:g} m, which rigid bars cannot follow; expected much less than the "
        f"size of the structure, {largest:g} m"
    )
