"""Which force densities to take in a shape where several balance."""

from __future__ import annotations

import numpy as np

from tenscontrol.statics import equilibrium_matrix, least_distance
from tenscontrol.structure import Structure, free_coordinates, is_movable
from tenscontrol.validation import FloatArray, IntArray

# In units of the level: what counts as zero, and what a null space is made of.
_ZERO, _RANK = 1e-9, 1e-9
# The linear program is good to this.
_STUCK = 1e-6
_NEWTON_STEPS = 100


def choose_force_density(
    structure: Structure,
    load: FloatArray,
    low: FloatArray,
    high: FloatArray,
    kind: str,
    level: float | None,
    reference: IntArray,
    scale: float,
) -> FloatArray | None:
    """Return balanced γ between bounds that are the least or the most central ones.

    Parameters
    ----------
    structure : Structure
        In the shape in question.
    load : ndarray, shape (3, n)
        N.
    low, high : ndarray, shape (α,)
        Bounds, N/m; ``high`` may be infinite.
    kind : {"centred", "least"}
        The analytic centre of the bounds (Boyd & Vandenberghe, *Convex
        Optimization*, section 8.5.3), or the least sum of squares.
    level : float, optional
        Mean γ of the ``reference`` strings, N/m.
    reference : ndarray of int
    scale : float
        Size of the force densities, N/m.

    Returns
    -------
    ndarray, shape (α,), or None
        None if nothing between the bounds balances. Both choices are unique, so
        that a symmetric shape gets symmetric forces.
    """
    live = is_movable(structure, np.vstack([structure.strings, structure.bars]))
    alpha = len(structure.strings)
    pulls = live[:alpha]
    E = equilibrium_matrix(structure)[structure.free_rows][:, live]
    w = free_coordinates(structure, load) / scale
    rows, goal = E, w
    count = int(pulls.sum())
    U, sizes, Vt = np.linalg.svd(rows)
    rank = int(np.count_nonzero(sizes > _RANK * sizes.max(initial=0.0)))
    at = Vt[:rank].T @ ((U[:, :rank].T @ goal) / sizes[:rank])
    D, p = Vt[rank:].T[:count], at[:count]
    if level is not None:
        mine = np.flatnonzero(np.isin(np.flatnonzero(pulls), reference))
        mean = D[mine].mean(axis=0)
        weight = float(mean @ mean)
        short = level / scale - p[mine].mean()
        if weight >= _ZERO**2:
            p = p + D @ mean * short / weight
            D = D @ np.linalg.svd(mean[None, :])[2][1:].T
        elif abs(short) > _ZERO:
            return None
    least, most = low[pulls] / scale, high[pulls] / scale
    chosen = (_analytic_centre if kind == "centred" else _least)(D, p, least, most)
    if chosen is None:
        return None
    gamma = low.copy()
    gamma[pulls] = np.clip(scale * chosen, low[pulls], high[pulls])
    return gamma


def _least(D: FloatArray, p: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray | None:
    """Return ``p + D x`` of least norm between bounds."""
    U, sizes, _ = np.linalg.svd(D, full_matrices=False)
    U = U[:, sizes > _ZERO]
    best = p - U @ (U.T @ p)
    capped = np.isfinite(high)
    G = np.vstack([U, -U[capped]])
    h = np.concatenate([low - best, (best - high)[capped]])
    G[np.abs(G) < 1e-12], h[np.abs(h) < 1e-12] = 0.0, 0.0
    if (h <= _ZERO).all():
        return np.asarray(best)
    step = least_distance(G, h)
    return None if step is None else np.asarray(best + U @ step)


def _analytic_centre(
    D: FloatArray, p: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray | None:
    """Return the ``p + D x`` that is farthest from the bounds in the sense of the product."""
    x = _inside(D, p, low, high)
    if x is None:
        return None
    p, x = p + D @ x, np.zeros(D.shape[1])
    # Entries that stand on a bound in all of the set tell nothing.
    at_low, at_high = p - low <= _STUCK, high - p <= _STUCK
    open_ = ~(at_low | at_high)
    if not open_.all():
        stuck, bound = D[~open_], np.where(at_low, low, high)[~open_]
        _, sizes, Vt = np.linalg.svd(stuck)
        p = p + D @ np.linalg.lstsq(stuck, bound - p[~open_], rcond=_RANK)[0]
        D = D @ Vt[np.count_nonzero(sizes > _RANK) :].T
        x = np.zeros(D.shape[1])
    capped = open_ & np.isfinite(high)

    def barrier(x: FloatArray) -> float:
        gamma = p + D @ x
        down, up = (gamma - low)[open_], (high - gamma)[capped]
        if (down <= 0).any() or (up <= 0).any():
            return np.inf
        return float(-np.log(down).sum() - np.log(up).sum())

    for _ in range(_NEWTON_STEPS):
        gamma = p + D @ x
        down, up = 1 / (gamma - low)[open_], 1 / (high - gamma)[capped]
        slope = -D[open_].T @ down + D[capped].T @ up
        curve = (D[open_].T * down**2) @ D[open_] + (D[capped].T * up**2) @ D[capped]
        step = np.linalg.lstsq(curve, -slope, rcond=1e-14)[0]
        gain = float(-slope @ step)
        if gain < 1e-24:
            break
        length, now = 1.0, barrier(x)
        while length > 1e-10 and barrier(x + length * step) > now - 0.1 * length * gain:
            length /= 2
        if length <= 1e-10:
            break
        x = x + length * step
    return np.asarray(p + D @ x)


def _inside(D: FloatArray, p: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray | None:
    """Return x at which ``p + D x`` is as far inside the bounds as it can be, or None."""
    from scipy.optimize import linprog

    m, k = D.shape
    capped = np.isfinite(high)
    A = np.vstack([-D, D[capped]])
    b = np.concatenate([p - low, (high - p)[capped]])

    def farthest(weights: FloatArray) -> FloatArray | None:
        """Maximize the room t of the weighted entries, at most one level."""
        depth = np.concatenate([weights, weights[capped]])
        answer = linprog(
            c=np.r_[np.zeros(k), -1.0],
            A_ub=np.column_stack([A, depth]),
            b_ub=b,
            bounds=[(None, None)] * k + [(0.0, 1.0)],
            method="highs",
        )
        if answer.status == 2:
            return None
        if answer.status != 0:
            raise ArithmeticError(f"the linear program of the force densities: {answer.message}")
        return np.asarray(answer.x)

    found = farthest(np.ones(m))
    if found is None or found[-1] > _STUCK:
        return None if found is None else found[:-1]
    # No point is inside all bounds: take the mean of those that are inside one each.
    each = [farthest(row) for row in np.eye(m)]
    points = [x[:-1] for x in each if x is not None]
    return np.asarray(np.mean(points, axis=0))
