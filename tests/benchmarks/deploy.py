"""Controllers as C code: difference from Python, time of a sample against Python, size.

Run: ``python -m tests.benchmarks.deploy``. Needs a C compiler. Each controller runs its nonlinear
plant for 500 samples, eight of them spoilt: a prism, a ball of six bars, or an arm in the plane.
Times are medians of one command, taken in turns and called from Python both: that call is part of
the time of the C code. Iterations are the most in a sample: changes of the active set.
``--controllers 2`` stops after the second.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from time import thread_time

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import compiler
from tests.benchmarks.command_line import options
from tests.deploy import scenes

SAMPLES = 500
SPOILT, ABSURD = (57, 120, 121, 122, 400), (180, 181, 300)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, samples=SAMPLES, controllers=10)
    found = compiler()
    if found is None:
        print("there is no C compiler")
        return
    plant = scenes.plant("force_density")
    wound = {"rest_length": scenes.plant("rest_length").rest_length, "input": "rest_length"}
    controllers = {
        "LQR": (
            tc.LQR(
                plant, *tc.energy_weights(plant), sample_time=scenes.SAMPLE, max_force_density=80.0
            ),
            {},
        ),
        "MPC, γ, N = 10": (scenes.of_force_density(), {}),
        "MPC, rest length, N = 4": (scenes.of_rest_length(), {"winches": scenes.WINCHES, **wound}),
        "MPC, winding, load, N = 4": (scenes.winding(), {"winches": scenes.WINDING, **wound}),
        "MPC, γ, load, N = 6": (scenes.with_load(), {}),
        "MPC, ball, N = 10": (scenes.tumbling(), {}),
        "MPC, planar arm, N = 4": (scenes.sliding(), {}),
        "NMPC, γ, N = 3, twice": (scenes.nonlinear(), {}),
        "NMPC, γ, load, N = 3": (scenes.nonlinear_with_load(), {"pull": 2 / 3}),
        "NMPC, rest length, N = 3": (
            scenes.nonlinear_of_rest_length(), {"winches": scenes.WINCHES, **wound}
        ),
    }  # fmt: skip
    print("controller                 difference  Python / C  iterations  code kB  numbers kB")
    for name, (controller, held) in islice(controllers.items(), given.controllers):
        with tempfile.TemporaryDirectory() as folder:
            made = tc.generate_c(controller, folder)
            pair = scenes.Pair(controller, made.compile(), SPOILT, ABSURD)
            run = scenes.closed_loop if controller.plant.nodes.shape == (3, 6) else scenes.shaken
            run(pair, samples=given.samples, **held)
            one, other = pair.statuses
            assert one == other  # what the table is about
            times = taken(pair)
            code, numbers = sizes(list(found), Path(folder))
        print(
            f"{name:26s} {pair.error:10.1e} {times[0] / times[1]:11.1f} "
            f"{max(pair.iterations):11d} {code / 1024:8.0f} {numbers / 1024:11.0f}"
        )


def taken(pair: scenes.Pair) -> list[float]:
    """Return the median time of a command of both, s: in turns, of the processor alone."""
    both = pair.one, pair.other
    for each in both:
        each.reset()
    times: list[list[float]] = [[], []]
    for time, *rest in pair.asked:
        N, V = (
            part.reshape(pair.plant.nodes.shape, order="F") for part in np.split(np.array(rest), 2)
        )
        for each, found in zip(both, times, strict=True):
            began = thread_time()
            each.command(time, N, V)
            found.append(thread_time() - began)
    return [float(np.median(found)) for found in times]


def sizes(command: tuple[str, ...], folder: Path) -> tuple[int, int]:
    """Return bytes of instructions, and of numbers, constant or not."""
    sources = [path.name for path in folder.glob("*.c") if path.name != "main.c"]
    subprocess.run([*command, "-O2", "-c", *sources], cwd=folder, check=True)
    objects = [path.name for path in folder.glob("*.o")]
    done = subprocess.run(
        ["size", "-A", *objects], cwd=folder, check=True, capture_output=True, text=True
    )
    rows = [line.split() for line in done.stdout.splitlines()]
    parts = [(row[0], int(row[1])) for row in rows if len(row) == 3 and row[1].isdigit()]
    code = sum(size for name, size in parts if name.startswith(".text"))
    numbers = sum(size for name, size in parts if name.startswith((".data", ".rodata", ".bss")))
    return code, numbers


if __name__ == "__main__":
    main()
