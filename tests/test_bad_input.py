"""Input that must be refused, and what the refusal must say.

One table. A case is a call, the exception, and a regular expression for the message, which has to
name the argument (or the culprit) and what was found. To add a section, write another list of
``refused(...)`` and name it in ``CASES``.

Calls are functions of no argument, so that nothing runs before its own test.
"""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial

import numpy as np
import pytest

import tenscontrol as tc
from examples.stiffness_study import stiffness_report

NAN, INF = float("nan"), float("inf")
STILL = np.zeros((3, 6))


def refused(name, call, exception, message):
    """One case of the table."""
    return pytest.param(call, exception, message, id=name)


# ---- good input, to be spoilt ----


def line(**changes):
    """A bar between two string nodes, with some arguments replaced."""
    arguments = {
        "nodes": [[0, 1, 2, 3], [0, 0, 0, 0], [0, 0, 0, 0]],
        "bars": [[1, 2]],
        "strings": [[0, 1], [2, 3]],
        "bar_mass": 1.0,
        "string_node_mass": 0.1,
    }
    return tc.Structure(**(arguments | changes))


def line_nodes():
    """The nodes of the line."""
    return np.array([[0.0, 1, 2, 3], [0, 0, 0, 0], [0, 0, 0, 0]])


def with_entry(array, index, value):
    """A copy of an array with one entry replaced."""
    changed = np.array(array, dtype=float)
    changed[index] = value
    return changed


@cache
def prism():
    return tc.prism()


def nodes():
    return prism().nodes


@cache
def rest():
    return tc.prestress(prism(), force_density=17.3205)


def gamma():
    return rest().force_density


@cache
def model():
    """Without string law."""
    return tc.Model(prism())


@cache
def elastic():
    """With string law."""
    return tc.Model(prism(), strings=tc.LinearStrings(stiffness=100.0))


@cache
def loaded():
    """With a load input."""
    return tc.Model(prism(), external_force=True)


@cache
def plant(coordinates="internal"):
    return tc.linearize(model(), rest(), coordinates=coordinates)


@cache
def rest_length():
    return tc.to_rest_length(elastic(), nodes(), gamma()).rest_length


@cache
def regulator(step=0.001, max_force_density=50.0):
    return tc.lqr(plant(), Q=1.0, R=1e-3, sample_time=step, max_force_density=max_force_density)


@cache
def winch_regulator():
    """Commands rest lengths."""
    return tc.lqr(
        tc.linearize(elastic(), rest(), input="rest_length"), Q=1.0, R=1.0, sample_time=0.001
    )


@cache
def pentagon_regulator():
    """Commands fifteen strings."""
    pentagon = tc.prism(sides=5)
    return tc.lqr(tc.linearize(tc.Model(pentagon), tc.prestress(pentagon, 17.0)), Q=1.0, R=1.0)


def mpc_on(reference):
    """An MPC on a reference."""
    return tc.MPC(plant(), horizon=2, sample_time=0.02, max_force_density=50.0, reference=reference)


def still_shape():
    """A reference of one shape, without force densities."""
    return tc.Reference([0.0], nodes()[:, :, None])


@cache
def short_path():
    """A path of a few shapes."""
    low = tc.Height(0.95, top=[0, 1, 2], bottom=[3, 4, 5])
    goal = tc.shape_target(elastic(), low, force_density=17.3205)
    return tc.shape_path(elastic(), rest(), goal, duration=1.0, step=0.25)


@cache
def lone_bar():
    """A bar and no string."""
    return tc.Structure([[0, 1], [0, 0], [0, 0]], bars=[[0, 1]], strings=[], bar_mass=1.0)


@cache
def touching():
    """The model of a line whose second string has no length."""
    structure = line(nodes=[[0, 1, 2, 2], [0, 0, 0, 0], [0, 0, 0, 0]])
    return tc.Model(structure, strings=tc.LinearStrings(stiffness=100.0))


def point(**changes):
    """The prism at rest, with some arguments of the operating point replaced."""
    return tc.OperatingPoint(**({"nodes": nodes(), "force_density": gamma()} | changes))


def drifting(of, nodes=None, force_density=None, **options):
    """The linear model of a shape that need not be at rest, of the prism if not given."""
    at = tc.OperatingPoint(prism().nodes if nodes is None else nodes, force_density)
    return tc.linearize(of, at, require_equilibrium=False, **options)


@cache
def held_plant():
    """Rest lengths are the input."""
    return tc.linearize(elastic(), rest(), input="rest_length")


@cache
def lengths(**options):
    """Sensors of all string lengths, with other options."""
    return tc.Sensors(**({"structure": prism(), "string_length": 1e-3} | options))


@cache
def estimator(step=0.001):
    return tc.kalman(held_plant(), lengths(), sample_time=step)


def flipped():
    """The nodes of the prism with the ends of one bar exchanged: bars keep their lengths."""
    turned, (start, end) = nodes().copy(), prism().bars[0]
    turned[:, [start, end]] = nodes()[:, [end, start]]
    return turned


def kalman(**changes):
    """A filter for the prism, with some arguments replaced."""
    arguments = {"plant": held_plant(), "sensors": lengths(), "sample_time": 0.01} | changes
    return tc.kalman(**arguments)


def run(**changes):
    """A short simulation with held rest lengths, with some arguments replaced."""
    return tc.simulate(
        **({"model": elastic(), "duration": 0.01, "rest_length": rest_length()} | changes)
    )


def closed(**changes):
    """A short simulation in closed loop, with some arguments replaced."""
    return tc.simulate(
        **({"model": elastic(), "duration": 0.002, "controller": regulator()} | changes)
    )


# fmt: off
# Two lines a case.

# ---- structure/ ----

