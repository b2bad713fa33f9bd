"""Five steps of the six-bar ball in a commanded direction: how often it makes them, on what ground.

Run: ``python -m tests.benchmarks.rolling``, about half an hour. On flat ground and 5° up a slope,
by winches of 0.2 m/s between 0.35 m and 0.8 m, from any yaw. The gait plans with the nominal ball
on the nominal ground; friction, the stiffness of the ground, of each string, and the mass of each
bar are drawn. ``--driven 12`` leaves winches to every second string of the shell, the others are
springs, and ``--payload 1`` hangs a mass of 1 kg in the middle by twelve springs more.
``--roughness 0.01`` has waves of 0.01 m in any direction on the ground, which the gait does not
know of. On level ground the gait has a table of its plans; with ``--planned`` it makes them in the
run, as on a slope. With ``--estimated`` it knows what a Kalman filter of the nominal ball tells by
IMUs on the bars and encoders on the motors. A success is five steps within 40 s that end within
45° of the direction. Prints the rates of success with their intervals, and the time of a command
over the sample time: by the clock, as the gait is used in a run, and the processor's for the plan
of a whole step at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import process_time

import casadi as ca
import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options

COUNT, SEED, STEPS, SLOPES = 100, 0, 5, (0.0, 5.0)  # degrees
SAMPLE, REST_LENGTH, PART, LONGEST = 0.05, 0.55, 2.0, 40.0  # s, m, s, s
WINCHES = tc.Winches(rate=0.2, shortest=0.35, longest=0.8, ramp=True)
FACE = [0, 4, 8]
WAVES = 6, (0.5, 2.0)  # of rough ground, and their lengths, m
PARAMETERS = {
    "friction": tc.Uniform(0.3, 1.0),
    "ground": tc.Uniform(2e3, 2e4),
    "bar_mass": tc.Uniform(0.8, 1.2, size=6),
    "stiffness": tc.Uniform(0.9, 1.1, size=24),
    "yaw": tc.Uniform(-180.0, 180.0),
}
WAVINESS = {
    "length": tc.Uniform(*WAVES[1], size=WAVES[0]),
    "heading": tc.Uniform(-180.0, 180.0, size=WAVES[0]),
    "phase": tc.Uniform(-180.0, 180.0, size=WAVES[0]),
}


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, count=COUNT, steps=STEPS, slopes=SLOPES, driven=24, payload=0.0,
        roughness=0.0, planned=False, estimated=False,
        seed=SEED, processes=1, file="", plans=10,
    )  # fmt: skip
    for slope in given.slopes:
        file = f"{given.file}.{slope:g}" if given.file else None
        case = Rolling(
            slope, given.steps, given.driven, given.payload, given.roughness, given.planned,
            given.estimated,
        )  # fmt: skip
        drawn = PARAMETERS | (WAVINESS if given.roughness else {})
        report = tc.sweep(
            case, drawn, given.count, seed=given.seed, processes=given.processes, file=file
        )
        print(f"slope of {slope:g}°: {report.summary()}\n")
    report_time(given.slopes, given.steps, given.plans)


@dataclass(frozen=True)
class Rolling:
    """A ball that is not quite the one that the gait plans with.

    Figures: steps made, the time they took, s, the way along the direction, m, and the angle
    between the two, degrees.
    """

    slope: float
    steps: int
    driven: int
    payload: float
    roughness: float
    planned: bool
    estimated: bool

    def __call__(self, parameters: dict, rng: np.random.Generator) -> tc.robustness.Outcome:
        robot = {
            "driven": self.driven, "payload": self.payload, "roughness": self.roughness,
            "tabulated": not self.planned and self.slope == 0, "estimated": self.estimated,
        }  # fmt: skip
        gait, runs = rolled(self.slope, self.steps, **robot, **parameters)
        moved = (runs[-1].nodes[:, :, -1] - runs[0].nodes[:, :, 0]).mean(axis=1)
        direction, side = np.cross([0.0, 1.0, 0.0], normal(self.slope)), moved[1]
        along = float(direction @ moved)
        off = float(np.degrees(np.arctan2(abs(side), along)))
        return tc.robustness.Outcome(
            success=len(gait.made) == self.steps and off < 45.0,
            figures={
                "steps": len(gait.made), "time": runs[-1].time[-1], "along": along, "angle": off,
            },
        )  # fmt: skip


def normal(slope: float) -> np.ndarray:
    """Return that of ground that rises along x by so many degrees."""
    angle = np.radians(slope)
    return np.array([-np.sin(angle), 0.0, np.cos(angle)])


def modelled(slope, payload=0.0, friction=0.5, ground=5e3, bar_mass=1.0, stiffness=1.0, height=0.0):
    """Return the ball on its ground, with masses and stiffnesses as parts of the nominal ones."""
    ball = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5 * np.broadcast_to(bar_mass, 6))
    shell = 1000.0 * np.broadcast_to(stiffness, 24)
    if payload:
        ball = with_payload(ball, payload)
        shell = np.append(shell, np.full(12, 1000.0))
    law = tc.LinearStrings(stiffness=shell, damping=10.0)
    plane = tc.Ground(ground, 0.5, friction, slip_speed=0.02, normal=normal(slope), height=height)
    return tc.Model(ball, strings=law, gravity=9.81, ground=plane)


def with_payload(ball, mass):
    """Return the ball with a node of this mass, kg, in the middle, on a string to each other."""
    strings = np.vstack([ball.strings, [[k, 12] for k in range(12)]])
    return replace(
        ball,
        nodes=np.column_stack([ball.nodes, ball.nodes.mean(axis=1)]),
        strings=strings,
        point_mass=np.append(np.zeros(12), mass),
        string_groups=["shell"] * 24 + ["payload"] * 12,
    )


def rough(roughness, length, heading, phase):
    """Return the height of ground over x and y, m: waves of this root mean square together."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    angle, shift = np.radians(heading), np.radians(phase)
    waves = [
        ca.sin(2 * np.pi / each * (np.cos(way) * x + np.sin(way) * y) + begin)
        for each, way, begin in zip(length, angle, shift, strict=True)
    ]
    return ca.Function("height", [x, y], [roughness * np.sqrt(2 / len(waves)) * sum(waves)])


