"""One implicit step a sample: its order, its stiff limit, and its derivatives."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tenscontrol as tc
from tenscontrol.control.mpc.shooting import RK4, RadauIIA
from tenscontrol.demo import tour as demo
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.plant.linear_plant import sampled
from tenscontrol.plant.reduced_dynamics import reduced_acceleration, sampled_dynamics
from tenscontrol.plant.reference import ReferencePreview, checked_reference

SAMPLE = 0.02


@cache
def plant_of(stiffness, damping=0.02):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness, damping=damping * stiffness**0.5))
    rest = tc.prestress(prism, force_density=demo.TOP_FORCE_DENSITY)
    return tc.linearize(model, rest, input="rest_length")


def moved(plant, stiffness):
    """A state and two inputs, off by a share of what stretches the strings."""
    rng = np.random.default_rng(0)
    z = np.r_[0.3 / stiffness * rng.normal(size=9), 0.01 * rng.normal(size=9)]
    return z, plant.rest_length + rng.normal(size=(2, 9)) / stiffness


def test_the_order_is_five():
    """Over a time of 0.12 s, against SciPy's method of order 8 on the same accelerations."""
    plant = plant_of(100.0)
    slope = Evaluator(reduced_acceleration(plant, taut=False))
    rng = np.random.default_rng(0)
    z, held = np.r_[0.01 * rng.normal(size=9), 0.1 * rng.normal(size=9)], plant.rest_length
    exact = solve_ivp(
        lambda _, x: np.r_[x[9:], slope(x, held)[0]], (0.0, 0.12), z, "DOP853", rtol=1e-13,
        atol=1e-15,
    ).y[:, -1]  # fmt: skip
    errors, counts = [], np.array([4, 6, 8, 12])
    for count in counts:
        motion, end = RadauIIA(plant, 0.12 / count, 1, False, False), z
        for _ in range(count):
            end, _ = motion.advance(end, held, held)
        errors.append(np.abs(end - exact).max())
    orders = -np.diff(np.log(errors)) / np.diff(np.log(counts))
    np.testing.assert_allclose(orders, 5.0, atol=0.3)


def test_a_step_is_the_motion_of_the_model():
    """All 36 states of the prism, no string slack; vibrations of 0.7 rad a sample."""
    plant = plant_of(100.0)
    z = np.r_[0.01 * np.random.default_rng(0).normal(size=9), np.zeros(9)]
    run = tc.simulate(
        plant.model, SAMPLE, plant.to_nodes(z[:9]), step=1e-4, rest_length=plant.rest_length
    )
    found = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
    end, _ = RadauIIA(plant, SAMPLE, 1, False, False).advance(z, *[plant.rest_length] * 2)
    assert np.abs(end - found).max() < 1e-4 * np.abs(found).max()


@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_stiff_strings_follow_their_winches_as_at_rest(stiffness):
    """Wound along equilibria, the prism goes through them, a thousandth of the way off."""
    prism, plant = tc.prism(), plant_of(stiffness)
    reference, _ = checked_reference(plant, demo.ramp(prism, 1.0, 0.97, 3.0))
    path = ReferencePreview(plant, reference, sampled(plant, SAMPLE, False))
    wound = path.at(SAMPLE * np.arange(151.0))
    motion, z = RadauIIA(plant, SAMPLE, 1, True, False), np.zeros(18)
    way = np.abs(wound.rest[-1]).max()
    assert way > 0.01
    for k in range(150):
        z, _ = motion.advance(z, wound.input[k], wound.input[k + 1])
        assert np.abs(z[:9] - wound.rest[k + 1, :9]).max() < 1e-3 * way


def test_winding_is_that_of_the_parts():
    """Strings of 1e6 N/m, against RK4 in each of 20 parts, where vibrations last."""
    plant, pieces = plant_of(1e6), 20
    fine = Evaluator(sampled_dynamics(plant, SAMPLE / pieces)[0])
    motion = RadauIIA(plant, SAMPLE, 1, True, False)
    way = 1e-5 * np.random.default_rng(2).normal(size=9)
    z = exact = np.zeros(18)
    held, off = plant.rest_length, []
    for k in range(25):
        before, held = held, held + way * (k < 10)
        z, _ = motion.advance(z, before, held)
        for piece in range(1, pieces + 1):
            exact = fine(exact, before + piece / pieces * (held - before))[0].copy()
        off.append(np.abs(z - exact)[:9].max() / np.abs(exact[:9]).max())
    assert max(off[1:10]) < 0.02  # while winches wind
    assert max(off[20:]) < 1e-4  # vibrations have died out


