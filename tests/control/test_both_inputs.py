"""Rest lengths of strings and lengths of bars as inputs at once: by an oracle, in closed loops."""

from __future__ import annotations

from dataclasses import replace

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.plant.linear_plant import sampled

STEP = 0.02
RAMP = tc.Winches(ramp=True, rate=1.0, shortest=0.1, longest=1.9)


def _plant(structure, **drives):
    model = tc.Model(structure, tc.LinearStrings(300.0, damping=2.0))
    rest = tc.prestress(structure, min_force_density=20.0)
    return tc.linearize(model, rest, "length", **drives)


@pytest.fixture(scope="module")
def plant():
    """A prism on three fixed nodes: two strings on one winch, two alone, and struts."""
    return _plant(
        replace(tc.prism(), fixed=[3, 4, 5]),
        actuated={"lid": {0: 1.0, 1: -1.0}, "v": [6], "w": [8]},
        struts={"a": [0], "pair": [1, 2]},
    )


@pytest.fixture(scope="module")
def responses(plant):
    """End of a sample by its start, and by inputs before and after it, of the simulator."""
    r, m = plant.degrees_of_freedom, plant.B.shape[1]
    strings = len(plant.model.structure.strings)

    def end(x):
        q, rates, before, after = np.split(x, [r, 2 * r, 2 * r + m])
        first, last = (
            plant.actuation.strings(plant.equilibrium_input + v) for v in (before, after)
        )
        lengths = np.stack([first, last], axis=1)
        bars = first[strings:], (last - first)[strings:] / STEP
        wound, grown = (
            tc.Profile([0.0, STEP], rows) for rows in (lengths[:strings], lengths[strings:])
        )
        run = tc.simulate(
            plant.model, STEP, plant.to_nodes(q, bars[0]), plant.to_velocities(q, rates, *bars),
            rest_length=wound, bar_length=grown, tolerance=1e-13, error="none", output_step=STEP,
        )  # fmt: skip
        return plant.measure(run.nodes[..., -1], run.velocities[..., -1])

    steps = (
        [(end(h * e) - end(-h * e)) / (2 * h) for e in np.eye(2 * (r + m))] for h in (1e-4, 2e-4)
    )
    fine, coarse = map(np.array, steps)
    return np.split(((4 * fine - coarse) / 3).T, [2 * r, 2 * r + m], axis=1)


def test_gains_are_those_of_python_control_on_columns_of_the_simulator(plant, responses):
    """Of the regulator with the inputs held as states, and of the filter by duality."""
    moved = sampled(plant, STEP, True)
    found = moved.transition, moved.by_previous, moved.by_input
    for own, true in zip(found, responses, strict=True):
        np.testing.assert_allclose(own, true, rtol=0, atol=1e-9 * np.abs(true).max())
    transition, by_previous, by_input = responses
    m, states = len(by_input.T), len(transition)
    A = np.block([[transition, by_previous], [np.zeros((m, states + m))]])
    Q, R = tc.plant.natural_weights(plant)
    weights = np.zeros_like(A)
    weights[:states, :states] = Q
    gain = control.dlqr(A, np.vstack([by_input, np.eye(m)]), weights, np.diag(R))[0]
    regulator = tc.LQR(plant, sample_time=STEP, winches=RAMP)
    own = np.hstack([regulator.gain, regulator.previous_input_gain])
    np.testing.assert_allclose(own, gain, rtol=0, atol=1e-9 * np.abs(gain).max())
    estimator = _filter(plant)
    C, noise = estimator.C, np.diag(estimator.sensors.noise**2)
    drive = estimator.design.process_covariance
    _, P, _ = control.dlqe(transition, np.eye(states), C, drive, noise)
    np.testing.assert_allclose(estimator.covariance, P, rtol=0, atol=1e-9 * np.abs(P).max())


def test_columns_are_those_of_each_input_alone(plant):
    model, rest = plant.model, tc.OperatingPoint(plant.nodes, plant.force_density)
    strings = tc.linearize(model, rest, "rest_length", actuated={"lid": {0: 1.0, 1: -1.0},
                                                                 "v": [6], "w": [8]})  # fmt: skip
    bars = tc.linearize(model, rest, "bar_length", actuated={"a": [0], "pair": [1, 2]})
    np.testing.assert_allclose(plant.B, np.hstack([strings.B, bars.B]), atol=1e-12)
    np.testing.assert_array_equal(plant.A, bars.A)
    none = np.zeros_like(strings.B)
    np.testing.assert_allclose(plant.rate_input, np.hstack([none, bars.rate_input]), atol=1e-12)
    assert plant.input_names == [*strings.input_names, *bars.input_names]
    other = tc.plant.in_coordinates(plant, "minimal")
    assert other.input_names == plant.input_names
    np.testing.assert_array_equal(other.string_values, plant.string_values)
    # Nine modes and no more are reached by both, and by any one of the two.
    assert not len(tc.LQR(plant, sample_time=STEP, winches=RAMP).left_alone.frequency)


def _filter(plant, **more):
    readings = {"node_position": 1e-4, "string_tension": 0.01, "gyroscope": 1e-3, **more}
    errors = (1e-3, 1e-4) if "encoder" in more else None
    sensors = tc.Sensors(structure=plant.model.structure, **readings)
    return tc.KalmanFilter(plant, sensors, sample_time=STEP, winches=RAMP, rest_length_error=errors)


