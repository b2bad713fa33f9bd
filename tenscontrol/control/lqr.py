"""Linear-quadratic regulator."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.command import Command
from tenscontrol.control.controller import (
    Controller,
    warn_of_unreached,
)
from tenscontrol.plant.controllability import refuse_empty, refuse_unreachable, ways
from tenscontrol.plant.input_bounds import input_bounds, largest_change
from tenscontrol.plant.linear_plant import NO_JUMP, LinearPlant, named_system, sampled
from tenscontrol.plant.riccati import cross_weight, natural_weights, regulator
from tenscontrol.status import Status
from tenscontrol.warn import warn

# Names of inputs that a warning lists.
_LISTED = 3


@final
class LQR(Controller):
    """Linear-quadratic regulator: the feedback that minimizes ``∫ zᵀ Q z + vᵀ R v + 2 zᵀ N v dt``.

    The command is ``u = u₀ − K z``, clipped to the bounds. With a ramp input, the state at the end
    of a sample depends on the previous input too: ``u = u₀ − K z − H (u_previous − u₀)``.

    The status is ``"saturated"`` where the desired input is out of bounds, or differs from the
    previous input (:meth:`applied`) by more than ``max_change``. If the structure cannot have the
    measured shape, the command is γ of the operating point, or the previous rest lengths.

    Parameters
    ----------
    plant : LinearPlant
        In ``"internal"`` coordinates. ``"nodes"`` and ``"minimal"`` coordinates include the
        rigid-body motions of free structures, which no string controls. Modes that no string
        reaches and that do not grow are left uncontrolled: :attr:`left_alone`.
    Q : float or array_like, shape (2r,) or (2r, 2r), optional
        Weight of the state, positive semidefinite. The state is ``z = [q; q̇]``. If not given, that
        of :func:`energy_weights`, by mode where the input is the rest length, as for :class:`MPC`.
    R : float or array_like, shape (m,) or (m, m), optional
        Weight of the input, positive definite. If not given, that of :func:`energy_weights`; a
        tenth of it for γ.
    N : array_like, shape (2r, m), optional
        Cross weight of state and input, as of ``control.lqr``; none if not given. ``Q − N R⁻¹ Nᵀ``
        must be positive semidefinite.
    sample_time : float, optional
        Time between two commands, s. With it the plant is discretized exactly, and the sum
        over samples is minimized in place of the integral.
    max_force_density : float or array_like, shape (α,), optional
        Largest force density γ commanded, N/m; only for a plant with γ as the input. The
        least is 0 always.
    max_change : float or array_like, shape (α,), optional
        Largest change of the command from sample to sample, N/m or m.
    winches : Winches, optional
        Speed and range that bound rest lengths. The feedback is designed for how they move, by
        their ``substeps``: a jump at the start of a sample, or a ramp over it.

    Attributes
    ----------
    gain : ndarray, shape (m, 2r)
        K.
    previous_input_gain : ndarray, shape (m, m), or None
        H, for a ramp input.
    poles : ndarray of complex, shape (2r,)
        Closed-loop poles: of the s-plane, 1/s, or with a sample time of the z-plane. For a ramp
        input there are 2r + m. Those of uncontrolled modes come last.
    cost : ndarray, shape (2r, 2r)
        Solution P of the Riccati equation: ``zᵀ P z`` is the cost to go. For a ramp input, of
        ``[z; u_previous − u₀]``. The cost of uncontrolled modes themselves is left out: no input
        changes it, and it is infinite for undamped modes.
    riccati_residual : float
        Residual of the Riccati equation relative to its largest term.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit; if no string reaches a motion that grows or drifts (the
        message says which and what to do); if the solution of the Riccati
        equation fails the check of its residual and poles.

    Warns
    -----
    RuntimeWarning
        If no string reaches a mode that does not decay, naming it. If an input is at a bound at the
        operating point, as a driven string with γ = 0: the poles are those of inputs that go both
        ways, and this one cannot.

    Notes
    -----
    The Riccati equation is solved by doubling. SciPy solves continuous ones of up to 100 states,
    and those in which Q has no weight on growing states. The solution is checked, as it can be
    wrong without an error if an undamped mode is not controllable. It covers the controllable
    states. The gain on the others is a feedforward from a Sylvester equation: zero if they neither
    disturb the controllable states nor share a weight with them.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> regulator = tc.LQR(plant, Q=1.0, R=1e-3)
    >>> regulator.gain.shape, bool(regulator.poles.real.max() < 0)
    ((9, 18), True)
    """

    def __init__(
        self,
        plant: LinearPlant,
        Q: object = None,
        R: object = None,
        N: object = None,
        *,
        sample_time: float | None = None,
        max_force_density: object = None,
        max_change: object = None,
        winches: Winches | None = None,
    ) -> None:
        validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        states, inputs = plant.B.shape
        refuse_empty(plant)
        if plant.drives_bars and sample_time is None:
            raise ValueError(NO_JUMP)
        if Q is None or R is None:
            natural_Q, natural_R = natural_weights(plant)
            Q = natural_Q if Q is None else Q
            R = natural_R if R is None else R
        state_weight = validation.weight_matrix("Q", Q, states, definite=False)
        input_weight = validation.weight("R", R, inputs, definite=True)
        cross = cross_weight(N, state_weight, input_weight)
        if sample_time is not None:
            sample_time = validation.positive_number("sample_time", sample_time, "s")
        bounds = input_bounds(plant, max_force_density, winches)
        change = largest_change(plant.input, plant.actuation, max_change, winches, sample_time)
        if sample_time is None and winches is not None and winches.ramp:
            raise ValueError(
                f"winches.substeps is {winches.substeps}: rest lengths are ramps over samples, so "
                "give sample_time, s"
            )
        refuse_unreachable(plant)

        if sample_time is None:
            A, B = plant.A, plant.B
        else:
            A, B = sampled(plant, sample_time, winches is not None and winches.ramp).augmented
        _, (gain, poles, cost, residual) = regulator(
            plant, A, B, state_weight, input_weight, sample_time is not None, cross
        )
        super().__init__(plant, sample_time, *bounds, change)
        warn_of_unreached(self)
        ramp = gain.shape[1] > states
        self.gain = frozen(gain[:, :states])
        self._settings = {"gain": self.gain}
        self.previous_input_gain = frozen(gain[:, states:]) if ramp else None
        self.poles = frozen(poles)
        self.cost = frozen(cost)
        self.riccati_residual = residual
        self._warn_of_bounds()

    def _warn_of_bounds(self) -> None:
        """Warn of inputs that the law uses, and that can go one way only."""
        rises, falls = ways(self.plant, *self.bounds)
        at_bound = ~(rises & falls) & self.gain.any(axis=1)
        names = [self.plant.input_names[i] for i in np.flatnonzero(at_bound)]
        if not names:
            return
        more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        warn(
            f"{', '.join(names[:_LISTED])}{more} {'are' if len(names) > 1 else 'is'} at a bound at "
            "the operating point, and can go one way only: the poles of this LQR are those of "
            "inputs that go both ways, and the loop can be unstable. Leave such strings out by "
            "linearize(..., actuated=[...]), tighten them, or take MPC, which knows bounds",
            RuntimeWarning,
        )

    def to_statespace(self) -> Any:
        """Return the law as a ``control.StateSpace`` from z to v, in a loop with the sign of +.

        It is a gain or, for a ramp input, has the previous input as its state. Close the loop by
        ``control.feedback(plant.to_statespace(dt, outputs="state"), law, sign=1)``.

        Returns
        -------
        control.StateSpace
            Continuous, or with the sample time as its ``dt``, s. Bounds are left out.

        Examples
        --------
        >>> import control, numpy as np, tenscontrol as tc
        >>> prism = tc.prism()
        >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
        >>> regulator = tc.LQR(plant, sample_time=0.01)
        >>> system = plant.to_statespace(0.01, outputs="state")
        >>> loop = control.feedback(system, regulator.to_statespace(), sign=1)
        >>> poles = (np.sort(abs(each)) for each in (loop.poles(), regulator.poles))
        >>> bool(np.allclose(*poles))
        True
        """
        plant, K, H = self.plant, self.gain, self.previous_input_gain
        if H is None:
            nothing = np.zeros((0, 0)), np.zeros((0, K.shape[1])), np.zeros((len(K), 0))
            return named_system(
                (*nothing, -K), self.sample_time, "LQR",
                inputs=plant.state_names, outputs=plant.input_names,
            )  # fmt: skip
        return named_system(
            (-H, -K, -H, -K), self.sample_time, "LQR", inputs=plant.state_names,
            outputs=plant.input_names, states=[f"previous_{name}" for name in plant.input_names],
        )  # fmt: skip

    def reference_nodes(self, times: FloatArray) -> FloatArray:
        """See :meth:`Controller.reference_nodes`: the operating point."""
        return np.repeat(self.plant.nodes[:, :, None], len(times), axis=2)

    def _decide(self, time: float, state: FloatArray) -> Command:
        equilibrium = self.plant.equilibrium_input
        desired = equilibrium - self.gain @ state
        if self.previous_input_gain is not None and self._previous_input is not None:
            desired -= self.previous_input_gain @ (self._previous_input - equilibrium)
        reached = np.array_equal(self._within_bounds(desired), desired)
        return Command(desired, Status.OK if reached else Status.SATURATED)

    def __repr__(self) -> str:
        kind = "continuous" if self.sample_time is None else f"every {self.sample_time:g} s"
        return f"LQR({self.plant!r}, {kind})"
