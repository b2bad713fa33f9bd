"""The rolling gait as C code: equal to Python's in a run, in space and in the plane."""

import pickle

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.status import Status
from tests.benchmarks import rolling_code
from tests.deploy import scenes
from tests.fuzz import sanitizers

SPOILT, ABSURD = (40, 41, 90), (60, 130)


class Both:
    """Obeys the gait in Python, and asks the code for the same command."""

    input, sample_time = "rest_length", 0.05

    def __init__(self, gait, code):
        self.gait = gait
        home = gait.settings.plans.home
        self.python = tc.FunctionController(gait.settings.structure, gait, equilibrium_input=home)
        self.code = code
        self.answers = []

    def reset(self):
        self.python.reset()
        self.code.reset()

    def applied(self, value):
        self.python.applied(value)
        self.code.applied(value)

    def command(self, time, nodes, velocities):
        nodes, velocities = np.array(nodes), np.array(velocities)
        if len(self.answers) in SPOILT:
            velocities[1, 2] = np.nan
        if len(self.answers) in ABSURD:
            nodes[:, 0] *= 3.0
        pair = [each.command(time, nodes, velocities) for each in (self.python, self.code)]
        self.answers.append(pair)
        return pair[0].value

    def check(self):
        values = np.array([[each.value for each in pair] for pair in self.answers])
        assert np.abs(values[:, 0] - values[:, 1]).max() < 1e-12
        assert all(str(one) == str(other) for one, other in self.answers)


@pytest.fixture(scope="module")
def code(tmp_path_factory):
    return tc.generate_c(scenes.rolling_gait(), tmp_path_factory.mktemp("gait"))


def test_a_ball_rolls_by_the_commands_of_python(code):
    gait, (model, nodes, winches) = scenes.rolling_gait(), scenes.rolling_ball()
    compiled = code.compile()
    both = Both(gait, pickle.loads(pickle.dumps(compiled)))
    run = tc.simulate(
        model, 7.0, nodes, controller=both, winches=winches, rest_length=0.55, method="rk4",
        step=1e-3, project=True, error="none", output_step=0.05,
    )  # fmt: skip
    both.check()
    assert len(gait.made) >= 2
    assert np.ptp(run.nodes.mean(axis=1)[0]) > 0.5
    statuses = [str(command.status) for _, command in both.answers]
    assert [k for k, status in enumerate(statuses) if "finite" in status] == list(SPOILT)
    assert [k for k, status in enumerate(statuses) if "plausible" in status] == list(ABSURD)


def test_what_it_takes(code):
    assert code.kind == "RollingGait"
    assert code.plant is None
    assert "controller_casadi.c" not in code.files
    use = code.memory()
    assert set(use.functions) <= {"atan2", "cos", "sin", "sincos", "sqrt", "fmin", "fmax"}
    assert 50_000 < use.flash < 200_000
    assert use.ram < 1000


def test_in_the_plane_and_where_no_step_comes(tmp_path):
    """Every way through the law: shapes that do not tip, so that all edges are tried."""
    structure = tc.library.snelson_x()
    model = tc.Model(
        structure, strings=tc.LinearStrings(1000.0), gravity=9.81, ground=tc.Ground(5e3)
    )
    rest = tc.to_rest_length(
        model, structure.nodes, tc.prestress(structure, min_force_density=60.0).force_density
    ).rest_length
    gait = tc.shape.RollingGait(model, rest, [1.0, 0.0], 0.1, steps=5, tabulated=True)
    both = Both(gait, tc.generate_c(gait, tmp_path).compile())
    faces, nodes, phases = gait.settings.plans.faces, tc.plant.set_down(model, [0, 1]), set()
    for k in range(400):
        if k in (40, 180):  # over the edge that it winds over
            feet, edge = gait._planner.feet, gait._planner.edge
            (onto,) = (
                face.feet for face in faces
                if edge[0] in face.feet and not np.array_equal(face.feet, feet)
            )  # fmt: skip
            nodes = tc.plant.set_down(model, onto)
        both.command(0.1 * k, nodes, np.full(nodes.shape, 0.0 if k % 50 else 10.0))
        phases.add((gait._phase, gait._enough))
    both.check()
    assert len(phases) >= 4
    assert len(gait.made) >= 1
    assert gait._vain


