"""Equilibrium under load, where the shape must give."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Model, builds, kernel, solving
from tenscontrol.plant.linear_plant import INPUTS
from tenscontrol.statics import Prestress, balanced, member_forces
from tenscontrol.structure import (
    free_coordinates,
    refuse_load_without_support,
    refuse_moved_supports,
    refuse_strings_without_length,
    restore_bar_lengths,
)
from tenscontrol.validation import FloatArray, instance, non_negative, per_member, positive, shaped

# Newton steps that polish the answer of the optimizer; each doubles the digits.
_POLISH = 10

# Unstable equilibria to leave before giving up.
_ESCAPES = 5

# Forces are judged against those of the stiffest string at this strain: where all strings are
# slack there are no others. Lengths, and forces where all are slack, are exact to this.
_STRAIN, _EXACT = 1e-3, 1e-12

# Curvature of the energy below this fraction of the stiffest string's is none.
_FLAT = 1e-9


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

    Parameters
    ----------
    model : Model
        Its weights and built-in load act.
    rest_length : float or array_like, shape (α,), optional
        Rest lengths that are held, m. Either this or ``force_density``.
    force_density : float or array_like, shape (α,), optional
        γ that are held, N/m.
    nodes : array_like, shape (3, n), optional
        Shape to start from, m; the reference shape if not given.
    external_force : array_like, shape (3, n), optional
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
        says what the optimizer ended with.

    Notes
    -----
    Solved by IPOPT with exact derivatives from CasADi, then polished by
    Newton steps on the conditions of optimality.

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
    start = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
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
    if kind == "rest_length":
        refuse_strings_without_length("nodes", structure, start)
    refuse_load_without_support(structure, load)
    found_nodes, stiffness = _minimize(model, kind, held, load, start)
    settled = replace(structure, nodes=restore_bar_lengths(structure, found_nodes))
    strained = _STRAIN * stiffness * float(np.ptp(start, axis=1).max())
    if kind == "rest_length":
        assert model.strings is not None  # the energy needed it
        held = model.strings.force_density(settled.string_length(), held)
        if (held * settled.string_length()).max(initial=0.0) <= _EXACT * strained:
            held = np.zeros_like(held)  # as slack as round-off lets them be
    what = f"no equilibrium found with this {kind}"
    forces = member_forces(settled, free_coordinates(settled, load))
    return balanced(settled, forces, held, load, what, "Start from other nodes", strained)


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
    model: Model, kind: str, held: FloatArray, load: FloatArray, start: FloatArray
) -> tuple[FloatArray, float]:
    """Return the nodes of least energy with these bar lengths, and the largest stiffness, N/m."""
    structure = model.structure
    free = structure.free
    N = ca.SX.sym("N", 3, len(free))
    x = ca.vertcat(ca.vec(N), ca.DM.zeros(N.numel()))
    stored = model.potential_energy if kind == "force_density" else model.elastic_energy
    energy = stored(x, held) - ca.sum1(ca.sum2(N * ca.DM(load[:, free])))
    moving = np.concatenate([structure.free_bars, structure.swinging_bars])
    nodes = kernel.all_nodes(structure, N, structure.nodes)
    B = kernel.differences(nodes, structure.bars[moving])
    stretch = (kernel.dots(B, B).T - ca.DM(structure.bar_length[moving] ** 2)) / 2
    problem = {"x": ca.vec(N), "f": energy, "g": stretch}
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}}
    solver = ca.nlpsol("equilibrium", "ipopt", problem, quiet)
    lam = ca.SX.sym("lambda", stretch.numel())
    conditions = ca.vertcat(ca.gradient(energy + ca.dot(lam, stretch), ca.vec(N)), stretch)
    unknowns = ca.vertcat(ca.vec(N), lam)
    newton = ca.Function("newton", [unknowns], [conditions, ca.jacobian(conditions, unknowns)])
    place = start[:, free].ravel(order="F")
    size = float(np.ptp(structure.nodes, axis=1).max())
    for _ in range(_ESCAPES):
        point = _polished(newton, _optimized(solver, place), N.numel(), size)
        place, downhill = point[: N.numel()], _downhill(newton, point, N.numel())
        if downhill is None:
            nodes = structure.nodes.copy()
            nodes[:, free] = place.reshape(3, -1, order="F")
            stiffness = np.array(newton(point)[1].full())[: N.numel(), : N.numel()]
            return nodes, float(np.abs(stiffness).max(initial=0.0))
        # An unstable equilibrium, such as a pendulum upside down: pushed off, it falls.
        place = place + 0.01 * size * downhill
    raise ValueError(
        "no stable equilibrium found: the shape comes to rest only where a small push makes it "
        "fall. Start from other nodes"
    )


def _optimized(solver: ca.Function, place: FloatArray) -> FloatArray:
    """Return positions and multipliers from the optimizer, or say what it ended with."""
    with solving():
        answer = solver(x0=place, lbg=0.0, ubg=0.0)
    status = solver.stats()
    if not status["success"]:
        raise ValueError(
            f"no equilibrium found: the optimizer ended with {status['return_status']!r} after "
            f"{status['iter_count']} iterations. Start from other nodes, or check that strings "
            "and supports can carry the load"
        )
    return np.concatenate([np.array(answer[part]).ravel() for part in ("x", "lam_g")])


def _polished(newton: ca.Function, point: FloatArray, count: int, size: float) -> FloatArray:
    """Return the point after Newton steps on the conditions of optimality."""
    for scaled in (False, True):
        for _ in range(_POLISH):
            residual, jacobian = (np.array(part.full()) for part in newton(point))
            rows, columns = np.ones((2, len(point)))
            if scaled:
                rows[:count] = columns[count:] = np.abs(jacobian[:count, :count]).max() or 1.0
            # Least squares: motions as one body that nothing holds leave a null space.
            system = jacobian / rows[:, None] * columns
            if not (np.isfinite(system).all() and np.isfinite(residual).all()):
                raise ValueError("no equilibrium found: forces are beyond all numbers")
            change = columns * np.linalg.lstsq(system, -residual.ravel() / rows, rcond=1e-12)[0]
            point = point + change
            if np.abs(change).max() < 1e-14 * np.abs(point).max():
                break
        # Beside very stiff strings the lengths of bars are lost, unless forces are in their unit.
        if np.abs(np.array(newton(point)[0].full())[count:]).max(initial=0.0) < _EXACT * size**2:
            break
    return point


def _downhill(newton: ca.Function, point: FloatArray, count: int) -> FloatArray | None:
    """Return a direction in which the energy falls with bar lengths kept, or None."""
    from scipy.linalg import null_space

    _, jacobian = (np.array(part.full()) for part in newton(point))
    hessian, constraints = jacobian[:count, :count], jacobian[count:, :count]
    free = null_space(constraints) if len(constraints) else np.eye(count)
    if free.shape[1] == 0:
        return None
    values, vectors = np.linalg.eigh(free.T @ hessian @ free)
    if values[0] >= -_FLAT * np.abs(hessian).max():
        return None
    return np.asarray(free @ vectors[:, 0])
