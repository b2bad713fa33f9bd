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
from tenscontrol.estimation.sensors import KINDS, Sensors, symbolic_readings
from tenscontrol.plant.controllability import LeftSpace, left_spaces, own_modes, reached_states
from tenscontrol.plant.linear_plant import LinearPlant, state_units
from tenscontrol.plant.linearize import in_coordinates
from tenscontrol.plant.modes import Modes, modes_of
from tenscontrol.plant.reduced_dynamics import near_symbol, reduced_motion, settled
from tenscontrol.plant.string_outputs import model_input
from tenscontrol.structure.supports import left_by_supports, rigid_motions

# A rigid-body motion that moves the readings less than this fraction of another is not seen.
_UNSEEN = 1e-9

# A singular value below this fraction of the largest is zero.
_TOLERANCE = 1e-9

# Poles this far left of the axis, relative to the largest, decay by themselves.
_SLOW = 1e-6

# Parts of a plant that move each other by less than this fraction are apart.
_APART = 1e-6


@dataclass(frozen=True, eq=False)
class UnseenStates:
    """States that a filter leaves alone: an orthonormal basis with them after ``count`` others."""

    basis: FloatArray  # (s, s)
    count: int
    left_alone: Modes


def output_function(plant: LinearPlant, sensors: Sensors, more: int = 0) -> ca.Function:
    """Return ``(z, u) -> (y, ∂y/∂z)``, dense, exact; ``more`` entries of z change nothing."""
    key = "output_function", more, sensors.measured
    return plant.prepared.get(key, lambda: _output_function(plant, sensors, more))


def _output_function(plant: LinearPlant, sensors: Sensors, more: int) -> ca.Function:
    structure = plant.model.structure
    z, u = ca.SX.sym("z", len(plant.A) + more), ca.SX.sym("u", plant.B.shape[1])
    near = near_symbol(plant)
    N, V = reduced_motion(plant, z[: len(plant.A)], near)
    tension = ca.SX(len(structure.strings), 1)
    if sensors.string_tension is not None:
        length, rate = (row.T for row in kernel.string_motion(structure, N, V))
        gamma = model_input(plant, u)
        if plant.input == "rest_length":
            law = plant.model.strings
            assert law is not None  # linearize needs one for this input
            gamma = law.symbolic_force_density(length, gamma, rate)
        tension = gamma * length
    y = symbolic_readings(sensors, N, V, tension)
    results = settled(plant, z, near, [ca.densify(y), ca.densify(ca.jacobian(y, z))])
    return Function("readings", [z, u], ca.cse(results))


def output_matrix(plant: LinearPlant, sensors: Sensors) -> FloatArray:
    """Return C = ∂y/∂z at the operating point, shape (m, 2r)."""
    function = output_function(plant, sensors)
    return np.array(function(np.zeros(len(plant.A)), plant.equilibrium_input)[1].full())


def observed_plant(plant: LinearPlant, sensors: Sensors) -> LinearPlant:
    """Return the plant with the rigid-body motions that the sensors see.

    Internal coordinates have none. Positions, directions and rates see some: those are added,
    so that a structure that drifts or turns is not mistaken for one that changes its shape.
    A plant in minimal coordinates, which has them all, is returned as it is.
    """
    if plant.coordinates.kind != "internal":
        return plant
    if all(chosen is None for chosen in (sensors.nodes, sensors.bars, sensors.rate_bars)):
        return plant
    key = "observed_plant", sensors.measured, sensors.noise.tobytes()
    return plant.prepared.get(key, lambda: _observed_plant(plant, sensors))


def _observed_plant(plant: LinearPlant, sensors: Sensors) -> LinearPlant:
    whole = in_coordinates(plant, "minimal")
    r = whole.degrees_of_freedom
    fields = left_by_supports(whole.model.structure, rigid_motions(whole.nodes))
    rigid = np.linalg.qr(whole.coordinates.project(fields))[0]
    C = output_matrix(whole, sensors) / sensors.noise[:, None]
    moved = C[:, :r] @ rigid
    if sensors.rate_bars is not None:
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
    return replace(plant, coordinates=within, A=None, B=None, drift=None)


