"""Equilibrium under load, where the shape must give."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Model, builds, kernel, solving
from tenscontrol.plant.linear_plant import INPUTS
from tenscontrol.statics import Prestress, balanced, listed, member_forces
from tenscontrol.structure import (
    Structure,
    bar_distances,
    crossing,
    free_coordinates,
    refuse_load_without_support,
    refuse_moved_supports,
    refuse_strings_without_length,
    restore_bar_lengths,
)
from tenscontrol.validation import FloatArray, instance, non_negative, per_member, positive, shaped

# Newton steps that polish the answer of the optimizer, each of which doubles the digits, and how
# many of them may bring nothing.
_POLISH, _WORSE = 20, 3

# Steps in which clustered strings are rounded, each a tenth of the one before, and the length of a
# segment, relative to the structure, that then is on its way to nothing.
_ROUNDINGS, _COLLAPSED = 6, 1e-3

# Unstable equilibria to leave before giving up.
_ESCAPES = 5

# Forces are judged against those of the stiffest string at this strain: where all strings are
# slack there are no others. Lengths, and forces where all are slack, are exact to this.
_STRAIN, _EXACT = 1e-3, 1e-12

# Newton's steps have nothing left to do below this part of the size.
_ROUND_OFF = 1e-16

# Without a load, strings that all pull less than this part of that force are slack.
_SLACK = 1e-10

# Iterations of the optimizer at most, and shapes that are looked at on the way from the start.
_ITERATIONS, _WAY = 500, 40

# Curvature of the energy below this fraction of the stiffest string's is none.
_FLAT = 1e-9

_HINT = "Start from other nodes"


def equilibrium(
    model: Model,
    *,
    rest_length: object = None,
    force_density: object = None,
    nodes: object = None,
    external_force: object = None,
) -> Prestress:
    """Return the shape at which a structure rests under its weights and loads.

    The energy of the strings and the loads is minimized over the shapes that
    keep the bar lengths. An equilibrium at which the energy is not least near
    by, such as a pendulum upside down, is left again: what is returned is stable.
    Bars may share nodes, strings be clustered, nearly without tension, or all slack.

    Parameters
    ----------
    model : Model
        Its weights and built-in load act.
    rest_length : float or array_like, shape (α,), optional
        Rest lengths that are held, m. Either this or ``force_density``.
    force_density : float or array_like, shape (α,), optional
        γ that are held, N/m.
    nodes : array_like, shape (d, n), optional
        Shape to start from, m; the reference shape if not given.
    external_force : array_like, shape (d, n), optional
        Load W, N, for a model that takes one.

    Returns
    -------
    Prestress
        Its ``structure`` has the shape found, its ``external_force`` is all
        that acts, weights included.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or no equilibrium is found; the message
        says what the optimizer ended with, or which clustered string draws two of its nodes
        together: there its force has no direction, and the energy no slope.

    Warns
    -----
    UserWarning
        If strings end slack while their rest lengths are held, or bars pass through one another on
        the straight way from the shape at the start to the one found (in space).

    Notes
    -----
    Solved by IPOPT with exact derivatives from CasADi, then polished by
    Newton steps on the conditions of optimality. Where IPOPT does not end, strings stiffer than the
    softest get their stiffness step by step, and clustered ones the sharp bends at their nodes.

    Examples
    --------
    A prism on three supports sinks a little under its own weight:

    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> standing = tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3, 4, 5])
    >>> model = tc.Model(standing, strings=tc.LinearStrings(stiffness=500.0), gravity=9.81)
    >>> gamma = tc.statics.prism_force_density(3, 60.0)[0]
    >>> wound = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    >>> rest = tc.equilibrium(model, rest_length=wound)
    >>> (rest.structure.nodes[2, :3] - 1.0).round(4), rest.residual < 1e-9
    (array([-0.0041, -0.0041, -0.0041]), True)
    """
    instance("model", model, Model, "make one by Model(structure)")
    structure = model.structure
    if (rest_length is None) == (force_density is None):
        found = "neither" if rest_length is None else "both"
        raise ValueError(f"expected one of rest_length and force_density, found {found}")
    start, called = structure.nodes, "the structure"
    if nodes is not None:
        start, called = structure.checked_nodes("nodes", nodes), "nodes"
        refuse_moved_supports("nodes", structure, start)
        start = restore_bar_lengths(structure, start)
    load = model.constant_force
    if external_force is not None:
        if not model.has_external_force:
            raise ValueError(
                "the model takes no load as an input; build it as "
                "Model(structure, external_force=True)"
            )
        shape = structure.nodes.shape
        load = load + shaped("external_force", external_force, shape, "one force per node")
    held, kind = held_value(model, rest_length, force_density), INPUTS[rest_length is not None]
    law = model.strings
    if kind == "rest_length":
        refuse_strings_without_length(called, structure, start)
        if law is None:
            raise ValueError(
                "the model has no string law, so rest lengths mean nothing to it; "
                "build it as Model(structure, strings=LinearStrings(stiffness=...))"
            )
    refuse_load_without_support(structure, load)
    strained = _strained(model, kind, held)
    settled = _settled(structure, _minimize(model, kind, held, load, start, strained))
    least = float(strained.max(initial=0.0))
    gamma = held
    if law is not None and kind == "rest_length":
        length = np.maximum(settled.string_length(), _EXACT * held)
        gamma = law.force_density(length, held)
        # Slack but for round-off: all of them, or those that carry less than it.
        is_slack = not load.any() and (gamma * length).max(initial=0.0) < _SLACK * least
        gamma = np.where(gamma * length > (np.inf if is_slack else _EXACT * least), gamma, 0.0)
    what = f"no equilibrium found with this {kind}"
    forces = member_forces(settled, free_coordinates(settled, load))
    rest = balanced(settled, forces, gamma, load, what, _HINT, least)
    if kind == "rest_length":
        _warn_of_slack(rest, forces.live)
    _warn_of_crossing(structure, start, settled.nodes)
    return rest


def _strained(model: Model, kind: str, held: FloatArray) -> FloatArray:
    """Return the tensions of the strings at a small strain, N, shape (α,)."""
    if kind == "force_density":
        return _STRAIN * held * float(np.ptp(model.structure.nodes, axis=1).max())
    if model.strings is None or len(held) == 0:
        return np.zeros(len(held))
    length = (1 + _STRAIN) * held
    return model.strings.force_density(length, held) * length


def _settled(structure: Structure, nodes: FloatArray) -> Structure:
    """Return the structure in the shape found, with its bars at their lengths."""
    try:
        return replace(structure, nodes=restore_bar_lengths(structure, nodes))
    except ValueError as error:
        raise ValueError(
            f"no equilibrium found: the shape that the optimizer ended with cannot be. {error}. "
            f"{_HINT}"
        ) from None


def _warn_of_slack(rest: Prestress, live: np.ndarray) -> None:
    """Warn of strings without force, but for those between fixed nodes."""
    moving = live[: len(rest.force_density)]
    slack = np.flatnonzero((rest.force_density == 0) & moving)
    if len(slack) == 0:
        return
    which = "all strings" if len(slack) == moving.sum() else f"strings {listed(slack)}"
    warnings.warn(
        f"in the equilibrium found, {which} are slack; shorter rest lengths would tighten them",
        UserWarning,
        stacklevel=3,
    )


def _warn_of_crossing(structure: Structure, start: FloatArray, end: FloatArray) -> None:
    """Warn if bars pass through one another on the straight way between two shapes."""
    if len(structure.bars) < 2 or structure.dimension == 2:
        return
    if len(structure.fixed_rows) == 0:  # turned back to where it was
        middle = start.mean(axis=1, keepdims=True)
        there = end - end.mean(axis=1, keepdims=True)
        U, _, Vt = np.linalg.svd(there @ (start - middle).T)
        mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))])
        end = Vt.T @ mirror @ U.T @ there + middle
    before = bar_distances(structure, start)
    farthest = float(np.linalg.norm(end - start, axis=0).max())
    if before.least > 2 * farthest:  # too far apart to meet
        return
    for step in np.linspace(0, 1, _WAY)[1:]:
        after = bar_distances(structure, start + step * (end - start))
        pair = crossing(before, after)
        if pair is not None:
            warnings.warn(
                f"bars {pair[0]} and {pair[1]} pass through each other on the way from the shape "
                "at the start to the equilibrium found: a real structure does not get there like "
                "this. Start from nodes on the other side, if that is not meant",
                UserWarning,
                stacklevel=3,
            )
            return
        before = after


def held_value(model: Model, rest_length: object, force_density: object) -> FloatArray:
    """Return what is held, shape (α,): the one that is not None, checked."""
    count = len(model.structure.strings)
    if force_density is None:
        values = per_member("rest_length", rest_length, count, "string")
        return positive("rest_length", values, "length in m")
    gamma = per_member("force_density", force_density, count, "string")
    return non_negative("force_density", gamma, "a string can only pull")


@builds
def _minimize(
    model: Model, kind: str, held: FloatArray, load: FloatArray, start: FloatArray,
    strained: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return the nodes of least energy with these bar lengths."""
    structure, rows = model.structure, model.structure.free_rows
    q, weights, rounding = (
        ca.SX.sym(name, count)
        for name, count in (("q", len(rows)), ("weights", len(held)), ("rounding", 1))
    )
    stage = ca.vertcat(weights, rounding)
    flat = ca.SX(ca.DM(structure.nodes.ravel(order="F")))
    flat[rows.tolist()] = q
    nodes = ca.reshape(flat, *structure.nodes.shape)
    energies = _string_energies(model, kind, nodes, held, rounding)
    energy = ca.dot(weights, energies) - ca.dot(free_coordinates(structure, load), q)
    moving = np.concatenate(
        [structure.free_bars, structure.swinging_bars, *(b.independent for b in structure.blocks)]
    )
    B = kernel.differences(nodes, structure.bars[moving])
    stretch = (kernel.dots(B, B).T - ca.DM(structure.bar_length[moving] ** 2)) / 2
    problem = {"x": q, "p": stage, "f": energy, "g": stretch}
    quiet = {
        "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "max_iter": _ITERATIONS},
    }
    solver = ca.nlpsol("equilibrium", "ipopt", problem, quiet)
    lam = ca.SX.sym("lambda", stretch.numel())
    energy = ca.substitute(energy, stage, ca.DM(np.append(np.ones(len(held)), 0.0)))
    conditions = ca.vertcat(ca.gradient(energy + ca.dot(lam, stretch), q), stretch)
    unknowns = ca.vertcat(q, lam)
    newton = ca.Function("newton", [unknowns], [conditions, ca.jacobian(conditions, unknowns)])
    place = free_coordinates(structure, start)
    size = float(np.ptp(structure.nodes, axis=1).max())
    stiffness = float(strained.max(initial=0.0)) / (_STRAIN * size)
    flat_below = _EXACT * stiffness
    for _ in range(_ESCAPES):
        point, trouble = _optimized(solver, place, strained, size, structure.has_clusters)
        if structure.has_clusters:
            ends = _with_rows(structure, point[: len(rows)])
            pulling = held > 0 if kind == "force_density" else structure.string_length(ends) > held
            _refuse_collapsed(structure, ends, pulling, size * (_COLLAPSED if trouble else _FLAT))
        point, off = _polished(newton, point, len(rows), size, stiffness)
        if trouble and off > _EXACT * size:
            raise ValueError(trouble)
        place, downhill = point[: len(rows)], _downhill(newton, point, len(rows), flat_below)
        if downhill is None:
            return _with_rows(structure, place)
        # An unstable equilibrium, such as a pendulum upside down: pushed off, it falls.
        place = place + 0.01 * size * downhill
    raise ValueError(
        "no stable equilibrium found: the shape comes to rest only where a small push makes it "
        f"fall. {_HINT}"
    )


