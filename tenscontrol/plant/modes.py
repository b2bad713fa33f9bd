"""Modes of a linear plant."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics.evaluator import on_one_thread
from tenscontrol.dynamics.tangent import normal_basis, string_stretch
from tenscontrol.plant.linear_plant import (
    LinearPlant,
    clusters,
    is_undamped,
    norm,
    squared_frequencies,
)
from tenscontrol.plant.linearize import in_coordinates
from tenscontrol.statics.equilibrium_matrix import orthogonal_part
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import affine_motions, left_by_supports, rigid_motions
from tenscontrol.viewable import Viewable

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array

# Singular values below this fraction of the largest are zero.
_ZERO = 1e-11

# Affine motions leave in place what they move by less than this part.
_KEPT = 1e-9

# A mode is named after a kind of motion that has at least this share of its kinetic energy.
_SHARE = 0.95

# Of the lowest modes, more are found than asked for, so that equal ones are not torn apart. The
# shift from zero, and the ω² that are lost in round-off, as parts of the stiffness.
_MORE, _SHIFT, _LOST = 4, 1e-15, 4e-16

# A stiffness this far from symmetric, relative to its size, is not that of a rest.
_ROUND = 1e-9

# Parts of the stretch of a motion that strings resist weakly, and of a shape that is in mechanisms.
_WEAK, _PART = 1e-7, 1e-2

# Displacements as large as the largest but for this part may be so on another machine.
_AS_LARGE = 1e-6


@dataclass(frozen=True, eq=False)
class Modes(Viewable):
    """Modes of a linear plant, in order of frequency. Made by :func:`modes`.

    Attributes
    ----------
    frequency : ndarray, shape (k,)
        Natural frequency ``|s|/2π`` of the pole s, Hz.
    damping : ndarray, shape (k,)
        Damping ratio ``−Re s/|s|``; 0 for a mode at zero frequency, −1 for one that runs away.
    pole : ndarray of complex, shape (k,)
        The pole s with Im s ≥ 0, 1/s.
    shape : ndarray, shape (d, n, k)
        Node displacements, scaled so that the largest is 1. Complex where
        damping makes the nodes move out of step.
    label : tuple of str, length k
        The kind of motion that has at least 95 % of the kinetic energy.
        ``"rigid"``: the structure moves as one body. ``"affine"``: it is
        stretched or sheared as a whole, at no cost when γ is held (supports stay, and no load is
        lifted or turned).
        ``"mechanism"``: no string changes its length to first order.
        ``"constraint"``: a bar changes its length (``"nodes"`` coordinates
        only; not a motion of the structure). ``"elastic"``: anything else.
    structure : Structure
    nodes : ndarray, shape (d, n)
        Node positions at the operating point, m.
    """

    frequency: FloatArray
    damping: FloatArray
    pole: np.ndarray
    shape: np.ndarray
    label: tuple[str, ...]
    structure: Structure
    nodes: FloatArray

    def table(self) -> str:
        """Return the modes as text, one a line.

        Returns
        -------
        str
        """
        lines = ["mode  frequency Hz  damping  kind"]
        for i, label in enumerate(self.label):
            grows = ", runs away" if self.damping[i] <= -1 else ""
            lines.append(
                f"{i:4d}  {self.frequency[i]:12.5f}  {self.damping[i]:7.4f}  {label}{grows}"
            )
        return "\n".join(lines)

    def __len__(self) -> int:
        return len(self.label)

    def __repr__(self) -> str:
        if not self.label:
            return "Modes(0)"
        return (
            f"Modes({len(self.label)}, {self.frequency.min():.3g} to {self.frequency.max():.3g} Hz)"
        )


def modes(plant: LinearPlant, count: int | None = None) -> Modes:
    """Return the natural frequencies, damping ratios and mode shapes of a linear plant.

    Motions without stiffness and damping are separated first, so that their frequencies are
    exactly zero. Where several modes have the same frequency, their shapes are chosen so that
    rigid, affine and mechanism motions are not mixed, and each in turn so that a node moves as far
    along an axis as it can. Signs are such that the largest of these displacements is positive, of
    equally large ones the first: coordinates of :func:`reduce` are the same on every machine.

    Parameters
    ----------
    plant : LinearPlant
    count : int, optional
        How many, those of the smallest poles; all if not given, or if there are fewer. A few of a
        large structure cost work and memory that grow with its members, all of them with the cube
        of their number.

    Returns
    -------
    Modes

    Raises
    ------
    TypeError, ValueError
        If ``plant`` is not a linear plant, or ``count`` is not a positive whole number; or if all
        modes are asked for of a plant of more than 4,000 coordinates.

    Notes
    -----
    The lowest modes are found by Lanczos' method on the inverse of the sparse stiffness (ARPACK;
    Lehoucq, Sorensen & Yang 1998), shifted by little from zero. Damping is not approximated: the
    poles of a damped plant are those of ``s² + s D + K``, by Arnoldi's method on its inverse.
    Squared frequencies have an error of round-off of the largest: those below 4e-16 of it are
    zero.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> print(tc.modes(tc.linearize(tc.Model(prism), rest)).table())
    mode  frequency Hz  damping  kind
       0       0.00000   0.0000  affine
       1       0.00000   0.0000  affine
       2       0.00000   0.0000  affine
       3       1.72726   0.0000  elastic
       4       1.72726   0.0000  elastic
       5       1.77540   0.0000  mechanism
       6       1.85657   0.0000  elastic
       7       1.85657   0.0000  elastic
       8       1.85657   0.0000  elastic
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    r = plant.degrees_of_freedom
    if count is not None:
        count = min(validation.whole_number("count", count, 1), r)
        slowest = lowest(plant, count)
        return _cut(modes(plant) if slowest is None else _in_order(plant, *slowest), count)
    stiffness, friction = -plant.A[r:, :r], -plant.A[r:, r:]
    if plant.coordinates.kind == "nodes":
        poles, vectors, labels = _node_modes(plant)
    elif is_undamped(plant):
        poles, vectors, labels = _undamped(*squared_frequencies(stiffness), _kinds(plant))
    else:
        poles, vectors, labels = _general(stiffness, friction, _kinds(plant))
    return _in_order(plant, poles, vectors, labels)


