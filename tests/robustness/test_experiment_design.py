"""Grids and random draws of what varies, in batches on the ground."""

from itertools import product

import numpy as np
import pytest

import tenscontrol as tc
from tests.robustness.cases import Inline, noisy


def test_a_grid_has_every_combination_once():
    values = {"a": [1.0, 2.0], "b": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], "c": [7.0]}
    rows = tc.grid(values)
    assert [rows[name].shape for name in values] == [(6,), (6, 2), (6,)]
    runs = list(zip(rows["a"], map(tuple, rows["b"]), rows["c"], strict=True))
    assert runs == list(product(values["a"], map(tuple, values["b"]), values["c"]))


def test_draws_are_those_of_a_sweep():
    drawn = {"mass": tc.Uniform(0.8, 1.2, size=3), "delay": tc.Normal(0.0, 0.1)}
    report = tc.sweep(noisy, drawn, 5, seed=3, executor=Inline())
    rows = tc.draws(drawn, 5, seed=3)
    for name in drawn:
        np.testing.assert_array_equal(rows[name], report.parameters[name])


def test_a_sweep_takes_the_values_of_a_grid(tmp_path):
    rows = tc.grid({"mass": [0.8, 1.2], "pair": [[1.0, 2.0], [3.0, 4.0]]})
    given = rows | {"delay": tc.Normal(0.0, 0.1)}
    file = tmp_path / "sweep.jsonl"
    how = {"seed": 3, "executor": Inline(), "file": file}
    first = tc.sweep(noisy, given, 2, **how)
    report = tc.sweep(noisy, given, **how)
    assert (len(first), len(report)) == (2, 4)
    for name, values in rows.items():
        np.testing.assert_array_equal(report.parameters[name], values)
    drawn = tc.draws({"delay": given["delay"]}, 4, seed=3)["delay"]
    np.testing.assert_array_equal(report.parameters["delay"], drawn)
    assert tc.robustness.SweepReport.load(file) == report
    with pytest.raises(ValueError, match="belongs to another sweep: parameter 'mass'"):
        tc.sweep(noisy, given | {"mass": rows["mass"][::-1]}, **how)
    with pytest.raises(ValueError, match="count is 5, expected a whole number of at most 4"):
        tc.sweep(noisy, given, 5, **how)
    with pytest.raises(ValueError, match=r"'pair'\] has 3 runs, but those before it have 4"):
        tc.sweep(noisy, rows | {"pair": rows["pair"][:3]}, **how)
    with pytest.raises(TypeError, match="count is None"):
        tc.sweep(noisy, {"mass": given["delay"]}, **how)


def test_a_grid_of_grounds_has_the_runs_of_simulate():
    prism = tc.prism()
    ground = tc.Ground(stiffness=2e3, damping=0.3, friction=0.5, slip_speed=0.05)
    model = tc.Model(
        prism, strings=tc.LinearStrings(100.0, damping=0.5), gravity=9.81, ground=ground
    )
    scene = tc.Scene(
        model, 0.2, velocities=np.tile([[0.5], [0.0], [-0.5]], 6), nodes=prism.nodes,
        rest_length=0.9 * prism.string_length(),
        integration=tc.Integration(method="rk4", step=2e-3),
    )  # fmt: skip
    vary = tc.grid({"ground.friction": [0.1, 0.8], "ground.stiffness": [1e3, 3e3],
                    "ground.damping": [0.1, 0.5]})  # fmt: skip
    batch = tc.simulate_many(scene, vary)
    assert batch.completed.all()
    ends = batch.nodes[..., -1]
    assert np.ptp(ends, axis=0).max() > 1e-3
    for run in (0, 5):
        own = {name.removeprefix("ground."): values[run] for name, values in vary.items()}
        law = tc.Ground(slip_speed=0.05, **own)
        alone = tc.simulate(
            model.replace(ground=law), 0.2, prism.nodes, velocities=scene.velocities,
            rest_length=scene.rest_length, method="rk4", step=2e-3,
        )  # fmt: skip
        np.testing.assert_array_equal(alone.nodes[..., -1], ends[run])


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({}, "values is a dict, expected a dict of arrays, by name, at least one"),
        ({"a": 1.0}, r"values\['a'\] has shape \(\), expected \(k,\)"),
        ({"a": []}, r"values\['a'\] has shape \(0,\)"),
        ({"a": [np.nan]}, "expected finite numbers|expected a finite number"),
        ({"a": np.ones(4000), "b": np.ones(4000)}, "the number of runs is 16000000"),
    ],
)
def test_what_is_no_grid_is_refused(values, match):
    with pytest.raises((TypeError, ValueError), match=match):
        tc.grid(values)


def test_draws_need_distributions():
    with pytest.raises(TypeError, match=r"parameters\['a'\] is a float, expected Distribution"):
        tc.draws({"a": 1.0}, 3)
    with pytest.raises(ValueError, match="count is 0"):
        tc.draws({"a": tc.Uniform(0.0, 1.0)}, 0)
