"""Prestress: force densities in equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import ArrayRecord, FloatArray, IntArray, frozen
from tenscontrol.properties import cached_property
from tenscontrol.statics.equilibrium_matrix import (
    MemberForces,
    is_small,
    least_norm,
    member_forces,
)
from tenscontrol.statics.least_distance import BalancedForces, can_be_positive
from tenscontrol.statics.stability import (
    Stability,
    TangentStiffness,
    stability,
    tangent_stiffness,
)
from tenscontrol.string_bounds import string_bounds
from tenscontrol.structure.bar_clearance import BarCrossing, bar_distances
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import free_coordinates, rigid_basis

if TYPE_CHECKING:
    from scipy.sparse import csc_array

# Singular values below this fraction of the largest count as zero: far above
# round-off, far below what a real member contributes.
_RANK_TOLERANCE = 1e-9

# How far below the largest least force density strings may be, so that there is a choice.
_BELOW = 1e-6

# A linear program of many strings finds bounds that can be kept to this part.
_CLOSE = 1e-7

# Force densities below this fraction of the largest are zero.
_ROUND_OFF = 1e-12

# Entries of γ that a message lists.
_LISTED = 12

# Unbalanced force above this fraction of the largest member force is not round-off.
_RESIDUAL_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Prestress(ArrayRecord):
    """A structure at rest: nodes, force densities and load in balance. Made by :func:`prestress`.

    It can be given wherever its ``force_density``, ``external_force`` or nodes can.

    Attributes
    ----------
    structure : Structure
        The structure; ``structure.nodes`` is the shape at rest.
    force_density : ndarray, shape (α,)
        γ of each string = tension / length, N/m, at least 0.
    bar_force_density : ndarray, shape (β,)
        λ of each bar = compression / length, N/m, positive in compression, negative in tension. Of
        a body with redundant bars, the least λ that balance: they are not unique.
    external_force : ndarray, shape (d, n)
        W, the load on the nodes, N.
    residual : float
        Largest unbalanced force on a node, ``max |N K_s − W|``, N.
    crossings : tuple of BarCrossing
        Of an :func:`equilibrium`: bars that pass through each other on the straight way from the
        shape at its start, by share of the way. Empty where there is none.
    """

    structure: Structure
    force_density: FloatArray
    bar_force_density: FloatArray
    external_force: FloatArray
    residual: float
    crossings: tuple[BarCrossing, ...] = field(default=(), kw_only=True)

    stands_for = MappingProxyType(
        {
            "force_density": "force_density",
            "prestress": "force_density",
            "nodes": "nodes",
            "external_force": "external_force",
            "bar_force_density": "bar_force_density",
        }
    )

    @property
    def nodes(self) -> FloatArray:
        """The shape at rest, m, shape (d, n)."""
        return self.structure.nodes

    @property
    def tension(self) -> FloatArray:
        """Tension of each string, N, shape (α,): γ times its length."""
        return frozen(self.force_density * self.structure.string_length())

    @property
    def bar_force(self) -> FloatArray:
        """Force along each bar, N, shape (β,), positive in compression: λ times its length."""
        return frozen(self.bar_force_density * self.structure.bar_length)

    @property
    def clearance(self) -> float:
        """Least distance between the axes of two bars without a common node, m.

        Infinite where there are none, and in the plane, where bars lie in layers.
        """
        structure = self.structure
        if structure.dimension == 2:
            return np.inf
        return bar_distances(structure, structure.nodes).least

    @property
    def self_stress_states(self) -> int:
        """Number of independent force densities that balance without load."""
        return int(self._forces.live.sum()) - self._forces.rank

    @property
    def mechanisms(self) -> int:
        """Number of independent small motions that change no member length to first order.

        Rigid-body motion is not counted. The time to count them grows with the members, as in flat
        nets and of the segments of strings, or with the square of their number too, where some
        motions change lengths but little.
        """
        structure = self.structure
        rigid = int(rigid_basis(structure).shape[1])
        return len(structure.free_rows) - rigid - self._forces.rank

    @cached_property
    def _forces(self) -> MemberForces:
        load = free_coordinates(self.structure, self.external_force)
        return member_forces(self.structure, load)

    @property
    def slack_strings(self) -> IntArray:
        """Indices of the strings without force, γ = 0."""
        return frozen(np.flatnonzero(self.force_density == 0))

    @property
    def bars_in_tension(self) -> IntArray:
        """Indices of the bars that pull their ends together, λ < 0 beyond round-off."""
        structure = self.structure
        pull = -self.bar_force_density * structure.bar_length
        pushes = np.abs(pull).max(initial=0.0)
        largest = max((self.force_density * structure.string_length()).max(initial=0.0), pushes)
        return frozen(np.flatnonzero(pull > _RESIDUAL_TOLERANCE * largest))

    @cached_property
    def stability(self) -> Stability:
        """Stiffness of the mechanisms by the prestress; see :class:`Stability`."""
        return stability(
            self.structure, self.force_density, self.bar_force_density, self._is_loaded
        )

    @property
    def _is_loaded(self) -> bool:
        return bool(free_coordinates(self.structure, self.external_force).any())

    @property
    def is_stable(self) -> bool:
        """Whether the prestress stiffens every mechanism; see :class:`Stability`.

        Strings must be stiff enough as well: :meth:`tangent_stiffness` says whether given ones are.
        """
        return self.stability.is_stable

    @property
    def is_super_stable(self) -> bool:
        """Whether it is stable at any level of prestress; see :class:`Stability`."""
        return self.stability.is_super_stable

    def tangent_stiffness(self, stiffness: object, count: int | None = None) -> TangentStiffness:
        """Return the stiffness of the structure with strings of this stiffness, rest lengths held.

        It decides whether the structure stays where it is when it is pushed.

        Parameters
        ----------
        stiffness : float or array_like, shape (α,)
            dT/dL of each string, N/m: k of linear strings, EA/l0 of elastic ones. What has no force
            here (γ = 0) is taken as slack, and adds none.
        count : int, optional
            How many eigenvalues, the lowest: of a large structure they take time and memory in
            proportion to its members. All if not given, which takes the cube and the square.

        Returns
        -------
        TangentStiffness

        Raises
        ------
        TypeError, ValueError
            If ``stiffness`` does not fit or is not positive, or ``count`` is below 1.

        Examples
        --------
        The prism is super-stable: any strings do, and stiff ones leave the stiffness of the twist:

        >>> import tenscontrol as tc
        >>> rest = tc.prestress(tc.prism(), force_density=10.0)
        >>> [round(float(rest.tangent_stiffness(k).eigenvalues[0]), 1) for k in (31, 1e2, 1e4)]
        [24.1, 55.9, 56.5]
        """
        k = validation.per_member("stiffness", stiffness, len(self.force_density), "string")
        validation.positive("stiffness", k, "stiffness in N/m")
        if count is not None:
            validation.whole_number("count", count, least=1)
        return tangent_stiffness(
            self.structure, self.force_density, self.bar_force_density, k,
            self._is_loaded, count,
        )  # fmt: skip

    def __repr__(self) -> str:
        items = [repr(self.structure), f"residual {self.residual:.1e} N"]
        if is_small(self._forces.matrix):  # else they take long
            items += [_counted(self.self_stress_states, "self-stress state")]
            items += [_counted(self.mechanisms, "mechanism")]
        if slack := len(self.slack_strings):
            items += [_counted(slack, "slack string")]
        return f"Prestress({', '.join(items)})"


def _counted(count: int, noun: str) -> str:
    """Return a number with its noun, in the plural but for one."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def prestress(
    structure: Structure,
    force_density: object = None,
    reference: str | None = None,
    external_force: object = None,
    *,
    min_force_density: object = None,
    max_force_density: object = None,
) -> Prestress:
    """Return force densities (tension per length) that hold a structure in equilibrium.

    Bars may be in compression or in tension: ``bars_in_tension`` of the result lists the latter.

    Parameters
    ----------
    structure : Structure
    force_density : float or array_like, shape (α,), optional
        Mean force density of the reference strings, or that of each string, N/m. A number: the mean
        γ that the ``reference`` strings get. Where the structure has several states of self-stress,
        the one nearest to a uniform γ of this value is taken; in it, strings may be slack. An
        array: γ of every string; it is checked, and refused when it does not balance.
    reference : str, optional
        Group of strings that a number is for; that of the first string if not given (for
        :func:`prism` the top strings).
    external_force : array_like, shape (d, n), or 0, optional
        Load W on the nodes, N.
    min_force_density : float or array_like, shape (α,), optional
        Least force density γ of each string, N/m: a positive number makes every string taut.
        Without ``force_density``, the result is, of all γ in equilibrium within the bounds, the one
        nearest (least sum of squares) to a uniform γ of the largest entry. With 0 for all it is the
        least γ that carries the load. Strings with both ends fixed get their entry, as they have no
        effect.
    max_force_density : float or array_like, shape (α,), optional
        Largest force density γ of each string, N/m; inf for any. Alone, it is finite: it makes the
        least γ of all strings with a free end as large as can be (but for a part in 1e6), and of
        the γ that do, takes the most uniform one.

    Returns
    -------
    Prestress

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit; if a given γ is negative or does not
        balance (the message says by how much and where); if no γ within the bounds balances (the
        message names the strings that cannot be taut, or the largest level that can be had).
    ArithmeticError
        If a large structure has such γ, and they are not found.

    Notes
    -----
    Equilibrium is ``N K_s = W``, Goyal & Skelton eq. (7) with N̈ = 0. The
    states of self-stress are the null space of the equilibrium matrix
    (Pellegrino & Calladine 1986, doi:10.1016/0020-7683(86)90014-4). Which strings can be taut, and
    how much, is found by linear programs (HiGHS); the nearest γ by least distance programming.

    Examples
    --------
    The prism rests at γ_v = √3 γ_t:

    >>> import tenscontrol as tc
    >>> rest = tc.prestress(tc.prism(), force_density=10.0)
    >>> rest.force_density[[0, 3, 6]].round(4), round(float(rest.bar_force_density[0]), 4)
    (array([10.    , 10.    , 17.3205]), 17.3205)
    >>> rest.self_stress_states, rest.mechanisms, rest.is_stable, rest.is_super_stable
    (1, 1, True, True)

    With every string at 10 N/m at least:

    >>> tc.prestress(tc.prism(), min_force_density=10.0).force_density[[0, 3, 6]].round(4)
    array([10.    , 10.    , 17.3205])
    """
    validation.instance(
        "structure", structure, Structure, "make one by Structure(...) or prism(...)"
    )
    alpha = len(structure.strings)
    is_bounded = min_force_density is not None or max_force_density is not None
    if alpha == 0:
        for name, value in (
            ("force_density", force_density),
            ("min_force_density", min_force_density),
            ("max_force_density", max_force_density),
        ):
            validation.limit_per_member(name, value, alpha, "string")
        force_density, reference, is_bounded = np.zeros(0), None, False
    if force_density is None and not is_bounded:
        raise TypeError(
            "force_density is None, expected a number or an array in N/m, or min_force_density or "
            "max_force_density"
        )
    given = None if force_density is None else validation.vector("force_density", force_density)
    load = np.zeros(structure.nodes.shape)
    if external_force is not None:
        load = validation.node_forces("external_force", external_force, load.shape)
    if reference is not None and (given is None or given.ndim > 0):
        instead = "not with an array" if given is not None else "which is not given"
        raise ValueError(f"reference goes with a single force_density, {instead}")
    if given is not None and given.ndim > 0:
        if is_bounded:
            raise ValueError(
                "force_density gives γ of every string, so that min_force_density and "
                "max_force_density have no effect; leave them out, or give force_density as one "
                "number"
            )
        gamma = validation.shaped("force_density", given, (alpha,), "one per string")
        validation.non_negative("force_density", gamma, "a string can only pull")
        forces = member_forces(structure, free_coordinates(structure, load))
        hint = "prestress(structure, force_density=<one number>) finds force densities that balance"
        try:
            return balanced(structure, forces, gamma, load, "force_density does not balance", hint)
        except UnbalancedError as error:
            raise UnbalancedError(f"{error}{_nearest_balance(structure, forces, gamma)}") from None
    level = (
        None if given is None else validation.positive_number("force_density", float(given), "N/m")
    )
    bounds = string_bounds(alpha, min_force_density, max_force_density, may_be_slack=True)
    low, high = bounds.low, bounds.high
    as_high = level is None and min_force_density is None
    if as_high and not np.isfinite(high).all():
        raise ValueError(
            f"max_force_density[{int(np.isinf(high).argmax())}] is inf, so that there are no "
            "largest force densities; give finite ones, or force_density or min_force_density"
        )
    return _found(structure, load, level, reference, low, high, as_high)


