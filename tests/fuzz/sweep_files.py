"""Spoilt sweep files: each is read to the same numbers, or refused with its name and line.

``python -m tests.fuzz.sweep_files --count 5000`` spoils so many, by seeded mutations, and prints
how they ended. A few are spoilt in the ordinary suite, by ``test_sweep_files.py``.
"""

import argparse
import json
import random
import re
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path
from zlib import crc32

import tenscontrol as tc
from tests.robustness.cases import PARAMETERS, Inline, noisy

COUNT, MORE, SEED = 8, 12, 7

VALUES = [
    "false", "true", "null", "NaN", "Infinity", "-Infinity", "1e999", "-0.0", "0", "1", "-1", "1.0",
    "1e308", "9" * 30, "9" * 5000, '"false"', '""', '"1.0"', "[]", "[1.0]", "{}", '{"a": 1.0}',
    '"\\ud800"', "[" * 3000 + "]" * 3000, "[" * 50_000, '{"a":' * 50_000,
]  # fmt: skip


def swept(file=None):
    """The sweep whose file is spoilt; it was made longer once."""
    for count in (COUNT, MORE):
        report = tc.sweep(noisy, PARAMETERS, count, seed=SEED, file=file, executor=Inline())
    return report


# ---- mutations of the bytes ----


def flip_a_bit(rng, content):
    place = rng.randrange(len(content))
    flipped = content[place] ^ (1 << rng.randrange(8))
    return content[:place] + bytes([flipped]) + content[place + 1 :]


def change_bytes(rng, content):
    place, size = rng.randrange(len(content)), rng.choice([1, 2, 8, 300])
    return content[:place] + rng.randbytes(size) + content[place + size :]


def drop_bytes(rng, content):
    place, size = rng.randrange(len(content)), rng.choice([1, 2, 8, 300])
    return content[:place] + content[place + size :]


def write_zeros(rng, content):
    """As some file systems do when the power fails."""
    place, size = rng.randrange(len(content)), rng.choice([8, 300, len(content)])
    return content[:place] + bytes(len(content[place : place + size])) + content[place + size :]


def cut(rng, content):
    return content[: rng.randrange(len(content))]


def append(rng, content):
    return content + rng.choice([b"x", b"\n", b"{}\n", b"[]\n", b"null\n", bytes(100), b"\xff\n"])


def reencode(rng, content):
    text = content.decode()
    return rng.choice(
        [
            text.encode("utf-16"), text.encode("utf-32"), text.encode("utf-8-sig"),
            text.replace("\n", "\r\n").encode(), text.replace("\n", "\r").encode(),
            text.replace("noisy", "n\xf6isy").encode("latin-1"),
        ]
    )  # fmt: skip


# ---- mutations of the lines ----


def drop_a_line(rng, content):
    lines = content.splitlines(keepends=True)
    del lines[rng.randrange(len(lines))]
    return b"".join(lines)


def double_a_line(rng, content):
    lines = content.splitlines(keepends=True)
    lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines))
    return b"".join(lines)


def shuffle_lines(rng, content):
    lines = content.splitlines(keepends=True)
    first = rng.randrange(2)
    moved = lines[first:]
    rng.shuffle(moved)
    return b"".join(lines[:first] + moved)


def join_lines(rng, content):
    places = [match.start() for match in re.finditer(b"\n", content)]
    place = rng.choice(places)
    return content[:place] + content[place + 1 :]


# ---- mutations of what lines say ----


def change_a_value(rng, content):
    """Any value, at any depth, becomes another one, in the text alone."""
    lines = content.splitlines(keepends=True)
    number = rng.randrange(len(lines))
    line = lines[number].decode()
    values = list(re.finditer(r'(?<=: )("[^"]*"|\[[^]]*\]|[^\s,\[{}\]]+)|(?<=[\[ ])[-\d.e]+', line))
    found = rng.choice(values)
    line = line[: found.start()] + rng.choice(VALUES) + line[found.end() :]
    lines[number] = line.encode()
    return b"".join(lines)


