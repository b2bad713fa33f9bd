"""The rolling gait as C code: equal to Python's in a run, in space and in the plane."""

import pickle

import numpy as np
import pytest

import tenscontrol as tc
from tests.deploy import scenes

SPOILT, ABSURD = (40, 41, 90), (60, 130)


class Both:
    """Obeys the gait in Python, and asks the code for the same command."""

    input, sample_time = "rest_length", 0.05

    def __init__(self, gait, code):
        self.gait = gait
        self.python = tc.FunctionController(gait.settings.structure, gait)
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
        model, 12.0, nodes, controller=both, winches=winches, rest_length=0.55, method="rk4",
        step=1e-3, project=True, error="none", output_step=0.05,
    )  # fmt: skip
    both.check()
    assert len(gait.made) >= 3
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
