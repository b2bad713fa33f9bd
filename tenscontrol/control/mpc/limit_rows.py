"""The rows of a finite-horizon program that limit inputs, their changes and outputs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.control.mpc.problem import Course, Horizon
from tenscontrol.validation import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array


class LimitRows:
    """Limits as matrices on inputs, states and violations, shared by both forms.

    Rows come in blocks of N times some width: inputs, changes, hard rows, soft rows from
    above, soft rows from below, violations. Each is in units of its level or scale.

    Parameters
    ----------
    horizon : Horizon

    Attributes
    ----------
    on_inputs, on_states, on_violations : sparse array, shapes (m, Nα), (m, Ns), (m, e)
        What multiplies v_0 …, z_1 … and the violations.
    on_first : sparse array, shape (m, s)
        What multiplies z_0.
    price : ndarray, shape (e,)
        Linear cost of the violations, in units of the scaled cost.
    widths : list of int
        Widths of the blocks of rows.
    """

    def __init__(self, horizon: Horizon) -> None:
        from scipy.sparse import csc_array, eye, identity, kron, vstack

        self._horizon = horizon
        N, count = horizon.length, len(horizon.low)
        each, earlier = identity(N), eye(N, k=-1)
        first = csc_array(([1.0], ([0], [0])), shape=(N, 1))
        soft = np.zeros(0, dtype=int) if horizon.rows is None else horizon.rows.soft
        # One block a row: what multiplies v, z_1 …, z_0 and the violations.
        blocks = [self._block(kron(each, identity(count)) / horizon.level, len(soft))]
        if horizon.change is not None:
            differences = kron(each - earlier, identity(count)) / horizon.level
            blocks.append(self._block(differences, len(soft)))
        self._parts: list[tuple[IntArray, bool, bool]] = []
        if horizon.rows is not None:
            rows = horizon.rows
            hard = np.setdiff1d(np.arange(len(rows.scale)), soft)
            above, below = rows.bounded
            for places, sign, low, high in (
                (hard, 0, True, True),
                (soft, -1, False, True),
                (soft, 1, True, False),
            ):
                if not len(places) or (sign < 0 and not above) or (sign > 0 and not below):
                    continue
                E, F, G = (
                    csc_array(part[places] / rows.scale[places, None])
                    for part in (rows.before, rows.after, rows.inputs)
                )
                blocks.append((
                    kron(each, G),
                    kron(earlier, E) + kron(each, F),
                    kron(first, E),
                    sign * identity(N * len(soft)) if sign else None,
                ))  # fmt: skip
                self._parts.append((places, low, high))
        if len(soft):
            empty = self._block(csc_array((N * len(soft), N * count)), len(soft))
            blocks.append((*empty[:3], identity(N * len(soft))))
        slacks = N * len(soft)
        columns = list(zip(*blocks, strict=True))
        self.on_inputs, self.on_states, self.on_first = (
            csc_array(vstack(column)) for column in columns[:3]
        )
        for part in (self.on_inputs, self.on_states):
            part.eliminate_zeros()  # kron fills blocks up
        none = [csc_array((block[0].shape[0], slacks)) for block in blocks]
        self.on_violations = csc_array(
            vstack(
                [
                    zero if part is None else part
                    for zero, part in zip(none, columns[3], strict=True)
                ]
            )
        )
        self.price = np.zeros(0)
        if horizon.rows is not None:
            price = horizon.rows.penalty[soft] * horizon.rows.scale[soft]
            self.price = np.tile(horizon.cost_scale * price, N)
        self.widths = [block[0].shape[0] // N for block in blocks]
        self._slacks = slacks

    @property
    def parts(self) -> list[tuple[IntArray, int]]:
        """Places of the limited rows in each block of them, and the first row of the block."""
        before = len(self.widths) - len(self._parts) - (1 if len(self.price) else 0)
        starts = self._horizon.length * np.cumsum([0, *self.widths])[before:]
        return [(part[0], int(start)) for part, start in zip(self._parts, starts, strict=False)]

    def _block(self, on_inputs: csc_array, soft: int) -> tuple[csc_array, ...]:
        """Return a block of rows that sees inputs alone."""
        from scipy.sparse import csc_array

        rows, N, states = (
            on_inputs.shape[0],
            self._horizon.length,
            len(self._horizon.drift),
        )
        return on_inputs, csc_array((rows, N * states)), csc_array((rows, states)), None

    def bounds(self, previous: FloatArray, course: Course) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of all rows before what is known of states is moved over.

        Parameters
        ----------
        previous : ndarray, shape (α,)
            v_{−1}.
        course : Course
        """
        horizon = self._horizon
        low, high = [course.low.ravel() / horizon.level], [course.high.ravel() / horizon.level]
        if horizon.change is not None:
            middle = -course.shift / horizon.level
            middle[0] += previous / horizon.level
            reach = horizon.change / horizon.level
            low.append((middle - reach).ravel())
            high.append((middle + reach).ravel())
        for places, below, above in self._parts:
            assert horizon.rows is not None  # there are parts
            scale = horizon.rows.scale[places]
            least, most = course.row_low[:, places] / scale, course.row_high[:, places] / scale
            low.append((least if below else np.full_like(least, -np.inf)).ravel())
            high.append((most if above else np.full_like(most, np.inf)).ravel())
        low.append(np.zeros(self._slacks))
        high.append(np.full(self._slacks, np.inf))
        return np.concatenate(low), np.concatenate(high)


def moved(vector: FloatArray, length: int, widths: list[int], repeat: bool) -> FloatArray:
    """Drop the first step of each block of (length, width), and repeat the last or append zeros."""
    parts, at = [], 0
    for width in widths:
        block = vector[at : at + length * width].reshape(length, width)
        parts += [block[1:].ravel(), block[-1] if repeat else np.zeros(width)]
        at += length * width
    return np.concatenate(parts)
