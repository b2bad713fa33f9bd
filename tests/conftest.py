"""What all tests share."""

import gc
import os
import signal
import subprocess
import sys
import sysconfig
import threading
import warnings
from pathlib import Path
from types import SimpleNamespace

if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # each worker has a core for itself

# A setting of some containers: each process that a test starts would compile all that it imports.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    sys.dont_write_bytecode = False

import numpy as np
import pytest
from hypothesis import settings

import tenscontrol as tc
from tenscontrol.deploy import compiled_controller
from tenscontrol.dynamics import machine_code
from tests.dynamics.scenes import TOP_FORCE_DENSITY, paper_force_density, rest_lengths
from tests.fuzz.sanitizers import LOOPS_OF_SOLVERS
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength

# Where no line of a user is: the package, Python's library, and what is not a file.
_NO_USERS = (str(Path(tc.__file__).parent), sysconfig.get_path("stdlib"), "sys", "<frozen")

# Property tests draw the same few examples on every run, so that a failure can be repeated;
# many others with ``pytest --hypothesis-profile=thorough``.
settings.register_profile("tenscontrol", deadline=None, derandomize=True, max_examples=12)
settings.register_profile("thorough", deadline=None, max_examples=500)
settings.load_profile("tenscontrol")

# A shell starts what runs in its background with Ctrl-C ignored, and tests of it would fail there.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file():
    """Tests have no doctests, and a search for them in all that they import takes seconds."""
    return [file for file in (yield) if type(file) is pytest.Module]


def pytest_collection_modifyitems(items):
    """Scenes that try the numerics may have bars that cross, and strings beside bars or others.

    Examples and pages may not.
    """
    tests = Path(__file__).parent
    for item in items:
        if tests in item.path.parents and item.path.parent != tests:
            crossing = "ignore::tenscontrol.simulation.BarCrossingWarning"
            beside = r"ignore:strings\[\d+\] joins nodes:UserWarning"
            item.add_marker(pytest.mark.filterwarnings(crossing, beside))


gc.set_threshold(10_000, 20, 20)  # searched less often: one per cent of the time went there


@pytest.fixture(autouse=True, scope="module")
def only_own_garbage():
    """The search for garbage leaves out thousands of tests, and what earlier files keep."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def compiled_quickly():
    """Compiling takes longer here than running what was compiled. Return what users have."""
    flags, usual, objects = machine_code.FLAGS, machine_code.compiler(), {}

    def link(command, sources, library, timeout, options=()):
        """Link C code; of solvers, which most controllers share, each text is compiled once."""
        if command == usual:
            options_alone = [flag for flag in machine_code.FLAGS if flag != "-shared"]
            compile_one = [*command, *options_alone, *options]
            sources = [object_of(file, compile_one, library.parent) for file in sources]
        machine_code.link(command, sources, library, timeout, options)

    def object_of(file, command, folder):
        if file.name not in LOOPS_OF_SOLVERS:
            return file
        text = subprocess.run([*command, "-E", "-P", file], check=True, capture_output=True).stdout
        key = *command, text
        compiled = folder / f"{file.stem}.o"
        if key not in objects:
            subprocess.run([*command, "-c", file, "-o", compiled], check=True)
            objects[key] = compiled.read_bytes()
        compiled.write_bytes(objects[key])
        return compiled

    with pytest.MonkeyPatch.context() as patch:
        quick = tuple("-O0" if flag == "-O3" else flag for flag in flags)
        patch.setattr(machine_code, "FLAGS", quick)
        patch.setattr(compiled_controller, "OPTIMIZATION", "-O0")
        patch.setattr(compiled_controller, "link", link)
        yield flags


@pytest.fixture(autouse=True, scope="session")
def figures_saved_with_few_dots():
    """Nobody looks at them, and dots take most of the time of a file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tenscontrol.plot.style._DPI", 40)
        yield


@pytest.fixture(autouse=True, scope="session")
def warnings_point_to_lines_of_users():
    """Each warning of any test names a line outside of the package and of Python's library."""

    def checked(message, category, stacklevel):
        where = sys._getframe(stacklevel).f_code.co_filename
        is_main = threading.current_thread() is threading.main_thread()
        in_doctest = where.endswith("doctest.py")  # which runs examples as lines of the package
        if where.startswith(_NO_USERS) and is_main and not in_doctest:
            raise AssertionError(f"the warning {message!r} points to {where}")
        warnings.warn(message, category, stacklevel=stacklevel + 1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tenscontrol.warn.warnings", SimpleNamespace(warn=checked))
        yield


@pytest.fixture(scope="session")
def prism():
    """The prism of the paper's example 1."""
    return tc.prism(sides=3, radius=0.5, height=1.0, bar_mass=1.0)


@pytest.fixture(scope="session")
def rest(prism):
    """The prism at rest, γ_v = 30 N/m."""
    return tc.prestress(prism, force_density=TOP_FORCE_DENSITY)


@pytest.fixture(scope="session")
def paper_motion(prism):
    """The paper's example 1 with massless strings over 5 s by the oracle, every millisecond."""
    time = np.linspace(0, 5, 5001)
    law = HeldRestLength(rest_lengths(prism, paper_force_density(9.0), 100.0), 100.0)
    nodes, switches = exact_motion(prism, law, time)
    return SimpleNamespace(time=time, nodes=nodes, switches=switches, rest_length=law.rest_length)
