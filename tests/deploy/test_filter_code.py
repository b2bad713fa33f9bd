"""The Kalman filter as C code: equal to Python's in a closed loop, whatever is read."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.status import Status
from tests.benchmarks import filter_code
from tests.benchmarks.filter_code import STEP, filter_of, plant_of, regulator_of
from tests.deploy.scenes import coupled_plant
from tests.fuzz import sanitizers


@pytest.mark.parametrize("name", ["nonlinear, late, ramps", "both, late, MPC"])
def test_a_loop_with_c_is_that_with_python(name, tmp_path):
    worst, statuses = filter_code.compare(name, 75, tmp_path)  # all of it: the benchmark
    assert worst.max() < 1e-12, worst
    assert {Status.OK, Status.PARTLY_USED, Status.LOST, Status.RESTARTED} <= statuses


def test_c_goes_on_where_readings_never_agree_or_are_very_good(tmp_path):
    plant = plant_of()
    sensors = tc.Sensors(plant.model.structure, node_position=1e-9)
    estimator = tc.KalmanFilter(plant, sensors, sample_time=STEP, patience=1)
    code = filter_code.Code(tc.generate_c(regulator_of(plant), tmp_path, estimator=estimator))
    good, held = sensors.measure(plant.nodes), plant.rest_length
    for k in range(400):  # a spread that grew without bound would leave the range of numbers
        y = good if k > 380 else -good
        N, V, status = code.estimate(y)
        expected = estimator.update(y)
        assert status == expected.status
        np.testing.assert_allclose(N, expected.nodes, rtol=0, atol=1e-6)
        np.testing.assert_allclose(V, expected.velocities, rtol=0, atol=1e-4)
        code.predict(held)
        estimator.predict(held)
    assert status == Status.OK
    assert estimator.statistics.restarts > 100


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
def test_absurd_readings_and_inputs_are_clean_under_the_sanitizers(tmp_path):
    plant = coupled_plant("d_bar")
    estimator = filter_of(plant, prediction="nonlinear", delay=2, strings=(1,))
    made = tc.generate_c(regulator_of(plant), tmp_path, estimator=estimator)
    (tmp_path / "main.c").write_text(PLAY)
    sources = [file for file in made.files if file.endswith(".c")]
    strict = [*sanitizers.CHECKED, "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    sanitizers.build(sources, tmp_path, strict)
    rng, count = np.random.default_rng(0), len(estimator.sensors.noise)
    usual = np.r_[estimator.sensors.measure(
        plant.nodes, velocities=0 * plant.nodes, rest_length=plant.rest_length
    ), plant.rest_length]  # fmt: skip
    rows = usual + 1e-3 * rng.normal(size=(120, len(usual)))
    for row in rows[::3]:
        row[rng.integers(len(row), size=3)] = rng.choice(sanitizers.ABSURD, 3)
    rows[5::17, :count] = rng.choice(sanitizers.ABSURD, size=rows[5::17, :count].shape)
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    lines = sanitizers.run(["./program"], tmp_path, text).splitlines()
    assert len(lines) == len(rows)
    assert np.isfinite([[float(word) for word in line.split()] for line in lines]).all()


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
