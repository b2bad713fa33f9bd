"""LQR: checked design, and what the gain does on the nonlinear prism."""

from functools import cache

import control
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_discrete_are

import tenscontrol as tc
from tenscontrol.plant import riccati


@pytest.fixture(scope="module")
def prism():
    return tc.prism()


@pytest.fixture(scope="module")
def rest(prism):
    return tc.prestress(prism, 30 / np.sqrt(3))


@pytest.fixture(scope="module")
def model(prism):
    return tc.Model(prism, strings=tc.LinearStrings(100.0))


def displaced(plant, size, seed=0):
    """Return a shape whose farthest node is off by ``size``, m."""
    direction = np.random.default_rng(seed).normal(size=plant.degrees_of_freedom)
    scale = 1e-5
    for _ in range(20):
        off = np.linalg.norm(plant.to_nodes(scale * direction) - plant.nodes, axis=0).max()
        scale *= size / off
    return plant.to_nodes(scale * direction)


def farthest(plant, run):
    """Return how far the farthest node is from the equilibrium at the end, m."""
    z = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
    shape = plant.to_nodes(z[: plant.degrees_of_freedom])
    return np.linalg.norm(shape - plant.nodes, axis=0).max()


@pytest.mark.parametrize("kind", ["force_density", "rest_length"])
def test_all_poles_lie_in_the_open_left_half_plane(model, rest, kind):
    plant = tc.linearize(model, rest, input=kind)
    Q, R = tc.energy_weights(plant)
    regulator = tc.LQR(plant, Q, 0.1 * R)
    assert regulator.poles.real.max() < -0.1
    closed = np.linalg.eigvals(plant.A - plant.B @ regulator.gain)
    assert np.allclose(np.sort(closed.real), np.sort(regulator.poles.real), rtol=1e-6, atol=1e-6)
    assert regulator.riccati_residual < 1e-10


def test_gain_and_cost_solve_the_continuous_riccati_equation(model, rest):
    plant = tc.linearize(model, rest)
    regulator = tc.LQR(plant, 2.0, 1e-2)
    P = solve_continuous_are(plant.A, plant.B, 2 * np.eye(18), 1e-2 * np.eye(9))
    assert np.allclose(regulator.cost, P, rtol=1e-7, atol=1e-7 * abs(P).max())
    assert np.allclose(regulator.gain, 100 * plant.B.T @ P, rtol=1e-6, atol=1e-6)


def test_gain_and_cost_solve_the_discrete_riccati_equation(model, rest):
    plant = tc.linearize(model, rest)
    regulator = tc.LQR(plant, 2.0, 1e-2, sample_time=0.02)
    transition, inputs, _ = plant.discretize(0.02)
    P = solve_discrete_are(transition, inputs, 2 * np.eye(18), 1e-2 * np.eye(9))
    assert np.allclose(regulator.cost, P, rtol=1e-7, atol=1e-7 * abs(P).max())
    assert np.abs(regulator.poles).max() < 1


@pytest.mark.parametrize("sample_time", [None, 0.02])
def test_cross_weights_are_those_of_python_control(model, rest, sample_time):
    plant = tc.linearize(model, rest)
    Q, R = tc.energy_weights(plant)
    N = 0.1 * np.random.default_rng(0).normal(size=plant.B.shape) * np.sqrt(np.diag(Q)[:, None] * R)
    given = plant.to_statespace(sample_time), Q, np.diag(R), N
    gain, cost, poles = control.lqr(*given) if sample_time is None else control.dlqr(*given)
    regulator = tc.LQR(plant, Q, R, N, sample_time=sample_time)
    np.testing.assert_allclose(regulator.gain, gain, rtol=0, atol=1e-9 * np.abs(gain).max())
    np.testing.assert_allclose(regulator.cost, cost, rtol=0, atol=1e-9 * np.abs(cost).max())
    both = (np.sort_complex(each.round(7)) for each in (regulator.poles, poles))
    np.testing.assert_allclose(*both, rtol=0, atol=1e-6)
    assert np.abs(gain - tc.LQR(plant, Q, R, sample_time=sample_time).gain).max() > 0.1
    with pytest.raises(ValueError, match=r"Q − N R⁻¹ Nᵀ has the eigenvalue -.* smaller N"):
        tc.LQR(plant, Q, R, 30 * N)
    with pytest.raises(ValueError, match=r"N has shape \(9, 18\), expected \(18, 9\)"):
        tc.MPC(plant, horizon=2, sample_time=0.02, N=N.T)


