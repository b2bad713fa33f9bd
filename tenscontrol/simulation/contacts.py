"""Ground contacts of a run: times, penetration, forces and lost energy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics.contact_laws import ContactLaw
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.integrate.integrator import IntegrationError
from tenscontrol.simulation.dense_motion import SHARES, WEIGHTS, DenseMotion

# A part is cut up until the works and impulses in it change by less than this part of the largest
# kinetic energy and momentum, or so many times the tolerance of the run; or of the work and impulse
# of the loads in the whole run. Velocities must change by less than a part of the largest, or of
# the size in the time of the part: else there may be more between its ends than they say.
_EXACT, _TOLERANCES, _OF_LOADS = 1e-7, 10.0, 1e-3
_EXACT_SPEED, _ROUND_OFF = 1e-4, 1e-14

# Into so many pieces, by how far it is off, so many times.
_FEWEST, _MOST, _LEVELS = 4, 8, 12

# Nodes may be this much faster between the states kept than they are there.
_FASTER = 2.0

# And into no more than so many in all, beside so many for each step of the run: the worst come
# first.
_PIECES, _PIECES_A_STEP = 1_000, 0.5

# Evaluations that this may take in any case; else it takes as many as the run did.
_EVALUATIONS = 50_000

# Parts that are integrated again in one go: the motion leaves that of the run no further than these
# let it.
_TOGETHER = 32

# Numbers of states that are looked at in one go.
_NUMBERS = 2_000_000

# Halvings of the time in which a contact switches.
_HALVINGS = 40


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """Contacts of a run with the ground. Made by :func:`simulate`, for models with a ground.

    A contact is a node and a law of the ground; those that never touched are left out. Works and
    impulses are from the start of the run to each time. They are integrals over the motion between
    the states kept, which is integrated again where these are too few to tell: at about the cost of
    the run itself, for the time in which something touched.

    Attributes
    ----------
    node, law : ndarray of int, shape (c,)
        Of each contact, the node, and the law's place in ``model.ground``.
    depth : ndarray, shape (c, T)
        m, positive in the ground.
    normal_force : ndarray, shape (c, T)
        N, at least 0.
    tangential_force : ndarray, shape (d, c, T)
        Friction on the node, N.
    stored_energy : ndarray, shape (c, T)
        What the ground stores, J.
    damping_work, friction_work : ndarray, shape (c, T)
        Energy lost by damping along the normal and by friction up to each time, J, at least 0.
    impulse : ndarray, shape (d, c, T)
        Of the force of the ground on the node up to each time, N s.
    deepest : ndarray, shape (c,)
        Largest depth at any time, also between those of the run, m.
    touch : ndarray of int, shape (k,)
        The contact of each time in which a node was pressed without a break.
    begin, end : ndarray, shape (k,)
        When the force began and ended to act, s, located between the states kept; or the start
        and end of the run.
    work_error : float
        Bound on the error of all works together, J, far above it where the motion is smooth;
        infinite where it could not be integrated again.
    impulse_error : float or None
        Largest difference between the change of momentum and the impulses of the ground and of
        constant loads, along an axis, N s; None where supports or other loads change it too.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> ground = tc.Ground(stiffness=5e3, damping=0.3, friction=0.5, height=-0.1)
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, gravity=9.81, ground=ground)
    >>> rest = tc.prestress(prism, force_density=500.0)
    >>> run = tc.simulate(model, 0.2, force_density=rest.force_density, step=1e-3)
    >>> run.contacts.node, run.contacts.begin.round(3)
    (array([3, 4, 5]), array([0.143, 0.143, 0.143]))
    """

    node: IntArray
    law: IntArray
    depth: FloatArray
    normal_force: FloatArray
    tangential_force: FloatArray
    stored_energy: FloatArray
    damping_work: FloatArray
    friction_work: FloatArray
    impulse: FloatArray
    deepest: FloatArray
    touch: IntArray
    begin: FloatArray
    end: FloatArray
    work_error: float
    impulse_error: float | None = None

    @property
    def lost_energy(self) -> FloatArray:
        """Energy lost at the ground up to each time, J, shape (T,)."""
        return np.asarray((self.damping_work + self.friction_work).sum(axis=0))

    @property
    def penetration(self) -> float:
        """Largest depth of all, m; 0 where nothing touched."""
        return float(self.deepest.max(initial=0.0))

    @property
    def node_impulse(self) -> dict[int, FloatArray]:
        """Impulse of the ground on each node that touched, over the run, N s, shape (d,)."""
        nodes = sorted({int(node) for node in self.node})
        return {node: self.impulse[:, self.node == node, -1].sum(axis=1) for node in nodes}

    @property
    def largest_impulse(self) -> float:
        """Largest impulse of the ground on a node over the run, N s."""
        return max((float(np.hypot.reduce(p)) for p in self.node_impulse.values()), default=0.0)

    def summary(self) -> str:
        """Return the nodes in contact, penetration and lost energy, as text.

        Returns
        -------
        str
        """
        nodes = list(self.node_impulse)
        if not nodes:
            return "ground            nothing touched it"
        some = ", ".join(map(str, nodes[:8])) + (", ..." if len(nodes) > 8 else "")
        damped, rubbed = (float(w[:, -1].sum()) for w in (self.damping_work, self.friction_work))
        return (
            f"ground            touched by node{'s' * (len(nodes) > 1)} {some}, "
            f"{len(self.touch)} times, {self.penetration:.2g} m deep at most\n"
            f"lost at ground    {damped:.4g} J by damping, {rubbed:.4g} J by friction"
        )

    def __repr__(self) -> str:
        return f"ContactRecord({len(self.node)} contacts, {len(self.touch)} times)"


def _at_a_node(law: ContactLaw, dimension: int) -> ca.Function:
    """Return ``(x, v) -> (depth, normal, stored, damped, rubbed, tangential, force)`` of one node.

    Depth, m; forces, N; stored energy, J; powers lost by damping and friction, W.
    """
    x, v, p = ca.SX.sym("x", dimension), ca.SX.sym("v", dimension), ca.SX.sym("p")
    depth, rate, away = law.sinking(x, v)
    gap, normal = law.gap(depth, rate), law.normal_force(depth, rate)
    if gap is not None:
        normal = ca.if_else(gap > 0, normal, 0)
    force, stored = law.force(x, v), law.stored_energy(p)
    tangential = force - normal * away
    energy, slowly = Function("stored", [p], [stored, ca.gradient(stored, p)])(depth)
    damped, rubbed = (normal - slowly) * rate, -ca.dot(tangential, v)
    parts = [depth, normal * ca.norm_2(away), energy, damped, rubbed, tangential, force]
    return Function("contact", [x, v], [ca.densify(ca.vertcat(*parts))])


class _Integrals:
    """What segments of a motion hold of each contact: works, impulse, and where it presses."""

    def __init__(self, work: FloatArray, pressing: FloatArray, deepest: FloatArray) -> None:
        self.work = work  # damping, friction and impulse, (c, 2 + d, K)
        self.pressing = pressing  # at the nodes of the quadrature, (c, K, 5)
        self.deepest = deepest  # m, (c, K)

    def take(self, k: IntArray) -> _Integrals:
        return _Integrals(self.work[:, :, k], self.pressing[:, k], self.deepest[:, k])


class _Recorder:
    """The contacts of a motion, segment by segment; those not exact are cut up."""

    def __init__(
        self, segments: DenseMotion, nodes: FloatArray, velocities: FloatArray, kinetic: float
    ) -> None:
        model = segments.run.model
        self._kept, self._model = segments, model
        self._dimension, self._count = nodes.shape[:2]
        self._speed = float(np.linalg.norm(velocities, axis=0).max())
        self._size = model.structure.size
        momentum = float(np.sqrt(2 * model.mass_matrix().sum() * kinetic))
        load = float(np.linalg.norm(model.constant_force.sum(axis=1)))
        load *= float(segments.ends[-1] - segments.begins[0])
        exact, tolerance, chosen = _EXACT, 0.0, segments.run.choice
        if chosen.setting == "tolerance":
            tolerance = chosen.value
            exact = max(exact, _TOLERANCES * tolerance)
        self._exact_work = exact * (kinetic + _OF_LOADS * load * self._speed)
        self._exact_impulse = exact * (momentum + _OF_LOADS * load)
        self._values = [
            model.prepared.get(("contact", i), partial(_at_a_node, law, self._dimension))
            for i, law in enumerate(model.ground)
        ]
        self._find(nodes, velocities)
        # Places are known to the tolerance, and forces to what the ground makes of that, N.
        deepest, c = self.values[:, 0].argmax(axis=1), np.arange(len(self.values))
        depth, force = self.values[c, 0, deepest], self.values[c, 1, deepest]
        stiffness = force[depth > 0] / depth[depth > 0]
        self._noise = tolerance * self._size * float(stiffness.max(initial=0.0))
        self.error = 0.0
        self._done: list[tuple[DenseMotion, IntArray, _Integrals]] = []

    def _find(self, nodes: FloatArray, velocities: FloatArray) -> None:
        """Find the contacts that may have been, where, and their values at the times kept."""
        segments, candidates, near = self._kept, [], []
        assert self._model.contacts is not None  # else nothing is recorded
        reach = _FASTER * self._speed * (segments.ends - segments.begins)
        for i, (law, every, _) in enumerate(self._model.contacts):
            for node in every:
                (values,) = evaluate_columns(self._values[i], nodes[:, node], velocities[:, node])
                after, before = values[0], np.append(values[0, :1], values[0, :-1])
                close = (np.maximum(after, before) > 0) | (after + before + reach > 0)
                close = (close | (not law.switches)) & (segments.ends > segments.begins)
                if close.any():
                    candidates.append((i, int(node), values))
                    near.append(close)
        shape = len(candidates), nodes.shape[2]
        self.law, self.node = (np.array([f[k] for f in candidates], dtype=np.int64) for k in (0, 1))
        rows = 5 + 2 * self._dimension
        self.values = np.array([f[2] for f in candidates]).reshape(shape[0], rows, shape[1])
        self.near = np.array(near, dtype=bool).reshape(shape)

    def run(self) -> None:
        """Integrate over all segments in which something may touch."""
        near = np.flatnonzero(self.near.any(axis=0))
        if not len(near):
            return
        parts = self._kept.take(near)
        integrals, off = self._integrated(parts, near), np.full(len(near), np.inf)
        change = np.zeros(len(near))
        # Two at a time: where one polynomial through both says the same, so does each.
        breaks = (np.diff(near, prepend=-2) != 1) | (np.diff(parts.of, prepend=-1) != 0)
        run = np.flatnonzero(breaks)[np.cumsum(breaks) - 1]
        lead = np.flatnonzero((np.arange(len(near)) - run) % 2 == 0)
        lead = lead[lead + 1 < len(near)]
        lead = lead[~breaks[lead + 1]]
        if len(lead):
            pairs = np.column_stack([lead, lead + 1]).ravel()
            fine = parts.take(pairs)
            both = DenseMotion(
                parts.run, parts.of[lead], parts.begins[lead], parts.ends[lead + 1],
                parts.before[:, lead], parts.after[:, lead + 1],
            )  # fmt: skip
            coarse = self._integrated(both, near[lead], near[lead + 1])
            owner = np.repeat(np.arange(len(lead)), 2)
            far, changed = self._off(both, coarse, fine, integrals.take(pairs), owner, near[pairs])
            off[pairs], change[pairs] = far[owner], changed[owner] / 2
        self._cut_up(parts, near, integrals, off, change)

    def _cut_up(
        self, parts: DenseMotion, kept: IntArray, integrals: _Integrals, off: FloatArray,
        change: FloatArray,
    ) -> None:  # fmt: skip
        """Take parts that are exact, and integrate the others again, in pieces.

        They are off by so much, as part of what is exact, and change in work, J.
        """
        left = _PIECES + _PIECES_A_STEP * parts.run.work.steps
        evaluations = max(_EVALUATIONS, parts.run.work.evaluations)
        for level in range(_LEVELS + 1):
            # Errors fall by the sixth power of the length. A power of two, so that many are alike.
            wanted = 2 ** np.ceil(np.log2(2 * np.clip(off, 1, _MOST**6) ** (1 / 6)))
            counts = np.where(np.isinf(off), _FEWEST, np.clip(wanted, _FEWEST, _MOST)).astype(int)
            worst = np.argsort(-off, kind="stable")
            good = off <= 1
            good[worst] |= (np.cumsum(counts[worst]) > left) | (level == _LEVELS)
            self.error += float(change[good].sum())
            taken, bad = np.flatnonzero(good), np.flatnonzero(~good)
            self._done.append((parts.take(taken), kept[taken], integrals.take(taken)))
            parts, kept = parts.take(bad), kept[bad]
            integrals, counts = integrals.take(bad), counts[bad]
            if not len(kept):
                return
            pieces, again = [], 0  # segments that are integrated again: the first ones
            try:
                for group in parts.groups(counts, _TOGETHER):
                    if evaluations <= 0:
                        break
                    piece, cost = parts.again(group[0], group[-1], int(counts[group].sum()))
                    pieces.append(piece)
                    evaluations -= cost
                    again = int(group[-1]) + 1
            except (IntegrationError, KeyboardInterrupt):
                self.error = np.inf
                self._done.append((parts, kept, integrals))
                return
            if again < len(kept):  # the others are as exact as they are
                rest, done = np.arange(again, len(kept)), np.arange(again)
                self.error += float(change[bad][rest].sum())
                self._done.append((parts.take(rest), kept[rest], integrals.take(rest)))
                if not again:
                    return
                parts, kept, integrals = parts.take(done), kept[done], integrals.take(done)
                counts = counts[done]
            left -= int(counts.sum())
            finer, owner = DenseMotion.joined(pieces), np.repeat(np.arange(len(kept)), counts)
            kept = kept[owner]
            fine = self._integrated(finer, kept)
            off, change = self._off(parts, integrals, finer, fine, owner, kept)
            parts, integrals, off, change = finer, fine, off[owner], (change / counts)[owner]

    def _off(
        self, coarse: DenseMotion, before: _Integrals, fine: DenseMotion, after: _Integrals,
        owner: IntArray, kept: IntArray,
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Return how far segments are from their pieces, as part of what is exact, and in work, J.

        Both of shape (K,).
        """
        starts = np.flatnonzero(np.diff(owner, prepend=-1))
        change = np.abs(np.add.reduceat(after.work, starts, axis=2) - before.work)
        length = (coarse.ends - coarse.begins)[owner]
        _, predicted = coarse.at((fine.begins - coarse.begins[owner]) / length, owner)
        _, true = fine.at(np.zeros(len(owner)), np.arange(len(owner)))
        apart = (predicted - true).reshape(2, self._count, self._dimension, -1)[1, self.node]
        apart = np.where(self.near[:, kept], np.linalg.norm(apart, axis=1), 0.0).max(axis=0)
        speed = _EXACT_SPEED * self._speed + _ROUND_OFF * self._size / length
        off = np.maximum.reduceat(apart / speed, starts)
        for integral, exact in (
            (change[:, :2], self._exact_work),
            (change[:, 2:], self._exact_impulse),
        ):
            off = np.maximum(off, integral.max(axis=(0, 1)) / max(exact, 1e-300))
        changed = change[:, :2].sum(axis=(0, 1))
        # Where the motion runs away, a difference of infinite numbers says nothing.
        off[np.isnan(off)] = changed[np.isnan(changed)] = np.inf
        return off, changed

    def _integrated(self, parts: DenseMotion, *kept: IntArray) -> _Integrals:
        """Return the integrals over segments, which are in these that were kept."""
        near = np.any([self.near[:, k] for k in kept], axis=0)
        (contacts, count), shares = near.shape, len(SHARES)
        work = np.zeros((contacts, 2 + self._dimension, count))
        pressing = np.zeros((contacts, count, shares), dtype=bool)
        deepest = np.full((contacts, count), -np.inf)
        size = max(1, _NUMBERS // (shares * 2 * self._dimension * self._count))
        for begin in range(0, count, size):
            some = np.arange(begin, min(begin + size, count))
            k, s = np.repeat(some, shares), np.tile(SHARES, len(some))
            every = parts.at(s, k)[1].reshape(2, self._count, self._dimension, -1)
            duration = parts.ends[some] - parts.begins[some]
            for c in range(contacts):
                touching = np.flatnonzero(near[c, some])
                if not len(touching):
                    continue
                places = (touching[:, None] * shares + np.arange(shares)).ravel()
                x, v = every[:, self.node[c]][:, :, places]
                (values,) = evaluate_columns(self._values[self.law[c]], x, v)
                values = values.reshape(len(values), len(touching), shares)
                rows = np.r_[3, 4, 5 + self._dimension : 5 + 2 * self._dimension]
                work[c][:, some[touching]] = values[rows] @ WEIGHTS * duration[touching]
                pressing[c, some[touching]] = values[1] > 0
                deepest[c, some[touching]] = values[0].max(axis=1)
        return _Integrals(work, pressing, deepest)

    def record(self) -> ContactRecord:
        """Return the contacts that were."""
        d, (count, times) = self._dimension, self.near.shape
        work, deepest = np.zeros((count, 2 + d, times)), self.values[:, 0].max(axis=1, initial=0.0)
        touched = (self.values[:, 1] > 0).any(axis=1)
        touch, begin, end = np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
        if self._done:
            parts = DenseMotion.joined([done[0] for done in self._done])
            order = np.argsort(parts.begins, kind="stable")
            for _, k, integrals in self._done:
                np.add.at(work.transpose(2, 0, 1), k, integrals.work.transpose(2, 0, 1))
                deepest = np.maximum(deepest, integrals.deepest.max(axis=1, initial=0.0))
            pressing = np.concatenate([done[2].pressing for done in self._done], axis=1)
            touched |= pressing.any(axis=(1, 2))
            touch, begin, end = self._touches(parts.take(order), pressing[:, order])
        values, work = self.values[touched], work[touched].cumsum(axis=2)
        return ContactRecord(
            node=frozen(self.node[touched]),
            law=frozen(self.law[touched]),
            depth=frozen(values[:, 0]),
            normal_force=frozen(values[:, 1]),
            tangential_force=frozen(values[:, 5 : 5 + d].swapaxes(0, 1)),
            stored_energy=frozen(values[:, 2]),
            damping_work=frozen(work[:, 0]),
            friction_work=frozen(work[:, 1]),
            impulse=frozen(work[:, 2:].swapaxes(0, 1)),
            deepest=frozen(deepest[touched]),
            touch=frozen((np.cumsum(touched) - 1)[touch]),
            begin=frozen(begin),
            end=frozen(end),
            work_error=self.error,
        )

    def _touches(
        self, parts: DenseMotion, pressing: np.ndarray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return contact, begin and end of each time in which a node was pressed."""
        flat, first, last = pressing.reshape(len(pressing), -1), parts.begins[0], parts.ends[-1]
        contact, change = np.nonzero(flat[:, 1:] != flat[:, :-1])
        before = flat[contact, change]
        k, j = np.divmod(change, len(SHARES))
        parts, k = parts.take(k), np.arange(len(k))
        low = SHARES[j]
        high = np.append(SHARES, 1.0)[j + 1]  # between two segments, the end of the first
        for _ in range(_HALVINGS if len(k) else 0):
            middle = (low + high) / 2
            every = parts.at(middle, k)[1].reshape(2, self._count, self._dimension, -1)
            x, v = every[:, self.node[contact], :, np.arange(len(k))].transpose(1, 2, 0)
            same = np.zeros(len(k), dtype=bool)
            for i, function in enumerate(self._values):
                mine = self.law[contact] == i
                if mine.any():
                    normal = evaluate_columns(function, x[:, mine], v[:, mine])[0][1]
                    same[mine] = (normal > 0) == before[mine]
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        time = (1 - low) * parts.begins[k] + low * parts.ends[k]
        ends = []
        for pressed, edge, when in ((False, 0, first), (True, -1, last)):
            pressed_there = np.flatnonzero(flat[:, edge])
            of = np.concatenate([contact[before == pressed], pressed_there])
            times = np.concatenate([time[before == pressed], np.full(len(pressed_there), when)])
            order = np.lexsort((times, of))
            ends.append((of[order], times[order]))
        (of, begin), (_, end) = ends
        order = np.argsort(begin, kind="stable")
        return of[order], begin[order], end[order]


def record_contacts(
    segments: DenseMotion, nodes: FloatArray, velocities: FloatArray, kinetic: float
) -> ContactRecord:
    """Return the contacts of a motion.

    ``segments`` are those between the states kept, ``nodes`` and ``velocities``, shape (d, n, T),
    what they end in; ``kinetic`` is the largest kinetic energy, J.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # of motions that run away
        recorder = _Recorder(segments, nodes, velocities, kinetic)
        recorder.run()
        return recorder.record()
