"""Curves over time: the generic plot, a motion, and its health."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc


def legend(ax):
    return sorted(text.get_text() for text in ax.get_legend().get_texts())


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


class TestHistory:
    time = np.linspace(0, 2, 21)

    def test_draws_every_row_under_one_name(self):
        rows = np.vstack([self.time, 2 * self.time])
        curves = tc.plot.history(self.time, {"a": rows, "b": -self.time}, "height, m")
        assert [len(lines) for lines in curves.lines.values()] == [2, 1]
        assert np.array_equal(curves.lines["a"][1].get_ydata(), 2 * self.time)
        assert np.array_equal(curves.lines["b"][0].get_xdata(), self.time)
        assert legend(curves.ax) == ["a", "b"]

    def test_axes_have_units_and_end_with_the_data(self):
        ax = tc.plot.history(self.time, {"a": self.time}, "height, m").ax
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("time, s", "height, m")
        assert ax.get_xlim() == (0.0, 2.0)

    def test_names_differ_in_colour_and_in_dashes(self):
        series = {f"{i}": self.time + i for i in range(5)}
        lines = [line for (line,) in tc.plot.history(self.time, series, "m").lines.values()]
        assert len({line.get_color() for line in lines}) == 5
        assert len({str(line._unscaled_dash_pattern) for line in lines}) == 5

    def test_references_are_numbers_or_courses(self):
        references = {"limit": 3.0, "ramp": 0.5 * self.time}
        curves = tc.plot.history(self.time, {"a": self.time}, "m", references=references)
        assert (curves.references["limit"].get_ydata() == 3.0).all()
        assert np.array_equal(curves.references["ramp"].get_ydata(), 0.5 * self.time)
        assert curves.ax.get_ylim()[1] > 3.0
        assert legend(curves.ax) == ["a", "limit", "ramp"]

    def test_legend_is_above_the_data(self):
        series = {f"a rather long name {i}": self.time for i in range(7)}
        ax = tc.plot.history(self.time, series, "m").ax
        ax.figure.canvas.draw()
        box = ax.get_legend().get_window_extent()
        assert box.y0 >= ax.get_window_extent().y1 - 1
        assert box.x1 <= ax.figure.bbox.x1 + 1
        assert box.y1 <= ax.figure.bbox.y1 + 1

    def test_legend_is_read_row_by_row(self):
        series = {name * 14: self.time for name in "abcde"}
        ax = tc.plot.history(self.time, series, "m").ax
        ax.figure.canvas.draw()
        places = {
            text.get_text()[0]: text.get_window_extent() for text in ax.get_legend().get_texts()
        }
        read = sorted(places, key=lambda name: (-round(places[name].y0), places[name].x0))
        assert "".join(read) == "abcde"

    def test_name_that_begins_with_an_underscore_shows(self):
        ax = tc.plot.history(self.time, {"_a": self.time}, "m").ax
        assert [text.strip("\u200b") for text in legend(ax)] == ["_a"]

    def test_draws_into_given_axes(self, flat):
        assert tc.plot.history(self.time, {"a": self.time}, "m", ax=flat).ax is flat

    @pytest.mark.parametrize(
        ("arguments", "error", "message"),
        [
            ({"time": [[0.0]]}, ValueError, r"time has shape \(1, 1\), expected \(T,\)"),
            ({"time": [0, 2, 1]}, ValueError, r"time\[2\] is 1, expected at least time\[1\] = 2"),
            ({"series": [1, 2]}, TypeError, "series is a list, expected a dict"),
            ({"series": {3: [0, 0, 0]}}, TypeError, "series has the key 3"),
            ({"series": {"a": [0, 0]}}, ValueError, r"series\['a'\] has shape \(2,\)"),
            ({"series": {"a": [0, 0, np.inf]}}, ValueError, r"series\['a'\]\[2\] is inf"),
            ({"references": {"b": [1, 2]}}, ValueError, r"references\['b'\] has shape \(2,\)"),
            ({"ylabel": 3}, TypeError, "ylabel is 3"),
            ({"ax": 3}, TypeError, "ax is a int, expected flat"),
        ],
    )
    def test_wrong_arguments_are_named(self, arguments, error, message):
        given = {"time": [0, 1, 2], "series": {"a": [0, 0, 0]}, "ylabel": "m"}
        with pytest.raises(error, match=message):
            tc.plot.history(**(given | arguments))


class TestTrajectory:
    def test_panels_of_held_rest_lengths(self, slack_run):
        panels = tc.plot.trajectory(slack_run)
        assert list(panels) == ["coordinates", "force_density", "rest_length"]
        labels = [panel.ax.get_ylabel() for panel in panels.values()]
        assert labels == ["node position, m", "γ, N/m", "rest length, m"]
        assert [panel.ax.get_xlabel() for panel in panels.values()] == ["", "", "time, s"]

    def test_panels_of_held_force_density(self, free_run):
        panels = tc.plot.trajectory(free_run)
        assert list(panels) == ["coordinates", "force_density"]

    def test_draws_the_coordinates_asked_for(self, slack_run):
        lines = tc.plot.trajectory(slack_run, nodes=(0, 4), directions="xz")["coordinates"].lines
        assert list(lines) == ["x[0]", "z[0]", "x[4]", "z[4]"]
        assert np.array_equal(lines["z[4]"][0].get_ydata(), slack_run.nodes[2, 4])

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
            ({"nodes": 2}, TypeError, "nodes is 2, expected a sequence"),
            ({"directions": "xw"}, ValueError, "directions is 'xw', expected letters"),
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
        panel = tc.plot.health(replace(slack_run, momentum=momentum))["momentum"]
        drawn = panel.lines["linear, kg m/s"][0].get_ydata()
        assert drawn[199] < 1e-12
        assert np.isclose(drawn[200], 0.5)

    def test_a_structure_at_rest_is_drawn(self, prism, rest):
        run = tc.simulate(tc.Model(prism), 0.01, force_density=rest.force_density, step=1e-3)
        still = replace(
            run,
            velocities=0 * run.velocities,
            momentum=0 * run.momentum,
            angular_momentum=0 * run.angular_momentum,
            bar_length_error=0 * run.bar_length_error,
        )
        panels = tc.plot.health(still)
        panels["energy"].ax.figure.canvas.draw()
        assert np.isfinite(panels["momentum"].ax.get_ylim()).all()

    def test_wrong_axes_are_named(self, slack_run, flat):
        with pytest.raises(ValueError, match="axes has 1 entries, expected 3: one for each of ene"):
            tc.plot.health(slack_run, axes=[flat])
        with pytest.raises(TypeError, match="run is a str"):
            tc.plot.health("run")
