"""Clearance of bars: the distances between their axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from ctypes import byref, c_double, c_int64
from dataclasses import dataclass
from math import ceil
from weakref import WeakKeyDictionary

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.core import records
from tenscontrol.core.library import library
from tenscontrol.core.records import pointers
from tenscontrol.properties import cached_property
from tenscontrol.structure.structure import Structure

# Of up to so many bars all pairs are looked at; of more, those near by, and to begin with so many
# that are nearest to each.
_FEW_BARS, _NEIGHBOURS = 64, 9

# Nodes may be this much faster between states than they are at them, if there are so many intervals
# at least, or as many as steps. With fewer, the motion is integrated again first.
_FASTER, _FEWEST = 2.0, 16

# Intervals that share one bound of the motion, and pairs in intervals that are taken in one go.
_BLOCK, _TOGETHER = 16, 20_000

# Places in an interval at which two bars are measured that come near each other, halvings of the
# time in which they cross, and rounds in which the least distance is found between two places.
_PLACES, _HALVINGS, _ROUNDS = np.linspace(0.0, 1.0, 33), 16, 3

# The cubic over two intervals is off by 16 times the one over each, if the motion is smooth.
_OFF_BY = 4.0

# An interval is integrated again in so many parts, then in so many times more; at first in as many
# as it has steps, up to the second. It has at most this many parts, and so have all of them
# together beside half as many as the run has steps.
_PARTS, _STEPS, _MOST_PARTS = 4, 64, 4_096

# Pairs in intervals that are looked at closely, at most.
_MOST_PLACES = 100_000

# As parts of the size: what needs no closer look; bars that touch; those that stay in one plane;
# motions that have run away; and those that are taken beside the mean of the nodes. Of the least
# distance, the part by which it may be missed.
_EXACT, _TOUCHING, _ROUND_OFF, _AWAY, _DRIFT, _MISSED = 1e-6, 1e-6, 1e-9, 1e9, 0.05, 1e-3

#: ``again(first, last, parts)``: times (parts + 1,), nodes and velocities (d, n, parts + 1) of some
#: intervals of a motion in equal parts, both ends included; None if they cannot be integrated.
Again = Callable[[int, int, int], tuple[FloatArray, FloatArray, FloatArray] | None]


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of bars as the core takes them."""

    bars: IntArray  # (p, 2)
    ends: np.ndarray  # (p, 4): nodes
    nodes: np.ndarray  # all of these nodes

    @classmethod
    def of(cls, bars: IntArray, pairs: IntArray) -> _Pairs:
        """Return pairs (p, 2) among bars."""
        ends = np.ascontiguousarray(bars[pairs].reshape(-1, 4), dtype=np.int32)
        return cls(pairs, ends, np.unique(ends))


# Places of no bars.
_NOWHERE = frozen(np.zeros(0, dtype=int))

# Pairs of bars that may cross, by structure.
_PAIRS: WeakKeyDictionary[Structure, _Pairs] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class BarDistances:
    """Distances between the axes of all p pairs of bars that share no node.

    ``side`` is the sign of the volume that two bars span; 0 where they are nearest at an end, so
    that one can go around the other, and in the plane, where bars lie in layers. ``nearest`` is
    where along its length each of two lines is nearest to the other, 0 at the start of the bar and
    1 at its end; of parallel bars, anywhere.
    """

    pairs: IntArray  # (p, 2)
    distance: FloatArray  # (p,), m
    side: FloatArray  # (p,)
    nearest: FloatArray  # (p, 2)

    @property
    def least(self) -> float:
        """The smallest distance, m; infinite for a single bar."""
        return float(self.distance.min(initial=np.inf))


def bar_distances(structure: Structure, nodes: FloatArray) -> BarDistances:
    """Return how far the bars are from one another in a shape."""
    pairs = _all_pairs(structure.bars)
    corners = _corners(structure.bars, nodes, pairs)
    distance, s, t, inside = _apart(corners)
    side = np.zeros(len(pairs))
    if structure.dimension == 3:
        side = np.where(inside, np.sign(_volume(corners)), 0.0)
    return BarDistances(pairs, distance, side, np.column_stack([s, t]))


def _all_pairs(bars: IntArray) -> IntArray:
    """Return all pairs of bars that share no node, shape (p, 2)."""
    return _without_joined(bars, np.column_stack(np.triu_indices(len(bars), 1)))


def _without_joined(bars: IntArray, pairs: IntArray) -> IntArray:
    ends = bars[pairs]
    joined = (ends[:, 0, :, None] == ends[:, 1, None, :]).any(axis=(1, 2))
    return np.asarray(pairs[~joined])


