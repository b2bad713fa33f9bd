"""Closed loops of scene files: what stands in the file is what Python is given."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.cli import main
from tests.scene.limits import limits

SCENES = Path(__file__).parent.parent.parent / "examples" / "scenes"

PLAIN = """\
[structure]
generator = "prism"
[strings]
law = "linear"
stiffness = 200.0
damping = 0.5
[prestress]
force_density = 17.3205
[run]
duration = 0.3
step = 2e-3
"""
LQR = "[controller]\nkind = 'lqr'\ninput = 'rest_length'\nsample_time = 0.02\n"


def pushed_along_x(plant):
    """Nodes of a shape in which node 1 is pushed along x, where it is limited."""
    displacement = np.zeros(plant.nodes.size)
    displacement[3] = 0.1
    return plant.to_nodes(plant.basis.T @ displacement)


def commands_alike(one, other, plant):
    pushed = pushed_along_x(plant)
    still = np.zeros_like(pushed)
    for each in (one, other):
        each.reset()
    for k in range(2):
        found = [each.command(0.02 * k, pushed, still) for each in (one, other)]
        np.testing.assert_array_equal(*[each.value for each in found])
        assert found[0].status == found[1].status == "ok"
    return found[0].value


def test_nmpc_takes_what_mpc_takes(load):
    text, given = limits(high=-0.12)
    text = (
        PLAIN
        + """[controller]
kind = "nmpc"
input = "rest_length"
horizon = 3
sample_time = 0.02
time_limit = 60.0
"""
        + text
    )
    scene = load(text)
    plant, given = scene.controller.plant, given | {"time_limit": 60.0}
    first = commands_alike(
        scene.controller, tc.NMPC(plant, horizon=3, sample_time=0.02, **given), plant
    )
    # The limit of the output is felt.
    other = tc.NMPC(plant, horizon=3, sample_time=0.02, **given | {"outputs": ()})
    pushed = pushed_along_x(plant)
    for k in range(2):
        without = other.command(0.02 * k, pushed, np.zeros((3, 6))).value
    assert np.abs(without - first).max() > 1e-4
    late = load(text.replace("60.0", "1e-9")).controller.command(0.0, pushed, np.zeros((3, 6)))
    assert late.status.startswith("out of time")


def test_mpc_has_a_time_limit(load):
    mpc = "[controller]\nkind = 'mpc'\nhorizon = 5\nsample_time = 0.02\nmax_force_density = 60.0\n"
    assert load(PLAIN + mpc).controller.law.settings.longest_time == np.inf
    controller = load(PLAIN + mpc + "time_limit = 1e-9\n").controller
    pushed = controller.plant.to_nodes(np.full(9, 0.01))
    assert controller.command(0.0, pushed, np.zeros((3, 6))).status.startswith("out of time")


def test_lqr_changes_no_faster_than_it_may(load):
    scene = load(PLAIN + LQR + "max_change = 1e-4\n[start]\ndisturbance = 0.02\n")
    run = scene.simulate()
    moves = np.abs(np.diff(np.c_[scene.rest_length, run.control.command])).max(axis=0)
    assert moves.max() == pytest.approx(1e-4, rel=1e-9)
    assert run.control.status_count["saturated"] > 5


def test_winches_ramp_in_substeps(load):
    scene = load(PLAIN + LQR + "[winches]\nrate = 0.1\nsubsteps = 4\n[start]\ndisturbance = 0.02\n")
    assert scene.winches.substeps == 4
    seen = np.unique(scene.simulate().rest_length[0].round(9))
    jumping = replace(scene, winches=tc.Winches(rate=0.1)).simulate()
    assert len(seen) > 3 * len(np.unique(jumping.rest_length[0].round(9)))


def test_the_reference_says_which_force_densities_hold_it(load):
    """Twelve strings balance in one shape in many ways; those of the path are wanted."""
    model = tc.Model(tc.prism(diagonals=True), strings=tc.LinearStrings(200.0))
    top, bottom = [0, 1, 2], [3, 4, 5]
    start = tc.shape_target(
        model, [tc.Height(1.0, top, bottom), tc.Twist(-0.6, top, bottom)],
        force_density=17.0, min_force_density=2.0,
    )  # fmt: skip
    structure = model.structure
    scene = load(
        f"""[structure]
