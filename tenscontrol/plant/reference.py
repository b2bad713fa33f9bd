"""What a controller is to follow: shapes over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.validation import (
    FloatArray,
    float_array,
    frozen,
    instance,
    non_negative,
    positive_number,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False)
class Reference:
    """Shapes at given times, held before the first and after the last, straight in between.

    Parameters
    ----------
    time : array_like, shape (K,)
        s, ascending.
    nodes : array_like, shape (3, n, K)
        Node positions at these times, m.
    force_density : array_like, shape (α, K), optional
        γ that holds the shapes, N/m, at least 0. Where several balance in a shape, it says which
        is wanted; if not given, the nearest to the operating point of the controller. For
        controllers of rest lengths: those of γ aim at γ of their operating point.

    Raises
    ------
    TypeError, ValueError
        If the arrays are not finite or do not fit, or the times do not ascend.

    Examples
    --------
    A prism on its way from 1 m to 0.85 m in two seconds:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism(height=1.0)
    >>> length = prism.bar_length[0]
    >>> time = np.linspace(0.0, 2.0, 21)
    >>> shapes = [tc.prism(radius=tc.structure.prism_radius(length, h), height=h).nodes
    ...           for h in 1.0 - 0.075 * time]
    >>> tc.Reference(time, np.stack(shapes, axis=-1)).nodes.shape
    (3, 6, 21)
    """

    time: FloatArray
    nodes: FloatArray
    force_density: FloatArray | None = None

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            time: ArrayLike,
            nodes: ArrayLike,
            force_density: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        time = float_array("time", self.time)
        nodes = float_array("nodes", self.nodes)
        if time.ndim != 1 or len(time) == 0:
            raise ValueError(f"time has shape {time.shape}, expected (K,) with K at least 1")
        if (np.diff(time) <= 0).any():
            k = int(np.argmax(np.diff(time) <= 0))
            raise ValueError(
                f"time[{k + 1}] is {time[k + 1]:g} s after time[{k}] = {time[k]:g} s; "
                "expected ascending times"
            )
        if nodes.ndim != 3 or nodes.shape[0] != 3 or nodes.shape[2] != len(time):
            raise ValueError(
                f"nodes has shape {nodes.shape}, expected (3, n, {len(time)}): one shape per time"
            )
        if self.force_density is not None:
            gamma = float_array("force_density", self.force_density)
            if gamma.ndim != 2 or gamma.shape[1] != len(time):
                raise ValueError(
                    f"force_density has shape {gamma.shape}, expected (α, {len(time)}): "
                    "one row per string, one column per time"
                )
            for i, row in enumerate(gamma):
                non_negative(f"force_density[{i}]", row, "a string can only pull")
            object.__setattr__(self, "force_density", frozen(gamma))
        object.__setattr__(self, "time", frozen(time))
        object.__setattr__(self, "nodes", frozen(nodes))

    def reversed(self) -> Reference:
        """Return the same shapes the other way round: the last first, at the first time.

        Examples
        --------
        >>> import numpy as np, tenscontrol as tc
        >>> shapes = tc.prism().nodes[:, :, None] * [1.0, 0.9, 0.7]
        >>> tc.Reference([0.0, 1.0, 3.0], shapes).reversed().time
        array([0., 2., 3.])
        """
        gamma = self.force_density
        return Reference(
            self.time[0] + self.time[-1] - self.time[::-1],
            self.nodes[:, :, ::-1],
            None if gamma is None else gamma[:, ::-1],
        )

    def then(self, other: Reference, pause: float) -> Reference:
        """Return this reference, a pause, then another one.

        Parameters
        ----------
        other : Reference
            Its first time comes a pause after the last of this one.
        pause : float
            s, more than 0.

        Returns
        -------
        Reference
            With force densities if both have them. In the pause the shape goes
            straight from the last of this one to the first of the other.

        Raises
        ------
        TypeError, ValueError
            If the other is no reference or of other nodes or strings, one of the two
            alone has force densities, or the pause is not a positive number.

        Examples
        --------
        There and back, with a second of rest:

        >>> import numpy as np, tenscontrol as tc
        >>> there = tc.Reference([0.0, 2.0], tc.prism().nodes[:, :, None] * [1.0, 0.7])
        >>> there.then(there.reversed(), pause=1.0).time
        array([0., 2., 3., 5.])
        """
        instance("other", other, Reference, "make one by Reference(time, nodes)")
        pause = positive_number("pause", pause, "s")
        for what in ("nodes", "force_density"):
            ours, theirs = (
                None if value is None else value.shape[:-1]
                for value in (getattr(self, what), getattr(other, what))
            )
            if ours != theirs:
                raise ValueError(
                    f"other.{what} has the shape {theirs} at each time, expected {ours}, as here"
                )
        begin = self.time[-1] + pause - other.time[0]
        gamma = None
        if self.force_density is not None and other.force_density is not None:
            gamma = np.hstack([self.force_density, other.force_density])
        return Reference(
            np.concatenate([self.time, begin + other.time]),
            np.concatenate([self.nodes, other.nodes], axis=-1),
            gamma,
        )


class ReducedReference:
    """A reference in the coordinates of a plant, ready to be read at any times.

    Parameters
    ----------
    time : ndarray, shape (K,)
    coordinates : ndarray, shape (K, r)
        q at these times.
    """

    def __init__(self, time: FloatArray, coordinates: FloatArray) -> None:
        self._time, self._coordinates = time, coordinates
        # Rates between the times, zero before the first and after the last.
        slopes = np.diff(coordinates, axis=0) / np.diff(time)[:, None]
        still = np.zeros((1, coordinates.shape[1]))
        self._rates = np.vstack([still, slopes, still])

    def at(self, times: FloatArray) -> FloatArray:
        """Return ``z = [q; q̇]`` at these times, shape (len(times), 2r)."""
        right = np.searchsorted(self._time, times, side="right")
        nearest = np.clip(right - 1, 0, None)
        past = np.clip(times - self._time[nearest], 0.0, None)[:, None]
        rates = self._rates[right]
        return np.hstack([self._coordinates[nearest] + past * rates, rates])


class SmoothReference:
    """Values over time with rates and accelerations: cubic splines, at rest at both ends.

    Parameters
    ----------
    time : ndarray, shape (K,)
    values : ndarray, shape (K, p)
    """

    def __init__(self, time: FloatArray, values: FloatArray) -> None:
        from scipy.interpolate import CubicSpline

        self._start, self._end = float(time[0]), float(time[-1])
        self._ends = values[0], values[-1]
        self._spline = CubicSpline(time, values, bc_type="clamped") if len(time) > 1 else None

    def at(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return value, rate and acceleration, shape (p,) each; still outside the times."""
        if self._spline is None or not self._start <= time < self._end:
            held = self._ends[int(time >= self._end)]
            return held, np.zeros_like(held), np.zeros_like(held)
        return self._spline(time), self._spline(time, 1), self._spline(time, 2)
