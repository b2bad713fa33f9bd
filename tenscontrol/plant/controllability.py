"""Controllability of a linear plant by its strings, mode by mode."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, freeze_arrays, frozen
from tenscontrol.dynamics.coordinates import coordinates
from tenscontrol.dynamics.evaluator import on_one_thread
from tenscontrol.plant.linear_plant import (
    LinearPlant,
    clusters,
    is_undamped,
    kept,
    spectral_norm,
    squared_frequencies,
    state_units,
    tall_qr,
)
from tenscontrol.plant.modes import Modes, modes_of
from tenscontrol.plant.reduced_dynamics import reduce
from tenscontrol.plant.string_outputs import to_commanded_strings
from tenscontrol.short_repr import short_repr
from tenscontrol.warn import warn

# A direction or margin below this fraction of its surroundings does not exist.
_TOLERANCE = 1e-9

# Poles closer than this fraction of the largest are one cluster: round-off splits the double
# poles of Jordan blocks by about 1e-8. Within a cluster they are told apart.
_SAME_POLE = 1e-6

# Round-off in the entries of A, relative to its size, and in the real part of a single pole.
_ROUND_OFF, _UPRIGHT = 1e-11, 1e-9

# Round-off of the eigenvectors of A, for one of size 1 and distances of 1.
_NOISE = 1e-14

# Accelerations by inputs below this fraction of what their forces could give are round-off.
_NO_PUSH = 1e-13

# Of the largest acceleration of a large plant; its square is left with the square of this, at most.
_CLOSE = 1e-2

# An input nearer to a bound than this part of the largest is at it.
_AT_BOUND = 1e-9

# Modes that a warning names.
_LISTED = 4

# Eigenvectors of a cluster that are this close to dependent make a Jordan block.
_DEPENDENT = 1e-4


@dataclass(frozen=True, eq=False)
class Controllability:
    """Controllability of each mode. Made by :func:`controllability`.

    Attributes
    ----------
    pole : ndarray of complex, shape (k,)
        The different poles with Im s ≥ 0, 1/s, by size.
    margin : ndarray, shape (k,)
        How well the inputs reach the modes of the pole, 0 to 1, whatever the units: the least
        acceleration of a mode by inputs of size 1, over the largest that they give to any motion.
        Of modes that share a pole, that of the combination reached least.
    unreachable : int
        Number of states that no input reaches, rate states included.
    unreached : Modes
        The modes that no input reaches.
    """

    pole: np.ndarray
    margin: FloatArray
    unreachable: int
    unreached: Modes

    __repr__ = short_repr

    @property
    def is_controllable(self) -> bool:
        """Whether the inputs reach every state."""
        return self.unreachable == 0

    def table(self) -> str:
        """Return the test as text, one pole a line.

        Returns
        -------
        str
        """
        lines = ["pole 1/s                margin"]
        for pole, margin in zip(self.pole, self.margin, strict=True):
            lines.append(f"{pole.real:9.4f} {pole.imag:+9.4f}j  {margin:9.3g}")
        return "\n".join(lines)


def controllability(plant: LinearPlant, count: int | None = None) -> Controllability:
    """Return whether the strings can control every mode, or each of the lowest.

    Parameters
    ----------
    plant : LinearPlant
    count : int, optional
        Number of modes of lowest frequency to test, for a large plant, as in :func:`reduce`.
        Only their states are counted; margins still refer to the largest acceleration of any
        motion. All modes if not given.

    Returns
    -------
    Controllability

    Raises
    ------
    TypeError, ValueError
        If ``plant`` is not a linear plant, or ``count`` is not a positive whole number.

    Notes
    -----
    Popov, Belevitch and Hautus (Hautus 1969): (A, B) is controllable if and only if no left
    eigenvector w of A has ``wᵀ B = 0``. One decomposition gives all w: of the symmetric stiffness
    where nothing is damped, else of A. Modes that share a pole are tested together, and where
    they have too few eigenvectors (a drift), on the space that belongs to the pole.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> print(tc.controllability(plant).table())
    pole 1/s                margin
       0.0000   +0.0000j      0.663
       0.0000  +10.8527j      0.443
       0.0000  +11.1551j       0.11
       0.0000  +11.6652j      0.649
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    if count is not None:
        count = min(validation.whole_number("count", count, 1), plant.degrees_of_freedom)
    if count:
        return _of_lowest(plant, count)
    states = reached_states(plant)
    order = np.argsort(np.abs(states.pole), kind="stable")
    return Controllability(
        pole=frozen(states.pole[order]),
        margin=frozen(states.margin[order]),
        unreachable=len(plant.A) - states.count,
        unreached=unreached_modes(plant),
    )


