"""Docstrings of public names are complete, as numpydoc validates them."""

import ast
import dataclasses
import inspect
import re
from functools import cache

from numpydoc.docscrape import get_doc_object
from numpydoc.validate import validate

from tests.public import members, public, public_classes, public_functions

# What is wrong anywhere: an unknown section or their order, no docstring, no summary, a parameter
# not documented, unknown, without type or with a faulty one.
FAULTS = {"GL06", "GL07", "GL08", "SS01", "PR01", "PR02", "PR04", "PR05", "PR10"}


def faults(value, text=None, codes=FAULTS):
    """Messages of numpydoc on a docstring: that of the object if no other is given."""
    document = get_doc_object(value, doc=text) if text else get_doc_object(value)
    errors = validate(document)["errors"]
    return [f"{code} {message}" for code, message in errors if code in codes]


def sections(value):
    return {name for name, content in get_doc_object(value).items() if content}


def test_there_is_something_to_walk():
    assert len(public_functions()) > 40
    assert len(public_classes()) > 80
    assert "Structure.bar_length" in members()
    assert "dynamics.Coordinates.measure" in members()


def test_faults_are_seen():
    def measure(nodes, velocities):
        """Return x.

        Parameters
        ----------
        nodes : ndarray
            N.
        speed : ndarray
            M.
        """

    found = faults(measure, codes=FAULTS | {"EX01"})
    assert [message.split()[0] for message in found] == ["PR01", "PR02", "EX01"]
    assert "velocities" in found[0]
    assert "speed" in found[1]


def test_every_public_name_has_a_docstring():
    # A dataclass without a docstring gets its signature for one.
    silent = [
        name
        for name, value in public().items()
        if not inspect.getdoc(value)
        or (inspect.getdoc(value) or "").startswith(name.rpartition(".")[2] + "(")
    ]
    silent += [name for name, (_, member) in members().items() if not inspect.getdoc(member)]
    assert silent == []


def wrong(faults_of):
    """Of faults by name those that are some."""
    return {name: found for name, found in faults_of.items() if found}


def without_example(names):
    return [name for name in names if ">>> " not in public()[name].__doc__]


def test_functions_document_every_parameter_and_have_an_example():
    codes = FAULTS | {"EX01"}
    assert wrong({name: faults(public()[name], codes=codes) for name in public_functions()}) == {}
    assert without_example(public_functions()) == []


def _docstrings_that_hold(cls, member):
    """The docstring of a method, those of the methods it overrides, and the one it refers to."""
    own = inspect.getdoc(member) or ""
    yield own
    for base in cls.__mro__:
        other = vars(base).get(member.__name__)
        if other is not None and other is not member:
            yield inspect.getdoc(other) or ""
    for path in re.findall(r"(?:[Ss]ee|[Aa]s) :meth:`~?\.?([\w.]+)`", own):
        *owner, method = path.removeprefix("tenscontrol.").split(".")
        classes = {other.__name__: other for other in (*public_classes().values(), *cls.__mro__)}
        yield inspect.getdoc(getattr(classes[owner[-1]] if owner else cls, method)) or ""


def test_methods_document_every_parameter():
    least = {
        name: min((faults(member, text) for text in _docstrings_that_hold(cls, member)), key=len)
        for name, (cls, member) in members().items()
        if inspect.isfunction(member)
    }
    assert len(least) > 200
    assert wrong(least) == {}


TAKES_PARAMETERS = [name for name, cls in public_classes().items() if "Parameters" in sections(cls)]


def test_classes_that_users_construct_say_how():
    # What stands at the top level is constructed; other classes are made by functions.
    constructed = {name for name in public_classes() if "." not in name}
    assert constructed <= set(TAKES_PARAMETERS)


def test_constructors_document_every_parameter():
    assert wrong({name: faults(public()[name]) for name in TAKES_PARAMETERS}) == {}


def test_classes_that_users_construct_have_an_example():
    constructed = [name for name in public_classes() if "." not in name]
    assert wrong({name: faults(public()[name], codes={"EX01"}) for name in constructed}) == {}
    assert without_example(constructed) == []


def _attributes(cls):
    """Names of the public attributes of a class: fields, properties, and what __init__ sets."""
    is_data = dataclasses.is_dataclass(cls)
    names = {field.name for field in dataclasses.fields(cls)} if is_data else set()
    for base in cls.__mro__:
        names |= set(vars(base)) | set(vars(base).get("__annotations__", {}))
        if base.__module__.startswith("tenscontrol"):
            names |= _set_on_self(base)
    return names


@cache
def _set_on_self(cls):
    source = inspect.cleandoc("\n" + inspect.getsource(cls))
    return {
        node.attr
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and ast.unparse(node.value) == "self"
    }


def test_classes_document_what_they_hold():
    unknown, untold = {}, {}
    for name, cls in public_classes().items():
        listed = _listed(cls)
        unknown[name] = sorted(set(listed) - _attributes(cls))
        if dataclasses.is_dataclass(cls) and "Parameters" not in sections(cls):
            fields = {field.name for field in dataclasses.fields(cls)}
            untold[name] = {each for each in fields if not each.startswith("_")} - set(listed)
    assert wrong(unknown) == {}
    assert wrong(untold) == {}


def _listed(cls):
    """Attributes that the docstring of a class lists itself; numpydoc adds properties."""
    listed = [
        each.strip()
        for entry in get_doc_object(cls)["Attributes"]
        for each in entry.name.split(",")
    ]
    own = inspect.cleandoc(cls.__doc__)
    return [entry for entry in listed if re.search(rf"^[\w, ]*\b{entry}\b[\w, ]* :", own, re.M)]
