"""Text of the files of a generated controller."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import shorten, wrap

import casadi as ca
import numpy as np

from tenscontrol.actuation.driven_strings import member_rows
from tenscontrol.arrays import FloatArray
from tenscontrol.control.command import Fallback
from tenscontrol.deploy.code_interface import CodeInterface
from tenscontrol.deploy.controllers import LawCode
from tenscontrol.dynamics.evaluator import Function, builds
from tenscontrol.estimation.kalman_filter import KalmanFilter
from tenscontrol.status import OF_ESTIMATES, Status

# Numbers a line.
_PER_LINE = 6

# How a C file ends: by a condition or a definition.
_END = re.compile(r"^(#endif.*|};?)\n+\Z", re.MULTILINE)

# A status in C is its position, and a fallback its position from 1 times this, added to it.
_FALLBACK = 32

# What the time is for, of a law on a plant and of a gait.
_TIME = (
    "matters only for a reference that moves, and is rounded to a whole sample",
    "of a clock that never goes back",
)

_UNIT = {
    "force_density": "force densities, N/m",
    "rest_length": "rest lengths, m",
    "bar_length": "lengths of bars, m",
    "length": "rest lengths of strings and lengths of bars, m",
}


@builds
def code_files(
    interface: CodeInterface, law: LawCode, name: str, estimator: KalmanFilter | None
) -> dict[str, str]:
    """Return the texts of all files, by file name; names in C begin with ``name``."""
    functions = _named(interface.functions | law.functions, name)
    (d, nodes), count = interface.nodes.shape, len(interface.bounds[0])
    prefix = name.upper()
    sizes = _constants({f"{prefix}_COORDINATES": d * nodes, f"{prefix}_COMMANDS": count})
    words = {
        "UNIT": _UNIT[interface.input],
        "INPUTS": _inputs(interface),
        "SIZES": f"{sizes}\n#define {prefix}_STEP {interface.sample_time!r} /* sample time, s */",
        "STATUSES": "\n".join(
            f"#define {prefix}_{status.name} {number} /* {status} */"
            for number, status in enumerate(Status)
            if estimator is not None or status not in OF_ESTIMATES
        ),
        "FALLBACKS": "\n".join(
            f"#define {prefix}_{fallback.name} {_FALLBACK * number} /* {fallback} */"
            for number, fallback in enumerate(Fallback, 1)
        ),
        "REASON": str(_FALLBACK - 1),
        "AXES": ", ".join("xyz"[:d]),
        "NODES": str(nodes),
        "COMMANDS": str(count),
        "STEP": f"{interface.sample_time:g}",
        "TIME": _TIME[interface.plant is None],
        "KIND": interface.kind,
    }
    words["ESTIMATOR"] = ""
    if estimator is not None:
        read = {
            "READINGS": str(law.numbers_read),
            "KINDS_READ": ", ".join(kind.name for kind in estimator.sensors.kinds),
            "HELD": _UNIT[estimator.input],
        }
        headers = ["filter.h", *(["sample.h"] if "sample.c" in law.templates else [])]
        text = "".join(_template(header, name, read) for header in headers)
        words["ESTIMATOR"] = text.lstrip() + "\n"
    code = "".join(
        _template(file, name, {}) for file in ("common.c", *law.templates, "interface.c")
    )
    texts = {
        f"{name}.h": _template("controller.h", name, words),
        f"{name}.c": code,
        f"{name}_data.h": _data(interface, law, functions),
        "main.c": _template("main.c", name, {}),
        "README.txt": _template("README.txt", name, words),
        **(_casadi(functions, name) if functions else {}),
    }
    core = files("tenscontrol") / "core"
    return texts | {file: (core / file).read_text(encoding="utf-8") for file in law.sources}


def _inputs(interface: CodeInterface) -> str:
    """Return which number of a command is which input, as a comment; nothing for all strings."""
    actuation = interface.actuation
    if actuation.is_whole and interface.input != "length":
        return ""
    strings, bars = member_rows(interface.input, interface.structure)
    nouns = " and ".join(["strings"] * (strings.stop > 0) + ["bars"] * (bars.stop > bars.start))
    lines = []
    for number, name in enumerate(interface.input_names):
        moved = ", ".join(
            (f"string {k}" if k < bars.start else f"bar {k - bars.start}")
            + (f" by {actuation.ratio[k]:g}" if actuation.ratio[k] != 1 else "")
            for k in np.flatnonzero(actuation.input == number)
        )
        lines += wrap(f"{number}: {name}: {moved}", 96, subsequent_indent="      ")
    text = "\n".join([f" *   {line}" for line in lines])
    return (
        f"\n/*\n * What the numbers of a command set, and which {nouns} move, by which ratio.\n"
        f" * Other {nouns} are passive.\n *\n{text}\n */\n"
    )


def status_and_fallback(number: int) -> tuple[Status, Fallback | None]:
    """Return what the number that a generated controller returns stands for."""
    fallback, status = divmod(number, _FALLBACK)
    return tuple(Status)[status], (None, *Fallback)[fallback]


def _named(functions: dict[str, ca.Function], name: str) -> list[ca.Function]:
    """Return functions under the names that they have in C."""
    renamed = []
    for role, function in functions.items():
        symbols = [ca.MX.sym(f"x{i}", *function.size_in(i)) for i in range(function.n_in())]
        renamed.append(Function(f"{name}_{role}", symbols, function.call(symbols)))
    return renamed


def _data(interface: CodeInterface, law: LawCode, functions: list[ca.Function]) -> str:
    """Return the header of all numbers."""
    low, high = interface.bounds
    # Work space for the largest function by CasADi.
    work = {
        f"CASADI_{space.upper()}": max(
            [1, *(getattr(function, f"sz_{space}")() for function in functions)]
        )
        for space in ("arg", "res", "iw", "w")
    }
    change, check = interface.change, interface.check
    structure, d = interface.structure, len(interface.nodes)
    rolling = structure.fixed_rows[~np.isin(structure.fixed_rows // d, structure.fixed)]
    constants: dict[str, float | int] = {
        "DIMENSION": d,
        "STATES": interface.state_count,
        "REDUCED": int(interface.plant is not None),
        "HOLDS_PREVIOUS_INPUT": int(interface.input != "force_density"),
        "CASADI": int(bool(functions)),
        "BARS": check.bars.shape[1],
        "FIXED": len(check.fixed),
        "ROLLERS": len(rolling),
        "FARTHEST": float(check.farthest),
        "SPREAD": float(check.spread),
        "FASTEST": float(check.fastest),
        "LARGEST_VELOCITY": float(check.largest_velocity),
        "SUPPORT_DISTANCE": float(check.support_distance),
        "MATRICES": len(law.matrices),
        **work,
        **law.constants,
    }
    arrays: dict[str, np.ndarray] = {
        "low": low,
        "high": high,
        "change": np.full(len(low), np.inf) if change is None else change,
        "equilibrium": interface.equilibrium_input,
        "bar_start": check.bars[0],
        "bar_end": check.bars[1],
        "shortest_square": check.squares[0],
        "longest_square": check.squares[1],
        "fixed_node": check.fixed,
        "place": check.places.ravel(order="F"),
        "rolling": rolling,
        "held_at": interface.nodes.ravel(order="F")[rolling],
        **law.arrays,
    }
    if law.table is not None:
        first, table = law.table
        varying = np.flatnonzero((table != table[0]).any(axis=0))
        arrays["first_row"] = table[0]
        constants |= {"ROW_LENGTH": table.shape[1], "VARYING": len(varying)}
        if len(varying):
            arrays |= {"varying": varying, "table": table[:, varying]}
            constants |= {"FIRST_SAMPLE": first, "LAST_SAMPLE": first + len(table) - 1}
    texts = [
        "/* Numbers of the controller. Included once. */",
        _constants(constants),
        *(_array(name, values) for name, values in arrays.items()),
        *(_matrix(name, values) for name, values in law.matrices.items()),
    ]
    return "\n".join(texts) + "\n"


def _casadi(functions: list[ca.Function], name: str) -> dict[str, str]:
    """Return the files that CasADi writes."""
    code = ca.CodeGenerator(f"{name}_casadi", {"with_header": True})
    for function in functions:
        code.add(function)

    # CasADi does not say that a disk is full: a file then does not end as it should.
    with TemporaryDirectory(prefix="tenscontrol-") as above:
        folder, number, reason = Path(above) / "code", errno.EIO, "a file of it is cut short"
        try:
            os.mkdir(folder)
            code.generate(str(folder) + os.sep)
            texts = {path.name: path.read_text("utf-8") for path in folder.glob("*.[ch]")}
            if all(
                text.count("{") == text.count("}") and _END.search(text) for text in texts.values()
            ):
                return texts
        except OSError as error:
            number = error.errno or number
            reason = error.strerror or shorten(str(error), 300)
    advice = "make TMPDIR a folder that can be written and has space"
    raise OSError(number, f"cannot write C code: {reason}; {advice}", str(folder))


def _constants(values: Mapping[str, float | int]) -> str:
    """Return numbers as ``#define`` lines."""
    return "\n".join(f"#define {name} {_number(value)}" for name, value in values.items())