STRUCTURE = [
    refused("nodes transposed", lambda: line(nodes=line_nodes().T), ValueError,
            r"nodes has shape \(4, 3\), expected \(3, n\).*transpose"),
    refused("nodes planar", lambda: line(nodes=line_nodes()[:2]), ValueError,
            r"nodes has shape \(2, 4\), expected \(3, n\)"),
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
            r"bars\[0\] is \[1\.0, 1\.5\], expected two whole numbers"),
    refused("bars out of range", lambda: line(bars=[[1, 4]]), ValueError,
            r"bars\[0\] names node 4, expected 0 to 3"),
    refused("bars negative index", lambda: line(bars=[[1, -1]]), ValueError,
            r"bars\[0\] names node -1, expected 0 to 3"),
    refused("bars self-connected", lambda: line(bars=[[1, 1]]), ValueError,
            r"bars\[0\] joins node 1 to itself"),
    refused("bars twice", lambda: line(bars=[[1, 2], [2, 1]]), ValueError,
            r"bars\[1\] joins nodes 1 and 2, as bars\[0\] does"),
    refused("strings transposed",
            lambda: tc.Structure(nodes(), prism().bars, prism().strings.T, 1.0), ValueError,
            r"strings has shape \(2, 9\), expected \(count, 2\)"),
    refused("strings float index", lambda: line(strings=[[0, 1], [2, 2.5]]), TypeError,
            r"strings\[1\] is \[2\.0, 2\.5\], expected two whole numbers"),
    refused("strings out of range", lambda: line(strings=[[0, 1], [2, 7]]), ValueError,
            r"strings\[1\] names node 7, expected 0 to 3"),
    refused("strings self-connected", lambda: line(strings=[[0, 0], [2, 3]]), ValueError,
            r"strings\[0\] joins node 0 to itself"),
    refused("strings twice", lambda: line(strings=[[0, 1], [1, 0], [2, 3]]), ValueError,
            r"strings\[1\] joins nodes 0 and 1, as strings\[0\] does"),
    refused("string along a bar", lambda: line(strings=[[0, 1], [2, 3], [2, 1]]), ValueError,
            r"strings\[2\] joins nodes 1 and 2, as bars\[0\] does"),
    refused("node on two bars", lambda: line(bars=[[0, 1], [1, 2]], strings=[[2, 3], [0, 2]]),
            ValueError, r"node 1 is on bars \[0, 1\]: not a class-1 structure"),
    refused("node untouched", lambda: line(nodes=np.arange(15.0).reshape(3, 5)), ValueError,
            r"nothing touches node 4"),
    refused("several nodes untouched", lambda: line(nodes=np.arange(18.0).reshape(3, 6)),
            ValueError, r"nothing touches node 4 \(nor 1 more\)"),
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
    refused("bar_mass of two dimensions", lambda: line(bar_mass=[[1.0]]), ValueError,
            r"bar_mass has shape \(1, 1\), expected \(\) or \(1,\)"),
    refused("string_node_mass missing", lambda: line(string_node_mass=None), ValueError,
            r"node 0 is on no bar.*needs string_node_mass.* 2 string nodes"),
    refused("string_node_mass superfluous",
            lambda: tc.Structure(nodes(), prism().bars, prism().strings, 1.0, string_node_mass=0.1),
            ValueError, r"string_node_mass is given, but every node is on a bar"),
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
            r"no string group 'diagonal'.*'top', 'bottom', 'vertical'"),
    refused("strings_in of no strings", lambda: lone_bar().strings_in("string"), ValueError,
            r"no string group 'string'.*none"),
    refused("string_length transposed", lambda: prism().string_length(nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("string_length nan", lambda: prism().string_length(with_entry(nodes(), (2, 5), NAN)),
            ValueError, r"nodes\[2, 5\] is nan"),
    refused("restore_bar_lengths transposed", lambda: tc.structure.restore_bar_lengths(prism(), nodes().T),
            ValueError, r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("restore_bar_lengths nan",
            lambda: tc.structure.restore_bar_lengths(prism(), with_entry(nodes(), (0, 0), NAN)), ValueError,
            r"nodes\[0, 0\] is nan"),
    refused("restore_bar_lengths collapsed", lambda: tc.structure.restore_bar_lengths(prism(), STILL),
            ValueError, r"ends of bar 0 are at the same place"),
]

PRISM = [
    refused("sides two", lambda: tc.prism(sides=2), ValueError, r"sides is 2, .*at least 3"),
    refused("sides float", lambda: tc.prism(sides=3.0), TypeError, r"sides is 3\.0, .*whole"),
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
    refused("prism_radius negative length", lambda: tc.structure.prism_radius(-1.0, height=0.5), ValueError,
            r"bar_length is -1\.0"),
    refused("prism_radius text height", lambda: tc.structure.prism_radius(1.0, height="low"), TypeError,
            r"height is 'low'"),
    refused("prism_radius sides", lambda: tc.structure.prism_radius(1.0, height=0.5, sides=2), ValueError,
            r"sides is 2"),
]

# ---- statics/ ----

STATICS = [
    refused("prestress of a model", lambda: tc.prestress(model(), 17.0), TypeError,
            r"structure is a Model, expected Structure"),
    refused("prestress of no strings", lambda: tc.prestress(lone_bar(), 17.0), ValueError,
            r"structure has no strings"),
    refused("prestress impossible", lambda: tc.prestress(line(), 1.0), ValueError,
            r"no state of self-stress.*singular value.*4\.1e-01"),
    refused("force_density none", lambda: tc.prestress(prism(), None), TypeError,
            r"force_density is None"),
    refused("force_density text", lambda: tc.prestress(prism(), "17"), TypeError,
            r"force_density .*'17'"),
    refused("force_density zero", lambda: tc.prestress(prism(), 0.0), ValueError,
            r"force_density is 0\.0, .*positive"),
    refused("force_density negative number", lambda: tc.prestress(prism(), -1.0), ValueError,
            r"force_density is -1\.0, .*positive"),
    refused("force_density nan", lambda: tc.prestress(prism(), NAN), ValueError,
            r"force_density is nan"),
    refused("force_density bool", lambda: tc.prestress(prism(), True), TypeError,
            r"force_density .*True"),
    refused("force_density too few", lambda: tc.prestress(prism(), gamma()[:8]), ValueError,
            r"force_density has shape \(8,\), expected \(9,\)"),
    refused("force_density a row", lambda: tc.prestress(prism(), gamma()[None, :]), ValueError,
            r"force_density has shape \(1, 9\), expected \(9,\)"),
    refused("force_density negative entry",
            lambda: tc.prestress(prism(), with_entry(gamma(), 4, -1.0)), ValueError,
            r"force_density\[4\] is -1, .*can only pull"),
    refused("force_density nan entry", lambda: tc.prestress(prism(), with_entry(gamma(), 4, NAN)),
            ValueError, r"force_density\[4\] is nan"),
    refused("force_density unbalanced", lambda: tc.prestress(prism(), np.ones(9)), ValueError,
            r"force_density does not balance: node \d is left with .* 0\.47 N"),
    refused("reference with an array", lambda: tc.prestress(prism(), gamma(), reference="top"),
            ValueError, r"reference goes with a single force_density"),
    refused("reference unknown", lambda: tc.prestress(prism(), 17.0, reference="diagonal"),
            ValueError, r"no string group 'diagonal'.*'top', 'bottom', 'vertical'"),
    refused("prestress load transposed",
            lambda: tc.prestress(prism(), 17.0, external_force=STILL.T), ValueError,
            r"external_force has shape \(6, 3\), expected \(3, 6\)"),
    refused("prestress load nan",
            lambda: tc.prestress(prism(), 17.0, external_force=with_entry(STILL, (1, 2), NAN)),
            ValueError, r"external_force\[1, 2\] is nan"),
    refused("prestress load unbalanced",
            lambda: tc.prestress(prism(), 17.0, external_force=with_entry(STILL, (2, 0), 1.0)),
            ValueError, r"no member forces balance external_force: node \d is left with .* N"),
    refused("prestress keyword", lambda: tc.prestress(prism(), gamma=1.0), TypeError,
            r"argument 'gamma'"),
    refused("prism_force_density sides", lambda: tc.statics.prism_force_density(2, 1.0), ValueError,
            r"sides is 2"),
    refused("prism_force_density negative", lambda: tc.statics.prism_force_density(3, -1.0), ValueError,
            r"force_density is -1\.0"),
    refused("prism_force_density array", lambda: tc.statics.prism_force_density(3, [1.0, 2.0]), TypeError,
            r"force_density is \[1\.0, 2\.0\]"),
    refused("prism_force_density radius", lambda: tc.statics.prism_force_density(3, 1.0, radius=0.0),
            ValueError, r"^radius is 0\.0"),
    refused("prism_force_density top_radius",
            lambda: tc.statics.prism_force_density(3, 1.0, top_radius=INF), ValueError,
            r"top_radius is inf"),
    refused("equilibrium_matrix transposed", lambda: tc.statics.equilibrium_matrix(prism(), nodes().T),
            ValueError, r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("equilibrium_matrix nan",
            lambda: tc.statics.equilibrium_matrix(prism(), with_entry(nodes(), (2, 3), NAN)), ValueError,
            r"nodes\[2, 3\] is nan"),
    refused("equilibrium_matrix text", lambda: tc.statics.equilibrium_matrix(prism(), "here"), TypeError,
            r"nodes .*'here'"),
]

# ---- dynamics/ ----

STRINGS = [
    refused("stiffness missing", lambda: tc.LinearStrings(), TypeError, r"'stiffness'"),
    refused("stiffness zero", lambda: tc.LinearStrings(0.0), ValueError,
            r"stiffness\[0\] is 0, .*pos"),
    refused("stiffness negative", lambda: tc.LinearStrings([1.0, -2.0]), ValueError,
            r"stiffness\[1\] is -2"),
    refused("stiffness nan", lambda: tc.LinearStrings(NAN), ValueError, r"stiffness is nan"),
    refused("stiffness inf", lambda: tc.LinearStrings(INF), ValueError, r"stiffness is inf"),
    refused("stiffness text", lambda: tc.LinearStrings("k"), TypeError, r"stiffness .*'k'"),
    refused("stiffness complex", lambda: tc.LinearStrings(1j), TypeError, r"stiffness .*complex"),
    refused("stiffness of two dimensions", lambda: tc.LinearStrings(np.ones((2, 2))), ValueError,
            r"stiffness has shape \(2, 2\)"),
    refused("damping negative", lambda: tc.LinearStrings(1.0, damping=-1.0), ValueError,
            r"damping\[0\] is -1, expected at least 0"),
    refused("LinearStrings keyword", lambda: tc.LinearStrings(1.0, rest_length=1.0), TypeError,
            r"argument 'rest_length'"),
    refused("axial_rigidity zero", lambda: tc.ElasticStrings(0.0), ValueError,
            r"axial_rigidity\[0\] is 0"),
    refused("axial_rigidity text", lambda: tc.ElasticStrings("EA"), TypeError,
            r"axial_rigidity .*'EA'"),
    refused("elastic damping nan", lambda: tc.ElasticStrings(1.0, damping=[0.0, NAN]), ValueError,
            r"damping\[1\] is nan"),
    refused("ElasticStrings keyword", lambda: tc.ElasticStrings(stiffness=1.0), TypeError,
            r"argument 'stiffness'"),
    refused("StringLaw itself", lambda: tc.dynamics.StringLaw(), TypeError,
            r"abstract class StringLaw.*tension"),
    refused("length zero", lambda: tc.LinearStrings(100.0).force_density([1.0, 0.0], 1.0),
            ValueError, r"^length\[1\] is 0"),
    refused("rest_length negative",
            lambda: tc.ElasticStrings(100.0).force_density(1.0, [1.0, -0.5]), ValueError,
            r"rest_length\[1\] is -0\.5"),
    refused("rest_length nan", lambda: tc.LinearStrings(100.0).force_density(1.0, NAN), ValueError,
            r"rest_length is nan"),
    refused("rate nan", lambda: tc.LinearStrings(100.0).force_density(1.0, 0.9, rate=NAN),
            ValueError, r"rate is nan"),
    refused("shapes of arguments",
            lambda: tc.LinearStrings(100.0).force_density(np.ones(2), np.ones(3)), ValueError,
            r"length \(2,\), rest_length \(3,\)"),
    refused("shapes of arguments and parameters",
            lambda: tc.LinearStrings([1.0, 2.0]).force_density(np.ones(3), 1.0), ValueError,
            r"length.*\(3,\).*\(2,\)"),
    refused("lengths of two dimensions",
            lambda: tc.LinearStrings(100.0).force_density(np.ones((2, 2)), 1.0), ValueError,
            r"(?=.*shape \(2, 2\)).*one per string"),
    refused("force_density keyword",
            lambda: tc.LinearStrings(100.0).force_density(1.0, 1.0, velocity=0.0), TypeError,
            r"argument 'velocity'"),
    refused("force_density at the stiffness",
            lambda: tc.LinearStrings(100.0).rest_length(1.0, [1.0, 100.0]), ValueError,
            r"force_density\[1\] is 100 N/m, expected less than the stiffness 100 N/m"),
    refused("force_density of a pushing string",
            lambda: tc.ElasticStrings(100.0).rest_length(1.0, -2.0), ValueError,
            r"force_density\[0\] is -2, .*can only pull"),
    refused("force_density infinite", lambda: tc.ElasticStrings(100.0).rest_length(1.0, INF),
            ValueError, r"force_density is inf"),
]

MODEL = [
    refused("Model of nodes", lambda: tc.Model(nodes()), TypeError, r"structure is a ndarray"),
    refused("Model strings number", lambda: tc.Model(prism(), strings=100.0), TypeError,
            r"strings is a float, expected StringLaw"),
    refused("Model strings count", lambda: tc.Model(prism(), strings=tc.LinearStrings(np.ones(8))),
            ValueError, r"stiffness has shape \(8,\), expected \(\) or \(9,\)"),
    refused("Model damping count",
            lambda: tc.Model(prism(), strings=tc.ElasticStrings(1.0, damping=np.ones(3))),
            ValueError, r"damping has shape \(3,\), expected \(\) or \(9,\)"),
    refused("Model load transposed", lambda: tc.Model(prism(), external_force=np.zeros((6, 3))),
            ValueError, r"external_force has shape \(6, 3\), expected \(3, 6\)"),
    refused("Model gravity of two", lambda: tc.Model(prism(), gravity=[0.0, 9.81]), ValueError,
            r"gravity has shape \(2,\), expected \(\) or \(3,\)"),
    refused("Model gravity nan", lambda: tc.Model(prism(), gravity=NAN), ValueError,
            r"gravity is nan"),
    refused("Model keyword", lambda: tc.Model(prism(), g=9.81), TypeError, r"argument 'g'"),
    *[
        refused(
            f"{name} without strings",
            lambda name=name: getattr(model(), name),
            ValueError,
            r"model has no string law.*strings=LinearStrings",
        )
        for name in ("rest_length_dynamics", "string_force_density", "elastic_energy")
    ],
    # A CasADi function speaks for itself.
    refused("acceleration of transposed nodes",
            lambda: model().acceleration(nodes().T, STILL, gamma()), RuntimeError,
            r"acceleration(.|\n)*\(N\) has mismatching shape\. Got 6-by-3"),
]

COORDINATES = [
    refused("coordinates unknown", lambda: tc.dynamics.coordinates(model(), kind="modal"), ValueError,
            r"is 'modal', expected one of 'nodes', 'minimal', 'internal'"),
    refused("coordinates kind as nodes", lambda: tc.dynamics.coordinates(model(), "minimal"), TypeError,
            r"nodes .*'minimal'"),
    refused("coordinates transposed", lambda: tc.dynamics.coordinates(model(), nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("coordinates nan", lambda: tc.dynamics.coordinates(model(), with_entry(nodes(), (0, 0), NAN)),
            ValueError, r"nodes\[0, 0\] is nan"),
    refused("measure transposed", lambda: plant().coordinates.measure(nodes().T, STILL), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("measure velocities", lambda: plant().coordinates.measure(nodes(), STILL[:2]),
            ValueError, r"velocities has shape \(2, 6\), expected \(3, 6\)"),
    refused("measure nan",
            lambda: plant().coordinates.measure(nodes(), with_entry(STILL, (1, 1), NAN)),
            ValueError, r"velocities\[1, 1\] is nan"),
    refused("to_nodes of a whole state", lambda: plant().coordinates.to_nodes(np.zeros(18)),
            ValueError, r"q has shape \(18,\), expected \(9,\): one per internal coordinate"),
    refused("to_nodes nan", lambda: plant().coordinates.to_nodes(with_entry(np.zeros(9), 2, NAN)),
            ValueError, r"q\[2\] is nan"),
    refused("to_nodes too far", lambda: plant().coordinates.to_nodes(np.full(9, 10.0)), ValueError,
            r"q turns bar \d by a right angle or more"),
    refused("to_velocities q", lambda: plant().coordinates.to_velocities(np.zeros(8), np.zeros(9)),
            ValueError, r"q has shape \(8,\), expected \(9,\)"),
    refused("to_velocities rates",
            lambda: plant().coordinates.to_velocities(np.zeros(9), np.zeros((9, 1))), ValueError,
            r"rates has shape \(9, 1\), expected \(9,\)"),
]

# ---- analysis/ ----

LINEARIZE = [
    refused("linearize a structure", lambda: tc.linearize(prism(), rest()), TypeError,
            r"model is a Structure, expected Model"),
    refused("linearize swapped", lambda: tc.linearize(rest(), model()), TypeError,
            r"model is a Prestress, expected Model"),
    refused("linearize at force densities", lambda: tc.linearize(model(), gamma()), TypeError,
            r"at is a ndarray, expected .*prestress"),
    refused("linearize at nothing", lambda: tc.linearize(model(), None), TypeError,
            r"at is a NoneType"),
    refused("input unknown", lambda: tc.linearize(model(), rest(), input="tension"), ValueError,
            r"input is 'tension', expected one of 'force_density', 'rest_length'"),
    refused("linearize coordinates unknown",
            lambda: tc.linearize(model(), rest(), coordinates="modal"), ValueError,
            r"coordinates is 'modal', expected one of 'nodes', 'minimal', 'internal'"),
    refused("linearize keyword", lambda: tc.linearize(model(), rest(), inputs="force_density"),
            TypeError, r"argument 'inputs'"),
    refused("rest length without strings",
            lambda: tc.linearize(model(), rest(), input="rest_length"), ValueError,
            r"model has no string law.*strings=LinearStrings"),
    refused("strings too soft",
            lambda: tc.linearize(tc.Model(prism(), strings=tc.LinearStrings(20.0)), rest()),
            ValueError, r"force_density\[6\] is 30 N/m, expected less than the stiffness 20 N/m"),
    refused("not an equilibrium", lambda: tc.linearize(model(), point(force_density=np.ones(9))),
            ValueError, r"not an equilibrium: node \d is left with an unbalanced force of 0\.47 N"),
    refused("not an equilibrium for its load",
            lambda: tc.linearize(loaded(), point(external_force=with_entry(STILL, (2, 0), 1.0))),
            ValueError, r"not an equilibrium: node 0 is left"),
    refused("load without a load input",
            lambda: tc.linearize(model(), point(external_force=with_entry(STILL, (2, 0), 1.0))),
            ValueError, r"carries another load than the model: at node 0"),
    refused("structure of other bars", lambda: tc.linearize(tc.Model(tc.prism(sides=4)), rest()),
            ValueError, r"prestress and the model differ in their bars"),
    refused("structure of other masses",
            lambda: tc.linearize(tc.Model(tc.prism(bar_mass=2.0)), rest()), ValueError,
            r"prestress and the model differ in their bar_mass"),
    refused("structure of other bar lengths",
            lambda: tc.linearize(tc.Model(tc.prism(height=1.2)), rest()), ValueError,
            r"bar 0 has length 1\.39\d* m, expected 1\.54\d* m"),
    refused("point transposed", lambda: tc.linearize(model(), point(nodes=nodes().T)), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, [6n]\)"),
    refused("point of wrong bar lengths", lambda: tc.linearize(model(), point(nodes=1.1 * nodes())),
            ValueError,
            r"at\.nodes, bar 0 has length 1\.529\d* m, expected 1\.390\d* m.*restore_bar_lengths"),
    refused("point of too few force densities",
            lambda: tc.linearize(model(), point(force_density=gamma()[:8])), ValueError,
            r"force_density has shape \(8,\), expected \(9,\)"),
    refused("point of one force density", lambda: tc.linearize(model(), point(force_density=17.0)),
            ValueError, r"force_density has shape \(\), expected \((9|α),\)"),
    refused("point of a pushing string",
            lambda: tc.linearize(model(), point(force_density=with_entry(gamma(), 3, -1.0))),
            ValueError, r"force_density\[3\] is -1, .*can only pull"),
    refused("point of a nan",
            lambda: tc.linearize(model(), point(force_density=with_entry(gamma(), 3, NAN))),
            ValueError, r"force_density\[3\] is nan"),
    refused("point load transposed", lambda: tc.linearize(loaded(), point(external_force=STILL.T)),
            ValueError, r"external_force has shape \(6, 3\), expected \(3, [6n]\)"),
    refused("slack string at the kink",
            lambda: drifting(elastic(), force_density=with_entry(gamma(), 5, 0.0),
                             input="rest_length"),
            ValueError, r"string 5 has γ = 0 N/m, at the border between taut and slack"),
    refused("OperatingPoint keyword", lambda: point(velocities=STILL), TypeError,
            r"argument 'velocities'"),
]

PLANT = [
    refused("modes of a model", lambda: tc.modes(model()), TypeError,
            r"plant is a Model, .*Linear"),
    refused("modes of a matrix", lambda: tc.modes(np.eye(2)), TypeError, r"plant is a ndarray"),
    refused("controllability of a model", lambda: tc.controllability(model()), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("controllability of matrices", lambda: tc.controllability(np.eye(2), np.eye(2)),
            TypeError, r"takes 1 positional argument but 2 were given"),
    refused("in_coordinates unknown", lambda: tc.plant.in_coordinates(plant(), "modal"), ValueError,
            r"is 'modal', expected one of 'nodes', 'minimal', 'internal'"),
    refused("step zero", lambda: plant().discretize(0.0), ValueError, r"sample_time is 0\.0, .* s$"),
    refused("step negative", lambda: plant().discretize(-0.1), ValueError, r"sample_time is -0\.1"),
    refused("step nan", lambda: plant().discretize(NAN), ValueError, r"sample_time is nan"),
    refused("step text", lambda: plant().discretize("0.1"), TypeError, r"sample_time is '0\.1'"),
    refused("step none", lambda: plant().discretize(None), TypeError, r"sample_time is None"),
    refused("state space of a drifting plant",
            lambda: drifting(model(), force_density=np.ones(9)).to_statespace(), ValueError,
            r"plant drifts.*away from an equilibrium"),
    refused("plant measure transposed", lambda: plant().measure(nodes().T, STILL), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("plant to_nodes of a whole state", lambda: plant().to_nodes(np.zeros(18)), ValueError,
            r"q has shape \(18,\), expected \(9,\)"),
    refused("plant to_velocities rates", lambda: plant().to_velocities(np.zeros(9), np.zeros(8)),
            ValueError, r"rates has shape \(8,\), expected \(9,\)"),
]

# ---- actuation/ ----

ACTUATION = [
    refused("rate zero", lambda: tc.Winches(rate=0.0), ValueError, r"rate\[0\] is 0, .*m/s"),
    refused("rate negative", lambda: tc.Winches(rate=[1.0, -1.0]), ValueError, r"rate\[1\] is -1"),
    refused("rate nan winches", lambda: tc.Winches(rate=NAN), ValueError, r"rate is nan"),
    refused("rate inf", lambda: tc.Winches(rate=INF), ValueError, r"rate is inf"),
    refused("rate text", lambda: tc.Winches(rate="fast"), TypeError, r"rate .*'fast'"),
    refused("rate of two dimensions", lambda: tc.Winches(rate=np.ones((2, 2))), ValueError,
            r"rate has shape \(2, 2\)"),
    refused("shortest zero", lambda: tc.Winches(shortest=0.0), ValueError, r"shortest\[0\] is 0"),
    refused("longest nan", lambda: tc.Winches(longest=[1, NAN]), ValueError,
            r"longest\[1\] is nan"),
    refused("range crossed", lambda: tc.Winches(shortest=0.5, longest=0.2), ValueError,
            r"shortest 0\.5 m exceeds longest 0\.2 m"),
    refused("range of two counts", lambda: tc.Winches(shortest=[0.1, 0.5], longest=[1.0] * 3),
            ValueError, r"shortest.*\(2,\).*longest.*\(3,\)"),
    refused("substeps zero", lambda: tc.Winches(substeps=0), ValueError, r"substeps is 0, .*at least 1"),
    refused("substeps without end", lambda: tc.Winches(substeps=10**9), ValueError,
            r"substeps is 1000000000, .*at most 10000"),
    refused("substeps of a part", lambda: tc.Winches(substeps=2.5), TypeError, r"substeps is 2\.5"),
    refused("substeps text", lambda: tc.Winches(substeps="many"), TypeError, r"substeps is 'many'"),
    refused("Winches keyword", lambda: tc.Winches(speed=1.0), TypeError, r"argument 'speed'"),
    refused("move of two counts", lambda: tc.Winches().move([1.0, 1.0], [1.0], 0.1), ValueError,
            r"current has shape \(2,\) and wanted \(1,\)"),
    refused("move of numbers", lambda: tc.Winches().move(1.0, 1.0, 0.1), ValueError,
            r"current has shape \(\) and wanted \(\)"),
    refused("move nan", lambda: tc.Winches().move([1.0, 1.0], [1.0, NAN], 0.1), ValueError,
            r"wanted\[1\] is nan"),
    refused("move step", lambda: tc.Winches().move([1.0], [1.0], 0.0), ValueError, r"sample_time is 0\.0"),
    refused("move of another count",
            lambda: tc.Winches(rate=[1.0, 1.0]).move(np.ones(3), np.ones(3), 0.1), ValueError,
            r"rate has shape \(2,\), expected \(\) or \(3,\)"),
    refused("to_rest_length of a structure", lambda: tc.to_rest_length(prism(), nodes(), gamma()),
            TypeError, r"model is a Structure, expected Model"),
    refused("to_rest_length without strings", lambda: tc.to_rest_length(model(), nodes(), gamma()),
            ValueError, r"model has no string law"),
    refused("to_rest_length transposed", lambda: tc.to_rest_length(elastic(), nodes().T, gamma()),
            ValueError, r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("to_rest_length swapped", lambda: tc.to_rest_length(elastic(), gamma(), nodes()),
            ValueError, r"nodes has shape \(9,\), expected \(3, 6\)"),
    refused("to_rest_length too few", lambda: tc.to_rest_length(elastic(), nodes(), gamma()[:8]),
            ValueError, r"force_density \(8,\)"),
    refused("to_rest_length negative", lambda: tc.to_rest_length(elastic(), nodes(), -1.0),
            ValueError, r"force_density\[0\] is -1"),
    refused("to_rest_length too much", lambda: tc.to_rest_length(elastic(), nodes(), 120.0),
            ValueError, r"force_density\[0\] is 120 N/m, expected less than the stiffness 100 N/m"),
    refused("to_force_density without strings",
            lambda: tc.to_force_density(model(), nodes(), rest_length()), ValueError,
            r"model has no string law"),
    refused("to_force_density zero", lambda: tc.to_force_density(elastic(), nodes(), 0.0),
            ValueError, r"rest_length\[0\] is 0"),
    refused("to_force_density too few",
            lambda: tc.to_force_density(elastic(), nodes(), rest_length()[:8]), ValueError,
            r"rest_length \(8,\)"),
]

# ---- simulation/ ----

OPEN_LOOP = [
    refused("simulate a structure", lambda: run(model=prism()), TypeError,
            r"model is a Structure, expected Model"),
    refused("duration zero", lambda: run(duration=0.0), ValueError, r"duration is 0\.0, .* s$"),
    refused("duration nan", lambda: run(duration=NAN), ValueError, r"duration is nan"),
    refused("duration text", lambda: run(duration="1"), TypeError, r"duration is '1'"),
    refused("duration none", lambda: run(duration=None), TypeError, r"duration is None"),
    refused("nothing held", lambda: run(rest_length=None), ValueError,
            r"one of rest_length, force_density and controller; found neither"),
    refused("two things held", lambda: run(force_density=17.0), ValueError,
            r"one of rest_length, force_density and controller; found both"),
    refused("rest length held without strings", lambda: run(model=model()), ValueError,
            r"model has no string law"),
    refused("held rest_length negative", lambda: run(rest_length=-1.0), ValueError,
            r"rest_length\[0\] is -1"),
    refused("held rest_length zero", lambda: run(rest_length=with_entry(rest_length(), 4, 0.0)),
            ValueError, r"rest_length\[4\] is 0"),
    refused("held rest_length too few", lambda: run(rest_length=rest_length()[:8]), ValueError,
            r"rest_length has shape \(8,\), expected \(\) or \(9,\)"),
    refused("held rest_length nan", lambda: run(rest_length=with_entry(rest_length(), 4, NAN)),
            ValueError, r"rest_length\[4\] is nan"),
    refused("held rest_length the result, not its field",
            lambda: run(rest_length=tc.to_rest_length(elastic(), nodes(), gamma())), TypeError,
            r"rest_length .*RestLengths"),
    refused("held force_density negative", lambda: run(rest_length=None, force_density=-1.0),
            ValueError, r"force_density\[0\] is -1, .*can only pull"),
    refused("held force_density too few", lambda: run(rest_length=None, force_density=gamma()[:8]),
            ValueError, r"force_density has shape \(8,\), expected \(\) or \(9,\)"),
    refused("held force_density the result, not its field",
            lambda: run(rest_length=None, force_density=rest()), TypeError,
            r"force_density .*Prestress"),
    refused("start transposed", lambda: run(nodes=nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("start nan", lambda: run(nodes=with_entry(nodes(), (1, 4), NAN)), ValueError,
            r"nodes\[1, 4\] is nan"),
    refused("start of wrong bar lengths", lambda: run(nodes=1.1 * nodes()), ValueError,
            r"nodes, bar 0 has length 1\.529\d* m, expected 1\.390\d* m.*restore_bar_lengths"),
    refused("velocities transposed", lambda: run(velocities=STILL.T), ValueError,
            r"velocities has shape \(6, 3\), expected \(3, 6\)"),
    refused("velocities inf", lambda: run(velocities=with_entry(STILL, (2, 0), INF)), ValueError,
            r"velocities\[2, 0\] is inf"),
    refused("velocities stretch a bar", lambda: run(velocities=with_entry(STILL, (2, 0), 1.0)),
            ValueError, r"velocities stretch bar 0 at 0\.719 m/s"),
    refused("load for a model without", lambda: run(external_force=STILL), ValueError,
            r"model takes no load.*external_force=True"),
    refused("load missing", lambda: run(model=loaded(), rest_length=None, force_density=17.0),
            ValueError, r"model takes a load: give external_force, shape \(3, n\)"),
    refused("load transposed",
            lambda: run(model=loaded(), rest_length=None, force_density=1, external_force=STILL.T),
            ValueError, r"external_force has shape \(6, 3\), expected \(3, 6\)"),
    refused("method unknown", lambda: run(method="euler"), ValueError,
            r"method is 'euler', expected one of 'auto', 'rk4', 'rattle'"),
    refused("rk4 without step", lambda: run(method="rk4"), ValueError, r"'rk4' needs a step"),
    refused("dop853 with step", lambda: run(method="dop853", step=0.001), ValueError,
            r"step goes with the methods .*; 'dop853' chooses"),
    refused("simulation step zero", lambda: run(step=0.0), ValueError, r"step is 0\.0"),
    refused("simulation step text", lambda: run(step="1 ms"), TypeError, r"step is '1 ms'"),
    refused("tolerance zero", lambda: run(tolerance=0.0), ValueError, r"tolerance is 0\.0"),
    refused("tolerance nan", lambda: run(tolerance=NAN), ValueError, r"tolerance is nan"),
    refused("tolerance below round-off", lambda: run(tolerance=1e-16), ValueError,
            r"tolerance is 1e-16, expected at least 2\.2e-14"),
    refused("output_step negative", lambda: run(output_step=-1.0), ValueError,
            r"output_step is -1\.0"),
    refused("output_step text", lambda: run(output_step="1"), TypeError, r"output_step is '1'"),
    refused("hold in open loop", lambda: run(input="rest_length"), ValueError,
            r"input goes with a controller"),
    refused("winches in open loop", lambda: run(winches=tc.Winches()), ValueError,
            r"winches .*go with a controller"),
    refused("sample_time in open loop", lambda: run(sample_time=0.1), ValueError,
            r"sample_time go with a controller"),
    refused("simulate keyword", lambda: run(dt=0.1), TypeError, r"argument 'dt'"),
    refused("input by position", lambda: tc.simulate(elastic(), 1.0, None, None, rest_length()),
            TypeError, r"positional arguments"),
]

CLOSED_LOOP = [
    refused("controller and force_density", lambda: closed(force_density=17.0), ValueError,
            r"force_density is commanded by the controller"),
    refused("hold unknown", lambda: closed(input="tension"), ValueError,
            r"input is 'tension', expected one of 'rest_length', 'force_density'"),
    refused("hold rest lengths without strings", lambda: closed(model=model(), input="rest_length"),
            ValueError, r"model has no string law"),
    refused("hold force densities of a winch controller",
            lambda: closed(controller=winch_regulator(), input="force_density"), ValueError,
            r"controller commands rest lengths; input='force_density'"),
    refused("sample_time beside the controller's", lambda: closed(sample_time=0.1), ValueError,
            r"controller has a sample time of its own, 0\.001 s; leave sample_time out"),
    refused("sample_time missing", lambda: closed(controller=regulator(step=None)), ValueError,
            r"continuous time: give sample_time"),
    refused("sample_time negative",
            lambda: closed(controller=regulator(step=None), sample_time=-0.1), ValueError,
            r"sample_time is -0\.1"),
    refused("winches a number", lambda: closed(winches=0.5), TypeError,
            r"winches is a float, expected Winches"),
    refused("winches of unknown start", lambda: closed(winches=tc.Winches(rate=0.5)), ValueError,
            r"winches with a rate or substeps need rest_length"),
    refused("winches that wind from an unknown start",
            lambda: closed(winches=tc.Winches(substeps=5)), ValueError,
            r"winches with a rate or substeps need rest_length"),
    refused("winches of another count",
            lambda: closed(winches=tc.Winches(rate=[0.5] * 8), rest_length=rest_length()),
            ValueError, r"rate has shape \(8,\), expected \(\) or \(9,\)"),
    refused("winches where force densities are held",
            lambda: closed(winches=tc.Winches(), input="force_density"), ValueError,
            r"winches and rest_length have no meaning where γ is held"),
    refused("start of the winches too short", lambda: closed(rest_length=rest_length()[:8]),
            ValueError, r"rest_length has shape \(8,\), expected \(\) or \(9,\)"),
    refused("controller of another structure",
            lambda: closed(controller=pentagon_regulator(), sample_time=0.001), ValueError,
            r"designed on Structure\(10 nodes.*the model has Structure\(6 nodes"),
    refused("controller beyond the stiffness",
            lambda: closed(controller=regulator(max_force_density=200.0)), ValueError,
            r"γ = 200 N/m on string 0.*stiffness 100 N/m.*max_force_density below 100"),
]

CONTROL = [
    refused("lqr of a model", lambda: tc.lqr(model(), 1.0, 1.0), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("lqr Q too small", lambda: tc.lqr(plant(), np.eye(9), 1.0), ValueError,
            r"Q has shape \(9, 9\), expected \(\), \(18,\) or \(18, 18\)"),
    refused("lqr Q negative", lambda: tc.lqr(plant(), -1.0, 1.0), ValueError,
            r"Q has the eigenvalue -1, expected at least 0"),
    refused("lqr Q lopsided", lambda: tc.lqr(plant(), np.triu(np.ones((18, 18))), 1.0), ValueError,
            r"Q is not symmetric"),
    refused("lqr Q nan", lambda: tc.lqr(plant(), NAN, 1.0), ValueError, r"Q is nan"),
    refused("lqr R zero", lambda: tc.lqr(plant(), 1.0, 0.0), ValueError,
            r"R has the eigenvalue 0, expected positive"),
    refused("lqr R of states", lambda: tc.lqr(plant(), 1.0, np.eye(18)), ValueError,
            r"R has shape \(18, 18\), expected \(\), \(9,\) or \(9, 9\)"),
    refused("lqr step zero", lambda: tc.lqr(plant(), 1.0, 1.0, sample_time=0.0), ValueError,
            r"sample_time is 0\.0, expected a positive"),
    refused("lqr limit below the prestress",
            lambda: tc.lqr(plant(), 1.0, 1.0, max_force_density=20.0), ValueError,
            r"max_force_density\[6\] is 20 N/m, but string 6 has 30 N/m"),
    refused("lqr limit for rest lengths",
            lambda: tc.lqr(tc.linearize(elastic(), rest(), input="rest_length"), 1.0, 1.0,
                           max_force_density=50.0),
            ValueError, r"max_force_density limits plants with input='force_density'"),
    refused("lqr in nodes", lambda: tc.lqr(plant("nodes"), 1.0, 1.0), ValueError,
            r"18 of the 36 states .*coordinates='internal'"),
    refused("lqr without weight", lambda: tc.lqr(plant(), 0.0, 1.0), ValueError, r"weight in Q"),
    refused("energy_weights of a model", lambda: tc.energy_weights(model()), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("MPC of a model", lambda: tc.MPC(model(), horizon=5, sample_time=0.02, max_force_density=50.0), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("winches for force densities",
            lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, winches=tc.Winches(rate=1.0)),
            ValueError, r"winches limit rest lengths, but plant has input='force_density'"),
    refused("MPC in minimal", lambda: tc.MPC(plant("minimal"), horizon=5, sample_time=0.02, max_force_density=50.0), ValueError,
            r"12 of the 30 states .*coordinates='internal'"),
    refused("horizon zero", lambda: tc.MPC(plant(), horizon=0, sample_time=0.02, max_force_density=50.0), ValueError,
            r"horizon is 0, expected a whole number of at least 1"),
    refused("horizon without end", lambda: tc.MPC(plant(), horizon=10**9, sample_time=0.02, max_force_density=50.0), ValueError,
            r"horizon is 1000000000, expected a whole number of at most 10000"),
    refused("NMPC horizon without end", lambda: tc.NMPC(plant(), horizon=10**9, sample_time=0.02, max_force_density=50.0), ValueError,
            r"horizon is 1000000000, expected a whole number of at most 10000"),
    refused("dense program without end",
            lambda: tc.MPC(plant(), horizon=1000, sample_time=0.02, max_force_density=50.0, form="condensed"), ValueError,
            r"form is 'condensed', which is dense, for 9000 unknown inputs; .*form='sparse'"),
    refused("horizon half", lambda: tc.MPC(plant(), horizon=2.5, sample_time=0.02, max_force_density=50.0), TypeError,
            r"horizon is 2\.5, expected a whole number"),
    refused("MPC step negative", lambda: tc.MPC(plant(), horizon=5, sample_time=-0.02, max_force_density=50.0), ValueError,
            r"sample_time is -0\.02, expected a positive"),
    refused("MPC without limit", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=None), TypeError,
            r"max_force_density is None"),
    refused("MPC limit nan", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=NAN), ValueError,
            r"max_force_density is nan"),
    refused("MPC limit of eight", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=np.full(8, 50.0)), ValueError,
            r"max_force_density has shape \(8,\), expected \(\) or \(9,\)"),
    refused("MPC change negative", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, max_change=-1.0),
            ValueError, r"max_change\[0\] is -1, expected a positive"),
    refused("NMPC of a model", lambda: tc.NMPC(model(), horizon=5, sample_time=0.02, max_force_density=50.0), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("NMPC without limit", lambda: tc.NMPC(plant(), horizon=5, sample_time=0.02), TypeError,
            r"max_force_density is None"),
    refused("NMPC least force density nan",
            lambda: tc.NMPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, min_force_density=NAN), ValueError,
            r"min_force_density is nan"),
    refused("NMPC tension of eight",
            lambda: tc.NMPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, max_tension=np.full(8, 50.0)), ValueError,
            r"max_tension has shape \(8,\), expected \(\) or \(9,\)"),
    refused("NMPC penalty nan", lambda: tc.NMPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, string_penalty=NAN),
            ValueError, r"string_penalty is nan"),
    refused("NMPC load gain", lambda: tc.NMPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, load_gain=0.0), ValueError,
            r"load_gain is 0"),
    refused("NMPC machine code", lambda: tc.NMPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, machine_code="yes"),
            TypeError, r"machine_code"),
    refused("MPC form", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, form="dense"), ValueError,
            r"form is 'dense', expected one of 'auto', 'condensed', 'sparse'"),
    refused("MPC tolerance", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, tolerance=0.0), ValueError,
            r"tolerance is 0\.0"),
    refused("MPC iterations", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, max_iterations=0), ValueError,
            r"max_iterations is 0"),
    refused("MPC time limit zero", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, time_limit=0.0),
            ValueError, r"time_limit is 0\.0, expected a positive finite number in s"),
    refused("NMPC time limit nan", lambda: tc.NMPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, time_limit=NAN),
            ValueError, r"time_limit is nan"),
    refused("NMPC time limit text", lambda: tc.NMPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, time_limit="1 ms"),
            TypeError, r"time_limit is '1 ms'"),
    refused("lqr winches a number", lambda: tc.lqr(plant(), 1.0, 1.0, winches=0.5), TypeError,
            r"winches is a float, expected Winches"),
    refused("lqr winches for force densities",
            lambda: tc.lqr(plant(), 1.0, 1.0, winches=tc.Winches()), ValueError,
            r"winches limit rest lengths, but plant has input='force_density'"),
    refused("lqr change negative", lambda: tc.lqr(plant(), 1.0, 1.0, sample_time=0.1, max_change=-1.0),
            ValueError, r"max_change\[0\] is -1, expected a positive"),
    refused("lqr change of eight", lambda: tc.lqr(plant(), 1.0, 1.0, sample_time=0.1, max_change=np.ones(8)),
            ValueError, r"max_change has shape \(8,\), expected \(\) or \(9,\)"),
    refused("applied of eight", lambda: regulator().applied(np.ones(8)), ValueError,
            r"value has shape \(8,\), expected \(9,\): one per string"),
    refused("applied nan", lambda: regulator().applied(np.full(9, NAN)), ValueError,
            r"value\[0\] is nan"),
    refused("MPC unknown keyword", lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, horizont=3), TypeError,
            r"horizont"),
    refused("MPC reference transposed",
            lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0, reference=nodes().T), ValueError,
            r"reference has shape \(6, 3\), expected \(3, 6\)"),
    refused("MPC reference of other nodes",
            lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0,
                           reference=tc.Reference([0.0], np.ones((3, 4, 1)))),
            ValueError, r"reference\.nodes has shape \(3, 4, 1\), expected \(3, 6, 1\)"),
    refused("shape control of a model",
            lambda: tc.FeedbackLinearization(model(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("shape control without frequency", lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0),
            TypeError, r"frequency"),
    refused("shape control of rest lengths",
            lambda: tc.FeedbackLinearization(winch_regulator().plant, reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0),
            ValueError, r"plant has input='rest_length'.*input='force_density'"),
    refused("shape control in nodes",
            lambda: tc.FeedbackLinearization(plant("nodes"), reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0), ValueError,
            r"plant\.coordinates\.kind is 'nodes', expected one of 'internal', 'minimal'"),
    refused("shape control without limit",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=None, frequency=1.0), TypeError,
            r"max_force_density is None"),
    refused("shape control limit low",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=20.0, frequency=1.0), ValueError,
            r"max_force_density\[6\] is 20 N/m, but string 6 has 30"),
    refused("shape control step", lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.0, max_force_density=50.0, frequency=1.0),
            ValueError, r"sample_time is 0\.0, expected a positive"),
    refused("shape control frequency nan",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=NAN), ValueError,
            r"frequency is nan, expected a positive finite number in Hz"),
    refused("shape control damping",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0, damping=0.0),
            ValueError, r"damping is 0\.0"),
    refused("shape control too fast",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=10.0), ValueError,
            r"frequency 10 Hz .* the error would grow; expected a·sample_time < 2"),
    refused("shape control tracked",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0, tracked=np.eye(6)),
            ValueError, r"tracked has shape \(6, 6\), expected \(p, 18\)"),
    refused("shape control of nothing",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0,
                                    tracked=np.zeros((2, 18))),
            ValueError, r"tracked combinations are moved by no string"),
    refused("shape control change",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0, max_change=0.0),
            ValueError, r"max_change\[0\] is 0, expected a positive"),
    refused("shape control regularization",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0, regularization=0.0),
            ValueError, r"regularization is 0\.0"),
    refused("shape control reference",
            lambda: tc.FeedbackLinearization(plant(), reference=nodes().T, sample_time=0.02, max_force_density=50.0, frequency=1.0), ValueError,
            r"reference has shape \(6, 3\), expected \(3, 6\)"),
    refused("shape control error of nan",
            lambda: tc.FeedbackLinearization(plant(), reference=None, sample_time=0.02, max_force_density=50.0, frequency=1.0).error(
                NAN, nodes(), STILL),
            ValueError, r"time is nan"),
    refused("Reference force_density of other times",
            lambda: tc.Reference([0.0, 1.0], np.ones((3, 6, 2)), np.ones((9, 3))), ValueError,
            r"force_density has shape \(9, 3\), expected \(α, 2\)"),
    refused("Reference force_density negative",
            lambda: tc.Reference([0.0, 1.0], np.ones((3, 6, 2)), [[1.0, 1.0], [1.0, -1.0]]),
            ValueError, r"force_density\[1\]\[1\] is -1"),
    refused("Reference force_density nan",
            lambda: tc.Reference([0.0], np.ones((3, 6, 1)), np.full((9, 1), NAN)), ValueError,
            r"force_density.* nan"),
    refused("Reference force_density of other strings",
            lambda: mpc_on(tc.Reference([0.0], nodes()[:, :, None], np.ones((8, 1)))),
            ValueError, r"reference\.force_density has shape \(8, 1\), expected \(9, 1\)"),
    refused("then no reference", lambda: still_shape().then(1.0, pause=1.0), TypeError,
            r"other is a float, expected Reference"),
    refused("then without a pause", lambda: still_shape().then(still_shape(), pause=0.0),
            ValueError, r"pause is 0\.0"),
    refused("then other nodes",
            lambda: still_shape().then(tc.Reference([0.0], np.ones((3, 4, 1))), pause=1.0),
            ValueError, r"other\.nodes has the shape \(3, 4\) at each time, expected \(3, 6\)"),
    refused("then with force densities in one",
            lambda: still_shape().then(
                tc.Reference([0.0], nodes()[:, :, None], np.ones((9, 1))), 1.0),
            ValueError, r"other\.force_density has the shape \(9,\) .*, expected None"),
    refused("Schedule of none", lambda: tc.GainSchedule([]), ValueError, r"controllers is empty"),
    refused("Schedule of one controller alone", lambda: tc.GainSchedule(regulator()), TypeError,
            r"controllers is a LQR, expected a sequence"),
    refused("Schedule of numbers", lambda: tc.GainSchedule([1.0]), TypeError,
            r"controllers\[0\] is a float, expected Controller"),
    refused("Schedule of two sample times",
            lambda: tc.GainSchedule([regulator(), regulator(step=0.002)]), ValueError,
            r"controllers\[1\] has sample_time 0\.002, expected 0\.001"),
    refused("Schedule of two inputs", lambda: tc.GainSchedule([regulator(), winch_regulator()]),
            ValueError, r"controllers\[1\] has input 'rest_length', expected 'force_density'"),
    refused("Schedule of two structures",
            lambda: tc.GainSchedule([regulator(None), pentagon_regulator()]), ValueError,
            r"controllers\[1\] was designed on a structure with other bars"),
    refused("diagonals text", lambda: tc.prism(diagonals="yes"), TypeError, r"diagonals is 'yes'"),
    refused("plants of no count", lambda: short_path().plants(0, "rest_length"), ValueError,
            r"count is 0, expected .*at least 1"),
    refused("plants of an unknown input", lambda: short_path().plants(2, "length"), ValueError,
            r"input is 'length'"),
    refused("Reference times descend", lambda: tc.Reference([1.0, 0.0], np.ones((3, 6, 2))),
            ValueError, r"time\[1\] is 0 s after time\[0\] = 1 s"),
    refused("Reference of no time", lambda: tc.Reference([], np.ones((3, 6, 0))), ValueError,
            r"time has shape \(0,\)"),
    refused("Reference of one shape", lambda: tc.Reference([0.0, 1.0], nodes()), ValueError,
            r"nodes has shape \(3, 6\), expected \(3, n, 2\)"),
    refused("Reference nan", lambda: tc.Reference([0.0], np.full((3, 6, 1), NAN)), ValueError,
            r"nodes\[0, 0, 0\] is nan"),
    refused("measured transposed",
            lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0).command(0.0, nodes().T, STILL), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("measured text",
            lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0).command(0.0, "here", STILL), TypeError,
            r"nodes .*'here'"),
]

