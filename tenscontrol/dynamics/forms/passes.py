"""The equations of motion as passes over members of one kind.

A pass is a kernel, the columns it reads for each member and the nodes it writes
to. The equations of a large scene are put together from passes: operation by
operation in a graph (:mod:`tenscontrol.dynamics.forms.mapped`), or as loops in C
(:mod:`tenscontrol.dynamics.forms.loops`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, IntArray

# Columns of the members by name, SX or MX: (3, k) or (1, k) each.
Columns = dict[str, Any]


@dataclass(frozen=True)
class Read:
    """One column of a kernel: of the member itself, or of one of its nodes."""

    array: str  # "p", "v", "f": positions, velocities, forces of nodes; "u", "taut" of strings
    nodes: IntArray | None = None  # the node of each member; None for entries of the members


@dataclass(frozen=True)
class Write:
    """One output of a kernel."""

    array: str  # "f", which is added up, or "a", accelerations; "gap" and "rate" of strings
    output: int  # which output of the kernel
    nodes: IntArray | None = None  # as for a read
    sign: int = 1  # whether the output or its opposite is added


@dataclass(frozen=True, eq=False)
class Pass:
    """A kernel and the members it goes over."""

    name: str
    count: int  # of members
    kernel: Callable[[Columns], tuple[Any, ...]]  # from columns by name to output columns
    reads: dict[str, Read]
    writes: tuple[Write, ...]
    parameters: dict[str, float | FloatArray]  # further columns: one number for all, or for each


def string_pass(structure: Structure, law: StringLaw | None) -> Pass:
    """Return the pass that adds the pull of the strings to the forces; γ is held without a law."""
    start, end = structure.strings.T

    def pull(columns: Columns) -> tuple[Any, ...]:
        S = columns["p_end"] - columns["p_start"]
        if law is None:
            return (kernel.string_pull(S, columns["u"]),)
        length, rate = _motion(S, columns)
        gamma = law.with_parameters(columns).taut_force_density(length, columns["u"], rate)
        return (kernel.string_pull(S, columns["taut"] * gamma),)

    reads = _ends(start, end, velocities=law is not None and law.is_damped) | {"u": Read("u")}
    if law is not None:
        reads["taut"] = Read("taut")
    writes = (Write("f", 0, start), Write("f", 0, end, sign=-1))
    return Pass("strings", len(start), pull, reads, writes, _parameters(law))


def gap_pass(structure: Structure, law: StringLaw) -> Pass:
    """Return the pass that measures how far the strings are from slack, and how that changes."""
    start, end = structure.strings.T

    def gap(columns: Columns) -> tuple[Any, ...]:
        length, rate = _motion(columns["p_end"] - columns["p_start"], columns)
        return law.with_parameters(columns).gap(length, columns["u"], rate), rate

    reads = _ends(start, end, velocities=True) | {"u": Read("u")}
    writes = (Write("gap", 0), Write("rate", 1))
    return Pass("gaps", len(start), gap, reads, writes, _parameters(law))


def body_passes(structure: Structure) -> list[Pass]:
    """Return the passes that turn the forces into accelerations of the free nodes."""
    bars = structure.bars[structure.free_bars]
    found = [_free_bars(bars[:, 0], bars[:, 1], structure.bar_mass[structure.free_bars])]
    hinge, tip = structure.hinged_pairs.T
    found.append(_swinging_bars(hinge, tip, structure.bar_mass[structure.swinging_bars]))
    found.append(_points(structure.string_nodes, structure.string_node_mass))
    return [each for each in found if each.count]


def _free_bars(start: IntArray, end: IntArray, mass: FloatArray) -> Pass:
    def accelerate(columns: Columns) -> tuple[Any, ...]:
        B, Bd = (columns[f"{part}_end"] - columns[f"{part}_start"] for part in "pv")
        at = columns["f_start"], columns["f_end"]
        return kernel.free_bar(B, Bd, *at, columns["mass"])[:2]

    reads = _ends(start, end) | {"f_start": Read("f", start), "f_end": Read("f", end)}
    writes = (Write("a", 0, start), Write("a", 1, end))
    return Pass("free_bars", len(start), accelerate, reads, writes, {"mass": _shared(mass)})


def _swinging_bars(hinge: IntArray, tip: IntArray, mass: FloatArray) -> Pass:
    def accelerate(columns: Columns) -> tuple[Any, ...]:
        B, Bd = (columns[f"{part}_end"] - columns[f"{part}_start"] for part in "pv")
        return kernel.swinging_bar(B, Bd, columns["f_end"], columns["mass"])[:1]

    reads = _ends(hinge, tip) | {"f_end": Read("f", tip)}
    writes = (Write("a", 0, tip),)
    return Pass("swinging_bars", len(tip), accelerate, reads, writes, {"mass": _shared(mass)})


def _points(nodes: IntArray, mass: FloatArray) -> Pass:
    def accelerate(columns: Columns) -> tuple[Any, ...]:
        return (kernel.point_acceleration(columns["f"], columns["mass"]),)

    writes = (Write("a", 0, nodes),)
    reads = {"f": Read("f", nodes)}
    return Pass("points", len(nodes), accelerate, reads, writes, {"mass": _shared(mass)})


def _motion(S: Any, columns: Columns) -> tuple[Any, Any]:
    """Return length and rate; the rate is None where no velocities are read."""
    length = kernel.pulling_length(S, columns["u"])
    if "v_end" not in columns:
        return length, None
    return length, kernel.length_rate(S, columns["v_end"] - columns["v_start"], length)


def _ends(start: IntArray, end: IntArray, velocities: bool = True) -> dict[str, Read]:
    parts = "pv" if velocities else "p"
    return {
        f"{part}_{name}": Read(part, nodes)
        for part in parts
        for name, nodes in (("start", start), ("end", end))
    }


def _parameters(law: StringLaw | None) -> dict[str, float | FloatArray]:
    names = () if law is None else fields(law)
    return {field.name: _shared(getattr(law, field.name)) for field in names}


def _shared(values: FloatArray) -> float | FloatArray:
    """Return the one number that all members share, if they do."""
    one = len(values) > 0 and bool(np.all(values == values[0]))
    return float(values[0]) if one else values
