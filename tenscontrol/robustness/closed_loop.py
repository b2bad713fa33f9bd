"""A case for sweeps: a controller on a plant that is not the one it was designed on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control import Controller, Status
from tenscontrol.dynamics import Model, StringLaw
from tenscontrol.estimation import KalmanFilter, Sensors
from tenscontrol.robustness.distance import farthest_node
from tenscontrol.robustness.errors import SweepError
from tenscontrol.robustness.outcome import Outcome
from tenscontrol.robustness.varied import varied_sensors, varied_strings
from tenscontrol.simulation import Fault, Faults, HealthLimits, Trajectory, simulate
from tenscontrol.structure import Structure
from tenscontrol.validation import (
    FloatArray,
    float_array,
    frozen,
    instance,
    per_member,
    positive_number,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_PARAMETERS = ("bar_mass", "string_node_mass", "stiffness", "damping", "start", "noise", "delay")

# What a factor on the stiffness acts on, by the law.
_STIFFNESS = ("stiffness", "axial_rigidity")

# The part of the run, at its end, in which the structure is to be at its place.
_SETTLED = 0.1


@final
@dataclass(frozen=True, eq=False)
class ClosedLoopCase:
    """A closed loop whose plant varies, while the controller keeps its nominal design.

    For :func:`sweep`. The parameters it knows: ``"bar_mass"``,
    ``"string_node_mass"``, ``"stiffness"`` and ``"damping"`` are factors on the
    nominal values, one for all or one a member; ``"start"`` is where the
    structure starts, coordinates q of the controller's plant, m √kg. With an estimator,
    ``"noise"`` is a factor on the standard deviations of all readings, and ``"delay"``
    how many samples late they come: draw it by :class:`OneOf`. The estimator is
    not told, as the controller is not. The noise itself is drawn from the run's generator.

    The figures of a run: ``final_error``, m, the largest distance of a node from
    its place in the last tenth of the run, motion of the structure as one body
    apart; ``least_force_density`` and ``largest_force_density``, N/m, of all
    strings; ``largest_command``, N/m or m; ``commands_not_ok``, how many commands
    had another status than ``Status.OK``. A motion that is not accurate is a failure.

    Parameters
    ----------
    structure : Structure
        Nominal; the one that the controller was designed on, or its subdivision.
    strings : StringLaw or None
        Nominal; None where γ is held.
    controller : Controller
        Its plant says where the nodes are to be.
    duration : float
        s.
    step : float
        Step of the integrator, s.
    tolerance : float
        Largest ``final_error`` of a success, m.
    nodes : array_like, shape (3, n), optional
        Start of each run, m, where ``"start"`` is not drawn; the reference shape if not given.
    target : array_like, shape (3, n), optional
        Where the nodes are to be, m; at the operating point if not given.
    gravity : float or array_like, shape (3,), optional
        As in :class:`Model`. Weights go with the masses.
    rest_length, input, winches, sample_time, estimator, sensors, faults : optional
        As in :func:`simulate`.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> strings = tc.LinearStrings(100.0, damping=0.5)
    >>> rest = tc.prestress(prism, force_density=17.3205)
    >>> plant = tc.linearize(tc.Model(prism, strings=strings), rest, input="rest_length")
    >>> Q, R = tc.energy_weights(plant)
    >>> case = tc.ClosedLoopCase(
    ...     prism, strings, tc.lqr(plant, Q, 0.1 * R, sample_time=0.02),
    ...     duration=1.0, step=5e-3, tolerance=0.03)
    >>> outcome = case({"stiffness": np.linspace(0.7, 1.3, 9)}, np.random.default_rng(0))
    >>> outcome.success, round(outcome.figures["final_error"], 4)
    (False, 0.0453)
    """

    structure: Structure
    strings: StringLaw | None
    controller: Controller
    duration: float
    step: float
    tolerance: float
    nodes: FloatArray | None = None
    target: FloatArray | None = None
    gravity: FloatArray | None = None
    rest_length: FloatArray | None = None
    input: str | None = None
    winches: Winches | None = None
    sample_time: float | None = None
    estimator: KalmanFilter | None = None
    sensors: Sensors | None = None
    faults: Sequence[Fault] = ()

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            structure: Structure,
            strings: StringLaw | None,
            controller: Controller,
            duration: float,
            step: float,
            tolerance: float,
            nodes: ArrayLike | None = None,
            target: ArrayLike | None = None,
            gravity: ArrayLike | None = None,
            rest_length: ArrayLike | None = None,
            input: str | None = None,
            winches: Winches | None = None,
            sample_time: float | None = None,
            estimator: KalmanFilter | None = None,
            sensors: Sensors | None = None,
            faults: Sequence[Fault] = (),
        ) -> None: ...

    def __post_init__(self) -> None:
        instance("structure", self.structure, Structure, "for example prism()")
        instance("controller", self.controller, Controller, "make one by lqr(...) or MPC(...)")
        if self.winches is not None:
            instance("winches", self.winches, Winches, "make them by Winches(rate=...)")
        put = object.__setattr__  # the dataclass is frozen for everyone else
        for name, unit in (("duration", "s"), ("step", "s"), ("tolerance", "m")):
            put(self, name, positive_number(name, getattr(self, name), unit))
        if self.sample_time is not None:
            put(self, "sample_time", positive_number("sample_time", self.sample_time, "s"))
        if self.nodes is not None:
            put(self, "nodes", frozen(self.structure.checked_nodes("nodes", self.nodes)))
        if self.target is not None:
            designed = self.controller.plant.model.structure
            put(self, "target", frozen(designed.checked_nodes("target", self.target)))
        for name in ("gravity", "rest_length"):
            if getattr(self, name) is not None:
                put(self, name, frozen(float_array(name, getattr(self, name))))
        if self.estimator is not None:
            instance("estimator", self.estimator, KalmanFilter, "make one by kalman(...)")
        if self.sensors is not None:
            instance("sensors", self.sensors, Sensors, "make them by Sensors(structure=..., ...)")
            if self.estimator is None:
                raise ValueError("sensors go with an estimator; kalman(...) makes one")
        put(self, "faults", self._checked_faults())
        self._model({})  # refuses strings and gravity that do not fit

    def __call__(self, parameters: Mapping[str, object], rng: np.random.Generator) -> Outcome:
        """Return what becomes of the closed loop with these parameters.

        Parameters
        ----------
        parameters : mapping of str to float or array_like
            Factors, and where the structure starts.
        rng : numpy.random.Generator
            For the noise of the readings.

        Returns
        -------
        Outcome

        Raises
        ------
        TypeError, ValueError, SimulationError
            If the plant cannot be built of these, or the motion runs away or is not accurate.
        SweepError
            If there is no such parameter, or it has nothing to act on.
        """
        unknown = sorted(set(parameters) - set(_PARAMETERS))
        if unknown:
            known = ", ".join(repr(name) for name in _PARAMETERS)
            raise SweepError(f"there is no parameter {unknown[0]!r}, expected some of {known}")
        sensors = self.sensors
        if sensors is None and self.estimator is not None:
            sensors = self.estimator.sensors
        run = simulate(
            self._model(parameters),
            self.duration,
            self._start(parameters),
            controller=self.controller,
            rest_length=self.rest_length,
            input=self.input,
            winches=self.winches,
            sample_time=self.sample_time,
            step=self.step,
            limits=HealthLimits(action="raise"),
            estimator=self.estimator,
            sensors=varied_sensors(sensors, parameters),
            seed=None if self.estimator is None else int(rng.integers(2**63)),
            faults=self.faults,
        )
        if run.stopped is not None:
            raise SweepError(f"a simulation {run.stopped}")
        return self._judged(run)

    def _model(self, parameters: Mapping[str, object]) -> Model:
        structure, strings = self.structure, self.strings
        for name in ("bar_mass", "string_node_mass"):
            if name in parameters:
                nominal = getattr(structure, name)
                factor = per_member(name, parameters[name], len(nominal), name)
                structure = replace(structure, **{name: factor * nominal})
        for name, of_law in (("stiffness", _STIFFNESS), ("damping", ("damping",))):
            if name in parameters:
                strings = varied_strings(
                    strings, name, of_law, parameters[name], len(structure.strings)
                )
        return Model(structure, strings=strings, gravity=self.gravity)

    def _checked_faults(self) -> tuple[Fault, ...]:
        """Return the faults, after checking that there is what they break."""
        held = "force_density" if self.strings is None else "rest_length"
        size = float(np.ptp(self.structure.nodes, axis=1).max())
        breaking = Faults(self.faults, size, self.input or held)
        winches = len(self.controller.plant.commanded.strings)
        breaking.refuse_unknown(len(self.structure.strings), winches)
        return tuple(self.faults)

    def _start(self, parameters: Mapping[str, object]) -> FloatArray | None:
        if "start" not in parameters:
            return self.nodes
        plant = self.controller.plant
        if plant.nodes.shape != self.structure.nodes.shape:
            raise SweepError(
                f"start gives the {plant.nodes.shape[1]} nodes of the controller's plant a place, "
                f"but the structure has {self.structure.nodes.shape[1]}: give nodes instead"
            )
        return plant.to_nodes(parameters["start"])

    def _judged(self, run: Trajectory) -> Outcome:
        record = run.control
        assert record is not None  # a controller was given
        error = self._error(run)
        figures = {
            "final_error": error,
            "least_force_density": float(run.force_density.min()),
            "largest_force_density": float(run.force_density.max()),
            "largest_command": float(record.command.max()),
            "commands_not_ok": float(sum(status is not Status.OK for status in record.status)),
        }
        return Outcome(success=error <= self.tolerance, figures=figures)

    def _error(self, run: Trajectory) -> float:
        """Return how far the farthest node is from its place at the end, m."""
        plant = self.controller.plant
        late = run.time >= (1 - _SETTLED) * run.time[-1]
        # Of a subdivision, the nodes of its parent come first.
        nodes = run.nodes[:, : plant.nodes.shape[1], late]
        return farthest_node(plant, nodes, plant.nodes if self.target is None else self.target)
