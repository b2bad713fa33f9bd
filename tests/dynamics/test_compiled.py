"""Compiled functions: the same bits as CasADi's, kept in the cache, and nobody else's code."""

import errno
import os
import stat
import subprocess
import sys
import time
from itertools import product
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import machine_code
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.dynamics.machine_code import CompilerError, CompilerWarning, compiled, compiler
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.without_core import without_core

PROJECT = Path(__file__).parents[2]

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
needs_shell = pytest.mark.skipif(os.name == "nt", reason="a shell script stands for the compiler")
needs_owners = pytest.mark.skipif(os.name == "nt", reason="Windows has no modes of files")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch, compiled_quickly):
    """The cache folder of the test, in which libraries are those of users."""
    monkeypatch.setattr(machine_code, "FLAGS", compiled_quickly)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "tenscontrol"


def libraries(folder):
    return sorted(path for path in folder.iterdir() if path.suffix in (".so", ".dll"))


def square(name="square", factor=1.0):
    x = ca.SX.sym("x", 2)
    return ca.Function(name, [x], [factor * x**2], ["x"], ["y"])


def bits(array):
    """The bits of numbers; what is not a number may have either sign."""
    return np.where(np.isnan(array), np.nan, array).view(np.int64)


def same_bits(one, other):
    return all(np.array_equal(bits(a), bits(b)) for a, b in zip(one, other, strict=True))


# ---- the same numbers ----


def prism_slope():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.1))
    x = np.concatenate([prism.nodes.ravel(order="F"), np.zeros(18)])
    return (
        model.equation("rest_length").kinked_slope,
        x,
        rest_lengths(prism, paper_force_density(9.0), 100.0),
    )


def rk4_graph(slope):
    """One step as a graph that calls the slope, rather than four copies of it."""
    x, u, h = (ca.MX.sym("x", slope.size1_in(0)), ca.MX.sym("u", slope.size1_in(1)), ca.MX.sym("h"))
    k1 = slope(x, u)
    k2 = slope(x + h / 2 * k1, u)
    k3 = slope(x + h / 2 * k2, u)
    k4 = slope(x + h * k3, u)
    return ca.Function("step", [x, u, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])


@needs_compiler
def test_a_motion_has_the_same_bits():
    """512 steps of the prism with strings that go slack and taut."""
    slope, x, rest = prism_slope()
    step = rk4_graph(slope)
    steps = 512
    chunk = step.mapaccum("chunk", steps)
    inputs = (x, np.tile(rest, (steps, 1)).T, np.full(steps, 1e-3))
    fast = compiled(chunk)
    plain, quick = Evaluator(chunk)(*inputs), Evaluator(fast)(*inputs)
    assert np.isfinite(plain[0]).all()
    assert np.abs(plain[0][:, -1] - x).max() > 0.1  # it moves
    assert same_bits(plain, quick)


@needs_compiler
def test_random_states_have_the_same_bits():
    slope, x, rest = prism_slope()
    fast = compiled(slope)
    plain, quick = Evaluator(slope), Evaluator(fast)
    rng = np.random.default_rng(seed=1)
    for _ in range(200):
        state = x + rng.normal(size=x.size)
        assert same_bits(plain(state, rest), quick(state, rest))


SPECIAL = [0.0, -0.0, 1 / 3, -2.5, 5e-324, 1e308, np.inf, -np.inf, np.nan, 0.1, 1e-9, 700.0]


def one_of_each(x):
    """What expressions are made of."""
    y = x + 0.7
    simple = [x + y, x - y, x * y, x / y, x**3, x**2.5, x**-0.5, ca.fabs(x) ** y, -x, 1 / x]
    simple += [f(x) for f in (ca.sqrt, ca.sin, ca.cos, ca.tan, ca.exp, ca.log, ca.tanh, ca.atan)]
    simple += [ca.atan2(x, y), ca.fmin(x, y), ca.fmax(x, y), ca.sign(x), ca.floor(x), ca.fmod(x, y)]
    simple += [x < y, ca.logic_and(x > 0, y < 1), ca.if_else(x > 0.1, x, y), ca.if_else(x, y, 0)]
    return ca.horzcat(*simple)