def _found(
    structure: Structure, load: FloatArray, level: float | None, reference: str | None,
    low: FloatArray, high: FloatArray, as_high: bool,
) -> Prestress:  # fmt: skip
    """Return the balanced γ within bounds nearest to uniform, or raise and say why there is none.

    Uniform is ``level``, which is then the mean of the reference strings too, or the highest of the
    lower bounds; these are as high as can be where that is asked for.
    """
    w = free_coordinates(structure, load)
    forces = member_forces(structure, w)
    strings = np.flatnonzero(forces.live[: len(low)])
    gamma, most = low, high
    low, high = low[strings], high[strings]
    count = len(strings)
    if w.any():
        _refuse_unbalanced(
            structure, forces.matrix, forces.particular, w,
            "no member forces balance external_force",
            "In this shape the load moves a mechanism; equilibrium(model, ...) finds the shape "
            "that carries the load",
        )  # fmt: skip
    if count == 0:
        raise ValueError(
            "both ends of every string are fixed, so that strings have no effect on the balance"
        )
    every = BalancedForces.of(forces)
    if as_high:
        least = every.largest_share(np.ones(count), high, None)
        if least <= _ROUND_OFF * high.max():
            raise ValueError(_infeasible(forces, strings, np.ones(count), high, bool(w.any())))
        low = np.full(count, (1 - _BELOW) * least)
        gamma = np.minimum(low[0], most)  # of strings between fixed nodes
    goal = float(low.max(initial=0.0)) if level is None else level
    if goal == 0 and not w.any():
        raise ValueError(
            "min_force_density is 0 for every string with a free end, and without a load the "
            "answer would be γ = 0; give a positive number, or a force_density"
        )
    if level is not None:
        at_level = every.at_level(_reference(structure, strings, reference), level)
        if at_level is None:
            raise ValueError(_infeasible(forces, strings, low, high, bool(w.any())))
        every = at_level
    densities = every.nearest(np.full(count, goal), low, high)
    if densities is None:
        raise ValueError(_infeasible(forces, strings, low, high, bool(w.any()), every, level))
    # What round-off leaves below zero is zero; the residual is checked afterwards.
    on_strings = densities[:count]
    on_strings[on_strings < _ROUND_OFF * np.abs(densities).max()] = 0.0
    if any(block.is_redundant for block in structure.blocks):
        densities[count:] = _least_bars(forces, on_strings, w)
    _refuse_unbalanced(
        structure, forces.matrix, densities, w, "no force_density balances", "Change the shape"
    )
    return _at_rest(structure, forces, gamma, densities, load)


