"""What a command prints with ``--json``: documented in docs/scenes.rst."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol.accuracy.work_precision import WorkPrecision
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.modes import Modes
from tenscontrol.simulation.control_record import ControlRecord
from tenscontrol.simulation.trajectory import Trajectory


def json_text(summary: Mapping[str, Any]) -> str:
    """Return a summary as JSON; numbers that are not known or not finite are null."""
    return json.dumps(_plain(summary), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    """Return a value made of what JSON has."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, complex):
        return [_plain(value.real), _plain(value.imag)]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def of_run(run: Trajectory) -> dict[str, Any]:
    """Return the figures of a motion."""
    size = run.structure.size
    off = np.linalg.norm(run.nodes - run.structure.nodes[:, :, None], axis=0).max(axis=0)
    return {
        "time": run.time[-1],
        "states": len(run.time),
        "stopped": run.stopped,
        "method": run.method,
        run.choice.setting: run.choice.value,
        "size": size,
        "displacement": {"start": off[0], "end": off[-1], "largest": off.max()},
        "energy": {"start": run.energy[0], "end": run.energy[-1]},
        "health": asdict(run.health),
        "faults": [fault.label for fault in run.faults],
        "control": None if run.control is None else _of_control(run.control),
    }


def _of_control(record: ControlRecord) -> dict[str, Any]:
    error, seconds = record.tracking_error, record.computing_time
    return {
        "controller": record.controller,
        "sample_time": record.sample_time,
        "samples": len(record.time),
        "status": record.status_count,
        "fallback": record.fallback_count,
        "tracking_error": None if error is None else {"end": error[-1], "largest": error.max()},
        "computing_time": {"median": np.median(seconds), "largest": seconds.max()},
        "problems": record.problems,
    }


def of_modes(plant: LinearPlant, modes: Modes) -> dict[str, Any]:
    """Return the modes of a plant."""
    rows = zip(modes.frequency, modes.damping, modes.pole, modes.label, strict=True)
    names = ("frequency", "damping", "pole", "kind")
    return {
        "input": plant.input,
        "coordinates": plant.coordinates.kind,
        "modes": [dict(zip(names, row, strict=True)) for row in rows],
    }


def of_comparison(comparison: WorkPrecision) -> dict[str, Any]:
    """Return the rows of a comparison of methods."""
    return {
        "case": comparison.case.name,
        "duration": comparison.case.duration,
        "reference_error": comparison.reference.error,
        "rows": [asdict(row) for row in comparison.rows],
        "refused": dict(comparison.refused),
    }
