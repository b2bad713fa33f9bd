"""Which motions the readings do not tell of, and what would."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscontrol.estimation.outputs import output_matrix
from tenscontrol.estimation.sensors import KINDS, Sensors
from tenscontrol.plant import LinearPlant, distinct_poles, reached_dimension
from tenscontrol.validation import FloatArray

# A singular value below this fraction of the largest is zero.
_TOLERANCE = 1e-9

# Poles this far left of the axis, relative to the largest, decay by themselves.
_SLOW = 1e-6


def refuse_unobservable(plant: LinearPlant, sensors: Sensors, C: FloatArray) -> None:
    """Refuse readings that leave a motion which does not decay unseen, and say what would do."""
    seen = C / sensors.noise[:, None]
    poles = unseen_poles(plant, seen)
    if not len(poles):
        return
    remedies = []
    for kind, _, chooser, _ in KINDS:
        there = sensors.count_of(chooser)
        measured = getattr(sensors, chooser)
        if there and (measured is None or len(measured) < there):
            arguments: dict[str, Any] = {"structure": sensors.structure, kind: 1.0}
            more = output_matrix(plant, Sensors(**arguments))
            if not len(unseen_poles(plant, np.vstack([seen, more]))):
                remedies.append(f"{kind} of all {chooser.removeprefix('tension_')}")
    advice = "No single kind of reading in addition would do"
    if remedies:
        advice = f"Measure in addition {', or '.join(remedies)}"
    A, scaled, _ = _scaled(plant, seen)
    count = len(A) - reached_dimension(A.T, scaled.T)
    listed = ", ".join(f"{pole:.4g}" for pole in poles)
    raise ValueError(
        f"{count} of the {len(A)} states are not seen by {sensors!r}. At the poles {listed} 1/s "
        f"they do not decay by themselves. {advice}"
    )


def refuse_unseen_loads(plant: LinearPlant, sensors: Sensors, C: FloatArray) -> None:
    """Refuse readings that do not tell a constant load from a shape that they do not see.

    A constant load shifts the structure. At the pole 0 the test of Hautus for the plant with
    ``q̈`` of the load as states comes down to this: ``∂y/∂q`` has full column rank.
    """
    r = plant.degrees_of_freedom
    count = r - _rank((C / sensors.noise[:, None])[:, :r])
    if not count:
        return
    remedies = []
    for kind, _, chooser, _ in KINDS:
        if sensors.count_of(chooser):
            arguments: dict[str, Any] = {"structure": sensors.structure, kind: 1.0}
            more = output_matrix(plant, Sensors(**arguments))[:, :r]
            seen = (C / sensors.noise[:, None])[:, :r]
            if _rank(np.vstack([seen, more])) == r:
                remedies.append(f"{kind} of all {chooser.removeprefix('tension_')}")
    advice = "No single kind of reading in addition would do; leave out load"
    if remedies:
        advice = f"Measure in addition {', or '.join(remedies)}, or leave out load"
    raise ValueError(
        f"load: {count} of the {r} ways to shift the structure change nothing that {sensors!r} "
        f"read, to first order, so that a load which does it is not seen. {advice}"
    )


def _rank(rows: FloatArray) -> int:
    sizes = np.linalg.svd(rows, compute_uv=False)
    return int(np.count_nonzero(sizes > _TOLERANCE * sizes.max(initial=0.0)))


def unseen_poles(plant: LinearPlant, C: FloatArray) -> np.ndarray:
    """Return the poles with Im s ≥ 0 that do not decay and that C does not see, 1/s.

    By the test of Hautus (1969): s is observable if ``[s I − A; C]`` has full column rank.
    """
    A, seen, highest = _scaled(plant, C)
    poles = distinct_poles(plant.A)
    slow = poles[poles.real >= -_SLOW * highest]
    eye = np.eye(len(A))
    lost = []
    for pole in slow:
        sizes = np.linalg.svd(np.vstack([pole / highest * eye - A, seen]), compute_uv=False)
        if sizes[-1] < _TOLERANCE * sizes[0]:
            lost.append(pole)
    return np.array(lost, dtype=complex)


def _scaled(plant: LinearPlant, C: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return A and C in time units of the highest frequency, C of unit size, and that frequency."""
    r = plant.degrees_of_freedom
    highest = float(np.abs(np.linalg.eigvals(plant.A)).max(initial=0.0)) or 1.0
    scale = np.r_[np.full(r, highest), np.ones(r)]
    seen = C / scale
    size = max(float(np.linalg.norm(seen, 2)), 1e-300)
    return scale[:, None] * plant.A / scale / highest, seen / size, highest
