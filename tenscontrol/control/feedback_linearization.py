"""Shape control: errors of node positions are made to decay as a spring and damper would."""

from __future__ import annotations

from typing import final

import numpy as np

from tenscontrol.control.controller import Command, Controller
from tenscontrol.control.held_loop import warn_of_slow_errors
from tenscontrol.control.input_bounds import input_bounds, largest_change
from tenscontrol.control.least_squares import BoundedLeastSquares
from tenscontrol.control.shape_design import (
    combinations,
    error_rates,
    refuse_other_plants,
    rounded_up,
)
from tenscontrol.control.shape_statistics import FeedbackLinearizationStatistics, statistics
from tenscontrol.control.status import Status
from tenscontrol.dynamics import Evaluator
from tenscontrol.plant import LinearPlant, SmoothReference, checked_reference, tracked_motion
from tenscontrol.validation import (
    FloatArray,
    float_array,
    instance,
    positive_number,
    whole_number,
)

# An acceleration off by δ leaves an error of δ/b. The law counts as reached where that is below
# this share of the size of the structure.
_REACHED = 1e-4

# A γ so close to a bound, in units of the largest at the operating point, is at it.
_CLOSE = 1e-7


@final
class FeedbackLinearization(Controller):
    """Impose ``Ë + a Ė + b E = 0`` on the error of chosen node coordinates, sample by sample.

    With ``y = C vec(N)`` and ``E = y − y_ref(t)``, node accelerations are affine in γ, so that
    the law is a linear system ``J γ = d`` at each measured state: exact, not linearized.
    Reference rates and accelerations are fed forward. It is solved as least squares within
    ``0 ≤ γ ≤ max_force_density``; where several γ do equally well (self-stress), the one near
    the operating point is taken. What is left is in the status and in :attr:`statistics`.

    There is no look ahead, and nothing is said about motions that are not tracked: these are
    free to swing. Strings must pull in every tracked direction; a mechanism answers only to
    prestress, and leaves a residual.

    If a program is not solved, or the measurement is not one that the structure can have, γ of
    the operating point is commanded.

    Parameters
    ----------
    plant : LinearPlant
        With γ as the input, in internal or minimal coordinates. It says how motion is
        measured and gives the preferred γ.
    reference : Reference or array_like, shape (3, n), or None
        Shapes to follow, joined by cubic splines in y, at rest at both ends. The
        operating point if None.
    sample_time : float
        Sample time, s. The law is exact at the samples; in between γ is held.
    max_force_density : float or array_like, shape (α,)
        Largest γ, N/m.
    frequency : float
        Natural frequency of the error, Hz: ``b = (2π frequency)²``.
    damping : float
        Damping ratio ζ of the error: ``a = 4π ζ frequency``.
    tracked : array_like, shape (p, 3n), optional
        C, node by node: L and R of ``E = L N R − Ȳ`` in one. If not given, r combinations
        that together are all changes of shape, in m.
    max_change : float or array_like, shape (α,), optional
        Largest change of γ from sample to sample, N/m.
    regularization : float
        Cost of γ that is off the operating point by its largest entry, against an
        acceleration off by what that γ gives; both squared.
    tolerance : float
        OSQP's absolute and relative tolerance, in units of the largest γ.
    max_iterations : int
        OSQP's limit.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or the error would grow from sample to sample:
        ``a step ≥ 2`` or ``b step ≥ 2 a``.

    Warns
    -----
    RuntimeWarning
        If winches, which hold rest lengths between samples, would keep errors from decaying
        at a quarter of the rate asked for or faster.

    Notes
    -----
    Goyal, Majji & Skelton, *Integrating structure, information architecture and control
    design: application to tensegrity systems*. In internal coordinates positions are those of
    the shape laid over the operating point, as in :class:`OutputLimit`.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> law = tc.FeedbackLinearization(
    ...     plant, sample_time=0.02, max_force_density=80.0, frequency=1.0)
    >>> command = law.command(0.0, plant.to_nodes(np.full(9, 0.01)), np.zeros((3, 6)))
    >>> bool((command.value >= 0).all()), command.value.shape
    (True, (9,))
    >>> print(command)  # the mechanism of the prism
    error dynamics not reached: off by up to 2 m/s²
    """

    def __init__(
        self,
        plant: LinearPlant,
        *,
        reference: object = None,
        sample_time: float,
        max_force_density: object,
        frequency: float,
        damping: float = 1.0,
        tracked: object = None,
        max_change: object = None,
        regularization: float = 1e-4,
        tolerance: float = 1e-7,
        max_iterations: int = 4000,
    ) -> None:
        instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        refuse_other_plants(plant)
        if max_force_density is None:
            raise TypeError("max_force_density is None, expected a positive number in N/m")
        sample_time = positive_number("sample_time", sample_time, "s")
        bounds = input_bounds(plant, max_force_density)
        super().__init__(
            plant, sample_time, *bounds, largest_change(plant, max_change, None, sample_time)
        )
        self._rates = error_rates(frequency, damping, sample_time)
        matrix = combinations(plant, tracked)
        self._motion = Evaluator(tracked_motion(plant, matrix))
        self._level = float(plant.force_density.max()) or float(self._high.max())
        push = self._moved(self._still(plant.nodes))[3]
        self._unit = self._level * float(np.linalg.norm(push, 2))
        if not self._unit > 0:
            raise ValueError(
                "tracked combinations are moved by no string at the operating point; expected "
                "coordinates of free nodes, relative to each other where no node is fixed"
            )
        size = float(np.ptp(plant.nodes, axis=1).max())
        self._unreached = _REACHED * size * self._rates[1]
        rows, columns = push.shape
        self._squares = BoundedLeastSquares(
            rows,
            columns,
            positive_number("regularization", regularization, "no unit"),
            positive_number("tolerance", tolerance, "units of the largest force density"),
            whole_number("max_iterations", max_iterations, least=1),
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
        """What became of the samples since the last reset."""
        return statistics(self.status_count, self.fallback_count, self._records)

    def follow(self, reference: object) -> None:
        """Follow another reference from now on.

        Parameters
        ----------
        reference : Reference or array_like, shape (3, n), or None
            As in the constructor.

        Raises
        ------
        TypeError, ValueError
            If it does not fit the structure.
        """
        given = checked_reference(self.plant, reference)
        shapes = np.moveaxis(given.nodes, 2, 0)
        values = [self._moved(self._still(each))[0].copy() for each in shapes]
        self._reference = SmoothReference(given.time, np.array(values))

    def error(
        self, time: float, nodes: object, velocities: object
    ) -> tuple[FloatArray, FloatArray]:
        """Return E, m, and Ė, m/s, of a motion, shape (p,) each.

        Parameters
        ----------
        time : float
            s.
        nodes, velocities : array_like, shape (3, n)
            m and m/s.

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit or is not finite.
        """
        y, rate, _, _ = self._moved(self.plant.measure(nodes, velocities))
        wanted, wanted_rate, _ = self._reference.at(float(float_array("time", time)))
        return y - wanted, rate - wanted_rate

    def reset(self) -> None:
        """Forget what stands and the statistics."""
        super().reset()
        self._squares.reset()
        self._records: list[tuple[float, ...]] = []

    def _moved(self, state: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return y, ẏ, ÿ without γ, and its derivative by γ, shape (p, α), until the next call."""
        y, rate, free, J = self._motion(state)
        return y, rate, free, J.reshape(len(free), -1)  # a single string gives a vector

    def _still(self, nodes: FloatArray) -> FloatArray:
        """Return z of a shape at rest."""
        return self.plant.measure(nodes, np.zeros_like(nodes))

    def _decide(self, time: float, state: FloatArray) -> Command:
        y, rate, free, J = self._moved(state)
        wanted, wanted_rate, wanted_acceleration = self._reference.at(time)
        a, b = self._rates
        d = wanted_acceleration - a * (rate - wanted_rate) - b * (y - wanted) - free
        if not (np.isfinite(d).all() and np.isfinite(J).all()):
            return self._fall_back(Status.BAD_DATA)  # a bar turned beyond the coordinates
        low, high = self._room()
        # In units of the largest γ and of the acceleration that it gives.
        level, unit, held = self._level, self._unit, self.plant.force_density
        system = J * (level / unit), d / unit, held / level
        answer = self._squares.solve(*system, low / level, high / level)
        if answer.x is None:
            self._records.append((np.nan, np.nan, 0, answer.iterations))
            return self._safe(answer.status)
        gamma = np.clip(level * answer.x[: len(held)], low, high)
        left, unbounded = (
            float(np.abs(J @ each - d).max())
            for each in (gamma, level * self._squares.unbounded(*system))
        )
        at_bound = int(((gamma <= low + _CLOSE * level) | (gamma >= high - _CLOSE * level)).sum())
        self._records.append((left, unbounded, at_bound, answer.iterations))
        reached = left <= self._unreached
        if reached:
            return Command(gamma)
        return Command(gamma, Status.UNREACHED, detail=f"off by up to {rounded_up(left)} m/s²")

    def _room(self) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of this sample."""
        if self._change is None:
            return self._low, self._high
        before = self._previous_within_bounds
        return (
            np.maximum(self._low, before - self._change),
            np.minimum(self._high, before + self._change),
        )

    def _fall_back(self, status: Status) -> Command:
        self._records.append((np.nan, np.nan, 0, 0))
        return self._safe(status)

    def _safe(self, status: Status) -> Command:
        """Return γ of the operating point; a limit of change allows a step towards it."""
        self._squares.forget()
        return self._hold(status)

    def __repr__(self) -> str:
        a, b = self._rates
        return (
            f"FeedbackLinearization({self.plant!r}, a = {a:.4g} 1/s, b = {b:.4g} 1/s², "
            f"sample time {self.sample_time} s)"
        )
