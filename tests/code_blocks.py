"""Code blocks of the README and of the documentation, and what they print."""

import contextlib
import io
import re
import textwrap
import warnings
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt

from tenscontrol.core.library import library

PROJECT = Path(__file__).parent.parent
DOCS = PROJECT / "docs"
PAGES = {
    path.relative_to(DOCS).with_suffix("").as_posix(): path
    for path in sorted([*DOCS.glob("*.rst"), *DOCS.glob("api/*.rst")])
}

_BLOCK = re.compile(
    r"^( *)\.\. code-block:: (\w+)\n((?:\1   :.*\n)*)\n((?:\1   .*\n|\n)+)", flags=re.MULTILINE
)
_NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Block:
    """Code of a page: its section, and what it prints if the page says that.

    A fragment, ``:class: fragment``, is not complete and does not run.
    """

    page: str
    section: str
    language: str
    code: str
    fragment: bool = False
    printed: str | None = None


def blocks(page):
    """Return the blocks of a page in order; a text block next to code is what that prints."""
    text = PAGES[page].read_text(encoding="utf-8")
    titles = [
        (each.start(), each[1]) for each in re.finditer(r"^(\S.*)\n[=\-]{3,}\n", text, re.MULTILINE)
    ]
    found, end = [], 0
    for match in _BLOCK.finditer(text):
        _, language, options, code = match.groups()
        code = textwrap.dedent(code)
        if language == "text" and found and not text[end : match.start()].strip():
            found[-1] = Block(**{**vars(found[-1]), "printed": code})
        else:
            section = [title for at, title in titles if at < match.start()][-1]
            found.append(Block(page, section, language, code, ":class: fragment" in options))
        end = match.end()
    return found


def run(block, names):
    """Run a block with these names, check what it prints, and return its warnings.

    Pages show runs in the core. Without it a summary has a line more, and the page on trust, which
    prints round-off and rejected steps, has other numbers, within a factor of two.
    """
    out = io.StringIO()
    with warnings.catch_warnings(record=True, action="always") as caught:
        with contextlib.redirect_stdout(out):
            exec(compile(block.code, f"{block.page}: {block.section}", "exec"), names)
        plt.close("all")
    if block.printed is not None:
        printed, part = out.getvalue(), 0.1
        if library() is None:
            printed = printed.replace("steps run in      virtual machine\n", "")
            part = 0.5 if block.page == "trust" else part
        assert agree(printed, block.printed, part), (
            f"{block.page}, {block.section}: prints\n{printed}"
        )
    return [str(each.message) for each in caught]


def agree(printed, said, part=0.1):
    """Whether two texts have the same words, and numbers within a part of them or round-off."""
    if _NUMBER.sub("#", printed).split() != _NUMBER.sub("#", said).split():
        return False
    pairs = zip(_NUMBER.findall(printed), _NUMBER.findall(said), strict=True)
    numbers = ((float(a), float(b)) for a, b in pairs)
    return all(abs(a - b) <= max(part * max(abs(a), abs(b)), 1e-9) for a, b in numbers)