def _with_rows(structure: Structure, place: FloatArray) -> FloatArray:
    """Return all nodes, shape (d, n), from the coordinates that supports leave free."""
    found = structure.nodes.ravel(order="F").copy()
    found[structure.free_rows] = place
    return np.asarray(found.reshape(structure.nodes.shape, order="F"))


def _refuse_collapsed(
    structure: Structure, nodes: FloatArray, pulling: np.ndarray, below: float
) -> None:
    """Raise if a clustered string that pulls draws the ends of a segment together."""
    length = np.linalg.norm(structure.string_vectors(nodes), axis=0)
    short = np.flatnonzero(pulling[structure.segment_string] & (length < below))
    if len(short):
        one, other = structure.segments[short[0]]
        raise ValueError(
            f"no equilibrium found: strings[{structure.segment_string[short[0]]}] runs over nodes "
            f"{one} and {other} and draws them together, where its force has no direction. Let it "
            f"end there, or change rest lengths. {_HINT}"
        )


def _string_energies(model: Model, kind: str, nodes: Any, held: FloatArray, rounding: Any) -> Any:
    """Return what each string stores, J, shape (α, 1).

    The segments of clusters are rounded where they are short: ``√(l² + rounding²)``.
    """
    structure = model.structure
    if len(held) == 0:
        return ca.SX(0, 1)
    S = kernel.differences(nodes, structure.segments)
    square = kernel.dots(S, S).T
    if not structure.has_clusters:
        if kind == "force_density":
            return square * ca.DM(held) / 2
        length = kernel.pulling_length(S, ca.DM(held).T).T
    else:
        size = float(np.ptp(structure.nodes, axis=1).max())
        each = ca.sqrt(ca.fmax(square, (_EXACT * size) ** 2) + rounding**2)
        count = len(structure.segments)
        sums = ca.DM.triplet(
            structure.segment_string.tolist(), list(range(count)), ca.DM.ones(count),
            len(held), count,
        )  # fmt: skip
        length = ca.mtimes(sums, each)
    if kind == "force_density":
        return length**2 * ca.DM(held) / 2
    assert model.strings is not None  # refused before
    return model.strings.as_expressions().stored_energy(length, ca.DM(held))


