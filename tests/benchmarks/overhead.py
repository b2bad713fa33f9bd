"""What a call costs beside its steps: the import, the first call of a script, the Python of a run.

``python -m tests.benchmarks.overhead``. Of processes of their own, the median of several: processor
time of ``import tenscontrol`` beyond NumPy, beside that of python-control, and wall and processor
time of a script that throws a ball for 5 s, beside a script that reads the same ball into MuJoCo
and runs it by ``implicitfast`` in steps of 2.5 ms. In this process, processor time of calls on that
ball: the first of a model; a later one of a single short step, which is what each call costs; and
what 1,000 states more cost than one. Needs the extra ``bench``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import tenscontrol as tc
from tests.benchmarks.cheapest import seconds_of
from tests.benchmarks.command_line import options
from tests.benchmarks.error_against_time import thrown

_TIMED = """
import time
import numpy
wall, processor = time.perf_counter(), time.process_time()
{}
print(time.perf_counter() - wall, time.process_time() - processor)
"""

IMPORTS = {
    "import tenscontrol": "import tenscontrol",
    "  and a prism's model": "import tenscontrol as tc; tc.Model(tc.prism()).dynamics",
    "import control, for scale": "import control",
}

_FIRST = {
    "first call: tenscontrol": """
import tenscontrol as tc
ball = tc.library.six_bar_ball(bar_length=1.0)
model = tc.Model(ball, strings=tc.LinearStrings(500.0), gravity=9.81)
velocities = numpy.tile([[1.0], [0.0], [4.0]], 12)
tc.simulate(model, 5.0, velocities=velocities, rest_length=0.999 * ball.string_length())
""",
    "first call: MuJoCo": """
import mujoco, sys
model = mujoco.MjModel.from_xml_path(sys.argv[1])
model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)
for _ in range(1000):
    mujoco.mj_step(model, data, round(0.005 / model.opt.timestep))
""",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    repeats = options(__doc__, arguments, repeats=7).repeats
    print(f"{'a process of its own':32s} {'wall s':>8s} {'processor s':>12s}")
    programs = IMPORTS | _FIRST
    with TemporaryDirectory() as folder:
        path = Path(folder) / "ball.xml"
        scene = thrown(5.0, 3.0, 500.0, 0.5)
        text = tc.exchange.to_mujoco(
            scene.model, rest_length=scene.input_value, velocities=scene.velocities, step=2.5e-3
        )
        path.write_text(text)
        turns = [
            {label: of_process(program, path) for label, program in programs.items()}
            for _ in range(repeats + 1)
        ]
    for label in programs:  # the first turn wrote the bytecode, as an installation does
        wall, processor = (median(turn[label][i] for turn in turns[1:]) for i in range(2))
        print(f"{label:32s} {wall:8.3f} {processor:12.3f}")
    print(f"{'in this process':32s} {'ms':>8s}")
    calls = [of_calls() for _ in range(repeats)]
    for label in calls[0]:
        print(f"{label:32s} {1e3 * median(call[label] for call in calls):8.2f}")


def of_process(program: str, path: Path) -> list[float]:
    """Return wall and processor time, s, that a program takes after NumPy's import."""
    command = [sys.executable, "-c", _TIMED.format(program), str(path)]
    bytecode = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(path.parent)}
    finished = subprocess.run(
        command, capture_output=True, text=True, check=True, env=os.environ | bytecode
    )
    return [float(x) for x in finished.stdout.split()]


def of_calls() -> dict[str, float]:
    """Return the processor time of calls on a new model, s."""
    scene = thrown(5.0, 3.0, 500.0, 0.5)

    def call(duration: float, outputs: int) -> float:
        return seconds_of(
            lambda: tc.simulate(
                scene.model, duration, velocities=scene.velocities,
                rest_length=scene.input_value, output_step=duration / outputs, error="none",
            )
        )  # fmt: skip

    first = call(5.0, 1)
    short, one, many = (
        min(call(*each) for _ in range(3)) for each in ((1e-4, 1), (5.0, 1), (5.0, 1000))
    )
    return {
        "first call of a model, 5 s": first,
        "a later one": one,
        "a later one of 0.1 ms": short,
        "1,000 states over one": many - one,
    }


if __name__ == "__main__":
    main()
