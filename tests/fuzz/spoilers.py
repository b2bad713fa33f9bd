"""What one argument of a valid call is replaced by, whole or in one entry."""

import decimal
import fractions
import random
from pathlib import Path
from types import MappingProxyType

import casadi as ca
import numpy as np
import scipy.sparse

import tenscontrol as tc
from tests.refused import elastic, held_plant, prism, regulator, rest

NAN, INF = float("nan"), float("inf")

# ---- what takes the place of the whole, or of an entry ----

NUMBERS = {
    "nan": NAN, "inf": INF, "-inf": -INF, "0": 0, "-0.0": -0.0, "1": 1, "-1": -1, "-0.5": -0.5,
    "0.5": 0.5, "2": 2, "7": 7, "100": 100, "1e6": 1e6, "1e15": 1e15, "1e100": 1e100,
    "-1e100": -1e100, "1e155": 1e155, "1e308": 1e308, "-1e308": -1e308, "1e-6": 1e-6,
    "1e-15": 1e-15, "1e-100": 1e-100, "1e-170": 1e-170, "1e-300": 1e-300, "1e-320": 1e-320,
    "2**31": 2**31, "2**63": 2**63, "-2**63": -(2**63), "10**400": 10**400, "-10**400": -(10**400),
    "float32 max": np.float32(3.4e38), "int8": np.int8(3), "uint64": np.uint64(2**64 - 1),
    "longdouble": np.longdouble("1e4000"),
}  # fmt: skip

OTHERS = {
    "None": None, "True": True, "False": False, "numpy True": np.True_, "empty text": "",
    "text": "x", "number as text": "1", "nan as text": "nan", "NUL": "a\0b", "surrogate": "\ud800",
    "long text": "x" * 5000, "empty bytes": b"", "bytes": b"x", "bytearray": bytearray(b"x"),
    "1j": 1j, "complex without": 1 + 0j, "Fraction": fractions.Fraction(1, 2),
    "Decimal": decimal.Decimal("0.5"), "datetime": np.datetime64("2020-01-01"),
    "NaT": np.timedelta64("NaT", "s"), "path": Path("nowhere") / "x", "ellipsis": ...,
    "NotImplemented": NotImplemented, "object": object(), "lambda": lambda *_, **__: None,
    "class": int, "our class": tc.Structure, "module": np, "error": ValueError("x"),
    "method": "x".join, "slice": slice(3), "property": property(),
    "SX": ca.SX.sym("x"), "MX": ca.MX.sym("x", 3), "DM": ca.DM(2, 2), "DM nan": ca.DM(NAN),
    "random generator": np.random.default_rng(0), "proxy": MappingProxyType({"x": 1}),
}  # fmt: skip


def _endless():
    held = []
    held.append(held)
    return held


# Made anew for each call: some are used up, some could be changed.
MADE = {
    "empty list": list, "nested empty": lambda: [[]], "empty tuple": tuple, "empty dict": dict,
    "dict": lambda: {"x": 1}, "numbered dict": lambda: {0: 0.5}, "empty set": set,
    "set": lambda: {1, 2}, "frozenset": lambda: frozenset("ab"),
    "generator": lambda: (each for each in (1.0, 2.0)), "range": lambda: range(3),
    "zip": lambda: zip([1], [2], strict=True), "text list": lambda: ["a", "b"],
    "text of names": lambda: ["top", "top"], "None list": lambda: [None, None],
    "ragged": lambda: [[1.0], [1.0, 2.0]], "list in itself": _endless,
    "list of lists": lambda: [[1, 2], [3, 4]], "list of objects": lambda: [object()],
    "list of dicts": lambda: [{}, {}], "huge list": lambda: [0.5] * 200_000,
    "deep list": lambda: _nested(80), "array of nothing": lambda: np.zeros(0),
    "array (0, 3)": lambda: np.zeros((0, 3)), "array (3, 0)": lambda: np.zeros((3, 0)),
    "array ()": lambda: np.array(0.5), "array () nan": lambda: np.array(NAN),
    "array (1,)": lambda: np.ones(1), "array (1, 1, 1)": lambda: np.ones((1, 1, 1)),
    "array 3-D": lambda: np.ones((2, 3, 4)), "array (3, 6) zeros": lambda: np.zeros((3, 6)),
    "array (9,) zeros": lambda: np.zeros(9), "array (9,) nan": lambda: np.full(9, NAN),
    "array (9,) huge": lambda: np.full(9, 1e308), "array (9,) tiny": lambda: np.full(9, 1e-320),
    "array (9,) negative": lambda: np.full(9, -1.0), "array of a million": lambda: np.ones(10**6),
    "array of objects": lambda: np.array([object(), None]),
    "array of text": lambda: np.array(["a"]),
    "array of bytes": lambda: np.array([b"a"]), "array of bool": lambda: np.array([True, False]),
    "array complex": lambda: np.ones(9, dtype=complex),
    "array of dates": lambda: np.array(["2020"], "M8"),
    "array of records": lambda: np.zeros(2, dtype=[("a", float)]),
    "array masked": lambda: np.ma.masked_array(np.ones(9), mask=[True] + [False] * 8),
    "masked": lambda: np.ma.masked, "matrix": lambda: scipy.sparse.eye_array(9).todense(),
    "sparse": lambda: scipy.sparse.eye_array(9).tocsr(), "memoryview": lambda: memoryview(b"abc"),
    "a structure": prism, "a model": elastic, "a plant": held_plant, "a prestress": rest,
    "a controller": regulator, "a law": lambda: tc.LinearStrings(100.0),
    "winches": tc.Winches, "a case, another": lambda: tc.HealthLimits(),
    "its mistake": lambda: tc.integrate.Work(), "list of structures": lambda: [prism()],
}  # fmt: skip


