"""The notebooks, which the build of the documentation runs: code and text, without outputs."""

import json
import re

import pytest

from tests.code_blocks import DOCS

NOTEBOOKS = sorted(DOCS.glob("notebooks/*.ipynb"))


def test_each_notebook_has_a_place_in_the_documentation():
    index = (DOCS / "index.rst").read_text("utf-8")
    shown = re.findall(r"^   notebooks/(\w+)$", index, re.MULTILINE)
    assert sorted(shown) == [path.stem for path in NOTEBOOKS]
    assert len(shown) == 3


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_code_and_text_alone(path):
    notebook = json.loads(path.read_text("utf-8"))
    assert notebook["nbformat"] == 4
    for cell in notebook["cells"]:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None
        if cell["cell_type"] == "code":
            compile("".join(cell["source"]), path.name, "exec")
