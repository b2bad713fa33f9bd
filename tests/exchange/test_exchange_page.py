"""The page on other programs runs as it is written."""

import re
import textwrap
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "exchange.rst"


def test_the_page_on_other_programs_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mujoco", reason="MuJoCo comes with the extra test")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r".. code-block:: python\n\n((?:   .*\n|\n)+)", PAGE.read_text("utf-8"))
    assert len(blocks) == 6
    names: dict = {}
    exec(textwrap.dedent("".join(blocks)), names)
    assert capsys.readouterr().out.splitlines()[1] == "Structure(12 nodes, 6 bars, 24 strings)"
    assert names["error"] < 1e-7
    assert names["found"].structure.structure_class == 1
    assert names["frame"].structure.rollers == ((1, "y"),)
    assert (tmp_path / "ball.pvd").exists()
