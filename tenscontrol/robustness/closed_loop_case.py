"""A closed loop for Monte Carlo studies: the plant differs from that of the design."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.motors import motor_numbers, with_motor_numbers
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.command import ControlWarning
from tenscontrol.control.controller import Controller
from tenscontrol.dynamics.coordinates import Coordinates, coordinates
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.model_parameters import (
    MASSES,
    law_parameters,
    parameters_of,
    with_parameters,
    without_law,
)
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.plant.linear_plant import LinearPlant, refuse_driven_bars
from tenscontrol.plant.reference import checked_reference
from tenscontrol.robustness.distributions import one_number
from tenscontrol.robustness.sweep_report import SweepError
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.batch.batch_inputs import refusal
from tenscontrol.simulation.batch.simulate_many import simulate_many
from tenscontrol.simulation.health import HealthLimits
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.strength import strength
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.status import Status
from tenscontrol.structure.bar_geometry import refuse_wrong_bar_lengths
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import refuse_moved_supports

# What can be drawn of a run, beside factors on the parameters of the model.
_OF_RUN = "start", "noise", "delay"

# Factors that act on a parameter of another name.
_STRING_NODE_MASS, _RIGIDITY = "string_node_mass", {"stiffness": "axial_rigidity"}

_MOTOR = "motor."

_MEMBERS = {"bar_mass": "bar", "point_mass": "node", "gravity": "axis"}

# Runs that go through the compiled loops together, and numbers of their motions.
_MOST_TOGETHER, _MOST_NUMBERS = 64, 4_000_000

# Methods of runs that go through them.
_FIXED_STEPS = "auto", "rk4", "rk4_plain"

# The part of the run, at its end, in which the structure is to be at its place.
_SETTLED = 0.1


@final
@dataclass(frozen=True, init=False)
class Outcome:
    """Result of one run of a case: success or not, and its figures.

    Parameters
    ----------
    success : bool
    figures : mapping of str to float, optional
        Finite numbers by name, the same names in every run. Names carry no
        unit; say in the case's docstring what they are in.

    Raises
    ------
    TypeError, ValueError
        If ``success`` is neither True nor False, or a figure has no name or is
        not one finite number. Raised within a case, that is a failure of the run.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> outcome = tc.robustness.Outcome(success=True, figures={"final_error": 0.8e-3})
    >>> outcome.success, outcome.figures
    (True, {'final_error': 0.0008})
    """

    success: bool
    _figures: tuple[tuple[str, float], ...] = field(repr=False)

    __repr__ = short_repr

    def __init__(self, success: bool, figures: Mapping[str, object] | None = None) -> None:
        given = {} if figures is None else figures
        validation.named("figures", given, "a dict of numbers")
        put = object.__setattr__  # the dataclass is frozen for everyone else
        put(self, "success", validation.truth("success", success, "whether the run was a success"))
        numbers = ((name, one_number(f"figures[{name!r}]", given[name])) for name in given)
        put(self, "_figures", tuple(numbers))

    @property
    def figures(self) -> dict[str, float]:
        """The figures by name; a new dict at each access."""
        return dict(self._figures)


@final
@dataclass(frozen=True, eq=False)
class ClosedLoopCase:
    """A scene whose plant varies, while the controller keeps its nominal design.

    For :func:`sweep`. Open loops, and runs whose controller is compiled code
    (:meth:`GeneratedController.compile`), are simulated by the compiled loops of
    :func:`simulate_many`, several at a time, with the same numbers. That needs steps of RK4, and a
    scene without winches, estimator, faults and ground. ``report.back_end`` says which way was
    taken, and why.

    These parameters can vary:

    - ``"bar_mass"``, ``"string_node_mass"``, ``"point_mass"``, ``"gravity"``, ``"stiffness"``,
      ``"damping"`` and other parameters of the string law: factors on the nominal values, one for
      all or one for each member (point masses: one for each node; gravity: for each axis);
    - ``"ground.stiffness"``, ``"ground.damping"``, ``"ground.friction"`` and other numbers of the
      contact laws: factors, one for all laws or one for each;
    - ``"motor.torque"``, ``"motor.speed"``, ``"motor.inertia"``, ``"motor.lag"`` and other numbers
      of :class:`Motor`, of winches that have one: factors, one for all or one for each string;
    - ``"start"``: where the structure starts, coordinates q of the controller's plant, m √kg; for
      a function, internal coordinates about the target;
    - ``"noise"``, with an estimator: a factor on the standard deviations of all readings;
    - ``"delay"``, with an estimator: delay of the readings in samples; draw it by :class:`OneOf`.

    Neither the controller nor the estimator knows the values drawn. The measurement noise comes
    from the random generator of the run.

    The figures of a run are ``final_error``, m: the largest distance of a node from its target in
    the last tenth of the run, without rigid-body motion; ``least_force_density`` and
    ``largest_force_density`` of all strings, N/m; ``largest_command``, N/m or m; and
    ``commands_not_ok``, the number of commands with a status other than ``Status.OK``. Structures
    without strings have no force densities, and open loops no commands. Where the limits of the
    scene have ``sections``, ``utilization`` is the largest force of a member over its strength, and
    a margin below their limit counts as a failure. So does a motion that is not accurate.

    Parameters
    ----------
    scene : Scene
        Nominal. Its controller was designed on its structure, or on the parent of that. Workers get
        it pickled: a function at the top of a module, not a lambda.
    tolerance : float, optional
        Largest ``final_error`` of a success, m. Needed if ``success`` is not given.
    target : array_like, shape (d, n), optional
        Where the nodes are to be, m. If not given: for a controller the shape of its plant, for a
        function and in open loop that of the structure.
    success : callable, optional
        ``success(run) -> bool`` of the :class:`Trajectory`: whether a place was reached, or how far
        it rolled. It may return an :class:`Outcome`, whose figures are added to those above. With
        ``tolerance`` too, both must hold. A function at the top of a module, as above.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> plant = tc.linearize(model, rest, input="rest_length")
    >>> Q, R = tc.energy_weights(plant)
    >>> scene = tc.Scene(
    ...     model, 1.0, controller=tc.LQR(plant, Q, 0.1 * R, sample_time=0.02),
    ...     integration=tc.Integration(step=5e-3))
    >>> case = tc.ClosedLoopCase(scene, tolerance=0.02)
    >>> outcome = case({"stiffness": np.linspace(0.7, 1.3, 9)}, np.random.default_rng(0))
    >>> outcome.success, round(outcome.figures["final_error"], 4)
    (False, 0.0257)

    How far does a prism fly that is thrown? A run is a success beyond a metre:

    >>> def flew(run):
    ...     way = run.nodes[:, :, -1].mean(axis=1) - run.nodes[:, :, 0].mean(axis=1)
    ...     return tc.robustness.Outcome(way[0] > 1.0, {"way": way[0]})
    >>> thrown = tc.Scene(
    ...     model, 0.5, velocities=np.tile([[2.1], [0.0], [0.0]], 6), rest_length=plant.rest_length)
    >>> case = tc.ClosedLoopCase(thrown, success=flew)
    >>> outcome = case({"bar_mass": 1.2}, np.random.default_rng(0))
    >>> outcome.success, round(outcome.figures["way"], 4)
    (True, 1.05)
    """

    scene: Scene
    tolerance: float | None = None
    target: Any = None  # given as anything array-like, held as an array
    success: Callable[[Trajectory], Any] | None = None
    # In which the nodes are to be at their place.
    _coordinates: Coordinates = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        validation.instance(
            "scene", self.scene, Scene, "make one by Scene(model, duration, controller=...)"
        )
        put = object.__setattr__  # the dataclass is frozen for everyone else
        if self.tolerance is None and self.success is None:
            raise ValueError(
                "there is neither tolerance nor success: give tolerance, m, or success, a function "
                "of the run"
            )
        if self.tolerance is not None:
            put(self, "tolerance", validation.positive_number("tolerance", self.tolerance, "m"))
        if self.success is not None:
            validation.function("success", self.success, "it takes a run to True or False")
        law = self.scene.law
        if isinstance(law, Controller):
            put(self, "_coordinates", law.plant.coordinates)
            if self.target is not None:
                reference = checked_reference(law.plant, self.target, "target", anywhere=True)[0]
                put(self, "target", frozen(reference.nodes[:, :, 0]))
            return
        known = self.scene.structure if law is None else law.structure
        if self.target is not None:
            shape = known.checked_nodes("target", self.target)
            refuse_wrong_bar_lengths("target", known, shape)
            refuse_moved_supports("target", known, shape)
            put(self, "target", frozen(shape))
        put(self, "_coordinates", coordinates(Model(known), self.target))

    @property
    def structure(self) -> Structure:
        """The nominal structure."""
        return self.scene.structure

    def __call__(self, parameters: Mapping[str, object], rng: np.random.Generator) -> Outcome:
        """Return what becomes of the closed loop with these factors and start; noise by ``rng``.

        Raises TypeError, ValueError or SimulationError if the plant cannot be built or the motion
        runs away or is not accurate; SweepError if there is no such parameter, or it has nothing to
        act on.
        """
        estimator, sensors = self.scene.estimator, self.scene.sensors
        if sensors is None and estimator is not None:
            sensors = estimator.sensors
        # Where the loop ends is what a sweep asks.
        nodes = self._start(parameters["start"]) if "start" in parameters else self.scene.nodes
        with warnings.catch_warnings(action="ignore", category=ControlWarning):
            run = replace(
                self.scene,
                model=self._model(parameters),
                winches=self._winches(parameters),
                nodes=nodes,
                sensors=_varied_sensors(sensors, parameters),
                seed=None if estimator is None else int(rng.integers(2**63)),
                integration=replace(self.scene.integration, limits=self._limits),
            ).simulate()
        if run.stopped is not None:
            raise SweepError(f"a simulation {run.stopped}")
        record = run.control
        if record is None:
            return self._judged(run)
        not_ok = sum(status is not Status.OK for status in record.status)
        return self._judged(run, record.command, not_ok)

    def alone(self, names: Collection[str]) -> str | None:
        """Return why runs go one by one; None if some of them can go together.

        Parameters
        ----------
        names : collection of str
            Parameters that vary.
        """
        why = self._runs_alone()
        if why is not None:
            return why
        if not names:
            return "nothing varies"
        scene, model, varied = self.scene, self.scene.model, {*names} - {"start"}
        masses = {*MASSES, _STRING_NODE_MASS}
        if not varied <= {*masses, *_RIGIDITY, *law_parameters(model)}:
            return "more than masses and strings vary"
        no_law = model.strings is None or scene.force_density is not None
        if no_law and varied - masses:
            return "strings vary whose rest lengths are not held"
        if varied and model.equation("force_density" if no_law else "rest_length").form != "flat":
            return "equations of so many members take no parameters"
        if varied & masses and self.structure.blocks:
            return "masses of bars that share nodes vary"
        return None

    def _runs_alone(self) -> str | None:
        """Return why runs of the scene go one by one, whatever varies."""
        scene = self.scene
        if scene.controller is not None and self.success is not None:
            return "success is asked of runs with their record of the control"
        why = refusal(scene)
        if why is not None:
            return why
        if scene.model.ground or scene.external_force is not None:
            return f"{'ground' if scene.model.ground else 'external_force'} given"
        if scene.integration.step is None or scene.integration.method not in _FIXED_STEPS:
            return "there are no steps of RK4"
        if scene.inputs is not None and not scene.inputs.is_constant:
            return "inputs change in time"
        return None

    @property
    def at_a_time(self) -> int:
        """Number of runs whose motions are held in memory together."""
        spacing = self.scene.integration.step
        if spacing is None:
            return 1
        numbers = 2 * self.structure.nodes.size * self.scene.duration / spacing
        return int(np.clip(_MOST_NUMBERS / numbers, 1, _MOST_TOGETHER))

    def together(self, drawn: Sequence[Mapping[str, object]]) -> list[Callable[[], Outcome] | None]:
        """Return what gives the outcome of each run; None for a run that has to go by itself.

        Parameters
        ----------
        drawn : sequence of mapping
            Parameters of each run.
        """
        outcomes: list[Callable[[], Outcome] | None] = [None] * len(drawn)
        values: dict[int, dict[str, FloatArray]] = {}
        for i, parameters in enumerate(drawn):
            # By itself, a run says what is wrong with its parameters.
            with suppress(TypeError, ValueError, SweepError):
                values[i] = self._values(parameters)
                if "start" in parameters:
                    values[i]["nodes"] = self._start(parameters["start"])
        if not values:
            return outcomes
        every = list(values.values())
        how = self.scene.integration
        how = replace(
            how, method="rk4" if how.method == "auto" else how.method,
            output_step=how.output_step or how.step,
            error="none",  # found with the trajectory
        )  # fmt: skip
        batch = simulate_many(
            replace(self.scene, integration=how),
            {name: np.array([own[name] for own in every]) for name in every[0]},
            threads=1,
        )

        def outcome(run: int) -> Outcome:
            motion = batch.trajectory(run, self._limits)
            commands, not_ok = batch.command, batch.commands_not_ok
            if commands is None or not_ok is None:
                return self._judged(motion)
            return self._judged(motion, commands[run], int(not_ok[run]))

        for run, i in enumerate(values):
            if batch.completed[run]:
                outcomes[i] = partial(outcome, run)
        return outcomes

    @property
    def _limits(self) -> HealthLimits:
        """What a run must keep to count; where bars cross is not asked, strength is a figure."""
        limits = self.scene.integration.limits
        return replace(limits, crossings=None, sections=None, action="raise")

    def _model(self, drawn: Mapping[str, object]) -> Model:
        """Return the model with the factors that are drawn."""
        return with_parameters(self.scene.model, self._values(drawn))

    def _values(self, drawn: Mapping[str, object]) -> dict[str, FloatArray]:
        """Return the parameters of the model on which factors are drawn."""
        nominal = parameters_of(self.scene.model)
        values: dict[str, FloatArray] = {}
        others = [name for name in drawn if name not in _OF_RUN and not name.startswith(_MOTOR)]
        for name in others:
            for own, factors in self._factors(name, drawn[name], nominal).items():
                values[own] = factors * values.get(own, nominal[own])
        return values

    def _winches(self, drawn: Mapping[str, object]) -> Winches | None:
        """Return the winches with the factors on numbers of their motors that are drawn."""
        winches, count = self.scene.winches, len(self.structure.strings)
        motor = None if winches is None else winches.motor
        nominal, values = motor_numbers(motor, count), dict[str, FloatArray]()
        for name in (name for name in drawn if name.startswith(_MOTOR)):
            if name not in nominal:
                known = ", ".join(map(repr, nominal)) or "none: give Winches(motor=Motor(...))"
                raise SweepError(f"{name} is drawn, but the motors of the scene have {known}")
            factors = validation.per_member(name, drawn[name], count, "string")
            values[name] = factors * nominal[name]
        if winches is None or motor is None or not values:
            return winches
        return replace(winches, motor=with_motor_numbers(motor, values))

    def _factors(
        self, name: str, drawn: object, nominal: Mapping[str, FloatArray]
    ) -> dict[str, FloatArray]:
        """Return the factors on parameters of the model, by name, that are drawn under a name."""
        structure, model = self.structure, self.scene.model
        if name == _STRING_NODE_MASS:
            points = structure.string_nodes
            factors = np.ones(structure.nodes.shape[1])
            factors[points] = validation.per_member(name, drawn, len(points), "string node")
            return {"point_mass": factors}
        if name.startswith("ground"):
            laws = [own for own in nominal if name in (own, without_law(own))]
            if not any(nominal[own].any() for own in laws):
                why = "the ground has none" if model.ground else "there is no ground: give ground"
                raise SweepError(f"{name} is drawn, but {why}")
            factors = validation.per_member(
                name, drawn, len(laws), "contact law of the ground that has it"
            )
            return dict(zip(laws, factors[:, None], strict=True))
        own = name if name in nominal else _RIGIDITY.get(name, name)
        if own in nominal and (own != "point_mass" or nominal[own].any()):
            member = _MEMBERS.get(own, "string")
            return {own: validation.per_member(name, drawn, len(nominal[own]), member)}
        if name == "point_mass":
            raise SweepError("point_mass is drawn, but no node has one")
        if name in ("stiffness", "damping"):
            raise SweepError(f"{name} is drawn, but the strings have none: {model.strings!r}")
        known = ", ".join(repr(name) for name in (*nominal, _STRING_NODE_MASS, *_OF_RUN))
        raise SweepError(f"there is no parameter {name!r}, expected some of {known}")

    def _start(self, drawn: object) -> FloatArray:
        """Return the nodes at the start by the coordinates that are drawn."""
        known = self._coordinates
        if known.nodes.shape != self.structure.nodes.shape:
            raise SweepError(
                f"start gives the {known.nodes.shape[1]} nodes of the controller's plant a "
                f"position, but the structure has {self.structure.nodes.shape[1]}: give nodes "
                "instead"
            )
        return known.to_nodes(drawn)

    def _judged(
        self, run: Trajectory, commands: FloatArray | None = None, not_ok: int = 0
    ) -> Outcome:
        known = self._coordinates
        late = run.time >= (1 - _SETTLED) * run.time[-1]
        # Of a subdivision, the nodes of its parent come first. Sums depend on the layout in memory.
        nodes = np.ascontiguousarray(run.nodes[:, : known.nodes.shape[1], late])
        error = farthest_node(known, nodes, known.nodes if self.target is None else self.target)
        figures = {"final_error": error}
        if run.force_density.size:
            figures["least_force_density"] = float(run.force_density.min())
            figures["largest_force_density"] = float(run.force_density.max())
        if commands is not None:
            figures["largest_command"] = float(commands.max())
            figures["commands_not_ok"] = float(not_ok)
        limits, holds = self.scene.integration.limits, True
        if limits.sections is not None:
            margin = strength(run, limits.sections).margin
            figures["utilization"] = 1 / margin
            holds = margin >= limits.margin
        holds = holds and (self.tolerance is None or error <= self.tolerance)
        if self.success is None:
            return Outcome(holds, figures)
        verdict = self.success(run)
        if not isinstance(verdict, Outcome):
            if not isinstance(verdict, bool | np.bool_):
                raise SweepError(
                    f"success returned {verdict!r:.60}, expected True or False, or an Outcome"
                )
            verdict = Outcome(bool(verdict))
        return Outcome(holds and verdict.success, figures | verdict.figures)


def _varied_sensors(sensors: Sensors | None, parameters: Mapping[str, object]) -> Sensors | None:
    """Return the sensors with the noise and delay that are drawn."""
    drawn = [name for name in ("noise", "delay") if name in parameters]
    if sensors is None:
        if drawn:
            raise SweepError(f"{drawn[0]} is drawn, but nothing is measured: give estimator")
        return None
    if "noise" in parameters:
        factor = validation.positive_number(
            "noise", parameters["noise"], "of the nominal deviations"
        )
        kinds = [kind.name for kind in sensors.kinds]
        deviations = {kind: factor * getattr(sensors, kind) for kind in kinds}
        sensors = replace(sensors, **deviations)
    if "delay" in parameters:
        late = validation.float_array("delay", parameters["delay"])
        if late.ndim or late < 0 or late != np.round(late):
            raise SweepError(
                f"delay is {parameters['delay']!r}, expected whole samples, at least 0: draw "
                "it by OneOf([0, 1, 2]), for example"
            )
        sensors = replace(sensors, delay=int(late))
    return sensors


def farthest_node(plant: LinearPlant | Coordinates, nodes: FloatArray, target: FloatArray) -> float:
    """Return the largest distance of a node from its target over a motion, m.

    Motions that the coordinates of the plant, or those given in its place, leave out do not
    count: in internal coordinates, those of the structure as one body.

    Parameters
    ----------
    plant : LinearPlant or Coordinates
    nodes : ndarray, shape (d, n, T)
        m.
    target : ndarray, shape (d, n)
        m.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.robustness import farthest_node
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> raised = prism.nodes + np.array([[0.0], [0.0], [0.5]])
    >>> farthest_node(plant, raised[:, :, None], prism.nodes) < 1e-12
    True
    """
    if not isinstance(plant, Coordinates):
        validation.instance("plant", plant, LinearPlant, "make one by linearize(model, at)")
        refuse_driven_bars(plant, "ClosedLoopCase")
    known = plant if isinstance(plant, Coordinates) else plant.coordinates
    target = known.structure.checked_nodes("target", target)
    nodes = validation.float_array("nodes", nodes)
    if nodes.ndim != 3 or nodes.shape[:2] != target.shape:
        raise ValueError(f"nodes has shape {nodes.shape}, expected {(*target.shape, 'T')}")
    at_rest = np.zeros_like(known.nodes)

    def seen(shape: FloatArray) -> FloatArray:
        if known.kind in ("nodes", "minimal") and known.is_complete:
            return shape
        if known.is_complete:  # but for motions as one body
            return known.laid_over(shape, at_rest)[0]
        return known.to_nodes(known.measure(shape, at_rest)[: known.count])

    wanted, *shapes = (seen(shape) for shape in (target, *np.moveaxis(nodes, 2, 0)))
    return max((float(np.linalg.norm(N - wanted, axis=0).max()) for N in shapes), default=0.0)