@pytest.mark.parametrize("ramp", [False, True])
@pytest.mark.parametrize("stiffness", [1e2, 1e6])
def test_slopes_are_those_of_the_solved_step(stiffness, ramp):
    """By differences of fourth order of single steps, which CasADi's Newton method solves alike."""
    plant = plant_of(stiffness)
    motion = RadauIIA(plant, SAMPLE, 1, ramp, False)
    z, acting = moved(plant, stiffness)
    end, stages = motion.advance(z, *acting)
    given = (z, *acting) if ramp else (z, acting[1])
    np.testing.assert_allclose(motion.sampled(*given).full().ravel(), end, atol=1e-12)
    jacobians = motion.linearize(z[None], acting, stages[None])
    slopes = [slope[0] for slope in (*jacobians.slopes, motion.load_response(np.eye(9)))]
    np.testing.assert_allclose(jacobians.values[0], end, rtol=1e-10, atol=1e-12)

    def ends(moves):
        shift = [np.zeros(18), *np.zeros((3, 9))]
        for place, move in moves.items():
            shift[place] = move
        load = shift[3 if ramp else 2]
        before = acting[0] + (shift[2] if ramp else 0.0)
        return motion.predict(z + shift[0], before, acting[1] + shift[1], load)[0]

    rng = np.random.default_rng(1)
    sizes = [np.r_[np.full(9, 0.03 / stiffness), np.full(9, 1e-3)], 0.03 / stiffness]
    sizes += [0.03 / stiffness, 1.0] if ramp else [1.0]
    for place, (slope, size) in enumerate(zip(slopes, sizes, strict=True)):
        step = size * rng.normal(size=len(slope))
        far, near = ((ends({place: m * step}) - ends({place: -m * step})) / m for m in (2, 1))
        expected = 2 * step @ slope
        assert np.abs((4 * near - far) / 3 - expected).max() < 1e-6 * np.abs(expected).max()
    np.testing.assert_allclose(
        motion.predict(z, *acting, np.zeros(9))[1], slopes[-1].T, rtol=1e-9, atol=1e-15
    )


@pytest.mark.parametrize("ramp", [False, True])
def test_stages_of_a_plan_converge_to_the_solved_step(ramp):
    """Newton's method: one step after the other, each a linearization."""
    plant = plant_of(1e6)
    motion = RadauIIA(plant, SAMPLE, 2, ramp, False)
    z, acting = moved(plant, 1e6)
    acting = np.vstack([acting, acting[:1]])
    states, stages = np.array([z, 0.5 * z]), np.zeros((2, 3, 9))
    off = []
    for _ in range(6):
        jacobians = motion.linearize(states, acting, stages)
        ends = jacobians.values
        stages = motion.corrected(stages, (0 * states, 0 * acting), None)
        exact = [motion.advance(states[k], acting[k], acting[k + 1]) for k in range(2)]
        off.append(max(np.abs(ends[k] - exact[k][0]).max() for k in range(2)))
    assert off[0] > 1e-6
    assert off[-1] < 1e-12
    for k in range(2):
        np.testing.assert_allclose(stages[k], exact[k][1], rtol=1e-8, atol=1e-6)


def test_correction_is_the_first_order_of_what_moved():
    plant = plant_of(1e4)
    motion = RadauIIA(plant, SAMPLE, 1, True, False)
    z, acting = moved(plant, 1e4)
    _, stages = motion.advance(z, *acting)
    rng, off = np.random.default_rng(3), []
    dz, du, load = 1e-6 * rng.normal(size=18), 1e-6 * rng.normal(size=(2, 9)), rng.normal(size=9)
    for size in (1.0, 0.5):
        motion.linearize(z[None], acting, stages[None])
        found = motion.corrected(stages[None], (size * dz[None], size * du), size * 1e-2 * load)
        _, exact = motion._step(z + size * dz, *(acting + size * du), size * 1e-2 * load)
        off.append(np.abs(found[0] - exact).max() / np.abs(exact - stages).max())
    assert off[0] < 1e-2
    assert off[1] == pytest.approx(0.5 * off[0], rel=0.1)


def test_a_step_that_is_not_solved_is_no_number():
    """Bars beyond the coordinates have no motion."""
    plant = plant_of(1e4)
    motion = RadauIIA(plant, SAMPLE, 1, True, False)
    end, stages = motion.advance(np.full(18, 3.0), plant.rest_length, plant.rest_length)
    assert np.isnan(end).any()
    assert np.isnan(stages).any()
    by_casadi = motion.sampled(np.full(18, 3.0), plant.rest_length, plant.rest_length)
    assert np.isnan(by_casadi.full()).all()


