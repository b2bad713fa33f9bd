"""RATTLE: order, invariants, exact bars, reversibility, long runs, refusals."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space
from scipy.special import ellipk

import tenscontrol as tc
from tenscontrol.dynamics import smooth_equation, unpack_states
from tenscontrol.dynamics.machine_code import compiled
from tenscontrol.integrate.rattle import rattle_evaluations, rattle_step, splitting
from tests.dynamics.scenes import (
    paper_force_density,
    random_force_density,
    random_structure,
    side_by_side,
)
from tests.dynamics.test_pendulum import GRAVITY, LENGTH, pendulum
from tests.integrate.stepping import (
    bar_errors,
    fitted_order,
    march,
    moving,
    records,
    rk4,
    smooth_motion,
    supported_structure,
)
from tests.integrate.test_rk4 import oscillator
from tests.oracle import HeldForceDensity, RigidBars, consistent_mass

ORDERS = (2, 4, 6)
EVALUATIONS = {2: 1, 4: 4, 6: 14}
each_order = pytest.mark.parametrize("order", ORDERS)
seeds = st.integers(0, 10_000)


def loaded(seed, load=True):
    """A supported structure with everything: equation, γ, and a state in motion."""
    structure = supported_structure(seed)
    force = 3 * np.random.default_rng(seed).normal(size=structure.nodes.shape) if load else None
    model = tc.Model(structure, external_force=load, gravity=9.81 if load else None)
    return (
        model.equation("force_density", force),
        random_force_density(structure, seed),
        moving(structure, seed),
    )


# ---- coefficients ----


@each_order
def test_flights_and_kicks_fill_the_step_alike_forwards_and_backwards(order):
    steps = splitting(order)
    assert len(steps.flights) == len(steps.kicks) + 1 == EVALUATIONS[order] + 1
    for fractions in (steps.flights, steps.kicks):
        assert sum(fractions) == pytest.approx(1, abs=3e-16)
        assert fractions == fractions[::-1]


@pytest.mark.parametrize(("order", "kicks"), [(2, 1), (4, 6), (6, 10)])
def test_where_kicks_do_not_commute_they_fill_the_step_as_well(order, kicks):
    """Those of order 2 are the same."""
    steps = splitting(order, velocity_dependent=True)
    assert len(steps.flights) == len(steps.kicks) + 1 == kicks + 1
    for fractions in (steps.flights, steps.kicks):
        assert sum(fractions) == pytest.approx(1, abs=3e-16)
        assert fractions == fractions[::-1]
    assert (steps == splitting(order)) == (order == 2)


@each_order
def test_kicks_are_a_quadrature_of_their_order(order):
    """A force that depends on time alone: ``Σ b_i c_iᵏ = 1/(k + 1)`` for k < order, no further."""
    steps = splitting(order)
    times = np.cumsum(steps.flights[:-1])
    gaps = [abs(np.dot(steps.kicks, times**k) - 1 / (k + 1)) for k in range(order + 1)]
    assert max(gaps[:order]) < 1e-14
    assert gaps[order] > 1e-6


@each_order
def test_order_of_the_coefficients_alone(order):
    """On the point of Hénon and Heiles, whose forces are not linear."""

    def run(count):
        q, p = np.array([0.1, -0.3]), np.array([0.4, 0.2])
        steps = splitting(order)
        for _ in range(count):
            for a, b in zip(steps.flights, (*steps.kicks, 0.0), strict=True):
                q = q + a * 4 / count * p
                slope = np.array([q[0] + 2 * q[0] * q[1], q[1] + q[0] ** 2 - q[1] ** 2])
                p = p - b * 4 / count * slope
        return np.concatenate([q, p])

    counts = np.array({2: [40, 80, 160], 4: [40, 80, 160], 6: [10, 20, 40]}[order])
    # One extrapolation more gives the limit.
    coarse, fine = run(640), run(1280)
    exact = fine + (fine - coarse) / (2**order - 1)
    errors = [np.abs(run(count) - exact).max() for count in counts]
    assert order - 0.1 < fitted_order(1 / counts, errors) < order + 0.1


# ---- order of the step ----


@each_order
@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_order_against_the_oracle(prism, held, order):
    equation, u, x, exact = smooth_motion(prism, held)
    step = rattle_step(equation, order)
    counts = np.array({2: [200, 400, 800], 4: [40, 80, 160], 6: [24, 34, 48]}[order])
    errors = [np.abs(march(step, x, u, 1 / n, n)[:18] - exact).max() for n in counts]
    assert order - 0.2 < fitted_order(1 / counts, errors) < order + 0.3
    assert errors[-1] < {2: 1e-4, 4: 1e-6, 6: 3e-9}[order]


@each_order
def test_a_single_step_of_any_length_is_of_full_order(order):
    """Local error of order p + 1 from rest and from motion, as steps that end at switches need."""
    equation, u, x = loaded(1)
    fine, lengths = rattle_step(equation, 6), np.array([0.04, 0.02, 0.01])
    step = rattle_step(equation, order)
    errors = []
    for h in lengths:
        exact = march(fine, x, u, h / 40, 40)
        errors.append(np.abs(march(step, x, u, h, 1) - exact).max())
    assert order + 0.6 < fitted_order(lengths, errors) < order + 1.2


@each_order
def test_supports_points_and_loads_against_another_integrator(order):
    equation, u, x = loaded(4)
    exact = march(rk4(equation), x, u, 1e-4, 5000)
    found = march(rattle_step(equation, order), x, u, 0.5 / 500, 500)
    assert np.abs(exact - x).max() > 0.5
    assert np.abs(found - exact).max() < {2: 2e-2, 4: 1e-6, 6: 1e-9}[order]


@pytest.mark.parametrize("seed", range(3))
def test_loads_and_points_against_the_oracle(seed):
    structure = random_structure(seed, bars=3, points=2)
    gamma = random_force_density(structure, seed)
    load = np.random.default_rng(seed).normal(size=structure.nodes.shape)
    x = moving(structure, seed)
    N, V = (each[:, :, 0] for each in unpack_states(structure, x[:, None]))
    bodies = RigidBars(structure, HeldForceDensity(gamma), load)
    exact = bodies.integrate(N, V, np.array([0.0, 0.5]))[0][:, :, -1]
    equation = tc.Model(structure, external_force=True).equation("force_density", load)
    found = march(rattle_step(equation, 6), x, gamma, 0.5 / 200, 200)[: exact.size]
    np.testing.assert_allclose(found, exact.ravel(order="F"), rtol=0, atol=1e-10)


@each_order
def test_the_order_holds_with_damped_strings(prism, order):
    """Kicks do not commute then, and forces change in them; 4 and 6 have steps back in time."""
    equation, u, x, exact = smooth_motion(prism, "rest_length", damping=1.0)
    step = rattle_step(equation, order)
    counts = np.array({2: [100, 200, 400], 4: [20, 40, 80], 6: [17, 24, 34]}[order])
    errors = [np.abs(march(step, x, u, 1 / n, n)[:18] - exact).max() for n in counts]
    assert order - 0.2 < fitted_order(1 / counts, errors) < order + 0.3
    assert max(bar_errors(prism, march(step, x, u, 1e-2, 100)[:, None])) < 1e-14


@pytest.mark.parametrize("order", [4, 6])
def test_what_depends_on_positions_alone_is_computed_once_a_kick(prism, order):
    """Written out, an evaluation takes little more than the force, with its kick and a flight."""
    equation = tc.Model(prism, strings=tc.LinearStrings(100.0, 1.0)).equation("rest_length")
    count = rattle_evaluations(equation, order)
    assert count == {4: 6 * 4, 6: 10 * 7}[order]
    step = rattle_step(equation, order)
    assert step.n_instructions() < 1.2 * count * equation.force.n_instructions()


# ---- what is kept ----


@each_order
@settings(max_examples=10)
@given(seed=seeds)
def test_bars_of_every_kind_keep_their_lengths(order, seed):
    equation, u, x = loaded(seed)
    states = records(rattle_step(equation, order), x, u, 1e-3, 20, 10)
    stretch, rate = bar_errors(equation.structure, states)
    assert stretch < 1e-13
    assert rate < 1e-12


@each_order
def test_momenta_are_kept(order):
    structure = random_structure(3, bars=3, points=2)
    model, x = tc.Model(structure), moving(structure, 3)
    u = random_force_density(structure, 3)
    states = records(rattle_step(model.equation("force_density"), order), x, u, 5e-3, 20, 50)
    linear, angular = model.momentum.map(20)(states)
    for found, start in zip((linear, angular), model.momentum(x), strict=True):
        assert np.linalg.norm(np.array(start)) > 0.3
        np.testing.assert_allclose(found, np.array(start) @ np.ones((1, 20)), rtol=0, atol=1e-12)


@each_order
def test_steps_back_lead_back(order):
    equation, u, x = loaded(2)
    step = rattle_step(equation, order)
    there = march(step, x, u, 0.01, 30)
    assert np.abs(there - x).max() > 0.5
    np.testing.assert_allclose(march(step, there, u, -0.01, 30), x, rtol=0, atol=1e-11)
    # RK4 does not come back.
    back = march(rk4(equation), march(rk4(equation), x, u, 0.01, 30), u, -0.01, 30)
    assert np.abs(back - x).max() > 1e-7


def symplectic_defect(step, equation, u, x, h):
    """How far a step changes the form ``δqᵀ M δv' − δvᵀ M δq'`` between two tangent vectors.

    Tangent vectors keep ``‖b‖² = l²`` and ``bᵀ ḃ = 0`` to first order.
    """
    structure = equation.structure
    count = len(structure.free)
    M = np.kron(consistent_mass(structure)[np.ix_(structure.free, structure.free)], np.eye(3))
    form = np.block([[np.zeros_like(M), M], [-M, np.zeros_like(M)]])
    at = ca.SX.sym("at", 6 * count)
    free = structure.free.tolist()
    N, V = ca.SX(structure.nodes), ca.SX(*structure.nodes.shape)
    N[:, free], V[:, free] = ca.reshape(at[: 3 * count], 3, -1), ca.reshape(at[3 * count :], 3, -1)
    start, end = structure.bars.T.tolist()
    B, Bd = N[:, end] - N[:, start], V[:, end] - V[:, start]
    held = ca.vertcat(ca.sum1(B * B).T / 2, ca.sum1(B * Bd).T)
    jacobian = ca.Function("held", [at], [ca.densify(ca.jacobian(held, at))])
    tangent = null_space(np.array(jacobian(x)))
    after = step(at, u, np.ones(equation.switches), h)
    moved = np.array(ca.Function("moved", [at], [ca.jacobian(after, at)])(x)) @ tangent
    return np.abs(moved.T @ form @ moved - tangent.T @ form @ tangent).max()


@each_order
def test_the_symplectic_form_is_kept(order):
    equation, u, x = loaded(6)
    assert symplectic_defect(rattle_step(equation, order), equation, u, x, 0.05) < 1e-12
    assert symplectic_defect(rk4(equation), equation, u, x, 0.05) > 1e-7


# ---- long runs ----


@pytest.fixture(scope="module")
def long_run(prism):
    """A million steps of order 2, the paper's prism with held γ, thrown and spinning."""
    model, gamma = tc.Model(prism), paper_force_density(9.0)
    # The centre drifts slowly: far from the origin coordinates have fewer digits.
    equation, x = model.equation("force_density"), moving(prism, 5)
    x[18:] -= np.tile(x[18:].reshape(6, 3).mean(axis=0) - [0.05, -0.1, 0.02], 6)
    step = rattle_step(equation, 2)
    fast = compiled(step)  # to the last bit the same
    states = records(fast or step, x, gamma, 4e-3, 1000, 1000)
    return model, gamma, x, np.column_stack([x, states])


