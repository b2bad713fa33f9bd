"""Every benchmark runs, cut short, and figures of its table are what they must be."""

import re
import sys
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from shutil import which
from types import SimpleNamespace

import numpy as np
import pytest

from tenscontrol.core.library import library
from tenscontrol.dynamics.machine_code import VARIABLE, compiler
from tests.marks import needs_core

BENCHMARKS = Path(__file__).parent / "benchmarks"

pytestmark = pytest.mark.benchmark

NMPC_BACK_END = "virtual machine" if library() is None else "core"

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


def needs(package, extra):
    return pytest.mark.skipif(
        find_spec(package) is None, reason=f"{package} is not installed (extra {extra})"
    )


def test_every_benchmark_is_tested():
    there = {path.stem for path in BENCHMARKS.glob("*.py") if not path.stem.startswith("test_")}
    there -= {"__init__", "command_line", "extreme_cases", "rk4_peers"}
    there -= {
        "filter_code",
        "rolling_code",
        "least_mass",
    }  # tests of deploy and sizing run parts of these
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert there == tested - {
        "batch_controlled",
        "batch_of_some_programs",
        "every_benchmark_is_tested",
    }


@pytest.fixture
def printed(capfd):
    """Runs a benchmark with a command line, and returns what it prints."""

    def run(name, arguments=""):
        import_module(f"tests.benchmarks.{name}").main(arguments.split())
        return capfd.readouterr().out

    return run


@pytest.fixture
def processes_run_here(monkeypatch):
    """For a benchmark whose rows are processes that import all: their programs run in this one."""

    def run(command, **how):
        monkeypatch.setattr(sys, "argv", command[2:])
        with redirect_stdout(StringIO()) as out:
            exec(compile(command[2], "program", "exec"), {})
        return SimpleNamespace(stdout=out.getvalue())

    def put(module):
        monkeypatch.setattr(module, "subprocess", SimpleNamespace(run=run))

    return put


@pytest.fixture
def nothing_compiled(monkeypatch):
    """For what takes longer to compile than to run: the numbers are the same."""
    monkeypatch.setenv(VARIABLE, "none")


@pytest.fixture
def jax_compiles_quickly(monkeypatch):
    """For peers in JAX: what it compiles takes longer to compile than to run."""
    monkeypatch.setenv("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
    monkeypatch.setattr(import_module("tests.benchmarks.rk4_peers"), "_AT_ONCE", 1)


def row(text, label, which=0):
    """Return the numbers of a line that begins so, of several the one with this index."""
    lines = [line for line in text.splitlines() if line.startswith(label)]
    return [
        float(x) for x in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]\d+)?", lines[which][len(label) :])
    ]


def test_reference_distance(printed):
    text = printed("reference_distance", "prism --shares 0.4 --ways sideways")
    rows = [line.split() for line in text.splitlines()[1:]]
    assert {line[2] for line in rows} == {"sideways"}
    assert [(line[1], line[3], line[-1]) for line in rows] == [
        ("rest_length", "40", "no"), ("force_density", "40", "yes"),
    ]  # fmt: skip


def test_arm_shape(printed):
    text = printed("arm_shape", "--runs 1 --stages 2")
    (nodes, *_), (untold, *_) = (row(text, name) for name in ("told what winches do", "not told"))
    assert 0 < nodes < 5
    assert 0 < untold < 10
    assert row(text, "published") == [2.1]


def test_driven_choices(printed):
    text = printed("driven_choices", "--start 3 --count 1 --each --struts")
    assert "silent: 0" in text
    assert text.count(" stable") >= 2


@needs_core
@needs("mujoco", "test")
def test_stepping(printed):
    text = printed("stepping", "--counts 1 --parts 5 10 --rounds 1 --seconds 0.001")
    for name in ("Stepper", "MuJoCo rk4", "MuJoCo implicitfast"):
        (_, coarse, *rates), (_, fine, *_) = (row(text, name + " " * 4, k) for k in (0, 1))
        assert 0 < fine < coarse < 0.05
        assert min(rates) > 0
    assert min(row(text, "with parameters of their own")) > 0


