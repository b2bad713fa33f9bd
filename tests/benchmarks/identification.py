"""Fits of models to simulated logs: rollouts, errors beside intervals, and other methods.

Run: ``python -m tests.benchmarks.identification [--rows prism ball ...] [--count 100]``; ``--first
50 --count 50`` are the draws from the 50th on. Each row prints a line for each draw of parameters
and noise, then how many of the intervals of 95 % hold the true value; fits that did not converge or
that noise does not explain have none. The lead of a fit is by how much its cost is below the least
with the unknowns at their true values, in squares of deviations: 1 an unknown as a rule if it is
right, and beyond what chance leaves one of 1000 where it is not. Below 0 the fit is in a wrong
minimum. Rows:

- ``prism``: 29 unknowns, 9 rest lengths, 9 stiffnesses, 9 dampings and 2 masses, off by about 20 %
  and 1 cm, are fitted to the places of its nodes, read to 1 mm at 50 Hz for 1 s while its strings
  are wound. ``--noise 2 4`` fits the prism read to so many mm, with unknowns that are as far off as
  the fit is told, dampings by 50 %; several numbers are several tables.
- ``outliers``: the same prism with 5 % of the readings off by some 10 cm, fitted by Huber's loss.
- ``delay``: the same prism with readings that are late by some 2 cs, as a 30th unknown.
- ``windows``: the same prism by windows of 0.3 s whose starts are unknown, from a first fit.
- ``ball``: six-bar balls that fall on ground, by the lengths of strings and directions of bars over
  2 s: 24 stiffnesses, friction, and a payload. ``nodes``: by the places of nodes.
- ``mujoco``: spinning prisms, by logs from MuJoCo and its rk4 in steps of 0.25 ms: 9 stiffnesses, 9
  dampings and 2 masses. The residuals at the end of its lines are those on another log, of other
  rest lengths and the spin the other way: 1 deviation where only noise is left.
- ``random``: random structures, ground, sensors and unknowns, in units over decades.
- ``peers``: one prism by ``scipy.optimize.least_squares`` with differences and by Nelder and Mead's
  method, on the same rollouts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from scipy.stats import chi2

import tenscontrol as tc
from tenscontrol.accuracy.peers import MuJoCo
from tenscontrol.optimize.fit import Fit, cost_of
from tenscontrol.optimize.unknowns import fitted_model, unknowns_of
from tests.benchmarks.command_line import options
from tests.random_scenes import random_scene

TIMES = np.arange(1, 51) * 0.02

NAMES = ["rest_length", "stiffness", "damping", "bar_mass"]

# Standard deviations of what --noise draws, and of what its fits are told: m, and of logarithms.
DEVIATIONS = {"rest_length": 0.01, "stiffness": 0.2, "damping": 0.5, "bar_mass": 0.2}

_NO_LIMITS = tc.HealthLimits(crossings=None, penetration=None)


@dataclass(frozen=True)
class Case:
    """A log, the model to begin with, and the values that made the log."""

    model: tc.Model
    log: tc.Log | tuple[tc.Log, ...]
    names: list[str] | dict[str, float]
    true: np.ndarray  # shifts, then factors
    shifts: int = 0
    options: dict[str, Any] = field(default_factory=dict)  # of the fit
    other: tc.Log | None = None  # to validate by

    def fit(self) -> Fit:
        """Return the fit by the package."""
        return tc.fit(self.model, self.log, self.names, **self.options)


def wound(rest: np.ndarray, shifts: np.ndarray | float = 0.0) -> tc.Profile:
    """Return rest lengths that change by 8 % up and down, out of step, and are off by shifts."""
    changes = [0.08 * rest.mean() * np.sin(3 * i + np.arange(len(rest))) for i in range(6)]
    values = np.stack([rest + shifts + each for each in changes], axis=1)
    return tc.Profile(np.linspace(0, 1, 6), values, "cubic")


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
        model, 1.0, rest_length=wound(rest, shifts), tolerance=1e-9, output_step=0.02,
        error="none", limits=_NO_LIMITS,
    )  # fmt: skip
    sensors = tc.Sensors(structure=prism, node_position=1e-3 * (millimetres or 1.0))
    log = replace(tc.Log.of_run(run, sensors, TIMES, seed=seed), rest_length=wound(rest))
    guess = tc.Model(prism, strings=tc.LinearStrings(300.0, 1.5))
    names = NAMES if millimetres is None else DEVIATIONS
    return Case(
        guess, log, names, np.concatenate([shifts, factors]), 9, {"known": {"bar_mass": [0]}}
    )


def outliers_case(seed: int) -> Case:
    """Return the prism, with readings of which some are far off."""
    case, random = prism_case(seed), np.random.default_rng([32, seed])
    readings = np.array(case.log.readings)
    wild = random.random(readings.shape) < 0.05
    readings[wild] += 0.1 * random.normal(size=wild.sum())
    log = replace(case.log, readings=readings)
    return replace(case, log=log, options=case.options | {"loss": "huber"})


def delay_case(seed: int) -> Case:
    """Return the prism, with readings that are late."""
    case = prism_case(seed)
    late = 0.02 * abs(np.random.default_rng([33, seed]).normal())
    return replace(
        case, log=replace(case.log, time=case.log.time + late), shifts=10,
        names=["delay", *case.names], true=np.append(late, case.true),
    )  # fmt: skip


def windows_case(seed: int) -> Case:
    """Return the prism, with its log in windows that begin where a first fit was."""
    case = prism_case(seed)
    first = case.fit()
    rest = wound(0.95 * tc.prism().string_length(), first.parameters["rest_length"])
    run = tc.simulate(
        first.model, 1.0, rest_length=rest, output_step=0.02, error="none", limits=_NO_LIMITS
    )
    options = case.options | {"start": (0.002, 0.02)}
    return replace(case, log=case.log.windows(0.3, run), options=options)


def ball_case(seed: int, **measured: float) -> Case:
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
    sensors = tc.Sensors(structure=ball, **measured)
    log = tc.Log.of_run(run, sensors, np.arange(1, 101) * 0.02, seed=seed)
    names = ["stiffness", "ground.friction", "point_mass"]
    return Case(model(800.0, 0.5, payload), log, names, factors)


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
    return Case(guess, first, NAMES[1:], factors, 0, {"known": {"bar_mass": [0]}}, other)


def random_case(seed: int) -> Case:
    """Return a random scene that random sensors read; its unknowns are drawn as the fit is told."""
    random = np.random.default_rng([35, seed])
    while True:
        scene = random_scene(int(random.integers(2**31)))
        if scene.input == "rest_length" and len(scene.structure.strings) <= 10:
            break
    structure, believed = scene.structure, scene.model
    names: dict[str, float] = {}
    if random.random() < 0.3:
        names["rest_length"] = 0.02 * float(structure.string_length().mean())
    names["stiffness" if isinstance(scene.strings, tc.LinearStrings) else "axial_rigidity"] = 0.3
    if scene.strings.damping.any() and random.random() < 0.7:
        names["damping"] = 0.5
    if len(structure.bars) > 1 and random.random() < 0.3:
        names["bar_mass"] = 0.3
    if scene.ground and scene.ground[0].friction and random.random() < 0.7:
        names["ground.friction"] = 0.3
    unknowns = unknowns_of(believed, "rest_length", names, None, None, scene.value)
    theta = [each.deviation * random.normal(size=len(each.groups)) for each in unknowns]
    shifts = len(theta[0]) if "rest_length" in names else 0
    rest = scene.value + theta[0] if shifts else scene.value
    noise = scene.size * 10 ** random.uniform(-4, -2.5)
    measured = [{"node_position": noise}, {"string_length": noise}][int(random.random() < 0.4)]
    sensors, count = tc.Sensors(structure=structure, **measured), int(random.integers(30, 101))
    run = tc.simulate(
        fitted_model(believed, unknowns, theta), scene.duration, velocities=scene.velocities,
        rest_length=rest, tolerance=1e-9, output_step=scene.duration / count, error="none",
        limits=_NO_LIMITS,
    )  # fmt: skip
    log = replace(tc.Log.of_run(run, sensors, run.time[1:], seed=seed), rest_length=scene.value)
    whole = np.concatenate(theta)
    whole[shifts:] = np.exp(whole[shifts:])
    return Case(believed, log, names, whole, shifts)


ROWS = {
    "prism": prism_case, "outliers": outliers_case, "delay": delay_case, "windows": windows_case,
    "ball": partial(ball_case, string_length=1e-3, bar_direction=5e-3),
    "nodes": partial(ball_case, node_position=1e-3), "mujoco": mujoco_case,
    "random": random_case,
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, rows=("prism",), count=20, first=0, noise=(0.0,))
    seeds = range(given.first, given.first + given.count)
    for row in given.rows:
        if row == "peers":
            print_peers(prism_case(given.first))
            continue
        for size in given.noise if row == "prism" else [0.0]:
            if size:
                print_fits(f"prism, {size:g} mm", partial(prism_case, millimetres=size), seeds)
            else:
                print_fits(row, ROWS[row], seeds)


@dataclass(frozen=True)
class Judged:
    """A fit beside what is true."""

    found: Fit
    held: int  # of told
    told: int  # with an interval
    lead: float
    unknowns: int


def judged(case: Case, found: Fit) -> Judged:
    """Return what of a fit is true."""
    count = len(case.true)
    low, high = found.interval[:count].T
    told = ~np.isnan(low)
    held = (low <= case.true) & (case.true <= high)
    return Judged(found, int(held[told].sum()), int(told.sum()), lead_of(case, found), count)


def lead_of(case: Case, found: Fit) -> float:
    """Return by how much the cost of a fit is below the least with what is true."""
    rollouts, count = found.identifiability.rollouts, len(case.true)
    deviations, is_robust = rollouts.deviations, case.options.get("loss") == "huber"

    def scaled(values: np.ndarray) -> np.ndarray:
        parts = values[: case.shifts], np.log(values[case.shifts : count]), values[count:]
        return np.concatenate(parts) / deviations[: len(values)]

    def cost(unknowns: np.ndarray) -> float:
        readings = rollouts.readings(unknowns * deviations, 1.0, slopes=False)
        return cost_of(readings.residuals, unknowns, is_robust)

    least, true = scaled(found.value), scaled(np.append(case.true, found.value[count:]))
    for _ in range(3 if len(true) > count else 0):  # starts, by the method of Gauss
        readings = rollouts.readings(true * deviations, 1.0, slopes=True)
        rows = np.vstack([(readings.slope * deviations)[:, count:], np.eye(len(true) - count)])
        right = np.concatenate([readings.residuals, true[count:]])
        true[count:] -= np.linalg.lstsq(rows, right, rcond=None)[0]
    return cost(true) - cost(least)


def print_fits(title: str, case_of: Callable[[int], Case], seeds: range) -> None:
    """Print a line for each fit, and how many intervals hold."""
    every = []
    print(f"{title}: seed rollouts chi2   lead an unknown   s")
    for seed in seeds:
        case = case_of(seed)
        began = perf_counter()
        found = case.fit()
        seconds = perf_counter() - began
        own = judged(case, found)
        every.append(own)
        print(
            f"{title} {seed:8d} {found.rollouts:8d} {found.chi_squared:4.2f} "
            f"{own.lead / own.unknowns:17.2f} {seconds:5.1f}  {found.message}, "
            f"{own.told - own.held} of {own.told} missed, {own.unknowns - own.told} without"
            + (f", validated {found.validate(case.other)}" if case.other is not None else ""),
            flush=True,
        )
    rollouts = [own.found.rollouts for own in every]
    stopped = sum(not own.found.converged for own in every)
    far = sum(not own.found.explained for own in every)
    print(
        f"{title}: {np.median(rollouts):g} rollouts as a rule, {max(rollouts)} at most; {stopped} "
        f"stopped, {far} far from the log"
    )
    held, told = (sum(getattr(own, name) for own in every) for name in ("held", "told"))
    leads = [own.lead / own.unknowns for own in every]
    beyond = sum(chi2.sf(own.lead, own.unknowns) < 1e-3 for own in every)
    print(
        f"{title}: {held} of {told} intervals of 95 % hold, {100 * held / max(told, 1):.1f} %; "
        f"lead {np.median(leads):.2f} an unknown as a rule, beyond chance in {beyond} of "
        f"{len(every)} fits, below 0 in {sum(lead < 0 for lead in leads)}"
    )


def print_peers(case: Case) -> None:
    """Print how general methods do on the same rollouts."""
    from scipy.optimize import least_squares, minimize

    from tenscontrol.optimize.fit import rollouts_of

    rollouts = rollouts_of(
        case.model, case.log, case.names, case.options["known"], None, None, 1e-8, None
    )
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