@needs_compiler
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_every_operation_has_the_same_bits(kind):
    x = kind.sym("x", len(SPECIAL))
    function = ca.Function("each", [x], [one_of_each(x)])
    assert same_bits(Evaluator(function)(SPECIAL), Evaluator(compiled(function))(SPECIAL))


@needs_compiler
def test_constants_have_the_same_bits():
    x = ca.SX.sym("x")
    function = ca.Function("constants", [x], [ca.if_else(x, ca.SX(ca.DM(SPECIAL)), x)])
    assert same_bits(Evaluator(function)(1.0), Evaluator(compiled(function))(1.0))


def branching():
    """A graph with short-circuit branches, a loop, a fold, a map and matrix products."""
    x, n = ca.MX.sym("x", 3), ca.MX.sym("n")
    grow = ca.Function("grow", [x], [ca.sin(3 * x) + x])
    shrink = ca.Function("shrink", [x], [x / 3 - ca.dot(x, x)])
    turn = ca.Function("turn", [x], [ca.mtimes(ca.DM([[0, 1, 0], [0, 0, 1], [1, 0.5, 0]]), x)])
    either = ca.Function.if_else("either", grow, shrink)
    which = ca.Function.conditional("which", [grow.fold(7), shrink], turn)
    y = either(ca.sumsqr(x) > 2, x) + ca.if_else(n > 1, turn(x), grow(x), True)
    return ca.Function(
        "branching", [x, n], [which(n, y), ca.sum2(grow.map(4)(ca.repmat(y, 1, 4) * n))]
    )


@needs_compiler
def test_graphs_with_branches_have_the_same_bits():
    function = branching()
    assert "Switch" in {part.class_name() for part in function.find_functions()}
    fast = compiled(function)
    for n, size in product((0, 1, 2), (0.1, 3.0)):
        x = size * np.array([0.3, -0.4, 0.9])
        assert same_bits(Evaluator(function)(x, n), Evaluator(fast)(x, n)), (n, size)


@needs_compiler
def test_the_signature_is_the_same():
    x, y = ca.MX.sym("x", ca.Sparsity.lower(3)), ca.MX.sym("y", 3)
    function = ca.Function("f", [x, y], [x + x, x @ y, y.T], ["lower", "y"], ["twice", "z", "t"])
    fast = compiled(function)
    assert fast.name() == "f"
    assert fast.name_in() == ["lower", "y"]
    assert fast.name_out() == ["twice", "z", "t"]
    for i in range(2):
        assert fast.sparsity_in(i) == function.sparsity_in(i)
    for i in range(3):
        assert fast.sparsity_out(i) == function.sparsity_out(i)
    lower, vector = ca.DM(ca.Sparsity.lower(3), [1, 2, 3, 4, 5, 6]), [1.0, 2.0, 3.0]
    for a, b in zip(function(lower, vector), fast(lower, vector), strict=True):
        assert float(ca.norm_inf(ca.densify(a - b))) == 0


@needs_compiler
def test_functions_of_one_name_do_not_get_in_each_others_way():
    """Also with names that the C library has, and over the threads of a map."""
    x = np.array([3.0, 4.0])
    made = [compiled(square("gamma", factor)) for factor in (1.0, 2.0, 3.0)]
    for factor, function in zip((1.0, 2.0, 3.0), made, strict=True):
        np.testing.assert_array_equal(function(x).full().ravel(), factor * x**2)
        columns = np.arange(16.0).reshape(2, 8)
        many = np.array(function.map(8, "thread", 2)(columns))
        np.testing.assert_array_equal(many, factor * columns**2)


