"""Controllers of structures on the ground as C code do what they do in Python."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import compiler
from tests import coupled
from tests.control.mpc import contact_scenes as contact
from tests.deploy import scenes

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


def test_an_x_falls_lands_and_jumps_by_code(tmp_path):
    """The prediction in C has the smooth law in it; the ground of the run is sharp."""
    plant = contact.STRUCTURES["x"](height=0.05)
    sharp = contact.models(plant.model.structure)[0]
    one = contact.hop(plant, 0.15, 6)
    pair = scenes.Pair(one, tc.generate_c(one, tmp_path).compile(), spoilt=(20,), absurd=(25,))
    run = tc.simulate(
        sharp, 1.2, plant.nodes, rest_length=plant.rest_length, controller=pair, error="none"
    )
    low = run.nodes[1].min(axis=0)
    assert low.min() < -1e-3 < 0.05 < low[run.time > 0.6].max()  # it touched, and left again
    assert pair.statuses[0] == pair.statuses[1]
    assert pair.statuses[1].count("ok") == len(pair.answers) - 2
    assert pair.error < 1e-10


def test_filters_are_not_written(tmp_path):
    plant = contact.STRUCTURES["x"](height=0.05)
    sensors = tc.Sensors(structure=plant.model.structure, node_position=1e-3)
    estimator = tc.KalmanFilter(plant, sensors, sample_time=0.02, prediction="nonlinear")
    with pytest.raises(TypeError, match="controller is a KalmanFilter, expected an LQR"):
        tc.generate_c(estimator, tmp_path)


def standing(structure, force, feet):
    """A plant on feet that stick, as supports: the stance of a structure on the ground."""
    held = tc.Structure(
        structure.nodes, structure.bars, structure.strings, structure.bar_mass, fixed=feet,
        string_groups=structure.string_groups,
    )  # fmt: skip
    model = tc.Model(held, contact.STRINGS)
    rest = tc.prestress(held, force_density=force)
    return tc.linearize(model, rest, input="rest_length")


@pytest.mark.parametrize(
    ("structure", "force", "feet"),
    [
        (tc.library.snelson_x(), 40.0, [0, 1]),
        (tc.library.six_bar_ball(bar_length=1.0), 60.0, [0, 4, 8]),
        (coupled.tower(), coupled.tower_force_density(), [0, 1, 2]),
    ],
)
def test_a_regulator_of_a_stance_by_code(structure, force, feet, tmp_path):
    plant = standing(structure, force, feet)
    one = tc.LQR(plant, sample_time=scenes.SAMPLE)
    pair = scenes.Pair(one, tc.generate_c(one, tmp_path).compile(), (), ())
    rng, r = np.random.default_rng(0), plant.degrees_of_freedom
    for k in range(20):
        q, rates = 1e-3 * rng.normal(size=r), 1e-2 * rng.normal(size=r)
        pair.command(scenes.SAMPLE * k, plant.to_nodes(q), plant.to_velocities(q, rates))
    assert pair.statuses[0] == pair.statuses[1]
    assert pair.error < 1e-12