@pytest.fixture(scope="module")
def uncontrolled(model, rest):
    """Motions without feedback, from a start of this seed."""

    @cache
    def run(seed):
        start = displaced(tc.linearize(model, rest), 0.01, seed)
        return tc.simulate(model, 5.0, start, force_density=rest.force_density, step=2e-3)

    return run


@pytest.mark.parametrize(("seed", "hold"), [(0, "force_density"), (1, "rest_length")])
def test_gain_brings_a_centimetre_below_a_tenth_of_a_millimetre(
    model, rest, uncontrolled, hold, seed
):
    plant = tc.linearize(model, rest)
    Q, R = tc.energy_weights(plant)
    regulator = tc.LQR(plant, Q, 0.1 * R, max_force_density=90.0)
    start = displaced(plant, 0.01, seed)
    assert np.linalg.norm(start - plant.nodes, axis=0).max() == pytest.approx(0.01)
    run = tc.simulate(
        model, 5.0, start, controller=regulator, input=hold, sample_time=0.01, step=2e-3
    )
    assert farthest(plant, run) < 1e-4
    # The same start without feedback keeps swinging.
    assert farthest(plant, uncontrolled(seed)) > 1e-3


def test_rest_length_plant_is_regulated_by_rest_lengths(model, rest):
    plant = tc.linearize(model, rest, input="rest_length")
    Q, R = tc.energy_weights(plant)
    regulator = tc.LQR(plant, Q, 0.1 * R)
    start = displaced(plant, 0.01)
    run = tc.simulate(model, 5.0, start, controller=regulator, sample_time=0.01, step=2e-3)
    assert farthest(plant, run) < 1e-4


def test_command_at_rest_is_the_equilibrium_input(model, rest):
    regulator = tc.LQR(tc.linearize(model, rest), 1.0, 1e-3)
    command = regulator.command(0.0, rest.structure.nodes, np.zeros((3, 6)))
    assert command.status == "ok"
    assert np.allclose(command.value, rest.force_density, atol=1e-9)


def test_saturated_commands_stay_within_bounds_and_say_so(model, rest):
    plant = tc.linearize(model, rest)
    regulator = tc.LQR(plant, 1e4, 1e-3, max_force_density=50.0)
    command = regulator.command(0.0, displaced(plant, 0.05), np.zeros((3, 6)))
    assert command.status == "saturated"
    assert command.value.min() == 0.0
    assert command.value.max() == 50.0


def test_measurement_that_is_not_finite_gives_the_equilibrium(model, rest):
    regulator = tc.LQR(tc.linearize(model, rest), 1.0, 1e-3)
    nodes = rest.structure.nodes.copy()
    nodes[0, 0] = np.nan
    command = regulator.command(0.0, nodes, np.zeros((3, 6)))
    assert str(command) == "measurement not finite: equilibrium held"
    assert np.array_equal(command.value, rest.force_density)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (
            "nodes",
            "18 of the 36 .*6 are lengths of bars and their rates and 12 are rigid-body motions",
        ),
        ("minimal", "12 of the 30 .*12 are rigid-body motions"),
    ],
)
def test_forms_with_unreachable_states_are_refused_with_a_count(model, rest, kind, expected):
    plant = tc.linearize(model, rest, coordinates=kind)
    with pytest.raises(ValueError, match=expected + ".*coordinates='internal'"):
        tc.LQR(plant, 1.0, 1.0)


def solver(change):
    """Return the solver of the Riccati equation with its answer changed."""
    original = riccati._solve

    def changed(*arguments):
        return change(*original(*arguments))

    return changed


def test_a_wrong_riccati_solution_is_not_passed_on(model, rest, monkeypatch):
    plant = tc.linearize(model, rest)
    wrong = solver(lambda K, P, poles: (K, 1.01 * P, poles))
    monkeypatch.setattr(riccati, "_solve", wrong)
    with pytest.raises(ValueError, match=r"has a solution with a residual of .* not accurate"):
        tc.LQR(plant, 1.0, 1e-3)


