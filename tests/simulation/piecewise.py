"""An independent oracle for inputs that change: SciPy's DOP853, ended at each kink and switch."""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

# Strings switch as far beyond the border, m: one that has switched does not switch back at once.
BAND = 1e-12


def integrated(slope, gap, state, breaks, tolerance=1e-13):
    """The state at the last of the breaks, and how often strings have switched.

    ``slope(t, x, taut)`` and ``gap(t, x)``, one entry a string, are smooth between breaks for the
    strings that pull now; where none can go slack, the gap is None.
    """
    switches = 0
    for start, end in pairwise(breaks):
        # Just inside, the inputs are those of this piece.
        inside = 1e-14 * max(1.0, abs(end))
        time, taut = start, np.zeros(0)
        if gap is not None:
            taut = (gap(start + inside, state) > 0).astype(float)
        while time < end - 2 * inside:

            def rate(t, x, taut=taut, end=end, inside=inside):
                return slope(min(t, end - inside), x, taut)

            def room(t, x, taut=taut, end=end, inside=inside):
                return ((2 * taut - 1) * gap(min(t, end - inside), x)).min() + BAND

            room.terminal, room.direction = True, -1
            found = solve_ivp(
                rate, (time, end), state, method="DOP853", rtol=tolerance, atol=tolerance,
                events=None if gap is None else room,
            )  # fmt: skip
            state, time = found.y[:, -1], found.t[-1]
            if found.status == 1:
                near = (2 * taut - 1) * gap(time, state)
                out = near <= near.min() + BAND / 2
                taut = np.where(out, 1 - taut, taut)
                switches += int(out.sum())
    return state, switches
