"""Optimal motions against closed forms, and of the arm against its replay."""

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

import tenscontrol as tc
from tenscontrol.optimize import OptimalMotionWarning
from tenscontrol.status import Status
from tests.benchmarks.optimal_motions import optimality, planned

# A mass on a rail between two strings: kg, m, N, and how far away they are fixed, m.
MASS, WAY, FORCE, REACH = 2.0, 0.4, 3.0, 20.0


def rail(place, reach=REACH):
    """Return the structure with its mass at a place, m."""
    return tc.Structure(
        [[-reach, place, reach], [0.0, 0.0, 0.0]],
        bars=[],
        strings=[[0, 1], [1, 2]],
        bar_mass=None,
        fixed=[0, 2, (1, "y")],
        point_mass=[0.0, MASS, 0.0],
    )


def along_rail(**arguments):
    """Return the optimal motion along the rail."""
    ends = [
        tc.prestress(rail(x), 1 / np.array([REACH + x, REACH - x])) for x in (-WAY / 2, WAY / 2)
    ]
    return tc.optimal_motion(tc.Model(rail(-WAY / 2)), *ends, **arguments)


def force(motion):
    """Return the force on the mass in the middle of each interval, N, and when, s."""
    time = (motion.time[1:] + motion.time[:-1]) / 2
    run = tc.simulate(motion.model, motion.duration, force_density=motion.profile, error="none")
    x = np.interp(time, run.time, run.nodes[0, 1])
    left, right = motion.profile.at(time)
    return right * (REACH - x) - left * (REACH + x), time


def test_fastest_motion_along_a_rail_is_bang_bang():
    motion = along_rail(max_tension=FORCE)
    assert motion.status is Status.OK
    np.testing.assert_allclose(motion.duration, 2 * np.sqrt(MASS * WAY / FORCE), rtol=1e-6)
    pushed = force(motion)[0]
    np.testing.assert_allclose(pushed, np.repeat([FORCE, -FORCE], 10), rtol=1e-4)
    assert motion.goal_miss < 1e-6
    assert motion.peak_tension < FORCE * (1 + 1e-5)


def test_motion_of_least_effort_is_a_cubic():
    duration = 1.5
    motion = along_rail(minimize="effort", duration=duration, intervals=20, refinements=0)
    largest = 6 * MASS * WAY / duration**2
    pushed, time = force(motion)
    np.testing.assert_allclose(pushed, largest * (1 - 2 * time / duration), atol=1e-4 * largest)
    share = motion.time / duration
    way = WAY * (3 * share**2 - 2 * share**3) - WAY / 2
    np.testing.assert_allclose(motion.nodes[0, 1], way, atol=1e-4 * WAY)
    np.testing.assert_allclose(motion.cost, 12 * (MASS * WAY) ** 2 / duration**3, rtol=1e-4)


# A mass that hangs on a winch: kg, m/s², how far it is raised and from where, m, and the drum, m.
HUNG, GRAVITY, RAISED, BELOW, DRUM = 1.0, 9.81, 0.3, 2.0, 0.01


