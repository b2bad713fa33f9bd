"""A prism lowered from 1.0 m to 0.7 m, twisted by 20 degrees, and brought back, by winches.

Run: ``python -m tests.benchmarks.morph``, with ``--jumps`` for winches that jump at the start of a
sample, ``--rate 0.4`` for faster winches, ``--interpreted`` for a controller that is not compiled,
or with stiffnesses in N/m. Some minutes: the integrator follows strings of up to 25,000 rad/s.

Twelve strings, rest lengths held, 0.02 s samples. One nonlinear MPC is designed half way, on
strings without mass. The plant has strings of 5 % of the mass of the bars, each in two segments,
with a damping of c = 0.02 √k: about 2 % of critical for the bars on their strings, as rope and
wire have. The error is the largest of the last 0.5 s of rest at the goal and at the start.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import tenscontrol as tc

TOP, BOTTOM = [0, 1, 2], [3, 4, 5]
SHAPES = ((1.0, -35.0), (0.7, -55.0))  # m and degrees, start and goal
LEVEL, LEAST, LARGEST_TENSION = 17.32, 2.0, 45.0  # N/m, N/m, N
RANGE, RATE = (0.4, 1.3), 0.1  # m, m/s
SAMPLE, HORIZON = 0.02, 10
SEGMENTS, MASS_SHARE = 2, 0.05
REST = 1.0  # s, at the goal and at the end

# Parts in which a winch winds: each much shorter than the stretch of a string, T/k.
PIECES = {1e2: 20, 1e3: 20, 1e4: 20, 1e5: 100, 1e6: 500}


@dataclass(frozen=True, eq=False)
class Morphed:
    """What came of a run: SI units, degrees, worst values."""

    run: tc.simulation.Trajectory
    height_error: float
    twist_error: float
    node_error: float
    least_force_density: float
    largest_tension: float
    rate: float
    at_rate: float
    in_range: bool
    statuses: dict
    controller: tc.control.Controller


def morph(stiffness, pieces, rate=RATE, machine_code=True):
    """Return what becomes of the prism on its way there and back."""
    damping = 0.02 * np.sqrt(stiffness)
    prism = tc.prism(diagonals=True)
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness, damping=damping))
    start, goal = (
        tc.shape_target(
            model,
            [tc.Height(height, TOP, BOTTOM), tc.Twist(np.radians(twist), TOP, BOTTOM)],
            force_density=LEVEL,
            min_force_density=LEAST,
            symmetry=tc.RotationalSymmetry([TOP, BOTTOM]),
        )
        for height, twist in SHAPES
    )
    winches = tc.Winches(rate, *RANGE, substeps=pieces)
    path = tc.shape_path(model, start, goal, winches=winches, step=SAMPLE, min_force_density=LEAST)
    there = path.reference()
    reference = there.then(there.reversed(), pause=REST)
    (half,) = path.plants(1, "rest_length")
    controller = tc.NMPC(
        half,
        horizon=HORIZON,
        sample_time=SAMPLE,
        reference=reference,
        winches=winches,
        min_force_density=LEAST,
        max_tension=LARGEST_TENSION,
        machine_code=machine_code,
    )
    mass = MASS_SHARE * prism.bar_mass.sum() / len(prism.strings)
    massive = tc.subdivide(start.prestress.structure, SEGMENTS, string_mass=mass)
    segments = tc.structure.segment_counts(massive)
    plant = tc.Model(
        massive, strings=tc.LinearStrings(stiffness * segments, damping=damping * segments)
    )
    fastest = 2 * np.sqrt(SEGMENTS * stiffness * (SEGMENTS - 1) / mass)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tc.simulation.AccuracyWarning)
        run = tc.simulate(
            plant,
            reference.time[-1] + REST,
            controller=controller,
            winches=winches,
            rest_length=path.rest_length[:, 0],
            step=min(1e-3, 1.0 / fastest),
            output_step=SAMPLE,
        )
    return _read(run, (start, goal), path.time[-1], rate, controller)


def _read(run, shapes, there, rate, controller):
    start, goal = shapes
    rests = (
        (goal, (run.time > there + 0.5 * REST) & (run.time <= there + REST)),
        (start, run.time > run.time[-1] - 0.5 * REST),
    )
    errors = []
    for shape, when in rests:
        places = np.flatnonzero(when)
        for k in places[:: max(1, len(places) // 50)]:
            nodes = run.nodes[:, :6, k]
            errors.append((
                height(nodes) - height(shape.nodes),
                np.degrees(twist(nodes) - twist(shape.nodes)),
                farthest(nodes, shape.nodes),
            ))  # fmt: skip
    structure = run.structure
    lengths = np.linalg.norm(
        run.nodes[:, structure.strings[:, 1]] - run.nodes[:, structure.strings[:, 0]], axis=0
    )
    applied, rates = run.control.applied, np.abs(run.control.winch_rate)
    return Morphed(
        run,
        *np.abs(errors).max(axis=0),
        # Of a whole string: its segments have as many times its γ, and its tension.
        least_force_density=float(run.force_density.min()) / SEGMENTS,
        largest_tension=float((run.force_density * lengths).max()),
        rate=float(rates.max()),
        at_rate=float((rates.max(axis=0) > 0.99 * rate).mean()),
        in_range=bool((applied >= RANGE[0]).all() and (applied <= RANGE[1]).all()),
        statuses={str(each): n for each, n in run.control.status_count.items()},
        controller=controller,
    )


def height(nodes):
    """Return the distance of the centres of top and bottom, m."""
    return float(np.linalg.norm(nodes[:, TOP].mean(axis=1) - nodes[:, BOTTOM].mean(axis=1)))


def twist(nodes):
    """Return the turn of the top against the bottom about the line of their centres, rad."""
    top, bottom = (nodes[:, part] - nodes[:, part].mean(axis=1)[:, None] for part in (TOP, BOTTOM))
    axis = nodes[:, TOP].mean(axis=1) - nodes[:, BOTTOM].mean(axis=1)
    axis = axis / np.linalg.norm(axis)
    across = (np.cross(bottom.T, top.T) @ axis).sum()
    along = (top * bottom).sum() - (axis @ top) @ (axis @ bottom)
    return float(np.arctan2(across, along))


def farthest(nodes, goal):
    """Return how far a node is from its goal after the best motion as one body, m."""
    here, there = (each - each.mean(axis=1)[:, None] for each in (nodes, goal))
    U, _, Vt = np.linalg.svd(there @ here.T)
    turn = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return float(np.linalg.norm(turn @ here - there, axis=0).max())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("stiffness", nargs="*", type=float, default=list(PIECES))
    parser.add_argument("--jumps", action="store_true")
    parser.add_argument("--rate", type=float, default=RATE)
    parser.add_argument("--interpreted", action="store_true")
    given = parser.parse_args(arguments)
    print("k, N/m  pieces  height, mm  twist, deg  node, mm  γ, N/m  tension, N  "
          "rate, m/s  samples at it  statuses")  # fmt: skip
    for stiffness in given.stiffness:
        pieces = 1 if given.jumps else PIECES[stiffness]
        try:
            made = morph(stiffness, pieces, rate=given.rate, machine_code=not given.interpreted)
        except tc.simulation.SimulationError as error:
            print(f"{stiffness:6.0e}  {pieces:6d}  {error}", flush=True)
            continue
        print(
            f"{stiffness:6.0e}  {pieces:6d}  {1e3 * made.height_error:10.5f}  "
            f"{made.twist_error:10.6f}  {1e3 * made.node_error:8.5f}  "
            f"{made.least_force_density:6.2f}  {made.largest_tension:10.1f}  "
            f"{made.rate:9.6f}  {100 * made.at_rate:11.0f} %  {made.statuses}"
            f"{'' if made.in_range else '  out of range'}",
            flush=True,
        )
        work = made.controller.statistics
        step = (work.preparation_time + work.feedback_time)[1:] / SAMPLE
        print(
            f"        step / sample time: median {np.median(step):.2f}, 99th percentile "
            f"{np.percentile(step, 99):.2f}; changes of the active set: median "
            f"{np.median(work.iterations):.0f}, most {work.iterations.max()}",
            flush=True,
        )


if __name__ == "__main__":
    main()
