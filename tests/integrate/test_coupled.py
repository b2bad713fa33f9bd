"""Bars that share nodes, rollers, payloads and clustered strings under every method.

Against a dense oracle of its own (multipliers by least squares, SciPy's DOP853, located switches),
closed forms, and what must be conserved. ``python -m tests.benchmarks.coupled_bars`` takes more
steps.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.integrate.methods import METHODS
from tenscontrol.integrate.projection import project
from tests.integrate import coupled_scenes
from tests.integrate.coupled_scenes import SCENES, errors_of_bars, moving
from tests.integrate.stepping import fitted_order

STIFFNESS, GRAVITY = 100.0, 2.0
each_scene = pytest.mark.parametrize("name", SCENES)


class Oracle:
    """N̈ by dense matrices, and the motion with a new start at each switch."""

    def __init__(self, structure, rest_length, damping=0.0):
        self.structure, self.rest_length, self.damping = structure, rest_length, damping
        d, rows = structure.dimension, structure.free_rows
        M = np.kron(tc.structure.blocks.node_mass(structure).toarray(), np.eye(d))
        self.inverse = np.linalg.inv(M[np.ix_(rows, rows)])
        weights = tc.structure.blocks.node_mass(structure).sum(axis=0)
        self.weight = np.zeros_like(structure.nodes)
        self.weight[-1] = -GRAVITY * weights
        self.moving = [
            i for i, pair in enumerate(structure.bars) if not set(pair) <= set(structure.fixed)
        ]

    def stretch(self, x):
        s = self.structure
        nodes, velocities = (part[:, :, 0] for part in unpack_states(s, x[:, None]))
        S, Sd = s.string_vectors(nodes), s.string_vectors(velocities)
        each = np.linalg.norm(S, axis=0)
        rate = np.bincount(s.segment_string, (S * Sd).sum(axis=0) / each, len(s.strings))
        return np.bincount(s.segment_string, each, len(s.strings)) - self.rest_length, rate

    def tension(self, x):
        """The tension that a taut string has, and what is left of stretch or tension."""
        stretch, rate = self.stretch(x)
        tension = STIFFNESS * stretch + self.damping * rate
        return tension, np.minimum(STIFFNESS * stretch, tension)

    def slope(self, x, taut):
        s, rows = self.structure, self.structure.free_rows
        nodes, velocities = (part[:, :, 0] for part in unpack_states(s, x[:, None]))
        F = self.weight.copy()
        S = s.string_vectors(nodes)
        pull = S * ((taut * self.tension(x)[0])[s.segment_string] / np.linalg.norm(S, axis=0))
        np.add.at(F.T, s.segments[:, 0], pull.T)
        np.subtract.at(F.T, s.segments[:, 1], pull.T)
        J = tc.structure.blocks.bar_rows(s, np.array(self.moving), nodes).toarray()[:, rows]
        f = F.ravel(order="F")[rows]
        known = -(s.bar_vectors(velocities)[:, self.moving] ** 2).sum(axis=0)
        JM = J @ self.inverse
        force = np.linalg.lstsq(JM @ J.T, known - JM @ f, rcond=1e-11)[0]
        return np.concatenate([x[len(rows) :], self.inverse @ (f + J.T @ force)])

    def until_a_switch(self, x, time, end):
        """Time and state at the next switch, or the end, and which strings switch there."""
        taut = self.tension(x)[1] > 0 if time == 0.0 else self.taut

        def landing(i):
            event = lambda t, x: self.tension(x)[1][i]  # noqa: E731
            event.terminal, event.direction = True, -1 if taut[i] else 1
            return event

        found = solve_ivp(
            lambda t, x: self.slope(x, taut), (time, end), x, method="DOP853",
            events=[landing(i) for i in range(len(taut))], rtol=1e-11, atol=1e-12,
        )  # fmt: skip
        landed = np.array([len(times) > 0 for times in found.t_events])
        self.taut = taut ^ landed
        return found.t[-1], found.y[:, -1], landed.sum()

    def motion(self, x, duration):
        """The state at the end, and the number of switches."""
        time, switches = 0.0, 0
        while time < duration:
            time, x, more = self.until_a_switch(x, time, duration)
            switches += more
        return x, switches


def scene(name, damping=0.0, gravity=GRAVITY, stretch=0.0):
    structure = SCENES[name]()
    model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS, damping), gravity=gravity)
    lengths = (1 - stretch) * structure.string_length()
    return structure, model, model.equation("rest_length"), lengths


# ---- against others ----


@pytest.mark.parametrize(("name", "damping"), [(n, float(n == "mixed")) for n in SCENES])
def test_a_motion_through_switches_is_the_oracles(name, damping):
    structure, model, equation, lengths = scene(name, damping, stretch=0.005)
    smooth = model.equation("rest_length", form="mapped") if equation.form == "loops" else equation
    x, duration = moving(structure), 0.6 if name == "arm" else 0.3
    exact, switches = Oracle(structure, lengths, damping).motion(x, duration)
    assert switches >= 2
    span = METHODS["dop853"].integrator(equation, 1e-12).advance(x, lengths, duration, 1)
    np.testing.assert_allclose(span.states[:, -1], exact, rtol=0, atol=1e-9)
    assert span.work.switches == switches
    loose = METHODS["cvodes"].integrator(smooth, 1e-8).advance(x, lengths, duration, 1)
    np.testing.assert_allclose(loose.states[:, -1], exact, rtol=0, atol=2e-5)
    for each in (span, loose):
        assert max(errors_of_bars(structure, each.states)) < 1e-13


ORDERS = {"rk4": 4, "energy_momentum": 2}


@pytest.mark.parametrize(
    ("method", "name", "damping"),
    [
        *((method, name, 0.0) for method in ORDERS for name in ("tower", "arm", "spine")),
        ("rk4", "tower", 1.0),
    ],
)
def test_methods_have_their_order_through_switches(name, method, damping):
    structure, _, equation, lengths = scene(name, damping)
    x = moving(structure)
    exact = METHODS["dop853"].integrator(equation, 1e-13).advance(x, lengths, 0.6, 1)
    assert exact.work.switches >= 4
    steps = np.array([0.01, 0.005, 0.0025])
    errors = []
    for step in steps:
        span = METHODS[method].integrator(equation, step).advance(x, lengths, 0.6, 1)
        errors.append(np.abs(span.states - exact.states).max())
        assert span.work.missed == 0
    # RK4 has fewer digits to lose to switches near the ends of its longest steps.
    less = 0.5 if method == "rk4" or damping else 0.2
    assert fitted_order(steps, errors) > ORDERS[method] - less
    if method != "rk4":
        assert max(errors_of_bars(structure, span.states)) < 1e-14


# ---- closed forms ----


def double_pendulum():
    """Two slender rods of 1 kg and 1 m in the plane, at rest at 45° from the vertical."""
    down = np.array([np.sin(np.pi / 4), -np.cos(np.pi / 4)])
    nodes = np.column_stack([0 * down, down, 2 * down])
    return tc.Structure(nodes, [[0, 1], [1, 2]], [], bar_mass=1.0, fixed=[0])


def double_pendulum_angles(duration, gravity=9.8):
    """The two angles of the rods from the vertical, by their own equations (m = L = 1)."""

    def slope(_, state):
        a, b, da, db = state
        mass = np.array([[4 / 3, np.cos(a - b) / 2], [np.cos(a - b) / 2, 1 / 3]])
        force = [
            -np.sin(a - b) / 2 * db**2 - 1.5 * gravity * np.sin(a),
            np.sin(a - b) / 2 * da**2 - 0.5 * gravity * np.sin(b),
        ]
        return np.concatenate([[da, db], np.linalg.solve(mass, force)])

    start = [np.pi / 4, np.pi / 4, 0.0, 0.0]
    return solve_ivp(slope, (0, duration), start, "DOP853", rtol=1e-13, atol=1e-14).y[:2, -1]


@pytest.mark.parametrize(
    ("method", "value", "off"),
    [("dop853", 1e-13, 1e-9), ("energy_momentum", 2e-3, 1e-3), ("cvodes", 1e-10, 1e-6)],
)  # fmt: skip
def test_double_pendulum(method, value, off):
    structure = double_pendulum()
    equation = tc.Model(structure, gravity=9.8).equation("force_density")
    x = pack_state(structure, structure.nodes, np.zeros((2, 3)))
    span = METHODS[method].integrator(equation, value).advance(x, np.zeros(0), 5.0, 1)
    a, b = double_pendulum_angles(5.0)
    tip = [np.sin(a), -np.cos(a), np.sin(a) + np.sin(b), -np.cos(a) - np.cos(b)]
    np.testing.assert_allclose(span.states[:4, -1], tip, rtol=0, atol=off)


@pytest.mark.parametrize(("method", "value"), [("dop853", 1e-13), ("rk4", 1e-3)])
@pytest.mark.parametrize("count", [4, 5])
def test_a_rigid_body_turns_by_eulers_equations(method, value, count):
    """A tetrahedron of 6 bars, and a body of 10 bars on 5 nodes, of which 9 hold it."""
    nodes = np.array([[1, -0.5, -0.5, 0, 0.3], [0, 0.9, -0.9, 0.1, 0.2], [0, 0.1, 0, 1.1, -0.7]])
    nodes = nodes[:, :count]
    bars = [(i, j) for i in range(count) for j in range(i)]
    body = tc.Structure(nodes, bars, [], bar_mass=np.linspace(0.5, 1.5, len(bars)))
    M = tc.structure.blocks.node_mass(body).toarray()
    arms = nodes - (nodes @ M).sum(axis=1, keepdims=True) / M.sum()
    spread = arms @ M @ arms.T
    inertia = np.trace(spread) * np.eye(3) - spread
    spin, drift = np.array([0.4, 2.0, -0.3]), np.array([[0.1], [-0.2], [0.3]])

    def slope(_, state):
        """Of the rotation matrix and the angular velocity in the axes of the body."""
        R, w = state[:9].reshape(3, 3), state[9:]
        skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        turn = np.linalg.solve(inertia, np.cross(inertia @ w, w))
        return np.concatenate([(R @ skew).ravel(), turn])

    start = np.concatenate([np.eye(3).ravel(), spin])
    R = solve_ivp(slope, (0, 2.0), start, "DOP853", rtol=1e-13, atol=1e-13).y[:9, -1]
    exact = R.reshape(3, 3) @ arms + (nodes - arms) + 2.0 * drift
    velocities = np.cross(spin, arms.T).T + drift
    equation = tc.Model(body).equation("force_density")
    x = pack_state(body, nodes, velocities)
    span = METHODS[method].integrator(equation, value).advance(x, np.zeros(0), 2.0, 1)
    found = unpack_states(body, span.states)[0][:, :, -1]
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)


def test_a_ladder_slides_on_two_rollers():
    """The ends run along x and y: θ̈ = −(3 g / 2 l) cos θ."""
    start = np.deg2rad(60.0)
    nodes = [[np.cos(start), 0.0], [0.0, np.sin(start)]]
    ladder = tc.Structure(nodes, [[0, 1]], [], bar_mass=1.0, fixed=[(0, "y"), (1, "x")])
    equation = tc.Model(ladder, gravity=9.8).equation("force_density")
    slope = lambda _, y: [y[1], -1.5 * 9.8 * np.cos(y[0])]  # noqa: E731
    angle = solve_ivp(slope, (0, 0.5), [start, 0.0], "DOP853", rtol=1e-13, atol=1e-13).y[0, -1]
    x = pack_state(ladder, ladder.nodes, np.zeros((2, 2)))
    assert len(x) == 4
    for method, value in (("dop853", 1e-12), ("rk4", 0.001)):
        span = METHODS[method].integrator(equation, value).advance(x, np.zeros(0), 0.5, 1)
        exact = [np.cos(angle), np.sin(angle)]
        np.testing.assert_allclose(span.states[:2, -1], exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("method", "value", "off"),
    [("rk4", 1e-3, 1e-9), ("dop853", 1e-12, 1e-9), ("cvodes", 1e-10, 1e-6),
     ("energy_momentum", 1e-3, 1e-4)],
)  # fmt: skip
def test_atwoods_machine(method, value, off):
    """Two masses on rollers hang by one string over a fixed pulley: its stretch is a spring's."""
    masses, k, g = (2.0, 1.0), 50.0, 9.8
    machine = tc.Structure(
        [[0, 0, 0.0], [-1.0, 0.0, -2.0]], [], [(0, 1, 2)], [],
        fixed=[1, (0, "x"), (2, "x")], point_mass=[masses[0], 0, masses[1]],
    )  # fmt: skip
    model = tc.Model(machine, strings=tc.LinearStrings(k), gravity=g)
    x = pack_state(machine, machine.nodes, np.zeros((2, 3)))
    rest = 2.9
    span = (
        METHODS[method]
        .integrator(model.equation("rest_length"), value)
        .advance(x, np.array([rest]), 0.4, 1)
    )
    # The length swings about the one at which both masses fall alike; the centre falls by g − 2T/m.
    both = 1 / masses[0] + 1 / masses[1]
    omega, still = np.sqrt(k * both), 2 * g / both / k
    stretch = still + (3.0 - rest - still) * np.cos(omega * 0.4)
    impulse = k * still * 0.4 + k * (3.0 - rest - still) * np.sin(omega * 0.4) / omega
    twice = k * still * 0.08 + k * (3.0 - rest - still) * (1 - np.cos(omega * 0.4)) / omega**2
    exact = [-1.0 - g * 0.08 + twice / masses[0], -2.0 - g * 0.08 + twice / masses[1]]
    assert abs(-(exact[0] + exact[1]) - rest - stretch) < 1e-12
    rates = [impulse / mass - g * 0.4 for mass in masses]
    np.testing.assert_allclose(span.states[:, -1], exact + rates, rtol=0, atol=off)


