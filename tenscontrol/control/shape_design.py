"""From what a user asks of shape control to the numbers of its law."""

from __future__ import annotations

from math import ceil, floor, log10, pi

import numpy as np

from tenscontrol.plant import LinearPlant, checked_tracked
from tenscontrol.validation import FloatArray, choice, positive_number


def refuse_other_plants(plant: LinearPlant) -> None:
    """Raise for a plant whose accelerations are not affine in the input, or not measured so."""
    if plant.input != "force_density":
        raise ValueError(
            f"plant has input={plant.input!r}, in which accelerations are not affine; linearize "
            "with input='force_density'"
        )
    choice("plant.coordinates.kind", plant.coordinates.kind, ("internal", "minimal"))


def error_rates(frequency: object, damping: object, sample_time: float) -> tuple[float, float]:
    """Return a and b, or raise where samples of this length make the error grow."""
    omega = 2 * pi * positive_number("frequency", frequency, "Hz")
    a, b = 2 * positive_number("damping", damping, "no unit") * omega, omega**2
    # With Ë held over a sample: det < 1 and trace > −1 − det of the map of (E, Ė).
    if a * sample_time >= 2 or b * sample_time >= 2 * a:
        raise ValueError(
            f"frequency {omega / (2 * pi):g} Hz and damping {a / (2 * omega):g} give a = {a:g} 1/s "
            f"and b = {b:g} 1/s²: in samples of {sample_time:g} s the error would grow; expected "
            f"a·sample_time < 2 and b·sample_time < 2a. Lower the frequency or sample_time"
        )
    return a, b


def combinations(plant: LinearPlant, tracked: object) -> FloatArray:
    """Return C, shape (p, 3n)."""
    if tracked is not None:
        return checked_tracked(plant, tracked)
    # δN = T q, and T = (orthonormal) R: so R q measures the same displacement in m.
    R = np.linalg.qr(plant.basis)[1]
    return np.asarray(R @ plant.coordinates.project(np.eye(plant.nodes.size)))


def rounded_up(value: float) -> str:
    """Return a number rounded up to 1, 2 or 5 times a power of ten: few texts to count."""
    power = 10.0 ** floor(log10(value))
    digit = next(each for each in (1, 2, 5, 10) if ceil(value / power * 1e6) <= each * 10**6)
    return f"{digit * power:g}"
