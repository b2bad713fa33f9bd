"""Equations of motion made linear on the motions that keep bar lengths."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.dynamics.force import Pass
from tenscontrol.dynamics.model import Model
from tenscontrol.structure.blocks import Block, bar_rows, block_mass, is_independent, node_mass
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import left_by_supports, rigid_motions

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array
    from scipy.sparse.linalg import SuperLU


# Directions whose singular value is below this fraction of the largest do not exist.
_RANK_TOLERANCE = 1e-9

# Steps at most to lay a shape over another; it lies there when the next one is below this part of
# its size.
_MOST, _LAID = 30, 1e-15

# Rows of a segment of a long chain at least, the groups before that its motions meet, and parts of
# the largest displacement that are round-off.
_SEGMENT, _BEFORE, _NEGLIGIBLE = 60, 3, 1e-17

# Entries of a dense matrix, 512 MB, beyond which it is refused.
_MOST_ENTRIES = 64_000_000


class Complement:
    """An orthonormal basis H of what is orthogonal to a few columns, shape (m, r), as a product.

    Of Householder's reflections, ``I − V S Vᵀ`` without its first columns: work and memory grow
    with m, not with its square.
    """

    def __init__(self, vectors: FloatArray) -> None:
        U, sizes, _ = np.linalg.svd(vectors, full_matrices=False)
        U = U[:, sizes > _RANK_TOLERANCE * sizes.max(initial=0.0)]
        #: An orthonormal basis of the columns themselves, shape (m, k), turned to the first ones.
        #: U is one of many where singular values are equal, and another one by another library.
        self.outside = U @ np.linalg.qr(U.T @ vectors)[0]
        m, k = U.shape
        raw, scale = np.linalg.qr(self.outside, mode="raw")
        V = np.tril(raw.T[:, :k], -1)
        V[np.arange(k), np.arange(k)] = 1.0
        S = np.zeros((k, k))
        for i in range(k):
            S[:i, i] = -scale[i] * S[:i, :i] @ (V[:, :i].T @ V[:, i])
            S[i, i] = scale[i]
        self._reflections, self.shape = (V, S), (m, m - k)

    def __matmul__(self, values: FloatArray) -> FloatArray:
        """Return H x, shape (m,) or (m, k)."""
        V, S = self._reflections
        whole = np.concatenate([np.zeros((len(V) - len(values), *values.shape[1:])), values])
        return np.asarray(whole - V @ (S @ (V.T @ whole)))

    def transposed(self, values: FloatArray) -> FloatArray:
        """Return Hᵀ y, shape (r,) or (r, k)."""
        V, S = self._reflections
        turned = values - V @ (S.T @ (V.T @ values))
        return np.asarray(turned[S.shape[0] :])


def bar_basis(structure: Structure, nodes: FloatArray) -> csr_array:
    """Return the mass-orthonormal basis of motions that keep bar lengths, shape (d n, r).

    In closed form for bars on their own, in space three translations ``e/√m`` and two rotations in
    which the ends move by ``∓ t √(3/m)`` across the bar; for a bar that swings about a fixed end
    the rotations ``t √(3/m)`` of the other; translations ``e/√m_s`` for a string node. For each
    block the null space of its constraints in the metric of its mass.
    """
    from scipy.sparse import csr_array

    d = structure.dimension
    # Rows of the basis, shape (k, a), with columns of a part each, shape (k, a, b).
    blocks: list[tuple[IntArray, FloatArray]] = []
    mass, ends = structure.bar_mass[structure.free_bars], structure.bars[structure.free_bars]
    across = _across(nodes[:, ends[:, 1]] - nodes[:, ends[:, 0]])
    across = across * np.sqrt(3 / mass)[:, None, None]
    shift = np.eye(d) / np.sqrt(mass)[:, None, None]
    both = [np.concatenate([shift, turn], axis=2) for turn in (-across, across)]
    blocks.append((_rows(ends, d), np.concatenate(both, axis=1)))
    mass, (hinge, tip) = structure.bar_mass[structure.swinging_bars], structure.hinged_pairs.T
    across = _across(nodes[:, tip] - nodes[:, hinge]) * np.sqrt(3 / mass)[:, None, None]
    blocks.append((_rows(tip[:, None], d), across))
    rows = _rows(structure.string_nodes[:, None], d)
    alone = np.isin(rows, structure.free_rows)
    by_row = np.repeat(1 / np.sqrt(structure.string_node_mass), d).reshape(-1, d)
    blocks.append((rows[alone][:, None], by_row[alone][:, None, None]))
    for block in structure.blocks:
        for start, own in _block_basis(structure, block, nodes):
            blocks.append((block.rows[None, start : start + len(own)], own[None]))
    row, column, value, count = [], [], [], 0
    for places, values in blocks:
        k, _, b = values.shape
        columns = count + np.arange(k * b).reshape(k, 1, b)
        row.append(np.broadcast_to(places[:, :, None], values.shape).ravel())
        column.append(np.broadcast_to(columns, values.shape).ravel())
        value.append(values.ravel())
        count += k * b
    indices = (np.concatenate(entries) for entries in (row, column))
    basis = csr_array((np.concatenate(value), tuple(indices)), shape=(nodes.size, count))
    basis.eliminate_zeros()
    return basis


def _block_basis(
    structure: Structure, block: Block, nodes: FloatArray
) -> list[tuple[int, FloatArray]]:
    """Return the columns of a block's basis in groups, each with the first of its rows.

    A long chain has motions that keep lengths within each segment of its rows, and others in each
    two neighbours. They are made orthonormal group by group: what that adds of the groups before
    decays along the chain.
    """
    mass, count = block_mass(structure, block).tocsr(), len(block.rows)
    J = bar_rows(structure, block.independent, nodes)[:, block.rows].tocsc()
    length = max(_SEGMENT, _bandwidth(J.tocsr()), _bandwidth(mass))
    if 2 * length <= count and is_independent(J):
        groups = _by_segments(J, mass, [*range(0, count - length + 1, length), count])
        if sum(basis.shape[1] for _, basis in groups) == count - J.shape[0]:
            return groups
    L = np.linalg.cholesky(mass.toarray())
    _scaled_rows(structure, block, nodes, L)  # no dead centre
    return [(0, _null(J, mass, 0, count))]


def _by_segments(J: csc_array, mass: csr_array, edges: list[int]) -> list[tuple[int, FloatArray]]:
    """Return mass-orthonormal motions of segments of rows and of each two neighbours that J keeps.

    J and the mass join neighbours alone.
    """
    from scipy import linalg

    within = [_null(J, mass, *ends) for ends in pairwise(edges)]
    groups: list[tuple[int, FloatArray]] = []
    for i, added in enumerate(within):
        start, end = edges[i], edges[min(i + 2, len(edges) - 1)]
        if i + 1 < len(within):
            apart = linalg.block_diag(added, within[i + 1])
            both = _null(J, mass, start, end)
            shares = both.T @ (mass[start:end, start:end] @ apart)
            across = both @ np.linalg.qr(shares, mode="complete")[0][:, apart.shape[1] :]
            added = np.hstack([apart[:, : added.shape[1]], across])
        for _ in range(2):  # the second time for the digits that the first one lost
            start, added = _orthonormal(mass, groups[-_BEFORE:], start, added)
        groups.append((start, added))
    return groups


def _null(J: csc_array, mass: csr_array, start: int, end: int) -> FloatArray:
    """Return mass-orthonormal motions of a segment of rows, all others at rest, that J keeps."""
    rows = J[:, start:end]
    # y = Lᵀ δ has the identity for a mass, where M = L Lᵀ.
    L = np.linalg.cholesky(mass[start:end, start:end].toarray())
    constraints = np.linalg.solve(L, rows[np.unique(rows.indices)].toarray().T)
    constraints /= np.maximum(np.linalg.norm(constraints, axis=0), np.finfo(float).tiny)
    directions, sizes, _ = np.linalg.svd(constraints)
    rank = np.count_nonzero(sizes > _RANK_TOLERANCE * sizes.max(initial=0.0))
    return np.asarray(np.linalg.solve(L.T, directions[:, rank:]))


def _orthonormal(
    mass: csr_array, before: list[tuple[int, FloatArray]], start: int, motions: FloatArray
) -> tuple[int, FloatArray]:
    """Return motions from a row on, orthonormal and across those before, less what is round-off."""
    first, end = min([start, *(row for row, _ in before)]), start + len(motions)
    motions = np.vstack([np.zeros((start - first, motions.shape[1])), motions])
    for row, other in before:
        rows = slice(row - first, row - first + len(other))
        moments = mass[row : row + len(other), first:end] @ motions
        motions[rows] -= other @ (other.T @ moments)
    squares = motions.T @ (mass[first:end, first:end] @ motions)
    motions = np.asarray(np.linalg.solve(np.linalg.cholesky(squares), motions.T).T)
    sizes = np.abs(motions).max(axis=1)
    leading = int(np.flatnonzero(sizes > _NEGLIGIBLE * sizes.max())[0])
    return first + leading, motions[leading:]


def _bandwidth(matrix: csr_array) -> int:
    """Return how many columns, from the first to the last, the rows of a matrix have entries in."""
    ends = [matrix.indices[slice(*ends)] for ends in pairwise(matrix.indptr.tolist())]
    return max((int(np.ptp(row)) + 1 for row in ends if len(row)), default=1)


def motions_kept(fields: FloatArray, held: IntArray) -> FloatArray:
    """Return the combinations of rigid-body motions, shape (k, ·), that move no held row."""
    from scipy.linalg import null_space

    size = np.maximum(np.linalg.norm(fields, axis=0), np.finfo(float).tiny)
    if not len(held):  # which older SciPy cannot take
        return np.asarray(np.diag(1 / size))
    return np.asarray(null_space(fields[held] / size, _RANK_TOLERANCE) / size[:, None])


def moved_as_one(nodes: FloatArray, move: Any) -> tuple[FloatArray, FloatArray]:
    """Return nodes after a screw, of the rates of :func:`rigid_motions`, and its turn."""
    from scipy.linalg import expm

    d = len(nodes)
    spin = np.concatenate([np.zeros(3), move[d:]])[-3:]  # in the plane about z alone
    screw = np.zeros((d + 1, d + 1))
    screw[:d, :d], screw[:d, d] = np.cross(spin, np.eye(3)).T[:d, :d], move[:d]
    whole, centre = expm(screw), nodes.mean(axis=1, keepdims=True)
    return whole[:d, :d] @ (nodes - centre) + whole[:d, d:] + centre, whole[:d, :d]


def laid_along_supports(
    structure: Structure, reference: FloatArray, mass: csr_array, nodes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return nodes laid over a reference by the motions that supports leave, and their turn.

    By Gauss-Newton steps along motions that keep nodes where supports hold them: first to the
    nearest shape, from however far; then until the displacement has no part along such motions
    of the reference, which is the same unless they change their direction, as on two slides.
    """
    held, turn = structure.fixed_rows, np.eye(len(nodes))
    own = momenta(mass, left_by_supports(structure, rigid_motions(reference))).T
    for nearest in (True, False):
        for _ in range(_MOST):
            fields, off = rigid_motions(nodes), (nodes - reference).ravel(order="F")
            back = np.linalg.lstsq(fields[held], -off[held], _RANK_TOLERANCE)[0]
            left = motions_kept(fields, held)
            moves = fields @ left
            along = momenta(mass, moves).T if nearest else own
            wanted = -along @ (off + fields @ back)
            move = back + left @ np.linalg.lstsq(along @ moves, wanted, _RANK_TOLERANCE)[0]
            nodes, step = moved_as_one(nodes, move)
            turn = step @ turn
            if np.abs(fields @ move).max() <= _LAID * np.abs(nodes).max():
                break
    return nodes, turn