def energies(model, gamma, states):
    count = states.shape[1]
    total = model.kinetic_energy.map(count)(states)
    held = np.repeat(gamma[:, None], count, axis=1)
    return np.array(total + model.potential_energy.map(count)(states, held)).ravel()


def drift(values):
    """Slope of a straight line through the means of 20 blocks, over its standard error."""
    means = values[: len(values) // 20 * 20].reshape(20, -1).mean(axis=1)
    place = np.arange(20) - 9.5
    slope = place @ means / (place @ place)
    rest = means - means.mean() - slope * place
    return slope / np.sqrt(rest @ rest / 18 / (place @ place))


def test_bar_lengths_after_a_million_steps(long_run):
    model, _, _, states = long_run
    stretch, rate = bar_errors(model.structure, states)
    assert stretch < 1e-13
    assert rate < 1e-12


def test_momenta_after_a_million_steps(long_run):
    model, _, x, states = long_run
    for found, start in zip(model.momentum(states[:, -1]), model.momentum(x), strict=True):
        assert np.linalg.norm(np.array(start)) > 0.3
        assert np.abs(np.array(found - start)).max() < 1e-10


def test_energy_does_not_drift_over_a_million_steps_and_rk4_does(long_run):
    model, gamma, x, states = long_run
    energy = energies(model, gamma, states)
    assert np.ptp(energy) < 1e-3 * energy[0]
    assert abs(drift(energy)) < 3
    # RK4 with as many evaluations a second loses energy steadily.
    step = rk4(model.equation("force_density"))
    lost = energies(model, gamma, records(step, x, gamma, 8e-3, 100, 20))
    assert drift(lost) < -10


# ---- pendulum, free spin, hinges ----


@each_order
def test_pendulum_has_the_period_of_the_elliptic_integral(order):
    structure = pendulum(2.5)
    equation = tc.Model(structure, gravity=GRAVITY).equation("force_density")
    small = 2 * np.pi * np.sqrt(2 * LENGTH / (3 * GRAVITY))
    period = small * 2 / np.pi * ellipk(np.sin(1.25) ** 2)
    x = np.concatenate([structure.nodes[:, 1], np.zeros(3)])
    step = rattle_step(equation, order)
    counts = np.array({2: [200, 400, 800], 4: [100, 200, 400], 6: [24, 34, 48]}[order])
    errors = [np.abs(march(step, x, [], period / n, n) - x).max() for n in counts]
    assert order - 0.3 < fitted_order(1 / counts, errors) < order + 0.6
    assert errors[-1] < {2: 1e-2, 4: 1e-6, 6: 1e-10}[order]


def spinning(turn):
    """A free bar that turns by ``turn`` a second about its centre, and its exact place after t."""
    structure = tc.Structure([[-0.5, 0.5], [0, 0], [0, 0]], [[0, 1]], [], 1.0)
    equation = tc.Model(structure).equation("force_density")
    velocities = np.array([[0.0, 0.0], [-0.5 * turn, 0.5 * turn], [0.0, 0.0]])
    x = np.concatenate([structure.nodes.ravel(order="F"), velocities.ravel(order="F")])
    return equation, x, lambda t: 0.5 * np.array([np.cos(turn * t), np.sin(turn * t)])


@pytest.mark.parametrize("turn", [0.0, 1e-6, 0.3, 1.0, 1.99])
def test_a_free_bar_turns_exactly(turn):
    """Order 2 flies twice a step: up to one radian each, the place is exact."""
    equation, x, place = spinning(turn)
    found = march(rattle_step(equation, 2), x, [], 1.0, 1)
    np.testing.assert_allclose(found[3:5], place(1.0), rtol=0, atol=5e-15)
    np.testing.assert_allclose(found[9:11], turn * place(1.0)[::-1] * [-1, 1], rtol=0, atol=1e-14)


@pytest.mark.parametrize("turn", [2.01, 3.5, 6.0, 100.0])
def test_a_step_in_which_a_bar_turns_too_far_gives_no_number(turn):
    equation, x, _ = spinning(turn)
    assert np.isnan(march(rattle_step(equation, 2), x, [], 1.0, 1)[:6]).all()


@each_order
def test_a_step_that_is_too_long_ends_in_nan_and_stays_there(prism, order):
    equation = tc.Model(prism, strings=tc.LinearStrings(1e4)).equation("rest_length")
    step = rattle_step(equation, order)
    states = records(step, moving(prism), 0.9 * prism.string_length(), 0.5, 20, 1)
    finite = np.isfinite(states).all(axis=0)
    assert not finite[-1]
    assert not finite[np.argmin(finite) :].any()


@each_order
def test_half_of_a_free_bar_moves_like_one_that_swings(order):
    """A bar of twice the length and mass in a net with point symmetry keeps its centre at rest."""
    posts = np.array([[1.5, 0.3, 0.2], [0.4, -1.2, 0.7], [-0.3, 0.9, -1.1]])
    tip = np.array([0.6, 0.5, -0.4])
    swing = tc.Structure(
        np.column_stack([np.zeros(3), tip, posts]), [[0, 1]],
        [[1, 2], [3, 1], [1, 4]], 0.7, fixed=[0, 2, 3, 4],
    )  # fmt: skip
    free = tc.Structure(
        np.column_stack([-tip, tip, posts, -posts]), [[0, 1]],
        [[1, 2], [3, 1], [1, 4], [0, 5], [6, 0], [0, 7]], 1.4, fixed=range(2, 8),
    )  # fmt: skip
    gamma, velocity = np.array([9.0, 4.0, 2.0]), np.cross([1.0, -2.0, 3.0], tip)
    ends = []
    for structure, copies in ((swing, [1]), (free, [-1, 1])):
        x = np.concatenate([np.outer(copies, part).ravel() for part in (tip, velocity)])
        step = rattle_step(tc.Model(structure).equation("force_density"), order)
        ends.append(march(step, x, np.tile(gamma, len(copies)), 0.02, 50))
    alone, pair = ends
    np.testing.assert_allclose(pair[3:6], alone[:3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(pair[9:], alone[3:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(pair[:3], -pair[3:6], rtol=0, atol=1e-12)


def test_without_bars_order_two_is_that_of_stoermer_and_verlet():
    structure = tc.Structure(np.eye(3), [], [[0, 1], [1, 2]], [], string_node_mass=0.5, fixed=[2])
    equation = tc.Model(structure, gravity=GRAVITY).equation("force_density")
    q, v, gamma, h = np.eye(3)[:, :2], np.ones((3, 2)), np.array([3.0, 7.0]), 0.1
    x = np.concatenate([q.ravel(order="F"), v.ravel(order="F")])
    q = q + h / 2 * v
    pull = gamma * np.diff(np.column_stack([q, [0, 0, 1]]), axis=1)
    force = np.column_stack([pull[:, 0], pull[:, 1] - pull[:, 0]])
    v = v + h * (force / 0.5 - [[0], [0], [GRAVITY]])
    q = q + h / 2 * v
    found = march(rattle_step(equation, 2), x, gamma, h, 1)
    expected = np.concatenate([q.ravel(order="F"), v.ravel(order="F")])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


# ---- how it is built ----


@pytest.mark.parametrize(("order", "damping"), [(2, 0.0), (2, 0.5), (4, 0.0), (6, 0.0)])
def test_forces_are_evaluated_as_often_as_is_said(prism, order, damping):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping))
    equation = model.equation("rest_length")
    calls = EVALUATIONS[order] * (2 if damping else 1)
    assert rattle_evaluations(equation, order) == calls
    step = rattle_step(equation, order, ca.MX)
    kinds = [step.instruction_id(k) for k in range(step.n_instructions())]
    assert kinds.count(ca.OP_CALL) == calls


@each_order
def test_both_kinds_of_symbols_give_the_same_step(order):
    equation, u, x = loaded(7)
    found = [march(rattle_step(equation, order, kind), x, u, 0.02, 1) for kind in (ca.SX, ca.MX)]
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-14)


@each_order
def test_work_grows_linearly_with_the_members(prism, order):
    counts = []
    for copies in (2, 3, 4):
        model = tc.Model(side_by_side(prism, copies))
        equation = model.equation("force_density", form="flat")
        counts.append(rattle_step(equation, order).n_instructions())
    assert counts[2] - counts[1] == counts[1] - counts[0]


@pytest.mark.parametrize("order", [1, 3, 8, "4"])
def test_another_order_is_refused(prism, order):
    with pytest.raises(ValueError, match=r"order is .*, expected 2, 4 or 6"):
        rattle_step(tc.Model(prism).equation("force_density"), order)


def test_an_equation_without_a_structure_is_refused():
    with pytest.raises(ValueError, match="the equation has no structure"):
        rattle_step(smooth_equation(oscillator()), 2)
