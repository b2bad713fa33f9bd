"""Equilibrium shapes that meet demands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.coordinates import coordinates
from tenscontrol.dynamics.model import Model
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.reference import STRINGS_MOVE_NO_CENTRE
from tenscontrol.shape.demands import Demand, NodesAt, centre_kept, checked_demands
from tenscontrol.shape.force_bounds import ForceLimits, checked_limits, refuse_ground
from tenscontrol.shape.held_strings import HeldStrings, shape_drives
from tenscontrol.shape.shape_search import MET, STIFF, Solved, solve_shape
from tenscontrol.shape.symmetry import RotationalSymmetry
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.bar_clearance import bar_distances
from tenscontrol.structure.bar_geometry import bar_lengths, restore_bar_lengths
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import refuse_load_without_support, refuse_moved_supports

CHOICES = ("centred", "least")

_KEEPING = ", in which the passive strings of plant are taut at what they keep"
PLACES = ("anywhere", "centre")

# A shape that differs from the start by less than this part of its way is the same elsewhere; ways
# below the second part of the size are none.
_UNCHANGED, _STAYED = 1e-3, 1e-6

# Lengths of bars that differ by less than this part are the same.
_SAME_LENGTH = 1e-9


@dataclass(frozen=True, eq=False)
class DemandCheck:
    """A demanded number, and the number of the shape found.

    Attributes
    ----------
    name : str
        ``"height"``, ``"x[0]"``, ``"rest_length[4]"`` and the like.
    low, high : float
        The demand, in ``unit``; the same number twice if it is exact.
    found : float
        What the shape has, in ``unit``.
    missed : float
        By how much the shape is outside, in ``unit``; 0 if it is not.
    unit : str
        ``"m"``, ``"rad"`` or ``"N/m"``.
    """

    name: str
    low: float
    high: float
    found: float
    missed: float
    unit: str

    def __str__(self) -> str:
        wanted = f"{self.low:.6g}"
        if np.isposinf(self.high):
            wanted = f"at least {wanted}"
        elif self.low != self.high:
            wanted += f" to {self.high:.6g}"
        return (
            f"{self.name} is {self.found:.6g} {self.unit}, wanted {wanted} {self.unit}, "
            f"missed by {self.missed:.3g} {self.unit}"
        )


@dataclass(frozen=True, eq=False)
class ShapeTarget:
    """A shape in equilibrium. Made by :func:`shape_target`.

    Attributes
    ----------
    model : Model
    prestress : Prestress
        The structure in this shape with its forces: what :func:`linearize` takes.
    nodes : ndarray, shape (d, n)
        m.
    force_density : ndarray, shape (α,)
        γ, N/m.
    rest_length : ndarray, shape (α,), or None
        m, just the length where γ = 0; None without a string law.
    bar_length : ndarray, shape (β,)
        m; those of the structure but for bars that are driven.
    residual : float
        Largest unbalanced force on a node, N.
    bar_length_error : float
        Largest departure of a bar that is not driven from its length, relative.
    stability_margin : float
        Smallest eigenvalue of the stiffness, N/m: with rest lengths held if the
        model has a string law; else with strings rigid, of what the prestress
        adds on the mechanisms (infinite if there are none).
    clearance : float
        Smallest distance between the axes of two bars that share no node, m.
    demands : tuple of DemandCheck
        One for each demanded number.
    """

    model: Model
    prestress: Prestress
    nodes: FloatArray
    force_density: FloatArray
    rest_length: FloatArray | None
    bar_length: FloatArray
    residual: float
    bar_length_error: float
    stability_margin: float
    clearance: float
    demands: tuple[DemandCheck, ...]

    @property
    def is_stable(self) -> bool:
        """Whether the equilibrium is stable: positive stiffness in every direction."""
        return self.stability_margin > STIFF * float(self.force_density.max(initial=0.0))

    @property
    def missed(self) -> tuple[DemandCheck, ...]:
        """The demands that are not met; none unless the shape is the nearest one."""
        return tuple(check for check in self.demands if check.missed > 0)

    def __repr__(self) -> str:
        return (
            f"ShapeTarget({self.prestress.structure!r}, residual {self.residual:.1e} N, "
            f"margin {self.stability_margin:.3g} N/m, {len(self.missed)} of "
            f"{len(self.demands)} demands missed)"
        )


class ShapeError(ValueError):
    """No equilibrium shape was found that meets the demands.

    Attributes
    ----------
    nearest : ShapeTarget or None
        The equilibrium found that misses them least in the sense of least squares (lengths in units
        of the size of the structure, angles in rad); None if no equilibrium was found at all.
    """

    def __init__(self, message: str, nearest: ShapeTarget | None) -> None:
        super().__init__(message)
        self.nearest = nearest


def shape_target(
    model: Model | Structure,
    demands: Demand | Sequence[Demand] = (),
    *,
    force_density: float | None = None,
    reference: str | None = None,
    prestress: str = "centred",
    min_force_density: object = 0.0,
    max_force_density: object = None,
    winches: Winches | None = None,
    min_clearance: float | None = None,
    symmetry: RotationalSymmetry | None = None,
    start: object = None,
    place: str = "anywhere",
    require_stable: bool = True,
    plant: LinearPlant | None = None,
    struts: LinearPlant | None = None,
    drives: Winches | None = None,
) -> ShapeTarget:
    """Return an equilibrium shape that meets given demands, and its force densities.

    Of the shapes that meet them, it is the one nearest to ``start`` (least sum of squares of the
    node displacements). Weights and the constant load of the model act. Members have no thickness:
    ``min_clearance`` sets the least distance between bars. Each string keeps at least a hundredth
    of its length in ``start``.

    Parameters
    ----------
    model : Model or Structure
    demands : Demand or sequence of Demand
        :class:`NodesAt`, :class:`PointAt`, :class:`Height`, :class:`Twist`.
    force_density : float, optional
        Level of the prestress: mean γ of the ``reference`` strings, N/m. If not
        given, the forces count beside the distance from ``start``: small ones for
        "least", the middle of the bounds for "centred".
    reference : str, optional
        String group of ``force_density``; the group of the first string if not given.
    prestress : {"centred", "least"}
        Where several γ balance in the shape: the ones farthest from the bounds
        (their analytic centre), or those of least square sum.
    min_force_density, max_force_density : float or array_like, shape (α,), optional
        Bounds of γ, N/m; at least 0.
    winches : Winches, optional
        Their ``shortest`` and ``longest`` bound the rest lengths.
    min_clearance : float, optional
        Least distance between the axes of two bars, m. Bars that pass one another in
        ``start`` stay on their side. Not in the plane, where bars lie in layers.
    symmetry : RotationalSymmetry, optional
        Only shapes that have it.
    start : array_like, shape (d, n), optional
        Where the search starts, m; the reference shape if not given.
    place : {"anywhere", "centre"}
        Where a structure may be that supports leave free to move as one body. ``"centre"``: where
        its strings alone bring it from rest in ``start``. The centre of mass stays there, and the
        way from ``start`` has no part that turns the whole, so that nodes are found at places in
        space. A structure that supports hold is in space already.
    require_stable : bool
        Whether a shape that buckles is refused.
    plant : LinearPlant, optional
        Of this model, made with ``actuated``: its passive strings keep their rest lengths, or force
        densities, and stay taut; strings that share a winch move by their ratios. All strings are
        driven if not given. With ``input="bar_length"``, lengths of the bars that it drives are
        found, all strings keep their rest lengths, which settles the forces, and ``winches`` bound
        lengths of bars.
    struts : LinearPlant, optional
        Of this model, with ``input="bar_length"``: lengths of the bars that it drives are found
        beside rest lengths of the strings that ``plant`` drives. Not with a plant of both.
    drives : Winches, optional
        Of the bars driven beside strings: ``shortest`` and ``longest`` bound their lengths.

    Returns
    -------
    ShapeTarget

    Raises
    ------
    ShapeError
        If no such equilibrium is found near ``start``. Its text says by how much each demand is
        missed, and which bar has another length than the places of its ends ask for; its
        ``nearest`` is the nearest equilibrium found. Also if the demands ask a free
        structure only to move as one body, in the same shape, or to do so by more than its size.
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Notes
    -----
    Equilibrium is ``N K_s = W`` (Goyal & Skelton, eq. 7 at rest) with exact bar
    lengths, solved by IPOPT with exact derivatives from CasADi in positions, γ
    and λ, then by Newton steps to round-off. The search is local: another start
    may lead to another shape, and to one that is nearer.

    Examples
    --------
    A lower prism. Its closed form is a radius of 0.5695 m and the same γ:

    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
    >>> low = tc.Height(0.85, top=[0, 1, 2], bottom=[3, 4, 5])
    >>> target = tc.shape_target(model, low, force_density=10.0)
    >>> target.force_density[[0, 6]].round(4), target.rest_length[[0, 6]].round(4)
    (array([10.    , 17.3205]), array([0.8878, 0.7438]))
    >>> bool(abs((target.nodes[:2]**2).sum(axis=0)**0.5 - 0.56952).max() < 1e-5)
    True
    """
    if isinstance(model, Structure):
        model = Model(model)
    validation.instance("model", model, Model, "make one by Model(structure)")
    refuse_ground(model)
    validation.choice("prestress", prestress, CHOICES)
    validation.choice("place", place, PLACES)
    validation.truth("require_stable", require_stable, "whether a shape that buckles is refused")
    structure = model.structure
    wanted = checked_demands("demands", demands, structure)
    if symmetry is not None:
        how = "make one by RotationalSymmetry(cycles)"
        validation.instance("symmetry", symmetry, RotationalSymmetry, how)
    held, winches, drives = shape_drives(model, plant, struts, winches, drives)
    limits = checked_limits(
        model,
        force_density,
        reference,
        min_force_density,
        max_force_density,
        winches,
        prestress,
        min_clearance,
        held,
        drives,
    )
    begin = structure.nodes if start is None else structure.checked_nodes("start", start)
    refuse_moved_supports("start", structure, begin)
    if held is None or held.struts is None:
        begin = restore_bar_lengths(structure, begin)
    refuse_load_without_support(structure, model.constant_force)
    asked = wanted + (centre_kept(structure, begin) if place == "centre" else ())
    solved = solve_shape(model, asked, limits, prestress, symmetry, begin, held)
    if solved is None:
        level = f", {limits.level:g} N/m in the reference strings" if limits.level else ""
        raise ShapeError(
            "no equilibrium found near start with the bar lengths of the structure and γ of at "
            f"least min_force_density{level}{_KEEPING if held else ''}. Start from another shape, "
            "or lower min_force_density",
            None,
        )
    target = _target(model, asked, limits, solved, held)
    if target.missed:
        misses = "; ".join(str(check) for check in target.missed)
        why = f" {STRINGS_MOVE_NO_CENTRE}." if len(asked) > len(wanted) else ""
        apart = _bar_apart(structure, wanted, held)
        other = "Give another place" if apart else "Try another start"
        raise ShapeError(
            f"no equilibrium found near start that meets the demands{apart}. The nearest one "
            f"found, .nearest, misses {len(target.missed)} of {len(target.demands)}: {misses}."
            f"{why} {other}, larger tolerances, wider bounds or more strings",
            target,
        )
    gone, changed = _travel(model, begin, target.nodes)
    if wanted and gone - changed > structure.size:
        raise ShapeError(
            f"the demands are met by a rigid-body motion of more than the size of the structure, "
            f"{structure.size:.3g} m: nodes go up to {gone:.3g} m, of which the shape found, "
            f".nearest, gives {changed:.3g} m. {STRINGS_MOVE_NO_CENTRE}. To put the structure "
            "there by hand, move the nodes of start",
            target,
        )
    if wanted and _is_rigid(begin, gone, changed):
        raise ShapeError(
            f"the demands are met by a rigid-body motion only: the shape found is that of "
            f"start, moved by up to {gone:.3g} m. {STRINGS_MOVE_NO_CENTRE}. To put the structure "
            "there by hand, move the nodes of start",
            target,
        )
    if require_stable and not target.is_stable:
        slack = np.flatnonzero(target.force_density == 0)
        why = f" with strings {slack.tolist()} slack" if len(slack) else ""
        raise ShapeError(
            f"the equilibrium found{why} is unstable: its stability margin is "
            f"{target.stability_margin:.3g} N/m, expected more than 0. Ask for a higher "
            "min_force_density, start from another shape, or accept it by require_stable=False",
            target,
        )
    return target


def _bar_apart(structure: Structure, demands: Sequence[Demand], held: HeldStrings | None) -> str:
    """Say which bar is too long or too short for the places that supports and demands give it.

    Empty if none is. Coordinates that are not given may be any.
    """
    d, n = structure.nodes.shape
    place, off = np.full((d, n), np.nan), np.zeros((d, n))
    for demand in demands:
        if isinstance(demand, NodesAt):
            rows = ["xyz".index(axis) for axis in demand.directions]
            at = np.array(rows)[:, None], demand.nodes
            place[at], off[at] = demand.positions, demand.tolerance
    at = structure.fixed_rows % d, structure.fixed_rows // d
    place[at], off[at] = structure.nodes[at], 0.0
    driven = () if held is None else held.driven_bars
    for i, (start, end) in enumerate(structure.bars.tolist()):
        way, length = place[:, end] - place[:, start], float(structure.bar_length[i])
        apart = float(np.linalg.norm(np.nan_to_num(way)))
        room = float(np.linalg.norm(off[:, end] + off[:, start])) + MET * structure.size
        is_far = apart > length + room
        is_near = apart < length - room and not np.isnan(way).any()
        if (is_far or is_near) and i not in driven:
            least = "at least " if np.isnan(way).any() else ""
            moved, other = (start, end) if end in structure.fixed else (end, start)
            return (
                f": node {moved} would be {least}{apart:.6g} m from node {other}; the bar between "
                f"them has {length:.6g} m"
            )
    return ""


def with_lengths_of(model: Model, nodes: FloatArray) -> Model:
    """Return a model whose bars have the lengths that they have in a shape."""
    length = bar_lengths(model.structure, nodes)
    if np.allclose(length, model.structure.bar_length, rtol=_SAME_LENGTH, atol=0):
        return model
    return model.replace(structure=replace(model.structure, nodes=nodes))


def moved_as_one_body(model: Model, before: FloatArray, after: FloatArray) -> float:
    """Return how far nodes move, m, where two shapes differ by a rigid-body motion alone; or 0."""
    gone, changed = _travel(model, before, after)
    return gone if _is_rigid(before, gone, changed) else 0.0


def _is_rigid(before: FloatArray, gone: float, changed: float) -> bool:
    size = float(np.ptp(before, axis=1).max())
    return gone > _STAYED * size and changed < _UNCHANGED * gone


def _travel(model: Model, before: FloatArray, after: FloatArray) -> tuple[float, float]:
    """Return how far a node goes at most, m, and how far where the shapes are laid over."""
    frame = coordinates(with_lengths_of(model, before), before, "nodes")
    laid = frame.laid_over(after, np.zeros_like(after))[0]
    gone, changed = (float(np.linalg.norm(nodes - before, axis=0).max()) for nodes in (after, laid))
    return gone, changed


def _target(
    model: Model,
    demands: tuple[Demand, ...],
    limits: ForceLimits,
    solved: Solved,
    held: HeldStrings | None,
) -> ShapeTarget:
    structure, rest = model.structure, solved.rest
    nodes, gamma = rest.structure.nodes, rest.force_density
    length = bar_lengths(structure, nodes)
    off = np.abs(length / structure.bar_length - 1)
    if held is not None:
        off[held.driven_bars] = 0.0
    return ShapeTarget(
        model=model,
        prestress=rest,
        nodes=nodes,
        force_density=gamma,
        rest_length=None if solved.rest_length is None else frozen(solved.rest_length),
        bar_length=frozen(length),
        residual=rest.residual,
        bar_length_error=float(off.max(initial=0.0)),
        stability_margin=solved.margin,
        clearance=bar_distances(structure, nodes).least,
        demands=tuple(_checks(demands, limits, solved)),
    )


def _checks(demands: tuple[Demand, ...], limits: ForceLimits, solved: Solved) -> list[DemandCheck]:
    rows = []
    row = 0
    for demand in demands:
        for name, number in zip(demand.names, demand.wanted.tolist(), strict=True):
            off, scale = float(solved.misses[row]), float(solved.scales[row])
            low, high = number - demand.tolerance, number + demand.tolerance
            over = _outside(off, -demand.tolerance, demand.tolerance, scale)
            rows.append(DemandCheck(name, low, high, number + off, over, demand.unit))
            row += 1
    gamma = solved.rest.force_density
    lengths = solved.rest.structure.bar_length
    for name, unit, values, low_, high_ in limits.bounded(gamma, solved.rest_length, lengths):
        scale = limits.scale if unit == "N/m" else float(solved.scales.max(initial=1.0))
        for i, value in enumerate(values.tolist()):
            least, most = float(low_[i]), float(high_[i])
            over = _outside(value, least, most, scale)
            rows.append(DemandCheck(f"{name}[{i}]", least, most, value, over, unit))
    if limits.clearance:
        least = bar_distances(solved.rest.structure, solved.rest.structure.nodes).least
        size = solved.rest.structure.size
        over = _outside(least, limits.clearance, np.inf, size)
        rows.append(DemandCheck("clearance", limits.clearance, np.inf, least, over, "m"))
    return rows


def _outside(value: float, low: float, high: float, scale: float) -> float:
    """Return by how much a value is outside of bounds; round-off is not."""
    over = max(low - value, value - high, 0.0)
    return over if over > MET * scale else 0.0
