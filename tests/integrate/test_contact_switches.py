"""Contacts that open and close: with strings and clusters, grazing, fast exits, bounces, rest."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import HertzGround
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.integrate.methods import METHODS
from tests.integrate.coupled_scenes import mixed, possible_velocities
from tests.integrate.ground_scenes import GRAVITY, GROUND, Scene, resting
from tests.located_motion import exact_motion


def test_strings_clusters_and_contacts_switch_together():
    """Bars that share nodes, a cluster, rollers and a payload over a floor with a wall."""
    structure = mixed()
    walls = [tc.Ground(**GROUND, height=-0.9), tc.Ground(**GROUND, normal=[0, 1, 0], height=-0.95)]
    velocities = possible_velocities(structure, 3, 1.0)
    scene = Scene(structure, structure.string_length(), tuple(walls), velocities, 100.0)
    times = np.array([0.0, 0.3])
    exact, switches = scene.exact(times)
    equation = scene.model.equation("rest_length")
    assert len(switches) >= 6
    for method, value, off in (("dop853", 1e-12, 1e-10), ("rk4", 2e-4, 2e-6)):
        nodes, work = scene.run(METHODS[method].integrator(equation, value), times)
        assert work.switches >= len(switches)
        assert work.missed == 0
        np.testing.assert_allclose(nodes, exact, rtol=0, atol=off)


# ---- grazing ----


def turning(depth, law, speed=20.0):
    """A bar of 1 m that turns in the plane about a centre, its ends reaching a depth of the ground:
    equation, state, and the nodes after a time without ground."""
    centre, start = np.array([0.0, 0.5 - depth]), -0.7 - np.pi / 2

    def nodes(time):
        angle = start + speed * time
        half = 0.5 * np.array([np.cos(angle), np.sin(angle)])
        return np.column_stack([centre - half, centre + half])

    N = nodes(0.0)
    arms = N - centre[:, None]
    velocities = speed * np.array([-arms[1], arms[0]])
    bar = tc.Structure(N, [[0, 1]], [], bar_mass=1.0)
    equation = tc.Model(bar, ground=law).equation("force_density")
    return equation, pack_state(bar, N, velocities), nodes


DEPTHS = [-1e-9, -1e-12, 0.0, 1e-13, 1e-11, 1e-9, 1e-7]


@pytest.mark.parametrize(
    ("method", "value", "off"),
    [("rk4", 1e-3, 1e-7), ("dop853", 1e-10, 1e-9), ("cvodes", 1e-9, 1e-6)],
)
@pytest.mark.parametrize("law", [tc.Ground(5e3), tc.Ground(**GROUND), HertzGround(1e5, 0.3, 0.5)])
def test_a_node_that_grazes_moves_on(law, method, value, off):
    """What a contact of 1e-7 m takes is far below the error; and no step is cut without end.

    The bar grazes twice. A contact cuts two steps, each after two or three approaches, and shorter
    ones, thrown away or not, follow as it is stiff: ten steps at most each time. A ratio to the
    run without contact would be one to what a search that finds nothing takes: that is one
    evaluation, where it was 62 (295 in all and 469 with contacts, now 171 and at most 389).
    """
    efforts, stages = [], {"rk4": 4, "dop853": 12}.get(method)
    for depth in DEPTHS:
        equation, state, nodes = turning(depth, law)
        span = METHODS[method].integrator(equation, value).advance(state, np.zeros(0), 0.2, 1)
        exact = nodes(0.2).ravel(order="F")
        # A contact of δ lasts √(8δ/a) and gives k δ times that.
        touch = 5e3 * max(depth, 0) * np.sqrt(8 * max(depth, 0) / 200)
        np.testing.assert_allclose(span.states[:4, -1], exact, rtol=0, atol=off + touch)
        assert span.work.missed == 0
        efforts.append(span.work.evaluations)
        if depth == DEPTHS[0] and stages:
            assert efforts[0] <= stages * span.work.steps + 3
    assert max(efforts) < (efforts[0] + 2 * 10 * stages if stages else 12 * efforts[0])


def test_a_dip_into_the_ground_within_a_long_step_is_found():
    """A node that dips in by a micrometre for 0.2 ms, in steps of 30 ms."""
    equation, state, _ = turning(1e-6, tc.Ground(5e3))
    span = METHODS["dop853"].integrator(equation, 1e-10).advance(state, np.zeros(0), 0.1, 1)
    assert span.work.steps < 20
    assert span.work.switches == 2


@pytest.mark.parametrize(
    ("method", "value", "off"),
    [("rk4", 2e-4, 1e-7), ("dop853", 1e-12, 1e-10)],
)
def test_a_node_that_is_drawn_out_fast_is_let_go_below_the_surface(method, value, off):
    """With 1 + d ṗ = 0 at a third of a metre a second; turning, the end leaves faster."""
    law = tc.Ground(5e3, 3.0, 0.5)
    equation, state, nodes = turning(1e-3, law)
    start = nodes(0.0)
    velocities = state[4:].reshape(2, 2).T
    bar = tc.Structure(start, [[0, 1]], [], bar_mass=1.0)
    scene = Scene(bar, np.zeros(0), (law,), velocities)
    strings, _, planes = scene.of_oracle()
    times = np.array([0.0, 0.06])
    exact, switches = exact_motion(bar, strings, times, velocities, ground=planes)
    assert len(switches) == 2
    span = METHODS[method].integrator(equation, value).advance(state, np.zeros(0), 0.06, 1)
    assert (span.work.switches, span.work.missed) == (2, 0)
    found = span.states[:4, -1]
    np.testing.assert_allclose(found, exact[:, :, -1].ravel(order="F"), rtol=0, atol=off)


def test_bounces_without_damping_are_counted():
    """A point on elastic ground: so many bounces as fit, and back to its height after each."""
    height, stiffness, mass = 1e-3, 1e6, 2.0
    ends = np.array([[0.0, 1.0], [0.0, 0.0], [height, height]])
    structure = tc.Structure(ends, [], [[0, 1]], bar_mass=[], string_node_mass=mass)
    model = tc.Model(structure, gravity=GRAVITY, ground=tc.Ground(stiffness))
    equation = model.equation("force_density")
    # Falls of √(2h/g); on the ground a cosine about the depth at rest, mg/k.
    omega, rest = np.sqrt(stiffness / mass), mass * GRAVITY / stiffness
    speed = np.sqrt(2 * GRAVITY * height)
    inside = 2 * (np.pi - np.arctan2(speed / omega, rest)) / omega
    bounce = 2 * np.sqrt(2 * height / GRAVITY) + inside
    count = 200
    state = pack_state(structure, ends, np.zeros((3, 2)))
    span = (
        METHODS["dop853"].integrator(equation, 1e-12).advance(state, np.zeros(1), count * bounce, 1)
    )
    assert span.work.switches == 2 * 2 * count
    assert span.states[2, -1] == pytest.approx(height, abs=1e-9)


# ---- rest ----


@pytest.mark.parametrize(
    ("method", "value", "span"), [("energy_momentum", 0.05, 60.0), ("rk4", 5e-4, 5.0)]
)
def test_rest_on_the_ground_costs_what_rest_on_supports_does(method, value, span):
    works = []
    for on_ground in (True, False):
        equation, state, lengths = resting(on_ground)
        works.append(
            METHODS[method].integrator(equation, value).advance(state, lengths, span, 1).work
        )
    ground, supports = works
    assert ground.steps <= supports.steps + 10
    assert ground.evaluations < 1.5 * supports.evaluations
    assert ground.switches <= 6 * 10  # while the nodes settle, all of them together
    assert ground.missed == 0


def test_rest_on_the_ground_takes_dop853_what_friction_takes_it():
    """Near rest friction is a damper of the rate µ F/(m v_s), which its steps must follow."""
    equation, state, lengths = resting(True)
    integrator = METHODS["dop853"].integrator(equation, 1e-6)
    settled = integrator.advance(state, lengths, 5.0, 1)
    work = integrator.advance(settled.states[:, -1], lengths, 5.0, 1).work
    rate = 0.5 * (3 * GRAVITY / 3) / (0.25 * 0.01)
    assert work.switches == 0
    assert work.steps < 5.0 * rate / 5
