"""Shape control: the law that it imposes, the least squares that it solves, what it reports."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import lsq_linear

import tenscontrol as tc
from tenscontrol.control import Status
from tenscontrol.control.feedback_linearization import error_rates, rounded_up
from tenscontrol.control.held_loop import held_error_rate
from tenscontrol.plant.reduced_dynamics import tracked_motion

FREE = 300.0  # N/m, never reached


@cache
def plant(coordinates="internal", **options):
    model = tc.Model(tc.prism(**options))
    rest = tc.prestress(model.structure, force_density=17.320508)
    return tc.linearize(model, rest, coordinates=coordinates)


def heights():
    """Heights of the top nodes above the bottom ones: strings pull in all three directions."""
    rows = np.zeros((3, 3, 6))
    for i in range(3):
        rows[i, 2, [i, 3 + i]] = 1, -1
    return rows.transpose(0, 2, 1).reshape(3, 18)


def disturbed(seed, size=0.01, coordinates="internal"):
    rng = np.random.default_rng(seed)
    at, r = plant(coordinates), plant(coordinates).degrees_of_freedom
    q, rates = size * rng.normal(size=r), 5 * size * rng.normal(size=r)
    return at.to_nodes(q), at.to_velocities(q, rates)


def path(duration=1.0):
    """Prisms from 1 m to 0.9 m."""
    length = tc.prism().bar_length[0]
    share = np.linspace(0.0, 1.0, 41)
    drop = 0.1 * (10 * share**3 - 15 * share**4 + 6 * share**5)
    shapes = [
        tc.prism(radius=tc.structure.prism_radius(length, h), height=h).nodes for h in 1.0 - drop
    ]
    return tc.Reference(duration * share, np.stack(shapes, axis=-1))


def linear_system(law, time, N, V, C):
    """J and d of ``J γ = d`` from the accelerations of the model, one column a force density."""
    acceleration = law.plant.model.acceleration
    columns = [
        C @ np.array(acceleration(N, V, gamma)).ravel(order="F")
        for gamma in np.vstack([np.zeros(9), np.eye(9)])
    ]
    J = np.column_stack(columns[1:]) - columns[0][:, None]
    E, rate = law.error(time, N, V)
    a, b = law.rates
    return J, -a * rate - b * E - columns[0]


@pytest.mark.parametrize("coordinates", ["internal", "minimal"])
def test_tracked_motion_is_that_of_the_nodes(coordinates):
    at, (N, V) = plant(coordinates), disturbed(1, 0.02, coordinates)
    C = np.random.default_rng(2).normal(size=(4, 18))
    gamma = np.random.default_rng(3).uniform(0, 40, 9)
    z = at.measure(N, V)
    y, rate, free, J = (np.array(part) for part in tracked_motion(at, C)(z))
    moved = np.array(at.model.acceleration(N, V, gamma)).ravel(order="F")
    # In minimal coordinates nodes are where they are; in internal ones they have not turned here.
    np.testing.assert_allclose(y.ravel(), C @ N.ravel(order="F"), atol=1e-12)
    np.testing.assert_allclose(rate.ravel(), C @ V.ravel(order="F"), atol=1e-12)
    np.testing.assert_allclose(free.ravel() + J @ gamma, C @ moved, atol=1e-9)


def error_after(law, N, V, duration, model):
    """The error at the end of a run with γ held, and as the law has it in closed form."""
    run = tc.simulate(
        model, duration, nodes=N, velocities=V, controller=law, input="force_density",
        method="dop853", tolerance=1e-10, output_step=duration,
    )  # fmt: skip
    assert set(run.control.status) == {"ok"}
    np.testing.assert_allclose(run.momentum[:, -1], run.momentum[:, 0], atol=1e-9)
    start = np.stack(law.error(0.0, N, V))
    a, b = law.rates
    exact = expm(duration * np.array([[0, 1], [-b, -a]])) @ start
    E, _ = law.error(duration, run.nodes[:, :, -1], run.velocities[:, :, -1])
    return np.abs(E - exact[0]).max(), np.abs(exact[0]).max()


@pytest.mark.parametrize("moving", [False, True])
def test_errors_decay_as_the_law_says_to_first_order(moving):
    at = plant()
    N, V = disturbed(4, 0.003)
    steps, off = np.array([0.02, 0.01, 0.005, 0.0025]), []
    for step in steps:
        law = tc.FeedbackLinearization(
            at,
            reference=path() if moving else None,
            sample_time=step,
            max_force_density=FREE,
            frequency=0.8,
            tracked=heights(),
            regularization=1e-6,
        )
        missed, size = error_after(law, N, V, 0.4, at.model)
        off.append(missed)
    order = np.polyfit(np.log(steps), np.log(off), 1)[0]
    assert 0.9 < order < 1.2
    assert off[-1] < 0.05 * size


@pytest.mark.parametrize("limit", [FREE, 30.1])
def test_the_command_is_the_bounded_least_squares(limit):
    at = plant()
    bounded = 0
    for seed in range(8):
        law = tc.FeedbackLinearization(
            at,
            reference=None,
            sample_time=0.02,
            max_force_density=limit,
            frequency=1.5,
            tracked=heights(),
        )
        N, V = disturbed(seed, 0.02)
        J, d = linear_system(law, 0.0, N, V, heights())
        command = law.command(0.0, N, V)
        level, held = 30.0, at.force_density
        unit = level * np.linalg.norm(linear_system(law, 0.0, at.nodes, 0 * V, heights())[0], 2)
        A = np.vstack([J * level / unit, 1e-2 * np.eye(9)])
        rhs = np.r_[d / unit, 1e-2 * held / level]
        oracle = level * lsq_linear(A, rhs, (0, limit / level), tol=1e-14).x
        np.testing.assert_allclose(command.value, oracle, atol=2e-3)
        # KKT: the gradient vanishes, or pushes against a bound.
        gradient = A.T @ (A @ (command.value / level) - rhs)
        up, down = command.value >= limit - 1e-5, command.value <= 1e-5
        assert np.abs(gradient[~up & ~down]).max(initial=0.0) < 1e-6
        assert gradient[up].max(initial=-1.0) < 1e-6
        assert gradient[down].min(initial=1.0) > -1e-6
        statistics = law.statistics
        assert statistics.residual[0] == pytest.approx(np.abs(J @ command.value - d).max())
        assert statistics.residual[0] >= statistics.unbounded_residual[0] - 1e-4
        assert statistics.at_bound[0] == (up | down).sum()
        bounded += statistics.at_bound[0] > 0
    assert bounded == (0 if limit == FREE else 8)


def test_what_bounds_leave_unreached_is_reported():
    at = plant()
    length = at.model.structure.bar_length[0]
    far = tc.prism(radius=tc.structure.prism_radius(length, 0.8), height=0.8).nodes
    found, status = {}, {}
    for limit in (FREE, 30.5):
        law = tc.FeedbackLinearization(
            at,
            reference=far,
            sample_time=0.02,
            max_force_density=limit,
            frequency=5.0,
            tracked=heights(),
        )
        status[limit] = str(law.command(0.0, at.nodes, np.zeros((3, 6))))
        found[limit] = law.statistics
    assert status[FREE] == "ok"
    assert found[FREE].status_count == {"ok": 1}
    assert found[FREE].at_bound[0] == 0
    # Nothing pulls the prism together but the vertical strings: all others are slack.
    left = found[30.5].largest_residual
    assert left > 10.0
    assert status[30.5] == f"{Status.UNREACHED}: off by up to {rounded_up(left)} m/s^2"
    assert found[30.5].status_count == {Status.UNREACHED: 1}
    assert found[30.5].at_bound[0] == 9
    for each in found.values():
        assert each.unbounded_residual[0] < 1e-3 * left


def test_a_mechanism_is_out_of_reach_without_any_bound():
    law = tc.FeedbackLinearization(
        plant(), reference=None, sample_time=0.02, max_force_density=FREE, frequency=1.0
    )
    N, V = disturbed(3, 0.01)
    assert law.command(0.0, N, V).status is Status.UNREACHED
    found = law.statistics
    assert found.at_bound[0] == 0
    assert found.residual[0] == pytest.approx(found.unbounded_residual[0], rel=1e-3)
    assert found.residual[0] > 0.01


def test_at_rest_on_the_reference_nothing_changes():
    at = plant()
    law = tc.FeedbackLinearization(
        at, reference=None, sample_time=0.02, max_force_density=FREE, frequency=1.0
    )
    command = law.command(0.0, at.nodes, np.zeros((3, 6)))
    assert command.status == "ok"
    np.testing.assert_allclose(command.value, at.force_density, atol=1e-4)


@pytest.mark.parametrize("frequency", [0.5, 2.0, 7.9, 8.1, 20.0])
@pytest.mark.parametrize("damping", [0.05, 0.1, 1.0, 3.0])
def test_errors_that_would_grow_are_refused(frequency, damping):
    step, omega = 0.02, 2 * np.pi * frequency
    a, b = 2 * damping * omega, omega**2
    held = expm(step * np.array([[0.0, 1, 0], [0, 0, 1], [0, 0, 0]]))[:2]
    sampled = held[:, :2] - held[:, 2:] @ np.array([[b, a]])
    if np.abs(np.linalg.eigvals(sampled)).max() < 1:
        assert error_rates(frequency, damping, step) == pytest.approx((a, b))
    else:
        with pytest.raises(ValueError, match=r"in samples of 0\.02 s the error would grow"):
            error_rates(frequency, damping, step)


def test_changes_of_force_density_are_limited():
    at = plant()
    N, V = disturbed(3, 0.02)
    law = tc.FeedbackLinearization(
        at,
        reference=None,
        sample_time=0.02,
        max_force_density=FREE,
        frequency=1.5,
        tracked=heights(),
        max_change=0.25,
    )
    first = law.command(0.0, N, V)
    assert np.abs(first.value - at.force_density).max() == pytest.approx(0.25)
    assert first.status is Status.UNREACHED
    second = law.command(0.02, N, V)
    assert np.abs(second.value - first.value).max() == pytest.approx(0.25)
    lost = law.command(0.04, np.full((3, 6), np.nan), V)
    assert np.abs(lost.value - second.value).max() <= 0.25 + 1e-12
    law.reset()
    np.testing.assert_allclose(law.command(0.0, N, V).value, first.value, atol=1e-5)
    assert len(law.statistics.residual) == 1


def test_what_cannot_be_decided_holds_the_equilibrium():
    at = plant()
    N, V = disturbed(3, 0.02)
    law = tc.FeedbackLinearization(
        at, reference=None, sample_time=0.02, max_force_density=FREE, frequency=1.5
    )
    wrong = N.copy()
    wrong[0, 0] = np.nan
    command = law.command(0.0, wrong, V)
    assert str(command) == "measurement not finite: equilibrium held"
    np.testing.assert_array_equal(command.value, at.force_density)
    lost = tc.FeedbackLinearization(
        at,
        reference=None,
        sample_time=0.02,
        max_force_density=FREE,
        frequency=1.5,
        tracked=heights(),
        max_iterations=1,
    )
    command = lost.command(0.0, N, V)
    assert str(command) == "out of iterations: equilibrium held"
    np.testing.assert_array_equal(command.value, at.force_density)
    absurd = law.command(0.0, at.nodes + 3.0 * np.random.default_rng(0).normal(size=(3, 6)), V)
    assert str(absurd) == "measurement not plausible: equilibrium held"
    assert np.isnan(law.statistics.residual).all()
    assert law.statistics.largest_residual == 0.0
    assert len(law.statistics.residual) == 2
    assert law.command(0.0, N, V).status != command.status  # and goes on


def test_a_fixed_structure_under_load_holds_its_place():
    prism = replace(tc.prism(), fixed=[3, 4, 5])
    forces = np.zeros((3, 6))
    forces[2, :3] = -2.0
    model = tc.Model(prism, external_force=forces, gravity=9.81)
    at = tc.linearize(
        model, tc.OperatingPoint(prism.nodes, tc.prestress(tc.prism(), 17.320508).force_density,
                                 model.constant_force),
        require_equilibrium=False,
    )  # fmt: skip
    rows = np.zeros((3, 18))
    rows[range(3), [2, 5, 8]] = 1.0
    law = tc.FeedbackLinearization(
        at, reference=None, sample_time=0.01, max_force_density=FREE, frequency=1.0, tracked=rows
    )
    run = tc.simulate(model, 1.0, controller=law, method="dop853", output_step=0.1)
    assert set(run.control.status) == {"ok"}
    assert np.abs(run.nodes[2, :3] - 1.0).max() < 1e-4
    # Strings hold what the loads are: without control the top nodes fall.
    fallen = tc.simulate(model, 0.2, force_density=at.force_density, method="dop853")
    assert fallen.nodes[2, :3, -1].max() < 0.95


def test_one_string_lifts_a_bar():
    hinged = tc.Structure(
        nodes=[[0, 1, 1], [0, 0, 0], [0, 0, 1]], bars=[[0, 1]], strings=[[1, 2]], bar_mass=1.0,
        fixed=[0, 2],
    )  # fmt: skip
    model = tc.Model(hinged, gravity=9.81)
    rest = tc.prestress(hinged, [9.81 / 2], external_force=model.constant_force)
    at = tc.linearize(model, rest, coordinates="minimal")
    row = np.zeros((1, 9))
    row[0, 5] = 1.0
    law = tc.FeedbackLinearization(
        at, reference=None, sample_time=0.01, max_force_density=50.0, frequency=1.0, tracked=row
    )
    assert law.statistics.largest_residual == 0.0
    start = at.to_nodes(np.full(at.degrees_of_freedom, 0.05))
    run = tc.simulate(model, 1.0, nodes=start, controller=law, step=1e-3)
    assert set(run.control.status) == {"ok"}
    assert abs(start[2, 1]) > 0.02
    assert abs(run.nodes[2, 1, -1]) < 0.05 * abs(start[2, 1])


def test_segments_of_a_string_pull_alike():
    massive = tc.subdivide(tc.prism(), segments=2, node_mass=0.01)
    model = tc.Model(massive)
    gamma = tc.structure.spread_force_density(
        massive, tc.prestress(tc.prism(), 17.320508).force_density
    )
    at = tc.plant.command_parents(
        tc.linearize(model, tc.OperatingPoint(massive.nodes, gamma, np.zeros(massive.nodes.shape)))
    )
    C = np.random.default_rng(2).normal(size=(4, massive.nodes.size))
    free, J = (np.array(part) for part in tracked_motion(at, C)(np.zeros(len(at.A)))[2:])
    wanted = np.random.default_rng(3).uniform(0, 40, 9)
    moved = model.acceleration(
        massive.nodes,
        np.zeros(massive.nodes.shape),
        tc.structure.spread_force_density(massive, wanted),
    )
    assert J.shape == (4, 9)
    np.testing.assert_allclose(
        free.ravel() + J @ wanted, C @ np.array(moved).ravel(order="F"), atol=1e-8
    )
    law = tc.FeedbackLinearization(
        at, reference=None, sample_time=0.01, max_force_density=FREE, frequency=1.0
    )
    assert law.command(0.0, massive.nodes, np.zeros(massive.nodes.shape)).value.shape == (9,)


def test_the_reference_is_followed_anew():
    at = plant()
    law = tc.FeedbackLinearization(
        at,
        reference=None,
        sample_time=0.02,
        max_force_density=FREE,
        frequency=1.0,
        tracked=heights(),
    )
    moving = path()
    law.follow(moving)
    E, _ = law.error(0.5, moving.nodes[:, :, 20], np.zeros((3, 6)))
    assert np.abs(E).max() < 1e-12
    E, rate = law.error(2.0, moving.nodes[:, :, -1], np.zeros((3, 6)))
    assert max(np.abs(E).max(), np.abs(rate).max()) < 1e-12
    _, rate = law.error(0.5, moving.nodes[:, :, 20], np.zeros((3, 6)))
    np.testing.assert_allclose(rate, 0.1 * 1.875, rtol=1e-3)  # peak of the quintic: 15/8


def test_numbers_are_rounded_up_to_few():
    assert [rounded_up(x) for x in (0.011, 0.02, 0.021, 0.0501, 3.0, 999.0)] == [
        "0.02", "0.02", "0.05", "0.1", "5", "1000",
    ]  # fmt: skip


@pytest.mark.parametrize(("stiffness", "frequency"), [(100.0, 0.5), (100.0, 2.0), (1e3, 2.0)])
def test_held_rest_lengths_slow_errors_down_as_foretold(stiffness, frequency):
    prism, step = tc.prism(), 0.01
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness))
    at = tc.linearize(model, tc.prestress(prism, 17.320508))
    omega = 2 * np.pi * frequency
    # All three heights alike: the motion in which strings are stretched the most.
    row = heights().mean(axis=0)[None]
    ratio = held_error_rate(at, row, (2 * omega, omega**2), step)
    law = shape_control_of_winches(at, row, frequency, step, ratio < 0.25)
    start = tc.prism(radius=tc.structure.prism_radius(prism.bar_length[0], 0.99), height=0.99).nodes
    run = tc.simulate(model, 3.0 / omega / ratio, nodes=start, controller=law, step=step / 10)
    E = [
        np.abs(law.error(0.0, run.nodes[:, :, k], run.velocities[:, :, k])[0]).max()
        for k in (len(run.time) // 2, -1)
    ]
    found = np.log(E[0] / E[1]) / (run.time[-1] - run.time[len(run.time) // 2]) / omega
    assert 0.5 * ratio < found < 1.5 * ratio


def shape_control_of_winches(at, row, frequency, step, slow):
    if not slow:
        return tc.FeedbackLinearization(
            at,
            reference=None,
            sample_time=step,
            max_force_density=80.0,
            frequency=frequency,
            tracked=row,
        )
    with pytest.warns(RuntimeWarning, match="errors decay at [0-9]+ % of the rate asked for"):
        return tc.FeedbackLinearization(
            at,
            reference=None,
            sample_time=step,
            max_force_density=80.0,
            frequency=frequency,
            tracked=row,
        )
