"""The rules of the house: who imports whom, what its files and names are called.

Layers, circles and the places of libraries are import-linter's (``[tool.importlinter]`` of
pyproject.toml), and how code is written is ruff's; here is what no tool checks.
"""

import ast
import builtins
import importlib
import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
import types
from collections import Counter
from functools import cache
from operator import attrgetter
from pathlib import Path

import pytest

import tenscontrol as tc
from tests.public import interface, named, syntax, tree

PACKAGE = Path(tc.__file__).parent
PROJECT = Path(__file__).parent.parent
SOURCES = sorted(PACKAGE.rglob("*.py"))
FOLDERS = sorted(
    ".".join(path.parent.relative_to(PACKAGE).parts) for path in PACKAGE.rglob("*/__init__.py")
)


def place(path):
    """A file as it is called within the package, for messages."""
    return path.relative_to(PACKAGE).as_posix()


# ---- who imports whom ----


def test_the_contracts_of_imports_hold():
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys, importlinter.cli as cli; sys.exit(cli.lint_imports(no_cache=True))",
        ],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_campaigns_import_what_there_is():
    """Some run by their command alone."""
    for path in PROJECT.glob("tests/fuzz/[!_]*.py"):
        importlib.import_module(f"tests.fuzz.{path.stem}")


def imported(path):
    """Line and full name of each module that a file imports names of this package from."""
    for node in syntax(path):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{place(path)}:{node.lineno} imports by dots"
            yield node.lineno, node.module


def test_names_are_imported_from_the_files_where_they_live():
    """What a folder's ``__init__`` exports is for users."""
    wrong, seen = [], 0
    for path in SOURCES:
        if path.name == "__init__.py":
            continue
        for node in syntax(path):
            if not isinstance(node, ast.ImportFrom) or not node.module.startswith("tenscontrol."):
                continue
            seen += 1
            folder = node.module.removeprefix("tenscontrol.")
            names = [] if folder not in FOLDERS else [alias.name for alias in node.names]
            wrong += [
                f"{place(path)}:{node.lineno} imports {name} from {folder}"
                for name in names
                if not lives_in(PACKAGE.joinpath(*folder.split(".")), name)
            ]
    assert seen > 100
    assert wrong == []


@cache
def lives_in(folder, name):
    """Whether a name is a module of a folder, or its ``__init__`` defines it."""
    if folder.joinpath(name).with_suffix(".py").exists() or folder.joinpath(name).is_dir():
        return True
    nodes = tree(folder / "__init__.py").body
    return name == "__all__" or any(getattr(node, "name", "") == name for node in nodes)


# ---- what modules hold ----

_MUTABLE = (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp)
_MUTABLE_CALLS = {"list", "dict", "set", "bytearray", "defaultdict", "deque", "Counter"}
_MUTABLE_CALLS |= {"array", "zeros", "ones", "empty", "full", "eye", "arange", "linspace"}
_MUTATING = {"append", "extend", "insert", "add", "update", "setdefault", "pop", "popitem"}
_MUTATING |= {"remove", "discard", "clear", "sort", "reverse", "setflags"}
_GLOBAL_SETTINGS = re.compile(
    r"\b(seterr|set_printoptions|simplefilter|filterwarnings|basicConfig|use|switch_backend"
    r"|setrecursionlimit|set_defaults)$|\brcParams(\.\w+|Default)?$|\benviron\b"
)


def _is_mutable(value):
    if isinstance(value, _MUTABLE):
        return True
    if isinstance(value, ast.Call):
        return ast.unparse(value.func).split(".")[-1] in _MUTABLE_CALLS
    return False


def _module_containers(module):
    """Names bound at module level to something that can change, with their lines."""
    names = {}
    for node in module.body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        if isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        for target in targets:
            if isinstance(target, ast.Name) and _is_mutable(node.value):
                names[target.id] = node.lineno
    return names


def _root(node):
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


