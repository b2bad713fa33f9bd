"""Simulation of a model, open loop or under a controller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.methods import Method
from tenscontrol.interrupt import interruptible
from tenscontrol.simulation.faults import Fault
from tenscontrol.simulation.health import HealthLimits
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.scene import Scene, run_scene
from tenscontrol.simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from tenscontrol.actuation.winches import Winches
    from tenscontrol.estimation.kalman_filter import KalmanFilter
    from tenscontrol.estimation.sensors import Sensors

# The usual limits; checked once.
_LIMITS = HealthLimits()


def simulate(
    model: Model,
    duration: float,
    nodes: object = None,
    velocities: object = None,
    *,
    rest_length: object = None,
    force_density: object = None,
    controller: object = None,
    input: str | None = None,
    winches: Winches | None = None,
    sample_time: float | None = None,
    faults: Sequence[Fault] | None = (),
    external_force: object = None,
    method: str | Method = "auto",
    tolerance: float = 1e-6,
    step: float | None = None,
    output_step: float | None = None,
    project: bool | None = None,
    limits: HealthLimits | None = None,
    error: str = "estimate",
    progress: bool = False,
    estimator: KalmanFilter | None = None,
    sensors: Sensors | None = None,
    seed: int | None = None,
    start: Trajectory | None = None,
    support_motion: object = None,
    bar_length: object = None,
) -> Trajectory:
    """Return the simulated motion of a model, in open loop or under a controller.

    Give one of ``force_density``, ``rest_length`` and ``controller``; without strings none is
    needed. The first two may be functions of time. Under a controller the actuators hold their
    value from one sample to the next. Winches hold the rest length, so that γ changes with the
    motion between samples.

    Parameters
    ----------
    model : Model
    duration : float
        Simulated time, s.
    nodes, velocities : array_like, shape (d, n), optional
        Motion at the start, m and m/s; the reference shape at rest if not given.
        Bars must have their lengths, and these must not change. Measured shapes, with bars off by
        up to 5 % of their length, and velocities that stretch them at up to 5 % of the speed that
        forces can give, are projected, and ``run.note`` says by how much. Supports and rollers must
        be at their places in the structure, and at rest.
    start : Trajectory, optional
        A run to continue, in place of ``nodes`` and ``velocities``; see the notes.
    rest_length : float, array_like, shape (α,), Profile or callable, optional
        Rest lengths, m; over time as a :class:`Profile` or a function of time, see the notes. With
        a controller: those at the start, one per string that it commands, constant.
    force_density : float, array_like, shape (α,), Profile or callable, optional
        γ, N/m.
    controller : controller, callable or object with a method ``command``, optional
        For example ``LQR(...)`` or ``MPC(...)``. It is reset first. A controller
        designed on the parent of a subdivided structure receives the parent's nodes and commands
        the parent's strings. So does a function ``(time, nodes, velocities) -> command``, whose
        command is the input of the actuators; see :class:`FunctionController`, also for bounds.
    input : {"rest_length", "force_density"}, optional
        What the actuators hold between samples. The rest length if the model
        has a string law, else γ.
    winches : Winches, optional
        Limits of the winches and their motors; none if not given. With a rate, substeps or a
        motor, give their start by ``rest_length``. If γ is the input: the motors of the cables.
    sample_time : float, optional
        Time between two commands, s, for a controller without a sample time of its own; else
        ``step``.
    faults : sequence of CutString, StuckWinch and LostMeasurement
        The controller receives the applied input (:meth:`Controller.applied`), but no
        information on cut strings.
    external_force : array_like, shape (d, n), 0, Profile or callable, optional
        Load W, N, for a model built with ``external_force=True``; a load of 0 for any.
    support_motion : Profile, callable or array_like, shape (d, number of fixed nodes), optional
        Displacement of the fixed nodes from their places in the structure, m, in the order of
        ``structure.fixed``. See the notes.
    bar_length : Profile, callable, float or array_like, shape (β,), optional
        Lengths of bars that are driven, as telescopic struts are, m; those of the structure if not
        given. In open loop, and not with moving supports. See the notes.
    method : str or Method
        Method of integration, or ``"auto"``. One of :data:`METHODS`, or a :class:`Method` of your
        own. ``"auto"`` is ``"rk4"`` where ``step`` is given; else it chooses by the largest string
        frequency, and goes on with another method where that gets further for its work, or where
        the first one fails. ``run.choice`` says which, from when and why.
    tolerance : float
        Error allowed in a step, of a method that chooses its steps. It is a part of the size of the
        structure and of its characteristic speed.
    step : float, optional
        Step of a method with a fixed step, s.
    output_step : float, optional
        Largest time between returned states, s. The ends of samples are returned as well, and the
        ends of the pieces that make a profile or replace a function of time, so that some states
        may lie closer. If not given, every fixed step, or a thousandth of the duration; of more
        than 8,000 nodes more, for at most 50 million numbers.
    project : bool, optional
        Whether to make the bar lengths exact after each step, for a method
        from which they drift. If not given, methods that control their error
        do, and RK4 does not: its drift shows too long a step.
    limits : HealthLimits, optional
        Limits on the figures in ``run.health``; ``HealthLimits()`` if not given.
    error : {"estimate", "none"}
        Whether to estimate the error of the motion, ``run.error``, by a second run at another
        resolution. With a tolerance it takes about as long as the run, with a fixed step half as
        long.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal. Without one, the logger
        ``"tenscontrol"`` says once how long a run takes, if that is more than 20 s.
    estimator : KalmanFilter, optional
        The controller then receives the estimate in place of the motion, and the estimator the
        applied input. It is reset first. It must have the sample time of the controller, and
        the substeps of the winches.
    sensors : Sensors, optional
        The actual sensors, if noise, delay or losses differ from those of the estimator.
    seed : int, optional
        Of the noise of the readings; 0 if not given. The same seed gives the same run.

    Returns
    -------
    Trajectory

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name; if a function of time
        jumps or has kinks, or supports jump, or bars join supports that move differently.
    SimulationError
        If the motion diverges, passes a limit with ``action="raise"``, or the controller raises an
        error, which is then its cause. It carries the motion up to there. An error of the
        controller at the first sample, before there is a motion, is raised unchanged.

    Warns
    -----
    AccuracyWarning
        If the motion passes a limit: the integration was too coarse, or nodes sink deep.
    BarCrossingWarning
        Once, if bars pass through each other; see :attr:`Health.crossings`.
    ControlWarning
        Once, if the run ends away from the reference of its controller, or many programs were not
        solved; see :attr:`ControlRecord.problems`.
    CompilerWarning
        A RuntimeWarning: the compiler or the folder of its libraries fails, and the run goes on
        uncompiled.
    InterruptionWarning
        A RuntimeWarning: Ctrl-C or SIGTERM ended the run, and the motion up to there is returned,
        with its control record, from the main thread. Before the first step there is no motion:
        KeyboardInterrupt. After SIGTERM the next long computation raises SystemExit (143), so that
        a script of many ends.

    Notes
    -----
    **Continued runs.** A run given as ``start`` is continued from its last state, also if it was
    interrupted. Times continue, with those of faults and references. Its faults and its inputs stay
    unless others are given; method and step are those of this call. Controller and estimator are
    not reset: give those of the run, in their last state. The sequence of the noise continues, and
    delayed measurements still arrive.

    How far a run in two parts equals one in a single part: under a controller bit by bit, if the
    method has fixed steps and the first part ends with a whole sample. In open loop to round-off,
    if it ends with a whole step: steps are equal parts of the time between ends of the run and of
    pieces of profiles. Under functions of time to the error of the method: each part replaces them
    by polynomials of its own, and their pieces end steps. Methods that choose their steps begin
    with a new first step, and agree to their tolerance. A run that ended within a sample begins a
    new one. A sample whose command was interrupted is measured again.

    **Functions of time** are a :class:`Profile`, or a smooth function ``time -> array``, time in s.
    Before the run, a function is replaced by polynomials of degree 9 with errors of 1e-12 of its
    largest value. It is called some 8,000 times or more, at intervals of at most 1/8192 of the
    duration. A pulse that is shorter may be missed; ``run.note`` tells the interval. For a shorter
    one give a profile with values where it is, or the run in parts. Every method integrates these
    polynomials and ends a step where a piece ends. So its order of convergence holds, also where
    strings go slack or taut, but steps are no longer than pieces. Damping of a string acts on the
    rate of its length, not on that of its rest length. Times are those of the run: give a run
    continued by ``start`` the same profile; without it, the last values are held.

    **Moving supports** carry the bars on them, so supports joined by bars must have the same
    displacement. If the velocity of a support jumps, as at a sudden start and at each kink of a
    linear profile, the bars on it receive an impulse: the free end of a uniform bar takes on the
    velocity of the hinge along the bar, and minus half of it across. States returned at such a time
    are those before the jump, except at the start of the run. Nodes and velocities at the start are
    absolute; velocities of supports there are those before a jump.

    **Driven bars** have the length that ``bar_length`` says, whatever force it takes; it is
    continuous and positive, and begins with the lengths that bars have at the start. The mass of a
    bar stays the same and is spread evenly over its length at any time, so that its moment of
    inertia is that of a uniform rod of this length. That is a strut of many short tubes; in one of
    two tubes the mass lags behind. If a rate jumps, as at a sudden start and at each kink of a
    linear profile, an impulse along the bar makes it: velocities at the start are those before it,
    at any rate of driven bars. ``run.struts`` has lengths, forces and the work of the drives.

    If any of these changes, ``run.conserves_energy`` is false, and the energy of a load is that of
    the load at the time.

    Examples
    --------
    A prism let go with too little force in its vertical strings:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> start = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    >>> run = tc.simulate(model, 1.0, rest_length=start, step=1e-3)
    >>> run.nodes.shape, round(float(run.nodes[2, 0, -1]), 3)
    ((3, 6, 1001), 1.076)

    It goes on for another second:

    >>> more = tc.simulate(model, 1.0, start=run, step=1e-3)
    >>> more.time[[0, -1]]
    array([1., 2.])

    Its vertical strings are wound in by a tenth within half a second:

    >>> wound = np.repeat([1.0, 1.0, 0.9], 3) * start
    >>> profile = tc.Profile([0.0, 0.5], np.column_stack([start, wound]), "cubic")
    >>> run = tc.simulate(model, 1.0, rest_length=profile, step=1e-3)
    >>> (run.rest_length[6, [0, 250, 500, 1000]] / start[6]).round(3)
    array([1.  , 0.95, 0.9 , 0.9 ])
    """
    if controller is None and input is not None:
        raise ValueError("input goes with a controller; in open loop the given input is held")
    with interruptible() as interruption:  # CasADi may lose a key while it builds
        integration = Integration(
            method, tolerance, step, output_step, project, error,
            _LIMITS if limits is None else limits,
        )  # fmt: skip
        scene = Scene(
            model,
            duration,
            nodes,
            velocities,
            rest_length=rest_length,
            force_density=force_density,
            controller=controller,
            input=input,
            winches=winches,
            sample_time=sample_time,
            faults=faults,
            external_force=external_force,
            support_motion=support_motion,
            bar_length=bar_length,
            estimator=estimator,
            sensors=sensors,
            seed=seed,
            start=start,
            integration=integration,
        )
        return run_scene(scene, progress, interruption)
