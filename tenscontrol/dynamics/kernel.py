"""The equations of motion, member by member, in CasADi expressions.

Every function takes and returns symbolic matrices with one column per node or
member. Work and memory grow linearly with the members; nothing is factorised.

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

# CasADi expressions carry no types of their own.
Symbolic = Any


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
        return ca.SX(3, n) if W is None else W
    pull = scale_columns(differences(N, structure.strings), gamma.T)
    F = ca.mtimes(pull, _gather(structure.strings, n))
    return F if W is None else W + F


def bar_force_density(structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic) -> Symbolic:
    """Return λ, shape (1, β), N/m, positive in compression.

    A bar with both ends fixed is part of the support; its entry is zero.
    """
    lam = ca.SX(1, len(structure.bars))
    if len(structure.free_bars):
        *_, free = _free_bars(structure, N, Nd, F)
        lam[:, structure.free_bars.tolist()] = free
    if len(structure.swinging_bars):
        _, swinging = _swinging_bars(structure, N, Nd, F)
        lam[:, structure.swinging_bars.tolist()] = swinging
    return lam


def accelerations(structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic) -> Symbolic:
    """Return N̈, shape (3, n), m/s², from eq. (7), with M_s inverted in closed form.

    For a free bar, ``b̈ = 6/m f + 12/m λ b`` (eq. 5) and ``r̈ = (f_start +
    f_end)/m`` (eq. 4); its ends move with ``r̈ ∓ b̈/2``. The free end of a bar
    that swings has the mass m/3. Columns of fixed nodes are left empty.
    """
    Ndd = ca.SX(3, structure.nodes.shape[1])
    if len(structure.free_bars):
        start, end = structure.bars[structure.free_bars].T.tolist()
        mass = _row(structure.bar_mass[structure.free_bars])
        B, f, lam = _free_bars(structure, N, Nd, F)
        half = scale_columns(f, 3 / mass) + scale_columns(B, 6 / mass * lam)
        centre = scale_columns(F[:, start] + F[:, end], 1 / mass)
        Ndd[:, start], Ndd[:, end] = centre - half, centre + half
    if len(structure.swinging_bars):
        tip = structure.hinged_pairs[:, 1].tolist()
        mass = _row(structure.bar_mass[structure.swinging_bars])
        B, lam = _swinging_bars(structure, N, Nd, F)
        Ndd[:, tip] = scale_columns(F[:, tip] + scale_columns(B, lam), 3 / mass)
    if len(structure.string_nodes):
        # No string nodes, no block: a scene pays only for what it has.
        points = structure.string_nodes.tolist()
        Ndd[:, points] = scale_columns(F[:, points], 1 / _row(structure.string_node_mass))
    return Ndd


def _free_bars(
    structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic
) -> tuple[Symbolic, Symbolic, Symbolic]:
    """Return b, the end force less the start force f, and λ of the bars with two free ends.

    ``λ = −m ‖ḃ‖²/(12 ‖b‖²) − bᵀ f/(2 ‖b‖²)``. The current ‖b‖² stands where
    the paper has l²: the two are equal on exact trajectories, and with l² an
    error of the bar length made by an integrator would grow exponentially
    under compression.
    """
    bars = structure.bars[structure.free_bars]
    B, Bd, f = (differences(columns, bars) for columns in (N, Nd, F))
    mass = _row(structure.bar_mass[structure.free_bars])
    return B, f, -(mass / 12 * dots(Bd, Bd) + dots(B, f) / 2) / dots(B, B)


def _swinging_bars(
    structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic
) -> tuple[Symbolic, Symbolic]:
    """Return b, from the fixed to the free end, and λ of the bars that swing.

    ``λ = −m ‖ḃ‖²/(3 ‖b‖²) − bᵀ f/‖b‖²`` with f the force on the free end.
    """
    bars = structure.hinged_pairs
    B, Bd, f = differences(N, bars), differences(Nd, bars), F[:, bars[:, 1].tolist()]
    mass = _row(structure.bar_mass[structure.swinging_bars])
    return B, -(mass / 3 * dots(Bd, Bd) + dots(B, f)) / dots(B, B)


def mass_product(structure: Structure, V: Symbolic) -> Symbolic:
    """Return V M_s, shape (3, n): M_s is m/6 [[2, 1], [1, 2]] a bar and m_s a string node."""
    product = ca.SX(3, structure.nodes.shape[1])
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
