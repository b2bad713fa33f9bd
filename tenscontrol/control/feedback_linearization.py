"""Feedback linearization: errors of node positions decay like those of a damped oscillator."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, log10, pi
from typing import final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.command import Command, Fallback
from tenscontrol.control.controller import Controller
from tenscontrol.control.held_loop import warn_of_slow_errors
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.control.mpc.qp_solver import QPSolution
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.plant.input_bounds import input_bounds, largest_change
from tenscontrol.plant.linear_plant import LinearPlant, refuse_driven_bars
from tenscontrol.plant.reduced_dynamics import checked_tracked, tracked_motion
from tenscontrol.plant.reference import SmoothReference, checked_reference
from tenscontrol.short_repr import short_repr
from tenscontrol.status import Status

# An acceleration off by δ leaves an error of δ/b. The law counts as reached where that is below
# this share of the size of the structure.
_REACHED = 1e-4

# A response to γ below this part of what the combinations could have is round-off.
_ROUND_OFF = 1e-12

# A γ so close to a bound, in units of the largest at the operating point, is at it.
_CLOSE = 1e-7


@dataclass(frozen=True, eq=False)
class FeedbackLinearizationStatistics:
    """Counts and residuals of the samples since the last reset.

    Attributes
    ----------
    status_count : dict of Status to int
        How often the error dynamics were reached (``Status.OK``), how often not.
    fallback_count : dict of Fallback to int
        How often each fallback was taken.
    residual : ndarray, shape (K,)
        Residual of the applied γ: largest entry of ``Ë + a Ė + b E``, m/s².
        NaN for a fallback, for which no residual is defined.
    unbounded_residual : ndarray, shape (K,)
        Residual if γ had no bounds, m/s²: above 0 where no string acts in that direction.
        NaN for a fallback too.
    at_bound : ndarray of int, shape (K,)
        Strings commanded at a bound of γ or of its change; 0 for a fallback.
    iterations : ndarray of int, shape (K,)
        OSQP iterations; 0 where no program was begun.
    """

    status_count: dict[Status, int]
    fallback_count: dict[Fallback, int]
    residual: FloatArray
    unbounded_residual: FloatArray
    at_bound: np.ndarray
    iterations: np.ndarray

    __repr__ = short_repr

    @property
    def largest_residual(self) -> float:
        """Largest residual, m/s²; zero where no sample has one."""
        return float(np.nanmax(self.residual, initial=0.0))


@final
class FeedbackLinearization(Controller):
    """Feedback linearization: the tracking error of node coordinates follows ``Ë + a Ė + b E = 0``.

    Here ``y = C vec(N)`` and ``E = y − y_ref(t)``. Node accelerations are affine in γ, so the law
    is a linear system ``J γ = d`` at each measured state, exact for the nonlinear dynamics. The
    velocity and acceleration of the reference are fed forward. The system is solved by least
    squares with ``0 ≤ γ ≤ max_force_density``. Self-stress leaves several solutions: the one
    nearest to the operating point is used. The status and
    :attr:`statistics` have the residual.

    The law does not predict, and it does not damp motions that are not tracked. Strings must be
    able to pull in every tracked direction. A mechanism responds only through its prestress, and
    leaves a residual.

    If the program is not solved, or the structure cannot have the measured shape, γ of the
    operating point is commanded.

    Parameters
    ----------
    plant : LinearPlant
        With γ as the input, in internal or minimal coordinates. Its operating point gives the
        preferred γ.
    reference : Reference or array_like, shape (d, n), or None
        Shapes to follow. They are joined by cubic splines in y, at rest at both ends. The operating
        point if None.
    sample_time : float
        Time between two commands, s. The law is exact at the samples; in between γ is held.
    max_force_density : float or array_like, shape (α,), optional
        Largest force density γ, N/m; no limit if infinite or not given.
    frequency : float
        Natural frequency of the error, Hz: ``b = (2π frequency)²``.
    damping : float
        Damping ratio ζ of the error: ``a = 4π ζ frequency``.
    tracked : array_like, shape (p, d n), optional
        Combinations of node coordinates that are tracked: C, node by node; L and R of ``E = L N R −
        Ȳ`` in one. If not given, r combinations that together are all changes of shape, in m.
    max_change : float or array_like, shape (α,), optional
        Largest change of γ from sample to sample, N/m.
    regularization : float
        Cost of force densities away from the operating point. It is that of a γ that is off by the
        largest entry there, against an acceleration off by what that γ gives; both squared.
    tolerance : float
        Absolute and relative tolerance of OSQP, in units of the largest γ.
    max_iterations : int
        Most iterations of OSQP.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or the error would grow from sample to sample:
        ``a sample_time ≥ 2`` or ``b sample_time ≥ 2 a``.

    Warns
    -----
    RuntimeWarning
        If winches, which hold rest lengths between samples, would make errors decay slower
        than at a quarter of the given rate.

    Notes
    -----
    Goyal, Majji & Skelton, *Integrating structure, information architecture and control
    design: application to tensegrity systems*. In internal coordinates positions are those of
    the shape laid over the operating point, as in :class:`OutputLimit`.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> law = tc.FeedbackLinearization(
    ...     plant, sample_time=0.02, max_force_density=80.0, frequency=1.0)
    >>> command = law.command(0.0, plant.to_nodes(np.full(9, 0.01)), np.zeros((3, 6)))
    >>> bool((command.value >= 0).all()), command.value.shape
    (True, (9,))
    >>> print(command)  # the mechanism of the prism
    error dynamics not reached: off by up to 1 m/s^2
    """

    def __init__(
        self,
        plant: LinearPlant,
        *,
        reference: object = None,
        sample_time: float,
        max_force_density: object = None,
        frequency: float,
        damping: float = 1.0,
        tracked: object = None,
        max_change: object = None,
        regularization: float = 1e-4,
        tolerance: float = 1e-7,
        max_iterations: int = 4000,
    ) -> None:
        validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        refuse_driven_bars(plant, "FeedbackLinearization")
        if plant.input != "force_density":
            raise ValueError(
                f"plant has input={plant.input!r}, in which accelerations are not affine; "
                "linearize with input='force_density'"
            )
        if not plant.actuation.is_whole:
            raise ValueError(
                f"plant has {plant.actuation!r}, but feedback linearization does not know passive "
                "or ganged strings yet: leave actuated out, or use LQR or MPC"
            )
        validation.choice("plant.coordinates.kind", plant.coordinates.kind, ("internal", "minimal"))
        sample_time = validation.positive_number("sample_time", sample_time, "s")
        low, high = input_bounds(plant, max_force_density)
        change = largest_change(plant.input, plant.actuation, max_change, None, sample_time)
        super().__init__(plant, sample_time, low, high, change)
        self._rates = error_rates(frequency, damping, sample_time)
        self._settings = {"rates": self._rates}
        matrix = _combinations(plant, tracked)
        self._tracks_part = tracked is not None
        self._motion = Evaluator(tracked_motion(plant, matrix))
        most = float(np.where(np.isinf(self._high), 1.0, self._high).max())
        self._level = float(plant.force_density.max()) or most
        response = self._tracked(plant.measure(plant.nodes, np.zeros_like(plant.nodes)))[3]
        self._unit = self._level * float(np.linalg.norm(response, 2))
        moved = plant.basis @ plant.B[plant.degrees_of_freedom :]
        most = float(np.linalg.norm(matrix, 2) * np.linalg.norm(moved, 2))
        if not np.linalg.norm(response, 2) > _ROUND_OFF * most:
            raise ValueError(
                "no string moves the tracked combinations at the operating point; expected "
                "coordinates of free nodes, relative to each other where no node is fixed"
            )
        size = float(np.ptp(plant.nodes, axis=1).max())
        self._unreached = _REACHED * size * self._rates[1]
        rows, columns = response.shape
        self._squares = BoundedLeastSquares(
            rows,
            columns,
            validation.positive_number("regularization", regularization, "no unit"),
            validation.positive_number(
                "tolerance", tolerance, "units of the largest force density"
            ),
            validation.whole_number("max_iterations", max_iterations, least=1),
        )
        self.follow(reference)
        self.reset()
        if plant.model.strings is not None:
            warn_of_slow_errors(plant, matrix, self._rates, sample_time)

    @property
    def rates(self) -> tuple[float, float]:
        """Factors a, 1/s, and b, 1/s², of the law."""
        return self._rates

    @property
    def statistics(self) -> FeedbackLinearizationStatistics:
        """Counts and residuals of the samples since the last reset."""
        table = np.array(self._records).reshape(-1, 4)
        return FeedbackLinearizationStatistics(
            status_count=self.status_count,
            fallback_count=self.fallback_count,
            residual=frozen(table[:, 0]),
            unbounded_residual=frozen(table[:, 1]),
            at_bound=frozen(table[:, 2].astype(np.int64)),
            iterations=frozen(table[:, 3].astype(np.int64)),
        )

    def follow(self, reference: object) -> None:
        """Follow another reference from now on; see :meth:`MPC.follow`."""
        given, q = checked_reference(self.plant, reference)
        values = [self._tracked(np.r_[shape, np.zeros_like(shape)])[0].copy() for shape in q]
        self._reference = SmoothReference(given.time, np.array(values))
        self._shapes = SmoothReference(given.time, q)

    def reference_nodes(self, times: FloatArray) -> FloatArray | None:
        """See :meth:`Controller.reference_nodes`: None where it tracks parts of the shape only."""
        if self._tracks_part:
            return None
        shapes = [self.plant.to_nodes(self._shapes.at(time)[0]) for time in times.tolist()]
        return np.stack(shapes, axis=-1)

    def error(
        self, time: float, nodes: object, velocities: object
    ) -> tuple[FloatArray, FloatArray]:
        """Return E, m, and Ė, m/s, of a motion, shape (p,) each.

        Parameters
        ----------
        time : float
            s.
        nodes, velocities : array_like, shape (d, n)
            m and m/s.

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit or is not finite.
        """
        y, rate, _, _ = self._tracked(self.plant.measure(nodes, velocities))
        if not np.isfinite(y).all():
            raise ValueError("nodes turn a bar by a right angle or more from the operating point")
        wanted, wanted_rate, _ = self._reference.at(validation.number("time", time, "s"))
        return y - wanted, rate - wanted_rate

    def reset(self) -> None:
        """Forget the previous input, the last solution and the statistics."""
        super().reset()
        self._squares.reset()
        self._records: list[tuple[float, ...]] = []

    def _tracked(self, state: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return y, ẏ, ÿ without γ, and its derivative by γ, shape (p, α), until the next call."""
        y, rate, free, J = self._motion(state)
        return y, rate, free, J.reshape(len(free), -1)  # a single string gives a vector

    def _decide(self, time: float, state: FloatArray) -> Command:
        y, rate, free, J = self._tracked(state)
        wanted, wanted_rate, wanted_acceleration = self._reference.at(time)
        a, b = self._rates
        d = wanted_acceleration - a * (rate - wanted_rate) - b * (y - wanted) - free
        if not (np.isfinite(d).all() and np.isfinite(J).all()):
            return self._fall_back(Status.BAD_DATA)  # a bar turned beyond the coordinates
        low, high = self._sample_bounds
        # In units of the largest γ and of the acceleration that it gives.
        level, unit, preferred = self._level, self._unit, self.plant.force_density
        system = J * (level / unit), d / unit, preferred / level
        answer = self._squares.solve(*system, low / level, high / level)
        if answer.x is None:
            return self._fall_back(answer.status, answer.iterations)
        gamma = np.clip(level * answer.x[: len(preferred)], low, high)
        residual, unbounded = (
            float(np.abs(J @ solution - d).max())
            for solution in (gamma, level * self._squares.unbounded(*system))
        )
        at_bound = int(((gamma <= low + _CLOSE * level) | (gamma >= high - _CLOSE * level)).sum())
        self._records.append((residual, unbounded, at_bound, answer.iterations))
        if residual <= self._unreached:
            return Command(gamma)
        return Command(gamma, Status.UNREACHED, detail=f"off by up to {rounded_up(residual)} m/s^2")

    def _fall_back(self, status: Status, iterations: int = 0) -> Command:
        """Return γ of the operating point; a limit of change allows a step towards it."""
        self._records.append((np.nan, np.nan, 0, iterations))
        self._squares.forget()
        return self._hold(status)

    def __repr__(self) -> str:
        a, b = self._rates
        return (
            f"FeedbackLinearization({self.plant!r}, a = {a:.4g} 1/s, b = {b:.4g} 1/s^2, "
            f"sample time {self.sample_time} s)"
        )


