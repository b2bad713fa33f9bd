"""A Kalman filter and a controller as C code, in one closed loop with those of Python.

Run: ``python -m tests.benchmarks.filter_code``. Needs a C compiler. Readings are lost, infinite,
far off, or all wrong for so long that the filter starts anew. Printed are the largest difference
of nodes, m, of velocities, relative where they are beyond 1 m/s, and of commands, m, and the
statuses, which are equal. ``--samples 100`` shortens all loops, ``--only linear`` runs one.
"""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

import tenscontrol as tc
from tenscontrol.deploy.compiled_controller import compiled
from tenscontrol.status import Status
from tests.benchmarks.command_line import options

VECTOR = np.ctypeslib.ndpointer(np.float64, flags="C")
STEP = 0.02

RAMP = tc.Winches(ramp=True, rate=2.0, shortest=0.3, longest=3.0)

# Arguments of the filter, and samples. Of driven bars, alone or with strings, loops are linear.
LOOPS = {
    "linear": ({}, 5000),
    "nonlinear": ({"prediction": "nonlinear"}, 1000),
    "nonlinear, late, ramps": ({"prediction": "nonlinear", "delay": 2, "substeps": 4}, 600),
    "linear, late, ramps": ({"delay": 3, "substeps": 4}, 600),
    "driven bars": ({}, 5000),
    "both, late, MPC": ({"delay": 2}, 600),
}


@cache
def plant_of():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.5))
    rest = tc.prestress(model.structure, force_density=17.320508)
    return tc.linearize(model, rest, input="rest_length")


@cache
def strut_plant(both):
    """Joined bars that are driven, alone or after some strings."""
    structure = tc.library.d_bar_3d()
    model = tc.Model(structure, tc.LinearStrings(300.0, damping=2.0))
    rest = tc.prestress(structure, min_force_density=20.0)
    if both:
        return tc.linearize(model, rest, "length", actuated=[0], struts=[0, 2, 3, 4, 5])
    return tc.linearize(model, rest, "bar_length")


def strut_filter(plant, delay=0):
    both = {}
    if plant.input == "length":
        motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, zero=1.0)
        both = {"encoder": 0.2, "encoder_strings": [0], "motor": motor}
    sensors = tc.Sensors(
        structure=plant.model.structure, string_length=1e-3, string_tension=0.1, bar_direction=0.01,
        gyroscope=0.02, bias={"gyroscope": (0.02, 1e-3)}, delay=delay, **both,
    )  # fmt: skip
    errors = (1e-3, 1e-4) if both else None
    return tc.KalmanFilter(plant, sensors, sample_time=STEP, winches=RAMP, rest_length_error=errors)


def filter_of(plant, prediction="linear", delay=0, substeps=1, strings=(0, 4)):
    motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, zero=1.0)
    sensors = tc.Sensors(
        structure=plant.model.structure, bar_inclination=0.01, gyroscope=0.02, encoder=0.2,
        motor=motor, string_length=1e-3, strings=strings, bar_direction=0.01, bars=[1],
        bias={"gyroscope": (0.02, 1e-3)}, delay=delay,
    )  # fmt: skip
    winches = tc.Winches(rate=0.5, shortest=0.1, substeps=substeps) if substeps > 1 else None
    return tc.KalmanFilter(
        plant, sensors, sample_time=STEP, prediction=prediction, winches=winches,
        rest_length_error=(1e-3, 1e-4),
    )  # fmt: skip


@cache
def simulated():
    """The nonlinear motion of the prism and its readings."""
    return filter_of(plant_of(), "nonlinear").design


def regulator_of(plant):
    Q, R = tc.energy_weights(plant, by_mode=True)
    return tc.LQR(plant, Q, 10 * R, sample_time=STEP)


def strut_law(plant, name):
    if "MPC" in name:
        return tc.MPC(plant, horizon=4, sample_time=STEP, winches=RAMP)
    return tc.LQR(plant, sample_time=STEP, winches=RAMP)


def following(design, z, held, previous):
    """Return the true state a sample later, and what inputs do then."""
    if not design.plant.drives_bars:
        return np.array(simulated().motion(z, held)[0]).ravel(), held
    moved, rest = design.sampled, design.plant.equilibrium_input
    known = np.concatenate([held, (held - previous[: len(held)]) / STEP])
    before = previous[: len(held)] - rest
    return moved.transition @ z + moved.by_previous @ before + moved.by_input @ (held - rest), known


