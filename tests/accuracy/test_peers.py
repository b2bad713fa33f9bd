"""Integrators of other packages solve the same problem as ours."""

from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tenscontrol as tc
from tenscontrol.accuracy import Peer, Solution
from tenscontrol.accuracy.peers import CasADiCVODES, CasADiRK, MuJoCo, SciPy
from tenscontrol.dynamics.equation import unpack_states
from tenscontrol.integrate import DOP853, RK4
from tests.dynamics.scenes import (
    paper_force_density,
    random_force_density,
    random_motion,
    random_structure,
    rest_lengths,
)
from tests.located_motion import exact_motion
from tests.oracle import HeldForceDensity, HeldRestLength

needs_mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed")
METHODS = ("euler", "implicit", "implicitfast", "rk4")
PEERS = [
    *(
        pytest.param(MuJoCo(method), id=f"mujoco_{method}", marks=needs_mujoco)
        for method in METHODS
    ),
    *(pytest.param(SciPy(name), id=name) for name in ("DOP853", "RK45", "Radau", "LSODA")),
    pytest.param(CasADiCVODES(), id="cvodes"),
    pytest.param(CasADiRK(), id="rk"),
]


def prism_case(vertical=45.0, duration=0.5, stiffness=100.0, damping=0.0):
    prism = tc.prism()
    lengths = rest_lengths(prism, paper_force_density(vertical), stiffness)
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness, damping))
    return tc.Scene(model, duration, rest_length=lengths)


def solved(peer, case, setting, outputs=5):
    times = case.duration * np.arange(1, outputs + 1) / outputs
    return peer.prepare(case, setting, times)()


def oracle(case, law, outputs=5):
    """Nodes at the output times by a method that shares no code, shape (3, n, T)."""
    times = case.duration * np.arange(outputs + 1) / outputs
    start = case.velocities, case.nodes
    return exact_motion(case.structure, law, times, *start, case.load)[0][:, :, 1:]


def ours(case, outputs=5):
    """Nodes and velocities by our own adaptive method, for what the oracle does not know."""
    span = DOP853(case.equation(), 1e-11).advance(
        case.state, case.input_value, case.duration, outputs
    )
    return unpack_states(case.structure, span.states)


@cache
def exact_prism():
    """What :func:`prism_case` does by the rigid-body model."""
    case = prism_case()
    return oracle(case, HeldRestLength(case.input_value, 100.0))


# ---- all of them ----

# A fine setting, the error at it in 0.5 s of the tense prism, and at a setting 10 times coarser.
FINE = {
    "mujoco euler": (1e-4, 1e-4),
    "mujoco implicit": (1e-4, 1e-4),
    "mujoco implicitfast": (1e-4, 1e-4),
    "mujoco rk4": (1e-3, 1e-8),
    "scipy dop853": (1e-9, 1e-9),
    "scipy rk45": (1e-9, 1e-8),
    "scipy radau": (1e-7, 1e-8),
    "scipy lsoda": (1e-10, 1e-8),
    "casadi cvodes": (1e-10, 1e-7),
    "casadi rk": (1e-3, 1e-8),
}


@pytest.mark.parametrize("peer", PEERS)
def test_a_peer_follows_the_oracle(peer):
    case, exact = prism_case(), exact_prism()
    setting, error = FINE[peer.name]
    found = solved(peer, case, setting)
    coarse = solved(peer, case, 10 * setting)
    assert isinstance(found, Solution)
    assert found.nodes.shape == found.velocities.shape == (3, 6, 5)
    assert np.abs(found.nodes - exact).max() < error
    assert np.abs(found.nodes - exact).max() < np.abs(coarse.nodes - exact).max()
    assert found.evaluations > coarse.evaluations > 0
    velocities = ours(case)[1]
    np.testing.assert_allclose(found.velocities, velocities, rtol=0, atol=100 * error)


