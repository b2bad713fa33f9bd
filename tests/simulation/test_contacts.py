"""Contacts of a run: forces, works and impulses against a quadrature of their own, and energy."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import simpson

import tenscontrol as tc
from tenscontrol.dynamics import HertzGround, SmoothGround
from tenscontrol.simulation import AccuracyWarning, SimulationError

STIFFNESS, DAMPING, FRICTION, SLIP = 5e3, 0.3, 0.5, 0.01
EXACT = {"method": "dop853", "tolerance": 1e-11}


def ground(height, **options):
    given = {"stiffness": STIFFNESS, "damping": DAMPING, "friction": FRICTION, "slip_speed": SLIP}
    return tc.Ground(height=height, **(given | options))


def beneath(structure, normal, by):
    """The height of a plane so far below the structure, m."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    return float((normal @ structure.nodes).min()) - by


def dropped(structure, laws, duration, speed=0.0, force_density=20.0, **options):
    rest = tc.prestress(structure, force_density=force_density)
    model = tc.Model(structure, gravity=9.81, ground=laws)
    V = np.zeros_like(structure.nodes)
    V[0] = speed
    gamma = rest.force_density
    return tc.simulate(model, duration, velocities=V, force_density=gamma, **options)


@pytest.fixture(scope="module")
def ball():
    """The six-bar ball dropped from 0.3 m with 0.5 m/s sideways, up to its second flight."""
    structure = tc.library.six_bar_ball()
    height = beneath(structure, [0, 0, 1], 0.3)

    def run(**options):
        return dropped(structure, ground(height), 0.5, speed=0.5, **(EXACT | options))

    return SimpleNamespace(height=height, run=run, usual=run(output_step=0.01))


def balance(run):
    """Largest change of the energy with what was lost, as part of the largest kinetic energy."""
    energy = run.energy + run.released_energy + run.lost_energy
    return np.abs(energy - energy[0]).max() / run.kinetic_energy.max()


def test_works_and_impulses_are_those_of_a_quadrature_of_a_fine_run(ball):
    """The law in plain NumPy, Simpson over 2e-5 s; the states kept are 0.01 s apart."""
    fine, found = ball.run(output_step=2e-5), ball.usual.contacts
    for i, node in enumerate(found.node):
        x, v = fine.nodes[:, node], fine.velocities[:, node]
        depth, rate = ball.height - x[2], -v[2]
        normal = STIFFNESS * depth * (1 + DAMPING * rate) * (depth > 0)
        slip = np.linalg.norm(v[:2], axis=0)
        rubbed = FRICTION * normal * slip**2 / np.sqrt(slip**2 + SLIP**2)
        damped = STIFFNESS * depth * DAMPING * rate**2 * (depth > 0)
        for power, work in ((rubbed, found.friction_work), (damped, found.damping_work)):
            assert work[i, -1] == pytest.approx(simpson(power, x=fine.time), rel=1e-6, abs=1e-7)
        assert found.impulse[2, i, -1] == pytest.approx(simpson(normal, x=fine.time), rel=1e-6)
        assert found.deepest[i] == pytest.approx(depth.max(), rel=1e-5)
        switches = np.flatnonzero(np.diff(np.r_[0, depth > 0, 0]))
        times = np.append(fine.time, fine.time[-1])[switches]
        mine = found.touch == i
        assert len(times) == 2 * mine.sum() > 0
        np.testing.assert_allclose(found.begin[mine], times[::2], atol=2.1e-5)
        np.testing.assert_allclose(found.end[mine], times[1::2], atol=2.1e-5)


def test_a_trapezoid_over_the_states_kept_would_be_far_off(ball):
    found, time = ball.usual.contacts, ball.usual.time
    for i in range(len(found.node)):
        there = np.trapezoid(found.normal_force[i], time)
        assert abs(there / found.impulse[2, i, -1] - 1) > 1e-4


def test_the_balances_of_energy_and_momentum_close(ball):
    run = ball.usual
    assert run.conserves_energy
    assert not run.conserves_momentum
    assert balance(run) < 1e-7
    assert run.health.energy_error == pytest.approx(balance(run))
    assert run.health.impulse_error < 1e-7
    assert run.health.momentum_change is None
    # More is lost than any error.
    assert run.lost_energy[-1] > 0.1 * run.kinetic_energy.max()
    assert (np.diff(run.contacts.damping_work) >= 0).all()
    assert (np.diff(run.contacts.friction_work) >= 0).all()


