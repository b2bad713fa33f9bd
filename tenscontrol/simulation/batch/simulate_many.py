"""Many runs of one model at once: starts, inputs, loads and parameters that differ from run to run.

Runs go in blocks to threads. Where a method has fixed steps and every member is written out, a
block is one call of compiled C that takes a step of several runs by one instruction. Else each run
is a call of the integrator. The numbers are those of single runs, to the last bit.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from threading import local
from types import MappingProxyType

import numpy as np

from tenscontrol.control import Controller
from tenscontrol.dynamics import Equation, Model, Pieces
from tenscontrol.integrate import (
    METHODS,
    Choice,
    FixedStep,
    IntegrationError,
    Integrator,
    Lanes,
    Method,
    choose,
    method_of,
    not_finite,
)
from tenscontrol.interrupt import check, keeping
from tenscontrol.progress import progress_bar
from tenscontrol.simulation.batch.batch_inputs import MASSES, BatchInputs, InputSpan, given_by_run
from tenscontrol.simulation.batch.compiled_loop import (
    MOST_CONTROLLERS,
    CompiledLoops,
    checked_controller,
)
from tenscontrol.structure import Structure
from tenscontrol.validation import (
    LARGEST,
    FloatArray,
    IntArray,
    float_array,
    indices,
    instance,
    positive_number,
    refuse_memory,
    truth,
    whole_number,
)

# Runs in a call, and numbers that it may return.
_BLOCK, _MOST_NUMBERS = 256, 4_000_000

_POLL = 0.05  # s until an interrupt is looked for

_INTERRUPTED = "interrupted"


@dataclass(frozen=True, eq=False)
class Batch:
    """Motions of many runs.

    Attributes
    ----------
    structure : Structure
    time : ndarray, shape (K,)
        Of the states kept, s.
    nodes, velocities : ndarray, shape (runs, d, k, K)
        Of the nodes kept, m and m/s; NaN after the end of a run that did not reach the last time.
    kept_nodes : ndarray of int, shape (k,)
    completed : ndarray of bool, shape (runs,)
        Whether a run reached the end.
    end_time : ndarray, shape (runs,)
        Time up to which a run is good, s.
    messages : mapping of int to str
        Why a run did not reach the end, by its number.
    switches, unlocated : ndarray of int, shape (runs,)
        As in :class:`Work`.
    choice : Choice
        Method and step, and what ran them.
    command : ndarray, shape (runs, α, samples), or None
        Of the controller, N/m or m; NaN where a run had ended. None without a controller.
    commands_not_ok : ndarray of int, shape (runs,), or None
        How many commands had another status than ``Status.OK``.
    """

    structure: Structure
    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    kept_nodes: IntArray
    completed: np.ndarray
    end_time: FloatArray
    messages: Mapping[int, str]
    switches: IntArray
    unlocated: IntArray
    choice: Choice
    command: FloatArray | None = None
    commands_not_ok: IntArray | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():  # not copied: they may be large
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        object.__setattr__(self, "messages", MappingProxyType(dict(self.messages)))

    def __repr__(self) -> str:
        done, runs = int(self.completed.sum()), len(self.completed)
        return f"Batch({done} of {runs} runs to {self.time[-1]:g} s, {self.choice.method})"


def simulate_many(
    model: Model,
    duration: float,
    nodes: object = None,
    velocities: object = None,
    *,
    rest_length: object = None,
    force_density: object = None,
    external_force: object = None,
    controller: object = None,
    vary: Mapping[str, object] | None = None,
    method: str | Method = "auto",
    tolerance: float = 1e-6,
    step: float | None = None,
    output_step: float | None = None,
    keep_nodes: object = None,
    project: bool | None = None,
    machine_code: bool = True,
    threads: int | None = None,
    progress: bool = False,
) -> Batch:
    """Return the motions of many runs of a model: open loops, or loops closed by compiled code.

    Arguments are those of :func:`simulate`; each array may have a first axis, one entry a run. What
    has none is the same for all runs. The numbers are those of :func:`simulate` run by run, to the
    last bit, with the same method and step.

    Parameters
    ----------
    model : Model
    duration : float
        s.
    nodes, velocities : array_like, shape (d, n) or (runs, d, n), optional
        Start of each run, m and m/s; the reference shape at rest if not given.
    rest_length : float, array_like, shape (α,) or (runs, α), Profile or callable, optional
        m. Give this or ``force_density``.
    force_density : float, array_like, shape (α,) or (runs, α), Profile or callable, optional
        N/m.
    external_force : array_like, shape (d, n) or (runs, d, n), Profile or callable, optional
        N, for a model built with ``external_force=True``.
    controller : CompiledController, optional
        ``generate_c(controller, folder).compile()``, in place of ``rest_length`` and
        ``force_density``. Each run has its own, from a fresh start; commands are held over a
        sample as they are, γ where the model has no string law. With winches: :func:`simulate`.
    vary : mapping of str to array_like, shape (runs,) or (runs, members), optional
        Parameters of the model that differ from run to run, by name: ``"bar_mass"``,
        ``"point_mass"`` (members are nodes), kg, parameters of the string law such as
        ``"stiffness"`` and ``"damping"``, and ``"gravity"``, shape (runs,) or (runs, d).
    method, tolerance, project : optional
        As in :func:`simulate`. ``"auto"`` chooses once, for the first run.
    step : float, optional
        Step of a method with a fixed step, s. Only these methods take several runs at once.
    output_step : float, optional
        Largest time between states kept, s; start and end alone if not given.
    keep_nodes : array_like of int, optional
        Nodes that are kept; all if not given.
    machine_code : bool
        Whether to compile. Without it, or a compiler, the numbers are the same, some ten times
        as late; ``batch.choice.back_end`` says what ran.
    threads : int, optional
        All processors if not given.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    Batch

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or shape, with its name, or what is asked for does not
        fit in memory. What is wrong with the numbers of one run ends that run alone, and
        ``batch.messages`` says so.

    Warns
    -----
    InterruptionWarning
        A RuntimeWarning: Ctrl-C or SIGTERM ended the batch; runs that are done are returned, the
        others are NaN. KeyboardInterrupt if none is.

    Examples
    --------
    A prism let go with a hundred prestresses:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> gamma = np.repeat([17.3205, 17.3205, 20.0], 3)
    >>> start = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    >>> factors = np.linspace(0.9, 1.0, 100)
    >>> batch = tc.simulate_many(model, 0.5, rest_length=factors[:, None] * start, step=5e-3)
    >>> batch.nodes.shape, int(batch.completed.sum())
    ((100, 3, 6, 2), 100)
    """
    instance("model", model, Model, "make one by Model(structure)")
    if not len(model.structure.free):
        raise ValueError("every node of the model is fixed: nothing can move")
    duration = positive_number("duration", duration, "s")
    tolerance = positive_number("tolerance", tolerance, "of size and speed")
    if output_step is not None:
        output_step = positive_number("output_step", output_step, "s")
    truth("progress", progress, "whether to show a progress bar")
    truth("machine_code", machine_code, "whether to compile the steps")
    if threads is None:
        affinity = getattr(os, "sched_getaffinity", None)
        threads = len(affinity(0)) if affinity else os.cpu_count() or 1
    threads = whole_number("threads", threads, 1)
    given = {"rest_length": rest_length, "force_density": force_density, "controller": controller}
    names = [name for name, value in given.items() if value is not None]
    if len(names) != 1:
        found = " and ".join(names) or "none"
        raise ValueError(
            f"expected one of rest_length, force_density and controller, found {found}"
        )
    law = None
    if controller is not None:
        law = checked_controller(controller, model)
        # What runs begin from, and what is chosen for, until there is a command.
        rest = law.plant.equilibrium_input
        rest_length, force_density = (rest, None) if law.input == "rest_length" else (None, rest)
    scene = BatchInputs(
        model, duration, rest_length, force_density, external_force,
        given_by_run(
            model, vary, nodes=nodes, velocities=velocities, rest_length=rest_length,
            force_density=force_density, external_force=external_force,
        ),
    )  # fmt: skip
    kept = np.arange(model.structure.nodes.shape[1])
    if keep_nodes is not None:
        kept = indices("keep_nodes", float_array("keep_nodes", keep_nodes), len(kept), "nodes")
    runner = None
    with keeping("runs are done, the others are NaN", lambda: 0 if runner is None else runner.done):
        if step is not None:
            step = positive_number("step", step, "s")
        how = _How(method_of(method), tolerance, step, project, machine_code)
        runner = _Runner(scene, how, output_step, kept, law)
        with progress_bar(scene.count, progress, label="simulating", unit="runs") as report:
            runner.run(threads, report)
    return runner.batch()


# ---- what is run ----


@dataclass(frozen=True)
class _How:
    """How runs are integrated."""

    method: Method | None
    tolerance: float
    step: float | None
    project: bool | None
    machine_code: bool


class _StopError(Exception):
    """Ends a run in a thread when the user interrupts."""


class _Runner:
    """Runs a scene block by block, and keeps what is asked for."""

    def __init__(
        self, scene: BatchInputs, how: _How, output_step: float | None, kept: IntArray,
        controller: Controller | None,
    ) -> None:  # fmt: skip
        structure = scene.model.structure
        self.scene, self.how, self.kept, self._controller = scene, how, kept, controller
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
        refuse_memory(f"asked for are {asked}", 2.0 * np.prod(shape), "numbers", 8, hint)
        # Entries of the nodes that are kept: those of a state, and those that supports hold.
        entries = (d * kept[:, None] + np.arange(d)).ravel()
        place = np.full(d * n, -1)
        place[structure.free_rows] = np.arange(len(structure.free_rows))
        self._from = place[entries]
        self._fixed = structure.nodes.ravel(order="F")[entries]
        self.nodes, self.velocities = np.full(shape, np.nan), np.full(shape, np.nan)
        self.completed = np.zeros(scene.count, dtype=bool)
        self.end_time, self.messages = np.zeros(scene.count), dict[int, str]()
        self.switches, self.unlocated = (np.zeros(scene.count, dtype=int) for _ in range(2))
        self.command: FloatArray | None = None
        self.commands_not_ok: IntArray | None = None
        if controller is not None:
            size = scene.count, len(controller.commanded.strings), len(self.spans)
            refuse_memory(f"{asked} and commands", 2.0 * np.prod(size), "numbers", 8, hint)
            self.command, self.commands_not_ok = np.full(size, np.nan), np.zeros(size[0], int)
        self._threads, self._has_no_memory = local(), False
        self._prepare()

    def _prepare(self) -> None:
        """Choose the method, by the first run that can begin, and make the lanes if there are."""
        scene, how = self.scene, self.how
        first, state = self._first()
        self._model = scene.model if first is None else scene.model_of(first)
        equation = self._equation(self._model, "auto", ())
        method = how.method
        span = self.spans[0]
        if method is None:
            if state is None or first is None:
                self.choice = Choice("auto", "tolerance", how.tolerance, "no run can begin", "none")
                return
            held = scene.held_inputs(first, first + 1, span, parameters=False)[0]
            chosen = choose(equation, state, held, scene.duration, how.tolerance, how.step)
            method = METHODS[chosen.method]
        elif how.step is not None:
            chosen = Choice(method.name, "step", how.step, "asked for")
        else:
            chosen = Choice(method.name, "tolerance", how.tolerance, "asked for")
        if chosen.setting not in method.settings:
            raise ValueError(
                f"method {method.name!r} is set by {method.setting}: give step for a method with "
                "fixed steps, and none for one that chooses its own by tolerance"
            )
        if scene.pieces.degree and not method.follows:
            raise ValueError(
                f"method {method.name!r} takes inputs that are constant over a step only, but "
                "an input changes in time"
            )
        self._method = method
        self._project = how.project if method.drifts or how.method is not None else None
        self.choice = chosen
        steps = isinstance(method.make, type) and issubclass(method.make, FixedStep)
        self._shares = not scene.parameters or (steps and self._can_share(equation))
        self._has_no_memory = steps and self._shares
        self._lanes = None
        if self._shares:
            shared = self._equation(scene.model, "auto", tuple(scene.parameters))
            if method.differentiates and shared.form == "loops":
                shared = self._equation(scene.model, "mapped", ())
            self._shared = shared
            if how.machine_code and steps:
                plain = self._integrator(shared, machine_code=False)
                self._lanes = Lanes.of(plain, shared, self._projects)
        if self._lanes is not None:
            back_end = self._lanes.back_end
        elif self._shares:
            back_end = self._integrator(self._shared, how.machine_code).back_end
        else:
            back_end = "a model built for each run"
        self.choice = replace(chosen, back_end=back_end)

    @property
    def _projects(self) -> bool:
        method = self._method
        if not method.drifts:
            return False
        return method.projects if self._project is None else self._project

    def _first(self) -> tuple[int | None, FloatArray | None]:
        for run in range(self.scene.count):
            states, refused = self.scene.states(run, run + 1)
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

    def _can_share(self, equation: Equation) -> bool:
        """Whether one compiled function takes the parameters of all runs as inputs."""
        given, structure = self.scene.given, self.scene.model.structure
        if equation.form != "flat" or (structure.blocks and set(MASSES) & set(given)):
            return False
        damping = given.get("damping")
        # Strings without any damping have simpler equations.
        return damping is None or bool((damping > 0).any(axis=1).all())

    def _integrator(self, equation: Equation, machine_code: bool) -> Integrator:
        return self._method.integrator(
            equation, self.choice.value, self.choice.setting, self._project, machine_code
        )

    # ---- blocks ----

    def run(self, threads: int, report: Callable[[float], None]) -> None:
        """Do all runs; if stopped, give up those that are not done."""
        states = 2 * len(self.scene.model.structure.free_rows)
        outputs = max(span.outputs for span in self.spans)
        most = _BLOCK if self._controller is None else MOST_CONTROLLERS
        block = int(np.clip(_MOST_NUMBERS / (states * outputs), 4, most))
        # So that all threads have work to the end.
        block = max(4, min(block, -(-self.scene.count // (4 * threads))))
        todo = iter(range(0, self.scene.count, block))
        pending: set[Future[int]] = set()
        with ThreadPoolExecutor(threads) as pool:
            try:
                while True:
                    check()
                    while len(pending) < 2 * threads and (first := next(todo, None)) is not None:
                        last = min(first + block, self.scene.count)
                        pending.add(pool.submit(self._block, first, last))
                    if not pending:
                        return
                    ended, pending = wait(pending, _POLL, FIRST_COMPLETED)
                    self.done += sum(future.result() for future in ended)
                    report(self.done)
            finally:
                self._stop.value = 1

    def _block(self, first: int, last: int) -> int:
        """Do some runs; return how many were done, whatever became of them."""
        states, refused = self.scene.states(first, last)
        self.messages.update(refused)
        self._keep(np.arange(first, last), 0, states[:, None])
        self.nodes[list(refused)] = self.velocities[list(refused)] = np.nan
        at = np.setdiff1d(np.arange(first, last), list(refused))
        states = states[at - first]
        column = 1
        if not self._has_no_memory:
            self._threads.__dict__.pop("made", None)
        loops = self._loops(last - first)
        for number, span in enumerate(self.spans):
            if not len(at) or self._stop.value:
                break
            held = self.scene.held_inputs(first, last, span, self._shares)
            held = held[at - first] if len(held) > 1 else held
            if loops is not None:
                at, states, held = self._commanded(loops, at, at - first, states, held, number)
                if not len(at):
                    break
            advance = self._in_lanes if self._lanes is not None else self._one_by_one
            kept, ended = advance(at, states, held, span)
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

    def _loops(self, runs: int) -> CompiledLoops | None:
        """Return the controllers of so many runs, which remember nothing; None if there is none."""
        if self._controller is None:
            return None
        loops: CompiledLoops | None = self._threads.__dict__.get("loops")
        if loops is None:
            loops = CompiledLoops(self._controller, self.scene.model.structure)
            self._threads.loops = loops
        loops.reset(runs)
        return loops

    def _commanded(
        self, loops: CompiledLoops, at: IntArray, places: IntArray, states: FloatArray,
        held: FloatArray, number: int,
    ) -> tuple[IntArray, FloatArray, FloatArray]:  # fmt: skip
        """Return the runs that go on in a sample, their states, and their inputs."""
        away, start = np.abs(states).max(axis=1) > LARGEST, self.spans[number].start
        for run in at[away]:
            self._end(run, start, f"the motion has run away, beyond {LARGEST:g} in m and m/s")
        if len(held) > 1:
            held = held[~away]
        at, states = at[~away], states[~away]
        found, failed = loops.commands(start, states, places[~away])
        assert self.command is not None  # made with the controller
        assert self.commands_not_ok is not None  # and this too
        self.command[at, :, number] = found
        self.commands_not_ok[at] += failed
        held = np.repeat(held, len(at), axis=0) if len(held) == 1 else held.copy()
        held[:, : found.shape[1]] = found
        return at, states, held

    def _in_lanes(
        self, at: IntArray, states: FloatArray, held: FloatArray, span: InputSpan
    ) -> tuple[FloatArray, np.ndarray]:
        """Return the states at the outputs of a span, and which runs ended in it."""
        assert self._lanes is not None  # asked by _block
        kept, good, counts = self._lanes.advance(
            states, held, span.length, span.outputs, self._stop
        )
        inner = self._lanes.steps_between(span.length, span.outputs)
        total = span.outputs * inner
        ended = good < total
        step = span.length / total
        for i in np.flatnonzero(ended):
            kept[i, good[i] // inner :] = np.nan
            if not self._stop.value:
                self._end(at[i], span.start + step * good[i], not_finite(int(good[i]), step))
        self.switches[at] += counts[:, 2].astype(int)
        self.unlocated[at] += counts[:, 3].astype(int)
        return kept, ended

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
                found = integrator.advance(states[i], u, span.length, span.outputs, report)
                ended[i] = False
            except IntegrationError as error:
                found = error.span
                self._end(run, span.start + error.time, str(error))
            except _StopError:
                break
            kept[i, : found.states.shape[1]] = found.states.T
            self.switches[run] += found.work.switches
            self.unlocated[run] += found.work.unlocated
        return kept, ended

    def _of_run(self, run: int) -> Integrator:
        """Return the integrator of a run: the same in all its spans, as it may remember.

        One with fixed steps has no memory, and serves all runs of a thread.
        """
        key = -1 if self._has_no_memory else run
        made: dict[int, Integrator] = self._threads.__dict__.setdefault("made", {})
        if key not in made:
            if len(self.spans) == 1:
                made.clear()
            made[key] = self._made_for(run)
        return made[key]

    def _made_for(self, run: int) -> Integrator:
        """Return a new integrator: of the equation that all share, or of the run's own."""
        code = self.how.machine_code
        if self._shares:
            return self._integrator(self._shared, code)
        equation = self._equation(self.scene.model_of(run), "auto", ())
        if self._method.differentiates and equation.form == "loops":
            equation = self._equation(self.scene.model_of(run), "mapped", ())
        return self._integrator(equation, code)

    def _end(self, run: int, time: float, why: str) -> None:
        self.end_time[run] = time
        self.messages[int(run)] = why

    def _keep(self, runs: IntArray, column: int, states: FloatArray) -> None:
        """Enter states, shape (runs, outputs, states), from a column of the result on."""
        d = self.scene.model.structure.dimension
        count, outputs, size = states.shape
        free = self._from >= 0
        for array, half, rest in (
            (self.nodes, states[:, :, : size // 2], self._fixed),
            (self.velocities, states[:, :, size // 2 :], np.zeros(len(free))),
        ):
            entries = np.broadcast_to(rest, (count, outputs, len(free))).copy()
            entries[:, :, free] = half[:, :, self._from[free]]
            shaped = entries.reshape(count, outputs, -1, d).transpose(0, 3, 2, 1)
            array[runs, :, :, column : column + outputs] = shaped

    def batch(self) -> Batch:
        """Return what was found."""
        left = ~self.completed
        for run in np.flatnonzero(left).tolist():
            self.messages.setdefault(run, _INTERRUPTED)
        return Batch(
            self.scene.model.structure, self.time, self.nodes, self.velocities, self.kept,
            self.completed, self.end_time, dict(sorted(self.messages.items())), self.switches,
            self.unlocated, self.choice, self.command, self.commands_not_ok,
        )  # fmt: skip
