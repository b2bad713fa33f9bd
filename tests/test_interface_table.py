"""One word for one thing: the public names, their arguments and units, by the table of the docs."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import tenscontrol as tc
from tests.public import DOCS, members, public, public_classes, public_functions, tree

# What another word or another unit is for.
EXCEPTIONS = {
    "dynamics.SymbolicModel": {"N", "Nd", "W", "gamma"},  # the names of the paper
    "plant.SparsePlant": {"stiffness"},  # by mass
    "dynamics.ContactLaw": {"stiffness"},  # its unit is the law's
    "control.HeldLoop": {"radius"},  # a spectral one
    "shape.tipping_path": {"step"},  # of rest lengths
    "plot.Drawing": {"nodes"},  # what is drawn of them
    "exchange.from_csv": {"nodes"},  # their file
}
# Methods without an argument that neither act nor return another form of what they belong to.
METHODS = {
    "Model.mass_matrix", "Reference.reversed", "RotationalSymmetry.rotation", "Scene.open_loop",
    "control.Controller.twin", "deploy.CompiledController.twin",
    "deploy.CompiledController.another", "dynamics.Contacts.gap_passes", "plot.View.html",
    "plot.View.figure", "robustness.Distribution.settings",
}  # fmt: skip
# Numbers of which the docstring has no unit: vectors and matrices of a problem that has none.
UNITLESS = {
    "control.QPSolution", "control.QPSolver.solve", "control.QuadraticProgram",
    "control.QuadraticProgram.inputs", "energy_weights",
}  # fmt: skip
UNIT = r"(?<![\w/])(N|m|s|kg|rad|Hz|J|W|Pa|K|V|A|1/s|%|MB)(?![\w])|√|m[²³⁴]|s²"
# What has none says what it is.
PURE = (
    r"ratio|factors?|coefficient|parts?|share|relative|without unit|no unit|units?|fraction|"
    r"probability|weights?|costs?|direction|vectors|normal|norm|largest is 1|displacement 1|"
    r"Spectral|matri(x|ces)|order|Slope|standard error|times|turns|Frames|Counts|over|"
    r"above 1|1 where|at most 1|degrees of freedom|coordinates?|eigenvalues?|z|"
    r"states?|by theory|standard deviations?|digits|number|choose"
)
# Analyses, by what they return beside a record of their own.
RETURNS = {
    "FloatArray", "IntArray", "float", "str", "Structure", "Path", "ca.Function", "csr_array",
    "tuple", "dict", "list", "Groups", "VectorEnv",
}  # fmt: skip
SHOWS = {"show_config"}  # prints
ACTIONS = r"(reset|prepare|open|shorten|\w*table|summary|to_\w+|as_\w+)$"


def rows():
    """Names, unit and words that are never used, by row of the table."""
    text = (DOCS / "developing.rst").read_text(encoding="utf-8")
    table = text.split("One word for one thing\n")[1].split("\n\nWhat a record holds")[0]
    for row in table.split("   * - ")[2:]:
        names, unit, never = (cell.strip() for cell in re.split(r"\n     -", row, maxsplit=2))
        yield re.findall(r"``(\w+)``", names), unit, re.findall(r"\w+", never)


def calls():
    """Every public function, class and method by its name."""
    found = dict(public())
    for name, (_, member) in members().items():
        function = getattr(member, "__func__", member)
        if callable(function):
            found[name] = function
    return found


def signatures():
    """The parameters of every public function and class that is no exception."""
    return {
        name: inspect.signature(thing).parameters
        for name, thing in public().items()
        if not (inspect.isclass(thing) and issubclass(thing, BaseException))
    }


def signed(function):
    """What a function says that it returns."""
    return inspect.signature(function).return_annotation


def entries(thing):
    """What the docstring of a function or class says of each parameter and attribute."""
    doc = thing.__doc__ if inspect.isclass(thing) else inspect.getdoc(thing)
    found, names = {}, []
    for line in inspect.cleandoc(doc or "").splitlines():
        entry = re.match(r"(\w[\w, ]*) : (.*)", line)
        if entry:
            names = entry[1].split(", ")
            found |= dict.fromkeys(names, entry[2])
        elif line.startswith("    "):
            found |= {name: f"{found[name]} {line.strip()}" for name in names}
        elif line:
            names = []
    return found


def test_the_table_is_read():
    found = list(rows())
    assert (["nodes"], "m", ["N", "positions_of_nodes", "coordinates_of_nodes"]) in found
    assert len(found) > 15
    assert len(EXCEPTIONS) <= 10
    assert len({name.rpartition(".")[2] for name in METHODS}) <= 10


def test_no_argument_has_another_word():
    never = {word for *_, words in rows() for word in words}
    wrong = set()
    for name, parameters in signatures().items():
        allowed = EXCEPTIONS.get(name, set()) | ({"N"} if "Q" in parameters else set())  # weights
        wrong |= {(name, each) for each in never & set(parameters) - allowed}
    assert wrong == set()


@pytest.mark.parametrize(("names", "unit"), [row[:2] for row in rows() if row[1]])
def test_docstrings_have_the_unit(names, unit):
    has_unit = re.compile(rf"(?<![\w/]){re.escape(unit)}(?![\w/²])")
    elsewhere = re.compile(r"\b(as|see)\b|:class:", re.IGNORECASE)
    missing = []
    for name, thing in calls().items():
        for argument, text in entries(thing).items():
            if argument in names and argument not in EXCEPTIONS.get(name, set()):
                counted = argument == "nodes" and re.search(r"\bint\b|drawn|The nodes", text)
                if not (has_unit.search(text) or elsewhere.search(text) or counted):
                    missing.append((name, argument, text))
    assert missing == []


def test_docstrings_of_numbers_have_a_unit_or_say_what_they_are():
    named = re.compile(rf"{UNIT}|\b(?i:{PURE})\b|:\w+:`")
    missing = []
    for name, thing in calls().items():
        for argument, text in entries(thing).items():
            numeric = re.match(r"(float|\(float|array_like(?! of)|ndarray(?! of))", text)
            if numeric and name not in UNITLESS and not named.search(f"{argument}: {text}"):
                missing.append((name, argument, text))
    assert missing == []


def test_functions_return_a_record_an_array_or_what_was_drawn_or_written():
    records = {name.rpartition(".")[2] for name in public_classes()}
    wrong = []
    for name, function in public_functions().items():
        kinds = set(re.findall(r"^[\w.]+|(?<=\| )[\w.]+", str(signed(function)))) - {"None"}
        if name.startswith("plot.") and not (
            kinds and kinds <= records | {"dict", "tuple", "Path"}
        ):
            wrong.append((name, kinds))
        if not kinds <= records | RETURNS or (not kinds and name not in SHOWS):
            wrong.append((name, kinds))
    assert wrong == []


def test_what_saves_returns_the_path():
    savers = {
        name: member
        for name, (_, member) in members().items()
        if re.search(r"\.(save|to_netcdf)$", name)
    } | {name: f for name, f in public_functions().items() if re.search(r"save_|to_vtk$", name)}
    assert len(savers) > 5
    assert {name for name, f in savers.items() if "Path" not in str(signed(f))} == set()


def test_methods_without_an_argument_act_or_convert():
    found = set()
    for name, (_, member) in members().items():
        if isinstance(member, property) or not callable(member):
            continue
        parameters = [each for each in inspect.signature(member).parameters if each != "self"]
        if not parameters and not isinstance(member, classmethod):
            found.add(name)
    others = {name for name in found if not re.match(ACTIONS, name.rpartition(".")[2])}
    assert others == METHODS


def test_no_signature_hides_its_settings():
    hidden = [
        name
        for name, parameters in signatures().items()
        if any(each.kind is inspect.Parameter.VAR_KEYWORD for each in parameters.values())
    ]
    assert hidden == []


def test_messages_name_functions_where_they_are_found():
    """What is not at the top level has its folder before it."""
    inside = {name.rpartition(".")[2]: name for name in public_functions() if "." in name}
    wrong = []
    for path in Path(tc.__file__).parent.rglob("*.py"):
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                if not re.search("Error$|^warn$", node.func.id):
                    continue
                texts = [each for each in ast.walk(node) if isinstance(each, ast.Constant)]
                for text in (str(each.value) for each in texts):
                    found = re.findall(r"(?<![\w.`])(\w+)\(", text)
                    wrong += [(path.name, name) for name in found if name in inside]
    assert [each for each in wrong if not hasattr(tc, each[1])] == []
