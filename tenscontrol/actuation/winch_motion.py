"""Motion of winches and their motors within a sample, tick by tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tenscontrol.actuation.motor_record import Turning
from tenscontrol.actuation.motors import EachMotor, each_motor
from tenscontrol.actuation.winches import Winches, WinchMove, within_reach
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays, frozen
from tenscontrol.dynamics.profile import polynomial_at

# Newton steps to the rest length at which a motor can turn no further, at most, and the part of the
# rest length below which a step is the last.
_NEWTON, _CONVERGED = 50, 1e-12

# Phases of a tick in which a drive with a lag is at its largest speed, or below it.
_PHASES = 3

# kg m²: of motors without inertia among others that have some.
_LEAST_INERTIA = 1e-30

#: Force that pulls at each winch, N, and how fast it falls with the rest length, N/m, each of shape
#: (α,), at rest lengths, m, shape (α,), so long after now, s. The force is that of the strings that
#: it winds in, less that of the strings that it then pays out.
Pull = Callable[[Any, float], tuple[Any, FloatArray]]


@dataclass(frozen=True, eq=False)
class Tick:
    """Motion of rest lengths and motors in a part of a sample, as polynomials in time.

    Attributes
    ----------
    rest_length : ndarray, shape (α, degree + 1)
        Coefficients of ascending powers of the time since the tick began.
    motor : ndarray, shape (α, 3)
        The same of the rest length that there would be without play.
    share : ndarray, shape (α,)
        Part of the motion of the motor that reaches the string; less than 1 in the play.
    """

    rest_length: FloatArray
    motor: FloatArray
    share: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


class Instant(NamedTuple):
    """Winches between two ticks, shape (α,) each: arrays, or numbers with derivatives."""

    rest_length: Any  # m
    position: Any  # m: the rest length that there would be without play
    speed: Any  # m/s, of the position
    start: Any  # m: the reference at the beginning of the sample


class Moved(NamedTuple):
    """What a tick has made of winches."""

    end: Instant
    motor: tuple[Any, Any, Any]  # coefficients of the position
    string: tuple[Any, ...]  # and of the rest length, degree + 1 of them
    share: Any
    reference: Any
    slow: Any  # whether the largest speed was met
    weak: Any  # whether the torque was


class TickMap:
    """What one tick makes of winches, each on its own.

    All that it takes may be arrays of one shape, or numbers with derivatives in place of them.

    Parameters
    ----------
    winches : Winches
    motor : EachMotor
        Their motors.
    rate : array_like, optional
        Largest speeds, m/s, beside those of the motors.
    sample_time : float
        s.
    ticks : int
        Parts of a sample.
    """

    def __init__(
        self, winches: Winches, motor: EachMotor, rate: Any, sample_time: float, ticks: int
    ) -> None:
        self._winches, self._motor = winches, motor
        self._rate = motor.rate if rate is None else np.minimum(motor.rate, rate)
        self._sample_time, self._ticks = sample_time, ticks

    def __call__(self, number: Any, at: Instant, within: Any, stuck: Any, pull: Pull) -> Moved:
        """Return what a tick of the sample, counted from 1, makes of winches.

        ``within`` is the command, m, within their range. What is stuck stays.
        """
        winches, time = self._winches, self._sample_time / self._ticks
        before, target = self._reference(number, at.start, within)
        first = at.speed
        slow = weak = np.zeros(1, dtype=bool)
        if winches.degree == 2:
            end, speed, slow, weak = self._accelerated(at, target, time, pull)
            end = np.where(stuck, at.position, end)
            first, speed = (np.where(stuck, 0.0, v) for v in (first, speed))
            acceleration = (speed - first) / time
            slow, weak = slow & ~stuck, weak & ~stuck
        else:
            end, slow = self._followed(at.position, before, target, time)
            end, weak = self._within_torque(at.position, end, pull, time * (not winches.jumps))
            end = np.where(stuck, at.position, end)
            acceleration = np.zeros(end.shape)
            first = speed = acceleration if winches.jumps else (end - at.position) / time
        play = self._motor.play / 2
        reached = np.clip(at.rest_length, end - play, end + play)
        moved = end - at.position
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(moved != 0, (reached - at.rest_length) / moved, 1.0)
        after = Instant(reached, end, speed, at.start)
        if winches.jumps:
            motor = end, acceleration, acceleration
            return Moved(after, motor, (reached,), share, target, slow, weak)
        motor = at.position, first, acceleration / 2
        string = at.rest_length, share * first, share * acceleration / 2
        string_of_degree = string[: winches.degree + 1]
        return Moved(after, motor, string_of_degree, share, target, slow, weak)

    def _reference(self, number: Any, start: Any, within: Any) -> tuple[Any, Any]:
        """Return what winches follow from the beginning of a tick to its end, m."""
        target = within
        if not self._winches.has_drive:
            target = within_reach(within, start, self._rate * self._sample_time)
        if not self._winches.ramp:
            return target, target
        way = target - start
        until = np.where(number < self._ticks, start + number / self._ticks * way, target)
        return start + (number - 1) / self._ticks * way, until

    def _followed(self, position: Any, before: Any, target: Any, time: float) -> tuple[Any, Any]:
        """Return the positions at the end of a tick, without inertia or limit of torque.

        And which were at their largest speed. The reference goes in a straight line from ``before``
        to ``target``. A drive with a lag closes the gap g to it by dg/dt = v - g/lag, v its speed,
        or at the largest speed.
        """
        lag, rate = self._motor.lag, self._rate
        at_once = within_reach(target, position, rate * time)
        if not (lag > 0).any():
            return at_once, np.zeros(1, dtype=bool)
        gap, speed = before - position, (target - before) / time
        left, slow = np.full(gap.shape, time), (lag == 0) & (at_once != target)
        with np.errstate(invalid="ignore", divide="ignore"):
            most, still = rate * lag, speed * lag
            # At the largest speed, then slower, then at the largest speed the other way.
            for _ in range(_PHASES):
                way = np.sign(gap)
                closing = rate - way * speed
                full = (np.abs(gap) > most) | ((np.abs(gap) == most) & (closing <= 0))
                edge = np.where(full, way, np.sign(speed)) * most
                until = np.where(closing > 0, (np.abs(gap) - most) / closing, np.inf)
                slower = np.where(
                    np.abs(speed) > rate, lag * np.log((still - gap) / (still - edge)), np.inf
                )
                until = np.where(full, until, slower)
                span = np.minimum(left, until)
                moved = np.where(
                    full, gap - way * closing * span, still + (gap - still) * np.exp(-span / lag)
                )
                slow = slow | (full & (span > 0) & (lag > 0))
                gap, left = np.where(until < left, edge, moved), left - span
        return np.where(lag > 0, target - gap, at_once), slow

    def _accelerated(
        self, at: Instant, target: Any, time: float, pull: Pull
    ) -> tuple[Any, Any, Any, Any]:
        """Return positions and speeds at the end of a tick of constant acceleration.

        As fast as torque and speed allow, and no faster than can be stopped at the target. And
        which motors met their speed, and their torque.
        """
        motor, lever = self._motor, self._motor.lever
        expected = np.maximum(at.rest_length + at.speed * time, at.rest_length / 2)
        force = (pull(at.rest_length, 0.0)[0] + pull(expected, time)[0]) / 2
        gain = lever / np.maximum(motor.inertia, _LEAST_INERTIA)
        winding = gain * (motor.torque - lever * force)
        paying = gain * (motor.torque + lever * force)
        low, high = at.speed - winding * time, at.speed + paying * time
        low = np.where(winding < 0, np.minimum(low, 0.0), low)  # a brake holds
        high = np.where(paying < 0, np.maximum(high, 0.0), high)
        gap = target - at.position - at.speed * time / 2
        braking = np.maximum(np.where(gap > 0, winding, paying), 0.0)
        # What is left at the end of the tick must do to stop in whole ticks.
        stopping = braking * time + np.sqrt((braking * time) ** 2 + 2 * braking * np.abs(gap))
        with np.errstate(invalid="ignore", divide="ignore"):
            # Where the torque cannot stop it, the brake does, at once.
            closing = np.where(stopping > 0, 2 * braking / stopping, np.inf)
        wished = gap * np.minimum(closing, 1 / (motor.lag + time / 2))
        wanted = np.clip(wished, -self._rate, self._rate)
        speed = np.clip(wanted, low, high)
        end = at.position + (at.speed + speed) * time / 2
        return end, speed, np.abs(wished) > self._rate, speed != wanted

    def _within_torque(self, position: Any, end: Any, pull: Pull, time: float) -> tuple[Any, Any]:
        """Return positions so long after now up to which motors turn on the way to others.

        Against the pull a motor turns up to where that takes all of its torque, or holds. And which
        motors met it.
        """
        motor = self._motor
        if not np.isfinite(motor.torque).any():
            return end, np.zeros(1, dtype=bool)
        first, last = np.asarray(position), np.asarray(end)  # without derivatives
        way = np.sign(first - last)  # 1 where it winds in

        def excess(at: FloatArray) -> tuple[Any, FloatArray]:
            force, stiffness = pull(at + way * motor.play / 2, time)
            return way * force - motor.most_tension, stiffness

        over, slope = excess(last)
        strained = (way != 0) & (over > 0)
        if not strained.any():
            return end, strained
        moves = strained & (excess(first)[0] < 0)
        # The pull falls with the rest length: what it takes grows on the way.
        reached, too_far, at = first, last, last
        for _ in range(_NEWTON):
            over = np.asarray(over)
            with np.errstate(all="ignore"):  # where nothing pulls, and of motions that run away
                step = at + way * over / slope
                is_between = (step - too_far) * (step - reached) <= 0
            before, at = at, np.where(is_between, step, (too_far + reached) / 2)
            over, slope = excess(at)
            if (np.abs(at - before) <= _CONVERGED * np.abs(first))[moves].all():
                break
            too_far, reached = np.where(over > 0, at, too_far), np.where(over > 0, reached, at)
        with np.errstate(all="ignore"):
            at = at + way * over / slope
        return np.where(moves, at, np.where(strained, position, end)), strained


class Drive:
    """Winches in motion: follows one command a sample, tick by tick.

    A sample has ``ticks`` equal parts, so many times those of the winches as ``finer`` says.

    Attributes
    ----------
    ticks : int
        Parts of a sample.
    now : Instant
        Where the winches are.
    reference : ndarray, shape (α,)
        The rest length that the motors follow, m: a ramp goes from that of the last sample to the
        command, wherever a lag or an inertia has left the motors.
    within, stuck : ndarray, shape (α,)
        The command of the sample, m, within the range of the winches, and which of them are stuck.
    """

    def __init__(
        self,
        winches: Winches,
        rest_length: FloatArray,
        sample_time: float,
        motion: FloatArray | None = None,
        finer: int = 1,
    ) -> None:
        count = len(rest_length)
        winches.move(rest_length, rest_length, sample_time)  # or the limits do not fit
        self._winches, self._sample_time = winches, sample_time
        self.ticks = finer * winches.ticks
        motor = each_motor(winches.motor, count)
        self._map = TickMap(winches, motor, winches.rate, sample_time, self.ticks)
        if motion is None:
            motion = np.stack([rest_length, np.zeros(count), rest_length])
        self.now = Instant(rest_length, motion[0], motion[1], motion[0])
        self.reference: FloatArray = motion[2]
        self._before = self.now.position
        self._history: list[tuple[float, Tick]] = []

    @property
    def rest_length(self) -> FloatArray:
        """Where they are, m."""
        return np.asarray(self.now.rest_length)

    @property
    def position(self) -> FloatArray:
        """The rest length that there would be without play, m."""
        return np.asarray(self.now.position)

    def begin(self, wanted: FloatArray, stuck: IntArray) -> WinchMove:
        """Take a command, m, shape (α,), and return the move that it leads to if torque allows."""
        self._move = self._winches.move(self.position, wanted, self._sample_time)
        self.stuck = np.isin(np.arange(len(wanted)), stuck)
        self.within = np.clip(wanted, *self._winches.range(len(wanted)))
        start = self.position
        if self._winches.has_drive:
            start = self.reference
            self._move = replace(self._move, rate_limited=self._move.rate_limited[:0])
        self.now = self.now._replace(start=start)
        self._slow = np.zeros(len(wanted), dtype=bool)
        self._weak = np.zeros(len(wanted), dtype=bool)
        return self._move

    def tick(self, number: int, now: float, pull: Pull) -> Tick:
        """Move through a tick of the sample, counted from 1, that begins now, s; return how."""
        moved = self._map(number, self.now, self.within, self.stuck, pull)
        self._slow |= moved.slow
        self._weak |= moved.weak
        self.now, self.reference = moved.end, moved.reference
        string, motor = (np.stack(rows, axis=-1) for rows in (moved.string, moved.motor))
        tick = Tick(string, motor, moved.share)
        if self._winches.motor is not None:
            self._history.append((now, tick))
        return tick

    def turning(self, begins: FloatArray, times: FloatArray, force: FloatArray) -> Turning:
        """Return the motion of the motors at times, s, in intervals with these beginnings, (T,).

        ``force`` is that of the strings, N, shape (α, T).
        """
        starts, k = self._tick_at(begins)
        motion = np.stack([tick.motor for _, tick in self._history])
        share = np.stack([tick.share for _, tick in self._history])
        c, times_in_tick = motion[k].transpose(1, 2, 0), times - starts[k]
        rate = polynomial_at(c, times_in_tick, 1)
        if self._winches.jumps:
            came = np.vstack([self._before, motion[:-1, :, 0]])
            rate = ((motion[:, :, 0] - came) * self.ticks / self._sample_time)[k].T
        return Turning(polynomial_at(c, times_in_tick), rate, 2 * c[:, 2], force * share[k].T)

    def rest_lengths(self, times: FloatArray) -> FloatArray:
        """Return rest lengths at times, s, of the ticks that there were, m, shape (α, T)."""
        starts, k = self._tick_at(times - self._sample_time / self.ticks / 2)
        strings = np.stack([tick.rest_length for _, tick in self._history])
        return polynomial_at(strings[k].transpose(1, 2, 0), times - starts[k])

    def _tick_at(self, begins: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return when each tick began, s, and which of them were under way at times, s."""
        starts = np.array([now for now, _ in self._history])
        close = 1e-6 * self._sample_time / self.ticks
        return starts, np.maximum(np.searchsorted(starts, begins + close, side="right") - 1, 0)

    def end(self) -> WinchMove:
        """Return the move of the sample, with the limits that were met."""
        slow = np.union1d(self._move.rate_limited, np.flatnonzero(self._slow))
        return replace(
            self._move,
            rest_length=frozen(self.rest_length),
            rate_limited=frozen(slow.astype(np.int64)),
            torque_limited=frozen(np.flatnonzero(self._weak)),
        )
