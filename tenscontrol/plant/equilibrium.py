"""Equilibrium shapes under loads."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.evaluator import BUILDING
from tenscontrol.dynamics.held_inputs import given_load, held_value, own_input
from tenscontrol.dynamics.model import Model
from tenscontrol.plant.linear_plant import INPUTS
from tenscontrol.plant.potential import Potential
from tenscontrol.plant.saddle import least_curvature, least_step
from tenscontrol.plant.stance import (
    GroundPoints,
    Stance,
    StanceContacts,
    Sticking,
    contact_forces,
    let_down,
    refuse_slip,
)
from tenscontrol.statics.equilibrium_matrix import member_forces
from tenscontrol.statics.prestress import Prestress, balanced
from tenscontrol.structure.bar_clearance import BarCrossing, BarMotion
from tenscontrol.structure.bar_geometry import refuse_strings_without_length, restore_bar_lengths
from tenscontrol.structure.structure import Structure, refuse_all_fixed
from tenscontrol.structure.supports import (
    free_coordinates,
    refuse_load_without_support,
    refuse_moved_supports,
    rotation_between,
)
from tenscontrol.warn import warn

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

# A segment of a clustered string below this part of the size has no length.
_NO_LENGTH = 1e-9

_HINT = "Start from other nodes"

# Times that the nodes which touch the ground are sought again, and the angle, rad, by which a
# structure that does not fall may tilt.
_LANDINGS, _FALLEN = 40, 0.5

_NOTHING_HOLDS = (
    "On its ground it may slide or fall: give friction or supports, or use "
    "plant.set_down(model, feet)"
)


def equilibrium(
    model: Model,
    *,
    rest_length: object = None,
    force_density: object = None,
    nodes: object = None,
    external_force: object = None,
    settle: object = False,
) -> Prestress:
    """Return the equilibrium shape of a structure under its weights and loads.

    It minimizes the energy of strings and loads over the shapes that keep the bar lengths. The
    result is stable: an equilibrium that is not a minimum, such as an inverted pendulum, is
    rejected. Bars may share nodes. Strings may be clustered, nearly without tension, or all slack.

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
    settle : bool
        On ground: whether feet move along it until all use the same part of their
        friction; see the notes. If not, only where a foot would slip.

    Returns
    -------
    Prestress
        Its ``structure`` has the shape found, its ``external_force`` is all
        that acts, weights included. Its ``crossings`` are the bars that pass through each other on
        the straight way from the shape at the start; ``clearance`` says how near bars come in the
        one found. For a model with ground it is a :class:`Stance`, with the ``contacts`` and the
        margin against ``tipping``.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or no equilibrium is found; the message
        says what the optimizer ended with, or which clustered string draws two of its nodes
        together: there its force has no direction, and the energy no slope. On the ground: if it
        slips, falls over (tilts by more than half a radian), slides or falls away.

    Warns
    -----
    UserWarning
        If all strings end slack while their rest lengths are held, or bars pass through one another
        on the straight way from the shape at the start to the one found (in space).

    Notes
    -----
    Solved by IPOPT with exact derivatives from CasADi, then polished by
    Newton steps on the conditions of optimality. Where IPOPT does not end, strings stiffer than the
    softest get their stiffness step by step, and clustered ones the sharp bends at their nodes.

    A structure that nothing holds keeps its centre of mass. Without loads it keeps its attitude
    too: turned as one body, the shape would be farther from that at the start, counted by masses.

    On **ground**, its stored energy joins that of the strings, and nodes that touch where there is
    friction keep their places along it: those that touch at the start, and those that are met on
    the way, from where they come to rest. A structure in the air is first let down along the
    resultant of its loads until a node touches; :func:`~tenscontrol.plant.set_down` puts it on
    given nodes. Which nodes touch is sought until it is consistent. The places determine the forces
    along the ground, where statics alone does not: other starts give other forces. If they ask more
    of a foot than friction holds, or with ``settle=True``, the feet move against each other, but
    not as one body, until F_t/(μ F_n) is the same at all of them: zero on level ground, on a plane
    slope its tangent by μ. There the rounded friction of the laws ends too, whose feet creep.

    Examples
    --------
    A prism on ground, whose feet use some of their friction; it may be tilted by 27°:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> strings, ground = tc.LinearStrings(stiffness=500.0), tc.Ground(5e3, friction=0.5)
    >>> model = tc.Model(prism, strings=strings, gravity=9.81, ground=ground)
    >>> gamma = tc.statics.prism_force_density(3, 60.0)[0]
    >>> wound = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    >>> stance = tc.equilibrium(model, rest_length=wound, settle=True)
    >>> stance.contacts.node, stance.contacts.normal_force.round(6)
    (array([3, 4, 5]), array([9.81, 9.81, 9.81]))
    >>> round(float(np.degrees(stance.tipping.angle)))
    27

    A prism on three supports sinks a little under its own weight:

    >>> standing = tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3, 4, 5])
    >>> model = tc.Model(standing, strings=tc.LinearStrings(stiffness=500.0), gravity=9.81)
    >>> gamma = tc.statics.prism_force_density(3, 60.0)[0]
    >>> wound = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    >>> rest = tc.equilibrium(model, rest_length=wound)
    >>> (rest.structure.nodes[2, :3] - 1.0).round(4), rest.residual < 1e-9
    (array([-0.0041, -0.0041, -0.0041]), True)
    """
    validation.instance("model", model, Model, "make one by Model(structure)")
    settles = validation.truth(
        "settle", settle, "whether feet move along the ground until they share its friction"
    )
    structure = model.structure
    refuse_all_fixed(structure)
    rest_length, force_density = own_input(model, rest_length, force_density)
    if (rest_length is None) == (force_density is None):
        given = "neither" if rest_length is None else "both"
        raise ValueError(f"expected one of rest_length and force_density, found {given}")
    start, called = structure.nodes, "the structure"
    if nodes is not None:
        start, called = structure.checked_nodes("nodes", nodes), "nodes"
        refuse_moved_supports("nodes", structure, start)
        start = restore_bar_lengths(structure, start)
    load = model.constant_force.copy()
    if external_force is not None:
        load += given_load(model, external_force)
    held = held_value(model.structure, rest_length, force_density)
    kind = INPUTS[rest_length is not None]
    law = model.strings
    if kind == "rest_length":
        refuse_strings_without_length(called, structure, start)
        if law is None:
            raise ValueError(
                "the model has no string law, so rest lengths have no meaning for it; "
                "build it as Model(structure, strings=LinearStrings(stiffness=...))"
            )
    strained = _strained(model, kind, held)
    least, contacts, softest = float(strained.max(initial=0.0)), None, 0.0
    if model.contacts is None:
        refuse_load_without_support(structure, load)
        end, _ = _minimize(model, kind, held, load, start, strained)
        if not len(structure.fixed_rows):
            end = _moved_back(structure, start, end, turns=not load.any())
        settled = _settled(structure, end)
        gamma = _pulling(model, kind, held, load, settled, least)
    else:
        settled, gamma, contacts, softest = _stood(
            model, kind, held, load, start, strained, settles
        )
        np.add.at(load.T, contacts.node, contacts.force.T)
        least = max(least, float(contacts.normal_force.max(initial=0.0)))
    failure = f"no equilibrium found with this {kind}"
    forces = member_forces(settled, free_coordinates(settled, load))
    rest = balanced(settled, forces, gamma, load, failure, _HINT, least)
    if contacts is not None:
        rest = Stance(**vars(rest), contacts=contacts, least_stiffness=softest)
    if kind == "rest_length":
        _warn_of_slack(rest, forces.live)
    crossings = _crossings(structure, start, settled.nodes)
    if crossings:
        i, j = crossings[0].bars
        warn(
            f"bars {i} and {j} pass through each other on the way from the shape at the start to "
            "the equilibrium found: a real structure cannot move like this. If this is not meant, "
            "start from nodes on the other side",
            UserWarning,
        )
    return replace(rest, crossings=crossings)


def _strained(model: Model, kind: str, held: FloatArray) -> FloatArray:
    """Return the tensions of the strings at a small strain, N, shape (α,)."""
    if kind == "force_density":
        return _STRAIN * held * model.structure.size
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
            f"no equilibrium found: the optimizer ended with an impossible shape. {error}. {_HINT}"
        ) from None


def _warn_of_slack(rest: Prestress, live: np.ndarray) -> None:
    """Warn if no string has a force, but for those between fixed nodes."""
    moving = live[: len(rest.force_density)]
    if not moving.any() or rest.force_density[moving].any():
        return
    warn(
        "in the equilibrium found, all strings are slack; shorter rest lengths would tighten them",
        UserWarning,
    )


def _crossings(structure: Structure, start: FloatArray, end: FloatArray) -> tuple[BarCrossing, ...]:
    """Return the bars that pass through each other on the straight way between two shapes."""
    if len(structure.bars) < 2 or structure.dimension == 2:
        return ()
    if not len(structure.fixed_rows):
        end = _moved_back(structure, start, end, turns=True)
    return BarMotion(structure, np.array([0.0, 1.0]), np.stack([start, end], axis=-1)).crossings


def _moved_back(
    structure: Structure, start: FloatArray, end: FloatArray, turns: bool
) -> FloatArray:
    """Return a shape moved, and turned where it may be, as one body to be nearest to the start.

    Nearest in the metric of the masses at nodes, half a bar at each end: the centre of mass stays.
    The turn is that of Kabsch, Acta Crystallographica A 32 (1976), without a reflection.
    """
    mass = structure.point_mass.copy()
    np.add.at(mass, structure.bars, structure.bar_mass[:, None] / 2)
    centre, centre_found = (nodes @ mass[:, None] / mass.sum() for nodes in (start, end))
    around = end - centre_found
    if turns:
        U, _, Vt = np.linalg.svd((mass * around) @ (start - centre).T)
        proper = np.ones(len(start))
        proper[-1] = np.sign(np.linalg.det(U @ Vt))
        around = (Vt.T * proper) @ U.T @ around
    return np.asarray(around + centre)


def _stood(
    model: Model, kind: str, held: FloatArray, load: FloatArray, start: FloatArray,
    strained: FloatArray, settle: bool,
) -> tuple[Structure, FloatArray, StanceContacts, float]:  # fmt: skip
    """Return a standing shape, γ of its strings, its contacts, and its least stiffness, N/m."""
    structure, bars = model.structure, model.structure.kept_bars
    least_force = float(strained.max(initial=0.0))
    nodes = first = let_down(model, start, load)
    points = GroundPoints.of(model, nodes).touching(float(np.ptp(nodes, axis=1).max()))
    places, settling, has_settled = {i: nodes[:, i] for i in points.gripping}, settle, settle
    let_go = set[int]()
    for _ in range(_LANDINGS):
        sticking = Sticking.at(structure, nodes, points, places, bars, settling)
        try:
            nodes, softest = _minimize(model, kind, held, load, nodes, strained, sticking)
        except ValueError as error:
            if has_settled:
                raise ValueError(f"{error}. {_NOTHING_HOLDS}") from None
            settling = has_settled = True
            continue
        if not len(structure.fixed_rows):
            _refuse_fall(first, nodes, load.sum(axis=1), kind)
        before, points = points, GroundPoints.of(model, nodes).pressing
        here = {i: nodes[:, i] for i in points.gripping}
        let_go |= places.keys() - here.keys()
        # Who has let go does not join again while feet settle, lest it goes on without end.
        sticks = here.keys() - let_go if settling else here.keys()
        if places.keys() == sticks and points.agrees(before, settling):
            if settling:
                places, settling = here, False
                continue
            settled = _settled(structure, nodes)
            gamma = _pulling(model, kind, held, load, settled, least_force)
            points = GroundPoints.of(model, settled.nodes).pressing
            contacts = contact_forces(settled, gamma, load, sticking, points)
            if has_settled:
                refuse_slip(contacts)
            if contacts.cone_use.max(initial=0.0) <= 1:
                return settled, gamma, contacts, softest
            settling = has_settled = True
        # Who lets go is free; who is met sticks where it came to rest.
        keeps = places.keys() <= sticks
        places = {i: places.get(i, here[i]) for i in sorted(sticks) if keeps or i in places}
    raise ValueError(
        "no equilibrium found: nodes touch and leave the ground in turn without end. Start from "
        "nodes nearer to the standing shape"
    )


def _pulling(
    model: Model, kind: str, held: FloatArray, load: FloatArray, settled: Structure, least: float
) -> FloatArray:
    """Return γ of each string of a shape, N/m; ``least`` is what judges forces, N."""
    if model.strings is None or kind == "force_density":
        return held
    length = np.maximum(settled.string_length(), _EXACT * held)
    gamma = model.strings.force_density(length, held)
    # Slack but for round-off: all of them, or those that carry less than it.
    is_slack = not load.any() and (gamma * length).max(initial=0.0) < _SLACK * least
    return np.where(gamma * length > (np.inf if is_slack else _EXACT * least), gamma, 0.0)


def _refuse_fall(start: FloatArray, end: FloatArray, resultant: FloatArray, kind: str) -> None:
    """Raise if a shape has tilted from the resultant of its loads, or gone far away."""
    turn = rotation_between(start, end)
    away = float(np.linalg.norm((end - start).mean(axis=1)))
    fall = resultant / (np.linalg.norm(resultant) or 1.0)
    angle = float(np.arccos(np.clip(fall @ turn @ fall, -1.0, 1.0))) if fall.any() else 0.0
    if angle > _FALLEN or away > np.ptp(start, axis=1).max():
        motion = f"tilts by {np.degrees(angle):.0f}°"
        if angle <= _FALLEN:
            motion = f"moves {away:.3g} m away"
        raise ValueError(
            f"no equilibrium with this {kind}: from the shape at the start the structure falls: it "
            f"{motion} before it comes to rest. Start from nodes that stand, as "
            "plant.set_down(model, feet) gives them"
        )


def _minimize(
    model: Model, kind: str, held: FloatArray, load: FloatArray, start: FloatArray,
    strained: FloatArray, sticking: Sticking | None = None,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Return the nodes of least energy with these bar lengths, and the least stiffness, N/m."""
    from scipy.sparse import eye_array

    structure, rows = model.structure, model.structure.free_rows
    at_rest = eye_array(start.size, format="csc")[:, rows]
    origin, motions = structure.nodes.ravel(order="F").copy(), at_rest
    origin[rows] = 0.0
    position = free_coordinates(structure, start)
    if sticking is not None:
        origin[rows] = sticking.origin
        motions = at_rest @ sticking.motions
        position = sticking.motions.T @ (position - sticking.origin)
    potential = Potential(model, kind, held, load, origin, motions)
    count, size = potential.count, structure.size
    stiffness = float(strained.max(initial=0.0)) / (_STRAIN * size)
    flat_below = _EXACT * stiffness
    for _ in range(_ESCAPES):
        point, trouble = _optimized(
            potential.solver, position, strained, size, structure.has_clusters
        )
        if structure.has_clusters:
            ends = potential.nodes(point[:count])
            pulling = held > 0 if kind == "force_density" else structure.string_length(ends) > held
            _refuse_collapsed(
                structure, ends, pulling, size * (_COLLAPSED if trouble else _NO_LENGTH)
            )
        point, off = _polished(potential, point, size, stiffness)
        if trouble and off > _EXACT * size:
            raise ValueError(trouble)
        position = point[:count]
        here = potential.conditions(point)
        least, downhill = least_curvature(here.hessian, here.by_coordinates.tocsr(), flat_below)
        if least >= 0:
            return potential.nodes(position), least
        # An unstable equilibrium, such as a pendulum upside down: pushed off, it falls.
        position = position + 0.01 * size * downhill
    raise ValueError(f"no stable equilibrium found: the equilibrium found is unstable. {_HINT}")


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
            f"{one} and {other} and pulls them to one point, where its force has no direction. "
            f"End the string at one of them, or change the rest lengths. {_HINT}"
        )


