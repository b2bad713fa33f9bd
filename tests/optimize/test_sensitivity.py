"""Derivatives of runs: closed forms, differences of the simulator, both ways alike."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.optimize.derivatives import Derivatives
from tests.benchmarks.error_against_time import thrown
from tests.benchmarks.sensitivities import comparison

# Of one mass on a string that goes taut: m, k, c, l0, where it starts, its speed, the time.
MASS, STIFFNESS, DAMPING, REST, PLACE, SPEED, TIME = 2.0, 50.0, 3.0, 1.0, 0.7, 0.9, 0.8


def pendant(rest=REST, stiffness=STIFFNESS, damping=DAMPING, speed=SPEED, method="dop853", **how):
    """A mass that moves along x from a fixed node, on a string that is slack at first."""
    structure = tc.Structure(
        [[0.0, PLACE], [0.0, 0.0]], np.zeros((0, 2), int), [(0, 1)], [], fixed=[0],
        rollers=[(1, "y")], point_mass=[0.0, MASS],
    )  # fmt: skip
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness, damping))
    return tc.simulate(
        model, TIME, velocities=[[0.0, speed], [0.0, 0.0]], rest_length=rest, method=method,
        error="none", **(how or {"tolerance": 1e-12}),
    )  # fmt: skip


def place_of_pendant(speed, rest, stiffness, damping, mass):
    """Where the mass is at the time: free flight, then a damped vibration; of complex numbers."""
    left = TIME - (rest - PLACE) / speed
    rate = damping / (2 * mass)
    frequency = np.sqrt(stiffness / mass - rate**2)
    return rest + speed / frequency * np.exp(-rate * left) * np.sin(frequency * left)


def test_a_string_that_goes_taut_has_the_derivatives_of_its_closed_form():
    run = pendant()
    assert run.work.switches == 1
    names = ["velocities", "rest_length", "stiffness", "damping", "point_mass"]
    tangent = tc.sensitivity(run, names)
    found = [
        tangent.nodes["velocities"][0, 1, 0, 0, 1],
        *(tangent.nodes[name][0, 1, 0, -1] for name in names[1:]),
    ]
    values = np.array([SPEED, REST, STIFFNESS, DAMPING, MASS])
    steps = 1e-30j * np.eye(5)
    exact = [place_of_pendant(*(values + step)).imag / 1e-30 for step in steps]
    np.testing.assert_allclose(found, exact, rtol=2e-9)
    assert tangent.switches == 1
    assert tangent.grazing == ()


def test_without_the_jump_where_it_goes_taut_they_are_wrong(monkeypatch):
    run, whole = pendant(), Derivatives.at_switches

    def without(self, *arguments):
        found = whole(self, *arguments)
        found.jump[:] = 0.0
        return found

    right = tc.sensitivity(run, ["rest_length"]).nodes["rest_length"]
    monkeypatch.setattr(Derivatives, "at_switches", without)
    wrong = tc.sensitivity(run, ["rest_length"]).nodes["rest_length"]
    assert abs(wrong[0, 1, 0, 0] / right[0, 1, 0, 0] - 1) > 0.03


# Seeds of some hundred steps: damped, on ground, with clusters, bars that share nodes, supports.
# The small run of the benchmark has two more, 24 and 25.
@pytest.mark.parametrize("seed", [12, 28])
@pytest.mark.filterwarnings("ignore:penetration")
def test_random_scenes_agree_with_differences_and_backward_with_forward(seed):
    found = comparison(seed, most_steps=500)
    assert found.is_judged
    assert found.error < 1e-7 + 3 * found.certain
    assert found.adjoint < 1e-12


def test_implicit_steps_agree_with_differences_and_backward_with_forward():
    found = comparison(702, most_steps=500, implicit=True)
    assert found.error < 1e-8
    assert found.adjoint < 1e-12


@pytest.mark.parametrize(("damping", "order"), [(0.0, 2), (DAMPING, 1)])
def test_implicit_steps_go_through_switches_with_their_order(damping, order):
    """Damping that begins within a step acts over the whole of it: an error of order 1."""
    exact = place_of_pendant(SPEED, REST + 1e-30j, STIFFNESS, damping, MASS).imag / 1e-30
    counts, errors = 2.0 ** np.arange(6, 9), []
    for count in counts:
        run = pendant(damping=damping, method="energy_momentum", step=TIME / count)
        found = tc.sensitivity(run, ["rest_length"]).nodes["rest_length"]
        errors.append(abs(found[0, 1, 0, 0] - exact))
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(order, abs=0.3)
    assert errors[-1] < 1e-3


def test_implicit_steps_by_tolerance_are_two_halves_each():
    exact = place_of_pendant(SPEED, REST + 1e-30j, STIFFNESS, 0.0, MASS).imag / 1e-30
    run = pendant(damping=0.0, method="energy_momentum", tolerance=1e-8, output_step=TIME)
    found = tc.sensitivity(run, ["rest_length"], [TIME / 3, TIME]).nodes["rest_length"]
    assert run.steps < 200
    assert found[0, 1, 0, 0] == 0.0  # it flies
    assert found[0, 1, 1, 0] == pytest.approx(exact, rel=1e-4)


def swinging_prism(rest, **options):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.8), gravity=0.5)
    return tc.simulate(model, 1.0, rest_length=rest, tolerance=1e-11, error="none", **options)


def test_a_profile_is_differentiated_by_its_values():
    usual, time = 0.97 * tc.prism().string_length(), [0.0, 0.3, 0.5, 0.8]
    values = usual[:, None] * np.array([1.0, 0.8, 1.15, 0.9])

    def end(values):
        return swinging_prism(tc.Profile(time, values)).nodes[:, :, -1]

    run = swinging_prism(tc.Profile(time, values))
    assert run.work.switches > 5
    found = tc.sensitivity(run, ["rest_length"]).nodes["rest_length"]
    assert found.shape == (3, 6, 1, 9, 4)
    for string, knot in ((0, 0), (4, 1), (7, 2), (8, 3)):
        change = np.zeros_like(values)
        change[string, knot] = 1e-5
        difference = (end(values + change) - end(values - change)) / 2e-5
        np.testing.assert_allclose(
            found[:, :, 0, string, knot], difference, atol=3e-6 * np.abs(found).max()
        )


@pytest.mark.parametrize("method", [{"method": "rk4", "step": 2e-3}, {"method": "dop853"}])
def test_derivatives_between_steps_lie_between_those_of_runs_up_to_there(method):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.8))
    rest = 0.9 * tc.prism().string_length()
    run = tc.simulate(model, 1.0, rest_length=rest, error="none", **method)
    times = [0.0, 0.1235, 0.5, 0.777, 1.0]
    found = tc.sensitivity(run, ["rest_length", "velocities"], times)
    assert found.nodes["rest_length"].shape == (3, 6, 5, 9)
    np.testing.assert_array_equal(found.nodes["rest_length"][:, :, 0], 0.0)
    for i, time in enumerate(times[1:], 1):
        shorter = tc.simulate(model, time, rest_length=rest, error="none", **method)
        alone = tc.sensitivity(shorter, ["rest_length"]).nodes["rest_length"]
        size = np.abs(alone).max()
        np.testing.assert_allclose(
            found.nodes["rest_length"][:, :, i], alone[:, :, 0], atol=2e-5 * size
        )


def test_the_order_of_a_fixed_step_is_that_of_the_method():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    rest = 0.9 * tc.prism().string_length()

    def slope(**how):
        run = tc.simulate(model, 0.5, rest_length=rest, error="none", **how)
        return tc.sensitivity(run, ["stiffness"]).nodes["stiffness"]

    exact = slope(tolerance=1e-13)
    errors = [np.abs(slope(step=h) - exact).max() for h in (0.01, 0.005, 0.0025)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 3.7).all()


def test_a_cost_at_several_times_has_the_slope_of_its_derivatives():
    run = swinging_prism(0.97 * tc.prism().string_length())
    names, times = ["rest_length", "bar_mass", "velocities"], [0.2, 0.55, 1.0]
    goal = ca.DM(tc.prism().nodes)

    def cost(time, nodes, velocities):
        return time * ca.sumsqr(nodes - goal) + 0.1 * ca.sumsqr(velocities)

    found = tc.gradient(run, cost, names, times)
    tangent = tc.sensitivity(run, names, times)
    again = tc.simulate(
        run.model, 1.0, rest_length=run.rest_length[:, 0], tolerance=1e-13, output_step=0.05,
        error="none",
    )  # fmt: skip
    at = np.searchsorted(again.time, np.array(times) - 1e-9)
    nodes, velocities = again.nodes[:, :, at], again.velocities[:, :, at]
    off = nodes - tc.prism().nodes[:, :, None]
    value = (times * (off**2).sum(axis=(0, 1))).sum() + 0.1 * (velocities**2).sum()
    assert found.value == pytest.approx(value, rel=1e-8)
    for name in names:
        slope = np.tensordot(2 * off * times, tangent.nodes[name], 3)
        slope = slope + np.tensordot(0.2 * velocities, tangent.velocities[name], 3)
        np.testing.assert_allclose(found.slope[name], slope, atol=1e-7 * np.abs(slope).max())


def test_under_a_controller_each_sample_is_an_input():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(500.0, damping=1.0))
    rest = tc.prestress(prism, force_density=10.0)
    plant = tc.linearize(model, rest, input="rest_length")
    law = tc.LQR(plant, Q=1.0, R=1.0, sample_time=0.05)
    start = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    nodes = tc.shape_target(
        model, tc.Height(1.01, top=[3, 4, 5], bottom=[0, 1, 2]), force_density=10.0
    ).nodes
    how = {"nodes": nodes, "tolerance": 1e-11, "error": "none"}
    run = tc.simulate(model, 0.2, controller=law, rest_length=start, **how)
    found = tc.sensitivity(run, ["rest_length"]).nodes["rest_length"]
    assert found.shape == (3, 6, 1, 9, 4)
    ticks = [0.0, 0.05, 0.1, 0.15]
    held = run.rest_length[:, np.searchsorted(run.time, np.array(ticks) + 0.025)]
    assert np.ptp(held, axis=1).max() > 1e-4
    replayed = tc.simulate(model, 0.2, rest_length=tc.Profile(ticks, held, "hold"), **how)
    again = tc.sensitivity(replayed, ["rest_length"]).nodes["rest_length"]
    np.testing.assert_allclose(found, again, atol=1e-8 * np.abs(again).max())


@pytest.mark.filterwarnings("ignore:penetration")
def test_friction_that_keeps_explicit_steps_short_leaves_derivatives_stable():
    """A symmetric throw: what it does not move along is seen by no error of its steps."""
    ball = tc.library.six_bar_ball()
    ground = tc.Ground(5e3, damping=0.3, friction=0.6)
    model = tc.Model(ball, tc.LinearStrings(800.0, damping=2.0), gravity=9.81, ground=ground)
    start = ball.nodes - [[0], [0], [ball.nodes[2].min() - 0.3]]
    throw = np.zeros(ball.nodes.shape)
    throw[0] = 1.5
    rest = 0.95 * ball.string_length()

    def thrown(rest):
        return tc.simulate(model, 0.6, start, throw, rest_length=rest, tolerance=1e-9, error="none")

    def far(time, nodes, velocities):
        return ca.sum2(nodes[0, :]) / 12

    run = thrown(rest)
    slope = tc.gradient(run, far, ["rest_length"]).slope["rest_length"]
    random = np.random.default_rng(0)
    along = random.normal(size=24)
    ends = [thrown(rest + by * along).nodes[0, :, -1].mean() for by in (1e-5, -1e-5)]
    assert slope @ along == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4)


@pytest.mark.parametrize("how", [{"tolerance": 1e-6}, {"tolerance": 1e-8}, {"step": 2e-3}])
def test_the_error_is_estimated_on_the_safe_side(how):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.8), gravity=0.5)
    rest = 0.97 * tc.prism().string_length() * np.linspace(0.93, 1.05, 9)
    names, times = ["rest_length", "stiffness"], [0.3, 0.6, 1.0]

    def tangent(**how):
        run = tc.simulate(model, 1.0, rest_length=rest, error="none", **how)
        return tc.sensitivity(run, names, times)

    found, exact = tangent(**how), tangent(tolerance=1e-12)
    assert exact.switches > 3
    for name in names:
        off = np.abs(found.nodes[name] - exact.nodes[name]).max(axis=(0, 1, 3))
        off /= np.abs(exact.nodes[name]).max(axis=(0, 1, 3))
        assert (found.error[name] > 0.7 * off).all()
        assert (found.error[name] < 1e4 * off).all()


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-3])
def test_the_error_is_seen_where_stability_limits_the_steps(tolerance):
    """A stiff ball vibrates by little: ten times the tolerance makes no longer steps."""
    ball = thrown(1.0, 1.5, 2000.0, 40.0)

    def tangent(tolerance):
        how = tc.Integration(tolerance=tolerance, error="none")
        run = replace(ball, integration=how).simulate()
        return tc.sensitivity(run, ["rest_length"])

    found, exact = tangent(tolerance), tangent(1e-9).nodes["rest_length"]
    off = np.abs(found.nodes["rest_length"] - exact).max() / np.abs(exact).max()
    assert 0.2 * tolerance < off < 3 * tolerance
    assert found.error["rest_length"][0] > 0.7 * off


def test_derivatives_are_right_where_the_motion_hardly_vibrates():
    """Steps of the run are as long as stability allows: of its derivatives they would be wrong."""
    ball = thrown(0.3, 0.2, 2e5, 400.0)
    found, exact = (
        tc.sensitivity(tc.simulate(
            ball.model, ball.duration, ball.nodes, ball.velocities, tolerance=tolerance,
            rest_length=ball.input_value, error="none",
        ), ["rest_length"]).nodes["rest_length"]
        for tolerance in (1e-6, 1e-9)
    )  # fmt: skip
    assert np.abs(found - exact).max() < 2e-5 * np.abs(exact).max()


def test_many_runs_have_the_derivatives_of_each():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.8))
    rest = 0.95 * tc.prism().string_length()
    how = tc.Integration("rk4", step=2e-3)
    scene = tc.Scene(model, 0.1, rest_length=rest, integration=how)
    lengths = np.array([rest, 0.97 * rest, -rest])
    batch = tc.simulate_many(scene, {"rest_length": lengths, "damping": [0.0, 0.8, 0.8]})
    found = tc.sensitivity(batch, ["rest_length", "stiffness"], [0.05, 0.1])
    assert found.nodes["stiffness"].shape == (3, 3, 6, 2, 9)
    assert np.isnan(found.nodes["stiffness"][2]).all()
    for i, damping in enumerate([0.0, 0.8]):
        own = model.replace(strings=tc.LinearStrings(100.0, damping=damping))
        run = tc.simulate(own, 0.1, rest_length=lengths[i], method="rk4", step=2e-3, error="none")
        alone = tc.sensitivity(run, ["rest_length", "stiffness"], [0.05, 0.1])
        assert found.switches[i] == alone.switches
        for name, by in alone.velocities.items():
            np.testing.assert_array_equal(found.velocities[name][i], by)


def test_what_cannot_be_differentiated_is_refused():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    rest = 0.9 * tc.prism().string_length()
    run = tc.simulate(model, 0.1, rest_length=rest)
    with pytest.raises(ValueError, match=r"to\[1\] is 'stifness', expected one of"):
        tc.sensitivity(run, ["nodes", "stifness"])
    with pytest.raises(TypeError, match="to is a str, expected a list of names"):
        tc.sensitivity(run, "stiffness")
    with pytest.raises(ValueError, match=r"times run from 0\.05 s to 0\.2 s"):
        tc.sensitivity(run, ["stiffness"], [0.05, 0.2])
    with pytest.raises(ValueError, match="times do not ascend"):
        tc.sensitivity(run, ["stiffness"], [0.05, 0.05])
    with pytest.raises(TypeError, match="what cost returns"):
        tc.gradient(run, lambda time, nodes, velocities: nodes, ["stiffness"])
    other = tc.simulate(model, 0.1, rest_length=rest, method="cvodes")
    with pytest.raises(ValueError, match="run is by the method 'cvodes'"):
        tc.sensitivity(other, ["stiffness"])
    onwards = tc.simulate(model, 0.1, start=run)
    with pytest.raises(ValueError, match="run has no scene"):
        tc.sensitivity(onwards, ["stiffness"])
