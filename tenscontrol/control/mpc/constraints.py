"""Limits on inputs, strings and outputs, as rows of a finite-horizon program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.control.mpc.problem import MPCProblem, Rows, StageData
from tenscontrol.plant import LinearPlant, Preview, StringMap
from tenscontrol.structure import bar_distances
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    float_array,
    freeze_arrays,
    frozen,
    instance,
    positive_number,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from scipy.sparse import csc_array


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


def clearance(plant: LinearPlant, clearance: float, penalty: float | None = None) -> OutputLimit:
    """Return the limit that keeps the axes of bars apart, for MPC and NMPC.

    The distance of two bars that pass one another is ``u · (p − q)``, with p and q the
    points where they are nearest and u the unit vector between them. Its first-order
    change is that with u, and the places of p and q along the bars, as at the operating
    point. That is what is limited: it is good near this shape. Pairs that are nearest at an
    end of a bar can go around each other, and are left out.

    Parameters
    ----------
    plant : LinearPlant
    clearance : float
        Least distance of the axes, m.
    penalty : float, optional
        Cost of a violation, per m and sample (L1), as in :class:`OutputLimit`. A hard
        limit if not given: a disturbance can then make a program infeasible.

    Returns
    -------
    OutputLimit
        One row for each pair.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, no two bars pass one another, or bars are nearer than
        ``clearance`` at the operating point.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> limit = tc.clearance(plant, clearance=0.2, penalty=1e4)
    >>> limit.matrix.shape, limit.low
    ((3, 18), array([0.2, 0.2, 0.2]))
    >>> mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0, outputs=[limit])
    """
    instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    clearance = positive_number("clearance", clearance, "m")
    structure, nodes = plant.model.structure, plant.nodes
    found = bar_distances(structure, nodes)
    passing = np.flatnonzero(found.side)
    if not len(passing):
        raise ValueError(
            "plant has no two bars that pass one another: each pair is nearest at an end of a bar"
        )
    near = passing[found.distance[passing].argmin()]
    if found.distance[near] < clearance:
        i, j = found.pairs[near]
        raise ValueError(
            f"clearance is {clearance:g} m, but bars {i} and {j} are {found.distance[near]:g} m "
            "apart at the operating point; expected at most that"
        )
    rows = np.zeros((len(passing), 3, nodes.shape[1]))
    starts, vectors = nodes[:, structure.bars[:, 0]], structure.bar_vectors(nodes)
    for row, pair in zip(rows, passing, strict=True):
        (i, j), (s, t) = found.pairs[pair], found.nearest[pair]
        between = starts[:, i] + s * vectors[:, i] - starts[:, j] - t * vectors[:, j]
        u = between / np.linalg.norm(between)
        for bar, place, sign in ((i, s, 1.0), (j, t, -1.0)):
            start, end = structure.bars[bar]
            row[:, start] += sign * (1 - place) * u
            row[:, end] += sign * place * u
    return OutputLimit(
        rows.transpose(0, 2, 1).reshape(len(passing), -1), low=clearance, penalty=penalty
    )


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Rows of one kind: their matrices and their bounds.

    Attributes
    ----------
    by_state, by_next_state, by_input : ndarray, shapes (p, s), (p, s), (p, α)
    low, high, scale, penalty : ndarray, shape (p,)
    quantity : str
        Of the path, which bounds are measured from: ``"force_density"``, ``"tension"``, or ``""``
        for node positions.
    offset, on_nodes : ndarray, shapes (p,) and (p, 3n)
        Of node positions: value at the operating point, and the matrix C.
    """

    by_state: FloatArray
    by_next_state: FloatArray
    by_input: FloatArray
    low: FloatArray
    high: FloatArray
    scale: FloatArray
    penalty: FloatArray
    quantity: str
    offset: FloatArray
    on_nodes: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def at_sample_ends(self, inputs: int) -> RowBlock:
        """Return the rows where ``[z; v_before]`` is the state: ramps reach v at the end."""
        none = np.zeros((len(self.low), inputs))
        by_next_state = np.hstack([self.by_state + self.by_next_state, none])
        return replace(self, by_state=np.zeros_like(by_next_state), by_next_state=by_next_state)


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

    @property
    def key(self) -> tuple[tuple[str, int, bytes], ...]:
        """What the values of the rows depend on, bounds aside."""
        return tuple(
            (each.quantity, len(each.low), each.on_nodes.tobytes()) for each in self.blocks
        )

    def rows(self) -> Rows | None:
        """Return the rows of the program, or None if there are none."""
        if not self.blocks:
            return None
        low, high = self.limits
        bounded = bool(np.isfinite(high).any()), bool(np.isfinite(low).any())
        return Rows(
            self._joined("by_state"),
            self._joined("by_next_state"),
            self._joined("by_input"),
            self._joined("scale"),
            self._joined("penalty"),
            bounded,
        )

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest values of all rows, shape (p,) each."""
        return frozen(self._joined("low")), frozen(self._joined("high"))

    def _joined(self, name: str) -> FloatArray:
        none = [] if self.blocks else [np.zeros(0)]
        return np.concatenate(none + [getattr(block, name) for block in self.blocks])

    def bounds(self, preview: Preview, length: int) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the rows, shape (N, p) each, on a path at N samples and their end."""
        low, high = [np.zeros((length, 0))], [np.zeros((length, 0))]
        for block in self.blocks:
            base = np.tile(block.offset, (length, 1))
            if block.quantity:
                # What the strings have where the path rests, less what the rows make of that rest.
                by_state = (block.by_state + block.by_next_state)[:, : self._states]
                base = getattr(preview, block.quantity)[:length]
                base = base - preview.rest[:length] @ by_state.T
            low.append(block.low - base)
            high.append(block.high - base)
        return np.hstack(low), np.hstack(high)