def rename(rng, content):
    names = sorted(set(re.findall(rb'"(\w+)":', content)))
    old, new = rng.choice(names), rng.choice([*names, b"", b"other"])
    place = rng.choice([match.start() for match in re.finditer(b'"%s":' % old, content)])
    return content[:place] + b'"%s":' % new + content[place + len(old) + 3 :]


def forge(rng, content):
    """A line says something else, or has other fields, and its check sum is right."""
    lines = content.splitlines()
    number = rng.randrange(len(lines))
    said = json.loads(lines[number])
    del said["check"]
    key, fate = rng.choice(sorted(said)), rng.random()
    if fate < 0.1:
        said["other"] = said.pop(key)
    elif fate < 0.2:
        del said[key]
    else:
        inside = said
        while isinstance(inside[key], dict | list) and inside[key] and rng.random() < 0.7:
            inside = inside[key]
            names = sorted(inside) if isinstance(inside, dict) else range(len(inside))
            key = rng.choice(names)
        inside[key] = rng.choice(
            [None, True, False, 0, 1, -1, 3, 1.0, 0.5, 1e308, 10**30, "", "false", [], [1.0], {},
             float("nan"), float("inf"), {"a": 1.0}, {"a": {"b": []}}, "\ud800", 10**400]
        )  # fmt: skip
    text = json.dumps(said)
    lines[number] = f'{text[:-1]}, "check": "{crc32(text.encode()):08x}"}}'.encode()
    return b"\n".join(lines) + b"\n"


MUTATIONS = [
    flip_a_bit, change_bytes, drop_bytes, write_zeros, cut, append, reencode, drop_a_line,
    double_a_line, shuffle_lines, join_lines, change_a_value, rename, forge,
]  # fmt: skip


# ---- what must hold ----


def lines_of(report):
    return {record.run: record.line() for record in report._records}


def outcome(use, file, expected):
    """How a use of the file ended: what is wrong ends in an exclamation mark."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            report = use(file)
            report.summary()
            found = lines_of(report)
    except ValueError as error:
        said = str(error)
        named = str(file) in said and (
            re.search(r", line \d+ is not", said) or "is not a sweep file" in said
            or "belongs to another sweep" in said
        )  # fmt: skip
        inside = traceback.extract_tb(error.__traceback__)[-1].filename
        return "refused" if named and inside.endswith("store.py") else f"{said[:200]} !"
    except tc.robustness.SweepError as error:
        # A forged figure of the run that is done again.
        return "another case" if "of the file gave" in str(error) else f"{error} !"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:200]} !"
    same = all(expected[run] == line for run, line in found.items())
    return "same numbers" if same else "other numbers !"


def resumed(file):
    return tc.sweep(noisy, PARAMETERS, MORE, seed=SEED, file=file, executor=Inline())


def spoil(count, seed=0):
    """Spoil so many files; return how they ended, and what went wrong."""
    ends, wrong = Counter(), []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "runs.jsonl"
        whole = lines_of(swept(file))
        content = file.read_bytes()
        for number in range(count):
            rng = random.Random(f"{seed} {number}")
            spoilt = content
            chosen = [rng.choice(MUTATIONS)]
            if rng.random() < 0.2:  # the bytes too
                chosen.append(rng.choice(MUTATIONS[:6]))
            for mutation in chosen:
                spoilt = mutation(rng, spoilt or b"\n")
            names = " ".join(mutation.__name__ for mutation in chosen)
            for use in (tc.robustness.SweepReport.load, resumed):
                file.write_bytes(spoilt)
                end = outcome(use, file, whole)
                if end == "other numbers !" and "forge" in names:
                    end = "forged figures"  # the check sum is right: nothing is known of them
                ends[f"{use.__name__}: {end}" if not end.endswith("!") else "wrong"] += 1
                if end.endswith("!"):
                    wrong.append(f"{number} {names}, {use.__name__}: {end}")
                if use is resumed and end == "same numbers":
                    assert lines_of(tc.robustness.SweepReport.load(file)) == whole
    return ends, wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    ends, wrong = spoil(asked.count, asked.seed)
    print(*wrong, sep="\n")
    for end, count in sorted(ends.items()):
        print(f"{count:6d}  {end}")
    print(f"{asked.count} spoilt sweep files: {len(wrong)} neither the same numbers nor refused")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
