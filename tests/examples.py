"""Numbers of the examples: what each must find. The gallery checks them when it has run one."""

from importlib.util import find_spec

import numpy as np

import tenscontrol as tc

NUMBERS = {}  # by the name of the file: what checks the names that the example leaves


def checks(function):
    """Register the check of the example of this name."""
    NUMBERS[f"plot_{function.__name__}.py"] = function
    return function


def assert_near(value, expected, off):
    np.testing.assert_allclose(value, expected, rtol=0, atol=off)


@checks
def control_ball(names):
    assert [len(each) for each in names["left_alone"].values()] == [1, 0]
    assert all(controlled[-1] < 0.02 * controlled[0] for controlled, _ in names["returns"].values())
    assert all(abs(moved[-1, 1] - 0.1) < 1e-3 for moved in names["moves"].values())


@checks
def control_landing(names):
    ways, steps, slope = (np.asarray(names[name]) for name in ("ways", "steps", "slope"))
    assert (np.diff(ways) > 0).all()
    told = slope @ names["along"]
    assert_near((ways[1] - ways[0]) / steps[1], told, 0.03 * told)
    # The throw is symmetric, and so are the strings.
    assert_near(slope[:8], slope[8:16], 0.05)


@checks
def fit_ball(names):
    before, found = names["before"], names["found"]
    assert len(before.untold) == 1
    scale = np.abs(before.untold[0])  # stiffness, damping, masses and ground alike
    assert_near(scale[:-1], np.full(32, 32**-0.5), 1e-6)
    assert found.converged
    assert found.identifiability.is_told.all()
    assert_near(found.parameters["stiffness"] / names["stiffness"], np.ones(24), 0.02)
    assert_near(found.parameters["ground.friction"], 0.4, 0.02)
    assert_near(names["check"].root_mean_square, 1.0, 0.1)


@checks
def ground_lander(names):
    # Softest and stiffest strings both stop the payload harder than those between.
    for height, values in names["peak"].items():
        least = values.argmin()
        assert 0 < least < len(values) - 1, height
        assert values[0] > 1.5 * values[least]
        # Least deceleration: at constant force over all the room there is.
        assert values[least] > 0.9 * height / names["LENGTH"]
    assert list(names["best"].values()) == sorted(names["best"].values())
    assert names["error"] < 1e-4
    assert not names["run"].health.crossings
    assert names["soft"].health.crossings


@checks
def ground_thrown_prisms(names):
    assert names["batch"].completed.all()
    assert 0 < names["toppled"].sum() < 200


@checks
def ground_rolling(names):
    assert names["path"].margin[-1] > 0
    for name, gait in names["gaits"].items():
        after = names["runs"][name]
        assert len(gait.made) == 5, name
        assert (after.nodes[:, :, -1] - after.nodes[:, :, 0]).mean(axis=1)[0] > 0.8, name
        assert np.abs(after.control.winch_rate).max() <= 0.2 * (1 + 1e-9)
        assert after.control.applied.min() >= 0.35
        assert after.control.applied.max() <= 0.8


@checks
def sizing_ball(names):
    for sized, found in names["designs"].values():
        margins = found.bar_margin.min(), found.string_margin.min()
        np.testing.assert_allclose(margins, names["SAFETY"], rtol=0.01)
        assert 0.3 < sized.mass < 1.0
    masses = list(names["mass"].values())
    assert masses == sorted(masses)
    assert "the margin of buckling of bar " in names["failure"]
    assert names["off"] < 1e-3


@checks
def sizing_mast(names):
    assert 6 < names["best"] < 16
    assert names["mass"][names["best"]] < 0.7 * names["mass"][4]
    changes = [each.change[1] for each in names["rigid"].values()]
    assert changes == sorted(changes, reverse=True)
    late = {name: np.abs(each[-50:]).max() for name, each in names["top"].items()}
    assert late["MPC"] < 0.02 * late["strings held"]
    assert names["strong"]["MPC"].margin > 1.5
    assert set(names["mpc"].statistics.status_count) == {tc.control.Status.OK}


@checks
def modes(names):
    held, free = names["held"], names["free"]
    assert names["rest"].mechanisms == 9
    assert_near(held.frequency[0], 2.04752, 5e-5)
    assert (held.frequency > 0).all()
    assert (free.frequency == 0).sum() == names["reach"].unreachable == 4


@checks
def control_profiles(names):
    run_, height = names["run"], names["height"]
    ground = run_.nodes[:, 0] - names["tower"].nodes[:, [0]]
    assert_near(ground[1], [names["ground"](t)[1, 0] for t in run_.time], 1e-9)
    assert_near(height[0] - height[-1], 0.0882, 2e-3)
    still = np.abs(run_.velocities[:, :, np.isclose(run_.time, 1.99, atol=6e-3)]).max()
    assert still < 0.05  # before the gust
    assert np.abs(run_.bar_length_error).max() < 1e-12


