"""Many runs of one scene at once: starts, inputs, loads and parameters that differ from run to run.

Runs go in blocks to threads. By dop853 and rk4 a block is a call of the compiled core, which takes
steps of several runs by one instruction. Else each run is a call of the integrator. Runs with
driven bars, winches, estimators, faults or moving supports go one after another by
:func:`simulate`. The numbers are those of single runs, to the last bit.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.integrate.methods import Choice
from tenscontrol.interrupt import keeping
from tenscontrol.progress import progress_bar
from tenscontrol.properties import cached_property
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.batch.batch_inputs import (
    BatchInputs,
    checked_variation,
    refusal,
    single_runs_of,
)
from tenscontrol.simulation.batch.compiled_loop import checked_controller
from tenscontrol.simulation.batch.runner import Runner
from tenscontrol.simulation.batch.single_runs import SingleRuns
from tenscontrol.simulation.health import ERROR_LIMIT, AccuracyWarning, HealthLimits
from tenscontrol.simulation.health_check import check_health, finer
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.structure import Structure
from tenscontrol.warn import warn

_INTERRUPTED = "interrupted"

# Runs whose error is estimated, and that are named in a warning.
_SAMPLE, _NAMED = 32, 8


@dataclass(frozen=True, eq=False)
class BatchCrossings:
    """Bars that pass through each other in the runs of a batch.

    Attributes
    ----------
    count : ndarray of int, shape (runs,)
        How many times.
    first_time : ndarray, shape (runs,)
        When bars cross first, s; NaN where none do.
    unresolved_intervals : ndarray of int, shape (runs,)
        Intervals between outputs in which bars may cross unseen, as in :class:`Health`.
    """

    count: IntArray
    first_time: FloatArray
    unresolved_intervals: IntArray

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)


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
    switches, missed : ndarray of int, shape (runs,)
        As in :class:`Work`.
    choice : Choice
        Method and step, and what ran them.
    command : ndarray, shape (runs, α, samples), or None
        Of the controller, N/m or m; NaN where a run had ended. None without a controller.
    commands_not_ok : ndarray of int, shape (runs,), or None
        How many commands had another status than ``Status.OK``.
    error : ndarray, shape (runs, K), or None
        Estimate of the error of the nodes kept, as :attr:`Trajectory.error`; NaN for runs that were
        not looked at, or did not reach the end. None where it was left out.
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
    missed: IntArray
    choice: Choice
    command: FloatArray | None = None
    commands_not_ok: IntArray | None = None
    error: FloatArray | None = None
    _runner: Runner | SingleRuns | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for value in vars(self).values():  # not copied: they may be large
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        object.__setattr__(self, "messages", MappingProxyType(dict(self.messages)))

    def trajectory(self, run: int, limits: HealthLimits | None = None) -> Trajectory:
        """Return a run as :func:`simulate` does, with its health; without a control record.

        Parameters
        ----------
        run : int
        limits : HealthLimits, optional
            As in :func:`simulate`; :attr:`Trajectory.health` is not looked at if not given.

        Raises
        ------
        ValueError
            If the run did not reach the end, or not all nodes were kept. Of runs that are done
            together, if there is ground, or inputs change in time other than by a controller.
        SimulationError
            If the motion passes a limit with ``action="raise"``.
        """
        run = validation.whole_number("run", run, 0, len(self.completed) - 1)
        if limits is not None:
            how = "make them by HealthLimits(bar_length_error=...)"
            validation.instance("limits", limits, HealthLimits, how)
        assert self._runner is not None  # made by simulate_many
        why = self._runner.lack()
        if not self.completed[run]:
            why = f"ended early: {self.messages[run]}"
        elif len(self.kept_nodes) < self.structure.nodes.shape[1]:
            why = "has some of its nodes only: leave keep_nodes out"
        if why is not None:
            raise ValueError(f"run {run} {why}")
        trajectory = self._runner.trajectory(run)
        if limits is not None:
            check_health(trajectory, limits)
        return trajectory

    def scene_of(self, run: int) -> Scene:
        """Return the scene of a run, which simulates it alone.

        Parameters
        ----------
        run : int

        Returns
        -------
        Scene
        """
        run = validation.whole_number("run", run, 0, len(self.completed) - 1)
        assert self._runner is not None  # made by simulate_many
        return self._runner.scene.scene_of(run)

    @cached_property
    def crossings(self) -> BatchCrossings | None:
        """Bars that pass through each other, run by run; None in the plane and for a single bar.

        It is looked for when it is first read. Where outputs are too far apart to tell, the motion
        between them is integrated again, at about the cost of the run; but not if start and end
        alone are kept under inputs that change.

        Raises
        ------
        ValueError
            If not all nodes were kept.
        """
        if self.structure.dimension == 2 or len(self.structure.bars) < 2:
            return None
        if len(self.kept_nodes) < self.structure.nodes.shape[1]:
            raise ValueError("runs have some of their nodes only: leave keep_nodes out")
        assert self._runner is not None  # made by simulate_many
        runs = [self._runner.bars(run) for run in range(len(self.completed))]
        first = [motion.crossings[0].time if motion.crossings else np.nan for motion in runs]
        return BatchCrossings(
            np.array([len(motion.crossings) for motion in runs]),
            np.array(first),
            np.array([motion.unresolved for motion in runs]),
        )

    def __repr__(self) -> str:
        done, runs = int(self.completed.sum()), len(self.completed)
        return f"Batch({done} of {runs} runs to {self.time[-1]:g} s, {self.choice.method})"


def simulate_many(
    scene: Scene,
    vary: Mapping[str, object],
    keep_nodes: object = None,
    *,
    threads: int | None = None,
    error: str = "sample",
    progress: bool = False,
) -> Batch:
    """Return the motions of many runs of a scene: open loops, or loops closed by compiled code.

    The numbers are those of :meth:`Scene.simulate` run by run, to the last bit, with the same
    method and step. Runs with driven bars, winches, an estimator, faults or moving supports are
    done by it, one after another, under any controller; the others together, in threads.

    Parameters
    ----------
    scene : Scene
        What runs have in common. Its controller, if it has one, is compiled code:
        ``generate_c(controller, folder).compile()``, where runs are done together. Each run has its
        own, from a fresh start; commands are held over a sample as they are. A ``start`` is left to
        :meth:`Scene.simulate`. Of its integration, ``"auto"`` chooses once, for the first run, or
        for each of runs that are done one after another; without ``output_step`` start and end
        alone are kept; ``limits`` are not looked at.
    vary : mapping of str to array_like
        What differs from run to run, in place of what the scene has, by name: ``"nodes"``,
        ``"velocities"`` and ``"external_force"``, shape (runs, d, n), in m, m/s and N; what is held
        in open loop, ``"rest_length"``, m, or ``"force_density"``, N/m, shape (runs,) or (runs, α);
        of bars that are driven, lengths that are held or at the start, ``"bar_length"``, m, shape
        (runs,) or (runs, β); under a controller with winches ``"rest_length"`` at the start, and
        numbers of their motors, as ``"motor.torque"``, shape (runs,) or (runs, α);
        and parameters of the model, shape (runs,) or (runs, members): ``"bar_mass"``,
        ``"point_mass"`` (members are nodes), kg, those of the string law such as ``"stiffness"``
        and ``"damping"``, ``"gravity"`` (members are axes), and numbers of the contact law, as
        ``"ground.friction"``, of several as ``"ground[0].friction"``.
    keep_nodes : array_like of int, or of bool, shape (n,), optional
        Nodes that are kept, or a mask of them; all if not given.
    threads : int, optional
        All processors if not given.
    error : {"sample", "all", "none"}
        Of which runs the error is estimated, by a second run at another resolution: of 32, spread
        evenly, of all, or of none. None if the integration of the scene says so.
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
    AccuracyWarning
        If the error of runs that were looked at passes 1 % of the size; it names them.
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
    >>> how = tc.Integration(step=5e-3)
    >>> scene = tc.Scene(model, 0.5, rest_length=start, integration=how)
    >>> factors = np.linspace(0.9, 1.0, 100)
    >>> batch = tc.simulate_many(scene, {"rest_length": factors[:, None] * start})
    >>> batch.nodes.shape, int(batch.completed.sum())
    ((100, 3, 6, 2), 100)
    """
    validation.instance("scene", scene, Scene, "make one by Scene(model, duration, ...)")
    validation.truth("progress", progress, "whether to show a progress bar")
    validation.choice("error", error, ("sample", "all", "none"))
    threads = _processors() if threads is None else validation.whole_number("threads", threads, 1)
    is_alone = single_runs_of(scene) is not None
    if scene.start is not None:
        raise ValueError("many runs begin at 0 s, but the scene has a start: simulate goes on")
    if not is_alone:
        if scene.law is not None:
            checked_controller(scene.controller, scene.model)
        why = refusal(scene)
        if why is not None:
            raise ValueError(
                f"many runs of this scene are not done together: {why}; simulate does each"
            )
    inputs = BatchInputs(scene, checked_variation(scene, vary))
    structure = scene.structure
    kept = np.arange(structure.nodes.shape[1])
    if keep_nodes is not None:
        kept = validation.index_list("keep_nodes", keep_nodes, len(kept), "nodes")
    runner: Runner | SingleRuns | None = None
    errors = None
    with keeping("runs are done, the others are NaN", lambda: 0 if runner is None else runner.done):
        runner = SingleRuns(inputs, kept) if is_alone else Runner(inputs, kept)
        with progress_bar(inputs.count, progress, label="simulating", unit="runs") as report:
            runner.run(threads, report)
        if error != "none" and scene.integration.error != "none":
            runs = np.flatnonzero(runner.completed)
            if error == "sample" and len(runs) > _SAMPLE:
                runs = runs[np.linspace(0, len(runs) - 1, _SAMPLE).round().astype(int)]
            with progress_bar(
                len(runs), progress, label="estimating errors", unit="runs"
            ) as report:
                errors = runner.estimate_errors(runs, threads, report)
    if errors is not None:
        _warn_of_errors(errors, runner.choice)
    messages = dict.fromkeys(np.flatnonzero(~runner.completed).tolist(), _INTERRUPTED)
    messages = dict(sorted((messages | runner.messages).items()))
    return Batch(
        structure, runner.time, runner.nodes, runner.velocities, kept, runner.completed,
        runner.end_time, messages, runner.switches, runner.missed, runner.choice,
        runner.command, runner.commands_not_ok, errors, runner,
    )  # fmt: skip


def _processors() -> int:
    """Return the number of processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def _warn_of_errors(errors: FloatArray, used: Choice) -> None:
    """Warn of runs whose error passes its limit."""
    looked_at = np.isfinite(errors[:, 0])
    wrong = np.flatnonzero((errors > ERROR_LIMIT).any(axis=1))
    if len(wrong):
        named = ", ".join(map(str, wrong[:_NAMED].tolist())) + ", …" * (len(wrong) > _NAMED)
        warn(
            f"the error of {len(wrong)} of the {looked_at.sum()} runs that were looked at passes "
            f"{ERROR_LIMIT:g} of the size: of {named}. batch.error says when. Try {finer(used)}",
            AccuracyWarning,
        )
