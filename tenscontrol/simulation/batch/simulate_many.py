"""Many runs of one model at once: starts, inputs, loads and parameters that differ from run to run.

Runs go in blocks to threads. By rk4 a block is one call of the compiled core, which takes a step of
several runs by one instruction. Else each run is a call of the integrator. The numbers are those of
single runs, to the last bit.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.control.controller import Controller
from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.methods import Choice, Method
from tenscontrol.interrupt import keeping
from tenscontrol.plant.equilibrium import own_input
from tenscontrol.progress import progress_bar
from tenscontrol.properties import cached_property
from tenscontrol.simulation.batch.batch_inputs import BatchInputs, given_by_run
from tenscontrol.simulation.batch.compiled_loop import checked_controller
from tenscontrol.simulation.batch.runner import Runner
from tenscontrol.simulation.health import ERROR_LIMIT, AccuracyWarning, HealthLimits
from tenscontrol.simulation.health_check import check_health, finer
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.structure import Structure

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
    _runner: Runner | None = field(default=None, repr=False)

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
            If the run did not reach the end, not all nodes were kept, there is ground, or inputs
            change in time other than by a controller.
        SimulationError
            If the motion passes a limit with ``action="raise"``.
        """
        run = validation.whole_number("run", run, 0, len(self.completed) - 1)
        if limits is not None:
            how = "make them by HealthLimits(bar_length_error=...)"
            validation.instance("limits", limits, HealthLimits, how)
        assert self._runner is not None  # made by simulate_many
        scene, why = self._runner.scene, None
        if not self.completed[run]:
            why = f"ended early: {self.messages[run]}"
        elif len(self.kept_nodes) < self.structure.nodes.shape[1]:
            why = "has some of its nodes only: leave keep_nodes out"
        elif scene.model.ground or not scene.pieces.is_constant:
            why = "has ground, or inputs that change in time: simulate gives its trajectory"
        if why is not None:
            raise ValueError(f"run {run} {why}")
        found = self._runner.trajectory(run)
        if limits is not None:
            check_health(found, limits)
        return found

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
        runs = [self._runner.bars(run).searched() for run in range(len(self.completed))]
        first = [each.crossings[0].time if each.crossings else np.nan for each in runs]
        return BatchCrossings(
            np.array([len(each.crossings) for each in runs]),
            np.array(first),
            np.array([each.unresolved for each in runs]),
        )

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
    threads: int | None = None,
    error: str = "sample",
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
    keep_nodes : array_like of int, or of bool, shape (n,), optional
        Nodes that are kept, or a mask of them; all if not given.
    threads : int, optional
        All processors if not given.
    error : {"sample", "all", "none"}
        Of which runs the error is estimated, by a second run at another resolution: of 32, spread
        evenly, of all, or of none.
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
    >>> factors = np.linspace(0.9, 1.0, 100)
    >>> batch = tc.simulate_many(model, 0.5, rest_length=factors[:, None] * start, step=5e-3)
    >>> batch.nodes.shape, int(batch.completed.sum())
    ((100, 3, 6, 2), 100)
    """
    validation.instance("model", model, Model, "make one by Model(structure)")
    integration = Integration(method, tolerance, step, output_step, project, error="none")
    validation.truth("progress", progress, "whether to show a progress bar")
    validation.choice("error", error, ("sample", "all", "none"))
    threads = _processors() if threads is None else validation.whole_number("threads", threads, 1)
    inputs, law = _inputs(model, rest_length, force_density, controller)
    given = given_by_run(
        model, vary, nodes=nodes, velocities=velocities, external_force=external_force, **inputs
    )
    base = Scene(
        model, duration, **_nominal(model, inputs | {"external_force": external_force}, given),
        integration=integration,
    )  # fmt: skip
    scene = BatchInputs(base, given)
    kept = np.arange(model.structure.nodes.shape[1])
    if keep_nodes is not None:
        kept = validation.index_list("keep_nodes", keep_nodes, len(kept), "nodes")
    runner = errors = None
    with keeping("runs are done, the others are NaN", lambda: 0 if runner is None else runner.done):
        runner = Runner(scene, kept, law)
        with progress_bar(scene.count, progress, label="simulating", unit="runs") as report:
            runner.run(threads, report)
        if error != "none":
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
        model.structure, runner.time, runner.nodes, runner.velocities, kept, runner.completed,
        runner.end_time, messages, runner.switches, runner.missed, runner.choice,
        runner.command, runner.commands_not_ok, errors, runner,
    )  # fmt: skip


def _processors() -> int:
    """Return the number of processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def _inputs(
    model: Model, rest_length: object, force_density: object, controller: object
) -> tuple[dict[str, object], Controller | None]:
    """Return what runs hold, by name, one of the two None, and the controller, checked."""
    if controller is None:
        rest_length, force_density = own_input(model, rest_length, force_density)
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
        rest = law.plant.string_values
        rest_length, force_density = (rest, None) if law.input == "rest_length" else (None, rest)
    return {"rest_length": rest_length, "force_density": force_density}, law


def _nominal(model: Model, values: dict[str, Any], given: dict[str, FloatArray]) -> dict[str, Any]:
    """Return arguments of the scene that runs vary: of what differs something that it can have."""
    usual = {
        "rest_length": np.ones(len(model.structure.strings)),
        "force_density": np.zeros(len(model.structure.strings)),
        "external_force": 0.0,
    }
    stacked = [
        name for name in usual if name in given and np.ndim(values[name]) == given[name].ndim
    ]
    return values | {name: usual[name] for name in stacked}


def _warn_of_errors(errors: FloatArray, used: Choice) -> None:
    """Warn of runs whose error passes its limit."""
    looked_at = np.isfinite(errors[:, 0])
    wrong = np.flatnonzero((errors > ERROR_LIMIT).any(axis=1))
    if len(wrong):
        named = ", ".join(map(str, wrong[:_NAMED].tolist())) + ", …" * (len(wrong) > _NAMED)
        warnings.warn(
            f"the error of {len(wrong)} of the {looked_at.sum()} runs that were looked at passes "
            f"{ERROR_LIMIT:g} of the size: of {named}. batch.error says when. Try {finer(used)}",
            AccuracyWarning,
            stacklevel=3,
        )