class BoundedLeastSquares:
    """``min ½ price |x − c|² + ½ |J x − d|²`` with ``low ≤ x ≤ high``, by OSQP.

    The residual is a variable of the program, so that J is part of its constraints: a new J, of
    shape (rows, columns), changes values in place. A price above 0 makes x unique.
    """

    def __init__(
        self, rows: int, columns: int, price: float, tolerance: float, max_iterations: int
    ) -> None:
        from scipy.sparse import csc_array, diags_array, eye_array, hstack, vstack

        self._price, self._columns = price, columns
        P = csc_array(diags_array(np.r_[np.full(columns, price), np.ones(rows)]))
        bounds = hstack([eye_array(columns), csc_array((columns, rows))])
        law = hstack([csc_array(np.ones((rows, columns))), -eye_array(rows)])
        A = csc_array(vstack([bounds, law]))
        self._arguments = P, A, tolerance, max_iterations
        self.reset()

    def forget(self) -> None:
        """Start the next solve from the centre."""
        self._guess: tuple[FloatArray, FloatArray] | None = None

    def reset(self) -> None:
        """Forget the last answer, and what the solver adapted to it and to earlier matrices."""
        self.forget()
        # OSQP scales an updated A by the cost at that time: only a new program forgets.
        self._program = OSQPSolver(*self._arguments)

    def solve(
        self, J: FloatArray, d: FloatArray, c: FloatArray, low: FloatArray, high: FloatArray
    ) -> QPSolution:
        """Return the answer: first x, then the residual ``J x − d``. J must be finite."""
        # The nonzeros of A column by column: one bound and a column of J each, then −1.
        by_x = np.vstack([np.ones(self._columns), J]).ravel(order="F")
        self._program.update(np.concatenate([by_x, np.full(len(d), -1.0)]))
        start = self._guess
        if start is None:
            start = np.r_[c, J @ c - d], np.zeros(len(c) + len(d))
        answer = self._program.solve(
            np.r_[-self._price * c, np.zeros(len(d))], np.r_[low, d], np.r_[high, d], start=start
        )
        self._guess = None
        if answer.x is not None and answer.y is not None:
            self._guess = answer.x, answer.y
        return answer

    def unbounded(self, J: FloatArray, d: FloatArray, c: FloatArray) -> FloatArray:
        """Return x without bounds, by the normal equations."""
        normal = J.T @ J + self._price * np.eye(self._columns)
        return c + np.linalg.solve(normal, J.T @ (d - J @ c))


