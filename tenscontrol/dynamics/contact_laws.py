"""Laws of the force of the ground on a node.

Sign convention::

      ^ normal n          depth  p = (h − n·x), positive in the ground
      |   ● node          rate   ṗ = −n·ẋ,      positive while it sinks
    ──┴──────────── n·x = h
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from math import sqrt
from typing import TYPE_CHECKING, Any, final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.docstrings import with_parameters_of
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.dynamics.force import Columns, Force, Pass, Read, Write
from tenscontrol.fields import (
    Field,
    OptionalArray,
    check_fields,
    checked,
    converted,
    optional,
)
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.structure import Structure

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Nodes of quadrature over the root of the depth: exact for forces that are polynomials of it up to
# degree 10, as powers 1, 3/2, 2, … of the depth.
_QUADRATURE = np.polynomial.legendre.leggauss(6)

# Added below roots and quotients, which have derivatives at zero then: m, or m², and m².
_ROOTED, _SHORT = 1e-30, 1e-12


def _at_least_zero(name: str, value: object, unit: str) -> float:
    number = 0.0 if value is None else validation.number(name, value, unit)
    if number < 0:
        raise ValueError(f"{name} is {number:g}, expected at least 0")
    return number


def _normal(name: str, value: object) -> FloatArray:
    dimension = 2 if np.size(validation.float_array(name, value)) == 2 else 3
    return validation.direction(name, value, dimension)


def _height(name: str, value: object) -> float | ca.Function:
    return value if isinstance(value, ca.Function) else validation.number(name, value, "m")


def _touching(name: str, value: object) -> IntArray:
    listed = validation.index_array(name, value)
    return validation.indices(name, listed, validation.LARGEST_WHOLE, "nodes")


@dataclass(frozen=True, eq=False)
class ContactLaw(ABC):
    """Base class of contact laws: normal force and friction of the ground on nodes.

    A law of your own is a frozen dataclass with one formula, :meth:`normal_force`; with a second,
    :meth:`gap`, where its force vanishes elsewhere than at the surface or by Hunt & Crossley's
    damping. In formulas depth and rate are CasADi expressions of one shape: write them with
    operators and functions of CasADi. Friction is that of Coulomb, rounded near rest::

        F_t = −μ F_n v_t / √(|v_t|² + v_s²)

    so that a node at rest under a tangential force F < μ F_n creeps with v_s F/√(μ² F_n² − F²).

    Parameters
    ----------
    stiffness : float
        Stiffness k of the contact, positive; its unit is the law's.
    damping : float
        Damping d of Hunt & Crossley, s/m, at least 0: the force has the factor 1 + d ṗ; None for 0.
    friction : float
        Friction coefficient μ, at least 0; None for 0.
    slip_speed : float
        Sliding speed above which friction is that of Coulomb, m/s: v_s, positive.
    normal : array_like, shape (d,), optional
        Direction away from the ground; upward, the last axis, if not given.
    height : float or casadi.Function
        Height of the ground along its normal, m: h of the plane ``n·x = h``. Or a function of x and
        y (in the plane of x), m, twice differentiable, under an upward normal.
    nodes : array_like of int or of bool, optional
        Nodes that it acts on, or a mask of them; all, if not given. It may act on none.

    Raises
    ------
    TypeError, ValueError
        If a parameter is not finite, or out of its range.

    References
    ----------
    K. H. Hunt, F. R. E. Crossley, *Coefficient of restitution interpreted as damping in
    vibroimpact*, J. Appl. Mech. 42 (1975), 440-445, doi:10.1115/1.3423596.
    """

    stiffness: float
    damping: float = field(default=0.0, metadata=checked(_at_least_zero, "s/m"))
    friction: float = field(default=0.0, metadata=checked(_at_least_zero, "–"))
    slip_speed: float = field(default=0.01, metadata=checked(validation.positive_number, "m/s"))
    normal: OptionalArray = converted(None, optional(_normal))
    height: float | ca.Function = field(default=0.0, metadata=checked(_height))
    nodes: Field[ArrayLike | None, IntArray | None] = converted(None, optional(_touching))

    # Expressions in CasADi: the only statement of the law.

    __repr__ = short_repr

    @abstractmethod
    def normal_force(self, depth: Any, rate: Any) -> Any:
        """Return the force on a node in the ground, N, along the normal.

        Smooth; beyond the border that :meth:`gap` draws it may have any value.

        Parameters
        ----------
        depth, rate : casadi.SX or MX, shape (1, k)
            p, m, and ṗ, m/s.
        """

    def gap(self, depth: Any, rate: Any) -> Any:
        """Return how far a node is from having no force, m, positive where it has; None for never.

        A force that vanishes at the surface, or with 1 + d ṗ where a node is drawn out fast. Above
        the surface a gap must be negative. Switches are sought by secants: it should be smooth
        where it crosses zero, and of the size of the depth.

        Parameters
        ----------
        depth, rate : casadi.SX or MX, shape (1, k)
            p, m, and ṗ, m/s.
        """
        if not self.damping:
            return depth
        # Smooth across both borders, and where a node sinks the depth, whose rate is known.
        factor = ca.fmin(_factor(self, rate), 1)
        return depth * ca.if_else(depth < 0, ca.fmax(factor, _LEAST_FACTOR), factor)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Depths, m, ascending: where the force begins, then where else it is not smooth."""
        return (0.0,)

    def stored_energy(self, depth: Any) -> Any:
        """Return the work that slow sinking takes, J, by quadrature of the force.

        Parameters
        ----------
        depth : casadi.SX or MX, shape (1, k)
            p, m.
        """
        energy: Any = 0
        for foot, end in pairwise((*self.kinks, np.inf)):
            inside = ca.fmin(ca.fmax(depth, foot), end) - foot
            for node, weight in zip(*_QUADRATURE, strict=True):
                fraction = (1 + node) / 2  # of the root of the way from the foot
                pressure = self._pressing(foot + inside * fraction**2, 0 * depth)
                energy += weight * fraction * pressure * inside
        return energy

    def __post_init__(self) -> None:
        check_fields(self)
        for declared in fields(self):
            if "check" not in declared.metadata:
                value = getattr(self, declared.name)
                number = validation.positive_number(declared.name, value, "SI units")
                object.__setattr__(self, declared.name, number)
        if isinstance(self.height, ca.Function):
            _check_height(self.height, self.normal)

    @property
    def is_velocity_dependent(self) -> bool:
        """Whether the force depends on velocities: there is damping or friction."""
        return self.damping > 0 or self.friction > 0

    @property
    def switches(self) -> bool:
        """Whether the force has a border, where it is not smooth."""
        one = ca.SX.sym("one")
        return self.gap(one, one) is not None

    def up(self, dimension: int) -> FloatArray:
        """Return the normal in the plane (2) or in space (3), shape (d,).

        Parameters
        ----------
        dimension : int
            Of the structure.
        """
        return np.eye(dimension)[-1] if self.normal is None else self.normal

    def sinking(self, positions: Any, velocities: Any) -> tuple[Any, Any, Any]:
        """Return depth, rate, and the direction in which depth falls, shape (1, k) and (d, k).

        For a plane the direction is the normal. Above a curved surface the depth is ``(h − z)/√(1 +
        |∇h|²)``, the distance to first order, and the direction −∇p is as long as makes the normal
        force that of the stored energy.

        Parameters
        ----------
        positions, velocities : casadi.SX or MX, shape (d, k)
            Of nodes, m and m/s.
        """
        if isinstance(self.height, ca.Function):
            depth, away = _surface(self.height, positions.shape[0])(positions)
        else:
            normal = ca.DM(self.up(positions.shape[0]))
            depth = self.height - ca.mtimes(normal.T, positions)
            away = ca.repmat(normal, 1, positions.shape[1])
        return depth, -kernel.dots(away, velocities), away

    def force(self, positions: Any, velocities: Any, pressing: Any = None) -> Any:
        """Return the force on nodes, N, shape (d, k).

        Parameters
        ----------
        positions, velocities : casadi.SX or MX, shape (d, k)
            Of nodes, m and m/s.
        pressing : casadi.SX or MX, shape (1, k), optional
            1 for nodes with a force, 0 for those without; by :meth:`gap` if not given.
        """
        depth, rate, away = self.sinking(positions, velocities)
        if pressing is None:
            return self.resultant(self._pressing(depth, rate), away, velocities)
        return self.resultant(pressing * self.normal_force(depth, rate), away, velocities)

    def _pressing(self, depth: Any, rate: Any) -> Any:
        """Return the normal force, none where the gap is not positive."""
        normal_force, gap = self.normal_force(depth, rate), self.gap(depth, rate)
        return normal_force if gap is None else (gap > 0) * normal_force

    def mean_force(self, before: Any, after: Any, h: Any) -> Any:
        """Return the mean force, N, over a way: its work is what the depths store at its ends.

        By quadrature over the way, piece by piece of the law, with the mean velocity: a discrete
        gradient of the stored energy. Damping and friction only take from it.

        Parameters
        ----------
        before, after : casadi.SX or MX, shape (d, k)
            Positions of nodes, m.
        h : casadi.SX or MX
            The time that the way takes, s.
        """
        way = after - before
        velocities = way / h
        starts, ends = (self.sinking(positions, velocities)[0] for positions in (before, after))
        _, _, away = self.sinking((before + after) / 2, velocities)
        rate = (ends - starts) / h
        if isinstance(self.height, ca.Function):
            # Of a curved surface, the depth changes along the way as by no single direction.
            beside = (ends - starts + kernel.dots(away, way)) / (kernel.dots(way, way) + _SHORT)
            away -= kernel.scale_columns(way, beside)
        force: Any = 0
        for foot, end in pairwise((*self.kinks, np.inf)):
            low, high = (ca.fmin(ca.fmax(depth, foot), end) for depth in (starts, ends))
            inside = ca.logic_and(*(ca.logic_and(p > foot, p <= end) for p in (starts, ends)))
            moved = ca.if_else(starts == ends, 1, ends - starts)
            share = ca.if_else(inside, 1, (high - low) / moved)
            first, last = ca.sqrt(low - foot + _ROOTED), ca.sqrt(high - foot + _ROOTED)
            for node, weight in zip(*_QUADRATURE, strict=True):
                root = first + (1 + node) / 2 * (last - first)
                pressure = self._pressing(foot + root**2, rate)
                force += weight * share * root / (first + last) * pressure
        return self.resultant(force, away, velocities)

    def resultant(self, normal_force: Any, away: Any, velocities: Any) -> Any:
        """Return the normal force with its friction, N, shape (d, k).

        Parameters
        ----------
        normal_force : casadi.SX or MX, shape (1, k)
            N.
        away, velocities : casadi.SX or MX, shape (d, k)
            Direction of :meth:`sinking`, and the velocities of the nodes, m/s.
        """
        force = kernel.scale_columns(away, normal_force)
        if not self.friction:
            return force
        across = kernel.dots(away, velocities)
        if isinstance(self.height, ca.Function):
            across = across / kernel.dots(away, away)
        slip = velocities - kernel.scale_columns(away, across)
        speed = ca.sqrt(kernel.dots(slip, slip) + self.slip_speed**2)
        return force - kernel.scale_columns(slip, self.friction * normal_force / speed)


