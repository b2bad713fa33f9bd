"""Actuators of a closed loop: they turn commands into force densities or rest lengths."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    bounds_of_inputs,
    changes_of_inputs,
    forces_on_inputs,
    inputs_of,
    moved_by,
    polynomials_of,
    refuse_passive,
    strings_of,
    sums_by_input,
    through,
)
from tenscontrol.actuation.motor_record import (
    Instants,
    MotorRecord,
    cable_work,
    motor_record,
    winding_work,
)
from tenscontrol.actuation.motors import Motor, each_motor
from tenscontrol.actuation.winch_motion import Drive, Instant
from tenscontrol.actuation.winches import Winches, WinchMove
from tenscontrol.arrays import BoolArray, FloatArray, IntArray, frozen
from tenscontrol.control.command import Command
from tenscontrol.control.controller import BaseController, Controller
from tenscontrol.dynamics.evaluator import Evaluator, evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces
from tenscontrol.plant.input_bounds import refuse_still
from tenscontrol.properties import cached_property
from tenscontrol.simulation.dense_motion import DenseMotion
from tenscontrol.simulation.faults import StuckWinch
from tenscontrol.simulation.plant_run import PlantRun
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.segments import to_segments, to_strings
from tenscontrol.structure.structure import same_members

_NONE = frozen(np.zeros(0, dtype=np.int64))


class TakenTick(NamedTuple):
    """A tick of a run that was traced, as winches took it."""

    time: float  # at its beginning, s
    number: int  # of the sample, counted from 1
    begin: Instant
    within: FloatArray  # the command, within the range
    stuck: BoolArray
    motion: FloatArray  # positions, then velocities, of all nodes


# Of winches: force and its slope, see ``Pull``.
_Forces = tuple[FloatArray, FloatArray]

# Of motors that move rest lengths.
_DYNAMIC = ("inertia", "lag", "backlash")


class Actuators:
    """Apply commands: γ as it is, or rest lengths through the winches.

    A controller commands the strings of the plant, or those of its parent, whose segments then
    move together. ``start`` are the rest lengths at the start, m, shape (α,), if they are known;
    ``reached`` is what the last sample led to, and ``held`` that of the plant's strings.
    ``actuation`` says which strings are driven, where passive ones keep what they had at the start;
    ``winches`` are those of the inputs, and ``sample_time`` is that between commands, s.
    """

    reached: FloatArray
    held: FloatArray
    lengths: Pieces | None = None  # of bars, which these do not drive

    def __init__(
        self,
        plant_run: PlantRun,
        controller: BaseController,
        winches: Winches | None,
        rest_length: FloatArray | None,
        sample_time: float,
        run: Trajectory | None,
    ) -> None:
        self._structure = plant_run.model.structure
        self._by_segment = commands_parent(plant_run.model, controller)
        self._count = len(controller.commanded.strings)
        self.actuation = controller.actuation
        self._plant_run, self._held = plant_run, plant_run.input
        self._convert = plant_run.input == "rest_length" and controller.input == "force_density"
        if controller.input == "rest_length" and plant_run.input == "force_density":
            raise ValueError(
                "the controller commands rest lengths; input='force_density' cannot follow it"
            )
        self._check_driven(winches)
        self._motor = None
        if winches is not None and winches.motor is not None:
            self._motor = each_motor(self._of_leads(winches.motor), len(self.actuation.lead))
        if plant_run.input == "force_density":
            self._refuse_lengths(winches, rest_length)
        self._input = controller.input
        self._law = plant_run.model.strings
        self.winches = winches
        self.sample_time = sample_time
        self._drive: Drive | None = None
        self._moves: list[tuple[FloatArray, IntArray]] = []  # of each sample: wanted, and stuck
        self._begins: list[float] = []
        self._asked: list[FloatArray] = []
        self._weak: list[int] = []
        self._earlier: MotorRecord | None = None
        self.taken: list[TakenTick] = []  # of a run that is traced
        self.start: FloatArray | None = None
        self._current: FloatArray | None = None
        if run is not None and rest_length is None:
            self._go_on(run)
        elif rest_length is not None:
            self.start = self._current = rest_length
        if self.start is not None:
            # Passive strings keep what they have, whatever the plant of the controller says.
            self.actuation = through(self.actuation, self.start)
            if winches is not None:
                driven = self.actuation.driven
                winches.refuse_out_of_range("rest_length", self.start, driven)
        elif plant_run.input == "rest_length" and (
            winches is not None and (winches.rate is not None or winches.ramp or winches.motor)
        ):
            raise ValueError(
                "winches with a rate, substeps or a motor need rest_length, the rest lengths at "
                "the start, m; to_rest_length(model, nodes, force_density) finds it"
            )
        if winches is not None and plant_run.input == "rest_length":
            self.winches = self._of_inputs(winches, controller)
        if self._convert:
            self._refuse_unreachable(controller.bounds[1])

    def _check_driven(self, winches: Winches | None) -> None:
        """Refuse what cannot be done with passive or ganged strings."""
        if self.actuation.is_whole:
            return
        if self._convert:
            raise ValueError(
                f"the controller commands γ of a plant with {self.actuation!r}, but rest lengths "
                "are held, so that passive strings would not keep their γ: give "
                "input='force_density', or design it on linearize(..., input='rest_length')"
            )
        motors = winches is not None and winches.motor is not None
        if motors and self._held == "force_density":
            raise ValueError(
                "winches has a motor, but the plant of the controller has passive or ganged "
                "strings, of which motors know no limits where γ is held: leave the motor out, or "
                "hold rest lengths"
            )
        refuse_stuck_passive(self.actuation, self._plant_run)

    def _of_inputs(self, winches: Winches, controller: BaseController) -> Winches:
        """Return winches with the limits of the inputs in place of those of the strings."""
        if isinstance(controller, Controller):
            refuse_still(self.actuation, winches, self._count)
        motor = None if winches.motor is None else self._of_leads(winches.motor)
        return winches_of_inputs(winches, self.actuation, motor)

    def _of_leads(self, motor: Motor) -> Motor:
        """Return the motors of the inputs, of those of all strings."""
        each_motor(motor, self._count)  # or they do not fit
        if self.actuation.is_whole:
            return motor
        lead = self.actuation.lead
        per_string = {name: value for name, value in vars(motor).items() if np.ndim(value)}
        given = {name: value[lead] for name, value in per_string.items()}
        if motor.zero is not None:  # a rest length of the lead: the input by its ratio
            given["zero"] = given.get("zero", motor.zero) / self.actuation.ratio[lead]
        return replace(motor, **given)

    def _go_on(self, run: Trajectory) -> None:
        """Begin with what the actuators held at the end of a run."""
        kind = "force_density" if run.rest_length is None else "rest_length"
        if kind != self._held:
            return
        if run.control is None:
            self._current = self._to_strings(kind, run.held)
        else:
            self._current, self._earlier = run.control.applied[:, -1], run.control.motors
        if kind == "rest_length":  # the controller may command other strings than that of the run
            where = "string of the controller"
            self.start = self._current = validation.per_member(
                "rest_length", self._current, self._count, where
            )

    @property
    def known(self) -> bool:
        """Whether it is known what they hold: from the start of the run, or from a command."""
        return self._current is not None

    def applied_input(self, nodes: FloatArray) -> FloatArray:
        """Return what the actuators hold in a shape, in the unit of the commands."""
        assert self._current is not None  # callers have commanded, or know the start
        if not self._convert:
            return self._current
        assert self._law is not None  # a rest length is held
        rest_length = self._to_plant("rest_length", self._current)
        gamma = self._law.force_density(self._structure.string_length(nodes), rest_length)
        return self._to_strings("force_density", gamma)

    @property
    def ticks(self) -> int:
        """Parts of a sample, in each of which inputs are one polynomial in time."""
        return 1 if self.winches is None else self.winches.ticks

    def begin(self, command: Command, nodes: FloatArray, stuck: IntArray) -> WinchMove:
        """Take the command of a sample, and return the move to expect, one entry a winch."""
        desired = self._checked(command.value)
        if self._held == "force_density":
            desired, weak = self._unless_stuck(desired, stuck), _NONE
            if self._motor is not None:
                most = self._motor.most_tension
                length = self._structure.string_length(nodes)
                weak = np.flatnonzero(desired * length > most)
                desired = desired.copy()
                desired[weak] = most[weak] / length[weak]
            self._weak.append(len(weak))
            return self._set(desired, weak)
        if self._convert:
            assert self._law is not None  # a rest length is held
            gamma = self._to_plant("force_density", desired)
            desired = self._law.rest_length(self._structure.string_length(nodes), gamma)
            desired = self._to_strings("rest_length", desired)
        if self._motor is not None:
            self._asked.append(inputs_of(self.actuation, desired))
        desired = self._unless_stuck(desired, stuck)
        if self.winches is None:
            return self._set(desired, _NONE)
        stuck = stuck_inputs(self.actuation, stuck)
        inputs = partial(inputs_of, self.actuation)
        if self._drive is None:
            motion = None if self._earlier is None else self._earlier.at_end
            start = inputs(desired if self._current is None else self._current)
            self._new_drive = partial(
                Drive, rest_length=start, sample_time=self.sample_time, motion=motion
            )
            self._drive = self._new_drive(self.winches)
        self._weak.append(0)
        self._moves.append((inputs(desired), stuck))
        return of_all_members(self.actuation, self._drive.begin(inputs(desired), stuck))

    def _set(self, value: FloatArray, weak: IntArray) -> WinchMove:
        """Hold a value at once, and return the move."""
        self._current = value
        self._at_once = WinchMove(frozen(value), _NONE, _NONE, frozen(weak))
        return self._at_once

    def tick(self, number: int, state: FloatArray, now: float) -> FloatArray | Pieces:
        """Return the input of the plant's strings in a tick, counted from 1, that begins now, s."""
        if self._drive is None:
            assert self._current is not None  # begun
            self.reached = self._current
            self.held = self._to_plant(self._held, self._current)
            return self.held

        if number == 1:
            self._begins.append(now)
        known: list[FloatArray] = []  # motion of all nodes, where it is asked for

        def motion() -> FloatArray:
            if not known:
                columns = [nodes.ravel(order="F") for nodes in self._plant_run.motion(state)]
                known.append(np.concatenate(columns))
            return known[0]

        def pull(rest_length: FloatArray, later: float) -> _Forces:
            return self.pulls(moved_on(motion(), later), rest_length)

        if self._plant_run.traces:
            drive = self._drive
            self.taken.append(
                TakenTick(now, number, drive.now, drive.within, drive.stuck, motion())
            )
        tick = self._drive.tick(number, now, pull)
        self._current = self.reached = strings_of(self.actuation, self._drive.rest_length)
        self.held = self._to_plant("rest_length", self.reached)
        lengths = polynomials_of(self.actuation, tick.rest_length)
        lengths = self._to_plant("rest_length", lengths.T).T
        if lengths.shape[1] == 1:
            return lengths[:, 0]
        return Pieces(np.array([-np.inf]), np.array([now]), lengths[None])

    def pulls(self, motion: FloatArray, inputs: FloatArray) -> _Forces:
        """Return the force at each winch and its slope, see ``Pull``, in one motion or in columns.

        Of positions and velocities of all nodes, and rest lengths that winches have wound, m.
        """
        act, lengths = self.actuation, self.wound(inputs)
        given = motion, lengths, np.zeros_like(lengths)
        if motion.ndim == 1:
            _, force, _, slope = self._winding(*given)
        else:
            _, force, _, slope = evaluate_columns(self._winding_function, *given)
        share = self._to_plant("rest_length", np.ones(self._count))
        tension = self._to_strings("tension", force.T.copy()).T  # the next call overwrites them
        stiffness = self._to_strings("length", slope.T * share**2).T
        if act.is_whole:
            return tension, stiffness
        by_strings = (act.ratio**2 * stiffness.T).T
        return forces_on_inputs(act, tension), sums_by_input(act, by_strings)

    def wound(self, inputs: FloatArray) -> FloatArray:
        """Return rest lengths of the plant's strings, m, where winches have wound these, (m, K)."""
        return self._to_plant("rest_length", strings_of(self.actuation, inputs).T).T

    @cached_property
    def winds(self) -> FloatArray:
        """Derivative of the rest lengths of the plant's strings by those of winches, (α′, m)."""
        units = moved_by(self.actuation, np.eye(len(self.actuation.lead)))
        return self._to_plant("rest_length", units).T

    @cached_property
    def feels(self) -> FloatArray:
        """Derivative of the forces at winches by the tensions of the plant's strings, (m, α′)."""
        units = np.eye(len(self._plant_run.model.structure.strings))
        return forces_on_inputs(self.actuation, self._to_strings("tension", units).T)

    def end(self) -> WinchMove:
        """Return the move of the sample, with the limits that were met."""
        if self._drive is None:
            return self._at_once
        move = self._drive.end()
        self._weak[-1] = len(move.torque_limited)
        return of_all_members(self.actuation, move)

    @property
    def _winding_function(self) -> ca.Function:
        return self._plant_run.model.of_all_nodes("winding")

    @cached_property
    def _winding(self) -> Evaluator:
        return Evaluator(self._winding_function)

    def _checked(self, value: object) -> FloatArray:
        """Return a command, or raise: a user's controller may break its promises."""
        desired = validation.shaped("command.value", value, (self._count,), "one per string")
        if not self.actuation.is_whole:  # passive strings keep what they have
            desired = strings_of(self.actuation, inputs_of(self.actuation, desired))
        if self._input == "force_density":
            return validation.non_negative("command.value", desired, "a string can only pull")
        return validation.positive("command.value", desired, "rest length in m")

    def _to_plant(self, name: str, values: FloatArray) -> FloatArray:
        """Return values of the plant's strings from those of the commanded ones."""
        return to_segments(self._structure, name, values) if self._by_segment else values

    def _to_strings(self, name: str, values: FloatArray) -> FloatArray:
        """Return values of the commanded strings from those of the plant's."""
        return to_strings(self._structure, name, values) if self._by_segment else values

    def _unless_stuck(self, desired: FloatArray, stuck: IntArray) -> FloatArray:
        """Return the desired input, but the current one of stuck actuators."""
        if not len(stuck):
            return desired
        if self._current is None:
            how = "give rest_length, or" if self._held == "rest_length" else "give"
            raise ValueError(
                f"faults has winch {stuck[0]} stuck from the start, but the value that it "
                f"holds is not known then: {how} a time after the first sample"
            )
        moved = inputs_of(self.actuation, desired).copy()
        held = stuck_inputs(self.actuation, stuck)
        moved[held] = inputs_of(self.actuation, self._current)[held]
        return strings_of(self.actuation, moved)

    def motor_record(self) -> MotorRecord | None:
        """Return what the motors did up to now; None where there are none."""
        if self._motor is None:
            return None
        model, error, close = self._plant_run.model, 0.0, 1e-6 * self.sample_time / self.ticks
        segments = DenseMotion.of_run(self._plant_run)
        count = len(segments.of)
        first, every = np.flatnonzero(np.diff(segments.of, prepend=-1)), np.arange(count)

        def motion(s: FloatArray, k: IntArray) -> Instants:
            time, nodes = segments.at(s, k)
            return Instants(time, nodes, segments.string_inputs(time, k))

        ends = motion(np.zeros(count), every), motion(np.ones(count), every)
        before = ends[0]
        if self._drive is None:
            turning, work = cable_work(model, ends)
            start, at_end = turning[0].position[:, 0], np.zeros((3, self._count))
        else:
            stored, forces, work, error = winding_work(model, ends, motion)
            # A jump of rest lengths at the standing structure gives what strings store more.
            previous = np.column_stack([stored[0][:, 0], stored[1][:, first[1:] - 1]])
            if self.start is not None:
                lengths = self._to_plant("rest_length", self.start)
                lengths = self._plant_run.faults.without_cut(lengths, before.time[0] + close)
                previous[:, 0] = self._winding(before.states[:, 0], lengths, 0 * lengths)[0]
            jump = stored[0][:, first] - previous
            for j, time in enumerate(before.time[first]):
                cut = self._plant_run.faults.without_cut(np.zeros(len(jump)), time + close) != 0
                jump[cut, j] = 0.0
            work[:, first] += jump
            act = self.actuation
            work = sums_by_input(act, self._to_strings("length", work.T).T)
            tensions = [self._to_strings("tension", force.T).T for force in forces]
            forces = [forces_on_inputs(act, tension) for tension in tensions]
            turning = [
                self._drive.turning(before.time, at.time, force)
                for at, force in zip(ends, forces, strict=True)
            ]
            start = turning[0].position[:, 0]
            if self.start is not None:
                start = inputs_of(self.actuation, self.start)
            drive = self._drive
            at_end = np.stack([drive.position, drive.now.speed, drive.reference])
        if self._earlier is not None:
            start = self._earlier.zero
        return motor_record(
            self._motor, start, ends, turning, work, error, self._asked, self._weak, at_end,
            self._rest_length_error(segments),
        )  # fmt: skip

    @property
    def follows_motion(self) -> bool:
        """Whether what a motor winds depends on the motion: by inertia, or a torque that it met."""
        return self._motor is not None and bool(self._motor.inertia.any() or any(self._weak))

    def _rest_length_error(self, segments: DenseMotion) -> float:
        """Estimate the error of rest lengths, m, that follows from few parts of a sample.

        The motors are followed again along the motion that there was, in parts of half the length.
        Errors fall in proportion to that at worst: the estimate is twice the largest difference.
        """
        drive = self._drive
        if drive is None or drive.ticks == 1 or len(segments.ends) == 1:
            return 0.0
        assert self._motor is not None  # asked for by the record of the motors
        assert self.winches is not None  # of the drive
        finer, end = self._new_drive(self.winches, finer=2), segments.ends[-1]
        reached, times = list[FloatArray](), list[float]()
        tick, limited = self.sample_time / finer.ticks, np.isfinite(self._motor.torque).any()

        def pull(ends: list[FloatArray], rest_length: FloatArray, later: float) -> _Forces:
            return self.pulls(ends[later > 0], rest_length)

        # The last sample may have been interrupted before it began to move.
        for begin, move in zip(self._begins, self._moves, strict=False):
            finer.begin(*move)
            instants = begin + tick * np.arange(finer.ticks + 1)
            instants = instants[instants < end + tick / 2]
            # Forces are asked for under limits of torque only.
            motion = list(segments.at_times(instants).T) if limited else []
            for i, (now, then) in enumerate(pairwise(instants)):
                finer.tick(i + 1, now, partial(pull, motion[i : i + 2]))
                reached.append(finer.rest_length)
                times.append(then)
        if not times:
            return 0.0
        difference = np.abs(drive.rest_lengths(np.array(times)) - np.column_stack(reached))
        return 2.0 * float(difference.max())

    def _refuse_lengths(self, winches: Winches | None, rest_length: object) -> None:
        """Refuse what sets rest lengths where γ is held."""
        motor = None if winches is None else winches.motor
        if rest_length is not None or (winches is not None and motor is None):
            raise ValueError(
                "winches and rest_length have no meaning where γ is held; only motors have: "
                "Winches(motor=...)"
            )
        if winches is None or motor is None:
            return
        given = [
            name
            for name, value in (
                *((name, getattr(winches, name)) for name in ("rate", "shortest", "longest")),
                ("ramp", winches.ramp or None),
                *((f"motor.{name}", getattr(motor, name)) for name in ("speed", *_DYNAMIC)),
            )
            if value is not None and np.any(value)
        ]
        if given:
            raise ValueError(
                f"winches has {', '.join(given)}, which set how rest lengths move, but γ is held: "
                "give drum_radius, gear_ratio, torque and zero alone"
            )
        if self._by_segment:
            raise ValueError(
                "winches has a motor, but a string of several segments has no one tension where γ "
                "is held: leave the motor out, or hold rest lengths"
            )

    def _refuse_unreachable(self, most: FloatArray) -> None:
        """Refuse a controller that may command a γ, at most ``most``, beyond any rest length."""
        assert self._law is not None  # a rest length is held
        largest, limit = self._to_plant("force_density", most), self._law.largest_force_density
        segments = self._to_plant("force_density", np.ones(self._count))
        # Under a law that reaches any γ, so do commands: they are finite.
        over = np.flatnonzero((largest >= limit) & np.isfinite(limit))
        if len(over):
            i = over[0]
            may = f"may command γ = {largest[i]:g} N/m"
            if np.isinf(largest[i]):
                may = "has no limit on the γ that it commands"
            raise ValueError(
                f"the controller {may} on string {i}, but γ of that string stays below its "
                f"stiffness, {limit[i]:g} N/m, whatever its rest length. Give the controller "
                f"max_force_density below {limit[i] / segments[i]:g} N/m"
            )


