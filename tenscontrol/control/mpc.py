"""Linear model predictive control of strings that cannot push."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.analysis import LinearPlant
from tenscontrol.control.constraints import OutputLimit
from tenscontrol.control.controller import Controller
from tenscontrol.control.held_loop import warn_of_held_lengths
from tenscontrol.control.horizon import Condensed, Sparse
from tenscontrol.control.load_observer import load_observer
from tenscontrol.control.mpc_design import LONGEST_HORIZON, Wishes, default_penalty, design
from tenscontrol.control.path import Path, acceleration_response, checked_reference
from tenscontrol.control.problem import Ahead, Course, Form
from tenscontrol.control.quadratic_program import QuadraticProgram, Status
from tenscontrol.control.sampled import Lead, along_jumps, along_winding
from tenscontrol.validation import (
    FloatArray,
    choice,
    frozen,
    instance,
    positive_number,
    whole_number,
)

FORMS = ("auto", "condensed", "sparse")

# Up to so many unknown inputs the dense form is the cheaper one: tests/benchmarks/mpc_step.py.
_LARGEST_CONDENSED = 600

# Beyond so many its dense matrices fill gigabytes.
_MOST_CONDENSED = 5000


@dataclass(frozen=True, eq=False)
class MPCStatistics:
    """What became of the solves since the last reset.

    Attributes
    ----------
    status_count : dict of str to int
        How often each status came; ``"ok"`` is a solved program.
    fallbacks : int
        Commands that did not come from a solved program.
    iterations : ndarray of int, shape (K,)
        OSQP iterations of each solve; a fallback for want of a measurement has none.
    """

    status_count: dict[str, int]
    fallbacks: int
    iterations: np.ndarray


@final
class MPC(Controller):
    """Model predictive control with γ ≥ 0, whatever else.

    At each sample the plant is predicted over a horizon by its exact
    zero-order-hold discretization, a quadratic program is solved by OSQP, and
    the first input is applied. The terminal cost is that of the discrete LQR.

    Where the plant's input is the rest length, γ moves with the structure: its
    limits are linear in state and input, and soft, since a push may slacken a
    string before any winch moves. Along a reference, rest lengths start from
    those that hold its shapes, and the plant's dynamics are taken about them. Winches
    that wind through samples (``Winches(pieces=...)``) are predicted as they do: about
    the motion of the reference, with limits of strings at the ends of samples.

    If a program is not solved, or the measurement is not one that the structure can
    have, the command is the next input of the last plan; when that is used up, γ of
    the operating point, or the rest lengths that stand. Either is counted
    (:attr:`statistics`) and shows in the status. Changes are limited from what the
    actuators hold (:meth:`applied`), and the next solved program makes a new plan.

    Parameters
    ----------
    plant : LinearPlant
        In internal coordinates.
    horizon : int
        Number of samples predicted, 1 to 10,000.
    step : float
        Sample time, s.
    max_force_density : float or array_like, shape (α,)
        Largest γ, N/m. May be left out where the input is the rest length.
    Q : float or array_like, shape (2r,) or (2r, 2r), optional
        Weight of ``z − reference``. If not given, that of :func:`energy_weights`,
        by mode where the input is the rest length.
    R : float or array_like, shape (α,) or (α, α), optional
        Weight of the departure of the input from the operating point, or from
        the rest lengths that hold the reference. If not given, that of
        :func:`energy_weights`; a tenth of it for γ.
    max_change : float or array_like, shape (α,), optional
        Largest change of the input from sample to sample, N/m or m.
    reference : Reference or array_like, shape (3, n), optional
        Shapes to follow, seen ahead over the horizon; a single shape is a
        constant one. The operating point if not given.
    form : {"auto", "condensed", "sparse"}
        How the program is written. Both give the same inputs; "auto" takes the
        cheaper one by size.
    tolerance : float
        OSQP's absolute and relative tolerance, in units of the largest γ at
        the operating point, or of the largest stretch.
    max_iterations : int
        OSQP's limit.
    min_force_density : float or array_like, shape (α,)
        Least γ, N/m, at least 0.
    max_tension : float or array_like, shape (α,), optional
        Strength of the strings, N.
    winches : Winches, optional
        Speed and range that bound rest lengths, never violated.
    outputs : sequence of OutputLimit
        Limits on node positions.
    string_penalty : float, optional
        Price of a γ or tension beyond its limit (L1): of one violated by its
        largest value at the operating point, against an input that is off by
        its unit. ``inf`` makes them hard; commands of γ are within bounds always.
    load_gain : float, optional
        With it a constant unknown load is estimated, at most 1 (at once), and
        the plant is brought to rest at the reference under it.
    tracked : array_like, shape (p, 3n), optional
        Combinations of node positions to be free of offset under a load; all
        coordinates, as well as can be, if not given.
    time_limit : float, optional
        Time for a command, s, from its call. A program that is not solved by then
        is given up at the end of an OSQP iteration. The few operations that follow are
        not counted.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, or the plant has a
        pole that no string reaches.

    Warns
    -----
    RuntimeWarning
        If γ is commanded but the strings are so stiff that winches, which hold
        rest lengths between samples, would undo it: see :func:`held_loop`.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> mpc = tc.MPC(plant, horizon=20, step=0.02, max_force_density=300.0)
    >>> pushed = plant.to_nodes(np.r_[0.01, np.zeros(8)])
    >>> command = mpc.command(0.0, pushed, np.zeros((3, 6)))
    >>> command.status, bool((command.value >= 0).all()), command.value.shape
    ('ok', True, (9,))
    """

    def __init__(
        self,
        plant: LinearPlant,
        horizon: int,
        step: float,
        max_force_density: object = None,
        *,
        Q: object = None,
        R: object = None,
        max_change: object = None,
        reference: object = None,
        form: str = "auto",
        tolerance: float = 1e-4,
        max_iterations: int = 4000,
        min_force_density: object = 0.0,
        max_tension: object = None,
        winches: Winches | None = None,
        outputs: Sequence[OutputLimit] = (),
        string_penalty: float | None = None,
        load_gain: float | None = None,
        tracked: object = None,
        time_limit: float | None = None,
    ) -> None:
        instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
        step = positive_number("step", step, "s")
        length = whole_number("horizon", horizon, 1, LONGEST_HORIZON)
        wishes = Wishes(
            max_force_density, min_force_density, max_tension, max_change, winches, outputs,
            default_penalty(string_penalty),
        )  # fmt: skip
        made = design(plant, length, step, Q, R, wishes)
        super().__init__(plant, step, made.low, made.high, made.problem.change)
        self._time_limit = np.inf
        if time_limit is not None:
            self._time_limit = positive_number("time_limit", time_limit, "s")
        self._problem, self._constraints = made.problem, made.constraints
        self._sampled = made.sampled
        if choice("form", form, FORMS) == "auto":
            form = "condensed" if self._problem.input_count <= _LARGEST_CONDENSED else "sparse"
        if form == "condensed" and self._problem.input_count > _MOST_CONDENSED:
            raise ValueError(
                f"form is 'condensed', which is dense, for {self._problem.input_count} unknown "
                f"inputs; expected at most {_MOST_CONDENSED}. Take form='sparse'"
            )
        self._form: Form = (
            Condensed(self._problem) if form == "condensed" else Sparse(self._problem)
        )
        self._form_name = form
        self._program = QuadraticProgram(
            self._form.P,
            self._form.A,
            positive_number("tolerance", tolerance, "units of the largest force density"),
            whole_number("max_iterations", max_iterations, least=1),
        )
        self._push = acceleration_response(plant, step)
        self._observer = load_observer(plant, self._push, load_gain, tracked)
        self._now: FloatArray = step * np.arange(length + 1.0)
        self.follow(reference)
        self.reset()
        if plant.input == "force_density" and plant.model.strings is not None:
            warn_of_held_lengths(plant, self._problem.feedback, step)

    @property
    def form(self) -> str:
        """``"condensed"`` or ``"sparse"``."""
        return self._form_name

    @property
    def statistics(self) -> MPCStatistics:
        """What became of the solves since the last reset."""
        counts = dict(Counter(self._statuses))
        return MPCStatistics(
            status_count=counts,
            fallbacks=len(self._statuses) - counts.get(Status.SOLVED.value, 0),
            iterations=frozen(np.array(self._iterations, dtype=np.int64)),
        )

    @property
    def plan(self) -> FloatArray:
        """Inputs that the last solved program planned, shape (α, N); empty before the first."""
        return frozen(self._plan.T)

    @property
    def load(self) -> FloatArray | None:
        """q̈ laid to an unknown load, m √kg/s², shape (r,); None where none is estimated."""
        return None if self._observer is None else frozen(self._observer.acceleration)

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
        checked = checked_reference(self.plant, reference)
        assert self.step is not None  # given to the constructor
        self._path = Path(self.plant, checked, self.step, self._push, self._sampled.drift)

    def reset(self) -> None:
        """Forget the last plan, what stands, the estimated load and the statistics."""
        self._plan = np.zeros((0, len(self._low)))
        self._used = 0
        self._guess: tuple[FloatArray, FloatArray] | None = None
        super().reset()
        self._statuses: list[str] = []
        self._iterations: list[int] = []
        self._program.reset()
        if self._observer is not None:
            self._observer.reset()

    def take_over(self, command: FloatArray) -> None:
        """See :meth:`Controller.take_over`."""
        super().take_over(command)
        self._plan, self._used, self._guess = self._plan[:0], 0, None
        if self._observer is not None:
            self._observer.expect(None)

    def _ahead(self, time: float) -> Ahead:
        """Return what is known of the horizon before anything is measured at its start."""
        problem, winds = self._problem, self._sampled.winds
        lead = self._lead(time)
        path, origin = lead.path, lead.path.input[:-1]
        drift, reference = lead.drift, lead.reference
        effort = np.zeros_like(origin)
        if self._observer is not None:
            drift = drift + self._observer.drift
            r = self.plant.degrees_of_freedom
            ends = path.rest[:-1] if winds else path.rest[1:]
            known = (reference - ends)[:, :r] @ self.plant.A[r:, :r].T
            offset, effort = self._observer.rest(known)
            reference = reference + np.hstack([offset, np.zeros_like(offset)])
        if winds:
            none = np.zeros_like(origin)
            drift, reference = np.hstack([drift, none]), np.hstack([reference, none])
        row_low, row_high = self._constraints.bounds(path, problem.length)
        course = Course(
            drift=drift,
            input_reference=effort,
            low=self._low - origin,
            high=self._high - origin,
            shift=np.diff(origin, axis=0, prepend=origin[:1]),
            row_low=row_low,
            row_high=row_high,
        )
        return Ahead(lead.before, reference, origin, course)

    def _begun(self, state: FloatArray, standing: FloatArray, ahead: Ahead) -> FloatArray:
        """Return z_0 of the program: ``[z; v_before]`` where winches wind."""
        return np.concatenate([state, standing - ahead.before]) if self._sampled.winds else state

    def _coasting(self, state: FloatArray, standing: FloatArray, ahead: Ahead) -> FloatArray:
        """Return the state a sample later, the load but not the input of the sample included."""
        coasting = self._sampled.coasting(state, standing - ahead.before, ahead.origin[0])
        return coasting + ahead.course.drift[0, : len(state)]

    def _decide(self, time: float, state: FloatArray) -> tuple[FloatArray, str]:
        deadline = self._called + self._time_limit
        if self._observer is not None and self._standing is not None:
            self._observer.correct(state, self._sampled.by_input @ self._standing)
        ahead = self._ahead(time)
        origin, course = ahead.origin, ahead.course
        if self._standing is None:
            self._standing = frozen(ahead.before)
        if self._observer is not None:
            self._observer.expect(self._coasting(state, self._standing, ahead))
        begun = self._begun(state, self._standing, ahead)
        vectors = self._form.vectors(begun, ahead.reference, self._reachable - origin[0], course)
        answer = self._program.solve(*vectors, start=self._guess, deadline=deadline)
        self._iterations.append(answer.iterations)
        if answer.x is None or answer.y is None:
            return self._continue(answer.status.value)
        # Solved to a tolerance: what is left outside the bounds is cut off.
        inputs = origin + self._form.inputs(answer.x, begun, course)
        self._plan = np.clip(inputs, self._low, self._high)
        self._used = 0
        self._guess = self._form.shifted(answer.x, answer.y)
        self._statuses.append(answer.status.value)
        return self._plan[0], answer.status.value

    def _lead(self, time: float) -> Lead:
        """Return what the reference asks for over the horizon."""
        assert self.step is not None  # given to the constructor
        if not self._sampled.winds:
            path = self._path.at(time + self._now)
            return along_jumps(path, self._path.wanted(time + self._now[1:]), self._sampled)
        times = time + self.step * np.arange(-1.0, len(self._now) + 1)
        q = self._path.wanted(times)[:, : self.plant.degrees_of_freedom]
        return along_winding(
            self._path.at(times[1:]), q, self._sampled, self.plant, self._push, self.step
        )

    def _fall_back(self, reason: str) -> tuple[FloatArray, str]:
        if self._observer is not None:
            self._observer.expect(None)
        return self._continue(reason)

    def _continue(self, reason: str) -> tuple[FloatArray, str]:
        """Go on without a new plan."""
        self._used += 1
        self._guess = None
        if self._used < len(self._plan):
            wish, what = self._plan[self._used], "last plan continued"
        elif self.input == "rest_length" and self._standing is not None:
            wish, what = self._standing, "last command held"
        else:
            wish, what = self.plant.equilibrium_input, "equilibrium held"
        status = f"{reason}: {what}"
        self._statuses.append(status)
        return wish, status

    def __repr__(self) -> str:
        return (
            f"MPC({self.plant!r}, horizon {self._problem.length}, step {self.step:g} s, "
            f"{self._form_name})"
        )