@final
@with_parameters_of(ContactLaw)
@dataclass(frozen=True, eq=False)
class Ground(ContactLaw):
    """Ground of constant stiffness: ``F_n = max(0, k p (1 + d ṗ))`` at depth p, with friction.

    The law of Hunt & Crossley with exponent 1. Without gravity, a point that hits the ground at
    speed v leaves it slower by 2/3 d v², for small d v.

    Parameters
    ----------
    stiffness : float
        Stiffness k of the contact, N/m, positive.

    Raises
    ------
    TypeError, ValueError
        If a parameter is not finite, or out of its range.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> ground = tc.Ground(stiffness=5e3, damping=0.3, friction=0.5)
    >>> model = tc.Model(tc.library.six_bar_ball(), gravity=9.81, ground=ground)
    >>> wall = tc.Ground(stiffness=5e3, normal=[1.0, 0.0, 0.0], height=-2.0)
    >>> model = tc.Model(tc.library.six_bar_ball(), gravity=9.81, ground=[ground, wall])
    """

    __repr__ = short_repr

    def normal_force(self, depth: Any, rate: Any) -> Any:
        """Return k p (1 + d ṗ), N; see :meth:`ContactLaw.normal_force`."""
        return self.stiffness * depth * _factor(self, rate)


@final
@with_parameters_of(ContactLaw)
@dataclass(frozen=True, eq=False)
class HertzGround(ContactLaw):
    """Elastic ground under round nodes: ``F_n = max(0, k p^{3/2} (1 + d ṗ))`` at depth p.

    Parameters
    ----------
    stiffness : float
        Stiffness k of the contact, N/m^1.5, positive: 4/3 E* √R of a sphere of radius R on a
        half-space.

    Raises
    ------
    TypeError, ValueError
        If a parameter is not finite, or out of its range.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> ground = tc.dynamics.HertzGround(stiffness=1e6, friction=0.5)
    >>> model = tc.Model(tc.library.six_bar_ball(), gravity=9.81, ground=ground)
    """

    __repr__ = short_repr

    def normal_force(self, depth: Any, rate: Any) -> Any:
        """Return k p √p (1 + d ṗ), N, odd in p; see :meth:`ContactLaw.normal_force`."""
        # The root has a derivative at zero too.
        root = (depth * depth + _ROOTED) ** 0.25
        return self.stiffness * depth * root * _factor(self, rate)


