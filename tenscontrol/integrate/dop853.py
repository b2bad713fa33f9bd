"""The Dormand-Prince method of order 8 with error control."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import factorial
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.core.records import Progress
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Function, SharedEvaluator
from tenscontrol.dynamics.machine_code import compiled_source, compiler, if_compiled
from tenscontrol.integrate.core_run import advance_in_core, settings_of
from tenscontrol.integrate.core_scene import CoreMotion, core_scene
from tenscontrol.integrate.dop853_loop import loop_source
from tenscontrol.integrate.events import (
    FLAT,
    POLISHES,
    SAMPLES,
    approached,
    crossing,
    distance,
    interpolant,
    room_inside,
    search,
    switch_on_interpolant,
    switching,
    taut_strings,
    zooms,
)
from tenscontrol.integrate.integrator import (
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Integrator,
    Report,
    Span,
    Work,
    checked_tolerance,
    largest_frequency,
    power_iteration,
    state_scale,
)
from tenscontrol.integrate.projection import NOT_RIGID, Projector, projection
from tenscontrol.interrupt import check

# Evaluations of a step whose first slope is known, and of its interpolant.
_STAGES, _MORE_STAGES = 12, 3

# Coefficients of the interpolant.
_POWERS = 7

# Turns (steps tried) per call, interpreted and compiled, and the most numbers that they may record.
_TURNS, _COMPILED_TURNS = 32, 1024
_MOST_RECORDED = 4e6

# How the step follows the error: by a factor 0.75 error^(-1/8) within these bounds.
_SAFETY, _LEAST, _MOST, _ORDER = 0.75, 0.2, 10.0, 8

# A step shorter than this part of the span is lost in round-off.
_SHORTEST = 10 * np.finfo(float).eps

# A longer step, times the largest frequency, makes round-off grow, which no error estimate sees.
_STABLE = 4.0

# Where it limits the steps, this is what a tenth of the tolerance makes of them: its eighth root.
_SHORTER = 0.75

# What ending late at a switch may change of velocities, as part of what a step may err.
_LATE = 0.003

# Steps end at a switch on their interpolant where it errs less than this part of what they may err.
_SMOOTH = 0.3

# Switches in a row without any time between them, at most.
_MOST_STALLS = 50

# What a turn carries beside x, its slope and taut.
_CARRIED: tuple[str, ...] = ("time", "step", "stuck", "stalls", "tries", "rejections")
_CARRIED += ("landings", "approaches", "switches", "interpolants")


@final
class DOP853(Integrator):
    """Adaptive steps of order 8; the loop over the steps runs inside CasADi (``mapaccum``).

    Where a string can go slack, every step ends at each switch.

    Parameters
    ----------
    equation : Equation
    tolerance : float
        Error allowed a step, as part of the size of the structure for
        positions, and of its characteristic speed for velocities.
    project : bool
        Whether to make the bar lengths exact after each step.
    machine_code : bool
        Whether to compile the steps, where there is a C compiler.

    Notes
    -----
    E. Hairer, S. P. Nørsett & G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed.,
    II.5 (coefficients, error estimate) and II.6 (interpolant).
    """

    name = "dop853"

    def __init__(
        self, equation: Equation, tolerance: float, project: bool = True, machine_code: bool = False
    ) -> None:
        super().__init__(equation, project, machine_code)
        self._project = project
        self.tolerance = checked_tolerance(tolerance)
        self._frequency = 0.0  # largest, rad/s
        # Longest step over the largest frequency and of the span, and the first of the usual.
        self._shares = _STABLE, 1.0, 1.0
        self._held: FloatArray | None = None  # input for which it was found
        self._core = core_scene(equation)
        if self._core is not None:
            self.back_end, self._largest = "core", None
            return
        by = compiler() if machine_code else None
        built = self._kept(lambda: self._build(project, machine_code), project, machine_code, by)
        self._chunk, self._start, self._largest, self._turns, self.back_end, exact = built
        self._projected = Projector(equation, project, exact)

    @property
    def cost(self) -> float:
        """See :attr:`Integrator.cost`."""
        states = self._equation.states
        if self.back_end in ("core", "machine code"):
            return 0.02 + 0.005 * states
        return 5.0 + 0.025 * states if self._equation.form == "loops" else 0.3 + 0.1 * states

    def _build(self, project: bool, machine_code: bool) -> tuple[Any, ...]:
        """Return what `__init__` keeps."""
        equation = self._equation
        most = int(np.clip(_MOST_RECORDED / (8 * equation.states), 1, _COMPILED_TURNS))
        functions: tuple[ca.Function | None, ...] = ()
        back_end = "machine code for the forces"
        if equation.form != "loops":
            functions, back_end = _compiled_turns(equation, project, most, machine_code)
        if not functions:
            most = min(most, _TURNS)
            functions = _Turn(equation, project).function().mapaccum(most), None, None
        x, u, _, _ = equation.symbols(ca.MX)
        taut = taut_strings(equation, x, u)
        start = Function("start", [x, u], [taut, equation.slope(x, u, taut)])
        chunk, largest, exact = functions
        by = None if largest is None else SharedEvaluator(largest)
        return SharedEvaluator(chunk), SharedEvaluator(start), by, most, back_end, exact

    def shorten(self) -> None:
        """See :meth:`Integrator.shorten`."""
        self._shares = _SHORTER * _STABLE, 0.5, _SHORTER

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        state, held, duration, outputs = self._checked(state, held, duration, outputs, report)
        n, switches = self._equation.states, self._equation.switches
        before, of_strings = self._held, held[: self._equation.layout.strings]
        # The frequency is found again only where an input has changed by more than a fifth.
        if before is None or (np.abs(of_strings - before) > 0.2 * np.abs(before)).any():
            self._frequency = largest_frequency(self._equation, state, held, self._largest)
            self._held = of_strings.copy()
        scene = self._core
        if scene is None:
            taut, slope = self._start(state, held)
        else:
            slope = scene.slope(state, held, scene.taut(state, held))
        scale = state_scale(self._equation, state, held, self._frequency)
        stable, whole, first = self._shares
        step = first * _first_step(slope, scale, duration)
        spacing = duration / outputs
        times: FloatArray = np.linspace(0.0, duration, outputs + 1)[1:]
        states = np.empty((n, outputs))
        longest = min(stable / max(self._frequency, 1e-300), whole * duration)
        if scene is not None:
            allowed = self.tolerance * scale
            settings = settings_of(
                "dop853", duration, outputs, self._project, step, longest, allowed, self.limit
            )
            return advance_in_core(
                CoreMotion(scene, state, held, settings), _core_work, _core_failure, report
            )
        carried = np.concatenate([state, slope, taut, [0.0, step], np.zeros(len(_CARRIED) - 2)])
        given = np.concatenate([held, [duration, spacing, longest], self.tolerance * scale])
        if self._largest is None and self._turns > 1:  # a column for each turn of the graph
            given = np.tile(given[:, None], (1, self._turns))
        done, told = 0, dict.fromkeys(_CARRIED, 0.0)
        try:
            while told["time"] < duration:
                check()
                with self._chunk.outputs(carried, given) as (after, recorded):
                    carried = after.reshape(len(carried), -1, order="F")[:, -1].copy()
                    recorded = recorded.reshape(-1, self._turns, order="F").T
                    done = _interpolate(recorded, times[:-1], states, done)
                told = dict(zip(_CARRIED, carried[2 * n + switches :].tolist(), strict=True))
                if told["stuck"]:
                    raise IntegrationError(
                        f"dop853 stopped after {told['time']:.6g} s: its step fell to "
                        f"{told['step']:.1e} s, as the forces are no longer finite or change "
                        "without end",
                        told["time"],
                        Span(self._projected(states[:, :done]), _work(told)),
                    )
                if report is not None:
                    report(told["time"])
                if told["time"] < duration and _work(told).evaluations >= self.limit:
                    reached = Span(self._projected(states[:, :done]), _work(told))
                    raise IntegrationPause(told["time"], carried[:n], reached)
            exact = self._projected(states[:, :-1])
            if (count := exact.shape[1]) < outputs - 1:
                stopped = f"dop853 stopped after {spacing * count:.6g} s: {NOT_RIGID}"
                raise IntegrationError(stopped, spacing * count, Span(exact, _work(told)))
            states[:, :-1] = exact
            states[:, -1] = carried[:n]
            return Span(states, _work(told))
        except KeyboardInterrupt:
            reached = Span(self._projected(states[:, :done]), _work(told))
            raise IntegrationInterrupt(told["time"], reached) from None


def _compiled_turns(
    equation: Equation, project: bool, count: int, wanted: bool
) -> tuple[tuple[ca.Function, ...], str]:
    """Return so many turns of the loop in C, what finds the largest frequency, and a projection.

    Or nothing, where it is not wanted, or no compiler works.
    """
    if not wanted or compiler() is None:
        return (), "virtual machine"
    exact = projection(equation) if project else None
    functions = [equation.slope, *([] if exact is None else [exact])]
    if equation.switches:
        functions += [each(equation) for each in (crossing, distance, switching)]
        functions += [interpolant(equation), room_inside(equation)]
        functions.append(switch_on_interpolant(equation, 0.0))
    functions.append(power_iteration(equation))
    n = equation.states
    sizes = {
        "STATES": n, "INPUTS": equation.inputs, "SWITCHES": equation.switches,
        "DEGREE": equation.layout.degree, "TURNS": count, "RECORD": 3 + n * (1 + _POWERS),
        "POLISHES": POLISHES, "MOST_STALLS": _MOST_STALLS,
        "SAMPLES": SAMPLES, "ZOOMS": zooms(equation),
    }  # fmt: skip
    numbers = {
        "SAFETY": _SAFETY, "LEAST": _LEAST, "MOST": _MOST, "ORDER": _ORDER, "STABLE": _STABLE,
        "SHORTEST": _SHORTEST, "TWICE_LATE": 2 * _LATE, "MORE": 1 + 1e-14, "SMOOTH": _SMOOTH,
        "FLAT": FLAT,
    }  # fmt: skip
    source = loop_source(functions, sizes, numbers, _CARRIED, _coefficients(), _interpolant_error())
    code = if_compiled(lambda: compiled_source(source, ("turns", "largest", "exact")))
    return ((), "virtual machine") if code is None else (code, "machine code")


def _coefficients() -> Any:
    from scipy.integrate import DOP853

    return DOP853


@cache
def _interpolant_error() -> tuple[float, ...]:
    """Return what the interpolant errs at a part of a step, as part of the error estimate.

    Of an equation that is linear, at the leading order: both are then multiples of the same term in
    h⁸. Coefficients of the polynomial in the part, from the lowest on.
    """
    method, count = _coefficients(), _STAGES + 1 + _MORE_STAGES
    A = np.zeros((count, count))
    A[:_STAGES, :_STAGES], A[_STAGES, :_STAGES] = method.A, method.B
    A[_STAGES + 1 :] = method.A_EXTRA
    # Slopes of the stages at each order of h, from 0 to 7.
    slopes = [np.linalg.matrix_power(A, order) @ np.ones(count) for order in range(_ORDER)]
    last, s = slopes[-1], np.polynomial.Polynomial([0.0, 1.0])
    step = method.B @ last[:_STAGES]
    found = np.polynomial.Polynomial([0.0])
    made = [step, last[0] - step, 2 * step - last[0] - last[_STAGES], *(method.D @ last)]
    for k in reversed(range(_POWERS)):
        found = (found + made[k]) * (1 - s if k % 2 else s)
    third, fifth = (e @ slopes[k][: _STAGES + 1] for e, k in ((method.E3, 3), (method.E5, 5)))
    true = s**_ORDER / factorial(_ORDER)
    # The estimate is the fifth by the root of its square and of a hundredth of that of the third.
    return tuple(((true - found) * 0.1 * abs(third) / fifth**2).coef.tolist())


def _work(told: dict[str, float]) -> Work:
    tries, landings = round(told["tries"]), round(told["landings"])
    return Work(
        steps=tries - round(told["rejections"]),
        rejections=round(told["rejections"]),
        evaluations=1
        # A landing takes a new start.
        + _STAGES * (tries + round(told["approaches"]))
        + landings
        + _MORE_STAGES * round(told["interpolants"]),
        switches=round(told["switches"]),
    )


def _core_work(progress: Progress) -> Work:
    return _work({name: getattr(progress, name) for name, _ in Progress._fields_})


def _core_failure(motion: CoreMotion) -> IntegrationError:
    progress = motion.progress
    return IntegrationError(
        f"dop853 stopped after {progress.time:.6g} s: its step fell to {progress.step:.1e} s, as "
        "the forces are no longer finite or change without end",
        progress.time,
        Span(motion.states[: motion.done].T, _core_work(progress)),
    )


def _interpolate(recorded: FloatArray, times: FloatArray, states: FloatArray, done: int) -> int:
    """Fill in states at times that the recorded steps (rows) reach, and return how many are."""
    n = len(states)
    made = np.flatnonzero(recorded[:, 1] > 0)
    if not made.size:
        return done
    # A step that reaches a time but for round-off, as one to a switch may, was recorded for it.
    ends = (recorded[made, 0] + recorded[made, 2]) * (1 + 2e-14)
    reached = int(np.searchsorted(times, ends[-1], side="right"))
    now = times[done:reached]
    within = recorded[made[np.minimum(np.searchsorted(ends, now), len(ends) - 1)]]
    part = (now[:, None] - within[:, :1]) / within[:, 1:2]
    # Coefficient k counts by k factors: the part, what is left of the step, and so on in turns.
    factors = np.ones((len(now), 1 + _POWERS))
    factors[:, 1::2], factors[:, 2::2] = part, 1 - part
    made_of = within[:, 3:].reshape(len(now), -1, n)
    states[:, done:reached] = np.einsum("tk,tkn->nt", np.cumprod(factors, axis=1), made_of)
    return reached


def _first_step(slope: FloatArray, scale: FloatArray, duration: float) -> float:
    """Return a step that moves the state by a hundredth of its scale."""
    speed = float(np.max(np.abs(slope) / scale, initial=0.0))
    return min(duration, 0.01 / speed) if speed > 0 else duration


class _Turn:
    """One turn of the loop: a step is tried, then accepted, cut at a switch, or thrown away."""

    def __init__(self, equation: Equation, project: bool) -> None:
        self._equation = equation
        self._method = _DormandPrince(equation, project)
        self._tried, self._interpolant = self._method.tried(), self._method.interpolant()
        n = equation.states
        self._sizes = [n, n, equation.switches, *[1] * len(_CARRIED)]
        self._given_sizes = [equation.inputs, 1, 1, 1, n]
        self._carried = _symbols(("x", "f", "taut", *_CARRIED), self._sizes)
        self._numbers = self._carried[3:]
        names = ("u", "duration", "spacing", "longest", "scale")
        given = _symbols(names, self._given_sizes)
        self._u, self._duration, self._spacing, self._longest, self._scale = given
        self._inputs = [*self._carried, *given]
        # The step tried.
        self._h, self._x1, self._f1, self._error = _symbols(("h", "x1", "f1", "e"), (1, n, n, 1))
        self._K = ca.MX.sym("K", n, _STAGES + 1)
        self._step = [self._h, self._x1, self._f1, self._error, self._K]
        self._nothing = ca.DM.zeros(3 + n * (1 + _POWERS))

    def function(self) -> ca.Function:
        """Return ``(z, given) -> (z, record)``, for ``mapaccum``.

        The record is the time at which the step began, the length of its interpolant, how much
        of that was taken, x there, and the coefficients; zeros where no output lies in it.
        """
        z, given = ca.MX.sym("z", sum(self._sizes)), ca.MX.sym("given", sum(self._given_sizes))
        carried = ca.vertsplit(z, _ends(self._sizes))
        parts = [*carried, *ca.vertsplit(given, _ends(self._given_sizes))]
        kept = self._branch("kept", self._carried, self._nothing, self._inputs)
        time, stuck, duration = parts[3], parts[5], parts[-4]
        over = ca.logic_or(time >= duration, stuck)
        choose = ca.Function.if_else("turn_or_not", kept, self._going())
        return Function("turn", [z, given], list(choose(over, *parts)))

    def _going(self) -> ca.Function:
        x, f, taut = self._carried[:3]
        time, step = self._numbers[:2]
        h = ca.fmin(ca.fmin(step, self._longest), self._duration - time)
        u = self._input
        x1, f1, error, K = self._tried(x, f, u, taut, h, self._scale)
        crossed: Any = 0
        branches = [self._thrown_away(), self._accepted()]
        if self._equation.switches:
            crossed = crossing(self._equation)(x, x1, u, taut, h)
            branches.append(self._cut())
        fate = ca.if_else(error < 1, 1 + crossed, 0)
        choose = ca.Function.conditional("fate", branches[:-1], branches[-1])
        outputs = choose(fate, *self._inputs, h, x1, f1, error, K)
        return Function("going", self._inputs, list(outputs))

    @property
    def _input(self) -> Any:
        """The input that begins with the step."""
        return self._equation.ahead(self._u, self._numbers[0])

    def _thrown_away(self) -> ca.Function:
        finite = self._error < ca.inf
        factor = ca.if_else(finite, ca.fmin(self._factor(), 1), _LEAST / 2)
        shorter = self._h * factor
        numbers = self._counted(
            step=shorter, tries=1, rejections=1, stuck=shorter < _SHORTEST * self._duration
        )
        return self._branch("thrown_away", [*self._carried[:3], *numbers], self._nothing)

    def _accepted(self) -> ca.Function:
        x, f, taut = self._carried[:3]
        time = self._after(self._h)
        record, made = self._recorded(x, self._x1, f, self._f1, self._K, time, self._h)
        step = self._h * self._factor()
        numbers = self._counted(time=time, step=step, tries=1, interpolants=made)
        return self._branch("accepted", [self._x1, self._f1, taut, *numbers], record)

    def _cut(self) -> ca.Function:
        x, f, taut = self._carried[:3]
        u, h, equation = self._input, self._h, self._equation
        # What ending late may change of velocities, as part of what a step may err; see landing().
        speed = self._scale[equation.states - 1]
        allowed = 2 * _LATE * speed * (self._longest / _STABLE) ** 2
        found = search(equation)(x, taut, u, h, self._x1, f, self._f1, allowed)
        switch = [ca.MX.sym("switch", each.sparsity()) for each in found]
        errs = self._error * ca.fabs(ca.polyval(ca.DM(_interpolant_error()[::-1]), found[1]))
        choose = ca.Function.if_else("where", self._cut_inside(switch), self._cut_by_steps(switch))
        is_inside = ca.logic_and(found[0], errs < _SMOOTH)
        inputs = [*self._inputs, *self._step]
        return Function("cut", inputs, list(choose(is_inside, *inputs, *found)))

    def _cut_inside(self, switch: list[Any]) -> ca.Function:
        """Return the branch of a step that ends at a switch on its interpolant."""
        x, f, taut = self._carried[:3]
        u, h = self._input, self._h
        made = ca.vec(self._interpolant(x, self._x1, f, self._f1, self._K, u, taut, h))
        approach = approached(self._method.inside(), self._equation)
        y = ca.vertcat(x, made, h)
        x2, taut2, taken, switched, _ = approach(y, taut, u, h, self._x1, *switch)
        needed = self._needed(self._after(taken))
        record = ca.vertcat(self._numbers[0], h * needed, taken, x, made)
        return self._landed(switch, x2, taut2, taken, switched, record, interpolants=1)

    def _cut_by_steps(self, switch: list[Any]) -> ca.Function:
        """Return the branch of a step that ends at a switch, found by true steps."""
        x, f, taut = self._carried[:3]
        n, u = self._equation.states, self._input
        approach = approached(self._method.trial(), self._equation)
        y, y1 = ca.vertcat(x, f), ca.vertcat(self._x1, self._f1, ca.vec(self._K))
        y2, taut2, taken, switched, tries = approach(y, taut, u, self._h, y1, *switch)
        x2, f2, K2 = y2[:n], y2[n : 2 * n], ca.reshape(y2[2 * n :], n, _STAGES + 1)
        record, made = self._recorded(x, x2, f, f2, K2, self._after(taken), taken)
        return self._landed(
            switch, x2, taut2, taken, switched, record, interpolants=made, approaches=tries
        )

    def _landed(
        self, switch: list[Any], x: Any, taut: Any, taken: Any, switched: Any, record: Any,
        **counted: Any,
    ) -> ca.Function:  # fmt: skip
        """Return the branch of a step cut at a switch, where it ends in x."""
        # Strings that switch again and again while no time passes.
        stalled = taken < _SHORTEST * self._duration
        stalls = ca.if_else(stalled, self._numbers[_CARRIED.index("stalls")] + 1, 0)
        numbers = self._counted(
            time=self._after(taken),
            step=self._h * ca.fmin(self._factor(), 1),
            tries=1,
            landings=1,
            switches=switched,
            stalls=stalls,
            stuck=stalls > _MOST_STALLS,
            **counted,
        )
        # The slope jumps with the strings.
        f = self._equation.slope(x, self._equation.ahead(self._input, taken), taut)
        inputs = [*self._inputs, *self._step, *switch]
        return self._branch("landed", [x, f, taut, *numbers], record, inputs)

    def _branch(
        self, name: str, state: list[Any], record: Any, inputs: list[Any] | None = None
    ) -> ca.Function:
        inputs = [*self._inputs, *self._step] if inputs is None else inputs
        outputs = [ca.densify(ca.vertcat(*state)), ca.densify(record)]
        return Function(name, inputs, outputs)

    def _factor(self) -> Any:
        error = ca.fmax(self._error, 1e-16)
        return ca.fmin(ca.fmax(_SAFETY * error ** (-1 / _ORDER), _LEAST), _MOST)

    def _after(self, taken: Any) -> Any:
        """Return the time after the step: the end of the span exactly, if it was to be reached."""
        time = self._numbers[0]
        return ca.if_else(taken >= self._duration - time, self._duration, time + taken)

    def _recorded(self, x: Any, x1: Any, f: Any, f1: Any, K: Any, after: Any, h: Any) -> Any:
        """Return the record of a step, and whether an output lies in it."""
        time = self._numbers[0]
        names = ["x", "x1", "f", "f1", "K", "u", "taut", "h"]
        values = [x, x1, f, f1, K, self._input, self._carried[2], h]
        inputs = [ca.MX.sym(name, v.sparsity()) for name, v in zip(names, values, strict=True)]
        made = ca.vertcat(inputs[0], ca.vec(self._interpolant(*inputs)))
        left_out = Function("left_out", inputs, [ca.DM.zeros(made.shape)])
        made = Function("made", inputs, [made])
        choose = ca.Function.if_else("interpolant_or_not", made, left_out)
        needed = self._needed(after)
        return ca.vertcat(time, h * needed, h, choose(needed, *values)), needed

    def _needed(self, after: Any) -> Any:
        """Return whether an output lies in a step that ends at a time."""
        time = self._numbers[0]
        until, since = (ca.floor(t / self._spacing * (1 + 1e-14)) for t in (after, time))
        # The end of the span needs no interpolant.
        inside = ca.logic_or(after < self._duration, time + self._spacing < after)
        return ca.logic_and(until > since, inside)

    def _counted(self, **changes: Any) -> list[Any]:
        """Return the numbers carried: those given replaced, the counts added to."""
        replaced = ("time", "step", "stuck", "stalls")
        return [
            changes.get(name, old) if name in replaced else old + changes.get(name, 0)
            for name, old in zip(_CARRIED, self._numbers, strict=True)
        ]


def _symbols(names: tuple[str, ...], sizes: Sequence[int]) -> list[Any]:
    return [ca.MX.sym(name, size) for name, size in zip(names, sizes, strict=True)]


def _ends(sizes: list[int]) -> list[int]:
    return [sum(sizes[:i]) for i in range(len(sizes) + 1)]


class _DormandPrince:
    """One step of the method for fixed ``taut``, as CasADi functions."""

    def __init__(self, equation: Equation, project: bool = False) -> None:
        self._equation = equation
        self._project = projection(equation) if project else None
        self._method = _coefficients()
        x, *rest = equation.symbols(ca.MX)
        self._inputs = [x, ca.MX.sym("f", x.shape), *rest]

    def _stages(self) -> tuple[Any, list[Any]]:
        """Return x after the step, and the slopes of its stages."""
        x, f, _, taut, h = self._inputs
        slopes = [f]
        for a, c in zip(self._method.A[1:], self._method.C[1:], strict=True):
            slopes.append(self._equation.slope(x + h * _combined(slopes, a), self._at(c), taut))
        x1 = x + h * _combined(slopes, self._method.B)
        return x1 if self._project is None else self._project(x1), slopes

    def _at(self, part: float) -> Any:
        """Return the input that begins after a part of the step."""
        _, _, u, _, h = self._inputs
        return self._equation.ahead(u, part * h)

    def trial(self) -> ca.Function:
        """Return ``([x; f], u, taut, h) -> [x1; f1; K]``: the step alone, without its error."""
        x, _, u, taut, h = self._inputs
        x1, slopes = self._stages()
        f1 = self._equation.slope(x1, self._at(1.0), taut)
        stages = Function("stages", self._inputs, [ca.vertcat(x1, f1, *slopes, f1)])
        y = ca.MX.sym("y", 2 * x.shape[0])
        end = stages(*ca.vertsplit(y, x.shape[0]), u, taut, h)
        return Function("trial", [y, u, taut, h], [end])

    def inside(self) -> ca.Function:
        """Return ``([x; coefficients; h], u, taut, taken) -> x1`` on the interpolant of a step."""
        x, _, u, taut, taken = self._inputs
        n = x.shape[0]
        y = ca.MX.sym("y", (1 + _POWERS) * n + 1)
        *made, h = ca.vertsplit(y, [*range(0, (2 + _POWERS) * n, n), y.shape[0]])
        value, part = ca.MX.zeros(n), taken / h
        for k in range(_POWERS, 0, -1):
            value = (value + made[k]) * (part if k % 2 else 1 - part)
        end = made[0] + value
        return Function(
            "inside", [y, u, taut, taken], [end if self._project is None else self._project(end)]
        )

    def tried(self) -> ca.Function:
        """Return ``(x, f, u, taut, h, scale) -> (x1, f1, error, K)``.

        The error is the root mean square over the state, as part of ``scale``.
        """
        x, _, _, taut, h = self._inputs
        scale = ca.MX.sym("scale", x.shape)
        x1, slopes = self._stages()
        f1 = self._equation.slope(x1, self._at(1.0), taut)
        slopes.append(f1)
        fifth, third = (
            ca.sumsqr(_combined(slopes, e) / scale) for e in (self._method.E5, self._method.E3)
        )
        # Nothing moves: no error. Slopes whose squares overflow: a step far too long, no quotient.
        below = ca.sqrt((fifth + 0.01 * third) * x.shape[0])
        usual = ca.logic_and(below > 0, below < ca.inf)
        error = ca.if_else(usual, h * fifth / below, below)
        outputs = [x1, f1, error, ca.horzcat(*slopes)]
        return Function("tried", [*self._inputs, scale], outputs)

    def interpolant(self) -> ca.Function:
        """Return ``(x, x1, f, f1, K, u, taut, h) -> coefficients``, one column each."""
        x, f, u, taut, h = self._inputs
        x1, f1 = ca.MX.sym("x1", x.shape), ca.MX.sym("f1", x.shape)
        K = ca.MX.sym("K", x.shape[0], _STAGES + 1)
        slopes = ca.horzsplit(K)
        for a, c in zip(self._method.A_EXTRA, self._method.C_EXTRA, strict=True):
            slopes.append(self._equation.slope(x + h * _combined(slopes, a), self._at(c), taut))
        step = x1 - x
        first = [step, h * f - step, 2 * step - h * (f1 + f)]
        rest = [h * _combined(slopes, d) for d in self._method.D]
        inputs = [x, x1, f, f1, K, u, taut, h]
        return Function("interpolant", inputs, [ca.horzcat(*first, *rest)])


def _combined(slopes: list[Any], weights: Any) -> Any:
    """Return the sum of slopes with weights; many weights are zero."""
    used = [i for i in range(len(slopes)) if weights[i] != 0]
    return ca.mtimes(ca.horzcat(*(slopes[i] for i in used)), ca.DM(weights[used]))
