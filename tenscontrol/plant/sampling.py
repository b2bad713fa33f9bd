"""What a sample does to a plant whose input jumps at its start, or winds through it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.plant import LinearPlant
from tenscontrol.plant.reduced_reference import Stretch
from tenscontrol.validation import FloatArray, freeze_arrays


@dataclass(frozen=True, eq=False)
class Sampled:
    """The exact model of a sample, ``z⁺ = Φ z + Γ_b v_before + Γ v + d``.

    Attributes
    ----------
    transition : ndarray, shape (s, s)
        Φ.
    by_before : ndarray, shape (s, α)
        Γ_b: what the input of the sample before still does.
    by_input : ndarray, shape (s, α)
        Γ.
    drift : ndarray, shape (s,)
        d.
    ramp : bool
        Whether the input moves through the sample; if not, ``by_before`` is zero.
    """

    transition: FloatArray
    by_before: FloatArray
    by_input: FloatArray
    drift: FloatArray
    ramp: bool

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def augmented(self) -> tuple[FloatArray, FloatArray]:
        """Φ and Γ of the state ``[z; v_before]``, or of z where the input jumps."""
        if not self.ramp:
            return self.transition, self.by_input
        s, a = self.by_input.shape
        rows = np.hstack([self.transition, self.by_before])
        return np.vstack([rows, np.zeros((a, s + a))]), np.vstack([self.by_input, np.eye(a)])

    def coasting(self, state: FloatArray, before: FloatArray, origin: FloatArray) -> FloatArray:
        """Return what becomes of a state without the input to come, shape (s,), and without drift.

        Parameters
        ----------
        state : ndarray, shape (s,)
            z.
        before : ndarray, shape (α,)
            v_before.
        origin : ndarray, shape (α,)
            What v is measured from.
        """
        return np.asarray(
            self.transition @ state + self.by_before @ before - self.by_input @ origin
        )


@dataclass(frozen=True, eq=False)
class Lead:
    """What a reference asks for over a horizon of N samples.

    Attributes
    ----------
    path : Stretch
        Of N + 1 moments: the first N are those whose inputs are the origins of v.
    before : ndarray, shape (α,)
        The input that the path has before the first sample.
    reference : ndarray, shape (N, s)
        r_1 … r_N.
    drift : ndarray, shape (N, s)
        d_k of the state measured from the operating point.
    """

    path: Stretch
    before: FloatArray
    reference: FloatArray
    drift: FloatArray


def along_jumps(path: Stretch, reference: FloatArray, sampled: Sampled) -> Lead:
    """Return the lead for inputs that stand still within samples: the plant swings about rests.

    Parameters
    ----------
    path : Stretch
        At the starts of the samples, and the end of the last.
    reference : ndarray, shape (N, s)
    sampled : Sampled
    """
    rest = path.rest[:-1]
    drift = rest - rest @ sampled.transition.T + path.drift[:-1]
    return Lead(path, path.input[0], reference, drift)


def along_winding(
    path: Stretch,
    q: FloatArray,
    sampled: Sampled,
    plant: LinearPlant,
    push: FloatArray,
    sample_time: float,
) -> Lead:
    """Return the lead for inputs that move through samples as the shapes do.

    The plant is linear about the motion: with the rest lengths of the path its strings
    have no force to spare at any time, and damping and inertia alone lead away from it. (About a
    shape at rest, a stiff string would have to be known to a hundredth of its stiffness.)

    Parameters
    ----------
    path : Stretch
        At the starts of the samples, and twice beyond.
    q : ndarray, shape (N + 3, r)
        Reference at a sample before the first, at those, and once more.
    sampled : Sampled
    plant : LinearPlant
    push : ndarray, shape (s, r)
        What unit accelerations do to the state in a sample.
    sample_time : float
        s.
    """
    r = plant.degrees_of_freedom
    rates = (q[2:] - q[:-2]) / (2 * sample_time)
    motion = np.hstack([q[1:-1], rates])
    mean, gained = (rates[1:] + rates[:-1]) / 2, np.diff(rates, axis=0) / sample_time
    spare = mean @ plant.A[r:, r:].T - gained
    later = Stretch(*(value[1:] for value in vars(path).values()))
    drift = motion[1:] - motion[:-1] @ sampled.transition.T + spare @ push.T + later.drift[:-1]
    return Lead(later, path.input[0], motion[1:], drift)


def sampled(plant: LinearPlant, sample_time: float, substeps: int) -> Sampled:
    """Return what a sample does.

    Parameters
    ----------
    plant : LinearPlant
    sample_time : float
        Sample time, s.
    substeps : int
        Equal parts in which the input moves from ``v_before`` to v; 1 if it jumps at once.
    """
    transition, input_matrix, drift = plant.discretize(sample_time / substeps)
    whole, moved = np.eye(len(transition)), np.zeros_like(drift)
    before, now = np.zeros_like(input_matrix), np.zeros_like(input_matrix)
    for piece in range(1, substeps + 1):
        share = piece / substeps
        before = transition @ before + (1 - share) * input_matrix
        now = transition @ now + share * input_matrix
        moved = transition @ moved + drift
        whole = transition @ whole
    return Sampled(whole, before, now, moved, substeps > 1)
