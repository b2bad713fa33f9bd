"""Motions on the ground: the oracle, orders through impacts, closed forms, stiff ground.

``python -m tests.benchmarks.ground_motions`` takes the motions of the oracle over two seconds.
"""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import tenscontrol as tc
from tenscontrol.dynamics import HertzGround, SmoothGround
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.integrate.integrator import contact_frequency, largest_frequency
from tenscontrol.integrate.methods import METHODS, choose
from tests.dynamics.scenes import Cubic
from tests.integrate.coupled_scenes import errors_of_bars
from tests.integrate.ground_scenes import (
    GRAVITY,
    GROUND,
    SCENES,
    Scene,
    dropped,
    free_tower,
    rotation,
)
from tests.integrate.stepping import fitted_order

# ---- the oracle, and orders ----


@pytest.mark.parametrize(("name", "duration"), [("ball", 0.26), ("prism", 0.2), ("tower", 0.12)])
def test_a_motion_through_impacts_is_the_oracles(name, duration):
    scene, times = SCENES[name](), np.array([0.0, duration])
    exact, switches = scene.exact(times)
    assert len(switches) >= 1
    equation = scene.model.equation("rest_length")
    methods = {"dop853": (1e-13, 1e-11)} | ({"cvodes": (1e-9, 1e-5)} if name == "prism" else {})
    for method, (value, off) in methods.items():
        nodes, work = scene.run(METHODS[method].integrator(equation, value), times)
        np.testing.assert_allclose(nodes, exact, rtol=0, atol=off)
        assert work.missed == 0


@pytest.mark.parametrize("case", ["hertz", "corner", "plane"])
def test_other_grounds_against_the_oracle(case):
    """Hertz's law; a corner of two planes; a structure in the plane on a slope."""
    if case == "plane":
        slope = tc.Ground(**GROUND, normal=[0.2, 0.98])
        scene = dropped(tc.library.d_bar(), [slope], 0.05, (0.3, -1.0))
    else:
        law = HertzGround(1e5, 0.3, 0.5) if case == "hertz" else tc.Ground(**GROUND)
        wall = [tc.Ground(**GROUND, normal=[-1.0, 0.0, 0.0], height=-0.6)] * (case == "corner")
        turn = rotation([1, 2, 3], 0.5)
        scene = dropped(tc.prism(), [law, *wall], 0.02, (1.0, 0.0, -1.0), 10.0, turn)
    times = np.array([0.0, 0.12])
    exact, switches = scene.exact(times)
    assert len(switches) >= 2
    integrator = METHODS["dop853"].integrator(scene.model.equation("rest_length"), 1e-12)
    nodes, _ = scene.run(integrator, times)
    # Of Hertz's law the oracle's dense output, too, is of lower order where a node touches.
    np.testing.assert_allclose(nodes, exact, rtol=0, atol=1e-8 if case == "hertz" else 1e-10)


MIDDLE, FINE = [2.8e-4, 2e-4, 1.4e-4], [2e-4, 1.4e-4, 1e-4]


@cache
def impacts(name):
    """A scene, its equation, start and end, and the motion that methods are to come close to."""
    scene, times = SCENES[name](), np.array([0.0, 0.3 if name == "prism" else 0.15])
    equation = scene.model.equation("rest_length")
    exact, work = scene.run(METHODS["dop853"].integrator(equation, 1e-13), times)
    return scene, equation, times, exact, work


def test_a_height_that_is_a_plane_is_that_plane():
    """With friction, under all three kinds of methods."""
    slope, x, y = 0.3, ca.SX.sym("x"), ca.SX.sym("y")
    tilted = ca.Function("tilted", [x, y], [slope * x - 0.1])
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    plane = tc.Ground(**GROUND, normal=normal, height=-0.1 * normal[2])
    scene = dropped(tc.prism(), [plane], 0.02, (0.5, 0.3, -1.0), 10.0)
    other = replace(scene, ground=(tc.Ground(**GROUND, height=tilted),))
    times = np.array([0.0, 0.2])
    for method, value in (("dop853", 1e-10), ("rk4", 2e-4), ("energy_momentum", 1e-3)):
        motions = [
            each.run(METHODS[method].integrator(each.model.equation("rest_length"), value), times)
            for each in (scene, other)
        ]
        assert motions[0][1].switches == motions[1][1].switches
        np.testing.assert_allclose(motions[0][0], motions[1][0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "method", "steps", "least"),
    [
        ("prism", "rk4", FINE, 3.8),
        ("tower", "rk4", MIDDLE, 3.8),
    ],
)
def test_the_order_holds_through_all_impacts(name, method, steps, least):
    scene, equation, times, exact, work = impacts(name)
    assert work.switches >= 5
    runs = [scene.run(METHODS[method].integrator(equation, step), times) for step in steps]
    errors = [np.abs(nodes - exact).max() for nodes, _ in runs]
    assert fitted_order(steps, errors) > least
    assert all(each.switches == work.switches and not each.missed for _, each in runs)


