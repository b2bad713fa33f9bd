"""Inputs, loads and supports that change in time, against an oracle that ends at each kink."""

from functools import cache

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.profile import as_pieces
from tenscontrol.integrate import Method
from tenscontrol.integrate.dop853 import _DormandPrince
from tenscontrol.integrate.fixed_step import FixedStep
from tenscontrol.integrate.methods import METHODS
from tenscontrol.simulation.faults import Faults
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.plant_run import PlantRun
from tests.integrate.coupled_scenes import arm, mixed, spine
from tests.known_structures import clustered_d_bar
from tests.marks import needs_core
from tests.oracle import string_motion
from tests.simulation.piecewise import Moving, constant

TIME = np.array([0.0, 0.1, 0.2, 0.3])
APART = np.stack([np.zeros((3, 3)), np.eye(3)], axis=2)
STIFFNESS = 400.0


def scene(structure, amplitude=0.25, stiffness=STIFFNESS, **options):
    """A model, and rest lengths over time that let strings go slack."""
    gamma = tc.prestress(structure, force_density=stiffness / 20).force_density
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness), **options)
    lengths = tc.to_rest_length(model, structure.nodes, gamma).rest_length
    random = np.random.default_rng(1)
    moved = random.uniform(-amplitude, amplitude, (len(lengths), len(TIME)))
    moved[:, 0] = 0.0
    return model, lengths[:, None] * (1 + moved)


def at_rest(structure):
    return pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))


def end(run):
    return pack_state(run.structure, run.nodes[:, :, -1], run.velocities[:, :, -1])


def hinged_prism():
    prism = tc.prism()
    return tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3, 4, 5])


STRUCTURES = {
    "ball": lambda: tc.library.six_bar_ball(bar_length=1.0),
    "tower": tc.library.class2_tower,
    "D-bar": tc.library.d_bar,
    "clustered": clustered_d_bar,
}


@pytest.fixture(scope="module")
def exact():
    """Model, profile, state at the end and switches of a structure, found once."""
    kept = {}

    def find(name, interpolation):
        if (name, interpolation) not in kept:
            stiffness = STIFFNESS if name == "ball" else 100.0
            model, values = scene(STRUCTURES[name](), stiffness=stiffness)
            profile = tc.Profile(TIME, values, interpolation)
            oracle = Moving(model.structure, stiffness, profile.at)
            state, switches = oracle.integrated(at_rest(model.structure), TIME)
            kept[name, interpolation] = model, profile, state, switches
        return kept[name, interpolation]

    return find


# ---- rest lengths ----


@pytest.mark.parametrize(
    ("name", "interpolation"),
    [
        ("ball", "cubic"),
        ("tower", "linear"),
        ("D-bar", "cubic"),
        *(("clustered", kind) for kind in ("hold", "linear", "cubic")),
    ],
)
def test_rest_lengths_follow_a_profile(exact, name, interpolation):
    model, profile, state, switches = exact(name, interpolation)
    run = tc.simulate(model, 0.3, rest_length=profile, tolerance=1e-11)
    assert np.abs(end(run) - state).max() < 1e-9
    # Those that a jump switches are not counted, nor a string at its border as a piece begins.
    assert run.work.switches == switches > 20 or (name, interpolation) != ("ball", "cubic")
    assert not run.conserves_energy
    assert run.health.energy_error is None
    inner = ~np.isin(run.time, TIME)
    np.testing.assert_allclose(
        run.rest_length[:, inner], profile.at(run.time[inner]), rtol=1e-13, atol=1e-15
    )
    # At a jump it is what acted up to there.
    before = profile.at(0.2 - 1e-12)
    np.testing.assert_allclose(run.rest_length[:, np.isclose(run.time, 0.2)][:, 0], before, 1e-10)


class _FixedDOP853(FixedStep):
    """The steps of DOP853, all of one length."""

    name = "fixed dop853"
    evaluations_per_step = 12

    def step_function(self, equation):
        x, u, taut, h = equation.symbols(ca.MX)
        size = ca.DM.ones(equation.states)
        end = _DormandPrince(equation).tried()(x, equation.slope(x, u, taut), u, taut, h, size)[0]
        return ca.Function("dop853", [x, u, taut, h], [end])


