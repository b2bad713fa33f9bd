"""Rollouts of a model beside logs: what sensors would have read, and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.equation import unpack_states
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Profile
from tenscontrol.dynamics.string_force import StringForce
from tenscontrol.dynamics.tangent import bar_basis
from tenscontrol.estimation.sensors import Moment, Sensors, symbolic_readings
from tenscontrol.integrate.projection import Projector
from tenscontrol.optimize.log import Log
from tenscontrol.optimize.parameters import Parameter
from tenscontrol.optimize.run_variations import RunVariations
from tenscontrol.optimize.unknowns import Unknown, fitted_model, parameter_of
from tenscontrol.properties import cached_property
from tenscontrol.simulation.health import HealthLimits
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.scene import Scene
from tenscontrol.structure.structure import Structure


@dataclass(frozen=True, eq=False)
class Readings:
    """What would be read along a rollout, less what was, in standard deviations.

    Attributes
    ----------
    residuals : ndarray, shape (R,)
        Of all readings that are not lost, log after log.
    slope : ndarray, shape (R, unknowns), or None
    of_log : ndarray of int, shape (R,)
    """

    residuals: FloatArray
    slope: FloatArray | None
    of_log: Any


class Rollouts:
    """Rollouts of a model with unknown parameters, beside logs.

    Parameters
    ----------
    model : Model
    logs : sequence of Log
    unknowns : sequence of Unknown
    start : tuple of float, or None
        Standard deviations of nodes, m, and velocities, m/s, at the start of each log; None where
        they are known.
    integration : Integration
    """

    def __init__(
        self, model: Model, logs: Sequence[Log], unknowns: Sequence[Unknown],
        start: tuple[float, float] | None, integration: Integration,
    ) -> None:  # fmt: skip
        self.model, self.logs, self.unknowns = model, logs, unknowns
        self.start, self.integration = start, integration
        structure = model.structure
        self._bases = []
        for log in logs:
            N = structure.nodes if log.nodes is None else np.asarray(log.nodes)
            basis = bar_basis(structure, N).toarray()
            self._bases.append(basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-300))
        self.count = 0
        self._last: tuple[bytes, Model] | None = None

    @cached_property
    def ends(self) -> list[int]:
        """Where the unknowns of each parameter end, then those of each start."""
        sizes = [len(unknown.groups) for unknown in self.unknowns]
        if self.start is not None:
            sizes += [2 * basis.shape[1] for basis in self._bases]
        return [int(end) for end in np.cumsum(sizes)]

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.ends[-1]

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations of the priors of all unknowns."""
        parts = [np.full(len(unknown.groups), unknown.deviation) for unknown in self.unknowns]
        if self.start is not None:
            for basis in self._bases:
                parts += [np.full(basis.shape[1], size) for size in self.start]
        return np.concatenate(parts)

    @property
    def labels(self) -> list[str]:
        """Name of each unknown."""
        labels = [label for unknown in self.unknowns for label in unknown.labels]
        if self.start is not None:
            for i, basis in enumerate(self._bases):
                which = f" of log {i}" if len(self.logs) > 1 else ""
                for quantity in ("place", "velocity"):
                    labels += [f"start {quantity}{which} {k}" for k in range(basis.shape[1])]
        return labels

    def own(self, theta: FloatArray) -> list[FloatArray]:
        """Return the unknowns of each parameter."""
        return np.split(theta, self.ends)[: len(self.unknowns)]

    def model_for(self, theta: FloatArray) -> Model:
        """Return the model with the parameters for all unknowns; the last one again if alike."""
        key = theta.tobytes()
        if self._last is None or self._last[0] != key:
            fitted = fitted_model(self.model, self.unknowns, self.own(theta))
            differing = [unknown.name for unknown in self.unknowns if not unknown.is_beside]
            self._last = key, fitted.sharing(self.model, differing)
        return self._last[1]

    def readings(self, theta: FloatArray, share: float, slopes: bool) -> Readings:
        """Return the residuals of readings in a first part of each log, and their slope."""
        self.count += 1
        model = self.model_for(theta)
        results = [self._of_log(i, model, theta, share, slopes) for i in range(len(self.logs))]
        residuals = np.concatenate([result[0] for result in results])
        of_log = np.repeat(np.arange(len(results)), [len(result[0]) for result in results])
        slope = np.vstack([result[1] for result in results]) if slopes else None
        return Readings(residuals, slope, of_log)

    def _of_log(
        self, i: int, model: Model, theta: FloatArray, share: float, slopes: bool
    ) -> tuple[FloatArray, Any]:
        log, own = self.logs[i], self.own(theta)
        if share < 1:
            log = log.until(max(share * float(log.time[-1]), log.first_read))
        names = [unknown.name for unknown in self.unknowns]
        delay = float(own[names.index("delay")][0]) if "delay" in names else 0.0
        times = np.clip(log.time - delay, 0.0, None)
        kept, again = np.unique(times, return_inverse=True)
        # Some motion there must be, where all that was read is of the start.
        duration = float(kept[-1]) or float(self.logs[i].time[-1])
        scene, basis = self._scene(i, model, theta, log, duration), self._bases[i]
        parameters = [parameter_of(self.model, unknown) for unknown in self.unknowns]
        carried = [parameter for parameter in parameters if parameter is not None]
        if self.start is not None:
            shape = model.structure.nodes.shape
            carried += [Parameter(name, name, shape) for name in ("nodes", "velocities")]
        variations = RunVariations(scene, carried if slopes else (), kept)
        assert scene.inputs is not None  # a log is of an open loop
        inputs = scene.inputs.at(kept)
        states = variations.motion()
        law = _law_values(model, log.input)
        function = _reading_function(model, log.sensors, log.input)
        columns = [states, inputs, np.repeat(law[:, None], len(kept), axis=1)]
        y, by_state, by_input, by_law = evaluate_columns(function, *columns)
        deviation = log.sensors.noise
        is_read = ~np.isnan(log.readings)
        off = (y.T[again] - np.nan_to_num(log.readings)) / deviation
        if not slopes:
            return off[is_read], None
        count, m = len(kept), len(deviation)
        by_state, by_input, by_law = (
            array.T.reshape(count, -1, m).swapaxes(1, 2) for array in (by_state, by_input, by_law)
        )
        X = variations.forward()
        slope = np.zeros((count, m, self.size))
        place = 0
        for unknown, parameter, theta_own, end in zip(
            self.unknowns, parameters, own, self.ends, strict=False
        ):
            columns_of = slice(end - len(unknown.groups), end)
            chain = unknown.slope(theta_own)
            if parameter is None:
                slopes_now = variations.slopes()
                slope[:, :, columns_of] = -np.einsum("kms,sk->km", by_state, slopes_now)[:, :, None]
                continue
            direct = by_state @ X[:, :, place : place + parameter.size]
            if parameter.kind == "input":
                direct = direct + by_input
            first = _law_place(model, log.input, unknown.name)
            if first is not None:
                direct = direct + by_law[:, :, first : first + parameter.size]
            slope[:, :, columns_of] = direct @ chain
            place += parameter.size
        if self.start is not None:
            d, n = model.structure.nodes.shape
            free, half = model.structure.free_rows, variations.derivatives.half
            of_array = np.arange(d * n).reshape(d, n).ravel(order="F")[free]  # of a free entry
            by_start = X[:, :, np.concatenate([place + of_array, place + d * n + of_array])]
            end, r = self.ends[len(self.unknowns) + i], basis.shape[1]
            moved = np.zeros((2 * half, 2 * r))
            moved[:half, :r] = moved[half:, r:] = basis[free]
            exact = variations.derivatives.projected(self._moved_start(i, model, theta)[:, None])
            if exact is not None:
                moved = exact[0][0] @ moved
            slope[:, :, end - 2 * r : end] = by_state @ (by_start @ moved)
        return off[is_read], (slope[again] / deviation[:, None])[is_read]

    def _scene(self, i: int, model: Model, theta: FloatArray, log: Log, duration: float) -> Scene:
        N, V = self._told_start(i)
        if self.start is not None:
            N, V = _exact_start(model, log.input, self._moved_start(i, model, theta))
        held: Any = getattr(log, log.input)
        names = [unknown.name for unknown in self.unknowns]
        if "rest_length" in names:
            k = names.index("rest_length")
            held = _shifted(held, self.unknowns[k].values(self.own(theta)[k]))
        inputs = {log.input: held}
        return Scene(
            model, duration, N, V, external_force=log.external_force,
            integration=self._integration_for(duration), **inputs,
        )  # fmt: skip

    def _told_start(self, i: int) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities at the start as a log has them."""
        log, usual = self.logs[i], self.model.structure.nodes
        N = usual if log.nodes is None else np.asarray(log.nodes)
        V = np.zeros(N.shape) if log.velocities is None else np.asarray(log.velocities)
        return N, V

    def _moved_start(self, i: int, model: Model, theta: FloatArray) -> FloatArray:
        """Return the state at the start, moved by its unknowns; bars are off by a little."""
        free, basis = model.structure.free_rows, self._bases[i]
        end = self.ends[len(self.unknowns) + i]
        moved = theta[end - 2 * basis.shape[1] : end].reshape(2, -1)
        whole = (array.ravel(order="F") for array in self._told_start(i))
        return np.concatenate(
            [(vector + basis @ by)[free] for vector, by in zip(whole, moved, strict=True)]
        )

    def _integration_for(self, duration: float) -> Integration:
        how = self.integration
        if how.step is not None:
            return how
        return Integration(
            "dop853", how.tolerance, output_step=duration, project=how.project, error="none",
            limits=HealthLimits(crossings=None),
        )  # fmt: skip


def _exact_start(model: Model, input: str, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return nodes and velocities at a start whose bars have their lengths."""
    exact = Projector(model.equation(input), True)(state[:, None])
    if not exact.size:
        raise ValueError("bars that share nodes cannot be put on their lengths at the start")
    nodes, velocities = unpack_states(model.structure, exact)
    return nodes[:, :, 0], velocities[:, :, 0]


