"""Simulation of a model, open loop or under a controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil
from time import perf_counter

import casadi as ca
import numpy as np

from tenscontrol.actuation import Winches, WinchMove
from tenscontrol.control.controller import Command, Controller
from tenscontrol.dynamics import Model, StringLaw, pack_state
from tenscontrol.integrate import DOP853, RK4, IntegrationError, Integrator, Span
from tenscontrol.simulation.progress import progress_bar
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory, build_trajectory
from tenscontrol.structure import refuse_strings_without_length, refuse_wrong_bar_lengths
from tenscontrol.validation import (
    FloatArray,
    choice,
    frozen,
    instance,
    non_negative,
    per_member,
    positive,
    positive_number,
    shaped,
    truth,
)

METHODS = ("auto", "rk4", "dop853")

# States kept of an adaptive run, unless the user says otherwise.
_OUTPUTS = 1000

# More would not be over in a day, or not fit in memory.
_MOST_STEPS = 1e11
_MOST_NUMBERS = 5e8


class SimulationError(ArithmeticError):
    """A simulation that could not go on.

    Attributes
    ----------
    trajectory : Trajectory
        The motion up to the time of the failure.
    """

    def __init__(self, message: str, trajectory: Trajectory) -> None:
        super().__init__(message)
        self.trajectory = trajectory


def simulate(
    model: Model,
    duration: float,
    nodes: object = None,
    velocities: object = None,
    *,
    rest_length: object = None,
    force_density: object = None,
    controller: Controller | None = None,
    hold: str | None = None,
    winches: Winches | None = None,
    sample_time: float | None = None,
    external_force: object = None,
    method: str = "auto",
    tolerance: float = 1e-6,
    step: float | None = None,
    output_step: float | None = None,
    progress: bool = False,
) -> Trajectory:
    """Return the motion of a model.

    Give one of ``force_density`` (γ held), ``rest_length`` (rest length held)
    and ``controller``. Under a controller the actuators hold their value from
    sample to sample: real winches hold the rest length, so that γ moves with
    the structure between samples.

    Parameters
    ----------
    model : Model
    duration : float
        s.
    nodes, velocities : array_like, shape (3, n), optional
        Motion at the start, m and m/s; the reference shape at rest if not given.
        Bars must have their lengths, and must not be stretching.
    rest_length : float or array_like, shape (α,), optional
        Rest lengths, m. With a controller: where the winches stand at the start.
    force_density : float or array_like, shape (α,), optional
        γ, N/m.
    controller : Controller, optional
        For example ``lqr(...)`` or ``MPC(...)``. It is reset first.
    hold : {"rest_length", "force_density"}, optional
        What the actuators hold between samples. The rest length if the model
        has a string law, else γ.
    winches : Winches, optional
        Limits of the winches; none if not given.
    sample_time : float, optional
        For a controller without a sample time of its own, s; else ``step``.
    external_force : array_like, shape (3, n), optional
        Constant load W, N, for a model built with ``external_force=True``.
    method : {"auto", "rk4", "dop853"}
        ``"auto"`` is ``"rk4"`` where ``step`` is given, else ``"dop853"``.
    tolerance : float
        Error allowed a step of ``"dop853"``, relative, and absolute in m and m/s.
    step : float, optional
        Step of ``"rk4"``, s.
    output_step : float, optional
        Time between returned states, s. Every step of ``"rk4"``, or a
        thousandth of the duration, if not given.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    Trajectory

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name.
    SimulationError
        If the motion runs away; it carries the motion up to there.

    Examples
    --------
    A prism let go with too little force in its vertical strings:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> start = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    >>> run = tc.simulate(model, 1.0, rest_length=start, step=1e-3)
    >>> run.nodes.shape, run.nodes[2, 0, -1].round(3)
    ((3, 6, 1001), np.float64(1.076))
    """
    instance("model", model, Model, "make one by Model(structure)")
    duration = positive_number("duration", duration, "s")
    tolerance = positive_number("tolerance", tolerance, "m and m/s")
    truth("progress", progress, "whether to show a progress bar")
    if controller is not None:
        instance("controller", controller, Controller, "make one by lqr(...) or MPC(...)")
    loop = _Loop(
        model,
        hold=_held(model, rest_length, force_density, controller, hold),
        load=_checked_load(model, external_force),
        method=method,
        tolerance=tolerance,
        step=step,
    )
    loop.output_step = _output_step(loop, output_step, duration)
    state = _initial_state(model, nodes, velocities, loop.hold)
    with progress_bar(duration, shown=progress) as report:
        if controller is None:
            if winches is not None or sample_time is not None:
                raise ValueError("winches and sample_time go with a controller")
            value = _held_value(model, rest_length, force_density)
            loop.run(state, value, duration, report)
            return loop.trajectory(None)
        return _closed_loop(
            loop, state, duration, controller, rest_length, winches, sample_time, report
        )


@dataclass(eq=False)
class _Loop:
    """The plant side of a simulation: integrates span by span and keeps what comes."""

    model: Model
    hold: str
    load: FloatArray | None
    method: str
    tolerance: float
    step: float | None
    output_step: float = 0.0
    time: list[FloatArray] = field(default_factory=list)
    states: list[FloatArray] = field(default_factory=list)
    inputs: list[FloatArray] = field(default_factory=list)
    steps: int = 0
    evaluations: int = 0
    now: float = 0.0

    def __post_init__(self) -> None:
        choice("method", self.method, METHODS)
        if self.method == "auto":
            self.method = "dop853" if self.step is None else "rk4"
        if self.method == "rk4" and self.step is None:
            raise ValueError("method 'rk4' needs a step, s; for example step=1e-3")
        if self.method == "dop853" and self.step is not None:
            raise ValueError(
                "step goes with method 'rk4'; 'dop853' chooses its own steps by tolerance"
            )
        equation = self.model.state_equation(self.hold)
        if self.load is not None:
            x, u = (ca.SX.sym(name, equation.size1_in(i)) for i, name in enumerate("xu"))
            equation = ca.Function("loaded", [x, u], [equation(x, u, ca.DM(self.load))])
        self.integrator: Integrator
        if self.method == "rk4":
            assert self.step is not None  # checked above
            self.integrator = RK4(equation, self.step)
        else:
            self.integrator = DOP853(equation, self.tolerance)

    def run(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        report: Callable[[float], None],
        record: Callable[[], ControlRecord | None] = lambda: None,
    ) -> FloatArray:
        """Integrate one span with the input held and return the state at its end."""
        if not self.time:
            self._keep(np.zeros(1), state[:, None], held)
        outputs = max(1, ceil(duration / self.output_step - 1e-9))
        start = self.now
        try:
            span = self.integrator.advance(
                state, held, duration, outputs, lambda time: report(start + time)
            )
        except IntegrationError as error:
            self._add(error.span, held, duration, outputs)
            raise SimulationError(
                f"the simulation stopped at {start + error.time:.6g} s of motion: {error}. "
                "The motion up to there is in the error's .trajectory",
                self.trajectory(record()),
            ) from error
        self._add(span, held, duration, outputs)
        self.now = start + duration
        return span.states[:, -1]

    def _add(self, span: Span, held: FloatArray, duration: float, outputs: int) -> None:
        reached = span.states.shape[1]
        times = self.now + duration * np.arange(1, reached + 1) / outputs
        self._keep(times, span.states, held)
        self.steps += span.steps
        self.evaluations += span.evaluations

    def _keep(self, time: FloatArray, states: FloatArray, held: FloatArray) -> None:
        self.time.append(time)
        self.states.append(states)
        self.inputs.append(np.tile(held[:, None], (1, len(time))))

    def trajectory(self, control: ControlRecord | None) -> Trajectory:
        """Return what came so far."""
        return build_trajectory(
            self.model,
            self.load,
            self.hold,
            np.concatenate(self.time),
            np.hstack(self.states),
            np.hstack(self.inputs),
            self.method,
            self.step,
            (self.steps, self.evaluations),
            control,
        )


def _closed_loop(
    loop: _Loop,
    state: FloatArray,
    duration: float,
    controller: Controller,
    rest_length: object,
    winches: Winches | None,
    sample_time: float | None,
    report: Callable[[float], None],
) -> Trajectory:
    sample = _sample_time(controller, sample_time, loop.step)
    actuators = _Actuators(loop, controller, winches, rest_length, sample)
    controller.reset()
    log = _Log(loop.hold)
    n = loop.model.structure.nodes.shape[1]
    # The allowance keeps round-off from adding a last sample of no length.
    for k in range(ceil(duration / sample - 1e-9)):
        loop.now = k * sample
        N, V = (part.reshape(3, n, order="F") for part in np.split(state, 2))
        began = perf_counter()
        command = controller.command(loop.now, N, V)
        taken = perf_counter() - began
        move = actuators.apply(command, N)
        log.add(loop.now, command, move, taken)
        span = min(sample, duration - loop.now)
        state = loop.run(state, move.rest_length, span, report, lambda: log.record(sample))
    return loop.trajectory(log.record(sample))


class _Actuators:
    """Turn commands into what is held: γ as it is, or rest lengths through the winches."""

    def __init__(
        self,
        loop: _Loop,
        controller: Controller,
        winches: Winches | None,
        rest_length: object,
        sample: float,
    ) -> None:
        structure = loop.model.structure
        if len(controller.plant.model.structure.strings) != len(structure.strings):
            raise ValueError(
                f"the controller commands {len(controller.plant.model.structure.strings)} strings, "
                f"but the model has {len(structure.strings)}"
            )
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
        self._convert = loop.hold == "rest_length" and controller.input == "force_density"
        if controller.input == "rest_length" and loop.hold == "force_density":
            raise ValueError(
                "the controller commands rest lengths; hold='force_density' cannot follow it"
            )
        if loop.hold == "force_density" and (winches is not None or rest_length is not None):
            raise ValueError("winches and rest_length have no meaning where γ is held")
        self._structure = structure
        self._input = controller.input
        self._law = loop.model.strings
        self._winches = winches
        self._sample = sample
        self._current: FloatArray | None = None
        if rest_length is not None:
            self._current = _checked_rest_length(loop.model, rest_length)
        elif winches is not None and winches.rate is not None:
            raise ValueError(
                "winches with a rate need rest_length: where they stand at the start, m; "
                "to_rest_length(model, nodes, force_density) finds it"
            )
        if self._convert:
            _refuse_unreachable(controller, loop.model)

    def _checked(self, value: object) -> FloatArray:
        """Return a command, or raise: a controller from elsewhere may promise what it does not."""
        count = len(self._structure.strings)
        wanted = shaped("command.value", value, (count,), "one per string")
        if self._input == "force_density":
            return non_negative("command.value", wanted, "a string can only pull")
        return positive("command.value", wanted, "rest length in m")

    def apply(self, command: Command, nodes: FloatArray) -> WinchMove:
        wanted = self._checked(command.value)
        if self._convert:
            length = np.linalg.norm(self._structure.string_vectors(nodes), axis=0)
            assert isinstance(self._law, StringLaw)  # a rest length is held
            wanted = self._law.rest_length(length, wanted)
        if self._winches is None:
            none = np.zeros(0, dtype=np.int64)
            move = WinchMove(frozen(wanted), none, none)
        else:
            start = wanted if self._current is None else self._current
            move = self._winches.move(start, wanted, self._sample)
        self._current = move.rest_length
        return move


class _Log:
    """Collects what becomes the control record."""

    def __init__(self, hold: str) -> None:
        self._hold = hold
        self._rows: list[tuple[float, Command, WinchMove, float]] = []

    def add(self, time: float, command: Command, move: WinchMove, taken: float) -> None:
        self._rows.append((time, command, move, taken))

    def record(self, sample: float) -> ControlRecord:
        times, commands, moves, taken = zip(*self._rows, strict=True)
        applied = np.column_stack([move.rest_length for move in moves])
        rate = np.zeros_like(applied)
        if self._hold == "rest_length":
            rate[:, 1:] = np.diff(applied, axis=1) / sample
        return ControlRecord(
            time=frozen(np.array(times)),
            command=frozen(np.column_stack([command.value for command in commands])),
            applied=frozen(applied),
            status=tuple(command.status for command in commands),
            winch_rate=frozen(rate),
            rate_limited=frozen(np.array([len(move.rate_limited) for move in moves])),
            range_limited=frozen(np.array([len(move.range_limited) for move in moves])),
            computing_time=frozen(np.array(taken)),
        )


def _held(
    model: Model,
    rest_length: object,
    force_density: object,
    controller: Controller | None,
    hold: str | None,
) -> str:
    """Return what is held, after checking that the arguments say so without contradiction."""
    if controller is not None:
        if force_density is not None:
            raise ValueError("force_density is commanded by the controller; leave it out")
        if hold is None:
            return "force_density" if model.strings is None else "rest_length"
        return choice("hold", hold, ("rest_length", "force_density"))
    if hold is not None:
        raise ValueError("hold goes with a controller; in open loop the given input is held")
    if (rest_length is None) == (force_density is None):
        found = "neither" if rest_length is None else "both"
        raise ValueError(
            f"expected one of rest_length, force_density and controller; found {found} of the "
            "first two and no controller"
        )
    return "force_density" if rest_length is None else "rest_length"


def _held_value(model: Model, rest_length: object, force_density: object) -> FloatArray:
    if force_density is None:
        return _checked_rest_length(model, rest_length)
    gamma = per_member("force_density", force_density, len(model.structure.strings), "string")
    return non_negative("force_density", gamma, "a string can only pull")


def _checked_rest_length(model: Model, rest_length: object) -> FloatArray:
    values = per_member("rest_length", rest_length, len(model.structure.strings), "string")
    return positive("rest_length", values, "length in m")


def _checked_load(model: Model, external_force: object) -> FloatArray | None:
    if not model.has_external_force:
        if external_force is not None:
            raise ValueError(
                "the model takes no load; build it as Model(structure, external_force=True)"
            )
        return None
    shape = model.structure.nodes.shape
    if external_force is None:
        raise ValueError("the model takes a load: give external_force, shape (3, n), N")
    return shaped("external_force", external_force, shape, "one force per node")


def _initial_state(model: Model, nodes: object, velocities: object, hold: str) -> FloatArray:
    structure = model.structure
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    V = np.zeros_like(N)
    if velocities is not None:
        V = structure.checked_nodes("velocities", velocities)
    refuse_wrong_bar_lengths("nodes", structure, N)
    if hold == "rest_length":
        refuse_strings_without_length("nodes", structure, N)
    bars, rates = structure.bar_vectors(N), structure.bar_vectors(V)
    stretching = np.abs((bars * rates).sum(axis=0)) / structure.bar_length
    allowed = 1e-8 * max(float(np.abs(V).max()), 1e-300)
    if stretching.size and stretching.max() > allowed:
        worst = int(stretching.argmax())
        raise ValueError(
            f"velocities stretch bar {worst} at {stretching[worst]:.3g} m/s, expected 0: bars "
            "are rigid. plant.to_velocities(q, rates) gives velocities that bars can have"
        )
    return pack_state(N, V)


def _output_step(loop: _Loop, output_step: float | None, duration: float) -> float:
    """Return the time between states kept, after checking that they can be kept."""
    if output_step is not None:
        name, value = "output_step", positive_number("output_step", output_step, "s")
    elif loop.step is not None:
        name, value = "step", loop.step
    else:
        return duration / _OUTPUTS
    if loop.step is not None and duration / loop.step > _MOST_STEPS:
        raise ValueError(
            f"step is {loop.step:g} s, expected at least {duration / _MOST_STEPS:.1e} s: "
            f"{duration:g} s would take {duration / loop.step:.1e} steps"
        )
    size = 6 * loop.model.structure.nodes.shape[1]
    if size * duration / value > _MOST_NUMBERS:
        raise ValueError(
            f"{name} is {value:g} s, expected at least {size * duration / _MOST_NUMBERS:.1e} s: "
            f"{duration / value:.1e} states of {size} numbers would be kept. "
            "A longer output_step keeps fewer"
        )
    return value


def _sample_time(controller: Controller, sample_time: float | None, step: float | None) -> float:
    if controller.step is not None:
        if sample_time is not None:
            raise ValueError(
                f"the controller has a sample time of its own, {controller.step:g} s; "
                "leave sample_time out"
            )
        return controller.step
    if sample_time is not None:
        return positive_number("sample_time", sample_time, "s")
    if step is None:
        raise ValueError(
            "the controller acts in continuous time: give sample_time, or a step to sample at"
        )
    return step


def _refuse_unreachable(controller: Controller, model: Model) -> None:
    """Refuse a controller that may command a γ which no rest length gives."""
    law = model.strings
    assert law is not None  # a rest length is held
    largest, limit = controller.bounds[1], law.largest_force_density
    over = np.flatnonzero(largest >= limit)
    if len(over):
        i = over[0]
        raise ValueError(
            f"the controller may command γ = {largest[i]:g} N/m on string {i}, but a string of "
            f"stiffness {limit[i]:g} N/m stays below that whatever its rest length. Give the "
            f"controller max_force_density below {limit[i]:g}"
        )
