"""Batches whose bars are driven: the numbers of single runs, by a profile and under controllers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc


@pytest.fixture(scope="module")
def model():
    return tc.Model(replace(tc.prism(), fixed=[3, 4, 5]), tc.LinearStrings(300.0, damping=2.0))


def test_runs_of_a_profile_are_single_runs(model):
    structure = model.structure
    rest = 0.95 * structure.string_length()
    grown = tc.Profile([0.02, 0.08], np.outer(structure.bar_length, [1.0, 1.03]))
    how = tc.Integration(tolerance=1e-8, output_step=0.02)
    scene = tc.Scene(model, 0.1, rest_length=rest, bar_length=grown, integration=how)
    batch = tc.simulate_many(scene, {"rest_length": np.array([[1.0], [0.97]]) * rest})
    for run, share in enumerate((1.0, 0.97)):
        single = tc.simulate(
            model, 0.1, rest_length=share * rest, bar_length=grown, tolerance=1e-8, output_step=0.02
        )
        np.testing.assert_array_equal(batch.nodes[run], single.nodes)
        np.testing.assert_array_equal(batch.error[run], single.error)
        np.testing.assert_array_equal(batch.trajectory(run).struts.work, single.struts.work)
    assert batch.completed.all()
    assert batch.choice.method == single.choice.method
    # Two lengths of one bar, of which the start has the first; the other run cannot begin.
    lengths = structure.bar_length * np.array([[1.0], [1.2]])
    held = tc.simulate_many(scene, {"bar_length": lengths}, keep_nodes=[0], error="none")
    assert held.completed.tolist() == [True, False]
    assert "bar 0 is" in held.messages[1]
    assert held.nodes.shape == (2, 3, 1, len(held.time))
    assert np.isnan(held.nodes[1]).all()


def test_loops_of_struts_are_single_loops(model):
    drives = tc.Winches(ramp=True, rate=1.0, shortest=1.2, longest=1.6)
    plant = tc.linearize(model, tc.prestress(model.structure, min_force_density=20.0), "bar_length")
    law = tc.LQR(plant, sample_time=0.02, winches=drives)
    starts = np.array([plant.to_nodes(q * np.ones(6)) for q in (0.002, 0.01)])
    scene = tc.Scene(model, 0.06, controller=law, winches=drives)
    batch = tc.simulate_many(scene, {"nodes": starts}, error="none")
    for run, start in enumerate(starts):
        single = tc.simulate(model, 0.06, start, controller=law, winches=drives, error="none")
        np.testing.assert_array_equal(batch.nodes[run], single.nodes[..., [0, -1]])
        np.testing.assert_array_equal(batch.command[run], single.control.command)
    assert batch.commands_not_ok.tolist() == [0, 0]
    assert batch.error is None
    with pytest.raises(ValueError, match="the scene has a start: simulate goes on"):
        tc.simulate_many(tc.Scene(model, 0.1, controller=law, winches=drives, start=single),
                         {"external_force": np.zeros((1, 3, 6))})  # fmt: skip
