"""States of a filter beside those of its plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.evaluator import Function


@dataclass(frozen=True)
class ExtraStates:
    """What a filter estimates beside the state of its plant, in this order after it.

    All but the disturbance keep their values over a sample, apart from a random walk.
    """

    states: int  # of the plant, 2r
    load: int = 0  # r accelerations by an unknown load, or none
    disturbance: int = 0  # r unknown accelerations over the last sample, which accelerometers feel
    rest_lengths: tuple[int, ...] = ()  # inputs that are off by an unknown error
    biased: tuple[int, ...] = ()  # entries of y with a bias

    @property
    def size(self) -> int:
        """Number of all states."""
        return int(self.of_bias.stop)

    @property
    def of_load(self) -> slice:
        """Places of the accelerations by the load."""
        return slice(self.states, self.states + self.load)

    @property
    def of_disturbance(self) -> slice:
        """Places of the unknown accelerations."""
        return slice(self.of_load.stop, self.of_load.stop + self.disturbance)

    @property
    def of_rest_length(self) -> slice:
        """Places of the errors of rest lengths."""
        first = self.of_disturbance.stop
        return slice(first, first + len(self.rest_lengths))

    @property
    def of_bias(self) -> slice:
        """Places of the biases."""
        return slice(self.of_rest_length.stop, self.of_rest_length.stop + len(self.biased))

    def acceleration(self, z: Any) -> Any:
        """Return the expression of the unknown accelerations q̈, shape (r,), of all states."""
        acceleration = type(z).zeros(self.states // 2)
        for rows in (self.of_load, self.of_disturbance):
            if rows.stop > rows.start:
                acceleration = acceleration + z[rows]
        return acceleration

    def input(self, z: Any, u: Any) -> Any:
        """Return the expression of the input that acts, of all states and that which is told."""
        if not self.rest_lengths:
            return u
        return u + ca.mtimes(ca.DM(self.by_rest_length(u.numel())), z[self.of_rest_length])

    def bias(self, z: Any, readings: int) -> Any:
        """Return the expression of the bias of each entry of y."""
        spread = ca.DM(np.eye(readings)[:, list(self.biased)])
        return ca.mtimes(spread, z[self.of_bias])

    def by_rest_length(self, inputs: int) -> FloatArray:
        """Return the derivative of the input by the errors of rest lengths."""
        return np.eye(inputs)[:, list(self.rest_lengths)]

    def joined(
        self, transition: FloatArray, by_load: FloatArray, by_input: FloatArray
    ) -> FloatArray:
        """Return the transition of all states from that of the plant's and its responses."""
        whole = np.eye(self.size)
        whole[: self.states, : self.states] = transition
        if self.load:
            whole[: self.states, self.of_load] = by_load
        whole[self.of_disturbance, self.of_disturbance] = 0.0
        changed = by_input @ self.by_rest_length(by_input.shape[1])
        whole[: self.states, self.of_rest_length] = changed
        return whole

    def motion(self, motion: ca.Function, by_load: FloatArray) -> ca.Function:
        """Return ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)`` of all states over a substep.

        ``motion`` is that of the states of the plant; loads count to first order.
        """
        inputs = motion.size1_in(1)
        z, u = ca.MX.sym("z", self.size), ca.MX.sym("u", inputs)
        end, of_state, of_input = motion(z[: self.states], self.input(z, u))
        columns = [of_state]
        if self.load:
            end = end + ca.mtimes(ca.DM(by_load), z[self.of_load])
            columns.append(ca.DM(by_load))
        columns += [
            ca.DM(self.states, self.disturbance),
            ca.mtimes(of_input, ca.DM(self.by_rest_length(inputs))),
            ca.DM(self.states, len(self.biased)),
        ]
        stays = np.eye(self.size)[self.states :]
        stays[:, self.of_disturbance] = 0.0
        outputs = [
            ca.vertcat(end, ca.mtimes(ca.DM(stays), z)),
            ca.vertcat(ca.horzcat(*columns), ca.DM(stays)),
            ca.vertcat(of_input, ca.DM(self.size - self.states, inputs)),
        ]
        return Function("with_extra_states", [z, u], [ca.densify(output) for output in outputs])