def test_forces_are_those_of_the_law_at_the_times_kept(ball):
    run, found = ball.usual, ball.usual.contacts
    depth = ball.height - run.nodes[2, found.node]
    np.testing.assert_allclose(found.depth, depth, atol=1e-15)
    normal = np.where(
        depth > 0, STIFFNESS * depth * (1 - DAMPING * run.velocities[2, found.node]), 0
    )
    np.testing.assert_allclose(found.normal_force, normal, rtol=1e-12, atol=1e-10)
    across = np.linalg.norm(found.tangential_force, axis=0)
    assert (across <= FRICTION * normal * (1 + 1e-12)).all()
    assert (
        np.einsum("dct,dct->ct", found.tangential_force, run.velocities[:, found.node]) <= 0
    ).all()
    np.testing.assert_allclose(found.stored_energy, STIFFNESS / 2 * np.maximum(depth, 0) ** 2)
    pressed = np.zeros_like(depth, dtype=bool)
    for contact, begin, end in zip(found.touch, found.begin, found.end, strict=True):
        pressed[contact] |= (run.time > begin) & (run.time <= end)
    assert (pressed == (normal > 0)).all()


def test_health_and_summary_say_what_touched(ball):
    run = ball.usual
    health = run.health
    assert health.penetration * np.ptp(run.structure.nodes, axis=1).max() == pytest.approx(
        run.contacts.penetration
    )
    assert health.damping_work + health.friction_work == pytest.approx(run.lost_energy[-1])
    largest = max(np.linalg.norm(p) for p in run.contacts.node_impulse.values())
    assert health.impulse == pytest.approx(largest)
    assert "touched by nodes 4, 5, 8, 10, 6 times" in run.summary()
    assert "J by friction" in run.summary()


@pytest.mark.parametrize("method", ["rk4", "cvodes"])
def test_another_method_agrees(ball, method):
    options = {"step": 1e-4, "tolerance": 1e-6} if method == "rk4" else {"tolerance": 1e-9}
    run = ball.run(**({"method": method, "output_step": 0.01} | options))
    assert balance(run) < 1e-4
    assert run.lost_energy[-1] == pytest.approx(ball.usual.lost_energy[-1], rel=1e-3)


def test_a_motion_that_is_wrong_is_still_seen(ball):
    with pytest.warns(AccuracyWarning, match="energy error"):
        run = ball.run(method="rk4", step=0.012, tolerance=1e-6)
    assert run.health.energy_error > 0.05


def test_in_the_plane_on_a_slope():
    structure = tc.library.d_bar()
    normal = [-0.3, 1.0]
    law = ground(beneath(structure, normal, 0.1), normal=normal)
    run = dropped(structure, law, 0.5, force_density=200.0, **EXACT)
    assert run.contacts.impulse.shape[0] == 2
    assert len(run.contacts.touch) >= 2
    assert balance(run) < 1e-7
    assert run.health.impulse_error < 1e-7


def test_a_tower_of_joined_bars_on_a_slope_and_against_a_wall():
    tower = tc.library.class2_tower()
    structure = tc.Structure(tower.nodes, tower.bars, tower.strings, bar_mass=tower.bar_mass)
    normal = [0.2, 0.1, 1.0]
    laws = [
        ground(beneath(structure, normal, 0.02), normal=normal),
        ground(beneath(structure, [1, 0, 0], 0.01), normal=[1, 0, 0]),
    ]
    run = dropped(structure, laws, 0.2, speed=-0.3, **EXACT)
    assert set(run.contacts.law) == {0, 1}
    assert balance(run) < 1e-7
    assert run.health.impulse_error < 1e-7


# ---- one bar that falls flat: each end is half its mass on a spring ----


def bar(**options):
    nodes = np.array([[0.0, 1.0], [0.0, 0.0], [0.1, 0.1]])
    return tc.Structure(nodes, bars=[[0, 1]], strings=np.zeros((0, 2), int), bar_mass=2.0)


