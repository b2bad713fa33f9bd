"""Input of simulation that must be refused by name."""

import subprocess
import sys

import numpy as np
import pytest

import tenscontrol as tc
from tests.refused import (
    INF,
    NAN,
    STILL,
    assert_refused,
    closed,
    elastic,
    gamma,
    loaded,
    model,
    nodes,
    pentagon_regulator,
    plant,
    prism,
    refused,
    regulator,
    rest,
    rest_length,
    run,
    touching,
    winch_regulator,
    with_entry,
)


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
# Two lines a case.
OPEN_LOOP = [
    refused("simulate a structure", lambda: run(model=prism()), TypeError,
            r"model is a Structure, expected Model"),
    refused("duration zero", lambda: run(duration=0.0), ValueError, r"duration is 0\.0, .* in s"),
    refused("rest_length of a function of nothing",
            lambda: tc.simulate(model(), 0.1, rest_length=lambda: 1.0), TypeError,
            r"rest_length cannot be called with a time: .* a function of a time, s, that returns"),
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
    refused("held rest_length a prestress", lambda: run(rest_length=rest()), TypeError,
            r"rest_length is a Prestress, which stands for force_density"),
    refused("held force_density negative", lambda: run(rest_length=None, force_density=-1.0),
            ValueError, r"force_density\[0\] is -1, .*can only pull"),
    refused("held force_density too few", lambda: run(rest_length=None, force_density=gamma()[:8]),
            ValueError, r"force_density has shape \(8,\), expected \(\) or \(9,\)"),
    refused("held force_density rest lengths",
            lambda: run(rest_length=None,
                        force_density=tc.to_rest_length(elastic(), nodes(), gamma())),
            TypeError, r"force_density is a RestLengths, which stands for rest_length"),
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
    refused("load for a model without", lambda: run(external_force=STILL + 1.0), ValueError,
            r"model takes no load.*external_force=True"),
    refused("load missing", lambda: run(model=loaded(), rest_length=None, force_density=17.0),
            ValueError, r"model takes a load: give external_force, shape \(3, n\)"),
    refused("load transposed",
            lambda: run(model=loaded(), rest_length=None, force_density=1, external_force=STILL.T),
            ValueError, r"external_force has shape \(6, 3\), expected \(3, 6\)"),
    refused("method unknown", lambda: run(method="euler"), ValueError,
            r"method is 'euler', expected one of 'auto', 'rk4', 'rk4_plain', 'dop853'"),
    refused("rk4 without step", lambda: run(method="rk4"), ValueError, r"'rk4' needs a step"),
    refused("dop853 with step", lambda: run(method="dop853", step=0.001), ValueError,
            r"step goes with the methods .*; 'dop853' chooses"),
    refused("step and tolerance", lambda: run(step=1e-3, tolerance=1e-8), ValueError,
            r"step is 0\.001 s and tolerance is 1e-08, expected one of them"),
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
            r"winches with a rate, substeps or a motor need rest_length"),
    refused("winches that wind from an unknown start",
            lambda: closed(winches=tc.Winches(substeps=5)), ValueError,
            r"winches with a rate, substeps or a motor need rest_length"),
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
            r"γ = 200 N/m on string 0.*stiffness, 100 N/m.*max_force_density below 100"),
]

FOUND_IN_REVIEW = [
    refused("held force_density complex", lambda: run(rest_length=None, force_density=gamma() + 1j),
            TypeError, r"force_density.*complex"),
    refused("controller a plant", lambda: closed(controller=plant()), TypeError,
            r"controller is a LinearPlant, expected a controller"),
    refused("progress text", lambda: run(progress="no"), TypeError, r"progress is .*(str|'no')"),
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


CASES = [*OPEN_LOOP, *CLOSED_LOOP, *FOUND_IN_REVIEW]


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)


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
