"""The motion that others are measured against, with an estimate of its own error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tenscontrol.accuracy.case import Case, as_case
from tenscontrol.accuracy.located import Located
from tenscontrol.dynamics import unpack_states
from tenscontrol.integrate import DOP853
from tenscontrol.scene import Scene
from tenscontrol.validation import FloatArray, frozen, whole_number

_TOLERANCE = 1e-13

# Switches closer than this part of the duration are one moment, set apart by round-off.
_TOGETHER = 1e-9


@dataclass(frozen=True, eq=False)
class ConvergedMotion:
    """A motion computed twice by codes that share only the state equation.

    Made by :func:`converged_motion`.

    Attributes
    ----------
    time : ndarray, shape (T,)
        s, equally spaced, without the start.
    nodes, velocities : ndarray, shape (3, n, T)
        m and m/s.
    states : ndarray, shape (6n, T)
        The same of the free nodes, as integrators have them.
    error : float
        Estimate of its error, m: the largest distance of a node between the two.
    switches : ndarray, shape (S,)
        When strings went slack or taut, s; what switches within round-off counts once.
    """

    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    states: FloatArray
    error: float
    switches: FloatArray

    def summary(self) -> str:
        """Return what the reference is and how good, as text.

        Returns
        -------
        str
        """
        return (
            f"reference: order 8, tolerance {_TOLERANCE:g}, every one of {len(self.switches)} "
            f"switches located; a second code differs by {self.error:.1e} m"
        )


def converged_motion(
    scene: Case | Scene,
    outputs: int = 100,
    report: Callable[[float], None] | None = None,
) -> ConvergedMotion:
    """Return the motion of a case as exactly as double precision allows, and its error.

    It is integrated by SciPy's DOP853 in smooth pieces, each switch of a
    string found by Brent's method on the dense output, and again by the
    package's own ``"dop853"``, which shares neither the steps nor the search
    for switches with it. How far the two part is the estimate of the error.

    Parameters
    ----------
    scene : Case or Scene
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
    >>> case = tc.Case(tc.Model(prism), 1.0, input="force_density", value=gamma)
    >>> found = tc.accuracy.converged_motion(case, outputs=20)
    >>> found.nodes.shape, found.error < 1e-11
    ((3, 6, 20), True)
    """
    case = as_case(scene)
    count = whole_number("outputs", outputs, least=1)
    times = case.duration * np.arange(1, count + 1) / count
    located = Located(case)
    found = []
    for time, state in zip(times, located.states(times, _TOLERANCE), strict=True):
        found.append(state)
        if report is not None:
            report(float(time))
    states = np.column_stack(found)
    span = DOP853(case.equation(), _TOLERANCE).advance(case.state, case.value, case.duration, count)
    nodes, velocities = unpack_states(case.structure, states)
    error = largest_distance(nodes, unpack_states(case.structure, span.states)[0])
    return ConvergedMotion(
        time=frozen(times),
        nodes=frozen(nodes),
        velocities=frozen(velocities),
        states=frozen(states),
        error=error,
        switches=frozen(_moments(located.switches, case.duration)),
    )


def _moments(switches: list[float], duration: float) -> FloatArray:
    """Return times of switches, those that round-off sets apart once."""
    times = np.array(switches)
    return times[np.diff(times, prepend=-duration) > _TOGETHER * duration]


def largest_distance(nodes: FloatArray, others: FloatArray) -> float:
    """Return the largest distance of a node between two motions, shape (3, n, T), m."""
    return float(np.linalg.norm(nodes - others, axis=0).max())
