"""How many files of the package a reader must open to follow one call, and its cost: a ratchet.

====================  =======  =====  ==============================================
call                  at most  0.1.0  what it is
====================  =======  =====  ==============================================
``MPC(...)``          21       31     on a new plant of the prism, in force densities
``MPC.command``       10       18     the second of a controller
``NMPC.command``      12       22     the second of a controller
``LQR.command``       10       7      the second of a controller
a function            5        –      the second command of a ``FunctionController``
``simulate``          40       44     one sample with that MPC
====================  =======  =====  ==============================================

The numbers of 0.1.0 were counted by this test. A file counts if a function of it is called.
Those at the base of the package, with checks and types, are not counted; in 0.1.0 they were.

What a run costs beside its steps is counted in calls of functions of the package: 389 with the
compiled core, and 933 in 0.2.0; and in all functions that are entered.
"""

import gc
import sys
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.core.library import library
from tenscontrol.fields import check_fields, checked
from tests.benchmarks.error_against_time import MOTIONS
from tests.marks import needs_core

PACKAGE = str(Path(tc.__file__).parent) + "/"
SAMPLE = 0.02
STILL = np.zeros((3, 6))


@contextmanager
def profiled(look):
    """Show each call and return to a function."""
    before = sys.getprofile()
    sys.setprofile(look)
    try:
        yield
    finally:
        sys.setprofile(before)


@contextmanager
def files_passed():
    """Collect the files of the package whose functions run."""
    found: set[str] = set()

    def look(frame, event, _):
        if event == "call":
            code = frame.f_code
            # The body of a module runs once, when it is imported.
            name = code.co_filename.removeprefix(PACKAGE)
            # Checks and types at the base need not be opened.
            if name != code.co_filename and "/" in name and code.co_name != "<module>":
                found.add(name)

    with profiled(look):
        yield found


@pytest.fixture(scope="module")
def scene():
    """The prism, its plants and controllers; what is imported or built once is there."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    rest = tc.prestress(prism, force_density=17.3205)
    plant = tc.linearize(model, rest)
    usual = {"horizon": 5, "sample_time": SAMPLE, "max_force_density": 50.0}
    return SimpleNamespace(model=model, rest=rest, nodes=prism.nodes, plant=plant, usual=usual)


def test_files_are_counted(scene):
    with files_passed() as found:
        scene.rest.force_density.sum()
        tc.structure.prism_radius(1.0, height=0.5)
    assert any(name.startswith("structure/") for name in found)
    assert len(found) < 8


def count(found, what, at_most):
    """Print what was passed, and compare."""
    print(f"{what}: {len(found)} files, at most {at_most}", *sorted(found), sep="\n    ")
    assert len(found) <= at_most, sorted(found)


def test_building_an_mpc(scene):
    tc.MPC(scene.plant, **scene.usual)
    fresh = tc.linearize(scene.model, scene.rest)  # nothing is prepared for it
    with files_passed() as found:
        tc.MPC(fresh, **scene.usual)
    count(found, "MPC(...)", 21)


@pytest.mark.parametrize(
    ("name", "make", "at_most"),
    [
        ("MPC.command", lambda scene: tc.MPC(scene.plant, **scene.usual), 10),
        ("NMPC.command", lambda scene: tc.NMPC(scene.plant, **scene.usual), 12),
        (
            "LQR.command",
            lambda scene: tc.LQR(
                scene.plant, Q=1.0, R=1e-3, sample_time=SAMPLE, max_force_density=50.0
            ),
            10,
        ),
        (
            "FunctionController.command",
            lambda scene: tc.FunctionController(
                scene.model.structure, lambda *_: np.full(9, 20.0), input="force_density"
            ),
            5,
        ),
    ],
    ids=["MPC", "NMPC", "LQR", "function"],
)
def test_a_command(scene, name, make, at_most):
    controller = make(scene)
    controller.command(0.0, scene.nodes, STILL)
    with files_passed() as found:
        command = controller.command(SAMPLE, scene.nodes, STILL)
    assert command.status is tc.control.Status.OK
    count(found, name, at_most)


def test_a_simulated_sample(scene):
    """From ``simulate`` to the trajectory, with one sample between."""
    mpc = tc.MPC(scene.plant, **scene.usual)
    tc.simulate(scene.model, SAMPLE, controller=mpc, step=1e-3)
    mpc.reset()
    with files_passed() as found:
        run = tc.simulate(scene.model, SAMPLE, controller=mpc, step=1e-3)
    assert len(run.control.status) == 1
    count(found, "one simulated sample", 42)


def entered_by(call):
    """Return how many functions of Python and of C a call enters."""
    count = 0

    def look(_, event, __):
        nonlocal count
        count += event in ("call", "c_call")

    with profiled(look):
        call()
    return count


@contextmanager
def calls():
    """Collect the calls of functions of the package."""
    names: list[str] = []

    def look(frame, event, _):
        if event == "call" and frame.f_code.co_filename.startswith(PACKAGE):
            names.append(frame.f_code.co_qualname)

    with profiled(look):
        yield names


def test_what_a_later_run_costs_beside_its_steps(scene):
    gamma = scene.rest.force_density
    given = {"rest_length": tc.to_rest_length(scene.model, scene.nodes, gamma).rest_length}
    given["velocities"] = np.tile([[0.0], [0.0], [1.0]], 6)
    tc.simulate(scene.model, 1e-4, **given)
    with calls() as passed:
        tc.simulate(scene.model, 1e-4, **given)
    most = 400 if library() is not None else 1330  # each step is Python's without the core
    assert len(passed) <= most, Counter(passed).most_common(20)


# NumPy and Python differ by some calls from version to version.
@needs_core
@pytest.mark.parametrize(("error", "most"), [("none", 550), ("estimate", 788)])
def test_a_later_run_enters_few_functions(error, most):
    scene = MOTIONS["taut"].make(5.0)

    def call():
        tc.simulate(
            scene.model, 5.0, velocities=scene.velocities, rest_length=scene.rest_length,
            tolerance=1e-5, error=error,
        )  # fmt: skip

    call()
    assert entered_by(call) <= most


@needs_core
def test_derivatives_of_a_run_enter_few_functions():
    scene = MOTIONS["taut"].make(1.0)
    run = tc.simulate(
        scene.model, 1.0, velocities=scene.velocities, rest_length=scene.rest_length,
        tolerance=1e-3, error="none",
    )  # fmt: skip

    def call():
        tc.sensitivity(run, ["rest_length"])

    call()
    assert entered_by(call) <= 510


def test_defaults_of_a_record_are_not_checked_again():
    seen = list[object]()

    def check(name, value):
        seen.append(value)
        if value is None:
            raise TypeError(f"{name} is None")
        return value

    @dataclass(frozen=True)
    class Record:
        given: str = field(default="as a rule", metadata=checked(check))
        needed: object = field(default=None, metadata=checked(check))

        def __post_init__(self):
            check_fields(self)

    Record(needed=1)
    seen.clear()
    Record(needed=2)
    assert seen == [2]
    with pytest.raises(TypeError, match="needed is None"):
        Record("another")
    assert seen == [2, "another", None]


def test_a_run_leaves_nothing_to_the_garbage_collector(scene):
    """Its memory would be kept until that comes."""
    given = {"force_density": scene.rest.force_density}
    tc.simulate(scene.model, 0.01, **given)
    gc.collect()
    gc.disable()
    try:
        run = tc.simulate(scene.model, 0.01, **given)
        del run
        assert gc.collect() == 0
    finally:
        gc.enable()
