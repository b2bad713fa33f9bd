"""Limits on what a small argument can ask for: refused at once, with the count that it makes."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol import validation
from tests.refused import assert_refused, lengths, line, model, prism, refused, regulator, run

HUGE = 10**400  # Python writes 4300 digits at most, and no double holds as many as 309
ENDLESS = 10**5000


def mpc(**changes):
    plant = tc.linearize(model(), tc.prestress(prism(), 17.0))
    given = {"sample_time": 0.02, "horizon": 5, "max_force_density": 50.0} | changes
    return tc.MPC(plant, **given)


def never(settings, seed):
    raise AssertionError


def sweep(**changes):
    return tc.sweep(
        never, {"stiffness": tc.Uniform(0.0, 1.0)}, **({"count": 1, "seed": 0} | changes)
    )


# fmt: off
# Two lines a case.
MEMBERS = r", which makes .* bars and strings, about .* GB of memory; expected at most 5e\+06, 4 GB"
COUNTS = [
    refused("sides", lambda: tc.prism(sides=10**9), ValueError, r"^sides is 1000000000" + MEMBERS),
    refused("sides of 400 digits", lambda: tc.prism(sides=HUGE), ValueError,
            r"^sides is 10{50,}\.\.\., expected a whole number of at most 2147483647"),
    refused("sides of 5000 digits", lambda: tc.prism(sides=ENDLESS), ValueError,
            r"^sides is beyond 1e4000, expected a whole number of at most"),
    refused("sides below zero", lambda: tc.prism(sides=-ENDLESS), ValueError, r"^sides is beyond"),
    refused("sides of a tower", lambda: tc.prism_tower(2, sides=10**9), ValueError,
            r"^stages is 2 and sides is 1000000000" + MEMBERS),
    refused("stages", lambda: tc.prism_tower(2**31 - 1), ValueError, r"^stages is" + MEMBERS[1:2]),
    refused("sides of a radius", lambda: tc.structure.prism_radius(1.0, 0.5, 2**31), ValueError,
            r"^sides is 2147483648, expected a whole number of at most 2147483647"),
    refused("sides of force densities", lambda: tc.statics.prism_force_density(2**31 - 1, 1.0),
            ValueError, r"^sides is 2147483647, expected a whole number of at most 10000000"),
    refused("rows", lambda: tc.net(10**5, 10**5, 0.1, 0.1), ValueError,
            r"^rows is 100000 and columns is 100000" + MEMBERS),
    refused("segments", lambda: tc.subdivide(prism(), 2**31, node_mass=0.1), ValueError,
            r"^segments is 2\.14748e\+09" + MEMBERS),
    refused("segments of a string", lambda: tc.subdivide(line(), [1, 1e60], string_mass=[0, 1]),
            ValueError, r"^segments is 1e\+60" + MEMBERS),
    refused("iterations of a skin", lambda: tc.skin(prism(), "top", 40, node_mass=0.1), ValueError,
            r"^iterations is 40" + MEMBERS),
    refused("iterations of 400 digits", lambda: tc.skin(prism(), "top", HUGE, node_mass=0.1),
            ValueError, r"^iterations is 1000.*, expected a whole number of at most 500"),
    refused("equilibrium matrix", lambda: tc.statics.equilibrium_matrix(tc.prism(10_000)),
            ValueError, r"has 20000 nodes and 40000 members, which makes .* about 19.2 GB"),
    refused("mechanisms", lambda: tc.prestress(tc.prism(3000), 1.0).mechanisms, ValueError,
            r"18000 free coordinates and possibly \d+ mechanisms, .* expected at most 1666\. Give"),
    refused("max_iterations", lambda: mpc(max_iterations=2**31), ValueError,
            r"^max_iterations is 2147483648, expected a whole number of at most 2147483647"),
    refused("horizon", lambda: mpc(horizon=2**31), ValueError, r"^horizon is .* at most 10000"),
    refused("substeps", lambda: tc.Winches(rate=1.0, substeps=HUGE), ValueError,
            r"^substeps is 1000.* at most 10000"),
    refused("delay", lambda: lengths(delay=10**9), ValueError, r"^delay is .* at most 10000"),
    refused("seed", lambda: sweep(seed=2**128), ValueError, r"^seed is 3402.* at most 3402"),
    refused("count of runs", lambda: sweep(count=2**31 - 1), ValueError,
            r"^count is 2147483647, expected a whole number of at most 10000000"),
    refused("size of a draw", lambda: tc.Uniform(0.0, 1.0, size=10**9), ValueError,
            r"^size is .* at most 10000000"),
    refused("step", lambda: run(duration=1e9, step=1e-6, output_step=1e5), ValueError,
            r"^step is 1e-06 s, which makes 1e\+15 steps, about 1\.16e\+04 days; .*a day"),
    refused("output_step", lambda: run(duration=1e9, step=1.0), ValueError,
            r"^step is 1 s, which makes 1e\+09 states, about 288 GB of memory; .* output_step"),
    refused("sample_time", lambda: run(duration=1e5, rest_length=None, controller=regulator(),
                                       step=0.1, output_step=1e3),
            ValueError, r"^sample_time is 0\.001 s, which makes 1e\+08 samples, about .* GB"),
]
# fmt: on


@pytest.mark.parametrize(("call", "exception", "message"), COUNTS)
def test_a_count_out_of_reach_is_refused_with_what_it_makes(call, exception, message):
    assert_refused(call, exception, message)


def test_shapes_of_a_path_are_counted():
    elastic = tc.Model(prism(), strings=tc.LinearStrings(100.0))
    start = tc.prestress(prism(), 17.3205)
    goal = tc.shape_target(elastic, tc.Height(0.99, [0, 1, 2], [3, 4, 5]), force_density=17.3205)
    path = tc.shape_path(elastic, start, goal, duration=0.1)
    with pytest.raises(ValueError, match=r"^count is 1001, expected .* at most 1000"):
        path.plants(1001, "rest_length")
    with pytest.raises(ValueError, match=r"^step is 1e-09 s, which makes 1\.02e\+09 shapes"):
        tc.shape_path(elastic, start, goal, duration=1.0, step=1e-9)


def test_outputs_are_counted():
    case = tc.Scene(tc.Model(prism()), 1.0, force_density=17.0)
    for call in (
        lambda: tc.accuracy.converged_motion(case, 10**9),
        lambda: tc.convergence_order(case, "rk4", outputs=10**9),
        lambda: tc.work_precision(case, outputs=10**9),
        lambda: tc.predictability(case, outputs=10**9),
        lambda: tc.long_run(case, "rk4", 1e-3, outputs=10**9),
    ):
        with pytest.raises(ValueError, match=r"^outputs is 10{9}, expected .* at most 10{7}"):
            call()


def test_large_structures_are_made():
    assert len(tc.prism_tower(1000).bars) == 3000
    assert len(tc.net(225, 225, 0.1, 0.1).strings) > 100_000
    validation.refuse_memory("rows is 1", 4e9, "things", 1.0)
    validation.refuse_time("rows is 1", 86_400.0, "things", 1.0)


@pytest.mark.parametrize("refuse", [validation.refuse_memory, validation.refuse_time])
@pytest.mark.parametrize("count", [np.inf, np.nan, 1e300])
def test_what_cannot_be_counted_is_refused(refuse, count):
    with pytest.raises(ValueError, match=r"^x is 1, which makes .* things, about"):
        refuse("x is 1", count, "things", 8.0)


def test_seeds_may_be_as_large_as_those_of_numpy():
    assert validation.whole_number("seed", 2**128 - 1, 0, validation.LARGEST_SEED) == 2**128 - 1


@pytest.mark.parametrize("value", [5e-324, 1e-71, 1.1e70, 1e308])
def test_numbers_whose_squares_leave_double_precision_are_refused(value):
    with pytest.raises(
        ValueError, match=r"^mass is .*, expected a positive .* in kg, between 1e-70 and 1e\+70"
    ):
        validation.positive_number("mass", value, "kg")
