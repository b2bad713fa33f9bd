"""A scene: everything that a simulation needs; and its motion in a file."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control import Controller
from tenscontrol.dynamics import Model
from tenscontrol.estimation import KalmanFilter
from tenscontrol.files import write_file
from tenscontrol.plant import LinearPlant, linearize
from tenscontrol.simulation import Fault, Trajectory, simulate
from tenscontrol.statics import prestress
from tenscontrol.structure import Structure, to_strings
from tenscontrol.validation import FloatArray, file_path, frozen, instance


@dataclass(frozen=True, eq=False)
class Scene:
    """A structure with strings, loads, start, controller, faults, run. By :func:`load_scene`.

    ``dataclasses.replace(scene, duration=0.1)`` gives the scene with other settings.

    Attributes
    ----------
    file : str
        Where it was read.
    model : Model
    nodes, velocities : ndarray, shape (3, n)
        Motion at the start, m and m/s.
    force_density : ndarray, shape (α,)
        γ of the strings in the shape of the structure, N/m, in balance or not.
    rest_length : ndarray, shape (α,), or None
        Rest lengths that give this γ in that shape, m; None where γ is held.
    controller : Controller or None
        Designed on the structure with its strings whole.
    winches : Winches or None
        Their limits, one for each whole string.
    sample_time : float or None
        Of a controller in continuous time, s.
    estimator : KalmanFilter or None
        Gives the controller its estimate; None if it gets the motion itself.
    seed : int or None
        Of the noise of the sensors; None without them.
    faults : tuple of Fault
    input : str
        ``"force_density"`` or ``"rest_length"``: the input of the actuators.
    duration : float
        s.
    step : float or None
        Step of a method with a fixed step, s.
    tolerance : float
        Of a method with steps of its own.
    output_step : float or None
        Time between states kept, s.
    method : str
        ``"auto"`` or the name of a method.
    """

    file: str
    model: Model
    nodes: FloatArray
    velocities: FloatArray
    force_density: FloatArray
    rest_length: FloatArray | None
    controller: Controller | None
    winches: Winches | None
    sample_time: float | None
    estimator: KalmanFilter | None
    seed: int | None
    faults: tuple[Fault, ...]
    input: str
    duration: float
    step: float | None
    tolerance: float
    output_step: float | None
    method: str

    def __post_init__(self) -> None:
        for name in ("nodes", "velocities", "force_density", "rest_length"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def structure(self) -> Structure:
        """The structure, skinned and cut as the scene says."""
        return self.model.structure

    def simulate(self, progress: bool = False) -> Trajectory:
        """Return the motion.

        Parameters
        ----------
        progress : bool
            Whether to show a progress bar; never shown away from a terminal.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            If the simulation refuses the scene.
        SimulationError
            If the motion runs away.
        """
        names = ["duration", "method", "tolerance", "step", "output_step", "faults"]
        if self.controller is not None:
            names += ["controller", "input", "winches", "sample_time", "estimator", "seed"]
        settings: dict[str, Any] = {name: getattr(self, name) for name in names}
        if self.controller is not None and self.rest_length is not None:
            wound = self.rest_length
            if len(self.controller.plant.model.structure.strings) != len(wound):
                wound = to_strings(self.structure, "rest_length", wound)
            settings["rest_length"] = wound
        elif self.rest_length is not None:
            settings["rest_length"] = self.rest_length
        elif self.controller is None:
            settings["force_density"] = self.force_density
        return simulate(
            self.model, nodes=self.nodes, velocities=self.velocities, progress=progress, **settings
        )

    def linearize(self, input: str | None = None, coordinates: str = "internal") -> LinearPlant:
        """Return the linear plant about the shape of the structure, as :func:`linearize` does.

        Parameters
        ----------
        input : {"force_density", "rest_length"}, optional
            That of the scene if not given.
        coordinates : {"internal", "minimal", "nodes"}
            See :func:`linearize`.

        Returns
        -------
        LinearPlant

        Raises
        ------
        ValueError
            If the structure is not at rest under its force densities and loads.
        """
        try:
            rest = prestress(
                self.structure, self.force_density, external_force=self.model.constant_force
            )
        except ValueError as error:
            raise ValueError(
                f"the scene has no linear plant, as it is not at rest: {error}"
            ) from error
        return linearize(self.model, rest, self.input if input is None else input, coordinates)


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
        If it cannot be written: a file that was there is as it was.

    Notes
    -----
    Read it by ``numpy.load(file)``. The arrays have the names of the attributes of
    :class:`Trajectory`, those of its structure and of its control record after ``structure_`` and
    ``control_``. Faults are texts. Attributes that are None and counts of statuses are left out.

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
    instance("run", run, Trajectory, "make one by simulate(model, ...)")
    path, buffer = file_path("file", file), BytesIO()
    np.savez_compressed(buffer, **_arrays("", run))
    return write_file(path, buffer.getbuffer())


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
