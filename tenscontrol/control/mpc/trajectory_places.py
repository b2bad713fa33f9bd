"""Where the slopes of a trajectory go in the matrix of its program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.control.mpc.limit_rows import LimitRows
from tenscontrol.control.mpc.problem import Horizon
from tenscontrol.validation import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array


@dataclass(frozen=True, eq=False)
class Slots:
    """Where slopes go: ``data[place] = factor * slope.ravel()[source]``."""

    place: IntArray
    source: IntArray
    factor: FloatArray

    def fill(self, data: FloatArray, slope: FloatArray) -> None:
        """Put slopes, stored by columns, into the entries of a matrix."""
        data[self.place] = self.factor * slope.reshape(-1)[self.source]


class TrajectoryPlaces:
    """The pattern of a :class:`TrajectoryProgram`, and the slots in it.

    Parameters
    ----------
    horizon : Horizon
    limits : LimitRows
    units : ndarray, shape (s,)
    ramp : bool
        Whether u_{k−1} matters to the motion.

    Attributes
    ----------
    pattern : sparse array
        A with ones where values go, so that no value that is 0 loses its place.
    motion : list of Slots
        Of A_k, B_k and, where winches wind, C_k; A_0 and C_0 meet only what is known.
    rows : list of tuple of Slots
        Of E_k, G_k and F_k, for each part of the limited rows.
    """

    def __init__(self, horizon: Horizon, limits: LimitRows, units: FloatArray, ramp: bool) -> None:
        self._horizon, self._units = horizon, units
        N, (s, a) = horizon.length, horizon.input_matrix.shape
        self._states = N * s
        self.pattern = _pattern(horizon, limits, ramp)
        every, factor = np.arange(s), -1 / units
        self.motion = [
            self._slots(np.ones((s, s)), every, factor, 0, late=1),
            self._slots(np.ones((s, a)), every, factor, 0, inputs=True),
        ]
        if ramp:
            self.motion.append(self._slots(np.ones((s, a)), every, factor, 0, late=1, inputs=True))
        self.rows, rows = [], horizon.rows
        for places, start in limits.parts:
            assert rows is not None  # there are parts
            factor, first = 1 / rows.scale[places], self._states + start
            self.rows.append((
                self._slots(rows.before, places, factor, first, late=1),
                self._slots(rows.inputs, places, factor, first, inputs=True),
                self._slots(rows.after, places, factor, first),
            ))  # fmt: skip

    def _slots(
        self, pattern: FloatArray, taken: IntArray, factor: FloatArray, start: int, late: int = 0,
        inputs: bool = False,
    ) -> Slots:  # fmt: skip
        """Return the slots of slopes of the N samples, by z_{k+1−late} or by u_{k−late}.

        Parameters
        ----------
        pattern : ndarray, shape (m, columns)
            Zero where a slope has no place.
        taken : ndarray of int, shape (w,)
            Which of the m values are used.
        factor : ndarray, shape (w,)
            Of these rows.
        start : int
            First row; those of a sample follow those of the one before.
        late : int
        inputs : bool
        """
        horizon, (size, columns) = self._horizon, pattern.shape
        units = np.full(columns, horizon.level) if inputs else self._units
        first = self._states if inputs else 0
        j, i = np.nonzero(pattern[taken].T)
        k = np.arange(late, horizon.length)[:, None]
        place = self._found(start + k * len(taken) + i, first + (k - late) * columns + j)
        source = (k * columns + j) * size + taken[i]
        scaled = np.tile(units[j] * factor[i], len(k))
        return Slots(place.ravel(), source.ravel(), scaled)

    def _found(self, row: IntArray, column: IntArray) -> IntArray:
        """Return the places of entries in the order of columns."""
        pattern = self.pattern
        columns = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))
        keys = columns * pattern.shape[0] + pattern.indices
        return np.asarray(np.searchsorted(keys, column * pattern.shape[0] + row))


def _pattern(horizon: Horizon, limits: LimitRows, ramp: bool) -> csc_array:
    from scipy.sparse import csc_array, eye, hstack, identity, kron, vstack

    N, (s, a) = horizon.length, horizon.input_matrix.shape
    acting = identity(N) + eye(N, k=-1) if ramp else identity(N)
    dynamics = hstack([
        # Dense blocks added as such would give the identity theirs, full of zeros.
        identity(N * s) + csc_array(kron(eye(N, k=-1), np.ones((s, s)))),
        kron(acting, np.ones((s, a))),
        csc_array((N * s, len(limits.price))),
    ])  # fmt: skip
    rows = hstack([limits.on_states, horizon.level * limits.on_inputs, limits.on_violations])
    pattern = csc_array(vstack([dynamics, rows]))
    pattern.sort_indices()
    return pattern
