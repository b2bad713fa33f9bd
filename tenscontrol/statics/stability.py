"""Stability of a prestressed shape: whether forces stiffen what the members leave free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.statics.equilibrium_matrix import (
    equilibrium_matrix,
    member_rank,
    null_space,
    principal_axes,
)
from tenscontrol.structure import Structure, rigid_basis
from tenscontrol.validation import FloatArray, frozen, instance, shaped

_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Stability:
    """What a prestress makes of the motions that the members leave free.

    Attributes
    ----------
    is_stable : bool
        Whether the energy of the prestress grows along every mechanism of the
        members that carry force (prestress stability; sufficient for a
        strict minimum of the energy, whatever the string stiffness).
    is_super_stable : bool
        Whether the stress matrix is positive semidefinite with the least possible rank defect (4 in
        space, 3 for a flat structure), and no affine motion keeps all member lengths (Connelly
        1999, doi:10.1007/0-306-47029-3_3): stable at any level of prestress, and rigid in any
        dimension. Fixed nodes take away from the rank defect what they hold of the affine motions.
    mechanism_stiffness : ndarray, shape (k,)
        Eigenvalues of the prestress energy on the mechanisms, N/m, ascending.
    stress_matrix_rank_defect : int
        Dimension of the null space of the stress matrix of the free nodes.
    """

    is_stable: bool
    is_super_stable: bool
    mechanism_stiffness: FloatArray
    stress_matrix_rank_defect: int


def stability(
    structure: Structure, force_density: FloatArray, bar_force_density: FloatArray
) -> Stability:
    """Test a balanced prestress γ, λ; strings with γ = 0 are left out, since they may go slack."""
    taut = force_density > _TOLERANCE * np.abs(force_density).max(initial=0.0)
    stress = stress_matrix(structure, force_density, bar_force_density)
    largest = float(np.abs(stress).max(initial=0.0))

    carrying = np.concatenate([taut, np.ones(len(structure.bars), bool)])
    members = equilibrium_matrix(structure)[structure.free_rows][:, carrying]
    flexes = null_space(members.T, member_rank(structure, members))
    flexes = flexes @ null_space(rigid_basis(structure)[structure.free_rows].T @ flexes)
    # vec(N) is node by node, so the energy ½ tr(N Ω Nᵀ) has the matrix Ω ⊗ I₃.
    rows = structure.free_rows
    energy = flexes.T @ np.kron(stress, np.eye(3))[np.ix_(rows, rows)] @ flexes
    mechanism_stiffness = np.linalg.eigvalsh(0.5 * (energy + energy.T))
    is_stable = bool((mechanism_stiffness > _TOLERANCE * largest).all()) and largest > 0

    eigenvalues = np.linalg.eigvalsh(stress[np.ix_(structure.free, structure.free)])
    defect = int(np.count_nonzero(np.abs(eigenvalues) <= _TOLERANCE * largest))
    axes = principal_axes(structure, _TOLERANCE)[0]
    held = structure.nodes[:, structure.fixed]
    # The rank of an empty matrix is an error in NumPy 1.26.
    anchors = np.vstack([held, np.ones(held.shape[1])])
    supported = int(np.linalg.matrix_rank(anchors)) if held.size else 0
    least = axes.shape[1] + 1 - supported
    affine_free = _affine_motions_keeping_length(structure, taut, axes) == 0
    is_super = bool(
        eigenvalues.min() > -_TOLERANCE * largest
        and defect == least
        and (affine_free or least == 0)
        and largest > 0
    )
    return Stability(is_stable, is_super, frozen(mechanism_stiffness), defect)


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
        N/m, symmetric; rows sum to zero.

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
    pairs = np.vstack([structure.strings, structure.bars])
    weights = np.concatenate([gamma, -lam])
    stress = np.zeros((n, n))
    start, end = pairs[:, 0], pairs[:, 1]
    np.add.at(stress, (start, start), weights)
    np.add.at(stress, (end, end), weights)
    np.add.at(stress, (start, end), -weights)
    np.add.at(stress, (end, start), -weights)
    return stress


def _affine_motions_keeping_length(structure: Structure, taut: FloatArray, axes: FloatArray) -> int:
    """Return how many independent symmetric G have ``vᵀ G v = 0`` for every member vector v."""
    strings = structure.string_vectors(structure.nodes)[:, taut]
    vectors = axes.T @ np.hstack([strings, structure.bar_vectors(structure.nodes)])
    length = np.linalg.norm(vectors, axis=0)
    vectors = vectors[:, length > 0] / length[length > 0]  # a string without length keeps nothing
    rows, columns = np.triu_indices(axes.shape[1])
    conic = (vectors[rows] * vectors[columns]).T
    return int(null_space(conic).shape[1])
