"""Prestress: force densities at which a structure rests, and what they make of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tenscontrol.limits import MOST_RUNS
from tenscontrol.statics.equilibrium_matrix import MemberForces, member_forces
from tenscontrol.statics.least_distance import nearest_in_cone
from tenscontrol.statics.stability import Stability, stability
from tenscontrol.structure import Structure, free_coordinates, rigid_basis
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    choice,
    float_array,
    frozen,
    instance,
    non_negative,
    positive_number,
    shaped,
    whole_number,
)

# Singular values below this fraction of the largest count as zero: far above
# round-off, far below what a real member contributes.
_RANK_TOLERANCE = 1e-9

# Force densities below this fraction of the largest are zero.
_ROUND_OFF = 1e-12

# Unbalanced force above this fraction of the largest member force is not round-off.
_RESIDUAL_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Prestress:
    """A structure at rest: nodes, force densities and load in balance. Made by :func:`prestress`.

    Attributes
    ----------
    structure : Structure
        The structure; ``structure.nodes`` is the shape at rest.
    force_density : ndarray, shape (α,)
        γ of each string = tension / length, N/m, at least 0.
    bar_force_density : ndarray, shape (β,)
        λ of each bar = compression / length, N/m, positive in compression.
    external_force : ndarray, shape (3, n)
        W, the load on the nodes, N.
    residual : float
        Largest unbalanced force on a node, ``max |N K_s − W|``, N.
    self_stress_states : int
        Number of independent force densities that balance without load.
    mechanisms : int
        Number of independent small motions, rigid-body motion not counted,
        that change no member length to first order.
    """

    structure: Structure
    force_density: FloatArray
    bar_force_density: FloatArray
    external_force: FloatArray
    residual: float
    self_stress_states: int
    mechanisms: int

    @cached_property
    def stability(self) -> Stability:
        """What the prestress makes of the mechanisms; see :class:`Stability`."""
        return stability(self.structure, self.force_density, self.bar_force_density)

    @property
    def is_stable(self) -> bool:
        """Whether the prestress stiffens every mechanism (prestress stability)."""
        return self.stability.is_stable

    @property
    def is_super_stable(self) -> bool:
        """Whether it stays stable at any level of prestress (super-stability)."""
        return self.stability.is_super_stable

    def __repr__(self) -> str:
        return (
            f"Prestress({self.structure!r}, residual {self.residual:.1e} N, "
            f"{self.self_stress_states} self-stress states, {self.mechanisms} mechanisms)"
        )


def prestress(
    structure: Structure,
    force_density: object,
    reference: str | None = None,
    external_force: object = None,
) -> Prestress:
    """Return the force densities at which a structure rests in its reference shape.

    Parameters
    ----------
    structure : Structure
    force_density : float or array_like, shape (α,)
        A number: the mean force density that the ``reference`` strings get,
        N/m. Where the structure has several states of self-stress, the one
        nearest to a uniform γ of this value is taken. An array: γ of every
        string, N/m; it is checked, and refused when it does not balance.
    reference : str, optional
        The string group that a single number refers to; the group of the
        first string if not given (for :func:`prism` the top strings).
    external_force : array_like, shape (3, n), optional
        Load W on the nodes, N.

    Returns
    -------
    Prestress

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit; if a given γ is negative or does not
        balance (the message says by how much and where); if no γ ≥ 0 balances.

    Notes
    -----
    Equilibrium is ``N K_s = W``, Goyal & Skelton eq. (7) with N̈ = 0. The
    states of self-stress are the null space of the equilibrium matrix
    (Pellegrino & Calladine 1986, doi:10.1016/0020-7683(86)90014-4).

    Examples
    --------
    The prism rests at γ_v = √3 γ_t:

    >>> import tenscontrol as tc
    >>> rest = tc.prestress(tc.prism(), force_density=17.3205)
    >>> rest.force_density[[0, 3, 6]].round(4), round(float(rest.bar_force_density[0]), 4)
    (array([17.3205, 17.3205, 30.    ]), 30.0)
    >>> rest.self_stress_states, rest.mechanisms, rest.is_stable, rest.is_super_stable
    (1, 1, True, True)
    """
    instance("structure", structure, Structure, "make one by Structure(...) or prism(...)")
    n, alpha = structure.nodes.shape[1], len(structure.strings)
    given = float_array("force_density", force_density)
    if alpha == 0 and given.ndim == 0:
        raise ValueError("the structure has no strings, so there is nothing to prestress")
    load = np.zeros((3, n))
    if external_force is not None:
        load = shaped("external_force", external_force, (3, n), "one force per node, N")
    w = free_coordinates(structure, load)
    forces = member_forces(structure, w)
    live, E, states, particular = forces.live, forces.matrix, forces.states, forces.particular
    live_strings = live[:alpha]
    count = int(live_strings.sum())

    if given.ndim == 0:
        level = positive_number("force_density", float(given), "N/m")
        _refuse_unbalanced(
            structure, E, particular, w, "no member forces balance external_force",
            "In this shape the load meets a mechanism; equilibrium(model, ...) lets the shape give",
        )  # fmt: skip
        groups = dict.fromkeys(structure.string_groups)
        group = next(iter(groups)) if reference is None else choice("reference", reference, groups)
        strings = np.flatnonzero(np.isin(np.flatnonzero(live_strings), structure.strings_in(group)))
        if len(strings) == 0:
            raise ValueError(
                f"reference is {group!r}, whose strings all run between fixed nodes: no force of "
                "theirs moves anything; give a group with a free end as reference"
            )
        densities = _nearest_to_uniform(particular, states, strings, level, count)
        if densities is None:
            raise ValueError(_infeasible(states, forces.sizes, bool(w.any())))
    else:
        if reference is not None:
            raise ValueError("reference goes with a single force_density, not with an array")
        gamma = shaped("force_density", given, (alpha,), "one per string")
        non_negative("force_density", gamma, "a string can only pull")
        hint = "prestress(structure, force_density=<one number>) finds force densities that balance"
        return balanced(structure, forces, gamma, load, "force_density does not balance", hint)
    _refuse_unbalanced(structure, E, densities, w, "no force_density balances", "Change the shape")
    return _at_rest(structure, forces, np.zeros(alpha), densities, load)


def balanced(
    structure: Structure, forces: MemberForces, gamma: FloatArray, load: FloatArray,
    what: str, hint: str, least: float = 0.0,
) -> Prestress:  # fmt: skip
    """Return γ of every string with the bars that balance it best, or raise saying what and hint.

    What is left on a node is judged against the largest force, N, or ``least`` if that is more.
    """
    pulls, E, w = forces.live[: len(gamma)], forces.matrix, free_coordinates(structure, load)
    count = int(pulls.sum())
    bars = np.linalg.lstsq(E[:, count:], w - E[:, :count] @ gamma[pulls], rcond=None)[0]
    densities = np.concatenate([gamma[pulls], bars])
    _refuse_unbalanced(structure, E, densities, w, what, hint, least)
    return _at_rest(structure, forces, gamma, densities, load)


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
        self_stress_states=forces.states.shape[1],
        mechanisms=len(w) - rigid_basis(structure).shape[1] - forces.rank,
    )


def prism_force_density(
    sides: int, force_density: float, radius: float = 1.0, top_radius: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the force densities at which a prism rests, in the order of :func:`prism`.

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
    q = whole_number("sides", sides, 3, MOST_RUNS)
    top = positive_number("force_density", force_density, "N/m")
    b = positive_number("radius", radius, "m")
    a = b if top_radius is None else positive_number("top_radius", top_radius, "m")
    vertical = 2 * np.sin(np.pi / q) * top * a / b
    bottom = positive_number("force_density (top_radius/radius)²", top * (a / b) ** 2, "N/m")
    return np.repeat([top, bottom, vertical], q), np.full(q, vertical)


def _nearest_to_uniform(
    particular: FloatArray, states: FloatArray, strings: IntArray, level: float, alpha: int
) -> FloatArray | None:
    """Return the balanced γ ≥ 0 nearest to ``level`` whose mean over ``strings`` is ``level``."""
    # States that keep the mean: c = start + directions @ free.
    mean = states[strings].mean(axis=0)
    weight = float(np.linalg.norm(mean))
    if weight < _RANK_TOLERANCE:
        return None
    start = mean * (level - particular[strings].mean()) / weight**2
    directions = np.linalg.svd(mean[None, :])[2][1:].T
    at = particular + states @ start
    moves = states @ directions
    free = nearest_in_cone(moves[:alpha], at[:alpha], target=np.full(alpha, level))
    if free is None:
        return None
    densities = at + moves @ free
    # What round-off leaves below zero is zero; the residual is checked afterwards.
    gamma = densities[:alpha]
    gamma[gamma < _ROUND_OFF * np.abs(densities).max()] = 0.0
    return np.asarray(densities)


def _infeasible(states: FloatArray, sizes: FloatArray, loaded: bool) -> str:
    """Say why no force densities were found."""
    if states.shape[1] == 0:
        smallest = sizes[-1] / sizes[0]
        return (
            "the structure has no state of self-stress in this shape: no force densities balance. "
            f"The smallest singular value of its equilibrium matrix is {smallest:.1e} of the "
            f"largest, against {_RANK_TOLERANCE:.0e} for a state of self-stress; if it is small, "
            "give the nodes with more digits"
        )
    what = "external_force with" if loaded else "the structure with"
    return (
        f"no force densities γ ≥ 0 balance {what} the reference strings at the wanted level: "
        f"each of the {states.shape[1]} states of self-stress needs a string in compression, or "
        "leaves the reference strings slack. Change the shape, the strings or the reference"
    )


def _refuse_unbalanced(
    structure: Structure, E: FloatArray, densities: FloatArray, w: FloatArray,
    what: str, hint: str, least: float = 0.0,
) -> None:  # fmt: skip
    unbalanced = (E @ densities - w).reshape(-1, 3)
    size = np.linalg.norm(unbalanced, axis=1)
    scale = max([least, *(float(np.abs(x).max(initial=0.0)) for x in (E * densities, w))])
    if size.max() > _RESIDUAL_TOLERANCE * scale:
        worst = int(size.argmax())
        raise ValueError(
            f"{what}: node {structure.free[worst]} is left with an unbalanced force of "
            f"{size[worst]:.3g} N, expected less than {_RESIDUAL_TOLERANCE * scale:.1e} N. {hint}"
        )
