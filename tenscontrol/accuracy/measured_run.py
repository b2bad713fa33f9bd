"""One measured run of one method: error, run time, work."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from statistics import median
from time import process_time
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.converged_motion import ConvergedMotion, largest_distance
from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.accuracy.peers.peer import Peer
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.dynamics.evaluator import Function, builds, evaluate_columns
from tenscontrol.integrate.integrator import Work, steps_between
from tenscontrol.integrate.methods import METHODS, Method
from tenscontrol.interrupt import check, interruptible
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.health import AccuracyWarning, HealthLimits
from tenscontrol.simulation.health_check import SimulationError
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.simulate import simulate
from tenscontrol.simulation.trajectory import Trajectory

# Steps by the fastest rate of the case, and tolerances, from coarse to fine.
_STEPS = tuple(2.0**-k for k in range(8))
_TOLERANCES = tuple(10.0**-k for k in range(3, 13))

# Time after which a run is not repeated any more, s.
_PATIENCE = 3.0

#: By how much the reference of a peer that has a law of its own is finer than its finest run.
FINER = 8.0

NOT_KNOWN = float("nan")

# ---- methods and their settings ----


def method_named(name: object, argument: str = "method") -> Method:
    """Return the method of this name, or raise ValueError."""
    return METHODS[validation.choice(argument, name, METHODS)]


def default_settings(method: Method, case: Scene) -> tuple[float, ...]:
    """Return steps that fit the case, s, coarse to fine; or tolerances."""
    if method.setting == "tolerance":
        return _TOLERANCES
    with interruptible():  # CasADi may lose a key while it builds
        rate = fastest_rate(case)
        check()
    return tuple(float(f"{share / rate:.3g}") for share in _STEPS)


def checked_settings(name: str, settings: object, unit: str) -> tuple[float, ...]:
    """Return the settings of an argument from coarse to fine, each once and positive."""
    given = validation.items(name, settings, f"numbers in {unit}")
    numbers = [
        validation.positive_number(f"{name}[{i}]", value, unit) for i, value in enumerate(given)
    ]
    if not numbers:
        raise ValueError(f"{name} is empty, expected at least one number in {unit}")
    return tuple(sorted(set(numbers), reverse=True))


def as_taken(method: Method, settings: Iterable[float], spacing: float) -> tuple[float, ...]:
    """Return steps, shortened to fit into the spacing of outputs, s, each once; or tolerances."""
    if method.setting == "tolerance":
        return tuple(settings)
    taken = [spacing / steps_between(spacing, step) for step in settings]
    return tuple(dict.fromkeys(taken))


# ---- what a motion conserves ----


@dataclass(frozen=True, eq=False)
class Invariants:
    """What a motion should conserve, at T times.

    Energies, J, (T,); momenta, kg m/s and, about the origin, kg m²/s, (3, T) each, in the plane
    (2, T) and (1, T); ``stretch``, (T,), the largest difference of a bar from its length, m.
    """

    kinetic: FloatArray
    potential: FloatArray
    momentum: FloatArray
    angular_momentum: FloatArray
    stretch: FloatArray

    @property
    def energy(self) -> FloatArray:
        """Kinetic and potential energy together, J, shape (T,)."""
        return self.kinetic + self.potential


def invariants(case: Scene, states: FloatArray) -> Invariants:
    """Return energies, momenta and bar-length errors of states, one a column."""
    model, structure = case.model, case.structure
    held = np.tile(case.input_value[:, None], (1, states.shape[1]))
    of_strings = model.potential_energy if case.input == "force_density" else model.elastic_energy
    (potential,) = evaluate_columns(of_strings, states, held)
    (kinetic,) = evaluate_columns(model.kinetic_energy, states)
    linear, angular = evaluate_columns(model.momentum, states)
    nodes, _ = unpack_states(structure, states)
    bars = nodes[:, structure.bars[:, 1]] - nodes[:, structure.bars[:, 0]]
    off = np.abs(np.linalg.norm(bars, axis=0) - structure.bar_length[:, None])
    work = np.einsum("in,int->t", case.load, nodes)
    if model.contacts is not None:
        potential = potential + _stored_in_ground(case, nodes)
    return Invariants(kinetic[0], potential[0] - work, linear, angular, off.max(axis=0, initial=0))


@builds
def _stored_in_ground(case: Scene, nodes: FloatArray) -> FloatArray:
    """Return what contacts store, J, shape (T,), at positions of all nodes, m, (d, n, T)."""
    d, n, count = nodes.shape

    def build() -> ca.Function:
        assert case.model.contacts is not None  # asked for where there is ground
        x = ca.SX.sym("x", d * n)
        stored = case.model.contacts.stored_energy(ca.reshape(x, d, n))
        return Function("stored", [x], [ca.densify(stored)])

    function = case.equation().prepared.get("stored in ground", build)
    (stored,) = evaluate_columns(function, nodes.swapaxes(0, 1).reshape(d * n, count))
    return np.asarray(stored[0])


def conserves_energy(case: Scene) -> bool:
    """Return whether the motion conserves energy: no string is damped, and no contact rubs."""
    return not case.equation().velocity_dependent


def conserves_momentum(case: Scene) -> bool:
    """Return whether the motion conserves momentum: nothing acts from outside."""
    forces = case.model.forces(case.input)
    return not (case.load.any() or len(case.structure.fixed_rows)) and forces.conserves_momentum


def deviations(
    case: Scene, measured: Invariants, reference: Invariants, start: Invariants
) -> dict[str, Any]:
    """Return how far a motion is from what it should conserve, as fields of :class:`Measurement`.

    What it does not conserve, under damping, loads or supports, is compared with the reference,
    which is of the same times; ``start`` is of the start alone.
    """
    energy = start.energy if conserves_energy(case) else reference.energy
    change = np.abs(reference.potential - start.potential)
    size = max(float(reference.kinetic.max()), float(change.max()))
    linear, angular = reference.momentum, reference.angular_momentum
    if conserves_momentum(case):
        linear, angular = start.momentum, start.angular_momentum
    off = float(np.abs(measured.energy - energy).max())
    return {
        "energy_error": off / size if size > 0 else NOT_KNOWN,
        "momentum_drift": float(np.linalg.norm(measured.momentum - linear, axis=0).max()),
        "angular_momentum_drift": float(
            np.linalg.norm(measured.angular_momentum - angular, axis=0).max()
        ),
        "bar_length_drift": float(measured.stretch.max()),
    }


# ---- runs ----


@dataclass(frozen=True)
class Measurement:
    """Error, run time and work of one run of a method. Numbers not known are NaN or None.

    Attributes
    ----------
    method : str
        Name of the method or peer.
    is_peer : bool
        Whether it is of another package.
    takes : str
        What the setting is: ``"step"``, s; ``"tolerance"``; ``"setting"``, of a peer.
    setting : float
        Step, s, or tolerance, as the method takes.
    error, end_error : float
        Largest distance of a node from the reference, m: over all output times, and at the end.
    relative_error : float
        ``error`` over the size of the structure.
    time : float
        Median processor time of a run as a user calls it the second time, s: of our methods all of
        :func:`simulate`, with its checks and its trajectory; of a peer the call that integrates.
    build_time : float
        What it took once, before: building, compiling, first call, s of the processor. A compiler
        is a process of its own, and not counted.
    repeats : int
        Runs of which ``time`` is the median.
    evaluations, steps, rejections, switches : int or None
        Evaluations of the forces; steps taken and thrown away; switches of a string located.
    energy_error : float
        Largest error of the energy, as part of what the motion exchanges.
    momentum_drift, angular_momentum_drift : float
        Largest, kg m/s and kg m²/s.
    bar_length_drift : float
        Largest difference of a bar from its length, m.
    back_end : str
        What runs the steps, as ``run.choice.back_end`` says; empty for a peer.
    failure : str
        Why there is no motion; empty if there is.
    """

    method: str
    is_peer: bool
    takes: str
    setting: float
    error: float = NOT_KNOWN
    end_error: float = NOT_KNOWN
    relative_error: float = NOT_KNOWN
    time: float = NOT_KNOWN
    build_time: float = NOT_KNOWN
    repeats: int = 0
    evaluations: int | None = None
    steps: int | None = None
    rejections: int | None = None
    switches: int | None = None
    energy_error: float = NOT_KNOWN
    momentum_drift: float = NOT_KNOWN
    angular_momentum_drift: float = NOT_KNOWN
    bar_length_drift: float = NOT_KNOWN
    back_end: str = ""
    failure: str = ""

    __repr__ = short_repr


class TimedRun:
    """A run that was done once, with its row; it is done again for its time."""

    def __init__(
        self,
        row: Measurement,
        again: Callable[[], object] | None = None,
        first: float = NOT_KNOWN,
        built: float = 0.0,
    ) -> None:
        self._row, self._again, self._first, self._built = row, again, first, built
        self._times: list[float] = []

    def repeat(self, count: int) -> None:
        """Do the run again, up to so many times in all; fewer where it takes seconds."""
        if self._again is None:
            return
        while len(self._times) < count and self._first + sum(self._times) < _PATIENCE:
            began = process_time()
            self._again()
            self._times.append(process_time() - began)

    def measurement(self) -> Measurement:
        """Return the row, with the median of the times if there is a motion."""
        if self._again is None:
            return self._row
        typical = median(self._times) if self._times else self._first
        build = self._built + max(self._first - typical, 0.0)  # the first fills what is filled once
        return replace(self._row, time=typical, build_time=build, repeats=max(len(self._times), 1))


class Bench:
    """Does runs of a case and judges them by its reference."""

    def __init__(self, case: Scene, reference: ConvergedMotion) -> None:
        self._case, self._reference = case, reference
        self._start = invariants(case, case.state[:, None])
        self._true = invariants(case, reference.states)
        self._own: dict[Peer, FloatArray] = {}

    def own(self, method: Method, setting: float) -> TimedRun:
        """Return a run of one of our methods at a setting."""
        case = self._case
        row = Measurement(method.name, False, method.setting, setting)
        options: dict[str, Any] = {method.setting: setting, case.input: case.input_value}

        def run() -> Trajectory:
            with warnings.catch_warnings(action="ignore", category=AccuracyWarning):
                return simulate(
                    case.model, case.duration, case.nodes, case.velocities,
                    external_force=case.external_force, method=method,
                    output_step=case.duration / len(self._reference.time),
                    error="none", limits=HealthLimits(crossings=None), **options,
                )  # fmt: skip

        began = process_time()
        try:
            trajectory = run()
        except SimulationError as error:
            return TimedRun(replace(row, **_counts(error.trajectory.work), failure=str(error)))
        except (ValueError, ArithmeticError) as error:
            return TimedRun(replace(row, failure=str(error)))
        first = process_time() - began
        row = replace(row, **_counts(trajectory.work), back_end=trajectory.choice.back_end)
        nodes, velocities = (
            motion[:, :, 1:] for motion in (trajectory.nodes, trajectory.velocities)
        )
        return TimedRun(self._judged(row, nodes, velocities, self._reference.nodes), run, first)

    def peer(self, peer: Peer, setting: float, finest: float) -> TimedRun:
        """Return a run of another package at a setting, of which ``finest`` is the finest run."""
        row = Measurement(peer.name, True, "setting", setting)
        times = [process_time()]
        try:
            run = peer.prepare(self._case, setting, self._reference.time)
            times.append(process_time())
            solution = run()
            times.append(process_time())
        except (ValueError, ArithmeticError, RuntimeError) as error:
            return TimedRun(replace(row, failure=str(error)))
        built, first = np.diff(times).tolist()
        row = replace(row, evaluations=solution.evaluations or None)
        true, velocities = self._reference.nodes, solution.velocities
        if peer.own_law(self._case) is not None:
            try:
                true = self._own_motion(peer, finest / FINER)
            except (ValueError, ArithmeticError, RuntimeError) as error:
                failure = f"no reference of its own law: {error}"
                return TimedRun(replace(row, failure=failure), run, first, built)
            velocities = None  # what it conserves is not what the case conserves
        row = self._judged(row, solution.nodes, velocities, true)
        return TimedRun(row, run, first, built)

    def _own_motion(self, peer: Peer, setting: float) -> FloatArray:
        """Return the motion of a peer under its own law, found once."""
        if peer not in self._own:
            self._own[peer] = peer.prepare(self._case, setting, self._reference.time)().nodes
        return self._own[peer]

    def _judged(
        self, row: Measurement, nodes: FloatArray, velocities: FloatArray | None, true: FloatArray
    ) -> Measurement:
        """Return the row with errors and health of the motion, or with why there are none."""
        if nodes.shape != true.shape:
            raise ValueError(
                f"{row.method} returned nodes of shape {nodes.shape}, expected {true.shape}: "
                "all nodes at all output times"
            )
        if not np.isfinite(nodes).all():
            return replace(row, failure="the motion is not finite")
        error = largest_distance(nodes, true)
        row = replace(
            row,
            error=error,
            end_error=largest_distance(nodes[:, :, -1:], true[:, :, -1:]),
            relative_error=error / self._case.size,
        )
        if velocities is None or not np.isfinite(velocities).all():
            return row
        structure = self._case.structure
        moments = zip(nodes.T, velocities.T, strict=True)
        states = np.column_stack([pack_state(structure, N.T, V.T) for N, V in moments])
        conserved = invariants(self._case, states)
        return replace(row, **deviations(self._case, conserved, self._true, self._start))


def _counts(work: Work) -> dict[str, Any]:
    names = ("evaluations", "steps", "rejections", "switches")
    return {name: getattr(work, name) for name in names}
