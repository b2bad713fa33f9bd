"""Simulation of a model, open loop or under a controller."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control import BaseController, ControlWarning, as_controller
from tenscontrol.dynamics import Model, Pieces, Profile, as_pieces, pack_state, sampling_interval
from tenscontrol.estimation import KalmanFilter, Sensors
from tenscontrol.integrate import Choice, Method, Projector, largest_frequency, state_scale
from tenscontrol.interrupt import InterruptionWarning, interruptible
from tenscontrol.plant import given_load, held_value, own_input
from tenscontrol.progress import long_run_note, progress_bar
from tenscontrol.simulation.closed_loop import run_closed_loop
from tenscontrol.simulation.faults import Fault, Faults
from tenscontrol.simulation.health import (
    AccuracyWarning,
    BarCrossingWarning,
    Given,
    HealthLimits,
)
from tenscontrol.simulation.loop import Loop, SimulationError, support_offset
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure import (
    carried_by_supports,
    refuse_moved_supports,
    refuse_strings_without_length,
    refuse_wrong_bar_lengths,
    same_members,
)
from tenscontrol.validation import (
    FloatArray,
    choice,
    frozen,
    instance,
    positive_number,
    refuse_memory,
    refuse_time,
    truth,
)

# States kept of an adaptive run, unless the user says otherwise.
_OUTPUTS = 1000

# A start whose bars are off by this part of their length, and stretching by this part of the
# largest speed, is taken as it is; up to the second, at which a run counts as inaccurate, it is
# projected. Near rest the speed is what forces and stiffness can give a structure of this size:
# the first part of that is round-off, the second what RK4 leaves in a motion that has died out.
# An input below zero by the first part of its largest value is zero.
_EXACT, _PROJECTED = 1e-8, 1e-3
_ROUND_OFF, _LEFT = 1e-12, 1e-6


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
    machine_code: bool = False,
    limits: HealthLimits | None = None,
    error: str = "estimate",
    progress: bool = False,
    estimator: KalmanFilter | None = None,
    sensors: Sensors | None = None,
    seed: int | None = None,
    start: Trajectory | None = None,
    support_motion: object = None,
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
        Bars must have their lengths, and these must not change. Errors below a thousandth are
        corrected by projection, and ``run.note`` says so. Supports and rollers must be at their
        places in the structure, and at rest.
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
        Largest time between returned states, s; the end of each sample is
        returned as well. Every fixed step, or a thousandth of the duration, if
        not given.
    project : bool, optional
        Whether to make the bar lengths exact after each step, for a method
        from which they drift. If not given, methods that control their error
        do, and RK4 does not: its drift shows too long a step.
    machine_code : bool
        Whether to compile the steps by the C compiler of the machine: the same
        numbers, several times as fast, after some seconds for the first run.
        Where there is no compiler, or it fails, or the method cannot be compiled,
        the steps run in CasADi's virtual machine; see ``run.choice.back_end``.
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
    instance("model", model, Model, "make one by Model(structure)")
    duration = positive_number("duration", duration, "s")
    tolerance = positive_number("tolerance", tolerance, "of size and speed")
    truth("progress", progress, "whether to show a progress bar")
    choice("error", error, ("estimate", "none"))
    if project is not None:
        truth("project", project, "whether to make bar lengths exact after each step")
    limits = HealthLimits() if limits is None else limits
    instance("limits", limits, HealthLimits, "make them by HealthLimits(bar_length_error=...)")
    if estimator is not None:
        how = "make one by KalmanFilter(plant, sensors, sample_time=...)"
        instance("estimator", estimator, KalmanFilter, how)
    if estimator is None and sensors is not None:
        raise ValueError("sensors go with an estimator; KalmanFilter(...) makes one")
    if not len(model.structure.free):
        raise ValueError("every node of the model is fixed: nothing can move")
    if start is not None:
        instance("start", start, Trajectory, "a run that simulate(...) returned")
        if nodes is not None or velocities is not None:
            raise ValueError("start gives nodes and velocities: leave those out")
        if not same_members(start.structure, model.structure) or not np.array_equal(
            start.structure.bar_length, model.structure.bar_length
        ):
            raise ValueError(
                f"start is a run of {start.structure!r}, expected the bars, strings and supports "
                f"of the model's {model.structure!r}"
            )
        faults = faults or start.faults
        if controller is None and rest_length is None and force_density is None:
            kept = start.held
            rest_length, force_density = (None, kept) if start.rest_length is None else (kept, None)
    if controller is None:
        rest_length, force_density = own_input(model, rest_length, force_density)
    what = _input_kind(model, rest_length, force_density, controller is not None, input)
    law: BaseController | None = None
    if controller is not None:
        law = (
            controller
            if isinstance(controller, BaseController)
            else as_controller(controller, model.structure, what, sample_time)
        )
    breaking = Faults(faults, float(np.ptp(model.structure.nodes, axis=1).max()), what)
    winch_count = None if law is None else len(law.commanded.strings)
    breaking.refuse_unknown(len(model.structure.strings), winch_count)
    stopped = None
    with interruptible() as interruption:  # CasADi may lose a key while it builds
        now = 0.0 if start is None else float(start.time[-1])
        span = now, now + duration
        held = None
        if controller is None:
            held = checked_inputs(model, rest_length, force_density, *span)
        offset = None
        if support_motion is not None:
            offset = support_offset(model, support_motion, *span)
        loop = Loop(
            model,
            input=what,
            load=load_in_time(model, external_force, *span),
            duration=duration,
            method=method,
            tolerance=tolerance,
            step=step,
            faults=breaking,
            project=project,
            machine_code=truth("machine_code", machine_code, "whether to compile the steps"),
            degree=_degree(held, what, winches),
            offset=offset,
            estimates_error=error == "estimate",
            watches_bars=limits.crossings is not None,
        )
        loop.error_limit = limits.position_error or loop.error_limit
        loop.given = _given(
            law is None,
            rest_length=rest_length,
            force_density=force_density,
            external_force=external_force,
            support_motion=support_motion,
        )
        loop.output_step = _output_step(loop, output_step, duration)
        loop.now = now
        if law is None and (
            winches is not None or sample_time is not None or estimator is not None
        ):
            raise ValueError("estimator, winches and sample_time go with a controller")
        N, V = _beside(loop, start, nodes, velocities)
        if start is None:
            first = None if held is None else held.at(np.zeros(1))[:, 0]
            state, loop.note = initial_state(model, N, V, loop.input, first)
        else:
            assert N is not None  # of the run
            assert V is not None  # of the run
            state = pack_state(model.structure, N, V)
        notes = [loop.note, _sampling_note(loop.given, *span)]
        loop.note = "; ".join(note for note in notes if note) or None
        try:
            end = loop.now + duration
            told = progress_bar(end, shown=True) if progress else long_run_note(loop.now, end)
            with told as loop.report:
                if law is None:
                    assert held is not None  # one of the two is given
                    loop.run(state, held, duration)
                else:
                    estimation = None if estimator is None else (estimator, sensors, seed)
                    used = nullcontext() if estimator is None else estimator.in_use
                    with law.in_use, used:
                        run_closed_loop(
                            loop, state, duration, law, rest_length, winches, sample_time,
                            estimation, start,
                        )  # fmt: skip
        except KeyboardInterrupt:
            if not loop.spans or interruption.whole:
                raise
            stopped = f"stopped at {loop.now:.6g} s of motion: interrupted"
        estimates = progress and error == "estimate" and stopped is None
        with progress_bar(duration, estimates, label="estimating error") as loop.report_of_error:
            run = loop.trajectory(stopped)
    if stopped is not None or interruption.signal is not None:
        what = stopped or "was interrupted at its end, and is complete"
        warnings.warn(f"the simulation {what}", InterruptionWarning, stacklevel=2)
    if stopped is None:
        check_health(run, limits)
        found = [] if run.control is None else run.control.problems
        if found:
            warnings.warn(
                f"under {type(controller).__name__} the run did not reach its goal: "
                f"{'; '.join(found)}. run.control.summary() says more",
                ControlWarning,
                stacklevel=2,
            )
    return run


def _given(in_open_loop: bool, **arguments: object) -> Given:
    """Return what is given of arguments; those of a controller's start are in its record."""
    kept = {name: value for name, value in arguments.items() if value is not None}
    if not in_open_loop:
        kept.pop("rest_length", None)
    plain = {
        name: value if changes_in_time(value) else np.asarray(value, dtype=float)
        for name, value in kept.items()
    }
    return Given(plain)