@final
@with_parameters_of(ContactLaw)
@dataclass(frozen=True, eq=False)
class SmoothGround(ContactLaw):
    """Smooth ground, for predictions: the force of :class:`Ground`, rounded near the surface.

    From ``width`` above the surface to as far below, the depth p is replaced by (p + w)²/4w. The
    factor f = 1 + d ṗ is replaced by ``(f + √(f² + ε²))/(1 + √(1 + ε²))`` with ε = 0.1: it stays
    positive, and is 1 at rest. So no switch is to be located, and the force has continuous
    derivatives, as optimizers need.

    Parameters
    ----------
    stiffness : float
        Stiffness k of the contact, N/m, positive.
    width : float
        Distance w over which the contact force sets in, m, positive.

    Raises
    ------
    TypeError, ValueError
        If a parameter is not finite, or out of its range.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> ground = tc.dynamics.SmoothGround(stiffness=1e3, friction=0.5, slip_speed=0.05, width=0.01)
    >>> model = tc.Model(tc.library.six_bar_ball(), gravity=9.81, ground=ground)
    """

    width: float = 0.01

    __repr__ = short_repr

    def normal_force(self, depth: Any, rate: Any) -> Any:
        """Return the force, N; see :meth:`ContactLaw.normal_force`."""
        near = ca.fmin(ca.fmax(depth + self.width, 0), 2 * self.width)
        rounded = near**2 / (4 * self.width) + ca.fmax(depth - self.width, 0)
        factor = _factor(self, rate)
        if self.damping:
            factor = (factor + ca.sqrt(factor**2 + _ROUNDED**2)) / (1 + sqrt(1 + _ROUNDED**2))
        return self.stiffness * rounded * factor

    def gap(self, depth: Any, rate: Any) -> None:
        """Return None: the force is smooth everywhere; see :meth:`ContactLaw.gap`."""

    @property
    def kinks(self) -> tuple[float, ...]:
        """The ends of the rounded foot, m; see :attr:`ContactLaw.kinks`."""
        return (-self.width, self.width)