@pytest.mark.parametrize("method", METHODS)
def test_in_the_plane_the_motion_is_that_in_space(method):
    flat = coupled_scenes.d_bar()
    nodes = np.vstack([flat.nodes, np.zeros(4)])
    space = tc.Structure(nodes, flat.bars, flat.strings, bar_mass=flat.bar_mass)
    velocities = coupled_scenes.possible_velocities(flat, 3)
    found = []
    for structure in (flat, space):
        model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS))
        V = np.zeros_like(structure.nodes)
        V[:2] = velocities
        x = pack_state(structure, structure.nodes, V)
        value = 5e-3 if METHODS[method].setting == "step" else 1e-10
        integrator = METHODS[method].integrator(model.equation("rest_length"), value)
        states = integrator.advance(x, flat.string_length(), 0.3, 1).states
        found.append(unpack_states(structure, states)[0][:, :, -1])
    off = 1e-8 if METHODS[method].setting == "tolerance" else 1e-12
    np.testing.assert_allclose(found[1][:2], found[0], rtol=0, atol=off)
    assert np.abs(found[1][2]).max() < 1e-13


# ---- what is conserved ----


@pytest.mark.parametrize("name", ["d_bar", "tower"])
def test_a_free_structure_keeps_momentum_and_bars(name):
    structure, model, equation, lengths = scene(name, gravity=None)
    x = moving(structure)
    span = METHODS["energy_momentum"].integrator(equation, 5e-3).advance(x, lengths, 2.0, 40)
    states = np.column_stack([x, span.states])
    linear, angular = evaluate_columns(model.momentum, states)
    assert np.abs(linear - linear[:, :1]).max() < 1e-12
    assert np.abs(angular - angular[:, :1]).max() < 1e-12
    assert max(errors_of_bars(structure, states)) < 1e-14


