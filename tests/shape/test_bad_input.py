"""What shapes and paths refuse, and what the refusal says."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.shape import (
    Height,
    NodesAt,
    PointAt,
    RotationalSymmetry,
    Twist,
    shape_path,
    shape_target,
)

TOP, BOTTOM = [0, 1, 2], [3, 4, 5]
NAN = float("nan")


def refused(name, call, exception, message):
    """One case of the table."""
    return pytest.param(call, exception, message, id=name)


def prism_model(**changes):
    return tc.Model(tc.prism(), **({"strings": tc.LinearStrings(100.0)} | changes))


def target(*demands, **changes):
    return shape_target(prism_model(), demands, **({"force_density": 10.0} | changes))


def rest(level=10.0):
    return tc.prestress(tc.prism(), force_density=level)


def lower():
    nodes = tc.prism(
        radius=tc.structure.prism_radius(tc.prism().bar_length[0], 0.9), height=0.9
    ).nodes
    prism = tc.prism()
    structure = tc.Structure(
        nodes, prism.bars, prism.strings, 1.0, string_groups=prism.string_groups
    )
    return tc.prestress(structure, force_density=10.0)


def path(start=None, goal=None, model=None, **changes):
    arguments = {"duration": 1.0} | changes
    return shape_path(model or prism_model(), start or rest(), goal or lower(), **arguments)


DEMANDS = [
    refused("nodes empty", lambda: NodesAt([], np.zeros((3, 0))), ValueError, r"nodes .*\(k,\)"),
    refused("nodes twice", lambda: NodesAt([1, 1], np.zeros((3, 2))), ValueError, "node 1 twice"),
    refused(
        "nodes negative", lambda: NodesAt([-1], np.zeros((3, 1))), ValueError, r"nodes\[0\] is -1"
    ),
    refused(
        "nodes fraction", lambda: NodesAt([0.5], np.zeros((3, 1))), TypeError, r"nodes\[0\] is 0\.5"
    ),
    refused(
        "positions shape",
        lambda: NodesAt([0, 1], np.zeros((4, 2))),
        ValueError,
        r"positions has shape \(4, 2\), expected \(3, 2\)",
    ),
    refused(
        "positions nan",
        lambda: NodesAt([0], [[NAN], [0], [0]]),
        ValueError,
        r"positions\[0, 0\] is nan",
    ),
    refused(
        "directions", lambda: NodesAt([0], [[1]], directions="w"), ValueError, "directions is 'w'"
    ),
    refused(
        "directions twice",
        lambda: NodesAt([0], [[1], [1]], directions="xx"),
        ValueError,
        "directions is 'xx'",
    ),
    refused(
        "directions none",
        lambda: NodesAt([0], [[1]]),
        ValueError,
        r"positions has shape \(1, 1\), expected \(3, 1\)",
    ),
    refused(
        "tolerance",
        lambda: NodesAt([0], np.zeros((3, 1)), tolerance=-1),
        ValueError,
        "tolerance is -1",
    ),
    refused(
        "position",
        lambda: PointAt([0], [0, 1, 2, 3]),
        ValueError,
        r"position has shape \(4,\), expected \(3,\)",
    ),
    refused(
        "weights",
        lambda: PointAt([0, 1], [0, 1, 2], weights=[1]),
        ValueError,
        r"weights has shape \(1,\)",
    ),
    refused(
        "weights sum",
        lambda: PointAt([0, 1], [0, 1, 2], weights=[1, -1]),
        ValueError,
        "weights add up to 0",
    ),
    refused("height", lambda: Height([1, 2], TOP, BOTTOM), ValueError, r"height has shape \(2,\)"),
    refused("height text", lambda: Height("high", TOP, BOTTOM), TypeError, "height must be"),
    refused("axis", lambda: Height(1.0, TOP, BOTTOM, axis=[0, 0, 0]), ValueError, "axis is 0"),
    refused("angle", lambda: Twist(NAN, TOP, BOTTOM), ValueError, "angle is nan"),
    refused(
        "angle in degrees",
        lambda: Twist(30.0, TOP, BOTTOM),
        ValueError,
        r"angle is 30 rad, more than a whole turn; .* give np\.radians\(30\) = 0\.5236",
    ),
    refused("pairs", lambda: Twist(0.1, TOP, [3, 4]), ValueError, "top has 3 nodes and bottom 2"),
    refused("cycles", lambda: RotationalSymmetry([]), ValueError, "cycles is empty"),
    refused("cycles text", lambda: RotationalSymmetry("abc"), TypeError, "cycles is 'abc'"),
    refused(
        "cycles uneven",
        lambda: RotationalSymmetry([[0, 1, 2], [3, 4]]),
        ValueError,
        r"cycles\[1\] has 2 nodes",
    ),
    refused(
        "cycles share",
        lambda: RotationalSymmetry([[0, 1], [1, 2]]),
        ValueError,
        "cycles has node 1 twice",
    ),
    refused("whole turn", lambda: RotationalSymmetry([TOP], turns=0), ValueError, "turns is 0"),
]

TARGETS = [
    refused("model", lambda: shape_target("prism", force_density=1.0), TypeError, "model is a str"),
    refused("demand", lambda: target("high"), TypeError, r"demands\[0\] is a str, expected Demand"),
    refused(
        "demands",
        lambda: shape_target(prism_model(), 0.85, force_density=1.0),
        TypeError,
        "demands is a float",
    ),
    refused(
        "node",
        lambda: target(NodesAt([6], np.zeros((3, 1)))),
        ValueError,
        r"demands\[0\]\.nodes\[0\] is 6, expected 0 to 5",
    ),
    refused(
        "node of height",
        lambda: target(Height(1.0, [9], [0])),
        ValueError,
        r"demands\[0\]\.top\[0\] is 9",
    ),
    refused("level", lambda: target(force_density=-1.0), ValueError, "force_density is -1"),
    refused(
        "no level",
        lambda: target(force_density=None),
        ValueError,
        "give force_density or max_force_density",
    ),
    refused(
        "no level least",
        lambda: target(force_density=None, prestress="least"),
        ValueError,
        "without load γ = 0 balances",
    ),
    refused(
        "group",
        lambda: target(reference="side"),
        ValueError,
        "reference is 'side', expected one of",
    ),
    refused(
        "group alone",
        lambda: target(force_density=None, reference="top"),
        ValueError,
        "goes with force_density",
    ),
    refused("prestress", lambda: target(prestress="most"), ValueError, "prestress is 'most'"),
    refused(
        "bounds",
        lambda: target(min_force_density=5.0, max_force_density=4.0),
        ValueError,
        "more than max_force_density",
    ),
    refused(
        "level outside",
        lambda: target(min_force_density=20.0),
        ValueError,
        "force_density is 10 N/m, but the bounds",
    ),
    refused(
        "min negative",
        lambda: target(min_force_density=-1.0),
        ValueError,
        r"min_force_density\[0\] is -1",
    ),
    refused(
        "min shape",
        lambda: target(min_force_density=[1.0, 2.0]),
        ValueError,
        r"min_force_density has shape \(2,\)",
    ),
    refused(
        "min beyond the law",
        lambda: target(force_density=None, prestress="least", min_force_density=100.0),
        ValueError,
        "stays below",
    ),
    refused("clearance", lambda: target(min_clearance=-0.1), ValueError, "min_clearance is -0"),
    refused("winches", lambda: target(winches=0.1), TypeError, "winches is a float"),
    refused(
        "winches without law",
        lambda: shape_target(tc.prism(), force_density=1.0, winches=tc.Winches(shortest=0.1)),
        ValueError,
        "no string law",
    ),
    refused(
        "winches shape",
        lambda: target(winches=tc.Winches(shortest=[0.1, 0.2])),
        ValueError,
        r"winches\.shortest has shape \(2,\)",
    ),
    refused("start", lambda: target(start=np.zeros((3, 5))), ValueError, "start has shape"),
    refused(
        "moved support",
        lambda: shape_target(
            tc.Structure(tc.prism().nodes, tc.prism().bars, tc.prism().strings, 1.0, fixed=BOTTOM),
            force_density=1.0,
            start=tc.prism().nodes + 1.0,
        ),
        ValueError,
        "in start, the fixed node 3",
    ),
    refused("symmetry", lambda: target(symmetry=3), TypeError, "symmetry is a int"),
    refused(
        "symmetry node",
        lambda: target(symmetry=RotationalSymmetry([[0, 7]])),
        ValueError,
        "names node 7",
    ),
    refused("require_stable", lambda: target(require_stable=1), TypeError, "require_stable is 1"),
    refused(
        "unheld weight",
        lambda: shape_target(prism_model(gravity=9.81), force_density=1.0),
        ValueError,
        "the structure has no support",
    ),
]

PATHS = [
    refused("path model", lambda: path(model=tc.prism()), TypeError, "model is a Structure"),
    refused("start nodes", lambda: path(start=3), TypeError, "start is a int, expected Prestress"),
    refused(
        "other structure",
        lambda: path(goal=tc.prestress(tc.prism(4), 10.0)),
        ValueError,
        "goal is a prestress of Structure",
    ),
    refused(
        "other bars",
        lambda: path(goal=tc.prestress(tc.prism(height=0.5), 10.0)),
        ValueError,
        "in goal, bar 0 has length",
    ),
    refused(
        "other load",
        lambda: path(model=prism_model(external_force=np.c_[np.eye(3), -np.eye(3)])),
        ValueError,
        "start rests under loads that differ",
    ),
    refused("same", lambda: path(goal=rest()), ValueError, "start and goal are the same"),
    refused(
        "no time",
        lambda: path(duration=None),
        ValueError,
        "expected duration, or winches with a rate",
    ),
    refused(
        "range only",
        lambda: path(duration=None, winches=tc.Winches(shortest=0.1)),
        ValueError,
        "expected duration",
    ),
    refused(
        "short",
        lambda: path(duration=0.01, winches=tc.Winches(rate=0.1)),
        ValueError,
        r"duration is 0\.01 s, expected at least",
    ),
    refused("duration", lambda: path(duration=-1.0), ValueError, "duration is -1"),
    refused("step", lambda: path(step=0.0), ValueError, r"step is 0\.0"),
    refused("ramp", lambda: path(ramp=0.6), ValueError, r"ramp is 0\.6, expected at most 0\.5"),
    refused(
        "start bound",
        lambda: path(min_force_density=12.0),
        ValueError,
        "start has γ = 10 N/m in string 0, expected at least 12",
    ),
    refused(
        "goal bound",
        lambda: path(goal=rest(40.0), max_force_density=50.0),
        ValueError,
        "goal has γ = 69",
    ),
    refused(
        "range",
        lambda: path(winches=tc.Winches(shortest=0.85)),
        ValueError,
        r"on the way, at 0 s, string 0 needs a rest length of 0\.779423 m, expected at least 0\.85",
    ),
    refused(
        "rate shape",
        lambda: path(winches=tc.Winches(rate=[0.1, 0.2])),
        ValueError,
        r"winches\.rate has shape \(2,\)",
    ),
    refused(
        "rate without law",
        lambda: path(model=tc.Model(tc.prism()), winches=tc.Winches(rate=0.1)),
        ValueError,
        "no string law",
    ),
    refused("times", lambda: path().reference([[0.0]]), ValueError, r"times has shape \(1, 1\)"),
    refused("times fall", lambda: path().reference([1.0, 0.0]), ValueError, "ascending times"),
]


@pytest.mark.parametrize(("call", "exception", "message"), DEMANDS + TARGETS + PATHS)
def test_is_refused(call, exception, message):
    with pytest.raises(exception, match=message) as caught:
        call()
    assert type(caught.value) is exception
