"""Plants in a few modes, and the nonlinear equations of motion in reduced coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import partial
from math import ceil
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.contact_laws import ContactLaw
from tenscontrol.dynamics.evaluator import Function, on_one_thread
from tenscontrol.plant.driven_lengths import length_symbols
from tenscontrol.plant.linear_plant import LinearPlant, kept, refuse_driven_bars
from tenscontrol.plant.modes import modes as all_modes  # `reduce` has an argument of this name
from tenscontrol.plant.string_outputs import model_input, string_forces

# Stiffness and damping below this part of the largest are none.
_SINGULAR = 1e-11

# Radians of the fastest vibration in a step of RK4: its error is then about 1e-4 of it.
_RADIANS = 0.35

# Size of a pole times a step up to which RK4 is well within its region of stability, for forces of
# contact: they are larger at an impact than at rest.
_STABLE = 2.0

# Depths, m, between which a contact bears the weight.
_SHALLOWEST, _DEEPEST = 1e-12, 1e6

# More steps of RK4 in a sample than this are refused.
_MOST_SUBSTEPS = 1000


@dataclass(frozen=True, eq=False)
class ReducedPlant(LinearPlant):
    """A linear plant reduced to a few modes. Made by :func:`reduce`; controllers accept it.

    Attributes
    ----------
    whole : LinearPlant
        The plant that was reduced.
    model, coordinates, input, A, B, drift, commanded, force_density, rest_length : as of it
    external_force, invariance_residual, actuation, feet, sparse : as of it
    input_displacements, rate_input : None
        Plants whose inputs are lengths of bars are not reduced.
    """

    whole: LinearPlant = field(kw_only=True)

    def __repr__(self) -> str:
        whole = repr(self.whole).removeprefix("LinearPlant(")
        return f"ReducedPlant({self.degrees_of_freedom} of {whole}"

    @property
    def dropped(self) -> float:
        """Share of the displacements by constant inputs that the modes left out have, 0 to 1.

        Root mean square of all: what the reduced plant does not see of slow commands. 1 where the
        whole plant does not resist all of its motions.
        """
        small: LinearPlant = self
        whole, r, own = self.whole, self.whole.degrees_of_freedom, self.degrees_of_freedom
        stiffness = -whole.A[r:, :r]
        if np.linalg.cond(stiffness) > 1 / _SINGULAR:
            return 1.0
        full = whole.basis @ np.linalg.solve(stiffness, whole.B[r:])
        seen = small.basis @ np.linalg.solve(-small.A[own:, :own], small.B[own:])
        return float(np.linalg.norm(full - seen) / max(float(np.linalg.norm(full)), 1e-300))

    @property
    @on_one_thread
    def error_bound(self) -> float:
        """Most that node displacements differ from the whole plant's, m per unit of the inputs.

        In the H∞ norm, root sums of squares of both over all time: at most twice the sum of the
        Hankel singular values of the difference of the two plants (Glover 1984). Infinite where
        anything that differs is not damped: driven at its frequency, it grows without end.
        """
        from scipy.linalg import block_diag, solve_continuous_lyapunov

        small: LinearPlant = self
        whole = self.whole
        A, B = block_diag(whole.A, small.A), np.vstack([whole.B, small.B])
        C = np.hstack([whole.basis, 0 * whole.basis, -small.basis, 0 * small.basis])
        if np.linalg.eigvals(A).real.max() > -_SINGULAR * whole.spectral_radius:
            return float("inf")
        reached = solve_continuous_lyapunov(A, -B @ B.T)
        seen = solve_continuous_lyapunov(A.T, -C.T @ C)
        squares = np.linalg.eigvals(reached @ seen).real
        return 2 * float(np.sqrt(np.maximum(squares, 0.0)).sum())


def reduce(plant: LinearPlant, modes: object = 20) -> ReducedPlant:
    """Return a linear plant reduced to a few of its modes, for the design of controllers.

    Its coordinates are those modes, scaled to unit mass. Its state is measured on the whole
    structure, without the modes that are left out. Controllers and filters designed on it run with
    the whole model.

    Parameters
    ----------
    plant : LinearPlant
    modes : int or array_like of int
        How many of the lowest (all, if there are fewer), or indices in :func:`modes` of the plant.

    Returns
    -------
    ReducedPlant

    Raises
    ------
    TypeError, ValueError
        If ``plant`` is not a linear plant in ``"internal"`` or ``"minimal"`` coordinates, or has no
        such modes.

    Notes
    -----
    Modal truncation. The modes are those of the stiffness; of the damping, what acts between modes
    that are kept stays, and what acts between them and the others is left out. Without damping the
    plants differ by the modes left out alone: inputs drive these as well (spillover), so keep what
    lies below the bandwidth of a controller. There is no static correction: it changes outputs, and
    laws feed back states. :attr:`~ReducedPlant.dropped` says what it would be, and
    :attr:`~ReducedPlant.error_bound` bounds all of the error of damped plants.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tower = tc.prism_tower(stages=4)
    >>> model = tc.Model(tower, strings=tc.LinearStrings(stiffness=1e3))
    >>> plant = tc.linearize(model, tc.prestress(tower, min_force_density=5), input="rest_length")
    >>> small = tc.reduce(plant, modes=6)
    >>> small
    ReducedPlant(6 of 54 internal coordinates, input rest_length, 72 inputs)
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    refuse_driven_bars(plant, "reduce")
    if plant.coordinates.kind == "nodes":
        raise ValueError(
            "plant is in 'nodes' coordinates, in which bars change their lengths; expected "
            "'internal' or 'minimal': tenscontrol.plant.in_coordinates(plant, 'internal')"
        )
    if plant.sparse is None:
        raise ValueError("plant has other A and B than linearize made, or is reduced already")
    r, still = plant.degrees_of_freedom, 0 * plant.sparse.damping
    still.eliminate_zeros()
    undamped = replace(plant, sparse=replace(plant.sparse, damping=still), A=None, B=None)
    is_count = isinstance(modes, np.ndarray) and modes.ndim == 0
    if is_count or isinstance(modes, int | float | np.number):
        chosen = np.arange(min(validation.whole_number("modes", modes, 1), r))
    else:
        chosen = validation.index_list("modes", modes, r, "modes of plant")
        if not len(chosen):
            raise ValueError("modes is empty, expected a number of modes, or indices of modes")
    d, n = plant.nodes.shape
    shape = all_modes(undamped, int(chosen.max()) + 1).shape[..., chosen]
    q = plant.coordinates.project(shape.swapaxes(0, 1).reshape(d * n, -1))
    q, turn = np.linalg.qr(q)
    within = plant.coordinates.within(q * np.sign(np.diag(turn)))
    small = replace(plant, coordinates=within, A=None, B=None, drift=None)
    values = {attribute.name: getattr(small, attribute.name) for attribute in fields(small)}
    return ReducedPlant(**values, whole=plant)


