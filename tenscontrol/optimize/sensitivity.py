"""Derivatives of a run's motion, or of its costs, by what it depends on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, overload

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics.evaluator import Evaluator, Function, builds
from tenscontrol.fields import changed
from tenscontrol.integrate.methods import Choice
from tenscontrol.optimize.feedback import regulator_of
from tenscontrol.optimize.parameters import parameters_of
from tenscontrol.optimize.run_variations import RunVariations
from tenscontrol.optimize.variations import IMPLICIT
from tenscontrol.properties import cached_property
from tenscontrol.simulation.batch.simulate_many import Batch
from tenscontrol.simulation.health import HealthLimits
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.tables import aligned

# The methods that can be differentiated, and the one in place of what a tolerance leaves open.
_METHODS = ("rk4", "dop853", IMPLICIT)

# With a tolerance, the steps that are differentiated are those of this part of it: a pair of
# switches that they pass over costs a motion little, and its derivatives per cents. The second is
# about the least that double precision is good for.
_TIGHTER, _TIGHTEST = 1e-3, 1e-12
_LIMITS = HealthLimits(crossings=None)


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity:
    """Derivatives of a motion by what it depends on. Made by :func:`sensitivity`.

    Attributes
    ----------
    run : Trajectory
        The motion that is differentiated.
    time : ndarray, shape (T,)
        s.
    nodes, velocities : mapping of str to ndarray, shape (d, n, T, ...)
        Derivatives of the nodes, m, and of their velocities, m/s, by each parameter; the last axes
        are those of the parameter.
    switches : int
        Switches of strings and contacts that the derivatives take into account; 0 of implicit
        steps, which do not end there.
    grazing : tuple of float
        Times of switches that are passed so slowly that a run next to it may not have them, s: the
        derivative holds for smaller changes only.
    """

    run: Trajectory
    time: FloatArray
    nodes: Mapping[str, FloatArray]
    velocities: Mapping[str, FloatArray]
    switches: int
    grazing: tuple[float, ...]
    _to: tuple[str, ...]
    _feedback: bool

    @cached_property
    def error(self) -> Mapping[str, FloatArray]:
        """Estimated error of the derivatives of the nodes by each parameter, shape (T,).

        As part of the largest at that time: the difference from those of the same run at ten times
        the tolerance, in steps longer where stability limits them, or twice the step. Found when it
        is first read, in about the time that the derivatives took.
        """
        other = _differentiable(self.run, self._to, self.time, self._feedback, looser=True)
        again, errors = _derivatives(other)[0], dict[str, FloatArray]()
        for name, by in self.nodes.items():
            rows = tuple(i for i in range(by.ndim) if i != 2)
            off, size = (np.abs(array).max(axis=rows) for array in (by - again[name], by))
            errors[name] = frozen(off / np.maximum(size, np.finfo(float).tiny))
        return MappingProxyType(errors)

    @property
    def trusted_until(self) -> float | None:
        """Time up to which the run itself can be trusted, s; beyond, so is its derivative not."""
        return self.run.trusted_until

    def table(self) -> str:
        """Return the largest derivatives of the nodes at the last time, as text."""
        rows = []
        for name, by in self.nodes.items():
            last = np.abs(by[:, :, -1])
            place = np.unravel_index(int(last.argmax()), last.shape)
            axis, node, *entry = (int(i) for i in place)
            rows.append(
                [name, f"{last.max():.4g}", f"{'xyz'[axis]} of node {node}",
                 ", ".join(map(str, entry)) or "-"]
            )  # fmt: skip
        return aligned(["parameter", "largest", "of", "by entry"], rows)

    def __repr__(self) -> str:
        names = ", ".join(f"{name} {by.shape[3:]}" for name, by in self.nodes.items())
        until = f"{len(self.time)} times up to {self.time[-1]:g} s"
        return f"Sensitivity(by {names}; {until}, {self.switches} switches)"


@dataclass(frozen=True, eq=False, repr=False)
class BatchSensitivity:
    """Derivatives of the motions of a batch. Made by :func:`sensitivity`.

    Attributes
    ----------
    batch : Batch
    time : ndarray, shape (T,)
        s.
    nodes, velocities : mapping of str to ndarray, shape (runs, d, n, T, ...)
        As of :class:`Sensitivity`, with a first axis of runs; NaN of runs that did not reach the
        end.
    switches : ndarray of int, shape (runs,)
    grazing : tuple of tuple of float
        One a run.
    """

    batch: Batch
    time: FloatArray
    nodes: Mapping[str, FloatArray]
    velocities: Mapping[str, FloatArray]
    switches: IntArray
    grazing: tuple[tuple[float, ...], ...]

    def __repr__(self) -> str:
        names = ", ".join(f"{name} {by.shape[4:]}" for name, by in self.nodes.items())
        until = f"{len(self.time)} times up to {self.time[-1]:g} s"
        return f"BatchSensitivity({len(self.switches)} runs by {names}; {until})"


@dataclass(frozen=True, eq=False, repr=False)
class Gradient:
    """A cost of a run and its derivatives. Made by :func:`gradient`.

    Attributes
    ----------
    run : Trajectory
    value : float
        The cost.
    slope : mapping of str to ndarray
        Its derivative by each parameter, in the shape of the parameter.
    switches : int
    grazing : tuple of float
        As of :class:`Sensitivity`.
    """

    run: Trajectory
    value: float
    slope: Mapping[str, FloatArray]
    switches: int
    grazing: tuple[float, ...]

    def __repr__(self) -> str:
        names = ", ".join(f"{name} {by.shape}" for name, by in self.slope.items())
        return f"Gradient({self.value:.6g}, by {names}, {self.switches} switches)"


@overload
def sensitivity(
    run: Trajectory, to: object, times: object = None, *, feedback: bool = False
) -> Sensitivity: ...


@overload
def sensitivity(
    run: Batch, to: object, times: object = None, *, feedback: bool = False
) -> BatchSensitivity: ...


def sensitivity(
    run: Trajectory | Batch, to: object, times: object = None, *, feedback: bool = False
) -> Sensitivity | BatchSensitivity:
    """Return the derivatives of a run by what it depends on, through its switches.

    The steps of the run are differentiated as they were taken. So are the switches at which strings
    go slack or taut and contacts open or close. One pass gives the derivatives by all parameters.

    Parameters
    ----------
    run : Trajectory or Batch
        Made by :func:`simulate` or :func:`simulate_many`, of the methods "auto", "rk4", "dop853" or
        "energy_momentum".
    to : list of str
        What to differentiate by: ``"nodes"`` and ``"velocities"`` at the start; the input,
        ``"rest_length"`` or ``"force_density"``; parameters of the string law, as ``"stiffness"``
        and ``"damping"``; ``"bar_mass"``, ``"point_mass"``, ``"gravity"``, ``"external_force"``;
        those of the ground, as ``"ground.stiffness"``, or ``"ground[1].friction"`` of several;
        ``"support_motion"``, a displacement or the values of a :class:`Profile`, (d, fixed, K);
        ``"bar_length"`` of driven bars, lengths that are held or the values of a profile, (β, K);
        numbers of winches, ``"winches.rate"``, ``"motor.drum_radius"``, ``"motor.gear_ratio"``,
        ``"motor.torque"``, ``"motor.speed"``, ``"motor.inertia"``, ``"motor.lag"`` and
        ``"motor.backlash"``, where rest lengths are held; with ``feedback`` the
        ``"gain"`` of an LQR.
    times : float or array_like, shape (T,), optional
        Ascending, s; the end of the run if not given.
    feedback : bool
        Whether the commands of an LQR answer the changes, where they are within their bounds; they
        stay as they were if not.

    Returns
    -------
    Sensitivity, or BatchSensitivity of a batch

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, a name is not one of the run's parameters, or the run
        cannot be differentiated: by another method, or a copy or from a file.

    Notes
    -----
    Of an input that is a :class:`Profile` the derivatives are those by its values, shape (α, K); of
    a controller's, by a change over each of its samples, with its commands as they were. A change
    of the nodes or velocities at the start is projected onto what keeps the bars' lengths, as
    :func:`simulate` does. A change of a mass changes its weight, too. A displacement of supports
    moves the nodes with it that bars join to them, at the start, too. A bar that has another length
    at the start has its nodes put on it, as in :func:`simulate`. Numbers of motors, all
    positive, change what strings are given under the same commanded rest lengths; of strings that
    share a winch that of the first counts, and ``"winches.rate"`` is no parameter. Motors with
    inertia, or that meet their torque, feel changes of the motion: what they wind is differentiated
    as it was computed, part by part of a sample. The input is then a string's length in addition
    to what its motor winds. Through such motors there is no derivative with ``feedback``, nor by
    ``"support_motion"``.

    Where a damped string goes taut, its force jumps, and the derivatives with it. Elsewhere forces
    are continuous. The steps are those of the run, or of a thousandth of its tolerance: a pair of
    switches that is passed over costs a motion little, and its derivatives per cents.
    :attr:`Sensitivity.error` estimates what is left. Steps of "energy_momentum" are differentiated
    as they are, and go through switches without an end there: where a damped string goes taut
    their error is of order 1 in the step.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.5))
    >>> run = tc.simulate(model, 1.0, rest_length=0.9 * tc.prism().string_length())
    >>> tangent = tc.sensitivity(run, ["rest_length", "stiffness"])
    >>> tangent.nodes["rest_length"].shape
    (3, 6, 1, 9)
    """
    if isinstance(run, Batch):
        return _of_batch(run, to, times, feedback)
    work = _differentiable(run, to, times, feedback)
    nodes, velocities = _derivatives(work)
    names = tuple(parameter.name for parameter in work.parameters)
    return Sensitivity(
        run, frozen(work.times), MappingProxyType(nodes), MappingProxyType(velocities),
        work.variations.switches, work.variations.grazing, names, feedback,
    )  # fmt: skip


def _of_batch(batch: Batch, to: object, times: object, feedback: bool) -> BatchSensitivity:
    runs = np.flatnonzero(batch.completed)
    if not len(runs):
        raise ValueError("run is a batch of which no run reached its end")
    first = batch.scene_of(int(runs[0]))
    if first.law is not None:
        raise ValueError("run is a batch under a controller: simulate gives runs for sensitivity")
    checked, at = parameters_of(first, to), _checked_times(batch.time, times)
    count, shape = len(batch.completed), (*batch.structure.nodes.shape, len(at))
    size = 16 * int(np.prod(shape)) * sum(by.size for by in checked)
    validation.refuse_memory("a derivative", count, "runs", size, ". Take fewer times or runs")
    nodes, velocities = (
        {by.name: np.full((count, *shape, *by.shape), np.nan) for by in checked} for _ in range(2)
    )
    switches = np.zeros(count, dtype=int)
    grazing: list[tuple[float, ...]] = [()] * count
    for run in map(int, runs):
        work = _Differentiable(batch.scene_of(run), batch.choice, to, at, feedback)
        for arrays, own in zip((nodes, velocities), _derivatives(work), strict=True):
            for name, by in own.items():
                arrays[name][run] = by
        switches[run] = work.variations.switches
        grazing[run] = work.variations.grazing
    for array in (*nodes.values(), *velocities.values(), switches):
        array.setflags(write=False)
    return BatchSensitivity(
        batch, frozen(at), MappingProxyType(nodes), MappingProxyType(velocities), switches,
        tuple(grazing),
    )  # fmt: skip


def _derivatives(work: _Differentiable) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return the derivatives of nodes and velocities by each parameter."""
    structure, variations = work.structure, work.variations
    whole = variations.whole(variations.forward())
    nodes: dict[str, FloatArray] = {}
    velocities: dict[str, FloatArray] = {}
    d, n = structure.nodes.shape
    for parameter, columns in zip(work.parameters, variations.columns, strict=True):
        for rows, into in zip(whole, (nodes, velocities), strict=True):
            own = rows[..., columns].swapaxes(0, 1)
            own = own.reshape(n, d, len(rows), *parameter.shape).swapaxes(0, 1)
            into[parameter.name] = frozen(own)
    return nodes, velocities


