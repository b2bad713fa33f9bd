"""Steps that end at slack switches: order, simultaneous, double and grazing switches."""

from contextlib import nullcontext

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.integrate.methods import METHODS
from tests.dynamics.scenes import paper_force_density, random_structure, rest_lengths
from tests.integrate.stepping import moving
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength
from tests.random_scenes import random_scene
from tests.without_core import without_core


@pytest.fixture(params=["core", "Python"], autouse=True)
def _loop(request):
    """Both loops over steps: that of the core where it is, and that in Python."""
    with without_core() if request.param == "Python" else nullcontext():
        yield


DURATION = 5.0
TIMES = np.linspace(0.0, DURATION, 11)


@pytest.fixture(scope="module")
def example():
    """The paper's example 1: six strings go slack and taut together, 55 times in 5 s."""
    prism = tc.prism()
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    exact, switches = exact_motion(prism, HeldRestLength(lengths, 100.0), TIMES)
    return model, lengths, exact, switches


def run(model, lengths, name, setting, **options):
    integrator = METHODS[name].integrator(model.equation("rest_length"), setting, **options)
    start = np.concatenate([model.structure.nodes.ravel(order="F"), np.zeros(18)])
    span = integrator.advance(start, lengths, DURATION, len(TIMES) - 1)
    return span.states[:18].reshape(6, 3, -1).swapaxes(0, 1), span.work


def error(example, name, setting, **options):
    nodes, _ = run(*example[:2], name, setting, **options)
    return np.abs(nodes - example[2][:, :, 1:]).max()


@pytest.mark.parametrize(
    ("name", "steps", "least"),
    [
        ("rk4", [4e-3, 2e-3, 1e-3, 5e-4], 3.8),
        ("rk4_plain", [4e-3, 2e-3, 1e-3, 5e-4], 2.0),  # goes through them
    ],
)
def test_the_order_holds_through_all_slack_switches(example, name, steps, least):
    errors = [error(example, name, step) for step in steps]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert least <= order <= least + 0.8


def test_two_formulations_and_two_methods_agree(example):
    """The oracle has other coordinates and another method: agreement says how good both are."""
    assert error(example, "dop853", 1e-12) < 1e-10
    assert error(example, "rk4", 1e-4) < 1e-9


@pytest.mark.parametrize(("name", "setting"), [("rk4", 1e-3), ("dop853", 1e-9)])
def test_strings_that_switch_together_are_taken_together(example, name, setting):
    model, lengths, _, switches = example
    _, work = run(model, lengths, name, setting)
    assert len(switches) == 55
    assert work.switches == 6 * 55
    assert work.missed == 0


def test_steps_of_dop853_end_at_switches_on_their_interpolant(example):
    """A step taken again up to the switch is twelve evaluations, the interpolant three."""
    _, work = run(*example[:2], "dop853", 1e-6)
    tries = work.steps + work.rejections
    assert work.switches == 6 * 55
    assert work.evaluations < 12 * tries + 55 * 11  # 55 * 14 by steps alone


# Two masses on a string: the stretch is that of one mass m/2 on a spring.
MASS, STIFFNESS, REST = 2.0, 1e4, 1.0
OMEGA = np.sqrt(2 * STIFFNESS / MASS)


def pair(load=0.0, damping=0.0):
    """Two point masses on a string along x, pulled apart by a load."""
    forces = np.array([[-load, load], [0.0, 0.0], [0.0, 0.0]])
    ends = tc.Structure(
        [[-0.5, 0.5], [0.0, 0.0], [0.0, 0.0]], [], [[0, 1]], bar_mass=1.0, string_node_mass=MASS
    )
    law = tc.LinearStrings(STIFFNESS, damping)
    return tc.Model(ends, strings=law, external_force=forces).equation("rest_length")


def distances(equation, name, setting, gap, speed, duration, outputs):
    """Return the stretch at the output times, from this stretch and its rate."""
    x = np.array([-0.5 - gap / 2, 0, 0, 0.5 + gap / 2, 0, 0, -speed / 2, 0, 0, speed / 2, 0, 0])
    span = (
        METHODS[name].integrator(equation, setting).advance(x, np.array([REST]), duration, outputs)
    )
    return span.states[3] - span.states[0] - REST, span.work


