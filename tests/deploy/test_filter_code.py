"""The Kalman filter as C code: equal to Python's in a closed loop, whatever is read."""

import ctypes

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.deploy.compiled_controller import compiled
from tenscontrol.status import Status
from tests.deploy import scenes
from tests.fuzz import sanitizers

VECTOR = np.ctypeslib.ndpointer(np.float64, flags="C")
STEP = scenes.SAMPLE


def plant_of():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.5))
    rest = tc.prestress(model.structure, force_density=17.320508)
    return tc.linearize(model, rest, input="rest_length")


def filter_of(plant, prediction="linear", delay=0, substeps=1):
    motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, zero=1.0)
    sensors = tc.Sensors(
        structure=plant.model.structure, bar_inclination=0.01, gyroscope=0.02, encoder=0.2,
        motor=motor, string_length=1e-3, strings=[0, 4], bar_direction=0.01, bars=[1],
        bias={"gyroscope": (0.02, 1e-3)}, delay=delay,
    )  # fmt: skip
    winches = tc.Winches(rate=0.5, shortest=0.1, substeps=substeps) if substeps > 1 else None
    return tc.KalmanFilter(
        plant, sensors, sample_time=STEP, prediction=prediction, winches=winches,
        rest_length_error=(1e-3, 1e-4),
    )  # fmt: skip


def regulator_of(plant):
    Q, R = tc.energy_weights(plant, by_mode=True)
    return tc.LQR(plant, Q, 10 * R, sample_time=STEP)


class Code:
    """Filter and controller in C."""

    def __init__(self, made):
        sources = [made.folder / f for f in made.files if f.endswith(".c") and f != "main.c"]
        path = made.folder / "loaded.so"
        path.write_bytes(compiled(made.name, sources, 100.0))
        self.library = ctypes.CDLL(str(path))
        self.library.controller_estimate.argtypes = [VECTOR] * 3
        self.library.controller_predict.argtypes = [VECTOR]
        self.library.controller_command.argtypes = [ctypes.c_double, *[VECTOR] * 3]
        self.shape, self.commands = made.plant.nodes.shape, len(made.low)

    def estimate(self, y):
        nodes, velocities = np.zeros((2, self.shape[0] * self.shape[1]))
        number = self.library.controller_estimate(np.ascontiguousarray(y), nodes, velocities)
        N, V = (part.reshape(self.shape, order="F") for part in (nodes, velocities))
        return N, V, tuple(Status)[number]

    def command(self, N, V):
        command = np.zeros(self.commands)
        parts = (np.ascontiguousarray(part.ravel(order="F")) for part in (N, V))
        self.library.controller_command(0.0, *parts, command)
        return command

    def predict(self, held):
        assert self.library.controller_predict(held) == 0


def spoilt(y, k, rng):
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
    if k % 1013 < 5:  # as long as the patience of the filter
        y += 1e2
    return y


@pytest.mark.parametrize(
    ("options", "samples"),
    [
        ({}, 5000),
        ({"prediction": "nonlinear"}, 1000),
        ({"prediction": "nonlinear", "delay": 2, "substeps": 4}, 600),
        ({"delay": 3, "substeps": 4}, 600),
    ],
)
def test_a_loop_with_c_is_that_with_python(options, samples, tmp_path):
    plant = plant_of()
    estimator, law = filter_of(plant, **options), regulator_of(plant)
    code = Code(tc.generate_c(law, tmp_path, estimator=estimator))
    design, rng = estimator.design, np.random.default_rng(3)
    truth = filter_of(plant, "nonlinear").design  # what is simulated
    assert truth.extra == design.extra
    z, late = np.zeros(len(design.start)), []
    z[:9] = 5e-3 * rng.normal(size=9)
    kick = 1e-2 * np.linalg.cholesky(design.process_covariance + 1e-18 * np.eye(len(z)))
    worst, statuses = np.zeros(3), set()
    held = plant.rest_length
    for k in range(samples):
        y = np.array(truth.outputs(z, held)[0]).ravel()
        late.append(spoilt(y + estimator.sensors.noise * rng.normal(size=len(y)), k, rng))
        read = late[max(0, k - estimator.sensors.delay)]
        estimate = estimator.update(read)
        N, V, status = code.estimate(read)
        assert status is estimate.status, k
        statuses.add(status)
        expected = law.command(0.0, estimate.nodes, estimate.velocities).value
        held = code.command(N, V)
        off = np.abs(N - estimate.nodes), np.abs(V - estimate.velocities), np.abs(held - expected)
        sizes = 1.0, max(1.0, np.abs(V).max()), 1.0
        off = [part.max() / size for part, size in zip(off, sizes, strict=True)]
        worst = np.maximum(worst, off)
        estimator.predict(held)
        code.predict(held)
        z = np.array(truth.motion(z, held)[0]).ravel() + kick @ rng.normal(size=len(z))
    assert worst.max() < 1e-12, worst
    assert {Status.OK, Status.PARTLY_USED, Status.LOST, Status.RESTARTED} <= statuses