def _of_lowest(plant: LinearPlant, count: int) -> Controllability:
    """Return what is reached of the lowest modes, by margins as of the whole plant."""
    from scipy.sparse.linalg import svds

    small: LinearPlant = reduce(plant, count)
    reduced = controllability(small)
    if plant.sparse is None or reduced.unreachable == len(small.A):
        return reduced
    by_input = plant.sparse.by_input
    start = np.cos(np.arange(1.0, min(by_input.shape) + 1) ** 2)  # any, without symmetry
    # Of many stages alike, the largest are close together.
    largest = svds(by_input, 1, tol=_CLOSE, v0=start, return_singular_vectors=False)[0]
    share = spectral_norm(small.B) / float(largest)
    return replace(reduced, margin=frozen(share * reduced.margin))


@dataclass(frozen=True, eq=False)
class ReachedStates:
    """The states of a plant that its inputs reach, and those that they do not; not for users.

    ``z = unit · (basis y)`` with an orthonormal basis, in which A is ``[[A11, A12], [0, A22]]`` and
    B is ``[B1; 0]``: the first ``count`` entries of y are reached.
    """

    pole: np.ndarray
    margin: FloatArray
    unit: FloatArray  # (s,)
    basis: FloatArray  # (s, s)
    count: int
    unreached_pole: np.ndarray  # (k,)
    unreached_shape: np.ndarray  # q of these modes, (r, k)
    growing: np.ndarray  # poles of what is not reached and grows or drifts, 1/s
    growing_states: int

    def __post_init__(self) -> None:
        freeze_arrays(self)


@kept
def reached_states(plant: LinearPlant) -> ReachedStates:
    """Return what the inputs of a plant reach."""
    return (_by_stiffness if is_undamped(plant) else _by_poles)(plant)


@kept
def unreached_modes(plant: LinearPlant) -> Modes:
    """Return the modes that no input reaches."""
    states = reached_states(plant)
    return modes_of(plant, states.unreached_pole, states.unreached_shape)


def _by_stiffness(plant: LinearPlant) -> ReachedStates:
    """Return what is reached of ``q̈ + K q = B₂ v``: K is symmetric, so left modes are modes."""
    r = plant.degrees_of_freedom
    squares, modes = squared_frequencies(-plant.A[r:, :r])
    rows = modes.T @ _reach(plant)[r:]
    sizes_of_one = np.linalg.norm(rows, axis=1)
    noise = _NOISE * np.abs(squares).max(initial=0.0)
    poles, margins = [], []
    reached, lost = [np.zeros((r, 0))], [np.zeros((r, 0))]
    lost_poles: list[complex] = []
    for first, last in clusters(squares):
        turn, sizes = _left_directions(rows[first:last])
        own, square = modes[:, first:last] @ turn, squares[first:last].mean()
        mixed = _mixed(squares, slice(first, last), noise, sizes_of_one)
        count = int(np.count_nonzero(sizes > max(_TOLERANCE, mixed)))
        pole = np.sqrt(complex(-square))
        poles += [pole, -pole] if square < 0 else [pole]
        margins += [sizes[-1]] * (1 + (square < 0))
        reached.append(own[:, :count])
        lost.append(own[:, count:])
        lost_poles += [pole] * (last - first - count)
    growing = [pole for pole in lost_poles if not pole.imag]
    pair = np.eye(2)  # of displacements and rates
    return ReachedStates(
        pole=np.array(poles, dtype=complex),
        margin=np.array(margins, dtype=float),
        unit=state_units(plant)[0],
        basis=np.hstack([np.kron(pair, np.hstack(reached)), np.kron(pair, np.hstack(lost))]),
        count=2 * (r - len(lost_poles)),
        unreached_pole=np.array(lost_poles, dtype=complex),
        unreached_shape=np.hstack(lost),
        growing=np.array(growing, dtype=complex),
        growing_states=2 * len(growing),
    )