# The least factor by which a gap above the surface is less than the height.
_LEAST_FACTOR = 0.1

# Part of the factor 1 + d ṗ by which it is rounded where it would vanish.
_ROUNDED = 0.1


def _factor(law: ContactLaw, rate: Any) -> Any:
    """Return 1 + d ṗ, without an instruction where there is no damping."""
    return 1 + law.damping * rate if law.damping else 1


def _check_height(height: ca.Function, normal: FloatArray | None) -> None:
    inputs = [height.sparsity_in(i).shape for i in range(height.n_in())]
    one = [(1, 1)]
    if inputs not in (one, 2 * one) or height.n_out() != 1 or height.size_out(0) != (1, 1):
        raise ValueError(
            f"height is {height}, expected a function of the numbers x and y, in the plane of x, "
            "with one number as its value: casadi.Function('height', [x, y], [h])"
        )
    if normal is not None and (normal[:-1].any() or normal[-1] < 0):
        raise ValueError(
            f"normal is {normal}, expected None where height is a function, which is measured "
            "along the last axis"
        )


def _surface(height: ca.Function, dimension: int) -> ca.Function:
    """Return ``(x) -> (p, −∇p)`` of one node."""
    x = ca.SX.sym("x", dimension)
    across = ca.vertsplit(x)[:-1]
    h = height(*across)
    slopes = [ca.jacobian(h, coordinate) for coordinate in across]
    depth = (h - x[-1]) / ca.sqrt(1 + sum(slope**2 for slope in slopes))
    return Function("surface", [x], [depth, -ca.gradient(depth, x)])


def checked_grounds(ground: object, structure: Structure) -> tuple[ContactLaw, ...]:
    """Return the contact laws that a model is given, one or several, after checking that they fit.

    Parameters
    ----------
    ground : ContactLaw or sequence of ContactLaw, or None
    structure : Structure
    """
    if ground is None:
        return ()
    several = ground if isinstance(ground, Sequence) else (ground,)
    dimension, count = structure.nodes.shape
    for i, law in enumerate(several):
        called = "ground" if several is not ground else f"ground[{i}]"
        if not isinstance(law, ContactLaw):
            raise validation.wrong_kind(
                called, law, "a contact law, as Ground(stiffness=...), or several"
            )
        if law.normal is not None and len(law.normal) != dimension:
            raise ValueError(
                f"{called}.normal has {len(law.normal)} entries, expected {dimension}: the "
                f"structure has nodes of shape {structure.nodes.shape}"
            )
        if isinstance(law.height, ca.Function) and law.height.n_in() != dimension - 1:
            raise ValueError(
                f"{called}.height is a function of {law.height.n_in()} numbers, expected "
                f"{dimension - 1}: the structure has nodes of shape {structure.nodes.shape}"
            )
        if law.nodes is not None:
            validation.indices(f"{called}.nodes", np.asarray(law.nodes, float), count, "nodes")
    return tuple(several)