def momenta(mass: object, basis: FloatArray) -> FloatArray:
    """Return M T: the mass matrix acts alike on x, y and z."""
    n = mass.shape[0]  # type: ignore[attr-defined]
    return np.asarray(mass @ basis.reshape(n, -1)).reshape(basis.shape)  # type: ignore[operator]


def refuse_large(name: str, shape: tuple[int, int]) -> None:
    """Raise where a dense matrix would take more memory than a computer is asked for lightly."""
    if shape[0] * shape[1] > _MOST_ENTRIES:
        raise ValueError(
            f"{name} is a dense matrix of shape {shape} here, {shape[0] * shape[1] * 8e-9:.1f} GB; "
            f"expected at most {_MOST_ENTRIES * 8e-9:.1f} GB. Large structures have sparse "
            "matrices, plant.sparse, their lowest modes(plant, count=20), and "
            "reduce(plant, modes=20) for controllers"
        )


def normal_basis(structure: Structure, block: Block, nodes: FloatArray) -> FloatArray:
    """Return displacements of a block's rows along its bars' forces, shape (r, c), 1/m.

    ``Z = M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹``: J Z = I, and Z is orthogonal in M to what keeps the lengths.
    """
    L = np.linalg.cholesky(block_mass(structure, block).toarray())
    constraints = _scaled_rows(structure, block, nodes, L)
    scale = np.linalg.norm(bar_rows(structure, block.independent, nodes).toarray(), axis=1)
    return np.asarray(np.linalg.solve(L.T, np.linalg.pinv(constraints)) / scale)