def _corners(
    bars: IntArray, nodes: FloatArray, pairs: IntArray, k: IntArray | None = None
) -> FloatArray:
    """Return where ends of first bars are, from ends of second ones, shape (3, d, m).

    From start to start, from start to end, and from end to start; of nodes (d, n), or in columns k
    of nodes (d, n, K).
    """
    ends = bars[pairs].reshape(-1, 4)
    a, b, c, d = np.moveaxis(nodes[:, ends] if k is None else nodes[:, ends, k[:, None]], 2, 0)
    return np.stack([a - c, b - c, a - d])


def _apart(corners: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, np.ndarray]:
    """Return how far bars are apart, where their lines are nearest, and if that is inside both."""
    w, u, v = corners[0], corners[1] - corners[0], corners[0] - corners[2]
    uu, vv, uv = (u * u).sum(0), (v * v).sum(0), (u * v).sum(0)
    uw, vw = (u * w).sum(0), (v * w).sum(0)
    across = uu * vv - uv**2
    slanted = across > 1e-12 * uu * vv
    scale = np.where(slanted, across, 1.0)
    s, t = (uv * vw - vv * uw) / scale, (uu * vw - uv * uw) / scale
    # Two lines are nearest within both bars, or else at an end of one of them.
    inside = slanted & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    distance = np.where(inside, np.linalg.norm(w + s * u - t * v, axis=0), np.inf)
    for s_end in (0.0, 1.0):
        t_near = np.clip((vw + s_end * uv) / vv, 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(w + s_end * u - t_near * v, axis=0))
    for t_end in (0.0, 1.0):
        s_near = np.clip((t_end * uv - uw) / uu, 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(w + s_near * u - t_end * v, axis=0))
    return distance, s, t, inside


def _volume(corners: FloatArray) -> FloatArray:
    """Return the volume that two bars span, in space, m³."""
    w, u, v = corners[0], corners[1] - corners[0], corners[0] - corners[2]
    return np.asarray((np.cross(u, v, axis=0) * w).sum(axis=0))


@dataclass(frozen=True)
class BarCrossing:
    """Two bars that pass through each other.

    Attributes
    ----------
    time : float
        s; between two shapes, the share of the way.
    bars : tuple of int
        The two bars, the lower number first.
    """

    time: float
    bars: tuple[int, int]


@dataclass(frozen=True)
class BarClearance:
    """The least distance between the axes of two bars over a motion.

    Attributes
    ----------
    distance : float
        m; 0 where bars cross.
    time : float
        When it is so small, s; between two shapes, the share of the way.
    bars : tuple of int
        The two bars, the lower number first.
    """

    distance: float
    time: float
    bars: tuple[int, int]


