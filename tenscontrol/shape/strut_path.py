"""Shapes at rest while bars get other lengths: paths that struts deploy a structure along."""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.tangent import bar_basis, bar_displacements, tangent
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.reference import Reference
from tenscontrol.shape.equilibrium_path import PathError
from tenscontrol.statics.prestress import Prestress, prestress
from tenscontrol.structure.bar_geometry import bar_lengths

# Largest change of a length from one shape to the next, as part of it; Newton steps at most, and
# the part of the size below which one is the last, and beyond which the shape is another one.
_STEP, _NEWTON, _EXACT, _FAR = 0.02, 12, 1e-12, 0.1

# Stiffness below this part of the largest resists nothing: motions as one body.
_NO_STIFFNESS = 1e-9


def strut_path(plant: LinearPlant, bar_length: object, time: object) -> Reference:
    """Return the shapes at rest of a structure whose bars have given lengths, as a reference.

    The strings keep the rest lengths of the plant. Shapes are followed from its operating point in
    steps of at most 2 % of a length, so that they belong together.

    Parameters
    ----------
    plant : LinearPlant
        With ``input="bar_length"``. Bars that it does not drive keep their lengths.
    bar_length : array_like, shape (β, K)
        Lengths of the bars, m, one column a time.
    time : array_like, shape (K,)
        Ascending, s.

    Returns
    -------
    Reference
        With the force densities of the strings in each shape.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or a bar that is not driven has another length.
    PathError
        If there is no shape at rest with such lengths near by, or a string goes slack on the way.

    Examples
    --------
    A prism that stands on three nodes is shortened by a tenth:

    >>> from dataclasses import replace
    >>> import numpy as np, tenscontrol as tc
    >>> prism = replace(tc.prism(), fixed=[3, 4, 5])
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=200.0))
    >>> plant = tc.linearize(model, tc.prestress(prism, min_force_density=20.0), "bar_length")
    >>> path = tc.shape.strut_path(plant, prism.bar_length[:, None] * [0.9, 1.0], [0.0, 2.0])
    >>> path.nodes[2, :3].max(axis=0).round(3)
    array([0.842, 1.   ])
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(..., 'bar_length')")
    if plant.input != "bar_length" or plant.rest_length is None:
        raise ValueError(
            f"plant has the input {plant.input!r}, expected 'bar_length': linearize(model, rest, "
            "input='bar_length')"
        )
    structure = plant.model.structure
    times = validation.vector("time", time)
    shape = len(structure.bars), times.size
    lengths = validation.shaped("bar_length", bar_length, shape, "one row per bar, a column a time")
    validation.positive("bar_length", lengths.ravel(), "length in m")
    passive = plant.actuation.passive
    off = np.abs(lengths[passive] / structure.bar_length[passive, None] - 1)
    if off.max(initial=0.0) > _EXACT:
        bar = int(passive[off.max(axis=1).argmax()])
        raise ValueError(
            f"bar_length changes bar {bar}, which the plant does not drive: it has "
            f"{structure.bar_length[bar]:.9g} m"
        )
    first = int(np.abs(lengths / structure.bar_length[:, None] - 1).max(axis=0).argmin())
    shapes = {first: _followed(plant, plant.nodes, lengths[:, first])}
    for k in range(first + 1, times.size):
        shapes[k] = _followed(plant, shapes[k - 1], lengths[:, k])
    for k in range(first - 1, -1, -1):
        shapes[k] = _followed(plant, shapes[k + 1], lengths[:, k])
    nodes = [shapes[k] for k in range(times.size)]
    gamma = [_force_density(plant, shape) for shape in nodes]
    return Reference(times, np.stack(nodes, axis=-1), np.stack(gamma, axis=-1))


def _followed(plant: LinearPlant, nodes: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the shape at rest with other lengths of bars, from one near by, in short steps."""
    begin = bar_lengths(plant.model.structure, nodes)
    count = max(1, ceil(float(np.abs(goal / begin - 1).max(initial=0.0)) / _STEP))
    for k in range(1, count + 1):
        nodes = _stepped(plant, nodes, begin + k / count * (goal - begin))
    return nodes


def _stepped(plant: LinearPlant, begin: FloatArray, lengths: FloatArray) -> FloatArray:
    """Return the shape at rest a step further, by Newton's method on lengths and balance.

    In each step ``J δN = L δL`` and ``Tᵀ (F − K δN) = 0``: ``δN = T q + E δL``.
    """
    structure, nodes, size = plant.model.structure, begin, float(np.ptp(plant.nodes))
    for _ in range(_NEWTON):
        here = tangent(plant.model, nodes, "rest_length", plant.rest_length, plant.external_force)
        T = bar_basis(structure, nodes)
        change = lengths - bar_lengths(structure, nodes)
        grown = bar_displacements(structure, nodes, here.mass) @ change
        pushed = T.T @ (here.force - here.stiffness @ grown)
        stiffness = (T.T @ here.stiffness @ T).toarray()
        q = np.linalg.lstsq(stiffness, pushed, rcond=_NO_STIFFNESS)[0]
        step = (T @ q + grown).reshape(-1, len(nodes)).T
        nodes = nodes + step
        if not np.abs(nodes - begin).max() <= _FAR * size:
            break
        if np.abs(step).max() <= _EXACT * size:
            return _checked(plant, begin, nodes, lengths)
    raise PathError(
        f"there is no shape at rest with bars of {lengths.round(4)} m near the one before",
        _at_rest(plant, begin),
    )


def _checked(
    plant: LinearPlant, begin: FloatArray, nodes: FloatArray, lengths: FloatArray
) -> FloatArray:
    """Return a shape whose strings pull that pulled before, or raise."""
    before, after = (_force_density(plant, shape) for shape in (begin, nodes))
    slack = np.flatnonzero((after <= 0) & (before > 0))
    if len(slack):
        raise PathError(
            f"string {slack[0]} goes slack with bars of {lengths.round(4)} m: give it more "
            "prestress, or end the path before",
            _at_rest(plant, begin),
        )
    return nodes


def _force_density(plant: LinearPlant, nodes: FloatArray) -> FloatArray:
    """Return γ of the strings in a shape, N/m, shape (α,)."""
    law = plant.model.strings
    assert law is not None  # linearize needs one
    assert plant.rest_length is not None  # then, too
    return law.force_density(plant.model.structure.string_length(nodes), plant.rest_length)


def _at_rest(plant: LinearPlant, nodes: FloatArray) -> Prestress:
    """Return a shape at rest with its forces."""
    structure = replace(plant.model.structure, nodes=nodes)
    return prestress(structure, _force_density(plant, nodes), external_force=plant.external_force)
