"""Fits of models to logs: what was put in comes out, and what cannot be told is said."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

import tenscontrol as tc
from tenscontrol.optimize.fit import identifiability_of
from tests.benchmarks.identification import lead_of, prism_case, random_case

PRISM = tc.prism()
REST = 0.95 * PRISM.string_length()
TIMES = np.arange(1, 41) * 0.02


def model_of(stiffness=100.0, damping=0.8, **options):
    return tc.Model(PRISM, strings=tc.LinearStrings(stiffness, damping), gravity=0.5, **options)


def log_of(model, sensors=None, seed=0, **start):
    if sensors is None:
        sensors = tc.Sensors(structure=PRISM, node_position=1e-3)
    run = tc.simulate(
        model, 0.8, rest_length=REST, tolerance=1e-9, error="none", output_step=0.02, **start
    )
    return tc.Log.of_run(run, sensors, TIMES, seed)


def test_a_prism_of_29_unknowns_is_found_in_few_rollouts():
    case = prism_case(1)
    found = case.fit()
    assert found.converged
    assert found.rollouts <= 20
    assert found.chi_squared == pytest.approx(1.0, abs=0.1)
    low, high = found.interval.T
    assert found.identifiability.is_told.all()
    assert ((low <= case.true) & (case.true <= high)).sum() >= 25
    assert abs(found.residuals[0].whiteness) < 0.1
    # The run of the fitted model is that of the true one, on inputs that were not in the log.
    assert found.validate(prism_case(1).log).root_mean_square < 1.1


@pytest.mark.parametrize("most", [1, 3])
def test_the_limit_of_rollouts_holds(most):
    log = log_of(model_of())
    found = tc.fit(model_of(130.0), log, ["stiffness"], step=5e-3, most_rollouts=most)
    assert found.rollouts == most
    assert found.message == f"stopped after {most} rollouts"
    assert len(found.residuals[0].residuals) == len(TIMES)


def test_a_fast_vibration_is_not_taken_for_another_number_of_periods():
    """60 periods of a mass on one string: a tenth of them has many minima already."""
    hung = tc.Structure([[0, 0], [0, -1]], [], [(0, 1)], [], point_mass=[0, 1], fixed=[0])

    def model(stiffness):
        return tc.Model(hung, strings=tc.LinearStrings(stiffness), gravity=9.81)

    duration = 60 * 2 * np.pi / np.sqrt(165.0)
    run = tc.simulate(
        model(165.0), duration, rest_length=[0.9], error="none", output_step=duration / 480
    )
    log = tc.Log.of_run(run, tc.Sensors(structure=hung, node_position=1e-3), run.time[1:], seed=0)
    found = tc.fit(model(100.0), log, ["stiffness"])
    assert found.parameters["stiffness"][0] == pytest.approx(165.0, rel=1e-3)
    assert found.rollouts <= 15


def test_a_narrow_and_bent_valley_is_followed_to_its_end():
    """Rest lengths and rigidities that make the same tension: straight steps leave the valley."""
    case = random_case(11)
    found = case.fit()
    assert found.converged
    assert found.rollouts <= 75
    # By how much the truth costs more is a sum of as many squares as there are unknowns.
    assert chi2.sf(lead_of(case, found), len(case.true)) > 1e-3
    assert lead_of(case, found) > 0


def test_what_data_cannot_tell_is_named_and_gets_no_interval():
    log = log_of(model_of())
    names = ["stiffness", "damping", "bar_mass"]
    told = tc.identifiable(model_of(), log, names)
    assert told.singular[-1] < 1e-6 < 1 < told.singular[0]
    together = told.directions[-1]
    np.testing.assert_allclose(together, together[0], atol=1e-6)
    assert "all of stiffness, " in told.table().splitlines()[-1]
    found = tc.fit(model_of(115.0), log, names)
    assert np.isnan(found.interval).all()
    assert "not told by the data" in found.table()
    # A tension tells it.
    sensors = tc.Sensors(structure=PRISM, node_position=1e-3, string_tension=0.1)
    tense = log_of(model_of(), sensors)
    assert tc.identifiable(model_of(), tense, names).singular[-1] > 1


def test_groups_share_an_unknown_and_what_is_known_is_held():
    true = model_of(np.repeat([80.0, 100.0, 140.0], 3))
    found = tc.fit(
        model_of(), log_of(true), {"stiffness": 1.0, "damping": tc.optimize.LogNormal(0.5, 1.0)},
        groups={"stiffness": [[0, 1, 2], [6, 7, 8]], "damping": "all"},
        known={"stiffness": [3, 4, 5]},
    )  # fmt: skip
    assert found.labels == ("stiffness 0-2", "stiffness 6-8", "damping 0-8")
    np.testing.assert_array_equal(found.parameters["stiffness"][3:6], 100.0)
    np.testing.assert_allclose(found.parameters["stiffness"], true.strings.stiffness, rtol=0.01)
    np.testing.assert_allclose(found.parameters["damping"], 0.8, rtol=0.05)
    np.testing.assert_array_equal(found.model.strings.stiffness, found.parameters["stiffness"])


def test_lost_and_wild_readings_are_skipped_and_bounded():
    clean = log_of(model_of(120.0))
    readings = np.array(clean.readings)
    readings[5:8] = np.nan
    readings[20, 3] += 0.5
    readings[33, 11:14] -= 0.8
    log = replace(clean, readings=readings)
    assert log.lost == 3 * 18
    wild = tc.fit(model_of(), log, ["stiffness"], groups={"stiffness": "all"})
    bounded = tc.fit(model_of(), log, ["stiffness"], groups={"stiffness": "all"}, loss="huber")
    assert not wild.explained
    assert np.isnan(wild.interval).all()
    assert bounded.explained
    assert bounded.parameters["stiffness"][0] == pytest.approx(120.0, abs=2.0)
    # Few that are far off widen an interval by little, and are no reason to begin again.
    fair = tc.fit(model_of(), clean, ["stiffness"], groups={"stiffness": "all"})
    assert bounded.chi_squared == pytest.approx(1.0, abs=0.2)
    assert 0.9 < np.ptp(bounded.interval) / np.ptp(fair.interval) < 1.2
    assert bounded.rollouts <= fair.rollouts + 2


def test_a_start_that_is_not_known_is_found_with_the_rest():
    turned = np.array([[0.9998, -0.02, 0.0], [0.02, 0.9998, 0.0], [0.0, 0.0, 1.0]])
    nodes = turned @ PRISM.nodes + [[0.01], [-0.02], [0.015]]
    push = np.full((3, 6), 0.03)
    log = log_of(model_of(115.0), nodes=nodes, velocities=push)
    vague = replace(log, nodes=None, velocities=None)
    found = tc.fit(model_of(), vague, ["stiffness"], groups={"stiffness": "all"}, start=(0.02, 0.1))
    assert found.parameters["stiffness"][0] == pytest.approx(115.0, rel=0.01)
    assert found.chi_squared == pytest.approx(1.0, abs=0.15)
    fixed = tc.fit(model_of(), vague, ["stiffness"], groups={"stiffness": "all"})
    assert fixed.chi_squared > 10


def test_a_delay_of_the_readings_is_found():
    log = log_of(model_of())
    late = replace(log, time=log.time + 0.013)
    found = tc.fit(model_of(), late, ["delay", "damping"], groups={"damping": "all"})
    assert found.parameters["delay"][0] == pytest.approx(0.013, abs=5e-4)


def test_friction_and_payload_of_a_sliding_prism_are_found():
    ground = tc.Ground(2e3, damping=0.3, friction=0.4, height=PRISM.nodes[2].min() - 0.01)

    def sliding(friction, payload):
        structure = replace(PRISM, point_mass=[0, 0, 0, payload, 0, 0])
        return tc.Model(
            structure, strings=tc.LinearStrings(200.0, 1.0), gravity=9.81,
            ground=replace(ground, friction=friction),
        )  # fmt: skip

    push = np.zeros((3, 6))
    push[0] = 0.8
    log = log_of(sliding(0.55, 0.4), velocities=push)
    found = tc.fit(sliding(0.4, 0.3), log, ["ground.friction", "point_mass"])
    assert found.labels == ("ground.friction", "point_mass 3")
    assert found.parameters["ground.friction"][0] == pytest.approx(0.55, rel=0.01)
    assert found.parameters["point_mass"][3] == pytest.approx(0.4, rel=0.02)


def test_several_logs_share_the_parameters():
    true = model_of(90.0)
    logs = [log_of(true, seed=1), log_of(true, seed=2)]
    both = tc.fit(model_of(), logs, ["stiffness"], groups={"stiffness": "all"})
    one = tc.fit(model_of(), logs[0], ["stiffness"], groups={"stiffness": "all"})
    assert both.parameters["stiffness"][0] == pytest.approx(90.0, rel=0.01)
    assert np.ptp(both.interval) < 0.85 * np.ptp(one.interval)


def test_a_log_goes_through_a_table_and_a_fit_through_json(tmp_path):
    log = log_of(model_of())
    readings = np.array(log.readings)
    readings[2, 4] = np.nan
    log = replace(log, readings=readings)
    read = tc.Log.read(log.save(tmp_path / "log.csv"), log.sensors, rest_length=REST)
    np.testing.assert_array_equal(read.readings, log.readings)
    np.testing.assert_array_equal(read.time, log.time)
    found = tc.fit(model_of(), read, ["stiffness"], groups={"stiffness": "all"})
    saved = json.loads(found.save(tmp_path / "fit.json").read_text())
    assert saved["parameters"]["stiffness"] == found.parameters["stiffness"].tolist()
    text = (tmp_path / "log.csv").read_text().replace("node_position 0 y", "node_position 0 w")
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(ValueError, match="no column 'node_position 0 y'"):
        tc.Log.read(tmp_path / "log.csv", log.sensors, rest_length=REST)
    (tmp_path / "log.csv").write_text(text.replace("node_position 0 w", "node_position 0 y") + "x")
    with pytest.raises(ValueError, match="line 42: 'x' is no number"):
        tc.Log.read(tmp_path / "log.csv", log.sensors, rest_length=REST)


def test_what_does_not_fit_is_refused():
    log = log_of(model_of())
    with pytest.raises(ValueError, match=r"time\[3\] is .* expected ascending"):
        replace(log, time=np.where(np.arange(40) == 3, 0.0, log.time))
    with pytest.raises(ValueError, match=r"readings\[0, 0\] is inf, expected at most 1e\+100"):
        replace(log, readings=np.full(log.readings.shape, np.inf))
    with pytest.raises(ValueError, match=r"rest_length has shape \(4,\)"):
        replace(log, rest_length=REST[:4])
    with pytest.raises(ValueError, match=r"rest_length\[0\] is nan"):
        replace(log, rest_length=np.nan * REST)
    with pytest.raises(ValueError, match="nothing was read"):
        replace(log, readings=np.full(log.readings.shape, np.nan))
    with pytest.raises(ValueError, match="parameters is 'stifness'"):
        tc.fit(model_of(), log, ["stifness"])
    with pytest.raises(ValueError, match="point_mass has no unknown"):
        tc.fit(model_of(), log, ["point_mass"])
    with pytest.raises(ValueError, match=r"groups\['stiffness'\]\[1\] has members"):
        tc.fit(model_of(), log, ["stiffness"], groups={"stiffness": [[0, 1], [1, 2]]})
    ball = tc.library.six_bar_ball()
    with pytest.raises(ValueError, match="log has sensors of"):
        tc.fit(tc.Model(ball, strings=tc.LinearStrings(100.0)), log, ["stiffness"])
    sensors = tc.Sensors(structure=PRISM, node_position=1e-3, accelerometer=0.1)
    shape = 40, len(sensors.noise)
    with pytest.raises(ValueError, match="accelerometers, whose readings are not fitted"):
        tc.fit(model_of(), replace(log, sensors=sensors, readings=np.ones(shape)), ["stiffness"])


def test_windows_of_a_log_are_logs_with_their_own_start():
    model = model_of()
    wound = tc.Profile([0.0, 0.15, 0.3, 0.5], np.outer(REST, [1.0, 0.95, 1.02, 0.97]))
    run = tc.simulate(model, 0.5, rest_length=wound, step=2e-3, error="none")
    sensors = tc.Sensors(structure=PRISM, node_position=1e-3)
    log = tc.Log.of_run(run, sensors, np.arange(1, 26) * 0.02)
    gusts = tc.Profile([0.0, 0.5], np.stack([np.zeros((3, 6)), np.ones((3, 6))], axis=2))
    last = replace(log, external_force=gusts).windows(0.2, run)[-1]
    np.testing.assert_allclose(last.external_force.at(0.07), gusts.at(0.47))
    windows = log.windows(0.2, run)
    assert [len(window.time) for window in windows] == [10, 10, 5]
    for i, window in enumerate(windows):
        rows = slice(10 * i, 10 * i + len(window.time))
        np.testing.assert_allclose(window.time, log.time[rows] - 0.2 * i, atol=1e-12)
        np.testing.assert_array_equal(window.readings, log.readings[rows])
        np.testing.assert_array_equal(window.velocities, run.velocities[:, :, 100 * i])
        np.testing.assert_allclose(window.rest_length.at(0.07), wound.at(0.2 * i + 0.07))
    # Each goes on as the whole did.
    found = tc.fit(model_of(115.0), windows, ["stiffness"], groups={"stiffness": "all"}, step=2e-3)
    assert found.parameters["stiffness"][0] == pytest.approx(100.0, rel=1e-3)
    assert max(found.validate(window).root_mean_square for window in windows) < 0.05
    lost = replace(log, readings=np.where(log.time[:, None] < 0.21, np.nan, log.readings))
    assert len(lost.windows(0.2, run)) == 2
    with pytest.raises(ValueError, match=r"run is of .* up to 0\.1 s, expected"):
        log.windows(0.2, tc.simulate(model, 0.1, rest_length=wound, step=2e-3, error="none"))


def test_what_leaves_half_of_the_variance_is_not_told_nor_what_no_reading_shows():
    """Singular values 10, 1.2, 0.8, and a sum of the last two unknowns that nothing tells."""
    slope = np.zeros((5, 5))
    slope[[0, 1, 2], [0, 1, 2]] = 10.0, 1.2, 0.8
    slope[3, 3:] = 10.0, -10.0
    rollouts = SimpleNamespace(deviations=np.ones(5), labels=list("abcde"), size=5)
    said = identifiability_of(rollouts, slope)
    assert said.is_told.tolist() == [True, True, False, False, False]
    np.testing.assert_allclose(np.abs(said.untold), [[0, 0, 0, 0.5**0.5, 0.5**0.5]], atol=1e-12)


def test_logs_in_other_units_and_times_beyond_the_run_are_said():
    log = log_of(model_of())
    far = replace(log, readings=1000.0 * log.readings)
    found = tc.fit(model_of(), far, ["stiffness"], groups={"stiffness": "all"}, step=0.01)
    assert "times the noise, so no interval holds: the model lacks something" in found.table()
    with pytest.raises(ValueError, match=r"external_force has shape \(2, 6\)"):
        replace(log, external_force=np.ones((2, 6)))
    run = tc.simulate(model_of(), 0.1, rest_length=REST, output_step=0.02, error="none")
    with pytest.raises(ValueError, match=r"times\[1\] is 0\.2 s, expected times of the run"):
        tc.Log.of_run(run, log.sensors, [0.1, 0.2])
    with pytest.raises(ValueError, match=r"times has shape \(3, 0\)"):
        tc.Log.of_run(run, log.sensors, np.ones((3, 0)))


def test_a_part_that_noise_does_not_explain_is_fitted_again_after_a_shorter_one():
    """From half of this log to all of it, the fit falls into a wrong minimum."""
    case = random_case(209)
    found = case.fit()
    assert found.converged
    assert found.explained
    assert lead_of(case, found) > 0


def test_a_fit_that_does_not_hold_gives_no_interval(tmp_path):
    log = log_of(model_of())
    stopped = tc.fit(model_of(200.0), log, ["stiffness"], step=5e-3, most_rollouts=3)
    assert not stopped.converged
    assert np.isnan(stopped.interval).all()
    assert "raise most_rollouts" in stopped.table()
    saved = json.loads(stopped.save(tmp_path / "fit.json").read_text())
    assert {unknown["interval"] for unknown in saved["unknowns"]} == {None}
    # Noise that is a little larger than it is said to be.
    sensors = tc.Sensors(structure=PRISM, node_position=0.8e-3)
    noisy = tc.fit(model_of(), replace(log, sensors=sensors), ["stiffness"])
    assert noisy.chi_squared == pytest.approx(1 / 0.64, rel=0.1)
    assert noisy.explained
    assert noisy.p_value < 1e-9
    assert not np.isnan(noisy.interval).any()
    assert "noise alone leaves squares as large with probability" in noisy.table()
    assert 0.01 < tc.fit(model_of(), log, ["stiffness"]).p_value < 0.99


def test_a_log_whose_first_rows_were_lost_is_fitted():
    log = log_of(model_of(115.0))
    late = replace(log, readings=np.where(log.time[:, None] < 0.5, np.nan, log.readings))
    found = tc.fit(model_of(), late, ["stiffness"], groups={"stiffness": "all"})
    assert found.parameters["stiffness"][0] == pytest.approx(115.0, rel=0.05)
    at_once = replace(log, time=log.time - log.time[0])
    found = tc.fit(model_of(), at_once, ["stiffness"], groups={"stiffness": "all"}, step=5e-3)
    assert found.rollouts > 3
    with pytest.raises(ValueError, match="log has readings at 0 s alone"):
        tc.fit(model_of(), replace(log, time=[0.0], readings=log.readings[:1]), ["stiffness"])
    with pytest.raises(ValueError, match=r"time is 0\.3 s, but the first reading is at 0\.5 s"):
        late.until(0.3)
