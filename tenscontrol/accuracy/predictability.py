"""Predictability of a motion: growth of a perturbation of its start."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.open_loop import open_loop_of, state_change
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.integrate.dop853 import DOP853
from tenscontrol.interrupt import keeping
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.scene import Scene
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import random_moves

# Size of the perturbation, m: far above round-off, far below what the motion is sensitive to.
_PERTURBATION = 1e-10

# Grown beyond this part of the structure's size it grows no longer as a small one does.
_SMALL = 1e-3

# What round-off amounts to, as part of the structure's size: ten units in the last place.
_ROUND_OFF = 10 * float(np.finfo(float).eps)

_TOLERANCE = 1e-12

# Times that are integrated at once.
_PART = 20


@dataclass(frozen=True, eq=False)
class Predictability:
    """Growth of a small perturbation of the start. Made by :func:`predictability`.

    Attributes
    ----------
    time : ndarray, shape (T,)
        s; up to where the growth is past what the error allows.
    growth : ndarray, shape (T,)
        Largest distance of a node from the unperturbed motion up to each time,
        over the largest at the start.
    rate : float
        Mean rate of exponential growth, ln(growth)/time, 1/s, over the time in
        which the perturbation stays small: the largest Lyapunov exponent of a
        chaotic motion that is watched for long.
    horizon : float
        Time up to which a comparison of two computed motions means something,
        s: round-off grows beyond ``error`` then. The duration where it does not.
    error : float
        The error asked for, m.
    duration : float
        s; if the user interrupted, how long it was followed.
    """

    time: FloatArray
    growth: FloatArray
    rate: float
    horizon: float
    error: float
    duration: float

    __repr__ = short_repr

    @property
    def factor(self) -> float:
        """Growth up to the last of the times."""
        return float(self.growth[-1])

    @property
    def is_limited(self) -> bool:
        """Whether the horizon comes before the end."""
        return self.horizon < self.duration

    def summary(self) -> str:
        """Return the growth and what follows from it, as text."""
        text = (
            f"a perturbation grows by {self.factor:.1e} in {self.time[-1]:g} s "
            f"({self.rate:.3g} per s)"
        )
        if self.is_limited:
            text += (
                f"; beyond {self.horizon:g} s round-off alone makes errors of {self.error:g} m, "
                "so motions are compared up to there"
            )
        return text


def predictability(
    scene: Scene,
    error: float = 1e-9,
    samples: int = 2,
    seed: int = 0,
    outputs: int = 200,
    report: Callable[[float], None] | None = None,
) -> Predictability:
    """Return how fast a small change of the start grows, and how long the motion is predictable.

    Every node is moved by about 1e-10 m at random while bars keep their lengths, and the motion is
    compared with the unperturbed one. Times at which strings go slack or taut are located in both
    motions.

    Parameters
    ----------
    scene : Scene
    error : float
        Error that a comparison is to resolve, m.
    samples : int
        Perturbations; the one that grows most counts.
    seed : int
        Of the random directions.
    outputs : int
        Times at which motions are compared.
    report : callable, optional
        Told the time reached, s.

    Returns
    -------
    Predictability
        Up to then, if Ctrl-C or SIGTERM ends it; a warning says so.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.
    ArithmeticError
        If the motion runs away.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> gamma = np.repeat([17.3205, 17.3205, 30.0], 3)
    >>> case = tc.Scene(tc.Model(prism), 1.0, force_density=gamma)
    >>> found = tc.predictability(case)
    >>> found.is_limited, found.factor < 100
    (False, True)
    """
    case = open_loop_of(scene)
    error = validation.positive_number("error", error, "m")
    count = validation.whole_number("outputs", outputs, 2, validation.MOST_RUNS)
    if report is not None:
        validation.function("report", report, "it is told the time reached, s")
    times = case.duration * np.arange(1, count + 1) / count
    random = np.random.default_rng(
        validation.whole_number("seed", seed, 0, validation.LARGEST_SEED)
    )
    offsets = [
        _offset(case, random)
        for _ in range(validation.whole_number("samples", samples, 1, validation.MOST_RUNS))
    ]
    allowed = error / (_ROUND_OFF * case.size)
    growth: list[float] = []
    with keeping("times are compared", growth.__len__):
        for largest in _growths(case, times, offsets):
            growth.append(max(largest, growth[-1] if growth else 0.0))
            if report is not None:
                report(float(times[len(growth) - 1]))
            if growth[-1] > allowed:
                break
    if growth[-1] <= allowed and len(growth) < count:  # interrupted
        case = replace(case, duration=float(times[len(growth) - 1]))
    return _judged(case, times[: len(growth)], np.array(growth), allowed, error)


def _offset(case: Scene, random: np.random.Generator) -> FloatArray:
    """Return a change of the state that moves every node at random and stretches no bar."""
    return state_change(case, _PERTURBATION * random_moves(case.structure, random))


def _growths(case: Scene, times: FloatArray, offsets: list[FloatArray]) -> Iterator[float]:
    """Yield the growth of the perturbation that has grown most, at each time."""
    structure = case.structure
    start = [_largest_move(structure, offset) for offset in offsets]
    integrator = DOP853(case.equation(), _TOLERANCE)
    still = np.zeros_like(offsets[0])
    motions = [_states(integrator, case, len(times), offset) for offset in (still, *offsets)]
    for state, *others in zip(*motions, strict=True):
        yield max(
            _largest_move(structure, other - state) / size
            for other, size in zip(others, start, strict=True)
        )


def _states(
    integrator: DOP853, case: Scene, count: int, offset: FloatArray
) -> Iterator[FloatArray]:
    """Yield so many states of a motion, integrated part by part so that it can be broken off."""
    state, spacing = case.state + offset, case.duration / count
    for first in range(0, count, _PART):
        outputs = min(_PART, count - first)
        span = integrator.advance(state, case.input_value, spacing * outputs, outputs)
        yield from span.states.T
        state = span.states[:, -1]


def _largest_move(structure: Structure, change: FloatArray) -> float:
    """Return how far the node that moves most is moved by a change of the state, m."""
    moves = np.zeros(structure.nodes.size)
    moves[structure.free_rows] = change[: len(change) // 2]
    return float(np.linalg.norm(moves.reshape(-1, structure.dimension), axis=1).max())


def _judged(
    case: Scene, times: FloatArray, growth: FloatArray, allowed: float, error: float
) -> Predictability:
    """Return the growth with its rate and the horizon, at which it passes what is allowed."""
    small = growth <= _SMALL * case.size / _PERTURBATION
    last = max(int(small.sum()) - 1, 0)
    rate = float(np.log(max(growth[last], 1.0)) / times[last])
    horizon = case.duration
    if growth[-1] > allowed:
        horizon = _rounded_down(float(times[max(len(times) - 2, 0)]))
    elif not small.all() and rate > 0:
        # No longer small, yet short of what is allowed: exponential growth is carried on.
        ahead = float(np.log(allowed / growth[last]) / rate)
        if times[last] + ahead < case.duration:
            horizon = _rounded_down(float(times[last]) + ahead)
    return Predictability(frozen(times), frozen(growth), rate, horizon, error, case.duration)


def _rounded_down(time: float) -> float:
    """Return a time with two digits that is not later."""
    unit = 10.0 ** (np.floor(np.log10(time)) - 1)
    return float(f"{np.floor(time / unit * (1 + 1e-12)) * unit:.3g}")
