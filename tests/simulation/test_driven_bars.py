"""Bars whose lengths are driven: closed forms, an oracle with multipliers, work, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import tenscontrol as tc
from tests.benchmarks.driven_bars import GRAVITY, SPIN, hoist, swinging
from tests.known_structures import class2_tower, d_bar
from tests.oracle import free_rows, node_acceleration

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
    free = structure.free
    found = model.driven_bar_force_density(nodes[:, free], velocities[:, free], gamma, extension)
    np.testing.assert_allclose(np.array(found).ravel(), lam, rtol=1e-10, atol=1e-9)


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


REFUSED = {
    "length": ({"bar_length": [1.1]}, "in nodes, bar 0 is 1 m long, but bar_length begins at 1.1"),
    "jump": ({"bar_length": tc.Profile([0.0, 0.5], [[1.0, 2.0]], "hold")}, "jumps by 1 m at 0.5 s"),
    "sign": ({"bar_length": tc.Profile([0.0, 1.0], [[1.0, -1.0]])}, "falls to -1 m at 1 s"),
    "shape": ({"bar_length": tc.Profile([0.0, 1.0], [[1.0, 1.0]] * 2)}, "expected \\(1,\\)"),
    "supports": ({"support_motion": 0.0}, "does not go with support_motion"),
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
    with pytest.raises(ValueError, match="driven bars, through which no derivative"):
        tc.sensitivity(spinning, to=["velocities"])
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
