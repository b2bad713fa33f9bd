"""Stability of a prestressed shape."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.short_repr import short_repr
from tenscontrol.statics.equilibrium_matrix import (
    affine_picture,
    is_small,
    kept_lengths,
    null_space,
    orthogonal_part,
    picture_axes,
    pictured_members,
    possible_mechanisms,
    principal_axes,
    rigid_picture,
    segment_share,
    sparse_equilibrium_matrix,
)
from tenscontrol.statics.inertia import factorized, held_factors, nearly_null
from tenscontrol.structure.blocks import bar_rows
from tenscontrol.structure.structure import Structure

if TYPE_CHECKING:
    from collections.abc import Callable

    from scipy.sparse import csc_array, csr_array
    from scipy.sparse.linalg import SuperLU

_TOLERANCE = 1e-9

# Stiffness below this part of that of all members together, signs left out, is none; or below what
# is counted as no length change at all, where the nodes have fewer digits.
_STIFF, _DIGITS = 1e-13, 10.0

# Eigenvalues next to zero are found from here.
_ASIDE = 1e-4

# More eigenvalues than are asked for.
_MORE = 6

# Pivots of this size are round-off.
_NO_PIVOT = 1e-11

# Stiffness of bars, parts of the largest stiffness, in whose place rigid ones are.
_RIGID = 1e4

# Mechanisms from which on their lowest stiffnesses alone are found, and how many of these.
_MANY, _LOWEST = 100, 20

# Give of what keeps lengths, the least shift from zero, parts of the stiffness, and its growth.
_GIVE, _NEAR_ZERO, _FARTHER = 1e-13, 1e-11, 8.0

# Part of a motion by which factors without pivoting may be off.
_SOLVED = 1e-7

# Change of length of a motion that keeps lengths, per length of the motion.
_KEEPS = 1e-6

# What is left of a sum that cancels.
_ROUND_OFF = 1e-12


@dataclass(frozen=True, eq=False)
class Stability:
    """Stability of a prestress: the stiffness that it gives to mechanisms.

    Rigid-body motions, which the supports leave and the load does not resist, are left out.

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
        Eigenvalues of the prestress energy on the mechanisms, N/m, ascending. Of a structure with
        more than 300 free coordinates and 100 mechanisms, the 20 lowest.
    stress_matrix_rank_defect : int
        Dimension of the null space of the stress matrix of the free nodes; with rollers, of the
        nodes free along x, y or z, whichever is largest.
    """

    is_stable: bool
    is_super_stable: bool
    mechanism_stiffness: FloatArray
    stress_matrix_rank_defect: int

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class TangentStiffness:
    """Stiffness at rest, material and geometric, on the motions that keep the bar lengths.

    Made by :meth:`Prestress.tangent_stiffness`. Rigid-body motions, which the supports leave and
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

    __repr__ = short_repr


def stability(
    structure: Structure, force_density: FloatArray, bar_force_density: FloatArray, loaded: bool
) -> Stability:
    """Test a balanced prestress γ, λ; strings with γ = 0 are left out, since they may go slack."""
    taut = _taut(structure, force_density)
    stiffness, gross = _geometric_stiffness(structure, force_density, bar_force_density)
    carrying = np.concatenate([taut, np.ones(len(structure.bars), bool)])
    has_force = bool(gross.max() > 0)
    values, is_stable = _mechanisms(structure, carrying, stiffness, gross, loaded)
    is_stable = has_force and is_stable
    defects, is_definite = _stress_defects(structure, force_density, bar_force_density)
    if structure.has_clusters:
        pulls = _pulls(structure, np.sqrt(force_density))
        squared = stiffness + pulls @ pulls.T + _TOLERANCE * gross
        is_super = is_stable and _is_definite(squared)
    else:
        axes, sizes = principal_axes(structure, _TOLERANCE)
        least = _least_defects(structure, axes / sizes)
        affine_free = _affine_motions_keeping_length(structure, taut, axes / sizes) == 0
        is_super = has_force and is_definite and defects == least
        is_super = is_super and (affine_free or max(least) == 0)
    return Stability(is_stable, is_super, frozen(values), max(defects))