def _reference(structure: Structure, strings: IntArray, reference: str | None) -> IntArray:
    """Return which of some strings are of the reference group."""
    groups = dict.fromkeys(structure.string_groups)
    group = (
        next(iter(groups))
        if reference is None
        else validation.choice("reference", reference, groups)
    )
    chosen = np.flatnonzero(np.isin(strings, structure.strings_in(group)))
    if len(chosen) == 0:
        raise ValueError(
            f"reference is {group!r}, whose strings have both ends fixed, so that they have no "
            "effect on the balance; give a group with a free end as reference"
        )
    return chosen


def balanced(
    structure: Structure, forces: MemberForces, gamma: FloatArray, load: FloatArray,
    failure: str, hint: str, least: float = 0.0,
) -> Prestress:  # fmt: skip
    """Return γ of every string with the bars that balance it best, or raise saying what and hint.

    What is left on a node is judged against the largest force, N, or ``least`` if that is more.
    """
    pulls, E, w = forces.live[: len(gamma)], forces.matrix, free_coordinates(structure, load)
    densities = np.concatenate([gamma[pulls], _least_bars(forces, gamma[pulls], w)])
    _refuse_unbalanced(structure, E, densities, w, failure, hint, least)
    return _at_rest(structure, forces, gamma, densities, load)


