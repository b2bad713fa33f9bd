"""Functions of time for inputs, loads and motions of supports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import comb
from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.interrupt import check
from tenscontrol.properties import cached_property
from tenscontrol.short_repr import short_repr

# How a profile goes from one value to the next.
_INTERPOLATIONS = ("hold", "linear", "cubic")

# A callable is replaced by polynomials of this degree, up to this error as part of its size. It is
# first looked at in so many parts; one below the last share of the time is not halved again.
_DEGREE, _TOLERANCE, _PARTS, _SHORTEST = 9, 1e-12, 16, 2.0**-22

# A callable is looked at so often over the whole time, so that no longer pulse is missed; there its
# polynomials may be off by so many times the error.
_LOOKED_AT, _ROUGHLY = 8192, 10.0

# Places in a piece at which its least value is sought.
_LOOKS = 33


@final
@dataclass(frozen=True, eq=False)
class Profile:
    """A function of time by interpolation, for the inputs and loads of :func:`simulate`.

    Before the first time the first value holds, and after the last time the last one.

    Parameters
    ----------
    time : array_like, shape (K,)
        Ascending, s. With ``"hold"`` and ``"linear"`` a time may be given twice: the value jumps.
    values : array_like, shape (..., K)
        The value at each time, in the unit of the argument; time is the last axis.
    interpolation : {"hold", "linear", "cubic"}
        The value of the last time at or before; straight lines; or the cubic spline whose rate and
        acceleration are continuous and whose rate is zero at the first and the last time.
    rates : array_like, shape (..., K), optional
        Of ``"cubic"``, the rate at each time: accelerations may then jump there.

    Raises
    ------
    TypeError, ValueError
        If an argument is not finite or does not fit, or times do not ascend.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> wind = tc.Profile([0.0, 1.0, 3.0], [[1.0, 0.8, 0.8], [1.0, 1.0, 0.6]])
    >>> wind.at(0.5), wind.rate(2.0)
    (array([0.9, 1. ]), array([ 0. , -0.2]))
    """

    time: FloatArray
    values: FloatArray
    interpolation: str = "linear"
    rates: FloatArray | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        validation.choice("interpolation", self.interpolation, _INTERPOLATIONS)
        time, values = (
            validation.vector("time", self.time),
            validation.float_array("values", self.values),
        )
        if time.ndim != 1 or not len(time):
            raise ValueError(f"time has shape {time.shape}, expected (K,): at least one time, s")
        if values.ndim == 0 or values.shape[-1] != len(time):
            raise ValueError(
                f"values has shape {values.shape}, expected (..., {len(time)}): one value for "
                "each time"
            )
        if self.rates is not None:
            if self.interpolation != "cubic":
                raise ValueError(
                    f"rates are given, but interpolation is {self.interpolation!r}: they are for "
                    "'cubic'"
                )
            rates = validation.shaped("rates", self.rates, values.shape, "one a value")
            object.__setattr__(self, "rates", frozen(rates))
        steps = np.diff(time)
        # Of a jump the value before and that after; a third would never be seen.
        twice = (steps == 0) & np.append(True, steps[:-1] > 0)
        wrong = np.flatnonzero((steps <= 0) & ~(twice & (self.interpolation != "cubic")))
        if len(wrong):
            k = int(wrong[0]) + 1
            raise ValueError(
                f"time[{k}] is {time[k]:g} s after {time[k - 1]:g} s, expected ascending times. "
                "A time may be given twice, for a jump, with 'hold' and 'linear' only"
            )
        object.__setattr__(self, "time", frozen(time))
        object.__setattr__(self, "values", frozen(values))

    def at(self, time: object) -> FloatArray:
        """Return the value at a time, or at many.

        Parameters
        ----------
        time : float or array_like, shape (T,)
            s.

        Returns
        -------
        ndarray, shape (...) or (..., T)
            At a jump the value after it.
        """
        return self._evaluated(time, 0)

    def rate(self, time: object) -> FloatArray:
        """Return the rate at a time, or at many, in the unit of the values per second.

        Parameters
        ----------
        time : float or array_like, shape (T,)
            s.

        Returns
        -------
        ndarray, shape (...) or (..., T)
            At a kink the rate after it; a jump has none.
        """
        return self._evaluated(time, 1)

    def _evaluated(self, time: object, order: int) -> FloatArray:
        times = validation.float_array("time", time)
        values = self.pieces.derivative(order).at(times.ravel())
        return values.reshape(self.values.shape[:-1] + times.shape)

    @cached_property
    def pieces(self) -> Pieces:
        """The profile as polynomials, one row an entry of the values; not for users."""
        time, rows = self.time, self.values.reshape(-1, len(self.time))
        kept = np.flatnonzero(np.diff(time) > 0)
        inner = rows[:, kept][:, :, None]
        if self.interpolation == "linear":
            slopes = (rows[:, kept + 1] - rows[:, kept]) / (time[kept + 1] - time[kept])
            inner = np.concatenate([inner, slopes[:, :, None]], axis=2)
        elif len(kept) and self.interpolation == "cubic":
            from scipy.interpolate import CubicHermiteSpline, CubicSpline

            if self.rates is None:
                spline = CubicSpline(time, rows, axis=1, bc_type="clamped")
            else:
                spline = CubicHermiteSpline(time, rows, self.rates.reshape(rows.shape), axis=1)
            inner = spline.c[::-1].transpose(2, 1, 0)
        outer = np.zeros((2, len(rows), inner.shape[2]))
        outer[:, :, 0] = rows[:, 0], rows[:, -1]
        return Pieces(
            np.concatenate([[-np.inf], time[kept], time[-1:]]),
            np.concatenate([time[:1], time[kept], time[-1:]]),
            np.concatenate([outer[:1], inner.swapaxes(0, 1), outer[1:]]),
        )


# Where a single piece begins, and the time from which it counts, s.
_ALWAYS, _ZERO = frozen(np.array([-np.inf])), frozen(np.zeros(1))


@dataclass(frozen=True, eq=False)
class Pieces:
    """A polynomial in time for each piece of time, one row a quantity.

    Attributes
    ----------
    start : ndarray, shape (P,)
        Where each piece begins, s, ascending; the first at minus infinity. The last has no end.
    origin : ndarray, shape (P,)
        The time from which each polynomial counts, s.
    coefficients : ndarray, shape (P, rows, degree + 1)
        Of ascending powers.
    """

    start: FloatArray
    origin: FloatArray
    coefficients: FloatArray

    @classmethod
    def constant(cls, values: FloatArray) -> Pieces:
        """Return what has these values, shape (rows,), at all times."""
        return cls(_ALWAYS, _ZERO, values[None, :, None])

    @classmethod
    def ramp(cls, start: float, duration: float, first: FloatArray, last: FloatArray) -> Pieces:
        """Return what goes from values, shape (rows,), at a time to others a duration later."""
        slope = (last - first) / duration
        return cls(np.array([-np.inf]), np.array([start]), np.stack([first, slope], axis=1)[None])

    @property
    def degree(self) -> int:
        """Of the polynomials."""
        return int(self.coefficients.shape[2]) - 1

    @property
    def is_constant(self) -> bool:
        """Whether nothing ever changes."""
        c = self.coefficients
        if len(c) == 1:
            return c.shape[2] == 1 or not c[:, :, 1:].any()
        return not c[:, :, 1:].any() and bool((c == c[:1]).all())

    def index(self, time: FloatArray) -> IntArray:
        """Return which piece holds from each time on."""
        return np.searchsorted(self.start, time, side="right") - 1

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at times, shape (rows, T): at a jump, those after it."""
        piece = self.index(time)
        return polynomial_at(self.coefficients[piece].transpose(1, 2, 0), time - self.origin[piece])

    def breaks(self, start: float, end: float) -> list[float]:
        """Return where pieces begin after ``start`` and before ``end``, s."""
        later = self.start[1:] if len(self.start) > 1 else ()
        return [float(t) for t in later if start < t < end]

    def within(self, start: float, end: float) -> Pieces:
        """Return the pieces that matter from a time to another."""
        if len(self.start) == 1:
            return self
        first, last = self.index(np.array([start, end]))
        inside = slice(first, last + 1)
        begin = self.start[inside].copy()
        begin[0] = -np.inf
        return Pieces(begin, self.origin[inside], self.coefficients[inside])

    def piece(self, time: float) -> tuple[float, FloatArray]:
        """Return origin and coefficients, shape (rows, degree + 1), that hold from a time on."""
        i = 0 if len(self.start) == 1 else self.index(np.array(time))
        return float(self.origin[i]), self.coefficients[i]

    def derivative(self, order: int = 1) -> Pieces:
        """Return the rates, or derivatives of a higher order; at a jump they tell nothing of it."""
        c = self.coefficients
        for _ in range(order):
            c = c[:, :, 1:] * np.arange(1, c.shape[2]) if c.shape[2] > 1 else np.zeros_like(c)
        return Pieces(self.start, self.origin, c)

    def mapped(self, matrix: Any) -> Pieces:
        """Return a matrix, shape (m, rows), dense or sparse, times the values."""
        pieces, rows, powers = self.coefficients.shape
        columns = matrix @ self.coefficients.transpose(1, 0, 2).reshape(rows, -1)
        shape = len(columns), pieces, powers
        return Pieces(self.start, self.origin, columns.reshape(shape).transpose(1, 0, 2))

    def jumps(self, start: float, end: float) -> tuple[float, float]:
        """Return the largest jump between two times, and when it is."""
        i = np.flatnonzero((self.start > start) & (self.start < end))
        if not len(i):
            return 0.0, start
        before = self.coefficients[i - 1].transpose(1, 2, 0)
        before = polynomial_at(before, self.start[i] - self.origin[i - 1])
        jumps = np.abs(self.at(self.start[i]) - before).max(axis=0, initial=0.0)
        return float(jumps.max()), float(self.start[i][jumps.argmax()])

    def with_degree(self, degree: int) -> Pieces:
        """Return the same as polynomials of a degree that is as high or higher."""
        if degree == self.degree:
            return self
        more = ((0, 0), (0, 0), (0, degree - self.degree))
        return Pieces(self.start, self.origin, np.pad(self.coefficients, more))

    def least(self, start: float, end: float) -> tuple[float, float]:
        """Return the least value between two times, as looked at often, and when that is."""
        some = self.within(start, end)
        looks = np.linspace(0.0, 1.0, 2 if self.degree < 2 else _LOOKS)
        first, ends = np.append(start, some.start[1:]), np.append(some.start[1:], end)
        coefficients, minima = some.coefficients.transpose(1, 2, 0), list[tuple[float, float]]()
        for look in looks:
            times = first + (ends - first) * look
            values = polynomial_at(coefficients, times - some.origin).min(axis=0, initial=np.inf)
            minima.append((float(values.min()), float(times[values.argmin()])))
        return min(minima)

    @staticmethod
    def added(terms: Sequence[Pieces]) -> Pieces:
        """Return the sum of several of as many rows."""
        stacked = Pieces.stacked(terms)
        pieces, rows, powers = stacked.coefficients.shape
        rows_of_terms = stacked.coefficients.reshape(pieces, len(terms), rows // len(terms), powers)
        return Pieces(stacked.start, stacked.origin, rows_of_terms.sum(axis=1))

    @staticmethod
    def stacked(blocks: Sequence[Pieces]) -> Pieces:
        """Return the rows of several one below the other, their pieces cut where any begins."""
        if len(blocks) == 1:
            return blocks[0]
        degree = max(block.degree for block in blocks)
        start = np.unique(np.concatenate([block.start for block in blocks]))
        first = min(float(block.origin[0]) for block in blocks)
        origin = np.concatenate([[first], start[1:]])
        rows = []
        for block in blocks:
            i = block.index(start)
            rows.append(_moved(block.with_degree(degree).coefficients[i], origin - block.origin[i]))
        return Pieces(start, origin, np.concatenate(rows, axis=1))


def polynomial_at(coefficients: FloatArray, time: FloatArray, order: int = 0) -> FloatArray:
    """Return values, shape (rows, T), or their derivative of an order, at times, shape (T,).

    Coefficients of ascending powers have shape (rows, degree + 1), or (rows, degree + 1, T).
    """
    c = coefficients if coefficients.ndim == 3 else coefficients[:, :, None]
    for _ in range(order):
        c = c[:, 1:] * np.arange(1, c.shape[1])[:, None]
    value = np.zeros((len(c), len(time)))
    for k in reversed(range(c.shape[1])):
        value = value * time + c[:, k]
    return value


def _moved(coefficients: FloatArray, by: FloatArray) -> FloatArray:
    """Return coefficients, shape (P, rows, degree + 1), about origins moved by times."""
    size = coefficients.shape[2]
    moved = np.zeros_like(coefficients)
    for k in range(size):
        for j in range(k, size):
            moved[:, :, k] += comb(j, k) * coefficients[:, :, j] * by[:, None] ** (j - k)
    return moved


def sampled(
    name: str,
    function: Callable[[float], object],
    shape: tuple[int, ...],
    start: float,
    end: float,
) -> Pieces:
    """Return a function of time as polynomials from a start to an end, rows in Fortran order.

    They are interpolated at Chebyshev's points, and halved until the error is about 1e-12 of the
    largest value, as looked at between those points and at :func:`sampling_interval`.
    """
    polynomials = _Interpolation(_Sampler(name, function, shape), start, end)
    return polynomials.pieces()


class _Sampler:
    """A function of time at many times, checked."""

    def __init__(
        self, name: str, function: Callable[[float], object], shape: tuple[int, ...]
    ) -> None:
        self.name, self._function, self._shape = name, function, shape

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the values at times, one column each, rows in Fortran order."""
        check()
        values = np.empty((len(times), *self._shape))
        for k, time in enumerate(times.tolist()):
            values[k] = self._value(time)
        # All at once: to check each takes longer than to call most functions.
        wrong = np.flatnonzero(~np.isfinite(values).reshape(len(times), -1).all(axis=1))
        if len(wrong):
            validation.float_array(f"{self.name} at {times[wrong[0]]:.6g} s", values[wrong[0]])
        return np.asarray(values.T.reshape(-1, len(times), order="C"))

    def _value(self, time: float) -> FloatArray:
        value, shape = self._function(time), self._shape
        if isinstance(value, np.ndarray) and value.shape == shape and value.dtype == float:
            return value
        array = validation.float_array(f"{self.name} at {time:.6g} s", value)
        if array.shape != shape and (array.shape or len(shape) > 1):
            raise ValueError(
                f"{self.name} returns shape {array.shape} at {time:.6g} s, expected {shape}"
            )
        return array


class _Interpolation:
    """Polynomials of a function between a start and an end, at Chebyshev's points."""

    def __init__(self, values: _Sampler, start: float, end: float) -> None:
        from numpy.polynomial import chebyshev

        self._values, self._start, self._end = values, start, end
        self._basis: Any = chebyshev.chebvander
        self._points = -np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE)
        self._between = np.cos(np.pi * (np.arange(_DEGREE) + 0.5) / _DEGREE)[::-1]
        self._to_series = np.linalg.inv(self._basis(self._points, _DEGREE))
        self._at_between = self._basis(self._between, _DEGREE)
        # Slopes of Chebyshev's polynomials are at most that.
        self._steepest = np.arange(_DEGREE + 1) ** 2
        self._interval = sampling_interval(start, end)
        # So that what is small beside the rest need not be met to more than that.
        everywhere = values(np.linspace(start, end, 8 * _PARTS + 1))
        self._size = float(np.abs(everywhere).max(initial=0.0))

    def _allowed(self, a: float, b: float, series: FloatArray) -> float:
        """Return the error with which polynomials are taken: times have a round-off, too."""
        slope = 2 / (b - a) * float((np.abs(series) @ self._steepest).max(initial=0.0))
        return _TOLERANCE * self._size + float(np.spacing(max(abs(a), abs(b)))) * slope

    def _holds(self, a: float, b: float, series: FloatArray) -> bool:
        """Whether polynomials in a part are what the function is at all places looked at."""
        first = np.ceil((a - self._start) / self._interval)
        last = np.floor((b - self._start) / self._interval)
        times = np.clip(self._start + self._interval * np.arange(first, last + 1), a, b)
        if not len(times):
            return True
        basis = self._basis((2 * times - a - b) / (b - a), _DEGREE)
        off = np.abs(series @ basis.T - self._values(times)).max(initial=0.0)
        return bool(off <= _ROUGHLY * self._allowed(a, b, series))

    def _series(self, a: float, b: float) -> tuple[FloatArray, float]:
        """Return the coefficients of Chebyshev's polynomials in a part, and their error there."""
        middle, half = (a + b) / 2, (b - a) / 2
        times = middle + half * self._points
        times[[0, -1]] = a, b
        series = self._values(times) @ self._to_series.T
        between = self._values(middle + half * self._between)
        self._size = max(self._size, float(np.abs(between).max(initial=0.0)))
        off = np.abs(series @ self._at_between.T - between)
        return series, float(off.max(initial=0.0))

    def pieces(self) -> Pieces:
        """Return the polynomials, in powers of the time from the start of each piece on."""
        ends = np.linspace(self._start, self._end, _PARTS + 1).tolist()
        open_parts = list(pairwise(ends))[::-1]
        closed: list[tuple[float, float, FloatArray]] = []
        while open_parts:
            a, b = open_parts.pop()
            series, off = self._series(a, b)
            if off <= self._allowed(a, b, series) and self._holds(a, b, series):
                closed.append((a, b, series))
            elif b - a > _SHORTEST * (self._end - self._start):
                open_parts += [((a + b) / 2, b), (a, (a + b) / 2)]
            else:
                raise ValueError(
                    f"{self._values.name} jumps, has a kink or is not smooth near {a:.9g} s: "
                    "polynomials do not approximate it. Give a tc.Profile(time, values), which "
                    "may have jumps and kinks"
                )
        powers, exponents = _powers(), np.arange(_DEGREE + 1)
        c = np.array([series @ powers.T / (b - a) ** exponents for a, b, series in closed])
        starts = np.array([a for a, *_ in closed])
        return Pieces(np.concatenate([[-np.inf], starts[1:]]), starts, c)