def _optimized(
    solver: ca.Function, place: FloatArray, strained: FloatArray, size: float, is_rounded: bool
) -> tuple[FloatArray, str]:
    """Return positions and multipliers from the optimizer, and what it says if it did not end.

    Where it does not end, strings stiffer than the softest are made so step by step, and clustered
    ones are rounded less and less where their segments are short.
    """
    ratio = strained / strained[strained > 0].min(initial=np.inf)
    decades = int(np.ceil(np.log10(ratio.max(initial=1.0))))
    widest = 0.1 * size if is_rounded else 0.0
    plain = np.append(np.ones(len(ratio)), 0.0)
    stages = [plain]
    for most in 10.0 ** np.arange(decades):
        stages.append(np.append(most / np.maximum(ratio, most), widest))
    for part in 0.1 ** np.arange(_ROUNDINGS if is_rounded else 0):
        stages.append(np.append(np.ones(len(ratio)), part * widest))
    stages += [plain] if len(stages) > 1 else []
    for stage in stages:
        with solving():
            answer = solver(x0=place, p=stage, lbg=0.0, ubg=0.0)
        status = solver.stats()
        found = [np.array(answer[part]).ravel() for part in ("x", "lam_g")]
        if status["success"] and stage is plain:
            return np.concatenate(found), ""
        place = found[0] if status["success"] else place
    return np.concatenate([place, found[1]]), (
        f"no equilibrium found: the optimizer ended with {status['return_status']!r} after "
        f"{status['iter_count']} iterations. {_HINT}, or check that strings and supports can carry "
        "the load"
    )