def test_fastest_motor_with_inertia_is_bang_bang():
    """All momentum is due to the force of the motor and the weight: up by F - m g, then F + m g.

    With F = 3 m g and a string whose period is that of the second part, nothing swings at the end.
    """
    turning, weight = 10 * HUNG, HUNG * GRAVITY
    slow, fast = (np.array([2.0, 4.0]) * weight / (HUNG + turning)).tolist()
    duration = np.sqrt(2 * RAISED * (1 / slow + 1 / fast))
    stiffness = (2 * np.pi / (duration / 3)) ** 2 / (1 / HUNG + 1 / turning)

    def hung(depth):
        return tc.Structure(
            [[0.0, 0.0], [0.0, -depth]],
            bars=[],
            strings=[[0, 1]],
            bar_mass=None,
            fixed=[0, (1, "x")],
            point_mass=[0.0, HUNG],
        )

    model = tc.Model(hung(BELOW), tc.LinearStrings(stiffness), gravity=GRAVITY)
    ends = [
        tc.shape_target(
            model, tc.NodesAt([1], [[0.0], [-depth]]), start=hung(depth).nodes, prestress="least"
        )
        for depth in (BELOW, BELOW - RAISED)
    ]
    motor = tc.Motor(DRUM, torque=3 * weight * DRUM, inertia=turning * DRUM**2)
    winches = tc.Winches(motor=motor)
    motion = tc.optimal_motion(
        model, *ends, winches=winches, intervals=15, refinements=0, tolerance=1e-3
    )
    assert motion.status is Status.OK
    np.testing.assert_allclose(motion.duration, duration, rtol=1e-5)
    # What the motor does, by the replay and the profile; within an interval both are smooth.
    run, profile = motion.run, motion.profile
    middle = (motion.time[1:] + motion.time[:-1]) / 2
    length = run.nodes[1, 0] - run.nodes[1, 1]
    tension = np.interp(middle, run.time, (run.force_density * length)[0])
    force = tension - turning * profile.pieces.derivative(2).at(middle)[0]
    np.testing.assert_allclose(force, 3 * weight * np.repeat([1, -1], [10, 5]), rtol=1e-2)
    np.testing.assert_allclose(motion.energy, 3 * weight * RAISED * 2 / 3, rtol=5e-3)
    assert not profile.rate([0.0, motion.duration]).any()
    with pytest.raises(ValueError, match="inertia, and force densities may jump"):
        tc.optimal_motion(model, *ends, winches=winches, input="force_density")


# ---- passive and ganged strings ----


def test_fastest_motion_against_a_spring_has_one_switch():
    """Between a string of constant γ and one of tension 0 to F, the mass goes along two circles.

    In the plane of x and velocity over ω, with ω² = γ / m: one about where F balances γ, then one
    about where nothing does. F is such that they meet in the middle.
    """
    gamma, reach = 10.0, 0.4
    ends = [
        tc.prestress(rail(x, reach), gamma * np.array([1.0, (reach + x) / (reach - x)]))
        for x in (-WAY / 2, WAY / 2)
    ]
    model = tc.Model(ends[0].structure)
    plant = tc.linearize(model, ends[0], input="force_density", actuated=[1])
    largest = np.array([np.inf, 2 * reach * gamma])
    motion = tc.optimal_motion(model, *ends, plant=plant, max_tension=largest, intervals=10)
    exact = 2 * np.arccos(reach / (reach + WAY / 2)) / np.sqrt(gamma / MASS)
    np.testing.assert_allclose(motion.duration, exact, rtol=1e-5)
    assert motion.status is Status.OK
    np.testing.assert_array_equal(motion.run.force_density[0], gamma)


# Of the strings below, N/m and m. The second one of the winch is wound half as fast as the first.
STIFFNESS, SPRING, SHIFT, HALF = 40.0, 0.6, 0.975, 0.5


def spring_and_winch(x):
    """Return an equilibrium of a mass at x, m, between a spring and two strings of one winch."""
    structure = tc.Structure(
        [[-1.0, x, 1.0, 1.5], np.zeros(4)],
        bars=[],
        strings=[[0, 1], [1, 2], [1, 3]],
        bar_mass=None,
        fixed=[0, 2, 3, (1, "y")],
        point_mass=[0.0, MASS, 0.0, 0.0],
    )
    length = structure.string_length()
    wound = (length[1] + length[2] - SHIFT - (length[0] - SPRING)) / (1 + HALF)
    rest_length = np.array([SPRING, wound, SHIFT + HALF * wound])
    return tc.prestress(structure, STIFFNESS * (1 - rest_length / length))


@pytest.fixture(scope="module")
def ganged():
    """Return model, ends and plant of a mass that goes 0.2 m against a spring."""
    start, goal = spring_and_winch(-0.1), spring_and_winch(0.1)
    model = tc.Model(start.structure, tc.LinearStrings(STIFFNESS))
    winch = {"winch": {1: 1.0, 2: HALF}}
    return model, start, goal, tc.linearize(model, start, input="rest_length", actuated=winch)