def _array(name: str, values: np.ndarray) -> str:
    """Return an array of one or two dimensions as a constant; one of no entries as a zero."""
    kind = "int" if values.dtype.kind in "iu" else "double"
    if values.size == 0:
        values = np.zeros(1, dtype=values.dtype)
    size = "".join(f"[{count}]" for count in values.shape)
    rows = [_wrapped(row) for row in np.atleast_2d(values)]
    inside = rows[0] if values.ndim == 1 else ",\n".join(f"{{\n{row}\n}}" for row in rows)
    return f"static const {kind} {name}{size} = {{\n{inside}\n}};"


def _matrix(name: str, values: FloatArray) -> str:
    """Return a matrix as constants: entries that are not zero, by rows."""
    from scipy.sparse import csr_array

    rows = csr_array(values)
    arrays = {
        f"{name}_start": rows.indptr.astype(np.int64),
        f"{name}_column": rows.indices.astype(np.int64),
        f"{name}_value": rows.data.astype(float),
    }
    record = f"static const Matrix {name} = {{{values.shape[0]}, {', '.join(arrays)}}};"
    return "\n".join([*(_array(*array) for array in arrays.items()), record])


def _template(file: str, name: str, words: Mapping[str, str]) -> str:
    """Return a C file of the package.

    ``controller`` is replaced by ``name`` where it begins a name, and ``@KEY@`` by its word.
    """
    text = (files("tenscontrol.deploy") / "templates" / file).read_text(encoding="utf-8")
    text = re.sub(r"\bcontroller(?=_|\.[ch]\b)", name, text)
    text = re.sub(r"\bCONTROLLER(?=_)", name.upper(), text)
    for key, word in words.items():
        text = text.replace(f"@{key}@", word)
    return text


def _wrapped(values: np.ndarray) -> str:
    texts = [_number(value) for value in values.tolist()]
    lines = [texts[i : i + _PER_LINE] for i in range(0, len(texts), _PER_LINE)]
    return ",\n".join(", ".join(line) for line in lines)


def _number(value: float) -> str:
    """Return a number that C reads back to the last bit."""
    if isinstance(value, int):
        return str(value)
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))