@checks
def library(names):
    counts = {name: tuple(each) for name, each in names["found"].items()}
    assert set(counts) == set(tc.library.__all__)
    assert (counts["levy_dome"], counts["stedy_arm"]) == ((13, 1), (6, 0))
    assert (counts["class2_tower"], counts["spine"]) == ((3, 3), (9, 0))
    assert len(names["figure"].axes) == len(counts)


@checks
def control_shape(names):
    errors, runs = names["errors"], names["runs"]
    largest = {key: off[runs[key].time >= 0.5].max() for key, off in errors.items()}
    assert largest["force_density", "shape control"] < 0.5 * largest["force_density", "MPC"]
    assert largest["rest_length", "MPC"] < 0.5 * largest["rest_length", "shape control"]
    assert max(off[-25:].max() for off in errors.values()) < 5e-4
    assert 0.01 < names["left"].largest_residual < 0.4


@checks
def control_own(names):
    on_ball, on_tower = names["errors"]
    last = {name: off[-1] for name, off in (on_ball | on_tower).items()}
    held = [off["rest lengths held"][-1] for off in (on_ball, on_tower)]
    assert last["PD on string lengths"] < 0.5 * held[0]
    assert last["LQR of python-control"] < 1e-5
    assert last["MPC by casadi.Opti"] < 0.3 * held[1]
    imitated = on_tower["network"] - on_tower["the LQR it imitates"]
    assert np.abs(imitated).max() < 1e-3
    assert set(names["tower_runs"]["MPC by casadi.Opti"].control.status) == {"ok"}
    # The gain of python-control gives the commands of our own LQR.
    plant, ball = names["plant"], names["ball"]
    own = tc.LQR(plant, names["Q"], names["R"])
    random = np.random.default_rng(0)
    for _ in range(20):
        q, rates = random.normal(size=(2, plant.degrees_of_freedom)) * [[1e-3], [1e-2]]
        motion = plant.to_nodes(q), plant.to_velocities(q, rates)
        theirs = names["lqr_of_control"](0.0, *motion)
        np.testing.assert_allclose(own.command(0.0, *motion).value, theirs, rtol=0, atol=1e-9)
    assert ball.structure_class == 1


@checks
def shape_new_height(names):
    assert abs(names["height_error"]) < 1e-3
    assert names["run"].force_density.min() > 0
    assert np.abs(names["run"].control.winch_rate).max() <= 0.5


@checks
def optimal_arm(names):
    motion, late = names["motion"], names["time"] > 0.21
    off = {name: np.abs(height[late] - names["LIFT"]) for name, height in names["heights"].items()}
    assert names["path"].time[-1] < motion.duration < 0.2
    assert off["fastest to rest"].max() < 1e-5
    assert off["path through equilibria"].max() > 0.02
    assert np.abs(motion.rate).max() <= names["RATE"] * (1 + 1e-9)


@checks
def optimal_mast(names):
    motion, work = names["motion"], names["work"]
    assert_near(work["least work"], motion.energy, 0.5)
    assert work["least work"] < 0.8 * work["equilibria"]
    swing = {
        name: float(np.ptp(run.nodes[2, 0][run.time > names["DURATION"]]))
        for name, run in names["runs"].items()
    }
    assert swing["least work"] < 1e-3
    assert swing["equilibria"] > 0.02


@checks
def shape_path(names):
    path = names["path"]
    assert_near(names["missed"], 5.0, 1e-6)
    assert np.abs(path.rest_length_rate).max() <= 0.1
    assert path.residual < 1e-12
    assert names["left"] < 1e-3


@checks
def paper_string_mass(names):
    assert names["massive"].nodes.shape == (3, 33)
    assert 0.05 < names["mass_effect"] < 0.1
    assert names["half_speed_error"] < 1e-6


@checks
def paper_skin(names):
    travel = names["travel"]
    shares = {v: travel[v, "with skin"] / travel[v, "without skin"] for v in (9.0, 45.0)}
    assert shares[9.0] > 0.9  # slack: hardly an effect
    assert shares[45.0] < 0.55  # taut: half the travel


@checks
def control_robustness(names):
    reports = names["reports"]
    without, estimated = reports["no load estimated"], reports["load estimated"]
    assert (len(without), len(estimated)) == (10, 20)
    assert without.confidence_interval()[1] < estimated.confidence_interval()[0]
    assert without.success_rate == 0.0
    assert estimated.success_rate == 1.0
    assert_near(estimated.figure("final_error").max(), 0.0155, 1e-3)


@checks
def control_string_mass(names):
    for values in names["left"].values():
        assert len(values) == 13
        assert max(values) < 4e-4
        assert values[0] < max(values)  # mass is noticed
    assert names["left_with_full"] < 1e-3


@checks
def control_estimation(names):
    left = names["left"]
    assert left["motion seen"] < 4e-4
    assert left["lengths and directions"] < min(left["lengths"], left["directions"])
    assert left["lengths and directions"] < 8e-3
    assert max(left.values()) < 25e-3
    assert "of the 18 states are not observable" in names["refusal"]
    assert names["statistics"].refused.sum() > 20
    assert names["statistics"].restarts == 0


