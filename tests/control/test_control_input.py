"""Input of control that must be refused by name."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import MPCSettings, OutputLimit
from tests.refused import (
    NAN,
    STILL,
    assert_refused,
    elastic,
    model,
    nodes,
    plant,
    refused,
    regulator,
    rest,
    winch_regulator,
)

SAMPLES = {"horizon": 2, "sample_time": 0.02}


def mpc_on(reference):
    """An MPC on a reference."""
    return tc.MPC(plant(), horizon=2, sample_time=0.02, max_force_density=50.0, reference=reference)


def elastic_plant():
    """Force densities of strings with a law."""
    return tc.linearize(elastic(), rest())


def still_shape():
    """A reference of one shape, without force densities."""
    return tc.Reference([0.0], nodes()[:, :, None])


@cache
def short_path():
    """A path of a few shapes."""
    low = tc.Height(0.95, top=[0, 1, 2], bottom=[3, 4, 5])
    goal = tc.shape_target(elastic(), low, force_density=17.3205)
    return tc.shape_path(elastic(), rest(), goal, duration=1.0, step=0.25)


def mpc(**changes):
    """An MPC, with some arguments replaced."""
    usual = {"plant": plant(), "horizon": 5, "sample_time": 0.02, "max_force_density": 50.0}
    return tc.MPC(**(usual | changes))


def nmpc(**changes):
    """A nonlinear MPC, with some arguments replaced."""
    usual = {"plant": plant(), "horizon": 5, "sample_time": 0.02, "max_force_density": 50.0}
    return tc.NMPC(**(usual | changes))


def linearizing(**changes):
    """A feedback linearization, with some arguments replaced."""
    usual = {"plant": plant(), "reference": None, "sample_time": 0.02}
    usual |= {"max_force_density": 50.0, "frequency": 1.0}
    return tc.FeedbackLinearization(**(usual | changes))


# fmt: off
# Two lines a case.
CONTROL = [
    refused("lqr of a model", lambda: tc.LQR(model(), 1.0, 1.0), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("lqr Q too small", lambda: tc.LQR(plant(), np.eye(9), 1.0), ValueError,
            r"Q has shape \(9, 9\), expected \(\), \(18,\) or \(18, 18\)"),
    refused("lqr Q negative", lambda: tc.LQR(plant(), -1.0, 1.0), ValueError,
            r"Q has the eigenvalue -1, expected at least 0"),
    refused("lqr Q lopsided", lambda: tc.LQR(plant(), np.triu(np.ones((18, 18))), 1.0), ValueError,
            r"Q is not symmetric"),
    refused("lqr Q nan", lambda: tc.LQR(plant(), NAN, 1.0), ValueError, r"Q is nan"),
    refused("lqr R zero", lambda: tc.LQR(plant(), 1.0, 0.0), ValueError,
            r"R has the eigenvalue 0, expected positive"),
    refused("lqr R of states", lambda: tc.LQR(plant(), 1.0, np.eye(18)), ValueError,
            r"R has shape \(18, 18\), expected \(\), \(9,\) or \(9, 9\)"),
    refused("lqr step zero", lambda: tc.LQR(plant(), 1.0, 1.0, sample_time=0.0), ValueError,
            r"sample_time is 0\.0, expected a positive"),
    refused("lqr limit below the prestress",
            lambda: tc.LQR(plant(), 1.0, 1.0, max_force_density=20.0), ValueError,
            r"max_force_density\[6\] is 20 N/m, but string 6 has 30 N/m"),
    refused("lqr limit for rest lengths",
            lambda: tc.LQR(tc.linearize(elastic(), rest(), input="rest_length"), 1.0, 1.0,
                           max_force_density=50.0),
            ValueError, r"max_force_density limits plants with input='force_density'"),
    refused("lqr in nodes", lambda: tc.LQR(plant("nodes"), 1.0, 1.0), ValueError,
            r"18 of the 36 states .*coordinates='internal'"),
    refused("lqr without weight", lambda: tc.LQR(plant(), 0.0, 1.0), ValueError, r"weight in Q"),
    refused("energy_weights of a model", lambda: tc.energy_weights(model()), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("MPC of a model",
            lambda: tc.MPC(model(), horizon=5, sample_time=0.02, max_force_density=50.0), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("winches for force densities", lambda: mpc(winches=tc.Winches(rate=1.0)), ValueError,
            r"winches limit rest lengths, but plant has input='force_density'"),
    refused("MPC in minimal", lambda: mpc(plant=plant("minimal")), ValueError,
            r"12 of the 30 states .*coordinates='internal'"),
    refused("horizon zero",
            lambda: tc.MPC(plant(), horizon=0, sample_time=0.02, max_force_density=50.0),
            ValueError, r"horizon is 0, expected a whole number of at least 1"),
    refused("horizon without end",
            lambda: tc.MPC(plant(), horizon=10**9, sample_time=0.02, max_force_density=50.0),
            ValueError, r"horizon is 1000000000, expected a whole number of at most 10000"),
    refused("NMPC horizon without end",
            lambda: tc.NMPC(plant(), horizon=10**9, sample_time=0.02, max_force_density=50.0),
            ValueError, r"horizon is 1000000000, expected a whole number of at most 10000"),
    refused("horizon half",
            lambda: tc.MPC(plant(), horizon=2.5, sample_time=0.02, max_force_density=50.0),
            TypeError, r"horizon is 2\.5, expected a whole number"),
    refused("MPC step negative",
            lambda: tc.MPC(plant(), horizon=5, sample_time=-0.02, max_force_density=50.0),
            ValueError, r"sample_time is -0\.02, expected a positive"),
    refused("MPC limit nan",
            lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=NAN), ValueError,
            r"max_force_density is nan"),
    refused("MPC limit of eight", lambda: mpc(max_force_density=np.full(8, 50.0)), ValueError,
            r"max_force_density has shape \(8,\), expected \(\) or \(9,\)"),
    refused("MPC change negative", lambda: mpc(max_change=-1.0), ValueError,
            r"max_change\[0\] is -1, expected a positive"),
    refused("NMPC of a model",
            lambda: tc.NMPC(model(), horizon=5, sample_time=0.02, max_force_density=50.0),
            TypeError, r"plant is a Model, expected LinearPlant"),
    refused("NMPC least force density nan", lambda: nmpc(min_force_density=NAN), ValueError,
            r"min_force_density is nan"),
    refused("NMPC tension of eight", lambda: nmpc(max_tension=np.full(8, 50.0)), ValueError,
            r"max_tension has shape \(8,\), expected \(\) or \(9,\)"),
    refused("NMPC penalty nan", lambda: nmpc(string_penalty=NAN), ValueError,
            r"string_penalty is nan"),
    refused("NMPC load gain", lambda: nmpc(load_gain=0.0), ValueError, r"load_gain is 0"),
    refused("NMPC machine code", lambda: nmpc(machine_code="yes"), TypeError, r"machine_code"),
    refused("MPC tolerance", lambda: mpc(tolerance=0.0), ValueError, r"tolerance is 0\.0"),
    refused("MPC iterations", lambda: mpc(max_iterations=0), ValueError, r"max_iterations is 0"),
    refused("MPC time limit zero", lambda: mpc(time_limit=0.0), ValueError,
            r"time_limit is 0\.0, expected a positive finite number in s"),
    refused("NMPC time limit nan", lambda: nmpc(time_limit=NAN), ValueError, r"time_limit is nan"),
    refused("NMPC time limit text", lambda: nmpc(time_limit="1 ms"), TypeError,
            r"time_limit is '1 ms'"),
    refused("lqr winches a number", lambda: tc.LQR(plant(), 1.0, 1.0, winches=0.5), TypeError,
            r"winches is a float, expected Winches"),
    refused("lqr winches for force densities",
            lambda: tc.LQR(plant(), 1.0, 1.0, winches=tc.Winches()), ValueError,
            r"winches limit rest lengths, but plant has input='force_density'"),
    refused("lqr change negative",
            lambda: tc.LQR(plant(), 1.0, 1.0, sample_time=0.1, max_change=-1.0), ValueError,
            r"max_change\[0\] is -1, expected a positive"),
    refused("lqr change of eight",
            lambda: tc.LQR(plant(), 1.0, 1.0, sample_time=0.1, max_change=np.ones(8)), ValueError,
            r"max_change has shape \(8,\), expected \(\) or \(9,\)"),
    refused("applied of eight", lambda: regulator().applied(np.ones(8)), ValueError,
            r"value has shape \(8,\), expected \(9,\): one per string"),
    refused("applied nan", lambda: regulator().applied(np.full(9, NAN)), ValueError,
            r"value\[0\] is nan"),
    refused("MPC unknown keyword", lambda: mpc(horizont=3), TypeError, r"horizont"),
    refused("MPC reference transposed", lambda: mpc(reference=nodes().T), ValueError,
            r"reference has shape \(6, 3\), expected \(3, 6\)"),
    refused("MPC reference of other nodes",
            lambda: tc.MPC(plant(), horizon=5, sample_time=0.02, max_force_density=50.0,
                           reference=tc.Reference([0.0], np.ones((3, 4, 1)))),
            ValueError, r"reference\.nodes has shape \(3, 4, 1\), expected \(3, 6, 1\)"),
    refused("shape control of a model", lambda: linearizing(plant=model()), TypeError,
            r"plant is a Model, expected LinearPlant"),
    refused("shape control without frequency",
            lambda: tc.FeedbackLinearization(plant(), reference=None,
                    sample_time=0.02, max_force_density=50.0),
            TypeError, r"frequency"),
    refused("shape control of rest lengths", lambda: linearizing(plant=winch_regulator().plant),
            ValueError, r"plant has input='rest_length'.*input='force_density'"),
    refused("shape control in nodes", lambda: linearizing(plant=plant("nodes")), ValueError,
            r"plant\.coordinates\.kind is 'nodes', expected one of 'internal', 'minimal'"),
    refused("shape control limit low", lambda: linearizing(max_force_density=20.0), ValueError,
            r"max_force_density\[6\] is 20 N/m, but string 6 has 30"),
    refused("shape control step", lambda: linearizing(sample_time=0.0), ValueError,
            r"sample_time is 0\.0, expected a positive"),
    refused("shape control frequency nan", lambda: linearizing(frequency=NAN), ValueError,
            r"frequency is nan, expected a positive finite number in Hz"),
    refused("shape control damping", lambda: linearizing(damping=0.0), ValueError,
            r"damping is 0\.0"),
    refused("shape control too fast", lambda: linearizing(frequency=10.0), ValueError,
            r"frequency 10 Hz .* the error would grow; expected a·sample_time < 2"),
    refused("shape control tracked", lambda: linearizing(tracked=np.eye(6)), ValueError,
            r"tracked has shape \(6, 6\), expected \(p, 18\)"),
    refused("shape control of nothing", lambda: linearizing(tracked=np.zeros((2, 18))), ValueError,
            r"tracked has a row of zeros"),
    refused("shape control of a drift",
            lambda: linearizing(tracked=np.tile([1.0, 0.0, 0.0], 6)[None]), ValueError,
            r"no string moves the tracked combinations"),
    refused("MPC load tracked nowhere",
            lambda: mpc(load_gain=0.5, tracked=np.zeros((1, 18))), ValueError,
            r"tracked has a row of zeros"),
    refused("MPC load tracked next to nowhere",
            lambda: mpc(load_gain=0.5, tracked=np.full((1, 18), 1e-310)), ValueError,
            r"tracked has a row of zeros"),
    refused("MPC outputs a mapping", lambda: mpc(outputs={}), TypeError, r"outputs is \{\}"),
    refused("MPC outputs a limit",
            lambda: mpc(outputs=tc.clearance(plant(), 0.1)), TypeError, r"outputs is Output"),
    refused("MPC sample without end", lambda: mpc(sample_time=1e15), ValueError,
            r"sample_time is 1e\+15 s, in which even the slowest vibration"),
    refused("MPC penalty of truth", lambda: mpc(string_penalty=True), TypeError,
            r"string_penalty is True"),
    refused("MPC penalty complex", lambda: mpc(string_penalty=1j), TypeError,
            r"string_penalty is 1j"),
    refused("MPC penalty beyond", lambda: mpc(string_penalty=10**400), ValueError,
            r"string_penalty is"),
    refused("settings with nan", lambda: MPCSettings(**SAMPLES, Q=NAN), ValueError, r"Q is nan"),
    refused("settings with a reference of nan",
            lambda: MPCSettings(**SAMPLES, reference=[NAN]), ValueError, r"reference\[0\] is nan"),
    refused("held_loop of no length",
            lambda: tc.control.held_loop(elastic_plant(), np.zeros((9, 18)), sample_time=1e-15),
            ValueError, r"sample_time is 1e-15 s, in which the loop as designed neither decays"),
    refused("held_loop without end",
            lambda: tc.control.held_loop(elastic_plant(), np.zeros((9, 18)), sample_time=1e15),
            ValueError, r"sample_time is 1e\+15 s"),
    refused("OutputLimit low empty", lambda: OutputLimit(np.ones((1, 18)), low=[]), ValueError,
            r"low has shape \(0,\), expected \(\) or \(1,\)"),
    refused("OutputLimit low a table", lambda: OutputLimit(np.ones((1, 18)), low=np.ones((3, 2))),
            ValueError, r"low has shape \(3, 2\)"),
    refused("OutputLimit penalty complex",
            lambda: OutputLimit(np.ones((1, 18)), low=0.0, penalty=1j), TypeError,
            r"penalty is 1j, expected a positive number"),
    refused("OutputLimit penalty true",
            lambda: OutputLimit(np.ones((1, 18)), low=0.0, penalty=True), TypeError,
            r"penalty is True"),
    refused("OutputLimit penalty list",
            lambda: OutputLimit(np.ones((1, 18)), low=0.0, penalty=[1.0, 2.0]), TypeError,
            r"penalty is \[1\.0, 2\.0\]"),
    refused("error of a shape without bars",
            lambda: linearizing().error(0.0, nodes() + 7 * np.eye(3, 6), STILL), ValueError,
            r"nodes turn a bar"),
    refused("shape control change", lambda: linearizing(max_change=0.0), ValueError,
            r"max_change\[0\] is 0, expected a positive"),
    refused("shape control regularization", lambda: linearizing(regularization=0.0), ValueError,
            r"regularization is 0\.0"),
    refused("shape control reference", lambda: linearizing(reference=nodes().T), ValueError,
            r"reference has shape \(6, 3\), expected \(3, 6\)"),
    refused("shape control error of nan", lambda: linearizing().error(NAN, nodes(), STILL),
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
    refused("diagonals text", lambda: tc.prism(diagonals="yes"), TypeError, r"diagonals is 'yes'"),
    refused("plants of no count", lambda: short_path().plants(0, "rest_length"), ValueError,
            r"count is 0, expected .*at least 1"),
    refused("plants of an unknown input", lambda: short_path().plants(2, "height"), ValueError,
            r"input is 'height'"),
    refused("Reference times descend", lambda: tc.Reference([1.0, 0.0], np.ones((3, 6, 2))),
            ValueError, r"time\[1\] is 0 s after time\[0\] = 1 s"),
    refused("Reference of no time", lambda: tc.Reference([], np.ones((3, 6, 0))), ValueError,
            r"time has shape \(0,\)"),
    refused("Reference of one shape", lambda: tc.Reference([0.0, 1.0], nodes()), ValueError,
            r"nodes has shape \(3, 6\), expected \(3, n, 2\)"),
    refused("Reference nan", lambda: tc.Reference([0.0], np.full((3, 6, 1), NAN)), ValueError,
            r"nodes\[0, 0, 0\] is nan"),
    refused("measured transposed", lambda: mpc().command(0.0, nodes().T, STILL), ValueError,
            r"nodes has shape \(6, 3\), expected \(3, 6\)"),
    refused("measured text", lambda: mpc().command(0.0, "here", STILL), TypeError,
            r"nodes .*'here'"),
]

# fmt: on


@pytest.mark.parametrize(("call", "exception", "message"), CONTROL)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)
