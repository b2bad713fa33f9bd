"""Input of actuation that must be refused by name."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.refused import (
    NAN,
    assert_refused,
    elastic,
    gamma,
    model,
    nodes,
    prism,
    refused,
    rest_length,
    touching,
)

# fmt: off
# Two lines a case.
ACTUATION = [
    refused("rate zero", lambda: tc.Winches(rate=0.0), ValueError, r"rate\[0\] is 0, .*m/s"),
    refused("rate negative", lambda: tc.Winches(rate=[1.0, -1.0]), ValueError, r"rate\[1\] is -1"),
    refused("rate nan winches", lambda: tc.Winches(rate=NAN), ValueError, r"rate is nan"),
    refused("rate text", lambda: tc.Winches(rate="fast"), TypeError, r"rate .*'fast'"),
    refused("rate of two dimensions", lambda: tc.Winches(rate=np.ones((2, 2))), ValueError,
            r"rate has shape \(2, 2\)"),
    refused("longest nan", lambda: tc.Winches(longest=[1, NAN]), ValueError,
            r"longest\[1\] is nan"),
    refused("range crossed", lambda: tc.Winches(shortest=0.5, longest=0.2), ValueError,
            r"shortest 0\.5 m exceeds longest 0\.2 m"),
    refused("range of two counts", lambda: tc.Winches(shortest=[0.1, 0.5], longest=[1.0] * 3),
            ValueError, r"shortest.*\(2,\).*longest.*\(3,\)"),
    refused("substeps zero", lambda: tc.Winches(substeps=0), ValueError,
            r"substeps is 0, .*at least 1"),
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
    refused("move step", lambda: tc.Winches().move([1.0], [1.0], 0.0), ValueError,
            r"sample_time is 0\.0"),
    refused("move of another count",
            lambda: tc.Winches(rate=[1.0, 1.0]).move(np.ones(3), np.ones(3), 0.1), ValueError,
            r"rate has shape \(2,\), expected \(\) or \(3,\)"),
    refused("motor without a drum", lambda: tc.Motor(), TypeError, r"drum_radius"),
    refused("drum without radius", lambda: tc.Motor(0.0), ValueError, r"drum_radius\[0\] is 0"),
    refused("gear nan", lambda: tc.Motor(0.01, NAN), ValueError, r"gear_ratio is nan"),
    refused("torque negative", lambda: tc.Motor(0.01, torque=[1.0, -1.0]), ValueError,
            r"torque\[1\] is -1, expected a positive torque in N m"),
    refused("inertia negative", lambda: tc.Motor(0.01, torque=1.0, inertia=-1.0), ValueError,
            r"inertia\[0\] is -1, expected at least 0"),
    refused("inertia without torque", lambda: tc.Motor(0.01, inertia=1e-6), ValueError,
            r"inertia needs torque"),
    refused("lag text", lambda: tc.Motor(0.01, lag="slow"), TypeError, r"lag .*'slow'"),
    refused("backlash of two counts", lambda: tc.Motor([0.01] * 3, backlash=[0.1] * 2), ValueError,
            r"drum_radius \(3,\).*backlash \(2,\)"),
    refused("zero of no length", lambda: tc.Motor(0.01, zero=0.0), ValueError, r"zero\[0\] is 0"),
    refused("motor of another kind", lambda: tc.Winches(motor=0.01), TypeError,
            r"motor is a float, expected Motor"),
    refused("motor of another count", lambda: tc.Winches([1.0] * 3, motor=tc.Motor([0.01] * 2)),
            ValueError, r"rate \(3,\).*drum_radius / gear_ratio \(2,\)"),
    refused("angle of unknown zero", lambda: tc.Motor(0.01).angle([1.0]), ValueError,
            r"zero is not known: give the rest length"),
    refused("angle of a number", lambda: tc.Motor(0.01, zero=1.0).angle(1.0), ValueError,
            r"rest_length has shape \(\), expected \(α,\)"),
    refused("angle of another count", lambda: tc.Motor([0.01] * 3, zero=1.0).angle([1.0, 1.0]),
            ValueError, r"shape \(3,\), expected \(\) or \(2,\)"),
    refused("rest length nan", lambda: tc.Motor(0.01, zero=1.0).rest_length([NAN]), ValueError,
            r"angle\[0\] is nan"),
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

FOUND_IN_REVIEW = [
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
    refused("rate and range of two counts", lambda: tc.Winches(rate=[1.0] * 3, shortest=[0.1, 0.5]),
            ValueError, r"rate.*\(3,\).*shortest.*\(2,\)"),
    refused("range of one and two", lambda: tc.Winches(shortest=[0.1, 0.5], longest=[1.0]),
            ValueError, r"shortest.*\(2,\).*longest.*\(1,\)"),
    refused("move from a negative length", lambda: tc.Winches().move([-1.0], [1.0], 0.1),
            ValueError, r"current\[0\] is -1"),
    refused("move to a negative length", lambda: tc.Winches().move([1.0], [-2.0], 0.1), ValueError,
            r"wanted\[0\] is -2"),
    refused("rest length of a string of no length",
            lambda: tc.to_rest_length(touching(), touching().structure.nodes, 1.0), ValueError,
            r"string(s\[1\]| 1) "),
]

# fmt: on


CASES = [*ACTUATION, *FOUND_IN_REVIEW]


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)
