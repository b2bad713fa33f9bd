"""Random structures with random motors: loops do what their designs say, or are refused.

Run: ``python -m tests.benchmarks.driven_choices``, some minutes. Each structure is of any class, in
space or in the plane, with supports, rollers, payloads and clustered strings. Its strings pull it
into a shape at rest; some of them are driven, one by one or several by a winch. LQR and MPC are
designed on that plant, with rest lengths or force densities as the input, and put into a loop on
the nonlinear plant, a little off its shape. With ``--struts`` some bars are driven beside the
strings, and the inputs are lengths that ramp.

A design that is made promises a motion: that of its closed linear loop. The nonlinear loop must
come within a part of the start of it (``--close``). What is not promised has a reason: an error, or
a warning of the modes that are left alone, or of strings that are slack where they are driven by
force and so go one way only. MPC knows those bounds: it must not leave the shape, but where it
warns that no law can hold it, or that its horizon is too short. ``SILENT`` is a loop that does
something else than promised without a word. Prints a line a case with ``--each``, and a table.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import tenscontrol as tc
from tenscontrol.plant.linear_plant import sampled
from tests.benchmarks.command_line import options
from tests.random_structures import any_structure

# Samples a period of the fastest vibration, and samples of a run; distance from the shape at the
# start over the size, so small that the linear plant is the plant.
SAMPLES, LENGTH, OFF = 10, 150, 1e-6

# How far MPC may end from the shape where some inputs go one way only, over the way of the loop
# that is promised without bounds.
KEPT = 2.0


@dataclass(frozen=True)
class Case:
    """What became of one law on one plant."""

    seed: int
    law: str
    input: str
    layout: str
    outcome: str  # stable, not damped, one way, too short, refused, SILENT
    reason: str = ""

    def __str__(self) -> str:
        return (
            f"{self.seed:5d} {self.law} {self.input:14} {self.layout:12} {self.outcome:12} "
            + (self.reason[:110])
        )


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, start=0, count=100, close=0.05, each=False, struts=False)
    cases = []
    for seed in range(given.start, given.start + given.count):
        for case in cases_of(seed, given.close, given.struts):
            cases.append(case)
            if given.each or case.outcome == "SILENT":
                print(case)
    for law in ("LQR", "MPC"):
        counts = Counter(case.outcome for case in cases if case.law == law)
        print(f"{law} {sum(counts.values())} loops: {table(counts)}")
    reasons = (case.reason for case in cases if case.outcome == "refused")
    refused = Counter(re.sub(r"-?\d+(\.\d+)?(e[-+]\d+)?", "#", reason)[:90] for reason in reasons)
    for reason, count in refused.most_common():
        print(f"  {count:3d} {reason}")
    kinds = Counter(case.layout.split()[0] for case in cases)
    print(f"layouts: {table(kinds)}")
    print(f"silent: {sum(case.outcome == 'SILENT' for case in cases)}")


def table(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))


def cases_of(seed: int, close: float, with_struts: bool = False) -> list[Case]:
    """Return what becomes of both laws on a random structure with random motors."""
    random = np.random.default_rng(seed)
    structure = any_structure(seed)
    kind, struts = str(random.choice(["rest_length", "force_density"])), None
    if with_struts:
        kind, struts = "length", some_bars(random, structure)
    stiffness = 10 ** random.uniform(2, 3, len(structure.strings))
    law = tc.LinearStrings(stiffness, damping=float(random.choice([0.0, 0.5, 2.0])))
    weighs = len(structure.fixed) > 0 and random.random() < 0.7
    model = tc.Model(structure, strings=law, gravity=9.81 if weighs else None)
    wound = random.uniform(0.5, 0.9) * structure.string_length()
    coordinates = "minimal" if weighs else "internal"  # weights couple motions as one body
    layout, actuated = winches_of(random, len(structure.strings))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of slack strings
        warnings.simplefilter("error", tc.control.ControlWarning)
        try:
            rest = tc.equilibrium(model, rest_length=wound)
            plant = tc.linearize(
                model, rest, kind, coordinates, actuated=actuated, struts=struts,
                rest_length=given_length(kind, wound),
            )  # fmt: skip
        except ValueError as error:
            return [
                Case(seed, name, kind, layout, "refused", str(error)) for name in ("LQR", "MPC")
            ]
    if not plant.spectral_radius:
        return [
            Case(seed, name, kind, layout, "refused", "nothing moves") for name in ("LQR", "MPC")
        ]
    return [case_of(seed, name, plant, model, layout, close) for name in ("LQR", "MPC")]


def given_length(kind: str, wound: np.ndarray) -> np.ndarray | None:
    return wound if kind != "force_density" else None


def some_bars(random: np.random.Generator, structure: tc.Structure) -> list[int]:
    """Return a random choice of the bars that can be driven, at least one if there is one."""
    redundant = [block.bars for block in structure.blocks if block.is_redundant]
    able = np.setdiff1d(structure.kept_bars, np.concatenate([[], *redundant]).astype(int))
    return random.permutation(able)[: int(random.integers(1, len(able) + 2))].tolist()


def winches_of(random: np.random.Generator, count: int) -> tuple[str, object]:
    """Return a random choice of driven strings, and what it is: single ones, or gangs."""
    strings = random.permutation(count)[: int(random.integers(1, count + 1))].tolist()
    if random.random() < 0.5:
        return f"single {len(strings)}/{count}", strings
    winches: dict[str, dict[int, float]] = {}
    while strings:
        size = int(random.integers(1, 4))
        group, strings = strings[:size], strings[size:]
        ratios = random.uniform(0.5, 1.5, len(group)) * random.choice([-1, 1], len(group))
        ratios[0] = abs(ratios[0])
        winches[f"w{len(winches)}"] = dict(zip(group, ratios.tolist(), strict=True))
    return f"gangs {len(winches)}/{count}", winches


def case_of(
    seed: int, name: str, plant: tc.LinearPlant, model: tc.Model, layout: str, close: float
) -> Case:
    """Return what becomes of a law, beside the closed linear loop that it promises."""
    sample = 2 * np.pi / (SAMPLES * plant.spectral_radius)
    kind, said = plant.input, ""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            ramp = {"winches": tc.Winches(ramp=True)} if plant.drives_bars else {}
            regulator = tc.LQR(plant, sample_time=sample, **ramp)
            law = regulator
            if name == "MPC":
                law = tc.MPC(plant, horizon=8, sample_time=sample, tolerance=1e-9, **ramp)
        except ValueError as error:
            return Case(seed, name, kind, layout, "refused", str(error))
    said = "; ".join(str(warning.message) for warning in told)
    random, r = np.random.default_rng(seed + 1), plant.degrees_of_freedom
    size = float(np.ptp(plant.nodes, axis=1).max())
    q = OFF * size * random.normal(size=r)
    start = plant.to_nodes(OFF * size / np.abs(plant.to_nodes(q) - plant.nodes).max() * q)
    held = {"rest_length": plant.rest_length, "input": kind} if kind == "rest_length" else ramp
    held = {"input": kind} if kind == "force_density" else held
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of bars that cross, of slack strings
        try:
            run = tc.simulate(
                model, LENGTH * sample, start, controller=law, method="dop853", tolerance=1e-11,
                limits=tc.HealthLimits(crossings=None), **held,
            )  # fmt: skip
        except ValueError as error:
            return Case(seed, name, kind, layout, "refused", str(error))
    phi, gamma = sampled(plant, sample, plant.drives_bars).augmented
    gain = (
        [regulator.gain, regulator.previous_input_gain] if plant.drives_bars else [regulator.gain]
    )
    closed = phi - gamma @ np.hstack(gain)
    first, last = (plant.measure(run.nodes[..., k], run.velocities[..., k]) for k in (0, -1))
    unit = np.repeat([plant.spectral_radius, 1.0], r)
    begin = np.pad(first, (0, len(closed) - 2 * r))
    way = {k: (np.linalg.matrix_power(closed, k) @ begin)[: 2 * r] for k in (0, 5, 20, LENGTH)}
    promised, most = way[LENGTH], max(np.linalg.norm(unit * z) for z in way.values())
    off = np.linalg.norm(unit * (last - promised)) / most
    radius = float(np.abs(np.linalg.eigvals(closed)).max())
    figures = f"radius {radius:.6f}, off by {off:.1e} {said}"
    if "does not hold the linear plant" in said:
        return Case(seed, name, kind, layout, "too short", figures)
    low, high = law.bounds
    room = np.minimum(plant.equilibrium_input - low, high - plant.equilibrium_input)
    one_way = bool((room <= 1e-9 * np.abs(plant.equilibrium_input).max()).any())
    if off > close and one_way:
        kept = "one way" in said
        if name == "MPC":
            kept = "no law can hold" in said or np.linalg.norm(unit * last) < KEPT * most
        return Case(seed, name, kind, layout, "one way" if kept else "SILENT", figures)
    if off > close:
        return Case(seed, name, kind, layout, "SILENT", figures)
    if radius < 1 - 1e-9:
        return Case(seed, name, kind, layout, "stable", figures)
    return Case(seed, name, kind, layout, "not damped" if said else "SILENT", figures)


if __name__ == "__main__":
    main()
