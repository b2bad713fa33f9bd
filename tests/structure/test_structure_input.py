"""Input of structure that must be refused by name."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tests.refused import (
    INF,
    NAN,
    STILL,
    assert_refused,
    line,
    lone_bar,
    model,
    nodes,
    prism,
    refused,
    with_entry,
)


def line_nodes():
    """The nodes of the line."""
    return np.array([[0.0, 1, 2, 3], [0, 0, 0, 0], [0, 0, 0, 0]])


# fmt: off
# Two lines a case.
STRUCTURE = [
    refused("nodes transposed", lambda: line(nodes=line_nodes().T), ValueError,
            r"nodes has shape \(4, 3\), expected \(3, n\).*transpose"),
    refused("nodes of one dimension", lambda: line(nodes=line_nodes()[:1]), ValueError,
            r"nodes has shape \(1, 4\), expected \(3, n\), or \(2, n\)"),
    refused("nodes of three dimensions", lambda: line(nodes=np.zeros((3, 4, 1))), ValueError,
            r"nodes has shape \(3, 4, 1\), expected \(3, n\)"),
    refused("nodes empty", lambda: line(nodes=np.zeros((3, 0)), bars=[], strings=[]), ValueError,
            r"nodes has shape \(3, 0\), expected \(3, n\)"),
    refused("nodes nan", lambda: line(nodes=with_entry(line_nodes(), (0, 1), NAN)), ValueError,
            r"nodes\[0, 1\] is nan.*1 of 12"),
    refused("nodes inf", lambda: line(nodes=with_entry(line_nodes(), (0, 1), INF)), ValueError,
            r"nodes\[0, 1\] is inf.*1 of 12"),
    refused("nodes text", lambda: line(nodes="abc"), TypeError, r"nodes .*'abc'"),
    refused("nodes ragged", lambda: line(nodes=[[0, 1, 2, 3], [0, 0, 0], [0, 0, 0, 0]]), TypeError,
            r"nodes .*(inhomogeneous|ragged|lengths)"),
    refused("nodes a list with a complex number",
            lambda: line(nodes=[[0, 1j, 2, 3], [0] * 4, [0] * 4]), TypeError,
            r"nodes .*complex"),
    refused("nodes dict", lambda: line(nodes={"x": 0}), TypeError, r"nodes .*(dict|\{'x': 0\})"),
    refused("bars transposed", lambda: tc.Structure(nodes(), prism().bars.T, prism().strings, 1.0),
            ValueError, r"bars has shape \(2, 3\), expected \(count, 2\)"),
    refused("bars one flat pair", lambda: line(bars=[1, 2]), ValueError,
            r"bars has shape \(2,\), expected \(count, 2\)"),
    refused("bars one number", lambda: line(bars=3), ValueError,
            r"bars has shape \(\), expected \(count, 2\)"),
    refused("bars nan", lambda: line(bars=[[1, NAN]]), ValueError, r"bars\[0, 1\] is nan"),
    refused("bars text", lambda: line(bars=[["a", "b"]]), TypeError, r"bars .*'a'"),
    refused("bars float index", lambda: line(bars=[[1, 1.5]]), TypeError,
            r"bars\[0\] is 1\.5, expected a whole number"),
    refused("bars out of range", lambda: line(bars=[[1, 4]]), ValueError,
            r"bars\[0\] is node 4, expected 0 to 3"),
    refused("bars negative index", lambda: line(bars=[[1, -1]]), ValueError,
            r"bars\[0\] is node -1, expected 0 to 3"),
    refused("bars self-connected", lambda: line(bars=[[1, 1]]), ValueError,
            r"bars\[0\] joins node 1 to itself"),
    refused("bars twice", lambda: line(bars=[[1, 2], [2, 1]]), ValueError,
            r"bars\[1\] joins nodes 1 and 2, as bars\[0\] does"),
    refused("strings transposed",
            lambda: tc.Structure(nodes(), prism().bars, prism().strings.T, 1.0), ValueError,
            r"strings has shape \(2, 9\), expected \(count, 2\)"),
    refused("strings float index", lambda: line(strings=[[0, 1], [2, 2.5]]), TypeError,
            r"strings\[1\] is 2\.5, expected a whole number"),
    refused("strings out of range", lambda: line(strings=[[0, 1], [2, 7]]), ValueError,
            r"strings\[1\] is node 7, expected 0 to 3"),
    refused("strings self-connected", lambda: line(strings=[[0, 0], [2, 3]]), ValueError,
            r"strings\[0\] joins node 0 to itself"),
    refused("node untouched", lambda: line(nodes=np.arange(15.0).reshape(3, 5)), ValueError,
            r"^nodes\[:, 4\] is in none of bars, strings and fixed; remove it"),
    refused("several nodes untouched", lambda: line(nodes=np.arange(18.0).reshape(3, 6)),
            ValueError, r"^nodes\[:, 4\] \(and 1 more\) is in none of bars"),
    refused("bar of no length", lambda: line(nodes=[[0, 1, 1, 3], [0] * 4, [0] * 4]), ValueError,
            r"bars\[0\] has no length: nodes 1 and 2"),
    refused("bar_mass zero", lambda: line(bar_mass=0), ValueError, r"bar_mass\[0\] is 0, .*kg"),
    refused("bar_mass negative", lambda: tc.prism(bar_mass=[1, -2, 1]), ValueError,
            r"bar_mass\[1\] is -2"),
    refused("bar_mass nan", lambda: line(bar_mass=NAN), ValueError, r"bar_mass is nan"),
    refused("bar_mass inf", lambda: line(bar_mass=[INF]), ValueError, r"bar_mass\[0\] is inf"),
    refused("bar_mass text", lambda: line(bar_mass="heavy"), TypeError, r"bar_mass .*'heavy'"),
    refused("bar_mass complex", lambda: line(bar_mass=1j), TypeError, r"bar_mass .*complex"),
    refused("bar_mass too many", lambda: line(bar_mass=[1, 2]), ValueError,
            r"bar_mass has shape \(2,\), expected \(\) or \(1,\).*per bar"),
    refused("string_node_mass missing", lambda: line(string_node_mass=None), ValueError,
            r"node 0 is in none of bars.*needs string_node_mass.* 2 string nodes"),
    refused("string_node_mass too many", lambda: line(string_node_mass=[0.1] * 4), ValueError,
            r"string_node_mass has shape \(4,\), expected \(\) or \(2,\).*per string node"),
    refused("string_node_mass zero", lambda: line(string_node_mass=[0.1, 0]), ValueError,
            r"string_node_mass\[1\] is 0"),
    refused("string_node_mass nan", lambda: line(string_node_mass=[NAN, 0.1]), ValueError,
            r"string_node_mass\[0\] is nan"),
    refused("string_groups one text", lambda: line(string_groups="top"), TypeError,
            r"string_groups is .*'top'"),
    refused("string_groups too few", lambda: line(string_groups=["a"]), ValueError,
            r"string_groups has 1 names, expected 2"),
    refused("string_groups not a name", lambda: line(string_groups=["a", "b c"]), ValueError,
            r"string_groups\[1\] is 'b c'"),
    refused("string_groups a number", lambda: line(string_groups=["a", 3]), ValueError,
            r"string_groups\[1\] is 3"),
    refused("Structure keyword", lambda: line(mass=3), TypeError, r"keyword argument 'mass'"),
    refused("strings_in unknown", lambda: prism().strings_in("diagonal"), ValueError,
            r"group is 'diagonal', expected one of 'top', 'bottom', 'vertical'"),
    refused("strings_in of no strings", lambda: lone_bar().strings_in("string"), ValueError,
            r"group is 'string', expected one of none"),
    refused("string_length transposed", lambda: prism().string_length(nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("string_length nan", lambda: prism().string_length(with_entry(nodes(), (2, 5), NAN)),
            ValueError, r"nodes\[2, 5\] is nan"),
    refused("restore_bar_lengths transposed",
            lambda: tc.structure.restore_bar_lengths(prism(), nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("restore_bar_lengths nan",
            lambda: tc.structure.restore_bar_lengths(prism(), with_entry(nodes(), (0, 0), NAN)),
            ValueError, r"nodes\[0, 0\] is nan"),
    refused("restore_bar_lengths collapsed",
            lambda: tc.structure.restore_bar_lengths(prism(), STILL), ValueError,
            r"ends of bar 0 are at the same point"),
]

PRISM = [
    refused("sides two", lambda: tc.prism(sides=2), ValueError, r"sides is 2, .*at least 3"),
    refused("sides text", lambda: tc.prism(sides="3"), TypeError, r"sides is '3', .*whole"),
    refused("sides bool", lambda: tc.prism(sides=True), TypeError, r"sides is True, .*whole"),
    refused("radius zero", lambda: tc.prism(radius=0), ValueError, r"radius is 0, .* m"),
    refused("radius array", lambda: tc.prism(radius=[0.5]), TypeError, r"radius is \[0\.5\]"),
    refused("height none", lambda: tc.prism(height=None), TypeError, r"height is None"),
    refused("height nan", lambda: tc.prism(height=NAN), ValueError, r"height is nan"),
    refused("height inf", lambda: tc.prism(height=INF), ValueError, r"height is inf"),
    refused("height complex", lambda: tc.prism(height=1j), TypeError, r"height is 1j"),
    refused("top_radius negative", lambda: tc.prism(top_radius=-1.0), ValueError,
            r"top_radius is -1"),
    refused("handedness unknown", lambda: tc.prism(handedness="Left"), ValueError,
            r"handedness is 'Left', expected one of 'left', 'right'"),
    refused("handedness none", lambda: tc.prism(handedness=None), ValueError,
            r"handedness is None"),
    refused("prism bar_mass too few", lambda: tc.prism(bar_mass=[1, 2]), ValueError,
            r"bar_mass has shape \(2,\), expected \(\) or \(3,\)"),
    refused("prism keyword", lambda: tc.prism(bars=3), TypeError, r"keyword argument 'bars'"),
    refused("prism_radius too high", lambda: tc.structure.prism_radius(1.0, height=1.5), ValueError,
            r"height is 1\.5 m, expected less than the bar length 1 m"),
    refused("prism_radius negative length", lambda: tc.structure.prism_radius(-1.0, height=0.5),
            ValueError, r"bar_length is -1\.0"),
    refused("prism_radius text height", lambda: tc.structure.prism_radius(1.0, height="low"),
            TypeError, r"height is 'low'"),
    refused("prism_radius sides", lambda: tc.structure.prism_radius(1.0, height=0.5, sides=2),
            ValueError, r"sides is 2"),
]

FOUND_IN_REVIEW = [
    refused("nodes none", lambda: line(nodes=None), TypeError, r"nodes is None"),
    refused("bars none", lambda: line(bars=None), TypeError, r"bars is None"),
    refused("bar_mass none", lambda: line(bar_mass=None), TypeError, r"bar_mass is None"),
    refused("bar_mass one none", lambda: tc.prism(bar_mass=[1, None, 1]), TypeError,
            r"bar_mass.*None"),
    refused("nodes complex", lambda: line(nodes=line_nodes() + 0j), TypeError, r"nodes.*complex"),
    refused("bars complex", lambda: line(bars=np.array([[1, 2 + 0j]])), TypeError,
            r"bars.*complex"),
    refused("bar_mass complex of NumPy", lambda: line(bar_mass=np.complex128(1 + 1j)), TypeError,
            r"bar_mass.*complex"),
    refused("bar_mass digits", lambda: line(bar_mass="1.0"), TypeError, r"bar_mass.*1\.0"),
    refused("bars digits", lambda: line(bars=[["1", "2"]]), TypeError, r"bars.*(str|text|'1')"),
    refused("bar_mass bool", lambda: line(bar_mass=True), TypeError, r"bar_mass.*(True|bool)"),
    refused("bars bool", lambda: line(bars=[[True, False]], strings=[[0, 2], [2, 3]]), TypeError,
            r"bars.*(True|bool)"),
    refused("nodes dates", lambda: line(nodes=line_nodes().astype("datetime64[s]")), TypeError,
            r"nodes.*datetime"),
    refused("nodes masked", lambda: line(nodes=np.ma.masked_equal(line_nodes(), 3.0)),
            (TypeError, ValueError), r"nodes.*mask"),
    refused("string_groups one number", lambda: line(string_groups=3), TypeError, r"string_groups"),
    refused("restore_bar_lengths of a model",
            lambda: tc.structure.restore_bar_lengths(model(), nodes()), TypeError,
            r"structure is a Model, expected Structure"),
    refused("bars of no columns",
            lambda: tc.Structure(nodes(), np.zeros((3, 0)), prism().strings, 1.0, 0.1), ValueError,
            r"bars has shape \(3, 0\), expected \(count, 2\)"),
    refused("bar_vectors transposed", lambda: prism().bar_vectors(nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("string_vectors of four rows", lambda: prism().string_vectors(np.zeros((4, 6))),
            ValueError, r"nodes has shape \(4, 6\), expected \(3, 6\)"),
    refused("bars index beyond integers", lambda: line(bars=[[1, 1e30]]), (TypeError, ValueError),
            r"bars\[0\].*1e\+30"),
    refused("height beyond numbers", lambda: tc.prism(height=10**400), (TypeError, ValueError),
            r"height"),
    refused("height whose square overflows", lambda: tc.prism(height=1e200), ValueError,
            r"^height is 1e\+200, expected a positive .* in m, between 1e-70 and 1e\+70"),
    refused("nodes whose squares overflow", lambda: line(nodes=1e71 * line_nodes()), ValueError,
            r"^nodes\[0, 1\] is 1e\+71, expected at most 1e\+70"),
    refused("bar length whose square overflows", lambda: tc.structure.prism_radius(1e160, 1.0),
            ValueError, r"^bar_length is 1e\+160, expected a positive"),
    refused("nodes too far to restore bars",
            lambda: tc.structure.restore_bar_lengths(prism(), with_entry(nodes(), (0, 0), 1e300)),
            ValueError, r"^nodes\[0, 0\] is 1e\+300, expected at most 1e\+70"),
    refused("nodes so far that bars vanish",
            lambda: tc.structure.restore_bar_lengths(prism(), nodes() + 1e20),
            ValueError, r"^nodes has entries up to 1e\+20 m, .* cannot resolve the shortest bar"),
]

# fmt: on


CASES = [*STRUCTURE, *PRISM, *FOUND_IN_REVIEW]


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)


def test_strings_that_cannot_be_meant_are_told_once():
    known = tc.prism()
    doubled = np.vstack([known.strings, known.strings[:1, ::-1]])
    with pytest.warns(UserWarning, match=r"strings\[9\] joins nodes .*, as strings\[0\]") as told:
        structure = tc.Structure(known.nodes, known.bars, doubled, 1.0)
    assert len(told) == 1
    along = np.vstack([known.strings, known.bars[:1]])
    with pytest.warns(UserWarning, match=r"strings\[9\] joins nodes 0 and 4, as bars\[0\] does"):
        tc.Structure(known.nodes, known.bars, along, 1.0)
    with warnings.catch_warnings(action="error"):
        replace(structure, nodes=2 * structure.nodes)
        groups = [*known.string_groups, "spare"]
        tc.Structure(known.nodes, known.bars, doubled, 1.0, string_groups=groups)