def error_rates(frequency: object, damping: object, sample_time: float) -> tuple[float, float]:
    """Return a and b, or raise if the sampled error would grow."""
    omega = 2 * pi * validation.positive_number("frequency", frequency, "Hz")
    a, b = 2 * validation.positive_number("damping", damping, "no unit") * omega, omega**2
    # With Ë held over a sample: det < 1 and trace > −1 − det of the map of (E, Ė).
    if a * sample_time >= 2 or b * sample_time >= 2 * a:
        raise ValueError(
            f"frequency {omega / (2 * pi):g} Hz and damping {a / (2 * omega):g} give a = {a:g} 1/s "
            f"and b = {b:g} 1/s²: in samples of {sample_time:g} s the error would grow; expected "
            f"a·sample_time < 2 and b·sample_time < 2a. Lower the frequency or sample_time"
        )
    return a, b


def _combinations(plant: LinearPlant, tracked: object) -> FloatArray:
    """Return C, shape (p, d n)."""
    if tracked is not None:
        return checked_tracked(plant, tracked)
    # δN = T q, and T = (orthonormal) R: so R q measures the same displacement in m.
    R = np.linalg.qr(plant.basis)[1]
    return np.asarray(R @ plant.coordinates.project(np.eye(plant.nodes.size)))


def rounded_up(value: float) -> str:
    """Return a number rounded up to 1, 2 or 5 times a power of ten, so that few texts differ."""
    power = 10.0 ** floor(log10(value))
    digit = next(one for one in (1, 2, 5, 10) if ceil(value / power * 1e6) <= one * 10**6)
    return f"{digit * power:g}"
