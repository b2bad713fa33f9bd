"""Controllers and filters of structures some of whose strings are driven."""

import warnings

import control
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import lsq_linear

import tenscontrol as tc
from tenscontrol.actuation.driven_strings import actuation_of, strings_of
from tests.plant.test_actuated import PAIRS

SAMPLE = 0.02
TOWER = tc.prism_tower(stages=2)
MODEL = tc.Model(TOWER, strings=tc.LinearStrings(stiffness=500.0, damping=2.0))
REST = tc.prestress(TOWER, min_force_density=20.0)


def tower_plant(actuated=None, input="rest_length"):
    return tc.linearize(MODEL, REST, input=input, actuated=actuated)


LAYOUTS = {"twelve": list(range(12)), "pairs": PAIRS, "seesaws": {"a": {0: 1.0, 5: -1.0}, "b": [9]}}
every_layout = pytest.mark.parametrize("layout", LAYOUTS)
SOME = tower_plant(LAYOUTS["twelve"])


def sampled_by_hand(plant, sample):
    """Return Φ and Γ of the driven columns, from the whole plant."""
    whole = tower_plant()
    B = whole.B @ plant.actuation.matrix.toarray()
    n, m = B.shape
    block = expm(sample * np.block([[whole.A, B], [np.zeros((m, n + m))]]))
    return block[:n, :n], block[:n, n:]


def pushed(plant, size=0.01, seed=0):
    q = np.random.default_rng(seed).normal(size=plant.degrees_of_freedom)
    return plant.to_nodes(size * q / np.linalg.norm(q))


@every_layout
def test_regulators_are_those_of_the_driven_columns(layout):
    plant = tower_plant(LAYOUTS[layout])
    Q, R = tc.energy_weights(plant)
    K = control.lqr(plant.A, tower_plant().B @ plant.actuation.matrix.toarray(), Q, np.diag(R))[0]
    regulator = tc.LQR(plant, Q, R)
    np.testing.assert_allclose(regulator.gain, K, rtol=0, atol=1e-9 * np.abs(K).max())
    assert (regulator.poles.real < 0).all()
    nodes, still = pushed(plant), np.zeros_like(BALL_NODES)
    u = plant.equilibrium_input - K @ plant.measure(nodes, still)
    command = regulator.command(0.0, nodes, still)
    expected = plant.rest_length + plant.actuation.matrix @ (u - plant.equilibrium_input)
    np.testing.assert_allclose(command.value, expected, atol=1e-9)


BALL_NODES = REST.structure.nodes


@every_layout
@pytest.mark.parametrize("winches", [None, tc.Winches(rate=0.3, substeps=4)])
def test_the_loop_on_the_nonlinear_plant_decays_and_leaves_passive_strings_alone(layout, winches):
    plant = tower_plant(LAYOUTS[layout])
    regulator = tc.LQR(plant, sample_time=SAMPLE, winches=winches)
    run = tc.simulate(
        MODEL, 3.0, pushed(plant), controller=regulator, winches=winches,
        rest_length=plant.rest_length,
    )  # fmt: skip
    applied, actuation = run.control.applied, plant.actuation
    fixed = plant.rest_length[actuation.passive, None]
    np.testing.assert_array_equal(applied[actuation.passive], fixed + 0 * applied[:1])
    through = actuation.strings(actuation.inputs(applied))
    np.testing.assert_allclose(applied, through, rtol=0, atol=1e-12)
    assert np.ptp(applied[actuation.driven], axis=1).min() > 1e-6
    z = plant.measure(run.nodes[..., -1], run.velocities[..., -1])
    radius = np.abs(regulator.poles).max()
    assert np.abs(z).max() < 50 * radius ** (3.0 / SAMPLE) * plant.spectral_radius * 0.01 + 1e-4
    if winches is not None:
        assert np.abs(run.control.winch_rate).max() <= 0.3 * (1 + 1e-9)


