"""Drift of energy, momentum and bar lengths over very many steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.measured_run import (
    conserves_energy,
    conserves_momentum,
    invariants,
    method_named,
)
from tenscontrol.accuracy.open_loop import fastest_rate, open_loop_of
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.integrate.integrator import IntegrationError, IntegrationInterrupt, Work
from tenscontrol.interrupt import check, interruptible, keeping
from tenscontrol.progress import progress_bar
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.scene import Scene
from tenscontrol.tables import aligned, shown

# States that are integrated, judged and dropped at once.
_PART = 50

# Blocks that a series is averaged over, and the part of cases that the interval is to cover.
_BLOCKS, _CONFIDENCE = 21, 0.95

# Differences of block means of a random walk share a block with the next: they are correlated by
# 1/4 with either neighbour, so that their mean varies by 1 + 2/4 times what it would alone.
_SHARED = 1.5


@dataclass(frozen=True, eq=False)
class Drift:
    """Drift of a conserved quantity over a long run.

    Attributes
    ----------
    name, unit : str
    error : ndarray, shape (T,)
        Its change since the start, in ``unit``; of a vector and of bar lengths the size of the
        change.
    slope : float
        Mean growth, in ``unit`` per s.
    half_width : float
        Of the 95 % confidence interval of the slope.
    """

    name: str
    unit: str
    error: FloatArray
    slope: float
    half_width: float

    __repr__ = short_repr

    @property
    def is_zero(self) -> bool:
        """Whether the slope cannot be told from zero: its interval covers zero."""
        return abs(self.slope) <= self.half_width

    @property
    def largest(self) -> float:
        """Largest error at any time."""
        return float(np.abs(self.error).max())


@dataclass(frozen=True, eq=False)
class LongRun:
    """Drift of a method over many steps. Made by :func:`long_run`.

    Attributes
    ----------
    method : str
    setting : float
        Step, s, or tolerance.
    time : ndarray, shape (T,)
        s, without the start.
    drifts : tuple of Drift
        Of what the motion conserves.
    energy_scale : float
        What the motion exchanges between kinetic and potential energy, J.
    work : Work
        What it cost.
    failure : str
        Why the run ended early; empty if it did not.
    """

    method: str
    setting: float
    time: FloatArray
    drifts: tuple[Drift, ...]
    energy_scale: float
    work: Work
    failure: str

    def of(self, name: str) -> Drift:
        """Return the drift of one quantity.

        Parameters
        ----------
        name : str

        Raises
        ------
        ValueError
            If the motion does not conserve it.
        """
        drifts = {drift.name: drift for drift in self.drifts}
        return drifts[validation.choice("name", name, drifts)]

    def table(self) -> str:
        """Return the drifts as text."""
        rows = [
            [
                drift.name,
                drift.unit,
                shown(drift.largest),
                shown(float(drift.error[-1]), "+.1e"),
                f"{drift.slope:+.1e} +/- {drift.half_width:.1e}",
                "cannot be told from zero" if drift.is_zero else "drifts",
            ]
            for drift in self.drifts
        ]
        head = ["quantity", "unit", "largest", "at end", "per s (95 %)", "slope"]
        lines = [
            f"{self.method} at {self.setting:g}: {self.work.steps} steps, {self.time[-1]:g} s, "
            f"{self.work.switches} switches; the motion exchanges {self.energy_scale:.3g} J",
            *([f"ended early: {self.failure}"] if self.failure else []),
        ]
        return "\n".join(lines) + "\n\n" + aligned(head, rows, left=2)

    def __repr__(self) -> str:
        return f"LongRun({self.method} at {self.setting:g}, {self.time[-1]:g} s)"


def long_run(
    scene: Scene,
    method: str,
    setting: float,
    steps: int = 1_000_000,
    outputs: int = 1000,
    progress: bool = False,
) -> LongRun:
    """Return how far energy, momentum and bar lengths drift over very many steps.

    The state is evaluated ``outputs`` times and then dropped, so memory does not grow with the
    number of steps. Quantities that the motion does not conserve, under damping, loads or
    supports, are left out.

    Parameters
    ----------
    scene : Scene
        Its duration does not count.
    method : str
    setting : float
        Step, s, or tolerance, as the method takes.
    steps : int
        Steps of a method that takes a step. One that takes a tolerance goes as
        far as ``steps`` times the inverse of the fastest rate of the motion.
    outputs : int
        Times at which the state is looked at, equally spaced.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    LongRun
        Also of a run that ended early, or by Ctrl-C or SIGTERM; a warning says so.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name.

    Notes
    -----
    The run is cut into 21 blocks. A slope is the mean difference of the means of successive blocks
    by their time; its 95 % interval is Student's t of these 20 differences as they come from a
    random walk of round-off. A slope whose interval covers zero cannot be told from zero. Of the
    three components of a momentum the one with the clearest slope is given, and its interval allows
    for the choice.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> case = tc.Scene(tc.Model(prism), 1.0, force_density=gamma)
    >>> found = tc.long_run(case, "rk4", 1e-3, steps=5000, outputs=200)
    >>> found.of("momentum").largest < 1e-12, found.of("bar length").largest < 1e-4
    (True, True)
    """
    case = open_loop_of(scene)
    chosen = method_named(method)
    setting = validation.positive_number(
        "setting", setting, "s" if chosen.setting == "step" else "1"
    )
    steps = validation.whole_number("steps", steps, least=10)
    outputs = validation.whole_number("outputs", outputs, _BLOCKS, validation.MOST_RUNS)
    with interruptible():  # CasADi may lose a key while it builds
        duration = setting * steps if chosen.setting == "step" else steps / fastest_rate(case)
        case = replace(case, duration=duration)
        recorder = _Recorder(case)
        check()
    state, spacing, failure, work = case.state, duration / outputs, "", Work()
    keep_states = keeping("states are judged", lambda: recorder.count * (recorder.count >= _BLOCKS))
    with keep_states, progress_bar(duration, progress, f"running {chosen.name}") as report:
        equation = case.equation(chosen.differentiates)
        integrator = chosen.integrator(equation, setting)
        for first in range(0, outputs, _PART):
            count = min(_PART, outputs - first)
            try:
                span = integrator.advance(state, case.input_value, spacing * count, count)
            except IntegrationInterrupt as error:
                recorder.add(error.span.states)
                work += error.span.work
                failure = f"interrupted at {spacing * first + error.time:.6g} s"
                raise
            except IntegrationError as error:
                span, reached = error.span, spacing * first + error.time
                # The message counts time from the start of the part.
                failure = f"at {reached:.6g} s; within its last {spacing * count:.6g} s, {error}"
            work += span.work
            if recorder.add(span.states) < span.states.shape[1] and not failure:
                reached = spacing * recorder.count
                failure = (
                    f"after {reached:.6g} s the motion runs away, beyond {validation.LARGEST:g} m "
                    "or m/s"
                )
            if failure:
                break
            state = span.states[:, -1]
            report(spacing * (first + count))
    if recorder.count < _BLOCKS:
        raise ValueError(
            f"setting is {setting:g}, at which {chosen.name} ends too early to judge: {failure}"
        )
    time = spacing * np.arange(1, recorder.count + 1)
    return LongRun(
        method=chosen.name,
        setting=setting,
        time=frozen(time),
        drifts=recorder.drifts(spacing),
        energy_scale=recorder.energy_scale,
        work=work,
        failure=failure,
    )


class _Recorder:
    """Keeps of states only how far conserved quantities have moved."""

    def __init__(self, case: Scene) -> None:
        self._case = case
        self._start = invariants(case, case.state[:, None])
        self._rows: dict[tuple[str, str], list[FloatArray]] = {}
        self.energy_scale = 0.0
        self.count = 0
        self._has_energy, self._has_momentum = conserves_energy(case), conserves_momentum(case)

    def add(self, states: FloatArray) -> int:
        """Keep the states before the first that is beyond ``LARGEST``; return how many."""
        good = int((np.abs(states) <= validation.LARGEST).all(axis=0).cumprod().sum())
        if not good:
            return 0
        conserved, start = invariants(self._case, states[:, :good]), self._start
        rows = {}
        if self._has_energy:
            rows["energy", "J"] = conserved.energy - start.energy
        if self._has_momentum:
            rows["momentum", "kg m/s"] = conserved.momentum - start.momentum
            angular = conserved.angular_momentum - start.angular_momentum
            rows["angular momentum", "kg m^2/s"] = angular
        if len(self._case.structure.bars):
            rows["bar length", "m"] = conserved.stretch
        for key, values in rows.items():
            self._rows.setdefault(key, []).append(values)
        change = float(np.abs(conserved.potential - start.potential).max())
        self.energy_scale = max(self.energy_scale, float(conserved.kinetic.max()), change)
        self.count += good
        return good

    def drifts(self, spacing: float) -> tuple[Drift, ...]:
        drifts = []
        for (name, unit), rows in self._rows.items():
            error = np.concatenate(rows, axis=-1)
            size = error if error.ndim == 1 else np.linalg.norm(error, axis=0)
            drifts.append(Drift(name, unit, frozen(size), *trend(spacing, error)))
        return tuple(drifts)


def trend(spacing: float, values: FloatArray) -> tuple[float, float]:
    """Return the slope of a series and the half-width of its 95 % confidence interval.

    See the notes of :func:`long_run`. ``values`` (T,) come one each ``spacing``, s. Of several
    series, (k, T), that with the clearest slope is returned; its interval allows for the choice
    (Bonferroni).
    """
    from scipy.special import stdtrit

    rows = np.atleast_2d(values)
    ends = np.linspace(0, rows.shape[1], min(_BLOCKS, rows.shape[1]) + 1).round().astype(int)
    means = np.stack([rows[:, a:b].mean(axis=1) for a, b in pairwise(ends)])
    centres = spacing * (ends[:-1] + ends[1:] - 1) / 2
    rates = np.diff(means, axis=0) / np.diff(centres)[:, None]
    count = len(rates)
    slope = rates.mean(axis=0)
    likely = 1 - (1 - _CONFIDENCE) / 2 / len(rows)
    half = stdtrit(count - 1, likely) * rates.std(axis=0, ddof=1) / np.sqrt(count / _SHARED)
    # Of a series without any change, nothing is clear.
    clear = np.abs(slope) / np.where(half > 0, half, np.inf)
    worst = int(clear.argmax())
    return float(slope[worst]), float(half[worst])