# ---- closed forms ----

MASS = 2.0
EXACT = (("dop853", 1e-13, 1e-9), ("rk4", 1e-4, 1e-9))


def points(law, height, velocity, gravity=None):
    """Two point masses that nothing joins, as equation and state: the string has no force."""
    ends = np.array([[0.0, 1.0], [0.0, 0.0], [height, height]])
    structure = tc.Structure(ends, [], [[0, 1]], bar_mass=[], string_node_mass=MASS)
    velocities = np.repeat(np.array(velocity, float)[:, None], 2, axis=1)
    model = tc.Model(structure, gravity=gravity, ground=law)
    return model.equation("force_density"), pack_state(structure, ends, velocities)


def rebound(speed, damping):
    """The speed after an impact under ``F(p) (1 + d ṗ)``, whatever F: v dv/(1 + d v) = −F dp/m."""

    def lost(v):
        return v / damping - np.log1p(damping * v) / damping**2

    return brentq(lambda w: lost(speed) - lost(-w), 0.1 * speed, min(speed, 0.999 / damping))


@pytest.mark.parametrize(("method", "value", "off"), [*EXACT, ("cvodes", 1e-11, 1e-7)])
@pytest.mark.parametrize("law", [tc.Ground(5e3, 0.3), HertzGround(2e5, 0.3)])
def test_a_point_comes_back_as_fast_as_the_law_has_it(law, method, value, off):
    equation, state = points(law, 0.01, (0.0, 0.0, -2.0))
    span = METHODS[method].integrator(equation, value).advance(state, np.zeros(1), 0.3, 1)
    assert span.work.switches == 4
    if isinstance(law, HertzGround) and method != "dop853":
        off = 1e-7  # the force has no second derivative at the surface
    np.testing.assert_allclose(span.states[[8, 11], -1], rebound(2.0, 0.3), rtol=0, atol=off)


@pytest.mark.parametrize(("method", "value", "off"), EXACT[:2])
def test_sliding_to_rest(method, value, off):
    """∫ √(v² + v_s²) dv/(µg): more than v²/2µg by about v_s² ln(2v/v_s)/2µg."""
    friction, speed, far = 0.5, 1.0, []
    slips = [0.1, 0.05, 0.02]
    for slip in slips:
        law = tc.Ground(5e3, 0.3, friction, slip)
        equation, state = points(law, -MASS * GRAVITY / 5e3, (speed, 0.0, 0.0), GRAVITY)
        time = (speed + 40 * slip) / (friction * GRAVITY)
        span = METHODS[method].integrator(equation, value).advance(state, np.zeros(1), time, 1)
        distance = speed * np.hypot(speed, slip) + slip**2 * np.arcsinh(speed / slip)
        assert span.states[0, -1] == pytest.approx(distance / (2 * friction * GRAVITY), abs=off)
        far.append(span.states[0, -1] - speed**2 / (2 * friction * GRAVITY))
    assert 1.6 < fitted_order(slips, far) < 2.0


def test_on_a_slope_a_point_creeps_as_fast_as_its_friction_needs():
    """µ F v/√(v² + v_s²) = F tan α: v = v_s r/√(1 − r²), r = tan α/µ."""
    angle, friction, slip = 0.3, 0.5, 0.01
    normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
    equation, state = points(tc.Ground(5e3, 0.3, friction, slip, normal), 0.0, np.zeros(3), GRAVITY)
    state[[0, 3]] = 0.0
    state[[1, 4]] = 0.0, 1.0
    state[:6] -= np.tile(normal * MASS * GRAVITY * np.cos(angle) / 5e3, 2)
    span = METHODS["dop853"].integrator(equation, 1e-12).advance(state, np.zeros(1), 0.5, 1)
    r = np.tan(angle) / friction
    speed = slip * r / np.sqrt(1 - r**2)
    down = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    np.testing.assert_allclose(span.states[6:9, -1], speed * down, rtol=0, atol=1e-9)