@dataclass(frozen=True, eq=False)
class Contacts(Force):
    """The nodes that can touch the ground, by contact law, and their switches.

    Attributes
    ----------
    laws : tuple of ContactLaw
    nodes : tuple of ndarray of int
        For each law.
    switch : tuple of slice or None
        For each law, where its nodes stand among the switches of contacts; None where the force
        is smooth.
    """

    argument = "ground"
    is_recorded = True

    laws: tuple[ContactLaw, ...]
    nodes: tuple[IntArray, ...]
    switch: tuple[slice | None, ...]

    __repr__ = short_repr

    @classmethod
    def of_argument(cls, structure: Structure, ground: object) -> Contacts | None:
        """Return the contacts of what is not fixed; None without ground.

        Parameters
        ----------
        structure : Structure
        ground : ContactLaw or sequence of ContactLaw, or None
        """
        laws = checked_grounds(ground, structure)
        if not laws:
            return None
        nodes, switch, count = [], [], 0
        for law in laws:
            some = structure.free
            if law.nodes is not None:
                some = np.intersect1d(some, law.nodes)
            nodes.append(frozen(some))
            switches = law.switches
            switch.append(slice(count, count + len(some)) if switches else None)
            count += len(some) * switches
        return cls(laws, tuple(nodes), tuple(switch))

    def __iter__(self) -> Any:
        return iter(zip(self.laws, self.nodes, self.switch, strict=True))

    @property
    def switches(self) -> int:
        """Number of switches."""
        return max((switch.stop for switch in self.switch if switch is not None), default=0)

    @property
    def is_velocity_dependent(self) -> bool:
        """Whether a force depends on velocities."""
        return any(law.is_velocity_dependent and len(nodes) for law, nodes, _ in self)

    def passes(self, switched: bool) -> list[Pass]:
        """See :meth:`Force.passes`."""
        passes = []
        for i, (law, nodes, switch) in enumerate(self):
            if len(nodes):

                def push(columns: Columns, law: ContactLaw = law) -> tuple[Any, ...]:
                    return (law.force(columns["p"], columns["v"], columns.get("taut")),)

                reads = {"p": Read("p", nodes), "v": Read("v", nodes)}
                if switched and switch is not None:
                    reads["taut"] = Read("taut", np.arange(switch.start, switch.stop))
                on = (Write("f", 0, nodes),)
                passes.append(Pass(f"ground_{i}", len(nodes), push, reads, on, {}))
        return passes

    def gap_passes(self) -> list[Pass]:
        """See :meth:`Force.gap_passes`."""
        passes = []
        for i, (law, nodes, switch) in enumerate(self):
            if len(nodes) and switch is not None:

                def gap(columns: Columns, law: ContactLaw = law) -> tuple[Any, ...]:
                    depth, rate, _ = law.sinking(columns["p"], columns["v"])
                    return law.gap(depth, rate), rate

                reads = {"p": Read("p", nodes), "v": Read("v", nodes)}
                rows = np.arange(switch.start, switch.stop)
                writes = (Write("gap", 0, rows), Write("rate", 1, rows))
                passes.append(Pass(f"ground_gaps_{i}", len(nodes), gap, reads, writes, {}))
        return passes

    def mean_force(self, before: Any, after: Any, u: Any, h: Any) -> Any:
        """Return the mean forces on all nodes over a step; see :meth:`Force.mean_force`."""
        forces = type(before)(*before.shape)
        for law, nodes, _ in self:
            columns = nodes.tolist()
            forces[:, columns] = forces[:, columns] + law.mean_force(
                before[:, columns], after[:, columns], h
            )
        return forces

    def stored_energy(self, N: Any, u: Any = None) -> Any:
        """Return what the ground stores under nodes, J; see :meth:`Force.stored_energy`."""
        energy = type(N)(1, 1)
        for law, nodes, _ in self:
            positions = N[:, nodes.tolist()]
            energy += ca.sum2(law.stored_energy(law.sinking(positions, 0 * positions)[0]))
        return energy
