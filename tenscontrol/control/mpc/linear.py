"""Linear model predictive control of strings that cannot push."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control.controller import Command, Controller
from tenscontrol.control.disturbance import load_observer
from tenscontrol.control.held_loop import warn_of_held_lengths
from tenscontrol.control.mpc.condensed import Condensed
from tenscontrol.control.mpc.constraints import OutputLimit
from tenscontrol.control.mpc.mpc_law import MPCLaw, form_of
from tenscontrol.control.mpc.mpc_statistics import MPCStatistics, statistics
from tenscontrol.control.mpc.settings import Wishes, checked_time_limit, default_penalty, design
from tenscontrol.control.status import Fallback, Status
from tenscontrol.plant import LinearPlant, ReferencePreview, acceleration_response
from tenscontrol.validation import FloatArray, frozen, instance, positive_number, whole_number


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
    that wind through samples (``Winches(substeps=...)``) are predicted as they do: about
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
    sample_time : float
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
    >>> mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=300.0)
    >>> pushed = plant.to_nodes(np.r_[0.01, np.zeros(8)])
    >>> command = mpc.command(0.0, pushed, np.zeros((3, 6)))
    >>> str(command), bool((command.value >= 0).all()), command.value.shape
    ('ok', True, (9,))
    """

    def __init__(
        self,
        plant: LinearPlant,
        *,
        horizon: int,
        sample_time: float,
        max_force_density: object = None,
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
        sample_time = positive_number("sample_time", sample_time, "s")
        wishes = Wishes(
            max_force_density, min_force_density, max_tension, max_change, winches, outputs,
            default_penalty(string_penalty),
        )  # fmt: skip
        made = design(plant, horizon, sample_time, Q, R, wishes)
        super().__init__(plant, sample_time, made.low, made.high, made.problem.change)
        push = acceleration_response(plant, sample_time)
        observer = load_observer(plant, push, load_gain, tracked)
        self._observer = observer
        self._law = MPCLaw(
            plant=plant,
            sample_time=sample_time,
            design=made,
            form=form_of(made.problem, form),
            load=None if observer is None else observer.model,
            tolerance=positive_number("tolerance", tolerance, "units of the largest force density"),
            max_iterations=whole_number("max_iterations", max_iterations, least=1),
            time_limit=checked_time_limit(time_limit),
            path=ReferencePreview(plant, reference, made.sampled),
        )
        self._program = self._law.program()
        self.reset()
        if plant.input == "force_density" and plant.model.strings is not None:
            warn_of_held_lengths(plant, made.problem.feedback, sample_time)

    @property
    def law(self) -> MPCLaw:
        """All that it goes by, except what it remembers; not for users, and may change."""
        return self._law

    @property
    def form(self) -> str:
        """``"condensed"`` or ``"sparse"``."""
        return "condensed" if isinstance(self._law.form, Condensed) else "sparse"

    @property
    def statistics(self) -> MPCStatistics:
        """What became of the solves since the last reset."""
        return statistics(self.status_count, self.fallback_count, self._iterations)

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
        self._law = replace(self._law, path=self._law.path.following(reference))

    def reset(self) -> None:
        """Forget the last plan, what stands, the estimated load and the statistics."""
        self._plan = np.zeros((0, len(self._low)))
        self._used = 0
        self._guess: tuple[FloatArray, FloatArray] | None = None
        super().reset()
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

    def _decide(self, time: float, state: FloatArray) -> Command:
        law, observer = self._law, self._observer
        deadline = self._called + law.time_limit
        if observer is not None and self._previous_input is not None:
            observer.correct(state, law.design.sampled.by_input @ self._previous_input)
        ahead = law.ahead(time, None if observer is None else observer.acceleration)
        if self._previous_input is None:
            self._previous_input = frozen(ahead.before)
        if observer is not None:
            observer.expect(law.coasting(ahead, state, self._previous_input))
        vectors = law.vectors(ahead, state, self._previous_input, self._previous_within_bounds)
        answer = self._program.solve(*vectors, start=self._guess, deadline=deadline)
        self._iterations.append(answer.iterations)
        if answer.x is None or answer.y is None:
            return self._continue(answer.status)
        # Solved to a tolerance: what is left outside the bounds is cut off.
        inputs = law.inputs(answer.x, ahead, state, self._previous_input)
        self._plan = np.clip(inputs, self._low, self._high)
        self._used = 0
        self._guess = law.form.shifted(answer.x, answer.y)
        return Command(self._plan[0])

    def _fall_back(self, status: Status) -> Command:
        if self._observer is not None:
            self._observer.expect(None)
        return self._continue(status)

    def _continue(self, status: Status) -> Command:
        """Go on without a new plan."""
        self._used += 1
        self._guess = None
        if self._used < len(self._plan):
            return Command(self._plan[self._used], status, Fallback.PLAN_CONTINUED)
        return self._hold(status)

    def __repr__(self) -> str:
        return (
            f"MPC({self.plant!r}, horizon {self._law.design.problem.length}, "
            f"sample time {self.sample_time:g} s, {self.form})"
        )