def _mechanisms(
    structure: Structure, members: np.ndarray, stiffness: csc_array, gross: csc_array, loaded: bool
) -> tuple[FloatArray, bool]:
    """Return eigenvalues of the energy on the motions that keep lengths, and if all are positive.

    The lowest, where there may be many such motions.
    """
    if not is_small(stiffness):
        picture = affine_picture(structure)
        E = sparse_equilibrium_matrix(structure, structure.nodes).tocsr()[structure.free_rows]
        factors = possible_mechanisms(structure, picture, E.tocsc()[:, members])
        if len(factors.doubtful) > _MANY:
            out = _unresisted(structure, picture, stiffness, gross, loaded)
            out = np.linalg.qr(picture.T @ out)[0]
            return _softest(pictured_members(picture, E.tocsc()[:, members])[0], picture,
                            stiffness, gross, out)  # fmt: skip
    flexes, floor = _left_free(structure, members, stiffness, gross, loaded)
    energy = flexes.T @ (stiffness @ flexes)
    return np.linalg.eigvalsh(energy), _is_positive(energy, floor * flexes.T @ (gross @ flexes))


def _softest(
    pictured: csc_array, picture: csr_array, stiffness: csc_array, gross: csc_array,
    out: FloatArray,
) -> tuple[FloatArray, bool]:  # fmt: skip
    """Return the lowest stiffnesses of motions that keep lengths, across those left out.

    By Lanczos' method on the inverse, shifted to below them: to where the matrix with stiff members
    in place of rigid ones is positive definite. ``pictured`` are unit columns of the picture.
    """
    from scipy.sparse import block_array, eye_array
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

    f, size = len(out), float(gross.diagonal().max())
    size, shift = size or 1.0, _NEAR_ZERO * (size or 1.0)
    # Congruent to the stiffness in the picture, in which constraints are well apart.
    inertia = (picture @ picture.T).tocsc()
    energy = (picture @ stiffness @ picture.T).tocsc()
    unit = size * float(inertia.diagonal().max())
    squares = _RIGID * unit * (pictured @ pictured.T)
    body = np.linalg.qr(_in_picture(picture, out))[0]
    while True:
        stiff = held_factors((energy + shift * inertia + squares).tocsc(), body)
        if stiff.is_semidefinite and stiff.pivots.min() > -_NO_PIVOT:
            break
        shift *= _FARTHER
    give = _GIVE * eye_array(pictured.shape[1])
    held = [[(energy + shift * inertia) / unit, pictured], [pictured.T, -give]]
    saddle = block_array(held, format="csc")
    none = np.zeros(pictured.shape[1])

    def applied(force: FloatArray) -> FloatArray:
        return np.concatenate([picture @ orthogonal_part(out, force.ravel()), none])

    def motion(solution: FloatArray) -> FloatArray:
        return orthogonal_part(out, picture.T @ solution[:f])

    load = np.cos(np.arange(1.0, f + 1) ** 2)  # any
    factors = _factors_of_saddle(saddle, applied(load), motion)

    def inverse(force: FloatArray) -> FloatArray:
        return motion(factors.solve(applied(force)))

    start = inverse(load)
    operator = LinearOperator((f, f), matvec=inverse, dtype=float)
    more = _LOWEST + _MORE
    try:
        _, vectors = eigsh(operator, more, which="LM", v0=start, ncv=3 * more)
    except ArpackNoConvergence as error:  # there are fewer
        vectors = error.eigenvectors
        if not vectors.shape[1]:
            raise ArithmeticError(
                "the lowest stiffnesses of the mechanisms were not found; give the structure more "
                "strings, or fewer members"
            ) from error
    vectors = np.linalg.qr(vectors)[0]
    changes = np.linalg.norm(pictured.T @ _in_picture(picture, vectors), axis=0)
    moved = np.linalg.norm(_in_picture(picture, vectors), axis=0)
    vectors = vectors[:, changes <= _KEEPS * moved]
    values, turn = np.linalg.eigh(vectors.T @ (stiffness @ vectors))
    if not len(values):
        return values, True
    lowest = vectors @ turn[:, 0]
    floor = max(_STIFF * float(lowest @ (gross @ lowest)), f * np.finfo(float).eps * size)
    return values[:_LOWEST], bool(values[0] > floor)


