"""Scales of a motion, against which errors are measured."""

from __future__ import annotations

import numpy as np

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.validation import FloatArray

# Iterations of the power method, and the step of its finite differences as part of the size.
_POWER_ITERATIONS, _DIFFERENCE = 60, 1e-6


def state_scale(
    equation: Equation, state: FloatArray, held: FloatArray, frequency: float
) -> FloatArray:
    """Return the size of each entry of the state, shape (states,).

    For positions it is the length of the longest bar or string; for velocities
    the larger of the fastest node's and the speed that the forces at the start
    give the whole structure over its own size, but a thousandth of what the
    fastest vibration of that size would have at least. So the answer does not
    change with units or place. An equation that is no structure's has the entry
    itself and 1.

    Parameters
    ----------
    equation : Equation
    state : ndarray, shape (states,)
    held : ndarray, shape (inputs,)
    frequency : float
        From :func:`largest_frequency`, rad/s.
    """
    structure, force = equation.structure, equation.force
    if structure is None or force is None:
        return 1 + np.abs(state)
    q, v = np.split(state, 2)
    taut = (np.array(equation.gap(state, held)[0]) > 0).astype(float)
    forces = np.abs(np.array(force(q, v, held, taut))).max(initial=0.0)
    nodes = structure.nodes
    members = np.vstack([structure.bars, structure.strings])
    size = np.linalg.norm(nodes[:, members[:, 1]] - nodes[:, members[:, 0]], axis=0).max()
    mass = structure.bar_mass.sum() + structure.string_node_mass.sum()
    speeds = (np.abs(v).max(initial=0.0), np.sqrt(forces * size / mass), 1e-3 * size * frequency)
    # Where nothing moves and nothing pulls, any speed will do.
    return np.repeat([size, max(speeds) or size], len(q))


class Frequency:
    """The largest frequency of a motion whose input changes now and then.

    Found again only where an input has changed by more than a fifth.
    """

    def __init__(self, equation: Equation) -> None:
        self._equation = equation
        self._held: FloatArray | None = None
        self._found = 0.0

    def __call__(self, state: FloatArray, held: FloatArray) -> float:
        """Return it for a state and what is held, rad/s."""
        if self._held is None or (np.abs(held - self._held) > 0.2 * np.abs(self._held)).any():
            self._found, self._held = largest_frequency(self._equation, state, held), held.copy()
        return self._found


def largest_frequency(equation: Equation, state: FloatArray, held: FloatArray) -> float:
    """Return the largest frequency of small motions about a state with all strings taut, rad/s.

    By power iteration on the derivative of the accelerations with respect to
    the positions: its largest eigenvalue is -ω².

    Parameters
    ----------
    equation : Equation
    state : ndarray, shape (states,)
    held : ndarray, shape (inputs,)

    Returns
    -------
    float
        0 for an equation that is no structure's.
    """
    if equation.structure is None:
        return 0.0
    n = equation.states // 2
    q, v = np.split(state, 2)
    size = float(np.abs(q - q.mean()).max()) or 1.0
    slope, taut = Evaluator(equation.slope), np.ones(equation.switches)

    def moved(direction: FloatArray) -> FloatArray:
        x = np.concatenate([q + _DIFFERENCE * size * direction, v])
        return slope(x, held, taut)[0][n:].copy()

    vector: FloatArray = np.random.default_rng(0).standard_normal(n)
    square = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_POWER_ITERATIONS):
            vector = vector / np.linalg.norm(vector)
            vector = (moved(vector) - moved(-vector)) / (2 * _DIFFERENCE * size)
            square = float(np.linalg.norm(vector))
            if not np.isfinite(square) or square == 0.0:
                break
        return float(np.sqrt(square))
