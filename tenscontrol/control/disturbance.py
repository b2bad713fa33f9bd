"""An unknown constant load, found from what the plant does otherwise than predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.control.solved import solved
from tenscontrol.plant import LinearPlant, checked_tracked
from tenscontrol.validation import FloatArray, frozen, positive_number

# Weight of the departure of inputs in the choice of where to rest, against that of what is
# tracked: small enough that nothing is given up for it.
_THRIFT = 1e-6


@dataclass(frozen=True, eq=False)
class LoadModel:
    """What a constant unknown load does to a plant: accelerations a held over each sample.

    Attributes
    ----------
    push : ndarray, shape (s, r)
        Ψ: what unit accelerations, held over a sample, do to the state.
    gain : ndarray, shape (r, s)
        g Ψ⁺: the accelerations that an unexpected change of the state is laid to.
    shift : ndarray, shape (r, r)
        Change of q at which the plant rests under unit accelerations.
    effort : ndarray, shape (α, r)
        Change of v that holds it there.
    share : float
        g.
    weight : ndarray, shape (r + α, r + α)
        Of departures of q and v, in units of each.
    reach, unit : float
        Units of q̈ by q, and of v.
    """

    push: FloatArray
    gain: FloatArray
    shift: FloatArray
    effort: FloatArray
    share: float
    weight: FloatArray
    reach: float
    unit: float

    def rest(self, accelerations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return changes of q and v, shapes (K, r) and (K, α), at which the plant rests.

        Parameters
        ----------
        accelerations : ndarray, shape (K, r)
            All that have to be balanced.
        """
        return accelerations @ self.shift.T, accelerations @ self.effort.T

    def rest_of(
        self, accelerations: FloatArray, stiffness: FloatArray, acting: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the same as :meth:`rest`, for K plants with derivatives of q̈ of their own.

        Parameters
        ----------
        accelerations : ndarray, shape (K, r)
        stiffness, acting : ndarray, shapes (K, r, r) and (K, r, α)
            By q and by v.
        """
        (K, r), whole = accelerations.shape, len(self.weight)
        balance = np.concatenate([stiffness / self.reach, acting * self.unit / self.reach], axis=2)
        system = np.zeros((K, whole + r, whole + r))
        system[:, :whole, :whole] = self.weight
        system[:, whole:, :whole], system[:, :whole, whole:] = balance, balance.swapaxes(1, 2)
        sides = np.zeros((K, whole + r, 1))
        sides[:, whole:, 0] = -accelerations / self.reach
        answer = solved(system, sides)[:, :, 0]
        return answer[:, :r], self.unit * answer[:, r:whole]


def load_model(plant: LinearPlant, push: FloatArray, gain: float, tracked: FloatArray) -> LoadModel:
    """Return what a load does, and where to rest under it.

    Parameters
    ----------
    plant : LinearPlant
    push : ndarray, shape (s, r)
        Ψ.
    gain : float
        g, above 0 and at most 1.
    tracked : ndarray, shape (p, r)
        What is to be brought to the reference, as combinations of q.
    """
    r, count = plant.degrees_of_freedom, plant.B.shape[1]
    # min ‖H q‖² + thrift (‖q‖² + ‖v‖²), in units of each, where A₂₁ q + B₂ v + a = 0.
    stiffness, acting = plant.A[r:, :r], plant.B[r:]
    reach = max(float(np.linalg.norm(stiffness, 2)), 1e-300)
    unit = reach / float(np.linalg.norm(acting, 2))
    size = max(float(np.linalg.norm(tracked, 2)), 1e-300)
    weight = np.zeros((r + count, r + count))
    weight[:r, :r] = tracked.T @ tracked / size**2
    weight += _THRIFT * np.eye(r + count)
    balance = np.hstack([stiffness / reach, acting * unit / reach])
    system = np.block([[weight, balance.T], [balance, np.zeros((r, r))]])
    unit_loads = np.vstack([np.zeros((r + count, r)), np.eye(r)])
    answer = np.linalg.lstsq(system, unit_loads, rcond=None)[0]
    return LoadModel(
        push=push,
        gain=frozen(gain * np.linalg.pinv(push)),
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
    doi:10.1002/aic.690490213).

    Parameters
    ----------
    model : LoadModel

    Attributes
    ----------
    acceleration : ndarray, shape (r,)
        The estimate a.
    """

    def __init__(self, model: LoadModel) -> None:
        self.model = model
        self.reset()

    def reset(self) -> None:
        """Forget the estimate."""
        self.acceleration = np.zeros(self.model.push.shape[1])
        self._coasting: FloatArray | None = None

    def correct(
        self, state: FloatArray, pushed: FloatArray, push: FloatArray | None = None
    ) -> None:
        """Compare a measured state with what was expected.

        Parameters
        ----------
        state : ndarray, shape (s,)
        pushed : ndarray, shape (s,)
            What the input that was held since the last sample did to the state. Where it is
            not finite, nothing is learned.
        push : ndarray, shape (s, r), optional
            Ψ of that sample. Where strings are stiff, that of another shape says nothing.
        """
        if self._coasting is not None:
            off = state - (self._coasting + pushed)
            # The nonlinear dynamics have no value where a bar turns beyond the coordinates.
            if np.isfinite(off).all():
                gain = self.model.gain
                if push is not None:
                    gain = np.asarray(self.model.share * np.linalg.pinv(push), dtype=float)
                self.acceleration = self.acceleration + gain @ off

    def expect(self, state: FloatArray | None) -> None:
        """Note the state at the next sample, the load but no input included; None if unknown."""
        self._coasting = state


def load_observer(
    plant: LinearPlant, push: FloatArray, gain: float | None, tracked: object
) -> LoadObserver | None:
    """Return an observer for what a user asked for, None where no gain was given.

    Parameters
    ----------
    plant : LinearPlant
    push : ndarray, shape (s, r)
    gain : float or None
    tracked : array_like, shape (p, 3n), or None

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    """
    if gain is None:
        if tracked is not None:
            raise ValueError("tracked says what is free of offset under a load: give load_gain")
        return None
    if positive_number("load_gain", gain, "no unit") > 1:
        raise ValueError(f"load_gain is {gain:g}, expected above 0 and at most 1")
    combinations = np.eye(plant.degrees_of_freedom)
    if tracked is not None:
        combinations = checked_tracked(plant, tracked) @ plant.basis
    return LoadObserver(load_model(plant, push, gain, combinations))
