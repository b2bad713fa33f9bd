"""Closed loops with plants that vary, of bars that share nodes, in the plane and with clusters."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.robustness import SweepError
from tests import coupled
from tests.robustness.cases import loop_case

STRINGS = tc.LinearStrings(500.0, damping=2.0)


@cache
def arm_loop(**options):
    """An arm on a roller with a clustered string and payloads, held by an LQR in the plane."""
    structure = coupled.arm(cluster=True)
    model = tc.Model(structure, strings=STRINGS, gravity=9.81)
    rest = tc.shape_target(model, force_density=60.0).prestress
    plant = tc.linearize(model, rest, input="rest_length")
    Q, R = tc.energy_weights(plant)
    law = tc.LQR(plant, Q, R, sample_time=0.02)
    return loop_case(
        structure, STRINGS, law, duration=1.0, step=5e-3, tolerance=0.02, gravity=9.81,
        nodes=plant.nodes, **options,
    )  # fmt: skip


def outcome(case, **parameters):
    return case(parameters, np.random.default_rng(0))


def test_the_nominal_arm_stays_and_a_heavier_payload_sinks():
    nominal = outcome(arm_loop())
    assert nominal.success
    assert nominal.figures["final_error"] < 1e-9
    errors = [
        outcome(arm_loop(), point_mass=factor).figures["final_error"] for factor in (1.2, 2.0)
    ]
    assert 1e-6 < errors[0] < errors[1]


def test_factors_keep_supports_clusters_and_payloads():
    case = arm_loop()
    model = case._model({"bar_mass": [0.9, 1.1], "point_mass": [1.0, 1.5, 1.0, 1.0],
                         "stiffness": [0.8, 1.2]})  # fmt: skip
    structure = model.structure
    np.testing.assert_allclose(structure.bar_mass, [0.9, 1.1])
    np.testing.assert_allclose(structure.point_mass, [0.0, 3.0, 0.5, 0.0])
    assert structure.paths == case.structure.paths
    assert structure.rollers == case.structure.rollers
    np.testing.assert_allclose(model.strings.stiffness, [400.0, 600.0])


def test_a_sweep_of_an_arm():
    case = arm_loop()
    case = replace(case, scene=replace(case.scene, duration=0.3))
    found = tc.sweep(case, {"bar_mass": tc.Uniform(0.9, 1.1, size=2)}, 2, seed=0, processes=1)
    assert found.completed.all()
    assert len(np.unique(found.figure("final_error"))) == 2


def test_a_string_that_breaks():
    case = arm_loop(faults=(tc.CutString(0, 0.2),))
    assert not outcome(case).success


def test_no_point_mass_to_vary():
    d_bar = coupled.d_bar()
    model = tc.Model(d_bar, strings=STRINGS)
    plant = tc.linearize(model, tc.prestress(d_bar, force_density=10.0), input="rest_length")
    law = tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.02)
    case = loop_case(d_bar, STRINGS, law, duration=0.1, step=5e-3, tolerance=0.02)
    with pytest.raises(SweepError, match="no node has one"):
        outcome(case, point_mass=1.1)
