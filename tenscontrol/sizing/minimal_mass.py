"""Cross sections of least mass that carry given loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.sizing.area_program import AreaProgram
from tenscontrol.sizing.branch_and_bound import search
from tenscontrol.sizing.common_prestress import Wound, wound_once
from tenscontrol.sizing.materials import Material
from tenscontrol.sizing.member_groups import area_of_member
from tenscontrol.sizing.sections import Sections, with_areas
from tenscontrol.statics.equilibrium_matrix import movable_members, sparse_equilibrium_matrix
from tenscontrol.structure.structure import Structure
from tenscontrol.tables import aligned

# Forces that are left over in the program without a solution, part of the largest load.
_UNBALANCED = 1e-7

# Starts of designs with one prestress.
_MOST_WOUND = 4

# Starts times members by default, and members above which one start is enough: a program takes
# seconds.
_WORK, _LARGE = 3_000, 3_000

# Masses of restarts that agree to this part are the same.
_AGREE = 1e-6


@dataclass(frozen=True)
class Tube:
    """Round tubes of one ratio of radii, as bars of a :func:`design`.

    Parameters
    ----------
    ratio : float
        Inner over outer radius, at least 0 and below 1.
    wall_factor : float, optional
        Part that is left of the load at which a perfect thin wall buckles, 0.3 to 0.6 for walls
        as they are made: the stress is limited to ``0.605 · wall_factor · E t / r``, r the mean
        radius.
    least_wall : float, optional
        Least thickness of the wall t, m.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """

    ratio: float
    wall_factor: float = 0.5
    least_wall: float = 0.0

    def __post_init__(self) -> None:
        ratio = validation.number("ratio", self.ratio, "inner over outer radius")
        if not 0 <= ratio < 1:
            raise ValueError(f"ratio is {ratio:g}, expected at least 0 and below 1")
        validation.positive_number("wall_factor", self.wall_factor, "part of the perfect wall's")
        if validation.number("least_wall", self.least_wall, "m") < 0:
            raise ValueError(f"least_wall is {self.least_wall:g} m, expected at least 0")

    @property
    def inertia_ratio(self) -> float:
        """``4π I / A²``: 1 of a solid bar."""
        return (1 + self.ratio**2) / (1 - self.ratio**2)

    def stress(self, material: Material) -> float:
        """Return the stress that the wall bears in compression, Pa.

        Parameters
        ----------
        material : Material
        """
        slenderness = 2 * (1 - self.ratio) / (1 + self.ratio)  # t over the mean radius
        wall = 0.605 * self.wall_factor * material.modulus * slenderness
        return min(material.yield_stress, wall)


@dataclass(frozen=True, eq=False, repr=False)
class Design(Sections):
    """Sections of least mass that carry loads. Made by :func:`design`.

    Attributes
    ----------
    structure, bars, strings, bar_area, string_area, bar_inertia, bar_stress :
        As of :class:`Sections`.
    force_density : ndarray, shape (K, α)
        γ of each string under each load, N/m.
    bar_force_density : ndarray, shape (K, β)
        λ of each bar under each load, N/m, positive in compression.
    string_limit, bar_limit : tuple of str
        What gives each member its area: "yield", "buckling" or "least"; "stiffness" where a common
        prestress asks for more than limits do.
    string_load, bar_load : ndarray of int, shape (α,), (β,)
        The load that does; -1 for the common prestress without load.
    string_sized_by, bar_sized_by : ndarray of int, shape (α,), (β,)
        The member whose force does: each itself, or another one of its group.
    restarts : ndarray, shape (r,)
        The masses that were found from starts, kg. The first is from the forces of yield alone. The
        mass is the least of them.
    bound : float
        Mass that no sections of this shape are below, kg, whatever the forces.
    prestress, bar_prestress : ndarray, shape (α,), (β,), or None
        γ and λ without load, N/m, of a common prestress; ``force_density`` has them in it.
    """

    force_density: FloatArray
    bar_force_density: FloatArray
    string_limit: tuple[str, ...]
    bar_limit: tuple[str, ...]
    string_load: IntArray
    bar_load: IntArray
    string_sized_by: IntArray
    bar_sized_by: IntArray
    restarts: FloatArray
    bound: float
    prestress: FloatArray | None = None
    bar_prestress: FloatArray | None = None

    @property
    def restarts_agree(self) -> bool:
        """Whether all starts end at the same mass, to 1e-6."""
        return bool(self.restarts.max() <= self.restarts.min() * (1 + _AGREE))

    @property
    def gap(self) -> float:
        """What may be saved at most, part of the mass: 0 where no sections have less, to 1e-6."""
        return max(1 - self.bound / self.mass, 0.0)

    def table(self) -> str:
        """Return members with area, mass, and the limit, load and member that govern them."""
        rows = []
        for kind, area, mass, limits, loads, members in (
            ("string", self.string_area, self.string_mass, self.string_limit, self.string_load,
             self.string_sized_by),
            ("bar", self.bar_area, self.bar_mass, self.bar_limit, self.bar_load,
             self.bar_sized_by),
        ):  # fmt: skip
            rows += [
                [f"{kind} {i}", f"{1e6 * area[i]:.4g}", f"{mass[i]:.4g}", limit, str(loads[i]),
                 f"{kind} {members[i]}"]
                for i, limit in enumerate(limits)
            ]  # fmt: skip
        return aligned(["member", "area mm^2", "mass kg", "limit", "load", "sized by"], rows)


def design(
    structure: Structure,
    *,
    bars: Material,
    strings: Material,
    loads: Sequence[object] = (),
    safety: float = 1.0,
    min_force_density: object = None,
    tube: Tube | None = None,
    least_radius: float = 0.0,
    groups: Mapping[str, Sequence[object]] | None = None,
    common_prestress: bool = False,
    restarts: int | None = None,
    seed: int = 0,
) -> Design:
    """Return the cross sections of least mass that carry each of several loads in a given shape.

    Parameters
    ----------
    structure : Structure
        Its shape, members and supports; its bar masses do not count.
    bars, strings : Material
        What bars and strings are made of.
    loads : sequence of array_like, shape (d, n), optional
        Loads W on the nodes, N, one after the other. Without any, the prestress alone.
    safety : float, optional
        Members are sized for this many times their forces, at least 1.
    min_force_density : float or array_like, shape (α,), optional
        Least γ of each string under each load, N/m. By default a thousandth of the largest load
        over the length of the longest member: strings that are taut, as slack ones leave
        mechanisms.
    tube : Tube, optional
        Makes bars tubes; solid round bars without.
    least_radius : float, optional
        Least radius of a solid member, m, the outer one of a tube.
    groups : mapping, optional
        Members that share one cross section: ``{"strings": […], "bars": […]}``, lists of groups,
        each a list of indices, or the name of a group of strings. Members that are in none have
        their own. :func:`tenscontrol.sizing.symmetry_groups` and
        :func:`tenscontrol.sizing.length_groups` find them.
    common_prestress : bool, optional
        Whether strings are wound once, before loads come, and left; see Notes. Without, they are
        wound for each load.
    restarts : int, optional
        How many starts at most. Least mass with buckling is no convex problem, so that each may end
        in another minimum, and many bars have many. The first starts are from the forces of yield
        alone, up to half of them by branch and bound, and the rest at random. They end before
        where the bound shows that no mass is less; where ``gap`` is above 0, more may find less. By
        default 60 up to 50 members, fewer for more, and 1 above 3,000.
    seed : int, optional
        Of the random starts.

    Returns
    -------
    Design

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, no forces carry a load (the message says which load and which
        nodes cannot be held), or a member carries no force, so that it would have no section.

    Notes
    -----
    A string has the area ``S T/σ``, a bar the larger of ``S |F|/σ`` and, in compression,
    ``2 l √(S F/(π E))``, where Euler's load ``π² E I/l²`` is reached. Yield is a linear program in
    forces and areas. Buckling is concave in the force: the root is replaced by its tangent, which
    is above it, so that each program gives areas that hold and a mass that falls (Skelton &
    de Oliveira, Tensegrity Systems, 2009, ch. 4). Over a range of areas, the root's chord is below
    it, so that a program gives a mass that none is below; ranges are cut in two where chord and
    root are furthest apart (branch and bound; Falk & Soland 1969, doi:10.1287/mnsc.15.9.550). The
    weight of the members is no load.

    Each load has forces of its own, in balance in the given shape: those of a structure whose
    strings are wound for it. With ``common_prestress`` there is one self-stress ``x₀``, and load
    ``w`` adds the response ``Δx`` of elastic members to it, to first order in displacements and
    with all strings taut: ``E Δx = w``, and ``Sᵀ (l/EA) Δx = 0`` for the states of self-stress S,
    so that elongations fit together (the force method; Pellegrino 1993,
    doi:10.1016/0020-7683(93)90014-X). Bars stretch as well. Areas, self-stress and responses are
    the unknowns of one nonlinear program (IPOPT), from the designs without it. Limits and
    ``min_force_density`` then hold without any load too. Where stiffness, and no limit, gives a
    member its area, its limit is "stiffness".

    Examples
    --------
    Four bars and a string that carry 10 kN over 2 m; buckling sizes the bars:

    >>> import tenscontrol as tc
    >>> square = tc.Structure([[-1, 0, 1, 0], [0, 1, 0, -1]],
    ...                       bars=[[0, 1], [1, 2], [2, 3], [3, 0]], strings=[[1, 3]], bar_mass=1.0)
    >>> soft = tc.Material(modulus=60e9, density=2700, yield_stress=110e6)
    >>> sized = tc.design(square, bars=soft, strings=soft, min_force_density=0.0,
    ...                   loads=[[[1e4, 0, -1e4, 0], [0, 0, 0, 0]]])
    >>> sized.bar_mass.round(4), sized.string_mass.round(4), round(sized.mass, 4)
    (array([2.0918, 2.0918, 2.0918, 2.0918]), array([0.4909]), 8.858)
    >>> sized.bar_limit[0], sized.string_limit[0]
    ('buckling', 'yield')
    """
    validation.instance("structure", structure, Structure, "make one by Structure(...)")
    for name, value in (("bars", bars), ("strings", strings)):
        validation.instance(name, value, Material, "make one by Material(...)")
    if tube is not None:
        validation.instance("tube", tube, Tube, "make one by Tube(ratio=…)")
    if validation.positive_number("safety", safety, "times the forces") < 1:
        raise ValueError(f"safety is {safety:g}, expected at least 1: times the forces")
    if not 0 <= validation.number("least_radius", least_radius, "m") <= structure.size:
        raise ValueError(
            f"least_radius is {least_radius:g} m, expected at least 0, and at most the size of the "
            f"structure, {structure.size:g} m"
        )
    if restarts is None:
        members = len(structure.strings) + len(structure.bars)
        restarts = min(max(_WORK // max(members, 1), 8), 60) if members <= _LARGE else 1
    validation.whole_number("restarts", restarts, least=1)
    validation.whole_number("seed", seed, least=0)
    validation.truth("common_prestress", common_prestress, "whether strings are wound once")
    given = validation.items("loads", loads, "loads, one array of shape (d, n) each")
    forces = [
        validation.node_forces(f"loads[{k}]", load, structure.nodes.shape)
        for k, load in enumerate(given)
    ] or [np.zeros(structure.nodes.shape)]
    largest = max(float(np.abs(load).max()) for load in forces)
    lengths = np.concatenate([structure.string_length(), structure.bar_length])
    if min_force_density is None:
        if largest == 0:
            raise ValueError(
                "loads has no force and min_force_density is not given, so that nothing is to be "
                "carried; give a load, or min_force_density in N/m for a prestress"
            )
        min_force_density = 1e-3 * largest / float(lengths.max())
    alpha = len(structure.strings)
    least = validation.per_member("min_force_density", min_force_density, alpha, "string")
    validation.non_negative("min_force_density", least, "a string can only pull")
    group = area_of_member(structure, groups)
    program, unit = _program(
        structure, bars, strings, np.array(forces), least, safety, tube, least_radius, group
    )
    none = np.zeros(len(structure.bars))
    by_yield = program.solve(none, none)
    if by_yield is None:
        _refuse(structure, program, unit)
    outcome = search(program, by_yield, restarts, seed)
    masses = np.array([mass for mass, _ in outcome.results])
    results = sorted(outcome.results, key=lambda result: result[0])
    x = results[0][1]
    if not common_prestress:
        plan = Wound(masses[0], None, x, program.shared(x))
    else:
        modulus = np.where(np.arange(x.shape[1]) < alpha, strings.modulus, bars.modulus)
        starts = [program.shared(result[1]) for result in results[:_MOST_WOUND]]
        plans = wound_once(program, lengths / modulus, starts)
        plan, masses = plans[0], np.array([wound.mass for wound in plans])
    return _designed(structure, bars, strings, program, plan, unit, tube, masses, outcome.bound)


def _program(
    structure: Structure, bars: Material, strings: Material, loads: FloatArray,
    least: FloatArray, safety: float, tube: Tube | None, least_radius: float, group: IntArray,
) -> tuple[AreaProgram, float]:  # fmt: skip
    """Return the program of a shape, and the force in N that is its unit."""
    from scipy.sparse import csr_array, diags_array

    pulls, l = structure.string_length(), structure.bar_length  # noqa: E741
    alpha, beta, length = len(pulls), len(l), np.concatenate([pulls, l])
    E = sparse_equilibrium_matrix(structure, structure.nodes).tocsr()[structure.free_rows]
    w = loads.transpose(0, 2, 1).reshape(len(loads), -1)[:, structure.free_rows]
    unit = max(float(np.abs(w).max(initial=0.0)), float((least * pulls).max(initial=0.0)))
    if unit < 1 / validation.LARGEST:
        raise ValueError(
            "loads pulls on supports alone and min_force_density is 0, or nearly, so that nothing "
            "is to be carried; give min_force_density in N/m"
        )
    hollow = tube.inertia_ratio if tube else 1.0
    stress = tube.stress(bars) if tube else bars.yield_stress
    solid = np.pi * least_radius**2
    ring = solid * (1 - tube.ratio**2) if tube else solid
    if tube:
        wall = tube.least_wall / (1 - tube.ratio)
        ring = max(ring, np.pi * wall**2 * (1 - tube.ratio**2))
    pull = np.r_[np.full(alpha, strings.yield_stress), np.full(beta, bars.yield_stress)]
    density = np.r_[np.full(alpha, strings.density), np.full(beta, bars.density)]
    return AreaProgram(
        csr_array(E @ diags_array(1 / length)), w / unit, least * pulls / unit,
        safety * unit / pull, np.full(beta, safety * unit / stress),
        2 * l * np.sqrt(safety * unit / (np.pi * bars.modulus * hollow)),
        np.r_[np.full(alpha, solid), np.full(beta, ring)], density * length, group,
    ), unit  # fmt: skip


def _designed(
    structure: Structure, bars: Material, strings: Material, program: AreaProgram, plan: Wound,
    unit: float, tube: Tube | None, masses: FloatArray, bound: float,
) -> Design:  # fmt: skip
    """Return the design of these forces, shape (K, m), in the unit."""
    x = plan.forces
    if plan.prestress is not None:
        x = np.vstack([x, plan.prestress])
    cases, count = x.shape
    alpha, beta = len(structure.strings), len(structure.bars)
    needs, area = program.areas(x), plan.area
    if not area.all():
        i = int(np.flatnonzero(area == 0)[0])
        member = f"string {i}" if i < alpha else f"bar {i - alpha}"
        is_held = not movable_members(structure)[i]
        why = "no load, as both ends are fixed" if is_held else "no force under any load"
        raise ValueError(
            f"{member} carries {why}, so that it would have no section; give least_radius in m"
            + (", or a positive min_force_density" if i < alpha else "")
        )
    # Of each group, the member, limit and load that ask for the largest area.
    largest = needs.max(axis=(0, 1))
    order = np.lexsort((largest, program.group))
    last = np.r_[np.flatnonzero(np.diff(program.group[order])), count - 1]
    by = order[last][program.group]
    by = np.where(largest >= area, np.arange(count), by)
    is_stiff = largest[by] < area * (1 - _AGREE)
    governs = needs.transpose(2, 0, 1).reshape(count, -1).argmax(axis=1)[by]
    limit = np.array(["yield", "yield", "buckling", "least"])[governs // cases]
    limit = np.where(is_stiff, "stiffness", limit)
    load = governs % cases
    load[load == len(plan.forces)] = -1
    hollow = tube.inertia_ratio if tube else 1.0
    stress = np.full(beta, tube.stress(bars) if tube else bars.yield_stress)
    A_s, A_b = area[:alpha], area[alpha:]
    plain = with_areas(
        structure, bars, strings, A_b, A_s, hollow * A_b**2 / (4 * np.pi), stress, is_lumped=False
    )
    density = x * unit / np.concatenate([structure.string_length(), structure.bar_length])
    loaded, rest = density[: len(plan.forces)], density[len(plan.forces) :]
    return Design(
        plain.structure, bars, strings, plain.bar_area, plain.string_area, plain.bar_inertia,
        plain.bar_stress, frozen(loaded[:, :alpha]), frozen(loaded[:, alpha:]),
        tuple(limit[:alpha].tolist()), tuple(limit[alpha:].tolist()),
        frozen(load[:alpha]), frozen(load[alpha:]),
        frozen(by[:alpha]), frozen(by[alpha:] - alpha), frozen(masses), bound,
        *(
            frozen(prestress[0]) if len(rest) else None
            for prestress in (rest[:, :alpha], rest[:, alpha:])
        ),
    )  # fmt: skip


def _refuse(structure: Structure, program: AreaProgram, unit: float) -> NoReturn:
    """Raise, naming the load and the nodes that no forces of members hold."""
    from scipy.optimize import linprog
    from scipy.sparse import eye_array, hstack

    rows, count = program.balance.shape
    low = np.r_[program.least_pull, np.full(count - len(program.least_pull), -np.inf)]
    bounds = np.c_[low, np.full(count, np.inf)]
    bounds = np.vstack([bounds, np.tile([0.0, np.inf], (2 * rows, 1))])
    equal = hstack([program.balance, eye_array(rows), -eye_array(rows)], format="csr")
    for k, load in enumerate(program.loads):
        cost = np.r_[np.zeros(count), np.ones(2 * rows)]
        answer = linprog(cost, A_eq=equal, b_eq=load, bounds=bounds, method="highs")
        if answer.status != 0:
            raise ArithmeticError(f"the program that looks for balance ended: {answer.message}")
        left = np.abs(answer.x[count : count + rows] - answer.x[count + rows :])
        if left.max(initial=0.0) > _UNBALANCED:
            nodes = np.unique(structure.free_rows[left > _UNBALANCED] // structure.dimension)
            named = ", ".join(str(node) for node in nodes[:5])
            more = f" and {len(nodes) - 5} more" if len(nodes) > 5 else ""
            raise ValueError(
                f"loads[{k}] cannot be carried in this shape with min_force_density in every "
                f"string: no forces of the members hold nodes {named}{more} (at least "
                f"{left.max() * unit:.3g} N are left). Add members or supports there, "
                "change the shape, or let strings go slack by min_force_density=0"
            )
    raise ArithmeticError("the linear program of least mass found no forces, yet some balance")
