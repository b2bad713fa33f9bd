"""Runs go to files and come back: equal array by array, with a word for what no file can hold."""

import json
import os
import pickle
import signal
import struct
import subprocess
import sys
import time
import tracemalloc
import zipfile
from dataclasses import dataclass, fields, is_dataclass, replace
from io import BytesIO
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import tenscontrol as tc
from tenscontrol.dynamics import SmoothGround, StringLaw
from tenscontrol.simulation import Arguments
from tenscontrol.simulation.run_file import _SHAPES, EVALUATED, _check_names, _Reader, _Writer
from tests.random_structures import any_structure

SCENES = Path(__file__).parents[2] / "examples" / "scenes"


# ---- what is equal ----


def assert_equal(one, other, place="run"):
    """Two values are equal bit by bit, and of one kind, all that is in them too."""
    if isinstance(one, ca.Function):
        points = np.random.default_rng(0).normal(size=(one.n_in(), 50))
        np.testing.assert_array_equal(*(f.map(50)(*points).full() for f in (one, other)))
        return
    assert type(one) is type(other), place
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, place
        assert one.shape == other.shape, place
        assert one.tobytes() == other.tobytes(), place
        assert one.flags.writeable or not other.flags.writeable, place
    elif is_dataclass(one):
        for field in fields(one):
            if field.name not in ("_functions", "scene"):  # of the live run alone
                a, b = getattr(one, field.name), getattr(other, field.name)
                assert_equal(a, b, f"{place}.{field.name}")
    elif isinstance(one, tuple | list):
        assert len(one) == len(other), place
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_equal(a, b, f"{place}[{i}]")
    elif isinstance(one, dict | Arguments):
        assert list(one) == list(other), place
        for name in one:
            assert_equal(one[name], other[name], f"{place}[{name!r}]")
    else:
        assert one == other or (one != one and other != other), place


def assert_same_run(run, saved):
    assert_equal(run, saved)
    for name in (*EVALUATED, "energy", "tension", "held"):
        assert_equal(getattr(run, name), getattr(saved, name), name)
    assert repr(saved.health) == repr(run.health)  # NaN too
    assert saved.summary() == run.summary()
    assert repr(saved) == repr(run)


def there_and_back(run, folder):
    path = Path(folder) / "run.npz"
    assert run.save(str(path)) == path
    return tc.load_run(path)


# ---- runs of structures that nobody tuned ----


def law(structure, damping=0.0):
    return tc.LinearStrings(200.0 + np.arange(len(structure.strings)), damping=damping)


def wind(time):
    return np.full((2, 4), 0.1 * np.sin(time))


