"""Observability of a plant from its readings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.estimation.extra_states import ExtraStates
from tenscontrol.estimation.sensors import KINDS, Moment, Sensors, symbolic_readings
from tenscontrol.plant.controllability import LeftSpace, left_spaces, own_modes, reached_states
from tenscontrol.plant.driven_lengths import known_at_rest, known_size
from tenscontrol.plant.linear_plant import LinearPlant, state_units
from tenscontrol.plant.linearize import in_coordinates
from tenscontrol.plant.modes import Modes, modes_of
from tenscontrol.plant.reduced_dynamics import (
    near_symbol,
    node_acceleration,
    reduced_motion,
    settled,
)
from tenscontrol.plant.string_outputs import model_input
from tenscontrol.structure.supports import left_by_supports, rigid_motions

# A rigid-body motion that moves the readings less than this fraction of another is not seen.
_UNSEEN = 1e-9

# A singular value below this fraction of the largest is zero.
_TOLERANCE = 1e-9

# Poles this far left of the axis, relative to the largest, decay by themselves.
_SLOW = 1e-6

# A motion as one body is held or seen by more than this part of the highest stiffness, or readings.
_STILL = 1e-11

# Parts of a plant that move each other by less than this fraction are apart.
_APART = 1e-6


@dataclass(frozen=True, eq=False)
class UnseenStates:
    """States that a filter leaves alone, as orthonormal columns.

    ``directions`` are places and angles of the structure as one body: the estimate of its rates
    moves them on. ``modes`` swing by themselves, and nothing drives them.
    """

    directions: FloatArray  # (s, k)
    modes: FloatArray  # (s, k)
    left_alone: Modes


def output_function(
    plant: LinearPlant, sensors: Sensors, extra: ExtraStates | None = None
) -> ca.Function:
    """Return ``(z, u) -> (y, ∂y/∂z)``, dense, exact, of all states of a filter."""
    extra = extra or ExtraStates(len(plant.A))
    key = "output_function", extra, sensors.measured
    return plant.prepared.get(key, lambda: _output_function(plant, sensors, extra))


def _output_function(plant: LinearPlant, sensors: Sensors, extra: ExtraStates) -> ca.Function:
    structure = plant.model.structure
    z, u = ca.SX.sym("z", extra.size), ca.SX.sym("u", known_size(plant))
    near = near_symbol(plant)
    N, V = reduced_motion(plant, z[: extra.states], near, u)
    held = model_input(plant, extra.input(z, u[: len(plant.actuation.lead)]))
    tension, rest_length = (ca.SX(len(structure.strings), 1) for _ in range(2))
    if sensors.needs("tension"):
        length, rate = (row.T for row in kernel.string_motion(structure, N, V))
        gamma = held
        if plant.string_input == "rest_length":
            law = plant.model.strings
            assert law is not None  # linearize needs one for this input
            gamma = law.symbolic_force_density(length, gamma, rate)
        tension = gamma * length
    if sensors.needs("rest_length"):
        if not plant.winds_strings:
            raise ValueError(
                f"sensors read encoders, but plant has the input {plant.input!r}, and winds no "
                "strings: linearize with input='rest_length'"
            )
        rest_length = held
    acceleration = ca.SX(*structure.nodes.shape)
    if sensors.needs("acceleration"):
        unknown = ca.mtimes(ca.DM(plant.basis), extra.acceleration(z))
        acceleration = node_acceleration(plant, N, V, held) + ca.reshape(unknown, *N.shape)
    y = symbolic_readings(sensors, Moment(N, V, acceleration, tension, rest_length))
    if extra.biased:
        y = y + extra.bias(z, y.numel())
    y = ca.cse(ca.densify(y))  # before its derivatives: they then have little in common but that
    results = settled(plant, z, near, [y, ca.densify(ca.jacobian(y, z))], u)
    return Function("readings", [z, u], results)


def output_derivative(
    plant: LinearPlant, sensors: Sensors, extra: ExtraStates | None = None
) -> FloatArray:
    """Return C = ∂y/∂z of all states at the operating point, shape (m, s)."""
    function = output_function(plant, sensors, extra)
    known = known_at_rest(plant, plant.equilibrium_input)
    return np.array(function(np.zeros(function.size1_in(0)), known)[1].full())


def observed_plant(plant: LinearPlant, sensors: Sensors) -> LinearPlant:
    """Return the plant with the rigid-body motions that the sensors see.

    Internal coordinates have none. Positions, directions and rates see some: those are added,
    so that a structure that drifts or turns is not mistaken for one that changes its shape.
    A plant in minimal coordinates, which has them all, is returned as it is.
    """
    if plant.coordinates.kind != "internal":
        return plant
    if not any(kind.sees_place for kind in sensors.kinds):
        return plant
    key = "observed_plant", sensors.measured, sensors.noise.tobytes()
    return plant.prepared.get(key, lambda: _observed_plant(plant, sensors))


def _observed_plant(plant: LinearPlant, sensors: Sensors) -> LinearPlant:
    whole = in_coordinates(plant, "minimal")
    r = whole.degrees_of_freedom
    fields = left_by_supports(whole.model.structure, rigid_motions(whole.nodes))
    rigid = np.linalg.qr(whole.coordinates.project(fields))[0]
    C = output_derivative(whole, sensors) / sensors.noise[:, None]
    moved = C[:, :r] @ rigid
    if sensors.needs("velocities") or sensors.needs("acceleration"):
        moved = np.vstack([moved, whole.spectral_radius * C[:, r:] @ rigid])
    _, sizes, Vt = np.linalg.svd(moved)
    seen = Vt[: int(np.count_nonzero(sizes > _UNSEEN * sizes.max(initial=0.0)))]
    # Of the minimal coordinates, the internal ones and the motions that are seen.
    inside = whole.coordinates.project(plant.basis)
    keep = np.hstack([inside, rigid @ seen.T])
    return _restricted(whole, keep)


def _restricted(plant: LinearPlant, keep: FloatArray) -> LinearPlant:
    """Return the plant on the space of orthonormal columns of its coordinates, shape (r, k)."""
    within = plant.coordinates.within(keep)
    rate = plant.rate_input
    if rate is not None:  # of the rates of bars
        felt = keep.T @ rate[plant.degrees_of_freedom :]
        rate = frozen(np.vstack([np.zeros_like(felt), felt]))
    return replace(plant, coordinates=within, rate_input=rate, A=None, B=None, drift=None)


def unseen(plant: LinearPlant, sensors: Sensors, C: FloatArray) -> UnseenStates:
    """Return what no reading shows and no string reaches; refuse what only the strings reach.

    Decaying motions are not among it: an estimate forgets them.
    """
    seen = C / sensors.noise[:, None]
    directions, lost, refused = _lasting(plant, seen)
    A, _, unit, rate = _scaled(plant, seen)
    if refused:
        advice = _remedy(
            plant, sensors, seen, lambda more: not _lasting(plant, np.vstack([seen, more]))[2]
        )
        count = sum(space.unreached.shape[1] for space in refused)
        listed = ", ".join(f"{rate * space.pole:.4g}" for space in refused)
        raise ValueError(
            f"{count} of the {len(A)} states are not observable by {sensors!r}. At the poles "
            f"{listed} "
            f"1/s they do not decay by themselves. {advice}"
        )
    spaces = [space.unreached for space in lost]
    swinging = np.hstack([np.zeros((len(A), 0)), *(unit[:, None] * space for space in spaces)])
    return UnseenStates(
        directions=frozen(_columns(unit[:, None] * directions)),
        modes=frozen(_columns(swinging)),
        left_alone=modes_of(plant, *own_modes(A, rate, [directions, *spaces])),
    )


def _lasting(
    plant: LinearPlant, seen: FloatArray
) -> tuple[FloatArray, list[LeftSpace], list[LeftSpace]]:
    """Return what neither decays nor is seen, in units of the state.

    First directions of the structure as one body, shape (s, k), then the rest pole by pole, and
    what of it cannot be left alone.
    """
    A, scaled, unit, _ = _scaled(plant, seen)
    reachable = reached_states(plant)
    reached = reachable.basis[:, : reachable.count]
    rigid = _columns(_rigid_states(plant) / unit[:, None])
    directions = rigid @ _kernel(np.vstack([A, scaled]) @ rigid)
    directions = directions @ _kernel(reached.T @ directions, _APART)
    # A place drifts away where no reading shows how fast it moves.
    rates = np.roll(directions, plant.degrees_of_freedom, axis=0)
    directions = directions @ _complement(_kernel(scaled @ rates))
    # The rest is that of the plant without them: they move nothing else.
    others = _complement(directions)
    A = others.T @ A @ others
    lost = [
        space
        for space in left_spaces(A.T, others.T @ scaled.T)
        if space.unreached.shape[1] and space.pole.real >= -_SLOW
    ]
    refused = [
        space
        for space in lost
        if space.grows or not _is_apart(A, others.T @ reached, space.unreached)
    ]
    lost, refused = (
        [replace(space, unreached=others @ space.unreached) for space in spaces]
        for spaces in (lost, refused)
    )
    return directions, lost, refused


def _rigid_states(plant: LinearPlant) -> FloatArray:
    """Return states of the structure at rest, moved as one body, shape (s, k); none over ground."""
    fields = left_by_supports(plant.model.structure, rigid_motions(plant.nodes))
    if plant.model.contacts is not None:
        fields = fields[:, :0]
    q = plant.coordinates.project(fields)
    whole = _kernel((fields - plant.basis @ q) / np.linalg.norm(fields, axis=0).max(initial=1e-300))
    return np.pad(q @ whole, ((0, len(q)), (0, 0)))


def unseen_with_biases(
    plant: LinearPlant, sensors: Sensors, extra: ExtraStates, C: FloatArray, apart: UnseenStates
) -> FloatArray:
    """Return the directions left alone, and what no reading tells from turning, shape (s, k).

    Where no reading shows a direction, a bias of its rate is not told from the rate either. ``C``
    has all states, and so has the result.
    """
    more, r = extra.size - extra.states, plant.degrees_of_freedom
    directions = np.pad(apart.directions, ((0, more), (0, 0)))
    turning = np.roll(directions, r, axis=0)
    candidates = np.hstack([turning, np.eye(extra.size)[:, extra.of_bias]])
    seen = C @ candidates / sensors.noise[:, None]
    size = np.maximum(np.linalg.norm(seen, axis=0), np.finfo(float).tiny)
    moved = plant.A[r:] @ turning[: extra.states] / (plant.spectral_radius or 1.0)
    moved = np.pad(moved, ((0, 0), (0, candidates.shape[1] - turning.shape[1])))
    mixed = candidates / size @ _kernel(np.vstack([seen / size, moved]))
    return np.hstack([directions, mixed / np.linalg.norm(mixed, axis=0)])


def _is_apart(A: FloatArray, reached: FloatArray, space: FloatArray) -> bool:
    """Whether strings do not reach a space of states that A keeps, and others do not drive it."""
    others = A - (A @ space) @ space.T
    coupling = (np.linalg.norm(block, 2) for block in (reached.T @ space, space.T @ others))
    return all(size < _APART for size in coupling if size)


def refuse_unseen_loads(plant: LinearPlant, sensors: Sensors, C: FloatArray) -> None:
    """Refuse readings that do not tell a constant load from a shape that they do not see.

    A constant load shifts the structure. At the pole 0 the test of Hautus for the plant with
    ``q̈`` of the load as states comes down to this: ``∂y/∂q`` has full column rank where the load
    keeps q at rest. Accelerometers then read what they read in any shape at rest.
    """
    r = plant.degrees_of_freedom
    at_rest = ExtraStates(len(plant.A), load=r)

    def resting(readings: Sensors, rows: FloatArray) -> FloatArray:
        if not readings.needs("acceleration"):
            return rows[:, :r]
        whole = output_derivative(plant, readings, at_rest) / readings.noise[:, None]
        return np.asarray(whole[:, :r] - whole[:, at_rest.of_load] @ plant.A[r:, :r])

    rows = C / sensors.noise[:, None]
    seen = resting(sensors, rows)
    count = r - _rank(seen)
    if not count:
        return
    advice = _remedy(plant, sensors, rows, lambda more: _rank(np.vstack([seen, more[:, :r]])) == r)
    leave = f"{advice}{', or' if advice.startswith('Measure') else ';'} leave out load"
    raise ValueError(
        f"load: {count} of the {r} directions of a load cannot be estimated, as {sensors!r} do not "
        f"measure their effect to first order. {leave}"
    )


def refuse_unseen_constants(
    plant: LinearPlant, sensors: Sensors, extra: ExtraStates, C: FloatArray, apart: FloatArray
) -> None:
    """Refuse biases and errors of rest lengths that readings do not tell from others, or motions.

    The test of Hautus at the pole 0 of the plant with them as states, but for those ``apart``;
    ``C`` has all states.
    """
    own = np.r_[extra.of_rest_length, extra.of_bias]
    if not len(own):
        return
    unit, _ = state_units(plant)
    rate = plant.spectral_radius or 1.0
    r, constant = plant.degrees_of_freedom, [*range(*extra.of_load.indices(extra.size)), *own]
    moved = np.zeros((len(plant.A), extra.size))
    moved[r:, extra.of_load] = np.eye(r)[:, : extra.load]
    moved[:, extra.of_rest_length] = plant.B @ extra.by_rest_length(plant.B.shape[1])
    states = np.r_[np.arange(extra.states), constant].astype(int)
    moved[:, : extra.states] = plant.A
    # Of states that are left alone no reading says anything, and how they move does not matter.
    away = _columns(apart[states] / np.r_[unit, np.ones(len(constant))][:, None])
    moved = moved[:, states] / unit[:, None] / rate
    moved = moved - away[: len(moved)] @ (away[: len(moved)].T @ moved)
    rows = np.vstack([moved, C[:, states] / sensors.noise[:, None], away.T])
    size = np.linalg.norm(rows, axis=0)
    rows /= np.where(size > 0, size, 1.0)
    before = _rank(rows[:, : len(states) - len(own)])
    lost = len(own) - (_rank(rows) - before)
    if not lost:
        return
    leads = plant.actuation.lead[list(extra.rest_lengths)]
    names = [f"the rest length of string {string}" for string in leads]
    names += [f"the bias of {sensors.readings[sensors.reading_of[i]]}" for i in extra.biased]
    hidden = [
        name
        for name, column in zip(names, range(len(states) - len(own), len(states)), strict=True)
        if _rank(np.delete(rows, column, axis=1)) == _rank(rows)
    ]
    raise ValueError(
        f"{lost} of {len(own)} biases and errors of rest lengths cannot be told from each other or "
        f"from a shape or motion by {sensors!r}: among them {', '.join(hidden[:3])}. Measure more, "
        "or leave them out"
    )


def _remedy(
    plant: LinearPlant, sensors: Sensors, seen: FloatArray, helps: Callable[[FloatArray], bool]
) -> str:
    """Return the kinds of reading whose rows, measured in addition, would help.

    Rows are C by the noise: that which the kind has, or one that makes them as large as those seen.
    """
    remedies = []
    for kind in KINDS:
        available, chosen = sensors.count_of(kind.chooser), getattr(sensors, kind.chooser)
        is_whole = chosen is not None and len(chosen) == available
        if is_whole or not available or kind.also or "acceleration" in kind.needs:
            continue
        arguments: dict[str, Any] = {"structure": sensors.structure, kind.name: 1.0}
        rows = output_derivative(plant, Sensors(**arguments))
        noise = getattr(sensors, kind.name)
        if noise is not None:
            rows = rows / noise.mean()
        elif rows.any():
            rows = rows * (float(np.linalg.norm(seen, 2)) / float(np.linalg.norm(rows, 2)))
        if helps(rows):
            remedies.append(f"{kind.name} of all {kind.members}")
    if not remedies:
        return "No single additional kind of reading is enough"
    return f"Measure in addition {', or '.join(remedies)}"


def _rank(rows: FloatArray) -> int:
    sizes = np.linalg.svd(rows, compute_uv=False)
    return int(np.count_nonzero(sizes > _TOLERANCE * sizes.max(initial=0.0)))


def _kernel(rows: FloatArray, tolerance: float = _STILL) -> FloatArray:
    """Return what rows of size 1 map to nothing, orthonormal columns."""
    _, sizes, Vt = np.linalg.svd(rows)
    return np.asarray(Vt[int(np.count_nonzero(sizes > tolerance)) :].T)


def _columns(space: FloatArray) -> FloatArray:
    """Return orthonormal columns of the same space."""
    return np.asarray(np.linalg.qr(space)[0])


def _complement(space: FloatArray) -> FloatArray:
    """Return orthonormal columns of all that is orthogonal to orthonormal columns."""
    return np.asarray(np.linalg.qr(space, mode="complete")[0][:, space.shape[1] :])


def _scaled(plant: LinearPlant, C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return A and C in units of the state, of size 1, these units and the highest frequency."""
    unit, _ = state_units(plant)
    rate = plant.spectral_radius or 1.0
    seen = C * unit
    size = max(float(np.linalg.norm(seen, 2)), 1e-300)
    return plant.A * unit / unit[:, None] / rate, seen / size, unit, rate
