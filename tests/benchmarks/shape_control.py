"""Shape control against MPC and NMPC on one move, and how fast its errors may decay.

Run: ``python -m tests.benchmarks.shape_control``. The prism goes from 1.0 to 0.85 m from a
disturbed start, sampled at 50 Hz; same reference, start, bounds of γ and winches for all. All are
designed about the target. Errors are those of node positions, the shape laid over the reference;
"moving" leaves out the first quarter of the move, in which the disturbance is taken back. Effort
is ∫|γ − γ₀|² in N²s/m², time that of the run relative to a row of shape control. The last table:
the rate at which tracked errors decay, relative to the design, with γ held and with rest lengths
held between samples.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from time import perf_counter

import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options

STEP, DURATION = 0.02, 4.0
HEIGHT, TOP = 0.85, 17.320508
MOVES = (2.0, 80.0), (0.3, 30.2)  # s, and the largest γ, N/m; the prestress has 30
STIFFNESS = 100.0  # N/m
FREQUENCIES = 0.6, 1.2, 2.4  # Hz
SHARES = 0.01, 0.02, 0.04, 0.08, 0.12, 0.15


def shape(height):
    """The prism with the bars of one of 1 m, and this height, m."""
    length = tc.prism().bar_length[0]
    return tc.prism(radius=tc.structure.prism_radius(length, height), height=height)


def reference(duration):
    """Down in this time, s, without a jump in speed or acceleration."""
    share = np.linspace(0.0, 1.0, 101)
    drop = (1.0 - HEIGHT) * (10 * share**3 - 15 * share**4 + 6 * share**5)
    return tc.Reference(duration * share, np.stack([shape(1.0 - each).nodes for each in drop], -1))


def plants():
    """The prism linearized about the start and about the target."""
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(STIFFNESS))
    return tuple(tc.linearize(model, tc.prestress(shape(height), TOP)) for height in (1.0, HEIGHT))


def errors(plant, path, run):
    """Largest error of a node coordinate at each output, m."""
    still = np.zeros_like(plant.nodes)
    r = plant.degrees_of_freedom
    wanted = np.array([plant.measure(each, still)[:r] for each in np.moveaxis(path.nodes, 2, 0)])
    found = []
    for k, time in enumerate(run.time):
        q = plant.measure(run.nodes[:, :, k], run.velocities[:, :, k])[:r]
        aim = [np.interp(time, path.time, column) for column in wanted.T]
        found.append(np.abs(plant.basis @ (q - aim)).max())
    return np.array(found)


def controllers(plant, path, limit):
    found = {
        f"shape control, {f:g} Hz": tc.FeedbackLinearization(
            plant, reference=path, sample_time=STEP, max_force_density=limit, frequency=f
        )
        for f in FREQUENCIES
    }
    found["MPC"] = tc.MPC(
        plant, horizon=20, sample_time=STEP, max_force_density=limit, reference=path
    )
    found["NMPC"] = tc.NMPC(
        plant, horizon=20, sample_time=STEP, max_force_density=limit, reference=path
    )
    return found


def play(hold, move, limit, duration):
    """Figures of every controller: a row of numbers by name."""
    before, plant = plants()
    path, model = reference(move), plant.model
    start = before.to_nodes(0.003 * np.random.default_rng(0).normal(size=9))
    actuators = {}
    if hold == "rest_length":
        wound = tc.to_rest_length(model, start, before.force_density).rest_length
        actuators = {"winches": tc.Winches(rate=0.5, shortest=0.1), "rest_length": wound}
    rows = {}
    for name, controller in controllers(plant, path, limit).items():
        began = perf_counter()
        run = tc.simulate(
            model, duration, nodes=start, controller=controller, input=hold, step=1e-3,
            output_step=STEP, **actuators,
        )  # fmt: skip
        gamma = run.control.command
        off, moving = errors(plant, path, run), run.time >= min(move, duration) / 4
        height = run.nodes[2, :3].mean(axis=0) - run.nodes[2, 3:].mean(axis=0)
        rows[name] = (
            1e3 * abs(height[-1] - HEIGHT),
            1e3 * off[-25:].max(),
            1e3 * off[moving].max(),
            1e3 * np.sqrt((off**2).mean()),
            STEP * ((gamma - plant.force_density[:, None]) ** 2).sum(),
            np.abs(np.diff(gamma)).max() / STEP,
            100 * ((gamma < 1e-4) | (gamma > limit - 1e-4)).any(axis=0).mean(),
            sum(status != "ok" for status in run.control.status),
            perf_counter() - began,
        )
    return rows


def settling(stiffness, share):
    """Decay of tracked errors relative to the design at ``frequency · step = share``."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness) if stiffness else None)
    plant = tc.linearize(model, tc.prestress(prism, TOP))
    rows = np.zeros((3, 3, 6))
    for i in range(3):
        rows[i, 2, [i, 3 + i]] = 1, -1
    law = tc.FeedbackLinearization(
        plant,
        reference=None,
        sample_time=STEP,
        max_force_density=min(80.0, 0.8 * (stiffness or np.inf)),
        frequency=share / STEP,
        tracked=rows.transpose(0, 2, 1).reshape(3, 18),
    )
    start = shape(0.99).nodes
    # As long as the law takes to a hundredth: (1 + ωt) exp(−ωt).
    duration = STEP * np.ceil(6.64 / (2 * np.pi * share))
    try:
        run = tc.simulate(
            model, duration, nodes=start, controller=law, step=STEP / 40, output_step=STEP,
            input="rest_length" if stiffness else "force_density",
        )  # fmt: skip
    except tc.simulation.SimulationError:
        return np.nan
    size = [
        np.linalg.norm(law.error(run.time[k], run.nodes[:, :, k], run.velocities[:, :, k])[0])
        for k in (0, -1)
    ]
    return np.log(size[1] / size[0]) / np.log(0.01)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, duration=DURATION, shares=SHARES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # stiff strings undo a law in γ: that is what is measured
        tables(given.duration, given.shares)


def tables(duration, shares):
    for hold in ("force_density", "rest_length"):
        for move, limit in MOVES:
            rows = play(hold, move, limit, duration)
            print(f"{move:g} s, {hold} held, γ at most {limit:g} N/m; errors in mm")
            print(
                f"{'':24s}{'height':>8s}{'end':>8s}{'moving':>8s}{'rms':>8s}{'effort':>9s}"
                f"{'γ rate':>9s}{'bound':>8s}{'not ok':>8s}{'time':>7s}"
            )
            base = rows[f"shape control, {FREQUENCIES[1]:g} Hz"][-1]
            for name, row in rows.items():
                print(
                    f"{name:24s}{row[0]:8.3f}{row[1]:8.3f}{row[2]:8.3f}{row[3]:8.3f}{row[4]:9.3f}"
                    f"{row[5]:9.1f}{row[6]:6.0f} %{row[7]:8d}{row[8] / base:7.1f}"
                )
    print(
        "\nrate of decay / design   " + "".join(f"{s:>9.2f}" for s in shares) + "  frequency·step"
    )
    for stiffness in (None, 1e2, 1e3, 1e4):
        held = "γ held" if stiffness is None else f"rest length held, {stiffness:g} N/m"
        print(f"{held:25s}" + "".join(f"{settling(stiffness, s):9.2f}" for s in shares))


if __name__ == "__main__":
    main()
