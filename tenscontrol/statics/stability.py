"""Stability of a prestressed shape: what the forces stiffen, and how stiff the whole is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.statics.equilibrium_matrix import (
    affine_picture,
    equilibrium_matrix,
    matrix_rank,
    member_basis,
    null_space,
    picture_axes,
    principal_axes,
    segment_share,
)
from tenscontrol.structure import Structure, left_by_supports, rigid_motions
from tenscontrol.validation import FloatArray, IntArray, frozen, instance, shaped

_TOLERANCE = 1e-9

# Stiffness below this part of that of all members together, signs left out, is none; or below what
# is counted as no length change at all, where the nodes have fewer digits.
_STIFF, _DIGITS = 1e-13, 10.0

# What is left of a sum that cancels.
_ROUND_OFF = 1e-12


@dataclass(frozen=True, eq=False)
class Stability:
    """What a prestress makes of the motions that the members leave free.

    Motions as one body, which the supports leave and the load does not resist, are left out.

    Attributes
    ----------
    is_stable : bool
        Whether the energy of the prestress grows along every mechanism of the
        members that carry force: *prestress stability*. The shape is then stable, a strict minimum
        of the energy, with strings that are stiff enough beside their forces, and need not be with
        softer ones: :meth:`Prestress.tangent_stiffness` says for a given stiffness. If it is False,
        no string stiffness makes the shape stable to second order.
    is_super_stable : bool
        Whether the stress matrix is positive semidefinite with the least possible rank defect (4 in
        space, 3 for a flat or planar structure), and no affine motion keeps all member lengths
        (Connelly 1999, doi:10.1007/0-306-47029-3_3): stable at any level of prestress with any
        strings, each stiffer than its γ, as all with a rest length are, and rigid in any dimension.
        Supports take away from the rank defect what
        they hold of the affine motions. With clustered strings: whether the energy ½ Σ γ L² − ½ Σ
        λ b² has no direction in which it falls, and grows along every mechanism; it says nothing
        of other dimensions.
    mechanism_stiffness : ndarray, shape (k,)
        Eigenvalues of the prestress energy on the mechanisms, N/m, ascending.
    stress_matrix_rank_defect : int
        Dimension of the null space of the stress matrix of the free nodes; with rollers, of the
        nodes free along x, y or z, whichever is largest.
    """

    is_stable: bool
    is_super_stable: bool
    mechanism_stiffness: FloatArray
    stress_matrix_rank_defect: int


@dataclass(frozen=True, eq=False)
class TangentStiffness:
    """Stiffness at rest, material and geometric, on the motions that keep the bar lengths.

    Made by :meth:`Prestress.tangent_stiffness`. Motions as one body, which the supports leave and
    the load does not resist, are left out.

    Attributes
    ----------
    is_stable : bool
        Whether all eigenvalues are positive: the shape is a strict minimum of the energy.
    eigenvalues : ndarray, shape (k,)
        Eigenvalues of the stiffness, N/m, ascending: force per displacement, each of unit norm over
        all free coordinates.
    modes : ndarray, shape (d, n, k)
        Their displacements of the nodes, of unit norm.

    Notes
    -----
    With T the tension and L the length of a string, the energy has the second derivative ::

        K = Σ (dT/dL) ∇L ∇Lᵀ + Σ T ∇²L − Σ λ ∇²(b²/2)

    over strings and bars: the first sum is the material, the rest the geometric stiffness (Guest
    2006, doi:10.1016/j.ijsolstr.2005.03.008).
    """

    is_stable: bool
    eigenvalues: FloatArray
    modes: FloatArray


def stability(
    structure: Structure, force_density: FloatArray, bar_force_density: FloatArray, loaded: bool
) -> Stability:
    """Test a balanced prestress γ, λ; strings with γ = 0 are left out, since they may go slack."""
    taut = _taut(structure, force_density)
    stiffness, gross = _geometric_stiffness(structure, force_density, bar_force_density)
    carrying = np.concatenate([taut, np.ones(len(structure.bars), bool)])
    flexes, floor = _left_free(structure, carrying, stiffness, gross, loaded)
    energy = flexes.T @ stiffness @ flexes
    has_force = bool(gross.max(initial=0.0) > 0)
    is_stable = has_force and _is_positive(energy, floor * flexes.T @ gross @ flexes)
    defects, is_definite = _stress_defects(structure, force_density, bar_force_density)
    if structure.has_clusters:
        pulls = equilibrium_matrix(structure)[structure.free_rows][:, : len(taut)]
        pulls = pulls * np.sqrt(force_density) / _lengths(structure)
        squared = stiffness + pulls @ pulls.T
        is_super = is_stable and _is_positive(squared + _TOLERANCE * gross, np.zeros_like(gross))
    else:
        axes, sizes = principal_axes(structure, _TOLERANCE)
        least = _least_defects(structure, axes / sizes)
        affine_free = _affine_motions_keeping_length(structure, taut, axes / sizes) == 0
        is_super = has_force and is_definite and defects == least
        is_super = is_super and (affine_free or max(least) == 0)
    values = np.linalg.eigvalsh(energy)
    return Stability(is_stable, is_super, frozen(values), max(defects))


def tangent_stiffness(
    structure: Structure, force_density: FloatArray, bar_force_density: FloatArray,
    stiffness: FloatArray, loaded: bool,
) -> TangentStiffness:  # fmt: skip
    """Return the stiffness of a balanced γ, λ with strings of dT/dL, shape (α,), N/m."""
    taut = _taut(structure, force_density)
    matrix, gross = _geometric_stiffness(structure, force_density, bar_force_density, every=True)
    pulls = equilibrium_matrix(structure)[structure.free_rows][:, : len(taut)][:, taut]
    pulls = pulls * np.sqrt(stiffness[taut]) / _lengths(structure)[taut]
    material = pulls @ pulls.T
    carrying = np.concatenate([np.zeros(len(taut), bool), np.ones(len(structure.bars), bool)])
    motions, floor = _left_free(structure, carrying, matrix, gross, loaded)
    matrix, gross = matrix + material, gross + material
    reduced = motions.T @ matrix @ motions
    values, vectors = np.linalg.eigh((reduced + reduced.T) / 2)
    modes = np.zeros((structure.nodes.size, len(values)))
    modes[structure.free_rows] = motions @ vectors
    shape = (structure.nodes.shape[1], structure.dimension, len(values))
    is_stable = _is_positive(reduced, floor * motions.T @ gross @ motions)
    return TangentStiffness(
        is_stable, frozen(values), frozen(modes.reshape(shape).swapaxes(0, 1).copy())
    )


def _taut(structure: Structure, force_density: FloatArray) -> np.ndarray:
    """Return which strings pull, beyond round-off in γ or in tension.

    The tension is that of the affine picture: strings of a short part of a long shape count.
    """
    axes, sizes = picture_axes(structure)
    vectors = (axes / sizes[:, None]) @ structure.string_vectors(structure.nodes)
    each = np.linalg.norm(vectors, axis=0)
    length = np.bincount(structure.segment_string, each, minlength=len(structure.strings))
    parts = (force_density, force_density * length)
    pulls = [part > _TOLERANCE * part.max(initial=0.0) for part in parts]
    return np.asarray(np.any(pulls, axis=0))


def _lengths(structure: Structure) -> FloatArray:
    """Return the string lengths, m, 1 for a string without length."""
    length = structure.string_length()
    return np.where(length > 0, length, 1.0)


def _geometric_stiffness(
    structure: Structure, gamma: FloatArray, lam: FloatArray, every: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return Σ T ∇²L − Σ λ ∇²(b²/2), shape (f, f), and the sum of the same without signs, N/m.

    Only ``every`` string has that of L; others have that of L²/2, the same where lengths keep.
    """
    rows, eye = structure.free_rows, np.eye(structure.dimension)
    at = np.ix_(rows, rows)
    stress = stress_matrix(structure, gamma, lam)
    gross = np.kron(stress_matrix(structure, gamma, -np.abs(lam)), eye)[at]
    matrix = np.kron(stress, eye)[at]
    if every or structure.has_clusters:
        # A segment that keeps its direction takes no part in ∇²L.
        vectors = structure.string_vectors(structure.nodes)
        length = np.linalg.norm(vectors, axis=0)
        share = gamma[structure.segment_string] * segment_share(structure, structure.nodes)
        along = vectors * np.sqrt(share) / np.where(length > 0, length, 1.0)
        spread = np.zeros((structure.nodes.shape[1], structure.dimension, len(share)))
        start, end = structure.segments.T
        spread[start, :, np.arange(len(share))] = -along.T
        spread[end, :, np.arange(len(share))] = along.T
        spread = spread.reshape(structure.nodes.size, -1)[rows]
        matrix = matrix - spread @ spread.T
    return np.asarray(matrix), np.asarray(gross)