@every_layout
def test_the_first_input_of_mpc_is_that_of_a_program_of_the_driven_columns(layout):
    """Condensed by hand, within bounds on the inputs alone, by an exact active set."""
    plant, horizon = tower_plant(LAYOUTS[layout]), 8
    Q, R = tc.energy_weights(plant)
    R = 0.01 * R
    span = 0.0005
    winches = tc.Winches(shortest=plant.rest_length - span, longest=plant.rest_length + span)
    mpc = tc.MPC(
        plant, horizon=horizon, sample_time=SAMPLE, Q=Q, R=R, winches=winches, string_penalty=1e-9
    )
    phi, gamma = sampled_by_hand(plant, SAMPLE)
    n, m = gamma.shape
    P = solve_discrete_are(phi, gamma, Q, np.diag(R))
    rows, right = [], []
    z = plant.measure(pushed(plant), np.zeros_like(BALL_NODES))
    by_u = np.zeros((n, m * horizon))
    for k in range(horizon):
        by_u, z = phi @ by_u, phi @ z
        by_u[:, m * k : m * k + m] += gamma
        root = np.linalg.cholesky(P if k == horizon - 1 else Q).T
        rows.append(root @ by_u)
        right.append(-root @ z)
    rows.append(np.diag(np.tile(np.sqrt(R), horizon)))
    right.append(np.zeros(m * horizon))
    low, high = (bound - plant.equilibrium_input for bound in mpc.bounds)
    bounds = np.tile(low, horizon), np.tile(high, horizon)
    found = lsq_linear(np.vstack(rows), np.concatenate(right), bounds, method="bvls", tol=1e-14)
    assert (found.active_mask[:m] != 0).any()
    command = mpc.command(0.0, pushed(plant), np.zeros_like(BALL_NODES))
    assert str(command) == "ok"
    v = plant.actuation.inputs(command.value) - plant.equilibrium_input
    close = 1e-9 if mpc.solver == "stages" else 2e-4 * span
    np.testing.assert_allclose(v, found.x[:m], rtol=0, atol=close)


def test_a_program_of_mpc_has_limits_of_all_strings_and_inputs_of_the_driven():
    mpc = tc.MPC(SOME, horizon=5, sample_time=SAMPLE, max_force_density=500.0)
    program = mpc.program(0.0, BALL_NODES, np.zeros_like(BALL_NODES))
    assert program.inputs(np.zeros(program.P.shape[0])).shape[-1] in (12, 5)
    assert mpc.plan.shape == (12, 0)
    mpc.command(0.0, BALL_NODES, np.zeros_like(BALL_NODES))
    assert mpc.plan.shape == (12, 5)


@pytest.mark.parametrize("kind", [tc.LQR, tc.MPC])
def test_force_densities_of_ganged_strings_stay_within_their_bounds(kind):
    single = {f"s{i}": [i] for i in range(13, len(TOWER.strings))}
    plant = tower_plant({"a": {0: 1.0, 5: -0.5}, "b": [9, 12]} | single, input="force_density")
    options = {"sample_time": SAMPLE, "max_force_density": 130.0}
    law = kind(plant, **options | ({"horizon": 10} if kind is tc.MPC else {}))
    random = np.random.default_rng(1)
    for _ in range(20):
        nodes = pushed(plant, 0.2, int(random.integers(99)))
        value = law.command(0.0, nodes, np.zeros_like(nodes)).value
        driven = plant.actuation.driven
        assert (value[driven] >= -1e-12).all()
        assert (value[driven] <= 130.0 + 1e-9).all()
        np.testing.assert_array_equal(
            value[plant.actuation.passive], plant.force_density[plant.actuation.passive]
        )


def test_a_filter_on_driven_strings_predicts_what_the_plant_does():
    sensors = tc.Sensors(structure=REST.structure, node_position=1e-3, string_length=1e-3)
    estimator = tc.KalmanFilter(SOME, sensors, sample_time=SAMPLE)
    regulator = tc.LQR(SOME, sample_time=SAMPLE)
    run = tc.simulate(
        MODEL, 1.0, pushed(SOME), controller=regulator, estimator=estimator, seed=1,
        rest_length=SOME.rest_length,
    )  # fmt: skip
    whole = tc.KalmanFilter(tower_plant(), sensors, sample_time=SAMPLE)
    other = tc.simulate(
        MODEL, 1.0, pushed(SOME), controller=regulator, estimator=whole, seed=1,
        rest_length=SOME.rest_length,
    )  # fmt: skip
    np.testing.assert_allclose(run.nodes, other.nodes, atol=1e-9)
    fewer = tc.KalmanFilter(tower_plant([0, 1]), sensors, sample_time=SAMPLE)
    with pytest.raises(ValueError, match="moves strings in other ways: give linearize the same"):
        tc.simulate(MODEL, 0.1, controller=regulator, estimator=fewer)


