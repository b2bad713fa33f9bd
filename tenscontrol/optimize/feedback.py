"""Feedback of a linear-quadratic regulator along a run: how its commands answer small changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tenscontrol.actuation.driven_strings import strings_of
from tenscontrol.arrays import FloatArray
from tenscontrol.control.lqr import LQR
from tenscontrol.dynamics.equation import unpack_states
from tenscontrol.optimize.parameters import Parameter, sample_times
from tenscontrol.optimize.traced_steps import TracedSteps
from tenscontrol.properties import cached_property
from tenscontrol.simulation.scene import Scene

# Change of a coordinate of the nodes, as part of the size, and of a velocity, as part of the
# largest: the measured state is a smooth function of them, differenced to order 4.
_CHANGE = 1e-3

# An input that is so close to what the law commands, relative to the largest, is it.
_SAME = 1e-9


class Feedback:
    """The commands ``u = u₀ − K z`` of a run, differentiated; constant where they are at a bound.

    Parameters
    ----------
    scene : Scene
        Under an LQR.
    steps : TracedSteps
        Of a part of the run.
    gain : slice, optional
        Columns of the derivatives that are those by K.

    Raises
    ------
    ValueError
        If what the strings were given is not what the law commands of the motion itself.
    """

    #: Of the polynomials in time of an answer: strings are held at it.
    degree = 0

    def __init__(self, scene: Scene, steps: TracedSteps, gain: slice | None) -> None:
        law = regulator_of(scene)
        self._law, self._steps, self._gain = law, steps, gain
        self._structure = scene.structure
        self._matrix = law.actuation.matrix.toarray()
        ticks = sample_times(scene)
        close = 1e-9 * (ticks[-1] - ticks[0] + scene.duration)
        ticks = ticks[(ticks > steps.begin[0] - close) & (ticks < steps.end - close)]
        first = np.searchsorted(steps.begin, ticks - close)
        self._sample_of = {int(k): i for i, k in enumerate(first)}
        self._check(first, ticks)

    @property
    def size(self) -> int:
        """Number of rows of an answer."""
        return len(self._structure.strings)

    def begins(self, step: int) -> bool:
        """Whether a command is given at the beginning of a step."""
        return step in self._sample_of

    def elapsed(self, step: int) -> float:
        """Return 0: what strings are given does not depend on the time since."""
        return 0.0

    def answer(self, step: int, X: FloatArray, before: FloatArray | None) -> FloatArray:
        """Return the derivative of what strings are given from a step on, (α, P)."""
        i = self._sample_of[step]
        moved = self._by_state[i] @ X
        if self._gain is not None:
            moved[:, self._gain] -= np.kron(self._matrix * self._is_free[i], self._states[i])
        return np.asarray(moved)

    def answer_back(self, step: int, cost: FloatArray, slope: FloatArray) -> FloatArray:
        """Return a cost by the state from that by what strings are given from a step on."""
        i = self._sample_of[step]
        if self._gain is not None:
            by_input = (cost @ self._matrix) * self._is_free[i]
            slope[self._gain] -= np.kron(by_input, self._states[i])
        by_state = np.asarray(cost @ self._by_state[i])
        cost[:] = 0.0  # of the command before
        return by_state

    def _check(self, first: FloatArray, ticks: FloatArray) -> None:
        law, strings = self._law, self._steps.layout.strings
        for i, k in enumerate(first):
            u = np.clip(self._desired(self._states[i]), *law.bounds)
            given, wanted = self._steps.inputs[:strings, k], strings_of(law.actuation, u)
            if np.abs(given - wanted).max() > _SAME * np.abs(wanted).max():
                raise ValueError(
                    f"feedback: at {ticks[i]:g} s the strings are not given what the LQR commands, "
                    "by slow or stuck winches, a limit of the change or a lost measurement: no "
                    "derivative is taken through them. Leave feedback out to hold the commands"
                )

    def _desired(self, z: FloatArray) -> FloatArray:
        return np.asarray(self._law.plant.equilibrium_input - self._law.gain @ z)

    def _measured(self, x: FloatArray) -> FloatArray:
        N, V = unpack_states(self._structure, x[:, None])
        return self._law.plant.coordinates.state_of(N[:, :, 0], V[:, :, 0])

    @cached_property
    def _states(self) -> list[FloatArray]:
        """State z of each sample."""
        return [self._measured(self._steps.states[:, k]) for k in self._sample_of]

    @cached_property
    def _is_free(self) -> list[FloatArray]:
        """Which inputs of each sample are within their bounds, 1 or 0."""
        low, high = self._law.bounds
        desired = [self._desired(z) for z in self._states]
        return [((low < u) & (u < high)).astype(float) for u in desired]

    @cached_property
    def _by_state(self) -> list[FloatArray]:
        """Derivative of what strings are given by x, (α, states), of each sample."""
        return [
            -(self._matrix * free) @ self._law.gain @ self._measured_by(self._steps.states[:, k])
            for k, free in zip(self._sample_of, self._is_free, strict=True)
        ]

    def _measured_by(self, x: FloatArray) -> FloatArray:
        """Return the derivative of z by x."""
        half = len(x) // 2
        sizes = np.repeat([np.ptp(self._structure.nodes), np.abs(x[half:]).max() or 1.0], half)
        columns = []
        for i, size in enumerate(_CHANGE * sizes):
            change = np.zeros(len(x))
            change[i] = size
            ends = [self._measured(x + by * change) for by in (1, -1, 2, -2)]
            columns.append((8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * size))
        return np.stack(columns, axis=1)


def feedback_of(
    scene: Scene, steps: TracedSteps, parameters: Sequence[Parameter], columns: Sequence[slice]
) -> Feedback:
    """Return the feedback along the steps of a scene."""
    names = [parameter.kind for parameter in parameters]
    gain = columns[names.index("gain")] if "gain" in names else None
    return Feedback(scene, steps, gain)


def regulator_of(scene: Scene) -> LQR:
    """Return the regulator of a scene whose feedback is differentiated, or raise."""
    law = scene.law
    if not isinstance(law, LQR):
        under = "in open loop" if law is None else f"under {law.label}"
        raise ValueError(f"feedback is that of an LQR, but the run is {under}: leave feedback out")
    reasons = {
        "an estimator between": scene.estimator is not None,
        "rest lengths that are ramps: winches with substeps": law.previous_input_gain is not None,
        "a subdivided structure": law.commanded is not scene.structure
        and len(law.commanded.strings) != len(scene.structure.strings),
    }  # fmt: skip
    for reason, is_so in reasons.items():
        if is_so:
            raise ValueError(f"feedback: no derivative is taken through {reason}")
    return law