def _scaled_rows(structure: Structure, block: Block, nodes: FloatArray, L: Any) -> FloatArray:
    """Return ``J L⁻ᵀ``, rows of J of length one, of a block, or refuse a dead centre."""
    J = bar_rows(structure, block.independent, nodes).toarray()
    J = J[:, block.rows] / np.linalg.norm(J, axis=1, keepdims=True)
    rows = np.linalg.solve(L, J.T).T
    sizes = np.linalg.svd(rows, compute_uv=False)
    if sizes.size and sizes.min() <= _RANK_TOLERANCE * sizes.max():
        raise ValueError(
            f"in nodes, bars {sorted(block.bars.tolist())}, which are joined to one another, "
            "are at a dead centre, where their lengths do not determine their motion. Change "
            "the nodes slightly"
        )
    return np.asarray(rows)


def _rows(nodes: IntArray, dimension: int) -> IntArray:
    """Return the rows of vec(N) of some nodes, (k, a), shape (k, a d)."""
    rows = dimension * nodes[:, :, None] + np.arange(dimension)
    return np.asarray(rows.reshape(len(nodes), dimension * nodes.shape[1]))


def _across(vectors: FloatArray) -> FloatArray:
    """Return orthonormal directions across each of k vectors, (d, k), shape (k, d, d − 1)."""
    return np.asarray(np.linalg.svd(vectors.T[:, None, :])[2][:, 1:].swapaxes(1, 2))


