"""All forces on the nodes of a model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics.contact_laws import Contacts
from tenscontrol.dynamics.force import Force, Pass, sum_on_nodes
from tenscontrol.dynamics.string_force import StringForce
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.properties import cached_property
from tenscontrol.structure.structure import Structure

#: The forces beside those of strings and loads, by the argument of a model that they come from.
TERMS: Mapping[str, type[Any]] = MappingProxyType({term.argument: term for term in (Contacts,)})


def terms_of(structure: Structure, arguments: dict[str, Any]) -> tuple[Force, ...]:
    """Return the forces that arguments of a model make, without those that are not there."""
    terms = (TERMS[name].of_argument(structure, value) for name, value in arguments.items())
    return tuple(term for term in terms if term is not None)


class Forces:
    """All forces on the nodes of a structure, with the input of its strings.

    Parameters
    ----------
    structure : Structure
    law : StringLaw or None
        None where the input of the strings is their force densities; else it is their rest lengths.
    terms : tuple of Force
        Beside strings. Their switches follow those of the strings, in this order.
    """

    def __init__(
        self, structure: Structure, law: StringLaw | None, terms: tuple[Force, ...] = ()
    ) -> None:
        self.structure, self.law, self.terms = structure, law, terms
        self.strings = StringForce(structure, law)

    def __iter__(self) -> Iterator[Force]:
        return iter((self.strings, *self.terms))

    @cached_property
    def contacts(self) -> Contacts | None:
        """Those of the ground; None without ground."""
        return next((term for term in self.terms if isinstance(term, Contacts)), None)

    @cached_property
    def switches(self) -> int:
        """Number of switches."""
        return sum(term.switches for term in self)

    @cached_property
    def is_velocity_dependent(self) -> bool:
        """Whether a force depends on velocities."""
        return any(term.is_velocity_dependent for term in self)

    @cached_property
    def conserves_energy(self) -> bool:
        """Whether what is taken from the energy is recorded."""
        return not any(term.is_velocity_dependent and not term.is_recorded for term in self)

    @cached_property
    def conserves_momentum(self) -> bool:
        """Whether all leave linear and angular momentum as they are."""
        return all(term.conserves_momentum for term in self)

    def stored_energy(self, N: Any, u: Any) -> Any:
        """Return what is stored, J, without what runs record; see :meth:`Force.stored_energy`."""
        own = (term.stored_energy(N, u) for term in self if not term.is_recorded)
        return sum(map(ca.sum1, own), type(N)(1, 1))

    def passes(self, switched: bool = True) -> list[list[Pass]]:
        """Return the passes of each force; see :meth:`Force.passes`."""
        return self._in_order([term.passes(switched) for term in self])

    def gap_passes(self) -> list[Pass]:
        """Return the passes that measure the gap of each switch, m, and its rate, m/s."""
        return list(chain(*self._in_order([term.gap_passes() for term in self])))

    def _in_order(self, passes: list[list[Pass]]) -> list[list[Pass]]:
        first, ordered = 0, []
        for term, own in zip(self, passes, strict=True):
            ordered.append([over.with_switches_from(first) for over in own])
            first += term.switches
        return ordered

    def on_nodes(self, N: Any, Nd: Any, u: Any, load: Any = None, taut: Any = None) -> Any:
        """Return the forces on all nodes, N, shape (d, n).

        Parameters
        ----------
        N, Nd : casadi.SX, shape (d, n)
            Positions, m, and velocities, m/s, of all nodes.
        u : casadi.SX, shape (α, 1)
            Input of the strings.
        load : casadi.SX or DM, shape (d, n), optional
            N.
        taut : casadi.SX, shape (switches, 1), optional
            1 for each switch with a force, 0 for one without; as it is by the gaps if not given.
        """
        arrays = {"p": N, "v": Nd, "u": u.T, "taut": None if taut is None else taut.T}
        forces = type(N)(*N.shape) if load is None else load
        for own in self.passes(switched=taut is not None):
            forces = forces + sum_on_nodes(own, arrays)
        return forces

    def gaps(self, N: Any, Nd: Any, u: Any) -> tuple[Any, Any]:
        """Return the gap of each switch, m, and its rate, m/s, columns; arguments as above."""
        passes = self.gap_passes()
        if not passes:
            return type(N)(0, 1), type(N)(0, 1)
        arrays = {"p": N, "v": Nd, "u": u.T}
        outputs = [over.outputs(arrays) for over in passes]
        gap, rate = (ca.horzcat(*rows) for rows in zip(*outputs, strict=True))
        switch = [range(p.count) if p.writes[0].at is None else p.writes[0].at for p in passes]
        order = np.argsort(np.concatenate(switch))
        if (np.diff(order) == 1).all():
            return gap.T, rate.T
        return gap[:, order.tolist()].T, rate[:, order.tolist()].T
