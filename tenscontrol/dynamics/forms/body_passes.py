"""Passes over members that turn the forces on nodes into accelerations."""

from __future__ import annotations

from typing import Any

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.force import Columns, Pass, Read, Write, shared
from tenscontrol.structure.structure import Structure


def body_passes(structure: Structure, driven: bool = False) -> list[Pass]:
    """Return the passes that turn the forces into accelerations of nodes outside of blocks.

    Where bars are ``driven``, they read the extension of each bar, an array "e".
    """
    bars, (start, end) = structure.free_bars, structure.bars[structure.free_bars].T
    extension = {"extension": Read("e", bars)} if driven else {}
    passes = [_free_bars(start, end, structure.bar_mass[bars], extension)]
    bars, (hinge, tip) = structure.swinging_bars, structure.hinged_pairs.T
    extension = {"extension": Read("e", bars)} if driven else {}
    passes.append(_swinging_bars(hinge, tip, structure.bar_mass[bars], extension))
    passes.append(_points(structure.string_nodes, structure.string_node_mass))
    return [over for over in passes if over.count]


def _free_bars(
    start: IntArray, end: IntArray, mass: FloatArray, extension: dict[str, Read]
) -> Pass:
    def accelerate(columns: Columns) -> tuple[Any, ...]:
        B, Bd = (columns[f"{array}_end"] - columns[f"{array}_start"] for array in "pv")
        forces = columns["f_start"], columns["f_end"]
        return kernel.free_bar(B, Bd, *forces, columns["mass"], columns.get("extension"))[:2]

    reads = _ends(start, end) | {"f_start": Read("f", start), "f_end": Read("f", end)} | extension
    writes = (Write("a", 0, start), Write("a", 1, end))
    return Pass("free_bars", len(start), accelerate, reads, writes, {"mass": shared(mass)})


def _swinging_bars(
    hinge: IntArray, tip: IntArray, mass: FloatArray, extension: dict[str, Read]
) -> Pass:
    def accelerate(columns: Columns) -> tuple[Any, ...]:
        B, Bd = (columns[f"{array}_end"] - columns[f"{array}_start"] for array in "pv")
        given = columns["f_end"], columns["mass"], columns.get("extension")
        return kernel.swinging_bar(B, Bd, *given)[:1]

    reads = _ends(hinge, tip) | {"f_end": Read("f", tip)} | extension
    writes = (Write("a", 0, tip),)
    return Pass("swinging_bars", len(tip), accelerate, reads, writes, {"mass": shared(mass)})


def _points(nodes: IntArray, mass: FloatArray) -> Pass:
    def accelerate(columns: Columns) -> tuple[Any, ...]:
        return (kernel.point_acceleration(columns["f"], columns["mass"]),)

    writes = (Write("a", 0, nodes),)
    reads = {"f": Read("f", nodes)}
    return Pass("points", len(nodes), accelerate, reads, writes, {"mass": shared(mass)})


def _ends(start: IntArray, end: IntArray) -> dict[str, Read]:
    return {
        f"{array}_{name}": Read(array, nodes)
        for array in "pv"
        for name, nodes in (("start", start), ("end", end))
    }
