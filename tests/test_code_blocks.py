"""Every code block of the documentation runs, or is of a kind that does not run here."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from tenscontrol.dynamics.machine_code import compiler
from tests.code_blocks import PAGES, PROJECT, agree, blocks, run
from tests.test_first_hour import PAGES as FIRST_HOUR

# Shell, files and output; other languages are code that has to run.
SHOWN = {
    "sh", "console", "powershell", "text", "toml", "json", "c", "xml", "yaml", "matlab", "bibtex",
}  # fmt: skip

_WARNING = re.compile(r"\w+Warning: ")

# Pages of which a test asks for more than that they run: ``ran("page")``.
TESTED = {"index", *FIRST_HOUR}

# Of pages that take long: what is put into the code in place of others.
SHORTER = {
    "identification": {"most_rollouts=12": "most_rollouts=4"},
    "microcontroller": {"    8.0,": "    0.3,", "made.memory()": "made.memory(options=('-O0',))"},
    "sizing": {"(2, 3, 4, 6, 8)": "(2, 4)", "varied, 20,": "varied, 4,"},
}
for _path in Path(__file__).parent.glob("test_*.py"):
    TESTED |= set(re.findall(r'\bran\("(\w+)"', _path.read_text("utf-8")))


def test_a_block_is_code_that_runs_or_is_shown():
    for page in PAGES:
        for block in blocks(page):
            assert block.language in SHOWN | {"python"}, (page, block.section)


@pytest.mark.parametrize("page", PAGES)
def test_no_code_without_a_language(page):
    text = PAGES[page].read_text(encoding="utf-8")
    bare = re.findall(r"^(?! *\.\.).*\w.*::\n\n +\S.*", text, flags=re.MULTILINE)
    assert bare == [], "write .. code-block:: and the language"
    assert text.count(".. code-block::") == sum(
        1 + (block.printed is not None) for block in blocks(page)
    )


@pytest.mark.parametrize(
    "page",
    [
        page
        for page in PAGES
        if page not in TESTED
        and any(block.language == "python" and not block.fragment for block in blocks(page))
    ],
)
def test_a_page_runs(page, tmp_path, monkeypatch):
    if "generate_c" in PAGES[page].read_text("utf-8") and compiler() is None:
        pytest.skip("there is no C compiler")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(PROJECT / "examples")  # where a page copies from
    names, messages, replaced = {}, [], 0
    for block in blocks(page):
        if block.language == "python" and not block.fragment:
            code = block.code
            for old, new in SHORTER.get(page, {}).items():
                replaced += old in code
                code = code.replace(old, new)
            warned = run(replace(block, code=code), names)
            assert not warned or "# warns" in block.code, (block.section, warned)
            messages += warned
        elif _WARNING.match(block.code):  # the page shows it after the code
            told = _WARNING.sub("", block.code)
            assert any(agree(message, told) for message in messages), (told, messages)
    assert replaced == len(SHORTER.get(page, {}))


def test_agreement_of_what_is_printed():
    assert agree("off by 1e-14 m, 3 of 4", "off by  2e-16 m,\n3 of 4")
    assert agree("1.02 Hz", "1.0 Hz")
    assert not agree("1.2 Hz", "1.0 Hz")
    assert not agree("1.0 Hz", "1.0 rad/s")
    assert not agree("2 modes", "1 modes")