@kept
def reduced_acceleration(plant: LinearPlant, *, taut: bool) -> ca.Function:
    """Return ``(z, u) -> q̈ = Tᵀ M vec(N̈)``, exact while nothing moves as one body.

    Bars keep their lengths in every shape of q: the plant is in internal or minimal coordinates.
    If ``taut``, strings of given rest lengths push where they would be slack, as in the linear
    plant: smooth, so that Newton's method converges however stiff they are.
    """
    z, u = (ca.SX.sym(name, size) for name, size in zip("zu", plant.B.shape, strict=True))
    acceleration = ca.densify(_acceleration(plant, z, u, taut))
    return Function("reduced", [z, u], [acceleration], ["z", "u"], ["qdd"])


def _acceleration(plant: LinearPlant, z: Any, u: Any, taut: bool, near: Any = None) -> Any:
    moved = _motion(plant, z, u, taut, near)[2]
    rows = plant.model.structure.free_rows
    project = plant.coordinates.project(np.eye(plant.nodes.size))[:, rows]
    project = np.where(np.abs(project) > 1e-14 * np.abs(project).max(), project, 0.0)
    return ca.mtimes(ca.sparsify(ca.DM(project)), moved)


def tracked_motion(plant: LinearPlant, matrix: FloatArray) -> ca.Function:
    """Return ``z -> (y, ẏ, ÿ at zero γ, ∂ÿ/∂γ)`` of ``y = C vec(N)``, exact; affine in γ."""
    key = "tracked_motion", matrix.shape, matrix.tobytes()
    return plant.prepared.get(key, partial(_tracked_motion, plant, matrix))