def test_loop_by_a_filter_with_encoders_goes_on_after_a_winch_is_stuck(plant):
    """Also in two runs, the second from where the first has ended."""
    motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, zero=1.0)
    made = [
        (
            tc.LQR(plant, sample_time=STEP, winches=RAMP),
            _filter(plant, encoder=0.02, encoder_strings=[6], motor=motor),
        )
        for _ in range(2)
    ]
    start = plant.to_nodes(3e-3 * np.arange(1.0, 7.0))
    how = {"winches": RAMP, "tolerance": 1e-9, "faults": [tc.StuckWinch(6, 0.2)], "seed": 1}
    loops = [{"controller": law, "estimator": estimator, **how} for law, estimator in made]
    whole = tc.simulate(plant.model, 0.4, nodes=start, **loops[0])
    first = tc.simulate(plant.model, 0.2, nodes=start, **loops[1])
    second = tc.simulate(plant.model, 0.2, start=first, **loops[1])
    np.testing.assert_allclose(second.nodes[..., -1], whole.nodes[..., -1], atol=1e-9)
    applied = whole.control.applied
    assert applied.shape == (12, 20)
    np.testing.assert_array_equal(applied[6, 10:], applied[6, 9])
    still = [2, 3, 4, 5, 7]  # strings that are passive
    np.testing.assert_array_equal(applied[still], plant.rest_length[still, None] * np.ones(20))
    np.testing.assert_allclose(applied[0] + applied[1], plant.rest_length[:2].sum(), rtol=1e-12)
    np.testing.assert_array_equal(whole.rest_length[:, -1], applied[:9, -1])
    np.testing.assert_allclose(whole.struts.length[:, -1], applied[9:, -1], rtol=1e-14)
    at = np.searchsorted(whole.time, whole.control.time - 1e-9)
    off = whole.control.estimate.nodes[..., 1:] - whole.nodes[..., at[1:]]
    assert np.abs(off).max() < 5e-4
    ends = (np.abs(run.nodes[..., k] - plant.nodes).max() for run, k in ((whole, 0), (whole, -1)))
    assert next(ends) > 2 * next(ends)  # though a winch keeps its rest length


def test_mpc_keeps_the_limits_of_both_and_deploys(plant):
    """Along shapes of a search by the same drives, which the inputs of both hold at rest."""
    every, higher = _plant(plant.model.structure), np.ptp(plant.nodes[2]) + 0.04
    goal = tc.Height(higher, top=[0, 1, 2], bottom=[3, 4, 5])
    target = tc.shape_target(
        plant.model, goal, plant=every, min_force_density=15.0, max_force_density=45.0
    )
    low, high = plant.string_values - 0.05, plant.string_values + 0.05
    rate = np.r_[np.full(9, 0.2), np.full(3, 0.1)]
    winches = tc.Winches(ramp=True, rate=rate, shortest=low, longest=high)
    rest = tc.prestress(plant.model.structure, min_force_density=20.0)
    path = tc.shape_path(plant.model, rest, target, duration=0.5, plant=every)
    mpc = tc.MPC(
        every, horizon=8, sample_time=0.05, winches=winches, reference=path.reference(),
        min_force_density=1.0,
    )  # fmt: skip
    run = tc.simulate(plant.model, 1.2, nodes=plant.nodes, controller=mpc, winches=winches)
    assert set(run.control.status_count) == {"ok"}
    assert np.abs(run.nodes[..., -1] - target.nodes).max() < 2e-3
    assert (np.abs(run.control.winch_rate) <= rate[:, None] * (1 + 1e-9)).all()
    assert ((run.control.applied >= low[:, None]) & (run.control.applied <= high[:, None])).all()
    assert np.abs(run.struts.rate).max() > 0.01
    assert not run.control.rate_limited.any()  # the program knows them
    drawing = tc.plot.structure(run, actuated=None)
    plt.close(drawing.ax.figure)
    panels = tc.plot.struts(run)
    plt.close(panels["length"].ax.figure)


REFUSED = {
    "strings alone": (lambda p: tc.linearize(p.model, tc.prestress(p.model.structure, 20.0),
                                             struts=[0]), "struts are driven beside strings"),
    "no bar": (lambda p: _plant(p.model.structure, struts=[3]), "struts"),
    "twice": (lambda p: _plant(p.model.structure, struts={"a": [0], "b": [0]}),
              r"struts\['b'\] has bar 0"),
    "jump": (lambda p: tc.LQR(p), "lengths of bars cannot jump"),
    "motor": (lambda p: tc.LQR(p, sample_time=STEP, winches=replace(RAMP, motor=tc.Motor(0.01))),
              "winches has a motor"),
    "NMPC": (lambda p: tc.NMPC(p, horizon=5, sample_time=STEP), "NMPC takes no plant"),
    "reduce": (lambda p: tc.plant.reduce(p, modes=3), "input='length'"),
    "acceleration": (lambda p: _filter(p, accelerometer=0.1), "input='length': leave"),
    "both": (lambda p: tc.shape_target(p.model, [], plant=p, struts=p), "leave struts out"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_go_with_both_is_refused_by_name(plant, case):
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        call(plant)