def _shifted(held: Any, by: FloatArray) -> Any:
    if isinstance(held, Profile):
        return replace(held, values=held.values + by[:, None])
    return np.asarray(held) + by


def _law_values(model: Model, input: str) -> FloatArray:
    """Return the parameters of the string law, one after the other."""
    law: Any = model.forces(input).law
    count = len(model.structure.strings)
    if law is None:
        return np.zeros(0)
    return np.concatenate([np.broadcast_to(getattr(law, f.name), (count,)) for f in fields(law)])


def _law_place(model: Model, input: str, name: str) -> int | None:
    """Return where a parameter begins among those of the string law."""
    law: Any = model.forces(input).law
    names = [] if law is None else [field.name for field in fields(law)]
    return names.index(name) * len(model.structure.strings) if name in names else None


def _reading_function(model: Model, sensors: Sensors, input: str) -> ca.Function:
    """Return ``(x, u, law) -> y and its slopes``, the same for all values of parameters."""
    law: Any = model.forces(input).law
    key = ("readings", sensors.measured, input, type(law))

    def build() -> ca.Function:
        structure: Structure = model.structure
        count, half = len(structure.strings), len(structure.free_rows)
        x, u = ca.SX.sym("x", 2 * half), ca.SX.sym("u", count)
        N, V = (
            kernel.placed(structure, x[rows], held)
            for rows, held in (
                (slice(half), structure.nodes),
                (slice(half, None), np.zeros(structure.nodes.shape)),
            )
        )
        names = [] if law is None else [field.name for field in fields(law)]
        own = ca.SX.sym("law", count * len(names))
        symbolic = law
        if law is not None:
            parts = {name: own[i * count : (i + 1) * count] for i, name in enumerate(names)}
            symbolic = law.with_parameters(parts)
        gamma = StringForce(structure, symbolic).force_density(N, V, u)
        tension = gamma * kernel.string_lengths(structure, N).T
        y = symbolic_readings(sensors, Moment(N, V, ca.SX(*N.shape), tension, u))
        outputs = [y, *(ca.vec(ca.jacobian(y, by)) for by in (x, u, own))]
        return Function("readings", [x, u, own], [ca.densify(output) for output in outputs])

    return model.prepared.get(key, build)


