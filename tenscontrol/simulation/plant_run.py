"""The plant side of a simulation: integration span by span, the input a polynomial in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple
from weakref import ref

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.equation import (
    Equation,
    InputLayout,
    free_accelerations,
    unpack_states,
    with_derivatives,
)
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces, polynomial_at
from tenscontrol.fields import changed
from tenscontrol.integrate.core_scene import CoreScene, core_scene
from tenscontrol.integrate.integrator import (
    NO_WORK,
    IntegrationError,
    IntegrationInterrupt,
    Integrator,
    Span,
    SpanInputs,
    StepEnds,
    Work,
    steps_between,
)
from tenscontrol.integrate.methods import METHODS, Choice, choose
from tenscontrol.integrate.watched import Watched
from tenscontrol.interrupt import check
from tenscontrol.simulation.driven_bars import DrivenBars
from tenscontrol.simulation.faults import Faults
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.motion_functions import BLOCK, MotionFunctions
from tenscontrol.simulation.moving_supports import MovingSupports

# Spans from which on they are integrated together, where they can be.
_FEW_SPANS = 2


class StoppedError(Exception):
    """A motion that cannot go on; its cause is what stopped it."""


@dataclass(frozen=True, eq=False)
class Jump:
    """By how much velocities of supports, node by node, and rates of bar lengths jump, m/s."""

    supports: FloatArray | None
    bars: FloatArray | None


class RunSpan(NamedTuple):
    """The motion over a time in which the inputs are one polynomial."""

    time: FloatArray  # of the states kept, s
    states: FloatArray
    begin: FloatArray  # state at its beginning
    origin: float  # from which the polynomials count, s
    coefficients: FloatArray  # of all inputs
    released: float  # what strings cut by then had stored, J
    jump: Jump | None = None  # of velocities at its beginning
    whole: FloatArray | None = None  # the beginning, then the states, in one piece of memory
    ends: StepEnds | None = None  # of the steps, counted from the beginning

    def values(self, rows: slice, order: int = 0) -> FloatArray:
        """Return some of the inputs at the times kept, or their rates."""
        return polynomial_at(self.coefficients[rows], self.time - self.origin, order)


@dataclass(eq=False)
class PlantRun:
    """The plant side of a simulation: integration span by span, from a time on.

    The input is held, or a polynomial in time of at most ``degree``; so is a load, where it is
    given as pieces of polynomials, one row an entry of it, node by node. Where supports move,
    states are beside their displacement, see :class:`MovingSupports`.
    """

    model: Model
    input: str
    load: FloatArray | Pieces
    duration: float
    integration: Integration
    faults: Faults
    degree: int = 0
    supports: MovingSupports | None = None
    support_rate: FloatArray | None = None  # now, of all nodes, node by node, m/s
    bars: DrivenBars | None = None
    length_rate: FloatArray | None = None  # now, of all bars, m/s
    now: float = 0.0
    output_step: float = 0.0
    report: Callable[[float], None] | None = None  # of the time reached, s
    keeps_steps: bool = False  # whether ends of steps are kept beside states at outputs
    traces: bool = False  # whether all are, with what pulled; see Integrator.traces
    shortens: bool = False  # whether steps are shorter wherever they can; see Integrator.shorten
    spans: list[RunSpan] = field(init=False, default_factory=list)
    moves: bool = field(init=False, default=False)  # an input changes without a controller
    lost_energy: float = field(init=False, default=0.0)
    work: Work = field(init=False, default=NO_WORK)
    choice: Choice = field(init=False)
    integrator: Integrator = field(init=False)

    def __post_init__(self) -> None:
        self._method = self.integration.chosen
        self._given: Pieces | None = self.load if isinstance(self.load, Pieces) else None
        if self.supports is not None:
            self._given = self.supports.inputs(self.load)
        self.loads_given = self._given is not None
        if self.bars is not None:
            if not self.bars.is_commanded:
                known = [] if self._given is None else [self._given]
                self._given = Pieces.stacked([*known, self.bars.lengths])
            self.degree = max(self.degree, 2)  # of which a jump of a rate is made
        if self._given is not None:
            self.degree = max(self.degree, self._given.degree)
        self._equation = self._equation_of("auto")

    @property
    def equation(self) -> Equation:
        """The equations of motion, as they are asked for; an integrator may have another form."""
        return self._equation

    def _equation_of(self, form: str) -> Equation:
        model, load = self.model, None
        if not self.loads_given:
            assert not isinstance(self.load, Pieces)  # else they were given
            constant = model.constant_force
            load = None if self.load is constant else self.load - constant
        moved, driven = self.supports is not None, self.bars is not None

        def equation() -> Equation:
            return model.equation(
                self.input, load, form, degree=self.degree, load_input=self.loads_given,
                offset_input=moved, length_input=driven,
            )  # fmt: skip

        if load is not None or not model.is_small:  # or by another compiler the next time
            return equation()
        of = self.input, form, self.degree, self.loads_given, moved, driven
        return model.prepared.get(("equation of a run", of), equation)

    def _prepare(self, state: FloatArray, u: FloatArray) -> None:
        """Make the integrator, chosen for the scene if the user has not."""
        equation, method, how = self._equation, self._method, self.integration
        if method is None:
            chosen = choose(equation, state, u, self.duration, how.tolerance, how.step)
            method = METHODS[chosen.method]
        elif how.step is None:
            chosen = Choice(method.name, "tolerance", how.tolerance, "asked for")
        else:
            chosen = Choice(method.name, "step", how.step, "asked for")
        if equation.layout.degree and not method.follows:
            able = [name for name, candidate in METHODS.items() if candidate.follows]
            raise ValueError(
                f"method {method.name!r} takes inputs that are constant over a step only, but "
                f"an input changes in time; methods that follow it are: {able}. For a method of "
                "your own that evaluates the input by equation.ahead(u, t), give "
                "Method(follows=True)"
            )
        self.choice = chosen
        self.integrator = self.integrator_for(chosen.value, keeps_steps=self.keeps_steps)
        if self.shortens:
            self.integrator.shorten()
        self.choice = changed(chosen, back_end=self.integrator.back_end)

    def integrator_for(self, value: float, keeps_steps: bool = False) -> Integrator:
        """Return an integrator of the whole motion, with a step or tolerance.

        One that is watched begins with the method that was last at work.
        """
        last = self.last_method
        if self._method is None and self.choice.setting == "tolerance":
            begin = self.spans[0].time[0] if self.spans else self.now
            # A cycle of references would keep the memory of runs that are over.
            this = ref(self)

            def make(name: str) -> Integrator:
                run = this()
                assert run is not None  # it is there while it is integrated
                return run.made_by(name, value, keeps_steps)

            return Watched(self._equation, last, make, self.duration, float(begin))
        return self.made_by(last, value, keeps_steps)

    @property
    def final_choice(self) -> Choice:
        """The choice of the method, with its changes so far."""
        changes = self.integrator.changes
        return changed(self.choice, changes=changes) if changes else self.choice

    @property
    def last_method(self) -> str:
        """The method that was last at work, or is to begin."""
        changes = self.integrator.changes if self.spans else ()
        return changes[-1].method if changes else self.choice.method

    @property
    def order(self) -> int:
        """Order of the method that was last at work."""
        return (self._method or METHODS[self.last_method]).order

    @property
    def core(self) -> CoreScene | None:
        """The equation as the compiled core runs it, if it does."""
        return core_scene(self._equation)

    def made_by(self, name: str, value: float, keeps_steps: bool) -> Integrator:
        """Return the integrator of a method by name, with a step or tolerance."""
        method, equation, how = self._method or METHODS[name], self._equation, self.integration
        if method.differentiates:
            equation = with_derivatives(equation, self._equation_of)
        # Not what the user says of a method that he has not chosen, and that needs no projection.
        project = how.project if method.drifts or self._method is not None else None
        integrator = method.integrator(equation, value, self.choice.setting, project)
        integrator.keeps_steps, integrator.traces = keeps_steps, self.traces
        return integrator

    def go_to(self, time: float) -> None:
        """Set the clock to a time that differs by round-off: samples are counted, not added up."""
        self.now = time

    def run(
        self, state: FloatArray, held: FloatArray | tuple[FloatArray, FloatArray] | Pieces,
        duration: float, lengths: Pieces | None = None,
    ) -> FloatArray:  # fmt: skip
        """Integrate and return the state at the end.

        The input of the strings is held, or goes in a straight line from the first of two to the
        second, or comes in pieces. Spans end where a piece does, and where strings are cut.
        ``lengths`` are those of all bars, m, where a controller commands them.
        """
        if isinstance(held, tuple):
            held = Pieces.ramp(self.now, duration, *held)
        elif not isinstance(held, Pieces):
            held = Pieces.constant(held)
        if held.degree > self.degree:
            reason = f"found one of degree {held.degree}"
            raise ValueError(f"the run was made for inputs of degree {self.degree}, {reason}")
        end = self.now + duration
        inputs = held if len(held.start) == 1 else held.within(self.now, end)
        self.moves |= not inputs.is_constant
        if self._given is not None:
            others = self._given.within(self.now, end)
            self.moves |= not others.is_constant
            inputs = Pieces.stacked([inputs, others])
        if lengths is not None:
            inputs = Pieces.stacked([inputs, lengths])
        # Round-off of the times leaves no spans of no length.
        close = 1e-9 * duration
        within = self.now + close, end - close
        cuts = [] if len(inputs.start) == 1 else inputs.breaks(*within)
        if self.faults.cuts:
            cuts = sorted({*self.faults.cut_times(*within), *cuts})
        if not cuts:
            return self._run_span(state, inputs, duration, close)
        durations, now = list[float](), self.now
        for cut in cuts:
            durations.append(cut - now)
            now, duration = now + durations[-1], end - cut
        durations.append(duration)
        while durations:
            count = 0
            if len(durations) >= _FEW_SPANS and self.spans:
                count = self._run_spans(state, inputs, durations, close)
            if count:
                del durations[:count]
                state = self.spans[-1].states[:, -1]
            else:
                state = self._run_span(state, inputs, durations.pop(0), close)
        return state

    def _run_spans(
        self, state: FloatArray, inputs: Pieces, durations: list[float], close: float
    ) -> int:
        """Integrate over spans that need no other look than the first; return how many."""
        moved = self.supports is not None or self.faults.cuts
        if moved:
            return 0
        check()
        starts = np.array([self.now, *durations[:-1]]).cumsum()
        piece = inputs.index(starts + close)
        coefficients = inputs.with_degree(self.degree).coefficients[piece]
        if self.bars is not None:
            count = self._without_jumps(self.bars, coefficients, starts, inputs.origin[piece])
            if count < _FEW_SPANS:
                return 0
            starts, piece, coefficients = starts[:count], piece[:count], coefficients[:count]
            durations = durations[:count]
        held = coefficients.transpose(0, 2, 1).reshape(len(piece), -1)
        if self.degree:
            held = np.column_stack([held, starts - inputs.origin[piece]])
        lengths = np.array(durations)
        outputs = np.maximum(1, np.ceil(lengths / self.output_step - 1e-9)).astype(int)
        given = SpanInputs(held, lengths, outputs)
        advanced = self.integrator.advance_spans(state, given)
        done, lost = len(advanced.whole), self.lost_energy
        if not done:
            return 0
        last, of = outputs.cumsum(), np.repeat(np.arange(len(outputs)), outputs)
        nth = np.arange(1, len(of) + 1) - (last - outputs)[of]
        times = starts[of] + lengths[of] * nth / outputs[of]
        first, origins = 0, inputs.origin[piece].tolist()
        every = zip(
            advanced.whole, advanced.ends, last.tolist(), origins, coefficients, strict=False
        )
        for whole, ends, end, origin, own in every:
            states = whole[:, 1:]
            self.spans.append(
                RunSpan(times[first:end], states, state, origin, own, lost, None, whole, ends)
            )
            state, first = states[:, -1], end
        self.now = float(starts[done - 1] + lengths[done - 1])
        self.work += advanced.work
        if self.bars is not None:
            self.length_rate = self.spans[-1].values(self.length_rows, 1)[:, -1]
        if self.report is not None:
            self.report(self.now)
        return done

    def _without_jumps(
        self, bars: DrivenBars, coefficients: FloatArray, starts: FloatArray, origins: FloatArray
    ) -> int:
        """Return how many of the first spans begin without a jump of the rate of a bar."""
        before = self.length_rate
        for k, (start, origin) in enumerate(zip(starts, origins, strict=True)):
            rows = coefficients[k, self.length_rows]
            after = polynomial_at(rows, np.array([start - origin]), 1)[:, 0]
            if before is not None and bars.jump(before, after) is not None:
                return k
            if k + 1 < len(starts):
                before = polynomial_at(rows, np.array([starts[k + 1] - origin]), 1)[:, 0]
        return len(starts)

    def _release(self, state: FloatArray, time: float) -> None:
        """Count the energy that strings store which are cut at a time."""
        before = self.spans[-1].values(self.string_rows)[:, -1]
        after = self.faults.without_cut(before, time)
        if np.array_equal(before, after):
            return
        energy = "potential_energy" if self.input == "force_density" else "elastic_energy"
        inputs = np.column_stack([before, after])
        motion = (np.repeat(array, 2, axis=2) for array in self._motion(state))
        functions = MotionFunctions(self.model, self.supports is not None, inputs)
        (stored,) = functions.of(energy, *motion, inputs)
        self.lost_energy += float(stored[0, 0] - stored[0, 1])

    def _run_span(
        self, state: FloatArray, inputs: Pieces, duration: float, close: float
    ) -> FloatArray:
        """Integrate with the strings that are not cut by now, up to what is close."""
        soon = self.now + close
        if self.spans:
            self._release(state, soon)
        origin, coefficients = inputs.piece(soon)
        more = self.degree + 1 - coefficients.shape[1]
        if more:
            coefficients = np.pad(coefficients, ((0, 0), (0, more)))
        coefficients = self.faults.without_cut(coefficients, soon)
        held = self.packed(coefficients, self.now - origin)
        jump = None
        if self.supports is not None or self.bars is not None:
            jump = self._jump(origin, coefficients)
            state = self.pushed(state, held, jump)
        if not self.spans:
            self._prepare(state, held)
            first = np.array([self.now])
            self.spans.append(
                RunSpan(first, state[:, None], state, origin, coefficients, self.lost_energy)
            )
        outputs = steps_between(duration, self.output_step)

        def add(span: Span) -> None:
            times = start + duration * np.arange(1, span.states.shape[1] + 1) / outputs
            held = coefficients, self.lost_energy, jump
            self.spans.append(
                RunSpan(times, span.states, state, origin, *held, span.whole, span.ends)
            )
            self.work += span.work

        start, report = self.now, self.report
        # A motion from 0 tells the time reached as it is.
        reached = report if report is None or not start else lambda time: report(start + time)
        try:
            span = self.integrator.advance(state, held, duration, outputs, reached)
        except (IntegrationError, IntegrationInterrupt) as error:
            add(error.span)
            self.now = start + error.time
            if isinstance(error, IntegrationInterrupt):
                raise
            raise StoppedError(str(error)) from error
        add(span)
        self.now = start + duration
        if self.supports is not None:
            self.support_rate = self.spans[-1].values(self.offset_rows, 1)[:, -1]
        if self.bars is not None:
            self.length_rate = self.spans[-1].values(self.length_rows, 1)[:, -1]
        return span.states[:, -1]

    def _jump(self, origin: float, coefficients: FloatArray) -> Jump | None:
        """Return by how much velocities jump now, None if they do not."""
        supports = bars = None
        if self.supports is not None:
            supports = self._support_jump(origin, coefficients)
        if self.bars is not None:
            time, before = np.array([self.now - origin]), self.length_rate
            self.length_rate = polynomial_at(coefficients[self.length_rows], time, 1)[:, 0]
            if before is not None:
                bars = self.bars.jump(before, self.length_rate)
        return None if supports is None and bars is None else Jump(supports, bars)

    def _support_jump(self, origin: float, coefficients: FloatArray) -> FloatArray | None:
        """Return by how much the velocity of supports jumps now, None if it does not."""
        time = np.array([self.now - origin])
        rate = polynomial_at(coefficients[self.offset_rows], time, 1)[:, 0]
        jump = rate if self.support_rate is None else rate - self.support_rate
        self.support_rate = rate
        return jump if jump.any() else None

    def pushed(self, state: FloatArray, held: FloatArray, jump: Jump | None) -> FloatArray:
        """Return the state after a jump of the velocity of supports, or of rates of bar lengths.

        Accelerations are affine in loads and in L L̈: what a jump adds to these is its impulse.
        """
        if jump is None:
            return state
        taut = np.ones(self._equation.switches)
        held, pushed = self.impulse_inputs(self._equation.layout, held, jump)
        slope = Evaluator(self._equation.slope)
        before = slope(state, held, taut)[0].copy()
        change = slope(state, pushed, taut)[0] - before
        change[: len(state) // 2] = 0.0  # positions stay
        return np.asarray(state + change)

    def impulse_inputs(
        self, layout: InputLayout, held: FloatArray, jump: Jump
    ) -> tuple[FloatArray, FloatArray]:
        """Return inputs at rest and such whose accelerations are more by what a jump adds."""
        pushed, held = held.copy(), held.copy()
        if jump.supports is not None and self.supports is not None:
            pushed[layout.load_rows] -= self.supports.force(jump.supports)
        if jump.bars is not None:
            rows, length = layout.length_rows, layout.bar_lengths(ca.DM(held))[0].full().ravel()
            for u, acceleration in ((held, np.zeros_like(length)), (pushed, jump.bars)):
                coefficients = u[:-1].reshape(layout.degree + 1, layout.count)
                coefficients[:, rows] = 0.0
                coefficients[0, rows] = length
                # So that its second derivative is the jump, and at this time nothing else is.
                for power, factor in enumerate((u[-1] ** 2 / 2, -u[-1], 0.5)):
                    coefficients[power, rows] += factor * acceleration
        return held, pushed

    def motion(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities, shape (d, n) each, of a state now."""
        N, V = self._motion(state)
        return N[:, :, 0], V[:, :, 0]

    def acceleration(self, state: FloatArray, held: FloatArray) -> FloatArray:
        """Return the accelerations of all nodes now, shape (d, n), m/s², with an input held."""
        inputs = Pieces.constant(held)
        if self._given is not None:
            inputs = Pieces.stacked([inputs, self._given])
        origin, coefficients = inputs.with_degree(self.degree).piece(self.now)
        coefficients = self.faults.without_cut(coefficients, self.now)
        u = self.packed(coefficients, self.now - origin)
        structure = self.model.structure
        moved = free_accelerations(self._equation, state[:, None], u[:, None])[:, 0]
        if self.supports is not None:
            rows = coefficients[self.offset_rows]
            moved += polynomial_at(rows, np.array([self.now - origin]), 2)[:, 0]
        return moved.reshape(structure.nodes.shape, order="F")

    def _motion(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        offset = rate = None
        if self.supports is not None:
            offset = self.supports.displacement.at(np.array([self.now]))
            rate = self.support_rate
            rate = np.zeros_like(offset) if rate is None else rate[:, None]
        return self._moved(state[:, None], offset, rate)

    def _moved(
        self, states: FloatArray, offset: FloatArray | None, rate: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities, shape (d, n, T) each, of states beside an offset."""
        N, V = unpack_states(self.model.structure, states)
        if offset is None or rate is None:
            return N, V
        return N + offset.reshape(N.shape, order="F"), V + rate.reshape(V.shape, order="F")

    def all_nodes(
        self, states: FloatArray, coefficients: FloatArray, time: FloatArray
    ) -> FloatArray:
        """Return positions, then velocities, of all nodes, one column for each state.

        ``coefficients`` are those of all inputs, (rows, degree + 1, T), taken at times (T,).
        """
        offset = rate = None
        if self.supports is not None:
            offset, rate = (polynomial_at(coefficients[self.offset_rows], time, i) for i in (0, 1))
        parts = self._moved(states, offset, rate)
        return np.vstack([array.reshape(-1, states.shape[1], order="F") for array in parts])

    @property
    def string_rows(self) -> slice:
        """Rows of the inputs that are those of strings."""
        return slice(self._equation.layout.strings)

    @property
    def load_rows(self) -> slice:
        """Rows of the inputs that are loads."""
        return self._equation.layout.load_rows

    @property
    def offset_rows(self) -> slice:
        """Rows of the inputs that are displacements by supports."""
        return self._equation.layout.offset_rows

    @property
    def length_rows(self) -> slice:
        """Rows of the inputs that are lengths of bars."""
        return self._equation.layout.length_rows

    def packed(self, coefficients: FloatArray, time: float) -> FloatArray:
        """Return inputs as integrators take them, a time after their origin, s."""
        if not self.degree:  # values held are the input
            return coefficients[:, 0]
        return self._equation.layout.packed(coefficients, time)

    def all_values(self, rows: slice, order: int = 0) -> FloatArray:
        """Return some of the inputs at all times kept, or their rates, read-only."""
        first, is_one = self.spans[0].coefficients, True
        for span in self.spans:
            is_one &= span.coefficients is first
        # As a rule the first span, which is the start alone, has the inputs of the second one.
        if is_one:
            every = first[None, rows]
        else:
            every = np.stack([span.coefficients[rows] for span in self.spans])
        if not (order or (self.degree and every[:, :, 1:].any())):  # constant in each span
            columns, counts = every[:, :, 0], [len(span.time) for span in self.spans]
            if len(columns) == 1 or (columns == columns[0]).all():  # one, read at all times
                column = frozen(columns[0])
                return np.ndarray((len(column), sum(counts)), buffer=column, strides=(8, 0))
            return frozen(np.repeat(columns, counts, axis=0).T)
        values = np.hstack([s.values(rows, order) for s in self.spans])
        values.setflags(write=False)
        return values

    def all_motion(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities at all times kept, read-only; built block by block."""
        if self.supports is None and not len(self.model.structure.fixed_rows):
            return self._all_free()
        d, n = self.model.structure.nodes.shape
        shape = d, n, sum(len(s.time) for s in self.spans)
        nodes, velocities = np.empty(shape), np.empty(shape)
        place = 0
        for span in self.spans:
            for first in range(0, len(span.time), BLOCK):
                some = slice(first, first + BLOCK)
                offset = rate = None
                if self.supports is not None:
                    within, rows = (
                        span.time[some] - span.origin,
                        span.coefficients[self.offset_rows],
                    )
                    offset, rate = (polynomial_at(rows, within, order) for order in (0, 1))
                N, V = self._moved(span.states[:, some], offset, rate)
                columns = slice(place, place + N.shape[2])
                nodes[:, :, columns], velocities[:, :, columns] = N, V
                place = columns.stop
        for array in (nodes, velocities):
            array.setflags(write=False)
        return nodes, velocities

    def _all_free(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities at all times kept, read-only, in the memory of the states."""
        whole = self.spans[1].whole if len(self.spans) == 2 else None
        if whole is None:
            whole = np.concatenate([span.states for span in self.spans], axis=1)
        owner = whole if whole.base is None else whole.base
        owner.setflags(write=False)
        whole.setflags(write=False)
        return unpack_states(self.model.structure, whole)