class Code:
    """Filter and controller in C; another one like it has a memory of its own."""

    def __init__(self, made, like=None):
        sources = [made.folder / f for f in made.files if f.endswith(".c") and f != "main.c"]
        self.built = compiled(made.name, sources, 200.0) if like is None else like.built
        path = made.folder / f"loaded_{id(self)}.so"
        path.write_bytes(self.built)
        self.library = ctypes.CDLL(str(path))
        self.library.controller_estimate.argtypes = [VECTOR] * 3
        self.library.controller_predict.argtypes = [VECTOR]
        self.library.controller_command.argtypes = [ctypes.c_double, *[VECTOR] * 3]
        self.shape, self.commands = made.structure.nodes.shape, len(made.low)

    def estimate(self, y):
        nodes, velocities = np.zeros((2, self.shape[0] * self.shape[1]))
        number = self.library.controller_estimate(np.ascontiguousarray(y), nodes, velocities)
        N, V = (part.reshape(self.shape, order="F") for part in (nodes, velocities))
        return N, V, tuple(Status)[number]

    def command(self, N, V, time=0.0):
        command = np.zeros(self.commands)
        parts = (np.ascontiguousarray(part.ravel(order="F")) for part in (N, V))
        self.library.controller_command(time, *parts, command)
        return command

    def predict(self, held):
        assert self.library.controller_predict(held) == 0


def spoilt(y, noise, k, rng):
    """Readings of which some are lost, infinite or far off; at times all."""
    y = y.copy()
    if k % 97 == 13:
        y[rng.integers(len(y))] = np.nan
    if k % 101 == 17:
        y[rng.integers(len(y))] = np.inf
    if k % 103 == 19:
        y[rng.integers(len(y))] += 1e3
    if k % 499 == 50:
        y[:] = np.nan
    if 60 <= k % 1013 < 65:  # as long as the patience of the filter
        y += 1e2
    if k % 9 == 5 and k % 1013 < 125:  # some pass alone, but not beside the others
        off = rng.choice(len(y), 8, replace=False)
        y[off] += noise[off] * rng.uniform(3, 8, size=8) * rng.choice([-1, 1], size=8)
    return y


def compare(name, samples, folder):
    """Return the largest difference of nodes, velocities and commands, and the statuses."""
    if name.startswith(("driven bars", "both")):
        plant = strut_plant(name.startswith("both"))
        estimator, law = strut_filter(plant, **LOOPS[name][0]), strut_law(plant, name)
    else:
        plant = plant_of()
        estimator, law = filter_of(plant, **LOOPS[name][0]), regulator_of(plant)
        assert simulated().extra == estimator.design.extra
    code = Code(tc.generate_c(law, folder, estimator=estimator))
    design, rng = estimator.design, np.random.default_rng(3)
    z, late, r = np.zeros(len(design.start)), [], plant.degrees_of_freedom
    z[:r] = 5e-3 * rng.normal(size=r)
    kick = 1e-2 * np.linalg.cholesky(design.process_covariance + 1e-18 * np.eye(len(z)))
    worst, statuses, noise = np.zeros(3), set(), estimator.sensors.noise
    known = plant.rest_length if design.start_input is None else design.start_input
    for k in range(samples):
        y = np.array(design.outputs(z, known)[0]).ravel()
        late.append(spoilt(y + noise * rng.normal(size=len(y)), noise, k, rng))
        read = late[max(0, k - estimator.sensors.delay)]
        estimate = estimator.update(read)
        N, V, status = code.estimate(read)
        assert status is estimate.status, k
        statuses.add(status)
        expected = law.command(0.0, estimate.nodes, estimate.velocities).value
        expected = plant.actuation.inputs(expected)
        held = code.command(N, V)
        off = np.abs(N - estimate.nodes), np.abs(V - estimate.velocities), np.abs(held - expected)
        sizes = 1.0, max(1.0, np.abs(V).max()), 1.0
        off = [part.max() / size for part, size in zip(off, sizes, strict=True)]
        worst = np.maximum(worst, off)
        estimator.predict(plant.actuation.strings(held))
        code.predict(held)
        z, known = following(design, z, held, known)
        z = z + kick @ rng.normal(size=len(z))
    return worst, statuses


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, samples=5000, only="")
    print("filter                  samples    nodes  velocities  commands  statuses")
    for name in [given.only] if given.only else LOOPS:
        samples = min(given.samples, LOOPS[name][1])
        with tempfile.TemporaryDirectory() as folder:
            worst, statuses = compare(name, samples, Path(folder))
        seen = ", ".join(sorted(map(str, statuses)))
        numbers = "{:9.1e} {:11.1e} {:9.1e}".format(*worst)
        print(f"{name:23} {samples:7d} {numbers}  {seen}", flush=True)


if __name__ == "__main__":
    main()
