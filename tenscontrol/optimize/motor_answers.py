"""What motors wind along a run, differentiated: how it answers changes of motion and numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca
import numpy as np

from tenscontrol.actuation.motors import EachMotor, all_numbers
from tenscontrol.actuation.winch_motion import Instant, TickMap
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.evaluator import Function, builds, evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_force import StringForce
from tenscontrol.optimize.derivatives import law_symbols, law_values
from tenscontrol.optimize.dual_numbers import Dual
from tenscontrol.optimize.parameters import Parameter, shares
from tenscontrol.optimize.traced_steps import TracedSteps
from tenscontrol.simulation.actuators import Actuators, moved_on

# States of each motor, as in ``Instant``, and forces that it feels, at both ends of a tick.
_STATES, _ENDS = 4, 2
_START = Instant._fields.index("start")

# Numbers of the derivatives of forces that are held at a time.
_MOST_NUMBERS = 1_000_000


class TickSlopes:
    """Derivatives of what winches did in each tick of a run: of the map that the run took.

    Parameters
    ----------
    actuators : Actuators
        At the end of a run that was traced.
    parameters : sequence of Parameter
        Of the kind "motor".

    Attributes
    ----------
    time : ndarray, shape (K,)
        When ticks begin, s.
    motion : ndarray, shape (2 d n, K)
        Of all nodes then.
    lengths : ndarray, shape (2, m, K)
        Rest lengths at winches, m, where they feel forces: now, and at the end of the tick.
    slopes : ndarray, shape (outputs, variables, K, m)
        Of rest length, position and speed after the tick, and of the coefficients of the rest
        length in it; by the states before, forces at both ends, and the numbers.
    """

    def __init__(self, actuators: Actuators, parameters: Sequence[Parameter]) -> None:
        taken, winches = actuators.taken, actuators.winches
        assert winches is not None  # else nothing is to be differentiated
        self._actuators = actuators
        self.degree, self.has_drive = winches.degree, winches.has_drive
        self.sample_time, self.ticks = actuators.sample_time, actuators.ticks
        self.length = self.sample_time / self.ticks
        self.time = np.array([tick.time for tick in taken])
        self.is_first = np.array([tick.number for tick in taken]) == 1
        self.motion = np.stack([tick.motion for tick in taken], axis=1)
        within, stuck = (
            np.stack([getattr(tick, name) for tick in taken]) for name in ("within", "stuck")
        )
        first = np.stack([tick.begin.rest_length for tick in taken], axis=1)
        self.lengths = np.stack([first] * _ENDS)  # where no force is asked for
        count, self._width = within.shape[1], _STATES + _ENDS + len(parameters)
        begin = Instant(
            *(
                self._variable(i, np.stack([getattr(tick.begin, name) for tick in taken]))
                for i, name in enumerate(Instant._fields)
            )
        )
        numbers = dict[str, FloatArray | Dual | None](all_numbers(winches.motor, count))
        numbers["rate"] = winches.rate
        for i, by in enumerate(parameters, _STATES + _ENDS):
            value = np.broadcast_to(np.asarray(numbers[by.field]), (1, count))
            numbers[by.field] = self._variable(i, value)
        ticks = TickMap(
            winches, EachMotor.of(numbers), numbers["rate"], self.sample_time, self.ticks
        )
        number = np.array([[tick.number] for tick in taken])
        moved = ticks(number, begin, within, stuck, self._pull)
        outputs = *moved.end[:_START], *moved.string
        shape = (self._width, *within.shape)
        self.slopes = np.stack(
            [np.broadcast_to(by.slope if isinstance(by, Dual) else 0.0, shape) for by in outputs]
        )

    def _variable(self, i: int, value: FloatArray) -> Dual:
        slope = np.zeros((self._width, *value.shape))
        slope[i] = 1.0
        return Dual(value, slope)

    def _pull(self, inputs: FloatArray | Dual, later: float) -> tuple[Dual, FloatArray]:
        """Return forces at winches in all ticks, which are variables, too; and their slopes."""
        end, lengths = int(later > 0), np.asarray(inputs).T
        self.lengths[end] = lengths
        force, slope = (
            values.T.copy()
            for values in self._actuators.pulls(moved_on(self.motion, later), lengths)
        )
        felt = self._variable(_STATES + end, force)
        if isinstance(inputs, Dual):
            felt.slope -= np.where(inputs.slope != 0, slope * inputs.slope, 0.0)
        return felt, slope


class MotorAnswers:
    """What strings are given in a part of a run under motors that feel changes.

    The forces F at winches change what motors wind from tick to tick, and so do their numbers. The
    answer of a tick has the coefficients of the rest lengths of strings, powers of the time since
    it began; then the states of the motors after it.

    Parameters
    ----------
    ticks : TickSlopes
    model : Model
    steps : TracedSteps
        Of the part.
    parameters : sequence of Parameter
    columns : sequence of slice
        Which columns of a derivative are those of each parameter.
    actuators : Actuators
    """

    def __init__(
        self, ticks: TickSlopes, model: Model, steps: TracedSteps,
        parameters: Sequence[Parameter], columns: Sequence[slice], actuators: Actuators,
    ) -> None:  # fmt: skip
        self._ticks, self._steps, self._model = ticks, steps, model
        self._columns = list(zip(parameters, columns, strict=True))
        self._winds, self._feels = actuators.winds, actuators.feels
        self._lead, self._wound = actuators.actuation.lead, actuators.wound
        #: Of the polynomials in time that an answer has first.
        self.degree = ticks.degree
        close = 1e-6 * ticks.length
        first = np.searchsorted(steps.begin, ticks.time - close)
        within = (ticks.time > steps.begin[0] - close) & (ticks.time < steps.end - close)
        self._tick_of = {int(first[i]): i for i in np.flatnonzero(within).tolist()}
        under_way = np.searchsorted(ticks.time, steps.begin + close, side="right") - 1
        self._elapsed = steps.begin - ticks.time[under_way]
        numbers = len(self._winds) * (len(steps.states) // 2 + 1)
        self._block = max(1, _MOST_NUMBERS // max(numbers, 1))
        self._known: dict[tuple[int, int], tuple[FloatArray, FloatArray, FloatArray]] = {}

    @property
    def size(self) -> int:
        """Number of rows of an answer."""
        return (self.degree + 1) * len(self._winds) + _STATES * len(self._lead)

    def begins(self, step: int) -> bool:
        """Whether a tick begins with a step."""
        return step in self._tick_of

    def elapsed(self, step: int) -> float:
        """Return how long a tick has lasted when a step begins, s."""
        return float(self._elapsed[step])

    def answer(self, step: int, X: FloatArray, before: FloatArray | None) -> FloatArray:
        """Return the answer of the tick that begins with a step, from that of the tick before."""
        i, ticks, count = self._tick_of[step], self._ticks, len(self._lead)
        states = np.zeros((_STATES, count, X.shape[1]))
        if before is not None:
            states[:] = before[-_STATES * count :].reshape(states.shape)
        if ticks.is_first[i]:
            states[_START] = 0.0 if ticks.has_drive else states[1]
        forces = [self._feels @ self._by_motion(i, end, X) for end in range(_ENDS)]
        felt = np.concatenate([states, forces])
        slopes = ticks.slopes[:, :, i]
        moved = np.einsum("ova,vap->oap", slopes[:, : len(felt)], felt)
        for number, columns in self._numbers():
            moved[:, np.arange(count), columns] += slopes[:, number]
        given = [self._winds @ change for change in moved[_START:]]
        return np.concatenate([*given, *moved[:_START], states[_START]])

    def answer_back(self, step: int, answered: FloatArray, slope: FloatArray) -> FloatArray:
        """Return a cost by the state from that by the answer of the tick that begins with a step.

        The latter then is that by the answer of the tick before.
        """
        i, ticks, count = self._tick_of[step], self._ticks, len(self._lead)
        coefficients = answered[: -_STATES * count].reshape(-1, len(self._winds))
        after = answered[-_STATES * count :].reshape(_STATES, count)
        moved = np.concatenate([after[:_START], coefficients @ self._winds])
        slopes = ticks.slopes[:, :, i]
        felt = np.einsum("ova,oa->va", slopes, moved)
        states = felt[:_STATES]
        states[_START] += after[_START]
        if ticks.is_first[i]:
            if not ticks.has_drive:
                states[1] += states[_START]
            states[_START] = 0.0
        for number, columns in self._numbers():
            slope[columns] += felt[number]
        mu = np.zeros(self._steps.states.shape[0])
        for end in range(_ENDS):
            mu += self._by_motion_back(i, end, felt[_STATES + end] @ self._feels, slope)
        coefficients[:] = 0.0
        after[:] = states
        return mu

    def _numbers(self) -> Iterator[tuple[int, FloatArray]]:
        """Yield which variable of a tick each number of motors is, and its columns."""
        of_motors = (columns for by, columns in self._columns if by.kind == "motor")
        for number, columns in enumerate(of_motors, _STATES + _ENDS):
            yield number, columns.start + self._lead

    def _by_motion(self, i: int, end: int, X: FloatArray) -> FloatArray:
        """Return the change of the forces of strings at an end of a tick, (α′, P)."""
        by_nodes, half = self._by(i, end)[0], len(X) // 2
        forces = by_nodes @ (X[:half] + end * self._ticks.length * X[half:])
        for columns, by in self._by_own(i, end):
            forces[np.arange(len(by)), columns] += by
        return np.asarray(forces)

    def _by_motion_back(self, i: int, end: int, cost: FloatArray, slope: FloatArray) -> FloatArray:
        """Return a cost by the state from that by the forces of strings, (α′,)."""
        by = cost @ self._by(i, end)[0]
        for columns, own in self._by_own(i, end):
            slope[columns] += cost * own
        return np.concatenate([by, end * self._ticks.length * by])

    def _by_own(self, i: int, end: int) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield columns of values of each string with what they change of its force, (α′,)."""
        strings, first = np.arange(len(self._winds)), 0
        _, by_length, by_law = self._by(i, end)
        for by, columns in self._columns:
            if by.kind == "strings":
                yield columns.start + strings, by_law[first]
                first += 1
            elif by.kind == "input":
                time = self._ticks.time[[i]]
                share = shares(by, time, time + self._ticks.length / 2)
                assert share is not None  # of each sample
                for j in np.flatnonzero(share).tolist():
                    yield columns.start + j + len(share) * strings, share[j] * by_length

    # ---- forces of strings ----

    def _by(self, i: int, end: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return derivatives of the forces of strings at an end of a tick.

        By free coordinates, (α′, half), by the own rest length of each, (α′,), and by the
        parameters of its law, (·, α′).
        """
        key = i // self._block, end
        if key not in self._known:
            if len(self._known) == _ENDS:
                self._known.clear()
            self._known[key] = self._forces_by(key[0] * self._block, end)
        by_nodes, by_length, by_law = self._known[key]
        k = i % self._block
        return by_nodes[k], by_length[k], by_law[k]

    def _forces_by(self, first: int, end: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return these derivatives for a block of ticks, one after the other."""
        laws = [by for by, _ in self._columns if by.kind == "strings"]
        key = "slopes of winding", tuple(by.name for by in laws)
        function = self._model.prepared.get(key, lambda: _force_slopes(self._model, laws))
        ticks, own = self._ticks, slice(first, first + self._block)
        motion = moved_on(ticks.motion[:, own], end * ticks.length)
        lengths = self._wound(ticks.lengths[end][:, own])
        strings, count = lengths.shape
        outputs = evaluate_columns(function, motion[: len(motion) // 2], lengths)
        by_nodes, by_length, by_laws = (values.T.copy() for values in outputs)
        by_nodes = by_nodes.reshape(count, -1, strings).swapaxes(1, 2)
        return by_nodes, by_length, by_laws.reshape(count, -1, strings)


@builds
def _force_slopes(model: Model, laws: Sequence[Parameter]) -> ca.Function:
    """Return ``(nodes, rest_length) -> derivatives`` of the force that winds each string in.

    By the free coordinates, by its own rest length, and by each parameter of the law.
    """
    structure, symbols = model.structure, law_symbols(laws)
    assert model.strings is not None  # rest lengths are held
    law = model.strings.with_parameters({by.field: s for by, s in zip(laws, symbols, strict=True)})
    N, rest = ca.SX.sym("N", *structure.nodes.shape), ca.SX.sym("l0", len(structure.strings))
    ones = ca.DM.ones(rest.shape)
    force = -ca.jtimes(StringForce(structure, law).stored_energy(N, rest), rest, ones)
    by_nodes = ca.jacobian(force, ca.vec(N))[:, structure.free_rows.tolist()]
    by_laws = ca.vertcat(ca.SX(0, 1), *(ca.jtimes(force, symbol, ones) for symbol in symbols))
    outputs = [ca.vec(by_nodes), ca.jtimes(force, rest, ones), by_laws]
    if laws:
        values = law_values(model, "rest_length", laws)
        outputs = ca.substitute(outputs, [ca.vertcat(*symbols)], [values])
    return Function("winding_slopes", [ca.vec(N), rest], [ca.densify(output) for output in outputs])
