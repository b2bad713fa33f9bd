"""Plain English in the README and on the pages: short sentences, no worn or empty words."""

import itertools
import re

import pytest

from tests.code_blocks import DOCS, PAGES, PROJECT

LONGEST = 30  # words in a sentence
WRITTEN = ["README", *sorted(path.stem for path in DOCS.glob("*.rst"))]

# Phrases that a reader has to translate, and what to write in their place.
AVOID = {
    r"that which": "name the thing",
    r"what (comes|stands|goes)\b": "name the thing",
    r"where it is so": "if it is",
    r"at one blow": "at once",
    r"from all sides": "say what is looked at",
    r"\bgoes by\b": "passes, follows",
    r"\bstands? in\b": "is in",
    r"\bas well as\b": "and",
    r"\bin order to\b": "to",
    r"\bin the course of\b": "during",
    r"\bdue to the fact\b": "because",
    r"\butili[sz]e": "use",
    r"\bleverag": "use",
    r"\b(very|simply|obviously|basically|actually|of course)\b": "leave it out",
    r"\b(seamless|powerful|cutting-edge|state-of-the-art|blazing|effortless)": "give a figure",
    r"\b(thereof|therein|hereby|whilst|upon|whence)\b": "use a common word",
    r"\bwho (wants|does|needs)\b": "to …, or: if you want",
    r"\bthe (house|road|stop)\b": "the field's word",
    r"\be\.g\.|\bi\.e\.|\betc\.": "for example, that is, and so on",
}

# Sentences that may break a rule, by their beginning.
EXCEPTIONS: dict[str, str] = {}


_SIMPLE_TABLE = re.compile(r"^( *)=+(?: +=+)+ *\n(?:\1.*\n)+?\1=[= ]*\n(?!\1\S)", re.MULTILINE)
_GRID_TABLE = re.compile(r"^( *)\+(?:-+\+)+ *\n(?:\1[|+].*\n)+", re.MULTILINE)


def cells(table):
    """Return the cells of a simple table or of a grid table, each a paragraph.

    Columns are those of its first line. A line whose first column is empty, or that is not the
    first after a rule of a grid, goes on with the row above. A line with text across the space
    between two columns has columns that are joined: it is a row of its own, of one cell.
    """
    lines = table.splitlines()
    columns = [match.span() for match in re.finditer(r"=+|(?<=\+)-+", lines[0])]
    grid = "+" in lines[0]
    gaps = [(end, start) for (_, end), (start, _) in itertools.pairwise(columns)]
    ends = [start for _, start in gaps] + [None]
    rows, goes_on = [], False
    for line in lines:
        if not line.strip("=-+ "):
            goes_on = False
            continue
        if any(line[end:start].strip(" |") for end, start in gaps):
            rows.append([line])
            goes_on = False
            continue
        found = [line[start:end].strip(" |") for (start, _), end in zip(columns, ends, strict=True)]
        if goes_on and (grid or not found[0]):
            rows[-1] = [f"{above} {below}" for above, below in zip(rows[-1], found, strict=True)]
        else:
            rows.append(found)
        goes_on = True
    return "\n\n" + "\n\n".join(cell.strip() for row in rows for cell in row) + "\n\n"


def prose(text):
    """Return the paragraphs of a page in Markdown or reStructuredText, without code and markup."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^\|[-| ]+\|$", "", text, flags=re.MULTILINE)
    for table in (_SIMPLE_TABLE, _GRID_TABLE):
        text = table.sub(lambda match: cells(match[0]), text)
    # A directive with what belongs to it; of a table its cells stay.
    text = re.sub(
        r"^( *)\.\. (?!list-table)\S.*\n((?:\1 +.*\n|\n)*)", "\n", text + "\n", flags=re.MULTILINE
    )
    text = re.sub(r"^ *(\.\. list-table::|:[\w-]+:(?!`)).*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"^ *(\* - |[*-] )", "\n\n", text, flags=re.MULTILINE)
    text = re.sub(r"^(=|-|#)+( .*)?$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"`+[^`]*`+_?", "x", re.sub(r":\w+:`", "`", text))  # names count as one word
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = text.replace("|", "\n\n")
    return [" ".join(each.split()) for each in re.split(r"\n\s*\n", text) if each.strip()]


def sentences(text):
    """Return the sentences of a page, titles and cells of tables among them."""
    return [
        sentence.strip(" *")
        for paragraph in prose(text)
        for sentence in re.split(r'(?<=[.!?])[)*]*\s+(?=["A-ZÀ-Ž*`(x\d])', paragraph)
    ]


def page_text(page):
    path = PROJECT / "README.md" if page == "README" else PAGES[page]
    return path.read_text(encoding="utf-8")


def words(sentence):
    return re.findall(r"\w[\w'’./-]*", sentence)


@pytest.mark.parametrize("page", WRITTEN)
def test_sentences_are_short(page):
    found = sentences(page_text(page))
    assert found
    long = {each: len(words(each)) for each in found if len(words(each)) > LONGEST}
    assert {each: n for each, n in long.items() if not each.startswith(tuple(EXCEPTIONS))} == {}


@pytest.mark.parametrize("page", WRITTEN)
def test_words_are_plain(page):
    found = [
        (sentence, found[0], f"write: {instead}")
        for sentence in sentences(page_text(page))
        for phrase, instead in AVOID.items()
        if (found := re.search(phrase, sentence, flags=re.IGNORECASE))
        and not sentence.startswith(tuple(EXCEPTIONS))
    ]
    assert found == []


def test_a_sentence_that_is_too_long_is_found():
    long = "Word " * (LONGEST + 1)
    code = f".. code-block:: sh\n\n   {long}\n\n"
    text = f"Title\n=====\n\nShort one. {long}.\n\n{code}A list:\n\n- ``x``\n"
    assert [len(words(each)) for each in sentences(text)] == [1, 2, LONGEST + 1, 2, 1]
    markdown = f"# Title\n\n```sh\n{long}\n```\n\n| {long} | cell |\n|---|---|\n"
    assert [len(words(each)) for each in sentences(markdown)] == [LONGEST + 1, 1]


def test_cells_of_tables_and_items_of_lists_are_sentences_of_their_own():
    rule = "======  =====\n"
    simple = f"Before.\n\n{rule}a b     one\n        two\nc       three\n{rule}\nAfter, x.\n"
    assert sentences(simple) == ["Before.", "a b", "one two", "c", "three", "After, x."]
    joined = f"{rule}of two columns\n-------------\na       b\n{rule}c       d\n{rule}"
    assert sentences(joined) == ["of two columns", "a", "b", "c", "d"]
    rule = "+-----+-----+\n"
    grid = f"{rule}| a b | one |\n|     | two |\n{rule}| c   | d   |\n{rule}\nAfter.\n"
    assert sentences(grid) == ["a b", "one two", "c", "d", "After."]
    assert sentences("A list:\n\n* one\n  two\n* *three*\n") == ["A list:", "one two", "three"]


def test_prose_next_to_a_table_is_not_cut():
    long = "Word " * (LONGEST + 1)
    rule = "======  =====\n"
    text = f"Title\n=====\n\n{long}\n{long}\n\n{rule}a       {long}\n{rule}\n{long}\n\n  * {long}\n"
    assert [len(words(each)) for each in sentences(text)] == [
        1, 2 * (LONGEST + 1), 1, LONGEST + 1, LONGEST + 1, LONGEST + 1,
    ]  # fmt: skip
