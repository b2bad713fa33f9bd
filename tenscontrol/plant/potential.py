"""Potential energy of a structure with held strings by its shape, and its derivatives, sparse.

They are put together of those of members, by their own small functions: the derivatives of one
expression of a whole structure take many times as long.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function, builds
from tenscontrol.dynamics.force import VECTORS, Pass
from tenscontrol.dynamics.model import Model

if TYPE_CHECKING:
    from scipy.sparse import csc_array

# Iterations of the optimizer at most.
_ITERATIONS = 500


@dataclass(frozen=True, eq=False)
class Conditions:
    """The conditions of optimality at a point, and their derivatives.

    Attributes
    ----------
    slope : ndarray, shape (m,)
        Gradient of the Lagrangian by the coordinates, N.
    stretch : ndarray, shape (c,)
        Half of what squared lengths of bars exceed theirs by, m².
    hessian, by_coordinates : csc_array, shape (m, m) and (c, m)
        Derivatives of ``slope`` and ``stretch`` by the coordinates.
    """

    slope: FloatArray
    stretch: FloatArray
    hessian: csc_array
    by_coordinates: csc_array


class Potential:
    """Energy of strings, loads and ground in coordinates q, with the lengths of bars to be kept.

    Its stages are ``[weights; rounding]``: factors of what strings store, and the length below
    which segments of clustered strings are rounded, m.

    Parameters
    ----------
    model : Model
    kind : {"force_density", "rest_length"}
    held : ndarray, shape (α,)
        The input that is held.
    load : ndarray, shape (d, n)
        N.
    origin : ndarray, shape (d n,)
        vec(N) at q = 0.
    motions : csc_array, shape (d n, m)
        What the coordinates add to vec(N).
    """

    @builds
    def __init__(
        self, model: Model, kind: str, held: FloatArray, load: FloatArray, origin: FloatArray,
        motions: csc_array,
    ) -> None:  # fmt: skip
        structure = model.structure
        d, n = structure.nodes.shape
        M, bars = kernel.sparse(motions), structure.kept_bars
        q, lam, factor = (
            ca.MX.sym(name, size)
            for name, size in (("q", M.shape[1]), ("lambda", len(bars)), ("factor", 1))
        )
        stage = ca.MX.sym("stage", len(held) + 1)
        flat = ca.DM(origin) + ca.mtimes(M, q)
        nodes = ca.reshape(flat, d, n)
        flat_load = ca.DM(load.ravel(order="F"))
        energy, slope, hessian = -ca.dot(flat_load, flat), -flat_load, ca.MX(d * n, d * n)
        forces = model.forces(kind)
        arrays = {"p": nodes, "u": ca.MX(ca.DM(held).T), "weight": stage[:-1].T,
                  "rounding": stage[-1]}  # fmt: skip
        parts = [_of_members(over, arrays) for over in forces.strings.energy_passes()]
        if forces.terms:
            parts.append(_of_terms(forces.terms, nodes))
        for added in parts:
            energy, slope, hessian = (
                a + b for a, b in zip((energy, slope, hessian), added, strict=True)
            )
        ends = structure.bars[bars]
        B = kernel.differences(nodes, ends)
        stretch = (kernel.dots(B, B).T - ca.DM(structure.bar_length[bars] ** 2)) / 2
        rows = d * ends.T[:, :, None] + np.arange(d)  # (2, c, d)
        line = np.broadcast_to(np.arange(len(bars))[:, None], rows.shape)
        J = _summed(ca.vertcat(-ca.vec(B), ca.vec(B)), line, rows, (len(bars), d * n))
        # λ/2 |b|² has the slopes ±λ.
        rows, columns = np.broadcast_arrays(rows[:, None], rows)  # (2, 2, c, d)
        axial = ca.vec(ca.repmat(lam.T, d, 1))
        bent = _summed(ca.vertcat(axial, -axial, -axial, axial), rows, columns, (d * n, d * n))
        slope, J = ca.mtimes(M.T, slope), ca.mtimes(J, M)
        hessian = ca.mtimes([M.T, factor * hessian + bent, M])
        given = [q, stage]
        options = {
            "print_time": False,
            "calc_lam_p": False,
            "grad_f": ca.Function("grad_f", given, [energy, slope], ["x", "p"], ["f", "grad_f_x"]),
            "jac_g": ca.Function("jac_g", given, [stretch, J], ["x", "p"], ["g", "jac_g_x"]),
            "hess_lag": ca.Function(
                "hess_lag", [*given, factor, lam], [ca.triu(hessian)],
                ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
            ),
            "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "max_iter": _ITERATIONS},
        }  # fmt: skip
        problem = {"x": q, "p": stage, "f": energy, "g": stretch}
        #: IPOPT, of the start and a stage.
        self.solver = Function(ca.nlpsol("equilibrium", "ipopt", problem, options))
        self._conditions = Function(
            "conditions", [q, stage, factor, lam],
            [slope + ca.mtimes(J.T, lam), stretch, hessian, J],
        )  # fmt: skip
        self._nodes = Function("nodes", [q], [nodes])
        self._plain = np.append(np.ones(len(held)), 0.0)
        #: Number of coordinates.
        self.count = M.shape[1]

    def nodes(self, q: FloatArray) -> FloatArray:
        """Return the nodes, m, shape (d, n)."""
        return np.array(self._nodes(q).full())

    def conditions(self, point: FloatArray) -> Conditions:
        """Return the conditions of optimality at ``[q; λ]``, with all strings as they are."""
        from scipy.sparse import csc_array

        q, lam = np.split(point, [self.count])
        slope, stretch, hessian, J = self._conditions(q, self._plain, 1.0, lam)
        vectors = (np.array(value.full()).ravel() for value in (slope, stretch))
        return Conditions(*vectors, *(csc_array(matrix.sparse()) for matrix in (hessian, J)))


def _of_members(over: Pass, arrays: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Return the energy of a pass, and its derivatives by vec(N), shapes (d n, 1), (d n, d n)."""
    d, n = arrays["p"].shape
    inputs, own, (energy,) = over.for_one(d)
    ends = {name: read.at for name, read in over.reads.items() if read.array in VECTORS}
    hessian, slope = ca.hessian(energy, ca.vertcat(*map(inputs.get, ends)))
    outputs = [energy, ca.densify(slope), ca.densify(ca.vec(hessian))]
    member = ca.Function("member", [*inputs.values(), *own.values()], outputs)
    columns = [
        arrays[read.array] if read.at is None else arrays[read.array][:, read.at.tolist()]
        for read in over.reads.values()
    ]
    columns += [ca.DM(over.parameters[name]).T for name in own]
    energy, slope, hessian = member.map(over.count)(*columns)
    # Of member by member, with the coordinates of its nodes one after another: (k, m).
    rows = np.hstack([d * np.asarray(at)[:, None] + np.arange(d) for at in ends.values()])
    by, of = np.broadcast_arrays(rows[:, :, None], rows[:, None])
    slope = _summed(ca.vec(slope), rows, np.zeros_like(rows), (d * n, 1))
    return ca.sum2(energy), slope, _summed(ca.vec(hessian), of, by, (d * n, d * n))


def _of_terms(terms: tuple[Any, ...], nodes: Any) -> tuple[Any, Any, Any]:
    """Return what forces that are no strings' store, and its derivatives by vec(N)."""
    N = ca.SX.sym("N", *nodes.shape)
    energy = sum(term.stored_energy(N) for term in terms)
    hessian, slope = ca.hessian(energy, ca.vec(N))
    function = ca.Function("terms", [N], [energy, slope, hessian])
    return tuple(function(nodes))


def _summed(entries: Any, rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> Any:
    """Return the sparse matrix of entries, a column, in which those at one place are added up."""
    from scipy.sparse import csc_array

    place = (columns.astype(np.int64) * shape[0] + rows).ravel()
    places, which = np.unique(place, return_inverse=True)
    count = len(place)
    gather = csc_array((np.ones(count), which, np.arange(count + 1)), shape=(len(places), count))
    column, row = np.divmod(places, shape[0])
    starts = np.searchsorted(column, np.arange(shape[1] + 1))
    pattern = ca.Sparsity(*shape, starts.tolist(), row.tolist())
    return ca.MX(pattern, ca.mtimes(kernel.sparse(gather), entries))