def test_least_effort_of_a_ganged_winch_is_that_of_the_gramian(ganged):
    """The state x, ẋ, rest length is linear in the rate: the least ∫ rate² is dᵀ W⁻¹ d."""
    *scene, plant = ganged
    duration = 0.9
    motion = tc.optimal_motion(
        *scene, plant=plant, minimize="effort", duration=duration, intervals=40, refinements=0
    )
    A = np.array([[0.0, 1.0, 0.0], [-3 * STIFFNESS, 0.0, -(1 + HALF) * STIFFNESS], np.zeros(3)])
    A[1] /= MASS
    B = np.array([[0.0], [0.0], [1.0]])
    exponential = expm(np.block([[-A, B @ B.T], [np.zeros((3, 3)), A.T]]) * duration)
    gramian = exponential[3:, 3:].T @ exponential[:3, 3:]  # Van Loan 1978
    way = np.array([0.2, 0.0, motion.rest_length[1, -1] - motion.rest_length[1, 0]])
    np.testing.assert_allclose(motion.cost, way @ np.linalg.solve(gramian, way), rtol=1e-4)
    wound = motion.run.rest_length
    np.testing.assert_array_equal(wound[0], wound[0, 0])
    np.testing.assert_allclose(wound[2], SHIFT + HALF * wound[1], atol=1e-12)
    assert motion.goal_miss < 1e-6


def test_least_work_of_a_ganged_winch_is_what_its_strings_store(ganged):
    *scene, plant = ganged
    motor = tc.Motor(drum_radius=0.01, torque=0.18)
    slow = tc.Winches(rate=[9.0, 9.0, 0.15], motor=motor)  # of the second string, by half
    how = {"plant": plant, "duration": 1.6, "winches": slow, "max_power": 4.0}
    motion = tc.optimal_motion(*scene, minimize="energy", **how)
    stored = []
    for rest in scene[1:]:
        length = rest.structure.string_length()
        stretch = rest.force_density * length / STIFFNESS
        stored.append(STIFFNESS / 2 * float(stretch @ stretch))
    np.testing.assert_allclose(motion.cost, stored[1] - stored[0], rtol=1e-6)
    np.testing.assert_allclose(motion.energy, motion.cost, rtol=1e-3)
    assert np.abs(motion.rate[1]).max() < 0.3 * (1 + 1e-9)
    run = motion.run
    tension = run.force_density * run.model.structure.string_length(run.nodes)
    power = -(tension[1] + HALF * tension[2]) * np.gradient(run.rest_length[1], run.time)
    assert power.max() < 4.0 * (1 + 1e-3)
    assert (tension[1] + HALF * tension[2]).max() < 18.0 * (1 + 1e-3)
    # All motions that take nothing back give this work: the plan is the one of least effort.
    effort = float(motion.rate[1] ** 2 @ np.diff(motion.time))
    least = tc.optimal_motion(*scene, minimize="effort", **how)
    np.testing.assert_allclose(effort, least.cost, rtol=1e-4)


def test_torque_of_antagonists_on_one_drum_limits_both_ways():
    """The drum is pulled as the mass is: the fastest motion is bang-bang, but for ramps."""
    reach, sum_of_lengths = 1.0, 1.4
    ends = []
    for x in (-WAY / 2, WAY / 2):
        wound = sum_of_lengths / 2 + np.array([x, -x])
        length = np.array([reach + x, reach - x])
        ends.append(tc.prestress(rail(x, reach), STIFFNESS * (1 - wound / length)))
    model = tc.Model(ends[0].structure, tc.LinearStrings(STIFFNESS))
    drum = {"drum": {0: -1.0, 1: 1.0}}
    plant = tc.linearize(model, ends[0], input="rest_length", actuated=drum)
    motor = tc.Motor(drum_radius=0.01, torque=0.01 * FORCE)
    motion = tc.optimal_motion(
        model, *ends, plant=plant, winches=tc.Winches(motor=motor), intervals=40, refinements=0
    )
    bang_bang = 2 * np.sqrt(MASS * WAY / FORCE)
    assert bang_bang < motion.duration < 1.06 * bang_bang
    tension = motion.run.force_density * motion.model.structure.string_length(motion.run.nodes)
    pull = tension[1] - tension[0]
    np.testing.assert_allclose([pull.min(), pull.max()], [-FORCE, FORCE], rtol=2e-2)


