"""The runs of a batch: blocks of runs in threads, side by side in the core where it knows them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from threading import local
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.control.controller import Controller
from tenscontrol.dynamics.equation import (
    Equation,
    pack_state,
    unpack_states,
    with_derivatives,
)
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.model_parameters import MASSES
from tenscontrol.dynamics.profile import Pieces
from tenscontrol.integrate.core_lanes import (
    AdaptiveLanes,
    CoreLanes,
    FixedStepLanes,
    RunLane,
    have_tables,
    tables_of_runs,
)
from tenscontrol.integrate.core_scene import core_scene
from tenscontrol.integrate.dop853 import cost_in_core
from tenscontrol.integrate.fixed_step import FixedStep
from tenscontrol.integrate.integrator import IntegrationError, Integrator, MethodChange, Work
from tenscontrol.integrate.methods import METHODS, Choice, Method, choose
from tenscontrol.integrate.watched import Watched, free_evaluations
from tenscontrol.interrupt import check
from tenscontrol.properties import cached_property
from tenscontrol.simulation.arguments import Arguments
from tenscontrol.simulation.batch.batch_inputs import BatchInputs, InputSpan
from tenscontrol.simulation.batch.compiled_loop import MOST_CONTROLLERS, CompiledLoops
from tenscontrol.simulation.batch.sample import Sample, SampledRun, TightenedRuns
from tenscontrol.simulation.error_estimate import Motion, Path, Resolved, Stage
from tenscontrol.simulation.health import ERROR_LIMIT
from tenscontrol.simulation.motion_functions import MotionFunctions
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.bar_clearance import BarMotion
from tenscontrol.structure.supports import moving_masses

# Runs in a call, and numbers that it may return.
_BLOCK, _MOST_NUMBERS = 256, 4_000_000

# Blocks of a thread, at least. At the end of each lanes are idle; but of two, which wait in its
# pool at once, an interrupt might leave none.
_PARTS = 3

# Of fixed steps, which the core takes side by side.
_FIXED = METHODS["rk4"], METHODS["rk4_plain"]

# Runs of which errors are estimated in a call.
_SAMPLE = 32

_POLL = 0.05  # s until an interrupt is looked for


def _rows(held: FloatArray, places: IntArray) -> FloatArray:
    """Return the inputs of some runs, of which all may have one row."""
    return held[places] if len(held) > 1 else held


class _StopError(Exception):
    """Ends a run in a thread when the user interrupts."""


class Runner:
    """Runs a scene block by block, and keeps what is asked for."""

    def __init__(self, scene: BatchInputs, kept: IntArray) -> None:
        structure, law = scene.model.structure, scene.base.law
        controller = law if isinstance(law, Controller) else None
        self.scene, self.kept, self._controller = scene, kept, controller
        self.how, output_step = scene.base.integration, scene.base.integration.output_step
        sample_time = None if controller is None else controller.sample_time
        self.spans = scene.spans(output_step, sample_time)
        self.done, self._stop = 0, ctypes.c_int(0)
        self._ends_alone = output_step is None
        ends = [span.times for span in self.spans]
        times = [self.spans[-1].times[-1:]] if self._ends_alone else ends
        self.time = np.concatenate([np.zeros(1), *times])
        d, n = structure.nodes.shape
        shape = scene.count, d, len(kept), len(self.time)
        hint = ". A longer output_step or fewer keep_nodes keep less"
        asked = f"{scene.count} runs with {len(self.time)} states of {len(kept)} nodes"
        validation.refuse_memory(f"asked for are {asked}", 2.0 * np.prod(shape), "numbers", 8, hint)
        # Entries of the nodes that are kept: those of a state, and those that supports hold.
        entries = (d * kept[:, None] + np.arange(d)).ravel()
        place = np.full(d * n, -1)
        place[structure.free_rows] = np.arange(len(structure.free_rows))
        self._from = place[entries]
        self._fixed = structure.nodes.ravel(order="F")[entries]
        self._is_whole = np.array_equal(self._from, np.arange(len(structure.free_rows)))
        self.nodes, self.velocities = np.full(shape, np.nan), np.full(shape, np.nan)
        self.completed = np.zeros(scene.count, dtype=bool)
        self.end_time, self.messages = np.zeros(scene.count), dict[int, str]()
        self.switches, self.missed = (np.zeros(scene.count, dtype=int) for _ in range(2))
        self.command: FloatArray | None = None
        self.commands_not_ok: IntArray | None = None
        if controller is not None:
            size = scene.count, len(controller.commanded.strings), len(self.spans)
            validation.refuse_memory(
                f"{asked} and commands", 2.0 * np.prod(size), "numbers", 8, hint
            )
            self.command, self.commands_not_ok = np.full(size, np.nan), np.zeros(size[0], int)
        # Of each run: what lanes counted, and the work of integrators.
        self._counts, self._work = np.zeros((scene.count, 0)), dict[int, Work]()
        self._threads, self._has_no_memory = local(), False
        self._watches = self._shares = False
        self._lanes: CoreLanes | None = None
        self._changes: dict[int, tuple[MethodChange, ...]] = {}  # of methods, run by run
        self._errors: dict[int, FloatArray] = {}  # of the runs that were looked at
        self._prepare()

    def _prepare(self) -> None:
        """Choose the method, by the first run that can begin, and make the lanes if there are."""
        scene, how = self.scene, self.how
        method = how.chosen
        first, state = self._first()
        if method is None:
            if state is None or first is None:
                self.choice = Choice("auto", "tolerance", how.tolerance, "no run can begin", "none")
                return
            equation = self._equation(scene.model_of(first), "auto", ())
            held = scene.held_inputs(first, first + 1, self.spans[0], parameters=False)[0]
            chosen = choose(equation, state, held, scene.duration, how.tolerance, how.step)
            method = METHODS[chosen.method]
        elif how.step is not None:
            chosen = Choice(method.name, "step", how.step, "asked for")
        else:
            chosen = Choice(method.name, "tolerance", how.tolerance, "asked for")
        if scene.pieces.degree and not method.follows:
            raise ValueError(
                f"method {method.name!r} takes inputs that are constant over a step only, but "
                "an input changes in time"
            )
        self._watches = how.chosen is None and chosen.setting == "tolerance"
        self._method = method
        self.choice = chosen
        self._lanes = self._made_lanes(first)
        if self._lanes is not None:
            self._counts = np.zeros((scene.count, len(self._lanes.counted)))
        steps = isinstance(method.make, type) and issubclass(method.make, FixedStep)
        self._shares = self._lanes is None and (
            not scene.parameters or (steps and self._can_share())
        )
        self._has_no_memory = steps and self._shares
        if self._lanes is not None:
            back_end = self._lanes.back_end
        elif self._shares:
            self._shared = self._equation(scene.model, "auto", tuple(scene.parameters))
            value = self.choice.value
            back_end = self._integrator(method, scene.model, self._shared, value).back_end
        else:
            back_end = "a model built for each run"
        self.choice = replace(chosen, back_end=back_end)

    def _made_lanes(self, first: int | None) -> CoreLanes | None:
        """Return what integrates several runs at once; None where the core does not know them."""
        scene, structure = self.scene, self.scene.model.structure
        if self._method not in (*_FIXED, METHODS["dop853"]):
            return None
        if first is None or not have_tables(scene.model, scene.given):
            return None
        equation = self._equation(scene.model_of(first), "auto", ())
        core = core_scene(equation)
        if core is None:
            return None
        alike = core, self._projects, tables_of_runs(scene.model, scene.given), self.choice.value
        if self._method in _FIXED:
            return FixedStepLanes(*alike, self._method.name)
        limit = free_evaluations(cost_in_core(core.states)) if self._watches else np.inf
        bars, points = (scene.given.get(name, getattr(structure, name)[None]) for name in MASSES)
        return AdaptiveLanes(equation, *alike, moving_masses(structure, bars, points), limit)

    def _are_damped(self) -> np.ndarray:
        """Which runs have damping, if they differ in it: strings without have simpler equations."""
        damping = self.scene.given.get("damping", np.ones((1, 1)))
        return np.asarray((damping > 0).any(axis=1))

    @property
    def _projects(self) -> bool:
        method = self._method
        if not method.drifts:
            return False
        project = self._project_of(method)
        return method.projects if project is None else project

    def _first(self) -> tuple[int | None, FloatArray | None]:
        for run in range(self.scene.count):
            states, refused = self.scene.states(np.array([run]))
            if not refused:
                return run, states[0]
        return None, None

    def _equation(self, model: Model, form: str, parameters: tuple[str, ...]) -> Equation:
        """Return the equation of motion, as a single run has it but for what runs differ in."""
        scene = self.scene
        as_input = "load" in scene.given or isinstance(scene.load, Pieces)
        load = None
        if not as_input:
            assert not isinstance(scene.load, Pieces)  # else it is an input
            load = scene.load - scene.model.constant_force
        return model.equation(
            scene.input, load, form, degree=scene.pieces.degree, load_input=as_input,
            parameters=parameters,
        )  # fmt: skip

    def _can_share(self) -> bool:
        """Whether one compiled function takes the parameters of all runs as inputs."""
        given, structure = self.scene.given, self.scene.model.structure
        form = self._equation(self.scene.model, "auto", ()).form
        own_model = self.scene.varies_ground or (structure.blocks and set(MASSES) & set(given))
        if form != "flat" or own_model:
            return False
        return bool(self._are_damped().all())

    def _integrator(
        self, method: Method, model: Model, equation: Equation, value: float
    ) -> Integrator:
        """Return the integrator of a method, by the equation of a model in a form that it takes."""
        if method.differentiates:
            equation = with_derivatives(equation, lambda form: self._equation(model, form, ()))
        return method.integrator(equation, value, self.choice.setting, self._project_of(method))

    def _project_of(self, method: Method) -> bool | None:
        """Return what the user says, unless the method was chosen and needs no projection."""
        return self.how.project if method.drifts or self.how.chosen is not None else None

    # ---- blocks ----

    def run(self, threads: int, report: Callable[[float], None]) -> None:
        """Do all runs; if stopped, give up those that are not done."""
        states = 2 * len(self.scene.model.structure.free_rows)
        outputs = max(span.outputs for span in self.spans)
        most = _BLOCK if self._controller is None else MOST_CONTROLLERS
        block = int(np.clip(_MOST_NUMBERS / (states * outputs), 4, most))
        # So that all threads have work to the end.
        block = max(4, min(block, -(-self.scene.count // (_PARTS * threads))))
        count = self.scene.count
        firsts = range(0, count, block)
        blocks = (partial(self._block, first, min(first + block, count)) for first in firsts)

        def count_up(done: int) -> None:
            self.done += done
            report(self.done)

        self._in_threads(threads, blocks, count_up)

    def estimate_errors(
        self, runs: IntArray, threads: int, report: Callable[[float], None]
    ) -> FloatArray:
        """Return :meth:`error` of some runs, shape (runs, K), if nobody stops it; NaN of others."""
        errors = np.full((self.scene.count, len(self.time)), np.nan)
        looked_at = 0
        if not len(runs):
            return errors

        def estimate(some: IntArray) -> int:
            starts = self.scene.states(some)[0]
            self._errors |= self._errors_by_tolerance(some, starts)
            resolved = self._again_at_once(some, starts)
            for run, start in zip(some.tolist(), starts, strict=True):
                if self._stop.value:
                    return 0
                if run not in self._errors:
                    self._errors[run] = self._estimated_error(run, start, resolved)
                errors[run] = self._errors[run]
            return len(some)

        def count_up(done: int) -> None:
            nonlocal looked_at
            looked_at += done
            report(looked_at)

        parts = np.array_split(runs, -(-len(runs) // min(_SAMPLE, -(-len(runs) // threads))))
        self._in_threads(threads, (partial(estimate, some) for some in parts), count_up)
        return errors

    def _again_at_once(
        self, runs: IntArray, starts: FloatArray
    ) -> Callable[[int, float], Resolved]:
        """Return what integrates runs of a sample again: at once those in fixed steps."""
        if not isinstance(self._lanes, FixedStepLanes) or len(self.spans) > 1:
            return self._resolved
        held = self._inputs_of(runs, 0)
        return partial(
            SampledRun, Sample(self._lanes, runs, starts, held, self._resolved, self._stop)
        )

    def _errors_by_tolerance(self, runs: IntArray, starts: FloatArray) -> dict[int, FloatArray]:
        """Return :meth:`error` of those of a sample that lanes find by a tolerance at once."""
        lanes = self._lanes
        in_lanes = np.setdiff1d(runs, [*self._work, *self._errors])
        if not isinstance(lanes, AdaptiveLanes) or not len(in_lanes):
            return {}
        with self._loops(len(in_lanes)) as loops:
            motion = self._motion(
                in_lanes, starts[np.searchsorted(runs, in_lanes)],
                [self._inputs_of(in_lanes, number) for number in range(len(self.spans))],
                partial(TightenedRuns, lanes, in_lanes, loops, self._stop),
            )  # fmt: skip
            errors = np.pad(motion.errors_by_tolerance(), ((0, 0), (1, 0)))
        is_known = np.isfinite(errors[:, -1])
        return dict(zip(in_lanes[is_known].tolist(), errors[is_known], strict=True))

    def _in_threads(
        self, threads: int, calls: Iterator[Callable[[], int]], report: Callable[[int], None]
    ) -> None:
        """Call in threads, and report what each call returns; raise if the user interrupts."""
        pending: set[Future[int]] = set()
        self._stop.value = 0
        with ThreadPoolExecutor(threads) as pool:
            try:
                while True:
                    check()
                    while len(pending) < 2 * threads and (call := next(calls, None)) is not None:
                        pending.add(pool.submit(call))
                    if not pending:
                        break
                    ended, pending = wait(pending, _POLL, FIRST_COMPLETED)
                    for future in ended:
                        report(future.result())
            finally:
                self._stop.value = 1
                for future in pending:
                    future.cancel()

    def _block(self, first: int, last: int) -> int:
        """Do some runs; return how many were done, whatever became of them."""
        with self._loops(last - first) as loops:
            return self._done(first, last, loops)

    def _done(self, first: int, last: int, loops: CompiledLoops | None) -> int:
        """Do so under their controllers, if there are any."""
        at = np.arange(first, last)
        states, refused = self.scene.states(at)
        self._keep(at, 0, states[:, None])
        if refused:
            self.messages.update(refused)
            self.nodes[list(refused)] = self.velocities[list(refused)] = np.nan
            at = np.setdiff1d(at, list(refused))
            states = states[at - first]
        column = 1
        if not self._has_no_memory:
            self._threads.__dict__.pop("made", None)
        lanes = self._lanes
        if lanes is not None and len(self.spans) > 1:
            lanes = lanes.over_spans(first, last)
        for number, span in enumerate(self.spans):
            if not len(at) or self._stop.value:
                break
            held = self.scene.held_inputs(first, last, span, self._shares)
            held = _rows(held, at - first)
            if loops is not None:
                at, states, held = self._commanded(loops, at, at - first, states, held, number)
                if not len(at):
                    break
            kept, ended = self._advance(lanes, at, states, held, number)
            if not self._ends_alone:
                self._keep(at, column, kept)
                column += span.outputs
            elif span is self.spans[-1]:
                self._keep(at, 1, kept[:, -1:])
            going = ~ended
            at, states = at[going], kept[going, -1]
            self.end_time[at] = span.start + span.length
        if not self._stop.value:
            self.completed[at] = True
        return 0 if self._stop.value else last - first

    @contextmanager
    def _loops(self, runs: int) -> Iterator[CompiledLoops | None]:
        """Yield the controllers of so many runs, which remember nothing; None if there is none."""
        if self._controller is None:
            yield None
            return
        loops = CompiledLoops(self._controller, self.scene.model.structure)
        try:
            loops.reset(runs)
            yield loops
        finally:
            loops.give_back()

    def _commanded(
        self, loops: CompiledLoops, at: IntArray, places: IntArray, states: FloatArray,
        held: FloatArray, number: int,
    ) -> tuple[IntArray, FloatArray, FloatArray]:  # fmt: skip
        """Return the runs that go on in a sample, their states, and their inputs."""
        away, start = np.abs(states).max(axis=1) > validation.LARGEST, self.spans[number].start
        for run in at[away]:
            self._end(
                run, start, f"the motion has run away, beyond {validation.LARGEST:g} in m and m/s"
            )
        if len(held) > 1:
            held = held[~away]
        at, states = at[~away], states[~away]
        commands, failed = loops.commands(start, states, places[~away])
        assert self.command is not None  # made with the controller
        assert self.commands_not_ok is not None  # and this too
        self.command[at, :, number] = commands
        self.commands_not_ok[at] += failed
        held = np.repeat(held, len(at), axis=0) if len(held) == 1 else held.copy()
        held[:, : commands.shape[1]] = commands
        return at, states, held

    def _advance(
        self, lanes: CoreLanes | None, at: IntArray, states: FloatArray, held: FloatArray,
        number: int,
    ) -> tuple[FloatArray, np.ndarray]:  # fmt: skip
        """Return the states at the outputs of a span, and which runs ended in it."""
        span = self.spans[number]
        if lanes is None:
            return self._one_by_one(at, states, held, span)
        if not isinstance(lanes, FixedStepLanes):
            return self._advance_adaptively(lanes, at, states, held, number)
        spans = lanes.advance(at, states, held, span.length, span.outputs, self._stop)
        ended = ~spans.reaches_end
        for i in np.flatnonzero(ended) if not self._stop.value else ():
            why = lanes.failure(spans.time[i], span.length, span.outputs)
            self._end(at[i], span.start + spans.time[i], why)
        self._count(lanes, at, spans.counts)
        return spans.states, ended

    def _advance_adaptively(
        self, lanes: CoreLanes, at: IntArray, states: FloatArray, held: FloatArray, number: int
    ) -> tuple[FloatArray, np.ndarray]:
        """Return the same of runs side by side, but for those that have come to be alone."""
        span = self.spans[number]
        kept = np.full((len(at), span.outputs, states.shape[1]), np.nan)
        ended = np.ones(len(at), dtype=bool)
        is_alone = np.isin(at, list(self._work)) if number else np.zeros(len(at), dtype=bool)
        in_lanes = np.flatnonzero(~is_alone)
        if len(in_lanes):
            spans = lanes.advance(
                at[in_lanes], states[in_lanes], _rows(held, in_lanes), span.length, span.outputs,
                self._stop,
            )  # fmt: skip
            kept[in_lanes], ended[in_lanes] = spans.states, ~spans.reaches_end
            self._count(lanes, at[in_lanes[spans.reaches_end]], spans.counts[spans.reaches_end])
            for run in at[in_lanes[~spans.reaches_end]] if number else ():
                self._replay(int(run), number)
        others = np.flatnonzero(ended)
        if len(others):
            kept[others], ended[others] = self._one_by_one(
                at[others], states[others], _rows(held, others), span
            )
        return kept, ended

    def _count(self, lanes: CoreLanes, runs: IntArray, counts: FloatArray) -> None:
        """Enter what lanes counted of runs."""
        for name, of in (("switches", self.switches), ("missed", self.missed)):
            if name in lanes.counted:
                of[runs] += counts[:, lanes.counted.index(name)].astype(int)
        self._counts[runs] += counts

    def _replay(self, run: int, number: int) -> None:
        """Bring an integrator of its own to where a run has come to, after so many spans."""
        integrator, work = self._of_run(run), Work()
        state = self.scene.states(np.array([run]))[0][0]
        for passed, span in enumerate(self.spans[:number]):
            if self._stop.value:
                return
            u = self._inputs(run, passed)
            advanced = integrator.advance(state, u, span.length, span.outputs)
            state, work = advanced.states[:, -1], work + advanced.work
        self._work[run] = work

    def _inputs(self, run: int, number: int) -> FloatArray:
        """Return the inputs of a run in a span, with the commands that it had."""
        inputs: FloatArray = self._inputs_of(np.array([run]), number)[0]
        return inputs

    def _inputs_of(self, runs: IntArray, number: int) -> FloatArray:
        """Return the same of some runs, shape (1 or runs, inputs)."""
        first, last = int(runs.min()), int(runs.max()) + 1
        held = self.scene.held_inputs(first, last, self.spans[number], self._shares)
        held = _rows(held, runs - first)
        if self.command is not None:
            commands = self.command[runs, :, number]
            held = np.broadcast_to(held, (len(runs), held.shape[1])).copy()
            held[:, : commands.shape[1]] = commands
        return held

    def _one_by_one(
        self, at: IntArray, states: FloatArray, held: FloatArray, span: InputSpan
    ) -> tuple[FloatArray, np.ndarray]:
        """Return the states at the outputs of a span, and which runs ended in it."""
        kept = np.full((len(at), span.outputs, states.shape[1]), np.nan)
        ended = np.ones(len(at), dtype=bool)

        def report(_: float) -> None:
            if self._stop.value:
                raise _StopError

        for i, run in enumerate(at.tolist()):
            integrator, u = self._of_run(run), held[i if len(held) > 1 else 0]
            try:
                report(0.0)
                advanced = integrator.advance(states[i], u, span.length, span.outputs, report)
                ended[i] = False
            except IntegrationError as error:
                advanced = error.span
                self._end(run, span.start + error.time, str(error))
            except _StopError:
                break
            if self._watches:
                self._changes[run] = integrator.changes
            kept[i, : advanced.states.shape[1]] = advanced.states.T
            self._work[run] = self._work.get(run, Work()) + advanced.work
            self.switches[run] += advanced.work.switches
            self.missed[run] += advanced.work.missed
        return kept, ended

    def _of_run(self, run: int) -> Integrator:
        """Return the integrator of a run: the same in all its spans, as it may remember.

        One with fixed steps has no memory, and serves all runs of a thread.
        """
        key = -1 if self._has_no_memory else run
        integrators: dict[int, Integrator] = self._threads.__dict__.setdefault("made", {})
        if key not in integrators:
            if len(self.spans) == 1:
                integrators.clear()
            integrators[key] = self._made_for(run)
        return integrators[key]

    def _made_for(self, run: int, value: float | None = None) -> Integrator:
        """Return a new integrator: of the equation that all share, or of the run's own.

        ``value`` is its step or tolerance, that of the batch if not given.
        """
        value = self.choice.value if value is None else value
        if self._watches:
            return self._watched(run, value)
        if self._shares:
            return self._integrator(self._method, self.scene.model, self._shared, value)
        model = self.scene.model_of(run)
        return self._integrator(self._method, model, self._equation(model, "auto", ()), value)

    def _watched(self, run: int, value: float) -> Integrator:
        model = self.scene.model if self._shares else self.scene.model_of(run)
        equation = self._equation(model, "auto", ())

        def make(name: str) -> Integrator:
            return self._integrator(METHODS[name], model, equation, value)

        return Watched(equation, self._methods_of(run)[-1], make, self.scene.duration)

    def _methods_of(self, run: int) -> tuple[str, ...]:
        """Return the methods of a run that were at work, in order."""
        return replace(self.choice, changes=self._changes.get(run, ())).methods

    def _end(self, run: int, time: float, why: str) -> None:
        self.end_time[run] = time
        self.messages[int(run)] = why

    def _keep(self, runs: IntArray, column: int, states: FloatArray) -> None:
        """Enter states, shape (runs, outputs, states), from a column of the result on."""
        d = self.scene.model.structure.dimension
        count, outputs, size = states.shape
        free = self._from >= 0
        follow = len(runs) and runs[-1] - runs[0] == count - 1
        where = slice(runs[0], runs[-1] + 1) if follow else runs
        for array, half, rest in (
            (self.nodes, states[:, :, : size // 2], self._fixed),
            (self.velocities, states[:, :, size // 2 :], np.zeros(len(free))),
        ):
            entries = half
            if not self._is_whole:
                entries = np.broadcast_to(rest, (count, outputs, len(free))).copy()
                entries[:, :, free] = half[:, :, self._from[free]]
            shaped = entries.reshape(count, outputs, -1, d).transpose(0, 3, 2, 1)
            array[where, :, :, column : column + outputs] = shaped

    # ---- single runs ----

    def trajectory(self, run: int) -> Trajectory:
        """Return a run that was completed, of a model without ground, under inputs that are held.

        All nodes were kept.
        """
        scene, choice, model = self.scene, self.choice, self.scene.model_of(run)
        structure = model.structure
        nodes, velocities = self.nodes[run], self.velocities[run]
        of = self._span_of
        given = Arguments({})
        if self.command is None:
            held = scene.input_value(run)
            inputs: FloatArray = np.broadcast_to(held[:, None], (len(held), len(of)))
            given = Arguments({scene.input: held})
        else:
            inputs = self.command[run][:, of]
        load = scene.entry("load", run)
        if load is None:
            assert not isinstance(scene.load, Pieces)  # refused where it changes
            load = scene.load
        load = load.reshape(structure.nodes.shape, order="F")
        loaded, free = bool(load.any()), not len(structure.fixed_rows)
        forces = model.forces(scene.input)
        trajectory = Trajectory(
            structure, self.time, nodes, velocities,
            inputs if scene.input == "rest_length" else None,
            replace(choice, changes=self._changes.get(run, ())), self._work_of(run),
            conserves_energy=self.command is None and forces.conserves_energy,
            conserves_momentum=not loaded and free and forces.conserves_momentum, control=None,
            released_energy=np.zeros(len(of)), error=self.error(run),
            falls=free and float(model.constant_force[-1].sum()) < 0,
            given=given,
            _functions=MotionFunctions(
                model, False, inputs, load if loaded else None,
                shared=partial(self._function, run, model) if self._shares else None,
                core=core_scene(self._equation(model, "auto", ())),
            ),
        )  # fmt: skip
        vars(trajectory).update(_bars=self.bars(run))
        return trajectory

    def lack(self) -> str | None:
        """Return why a run cannot be had as a trajectory; None if it can."""
        if self.scene.model.ground or not self.scene.pieces.is_constant:
            return "has ground, or inputs that change in time: simulate gives its trajectory"
        return None

    def bars(self, run: int) -> BarMotion:
        """Return the bars over a run, up to where it is good; all nodes were kept."""
        finite = np.isfinite(self.nodes[run]).all(axis=(0, 1))
        nodes, velocities = self.nodes[run][:, :, finite], self.velocities[run][:, :, finite]
        structure, steps = self.scene.model.structure, self._work_of(run).steps
        # From one output to the next the input is one polynomial in time.
        has_input = not self._ends_alone or len(self.spans) == 1
        again = partial(self._again, run) if has_input else None
        return BarMotion(structure, self.time[finite], nodes, velocities, again, steps)

    @property
    def _span_of(self) -> IntArray:
        """The span of each state kept: the start belongs to the first."""
        if self._ends_alone:
            return np.array([0, len(self.spans) - 1])
        outputs = np.repeat(np.arange(len(self.spans)), [span.outputs for span in self.spans])
        return np.concatenate([outputs[:1], outputs])

    def _again(
        self, run: int, first: int, last: int, parts: int
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Return times, nodes and velocities from one interval of outputs to another, in parts."""
        number = self._span_of[first + 1]
        if number != self._span_of[last + 1]:
            return None
        begin, end = self.time[first], self.time[last + 1]
        u = self._inputs(run, number)
        if self.spans[number].time is not None:
            u[-1] += begin - self.spans[number].start
        motion = self.nodes[run][:, :, first], self.velocities[run][:, :, first]
        state = pack_state(self.scene.model.structure, *motion)
        integrator = self._resolved(run, self.choice.value)
        try:
            states = integrator.advance(state, u, end - begin, parts).states
        except (IntegrationError, KeyboardInterrupt):
            return None
        every = unpack_states(self.scene.model.structure, np.column_stack([state, states]))
        return begin + (end - begin) * np.arange(parts + 1) / parts, *every

    def _work_of(self, run: int) -> Work:
        work = self._work.get(run)
        if work is not None or self._lanes is None:
            return Work() if work is None else work
        return self._lanes.work_of(self._counts[run])

    def error(self, run: int) -> FloatArray:
        """Return an estimate of the error of the nodes that were kept, as part of the size.

        At each time kept, of a run that was completed: by another run, under a controller that
        begins anew.
        """
        if run not in self._errors:
            start = self.scene.states(np.array([run]))[0][0]
            self._errors[run] = self._estimated_error(run, start, self._resolved)
        return self._errors[run]

    def _estimated_error(
        self, run: int, start: FloatArray, resolved: Callable[[int, float], Resolved]
    ) -> FloatArray:
        inputs = [self._inputs(run, number) for number in range(len(self.spans))]
        motion = self._motion(run, start, inputs, partial(resolved, run))
        return np.concatenate([[0.0], motion.estimated_error(ERROR_LIMIT)])

    def _motion(
        self, run: Any, start: FloatArray, inputs: list[FloatArray],
        integrator: Callable[[float], Resolved],
    ) -> Motion:  # fmt: skip
        """Return the motion of a run by its number, or those of several, to be found again.

        ``start`` and the inputs of each span have a first axis of runs for several.
        """
        structure = self.scene.model.structure
        stages = [
            Stage(span.length, span.outputs, held)
            for span, held in zip(self.spans, inputs, strict=True)
        ]
        columns = np.arange(sum(span.outputs for span in self.spans))
        if self._ends_alone:
            columns = columns[-1:]
        is_known = self._from >= 0
        nodes = self.nodes[run].swapaxes(-3, -2)
        positions = nodes.reshape(*nodes.shape[:-3], -1, nodes.shape[-1])[..., is_known, 1:]
        loop = None
        switches, order = 0, METHODS["dop853"].order
        if np.ndim(run) == 0:
            switches = int(self.switches[run] + self.missed[run])
            order = (self.how.chosen or METHODS[self._methods_of(run)[-1]]).order
            if self._controller is not None:
                loop = partial(self._looped_again, run, start, integrator)
        return Motion(
            structure, start, stages, Path(columns, positions, switches), self._from[is_known],
            self.choice.setting, self.choice.value, order, integrator, self._later, loop,
        )  # fmt: skip

    def _looped_again(
        self, run: int, start: FloatArray, integrator_for: Callable[[float], Resolved], value: float
    ) -> Path:
        """Return a run at another step or tolerance, under a controller that begins anew."""
        integrator, state, positions = integrator_for(value), start, list[FloatArray]()
        if value < self.choice.value:
            integrator.shorten()
        with suppress(IntegrationError), self._loops(1) as loops:
            assert loops is not None  # asked for under a controller
            for number, span in enumerate(self.spans):
                if np.abs(state).max() > validation.LARGEST:
                    break
                (command,), _ = loops.commands(span.start, state[None], np.zeros(1, dtype=int))
                u = self._inputs(run, number)
                u[: len(command)] = command
                states = integrator.advance(state, u, span.length, span.outputs).states
                positions.append(states[self._from[self._from >= 0]])
                state = states[:, -1]
        known = np.zeros((np.count_nonzero(self._from >= 0), 0))
        joined = np.hstack([known, *positions])
        return Path(np.arange(joined.shape[1]), joined, 0)

    @cached_property
    def _later(self) -> Callable[[FloatArray, float], FloatArray]:
        """What takes inputs to those that begin a time later; see :class:`Motion`."""
        return self._equation(self.scene.model, "auto", ()).layout.later

    def _resolved(self, run: int, value: float) -> Resolved:
        """Return what integrates a run with another step or tolerance."""
        if isinstance(self._lanes, FixedStepLanes):
            return RunLane(self._lanes.of_step(value), run)
        return self._made_for(run, value)

    def _function(self, run: int, model: Model, name: str) -> tuple[ca.Function, list[FloatArray]]:
        """Return a function of the model of a run, one that all runs share, and more inputs."""
        scene, shared = self.scene, self.scene.model
        names = [parameter for parameter in scene.parameters if parameter not in MASSES]
        if name not in ("string_force_density", "elastic_energy"):
            if set(MASSES) & set(scene.varied):
                return getattr(model, name), []
            names = []

        def build() -> ca.Function:
            return shared.of_parameters(name, names) if names else getattr(shared, name)

        function = shared.prepared.get(("shared", name, tuple(names)), build)
        return function, [scene.some(parameter, np.array([run]))[0] for parameter in names]