def _nearest_balance(structure: Structure, forces: MemberForces, gamma: FloatArray) -> str:
    """Say which γ near given ones balance; nothing of large structures, or if none do."""
    strings = np.flatnonzero(forces.live[: len(gamma)])
    if not (is_small(forces.matrix) and len(strings)):
        return ""
    target, unbounded = gamma[strings], np.full(len(strings), np.inf)
    every = BalancedForces.of(forces)
    first = np.flatnonzero(np.isin(strings, structure.strings_in(structure.string_groups[0])))
    if len(first):  # the first group keeps its mean, where it can
        every = every.at_level(first, float(target[first].mean())) or every
    densities = every.nearest(target, np.zeros(len(strings)), unbounded)
    if densities is None or not densities.any():
        return ""
    missed = np.abs(forces.matrix @ densities - forces.load).max()
    if missed > _RESIDUAL_TOLERANCE * abs(forces.matrix * densities).max():
        return ""
    nearest = gamma.copy()
    nearest[strings] = densities[: len(strings)]
    off, size = np.abs(nearest - gamma), np.abs(nearest).max()
    digits = [f"{entry:.12g}" for entry in np.where(nearest < _ROUND_OFF * size, 0.0, nearest)]
    by_group = {
        group: {digits[i] for i in structure.strings_in(group)}
        for group in dict.fromkeys(structure.string_groups)
    }
    if all(len(entries) == 1 for entries in by_group.values()):
        values = ", ".join(f"{entries.pop()} in {group}" for group, entries in by_group.items())
    else:
        values = ", ".join(digits[:_LISTED]) + ", …" * (len(digits) > _LISTED)
    worst = int(off.argmax())
    return (
        f". The nearest that balance, N/m: {values}; string {worst} is farthest from it, by "
        f"{off[worst]:.2g} N/m"
    )