def _polished(
    newton: ca.Function, point: FloatArray, count: int, size: float, stiffness: float
) -> tuple[FloatArray, float]:
    """Return the best point of Newton's steps on the conditions of optimality, and how far off, m.

    Forces are judged in units of the stiffness of strings, N/m: where all are slack nothing else is
    there, and beside very stiff ones the lengths of bars would be lost.
    """
    best, least, worse = point, np.inf, 0
    for _ in range(_POLISH):
        residual, jacobian = (np.array(part.full()) for part in newton(point))
        unit = max(stiffness, float(np.abs(jacobian[:count, :count]).max(initial=0.0))) or 1.0
        rows = np.concatenate([np.full(count, unit), np.full(len(point) - count, size)])
        columns = np.concatenate([np.ones(count), np.full(len(point) - count, unit / size)])
        off = residual.ravel() / rows
        # Least squares: motions as one body that nothing holds leave a null space.
        system = jacobian / rows[:, None] * columns
        if not (np.isfinite(system).all() and np.isfinite(off).all()):
            raise ValueError("no equilibrium found: forces are beyond all numbers")
        largest = float(np.abs(off).max(initial=0.0))
        worse = 0 if largest < least else worse + 1
        if largest < least:
            best, least = point, largest
        if worse == _WORSE or least < _ROUND_OFF * size:
            break
        point = point - columns * np.linalg.lstsq(system, off, rcond=_EXACT)[0]
    return best, least


def _downhill(newton: ca.Function, point: FloatArray, count: int, flat: float) -> FloatArray | None:
    """Return a direction in which the energy falls with bar lengths kept, or None."""
    from scipy.linalg import null_space

    _, jacobian = (np.array(part.full()) for part in newton(point))
    hessian, constraints = jacobian[:count, :count], jacobian[count:, :count]
    free = null_space(constraints) if len(constraints) else np.eye(count)
    if free.shape[1] == 0:
        return None
    values, vectors = np.linalg.eigh(free.T @ hessian @ free)
    if values[0] >= -max(flat, _FLAT * np.abs(hessian).max()):
        return None
    return np.asarray(free @ vectors[:, 0])
