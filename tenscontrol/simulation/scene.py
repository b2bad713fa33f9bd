"""A scene: what is simulated, from which start, under which inputs, for how long."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from functools import partial
from operator import is_
from typing import TYPE_CHECKING, Any
from weakref import ref

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.equation import (
    Equation,
    pack_state,
    unpack_states,
    with_derivatives,
)
from tenscontrol.dynamics.held_inputs import held_value, own_input
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces, sampling_interval
from tenscontrol.fields import changed, check_fields, checked, instance_of, optional
from tenscontrol.interrupt import (
    Interruption,
    InterruptionWarning,
    finishing,
    interruptible,
)
from tenscontrol.progress import progress_bar
from tenscontrol.properties import cached_property
from tenscontrol.simulation.arguments import Arguments
from tenscontrol.simulation.assembly import assembled
from tenscontrol.simulation.driven_bars import DrivenBars, driven_bars, stretching
from tenscontrol.simulation.error_estimate import estimated_errors
from tenscontrol.simulation.faults import Fault, Faults, StuckWinch
from tenscontrol.simulation.health import ERROR_LIMIT
from tenscontrol.simulation.health_check import SimulationError, check_health
from tenscontrol.simulation.inputs import changes_in_time, checked_inputs, load_in_time
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.moving_supports import MovingSupports, support_offset
from tenscontrol.simulation.plant_run import PlantRun, StoppedError
from tenscontrol.simulation.start import (
    Start,
    initial_state,
    refuse_other_lengths,
    start_beside_supports,
)
from tenscontrol.simulation.strength import refuse_other_members
from tenscontrol.simulation.strut_record import done_by_drives
from tenscontrol.simulation.traced_run import TracedRun
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.bar_geometry import refuse_other_bar_lengths
from tenscontrol.structure.segments import to_segments
from tenscontrol.structure.structure import Structure, refuse_all_fixed, same_members
from tenscontrol.warn import warn

if TYPE_CHECKING:
    from tenscontrol.actuation.winches import Winches
    from tenscontrol.control.controller import BaseController
    from tenscontrol.estimation.kalman_filter import KalmanFilter
    from tenscontrol.estimation.sensors import Sensors
    from tenscontrol.plant.linear_plant import LinearPlant
    from tenscontrol.simulation.closed_loop import ClosedLoop
    from tenscontrol.sizing.sections import Sections

# States kept of an adaptive run, unless the user says otherwise, and numbers in them at most.
_OUTPUTS, _NUMBERS = 1000, 50_000_000

# Of a run with fewer states than this the ends of steps are kept, to look for bars that cross.
_FEW_OUTPUTS = 256

# What is given as arrays, or as functions of time, in open loop; the state first.
_GIVEN = "rest_length", "force_density", "external_force", "support_motion", "bar_length"
_ARRAYS = "nodes", "velocities", *_GIVEN


class _Checked:
    """The last scene of a model that was checked: the same in another integration need not be."""

    scene: ref[Scene] | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """What is simulated: a model, its start, its inputs or controller, loads, faults, duration.

    Give one of ``rest_length``, ``force_density`` and ``controller``; without strings none is
    needed. :func:`simulate` takes the same arguments, and describes each of them. A scene is
    checked when it is made; ``dataclasses.replace(scene, duration=0.1)`` gives one with other
    settings.

    Parameters
    ----------
    model : Model
    duration : float
        s.
    nodes, velocities : array_like, shape (d, n), optional
        Motion at the start, m and m/s; the reference shape at rest if not given. None where a run
        goes on, or supports move and it was not given.
    rest_length : float, array_like, shape (α,), Profile or callable, optional
        Rest lengths, m; with a controller those at the start, one per string that it commands.
    force_density : float, array_like, shape (α,), Profile or callable, optional
        γ, N/m.
    controller : controller, callable or object with a method ``command``, optional
    input : {"rest_length", "force_density"}, optional
        What the actuators hold. In open loop what is given; under a controller the rest length if
        the model has a string law, else γ.
    winches : Winches, optional
    sample_time : float, optional
        For a controller without a sample time of its own, s.
    faults : sequence of CutString, StuckWinch and LostMeasurement
    external_force : array_like, shape (d, n), 0, Profile or callable, optional
        Load W, N.
    support_motion : Profile, callable or array_like, shape (d, number of fixed nodes), optional
        Displacement of the fixed nodes, m.
    bar_length : Profile, callable, float or array_like, shape (β,), optional
        Lengths of bars that are driven, m.
    estimator : KalmanFilter, optional
    sensors : Sensors, optional
    seed : int, optional
        Of the noise of the readings; 0 if not given.
    start : Trajectory, optional
        A run to go on from, in place of ``nodes`` and ``velocities``.
    prestress : array_like, shape (α,), optional
        γ of the strings in the shape of the structure, N/m, about which :meth:`linearize` takes the
        scene; that of the input if not given.
    integration : Integration
        Method, step or tolerance, states kept, limits.
    name, note : str
        For titles, and what a reader of a result must know.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> start = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    >>> scene = tc.Scene(model, 5.0, rest_length=start)
    >>> scene
    Scene(5 s, rest_length held, 6 nodes)
    >>> scene.simulate()
    Trajectory(5 s, 1001 states, dop853)
    """

    model: Model = field(
        metadata=checked(validation.instance, Model, "make one by Model(structure)")
    )
    duration: float = field(metadata=checked(validation.positive_number, "s"))
    nodes: Any = None
    velocities: Any = None
    _: KW_ONLY
    rest_length: Any = None
    force_density: Any = None
    controller: Any = None
    input: Any = None  # found below
    winches: Winches | None = field(
        default=None,
        metadata=optional(
            instance_of, "tenscontrol.actuation.winches.Winches", "make them by Winches(rate=...)"
        ),
    )
    sample_time: float | None = field(
        default=None, metadata=optional(validation.positive_number, "s")
    )
    faults: Sequence[Fault] | None = ()
    external_force: Any = None
    support_motion: Any = None
    bar_length: Any = None
    estimator: KalmanFilter | None = field(
        default=None,
        metadata=optional(
            instance_of, "tenscontrol.estimation.kalman_filter.KalmanFilter",
            "make one by KalmanFilter(plant, sensors, sample_time=...)",
        ),
    )  # fmt: skip
    sensors: Sensors | None = field(
        default=None,
        metadata=optional(
            instance_of,
            "tenscontrol.estimation.sensors.Sensors",
            "make them by Sensors(structure=..., ...)",
        ),
    )
    seed: int | None = field(
        default=None, metadata=optional(validation.whole_number, 0, validation.LARGEST_SEED)
    )
    start: Trajectory | None = field(
        default=None,
        metadata=optional(validation.instance, Trajectory, "a run that simulate(...) returned"),
    )
    prestress: Any = None
    integration: Integration = field(
        default_factory=Integration,
        metadata=checked(validation.instance, Integration, "make one by Integration(step=...)"),
    )
    name: str = field(default="", metadata=checked(validation.text, "for titles"))
    note: str = field(
        default="", metadata=checked(validation.text, "what a reader of the result must know")
    )

    def __post_init__(self) -> None:
        given: object = self.model
        last = _Checked()
        if isinstance(given, Model):
            last = given.prepared.get("last scene", _Checked)
        if not self._takes_over_checks(last):
            self._check(last)
        if self.integration.limits.sections is not None:
            self._check_strength(self.integration.limits.sections)

    def _takes_over_checks(self, last: _Checked) -> bool:
        """Take over what was found of the last scene of the model, if that hangs on the same."""
        before = None if last.scene is None else last.scene()
        if before is None or type(before) is not type(self):
            return False
        own, known = vars(self), vars(before)
        if not all(map(is_, *(map(of.__getitem__, _FOUND_FROM) for of in (own, known)))):
            return False
        check_fields(self, _FOUND_FROM)
        beside = {name: own[name] for name in _BESIDE}
        own.update(known)
        own.update(beside)
        return True

    def _check(self, last: _Checked) -> None:
        check_fields(self)
        refuse_all_fixed(self.model.structure)
        if self.sensors is not None and self.estimator is None:
            raise ValueError("sensors go with an estimator; KalmanFilter(...) makes one")
        is_alone = self.winches is None and self.sample_time is None and self.estimator is None
        if self.controller is None and not is_alone:
            raise ValueError("estimator, winches and sample_time go with a controller")
        if self.start is not None:
            self._take_over_start(self.start)
        if self.bar_length is not None or self.controller is not None:
            self._check_bars()
        self._check_inputs()
        _ = self.loads, self.initial
        self._keep_arrays()
        # What controllers, runs and functions of time do may change, though they are the same.
        if self.controller is None and self.start is None:
            values = vars(self)
            if not any(map(callable, map(values.__getitem__, _GIVEN))):
                last.scene = ref(self)

    def _check_strength(self, sections: Sections) -> None:
        """Refuse limits on members of another structure, or whose forces will not be found."""
        refuse_other_members(self.model.structure, sections)
        if self.support_motion is not None:
            raise ValueError(
                "limits have sections, but forces of bars are not found where supports move: leave "
                "sections out of HealthLimits, or support_motion"
            )
        if self.bar_length is not None:
            raise ValueError(
                "limits have sections, whose buckling is that of bars of constant length: leave "
                "sections out of HealthLimits, or bar_length"
            )

    def _check_bars(self) -> None:
        """Refuse driven bars under a controller that takes them for rigid, or commands them."""
        if self.controller is None or self.bar_length is None:
            return
        if not self._commands_bars:
            raise ValueError(
                "bar_length does not go with controller, which takes bars of constant length: "
                "leave one of the two out"
            )
        if changes_in_time(self.bar_length):
            raise ValueError(
                "bar_length changes in time, but the controller commands it: expected the lengths "
                "at the start, m, one per bar"
            )

    @property
    def drives_bars(self) -> bool:
        """Whether lengths of bars are given, or commanded."""
        return self.bar_length is not None or self._commands_bars

    @property
    def _commands_bars(self) -> bool:
        if self.controller is None:
            return False
        from tenscontrol.actuation.driven_strings import BAR_INPUTS

        return getattr(self.controller, "input", None) in BAR_INPUTS

    def _take_over_start(self, run: Trajectory) -> None:
        """Check the run to go on from, and take its faults and inputs where none are given."""
        put = object.__setattr__
        if self.nodes is not None or self.velocities is not None:
            raise ValueError("start gives nodes and velocities: leave those out")
        structure = self.structure
        if not same_members(run.structure, structure) or not np.array_equal(
            run.structure.bar_length, structure.bar_length
        ):
            raise ValueError(
                f"start is a run of {run.structure!r}, expected the bars, strings and supports "
                f"of the model's {structure!r}"
            )
        put(self, "faults", self.faults or run.faults)
        if self.bar_length is None and run.struts is not None:
            put(self, "bar_length", run.struts.length[:, -1])
        if self.controller is None and self.rest_length is None and self.force_density is None:
            put(self, "force_density" if run.rest_length is None else "rest_length", run.held)

    def _check_inputs(self) -> None:
        """Check what the actuators hold, and which strings and winches fail."""
        of_strings = ("rest_length", "force_density")
        is_known = self.input is None or (type(self.input) is str and self.input in of_strings)
        if not is_known:
            from tenscontrol.actuation.driven_strings import BAR_INPUTS

            validation.choice("input", self.input, (*of_strings, *BAR_INPUTS))
        if self.controller is None:
            self._check_open_loop()
        else:
            self._check_closed_loop()
        object.__setattr__(self, "faults", self._faults.listed)
        winches = None if self.law is None else len(self.law.commanded.strings)
        self._faults.refuse_unknown(len(self.model.structure.strings), winches)
        _ = self.inputs

    def _check_closed_loop(self) -> None:
        put = object.__setattr__
        if self.force_density is not None:
            raise ValueError("force_density is commanded by the controller; leave it out")
        kind = "force_density" if self.model.strings is None else "rest_length"
        if self._commands_bars:
            self._check_commanded_bars()
            return
        if self.input is not None:
            kind = validation.choice("input", self.input, ("rest_length", "force_density"))
        put(self, "input", kind)
        from tenscontrol.simulation.actuators import commands_parent

        assert self.law is not None  # there is a controller
        commands_parent(self.model, self.law)
        if self.rest_length is not None and kind == "rest_length":
            count, noun = len(self.law.commanded.strings), "string of the controller"
            lengths = validation.per_member("rest_length", self.rest_length, count, noun)
            put(self, "rest_length", validation.positive("rest_length", lengths, "length in m"))

    def _check_commanded_bars(self) -> None:
        """Check what strings hold under a controller of bars: as in its plant if not given."""
        from tenscontrol.control.controller import Controller
        from tenscontrol.simulation.actuators import commands_parent

        assert self.law is not None  # it commands bars
        if self.input not in (None, self.law.input, "rest_length"):
            raise ValueError(
                f"input is {self.input!r}, but the controller commands lengths of bars, where "
                "strings hold rest lengths: leave input out"
            )
        is_stuck = any(isinstance(fault, StuckWinch) for fault in self.faults or ())
        if is_stuck and self.law.input == "bar_length":
            raise ValueError("faults has a stuck winch, but the controller commands bars alone")
        held, count = self.rest_length, len(self.structure.strings)
        if held is None and self.start is not None:
            held = self.start.held
        elif held is None and isinstance(self.law, Controller):
            held = self.law.plant.rest_length
        lengths = validation.per_member("rest_length", held, count, "string")
        object.__setattr__(self, "input", "rest_length")
        put = validation.positive("rest_length", lengths, "length in m")
        object.__setattr__(self, "rest_length", put)
        commands_parent(self.model, self.law)

    def _check_open_loop(self) -> None:
        put = object.__setattr__
        rest_length, force_density = own_input(self.model, self.rest_length, self.force_density)
        put(self, "rest_length", rest_length)
        put(self, "force_density", force_density)
        if (self.rest_length is None) == (self.force_density is None):
            given = "neither" if self.rest_length is None else "both"
            raise ValueError(
                f"expected one of rest_length, force_density and controller; found {given} of the "
                "first two and no controller"
            )
        kind = "force_density" if self.rest_length is None else "rest_length"
        if self.input is not None and self.input != kind:
            raise ValueError(f"input is {self.input!r}, but {kind} is given and held")
        put(self, "input", kind)

    def _keep_arrays(self) -> None:
        """Hold arrays that nobody else can change."""
        if self.prestress is not None:
            gamma = validation.per_member(
                "prestress", self.prestress, len(self.structure.strings), "string"
            )
            gamma = validation.non_negative("prestress", gamma, "a string can only pull")
            object.__setattr__(self, "prestress", frozen(gamma))
        if self.start is None and self.support_motion is None:
            nodes = self.structure.nodes
            if self.nodes is None:
                object.__setattr__(self, "nodes", nodes)
            if self.velocities is None:
                object.__setattr__(self, "velocities", frozen(np.zeros_like(nodes)))
        values = vars(self)
        for name in _ARRAYS:
            value = values[name]
            if value is None or (isinstance(value, np.ndarray) and value.dtype == np.float64):
                continue  # kept when it was checked
            if not changes_in_time(value):
                array = np.asarray(validation.array_of(name, value), dtype=float)
                object.__setattr__(self, name, frozen(array))

    # ---- what follows from it ----

    @property
    def structure(self) -> Structure:
        """The structure of the model."""
        return self.model.structure

    @property
    def size(self) -> float:
        """Largest extent of the structure at the start along an axis, m."""
        nodes = self.structure.nodes if self.nodes is None else self.nodes  # None: of a start
        return float(np.ptp(nodes, axis=1).max())

    @cached_property
    def law(self) -> BaseController | None:
        """The controller as the loop takes it; None in open loop."""
        if self.controller is None:
            return None
        from tenscontrol.control.controller import BaseController
        from tenscontrol.control.function_controller import as_controller

        if isinstance(self.controller, BaseController):
            return self.controller
        return as_controller(self.controller, self.structure, self.input, self.sample_time)

    @cached_property
    def begin(self) -> float:
        """Time at which the motion begins, s."""
        return 0.0 if self.start is None else float(self.start.time[-1])

    @cached_property
    def span(self) -> tuple[float, float]:
        """Times at which the motion begins and ends, s; not for users."""
        begin = self.begin
        return begin, begin + self.duration

    @cached_property
    def _faults(self) -> Faults:
        return Faults(self.faults, self.model.structure.size, self.input)

    @cached_property
    def inputs(self) -> Pieces | None:
        """What is held in open loop, or changes; None under a controller."""
        if self.controller is not None:
            return None
        held = self.rest_length, self.force_density
        return checked_inputs(self.model.structure, *held, *self.span)

    @cached_property
    def loads(self) -> FloatArray | Pieces:
        """All that acts on the nodes from outside, N, shape (d, n), or in time."""
        return load_in_time(self.model, self.external_force, *self.span)

    @cached_property
    def supports(self) -> MovingSupports | None:
        """What moves with supports, None where they stand."""
        if self.support_motion is None:
            return None
        offset = support_offset(self.model, self.support_motion, *self.span)
        return None if offset is None else MovingSupports(self.model, offset)

    @cached_property
    def bars(self) -> DrivenBars | None:
        """Lengths of driven bars, None where bars are rigid."""
        if not self.drives_bars:
            return None
        if self.law is not None:
            from tenscontrol.actuation.driven_strings import member_rows

            given = self.structure.bar_length if self.bar_length is None else self.bar_length
            lengths = validation.per_member("bar_length", given, len(self.structure.bars), "bar")
            validation.positive("bar_length", lengths, "length in m")
            first = member_rows(self.law.input, self.law.commanded)[1].start
            driven = self.law.actuation.driven
            driven = driven[driven >= first] - first
            refuse_other_bar_lengths("the controller", self.structure, driven)
            return DrivenBars(Pieces.constant(lengths), driven, is_commanded=True)
        before = None if self.start is None else self.start.struts
        stretches = before is not None and bool(before.rate[:, -1].any())
        return driven_bars(self.structure, self.bar_length, *self.span, stretches)

    @cached_property
    def _length_rate(self) -> FloatArray:
        """At what rates driven bars stretch before the start, m/s."""
        assert self.bars is not None  # else it is not asked for
        if self.start is not None:  # in which any bar may have been driven
            return stretching(
                self.structure, self.start.nodes[:, :, -1], self.start.velocities[:, :, -1]
            )
        motion = (array[:, :, 0] for array in unpack_states(self.structure, self.state[:, None]))
        return self.bars.rates(self.structure, *motion)

    @cached_property
    def _beside(self) -> Start:
        return start_beside_supports(
            self.model, self.supports, self.begin, self.start, self.nodes, self.velocities
        )

    @cached_property
    def initial(self) -> tuple[FloatArray, str | None]:
        """The state at the start as integrators take it, and what was put right in it."""
        beside = self._beside
        if self.start is not None:
            assert beside.nodes is not None  # of the run
            assert beside.velocities is not None  # of the run
            lengths = self.structure.bar_length if self.bars is None else self.bars.at(self.begin)
            refuse_other_lengths("start", self.structure, beside.nodes, lengths)
            return frozen(pack_state(self.structure, beside.nodes, beside.velocities)), None
        inputs, motion = self.inputs, (beside.nodes, beside.velocities)
        first = None if inputs is None else lambda: inputs.at(np.zeros(1))[:, 0]
        state, note = initial_state(
            self.model, *motion, self.input, first, bars=self.bars, now=self.begin
        )
        return frozen(state), note

    @property
    def state(self) -> FloatArray:
        """The state at the start as integrators take it: x of the free nodes."""
        return self.initial[0]

    @cached_property
    def input_value(self) -> FloatArray:
        """What is held in open loop: rest lengths, m, or γ, N/m, shape (α,).

        Raises a ValueError if it changes, or a controller acts.
        """
        for name in ("controller", "rest_length", "force_density"):
            value = getattr(self, name)
            if value is not None and (name == "controller" or changes_in_time(value)):
                raise ValueError(f"{name} changes the input in time, expected one that is held")
        return frozen(held_value(self.structure, self.rest_length, self.force_density))

    @property
    def load(self) -> FloatArray:
        """Weights and external loads on the nodes, N, shape (d, n); ValueError if these change."""
        for name, changes in (
            ("external_force", isinstance(self.loads, Pieces)),
            ("support_motion", self.supports is not None),
        ):
            if changes:
                raise ValueError(f"{name} changes in time, expected a constant load")
        if self.bars is not None:
            raise ValueError("bars are driven, expected bars with the lengths of the structure")
        return np.asarray(self.loads)

    def equation(self, derivatives: bool = False) -> Equation:
        """Return the state equation under the inputs and constant loads of the scene.

        Parameters
        ----------
        derivatives : bool
            Whether a form with derivatives is needed, which compiled loops are not.

        Raises
        ------
        ValueError
            If loads or supports change in time, or bars are driven.
        """
        validation.truth("derivatives", derivatives, "whether derivatives are needed")
        load = self.load - self.model.constant_force
        equation = self.model.equation(self.input, load)
        if derivatives:
            return with_derivatives(equation, partial(self.model.equation, self.input, load))
        return equation

    @cached_property
    def given(self) -> Arguments:
        """Inputs, loads and motions of supports as they are given, by name.

        Rest lengths at the start of a closed loop are in its record.
        """
        names, values = _GIVEN if self.controller is None else _GIVEN[1:], vars(self)
        return Arguments({name: values[name] for name in names if values[name] is not None})

    def open_loop(self) -> Scene:
        """Return the scene without controller and faults: what is held at its start is held.

        The note of the scene says so.

        Returns
        -------
        Scene

        Raises
        ------
        ValueError
            If it is not known what the actuators hold at the start.
        """
        if self.controller is None and not self.faults:
            return self
        notes: list[str] = [self.note] if self.note else []
        held: dict[str, Any] = {}
        if self.controller is not None:
            held = {"rest_length": None, self.input: self._held_at_start()}
            words = {"rest_length": "rest lengths", "force_density": "force densities"}[self.input]
            notes.append(
                f"The controller of the scene is left out: {words} are held as at the start."
            )
        if self.faults:
            names = ", ".join(fault.label for fault in self.faults)
            notes.append(f"Its faults are left out: {names}.")
        parts: dict[str, Any] = dict.fromkeys(
            ("controller", "winches", "sample_time", "estimator", "sensors", "seed")
        )
        return replace(self, **parts, **held, faults=(), note=" ".join(notes))

    def _held_at_start(self) -> FloatArray:
        """Return what the actuators of a closed loop hold at the start, one per string."""
        if self._commands_bars:
            return np.asarray(self.rest_length)
        if self.input == "force_density":
            if self.prestress is None:
                raise ValueError("the scene holds no force_density at its start: give prestress")
            return np.asarray(self.prestress)
        if self.prestress is not None:
            from tenscontrol.actuation.rest_lengths import to_rest_length

            return to_rest_length(self.model, self.structure.nodes, self.prestress).rest_length
        if self.rest_length is None:
            raise ValueError(
                "the scene has no rest lengths at its start: give rest_length, or prestress"
            )
        lengths = np.asarray(self.rest_length)
        whole = len(lengths) != len(self.structure.strings)
        return to_segments(self.structure, "rest_length", lengths) if whole else lengths

    def linearize(self, input: str | None = None, coordinates: str = "internal") -> LinearPlant:
        """Return the linear plant about the shape of the structure, as :func:`linearize` does.

        Its inputs are those of the controller, where that commands this input.

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
        from tenscontrol.plant.linear_plant import PLANT_INPUTS
        from tenscontrol.plant.linearize import linearize
        from tenscontrol.statics.prestress import prestress

        try:
            rest = prestress(
                self.structure, self._design_force_density(),
                external_force=self.model.constant_force,
            )  # fmt: skip
        except ValueError as error:
            raise ValueError(
                f"the scene cannot be linearized, as it is not at rest: {error}"
            ) from error
        kind, law = self.input, self.law
        if input is not None:
            kind = validation.choice("input", input, PLANT_INPUTS)
        actuated = None
        if (
            law is not None
            and law.input == kind
            and len(law.commanded.strings) == len(self.structure.strings)
        ):
            actuated = law.actuation
        return linearize(self.model, rest, kind, coordinates, actuated=actuated)

    def _design_force_density(self) -> FloatArray:
        """Return the γ that the scene is linearized about."""
        if self.prestress is not None:
            return np.asarray(self.prestress)
        held = self._held_at_start() if self.controller is not None else self.input_value
        if self.input == "force_density" or self.model.strings is None:
            return held
        return self.model.strings.force_density(self.structure.string_length(), held)

    def simulate(self, progress: bool = False, start: Trajectory | None = None) -> Trajectory:
        """Return the motion.

        Parameters
        ----------
        progress : bool
            Whether to show a progress bar; never shown away from a terminal.
        start : Trajectory, optional
            A run of the scene to go on from, in place of its start: with the rest lengths or force
            densities at the end of that run. See :func:`simulate`.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            If the parts of a closed loop do not fit each other, or the run does not fit in memory.
        SimulationError
            If the motion runs away.
        """
        with interruptible() as interruption:
            scene = self
            if start is not None:
                scene = replace(
                    self, start=start, nodes=None, velocities=None, rest_length=None,
                    force_density=None,
                )  # fmt: skip
            return run_scene(scene, progress, interruption)

    @property
    def _degree(self) -> int:
        """Degree of the polynomials in time that the inputs of the strings are."""
        if self.inputs is not None:
            return self.inputs.degree
        if self.winches is None or self.input != "rest_length" or self._commands_bars:
            return 0
        return self.winches.degree

    def integrated(self, integration: Integration) -> Scene:
        """Return the same scene by another integration, without its checks once more.

        Parameters
        ----------
        integration : Integration

        Returns
        -------
        Scene
        """
        return changed(self, integration=integration)

    def plant_run(
        self,
        report: Callable[[float], None] | None = None,
        traces: bool = False,
        integration: Integration | None = None,
    ) -> PlantRun:
        """Return the plant side of a run, at its start.

        Parameters
        ----------
        report : callable, optional
            It is told the time reached, s.
        traces : bool
            Whether all steps are kept; see :attr:`Integrator.traces`.
        integration : Integration, optional
            Another one than that of the scene, for the same states kept.
        """
        output_step = self._output_step
        is_few = self.duration < _FEW_OUTPUTS * output_step
        kind = TracedRun if traces else PlantRun
        return kind(
            self.model,
            self.input,
            self.loads,
            self.duration,
            integration or self.integration,
            self._faults,
            degree=self._degree,
            supports=self.supports,
            support_rate=self._beside.support_rate,
            bars=self.bars,
            length_rate=None if self.bars is None else self._length_rate,
            now=self.begin,
            output_step=output_step,
            report=report,
            # To look for bars that cross where outputs are few.
            keeps_steps=is_few
            and self.law is None
            and self.integration.limits.crossings is not None,
        )

    @property
    def _output_step(self) -> float:
        """Time between states kept, after checking that they can be kept."""
        how, duration = self.integration, self.duration
        numbers = 2 * self.model.structure.nodes.size
        if how.output_step is None and how.step is None:
            return duration / min(_OUTPUTS, max(1, _NUMBERS // numbers))
        name = "step" if how.output_step is None else "output_step"
        value: float = getattr(how, name)
        if how.step is not None:
            validation.refuse_time(f"step is {how.step:g} s", duration / how.step, "steps", 1e-6)
        advice, size = ". A longer output_step keeps fewer", 8 * numbers
        validation.refuse_memory(f"{name} is {value:g} s", duration / value, "states", size, advice)
        return value

    @property
    def start_note(self) -> str | None:
        """What was put right at the start, and in which intervals functions are sampled."""
        note = self.initial[1]
        names = [name for name, value in self.given.raw.items() if callable(value)]
        if not names:
            return note
        missed = (
            f"{' and '.join(names)} sampled every {sampling_interval(*self.span):.2g} s: shorter "
            "pulses may be missed"
        )
        return f"{note}; {missed}" if note else missed

    def __repr__(self) -> str:
        parts = [self.name] if self.name else []
        parts += [f"{self.duration:g} s"]
        parts += [f"{self.input} held" if self.law is None else self.law.label]
        return f"Scene({', '.join(parts)}, {self.structure.nodes.shape[1]} nodes)"


# On what nothing depends that a scene keeps, and on what it does.
_BESIDE = "integration", "name", "note"
_FOUND_FROM = frozenset(entry.name for entry in fields(Scene)) - frozenset(_BESIDE)


def trace(scene: Scene, run: TracedRun) -> ClosedLoop | None:
    """Run a scene by a method that can be traced; return the loop, if it has one."""
    loop = None if scene.law is None else _loop(scene, scene.law, run)
    _integrate(scene, run, loop)
    run.end_part()
    return loop


def run_scene(scene: Scene, progress: bool, interruption: Interruption) -> Trajectory:
    """Return the motion of a scene; see :func:`simulate`. Warnings are those of the caller's."""
    how, stopped = scene.integration, None
    begin, end = scene.span
    with progress_bar(end, progress, start=begin) as report:
        run = scene.plant_run(report)
        loop = None if scene.law is None else _loop(scene, scene.law, run)
        try:
            _integrate(scene, run, loop)
        except StoppedError as stop:
            reason = f"stopped at {run.now:.6g} s of motion: {stop}"
            raise SimulationError(
                f"the simulation {reason}. The motion up to there is in the error's .trajectory",
                _trajectory(scene, run, loop, reason, report, interruption),
            ) from stop.__cause__
        except KeyboardInterrupt:
            if not run.spans or interruption.whole:
                raise
            stopped = f"stopped at {run.now:.6g} s of motion: interrupted"
    estimates = how.error == "estimate" and stopped is None
    with progress_bar(scene.duration, progress and estimates, "estimating error") as report:
        trajectory = _trajectory(scene, run, loop, stopped, report, interruption)
    if stopped is not None or interruption.signal is not None:
        outcome = stopped or "was interrupted at its end, and is complete"
        warn(f"the simulation {outcome}", InterruptionWarning)
    if stopped is None:
        check_health(trajectory, how.limits)
        problems = [] if trajectory.control is None else trajectory.control.problems
        if problems:
            from tenscontrol.control.command import ControlWarning

            warn(
                f"under {type(scene.controller).__name__} the run did not reach its goal: "
                f"{'; '.join(problems)}. run.control.summary() says more",
                ControlWarning,
            )
    return trajectory


def _loop(scene: Scene, law: BaseController, run: PlantRun) -> ClosedLoop:
    """Return the loop of the controller with a plant run."""
    from tenscontrol.simulation.closed_loop import ClosedLoop

    estimation = None
    if scene.estimator is not None:
        estimation = scene.estimator, scene.sensors, scene.seed
    return ClosedLoop(
        run, law, scene.sample_time, scene.rest_length, scene.winches, estimation, scene.start
    )


def _integrate(scene: Scene, run: PlantRun, loop: ClosedLoop | None) -> None:
    """Integrate a scene from its start to its end."""
    if scene.law is None or loop is None:
        assert scene.inputs is not None  # held in open loop
        run.run(scene.state, scene.inputs, scene.duration)
        return
    with scene.law.in_use, nullcontext() if scene.estimator is None else scene.estimator.in_use:
        loop.run(scene.state)


def _run_again(
    scene: Scene, run: PlantRun, loop: ClosedLoop | None, report: Callable[[float], None]
) -> Callable[[float], PlantRun] | None:
    """Return what does a run under a controller again with another step or tolerance, if it can."""
    closed = None if loop is None else loop.again()
    if closed is None:
        return None

    def again(value: float) -> PlantRun:
        how = changed(scene.integration, **{run.choice.setting: value})
        other = scene.plant_run(lambda time: report(time - scene.begin), integration=how)
        other.shortens = value < run.choice.value
        assert scene.law is not None  # it has a loop
        with scene.law.in_use, suppress(StoppedError):
            closed(other).run(scene.state)
        return other

    return again


def _trajectory(
    scene: Scene,
    run: PlantRun,
    loop: ClosedLoop | None,
    stopped: str | None,
    report: Callable[[float], None],
    interruption: Interruption,
) -> Trajectory:
    """Return the motion so far, with an estimate of its error if it was not stopped."""
    limits = scene.integration.limits
    with finishing(interruption):
        errors, record = None, None if loop is None else loop.record()
        done = None if run.bars is None else done_by_drives(run)
        if scene.integration.error == "estimate" and stopped is None:
            limit = limits.position_error or ERROR_LIMIT
            work = None if done is None else done[1]
            again = _run_again(scene, run, loop, report)
            errors = estimated_errors(run, limit, again, report, work)
        return assembled(
            run, record, errors, stopped, limits, given=scene.given, note=scene.start_note,
            scene=scene if scene.start is None else None, done=done,
        )  # fmt: skip