def _left_free(
    structure: Structure, members: np.ndarray, stiffness: FloatArray, gross: FloatArray,
    loaded: bool,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Return a basis, shape (f, k), of the motions that keep the lengths of some members.

    Motions as one body are left out where nothing resists them. The number is the least stiffness
    that is told from none, as a part of the gross one.
    """
    rows, picture = structure.free_rows, affine_picture(structure)
    U, sizes, _, _ = member_basis(picture, equilibrium_matrix(structure)[rows][:, members])
    rank = matrix_rank(sizes)
    lost = sizes[rank:].max(initial=0.0) / sizes.max(initial=1.0)
    # A motion v of the shape is (P Pᵀ)⁻¹ P v in the picture, where motions are well apart.
    axes = picture_axes(structure)[0]
    body = rigid_motions(axes @ structure.nodes).reshape(
        -1, len(axes), len(axes) * (len(axes) + 1) // 2
    )
    body = np.einsum("ij,nik->njk", axes, body).reshape(structure.nodes.size, -1)
    body = left_by_supports(structure, body)[rows]
    pictured = (picture @ body) / picture.multiply(picture).sum(axis=1)[:, None]
    pictured /= np.maximum(np.linalg.norm(pictured, axis=0), np.finfo(float).tiny)
    pictured, extents, _ = np.linalg.svd(pictured, full_matrices=False)
    pictured = pictured[:, extents > _TOLERANCE * extents.max(initial=0.0)]
    if loaded or structure.rollers:
        resisted = stiffness @ np.linalg.qr(picture.T @ pictured)[0]
        _, forces, Vt = np.linalg.svd(resisted)
        pictured = pictured @ Vt[np.count_nonzero(forces > _TOLERANCE * gross.max()) :].T
    free = U[:, rank:]
    free = free @ null_space(pictured.T @ free)
    # Orthonormal in the shape, and across the motions that are left out.
    basis, out = (np.linalg.qr(picture.T @ part)[0] for part in (free, pictured))
    basis = np.linalg.qr(basis - out @ (out.T @ basis))[0]
    return basis, max(_STIFF, _DIGITS * float(lost))


def _stress_defects(
    structure: Structure, gamma: FloatArray, lam: FloatArray
) -> tuple[list[int], bool]:
    """Return the rank defects of the stress matrix by axis, and whether it is semidefinite."""
    stress = stress_matrix(structure, gamma, lam)
    gross = stress_matrix(structure, gamma, -np.abs(lam)).diagonal()
    # A congruence keeps the signs of eigenvalues, and tells small ones from round-off.
    scale = np.abs(stress.diagonal())
    scale = np.where(scale > _ROUND_OFF * gross, scale, gross)
    scale = np.sqrt(np.where(scale > 0, scale, 1.0))
    scaled = stress / np.outer(scale, scale)
    values = [np.linalg.eigvalsh(scaled[np.ix_(free, free)]) for free in _free_by_axis(structure)]
    defects = [int(np.count_nonzero(np.abs(found) <= _TOLERANCE)) for found in values]
    return defects, all(found.min(initial=0.0) > -_TOLERANCE for found in values)


def _least_defects(structure: Structure, picture: FloatArray) -> list[int]:
    """Return the rank defects of affine motions that the supports leave, by axis."""
    places = picture.T @ (structure.nodes - structure.nodes.mean(axis=1, keepdims=True))
    anchors = np.vstack([places, np.ones(places.shape[1])])
    least = []
    for free in _free_by_axis(structure):
        held = np.delete(anchors, free, axis=1)
        # The rank of an empty matrix is an error in NumPy 1.26.
        least.append(len(anchors) - (int(np.linalg.matrix_rank(held)) if held.size else 0))
    return least


def _free_by_axis(structure: Structure) -> list[IntArray]:
    """Return the nodes free along x, y and z, or those free at all if there are no rollers."""
    d = structure.dimension
    if not structure.rollers:
        return [structure.free]
    rows = structure.free_rows
    return [rows[rows % d == axis] // d for axis in range(d)]


def stress_matrix(
    structure: Structure, force_density: object, bar_force_density: object
) -> FloatArray:
    """Return the stress matrix Ω, K_s at rest: ``N Ω`` is the load the members need.

    Parameters
    ----------
    structure : Structure
    force_density : array_like, shape (α,)
        γ of the strings, N/m, positive in tension.
    bar_force_density : array_like, shape (β,)
        λ of the bars, N/m, positive in compression.

    Returns
    -------
    ndarray, shape (n, n)
        N/m, symmetric; rows sum to zero. Segments of clustered strings have their own γ.

    Raises
    ------
    TypeError, ValueError
        If an argument is not finite or does not fit.

    Notes
    -----
    Goyal & Skelton, eq. (9), with the λ of rest.

    Examples
    --------
    The stress matrix of a prism in balance has rank n − 4:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> stress = tc.statics.stress_matrix(prism, *tc.statics.prism_force_density(3, 10.0))
    >>> int(np.linalg.matrix_rank(stress, tol=1e-9))
    2
    """
    instance("structure", structure, Structure, "make one by Structure(...) or prism(...)")
    gamma = shaped("force_density", force_density, (len(structure.strings),), "one per string")
    lam = shaped("bar_force_density", bar_force_density, (len(structure.bars),), "one per bar")
    n = structure.nodes.shape[1]
    pairs = np.vstack([structure.segments, structure.bars])
    share = segment_share(structure, structure.nodes)
    weights = np.concatenate([gamma[structure.segment_string] * share, -lam])
    stress = np.zeros((n, n))
    start, end = pairs[:, 0], pairs[:, 1]
    np.add.at(stress, (start, start), weights)
    np.add.at(stress, (end, end), weights)
    np.add.at(stress, (start, end), -weights)
    np.add.at(stress, (end, start), -weights)
    return stress


def _affine_motions_keeping_length(
    structure: Structure, taut: np.ndarray, picture: FloatArray
) -> int:
    """Return how many independent symmetric G have ``vᵀ G v = 0`` for every member vector v."""
    strings = structure.string_vectors(structure.nodes)[:, taut]
    vectors = picture.T @ np.hstack([strings, structure.bar_vectors(structure.nodes)])
    length = np.linalg.norm(vectors, axis=0)
    vectors = vectors[:, length > 0] / length[length > 0]  # a string without length keeps nothing
    rows, columns = np.triu_indices(len(vectors))
    conic = (vectors[rows] * vectors[columns]).T
    return int(null_space(conic).shape[1])


def _is_positive(matrix: FloatArray, floor: FloatArray) -> bool:
    """Return whether ``matrix − floor`` is positive definite beyond round-off."""
    if len(matrix) == 0:
        return True
    values = np.linalg.eigvalsh((matrix + matrix.T - floor - floor.T) / 2)
    return bool(values[0] > len(values) * np.finfo(float).eps * np.abs(values).max())