def modes_of(plant: LinearPlant, poles: np.ndarray, vectors: np.ndarray) -> Modes:
    """Return modes of a plant, of poles and displacements q, (r, k), with their labels."""
    kinds = _kinds(plant, vectors) if len(poles) else {}
    return _in_order(plant, poles, vectors, [_label(vector, kinds) for vector in vectors.T])


def _cut(whole: Modes, count: int) -> Modes:
    """Return the first modes."""
    arrays = (whole.frequency, whole.damping, whole.pole, whole.shape)
    frequency, damping, pole, shape = (frozen(np.array(array[..., :count])) for array in arrays)
    return Modes(frequency, damping, pole, shape, whole.label[:count], whole.structure, whole.nodes)


def lowest(plant: LinearPlant, count: int) -> tuple[np.ndarray, np.ndarray, list[str]] | None:
    """Return a few more than the lowest poles, Im s ≥ 0, shapes q and labels, from sparse matrices.

    None where it is easier to find all of them.
    """
    from scipy.sparse import csc_array

    system, frame = plant.sparse, plant.coordinates
    more = count + _MORE
    if system is None or not frame.is_sparse or 4 * more > plant.degrees_of_freedom:
        return None
    K, D = csc_array(system.stiffness), csc_array(system.damping)
    top = float(abs(K).sum(axis=0).max())
    # What moves the structure as one body is known, unless the ground or a load resists it.
    rigid = frame.rigid
    matrices = (matrix for matrix in (K, D) if matrix.nnz)
    if any(
        np.abs(matrix @ rigid).max(initial=0.0) > _ZERO * abs(matrix).max() for matrix in matrices
    ):
        rigid = rigid[:, :0]
    still = rigid if frame.kind == "minimal" else rigid[:, :0]
    undamped = not D.nnz and norm(K - K.T) <= _ROUND * norm(K)
    if undamped:
        values, vectors = _slowest(K, rigid, more, top)
        vectors = np.hstack([still, vectors])
        shapes = frame.from_sparse(vectors)
        values = np.concatenate([np.zeros(still.shape[1]), values])
        order = np.argsort(values, kind="stable")
        return _undamped(values[order], shapes[:, order], _kinds(plant, shapes))
    poles, vectors = _slowest_damped(K, D, rigid, more, top)
    shapes = frame.from_sparse(np.hstack([still, vectors]))
    kinds = _kinds(plant, shapes)
    poles = np.concatenate([np.zeros(still.shape[1]), poles])
    return poles, shapes, [_label(shape, kinds) for shape in shapes.T]