def _by_poles(plant: LinearPlant) -> ReachedStates:
    """Return what is reached of any plant, from the left eigenvectors of A."""
    r = plant.degrees_of_freedom
    unit, _ = state_units(plant)
    rate = 1 / unit[0] if r else 1.0
    A = plant.A * unit / unit[:, None] / rate
    spaces_by_pole = left_spaces(A, _reach(plant))
    lost = [space for space in spaces_by_pole if space.unreached.shape[1]]
    spaces = np.hstack([np.zeros((2 * r, 0)), *(space.unreached for space in lost)])
    count = 2 * r - spaces.shape[1]
    lost_poles, lost_shapes = own_modes(A, rate, [space.unreached for space in lost])
    away = np.linalg.qr(spaces, mode="complete")[0]
    growing = [space for space in lost if space.grows]
    return ReachedStates(
        pole=rate * np.array([space.pole for space in spaces_by_pole], dtype=complex),
        margin=np.array([space.margin for space in spaces_by_pole], dtype=float),
        unit=unit,
        basis=np.hstack([away[:, 2 * r - count :], away[:, : 2 * r - count]]),
        count=count,
        unreached_pole=lost_poles,
        unreached_shape=lost_shapes,
        growing=rate * np.array([space.pole for space in growing], dtype=complex),
        growing_states=sum(space.unreached.shape[1] for space in growing),
    )


@dataclass(frozen=True, eq=False)
class LeftSpace:
    """A pole s, Im s ≥ 0, how well inputs reach it, and what inputs do not reach of its states."""

    pole: complex
    margin: float  # least size of Bᵀ w, w a left eigenvector whose rates have the norm 1
    unreached: FloatArray  # orthonormal, (s, k); Aᵀ maps it into itself
    grows: bool  # whether what is not reached grows or drifts


