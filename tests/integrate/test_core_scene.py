"""The compiled core evaluates the equation of motion that CasADi states."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.integrate.core_scene import core_scene
from tenscontrol.integrate.projection import projection
from tests import core_kernels
from tests.marks import needs_core
from tests.random_scenes import random_scene
from tests.without_core import without_core

pytestmark = needs_core


def scene_and_state(seed):
    """A random scene, its equation, a state near by with any velocities, an input, switches.

    Of every second scene rest lengths and lengths of bars are polynomials in time.
    """
    scene, rng = random_scene(seed), np.random.default_rng(seed)
    structure = scene.structure
    rows = structure.free_rows
    position = structure.nodes.ravel(order="F")[rows] * (1 + 1e-3 * rng.normal(size=len(rows)))
    state = np.concatenate([position, rng.normal(size=len(rows)) * scene.size])
    u = np.asarray(scene.value, dtype=float) * np.ones(len(structure.strings))
    equation = scene.model.equation(scene.input)
    if seed % 2 and len(structure.bars):
        equation = scene.model.equation(scene.input, degree=3, length_input=True)
        values = np.concatenate([u, structure.bar_length])
        changes = rng.normal(size=(len(values), 3)) * [0.1, 1.0, 1.0]
        u = equation.layout.packed(values[:, None] * np.c_[np.ones(len(values)), changes], 0.01)
    taut = (rng.random(equation.switches) < 0.7).astype(float)
    return scene, equation, state, u, taut


def apart(left, right):
    """The largest difference as part of the largest number."""
    left, right = np.ravel(left), np.ravel(right)
    size = np.abs(right).max(initial=0.0)
    return np.abs(left - right).max(initial=0.0) / max(size, 1e-300)


@pytest.mark.parametrize("first", range(0, 24, 8))
def test_slopes_gaps_and_forces_are_those_of_the_equation(first):
    for seed in range(first, first + 8):
        _, equation, state, u, taut = scene_and_state(seed)
        core = core_scene(equation)
        half = len(state) // 2
        assert apart(core.slope(state, u, taut), equation.slope(state, u, taut).full()) < 1e-12
        gap, rate = core.gap(state, u)
        wanted = [value.full() for value in equation.gap(state, u)]
        assert apart(gap, wanted[0]) < 1e-12
        assert apart(rate, wanted[1]) < 1e-12
        forces = equation.force(state[:half], state[half:], u, gap > 0).full()
        assert core.largest_force(state, u) == pytest.approx(np.abs(forces).max(), rel=1e-12)


@pytest.mark.parametrize("law", [tc.Ground, tc.dynamics.HertzGround, tc.dynamics.SmoothGround])
@pytest.mark.parametrize("damping", [0.0, 0.7])
@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("structure", [tc.library.six_bar_ball(), tc.library.d_bar()])
def test_grounds_are_those_of_the_laws(law, damping, friction, structure):
    size = float(np.ptp(structure.nodes))
    more = {"width": 0.1 * size} if law is tc.dynamics.SmoothGround else {}
    model = tc.Model(
        structure,
        strings=tc.LinearStrings(100.0),
        gravity=9.81,
        ground=law(300.0, damping=damping, friction=friction, height=0.1 * size, **more),
    )
    equation, rng = model.equation("rest_length"), np.random.default_rng(1)
    for _ in range(5):
        state = rng.normal(size=equation.states) * size
        u = structure.string_length(structure.nodes)
        taut = (rng.random(equation.switches) < 0.7).astype(float)
        wanted = equation.slope(state, u, taut).full()
        assert apart(core_scene(equation).slope(state, u, taut), wanted) < 1e-12


def test_bars_are_put_on_their_lengths():
    for seed in range(12):
        scene, equation, state, u, _ = scene_and_state(seed)
        if len(scene.structure.bars) == 0:
            continue
        off = state.copy()
        off[: len(off) // 2] += (
            1e-5 * scene.size * np.random.default_rng(0).normal(size=len(off) // 2)
        )
        exact = projection(equation)
        wanted = exact(off, u) if equation.layout.lengths else exact(off)
        # How a bar spins about itself.
        assert apart(core_scene(equation).restored(off, u), wanted.full()) < 1e-7


def test_what_the_core_does_not_know_is_left_to_casadi():
    _, equation, _, _, _ = scene_and_state(0)
    with without_core():
        assert core_scene(equation) is None
    assert core_scene(equation) is not None


def test_the_kernels_are_those_of_the_laws():
    """``python -m tests.core_kernels --write`` prints them anew."""
    assert core_kernels.FILE.read_text("utf-8") == core_kernels.kernels()
    assert core_kernels.SLOPES.read_text("utf-8") == core_kernels.slopes()
    assert core_kernels.COEFFICIENTS.read_text("utf-8") == core_kernels.coefficients()