def _least_bars(forces: MemberForces, gamma: FloatArray, w: FloatArray) -> FloatArray:
    """Return the least λ of movable bars that balance γ of movable strings best."""
    count = len(gamma)
    pushes, load = forces.matrix[:, count:], w - forces.matrix[:, :count] @ gamma
    if not is_small(forces.matrix):
        return least_norm(pushes, load)
    pushes = pushes.toarray()
    length = np.linalg.norm(pushes, axis=0)
    length = length[length > 0]
    ratio = length.min() / length.max() if len(length) else 1.0
    return np.asarray(np.linalg.lstsq(pushes, load, rcond=_RANK_TOLERANCE * ratio)[0])


def _at_rest(
    structure: Structure, forces: MemberForces, gamma: FloatArray, densities: FloatArray,
    load: FloatArray,
) -> Prestress:  # fmt: skip
    """Return the record of force densities of movable members; γ holds those of the others."""
    E, w, alpha = forces.matrix, free_coordinates(structure, load), len(gamma)
    every = np.concatenate([gamma, np.zeros(len(structure.bars))])
    every[forces.live] = densities
    return Prestress(
        structure=structure,
        force_density=frozen(every[:alpha]),
        bar_force_density=frozen(every[alpha:]),
        external_force=frozen(load),
        residual=float(np.abs(E @ densities - w).max(initial=0.0)),
    )


