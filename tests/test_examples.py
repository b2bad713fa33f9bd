"""Every example runs, and one of its numbers is what it should be."""

import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def run(name):
    code = (EXAMPLES / name).read_text("utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(EXAMPLES)  # as it is when Python runs the file
        result = runpy.run_path(str(EXAMPLES / name))
    # Else the gallery has no picture of it in its index.
    thumbnail = re.search(r"# sphinx_gallery_thumbnail_number = (\d+)", code)
    assert len(plt.get_fignums()) >= (int(thumbnail[1]) if thumbnail else 1), name
    plt.close("all")
    return result


def test_every_example_is_tested():
    tested = {
        "plot_accuracy_error_against_time.py",
        "plot_accuracy_form.py",
        "plot_accuracy_long_run.py",
        "plot_accuracy_order.py",
        "plot_accuracy_stability.py",
        "plot_control_arm.py",
        "plot_control_ball.py",
        "plot_control_estimation.py",
        "plot_control_robustness.py",
        "plot_control_shape.py",
        "plot_control_lqr.py",
        "plot_control_own.py",
        "plot_control_morph.py",
        "plot_control_profiles.py",
        "plot_control_spine.py",
        "plot_control_stiffness.py",
        "plot_control_string_mass.py",
        "plot_control_t_bar.py",
        "plot_ground_lander.py",
        "plot_ground_rolling.py",
        "plot_ground_thrown_prisms.py",
        "plot_library.py",
        "plot_modes.py",
        "plot_paper_skin.py",
        "plot_paper_string_mass.py",
        "plot_shape_new_height.py",
        "plot_shape_path.py",
    }
    studies = {"stiffness_study.py"}  # which examples import; tests/benchmarks/ tests it
    assert {path.name for path in EXAMPLES.glob("*.py")} == tested | studies


def test_every_example_is_in_the_gallery_once():
    index = (EXAMPLES / "index.rst").read_text("utf-8").split()
    for path in EXAMPLES.glob("plot_*.py"):
        assert index.count(f"../examples/{path.name}") == 1, path.name  # its thumbnail
        assert index.count(path.stem) == 1, path.name  # its place in the sidebar


def test_control_ball():
    found = run("plot_control_ball.py")
    assert [len(each) for each in found["left_alone"].values()] == [1, 0]
    assert all(controlled[-1] < 0.02 * controlled[0] for controlled, _ in found["returns"].values())
    assert all(abs(moved[-1, 1] - 0.1) < 1e-3 for moved in found["moves"].values())


def test_ground_lander():
    found = run("plot_ground_lander.py")
    # Softest and stiffest strings both stop the payload harder than those between.
    for height, values in found["peak"].items():
        least = values.argmin()
        assert 0 < least < len(values) - 1, height
        assert values[0] > 1.5 * values[least]
        # Least deceleration: at constant force over all the room there is.
        assert values[least] > 0.9 * height / found["LENGTH"]
    assert list(found["best"].values()) == sorted(found["best"].values())
    assert found["error"] < 1e-4
    assert not found["run"].health.crossings
    assert found["soft"].health.crossings


def test_ground_thrown_prisms():
    found = run("plot_ground_thrown_prisms.py")
    assert found["batch"].completed.all()
    assert 0 < found["toppled"].sum() < 200


def test_ground_rolling():
    found = run("plot_ground_rolling.py")
    assert found["path"].margin[-1] > 0
    for name, gait in found["gaits"].items():
        after = found["runs"][name]
        assert len(gait.made) == 5, name
        assert (after.nodes[:, :, -1] - after.nodes[:, :, 0]).mean(axis=1)[0] > 0.8, name
        assert np.abs(after.control.winch_rate).max() <= 0.2 * (1 + 1e-9)
        assert after.control.applied.min() >= 0.35
        assert after.control.applied.max() <= 0.8


def test_modes():
    found = run("plot_modes.py")
    held, free = found["held"], found["free"]
    assert found["rest"].mechanisms == 9
    assert held.frequency[0] == pytest.approx(2.04752, abs=5e-5)
    assert (held.frequency > 0).all()
    assert (free.frequency == 0).sum() == found["reach"].unreachable == 4


def test_profiles():
    result = run("plot_control_profiles.py")
    run_, height = result["run"], result["height"]
    ground = run_.nodes[:, 0] - result["tower"].nodes[:, [0]]
    assert ground[1] == pytest.approx([result["ground"](t)[1, 0] for t in run_.time], abs=1e-9)
    assert height[0] - height[-1] == pytest.approx(0.0882, abs=2e-3)
    still = np.abs(run_.velocities[:, :, np.isclose(run_.time, 1.99, atol=6e-3)]).max()
    assert still < 0.05  # before the gust
    assert np.abs(run_.bar_length_error).max() < 1e-12


def test_library():
    import tenscontrol as tc

    result = run("plot_library.py")
    found = {name: tuple(counts) for name, counts in result["found"].items()}
    assert set(found) == set(tc.library.__all__)
    assert (found["levy_dome"], found["stedy_arm"]) == ((13, 1), (6, 0))
    assert (found["class2_tower"], found["spine"]) == ((3, 3), (9, 0))
    assert len(result["figure"].axes) == len(found)


def test_control_shape():
    found = run("plot_control_shape.py")
    errors, runs = found["errors"], found["runs"]
    largest = {key: off[runs[key].time >= 0.5].max() for key, off in errors.items()}
    assert largest["force_density", "shape control"] < 0.5 * largest["force_density", "MPC"]
    assert largest["rest_length", "MPC"] < 0.5 * largest["rest_length", "shape control"]
    assert max(off[-25:].max() for off in errors.values()) < 5e-4
    assert 0.01 < found["left"].largest_residual < 0.4


def test_control_own():
    import tenscontrol as tc

    found = run("plot_control_own.py")
    on_ball, on_tower = found["errors"]
    last = {name: off[-1] for name, off in (on_ball | on_tower).items()}
    held = [off["rest lengths held"][-1] for off in (on_ball, on_tower)]
    assert last["PD on string lengths"] < 0.5 * held[0]
    assert last["LQR of python-control"] < 1e-5
    assert last["MPC by casadi.Opti"] < 0.3 * held[1]
    imitated = on_tower["network"] - on_tower["the LQR it imitates"]
    assert np.abs(imitated).max() < 1e-3
    assert set(found["tower_runs"]["MPC by casadi.Opti"].control.status) == {"ok"}
    # The gain of python-control gives the commands of our own LQR.
    plant, ball = found["plant"], found["ball"]
    own = tc.LQR(plant, found["Q"], found["R"])
    random = np.random.default_rng(0)
    for _ in range(20):
        q, rates = random.normal(size=(2, plant.degrees_of_freedom)) * [[1e-3], [1e-2]]
        motion = plant.to_nodes(q), plant.to_velocities(q, rates)
        theirs = found["lqr_of_control"](0.0, *motion)
        np.testing.assert_allclose(own.command(0.0, *motion).value, theirs, rtol=0, atol=1e-9)
    assert ball.structure_class == 1


def test_shape_new_height():
    found = run("plot_shape_new_height.py")
    assert abs(found["height_error"]) < 1e-3
    assert found["run"].force_density.min() > 0
    assert np.abs(found["run"].control.winch_rate).max() <= 0.5


def test_shape_path():
    found = run("plot_shape_path.py")
    path = found["path"]
    assert found["missed"] == pytest.approx(5.0, abs=1e-6)
    assert np.abs(path.rest_length_rate).max() <= 0.1
    assert path.residual < 1e-12
    assert found["left"] < 1e-3


def test_paper_string_mass():
    found = run("plot_paper_string_mass.py")
    assert found["massive"].nodes.shape == (3, 33)
    assert 0.05 < found["mass_effect"] < 0.1
    assert found["half_speed_error"] < 1e-6


def test_paper_skin():
    travel = run("plot_paper_skin.py")["travel"]
    shares = {v: travel[v, "with skin"] / travel[v, "without skin"] for v in (9.0, 45.0)}
    assert shares[9.0] > 0.9  # slack: hardly an effect
    assert shares[45.0] < 0.55  # taut: half the travel


def test_control_robustness():
    reports = run("plot_control_robustness.py")["reports"]
    without, estimated = reports["no load estimated"], reports["load estimated"]
    assert (len(without), len(estimated)) == (10, 20)
    assert without.confidence_interval()[1] < estimated.confidence_interval()[0]
    assert without.success_rate == 0.0
    assert estimated.success_rate == 1.0
    assert estimated.figure("final_error").max() == pytest.approx(0.0139, abs=1e-3)


def test_control_string_mass():
    found = run("plot_control_string_mass.py")
    for values in found["left"].values():
        assert len(values) == 13
        assert max(values) < 4e-4
        assert values[0] < max(values)  # mass is noticed
    assert found["left_with_full"] < 1e-3


def test_control_estimation():
    found = run("plot_control_estimation.py")
    left = found["left"]
    assert left["motion seen"] < 4e-4
    assert left["lengths and directions"] < 5e-3
    assert left["lengths and directions"] < left["lengths"] < 15e-3
    assert left["directions"] < 25e-3
    assert "of the 18 states are not observable" in found["refusal"]
    assert found["statistics"].refused.sum() > 20
    assert found["statistics"].restarts == 0


def test_control_morph():
    found = run("plot_control_morph.py")
    for off, turned in found["errors"].values():
        assert abs(off) < 0.05
        assert abs(turned) < 0.01
    assert found["run"].force_density.min() / 2 > 2.0
    assert found["tension"].max() < found["LARGEST_TENSION"]
    assert found["rates"].max() <= found["RATE"] * (1 + 1e-9)
    assert found["at_rate"] > 0.25
    applied = found["run"].control.applied
    assert 0.4 < applied.min() < applied.max() < 1.3


def test_control_stiffness():
    report = run("plot_control_stiffness.py")["report"]
    assert report.limit("MPC", "force_density") == 1e2
    assert report.limit("MPC", "rest_length") == 1e5
    off = [run.error for run in report.runs("MPC", "force_density")]
    assert off == sorted(off)
    assert off[-1] == pytest.approx(0.1003, abs=5e-4)
    assert report.rows[1].held.rate_ratio == pytest.approx(0.256, abs=2e-3)


def test_control_lqr():
    found = run("plot_control_lqr.py")
    for _, law in found["designs"].values():
        assert law.poles.real.max() < -0.2
    assert found["off"]["force_density"][-1] < 3e-5
    assert found["off"]["rest_length"][-1] < 2e-4


def test_accuracy_error_against_time():
    compared = run("plot_accuracy_error_against_time.py")["compared"]
    assert compared.failures == ()
    finest = {name: min(row.error for row in compared.of(name)) for name in compared.methods}
    assert finest["dop853"] < 1e-9 < finest["rk4"] < 1e-4


@pytest.fixture(scope="module")
def form():
    return run("plot_accuracy_form.py")


def test_accuracy_form(form):
    taut, across = form["found"]["strings stay taut"]
    slack, across_switches = form["found"]["strings go slack"]
    own = [row.error for row in taut.of("rk4")]
    # Without switches there is nothing to step across.
    assert across == pytest.approx(own, rel=0.05)
    assert across_switches[-1] > 10 * slack.of("rk4")[-1].error


def test_accuracy_form_against_mujoco(form):
    pytest.importorskip("mujoco", reason="MuJoCo comes with the extra bench")
    share = form["share"]
    assert share["strings stay taut"] == pytest.approx([1.0] * 5, abs=0.1)
    assert share["strings go slack"][-1] > 10


def test_accuracy_order():
    found = run("plot_accuracy_order.py")
    assert found["orders"]["rk4"].order == pytest.approx(4.0, abs=0.2)
    assert found["orders"]["energy_momentum"].order == pytest.approx(2.0, abs=0.2)
    assert found["orders"]["rk4"].switches == 33
    assert found["gain"] < 0.05


def test_accuracy_stability():
    found = run("plot_accuracy_stability.py")
    np.testing.assert_allclose(found["stability"].step, found["stability"].bound, rtol=0.02)
    assert found["run"].health.energy_error < 1e-6
    assert found["chosen"].choice.method == "energy_momentum"


def test_accuracy_long_run():
    found = run("plot_accuracy_long_run.py")
    energy = {name: each.of("energy") for name, each in found["runs"].items()}
    assert not energy["rk4"].is_zero
    assert energy["energy_momentum"].largest < 1e-10
    assert found["growth"]["slack skin"].horizon == pytest.approx(1.1, abs=0.2)
    assert not found["growth"]["no skin"].is_limited


def test_control_arm():
    found = run("plot_control_arm.py")
    goal = found["shapes"][-1]
    for name, each in found["runs"].items():
        assert np.abs(each.nodes[:, :, -1] - goal).max() < 2e-3, name
    assert found["runs"]["MPC"].force_density.min() > 5.0
    assert max(found["lengths"].values()) < 1e-13
    for each in found["runs"].values():
        motors = each.control.motors
        assert np.abs(motors.speed).max() <= 600.0 * (1 + 1e-9)
        # At rest before and after, up to damping: the arm is lifted, and more.
        assert 0.5 * 9.81 * found["RISE"] < motors.energy[:, -1].sum() < 6.0
        assert motors.energy_error < 1e-4


def test_control_spine():
    found = run("plot_control_spine.py")
    goal, top = found["shapes"][-1], found["top"]
    assert goal[0, top] == pytest.approx(0.1, abs=2e-3)
    for name, each in found["runs"].items():
        assert np.abs(each.nodes[:, :, -1] - goal).max() < 2e-3, name
    assert found["runs"]["MPC"].force_density.min() > 10.0
    assert found["lengths"] < 1e-13


def test_control_t_bar():
    found = run("plot_control_t_bar.py")
    assert found["rest"].self_stress_states == 2
    assert max(found["off"].values()) < 0.1  # mm
    assert found["runs"]["NMPC"].force_density.min() > 1.0