@needs_compiler
def test_it_works_inside_further_graphs():
    slope, x, rest = prism_slope()
    fast = compiled(slope)
    plain, quick = (Evaluator(rk4_graph(f).fold(10)) for f in (slope, fast))
    inputs = (x, np.tile(rest, (10, 1)).T, np.full(10, 1e-3))
    assert same_bits(plain(*inputs), quick(*inputs))


@needs_compiler
def test_what_is_compiled_is_not_compiled_again():
    x = ca.MX.sym("x", 2)
    outer = ca.Function("outer", [x], [compiled(square())(x) + 1])
    with pytest.raises(ValueError, match="function calls 'square', which is compiled already"):
        compiled(outer)


def test_arguments_are_checked():
    with pytest.raises(TypeError, match="function is a str, expected Function"):
        compiled("f")
    with pytest.raises(ValueError, match="timeout is -1, expected a positive"):
        compiled(square(), timeout=-1)
    with pytest.raises(ValueError, match=r"timeout is 10+\.0, .* in s, between 1e-70 and 86400"):
        compiled(square(), timeout=1e15)


# ---- the compiler ----


def script(path, text):
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


@pytest.fixture
def counting(tmp_path, monkeypatch):
    """The compiler, with a record of what it was asked to make. Returns a counter."""
    real = compiler()[0]
    record = tmp_path / "record"
    record.touch()
    path = script(
        tmp_path / "counting",
        f'echo make >> "{record}"; exec "{real}" "$@"',
    )
    monkeypatch.setenv("TENSCONTROL_COMPILER", str(path))
    return lambda: len(record.read_text().splitlines())


def test_it_can_be_switched_off(monkeypatch, cache):
    monkeypatch.setenv("TENSCONTROL_COMPILER", "none")
    assert compiler() is None
    assert compiled(square()) is None
    assert not cache.exists()


def test_a_machine_may_have_no_compiler(monkeypatch, tmp_path):
    for name in ("TENSCONTROL_COMPILER", "CC"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert compiler() is None
    assert compiled(square()) is None


@needs_shell
def test_compilers_are_looked_for_in_order(monkeypatch, tmp_path):
    for name in ("gcc", "clang", "mine", "yours"):
        script(tmp_path / name, "exit 1")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("TENSCONTROL_COMPILER", raising=False)
    monkeypatch.delenv("CC", raising=False)
    assert compiler() == (str(tmp_path / "gcc"),)
    monkeypatch.setenv("CC", "mine -m64")
    assert compiler() == (str(tmp_path / "mine"), "-m64")
    monkeypatch.setenv("TENSCONTROL_COMPILER", "yours")
    assert compiler() == (str(tmp_path / "yours"),)


@pytest.mark.parametrize("variable", ["CC", "TENSCONTROL_COMPILER"])
def test_a_compiler_that_is_not_there_is_no_silent_matter(monkeypatch, variable):
    monkeypatch.delenv("TENSCONTROL_COMPILER", raising=False)
    monkeypatch.setenv(variable, "nowhere/cc")
    with pytest.raises(CompilerError, match=f"{variable} is 'nowhere/cc', and there is no such"):
        compiled(square())


@pytest.mark.parametrize("variable", ["CC", "TENSCONTROL_COMPILER"])
def test_a_compiler_with_an_open_quotation_is_named(monkeypatch, variable):
    monkeypatch.delenv("TENSCONTROL_COMPILER", raising=False)
    monkeypatch.setenv(variable, "'x")
    with pytest.raises(CompilerError, match=f'{variable} is "\'x", expected a program.*or CC'):
        compiled(square())


# A compiler that writes what is no library to what follows -o.
RUBBISH = 'while [ "$1" != -o ]; do shift; done; echo rubbish > "$2"'


@needs_shell
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("echo out of order >&2; exit 3", "(?s)exit status 3.*=none to run without.*out of order"),
        ("exit 0", "wrote no library"),
        (RUBBISH, "cannot be loaded.*XDG_CACHE_HOME"),
    ],
)
def test_a_broken_compiler_is_reported(monkeypatch, tmp_path, cache, text, message):
    path = script(tmp_path / "broken", text)
    monkeypatch.setenv("TENSCONTROL_COMPILER", str(path))
    with pytest.raises(CompilerError, match=message):
        compiled(square())
    assert libraries(cache) == []


