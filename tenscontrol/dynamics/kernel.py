"""The equations of motion, member by member, in CasADi expressions.

Every function takes and returns symbolic matrices, SX or MX, with one column
per node or member. Work and memory grow linearly with the members; nothing is
factorised. The functions of columns below hold for any number of members, so
also for one: the loops in C (:mod:`tenscontrol.dynamics.forms.loops`) are made of them.

Sign convention::

      ●────────→ s ────────●      string: γ = tension / length,     pulls its ends together
      ●════════→ b ════════●      bar:    λ = compression / length, pushes its ends apart
    start                 end
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, IntArray

# A string shorter than this part of its rest length has no direction to pull in.
_NO_LENGTH = 1e-12

# CasADi expressions carry no types of their own.
Symbolic = Any


def all_nodes(structure: Structure, free: Symbolic, fixed: FloatArray | None = None) -> Symbolic:
    """Return the columns of all nodes, shape (3, n), from those of the free ones.

    The only place where supports are put into symbols: fixed nodes are constants, columns of
    ``fixed`` of shape (3, n), or nothing (velocities, loads).
    """
    if len(structure.fixed) == 0:
        return free
    if isinstance(free, ca.MX):
        rest = np.zeros((3, len(structure.fixed))) if fixed is None else fixed[:, structure.fixed]
        order = np.argsort(np.concatenate([structure.free, structure.fixed]))
        return ca.horzcat(free, ca.DM(rest))[:, order.tolist()]
    columns = type(free)(3, structure.nodes.shape[1])
    if fixed is not None:
        columns[:, structure.fixed.tolist()] = ca.DM(fixed[:, structure.fixed])
    columns[:, structure.free.tolist()] = free
    return columns


def differences(columns: Symbolic, pairs: IntArray) -> Symbolic:
    """Return end minus start column of each pair: B, S, or their rates."""
    return columns[:, pairs[:, 1].tolist()] - columns[:, pairs[:, 0].tolist()]


def dots(a: Symbolic, b: Symbolic) -> Symbolic:
    """Return the dot products of the columns of two (3, k) matrices, shape (1, k)."""
    return ca.sum1(a * b)


def scale_columns(columns: Symbolic, factors: Symbolic) -> Symbolic:
    """Multiply column i of a (3, k) matrix by entry i of a (1, k) row."""
    return columns * ca.repmat(factors, 3, 1)


def node_forces(structure: Structure, N: Symbolic, gamma: Symbolic, W: Symbolic | None) -> Symbolic:
    """Return F = W − N C_sᵀ γ̂ C_s, shape (3, n), N (eq. 2). Without load W is None."""
    n = N.shape[1]
    if len(structure.strings) == 0:
        return type(N)(3, n) if W is None else W
    pull = string_pull(differences(N, structure.strings), gamma.T)
    F = ca.mtimes(pull, _gather(structure.strings, n))
    return F if W is None else W + F


def bar_force_density(structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic) -> Symbolic:
    """Return λ, shape (1, β), N/m, positive in compression.

    A bar with both ends fixed is part of the support; its entry is zero.
    """
    lam = type(N)(1, len(structure.bars))
    if len(structure.free_bars):
        *_, lam[:, structure.free_bars.tolist()] = _free_bars(structure, N, Nd, F)
    if len(structure.swinging_bars):
        _, lam[:, structure.swinging_bars.tolist()] = _swinging_bars(structure, N, Nd, F)
    return lam


def accelerations(structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic) -> Symbolic:
    """Return N̈, shape (3, n), m/s², from eq. (7), with M_s inverted in closed form.

    Columns of fixed nodes are left empty.
    """
    Ndd = type(N)(3, structure.nodes.shape[1])
    if len(structure.free_bars):
        start, end = structure.bars[structure.free_bars].T.tolist()
        Ndd[:, start], Ndd[:, end], _ = _free_bars(structure, N, Nd, F)
    if len(structure.swinging_bars):
        tip = structure.hinged_pairs[:, 1].tolist()
        Ndd[:, tip], _ = _swinging_bars(structure, N, Nd, F)
    if len(structure.string_nodes):
        # No string nodes, no block: a scene pays only for what it has.
        points = structure.string_nodes.tolist()
        Ndd[:, points] = point_acceleration(F[:, points], _row(structure.string_node_mass))
    return Ndd


# ---- one member, or any number of them ----


def string_pull(S: Symbolic, gamma: Symbolic) -> Symbolic:
    """Return the force on the start node, N, shape (3, k); the end node gets the opposite."""
    return scale_columns(S, gamma)


def length(S: Symbolic) -> Symbolic:
    """Return l, m, shape (1, k)."""
    return ca.sqrt(dots(S, S))


def length_rate(S: Symbolic, Sd: Symbolic, length: Symbolic) -> Symbolic:
    """Return l̇, m/s, shape (1, k)."""
    return dots(S, Sd) / length


def pulling_length(S: Symbolic, rest_length: Symbolic) -> Symbolic:
    """Return l where a string can pull, m, shape (1, k).

    A slack string may have no length; one that pulls is longer than this.
    """
    # Under the root, so that derivatives are finite too.
    return ca.sqrt(ca.fmax(dots(S, S), (_NO_LENGTH * rest_length) ** 2))


def free_bar(
    B: Symbolic, Bd: Symbolic, start: Symbolic, end: Symbolic, mass: Symbolic
) -> tuple[Symbolic, Symbolic, Symbolic]:
    """Return the accelerations of start and end node and λ of bars with two free ends.

    From the forces on the two nodes, N, shape (3, k). ``b̈ = 6/m f + 12/m λ b``
    (eq. 5) with f the end force less the start force, and ``r̈ = (f_start +
    f_end)/m`` (eq. 4); the ends move with ``r̈ ∓ b̈/2``.

    ``λ = −m ‖ḃ‖²/(12 ‖b‖²) − bᵀ f/(2 ‖b‖²)``. The current ‖b‖² stands where the paper has l²: the
    two are equal on exact trajectories, and with l² an error of the bar length made by an
    integrator would grow exponentially under compression.
    """
    f = end - start
    lam = -(mass / 12 * dots(Bd, Bd) + dots(B, f) / 2) / dots(B, B)
    half = scale_columns(f, 3 / mass) + scale_columns(B, 6 / mass * lam)
    centre = scale_columns(start + end, 1 / mass)
    return centre - half, centre + half, lam


def swinging_bar(
    B: Symbolic, Bd: Symbolic, tip: Symbolic, mass: Symbolic
) -> tuple[Symbolic, Symbolic]:
    """Return the acceleration of the free end and λ of bars that swing about the other.

    b goes from the fixed to the free end, which has the mass m/3. ``λ = −m
    ‖ḃ‖²/(3 ‖b‖²) − bᵀ f/‖b‖²`` with f the force on the free end.
    """
    lam = -(mass / 3 * dots(Bd, Bd) + dots(B, tip)) / dots(B, B)
    return scale_columns(tip + scale_columns(B, lam), 3 / mass), lam


def point_acceleration(force: Symbolic, mass: Symbolic) -> Symbolic:
    """Return the acceleration of point masses, m/s², shape (3, k)."""
    return scale_columns(force, 1 / mass)


def _free_bars(
    structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic
) -> tuple[Symbolic, Symbolic, Symbolic]:
    bars = structure.bars[structure.free_bars]
    start, end = (F[:, nodes] for nodes in bars.T.tolist())
    mass = _row(structure.bar_mass[structure.free_bars])
    return free_bar(differences(N, bars), differences(Nd, bars), start, end, mass)


def _swinging_bars(
    structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic
) -> tuple[Symbolic, Symbolic]:
    bars = structure.hinged_pairs
    tip, mass = F[:, bars[:, 1].tolist()], _row(structure.bar_mass[structure.swinging_bars])
    return swinging_bar(differences(N, bars), differences(Nd, bars), tip, mass)


def mass_product(structure: Structure, V: Symbolic) -> Symbolic:
    """Return V M_s, shape (3, n): M_s is m/6 [[2, 1], [1, 2]] a bar and m_s a string node."""
    product = type(V)(3, structure.nodes.shape[1])
    if len(structure.bars):
        sixth = _row(structure.bar_mass / 6)
        start, end = structure.bars[:, 0].tolist(), structure.bars[:, 1].tolist()
        both = V[:, start] + V[:, end]
        product[:, start] = scale_columns(both + V[:, start], sixth)
        product[:, end] = scale_columns(both + V[:, end], sixth)
    if len(structure.string_nodes):
        points = structure.string_nodes.tolist()
        product[:, points] = scale_columns(V[:, points], _row(structure.string_node_mass))
    return product


def stiffness(structure: Structure, gamma: Symbolic, lam: Symbolic) -> Symbolic:
    """Return K_s, shape (n, n), sparse, in the order of the nodes (eq. 9)."""
    n = structure.nodes.shape[1]
    K = ca.SX(n, n)
    if len(structure.strings):
        C_s = _gather(structure.strings, n)
        K += ca.mtimes([C_s.T, ca.diag(gamma), C_s])
    if len(structure.bars):
        C_bar = _gather(structure.bars, n)
        K -= ca.mtimes([C_bar.T, ca.diag(lam.T), C_bar])
    return K


def _row(values: FloatArray) -> ca.DM:
    return ca.DM(values).T


def _gather(pairs: IntArray, n: int) -> ca.DM:
    """Return the sparse matrix that adds member forces to nodes: 1 at the start, −1 at the end."""
    rows = np.repeat(np.arange(len(pairs)), 2).tolist()
    values = np.tile([1.0, -1.0], len(pairs))
    return ca.DM.triplet(rows, pairs.ravel().tolist(), ca.DM(values), len(pairs), n)