def _nested(depth):
    value = 1.0
    for _ in range(depth):
        value = [value]
    return value


# ---- what is made of the value ----

NOTHING = object()


def _array(value):
    """The value as an array of numbers, or None."""
    if isinstance(value, np.ndarray | list | tuple) and len(
        np.shape(value) if _even(value) else ()
    ):
        array = np.asarray(value)
        if array.dtype.kind in "iuf" and array.size:
            return array
    return None


def _even(value):
    try:
        np.shape(value)
    except ValueError:
        return False
    return True


def _of_array(change):
    def spoil(value):
        array = _array(value)
        return NOTHING if array is None else change(array)

    return spoil


def _of(kinds, change):
    return lambda value: change(value) if type(value) in kinds else NOTHING


CHANGES = {
    "transposed": _of_array(lambda a: a.T if a.ndim > 1 else a[None]),
    "without the last": _of_array(lambda a: a[..., :-1]),
    "without the first row": _of_array(lambda a: a[1:]),
    "twice": _of_array(lambda a: np.concatenate([a, a], axis=-1)),
    "with an axis": _of_array(lambda a: a[..., None]),
    "with an axis before": _of_array(lambda a: a[None]),
    "first alone": _of_array(lambda a: a.flat[0]),
    "as complex": _of_array(lambda a: a + 0j),
    "as text array": _of_array(lambda a: a.astype(str)),
    "as objects": _of_array(lambda a: a.astype(object)),
    "as bools": _of_array(lambda a: a.astype(bool)),
    "as float": _of_array(lambda a: a.astype(float)),
    "as float16": _of_array(lambda a: a.astype(np.float16)),
    "masked whole": _of_array(lambda a: np.ma.masked_array(a, mask=np.ones(a.shape))),
    "strided": _of_array(lambda a: np.repeat(a, 2, axis=0)[::2]),
    "big endian": _of_array(lambda a: a.astype(a.dtype.newbyteorder(">"))),
    "all nan": _of_array(lambda a: np.full(a.shape, NAN)),
    "all zero": _of_array(lambda a: np.zeros(a.shape)),
    "all one": _of_array(lambda a: np.ones(a.shape)),
    "all huge": _of_array(lambda a: np.full(a.shape, 1e308)),
    "times -1": _of_array(lambda a: -a),
    "times 1e150": _of_array(lambda a: a * 1e150),
    "times 1e300": _of_array(lambda a: a * 1e300),
    "times 1e-150": _of_array(lambda a: a * 1e-150),
    "times 1e-310": _of_array(lambda a: a * 1e-310),
    "plus 1e-3": _of_array(lambda a: a + 1e-3),
    "plus 1e9": _of_array(lambda a: a + 1e9),
    "reversed": _of_array(lambda a: a[..., ::-1]),
    "one for all": _of_array(lambda a: np.full(a.shape, a.flat[0])),
    "sparse of it": _of_array(lambda a: scipy.sparse.csr_array(a) if a.ndim == 2 else NOTHING),
    "DM of it": _of_array(lambda a: ca.DM(a) if a.ndim < 3 else NOTHING),
    "generator of it": lambda v: (each for each in v) if np.iterable(v) else NOTHING,
    "list of it": lambda v: [v],
    "twice in a tuple": lambda v: (v, v),
    "repr of it": repr,
    "class of it": type,
    "lambda of it": lambda v: lambda: v,
    "dict of it": lambda v: {"x": v},
    "first item": lambda v: v[0] if isinstance(v, list | tuple) and v else NOTHING,
    "items twice": lambda v: [*v, *v] if isinstance(v, list | tuple) and v else NOTHING,
    "dict without": _of((dict,), lambda v: dict(list(v.items())[1:])),
    "dict with text": _of((dict,), lambda v: v | {"x": 1.0}),
    "dict with number": _of((dict,), lambda v: v | {3: 1.0}),
    "dict with None": _of((dict,), lambda v: v | {None: None}),
    "dict with empty": _of((dict,), lambda v: v | {"": 1.0}),
    "dict as list": _of((dict,), lambda v: list(v.items())),
    "upper": _of((str,), str.upper),
    "with a blank": _of((str,), lambda v: v + " "),
    "with NUL": _of((str,), lambda v: v + "\0"),
    "as bytes": _of((str,), str.encode),
    "numpy text": _of((str,), np.str_),
    "negative": _of((int, float), lambda v: -v),
    "as text": _of((int, float), str),
    "times 1e6": _of((int, float), lambda v: v * 1e6),
    "times a thousandth": _of((int, float), lambda v: v * 1e-3),
    "as fraction": _of((int,), lambda v: v + 0.5),
    "as an array": _of((int, float), lambda v: np.array([v])),
    "as 0-d": _of((int, float), lambda v: np.array(v)),
    "path with NUL": lambda v: Path(f"{v}\0") if isinstance(v, Path) else NOTHING,
    "a folder": lambda v: v.parent if isinstance(v, Path) else NOTHING,
    "below a file": lambda v: Path(__file__) / "x" if isinstance(v, Path) else NOTHING,
    "path in nowhere": lambda v: Path("nowhere", v.name) if isinstance(v, Path) else NOTHING,
    "without ending": lambda v: v.with_suffix("") if isinstance(v, Path) else NOTHING,
    "unknown ending": lambda v: v.with_suffix(".xyz") if isinstance(v, Path) else NOTHING,
}