@pytest.mark.parametrize("pole", [0.0, 0.1])
def test_poles_that_do_not_decay_are_not_passed_on(model, rest, monkeypatch, pole):
    plant = tc.linearize(model, rest)
    unstable = solver(lambda K, P, poles: (K, P, np.r_[pole, poles[1:]]))
    monkeypatch.setattr(riccati, "_solve", unstable)
    with pytest.raises(ValueError, match="closed loop is not stable"):
        tc.LQR(plant, 1.0, 1e-3)


@pytest.mark.parametrize(
    ("length", "mass", "gamma"),
    [(1.0, 1e-6, 1.0), (1.0, 1e12, 1.0), (1e-6, 1.0, 1.0), (1e3, 1.0, 1e-6), (1.0, 1.0, 1e6)],
)
def test_design_does_not_depend_on_units(length, mass, gamma):
    """The same prism in other units: the same gain, scaled."""

    def design(length, mass, gamma):
        prism = tc.prism(radius=0.5 * length, height=length, bar_mass=mass)
        plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 30 / np.sqrt(3) * gamma))
        Q, R = tc.energy_weights(plant)
        regulator = tc.LQR(plant, Q, 0.1 * R)
        # Node displacement 1 % of the length in the direction of the first basis-free shape.
        nodes = plant.nodes + 0.01 * length * np.sin(np.arange(18)).reshape(3, 6)
        return regulator.command(0.0, nodes, np.zeros((3, 6))).value / gamma

    np.testing.assert_allclose(design(length, mass, gamma), design(1.0, 1.0, 1.0), rtol=1e-5)


def test_unreachable_changes_of_shape_are_told_from_motions_as_one_body(prism):
    """Without prestress the twist is out of reach: two states that 'internal' does not cure."""
    bare = tc.prestress(prism, np.zeros(9))
    expected = "12 are rigid-body motions and 2 are changes of shape"
    with pytest.raises(ValueError, match=expected):
        tc.LQR(tc.linearize(tc.Model(prism), bare, coordinates="minimal"), 1.0, 1.0)
    with pytest.raises(ValueError, match=r"2 of the 18 .* 2 are changes of shape, at the poles 0"):
        tc.LQR(tc.linearize(tc.Model(prism), bare), 1.0, 1.0)


def test_mode_without_weight_is_refused(model, rest):
    plant = tc.linearize(model, rest)
    with pytest.raises(ValueError, match="weight"):
        tc.LQR(plant, 0.0, 1.0)


def test_a_driven_string_without_force_is_warned_of():
    """γ of a slack string can only grow: a gain that takes it down as well is none."""
    cross = tc.Structure(
        [[0.0, 1.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0]], [[0, 1], [2, 3]],
        [[0, 2], [2, 1], [1, 3], [3, 0], [0, 2]], 1.0,
    )  # fmt: skip
    gamma = [20.0, 20.0, 20.0, 20.0, 0.0]
    model, rest = tc.Model(cross), tc.prestress(cross, gamma)
    with pytest.warns(RuntimeWarning, match=r"gamma_.*\[4\] is at a bound .* one way only"):
        tc.LQR(tc.linearize(model, rest), sample_time=0.02)
    tc.LQR(tc.linearize(model, rest, actuated=[0, 1, 2, 3]), sample_time=0.02)
    both = tc.linearize(model, rest, actuated={"pair": [0, 4], "b": 1, "c": 2, "d": 3})
    with pytest.warns(RuntimeWarning, match="gamma_pair is at a bound"):
        tc.LQR(both, sample_time=0.02)


def test_driven_strings_that_move_nothing_are_said_to():
    """And not that a weight is 0 which nobody gave."""
    cross = tc.Structure(
        [[0.0, 1.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0]], [[0, 1], [2, 3]],
        [[0, 2], [2, 1], [1, 3], [3, 0], [0, 2]], 1.0,
    )  # fmt: skip
    model = tc.Model(cross, strings=tc.LinearStrings(100.0))
    wound = [0.9, 0.9, 0.9, 0.9, 2.0]
    rest = tc.equilibrium(model, rest_length=wound)
    plant = tc.linearize(model, rest, input="rest_length", rest_length=wound, actuated=[4])
    with pytest.raises(ValueError, match=r"none of the \d+ states .* can be controlled"):
        tc.LQR(plant, sample_time=0.02)
