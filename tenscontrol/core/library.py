"""The shared library of the core, where it was built."""

from __future__ import annotations

import ctypes
import hashlib
import sys
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path

from tenscontrol.warn import warn

#: What the library is called.
NAME = "_core.dll" if sys.platform == "win32" else "_core.so"

_FOLDER = Path(__file__).parent

_MISSING = (
    "tenscontrol was installed without a C compiler, or its build failed: install one and run pip "
    "install again, with -v to see the compiler's messages"
)
_OTHER = (
    "the library of tenscontrol's core was built from other sources than those in this folder: "
    "run pip install again"
)


@cache
def library() -> ctypes.CDLL | None:
    """Return the core, or None where there is none; :func:`absence` says why."""
    core, missing = _loaded()
    if missing == _OTHER:
        warn(
            f"{_OTHER}; until then runs and controllers go without it, and are slower",
            RuntimeWarning,
        )
    return core


def absence() -> str:
    """Return why there is no core; nothing where there is one."""
    return _loaded()[1]


@cache
def _loaded() -> tuple[ctypes.CDLL | None, str]:
    file = _file()
    if file is None:
        return None, _MISSING
    core = ctypes.CDLL(str(file))
    core.tc_sources.restype = ctypes.c_char_p
    if (_FOLDER / "core.h").is_file() and core.tc_sources().decode() != sources_id():
        return None, _OTHER
    core.tc_motion_work_size.restype = core.tc_runs_work_size.restype = ctypes.c_size_t
    core.tc_variations_work_size.restype = core.tc_strut_work_size.restype = ctypes.c_size_t
    core.tc_reduced_work_size.restype = ctypes.c_size_t
    core.tc_near_bars.restype = ctypes.c_int64
    core.tc_begin.restype = core.tc_frequency.restype = ctypes.c_double
    core.tc_evaluations.restype = ctypes.c_double
    return core, ""


def sources_id() -> str:
    """Return what the sources in this folder are told apart from others by."""
    files = sorted(file for kind in ("*.c", "*.h") for file in _FOLDER.glob(kind))
    digests = "".join(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)
    return hashlib.sha256(digests.encode()).hexdigest()


def _file() -> Path | None:
    """Return the library: beside this file, or in the installation if this is a folder of it."""
    folders = import_module(__package__).__path__  # several where it is installed as editable
    places = [Path(folder) / NAME for folder in folders]
    if not any(place.is_file() for place in places):
        from importlib.metadata import PackageNotFoundError, distribution

        with suppress(PackageNotFoundError):  # the sources alone
            installed = distribution("tenscontrol").locate_file(f"tenscontrol/core/{NAME}")
            places.append(Path(str(installed)))
    return next((place for place in places if place.is_file()), None)