@pytest.mark.parametrize(("name", "setting"), [("rk4", 0.05), ("dop853", 1e-10)])
def test_a_string_that_goes_taut_and_slack_within_one_step_is_found(name, setting):
    """It pulls for π/ω = 31 ms, from 10 ms on: the masses part at 1 m/s and come back as fast."""
    time = 0.05
    stretch, work = distances(pair(), name, setting, -0.01, 1.0, time, 1)
    assert np.pi / OMEGA < 0.8 * time
    assert work.switches == 2
    assert work.missed == 0
    # A step of RK4 over half a period is coarse, but it is cut at both ends.
    allowed = {"rk4": 1e-1, "dop853": 1e-9}[name]
    assert stretch[0] == pytest.approx(-(time - 0.01 - np.pi / OMEGA), abs=allowed)


def test_a_dip_below_the_border_within_a_step_is_found():
    """The stretch swings about F/k under a load; for 4 ms it is negative."""
    load, over = 10.0, 1.02
    rest = load / STIFFNESS  # the load stretches the string by so much
    stretch, work = distances(pair(load), "dop853", 1e-10, rest * (1 + over), 0.0, 0.06, 1)
    assert work.switches == 2
    # Slack, the masses are pulled apart by the load alone: a parabola in place of the cosine.
    speed = rest * OMEGA * np.sqrt(over**2 - 1)
    slack = 2 * speed / (2 * load / MASS)
    late = 0.06 - 2 * np.arccos(-1 / over) / OMEGA - slack
    exact = rest * (1 + over * np.cos(OMEGA * late))
    assert stretch[0] == pytest.approx(exact, abs=1e-3 * rest)


@pytest.mark.parametrize("part", [1.0, 1 - 1e-13, 1 + 1e-13, 1 + 1e-9, 1 - 1e-9])
@pytest.mark.parametrize(("name", "setting"), [("rk4", 5e-4), ("dop853", 1e-10)])
def test_a_string_that_only_grazes_the_border_does_not_chatter(part, name, setting):
    """Stretch F/k (1 + cos ωt), to zero once a period and back: at most two switches there."""
    load, periods = 10.0, 20
    rest = load / STIFFNESS
    duration = periods * 2 * np.pi / OMEGA
    stretch, work = distances(
        pair(load), name, setting, rest * (1 + part), 0.0, duration, 2 * periods
    )
    assert work.switches <= 2 * periods
    assert work.missed == 0
    assert np.abs(stretch[1::2] - 2 * rest).max() < 1e-3 * rest
    assert np.abs(stretch[0::2]).max() < 1e-3 * rest


def test_where_no_string_can_go_slack_nothing_is_looked_for(prism):
    equation = tc.Model(prism).equation("force_density")
    assert equation.switches == 0
    integrator = METHODS["rk4"].integrator(equation, 1e-3)
    start = np.concatenate([prism.nodes.ravel(order="F"), np.zeros(18)])
    work = integrator.advance(start, np.full(9, 10.0), 0.1, 1).work
    assert (work.steps, work.evaluations, work.switches) == (100, 400, 0)


@pytest.mark.parametrize("damping", [0.1, 3.0])
def test_damped_strings_switch_where_their_tension_ends(prism, damping):
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping))
    law = HeldRestLength(lengths, 100.0, damping)
    exact, _ = exact_motion(prism, law, np.array([0.0, 1.0]))
    steps, errors = [4e-3, 2e-3, 1e-3], []
    for step in steps:
        motion = tc.simulate(model, 1.0, rest_length=lengths, step=step)
        errors.append(np.abs(motion.nodes[:, :, -1] - exact[:, :, -1]).max())
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 3.7
    fine = tc.simulate(model, 1.0, rest_length=lengths, tolerance=1e-12)
    assert np.abs(fine.nodes[:, :, -1] - exact[:, :, -1]).max() < 1e-10


@pytest.mark.parametrize(("name", "setting"), [("rk4", 2e-5), ("dop853", 1e-13)])
def test_a_damped_string_is_not_taken_on_late(name, setting):
    """Its force jumps as it comes taut: ending there 4e-12 m late was an error of 7e-13 m."""
    rate, time = 50.0, 0.05  # half of 2 c / m, 1/s
    stretch, work = distances(pair(0.0, rate * MASS), name, setting, -0.01, 1.0, time, 1)
    assert (work.switches, work.missed) == (2, 0)
    # From a stretch of 0 at 1 m/s, until k s + c s' = 0; from there on it keeps its speed.
    turning = np.sqrt(OMEGA**2 - rate**2)
    angle = np.pi - np.arctan2(2 * rate * turning, OMEGA**2 - 2 * rate**2)
    decay = np.exp(-rate * angle / turning)
    speed = decay * (np.cos(angle) - rate / turning * np.sin(angle))
    exact = decay * np.sin(angle) / turning + (time - 0.01 - angle / turning) * speed
    assert stretch[0] == pytest.approx(exact, abs=3e-13)