# ---- the arm ----

RATE = 0.8
WINCHES = tc.Winches(rate=RATE, shortest=0.1)


@pytest.fixture(scope="module")
def arm():
    """Return model, start and goal: the tip 10 cm higher."""
    structure = tc.library.arm()
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness=500.0, damping=2.0))
    rest = tc.prestress(structure, min_force_density=50.0)
    raised = tc.NodesAt([5], structure.nodes[:, [5]] + [[0.0], [0.1]])
    return model, rest, tc.shape_target(model, raised, force_density=50.0)


@pytest.fixture(scope="module")
def fastest(arm):
    return tc.optimal_motion(*arm, winches=WINCHES)


def test_the_arm_is_at_rest_at_its_goal_within_a_fifth_of_a_second(arm, fastest):
    model, _, goal = arm
    run = tc.simulate(
        model, fastest.duration, rest_length=fastest.profile, method="cvodes", tolerance=1e-8
    )
    assert fastest.status is Status.OK
    assert fastest.guess == "path"
    assert fastest.duration < 0.2
    assert np.abs(run.nodes[:, :, -1] - goal.nodes).max() < 2e-5
    assert np.abs(run.velocities[:, :, -1]).max() < 1e-3
    assert np.abs(fastest.rate).max() < RATE * (1 + 1e-9)
    length = np.linalg.norm(model.structure.bar_vectors(fastest.nodes[:, :, 7]), axis=0)
    np.testing.assert_allclose(length, model.structure.bar_length, rtol=1e-7)
    assert fastest.least_force_density > 1.0
    assert "ok" in fastest.summary()


@pytest.fixture(scope="module")
def coarse(arm):
    return tc.optimal_motion(*arm, winches=WINCHES, intervals=4, refinements=0, tolerance=3e-2)


def test_identical_calls_take_identical_iterations(arm, coarse):
    again = tc.optimal_motion(*arm, winches=WINCHES, intervals=4, refinements=0, tolerance=3e-2)
    assert repr(again.meshes) == repr(coarse.meshes)
    np.testing.assert_array_equal(again.nodes, coarse.nodes)


def test_meshes_are_halved_until_the_replay_meets_the_goal_and_the_cost_settles(fastest, coarse):
    ten, twenty = fastest.meshes
    assert (ten.intervals, twenty.intervals) == (10, 20)
    # Gauss points are of order 4, the duration of order 2 in the intervals.
    assert twenty.goal_miss < ten.goal_miss / 8
    assert 0 < fastest.cost_change < 0.01
    assert coarse.status is Status.OK  # a mesh alone is not judged
    assert np.isnan(coarse.cost_change)
    assert 1.01 < coarse.duration / fastest.duration < 1.06


def test_a_cost_that_has_not_settled_says_so(arm):
    with pytest.warns(OptimalMotionWarning, match="cost changed by .* %.*more intervals"):
        motion = tc.optimal_motion(
            *arm, minimize="effort", duration=0.3, intervals=4, refinements=1, tolerance=3e-2
        )
    assert motion.status is Status.INACCURATE
    assert 0.01 < motion.cost_change < 0.2
    assert motion.profile.time[-1] == 0.3


def test_least_effort_is_stationary_by_the_derivatives_of_the_simulator(arm):
    how = {"minimize": "effort", "duration": 0.3, "refinements": 0, "tolerance": 1e-3}
    off = []
    for intervals in (10, 20):
        motion, mesh, solution = planned(arm, how | {"intervals": intervals})
        off.append(optimality(motion, mesh, solution.multipliers))
    assert off[1] < 2e-3
    assert off[1] < off[0] / 10  # of order 4
    of_bounds, of_rows = solution.multipliers
    assert optimality(motion, mesh, (of_bounds, 0.9 * of_rows)) > 0.05


def test_least_work_is_that_of_the_replay(arm):
    motion = tc.optimal_motion(
        *arm, winches=WINCHES, minimize="energy", duration=0.3, refinements=0, tolerance=1e-3
    )
    np.testing.assert_allclose(motion.energy, motion.cost, rtol=5e-3)
    assert motion.duration == pytest.approx(0.3)
    # Less than what raises the elastic energy cannot be.
    run = motion.run
    assert motion.energy > run.energy[-1] - run.energy[0]