def test_motor_substeps(printed, monkeypatch):
    module = import_module("tests.benchmarks.motor_substeps")
    monkeypatch.setattr(module, "MOTORS", {"torque alone": {}})
    text = printed("motor_substeps", "--substeps 2 4 --finest 16")
    few, more = row(text, "torque alone"), row(text, "torque alone", 1)
    assert more[1] < 0.5 * few[1]  # rest length, after the substeps
    assert 0.5 < few[3] / few[1] < 3


def test_driven_bars(printed, monkeypatch):
    module = import_module("tests.benchmarks.driven_bars")
    monkeypatch.delitem(module.HOW, "cvodes")
    monkeypatch.setitem(module.HOW, "dop853", [{"tolerance": 1e-12}])
    monkeypatch.setattr(module, "STRUCTURES", {"tower": module.STRUCTURES["tower"]})
    text = printed("driven_bars", "--duration 0.5")
    assert 3.7 < row(text, "rk4", 2)[3] < 4.3
    _, _, angle, work, length, spin = row(text, "dop853")
    assert max(angle, work, length, spin) < 1e-9
    assert max(row(text, "tower")[:2]) < 1e-11


def test_model_cost(printed):
    text = printed("model_cost", "--calls 10")
    assert row(text, "γ held  ") == [316, 2]
    assert row(text, "γ held, load as an input")[1] == 3
    assert row(text, "rest length held, damped")[0] > row(text, "rest length held  ")[0]
    plane, space = (row(text, name) for name in ("a D-bar in the plane", "the same in space"))
    assert plane[0] < 0.7 * space[0]
    assert "µs through the buffer" in text


