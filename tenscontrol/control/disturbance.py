"""Estimate of an unknown constant load from the prediction error of the plant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.reduced_dynamics import checked_tracked

# Weight of the departure of inputs in the choice of where to rest, against that of what is
# tracked: small enough that nothing is given up for it.
_THRIFT = 1e-6


@dataclass(frozen=True, eq=False)
class LoadModel:
    """What a constant unknown load does to a plant: accelerations a held over each sample."""

    response: FloatArray  # Ψ, (s, r): what unit accelerations, held over a sample, do to the state
    gain: FloatArray  # g Ψ⁺, (r, s): accelerations that a change of the state is laid to
    shift: FloatArray  # (r, r), change of q at which the plant rests under unit accelerations
    effort: FloatArray  # (α, r), change of v that holds it there
    share: float  # g
    weight: FloatArray  # (r + α, r + α), of departures of q and v, in units of each
    reach: float  # unit of q̈ by q
    unit: float  # unit of v

    def rest(self, accelerations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return changes of q, (K, r), and of v, (K, α), that balance accelerations, (K, r)."""
        return accelerations @ self.shift.T, accelerations @ self.effort.T

    def rest_of(
        self, accelerations: FloatArray, stiffness: FloatArray, by_input: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the same by derivatives of q̈ of each plant, by q (K, r, r) and by v (K, r, α)."""
        (K, r), whole = accelerations.shape, len(self.weight)
        by_unit = by_input * self.unit / self.reach
        balance = np.concatenate([stiffness / self.reach, by_unit], axis=2)
        system = np.zeros((K, whole + r, whole + r))
        system[:, :whole, :whole] = self.weight
        system[:, whole:, :whole], system[:, :whole, whole:] = balance, balance.swapaxes(1, 2)
        sides = np.zeros((K, whole + r, 1))
        sides[:, whole:, 0] = -accelerations / self.reach
        answer = solve_stacked(system, sides)[:, :, 0]
        return answer[:, :r], self.unit * answer[:, r:whole]


def load_model(
    plant: LinearPlant, response: FloatArray, gain: float, tracked: FloatArray
) -> LoadModel:
    """Return what a load does, and where to rest under it; ``tracked`` is of q, shape (p, r)."""
    r, count = plant.degrees_of_freedom, plant.B.shape[1]
    # min ‖H q‖² + thrift (‖q‖² + ‖v‖²), in units of each, where A₂₁ q + B₂ v + a = 0.
    stiffness, by_input = plant.A[r:, :r], plant.B[r:]
    reach = max(float(np.linalg.norm(stiffness, 2)), 1e-300)
    unit = reach / float(np.linalg.norm(by_input, 2))
    size = max(float(np.linalg.norm(tracked, 2)), 1e-150)  # its square stays above zero
    weight = np.zeros((r + count, r + count))
    weight[:r, :r] = tracked.T @ tracked / size**2
    weight += _THRIFT * np.eye(r + count)
    balance = np.hstack([stiffness / reach, by_input * unit / reach])
    system = np.block([[weight, balance.T], [balance, np.zeros((r, r))]])
    unit_loads = np.vstack([np.zeros((r + count, r)), np.eye(r)])
    answer = np.linalg.lstsq(system, unit_loads, rcond=None)[0]
    return LoadModel(
        response=response,
        gain=frozen(gain * np.linalg.pinv(response)),
        shift=frozen(-answer[:r] / reach),
        effort=frozen(-unit * answer[r : r + count] / reach),
        share=gain,
        weight=frozen(weight),
        reach=reach,
        unit=unit,
    )


class LoadObserver:
    """Estimates constant accelerations that the model does not know.

    The state is measured whole, so the disturbance model needs no Kalman filter for it:
    what the state did beyond the prediction is laid to accelerations a held over the sample,
    ``a ← a + g Ψ⁺ (z − ẑ)``, which settles as (1 − g)^k. An integrating disturbance of as many
    entries as are tracked is what offset-free tracking takes (Pannocchia & Rawlings 2003,
    doi:10.1002/aic.690490213). ``acceleration`` is the estimate a, shape (r,).
    """

    def __init__(self, model: LoadModel) -> None:
        self.model = model
        self.reset()

    def reset(self) -> None:
        """Forget the estimate."""
        self.acceleration = np.zeros(self.model.response.shape[1])
        self._free_response: FloatArray | None = None

    def correct(
        self, state: FloatArray, input_response: FloatArray, response: FloatArray | None = None
    ) -> None:
        """Compare a measured state, shape (s,), with what was expected.

        The input response, shape (s,), is what the input that was held since the last sample did
        to the state. Where it is not finite, nothing is learned. The response is Ψ of that sample,
        if it is not that of the model: where strings are stiff, that of another shape says nothing.
        """
        if self._free_response is not None:
            off = state - (self._free_response + input_response)
            # The nonlinear dynamics have no value where a bar turns beyond the coordinates.
            if np.isfinite(off).all():
                gain = self.model.gain
                if response is not None:
                    gain = np.asarray(self.model.share * np.linalg.pinv(response), dtype=float)
                self.acceleration = self.acceleration + gain @ off

    def expect(self, state: FloatArray | None) -> None:
        """Note the state at the next sample, the load but no input included; None if unknown."""
        self._free_response = state


def load_observer(
    plant: LinearPlant, response: FloatArray, gain: float, tracked: object
) -> LoadObserver:
    """Return an observer of this gain, for combinations of node positions that are tracked."""
    combinations = np.eye(plant.degrees_of_freedom)
    if tracked is not None:
        combinations = checked_tracked(plant, tracked) @ plant.basis
    return LoadObserver(load_model(plant, response, gain, combinations))


def solve_stacked(systems: FloatArray, sides: FloatArray) -> FloatArray:
    """Solve K systems, (K, m, m), for sides (K, m, ·); NaN where one has no solution."""
    try:
        return np.asarray(np.linalg.solve(systems, sides), dtype=float)
    except np.linalg.LinAlgError:
        return np.full(sides.shape, np.nan)