def test_a_cost_of_ones_is_the_duration(arm, coarse):
    motion = tc.optimal_motion(
        *arm,
        winches=WINCHES,
        minimize=lambda nodes, velocities, rest_length, rate: 1 + 1e-3 * ca.sumsqr(rate / RATE),
        intervals=4,
        refinements=0,
        tolerance=3e-2,
    )
    np.testing.assert_allclose(motion.cost, coarse.duration, rtol=1e-2)
    assert motion.minimize == "<lambda>"


def test_limits_hold_in_the_replay(arm, fastest):
    model, _, _ = arm
    centre = model.structure.nodes[:, 5] + [-0.04, 0.05]
    motor = tc.Motor(drum_radius=0.01, gear_ratio=10.0, torque=0.108, speed=800.0)
    motion = tc.optimal_motion(
        *arm,
        winches=tc.Winches(motor=motor),
        max_power=60.0,
        obstacles=lambda nodes: ca.norm_2(nodes[:, 5] - ca.DM(centre)) - 0.04,
        intervals=8,
        cost_tolerance=None,
        tolerance=3e-3,
    )
    assert motion.status is Status.OK
    assert motion.duration > fastest.duration
    assert motion.peak_tension < 108.0 * (1 + 1e-3)
    assert np.abs(motion.rate).max() < 0.8 * (1 + 1e-9)
    away = np.linalg.norm(motion.run.nodes[:, 5] - centre[:, None], axis=0)
    assert away.min() > 0.04 - 2e-3
    assert np.linalg.norm(fastest.run.nodes[:, 5] - centre[:, None], axis=0).min() < 0.04 - 2e-3


def test_what_cannot_be_done_in_time_says_so(arm):
    with pytest.warns(OptimalMotionWarning, match="Give more time"):
        motion = tc.optimal_motion(
            *arm, winches=WINCHES, minimize="effort", duration=0.1, intervals=4
        )
    assert motion.run is None
    assert motion.status is Status.INFEASIBLE
    assert np.isnan(motion.goal_miss)
    for use in (lambda: motion.profile, motion.reference, lambda: tc.plot.optimal_motion(motion)):
        with pytest.raises(ValueError, match="planned"):
            use()


def test_mpc_follows_the_plan(arm, fastest):
    model, _, goal = arm
    plant = tc.linearize(model, goal.prestress, input="rest_length")
    mpc = tc.MPC(
        plant, horizon=10, sample_time=0.01, reference=fastest.reference(),
        winches=tc.Winches(rate=2.0, ramp=True), min_force_density=1.0,
    )  # fmt: skip
    run = tc.simulate(
        model, 0.5, controller=mpc, winches=tc.Winches(rate=2.0, ramp=True),
        rest_length=fastest.rest_length[:, 0], error="none",
    )  # fmt: skip
    half = int(np.searchsorted(run.time, fastest.duration / 2))
    assert np.abs(run.nodes[:, :, half] - fastest.at(run.time[half])[0]).max() < 0.02
    assert np.abs(run.nodes[:, :, -1] - goal.nodes).max() < 3e-3


def test_a_free_prism_gets_lower_wherever_it_turns():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    rest = tc.prestress(prism, force_density=17.3205)
    low = tc.Height(0.9, top=[0, 1, 2], bottom=[3, 4, 5])
    motion = tc.optimal_motion(
        model, rest, low, winches=tc.Winches(rate=0.2), refinements=0, tolerance=2e-3
    )
    assert motion.status is Status.OK
    last = motion.run.nodes[:, :, -1]
    height = np.linalg.norm(last[:, :3].mean(axis=1) - last[:, 3:].mean(axis=1))
    assert height == pytest.approx(0.9, abs=4e-3)
    assert motion.goal_distance(motion.run.nodes)[-1] == motion.goal_miss


