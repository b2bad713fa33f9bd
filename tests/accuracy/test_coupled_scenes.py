"""Each measure of accuracy on structures whose bars share nodes, in the plane or with clusters."""

from functools import cache, partial
from xml.etree import ElementTree

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy.measured_run import conserves_momentum, invariants
from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.accuracy.peers import CasADiCVODES, CasADiRK, MuJoCo, SciPy
from tests import coupled
from tests.benchmarks import extreme_cases


@cache
def tower_case(duration=0.5):
    """A class-2 tower let go with a tenth less force along; no string goes slack."""
    tower = coupled.tower()
    model = tc.Model(tower, strings=tc.LinearStrings(100.0))
    gamma = coupled.tower_force_density() * np.repeat([0.9, 1.0], [6, 9])
    lengths = tc.to_rest_length(model, tower.nodes, gamma).rest_length
    return tc.Scene(model, duration, rest_length=lengths)


@cache
def arm_case(duration=0.3):
    """A planar arm on a roller under gravity, with a clustered string and payloads."""
    model = tc.Model(coupled.arm(cluster=True), strings=tc.LinearStrings(500.0), gravity=9.81)
    return tc.Scene(model, duration, rest_length=0.95 * model.structure.string_length())


def d_bar_case(duration=2.0, change=(-0.1, 0.01)):
    """A free D-bar in the plane, turning, whose strings go slack by turns."""
    d_bar = coupled.d_bar()
    model = tc.Model(d_bar, strings=tc.LinearStrings(100.0))
    turning = np.vstack([-d_bar.nodes[1], d_bar.nodes[0]])
    value = d_bar.string_length() + np.array(change)
    return tc.Scene(model, duration, velocities=turning, rest_length=value)


@pytest.mark.parametrize(
    ("make", "method", "order"),
    [(tower_case, "rk4", 4), (arm_case, "rk4", 4), (arm_case, "energy_momentum", 2)],
)
def test_methods_converge_at_their_order(make, method, order):
    assert abs(tc.convergence_order(make(), method).order - order) < 0.2


def test_work_and_precision_of_methods_and_peers():
    found = tc.work_precision(
        arm_case(), methods=["rk4", "dop853"], repeats=1, outputs=20,
        settings={"rk4": [1e-3, 1e-4], "dop853": [1e-6, 1e-8]},
        peers=[SciPy("DOP853", [1e-6, 1e-9]), SciPy("Radau", [1e-6]), CasADiCVODES([1e-9]),
               CasADiRK([1e-4])],
    )  # fmt: skip
    rows = [row for row in found.rows if not row.failure]
    assert len(rows) == len(found.rows) == 9
    for name in ("rk4", "dop853", "scipy dop853", "scipy radau", "casadi cvodes", "casadi rk"):
        assert min(row.error for row in rows if row.method == name) < 2e-6, name
    assert max(row.bar_length_drift for row in rows if row.method == "dop853") < 1e-13


def test_a_long_run_keeps_energy_and_lengths():
    found = tc.long_run(tower_case(), "energy_momentum", 1e-2, steps=1000, outputs=100)
    assert found.of("bar length").largest < 1e-12
    assert found.of("angular momentum").largest < 1e-11
    assert found.of("energy").largest < 1e-2 * found.energy_scale


def test_predictability_of_a_planar_arm():
    found = tc.predictability(arm_case(), samples=2)
    assert found.growth.max() < 100
    assert found.horizon == arm_case().duration


def test_stable_steps_over_stiffness_and_payload():
    def near_rest(stiffness, mass_ratio):
        structure = coupled.d_bar(point_mass=[0.0, mass_ratio, 0.0, mass_ratio])
        model = tc.Model(structure, strings=tc.LinearStrings(stiffness))
        lengths = (1 - 10.0 / stiffness) * structure.string_length()
        spread = structure.nodes * [[1.0001], [1.0]]
        nodes = tc.structure.restore_bar_lengths(structure, spread)
        return tc.Scene(model, 1.0, nodes, rest_length=lengths)

    found = tc.stability_map("rk4", [1e2, 1e4], [1e-1], case=near_rest, steps=500)
    np.testing.assert_allclose(found.step / found.bound, 1.0, atol=0.05)


