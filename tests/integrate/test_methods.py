"""The choice of a method, and the largest frequency that it rests on."""

from functools import cache, partial

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.integrate.fixed_step import FixedStep
from tenscontrol.integrate.integrator import largest_frequency, state_scale
from tenscontrol.integrate.methods import choose
from tests.dynamics.scenes import paper_force_density, rest_lengths


def stiff(prism, stiffness):
    lengths = rest_lengths(prism, paper_force_density(45.0), stiffness)
    equation = tc.Model(prism, strings=tc.LinearStrings(stiffness)).equation("rest_length")
    return equation, pack_state(prism, prism.nodes, np.zeros((3, 6))), lengths


@pytest.mark.parametrize("stiffness", [1e2, 1e5, 1e8])
def test_the_largest_frequency_is_that_of_the_linear_plant(prism, rest, stiffness):
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness))
    plant = tc.linearize(model, rest, "rest_length", "minimal")
    exact = 2 * np.pi * tc.modes(plant).frequency.max()
    lengths = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    found = largest_frequency(model.equation("rest_length"), state, lengths)
    assert exact * 0.97 < found < exact * 1.1


def test_soft_strings_get_the_method_of_order_eight(prism):
    chosen = choose(*stiff(prism, 1e2), 5.0, 1e-6, None)
    assert (chosen.method, chosen.setting, chosen.value) == ("dop853", "tolerance", 1e-6)
    assert "rad/s" in chosen.reason


def test_stiff_strings_get_the_implicit_method(prism):
    chosen = choose(*stiff(prism, 1e12), 5.0, 1e-6, None)
    assert chosen.method == "energy_momentum"
    assert "an explicit method would need" in chosen.reason


def test_a_step_asks_for_rk4(prism):
    chosen = choose(*stiff(prism, 1e2), 5.0, 1e-6, 1e-3)
    assert (chosen.method, chosen.setting, chosen.value) == ("rk4", "step", 1e-3)


def test_a_run_says_what_was_chosen_and_why(prism):
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    run = tc.simulate(model, 0.2, rest_length=lengths)
    assert run.choice.reason in run.summary()
    assert "rejected" in run.summary() or run.work.rejections == 0


@cache
def last_nodes(scale, method, setting):
    """Nodes of a prism of this size after 0.5 s, over its size."""
    lengths = scale * rest_lengths(tc.prism(), paper_force_density(9.0), 100.0)
    model = tc.Model(tc.prism(radius=0.5 * scale, height=scale), strings=tc.LinearStrings(100.0))
    run = tc.simulate(model, 0.5, rest_length=lengths, method=method, tolerance=setting)
    return run.nodes[:, :, -1] / scale


@pytest.mark.parametrize(
    ("unit", "method", "setting"),
    [
        (1e-6, "dop853", 1e-8), (1e3, "dop853", 1e-8), (1e-6, "cvodes", 1e-8),
        (1e3, "energy_momentum", 1e-5),
    ],
)  # fmt: skip
def test_the_answer_does_not_change_with_the_unit_of_length(unit, method, setting):
    """Lengths in another unit, force densities and masses as they are: the same motion."""
    found, expected = (last_nodes(scale, method, setting) for scale in (unit, 1.0))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_scales_follow_size_and_forces(prism):
    equation, state, lengths = stiff(prism, 100.0)
    scale = state_scale(equation, state, lengths, 40.0)
    assert scale[0] == pytest.approx(prism.bar_length[0])
    assert scale.shape == state.shape
    assert 0.1 < scale[-1] < 100


class Midpoint(FixedStep):
    """A method of a user: the explicit midpoint rule, of order 2."""

    name = "midpoint"
    evaluations_per_step = 2

    def step_function(self, equation):
        x, u, taut, h = equation.symbols()
        half = x + h / 2 * equation.slope(x, u, taut)
        return ca.Function("midpoint", [x, u, taut, h], [x + h * equation.slope(half, u, taut)])


MIDPOINT = tc.integrate.Method("midpoint", ("step",), "order 2, explicit", Midpoint)


def test_a_method_of_your_own_is_taken_as_it_is(prism):
    """Its order holds through slack switches, projected as well."""
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    limits = tc.HealthLimits(energy_error=None, bar_length_error=None, position_error=None)
    run = partial(tc.simulate, model, 0.5, rest_length=lengths, limits=limits)
    exact = run(tolerance=1e-10).nodes[:, :, -1]
    steps = (4e-3, 2e-3, 1e-3)
    errors = [
        np.abs(run(method=MIDPOINT, step=step).nodes[:, :, -1] - exact).max() for step in steps
    ]
    assert 1.8 < np.polyfit(np.log(steps), np.log(errors), 1)[0] < 2.3
    fine = run(method=MIDPOINT, step=1e-3, project=True)
    assert fine.method == "midpoint"
    assert np.abs(fine.bar_length_error).max() < 1e-14
    with pytest.raises(ValueError, match="method 'midpoint' needs a step"):
        run(method=MIDPOINT)


@pytest.mark.parametrize("method", ["rk4", "dop853", "energy_momentum", "auto"])
def test_the_answer_of_a_method_does_not_change_with_units(method):
    gamma = np.repeat([10.0, 10.0, 0.9 * np.sqrt(3) * 10.0], 3)
    shapes = []
    for length in (1e-6, 1.0, 1e3):
        structure = tc.prism(radius=0.5 * length, height=length, bar_mass=length**3)
        given = {"step": 0.01 * length} if method == "rk4" else {"tolerance": 1e-6}
        run = tc.simulate(
            tc.Model(structure),
            length,
            force_density=length * gamma,
            method=method,
            output_step=0.1 * length,
            **given,
        )
        shapes.append(run.nodes / length)
    np.testing.assert_allclose(shapes[1], shapes[0], atol=1e-9)
    np.testing.assert_allclose(shapes[2], shapes[0], atol=1e-9)