@dataclass(frozen=True, eq=False)
class Tangent:
    """Forces on all nodes at zero velocity and their derivatives, node by node, and the masses.

    Accelerations are those of ``M a − Jᵀ λ = F``, ``J a = 0``, where J has half the derivatives of
    the squared lengths of the bars that are kept: of ``δa`` under ``δN``, ``δṄ`` and a change
    ``δu`` of the input, ``M δa − Jᵀ δλ = E δu − K δN − D δṄ`` and ``J δa = −J(a) δN``.

    Attributes
    ----------
    load : ndarray, shape (d, n)
        The part of F that is no string's and not of the ground, N.
    string_length : ndarray, shape (α,)
        m.
    force, acceleration : ndarray, shape (d n,)
        F, N, and a, m/s²; what supports hold has no acceleration.
    mass, stiffness, damping : csr_array, shape (d n, d n)
        M, kg, K, N/m, of strings, ground and bars with the forces that they have, and D, N s/m.
    by_input : csr_array, shape (d n, α)
        E, N per unit of the input.
    curvature : csr_array, shape (c, d n)
        J(a).
    """

    structure: Structure
    load: FloatArray
    string_length: FloatArray
    force: FloatArray
    acceleration: FloatArray
    mass: csr_array
    stiffness: csr_array
    damping: csr_array
    by_input: csr_array
    curvature: csr_array
    _factors: SuperLU

    def accelerations(self, forces: FloatArray, bent: FloatArray) -> FloatArray:
        """Return what supports leave of δa, shape (f, k), from the right sides of the equations.

        Parameters
        ----------
        forces : ndarray, shape (d n, k)
            N.
        bent : ndarray, shape (c, k)
            ``−J(a) δN``.
        """
        return self._solved(forces, bent)[: len(self.structure.free_rows)]

    def bar_force_densities(self, forces: FloatArray, bent: FloatArray) -> FloatArray:
        """Return δλ of the bars that are kept, N/m, shape (c, k); arguments as above."""
        return -self._solved(forces, bent)[len(self.structure.free_rows) :]

    def _solved(self, forces: FloatArray, bent: FloatArray) -> FloatArray:
        right = np.vstack([forces[self.structure.free_rows], bent])
        return np.asarray(self._factors.solve(right))