def test_winches_that_cannot_move_are_no_inputs():
    shortest, longest = 0.5 * SOME.rest_length, 2.0 * SOME.rest_length
    shortest[3] = longest[3] = SOME.rest_length[3]
    winches, match = tc.Winches(shortest=shortest, longest=longest), "driven, so that a design"
    with pytest.raises(ValueError, match=match):
        tc.LQR(SOME, sample_time=SAMPLE, winches=winches)
    with pytest.raises(ValueError, match=match):
        tc.MPC(SOME, horizon=5, sample_time=SAMPLE, winches=winches)
    regulator = tc.LQR(SOME, sample_time=SAMPLE)
    with pytest.raises(ValueError, match=match):
        tc.simulate(MODEL, 0.1, controller=regulator, winches=winches)
    tc.LQR(tower_plant(range(4, 12)), sample_time=SAMPLE, winches=winches)


def test_what_passive_or_ganged_strings_do_not_have_is_refused():
    by_force = tc.LQR(tower_plant(range(12), "force_density"), sample_time=SAMPLE)
    with pytest.raises(ValueError, match="passive strings would not keep their γ"):
        tc.simulate(MODEL, 0.1, controller=by_force)
    with pytest.raises(ValueError, match="passive strings that hold rest lengths"):
        tc.control.held_loop(by_force.plant, by_force.gain, sample_time=SAMPLE)
    motors = tc.Winches(motor=tc.Motor(drum_radius=0.01, torque=5.0))
    start = {"rest_length": SOME.rest_length, "winches": motors}
    regulator = tc.LQR(SOME, sample_time=SAMPLE)
    run = tc.simulate(MODEL, 0.1, controller=regulator, **start)
    assert len(run.control.motors.angle) == 12
    with pytest.raises(ValueError, match="of string 20, which no winch drives"):
        tc.simulate(MODEL, 0.1, controller=regulator, faults=[tc.StuckWinch(20, 0.05)])


@every_layout
def test_nonlinear_mpc_near_the_operating_point_is_linear_mpc(layout):
    plant = tower_plant(LAYOUTS[layout])
    options = {"horizon": 6, "sample_time": SAMPLE}
    laws = [kind(plant, **options) for kind in (tc.MPC, tc.NMPC)]
    nodes = pushed(plant, 1e-5)
    values = [law.command(0.0, nodes, np.zeros_like(nodes)).value for law in laws]
    moves = [value - plant.rest_length for value in values]
    np.testing.assert_allclose(moves[1], moves[0], rtol=0, atol=2e-2 * np.abs(moves[0]).max())
    np.testing.assert_array_equal(moves[1][plant.actuation.passive], 0.0)


def test_a_tower_whose_design_for_all_strings_fails_on_the_driven_ones():
    """Winches held still behind the design: its poles say one thing, the loop does another."""
    model = tc.Model(TOWER, strings=tc.LinearStrings(stiffness=500.0))
    whole = tc.linearize(model, REST, input="rest_length")
    Q, R = tc.energy_weights(whole)
    law = tc.LQR(whole, Q, 0.01 * R, sample_time=SAMPLE)
    phi, gamma, _ = whole.discretize(SAMPLE)
    random, found = np.random.default_rng(0), []
    for _ in range(100):
        driven = np.sort(random.permutation(len(TOWER.strings))[:12])
        loop = phi - gamma[:, driven] @ law.gain[driven]
        found.append((np.abs(np.linalg.eigvals(loop)).max(), driven))
    grows, driven = max(found, key=lambda entry: entry[0])
    assert np.abs(law.poles).max() < 0.3
    assert grows > 1.0
    plant = tc.linearize(model, REST, input="rest_length", actuated=driven)
    own = tc.LQR(plant, Q, 0.01 * R[driven], sample_time=SAMPLE)
    assert np.abs(own.poles).max() < 0.92
    start, still = pushed(plant, 1e-4), np.zeros_like(BALL_NODES)
    options = {"controller": own, "rest_length": plant.rest_length}
    states = []
    for duration in (1.0, 2.0):
        run = tc.simulate(model, duration, start, **options)
        states.append(plant.measure(run.nodes[..., -1], run.velocities[..., -1]))
    closed = plant.discretize(SAMPLE)
    step = np.linalg.matrix_power(closed[0] - closed[1] @ own.gain, round(1.0 / SAMPLE))
    unit = np.repeat([plant.spectral_radius, 1.0], plant.degrees_of_freedom)
    first = np.linalg.norm(unit * plant.measure(start, still))
    assert np.linalg.norm(unit * (states[1] - step @ states[0])) < 0.01 * first


