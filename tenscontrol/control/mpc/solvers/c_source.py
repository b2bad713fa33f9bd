"""The text of the active-set solver in C, for libraries made at run time and for generated code."""

from __future__ import annotations

from importlib.resources import files


def active_set_source() -> str:
    """Return the C99 text of ``active_set.c``, whose head says how to use it."""
    place = files("tenscontrol.control.mpc") / "solvers" / "active_set.c"
    return place.read_text(encoding="utf-8")


def stages_source() -> str:
    """Return the C99 text of ``stages.c``, which goes after that of ``active_set.c``."""
    place = files("tenscontrol.control.mpc") / "solvers" / "stages.c"
    return place.read_text(encoding="utf-8")
