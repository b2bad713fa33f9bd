"""What the search of the built documentation finds first.

Run: ``python -m tests.docs_search FOLDER``, where FOLDER has the HTML pages. It prints the first
page for each word of :data:`FIRST`, and ends with status 1 if one is another than expected. The
scores are those of Sphinx 9 (``searchtools.js``): titles, index entries, objects, words.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

FIRST = {  # what users type, and the page that they should see first
    "ground": "ground",
    "gravity": "ground",
    "class 2": "structures",
    "own controller": "own_controllers",
    "Opti": "interop",
    "save": "files",
    "MuJoCo": "exchange",
    "units": "limits",
    "slycot": "interop",
}
_TITLE, _PART_OF_TITLE, _TERM, _PART_OF_TERM = 15, 7, 5, 2
_NAME, _PART_OF_NAME, _PRIORITY = 11, 6, {0: 15, 1: 5, 2: -5}


def load(folder):
    """Return the search index of a folder of HTML pages."""
    text = (Path(folder) / "searchindex.js").read_text(encoding="utf-8")
    return json.loads(text.removeprefix("Search.setIndex(").rstrip(";\n").removesuffix(")"))


def found(index, query, stem=str.lower):
    """Return ``(score, page, title)`` of all that a query finds, the first first.

    ``stem`` makes of a word what the index has of it.
    """
    docs, titles, low = index["docnames"], index["titles"], query.lower().strip()
    hits = []
    for title, places in index["alltitles"].items():
        if low in title.lower() and len(low) >= len(title) / 2:
            score = round(_TITLE * len(low) / len(title))
            for doc, _ in places:
                own = titles[doc] == title
                hits.append((score + own, docs[doc], title if own else f"{titles[doc]} > {title}"))
    asides = []  # index entries that are not the main one, shown last
    for entry, places in index["indexentries"].items():
        if low in entry and len(low) >= len(entry) / 2:
            for doc, _, main in places:
                hit = round(100 * len(low) / len(entry)), docs[doc], titles[doc]
                (hits if main else asides).append(hit)
    words = [word for word in re.split(r"\W+", low) if word]
    hits += [hit for word in words for hit in _objects(index, word, words)]
    hits += _texts(index, [stem(word) for word in words if not word.isdigit()])
    return [*_ordered(hits), *_ordered(asides)]


def _ordered(hits):
    return sorted(set(hits), key=lambda hit: (-hit[0], hit[2].lower()))


def _objects(index, word, words):
    for prefix, objects in index["objects"].items():
        for doc, kind, priority, _, name in objects:
            full = f"{prefix}.{name}" if prefix else name
            last, title = full.lower().split(".")[-1], index["titles"][doc]
            around = f"{prefix} {name} {index['objnames'][str(kind)][2]} {title}".lower()
            if word not in full.lower() or any(each not in around for each in words):
                continue
            match = _NAME if word in (last, full.lower()) else _PART_OF_NAME * (word in last)
            yield match + _PRIORITY.get(priority, 0), index["docnames"][doc], full


def _texts(index, words):
    """Pages that have all words, each with the score of its best word."""
    scores = {}
    for word in words:
        for table, whole, part in (
            ("terms", _TERM, _PART_OF_TERM),
            ("titleterms", _TITLE, _PART_OF_TITLE),
        ):
            terms = index[table]
            if word in terms:
                matches = [(terms[word], whole)]
            else:
                matches = [
                    (docs, part) for term, docs in terms.items() if len(word) > 2 and word in term
                ]
            for docs, score in matches:
                for doc in docs if isinstance(docs, list) else [docs]:
                    best = scores.setdefault(doc, {})
                    best[word] = max(score, best.get(word, 0))
    for doc, best in scores.items():
        if len(best) == len(set(words)):
            yield max(best.values()), index["docnames"][doc], index["titles"][doc]


def main(arguments):
    import snowballstemmer  # comes with Sphinx

    (folder,) = arguments
    index, stem = load(folder), snowballstemmer.stemmer("english").stemWord
    wrong = 0
    for query, page in FIRST.items():
        _, first, _ = [*found(index, query, stem), (0, "nothing", "")][0]
        wrong += first != page
        print(f"{query:16} {first:16} {'' if first == page else f'expected {page}'}".rstrip())
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