def unseen(plant: LinearPlant, sensors: Sensors, C: FloatArray) -> UnseenStates:
    """Return what no reading shows and no string reaches; refuse what only the strings reach.

    Decaying motions are not among it: an estimate forgets them.
    """
    seen = C / sensors.noise[:, None]
    lost, refused = _lasting(plant, seen)
    A, _, unit, rate = _scaled(plant, seen)
    if refused:
        advice = _remedy(
            plant, sensors, lambda more: not _lasting(plant, np.vstack([seen, more]))[1]
        )
        count = sum(space.unreached.shape[1] for space in refused)
        listed = ", ".join(f"{rate * space.pole:.4g}" for space in refused)
        raise ValueError(
            f"{count} of the {len(A)} states are not observable by {sensors!r}. At the poles "
            f"{listed} "
            f"1/s they do not decay by themselves. {advice}"
        )
    spaces = [space.unreached for space in lost]
    whole = np.hstack([np.zeros((len(A), 0)), *(unit[:, None] * space for space in spaces)])
    count = len(A) - whole.shape[1]
    basis = np.linalg.qr(whole, mode="complete")[0]
    return UnseenStates(
        basis=frozen(np.hstack([basis[:, len(A) - count :], basis[:, : len(A) - count]])),
        count=count,
        left_alone=modes_of(plant, *own_modes(A, rate, spaces)),
    )


def _lasting(plant: LinearPlant, seen: FloatArray) -> tuple[list[LeftSpace], list[LeftSpace]]:
    """Return what neither decays nor is seen, pole by pole, and what of it cannot be left alone."""
    A, scaled, _, _ = _scaled(plant, seen)
    reachable = reached_states(plant)
    reached = reachable.basis[:, : reachable.count]
    lost = [
        space
        for space in left_spaces(A.T, scaled.T)
        if space.unreached.shape[1] and space.pole.real >= -_SLOW
    ]
    return lost, [
        space for space in lost if space.grows or not _is_apart(A, reached, space.unreached)
    ]


def _is_apart(A: FloatArray, reached: FloatArray, space: FloatArray) -> bool:
    """Whether strings do not reach a space of states that A keeps, and others do not drive it."""
    others = A - (A @ space) @ space.T
    coupling = (np.linalg.norm(block, 2) for block in (reached.T @ space, space.T @ others))
    return all(size < _APART for size in coupling if size)


def refuse_unseen_loads(plant: LinearPlant, sensors: Sensors, C: FloatArray) -> None:
    """Refuse readings that do not tell a constant load from a shape that they do not see.

    A constant load shifts the structure. At the pole 0 the test of Hautus for the plant with
    ``q̈`` of the load as states comes down to this: ``∂y/∂q`` has full column rank.
    """
    r = plant.degrees_of_freedom
    seen = (C / sensors.noise[:, None])[:, :r]
    count = r - _rank(seen)
    if not count:
        return
    advice = _remedy(plant, sensors, lambda more: _rank(np.vstack([seen, more[:, :r]])) == r)
    leave = f"{advice}{', or' if advice.startswith('Measure') else ';'} leave out load"
    raise ValueError(
        f"load: {count} of the {r} directions of a load cannot be estimated, as {sensors!r} do not "
        f"measure their effect to first order. {leave}"
    )


def _remedy(plant: LinearPlant, sensors: Sensors, helps: Callable[[FloatArray], bool]) -> str:
    """Return the kinds of reading whose rows C, measured in addition, would help."""
    remedies = []
    for kind, _, chooser, _ in KINDS:
        available, chosen = sensors.count_of(chooser), getattr(sensors, chooser)
        if available and (chosen is None or len(chosen) < available):
            arguments: dict[str, Any] = {"structure": sensors.structure, kind: 1.0}
            if helps(output_matrix(plant, Sensors(**arguments))):
                remedies.append(f"{kind} of all {chooser.rpartition('_')[2]}")
    if not remedies:
        return "No single additional kind of reading is enough"
    return f"Measure in addition {', or '.join(remedies)}"


def _rank(rows: FloatArray) -> int:
    sizes = np.linalg.svd(rows, compute_uv=False)
    return int(np.count_nonzero(sizes > _TOLERANCE * sizes.max(initial=0.0)))


def _scaled(plant: LinearPlant, C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return A and C in units of the state, of size 1, these units and the highest frequency."""
    unit, _ = state_units(plant)
    rate = plant.spectral_radius or 1.0
    seen = C * unit
    size = max(float(np.linalg.norm(seen, 2)), 1e-300)
    return plant.A * unit / unit[:, None] / rate, seen / size, unit, rate