def rolled(
    slope,
    steps,
    driven=24,
    payload=0.0,
    yaw=0.0,
    roughness=0.0,
    tabulated=False,
    estimated=False,
    **parameters,
):
    """Return the gait and its runs, one after the other, until the steps are made."""
    if roughness:
        waves = {name: parameters.pop(name) for name in WAVINESS}
        parameters["height"] = rough(roughness, **waves)
    nominal, up = modelled(slope, payload), normal(slope)
    lengths = nominal.structure.string_length()
    lengths = np.where(np.arange(len(lengths)) < 24, REST_LENGTH, 0.9 * lengths)
    driven = list(range(0, 24, 24 // driven))
    gait = tc.shape.RollingGait(
        nominal, lengths, np.cross([0.0, 1.0, 0.0], up), SAMPLE, winches=WINCHES, steps=steps,
        actuated=driven, tabulated=tabulated,
    )  # fmt: skip
    begin = turn(up, np.radians(yaw)) @ tc.plant.set_down(nominal, FACE)
    estimator = filter_of(nominal, lengths, driven, begin) if estimated else None
    model, runs = modelled(slope, payload, **parameters), []
    while not runs or (len(gait.made) < steps and runs[-1].time[-1] < LONGEST):
        start = {"start": runs[-1]} if runs else {"nodes": begin, "rest_length": lengths}
        runs.append(
            tc.simulate(
                model, PART, controller=gait, winches=WINCHES, output_step=SAMPLE,
                estimator=estimator, **start,
            )
        )  # fmt: skip
    return gait, runs


def filter_of(model, lengths, driven, start):
    """Return a filter of directions and rates of the bars and angles of the motors."""
    free = tc.Model(model.structure, strings=model.strings)
    rest = tc.equilibrium(free, rest_length=lengths)
    plant = tc.linearize(free, rest, input="rest_length", actuated=driven)
    sensors = tc.Sensors(
        structure=model.structure, bar_direction=0.02, bar_rate=0.05, encoder=0.2,
        encoder_strings=driven, motor=tc.Motor(drum_radius=0.02, gear_ratio=20.0, zero=lengths),
    )  # fmt: skip
    return tc.KalmanFilter(
        plant, sensors, sample_time=SAMPLE, process_noise=0.1, rest_length_error=(2e-3, 5e-4),
        winches=WINCHES, rolling=True, start=start,
    )  # fmt: skip


def turn(axis, angle):
    """Return the matrix of a turn about a unit vector, clockwise seen from its tip."""
    across = np.cross(np.eye(3), axis).T
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across


def report_time(slopes, steps, plans):
    """Print the time of commands, and of a plan at once, over the sample time."""
    for slope in slopes:
        _, runs = rolled(slope, steps)
        times = np.concatenate([run.control.computing_time for run in runs]) / SAMPLE
        busy = times[times > np.median(times)]
        print(
            f"slope of {slope:g}°: a command takes {times.max():.3f} sample times at most, "
            f"{np.median(busy):.3f} in the median of those that plan"
        )
    model = modelled(slopes[-1])
    nodes, took = tc.plant.set_down(model, FACE), []
    for _ in range(plans):
        began = process_time()
        path = tc.shape.tipping_path(
            model, REST_LENGTH, FACE, [1.0, 0.0, 0.0], nodes=nodes, winches=WINCHES
        )
        took.append((process_time() - began) / SAMPLE)
    if plans:
        print(
            f"a plan of {path.margin.size} equilibria at once: {np.median(took):.3f} sample times"
        )


if __name__ == "__main__":
    main()