def ball():
    """A six-bar ball that drops onto uneven ground, with friction."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    hills = ca.Function("hills", [x, y], [-0.9 + 0.05 * ca.sin(3 * x) * ca.fmax(y, -0.2) ** 2])
    structure = tc.library.six_bar_ball()
    ground = [tc.Ground(stiffness=3e3, damping=0.2, friction=0.4, height=hills)]
    model = tc.Model(structure, gravity=9.81, ground=ground)
    return tc.simulate(model, 0.3, force_density=20.0, step=1e-3, output_step=0.01)


def tower():
    """A class-2 tower whose strings are wound along a profile, and one cut, its load a profile."""
    structure = tc.library.class2_tower(stages=2)
    model = tc.Model(structure, strings=law(structure, 1.0), external_force=True)
    length = structure.string_length()
    rest = tc.Profile([0.0, 0.1], np.stack([0.9 * length, 0.85 * length], axis=-1), "cubic")
    push = tc.Profile([0.0, 0.1], np.stack([0 * structure.nodes, 0.1 + 0 * structure.nodes], -1))
    return tc.simulate(
        model, 0.1, rest_length=rest, external_force=push, step=1e-3, output_step=0.01,
        faults=[tc.CutString(3, 0.05)],
    )  # fmt: skip


def spine():
    structure = tc.library.spine(vertebrae=3)
    law = tc.ElasticStrings(axial_rigidity=500.0)
    model = tc.Model(structure, strings=law, gravity=[0.0, 1.0, -9.81])
    return tc.simulate(model, 0.05, rest_length=0.95 * structure.string_length(), step=1e-3)


def net():
    """A radial net with clustered strings, skinned where it may be; its supports move."""
    structure = tc.library.wheel(spokes=6)
    return tc.simulate(tc.Model(structure), 0.05, force_density=10.0, step=1e-3)


def cross():
    """A planar X frame whose ground is one that rounds its foot."""
    structure = tc.library.snelson_x(dimension=2)
    ground = SmoothGround(stiffness=1e3, width=0.01, height=-0.2, nodes=[0, 1])
    model = tc.Model(structure, gravity=9.81, ground=ground)
    return tc.simulate(model, 0.3, force_density=5.0, step=1e-3, output_step=0.01)


def arm():
    """An arm under MPC with winches and a reference."""
    structure = tc.library.arm(sections=2)
    model = tc.Model(structure, strings=tc.LinearStrings(500.0))
    plant = tc.linearize(model, tc.prestress(structure, min_force_density=10.0), "rest_length")
    mpc = tc.MPC(
        plant, horizon=3, sample_time=0.02, winches=tc.Winches(rate=0.5, shortest=0.01),
        outputs=[tc.OutputLimit(np.eye(plant.nodes.size)[:1], high=5.0, penalty=1e3)],
        reference=tc.Reference([0.0, 1.0], np.stack([plant.nodes] * 2, axis=-1)),
    )  # fmt: skip
    start, winches = plant.equilibrium_input, tc.Winches(rate=0.5)
    return tc.simulate(model, 0.1, rest_length=start, controller=mpc, winches=winches, step=1e-3)


def fault():
    """A prism with sensors, Kalman filter, noise, motors, and faults."""
    scene = tc.load_scene(SCENES / "prism_fault.toml")
    motor = tc.Motor(drum_radius=0.01, torque=5.0, inertia=1e-5)
    return replace(
        scene, duration=0.4, winches=tc.Winches(rate=scene.winches.rate, motor=motor)
    ).simulate()


RUNS = {each.__name__: each for each in (ball, tower, spine, net, cross, arm, fault)}


@pytest.fixture(scope="module")
def runs():
    made = {}

    def of(name):
        if name not in made:
            made[name] = RUNS[name]()
        return made[name]

    return of


@pytest.mark.parametrize("name", RUNS)
def test_a_run_comes_back(name, runs, tmp_path):
    run = runs(name)
    saved = there_and_back(run, tmp_path)
    assert_same_run(run, saved)
    again = there_and_back(saved, tmp_path)
    assert_same_run(run, again)
    assert repr(saved.model) == repr(run.model)
    assert_equal(run.model.strings, saved.model.strings)
    assert_equal(run.model.ground, saved.model.ground)
    for part in ("constant_force", "gravity", "built_in_load"):
        assert_equal(getattr(run.model, part), getattr(saved.model, part))
    assert saved.model.has_external_force == run.model.has_external_force


@pytest.mark.parametrize("name", ["spine", "cross", "net"])
def test_a_saved_run_goes_on_and_is_run_again(name, runs, tmp_path):
    run = runs(name)
    saved = there_and_back(run, tmp_path)
    setting = {run.choice.setting: run.choice.value, "method": run.method}
    more, other = (tc.simulate(each.model, 0.02, start=each, **setting) for each in (run, saved))
    assert_same_run(more, other)
    again = tc.simulate(
        saved.model, 0.02, saved.nodes[:, :, 0], saved.velocities[:, :, 0], **saved.given, **setting
    )
    first = tc.simulate(
        run.model, 0.02, run.nodes[:, :, 0], run.velocities[:, :, 0], **run.given, **setting
    )
    np.testing.assert_array_equal(again.nodes, first.nodes)


def test_the_record_of_the_controller(runs, tmp_path):
    run = runs("arm")
    saved = there_and_back(run, tmp_path)
    kept = saved.control.settings
    assert (kept["kind"], kept["horizon"], kept["sample_time"]) == ("MPC", 3, 0.02)
    np.testing.assert_array_equal(kept["winches"].rate, 0.5)
    assert isinstance(kept["reference"], tc.Reference)
    assert len(saved.control.statistics.iterations) == len(saved.control.status) == 5
    assert saved.control.summary() == run.control.summary()
    assert saved.control.status_count == run.control.status_count


def test_a_saved_run_is_drawn_as_the_run(runs, tmp_path):
    run, pictures = runs("ball"), []
    for each in (run, there_and_back(run, tmp_path)):
        drawn = tc.plot.structure(each, time=0.1)
        drawn.ax.figure.set_dpi(20)
        buffer = BytesIO()
        drawn.ax.figure.savefig(buffer, format="raw")
        pictures.append(buffer.getvalue())
        assert drawn.ground
    assert pictures[0] == pictures[1]


STATUSES = list(tc.control.Status)
# All characters of UTF-8, which are those but for surrogates: to ask its codec takes seconds.
LETTERS = st.characters(exclude_categories=["Cs"])
SCALARS = (
    st.none() | st.booleans() | st.integers() | st.text(LETTERS) | st.floats()
    | st.sampled_from([tc.Ground(1e3, height=0.1), tc.Profile([0.0], [[1.0]])])
    | st.lists(st.integers(0, 5), min_size=1).map(lambda x: tuple(STATUSES[i] for i in x))
    | st.lists(st.floats(width=64), max_size=4).map(np.array)
    | st.lists(st.integers(-(2**63), 2**63 - 1), max_size=4).map(lambda x: np.array(x, np.int64))
)  # fmt: skip
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.text(LETTERS, max_size=3), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(value=VALUES)
def test_any_value_comes_back(value):
    writer = _Writer()
    text = json.dumps(writer.node(value, ("value",)), allow_nan=False)
    arrays = {name: tc.arrays.frozen(array) for name, array in writer.arrays.items()}
    assert_equal(value, _Reader(arrays).value(json.loads(text), "value"))
    _check_names({"value": json.loads(text)}, arrays.keys())
    assert writer.unsaved == {}


@pytest.mark.parametrize("seed", [3, 8])
def test_runs_of_any_structure(seed, tmp_path):
    structure = any_structure(seed)
    load = np.random.default_rng(seed).normal(size=structure.nodes.shape)
    model = tc.Model(structure, external_force=load)
    run = tc.simulate(model, 3e-5, force_density=1.0, step=1e-5)
    assert_same_run(run, there_and_back(run, tmp_path))


def test_the_same_run_gives_the_same_bytes(runs, tmp_path):
    first = runs("net").save(tmp_path / "one.npz").read_bytes()
    assert runs("net").save(tmp_path / "two.npz").read_bytes() == first


# ---- what no file can hold ----


@dataclass(frozen=True, eq=False)
class Rubber(StringLaw):
    stiffness: float
    damping: float = 0.0

    def tension(self, length, rest_length):
        return self.stiffness * (length - rest_length)

    def taut_rest_length(self, length, force_density):
        return length * (1 - force_density / self.stiffness)

    def stored_energy(self, length, rest_length):
        return self.stiffness * ca.fmax(0, length - rest_length) ** 2 / 2

    @property
    def largest_force_density(self):
        return self.stiffness


def header(path):
    return json.loads(np.load(path)["header"].tobytes())


def test_a_load_that_is_a_function_is_named_and_its_values_are_kept(tmp_path):
    frame = tc.library.snelson_x(dimension=2)
    model = tc.Model(frame, external_force=True)
    run = tc.simulate(model, 0.05, force_density=5.0, external_force=wind, step=1e-3)
    assert run.given["external_force"] is wind
    path = run.save(tmp_path / "run.npz")
    assert list(header(path)["not_saved"]) == ["given.external_force"]
    saved = tc.load_run(path)
    with pytest.raises(ValueError, match=r"given\.external_force was the function or class .*wind"):
        _ = saved.given["external_force"]
    np.testing.assert_array_equal(saved.given["force_density"], 5.0)
    assert saved.summary() == run.summary()
    np.testing.assert_array_equal(saved.potential_energy, run.potential_energy)
    again = tc.load_run(saved.save(tmp_path / "again.npz"))
    with pytest.raises(ValueError, match=r"given\.external_force was the function or class .*wind"):
        _ = again.given["external_force"]


def test_a_run_with_a_function_is_pickled_and_names_it():
    frame = tc.library.snelson_x(dimension=2)
    model = tc.Model(frame, external_force=True)
    run = tc.simulate(model, 0.01, force_density=5.0, external_force=lambda t: wind(t), step=1e-3)
    copied = pickle.loads(pickle.dumps(run))
    with pytest.raises(ValueError, match=r"external_force was the .*lambda"):
        _ = copied.given["external_force"]
    np.testing.assert_array_equal(copied.given["force_density"], 5.0)


def test_a_string_law_of_ones_own_is_named(tmp_path):
    spine = tc.library.spine(vertebrae=3)
    model = tc.Model(spine, strings=Rubber(100.0))
    run = tc.simulate(model, 0.02, rest_length=0.9 * spine.string_length(), step=1e-3)
    saved = there_and_back(run, tmp_path)
    with pytest.raises(ValueError, match=r"model\.strings was a Rubber of"):
        _ = saved.model
    for name in EVALUATED:
        np.testing.assert_array_equal(getattr(saved, name), getattr(run, name))
    more = tc.simulate(model, 0.01, start=saved, step=1e-3)
    other = tc.simulate(model, 0.01, start=run, step=1e-3)
    np.testing.assert_array_equal(more.nodes, other.nodes)


def test_a_ground_that_no_expression_says_is_named(tmp_path):
    class Field(ca.Callback):
        def __init__(self):
            ca.Callback.__init__(self)
            self.construct("field", {"enable_fd": True})

        def get_n_in(self):
            return 2

        def eval(self, arguments):
            return [-2.0 + 0.0 * arguments[0]]

    field, x, y = Field(), ca.MX.sym("x"), ca.MX.sym("y")
    height = ca.Function("bumps", [x, y], [field(x, y)])
    run = tc.simulate(tc.Model(tc.prism()), 0.01, force_density=20.0, step=1e-3)
    run = replace(run, _ground=(tc.Ground(stiffness=1e3, height=height),))
    saved = there_and_back(run, tmp_path)
    with pytest.raises(ValueError, match=r"ground\.0\.height was a Function of casadi"):
        _ = saved.ground
    assert saved.summary() == run.summary()


def test_a_controller_of_ones_own_is_named(tmp_path):
    def hold(time, nodes, velocities):
        return np.full(9, 20.0)

    run = tc.simulate(tc.Model(tc.prism()), 0.02, controller=hold, sample_time=0.01, step=1e-3)
    saved = there_and_back(run, tmp_path)
    kept = saved.control.settings
    assert kept["kind"] == "FunctionController"
    with pytest.raises(ValueError, match=r"control\.settings\.function was the .*hold"):
        _ = kept["function"]
    np.testing.assert_array_equal(saved.control.command, 20.0)


def test_what_the_rest_depends_on_must_be_writable(runs, tmp_path):
    with pytest.raises(TypeError, match=r"note of the run is a object of builtins"):
        replace(runs("net"), note=object()).save(tmp_path / "run.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_copy_is_saved_without_its_model(runs, tmp_path):
    copied = pickle.loads(pickle.dumps(runs("net")))
    saved = there_and_back(copied, tmp_path)
    assert_same_run(copied, saved)
    for each in (copied, saved):
        with pytest.raises(ValueError, match="a copy of a run has no model"):
            _ = each.model


# ---- files that are refused ----


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    run = tc.simulate(tc.Model(tc.prism()), 0.003, force_density=20.0, step=1e-3)
    return run, run.save(tmp_path_factory.mktemp("small") / "run.npz").read_bytes()


def rewritten(content, **arrays):
    """The archive with other arrays; None leaves one out. The header may be a function."""
    with np.load(BytesIO(content)) as archive:
        found = {name: archive[name] for name in archive.files}
    change = arrays.pop("header", None)
    if change is not None:
        text = json.dumps(change(json.loads(found["header"].tobytes()))).encode()
        text = text.replace(b'"deep"', 2000 * b'{"list": [' + b"1" + 2000 * b"]}")
        found["header"] = np.frombuffer(text, dtype=np.uint8)
    found |= arrays
    buffer = BytesIO()
    np.savez_compressed(buffer, **{name: x for name, x in found.items() if x is not None})
    return buffer.getvalue()


def _header(change):
    """What rewrites the header of an archive."""
    return lambda content: rewritten(content, header=change)


def _work(node):
    """What puts another node into the place of a record."""
    return _header(lambda header: header | {"run": header["run"] | {"work": node}})


SPOILED = {
    "empty": (lambda c: b"", "no run: expected a file that run.save"),
    "no archive": (lambda c: b"PK but no archive", "no run"),
    "other archive": (_header(lambda h: {"format": "x"}), "no run: the header"),
    "no header": (lambda c: rewritten(c) and _bare(), "no run: the archive has no header"),
    "newer": (
        _header(lambda h: h | {"version": 2, "tenscontrol": "9.0"}),
        "version is 2, expected 1: the file was written by tenscontrol 9.0",
    ),
    "NaN": (lambda c: rewritten(c, nodes=np.full((3, 6, 4), np.nan)), "nodes holds what is not"),
    "infinite energy": (
        lambda c: rewritten(c, kinetic_energy=np.full(4, np.inf)), "kinetic_energy holds"
    ),
    "NaN of the structure": (
        lambda c: rewritten(c, structure_nodes=np.full((3, 6), np.nan)), "structure_nodes holds"
    ),
    "missing array": (lambda c: rewritten(c, velocities=None), "damaged.*velocities"),
    "more arrays": (lambda c: rewritten(c, more=np.zeros(3)), "header does not name: more"),
    "another shape": (lambda c: rewritten(c, nodes=np.zeros((3, 5, 4))), "nodes has shape"),
    "another time": (lambda c: rewritten(c, time=np.zeros(9)), "shape"),
    "objects": (
        lambda c: rewritten(c, nodes=np.array([{}], dtype=object)), "nodes.npy has entries of the"
    ),
    "text": (lambda c: rewritten(c, nodes=np.full((3, 6, 4), "1")), "nodes has entries of the"),
    "another law": (
        _header(lambda h: h["run"]["model"]["dict"].update(strings=1) or h),
        "damaged.*strings is a int",
    ),
    "a class": (_work({"record": "Popen", "fields": {}}), "damaged.*Popen"),
    "no field": (_work({"record": "Work", "fields": {"magic": 1}}), "damaged.*magic"),
    "no node": (_work({"x": 1}), "not understood"),
    "a list": (_work([1]), "is a list"),
    "no part": (_header(lambda h: h | {"run": {"time": 1.0}}), "damaged"),
    "another part": (_header(lambda h: h | {"run": h["run"] | {"x": 1}}), "'x' is not what a run"),
    "another record": (_work({"dict": {}}), "work is not what a run has there"),
    "nested": (_work("deep"), "damaged"),
    "an instruction": (_work({"function": ["f", "x"], "lines": {"list": [{"list": [
        "CALL", {"list": [0]}, {"list": [0]}, 0.0]}]}}), "damaged.*instruction 'CALL'"),
    "parts in a list": (_header(lambda h: h | {"run": []}), "damaged.*run is a list"),
    "an array twice": (
        _work({"tuple": [{"array": "work_0"}, {"array": "time"}]}), "work.0 is the array 'work_0', "
        "which is not there"
    ),
    "an array of another place": (_work({"array": "time"}), "work is the array 'time', expected"),
    "text of no letters": (
        lambda c: repacked(c, {"nodes": _array((10**12,), 0, "<U0")}), "nodes.npy has entries of"
    ),
    "more than memory": (
        lambda c: rewritten(c, nodes=np.zeros((0, 10**10))), "is too large: arrays of 80,000,0"
    ),
    "another packing": (
        lambda c: repacked(c, {}, zipfile.ZIP_LZMA), "npy is packed by another way than deflate"
    ),
    "a form of less": (
        lambda c: repacked(c, {"nodes": _array((3, 6, 3), 576)}), "nodes.npy has 576 bytes, expect"
    ),
    "a form of more": (
        lambda c: repacked(c, {"nodes": _array((3, 6, 10**7), 576)}), "nodes.npy has 576 bytes"
    ),
    "10,000 arrays": (
        lambda c: repacked(c, {f"{i:0200d}": b"" for i in range(5000)}),
        "no run: its directory has more than 1,000,000 bytes"
    ),
}  # fmt: skip


def _array(shape, count, kind="<f8"):
    """So many bytes of zeros with the header of an array of some shape."""
    stream = BytesIO()
    form = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, form)
    return stream.getvalue() + bytes(count)


def repacked(content, members, kind=zipfile.ZIP_DEFLATED):
    """The archive with members of these bytes, by name."""
    buffer = BytesIO()
    with zipfile.ZipFile(BytesIO(content)) as old, zipfile.ZipFile(buffer, "w", kind) as new:
        found = {each.filename: old.read(each) for each in old.infolist()}
        for name, data in (found | {f"{name}.npy": each for name, each in members.items()}).items():
            new.writestr(name, data)
    return buffer.getvalue()


def _bare():
    buffer = BytesIO()
    np.savez(buffer, nodes=np.zeros(3))
    return buffer.getvalue()


@pytest.mark.parametrize("name", SPOILED)
def test_what_is_no_run_is_refused(name, small, tmp_path):
    spoil, message = SPOILED[name]
    path = tmp_path / "run.npz"
    path.write_bytes(spoil(small[1]))
    with pytest.raises(ValueError, match=message) as raised:
        tc.load_run(path)
    assert str(raised.value).startswith(str(path))


def peak_of_refusal(path, content, message):
    """The most memory that is taken while a file is refused, bytes."""
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=message):
            tc.load_run(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("name", "shape", "message"),
    [
        ("nodes", (3, 6, 10**5), r"nodes has shape \(3, 6, 100000\), expected \(3, 6, 4\)"),
        (
            "structure_bars",
            (10**6, 2),
            r"structure_bar_mass has shape \(3,\), expected \(1000000,",
        ),
        ("more", (10**6,), "an array that the header does not name: more"),
        ("given_force_density_", (10**6,), "the header does not name: given_force_density_"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_before_they_are_read(
    name, shape, message, small, tmp_path
):
    count = 8 * int(np.prod(shape))
    bomb = repacked(small[1], {name: _array(shape, count)})
    assert len(bomb) < count / 300
    path = tmp_path / "run.npz"
    assert peak_of_refusal(path, bomb, message) < 3e6


def test_a_directory_that_lies_costs_what_the_file_holds(small, tmp_path):
    """Header and directory claim 800 MB; the archive holds 80 bytes of them."""
    content = repacked(small[1], {"given_force_density": _array((10**8,), 80)})
    begin = content.rindex(b"PK\x01\x02", 0, content.rindex(b"given_force_density.npy"))
    (held,) = struct.unpack("<I", content[begin + 24 : begin + 28])
    claimed = struct.pack("<I", held - 80 + 8 * 10**8)
    content = content[: begin + 24] + claimed + content[begin + 28 :]
    (tmp_path / "run.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"given_force_density\.npy holds 80 bytes, expected 800,"):
        tc.load_run(tmp_path / "run.npz")


def test_reading_takes_little_more_memory_than_the_arrays(small, tmp_path):
    with np.load(BytesIO(small[1])) as archive:
        longer = {
            name: np.repeat(archive[name][..., :1], 30_000, axis=-1)
            for name in archive.files
            if _SHAPES.get(name, "").endswith("T")
        }
    path, total = tmp_path / "run.npz", sum(array.nbytes for array in longer.values())
    path.write_bytes(rewritten(small[1], **longer))
    tracemalloc.start()
    tc.load_run(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert total > 1e7
    assert peak < 1.5 * total + 5e6


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match="cannot be read"):
        tc.load_run(tmp_path / "absent.npz")
    with pytest.raises(OSError, match="it is a folder"):
        tc.load_run(tmp_path)
    run = tc.simulate(tc.Model(tc.prism()), 0.002, force_density=20.0, step=1e-3)
    with pytest.raises(ValueError, match=r"expected a name ending in \.npz"):
        run.save(tmp_path / "run.csv")


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_no_damage_gets_through(data, small, tmp_path_factory):
    """A flipped bit, or an end cut off: refused, or nothing that is read was hit."""
    run, content = small
    place = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        spoiled = content[:place]
    else:
        spoiled = bytearray(content)
        spoiled[place] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path_factory.getbasetemp() / "spoiled.npz"
    path.write_bytes(bytes(spoiled))
    try:
        found = tc.load_run(path)
    except ValueError as error:
        message = str(error)
    else:
        assert_same_run(run, found)
        return
    assert message.startswith(str(path))


_WRITE = """
import sys, tenscontrol as tc
runs = [tc.simulate(tc.Model(tc.prism()), 0.05, force_density=g, step=1e-3) for g in (20.0, 30.0)]
for run in runs:
    run.energy, run.momentum, run.bar_length_error
