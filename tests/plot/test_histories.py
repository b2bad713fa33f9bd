"""Curves over time: the generic plot, a motion, and its health."""

import numpy as np
import pytest

import tenscontrol as tc


def legend(ax):
    return sorted(text.get_text() for text in ax.get_legend().get_texts())


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

    def test_times_that_are_all_the_same(self):
        assert tc.plot.history([1.0, 1.0], {"a": [0.0, 1.0]}, "m").ax.get_xlim()[0] < 1.0

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
            ({"references": np.zeros(3)}, TypeError, "references is a ndarray, expected a dict"),
            (
                {"references": {"b": 1e200}},
                ValueError,
                r"references\['b'\] is 1e\+200, expected",
            ),
            ({"time": [0, 1, 1e308]}, ValueError, r"time\[2\] is 1e\+308, expected"),
            (
                {"series": {"a": [0, 0, -1e200]}},
                ValueError,
                r"series\['a'\]\[2\] is -1e\+200, expected",
            ),
            ({"ylabel": 3}, TypeError, "ylabel is 3"),
            ({"ax": 3}, TypeError, "ax is a int, expected flat"),
        ],
    )
    def test_wrong_arguments_are_named(self, arguments, error, message):
        given = {"time": [0, 1, 2], "series": {"a": [0, 0, 0]}, "ylabel": "m"}
        with pytest.raises(error, match=message):
            tc.plot.history(**(given | arguments))