def moved_on(motion: FloatArray, later: float) -> FloatArray:
    """Return a motion, or columns of them, so long later at the same velocities."""
    nodes, velocities = np.split(motion, 2)
    return np.concatenate([nodes + later * velocities, velocities])


def stuck_inputs(actuation: Actuation, strings: IntArray) -> IntArray:
    """Return the inputs whose winch is stuck with one of its strings."""
    return strings if actuation.is_whole else np.unique(actuation.input[strings])


def refuse_stuck_passive(actuation: Actuation, run: PlantRun) -> None:
    """Raise if a winch is to be stuck in a run that drives nothing."""
    stuck = [fault.string for fault in run.faults.listed if isinstance(fault, StuckWinch)]
    refuse_passive(actuation, "a stuck winch in faults", np.array(stuck, dtype=np.int64))


def of_all_members(actuation: Actuation, move: WinchMove) -> WinchMove:
    """Return the move of winches with the lengths of all strings, or bars."""
    if actuation.is_whole:
        return move
    return replace(move, rest_length=frozen(strings_of(actuation, move.rest_length)))


def winches_of_inputs(winches: Winches, actuation: Actuation, motor: Motor | None) -> Winches:
    """Return winches with the limits of the inputs in place of those of strings or bars."""
    if actuation.is_whole:
        return winches
    count = len(actuation.input)
    rate, (low, high) = winches.rate, winches.range(count)
    if rate is not None:
        rate = changes_of_inputs(actuation, np.broadcast_to(rate, (count,)))
    low, high = bounds_of_inputs(actuation, low, high)
    low = np.maximum(low, 0.0)  # not below by round-off: leads have positive lengths
    return replace(winches, rate=rate, shortest=low, longest=high, motor=motor)


def commands_parent(model: Model, controller: BaseController) -> bool:
    """Return whether a controller commands the strings of the plant's parent, or refuse it."""
    structure, designed = model.structure, controller.commanded
    seen, parent = controller.structure, structure.parent
    # Feet are fixed nodes to a controller for a stance; here the ground holds them.
    feet = controller.feet if model.ground else ()
    by_segment = not same_members(designed, structure, feet)
    fits = same_members(seen, structure, feet)
    if by_segment:
        fits = same_members(designed, parent, feet) and (fits or seen is designed)
    if not fits:
        raise ValueError(
            f"the controller was designed on {seen!r}, but the model has {structure!r} "
            "with other bars, strings or fixed nodes, and is no direct subdivision of it"
        )
    return by_segment
