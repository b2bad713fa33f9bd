"""How far a motion in fixed steps is off: parts of it are taken again in half the steps."""

from __future__ import annotations

from math import ceil

import numpy as np

from tenscontrol.integrate import IntegrationError, Integrator
from tenscontrol.validation import FloatArray

# Parts that are looked at, spread over the motion, and the most of it that they may be: a second
# look must not take longer than the motion itself.
_PARTS, _SHARE = 16, 0.25

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
    between. Twice their mean times the number of such parts in the motion is
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
        long as the motion. Infinite where the second look runs away.
    """
    intervals = len(time) - 1
    count = min(_PARTS, int(_SHARE * intervals))
    if count == 0:
        return None
    parts = np.unique(np.linspace(0, intervals - 1, count).round().astype(int))
    errors = []
    for k in parts:
        duration = float(time[k + 1] - time[k])
        halves = 2 * max(1, ceil(duration / step - 1e-9))
        try:
            span = integrator.advance(states[:, k], inputs[:, k + 1], duration, halves)
        except IntegrationError:
            return float("inf")
        change = (span.states[:, -1] - states[:, k + 1])[: len(states) // 2].reshape(-1, 3)
        errors.append(np.linalg.norm(change, axis=1).max())
    return _SAFETY * float(np.mean(errors)) * intervals / size