def _factors_of_saddle(
    saddle: csc_array, right: FloatArray, motion: Callable[[FloatArray], FloatArray]
) -> SuperLU:
    """Return the factors of a symmetric matrix that is not definite.

    Without pivoting those of a net have a quarter of the entries. They are taken where a step of
    refinement leaves the motion of a solution, for a given right side, as it is: what is left of
    the right side grows with the rigid-body motions, which are no part of it. Where bars share
    nodes they may not be good enough, as pivots may be round-off.
    """
    from scipy.sparse.linalg import splu

    how = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    with suppress(RuntimeError):  # a pivot that is zero
        factors = splu(saddle, permc_spec="MMD_AT_PLUS_A", **how)
        solution = factors.solve(right)
        correction = motion(factors.solve(right - saddle @ solution))
        if np.linalg.norm(correction) < _SOLVED * np.linalg.norm(motion(solution)):
            return factors
    return splu(saddle)


def _in_picture(picture: csr_array, motions: FloatArray) -> FloatArray:
    """Return y of motions ``x = Pᵀ y``."""
    return np.asarray((picture @ motions) / picture.multiply(picture).sum(axis=1)[:, None])


def tangent_stiffness(
    structure: Structure, force_density: FloatArray, bar_force_density: FloatArray,
    stiffness: FloatArray, loaded: bool, count: int | None = None,
) -> TangentStiffness:  # fmt: skip
    """Return the stiffness of a balanced γ, λ with strings of dT/dL, shape (α,), N/m.

    The ``count`` lowest eigenvalues, or all.
    """
    taut = _taut(structure, force_density)
    geometric, gross = _geometric_stiffness(structure, force_density, bar_force_density, every=True)
    pulls = _pulls(structure, np.sqrt(np.where(taut, stiffness, 0.0)))
    material = pulls @ pulls.T
    if count is None or is_small(geometric):
        rows = geometric.shape[0]
        hint = ". Give count, a number of lowest eigenvalues"
        validation.refuse_memory(f"structure has {rows} free coordinates", 3 * rows**2,
                      "numbers in its stiffness and modes", 8, hint)  # fmt: skip
        carrying = np.concatenate([np.zeros(len(taut), bool), np.ones(len(structure.bars), bool)])
        motions, floor = _left_free(structure, carrying, geometric, gross, loaded)
        reduced = motions.T @ ((geometric + material) @ motions)
        values, vectors = np.linalg.eigh((reduced + reduced.T) / 2)
        is_stable = _is_positive(reduced, floor * motions.T @ ((gross + material) @ motions))
        values, vectors = values[:count], motions @ vectors[:, :count]
    else:
        picture = affine_picture(structure)
        out = _unresisted(structure, picture, geometric, gross, loaded)
        out = np.linalg.qr(picture.T @ out)[0]
        values, vectors, is_stable = _lowest(
            structure, geometric, material, gross + material, out, count
        )
    modes = np.zeros((structure.nodes.size, len(values)))
    modes[structure.free_rows] = vectors
    shape = (structure.nodes.shape[1], structure.dimension, len(values))
    return TangentStiffness(
        is_stable, frozen(values), frozen(modes.reshape(shape).swapaxes(0, 1).copy())
    )


