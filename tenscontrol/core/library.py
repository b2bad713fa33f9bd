"""The shared library of the core, where it was built."""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from pathlib import Path

import tenscontrol.core

#: What the library is called, in the folder of this file.
NAME = "_core.dll" if sys.platform == "win32" else "_core.so"


@cache
def library() -> ctypes.CDLL | None:
    """Return the core, or None where the package was installed without it."""
    file = _file()
    if file is None:
        return None
    core = ctypes.CDLL(str(file))
    core.tc_motion_work_size.restype = ctypes.c_size_t
    core.tc_frequency.restype = core.tc_evaluations.restype = ctypes.c_double
    return core


def absence() -> str:
    """Return why there is no core; nothing where there is one."""
    if _file() is not None:
        return ""
    return (
        "tenscontrol was installed without a C compiler, or its build failed: "
        "install one and run pip install again, with -v to see the compiler's messages"
    )


def _file() -> Path | None:
    # An editable installation keeps the library apart from the sources: both are on the path.
    places = (Path(folder) / NAME for folder in tenscontrol.core.__path__)
    return next((file for file in places if file.is_file()), None)
