"""A scene: everything that a simulation needs."""

from __future__ import annotations

from dataclasses import dataclass

from tenscontrol.actuation import Winches
from tenscontrol.control import Controller
from tenscontrol.dynamics import Model
from tenscontrol.estimation import KalmanFilter
from tenscontrol.plant import LinearPlant, linearize
from tenscontrol.simulation import Fault, Trajectory, simulate
from tenscontrol.statics import prestress
from tenscontrol.structure import Structure, to_strings
from tenscontrol.validation import FloatArray, frozen


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
        Of a controller without its own, s.
    estimator : KalmanFilter or None
        What tells the controller the motion; None where it sees it.
    seed : int or None
        Of the noise of the sensors; None without them.
    faults : tuple of Fault
        What breaks.
    input : str
        ``"force_density"`` or ``"rest_length"``: what the actuators hold.
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
        held: dict[str, object] = {}
        if self.controller is not None:
            held = {"controller": self.controller, "input": self.input, "winches": self.winches}
            held |= {"sample_time": self.sample_time, "estimator": self.estimator}
            held["seed"] = self.seed
            if self.rest_length is not None:
                held["rest_length"] = self._wound(self.controller.plant.model.structure)
        elif self.rest_length is not None:
            held = {"rest_length": self.rest_length}
        else:
            held = {"force_density": self.force_density}
        return simulate(
            self.model,
            self.duration,
            self.nodes,
            self.velocities,
            method=self.method,
            tolerance=self.tolerance,
            step=self.step,
            output_step=self.output_step,
            faults=self.faults,
            progress=progress,
            **held,  # type: ignore[arg-type]  # each under its own name
        )

    def _wound(self, design: Structure) -> FloatArray:
        """Return where the winches stand, m: the sum over the segments of each string."""
        assert self.rest_length is not None  # the caller saw
        if len(design.strings) == len(self.structure.strings):
            return self.rest_length
        return to_strings(self.structure, "rest_length", self.rest_length)

    def linearize(self, input: str | None = None, coordinates: str = "internal") -> LinearPlant:
        """Return the linear plant about the shape of the structure, which must be at rest.

        Parameters
        ----------
        input : {"force_density", "rest_length"}, optional
            As ``input`` if not given.
        coordinates : {"internal", "minimal", "nodes"}

        Returns
        -------
        LinearPlant

        Raises
        ------
        ValueError
            If the structure is not at rest under its force densities and loads,
            or as :func:`linearize`.
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