@pytest.mark.parametrize("kind", ["RK4", "held", "ramp"])
def test_samples_keep_their_slopes_in_slots_and_have_exact_values(kind):
    """A plan of three samples moves on by one: the first two slopes are those of before.

    Then the last one has the slot of the first.
    """
    if kind == "RK4":
        ball = tc.library.six_bar_ball()
        plant = tc.linearize(tc.Model(ball), tc.prestress(ball, force_density=20.0))
        kept, anew = (RK4(plant, SAMPLE, 3, False) for _ in range(2))
    else:
        plant = plant_of(1e3)
        kept, anew = (RadauIIA(plant, SAMPLE, 3, kind == "ramp", False) for _ in range(2))
    rng, (s, a) = np.random.default_rng(4), plant.B.shape
    states = 1e-3 * rng.normal(size=(4, s))
    inputs = plant.equilibrium_input + 1e-4 * rng.normal(size=(5, a))
    stages = rng.normal(size=(4, 3, s // 2))
    before = kept.linearize(states[:3], inputs[:4], stages[:3])
    slopes = [part.copy() for part in before.slopes]
    states[1] += 1e-6
    moved_on, last = (states[1:], inputs[1:], stages[1:]), np.array([False, False, True])
    now = kept.linearize(*moved_on, np.array([1, 2, 0]), last)
    exact = anew.linearize(*moved_on)
    assert now.slots.tolist() == [1, 2, 0]
    assert now.fresh.tolist() == last.tolist()
    for part, old, new in zip(now.in_order().slopes, slopes, exact.slopes, strict=True):
        assert np.array_equal(part[:2], old[1:])
        np.testing.assert_allclose(part[2], new[2], rtol=0, atol=1e-12)
        assert 0 < np.abs(part[0] - new[0]).max() < 1e-3
    if kind == "RK4":
        assert np.array_equal(now.values, exact.values)
        assert_slopes_of_the_first(
            kept.linearize(*moved_on, np.array([1, 2, 1]), np.zeros(3, bool))
        )
        return
    # Stages take a step of Newton's method, from what is left of the equations.
    found, wanted = (
        each.corrected(stages[1:], (0 * states[1:], 0 * inputs[1:]), None) for each in (kept, anew)
    )
    scale = np.abs(wanted - stages[1:]).max()
    np.testing.assert_allclose(found[2], wanted[2], rtol=0, atol=1e-9 * scale)
    assert 0 < np.abs(found - wanted).max() < 1e-3 * scale
    np.testing.assert_allclose(now.values, exact.values, rtol=0, atol=1e-3 * scale * SAMPLE)
    assert_slopes_of_the_first(kept.linearize(*moved_on, np.array([1, 2, 1]), np.zeros(3, bool)))
    found = kept.corrected(stages[1:], (0 * states[1:], 0 * inputs[1:]), None)
    assert 0 < np.abs(found - wanted).max() < 1e-2 * scale


def assert_slopes_of_the_first(jacobians):
    assert not jacobians.fresh.any()
    for part in jacobians.in_order().slopes:
        assert np.array_equal(part[2], part[0])
        assert not np.array_equal(part[2], part[1])


def test_a_step_from_the_stages_of_the_last_sample_is_the_same_step(monkeypatch):
    """And is found without derivatives of its own."""
    plant = plant_of(1e4)
    motion = RadauIIA(plant, SAMPLE, 2, False, False)
    z, acting = moved(plant, 1e4)
    _, stages = motion.advance(z, *acting)
    motion.linearize(np.array([z, z]), acting[[0, 1, 1]], np.array([stages, stages]))
    near = z + 1e-6
    exact, _ = motion.advance(near, *acting)
    factorized = []
    monkeypatch.setattr(motion._single, "factorize", lambda *_: factorized.append(1))
    found, _ = motion.advance(near, acting[1], acting[1], stages)
    assert not factorized
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-10 * motion._size)


def test_a_step_from_stages_that_are_far_off_takes_derivatives_of_its_own():
    """Also where nothing was linearized, so that the equations of the plan have no solution."""
    plant = plant_of(1e4)
    z, acting = moved(plant, 1e4)
    motion = RadauIIA(plant, SAMPLE, 2, False, False)
    exact, stages = motion.advance(z, *acting)
    far = stages + 10 * np.abs(stages).max()
    for _ in range(2):
        found, _ = motion.advance(z, *acting, far)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-10 * motion._size)
        motion.linearize(np.array([0 * z, z]), acting[[0, 1, 1]], np.array([stages, far]))