# fmt: on


@cache
def varied_loop():
    """A closed loop for sweeps."""
    return loop_case()


def loop_case(**changes):
    """The closed loop with some arguments replaced."""
    arguments = {
        "structure": prism(),
        "strings": elastic().strings,
        "controller": winch_regulator(),
        "duration": 0.1,
        "step": 0.001,
        "tolerance": 0.01,
    }
    return tc.ClosedLoopCase(**(arguments | changes))


def sweep(case=None, parameters=None, count=2, seed=0, **options):
    """A sweep, with some arguments replaced; refused before any worker is started."""
    case = varied_loop() if case is None else case
    return tc.sweep(case, {} if parameters is None else parameters, count, seed=seed, **options)


def lowered():
    """Nodes of a prism of 0.85 m with the same bars."""
    radius = tc.structure.prism_radius(prism().bar_length[0], 0.85)
    return tc.prism(radius=radius, height=0.85).nodes


def over_stiffness(at=None, stiffness=(1e2, 1e3), **changes):
    """A report over the stiffness, with some arguments replaced; refused before any run."""
    at = rest() if at is None else at
    return stiffness_report(at, stiffness, **({"sample_time": 0.02, "duration": 0.1} | changes))


# fmt: off
ROBUSTNESS = [
    refused("stiffness of a structure", lambda: over_stiffness(prism()), TypeError,
            r"at is a Structure, expected Prestress: make one by prestress"),
    refused("stiffness of segments",
            lambda: over_stiffness(tc.prestress(tc.subdivide(prism(), 2, 0.01), 17.3205)),
            ValueError, r"at is of a subdivided structure.*before subdivide"),
    refused("stiffness none", lambda: over_stiffness(stiffness=[]), ValueError,
            r"stiffness has shape \(0,\), expected \(K,\) with K at least 1"),
    refused("stiffness number", lambda: over_stiffness(stiffness=1e3), ValueError,
            r"stiffness has shape \(\)"),
    refused("stiffness nan", lambda: over_stiffness(stiffness=[1e2, NAN]), ValueError,
            r"stiffness\[1\] is nan"),
    refused("stiffness zero", lambda: over_stiffness(stiffness=[0.0, 1e2]), ValueError,
            r"stiffness\[0\] is 0, expected a positive stiffness in N/m"),
    refused("stiffness falling", lambda: over_stiffness(stiffness=[1e3, 1e2]), ValueError,
            r"stiffness\[1\] is 100 N/m after 1000 N/m, expected ascending"),
    refused("stiffness step", lambda: over_stiffness(sample_time=0.0), ValueError, r"sample_time is 0\.0"),
    refused("stiffness push", lambda: over_stiffness(push=NAN), ValueError, r"push is nan"),
    refused("stiffness duration", lambda: over_stiffness(duration=-1), ValueError,
            r"duration is -1"),
    refused("stiffness tolerance", lambda: over_stiffness(tolerance=0), ValueError,
            r"tolerance is 0"),
    refused("stiffness damping negative", lambda: over_stiffness(damping=-0.1), ValueError,
            r"damping is -0\.1 at 100 N/m, expected one number of at least 0"),
    refused("stiffness damping a string", lambda: over_stiffness(damping=lambda k: [1.0] * 9),
            ValueError, r"damping is of shape \(9,\) at 100 N/m"),
    refused("stiffness damping nan", lambda: over_stiffness(damping=lambda k: NAN), ValueError,
            r"damping is nan"),
    refused("stiffness damping text", lambda: over_stiffness(damping="some"), TypeError,
            r"damping .*'some'"),
    refused("stiffness reference nodes", lambda: over_stiffness(reference=nodes()), TypeError,
            r"reference is a ndarray, expected Reference: shape_path"),
    refused("stiffness reference of others",
            lambda: over_stiffness(reference=tc.Reference([0.0], np.zeros((3, 4, 1)))), ValueError,
            r"reference\.nodes has shape \(3, 4, 1\), expected \(3, 6\) at each time"),
    refused("stiffness reference bars",
            lambda: over_stiffness(reference=tc.Reference([0.0], 2 * nodes()[:, :, None])),
            ValueError, r"in reference\.nodes\[:, :, 0\], bar 0 has length"),
    refused("stiffness reference late",
            lambda: over_stiffness(reference=tc.Reference([0.1], nodes()[:, :, None])), ValueError,
            r"reference ends at 0\.1 s, expected by 0\.075 s"),
    refused("stiffness reference elsewhere",
            lambda: over_stiffness(reference=tc.Reference([0.0], lowered()[:, :, None])),
            ValueError, r"reference ends with a node 0\.\d+ m off the shape of at"),
    refused("stiffness integration step", lambda: over_stiffness(integration_step=-1.0),
            ValueError, r"integration_step is -1\.0"),
    refused("stiffness weights matrix", lambda: over_stiffness(weights=np.eye(18)), TypeError,
            r"weights is a ndarray, expected a function weights\(plant\) -> Q, R"),
    refused("stiffness weights one", lambda: over_stiffness(weights=lambda plant: 1.0), TypeError,
            r"weights returned a float, expected a pair Q, R"),
    refused("stiffness weights negative",
            lambda: over_stiffness(weights=lambda plant: (1.0, -1.0)), ValueError,
            r"R has the eigenvalue -1"),
    refused("stiffness horizon", lambda: over_stiffness(horizon=0), ValueError, r"horizon is 0"),
    refused("stiffness largest γ", lambda: over_stiffness(max_force_density=1.0), ValueError,
            r"max_force_density\[0\] is 1 N/m"),
    refused("stiffness winches", lambda: over_stiffness(winches=0.5), TypeError,
            r"winches is a float, expected Winches"),
    refused("stiffness winches too long",
            lambda: over_stiffness(winches=tc.Winches(shortest=5.0)), ValueError,
            r"range of the winches"),
    refused("stiffness progress", lambda: over_stiffness(progress="no"), TypeError,
            r"progress is 'no'"),
    refused("sweep without case", lambda: sweep(case=3), TypeError, r"case is a int, expected a"),
    refused("sweep of a lambda", lambda: sweep(case=lambda parameters, rng: None), TypeError,
            r"case cannot be pickled.*top of a module"),
    refused("sweep of a file handle", lambda: sweep(case=with_handle()), TypeError,
            r"case cannot be pickled"),
    refused("sweep parameters list", lambda: sweep(parameters=[tc.Uniform(0, 1)]), TypeError,
            r"parameters is a list, expected a dict"),
    refused("sweep parameter number", lambda: sweep(parameters={"mass": 1.0}), TypeError,
            r"parameters\['mass'\] is a float, expected Distribution: use Uniform"),
    refused("sweep parameter unnamed", lambda: sweep(parameters={3: tc.Uniform(0, 1)}), TypeError,
            r"parameters has the key 3, expected a name"),
    refused("sweep count zero", lambda: sweep(count=0), ValueError, r"count is 0"),
    refused("sweep count float", lambda: sweep(count=2.0), TypeError, r"count is 2\.0"),
    refused("sweep seed negative", lambda: sweep(seed=-1), ValueError, r"seed is -1"),
    refused("sweep seed none", lambda: sweep(seed=None), TypeError, r"seed is None"),
    refused("sweep executor text", lambda: sweep(executor="processes"), TypeError,
            r"executor is a str, expected Executor"),
    refused("sweep executor and processes",
            lambda: sweep(executor=ThreadPoolExecutor(1), processes=2), ValueError,
            r"processes goes without executor"),
    refused("sweep processes zero", lambda: sweep(processes=0), ValueError, r"processes is 0"),
    refused("sweep in_flight zero", lambda: sweep(in_flight=0), ValueError, r"in_flight is 0"),
    refused("sweep progress text", lambda: sweep(progress="no"), TypeError, r"progress is 'no'"),
    refused("sweep file number", lambda: sweep(file=3), TypeError, r"file is 3"),
    refused("sweep file folder", lambda: sweep(file="."), OSError, r"directory|denied"),
    refused("uniform nan", lambda: tc.Uniform(NAN, 1), ValueError, r"low is nan"),
    refused("uniform falling", lambda: tc.Uniform(1, 1), ValueError, r"low is 1 and high is 1"),
    refused("uniform vast", lambda: tc.Uniform(-1.7e308, 1.7e308), ValueError, r"too far apart"),
    refused("uniform array", lambda: tc.Uniform([0, 1], 2), ValueError, r"low has shape \(2,\)"),
    refused("uniform size", lambda: tc.Uniform(0, 1, size=0), ValueError, r"size is 0"),
    refused("normal deviation", lambda: tc.Normal(0, 0), ValueError, r"deviation is 0"),
    refused("normal mean text", lambda: tc.Normal("0", 1), TypeError, r"mean .*'0'"),
    refused("one of none", lambda: tc.OneOf([]), ValueError, r"values has shape \(0,\)"),
    refused("one of nan", lambda: tc.OneOf([1, NAN]), ValueError, r"values\[1\] is nan"),
    refused("outcome success number", lambda: tc.robustness.Outcome(success=1), TypeError, r"success is 1"),
    refused("outcome figure nan", lambda: tc.robustness.Outcome(True, {"e": NAN}), ValueError,
            r"figures\['e'\] is nan"),
    refused("outcome figure array", lambda: tc.robustness.Outcome(True, {"e": [1, 2]}), ValueError,
            r"figures\['e'\] has shape \(2,\)"),
    refused("outcome figures list", lambda: tc.robustness.Outcome(True, [1.0]), TypeError,
            r"figures is a list"),
    refused("outcome figure unnamed", lambda: tc.robustness.Outcome(True, {1: 1.0}), TypeError,
            r"figures has the key 1"),
    refused("loop case controller", lambda: loop_case(controller=plant()), TypeError,
            r"controller is a LinearPlant"),
    refused("loop case structure", lambda: loop_case(structure=nodes()), TypeError,
            r"structure is a ndarray"),
    refused("loop case strings", lambda: loop_case(strings=100.0), TypeError,
            r"strings is a float"),
    refused("loop case tolerance", lambda: loop_case(tolerance=0), ValueError, r"tolerance is 0"),
    refused("loop case duration", lambda: loop_case(duration=INF), ValueError, r"duration is inf"),
    refused("loop case sample time", lambda: loop_case(sample_time="1"), TypeError,
            r"sample_time is"),
    refused("loop case nodes", lambda: loop_case(nodes=nodes().T), ValueError,
            r"nodes has shape \(6, 3\)"),
    refused("loop case target nan", lambda: loop_case(target=with_entry(nodes(), (0, 0), NAN)),
            ValueError, r"target\[0, 0\] is nan"),
    refused("loop case gravity", lambda: loop_case(gravity=[1.0, 2.0]), ValueError, r"gravity"),
    refused("loop case estimator", lambda: loop_case(estimator=3), TypeError,
            r"estimator is a int, expected KalmanFilter"),
    refused("loop case sensors", lambda: loop_case(estimator=estimator(), sensors=3), TypeError,
            r"sensors is a int, expected Sensors"),
    refused("loop case sensors alone", lambda: loop_case(sensors=lengths()), ValueError,
            r"sensors go with an estimator"),
    refused("loop case faults", lambda: loop_case(faults=[3]), TypeError,
            r"faults\[0\] is a int, expected Fault"),
    refused("loop case fault of no string",
            lambda: loop_case(faults=[tc.CutString(string=9, time=0.0)]), ValueError, r"9"),
    refused("loop case winches", lambda: loop_case(winches=0.5), TypeError, r"winches is a float"),
    refused("report file absent", lambda: tc.robustness.SweepReport.load("nowhere.jsonl"), FileNotFoundError,
            r"nowhere"),
]
# fmt: on


