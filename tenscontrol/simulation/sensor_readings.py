"""Readings that sensors on a simulated structure hand out, sample by sample."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.dynamics.model import Model
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.structure.segments import to_strings


class SensorReadings:
    """Sensors with their noise, bias and delay.

    Parameters
    ----------
    sensors : Sensors
    seed : int, optional
        Of the noise.
    model : Model
        Of what is measured.
    input : {"rest_length", "force_density"}
    sample_time : float
        s.

    Attributes
    ----------
    bias : ndarray, shape (m,)
        Of the next reading.
    under_way : sequence of ndarray
        What was read and has not arrived.
    """

    def __init__(
        self, sensors: Sensors, seed: int | None, model: Model, input: str, sample_time: float
    ) -> None:
        self.sensors, self._input, self._sample_time = sensors, input, sample_time
        self._generator = np.random.default_rng(0 if seed is None else seed)
        # Of its own, so that sensors without a bias read the same.
        self._bias_generator = np.random.default_rng([0 if seed is None else seed, 1])
        self.nothing = np.full(len(sensors.noise), np.nan)
        self.begin(model)

    def begin(self, model: Model) -> None:
        """Begin a run of a model with another bias; the noise goes on."""
        self._model = model
        self._law = None
        if self._input == "rest_length" and self.sensors.string_tension is not None:
            self._law = Evaluator(model.string_force_density)
        self.bias = self.sensors.draw_bias(self._bias_generator, self._sample_time)
        # The first were before the run.
        self.under_way = deque([self.nothing] * self.sensors.delay)

    def skip(self, samples: int) -> None:
        """Draw the noise of so many samples."""
        for _ in range(samples):
            self.sensors.disturb(np.zeros(len(self.nothing)), self._generator)
            self._drift()

    def take(
        self, nodes: FloatArray, velocities: FloatArray, held: FloatArray | None,
        acceleration: Callable[[FloatArray], FloatArray], lost: bool = False,
    ) -> FloatArray:  # fmt: skip
        """Measure a motion, and return what arrives now.

        ``held`` is what the strings have, if anything yet; ``acceleration`` returns that of the
        nodes under it. A measurement that is lost now is missing when it would have arrived.
        """
        sensors = self.sensors
        seen, felt = sensors.structure.nodes.shape[1], None
        if sensors.needs("acceleration") and held is not None:
            felt = acceleration(held)[:, :seen]
        exact = sensors.measure(
            nodes[:, :seen], self._tension(nodes, velocities, held), velocities[:, :seen], felt,
            self._rest_length(held),
        )  # fmt: skip
        noisy = sensors.disturb(exact + self.bias, self._generator)
        self._drift()
        self.under_way.append(self.nothing if lost else noisy)
        return self.under_way.popleft()

    def _drift(self) -> None:
        """Let the bias walk for a sample, if there is any."""
        if not self.sensors.bias:
            return
        self.bias = self.sensors.draw_bias(self._bias_generator, self._sample_time, self.bias)

    def _tension(
        self, nodes: FloatArray, velocities: FloatArray, held: FloatArray | None
    ) -> FloatArray | None:
        """Return the tension of each string of the sensors' structure; None before any input."""
        if self.sensors.string_tension is None or held is None:
            return None
        structure, gamma = self._model.structure, held
        if self._law is not None:
            (gamma,) = self._law(pack_state(structure, nodes, velocities), held)
        tension = np.atleast_1d(gamma) * structure.string_length(nodes)
        return self._of_strings("tension", tension)

    def _rest_length(self, held: FloatArray | None) -> FloatArray | None:
        """Return the rest lengths of the strings of the sensors' structure, if they are held."""
        if held is None or not self.sensors.needs("rest_length"):
            return None
        return self._of_strings("rest_length", held)

    def _of_strings(self, name: str, values: FloatArray) -> FloatArray:
        if len(values) == len(self.sensors.structure.strings):
            return values
        return to_strings(self._model.structure, name, values)
