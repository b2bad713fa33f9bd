"""The state equation as integrators see it: smooth between the switches of strings."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca

from tenscontrol.dynamics.evaluator import Prepared, builds
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray

#: How the functions of an equation can be built.
FORMS = ("flat", "mapped", "loops")


@dataclass(frozen=True, eq=False)
class Equation:
    """A state equation ``ẋ = f(x, u)`` that is smooth while no string goes slack or taut.

    Strings whose rest length is held pull or are slack; ``taut`` says which, 1
    or 0 for each, and is an input of its own so that a step never crosses the
    switching surface between the two. Where no string can go slack (force densities are
    held), ``taut`` has no entries. Made by :meth:`Model.equation`.

    Attributes
    ----------
    slope : casadi.Function
        ``(x, u, taut) -> xdot``, dense columns.
    gap : casadi.Function
        ``(x, u) -> (gap, gap_rate)``: how far each string is from slack, m,
        positive where it pulls, and how fast the stretch grows, m/s.
    force : casadi.Function or None
        ``(q, v, u, taut) -> F``: forces along the free coordinates from positions and
        velocities, N, node by node. None for an equation that is no structure's.
    velocity_dependent : bool
        Whether the force depends on the velocities: some string is damped.
    structure : Structure or None
    law : StringLaw or None
        The law of the strings where rest lengths are held; None where γ is.
    load : ndarray, shape (d, n), or None
        Constant force on every node, N; None for none.
    form : {"flat", "mapped", "loops"}
        How the functions are built: one expression of all members (SX);
        operations on all members at once (MX); loops over the members in C.
    prepared : Prepared
        What integrators have built for this equation, for every later call; not for users.
    """

    slope: ca.Function
    gap: ca.Function
    force: ca.Function | None = None
    velocity_dependent: bool = False
    structure: Structure | None = None
    law: StringLaw | None = None
    load: FloatArray | None = None
    form: str = "flat"
    prepared: Prepared = field(default_factory=Prepared, init=False, repr=False)

    @property
    def symbol(self) -> Any:
        """``casadi.SX.sym`` or ``casadi.MX.sym``: for graphs that call the functions."""
        return ca.SX.sym if self.form == "flat" else ca.MX.sym

    def symbols(self, kind: Any = None) -> tuple[Any, Any, Any, Any]:
        """Return fresh symbols for x, u, taut and a step h, for functions of one step.

        Parameters
        ----------
        kind : type, optional
            ``casadi.SX`` or ``casadi.MX``; what :attr:`symbol` makes if not given.
        """
        make = self.symbol if kind is None else kind.sym
        sizes = {"x": self.states, "u": self.inputs, "taut": self.switches, "h": 1}
        x, u, taut, h = (make(name, size) for name, size in sizes.items())
        return x, u, taut, h

    @cached_property
    def states(self) -> int:
        """Number of entries of x."""
        return int(self.slope.size1_in(0))

    @cached_property
    def inputs(self) -> int:
        """Number of entries of u."""
        return int(self.slope.size1_in(1))

    @cached_property
    def switches(self) -> int:
        """Number of strings that can go slack: entries of ``taut``."""
        return int(self.slope.size1_in(2))

    @property
    def kinked_slope(self) -> ca.Function:
        """``(x, u) -> xdot``: the whole equation, not smooth where strings switch."""
        return self.prepared.get("kinked_slope", self._kinked_slope)

    def _kinked_slope(self) -> ca.Function:
        x, u = self.symbol("x", self.states), self.symbol("u", self.inputs)
        return ca.Function("kinked", [x, u], [self.slope(x, u, self.gap(x, u)[0] > 0)])


@builds
def smooth_equation(slope: ca.Function) -> Equation:
    """Return the equation of a smooth ``(x, u) -> xdot``, dense columns, without a structure."""
    x, u = (ca.SX.sym(name, slope.size1_in(i)) for i, name in enumerate("xu"))
    taut, none = ca.SX.sym("taut", 0), ca.SX(0, 1)
    return Equation(
        slope=ca.Function("slope", [x, u, taut], [slope(x, u)]),
        gap=ca.Function("gap", [x, u], [none, none]),
    )