def with_handle():
    """A case that holds what cannot be sent to another process."""
    return partial(print, file=sys.stdout)


CASES = [
    *STRUCTURE,
    *PRISM,
    *STATICS,
    *STRINGS,
    *MODEL,
    *COORDINATES,
    *LINEARIZE,
    *PLANT,
    *ACTUATION,
    *OPEN_LOOP,
    *CLOSED_LOOP,
    *CONTROL,
    *ROBUSTNESS,
]


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    with pytest.raises(exception, match=message) as raised:
        call()
    # A ValueError by inheritance only: nobody checked, and NumPy fell over.
    assert not isinstance(raised.value, np.linalg.LinAlgError)


# ---- found in review: each of these got through, or fell over without naming the culprit ----


class Stubborn(tc.control.Controller):
    """A controller of a user's own, which commands the same whatever happens."""

    def __init__(self, value, plant_of_its_own=None):
        designed_on = plant() if plant_of_its_own is None else plant_of_its_own
        super().__init__(designed_on, 0.001, np.zeros(9), np.full(9, 50.0))
        self.value = value

    def command(self, time, nodes, velocities):
        return tc.control.Command(self.value, "ok")

    def reset(self):
        pass

    def _decide(self, time, state):
        return tc.control.Command(self.value)

    def _fall_back(self, status):
        return tc.control.Command(self.value, status)