def gradient(
    run: Trajectory, cost: Callable[[Any, Any, Any], Any], to: object, times: object = None,
    *, feedback: bool = False,
) -> Gradient:  # fmt: skip
    """Return a cost of a run and its derivatives by all parameters, in one pass backward.

    It takes about as long as a few runs, however many parameters there are.

    Parameters
    ----------
    run : Trajectory
        As of :func:`sensitivity`.
    cost : callable
        ``(time, nodes, velocities) -> cost``, one number, in CasADi: of a time, s, the nodes, m,
        and their velocities, m/s, shape (d, n). Added up over the times.
    to : list of str
        As of :func:`sensitivity`.
    times : float or array_like, shape (T,), optional
        As of :func:`sensitivity`, s.
    feedback : bool
        As of :func:`sensitivity`.

    Returns
    -------
    Gradient

    Raises
    ------
    TypeError, ValueError
        As :func:`sensitivity`, or if the cost is not a number in CasADi.

    Examples
    --------
    How high the prism stands after a second, by its rest lengths:

    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.5))
    >>> run = tc.simulate(model, 1.0, rest_length=0.9 * tc.prism().string_length())
    >>> height = lambda time, nodes, velocities: nodes[2, 3]
    >>> tc.gradient(run, height, ["rest_length"]).slope["rest_length"].shape
    (9,)
    """
    validation.function("cost", cost, "(time, nodes, velocities) -> a number in CasADi")
    work = _differentiable(run, to, times, feedback)
    structure = run.structure
    function = Evaluator(_cost_function(cost, structure.nodes.shape))
    value, count = 0.0, len(work.times)
    moved = np.stack([array.T.reshape(count, -1) for array in work.variations.nodes()], axis=2)
    costs = np.empty((2, count, structure.nodes.size))
    for i, time in enumerate(work.times):
        one, slopes = function(time, moved[i])
        value += float(one[0])
        costs[:, i] = slopes.T
    if not (np.isfinite(value) and np.isfinite(costs).all()):
        raise ValueError("cost or its slope is not finite at the motion of the run")
    of_states = np.concatenate(costs[:, :, structure.free_rows], axis=1)
    derivatives = work.variations.backward(of_states) + work.variations.cost_of_supports(*costs)
    slope = {
        parameter.name: frozen(derivatives[columns].reshape(parameter.shape))
        for parameter, columns in zip(work.parameters, work.variations.columns, strict=True)
    }
    of_run = work.variations
    return Gradient(run, value, MappingProxyType(slope), of_run.switches, of_run.grazing)


