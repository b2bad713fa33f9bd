"""Calls that build with CasADi outside of the package's lock, in every thread."""

import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

import casadi as ca

from tenscontrol.dynamics.evaluator import BUILDING

EXPRESSIONS = (ca.SX, ca.MX)

# What reads or evaluates functions that are there. Anything else that is given one builds.
READING = tuple(
    f"Function.{name}"
    for name in (
        *("__call__", "call", "buffer", "stats", "n_", "size", "nnz", "numel", "sparsity_"),
        *("name", "index_", "is_a", "class_name", "default_in", "get_free", "has_", "find_", "sz_"),
    )
)


# What leaves the elements of an expression alone.
HARMLESS = ("__del__", "__hash__", "_drop", "numel", "size1", "size2", "shape")


def _has(value: object, kinds: tuple[type, ...]) -> bool:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        return any(_has(each, kinds) for each in value)
    return isinstance(value, kinds)


def _builds(frame: object) -> bool:
    code, given = frame.f_code, list(frame.f_locals.values())
    name = code.co_qualname
    if code.co_name in HARMLESS or name.startswith("_swig"):
        return False
    if name.startswith(("SX.", "MX.", "GenSX.", "GenMX.", "CodeGenerator.")):
        return code.co_name not in ("__init__",) or _has(given, EXPRESSIONS)
    if _has(given, EXPRESSIONS):
        return True
    return (
        name.startswith("Function.")
        and not name.startswith(READING)
        and (code.co_name != "__init__" or len(given) > 1)
    )


@contextmanager
def unlocked_calls() -> Iterator[set[str]]:
    """Yield a set that is filled with where CasADi builds without the lock."""
    found: set[str] = set()

    def look(frame, event, _):
        if event != "call" or not frame.f_code.co_filename.endswith("casadi/casadi.py"):
            return
        if BUILDING._is_owned() or not _builds(frame):
            return
        lines = traceback.extract_stack(frame.f_back, limit=12)
        own = [line for line in lines if "/tenscontrol/" in line.filename]
        if own:
            name = own[-1].filename.split("/tenscontrol/")[-1]
            found.add(f"{name}:{own[-1].lineno} {own[-1].name}: {frame.f_code.co_qualname}")

    threading.setprofile(look)
    sys.setprofile(look)
    try:
        yield found
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