def _lowest(
    structure: Structure, geometric: csc_array, material: csc_array, gross: csc_array,
    out: FloatArray, count: int,
) -> tuple[FloatArray, FloatArray, bool]:  # fmt: skip
    """Return the lowest eigenvalues on the motions that keep bar lengths, across those left out.

    With their vectors, and whether all eigenvalues are positive.
    """
    from scipy.sparse import block_array, diags_array, eye_array
    from scipy.sparse.linalg import LinearOperator, eigsh, splu

    matrix = (geometric + material).tocsc()
    f, bars = matrix.shape[0], structure.kept_bars
    J = bar_rows(structure, bars, structure.nodes)[:, structure.free_rows]
    J = (diags_array(1 / np.sqrt(J.multiply(J).sum(axis=1))) @ J).tocsr()
    size = float(gross.diagonal().max())
    # Stiff bars in place of rigid ones: where all pivots are positive, all eigenvalues are.
    stiff = held_factors((matrix + _RIGID * size * (J.T @ J)).tocsc(), out)
    is_definite = stiff.is_semidefinite and stiff.pivots.min() > _NO_PIVOT
    # Else the lowest are sought from below all of them, where the search takes longer.
    below = 0.0 if is_definite else -2.0 * float(abs(geometric).sum(axis=1).max() or size)
    shifted = matrix - below * eye_array(f)
    if is_definite:
        shifted = shifted + diags_array(size * stiff.held)
    factors = splu(block_array([[shifted, J.T], [J, None]], format="csc"))

    def inverse(vector: FloatArray) -> FloatArray:
        right = np.concatenate([orthogonal_part(out, vector.ravel()), np.zeros(len(bars))])
        return orthogonal_part(out, factors.solve(right)[:f])

    # Some more, so that none of several equal ones is missed.
    more = min(count + _MORE, f - len(bars) - out.shape[1], f - 1)
    if more < 1:
        return np.zeros(0), np.zeros((f, 0)), True
    start = inverse(np.cos(np.arange(1.0, f + 1) ** 2))  # any
    operator = LinearOperator((f, f), matvec=inverse, dtype=float)
    _, vectors = eigsh(operator, more, which="LA", v0=start, ncv=min(f, 2 * more + 20))
    vectors = np.linalg.qr(vectors)[0]
    values, turn = np.linalg.eigh(vectors.T @ (matrix @ vectors))
    floor = _STIFF * float(vectors[:, 0] @ (gross @ vectors[:, 0]))
    return values[:count], (vectors @ turn)[:, :count], bool(is_definite or values[0] > floor)


def _taut(structure: Structure, force_density: FloatArray) -> np.ndarray:
    """Return which strings pull, beyond round-off in γ or in tension.

    The tension is that of the affine picture: strings of a short part of a long shape count.
    """
    axes, sizes = picture_axes(structure)
    vectors = (axes / sizes[:, None]) @ structure.string_vectors(structure.nodes)
    segment_length = np.linalg.norm(vectors, axis=0)
    length = np.bincount(structure.segment_string, segment_length, minlength=len(structure.strings))
    measures = (force_density, force_density * length)
    pulls = [measure > _TOLERANCE * measure.max(initial=0.0) for measure in measures]
    return np.asarray(np.any(pulls, axis=0))


def _pulls(structure: Structure, weight: FloatArray) -> csc_array:
    """Return ∇L of the strings for the free coordinates, times weights, shape (f, α)."""
    from scipy.sparse import diags_array

    length = structure.string_length()
    length = np.where(length > 0, length, 1.0)
    E = sparse_equilibrium_matrix(structure, structure.nodes)[:, : len(length)]
    return (E.tocsr()[structure.free_rows] @ diags_array(weight / length)).tocsc()


def _geometric_stiffness(
    structure: Structure, gamma: FloatArray, lam: FloatArray, every: bool = False
) -> tuple[csc_array, csc_array]:
    """Return Σ T ∇²L − Σ λ ∇²(b²/2), shape (f, f), and the sum of the same without signs, N/m.

    Only ``every`` string has that of L; others have that of L²/2, the same where lengths keep.
    """
    from scipy.sparse import csc_array, eye_array, kron

    rows, eye = structure.free_rows, eye_array(structure.dimension)
    matrix, gross = (
        csc_array(
            kron(_sparse_stress(structure, gamma, bar_density), eye, format="csr")[rows][:, rows]
        )
        for bar_density in (lam, -np.abs(lam))
    )
    if every or structure.has_clusters:
        # A segment that keeps its direction takes no part in ∇²L.
        vectors = structure.string_vectors(structure.nodes)
        length = np.linalg.norm(vectors, axis=0)
        share = gamma[structure.segment_string] * segment_share(structure, structure.nodes)
        along = vectors * np.sqrt(share) / np.where(length > 0, length, 1.0)
        row = structure.dimension * structure.segments[:, :, None] + np.arange(structure.dimension)
        column = np.broadcast_to(np.arange(len(share))[:, None, None], row.shape)
        values = np.stack([-along.T, along.T], axis=1)
        spread = csc_array(
            (values.ravel(), (row.ravel(), column.ravel())),
            shape=(structure.nodes.size, len(share)),
        ).tocsr()[rows]
        matrix = csc_array(matrix - spread @ spread.T)
    return matrix, gross


