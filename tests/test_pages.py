"""The pages of the documentation: their code runs as written, and the search finds them."""

import re
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import ControlWarning
from tenscontrol.dynamics.machine_code import compiler
from tests.code_blocks import blocks
from tests.docs_search import found

DOCS = Path(__file__).parent.parent / "docs"


def ran(page, **instead):
    """Run the code of a page, one block after the other; return all names.

    ``instead`` has texts that are put into the code in place of others, which would take long.
    """
    code = "\n".join(
        each.code for each in blocks(page) if each.language == "python" and not each.fragment
    )
    assert code
    for old, new in instead.items():
        assert old in code
        code = code.replace(old, new)
    names = {"__name__": "__main__"}
    exec(compile(code, page, "exec"), names)
    plt.close("all")
    return names


def test_mpc():
    with pytest.warns(RuntimeWarning, match=r"no string reaches 1 mode of .*at 2\.013 Hz"):
        names = ran("mpc", **{"heavy,\n    1.0,": "heavy,\n    0.3,"})
    run = names["run"]
    assert np.abs(run.control.winch_rate).max() < 0.15 + 1e-9
    assert set(run.control.status) == {"ok"}
    heights = run.nodes[2, :3].mean(axis=0) - run.nodes[2, 3:].mean(axis=0)
    assert heights[0] == pytest.approx(1.0)
    assert heights[-1] == pytest.approx(0.85, abs=5e-3)
    assert set(names["morph"].control.status) == {"ok"}
    assert names["jump"].nodes[1].min(axis=0)[300:].max() > 0.1


def test_few_motors():
    names = ran("few_motors")
    passive = names["plant"].actuation.passive
    assert len(passive) == 24
    assert names["wound"][passive].max() == 0
    assert names["wound"].max() > 0
    assert np.allclose(
        names["target"].rest_length[passive], names["plant"].rest_length[passive], atol=1e-9
    )
    assert len(names["choice"].string) == 6


def test_stepping():
    names = ran("stepping")
    assert names["robot"].time == pytest.approx(0.2)
    assert names["seen"].shape[0] == 8
    assert 0 < names["env"].unwrapped.step_error() < 1e-3


def test_winches(monkeypatch):
    monkeypatch.syspath_prepend(DOCS.parent / "examples")  # the study is a file to copy
    names = ran("winches", **{"[1e2, 1e4]": "[1e2]"})
    limits = [names["report"].limit("MPC", held) for held in ("force_density", "rest_length")]
    assert limits == [1e2, 1e2]
    assert names["motors"].energy.shape[0] == len(names["tower"].strings)
    assert np.ptp(names["run"].nodes[0], axis=1).max() > 1e-3


def test_estimation():
    names = ran("estimation", **{"model, 4.0, start": "model, 2.0, start"})
    assert names["y"].shape == (12,)
    assert names["rocking"].sensors.readings[-1] == "bar_rate 3"
    off = names["run"].nodes[:, :, -1] - names["prism"].nodes
    assert np.abs(off).max() < 5e-3  # from 15 mm