@each_scene
@pytest.mark.parametrize("held", ["rest_length", "force_density"])
def test_energy_momentum_keeps_energy(name, held):
    structure, model, _, lengths = scene(name, gravity=None)
    u = lengths if held == "rest_length" else np.full(len(lengths), 10.0)
    x = moving(structure)
    span = METHODS["energy_momentum"].integrator(model.equation(held), 0.01).advance(x, u, 1.0, 20)
    states = np.column_stack([x, span.states])
    stored = model.elastic_energy if held == "rest_length" else model.potential_energy
    inputs = np.tile(u[:, None], (1, states.shape[1]))
    energy = (
        evaluate_columns(stored, states, inputs)[0]
        + evaluate_columns(model.kinetic_energy, states)[0]
    )
    assert np.ptp(energy) < 1e-12 * energy.max()
    assert max(errors_of_bars(structure, states)) < 1e-13


def test_energy_momentum_chooses_its_steps_and_damping_only_takes_energy():
    structure, model, equation, lengths = scene("mixed", damping=1.0, gravity=None)
    x = moving(structure)
    exact = METHODS["dop853"].integrator(equation, 1e-12).advance(x, lengths, 1.0, 1)
    integrator = METHODS["energy_momentum"].integrator(equation, 1e-6, "tolerance")
    span = integrator.advance(x, lengths, 1.0, 50)
    assert np.abs(span.states[:, -1] - exact.states[:, -1]).max() < 1e-3
    states = np.column_stack([x, span.states])
    inputs = np.tile(lengths[:, None], (1, states.shape[1]))
    energy = evaluate_columns(model.elastic_energy, states, inputs)[0]
    energy = energy + evaluate_columns(model.kinetic_energy, states)[0]
    assert np.diff(energy[0]).max() < 1e-12