def _left_free(
    structure: Structure, members: np.ndarray, stiffness: csc_array, gross: csc_array,
    loaded: bool,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Return a basis, shape (f, k), of the motions that keep the lengths of some members.

    Rigid-body motions are left out where nothing resists them. The number is the least stiffness
    that is told from none, as a part of the gross one.
    """
    E = sparse_equilibrium_matrix(structure, structure.nodes).tocsr()[structure.free_rows]
    picture = affine_picture(structure)
    keeping = kept_lengths(structure, picture, E.tocsc()[:, members])
    pictured = _unresisted(structure, picture, stiffness, gross, loaded)
    free = keeping.motions
    free = free @ null_space(pictured.T @ free)
    # Orthonormal in the shape, and across the motions that are left out.
    basis, out = (np.linalg.qr(picture.T @ motions)[0] for motions in (free, pictured))
    basis = np.linalg.qr(orthogonal_part(out, basis))[0]
    return basis, max(_STIFF, _DIGITS * keeping.lost)


def _unresisted(
    structure: Structure, picture: csc_array, stiffness: csc_array, gross: csc_array, loaded: bool
) -> FloatArray:
    """Return the rigid-body motions that nothing resists, orthonormal in the picture."""
    pictured = rigid_picture(structure, picture)
    if loaded or structure.rollers:
        resisted = stiffness @ np.linalg.qr(picture.T @ pictured)[0]
        _, forces, Vt = np.linalg.svd(resisted, full_matrices=len(resisted) < resisted.shape[1])
        pictured = pictured @ Vt[np.count_nonzero(forces > _TOLERANCE * gross.max()) :].T
    return pictured


def _stress_defects(
    structure: Structure, gamma: FloatArray, lam: FloatArray
) -> tuple[list[int], bool]:
    """Return the rank defects of the stress matrix by axis, and whether it is semidefinite."""
    from scipy.sparse import diags_array

    stress = _sparse_stress(structure, gamma, lam)
    gross = _sparse_stress(structure, gamma, -np.abs(lam)).diagonal()
    # A congruence keeps the signs of eigenvalues, and tells small ones from round-off.
    scale = np.abs(stress.diagonal())
    scale = np.where(scale > _ROUND_OFF * gross, scale, gross)
    scale = np.sqrt(np.where(scale > 0, scale, 1.0))
    scaled = (diags_array(1 / scale) @ stress @ diags_array(1 / scale)).tocsr()
    defects = []
    for free in _free_by_axis(structure):
        block = scaled[free][:, free].tocsc()
        if is_small(block):
            values = np.linalg.eigvalsh(block.toarray())
            defect = int(np.count_nonzero(np.abs(values) <= _TOLERANCE))
            defects.append((defect, bool(values.min(initial=0.0) > -_TOLERANCE)))
        else:
            defects.append(_sparse_defect(block, _affine_fields(structure, free, scale)))
    return [defect for defect, _ in defects], all(is_definite for _, is_definite in defects)


def _affine_fields(structure: Structure, free: IntArray, scale: FloatArray) -> FloatArray:
    """Return affine functions of the place that are zero at the other nodes, at the free ones."""
    axes, sizes = principal_axes(structure, _TOLERANCE)
    places = (axes / sizes).T @ (structure.nodes - structure.nodes.mean(axis=1, keepdims=True))
    anchors = np.vstack([places, np.full(places.shape[1], places.shape[1] ** -0.5)])
    held = np.delete(anchors, free, axis=1)
    left = null_space(held.T) if held.size else np.eye(len(anchors))
    return np.asarray(np.linalg.qr((left.T @ anchors)[:, free].T * scale[free, None])[0])


def _sparse_defect(matrix: csc_array, fields: FloatArray) -> tuple[int, bool]:
    """Return the rank defect of a stress matrix with a diagonal of 1, and if it is semidefinite.

    Motions that it does not resist are among the fields, as a rule all.
    """
    from scipy.sparse import eye_array

    _, forces, Vt = np.linalg.svd(matrix @ fields, full_matrices=False)
    fields = fields @ Vt[np.count_nonzero(forces > _TOLERANCE) :].T
    factors = held_factors(matrix, fields)
    if len(factors.doubtful) > _MANY:
        # By Sylvester's law, on both sides of zero.
        eye = eye_array(matrix.shape[0])
        sides = [factorized((matrix + t * eye).tocsc()) for t in (_TOLERANCE, -_TOLERANCE)]
        if all(side.is_symmetric for side in sides):
            negative, upto_zero = (int(np.count_nonzero(side.pivots < 0)) for side in sides)
            return upto_zero - negative, negative == 0
    vectors = nearly_null(factors, 0)
    vectors = np.linalg.qr(orthogonal_part(fields, vectors))[0]
    values = np.linalg.eigvalsh(vectors.T @ (matrix @ vectors))
    if factors.is_semidefinite and values.min(initial=0.0) > -_TOLERANCE:
        return fields.shape[1] + int(np.count_nonzero(values <= _TOLERANCE)), True
    return _near_zero(matrix, fields.shape[1]), False


def _near_zero(matrix: csc_array, expected: int) -> int:
    """Return how many eigenvalues of a symmetric matrix with a diagonal of 1 are zero."""
    from scipy.sparse.linalg import eigsh

    count, n = expected, matrix.shape[0]
    while True:
        count = 2 * count + 2
        if count >= n:
            values = np.linalg.eigvalsh(matrix.toarray())
        else:
            start = np.cos(np.arange(1.0, n + 1) ** 2)  # any
            values = eigsh(matrix, count, sigma=_ASIDE, v0=start, return_eigenvectors=False)
        zero = int(np.count_nonzero(np.abs(values) <= _TOLERANCE))
        if zero < len(values) or count >= n:
            return zero


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
    validation.instance(
        "structure", structure, Structure, "make one by Structure(...) or prism(...)"
    )
    gamma = validation.shaped(
        "force_density", force_density, (len(structure.strings),), "one per string"
    )
    lam = validation.shaped(
        "bar_force_density", bar_force_density, (len(structure.bars),), "one per bar"
    )
    n = structure.nodes.shape[1]
    validation.refuse_memory(f"structure has {n} nodes", n**2, "numbers in its stress matrix", 8)
    return np.asarray(_sparse_stress(structure, gamma, lam).toarray())


def _sparse_stress(structure: Structure, gamma: FloatArray, lam: FloatArray) -> csr_array:
    """Return the stress matrix, sparse."""
    from scipy.sparse import csr_array

    n = structure.nodes.shape[1]
    start, end = np.vstack([structure.segments, structure.bars]).T
    share = segment_share(structure, structure.nodes)
    weights = np.concatenate([gamma[structure.segment_string] * share, -lam])
    rows, columns = (
        np.concatenate([start, end, start, end]),
        np.concatenate([start, end, end, start]),
    )
    values = np.concatenate([weights, weights, -weights, -weights])
    return csr_array((values, (rows, columns)), shape=(n, n))


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


def _is_definite(matrix: csc_array) -> bool:
    """Return whether a sparse matrix is positive definite beyond round-off."""
    if is_small(matrix):
        return _is_positive(matrix.toarray(), np.zeros(matrix.shape))
    return bool(factorized(matrix.tocsc()).pivots.min() > _ROUND_OFF)
