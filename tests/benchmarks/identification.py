"""Fits of models to simulated logs: rollouts, errors beside intervals, and other methods.

Run: ``python -m tests.benchmarks.identification [--count 100] [--noise 8] [--ball 1] [--mujoco 3]
[--peers]``; ``--first 50 --count 50`` are the draws from the 50th on.

A prism with 29 unknowns, 9 rest lengths, 9 stiffnesses, 9 dampings and 2 masses, off by about 20 %
and 1 cm, is fitted to the places of its nodes, read to 1 mm at 50 Hz for 1 s while its strings are
wound. The table has a line for each draw of parameters and noise. Below is how many of all
intervals of 95 % hold the true value. ``--noise`` fits the prism read to so many mm, with unknowns
that are as far off as the fit is told, dampings by 50 %; several numbers are several tables.
``--ball`` fits six-bar balls that fall on ground, by the
lengths of strings and directions of bars over 2 s: 24 stiffnesses, friction, and a payload.
``--mujoco`` fits spinning prisms to logs from MuJoCo, by its rk4 in steps of 0.25 ms: 9
stiffnesses, 9 dampings and 2 masses. The residuals at the end of its lines are those on another
log, of other rest lengths and the spin the other way: 1 deviation where only noise is left.
``--peers`` fits the prism by ``scipy.optimize.least_squares`` with differences and by Nelder and
Mead's method, on the same rollouts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers import MuJoCo
from tenscontrol.optimize.fit import Fit
from tests.benchmarks.command_line import options

TIMES = np.arange(1, 51) * 0.02

NAMES = ["rest_length", "stiffness", "damping", "bar_mass"]

# Standard deviations of what --noise draws, and of what its fits are told: m, and of logarithms.
DEVIATIONS = {"rest_length": 0.01, "stiffness": 0.2, "damping": 0.5, "bar_mass": 0.2}

_NO_LIMITS = tc.HealthLimits(crossings=None, penetration=None)


@dataclass(frozen=True)
class Case:
    """A log, the model to begin with, and the values that made the log."""

    model: tc.Model
    log: tc.Log
    names: list[str] | dict[str, float]
    known: dict[str, list[int]]
    true: np.ndarray  # factors, or shifts

    other: tc.Log | None = None  # to validate by

    def fit(self) -> Fit:
        """Return the fit by the package."""
        return tc.fit(self.model, self.log, self.names, known=self.known)


def wound(rest: np.ndarray) -> tc.Profile:
    """Return rest lengths that change by 8 % up and down, out of step."""
    changes = [0.08 * rest.mean() * np.sin(3 * i + np.arange(len(rest))) for i in range(6)]
    return tc.Profile(np.linspace(0, 1, 6), np.stack([rest + each for each in changes], 1), "cubic")


def prism_case(seed: int, millimetres: float | None = None) -> Case:
    """Return a prism whose parameters are drawn at random."""
    random, prism = np.random.default_rng([29, seed]), tc.prism()
    spread = np.repeat([0.2, 0.2 if millimetres is None else DEVIATIONS["damping"], 0.2], [9, 9, 2])
    factors = np.exp(spread * random.normal(size=20))
    shifts = DEVIATIONS["rest_length"] * random.normal(size=9)
    mass = prism.bar_mass * np.append(1.0, factors[18:])
    strings = tc.LinearStrings(300.0 * factors[:9], 1.5 * factors[9:18])
    model = tc.Model(replace(prism, bar_mass=mass), strings=strings)
    rest = 0.95 * prism.string_length()
    run = tc.simulate(
        model, 1.0, rest_length=wound(rest + shifts), tolerance=1e-9, output_step=0.02,
        error="none", limits=_NO_LIMITS,
    )  # fmt: skip
    sensors = tc.Sensors(structure=prism, node_position=1e-3 * (millimetres or 1.0))
    log = replace(tc.Log.of_run(run, sensors, TIMES, seed=seed), rest_length=wound(rest))
    guess = tc.Model(prism, strings=tc.LinearStrings(300.0, 1.5))
    names = NAMES if millimetres is None else DEVIATIONS
    return Case(guess, log, names, {"bar_mass": [0]}, np.concatenate([shifts, factors]))


def ball_case(seed: int) -> Case:
    """Return a six-bar ball that falls on ground, with a payload."""
    random = np.random.default_rng([30, seed])
    ball = tc.library.six_bar_ball()
    length = ball.string_length()
    payload = np.zeros(ball.nodes.shape[1])
    payload[0] = 0.2 * ball.bar_mass.mean()
    factors = np.exp(0.2 * random.normal(size=26))
    ground = tc.Ground(2e3, damping=0.3, friction=0.5)

    def model(stiffness, friction, mass) -> tc.Model:
        return tc.Model(
            replace(ball, point_mass=mass), strings=tc.LinearStrings(stiffness, 2.0), gravity=9.81,
            ground=replace(ground, friction=friction),
        )  # fmt: skip

    push = np.zeros(ball.nodes.shape)
    push[0] = 0.5
    start = ball.nodes - [[0], [0], [ball.nodes[2].min() - 0.02]]
    true = model(800.0 * factors[:24], 0.5 * factors[24], payload * factors[25])
    rest = 0.95 * length
    run = tc.simulate(
        true, 2.0, start, push, rest_length=rest, tolerance=1e-9, output_step=0.02, error="none",
        limits=_NO_LIMITS,
    )  # fmt: skip
    sensors = tc.Sensors(structure=ball, string_length=1e-3, bar_direction=5e-3)
    log = tc.Log.of_run(run, sensors, np.arange(1, 101) * 0.02, seed=seed)
    names = ["stiffness", "ground.friction", "point_mass"]
    return Case(model(800.0, 0.5, payload), log, names, {}, factors)


def mujoco_case(seed: int) -> Case:
    """Return a prism that spins in MuJoCo, with another log to validate by."""
    random, prism = np.random.default_rng([31, seed]), tc.prism()
    factors = np.exp(0.2 * random.normal(size=20))
    mass = prism.bar_mass * np.append(1.0, factors[18:])
    strings = tc.LinearStrings(300.0 * factors[:9], 1.5 * factors[9:18])
    model = tc.Model(replace(prism, bar_mass=mass), strings=strings)
    sensors = tc.Sensors(structure=prism, node_position=1e-3)
    spin = np.cross([1.0, 0.4, 0.2], prism.nodes.T).T

    def log(rest_length: np.ndarray, velocities: np.ndarray) -> tc.Log:
        scene = tc.Scene(model, TIMES[-1], velocities=velocities, rest_length=rest_length)
        nodes = MuJoCo("rk4").prepare(scene, 2.5e-4, TIMES)().nodes[..., -len(TIMES) :]
        exact = nodes.transpose(2, 1, 0).reshape(len(TIMES), -1)
        noisy = exact + 1e-3 * random.normal(size=exact.shape)
        return tc.Log(TIMES, noisy, sensors, rest_length=rest_length, velocities=velocities)

    rest, uneven = 0.9 * prism.string_length(), np.linspace(0.95, 1.05, 9)
    guess = tc.Model(prism, strings=tc.LinearStrings(300.0, 1.5))
    first, other = log(rest * uneven, spin), log(0.98 * rest * uneven[::-1], -spin)
    return Case(guess, first, NAMES[1:], {"bar_mass": [0]}, factors, other)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, count=20, first=0, noise=(0.0,), ball=0, mujoco=0, peers=False
    )
    noisy = [
        (f"prism, {size:g} mm", partial(prism_case, millimetres=size), given.count)
        for size in given.noise
        if size
    ]
    for title, case_of, count in (
        *(noisy or [("prism", prism_case, given.count)]), ("ball", ball_case, given.ball),
        ("mujoco", mujoco_case, given.mujoco),
    ):  # fmt: skip
        if count:
            print_fits(title, case_of, range(given.first, given.first + count))
    if given.peers:
        print_peers(prism_case(0))


def print_fits(title: str, case_of, seeds: range) -> None:
    """Print a line for each fit, and how many intervals hold."""
    held, of, ratios = 0, 0, []
    print(f"{title}: seed rollouts chi2   error/deviation rms   s")
    for seed in seeds:
        case = case_of(seed)
        began = perf_counter()
        found = case.fit()
        seconds = perf_counter() - began
        low, high = found.interval.T
        told = found.identifiability.is_told
        held += int(((low <= case.true) & (case.true <= high))[told].sum())
        of += int(told.sum())
        is_prism = "rest_length" in case.names
        scaled = np.arange(len(case.true)) >= len(case.true) - 20 if is_prism else True
        values, true, ends = (
            np.where(scaled, np.log(np.where(scaled, part, 1.0)), part)
            for part in (found.value, case.true, high)
        )
        own = (values - true) / ((ends - values) / 1.959964)
        ratios.append(float(np.sqrt(np.mean(own[told] ** 2))))
        print(
            f"{title} {seed:8d} {found.rollouts:8d} {found.chi_squared:4.2f} {ratios[-1]:20.2f} "
            f"{seconds:5.1f}  {found.message}, {int((~told).sum())} not told"
            + (f", validated {found.validate(case.other)}" if case.other is not None else ""),
            flush=True,
        )
    print(f"{title}: {held} of {of} intervals of 95 % hold, {100 * held / max(of, 1):.1f} %")


def print_peers(case: Case) -> None:
    """Print how general methods do on the same rollouts."""
    from scipy.optimize import least_squares, minimize

    from tenscontrol.optimize.fit import rollouts_of

    rollouts = rollouts_of(case.model, case.log, case.names, case.known, None, None, 1e-8, None)
    scale = rollouts.deviations

    def residuals(scaled: np.ndarray) -> np.ndarray:
        found = rollouts.readings(scaled * scale, 1.0, slopes=False).residuals
        return np.concatenate([found, scaled])

    start, size = np.zeros(rollouts.size), len(case.log.readings.ravel())
    ours = case.fit()
    print(f"fit: {ours.rollouts} rollouts with slopes, chi2 {ours.chi_squared:.2f}")
    for name, solve in (
        ("least_squares", lambda: least_squares(residuals, start, max_nfev=60)),
        (
            "Nelder-Mead",
            lambda: minimize(
                lambda s: (residuals(s) ** 2).sum(), start, method="Nelder-Mead",
                options={"maxfev": 3000},
            ),
        ),
    ):  # fmt: skip
        rollouts.count = 0
        x = solve().x
        chi = (residuals(x)[:size] ** 2).sum() / (size - rollouts.size)
        print(f"{name}: {rollouts.count} rollouts, chi2 {chi:.3g}")


if __name__ == "__main__":
    main()
