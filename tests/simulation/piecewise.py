"""An independent oracle for what changes in time, in NumPy: it ends at each kink and switch."""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from tests.oracle import consistent_mass, free_rows, string_forces, string_motion

# Strings switch as far beyond the border, m: one that has switched does not switch back at once.
BAND = 1e-12


def constant(value):
    """What has a value at all times."""
    return lambda t: value


class Moving:
    """Lagrange's equations of the first kind over all nodes, those of supports prescribed.

    Rest lengths, loads and the displacement of supports are functions of time; of the last also its
    rate and its acceleration. States are positions and velocities of the free coordinates, as they
    are in space.
    """

    def __init__(self, structure, stiffness, rest, damping=0.0, load=None, supports=None):
        self.structure, self.stiffness, self.damping = structure, stiffness, damping
        self.rest = rest
        self.load = constant(0.0) if load is None else load
        still = constant(np.zeros((structure.dimension, len(structure.fixed))))
        self.supports = (still, still, still) if supports is None else supports
        d, n = structure.nodes.shape
        self.rows = free_rows(structure)
        self.held = np.setdiff1d(np.arange(d * n), self.rows)
        self.mass = np.kron(consistent_mass(structure), np.eye(d))
        self.redundant = None  # whether bars are, found with the first accelerations
        bars = len(structure.bars)
        self.bars = np.zeros((bars, n))
        self.bars[np.arange(bars), structure.bars[:, 0]] = -1.0
        self.bars[np.arange(bars), structure.bars[:, 1]] = 1.0

    def all_nodes(self, t, state):
        """Positions and velocities of all nodes, shape (d, n) each."""
        N, V = self.structure.nodes.copy(), np.zeros_like(self.structure.nodes)
        N[:, self.structure.fixed] += self.supports[0](t)
        V[:, self.structure.fixed] = self.supports[1](t)
        flat = [part.ravel(order="F") for part in (N, V)]
        for part, free in zip(flat, np.split(state, 2), strict=True):
            part[self.rows] = free
        return [part.reshape(N.shape, order="F") for part in flat]

    def solved(self, N, forces, goal, known):
        """Accelerations of the free coordinates, those of supports known, shape (d, n)."""
        d, n = N.shape
        J = (self.bars[:, :, None] * (self.bars @ N.T)[:, None, :]).reshape(len(self.bars), d * n)
        rows, held = self.rows, self.held
        moved = np.abs(J[:, rows]).max(axis=1, initial=0.0) > 0  # others are part of the support
        J, goal = J[moved], goal[moved]
        known = known.ravel(order="F")[held]
        M, Jf = self.mass[np.ix_(rows, rows)], J[:, rows]
        saddle = np.block([[M, -Jf.T], [Jf, np.zeros((len(J), len(J)))]])
        right = np.concatenate(
            [
                forces.ravel(order="F")[rows] - self.mass[np.ix_(rows, held)] @ known,
                goal - J[:, held] @ known,
            ]
        )
        if self.redundant is None:
            self.redundant = np.linalg.matrix_rank(saddle) < len(saddle)
        if self.redundant:
            return np.linalg.lstsq(saddle, right, rcond=1e-12)[0][: len(rows)]
        return np.linalg.solve(saddle, right)[: len(rows)]

    def slope(self, t, state, taut):
        """The state equation for strings that pull or not."""
        N, V = self.all_nodes(t, state)
        length, rate = string_motion(self.structure, N, V)
        tension = self.stiffness * (length - self.rest(t)) + self.damping * rate
        forces = string_forces(self.structure, N, taut * tension / length) + self.load(t)
        known = np.zeros_like(N)
        known[:, self.structure.fixed] = self.supports[2](t)
        spread = V @ self.bars.T
        found = self.solved(N, forces, -(spread * spread).sum(axis=0), known)
        return np.concatenate([state[len(found) :], found])

    def gap(self, t, state):
        """How far strings are from slack, m."""
        length, rate = string_motion(self.structure, *self.all_nodes(t, state))
        stretch = length - self.rest(t)
        return np.minimum(stretch, stretch + self.damping / self.stiffness * rate)

    def kicked(self, t, state, jump):
        """The state after the velocities of supports have jumped."""
        N, _ = self.all_nodes(t, state)
        known = np.zeros_like(N)
        known[:, self.structure.fixed] = jump
        change = self.solved(N, np.zeros_like(N), np.zeros(len(self.bars)), known)
        return np.concatenate([state[: len(change)], state[len(change) :] + change])

    def integrated(self, state, breaks, tolerance=1e-13):
        """The state at the last of the breaks, and how often strings have switched.

        Between breaks everything is smooth. Supports stand still before the first.
        """
        switches, speed = 0, 0.0 * self.supports[1](breaks[0])
        for start, end in pairwise(breaks):
            # Just inside, the inputs are those of this piece.
            inside = 1e-14 * max(1.0, abs(end))
            state = self.kicked(start, state, self.supports[1](start + inside) - speed)
            speed = self.supports[1](end - inside)
            time = start
            taut = (self.gap(start + inside, state) > 0).astype(float)
            while time < end - 2 * inside:

                def room(t, x, taut=taut, end=end, inside=inside):
                    return ((2 * taut - 1) * self.gap(min(t, end - inside), x)).min() + BAND

                def rate(t, x, taut=taut, end=end, inside=inside):
                    return self.slope(min(t, end - inside), x, taut)

                room.terminal, room.direction = True, -1
                found = solve_ivp(
                    rate, (time, end), state, method="DOP853", rtol=tolerance, atol=tolerance,
                    events=room,
                )  # fmt: skip
                state, time = found.y[:, -1], found.t[-1]
                if found.status == 1:
                    near = (2 * taut - 1) * self.gap(time, state)
                    out = near <= near.min() + BAND / 2
                    taut = np.where(out, 1 - taut, taut)
                    switches += int(out.sum())
        return state, switches