WHOLE = (
    {name: lambda _, new=new: new for name, new in (NUMBERS | OTHERS).items()}
    | {name: lambda _, make=make: make() for name, make in MADE.items()}
    | CHANGES
)

ENTRY = (
    {name: lambda _, new=new: new for name, new in (NUMBERS | OTHERS).items()}
    | {name: lambda _, make=make: make() for name, make in MADE.items() if "huge" not in name}
    | {name: CHANGES[name] for name in ("list of it", "class of it", "negative", "times 1e6")}
)


# ---- places ----


def place_of(value, choose: random.Random):
    """A place in an array, sequence or dict; None if there is none."""
    if isinstance(value, dict):
        return choose.choice(list(value)) if value else None
    if isinstance(value, np.ndarray | list | tuple):
        shape = np.shape(value) if _array(value) is not None else (len(value),)
        if shape and 0 not in shape:
            return tuple(choose.randrange(size) for size in shape)
    return None


def spoilt(value, place, spoiler):
    """The value, spoilt whole or in one place; ``NOTHING`` where the spoiler has no meaning."""
    if place is None:
        return WHOLE[spoiler](value)
    if isinstance(value, dict):
        new = ENTRY[spoiler](value[place])
        return NOTHING if new is NOTHING else value | {place: new}
    entry = value
    for index in place:
        entry = entry[index]
    new = ENTRY[spoiler](entry.item() if isinstance(entry, np.generic) else entry)
    if new is NOTHING:
        return NOTHING
    if isinstance(value, np.ndarray) and type(new) is float:
        changed = value.astype(float)
        changed[place] = new
        return changed
    return _with(value.tolist() if isinstance(value, np.ndarray) else value, place, new)


def _with(items, place, new):
    index, *rest_of_place = place
    changed = list(items)
    changed[index] = _with(changed[index], rest_of_place, new) if rest_of_place else new
    return changed


def is_replaced(value, place, spoiler):
    """Whether a spoiler gives something else there."""
    new = spoilt(value, place, spoiler)
    return new is not NOTHING and not (
        new is value or (type(new) is type(value) is int and new == value)
    )