# fmt: off
NOT_AN_ARRAY = [
    refused("nodes none", lambda: line(nodes=None), TypeError, r"nodes is None"),
    refused("bars none", lambda: line(bars=None), TypeError, r"bars is None"),
    refused("bar_mass none", lambda: line(bar_mass=None), TypeError, r"bar_mass is None"),
    refused("bar_mass one none", lambda: tc.prism(bar_mass=[1, None, 1]), TypeError,
            r"bar_mass.*None"),
    refused("stiffness none", lambda: tc.LinearStrings(None), TypeError, r"stiffness is None"),
    refused("damping none", lambda: tc.LinearStrings(1.0, damping=None), TypeError,
            r"damping is None"),
    refused("q none", lambda: plant().coordinates.to_nodes(None), TypeError, r"q is None"),
    refused("current none", lambda: tc.Winches().move(None, [1.0], 0.1), TypeError,
            r"current is None"),
    refused("to_rest_length force_density none",
            lambda: tc.to_rest_length(elastic(), nodes(), None), TypeError,
            r"force_density is None"),
    refused("to_rest_length nodes none", lambda: tc.to_rest_length(elastic(), None, gamma()),
            TypeError, r"nodes is None"),
    refused("to_force_density nodes none",
            lambda: tc.to_force_density(elastic(), None, rest_length()), TypeError,
            r"nodes is None"),
    refused("nodes complex", lambda: line(nodes=line_nodes() + 0j), TypeError, r"nodes.*complex"),
    refused("bars complex", lambda: line(bars=np.array([[1, 2 + 0j]])), TypeError,
            r"bars.*complex"),
    refused("bar_mass complex of NumPy", lambda: line(bar_mass=np.complex128(1 + 1j)), TypeError,
            r"bar_mass.*complex"),
    refused("prestress force_density complex", lambda: tc.prestress(prism(), gamma() + 0j),
            TypeError, r"force_density.*complex"),
    refused("held force_density complex", lambda: run(rest_length=None, force_density=gamma() + 1j),
            TypeError, r"force_density.*complex"),
    refused("bar_mass digits", lambda: line(bar_mass="1.0"), TypeError, r"bar_mass.*1\.0"),
    refused("bars digits", lambda: line(bars=[["1", "2"]]), TypeError, r"bars.*(str|text|'1')"),
    refused("stiffness digits", lambda: tc.LinearStrings("100"), TypeError, r"stiffness.*100"),
    refused("bar_mass bool", lambda: line(bar_mass=True), TypeError, r"bar_mass.*(True|bool)"),
    refused("bars bool", lambda: line(bars=[[True, False]], strings=[[0, 2], [2, 3]]), TypeError,
            r"bars.*(True|bool)"),
    refused("nodes dates", lambda: line(nodes=line_nodes().astype("datetime64[s]")), TypeError,
            r"nodes.*datetime"),
    refused("nodes masked", lambda: line(nodes=np.ma.masked_equal(line_nodes(), 3.0)),
            (TypeError, ValueError), r"nodes.*mask"),
    refused("force_density ragged", lambda: tc.prestress(prism(), [[1.0], [1.0, 2.0]]), TypeError,
            r"force_density .*(inhomogeneous|ragged|lengths)"),
    refused("string_groups one number", lambda: line(string_groups=3), TypeError, r"string_groups"),
]