@builds
def _cost_function(cost: Callable[[Any, Any, Any], Any], shape: tuple[int, ...]) -> ca.Function:
    """Return ``(time, x) -> cost, slopes``: columns of nodes and velocities, (d n, 2) each."""
    time, state = ca.MX.sym("time"), ca.MX.sym("x", shape[0] * shape[1], 2)
    nodes, velocities = (ca.reshape(column, *shape) for column in ca.horzsplit(state))
    value = cost(time, nodes, velocities)
    if isinstance(value, (int, float, ca.DM)):
        value = ca.MX(value)
    if not isinstance(value, ca.MX) or value.numel() != 1:
        raise validation.wrong_kind(
            "what cost returns", value, "one number in CasADi, as ca.sumsqr(nodes - goal)"
        )
    slopes = ca.gradient(value, state)
    return Function("cost", [time, state], [ca.densify(value), ca.densify(slopes)])


def _differentiable(
    run: Trajectory, to: object, times: object, feedback: bool, looser: bool = False
) -> _Differentiable:
    """Return a run, checked, as it is differentiated."""
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    scene = run.scene
    if not isinstance(scene, Scene):
        raise ValueError(
            "run has no scene to be run again: it is a copy, from a file or a batch, or goes "
            "on from another run. Give one that simulate(...) returned"
        )
    if run.stopped is not None:
        raise ValueError(f"run {run.stopped}, expected one that reached its end")
    at = _checked_times(run.time, times)
    return _Differentiable(scene, run.choice, to, at, feedback, run.steps, looser)