FIXED_DOP853 = Method("fixed", ("step",), "steps of one length", _FixedDOP853, follows=True)
ORDERS = [
    ("rk4", (50, 100, 200), 3.8),
    ("rk4_plain", (50, 100, 200), 1.8),
    (
        Method("fixed", ("step",), "of one length", _FixedDOP853, follows=True),
        (5, 6, 8, 10, 12),
        7.5,
    ),
    ("energy_momentum", (32, 64, 128), 1.9),
]


@pytest.mark.parametrize(("method", "steps", "least"), ORDERS)
def test_methods_keep_their_order_through_profiles_and_switches(exact, method, steps, least):
    model, profile, state, _ = exact("ball", "cubic")
    errors = []
    for count in steps:
        run = tc.simulate(
            model, 0.3, rest_length=profile, step=0.1 / count, method=method, output_step=0.1
        )
        errors.append(np.abs(end(run) - state)[:36].max())
    assert -np.polyfit(np.log(steps), np.log(errors), 1)[0] > least


@pytest.mark.parametrize("name", ["tower", "D-bar", "clustered"])
@pytest.mark.parametrize(("method", "steps", "least"), [ORDERS[0]])
def test_orders_hold_for_any_structure(exact, name, method, steps, least):
    test_methods_keep_their_order_through_profiles_and_switches(
        lambda *_: exact(name, "cubic"), method, steps, least - 0.3
    )


@pytest.mark.parametrize(("tolerance", "most"), [(1e-6, 1e-3), (1e-10, 1e-6)])
def test_cvodes_follows_a_profile(exact, tolerance, most):
    model, profile, state, switches = exact("tower", "linear")
    run = tc.simulate(model, 0.3, rest_length=profile, tolerance=tolerance, method="cvodes")
    assert np.abs(end(run) - state).max() < most
    assert run.work.switches == switches


def test_damped_strings_follow_a_callable():
    structure = STRUCTURES["tower"]()
    _, values = scene(structure)
    damped = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS, 2.0))

    def rest(t):
        return values[:, 0] * (1 + 0.3 * np.sin(25 * t + np.arange(len(values))))

    oracle = Moving(structure, STIFFNESS, rest, damping=2.0)
    state, switches = oracle.integrated(at_rest(structure), [0.0, 0.3], 1e-12)
    run = tc.simulate(damped, 0.3, rest_length=rest, tolerance=1e-11)
    assert run.work.switches == switches > 5
    assert np.abs(end(run) - state).max() < 1e-9


def test_a_profile_that_does_not_move_is_a_held_input(prism):
    model, values = scene(prism)
    held = tc.simulate(model, 0.1, rest_length=values[:, 1], step=1e-3)
    same = tc.simulate(model, 0.1, rest_length=tc.Profile([0.0], values[:, 1:2]), step=1e-3)
    np.testing.assert_array_equal(same.nodes, held.nodes)
    assert same.conserves_energy


def test_force_densities_follow_a_profile(prism):
    values = 10.0 + 5.0 * np.random.default_rng(2).uniform(-1, 1, (9, 3))
    profile = tc.Profile([0.0, 0.1, 0.2], values)
    run = tc.simulate(tc.Model(prism), 0.2, force_density=profile, tolerance=1e-12)
    np.testing.assert_allclose(run.force_density[:, 1:-1], profile.at(run.time[1:-1]), rtol=1e-13)
    oracle = tc.simulate(tc.Model(prism), 0.2, force_density=profile, method="rk4", step=1e-4)
    assert np.abs(end(run) - end(oracle)).max() < 1e-10
    assert not run.conserves_energy


# ---- loads ----


@cache
def pushed_ball():
    """A sinusoidal load on a ball; its state after 0.2 s, and switches, by the oracle."""
    structure = STRUCTURES["ball"]()
    _, values = scene(structure, external_force=True)
    push = np.random.default_rng(4).uniform(-30, 30, structure.nodes.shape)

    def load(t):
        return push * np.sin(40 * t)

    oracle = Moving(structure, STIFFNESS, constant(values[:, 0]), load=load)
    return load, *oracle.integrated(at_rest(structure), [0.0, 0.2])