def _optimized(
    solver: ca.Function, position: FloatArray, strained: FloatArray, size: float, is_rounded: bool
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
    for share in 0.1 ** np.arange(_ROUNDINGS if is_rounded else 0):
        stages.append(np.append(np.ones(len(ratio)), share * widest))
    stages += [plain] if len(stages) > 1 else []
    for stage in stages:
        with BUILDING:
            answer = solver(x0=position, p=stage, lbg=0.0, ubg=0.0)
        status = solver.stats()
        vectors = [np.array(answer[name]).ravel() for name in ("x", "lam_g")]
        if status["success"] and stage is plain:
            return np.concatenate(vectors), ""
        position = vectors[0] if status["success"] else position
    return np.concatenate([position, vectors[1]]), (
        f"no equilibrium found: the optimizer ended with {status['return_status']!r} after "
        f"{status['iter_count']} iterations. {_HINT}, or check that strings and supports can carry "
        "the load"
    )


def _polished(
    potential: Potential, point: FloatArray, size: float, stiffness: float
) -> tuple[FloatArray, float]:
    """Return the best point of Newton's steps on the conditions of optimality, and how far off, m.

    Forces are judged in units of the stiffness of strings, N/m: where all are slack nothing else is
    there, and beside very stiff ones the lengths of bars would be lost.
    """
    from scipy.sparse import block_array

    best, least, worse, count = point, np.inf, 0, potential.count
    for _ in range(_POLISH):
        here = potential.conditions(point)
        unit = max(stiffness, float(abs(here.hessian).max())) or 1.0
        J = here.by_coordinates / size
        system = block_array([[here.hessian / unit, J.T], [J, None]], format="csc")
        off = np.concatenate([here.slope / unit, here.stretch / size])
        if not (np.isfinite(system.data).all() and np.isfinite(off).all()):
            raise ValueError("no equilibrium found: the forces overflow")
        largest = float(np.abs(off).max(initial=0.0))
        worse = 0 if largest < least else worse + 1
        if largest < least:
            best, least = point, largest
        if worse == _WORSE or least < _ROUND_OFF * size:
            break
        step = least_step(system, off, count)
        step[count:] *= unit / size
        point = point - step
    return best, least