nodes = {start.nodes.T.tolist()}
bars = {structure.bars.tolist()}
strings = {structure.strings.tolist()}
bar_mass = 1.0
string_groups = {list(structure.string_groups)}
[strings]
law = "linear"
stiffness = 200.0
[prestress]
force_density = {start.force_density.tolist()}
[run]
duration = 1.0
[controller]
kind = "mpc"
input = "rest_length"
horizon = 5
sample_time = 0.02
min_force_density = 2.0
[[controller.reference]]
time = 1.0
height = 0.95
top = {top}
bottom = {bottom}
force_density = 20.0
"""
    )
    goal = tc.shape_target(
        model, tc.Height(0.95, top, bottom), force_density=20.0,
        min_force_density=2.0, start=start.nodes,
    )  # fmt: skip
    for k in range(3):
        command = scene.controller.command(5.0 + 0.02 * k, goal.nodes, np.zeros((3, 6)))
    np.testing.assert_allclose(command.value, goal.rest_length, atol=1e-4)


def test_estimate_and_faults_are_those_of_python(load):
    scene = load(
        PLAIN
        + LQR
        + """[start]
disturbance = 0.02
[sensors]
string_length = [0.001, 0.002, 0.001]
strings = [0, 4, 8]
bar_direction = 0.01
bars = [0, 1, 2]
node_position = 0.01
nodes = [1]
string_tension = 0.5
tension_strings = [2]
bar_rate = 0.05
rate_bars = [1]
delay = 1
drop_rate = 0.1
outlier_rate = 0.01
seed = 7
[estimator]
kind = "kalman"
process_noise = 0.03
prediction = "nonlinear"
gate = 1e-5
patience = 6
start_spread = 0.02
[[faults]]
kind = "lost_measurement"
time = 0.1
until = 0.16
[[faults]]
kind = "stuck_winch"
string = 3
time = 0.06
[[faults]]
kind = "cut_string"
string = 6
time = 0.205
"""
    )
    plant = scene.controller.plant
    sensors = tc.Sensors(
        structure=scene.structure, string_length=[0.001, 0.002, 0.001], strings=[0, 4, 8],
        bar_direction=0.01, node_position=0.01, nodes=[1], string_tension=0.5,
        tension_strings=[2], bar_rate=0.05, rate_bars=[1], delay=1, drop_rate=0.1,
        outlier_rate=0.01,
    )  # fmt: skip
    estimator = tc.KalmanFilter(
        plant,
        sensors,
        sample_time=0.02,
        process_noise=0.03,
        prediction="nonlinear",
        gate=1e-5,
        patience=6,
        start_spread=0.02,
    )
    faults = (
        tc.LostMeasurement(0.1, 0.16),
        tc.StuckWinch(3, 0.06),
        tc.CutString(6, 0.205),
    )
    assert scene.faults == faults
    with pytest.warns(tc.control.ControlWarning, match="ends up to"):  # a string is cut
        same = tc.simulate(
            scene.model,
            0.3,
            scene.nodes,
            controller=tc.LQR(plant, sample_time=0.02),
            rest_length=scene.rest_length,
            step=2e-3,
            faults=faults,
            estimator=estimator,
            seed=7,
        )
    with pytest.warns(tc.control.ControlWarning, match="ends up to"):
        run = scene.simulate()
    np.testing.assert_array_equal(run.nodes, same.nodes)
    np.testing.assert_array_equal(
        run.control.estimate.measurement, same.control.estimate.measurement
    )
    assert (run.force_density[6, run.time > 0.206] == 0).all()
    assert np.ptp(run.rest_length[3, run.time > 0.061]) == 0


def test_the_estimator_knows_what_is_held(load):
    """MPC asks for force densities, winches hold rest lengths between samples."""
    text = "[sensors]\nstring_length = 0.001\n[estimator]\nkind = 'kalman'\n"
    law = "[controller]\nkind = 'lqr'\n"
    sampled = PLAIN.replace("[run]\n", "[run]\nsample_time = 0.01\n")
    estimator = load(sampled + law + text).estimator
    assert (estimator.input, estimator.sample_time) == ("rest_length", 0.01)
    assert load(PLAIN + law + text).estimator.sample_time == 2e-3
    other = load(sampled.replace("[run]\n", "[run]\ninput = 'force_density'\n") + law + text)
    assert other.estimator.input == "force_density"


def test_the_estimator_ramps_as_the_winches_do(load):
    """Refused by simulate where it does not; the estimate tells a ramp from jumps."""
    text = (
        PLAIN
        + LQR
        + "[start]\ndisturbance = 0.02\n[winches]\nrate = 0.1\nsubsteps = 4\n"
        + "[sensors]\nstring_length = 0.001\nbar_direction = 0.01\n"
        + "[estimator]\nkind = 'kalman'\n"
    )
    scene = load(text)
    assert scene.estimator.substeps == 4
    winding = scene.simulate().control.estimate.nodes
    jumping = load(text.replace("substeps = 4\n", "")).simulate().control.estimate.nodes
    assert np.abs(winding - jumping).max() > 1e-5


def test_the_estimator_can_find_a_load(load):
    text = "[sensors]\nstring_length = 0.001\nbar_direction = 0.01\n[estimator]\nkind = 'kalman'\n"
    plain, loaded = (load(PLAIN + LQR + text + more) for more in ("", "load = true\n"))
    assert plain.simulate().control.estimate.state.shape[0] == 24
    assert loaded.simulate().control.estimate.state.shape[0] == 36
    noisier = load(PLAIN + LQR + text + "load = true\nload_noise = 0.5\n")
    assert not np.allclose(noisier.estimator.gain, loaded.estimator.gain)


def test_an_estimator_of_whole_strings(load):
    scene = load(
        PLAIN
        + LQR
        + "[subdivide]\nsegments = 2\nnode_mass = 0.02\n"
        + "[sensors]\nstring_length = 0.001\nbar_direction = 0.01\n[estimator]\nkind = 'kalman'\n"
        + "[[faults]]\nkind = 'cut_string'\nstring = 17\ntime = 0.1\n"
    )
    assert scene.estimator.plant.model.structure is scene.structure.parent
    with pytest.warns(tc.control.ControlWarning, match="ends up to"):
        run = scene.simulate()
    assert run.control.estimate.nodes.shape == (3, 6, 15)
    assert (run.force_density[17, run.time > 0.101] == 0).all()


def test_a_string_is_cut_in_open_loop(load):
    text = "[[faults]]\nkind = 'cut_string'\nstring = 6\ntime = 0.05\n"
    run = load(PLAIN + text).simulate()
    assert run.faults == (tc.CutString(6, 0.05),)
    assert run.released_energy[-1] > 0


def test_what_is_compared_has_no_faults(load):
    scene = load(PLAIN + LQR + "[[faults]]\nkind = 'cut_string'\nstring = 6\ntime = 0.05\n")
    assert scene.open_loop().note == (
        "The controller of the scene is left out: rest lengths are held as at the start. "
        "Its faults are left out: string 6 cut."
    )


def test_prism_fault():
    scene = tc.load_scene(SCENES / "prism_fault.toml")
    run = scene.simulate()
    record = run.control
    assert record.status_count == {"ok": 200}
    assert record.estimate.status_count["lost"] >= 10
    seen = (run.time > 0.301) & (run.time < 0.999)
    assert np.ptp(run.rest_length[6, seen]) == 0
    assert np.ptp(run.rest_length[7, seen]) > 1e-3
    plant = scene.controller.plant

    def off(k):
        q = plant.measure(run.nodes[..., k], run.velocities[..., k])[:9]
        return np.linalg.norm(plant.to_nodes(q) - plant.nodes, axis=0).max()

    assert off(0) > 0.02
    assert off(-1) < 0.005


def test_estimate_and_faults_are_saved(tmp_path, capsys):
    text = (SCENES / "prism_fault.toml").read_text(encoding="utf-8")
    file = tmp_path / "short.toml"
    file.write_text(text.replace("duration = 4.0", "duration = 0.1"), encoding="utf-8")
    assert main(["simulate", str(file), "--output", str(tmp_path)]) == 0
    assert "winch 6 stuck from 0.3 s to 1 s" in capsys.readouterr().out
    assert (tmp_path / "estimate.png").stat().st_size > 10_000
    saved = tc.load_run(tmp_path / "trajectory.npz")
    assert saved.faults == (tc.StuckWinch(6, 0.3, 1.0), tc.LostMeasurement(1.5, 1.7))
    assert saved.control.estimate.nodes.shape == (3, 6, 5)
    assert len(saved.control.estimate.statistics.used) == 12


def test_an_lqr_with_a_sample_time_is_designed_for_samples(load):
    """Beside no sample time it is a law in continuous time, sampled by [run]."""
    law = "[controller]\nkind = 'lqr'\ninput = 'rest_length'\n"
    discrete = load(PLAIN + law + "sample_time = 0.02\n")
    continuous = load(PLAIN.replace("[run]\n", "[run]\nsample_time = 0.02\n") + law)
    plant = discrete.controller.plant
    for scene, own in ((discrete, 0.02), (continuous, None)):
        same = tc.LQR(plant, sample_time=own)
        assert scene.controller.sample_time == own
        np.testing.assert_array_equal(scene.controller.gain, same.gain)
        assert scene.sample_time == (None if own else 0.02)
        np.testing.assert_allclose(np.diff(scene.simulate().control.time), 0.02)


def test_winches_ramp(load):
    scene = load(PLAIN + LQR + "[winches]\nrate = 0.1\nramp = true\n[start]\ndisturbance = 0.02\n")
    assert scene.winches.ramp
    assert scene.winches.substeps == tc.Winches(ramp=True).substeps