@needs_compiler
def test_coupled_cost(printed, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    text = printed("coupled_cost", "--stages 1 3 --turns 1 --members 300")
    assert len(re.findall("flat .* mapped .* loops ", text)) == 4
    assert text.count("largest over smallest") == 6


@needs_compiler
def test_oracle_agreement(printed, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    text = printed("oracle_agreement", "--structures 3 --motions 1")
    for name in ("λ ", "flat", "mapped", "loops"):
        assert row(text, name)[0] < 1e-12
    assert row(text, "motions")[0] < 1e-10


def test_suite(printed):
    text = printed("suite", "--quick --only grazing")
    assert text.splitlines()[0].split()[:5] == ["case", "truth", "growth", "rk4", "dop853"]
    assert "6 runs: 5 accurate" in text


def test_frontier(printed, monkeypatch):
    monkeypatch.setattr(import_module("tests.benchmarks.frontier"), "SHORT", 2e-3)  # s
    text = printed("frontier", "--count 0 --library 1 --limit 0.01 --methods rk4 dop853 --cells")
    assert "library in the air: prism, massless strings, 1e-02: ms " in text
    assert text.count("  library in the air: 7 cells") == 2  # time and evaluations
    assert text.count("  long run, energy: 7 cells") == 2


def test_growth(printed, monkeypatch):
    module = import_module("tests.benchmarks.growth")
    module.forget_peak()
    monkeypatch.setattr(module, "forget_peak", lambda: None)  # takes longer than most routines
    text = printed("growth", "--stages 1 2 --whole 2 --repeats 1")
    for what in import_module("tests.benchmarks.growth").ROUTINES:
        lines = [line for line in text.splitlines() if line.startswith(f"{what} ")]
        assert len(lines) >= 4, what  # time and memory of two towers
    assert "failed" not in text
    assert "needs" not in text
    for what in ("prestress at a level", "prestress, all taut", "bars of a given γ"):
        assert row(text, f"     2  {what}")[0] < 1e-8
    assert row(text, "     2  counts and verdicts")[0] == 0.0
    for what in ("20 lowest stiffnesses", "20 lowest modes"):
        assert row(text, f"     2  {what}")[0] < 1e-8


@needs_core
@needs_compiler
def test_member_cost(printed, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    text = printed("member_cost", "--bars 3 30 --turns 1 --members 1000")
    for held in (0, 1):
        assert row(text, "      3       12 ", held)
        assert row(text, "     30      228 ", held)
    # It asserts itself that all give the same numbers.
    forms = [line.split()[-1] for line in text.splitlines() if " s " in line]
    assert forms == ["flat", "mapped"] * 2
    assert list(tmp_path.iterdir()) == []  # the folder of compiled functions is its own


def test_bar_crossings(printed):
    text = printed("bar_crossings", "--stages 4 --repeats 1")
    assert row(text, "ball, 5 s")[2] == 0
    for label in ("prism, 1.5 s", "prism, ends alone"):
        assert row(text, label)[2:] == [12, 0.1386]


def test_stiff_strings(printed, nothing_compiled):
    text = printed("stiff_strings", "--duration 0.01 --segments 2")
    assert "0.01 s, nodes move up to 0.01 m" in text
    evaluations = row(text, "             rk4")[2]
    assert evaluations > 30_000
    for k, step in enumerate((1e-3, 5e-4, 2.5e-4)):
        found = row(text, " energy_momentum", k)
        assert found[0] == step
        assert found[1] < 1e-5
        assert found[2] < 0.01 * evaluations


def test_coupled_bars(printed):
    text = printed("coupled_bars", "--duration 1")
    orders = [float(order) for order in re.findall(r"order +(\S+)", text)]
    for found, order in zip(orders, (4, 2, 8), strict=True):
        assert order - 0.3 < found < order + 0.5
    assert max(row(text, "  energy_momentum", 1)) < 1e-12
    assert row(text, "  rk4 ", 1)[0] < 1e-8


def test_ground_motions(printed, monkeypatch):
    module = import_module("tests.benchmarks.ground_motions")
    monkeypatch.setattr(module, "SCENES", {"ball": module.SCENES["ball"]})
    few = partial(module.resting, copies=1)
    monkeypatch.setattr(module, "resting", lambda on_ground, _: few(on_ground))
    text = printed("ground_motions", "--duration 0.3 --rest 0.1")
    for error in re.findall(r"farthest node, m +(.*)", text):
        assert max(map(float, error.split())) < 1e-11
    assert "0 not located" in text
    orders = [float(order) for order in re.findall(r"order +(\S+)", text)]
    assert len(orders) == 1
    assert orders[0] > 3.8


@needs_core
def test_mpc_step(printed):
    text = printed("mpc_step", "--duration 0.1 --lengths 5 --tower 1 --horizon 4")
    ramp, push = map(int, re.findall(r"samples with a bound active: (\d+)", text))
    assert ramp == 0
    assert 2 < push <= 5
    assert len(re.findall(r"^  (?:stages|osqp), (?:updated|built anew) ", text, re.M)) == 8
    assert row(text, "        5 ")[0] == 45
    *_, changes, median, late = map(float, text.splitlines()[-1].split())
    assert changes >= 0
    assert 0 < median <= late


def test_stiffness(printed):
    text = printed("stiffness", "--stiffness 100")
    ratio, pushed, moved, rate, *by_length = row(text, "100 ")
    assert 0.5 < ratio < 1.0
    assert 0.05 < rate < 0.2  # 1/s
    assert moved < 0.1  # mm
    assert by_length[1] < 0.1
    assert max(pushed, by_length[0]) < 0.5
    assert text.count("holds within 1 mm at all that was tried") == 4


@needs_core
def test_qp_solvers(printed):
    text = printed("qp_solvers", "--starts 1 --samples 6 --lengths 4")
    assert "horizon 4: 6 programs, 36 inputs" in text
    errors = {"stages": 1e-9, "OSQP, sparse": 1e-9}
    errors |= {"PIQP multistage, sparse": 1e-2} if find_spec("piqp") else {}
    errors |= {"DAQP, dense": 1e-9} if find_spec("daqp") else {}
    errors |= {"quadprog, dense": 1e-9} if find_spec("quadprog") else {}
    for name, most in errors.items():
        times, worst = row(text, name)[::2], row(text, name)[1::2]
        assert len(times) == len(worst) >= 1
        assert max(worst) < most
    assert row(text, "stages")[0] == 1.0


@needs_core
def test_exact_commands(printed):
    text = printed("exact_commands", "--count 2 --only d_bar")
    assert "8 commands, 8 compared" in text
    assert "0 off by more than 1e-09" in text
    assert text.startswith("8 commands")
    assert "status: {'ok': 8}" in text


def test_contact_estimation(printed, monkeypatch):
    module = import_module("tests.benchmarks.contact_estimation")
    monkeypatch.setattr(module, "normalized_errors", lambda *_: (1.0, 1.0))  # estimation has them
    text = printed("contact_estimation", "--seeds 1 --structures 1")
    places, rates, places_by_load, rates_by_load, *_ = row(text, "x")
    assert 2 * places < places_by_load
    assert 4 * rates < rates_by_load


def test_filter_consistency(printed, monkeypatch):
    kinds = import_module("tests.benchmarks.filter_consistency").KINDS
    for name in list(kinds)[1:]:  # tests/estimation has them all
        monkeypatch.delitem(kinds, name)
    text = printed("filter_consistency", "--runs 2")
    assert "outside" not in text
    assert len(text.splitlines()) == 1 + 2


def test_nmpc_contact(printed):
    text = printed("nmpc_contact", "--scenes 1 --duration 1.1")
    sample, horizon, steps, clear, median, largest, *_ = row(text, "x")
    assert (sample, horizon, steps) == (0.02, 15, 7)
    assert clear > 0.1
    assert 0 < median < largest < 5
    assert f"{NMPC_BACK_END}; commands: 55 ok" in text


@needs("do_mpc", "bench")
def test_nmpc_step(printed, nothing_compiled):
    text = printed("nmpc_step", "--starts 3 --samples 3 --horizon 3")
    assert "3 starts, 3 samples each; a bound active in 1 commands of NMPC" in text
    # Nothing is compiled.
    assert f"NMPC: {NMPC_BACK_END}; with own laws, compiled: virtual machine" in text
    cost = {name: row(text, name)[0] for name in (
        "NMPC  ", "own law, compiled", "own law  ", "NMPC, converged", "MPC, linear",
        "IPOPT (nlpsol)", "do-mpc (IPOPT)",
    )}  # fmt: skip
    assert cost["IPOPT (nlpsol)"] == 1.0
    assert cost["do-mpc (IPOPT)"] == pytest.approx(1.0, abs=1e-5)
    assert cost["NMPC, converged"] == pytest.approx(1.0, abs=1e-4)
    assert cost["NMPC  "] == cost["own law, compiled"] == cost["own law  "]
    assert cost["NMPC  "] == pytest.approx(1.0, abs=1e-3)
    assert abs(cost["MPC, linear"] - 1.0) > 1e-2


def test_nmpc_large(printed):
    text = printed("nmpc_large", "--starts 1 --samples 4 --horizon 4 --stages 2")
    assert "tower, 2 stages: 6 bars, 30 winches" in text
    for structure in (0, 1):
        found = {name: row(text, name, structure) for name in (
            "core  ", "core, all anew", "own law",
        )}  # fmt: skip
        assert found["core, all anew"][4:6] == [4.0, 1.0]
        for name in ("core  ", "own law"):
            assert 0 <= found[name][4] < 3
            assert found[name][5] == pytest.approx(1.0, abs=1e-3)


def test_installations(printed):
    case = "--kinds NMPC --structures prism --inputs forces --horizons 3"
    text = printed("installations", f"{case} --starts 1 --samples 3 --repeats 1 --interpreted")
    assert "NMPC, prism, forces, 3 samples: 18 states, 9 inputs; cost 1.000000" in text
    assert row(text, "  prepare()  median")[0] > 0


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="Linux alone tells the memory")
def test_many_models(printed):
    text = printed("many_models", "--count 7")
    rows = np.array([list(map(float, line.split())) for line in text.splitlines()[1:]])
    memory, mappings, files = rows[4:, 1:4].T  # the first ones import
    assert np.ptp(memory) < 4.0  # MB
    assert np.ptp(mappings) < 10
    assert np.ptp(files) == 0


@needs_compiler
@pytest.mark.skipif(which("size") is None, reason="there is no program size")
def test_deploy(printed):
    text = printed("deploy", "--samples 60 --controllers 1")
    difference, _, iterations, code, numbers = row(text, "LQR")
    assert difference < 1e-10
    assert iterations == 0
    assert min(code, numbers) > 1


def test_robustness(printed, monkeypatch):
    monkeypatch.setenv("TENSCONTROL_COMPILER", "none")
    module = import_module("tests.benchmarks.robustness")
    monkeypatch.setattr(module, "MANY", 2)
    monkeypatch.setattr(sys.modules["tenscontrol.robustness.monte_carlo"], "_WORTHWHILE", 2)
    text = printed("robustness", "--scenes ball --count 2 --alone 1 --duration 0.05")
    assert re.search(r"\n +2 .* up to 64 together, in compiled loops", text)
    assert "equal to the last bit: True" in text


def test_rolling(printed, monkeypatch, nothing_compiled):
    module = import_module("tests.benchmarks.rolling")
    runs = {}

    def once(case, drawn, count, **how):
        """In place of a sweep, which tests/robustness has: the nominal ball, here."""
        runs["steps"] = case({}, None).figures["steps"]
        return SimpleNamespace(summary=str)

    monkeypatch.setattr(module.tc, "sweep", once)
    text = printed("rolling", "--count 1 --steps 1 --slopes 5 --plans 1")
    assert runs == {"steps": 1}
    assert row(text, "slope of 5°: a command takes")[0] > 0


def test_shape_control(printed, monkeypatch):
    module = import_module("tests.benchmarks.shape_control")
    monkeypatch.setattr(module, "MOVES", module.MOVES[:1])  # no bound is in the way
    text = printed("shape_control", "--duration 0.1 --shares 0.15")
    for table in range(2):
        for name in ("MPC  ", "NMPC  "):
            assert row(text, name, table)[7] == 0  # commands whose status is not ok
        rms = [row(text, f"shape control, {hertz} Hz", table)[3] for hertz in (0.6, 1.2, 2.4)]
        assert rms == sorted(rms, reverse=True)
    decay = [row(text, name)[0] for name in (
        "γ held", "rest length held, 100 N/m", "rest length held, 1000 N/m",
        "rest length held, 10000 N/m",
    )]  # fmt: skip
    assert decay == sorted(decay, reverse=True)
    assert decay[0] > 1.0
    assert decay[-1] < 0.1


@needs_compiler
def test_optimal_goals(printed):
    text = printed("optimal_goals", "--structures arm --goals 1")
    found = row(text, "arm            ok")
    assert found[0] < found[1]  # on the path through equilibria
    assert found[4] < 1e-4
    assert row(text, "planned: 1") == []


def test_optimal_motions(printed):
    text = printed("optimal_motions", "--motions weight --finer 2")
    _, _, _, change, finer, times, off, _ = row(text, "weight     ok")
    assert 0 < finer < change < 1  # %
    assert times >= 2
    assert off < 1e-3


def test_sensitivities(printed):
    text = printed("sensitivities", "--seed 24 --count 1 --steps 200 --processes 1")
    assert "1 scenes, 1 judged" in text
    assert "above 1e-07: []" in text
    assert "beyond what differences are certain to: []" in text
    assert "switches 1" in text
    assert "left out, 0: " in text


def test_derivatives(printed, monkeypatch, jax_compiles_quickly):
    module = import_module("tests.benchmarks.derivatives")
    # JAX compiles for each step anew, for seconds, until it comes to an error of 1e-2 in reverse.
    monkeypatch.setattr(module, "grid", lambda coarsest, *_: (coarsest,))
    how = "--scenes switching --errors 1e-2 --repeats 1 --duration 0.1 --longest 0.1"
    text = printed("derivatives", how)
    for program in ("tenscontrol, sensitivity", "tenscontrol, central", "tenscontrol, gradient"):
        assert len(re.findall(rf"^1e-02  {program}.* [^-\s]+$", text, re.M)) == 1
    for program in beside("JAX, forward", "JAX, reverse"):
        assert len(re.findall(rf"^1e-02  {program} ", text, re.M)) == 1


def test_identification(printed):
    text = printed("identification", "--rows mujoco --count 1")
    assert "0 without, validated Validation(residuals 1.0" in text
    assert "of 20 intervals of 95 % hold" in text


def test_trust(printed, tmp_path):
    text = printed("trust", f"--seed 9 --count 1 --methods rk4 energy_momentum --cache {tmp_path}")
    assert "1 scenes: 1 ok" in text
    assert row(text, "rk4 ")[0] + row(text, "rk4 ")[1] == 3
    assert row(text, "all with fixed steps")[0] >= 5
    text = printed("trust", f"--scene 9 --methods rk4 --cache {tmp_path}")
    assert len(re.findall(r"rk4 .* (?:ok|stopped) ", text)) == 9


def test_trust_in_loops(printed):
    text = printed("trust_in_loops", "--seed 3 --count 2")
    for name in ("default call ", "tolerance 1e-4 "):
        judged, _, silent = row(text, name)[:3]
        assert (judged, silent) == (2, 0)
    assert "LQR" in printed("trust_in_loops", "--scene 36")


@needs("mujoco", "bench")
def test_exported_models(printed):
    text = printed("exported_models", "--names arm d_bar --steps 2e-3 1e-3 --duration 0.05")
    for name, order in (("arm", 4), ("d_bar", 2)):
        loops, *errors, fitted = row(text, f"{name} ")
        assert loops == (order == 2)
        assert errors == sorted(errors, reverse=True)
        assert fitted == pytest.approx(order, abs=0.6)


def test_morph(printed, nothing_compiled):
    text = printed("morph", "1000 --rate 1 --interpreted")
    stiffness, pieces, height, twist, node, gamma, tension, rate, *_ = row(text, " ")
    assert (stiffness, pieces, rate) == (1000, 20, 1.0)
    assert max(height, node) < 1.0  # mm; one plant is not enough at this rate
    assert twist < 0.5  # degrees
    assert gamma > 2.0
    assert tension < 45.0
    assert "{'ok': 135}" in text
    assert "out of range" not in text


def test_reduced_control(printed):
    text = printed("reduced_control", "--stages 5 --loop 8 --duration 2")
    assert float(re.search(r"^ +5 +\d+ .* (\S+)$", text, re.M)[1]) < 1e-8
    for law in ("LQR", "MPC"):
        assert row(text, law)[2] == pytest.approx(1, abs=0.05)


def cheapest(text, program):
    """Return setting, error, ms and ratio of each cheapest run of a program."""
    lines = re.findall(rf"^\S+  {program} +(\S+) +(\S+) +(\S+) +(\S+)$", text, re.M)
    return [[float(x) for x in line] for line in lines]


def test_cheapest():
    """Of three settings the coarsest that reaches the error is taken, and only it is timed."""
    module = import_module("tests.benchmarks.cheapest")
    calls = []

    def program(name, settings):
        def prepare(setting):
            return lambda: calls.append((name, setting)) or setting

        return module.Program(name, settings, prepare)

    programs = [program("one", module.grid(1.0, 0.5)), program("other", (4.0, 2.0))]
    first, other = module.cheapest(programs, float, [0.7], repeats=3)
    assert (first.setting, first.reached, first.ratio) == (0.64, 0.64, 1.0)
    assert np.isnan(other.setting)
    assert calls.count(("one", 0.64)) == 4
    assert calls.count(("one", 0.8)) == 1
    assert module.grid(1.0, 0.5) == pytest.approx([1, 0.8, 0.64, 0.512, 0.4096])


@needs("mujoco", "bench")
def test_overhead(printed, monkeypatch, processes_run_here):
    module = import_module("tests.benchmarks.overhead")
    monkeypatch.setattr(module, "IMPORTS", {"import tenscontrol": "import tenscontrol"})
    processes_run_here(module)
    text = printed("overhead", "--repeats 1")
    labels = ("import tenscontrol", "first call: tenscontrol", "first call: MuJoCo",
              "first call of a model, 5 s", "a later one of 0.1 ms")  # fmt: skip
    assert all(row(text, label)[-1] >= 0 for label in labels)


def beside(*names):
    """Return the programs whose package is installed, by the first word in lower case."""
    return [name for name in names if find_spec(re.split("[ ,]", name)[0].lower()) is not None]


@needs("mujoco", "bench")
def test_error_against_time(printed, monkeypatch, jax_compiles_quickly):
    module = import_module("tests.benchmarks.error_against_time")
    monkeypatch.setattr(module, "DIFFRAX", ("Dopri8",))
    text = printed(
        "error_against_time", "--scenes switching --duration 0.2 --errors 1e-3 --repeats 1"
    )
    assert "order 8, tolerance 1e-13" in text
    for program in beside(
        "tenscontrol, default call", "tenscontrol, no estimate", "tenscontrol, without the core",
        "JAX RK4", "Diffrax Dopri8",
        "scipy dop853", "mujoco rk4", "mujoco implicitfast",
    ):  # fmt: skip
        (found,) = cheapest(text, program)
        assert 0 < found[1] <= 1e-3


@needs("mujoco", "bench")
@pytest.mark.parametrize(("scene", "kind"), [("slack", np.float32), ("ground", np.float64)])
def test_batch(printed, monkeypatch, jax_compiles_quickly, scene, kind):
    module = import_module("tests.benchmarks.batch")
    monkeypatch.setattr(module, "BLOCKS", (5,))
    monkeypatch.setattr(module, "PRECISIONS", (kind,))
    text = printed(
        "batch", f"--structures prism --scenes {scene} --runs 5 --duration 0.1 --repeats 1"
        " --errors 1e-3",
    )  # fmt: skip
    for program in beside(
        "tenscontrol, default call", "tenscontrol, ends, no estimate", "NumPy RK4, blocks of 5",
        f"JAX RK4, {kind.__name__}, blocks of 5", "MuJoCo rollout RK4",
    ):  # fmt: skip
        (found,) = cheapest(text, program)
        assert 0 < found[1] <= 1e-3


def test_batch_of_some_programs(printed):
    text = printed(
        "batch", "--structures prism --scenes taut --runs 5 --duration 0.1 --repeats 1"
        " --errors 1e-3 --only ends",
    )  # fmt: skip
    (found,) = cheapest(text, "tenscontrol, ends, no estimate")
    assert 0 < found[1] <= 1e-3
    assert not {"default", "NumPy", "JAX", "MuJoCo"} & set(text.replace(",", " ").split())


@needs_compiler
def test_batch_controlled(printed):
    text = printed("batch", "--scenes controlled --runs 2 --duration 0.04 --repeats 1")
    for label in ("compiled, at once", "compiled, one by one"):
        assert row(text, label)[2] < 1e-12
    assert row(text, "Python, one by one")[2] < 1e-8


def test_towers(printed, monkeypatch, jax_compiles_quickly, processes_run_here):
    module = import_module("tests.benchmarks.towers")
    print_memory = module.print_memory
    monkeypatch.setattr(module, "print_memory", lambda stages, rows: print_memory(stages, rows[:1]))
    processes_run_here(module)
    text = printed(
        "towers", "--stages 3 --errors 1e-3 --repeats 1 --steps 4e-3 5e-4 --tolerances 1e-6"
    )
    assert "tower of 3 stages, 60 members, 55 switches" in text
    for program in beside("tenscontrol, default call", "NumPy RK4", "JAX RK4"):
        assert cheapest(text, program)[0][1] <= 1e-3
    for step in ("0.004", "0.0005"):
        found, missed, of_all, error, estimate, naive = row(text, f"rk4, {step} ")
        assert found > missed >= 0
        assert 0.95 < of_all < 1.05
        assert 0 < error < naive or step == "0.004"
        assert estimate > 0
    for label in ("the tower alone", "tenscontrol, default call"):
        assert row(text, label, -1)[0] > 0