@pytest.mark.parametrize(("seed", "tolerance"), [(4, 1e-12), (5, 1e-12), (6, 1e-11), (20, 1e-12)])
def test_of_two_strings_that_switch_close_together_the_first_comes_first(seed, tolerance):
    """Within a 36th of a step; with the steeper one first, states were off by 4e-7 to 3e-6."""
    structure = random_structure(seed)
    equation = tc.Model(structure, strings=tc.LinearStrings(50.0)).equation("rest_length")
    state = moving(structure, seed)
    state[len(state) // 2 :] *= 0.5
    lengths = 0.9 * structure.string_length()
    found = [
        METHODS[name].integrator(equation, value).advance(state, lengths, 0.4, 1)
        for name, value in (("dop853", tolerance), ("rk4", 1e-4))
    ]
    assert found[0].work.switches == found[1].work.switches > 15
    np.testing.assert_allclose(found[0].states, found[1].states, rtol=0, atol=1e-9)


def test_a_damped_string_that_touches_early_in_a_step_pulls():
    """Its stretch grows through zero just after another string's; damping lets it go again soon."""
    structure = tc.Structure(
        nodes=[
            [2.0693, 1.7394, 1.3312, 1.7254],
            [-4.7099, -4.3274, -4.1234, -4.0958],
            [2.2556, 2.1221, 1.6440, 1.2531],
        ],
        bars=[(0, 1), (2, 3)],
        strings=[(0, 2), (1, 2), (3, 1), (3, 0), (0, 2, 1, 3, 0), (3, 1, 2), (0, 3, 1, 2)],
        bar_mass=0.27406,
        point_mass=[0.0, 0.0, 0.0, 10.429],
    )
    velocities = [
        [35.167, 31.962, -51.303, 9.0452],
        [-10.395, 8.6759, 40.241, 51.431],
        [-60.495, 2.0748, -2.2782, 59.363],
    ]
    rigidity = [105720, 211570, 338340, 85872, 1481600, 554990, 172900]
    model = tc.Model(structure, strings=tc.ElasticStrings(rigidity, damping=124.65))
    lengths = [1.0294, 0.59241, 0.89742, 1.2096, 3.4497, 1.4725, 2.5189]
    coarse, fine = (
        tc.simulate(model, 0.02, velocities=velocities, rest_length=lengths, tolerance=tolerance)
        for tolerance in (1e-6, 1e-10)
    )
    assert coarse.work.switches == fine.work.switches == 24
    assert np.abs(coarse.nodes[:, :, -1] - fine.nodes[:, :, -1]).max() < 1e-6


def test_switches_in_too_long_a_step_are_counted_as_missed():
    """A damped tower with more switches in a step than it can be cut at."""
    tower = tc.library.prism_tower(30)
    rest = tc.prestress(tower, min_force_density=1.0)
    stiffness = 100 * rest.force_density.max()
    model = tc.Model(tower, strings=tc.LinearStrings(stiffness, damping=1e-4 * stiffness))
    lengths = tc.to_rest_length(model, tower.nodes, rest.force_density).rest_length.copy()
    lengths[::7] *= 0.97
    equation = model.equation("rest_length")
    start = np.concatenate([tower.nodes.ravel(order="F"), np.zeros(tower.nodes.size)])
    true = METHODS["dop853"].integrator(equation, 1e-8).advance(start, lengths, 0.1, 1).work
    work = METHODS["rk4"].integrator(equation, 4e-3).advance(start, lengths, 0.1, 1).work
    assert true.missed == 0
    assert work.missed > 0.03 * true.switches
    assert work.switches + work.missed == pytest.approx(true.switches, rel=0.02)


def test_a_damped_string_lands_where_its_gap_has_a_kink():
    """Its tension falls to zero fast; beyond, the gap is the stretch, a thousandth of that."""
    scene = random_scene(60)
    coarse, fine = (scene.simulate(tolerance=tolerance) for tolerance in (1e-6, 1e-10))
    assert coarse.work.switches == fine.work.switches == 12
    assert np.abs(coarse.nodes[:, :, -1] - fine.nodes[:, :, -1]).max() < 1e-6 * scene.size
