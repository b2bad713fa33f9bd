"""Error against run time of our methods and of peers, on the user's own motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from tenscontrol.accuracy.case import Case, as_case
from tenscontrol.accuracy.converged_motion import ConvergedMotion, converged_motion
from tenscontrol.accuracy.growth import Predictability, predictability
from tenscontrol.accuracy.methods import as_taken, checked_settings, default_settings, method_named
from tenscontrol.accuracy.peer import Peer
from tenscontrol.accuracy.result import WorkPrecision
from tenscontrol.accuracy.runs import Bench, Measurement
from tenscontrol.integrate import METHODS, Method
from tenscontrol.progress import progress_bar
from tenscontrol.validation import instance, positive_number, truth, whole_number

if TYPE_CHECKING:
    from tenscontrol.scene import Scene


def work_precision(
    scene: Case | Scene,
    methods: Sequence[str] | None = None,
    settings: Mapping[str, Sequence[float]] | None = None,
    peers: Sequence[Peer] = (),
    reference: ConvergedMotion | None = None,
    repeats: int = 5,
    outputs: int = 100,
    finest: float = 1e-9,
    machine_code: bool = False,
    progress: bool = False,
) -> WorkPrecision:
    """Return error and run time of methods on one motion, each at several settings.

    Errors are distances of nodes from a reference whose own error is
    estimated. First a perturbation of the start is followed: where it grows so
    much that round-off alone would make errors of ``finest``, the comparison
    ends before, and the result says so. Run times are medians and of the
    integration alone; building and compiling come before and are given beside.

    Parameters
    ----------
    scene : Case or Scene
        Of a scene with a controller, the open loop with what its actuators
        hold at the start; the result says so.
    methods : sequence of str, optional
        Our own; all of them if not given.
    settings : mapping of str to sequence of float, optional
        Steps, s, or tolerances, by the name of a method or peer; steps that
        fit the case, or 1e-3 to 1e-12, where not given. No step is longer than
        from one output to the next.
    peers : sequence of Peer
        Integrators of other packages to measure beside.
    reference : ConvergedMotion, optional
        From :func:`converged_motion` of the same case; then nothing is cut.
    repeats : int
        Runs of which the median time is taken; fewer where they take seconds.
    outputs : int
        Times at which errors are looked at, equally spaced.
    finest : float
        Smallest error that is to be resolved, m.
    machine_code : bool
        Whether our own methods are compiled, where there is a C compiler. What
        that takes is in the build time, less where the code was in the cache.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    WorkPrecision

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name.
    ArithmeticError
        If the motion runs away.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> case = tc.Case(tc.Model(prism), 0.5, input="force_density", value=gamma)
    >>> found = tc.work_precision(
    ...     case, ["rk4"], {"rk4": [0.025, 0.0125]}, repeats=1, outputs=10)
    >>> coarse, fine = found.rows
    >>> coarse.steps, fine.steps, 12 < coarse.error / fine.error < 20
    (20, 40, True)
    """
    case = as_case(scene)
    finest = positive_number("finest", finest, "m")
    repeats = whole_number("repeats", repeats, least=1)
    outputs = whole_number("outputs", outputs, least=1)
    truth("machine_code", machine_code, "whether to compile our own methods")
    truth("progress", progress, "whether to show a progress bar")
    chosen = [method_named(name) for name in _names("methods", methods)]
    for i, peer in enumerate(peers):
        instance(f"peers[{i}]", peer, Peer, "make one by subclassing Peer")
    given = _checked_settings(settings, chosen, peers)
    wanted = {m: given.get(m.name) or default_settings(m, case) for m in chosen}
    other = [(p, x) for p in peers for x in given.get(p.name) or p.settings]
    total = 2 + sum(map(len, wanted.values())) + len(other)
    with progress_bar(total, progress, "measuring", "runs") as report:
        growth: Predictability | None = None
        if reference is None:
            full = case.duration
            growth = predictability(case, finest, report=lambda time: report(time / full))
            case = replace(case, duration=growth.horizon)
            cut = case.duration
            reference = converged_motion(case, outputs, lambda time: report(1 + time / cut))
        _refuse_other_times(reference, case)
        refusals = {peer.name: peer.refuse(case) for peer in peers}
        bench = Bench(case, reference, repeats, machine_code)
        spacing = case.duration / len(reference.time)
        own = [(m, x) for m in chosen for x in as_taken(m, wanted[m], spacing)]
        rows = tuple(_measured(bench, own, other, refusals, report))
        report(total)
    refused = tuple((name, why) for name, why in refusals.items() if why is not None)
    return WorkPrecision(case, rows, reference, growth, refused)


def _measured(
    bench: Bench,
    own: Sequence[tuple[Method, float]],
    other: Sequence[tuple[Peer, float]],
    refusals: Mapping[str, str | None],
    report: Callable[[float], None],
) -> Iterator[Measurement]:
    done = 2
    for method, setting in own:
        yield bench.own(method, setting)
        done += 1
        report(done)
    for peer, setting in other:
        if refusals[peer.name] is None:
            yield bench.peer(peer, setting)
        done += 1
        report(done)


def _names(argument: str, names: Sequence[str] | None) -> Sequence[str]:
    """Return names of methods, all if none are given."""
    if names is None:
        return tuple(METHODS)
    if isinstance(names, str):
        raise TypeError(f"{argument} is {names!r}, expected a sequence of names: [{names!r}]")
    if len(set(names)) != len(names):
        raise ValueError(f"{argument} is {list(names)}, expected each method once")
    return names


def _checked_settings(
    settings: Mapping[str, Sequence[float]] | None, methods: Sequence[Method], peers: Sequence[Peer]
) -> dict[str, tuple[float, ...]]:
    units = {method.name: "s" if method.setting == "step" else "1" for method in methods}
    units |= {peer.name: "s or 1" for peer in peers}
    found = {}
    for name, values in (settings or {}).items():
        if name not in units:
            raise ValueError(
                f"settings has the key {name!r}, expected one of what is run: {', '.join(units)}"
            )
        found[name] = checked_settings(f"settings[{name!r}]", values, units[name])
    return found


def _refuse_other_times(reference: ConvergedMotion, case: Case) -> None:
    instance("reference", reference, ConvergedMotion, "make one by converged_motion(case)")
    end = float(reference.time[-1])
    if abs(end / case.duration - 1) > 1e-12:
        raise ValueError(
            f"reference ends at {end:g} s, expected the duration of the case, {case.duration:g} s"
        )
    if reference.states.shape[0] != len(case.state):
        raise ValueError(
            f"reference has {reference.states.shape[0]} states, expected those of the case: "
            f"{len(case.state)}"
        )