def _slowest(
    K: csc_array, rigid: FloatArray, count: int, top: float
) -> tuple[FloatArray, FloatArray]:
    """Return the least ω² by size and orthonormal modes of ``ÿ + K y = 0``, without the rigid."""
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import LinearOperator, eigsh, splu

    size, shift = len(rigid), _SHIFT * top
    factors = splu(K + shift * eye_array(size, format="csc"), permc_spec="MMD_AT_PLUS_A")

    inverse = LinearOperator(
        K.shape,
        lambda y: orthogonal_part(rigid, factors.solve(orthogonal_part(rigid, y))),
        dtype=float,
    )
    start = orthogonal_part(rigid, np.random.default_rng(0).normal(size=size))
    vectors = eigsh(K, count, sigma=-shift, OPinv=inverse, v0=start)[1]
    vectors = np.linalg.qr(vectors)[0]
    values, turn = np.linalg.eigh(vectors.T @ (K @ vectors))
    values[np.abs(values) < _LOST * top] = 0.0
    return values, vectors @ turn


def _slowest_damped(
    K: csc_array, D: csc_array, rigid: FloatArray, count: int, top: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the poles of least size, Im s ≥ 0, and shapes of ``ÿ + D ẏ + K y = 0``."""
    from scipy.sparse import block_array, eye_array
    from scipy.sparse.linalg import LinearOperator, eigs, splu

    m, shift = len(rigid), float(np.sqrt(_SHIFT * top))
    eye = eye_array(m, format="csc")
    factors = splu(K + shift * D + shift**2 * eye, permc_spec="MMD_AT_PLUS_A")

    def solve(z: FloatArray) -> FloatArray:
        f, g = orthogonal_part(rigid, z[:m]), orthogonal_part(rigid, z[m:])
        y = orthogonal_part(rigid, factors.solve(-(g + D @ f + shift * f)))
        return np.concatenate([y, f + shift * y])

    A = block_array([[None, eye], [-K, -D]], format="csc")
    inverse = LinearOperator(A.shape, solve, dtype=float)
    start = np.tile(orthogonal_part(rigid, np.random.default_rng(0).normal(size=m)), 2)
    poles, vectors = eigs(A, 2 * count, sigma=shift, OPinv=inverse, v0=start)
    poles[np.abs(poles) ** 2 < _LOST * top] = 0.0
    still, keep = poles == 0, (poles != 0) & (poles.imag >= 0)
    # What meets neither stiffness nor damping has one shape, but two poles.
    both = np.hstack([vectors[:m, still].real, vectors[:m, still].imag])
    U, sizes, _ = np.linalg.svd(both, full_matrices=False)
    zero = U[:, sizes > _KEPT**0.5 * sizes.max(initial=0.0)]
    shapes = vectors[:m, keep] / np.linalg.norm(vectors[:m, keep], axis=0)
    return np.concatenate([np.zeros(zero.shape[1]), poles[keep]]), np.hstack([zero, shapes])


def _in_order(
    plant: LinearPlant, poles: np.ndarray, vectors: np.ndarray, labels: list[str]
) -> Modes:
    """Return modes of a plant, of poles and displacements q, in order of frequency."""
    order = np.lexsort([_rank(labels), np.round(np.abs(poles), 9)])
    poles, vectors, labels = poles[order], vectors[:, order], [labels[i] for i in order]
    size = np.abs(poles)
    d, n = plant.nodes.shape
    moved = plant.coordinates.displacements(vectors)
    is_reduced = plant.coordinates.kind != "nodes"
    for first, last in clusters(size**2) if is_reduced else ():
        for _, same in groupby(range(first, last), labels.__getitem__):
            run = list(same)
            moved[:, run] = _settled(moved[:, run])
    shape = moved.reshape(n, d, len(order)).swapaxes(0, 1)
    shape = shape / np.linalg.norm(shape, axis=0).max(axis=0, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        damping = np.where(size > 0, -poles.real / size, 0.0)
    return Modes(
        frequency=frozen(size / (2 * np.pi)),
        damping=frozen(damping + 0.0),
        pole=frozen(poles),
        shape=frozen(shape),
        label=tuple(labels),
        structure=plant.model.structure,
        nodes=plant.nodes,
    )


def _settled(moved: np.ndarray) -> np.ndarray:
    """Return shapes of one frequency and kind, (d n, k), as no turn of them can change.

    Each has the largest displacement of a node along an axis that is left when those before it are
    taken away, and there it is positive: the first of those that are as large but for round-off.
    Modes are orthonormal in q, so turns of them are orthogonal. Of complex ones, the phases alone.
    """
    settled, left = np.zeros_like(moved), np.array(moved)
    if np.iscomplexobj(moved) and np.any(moved.imag):
        for i, shape in enumerate(moved.T):
            largest = shape[_first_largest(np.abs(shape))]
            settled[:, i] = shape * (np.conj(largest) / np.abs(largest))
        return settled
    for i in range(moved.shape[1]):
        axis = left[_first_largest(np.linalg.norm(left, axis=1))]
        axis = axis / np.linalg.norm(axis)
        settled[:, i] = left @ axis
        left -= np.outer(settled[:, i], axis)
    return settled


def _first_largest(sizes: FloatArray) -> int:
    """Return the index of the largest, the first of those that are so but for round-off."""
    return int(np.argmax(sizes >= (1 - _AS_LARGE) * sizes.max()))


def _rank(labels: list[str]) -> IntArray:
    names = ["constraint", "rigid", "affine", "mechanism", "elastic"]
    return np.array([names.index(label) for label in labels], dtype=np.int64)


def _kinds(plant: LinearPlant, shapes: np.ndarray | None = None) -> dict[str, FloatArray]:
    """Return orthonormal bases of the rigid, affine and mechanism motions in q.

    Of mechanisms, if shapes q are given, as many as these have a part in.
    """
    structure, nodes = plant.model.structure, plant.nodes
    bar_axes = structure.bar_vectors(nodes) / structure.bar_length
    rigid, affine = rigid_motions(nodes), affine_motions(nodes)
    # Affine motions count only as far as they keep supports and bar lengths, and loads in balance.
    constraints = [affine[structure.fixed_rows], _stretch(structure.bars, bar_axes, affine)]
    unhurt = affine @ _null(np.vstack([*constraints, _turned_loads(plant)]), _KEPT)
    stretch = string_stretch(structure, nodes)
    if shapes is not None and plant.coordinates.is_sparse:
        mechanism = _in_mechanisms(plant, stretch, shapes)
    else:
        bar_stretch = _stretch(structure.bars, bar_axes, plant.basis)
        mechanism = _null(np.vstack([stretch @ plant.basis, bar_stretch]))
    return {
        "rigid": _span(plant, left_by_supports(structure, rigid), rigid),
        "affine": _span(plant, unhurt, affine),
        "mechanism": mechanism,
    }


def _in_mechanisms(plant: LinearPlant, stretch: csr_array, vectors: np.ndarray) -> FloatArray:
    """Return an orthonormal basis, in q, of the mechanisms that shapes q have a part in.

    What strings resist but weakly is left by the projection, and then told apart by its stretch.
    """
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    frame = plant.coordinates
    S = stretch @ frame.sparse_basis
    largest = float(np.sqrt((S.T @ S).trace() / max(S.shape[1], 1)))
    if largest == 0.0:
        return np.eye(plant.degrees_of_freedom)
    squared = (S.T @ S) / (_WEAK * largest) ** 2
    factors = splu((eye_array(S.shape[1]) + squared).tocsc(), permc_spec="MMD_AT_PLUS_A")
    shapes = np.hstack([vectors.real, vectors.imag]) if np.iscomplexobj(vectors) else vectors
    mechanisms = factors.solve(frame.to_sparse(shapes))
    sizes = np.linalg.norm(mechanisms, axis=0)
    mechanisms = mechanisms[:, sizes > _PART]
    mechanisms = mechanisms[:, np.linalg.norm(S @ mechanisms, axis=0) <= _KEPT * largest]
    U, sizes, _ = np.linalg.svd(frame.from_sparse(mechanisms), full_matrices=False)
    return np.asarray(U[:, sizes > _PART])


def _turned_loads(plant: LinearPlant) -> FloatArray:
    """Return the forces G w, in lengths, that affine motions δn = G n + c leave unbalanced.

    Strings and bars hold the load w of a node. If their force densities stay, they hold
    ``w + G w`` in the shape after the motion.
    """
    structure = plant.model.structure
    d = structure.dimension
    load = plant.external_force.ravel(order="F")
    load = load * np.isin(np.arange(load.size), structure.free_rows)
    largest = float(np.abs(load).max(initial=0.0))
    load = load.reshape(-1, d) * float(np.ptp(plant.nodes)) / (largest or 1.0)
    turned = [np.outer(load[:, j], axis).ravel() for axis in np.eye(d) for j in range(d)]
    return np.column_stack([np.zeros((load.size, d)), *turned])[structure.free_rows]


def _stretch(pairs: IntArray, axes: FloatArray, fields: FloatArray) -> FloatArray:
    """Return the changes of length of members under displacement fields, shape (count, k)."""
    d = len(axes)
    moves = fields.reshape(len(fields) // d, d, fields.shape[1])
    return np.asarray(np.einsum("ib,bij->bj", axes, moves[pairs[:, 1]] - moves[pairs[:, 0]]))


def _undamped(
    values: FloatArray, vectors: FloatArray, kinds: dict[str, FloatArray]
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Modes of q̈ + K q = 0 of ω², ascending: real shapes, sorted within equal frequencies."""
    labels: list[str] = []
    for first, last in clusters(values):
        vectors[:, first:last], own_labels = _unmixed(vectors[:, first:last], kinds)
        labels += own_labels
    return np.sqrt((-values).astype(complex)), vectors, labels


@on_one_thread
def _general(
    stiffness: FloatArray, friction: FloatArray, kinds: dict[str, FloatArray]
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Modes of q̈ + D q̇ + K q = 0, the motions free of both set apart."""
    sizes = (max(float(np.abs(matrix).max()), 1e-300) for matrix in (stiffness, friction))
    scaled = [matrix / size for matrix, size in zip((stiffness, friction), sizes, strict=True)]
    free = _null(np.vstack(scaled))
    held = _null(free.T) if free.shape[1] else np.eye(len(stiffness))
    size = held.shape[1]
    A = np.zeros((2 * size, 2 * size))
    A[:size, size:] = np.eye(size)
    A[size:, :size], A[size:, size:] = -held.T @ stiffness @ held, -held.T @ friction @ held
    poles, vectors = np.linalg.eig(A)
    keep = poles.imag >= 0
    shapes = held @ vectors[:size, keep]
    free, free_labels = _unmixed(free, kinds)
    labels = free_labels + [_label(shape, kinds) for shape in shapes.T]
    return np.r_[np.zeros(free.shape[1], complex), poles[keep]], np.hstack([free, shapes]), labels


def _node_modes(plant: LinearPlant) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Modes in node coordinates: those of the minimal ones, and one zero for each bar length."""
    inner = modes(in_coordinates(plant, "minimal"))
    d, count = plant.nodes.shape
    shapes = inner.shape.swapaxes(0, 1).reshape(d * count, -1)
    structure = plant.model.structure
    moving = np.concatenate([structure.free_bars, structure.swinging_bars])
    bars = structure.bars[moving]
    stretched = np.zeros((count, d, len(bars)))
    half = structure.bar_vectors(plant.nodes).T[moving] / 2
    stretched[bars[:, 0], :, np.arange(len(bars))] = -half
    stretched[bars[:, 1], :, np.arange(len(bars))] = half
    stretched[structure.fixed] = 0.0
    normals = [stretched.reshape(d * count, -1)]
    for block in structure.blocks:
        normals.append(np.zeros((d * count, len(block.independent))))
        normals[-1][block.rows] = normal_basis(structure, block, plant.nodes)
    constraints = np.hstack(normals)
    lengths = constraints.shape[1]
    return (
        np.r_[np.zeros(lengths, complex), inner.pole],
        np.hstack([constraints, shapes])[structure.free_rows],
        ["constraint"] * lengths + list(inner.label),
    )


def _unmixed(vectors: np.ndarray, kinds: dict[str, FloatArray]) -> tuple[np.ndarray, list[str]]:
    """Turn a basis of a space of equal modes so that each kind shows unmixed."""
    sorted_parts, labels = [], []
    rest = vectors
    for kind, basis in kinds.items():
        if rest.shape[1] == 0 or basis.shape[1] == 0:
            continue
        U, cosines, _ = np.linalg.svd(rest.T @ basis)
        inside = int(np.count_nonzero(cosines**2 >= _SHARE))
        turned = rest @ U
        sorted_parts.append(turned[:, :inside])
        labels += [kind] * inside
        rest = turned[:, inside:]
    return np.hstack([*sorted_parts, rest]), labels + ["elastic"] * rest.shape[1]


def _label(shape: np.ndarray, kinds: dict[str, FloatArray]) -> str:
    """Return the kind of motion that has most of the kinetic energy of a shape."""
    whole = float(np.linalg.norm(shape)) ** 2
    for kind, basis in kinds.items():
        if float(np.linalg.norm(basis.T @ shape)) ** 2 >= _SHARE * whole:
            return kind
    return "elastic"


def _span(plant: LinearPlant, fields: FloatArray, every: FloatArray) -> FloatArray:
    """Return an orthonormal basis, in q, of displacement fields that are some of ``every``."""
    # What the coordinates leave out is round-off beside the fields themselves.
    if fields.shape[1] == 0:
        return np.zeros((plant.degrees_of_freedom, 0))
    U, sizes, _ = np.linalg.svd(plant.coordinates.project(fields), full_matrices=False)
    whole = np.linalg.norm(every, 2) * np.sqrt(plant.model.mass_matrix().sum())
    return np.asarray(U[:, sizes > 1e-9 * whole])


def _null(matrix: FloatArray, tolerance: float = _ZERO) -> FloatArray:
    if len(matrix) > matrix.shape[1]:
        matrix = np.asarray(np.linalg.qr(matrix, mode="r"))
    _, sizes, Vt = np.linalg.svd(matrix)
    return np.asarray(Vt[int(np.count_nonzero(sizes > tolerance * sizes.max(initial=0.0))) :].T)