def test_what_a_planar_motion_conserves():
    case = d_bar_case()
    run = tc.simulate(
        case.model, case.duration, velocities=case.velocities, rest_length=case.input_value,
        method="energy_momentum", step=1e-3,
    )  # fmt: skip
    structure = case.structure
    moments = zip(run.nodes.T, run.velocities.T, strict=True)
    states = np.column_stack(
        [tc.dynamics.equation.pack_state(structure, N.T, V.T) for N, V in moments]
    )
    found = invariants(case, states)
    assert found.momentum.shape[0] == 2
    assert found.angular_momentum.shape[0] == 1
    assert np.ptp(found.angular_momentum) < 1e-12
    assert found.stretch.max() < 1e-13
    assert conserves_momentum(case)
    assert not conserves_momentum(arm_case())


def test_a_bound_of_the_fastest_motion():
    """Of the arm, that of its only motion: half the power of its two eigenvalues."""
    assert fastest_rate(arm_case()) > 1.0
    assert fastest_rate(tower_case()) == pytest.approx(29.7, abs=1.0)


@pytest.mark.parametrize(
    ("make", "order"), [(tower_case, 4), (arm_case, 2), (partial(d_bar_case, 0.3, (-0.5, -0.5)), 2)]
)
def test_mujoco_runs_joined_bars(make, order):
    """Bars in a tree are joined exactly; joints that close a loop are springs of two steps."""
    pytest.importorskip("mujoco", reason="MuJoCo comes with the extra test")
    steps = [4e-3, 2e-3, 1e-3]
    found = tc.work_precision(make(), ["rk4"], {"rk4": [1e-3]}, peers=[MuJoCo("rk4", steps)],
                              repeats=1, outputs=5)  # fmt: skip
    errors = [row.error for row in found.of("mujoco rk4")]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(order, abs=0.7)
    assert errors[-1] < 1e-5


def test_mujoco_refuses_by_name_what_it_cannot_do(monkeypatch):
    from tenscontrol.accuracy.peers import rigid_bodies

    monkeypatch.setattr(rigid_bodies, "find_spec", lambda name: True)
    ladder = tc.Structure(
        [[0.0, 1.0], [1.0, 0.0]], [[0, 1]], np.zeros((0, 2), int), 1.0, fixed=[(0, "x"), (1, "y")]
    )
    case = tc.Scene(tc.Model(ladder), 0.1, force_density=np.zeros(0))
    assert "node 1 is on a roller" in MuJoCo("rk4").refuse(case)


def test_a_tendon_of_mujoco_runs_over_the_nodes_of_a_clustered_string():
    (extreme, _) = extreme_cases._short_segment()
    text = tc.exchange.to_mujoco(extreme.case.model, rest_length=extreme.case.input_value)
    tendons = ElementTree.fromstring(text).findall("tendon/spatial")
    sites = [[site.get("site") for site in tendon] for tendon in tendons]
    assert sites == [["n0", "n2", "n1"], ["n1", "n3"]]
    assert MuJoCo("rk4").refuse(extreme.case) in (None, "mujoco is not installed: pip install "
                                                  "'tenscontrol[bench]'")  # fmt: skip


def test_new_scenes_of_the_suite_are_of_the_kinds_they_name():
    kinds = {
        extreme.group: extreme.case.structure
        for make in (
            extreme_cases._class_2_tower, extreme_cases._spine, extreme_cases._chain,
            extreme_cases._short_segment, extreme_cases._d_bar,
        )
        for extreme in make()
    }  # fmt: skip
    assert [structure.structure_class for structure in kinds.values()] == [2, 4, 2, 1, 2]
    assert all(block.is_redundant for block in kinds["spine of redundant bars"].blocks)
    assert kinds["segment of a string"].has_clusters
    assert kinds["D-bar through slack"].dimension == 2
    assert np.ptp(np.log10(kinds["chain of 20 bars"].bar_mass)) == 6