def tip(softness, duration, start):
    """Angle of a bar in the plane, from upright, after it has tipped over its end on the ground."""
    stiffness, slip = 1e6 / softness, 1e-4 * softness
    nodes = np.array([[0.0, np.sin(start)], [0.0, np.cos(start)]])
    pressed = GRAVITY * (1 - 0.75 * np.sin(start) ** 2)  # the reaction at the start
    nodes[1] -= pressed / stiffness
    bar = tc.Structure(nodes, [[0, 1]], [], bar_mass=1.0)
    law = tc.Ground(stiffness, 0.3, 2.0, slip, nodes=[0])
    equation = tc.Model(bar, gravity=GRAVITY, ground=law).equation("force_density")
    state = pack_state(bar, nodes, np.zeros((2, 2)))
    span = METHODS["dop853"].integrator(equation, 1e-11).advance(state, np.zeros(0), duration, 1)
    return np.arctan2(*(span.states[2:4, -1] - span.states[:2, -1]))


def test_a_bar_tips_over_its_end_as_a_pendulum_on_a_hinge():
    """It does in the limit of stiff ground and small slip speed, whose error is of first order."""
    start, end = 0.4, 0.8

    def speed(angle):
        return np.sqrt(3 * GRAVITY * (np.cos(start) - np.cos(angle)))

    root = np.sqrt(end - start)
    duration = quad(lambda u: 2 * u / speed(start + u**2), 0, root, epsabs=1e-13, epsrel=1e-13)[0]
    late = np.array([(tip(s, duration, start) - end) / speed(end) for s in (16.0, 8.0, 4.0)])
    np.testing.assert_allclose(late[:-1] / late[1:], 2.0, rtol=2e-3)
    assert abs(2 * late[2] - late[1]) < 1e-7


def test_a_ball_at_rest_presses_with_its_weight():
    """It lies on three nodes, in steps of 20 ms, and nothing moves any more."""
    ball = tc.prestress(tc.library.six_bar_ball(), force_density=20.0).structure
    model = tc.Model(
        ball, strings=tc.LinearStrings(1e3, 20.0), gravity=GRAVITY, ground=tc.Ground(**GROUND)
    )
    nodes = ball.nodes - [[0], [0], [ball.nodes[2].min()]]
    lengths = 0.9 * ball.string_length()
    state = pack_state(ball, nodes, np.zeros_like(nodes))
    integrator = METHODS["energy_momentum"].integrator(model.equation("rest_length"), 2e-2)
    end = integrator.advance(state, lengths, 60.0, 1).states[:, -1]
    N, V = (each[:, :, 0] for each in tc.dynamics.equation.unpack_states(ball, end[:, None]))
    assert np.abs(V).max() < 1e-10
    N, V = ca.SX(ca.DM(N)), ca.SX(ca.DM(V))
    forces = np.array(ca.evalf(model.contacts.on_nodes(N, V)))
    np.testing.assert_allclose(forces.sum(axis=1), [0, 0, 6 * GRAVITY], rtol=0, atol=1e-10)
    assert np.count_nonzero(forces[2]) >= 3


# ---- stiff ground ----

STRUCTURES = {"prism": tc.prism, "ball": tc.library.six_bar_ball, "tower": free_tower}


