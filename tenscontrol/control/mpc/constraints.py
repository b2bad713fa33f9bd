"""Limits on strings and outputs, as rows of a finite-horizon program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.control.mpc.problem import Rows
from tenscontrol.plant import LinearPlant, Preview, StringMap
from tenscontrol.validation import FloatArray, float_array, freeze_arrays, frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


# Unit of positions inside a program, as a share of the size of the structure.
_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class OutputLimit:
    """Bounds on combinations of node positions, at the end of each sample of a horizon.

    In internal coordinates positions are those of the shape laid over the
    operating point: combinations that rigid motion changes mean nothing.

    Parameters
    ----------
    matrix : array_like, shape (p, 3n)
        C of ``y = C vec(N)``, node by node.
    low, high : float or array_like, shape (p,), optional
        Bounds of y, m; no bound if not given.
    penalty : float, optional
        Cost of a violation, per m and sample (L1). A hard limit if not given.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, ``low`` exceeds ``high`` or the penalty is
        not positive.

    Examples
    --------
    The height of a prism's first node above its fourth, at least 0.9 m:

    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.control import OutputLimit
    >>> row = np.zeros((3, 6))
    >>> row[2, [0, 3]] = 1, -1
    >>> OutputLimit(row.ravel(order="F")[None], low=0.9).matrix.shape
    (1, 18)
    """

    matrix: FloatArray
    low: FloatArray | None = None
    high: FloatArray | None = None
    penalty: float | None = None

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            matrix: ArrayLike,
            low: ArrayLike | None = None,
            high: ArrayLike | None = None,
            penalty: float | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        matrix = float_array("matrix", self.matrix)
        if matrix.ndim != 2:
            raise ValueError(f"matrix has shape {matrix.shape}, expected (p, 3n)")
        if not np.abs(matrix).sum(axis=1).all():
            raise ValueError("matrix has a row of zeros, which limits nothing")
        object.__setattr__(self, "matrix", frozen(matrix))
        for name, none in (("low", -np.inf), ("high", np.inf)):
            given = getattr(self, name)
            bound = np.full(len(matrix), none)
            if given is not None:
                bound[:] = float_array(name, given)
            object.__setattr__(self, name, frozen(bound))
        if np.any(self.low > self.high):  # type: ignore[operator]
            raise ValueError(f"low {self.low} m exceeds high {self.high} m")
        if self.penalty is not None and not (np.isfinite(self.penalty) and self.penalty > 0):
            raise ValueError(f"penalty is {self.penalty}, expected a positive number, cost per m")


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Rows of one kind: their matrices and their bounds.

    Attributes
    ----------
    before, after, inputs : ndarray, shapes (p, s), (p, s), (p, α)
    low, high : ndarray, shape (p,)
    scale, penalty : ndarray, shape (p,)
    along : str
        What of a path the rows are measured from: ``"force_density"``, ``"tension"`` or ``""``.
    offset : ndarray, shape (p,)
        Value at the operating point, where ``along`` is empty.
    on_nodes : ndarray, shape (p, 3n)
        What multiplies the node positions, where ``along`` is empty.
    """

    before: FloatArray
    after: FloatArray
    inputs: FloatArray
    low: FloatArray
    high: FloatArray
    scale: FloatArray
    penalty: FloatArray
    along: str
    offset: FloatArray
    on_nodes: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def wound(self, inputs: int) -> RowBlock:
        """Return the rows for inputs that move through samples, and so are reached at their ends.

        Parameters
        ----------
        inputs : int
            Number α of inputs before, which the state has in addition.
        """
        none = np.zeros((len(self.low), inputs))
        after = np.hstack([self.before + self.after, none])
        return replace(self, before=np.zeros_like(after), after=after)


class Constraints:
    """All rows of a problem, with bounds that move along a path.

    Parameters
    ----------
    blocks : list of RowBlock
        Rows of strings see the state either before or after a sample.
    states : int
        Number s of states of the plant, which come first.
    """

    def __init__(self, blocks: list[RowBlock], states: int) -> None:
        self.blocks, self._states = tuple(blocks), states

    def rows(self) -> Rows | None:
        """Return the rows of the program, or None if there are none."""
        if not self.blocks:
            return None
        before, after, inputs, scale, penalty, low, high = (
            np.concatenate([getattr(block, name) for block in self.blocks])
            for name in ("before", "after", "inputs", "scale", "penalty", "low", "high")
        )
        bounded = bool(np.isfinite(high).any()), bool(np.isfinite(low).any())
        return Rows(before, after, inputs, scale, penalty, bounded)

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest values of all rows, shape (p,) each."""
        none = [np.zeros(0)]
        return (
            frozen(np.concatenate(none + [block.low for block in self.blocks])),
            frozen(np.concatenate(none + [block.high for block in self.blocks])),
        )

    def bounds(self, preview: Preview, length: int) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the rows, shape (N, p) each, as the program has them.

        Parameters
        ----------
        preview : Preview
            The reference at the N samples and the end of the last.
        length : int
            N.
        """
        low, high = [np.zeros((length, 0))], [np.zeros((length, 0))]
        for block in self.blocks:
            base = np.tile(block.offset, (length, 1))
            if block.along:
                # What the strings have where the path rests, less what the rows make of that rest.
                by_state = (block.before + block.after)[:, : self._states]
                base = getattr(preview, block.along)[:length]
                base = base - preview.rest[:length] @ by_state.T
            low.append(block.low - base)
            high.append(block.high - base)
        return np.hstack(low), np.hstack(high)


def string_block(
    what: str,
    strings: StringMap,
    low: FloatArray,
    high: FloatArray,
    level: float,
    penalty: float,
) -> RowBlock:
    """Return limits on force densities or tensions at the start of each sample.

    Parameters
    ----------
    what : {"force_density", "tension"}
    strings : StringMap
    low, high : ndarray, shape (α',)
    level : float
        Unit of the rows.
    penalty : float
        Cost of a violation by one level; infinite for a hard limit.
    """
    name = "gamma" if what == "force_density" else what
    before = getattr(strings, f"{name}_by_state")
    count = len(low)
    return RowBlock(
        before=before,
        after=np.zeros_like(before),
        inputs=getattr(strings, f"{name}_by_input"),
        low=low,
        high=high,
        scale=np.full(count, level),
        penalty=np.full(count, penalty / level),
        along=what,
        offset=np.zeros(count),
        on_nodes=np.zeros((count, 0)),
    )


def output_block(plant: LinearPlant, limit: OutputLimit) -> RowBlock:
    """Return limits on node positions at the end of each sample."""
    assert limit.low is not None  # filled in by the limit itself
    assert limit.high is not None  # filled in by the limit itself
    count, size = limit.matrix.shape
    if size != plant.nodes.size:
        raise ValueError(
            f"outputs: matrix has shape {limit.matrix.shape}, expected (p, {plant.nodes.size}): "
            "one column per coordinate of a node"
        )
    by_q = limit.matrix @ plant.basis
    states = len(plant.A)
    return RowBlock(
        before=np.zeros((count, states)),
        after=np.hstack([by_q, np.zeros_like(by_q)]),
        inputs=np.zeros((count, plant.B.shape[1])),
        low=limit.low,
        high=limit.high,
        scale=_SHARE
        * np.linalg.norm(limit.matrix, axis=1)
        * float(np.ptp(plant.nodes, axis=1).max()),
        penalty=np.full(count, np.inf if limit.penalty is None else limit.penalty),
        along="",
        offset=limit.matrix @ plant.nodes.ravel(order="F"),
        on_nodes=limit.matrix,
    )
