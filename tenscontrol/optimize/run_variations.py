"""Propagation of small changes along a whole run, part by part."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import unpack_states
from tenscontrol.dynamics.profile import polynomial_at
from tenscontrol.optimize.bar_changes import BarChanges
from tenscontrol.optimize.derivatives import Derivatives
from tenscontrol.optimize.feedback import feedback_of
from tenscontrol.optimize.implicit_steps import halved
from tenscontrol.optimize.motor_answers import MotorAnswers, TickSlopes
from tenscontrol.optimize.parameters import Parameter
from tenscontrol.optimize.support_changes import SupportChanges
from tenscontrol.optimize.traced_steps import steps_of
from tenscontrol.optimize.variations import IMPLICIT, Answers, Variations, columns_of, stable
from tenscontrol.simulation.actuators import Actuators
from tenscontrol.simulation.plant_run import PlantRun
from tenscontrol.simulation.scene import Scene, trace
from tenscontrol.simulation.traced_run import TracedRun

# Memory of the steps of a part, bytes, and how often each number of a step is there at most.
_MOST_BYTES, _COPIES = 2**28, 4

# A switch that is passed slower than this part of the largest speed of its kind may not be met at
# all by a run next to it.
_GRAZING = 1e-3


class RunVariations:
    """The derivative of the run of a scene by a method that can be traced.

    Of long runs the steps are not kept. They are found again, part by part, to the last bit.

    Parameters
    ----------
    scene : Scene
    parameters : sequence of Parameter
    times : ndarray, shape (T,)
        At which derivatives are asked for, s, ascending.
    feedback : bool
        Whether the commands of an LQR answer changes.
    expected : float
        About how many steps there will be.
    most : float, optional
        How many are kept at a time, about.
    is_shortened : bool
        Whether steps are shorter where stability limits them; see :meth:`Integrator.shorten`.
    """

    def __init__(
        self, scene: Scene, parameters: Sequence[Parameter], times: FloatArray,
        feedback: bool = False, expected: float = 0.0, most: float | None = None,
        is_shortened: bool = False,
    ) -> None:  # fmt: skip
        self.parameters, self.times = parameters, times
        #: Which columns of a derivative are those of each parameter, and how many there are.
        self.columns = columns_of(parameters)
        self.width = self.columns[-1].stop if self.columns else 0
        self._scene, self._feedback = scene, feedback
        run = scene.plant_run(traces=True)
        assert isinstance(run, TracedRun)  # as it was asked for
        self._run = run
        run.shortens = is_shortened
        of_motors = [parameter for parameter in parameters if parameter.kind == "motor"]
        answers = feedback or bool(of_motors) or feels_motion(scene)
        self.derivatives = Derivatives(
            scene.model, scene.input, run.degree, parameters, answers, scene.supports is not None,
            scene.bars is not None,
        )  # fmt: skip
        self._motors: tuple[TickSlopes, Actuators] | None = None
        self._changes: SupportChanges | None = None
        self._lengths: BarChanges | None = None
        for parameter in parameters:
            if parameter.kind == "bars":
                self._lengths = BarChanges(parameter)
            if parameter.kind == "supports" and scene.supports is not None:
                self._changes = SupportChanges(scene.structure, scene.supports, parameter)
        numbers = self.derivatives.equation
        of_step = 8 * _COPIES * (numbers.states + numbers.inputs + numbers.switches)
        run.most = max(_MOST_BYTES / of_step, 256) if most is None else most
        run.expected, run.take = expected, self._take
        self._states: list[FloatArray] = []  # at the times; of the last part when asked for
        self._ends: list[int] = []
        self._slow: list[tuple[float, float]] = []  # times and rates
        self._fastest, self.switches = 0.0, 0  # velocity, m/s, where something switches
        self._last: tuple[int, Variations] | None = None
        loop = trace(scene, run)
        run.take = None
        if self._slow:
            self._see_speed()
        actuators = None if loop is None else loop.actuators
        if isinstance(actuators, Actuators) and (of_motors or actuators.follows_motion):
            self._refuse_beside_motors(actuators)
            self._motors = TickSlopes(actuators, of_motors), actuators
            self.motion()  # before what has been found without the motors goes
            self._last = None

    def _refuse_beside_motors(self, actuators: Actuators) -> None:
        """Refuse what motors are not differentiated with."""
        if self._scene.input == "force_density":
            raise ValueError(
                "a motor of the run met its torque where force densities are held: no derivative "
                "is taken through that. Give more torque, or hold rest lengths"
            )
        if self._feedback:
            raise ValueError(
                "feedback: no derivative is taken through motors that wind what an LQR commands. "
                "Leave feedback out, or the motors and their numbers"
            )
        if actuators.follows_motion and any(by.kind == "supports" for by in self.parameters):
            raise ValueError(
                "no derivative by 'support_motion' is taken where motors have an inertia or meet "
                "their torque: leave it out of to, or give the motors more torque and no inertia"
            )

    @property
    def grazing(self) -> tuple[float, ...]:
        """Times of switches that are passed slowly, s."""
        return tuple([time for time, rate in self._slow if rate < _GRAZING * self._fastest])

    def motion(self) -> FloatArray:
        """Return the states at the times, shape (states, T)."""
        if len(self._states) < len(self._ends):
            self._states.append(self._part(len(self._ends) - 1).motion())
        return np.hstack(self._states)

    def slopes(self) -> FloatArray:
        """Return ẋ at the times, shape (states, T)."""
        return np.hstack([self._part(i).slopes() for i in range(len(self._ends))])

    def forward(self) -> FloatArray:
        """Return the derivatives of x at the times, shape (T, states, P)."""
        X, answer = self._part(0).start(), None
        sensitivities = np.empty((len(self.times), *X.shape))
        for i in range(len(self._ends)):
            X, answer = self._part(i).forward(X, sensitivities[self._of(i)], answer)
        return _finite(sensitivities)

    def backward(self, costs: FloatArray) -> FloatArray:
        """Return derivatives of a cost by the parameters, shape (P,), from those by x at the times.

        Parameters
        ----------
        costs : ndarray, shape (T, states)
        """
        slope = np.zeros(self.width)
        mu, answers = np.zeros(costs.shape[1]), self._part(len(self._ends) - 1).answers
        answered = np.zeros(0 if answers is None else answers.size)
        for i in reversed(range(len(self._ends))):
            mu = self._part(i).backward(mu, costs[self._of(i)], slope, answered)
        self._part(0).start_back(mu, slope)
        return _finite(slope)

    # ---- all nodes ----

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities at the times, shape (d, n, T) each."""
        nodes, velocities = unpack_states(self._scene.structure, self.motion())
        supports = self._scene.supports
        if supports is None:
            return nodes, velocities
        moved = supports.displacement
        piece = moved.index(self._within)
        coefficients = moved.coefficients[piece].transpose(1, 2, 0)
        offset, rate = (
            polynomial_at(coefficients, self.times - moved.origin[piece], order) for order in (0, 1)
        )
        return (
            nodes + offset.reshape(nodes.shape, order="F"),
            velocities + rate.reshape(nodes.shape, order="F"),
        )

    def whole(self, sensitivities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of all nodes and velocities, node by node, (T, d n, P) each.

        From those of x at the times, shape (T, states, P).
        """
        structure, half = self._scene.structure, self.derivatives.half
        if not len(structure.fixed_rows):
            return sensitivities[:, :half], sensitivities[:, half:]
        count, _, width = sensitivities.shape
        whole = np.zeros((2, count, structure.nodes.size, width))
        whole[:, :, structure.free_rows] = sensitivities[:, :half], sensitivities[:, half:]
        for columns, changes in self._displaced():
            whole[..., columns] += changes
        return whole[0], whole[1]

    def cost_of_supports(self, by_nodes: FloatArray, by_velocities: FloatArray) -> FloatArray:
        """Return derivatives of a cost by what supports displace at the times, shape (P,).

        From those by all nodes and velocities, node by node, shape (T, d n) each.
        """
        slope = np.zeros(self.width)
        for columns, (places, rates) in self._displaced():
            slope[columns] = np.tensordot(by_nodes, places, 2)
            slope[columns] += np.tensordot(by_velocities, rates, 2)
        return slope

    def _displaced(self) -> Iterator[tuple[slice, tuple[FloatArray, FloatArray]]]:
        """Yield columns with what they displace of nodes and velocities at the times."""
        for parameter, columns in zip(self.parameters, self.columns, strict=True):
            if parameter.kind == "supports" and self._changes is not None:
                places, rates = (self._changes.at(self.times, self._within, i) for i in (0, 1))
                yield columns, (places, rates)

    @property
    def _within(self) -> FloatArray:
        """Times in the pieces that the times end, s; that at the start begins one."""
        close = 1e-9 * self._scene.duration
        return np.where(self.times > self._scene.begin + close, self.times - close, self.times)

    # ---- parts ----

    def _take(self, run: PlantRun) -> None:
        """Look at a part of the run, and keep the last."""
        if self._last is not None:
            self._states.append(self._last[1].motion())
            self._see_speed()
            self._last = None  # or there were two at a time
        variations = self._variations(run, len(self._ends))
        switches, steps = variations.switches, variations.steps
        if len(switches.step):
            self.switches += len(switches.step)
            ends = (steps.begin + steps.length)[switches.step]
            self._slow += zip(ends.tolist(), np.abs(switches.rate).tolist(), strict=True)
        self._last = len(self._ends) - 1, variations

    def _see_speed(self) -> None:
        """Take note of the largest velocity of a free coordinate in the last part."""
        assert self._last is not None  # it was taken
        states = self._last[1].steps.states
        fastest = float(np.abs(states[len(states) // 2 :]).max())
        self._fastest = max(self._fastest, fastest)

    def _part(self, i: int) -> Variations:
        """Return the derivative of a part; the last one again if it is that."""
        if self._last is None or self._last[0] != i:
            self._last = None  # or there were two at a time
            self._last = i, self._variations(self._run.again(i), i)
        return self._last[1]

    def _of(self, i: int) -> slice:
        """Return which of the times are in a part."""
        return slice(self._ends[i - 1] if i else 0, self._ends[i])

    def _variations(self, run: PlantRun, i: int) -> Variations:
        scene, derivatives = self._scene, self.derivatives
        load = run.load if isinstance(run.load, np.ndarray) else scene.model.constant_force
        steps = steps_of(run, load, scene.state)
        if steps.method == IMPLICIT and scene.integration.step is None:
            steps = halved(steps, derivatives)
        steps = stable(steps, derivatives)
        if i == len(self._ends):
            close = max(1e-9 * float(steps.length[-1]), 1e-12 * scene.duration)
            self._ends.append(int(self.times.searchsorted(steps.end + close, side="right")))
        answers: Answers | None = None
        if self._feedback:
            answers = feedback_of(scene, steps, self.parameters, self.columns)
        elif self._motors is not None:
            ticks, actuators = self._motors
            answers = MotorAnswers(
                ticks, scene.model, steps, self.parameters, self.columns, actuators
            )
        return Variations(
            steps, derivatives, self.parameters, self.times[self._of(i)], answers, self._changes,
            self._lengths, None if scene.bars is None else scene.bars.bars,
        )  # fmt: skip


def feels_motion(scene: Scene) -> bool:
    """Whether motors of a scene may wind what depends on the motion."""
    motor = None if scene.winches is None else scene.winches.motor
    return motor is not None and motor.torque is not None and scene.input == "rest_length"


def _finite(array: FloatArray) -> FloatArray:
    if not (validation.is_bounded(array) or np.isfinite(array).all()):
        raise ValueError(
            "the derivatives of the run grow beyond all bounds: it cannot be predicted so far. "
            "Take a shorter one"
        )
    return array
