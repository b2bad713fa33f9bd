"""Integration by SciPy with every slack/taut switch located, for references.

It shares no code with the integrators that are measured: a mistake in their
switches cannot hide in the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.dynamics import Evaluator
from tenscontrol.validation import FloatArray

# How far a string may pass the border of slack before the switch is acted on, m. It passes within
# a time t in which the force is wrong by less than stiffness × this: below round-off after t.
_BORDER = 1e-11

# Where within a step the strings are looked at.
_LOOKS = np.linspace(0.0, 1.0, 9)[1:]

# So many switches a string within such a part of the duration are no motion but chatter.
_CHATTER, _INSTANT = 50, 1e-9


class Located:
    """A case that SciPy's DOP853 integrates piece by piece, each smooth.

    Parameters
    ----------
    case : Case

    Attributes
    ----------
    switches : list of float
        When strings switched in the last run, s; what switches within round-off counts once.
    """

    def __init__(self, case: Case) -> None:
        equation = case.equation()
        self._case = case
        self._slope = Evaluator(equation.slope)
        self._can_switch = equation.switches > 0
        self._is_damped = equation.velocity_dependent
        if self._can_switch:
            self._gap = Evaluator(equation.gap)
            self._gaps_within = Evaluator(equation.gap.map(len(_LOOKS)))
            self._held_within = np.tile(case.value[:, None], (1, len(_LOOKS)))
        self.switches: list[float] = []

    def states(
        self, times: FloatArray, tolerance: float, offset: FloatArray | float = 0.0
    ) -> Iterator[FloatArray]:
        """Yield the states at the times, each as soon as it is reached.

        Parameters
        ----------
        times : ndarray, shape (T,)
            s, ascending, above 0.
        tolerance : float
            Of a step, relative and, a tenth of it, absolute.
        offset : ndarray, shape (states,), or float
            Added to the start.

        Yields
        ------
        ndarray, shape (states,)

        Raises
        ------
        ArithmeticError
            If the state grows beyond all bounds, or strings chatter.
        """
        self.switches = []
        state, now, done = self._case.state + offset, 0.0, 0
        pulls = self._gaps(state) > 0
        while done < len(times):
            sign = np.where(pulls, 1.0, -1.0)
            slope = self._smooth_slope(pulls)
            stepper = _stepper(slope, now, state, times[-1], tolerance)
            switch = None
            while switch is None and stepper.status == "running":
                at, before = float(stepper.t), stepper.y.copy()
                _advance(stepper)
                near = self._comes_near(before, stepper.y, float(stepper.t) - at, sign)
                if not near and stepper.t < times[done]:
                    continue
                between = stepper.dense_output()
                if near and self._crosses(between(at + (stepper.t - at) * _LOOKS), sign):
                    switch = self._first_crossing(between, at, float(stepper.t), sign)
                reached = float(stepper.t) if switch is None else switch
                while done < len(times) and times[done] <= reached:
                    yield np.asarray(between(times[done]))
                    done += 1
            if switch is not None:
                # Dense output is less accurate than a step: step to the switch anew.
                state, now = _landed(_stepper(slope, at, before, switch, tolerance)), switch
                pulls = pulls ^ (sign * self._gaps(state) < -0.5 * _BORDER)
                self._note_switch(now, len(pulls))

    def _smooth_slope(self, pulls: np.ndarray) -> Callable[[float, FloatArray], FloatArray]:
        """Return the right-hand side with these strings pulling and no others."""
        taut = pulls.astype(float)

        def slope(_: float, x: FloatArray) -> FloatArray:
            rate = self._slope(x, self._case.value, taut)[0].copy()
            if not np.isfinite(rate).all():
                # SciPy would shorten its step for ever.
                raise ArithmeticError("the forces are no longer finite")
            return rate

        return slope

    def _note_switch(self, now: float, strings: int) -> None:
        self.switches.append(now)
        count = _CHATTER * strings
        recent = self.switches[-count:]
        if len(recent) == count and now - recent[0] < _INSTANT * self._case.duration:
            raise ArithmeticError(f"strings switch without end at {now:.6g} s")

    def _gaps(self, state: FloatArray) -> FloatArray:
        if not self._can_switch:
            return np.zeros(0)
        return self._gap(state, self._case.value)[0].copy()

    def _room(self, state: FloatArray, sign: FloatArray) -> float:
        """Return how far the nearest string is from having passed the border, m."""
        return float((sign * self._gaps(state)).min()) + _BORDER

    def _comes_near(self, x0: FloatArray, x1: FloatArray, step: float, sign: FloatArray) -> bool:
        """Return whether a string may come to the border within a step.

        It cannot if its ends are farther away than it goes at twice its larger speed there.
        """
        if not self._can_switch:
            return False
        if self._is_damped:  # the border then moves with the speed
            return True
        gap0, rate0 = (part.copy() for part in self._gap(x0, self._case.value))
        gap1, rate1 = self._gap(x1, self._case.value)
        way = 2 * step * np.maximum(np.abs(rate0), np.abs(rate1))
        return bool((sign * (gap0 + gap1) <= way + _BORDER).any())

    def _crosses(self, states: FloatArray, sign: FloatArray) -> bool:
        """Return whether a string is over the border in one of the states."""
        gaps = self._gaps_within(states, self._held_within)[0]
        return bool((sign[:, None] * gaps + _BORDER).min() < 0)

    def _first_crossing(self, between: Any, start: float, end: float, sign: FloatArray) -> float:
        """Return when the first string passes the border; one does at one of the looks."""
        from scipy.optimize import brentq

        def room(time: float) -> float:
            return self._room(between(time), sign)

        last = start
        for time in start + (end - start) * _LOOKS:
            if room(time) < 0:
                break
            last = float(time)
        if room(last) <= 0:  # it passes at once
            return last
        return float(brentq(room, last, time, xtol=1e-15, rtol=1e-15))


def _stepper(slope: Any, start: float, state: FloatArray, end: float, tolerance: float) -> Any:
    from scipy.integrate import DOP853

    return DOP853(slope, start, state, end, rtol=tolerance, atol=0.1 * tolerance)


def _advance(stepper: Any) -> None:
    # A state that is not finite is looked for, so NumPy need not warn of it.
    with np.errstate(over="ignore", invalid="ignore"):
        trouble = stepper.step()
    if stepper.status == "failed":
        raise ArithmeticError(f"DOP853 stopped at {stepper.t:.6g} s: {trouble}")


def _landed(stepper: Any) -> FloatArray:
    """Return the state at the end of a short way."""
    while stepper.status == "running":
        _advance(stepper)
    return np.asarray(stepper.y)
