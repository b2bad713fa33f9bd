"""The interface of a force on nodes, which strings, contacts and every other force show.

A force is stated once, as passes: kernels in CasADi on the columns of its members. All forms of
the equations of motion, their derivatives and the steps of integrators are made of these.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from tenscontrol.arrays import IntArray

# Arrays with a vector for each node; the others have a number for each string or switch.
VECTORS = "pvfa"

# Columns of the members by name, SX or MX: (d, k) or (1, k) each.
Columns = dict[str, Any]


@dataclass(frozen=True)
class Read:
    """One column of a kernel: of the member itself, or of one of its nodes."""

    # "p", "v", "f": positions, velocities, forces of nodes; "u" of strings; "taut" of switches;
    # "e": extension of bars whose lengths are driven
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
    parameters: dict[str, Any]  # further columns: one number for all, or one for each, or symbols

    def outputs(self, arrays: Columns) -> list[Any]:
        """Return the outputs of the kernel, a column a member, from arrays by name."""
        columns = {}
        for name, read in self.reads.items():
            array = arrays[read.array]
            if read.at is not None:
                array = array[:, read.at.tolist()]
            elif array.shape[1] > self.count:  # switches of others follow those of strings
                array = array[:, : self.count]
            columns[name] = array
        for name, value in self.parameters.items():
            columns[name] = value.T if isinstance(value, ca.SX) else ca.DM(value).T
        return [ca.densify(output) for output in self.kernel(columns)]

    def for_one(self, dimension: int) -> tuple[Columns, Columns, tuple[Any, ...]]:
        """Return symbols of what one member reads and of parameters of its own, and its outputs."""
        inputs = {
            name: ca.SX.sym(name, dimension if read.array in VECTORS else 1)
            for name, read in self.reads.items()
        }
        same = {name: ca.DM(v) for name, v in self.parameters.items() if isinstance(v, float)}
        own = {name: ca.SX.sym(name) for name in self.parameters if name not in same}
        return inputs, own, self.kernel(inputs | same | own)

    def with_switches_from(self, first: int) -> Pass:
        """Return the pass with its switches behind those of other forces."""
        if not first:
            return self

        def moved(access: Any) -> Any:
            if access.array not in ("taut", "gap", "rate"):
                return access
            members = np.arange(self.count) if access.at is None else access.at
            return replace(access, at=first + members)

        reads = {name: moved(read) for name, read in self.reads.items()}
        return replace(self, reads=reads, writes=tuple(map(moved, self.writes)))


def sum_on_nodes(passes: Iterable[Pass], arrays: Columns) -> Any:
    """Return the forces of passes on all nodes, N, shape (d, n), from arrays by name."""
    d, n = arrays["p"].shape
    pushes: list[Any] = []
    # Which push goes to which node, and its sign.
    ends = [np.zeros((3, 0), dtype=int)]
    total = 0
    for over in passes:
        for write in over.writes:
            push = total + over.count * write.output + np.arange(over.count)
            ends.append(np.array([push, write.at, np.full(over.count, write.sign)]))
        outputs = over.outputs(arrays)
        pushes += outputs
        total += over.count * len(outputs)
    if not pushes:
        return type(arrays["p"])(d, n)
    rows, columns, signs = np.hstack(ends)
    gather = ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM(signs), total, n)
    return ca.mtimes(ca.horzcat(*pushes), gather)


def shared(values: Any) -> Any:
    """Return the one number that all members share, if they do; symbols as they are."""
    if isinstance(values, ca.SX):
        return values
    one = len(values) > 0 and bool(np.all(values == values[0]))
    return float(values[0]) if one else values


class Force(ABC):
    """A force on nodes, by members.

    A force of your own is a subclass with one method, :meth:`passes`, and the attributes that
    differ from those here.
    """

    #: The argument of a model that it is made from. Where that is a number that scene files may
    #: give in [loads]: its unit, and what it is.
    argument: ClassVar[str] = ""
    unit: ClassVar[str] = ""
    meaning: ClassVar[str] = ""

    #: Whether it leaves linear and angular momentum as they are.
    conserves_momentum: bool = False
    #: Whether runs record what it stores and what it takes from the energy.
    is_recorded: bool = False

    @property
    def switches(self) -> int:
        """Number of switches: entries of ``taut``."""
        return 0

    @property
    def is_velocity_dependent(self) -> bool:
        """Whether it depends on velocities."""
        return False

    @abstractmethod
    def passes(self, switched: bool) -> list[Pass]:
        """Return the passes that add it to the forces on nodes.

        Parameters
        ----------
        switched : bool
            Whether ``taut``, 1 or 0, says for each switch if there is a force, so that the kernels
            are smooth. Else they find out.
        """

    def gap_passes(self) -> list[Pass]:
        """Return the passes that measure the gap of each switch, m, and its rate, m/s."""
        return []

    def on_nodes(self, N: Any, Nd: Any, u: Any = None) -> Any:
        """Return the force on all nodes, N, shape (d, n).

        Parameters
        ----------
        N, Nd : casadi.SX, shape (d, n)
            Positions, m, and velocities, m/s, of all nodes.
        u : casadi.SX, shape (α, 1), optional
            Input of the strings, for a force that depends on it.
        """
        arrays = {"p": N, "v": Nd, "u": None if u is None else u.T}
        return sum_on_nodes(self.passes(switched=False), arrays)

    def mean_force(self, before: Any, after: Any, u: Any, h: Any) -> Any:
        """Return the mean force on all nodes over a step, N, shape (d, n).

        What a force takes from the energy over a step must be its work: one that stores energy has
        a discrete gradient of its own. This is the force halfway at the mean velocity.

        Parameters
        ----------
        before, after : casadi.SX, shape (d, n)
            Positions of all nodes, m.
        u : casadi.SX, shape (α, 1)
            Input of the strings.
        h : casadi.SX
            s.
        """
        return self.on_nodes((before + after) / 2, (after - before) / h, u)

    def stored_energy(self, N: Any, u: Any = None) -> Any:
        """Return what it stores, J, a number, or a column of one a member.

        Parameters
        ----------
        N : casadi.SX, shape (d, n)
            Positions of all nodes, m.
        u : casadi.SX, shape (α, 1), optional
            Input of the strings, for a force that depends on it.
        """
        return type(N)(1, 1)