def _sampling_note(given: Given, start: float, end: float) -> str:
    """Return in which intervals functions of time are sampled, as text; empty if there are none."""
    names = [name for name, value in given.raw.items() if callable(value)]
    if not names:
        return ""
    interval = sampling_interval(start, end)
    return f"{' and '.join(names)} sampled every {interval:.2g} s: shorter pulses may be missed"


def check_health(run: Trajectory, limits: HealthLimits) -> None:
    """Warn or raise where the motion passes a limit."""
    health = run.health_of(limits.names)
    every = limits.passed(health)
    limits = replace(limits, crossings=None)
    passed = limits.passed(health)
    crossed = "; ".join(text for text in every if text not in passed)
    if crossed and limits.action == "raise":
        raise SimulationError(crossed, run)
    if crossed:
        warnings.warn(crossed, BarCrossingWarning, stacklevel=3)
    if not passed:
        return
    text = "; ".join(passed)
    # How deep nodes sink, a fall, and steps of motors are no errors of the integration.
    if replace(limits, penetration=None, fall=None, rest_length_error=None).passed(health):
        text += f": the motion may not be accurate. Try {finer(run.choice)}"
    if health.trusted_until is not None and health.trusted_until < run.time[-1]:
        text += "; a motion that magnifies errors can only be foretold for a time, see run.error"
    if limits.action == "raise":
        raise SimulationError(text, run)
    warnings.warn(text, AccuracyWarning, stacklevel=3)


