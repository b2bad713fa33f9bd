"""A cheap loop for faults: the prism as a sampled nonlinear plant under each controller.

A fault comes and goes, over and over; each command is checked when it is given.
"""

from dataclasses import dataclass, field
from functools import cache

import numpy as np

import tenscontrol as tc
from tenscontrol.control import Status
from tenscontrol.control.mpc import QPSolution
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.control.mpc.problem import LinearSolution, SubproblemSolution
from tenscontrol.control.mpc.stages import StagesProgram, StagesSubproblem
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.plant.reduced_dynamics import sampled_dynamics

STEP, GAMMA = 0.02, 17.3205
CHANGE = {"force_density": 6.0, "rest_length": 0.03}  # N/m and m a sample
HORIZON = {"mpc": 8, "nmpc": 5}
RATE = CHANGE["rest_length"] / STEP
HIGH = 60.0
RANGE = (0.4, 1.1)
CONTROLLERS = [("lqr", "force_density"), ("lqr", "rest_length")] + [
    (kind, held) for kind in ("mpc", "nmpc") for held in ("force_density", "rest_length")
]
STILL = np.zeros((3, 6))


@cache
def plant(held):
    """The prism at rest, its γ or rest lengths commanded; a little damping takes energy out."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    return tc.linearize(model, tc.prestress(prism, GAMMA), held)


@cache
def sampled(held):
    """``(z, u) -> z`` of the plant, a sample later, nonlinear."""
    return Evaluator(sampled_dynamics(plant(held), STEP)[0])


def controller(kind, held, **changes):
    """A controller with all its limits."""
    at = plant(held)
    limits = {"max_force_density": HIGH, "max_change": CHANGE[held]}
    if held == "rest_length":
        limits = {"winches": tc.Winches(RATE, *RANGE)}
    if kind == "lqr":
        Q, R = tc.energy_weights(at)
        return tc.LQR(at, Q, R, sample_time=STEP, **limits, **changes)
    made = {"mpc": tc.MPC, "nmpc": tc.NMPC}[kind]
    return made(at, horizon=HORIZON[kind], sample_time=STEP, **limits, **changes)


def absurd(rng, nodes, velocities):
    """A measurement that is finite, and cannot be: one of many kinds."""
    kind = int(rng.integers(7))
    nodes, velocities = nodes.copy(), velocities.copy()
    if kind == 0:
        nodes[rng.integers(3), rng.integers(6)] = 10.0 ** rng.uniform(3, 300)
    elif kind == 1:
        nodes[:, [0, 1]] = nodes[:, [1, 0]]  # two markers swapped
    elif kind == 2:
        nodes *= 0.0
    elif kind == 3:
        nodes *= rng.choice([0.5, 1000.0])  # another unit
    elif kind == 4:
        velocities[rng.integers(3), rng.integers(6)] = 10.0 ** rng.uniform(5, 300)
    elif kind == 5:
        nodes += 1e12
    else:
        nodes[:, rng.integers(6)] += 10.0
    return nodes, velocities


def broken(rng, nodes, velocities):
    """A measurement that is not finite."""
    nodes, velocities = nodes.copy(), velocities.copy()
    where = (nodes, velocities)[rng.integers(2)]
    where[rng.integers(3), rng.integers(6)] = rng.choice([np.nan, np.inf, -np.inf])
    return nodes, velocities


def solve_nothing(patch, status, iterations=1):
    """Let no solver solve."""
    answer, unsolved = QPSolution(status, None, None, iterations), (status, iterations, None)
    patch.setattr(OSQPSolver, "solve", lambda *_, **__: answer)
    patch.setattr(StagesProgram, "solve", lambda *_: LinearSolution(*unsolved))
    patch.setattr(StagesSubproblem, "solve", lambda *_: SubproblemSolution(*unsolved))


@dataclass
class FaultLoop:
    """A controller on the sampled plant."""

    kind: str
    held: str
    made: tc.control.Controller
    rng: np.random.Generator
    state: np.ndarray = field(default_factory=lambda: np.zeros(18))
    statuses: list = field(default_factory=list)
    time: float = 0.0

    def __post_init__(self):
        self.stands = plant(self.held).equilibrium_input.copy()
        self.made.reset()
        self.made.applied(self.stands)

    def sample(self, fault=None, strings=()):
        """Run a sample with a fault, and return the status."""
        at = plant(self.held)
        q, rates = np.split(self.state, 2)
        nodes, velocities = at.to_nodes(q), at.to_velocities(q, rates)
        if fault in ("not finite", "absurd"):
            spoil = {"not finite": broken, "absurd": absurd}[fault]
            nodes, velocities = spoil(self.rng, nodes, velocities)
        command = self.made.command(self.time, nodes, velocities)
        self.check(command.value)
        self.statuses.append(str(command))
        held = command.value.copy()
        strings = np.asarray(strings, dtype=int)
        if fault == "stuck":
            held[strings] = self.stands[strings]
        self.stands = held
        self.made.applied(held)
        acting = held.copy()
        if fault == "cut":
            acting[strings] = 0.0 if self.held == "force_density" else 1e6
        self.state = sampled(self.held)(self.state, acting)[0].copy()
        self.time += STEP
        return str(command)

    def check(self, value):
        """Finite, within bounds, and no farther from what stands than the actuators go."""
        assert np.isfinite(value).all()
        low, high = self.made.bounds
        assert (value >= low).all()
        assert (value <= high).all()
        allowed = CHANGE[self.held] * (1 + 1e-9)
        assert np.abs(value - self.stands).max() <= allowed

    def inject(self, fault, samples, monkeypatch):
        """Run some samples with a fault; the solver's faults reach MPC and NMPC alone."""
        strings = self.rng.choice(9, size=self.rng.integers(1, 4), replace=False)
        if fault in SOLVER:
            with monkeypatch.context() as patch:
                solve_nothing(patch, SOLVER[fault])
                return [self.sample() for _ in range(samples)]
        if fault == "cut":
            strings = strings[:1]
        return [self.sample(fault, strings) for _ in range(samples)]

    def recover(self, most):
        """Run until a status is good and return how many samples were not."""
        good = {"ok", "saturated"} if self.kind == "lqr" else {"ok"}
        for count in range(most + 1):
            if self.sample() in good:
                return count
        raise AssertionError(f"not recovered within {most} samples: {self.statuses[-1]}")


SOLVER = {
    "infeasible": Status.INFEASIBLE,
    "out of iterations": Status.OUT_OF_ITERATIONS,
    "out of time": Status.OUT_OF_TIME,
}
FAULTS = ("not finite", "absurd", "stuck", "cut", *SOLVER)
