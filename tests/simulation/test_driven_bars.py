"""Bars whose lengths are driven: closed forms, an oracle with multipliers, work, refusals."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import tenscontrol as tc
from tenscontrol.simulation.strut_record import driven_bar_forces
from tests.benchmarks.driven_bars import GRAVITY, SPIN, hoist, swinging
from tests.known_structures import class2_tower, d_bar
from tests.oracle import free_rows, node_acceleration
from tests.without_core import without_core

MASS = 2.0


@pytest.fixture(scope="module")
def rod():
    """A free bar of 1 m."""
    return tc.Model(tc.Structure([[-0.5, 0.5], [0, 0], [0, 0]], [(0, 1)], [], MASS))


@pytest.fixture(scope="module")
def spinning(rod):
    """A rod that spins while it is made longer and shorter."""
    return tc.simulate(
        rod, 2.0, velocities=_spin(rod), bar_length=_swelling, method="dop853", tolerance=1e-12
    )


def _spin(rod):
    return np.cross([0, 0, SPIN], rod.structure.nodes.T).T


def _swelling(time):
    return [1 + 0.3 * (1 - np.cos(2 * time))]


def _turning(run):
    b, rate = (array[:, 1] - array[:, 0] for array in (run.nodes, run.velocities))
    return np.cross(b.T, rate.T)[:, 2] / (b**2).sum(axis=0)


def test_a_spinning_rod_turns_by_the_inverse_square_of_its_length(spinning):
    """ω L² is constant, and so is the angular momentum."""
    length = np.array([_swelling(time)[0] for time in spinning.time])
    np.testing.assert_allclose(_turning(spinning), SPIN / length**2, rtol=1e-10)
    momentum = spinning.angular_momentum[2]
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-10)
    assert np.abs(spinning.nodes[:, 1] - spinning.nodes[:, 0]).max() > 1.5
    assert spinning.health.bar_length_error < 1e-14
    assert spinning.error.max() < 1e-9


def test_work_of_the_drive_is_the_change_of_energy(spinning):
    gained = spinning.kinetic_energy - spinning.kinetic_energy[0]
    np.testing.assert_allclose(spinning.struts.work.sum(axis=0), gained, atol=1e-9)
    # λ L of a uniform rod: inertia of its stretching less that of its turning, along it.
    length, _, acceleration = (getattr(spinning.struts, name)[0] for name in
                               ("length", "rate", "acceleration"))  # fmt: skip
    force = MASS / 12 * (acceleration - length * _turning(spinning) ** 2)
    np.testing.assert_allclose(spinning.bar_force[0], force, atol=1e-9)


def test_a_swinging_rod_of_changing_length_obeys_its_own_equation():
    """θ̈ = −2 L̇/L θ̇ − 3 g/(2 L) sin θ."""
    pendulum, true = swinging(2.0)

    def off(**how):
        how = {"bar_length": lambda t: [hoist(t)], "error": "none"} | how
        run = tc.simulate(pendulum, 2.0, **how)
        angle = np.arctan2(run.nodes[0, 1], -run.nodes[1, 1])
        return run, np.abs(angle[::8] - true(run.time[::8])[0]).max()

    run, error = off(method="dop853", tolerance=1e-12)
    assert error < 1e-9
    np.testing.assert_allclose(run.struts.work[0], run.energy - run.energy[0], atol=1e-8)
    (few, coarse), (many, fine) = off(step=0.02, error="estimate"), off(step=0.005)
    wrong = np.abs(few.struts.work - CubicSpline(run.time, run.struts.work[0])(few.time)).max()
    assert wrong < few.struts.work_error.max() < 5 * wrong
    assert 3.85 < np.log(coarse / fine) / np.log(many.steps / few.steps) < 4.4  # ends of pieces
    assert off(method="cvodes", tolerance=1e-10)[1] < 1e-7


KINDS = {
    "alone": tc.prism,
    "on supports": lambda: replace(tc.prism(), fixed=[3, 4, 5]),
    "coupled": d_bar,
    "tower": lambda: class2_tower(2),
}


@pytest.mark.parametrize("form", ["flat", "mapped"])
@pytest.mark.parametrize("kind", KINDS)
def test_accelerations_and_bar_forces_are_those_of_multipliers(kind, form):
    structure, random = KINDS[kind](), np.random.default_rng(3)
    nodes, rows = structure.nodes.copy(), free_rows(structure)
    velocities = np.zeros_like(nodes)
    velocities.T.flat[rows] = random.standard_normal(len(rows))
    gamma = random.uniform(5, 20, len(structure.strings))
    beta = len(structure.bars)
    coefficients = np.zeros((len(gamma) + beta, 4))
    coefficients[: len(gamma), 0] = gamma
    coefficients[len(gamma) :] = random.uniform(0.5, 1.5, (beta, 4))
    model = tc.Model(structure, gravity=GRAVITY)
    equation = model.equation("force_density", form=form, degree=3, length_input=True)
    time = 0.3
    u = equation.layout.packed(coefficients, time)
    powers = np.array([[time**k for k in range(4)], [k * time ** max(k - 1, 0) for k in range(4)],
                       [0, 0, 2, 6 * time]])  # fmt: skip
    length, rate, acceleration = powers @ coefficients[len(gamma) :].T
    extension = length * acceleration + rate**2
    x = np.concatenate([nodes.T.ravel()[rows], velocities.T.ravel()[rows]])
    slope = np.array(equation.slope(x, u, [])).ravel()
    true, lam = node_acceleration(
        structure, nodes, velocities, gamma, model.constant_force, extension
    )
    np.testing.assert_allclose(slope[len(rows) :], true.T.ravel()[rows], rtol=1e-10, atol=1e-9)
    columns = [array.T.reshape(-1, 1) for array in (nodes, velocities, model.constant_force)]
    driven = tuple(array[:, None] for array in (length, rate, acceleration))
    held = "force_density", gamma[:, None]
    found = driven_bar_forces(model, *columns[:2], held, columns[2], driven)
    np.testing.assert_allclose(found[:, 0], lam, rtol=1e-10, atol=1e-9)


@pytest.fixture(scope="module")
def swelling_tower():
    """A tower of two stages with joined bars that grow in a ramp, its strings going slack."""
    structure = class2_tower(2)
    model = tc.Model(structure, tc.LinearStrings(stiffness=200.0))
    rest = structure.string_length() * 0.98
    longer = structure.bar_length * np.where(np.arange(len(structure.bars)) < 3, 1.05, 1.0)
    ramp = tc.Profile([0.1, 0.3], np.column_stack([structure.bar_length, longer]))
    return tc.simulate(model, 0.5, rest_length=rest, bar_length=ramp, tolerance=1e-10)


def test_impulses_at_kinks_do_their_work(swelling_tower):
    """Joined bars, of which three grow in a ramp: rates jump at its ends."""
    run = swelling_tower
    assert list(run.struts.bar) == [0, 1, 2]
    assert run.work.switches > 0
    gained = run.energy - run.energy[0]
    np.testing.assert_allclose(run.struts.work.sum(axis=0), gained, atol=1e-6 * gained.max())
    assert run.health.bar_length_error < 1e-10
    assert np.ptp(run.momentum, axis=1).max() < 1e-10
    assert np.ptp(run.angular_momentum, axis=1).max() < 1e-9
    assert run.error.max() < 1e-6
    assert np.abs(run.struts.work.sum(axis=0) - gained).max() < run.struts.work_error.sum()
    assert "bars 0, 1, 2: stroke" in run.summary()


def test_a_run_goes_on_and_is_kept_in_a_file(swelling_tower, tmp_path):
    """A file has all of it; a run that goes on holds the lengths that bars have."""
    saved = tc.load_run(swelling_tower.save(tmp_path / "run.npz"))
    assert saved.summary() == swelling_tower.summary()
    np.testing.assert_array_equal(saved.struts.work, swelling_tower.struts.work)
    np.testing.assert_array_equal(saved.bar_force, swelling_tower.bar_force)
    more = tc.simulate(saved.model, 0.05, start=saved, tolerance=1e-8)
    held = swelling_tower.struts.length[:, -1]
    np.testing.assert_allclose(more.struts.length, np.broadcast_to(held[:, None], (6, 1001)))
    assert more.health.bar_length_error < 1e-10
    assert not len(more.struts.bar)
    assert not more.struts.work.any()


def test_velocities_at_the_start_are_those_before_a_jump(rod):
    """A rod whose ends are sent off at once, each at half of the rate, and stopped later."""
    ramp = tc.Profile([0.0, 1.0], [[1.0, 1.5]])
    run = tc.simulate(rod, 0.1, velocities=_spin(rod), bar_length=ramp, tolerance=1e-10)
    np.testing.assert_allclose(run.velocities[0, :, 0], [-0.25, 0.25], atol=1e-15)
    on = tc.simulate(rod, 0.1, bar_length=[1.05], start=run, tolerance=1e-10)
    np.testing.assert_allclose(_turning(on), SPIN / 1.05**2, rtol=1e-9)
    assert on.conserves_energy
    assert on.health.energy_error < 1e-9
    same = tc.simulate(rod, 0.1, bar_length=1.0, step=0.01)
    assert same.struts is None  # nothing is driven


@pytest.mark.parametrize("back_end", ["core", "virtual machine"])
def test_a_rod_hangs_from_a_hinge_that_moves(back_end):
    """θ̈ = −2 L̇/L θ̇ − 3/(2 L) ((g + ÿ) sin θ + ẍ cos θ), and m/2 (a + g) e + m/3 (L̈ − L θ̇²)."""
    pendulum, _ = swinging(1.0)
    step = 1e-4

    def hinge(time):
        return np.array([[0.1 * np.sin(3 * time)], [0.05 * (1 - np.cos(5 * time))]])

    def pushed(time):
        return np.array([-0.9 * np.sin(3 * time), GRAVITY + 1.25 * np.cos(5 * time)])

    def slope(time, y):
        rate = (hoist(time + step) - hoist(time - step)) / (2 * step)
        x, up = pushed(time)
        turned = 1.5 / hoist(time) * (up * np.sin(y[0]) + x * np.cos(y[0]))
        return [y[1], -2 * rate / hoist(time) * y[1] - turned]

    with nullcontext() if back_end == "core" else without_core():
        run = tc.simulate(
            pendulum, 1.0, bar_length=lambda t: [hoist(t)], support_motion=hinge, method="dop853",
            tolerance=1e-11, error="none",
        )  # fmt: skip
    b, moving = (array[:, 1] - array[:, 0] for array in (run.nodes, run.velocities))
    length = np.linalg.norm(b, axis=0)
    angle, turning = np.arctan2(b[0], -b[1]), (b[0] * moving[1] - b[1] * moving[0]) / length**2
    true = solve_ivp(slope, (0, 1), [angle[0], turning[0]], "DOP853", run.time, rtol=1e-11,
                     atol=1e-12)  # fmt: skip
    assert np.abs(angle - true.y[0]).max() < 2e-8  # as exact as the rate by differences
    inertia = MASS / 3 * (run.struts.acceleration[0] - length * turning**2)
    force = MASS / 2 * (pushed(run.time) * b / length).sum(axis=0) + inertia
    np.testing.assert_allclose(run.struts.force[0], force, atol=1e-9)
    work = CubicSpline(run.time, force * run.struts.rate[0]).antiderivative()
    np.testing.assert_allclose(run.struts.work[0], work(run.time), atol=1e-8)


def test_a_hinge_that_jumps_off_pushes_on_a_rod_that_grows():
    """By Δθ̇ = −3/(2 L) (Δẏ sin θ + Δẋ cos θ), and the drive takes m/2 Δv e L̇."""
    pendulum, _ = swinging(1.0)
    grown = tc.Profile([0.0, 1.0], [[hoist(0.0), 1.5]])
    rate, off = 1.5 - hoist(0.0), np.array([0.4, -0.3])
    hinge = tc.Profile([0.0, 0.5, 1.0], np.outer(off, [0.0, 1.0, 2.5])[:, None])  # 2 off, 3 off
    run = tc.simulate(
        pendulum, 1.0, bar_length=grown, support_motion=hinge, tolerance=1e-11, error="none"
    )

    def slope(time, y):
        length = hoist(0.0) + rate * time
        along = MASS / 2 * GRAVITY * -np.cos(y[0]) - MASS / 3 * length * y[1] ** 2
        turned = -2 * rate / length * y[1] - 1.5 * GRAVITY / length * np.sin(y[0])
        return [y[1], turned, along * rate]

    b, moving = (array[:, 1, 0] - array[:, 0, 0] for array in (run.nodes, run.velocities))
    y = np.array([np.arctan2(b[0], -b[1]), (b[0] * moving[1] - b[1] * moving[0]) / (b @ b), 0.0])
    for span in ((0.0, 0.5), (0.5, 1.0)):
        y = solve_ivp(slope, span, y, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        if span[0] == 0.0:
            across, along = (np.array([np.cos(y[0]), np.sin(y[0])]),
                             np.array([np.sin(y[0]), -np.cos(y[0])]))  # fmt: skip
            y -= [0.0, 1.5 / (hoist(0.0) + rate / 2) * (off @ across), 0.0]
            y += [0.0, 0.0, MASS / 2 * (off @ along) * rate]
    b = run.nodes[:, 1, -1] - run.nodes[:, 0, -1]
    np.testing.assert_allclose([np.arctan2(b[0], -b[1]), run.struts.work[0, -1]], y[[0, 2]],
                               atol=1e-9)  # fmt: skip


def test_drives_beside_supports_that_move_apart():
    """Core and virtual machine agree, and the work is the integral of the power."""
    structure = replace(tc.prism(), fixed=[3, 4, 5])
    model = tc.Model(structure, tc.LinearStrings(300.0, damping=2.0))
    moved = np.zeros((3, 3, 3))
    moved[:, :, 1:] = 0.02 * np.random.default_rng(0).normal(size=(3, 3, 2))
    how = {
        "rest_length": 0.95 * structure.string_length(), "tolerance": 1e-9, "error": "none",
        "support_motion": tc.Profile([0.0, 0.05, 0.2], moved),
        "bar_length": tc.Profile([0.0, 0.2], np.outer(structure.bar_length, [1.0, 1.02])),
    }  # fmt: skip
    run = tc.simulate(model, 0.2, **how)
    with without_core():
        other = tc.simulate(model, 0.2, **how)
    for name in ("force", "work"):
        found, true = (getattr(each.struts, name) for each in (other, run))
        np.testing.assert_allclose(found, true, atol=1e-10 * np.abs(true).max())
    power = run.struts.power[:, run.time > 0.0501]
    between = CubicSpline(run.time[run.time > 0.0501], power, axis=1).integrate(0.06, 0.2)
    work = CubicSpline(run.time, run.struts.work, axis=1)
    np.testing.assert_allclose(work(0.2) - work(0.06), between, atol=1e-6)


REFUSED = {
    "length": ({"bar_length": [1.1]}, "in nodes, bar 0 is 1 m long, but bar_length begins at 1.1"),
    "jump": ({"bar_length": tc.Profile([0.0, 0.5], [[1.0, 2.0]], "hold")}, "jumps by 1 m at 0.5 s"),
    "sign": ({"bar_length": tc.Profile([0.0, 1.0], [[1.0, -1.0]])}, "falls to -1 m at 1 s"),
    "shape": ({"bar_length": tc.Profile([0.0, 1.0], [[1.0, 1.0]] * 2)}, "expected \\(1,\\)"),
    "sections": ({"limits": "sections"}, "sections, whose buckling"),
    "method": ({"method": "energy_momentum", "step": 0.01}, "takes bars of constant length"),
    "controller": ({"controller": lambda t, N, V: []}, "does not go with controller"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_by_name(rod, case):
    given, message = REFUSED[case]
    grow = tc.Profile([0.0, 1.0], [[1.0, 2.0]])
    given = {"bar_length": grow} | given
    if given.get("limits") == "sections":
        steel = tc.sizing.Material(2e11, 7850.0, 2.5e8)
        areas = {"bar_area": 1e-4, "string_area": 1e-6}
        sections = tc.sizing.sections(rod.structure, bars=steel, strings=steel, **areas)
        given["limits"] = tc.HealthLimits(sections=sections)
    with pytest.raises(ValueError, match=message):
        tc.simulate(rod, 1.0, **given)


def test_bars_that_cannot_be_driven_are_refused():
    nodes = [[0, 1, 1, 0], [0, 0, 1, 1]]
    square = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]
    body = tc.Model(tc.Structure(nodes, square, [], MASS))
    long = 1.01 * body.structure.bar_length
    with pytest.raises(ValueError, match="more bars than a rigid body needs"):
        tc.simulate(body, 1.0, nodes=1.01 * body.structure.nodes, bar_length=long)
    held = tc.Model(tc.Structure(nodes, square[:3], [], MASS, fixed=[0, 1]))
    with pytest.raises(ValueError, match="length of bar 0, whose two ends are fixed"):
        tc.simulate(held, 1.0, bar_length=tc.Profile([0, 1], [[1.0, 1.1], [1, 1], [1, 1]]))


def test_other_uses_of_a_scene_with_driven_bars_are_refused(spinning):
    with pytest.raises(ValueError, match="bars are driven, expected bars"):
        spinning.scene.equation()


def test_a_scene_file_drives_bars(tmp_path):
    prism = tc.prism()
    file = tmp_path / "struts.toml"
    file.write_text(
        f"""
        structure.generator = "prism"
        structure.fixed = [3, 4, 5]
        prestress.force_density = 20.0
        run = {{duration = 0.1, step = 0.01}}
        struts = {{bars = [0, 2], time = [0.0, 0.1], length = [
            [{prism.bar_length[0]}, {prism.bar_length[2]}], [1.4, 1.38]]}}
        """
    )
    run = tc.load_scene(file).simulate()
    assert run.struts.bar.tolist() == [0, 2]
    np.testing.assert_allclose(run.struts.length[[0, 2], -1], [1.4, 1.38])
    file.write_text(file.read_text().replace("1.4, 1.38", "1.4, -1.38"))
    with pytest.raises(tc.scene.SceneError, match="length"):
        tc.load_scene(file)