@pytest.mark.parametrize("method", ["rk4", "dop853", "energy_momentum"])
def test_a_sinusoidal_load(method):
    structure = STRUCTURES["ball"]()
    model, values = scene(structure, external_force=True)
    load, state, switches = pushed_ball()
    setting = {"rk4": {"step": 2e-4}, "energy_momentum": {"step": 4e-4}}
    run = tc.simulate(
        model, 0.2, rest_length=values[:, 0], external_force=load, method=method,
        **setting.get(method, {"tolerance": 1e-12}),
    )  # fmt: skip
    assert np.abs(end(run) - state).max() < {"energy_momentum": 1e-3}.get(method, 1e-8)
    assert run.work.switches == switches or method == "energy_momentum"
    length, _ = string_motion(structure, run.nodes[:, :, -1], run.velocities[:, :, -1])
    stored = 0.5 * STIFFNESS * (np.maximum(0, length - values[:, 0]) ** 2).sum()
    energy = stored - (load(0.2) * run.nodes[:, :, -1]).sum()
    assert run.potential_energy[-1] == pytest.approx(energy, rel=1e-9)
    assert not run.conserves_energy
    assert not run.conserves_momentum


@pytest.mark.parametrize("form", ["mapped", "loops"])
@pytest.mark.parametrize("make", [STRUCTURES["ball"], spine, arm, mixed])
def test_all_forms_take_inputs_that_move(make, form):
    structure = make()
    model = tc.Model(structure, strings=tc.LinearStrings(50.0, 0.1))
    options = {"degree": 2, "load_input": True, "offset_input": True}
    flat = model.equation("rest_length", form="flat", **options)
    other = model.equation("rest_length", form=form, **options)
    random = np.random.default_rng(5)
    c = random.uniform(-0.1, 0.1, (flat.layout.count, 3))
    c[: len(structure.strings), 0] += 0.9 * structure.string_length()
    u = flat.layout.packed(c, 0.01)
    x = at_rest(structure) + random.uniform(-0.1, 0.1, flat.states)
    taut = random.integers(0, 2, flat.switches).astype(float)
    q, v = np.split(x, 2)
    for name, given in (("slope", (x, u, taut)), ("gap", (x, u)), ("force", (q, v, u, taut))):
        pair = [getattr(each, name)(*given) for each in (flat, other)]
        for a, b in zip(*(p if isinstance(p, tuple) else (p,) for p in pair), strict=True):
            np.testing.assert_allclose(np.array(a), np.array(b), rtol=1e-10, atol=1e-10)


# ---- supports ----


def motion_of(structure, interpolation):
    d, count = structure.dimension, len(structure.fixed)
    values = np.random.default_rng(6).uniform(-0.05, 0.05, (d, count, len(TIME)))
    values[:, :, 0] = 0.0
    if structure.dimension == 2:  # of the arm: a roller holds y at the end of its bars
        values[1, 0] = 0.0
    profile = tc.Profile(TIME, values, interpolation)
    acceleration = profile.pieces.derivative(2)
    return profile, (
        profile.at,
        profile.rate,
        lambda t: acceleration.at(np.array([t]))[:, 0].reshape(d, count),
    )


@pytest.mark.parametrize(
    ("make", "interpolation"),
    [
        (hinged_prism, "linear"),
        (mixed, "cubic"),
        (spine, "linear"),
        (arm, "cubic"),
    ],
)
def test_supports_move(make, interpolation):
    """In linear motion the supports jump to a velocity at each kink: bars on them are struck."""
    structure = make()
    profile, supports = motion_of(structure, interpolation)
    lengths = 0.9 * structure.string_length()
    model = tc.Model(structure, strings=tc.LinearStrings(200.0, 0.1))
    oracle = Moving(structure, 200.0, constant(lengths), 0.1, supports=supports)
    state, switches = oracle.integrated(at_rest(structure), TIME, 1e-12)
    run = tc.simulate(model, 0.3, rest_length=lengths, support_motion=profile, tolerance=1e-11)
    assert np.abs(end(run) - state).max() < 1e-9
    assert run.work.switches == switches
    N, V = oracle.all_nodes(0.3 - 1e-13, state)
    np.testing.assert_allclose(run.nodes[:, :, -1], N, atol=1e-9)
    np.testing.assert_allclose(run.velocities[:, :, -1], V, atol=1e-8)
    assert np.abs(run.bar_length_error).max() < 1e-12
    momenta = V @ oracle.mass[:: structure.dimension, :: structure.dimension]
    assert run.kinetic_energy[-1] == pytest.approx((momenta * V).sum() / 2, rel=1e-8)
    np.testing.assert_allclose(run.momentum[:, -1], momenta.sum(axis=1), atol=1e-8)
    stretch = np.maximum(0, string_motion(structure, N, V)[0] - lengths)
    assert run.potential_energy[-1] == pytest.approx(100.0 * (stretch**2).sum(), rel=1e-8)
    assert not run.conserves_energy