NOT_THE_CLASS = [
    refused("restore_bar_lengths of a model", lambda: tc.structure.restore_bar_lengths(model(), nodes()),
            TypeError, r"structure is a Model, expected Structure"),
    refused("equilibrium_matrix of nodes", lambda: tc.statics.equilibrium_matrix(nodes()), TypeError,
            r"structure is a ndarray, expected Structure"),
    refused("stress_matrix of a model", lambda: tc.statics.stress_matrix(model(), np.ones(9), np.ones(3)),
            TypeError, r"structure is a Model, expected Structure"),
    refused("coordinates of a structure", lambda: tc.dynamics.coordinates(prism()), TypeError,
            r"model is a Structure, expected Model"),
    refused("in_coordinates of a model", lambda: tc.plant.in_coordinates(model(), "minimal"), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("controller a plant", lambda: closed(controller=plant()), TypeError,
            r"controller is a LinearPlant, expected Controller"),
    refused("controller a function",
            lambda: closed(controller=lambda time, nodes, velocities: gamma(), sample_time=0.001),
            TypeError, r"controller is a function, expected Controller"),
    refused("require_equilibrium text",
            lambda: tc.linearize(model(), rest(), require_equilibrium="no"), TypeError,
            r"require_equilibrium is .*(str|'no')"),
    refused("progress text", lambda: run(progress="no"), TypeError, r"progress is .*(str|'no')"),
]

NOT_THE_SHAPE = [
    refused("bars of no columns",
            lambda: tc.Structure(nodes(), np.zeros((3, 0)), prism().strings, 1.0, 0.1), ValueError,
            r"bars has shape \(3, 0\), expected \(count, 2\)"),
    refused("bar_vectors transposed", lambda: prism().bar_vectors(nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("string_vectors of four rows", lambda: prism().string_vectors(np.zeros((4, 6))),
            ValueError, r"nodes has shape \(4, 6\), expected \(3, 6\)"),
    refused("stress_matrix too few", lambda: tc.statics.stress_matrix(prism(), np.ones(8), np.ones(3)),
            ValueError, r"^force_density has shape \(8,\), expected \(9,\)"),
    refused("stress_matrix swapped", lambda: tc.statics.stress_matrix(prism(), np.ones(3), np.ones(9)),
            ValueError, r"^force_density has shape \(3,\), expected \(9,\)"),
    refused("stress_matrix nan", lambda: tc.statics.stress_matrix(prism(), np.full(9, NAN), np.ones(3)),
            ValueError, r"^force_density\[0\] is nan"),
    refused("project a shape", lambda: plant().coordinates.project(nodes()), ValueError,
            r"displacements has shape \(3, 6\)"),
    refused("project nan", lambda: plant().coordinates.project(np.full(18, NAN)), ValueError,
            r"displacements\[0\] is nan"),
    refused("to_velocities q in nodes",
            lambda: plant("nodes").coordinates.to_velocities(np.zeros(3), np.zeros(18)), ValueError,
            r"q has shape \(3,\), expected \(18,\)"),
    refused("stiffness and damping of two counts",
            lambda: tc.LinearStrings([1.0, 2.0], damping=[1.0, 2.0, 3.0]), ValueError,
            r"stiffness.*\(2,\).*damping.*\(3,\)"),
    refused("stiffness of no strings", lambda: tc.LinearStrings([]), ValueError, r"stiffness"),
    refused("length of no strings", lambda: tc.LinearStrings(100.0).force_density([], 1.0),
            ValueError, r"length.*\(0,\)"),
    refused("rate of no strings", lambda: tc.Winches(rate=[]), ValueError, r"rate.*\(0,\)"),
    refused("rate and range of two counts", lambda: tc.Winches(rate=[1.0] * 3, shortest=[0.1, 0.5]),
            ValueError, r"rate.*\(3,\).*shortest.*\(2,\)"),
    refused("range of one and two", lambda: tc.Winches(shortest=[0.1, 0.5], longest=[1.0]),
            ValueError, r"shortest.*\(2,\).*longest.*\(1,\)"),
    refused("OperatingPoint transposed", lambda: tc.OperatingPoint(nodes().T, gamma()), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, n\)"),
    refused("OperatingPoint text", lambda: tc.OperatingPoint("here", gamma()), TypeError,
            r"nodes .*'here'"),
]

NOT_THE_VALUE = [
    refused("bars index beyond integers", lambda: line(bars=[[1, 1e30]]), (TypeError, ValueError),
            r"bars\[0\].*1e\+30"),
    refused("height beyond numbers", lambda: tc.prism(height=10**400), (TypeError, ValueError),
            r"height"),
    refused("height whose square overflows", lambda: tc.prism(height=1e200), ValueError,
            r"(height|bars\[0\]|nodes).*1e\+200|bars\[0\].*length"),
    refused("reference empty", lambda: tc.prestress(prism(), 17.0, reference=""), ValueError,
            r"no string group ''"),
    refused("state_equation unknown", lambda: elastic().state_equation("tension"), ValueError,
            r"input is 'tension', expected one of 'force_density', 'rest_length'"),
    refused("kind by its name", lambda: tc.dynamics.coordinates(model(), kind="modal"), ValueError,
            r"^kind is 'modal'"),
    refused("coordinates of wrong bar lengths", lambda: tc.dynamics.coordinates(model(), 1.1 * nodes()),
            ValueError, r"nodes, bar 0 has length 1\.529\d* m, expected 1\.390\d* m"),
    refused("coordinates collapsed", lambda: tc.dynamics.coordinates(model(), STILL), ValueError,
            r"nodes, bar 0 has length 0 m, expected 1\.390\d* m"),
    refused("modes of no coordinates",
            lambda: tc.modes(drifting(tc.Model(lone_bar()), lone_bar().nodes, [])),
            ValueError, r"plant.*no.*coordinates"),
    refused("move from a negative length", lambda: tc.Winches().move([-1.0], [1.0], 0.1),
            ValueError, r"current\[0\] is -1"),
    refused("move to a negative length", lambda: tc.Winches().move([1.0], [-2.0], 0.1), ValueError,
            r"wanted\[0\] is -2"),
    refused("rest length of a string of no length",
            lambda: tc.to_rest_length(touching(), touching().structure.nodes, 1.0), ValueError,
            r"string(s\[1\]| 1) "),
    refused("linearize with a string of no length",
            lambda: drifting(touching(), touching().structure.nodes, [1.0, 1.0],
                             input="rest_length"),
            ValueError, r"string(s\[1\]| 1) "),
    refused("simulate a string of no length",
            lambda: tc.simulate(touching(), 0.01, rest_length=0.5, step=1e-3),
            ValueError, r"string(s\[1\]| 1) "),
    refused("tolerance unused but negative", lambda: run(step=0.001, tolerance=-1.0), ValueError,
            r"tolerance is -1\.0"),
    refused("tolerance unused but text", lambda: run(step=0.001, tolerance="fine"), TypeError,
            r"tolerance is 'fine'"),
    refused("output_step of too many states", lambda: run(output_step=1e-18), ValueError,
            r"output_step is 1e-18"),
    refused("step of too many states", lambda: run(step=1e-18), ValueError, r"step is 1e-18"),
]

NOT_A_COMMAND = [
    refused("command of another count", lambda: closed(controller=Stubborn(np.ones(8))),
            ValueError, r"command.*shape \(8,\), expected \(9,\)"),
    refused("command for one string", lambda: closed(controller=Stubborn(np.ones(1))),
            ValueError, r"command.*shape \(1,\), expected \(9,\)"),
    refused("command nan", lambda: closed(controller=Stubborn(np.full(9, NAN)), model=model()),
            ValueError, r"command.*\[0\] is nan"),
    refused("command of pushing strings",
            lambda: closed(controller=Stubborn(-np.ones(9)), model=model()),
            ValueError, r"command.*\[0\] is -1"),
    refused("command of negative rest lengths",
            lambda: closed(controller=Stubborn(-np.ones(9), winch_regulator().plant)),
            ValueError, r"command.*\[0\] is -1"),
]
# fmt: on

# fmt: off
ESTIMATION = [
    refused("Sensors of nothing", lambda: tc.Sensors(structure=prism()), ValueError,
            r"nothing is measured.*node_position"),
    refused("Sensors of no structure", lambda: lengths(structure=3), TypeError,
            r"structure is a int, expected Structure"),
    refused("Sensors without a bar",
            lambda: tc.Sensors(structure=prism(), bar_direction=np.zeros(0)),
            ValueError, r"bar_direction has shape \(0,\), expected \(\) or \(3,\)"),
    refused("Sensors without noise", lambda: lengths(string_length=0.0), ValueError,
            r"string_length\[0\] is 0, expected a positive standard deviation, m"),
    refused("Sensors with noise nan", lambda: lengths(node_position=NAN), ValueError,
            r"node_position is nan"),
    refused("Sensors with noise of another count", lambda: lengths(string_length=(1.0, 2.0)),
            ValueError, r"string_length has shape \(2,\), expected \(\) or \(9,\)"),
    refused("Sensors with noise of too many nodes",
            lambda: lengths(node_position=(1.0, 2.0), nodes=(0,)), ValueError,
            r"node_position has shape \(2,\), expected \(\) or \(1,\)"),
    refused("Sensors of nodes without noise", lambda: lengths(nodes=(0,)), ValueError,
            r"nodes is given, but node_position is not"),
    refused("Sensors of a string that is not", lambda: lengths(strings=(0, 9)), ValueError,
            r"strings names 9, expected 0 to 8"),
    refused("Sensors of a string twice", lambda: lengths(strings=(1, 1)), ValueError,
            r"strings is \[1, 1\], expected each index once"),
    refused("Sensors of a negative string", lambda: lengths(strings=(-1,)), ValueError,
            r"strings\[0\] is -1"),
    refused("Sensors of half a string", lambda: lengths(strings=(0.5,)), TypeError,
            r"strings\[0\] is 0\.5"),
    refused("Sensors of strings by one number", lambda: lengths(strings=3), ValueError,
            r"strings is 3, expected a sequence"),
    refused("Sensors of strings by name", lambda: lengths(strings="top"), ValueError,
            r"strings is 'top', expected a sequence"),
    refused("Sensors of no strings chosen", lambda: lengths(strings=()), ValueError,
            r"strings is \(\), expected a sequence"),
    refused("delay negative", lambda: lengths(delay=-1), ValueError, r"delay is -1"),
    refused("delay half a sample", lambda: lengths(delay=0.5), TypeError, r"delay is 0\.5"),
    refused("drop_rate one", lambda: lengths(drop_rate=1.0), ValueError,
            r"drop_rate is 1\.0, expected a probability of at least 0 and below 1"),
    refused("drop_rate nan", lambda: lengths(drop_rate=NAN), ValueError, r"drop_rate is nan"),
    refused("outlier_rate negative", lambda: lengths(outlier_rate=-0.1), ValueError,
            r"outlier_rate is -0\.1"),
    refused("outlier_rate text", lambda: lengths(outlier_rate="few"), TypeError,
            r"outlier_rate .*'few'"),
    refused("Sensors keyword", lambda: lengths(noise=1.0), TypeError, r"'noise'"),
    refused("Sensors by position", lambda: tc.Sensors(prism(), 0.001), TypeError, r"positional"),
    refused("measure transposed", lambda: lengths().measure(nodes().T), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("measure nan", lambda: lengths().measure(with_entry(nodes(), (0, 0), NAN)), ValueError,
            r"nodes\[0, 0\] is nan"),
    refused("measure a bar of no length",
            lambda: lengths(bar_direction=1.0).measure(np.zeros((3, 6))), ValueError,
            r"nodes: bar 0 .*no length"),
    refused("measure tensions of another count",
            lambda: lengths(string_tension=1.0).measure(nodes(), np.ones(8)), ValueError,
            r"tension has shape \(8,\), expected \(9,\)"),
    refused("disturb by a seed", lambda: lengths().disturb(np.zeros(9), 3), TypeError,
            r"generator is a int, expected Generator"),
    refused("disturb readings of another count",
            lambda: lengths().disturb(np.zeros(8), np.random.default_rng()), ValueError,
            r"exact has shape \(8,\), expected \(9,\)"),
    refused("count_of bolts", lambda: lengths().count_of("bolts"), ValueError,
            r"chooser is 'bolts'"),
    refused("kalman of no plant", lambda: kalman(plant=3), TypeError, r"plant is a int"),
    refused("kalman of no sensors", lambda: kalman(sensors=3), TypeError, r"sensors is a int"),
    refused("kalman of nodes", lambda: kalman(plant=plant("nodes")), ValueError,
            r"plant has 'nodes' coordinates.*'internal' or 'minimal'"),
    refused("kalman with sensors of another structure",
            lambda: kalman(sensors=tc.Sensors(structure=tc.prism(4), string_length=1e-3)),
            ValueError, r"sensors are those of .*8 nodes"),
    refused("kalman step zero", lambda: kalman(sample_time=0), ValueError, r"sample_time is 0, .* s"),
    refused("kalman step text", lambda: kalman(sample_time="fast"), TypeError, r"sample_time is 'fast'"),
    refused("process_noise zero", lambda: kalman(process_noise=0.0), ValueError,
            r"process_noise is 0\.0"),
    refused("process_noise nan", lambda: kalman(process_noise=NAN), ValueError,
            r"process_noise is nan"),
    refused("start_spread negative", lambda: kalman(start_spread=-1.0), ValueError,
            r"start_spread is -1\.0"),
    refused("start transposed", lambda: kalman(start=nodes().T), ValueError,
            r"start has shape \(6, 3\), expected \(3, 6\)"),
    refused("start with longer bars", lambda: kalman(start=1.1 * nodes()), ValueError,
            r"in start, bar 0 has length 1\.529"),
    refused("start out of reach", lambda: kalman(start=flipped()), ValueError,
            r"start is .*0\.\d+ m off: it is out of reach"),
    refused("gate one", lambda: kalman(gate=1.0), ValueError, r"gate is 1, expected a probability"),
    refused("gate zero", lambda: kalman(gate=0.0), ValueError, r"gate is 0\.0"),
    refused("patience zero", lambda: kalman(patience=0), ValueError, r"patience is 0"),
    refused("patience text", lambda: kalman(patience="long"), TypeError, r"patience is 'long'"),
    refused("prediction unknown", lambda: kalman(prediction="magic"), ValueError,
            r"prediction is 'magic', expected one of 'linear', 'nonlinear'"),
    refused("kalman without prestress",
            lambda: kalman(plant=drifting(model(), force_density=np.zeros(9)),
                           sensors=lengths(node_position=1e-3)),
            ValueError, r"no string of the plant pulls"),
    refused("kalman load text", lambda: kalman(load="yes"), TypeError, r"load is 'yes'"),
    refused("load_noise zero", lambda: kalman(load_noise=0.0), ValueError, r"load_noise is 0"),
    refused("load_noise nan", lambda: kalman(load_noise=NAN), ValueError, r"load_noise is nan"),
    refused("load that is not seen", lambda: kalman(load=True), ValueError,
            r"load: 1 of the 9 ways to shift .*Measure in addition node_position of all nodes"),
    refused("kalman keyword", lambda: kalman(noise=1.0), TypeError, r"'noise'"),
    refused("update of another count", lambda: estimator().update(np.ones(8)), ValueError,
            r"measurement has shape \(8,\), expected \(9,\): one entry per number read"),
    refused("update by text", lambda: estimator().update("nine"), TypeError,
            r"measurement .*'nine'"),
    refused("reset to bad rest lengths", lambda: estimator().reset(held=np.full(9, NAN)),
            ValueError, r"held\[0\] is nan"),
    refused("predict nan", lambda: estimator().predict(np.full(9, NAN)), ValueError,
            r"held\[0\] is nan"),
    refused("predict of another count", lambda: estimator().predict(np.ones(8)), ValueError,
            r"held has shape \(8,\), expected \(9,\)"),
    refused("reset to another count", lambda: estimator().reset(np.ones(9)), ValueError,
            r"state has shape \(9,\), expected \(18,\)"),
    refused("reset out of reach", lambda: estimator().reset(10 * np.ones(18)), ValueError,
            r"q turns bar \d by a right angle"),
    refused("reset to no covariance", lambda: estimator().reset(covariance=-np.eye(18)), ValueError,
            r"covariance has the eigenvalue -1, expected at least 0"),
    refused("reset to a crooked covariance",
            lambda: estimator().reset(covariance=np.triu(np.ones((18, 18)))), ValueError,
            r"covariance is not symmetric"),
    refused("simulate with no estimator", lambda: closed(estimator=3), TypeError,
            r"estimator is a int, expected KalmanFilter"),
    refused("simulate with no sensors", lambda: closed(estimator=estimator(), sensors=3), TypeError,
            r"sensors is a int, expected Sensors"),
    refused("sensors without an estimator", lambda: closed(sensors=lengths()), ValueError,
            r"sensors and seed go with an estimator"),
    refused("seed without an estimator", lambda: closed(seed=1), ValueError,
            r"sensors and seed go with an estimator"),
    refused("seed negative", lambda: closed(estimator=estimator(), seed=-1), ValueError,
            r"seed is -1"),
    refused("seed text", lambda: closed(estimator=estimator(), seed="luck"), TypeError,
            r"seed is 'luck'"),
    refused("estimator without a controller", lambda: run(estimator=estimator()), ValueError,
            r"estimator, winches and sample_time go with a controller"),
    refused("estimator of another sample time", lambda: closed(estimator=estimator(0.002)),
            ValueError, r"estimator has the sample time 0\.002 s, expected .* 0\.001 s"),
    refused("estimator that is told something else",
            lambda: closed(estimator=tc.kalman(plant(), lengths(), sample_time=0.001)), ValueError,
            r"estimator knows the effect of force_density, but the actuators hold rest_length"),
    refused("sensors of other readings",
            lambda: closed(estimator=estimator(), sensors=lengths(strings=(0, 1))), ValueError,
            r"sensors has the readings .*2 readings.*but estimator expects .*9 readings"),
    refused("plot.estimate of no run", lambda: tc.plot.estimate(3), TypeError, r"run is a int"),
    refused("plot.estimate of an open loop", lambda: tc.plot.estimate(run()), ValueError,
            r"run has no estimate"),
    refused("plot.estimate of a string that is not",
            lambda: tc.plot.estimate(closed(estimator=estimator()), strings=(9,)), ValueError,
            r"strings names 9, expected 0 to 8"),
    refused("plot.estimate of no strings",
            lambda: tc.plot.estimate(closed(estimator=estimator()), strings=()), ValueError,
            r"strings is empty, expected at least one index"),
    refused("plot.estimate of strings by name",
            lambda: tc.plot.estimate(closed(estimator=estimator()), strings="top"), TypeError,
            r"strings is 'top', expected a sequence"),
]
# fmt: on

FOUND_IN_REVIEW = [
    *ESTIMATION,
    *NOT_AN_ARRAY,
    *NOT_THE_CLASS,
    *NOT_THE_SHAPE,
    *NOT_THE_VALUE,
    *NOT_A_COMMAND,
]


@pytest.mark.parametrize(("call", "exception", "message"), FOUND_IN_REVIEW)
def test_bad_input_found_in_review_is_refused_by_name(call, exception, message):
    with pytest.raises(exception, match=message) as raised:
        call()
    assert not isinstance(raised.value, np.linalg.LinAlgError)


# Good input that was refused, or fell over.


def test_a_number_may_be_an_array_without_dimension():
    strings = tc.LinearStrings(stiffness=100.0)
    wanted = strings.force_density(length=1.0, rest_length=0.8)  # array(20.)
    assert tc.prestress(prism(), wanted).force_density[0] == pytest.approx(20.0)


def test_controllability_of_a_plant_whose_poles_are_all_real():
    result = tc.controllability(drifting(model(), force_density=np.zeros(9)))
    np.testing.assert_array_equal(result.pole, [0.0])
    # The strings change no length, and so do no work, along the mechanism of the prism.
    assert result.unreachable == 2


# Never stops while the defect is there, so it runs in a process of its own.

ENDLESS = {
    "forces overflow at the start": """
import tenscontrol as tc
tc.simulate(tc.Model(tc.prism()), 1.0, force_density=1e308)
""",
    "string of no length": """
import tenscontrol as tc
line = tc.Structure(nodes=[[0, 1, 2, 2], [0] * 4, [0] * 4], bars=[[1, 2]],
                    strings=[[0, 1], [2, 3]], bar_mass=1.0, string_node_mass=0.1)
tc.simulate(tc.Model(line, strings=tc.LinearStrings(100.0)), 0.01, rest_length=0.5)
""",
}


@pytest.mark.parametrize("program", ENDLESS.values(), ids=ENDLESS.keys())
def test_a_motion_that_cannot_start_is_refused_and_not_waited_for(program):
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert "Error" in done.stderr.splitlines()[-1]