def prism_force_density(
    sides: int, force_density: float, radius: float = 1.0, top_radius: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the force densities of a prism in equilibrium, in the order of :func:`prism`.

    With top radius a and bottom radius b::

        γ_v = λ = 2 sin(π/q) γ_t a/b,    γ_b = γ_t a²/b²

    so that for three bars and equal radii γ_v = √3 γ_t. The height plays no part.

    Parameters
    ----------
    sides : int
        Number q of bars, at least 3.
    force_density : float
        γ_t of the top strings, N/m.
    radius, top_radius : float
        Radii of bottom and top, m; only their ratio matters. Equal if ``top_radius`` is not given.

    Returns
    -------
    strings : ndarray, shape (3q,)
        γ of top, bottom and vertical strings, N/m.
    bars : ndarray, shape (q,)
        λ of the bars, N/m, positive in compression.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite or ``sides`` is below 3.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> strings, bars = tc.statics.prism_force_density(3, 10.0)
    >>> strings[[0, 3, 6]].round(4)
    array([10.    , 10.    , 17.3205])
    """
    q = validation.whole_number("sides", sides, 3, validation.MOST_RUNS)
    top = validation.positive_number("force_density", force_density, "N/m")
    b = validation.positive_number("radius", radius, "m")
    a = b if top_radius is None else validation.positive_number("top_radius", top_radius, "m")
    vertical = 2 * np.sin(np.pi / q) * top * a / b
    bottom = validation.positive_number(
        "force_density (top_radius/radius)²", top * (a / b) ** 2, "N/m"
    )
    return np.repeat([top, bottom, vertical], q), np.full(q, vertical)


def _infeasible(
    forces: MemberForces, strings: IntArray, low: FloatArray, high: FloatArray, loaded: bool,
    at_level: BalancedForces | None = None, level: float | None = None,
) -> str:  # fmt: skip
    """Say why no force densities were found."""
    states, count = forces.matrix.shape[1] - forces.rank, len(strings)
    if states == 0 and not loaded:
        return (
            "the structure has no state of self-stress in this shape: no force densities balance. "
            f"The smallest singular value of its equilibrium matrix is {forces.least:.1e} of the "
            f"largest, against {_RANK_TOLERANCE:.0e} for a state of self-stress; if it is small, "
            "give the nodes with more digits"
        )
    if states == 0:
        gamma = forces.particular[:count]
        i = int((gamma - low).argmin()) if (gamma < low).any() else int((gamma - high).argmax())
        return (
            "the structure has no state of self-stress in this shape, so that external_force "
            f"alone determines the forces: string {strings[i]} would get γ = {gamma[i]:.6g} N/m, "
            f"expected {validation.span(low[i], high[i], 'N/m')}. Change the load, the shape or "
            "the bounds"
        )
    every = BalancedForces.of(forces)
    share = (at_level or every).largest_share(low, high)
    free = (
        None if every.balance is None else replace(every.balance, values=0 * every.balance.values)
    )
    can = can_be_positive(every.directions[:count], np.zeros(count), free)
    stuck = strings[~can & (low > 0)] if can is not None else strings
    subject = "external_force with" if loaded else "the structure with"
    if not loaded and len(stuck):
        return (
            f"strings {listed(stuck)} cannot be taut while no other is in compression: in this "
            "shape no state of self-stress with γ ≥ 0 has them taut. Change the shape or the "
            "strings, or give 0 for them in min_force_density, an array"
        )
    if at_level is not None and at_level.balance is not None and share > 1 - _CLOSE:
        raise ArithmeticError(
            "the quadratic program of the prestress did not converge, although force densities "
            "within the bounds balance, or nearly do; give other bounds or another level"
        )
    unbounded = np.full(count, np.inf)
    wider = (at_level or every).largest_share(low, unbounded)
    if share < 1 and wider >= 1 - _ROUND_OFF:
        asked = "" if level is None else f" for a force_density of {level:g} N/m"
        most = f"; with it, all strings can have {share:.4g} times the least that is asked for"
        return (
            f"max_force_density is too low{asked}: without it, there are force densities that "
            f"balance{most if np.isfinite(share) and low.any() else ''}"
        )
    slack = strings[~can] if can is not None else strings
    which = f" (strings {listed(slack)} cannot be taut)" if len(slack) else ""
    return (
        f"no force densities γ ≥ 0 balance {subject} the reference strings at the wanted level, "
        f"within min_force_density and max_force_density: each of the {states} states of "
        f"self-stress needs a string in compression, or leaves the reference strings slack{which}. "
        "Change the shape, the strings, the reference or the bounds"
    )


def listed(members: IntArray) -> str:
    """Return indices as text, the first ten."""
    more = f" and {len(members) - 10} more" if len(members) > 10 else ""
    return ", ".join(map(str, members[:10].tolist())) + more


class UnbalancedError(ValueError):
    """Force densities leave a node with a force."""


def _refuse_unbalanced(
    structure: Structure, E: csc_array, densities: FloatArray, w: FloatArray,
    failure: str, hint: str, least: float = 0.0,
) -> None:  # fmt: skip
    d, n = structure.nodes.shape
    size = np.sqrt(np.bincount(structure.free_rows // d, (E @ densities - w) ** 2, minlength=n))
    scale = max([least, abs(E * densities).max(), np.abs(w).max(initial=0.0)])
    if size.max() > _RESIDUAL_TOLERANCE * scale:
        worst = int(size.argmax())
        raise UnbalancedError(
            f"{failure}: node {worst} is left with an unbalanced force of "
            f"{size[worst]:.3g} N, expected less than {_RESIDUAL_TOLERANCE * scale:.1e} N. {hint}"
        )