def test_a_bar_whose_hinge_is_struck_turns_about_its_centre_of_percussion():
    """Across the bar its free end goes back by half; along it, it goes with the hinge."""
    bar = tc.Structure([[0.0, 1.0], [0.0, 0.0]], [[0, 1]], [], 2.0, fixed=[0])
    profile = tc.Profile([0.0, 1.0], [[[0.0, 0.2]], [[0.0, 0.5]]])
    run = tc.simulate(tc.Model(bar), 1e-3, force_density=[], support_motion=profile, step=1e-3)
    np.testing.assert_allclose(run.velocities[:, :, 0], [[0.2, 0.2], [0.5, -0.25]], atol=1e-13)


@pytest.mark.parametrize(
    ("make", "method"),
    [
        *((hinged_prism, name) for name in ("rk4", "energy_momentum")),
        (spine, "dop853"),
    ],
)
def test_shaking_the_whole_frame_is_an_inertial_load(make, method):
    structure = make()
    law = tc.LinearStrings(200.0)
    lengths = 0.9 * structure.string_length()
    way = np.linspace(0.02, -0.03, structure.dimension)[:, None]
    mass = Moving(structure, 1.0, None).mass[:: structure.dimension, :: structure.dimension]
    setting = {} if method == "dop853" else {"step": 2e-3}
    options = {"rest_length": lengths, "method": method, "output_step": 0.02, **setting}
    shaken = tc.simulate(
        tc.Model(structure, strings=law), 0.2, **options,
        support_motion=lambda t: np.repeat(way * (1 - np.cos(30 * t)), len(structure.fixed), 1),
    )  # fmt: skip
    loaded = tc.simulate(
        tc.Model(structure, strings=law, external_force=True), 0.2, **options,
        external_force=lambda t: -900 * np.cos(30 * t) * way * mass.sum(axis=1),
    )  # fmt: skip
    frame = way[:, :, None] * (1 - np.cos(30 * shaken.time))
    np.testing.assert_allclose(shaken.nodes - frame, loaded.nodes, atol=1e-10)


# ---- runs ----


def test_a_run_goes_on_with_its_profile():
    structure = hinged_prism()
    model, values = scene(structure)
    profile = tc.Profile(TIME, values, "cubic")
    motion, _ = motion_of(structure, "linear")
    given = {"rest_length": profile, "support_motion": motion, "step": 1e-3}
    whole = tc.simulate(model, 0.24, **given)
    first = tc.simulate(model, 0.14, **given)
    second = tc.simulate(model, 0.1, start=first, **given)
    np.testing.assert_allclose(second.nodes[:, :, -1], whole.nodes[:, :, -1], atol=1e-12)
    np.testing.assert_allclose(second.time[-1], 0.24)
    with pytest.raises(ValueError, match="supports move at the end of start: give support_motion"):
        tc.simulate(model, 0.1, start=first, step=1e-3)
    with pytest.raises(ValueError, match=r"in start, the fixed node .* from its place"):
        tc.simulate(model, 0.1, start=first, step=1e-3, support_motion=np.zeros((3, 3)))


