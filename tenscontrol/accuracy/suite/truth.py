"""The true motion of a case, with its own error and how far it can be compared with others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.accuracy.suite.extreme import ASKED, Extreme
from tenscontrol.dynamics import pack_state, unpack_states
from tenscontrol.integrate import CVODES, DOP853, EnergyMomentum, Integrator, Rattle6
from tenscontrol.structure import restore_bar_lengths
from tenscontrol.validation import FloatArray, frozen

# Perturbation of the start, as part of the size: far above round-off, and small to the end.
_PERTURBATION = 1e-10

# What round-off amounts to, as part of the size.
_ROUND_OFF = 1e-13

# The two computations must agree to this part of what is asked.
_AGREE = 0.1

# Beyond so many radians of the fastest motion the truth is computed by an implicit method first.
_EXPLICIT = 2.1e4


@dataclass(frozen=True, eq=False)
class Truth:
    """The true motion, by a closed form or computed twice.

    Attributes
    ----------
    nodes : ndarray, shape (3, n, T)
        At the times of the case, m.
    error : float
        Largest distance of a node between the two computations, by the size,
        up to where they are compared.
    growth : ndarray, shape (T,)
        How much a perturbation of the start has grown up to each time.
    outputs : int
        Number of times at which the truth is known well enough.
    how : str
        Where it is from.
    """

    nodes: FloatArray
    error: float
    growth: FloatArray
    outputs: int
    how: str

    def comparable(self, error: float) -> int:
        """Return at how many times a run that makes this error can be compared.

        Up to where the error, grown as a perturbation of the start grows, is
        the error asked for: no run that makes such errors can be right for longer.

        Parameters
        ----------
        error : float
            As part of the size.

        Returns
        -------
        int
        """
        # Errors near what is asked are compared until they have grown tenfold.
        counted = min(max(error, _ROUND_OFF), 0.1 * ASKED)
        within = self.growth[: self.outputs] * counted <= ASKED
        return self.outputs if within.all() else int(np.argmin(within))


def truth(extreme: Extreme) -> Truth:
    """Return the true motion of a case.

    Parameters
    ----------
    extreme : Extreme

    Returns
    -------
    Truth

    Raises
    ------
    ArithmeticError
        If the motion runs away.
    """
    times = extreme.time
    if extreme.closed_form is not None:
        known = extreme.closed_form(times)
        return Truth(frozen(known), 0.0, frozen(np.ones(len(times))), len(times), "closed form")
    main, other, how = _methods(extreme)
    state = extreme.case.state
    first, second = _nodes(extreme, main, state), _nodes(extreme, other, state)
    pushed = _nodes(extreme, main, state + _push(extreme))
    growth = _apart(extreme, pushed, first) / _PERTURBATION
    apart = _apart(extreme, first, second)
    good = (growth * _ROUND_OFF <= ASKED) & (apart <= _AGREE * ASKED)
    outputs = len(times) if good.all() else int(np.argmin(good))
    error = float(apart[outputs - 1]) if outputs else float(apart[0])
    return Truth(frozen(first), error, frozen(np.maximum(growth, 1.0)), outputs, how)


def _methods(extreme: Extreme) -> tuple[Integrator, Integrator, str]:
    """Return two methods that have little in common."""
    equation = extreme.case.equation()
    if extreme.angle > _EXPLICIT:
        return (
            EnergyMomentum(equation, step=2.5e-4 * extreme.case.duration),
            DOP853(equation, 1e-9, project=True),
            "energy_momentum in 4000 steps, dop853 at 1e-9",
        )
    main = DOP853(equation, 1e-12, project=True)
    if equation.velocity_dependent:
        return main, CVODES(equation, 1e-11, project=True), "dop853 at 1e-12, cvodes at 1e-11"
    step = 0.3 / extreme.frequency
    return main, Rattle6(equation, step), f"dop853 at 1e-12, rattle6 at {step:.1e} s"


def _nodes(extreme: Extreme, integrator: Integrator, state: FloatArray) -> FloatArray:
    case = extreme.case
    span = integrator.advance(state, case.value, case.duration, extreme.outputs)
    return unpack_states(case.structure, span.states)[0]


def _apart(extreme: Extreme, nodes: FloatArray, others: FloatArray) -> FloatArray:
    """Return the largest distance of a node up to each time, by the size."""
    far = np.linalg.norm(nodes - others, axis=0).max(axis=0)
    return np.asarray(np.maximum.accumulate(far) / extreme.case.size)


def _push(extreme: Extreme) -> FloatArray:
    """Return a small change of the state that stretches no bar."""
    case, structure = extreme.case, extreme.case.structure
    moves = np.random.default_rng(0).standard_normal(case.nodes.shape)
    moves[:, structure.fixed] = 0.0
    moves *= _PERTURBATION * case.size / np.linalg.norm(moves, axis=0).max()
    # Both restored, so that a bar off by round-off in the case does not count as perturbed.
    moved = restore_bar_lengths(structure, case.nodes + moves)
    change = moved - restore_bar_lengths(structure, case.nodes)
    return pack_state(structure, change, np.zeros_like(change))