def flat_drop(law, duration, **options):
    return tc.simulate(
        tc.Model(bar(), gravity=9.81, ground=law), duration, force_density=np.zeros(0), **options
    )


@pytest.mark.parametrize(
    ("method", "tolerance", "accurate"),
    [("dop853", 1e-11, 1e-7), ("energy_momentum", 1e-9, 1e-4)],
    ids=["dop853", "energy_momentum"],
)
def test_an_impact_shorter_than_the_output_step(method, tolerance, accurate):
    """On stiff ground, speeds before and after say what was lost, and the impulse."""
    law = tc.Ground(stiffness=1e8, damping=0.2)
    run = flat_drop(law, 0.2, method=method, tolerance=tolerance, output_step=0.01)
    exact = flat_drop(law, 0.2, method="dop853", tolerance=1e-12)
    found = run.contacts
    np.testing.assert_allclose(found.end - found.begin, np.pi / np.sqrt(1e8), rtol=0.1)
    np.testing.assert_allclose(found.begin, np.sqrt(2 * 0.1 / 9.81), rtol=1e-5)
    assert len(found.begin) == 2
    assert (found.normal_force == 0).all()  # in flight at all states kept
    lost = exact.energy[0] - exact.energy[-1]
    assert lost > 0.1 * run.kinetic_energy.max()
    assert run.lost_energy[-1] == pytest.approx(lost, rel=max(accurate, 1e-6) / 2)
    assert balance(run) < accurate
    change = exact.velocities[2, 0, -1] + 9.81 * 0.2
    assert found.impulse[2, :, -1] == pytest.approx(np.full(2, change), rel=accurate)


def test_steps_that_lose_another_energy_are_seen():
    """Steps far beyond the impact, by a method whose own energy is exact: the loss is not."""
    law = tc.Ground(stiffness=1e8, damping=0.2)
    with pytest.warns(AccuracyWarning, match="energy error"):
        run = flat_drop(law, 0.2, method="energy_momentum", step=1e-3)
    assert run.health.energy_error > 0.1


def test_at_rest_impulses_are_those_of_the_weight():
    law = tc.Ground(stiffness=1e4, damping=5.0, height=0.1 - 9.81 / 1e4)
    # Half a millimetre too deep: it rings.
    run = flat_drop(law, 3.0, step=1e-3)
    assert len(run.contacts.touch) >= 2
    assert balance(run) < 1e-5
    assert run.health.impulse_error < 1e-5


def test_nothing_touched():
    run = flat_drop(tc.Ground(stiffness=1e4), 0.1, step=1e-3)
    assert run.contacts.node.size == 0
    assert run.contacts.penetration == 0.0
    assert run.contacts.damping_work.shape == (0, 101)
    assert run.health.penetration == 0.0
    assert "nothing touched it" in run.summary()


def test_near_but_not_touching():
    run = flat_drop(tc.Ground(stiffness=1e4, height=0.09), 0.04, step=1e-3)
    assert run.nodes[2].min() < 0.0925
    assert run.contacts.node.size == run.contacts.touch.size == 0
    assert run.contacts.impulse.shape == (3, 0, 41)


def test_pressed_from_begin_to_end():
    """Each end rests on its half of the weight."""
    law = tc.Ground(stiffness=1e4, damping=1.0, height=0.1 + 9.81 / 1e4)
    run = flat_drop(law, 0.1, step=1e-3)
    found = run.contacts
    np.testing.assert_array_equal(found.touch, [0, 1])
    np.testing.assert_array_equal(found.begin, [0, 0])
    np.testing.assert_allclose(found.end, run.time[-1])
    np.testing.assert_allclose(found.impulse[2, :, -1], 9.81 * 0.1, rtol=1e-10)
    np.testing.assert_allclose(found.depth, 9.81 / 1e4, rtol=1e-9)
    assert np.abs(run.lost_energy).max() < 1e-15


def test_a_motion_that_runs_away_has_contacts_too():
    model, lengths = prism_scene(stiffness=1e8)
    with pytest.raises(SimulationError) as caught:
        tc.simulate(model, 1.0, rest_length=lengths, step=5e-3)
    run = caught.value.trajectory
    assert run.contacts.touch.size
    assert np.isinf(run.contacts.work_error)


