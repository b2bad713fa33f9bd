"""The linear-quadratic regulator, checked before and after."""

from __future__ import annotations

from typing import final

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control.controller import Command, Controller
from tenscontrol.control.input_bounds import input_bounds, largest_change
from tenscontrol.control.status import Status
from tenscontrol.control.weights import energy_weights, weight_matrix
from tenscontrol.dynamics import coordinates
from tenscontrol.plant import LinearPlant, controllability, lost_poles, sampled
from tenscontrol.validation import FloatArray, frozen, instance, positive_number

# A Riccati residual above this fraction of its terms means that the solution is wrong.
_RESIDUAL_TOLERANCE = 1e-6


@final
class LQR(Controller):
    """The state feedback ``u = u₀ − K z``, kept within bounds. Made by :func:`lqr`.

    Winches that wind through a sample start where they stand, which is fed back too:
    ``u = u₀ − K z − H (u_held − u₀)``.

    Where the wish is beyond the bounds, or farther from what the actuators hold
    (:meth:`applied`) than a change may be, the status is ``"saturated"``. Without a
    measurement that the structure can have, γ of the operating point is commanded,
    or the rest lengths that stand.

    Attributes
    ----------
    gain : ndarray, shape (α, 2r)
        K.
    held_gain : ndarray, shape (α, α), or None
        H, where winches wind.
    poles : ndarray of complex, shape (2r,)
        Closed-loop poles: of the s-plane, 1/s, or with a sample time of the z-plane. Where
        winches wind, 2r + α of them.
    cost : ndarray, shape (2r, 2r)
        Solution P of the Riccati equation: ``zᵀ P z`` is the cost to go. Where winches wind, of
        ``[z; u_held − u₀]``.
    riccati_residual : float
        Residual of the Riccati equation relative to its largest term.
    """

    def __init__(
        self,
        plant: LinearPlant,
        sample_time: float | None,
        bounds: tuple[FloatArray, FloatArray],
        gain: FloatArray,
        poles: np.ndarray,
        cost: FloatArray,
        riccati_residual: float,
        change: FloatArray | None,
    ) -> None:
        super().__init__(plant, sample_time, *bounds, change)
        states = len(plant.A)
        ramp = gain.shape[1] > states
        self.gain = frozen(gain[:, :states])
        self.held_gain = frozen(gain[:, states:]) if ramp else None
        self.poles = frozen(poles)
        self.cost = frozen(cost)
        self.riccati_residual = riccati_residual

    def reset(self) -> None:
        """Forget what the actuators hold: the feedback remembers nothing else."""
        super().reset()

    def _decide(self, time: float, state: FloatArray) -> Command:
        wish = self.plant.equilibrium_input - self.gain @ state
        if self.held_gain is not None and self._previous_input is not None:
            wish -= self.held_gain @ (self._previous_input - self.plant.equilibrium_input)
        reached = np.array_equal(self._within_reach(wish), wish)
        return Command(wish, Status.OK if reached else Status.SATURATED)

    def _fall_back(self, status: Status) -> Command:
        return self._hold(status)

    def __repr__(self) -> str:
        kind = "continuous" if self.sample_time is None else f"every {self.sample_time:g} s"
        return f"LQR({self.plant!r}, {kind})"


def lqr(
    plant: LinearPlant,
    Q: object = None,
    R: object = None,
    *,
    sample_time: float | None = None,
    max_force_density: object = None,
    max_change: object = None,
    winches: Winches | None = None,
) -> LQR:
    """Return the feedback that minimizes ``∫ zᵀ Q z + vᵀ R v dt``.

    Parameters
    ----------
    plant : LinearPlant
        In ``"internal"`` coordinates; ``"nodes"`` and ``"minimal"`` have
        states that no string reaches.
    Q : float or array_like, shape (2r,) or (2r, 2r), optional
        Weight of the state ``z = [q; q̇]``, positive semidefinite. If not given, that of
        :func:`energy_weights`.
    R : float or array_like, shape (α,) or (α, α), optional
        Weight of the input, positive definite. If not given, that of :func:`energy_weights`.
    sample_time : float, optional
        Sample time, s. With it the plant is discretized exactly, and the sum
        over samples is minimized in place of the integral.
    max_force_density : float or array_like, shape (α,), optional
        Largest γ commanded, N/m; only for a plant with γ as the input. The
        least is 0 always.
    max_change : float or array_like, shape (α,), optional
        Largest change of the command from sample to sample, N/m or m.
    winches : Winches, optional
        Speed and range that bound rest lengths. The feedback is designed for how they move, by
        their ``substeps``: with a jump at the start of a sample, or winding through it.

    Returns
    -------
    LQR

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit; if an unstable pole cannot be reached (the
        message says which and what to do); if the solution of the Riccati
        equation does not stand the check of its residual and poles.

    Notes
    -----
    The Riccati equation is solved by python-control. Its answer is checked,
    since it can be wrong without a word where an undamped mode is out of reach.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> regulator = tc.lqr(plant, Q=1.0, R=1e-3)
    >>> regulator.gain.shape, bool(regulator.poles.real.max() < 0)
    ((9, 18), True)
    """
    instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    states, inputs = plant.B.shape
    refuse_empty(plant)
    if Q is None or R is None:
        natural = energy_weights(plant)
        Q, R = (own if given is None else given for own, given in zip(natural, (Q, R), strict=True))
    state_weight = weight_matrix("Q", Q, states, definite=False)
    input_weight = weight_matrix("R", R, inputs, definite=True)
    if winches is not None:
        instance("winches", winches, Winches, "make them by Winches(rate=...)")
    if sample_time is not None:
        sample_time = positive_number("sample_time", sample_time, "s")
    bounds = input_bounds(plant, max_force_density, winches)
    change = largest_change(plant, max_change, winches, sample_time)
    if sample_time is None and winches is not None and winches.substeps > 1:
        raise ValueError(
            f"winches.substeps is {winches.substeps}: they wind through samples, so "
            "give sample_time, s"
        )
    refuse_unreachable(plant)

    units, level = state_units(plant)
    if sample_time is None:
        A, B = plant.A, plant.B
    else:
        A, B = sampled(plant, sample_time, 1 if winches is None else winches.substeps).augmented
    held = len(A) - states  # entries of what winches hold, where they wind: without a weight
    state_weight = np.pad(state_weight, (0, held))
    units = np.concatenate([units, np.full(held, level)])
    feedback = regulate(A, B, state_weight, input_weight, units, level, sample_time is not None)
    return LQR(plant, sample_time, bounds, *feedback, change)