def _dotted(node):
    """The text of an expression, of ``module.name`` without unparsing."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name | ast.Attribute):
        return f"{_dotted(node.value)}.{node.attr}"
    return ast.unparse(node)


def test_modules_hold_no_settings_that_change():
    faults = []
    for path in SOURCES:
        module, file = tree(path), str(path.relative_to(PACKAGE))
        containers = _module_containers(module)
        faults += [
            f"{file}:{line} {name} is public and mutable"
            for name, line in containers.items()
            if not name.startswith("_")
        ]
        for node in syntax(path):
            where = f"{file}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Global):
                faults.append(f"{where} global {', '.join(node.names)}")
            changed = []
            if isinstance(node, ast.Assign | ast.Delete):
                changed = [target for target in node.targets if not isinstance(target, ast.Name)]
            elif isinstance(node, ast.AugAssign):
                changed = [node.target]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                if node.func.attr in _MUTATING:
                    changed = [node.func.value]
                called = _dotted(node.func)
                if _GLOBAL_SETTINGS.search(called):
                    faults.append(f"{where} {called} changes settings of others")
            for target in changed:
                place = target.value if isinstance(target, ast.Subscript) else target
                if _root(target) in containers or _GLOBAL_SETTINGS.search(_dotted(place)):
                    faults.append(f"{where} changes {ast.unparse(target)}")
    assert faults == []


# ---- what it prints ----


def test_texts_to_print_are_in_ascii():
    """Some terminals and pipes can print nothing else."""
    printed = ("summary", "table", "__str__", "__repr__")
    found = [
        f"{place(path)}:{text.lineno}: {text.value!r}"
        for path in SOURCES
        for node in syntax(path)
        if isinstance(node, ast.FunctionDef)
        and (node.name in printed or place(path) in ("tables.py", "demo/tour.py"))
        for text in ast.walk(ast.Module(node.body[1:], []))  # without the docstring
        if isinstance(text, ast.Constant) and isinstance(text.value, str)
        if not text.value.isascii()
    ]
    assert found == []


# ---- its files ----


def test_no_two_files_have_one_name():
    names = Counter(path.name for path in SOURCES if path.name != "__init__.py")
    assert [name for name, count in names.items() if count > 1] == []


# ---- what the page for developers says ----


def test_the_walks_name_what_there_is():
    text = (PROJECT / "docs" / "developing.rst").read_text("utf-8")
    walks = text.partition("Two walks through the code")[2].partition("Where to put what is new")[0]
    for walk in walks.split("**From a scene file"):
        files = re.findall(r"``([\w/]+\.py)``", walk)
        assert 5 < len(set(files)) <= 12
        code = "\n".join((PACKAGE / file).read_text("utf-8") for file in files)
        named = [name for name in re.findall(r"``([\w.]+)``", walk) if not name.endswith(".py")]
        for name in named:
            assert re.search(rf"(def|class) {name.split('.')[-1]}\b", code), name


# ---- what its names are ----


def top_level():
    """What the top level holds by name: folders left out."""
    names = [name for name in tc.__all__ if name != "__version__"]
    return [name for name in names if not isinstance(getattr(tc, name), types.ModuleType)]


def test_few_names_are_at_the_top_level():
    assert 30 < len(top_level()) <= 80


def stub():
    """The stub that the lazy names come from, as it is read by a type checker."""
    nodes = ast.parse((PACKAGE / "__init__.pyi").read_text("utf-8")).body
    names = [
        alias.asname or alias.name
        for node in nodes
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    (listed,) = (ast.literal_eval(node.value) for node in nodes if isinstance(node, ast.Assign))
    return names, listed


def test_the_stub_lists_what_there_is():
    names, listed = stub()
    assert len(set(names)) == len(names)
    assert sorted(listed) == sorted(tc.__all__)
    folders = {name for name in names if isinstance(getattr(tc, name), types.ModuleType)}
    assert sorted(listed) == sorted(set(names) - folders)
    assert folders == {name for name in FOLDERS if "." not in name} - {"core", "demo"}
    assert set(names) <= set(dir(tc))
    assert not set(names) & set(dir(builtins))
    with pytest.raises(AttributeError, match="nothing"):
        _ = tc.nothing


def test_every_name_of_the_stub_imports():
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "import tenscontrol"],
        env=os.environ | {"EAGER_IMPORT": "1", "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr


@cache
def objects_on_the_page():
    """What the page names, by identity: a folder may hand on the names of a folder within."""
    return {id(named(name)): name for name in interface()}


def test_every_name_of_the_top_level_is_documented():
    assert [name for name in top_level() if f"tenscontrol.{name}" not in interface()] == []


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_name_of_a_folder_is_documented(folder):
    module = importlib.import_module(f"tenscontrol.{folder}")
    names = getattr(module, "__all__", [])
    assert len(set(names)) == len(names)
    missing = [name for name in names if id(getattr(module, name)) not in objects_on_the_page()]
    assert missing == []


# ---- how it is written ----


# Names that fit any local variable, and so tell nothing of what it holds.
VAGUE = {"found", "each", "part", "said", "told", "made", "there", "what"}


def test_locals_say_what_they_hold():
    vague = {
        f"{place(path)}:{node.lineno}: {node.id}"
        for path in SOURCES
        for function in syntax(path)
        if isinstance(function, ast.FunctionDef | ast.Lambda)
        for node in ast.walk(function)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in VAGUE
    }
    assert sorted(vague) == []


def test_assertions_say_why_they_hold():
    # A user's input is never checked by assert; what is left states what was checked elsewhere.
    bare = []
    for path in SOURCES:
        lines = path.read_text("utf-8").splitlines()
        for node in syntax(path):
            if isinstance(node, ast.Assert):
                last = lines[node.end_lineno - 1]
                if not re.search(r"\S\s+#\s*\S", last[node.end_col_offset - 1 :]):
                    bare.append(f"{place(path)}:{node.lineno}")
    assert bare == []


def test_no_text_speaks_of_the_place_it_was_written_in():
    # Put together here, so that this file does not speak of it either.
    words = [r"(?<!\w)/" + r"work\b(?!-)", r"\.\./" + "shared", "shared" + "/d"]
    private, seen, mentions = re.compile("|".join(words)), 0, []
    made = {
        "__pycache__",
        "_build",
        "auto_examples",
        "gallery",
        "generated",
        "gen_modules",
        "build",
        "dist",
    }
    paths = [path for pattern in ("*.md", "*.toml", "*.cff") for path in PROJECT.glob(pattern)]
    for folder in ("tenscontrol", "tests", "docs", "examples", ".ci", ".github"):
        paths += [path for path in (PROJECT / folder).rglob("*") if path.is_file()]
    for path in paths:
        if made & set(path.relative_to(PROJECT).parts) or path.suffix in {
            ".png",
            ".npz",
            ".gif",
            ".so",
            ".dll",
        }:
            continue
        seen += 1
        found = private.finditer(path.read_text(encoding="utf-8"))
        mentions += [f"{path.relative_to(PROJECT)}: {match.group()}" for match in found]
    assert seen > 30
    assert mentions == []


def test_the_version_is_one():
    version = re.escape(tc.__version__)
    changes, citation = ((PROJECT / f).read_text("utf-8") for f in ("CHANGELOG.md", "CITATION.cff"))
    newest = re.search(r"^## (.*)", changes, re.MULTILINE)
    released = re.search(r"^date-released: (\S+)$", citation, re.MULTILINE)
    assert newest[1] == f"{tc.__version__} ({released[1]})"
    assert re.search(rf"^version: [\"']?{version}[\"']?$", citation, re.MULTILINE)


def test_the_newest_changes_name_what_there_is():
    """Names of the package in its changes, and of the table of what has moved."""
    section = (PROJECT / "CHANGELOG.md").read_text("utf-8").split("\n## ")[1]
    names = set(re.findall(r"`tc\.([\w.]+)", section))
    places = re.findall(r"^\| `tc\.(\w+)` \| (.*) \|$", section, re.MULTILINE)
    for folder, moved in places:
        names |= {f"{folder}.{name}" for name in re.findall(r"`(\w+)`", moved)}
    assert len(names) > 90

    def is_there(name):
        try:
            attrgetter(name)(tc)
        except AttributeError:
            return False
        return True

    assert {name for name in names if not is_there(name)} == set()


def test_wheels_are_built_for_three_systems():
    workflow = (PROJECT / ".github/workflows/wheels.yml").read_text("utf-8")
    systems = re.search(r"os: \[(.*)\]", workflow)[1]
    assert all(name in systems for name in ("ubuntu", "macos", "windows"))
    built = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["tool"]["cibuildwheel"]
    assert any("absence" in command for command in built["test-command"])


def test_the_version_is_that_of_the_installation():
    assert importlib.metadata.version("tenscontrol") == tc.__version__
