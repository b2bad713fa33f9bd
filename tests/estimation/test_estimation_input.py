"""Input of estimation that must be refused by name."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.estimation.conftest import STEP
from tests.refused import (
    NAN,
    assert_refused,
    closed,
    drifting,
    estimator,
    held_plant,
    lengths,
    model,
    nodes,
    plant,
    prism,
    refused,
    run,
    with_entry,
)


def flipped():
    """The nodes of the prism with the ends of one bar exchanged: bars keep their lengths."""
    turned, (start, end) = nodes().copy(), prism().bars[0]
    turned[:, [start, end]] = nodes()[:, [end, start]]
    return turned


def kalman(**changes):
    """A filter for the prism, with some arguments replaced."""
    arguments = {"plant": held_plant(), "sensors": lengths(), "sample_time": 0.01} | changes
    return tc.KalmanFilter(**arguments)


# fmt: off
# Two lines a case.
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
            r"strings\[1\] is 9, expected 0 to 8"),
    refused("Sensors of a negative string", lambda: lengths(strings=(-1,)), ValueError,
            r"strings\[0\] is -1"),
    refused("Sensors of half a string", lambda: lengths(strings=(0.5,)), TypeError,
            r"strings\[0\] is 0\.5"),
    refused("Sensors of strings by name", lambda: lengths(strings="top"), TypeError,
            r"strings must be an array of real numbers; found 'top'"),
    refused("Sensors of ragged strings",
            lambda: tc.Sensors(structure=prism(), string_length=1e-3, strings=[[0], [1, 2]]),
            TypeError,
            r"strings must be an array of real numbers"),
    refused("disturb infinite readings",
            lambda: lengths().disturb(np.full(9, np.inf), np.random.default_rng(0)), ValueError,
            r"exact\[0\] is inf"),
    refused("kalman of a sample without end", lambda: estimator(1e30), ValueError,
            r"sample_time is 1e\+30 s, in which even the slowest vibration of the plant"),
    refused("reset to no shape", lambda: estimator().reset(state=np.full(18, 1e6)), ValueError,
            r"state is not a possible shape of the structure: q turns bar"),
    refused("delay negative", lambda: lengths(delay=-1), ValueError, r"delay is -1"),
    refused("delay half a sample", lambda: lengths(delay=0.5), TypeError, r"delay is 0\.5"),
    refused("drop_rate one", lambda: lengths(drop_rate=1.0), ValueError,
            r"drop_rate is 1, expected a probability of at least 0 and below 1"),
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
    refused("kalman step zero", lambda: kalman(sample_time=0), ValueError,
            r"sample_time is 0, .* s"),
    refused("kalman step text", lambda: kalman(sample_time="fast"), TypeError,
            r"sample_time is 'fast'"),
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
            r"start is .*0\.\d+ m off; linearize about a nearer"),
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
            r"load: 1 of the 9 directions of a load .*in addition node_position of all nodes"),
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
            r"sensors go with an estimator"),
    refused("seed negative", lambda: closed(estimator=estimator(), seed=-1), ValueError,
            r"seed is -1"),
    refused("seed text", lambda: closed(estimator=estimator(), seed="luck"), TypeError,
            r"seed is 'luck'"),
    refused("estimator without a controller", lambda: run(estimator=estimator()), ValueError,
            r"estimator, winches and sample_time go with a controller"),
    refused("estimator of another sample time", lambda: closed(estimator=estimator(0.002)),
            ValueError, r"estimator has the sample time 0\.002 s, expected .* 0\.001 s"),
    refused("estimator that is told something else",
            lambda: closed(estimator=tc.KalmanFilter(plant(), lengths(), sample_time=0.001)),
            ValueError,
            r"designed for the input force_density, but the actuators hold rest_length"),
    refused("sensors of other readings",
            lambda: closed(estimator=estimator(), sensors=lengths(strings=(0, 1))), ValueError,
            r"sensors has the readings .*2 readings.*but estimator expects .*9 readings"),
    refused("plot.estimate of no run", lambda: tc.plot.estimate(3), TypeError, r"run is a int"),
    refused("plot.estimate of an open loop", lambda: tc.plot.estimate(run()), ValueError,
            r"run has no estimate"),
    refused("plot.estimate of a string that is not",
            lambda: tc.plot.estimate(closed(estimator=estimator()), strings=(9,)), ValueError,
            r"strings\[0\] is 9, expected 0 to 8"),
    refused("plot.estimate of no strings",
            lambda: tc.plot.estimate(closed(estimator=estimator()), strings=()), TypeError,
            r"strings is \(\), expected a sequence of string indices"),
    refused("plot.estimate of strings by name",
            lambda: tc.plot.estimate(closed(estimator=estimator()), strings="top"), TypeError,
            r"strings must be an array of real numbers; found 'top'"),
]

# fmt: on


@pytest.mark.parametrize(("call", "exception", "message"), ESTIMATION)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)


def test_a_measured_start_is_moved_and_said(held, sensors_of):
    nodes = held.model.structure.nodes
    measured = nodes + 3e-3 * np.random.default_rng(1).normal(size=nodes.shape)
    exact = tc.structure.restore_bar_lengths(held.model.structure, measured)
    sensors, most = sensors_of("string_length"), np.linalg.norm(exact - measured, axis=0).max()
    with pytest.warns(RuntimeWarning, match=f"in start, .* moved by up to {most:.3g} m") as said:
        estimator = tc.KalmanFilter(held, sensors, sample_time=STEP, start=measured)
    assert said[0].filename == __file__
    same = tc.KalmanFilter(held, sensors, sample_time=STEP, start=exact)
    np.testing.assert_array_equal(estimator._design.start, same._design.start)


def test_a_measured_operating_point_is_moved_and_said(held, model):
    nodes = held.model.structure.nodes
    measured = nodes + 3e-3 * np.random.default_rng(1).normal(size=nodes.shape)
    exact = tc.structure.restore_bar_lengths(model.structure, measured)
    with pytest.warns(RuntimeWarning, match=r"in at\.nodes, bars are off by") as said:
        plant = tc.linearize(
            model, tc.OperatingPoint(measured, held.force_density), require_equilibrium=False
        )
    assert said[0].filename == __file__
    np.testing.assert_array_equal(plant.nodes, exact)
    with pytest.raises(ValueError, match="restore_bar_lengths"):
        tc.linearize(model, tc.OperatingPoint(1.06 * nodes, held.force_density))