def regulate(
    A: FloatArray,
    B: FloatArray,
    state_weight: FloatArray,
    input_weight: FloatArray,
    unit: FloatArray,
    level: float,
    discrete: bool,
) -> tuple[FloatArray, np.ndarray, FloatArray, float]:
    """Return gain, poles, cost and Riccati residual of the regulator, checked.

    Solved with states and inputs in units of the same energy: a stiff plant is out of reach else.

    Parameters
    ----------
    A, B : ndarray, shapes (s, s) and (s, α)
    state_weight, input_weight : ndarray, shapes (s, s) and (α, α)
        Q and R.
    unit : ndarray, shape (s,)
        Units of the states.
    level : float
        Unit of the inputs.
    discrete : bool
        Whether A and B are of samples.
    """
    import control

    scaled = (
        A * unit / unit[:, None],
        level * B / unit[:, None],
        unit[:, None] * state_weight * unit,
        level**2 * input_weight,
    )
    try:
        K, P, poles = (control.dlqr if discrete else control.lqr)(*scaled)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ValueError(
            f"the Riccati equation has no stabilizing solution: {error}. An undamped mode without "
            "weight in Q is one reason; weights that differ by many powers of ten are another"
        ) from error
    residual = _riccati_residual(*scaled, P, discrete=discrete)
    _refuse_bad_solution(poles, residual, discrete=discrete)
    return level * K / unit, poles, P / unit[:, None] / unit, residual


def state_units(plant: LinearPlant) -> tuple[FloatArray, float]:
    """Return units of the state, shape (s,), and of the input: of one speed and acceleration."""
    r = plant.degrees_of_freedom
    highest = float(np.abs(np.linalg.eigvals(plant.A)).max(initial=0.0)) or 1.0
    push = float(np.linalg.norm(plant.B, 2)) or 1.0
    return frozen(np.r_[np.full(r, 1 / highest), np.ones(r)]), highest / push


def _riccati_residual(
    A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, P: FloatArray, discrete: bool
) -> float:
    if discrete:
        PB = A.T @ P @ B
        terms = [A.T @ P @ A, -P, -PB @ np.linalg.solve(R + B.T @ P @ B, PB.T), Q]
    else:
        PB = P @ B
        terms = [A.T @ P, P @ A, -PB @ np.linalg.solve(R, PB.T), Q]
    largest = max(float(np.linalg.norm(term)) for term in terms)
    return float(np.linalg.norm(sum(terms))) / max(largest, 1e-300)


def _refuse_bad_solution(poles: np.ndarray, residual: float, discrete: bool) -> None:
    if not residual <= _RESIDUAL_TOLERANCE:
        raise ValueError(
            f"the Riccati equation is left with a residual of {residual:.1e}, expected at most "
            f"{_RESIDUAL_TOLERANCE:.0e}: its solution is not to be trusted. Bring the weights "
            "Q and R closer together"
        )
    margin = float(1 - np.abs(poles).max()) if discrete else float(-poles.real.max())
    if not margin > 0:
        raise ValueError(
            f"the closed loop is not stable by {-margin:.1e}. Give every mode some weight in Q"
        )


def refuse_empty(plant: LinearPlant) -> None:
    """Raise if there is nothing to control."""
    states, inputs = plant.B.shape
    if states == 0 or inputs == 0:
        raise ValueError(
            f"plant has {states} states and {inputs} inputs, so there is nothing to control"
        )


def refuse_unreachable(plant: LinearPlant) -> None:
    """Raise if a pole that does not decay is out of reach, saying which and what to do."""
    lost = lost_poles(plant)
    if len(lost) == 0:
        return
    kind, unreachable = plant.coordinates.kind, controllability(plant).unreachable
    counts = {
        each: coordinates(plant.model, plant.nodes, each).count
        for each in ("nodes", "minimal", "internal")
    }
    what = []
    if kind == "nodes":
        what.append(
            (2 * (counts["nodes"] - counts["minimal"]), "are lengths of bars and their rates")
        )
    if kind != "internal":
        rigid = 2 * (counts["minimal"] - counts["internal"])
        what.append((rigid, "are motions of the structure as one body"))
    inner = unreachable - sum(count for count, _ in what)
    if inner:
        poles = ", ".join(f"{pole:.4g}" for pole in lost)
        what.append((inner, f"are changes of shape, at the poles {poles} 1/s"))
    advice = (
        "Damping, other strings or another prestress would mend that; controllability(plant) "
        "says more"
        if inner
        else "Internal forces change neither: linearize with coordinates='internal'"
    )
    listed = " and ".join(f"{count} {meaning}" for count, meaning in what if count)
    raise ValueError(
        f"{unreachable} of the {len(plant.A)} states of the plant in {kind!r} coordinates are out "
        f"of reach of the strings, and do not decay by themselves: {listed}. {advice}"
    )