print(flush=True)
for i in range(10**9):
    runs[i % 2].save(sys.argv[1])
"""


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX")
def test_a_killed_writer_leaves_a_whole_run(tmp_path):
    path, rng = tmp_path / "run.npz", np.random.default_rng(2)
    with subprocess.Popen([sys.executable, "-c", _WRITE, path], stdout=subprocess.PIPE) as writer:
        writer.stdout.readline()
        time.sleep(0.05 + rng.uniform(0.0, 0.05))
        while not path.exists():
            time.sleep(0.005)
        writer.send_signal(signal.SIGKILL)
    assert tc.load_run(path).given["force_density"] in (20.0, 30.0)


# ---- for other programs ----


def test_csv_has_all_with_names_and_units(runs, tmp_path):
    for name in ("tower", "cross", "arm"):
        run = runs(name)
        path = run.to_csv(tmp_path / f"{name}.csv")
        head, *lines = path.read_text(encoding="utf-8").splitlines()
        table = np.array([line.split(",") for line in lines], dtype=float)
        columns = dict(zip(head.split(","), table.T, strict=True))
        np.testing.assert_array_equal(columns["time [s]"], run.time)
        np.testing.assert_array_equal(columns["node 2 y [m]"], run.nodes[1, 2])
        gamma = columns["string 1 force density [N/m]"]
        np.testing.assert_array_equal(gamma, run.force_density[1])
        lengths = [run.structure.string_length(N)[1] for N in np.moveaxis(run.nodes, 2, 0)]
        np.testing.assert_allclose(columns["string 1 tension [N]"], gamma * lengths, rtol=1e-14)
        assert ("string 0 rest length [m]" in columns) == (run.rest_length is not None)
    command = columns["winch 0 command [m]"]
    at_end = np.isclose(run.time[:, None], run.control.time[1:]).any(axis=1)
    assert set(command) == set(run.control.command[0])
    # At the end of a sample it is the command of this sample that has acted.
    np.testing.assert_array_equal(command[at_end], run.control.command[0, :-1])


def test_the_tension_of_a_clustered_string_is_that_of_its_whole_length():
    seed = next(s for s in range(99) if any_structure(s).has_clusters)
    structure = any_structure(seed)
    run = tc.simulate(tc.Model(structure), 2e-5, force_density=2.0, step=1e-5)
    np.testing.assert_allclose(run.tension[:, 0], 2.0 * structure.string_length(), rtol=1e-14)


def test_xarray_has_dimensions_and_units(runs):
    pytest.importorskip("xarray", reason="the extra tenscontrol[xarray] is not installed")
    for name in ("tower", "cross", "arm"):
        run = runs(name)
        found = run.to_xarray()
        d, n, count = run.nodes.shape
        sizes = {"axis": d, "node": n, "time": count, "bar": len(run.structure.bars)}
        assert dict(found.sizes).items() >= sizes.items()
        np.testing.assert_array_equal(found.nodes.sel(axis="y"), run.nodes[1])
        np.testing.assert_array_equal(found.tension.isel(time=-1), run.tension[:, -1])
        assert {each.attrs["units"] for each in found.data_vars.values()} <= {
            "m", "m/s", "N", "N/m", "J", "kg m/s", "kg m2/s"
        }  # fmt: skip
    assert found.command.dims == ("winch", "sample")
    assert found.status.values.tolist() == [str(each) for each in run.control.status]


def test_a_missing_xarray_is_named(runs, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    monkeypatch.delitem(sys.modules, "tenscontrol.simulation.run_dataset", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'tenscontrol\[xarray\]'"):
        runs("cross").to_xarray()


def test_no_pickle_is_in_the_file(small):
    with zipfile.ZipFile(BytesIO(small[1])) as archive:
        assert all(b"|O" not in archive.read(name) for name in archive.namelist())
    with np.load(BytesIO(small[1]), allow_pickle=False) as arrays:
        assert all(arrays[name].dtype != object for name in arrays.files)
