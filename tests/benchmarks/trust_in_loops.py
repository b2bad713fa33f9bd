"""Is a run under a controller ever wrong without a warning? Random loops against tight ones.

Run: ``python -m tests.benchmarks.trust_in_loops --count 100 [--seed 0] [--jobs 2]``.

A structure of the library or a random prism is thrown out of its prestress, by speeds over decades
and with weights over decades, under LQR or linear MPC, for 20 to 80 samples. Some have winches with
a largest rate, half of these with motors, some a Kalman filter that reads noisy places of nodes.
The reference is the same loop, under a controller of its own, at a tolerance of 1e-11. It is
certain to what the loop at 1e-10 is off. Each loop is run at the default tolerance and at 1e-4, and
judged as in ``tests.benchmarks.trust``, whose table this prints. ``--scene 7`` prints one loop.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import tenscontrol as tc
from tenscontrol.plant import natural_weights
from tenscontrol.simulation import SimulationError
from tests.benchmarks.command_line import options
from tests.benchmarks.trust import HEADER, Run, judged_run, mapped, print_failures, row
from tests.random_structures import any_motion_of
from tests.references import (
    TIMES,
    Reference,
    TimeLimitError,
    error_between,
    places,
    time_limit,
)

TOLERANCES = {"default call": {}, "tolerance 1e-4": {"tolerance": 1e-4}}

# Tolerances of the reference and of what shows how certain it is; processor time of a run, s.
_TIGHT, _CERTAIN, _SECONDS = 1e-11, 1e-10, 60.0

_STREAM = 20261129


@dataclass(frozen=True, eq=False)
class Loop:
    """A plant, how it is thrown, and the settings of its controller."""

    seed: int
    plant: tc.LinearPlant
    velocities: np.ndarray
    horizon: int  # samples; 0: LQR
    samples: int
    sample_time: float
    effort: float  # weight of the inputs over the natural one
    winches: tc.Winches | None
    noise: float | None  # of a filter's readings, m

    @property
    def size(self) -> float:
        """Largest extent of the nodes, m."""
        return float(np.ptp(self.plant.model.structure.nodes, axis=1).max())

    def controller(self) -> tc.Controller:
        """Return a controller that remembers nothing."""
        sampled = {"sample_time": self.sample_time, "winches": self.winches}
        if self.horizon:
            return tc.MPC(self.plant, horizon=self.horizon, **sampled)
        return tc.LQR(self.plant, R=self.effort * natural_weights(self.plant)[1], **sampled)

    @property
    def duration(self) -> float:
        """In s."""
        return self.samples * self.sample_time

    def simulate(self, **given: object) -> tc.Trajectory:
        """Run the loop by the package; bars may cross."""
        given.setdefault("limits", tc.HealthLimits(crossings=None))
        if self.winches is not None:
            given["rest_length"] = self.plant.rest_length
        if self.noise is not None:
            sensors = tc.Sensors(self.plant.model.structure, node_position=self.noise)
            given["estimator"] = tc.KalmanFilter(self.plant, sensors, sample_time=self.sample_time)
            given |= {"sensors": sensors, "seed": self.seed}
        return tc.simulate(
            self.plant.model, self.duration, velocities=self.velocities,
            controller=self.controller(), input=self.plant.input, winches=self.winches, **given,
        )  # fmt: skip

    def about(self) -> str:
        """Return one line on the loop."""
        kind = f"MPC over {self.horizon}" if self.horizon else f"LQR, {self.effort:.2g} R"
        structure = self.plant.model.structure
        return (
            f"{structure.dimension}-D, {len(structure.bars)} bars, {len(structure.strings)} "
            f"strings, {type(self.plant.model.strings).__name__}, input {self.plant.input}, "
            f"{kind}, {self.samples} samples of {self.sample_time:.3g} s, "
            f"{np.abs(self.velocities).max():.3g} m/s"
            + ("" if self.winches is None else ", winches")
            + ("" if self.winches is None or self.winches.motor is None else " with motors")
            + ("" if self.noise is None else ", filter")
        )


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, count=100, seed=0, jobs=1, scene=(-1,))
    if given.scene[0] >= 0:
        for seed in given.scene:
            print(f"{seed}: {random_loop(seed).about()}")
            print(*judged_loop(seed), sep="\n  ")
        return
    runs: list[Run] = []
    states: dict[int, str] = {}
    seeds = range(given.seed, given.seed + given.count)
    for seed, state, some in mapped(judged_loop, seeds, given.jobs, "loops"):
        states[seed] = state
        runs += some
    print(HEADER)
    for name in TOLERANCES:
        print(row(name, [run for run in runs if run.method == name]))
    print_failures(runs, tuple(TOLERANCES), states)


def random_loop(seed: int) -> Loop:
    """Return the loop of this seed."""
    random = np.random.default_rng([_STREAM, seed])
    structure = _structure(random)
    prestress = tc.prestress(structure, min_force_density=10 ** random.uniform(0, 3))
    density = prestress.force_density
    stiffness = density * 10 ** random.uniform(0.3, 2.5)  # N/m, for strings of a metre
    mass = float(np.mean(structure.bar_mass))
    damping = 2 * 10 ** random.uniform(-3, -0.5) * np.sqrt(stiffness * mass)
    strings: tc.LinearStrings | tc.ElasticStrings
    if random.random() < 0.5:
        strings = tc.LinearStrings(stiffness, damping)
    else:
        strings = tc.ElasticStrings(stiffness * structure.string_length(), damping)
    input_ = "force_density" if random.random() < 0.25 else "rest_length"
    with warnings.catch_warnings(action="ignore"):  # modes that no string reaches
        plant = tc.linearize(tc.Model(structure, strings), prestress, input=input_)
    frequency = float(np.sqrt(np.median(density) / mass))  # rad/s: of the prestress
    velocities = any_motion_of(structure, int(random.integers(2**31)))[1]
    size = float(np.ptp(structure.nodes, axis=1).max())
    speed = 10 ** random.uniform(-2, 0.6) * size * frequency
    velocities *= speed / np.abs(velocities).max()
    winches, noise = None, None
    if input_ == "rest_length" and random.random() < 0.4:
        motor = None
        if random.random() < 0.5:
            pull = float(np.max(density * structure.string_length()))
            motor = _motor(random, size, pull, frequency)
        winches = tc.Winches(rate=speed * 10 ** random.uniform(-2, 0.5), motor=motor)
    if random.random() < 0.25:
        noise = size * 10 ** random.uniform(-4, -2)
    return Loop(
        seed, plant, velocities, int(random.integers(5, 16)) * (random.random() < 0.4),
        20 * int(random.integers(1, 5)), 10 ** random.uniform(-1.3, 0) / frequency,
        10 ** random.uniform(-3, 3), winches, noise,
    )  # fmt: skip


def _motor(random: np.random.Generator, size: float, pull: float, frequency: float) -> tc.Motor:
    """Return motors that hold up to ten times a pull, N; frequency in rad/s."""
    radius, ratio = 0.01 * size, 20.0
    torque = pull * radius / ratio * 10 ** random.uniform(0, 1)
    slow = random.integers(4)  # by nothing more, inertia, lag or backlash
    fastest = frequency**2 * 10 ** random.uniform(0, 2) / 0.01 * ratio  # rad/s², a size a second²
    return tc.Motor(
        radius, ratio, torque=torque,
        inertia=torque / fastest if slow == 1 else 0.0,
        lag=0.1 / frequency if slow == 2 else 0.0,
        backlash=10 ** random.uniform(-2, 0) if slow == 3 else 0.0,
    )  # fmt: skip


def _structure(random: np.random.Generator) -> tc.Structure:
    kind = random.integers(5)
    if kind == 0:
        return tc.prism(sides=int(random.integers(3, 7)), bar_mass=10 ** random.uniform(-1, 1))
    if kind == 1:
        return tc.prism_tower(int(random.integers(2, 4)))
    makers = tc.library.six_bar_ball, tc.library.kite, tc.library.class2_tower
    return makers[kind - 2]()


def judged_loop(seed: int) -> tuple[int, str, list[Run]]:
    """Return the state of a loop's reference, and its runs."""
    loop = random_loop(seed)
    try:
        found = _reference(loop)
    except (SimulationError, TimeLimitError) as error:
        return seed, f"tight run: {error}", []
    if not len(found.judged):
        return seed, "uncertain at once", []
    return seed, "ok", [
        judged_run(loop, found, name, "", given, _SECONDS) for name, given in TOLERANCES.items()
    ]  # fmt: skip


def _reference(loop: Loop) -> Reference:
    """Return the loop's motion by tight tolerances, as certain as two of them agree."""
    times = np.linspace(0.0, loop.duration, TIMES + 1)
    with warnings.catch_warnings(action="ignore"), time_limit(_SECONDS):
        tight, other = (
            loop.simulate(method="dop853", tolerance=tolerance, error="none")
            for tolerance in (_TIGHT, _CERTAIN)
        )
    nodes, others = (run.nodes[:, :, places(run.time, times)] for run in (tight, other))
    # What separates both grows with time, but may pass zero.
    certain = np.maximum.accumulate(error_between(loop, others, nodes))
    return Reference(times, nodes, certain, "ok", 0)


if __name__ == "__main__":
    main()