PLAY = """
#include <stdio.h>
#include "controller.h"

int main(void)
{
    double y[FILTER_NUMBERS], command[CONTROLLER_COMMANDS], time = 0.0;
    int i;
    for (;; time += CONTROLLER_STEP) {
        for (i = 0; i < FILTER_NUMBERS; i++)
            if (scanf("%lf", &y[i]) != 1)
                return 0;
        controller_sample(time, y, command);
        controller_command(time, y, y, command); /* there are as many readings as coordinates */
        for (i = 0; i < CONTROLLER_COMMANDS; i++)
            printf("%.17g ", command[i]);
        printf("\\n");
    }
}
"""


def robot_of(structure, feet):
    """A structure on the ground, its gait, and what a filter of IMUs and encoders is made of."""
    strings = tc.LinearStrings(1000.0, damping=5.0)
    ground = tc.Ground(5e3, damping=0.5, friction=0.6, slip_speed=0.05)
    model = tc.Model(structure, strings, gravity=9.81, ground=ground)
    rest = tc.to_rest_length(
        model, structure.nodes, tc.prestress(structure, min_force_density=60.0).force_density
    ).rest_length
    winches = tc.Winches(rate=0.5, shortest=0.1, ramp=True)
    ahead = np.eye(structure.dimension)[0]
    gait = tc.shape.RollingGait(model, rest, ahead, 0.05, winches=winches, tabulated=True)
    free = tc.Model(structure, strings)
    plant = tc.linearize(free, tc.equilibrium(free, rest_length=rest), input="rest_length")
    motor = tc.Motor(drum_radius=0.02, gear_ratio=20.0, zero=rest)

    def filter_of(gravity=9.81, **more):
        sensors = tc.Sensors(
            structure=structure, bar_direction=0.02, bar_rate=0.05, encoder=0.2, motor=motor,
            gravity=gravity,
        )  # fmt: skip
        return tc.KalmanFilter(
            plant, sensors, sample_time=0.05, process_noise=0.1, winches=winches,
            rest_length_error=(2e-3, 5e-4), **more,
        )  # fmt: skip

    start = tc.plant.set_down(model, feet)
    estimator = filter_of(rolling=True, start=start)
    robot = tc.Stepper(
        model, 0.05, step=1e-3, nodes=start, rest_length=rest, winches=winches,
        sensors=estimator.sensors,
    )  # fmt: skip
    return gait, robot, estimator, filter_of


@pytest.mark.parametrize(("name", "samples"), [("in the plane", 90), ("in space", 80)])
def test_by_readings_alone_in_one_call(name, samples, tmp_path):
    """IMUs and encoders in, rest lengths out: filter and gait in C beside Python."""
    is_flat = name == "in the plane"
    structure = tc.library.snelson_x() if is_flat else tc.prism(bar_mass=0.5)
    gait, robot, estimator, filter_of = robot_of(structure, [0, 1] if is_flat else [3, 4, 5])
    worst, statuses, errors = rolling_code.compare(gait, estimator, robot, samples, tmp_path)
    assert worst.max() < 1e-12
    assert {Status.OK, Status.PARTLY_USED, Status.LOST, Status.RESTARTED} <= statuses
    assert len(gait.made) >= 1
    assert np.median(errors) < 0.06
    if not is_flat:
        return
    with pytest.raises(ValueError, match=r"must know which way is down: .*rolling=True"):
        tc.generate_c(gait, tmp_path, estimator=filter_of(), overwrite=True)
    aside = filter_of(gravity=[9.81, 0.0], rolling=True)
    with pytest.raises(ValueError, match="give both the same gravity"):
        tc.generate_c(gait, tmp_path, estimator=aside, overwrite=True)
    if not sanitizers.can_sanitize():
        return
    (tmp_path / "main.c").write_text(PLAY)
    sources = [path.name for path in tmp_path.glob("*.c")]
    strict = [*sanitizers.CHECKED, "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    sanitizers.build(sources, tmp_path, strict)
    rng, count = np.random.default_rng(0), len(estimator.sensors.noise)
    assert count >= structure.nodes.size
    rows = robot.reset() + 0.01 * rng.normal(size=(120, count))
    for row in rows[40::3]:
        row[rng.integers(count, size=3)] = rng.choice(sanitizers.ABSURD, 3)
    rows[45::17] = rng.choice(sanitizers.ABSURD, size=rows[45::17].shape)
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    lines = sanitizers.run(["./program"], tmp_path, text).splitlines()
    assert len(lines) == len(rows)
    assert np.isfinite([[float(word) for word in line.split()] for line in lines]).all()
