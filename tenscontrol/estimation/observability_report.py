"""Report on what the readings of a filter tell, direction by direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, freeze_arrays
from tenscontrol.estimation.filter_design import FilterDesign
from tenscontrol.plant.linear_plant import LinearPlant, squared_frequencies
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.supports import left_by_supports, rigid_motions

# Motions as one body that a filter has to this part, and parts of states that are left alone.
_WHOLE, _PART = 1e-9, 1e-6


@dataclass(frozen=True, eq=False)
class Observability:
    """What readings tell of each direction. Made by :meth:`KalmanFilter.observability`.

    Attributes
    ----------
    direction : tuple of str, length k
        Motions as one body, their rates, changes of shape by frequency, errors of rest lengths, and
        biases.
    unit : tuple of str, length k
        Of a direction: m or m/s of the node that moves most, or that of the error or bias.
    sensor : tuple of str, length p
        Kinds of readings.
    deviation : ndarray, shape (k, p)
        Standard deviation that the readings of one kind alone would leave over ``duration``, if
        all else were known; infinite where they do not tell.
    filter_deviation : ndarray, shape (k,)
        Standard deviation of the filter at rest, before it uses the readings of a sample; NaN if it
        is left alone.
    left_alone : tuple of str
        Directions that the filter has but no reading shows, wholly or in part: it predicts them.
    left_out : tuple of str
        Motions as one body that the filter does not have.
    duration : float
        s.
    """

    direction: tuple[str, ...]
    unit: tuple[str, ...]
    sensor: tuple[str, ...]
    deviation: FloatArray
    filter_deviation: FloatArray
    left_alone: tuple[str, ...]
    left_out: tuple[str, ...]
    duration: float

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def told_by(self, direction: str) -> tuple[str, ...]:
        """Return the kinds of readings that tell of a direction, the best first.

        Parameters
        ----------
        direction : str
            One of :attr:`direction`.

        Returns
        -------
        tuple of str

        Raises
        ------
        ValueError
            If there is no such direction.
        """
        validation.choice("direction", direction, self.direction)
        row = self.deviation[self.direction.index(direction)]
        return tuple(self.sensor[i] for i in np.argsort(row, kind="stable") if np.isfinite(row[i]))

    def table(self) -> str:
        """Return the report as text: a direction a line, then what is left alone in words.

        Returns
        -------
        str
        """
        names = [f"{name}, {unit}" for name, unit in zip(self.direction, self.unit, strict=True)]
        width = max(map(len, ["direction", *names]))
        sizes = [max(len(name), 10) for name in self.sensor]
        heads = [f"{name:>{size}}" for name, size in zip(self.sensor, sizes, strict=True)]
        lines = ["  ".join([f"{'direction':{width}}", *heads, f"{'filter':>10}"])]
        for name, row, own in zip(names, self.deviation, self.filter_deviation, strict=True):
            entries = [
                f"{value:{size}.3g}" if np.isfinite(value) else f"{'-':>{size}}"
                for value, size in zip(row, sizes, strict=True)
            ]
            own_text = f"{own:10.3g}" if np.isfinite(own) else "left alone"
            lines.append("  ".join([f"{name:{width}}", *entries, own_text]))
        if self.left_alone:
            lines.append(
                f"Left alone: {', '.join(self.left_alone)}. No reading shows them, and no other "
                "estimate depends on them."
            )
        if self.left_out:
            lines.append(f"Left out: {', '.join(self.left_out)}. No reading shows them.")
        return "\n".join(lines)


def observability(
    design: FilterDesign, C: FloatArray, covariance: FloatArray, duration: float
) -> Observability:
    """Return what the readings of a filter tell, by their derivatives at rest."""
    names, units, states = _directions(design)
    left_out = _left_out(design.plant)
    sensors, samples = design.sensors, max(1, round(duration / design.settings.sample_time))
    kinds = [kind.name for kind in sensors.kinds]
    names_read = [sensors.readings[i].split()[0] for i in sensors.reading_of]
    of_kind = np.array([kinds.index(name) for name in names_read])
    information = np.zeros((len(kinds), states.shape[1]))
    moved = states
    for _ in range(samples):
        seen = C @ moved / sensors.noise[:, None]
        np.add.at(information, of_kind, seen**2)
        moved = design.sampled.transition @ moved
    lost = design.unseen
    alone = np.linalg.norm(lost.T @ states, axis=0) > _PART * np.linalg.norm(states, axis=0)
    # Round-off of readings that do not change.
    information[
        information <= _PART**2 * information.max(axis=1, initial=0.0, keepdims=True) * _WHOLE
    ] = 0.0
    information[:, alone] = 0.0
    along = states / (states**2).sum(axis=0)
    own = np.sqrt(np.maximum(((covariance @ along) * along).sum(axis=0), 0.0))
    with np.errstate(divide="ignore"):
        deviation = 1 / np.sqrt(information.T)
    return Observability(
        direction=tuple(names),
        unit=tuple(units),
        sensor=tuple(kinds),
        deviation=deviation,
        filter_deviation=np.where(alone, np.nan, own),
        left_alone=tuple(name for name, is_left in zip(names, alone, strict=True) if is_left),
        left_out=left_out,
        duration=samples * design.settings.sample_time,
    )


def _directions(design: FilterDesign) -> tuple[list[str], list[str], FloatArray]:
    """Return the names, units and states, (s, k), of all directions of a filter."""
    plant, extra = design.plant, design.extra
    r = plant.degrees_of_freedom
    labels, fields = _rigid_fields(plant)
    q = plant.coordinates.project(fields)
    whole = np.linalg.norm(fields - plant.basis @ q, axis=0) <= _WHOLE * np.linalg.norm(
        fields, axis=0
    )
    rigid, names = q[:, whole], [labels[i] for i in np.flatnonzero(whole)]
    inside = np.linalg.qr(rigid, mode="complete")[0][:, rigid.shape[1] :]
    squares, modes = squared_frequencies(-inside.T @ plant.A[r:, :r] @ inside)
    shapes = inside @ modes
    frequency = np.sqrt(np.abs(squares)) / (2 * np.pi)
    places = np.hstack([rigid, shapes])
    d, n = plant.nodes.shape
    nodes = np.linalg.norm((plant.basis @ places).reshape(n, d, -1), axis=1)
    places = places / nodes.max(axis=0)
    states = np.zeros((extra.size, places.shape[1] + rigid.shape[1]))
    states[:r, : places.shape[1]] = places
    states[r : 2 * r, places.shape[1] :] = places[:, : rigid.shape[1]]
    shape_names = [f"shape {i} at {size:.4g} Hz" for i, size in enumerate(frequency)]
    all_names = [*names, *shape_names, *(f"rate of {name}" for name in names)]
    units = ["m"] * places.shape[1] + ["m/s"] * rigid.shape[1]
    sensors = design.sensors
    kind_units = {kind.name: kind.unit for kind in sensors.kinds}
    leads = plant.actuation.lead[list(extra.rest_lengths)]
    all_names += [f"rest length error {string}" for string in leads]
    units += ["m"] * len(extra.rest_lengths)
    first = {int(i): k for k, i in reversed(list(enumerate(sensors.reading_of)))}
    for entry in extra.biased:
        reading = sensors.reading_of[entry]
        name = sensors.readings[reading]
        alone = np.count_nonzero(sensors.reading_of == reading) == 1
        number = "" if alone else f", entry {entry - first[int(reading)]}"
        all_names.append(f"bias of {name}{number}")
        units.append(kind_units[name.split()[0]])
    constants = np.eye(extra.size)[:, [*_range(extra.of_rest_length), *_range(extra.of_bias)]]
    return all_names, units, np.hstack([states, constants])


def _range(places: slice) -> range:
    return range(places.start, places.stop)


def _rigid_fields(plant: LinearPlant) -> tuple[list[str], FloatArray]:
    """Return the motions as one body that the supports leave, with names: about the centre."""
    d = plant.nodes.shape[0]
    fields = rigid_motions(plant.nodes)
    mass = np.kron(plant.model.mass_matrix().toarray(), np.eye(d))
    shifts = fields[:, :d]
    fields[:, d:] -= (
        shifts @ np.linalg.solve(shifts.T @ mass @ shifts, shifts.T @ mass) @ (fields[:, d:])
    )
    left = left_by_supports(plant.model.structure, fields)
    if left is not fields:
        return [f"motion as one body {i}" for i in range(left.shape[1])], left
    turns = "xyz" if d == 3 else "z"
    return [
        *(f"motion along {axis}" for axis in "xyz"[:d]),
        *(f"turn about {axis}" for axis in turns),
    ], fields


def _left_out(plant: LinearPlant) -> tuple[str, ...]:
    labels, fields = _rigid_fields(plant)
    off = fields - plant.basis @ plant.coordinates.project(fields)
    lost = np.linalg.norm(off, axis=0) > _WHOLE * np.linalg.norm(fields, axis=0)
    return tuple(label for label, is_lost in zip(labels, lost, strict=True) if is_lost)
