"""The reference solution for error measurements, with an estimate of its own error.

Switches of strings and contacts are located here a second time, beside ``tenscontrol.integrate``,
and by other means, on purpose: the reference shares no code with the integrators that are measured,
so that a mistake in their location of switches cannot hide in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.open_loop import open_loop_of
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.equation import unpack_states
from tenscontrol.dynamics.evaluator import Evaluator, builds
from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.scene import Scene

_TOLERANCE = 1e-13

# Switches closer than this part of the duration are one moment, set apart by round-off.
_TOGETHER = 1e-9

# How far a string may pass the border of slack, or a contact that of the ground, before the switch
# is acted on, m. It passes within
# a time t in which the force is wrong by less than stiffness × this: below round-off after t.
_BORDER = 1e-11

# Where within a step the gaps are looked at.
_LOOKS = np.linspace(0.0, 1.0, 9)[1:]

# So many switches for each within such a part of the duration are no motion but chatter.
_CHATTER, _INSTANT = 50, 1e-9


@dataclass(frozen=True, eq=False)
class ConvergedMotion:
    """A reference solution: a motion computed by two independent codes.

    Made by :func:`converged_motion`.

    Attributes
    ----------
    time : ndarray, shape (T,)
        s, equally spaced, without the start.
    nodes, velocities : ndarray, shape (d, n, T)
        m and m/s.
    states : ndarray, shape (6n, T)
        The same of the free nodes, m and m/s, as integrators have them.
    error : float
        Estimate of its error, m: the largest distance of a node between the two.
    switches : ndarray, shape (S,)
        When strings went slack or taut, or contacts opened or closed, s; what switches within
        round-off counts once.
    """

    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    states: FloatArray
    error: float
    switches: FloatArray

    __repr__ = short_repr

    def summary(self) -> str:
        """Return what the reference is and how good, as text."""
        return (
            f"reference: order 8, tolerance {_TOLERANCE:g}, every one of {len(self.switches)} "
            f"switches located; a second code differs by {self.error:.1e} m"
        )


def converged_motion(
    scene: Scene, outputs: int = 100, report: Callable[[float], None] | None = None
) -> ConvergedMotion:
    """Return a reference solution near the limit of double precision, with its error.

    It is integrated by SciPy's DOP853 in smooth pieces, each switch of a
    string or a contact found by Brent's method on the dense output, and again by the
    package's own ``"dop853"``, which shares neither the steps nor the search
    for switches with it. How far the two part is the estimate of the error.

    Parameters
    ----------
    scene : Scene
    outputs : int
        Number of equally spaced times, the last at the end.
    report : callable, optional
        Told the time reached, s.

    Returns
    -------
    ConvergedMotion

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind.
    ArithmeticError
        If the motion runs away.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> case = tc.Scene(tc.Model(prism), 1.0, force_density=gamma)
    >>> found = tc.accuracy.converged_motion(case, outputs=20)
    >>> found.nodes.shape, found.error < 1e-11
    ((3, 6, 20), True)
    """
    case = open_loop_of(scene)
    count = validation.whole_number("outputs", outputs, 1, validation.MOST_RUNS)
    if report is not None:
        validation.function("report", report, "it is told the time reached, s")
    times = case.duration * np.arange(1, count + 1) / count
    solver = PiecewiseSolver(case)
    columns = []
    for time, state in zip(times, solver.states(times, _TOLERANCE), strict=True):
        columns.append(state)
        if report is not None:
            report(float(time))
    states = np.column_stack(columns)
    span = DOP853(case.equation(), _TOLERANCE).advance(
        case.state, case.input_value, case.duration, count
    )
    nodes, velocities = unpack_states(case.structure, states)
    error = largest_distance(nodes, unpack_states(case.structure, span.states)[0])
    switches = np.array(solver.switches)
    apart = np.diff(switches, prepend=-case.duration)
    return ConvergedMotion(
        time=frozen(times),
        nodes=frozen(nodes),
        velocities=frozen(velocities),
        states=frozen(states),
        error=error,
        switches=frozen(switches[apart > _TOGETHER * case.duration]),
    )


def largest_distance(nodes: FloatArray, others: FloatArray) -> float:
    """Return the largest distance of a node between two motions, shape (d, n, T), m."""
    return float(np.linalg.norm(nodes - others, axis=0).max())


class PiecewiseSolver:
    """SciPy's DOP853 on a case in smooth pieces, with the times of all ``switches``, s, located."""

    @builds
    def __init__(self, case: Scene) -> None:
        equation = case.equation()
        self._case = case
        self._slope = Evaluator(equation.slope)
        self._can_switch = equation.switches > 0
        self._is_damped = equation.velocity_dependent
        if self._can_switch:
            self._gap = Evaluator(equation.gap)
            self._gaps_within = Evaluator(equation.gap.map(len(_LOOKS)))
            self._held_within = np.tile(case.input_value[:, None], (1, len(_LOOKS)))
        self.switches: list[float] = []

    def states(self, times: FloatArray, tolerance: float) -> Iterator[FloatArray]:
        """Yield the states at the times, s, ascending above 0, each as soon as it is reached.

        ``tolerance`` of a step is relative and, a tenth of it, absolute. Raises ArithmeticError.
        """
        self.switches = []
        state, now, done = self._case.state, 0.0, 0
        pulls = self._gaps(state) > 0
        while done < len(times):
            sign = np.where(pulls, 1.0, -1.0)
            slope = self._smooth_slope(pulls)
            stepper = _stepper(slope, now, state, times[-1], tolerance)
            switch = None
            while switch is None and stepper.status == "running":
                begin, before = float(stepper.t), stepper.y.copy()
                _advance(stepper)
                near = self._comes_near(before, stepper.y, float(stepper.t) - begin, sign)
                if not near and stepper.t < times[done]:
                    continue
                between = stepper.dense_output()
                if near and self._crosses(between(begin + (stepper.t - begin) * _LOOKS), sign):
                    switch = self._first_crossing(between, begin, float(stepper.t), sign)
                reached = float(stepper.t) if switch is None else switch
                while done < len(times) and times[done] <= reached:
                    yield np.asarray(between(times[done]))
                    done += 1
            if switch is not None:
                # Dense output is less accurate than a step: step to the switch anew.
                stepper = _stepper(slope, begin, before, switch, tolerance)
                while stepper.status == "running":
                    _advance(stepper)
                state, now = np.asarray(stepper.y), switch
                pulls = pulls ^ (sign * self._gaps(state) < -0.5 * _BORDER)
                self._note_switch(now, len(pulls))

    def _smooth_slope(self, pulls: np.ndarray) -> Callable[[float, FloatArray], FloatArray]:
        """Return the right-hand side with these strings pulling and no others."""
        taut = pulls.astype(float)

        def slope(_: float, x: FloatArray) -> FloatArray:
            rate = self._slope(x, self._case.input_value, taut)[0].copy()
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
            raise ArithmeticError(f"strings or contacts switch without end at {now:.6g} s")

    def _gaps(self, state: FloatArray) -> FloatArray:
        if not self._can_switch:
            return np.zeros(0)
        return self._gap(state, self._case.input_value)[0].copy()

    def _comes_near(self, x0: FloatArray, x1: FloatArray, step: float, sign: FloatArray) -> bool:
        """Whether a string may reach the border in a step at twice its larger speed at the ends."""
        if not self._can_switch:
            return False
        if self._is_damped:  # the border then moves with the speed
            return True
        gap0, rate0 = (output.copy() for output in self._gap(x0, self._case.input_value))
        gap1, rate1 = self._gap(x1, self._case.input_value)
        way = 2 * step * np.maximum(np.abs(rate0), np.abs(rate1))
        return bool((sign * (gap0 + gap1) <= way + _BORDER).any())

    def _crosses(self, states: FloatArray, sign: FloatArray) -> bool:
        """Return whether a string is over the border in one of the states."""
        gaps = self._gaps_within(states, self._held_within)[0]
        return bool((sign[:, None] * gaps + _BORDER).min() < 0)

    def _first_crossing(self, between: Any, start: float, end: float, sign: FloatArray) -> float:
        """Return when the first string passes the border; one does at one of the looks."""
        from scipy.optimize import brentq

        def room(time: float) -> float:  # of the nearest string to the border, m
            return float((sign * self._gaps(between(time))).min()) + _BORDER

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