def refuse_accelerometers(sensors: Sensors) -> None:
    """Raise if readings depend on accelerations, which are not differentiated."""
    if sensors.needs("acceleration"):
        raise ValueError(
            "sensors have accelerometers, whose readings are not fitted: leave them out of the log"
        )


def checked_logs(model: Model, log: object) -> tuple[Log, ...]:
    """Return the logs that a fit is given, one or several, after checking that they fit."""
    logs = tuple(log) if isinstance(log, Sequence) else (log,)
    if not logs:
        raise ValueError("log is empty, expected at least one Log")
    for i, entry in enumerate(logs):
        name = f"log[{i}]" if isinstance(log, Sequence) else "log"
        validation.instance(name, entry, Log, "make one by Log(time, readings, sensors, ...)")
        shape, sensor_shape = model.structure.nodes.shape, entry.sensors.structure.nodes.shape
        if shape != sensor_shape or len(model.structure.strings) != len(
            entry.sensors.structure.strings
        ):
            raise ValueError(
                f"{name} has sensors of {entry.sensors.structure!r}, expected the model's "
                f"{model.structure!r}"
            )
        if entry.time[-1] == 0:
            raise ValueError(f"{name} has readings at 0 s alone, expected some of a motion")
        refuse_accelerometers(entry.sensors)
        if entry.input != logs[0].input:
            raise ValueError(f"{name} holds {entry.input}, the first log {logs[0].input}")
        if callable(getattr(entry, entry.input)) and not isinstance(
            getattr(entry, entry.input), Profile
        ):
            raise TypeError(
                f"{name}.{entry.input} is a function of time, expected an array or a Profile"
            )
    return logs