@dataclass(eq=False)
class _Intervals:
    """A motion, cubic in each of K intervals."""

    begin: FloatArray  # (K,), s
    length: FloatArray
    nodes: tuple[FloatArray, FloatArray]  # at both ends, (d, n, K) each
    rates: tuple[FloatArray, FloatArray] | None  # of nodes that move in straight lines None
    follows: np.ndarray  # whether an interval begins where the one before ends
    origin: IntArray  # the interval of the motion given that each is part of
    is_joined: bool = False  # else both ends are of the same states in memory

    @classmethod
    def between(
        cls, time: FloatArray, nodes: FloatArray, velocities: FloatArray | None, origin: IntArray
    ) -> _Intervals:
        """Return the intervals between states."""
        rates = None if velocities is None else (velocities[:, :, :-1], velocities[:, :, 1:])
        moves, follows = (nodes[:, :, :-1], nodes[:, :, 1:]), np.arange(len(time) - 1) > 0
        return cls(time[:-1], time[1:] - time[:-1], moves, rates, follows, origin)

    @classmethod
    def joined(cls, motions: list[_Intervals]) -> _Intervals:
        """Return the intervals of several motions."""
        flat = [
            (
                motion.begin,
                motion.length,
                *motion.nodes,
                *(motion.rates or ()),
                motion.follows,
                motion.origin,
            )
            for motion in motions
        ]
        begin, length, x0, x1, *rates, follows, origin = (
            np.concatenate(arrays, axis=-1) for arrays in zip(*flat, strict=True)
        )
        ends = (rates[0], rates[1]) if rates else None
        return cls(begin, length, (x0, x1), ends, follows, origin, is_joined=True)

    @property
    def count(self) -> int:
        return len(self.begin)

    def cubics(self, bars: IntArray, pairs: IntArray, k: IntArray) -> FloatArray:
        """Return control points of the motion of corners in intervals, (4, 3, d, m)."""
        first, last = (_corners(bars, nodes, pairs, k) for nodes in self.nodes)
        if self.rates is None:
            third = (last - first) / 3
            return np.stack([first, first + third, last - third, last])
        h = self.length[k] / 3
        out, into = (h * _corners(bars, rates, pairs, k) for rates in self.rates)
        return np.stack([first, first + out, last - into, last])

    def strays(self, nodes: IntArray | None = None) -> FloatArray:
        """Return how far nodes may be, between two states, from both, m, shape (n,).

        Of some nodes, beside what all of them do alike.
        """
        if self.rates is None:
            return np.zeros(self.nodes[0].shape[1])
        if nodes is None:
            first, end = self.rates[0], self.rates[1][:, :, -1]
            low, high = _bounds(first, end)
            return self._strays(np.linalg.norm(np.maximum(-low, high), axis=0))
        speed, core = np.zeros(self.nodes[0].shape[1]), library()
        if core is not None:
            rates, work = self._rates_of(nodes.astype(np.int32)), np.empty(3 * len(nodes))
            core.tc_largest_speeds(byref(rates), self.count, *pointers(speed, work))
        else:
            first, end = self.rates[0][:, nodes], self.rates[1][:, nodes, -1]
            low, high = _bounds(_beside_mean(first), _beside_mean(end))
            speed[nodes] = np.linalg.norm(np.maximum(-low, high), axis=0)
        return self._strays(speed)

    def _strays(self, speed: FloatArray) -> FloatArray:
        """Return how far nodes of these speeds at states may be from both, m."""
        return np.asarray(_FASTER / 2 * float(self.length.max()) * speed)

    def _rates_of(self, nodes: np.ndarray) -> records.Rates:
        """Return the rates of some nodes as the core takes them."""
        assert self.rates is not None  # it is asked of motions that have some
        begin = records.Motion.of(self.rates[0])
        if self.is_joined:
            end = records.Motion.of(self.rates[1])
        else:  # one state later
            after = begin.values + self.rates[0].strides[2]
            end = records.Motion(after, begin.axis, begin.node, begin.time)
        return records.Rates(begin, end, len(nodes), records.address(nodes))

    def near(self, pairs: _Pairs) -> tuple[IntArray, IntArray, FloatArray]:
        """Return places of pairs, and intervals, that begin where bars are near: by the core.

        And how far nodes may be from the ends of intervals, m. Near is what they may come by.
        """
        core, ends, nodes = library(), pairs.ends, pairs.nodes
        assert core is not None  # it was asked for
        motion, room = records.Motion.of(self.nodes[0]), 2 * len(ends) + 1000
        motions = byref(motion), byref(self._rates_of(nodes)), self.count
        times = np.ascontiguousarray(self.begin), np.ascontiguousarray(self.length)
        speed, work = np.zeros(self.nodes[0].shape[1]), np.empty(3 * len(nodes))
        while True:
            near = np.empty((room, 2), dtype=np.int32)
            begin, length, *at = pointers(*times, ends, near, speed, work)
            count = core.tc_near_bars(
                *motions, begin, length, len(ends), at[0], c_double(_FASTER), c_int64(room), *at[1:]
            )
            if not count:  # as a rule
                return _NOWHERE, _NOWHERE, speed
            if count <= room:
                p, k = near[:count].T.astype(int)
                return p, k, self._strays(speed)
            room = count

    def error(self, bars: IntArray, pairs: IntArray, k: IntArray) -> FloatArray:
        """Return estimates of how far corners may be off the cubics in intervals, (m,), m.

        By how far the cubic over an interval and one beside it is off the state between them.
        """
        if self.rates is None:
            return np.zeros(len(k))
        worst = np.full(len(k), -1.0)
        for second in (k, k + 1):
            inner = np.flatnonzero((second > 0) & (second < self.count))
            inner = inner[self.follows[second[inner]]]
            after, before, some = second[inner], second[inner] - 1, pairs[inner]
            h = self.length[before], self.length[after]
            whole, share = h[0] + h[1], h[0] / (h[0] + h[1])
            ends = [
                _corners(bars, states[i], some, index)
                for states in (self.nodes, self.rates)
                for i, index in ((0, before), (1, after))
            ]
            out, into = (whole / 3 * rate for rate in ends[2:])
            cubic = np.stack([ends[0], ends[0] + out, ends[1] - into, ends[1]])
            off = _largest(_at(cubic, share) - _corners(bars, self.nodes[0], some, after))
            turned = _rate(cubic, share) / whole - _corners(bars, self.rates[0], some, after)
            off = np.maximum(off, np.minimum(*h) / 4 * _largest(turned))
            worst[inner] = np.maximum(worst[inner], off / _OFF_BY)
        return np.where(worst < 0, np.inf, worst)


def _beside_mean(nodes: FloatArray) -> FloatArray:
    """Return nodes, or rates, beside what all of them do alike: that brings no bars together."""
    return np.asarray(nodes - nodes.mean(axis=1, keepdims=True))