def test_faults(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = ThreadPoolExecutor(1)
    monkeypatch.setattr(tc, "here", here, raising=False)
    few = {"count=200": "count=4, executor=tc.here", "progress=True": "progress=False"}
    with here, pytest.warns(ControlWarning, match="comes no nearer"):
        names = ran("faults", **few)
    control = names["run"].control
    assert "string 6 cut from 0.9 s" in capsys.readouterr().out
    assert control.status_count["measurement not finite"] == 5
    assert control.fallback_count == {"plan continued": 5}
    assert sum(control.status_count.values()) == 60
    assert len((tmp_path / "prism.jsonl").read_text().splitlines()) == 5
    assert names["batch"].nodes.shape[:3] == (100, 3, 6)


def test_ground():
    names = ran("ground", **{"model, 15.0,": "model, 0.3,", "rough, 1.0,": "rough, 0.3,"})
    assert names["bounced"].nodes[0].max() < 1.05  # in front of the wall
    assert -0.96 < names["landed"].nodes[2].min() < -0.9
    assert names["stance"].contacts.normal_force.sum() == pytest.approx(6 * 9.81, rel=1e-9)
    held = names["held"]
    assert np.abs(held.velocities[:, :, -1]).max() < 0.2 * np.abs(held.velocities[:, :, 0]).max()
    assert np.ptp(names["run"].nodes[2], axis=1).max() > 1e-3  # it is on its way


def test_accuracy():
    names = ran("accuracy", **{"stages=100": "stages=20"})
    assert names["second"].time[-1] == pytest.approx(1.0)


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_deployment(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert ran("deployment")["run"].control.status_count == {"ok": 150}
    assert (tmp_path / "prism_mpc" / "controller.h").exists()


def test_own_controllers():
    run = ran("own_controllers")["run"]
    assert run.control.controller.startswith("FunctionController(policy, input 'force_density'")
    assert run.control.status_count == {"ok": 25}


def test_files(tmp_path, monkeypatch):
    pytest.importorskip("xarray", reason="the extra tenscontrol[xarray] is not installed")
    monkeypatch.chdir(tmp_path)
    names = ran("files")
    assert names["more"].time[0] == names["run"].time[-1] == 0.2
    assert {path.name for path in tmp_path.iterdir()} == {"ball.toml", "run.npz", "run.csv"}


def test_structures():
    assert ran("structures")["arm"].structure_class == 3


def test_figures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = ran("figures", **{"len(run.time), 20)": "len(run.time), 180)"})["run"]
    assert np.abs(run.nodes - run.nodes[:, :, :1]).max() > 0.01
    assert {path.name for path in tmp_path.iterdir()} == {"tower.pdf", "tower.gif"}


def test_limits_are_refused_in_these_words():
    names = ran("limits")
    assert "did you mean 0.02 (20 ms)?" in names["unit"]
    assert "cannot be cut into segments" in names["clustered"]
    assert "without a change of shape" in names["place"]


def test_coming_from():
    names = ran("coming_from")
    assert names["A"].shape == (8, 6)  # coordinates, members
    assert names["least"].bar_mass.round(4).tolist() == [2.0918] * 4
    assert round(names["least"].mass, 4) == 8.8580
    assert names["lowest"].round(4).tolist() == [0.0109, 0.0195, 0.0340]
    assert names["hung"].string_length(names["run"].nodes[..., 0])[0] == 0.5
    assert names["command"] == pytest.approx(names["plant"].force_density, abs=1e-6)


def test_interop():
    near = {
        "[500.0, 50.0]": "[640.0, 41.0]",
        '{"xatol": 1e-4, "fatol": 1e-10}': "dict(xatol=5e-4, fatol=1e-7)",
    }
    names = ran("interop", **near)
    theirs, ours = names["theirs"], names["ours"]
    assert names["packed"](ours.nodes[..., -1], ours.velocities[..., -1]) == pytest.approx(
        theirs.y[:, -1], abs=1e-8
    )
    assert tc.modes(names["tall"], count=6).frequency == pytest.approx(names["lowest"], rel=1e-6)
    assert np.exp(names["fitted"].x) == pytest.approx([650.0, 40.0], rel=1e-3)
    assert abs(names["step"].outputs).max() < 4e-3
    assert len(names["robust"]) == (2 if find_spec("slycot") else 0)
    for run in (names["run"], names["lqg"], *names["robust"].values()):
        speed = np.abs(run.velocities).max(axis=(0, 1))
        assert speed[-1] < 0.2 * speed[0]


def test_optimal_motion():
    coarse = {
        "0.4, tolerance=1e-3": "0.4, tolerance=0.1, intervals=6, cost_tolerance=None",
        "intervals=10, tolerance=3e-3": "intervals=10",
        "intervals=10": "intervals=6, tolerance=0.1, cost_tolerance=None",
        "winches)\nprint(motion": "winches, tolerance=0.02, cost_tolerance=None)\nprint(motion",
    }
    names = ran("optimal_motion", **coarse)
    motion, path = names["motion"], names["path"]
    assert motion.duration < 0.2
    assert motion.end_speed < 1e-3
    bound = np.ptp(path.rest_length[:, [0, -1]], axis=1).max() / 0.8
    assert bound < motion.duration < 0.25
    played = names["played"]
    off = np.abs(played.nodes[..., -1] - names["goal"].nodes).max()
    assert off > 0.02
    assert np.abs(played.velocities[..., -1]).max() > 0.2
    assert names["gentle"].energy < 0.5 * motion.energy
    ball = names["kept_clear"].run.nodes[:, 5] - np.array(names["centre"])[:, None]
    assert np.linalg.norm(ball, axis=0).min() > 0.04 - 2e-3
    tracked = names["tracked"]
    off = np.abs(tracked.nodes[..., -1] - names["goal"].nodes).max()
    assert off < 0.01


@pytest.mark.skipif(find_spec("slycot") is not None, reason="slycot is installed")
def test_functions_of_python_control_that_need_slycot_are_named():
    table = (DOCS / "interop.rst").read_text(encoding="utf-8").split("needs slycot", 1)[1]
    needs = set(re.findall(r"``(\w+)``", table.split("     - ``h2syn``", 1)[1])) | {"h2syn"}
    A, B = np.array([[0.0, 1.0], [-2.0, -0.5]]), np.eye(2)
    system = control.ss(A, B, B, 0 * B)
    for name, arguments in {
        "h2syn": (1, 1), "hinfsyn": (1, 1), "balanced_reduction": (1,), "gram": ("c",),
        "hankel_singular_values": (), "linfnorm": (), "minimal_realization": (),
    }.items():  # fmt: skip
        assert name in needs
        with pytest.raises((control.ControlSlycot, TypeError), match="slycot"):
            getattr(control, name)(system, *arguments)
    with pytest.raises(control.ControlSlycot):
        control.place_varga(A, B, [-1.0, -2.0])


# ---- the search ----

INDEX = {
    "docnames": ["ground", "api", "save"],
    "titles": ["Ground", "API", "Files"],
    "alltitles": {"Ground": [[0, None]], "API": [[1, None]], "Files": [[2, None]]},
    "indexentries": {"gravity": [[0, "index-0", True]], "saves": [[1, "i", False]]},
    "objects": {"tenscontrol": [[1, 0, 1, "", "Ground"], [1, 0, 1, "", "save_figure"]]},
    "objnames": {"0": ["py", "class", "Python class"]},
    "terms": {"ground": [0, 1], "save": 2, "figur": [1, 2], "graviti": 1},
    "titleterms": {"ground": 0, "file": 2},
}


@pytest.mark.parametrize(
    ("query", "pages"),
    [
        ("ground", ["ground", "api", "ground", "api"]),  # title, object, its word, a word
        ("gravity", ["ground"]),  # a main index entry
        ("save", ["api", "save", "api"]),  # an object, a word, and last an aside
        ("save figure", ["api"]),  # once, though both words are its name
        ("gravity file", []),  # no page has both
        ("nothing", []),
    ],
)
def test_search_orders_pages_as_sphinx_does(query, pages):
    assert [page for _, page, _ in found(INDEX, query)] == pages
