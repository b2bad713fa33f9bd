"""Faults in runs of structures that fall on the ground."""

import numpy as np
import pytest

import tenscontrol as tc

PRECISE = {"method": "dop853", "tolerance": 1e-9}
FLOOR = {"damping": 0.3, "friction": 0.5, "height": -0.15}
STIFF, CUT, END = 100.0, 0.2137, 0.4


def landing(structure, **changes):
    strings = tc.LinearStrings(STIFF, damping=0.1)
    ground = tc.Ground(2e3, **(FLOOR | changes))
    return tc.Model(structure, strings=strings, gravity=9.81, ground=ground)


def wound(prism):
    rest = tc.prestress(prism, 17.3205)
    return tc.to_rest_length(landing(prism), prism.nodes, rest.force_density).rest_length


@pytest.mark.parametrize("string", [0, 6])
def test_a_string_cut_while_nodes_press_on_the_ground(prism, string):
    model, lengths = landing(prism), wound(prism)
    faults = [tc.CutString(string, CUT)]
    run = tc.simulate(model, END, rest_length=lengths, faults=faults, **PRECISE)
    before = tc.simulate(model, CUT, rest_length=lengths, **PRECISE)
    assert before.nodes[2, :, -1].min() < -0.16
    keep = np.arange(9) != string
    less = tc.Structure(prism.nodes, prism.bars, prism.strings[keep], prism.bar_mass)
    at = {"nodes": before.nodes[:, :, -1], "velocities": before.velocities[:, :, -1]}
    after = tc.simulate(landing(less), END - CUT, rest_length=lengths[keep], **at, **PRECISE)
    np.testing.assert_allclose(run.nodes[:, :, -1], after.nodes[:, :, -1], rtol=0, atol=1e-6)
    whole = tc.simulate(model, END, rest_length=lengths, **PRECISE)
    assert np.abs(run.nodes[:, :, -1] - whole.nodes[:, :, -1]).max() > 0.01


@pytest.mark.filterwarnings("ignore::tenscontrol.control.ControlWarning")
@pytest.mark.parametrize(
    "fault", [tc.StuckWinch(4, 0.06, 0.3), tc.LostMeasurement(0.1, 0.3)], ids=lambda f: f.label
)
def test_faults_of_a_loop_do_the_same_on_the_ground_as_in_the_air(prism, fault):
    rest = tc.prestress(prism, 17.3205)
    free = tc.Model(prism, strings=tc.LinearStrings(STIFF, damping=0.1))
    plant = tc.linearize(free, rest, input="rest_length")
    Q, R = tc.energy_weights(plant)
    lqr = tc.LQR(plant, Q, 0.1 * R, sample_time=0.02)

    def falls(model):
        return tc.simulate(model, END, controller=lqr, faults=[fault], step=1e-3)

    landed = falls(landing(prism))
    assert landed.nodes[2].min() < -0.16
    control = landed.control
    during = (control.time > fault.time - 1e-9) & (control.time < fault.until - 1e-9)
    if isinstance(fault, tc.StuckWinch):
        assert np.ptp(control.applied[4, during]) == 0
        assert np.ptp(np.delete(control.applied, 4, axis=0)[:, during], axis=1).min() > 0
    else:
        lost = np.array([status.startswith("measurement not") for status in control.status])
        np.testing.assert_array_equal(lost, during)
    # Ground that nothing reaches changes nothing.
    none = tc.Model(prism, strings=tc.LinearStrings(STIFF, damping=0.1), gravity=9.81)
    deep = falls(landing(prism, height=-9.0))
    np.testing.assert_allclose(deep.nodes, falls(none).nodes, rtol=0, atol=1e-12)