@pytest.fixture(params=["broken", "unloadable", "full"])
def failing(request, tmp_path, monkeypatch):
    """A compiler that fails, or no room for its code; returns what the warning says."""
    if request.param == "full":

        def write_file(path, *_, **__):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

        monkeypatch.setattr(machine_code, "write_file", write_file)
        return "No space left on device"
    if os.name == "nt":
        pytest.skip("a shell script stands for the compiler")
    text, said = {
        "broken": ("echo out of order >&2; exit 3", "(?s)exit status 3.*out of order"),
        "unloadable": (RUBBISH, "invalid ELF|too short|not a mach-o"),
    }[request.param]
    path = script(tmp_path / "broken", text)
    monkeypatch.setenv("TENSCONTROL_COMPILER", str(path))
    return said


@needs_compiler
class TestAFailingCompilerStopsNothing:
    def model(self):
        return tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))

    def test_a_large_structure(self, failing):
        model = tc.Model(tc.prism_tower(30), strings=tc.LinearStrings(100.0))
        with pytest.warns(CompilerWarning, match=failing):
            equation = model.equation("rest_length")
        assert equation.form == "mapped"
        assert model.equation("rest_length") is equation  # nothing is tried again

    def test_controllers(self, failing):
        plant = tc.linearize(
            self.model(), tc.prestress(tc.prism(), force_density=17.3205), input="rest_length"
        )
        nodes, still = tc.prism().nodes, np.zeros((3, 6))
        plain = tc.NMPC(plant, sample_time=0.02, horizon=3).command(0.0, nodes, still).value
        with without_core(), pytest.warns(CompilerWarning, match=failing):
            controller = tc.NMPC(plant, sample_time=0.02, horizon=3, machine_code=True)
        value = controller.command(0.0, nodes, still).value
        np.testing.assert_allclose(value, plain, rtol=1e-9)


@needs_shell
def test_a_long_complaint_is_cut_short(monkeypatch, tmp_path):
    path = script(tmp_path / "wordy", "seq 1 1000; exit 1")
    monkeypatch.setenv("TENSCONTROL_COMPILER", str(path))
    with pytest.raises(CompilerError) as error:
        compiled(square())
    assert str(error.value).splitlines()[-1] == "  8"


@needs_shell
def test_a_compiler_that_takes_too_long_is_stopped(monkeypatch, tmp_path, cache):
    path = script(tmp_path / "slow", "exec sleep 60")
    monkeypatch.setenv("TENSCONTROL_COMPILER", str(path))
    began = time.monotonic()
    with pytest.raises(CompilerError, match=r"stopped after 0\.3 s"):
        compiled(square(), timeout=0.3)
    assert time.monotonic() - began < 40.0
    assert libraries(cache) == []


@needs_compiler
@pytest.mark.filterwarnings("ignore")
def test_what_cannot_be_written_in_c_is_reported():
    class Twice(ca.Callback):
        def __init__(self):
            ca.Callback.__init__(self)
            self.construct("twice", {})

        def eval(self, arguments):
            return [2 * arguments[0]]

    twice, x = Twice(), ca.MX.sym("x")
    with pytest.raises(CompilerError, match="Code generation not supported for CallbackInternal"):
        compiled(ca.Function("f", [x], [twice(x)]))


# ---- the cache ----