@pytest.mark.parametrize("peer", PEERS)
def test_a_peer_starts_anew_each_time(peer):
    case = prism_case(vertical=9.0, duration=0.2)
    run = peer.prepare(case, peer.settings[1], np.array([0.1, 0.2]))
    first, second = run(), run()
    np.testing.assert_array_equal(second.nodes, first.nodes)
    np.testing.assert_array_equal(second.velocities, first.velocities)
    assert second.evaluations == first.evaluations


@pytest.mark.parametrize("peer", PEERS)
def test_a_peer_holds_force_densities(peer):
    gamma = paper_force_density(20.0)
    case = tc.Scene(tc.Model(tc.prism()), 0.3, force_density=gamma)
    exact = oracle(case, HeldForceDensity(gamma))
    setting, error = FINE[peer.name]
    assert np.abs(solved(peer, case, setting).nodes - exact).max() < 3 * error


@pytest.mark.parametrize("peer", PEERS)
def test_settings_go_from_coarse_to_fine(peer):
    assert isinstance(peer, Peer)
    assert peer.refuse(prism_case()) is None
    assert len(peer.settings) >= 4
    assert all(np.diff(peer.settings) < 0)


@pytest.mark.parametrize(("kind", "wrong"), [(MuJoCo, "rk5"), (SciPy, "dop853")])
def test_an_unknown_method_is_refused(kind, wrong):
    with pytest.raises(ValueError, match=f"method is '{wrong}', expected one of"):
        kind(wrong)


# ---- counts ----


def test_the_fixed_steps_of_casadi_are_those_of_our_own_method():
    """The same steps, so that the count of evaluations is theirs; 0.7 s in steps of 7/3 ms."""
    case = prism_case(duration=0.7)
    found = solved(CasADiRK(), case, 3e-3, outputs=100)
    span = RK4(case.equation(), 3e-3).advance(case.state, case.input_value, 0.7, 100)
    assert found.evaluations == span.work.evaluations == 4 * 300
    x = found.nodes.transpose(1, 0, 2).reshape(18, 100)
    np.testing.assert_allclose(x, span.states[:18], rtol=0, atol=1e-12)


def test_more_steps_than_are_done_in_a_day_are_refused():
    with pytest.raises(ValueError, match=r"times end at 3e\+38 s, which makes 3e\+41 steps.* day"):
        CasADiRK().prepare(prism_case(), 1e-3, np.array([3e38]))


def test_scipy_counts_every_evaluation_and_jacobians_beside():
    case = prism_case(duration=0.1)
    kinked = case.equation().kinked_slope
    plain = solve_ivp(
        lambda t, x: np.array(kinked(x, case.input_value)).ravel(),
        (0, 0.1),
        case.state,
        method="RK45",
        rtol=1e-6,
        atol=1e-6,
    )
    assert solved(SciPy("RK45"), case, 1e-6).evaluations == plain.nfev
    without = solved(SciPy("DOP853"), case, 1e-6).evaluations
    assert solved(SciPy("Radau"), case, 1e-6).evaluations > without


@needs_mujoco
@pytest.mark.parametrize(("method", "each"), [("euler", 1), ("implicit", 1), ("rk4", 4)])
def test_mujoco_counts_the_evaluations_of_its_steps(method, each):
    """Steps of at most 0.7 ms between outputs 10 ms apart: 15 of them."""
    found = solved(MuJoCo(method), prism_case(duration=0.1), 7e-4, outputs=10)
    assert found.evaluations == each * 10 * 15


# ---- what runs away ----


