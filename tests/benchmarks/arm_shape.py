"""Shape of an arm of 20 bars, estimated from the inclinations of its bars alone.

Run: ``python -m tests.benchmarks.arm_shape``, two or three minutes. The arm is a tower of five
stages of four bars, 1.2 m long, held at its base. Winches bend it to a random side by a tenth to a
fifth of its length. Each bar has a sensor of its inclination, with noise of half a degree; nothing
tells headings, lengths or places. The arm is not that of the filter: stiffnesses of strings and
masses of bars are up to 10 % off, and its tip carries up to what a stage weighs.

Prints the distance of a node from its estimate as part of the length: the root mean square of all
nodes and samples, and the largest at the end, when the arm is bent. Three filters see the same
readings: one is told what the winches do, one is not and takes tensions as less known, and one is
told but reads nothing. Published for an arm of 20 struts with inclinations alone: 2.1 % of its
length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options

STAGES, SIDES, PUBLISHED = 5, 4, 0.021
STIFFNESS, DAMPING, BAR_MASS, TIP_MASS = 3000.0, 2.0, 0.05, 0.05  # N/m, N s/m, kg, kg
SAMPLE, BENDING, DURATION, NOISE = 0.05, 1.5, 2.5, np.radians(0.5)  # s, s, s, rad
WOUND, OFF = (0.05, 0.1), 0.1  # part of rest lengths; of stiffnesses and masses
TOLD, UNTOLD = 0.02, 0.1  # parts of tensions: where winding is known, where not


class Arm:
    """The arm as the filters know it."""

    def __init__(self, stages: int) -> None:
        tower = tc.prism_tower(stages, SIDES, radius=0.12, height=0.3, bar_mass=BAR_MASS)
        law = tc.LinearStrings(STIFFNESS, damping=DAMPING)
        rest = tc.prestress(tower, min_force_density=60.0)
        lengths = tc.to_rest_length(tc.Model(tower, law), tower.nodes, rest.force_density)
        self.structure = replace(tower, fixed=list(range(SIDES, 2 * SIDES)))
        self.model = tc.Model(self.structure, law, gravity=9.81)
        self.rest_length = lengths.rest_length
        self.rest = tc.equilibrium(self.model, rest_length=self.rest_length)
        self.plant = tc.linearize(self.model, self.rest, "rest_length")
        self.sensors = tc.Sensors(structure=self.structure, bar_inclination=NOISE, gravity=9.81)
        self.length = float(np.ptp(tower.nodes[2]))

    def estimator(self, process_noise: float) -> tc.KalmanFilter:
        """Return a filter of inclinations, by the part by which tensions may be off."""
        return tc.KalmanFilter(
            self.plant, self.sensors, sample_time=SAMPLE, process_noise=process_noise, gate=1e-12
        )

    def bent(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return nodes, readings and rest lengths of an arm that is not quite this one."""
        structure = self.structure
        strings, bars = len(structure.strings), len(structure.bars)
        carried = np.zeros(structure.nodes.shape[1])
        top = 2 * SIDES * (bars // SIDES - 1)
        carried[top : top + SIDES] = TIP_MASS * rng.uniform()
        masses = BAR_MASS * rng.uniform(1 - OFF, 1 + OFF, bars)
        law = tc.LinearStrings(STIFFNESS * rng.uniform(1 - OFF, 1 + OFF, strings), damping=DAMPING)
        own = tc.Model(replace(structure, bar_mass=masses, point_mass=carried), law, gravity=9.81)
        middle = self.rest.structure.nodes[:2, structure.strings].mean(axis=2)
        towards = np.arctan2(middle[1], middle[0]) - rng.uniform(-np.pi, np.pi)
        drives = np.isin(structure.string_groups, ["vertical", "saddle"])
        wound = drives * np.cos(towards) * rng.uniform(*WOUND) * self.rest_length
        arm = tc.Stepper(
            own, SAMPLE, step=5e-4, nodes=self.rest.structure.nodes, rest_length=self.rest_length,
            winches=tc.Winches(rate=1.0, ramp=True), sensors=self.sensors,
            seed=int(rng.integers(2**31)),
        )  # fmt: skip
        rows = [(arm.nodes, arm.reset(), self.rest_length)]
        for k in range(round(DURATION / SAMPLE)):
            lengths = self.rest_length - wound * min(1.0, k * SAMPLE / BENDING)
            reading = arm.step(lengths)
            rows.append((arm.nodes, reading, lengths))
        nodes, readings, lengths = map(np.array, zip(*rows, strict=True))
        return nodes, readings, lengths


def errors(
    estimator: tc.KalmanFilter, nodes: np.ndarray, readings: np.ndarray, lengths: np.ndarray
) -> tuple[float, float]:
    """Return the root mean square error of nodes, and the largest at the end, m."""
    estimator.reset(held=lengths[0])
    off = []
    for k, (shape, reading) in enumerate(zip(nodes, readings, strict=True)):
        off.append(np.linalg.norm(estimator.update(reading).nodes - shape, axis=0))
        estimator.predict(lengths[min(k + 1, len(lengths) - 1)])
    return float(np.sqrt(np.mean(np.square(off)))), float(off[-1].max())


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, runs=20, stages=STAGES)
    arm = Arm(given.stages)
    told, untold = arm.estimator(TOLD), arm.estimator(UNTOLD)
    rows: dict[str, list[tuple[float, float]]] = {}
    bends = []
    for run in range(given.runs):
        nodes, readings, lengths = arm.bent(np.random.default_rng(run))
        still, nothing = np.tile(lengths[0], (len(lengths), 1)), np.full_like(readings, np.nan)
        bends.append(np.linalg.norm(nodes[-1] - nodes[0], axis=0).max() / arm.length)
        for name, case in (
            ("told what winches do", (told, nodes, readings, lengths)),
            ("not told", (untold, nodes, readings, still)),
            ("told, no readings", (told, nodes, nothing, lengths)),
        ):
            rows.setdefault(name, []).append(errors(*case))
    print(
        f"{len(arm.structure.bars)} bars, {arm.length:.2f} m, the tip goes aside by "
        f"{min(bends):.1%} to {max(bends):.1%} of the length"
    )
    print("error over the length   all nodes  farthest node at the end: median, largest")
    for name, found in rows.items():
        mean, last = np.array(found).T / arm.length
        print(
            f"{name:22}  {np.sqrt(np.mean(mean**2)):9.2%}  {np.median(last):.2%}, {last.max():.2%}"
        )
    print(f"published             {PUBLISHED:9.2%}")


if __name__ == "__main__":
    main()
