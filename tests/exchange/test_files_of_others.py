"""CSV tables and VTK: each file read back by its own rules."""

import sys
from xml.etree import ElementTree

import numpy as np
import pytest

import tenscontrol as tc
from tests.exchange.structures import library, others

BALL = tc.library.six_bar_ball()


@pytest.fixture(scope="module")
def run():
    model = tc.Model(others()["clustered"], strings=tc.LinearStrings(500.0), gravity=9.81)
    rest = 0.95 * model.structure.string_length()
    return tc.simulate(model, 0.1, rest_length=rest, output_step=0.02)


# ---- CSV ----


def tables(folder, structure, law, rest):
    """Write the two files of a structure in space."""
    rows = ["name,x,y,z,mass,fixed"]
    for i, (x, y, z) in enumerate(structure.nodes.T.tolist()):
        held = "all" if i in structure.fixed else "".join(a for n, a in structure.rollers if n == i)
        rows.append(f"p{i},{x!r},{y!r},{z!r},{float(structure.point_mass[i])!r},{held}")
    members = ["kind,start,end,mass,stiffness,rest_length,damping,group"]
    for (a, b), mass in zip(structure.bars.tolist(), structure.bar_mass.tolist(), strict=True):
        members.append(f"bar,p{a},{b},{mass!r},,,,")
    for k, (a, b) in enumerate(structure.strings.tolist()):
        own = float(law.stiffness[k]), float(rest[k]), float(law.damping[k])
        members.append(
            f"cable,{a},p{b},,{own[0]!r},{own[1]!r},{own[2]!r},{structure.string_groups[k]}"
        )
    (folder / "nodes.csv").write_text("\n".join(rows) + "\n")
    (folder / "members.csv").write_text("\n".join(members) + "\n")
    return folder / "nodes.csv", folder / "members.csv"


@pytest.mark.parametrize("name", ["six_bar_ball", "class2_tower", "geiger_dome", "rollers"])
def test_tables_give_the_structure_they_hold(name, tmp_path):
    structure = (library() | others())[name]
    count = len(structure.strings)
    law = tc.LinearStrings(np.linspace(100, 200, count), np.linspace(0, 1, count))
    rest = 0.9 * structure.string_length()
    found = tc.exchange.from_csv(*tables(tmp_path, structure, law, rest))
    for field in ("nodes", "bars", "strings", "bar_mass", "point_mass", "fixed"):
        np.testing.assert_array_equal(getattr(found.structure, field), getattr(structure, field))
    assert sorted(found.structure.rollers) == sorted(structure.rollers)
    assert found.structure.string_groups == structure.string_groups
    np.testing.assert_array_equal(found.model.strings.stiffness, law.stiffness)
    np.testing.assert_array_equal(found.rest_length, rest)


CROSS = "x,y\n0,0\n1,0\n1,1\n0,1\n"
MEMBERS = "kind,start,end\nbar,0,2\nbar,1,3\nstring,0,1\nstring,1,2\nstring,2,3\nstring,3,0\n"


@pytest.mark.parametrize(
    ("nodes", "members", "message"),
    [
        ("", MEMBERS, "nodes.csv has the columns none, expected x, y in its first row"),
        ("x,y\n", MEMBERS, "nodes.csv has no rows"),
        (CROSS.replace("x,y", "x,q"), MEMBERS, r"a column of .*nodes.csv is 'q'"),
        (CROSS.replace("1,1", "1,one"), MEMBERS, "nodes.csv, row 4: y is 'one', expected a number"),
        (CROSS.replace("1,1", "1,nan"), MEMBERS, "row 4: y is 'nan', expected a number"),
        (CROSS.replace("1,1", "1"), MEMBERS, "row 4: 1 cells, expected 2"),
        (CROSS, MEMBERS.replace("bar,1,3", "bar,1,7"), "members.csv, row 3: end is '7'"),
        (CROSS, MEMBERS.replace("bar,1", "rope,1"), "members.csv, row 3: kind is 'rope'"),
        (
            CROSS,
            "kind,start,end,stiffness\nbar,0,2,\nbar,1,3,\nstring,0,1,5\nstring,1,2,",
            "row 5: stiffness is empty, and other strings have one",
        ),
    ],
)
def test_what_is_wrong_in_a_table_is_named(nodes, members, message, tmp_path):
    (tmp_path / "nodes.csv").write_text(nodes)
    (tmp_path / "members.csv").write_text(members)
    with pytest.raises(ValueError, match=message):
        tc.exchange.from_csv(tmp_path / "nodes.csv", tmp_path / "members.csv")