# ---- projection ----


@each_scene
def test_projection_makes_bars_exact_and_stays_there(name):
    structure = SCENES[name]()
    function = project(structure)
    x = moving(structure)
    np.testing.assert_allclose(function(x).full().ravel(), x, rtol=0, atol=1e-14)
    off = x + 1e-3 * np.random.default_rng(1).normal(size=len(x))
    near = function(off).full()
    assert max(errors_of_bars(structure, near)) < 1e-14
    assert np.abs(near.ravel() - off).max() < 1e-2
    np.testing.assert_allclose(function(near).full(), near, rtol=0, atol=1e-14)


def weighted_bar():
    """One bar with a point mass on an end: no inertia about its own line."""
    nodes = [[0.1, 0.6], [0.2, -0.3], [0.3, 0.7]]
    return tc.Structure(nodes, [[0, 1]], [], bar_mass=1.0, point_mass=[0.4, 0])


@pytest.mark.parametrize("make", [coupled_scenes.d_bar, coupled_scenes.tower, weighted_bar])
def test_projection_keeps_momenta_of_what_is_free(make):
    structure = make()
    momentum = tc.Model(structure).momentum
    x = moving(structure) + 1e-3 * np.random.default_rng(1).normal(size=2 * structure.nodes.size)
    before, after = (evaluate_columns(momentum, each) for each in (
        x[:, None], project(structure)(x).full()
    ))  # fmt: skip
    np.testing.assert_allclose(after[0], before[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(after[1], before[1], rtol=0, atol=1e-14)


def test_rk4_is_projected_without_loss_of_order():
    structure, _, equation, lengths = scene("tower")
    x = moving(structure)
    exact = METHODS["dop853"].integrator(equation, 1e-13).advance(x, lengths, 0.6, 1).states
    steps, errors = np.array([0.01, 0.005, 0.0025]), []
    for step in steps:
        integrator = METHODS["rk4"].integrator(equation, step, project=True)
        span = integrator.advance(x, lengths, 0.6, 1)
        errors.append(np.abs(span.states - exact).max())
        assert max(errors_of_bars(structure, span.states)) < 1e-14
    assert fitted_order(steps, errors) > 3.5


def test_what_cannot_be_projected_is_no_number():
    structure = coupled_scenes.d_bar()
    x = moving(structure)
    x[:8] *= 3.0
    assert np.isnan(project(structure)(x).full()).any()


# ---- steps that are too long, and counts ----


def test_a_step_that_is_too_long_is_shortened():
    structure = double_pendulum()
    equation = tc.Model(structure, gravity=9.8).equation("force_density")
    velocities = np.array([[0, 20.0, 40.0], [0, 20.0, 40.0]])
    x = pack_state(structure, structure.nodes, velocities)
    span = METHODS["energy_momentum"].integrator(equation, 1.0).advance(x, np.zeros(0), 1.0, 1)
    assert span.work.rejections