LAWS = [
    HertzGround(stiffness=1e5, damping=0.5, friction=0.3),
    SmoothGround(stiffness=5e3, damping=0.3, friction=0.3, width=0.005),
    tc.Ground(
        stiffness=1e4,
        friction=0.3,
        damping=0.2,
        height=ca.Function(
            "h", [x := ca.SX.sym("x"), y := ca.SX.sym("y")], [0.1 * x * x + 0.05 * y]
        ),
    ),
]


@pytest.mark.parametrize("law", LAWS, ids=["hertz", "smooth", "height"])
def test_the_balance_closes_for_every_law(law):
    run = flat_drop(law, 0.5, **EXACT)
    assert run.lost_energy[-1] > 1e-3
    assert balance(run) < 1e-6
    assert run.health.impulse_error < 1e-6


# ---- runs that go on, end early, are controlled or moved ----


def test_a_run_in_two_parts_adds_up():
    law = tc.Ground(stiffness=1e4, damping=0.5)
    whole = flat_drop(law, 0.4, **EXACT)
    first = flat_drop(law, 0.15, **EXACT)  # it touches then
    second = tc.simulate(tc.Model(bar(), gravity=9.81, ground=law), 0.25, start=first, **EXACT)
    assert first.contacts.end[0] == first.time[-1]
    assert second.contacts.begin[0] == first.time[-1]
    assert second.contacts.end[0] == pytest.approx(whole.contacts.end[0], abs=1e-8)
    lost = first.lost_energy[-1] + second.lost_energy[-1]
    assert lost == pytest.approx(whole.lost_energy[-1], rel=1e-7)


def prism_scene(**options):
    prism = tc.prism()
    law = ground(**({"height": -0.05} | options))
    strings = tc.LinearStrings(stiffness=1e3)
    model = tc.Model(prism, strings=strings, gravity=9.81, ground=law)
    lengths = tc.to_rest_length(model, prism.nodes, np.full(9, 17.3205)).rest_length
    return model, lengths


def test_under_a_controller_with_a_cut_string_and_winches():
    model, lengths = prism_scene()

    def pull(time, nodes, velocities):
        if time > 0.37:
            raise OSError("lost")
        return lengths * (1 - 0.2 * np.sin(5 * time))

    with pytest.raises(SimulationError) as caught:
        tc.simulate(
            model, 0.5, controller=pull, sample_time=0.02, rest_length=lengths,
            winches=tc.Winches(ramp=True), faults=[tc.CutString(string=3, time=0.2)],
            method="dop853", tolerance=1e-10,
        )  # fmt: skip
    run = caught.value.trajectory
    assert run.stopped is not None
    assert run.contacts.touch.size
    assert run.lost_energy[-1] > 0
    assert run.health.impulse_error < 1e-6


def test_with_rest_lengths_in_time():
    model, lengths = prism_scene()
    wound = tc.Profile([0.0, 0.3], np.column_stack([lengths, 0.9 * lengths]), "cubic")
    run = tc.simulate(model, 0.4, rest_length=wound, method="dop853", tolerance=1e-10)
    assert not run.conserves_energy
    assert run.contacts.touch.size
    assert run.health.impulse_error < 1e-6


def test_with_supports_that_move():
    """A hinged bar is lowered to the ground: two output steps tell the same works."""
    nodes = np.array([[0.0, 1.0], [0.0, 0.0], [0.3, 0.3]])
    structure = tc.Structure(
        nodes, bars=[[0, 1]], strings=np.zeros((0, 2), int), bar_mass=2.0, fixed=[0]
    )
    law = tc.Ground(stiffness=1e4, damping=0.5, friction=0.5, slip_speed=0.05)
    model = tc.Model(structure, gravity=9.81, ground=law)
    runs = [
        tc.simulate(
            model, 0.5, force_density=np.zeros(0), output_step=step, **EXACT,
            support_motion=lambda t: np.array([[0.1 * np.sin(6 * t)], [0.0], [-0.05 * t]]),
        )
        for step in (0.02, 5e-5)
    ]  # fmt: skip
    coarse, fine = (run.contacts for run in runs)
    assert list(coarse.node) == [1]
    depth = np.maximum(-runs[1].nodes[2, 1], 0)
    rate = -runs[1].velocities[2, 1]
    damped = simpson(1e4 * depth * 0.5 * rate**2, x=runs[1].time)
    assert coarse.damping_work[0, -1] == pytest.approx(damped, rel=1e-5)
    assert coarse.friction_work[0, -1] == pytest.approx(fine.friction_work[0, -1], rel=1e-6)
    assert coarse.impulse_error is None