def _tracked_motion(plant: LinearPlant, matrix: FloatArray) -> ca.Function:
    z, gamma = (ca.SX.sym(name, size) for name, size in zip("zg", plant.B.shape, strict=True))
    N, V, moved = _motion(plant, z, gamma)
    C = ca.sparsify(ca.DM(matrix))
    acceleration = ca.mtimes(C[:, plant.model.structure.free_rows.tolist()], moved)
    outputs = [
        ca.mtimes(C, ca.vec(N)),
        ca.mtimes(C, ca.vec(V)),
        ca.substitute(acceleration, gamma, ca.SX.zeros(gamma.shape)),
        ca.jacobian(acceleration, gamma),
    ]
    return Function("tracked", [z], ca.cse([ca.densify(output) for output in outputs]))


def checked_tracked(plant: LinearPlant, tracked: object) -> FloatArray:
    """Return combinations of node positions, shape (p, d n), or raise naming the argument."""
    matrix = validation.float_array("tracked", tracked)
    if matrix.ndim != 2 or matrix.shape[1] != plant.nodes.size or not len(matrix):
        raise ValueError(
            f"tracked has shape {matrix.shape}, expected (p, {plant.nodes.size}): "
            "one column per coordinate of a node"
        )
    if np.abs(matrix).max(axis=1).min() < 1e-100:  # squares vanish
        raise ValueError("tracked has a row of zeros, which tracks nothing")
    return matrix


def _motion(
    plant: LinearPlant, z: Any, u: Any, taut: bool = False, near: Any = None
) -> tuple[Any, Any, Any]:
    """Return all nodes and velocities, and the accelerations of what is free, node by node."""
    N, V = reduced_motion(plant, z, near)
    held, kind = model_input(plant, u), plant.input
    if taut and kind == "rest_length":
        held, kind = string_forces(plant, kind, N, V, held)[0], "force_density"
    return N, V, _free_acceleration(plant, N, V, held, kind)