@every_layout
def test_mpc_reaches_a_shape_that_its_winches_hold(layout):
    """The inputs that hold the shape are found; passive strings stay."""
    plant = tower_plant(LAYOUTS[layout])
    u = plant.equilibrium_input - 0.02
    shape = tc.equilibrium(MODEL, rest_length=plant.actuation.strings(u), nodes=BALL_NODES)
    nodes = shape.structure.nodes
    mpc = tc.MPC(plant, horizon=20, sample_time=SAMPLE, reference=nodes)
    run = tc.simulate(MODEL, 6.0, controller=mpc, rest_length=plant.rest_length)
    applied = run.control.applied[:, -1]
    np.testing.assert_allclose(plant.actuation.inputs(applied), u, atol=2e-3)
    z, wanted = (plant.measure(N, np.zeros_like(N)) for N in (run.nodes[..., -1], nodes))
    assert np.abs(z - wanted).max() < 0.1 * np.abs(wanted).max()


def test_a_reference_that_moves_passive_strings_is_refused():
    gamma = 1.2 * REST.force_density
    reference = tc.Reference([0.0, 1.0], np.stack([BALL_NODES] * 2, -1), np.stack([gamma] * 2, -1))
    with pytest.raises(ValueError, match="but the string is passive: leave force_density out"):
        tc.MPC(SOME, horizon=5, sample_time=SAMPLE, reference=reference)


@pytest.mark.parametrize("ramp", [False, True])
def test_a_function_commands_what_is_driven(ramp):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
    start = 0.97 * model.structure.string_length()
    groups = {"lid": ["top"], "side": {6: 1.0, 7: -0.5}}
    told = []

    class Law:
        input, sample_time = "rest_length", 0.02

        def command(self, time, nodes, velocities):
            return [start[0] + 0.02, start[6] - 0.03]

        def applied(self, value):
            told.append(value)

    own = tc.FunctionController(model.structure, Law(), actuated=groups)
    run = tc.simulate(
        model, 0.1, controller=own, rest_length=start, winches=tc.Winches(rate=10.0, ramp=ramp)
    )
    wound = run.control.applied[:, -1] - start
    expected = np.array([0.02] * 3 + [0.0] * 3 + [-0.03, 0.015, 0.0])
    assert np.allclose(wound, expected, rtol=0, atol=1e-12)
    assert np.allclose(told[-1], [start[0] + 0.02, start[6] - 0.03])
    with pytest.raises(ValueError, match=r"has shape \(9,\), expected \(2,\)"):
        tc.FunctionController(
            model.structure, lambda t, N, V: start, input="rest_length", actuated=groups
        ).command(0.0, model.structure.nodes, 0 * model.structure.nodes)
    with pytest.raises(ValueError, match="equilibrium_input, γ of all strings"):
        tc.FunctionController(
            model.structure, Law().command, input="force_density", actuated=groups
        )
    held = tc.FunctionController(
        model.structure, lambda t, N, V: [20.0, 31.0], input="force_density", sample_time=0.02,
        actuated=[6, 0], equilibrium_input=17.0,
    )  # fmt: skip
    gamma = held.command(0.0, model.structure.nodes, 0 * model.structure.nodes).value
    assert gamma.tolist() == [31.0, 17.0, 17.0, 17.0, 17.0, 17.0, 20.0, 17.0, 17.0]


