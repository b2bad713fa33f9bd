"""How far a motion in fixed steps is off: parts of it are taken again in half the steps."""

from __future__ import annotations

from math import ceil

import numpy as np

from tenscontrol.integrate import IntegrationError, Integrator
from tenscontrol.validation import FloatArray

# Parts that are looked at: those in which velocities change most, and others spread over the
# motion; and the most of it that they may be, as a second look must not take longer than it.
_VIOLENT, _SPREAD, _SHARE = 4, 16, 0.25

# The parts may miss the worst of the motion.
_SAFETY = 2.0


def estimated_error(
    integrator: Integrator,
    step: float,
    size: float,
    time: FloatArray,
    states: FloatArray,
    inputs: FloatArray,
) -> float | None:
    """Return about how far the nodes of a motion are off at its end, as part of the size.

    From some states along the motion the next one is found anew, in steps of
    half the length; how far the two end apart is about the error made in
    between. The errors where velocities change most are added, those of
    velocities by how far they lead in the time that is left, or that the motion
    needs for its own size; of the rest the mean stands for all. Twice that is
    the estimate: the error if errors add up, neither growing nor dying out. It
    is far too high for symplectic methods, whose errors mostly cancel. It tells
    of too long a step where energy and bar lengths do not: under damping,
    under a controller, in methods that conserve both.

    Parameters
    ----------
    integrator : Integrator
        That of the motion, with a fixed step.
    step : float
        Its step, s.
    size : float
        Size of the structure, m.
    time : ndarray, shape (T,)
        s.
    states : ndarray, shape (states, T)
        x.
    inputs : ndarray, shape (inputs, T)
        u held up to each time.

    Returns
    -------
    float or None
        None where so few states were kept that the second look would take as
        long as the motion, or the user interrupts it. Infinite where it runs away.
    """
    intervals = len(time) - 1
    most = int(_SHARE * intervals)
    if most == 0:
        return None
    half = len(states) // 2
    speed = float(np.abs(states[half:]).max())
    reach = size / speed if speed > 0 else float("inf")
    jumps = np.abs(np.diff(states[half:], axis=1)).max(axis=0)
    violent = np.argsort(jumps)[::-1][: min(_VIOLENT, most // 2)]
    spread = np.linspace(0, intervals - 1, min(_SPREAD, most)).round().astype(int)
    spread = np.setdiff1d(spread, violent)
    errors = {}
    for k in (*violent, *spread):
        duration = float(time[k + 1] - time[k])
        halves = 2 * max(1, ceil(duration / step - 1e-9))
        try:
            span = integrator.advance(states[:, k], inputs[:, k + 1], duration, halves)
        except IntegrationError as error:
            return None if error.interrupted else float("inf")
        change = (span.states[:, -1] - states[:, k + 1]).reshape(2, -1, 3)
        moved, sped = np.linalg.norm(change, axis=2).max(axis=1)
        errors[k] = moved
        if k in violent:
            errors[k] = max(moved, sped * min(float(time[-1] - time[k + 1]), reach))
    rest = intervals - len(violent)
    mean = float(np.mean([errors[k] for k in spread])) if len(spread) else 0.0
    worst = float(sum(errors[k] for k in violent))
    return _SAFETY * (worst + rest * mean) / size