def finer(used: Choice) -> str:
    """Return what to try where a motion is not accurate."""
    return (
        "a smaller tolerance" if used.setting == "tolerance" else f"a step below {used.value:g} s"
    )


def _input_kind(
    model: Model,
    rest_length: object,
    force_density: object,
    is_controlled: bool,
    input: str | None,
) -> str:
    """Return what is held, after checking that the arguments say so without contradiction."""
    if is_controlled:
        if force_density is not None:
            raise ValueError("force_density is commanded by the controller; leave it out")
        if input is None:
            return "force_density" if model.strings is None else "rest_length"
        return choice("input", input, ("rest_length", "force_density"))
    if input is not None:
        raise ValueError("input goes with a controller; in open loop the given input is held")
    if (rest_length is None) == (force_density is None):
        found = "neither" if rest_length is None else "both"
        raise ValueError(
            f"expected one of rest_length, force_density and controller; found {found} of the "
            "first two and no controller"
        )
    return "force_density" if rest_length is None else "rest_length"


def _output_step(loop: Loop, output_step: float | None, duration: float) -> float:
    """Return the time between states kept, after checking that they can be kept."""
    if output_step is not None:
        name, value = "output_step", positive_number("output_step", output_step, "s")
    elif loop.step is not None:
        name, value = "step", loop.step
    else:
        return duration / _OUTPUTS
    if loop.step is not None:
        refuse_time(f"step is {loop.step:g} s", duration / loop.step, "steps", 1e-6)
    size = 8 * 2 * loop.model.structure.nodes.size
    keep = ". A longer output_step keeps fewer"
    refuse_memory(f"{name} is {value:g} s", duration / value, "states", size, keep)
    return value


def _degree(held: Pieces | None, what: str, winches: object) -> int:
    """Return the degree of the polynomials in time that the inputs of the strings are."""
    if held is not None:
        return held.degree
    return winches.degree if what == "rest_length" and isinstance(winches, Winches) else 0


def changes_in_time(value: object) -> bool:
    """Return whether an argument may change in time."""
    return isinstance(value, Profile) or callable(value)


def checked_inputs(
    model: Model, rest_length: object, force_density: object, start: float, end: float
) -> Pieces:
    """Return what is held, or changes: the one of the two that is not None, checked."""
    name = "rest_length" if force_density is None else "force_density"
    value = rest_length if force_density is None else force_density
    if not changes_in_time(value):
        return Pieces.constant(held_value(model, rest_length, force_density))
    shape = (len(model.structure.strings),)
    pieces = as_pieces(name, value, shape, "one per string", start, end)
    least, time = pieces.least(start, end)
    round_off = _ROUND_OFF * float(np.abs(pieces.coefficients[:, :, 0]).max(initial=0.0))
    if least < -round_off or (least <= 0 and name == "rest_length"):
        what = "a positive length in m" if name == "rest_length" else "at least 0"
        raise ValueError(
            f"{name} falls to {least:.3g} at {time:.6g} s, expected {what}. Cubic interpolation "
            "may go below the values given; linear interpolation does not"
        )
    return pieces


def load_in_time(
    model: Model, external_force: object, start: float, end: float
) -> FloatArray | Pieces:
    """Return all that acts on the nodes from outside, N, shape (d, n), or in time."""
    if not (model.has_external_force and changes_in_time(external_force)):
        return checked_load(model, external_force)
    shape = model.structure.nodes.shape
    pieces = as_pieces("external_force", external_force, shape, "one force per node", start, end)
    return Pieces.added([pieces, Pieces.constant(model.constant_force.ravel(order="F"))])


