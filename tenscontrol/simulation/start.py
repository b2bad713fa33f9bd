"""State at the start of a motion, checked, with bars made exact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.integrator import largest_frequency, state_scale
from tenscontrol.integrate.projection import Projector, project
from tenscontrol.simulation.driven_bars import DrivenBars
from tenscontrol.simulation.moving_supports import MovingSupports
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.bar_geometry import (
    MEASURED,
    bar_lengths,
    refuse_strings_without_length,
    refuse_wrong_bar_lengths,
)
from tenscontrol.structure.structure import Structure, member_vectors
from tenscontrol.structure.supports import (
    carried_by_supports,
    free_coordinates,
    refuse_moved_supports,
)

# A start whose bars are off by this part of their length, and stretching by this part of the
# largest speed, is taken as it is; up to the second, at which a run counts as inaccurate, it is
# projected. Near rest the speed is what forces and stiffness can give a structure of this size:
# the first part of that is round-off, the second what RK4 leaves in a motion that has died out.
# Measured velocities may stretch bars at that part of it by which measured lengths may be off.
_EXACT, _PROJECTED = 1e-8, 1e-3
_ROUND_OFF, _LEFT = 1e-12, 1e-6


@dataclass(frozen=True, eq=False)
class Start:
    """The start of a motion: nodes and velocities beside the displacement by moving supports.

    None for what is not given. ``support_rate`` is the velocity of the nodes with their supports
    just before, m/s, node by node; None where supports stand.
    """

    nodes: FloatArray | None
    velocities: FloatArray | None
    support_rate: FloatArray | None = None


def start_beside_supports(
    model: Model,
    supports: MovingSupports | None,
    now: float,
    run: Trajectory | None,
    nodes: object,
    velocities: object,
) -> Start:
    """Return the start at a time, s, by nodes and velocities, or at the end of a run."""
    structure = model.structure
    given = None if nodes is None else structure.checked_nodes("nodes", nodes)
    V = None if velocities is None else structure.checked_nodes("velocities", velocities)
    if supports is None and run is None:
        return Start(given, V)
    N = structure.nodes if given is None else given
    if run is not None:
        N, V = run.nodes[:, :, -1], run.velocities[:, :, -1]
    carried = carried_by_supports(structure)
    before = np.zeros_like(N) if V is None else np.where(carried >= 0, V[:, carried], 0.0)
    if supports is None and before.any():
        raise ValueError("supports move at the end of start: give support_motion, how they go on")
    rate = None
    if supports is not None:
        rate = before.ravel(order="F")
        displaced = supports.displacement.at(np.array([now])).reshape(N.shape, order="F")
        N = N if nodes is None and run is None else N - displaced
    try:
        refuse_moved_supports("nodes" if run is None else "start", structure, N)
    except ValueError as error:
        if supports is None:
            raise
        by = f"less what support_motion displaces it by at {now:g} s"
        raise ValueError(f"{error}, {by}") from None
    return Start(N, np.zeros_like(N) if V is None else V - before, rate)


def initial_state(
    model: Model,
    nodes: FloatArray | None,
    velocities: FloatArray | None,
    input: str,
    held: Callable[[], FloatArray] | None = None,
    *,
    measured: bool = True,
    bars: DrivenBars | None = None,
    now: float = 0.0,
) -> tuple[FloatArray, str | None]:
    """Return the state at the start, and what was put right, after checking the structure is in it.

    ``held`` returns the input at the start, if it is known: forces give the structure its speed.
    ``measured`` says whether bars may be off as in measured shapes: the caller says what was moved.
    ``bars`` says which lengths bars have now; those that are driven may stretch at any rate, which
    is that before the start.
    """
    if bars is not None:
        lengths = bars.at(now)
        return _checked_state(model, nodes, velocities, input, held, measured, (bars, lengths))
    if nodes is None and velocities is None:
        return _state_at_rest(model, input), None
    return _checked_state(model, nodes, velocities, input, held, measured)


def _state_at_rest(model: Model, input: str) -> FloatArray:
    """Return the state at rest in the shape of the structure, which depends on the model alone."""

    def build() -> FloatArray:
        nodes = model.structure.nodes
        return frozen(_checked_state(model, nodes, None, input, None, True)[0])

    return model.prepared.get(("state at rest", input), build)


class _Shape(NamedTuple):
    """A shape, checked: free coordinates, vectors along bars, and the largest error of a bar."""

    places: FloatArray
    bars: FloatArray
    off: float


def _shape_of_structure(model: Model, input: str) -> _Shape:
    """Return the shape of the structure, which depends on the model alone."""

    def build() -> _Shape:
        structure = model.structure
        nodes, bars = structure.nodes, member_vectors(structure.nodes, structure.bars)
        off = _checked_shape(structure, nodes, bars, input, True, None)
        return _Shape(frozen(free_coordinates(structure, nodes)), frozen(bars), off)

    return model.prepared.get(("shape of the structure", input), build)


def _shape_at_rest(model: Model, input: str) -> _Shape:
    """Return the shape of the structure with its bars on their lengths."""

    def build() -> _Shape:
        rest = _state_at_rest(model, input)
        return _Shape(rest[: len(rest) // 2], _shape_of_structure(model, input).bars, 0.0)

    return model.prepared.get(("shape at rest", input), build)


def _checked_state(
    model: Model,
    nodes: FloatArray | None,
    velocities: FloatArray | None,
    input: str,
    held: Callable[[], FloatArray] | None,
    measured: bool,
    driven: tuple[DrivenBars, FloatArray] | None = None,
) -> tuple[FloatArray, str | None]:
    structure = model.structure
    true = structure.bar_length if driven is None else driven[1]
    N = structure.nodes if nodes is None else nodes
    V = np.zeros_like(N) if velocities is None else velocities
    if driven is None and nodes is None:
        places, bars, off = _shape_at_rest(model, input)
    elif driven is None and measured and np.array_equal(N, structure.nodes):
        places, bars, off = _shape_of_structure(model, input)
    else:
        bars, places = member_vectors(N, structure.bars), free_coordinates(structure, N)
        off = _checked_shape(structure, N, bars, input, measured, None if driven is None else true)
    state = np.concatenate([places, free_coordinates(structure, V)])
    if len(structure.fixed_rows) and V.ravel(order="F")[structure.fixed_rows].any():
        _refuse_moving_supports(structure, V)
    along = np.add.reduce(bars * member_vectors(V, structure.bars))
    stretching, fastest = np.abs(along) / true, float(np.maximum.reduce(np.abs(V), None))
    if driven is not None:
        stretching[driven[0].bars] = 0.0  # at any rate
    worst = float(np.maximum.reduce(stretching, initial=0.0))
    if off <= _EXACT and worst <= _EXACT * fastest:
        return state, None
    equation = model.equation(input)
    u = structure.string_length(N) * (input == "rest_length") if held is None else held()
    speed = float(state_scale(equation, state, u, largest_frequency(equation, state, u))[-1])
    if off <= _EXACT and worst <= _ROUND_OFF * speed:
        return state, None
    most = max(_PROJECTED * fastest, _LEFT * speed)
    if worst > (MEASURED * speed if measured else most):
        raise ValueError(
            f"velocities stretch bar {stretching.argmax()} at {worst:.3g} m/s, expected 0: bars "
            "are rigid. plant.to_velocities(q, rates) gives velocities that bars can have"
        )
    if driven is None:
        exact = Projector(equation, True)(state[:, None])
    else:
        exact = _on_lengths(structure, state, true, driven[0].rates(structure, N, V))
    if not exact.size:
        raise ValueError(
            f"in nodes, bars are off by {off:.1e} of their length, and those that share nodes "
            "cannot all be given theirs near by: start from a shape that is nearer"
        )
    half = len(state) // 2
    moved = np.abs(exact[:, 0] - state)
    return exact[:, 0], (
        f"bars made rigid: off by {off:.1e} of their length, stretching at {worst:.1e} m/s; nodes "
        f"moved by up to {moved[:half].max():.1e} m and {moved[half:].max():.1e} m/s along an axis"
    )


def _checked_shape(
    structure: Structure, nodes: FloatArray, bars: FloatArray, input: str, measured: bool,
    driven: FloatArray | None,
) -> float:  # fmt: skip
    """Return by which part of its length a bar is off at most, after checks of a shape.

    ``bars`` are the vectors along them, ``driven`` their lengths where those are driven.
    """
    true, length = structure.bar_length if driven is None else driven, np.linalg.norm(bars, axis=0)
    off = float(np.abs(length / true - 1).max(initial=0.0))
    if off > (MEASURED if measured else _PROJECTED):
        if driven is not None:
            _refuse_other_lengths("nodes", length, true)
        refuse_wrong_bar_lengths("nodes", structure, nodes)
    refuse_moved_supports("nodes", structure, nodes)
    if input == "rest_length":
        refuse_strings_without_length("nodes", structure, nodes)
    return off


def _refuse_moving_supports(structure: Structure, velocities: FloatArray) -> None:
    """Raise a ValueError if what supports hold has a velocity."""
    rows = structure.fixed_rows
    moving = rows[velocities.ravel(order="F")[rows] != 0]
    node, axis = divmod(int(moving[0]), structure.dimension)
    if node in structure.fixed:
        movement = f"the fixed node {node} by {velocities[:, node]} m/s"
    else:
        speed = f"{velocities[axis, node]:g} m/s along {'xyz'[axis]}"
        movement = f"node {node}, on a roller, by {speed}"
    raise ValueError(f"velocities move {movement}, expected 0")


def _on_lengths(
    structure: Structure, state: FloatArray, lengths: FloatArray, rates: FloatArray
) -> FloatArray:
    """Return a state, one column, with bars of these lengths and rates; empty if there is none."""
    exact = np.array(project(structure, driven=True)(state, np.concatenate([lengths, rates])))
    return exact if np.isfinite(exact).all() else exact[:, :0]


def refuse_other_lengths(
    name: str, structure: Structure, nodes: FloatArray, true: FloatArray
) -> None:
    """Raise a ValueError if bars of a shape are not as long as they are driven."""
    length = bar_lengths(structure, nodes)
    if len(true) and np.abs(length / true - 1).max() > _PROJECTED:
        _refuse_other_lengths(name, length, true)


def _refuse_other_lengths(name: str, length: FloatArray, true: FloatArray) -> None:
    bar = int(np.abs(length / true - 1).argmax())
    raise ValueError(
        f"in {name}, bar {bar} is {length[bar]:.9g} m long, but bar_length begins at "
        f"{true[bar]:.9g} m: begin with the length that it has, or give nodes that have those of "
        "bar_length"
    )
