"""Energy, momentum and bar lengths of a motion, and how far they are from what they should be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.dynamics import evaluate_columns, unpack_states
from tenscontrol.validation import FloatArray


@dataclass(frozen=True, eq=False)
class Invariants:
    """What a motion conserves or should conserve, at T times.

    Attributes
    ----------
    kinetic, potential : ndarray, shape (T,)
        J. The potential energy is that of a simulation: see :class:`Trajectory`.
    momentum, angular_momentum : ndarray, shape (3, T)
        kg m/s, and kg m²/s about the origin.
    stretch : ndarray, shape (T,)
        Largest difference of a bar from its length, m.
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


def invariants(case: Case, states: FloatArray) -> Invariants:
    """Return energies, momenta and bar-length errors of states, shape (6n, T).

    Parameters
    ----------
    case : Case
    states : ndarray, shape (6n, T)

    Returns
    -------
    Invariants
    """
    model, structure = case.model, case.structure
    held = np.tile(case.value[:, None], (1, states.shape[1]))
    of_strings = model.potential_energy if case.input == "force_density" else model.elastic_energy
    (potential,) = evaluate_columns(of_strings, states, held)
    (kinetic,) = evaluate_columns(model.kinetic_energy, states)
    linear, angular = evaluate_columns(model.momentum, states)
    nodes, _ = unpack_states(structure, states)
    bars = nodes[:, structure.bars[:, 1]] - nodes[:, structure.bars[:, 0]]
    off = np.abs(np.linalg.norm(bars, axis=0) - structure.bar_length[:, None])
    work = np.einsum("in,int->t", case.load, nodes)
    return Invariants(kinetic[0], potential[0] - work, linear, angular, off.max(axis=0, initial=0))


def conserves_energy(case: Case) -> bool:
    """Return whether the motion conserves energy: no string is damped."""
    return not case.equation().velocity_dependent


def conserves_momentum(case: Case) -> bool:
    """Return whether the motion conserves momentum: nothing acts from outside."""
    return not case.load.any() and not len(case.structure.fixed)


@dataclass(frozen=True)
class Deviations:
    """How far a motion is from what it should conserve, largest over its times.

    What the motion does not conserve, under damping, loads or supports, is
    compared with the reference motion instead.

    Attributes
    ----------
    energy : float
        Error of the energy, as part of what the reference exchanges: the larger
        of its largest kinetic energy and largest change of potential energy.
    momentum, angular_momentum : float
        kg m/s and kg m²/s.
    stretch : float
        Largest difference of a bar from its length, m.
    """

    energy: float
    momentum: float
    angular_momentum: float
    stretch: float


def deviations(
    case: Case, found: Invariants, reference: Invariants, start: Invariants
) -> Deviations:
    """Return how far a motion is from what it should conserve.

    Parameters
    ----------
    case : Case
    found, reference : Invariants
        Of the motion and of the reference, at the same times.
    start : Invariants
        Of the start alone.

    Returns
    -------
    Deviations
    """
    energy = start.energy if conserves_energy(case) else reference.energy
    change = np.abs(reference.potential - start.potential)
    size = max(float(reference.kinetic.max()), float(change.max()))
    linear, angular = reference.momentum, reference.angular_momentum
    if conserves_momentum(case):
        linear, angular = start.momentum, start.angular_momentum
    off = float(np.abs(found.energy - energy).max())
    return Deviations(
        energy=off / size if size > 0 else float("nan"),
        momentum=float(np.linalg.norm(found.momentum - linear, axis=0).max()),
        angular_momentum=float(np.linalg.norm(found.angular_momentum - angular, axis=0).max()),
        stretch=float(found.stretch.max()),
    )