def _beside(
    loop: Loop, start: Trajectory | None, nodes: object, velocities: object
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return nodes and velocities at the start beside the motion of supports, and tell the loop.

    None for what is not given.
    """
    structure = loop.model.structure
    if loop.offset is None and start is None:
        given = ("nodes", nodes), ("velocities", velocities)
        N, V = (None if v is None else structure.checked_nodes(name, v) for name, v in given)
        return N, V
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    V = None if velocities is None else structure.checked_nodes("velocities", velocities)
    if start is not None:
        N, V = start.nodes[:, :, -1], start.velocities[:, :, -1]
    carried = carried_by_supports(structure)
    before = np.zeros_like(N) if V is None else np.where(carried >= 0, V[:, carried], 0.0)
    if loop.offset is None and before.any():
        raise ValueError("supports move at the end of start: give support_motion, how they go on")
    if loop.offset is not None:
        loop.offset_rate = before.ravel(order="F")
        displaced = loop.offset.at(np.array([loop.now])).reshape(N.shape, order="F")
        N = N if nodes is None and start is None else N - displaced
    try:
        refuse_moved_supports("nodes" if start is None else "start", structure, N)
    except ValueError as error:
        if loop.offset is None:
            raise
        by = f"less what support_motion displaces it by at {loop.now:g} s"
        raise ValueError(f"{error}, {by}") from None
    return N, np.zeros_like(N) if V is None else V - before


def checked_load(model: Model, external_force: object) -> FloatArray:
    """Return all that acts on the nodes from outside, N, shape (d, n)."""
    if external_force is not None:
        return given_load(model, external_force) + model.constant_force
    if model.has_external_force:
        d = model.structure.dimension
        raise ValueError(f"the model takes a load: give external_force, shape ({d}, n), N, or 0")
    return model.constant_force


def initial_state(
    model: Model, nodes: object, velocities: object, input: str, held: FloatArray | None = None
) -> tuple[FloatArray, str | None]:
    """Return the state at the start, and what was put right, after checking the structure is in it.

    ``held`` is the input at the start, if it is known: forces give the structure its speed.
    """
    if nodes is None and velocities is None:  # depends on nothing but the model
        key = "state at rest", input
        build = lambda: frozen(_checked_state(model, None, None, input, None)[0])  # noqa: E731
        return model.prepared.get(key, build), None
    return _checked_state(model, nodes, velocities, input, held)


def _checked_state(
    model: Model, nodes: object, velocities: object, input: str, held: FloatArray | None
) -> tuple[FloatArray, str | None]:
    structure = model.structure
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    V = np.zeros_like(N)
    if velocities is not None:
        V = structure.checked_nodes("velocities", velocities)
    bars = structure.bar_vectors(N)
    length = np.linalg.norm(bars, axis=0)
    off = float(np.abs(length / structure.bar_length - 1).max(initial=0.0))
    if off > _PROJECTED:
        refuse_wrong_bar_lengths("nodes", structure, N)
    refuse_moved_supports("nodes", structure, N)
    rows = structure.fixed_rows
    moving = rows[V.ravel(order="F")[rows] != 0]
    if len(moving):
        node, axis = divmod(int(moving[0]), structure.dimension)
        if node in structure.fixed:
            what = f"the fixed node {node} by {V[:, node]} m/s"
        else:
            what = f"node {node}, on a roller, by {V[axis, node]:g} m/s along {'xyz'[axis]}"
        raise ValueError(f"velocities move {what}, expected 0")
    if input == "rest_length":
        refuse_strings_without_length("nodes", structure, N)
    state = pack_state(structure, N, V)
    stretching = np.abs((bars * structure.bar_vectors(V)).sum(axis=0)) / structure.bar_length
    worst = float(stretching.max(initial=0.0))
    if off <= _EXACT and worst <= _EXACT * float(np.abs(V).max()):
        return state, None
    equation = model.equation(input)
    if held is None:
        held = structure.string_length(N) * (input == "rest_length")
    speed = float(state_scale(equation, state, held, largest_frequency(equation, state, held))[-1])
    if off <= _EXACT and worst <= _ROUND_OFF * speed:
        return state, None
    if worst > max(_PROJECTED * float(np.abs(V).max()), _LEFT * speed):
        raise ValueError(
            f"velocities stretch bar {stretching.argmax()} at {worst:.3g} m/s, expected 0: bars "
            "are rigid. plant.to_velocities(q, rates) gives velocities that bars can have"
        )
    exact = Projector(equation, True)(state[:, None])
    if not exact.size:
        raise ValueError(
            f"in nodes, bars are off by {off:.1e} of their length, and those that share nodes "
            "cannot all be given theirs near by: start from a shape that is nearer"
        )
    return exact[:, 0], (
        f"bars made rigid: off by {off:.1e} of their length, stretching at {worst:.1e} m/s"
    )
