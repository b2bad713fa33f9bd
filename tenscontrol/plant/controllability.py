"""Controllability of a linear plant, pole by pole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.dynamics import coordinates
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.validation import FloatArray, frozen, instance

# A direction or margin below this fraction of its surroundings does not exist.
_TOLERANCE = 1e-9

# Eigenvalues closer than this fraction of the largest are one: round-off splits
# a double pole by about 1e-8.
_SAME_POLE = 1e-6


@dataclass(frozen=True, eq=False)
class Controllability:
    """Result of the PBH test. Made by :func:`controllability`.

    Attributes
    ----------
    pole : ndarray of complex, shape (k,)
        The different poles with Im s ≥ 0, 1/s, by size.
    margin : ndarray, shape (k,)
        Smallest singular value of ``[s I − A, B]``: how far A and B must
        change, in the plant's units, before the inputs lose the pole.
    unreachable : int
        Number of states that no input reaches, rate states included.
    """

    pole: np.ndarray
    margin: FloatArray
    unreachable: int

    @property
    def is_controllable(self) -> bool:
        """Whether the inputs reach every state."""
        return self.unreachable == 0

    def table(self) -> str:
        """Return the test as text, one pole a line.

        Returns
        -------
        str
        """
        lines = ["pole 1/s                margin"]
        for pole, margin in zip(self.pole, self.margin, strict=True):
            lines.append(f"{pole.real:9.4f} {pole.imag:+9.4f}j  {margin:9.3g}")
        return "\n".join(lines)


def controllability(plant: LinearPlant) -> Controllability:
    """Test by Popov, Belevitch and Hautus whether the inputs reach every pole.

    Parameters
    ----------
    plant : LinearPlant

    Returns
    -------
    Controllability

    Raises
    ------
    TypeError
        If ``plant`` is not a linear plant.

    Notes
    -----
    Hautus (1969): (A, B) is controllable if and only if ``[s I − A, B]`` has
    full row rank at every eigenvalue s of A.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> print(tc.controllability(plant).table())
    pole 1/s                margin
       0.0000   +0.0000j          1
       0.0000  +14.2830j     0.0584
       0.0000  +14.6810j     0.0246
       0.0000  +15.3523j     0.0966
    """
    instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    poles = distinct_poles(plant.A)
    margins = [_margin(plant.A, plant.B, pole) for pole in poles]
    return Controllability(
        pole=frozen(poles),
        margin=frozen(np.array(margins)),
        unreachable=len(plant.A) - reached_dimension(*_scaled(plant)[:2]),
    )


def lost_poles(plant: LinearPlant) -> np.ndarray:
    """Return the poles, Re s ≥ 0, that no input reaches; whatever the units of the plant."""
    poles = distinct_poles(plant.A)
    A, B, highest = _scaled(plant)
    if B.shape[1]:
        B = B / max(float(np.linalg.norm(B, 2)), 1e-300)
    slow = poles.real >= -_SAME_POLE * np.abs(poles).max(initial=0.0)
    lost = [pole for pole in poles[slow] if _margin(A, B, pole / highest) < _TOLERANCE]
    return np.array(lost, dtype=complex)


def refuse_empty(plant: LinearPlant) -> None:
    """Raise if there is nothing to control."""
    states, inputs = plant.B.shape
    if states == 0 or inputs == 0:
        raise ValueError(
            f"plant has {states} states and {inputs} inputs, so there is nothing to control"
        )


def refuse_unreachable(plant: LinearPlant) -> None:
    """Raise if a pole that does not decay is out of reach, saying which and what to do."""
    lost = lost_poles(plant)
    if len(lost) == 0:
        return
    kind, unreachable = plant.coordinates.kind, controllability(plant).unreachable
    counts = {
        each: coordinates(plant.model, plant.nodes, each).count
        for each in ("nodes", "minimal", "internal")
    }
    what = []
    if kind == "nodes":
        what.append(
            (2 * (counts["nodes"] - counts["minimal"]), "are lengths of bars and their rates")
        )
    if kind != "internal":
        rigid = 2 * (counts["minimal"] - counts["internal"])
        what.append((rigid, "are motions of the structure as one body"))
    inner = unreachable - sum(count for count, _ in what)
    if inner:
        poles = ", ".join(f"{pole:.4g}" for pole in lost)
        what.append((inner, f"are changes of shape, at the poles {poles} 1/s"))
    advice = (
        "Damping, other strings or another prestress would mend that; controllability(plant) "
        "says more"
        if inner
        else "Internal forces change neither: linearize with coordinates='internal'"
    )
    listed = " and ".join(f"{count} {meaning}" for count, meaning in what if count)
    raise ValueError(
        f"{unreachable} of the {len(plant.A)} states of the plant in {kind!r} coordinates are out "
        f"of reach of the strings, and do not decay by themselves: {listed}. {advice}"
    )


def distinct_poles(A: FloatArray) -> np.ndarray:
    """Return the different eigenvalues with Im s ≥ 0, by size; equal ones are averaged."""
    values = np.linalg.eigvals(A)
    same = _SAME_POLE * max(float(np.abs(values).max(initial=0.0)), 1e-300)
    groups: list[list[complex]] = []
    for value in sorted(values, key=abs):
        near = next((group for group in groups if abs(group[0] - value) < same), None)
        if near is None:
            groups.append([value])
        else:
            near.append(value)
    means = np.array([np.mean(group) for group in groups], dtype=complex)
    # A pole within round-off of an axis is on it.
    means.real[np.abs(means.real) < same] = 0.0
    means.imag[np.abs(means.imag) < same] = 0.0
    return means[means.imag >= 0]


def _margin(A: FloatArray, B: FloatArray, pole: complex) -> float:
    pencil = np.hstack([pole * np.eye(len(A)) - A, B])
    return float(np.linalg.svd(pencil, compute_uv=False)[-1])


def _scaled(plant: LinearPlant) -> tuple[FloatArray, FloatArray, float]:
    """Return A and B in time units of the highest frequency, and that frequency, rad/s."""
    r = plant.degrees_of_freedom
    highest = plant.spectral_radius or 1.0
    scale = np.r_[np.full(r, highest), np.ones(r)]
    return scale[:, None] * plant.A / scale / highest, scale[:, None] * plant.B, highest


def reached_dimension(A: FloatArray, block: FloatArray) -> int:
    """Return the dimension of the Krylov space of A and a block, (s, k), by block Arnoldi."""
    basis = np.zeros((len(A), 0))
    while block.shape[1] and basis.shape[1] < len(A):
        size = float(np.linalg.norm(block, 2))
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            block = block - basis @ (basis.T @ block)
        U, sizes, _ = np.linalg.svd(block, full_matrices=False)
        fresh = U[:, np.asarray(sizes) > _TOLERANCE * max(size, 1e-300)]
        basis = np.hstack([basis, fresh])
        block = A @ fresh
    return int(basis.shape[1])