@pytest.mark.parametrize(
    ("gravity", "what"), [(9.81, r"grows by a factor e in 0.26 s"), (None, "drifts")]
)
def test_mpc_says_where_no_law_within_its_bounds_can_hold_a_shape(gravity, what):
    """An upright rod of pole √(3g/2L), between slack strings that can only pull."""
    rod = tc.Structure(
        [[0.0, 0.0, -1.0, 1.0], [0.0, 1.0, 0.0, 0.0]], [[0, 1]], [[1, 2], [1, 3]], 1.0,
        fixed=[0, 2, 3],
    )  # fmt: skip
    model = tc.Model(rod, gravity=gravity)
    rest = tc.prestress(rod, force_density=[0.0, 0.0], external_force=model.constant_force)
    one, both = tc.linearize(model, rest, actuated=[0]), tc.linearize(model, rest)
    for kind in (tc.MPC, tc.control.NMPC):
        with pytest.warns(tc.control.ControlWarning, match=f"{what} one way only, so no law"):
            kind(one, horizon=8, sample_time=SAMPLE)
        kind(both, horizon=8, sample_time=SAMPLE)  # held from both sides


def test_mpc_says_where_its_horizon_is_too_short_for_strings_that_only_pull():
    """An upright rod among three slack strings: what two of them share is left to a long horizon.

    A law of inputs that go both ways has no sense of that: the loop falls as the warning says.
    """
    angle = np.radians([0.0, 100.0, 200.0])
    feet = np.array([np.cos(angle), np.sin(angle), 0 * angle])
    rod = tc.Structure(
        np.c_[np.zeros(3), [0.0, 0.0, 1.0], feet], [[0, 1]], [[1, 2], [1, 3], [1, 4]], 1.0,
        fixed=[0, 2, 3, 4],
    )  # fmt: skip
    model = tc.Model(rod, gravity=9.81)
    rest = tc.prestress(rod, force_density=np.zeros(3), external_force=model.constant_force)
    plant = tc.linearize(model, rest)
    start, ends = plant.to_nodes([1e-6, 2e-6]), []
    for horizon, said in ((4, ["horizon of 4 samples does not hold", "is unstable"]), (40, [])):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            mpc = tc.MPC(plant, horizon=horizon, sample_time=0.02)
            run = tc.simulate(
                model, 4.0, start, controller=mpc, input="force_density", error="none"
            )
        assert len(told) == len(said)
        assert all(part in str(each.message) for part, each in zip(said, told, strict=True))
        ends.append(np.abs(run.nodes[..., -1] - rod.nodes).max())
    assert ends[0] > 1e-3
    assert ends[1] < 1e-7


def test_mpc_holds_by_inputs_that_go_both_ways_whatever_its_horizon():
    """P is the cost of the law of those that hold the plant alone, by python-control."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=1.0))
    plant = tc.linearize(model, tc.prestress(prism, force_density=10.0))
    most = np.full(9, 100.0)
    most[[0, 4]] = plant.equilibrium_input[[0, 4]]  # which cannot pull more
    Q, R = tc.plant.natural_weights(plant)
    mpc = tc.MPC(plant, horizon=1, sample_time=SAMPLE, max_force_density=most)
    phi, gamma, _ = plant.discretize(SAMPLE)
    free = [1, 2, 3, 5, 6, 7, 8]
    expected = control.dlqr(phi, gamma[:, free], Q, np.diag(R[free]))[1]
    P = mpc.law.design.problem.terminal_weight
    assert np.allclose(P, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_a_string_that_a_gang_takes_to_zero_is_not_past_it():
    """Where the sum of what it has and what it gets cancels, but for round-off."""
    prism, random = tc.prism(), np.random.default_rng(0)
    ended = []
    for _ in range(100):
        held = random.uniform(0.1, 50.0, 9)
        gang = {"pair": {0: 1.0, 1: -random.uniform(0.5, 1.5)}}
        actuation = actuation_of(prism, gang, held)
        takes = held[0] + held[1] / -gang["pair"][1]
        ended.append(strings_of(actuation, np.array([takes]))[1])
    assert min(ended) == max(ended) == 0.0
