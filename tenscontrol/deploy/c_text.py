"""Numbers and names as C text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files

import numpy as np

from tenscontrol.validation import FloatArray

_PER_LINE = 6


def constants(values: Mapping[str, float | int]) -> str:
    """Return numbers as ``#define`` lines."""
    return "\n".join(f"#define {name} {_number(value)}" for name, value in values.items())


def array(name: str, values: np.ndarray) -> str:
    """Return an array of one or two dimensions as a constant; one of no entries as a zero."""
    kind = "int" if values.dtype.kind in "iu" else "double"
    if values.size == 0:
        values = np.zeros(1, dtype=values.dtype)
    size = "".join(f"[{count}]" for count in values.shape)
    rows = [_wrapped(row) for row in np.atleast_2d(values)]
    inside = rows[0] if values.ndim == 1 else ",\n".join(f"{{\n{row}\n}}" for row in rows)
    return f"static const {kind} {name}{size} = {{\n{inside}\n}};"


def matrix(name: str, values: FloatArray) -> str:
    """Return a matrix as constants: entries that are not zero, by rows."""
    from scipy.sparse import csr_array

    rows = csr_array(values)
    parts = [
        array(f"{name}_start", rows.indptr.astype(np.int64)),
        array(f"{name}_column", rows.indices.astype(np.int64)),
        array(f"{name}_value", rows.data.astype(float)),
        f"static const Matrix {name} = {{{values.shape[0]}, {name}_start, {name}_column, "
        f"{name}_value}};",
    ]
    return "\n".join(parts)


def template(file: str, name: str, words: Mapping[str, str]) -> str:
    """Return a C file of the package, with the name of the controller and other words put in.

    Parameters
    ----------
    file : str
    name : str
        What ``controller`` is replaced by where it begins a name.
    words : mapping of str to str
        What ``@KEY@`` is replaced by.
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