PLAY = """
#include <stdio.h>
#include "controller.h"

int main(void)
{
    double y[FILTER_NUMBERS], u[CONTROLLER_COMMANDS], command[CONTROLLER_COMMANDS];
    double N[CONTROLLER_COORDINATES], V[CONTROLLER_COORDINATES];
    int i;
    for (;;) {
        for (i = 0; i < FILTER_NUMBERS; i++)
            if (scanf("%lf", &y[i]) != 1)
                return 0;
        for (i = 0; i < CONTROLLER_COMMANDS; i++)
            if (scanf("%lf", &u[i]) != 1)
                return 1;
        controller_estimate(y, N, V);
        controller_command(0.0, N, V, command);
        controller_predict(u);
        for (i = 0; i < CONTROLLER_COORDINATES; i++)
            printf("%.17g %.17g ", N[i], V[i]);
        printf("\\n");
    }
}
"""


@pytest.mark.skipif(not sanitizers.can_sanitize(), reason="needs a compiler with sanitizers")
@pytest.mark.parametrize("options", [{}, {"prediction": "nonlinear", "delay": 2}])
def test_absurd_readings_and_inputs_are_clean_under_the_sanitizers(options, tmp_path):
    plant = plant_of()
    estimator = filter_of(plant, **options)
    made = tc.generate_c(regulator_of(plant), tmp_path, estimator=estimator)
    (tmp_path / "main.c").write_text(PLAY)
    sources = [file for file in made.files if file.endswith(".c")]
    strict = [*sanitizers.CHECKED, "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    sanitizers.build(sources, tmp_path, strict)
    rng, count = np.random.default_rng(0), len(estimator.sensors.noise)
    usual = np.r_[estimator.sensors.measure(
        plant.nodes, velocities=0 * plant.nodes, rest_length=plant.rest_length
    ), plant.rest_length]  # fmt: skip
    rows = usual + 1e-3 * rng.normal(size=(300, len(usual)))
    for row in rows[::3]:
        row[rng.integers(len(row), size=3)] = rng.choice(sanitizers.ABSURD, 3)
    rows[5::17, :count] = rng.choice(sanitizers.ABSURD, size=rows[5::17, :count].shape)
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    lines = sanitizers.run(["./program"], tmp_path, text).splitlines()
    assert len(lines) == len(rows)
    assert np.isfinite([[float(word) for word in line.split()] for line in lines]).all()


def test_predictive_control_and_a_filter_go_into_one_folder(tmp_path):
    plant = plant_of()
    winches = tc.Winches(rate=0.5, shortest=0.1)
    mpc = tc.MPC(plant, horizon=3, sample_time=STEP, winches=winches)
    made = tc.generate_c(mpc, tmp_path, estimator=filter_of(plant))
    code, N, command = Code(made), plant.nodes, plant.rest_length
    for _ in range(5):
        y = filter_of(plant).sensors.measure(N, velocities=0 * N, rest_length=command)
        nodes, velocities, _ = code.estimate(y)
        command = mpc.command(0.0, nodes, velocities).value
        np.testing.assert_allclose(code.command(nodes, velocities), command, rtol=0, atol=1e-12)
        code.predict(command)
    use = made.memory()
    assert use.ram < 2**19


def test_what_does_not_go_together_is_refused(tmp_path):
    plant = plant_of()
    law = regulator_of(plant)
    with pytest.raises(TypeError, match=r"estimator is .*make one by KalmanFilter"):
        tc.generate_c(law, tmp_path, estimator=law)
    other = tc.KalmanFilter(plant, filter_of(plant).sensors, sample_time=0.01,
                            rest_length_error=(1e-3, 1e-4))  # fmt: skip
    with pytest.raises(
        ValueError, match=r"sample time of 0\.01 s, but the controller one of 0\.02"
    ):
        tc.generate_c(law, tmp_path, estimator=other)
    quad = tc.prism(sides=4)
    model = tc.Model(quad, strings=tc.LinearStrings(100.0, damping=0.5))
    wide = tc.linearize(model, tc.prestress(quad, 17.3), input="rest_length")
    sensors = tc.Sensors(structure=quad, string_length=1e-3, bar_direction=0.01)
    with pytest.raises(ValueError, match="estimator is for"):
        tc.generate_c(law, tmp_path, estimator=tc.KalmanFilter(wide, sensors, sample_time=STEP))
    assert not list(tmp_path.iterdir())