@checks
def control_imu_ball(names):
    assert names["off"][0] > 0.02
    assert names["off"][50:].max() < 3e-3
    assert len(names["told_bias"]) == 8
    assert names["bias_error"].max() < 4e-3
    assert "turn about z" in names["report"].left_alone


@checks
def control_morph(names):
    for off, turned in names["errors"].values():
        assert abs(off) < 0.05
        assert abs(turned) < 0.01
    assert names["run"].force_density.min() / 2 > 2.0
    assert names["tension"].max() < names["LARGEST_TENSION"]
    assert names["rates"].max() <= names["RATE"] * (1 + 1e-9)
    assert names["at_rate"] > 0.25
    applied = names["run"].control.applied
    assert 0.4 < applied.min() < applied.max() < 1.3


@checks
def control_struts(names):
    off, run = names["off"], names["run"]
    assert off["MPC"].max() < 0.25
    assert off["MPC"][-1] < 1e-3 < 0.1 < off["played"][-300:].max()
    assert run.force_density.min() > 2.0
    assert_near(run.nodes[2, :, -1].max(), 1.75, 1e-3)
    assert set(run.control.status_count) == {"ok"}


@checks
def control_stiffness(names):
    report = names["report"]
    assert report.limit("MPC", "force_density") == 1e2
    assert report.limit("MPC", "rest_length") == 1e5
    off = [run.error for run in report.runs("MPC", "force_density")]
    assert off == sorted(off)
    assert_near(off[-1], 0.1003, 5e-4)
    assert_near(report.rows[1].held.rate_ratio, 0.256, 2e-3)


@checks
def control_lqr(names):
    for _, law in names["designs"].values():
        assert law.poles.real.max() < -0.2
    assert names["off"]["force_density"][-1] < 3e-5
    assert names["off"]["rest_length"][-1] < 2e-4


@checks
def accuracy_error_against_time(names):
    compared = names["compared"]
    assert compared.failures == ()
    finest = {name: min(row.error for row in compared.of(name)) for name in compared.methods}
    assert finest["dop853"] < 1e-9 < finest["rk4"] < 1e-4


@checks
def accuracy_form(names):
    taut, across = names["found"]["strings stay taut"]
    slack, across_switches = names["found"]["strings go slack"]
    own = [row.error for row in taut.of("rk4")]
    # Without switches there is nothing to step across.
    np.testing.assert_allclose(across, own, rtol=0.05)
    assert across_switches[-1] > 10 * slack.of("rk4")[-1].error
    if find_spec("mujoco"):  # it comes with an extra
        np.testing.assert_allclose(names["share"]["strings stay taut"], 1.0, atol=0.1)
        assert names["share"]["strings go slack"][-1] > 10


@checks
def accuracy_order(names):
    assert_near(names["orders"]["rk4"].order, 4.0, 0.2)
    assert_near(names["orders"]["energy_momentum"].order, 2.0, 0.2)
    assert names["orders"]["rk4"].switches == 33
    assert names["gain"] < 0.05


@checks
def accuracy_stability(names):
    np.testing.assert_allclose(names["stability"].step, names["stability"].bound, rtol=0.02)
    assert names["run"].health.energy_error < 1e-6
    assert names["chosen"].choice.method == "energy_momentum"


@checks
def accuracy_long_run(names):
    energy = {name: each.of("energy") for name, each in names["runs"].items()}
    assert not energy["rk4"].is_zero
    assert energy["energy_momentum"].largest < 1e-10
    assert_near(names["growth"]["slack skin"].horizon, 1.1, 0.2)
    assert not names["growth"]["no skin"].is_limited


@checks
def control_arm(names):
    goal = names["shapes"][-1]
    for name, each in names["runs"].items():
        assert np.abs(each.nodes[:, :, -1] - goal).max() < 2e-3, name
    assert names["runs"]["MPC"].force_density.min() > 5.0
    assert max(names["lengths"].values()) < 1e-13
    for each in names["runs"].values():
        motors = each.control.motors
        assert np.abs(motors.speed).max() <= 600.0 * (1 + 1e-9)
        # At rest before and after, up to damping: the arm is lifted, and more.
        assert 0.5 * 9.81 * names["RISE"] < motors.energy[:, -1].sum() < 6.0
        assert motors.energy_error < 1e-4


@checks
def control_spine(names):
    goal, top = names["shapes"][-1], names["top"]
    assert_near(goal[0, top], 0.1, 2e-3)
    for name, each in names["runs"].items():
        assert np.abs(each.nodes[:, :, -1] - goal).max() < 2e-3, name
    assert names["runs"]["MPC"].force_density.min() > 10.0
    assert names["lengths"] < 1e-13


@checks
def control_t_bar(names):
    assert names["rest"].self_stress_states == 2
    assert max(names["off"].values()) < 0.1  # mm
    assert names["runs"]["NMPC"].force_density.min() > 1.0
