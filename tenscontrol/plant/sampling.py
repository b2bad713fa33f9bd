"""Exact sampled models of a linear plant: zero-order-hold and ramp inputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.validation import FloatArray, freeze_arrays, frozen

if TYPE_CHECKING:
    from tenscontrol.plant.linear_plant import LinearPlant


@dataclass(frozen=True, eq=False)
class Sampled:
    """The exact model of a sample, ``z⁺ = Φ z + Γ_p v_previous + Γ v + d``."""

    sample_time: float  # s
    transition: FloatArray  # Φ, (s, s)
    by_previous: FloatArray  # Γ_p, (s, α); zero without a ramp
    by_input: FloatArray  # Γ, (s, α)
    drift: FloatArray  # d, (s,)
    ramp: bool  # whether the input moves through the sample, from v_previous to v

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def augmented(self) -> tuple[FloatArray, FloatArray]:
        """Φ and Γ of the state ``[z; v_previous]``, or of z without a ramp."""
        if not self.ramp:
            return self.transition, self.by_input
        s, a = self.by_input.shape
        rows = np.hstack([self.transition, self.by_previous])
        return np.vstack([rows, np.zeros((a, s + a))]), np.vstack([self.by_input, np.eye(a)])

    def free_response(
        self, state: FloatArray, previous: FloatArray, origin: FloatArray
    ) -> FloatArray:
        """Return the next state, shape (s,), at zero input and without drift.

        ``previous``, shape (α,), is v_previous; ``origin``, shape (α,), is what v is measured from.
        """
        return np.asarray(
            self.transition @ state + self.by_previous @ previous - self.by_input @ origin
        )


def sampled(plant: LinearPlant, sample_time: float, substeps: int) -> Sampled:
    """Return the sampled model; the input reaches v in equal substeps, at once if there is one."""

    def build() -> Sampled:
        transition, by_input, drift = plant.discretize(sample_time / substeps)
        whole, moved = np.eye(len(transition)), np.zeros_like(drift)
        previous, now = np.zeros_like(by_input), np.zeros_like(by_input)
        for substep in range(1, substeps + 1):
            share = substep / substeps
            previous = transition @ previous + (1 - share) * by_input
            now = transition @ now + share * by_input
            moved = transition @ moved + drift
            whole = transition @ whole
        return Sampled(sample_time, whole, previous, now, moved, substeps > 1)

    return plant.prepared.get(("sampled", sample_time, substeps), build)


def acceleration_response(plant: LinearPlant, sample_time: float) -> FloatArray:
    """Return the response of the state to unit accelerations held over a sample, shape (s, r)."""

    def build() -> FloatArray:
        r = plant.degrees_of_freedom
        unit = np.vstack([np.zeros((r, r)), np.eye(r)])
        return frozen(zero_order_hold(plant.A, unit, plant.drift, sample_time)[1])

    return plant.prepared.get(("acceleration_response", sample_time), build)


def zero_order_hold(
    A: FloatArray, B: FloatArray, drift: FloatArray, sample_time: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Φ, Γ and d of ``z⁺ = Φ z + Γ v + d``, exact for v held over a sample."""
    from scipy.linalg import expm

    states, inputs = B.shape
    exponent = np.zeros((states + inputs + 1, states + inputs + 1))
    exponent[:states, :states] = A
    exponent[:states, states:-1] = B
    exponent[:states, -1] = drift
    grown = expm(sample_time * exponent)[:states]
    return grown[:, :states], grown[:, states:-1], grown[:, -1]
