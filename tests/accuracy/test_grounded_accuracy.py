"""Accuracy of motions that meet the ground: the reference, orders, energies, peers."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.accuracy.peers import CasADiRK, SciPy
from tenscontrol.integrate import DOP853

FALL, SPEED, STIFFNESS = 0.1, 2.0, 1e3


def bar_case(**law):
    """A level bar of 2 kg that meets the ground with both ends at once, without weight."""
    bar = tc.Structure([[-0.5, 0.5], [0, 0], [FALL, FALL]], [[0, 1]], np.zeros((0, 2), int), 2.0)
    ground = tc.Ground(STIFFNESS, **law)
    down = np.array([[0.0], [0.0], [-SPEED]]) * np.ones(2)
    model = tc.Model(bar, ground=ground)
    return tc.Scene(model, 0.4, velocities=down, force_density=np.zeros(0))


def ball_case(duration=0.35, **law):
    ball = tc.library.six_bar_ball()
    rest = tc.prestress(ball, force_density=30.0)
    strings = tc.LinearStrings(500.0)
    lengths = tc.to_rest_length(tc.Model(ball, strings=strings), ball.nodes, rest.force_density)
    ground = tc.Ground(5e3, height=ball.nodes[2].min() - 0.1, **law)
    model = tc.Model(ball, strings=strings, gravity=9.81, ground=ground)
    velocities = np.zeros_like(ball.nodes)
    velocities[0] = 0.5
    return tc.Scene(model, duration, velocities=velocities, rest_length=lengths.rest_length)


@pytest.fixture(scope="module")
def bouncing():
    """A ball on ground that keeps its energy, and the reference."""
    case = ball_case()
    return case, tc.accuracy.converged_motion(case, outputs=20)


def test_the_reference_of_a_bounce_is_the_closed_form():
    found = tc.accuracy.converged_motion(bar_case(), outputs=40)
    rate = np.sqrt(STIFFNESS)  # of half the bar, 1 kg, on each end
    touches, leaves = FALL / SPEED, FALL / SPEED + np.pi / rate
    np.testing.assert_allclose(found.switches, [touches, leaves], rtol=0, atol=1e-10)
    within = np.clip(found.time - touches, 0, np.pi / rate)
    height = FALL - SPEED * np.minimum(found.time, touches) - SPEED / rate * np.sin(rate * within)
    height += SPEED * np.maximum(found.time - leaves, 0)
    np.testing.assert_allclose(found.nodes[2], [height, height], rtol=0, atol=1e-11)
    assert found.error < 1e-11


def test_outputs_at_the_very_time_of_a_switch_are_those_of_the_step_before_it():
    case = bar_case()  # which touches at 0.05 s
    found = DOP853(case.equation(), 1e-9).advance(case.state, case.input_value, case.duration, 40)
    height, speed = found.states[[2, 8], 4]
    assert abs(height) < 1e-15
    assert speed == pytest.approx(-SPEED, rel=1e-14)


def test_codes_of_the_reference_agree_where_contacts_rub(bouncing):
    rubbing = tc.accuracy.converged_motion(ball_case(damping=0.3, friction=0.5), outputs=20)
    assert rubbing.error < 1e-11
    assert len(rubbing.switches) >= 1
    assert bouncing[1].error < 1e-11
    smooth = bar_case()
    law = tc.dynamics.SmoothGround(STIFFNESS, friction=0.3, width=0.01)
    model = tc.Model(smooth.structure, ground=law)
    case = tc.Scene(model, 0.2, velocities=smooth.velocities, force_density=np.zeros(0))
    found = tc.accuracy.converged_motion(case, outputs=10)
    assert found.error < 1e-11
    assert len(found.switches) == 0


def test_the_fastest_rate_is_that_of_the_ground_before_and_in_contact():
    rocks = np.sqrt(3 * STIFFNESS)  # one end down, the other up: k / (m / 6) of each, 2 kg
    assert fastest_rate(bar_case()) == pytest.approx(rocks, rel=1e-6)
    assert fastest_rate(bar_case(damping=0.5)) < 2 * rocks  # high above, damping says nothing


@pytest.mark.parametrize(
    ("method", "order", "steps"),
    [
        ("rk4", 4, [8e-4, 4e-4, 2e-4]),
        ("energy_momentum", 2, [3.2e-3, 1.6e-3, 8e-4]),
    ],
)
def test_orders_hold_through_impacts(bouncing, method, order, steps):
    case, reference = bouncing
    found = tc.convergence_order(case, method, steps, reference)
    assert found.switches >= 2
    assert found.order == pytest.approx(order, abs=0.15)


def test_energy_counts_what_the_ground_stores(bouncing):
    case, reference = bouncing
    compared = tc.work_precision(
        case, ["dop853", "energy_momentum"], {"dop853": [1e-10], "energy_momentum": [1e-3]},
        peers=[SciPy("DOP853", [1e-9]), CasADiRK([2e-4])], reference=reference, repeats=1,
    )  # fmt: skip
    rows = {row.method: row for row in compared.rows}
    assert not any(row.failure for row in rows.values())
    assert rows["dop853"].energy_error < 1e-8
    assert rows["dop853"].error < 1e-9
    assert rows["energy_momentum"].energy_error < 1e-9  # it conserves, however far off
    assert rows["scipy dop853"].error < 1e-4
    # The ground takes momentum up: nothing says that it drifts.
    assert rows["dop853"].momentum_drift < 1e-7


def test_long_runs_leave_out_what_the_ground_takes():
    found = tc.long_run(bar_case(), "energy_momentum", 1e-3, steps=400, outputs=40)
    assert {drift.name for drift in found.drifts} == {"energy", "bar length"}
    assert found.of("energy").largest < 1e-10
    lossy = tc.long_run(bar_case(damping=0.1), "rk4", 1e-3, steps=400, outputs=40)
    assert {drift.name for drift in lossy.drifts} == {"bar length"}


def test_perturbations_are_followed_through_impacts():
    found = tc.predictability(ball_case(damping=0.3, friction=0.5), outputs=20, samples=1)
    assert 1.0 < found.factor < 1e6
