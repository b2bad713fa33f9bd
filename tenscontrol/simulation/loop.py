"""The plant side of a simulation: integration span by span, the input a polynomial in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from math import ceil
from typing import Any

import numpy as np

from tenscontrol.dynamics import (
    Equation,
    Evaluator,
    Model,
    Pieces,
    as_pieces,
    polynomial_at,
    unpack_states,
)
from tenscontrol.integrate import (
    METHODS,
    Choice,
    IntegrationError,
    IntegrationInterrupt,
    Integrator,
    Method,
    Span,
    Watched,
    Work,
    choose,
    method_of,
)
from tenscontrol.interrupt import finishing
from tenscontrol.properties import cached_property
from tenscontrol.simulation.contacts import Segments, record_contacts
from tenscontrol.simulation.error_estimate import Motion, Path, Stage
from tenscontrol.simulation.faults import Faults
from tenscontrol.simulation.health import BLOCK, ERROR_LIMIT, ControlRecord, Given, Quantities
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure import BarMotion, carried_by_supports, node_mass
from tenscontrol.validation import FloatArray, frozen, positive_number

# A support whose place changes by more than this part of the size at once jumps; supports whose
# motions differ by less than the second part of the largest move alike.
_JUMP, _ALIKE = 1e-9, 1e-12


class SimulationError(ArithmeticError):
    """A simulation that stopped before its end; it carries the motion up to there.

    Attributes
    ----------
    trajectory : Trajectory
        The motion up to the time of the failure.
    """

    def __init__(self, message: str, trajectory: Trajectory) -> None:
        super().__init__(message)
        self.trajectory = trajectory


@dataclass(eq=False)
class _Stretch:
    """The motion over a time in which the inputs are one polynomial."""

    time: FloatArray  # of the states kept, s
    states: FloatArray
    begin: FloatArray  # state at its beginning
    origin: float  # from which the polynomials count, s
    coefficients: FloatArray  # of all inputs
    released: float  # what strings cut by then had stored, J
    jump: FloatArray | None = None  # of the velocities of supports at its beginning, m/s

    def values(self, rows: slice, order: int = 0) -> FloatArray:
        """Return some of the inputs at the times kept, or their rates."""
        return polynomial_at(self.coefficients[rows], self.time - self.origin, order)


@dataclass(eq=False)
class Loop:
    """The plant side of a simulation: integration span by span.

    The input is held, or a polynomial in time of at most ``degree``; so is a load, where it is
    given as pieces of polynomials, one row an entry of it, node by node.

    Where supports move, ``offset`` is the displacement of the nodes that move with them, and
    states are beside it: N - E and Ṅ - Ė. Bars keep their lengths so, strings see N, and the load
    is less by M Ë. A jump of Ė, at a kink of the motion, is an impulse of -M ΔĖ on the nodes: what
    bars let keep its velocity keeps it.
    """

    model: Model
    input: str
    load: FloatArray | Pieces
    duration: float
    method: str | Method
    tolerance: float
    step: float | None
    faults: Faults
    project: bool | None = None
    machine_code: bool = False
    output_step: float = 0.0
    report: Callable[[float], None] | None = None  # of the time reached, s
    record: Callable[[], ControlRecord] | None = None  # under a controller
    degree: int = 0
    offset: Pieces | None = None
    offset_rate: FloatArray | None = None  # now, of all nodes, node by node, m/s
    spans: list[_Stretch] = field(default_factory=list)
    moves: bool = False  # whether an input has changed otherwise than by a controller's commands
    lost_energy: float = 0.0
    work: Work = field(default_factory=Work)
    now: float = 0.0
    integrator: Integrator | None = None
    choice: Choice | None = None
    note: str | None = None
    given: Given = field(default_factory=Given)
    estimates_error: bool = True
    report_of_error: Callable[[float], None] | None = None  # of the time reached, s
    error_limit: float = ERROR_LIMIT
    watches_bars: bool = True  # whether bars that cross are looked for at the end

    def __post_init__(self) -> None:
        self._method = method_of(self.method)
        if self.step is not None:
            self.step = positive_number("step", self.step, "s")
        load, structure = self.load, self.model.structure
        self._given: Pieces | None = load if isinstance(load, Pieces) else None
        if self.offset is not None:
            from scipy.sparse import eye_array, kron

            if not isinstance(load, Pieces):
                load = Pieces.constant(load.ravel(order="F"))
            self._mass = kron(node_mass(structure), eye_array(structure.dimension)).tocsr()
            inertia = self.offset.derivative(2).mapped(-self._mass)
            self._given = Pieces.stacked([Pieces.added([load, inertia]), self.offset])
        if self._given is not None:
            self.degree = max(self.degree, self._given.degree)
        self._equation = self._equation_of("auto")
        if self._method is None:
            return
        name, settings = self._method.name, self._method.settings
        if "tolerance" not in settings and self.step is None:
            raise ValueError(f"method {name!r} needs a step, s; for example step=1e-3")
        if "step" not in settings and self.step is not None:
            fixed = [known for known, each in METHODS.items() if "step" in each.settings]
            raise ValueError(
                f"step goes with the methods {fixed}; {name!r} chooses its own steps by tolerance"
            )

    @property
    def equation(self) -> Equation:
        """The equations of motion, as they are asked for; an integrator may have another form."""
        return self._equation

    def _equation_of(self, form: str) -> Equation:
        load = None
        if self._given is None:
            assert not isinstance(self.load, Pieces)  # else they were given
            load = self.load - self.model.constant_force
        return self.model.equation(
            self.input, load, form, degree=self.degree,
            load_input=load is None, offset_input=self.offset is not None,
        )  # fmt: skip

    def _prepare(self, state: FloatArray, held: FloatArray) -> Integrator:
        """Return the integrator, chosen for the scene if the user has not."""
        equation = self._equation
        method = self._method
        if method is None:
            chosen = choose(equation, state, held, self.duration, self.tolerance, self.step)
            method = METHODS[chosen.method]
        elif self.step is None:
            chosen = Choice(method.name, "tolerance", self.tolerance, "asked for")
        else:
            chosen = Choice(method.name, "step", self.step, "asked for")
        if equation.layout.degree and not method.follows:
            able = [name for name, each in METHODS.items() if each.follows]
            raise ValueError(
                f"method {method.name!r} takes inputs that are constant over a step only, but "
                f"an input changes in time; methods that follow it are: {able}. For a method of "
                "your own that evaluates the input by equation.ahead(u, t), give "
                "Method(follows=True)"
            )
        self.choice = chosen
        integrator = self._integrator_for(chosen.value)
        self.choice = replace(chosen, back_end=integrator.back_end)
        return integrator

    def _integrator_for(self, value: float) -> Integrator:
        """Return an integrator of the whole motion, with a step or tolerance.

        One that is watched begins with the method that was last at work.
        """
        assert self.choice is not None  # made before it
        last = self.choice.methods[-1]
        if self._method is None and self.choice.setting == "tolerance":
            begin = self.spans[0].time[0] if self.spans else self.now
            make = partial(self._made, value)
            return Watched(self._equation, last, make, self.duration, float(begin))
        return self._made(value, last)

    def _made(self, value: float, name: str) -> Integrator:
        """Return the integrator of a method, with a step or tolerance."""
        assert self.choice is not None  # made before it
        method, equation = self._method or METHODS[name], self._equation
        if method.differentiates and equation.form == "loops":
            equation = self._equation_of("mapped")
        # Not what the user says of a method that he has not chosen, and that needs no projection.
        project = self.project if method.drifts or self._method is not None else None
        return method.integrator(equation, value, self.choice.setting, project, self.machine_code)

    def run(
        self, state: FloatArray, held: FloatArray | tuple[FloatArray, FloatArray] | Pieces,
        duration: float,
    ) -> FloatArray:  # fmt: skip
        """Integrate and return the state at the end.

        The input of the strings is held, or goes in a straight line from the first of two to the
        second, or comes in pieces. Spans end where a piece does, and where strings are cut.
        """
        if isinstance(held, tuple):
            held = Pieces.ramp(self.now, duration, *held)
        elif not isinstance(held, Pieces):
            held = Pieces.constant(held)
        if held.degree > self.degree:
            found = f"found one of degree {held.degree}"
            raise ValueError(f"the loop was made for inputs of degree {self.degree}, {found}")
        end = self.now + duration
        inputs = held.within(self.now, end)
        self.moves |= not inputs.is_constant
        if self._given is not None:
            others = self._given.within(self.now, end)
            self.moves |= not others.is_constant
            inputs = Pieces.stacked([inputs, others])
        # Round-off of the times leaves no spans of no length.
        close = 1e-9 * duration
        within = self.now + close, end - close
        cuts = sorted({*self.faults.cut_times(*within), *inputs.breaks(*within)})
        for cut in cuts:
            state = self._run_span(state, inputs, cut - self.now, close)
            duration = end - cut
        return self._run_span(state, inputs, duration, close)

    def _release(self, state: FloatArray, time: float) -> None:
        """Count the energy that strings store which are cut at a time."""
        if not self.spans:
            return
        before = self.spans[-1].values(self._strings)[:, -1]
        after = self.faults.without_cut(before, time)
        if np.array_equal(before, after):
            return
        energy = "potential_energy" if self.input == "force_density" else "elastic_energy"
        inputs = np.column_stack([before, after])
        motion = (np.repeat(part, 2, axis=2) for part in self._motion(state))
        found = Quantities(self.model, self.offset is not None, inputs)
        (stored,) = found.of(energy, *motion, inputs)
        self.lost_energy += float(stored[0, 0] - stored[0, 1])

    def _run_span(
        self, state: FloatArray, inputs: Pieces, duration: float, close: float
    ) -> FloatArray:
        """Integrate with the strings that are not cut by now, up to what is close."""
        self._release(state, self.now + close)
        origin, coefficients = inputs.piece(self.now + close)
        more = self.degree + 1 - coefficients.shape[1]
        coefficients = self.faults.without_cut(
            np.pad(coefficients, ((0, 0), (0, more))) if more else coefficients, self.now + close
        )
        held = self._packed(coefficients, self.now - origin)
        jump = None
        if self.offset is not None:
            jump = self._support_jump(origin, coefficients)
            state = self._pushed(state, held, jump)
        if self.integrator is None:
            self.integrator = self._prepare(state, held)
            first = np.array([self.now])
            self._keep(_Stretch(first, state[:, None], state, origin, coefficients, 0.0))
        outputs = max(1, ceil(duration / self.output_step - 1e-9))

        def add(span: Span) -> None:
            times = start + duration * np.arange(1, span.states.shape[1] + 1) / outputs
            self._keep(_Stretch(times, span.states, state, origin, coefficients, 0.0, jump))
            self.work += span.work

        start, report = self.now, self.report
        reached = None if report is None else lambda time: report(start + time)
        try:
            span = self.integrator.advance(state, held, duration, outputs, reached)
        except (IntegrationError, IntegrationInterrupt) as error:
            add(error.span)
            self.now = start + error.time
            if isinstance(error, IntegrationInterrupt):
                raise
            raise self.stopped(str(error)) from error
        add(span)
        self.now = start + duration
        if self.offset is not None:
            self.offset_rate = self.spans[-1].values(self._offsets, 1)[:, -1]
        return span.states[:, -1]

    def _support_jump(self, origin: float, coefficients: FloatArray) -> FloatArray | None:
        """Return by how much the velocity of supports jumps now, None if it does not."""
        time = np.array([self.now - origin])
        rate = polynomial_at(coefficients[self._offsets], time, 1)[:, 0]
        jump = rate if self.offset_rate is None else rate - self.offset_rate
        self.offset_rate = rate
        return jump if jump.any() else None

    def _pushed(self, state: FloatArray, held: FloatArray, jump: FloatArray | None) -> FloatArray:
        """Return the state after a jump of the velocity of supports."""
        if jump is None:
            return state
        slope, layout = Evaluator(self._equation.slope), self._equation.layout
        pushed, taut = held.copy(), np.ones(self._equation.switches)
        pushed[layout.strings : layout.strings + layout.load] -= self._mass @ jump
        before = slope(state, held, taut)[0].copy()
        change = slope(state, pushed, taut)[0] - before
        change[: len(state) // 2] = 0.0  # positions stay
        return np.asarray(state + change)

    def motion(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities, shape (d, n) each, of a state now."""
        N, V = self._motion(state)
        return N[:, :, 0], V[:, :, 0]

    def _motion(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        offset = rate = None
        if self.offset is not None:
            offset, rate = self.offset.at(np.array([self.now])), self.offset_rate
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
        if self.offset is not None:
            offset, rate = (polynomial_at(coefficients[self._offsets], time, i) for i in (0, 1))
        parts = self._moved(states, offset, rate)
        return np.vstack([part.reshape(-1, states.shape[1], order="F") for part in parts])

    def stopped(self, why: str) -> SimulationError:
        """Return the error of a motion that cannot go on, with the motion up to now."""
        reason = f"stopped at {self.now:.6g} s of motion: {why}"
        return SimulationError(
            f"the simulation {reason}. The motion up to there is in the error's .trajectory",
            self.trajectory(reason),
        )

    @property
    def _strings(self) -> slice:
        return slice(self._equation.layout.strings)

    @property
    def _loads(self) -> slice:
        layout = self._equation.layout
        return slice(layout.strings, layout.strings + layout.load)

    @property
    def _offsets(self) -> slice:
        return slice(self._loads.stop, None)

    def _interval(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Return the state and the input at the beginning of an interval between states kept."""
        ends = np.cumsum([len(stretch.time) for stretch in self.spans])
        i = int(np.searchsorted(ends, k + 1, side="right"))
        stretch, place = self.spans[i], k + 1 - int(ends[i] - len(self.spans[i].time))
        if place:
            state, time = stretch.states[:, place - 1], stretch.time[place - 1]
        else:
            state, time = stretch.begin, self.spans[i - 1].time[-1]
        return state, self._packed(stretch.coefficients, float(time) - stretch.origin)

    def segments(self) -> Segments:
        """Return the motion between states kept; the first is the start alone."""
        spans, starts = self.spans, [span.begin for span in self.spans]
        ends = np.concatenate([span.time for span in spans])
        begins = np.concatenate([ends[:1], ends[:-1]])
        states = np.hstack([span.states for span in spans])
        of = np.repeat(np.arange(len(spans)), [len(span.time) for span in spans])
        before = np.column_stack([states[:, :1], states[:, :-1]])
        first = np.flatnonzero(np.diff(of, prepend=-1))
        before[:, first] = np.column_stack([starts[i] for i in of[first]])
        return Segments(self, of, begins, ends, before, states)

    def _again(
        self, first: int, last: int, parts: int
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Return times, nodes and velocities from one interval between states kept to another.

        In equal parts; None if the motion cannot be integrated again.
        """
        kept = self._segments
        stretch = self.spans[kept.of[first + 1]]
        if kept.of[first + 1] != kept.of[last + 1]:
            return None
        try:
            piece, _ = kept.again(first + 1, last + 1, parts)
        except (IntegrationError, KeyboardInterrupt):
            return None
        time = np.append(piece.begins, piece.ends[-1:])
        states = np.column_stack([piece.before, piece.after[:, -1]])
        inputs = np.repeat(stretch.coefficients[:, :, None], len(time), axis=2)
        d, n = self.model.structure.nodes.shape
        motion = self.all_nodes(states, inputs, time - stretch.origin)
        nodes, velocities = motion.reshape(2, n, d, -1).swapaxes(1, 2)
        return time, nodes, velocities

    @cached_property
    def _segments(self) -> Segments:
        return self.segments()

    def _packed(self, coefficients: FloatArray, time: float) -> FloatArray:
        if not self.degree:  # values held are the input
            return coefficients[:, 0]
        return self._equation.layout.packed(coefficients, time)

    def _keep(self, stretch: _Stretch) -> None:
        stretch.released = self.lost_energy
        self.spans.append(stretch)

    def trajectory(self, stopped: str | None = None) -> Trajectory:
        """Return the motion so far; the model evaluates its energies and momenta at all times."""
        with finishing():
            return self._trajectory(stopped)

    def _trajectory(self, stopped: str | None) -> Trajectory:
        assert self.choice is not None  # made before the first span
        assert self.integrator is not None  # made with it
        self.choice = replace(self.choice, changes=self.integrator.changes)
        model, structure, forces = self.model, self.model.structure, self.model.forces(self.input)
        control = None if self.record is None else self.record()
        spans = self.spans
        time = np.concatenate([s.time for s in spans])
        released = np.repeat([s.released for s in spans], [len(s.time) for s in spans])
        error = None
        if self.estimates_error and stopped is None:
            error = self._estimated_error()
        nodes, velocities = self._all_motion()
        inputs = self._all_values(self._strings)
        quantities = Quantities(model, self.offset is not None, inputs)
        known: dict[str, FloatArray | list[FloatArray]] = {}
        contacts = None
        if model.contacts is not None:
            segments = self.segments()
            (kinetic,) = quantities.of("kinetic_energy", nodes, velocities)
            known["kinetic_energy"] = kinetic[0]
            contacts = record_contacts(segments, nodes, velocities, float(kinetic.max()))
            quantities = replace(quantities, stored=contacts.stored_energy.sum(axis=0))
        if self._given is not None:
            loads = self._all_values(self._loads)
            if self.offset is not None:  # without the inertia that is a load beside the offset
                loads = loads + self._mass @ self._all_values(self._offsets, 2)
            loaded = bool(loads.any())
            quantities = replace(quantities, load=loads)
        elif loaded := not isinstance(self.load, Pieces) and bool(self.load.any()):
            quantities = replace(quantities, load=self.load)
        free = not len(structure.fixed_rows)
        if contacts is not None and free and not isinstance(self.load, Pieces):
            momenta = quantities.of("momentum", nodes, velocities)
            known["_momenta"], linear = momenta, momenta[0]
            given = contacts.impulse.sum(axis=1) + np.outer(self.load.sum(axis=1), time - time[0])
            off = linear - linear[:, :1] - given
            contacts = replace(contacts, impulse_error=float(np.abs(off).max()))
        run = Trajectory(
            structure=structure,
            time=frozen(time),
            nodes=nodes,
            velocities=velocities,
            rest_length=inputs if self.input == "rest_length" else None,
            choice=self.choice,
            work=self.work,
            conserves_energy=control is None and not self.moves and forces.conserves_energy,
            conserves_momentum=not loaded and free and forces.conserves_momentum,
            control=control,
            stopped=stopped,
            error=error,
            error_limit=self.error_limit,
            released_energy=frozen(released),
            falls=free and contacts is None and float(model.constant_force[-1].sum()) < 0,
            contacts=contacts,
            faults=self.faults.listed,
            note=self.note,
            given=self.given,
            _ground=model.ground,
            _quantities=quantities,
        )
        vars(run).update(known)
        if self.watches_bars:
            bars = BarMotion(structure, time, nodes, velocities, self._again, self.work.steps)
            vars(run).update(_bars=bars.searched())
        return run

    def _estimated_error(self) -> FloatArray | None:
        """Return an estimate of the error of the nodes at all times kept; None if interrupted."""
        assert self.choice is not None  # made before the first span
        stages, half = [], len(self.model.structure.free_rows)
        for i, (before, span) in enumerate(pairwise(self.spans)):
            start = float(before.time[-1])
            held = self._packed(span.coefficients, start - span.origin)
            # The motion is kept from after a jump at its start on.
            begin = partial(self._pushed, held=held, jump=span.jump if i else None)
            length = float(span.time[-1]) - start
            stages.append(Stage(length, len(span.time), held, begin))
        positions = np.hstack([span.states[:half] for span in self.spans[1:]])
        switches = self.work.switches + self.work.missed
        starts = None
        if self.record is not None:  # a controller corrects the motion
            starts = np.column_stack([span.begin for span in self.spans[1:]])
        motion = Motion(
            self.model.structure, self.spans[0].begin, stages,
            Path(np.arange(positions.shape[1]), positions, switches), np.arange(half),
            self.choice.setting, self.choice.value,
            (self._method or METHODS[self.choice.methods[-1]]).order,
            self._integrator_for, self._equation.layout.later, starts, self.report_of_error,
        )  # fmt: skip
        try:
            return frozen(np.concatenate([[0.0], motion.estimated_error(self.error_limit)]))
        except KeyboardInterrupt:
            return None

    def _all_values(self, rows: slice, order: int = 0) -> FloatArray:
        """Return some of the inputs at all times kept, or their rates, read-only."""
        held = [s.coefficients[rows] for s in self.spans]
        if not order and all(
            not each[:, 1:].any() and np.array_equal(each[:, 0], held[0][:, 0]) for each in held
        ):  # one column, read at all times
            count = sum(len(s.time) for s in self.spans)
            return np.broadcast_to(frozen(held[0][:, :1]), (len(held[0]), count))
        values = np.hstack([s.values(rows, order) for s in self.spans])
        values.setflags(write=False)
        return values

    def _all_motion(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities at all times kept, read-only; built block by block."""
        d, n = self.model.structure.nodes.shape
        shape = d, n, sum(len(s.time) for s in self.spans)
        nodes, velocities = np.empty(shape), np.empty(shape)
        place = 0
        for span in self.spans:
            for first in range(0, len(span.time), BLOCK):
                some = slice(first, first + BLOCK)
                offset = rate = None
                if self.offset is not None:
                    within, rows = span.time[some] - span.origin, span.coefficients[self._offsets]
                    offset, rate = (polynomial_at(rows, within, order) for order in (0, 1))
                N, V = self._moved(span.states[:, some], offset, rate)
                there = slice(place, place + N.shape[2])
                nodes[:, :, there], velocities[:, :, there] = N, V
                place = there.stop
        for part in (nodes, velocities):
            part.setflags(write=False)
        return nodes, velocities


def support_offset(model: Model, value: object, start: float, end: float) -> Pieces | None:
    """Return by how much each node moves with supports, m, node by node, after checking it can.

    None for the motion of no node where none is fixed.
    """
    from scipy.sparse import csr_array, eye_array, kron

    structure = model.structure
    d, n = structure.nodes.shape
    fixed, size = structure.fixed, float(np.ptp(structure.nodes, axis=1).max())
    numbers: Any = getattr(value, "values", value)  # of a profile
    if not len(fixed) and np.size(numbers) == 0:
        return None
    if not len(fixed):
        raise ValueError(
            "support_motion is given, but no node of the structure is fixed; fix some by "
            "Structure(..., fixed=[...])"
        )
    shape, meaning = (d, len(fixed)), "m, one column a fixed node, in the order of structure.fixed"
    given = as_pieces("support_motion", value, shape, meaning, start, end)
    jump, time = given.jumps(start, end)
    if jump > _JUMP * size:
        raise ValueError(
            f"support_motion jumps by {jump:.3g} m at {time:.6g} s, expected a continuous motion: "
            "interpolate by 'linear' or 'cubic'"
        )
    carried = carried_by_supports(structure)
    column = np.searchsorted(fixed, carried)
    motions = given.coefficients.reshape(len(given.start), len(fixed), d, -1)
    largest = np.abs(motions).max(initial=0.0)
    for i, node in enumerate(fixed):
        if np.abs(motions[:, i] - motions[:, column[node]]).max() > _ALIKE * largest:
            raise ValueError(
                f"support_motion moves the fixed nodes {carried[node]} and {node} differently, but "
                "bars lead from one to the other: give both the same displacement"
            )
    for node, axis in structure.rollers:
        if carried[node] >= 0 and motions[:, column[node], "xyz".index(axis)].any():
            raise ValueError(
                f"support_motion moves the fixed node {carried[node]} along {axis}, but bars lead "
                f"from it to node {node}, which a roller holds along {axis}"
            )
    nodes = np.flatnonzero(carried >= 0)
    shape = n, len(fixed)
    moves = csr_array((np.ones(len(nodes)), (nodes, column[nodes])), shape=shape)
    return given.mapped(kron(moves, eye_array(d)).tocsr())