def _powers() -> FloatArray:
    """Return Chebyshev's polynomials in powers of the part of a piece, one column each."""
    from numpy.polynomial import chebyshev

    powers = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for k in range(_DEGREE + 1):
        for j, c in enumerate(chebyshev.cheb2poly(np.eye(_DEGREE + 1)[k])):
            for i in range(j + 1):
                powers[i, k] += c * comb(j, i) * 2.0**i * (-1.0) ** (j - i)
    return powers


def sampling_interval(start: float, end: float) -> float:
    """Return the time between the places at which a callable is looked at, s, at most."""
    return (end - start) / _LOOKED_AT


def as_pieces(
    name: str, value: object, shape: tuple[int, ...], meaning: str, start: float, end: float
) -> Pieces:
    """Return an argument that may change in time as polynomials, rows in Fortran order.

    It is a :class:`Profile`, a callable, or an array of this shape; one number is for all strings.
    """
    fitting = (shape, ()) if len(shape) == 1 else (shape,)
    if isinstance(value, Profile):
        own = value.values.shape[:-1]
        if own not in fitting:
            raise ValueError(
                f"{name} is a profile of values of shape {own}, expected {shape}: {meaning}"
            )
        rows = int(np.prod(shape))
        order = np.arange(rows).reshape(shape).ravel(order="F") if own else np.zeros(rows, int)
        pieces = value.pieces
        return Pieces(pieces.start, pieces.origin, pieces.coefficients[:, order])
    if callable(value):
        try:
            value(start)
        except TypeError as error:
            raise TypeError(
                f"{name} cannot be called with a time: {error}; expected a function of a time, s, "
                f"that returns an array, {meaning}"
            ) from error
        return sampled(name, value, shape, start, end)
    array = (
        validation.vector(name, value) if len(shape) == 1 else validation.float_array(name, value)
    )
    if array.shape not in fitting and (array.ndim or array != 0):  # 0 is none
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}: {meaning}")
    return Pieces.constant(np.broadcast_to(array, shape).ravel(order="F"))
