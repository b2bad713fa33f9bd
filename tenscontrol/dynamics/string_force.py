"""The pull of the strings on the nodes."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.force import Columns, Force, Pass, Read, Write, shared
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.structure.structure import Structure


class StringForce(Force):
    """The pull of strings whose force densities are held, or by a law whose rest lengths are.

    Parameters
    ----------
    structure : Structure
    law : StringLaw or None
        None where force densities are held. Its parameters may be symbols.
    """

    conserves_momentum = True

    def __init__(self, structure: Structure, law: StringLaw | None) -> None:
        self._structure, self._law = structure, law

    @property
    def switches(self) -> int:
        """Number of strings that can go slack."""
        return 0 if self._law is None else len(self._structure.strings)

    @property
    def is_velocity_dependent(self) -> bool:
        """Whether a string is damped."""
        return self._law is not None and self._law.is_damped

    def force_density(self, N: Any, Nd: Any, u: Any) -> Any:
        """Return γ of each string, N/m, shape (α, 1): the input, or what the law makes of it.

        Parameters
        ----------
        N, Nd : casadi.SX, shape (d, n)
            Positions, m, and velocities, m/s, of all nodes.
        u : casadi.SX, shape (α, 1)
        """
        if self._law is None:
            return u
        length, rate = kernel.string_motion(self._structure, N, Nd)
        return self._law.symbolic_force_density(length.T, u, rate.T)

    def stored_energy(self, N: Any, u: Any = None) -> Any:
        """Return what each string stores, J, shape (α, 1); see :meth:`Force.stored_energy`."""
        if len(self._structure.strings) == 0:
            return type(N)(0, 1)
        if self._law is None and not self._structure.has_clusters:
            S = kernel.differences(N, self._structure.strings)
            return kernel.dots(S, S).T * u / 2
        length = kernel.string_lengths(self._structure, N).T
        if self._law is None:
            return length**2 * u / 2
        return self._law.as_expressions().stored_energy(length, u)

    def energy_passes(self) -> list[Pass]:
        """Return the passes that measure what strings store, J, times a weight of each.

        Of a structure with clustered strings, lengths of segments are rounded: ``√(l² + r²)``.
        """
        structure, law = self._structure, self._law

        def stored(columns: Columns) -> tuple[Any, ...]:
            S, u = _segments(columns, "p"), columns["u"]
            if structure.has_clusters:
                own = (kernel.string_length(structure, segment) for segment in S)
                square = sum(ca.sqrt(length**2 + columns["rounding"] ** 2) for length in own) ** 2
            elif law is None:
                square = kernel.dots(S[0], S[0])
            else:
                square = kernel.pulling_length(S[0], u) ** 2
            if law is None:
                return (columns["weight"] * square * u / 2,)
            energy = law.with_parameters(columns).stored_energy(ca.sqrt(square), u)
            return (columns["weight"] * energy,)

        passes = []
        for strings, nodes in _by_segments(structure):
            reads = _along(nodes, velocities=False)
            reads |= {"u": Read("u", strings), "weight": Read("weight", strings)}
            name, count = f"stored_{len(nodes)}", len(nodes[0])
            if structure.has_clusters:
                reads["rounding"] = Read("rounding", np.zeros(count, int))
            passes.append(Pass(name, count, stored, reads, (), _parameters(law, strings)))
        return passes

    def passes(self, switched: bool) -> list[Pass]:
        """See :meth:`Force.passes`."""
        structure, law = self._structure, self._law

        def pull(columns: Columns) -> tuple[Any, ...]:
            S, gamma = _segments(columns, "p"), columns["u"]
            if len(S) == 1 and law is None:
                return (kernel.string_pull(S[0], gamma),)
            own, length, rate = _motion(structure, S, columns, guarded=switched or law is None)
            if law is not None:
                strings = law.with_parameters(columns)
                if switched:
                    gamma = strings.taut_force_density(length, columns["u"], rate)
                    gamma = columns["taut"] * gamma
                else:
                    gamma = strings.symbolic_force_density(length, columns["u"], rate)
            if len(S) == 1:
                return (kernel.string_pull(S[0], gamma),)
            tension = gamma * length  # one along the whole string
            return tuple(map(kernel.string_pull, S, (tension / segment for segment in own)))

        passes = []
        for strings, nodes in _by_segments(structure):
            reads = _along(nodes, velocities=self.is_velocity_dependent)
            reads["u"] = Read("u", strings)
            if law is not None and switched:
                reads["taut"] = Read("taut", strings)
            writes = [
                Write("f", k, nodes[k + end], sign=1 - 2 * end)
                for k in range(len(nodes) - 1)
                for end in (0, 1)
            ]
            name, count = f"strings_{len(nodes)}", len(nodes[0])
            passes.append(Pass(name, count, pull, reads, tuple(writes), _parameters(law, strings)))
        return passes

    def gap_passes(self) -> list[Pass]:
        """Return the passes that measure how far strings are from slack, and how that changes."""
        structure, law = self._structure, self._law
        if law is None:
            return []

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

    def mean_force(self, before: Any, after: Any, u: Any, h: Any) -> Any:
        """Return the forces whose work strings store; see :meth:`Force.mean_force`.

        The force density of a straight piece of string is 2 T̄/(l₀ + l₁), where T̄ is the mean of
        the tension over the lengths that the whole string passes: a discrete gradient.
        """
        structure, law = self._structure, self._law
        if len(structure.strings) == 0:
            return type(before)(*before.shape)
        gamma = u.T
        if law is not None or structure.has_clusters:
            S0, S1 = (kernel.differences(N, structure.segments) for N in (before, after))
            pieces = [kernel.string_length(structure, S).T for S in (S0, S1)]
            first, last = pieces
            if structure.has_clusters:
                first, last = (kernel.string_lengths(structure, N).T for N in (before, after))
            if law is None:
                twice = u * (first + last)
            else:
                twice = _twice_mean_tension(law, first, last, u, h)
            if structure.has_clusters:
                twice = twice[structure.segment_string.tolist(), 0]
            gamma = (twice / (pieces[0] + pieces[1])).T
        S = kernel.differences((before + after) / 2, structure.segments)
        return kernel.segment_forces(structure, S, gamma)


def _twice_mean_tension(law: StringLaw, before: Any, after: Any, rest: Any, h: Any) -> Any:
    """Return 2 T̄ of strings whose lengths and rest lengths are columns.

    ``T̄ (l₁ − l₀)`` is the change of the stored energy. A string that is slack on a part of the way
    pulls on the other part only. For laws in which the tension is linear in the length, the mean
    over the taut part is the tension in its middle.
    """
    low, high = ca.fmax(before, rest), ca.fmax(after, rest)
    was, is_ = before > rest, after > rest
    change = after - before
    crossing = was != is_
    share = ca.if_else(crossing, (high - low) / ca.if_else(crossing, change, 1), was)
    law = law.as_expressions()
    tension = law.tension((low + high) / 2, rest)
    if law.is_damped:
        tension = ca.fmax(0, tension + law.damping * change / h)
    return 2 * share * tension


def _by_segments(structure: Structure) -> list[tuple[IntArray | None, IntArray]]:
    """Return strings of as many segments each, None for all, and their nodes, one a column."""
    if len(structure.strings) == 0:
        return []
    if not structure.has_clusters:
        return [(None, structure.strings.T)]
    sizes = np.array([len(path) for path in structure.paths])
    groups = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    return [(group, np.array([structure.paths[i] for i in group]).T) for group in groups]


def _along(nodes: IntArray, velocities: bool = True) -> dict[str, Read]:
    """Return the reads of the nodes that strings run over."""
    arrays = "pv" if velocities else "p"
    return {f"{array}_{k}": Read(array, node) for array in arrays for k, node in enumerate(nodes)}


def _segments(columns: Columns, array: str) -> list[Any]:
    """Return the vectors of the segments, or their rates."""
    count = sum(name.startswith(f"{array}_") for name in columns)
    return [columns[f"{array}_{k + 1}"] - columns[f"{array}_{k}"] for k in range(count - 1)]


def _motion(
    structure: Structure, S: list[Any], columns: Columns, guarded: bool = True
) -> tuple[list[Any], Any, Any]:
    """Return the lengths of segments, and length and rate of the strings.

    Guarded, a slack string may have no length. The rate is None where no velocities are read.
    """
    if guarded and not structure.has_clusters:
        own = [kernel.pulling_length(S[0], columns["u"])]
    else:
        own = [kernel.string_length(structure, segment) for segment in S]
    rates = map(kernel.length_rate, S, _segments(columns, "v"), own)
    first = next(rates, None)
    return own, sum(own[1:], own[0]), None if first is None else sum(rates, first)


def _parameters(law: StringLaw | None, strings: IntArray | None) -> dict[str, Any]:
    names = () if law is None else fields(law)
    some = slice(None) if strings is None else strings.tolist()
    return {field.name: shared(getattr(law, field.name)[some]) for field in names}