def test_a_string_is_cut_while_all_are_wound():
    model, values = scene(tc.prism())
    profile = tc.Profile(TIME, values)
    run = tc.simulate(
        model, 0.2, rest_length=profile, faults=[tc.CutString(7, 0.15)], tolerance=1e-10
    )
    after = run.time > 0.15
    assert not run.force_density[7, after].any()
    others = np.arange(9) != 7
    np.testing.assert_allclose(run.rest_length[others][:, after][:, 1], profile.at(
        run.time[after][1])[others], rtol=1e-12)  # fmt: skip
    assert run.released_energy[-1] > 0


def test_a_controller_meets_a_load_that_changes(prism):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0), external_force=True)
    rest = tc.prestress(prism, force_density=17.3205)
    plant = tc.linearize(tc.Model(prism, strings=tc.LinearStrings(100.0)), rest)
    lqr = tc.LQR(plant, Q=1.0, R=1e-3, sample_time=0.02, max_force_density=50.0)
    gust = tc.Profile([0.05, 0.051], np.stack([np.zeros((3, 6)), np.ones((3, 6))], axis=2))
    run = tc.simulate(model, 0.2, controller=lqr, external_force=gust, step=1e-3)
    mass = prism.bar_mass.sum()
    assert run.momentum[0, -1] == pytest.approx(6 * (0.15 - 0.0005), rel=1e-9)
    assert run.velocities[0, :, -1].mean() == pytest.approx(run.momentum[0, -1] / mass, rel=1e-9)


@pytest.mark.parametrize("step", [1e-3, 7e-4])
def test_a_loop_runs_straight_lines_of_inputs(step):
    model, values = scene(tc.prism())
    run = PlantRun(
        model, "rest_length", np.zeros((3, 6)), 0.2, Integration("rk4", step=step),
        Faults((), 1.0, "x"), degree=1, output_step=step,
    )  # fmt: skip
    state = at_rest(model.structure)
    state = run.run(state, (values[:, 0], values[:, 1]), 0.1)
    state = run.run(state, values[:, 1], 0.1)
    profile = tc.Profile([0.0, 0.1], values[:, :2])
    run = tc.simulate(model, 0.2, rest_length=profile, step=step)
    np.testing.assert_allclose(state, end(run), atol=1e-12)


def test_the_estimate_of_the_error_knows_the_pieces():
    model, values = scene(tc.prism(), amplitude=0.1)
    profile = tc.Profile(TIME, values, "cubic")
    exact = tc.simulate(model, 0.3, rest_length=profile, tolerance=1e-13)
    run = tc.simulate(model, 0.3, rest_length=profile, step=2e-3)
    off = np.linalg.norm(run.nodes[:, :, -1] - exact.nodes[:, :, -1], axis=0).max()
    assert off / 2 < run.error[-1] * np.ptp(model.structure.nodes, axis=1).max() < 20 * off


# ---- refusals ----


HELD = Method("held", ("step",), "knows no time", METHODS["rk4"].make)


