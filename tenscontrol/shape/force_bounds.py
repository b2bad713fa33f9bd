"""Choice of the force densities in a shape: their level, within bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.model import Model
from tenscontrol.shape.held_strings import HeldStrings
from tenscontrol.statics.equilibrium_matrix import member_forces
from tenscontrol.statics.least_distance import least_distance
from tenscontrol.string_bounds import StringBounds, string_bounds
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import free_coordinates, is_movable

# In units of the level: what counts as zero, and what a null space is made of.
_ZERO, _RANK = 1e-9, 1e-9
# A centre beyond is none: the set has no end. It is met where bars come into line.
_FAR = 1e4
# The linear program is good to this.
_STUCK = 1e-6
_NEWTON_STEPS = 100


@dataclass(frozen=True, eq=False)
class ForceLimits:
    """Level and bounds of the forces, and the least distance of bars."""

    bounds: StringBounds
    clearance: float  # m, 0 if not asked for
    level: float | None  # mean γ of the reference strings, N/m
    reference: IntArray
    scale: float  # size of the force densities, N/m
    strokes: tuple[FloatArray, FloatArray] | None = None  # of bars that are driven, m, (β,) each
    is_settled: bool = False  # no string is driven: the shape alone says what γ are

    def bounded(
        self, gamma: FloatArray, rest_length: FloatArray | None, bar_length: FloatArray
    ) -> list[tuple[str, str, FloatArray, FloatArray, FloatArray]]:
        """Return name, unit, values and bounds of what the user bounds."""
        rows, b = [], self.bounds
        if b.low.any() or np.isfinite(b.high).any():
            rows.append(("force_density", "N/m", gamma, b.low, b.high))
        if rest_length is not None and b.rest_length is not None:
            rows.append(("rest_length", "m", rest_length, *b.rest_length))
        if self.strokes is not None:
            rows.append(("bar_length", "m", bar_length, *self.strokes))
        return rows


def refuse_ground(model: Model) -> None:
    """Raise if a model has ground, whose forces searches for shapes do not know."""
    if model.ground:
        raise ValueError(
            "model has ground, whose contact forces the search for shapes does not include: "
            "give the model of a "
            "plant about a stance, linearize(model, equilibrium(model, ...)).model, whose feet are "
            "fixed nodes, or a model without ground"
        )


def checked_limits(
    model: Model,
    force_density: object,
    reference: str | None,
    min_force_density: object,
    max_force_density: object,
    winches: Winches | None,
    prestress: str,
    min_clearance: object,
    held: HeldStrings | None,
    drives: Winches | None,
) -> ForceLimits:
    """Return level and bounds, or raise naming the argument."""
    bounds = checked_bounds(model, min_force_density, max_force_density, winches, held)
    springs = np.zeros(0) if held is None else held.spring_force_density(model)
    structure, low, high = model.structure, bounds.low, bounds.high
    clearance = 0.0
    if min_clearance is not None:
        clearance = validation.positive_number("min_clearance", min_clearance, "m")
        if structure.dimension == 2:
            raise ValueError(
                f"min_clearance is {clearance:g} m, but the structure is in the plane, where bars "
                "lie in layers and pass one another; leave it out"
            )
    group = structure.string_groups[0]
    if reference is not None:
        group = validation.choice("reference", reference, dict.fromkeys(structure.string_groups))
    strings = structure.strings_in(group)
    # A string between two fixed nodes is part of the support.
    movable = is_movable(structure, structure.segments).astype(float)
    strings = strings[np.bincount(structure.segment_string, movable)[strings] > 0]
    if len(strings) == 0:
        raise ValueError(
            f"the {group!r} strings have both ends fixed, so that their γ has no effect; name "
            "another group by reference=..."
        )
    strokes = drive_strokes(model, drives, held)
    is_settled = held is not None and held.settles_forces
    level = _checked_level(force_density, reference, (low, high), strings, group)
    if level is not None and is_settled:
        raise ValueError(
            "force_density goes with winches that set forces, but plant drives bars, and its "
            "strings keep their rest lengths: leave it out"
        )
    loaded = bool(free_coordinates(structure, model.constant_force).any())
    centred = prestress == "centred" and not is_settled
    if level is None and centred and not np.isfinite(high).all():
        raise ValueError(
            "the level of the prestress is unbounded: give force_density or "
            "max_force_density, or ask for prestress='least'"
        )
    pulls = loaded or springs.any()
    if level is None and not low.any() and not pulls and not np.isfinite(high).all():
        raise ValueError(
            "without load γ = 0 balances in every shape: give force_density or "
            "min_force_density, N/m"
        )
    candidates = [level, float(low.max()), float(springs.max(initial=0.0))]
    if np.isfinite(high).all():
        candidates.append(float((low + high).mean() / 2))
    if loaded:
        size = structure.size
        candidates.append(float(np.abs(model.constant_force).max()) / size)
    scale = max(value for value in candidates if value)
    return ForceLimits(bounds, clearance, level, strings, scale, strokes, is_settled)


def _checked_level(
    force_density: object,
    reference: str | None,
    bounds: tuple[FloatArray, FloatArray],
    strings: IntArray,
    group: str,
) -> float | None:
    """Return the mean γ of the reference strings, N/m, if it is given, or raise."""
    if force_density is None:
        if reference is not None:
            raise ValueError(f"reference is {reference!r}, but it goes with force_density")
        return None
    level = validation.positive_number("force_density", force_density, "N/m")
    least, most = (float(bound[strings].mean()) for bound in bounds)
    if level < least or level > most:
        raise ValueError(
            f"force_density is {level:g} N/m, but the bounds leave the {group!r} strings "
            f"{validation.span(least, most, 'N/m')} in the mean"
        )
    return level


def drive_strokes(
    model: Model, drives: Winches | None, held: HeldStrings | None
) -> tuple[FloatArray, FloatArray] | None:
    """Return the shortest and longest length of each bar, m; None where no bar is driven.

    Those that are not driven have no limit.
    """
    if held is None or held.struts is None:
        return None
    count, passive = len(model.structure.bars), held.struts.passive
    shortest, longest = np.zeros(count), np.full(count, np.inf)
    if drives is not None:
        shortest, longest = (limit.copy() for limit in drives.range(count))
        shortest[passive], longest[passive] = 0.0, np.inf
    return shortest, longest


def checked_bounds(
    model: Model,
    min_force_density: object,
    max_force_density: object,
    winches: Winches | None,
    held: HeldStrings | None,
) -> StringBounds:
    """Return the bounds of the strings of a model, or raise naming the argument."""
    count = len(model.structure.strings)
    if count == 0:
        raise ValueError("the structure has no strings, so there is nothing to balance")
    rest_length = None
    if winches is not None:
        validation.instance("winches", winches, Winches, "make them by Winches(shortest=...)")
        if model.strings is None:
            raise ValueError(
                "winches bound rest lengths, but the model has no string law; "
                "build it as Model(structure, strings=LinearStrings(stiffness=...))"
            )
        if winches.shortest is not None or winches.longest is not None:
            shortest, longest = winches.range(count)
            if held is not None:  # passive strings have no winch
                passive = held.actuation.input < 0
                shortest = np.where(passive, 0.0, shortest)
                longest = np.where(passive, np.inf, longest)
            rest_length = shortest, longest
    return string_bounds(
        count,
        min_force_density,
        max_force_density,
        largest=np.inf if model.strings is None else model.strings.largest_force_density,
        rest_length=rest_length,
    )


# ---- the forces chosen between the bounds ----


def choose_force_density(
    structure: Structure,
    load: FloatArray,
    limits: ForceLimits,
    low: FloatArray,
    high: FloatArray,
    kind: str,
) -> FloatArray | None:
    """Return γ, shape (α,), that balances in the shape of a structure, or None if none does.

    ``kind`` is "centred", the analytic centre of the bounds (Boyd & Vandenberghe, *Convex
    Optimization*, 8.5.3), or "least", the least sum of squares: unique, so that a symmetric shape
    gets symmetric forces. ``low`` and ``high``, N/m, replace the bounds of γ in ``limits``.
    """
    forces = member_forces(structure, free_coordinates(structure, load) / limits.scale)
    pulls = forces.live[: len(structure.strings)]
    count = int(pulls.sum())
    D, p = forces.states[:count], forces.particular[:count]
    if limits.level is not None:
        mine = np.flatnonzero(np.isin(np.flatnonzero(pulls), limits.reference))
        mean = D[mine].mean(axis=0)
        weight = float(mean @ mean)
        short = limits.level / limits.scale - p[mine].mean()
        if weight >= _ZERO**2:
            p = p + D @ mean * short / weight
            D = D @ np.linalg.svd(mean[None, :])[2][1:].T
        elif abs(short) > _ZERO:
            return None
    least, most = low[pulls] / limits.scale, high[pulls] / limits.scale
    chosen = (_analytic_centre if kind == "centred" else _least)(D, p, least, most)
    if chosen is not None and kind == "centred" and np.abs(chosen).max(initial=0.0) > _FAR:
        chosen = _least(D, p, least, most)
    if chosen is None:
        return None
    gamma = low.copy()
    gamma[pulls] = np.clip(limits.scale * chosen, low[pulls], high[pulls])
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
    """Return the ``p + D x`` for which the product of distances from the bounds is largest."""
    x = _inside(D, p, low, high)
    if x is None:
        return None
    p, x = p + D @ x, np.zeros(D.shape[1])
    # Entries that are at a bound in all of the set are left out.
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

    farthest_point = farthest(np.ones(m))
    if farthest_point is None or farthest_point[-1] > _STUCK:
        return None if farthest_point is None else farthest_point[:-1]
    # No point is inside all bounds: take the mean of those that are inside one each.
    vertices = [farthest(row) for row in np.eye(m)]
    points = [x[:-1] for x in vertices if x is not None]
    return np.asarray(np.mean(points, axis=0))
