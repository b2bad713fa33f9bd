"""A motion written to a file of arrays."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol.simulation import Trajectory


def save_trajectory(run: Trajectory, file: str | Path) -> Path:
    """Write everything that a motion holds to a NumPy archive.

    Parameters
    ----------
    run : Trajectory
    file : str or Path
        Its name ends in ``.npz``.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OSError
        If it cannot be written.

    Notes
    -----
    Read it by ``numpy.load(file)``. The arrays have the names of the attributes
    of :class:`Trajectory`; those of the structure and of the control record
    come after ``structure_`` and ``control_``, and so on. Faults are texts. What is None is
    left out, and so is the count of the statuses, all of which are there.

    Examples
    --------
    >>> import tempfile, numpy as np, tenscontrol as tc
    >>> run = tc.simulate(tc.Model(tc.prism()), 0.1, force_density=20.0, step=1e-2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = tc.scene.save_trajectory(run, folder + "/run.npz")
    ...     with np.load(file) as saved:
    ...         saved["nodes"].shape, str(saved["choice_method"]), saved["structure_bars"].shape
    ((3, 6, 11), 'rk4', (3, 2))
    """
    arrays = _arrays("", run)
    path = Path(file)
    with path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
    return path


def _arrays(prefix: str, value: Any) -> dict[str, Any]:
    """Return the fields of a value as arrays by name."""
    found: dict[str, Any] = {}
    for field in fields(value):
        part = getattr(value, field.name)
        if is_dataclass(part):
            found |= _arrays(f"{prefix}{field.name}_", part)
        elif field.name == "fallback":
            found[f"{prefix}{field.name}"] = np.array([str(each or "") for each in part], dtype=str)
        elif field.name == "faults":
            found[field.name] = np.array([repr(fault) for fault in part], dtype=str)
        elif part is not None and not isinstance(part, dict):
            found[f"{prefix}{field.name}"] = np.asarray(part)
    return found