class _Differentiable:
    """The run of a scene, traced again, with what carries its variations."""

    def __init__(
        self, scene: Scene, choice: Choice, to: object, times: FloatArray, feedback: bool,
        steps: int = 0, looser: bool = False,
    ) -> None:  # fmt: skip
        if scene.supports is not None and (feedback or choice.method == IMPLICIT):
            through = "a feedback" if feedback else "steps of the method 'energy_momentum'"
            raise ValueError(
                f"run has supports that move, and through {through} no derivative is taken then"
            )
        self.parameters = parameters_of(scene, to)
        validation.truth("feedback", feedback, "whether the commands of an LQR answer changes")
        if feedback:
            regulator_of(scene)
        elif any(parameter.kind == "gain" for parameter in self.parameters):
            raise ValueError("the gain acts by feedback: give feedback=True, too")
        self.times, self.structure = times, scene.structure
        able = _traceable(scene, choice)
        if looser:
            able = able.integrated(_looser(able.integration))
        expected = steps * (scene.integration.tolerance / able.integration.tolerance) ** (1 / 8)
        # Steps that stability limits are as long at ten times the tolerance, and no error showed.
        self.variations = RunVariations(
            able, self.parameters, times, feedback, expected, is_shortened=not looser
        )


def _traceable(scene: Scene, choice: Choice) -> Scene:
    """Return a scene by a method that can be traced, the same as in its run if it can."""
    how = scene.integration
    used = set(choice.methods)
    if how.method == "auto" and used != {IMPLICIT}:
        method = "rk4" if how.step is not None else "dop853"
    elif used <= set(_METHODS):
        method = choice.method
    else:
        raise ValueError(
            f"run is by the method {choice.method!r}, expected one of {list(_METHODS)}, or 'auto': "
            "'rk4_plain', 'cvodes' and methods of your own are not differentiated"
        )
    others: dict[str, Any] = {"method": method, "error": "none", "limits": _LIMITS}
    if method == "dop853":
        others["tolerance"] = max(how.tolerance * _TIGHTER, min(how.tolerance, _TIGHTEST))
        others["output_step"] = scene.duration
    return scene.integrated(changed(how, **others))


def _looser(how: Integration) -> Integration:
    """Return the same integration in steps of twice the length, or to ten times the tolerance."""
    if how.step is None:
        return replace(how, tolerance=10 * how.tolerance)
    step = 2 * how.step
    outputs = how.output_step
    return replace(how, step=step, output_step=None if outputs is None else max(outputs, step))


def _checked_times(time: FloatArray, times: object) -> FloatArray:
    if times is None:
        return time[-1:].copy()
    array = np.atleast_1d(validation.float_array("times", times))
    if array.ndim != 1 or not len(array):
        raise ValueError(f"times has shape {array.shape}, expected (T,): at least one time, s")
    first, last = float(time[0]), float(time[-1])
    if (np.diff(array) <= 0).any():
        raise ValueError("times do not ascend, expected each later than the one before, s")
    close = 1e-9 * (last - first)
    if array[0] < first - close or array[-1] > last + close:
        raise ValueError(
            f"times run from {array[0]:g} s to {array[-1]:g} s, expected times of the run, from "
            f"{first:g} s to {last:g} s"
        )
    return np.clip(array, first, last)
