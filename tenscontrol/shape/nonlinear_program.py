"""Equilibrium shapes as a nonlinear program: unknowns, equations, search and stiffness."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import BUILDING, Function, builds, built
from tenscontrol.dynamics.model import Model
from tenscontrol.shape.held_strings import HeldStrings
from tenscontrol.shape.symmetry import Reduction, RotationalSymmetry, reduction
from tenscontrol.statics.equilibrium_matrix import equilibrium_matrix, null_space
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.blocks import bar_rows
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import free_coordinates, is_movable

# Newton steps onto the equations; each doubles the digits, unless they are singular.
_STEPS = 30

# What the equations may be left with, in units of size, force density and their product.
EXACT = 1e-12

# Directions in which the equations are flatter than this are left alone by Newton.
_FLAT = 1e-10

# Weight of a cost of γ that makes the solution unique where several force densities balance.
_TIE = 1e-10

# Bars whose lengths change less than this, relatively, when others keep theirs depend on them.
_DEPENDENT = 1e-9

# How far off a bar that depends on others may be, less than in a mirror image.
MIRRORED = 1e-3

# A string with less than this fraction of the largest γ is slack.
_SLACK = 1e-9


class ShapeProblem:
    """The equations of equilibrium in positions, γ and λ, scaled to order one.

    The unknowns are ``v = [y; g; l; w]``: positions in units of the size, γ and λ
    in units of the level, and a motion w as one body. The equations are::

        F(N, γ, λ) + w₁ + w₂ × (n − c) = 0     in the free coordinates
        (‖b‖² − l²)/2 = 0                      for the bars that move

    Forces between nodes have no resultant, so that w is zero. It makes up for the
    redundant equations and keeps the Jacobian regular. Of redundant bars, a set is taken that
    determines the lengths and forces of the others.

    The nodes of ``start``, shape (d, n), give the size; ``level`` is the scale of the
    force densities, N/m. With a ``symmetry``, only shapes that have it are solutions; with strings
    that are ``held``, only those in which these have the values that they must have. Bars whose
    lengths are driven may have any.
    """

    @builds
    def __init__(
        self,
        model: Model,
        start: FloatArray,
        level: float,
        symmetry: RotationalSymmetry | None = None,
        held: HeldStrings | None = None,
    ) -> None:
        structure, load = model.structure, model.constant_force
        d = structure.dimension
        self.model, self.level = model, level
        self.size = float(np.ptp(start, axis=1).max())
        self._reduced = red = reduction(structure, load, symmetry)
        self.neutral = self._neutral_motions(red.rigid)
        self._bars = red.bars[:, _determining(structure, red)]

        y = ca.SX.sym("y", red.basis.shape[1])
        g = ca.SX.sym("g", red.strings.shape[1])
        lam = ca.SX.sym("l", self._bars.shape[1])
        w = ca.SX.sym("w", self.neutral.shape[1])
        places = ca.mtimes(_sparse(red.basis), self.size * y) + ca.DM(red.offset)
        nodes = kernel.placed(structure, places, structure.nodes)
        self.unknowns = ca.vertcat(y, g, lam, w)
        self.positions, self.tensions, self.nodes = y, g, nodes
        self.gamma = level * ca.mtimes(_sparse(red.strings), g)
        bars = level * ca.mtimes(_sparse(self._bars), lam)
        still, acting = ca.SX(*nodes.shape), ca.sparsify(ca.DM(load))
        F = model.forces("force_density").on_nodes(nodes, still, self.gamma, acting)
        F += _bar_push(structure.bars, nodes, bars)
        body = ca.mtimes(ca.DM(self.neutral), w)
        arms = (nodes - ca.repmat(ca.DM(red.centre), 1, nodes.shape[1])) / self.size
        F = F / (level * self.size)
        for j in structure.free.tolist():
            F[:, j] += body[:d] + _turned(body[d:], arms[:, j])
        unbalanced = ca.vec(F)[structure.free_rows.tolist()]
        driven = np.zeros(0, dtype=np.int64) if held is None else held.driven_bars
        stretch = self._stretch(_keeping(self._bars, driven))
        # Equations that the symmetry makes equal are written once.
        self.equations = ca.vertcat(ca.mtimes(_sparse(red.basis.T), unbalanced), stretch)
        self.held = held
        if held is not None:
            unit = self.size if held.input == "rest_length" else level
            rows = held.rows(model, nodes, self.gamma, red.strings, unit)
            of_bars = held.bar_rows(self.bar_lengths, red.bars, self.size)
            self.equations = ca.vertcat(self.equations, rows, of_bars)
        self._parts = Function("parts", [self.unknowns], [ca.densify(nodes), self.gamma])

    @property
    def dependent_stretch(self) -> Any:
        """Expression of the stretch of the bars that depend on others, in units of the size.

        It is zero where those keep their lengths, but in a mirror image of a part of the bars.
        """
        structure = self.model.structure
        chosen = self._bars.sum(axis=1) > 0
        return self._stretch(np.flatnonzero(is_movable(structure, structure.bars) & ~chosen))

    @property
    def bar_lengths(self) -> Any:
        """Expression of the lengths of all bars, m, a column."""
        B = kernel.differences(self.nodes, self.model.structure.bars)
        return ca.sqrt(kernel.dots(B, B)).T

    def _stretch(self, bars: IntArray) -> Any:
        """Return half the excess of squared lengths, in units of the size, one a row."""
        B = kernel.differences(self.nodes, self.model.structure.bars[bars])
        lengths = ca.DM(self.model.structure.bar_length[bars] ** 2)
        return (ca.sum1(B * B).T - lengths) / (2 * self.size**2)

    def start(self, nodes: FloatArray, gamma: FloatArray) -> FloatArray:
        """Return unknowns at or near this shape, with the λ that balances best."""
        red, structure = self._reduced, self.model.structure
        E = equilibrium_matrix(structure, nodes)[structure.free_rows]
        alpha = len(structure.strings)
        load = free_coordinates(structure, self.model.constant_force)
        pushes = E[:, alpha:]
        pushes[:, ~self._bars.any(axis=1)] = 0.0
        lam = np.linalg.lstsq(pushes, load - E[:, :alpha] @ gamma, rcond=None)[0]
        return np.concatenate(
            [
                red.basis.T @ (free_coordinates(structure, nodes) - red.offset) / self.size,
                _mean(red.strings, gamma) / self.level,
                _mean(self._bars, np.asarray(lam, dtype=float)) / self.level,
                np.zeros(self.neutral.shape[1]),
            ]
        )

    def read(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return node positions and γ of unknowns."""
        nodes, gamma = self._parts(values[: self.unknowns.numel()])
        return np.array(nodes.full()), np.array(gamma.full()).ravel()

    @property
    def string_orbits(self) -> FloatArray:
        """Which strings share one γ, shape (α, ·): a 1 in each row."""
        return self._reduced.strings

    def neutral_fields(self, nodes: FloatArray) -> FloatArray:
        """Return displacements, (f, m), in all rigid motions that nothing resists."""
        d = self.model.structure.dimension
        motions = self._neutral_motions(np.eye(d * (d + 1) // 2))
        if motions.shape[1] == 0:
            return np.zeros((len(self.model.structure.free_rows), 0))
        return self._fields(nodes, motions)[self.model.structure.free_rows]

    @property
    def tension_rows(self) -> slice:
        """Indices of γ in the unknowns."""
        first = self.positions.numel()
        return slice(first, first + self.tensions.numel())

    def search(
        self,
        objective: Any,
        more: list[tuple[Any, FloatArray, FloatArray]],
        extra: Any,
        lowest: FloatArray,
        highest: FloatArray,
        guess: FloatArray,
    ) -> tuple[FloatArray, bool]:
        """Return unknowns that solve the equations at least cost, by IPOPT, and if it converged.

        ``more`` lists further expressions with their bounds, ``extra`` further unknowns after v;
        ``lowest`` and ``highest`` bound γ in units of the level.
        """
        v = ca.vertcat(self.unknowns, extra)
        rows = ca.vertcat(self.equations, *(expression for expression, _, _ in more))
        zero = np.zeros(self.equations.numel())
        low = np.concatenate([zero, *(bound for _, bound, _ in more)])
        high = np.concatenate([zero, *(bound for _, _, bound in more)])
        least, most = np.full(v.numel(), -np.inf), np.full(v.numel(), np.inf)
        least[self.tension_rows], most[self.tension_rows] = lowest, highest
        tie = _TIE * ca.sumsqr(self.tensions - 1)
        options = {
            "print_time": False,
            "show_eval_warnings": False,
            "error_on_fail": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "tol": 1e-10,
                "max_iter": 200,
                "bound_relax_factor": 0.0,
            },
        }
        problem = {"x": v, "f": objective + tie, "g": rows}
        solver = ca.nlpsol("shape", "ipopt", problem, options)
        with BUILDING:
            answer = solver(x0=guess, lbx=least, ubx=most, lbg=low, ubg=high)
        return np.array(answer["x"].full()).ravel(), bool(solver.stats()["success"])

    @builds
    def polish(self, values: FloatArray, rows: Any = None) -> tuple[FloatArray, FloatArray]:
        """Return the nearest unknowns at which equations and ``rows`` vanish, and what is left."""
        every = self.equations if rows is None else ca.vertcat(self.equations, rows)
        newton = Function("newton", [self.unknowns], [every, ca.jacobian(every, self.unknowns)])
        best = point = values[: self.unknowns.numel()]
        least, left = np.inf, np.full(1, np.inf)
        for _ in range(_STEPS):
            residual, jacobian = (np.array(output.full()) for output in newton(point))
            residual = residual.ravel()
            worst = np.abs(residual).max(initial=0.0)
            if not worst < least:
                break
            best, least, left = point, worst, residual
            point = point - np.linalg.lstsq(jacobian, residual, rcond=_FLAT)[0]
        return best, left

    def stability_margin(self, rest: Prestress) -> float:
        """Return the smallest eigenvalue of the stiffness at rest, N/m, of what can move.

        As in :class:`ShapeTarget`; rigid-body motions that nothing resists are left out.
        """
        from scipy import linalg

        law = self.model.strings
        if law is None:
            return float(rest.stability.mechanism_stiffness.min(initial=np.inf))
        structure, gamma = rest.structure, rest.force_density
        wound = law.rest_length(structure.string_length(), gamma)
        # At the brink of slackness the stiffness has two values; the smaller one counts.
        wound = np.where(gamma > _SLACK * gamma.max(initial=0.0), wound, 2 * wound)
        positions = free_coordinates(structure, structure.nodes)
        outputs = self._stiffness(positions, wound, rest.bar_force_density)
        K, J = (np.array(output.full()) for output in outputs)
        held = np.vstack([J, self.neutral_fields(structure.nodes).T])
        Z = linalg.null_space(held, rcond=1e-9) if held.size else np.eye(len(positions))
        return float(np.linalg.eigvalsh(Z.T @ K @ Z)[0]) if Z.shape[1] else float("inf")

    @built
    def _stiffness(self) -> ca.Function:
        """Stiffness with rest lengths held, and rows of the bars, by the free coordinates."""
        structure = self.model.structure
        q = ca.SX.sym("q", len(structure.free_rows))
        lam = ca.SX.sym("lambda", len(structure.bars))
        rest_length = ca.SX.sym("rest_length", len(structure.strings))
        nodes = kernel.placed(structure, q, structure.nodes)
        B = kernel.differences(nodes, structure.bars)
        squares = kernel.dots(B, B).T / 2
        state = ca.vertcat(q, ca.SX.zeros(q.numel()))
        stored = self.model.elastic_energy(state, rest_length)
        hessian, _ = ca.hessian(stored - ca.dot(lam, squares), q)
        results = [hessian, ca.jacobian(squares, q)]
        return Function("stiffness", [q, rest_length, lam], results)

    def _neutral_motions(self, motions: FloatArray) -> FloatArray:
        """Return the rigid motions, (d (d + 1)/2, m), that supports permit and that do no work."""
        red, structure = self._reduced, self.model.structure
        if len(structure.fixed_rows):
            held = self._fields(structure.nodes, motions)[structure.fixed_rows]
            motions = motions @ null_space(held)
        load = free_coordinates(structure, self.model.constant_force)
        if not load.any() or motions.shape[1] == 0:
            return motions
        # The power of the load is linear in the positions: a few shapes determine it.
        random = np.random.default_rng(0)
        powers, places = [], structure.nodes.ravel(order="F").copy()
        for _ in range(len(load) + 3):
            y = random.normal(size=red.basis.shape[1])
            places[structure.free_rows] = red.offset + red.basis @ (self.size * y)
            fields = self._fields(places.reshape(structure.nodes.shape, order="F"), motions)
            powers.append(load @ fields[structure.free_rows])
        return np.asarray(motions @ null_space(np.array(powers)))

    def _fields(self, nodes: FloatArray, motions: FloatArray) -> FloatArray:
        """Return the displacements of nodes in rigid-body motions, shape (d k, m)."""
        arms = (nodes - self._reduced.centre[:, None]) / self.size
        d = len(arms)
        if d == 3:
            turns = [np.cross(m[3:], arms.T).T for m in motions.T]
        else:
            turns = [m[2] * np.vstack([-arms[1], arms[0]]) for m in motions.T]
        moved = [
            (m[:d, None] + turn).ravel(order="F") for m, turn in zip(motions.T, turns, strict=True)
        ]
        return np.column_stack(moved)


def _keeping(orbits: FloatArray, driven: IntArray) -> IntArray:
    """Return a bar of each orbit, shape (β, orbits), that keeps its length."""
    if not orbits.size:
        return np.zeros(0, np.int64)
    keeps = orbits > 0
    keeps[driven] = False
    chosen: IntArray = keeps.argmax(axis=0)[keeps.any(axis=0)]
    return chosen


def _determining(structure: Structure, red: Reduction) -> IntArray:
    """Return sets of bars that share one λ, of which none depends on others.

    Bars between two fixed nodes are part of the support.
    """
    moves = is_movable(structure, structure.bars)
    orbits = np.flatnonzero(red.bars[moves].any(axis=0))
    if not any(block.is_redundant for block in structure.blocks):
        return orbits
    from scipy.linalg import qr

    every = np.arange(len(structure.bars))
    J = bar_rows(structure, every, structure.nodes)[:, structure.free_rows] @ red.basis
    R, order = qr((red.bars[:, orbits].T @ J).T, mode="r", pivoting=True)
    sizes = np.abs(np.diagonal(R))
    return np.sort(orbits[order[: np.count_nonzero(sizes > _DEPENDENT * sizes[0])]])


def _turned(turn: Any, arm: Any) -> Any:
    """Return the velocity at an arm in a turn: ``w × r``."""
    if arm.numel() == 3:
        return ca.cross(turn, arm)
    return ca.vertcat(-turn * arm[1], turn * arm[0])


def _bar_push(bars: Any, nodes: Any, lam: Any) -> Any:
    """Return the forces of the bars on the nodes: each pushes its ends apart."""
    F = ca.SX(*nodes.shape)
    if len(bars):
        push = kernel.scale_columns(kernel.differences(nodes, bars), lam.T)
        for (start, end), force in zip(bars.tolist(), ca.horzsplit(push), strict=True):
            F[:, end] += force
            F[:, start] -= force
    return F


def _mean(orbits: FloatArray, values: FloatArray) -> FloatArray:
    return np.asarray(orbits.T @ values / np.maximum(orbits.sum(axis=0), 1))


def _sparse(matrix: FloatArray) -> ca.DM:
    return ca.sparsify(ca.DM(matrix))