def hills():
    """A height over x and y."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    return ca.Function("hills", [x, y], [0.2 * ca.sin(2 * x) * ca.cos(3 * y)])


def energies(scene: Scene, states):
    """Kinetic, elastic, of weight, and stored in the ground, together, of states."""
    model = scene.model
    inputs = np.repeat(scene.rest_length[:, None], states.shape[1], axis=1)
    total = evaluate_columns(model.kinetic_energy, states)[0].ravel()
    total += evaluate_columns(model.elastic_energy, states, inputs)[0].ravel()
    nodes = states[: len(states) // 2]
    total -= model.constant_force.ravel(order="F") @ nodes
    N = ca.SX.sym("N", *model.constant_force.shape)
    for law in scene.ground:
        stored = ca.sum2(law.stored_energy(law.sinking(N, 0 * N)[0]))
        total += evaluate_columns(ca.Function("stored", [ca.vec(N)], [stored]), nodes)[0].ravel()
    return total


def implicit(scene: Scene, step, duration=1.0, outputs=100):
    """Return the states of energy_momentum, with the start, and its work."""
    integrator = METHODS["energy_momentum"].integrator(scene.model.equation("rest_length"), step)
    span = integrator.advance(scene.state, scene.rest_length, duration, outputs)
    return np.column_stack([scene.state, span.states]), span.work


ELASTIC = {
    "linear": lambda: tc.Ground(1e6),
    "hertz": lambda: HertzGround(1e8),
    "own": lambda: Cubic(1e8),
    "smooth": lambda: SmoothGround(1e4),
    "hills": lambda: tc.Ground(1e6, height=hills()),
}


@pytest.mark.parametrize(
    ("structure", "law"),
    [*(("prism", law) for law in ELASTIC), ("tower", "hills")],
)
def test_ground_that_only_stores_energy_keeps_it(structure, law):
    scene = dropped(STRUCTURES[structure](), [ELASTIC[law]()], 0.25, (0.5, 0.0, -1.0))
    states, _ = implicit(scene, 2e-3)
    energy = energies(scene, states)
    assert np.abs(energy - energy[0]).max() < 1e-10 * energy[0]
    assert max(errors_of_bars(scene.structure, states)) < 1e-12
    assert states[len(states) // 2 + 2 :: 3].max() > 0.5  # it has come back


STIFF = {"damping": 0.3, "friction": 0.5}
DAMPED = {
    "1e2": lambda: tc.Ground(1e2, **STIFF),
    "1e5": lambda: tc.Ground(1e5, **STIFF),
    "1e8": lambda: tc.Ground(1e8, **STIFF),
    "1e9": lambda: tc.Ground(1e9, **STIFF),
    "friction 5": lambda: tc.Ground(1e8, 0.3, 5.0),
    "hertz": lambda: HertzGround(1e9, **STIFF),
    "own": lambda: Cubic(1e8, **STIFF),
    "hills": lambda: tc.Ground(1e8, **STIFF, height=hills()),
    "smooth": lambda: SmoothGround(1e5, **STIFF),
}


@pytest.mark.parametrize(
    ("structure", "law"),
    [
        *(("ball", law) for law in DAMPED if law not in ("1e5", "1e8", "own", "hills")),
        *(("tower", law) for law in ("1e8", "own", "hills")),
    ],
)
def test_stiff_ground_in_long_steps_never_gives_energy(structure, law):
    """Steps of 10 ms, 30 times the period of a node on ground of 1e8 N/m, and more."""
    scene = dropped(STRUCTURES[structure](), [DAMPED[law]()], 0.3, (0.5, 0.0, 0.0))
    states, work = implicit(scene, 1e-2)
    energy = energies(scene, states)
    assert np.diff(energy).max() < 1e-12 * energy[0]
    assert energy[-1] < 0.95 * energy[0]
    assert work.steps < (500 if law == "friction 5" else 105)
    assert max(errors_of_bars(scene.structure, states)) < 1e-12


def test_ground_without_friction_leaves_momentum_along_it():
    """Nothing pushes sideways without friction, up only the ground does."""
    scene = dropped(tc.library.six_bar_ball(), [tc.Ground(1e8, 0.3)], 0.1, (0.5, 0.2, 0.0))
    states, _ = implicit(scene, 1e-2)
    linear, _ = evaluate_columns(scene.model.momentum, states)
    np.testing.assert_allclose(linear[:2], linear[:2, [0] * 101], rtol=0, atol=1e-11)
    assert linear[2].min() < -5.0
    assert linear[2].max() > 1.0


def test_momentum_changes_by_the_mean_forces_of_the_ground():
    """Step by step, with the weight: the impulses on the nodes are those of the mean forces."""
    law, step = tc.Ground(1e8, **STIFF), 1e-2
    scene = dropped(free_tower(), [law], 0.05, (0.5, 0.0, 0.0))
    states, work = implicit(scene, step, 0.3, 30)
    assert work.steps == 30
    linear, _ = evaluate_columns(scene.model.momentum, states)
    shape = scene.structure.nodes.shape
    before, after = (ca.SX.sym(name, *shape) for name in ("before", "after"))
    forces = scene.model.contacts.mean_force(before, after, None, step)
    mean = ca.Function("mean", [ca.vec(before), ca.vec(after)], [ca.sum2(forces)])
    nodes = states[: len(states) // 2]
    pushed = evaluate_columns(mean, nodes[:, :-1], nodes[:, 1:])[0]
    weight = scene.model.constant_force.sum(axis=1)[:, None]
    assert pushed[2].max() > 100.0
    # The mean force is 1e8 N/m times depths that are rounded to 1e-16 m and more.
    np.testing.assert_allclose(np.diff(linear) / step, pushed + weight, rtol=0, atol=1e-4)


def test_the_implicit_method_has_its_order_on_the_ground():
    """About two: it does not end steps where nodes touch."""
    scene, times = SCENES["tower"](), np.array([0.0, 0.15])
    equation = scene.model.equation("rest_length")
    exact, _ = scene.run(METHODS["dop853"].integrator(equation, 1e-11), times)
    errors, steps = [], [2e-3, 1e-3, 5e-4]
    for step in steps:
        nodes, _ = scene.run(METHODS["energy_momentum"].integrator(equation, step), times)
        errors.append(np.abs(nodes - exact).max())
    assert fitted_order(steps, errors) > 1.7


@pytest.mark.parametrize(("method", "value"), [("cvodes", 1e-8), ("dop853", 1e-8)])
def test_other_methods_take_stiff_ground_too(method, value):
    law = tc.Ground(1e8, **STIFF)
    scene = dropped(tc.prism(), [law], 0.05, (0.2, 0.0, 0.0))
    integrator = METHODS[method].integrator(scene.model.equation("rest_length"), value)
    span = integrator.advance(scene.state, scene.rest_length, 0.3, 60)
    states = np.column_stack([scene.state, span.states])
    energy = energies(scene, states)
    assert span.work.switches >= 6
    assert np.diff(energy).max() < 1e-4 * energy[0]


# ---- the choice of a method ----


def chosen(law, height=0.3, gravity=GRAVITY, duration=5.0):
    scene = dropped(tc.library.six_bar_ball(), [law], height)
    model = tc.Model(
        scene.structure, strings=tc.LinearStrings(1e3), gravity=gravity, ground=scene.ground
    )
    given = model.equation("rest_length"), scene.state, scene.rest_length
    choice = choose(*given, duration, 1e-6, None)
    return largest_frequency(*given), contact_frequency(*given), choice


def test_frequencies_of_the_ground():
    """A node at the end of a bar of 1 kg has a quarter of its mass."""
    strings, ground, choice = chosen(tc.Ground(1e8))
    assert ground == pytest.approx(np.sqrt(1e8 / 0.25))
    assert choice.method == "dop853"
    assert "(ground)" in choice.reason
    assert "contacts open" in choice.reason
    without = chosen(tc.Ground(1e-3))
    assert without[0] == strings  # strings alone, whatever the ground
    assert "(ground)" not in without[2].reason


def test_rates_of_friction_and_damping():
    weight = 6 * GRAVITY
    assert chosen(tc.Ground(1.0, friction=0.5, slip_speed=1e-3))[1] == pytest.approx(
        0.5 * weight / (0.25 * 1e-3)
    )
    assert chosen(tc.Ground(1.0, damping=100.0))[1] == pytest.approx(100.0 * weight / 0.25, rel=0.1)
    assert chosen(tc.Ground(1.0, friction=0.5), gravity=None)[1] == pytest.approx(2.0)


def test_a_step_that_does_not_follow_the_ground_is_told():
    scene = dropped(tc.library.six_bar_ball(), [tc.Ground(1e8)], 0.3)
    given = scene.model.equation("rest_length"), scene.state, scene.rest_length
    long, short = (choose(*given, 5.0, 1e-6, step).reason for step in (1e-3, 1e-4))
    assert long.endswith("and steps follow the ground up to 0.0001 s only")
    assert "follow" not in short


def test_hertzian_ground_is_as_stiff_as_where_the_fall_ends():
    """2/5 k p^{5/2} = m g h, and the stiffness there is 3/2 k √p; at rest, k p^{3/2} = m g."""
    energy, k = 6 * GRAVITY * 0.3, 1e9
    depth = (2.5 * energy / k) ** 0.4
    expected = np.sqrt(1.5 * k * np.sqrt(depth) / 0.25)
    assert chosen(HertzGround(k))[1] == pytest.approx(expected, rel=0.02)
    depth = (6 * GRAVITY / k) ** (2 / 3)
    expected = np.sqrt(1.5 * k * np.sqrt(depth) / 0.25)
    assert chosen(HertzGround(k), height=-1e-3)[1] == pytest.approx(expected, rel=0.02)


def test_ground_alone_does_not_choose_the_implicit_method():
    """How long nodes touch is not known before: another method may take over, see Watched."""
    assert chosen(tc.Ground(1e12))[2].method == "dop853"
    assert chosen(tc.Ground(1e4, friction=1.0, slip_speed=1e-6))[2].method == "dop853"