def test_the_duration_does_not_run_away_from_the_guess():
    """With 50 times the time of the guess at hand, IPOPT got lost on this mesh."""
    cross = tc.library.snelson_x()
    model = tc.Model(cross, tc.LinearStrings(500.0, damping=2.0))
    rest = tc.prestress(cross, min_force_density=20.0)
    moved = tc.NodesAt([3], cross.nodes[:, [3]] + 0.1 * np.array([[0.7368005], [-0.67611021]]))
    motion = tc.optimal_motion(
        model, rest, moved, winches=tc.Winches(rate=0.5), min_force_density=1.0, intervals=8,
        refinements=0, tolerance=3e-2,
    )  # fmt: skip
    assert motion.status is Status.OK
    assert motion.duration < 0.38


# ---- bars, and bad input ----


def test_distances_of_bars_are_those_of_the_structure():
    from tenscontrol.optimize.motion_limits import bar_clearances
    from tenscontrol.structure.bar_clearance import bar_distances

    ball = tc.library.six_bar_ball()
    N = ca.SX.sym("N", *ball.nodes.shape)
    function = ca.Function("apart", [N], [bar_clearances(ball, N)])
    random = np.random.default_rng(0)
    for _ in range(20):
        nodes = ball.nodes + 0.5 * random.normal(size=ball.nodes.shape)
        found = np.array(function(nodes)).ravel()
        np.testing.assert_allclose(found, bar_distances(ball, nodes).distance, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"minimize": "tim"}, "minimize"),
        ({"minimize": "energy"}, "expected duration"),
        ({"duration": 1.0}, "duration is given"),
        ({"max_tension": -1.0}, "max_tension"),
        ({"min_clearance": 0.1}, "plane"),
        ({"intervals": 0}, "intervals"),
        ({"goal": iter([])}, "goal is a list_iterator, expected a demand"),
        ({"intervals": 2}, "intervals is 2, which leaves .* give more intervals"),
        ({"winches": tc.Winches(rate=np.ones(5))}, "winches.rate"),
        ({"min_force_density": 60.0}, "start"),
        ({"winches": tc.Winches(motor=tc.Motor(0.01, lag=0.1))}, "lag or backlash"),
        (
            {"winches": tc.Winches(motor=tc.Motor(0.01, torque=9.0, inertia=5 * [1e-4] + [0.0]))},
            "the motor of string 5 has no inertia beside others",
        ),
        ({"obstacles": lambda nodes: "far"}, "obstacles"),
        ({"obstacles": lambda nodes: [nodes[1, 5], None]}, "obstacles.* entry 1,.* NoneType"),
        ({"minimize": lambda nodes, velocities, input, rate: nodes}, "minimize"),
        ({"max_tension": 90.0}, "start is an end.*max_tension"),
        ({"obstacles": lambda nodes: 1.05 - nodes[1, 5]}, "goal is an end.*obstacles"),
    ],
)
def test_bad_arguments_are_named(arm, arguments, text):
    model, start, goal = arm
    given = {"goal": goal, "winches": WINCHES} | arguments
    with pytest.raises((TypeError, ValueError), match=text):
        tc.optimal_motion(model, start, **given)


def test_what_a_plant_cannot_hold_is_refused(ganged):
    model, start, goal, plant = ganged
    other = tc.linearize(model, start, input="rest_length", actuated=[1])
    for arguments, text in (
        ({"plant": other}, "goal has a rest length.*string 2, which is passive"),
        ({"plant": plant, "input": "force_density"}, "input is 'force_density'"),
        ({"plant": model}, "plant"),
    ):
        with pytest.raises((TypeError, ValueError), match=text):
            tc.optimal_motion(model, start, goal, **({"winches": WINCHES} | arguments))


def test_ends_are_checked(arm):
    model, rest, _ = arm
    with pytest.raises(ValueError, match="same shape"):
        tc.optimal_motion(model, rest, rest, winches=WINCHES)
    far = tc.NodesAt([5], model.structure.nodes[:, [5]] + [[1.0], [0.0]])
    with pytest.raises(tc.shape.ShapeError, match="no equilibrium"):
        tc.optimal_motion(model, rest, far, winches=WINCHES)
    with pytest.raises(ValueError, match="ground"):
        tc.optimal_motion(model.replace(ground=tc.Ground(1e3)), rest, rest)
