"""What users reach by name, for the tests that walk it: what the pages of docs/api document."""

import ast
import importlib
import inspect
import re
import runpy
from functools import cache, cached_property
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"
PAGES = sorted((DOCS / "api").glob("*.rst"))


#: The directive that documents what a folder exports.
FOLDER = r"^\.\. folder:: +(\S+)(?:\n +:without: (.*))?"


@cache
def tree(path):
    """The syntax tree of a file, not to be changed."""
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@cache
def syntax(path):
    """All nodes of the syntax tree of a file, which are walked by several tests."""
    return tuple(ast.walk(tree(path)))


def exported(page, folder, without):
    """As the directive of the pages finds the names that a folder exports."""
    return runpy.run_path(str(DOCS / "_ext" / "folder.py"))["exported"](page, folder, without)


@cache
def interface():
    """Full names that docs/api documents."""
    named = set()
    for page in PAGES:
        text, module = page.read_text(encoding="utf-8"), "tenscontrol"
        for kind, name in re.findall(r"^\.\. (currentmodule|auto\w+):: +([\w.]+)", text, re.M):
            if kind == "currentmodule":
                module = name
            else:
                named.add(name if name.startswith("tenscontrol.") else f"{module}.{name}")
        for folder, without in re.findall(FOLDER, text, re.M):
            named |= set(exported(text, folder, without))
    return named


def named(full_name):
    """The object of a full name. A function may have the name of the file that it is in."""
    module, _, name = full_name.rpartition(".")
    return getattr(importlib.import_module(module), name)


@cache
def public():
    """Every public function and class by its name without ``tenscontrol.``, of two the first."""
    names = {id(named(name)): name for name in sorted(interface(), reverse=True)}
    return {
        name.removeprefix("tenscontrol."): named(name)
        for name in sorted(names.values())
        if callable(named(name))
    }


@cache
def public_functions():
    return {name: value for name, value in public().items() if not inspect.isclass(value)}


@cache
def public_classes():
    return {name: value for name, value in public().items() if inspect.isclass(value)}


@cache
def members():
    """Public methods and properties of public classes, as ``Class.name: (class, member)``.

    What a class inherits from another public class is listed there only.
    """
    classes, found = public_classes(), {}
    for class_name, cls in classes.items():
        for base in cls.__mro__:
            inherits = base is not cls and base in classes.values()
            if inherits or not base.__module__.startswith("tenscontrol"):
                continue
            for name, member in vars(base).items():
                is_member = inspect.isfunction(member) or isinstance(
                    member, property | cached_property | classmethod | staticmethod
                )
                if is_member and not name.startswith("_"):
                    found.setdefault(f"{class_name}.{name}", (cls, member))
    return found
