"""Input of robustness that must be refused by name."""

import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial

import numpy as np
import pytest

import tenscontrol as tc
from examples.stiffness_study import stiffness_report
from tests.refused import (
    INF,
    NAN,
    assert_refused,
    elastic,
    estimator,
    lengths,
    nodes,
    plant,
    prism,
    refused,
    rest,
    winch_regulator,
    with_entry,
)
from tests.robustness import cases


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
    return cases.loop_case(**(arguments | changes))


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


def with_handle():
    """A case that holds what cannot be sent to another process."""
    return partial(print, file=sys.stdout)


# fmt: off
# Two lines a case.
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
    refused("stiffness step", lambda: over_stiffness(sample_time=0.0), ValueError,
            r"sample_time is 0\.0"),
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
    refused("sweep seed negative", lambda: sweep(seed=-1), ValueError, r"seed is -1"),
    refused("sweep seed none", lambda: sweep(seed=None), TypeError, r"seed is None"),
    refused("sweep executor text", lambda: sweep(executor="processes"), TypeError,
            r"executor is a str, expected Executor"),
    refused("sweep executor and processes",
            lambda: sweep(executor=ThreadPoolExecutor(1), processes=2), ValueError,
            r"processes and executor are both given"),
    refused("sweep processes zero", lambda: sweep(processes=0), ValueError, r"processes is 0"),
    refused("sweep in_flight zero", lambda: sweep(in_flight=0), ValueError, r"in_flight is 0"),
    refused("sweep progress text", lambda: sweep(progress="no"), TypeError, r"progress is 'no'"),
    refused("sweep file number", lambda: sweep(file=3), TypeError, r"file is 3"),
    refused("sweep file name", lambda: sweep(file="\ud800"), ValueError, r"file is '.ud800', .* a"),
    refused("sweep file folder", lambda: sweep(file="."), OSError, r"it is a folder"),
    refused("uniform nan", lambda: tc.Uniform(NAN, 1), ValueError, r"low is nan"),
    refused("uniform falling", lambda: tc.Uniform(2, 1), ValueError, r"low is 2 and high is 1"),
    refused("uniform vast", lambda: tc.Uniform(-1.7e308, 1.7e308), ValueError,
            r"low is -1\.7e\+308, expected at most 1e\+70"),
    refused("uniform array", lambda: tc.Uniform([0, 1], 2), ValueError, r"low has shape \(2,\)"),
    refused("uniform size", lambda: tc.Uniform(0, 1, size=0), ValueError, r"size is 0"),
    refused("normal deviation", lambda: tc.Normal(0, -1), ValueError, r"deviation is -1"),
    refused("normal mean text", lambda: tc.Normal("0", 1), TypeError, r"mean .*'0'"),
    refused("one of none", lambda: tc.OneOf([]), ValueError, r"values has shape \(0,\)"),
    refused("one of nan", lambda: tc.OneOf([1, NAN]), ValueError, r"values\[1\] is nan"),
    refused("outcome success number", lambda: tc.robustness.Outcome(success=1), TypeError,
            r"success is 1"),
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
    refused("loop case rest length negative", lambda: loop_case(rest_length=-1), ValueError,
            r"rest_length\[0\] is -1, expected a positive length"),
    refused("loop case rest lengths in space", lambda: loop_case(rest_length=np.ones((3, 3, 3))),
            ValueError, r"rest_length has shape \(3, 3, 3\)"),
    refused("loop case nodes in time", lambda: loop_case(nodes=np.ones((3, 6, 2))), ValueError,
            r"nodes has shape \(3, 6, 2\)"),
    refused("loop case nodes twice the size", lambda: loop_case(nodes=2 * nodes()), ValueError,
            r"in nodes, bar \d has length 2\.\d+ m, expected 1\."),
    refused("loop case target twice the size", lambda: loop_case(target=2 * nodes()), ValueError,
            r"in target at 0 s, bar \d has length 2\.\d+ m, expected 1\."),
    refused("loop case target mirrored",
            lambda: loop_case(target=nodes() * [[-1.0], [1.0], [1.0]]), ValueError,
            r"in target at 0 s, bars 0 and 1 have changed sides"),
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
    refused("report file absent", lambda: tc.robustness.SweepReport.load("nowhere.jsonl"),
            FileNotFoundError, r"nowhere"),
]

# fmt: on


@pytest.mark.parametrize(("call", "exception", "message"), ROBUSTNESS)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)