@needs_core
@pytest.mark.parametrize("method", ["auto", "rk4", "dop853"])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_pieces_in_one_call_are_those_one_by_one(method, interpolation, prism, monkeypatch):
    random, count = np.random.default_rng(2), 12
    lengths = prism.string_length()[:, None] * random.uniform(0.95, 1.05, (9, count))
    lengths[:, 8] *= 0.7  # so much that the frequency is found anew
    wound = tc.Profile(np.arange(count) / 40, lengths, interpolation)
    ground = tc.Ground(2e3, damping=0.3, height=float(prism.nodes[2].min()) - 0.02)
    model = tc.Model(prism, tc.LinearStrings(300.0), gravity=9.81, ground=ground)
    how = {"method": method} | ({"step": 3e-3} if method == "rk4" else {})
    limits = tc.HealthLimits(position_error=None, energy_error=None)

    def run():
        return tc.simulate(model, 0.3, rest_length=wound, limits=limits, **how)

    together, finished = run(), []
    advance = PlantRun._run_spans
    monkeypatch.setattr(
        PlantRun, "_run_spans", lambda *given: finished.append(advance(*given)) or finished[-1]
    )
    run()
    assert sum(finished) > count / 2
    monkeypatch.setattr(PlantRun, "_run_spans", lambda *_: 0)
    one_by_one = run()
    assert together.work == one_by_one.work
    for name in ("time", "nodes", "velocities", "error"):
        np.testing.assert_array_equal(getattr(together, name), getattr(one_by_one, name))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"rest_length": tc.Profile([0, 0.1], [1.0, -1.0])},
            "rest_length falls to .* a pos",
        ),
        (
            {"rest_length": lambda t: 1.0 if t < 0.033 else 2.0},
            r"rest_length jumps, .* near 0\.03.* Give a tc\.Profile",
        ),
        ({"rest_length": lambda t: [1.0, 2.0]}, r"rest_length returns shape \(2,\) at 0 s"),
        ({"rest_length": tc.Profile([0, 1], np.ones((3, 2)))}, r"values of shape \(3,\), expected"),
        (
            {"force_density": tc.Profile([0, 0.1], [1.0, -1.0])},
            "force_density falls to .* expe",
        ),
        (
            {"rest_length": 1.0, "support_motion": tc.Profile([0, 0.05], APART, "hold")},
            "support_motion jumps by 1 m at 0.05 s, expected a continuous motion",
        ),
        (
            {"rest_length": lambda t: 1 + t, "method": HELD},
            "takes inputs that are constant over a step only, but an inp",
        ),
        ({"rest_length": 1.0, "support_motion": np.zeros((2, 3))}, r"support_motion has shape"),
        ({"rest_length": 1.0, "external_force": tc.Profile([0], [1.0])}, "takes no load"),
    ],
)
def test_wrong_inputs_are_refused(given, message):
    model = tc.Model(hinged_prism(), strings=tc.LinearStrings(100.0))
    with pytest.raises(ValueError, match=message):
        tc.simulate(model, 0.1, step=1e-3, **given)


def test_supports_that_bars_join_move_alike():
    line = [[0.0, 1.0, 2.0], [0.0, 0.3, 0.0]]
    arch = tc.Structure(line, [[0, 1], [1, 2]], [], 1.0, fixed=[0, 2])
    apart = tc.Profile([0.0, 1.0], np.stack([np.zeros((2, 2)), np.eye(2)], axis=2))
    with pytest.raises(ValueError, match="moves the fixed nodes 0 and 2 differently, but bars"):
        tc.simulate(tc.Model(arch), 0.1, force_density=[], support_motion=apart, step=1e-3)
    rolling = tc.Structure(line, [[0, 1], [1, 2]], [], 1.0, fixed=[0, (2, "y")])
    rise = tc.Profile([0.0, 1.0], [[[0.0, 0.0]], [[0.0, 1.0]]])
    with pytest.raises(ValueError, match=r"moves the fixed node 0 along y, .* node 2, which a ro"):
        tc.simulate(tc.Model(rolling), 0.1, force_density=[], support_motion=rise, step=1e-3)


def test_supports_to_move_must_be_there(prism):
    with pytest.raises(ValueError, match="support_motion is given, but no node"):
        tc.simulate(
            tc.Model(prism), 0.1, force_density=1.0, support_motion=np.zeros((3, 1)), step=1e-3
        )


def test_every_method_is_tested_with_profiles():
    named = {name for name, *_ in ORDERS if isinstance(name, str)}
    assert named | {"dop853", "cvodes"} == set(METHODS)


@pytest.mark.parametrize("at", [7.77, 13.1234, 19.9])
def test_a_short_pulse_of_a_long_function_is_seen(at):
    """3 ms in 20 s: smooth it is followed, and with edges it is refused."""
    given = "external_force", (2, 1), "m", 0.0, 20.0
    pulse = as_pieces(
        given[0], lambda t: np.full((2, 1), np.exp(-(((t - at) / 8e-4) ** 2))), *given[1:]
    )
    np.testing.assert_allclose(pulse.at(np.array([at]))[:, 0], 1.0, rtol=1e-9)
    with pytest.raises(ValueError, match=r"external_force jumps, has a kink .* Give a tc\.Profile"):
        as_pieces(given[0], lambda t: np.full((2, 1), float(abs(t - at) < 1.5e-3)), *given[1:])