def test_cells_that_python_would_refuse_by_itself(tmp_path):
    """Numbers of more digits than Python reads, cells longer than its csv module reads."""
    nodes, members = tmp_path / "nodes.csv", tmp_path / "members.csv"
    nodes.write_text(CROSS)
    members.write_text(MEMBERS.replace("bar,1,3", f"bar,1,{'3' * 5_000}"))
    with pytest.raises(ValueError, match=r"members\.csv, row 3: end is '33+, expected the name"):
        tc.exchange.from_csv(nodes, members)
    for text in (f"x,y\n{'1' * 200_000},2\n", 'x,y\n0,"' + "1\n" * 100_000):
        nodes.write_text(text)
        with pytest.raises(ValueError, match=r"nodes\.csv, line \d+: not CSV: field larger than"):
            tc.exchange.from_csv(nodes, members)
    nodes.write_bytes(b"x,y\n\xff,1\n")
    with pytest.raises(ValueError, match=r"nodes\.csv:2: not UTF-8 text"):
        tc.exchange.from_csv(nodes, members)


def test_tables_that_become_too_much_memory_are_refused(tmp_path, monkeypatch):
    (tmp_path / "nodes.csv").write_text(CROSS + "0,0\n" * 1_000)
    monkeypatch.setattr(tc.validation, "_MOST_BYTES", 500_000)
    with pytest.raises(ValueError, match=r"nodes\.csv: it has 1,006 rows and 2,011 cells, which"):
        tc.exchange.from_csv(tmp_path / "nodes.csv", tmp_path / "members.csv")


def test_the_lines_of_a_table_are_read_in_work_that_grows_as_the_file(tmp_path):
    """Steps of the reader, a line or a turn of a loop each: twice as many for twice the rows."""
    steps = []

    def traced(frame, event, _):
        if not frame.f_code.co_filename.endswith("csv_tables.py"):
            return None
        steps[-1] += event == "line"
        return traced

    for count in (100, 200):
        nodes, members = tmp_path / "nodes.csv", tmp_path / "members.csv"
        nodes.write_text("x,y\n" + "".join(f"{i},{i % 3}\n" for i in range(2 * count)))
        members.write_text(
            "kind,start,end\n" + "".join(f"bar,{2 * i},{2 * i + 1}\n" for i in range(count))
        )
        before = sys.gettrace()
        steps.append(0)
        sys.settrace(traced)
        try:
            tc.exchange.from_csv(nodes, members)
        finally:
            sys.settrace(before)
    assert steps[0] > 1_000
    assert steps[1] < 2.1 * steps[0]


# ---- VTK ----


def arrays(file):
    """All arrays of a file by name."""
    found = {}
    for data in ElementTree.parse(file).getroot().iter("DataArray"):
        values = np.array((data.text or "").split(), dtype=float)
        width = int(data.get("NumberOfComponents", 1))
        found[data.get("Name")] = values.reshape(-1, width) if width > 1 else values
    return found


def test_a_run_is_a_series_of_shapes_with_tensions(run, tmp_path):
    first, *frames = tc.exchange.to_vtk(run, tmp_path / "run.pvd")
    listed = list(ElementTree.parse(first).getroot().iter("DataSet"))
    assert [tmp_path / each.get("file") for each in listed] == frames
    np.testing.assert_array_equal([float(each.get("timestep")) for each in listed], run.time)
    last, structure = arrays(frames[-1]), run.structure
    np.testing.assert_array_equal(last["nodes"], run.nodes[..., -1].T)
    np.testing.assert_array_equal(last["velocity"], run.velocities[..., -1].T)
    lines = last["connectivity"].reshape(-1, 2)
    np.testing.assert_array_equal(lines, np.vstack([structure.bars, structure.segments]))
    np.testing.assert_array_equal(last["offsets"], 2 * np.arange(1, len(lines) + 1))
    length = structure.string_length(run.nodes[..., -1])
    pull = np.maximum(0, 500 * (length - run.rest_length[:, -1]))
    np.testing.assert_allclose(last["tension"][6:], pull[structure.segment_string], atol=1e-9)
    own = np.linalg.norm(structure.string_vectors(run.nodes[..., -1]), axis=0)
    np.testing.assert_allclose(last["force_density"][6:] * own, last["tension"][6:], atol=1e-9)
    assert not last["tension"][:6].any()


def test_a_planar_shape_lies_in_x_and_y(tmp_path):
    (file,) = tc.exchange.to_vtk(tc.library.d_bar(), tmp_path / "d_bar.vtp")
    found = arrays(file)
    assert found["nodes"].shape == (4, 3)
    assert not found["nodes"][:, 2].any()
    np.testing.assert_array_equal(found["kind"], [0, 0, 0, 0, 1, 1])


def test_what_is_neither_a_structure_nor_a_run_is_refused(tmp_path):
    with pytest.raises(TypeError, match="source is a int, expected Structure or Trajectory"):
        tc.exchange.to_vtk(3, tmp_path / "x.vtp")
    with pytest.raises(ValueError, match="expected a name ending in"):
        tc.exchange.to_vtk(BALL, tmp_path / "x.txt")
