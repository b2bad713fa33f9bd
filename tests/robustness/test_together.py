"""Runs that go together: the numbers of one by one, and which cases they are of."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import compiler
from tests.robustness.cases import Inline, loop_case

RUNS, TOGETHER = 5, 3  # the last group is a part of one
POOL = sys.modules["tenscontrol.robustness.pool"]
SWEEP = sys.modules["tenscontrol.robustness.monte_carlo"]


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Some runs go together, few at a time."""
    monkeypatch.setattr(POOL, "_FEWEST", TOGETHER)
    monkeypatch.setattr(SWEEP, "_WORTHWHILE", 2)


@pytest.fixture
def no_compiler(monkeypatch):
    monkeypatch.setenv("TENSCONTROL_COMPILER", "none")


def one_by_one(case, monkeypatch):
    """Let runs of the case go one by one."""
    monkeypatch.setattr(tc.ClosedLoopCase, "alone", lambda *_: "asked for")
    return case


def thrown(structure, **changes):
    """A structure let go in open loop."""
    settings = {"duration": 0.1, "step": 5e-3, "tolerance": 0.1}
    strings = tc.LinearStrings(1000.0)
    lengths = 0.95 * structure.string_length(structure.nodes)
    settings |= {"rest_length": lengths, "gravity": 9.81, **changes}
    return loop_case(structure, strings, None, **settings)


def compare(case, drawn, monkeypatch, **options):
    """The report of runs together, after a comparison with one by one."""
    together = tc.sweep(case, drawn, RUNS, seed=0, executor=Inline(), **options)
    assert "together, in compiled loops" in together.summary()
    apart = tc.sweep(one_by_one(case, monkeypatch), drawn, RUNS, seed=0, executor=Inline())
    assert apart.back_end == "one by one: asked for"
    assert together == apart
    assert together._records == apart._records
    return together


def test_open_loops_have_the_bits_of_one_by_one(no_compiler, monkeypatch):
    ball = tc.library.six_bar_ball()
    drawn = {
        "stiffness": tc.Uniform(0.7, 1.3, size=24),
        "bar_mass": tc.Uniform(0.8, 1.2, size=6),
        "start": tc.Normal(0.0, 0.02, size=24),
    }
    report = compare(thrown(ball), drawn, monkeypatch)
    assert report.completed.all()
    assert set(report.figures) == {"final_error", "least_force_density", "largest_force_density"}
    assert len(np.unique(report.figure("final_error"))) == RUNS


def test_runs_that_fail_say_the_same(no_compiler, monkeypatch):
    stiff = {"stiffness": tc.OneOf([1.0, 1e4, -1.0]), "damping": tc.OneOf([0.0])}
    report = compare(thrown(tc.library.d_bar()), stiff, monkeypatch)
    assert {failure.error for failure in report.failures} == {"SimulationError", "ValueError"}
    assert report.completed.any()


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_compiled_controllers_have_the_bits_of_one_by_one(tmp_path, monkeypatch):
    structure, strings = tc.library.d_bar(), tc.LinearStrings(1000.0, damping=1.0)
    rest = tc.prestress(structure, min_force_density=20.0)
    plant = tc.linearize(tc.Model(structure, strings=strings), rest, input="rest_length")
    law = tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.02)
    code = tc.generate_c(law, tmp_path / "law").compile()
    case = loop_case(structure, strings, code, 0.11, 5e-3, 0.02)
    size = plant.degrees_of_freedom
    drawn = {"stiffness": tc.Uniform(0.7, 1.3), "start": tc.Normal(0.0, 0.01, size=size)}
    file = tmp_path / "runs.jsonl"
    part = tc.sweep(case, drawn, 3, seed=0, executor=Inline(), file=file)
    assert part.is_complete
    report = compare(case, drawn, monkeypatch, file=file)
    assert report.figure("largest_command").min() > 0
    assert len(file.read_text().splitlines()) == 2 + RUNS  # header, and the new count


def test_an_interrupt_keeps_the_groups_that_are_done(no_compiler, tmp_path):
    file, drawn = tmp_path / "runs.jsonl", {"stiffness": tc.Uniform(0.7, 1.3)}
    case = thrown(tc.library.d_bar())
    how = {"seed": 0, "file": file, "in_flight": 2}
    with pytest.warns(RuntimeWarning, match="interrupted with 3 of 5 runs done"):
        part = tc.sweep(case, drawn, RUNS, executor=Inline(interrupt_after=TOGETHER), **how)
    assert part.runs.tolist() == list(range(TOGETHER))
    executor = Inline()
    whole = tc.sweep(case, drawn, RUNS, executor=executor, **how)
    assert executor.runs == [0, *range(TOGETHER, RUNS)]
    assert whole.is_complete
    assert tc.robustness.SweepReport.load(file) == whole


@pytest.mark.parametrize(
    ("changes", "drawn", "why"),
    [
        ({"faults": [tc.CutString(0, 0.05)]}, {}, "faults given"),
        ({"ground": tc.Ground(1e4, height=-5.0)}, {}, "ground given"),
        ({}, {"bar_mass": tc.Uniform(0.9, 1.1)}, "masses of bars that share nodes vary"),
        ({"duration": 1e5, "step": 1e-3}, {"start": tc.Normal(0.0, 0.01)}, None),
        ({}, {}, "nothing varies"),
    ],
)
def test_what_goes_one_by_one(changes, drawn, why):
    case = thrown(tc.library.class2_tower(), **changes)
    assert case.alone(drawn) == why
    assert (case.at_a_time == 1) == ("step" in changes)
    assert case.alone({"noise": 1.0}) is not None


def test_controllers_in_python_and_winches_go_one_by_one(prism):
    strings = tc.LinearStrings(100.0, damping=0.5)
    plant = tc.linearize(
        tc.Model(prism, strings=strings), tc.prestress(prism, 17.32), input="rest_length"
    )
    law = tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.02)
    case = loop_case(prism, strings, law, 0.1, 5e-3, 0.02)
    assert case.alone({}).startswith("controller is a LQR, expected the compiled code of one")
    report = tc.sweep(case, {}, 2, seed=0, executor=Inline())
    assert report.back_end == f"one by one: {case.alone({})}"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rest_length": None}, "rest_length, force_density and controller; found neither"),
        ({"force_density": 20.0}, "found both"),
        ({"sample_time": 0.1}, "sample_time go with a controller"),
        ({"rest_length": -1.0}, "rest_length"),
    ],
)
def test_bad_input_in_open_loop_is_named(changes, said):
    with pytest.raises(ValueError, match=said):
        thrown(tc.prism(), **changes)


def test_force_densities_are_held(no_compiler):
    structure = tc.prism()
    gamma = tc.prestress(structure, 17.3205).force_density
    case = thrown(structure, rest_length=None, force_density=gamma, gravity=None)
    assert case({}, np.random.default_rng(0)).figures["final_error"] < 1e-9
    assert replace(case, tolerance=1.0).alone({"bar_mass"}) is None
    assert case.alone({"stiffness"}) == "strings vary whose rest lengths are not held"