def _free_acceleration(plant: LinearPlant, N: Any, V: Any, held: Any, kind: str) -> Any:
    """Return the accelerations of what is free, node by node, under an input of a kind."""
    refuse_lost_place(plant)
    structure, equation = plant.model.structure, plant.model.state_equation(kind)
    free = structure.free.tolist()
    x = ca.vertcat(*(kernel.free_entries(structure, array[:, free]) for array in (N, V)))
    slope = equation(x, held, *map(ca.DM, plant.load_input))
    return slope[slope.shape[0] // 2 :]


def node_acceleration(plant: LinearPlant, N: Any, V: Any, held: Any) -> Any:
    """Return the expression of the accelerations of all nodes, (d, n), of a motion (SX).

    ``held`` is the input of the model's strings. Supports stand.
    """
    moved = ca.SX(plant.nodes.size, 1)
    rows = plant.model.structure.free_rows.tolist()
    moved[rows] = _free_acceleration(plant, N, V, held, plant.input)
    return ca.reshape(moved, *plant.nodes.shape)


def refuse_lost_place(plant: LinearPlant) -> None:
    """Raise if forces depend on where the structure is and moves, and coordinates do not say.

    Where supports leave no rigid-body motion, internal coordinates say it.
    """
    frame, terms = plant.coordinates, plant.model.forces("force_density").terms
    outer = [term.argument for term in terms if not term.conserves_momentum]
    if outer and frame.kind == "internal" and frame.is_loose:
        raise ValueError(
            "plant has internal coordinates, which leave out where the structure is, and its model "
            f"has {outer[0]}, whose forces depend on that: linearize with coordinates='minimal'"
        )


@kept
def sampled_motion(plant: LinearPlant, sample_time: float) -> ca.Function:
    """Return ``(z, u) -> z⁺`` over a sample.

    Nonlinear, by RK4 in steps that resolve the fastest vibration; :func:`sampled` is the exact
    counterpart of the linear plant.
    """
    count = possible_substeps(plant, sample_time)
    motion = _rk4_step(plant, sample_time / count)
    if count == 1:
        return motion
    z, u = (ca.MX.sym(name, size) for name, size in zip("zu", plant.B.shape, strict=True))
    return Function("motion", [z, u], [motion.fold(count)(z, ca.repmat(u, 1, count))])


@kept
def sampled_dynamics(plant: LinearPlant, sample_time: float) -> tuple[ca.Function, ca.Function]:
    """Return :func:`sampled_motion`, and ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)``, dense.

    The derivatives are those of the steps of RK4.
    """
    motion, count = sampled_motion(plant, sample_time), explicit_substeps(plant, sample_time)
    linearized = _linearized_rk4_step(plant, sample_time / count)
    if count > 1:
        s, a = plant.B.shape
        z, u = ca.MX.sym("z", s), ca.MX.sym("u", a)
        chain = _chained(linearized).fold(count)
        start = ca.horzcat(z, ca.DM.eye(s), ca.DM.zeros(s, a))
        end = chain(ca.densify(start), ca.repmat(u, 1, count))
        columns = end[:, 0], end[:, 1 : 1 + s], end[:, 1 + s :]
        linearized = Function("linearized", [z, u], list(columns))
    return motion, linearized


def possible_substeps(plant: LinearPlant, sample_time: float) -> int:
    """Return :func:`explicit_substeps`, or raise where they are too many."""
    count = explicit_substeps(plant, sample_time)
    if count > _MOST_SUBSTEPS:
        raise ValueError(
            f"plant vibrates with up to {plant.spectral_radius:.3g} rad/s: a sample of "
            f"{sample_time:g} s takes {count} steps of RK4 to predict, expected at most "
            f"{_MOST_SUBSTEPS}; give a shorter sample_time, or use a linear prediction"
        )
    return count


def explicit_substeps(plant: LinearPlant, sample_time: float) -> int:
    """Return the number of RK4 steps in a sample.

    Where there is ground, its nodes may touch at any moment: steps are then as short as vibrations
    in contact need, and stable for friction, which damps far faster than anything vibrates.
    """
    if plant.model.contacts is None:
        return max(1, ceil(sample_time * plant.spectral_radius / _RADIANS))
    poles = np.concatenate([np.linalg.eigvals(plant.A), _poles_in_contact(plant)])
    rate = np.maximum(np.abs(poles.imag) / _RADIANS, np.abs(poles) / _STABLE).max(initial=0.0)
    return max(1, ceil(sample_time * float(rate)))


@kept
def _poles_in_contact(plant: LinearPlant) -> np.ndarray:
    """Return the poles with every node that can touch pressed as one of those it stands on, 1/s.

    That is by a third of the weight, in the plane a half; without weight, by the largest tension.
    """
    model, r, d = plant.model, plant.degrees_of_freedom, len(plant.nodes)
    load = float(np.linalg.norm(model.constant_force, axis=0).sum()) / d
    lengths = plant.commanded.string_length(plant.nodes[:, : plant.commanded.nodes.shape[1]])
    load = load or float((plant.force_density * lengths).max(initial=0.0))
    stiffness, damping = np.zeros((2, r, r))
    assert model.contacts is not None  # explicit_substeps has seen to it
    for law, nodes, _ in model.contacts:
        slopes = _slopes_under(law, load)
        away = np.array(law.sinking(ca.DM(plant.nodes), ca.DM(*plant.nodes.shape))[2])
        for node in nodes.tolist():
            moved, normal = plant.basis[d * node : d * node + d], away[:, node]
            sinks = moved.T @ normal
            slides = moved - np.outer(normal, sinks) / (normal @ normal)
            stiffness += slopes[0] * np.outer(sinks, sinks)
            damping += slopes[1] * np.outer(sinks, sinks)
            damping += law.friction * load / law.slip_speed * slides.T @ slides
    A = plant.A.copy()
    A[r:, :r] -= stiffness
    A[r:, r:] -= damping
    return np.asarray(np.linalg.eigvals(A))


def _slopes_under(law: ContactLaw, load: float) -> tuple[float, float]:
    """Return the slopes of the normal force by depth, N/m, and by its rate, N s/m, at a force."""
    depth, rate = ca.SX.sym("depth"), ca.SX.sym("rate")
    force = law.normal_force(depth, rate)
    outputs = [force, ca.gradient(force, depth), ca.gradient(force, rate)]
    function = Function("pressed", [depth, rate], [ca.densify(output) for output in outputs])
    trial = 1.0
    while float(function(trial, 0.0)[0]) > load and trial > _SHALLOWEST:
        trial /= 2
    while float(function(trial, 0.0)[0]) < load and trial < _DEEPEST:
        trial *= 2
    _, by_depth, by_rate = function(trial, 0.0)
    return float(by_depth), float(by_rate)


def _rk4_stages(h: float) -> list[tuple[float, float]]:
    """Return weight, and how far ahead, s, of each stage of the classic Runge-Kutta method."""
    return [(1.0, 0.0), (2.0, 0.5 * h), (2.0, 0.5 * h), (1.0, h)]


def _rk4_step(plant: LinearPlant, h: float) -> ca.Function:
    r, (s, a) = plant.degrees_of_freedom, plant.B.shape
    acceleration = reduced_acceleration(plant, taut=False)
    z, u = ca.MX.sym("z", s), ca.MX.sym("u", a)
    slope, end = ca.DM.zeros(s), z
    for weight, ahead in _rk4_stages(h):
        stage = z + ahead * slope
        slope = ca.vertcat(stage[r:], acceleration(stage, u))
        end += h / 6 * weight * slope
    return Function("motion", [z, u], [end])


def _linearized_rk4_step(plant: LinearPlant, h: float) -> ca.Function:
    """Return the step with its derivatives.

    Those of speeds and accelerations by q, q̇ and u stand side by side. What starts as the identity
    is put in its place, not multiplied out.
    """
    r, (s, a) = plant.degrees_of_freedom, plant.B.shape
    derivatives = acceleration_slopes(plant, taut=False)
    z, u = ca.MX.sym("z", s), ca.MX.sym("u", a)
    one, beside = ca.DM.eye(r), ca.DM.zeros(r, a)
    start = ca.horzcat(ca.DM.zeros(r, r), one, beside)  # of the speed at the start
    slope, end, total, rates = ca.DM.zeros(s), z, ca.horzcat(one, ca.DM.zeros(r, r + a)), start
    speeds, accelerations = start, None
    for weight, ahead in _rk4_stages(h):
        stage = z + ahead * slope
        qdd, by_q, by_v, by_u = derivatives(stage, u)
        by_all = ca.horzcat(by_q, by_v, by_u)
        if accelerations is not None:
            # Positions at this stage went ahead at the speeds of the stage before.
            moved = (
                ca.horzcat(ca.DM.zeros(r, r), by_q, beside)
                if speeds is start
                else ca.mtimes(by_q, speeds)
            )
            by_all += ahead * (moved + ca.mtimes(by_v, accelerations))
            speeds = start + ahead * accelerations
        accelerations = by_all
        slope = ca.vertcat(stage[r:], qdd)
        end += h / 6 * weight * slope
        total += h / 6 * weight * speeds
        rates += h / 6 * weight * accelerations
    whole = ca.vertcat(total, rates)
    outputs = [end, ca.densify(whole[:, :s]), ca.densify(whole[:, s:])]
    return Function("linearized", [z, u], outputs)


def _chained(linearized: ca.Function) -> ca.Function:
    """Return ``([z, ∂z/∂z_0, ∂z/∂u], u) -> `` the same a step later."""
    s, a = linearized.size1_in(0), linearized.size1_in(1)
    carried, u = ca.MX.sym("carried", s, 1 + s + a), ca.MX.sym("u", a)
    end, by_z, by_u = linearized(carried[:, 0], u)
    inner = ca.mtimes(by_z, carried[:, 1:]) + ca.horzcat(ca.DM.zeros(s, s), by_u)
    return Function("chained", [carried, u], [ca.densify(ca.horzcat(end, inner))])


def acceleration_slopes(plant: LinearPlant, *, taut: bool) -> ca.Function:
    """Return ``(z, u) -> (q̈, ∂q̈/∂q, ∂q̈/∂q̇, ∂q̈/∂u)``, dense, of :func:`reduced_acceleration`."""
    r = plant.degrees_of_freedom
    z, u = (ca.SX.sym(name, size) for name, size in zip("zu", plant.B.shape, strict=True))
    near = near_symbol(plant)
    qdd = _acceleration(plant, z, u, taut, near)
    if near.numel() == 0:  # among the many operations of blocks, the search takes too long
        qdd = ca.cse(qdd)  # before its derivatives: they then have little in common but that
    by_z, by_u = (ca.densify(ca.jacobian(qdd, by)) for by in (z, u))
    outputs = settled(plant, z, near, [ca.densify(qdd), by_z[:, :r], by_z[:, r:], by_u])
    return Function("derivatives", [z, u], outputs)


@kept
def linked_accelerations(
    plant: LinearPlant, *, taut: bool
) -> tuple[ca.Function, tuple[ca.Sparsity, ...]]:
    """Return accelerations of nodes and the Jacobians of three maps, and the patterns of these.

    Of the maps from what the basis displaces to shapes with exact bar lengths, on to forces, and on
    to accelerations, each has a sparse Jacobian, so that its code grows with the members.

    The function is ``(n, ṅ, u) -> (N̈, entries of ∂N̈/∂(N, Ṅ, F), of ∂F/∂(N, Ṅ, u) and of
    ∂(N, Ṅ)/∂(n, ṅ))``: n and ṅ as the basis displaces nodes, N̈ where supports leave them free.
    """
    refuse_lost_place(plant)
    structure, size = plant.model.structure, plant.nodes.size
    n, rates, u = (ca.SX.sym(x, k) for x, k in (("n", size), ("r", size), ("u", plant.B.shape[1])))
    N, V, F = (ca.SX.sym(name, *structure.nodes.shape) for name in "NVF")
    moved = ca.vec(kernel.accelerations(structure, N, V, F))[structure.free_rows.tolist()]
    accelerated = with_jacobian(moved, N, V, F)
    forced = with_jacobian(ca.vec(_forces(plant, N, V, u, taut)), N, V, u)
    positions, velocities, by_n = exact_motion(plant, n, rates)
    force, by_N = forced(positions, velocities, u)
    moved, by_F = accelerated(positions, velocities, ca.reshape(force, *N.shape))
    jacobians = by_F, by_N, by_n
    entries = [ca.densify(jacobian.nz[:]) for jacobian in jacobians]
    function = Function("linked", [n, rates, u], [ca.densify(moved), *entries])
    return function, tuple(jacobian.sparsity() for jacobian in jacobians)


def exact_motion(plant: LinearPlant, n: Any, rates: Any) -> tuple[Any, Any, Any]:
    """Return N, Ṅ and ∂(N, Ṅ)/∂(n, ṅ), sparse, of what the basis displaces, columns, SX."""
    frame, near = plant.coordinates, near_symbol(plant)
    displaced, moving = (ca.SX.sym("at", *symbol.shape) for symbol in (n, rates))
    value = ca.vertcat(*map(ca.vec, frame.kept_lengths(displaced, moving, near)))
    outputs = ca.cse([value, ca.jacobian(value, ca.vertcat(displaced, moving))])
    exact = Function("exact", [displaced, moving, near], outputs)
    motion, jacobian = exact(n, rates, frame.hidden(n, rates))
    N, V = (ca.reshape(column, *plant.nodes.shape) for column in ca.vertsplit(motion, n.numel()))
    return N, V, jacobian


def with_jacobian(value: Any, *arguments: Any) -> ca.Function:
    """Return the function of a column, dense, and its Jacobian, sparse, by all arguments, SX."""
    value = ca.densify(value)
    jacobian = ca.jacobian(value, ca.vertcat(*map(ca.vec, arguments)))
    return Function("link", list(arguments), ca.cse([value, jacobian]))


def _forces(plant: LinearPlant, N: Any, V: Any, u: Any, taut: bool) -> Any:
    """Return the forces on all nodes, N, shape (d, n), of a motion of all nodes and an input."""
    model, held, kind = plant.model, model_input(plant, u), plant.input
    if taut and kind == "rest_length":
        held, kind = string_forces(plant, kind, N, V, held)[0], "force_density"
    load = plant.external_force if model.has_external_force else model.constant_force
    return model.forces(kind).on_nodes(N, V, held, ca.sparsify(ca.DM(load)))


def near_symbol(plant: LinearPlant) -> Any:
    """Return a symbol for ``near`` in :func:`reduced_motion`, empty where bars share no nodes."""
    return ca.SX.sym("near", plant.coordinates.hidden_size)


def settled(
    plant: LinearPlant, z: Any, near: Any, expressions: list[Any], known: Any = None
) -> list[Any]:
    """Return expressions, or their first derivatives, in z alone: the symbol near put in.

    ``known`` as for :func:`reduced_motion`.
    """
    if near.numel() == 0:
        return expressions
    frame = plant.coordinates
    displaced = frame.displaced(z[: len(plant.A)])
    corrected = frame.hidden(*displaced, length_symbols(plant, known))
    return list(ca.substitute(expressions, [near], [corrected]))


def reduced_motion(
    plant: LinearPlant, z: Any, near: Any = None, known: Any = None
) -> tuple[Any, Any]:
    """Return expressions of node positions and velocities, shape (d, n), of a state z (SX).

    ``known`` is what inputs do, see :func:`known_size`: bars may be driven.
    """
    frame = plant.coordinates
    return frame.kept_lengths(*frame.displaced(z), near, length_symbols(plant, known))
