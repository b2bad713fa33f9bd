"""First guess of a planned motion: a path through equilibria, or else a straight line."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.model import Model
from tenscontrol.optimize.collocation import STAGES, DiscreteMotion, gauss_points
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.shape.equilibrium_path import PathError
from tenscontrol.shape.shape_path import ShapePath, shape_path
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.bar_geometry import restore_bar_lengths
from tenscontrol.structure.supports import free_coordinates

# Intervals of a guess.
_INTERVALS = 20


def guessed_motion(
    model: Model,
    ends: tuple[Prestress, Prestress],
    input: str,
    winches: Winches | None,
    plant: LinearPlant | None,
    duration: float | None,
    least_duration: float,
) -> tuple[DiscreteMotion, str]:
    """Return a guess and what it is: ``"path"`` through equilibria, or ``"straight line"``.

    Its duration is what the winches need on the path, or ``least_duration`` if that is more.
    """
    try:
        path = _path(model, ends, winches, plant, duration, least_duration)
    except (PathError, ValueError):  # none, or out of the range of winches; ends were checked
        time = duration or least_duration
        return _straight(model, ends, input, time), "straight line"
    time = duration or max(float(path.time[-1]), least_duration)
    return _of_path(path, input, time), "path"


def _path(
    model: Model,
    ends: tuple[Prestress, Prestress],
    winches: Winches | None,
    plant: LinearPlant | None,
    duration: float | None,
    least_duration: float,
) -> ShapePath:
    """Return the path through equilibria, as slow as it has to be."""
    given = None if model.strings is None else winches
    rated = given is not None and given.largest_rate is not None
    time = None if rated else duration or least_duration
    return shape_path(
        model, *ends, winches=given, duration=time, step=least_duration / _INTERVALS,
        require_stable=False, place="centre", plant=plant,
    )  # fmt: skip


def _of_path(path: ShapePath, input: str, duration: float) -> DiscreteMotion:
    from scipy.interpolate import CubicHermiteSpline

    structure, time = path.model.structure, path.time * (duration / path.time[-1])
    slower = path.time[-1] / duration
    places, velocities = (
        np.column_stack(
            [free_coordinates(structure, matrix) for matrix in np.moveaxis(array, 2, 0)]
        )
        for array in (path.nodes, path.velocities * slower)
    )
    spline = CubicHermiteSpline(time, places, velocities, axis=1)
    values = path.force_density if input == "force_density" else path.rest_length
    assert values is not None  # a rest length is the input
    at = np.linspace(0.0, duration, _INTERVALS + 1)
    inputs = np.array([np.interp(at, time, row) for row in values])
    rates = spline.derivative()
    return _guess(spline, duration, spline(at), rates(at), inputs)


def _straight(
    model: Model, ends: tuple[Prestress, Prestress], input: str, duration: float
) -> DiscreteMotion:
    """Return shapes on the straight line, with bar lengths restored where that can be."""
    from scipy.interpolate import CubicHermiteSpline

    structure = model.structure
    at = np.linspace(0.0, 1.0, _INTERVALS + 1)
    smooth = at**2 * (3 - 2 * at)
    first, last = (rest.structure.nodes for rest in ends)
    shapes = []
    for share in smooth:
        nodes = first + share * (last - first)
        with suppress(ValueError):  # far from all shapes that bars allow: a guess all the same
            nodes = restore_bar_lengths(structure, nodes)
        shapes.append(free_coordinates(structure, nodes))
    places, time = np.column_stack(shapes), at * duration
    velocities = np.gradient(places, time, axis=1)
    velocities[:, [0, -1]] = 0.0
    spline = CubicHermiteSpline(time, places, velocities, axis=1)
    values = [end_input(model, rest, input) for rest in ends]
    inputs = values[0][:, None] + smooth * (values[1] - values[0])[:, None]
    return _guess(spline, duration, places, velocities, inputs)


def _guess(
    spline: Any, duration: float, places: FloatArray, velocities: FloatArray, inputs: FloatArray
) -> DiscreteMotion:
    """Return a motion by what it is at the ends of intervals, and a spline of its places."""
    stages = ((np.arange(_INTERVALS)[:, None] + gauss_points(STAGES)[1:]) / _INTERVALS) * duration
    return DiscreteMotion(
        duration, places, velocities, inputs[:, :-1], inputs[:, 1:],
        *(curve(stages).swapaxes(1, 2) for curve in (spline, spline.derivative())),
    )  # fmt: skip


def end_input(model: Model, rest: Prestress, input: str) -> FloatArray:
    """Return the input that holds an equilibrium, shape (α,)."""
    if input == "force_density":
        return rest.force_density
    assert model.strings is not None  # a rest length is the input
    return model.strings.rest_length(rest.structure.string_length(), rest.force_density)