def bar_displacements(structure: Structure, nodes: FloatArray, mass: csr_array) -> FloatArray:
    """Return E, shape (d n, β): how nodes move where bars grow, by forces along bars alone.

    ``M E = Jᵀ μ`` and ``J E = L̂``, with J half the derivatives of the squared lengths L: across all
    motions that keep the lengths, in the metric of the mass. Zero for bars that do not count in J.
    """
    from scipy.sparse import block_array, csc_array
    from scipy.sparse.linalg import splu

    rows, E = structure.free_rows, np.zeros((nodes.size, len(structure.bars)))
    bars = structure.kept_bars
    if not len(bars):
        return E
    J = bar_rows(structure, bars, nodes)[:, rows]
    system = block_array([[mass[rows][:, rows], J.T], [J, csc_array((len(bars), len(bars)))]])
    right = np.zeros((len(rows) + len(bars), len(bars)))
    right[len(rows) + np.arange(len(bars)), np.arange(len(bars))] = np.linalg.norm(
        structure.bar_vectors(nodes)[:, bars], axis=0
    )
    E[np.ix_(rows, bars)] = splu(system.tocsc()).solve(right)[: len(rows)]
    return E


def tangent(
    model: Model, nodes: FloatArray, input: str, held: FloatArray | None, load: FloatArray
) -> Tangent:
    """Return the forces of a model at rest and their derivatives.

    Parameters
    ----------
    model : Model
    nodes : ndarray, shape (d, n)
        m.
    input : {"force_density", "rest_length"}
    held : ndarray, shape (α,)
        The input, N/m or m.
    load : ndarray, shape (d, n)
        All of the load on the nodes, N.
    """
    from scipy.sparse import block_array, diags_array, eye_array, kron
    from scipy.sparse.linalg import splu

    structure = model.structure
    d, n = nodes.shape
    push, stiffness, damping, by_input = _of_forces(model, nodes, input, held)
    force = load.ravel(order="F") + push
    mass = kron(node_mass(structure), eye_array(d), format="csr")
    free, bars = structure.free_rows, structure.kept_bars
    J = bar_rows(structure, bars, nodes)[:, free]
    saddle = block_array([[mass[free][:, free], J.T], [J, None]], format="csc")
    factors = splu(saddle, permc_spec="MMD_AT_PLUS_A")
    solution = factors.solve(np.r_[force[free], np.zeros(len(bars))])
    acceleration = np.zeros(d * n)
    acceleration[free] = solution[: len(free)]
    # What pushes the ends of a bar apart by λ b turns with the bar.
    C = _ends(structure.bars[bars], n)
    pushed = C.T @ diags_array(solution[len(free) :]) @ C
    bent = bar_rows(structure, bars, acceleration.reshape(d, n, order="F"))
    stiffness = stiffness + kron(pushed, eye_array(d), format="csr")
    return Tangent(
        structure, load, structure.string_length(nodes), force, acceleration, mass, stiffness,
        damping, by_input, bent, factors,
    )  # fmt: skip


