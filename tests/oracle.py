"""Independent NumPy models that the package is measured against.

Two formulations, neither of them the package's:

- :class:`RigidBars`, for class 1 in space: Newton and Euler, every bar a rigid body with a centre,
  a direction and an angular velocity, every string node a point mass.
- :func:`node_acceleration` and :class:`NodeMotion`, for any structure: Lagrange multipliers over
  the node coordinates, dense, by least squares. Complex numbers are allowed, so that derivatives
  can be taken by complex steps.

Both motions are integrated with each switch of a string or contact located, so that no step crosses
a kink.

Of the package only the :class:`Structure`, a bag of indices and masses, is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from scipy.integrate import DOP853, solve_ivp
from scipy.linalg import qr
from scipy.optimize import brentq

# How far a string may pass the border of slack before the switch is acted on, m. The border is
# crossed within a time t in which the force is wrong by less than stiffness × this: far below
# round-off after the integration over t.
_BORDER = 1e-11

# Switches of different strings that follow each other within this time are one switch, s. Strings
# that switch together by symmetry differ by round-off, which the motion magnifies: after 4.6 s of
# the paper's example a string may lag by more than half a border, 0.5e-11 m, and gaps close at
# about 1 m/s there. Distinct switches of that motion are 0.04 s apart.
_TOGETHER = 1e-11

# Where within a step the strings are looked at.
_FRACTIONS = np.linspace(0.0, 1.0, 9)

# The components after each, and after those, in a cross product.
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


@dataclass(frozen=True)
class HeldForceDensity:
    """Strings whose force density is held."""

    force_density: np.ndarray

    def __call__(self, length, rate, pulls):
        return self.force_density

    def border(self, length, rate):
        return np.ones_like(length)


@dataclass(frozen=True)
class HeldRestLength:
    """Strings ``T = k (l - l0) + c dl/dt`` while longer than l0 and pulling, else T = 0."""

    rest_length: np.ndarray
    stiffness: float
    damping: float = 0.0

    def __call__(self, length, rate, pulls):
        tension = self.stiffness * (length - self.rest_length) + self.damping * rate
        return np.where(pulls, tension / length, 0.0)

    def border(self, length, rate):
        """Positive where a string pulls, m."""
        stretch = length - self.rest_length
        return np.minimum(stretch, stretch + self.damping / self.stiffness * rate)


@dataclass(frozen=True)
class Plane:
    """Ground ``n·x <= h`` under all nodes: ``k p**e (1 + d dp/dt)``, and rounded friction."""

    stiffness: float
    damping: float
    friction: float
    slip_speed: float
    normal: tuple[float, ...]
    height: float = 0.0
    exponent: float = 1.0

    @cached_property
    def _up(self):
        return np.array(self.normal)

    def sinking(self, N, V):
        """Return depths and their rates of nodes, one a row."""
        return self.height - N @ self._up, -(V @ self._up)

    def force(self, N, V, presses):
        """Return the force on each node, N, one a row, where it presses."""
        depth, rate = self.sinking(N, V)
        force, at = np.zeros_like(V), np.flatnonzero(presses)
        if len(at):
            depth, rate = depth[at], rate[at]
            size = self.stiffness * np.abs(depth) ** self.exponent
            size *= np.sign(depth) * (1 + self.damping * rate)
            slip = V[at] + rate[:, None] * self._up
            speed = np.sqrt((slip * slip).sum(axis=1) + self.slip_speed**2)
            force[at] = size[:, None] * self._up - (self.friction * size / speed)[:, None] * slip
        return force

    def border(self, N, V):
        """Positive where a node presses."""
        depth, rate = self.sinking(N, V)
        return np.minimum(depth, 1 + self.damping * rate)


def _pushes(planes, N, V, presses):
    """Return the forces of several planes on the nodes, one a row."""
    parts = presses.reshape(len(planes), -1)
    return sum(plane.force(N, V, part) for plane, part in zip(planes, parts, strict=True))


class Motion:
    """A motion with strings that go slack and taut, and contacts, each switch located.

    A formulation gives ``structure``, ``state(nodes, velocities)`` and ``nodes(state)``, its
    inverse, ``slope(state, pulls)`` for fixed slack and taut strings, and ``border(states)``, how
    far each string is from slack, m, positive where it pulls. Contacts follow the strings, plane
    by plane.
    """

    def pulls(self, state):
        """Return which strings pull."""
        return self.border(state) > 0

    def integrate(self, nodes, velocities, times, tolerance=1e-13, method=DOP853):
        """Return node positions at the times (ascending, from 0), shape (d, n, T), and switches.

        Every step ends at the next switch of a string; the time of each switch is returned.
        Other strings that follow within round-off belong to the same switch.
        """
        state, now = self.state(nodes, velocities), 0.0
        states = [state]
        switches: list[float] = []
        pulls = self.pulls(state)
        switched = np.zeros_like(pulls)
        while len(states) < len(times):
            piece = self._piece(state, now, times, len(states), pulls, tolerance, method)
            found, state, now, crossed = piece
            states += found
            pulls = pulls ^ crossed
            if crossed.any():
                late = switches and now - switches[-1] <= _TOGETHER
                if late and not (switched & crossed).any():
                    switched |= crossed
                else:
                    switches.append(now)
                    switched = crossed
        placed = [self.nodes(each)[0] for each in states]
        return np.stack(placed, axis=2), np.array(switches)

    def _piece(self, state, now, times, done, pulls, tolerance, method):
        """Integrate to the next switch or the end, and return what was met on the way."""
        sign = np.where(pulls, 1.0, -1.0)

        def slope(_, y):
            return self.slope(y, pulls)

        def room(y):
            return sign * self.border(y) + _BORDER

        stepper = method(slope, now, state, times[-1], rtol=tolerance, atol=0.1 * tolerance)
        found: list[np.ndarray] = []
        while stepper.status == "running":
            before, at = stepper.y.copy(), stepper.t
            stepper.step()
            assert stepper.status != "failed"
            between = stepper.dense_output()
            switch = _first_crossing(room, between, at, stepper.t)
            reached = stepper.t if switch is None else switch
            last = np.searchsorted(times, reached, side="right")
            found += [between(time) for time in times[done + len(found) : last]]
            if switch is not None:
                landed = solve_ivp(
                    slope, (at, switch), before, "DOP853", rtol=tolerance, atol=0.1 * tolerance
                )
                end = landed.y[:, -1]
                return found, end, switch, room(end) < 0.5 * _BORDER
        return found, stepper.y, stepper.t, np.zeros_like(pulls)


class RigidBars(Motion):
    """A structure as rigid bodies and point masses.

    The state is ``[r, e, p, dr/dt, w, dp/dt]``: bar centres, bar directions (unit vectors), string
    nodes, and their rates, w the angular velocities.
    """

    def __init__(self, structure, law, external_force=None, ground=()):
        self.structure, self.law, self.ground = structure, law, ground
        self.start, self.end = structure.bars.T
        self.points = structure.string_nodes
        self.mass, self.point_mass = (
            structure.bar_mass[:, None],
            structure.string_node_mass[:, None],
        )
        ends = structure.nodes[:, self.end] - structure.nodes[:, self.start]
        self.half = 0.5 * np.linalg.norm(ends, axis=0)[:, None]
        count = structure.nodes.shape[1]
        self.load = np.zeros((count, 3)) if external_force is None else np.transpose(external_force)
        self.inertia = self.mass * (2 * self.half) ** 2 / 12
        bars, points = len(self.mass), len(self.points)
        self.bodies, self._turning = 2 * bars + points, slice(bars, 2 * bars)
        # Node positions are linear in r, e and p; so are string vectors.
        place = np.zeros((count, self.bodies))
        every = np.arange(bars)
        place[self.start, every] = place[self.end, every] = 1.0
        place[self.start, bars + every] = -self.half[:, 0]
        place[self.end, bars + every] = self.half[:, 0]
        place[self.points, 2 * bars + np.arange(points)] = 1.0
        self.stretch = _incidence(structure.strings, count) @ place
        self.body_load, self.place = place.T @ self.load, place
        self.resistance = np.concatenate([self.mass, self.inertia, self.point_mass])
        ends = np.cumsum([bars, bars, points, bars, bars, points]) * 3
        self._parts = [slice(*cut) for cut in zip([0, *ends[:-1]], ends, strict=True)]

    # ---- between nodes and bodies ----

    def state(self, nodes, velocities):
        """Return the state of a motion of the nodes, shape (3, n) each."""
        N, V = nodes.T, velocities.T
        e = (N[self.end] - N[self.start]) / (2 * self.half)
        rate = (V[self.end] - V[self.start]) / (2 * self.half)
        position = [0.5 * (N[self.start] + N[self.end]), e, N[self.points]]
        motion = [0.5 * (V[self.start] + V[self.end]), np.cross(e, rate), V[self.points]]
        return np.concatenate([part.ravel() for part in position + motion])

    def nodes(self, state):
        """Return node positions and velocities, shape (3, n) each."""
        N, V = self._placed(*self._split(state))
        return N.T, V.T

    def _split(self, state):
        return [state[part].reshape(-1, 3) for part in self._parts]

    def _placed(self, r, e, p, rd, w, pd):
        N, V = np.empty_like(self.load), np.empty_like(self.load)
        arm, swing = self.half * e, self.half * _cross(w, e)
        N[self.start], N[self.end], N[self.points] = r - arm, r + arm, p
        V[self.start], V[self.end], V[self.points] = rd - swing, rd + swing, pd
        return N, V

    # ---- forces and motion ----

    def lengths(self, states):
        """Return string lengths and their rates, of one state or of many, one a row."""
        shaped = states.reshape(*states.shape[:-1], 2, self.bodies, 3)
        positions, motion = shaped[..., 0, :, :], self._rates(shaped)
        return _stretch(self.stretch @ positions, self.stretch @ motion)

    def _rates(self, shaped):
        """Return the rates of r, e and p: the directions turn with w."""
        motion = shaped[..., 1, :, :].copy()
        turning = self._turning
        motion[..., turning, :] = _cross(motion[..., turning, :], shaped[..., 0, turning, :])
        return motion

    def slope(self, state, pulls):
        """Return the time derivative of the state."""
        shaped = state.reshape(2, self.bodies, 3)
        positions, motion = shaped[0], self._rates(shaped)
        S = self.stretch @ positions
        alpha = len(self.stretch)
        gamma = self.law(
            *_stretch(S, self.stretch @ motion), pulls[:alpha] if self.ground else pulls
        )
        # Forces on the bodies; at the directions half a bar times the difference of its ends.
        F = self.body_load - self.stretch.T @ (gamma[:, None] * S)
        if self.ground:
            N, V = self.place @ positions, self.place @ motion
            F += self.place.T @ _pushes(self.ground, N, V, pulls[alpha:])
        F[self._turning] = _cross(positions[self._turning], F[self._turning])
        return np.concatenate([motion, F / self.resistance]).ravel()

    def node_acceleration(self, nodes, velocities):
        """Return the acceleration of every node, shape (3, n)."""
        state = self.state(nodes, velocities)
        _, e, _, _, w, _ = self._split(state)
        rates = self._split(self.slope(state, self.pulls(state)))
        rdd, wd, pdd = rates[3], rates[4], rates[5]
        swing = self.half * (_cross(wd, e) + _cross(w, _cross(w, e)))
        acceleration = np.empty_like(self.load)
        acceleration[self.start], acceleration[self.end] = rdd - swing, rdd + swing
        acceleration[self.points] = pdd
        return acceleration.T

    def border(self, states):
        """Return how far each string is from slack, m; positive where it pulls."""
        found = [self.law.border(*self.lengths(states))]
        if self.ground:
            shaped = states.reshape(*states.shape[:-1], 2, self.bodies, 3)
            N, V = self.place @ shaped[..., 0, :, :], self.place @ self._rates(shaped)
            found += [plane.border(N, V) for plane in self.ground]
        return np.concatenate(found, axis=-1)

    # ---- conserved quantities ----

    def momentum(self, nodes, velocities):
        """Return linear and angular momentum (about the origin) from the bodies."""
        r, _, p, rd, w, pd = self._split(self.state(nodes, velocities))
        inertia = self.mass * (2 * self.half) ** 2 / 12
        linear = (self.mass * rd).sum(axis=0) + (self.point_mass * pd).sum(axis=0)
        spin = (inertia * w).sum(axis=0)
        orbit = np.cross(r, self.mass * rd).sum(axis=0)
        return linear, spin + orbit + np.cross(p, self.point_mass * pd).sum(axis=0)

    def kinetic_energy(self, nodes, velocities):
        """Return the energy of translation and rotation, J."""
        _, _, _, rd, w, pd = self._split(self.state(nodes, velocities))
        inertia = self.mass * (2 * self.half) ** 2 / 12
        parts = (self.mass * rd**2, inertia * w**2, self.point_mass * pd**2)
        return 0.5 * sum(part.sum() for part in parts)


class NodeMotion(Motion):
    """Any structure by its node coordinates; the state is ``[vec(N); vec(dN/dt)]``, all nodes."""

    def __init__(self, structure, law, external_force=0.0, ground=()):
        self.structure, self.law, self.load = structure, law, external_force
        self.ground = ground

    def state(self, nodes, velocities):
        return np.concatenate([nodes.T.ravel(), velocities.T.ravel()])

    def nodes(self, state):
        """Return node positions and velocities, shape (d, n) each."""
        d, n = self.structure.nodes.shape
        return tuple(part.reshape(n, d).T for part in np.split(state, 2))

    def slope(self, state, pulls):
        N, V = self.nodes(state)
        alpha, load = len(self.structure.strings), self.load
        gamma = self.law(
            *string_motion(self.structure, N, V), pulls[:alpha] if self.ground else pulls
        )
        if self.ground:
            load = load + _pushes(self.ground, N.T, V.T, pulls[alpha:]).T
        acceleration, _ = node_acceleration(self.structure, N, V, gamma, load)
        return np.concatenate([V.T.ravel(), acceleration.T.ravel()])

    def border(self, states):
        each = np.array([self._border(*self.nodes(x)) for x in np.atleast_2d(states)])
        return each if np.ndim(states) == 2 else each[0]

    def _border(self, N, V):
        of_strings = self.law.border(*string_motion(self.structure, N, V))
        return np.concatenate([of_strings, *(plane.border(N.T, V.T) for plane in self.ground)])


def _cross(a, b):
    """Cross products of rows: np.cross at a tenth of its cost."""
    next_a, next_b = a.take(_NEXT, -1), b.take(_NEXT, -1)
    return next_a * b.take(_AFTER, -1) - a.take(_AFTER, -1) * next_b


def _stretch(S, Sd):
    length = np.sqrt(np.add.reduce(S * S, -1))
    return length, np.add.reduce(S * Sd, -1) / length


def _first_crossing(room, between, start, end):
    """Return when the least room first falls below zero within a step, or None."""
    times = start + (end - start) * _FRACTIONS
    met = np.flatnonzero(room(between(times[1:]).T).min(axis=1, initial=1.0) < 0)
    if not len(met):
        return None
    last, time = times[met[0] : met[0] + 2]
    return brentq(lambda t: room(between(t)).min(), last, time, xtol=1e-15, rtol=1e-15)


def node_acceleration(
    structure, nodes, velocities, force_density, external_force=0.0, extension=0.0
):
    """Return node accelerations (d, n) and bar multipliers λ from the saddle-point system.

    Lagrange's equations of the first kind, ``M a - Jᵀ λ = F`` with ``J a = -‖ḃ‖²``, more by the
    ``extension`` ``L L̈ + L̇²`` of each bar whose length L is driven, over the coordinates that
    supports leave free. A multiplier is the compression of its bar by its length; of redundant
    bars, those of least norm by least squares (for complex numbers: one solution).
    """
    d, count = nodes.shape
    rows, along_bars, M, few = _constants(structure)
    bars = len(along_bars)
    forces = external_force + string_forces(structure, nodes, force_density)
    jacobian = along_bars[:, :, None] * (along_bars @ nodes.T)[:, None, :]
    J = jacobian.reshape(bars, d * count)[:, rows]
    saddle = np.block([[M, -J[few].T], [J[few], np.zeros((len(few), len(few)))]])
    spread = velocities @ along_bars.T
    extension = np.broadcast_to(extension, bars)
    goal = extension[few] - (spread * spread).sum(axis=0)[few]
    goal = np.concatenate([forces.T.ravel()[rows], goal])
    solution = np.linalg.solve(saddle, goal)
    acceleration = np.zeros(d * count, solution.dtype)
    acceleration[rows] = solution[: len(rows)]
    lam = np.zeros(bars, solution.dtype)
    lam[few] = solution[len(rows) :]
    if len(few) < bars and not np.iscomplexobj(J):
        lam = np.linalg.lstsq(J.T, J[few].T @ lam[few], rcond=1e-9)[0]
    return acceleration.reshape(count, d).T, lam


@lru_cache(maxsize=4)
def _constants(structure):
    """Return the free rows, the incidence of bars, the free mass matrix and independent bars.

    Of redundant bars, those of the largest independent set in the structure's own shape.
    """
    rows, along_bars = free_rows(structure), _incidence(structure.bars, structure.nodes.shape[1])
    M = np.kron(consistent_mass(structure), np.eye(len(structure.nodes)))[np.ix_(rows, rows)]
    return rows, along_bars, M, independent_bars(structure)


def independent_bars(structure):
    """Return the largest set of bars whose lengths are independent in the structure's shape.

    Bars are compared as unit vectors in the metric of the masses, so that light bars beside heavy
    ones count as much; those between supports are left out.
    """
    d, count = structure.nodes.shape
    rows, along_bars = free_rows(structure), _incidence(structure.bars, count)
    M = np.kron(consistent_mass(structure), np.eye(d))[np.ix_(rows, rows)]
    jacobian = along_bars[:, :, None] * (along_bars @ structure.nodes.T)[:, None, :]
    J = jacobian.reshape(len(along_bars), d * count)[:, rows]
    if not J.any():
        return np.arange(0)
    scaled = np.linalg.solve(np.linalg.cholesky(M), J.T)
    length = np.linalg.norm(scaled, axis=0)
    _, R, order = qr(scaled / np.where(length > 0, length, 1.0), mode="economic", pivoting=True)
    return np.sort(order[: np.count_nonzero(np.abs(np.diag(R)) > 1e-9)])


def free_rows(structure):
    """Return the rows of ``vec(N)`` that supports leave free, one node after the other."""
    d, count = structure.nodes.shape
    held = {d * node + axis for node in structure.fixed.tolist() for axis in range(d)}
    held |= {d * node + "xyz".index(axis) for node, axis in structure.rollers}
    return np.array([row for row in range(d * count) if row not in held], dtype=int)


@lru_cache(maxsize=4)
def _segments(structure):
    """Return the incidence of segments, the sums over each string, and what is straight."""
    first, pairs = segment_pairs(structure)
    string = np.repeat(np.arange(len(first) - 1), np.diff(first))
    sums = np.zeros((len(first) - 1, len(pairs)))
    sums[string, np.arange(len(pairs))] = 1.0
    straight = sums.sum(axis=1)[string] == 1
    return _incidence(pairs, structure.nodes.shape[1]), sums, string, straight


def segment_pairs(structure):
    """Return the first segment of each string, and one past the last, and the ends of segments."""
    paths = structure.paths or structure.strings.tolist()
    pairs = [pair for path in paths for pair in pairwise(path)]
    first = np.cumsum([0, *(len(path) - 1 for path in paths)])
    return first, np.array(pairs, dtype=int).reshape(-1, 2)


def string_forces(structure, nodes, force_density):
    """Return the forces of the strings on the nodes, shape (d, n), from γ = T/L of each."""
    incidence, sums, string, straight = _segments(structure)
    S = nodes @ incidence.T
    gamma = force_density[string]
    if not straight.all():  # one tension all along; a straight string may have no length
        each = np.where(straight, 1.0, np.sqrt((S * S).sum(axis=0)))
        gamma = gamma * (sums @ each)[string] / each
    return -(gamma * S) @ incidence


def string_motion(structure, nodes, velocities):
    """Return the length of each string and its rate, of all its segments together."""
    incidence, sums, *_ = _segments(structure)
    S, Sd = nodes @ incidence.T, velocities @ incidence.T
    each = np.sqrt((S * S).sum(axis=0))
    return sums @ each, sums @ ((S * Sd).sum(axis=0) / each)


def consistent_mass(structure):
    """Return the mass matrix (n, n), kg: a bar's mass at the two Gauss points of its length.

    That rule is exact for the square of a field that is linear along the bar.
    """
    count = structure.nodes.shape[1]
    M = np.zeros((count, count))
    for place in (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)):
        weights = np.zeros((len(structure.bars), count))
        every = np.arange(len(structure.bars))
        weights[every, structure.bars[:, 0]] = 1 - place
        weights[every, structure.bars[:, 1]] = place
        M += weights.T @ (0.5 * structure.bar_mass[:, None] * weights)
    return M + np.diag(structure.point_mass)


def state_jacobians(structure, nodes, velocities, law, held, size=1e-30):
    """Return ∂ẋ/∂x and ∂ẋ/∂u by complex steps, all strings taken to pull.

    Of the coordinates that supports leave free. ``law(u)`` returns one of the held laws above for
    the held values u.
    """
    d, count = nodes.shape
    rows = free_rows(structure)
    rows = np.concatenate([rows, d * count + rows])
    at = np.concatenate([nodes.T.ravel(), velocities.T.ravel()])

    def slope(x, u):
        every = at.astype(complex)
        every[rows] = x
        return NodeMotion(structure, law(u)).slope(every, True)[rows]

    x = at[rows]
    by_state = [slope(x + 1j * size * step, held + 0j).imag / size for step in np.eye(len(x))]
    by_input = [slope(x + 0j, held + 1j * size * step).imag / size for step in np.eye(len(held))]
    return np.column_stack(by_state), np.column_stack(by_input)


def _incidence(pairs, count):
    incidence = np.zeros((len(pairs), count))
    every = np.arange(len(pairs))
    incidence[every, pairs[:, 0]], incidence[every, pairs[:, 1]] = -1.0, 1.0
    return incidence


def truss_stiffness(structure, gamma, bar_gamma, string_stiffness, axial_rigidity):
    """Stiffness, shape (d n, d n), of bars and strings as elastic elements with their forces."""
    d, n = structure.nodes.shape
    K = np.zeros((d * n, d * n))
    axial = np.concatenate([string_stiffness, axial_rigidity / structure.bar_length])
    density = np.concatenate([gamma, -bar_gamma])
    for (i, j), k, g in zip(
        np.vstack([structure.strings, structure.bars]), axial, density, strict=True
    ):
        u = structure.nodes[:, j] - structure.nodes[:, i]
        u = u / np.linalg.norm(u)
        block = g * (np.eye(d) - np.outer(u, u)) + k * np.outer(u, u)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            K[d * a : d * a + d, d * b : d * b + d] += sign * block
    return K