def _bounds(first: FloatArray, end: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bounds of a motion with these values as intervals begin, and at its end."""
    return np.minimum(first.min(axis=2), end), np.maximum(first.max(axis=2), end)


def _at(cubic: FloatArray, s: FloatArray) -> FloatArray:
    """Return cubics with these control points (4, ..., m) at shares s, (m,) or (m, places)."""
    a, b, c, d = cubic if s.ndim == 1 else cubic[..., None]
    r = 1 - s
    return np.asarray(r**3 * a + 3 * r * s * (r * b + s * c) + s**3 * d)


def _rate(cubic: FloatArray, s: FloatArray) -> FloatArray:
    a, b, c, d = cubic
    r = 1 - s
    return np.asarray(3 * (r**2 * (b - a) + 2 * r * s * (c - b) + s**2 * (d - c)))


def _largest(corners: FloatArray) -> FloatArray:
    """Return the largest of the lengths of all four corners."""
    fourth = corners[1] + corners[2] - corners[0]
    lengths = [np.linalg.norm(vectors, axis=-2) for vectors in (*corners, fourth)]
    return np.asarray(np.max(lengths, axis=0))


@dataclass(eq=False)
class _Least:
    """The least distance seen so far, when, and of which bars."""

    distance: float = np.inf
    time: float = 0.0
    bars: tuple[int, int] = (0, 0)

    @property
    def limit(self) -> float:
        """Nothing above it is worth a look, m."""
        return (1 - _MISSED) * self.distance

    def see(self, distance: FloatArray, time: FloatArray, pairs: IntArray) -> None:
        """Take the least of these, if it is less."""
        if len(distance) and distance.min() < self.distance:
            k = int(distance.argmin())
            i, j = pairs[k].tolist()
            self.distance, self.time, self.bars = float(distance[k]), float(time[k]), (i, j)


class BarMotion:
    """The bars of a structure over a motion: which of them cross, and how near they come.

    Between two states each node moves along the cubic with their positions and velocities. For bars
    a → b and c → d without a common node, ``v = ((N_b − N_a) × (N_d − N_c)) · (N_c − N_a)`` is a
    polynomial in time there. They cross where it changes sign and the points of the two lines that
    are nearest to each other are on both bars. Pairs are looked at only when they may be within
    reach, so that costs grow with the number of bars. In the plane bars lie in layers: there are no
    crossings, and no clearance. The same holds for bars that touch in the shape of the structure.

    Parameters
    ----------
    structure : Structure
    time : ndarray, shape (T,)
        s, ascending.
    nodes : ndarray, shape (d, n, T)
        m.
    velocities : ndarray, shape (d, n, T), optional
        m/s; if not given, nodes move in straight lines from one shape to the next.
    again : callable, optional
        Integrates again where states are too far apart to tell; see :data:`Again`.
    steps : int
        Steps of the run, 0 where they are not known. They say how well the states resolve it, and
        in how many parts intervals are integrated again.
    """

    def __init__(
        self, structure: Structure, time: FloatArray, nodes: FloatArray,
        velocities: FloatArray | None = None, again: Again | None = None, steps: int = 0,
    ) -> None:  # fmt: skip
        self._structure, self._bars, self._again = structure, structure.bars, again
        self._size = structure.size
        self.has_pairs = structure.dimension == 3 and len(self._bars) > 1 and len(time) > 0
        count, far = len(time), _AWAY * self._size
        least, most = np.minimum.reduce, np.maximum.reduce
        if self.has_pairs and not (least(nodes, None) > -far and most(nodes, None) < far):
            count = int((~(np.abs(nodes) < far).all(axis=(0, 1))).argmax())
            self.has_pairs = count > 0
        rates = None if velocities is None else velocities[:, :, :count]
        intervals = max(0, count - 1)
        origin = np.arange(intervals)
        self._kept = _Intervals.between(time[:count], nodes[:, :, :count], rates, origin)
        self._time, self._nodes, self._left = time, nodes, _MOST_PARTS + steps // 2
        # Fewer states than steps may be too few to bound the motion.
        self._is_short = velocities is not None and intervals < _FEWEST
        self._is_short &= not 0 < steps <= intervals
        self._parts = min(max(steps // max(1, intervals), _PARTS), _STEPS)
        # Intervals that were integrated again, with the pairs and places that asked for it.
        self._finer: list[tuple[_Intervals, IntArray, IntArray]] = []
        self._made_finer = np.zeros(0, dtype=int)

    @property
    def crossings(self) -> tuple[BarCrossing, ...]:
        """The crossings in order of time."""
        return self.searched[0]

    @property
    def unresolved(self) -> int:
        """Number of intervals whose states are too few to tell whether bars cross in them."""
        return self.searched[1]

    @cached_property
    def clearance(self) -> BarClearance | None:
        """The least distance of all, to a thousandth of it; None without two bars apart."""
        if self.crossings:
            first = self.crossings[0]
            return BarClearance(0.0, first.time, first.bars)
        if not self.has_pairs:
            return None
        with np.errstate(over="ignore", invalid="ignore"):
            least = self._least()
        if not np.isfinite(least.distance):
            return None
        return BarClearance(least.distance, least.time, least.bars)

    def _least(self) -> _Least:
        least, base = _Least(), self._base
        if not base.count:
            distances = bar_distances(self._structure, self._nodes[:, :, 0])
            least.see(
                distances.distance, self._time[:1].repeat(len(distances.pairs)), distances.pairs
            )
            return least
        pairs, k, _ = self._close(base, least)
        coarse = ~np.isin(self._key(base, pairs, k), self._made_finer)
        for motion, some, index in [(base, pairs[coarse], k[coarse]), *self._finer]:
            self._see_between(motion, some, index, least)
        return least

    @cached_property
    def _base(self) -> _Intervals:
        """The motion, integrated again if it has too few states to bound it."""
        intervals, parts = self._kept, self._parts
        if self._again is None or not self._is_short:
            return intervals
        parts = max(parts, ceil(_FEWEST / intervals.count))
        # In one go where intervals are equally long, under one input.
        if np.ptp(intervals.length) < 1e-6 * intervals.length[0]:
            whole = self._integrated(0, intervals.count - 1, parts)
            if whole is not None:
                return whole
        pieces = [self._integrated(k, k, parts) for k in range(intervals.count)]
        integrated = [piece for piece in pieces if piece is not None]
        return _Intervals.joined(integrated) if len(integrated) == len(pieces) else intervals

    def _integrated(self, first: int, last: int, parts: int) -> _Intervals | None:
        """Return intervals, each in parts, or None if they are not integrated again."""
        count = parts * (last - first + 1)
        if self._again is None or count > self._left:
            return None
        states = self._again(first, last, count)
        if states is None:
            return None
        self._left -= count
        return _Intervals.between(*states, np.repeat(np.arange(first, last + 1), parts))

    # ---- which pairs, and when ----

    def _close(
        self, motion: _Intervals, least: _Least | None
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Return pairs, intervals, and the errors there, in which bars may meet.

        Or in which they may come nearer than the least distance known, which is updated.
        """
        if least is None and motion.rates is not None and library() is not None:
            # The core looks at all pairs sooner than it could be told which may meet at all.
            is_few = len(self._bars) <= _FEW_BARS
            known = (
                self._every() if is_few else _Pairs.of(self._bars, self._reachable(motion, None))
            )
            if not len(known.bars):
                return known.bars, np.zeros(0, dtype=int), np.zeros(0)
            p, k, strays = motion.near(known)
            return self._close_within(motion, known.bars[p], k, strays, None)
        pairs = self._reachable(motion, least)
        if not len(pairs):
            return pairs, np.zeros(0, dtype=int), np.zeros(0)
        strays = motion.strays(np.unique(self._bars[pairs]))
        blocks = self._close_blocks(motion, pairs, strays, least)
        candidates = [self._close_within(motion, pairs[p], k, strays, least) for p, k in blocks]
        some, k, error = (np.concatenate(arrays) for arrays in zip(*candidates, strict=True))
        return some, k, error

    def _reachable(self, motion: _Intervals, least: _Least | None) -> IntArray:
        """Return pairs that may meet, by how far their nodes are ever from where they are halfway.

        Or that may come nearer than the least distance known, which is updated.
        """
        half, first, end = motion.count // 2, motion.nodes[0], motion.nodes[1][:, :, -1]
        nodes = None
        if np.abs((end - first[:, :, 0]).mean(axis=1)).max() > _DRIFT * self._size:  # as in a fall
            nodes = np.arange(first.shape[1])
            first, end = _beside_mean(first), _beside_mean(end)
        middle, (low, high) = np.ascontiguousarray(first[:, :, half]), _bounds(first, end)
        moved = np.linalg.norm(np.maximum(high - middle, middle - low), axis=0)
        reach = (moved + motion.strays(nodes))[self._bars].max(axis=1)
        pairs = self._pairs_within(middle, reach, least, float(motion.begin[half]))
        if least is not None:  # those that touch would be the nearest
            pairs = self._separate(pairs)
        apart = _apart(_corners(self._bars, middle, pairs))[0]
        if least is not None:
            least.see(apart, np.full(len(pairs), motion.begin[half]), pairs)
        pairs = pairs[apart - reach[pairs].sum(axis=1) <= _limit(least)]
        return self._separate(pairs) if least is None and len(pairs) else pairs

    def _apart_at(
        self, motion: _Intervals, pairs: IntArray, k: IntArray, least: _Least | None
    ) -> FloatArray:
        """Return distances at the beginning of intervals."""
        apart = _apart(_corners(self._bars, motion.nodes[0], pairs, k))[0]
        if least is not None:
            least.see(apart, motion.begin[k], pairs)
        return apart

    def _pairs_within(
        self, nodes: FloatArray, reach: FloatArray, least: _Least | None, time: float
    ) -> IntArray:
        """Return pairs whose bars may meet if each moves by its reach, (p, 2), or touch at rest.

        Or may come nearer than the least distance known.
        """
        bars = self._bars
        if len(bars) <= _FEW_BARS:
            return self._every().bars
        from scipy.spatial import cKDTree

        ends = nodes[:, bars]
        middles = ends.mean(axis=2).T
        radius = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=0) / 2 + reach
        if least is not None:
            _, near = cKDTree(middles).query(middles, _NEIGHBOURS)
            own = np.repeat(np.arange(len(bars)), _NEIGHBOURS)
            pairs = np.sort(np.column_stack([own, near.ravel()]), axis=1)
            pairs = self._separate(_without_joined(bars, pairs[pairs[:, 0] != pairs[:, 1]]))
            corners = _corners(bars, nodes, pairs)
            least.see(_apart(corners)[0], np.full(len(pairs), time), pairs)
            if not len(pairs):  # all neighbours share a node
                return self._every().bars
        extra = _limit(least)
        # By size, so that a large bar does not make all others neighbours.
        kinds = np.floor(np.log2(radius / radius.min())).astype(int)
        members = [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]
        trees, close = [cKDTree(middles[kind]) for kind in members], []
        for a, (mine, tree) in enumerate(zip(members, trees, strict=True)):
            within = 2 * radius[mine].max() + extra
            close.append(mine[tree.query_pairs(within, output_type="ndarray")])
            for others, other in zip(members[a + 1 :], trees[a + 1 :], strict=True):
                within = radius[mine].max() + radius[others].max() + extra
                pairs = tree.sparse_distance_matrix(other, within, output_type="ndarray")
                close.append(np.column_stack([mine[pairs["i"]], others[pairs["j"]]]))
        pairs = np.sort(np.concatenate(close), axis=1)
        i, j = pairs.T
        apart = np.linalg.norm(middles[i] - middles[j], axis=1) - radius[i] - radius[j]
        return _without_joined(bars, pairs[apart <= extra])

    def _every(self) -> _Pairs:
        """Return all pairs that do not touch in the shape of the structure, made once for it."""
        pairs = _PAIRS.get(self._structure)
        if pairs is None:
            every = self._separate(_all_pairs(self._bars))
            pairs = _PAIRS[self._structure] = _Pairs.of(self._bars, every)
        return pairs

    def _separate(self, pairs: IntArray) -> IntArray:
        """Return pairs without those that touch in the shape of the structure."""
        apart = _apart(_corners(self._bars, self._structure.nodes, pairs))[0]
        return np.asarray(pairs[apart > _TOUCHING * self._size])

    def _close_blocks(
        self, motion: _Intervals, pairs: IntArray, strays: FloatArray, least: _Least | None
    ) -> Iterator[tuple[IntArray, IntArray]]:
        """Yield pairs, by their place, and intervals of blocks in which these may be close."""
        count, nodes = motion.count, np.unique(self._bars[pairs])
        ends = motion.nodes[0][:, nodes], motion.nodes[1][:, nodes, -1:]
        x = _beside_mean(np.concatenate(ends, axis=2))
        starts = np.arange(0, count, _BLOCK)
        stops = np.minimum(starts + _BLOCK, count)
        middle = np.minimum(starts + _BLOCK // 2, count - 1)
        nodes_at_middle = x[:, :, middle]
        low = np.minimum(np.minimum.reduceat(x, starts, axis=2), x[:, :, stops])
        high = np.maximum(np.maximum.reduceat(x, starts, axis=2), x[:, :, stops])
        moved = np.linalg.norm(np.maximum(high - nodes_at_middle, nodes_at_middle - low), axis=0)
        moved += strays[nodes][:, None]
        places = np.searchsorted(nodes, self._bars[pairs])
        reach = moved[places].max(axis=2)
        step = max(1, _TOGETHER // len(starts))
        for first in range(0, len(pairs), step):
            some = slice(first, first + step)
            a, b = (nodes_at_middle[:, places[some, :, end]] for end in (0, 1))
            centre, half = (a + b) / 2, np.linalg.norm(b - a, axis=0) / 2 + reach[some]
            gap = np.linalg.norm(centre[:, :, 0] - centre[:, :, 1], axis=0) - half.sum(axis=1)
            p, block = np.nonzero(gap <= _limit(least))
            p += first
            apart = self._apart_at(motion, pairs[p], middle[block], least)
            close = np.flatnonzero(apart - reach[p, :, block].sum(axis=1) <= _limit(least))
            k = starts[block[close]][:, None] + np.arange(_BLOCK)
            p = np.broadcast_to(p[close][:, None], k.shape)
            inside = k < stops[block[close]][:, None]
            yield p[inside], k[inside]

    def _close_within(
        self, motion: _Intervals, pairs: IntArray, k: IntArray, strays: FloatArray,
        least: _Least | None,
    ) -> tuple[IntArray, IntArray, FloatArray]:  # fmt: skip
        """Return pairs, intervals and errors in which bars may be close, of some intervals."""
        if not len(k):
            return pairs, k, np.zeros(0)
        candidates = []
        for first in range(0, len(k), _TOGETHER):
            some, index = pairs[first : first + _TOGETHER], k[first : first + _TOGETHER]
            apart = self._apart_at(motion, some, index, least)
            if motion.rates is not None:
                within = 2 * strays[self._bars[some]].max(axis=2).sum(axis=1)
                close = apart - within <= _limit(least)
                some, index, apart = some[close], index[close], apart[close]
            way = _largest(np.diff(motion.cubics(self._bars, some, index), axis=0).swapaxes(0, 1))
            error = np.zeros(len(index))
            if least is None:
                error = motion.error(self._bars, some, index)
            close = apart - way.sum(axis=0) - error <= _limit(least)
            candidates.append((some[close], index[close], error[close]))
        some, index, error = (np.concatenate(arrays) for arrays in zip(*candidates, strict=True))
        return some, index, error

    def _see_between(self, motion: _Intervals, pairs: IntArray, k: IntArray, least: _Least) -> None:
        """Look for the least distance within intervals."""
        for first in range(0, len(k), _TOGETHER // 8):
            some, index = pairs[first : first + _TOGETHER // 8], k[first : first + _TOGETHER // 8]
            cubic = motion.cubics(self._bars, some, index)
            distance = _apart(_at(cubic, _PLACES[None]))[0]
            item, sample = np.unravel_index(distance.argmin(), distance.shape)
            one, s, step = slice(item, item + 1), float(_PLACES[sample]), _PLACES[1]
            for _ in range(_ROUNDS):
                near = np.clip(s + step * (2 * _PLACES - 1), 0, 1)
                step *= 2 * _PLACES[1]
                distance = _apart(_at(cubic[..., one], near[None]))[0][0]
                s = float(near[distance.argmin()])
            time = motion.begin[index[item]] + s * motion.length[index[item]]
            least.see(distance.min()[None], np.array([time]), some[one])

    # ---- crossings ----

    def _key(self, motion: _Intervals, pairs: IntArray, k: IntArray) -> IntArray:
        """Return a number for each pair in each interval of the motion given."""
        pair = pairs[:, 0] * len(self._bars) + pairs[:, 1]
        return np.asarray(pair * (self._kept.count + 1) + motion.origin[k])

    @cached_property
    def searched(self) -> tuple[tuple[BarCrossing, ...], int]:
        """Crossings, and the number of intervals that could not be resolved.

        What the motion is integrated again with is let go of.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # of motions that run away
            crossings = self._searched() if self.has_pairs and self._kept.count else ((), 0)
        self._again = None  # which holds all that was integrated with
        return crossings

    def _searched(self) -> tuple[tuple[BarCrossing, ...], int]:
        motion, events, unresolved = self._base, list[BarCrossing](), set[int]()
        if self._is_short and motion is self._kept:
            unresolved |= set(range(self._kept.count))
        pairs, k, error = self._close(motion, None)
        parts = self._parts if motion is self._kept else _PARTS * motion.count // self._kept.count
        while len(k):
            if len(k) > _MOST_PLACES:  # bars fly about: nothing can be told of them
                unresolved |= set(np.unique(motion.origin[k]).tolist())
                break
            more, sure = self._crossed(motion, pairs, k, error)
            # All of a pair in an interval is looked at again, or nothing.
            key = self._key(motion, pairs, k)
            finer = np.isin(key, key[~sure])
            pieces = dict[int, _Intervals]()
            for origin in np.unique(motion.origin[k[finer]]).tolist():
                piece = self._integrated(origin, origin, parts) if parts <= _MOST_PARTS else None
                if piece is None:
                    unresolved.add(origin)
                else:
                    pieces[origin] = piece
            finer &= np.isin(motion.origin[k], list(pieces))
            events += [
                BarCrossing(float(time), (int(pairs[i, 0]), int(pairs[i, 1])))
                for i, time in more
                if not finer[i]
            ]
            if motion is not self._base:
                self._finer.append((motion, pairs[~finer], k[~finer]))
            if not pieces:
                break
            again, first = np.unique(key[finer], return_index=True)
            self._made_finer = np.concatenate([self._made_finer, again])
            origins, some = motion.origin[k[finer]][first], pairs[finer][first]
            motion = _Intervals.joined(list(pieces.values()))
            start = np.searchsorted(list(pieces), origins) * parts
            k = (start[:, None] + np.arange(parts)).ravel()
            pairs = np.repeat(some, parts, axis=0)
            error = motion.error(self._bars, pairs, k)
            parts *= _PARTS
        if events:  # those that are together, up to round-off, by the numbers of their bars
            tick = _ROUND_OFF * float(self._kept.length.sum())
            events.sort(key=lambda crossing: (round(crossing.time / tick), crossing.bars))
        return tuple(events), len(unresolved)

    def _crossed(
        self, motion: _Intervals, pairs: IntArray, k: IntArray, error: FloatArray
    ) -> tuple[list[tuple[int, float]], np.ndarray]:
        """Return crossings, by place and time, and whether the states tell them for sure."""
        sure, events = np.ones(len(k), dtype=bool), list[tuple[int, float]]()
        for first in range(0, len(k), _TOGETHER // 8):
            some = np.arange(first, min(first + _TOGETHER // 8, len(k)))
            cubic = motion.cubics(self._bars, pairs[some], k[some])
            corners = _at(cubic, _PLACES[None])
            distance, volume = _apart(corners)[0], _volume(corners)
            u, v = corners[1] - corners[0], corners[0] - corners[2]
            area = np.linalg.norm(u, axis=0) * np.linalg.norm(v, axis=0)
            apart = (np.abs(volume) > _ROUND_OFF * self._size * area).any(axis=1)
            item, low, high = _sign_changes(cubic, volume)
            item, low, high = (array[apart[item]] for array in (item, low, high))
            here = cubic[..., item]
            after = _volume(_at(here, high)) >= 0
            for _ in range(_HALVINGS if len(item) else 0):
                middle = (low + high) / 2
                late = (_volume(_at(here, middle)) >= 0) == after
                low, high = np.where(late, low, middle), np.where(late, middle, high)
            left, right = (np.abs(_volume(_at(here, share_at))) for share_at in (low, high))
            share = low + (high - low) * left / np.where(left > 0, left + right, 1.0)
            inside = _apart(_at(here, share))[3]
            item, share = item[inside], share[inside]
            time = motion.begin[k[some[item]]] + share * motion.length[k[some[item]]]
            events += zip(some[item].tolist(), time.tolist(), strict=True)
            # Between two places bars come nearer by less than this.
            fastest = 3 * _largest(np.diff(cubic, axis=0).swapaxes(0, 1)).max(axis=0)
            nearest = distance.min(axis=1) - fastest * _PLACES[1] / 2
            ends, off = np.minimum(distance[:, 0], distance[:, -1]), 2 * error[some]
            once = np.bincount(item, minlength=len(some)) == 1
            sure[some] = (nearest > off) | (once & (ends > off)) | (off <= _EXACT * self._size)
        return events, sure


def _limit(least: _Least | None) -> float:
    """Return the distance above which bars need no closer look, m."""
    return 0.0 if least is None else least.limit


def _sign_changes(cubic: FloatArray, volume: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return items and the shares between which their volumes, (m, places), change sign."""
    positive, step = volume >= 0, _PLACES[1]
    item, sample = np.nonzero(positive[:, 1:] != positive[:, :-1])
    brackets = [(item, _PLACES[sample], _PLACES[sample + 1])]
    # Twice between two places: where the volume is least between two that are alike.
    size = np.abs(volume)
    before, here, after = size[:, :-2], size[:, 1:-1], size[:, 2:]
    alike = (positive[:, :-2] == positive[:, 1:-1]) & (positive[:, 1:-1] == positive[:, 2:])
    bend = before - 2 * here + after
    item, sample = np.nonzero(alike & (here <= before) & (here <= after) & (bend > 0))
    change = (before - after)[item, sample] / (2 * bend[item, sample])
    least = _PLACES[sample + 1] + step * change
    if len(item):
        other = (_volume(_at(cubic[..., item], least)) >= 0) != positive[item, sample + 1]
        item, sample, least = item[other], sample[other], least[other]
        brackets += [(item, _PLACES[sample], least), (item, least, _PLACES[sample + 2])]
    items, low, high = (np.concatenate(arrays) for arrays in zip(*brackets, strict=True))
    return items, low, high