@on_one_thread
def left_spaces(A: FloatArray, B: FloatArray) -> list[LeftSpace]:
    """Return what B does not reach of ``ż = A z``, pole by pole; both are of size 1."""
    from scipy import linalg
    from scipy.sparse.csgraph import connected_components

    if not len(A):
        return []
    poles, left = linalg.eig(A.T)  # wᵀ A = s wᵀ
    count, cluster = connected_components(np.abs(poles[:, None] - poles) < _SAME_POLE)
    spaces = []
    nothing = np.zeros((len(A), 0))
    sizes_of_one = np.linalg.norm(left.T @ B, axis=1)
    rates = np.linalg.norm(left[len(A) // 2 :], axis=0)
    for number in range(count):
        mine = cluster == number
        pole = complex(poles[mine].mean())
        if pole.imag < -_SAME_POLE / 2:  # the conjugate of another
            continue
        pole = complex(_on_axis(pole.real), 0.0 if pole.imag < _SAME_POLE / 2 else pole.imag)
        # Left and right eigenvectors of a slow pole are nearly orthogonal.
        noise = _NOISE / max(abs(pole), _SAME_POLE)
        tolerance = max(_TOLERANCE, _mixed(poles, mine, noise, sizes_of_one))
        if mine.sum() == 1 and sizes_of_one[mine] > tolerance:
            margin = sizes_of_one[mine] / rates[mine]
            spaces.append(LeftSpace(pole, float(margin[0]), nothing, grows=False))
            continue
        vectors, sizes, _ = np.linalg.svd(left[:, mine], full_matrices=False)
        basis = vectors
        if sizes[-1] < _DEPENDENT * sizes[0]:
            reach = np.abs(poles[mine] - pole).max() + _SAME_POLE / 2
            _, basis, multiplicity = linalg.schur(
                A.T,
                output="complex",
                sort=lambda s, centre=pole, reach=reach: abs(s - centre) <= reach,
            )
            basis = basis[:, :multiplicity]
        unreached, grows = _unreached_of(A, B, pole, basis, tolerance)
        vectors = vectors[:, sizes >= _DEPENDENT * sizes[0]]
        spaces.append(LeftSpace(pole, _margin(vectors, B), unreached, grows))
    return spaces


def _unreached_of(
    A: FloatArray, B: FloatArray, pole: complex, basis: np.ndarray, tolerance: float
) -> tuple[FloatArray, bool]:
    """Return what is not reached of the left space of a pole, and whether it grows."""
    T: np.ndarray | None = None
    reached = np.zeros((basis.shape[1], 0), dtype=complex)
    block = basis.conj().T @ B
    while block.shape[1]:
        directions, sizes = _left_directions(block - reached @ (reached.conj().T @ block))
        fresh = directions[:, sizes > tolerance]
        reached = np.hstack([reached, fresh])
        if len(reached) == reached.shape[1]:
            return np.zeros((len(A), 0)), False
        if T is None:
            T = basis.conj().T @ A.T @ basis
            shifted = T - np.eye(len(T)) * np.trace(T) / len(T)
            away = float(np.linalg.norm(shifted, 2))
        if away <= _ROUND_OFF:  # one pole with all its eigenvectors
            break
        block = shifted.conj().T @ fresh / away
        tolerance = max(tolerance, 1e-3 * _ROUND_OFF / away)
    left = np.linalg.qr(reached, mode="complete")[0][:, reached.shape[1] :]
    grows = pole.real > _UPRIGHT
    if abs(pole.real) <= _UPRIGHT:
        sizes = np.linalg.svd(np.linalg.eig(left.conj().T @ T @ left)[1], compute_uv=False)
        grows = bool(sizes[-1] < _DEPENDENT * sizes[0])
    vectors, is_pair = basis @ left, pole.imag > _SAME_POLE / 2
    both = np.hstack([vectors.real, vectors.imag])
    return np.linalg.svd(both, full_matrices=False)[0][:, : (1 + is_pair) * left.shape[1]], grows


def _mixed(values: np.ndarray, mine: np.ndarray | slice, noise: float, sizes: FloatArray) -> float:
    """Return how much of the reach of others round-off adds to that of some eigenvectors.

    A change of A by ``noise`` turns an eigenvector towards another one by the noise over the
    distance of their values: soft modes beside stiff ones lose digits.
    """
    others = np.ones(len(values), bool)
    others[mine] = False
    away = np.abs(values[others] - values[mine].mean())
    return float(np.linalg.norm(noise / away * sizes[others]))


def _left_directions(rows: np.ndarray) -> tuple[np.ndarray, FloatArray]:
    """Return orthonormal directions of the left side, (m, m), and their sizes, descending."""
    count, columns = rows.shape
    directions, sizes, _ = np.linalg.svd(rows, full_matrices=columns < count)
    return directions, np.r_[sizes, np.zeros(count - len(sizes))]


def _on_axis(real: Any) -> Any:
    """Return real parts of poles of size 1 without round-off."""
    return np.where(np.abs(real) <= _UPRIGHT, 0.0, real)


def normalized_input(plant: LinearPlant) -> FloatArray:
    """Return B of norm 1, or a column of zeros where nothing pushes.

    Strings that pull along bars only give round-off, beside the forces that they have: the change
    of the tension by γ, or by the rest length.
    """
    length = plant.model.structure.string_length(plant.nodes)
    length = to_commanded_strings(plant, "length", length)
    force = length
    if plant.input != "force_density":
        assert plant.rest_length is not None  # there is a law
        stretch = np.abs(length - plant.rest_length)
        taut = (plant.force_density > 0) & (stretch > 0)
        force = (plant.force_density * length)[taut] / stretch[taut]
    most = spectral_norm(plant.basis) * force.max(initial=0.0) if plant.B.size else 0.0
    size = spectral_norm(plant.B) if plant.B.size else 0.0
    return plant.B / size if size > _NO_PUSH * most else np.zeros((len(plant.B), 1))


def _reach(plant: LinearPlant) -> FloatArray:
    """Return a matrix B of norm 1 with the same B Bᵀ, and no more columns than states."""
    B = normalized_input(plant)
    return B if B.shape[1] <= len(B) else tall_qr(B.T)[1].T


def _margin(vectors: np.ndarray, B: FloatArray) -> float:
    """Return the least size of Bᵀ w for left eigenvectors w whose rates have the norm 1."""
    r = len(vectors) // 2
    # The rest of a left eigenvector follows from its last rows.
    own = np.linalg.svd(vectors[r:], full_matrices=False)[0]
    return float(_left_directions(own.conj().T @ B[r:])[1][-1])


def own_modes(
    A: FloatArray, rate: float, spaces: list[FloatArray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return poles and shapes q of spaces of states that Aᵀ keeps; A is that of a plant by rate."""
    poles, shapes = np.zeros(0, complex), np.zeros((len(A) // 2, 0), complex)
    for space in spaces:
        own, moved = _own_modes(A, space)
        poles, shapes = np.r_[poles, rate * own], np.hstack([shapes, moved])
    return poles, shapes


def _own_modes(A: FloatArray, space: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Return poles, Im s ≥ 0, and shapes q of the motion in a real space that Aᵀ keeps."""
    r = len(A) // 2
    poles, vectors = np.linalg.eig(space.T @ A @ space)
    moved = space @ vectors
    lengths = np.linalg.norm(moved[:r], axis=0) >= np.linalg.norm(moved[r:], axis=0)
    shapes = np.where(lengths, moved[:r], moved[r:])
    still = np.abs(poles) < _SAME_POLE
    zero, sizes, _ = np.linalg.svd(shapes[:, still], full_matrices=False)
    zero = zero[:, sizes > _DEPENDENT * sizes.max(initial=0.0)]
    others = ~still & (poles.imag >= 0)
    poles = _on_axis(poles.real) + 1j * poles.imag
    return (
        np.r_[np.zeros(zero.shape[1], complex), poles[others]],
        np.hstack([zero, shapes[:, others]]),
    )


def ways(plant: LinearPlant, low: FloatArray, high: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Return which inputs can rise from the operating point within bounds, and which can fall."""
    u = plant.equilibrium_input
    near = _AT_BOUND * np.abs(u).max(initial=0.0)
    return high - u > near, u - low > near


def lasting(poles: np.ndarray) -> int:
    """Return how many poles, of any unit, do not decay."""
    return int(np.count_nonzero(-poles.real <= _UPRIGHT * np.abs(poles)))


@on_one_thread
def pushed_one_way(plant: LinearPlant, low: FloatArray, high: FloatArray) -> float | None:
    """Return the real pole, 1/s, of a motion that does not decay and is pushed one way only.

    Inputs at a bound go one way. No law holds the linear plant where a real left eigenvector w of
    a pole s ≥ 0 has wᵀB u ≥ 0 for all of them: Brammer, SIAM J. Control 10 (1972),
    doi:10.1137/0310026.
    The largest such pole; None where there is none.
    """
    rises, falls = ways(plant, low, high)
    B = normalized_input(plant)
    if (rises == falls).all() or B.shape[1] != len(rises):
        return None
    from scipy import linalg
    from scipy.optimize import linprog

    unit, _ = state_units(plant)
    A = plant.A * unit / unit[:, None] * unit[0]
    both, one_way = B[:, rises & falls], (B * np.where(rises, 1, -1))[:, rises != falls]
    poles = linalg.eigvals(A)
    is_real = (np.abs(poles.imag) < _SAME_POLE) & (poles.real > -_SAME_POLE)
    # Round-off splits a pole of several states; those of them at rest are at 0.
    candidates = np.where(np.abs(poles.real) < _SAME_POLE, 0.0, poles.real)[is_real]
    for pole in np.unique(candidates)[::-1]:
        directions, sizes = _left_directions(A - pole * np.eye(len(A)))
        vectors = directions[:, sizes <= _SAME_POLE]
        directions, sizes = _left_directions(vectors.T @ both)
        vectors = vectors @ directions[:, sizes <= _TOLERANCE]
        pushes = one_way.T @ vectors
        pushes[np.abs(pushes) < _TOLERANCE] = 0.0
        if not pushes.any():
            continue
        bounds = np.vstack([pushes, -pushes]), np.repeat([1.0, 0.0], len(pushes))
        best = linprog(-pushes.sum(axis=0), *bounds, bounds=(None, None))
        if best.status == 0 and best.fun < -0.5:
            return float(pole / unit[0])
    return None


def refuse_empty(plant: LinearPlant) -> None:
    """Raise if there is nothing to control."""
    states, inputs = plant.B.shape
    if states == 0 or inputs == 0:
        raise ValueError(
            f"plant has {states} states and {inputs} inputs, so there is nothing to control"
        )


def refuse_unreachable(plant: LinearPlant, drifting: bool = True) -> None:
    """Raise if a motion that grows or drifts is out of reach, saying which and what to do.

    Without ``drifting`` only if one grows.
    """
    states = reached_states(plant)
    if not states.count:
        raise ValueError(
            f"none of the {len(plant.A)} states of the plant can be controlled: at the "
            "operating point strings pull along bars only, or are slack"
        )
    if not states.growing_states or not (drifting or (states.growing.real > 0).any()):
        return
    kind = plant.coordinates.kind
    counts = {
        name: coordinates(plant.model, plant.nodes, name).count
        for name in ("nodes", "minimal", "internal")
    }
    motions = []
    if kind == "nodes":
        motions.append(
            (2 * (counts["nodes"] - counts["minimal"]), "are lengths of bars and their rates")
        )
    if kind != "internal":
        rigid = 2 * (counts["minimal"] - counts["internal"])
        motions.append((rigid, "are rigid-body motions"))
    inner = states.growing_states - sum(count for count, _ in motions)
    if inner:
        poles = ", ".join(f"{pole:.4g}" for pole in states.growing)
        motions.append((inner, f"are changes of shape, at the poles {poles} 1/s"))
    advice = (
        "Choose a prestress that makes the shape stable, or add strings whose lengths change in "
        "these modes; controllability(plant).unreached has the mode shapes"
        if inner
        else "Internal forces change neither: linearize with coordinates='internal'"
    )
    listed = " and ".join(f"{count} {meaning}" for count, meaning in motions if count)
    raise ValueError(
        f"{states.growing_states} of the {len(plant.A)} states of the plant in {kind!r} "
        "coordinates "
        f"are out of reach of the strings, and grow or drift: {listed}. {advice}"
    )


def warn_of_left_alone(modes: Modes, effect: str, meaning: str) -> None:
    """Warn of modes left alone that do not decay: what is so of them, and what that means."""
    swinging = [
        f"{frequency:.4g} Hz ({label})"
        for frequency, damping, label in zip(
            modes.frequency, modes.damping, modes.label, strict=True
        )
        if damping < _UPRIGHT
    ]
    if swinging:
        count = f"{len(swinging)} mode{'s' if len(swinging) > 1 else ''}"
        more = ", …" if len(swinging) > _LISTED else ""
        warn(
            f"{effect} {count} of the plant, at {', '.join(swinging[:_LISTED])}{more}: left "
            f"alone. {meaning} The attribute left_alone has the mode shapes, for plot.mode_shapes",
            RuntimeWarning,
        )