# ---- without ground ----


def test_without_ground_there_are_no_contacts():
    run = tc.simulate(tc.Model(bar()), 0.1, force_density=np.zeros(0), step=1e-2)
    assert run.contacts is None
    assert run.ground == ()
    assert run.health.penetration is None
    assert "ground" not in run.summary()
    assert not run.lost_energy.any()


def test_a_fall_is_said():
    run = tc.simulate(tc.Model(bar(), gravity=9.81), 1.0, force_density=np.zeros(0), step=1e-2)
    assert run.health.fall == pytest.approx(9.81 / 2 - 0.1)
    assert "sizes below z = 0: there is no ground" in run.summary()
    limits = tc.HealthLimits(fall=2.0)
    with pytest.warns(AccuracyWarning, match="fall 4.8 is above its limit 2 sizes below z = 0"):
        tc.simulate(
            tc.Model(bar(), gravity=9.81), 1.0, force_density=np.zeros(0), step=1e-2, limits=limits
        )


def test_what_is_stopped_does_not_fall():
    run = tc.simulate(tc.Model(bar()), 0.1, force_density=np.zeros(0), step=1e-2)
    assert run.health.fall is None
    assert not run.falls
    assert not flat_drop(tc.Ground(stiffness=1e4), 0.01, step=1e-3).falls


def test_deep_is_worth_a_warning_but_no_error_of_the_integration():
    with pytest.warns(AccuracyWarning, match="penetration") as caught:
        flat_drop(tc.Ground(stiffness=20.0), 1.0, **EXACT)
    assert "accurate" not in str(caught[0].message)
    flat_drop(tc.Ground(stiffness=20.0), 1.0, limits=tc.HealthLimits(penetration=None), **EXACT)


def test_contacts_are_saved_with_the_run(ball, tmp_path):
    file = ball.usual.save(tmp_path / "run.npz")
    with np.load(file) as saved:
        np.testing.assert_array_equal(saved["contacts_begin"], ball.usual.contacts.begin)
    (ground,) = tc.load_run(file).ground
    assert repr(ground) == repr(ball.usual.ground[0])


def test_contacts_cost_no_more_than_the_run(monkeypatch):
    """A light node on stiff ground, in short steps: six times as much without a bound."""
    monkeypatch.setattr("tenscontrol.simulation.contacts._EVALUATIONS", 0)
    evaluations = []

    class Counted(tc.integrate.Integrator):
        name = "counted"

        def __init__(self, equation, tolerance):
            super().__init__(equation)
            self._within = tc.integrate.EnergyMomentum(equation, tolerance=tolerance)

        def advance(self, *given):
            span = self._within.advance(*given)
            evaluations.append(span.work.evaluations)
            return span

    method = tc.integrate.Method(
        "counted", ("tolerance",), "counts", Counted,
        drifts=False, differentiates=True, follows=True, locates=False,
    )  # fmt: skip
    nodes = np.array([[0, 0, 0.0], [0.3, 0, 0.02], [0, 0.3, 0.05], [0.25, 0.2, 0.3]]).T
    pairs = [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]]
    structure = tc.Structure(nodes, [], pairs, [], point_mass=[0.5, 0.6, 0.7, 1e-3])
    ground = tc.Ground(1e6, friction=1.0, slip_speed=0.01)
    model = tc.Model(structure, strings=tc.LinearStrings(2e3), gravity=9.81, ground=ground)
    run = tc.simulate(
        model, 0.02, rest_length=0.9 * structure.string_length(), method=method, tolerance=1e-5,
        output_step=1e-3, limits=tc.HealthLimits(energy_error=None), error="none",
    )  # fmt: skip
    assert run.contacts.work_error > 0
    assert run.evaluations == evaluations[0]
    assert sum(evaluations[1:]) < 1.5 * run.evaluations