@needs_compiler
@needs_shell
def test_the_second_time_nothing_is_compiled(counting, cache):
    for _ in range(2):
        compiled(square())
        assert counting() == len(libraries(cache)) == 1
    compiled(square(factor=2.0))
    assert counting() == len(libraries(cache)) == 2


@needs_compiler
@needs_shell
def test_another_compiler_makes_another_library(tmp_path, monkeypatch, cache):
    compiled(square())
    monkeypatch.setenv("CC", str(script(tmp_path / "other", f'exec "{compiler()[0]}" "$@"')))
    monkeypatch.delenv("TENSCONTROL_COMPILER", raising=False)
    compiled(square())
    assert len(libraries(cache)) == 2


@needs_compiler
@needs_owners
def test_nobody_else_can_read_or_write_the_cache(cache):
    before = os.umask(0)
    try:
        compiled(square())
    finally:
        os.umask(before)
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700


PROGRAM = """
import pathlib, time
import casadi as ca
from tenscontrol.dynamics import machine_code
x = ca.SX.sym("x", 2)
function = ca.Function("square", [x], [x**2], ["x"], ["y"])
print("ready", flush=True)
while not pathlib.Path({go!r}).exists():
    time.sleep(0.005)
made = machine_code.compiled(function)
assert made([3, 4]).full().ravel().tolist() == [9, 16]
print(machine_code._cache_folder())
"""


def start(tmp_path):
    """Start another process that compiles when the file ``go`` is there."""
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(go=str(tmp_path / "go"))],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
    )  # fmt: skip


def end(process):
    """Return the cache folder that it used."""
    out, fault = process.communicate(timeout=60)
    assert process.returncode == 0, fault
    return Path(out.splitlines()[-1])


@needs_compiler
@needs_shell
def test_processes_may_want_the_same_at_once(counting, cache, tmp_path):
    processes = [start(tmp_path) for _ in range(2)]
    for process in processes:
        process.stdout.readline()
    (tmp_path / "go").touch()
    assert [end(process) for process in processes] == [cache] * 2
    assert counting() == len(libraries(cache)) == 1


@needs_compiler
@needs_shell
def test_a_damaged_library_is_reported_once_and_compiled_again(counting, cache, tmp_path):
    (tmp_path / "go").touch()
    end(start(tmp_path))
    (library,) = libraries(cache)
    library.write_bytes(library.read_bytes()[:100])
    with pytest.raises(CompilerError, match="cannot be loaded"):
        compiled(square())
    assert compiled(square())([3, 4]).full().ravel().tolist() == [9, 16]
    assert counting() == 2


@needs_compiler
@needs_shell
def test_without_a_cache_libraries_go_with_the_process(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    (tmp_path / "go").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    folder = end(start(tmp_path))
    assert tmp_path not in folder.parents
    assert not folder.exists()


@needs_compiler
@pytest.mark.skipif(os.name == "nt", reason="Windows has a place of its own")
def test_the_cache_is_where_the_system_wants_it(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    compiled(square())
    inside = "Library/Caches" if sys.platform == "darwin" else ".cache"
    assert libraries(tmp_path / inside / "tenscontrol")


# ---- code of others ----


@needs_compiler
@needs_owners
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_from_a_folder_that_others_may_write_to_nothing_is_loaded(monkeypatch, cache, mode):
    compiled(square())
    cache.chmod(mode)
    with monkeypatch.context() as patch:
        patch.setattr(ca, "external", None)  # not to be called
        with pytest.raises(PermissionError, match=r"other users may write.*chmod 700.*=none"):
            compiled(square())
    cache.chmod(0o700)
    compiled(square())


@needs_compiler
@needs_owners
def test_from_a_folder_of_another_user_nothing_is_loaded(monkeypatch, cache):
    compiled(square())
    mine = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    monkeypatch.setattr(ca, "external", None)  # not to be called
    with pytest.raises(PermissionError, match="is not loaded from"):
        compiled(square())