def _of_forces(
    model: Model, nodes: FloatArray, input: str, held: Any
) -> tuple[FloatArray, csr_array, csr_array, csr_array]:
    """Return the forces on all nodes at no velocity, N, shape (d n,), and K, D and E of them."""
    from scipy.sparse import csr_array

    d, size, count = len(nodes), nodes.size, len(model.structure.strings)

    def build() -> list[list[tuple[Pass, ca.Function]]]:
        forces = model.forces(input)
        kinds = forces.gap_passes(), chain(*forces.passes())
        return [[(over, _of_member(over, d)) for over in passes] for passes in kinds]

    gaps, passes = model.prepared.get(("members at rest", input), build)
    taut = np.zeros(sum(over.count for over, _ in gaps))
    still = {"p": nodes, "v": np.zeros_like(nodes), "u": np.reshape(held, (1, -1))}
    for over, function in gaps:
        switches = over.writes[0].at
        taut[slice(None, over.count) if switches is None else switches] = (
            _at(over, function, still)[0][0] > 0
        )
    push = np.zeros(size)
    # Rows, columns and values of the derivatives by each array.
    entries: dict[str, list[IntArray | FloatArray]] = {array: [] for array in "pvu"}
    for over, function in passes:
        values, slopes = _at(over, function, still | {"taut": taut[None]})
        for write in over.writes:
            assert write.at is not None  # forces are on nodes
            out = slice(d * write.output, d * write.output + d)
            rows = d * write.at + np.arange(d)[:, None]  # (d, k)
            np.add.at(push, rows, write.sign * values[out])
            first = 0
            for read in over.reads.values():
                if read.array not in entries:
                    continue
                columns = (np.arange(over.count) if read.at is None else read.at)[None]
                if read.array != "u":
                    columns = d * columns + np.arange(d)[:, None]
                block = write.sign * slopes[first : first + len(columns), out]  # (·, d, k)
                places = np.broadcast_arrays(rows, columns[:, None])
                entries[read.array].append(np.stack([*places, block]).reshape(3, -1))
                first += len(columns)
    matrices = []
    for array, blocks in entries.items():
        rows, columns, slopes = np.hstack([np.zeros((3, 0)), *blocks])
        shape = (size, count if array == "u" else size)
        matrices.append(csr_array((slopes, (rows.astype(int), columns.astype(int))), shape=shape))
    return push, -matrices[0], -matrices[1], matrices[2]


def _of_member(over: Pass, dimension: int) -> ca.Function:
    """Return the outputs of a member, a column, and their slopes by what it reads of p, v and u."""
    inputs, own, outputs = over.for_one(dimension)
    value = ca.densify(ca.vertcat(*map(ca.vec, outputs)))
    by = [inputs[name] for name, read in over.reads.items() if read.array in "pvu"]
    slopes = ca.densify(ca.vec(ca.jacobian(value, ca.vertcat(*by))))
    return Function("member", [*inputs.values(), *own.values()], [value, slopes])


def _at(over: Pass, function: ca.Function, arrays: dict[str, FloatArray]) -> list[FloatArray]:
    """Return the outputs of members, shape (m, k), and their slopes, (·, m, k)."""
    columns = []
    for read in over.reads.values():
        array = arrays[read.array]
        columns.append(array[:, : over.count] if read.at is None else array[:, read.at])
    own = [value for value in over.parameters.values() if not isinstance(value, float)]
    values, slopes = evaluate_columns(function, *columns, *(np.atleast_2d(v) for v in own))
    return [values, slopes.reshape(-1, len(values), over.count)]


def string_stretch(structure: Structure, nodes: FloatArray) -> csr_array:
    """Return the derivatives of string lengths by the nodes, shape (α, d n)."""
    from scipy.sparse import csr_array

    of, count = structure.segment_string, len(structure.strings)
    ends = structure.segments
    unit = _segment_rows(structure, _unit(nodes[:, ends[:, 1]] - nodes[:, ends[:, 0]]))
    return csr_array((np.ones(len(of)), (of, np.arange(len(of)))), shape=(count, len(of))) @ unit


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=0), 1e-300))


def _ends(pairs: Any, n: int) -> csr_array:
    """Return the matrix of end minus start of members, shape (k, n)."""
    from scipy.sparse import csr_array

    k = len(pairs)
    values = np.repeat([-1.0, 1.0], k)
    return csr_array((values, (np.tile(np.arange(k), 2), pairs.T.ravel())), shape=(k, n))


def _segment_rows(structure: Structure, vectors: FloatArray) -> csr_array:
    """Return for each segment the row that holds a vector, (d, s), at its end, less at its start.

    Shape (s, d n).
    """
    from scipy.sparse import csr_array

    d, count = vectors.shape
    columns = d * structure.segments[:, :, None] + np.arange(d)
    values = np.stack([-vectors.T, vectors.T], axis=1)
    starts = np.arange(0, values.size + 1, 2 * d)
    size = structure.nodes.size
    return csr_array((values.ravel(), columns.ravel(), starts), shape=(count, size))
