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
from tenscontrol.dynamics.contact_laws import ContactLaw, Contacts
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, IntArray

# Columns of the members by name, SX or MX: (d, k) or (1, k) each.
Columns = dict[str, Any]


@dataclass(frozen=True)
class Read:
    """One column of a kernel: of the member itself, or of one of its nodes."""

    # "p", "v", "f": positions, velocities, forces of nodes; "u" of strings; "taut" of switches
    array: str
    at: IntArray | None = None  # the node, or the string; None: member i reads entry i


@dataclass(frozen=True)
class Write:
    """One output of a kernel."""

    # "f", which is added up; "a", accelerations; "gap" and "rate" of switches
    array: str
    output: int  # which output of the kernel
    at: IntArray | None = None  # as for a read
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


def string_passes(structure: Structure, law: StringLaw | None) -> list[Pass]:
    """Return the passes that add the pull of the strings to the forces; γ is held without a law."""

    def pull(columns: Columns) -> tuple[Any, ...]:
        S, gamma = _segments(columns, "p"), columns["u"]
        if len(S) == 1 and law is None:
            return (kernel.string_pull(S[0], gamma),)
        each, length, rate = _motion(structure, S, columns)
        if law is not None:
            strings = law.with_parameters(columns)
            gamma = columns["taut"] * strings.taut_force_density(length, columns["u"], rate)
        if len(S) == 1:
            return (kernel.string_pull(S[0], gamma),)
        tension = gamma * length  # one along the whole string
        return tuple(map(kernel.string_pull, S, (tension / part for part in each)))

    found = []
    for strings, nodes in _by_segments(structure):
        reads = _along(nodes, velocities=law is not None and law.is_damped)
        reads["u"] = Read("u", strings)
        if law is not None:
            reads["taut"] = Read("taut", strings)
        writes = [
            Write("f", k, nodes[k + end], sign=1 - 2 * end)
            for k in range(len(nodes) - 1)
            for end in (0, 1)
        ]
        name, count = f"strings_{len(nodes)}", len(nodes[0])
        found.append(Pass(name, count, pull, reads, tuple(writes), _parameters(law, strings)))
    return found


def gap_passes(structure: Structure, law: StringLaw) -> list[Pass]:
    """Return the passes that measure how far strings are from slack, and how that changes."""

    def gap(columns: Columns) -> tuple[Any, ...]:
        _, length, rate = _motion(structure, _segments(columns, "p"), columns)
        return law.with_parameters(columns).gap(length, columns["u"], rate), rate

    return [
        Pass(
            f"gaps_{len(nodes)}",
            len(nodes[0]),
            gap,
            _along(nodes) | {"u": Read("u", strings)},
            (Write("gap", 0, strings), Write("rate", 1, strings)),
            _parameters(law, strings),
        )
        for strings, nodes in _by_segments(structure)
    ]


def contact_passes(contacts: Contacts | None, strings: int) -> tuple[list[Pass], list[Pass]]:
    """Return the passes that add the forces of the ground, and those that measure the gaps.

    The switches of contacts follow those of so many strings.
    """
    forces, gaps = [], []
    for i, (law, nodes, switch) in enumerate(contacts or ()):
        if not len(nodes):
            continue

        def push(columns: Columns, law: ContactLaw = law) -> tuple[Any, ...]:
            return (law.force(columns["p"], columns["v"], columns.get("taut", 1)),)

        def gap(columns: Columns, law: ContactLaw = law) -> tuple[Any, ...]:
            depth, rate, _ = law.sinking(columns["p"], columns["v"])
            return law.gap(depth, rate), rate

        reads = {"p": Read("p", nodes), "v": Read("v", nodes)}
        of_force = reads
        if switch is not None:
            at = strings + np.arange(switch.start, switch.stop)
            of_force = reads | {"taut": Read("taut", at)}
            writes = (Write("gap", 0, at), Write("rate", 1, at))
            gaps.append(Pass(f"ground_gaps_{i}", len(nodes), gap, reads, writes, {}))
        on = (Write("f", 0, nodes),)
        forces.append(Pass(f"ground_{i}", len(nodes), push, of_force, on, {}))
    return forces, gaps


def body_passes(structure: Structure) -> list[Pass]:
    """Return the passes that turn the forces into accelerations of nodes outside of blocks."""
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


def _by_segments(structure: Structure) -> list[tuple[IntArray | None, IntArray]]:
    """Return strings of as many segments each, None for all, and their nodes, one a column."""
    if len(structure.strings) == 0:
        return []
    if not structure.has_clusters:
        return [(None, structure.strings.T)]
    sizes = np.array([len(path) for path in structure.paths])
    groups = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    return [(each, np.array([structure.paths[i] for i in each]).T) for each in groups]


def _along(nodes: IntArray, velocities: bool = True) -> dict[str, Read]:
    """Return the reads of the nodes that strings run over."""
    parts = "pv" if velocities else "p"
    return {f"{part}_{k}": Read(part, at) for part in parts for k, at in enumerate(nodes)}


def _segments(columns: Columns, part: str) -> list[Any]:
    """Return the vectors of the segments, or their rates."""
    count = sum(name.startswith(f"{part}_") for name in columns)
    return [columns[f"{part}_{k + 1}"] - columns[f"{part}_{k}"] for k in range(count - 1)]


def _motion(structure: Structure, S: list[Any], columns: Columns) -> tuple[list[Any], Any, Any]:
    """Return the lengths of segments, and length and rate of the strings.

    The rate is None where no velocities are read.
    """
    if len(S) == 1:
        each = [kernel.pulling_length(S[0], columns["u"])]
    else:
        each = [kernel.string_length(structure, part) for part in S]
    rates = map(kernel.length_rate, S, _segments(columns, "v"), each)
    first = next(rates, None)
    return each, sum(each[1:], each[0]), None if first is None else sum(rates, first)


def _ends(start: IntArray, end: IntArray) -> dict[str, Read]:
    return {
        f"{part}_{name}": Read(part, nodes)
        for part in "pv"
        for name, nodes in (("start", start), ("end", end))
    }


def _parameters(law: StringLaw | None, strings: IntArray | None) -> dict[str, float | FloatArray]:
    names = () if law is None else fields(law)
    some = slice(None) if strings is None else strings
    return {field.name: _shared(getattr(law, field.name)[some]) for field in names}


def _shared(values: FloatArray) -> float | FloatArray:
    """Return the one number that all members share, if they do."""
    one = len(values) > 0 and bool(np.all(values == values[0]))
    return float(values[0]) if one else values