def test_a_fast_vibration_late_in_a_run_is_no_jump():
    """The round-off of times alone is more than a millionth of a millionth there."""
    tone = as_pieces(
        "load", lambda t: np.sin(2 * np.pi * 100 * t) * np.ones(2), (2,), "", 19.0, 20.0
    )
    times = np.linspace(19.0, 20.0, 5001)
    np.testing.assert_allclose(tone.at(times)[0], np.sin(2 * np.pi * 100 * times), atol=1e-11)


def test_a_function_is_called_some_eight_thousand_times():
    calls = []
    as_pieces(
        "force_density",
        lambda t: calls.append(t) or 2 + np.sin(3 * t) * np.ones(4),
        (4,),
        "",
        0.0,
        20.0,
    )
    assert 8192 < len(calls) < 12_000
    assert np.diff(np.sort(calls)).max() <= 20.0 / 8192 * (1 + 1e-9)


def test_a_function_of_no_numbers_is_refused_by_name():
    for value in ([[1.0], [1.0, 2.0]], "much", 1j):
        with pytest.raises((TypeError, ValueError), match="force_density at 0 s"):
            as_pieces("force_density", lambda t, value=value: value, (4,), "", 0.0, 1.0)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_function_that_is_not_finite_is_refused_with_its_time(wrong):
    with pytest.raises(ValueError, match=r"force_density at 0\.\d+ s"):
        as_pieces(
            "force_density", lambda t: np.full(4, wrong if t > 0.5 else 1.0), (4,), "", 0.0, 1.0
        )


def test_a_run_tells_how_finely_functions_are_sampled(prism):
    model = tc.Model(prism, external_force=True)
    given = {"force_density": lambda t: 20 + np.sin(t) * np.ones(9), "step": 1e-2}
    still = np.zeros((3, 6))
    run = tc.simulate(model, 0.5, external_force=lambda t: t * still, **given)
    assert run.note == (
        "force_density and external_force sampled every 6.1e-05 s: shorter pulses may be missed"
    )
    assert run.note in run.summary()
    profile = tc.Profile([0.0, 1.0], np.full((9, 2), 20.0))
    assert (
        tc.simulate(model, 0.1, force_density=profile, external_force=still, step=1e-2).note is None
    )


@pytest.mark.parametrize("cut", [0.3, 0.14, 0.7])
def test_a_controlled_run_in_parts_is_one_bit_by_bit(prism, cut):
    """Also where the times of its samples are no round numbers, under a load in pieces."""
    strings = tc.LinearStrings(STIFFNESS, damping=0.5)
    plant = tc.linearize(
        tc.Model(prism, strings=strings), tc.prestress(prism, 17.3), input="rest_length"
    )
    model = tc.Model(prism, strings=strings, external_force=True)
    load = np.zeros((3, 6, 4))
    load[0, :, 1:3] = 0.3, -0.2
    given = {
        "controller": tc.LQR(plant, sample_time=0.02), "step": 2e-3,
        "external_force": tc.Profile([0.0, 0.213, 0.5, 0.97], load),
    }  # fmt: skip
    start = {"rest_length": plant.rest_length}
    whole = tc.simulate(model, 1.0, **start, **given)
    first = tc.simulate(model, cut, **start, **given)
    second = tc.simulate(model, 1.0 - cut, start=first, **given)
    np.testing.assert_array_equal(second.nodes[:, :, -1], whole.nodes[:, :, -1])


def test_an_open_loop_in_parts_is_one_to_round_off(prism):
    model = tc.Model(prism, strings=tc.LinearStrings(STIFFNESS))
    begin = 0.9 * prism.string_length()
    profile = tc.Profile([0.0, 0.21, 0.53], np.column_stack([begin, 0.97 * begin, begin]))
    function = lambda t: begin * (1 - 0.02 * np.sin(5 * t) ** 2)  # noqa: E731
    for given, least, most in ((profile, 0.0, 1e-13), (function, 1e-15, 1e-8)):
        whole = tc.simulate(model, 0.6, rest_length=given, step=1e-3)
        first = tc.simulate(model, 0.25, rest_length=given, step=1e-3)
        second = tc.simulate(model, 0.35, start=first, rest_length=given, step=1e-3)
        off = np.abs(second.nodes[:, :, -1] - whole.nodes[:, :, -1]).max()
        assert least <= off < most
