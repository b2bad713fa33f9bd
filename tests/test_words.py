"""Plain English in the README and on the first pages: short sentences, no worn or empty words."""

import re

import pytest

from tests.code_blocks import PAGES, PROJECT

LONGEST = 30  # words in a sentence
FIRST_PAGES = ["index", "install", "first_structure", "modes", "lqr", "first_hour"]

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


def prose(text):
    """Return the paragraphs of a page in Markdown or reStructuredText, without code and markup."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^\|[-| ]+\|$", "", text, flags=re.MULTILINE)
    # A directive with what belongs to it; of a table its cells stay.
    text = re.sub(
        r"^( *)\.\. (?!list-table)\S.*\n((?:\1 +.*\n|\n)*)", "\n", text + "\n", flags=re.MULTILINE
    )
    text = re.sub(r"^ *(\.\. list-table::|:[\w-]+:(?!`)).*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"^ *(\* )?- ", "\n\n", text, flags=re.MULTILINE)
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
        for sentence in re.split(r"(?<=[.!?])[)*]*\s+(?=[A-ZÀ-Ž*`(x\d])", paragraph)
    ]


def page_text(page):
    path = PROJECT / "README.md" if page == "README" else PAGES[page]
    return path.read_text(encoding="utf-8")


def words(sentence):
    return re.findall(r"\w[\w'’./-]*", sentence)


@pytest.mark.parametrize("page", ["README", *FIRST_PAGES])
def test_sentences_are_short(page):
    found = sentences(page_text(page))
    assert len(found) > 10
    long = {each: len(words(each)) for each in found if len(words(each)) > LONGEST}
    assert {each: n for each, n in long.items() if not each.startswith(tuple(EXCEPTIONS))} == {}


@pytest.mark.parametrize("page", ["README", *FIRST_PAGES])
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