def string_block(
    quantity: str,
    strings: StringMap,
    low: FloatArray,
    high: FloatArray,
    level: float,
    penalty: float,
) -> RowBlock:
    """Return limits on ``"force_density"`` or ``"tension"`` at the start of each sample.

    The level is the unit of the rows, and the penalty the cost of a violation by one level,
    infinite for a hard limit.
    """
    name = "gamma" if quantity == "force_density" else quantity
    by_state, count = getattr(strings, f"{name}_by_state"), len(low)
    return RowBlock(
        by_state=by_state,
        by_next_state=np.zeros_like(by_state),
        by_input=getattr(strings, f"{name}_by_input"),
        low=low,
        high=high,
        scale=np.full(count, level),
        penalty=np.full(count, penalty / level),
        quantity=quantity,
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
    sizes = np.linalg.norm(limit.matrix, axis=1)
    return RowBlock(
        by_state=np.zeros((count, len(plant.A))),
        by_next_state=np.hstack([by_q, np.zeros_like(by_q)]),
        by_input=np.zeros((count, plant.B.shape[1])),
        low=limit.low,
        high=limit.high,
        scale=_SHARE * sizes * float(np.ptp(plant.nodes, axis=1).max()),
        penalty=np.full(count, np.inf if limit.penalty is None else limit.penalty),
        quantity="",
        offset=limit.matrix @ plant.nodes.ravel(order="F"),
        on_nodes=limit.matrix,
    )


class LimitRows:
    """Limits as matrices on inputs, states and violations, shared by both forms.

    Rows come in blocks of N times some width: inputs, changes, hard rows, soft rows from
    above, soft rows from below, violations. Each is in units of its level or scale.

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

    def __init__(self, problem: MPCProblem) -> None:
        from scipy.sparse import csc_array, eye, identity, kron, vstack

        self._problem = problem
        N, count = problem.length, len(problem.low)
        each, earlier = identity(N), eye(N, k=-1)
        first = csc_array(([1.0], ([0], [0])), shape=(N, 1))
        soft = np.zeros(0, dtype=int) if problem.rows is None else problem.rows.soft
        # One block a row: what multiplies v, z_1 …, z_0 and the violations.
        blocks: list[tuple[csc_array, csc_array, csc_array, csc_array | None]]
        blocks = [self._block(kron(each, identity(count)) / problem.level)]
        if problem.change is not None:
            differences = kron(each - earlier, identity(count)) / problem.level
            blocks.append(self._block(differences))
        self._parts: list[tuple[IntArray, bool, bool]] = []
        if problem.rows is not None:
            rows = problem.rows
            hard = np.setdiff1d(np.arange(len(rows.scale)), soft)
            above, below = rows.bounded
            for taken, sign, low, high in (
                (hard, 0, True, True),
                (soft, -1, False, True),
                (soft, 1, True, False),
            ):
                if not len(taken) or (sign < 0 and not above) or (sign > 0 and not below):
                    continue
                E, F, G = (
                    csc_array(part[taken] / rows.scale[taken, None])
                    for part in (rows.by_state, rows.by_next_state, rows.by_input)
                )
                blocks.append((
                    kron(each, G),
                    kron(earlier, E) + kron(each, F),
                    kron(first, E),
                    sign * identity(N * len(soft)) if sign else None,
                ))  # fmt: skip
                self._parts.append((taken, low, high))
        self._slacks = N * len(soft)
        if len(soft):
            empty = self._block(csc_array((self._slacks, N * count)))
            blocks.append((*empty[:3], identity(self._slacks)))
        columns = list(zip(*blocks, strict=True))
        self.on_inputs, self.on_states, self.on_first = (
            csc_array(vstack(column)) for column in columns[:3]
        )
        for part in (self.on_inputs, self.on_states):
            part.eliminate_zeros()  # kron fills blocks up
        self.on_violations = csc_array(vstack([
            csc_array((block[0].shape[0], self._slacks)) if block[3] is None else block[3]
            for block in blocks
        ]))  # fmt: skip
        self.price = np.zeros(0)
        if problem.rows is not None:
            price = problem.rows.penalty[soft] * problem.rows.scale[soft]
            self.price = np.tile(problem.cost_scale * price, N)
        self.widths = [block[0].shape[0] // N for block in blocks]

    @property
    def parts(self) -> list[tuple[IntArray, int]]:
        """Indices of the limited rows in each block of them, and the first row of the block."""
        before = len(self.widths) - len(self._parts) - (1 if len(self.price) else 0)
        starts = self._problem.length * np.cumsum([0, *self.widths])[before:]
        return [(part[0], int(start)) for part, start in zip(self._parts, starts, strict=False)]

    def _block(self, on_inputs: csc_array) -> tuple[csc_array, csc_array, csc_array, None]:
        """Return a block of rows that sees inputs alone."""
        from scipy.sparse import csc_array

        rows, states = on_inputs.shape[0], len(self._problem.drift)
        none = csc_array((rows, self._problem.length * states))
        return on_inputs, none, csc_array((rows, states)), None

    def bounds(self, previous: FloatArray, data: StageData) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of all rows before what is known of states is moved over.

        The previous input is v_{−1}, shape (α,).
        """
        problem = self._problem
        low, high = [data.low.ravel() / problem.level], [data.high.ravel() / problem.level]
        if problem.change is not None:
            middle = -data.shift / problem.level
            middle[0] += previous / problem.level
            reach = problem.change / problem.level
            low.append((middle - reach).ravel())
            high.append((middle + reach).ravel())
        for taken, below, above in self._parts:
            assert problem.rows is not None  # there are parts
            scale = problem.rows.scale[taken]
            least, most = data.row_low[:, taken] / scale, data.row_high[:, taken] / scale
            low.append((least if below else np.full_like(least, -np.inf)).ravel())
            high.append((most if above else np.full_like(most, np.inf)).ravel())
        low.append(np.zeros(self._slacks))
        high.append(np.full(self._slacks, np.inf))
        return np.concatenate(low), np.concatenate(high)


def shifted(vector: FloatArray, length: int, widths: list[int], repeat: bool) -> FloatArray:
    """Drop the first step of each block of (length, width), and repeat the last or append zeros."""
    parts, at = [], 0
    for width in widths:
        block = vector[at : at + length * width].reshape(length, width)
        parts += [block[1:].ravel(), block[-1] if repeat else np.zeros(width)]
        at += length * width
    return np.concatenate(parts)
