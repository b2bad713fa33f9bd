"""Faults in the time histories of a run."""

import numpy as np
import pytest

import tenscontrol as tc


@pytest.fixture(scope="module")
def broken_run():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205), "rest_length")
    regulator = tc.lqr(plant, *tc.energy_weights(plant), sample_time=0.02)
    faults = [tc.StuckWinch(4, 0.02, 0.06), tc.CutString(6, 0.07), tc.LostMeasurement(0.04, 9.0)]
    late = tc.CutString(1, 5.0)  # the run is over by then
    return tc.simulate(model, 0.1, controller=regulator, step=2e-3, faults=[*faults, late])


def test_faults_are_marked_with_what_they_act_on(broken_run):
    panels = tc.plot.trajectory(broken_run)
    names = ["winch 4 stuck at 0.02 s", "string 6 cut at 0.07 s", "measurement lost at 0.04 s"]
    assert list(panels["coordinates"].marks) == []
    assert list(panels["force_density"].marks) == names
    assert list(panels["rest_length"].marks)[:3] == names
    assert any(name.startswith("measurement not finite") for name in panels["rest_length"].marks)
    stuck, cut, lost = (panels["force_density"].marks[name].get_xdata() for name in names)
    np.testing.assert_allclose(stuck, [0.02, 0.02, 0.06, 0.06])
    np.testing.assert_allclose(cut, [0.07, 0.07])
    np.testing.assert_allclose(lost, [0.04, 0.04, 0.1, 0.1])
    shown = {text.get_text() for text in panels["force_density"].ax.get_legend().get_texts()}
    assert set(names) <= shown


def test_a_cut_string_has_no_rest_length(broken_run):
    """The million sizes that keep it slack are not drawn."""
    lines = tc.plot.trajectory(broken_run)["rest_length"].lines["vertical"]
    rows = np.array([line.get_ydata() for line in lines])
    late = broken_run.time > 0.07
    assert np.isnan(rows[0, late]).all()
    np.testing.assert_array_equal(rows[0, ~late], broken_run.rest_length[6, ~late])
    assert np.isfinite(rows[1:]).all()
    assert broken_run.rest_length[6, -1] > 1e5


def test_a_run_without_faults_has_no_marks():
    prism = tc.prism()
    run = tc.simulate(tc.Model(prism), 0.1, force_density=17.0)
    assert tc.plot.trajectory(run)["force_density"].marks == {}


def test_the_energy_that_was_lost_is_drawn():
    prism = tc.prism()
    cut = tc.CutString(0, 0.05)
    run = tc.simulate(tc.Model(prism), 0.1, force_density=17.0, faults=[cut])
    (line,) = tc.plot.health(run)["energy"].lines["lost with cut strings"]
    np.testing.assert_array_equal(line.get_ydata(), run.released_energy)
    assert line.get_ydata()[-1] > 1.0
