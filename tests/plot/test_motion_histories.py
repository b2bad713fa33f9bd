"""Time histories of a motion, with its faults; energy, momentum and bar lengths."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc


def legend(ax):
    return sorted(text.get_text() for text in ax.get_legend().get_texts())


def with_values(run, **values):
    """A copy of a run with values of its own where others are evaluated."""
    other = copy(run)
    vars(other).update(values)
    return other


def record(run, status):
    """Return the run with a control record of these statuses, 10 ms each."""
    count = len(status)
    zeros = np.zeros((9, count))
    return replace(
        run,
        control=tc.simulation.ControlRecord(
            time=0.01 * np.arange(count),
            command=zeros,
            applied=zeros,
            fallback=(None,) * count,
            detail=("",) * count,
            status=tuple(status),
            winch_rate=zeros,
            rate_limited=np.zeros(count, int),
            range_limited=np.zeros(count, int),
            computing_time=np.zeros(count),
        ),
    )


class TestTrajectory:
    def test_panels_of_held_rest_lengths(self, slack_run):
        panels = tc.plot.trajectory(slack_run)
        assert list(panels) == ["coordinates", "force_density", "rest_length"]
        labels = [panel.ax.get_ylabel() for panel in panels.values()]
        assert labels == ["displacement\nfrom the start, m", "γ, N/m", "rest length, m"]
        assert [panel.ax.get_xlabel() for panel in panels.values()] == ["", "", "time, s"]

    def test_panels_of_held_force_density(self, free_run):
        panels = tc.plot.trajectory(free_run)
        assert list(panels) == ["coordinates", "force_density"]

    def test_draws_how_far_the_nodes_are_that_move_most(self, slack_run):
        panel = tc.plot.trajectory(slack_run)["coordinates"]
        away = np.linalg.norm(slack_run.nodes - slack_run.nodes[:, :, :1], axis=0)
        # The bars of a prism move alike: the first four ends.
        assert list(panel.lines) == [f"node {i}" for i in range(4)] + ["other 2 of 6 nodes"]
        assert np.allclose(panel.lines["node 2"][0].get_ydata(), away[2])
        assert np.allclose(
            [line.get_ydata() for line in panel.lines["other 2 of 6 nodes"]], away[4:]
        )
        assert "other 2 of 6 nodes" in legend(panel.ax)

    def test_nodes_that_move_most_are_chosen_and_still_ones_are_not(self, slack_run):
        nodes = np.repeat(slack_run.nodes[:, :, :1], len(slack_run.time), axis=2)
        nodes[0, 4] += np.linspace(0, 2, nodes.shape[2])
        nodes[1, 1] += np.linspace(0, 1, nodes.shape[2])
        panel = tc.plot.trajectory(replace(slack_run, nodes=nodes))["coordinates"]
        assert list(panel.lines) == ["node 1", "node 4", "other 4 of 6 nodes"]
        along = tc.plot.trajectory(replace(slack_run, nodes=nodes), directions="xyz")["coordinates"]
        assert list(along.lines) == ["x[4]", "y[4]", "z[4]"]
        still = replace(slack_run, nodes=np.repeat(nodes[:, :, :1], nodes.shape[2], axis=2))
        assert len(tc.plot.trajectory(still)["coordinates"].lines) == 2

    def test_displacement_from_a_shape_and_from_one_for_each_time(self, slack_run):
        shape = slack_run.nodes[:, :, -1]
        panel = tc.plot.trajectory(slack_run, relative_to=shape, nodes=[5])["coordinates"]
        drawn = panel.lines["node 5"][0].get_ydata()
        assert drawn[-1] == 0
        assert np.isclose(drawn[0], np.linalg.norm(slack_run.nodes[:, 5, 0] - shape[:, 5]))
        assert panel.ax.get_ylabel() == "displacement from\nthe reference, m"
        panel = tc.plot.trajectory(slack_run, relative_to=slack_run.nodes, nodes=[5])["coordinates"]
        assert not panel.lines["node 5"][0].get_ydata().any()

    def test_draws_the_coordinates_asked_for(self, slack_run):
        options = {"nodes": (0, 4), "directions": "xz", "relative_to": "origin"}
        panel = tc.plot.trajectory(slack_run, **options)["coordinates"]
        assert list(panel.lines) == ["x[0]", "z[0]", "x[4]", "z[4]"]
        assert np.array_equal(panel.lines["z[4]"][0].get_ydata(), slack_run.nodes[2, 4])
        assert panel.ax.get_ylabel() == "node position, m"
        options["relative_to"] = "start"
        panel = tc.plot.trajectory(slack_run, **options)["coordinates"]
        moved = slack_run.nodes[2, 4] - slack_run.nodes[2, 4, 0]
        assert np.array_equal(panel.lines["z[4]"][0].get_ydata(), moved)

    def test_draws_every_string_in_the_style_of_its_group(self, slack_run):
        lines = tc.plot.trajectory(slack_run)["force_density"].lines
        assert [len(group) for group in lines.values()] == [3, 3, 3]
        for group in ("top", "vertical"):
            indices = slack_run.structure.strings_in(group)
            for line, i in zip(lines[group], indices, strict=True):
                assert np.array_equal(line.get_ydata(), slack_run.force_density[i])
            assert len({line.get_color() for line in lines[group]}) == 1
        assert lines["top"][0].get_color() != lines["vertical"][0].get_color()

    def test_held_quantities_are_drawn_in_steps(self, slack_run, free_run):
        def style(run, panel):
            (line, *_) = tc.plot.trajectory(run)[panel].lines["top"]
            return line.get_drawstyle()

        assert style(slack_run, "rest_length") == style(free_run, "force_density") == "steps-pre"
        assert style(slack_run, "force_density") == "default"

    def test_references_stand_with_the_coordinates(self, slack_run):
        panels = tc.plot.trajectory(slack_run, directions="z", references={"target height": 0.85})
        assert (panels["coordinates"].references["target height"].get_ydata() == 0.85).all()
        assert panels["force_density"].references == {}

    def test_bad_statuses_are_marked_on_the_lowest_time_axis(self, slack_run):
        status = ["ok"] * 40
        status[3] = status[4] = "infeasible"
        status[20] = "time limit"
        panels = tc.plot.trajectory(record(slack_run, status))
        lowest = panels["rest_length"]
        assert list(lowest.marks) == ["infeasible", "time limit"]
        assert np.allclose(lowest.marks["infeasible"].get_xdata(), [0.03, 0.04])
        assert (lowest.marks["infeasible"].get_ydata() == 0).all()
        assert lowest.marks["infeasible"].get_transform() is not lowest.ax.transData
        first, second = lowest.marks.values()
        assert first.get_marker() != second.get_marker()
        assert {"infeasible (×2)", "time limit (×1)"} < set(legend(lowest.ax))
        assert panels["coordinates"].marks == {}

    def test_nothing_is_marked_where_all_went_well(self, slack_run):
        panels = tc.plot.trajectory(record(slack_run, ["ok"] * 40))
        assert panels["rest_length"].marks == {}

    def test_given_axes_are_used_and_all_labelled(self, slack_run):
        import matplotlib.pyplot as plt

        _, axes = plt.subplots(3)
        panels = tc.plot.trajectory(slack_run, axes=axes)
        assert [panel.ax for panel in panels.values()] == list(axes)
        assert {ax.get_xlabel() for ax in axes} == {"time, s"}

    @pytest.mark.parametrize(
        ("arguments", "error", "message"),
        [
            ({"nodes": [6]}, ValueError, r"nodes\[0\] is 6, expected 0 to 5"),
            ({"nodes": [-1]}, ValueError, r"nodes\[0\] is -1"),
            ({"nodes": []}, TypeError, r"nodes is \[\], expected a sequence"),
            ({"directions": "xw"}, ValueError, "directions is 'xw', expected letters"),
            ({"relative_to": "end"}, ValueError, "relative_to is 'end', expected one of 'start'"),
            ({"relative_to": np.zeros((6, 3))}, ValueError, r"relative_to has shape \(6, 3\), exp"),
            ({"relative_to": np.full((3, 6), np.nan)}, ValueError, r"relative_to\[0, 0\] is nan"),
            ({"references": {"a": [1, 2]}}, ValueError, r"references\['a'\]"),
            ({"axes": []}, ValueError, "axes has 0 entries, expected 3: one for each of"),
        ],
    )
    def test_wrong_arguments_are_named(self, slack_run, arguments, error, message):
        with pytest.raises(error, match=message):
            tc.plot.trajectory(slack_run, **arguments)

    def test_other_objects_are_refused(self, prism):
        with pytest.raises(TypeError, match="run is a Structure, expected Trajectory"):
            tc.plot.trajectory(prism)


class TestHealth:
    def test_panels_have_units(self, slack_run):
        panels = tc.plot.health(slack_run)
        labels = {name: panel.ax.get_ylabel() for name, panel in panels.items()}
        assert labels == {
            "error": "error of nodes,\npart of the size",
            "energy": "energy, J",
            "momentum": "momentum change,\nkg m/s, kg m²/s",
            "bar_length_error": "bar-length error, m",
        }

    def test_draws_the_energies(self, slack_run):
        lines = tc.plot.health(slack_run)["energy"].lines
        change = slack_run.energy[-1] - slack_run.energy[0]
        assert list(lines) == ["kinetic", "potential", f"total (change {change:+.2g} J)"]
        kinetic, potential, total = lines.values()
        assert np.array_equal(kinetic[0].get_ydata(), slack_run.kinetic_energy)
        assert np.array_equal(potential[0].get_ydata(), slack_run.potential_energy)
        assert np.array_equal(total[0].get_ydata(), slack_run.energy)

    def test_draws_the_largest_bar_length_error(self, slack_run):
        panel = tc.plot.health(slack_run)["bar_length_error"]
        drawn = panel.lines["largest of all bars"][0].get_ydata()
        worst = np.abs(slack_run.bar_length_error).max(axis=0)
        assert panel.ax.get_yscale() == "log"
        assert np.array_equal(drawn[1:], np.maximum(worst[1:], drawn[0]))
        assert np.isclose(drawn[0], np.finfo(float).eps * slack_run.structure.bar_length.max())
        assert panel.ax.get_ylim()[0] < drawn.min()
        assert panel.ax.get_ylim()[1] > drawn.max()

    def test_a_kick_shows_as_change_of_momentum(self, slack_run):
        momentum = slack_run.momentum.copy()
        momentum[0, 200:] += 0.5
        kicked = with_values(slack_run, _momenta=[momentum, slack_run.angular_momentum])
        panel = tc.plot.health(kicked)["momentum"]
        drawn = panel.lines["linear, kg m/s"][0].get_ydata()
        assert drawn[199] < 1e-12
        assert np.isclose(drawn[200], 0.5)

    def test_bars_that_cross_are_marked(self, prism, slack_run):
        assert tc.plot.health(slack_run)["bar_length_error"].marks == {}
        run = tc.simulate(tc.Model(prism), 0.3, force_density=[17.3205] * 6 + [9.0] * 3, step=1e-3)
        panel = tc.plot.health(run)["bar_length_error"]
        times = [each.time for each in run.health.crossings]
        assert len(times) == 3
        assert panel.marks["bars cross"].get_xdata().tolist() == times
        assert "bars cross (×3)" in [text.get_text() for text in panel.ax.get_legend().get_texts()]

    def test_a_structure_at_rest_is_drawn(self, prism, rest):
        run = tc.simulate(tc.Model(prism), 0.01, force_density=rest.force_density, step=1e-3)
        still = with_values(
            run,
            velocities=0 * run.velocities,
            _momenta=[0 * run.momentum, 0 * run.angular_momentum],
            bar_length_error=0 * run.bar_length_error,
        )
        panels = tc.plot.health(still)
        panels["energy"].ax.figure.canvas.draw()
        assert np.isfinite(panels["momentum"].ax.get_ylim()).all()

    def test_wrong_axes_are_named(self, slack_run, flat):
        with pytest.raises(ValueError, match="axes has 1 entries, expected 4: one for each of err"):
            tc.plot.health(slack_run, axes=[flat])
        with pytest.raises(TypeError, match="run is a str"):
            tc.plot.health("run")


@pytest.fixture(scope="module")
def broken_run():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205), "rest_length")
    regulator = tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.02)
    faults = [tc.StuckWinch(4, 0.02, 0.06), tc.CutString(6, 0.07), tc.LostMeasurement(0.04, 9.0)]
    late = tc.CutString(1, 5.0)  # the run is over by then
    return tc.simulate(model, 0.1, controller=regulator, step=2e-3, faults=[*faults, late])


def test_faults_are_marked_with_what_they_act_on(broken_run):
    panels = tc.plot.trajectory(broken_run)
    names = ["winch 4 stuck at 0.02 s", "string 6 cut at 0.07 s", "measurement lost at 0.04 s"]
    assert list(panels["coordinates"].marks) == []
    assert list(panels["force_density"].marks) == names
    assert list(panels["rest_length"].marks)[:3] == names
    assert any(name.startswith("measurement not finite") for name in panels["rest_length"].marks)
    stuck, cut, lost = (panels["force_density"].marks[name].get_xdata() for name in names)
    np.testing.assert_allclose(stuck, [0.02, 0.02, 0.06, 0.06])
    np.testing.assert_allclose(cut, [0.07, 0.07])
    np.testing.assert_allclose(lost, [0.04, 0.04, 0.1, 0.1])
    shown = {text.get_text() for text in panels["force_density"].ax.get_legend().get_texts()}
    assert set(names) <= shown


def test_a_controlled_run_shows_how_far_it_is_from_the_reference(broken_run):
    panel = tc.plot.trajectory(broken_run)["coordinates"]
    line = panel.references["farthest from reference"]
    np.testing.assert_array_equal(line.get_ydata(), broken_run.control.tracking_error)
    np.testing.assert_array_equal(line.get_xdata()[:-1], broken_run.control.time)
    assert tc.plot.trajectory(broken_run, directions="x")["coordinates"].references == {}


def test_logarithmic_panels_have_numbers_within_a_decade_too(broken_run):
    control = replace(broken_run.control, tracking_error=np.linspace(0.021, 0.037, 6))
    control = replace(control, time=broken_run.control.time[:5])
    panel = tc.plot.tracking(replace(broken_run, control=control))["tracking_error"]
    panel.ax.figure.canvas.draw()
    low, high = panel.ax.get_ylim()
    ticks = [tick for tick in panel.ax.get_yticks() if low <= tick <= high]
    assert ticks
    assert panel.ax.yaxis.get_major_formatter()(0.02, 0) == "0.02"


def test_a_cut_string_has_no_rest_length(broken_run):
    """The million sizes that keep it slack are not drawn."""
    lines = tc.plot.trajectory(broken_run)["rest_length"].lines["vertical"]
    rows = np.array([line.get_ydata() for line in lines])
    late = broken_run.time > 0.07
    assert np.isnan(rows[0, late]).all()
    np.testing.assert_array_equal(rows[0, ~late], broken_run.rest_length[6, ~late])
    assert np.isfinite(rows[1:]).all()
    assert broken_run.rest_length[6, -1] > 1e5


def test_a_run_without_faults_has_no_marks():
    prism = tc.prism()
    run = tc.simulate(tc.Model(prism), 0.1, force_density=17.0)
    assert tc.plot.trajectory(run)["force_density"].marks == {}


def test_the_energy_that_was_lost_is_drawn():
    prism = tc.prism()
    cut = tc.CutString(0, 0.05)
    run = tc.simulate(tc.Model(prism), 0.1, force_density=17.0, faults=[cut])
    (line,) = tc.plot.health(run)["energy"].lines["lost with cut strings"]
    np.testing.assert_array_equal(line.get_ydata(), run.released_energy)
    assert line.get_ydata()[-1] > 1.0


def test_motors_are_drawn_by_group_and_their_energy_together():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0, damping=0.5))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205), input="rest_length")
    options = {"controller": tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.02)}
    options |= {"rest_length": plant.rest_length, "step": 1e-3}
    start = plant.to_nodes([0.02] + 8 * [0.0])
    winches = tc.Winches(ramp=True, motor=tc.Motor(drum_radius=0.01, gear_ratio=20.0))
    run = tc.simulate(model, 0.1, start, winches=winches, **options)
    panels, motors = tc.plot.motors(run), run.control.motors
    assert list(panels) == ["angle", "speed", "torque", "power", "energy"]
    for name in ("angle", "speed", "torque", "power"):
        lines = panels[name].lines["vertical"]
        drawn = np.array([line.get_ydata() for line in lines])
        np.testing.assert_array_equal(drawn, getattr(motors, name)[prism.strings_in("vertical")])
    (total,) = panels["energy"].lines["all motors"]
    np.testing.assert_array_equal(total.get_ydata(), motors.energy.sum(axis=0))
    assert panels["torque"].ax.get_ylabel() == "motor torque, N m"
    with pytest.raises(ValueError, match="run has no motors"):
        tc.plot.motors(tc.simulate(model, 0.1, start, **options))


def test_driven_bars_are_drawn_apart():
    """Of two bars the one that is driven: its work, and its look in the drawing of the run."""
    bars = tc.Structure([[0, 1, 0, 1], [0, 0, 1, 1]], [(0, 1), (2, 3)], [], 1.0)
    grow = tc.Profile([0.0, 0.1], [[1.0, 1.1], [1.0, 1.0]], "cubic")
    run = tc.simulate(tc.Model(bars), 0.1, bar_length=grow, step=0.01, error="none")
    panels = tc.plot.struts(run)
    assert list(panels["force"].lines) == ["bar 0"]
    np.testing.assert_array_equal(
        panels["work"].lines["all drives"][0].get_ydata(), run.struts.work.sum(axis=0)
    )
    drawing = tc.plot.structure(run)
    wide, slim = drawing.bars.get_linewidths()[::-1]
    assert slim < wide
    labels = [text.get_text() for text in drawing.ax.get_legend().get_texts()]
    assert labels == ["bar", "driven bar"]
    traces = {trace["name"]: trace for trace in tc.plot.view(run).figure()["data"]}
    ends = [[x for x in traces[name]["x"] if x is not None] for name in ("bars", "driven bars")]
    assert [len(points) for points in ends] == [2, 2]
    assert traces["driven bars"]["line"]["width"] < traces["bars"]["line"]["width"]
    with pytest.raises(ValueError, match="drives no bar"):
        tc.plot.struts(tc.simulate(tc.Model(bars), 0.1, step=0.01))