@pytest.mark.parametrize(
    "peer", [PEERS[0], PEERS[3], PEERS[-1]], ids=["mujoco_euler", "mujoco_rk4", "casadi_rk"]
)
def test_an_unstable_step_is_a_failed_run(peer, tmp_path, monkeypatch, capfd):
    """MuJoCo by itself would write a file into the working folder."""
    monkeypatch.chdir(tmp_path)
    case = prism_case(stiffness=1e8, vertical=46.0)
    with pytest.raises(ArithmeticError, match="no longer finite"):
        solved(peer, case, 1e-2)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_problem_beyond_cvodes_is_a_failed_run(capfd):
    """Two masses drawn into one point by held force densities of 10⁷⁰ N/m."""
    pair = tc.Structure(
        [[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]], [], [[0, 1]], [], string_node_mass=1.0
    )
    case = tc.Scene(tc.Model(pair), 1.0, force_density=1e70)
    with pytest.raises(ArithmeticError, match="CVODES stopped with"):
        solved(CasADiCVODES(), case, 1e-8)
    assert capfd.readouterr() == ("", "")


# ---- MuJoCo: what a structure can have ----


def compared(case, law=None, error=1e-8, step=2e-4):
    """Check MuJoCo's fourth-order method against the oracle, or our own method."""
    found = solved(MuJoCo("rk4"), case, step)
    nodes, velocities = ours(case)
    exact = nodes if law is None else oracle(case, law)
    assert np.abs(found.nodes - exact).max() < error
    assert np.abs(found.velocities - velocities).max() < 100 * error
    return found


@needs_mujoco
@pytest.mark.parametrize("seed", range(3))
def test_mujoco_takes_any_structure_and_motion(seed):
    """Bars of different mass that turn and travel, point masses, held force densities."""
    structure = random_structure(seed, bars=3, points=2)
    start, rates = random_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    model = tc.Model(structure)
    case = tc.Scene(model, 0.2, start, rates, force_density=gamma)
    compared(case, HeldForceDensity(gamma))


@needs_mujoco
@pytest.mark.parametrize("vertical", [9.0, 45.0])
def test_mujoco_takes_the_papers_prism(vertical):
    """In minimal coordinates; with 9 N/m strings go slack, and no step ends there."""
    case = prism_case(vertical, duration=0.5)
    error = 1e-6 if vertical == 9.0 else 1e-10
    found = compared(case, HeldRestLength(case.input_value, 100.0), error)
    ends = found.nodes[:, case.structure.bars]
    length = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=0)
    np.testing.assert_allclose(length, case.structure.bar_length[:, None].repeat(5, 1), rtol=1e-14)


@needs_mujoco
def test_mujoco_takes_damped_strings_while_none_is_slack():
    case = prism_case(vertical=45.0, damping=1.0)
    compared(case, HeldRestLength(case.input_value, 100.0, 1.0))


@needs_mujoco
def test_mujoco_refuses_a_result_with_a_damped_string_gone_slack():
    case = prism_case(vertical=9.0, damping=0.05)
    with pytest.raises(ArithmeticError, match=r"string \d is damped and went slack"):
        solved(MuJoCo("rk4"), case, 1e-3, outputs=50)


@needs_mujoco
def test_mujoco_takes_elastic_strings():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.ElasticStrings(80.0))
    lengths = model.strings.rest_length(prism.string_length(), paper_force_density(40.0))
    compared(tc.Scene(model, 0.3, rest_length=lengths))


@needs_mujoco
@pytest.mark.parametrize("fixed", [[3], [3, 4], [3, 4, 5], [0, 3, 4, 5]])
def test_mujoco_takes_fixed_nodes_and_gravity(fixed):
    """A bar with a fixed end hangs on a ball joint; one with two is part of the support."""
    prism = tc.prism()
    standing = tc.Structure(prism.nodes, prism.bars, prism.strings, 2.0, fixed=fixed)
    model = tc.Model(standing, strings=tc.LinearStrings(100.0), gravity=9.81)
    lengths = rest_lengths(standing, paper_force_density(45.0), 100.0)
    case = tc.Scene(model, 0.3, rest_length=lengths)
    rates = ours(case)[1][:, :, -1]
    nodes = tc.structure.restore_bar_lengths(standing, ours(case)[0][:, :, -1])
    moving = tc.Scene(model, 0.2, nodes, _rigid(standing, nodes, rates), rest_length=lengths)
    compared(case)
    found = compared(moving)
    np.testing.assert_array_equal(found.nodes[:, fixed], nodes[:, fixed, None].repeat(5, axis=2))


def _rigid(structure, nodes, rates):
    """Rates with the stretching of bars, round-off, taken out."""
    rates = rates.copy()
    for start, end in structure.bars:
        if start in structure.fixed and end in structure.fixed:
            continue
        moved = start if end in structure.fixed else end
        b, d = nodes[:, end] - nodes[:, start], rates[:, end] - rates[:, start]
        sign = 1.0 if moved == end else -1.0
        rates[:, moved] -= sign * b * (b @ d) / (b @ b)
    return rates


@needs_mujoco
@pytest.mark.parametrize("even", [True, False])
def test_mujoco_takes_loads(even):
    """Equal at the ends of a bar they push its centre; else they turn it, in space's directions."""
    structure = random_structure(5, bars=3, points=2)
    load = np.random.default_rng(1).normal(size=(3, 8))
    if even:
        load[:, structure.bars[:, 1]] = load[:, structure.bars[:, 0]]
    gamma = random_force_density(structure, 5)
    model = tc.Model(structure, external_force=True, gravity=[0.0, 1.0, -9.0])
    case = tc.Scene(model, 0.2, force_density=gamma, external_force=load)
    compared(case, HeldForceDensity(gamma))


@needs_mujoco
def test_mujoco_takes_loads_on_swinging_bars():
    structure = tc.Structure(
        [[0.0, 1.0, 2.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], [[0, 1]], [[1, 2]], 1.5, fixed=[0, 2]
    )
    load = np.zeros((3, 3))
    load[:, 1] = 1.0, 2.0, -3.0
    model = tc.Model(structure, external_force=load)
    compared(tc.Scene(model, 0.5, force_density=2.0))


@needs_mujoco
def test_mujoco_gains_four_orders_by_its_best_method():
    """Fitted over steps of 8 to 1 ms: 4 for rk4, 1 for the others."""
    case = prism_case()
    exact = oracle(case, HeldRestLength(case.input_value, 100.0))
    steps = np.array([8e-3, 4e-3, 2e-3, 1e-3])
    for method in METHODS:
        errors = [np.abs(solved(MuJoCo(method), case, h).nodes - exact).max() for h in steps]
        order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert order == pytest.approx(4.0 if method == "rk4" else 1.0, abs=0.4)


# ---- MuJoCo: its own ground ----


def bar_on_ground(height=0.0, speed=0.0, duration=0.4, gravity=None, tilt=0.0, **law):
    """A bar of 2 kg above, or on, ground of 1e3 N/m."""
    turn = np.array([[np.cos(tilt), 0, 0], [0, 1, 0], [np.sin(tilt), 0, 0]])
    nodes = turn @ np.array([[-0.5, 0.5], [0, 0], [0, 0]])
    nodes[2] += height - nodes[2].min()
    bar = tc.Structure(nodes, [[0, 1]], np.zeros((0, 2), int), 2.0)
    velocities = np.array([[speed], [0.0], [-speed]]) * np.ones(2)
    model = tc.Model(bar, gravity=gravity, ground=tc.Ground(1e3, **law))
    return tc.Scene(model, duration, velocities=velocities, force_density=np.zeros(0))


@needs_mujoco
@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_mujoco_bounces_on_ground_without_loss_as_the_case_does(tilt):
    """Its impedance of 1e-4 is the difference; a bar that lands askew has another mass there."""
    case = bar_on_ground(height=0.1, speed=2.0, tilt=tilt)
    found = solved(MuJoCo("rk4"), case, 1e-4, outputs=40)
    exact = ours(case, outputs=40)[0]
    assert exact[2].min() < -0.02
    assert np.abs(found.nodes - exact).max() < 1e-3
    assert MuJoCo("rk4").own_law(case) is not None
    assert MuJoCo("rk4").own_law(prism_case()) is None


@needs_mujoco
def test_mujoco_rests_on_ground_as_deep_as_the_case_does():
    case = bar_on_ground(duration=6.0, gravity=9.81, damping=5.0, friction=0.5)
    found = solved(MuJoCo("rk4"), case, 1e-3)
    np.testing.assert_allclose(found.nodes[2, :, -1], -9.81 / 1e3, rtol=1e-3)


@needs_mujoco
def test_mujoco_slides_to_rest_under_the_friction_of_the_case():
    """Far above the slip speed both laws are Coulomb's, and the way is v²/2µg."""
    law = {"damping": 5.0, "friction": 0.5, "slip_speed": 1e-3}
    case = bar_on_ground(height=-9.81e-3, duration=0.6, gravity=9.81, **law)
    sliding = np.array([[2.0], [0.0], [0.0]]) * np.ones(2)
    case = tc.Scene(case.model, 0.6, velocities=sliding, force_density=np.zeros(0))
    found, exact = solved(MuJoCo("rk4"), case, 2e-4, outputs=6), ours(case, outputs=6)[0]
    ways = [nodes[0, 0, -1] - case.nodes[0, 0] for nodes in (exact, found.nodes)]
    coulomb = 2.0**2 / (2 * 0.5 * 9.81)
    assert ways[0] == pytest.approx(coulomb, rel=1e-3)
    assert ways[1] == pytest.approx(coulomb, rel=1e-2)  # the balls roll a little


@needs_mujoco
def test_mujoco_takes_several_planes_each_on_its_nodes():
    """One end on the floor, the other stopped by a wall that the first does not see."""
    floor = tc.Ground(1e3, damping=0.1, nodes=[0], height=-0.1)
    wall = tc.Ground(1e3, damping=0.1, normal=[-1.0, 0.0, 0.0], height=-0.6, nodes=[1])
    bar = tc.Structure([[-0.5, 0.5], [0, 0], [0, 0.2]], [[0, 1]], np.zeros((0, 2), int), 2.0)
    moving = np.array([[1.0], [0.0], [-1.0]]) * np.ones(2)
    case = tc.Scene(
        tc.Model(bar, ground=[floor, wall]), 0.3, velocities=moving, force_density=np.zeros(0),
    )  # fmt: skip
    found, exact = solved(MuJoCo("rk4"), case, 2e-4, outputs=30), ours(case, outputs=30)[0]
    assert np.abs(found.nodes - exact).max() < 5e-3
    free = case.nodes[:, :, None] + moving[:, :, None] * 0.01 * np.arange(1, 31)
    assert np.abs(exact - free).max() > 0.1


@pytest.mark.parametrize(
    ("ground", "why"),
    [
        (tc.dynamics.HertzGround(1e3), "springs on planes, not HertzGround"),
        (tc.dynamics.SmoothGround(1e3), "springs on planes, not SmoothGround"),
        (tc.Ground(1e3, friction=0.5), "rub by their damping, and the ground has none"),
    ],
)
@needs_mujoco
def test_mujoco_refuses_other_contact_laws(ground, why):
    case = tc.Scene(tc.Model(tc.prism(), ground=ground), 0.1, force_density=np.ones(9))
    assert why in MuJoCo("rk4").refuse(case)


@needs_mujoco
def test_errors_of_a_peer_with_its_own_law_are_against_its_own_motion():
    case = bar_on_ground(height=0.1, speed=2.0, damping=0.5, friction=0.3)
    found = tc.work_precision(
        case, ["rk4"], {"rk4": [1e-4]}, peers=[MuJoCo("rk4", [1e-3, 5e-4])], repeats=1, outputs=20
    )
    coarse, fine = found.of("mujoco rk4")
    assert fine.error < coarse.error < 2e-3
    assert np.isnan(fine.energy_error)
    apart = solved(MuJoCo("rk4"), found.case, 1e-4, outputs=20).nodes - found.reference.nodes
    assert np.abs(apart).max() > 2 * coarse.error
    assert dict(found.own_laws).keys() == {"mujoco rk4"}
    assert "law of its own" in found.summary()
